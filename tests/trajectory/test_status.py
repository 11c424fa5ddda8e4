"""Every sample has a status; what is not ok holds NaN and names its cable; what is ok is right."""

from dataclasses import replace

import numpy as np
import pytest
from cells import START, FloatArray, cell, motion, position_error, record, with_recorded
from scipy.spatial.transform import Rotation

from lmeasure.core import WORDS, GeometryError, Status, TrajectoryError
from lmeasure.recording import Run
from lmeasure.rig import Rig
from lmeasure.trajectory import Trajectory, reconstruct

N = 400


def statuses(trajectory: Trajectory) -> list[str]:
    return [WORDS[s] for s in trajectory.status]


def assert_not_ok_is_nan(trajectory: Trajectory) -> None:
    bad = trajectory.status != Status.OK
    assert np.isnan(trajectory.residual_mm).all(), "six cables have no residuals"
    for values in (trajectory.poses, trajectory.u, trajectory.worst_pressure_angle_deg):
        assert np.isnan(values[bad]).all()
        assert np.isfinite(values[~bad]).all()
    assert all(bool(cause) == b or str(cause).startswith("nearly singular") for cause, b in zip(trajectory.cause, bad, strict=True))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return cell()


@pytest.fixture(scope="module")
def run(rig: Rig) -> Run:
    return record(rig, *motion(N))


@pytest.fixture(scope="module")
def clean(run: Run) -> Trajectory:
    return reconstruct(run)


def test_a_gap_is_a_gap_and_the_rest_is_untouched(run: Run, clean: Trajectory) -> None:
    recorded = run.passes[0].recorded.copy()
    recorded[100:140, 2] = np.nan
    trajectory = reconstruct(with_recorded(run, recorded))
    assert statuses(trajectory) == ["gap" if 100 <= i < 140 else "ok" for i in range(N)]
    assert set(trajectory.cable[100:140]) == {"c3"}
    assert_not_ok_is_nan(trajectory)
    rest = np.r_[0:100, 140:N]
    np.testing.assert_allclose(trajectory.poses[rest], clean.poses[rest], atol=1e-9)


def test_a_jump_of_one_channel_holds_until_it_jumps_back(run: Run, clean: Trajectory) -> None:
    recorded = run.passes[0].recorded.copy()
    recorded[200:250, 4] += 50_000
    trajectory = reconstruct(with_recorded(run, recorded))
    assert statuses(trajectory) == ["jump" if 200 <= i < 250 else "ok" for i in range(N)]
    assert set(trajectory.cable[200:250]) == {"c5"}
    assert_not_ok_is_nan(trajectory)
    rest = np.r_[0:200, 250:N]
    np.testing.assert_allclose(trajectory.poses[rest], clean.poses[rest], atol=1e-9)


def test_a_jump_that_does_not_come_back_loses_the_rest(run: Run) -> None:
    recorded = run.passes[0].recorded.copy()
    recorded[300:, 1] -= 50_000
    trajectory = reconstruct(with_recorded(run, recorded))
    assert statuses(trajectory) == ["jump" if i == 300 else "origin_lost" if i > 300 else "ok" for i in range(N)]
    assert set(trajectory.cable[300:]) == {"c2"}


@pytest.mark.parametrize("stated", [True, False])
def test_sixteen_bits_wrap_within_the_stroke(stated: bool) -> None:
    times, poses = motion(1500, reach_mm=520.0, tilt_rad=0.1)
    wide = reconstruct(record(cell(32), times, poses))
    run = record(cell(16), times, poses)
    assert (np.abs(np.diff(run.passes[0].recorded, axis=0)) > 60_000).any()
    if not stated:
        run = Run(cell(None), run.start, run.passes, unstated="exact")
    narrow = reconstruct(run)
    assert set(statuses(narrow)) == {"ok"}
    np.testing.assert_array_equal(narrow.poses, wide.poses)
    assert any("16 bits" in note for note in map(str, narrow.notes)) is not stated


