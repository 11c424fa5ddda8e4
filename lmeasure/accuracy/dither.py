"""Dither: slow swings about a pose, so that rounded counts average below the count, and what they bring."""

import numpy as np

from lmeasure.core import AccuracyError, FloatArray
from lmeasure.kernels import span_rows_of
from lmeasure.rig import Rig
from lmeasure.sensors import Channels
from lmeasure.text import message
from lmeasure.trajectory import kept_on

FREEDOMS = 6
SAMPLES = 240


def dither_gain(rig: Rig, poses: FloatArray, size_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return standard uncertainties (n,) [mm] of positions at (n, 7) poses by the counts: of rests, and of dithers of a size.

    Each axis swings by the size to both sides, as `iso9283.dithered` commands it. AccuracyError where the channels do not determine the
    pose.
    """
    channels = Channels.of_rig(rig, covariance=False)
    rows = span_rows_of(channels.rows, np.ascontiguousarray(poses)) / np.sqrt(channels.rounding)[:, None]
    if (np.linalg.matrix_rank(rows) < FREEDOMS).any():
        raise AccuracyError(message("error.dither_channels"))
    square = np.linalg.pinv(rows)[:, 3:] ** 2
    turn = 2.0 * np.pi * np.arange(1, 4)[:, None] * (np.arange(SAMPLES) + 0.5) / SAMPLES
    moved = size_mm * 2.0 / np.pi * np.arcsin(np.sin(turn))
    # the standard deviation of a rounding is a count over sqrt(12)
    kept = np.array([kept_on(one[:, 3:] @ moved / np.sqrt(12.0)) for one in rows])
    return np.sqrt(square.sum(axis=(1, 2))), np.sqrt(np.einsum("ncm,nm->n", square, kept))
