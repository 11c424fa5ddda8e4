"""Which poses of a robot to measure: those that leave the least uncertainty at the others."""

from dataclasses import replace

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.estimation.exchange import Criterion, Numbered, empty, grown, improved, ordered
from lmeasure.estimation.information import blocks
from lmeasure.robots.measurements import POSITION, measured
from lmeasure.robots.unknowns import R, Unknowns

FAR_MM, FAR_RAD = 1e3, 1.0
"""Prior of frames of which nothing is known, while poses are chosen: as good as nothing, and the first poses are not lost in rounding."""


def chosen(unknowns: Unknowns[R], candidates: FloatArray, zone: FloatArray, count: int, u_mm: float) -> IntArray:
    """(count,) candidates (N, n) joint values that, measured with u_mm in each coordinate, leave the least mean variance of predicted
    places at the joint values `zone` (M, n) (I-optimality), in the order of what they bring."""
    told = blocks(_sensitivity(unknowns, candidates), np.full(3, u_mm**2))
    criterion = Criterion("I", _sensitivity(unknowns, zone).reshape(-1, len(unknowns)))
    rng = np.random.default_rng(0)  # which nothing is drawn from: every candidate is tried
    width = np.minimum(unknowns.width, np.where(unknowns.size == 1.0, FAR_MM, FAR_RAD))
    start = empty(Numbered(told), np.diag((unknowns.size / width) ** 2))
    design = ordered(improved(grown(start, count, criterion, rng), criterion, rng), criterion)
    return design.points[:, 0].astype(np.int64)


def _sensitivity(unknowns: Unknowns[R], joints: FloatArray) -> FloatArray:
    """(N, 3, p) derivatives of the first target's place by the unknowns in the units of their names."""
    rows = replace(measured(joints, np.zeros((len(joints), 3)), side=np.zeros_like(joints)), targets=unknowns.rows.targets)
    return unknowns.linearised(np.zeros(len(unknowns)), rows)[1][:, POSITION] * unknowns.size
