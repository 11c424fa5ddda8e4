"""Every kind of channel: its row and gradient are the derivatives of what it predicts, in whatever frame the rig is described."""

from dataclasses import replace
from typing import Any

import numpy as np
import oracles
import pytest
from hypothesis import given, settings, strategies as st
from reference import rig_channels
from reference.channel import Observation, differences, predictions, values
from rigs import HOME, FloatArray, cable, cables, distance, inclination, poses, rows_of, swivel
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.kernels import cable as compiled
from lmeasure.rig import FACTORS, rig_from_dict
from lmeasure.sensors import wrap
from lmeasure.simulation import cell_rig


def every_kind(seed: int) -> list[Observation]:
    g = np.random.default_rng(seed)
    begun = poses(seed + 1, 1)[0]
    wrapped = [cable(g, i, 6, zeroed_at=begun if i else None) for i in range(3)]
    straight = cable(g, 3, 6, radius=0.0, zeroed_at=begun)
    return [*wrapped, straight, *(swivel(c, 17.0) for c in wrapped), inclination(g, "lean"), distance(g, "beam")]


def tried(o: Observation, g: np.random.Generator) -> FloatArray:
    """Parameters somewhat off those it is taken to have, the drum's among them; a straight cable stays straight."""
    p = values(o)
    off = p + g.normal(size=len(p)) * np.minimum([q.prior_u for q in o.parameters], 0.05 * np.maximum(np.abs(p), 1.0))
    return np.where((p == 0.0) & np.array([q.name.endswith("radius_mm") for q in o.parameters]), 0.0, off)


