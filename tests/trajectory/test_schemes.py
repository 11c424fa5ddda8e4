"""Cable schemes besides six cables to a body: more of them, fewer with a constraint, several to one point."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cells import PAIRS, POINTS, START, FloatArray, cell, motion, observation_point, position_error, record, rotation_error, with_recorded
from scipy.spatial.transform import Rotation

from lmeasure.core import WORDS, RigError, Status
from lmeasure.recording import Run
from lmeasure.rig import Rig
from lmeasure.trajectory import read_trajectory, reconstruct, write_trajectory

N = 300
MORE = {"B7": (-900.0, -700.0, 400.0), "B8": (-300.0, 1200.0, -300.0)}
EXACT_MM, EXACT_RAD = 1e-9, 1e-12


def rig_of(pairs: list[tuple[str, str]], **changes: Any) -> Rig:
    places = POINTS | MORE
    return cell(
        observation_point=[observation_point(b, places[b]) for b in dict(pairs)],
        cable=[{"name": f"c{i}", "channel": f"ch{i}", "from": b, "to": p} for i, (b, p) in enumerate(pairs, 1)],
        **changes,
    )


SEVEN = [*PAIRS, ("B7", "P1")]
EIGHT = [*SEVEN, ("B8", "P2")]


def statuses(status: Any) -> set[str]:
    return {WORDS[s] for s in status}


@pytest.mark.parametrize("pairs", [SEVEN, EIGHT])
def test_more_than_six_cables_are_exact_too_and_state_what_they_scatter_by(pairs: list[tuple[str, str]]) -> None:
    rig = rig_of(pairs)
    times, poses = motion(N)
    exact = reconstruct(record(rig, times, poses, exact=True))
    assert statuses(exact.status) == {"ok"}
    assert position_error(exact.poses, poses).max() < EXACT_MM
    assert rotation_error(exact.poses, poses).max() < EXACT_RAD
    counted = reconstruct(record(rig, *motion(3000, rate_hz=20.0)))
    six = reconstruct(record(cell(), *motion(3000, rate_hz=20.0)))
    # more cables, less uncertainty; errors of the stated size; residuals as many as there are cables too many
    assert (np.nanmean(counted.u, axis=0) < np.nanmean(six.u, axis=0)).all()
    error = position_error(counted.poses, motion(3000, rate_hz=20.0)[1])
    assert np.mean(error**2) == pytest.approx(np.mean((counted.u[:, :3] ** 2).sum(axis=1)), rel=0.1)
    assert counted.chi_squared is not None
    assert counted.chi_squared.mean() == pytest.approx(len(pairs) - 6, rel=0.1)


def test_a_cable_that_does_not_follow_is_named_and_left_out() -> None:
    run = record(rig_of(EIGHT), *motion(N))
    recorded = run.passes[0].recorded.copy()
    # so gently that its own motion does not show it
    recorded[50:250, 3] -= (400.0 * np.sin(np.pi * np.arange(200) / 200) ** 2).round()
    trajectory = reconstruct(with_recorded(run, recorded))
    assert statuses(trajectory.status) == {"ok"}
    assert set(trajectory.cable[60:240]) == {"c4"}
    determined = re.search(
        r"differs from the other cables by up to (\S+) mm \(standard uncertainty (\S+) mm\), and is not used", str(trajectory.cause[170])
    )
    assert determined is not None, trajectory.cause[170]
    assert abs(abs(float(determined[1])) - 400.0 * 0.012) < 4.0 * float(determined[2]) + 0.005
    assert 0.001 < float(determined[2]) < 0.1
    assert any("cable c4 differs from the other cables" in note for note in map(str, trajectory.notes))
    assert set(trajectory.cable[:50]) | set(trajectory.cable[260:]) == {""}
    assert position_error(trajectory.poses, motion(N)[1]).max() < 0.02


def test_with_one_cable_too_many_a_contradiction_is_seen_but_not_named() -> None:
    run = record(rig_of(SEVEN), *motion(N))
    recorded = run.passes[0].recorded.copy()
    recorded[50:250, 3] -= (400.0 * np.sin(np.pi * np.arange(200) / 200) ** 2).round()
    trajectory = reconstruct(with_recorded(run, recorded))
    bad = trajectory.status == Status.INCONSISTENT
    assert statuses(trajectory.status) == {"ok", "inconsistent"}
    assert bad[60:240].all()
    assert not bad[:50].any()
    assert not bad[270:].any()
    assert np.isnan(trajectory.poses[bad]).all()
    assert set(trajectory.cable) == {""}
    assert set(map(str, trajectory.cause[bad])) == {"the cables contradict each other. The wrong one cannot be determined"}
    assert position_error(trajectory.poses[~bad], motion(N)[1][~bad]).max() < 0.02


def test_with_cables_to_spare_a_gap_of_one_is_bridged_and_said() -> None:
    run = record(rig_of(SEVEN), *motion(N))
    recorded = run.passes[0].recorded.copy()
    recorded[50:80, 6] = np.nan
    recorded[200:220, 2] += 40_000
    recorded[250:260, :2] = np.nan
    trajectory = reconstruct(with_recorded(run, recorded))
    assert [WORDS[s] for s in trajectory.status] == ["gap" if 250 <= i < 260 else "ok" for i in range(N)]
    assert set(trajectory.cable[50:80]) == {"c7"}
    assert set(trajectory.cable[200:220]) == {"c3"}
    assert str(trajectory.cause[60]) == "without it: channel ch7 has no count"
    ok = trajectory.status == Status.OK
    assert position_error(trajectory.poses[ok], motion(N)[1][ok]).max() < 0.03


@pytest.mark.parametrize("points", [["B1", "B2", "B4"], ["B1", "B2", "B3", "B4"]])
def test_cables_to_one_point_measure_its_position_and_say_so(points: list[str], tmp_path: Path) -> None:
    rig = rig_of([(b, "P1") for b in points])
    times, poses = motion(N)
    place = poses[:, :3] + Rotation.from_quat(poses[:, 3:]).apply(rig.tool["P1"])
    trajectory = reconstruct(record(rig, times, poses, exact=True))
    assert statuses(trajectory.status) == {"ok"}
    assert np.abs(trajectory.poses[:, :3] - place).max() < EXACT_MM
    assert np.isnan(trajectory.poses[:, 3:]).all()
    assert np.isnan(trajectory.u[:, 3:]).all()
    assert np.isfinite(trajectory.u[:, :3]).all()
    assert set(map(str, trajectory.cause)) == {"orientation not measured"}
    assert any("P1" in note for note in map(str, trajectory.notes))
    for name in ("a.csv", "a.parquet"):
        write_trajectory(tmp_path / name, trajectory)
        again = read_trajectory(tmp_path / name)
        np.testing.assert_array_equal(again.poses, trajectory.poses)
        np.testing.assert_array_equal(again.u, trajectory.u)
    assert pd.read_parquet(tmp_path / "a.parquet")["qx"].isna().all()
    assert trajectory.summary()


def planar(n: int) -> tuple[FloatArray, FloatArray]:
    times, poses = motion(n)
    turn = Rotation.from_rotvec(np.outer(0.3 * np.sin(2 * times), [0, 0, 1]))
    return times, np.column_stack([poses[:, :2], np.zeros(n), turn.as_quat()])


def upright(n: int) -> tuple[FloatArray, FloatArray]:
    times, poses = planar(n)
    poses[:, 2] = 80 * np.sin(3 * times)
    return times, poses


@pytest.mark.parametrize(
    ("cables", "constraint", "path"),
    [(3, "planar", planar), (4, "planar", planar), (4, "vertical-axis", upright), (5, "vertical-axis", upright)],
)
def test_a_constraint_takes_the_place_of_cables(cables: int, constraint: str, path: Any) -> None:
    pairs = [("B1", "P1"), ("B2", "P2"), ("B4", "P3"), ("B6", "P1"), ("B3", "P2")][:cables]
    times, poses = path(N)
    start = np.r_[0.0, 0.0, 0.0, Rotation.from_rotvec([0.0, 0.0, 0.0]).as_quat()]
    stated = rig_of(pairs, constraint=constraint)
    run = record(stated, times, poses, start, exact=True)
    trajectory = reconstruct(run)
    assert statuses(trajectory.status) == {"ok"}
    assert position_error(trajectory.poses, poses).max() < EXACT_MM
    assert rotation_error(trajectory.poses, poses).max() < EXACT_RAD
    assert (trajectory.u[:, 3:5] == 0).all()
    assert (trajectory.u[:, 5] > 0).all()
    assert any("taken as exact" in note for note in map(str, trajectory.notes))
    given = reconstruct(Run(rig_of(pairs), run.start, run.passes, unstated="exact"), constraint)
    np.testing.assert_array_equal(given.poses, trajectory.poses)


@pytest.mark.parametrize(("cables", "missing"), [(5, 1), (4, 2)])
def test_too_few_cables_are_refused_with_the_freedoms_they_leave(cables: int, missing: int) -> None:
    rig = rig_of(list(PAIRS[:cables]))
    with pytest.raises(RigError, match=f"leaves {missing} of six freedoms unmeasured, at the start a (turn|shift)") as error:
        reconstruct(record(rig, *motion(3)))
    assert "\n" not in str(error.value)
    assert "vertical-axis" in str(error.value)


def test_too_few_cables_even_for_what_is_free() -> None:
    with pytest.raises(RigError, match="needs at least 3"):
        reconstruct(record(rig_of([("B1", "P1"), ("B2", "P1")]), *motion(3)))
    with pytest.raises(RigError, match="leaves 4 freedoms"):
        reconstruct(record(rig_of(list(PAIRS[:3]), constraint="vertical-axis"), *motion(3)))


def test_the_singular_pose_of_a_planar_stage_is_not_passed_silently() -> None:
    """Three cables in the plane: when all pass through one point, the turn about it is lost."""
    pairs = [("B1", "P1"), ("B2", "P2"), ("B4", "P3")]
    times = np.arange(1500) / 1000.0
    poses = np.column_stack([np.zeros((1500, 3)), Rotation.from_rotvec(np.outer(2.5 * times / 1.5, [0, 0, 1])).as_quat()])
    trajectory = reconstruct(record(rig_of(pairs, constraint="planar"), times, poses, START))
    ok = trajectory.status == Status.OK
    assert not ok.all()
    assert not ok[int(np.argmax(~ok)) :].any()
    assert (position_error(trajectory.poses[ok], poses[ok]) < 6 * np.linalg.norm(trajectory.u[ok, :3], axis=1) + 1e-3).all()
