"""What is as likely as the attained cycles of a path, by the errors of each of its waves written out, and how errors move it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_paths import LINE, SQUARE, program_of, runs
from synthetic_trajectories import trajectory_of

from lmeasure.core import FloatArray
from lmeasure.iso9283 import CertificationSettings
from lmeasure.iso9283.attainment import attained
from lmeasure.iso9283.clauses.path import PathPart, tests as path_tests
from lmeasure.iso9283.figure import cosines, reduced
from lmeasure.trajectory import PoseErrors
from lmeasure.trajectory.time.stamps import sound

SIDED = 1.6448536
COMMANDED = Rotation.from_euler("xyz", [20.0, -35.0, 178.0], degrees=True)
ROUND = np.array([[-10.0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0], [0, -10, 0]])


def part_of(which: str, scale: float) -> tuple[PathPart, PoseErrors]:
    """Three cycles of a line or a square, that deviate and turn by waves, with errors of that scale of their own and in common."""
    rng = np.random.default_rng(4)
    way = np.arange(-10.0, 510.0 if which == "line" else 810.0, 1.0)
    if which == "line":
        ideal, path = way[:, None] * np.array([0.6, 0.8, 0.0]), LINE
    else:
        ideal = np.column_stack([np.interp(way, [-10.0, 200.0, 400.0, 600.0, 810.0], ROUND[:, i]) for i in range(3)])
        path = SQUARE | {"speed_mm_s": 500.0}
    places, turns = [], []
    for _ in range(3):
        phase, amount = 6.0 * rng.random(6), rng.normal(size=6)
        wave = amount * np.cos(way[:, None] / [150.0, 90.0, 120.0, 60.0, 200.0, 110.0] + phase)
        places.append(ideal + 0.1 * wave[:, :3] + 0.02 * rng.normal(size=(len(way), 3)))
        turns.append(1e-3 * wave[:, 3:] + 2e-4 * rng.normal(size=(len(way), 3)) + [2e-3, 0.0, 0.0])
    trajectory, windows = runs(way, places)
    vectors = (Rotation.from_rotvec(np.concatenate(turns)) * COMMANDED).as_rotvec()
    trajectory = trajectory_of(trajectory.time_s, trajectory.poses[:, :3], vectors)
    program = program_of(path | {"quaternion_xyzw": tuple(COMMANDED.as_quat())}, windows)
    stamps = sound(trajectory.time_s)
    crossed = attained(trajectory, program, CertificationSettings(planes=24), stamps, rig_angles=None).paths[which]
    # the noise is more than is stated: that would look like corners
    crossed = replace(crossed, hidden=None)
    k, units = crossed.time_s.size, np.repeat([3e-4, 0.03], 3)[:, None]
    own, local, shared = (scale * by * units * rng.normal(size=(k, 6, 2)) for by in (1.0, 0.3, 0.3))
    errors = PoseErrors(own, local, np.arange(k) % 7, shared)
    return PathPart(crossed, errors, "fanuc-wpr", stamps), errors


def whole(errors: PoseErrors, m: int, n: int) -> tuple[FloatArray, FloatArray]:
    """Covariances of what is new at every crossing, (m, 6, 6), the mean of the cycles', and of the mean of cycles by all that crossings
    have in common, (m, 6, m, 6)."""
    own = np.array([np.mean([errors.own[i * n + j] @ errors.own[i * n + j].T for j in range(n)], axis=0) for i in range(m)])
    common = np.zeros((m, 6, m, 6))
    for one in range(m * n):
        for other in range(m * n):
            alike = errors.place[one] == errors.place[other]
            both = errors.shared[one] @ errors.shared[other].T + alike * errors.local[one] @ errors.local[other].T
            common[one // n, :, other // n] += both / n**2
    return own, common


def likely(values: FloatArray, stretch: Any, by: FloatArray, own: FloatArray, common: FloatArray) -> FloatArray:
    """Values (q, n, c) as likely as those measured; by (q, c, m, 6): their derivatives by the errors at the planes."""
    n, along = values.shape[1], cosines(stretch)
    waves_by = np.einsum("pq,qcmi->pcmi", along, by)
    added = np.einsum("pcmi,mij,pcmj->pc", waves_by, own, waves_by)
    of_all = np.einsum("pcmi,minj,pcnj->pc", waves_by, common, waves_by)
    waves = np.einsum("pq,qnc->pnc", along, values)
    mean = waves.mean(axis=1, keepdims=True)
    out = reduced(mean, added / n + of_all, 1, 1.0) + reduced(waves - mean, added, n - 1, SIDED)
    return np.asarray(np.einsum("pq,pnc->qnc", along, out))


@pytest.mark.parametrize("scale", [0.3, 1.0])
@pytest.mark.parametrize("which", ["line", "square"])
def test_cycles_as_likely_as_those_measured(which: str, scale: float) -> None:
    """Of deviations across the path, of turns, of angles one by one and of speeds in the middle of its lines."""
    part, errors = part_of(which, scale)
    c = part.crossings
    m, n = c.time_s.shape
    own, common = whole(errors, m, n)
    measured, state = (part.state(np.zeros((m * n, 6)), reduced) for reduced in (False, True))
    assert measured.turn_deg is not None
    assert measured.angles_deg is not None
    assert state.turn_deg is not None
    assert state.angles_deg is not None
    across = np.array([np.eye(3) - np.outer(t, t) for t in c.tangent])
    deviation = np.array([[across[i] @ (c.attained[i, j, :3] - c.commanded[i]) for j in range(n)] for i in range(m)])
    turned = [[Rotation.from_quat(c.attained[i, j, 3:]) for j in range(n)] for i in range(m)]
    turns = np.degrees([[(t * COMMANDED.inv()).as_rotvec() for t in row] for row in turned])
    angles = np.array([[t.as_euler("xyz", degrees=True) - COMMANDED.as_euler("xyz", degrees=True) for t in row] for row in turned])
    angles -= 360.0 * np.rint(angles / 360.0)
    np.testing.assert_allclose(measured.position, deviation, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(part.positions, [c.attained[i, j, :3] for i in range(m) for j in range(n)])
    np.testing.assert_allclose(measured.turn_deg, turns, rtol=0, atol=1e-9)
    np.testing.assert_allclose(measured.angles_deg, angles, rtol=0, atol=1e-9)
    step = 1e-4
    sides = [[(Rotation.from_rotvec(s * step * a) * COMMANDED).as_euler("xyz", degrees=True) for s in (1.0, -1.0)] for a in np.eye(3)]
    rates = np.array([(there - back) / (2.0 * step) for there, back in sides]).T

    def at_each(to: FloatArray) -> FloatArray:
        """(m, c, m, 6) derivatives of what each plane's own errors alone move by (m, c, 6)."""
        out = np.zeros((m, to.shape[1], m, 6))
        out[np.arange(m), :, np.arange(m)] = to
        return out

    nothing = np.zeros((m, 3, 3))
    found = likely(deviation, c.stretch, at_each(np.concatenate([nothing, across], axis=2)), own, common)
    np.testing.assert_allclose(state.position, np.einsum("mij,mnj->mni", across, found), rtol=0, atol=1e-6)
    degrees = np.tile(np.degrees(np.eye(3)), (m, 1, 1))
    found = likely(turns, c.stretch, at_each(np.concatenate([degrees, nothing], axis=2)), own, common)
    np.testing.assert_allclose(state.turn_deg, found, rtol=0, atol=1e-6)
    found = likely(angles, c.stretch, at_each(np.concatenate([np.tile(rates, (m, 1, 1)), nothing], axis=2)), own, common)
    np.testing.assert_allclose(state.angles_deg, found, rtol=0, atol=1e-6)
    # speeds from plane to plane: a plane that is seen ahead is crossed earlier, by as much as the robot needs there
    pieces = [i for s in range(c.stretch.max() + 1) for i in np.flatnonzero((c.stretch[:-1] == s) & (c.stretch[1:] == s))]
    pieces = [i for i in pieces if i in part._middle]
    lasted = np.diff(c.time_s, axis=0)
    speed = np.array([c.speed_mm_s[:, i] for i in pieces])
    by = np.zeros((len(pieces), 1, m, 6))
    for q, i in enumerate(pieces):
        for plane, sign in ((i, -1.0), (i + 1, 1.0)):
            by[q, 0, plane, 3:] = sign * speed[q].mean() / lasted[i].mean() / c.pace_mm_s[plane].mean() * c.tangent[plane]
    found = likely((speed - speed.mean())[:, :, None], c.stretch[pieces], by, own, common)[:, :, 0]
    np.testing.assert_allclose(measured.speed_mm_s, speed.T, rtol=1e-12)
    np.testing.assert_allclose(state.speed_mm_s, (speed.mean() + found).T, rtol=0, atol=1e-5)


