"""Poses and lengths for the tests of the screw method."""

import math

import numpy as np
import oracles
from numpy.typing import NDArray
from rows import HOME

from lmeasure.kernels import cable

FloatArray = NDArray[np.float64]
U = np.full(6, 0.012 / math.sqrt(12))  # standard uncertainty of lengths in whole counts [mm]


def random_pose(g: np.random.Generator, reach: float = 250.0, turn: float = 0.3) -> FloatArray:
    return oracles.compose(HOME, g.uniform(-turn, turn, 3), g.uniform(-reach, reach, 3))


def changes_of(poses: FloatArray, rows: FloatArray) -> FloatArray:
    lengths = cable.span_lengths(rows, np.vstack([HOME, poses]))
    return np.asarray(lengths[1:] - lengths[0])
