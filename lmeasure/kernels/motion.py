"""Local polynomials through poses: a smoothed pose and its derivatives at every sample (Fan and Gijbels, Local Polynomial Modelling).

About each sample the neighbours are seen as small displacements d(t) = (rotation vector of R(t) R_i^T; x(t) - x_i), base axes, and a
cubic is fitted to each component over +- half_width seconds with Epanechnikov's weights. Gaps and uneven times are no special case.
"""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import kernel
from lmeasure.kernels.screw import copy, displace, eliminate
from lmeasure.kernels.se3 import log_rotation
from lmeasure.kernels.vector import Quat, multiply, orientation

TERMS = 4  # of a cubic
LEAST = 8  # samples in a window: twice the terms


@kernel
def _relative(pose: FloatArray, origin: FloatArray, out: FloatArray) -> None:
    """(rotation vector; translation) of the pose from the origin, base axes, into out (6,)."""
    q: Quat = orientation(origin)
    w = log_rotation(multiply(orientation(pose), (-q[0], -q[1], -q[2], q[3])))
    for c in range(3):
        out[c] = w[c]
        out[3 + c] = pose[c] - origin[c]


@kernel
def local_cubics(time_s: FloatArray, poses: FloatArray, half_width_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smoothed poses (n, 7), derivatives (n, 3, 6) and factors (n, 4) from times (n,) and poses (n, 7), NaN where there is none.

    Derivatives are velocity, acceleration and jerk of (rotation; tool origin) in base axes: angular velocity first. A factor times the
    standard uncertainty of one pose is that of the smoothed pose and of the three derivatives, for errors independent from sample to
    sample. NaN where the window holds fewer than LEAST poses or the sample itself has none.
    """
    n = len(time_s)
    smooth, derivatives, factors = np.full((n, 7), np.nan), np.full((n, 3, 6), np.nan), np.full((n, TERMS), np.nan)
    M, K, B, d, x = np.empty((TERMS, TERMS)), np.empty((TERMS, TERMS)), np.empty((TERMS, TERMS + 6)), np.empty(6), np.empty(6)
    powers, c = np.empty(TERMS), np.empty((TERMS, 6))
    first = 0
    for i in range(n):
        while time_s[i] - time_s[first] > half_width_s:
            first += 1
        if math.isnan(poses[i, 0]):
            continue
        for a in range(TERMS):
            for b in range(TERMS):
                M[a, b], K[a, b], B[a, b] = 0.0, 0.0, 1.0 if a == b else 0.0
            for b in range(6):
                B[a, TERMS + b] = 0.0
        count = 0
        j = first
        while j < n and time_s[j] - time_s[i] <= half_width_s:
            if not math.isnan(poses[j, 0]):
                tau = (time_s[j] - time_s[i]) / half_width_s
                w = max(1.0 - tau * tau, 1e-3)
                _relative(poses[j], poses[i], d)
                powers[0] = 1.0
                for a in range(1, TERMS):
                    powers[a] = powers[a - 1] * tau
                for a in range(TERMS):
                    for b in range(TERMS):
                        M[a, b] += w * powers[a] * powers[b]
                        K[a, b] += w * w * powers[a] * powers[b]
                    for b in range(6):
                        B[a, TERMS + b] += w * powers[a] * d[b]
                count += 1
            j += 1
        if count < LEAST:
            continue
        # rows to unit size, so that a pivot means the same in any window
        for a in range(TERMS):
            f = 1.0 / M[a, a]
            for b in range(TERMS):
                M[a, b] *= f
            for b in range(TERMS + 6):
                B[a, b] *= f
        if eliminate(M, B) == 0.0:
            continue
        scale = 1.0
        for a in range(TERMS):
            variance = 0.0
            for b in range(TERMS):
                for e in range(TERMS):
                    variance += B[a, b] * K[b, e] * B[a, e]
            factors[i, a] = math.sqrt(variance) * scale
            for b in range(6):
                c[a, b] = B[a, TERMS + b] * scale
            scale *= (a + 1) / half_width_s
        copy(poses[i], smooth[i])
        for b in range(6):
            x[b] = c[0, b]
        # a shift in base axes and a turn about the tool origin: no screw
        for b in range(3):
            smooth[i, b] += x[3 + b]
            x[3 + b] = 0.0
        displace(smooth[i], x, 1.0)
        for b in range(6):
            for a in range(3):
                derivatives[i, a, b] = c[1 + a, b]
        # the rotation vector's third derivative is not that of the angular velocity: w'' = d''' + d' x d'' / 2 where d = 0
        for b in range(3):
            p, q = (b + 1) % 3, (b + 2) % 3
            derivatives[i, 2, b] += 0.5 * (c[1, p] * c[2, q] - c[1, q] * c[2, p])
    return smooth, derivatives, factors
