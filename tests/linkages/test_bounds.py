"""Limits of a mechanism's poses, stated once more by inverses of its rows: of six links and of more, in all units that are promised."""

import numpy as np
import pytest

from lmeasure.core import FloatArray, StructureError, se3
from lmeasure.linkages import Bounds, link_rows, rim_mm

RNG = np.random.default_rng(11)
BODY = RNG.normal(size=(8, 3)) * 150.0 + [40.0, -30.0, 20.0]
BASE = RNG.normal(size=(8, 3)) * 500.0
AT = se3.displaced(np.array([60.0, -80.0, 900.0, 0.0, 0.0, 0.0, 1.0]), RNG.normal(size=6) * np.repeat([0.3, 40.0], 3))
POSES = se3.displaced(np.tile(AT, (2, 3, 1)), RNG.normal(size=(2, 3, 6)) * np.repeat([0.05, 20.0], 3))
WEIGHTS = np.array([1.0, 0.25, 0.5, 1.0, 0.9, 0.1, 0.7, 1.0])
LIMIT = np.radians(70.0)


def by_inverses(order: list[int], pose: FloatArray, weights: FloatArray | None) -> tuple[float, FloatArray, FloatArray]:
    """The determinant at a pose, how fast each point moves by a unit of its own link, and the lengths."""
    base, body = BASE[order], BODY[order]
    M, lengths, points = link_rows(base, body, pose)
    if len(order) == 6:
        twists = np.linalg.inv(M).T  # (v; omega) of a point at the origin of the base
        return float(np.linalg.det(M)), np.linalg.norm(twists[:, :3] + np.cross(twists[:, 3:], points), axis=1), lengths
    arms = points - points.mean(axis=0)
    rim = rim_mm(body)
    J = np.hstack([M[:, :3], np.cross(arms, M[:, :3]) / rim])
    W = np.eye(len(order)) if weights is None else np.diag(weights)
    twists = np.linalg.solve(J.T @ W @ J, J.T @ W).T
    speeds = np.linalg.norm(twists[:, :3] + np.cross(twists[:, 3:] / rim, arms), axis=1)
    return float(np.linalg.det(J.T @ W @ J)), speeds, lengths


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4, 5], [1, 0, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5, 6, 7]], ids=["six", "mirrored", "eight"])
@pytest.mark.parametrize("weighted", [False, True])
def test_values_are_parts_of_what_is_at_the_start(order: list[int], weighted: bool) -> None:
    m, weights = len(order), WEIGHTS if weighted else None
    if weighted and m == 6:
        weights = None  # six links are met exactly, whatever they weigh
    start = by_inverses(order, AT, weights)[0]
    # the least determinant is of six links alone
    least = 0.4 * abs(start) if m == 6 else 0.0
    bounds = Bounds(BASE[order], BODY[order], AT, LIMIT, (300.0, 1900.0), least, weights=weights)
    found = bounds.values(POSES)
    sides = []
    for i in range(2):
        for k in range(3):
            det, speeds, lengths = by_inverses(order, POSES[i, k], weights)
            sides.append(np.sign(det))
            angles = det / start - np.cos(LIMIT) * abs(det) * speeds / abs(start)
            of_det = [det / start - 0.4] if m == 6 else []
            np.testing.assert_allclose(
                found[i, k], [*angles, *of_det, *(lengths - 300.0) / 1900.0, *(1900.0 - lengths) / 1900.0], rtol=1e-7
            )
            # where the determinant has the start's side an angle is kept as its cosine says
            np.testing.assert_array_equal(found[i, k, :m] > 0.0, (det / start > 0.0) & (1.0 / speeds > np.cos(LIMIT)))
    assert sides[0] == np.sign(start) * np.sign(found[0, 0, m] + 0.4 if m == 6 else 1.0)
    names = [f"pressure angle of link {i + 1}" for i in range(m)] + ["determinant"] * (m == 6)
    assert list(bounds.names) == names + [f"link {i + 1} {way}" for way in ("short", "long") for i in range(m)]
    np.testing.assert_array_equal(bounds.inside(POSES), (found > 0.0).all(axis=-1))


def test_a_limit_that_is_met_is_not_kept() -> None:
    """Lengths that are just the least, or the greatest."""
    lengths = by_inverses([0, 1, 2, 3, 4, 5], AT, None)[2]
    wide = (float(lengths.min()), float(lengths.max()))
    for limits, kept in (
        (wide, False),
        ((wide[0] - 1e-9, wide[1] + 1e-9), True),
        ((wide[0] - 1.0, wide[1]), False),
        ((wide[0], 1e4), False),
    ):
        assert bool(Bounds(BASE[:6], BODY[:6], AT, lengths_mm=limits).inside(AT)) == kept
    assert Bounds(BASE[:6], BODY[:6], AT).values(AT) == pytest.approx([1.0])
    assert Bounds(BASE[:6], BODY[:6], AT).names == ("singular",)
    assert Bounds(BASE, BODY, AT, lengths_mm=(1.0, 9e3), called=list("abcdefgh")).names[7:9] == ("h short", "a long")


def test_a_link_without_a_length_has_no_values() -> None:
    base, body, there = BASE[:6].copy(), BODY[:6].round(), np.array([70.0, -50.0, 800.0, 0.0, 0.0, 0.0, 1.0])
    base[2] = body[2] + there[:3]
    bounds = Bounds(base, body, AT, LIMIT, (1.0, 9e3))
    values = bounds.values(np.stack([there, AT]))
    assert np.isnan(values[0, :6]).all()
    assert np.isfinite(values[0, 6:]).all()
    assert np.isfinite(values[1]).all()
    assert bounds.inside(np.stack([there, POSES[0, 1]])).tolist()[0] is False


