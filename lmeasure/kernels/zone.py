"""Scan of an accuracy zone: for each place of the tool origin the worst over all orientations.

The scan measures; limits are applied to its figures afterwards, so that one scan serves any limit. A pose where a cable cannot run, or
where the cables do not determine the pose, counts as a pressure angle of 90 degrees and an infinite uncertainty.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lmeasure.kernels import inline, kernel
from lmeasure.kernels.cable import FloatArray, drum_count, length_gradient, span_at
from lmeasure.kernels.gaussian import radius_95
from lmeasure.kernels.screw import CABLES, WIDTH, invert, platform_size, worst_pressure_angle

IntArray = NDArray[np.int64]

CANNOT_RUN, SINGULAR = 1, 2


@inline
def _add_systematic(
    cables: FloatArray,
    pose: FloatArray,
    zero: FloatArray,
    at_start: FloatArray,
    here: FloatArray,
    scales: FloatArray,
    factor: FloatArray,
    inverse: FloatArray,
    shift: FloatArray,
    C: FloatArray,
) -> None:
    """Add the calibration's part to the tool origin's covariance C (3, 3): the rig parameters' covariance is factor @ factor.T, and
    a parameter moves the length at the pose less that at the start pose, where the counters are zeroed."""
    for j in range(CABLES):
        change = span_at(cables[j], pose)[0] - zero[j]
        k = drum_count(change, cables[j, 10], cables[j, 11], cables[j, 12], cables[j, 13])
        length_gradient(cables[j], pose, k, scales[j], here[j])
        for c in range(WIDTH):
            here[j, c] -= at_start[j, c]
    for column in range(factor.shape[1]):
        for a in range(3):
            shift[a] = 0.0
        for j in range(CABLES):
            dl = 0.0
            for c in range(WIDTH):
                dl += here[j, c] * factor[WIDTH * j + c, column]
            for a in range(3):
                shift[a] += inverse[3 + a, j] * dl
        for a in range(3):
            for b in range(3):
                C[a, b] += shift[a] * shift[b]


@kernel
def scan(
    cables: FloatArray,
    positions: FloatArray,
    quaternions: FloatArray,
    variance: FloatArray,
    scales: FloatArray,
    factor: FloatArray,
    start: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Worst figures at (n, 3) positions of the tool origin over (k, 4) orientations x, y, z, w, all in the base frame.

    cables (6, 17); variance (6,) of the lengths' own errors [mm^2]; scales (6,) decoding factors; factor (6 WIDTH, r) with
    factor @ factor.T the rig parameters' covariance (r = 0: not linked); start (7,) pose at which the counters are zeroed.
    Returns (n,) worst pressure angle [rad], radius of the sphere at the tool origin that holds 95 % [mm], shortest and longest cable [mm],
    flags CANNOT_RUN and SINGULAR.
    """
    n = positions.shape[0]
    angle, u95 = np.zeros(n), np.zeros(n)
    shortest, longest = np.full(n, np.inf), np.zeros(n)
    flags = np.zeros(n, np.int64)
    size = platform_size(cables)
    J, inverse, C = np.empty((CABLES, CABLES)), np.empty((CABLES, CABLES)), np.empty((3, 3))
    here, at_start, shift = np.empty((CABLES, WIDTH)), np.empty((CABLES, WIDTH)), np.empty(3)
    zero = np.empty(CABLES)
    for j in range(CABLES):
        zero[j] = span_at(cables[j], start)[0]
        length_gradient(cables[j], start, 0.0, scales[j], at_start[j])
    pose = np.empty(7)
    for i in range(n):
        for o in range(quaternions.shape[0]):
            for c in range(3):
                pose[c] = positions[i, c]
            for c in range(4):
                pose[3 + c] = quaternions[o, c]
            runs = True
            for j in range(CABLES):
                length = span_at(cables[j], pose)[0]
                runs &= not math.isnan(length)
                shortest[i] = min(shortest[i], length)
                longest[i] = max(longest[i], length)
            if not runs or invert(cables, pose, J, inverse, size) == 0.0:
                flags[i] |= SINGULAR if runs else CANNOT_RUN
                angle[i], u95[i] = 0.5 * math.pi, math.inf
                continue
            angle[i] = max(angle[i], worst_pressure_angle(cables, pose, inverse))
            for a in range(3):
                for b in range(3):
                    s = 0.0
                    for j in range(CABLES):
                        s += inverse[3 + a, j] * variance[j] * inverse[3 + b, j]
                    C[a, b] = s
            if factor.shape[1] > 0:
                _add_systematic(cables, pose, zero, at_start, here, scales, factor, inverse, shift, C)
            u95[i] = max(u95[i], radius_95(C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2]))
    return angle, u95, shortest, longest, flags
