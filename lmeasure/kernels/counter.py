"""A finite counter: its wraps undone, and what cannot be a motion told apart."""

import math

import numpy as np
from numpy.typing import NDArray

from lmeasure.kernels import inline, kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FOLLOWED, EMPTY, JUMPED, UNSURE, FOREIGN = range(5)


@inline
def shortest(step: float, full: float) -> float:
    """The step of a counter of `full` values in [-full/2, full/2); full 0: it never wraps."""
    return step - full * math.floor(step / full + 0.5) if full > 0.0 else step


@kernel
def follow(recorded: FloatArray, time_s: FloatArray, max_rate: float, full: float) -> tuple[FloatArray, IntArray]:
    """Continuous counts (n,) and what each sample is (n,), from recorded counts (n,) with NaN for empty cells.

    max_rate [1/s] bounds the motion, full is the number of values of the counter, 0 when it does not wrap. The first count is taken as a
    signed one. A step that the motion cannot have made is a jump, and the counter's origin is lost with it (JUMPED), until a jump back
    to where the last good sample could have come. After a pause in which it could have gone half its range a counter is UNSURE for good.
    A value that no counter of that size shows is FOREIGN and nothing else. Continuous counts are the recorded ones plus whole turns,
    exactly.
    """
    n = len(recorded)
    counts, what = np.full(n, np.nan), np.full(n, EMPTY)
    good, seen = -1, -1
    lost, unsure = False, False
    for i in range(n):
        x = recorded[i]
        if math.isnan(x):
            continue
        if full > 0.0 and not (-0.5 * full <= x < full):
            what[i] = FOREIGN
            continue
        if good < 0:
            counts[i] = shortest(x, full)
            what[i] = FOLLOWED
            good = seen = i
            continue
        step = shortest(x - recorded[seen], full)
        reach = max_rate * (time_s[i] - time_s[seen]) + 1.0
        possible = abs(step) <= reach
        if lost and not possible:
            step = shortest(x - recorded[good], full)
            reach = max_rate * (time_s[i] - time_s[good]) + 1.0
            lost = abs(step) > reach
        elif not possible:
            lost = True
        seen = i
        if lost:
            what[i] = JUMPED
            continue
        # a way of half the range or more may as well have been the other way round
        unsure = unsure or (full > 0.0 and reach >= 0.5 * full)
        target = counts[good] + step
        counts[i] = x + (full * math.floor((target - x) / full + 0.5) if full > 0.0 else 0.0)
        what[i] = UNSURE if unsure else FOLLOWED
        good = i
    return counts, what
