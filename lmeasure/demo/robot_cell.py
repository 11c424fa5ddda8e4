"""A robot's motion in the simulated cell, as the calibrated instrument records it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.calibration import Calibration
from lmeasure.core import se3
from lmeasure.demo.bus_loop import record_motion
from lmeasure.demo.calibrated_cell import U_REFERENCE_MM, U_REFERENCE_RAD
from lmeasure.recording import Run
from lmeasure.rig import Rig
from lmeasure.robots import Performance
from lmeasure.simulation import simulate_run


@dataclass(frozen=True)
class RobotCell:
    """true: the rig as it stands; calibration: what is known of it."""

    true: Rig
    calibration: Calibration

    def record(self, done: Performance, rng: np.random.Generator, progress: Callable[[int, int], None] | None = None) -> Run:
        """The run of a performance, over the bus. The counters are zeroed where the robot stands at its beginning, which a reference
        instrument measures each time."""
        moved = simulate_run(self.true, done.time_s, done.poses, noise_mm=0.0, rng=rng)
        recorded = record_motion(moved, progress)
        shift, turn = U_REFERENCE_MM * rng.normal(size=3), U_REFERENCE_RAD * rng.normal(size=3)
        start = se3.displaced(done.poses[0], np.concatenate([turn, shift]))
        known = self.calibration
        return replace(recorded, rig=known.rig, calibration=known.record, start=start, u_start=(U_REFERENCE_MM, U_REFERENCE_RAD))
