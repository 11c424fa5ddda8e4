"""The first stages of every demo: reference poses counted over the bus, and the rig calibrated from them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure.acquisition import record_feed
from lmeasure.calibration import Calibration, calibrate, read_campaign
from lmeasure.core import FloatArray, se3
from lmeasure.recording import Run
from lmeasure.rig import Rig
from lmeasure.robots import Performance
from lmeasure.simulation import (
    Leg,
    SimulatedCampaign,
    SimulatedRun,
    campaign_at,
    reference_poses,
    simulate_run,
    smooth_path,
    write_campaign,
)
from lmeasure.text import of_terminal

DWELL_S = 0.2
REFERENCE_RATE_HZ = 100.0
SPEED_MM_S = 800.0


def count_at_stops(rig: Rig, stops: FloatArray, rng: np.random.Generator, progress: Callable[[int, int], None] | None = None) -> FloatArray:
    """(n, m) recorded counts of pass 1 at (n, 7) poses that a robot drives to and rests at, through the bus; zeroed at the first."""
    legs = [Leg(pose, SPEED_MM_S, 1.0, DWELL_S) for pose in stops]
    time_s, poses = smooth_path(stops[0], legs, REFERENCE_RATE_HZ)
    simulated = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=rng)
    counts = record_feed(rig, simulated.run.passes[0], progress=progress).counts
    resting = [int(np.flatnonzero((np.abs(poses - pose) < 1e-9).all(axis=1))[-1]) for pose in stops]
    return counts.recorded[resting]


def record_motion(simulated: SimulatedRun, progress: Callable[[int, int], None] | None = None) -> Run:
    """The simulated run as it arrives on the other side of the bus, pass by pass."""
    passes = (record_feed(simulated.run.rig, c, i, progress).counts for i, c in enumerate(simulated.run.passes, 1))
    return replace(simulated.run, passes=tuple(passes))


def different_counts(sent: Run, received: Run) -> str:
    """Return how many recorded counts of two runs differ, lost samples included."""
    total = sum(c.recorded.size for c in sent.passes)
    same = 0
    for there, here in zip(sent.passes, received.passes, strict=True):
        if here.recorded.shape == there.recorded.shape:
            same += int((here.recorded == there.recorded).sum())
    return f"{total - same} of {total}"


Progress = Callable[[str, int, int], None]
"""Called with the stage, and how much of it is done of how much."""
Step = Callable[[str], Callable[[int, int], None]]
"""Begins a stage; its value takes how much of it is done of how much."""

COUNT, CALIBRATE = "count reference poses over the bus", "calibrate"
U_REFERENCE_MM = 0.02  # of each coordinate of a reference pose, as a laser tracker gives it
U_REFERENCE_RAD = 5e-5
NOMINAL_SHIFT_MM, NOMINAL_SHIFT_DEG = 30.0, 5.0


@dataclass(frozen=True)
class CalibratedCell:
    """The campaign, and the calibration made of its files."""

    campaign: SimulatedCampaign
    calibration: Calibration


def stages(progress: Progress | None) -> Step:
    """Progress stage by stage."""

    def step(stage: str) -> Callable[[int, int], None]:
        def report(done: int, of: int) -> None:
            if progress is not None:
                progress(stage, done, of)

        report(0, 1)
        return report

    return step


def calibrated_cell(out: Path, true: Rig, rng: np.random.Generator, step: Step) -> CalibratedCell:
    """Calibrate a nominal rig from counts of the true one; `campaign/` and `calibration/` are written into `out`."""
    # slow to import, and needed only for the page
    from lmeasure.report import write_calibration_page
    from lmeasure.rig import write_calibration_record, write_rig

    report = step(COUNT)
    requested = campaign_at(
        true,
        reference_poses(),
        rng,
        u_position_mm=U_REFERENCE_MM,
        u_rotation_rad=U_REFERENCE_RAD,
        nominal_shift_mm=NOMINAL_SHIFT_MM,
        nominal_shift_deg=NOMINAL_SHIFT_DEG,
    )
    campaign = replace(requested, recorded=count_at_stops(true, requested.poses, rng, report))
    write_campaign(out / "campaign", campaign)

    report = step(CALIBRATE)
    calibration = calibrate(read_campaign(out / "campaign"), progress=report)
    write_calibration_page(out / "calibration" / "report.html", calibration, language=of_terminal())
    write_calibration_record(out / "calibration" / "calibration.json", calibration.record)
    write_rig(out / "calibration" / "rig.toml", calibration.rig)
    return CalibratedCell(campaign, calibration)


@dataclass(frozen=True)
class RobotCell:
    """Robot in a cell. true: the built rig; calibration: its record."""

    true: Rig
    calibration: Calibration

    def record(self, done: Performance, rng: np.random.Generator, progress: Callable[[int, int], None] | None = None) -> Run:
        """Return the run of a performance, over the bus. The counters are zeroed at the robot's first pose, which a reference instrument
        measures each time."""
        moved = simulate_run(self.true, done.time_s, done.poses, noise_mm=0.0, rng=rng)
        recorded = record_motion(moved, progress)
        shift, turn = U_REFERENCE_MM * rng.normal(size=3), U_REFERENCE_RAD * rng.normal(size=3)
        start = se3.displaced(done.poses[0], np.concatenate([turn, shift]))
        known = self.calibration
        return replace(recorded, rig=known.rig, calibration=known.record, start=start, u_start=(U_REFERENCE_MM, U_REFERENCE_RAD))