def turning(amplitude_rad: float, axis: tuple[float, float, float], n: int = 3000) -> tuple[FloatArray, FloatArray]:
    """Out to a rotation about the axis and back, while moving on by 30 mm/s."""
    t = np.arange(n) / 1000.0
    turn = amplitude_rad * np.sin(np.pi * t / t[-1])
    poses = np.column_stack([30.0 * t, 0 * t, 0 * t, Rotation.from_rotvec(np.outer(turn, axis)).as_quat()])
    return t, poses


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)])
def test_through_a_singular_pose_no_wrong_assembly_is_called_ok(rig: Rig, axis: tuple[float, float, float]) -> None:
    times, poses = turning(1.5, axis)
    rows = rig.cable_rows()
    sides = np.array([np.linalg.det(screw_rows) for screw_rows in _rows(rows, poses)])
    assert sides.min() < 0 < sides.max()
    trajectory = reconstruct(record(rig, times, poses))
    ok = trajectory.status == Status.OK
    first = int(np.argmax(~ok))
    assert 500 < first <= int(np.argmax(sides * sides[0] < 0))
    assert not ok[first:].any()
    assert set(statuses(trajectory)[first:]) <= {"singular", "other_assembly"}
    assert statuses(trajectory)[-1] == "other_assembly"
    assert_not_ok_is_nan(trajectory)
    # up to there every pose is the true one, within what it states
    assert (position_error(trajectory.poses[ok], poses[ok]) < 5 * np.linalg.norm(trajectory.u[ok, :3], axis=1)).all()


def _rows(rows: FloatArray, poses: FloatArray) -> list[FloatArray]:
    from lmeasure.kernels import span_rows

    return [np.asarray(span_rows(rows, pose)) for pose in poses]


def test_lengths_of_no_pose_do_not_converge_and_the_run_goes_on(run: Run, clean: Trajectory) -> None:
    recorded = run.passes[0].recorded.copy()
    # 19 m/s is a possible speed of a cable, and two at once are no counter's fault
    ramp = np.concatenate([np.arange(1, 101), np.arange(99, 0, -1)]) * -1500.0
    for channel in (0, 4):
        recorded[150:349, channel] += ramp
    trajectory = reconstruct(with_recorded(run, recorded))
    assert statuses(trajectory)[:150] == ["ok"] * 150
    assert statuses(trajectory)[349:] == ["ok"] * (N - 349)
    assert "not_converged" in statuses(trajectory) or "singular" in statuses(trajectory)
    assert_not_ok_is_nan(trajectory)
    np.testing.assert_allclose(trajectory.poses[349:], clean.poses[349:], atol=1e-9)


def test_a_singular_start_is_refused() -> None:
    # cables that all meet one axis see no rotation about it
    tool = {"P1": [0.0, 150.0, 0.0], "P2": [-130.0, -75.0, 0.0], "P3": [130.0, -75.0, 0.0]}
    points = []
    for point in cell().to_dict()["observation_point"]:
        x, y, _ = tool[{"B1": "P1", "B2": "P1", "B3": "P2", "B4": "P2", "B5": "P3", "B6": "P3"}[point["name"]]]
        k, z = (6.0, 500.0) if point["name"] in {"B1", "B3", "B5"} else (4.0, -700.0)
        points.append(point | {"position_mm": [k * x, k * y, z], "pulley_radius_mm": 0.0})
    rig = cell(observation_point=points, tool=tool)
    with pytest.raises(TrajectoryError, match=r"singular .*. Not determined: a turn about the axis through .* mm along \(.*1\.000\)"):
        reconstruct(record(rig, np.arange(3.0), np.tile(START, (3, 1))))


def test_a_start_at_which_a_cable_cannot_run_is_refused(rig: Rig, run: Run) -> None:
    start = np.r_[np.array(rig.point("B1").position_mm) - np.array(rig.tool["P1"]) + 1e-3, START[3:]]
    with pytest.raises(GeometryError, match="c1"):
        reconstruct(Run(rig, start, run.passes, unstated="exact"))


def test_a_start_near_a_singular_pose_is_said(rig: Rig) -> None:
    start = np.r_[0.0, 0.0, 0.0, Rotation.from_rotvec([0.0, 0.0, 1.38]).as_quat()]
    trajectory = reconstruct(record(rig, np.arange(3) / 1000.0, np.tile(start, (3, 1)), start))
    assert any("may be in another assembly" in note for note in map(str, trajectory.notes))
    assert not any("assembly" in note for note in map(str, reconstruct(record(rig, *motion(3))).notes))


def test_a_start_whose_uncertainty_reaches_a_singular_pose_is_refused(rig: Rig) -> None:
    start = np.r_[0.0, 0.0, 0.0, Rotation.from_rotvec([0.0, 0.0, 1.38]).as_quat()]
    run = record(rig, np.arange(3) / 1000.0, np.tile(start, (3, 1)), start)
    # some 0.2 rad from there the determinant of the rows changes its sign
    assert (reconstruct(replace(run, u_start=(0.1, 0.001))).status == Status.OK).all()
    with pytest.raises(
        TrajectoryError, match=r"start: its uncertainty reaches a singular pose .*poorly determined: a turn about .*cannot be determined"
    ):
        reconstruct(replace(run, u_start=(0.1, 0.3)))
    assert (reconstruct(replace(record(rig, *motion(3)), u_start=(1.0, 0.02))).status == Status.OK).all()