@settings(max_examples=12, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_rows_and_gradients_are_central_differences(seed: int, as_stated: bool) -> None:
    g = np.random.default_rng(seed)
    at = poses(seed, 3)
    for o in every_kind(seed):
        p = values(o) if as_stated else tried(o, g)
        scale = max(1.0, float(np.abs(o.predict(at, p)).max()))
        for axis, h in enumerate(np.repeat([1e-5, 1e-2], 3)):
            step = h * np.eye(6)[axis]
            expected = (o.predict(se3.displaced(at, step), p) - o.predict(se3.displaced(at, -step), p)) / (2.0 * h)
            np.testing.assert_allclose(o.row(at, p)[:, axis], expected, rtol=1e-6, atol=3e-11 * scale / h, err_msg=f"{o.name} {axis}")
        found = o.gradient(at, p)
        for i, q in enumerate(o.parameters):
            if q.name.endswith("radius_mm") and p[i] == 0.0:
                continue  # there is no pulley of negative radius: `test_radius_zero_is_the_limit`
            h = 1e-4 * max(abs(p[i]), 0.01) if q.unit else 1e-5
            ahead, behind = (o.predict(at, p + s * h * np.eye(len(p))[i]) for s in (1, -1))
            np.testing.assert_allclose(found[:, i], (ahead - behind) / (2.0 * h), rtol=1e-5, atol=1e-10 * scale / h, err_msg=q.name)


def test_radius_zero_is_the_limit() -> None:
    at, g = poses(0, 5), np.random.default_rng(1)
    straight = cable(g, 2, 6, radius=0.0)
    p, thin = values(straight), values(straight)
    thin[5] = 1e-5
    np.testing.assert_allclose(straight.gradient(at, p), straight.gradient(at, thin), atol=1e-6)
    np.testing.assert_allclose(straight.gradient(at, p)[:, 5], (straight.predict(at, thin) - straight.predict(at, p)) / 1e-5, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_cable_is_that_of_the_compiled_formulas(seed: int) -> None:
    """Lengths, rows and gradients, and counts there and back."""
    channels, at = cables(seed, 6, radius=0.0 if seed == 0 else None), poses(seed, 20)
    rows = rows_of(channels)
    lengths = compiled.span_lengths(rows, at) - compiled.span_lengths(rows, HOME[None])
    np.testing.assert_allclose(predictions(channels, at), lengths, rtol=0, atol=1e-11)
    counts = compiled.counts_from_changes(rows, lengths)
    np.testing.assert_allclose(np.stack([o.readings(k) for o, k in zip(channels, counts.T, strict=True)], 1), lengths, rtol=0, atol=1e-11)
    expected = compiled.length_gradients(rows, at, counts, np.ones(6))
    expected -= compiled.length_gradients(rows, HOME[None], np.zeros((1, 6)), np.ones(6))
    found = np.stack([o.gradient(at, values(o)) for o in channels], 1)
    np.testing.assert_allclose(found[:, :, :13], expected * FACTORS, rtol=1e-9, atol=1e-10)
    assert (found[:, :, 13] == -1.0).all()
    np.testing.assert_allclose(np.stack([o.row(at, values(o)) for o in channels], 1), compiled.span_rows_of(rows, at), rtol=0, atol=1e-11)


def test_other_drums_make_other_counts_of_a_length() -> None:
    """With another drum tried, what is read are that drum's counts as the stated drum makes lengths of them, scale and sign included."""
    g = np.random.default_rng(5)
    o, at = cable(g, 1, 6), poses(2, 10)
    p = values(o)
    p[[6, 7, 8, 12]] += [0.01, 20.0, -8.0, 0.4]
    drum = o._drum(p)
    recorded = -p[6] * drum.counts(o.predict(at, np.where(np.isin(np.arange(14), [6, 7, 8, 12]), values(o), p)))
    np.testing.assert_allclose(o.predict(at, p), o.readings(recorded, sign=-1), rtol=0, atol=1e-10)


@settings(max_examples=10, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_the_base_frame_does_not_matter(seed: int) -> None:
    """A rig described in another base frame: readings are the same, of a swivel, whose zero looks up, but for one angle."""
    g = np.random.default_rng(seed)
    to = se3.pose(g.uniform(-500.0, 500.0, 3), Rotation.random(rng=g))
    turn, at = se3.matrices(to), poses(seed, 4)
    for o in every_kind(seed):
        kind: Any = o
        moved = replace(kind, parameters=_described(o, to, turn))
        begun = getattr(o, "zeroed_at", None)
        if begun is not None:
            moved = replace(moved, zeroed_at=se3.compose(to, begun))
        there = se3.compose(to, at)
        one, other = predictions([o], at), predictions([moved], there)
        same = differences([o], one, other)
        np.testing.assert_allclose(differences([o], same, np.full((4, 1), same[0, 0] if o.period < 10.0 else 0.0)), 0.0, atol=1e-9)
        # a motion of the base's axes is one of the other's
        turned = np.concatenate([o.row(at, values(o))[:, :3] @ turn.T, o.row(at, values(o))[:, 3:] @ turn.T], axis=1)
        np.testing.assert_allclose(moved.row(there, values(moved)), turned, rtol=0, atol=1e-9)


def _described(o: Observation, to: FloatArray, turn: FloatArray) -> tuple[Any, ...]:
    """A channel's parameters in another base frame."""
    p = values(o)
    if o.name == "lean":
        p[3:6] = turn @ p[3:6]
    else:
        p[:3] = se3.apply(to, p[:3])
    if len(p) > 7:
        a, b = np.radians(p[3:5])
        u = turn @ [-np.cos(a) * np.sin(b), -np.cos(a) * np.cos(b), np.sin(a)]
        p[3:5] = np.degrees([np.arcsin(u[2]), np.arctan2(-u[0], -u[1])])
    return tuple(replace(q, value=float(v)) for q, v in zip(o.parameters, p, strict=True))


def test_a_swivel_is_read_as_the_contract_says() -> None:
    """e0 upward and normal to u, e1 = u x e0; angles are compared the short way around."""
    g = np.random.default_rng(3)
    c = cable(g, 2, 6)
    o, at = swivel(c, 200.0), poses(4, 6)
    p = values(c)
    a, b = np.radians(p[3:5])
    u = np.array([float(v) for v in oracles.guide(a, b)])
    e0 = np.array([np.sin(a) * np.sin(b), np.sin(a) * np.cos(b), np.cos(a)])
    way = at[:, :3] + np.array([oracles.matrix_of_quaternion(q) @ p[9:12] for q in at[:, 3:]]) - p[:3]
    angle = np.arctan2(way @ np.cross(u, e0), way @ e0)
    assert e0[2] > 0.0
    np.testing.assert_allclose(o.predict(at, values(o)), angle - np.radians(200.0), atol=1e-12)
    around = differences([o], angle[:, None] + 6.0 * np.pi, predictions([o], at))[:, 0]
    np.testing.assert_allclose(np.exp(1j * around), np.exp(1j * np.radians(200.0)), atol=1e-12)
    assert (np.abs(around) <= np.pi).all()


def test_an_inclination_is_the_angle_above_the_horizontal() -> None:
    o = inclination(np.random.default_rng(0), "lean")
    level = replace(o, parameters=tuple(replace(q, value=v) for q, v in zip(o.parameters, (2.0, 0, 0, 0, 0, 3.0, 0), strict=True)))
    for angle in (-1.2, -0.3, 0.0, 0.5, 1.5):
        at = se3.pose([1.0, 2.0, 3.0], Rotation.from_euler("ZYX", [0.7, -angle, 0.4]))[None]
        assert level.predict(at, values(level))[0] == pytest.approx(angle, abs=1e-12)


def test_inclinometers_share_the_way_up() -> None:
    """As stated for a rig: encoders of 3,600 counts, one zero unknown, one stated, and one and the same gravity."""
    x = rig_channels.rig_inclination("ix", (1.0, 0.0, 0.0), counts_per_revolution=3600, up=(0.0, 0.01, 1.0), u_up=1e-3)
    y = rig_channels.rig_inclination(
        "iy", (0.0, 1.0, 0.0), counts_per_revolution=3600, zero_deg=2.0, u_zero_deg=0.1, up=(0.0, 0.01, 1.0), u_up=1e-3
    )
    assert {q.name for q in x.parameters} & {q.name for q in y.parameters} == {"up_x", "up_y", "up_z"}
    assert (x.parameters[-1].prior_u, y.parameters[-1].prior_u) == (rig_channels.UNKNOWN_DEG, 0.1)
    assert x.variance == pytest.approx(np.radians(0.1) ** 2 / 12.0)
    level = predictions([x, y], HOME[None])[0]
    np.testing.assert_allclose(level, [0.0, np.arctan(0.01) - np.radians(2.0)], atol=1e-15)


@pytest.mark.parametrize("angle", [0.02, 0.7, 1.5, 2.4, 3.0, 3.3, 4.0, 4.9])
@pytest.mark.parametrize("free_mm", [3.0, 40.0, 900.0])
def test_a_cable_goes_round_its_pulley_however_far(angle: float, free_mm: float) -> None:
    """Built from its arc: round a pulley whose middle is R beside B, off it by the tangent."""
    R, turn = 20.0, Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    u, n = turn[0], turn[1]
    e = np.cos(angle) * u + np.sin(angle) * n
    way = R * n + R * (np.sin(angle) * u - np.cos(angle) * n) + free_mm * e
    found = wrap.span(way, u, R)
    if way @ n < 0.0:  # there the pulley has swivelled to the other side
        assert found.angle != pytest.approx(angle)
        return
    assert found.angle == pytest.approx(angle, abs=1e-9)
    assert found.length == pytest.approx(R * angle + free_mm, abs=1e-9)
    np.testing.assert_allclose(found.direction, e, atol=1e-9)
    assert (found.cosine, found.sine) == pytest.approx((np.cos(angle), np.sin(angle)), abs=1e-9)


@pytest.mark.parametrize("travel", [0.0, 0.004, -0.002])
def test_a_drum_pays_out_what_its_counts_are_worth(travel: float) -> None:
    """By the geometry: cable past the fixed pulley is what the drum gave less what the way to it grew; and back to counts."""
    drum, k = wrap.Drum(180.0, 25.0, travel, 0.012), np.array([-9000.0, -1.0, 0.0, 1.0, 4000.0, 30000.0])
    way = np.hypot(drum.tangent_mm, drum.axial_mm + travel * k) - np.hypot(drum.tangent_mm, drum.axial_mm)
    np.testing.assert_allclose(drum.paid_out(k), k * drum.count_mm - way, atol=1e-9)
    np.testing.assert_allclose(drum.slope(k), (drum.paid_out(k + 0.5) - drum.paid_out(k - 0.5)), rtol=1e-6)
    np.testing.assert_allclose(drum.counts(drum.paid_out(k)), k, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("radius", [0.0, 1e-3, 1.0, 25.0])
def test_a_cable_leaves_its_pulley_where_it_is_put_there(radius: float) -> None:
    """Built from the angle that is wrapped and the length that runs free, in a turned frame; straight ones along u too."""
    u, side, _ = Rotation.from_euler("xyz", [0.3, -0.8, 1.9]).as_matrix().T
    angle, free = np.array([0.01, 0.2, 1.3, 2.5]), np.array([800.0, 900.0, 300.0, 1200.0])
    if radius == 0.0:
        angle[0] = 0.0
    along = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * side
    left = radius * (np.sin(angle)[:, None] * u + (1.0 - np.cos(angle))[:, None] * side)
    found = wrap.span(left + free[:, None] * along, u, radius)
    np.testing.assert_allclose(found.length, radius * angle + free, rtol=1e-12)
    np.testing.assert_allclose(found.direction, along, atol=1e-12)


def test_channels_of_a_rig_are_as_uncertain_as_their_counts_and_zeros() -> None:
    """A reading by a count, evenly distributed, and so its zero; one that nobody knows by ten metres, or anywhere on the circle."""
    data = cell_rig(1).to_dict()
    for i, point in enumerate(data["observation_point"]):
        point["drum"] |= {"zero_exact": i == 2, "scale": 1.0 + 0.01 * i}
    rig, twelfth = rig_from_dict(data), np.sqrt(12.0)
    for zeroed in (None, HOME):
        for i, (c, o) in enumerate(zip(rig.cable, rig_channels.cable_lengths(rig, zeroed), strict=True)):
            drum = rig.point(c.from_point).drum
            count = drum.count_length_mm / drum.scale
            assert o.variance == pytest.approx((count / twelfth) ** 2)
            assert o.parameters[-1].value == 0.0
            assert o.parameters[-1].prior_u == pytest.approx(1e4 if zeroed is None else 0.0 if i == 2 else count / twelfth)
            assert (o.count_length_mm, o.counts_per_revolution) == (drum.count_length_mm, drum.counts_per_revolution)
    some = rig_channels.cable_lengths(rig, HOME, rig.cable[1:3])
    assert [o.name for o in some] == [c.channel for c in rig.cable[1:3]]
    point, to = rig.cable[0].from_point, rig.cable[0].to_point
    said: dict[str, Any] = {"zero_deg": 7.0, "u_zero_deg": 0.5}
    for stated, (zero, u) in (({}, (0.0, 360.0 / twelfth)), (said, (7.0, 0.5))):
        swung = rig_channels.swivel_angle(rig, "s1", point, to, counts_per_revolution=4096, **stated)
        leaning = rig_channels.rig_inclination("i1", (0.0, 0.6, 0.8), counts_per_revolution=4096, **stated)
        for sensor in (swung, leaning):
            assert sensor.variance == pytest.approx((2.0 * np.pi / 4096 / twelfth) ** 2)
            assert (sensor.parameters[-1].value, sensor.parameters[-1].unit) == (zero, "deg")
            assert sensor.parameters[-1].prior_u == pytest.approx(u)
        assert [(q.value, q.prior_u) for q in leaning.parameters[:6]] == [(v, 0.0) for v in (0.0, 0.6, 0.8, 0.0, 0.0, 1.0)]
    leaning = rig_channels.rig_inclination("i1", (0.0, 0.6, 0.8), counts_per_revolution=4096, u_axis=1e-3, up=(0.0, 0.6, 0.8), u_up=2e-3)
    assert [(q.value, q.prior_u) for q in leaning.parameters[3:6]] == [(0.0, 2e-3), (0.6, 2e-3), (0.8, 2e-3)]
    assert {q.prior_u for q in leaning.parameters[:3]} == {1e-3}
