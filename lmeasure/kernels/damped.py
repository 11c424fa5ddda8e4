"""Poses sought from far: least squares by damped steps, where whole ones lead nowhere."""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.decorators import kernel
from lmeasure.kernels.layout import POSE_COLUMNS
from lmeasure.kernels.least_squares import fill, normal
from lmeasure.kernels.screw import copy, displace, eliminate, platform_size

SEARCH_STEPS = 60


@kernel
def _cost(r: FloatArray) -> float:
    s = 0.0
    for j in range(len(r)):
        s += r[j] * r[j]
    return s


@kernel
def _seek(cables: FloatArray, targets: FloatArray, weights: FloatArray, free: IntArray, size: float, pose: FloatArray) -> float:
    """Move a pose (in place) by damped steps to where readings fit targets best: chi squared there, infinite where none was reached."""
    m, f = cables.shape[0], len(free)
    A, r, N, damped, b, twist, tried = (
        np.zeros((m, f)), np.zeros(m), np.empty((f, f)), np.empty((f, f)), np.empty((f, 1)), np.zeros(6), np.empty(POSE_COLUMNS),
    )  # fmt: skip
    if not fill(cables, pose, targets, weights, free, size, A, r):
        return math.inf
    damping, cost = 1e-3, _cost(r)
    for _ in range(SEARCH_STEPS):
        normal(A, N)
        # pivots are held against 1
        scale = 1.0 / max(np.abs(A).max(), 1e-300)
        for a in range(f):
            b[a, 0] = 0.0
            for j in range(m):
                b[a, 0] += A[j, a] * r[j] * scale * scale
            for c in range(f):
                damped[a, c] = N[a, c] * scale * scale
            damped[a, a] *= 1.0 + damping
            damped[a, a] += 1e-18
        if eliminate(damped, b) == 0.0:
            return math.inf
        step = 0.0
        for c in range(f):
            twist[free[c]] = b[c, 0]
            step = max(step, abs(b[c, 0]))
        copy(pose, tried)
        displace(tried, twist, size)
        fine = fill(cables, tried, targets, weights, free, size, A, r)
        now = _cost(r)
        if fine and now <= cost:
            copy(tried, pose)
            if step < 1e-6:
                return now
            cost, damping = now, max(0.1 * damping, 1e-12)
        else:
            fill(cables, pose, targets, weights, free, size, A, r)
            damping *= 10.0
            if damping > 1e12:
                return cost
    return math.inf


@kernel
def damped_search(
    cables: FloatArray, targets: FloatArray, u: FloatArray, free: IntArray, starts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 7) at which readings of channels, rows (m, columns), fit targets (m,) of standard uncertainties u (m,) best, each sought
    from its start (n, 7) by damped steps (Levenberg and Marquardt), and chi squared (n,), infinite where none was reached."""
    poses, chi, size = starts.copy(), np.empty(len(starts)), platform_size(cables)
    weights = 1.0 / u
    for i in range(len(starts)):
        chi[i] = _seek(cables, targets, weights, free, size, poses[i])
    return poses, chi
