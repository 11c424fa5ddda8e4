"""Poses and lengths for the tests of the screw method."""

import math
from typing import Any

import numpy as np
import oracles
from numpy.typing import NDArray
from rows import HOME

from lmeasure.kernels import cable, screw
from lmeasure.linkages import pressure_angles

FloatArray = NDArray[np.float64]
U = np.full(6, 0.012 / math.sqrt(12))  # standard uncertainty of lengths in whole counts [mm]


def random_pose(g: np.random.Generator, reach: float = 250.0, turn: float = 0.3) -> FloatArray:
    return oracles.compose(HOME, g.uniform(-turn, turn, 3), g.uniform(-reach, reach, 3))


def changes_of(poses: FloatArray, rows: FloatArray) -> FloatArray:
    lengths = cable.span_lengths(rows, np.vstack([HOME, poses]))
    return np.asarray(lengths[1:] - lengths[0])


def angles_at(rows: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 6) pressure-angle analogues [rad] of the cables at poses (n, 7)."""
    arms = np.stack([rows[:, 7:10] @ oracles.matrix_of_quaternion(pose[3:]).T for pose in poses])
    return pressure_angles(np.stack([cable.span_rows(rows, pose) for pose in poses]), arms)


def track(rows: FloatArray, start: FloatArray, changes: FloatArray, flags: NDArray[np.int64], u: FloatArray) -> Any:
    """Follow a run from its beginning."""
    return screw.resume_screw(rows, start, screw.new_state(start), changes, flags, u)
