"""One sample from recorded counts to a pose, for a run that is being recorded."""

import math

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.kernels import counter, kernel, layout
from lmeasure.kernels.cable import drum_change
from lmeasure.kernels.screw import CABLES, GAP, JUMP, OK, ORIGIN_LOST, resume


@kernel
def step(
    cables: FloatArray,
    start: FloatArray,
    state: FloatArray,
    counters: FloatArray,
    channels: FloatArray,
    time_s: float,
    recorded: FloatArray,
    u: FloatArray,
    pose: FloatArray,
) -> tuple[int, float]:
    """(status, worst pressure angle [rad]) of a sample, its pose into pose (7,), NaN when it is not OK.

    state of `screw.resume` and counters (6, `counter.STATE`) are moved on in place; channels (6, 4) of the cables: count per recorded count
    (sign over scale), largest rate of recorded counts [1/s], values of the counter or 0, count length [mm]; recorded (6,) NaN for no count.
    """
    changes, flags, now = np.empty((1, CABLES)), np.zeros(1, np.int64), np.full(1, time_s)
    for j in range(CABLES):
        counts, what = counter.resume(
            recorded[j : j + 1], now, channels[j, layout.CHANNEL_RATE], channels[j, layout.CHANNEL_VALUES], counters[j], 0.0
        )
        if what[0] != counter.FOLLOWED and flags[0] == OK:
            if what[0] == counter.WENT_ON:
                flags[0] = ORIGIN_LOST
            else:
                flags[0] = JUMP if what[0] == counter.JUMPED or what[0] == counter.FOREIGN else GAP
        k = counts[0] if what[0] == counter.FOLLOWED else math.nan
        k *= channels[j, layout.CHANNEL_PER_RECORDED]
        changes[0, j] = drum_change(
            k, cables[j, layout.TANGENT], cables[j, layout.AXIAL], cables[j, layout.TRAVEL], channels[j, layout.CHANNEL_COUNT_LENGTH]
        )
    poses, _, _, status, angle = resume(cables, start, state, changes, flags, u)
    for c in range(layout.POSE_COLUMNS):
        pose[c] = poses[0, c] if status[0] == OK else math.nan
    return status[0], angle[0]
