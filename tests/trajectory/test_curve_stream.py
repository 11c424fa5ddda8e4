"""Curves of runs that are still going on, against the truth and the curve of the whole run."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from test_curve import exact_run, truth_of

from lmeasure.core import FloatArray, TrajectoryError
from lmeasure.recording import Run
from lmeasure.trajectory import CurveStream, Instants, reconstruct_curve


def followed(stream: CurveStream, run: Run) -> tuple[list[Instants], FloatArray]:
    """Poses as they come, and the time of the last sample at each."""
    counts, found, now = run.passes[0], list[Instants](), list[float]()
    for time_s, recorded in zip(counts.time_s.tolist(), counts.recorded, strict=True):
        there = stream.push(time_s, recorded)
        if there is not None:
            found.append(there)
            now.append(time_s)
    last = stream.finish()
    assert last is not None
    return [*found, last], np.array(now)


@pytest.mark.parametrize(("name", "lags_s"), [("cell-run", (0.3, 1.2, 2.5)), ("swivel-run", (1.2, 2.5))])
def test_poses_come_with_the_lag_and_tend_to_those_of_the_whole_run(name: str, lags_s: tuple[float, ...]) -> None:
    run, truth = exact_run(name, zeroed=name == "cell-run"), truth_of(name)
    trajectory, curve = reconstruct_curve(run)
    off = []
    for lag_s in lags_s:
        stream = CurveStream(replace(run, passes=()), lag_s=lag_s, spacing_s=curve.spacing_s)
        found, now = followed(stream, run)
        times = np.concatenate([each.time_s for each in found])
        np.testing.assert_array_equal(times, truth[:, 0])
        for each, at in zip(found[1:], now[1:], strict=False):
            assert 0.75 * lag_s - 1e-9 < at - each.time_s[-1]
            assert at - each.time_s[0] < lag_s + 1e-9
        poses, u = np.concatenate([each.poses for each in found]), np.concatenate([each.u[:, 0] for each in found])
        error = poses[:, :3] - truth[:, 1:4]
        assert np.sqrt((error**2).sum(axis=1).mean()) < 0.006
        assert (np.abs(error) < 1.96 * u[:, 3:]).mean() > 0.9
        off.append(float(np.sqrt(((poses[:, :3] - trajectory.poses[:, :3]) ** 2).sum(axis=1).mean())))
    assert off[0] < 0.001
    assert all(longer < 0.7 * shorter for shorter, longer in pairwise(off))
    assert off[-1] < 1e-5


def test_the_velocity_of_a_stream_is_the_true_one() -> None:
    run, truth = exact_run("cell-run", zeroed=True), truth_of("cell-run")
    found, _ = followed(CurveStream(run, lag_s=0.3), run)
    velocity = np.concatenate([each.rates[:, 1, 3:] for each in found])[100:-100]
    true = np.gradient(truth[:, 1:4], truth[:, 0], axis=0)[100:-100]
    u = np.concatenate([each.u[:, 1, 3:] for each in found])[100:-100]
    assert np.sqrt(((velocity - true) ** 2).mean()) < 0.5
    assert (np.abs(velocity - true) < 3.0 * u).mean() > 0.95


def test_counts_that_do_not_fit_give_no_pose() -> None:
    """A counter that loses counts is contradicted by the others; a gap is bridged as long as its uncertainty is small."""
    run = exact_run("eight-run")
    recorded = run.passes[0].recorded.copy()
    recorded[1000:, 3] -= 15.0
    stream = CurveStream(run, lag_s=0.2)
    found, now = followed(stream, replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    first = int(np.searchsorted(now, 1.05))
    assert all(np.isfinite(each.poses).all() for each in found[: first - 1])
    assert all(np.isnan(each.poses).all() for each, at in zip(found, now, strict=False) if 1.05 < at < 1.3)
    run = exact_run("cell-run", zeroed=True)
    recorded = run.passes[0].recorded[:1600].copy()
    recorded[700:730] = recorded[1100:1500] = np.nan
    short = replace(run, passes=(replace(run.passes[0], time_s=run.passes[0].time_s[:1600], recorded=recorded),))
    poses = np.concatenate([each.poses for each in followed(CurveStream(run, lag_s=0.2), short)[0]])
    assert np.linalg.norm(poses[700:730, :3] - truth_of("cell-run")[700:730, 1:4], axis=1).max() < 0.05
    assert np.isnan(poses[1250:1350]).all()


def test_streams_that_cannot_be_are_refused_in_one_line() -> None:
    run = exact_run("cell-run", zeroed=True)
    with pytest.raises(TrajectoryError, match="the lag must be a positive time, not 0 s"):
        CurveStream(run, lag_s=0.0)
    with pytest.raises(TrajectoryError, match="the rig has 2 passes"):
        CurveStream(exact_run("three-drums-two-passes"))
    with pytest.raises(TrajectoryError, match="start"):
        CurveStream(replace(run, start=None))
    stream = CurveStream(run, lag_s=0.02)
    with pytest.raises(
        TrajectoryError, match=r"a lag of 0\.02 s is too short: it needs at least 8 intervals of knots, which are 8 ms apart"
    ):
        followed(stream, run)
    stream = CurveStream(run)
    stream.push(1.0, run.passes[0].recorded[0])
    with pytest.raises(TrajectoryError, match=r"sample at 1 s does not follow the last one at 1 s"):
        stream.push(1.0, run.passes[0].recorded[1])
