"""Twists of a pose per unit of each of six lengths, and its covariance from theirs and that of the rig's parameters."""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels.cable import length_gradient
from lmeasure.kernels.decorators import kernel
from lmeasure.kernels.layout import WIDTH
from lmeasure.kernels.screw import CABLES, copy, invert, platform_size


@kernel
def pose_twists(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 6, 6) inverses of the rows at (n, 7) poses: column i is the twist (omega; v) about the tool origin per unit of length i; NaN
    where the pose is NaN or singular."""
    out = np.full((poses.shape[0], 6, CABLES), np.nan)
    J, inverse = np.empty((CABLES, CABLES)), np.empty((CABLES, CABLES))
    size = platform_size(cables)
    for i in range(poses.shape[0]):
        if not math.isnan(poses[i, 0]) and invert(cables, poses[i], J, inverse, size) != 0.0:
            for a in range(6):
                copy(inverse[a], out[i, a])
    return out


@kernel
def spread(
    inverse: FloatArray, gradients: FloatArray, count_variance: FloatArray, parameter_covariance: FloatArray, linked: bool
) -> tuple[FloatArray, FloatArray]:
    """Random and systematic covariance (6, 6) each of a pose.

    inverse (6, m): twist per unit of each length; gradients (m, 13) of the lengths by their parameters; count_variance (m,) [mm^2];
    parameter_covariance (13 m, 13 m), read only when linked.
    """
    m = inverse.shape[1]
    random, systematic = np.zeros((6, 6)), np.zeros((6, 6))
    for a in range(6):
        for b in range(6):
            s = 0.0
            for j in range(m):
                s += inverse[a, j] * count_variance[j] * inverse[b, j]
            random[a, b] = s
    if not linked:
        return random, systematic
    C = np.empty((m, m))
    for j in range(m):
        for k in range(m):
            s = 0.0
            for a in range(WIDTH):
                t = 0.0
                for b in range(WIDTH):
                    t += parameter_covariance[WIDTH * j + a, WIDTH * k + b] * gradients[k, b]
                s += gradients[j, a] * t
            C[j, k] = s
    for a in range(6):
        for b in range(6):
            s = 0.0
            for j in range(m):
                for k in range(m):
                    s += inverse[a, j] * C[j, k] * inverse[b, k]
            systematic[a, b] = s
    return random, systematic


@kernel
def pose_covariances(
    cables: FloatArray,
    start: FloatArray,
    poses: FloatArray,
    counts: FloatArray,
    scales: FloatArray,
    count_variance: FloatArray,
    parameter_covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Covariances of poses, random and systematic: two (n, 6, 6) arrays.

    The error of a pose is delta = (rotation; translation of the tool origin), R_true = Exp(delta_rotation) R, base axes [rad, mm];
    delta = inverse(rows) dl. Random: the lengths' own independent variances (m,) [mm^2]. Systematic: the rig parameters' covariance
    (13 m, 13 m) in the order of `PARAMETERS` per cable; a parameter moves the length at the pose *and* at the zero pose, where the counters
    started. NaN poses give NaN.
    """
    n = poses.shape[0]
    random, systematic = np.full((n, 6, 6), np.nan), np.full((n, 6, 6), np.nan)
    J, inverse = np.empty((CABLES, CABLES)), np.empty((CABLES, CABLES))
    size = platform_size(cables)
    at_start, here = np.empty((CABLES, WIDTH)), np.zeros((CABLES, WIDTH))
    linked = np.any(parameter_covariance != 0.0)
    for j in range(CABLES):
        length_gradient(cables[j], start, 0.0, scales[j], at_start[j])
    for i in range(n):
        if math.isnan(poses[i, 0]):
            continue
        invert(cables, poses[i], J, inverse, size)
        if linked:
            for j in range(CABLES):
                length_gradient(cables[j], poses[i], counts[i, j], scales[j], here[j])
                for c in range(WIDTH):
                    here[j, c] -= at_start[j, c]
        r, s = spread(inverse, here, count_variance, parameter_covariance, linked)
        for a in range(6):
            copy(r[a], random[i, a])
            copy(s[a], systematic[i, a])
    return random, systematic
