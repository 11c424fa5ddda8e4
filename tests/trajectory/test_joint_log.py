"""A robot's own log as a prior of the shape: it helps where it is right, and what it does not show is measured as without it."""

from dataclasses import replace

import numpy as np
import pytest
from moving_robot import Instrument, Motion, Shaken, Waves, errors, logged
from test_curve import ORIGIN, exact_run

from lmeasure.core import FloatArray, TrajectoryError
from lmeasure.recording import Counts, Run
from lmeasure.trajectory import JointLog, reconstruct_curve

LASTS_S = 3.0
AT = np.linspace(0.1, LASTS_S - 0.1, 600)


def run_of(motion: Motion) -> Run:
    instrument, time_s = Instrument("cell-run"), np.arange(int(LASTS_S * 250.0)) / 250.0
    recorded = instrument.recorded(motion, np.tile(time_s[:, None], (1, len(instrument.channels))))
    return replace(exact_run("cell-run", zeroed=True), passes=(Counts(time_s, instrument.channels, recorded),), start=ORIGIN)


def rms_um(error: FloatArray) -> float:
    return 1e3 * float(np.sqrt((error[:, 3:] ** 2).sum(axis=1).mean()))


def test_a_log_that_is_right_helps_and_one_that_scatters_is_not_used() -> None:
    motion = Waves(np.random.default_rng(3), LASTS_S)
    run = run_of(motion)
    _, alone = reconstruct_curve(run)
    trajectory, curve = reconstruct_curve(run, joints=JointLog(*logged(motion, LASTS_S, 0.0137)))
    assert trajectory.notes[-1].code == "curve.log_used"
    assert trajectory.notes[-1].values["late_ms"] == pytest.approx(13.7, abs=0.02)
    error = errors(motion, AT, curve.at(AT, rates=0))[0]
    assert rms_um(error) < 0.75 * rms_um(errors(motion, AT, alone.at(AT, rates=0))[0])
    assert (np.abs(error) < 1.96 * curve.at(AT, rates=0).u[:, 0]).mean() > 0.9
    trajectory, curve = reconstruct_curve(run, joints=JointLog(*logged(motion, LASTS_S, -0.3, 0.05)))
    assert trajectory.notes[-1].code == "curve.log_unused"
    np.testing.assert_array_equal(curve.poses(AT), alone.poses(AT))


def test_a_log_never_hides_what_the_robot_does_besides() -> None:
    """A bump of 50 um, and a slow sag with a vibration, that the encoders of the joints do not see."""

    def bump(t: FloatArray) -> FloatArray:
        return np.asarray(0.05 * np.exp(-0.5 * ((t - 1.5) / 0.02) ** 2))

    def sag(t: FloatArray) -> FloatArray:
        return np.asarray(0.5 * np.sin(1.4 * np.pi * t) + 0.02 * np.sin(34.0 * np.pi * t))

    shown = Waves(np.random.default_rng(3), LASTS_S)
    for by in (bump, sag):
        motion = Shaken(shown, by)
        curve = reconstruct_curve(run_of(motion), joints=JointLog(*logged(shown, LASTS_S, 0.02)))[1]
        there = curve.at(AT, rates=0)
        error = errors(motion, AT, there)[0]
        assert (np.abs(error) < 1.96 * there.u[:, 0]).mean() > 0.9
        assert rms_um(error) < 3.0
        peak = np.abs(AT - 1.5) < 0.05
        assert np.abs(error[peak, 3]).max() < 4.0 * there.u[peak, 0, 3].max() < 0.02


def test_logs_of_another_motion_are_refused_in_one_line() -> None:
    motion, other = (Waves(np.random.default_rng(seed), LASTS_S) for seed in (3, 4))
    run = run_of(motion)
    with pytest.raises(TrajectoryError, match="it is another motion, another robot, or its clock differs by more than a second"):
        reconstruct_curve(run, joints=JointLog(*logged(other, LASTS_S, 0.0)))
    with pytest.raises(TrajectoryError, match="the log and the run have no motion in common"):
        reconstruct_curve(run, joints=JointLog(*logged(motion, LASTS_S, 100.0)))
    log = JointLog(*logged(motion, LASTS_S, 0.0))
    with pytest.raises(TrajectoryError, match="a joint log needs at least 8 rows of increasing times"):
        JointLog(log.time_s[::-1], log.poses)
