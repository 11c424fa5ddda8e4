"""Simulated counts as they arrive on the other side of a bus."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lmeasure.acquisition import record_feed
from lmeasure.core import FloatArray
from lmeasure.recording import Run
from lmeasure.rig import Rig
from lmeasure.simulation import Leg, SimulatedRun, simulate_run, smooth_path

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
