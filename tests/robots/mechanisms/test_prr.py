"""Planar platforms on carriages against their constraint, differences, and a scan of the platform's turn."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.core import GeometryError
from lmeasure.robots.parallel.mechanisms.jacobians import Singular, singular
from lmeasure.robots.parallel.mechanisms.prr import CarriagePlatform, carriages

SEEDS = st.integers(0, 10**6)


def platform(seed: int) -> CarriagePlatform:
    rng = np.random.default_rng(seed)
    a = rng.uniform(-400.0, 400.0, (3, 2))
    return CarriagePlatform(a, a + rng.uniform(-600.0, 600.0, (3, 2)), rng.uniform(-150.0, 150.0, (3, 2)), rng.uniform(200.0, 600.0, 3))


def placed(seed: int) -> tuple[CarriagePlatform, np.ndarray, np.ndarray]:
    """A platform whose rods are as long as a pose and carriages within the guides make them."""
    drawn, rng = platform(seed), np.random.default_rng([seed, 1])
    pose = np.array([*rng.uniform(-300.0, 300.0, 2), rng.uniform(-3.0, 3.0)])
    s = rng.uniform(0.05, 0.95, 3) * drawn.guides
    rods = np.linalg.norm(drawn.ends(pose) - drawn.a - s[:, None] * drawn.along, axis=1)
    return CarriagePlatform(drawn.a, drawn.b, drawn.hinges, rods), pose, s


def test_ten_thousand_round_trips() -> None:
    """Equation 4 of source 001 with its minus: both roots are at the rod's length from D, and the carriage set is one of them."""
    rng = np.random.default_rng(1)
    a, d = rng.uniform(-10.0, 10.0, (2, 10000, 2))
    u = rng.normal(size=(10000, 2))
    u /= np.linalg.norm(u, axis=1)[:, None]
    s = rng.uniform(-5.0, 15.0, 10000)
    rod = np.linalg.norm(d - a - s[:, None] * u, axis=1)
    both = carriages(d - a, u, rod)
    assert np.abs(both - s[:, None]).min(axis=1).max() < 1e-8  # at dead points a root keeps half of its digits
    away = np.linalg.norm(d[:, None] - a[:, None] - both[..., None] * u[:, None], axis=2)
    np.testing.assert_allclose(away, np.repeat(rod[:, None], 2, axis=1), rtol=0.0, atol=1.5e-11)
    # the printed sign puts the carriages on the other side of A
    printed = np.sort(-both, axis=1)
    wrong = np.linalg.norm(d[:, None] - a[:, None] - printed[..., None] * u[:, None], axis=2)
    assert np.median(np.abs(wrong - rod[:, None])) > 1.0


def test_a_dyad_in_space_is_the_same_equation() -> None:
    rng = np.random.default_rng(2)
    u, across = np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :2].T
    reach = 3.0 * u + 4.0 * across
    np.testing.assert_allclose(carriages(reach, u, np.array(5.0)), [0.0, 6.0], atol=1e-14)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_inverse_and_assemblies_find_each_other(seed: int) -> None:
    mechanism, pose, s = placed(seed)
    roots = mechanism.inverse(pose)
    np.testing.assert_allclose(np.nanmin(np.abs(roots - s[:, None]), axis=1), 0.0, atol=1e-6)
    found = mechanism.assemblies(s)
    assert 1 <= len(found) <= 6
    assert np.abs(mechanism.residuals(found, np.broadcast_to(s, (len(found), 3)))).max() < 1e-6
    assert np.abs((found - pose) * [1.0, 1.0, 300.0]).max(axis=1).min() < 1e-5