def test_errors_move_deviations_across_the_path_and_instants_along_it() -> None:
    part, _ = part_of("square", 1.0)
    c = part.crossings
    m, n = c.time_s.shape
    errors = 1e-6 * np.random.default_rng(8).normal(size=(2, m * n, 6))
    e = errors.reshape(2, m, n, 6)
    for reduced_too in (False, True):
        before, after = (part.state(x, reduced_too) for x in (np.zeros_like(errors), errors))
        assert before.angles_deg is not None
        assert before.turn_deg is not None
        assert after.angles_deg is not None
        assert after.turn_deg is not None
        along = (e[..., 3:] * c.tangent[:, None]).sum(axis=-1)
        np.testing.assert_allclose(after.position - before.position, e[..., 3:] - along[..., None] * c.tangent[:, None], rtol=0, atol=1e-12)
        np.testing.assert_allclose(after.turn_deg - before.turn_deg, np.degrees(e[..., :3]), rtol=0, atol=1e-10)
        turned = (Rotation.from_rotvec(e[..., :3].reshape(-1, 3)) * COMMANDED).as_euler("xyz", degrees=True)
        moved = turned.reshape(2, m, n, 3) - COMMANDED.as_euler("xyz", degrees=True)
        np.testing.assert_allclose(after.angles_deg - before.angles_deg, moved, rtol=0, atol=1e-8)
        # as far in less time
        earlier = np.diff(c.time_s - along / c.pace_mm_s, axis=1)
        faster = (np.diff(c.time_s, axis=0) / earlier)[:, part._middle]
        np.testing.assert_allclose(after.speed_mm_s / before.speed_mm_s, np.swapaxes(faster, 1, 2), rtol=1e-9)


@pytest.mark.parametrize("cycles", [1, 2])
@pytest.mark.parametrize("oriented", [True, False])
def test_a_path_has_figures_of_its_angles_where_it_has_an_orientation_and_of_scatter_from_two_cycles_on(
    cycles: int, oriented: bool
) -> None:
    way = np.arange(-10.0, 510.0, 2.0)
    trajectory, windows = runs(way, [way[:, None] * np.array([0.6, 0.8, 0.0])] * cycles)
    program = program_of(LINE | ({"quaternion_xyzw": (0.0, 0.0, 0.0, 1.0)} if oriented else {}), windows)
    given = attained(trajectory, program, CertificationSettings(angles="fanuc-wpr"), sound(trajectory.time_s), rig_angles=None)
    (test,) = path_tests(given)
    kinds = ["AT", "RT"][:cycles]
    expected = [f"{kind}_{part}" for kind in kinds for part in (("p", "a", "b", "c", "rot") if oriented else ("p",))]
    assert [figure.key.name for figure in test.figures()] == expected
