"""What is as likely as the attained cycles of a pose, against the rule written out for each of them, and how errors move it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, IntArray
from lmeasure.iso9283.clauses.pose import PosePart, of_rests
from lmeasure.trajectory import PoseErrors
from lmeasure.trajectory.motion.vibration import Swing, Vibration

SIDED = 1.6448536
"""Standard deviations of a normal law above which 5 % lie."""
COMMANDED = Rotation.from_euler("xyz", [10.0, 40.0, -175.0], degrees=True)
PLACE = np.array([100.0, -50.0, 30.0])


def law_of(errors: PoseErrors, i: int, j: int, places: set[int]) -> FloatArray:
    """(6, 6) covariance of the errors that two cycles have in common by standing at one of these places."""
    alike = errors.place[i] == errors.place[j] and int(errors.place[i]) in places
    return np.asarray(errors.local[i] @ errors.local[j].T * alike)


def mean_of(errors: PoseErrors, members: list[int], places: set[int], *, shared: bool) -> FloatArray:
    """(6, 6) covariance of the mean error of some cycles, by places and by what the run shares, independent ones left out."""
    total = sum(law_of(errors, i, j, places) + shared * errors.shared[i] @ errors.shared[j].T for i in members for j in members)
    return np.asarray(total) / len(members) ** 2


def shortened(vector: FloatArray, law: FloatArray) -> FloatArray:
    """The least vector that errors make as long as this one once in twenty times, along it."""
    added, axes = np.trace(law), len(vector)
    least = np.sqrt(max(vector @ vector - (1.0 - 1.0 / axes) * added, 0.0)) - SIDED * np.sqrt(added)
    return np.asarray(max(least, 0.0) / np.sqrt(vector @ vector) * vector)


def repeatability(points: FloatArray) -> float:
    away = np.linalg.norm(points - points.mean(axis=0), axis=1)
    return float(away.mean() + 3.0 * away.std(ddof=1))


def likely(values: FloatArray, groups: IntArray, one: FloatArray, mean: FloatArray, apart: list[FloatArray]) -> FloatArray:
    """Deviations (n, d) as likely as those measured: one, mean, apart: laws of a single error, of the mean and of groups' means."""
    n, d = values.shape
    members = [np.flatnonzero(groups == g) for g in range(len(apart))]
    centre = values.mean(axis=0)
    out = np.tile(shortened(centre, mean), (n, 1))
    away = np.array([values[i] - values[members[groups[i]]].mean(axis=0) for i in range(n)])
    if len(members) > 1:
        for inside, law in zip(members, apart, strict=True):
            out[inside] += shortened(values[inside].mean(axis=0) - centre, law)
    freedom = n - len(members)
    square, added = float((away**2).sum()) / max(freedom, 1), float(np.trace(one))
    # of one that errs along few axes a mean square is known by fewer
    known = max(freedom, 1) * added**2 / np.trace(one @ one)
    least = square / (1.0 + SIDED * np.sqrt(2.0 / known))
    less = np.sqrt(max(least - added, 0.0) / square) if square else 0.0
    if len(members) == 1 or min(map(len, members)) == 1:
        return np.asarray(out + less * away)
    # the mean square of errors E and robot S is known to 2 tr E^2 + 4 tr(E S), a repeatability to half as much of itself
    of_robot = max(square - added, 0.0) / d * np.eye(d)
    varies = [np.trace(2.0 * one @ one + 4.0 * one @ of_robot) / square**2 / 4.0 / (len(inside) - 1) for inside in members]
    sizes = np.array([repeatability(away[inside]) for inside in members])
    differ = sizes - sizes.mean()
    added = sizes.mean() ** 2 * sum(varies)
    axes = len(members) - 1
    kept = np.sqrt(max(differ @ differ - (1.0 - 1.0 / axes) * added, 0.0)) - SIDED * np.sqrt(added)
    wanted = less * sizes.mean() + max(kept, 0.0) / np.linalg.norm(differ) * differ
    return np.asarray(out + (np.maximum(wanted, 0.0) / sizes)[groups, None] * away)


def rates_at(rotation: Rotation) -> FloatArray:
    """(3, 3) degrees by which W, P, R change per radian about the base axes."""
    step = 1e-4
    sides = [[(Rotation.from_rotvec(s * step * a) * rotation).as_euler("xyz", degrees=True) for s in (1.0, -1.0)] for a in np.eye(3)]
    return np.array([(there - back) / (2.0 * step) for there, back in sides]).T


