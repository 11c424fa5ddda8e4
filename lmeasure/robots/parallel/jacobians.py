"""Rates of a closed mechanism: constraint equations F(x, q) = 0 of its output x and its drives q, both Jacobians, and where they fail.

A x' + B q' = 0 with A = dF/dx (m, f) and B = dF/dq (m, n). Where B loses rank a drive is at a dead point and the output at a limit (type
1); where A does, the output moves although the drives stand (type 2); both at once is type 3 (Gosselin and Angeles, Singularity analysis
of closed-loop kinematic chains, IEEE Transactions on Robotics and Automation 6, 1990). A determinant has the units of its columns and
says nothing of how near it is: rank is judged by singular values of matrices whose rows are of length one in stated units.
"""

from enum import IntFlag
from typing import NamedTuple

import numpy as np

from lmeasure.core import FloatArray, IntArray

NEAR = 1e-6
"""Smallest singular value over the largest under which a matrix is singular."""


class Singular(IntFlag):
    """Which Jacobians are singular: `OUTPUT` alone is type 2, `DRIVES` alone type 1, both type 3."""

    NO = 0
    DRIVES = 1
    OUTPUT = 2
    BOTH = 3


class Jacobians(NamedTuple):
    """output (..., m, f) is dF/dx, drives (..., m, n) is dF/dq; m equations."""

    output: FloatArray
    drives: FloatArray


def nearness(matrices: FloatArray, units: FloatArray | float = 1.0) -> FloatArray:
    """(...) smallest over largest singular value of matrices (..., m, f), columns multiplied by units (f,) and rows then of length one.

    units makes turns and shifts comparable: a length in which one radian is about as much as it. A row of zeros gives zero.
    """
    scaled = matrices * units
    size = np.linalg.norm(scaled, axis=-1, keepdims=True)
    values = np.linalg.svd(np.divide(scaled, size, out=np.zeros_like(scaled), where=size > 0.0), compute_uv=False)
    return np.asarray(values[..., -1] / np.maximum(values[..., 0], np.finfo(np.float64).tiny))


def singular(jacobians: Jacobians, output_units: FloatArray | float = 1.0) -> IntArray:
    """(...) `Singular` of mechanisms. Drives are of one kind, and judged by the rank of their columns beside the largest of them."""
    values = np.linalg.svd(jacobians.drives, compute_uv=False)
    drives = values[..., -1] <= NEAR * values[..., 0]
    output = nearness(jacobians.output, output_units) <= NEAR
    return np.asarray(Singular.DRIVES * drives + Singular.OUTPUT * output, dtype=np.int64)


def velocities(jacobians: Jacobians) -> FloatArray:
    """(..., f, n) V = -A^-1 B, which gives the output's twist of the drives' rates; NaN where the output is singular."""
    output, drives = jacobians
    if (singular(jacobians) & Singular.OUTPUT).any():
        return np.full((*output.shape[:-1], drives.shape[-1]), np.nan)
    return np.asarray(-np.linalg.solve(output, drives))
