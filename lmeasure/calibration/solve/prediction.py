"""Prediction of lengths and poses by the calibrated rig over its workspace. It matters; B alone misleads."""

from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.core import FloatArray
from lmeasure.kernels import span_lengths, span_rows_of
from lmeasure.rig import CABLES_FOR_A_POSE, CalibrationRecord, Rig
from lmeasure.sensors import cable_covariance, channel_names, counts_from_poses, further_solved, length_gradients_since

SAMPLES_LOG2 = 8


@dataclass(frozen=True)
class Prediction:
    """Standard uncertainties from the calibration alone, at (n, 7) poses of the workspace.

    length_mm (n, m): of the change of each cable since the zero pose; pose (n, 6): of the tool's origin [mm] and rotation [rad], empty
    (n, 0) when the cables do not make a pose.
    """

    rows: FloatArray
    length_mm: FloatArray
    pose: FloatArray


def workspace(campaign: Campaign, seed: int) -> FloatArray:
    """(n, 7) poses spread over the box of the reference poses (Sobol), each with the orientation of one of them."""
    rows = campaign.poses.rows
    unit = scipy.stats.qmc.Sobol(4, scramble=True, rng=np.random.default_rng([seed, 3])).random_base2(SAMPLES_LOG2)
    low, high = rows[:, :3].min(axis=0), rows[:, :3].max(axis=0)
    which = (unit[:, 3] * len(rows)).astype(np.int64)
    return np.column_stack([low + unit[:, :3] * (high - low), rows[which, 3:]])


def predict(campaign: Campaign, rig: Rig, record: CalibrationRecord, seed: int = 0, *, solved: bool = False) -> Prediction:
    """Propagate the record's covariance, and that of dimensions which the rig states and nothing solved, to lengths and poses over the
    reference poses' workspace; counters zeroed at the zero pose. solved: the covariance of the record's parameters alone."""
    rows = workspace(campaign, seed)
    cables = campaign.drums
    zero = campaign.poses.rows[campaign.zero[0]]
    kernel_rows = rig.cable_rows(cables)
    lengths = span_lengths(kernel_rows, rows)
    rows = rows[np.isfinite(lengths).all(axis=1)]
    counts = counts_from_poses(rig, rows, zero, cables)
    wide = further_solved(record)
    g = length_gradients_since(rig, cables, zero, rows, counts=counts, wide=wide)
    names = channel_names(rig, cables, wide=wide)
    covariance = record.cable_covariance(names) if solved else cable_covariance(rig, record, cables, wide=wide)
    width = g.shape[2]
    u = np.empty(g.shape[:2])
    for j in range(len(cables)):
        own = covariance[j * width : (j + 1) * width, j * width : (j + 1) * width]
        u[:, j] = np.sqrt(np.maximum(np.einsum("na,ab,nb->n", g[:, j], own, g[:, j]), 0.0))
    pose = np.empty((len(rows), 0))
    if len(cables) == CABLES_FOR_A_POSE:
        wrenches = span_rows_of(kernel_rows, np.ascontiguousarray(rows))
        if (np.linalg.matrix_rank(wrenches) == CABLES_FOR_A_POSE).all():
            pose = _of_poses(wrenches, g, covariance)
    return Prediction(rows, u, pose)


def _of_poses(wrenches: FloatArray, g: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n, 6) standard uncertainties of tool's origin and rotation at n poses whose m lengths have errors g (n, m, w) per parameter."""
    n, m, width = g.shape
    every = np.zeros((n, m, m, width))
    every[:, np.arange(m), np.arange(m)] = g
    by = np.linalg.inv(wrenches) @ every.reshape(n, m, m * width)
    return np.asarray(np.sqrt(np.maximum(np.einsum("nia,ab,nib->ni", by, covariance, by), 0.0))[:, [3, 4, 5, 0, 1, 2]])
