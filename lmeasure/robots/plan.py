"""Which poses of a robot to measure: those that leave the least uncertainty at the others, chosen one after the other, then exchanged."""

from dataclasses import replace

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.robots.measurements import POSITION, measured
from lmeasure.robots.unknowns import R, Unknowns

EXCHANGES = 2
"""Rounds in which every chosen pose is weighed against all others."""


def chosen(unknowns: Unknowns[R], candidates: FloatArray, zone: FloatArray, count: int, u_mm: float) -> IntArray:
    """(count,) candidates (N, n) joint values that, measured with u_mm in each coordinate, leave the least mean variance of predicted
    places at the joint values `zone` (M, n) (I-optimality), in the order of what they bring."""
    J = _sensitivity(unknowns, candidates) / u_mm
    over = _sensitivity(unknowns, zone)
    weight = np.einsum("nip,niq->pq", over, over) / len(over)
    C = np.diag((unknowns.width / unknowns.size) ** 2)
    out: list[int] = []
    for _ in range(min(count, len(J))):
        gain = _gain(J, C, weight)
        gain[out] = -1.0
        best = int(np.argmax(gain))
        out.append(best)
        C = _with(C, J[best], 1.0)
    for _ in range(EXCHANGES):
        for k, old in enumerate(out):
            without = _with(C, J[old], -1.0)
            gain = _gain(J, without, weight)
            gain[[i for i in out if i != old]] = -1.0
            out[k] = int(np.argmax(gain))
            C = _with(without, J[out[k]], 1.0)
    return np.array(out, dtype=np.int64)


def _sensitivity(unknowns: Unknowns[R], joints: FloatArray) -> FloatArray:
    """(N, 3, p) derivatives of the first target's place by the unknowns in the units of their names."""
    rows = replace(measured(joints, np.zeros((len(joints), 3)), side=np.zeros_like(joints)), targets=unknowns.rows.targets)
    return unknowns.linearised(np.zeros(len(unknowns)), rows)[1][:, POSITION] * unknowns.size


def _gain(J: FloatArray, C: FloatArray, weight: FloatArray) -> FloatArray:
    """(N,) by how much the weighted trace of the covariance C falls with each candidate's three coordinates."""
    JC = J @ C
    inner = np.eye(3) + JC @ np.swapaxes(J, 1, 2)
    fall = JC @ weight @ np.swapaxes(JC, 1, 2)
    return np.asarray(np.einsum("nii->n", np.linalg.solve(inner, fall)))


def _with(C: FloatArray, rows: FloatArray, sign: float) -> FloatArray:
    """The covariance with (+1) or without (-1) a candidate's rows (3, p)."""
    JC = rows @ C
    out = C - sign * JC.T @ np.linalg.solve(np.eye(3) + sign * JC @ rows.T, JC)
    return np.asarray((out + out.T) / 2)
