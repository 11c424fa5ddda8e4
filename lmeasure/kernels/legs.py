"""Poses of a platform whose six legs' lower ends move: straight links for the screw kernel, laid anew for every pose."""

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.kernels import kernel
from lmeasure.kernels.layout import ATTACHMENT, BASE, CABLE_COLUMNS, GUIDE
from lmeasure.kernels.screw import CABLES, TOLERANCE_MM, newton, platform_size


@kernel
def placed(points: FloatArray, ends: FloatArray, lengths: FloatArray, starts: FloatArray) -> tuple[IntArray, FloatArray]:
    """Status (n,) and poses (n, 7) of platforms with points (6, 3) on legs from ends (n, 6, 3), lengths (n, 6) [mm], from starts (n, 7)."""
    legs = np.zeros((CABLES, CABLE_COLUMNS))
    for j in range(CABLES):
        for c in range(3):
            legs[j, ATTACHMENT + c] = points[j, c]
        # nothing is wrapped; only a leg along this very direction would have no plane to be wrapped in
        legs[j, GUIDE], legs[j, GUIDE + 1], legs[j, GUIDE + 2] = 0.48, -0.64, 0.6
    poses, status = starts.copy(), np.empty(len(starts), np.int64)
    J, r = np.empty((CABLES, CABLES)), np.empty((CABLES, 1))
    size = platform_size(legs)
    for i in range(len(starts)):
        for j in range(CABLES):
            for c in range(3):
                legs[j, BASE + c] = ends[i, j, c]
        status[i] = newton(legs, lengths[i], TOLERANCE_MM, poses[i], J, r, size)[0]
    return status, poses