GROUPED = {
    "all alike": [0] * 6, "two directions": [0, 1, 0, 1, 1, 0, 1, 0], "three of them, unlike in number": [0, 0, 1, 2, 2, 1, 2, 0, 2],
    "one alone": [0, 0, 1, 0], "each alone": [0, 1, 2],
}  # fmt: skip


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("name", GROUPED)
def test_cycles_as_likely_as_those_measured(name: str, scale: float) -> None:
    """Of positions, of rotation vectors and of angles one by one; scale: of errors, beside the scatter of cycles. Some groups stand at
    places that others stand at too, which sets them not apart."""
    rng, groups = np.random.default_rng(len(name)), np.array(GROUPED[name])
    n = len(groups)
    place = np.where(rng.uniform(size=n) < 0.3, 5, groups)
    units = np.repeat([1e-3, 0.1], 3)[:, None]
    own, local, shared = (scale * part * units * rng.normal(size=(n, 6, 2)) for part in (0.3, 0.2, 0.1))
    errors = PoseErrors(own, local, place, shared)
    offset = 0.4 * rng.normal(size=(groups.max() + 1, 6)) * units[:, 0]
    delta = offset[groups] + 0.3 * rng.normal(size=(n, 6)) * units[:, 0] + np.array([4e-3, 0.0, -2e-3, 0.5, 0.0, 0.2])
    attained = Rotation.from_rotvec(delta[:, :3]) * COMMANDED
    pose: Any = SimpleNamespace(
        commanded=np.r_[PLACE, COMMANDED.as_quat()], poses=np.column_stack([PLACE + delta[:, 3:], attained.as_quat()])
    )
    part = PosePart(pose, errors, "fanuc-wpr", groups)
    everyone, places = list(range(n)), set(place.tolist())
    one = np.mean([own[i] @ own[i].T for i in everyone], axis=0)
    laws = [one, mean_of(errors, everyone, places, shared=True) + one / n]
    for g in range(groups.max() + 1):
        members = np.flatnonzero(groups == g).tolist()
        only = places - {int(place[i]) for i in everyone if i not in members}
        laws.append(mean_of(errors, members, only, shared=False) + one / len(members))

    def expected(values: FloatArray, to: FloatArray) -> FloatArray:
        one, mean, *apart = [to @ law @ to.T for law in laws]
        return likely(values, groups, one, mean, apart)

    measured, state = (part.state(np.zeros((n, 6)), reduced) for reduced in (False, True))
    angles = attained.as_euler("xyz", degrees=True) - COMMANDED.as_euler("xyz", degrees=True)
    angles -= 360.0 * np.rint(angles / 360.0)
    turns = np.degrees(delta[:, :3])
    assert measured.angles_deg is not None
    assert measured.turn_deg is not None
    assert state.angles_deg is not None
    assert state.turn_deg is not None
    for position in (measured.position, part.positions):
        np.testing.assert_allclose(position, PLACE + delta[:, 3:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(measured.turn_deg, turns, rtol=0, atol=1e-9)
    np.testing.assert_allclose(measured.angles_deg, angles, rtol=0, atol=1e-9)
    nothing = np.zeros((3, 3))
    np.testing.assert_allclose(state.position, PLACE + expected(delta[:, 3:], np.hstack([nothing, np.eye(3)])), rtol=0, atol=1e-6)
    np.testing.assert_allclose(state.turn_deg, expected(turns, np.hstack([np.degrees(np.eye(3)), nothing])), rtol=0, atol=1e-6)
    rates = np.hstack([rates_at(attained.mean()), nothing])
    for axis in range(3):
        found = expected(angles[:, axis : axis + 1], rates[axis : axis + 1])
        np.testing.assert_allclose(state.angles_deg[:, axis], found[:, 0], rtol=0, atol=1e-6)
    # errors move all of them as they turn and shift what is attained
    moved = rng.normal(size=(2, n, 6)) * 1e-6
    for reduced in (False, True):
        before, after = (np.broadcast_arrays(*vars(part.state(e, reduced)).values()) for e in (np.zeros_like(moved), moved))
        shift, turned, twist = (b - a for a, b in zip(before, after, strict=True))
        np.testing.assert_allclose(shift, moved[..., 3:], rtol=0, atol=1e-12)
        np.testing.assert_allclose(turned, moved[..., :3] @ rates_at(attained.mean()).T, rtol=0, atol=1e-9)
        np.testing.assert_allclose(twist, np.degrees(moved[..., :3]), rtol=0, atol=1e-10)


def test_where_the_orientation_is_not_measured_there_is_none() -> None:
    """Of a cycle alone as of several; positions are what they were."""
    for n in (1, 4):
        places = PLACE + np.random.default_rng(3).normal(size=(n, 3))
        pose: Any = SimpleNamespace(commanded=np.r_[PLACE, COMMANDED.as_quat()], poses=np.column_stack([places, np.full((n, 4), np.nan)]))
        part = PosePart(pose, PoseErrors.of(np.zeros((n, 6, 1)), np.zeros((n, 6, 0))), "fanuc-wpr", np.zeros(n, np.int64))
        for reduced in (False, True):
            state = part.state(np.zeros((n, 6)), reduced)
            assert (state.angles_deg, state.turn_deg) == (None, None)
            np.testing.assert_allclose(state.position.mean(axis=0), places.mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize(("scatter", "common"), [(1.0, 1.0), (0.5, 1.0), (1.01, 0.99), (20.0, 0.0)])
def test_rests_that_only_swing_apart_are_rounded_alike(scatter: float, common: float) -> None:
    """What means of dwells scatter by because the robot swings, 0.3 counts here, is not where it rests; scatter: times as much."""
    count, n = 0.02, 5
    along = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    errors = PoseErrors.of(np.tile(count / np.sqrt(12.0) * along, (n, 1, 1)), np.zeros((n, 6, 0)), rounded=True)
    still, swing = Swing(np.zeros((9, 6)), np.zeros((6, 6)), np.zeros(6)), (0.3 * count) ** 2 * along
    pose: Any = SimpleNamespace(
        scatter_within=lambda groups: scatter * swing, vibration=Vibration((still,) * n, swing), readings=np.full(n, 9)
    )
    found = of_rests(errors, pose, np.zeros(n, np.int64))
    of_rounding = found.covariance_of(np.array([[1.0, -1.0, 0.0, 0.0, 0.0]]))[0, 3, 3] - 2.0 * swing[3, 3]
    assert of_rounding == pytest.approx(2.0 * count**2 / 12.0, rel=1e-6)
    assert np.square(found.local[:, 3, :6]).sum(axis=1) * 12.0 / count**2 == pytest.approx(np.full(n, common), abs=0.05)