@pytest.mark.parametrize("m", [6, 8])
def test_rates_are_those_of_differences(m: int) -> None:
    bounds = Bounds(BASE[:m], BODY[:m], AT, LIMIT, (300.0, 1900.0))
    directions = np.vstack([np.diag(np.repeat([1e-3, 2.0], 3)), RNG.normal(size=(1, 6)) * np.repeat([0.01, 1.0], 3)])
    values, rates = bounds.with_rates(POSES, directions)
    np.testing.assert_array_equal(values, bounds.values(POSES))
    assert rates.shape == (2, 3, len(bounds.names), 7)
    for q, way in enumerate(directions):
        h = 0.2 / np.abs(way * np.repeat([rim_mm(BODY[:m]), 1.0], 3)).max()
        v = [bounds.values(se3.displaced(POSES, k * h * way)) for k in (-2, -1, 1, 2)]
        np.testing.assert_allclose(
            rates[..., q], (v[0] - 8.0 * v[1] + 8.0 * v[2] - v[3]) / (12.0 * h), rtol=1e-5, atol=1e-5 * np.abs(rates[..., q]).max()
        )
    still = bounds.with_rates(AT, np.zeros((1, 6)))[1]
    np.testing.assert_array_equal(still, 0.0)


def test_what_holds_nothing_has_no_bounds() -> None:
    hold = "bounds: the links do not fix the body at the initial pose"
    line = BODY.copy()
    line[:] = BODY[0] + np.arange(8.0)[:, None] * [30.0, 10.0, -20.0]
    nowhere = BASE.copy()
    nowhere[3] = link_rows(BASE, BODY, AT)[2][3]
    for base, body in ((BASE[:5], BODY[:5]), (BASE[:6], line[:6]), (BASE, line), (nowhere[:6], BODY[:6]), (nowhere, BODY)):
        with pytest.raises(StructureError, match=hold):
            Bounds(base, body, AT, LIMIT)
    assert Bounds(BASE, BODY, AT, LIMIT).inside(AT)
    assert Bounds(BASE, BODY, AT, lengths_mm=(1.0, 9e3)).inside(AT)
    for limit, least in ((None, 0.0), (LIMIT, 1.0)):
        with pytest.raises(
            StructureError, match="bounds: 8 links have no determinant and lose hold of the body on curves only: state a limit"
        ):
            Bounds(BASE, BODY, AT, limit, determinant=least)
    with pytest.raises(StructureError, match="8 links have no determinant"):
        Bounds(BASE, BODY, AT, lengths_mm=(1.0, 9e3), determinant=1.0)


@pytest.mark.parametrize(("lean", "sound"), [(0.5e-12, False), (2e-12, True)])
def test_six_links_hold_from_a_million_millionth_of_the_rows_on(lean: float, sound: bool) -> None:
    """The sixth link stands so much beside one that is the others' sum."""
    base, body = BASE[:6].copy(), BODY[:6].copy()
    body[5] = body[4]

    def part(off: float) -> float:
        base[5] = base[4] + 0.4 * (se3.apply(AT, body[4]) - base[4]) + off * np.array([0.48, -0.6, 0.64])
        M = link_rows(base, body, AT)[0]
        return abs(float(np.linalg.det(M))) / float(np.linalg.norm(M, axis=1).prod())

    off = lean / part(1.0)
    assert part(off) == pytest.approx(lean, rel=0.1)
    if sound:
        assert Bounds(base, body, AT).inside(AT)
    else:
        with pytest.raises(StructureError, match="do not fix"):
            Bounds(base, body, AT)


@pytest.mark.parametrize(("condition", "sound"), [(0.85e12, True), (1.15e12, False)])
def test_eight_links_hold_up_to_a_condition_of_a_million_millions(condition: float, sound: bool) -> None:
    """Points beside one line, about which the body turns: the condition of the normal equations goes by the square of how far."""
    side = RNG.normal(size=(8, 3))

    def beside(off: float) -> tuple[FloatArray, float]:
        body = np.arange(8.0)[:, None] * [30.0, 10.0, -20.0] + off * side
        M, _, points = link_rows(BASE, body, AT)
        J = np.hstack([M[:, :3], np.cross((points - points.mean(axis=0)) / rim_mm(body), M[:, :3])])
        return body, float(np.linalg.cond(J.T @ J))

    body, found = beside(np.sqrt(beside(1e-2)[1] / condition) * 1e-2)
    assert found == pytest.approx(condition, rel=0.05)
    if sound:
        assert Bounds(BASE, body, AT, LIMIT).values(AT).shape == (8,)
    else:
        with pytest.raises(StructureError, match="do not fix"):
            Bounds(BASE, body, AT, LIMIT)


def test_limits_of_every_orientation_stand_one_behind_the_other() -> None:
    turns = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.06, np.sqrt(1.0 - 0.0036)]])
    one, both = (Bounds(BASE, BODY, AT, LIMIT, (300.0, 1900.0), turns=t) for t in (None, turns))
    found = both.values(POSES)
    assert found.shape == (2, 3, 2 * len(one.names)) == (2, 3, len(both.names))
    np.testing.assert_allclose(found[..., : len(one.names)], one.values(POSES), rtol=1e-9, atol=1e-12)
    assert both.values(AT).shape == (len(both.names),)