@pytest.mark.parametrize("seed", range(12))
def test_no_assembly_is_missed(seed: int) -> None:
    """Against a scan: for each turn the first two rods leave two places of the platform; zeros of what the third rod then lacks."""
    mechanism, _, s = placed(seed)
    c = mechanism.a + s[:, None] * mechanism.along
    phi = np.linspace(-np.pi, np.pi, 200001)
    turned = np.stack(
        [
            np.cos(phi)[:, None] * mechanism.hinges[:, 0] - np.sin(phi)[:, None] * mechanism.hinges[:, 1],
            np.sin(phi)[:, None] * mechanism.hinges[:, 0] + np.cos(phi)[:, None] * mechanism.hinges[:, 1],
        ],
        axis=-1,
    )
    centre = c - turned  # of the circles on which E lies
    base = centre[:, 1] - centre[:, 0]
    far = np.linalg.norm(base, axis=1)
    along = (far**2 + mechanism.rods[0] ** 2 - mechanism.rods[1] ** 2) / (2.0 * far)
    with np.errstate(invalid="ignore"):
        off = np.sqrt(mechanism.rods[0] ** 2 - along**2)
    count = 0
    for sign in (1.0, -1.0):
        e = centre[:, 0] + (along / far)[:, None] * base + sign * (off / far)[:, None] * np.stack([-base[:, 1], base[:, 0]], axis=1)
        lacks = np.linalg.norm(e - centre[:, 2], axis=1) - mechanism.rods[2]
        with np.errstate(invalid="ignore"):
            count += int(np.sum(lacks[1:] * lacks[:-1] < 0.0))
    assert len(mechanism.assemblies(s)) == count


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_rates_are_differences(seed: int) -> None:
    mechanism, pose, s = placed(seed)
    jacobians = mechanism.jacobians(pose, s)
    step = np.array([1e-3, 1e-3, 1e-6])
    for k, h in enumerate(step):
        off = np.eye(3)[k] * h
        difference = 0.5 * (mechanism.residuals(pose + off, s) - mechanism.residuals(pose - off, s)) / (2.0 * h)
        np.testing.assert_allclose(jacobians.output[:, k], difference, rtol=1e-7, atol=1e-4)
        difference = 0.5 * (mechanism.residuals(pose, s + np.eye(3)[k]) - mechanism.residuals(pose, s - np.eye(3)[k])) / 2.0
        np.testing.assert_allclose(jacobians.drives[:, k], difference, rtol=1e-7, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_speeds_of_carriages_are_differences(seed: int) -> None:
    mechanism, pose, s = placed(seed)
    rng = np.random.default_rng([seed, 2])
    rates = rng.normal(size=3) * [50.0, 50.0, 0.3]
    gain = np.abs(np.diag(mechanism.jacobians(pose, s).drives)) / mechanism.rods
    if gain.min() < 0.5:  # near a dead point no difference is good
        return
    h = 3e-4
    poses = pose + rates * np.array([[-h], [0.0], [h]])
    roots = carriages(mechanism.ends(poses) - mechanism.a, mechanism.along, mechanism.rods)
    near = np.take_along_axis(roots, np.argmin(np.abs(roots - s[:, None]), axis=-1)[..., None], axis=-1)[..., 0]
    np.testing.assert_allclose(mechanism.jacobians(pose, s).drive_rates(rates), (near[2] - near[0]) / (2.0 * h), rtol=1e-4, atol=1e-2)


def test_singular_poses_are_of_the_types_that_geometry_says() -> None:
    """A rod across its guide is a dead point (type 1); three rods through one point, or parallel, let the platform go (type 2)."""
    a = np.array([[-300.0, -200.0], [300.0, -200.0], [0.0, 300.0]])
    b = a + [[600.0, 0.0], [-500.0, 0.0], [400.0, 400.0]]
    hinges = np.array([[-50.0, 0.0], [50.0, 0.0], [0.0, 60.0]])
    pose, units = np.zeros(3), np.array([1.0, 1.0, 1 / 50.0])

    def made(s: list[float]) -> tuple[CarriagePlatform, np.ndarray]:
        at = np.array(s)
        along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        rods = np.linalg.norm(hinges - a - at[:, None] * along, axis=1)
        return CarriagePlatform(a, b, hinges, rods), at

    sound = made([100.0, 120.0, 130.0])
    dead = made([250.0, 120.0, 130.0])
    # all rods through (0, 500)
    through = made([230.0, 230.0, 0.0])
    assert singular(sound[0].jacobians(pose, sound[1]), units) == Singular.NO
    assert singular(dead[0].jacobians(pose, dead[1]), units) == Singular.DRIVES
    assert singular(through[0].jacobians(pose, through[1]), units) == Singular.OUTPUT


def test_both_roots_of_every_chain_assemble_the_mechanism() -> None:
    mechanism, pose, _ = placed(5)
    roots = mechanism.inverse(pose)
    for choice in product((0, 1), repeat=3):
        s = roots[np.arange(3), choice]
        if np.isfinite(s).all():
            assert np.abs(mechanism.residuals(pose, s)).max() < 1e-8
            assert ((s >= 0.0) & (s <= mechanism.guides)).all()


def test_what_cannot_be_is_refused() -> None:
    good = platform(0)
    with pytest.raises(GeometryError, match="chain 2: A and B are one point"):
        CarriagePlatform(good.a, np.vstack([good.b[0], good.a[1], good.b[2]]), good.hinges, good.rods)
    with pytest.raises(GeometryError, match="chain 3: a rod of length 0"):
        CarriagePlatform(good.a, good.b, good.hinges, good.rods * [1.0, 1.0, 0.0])
    # equal, parallel rods to a platform of the carriages' size: it translates along circles
    square = CarriagePlatform(
        np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]]),
        np.array([[50.0, 0.0], [150.0, 0.0], [50.0, 100.0]]),
        np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]]),
        np.full(3, 80.0),
    )
    with pytest.raises(GeometryError, match="continuum"):
        square.assemblies(np.zeros(3))
