"""From recorded counts to poses, sample by sample, for a run that is being recorded."""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels import counter, layout
from lmeasure.kernels.cable import drum_change
from lmeasure.kernels.decorators import kernel
from lmeasure.kernels.least_squares import follow_least_squares
from lmeasure.kernels.screw import CABLES, GAP, JUMP, OK, ORIGIN_LOST, resume_screw


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

    state of `screw.resume` and counters (6, `counter.STATE`) are moved on in place; channels (6, `CHANNEL_COLUMNS`) of the cables; recorded
    (6,) NaN for no count.
    """
    changes, flags, now = np.empty((1, CABLES)), np.zeros(1, np.int64), np.full(1, time_s)
    for j in range(CABLES):
        counts, what = counter.resume_counting(
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
    poses, _, _, status, angle = resume_screw(cables, start, state, changes, flags, u)
    for c in range(layout.POSE_COLUMNS):
        pose[c] = poses[0, c] if status[0] == OK else math.nan
    return status[0], angle[0]


@kernel
def changes_of(
    cables: FloatArray, channels: FloatArray, counters: FloatArray, time_s: FloatArray, recorded: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Changes (n, m) of m channels of any kind [mm, rad] from recorded counts (n, m) at times (n,), NaN where there is none, and for each
    sample (n,) the fault of the first channel that has none.

    counters (m, `counter.STATE`) are moved on in place; channels (m, `CHANNEL_COLUMNS`).
    """
    n, m = recorded.shape
    changes, flags = np.empty((n, m)), np.zeros(n, np.int64)
    for j in range(m):
        full, codes = channels[j, layout.CHANNEL_VALUES], channels[j, layout.CHANNEL_ABSOLUTE] > 0.0
        shown = recorded[:, j].copy()
        foreign = np.zeros(n, np.bool_)
        if codes:
            for i in range(n):
                foreign[i] = math.isfinite(shown[i]) and not (-0.5 < shown[i] < full)
                shown[i] = math.nan if foreign[i] else shown[i] - (full if shown[i] >= 0.5 * full else 0.0)
        counts, what = counter.resume_counting(shown, time_s, channels[j, layout.CHANNEL_RATE], full, counters[j], 0.0)
        if codes:
            # an absolute code is sure after any pause
            counters[j, counter.UNSURE_AT] = 0.0
        for i in range(n):
            kind = counter.FOREIGN if foreign[i] else counter.FOLLOWED if codes and what[i] == counter.UNSURE else what[i]
            if kind != counter.FOLLOWED and flags[i] == OK:
                if kind == counter.WENT_ON:
                    flags[i] = ORIGIN_LOST
                else:
                    flags[i] = JUMP if kind == counter.JUMPED or kind == counter.FOREIGN else GAP
            k = channels[j, layout.CHANNEL_PER_RECORDED] * (counts[i] if kind == counter.FOLLOWED else math.nan)
            k -= channels[j, layout.CHANNEL_SHIFT]
            changes[i, j] = drum_change(
                k, cables[j, layout.TANGENT], cables[j, layout.AXIAL], cables[j, layout.TRAVEL], channels[j, layout.CHANNEL_COUNT_LENGTH]
            )
    return changes, flags


@kernel
def step_of(
    cables: FloatArray,
    start: FloatArray,
    zero: FloatArray,
    state: FloatArray,
    counters: FloatArray,
    channels: FloatArray,
    offsets: FloatArray,
    time_s: float,
    recorded: FloatArray,
    u: FloatArray,
    free: IntArray,
    pose: FloatArray,
    change: FloatArray,
) -> tuple[int, float, float]:
    """(status, worst pressure angle [rad], chi squared by u alone) of a sample of m channels of any kind; its pose into pose (7,), NaN when
    it is not OK, its changes into change (m,).

    offsets (m,): by how much readings are too large, NaN of a channel that is not used; otherwise as `least_squares.follow` and
    `changes_of` have it.
    """
    m = cables.shape[0]
    changes, flags = changes_of(cables, channels, counters, np.full(1, time_s), recorded.reshape(1, m))
    for j in range(m):
        changes[0, j] -= offsets[j]
        change[j] = changes[0, j]
    if flags[0] == OK:
        flags[0] = GAP  # of omitted channels
    poses, _, _, status, angle, chi = follow_least_squares(cables, start, zero, state, changes, flags, u, free)
    for c in range(layout.POSE_COLUMNS):
        pose[c] = poses[0, c] if status[0] == OK else math.nan
    return status[0], angle[0], chi[0]
