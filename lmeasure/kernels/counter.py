"""A finite counter: undo its wraps, and detect steps that no motion explains."""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.decorators import inline, strict_kernel

FOLLOWED, EMPTY, JUMPED, UNSURE, FOREIGN, WENT_ON = range(6)
RETURN_S = 0.1  # within which a jump back shows that the number was wrong and not the counter
STATE = 10
# content of a counter's state: whether there is a sample; continuous and recorded count and time of the last one; the same of the last one
# before its origin was lost; whether it is lost; whether it is unsure; the rate that is believed of it in a pause
_ANY, _COUNT, _SEEN, _SEEN_TIME, _GOOD_COUNT, _GOOD, _GOOD_TIME, _LOST, _UNSURE, _BELIEVED = range(STATE)
UNSURE_AT, BELIEVED_AT = _UNSURE, _BELIEVED
"""Where a state has whether its counter is unsure, and the largest rate [1/s] that the motion itself makes believe of it, 0 for the one
that bounds it."""
AT_ONCE = 2**16
"""Counts that are looked at together: more would take several times their own memory."""
PAUSE = 2.5
"""Usual intervals: what is no longer is no pause."""


@inline
def shortest(step: float, full: float) -> float:
    """The step of a counter of `full` values in [-full/2, full/2); full 0: it never wraps."""
    return step - full * math.floor(step / full + 0.5) if full > 0.0 else step


@strict_kernel
def resume_counting(
    recorded: FloatArray, time_s: FloatArray, max_rate: float, full: float, state: FloatArray, least_s: float
) -> tuple[FloatArray, IntArray]:
    """Return continuous counts (n,) and the status of each sample (n,), from recorded counts (n,) with NaN for empty cells.

    max_rate [1/s] bounds the motion, full is the number of values of the counter, 0 when it does not wrap. The first count is taken as a
    signed one. A step that the motion cannot have made is a jump (JUMPED), and the counter's origin is lost with it: it WENT_ON, until it
    jumps, within RETURN_S, back to where the last good sample could have come. Its counts continue too, if a caller can prove them. After
    a pause in which it could have gone round a counter is UNSURE for good. A value that no counter of that size shows is FOREIGN
    and nothing else. Continuous counts are the recorded ones plus whole turns, exactly.

    state (STATE,), zeros at the beginning of a recording, is changed in place, for the next piece of it.
    least_s: taken for the time between samples whose stamps are closer: a busy host stamps at once frames that arrived one by one. If the
    motion has confirmed the rate in the state (`BELIEVED_AT`), only pauses, longer than PAUSE times least_s, make a counter unsure, and
    by that rate.
    """
    n = len(recorded)
    counts, what = np.full(n, np.nan), np.full(n, EMPTY)
    for i in range(n):
        x = recorded[i]
        if math.isnan(x):
            continue
        if full > 0.0 and not (-0.5 * full <= x < full):
            what[i] = FOREIGN
            continue
        step = shortest(x - state[_SEEN], full)
        pause = max(time_s[i] - state[_SEEN_TIME], least_s)
        reach = max_rate * pause + 1.0
        if state[_ANY] == 0.0:
            counts[i] = shortest(x, full)
            what[i] = FOLLOWED
        else:
            base, jumped = state[_COUNT], abs(step) > reach
            if jumped and state[_LOST] == 0.0:
                state[_LOST] = 1.0
                state[_GOOD_COUNT], state[_GOOD], state[_GOOD_TIME] = state[_COUNT], state[_SEEN], state[_SEEN_TIME]
            elif jumped:
                away, back = time_s[i] - state[_GOOD_TIME], shortest(x - state[_GOOD], full)
                possible = max_rate * max(away, least_s) + 1.0
                if away <= RETURN_S and abs(back) <= possible:
                    state[_LOST] = 0.0
                    base, step, pause = state[_GOOD_COUNT], back, max(away, least_s)
            target = base + step
            if state[_LOST] != 0.0:
                what[i] = JUMPED if jumped else WENT_ON
            else:
                # the other way round may have been gone as well; by a rate that is only believed, as soon as half the range is possible
                rate, least = max_rate, full - abs(step)
                if state[_BELIEVED] > 0.0:
                    rate, least = state[_BELIEVED] if pause > PAUSE * least_s else 0.0, 0.5 * full
                if full > 0.0 and rate * pause + 1.0 >= least:
                    state[_UNSURE] = 1.0
                what[i] = UNSURE if state[_UNSURE] != 0.0 else FOLLOWED
            counts[i] = x + (full * math.floor((target - x) / full + 0.5) if full > 0.0 else 0.0)
        state[_ANY], state[_COUNT], state[_SEEN], state[_SEEN_TIME] = 1.0, counts[i], x, time_s[i]
    return counts, what


def _followed(
    recorded: FloatArray, time_s: FloatArray, max_rate: float, full: float, state: FloatArray, least_s: float
) -> tuple[FloatArray, IntArray] | None:
    """Return the counts and codes of `resume_counting` for counts to which nothing happens, else None."""
    if len(recorded) > AT_ONCE:
        own, parts = state.copy(), range(0, len(recorded), AT_ONCE)
        found = [_followed(recorded[i : i + AT_ONCE], time_s[i : i + AT_ONCE], max_rate, full, own, least_s) for i in parts]
        if any(part is None for part in found):
            return None
        state[:] = own
        return np.concatenate([part[0] for part in found if part]), np.full(len(recorded), FOLLOWED)
    any_before, count, seen, seen_s = state[: _SEEN_TIME + 1].tolist()
    if len(recorded) == 0 or state[[_LOST, _UNSURE, _BELIEVED]].any() or not np.isfinite(recorded).all():
        return None
    if full > 0.0 and not ((recorded >= -0.5 * full) & (recorded < 0.5 * full)).all():
        return None
    steps = np.diff(recorded, prepend=seen if any_before else recorded[0])
    reach = max_rate * np.maximum(np.diff(time_s, prepend=seen_s if any_before else time_s[0]), least_s) + 1.0
    turns = np.floor(steps / full + 0.5) if full > 0.0 else 0.0 * steps
    lengths = np.abs(steps - full * turns)
    if (lengths > reach).any() or (full > 0.0 and (reach >= full - lengths).any()):
        return None
    begun = math.floor((count - seen) / full + 0.5) if full > 0.0 and any_before else 0.0
    counts = recorded + full * (begun - np.cumsum(turns))
    state[: _SEEN_TIME + 1] = 1.0, counts[-1], recorded[-1], time_s[-1]
    return counts, np.full(len(counts), FOLLOWED)


resume_counting.usual = _followed


@strict_kernel
def runs_on(
    values: IntArray,
    times: FloatArray,
    value: int,
    time_s: float,
    full: int,
    max_rate: float,
    most: float,
    zero: int,
    least: int,
    longest: float,
) -> bool:
    """Whether nothing at all happens to a counter in (n,) values at the times [s] behind a value at time_s.

    Then every step is one that max_rate [1/s] allows, in no pause more than `most` units were possible, no step passes the end of a range
    of `full` values (0: it has none), none of more than `least` units leads to within `zero` of 0, and no pause exceeds `longest` [s].
    """
    half = full // 2
    for i in range(len(values)):
        step = values[i] - value
        limit = max_rate * (times[i] - time_s) + 1.0
        if abs(step) > limit or limit > most or times[i] - time_s > longest or (full > 0 and not -half <= step < half):
            return False
        if abs(values[i]) <= zero and abs(step) > least:
            return False
        value, time_s = values[i], times[i]
    return True


@strict_kernel
def rests(time_s: FloatArray, recorded: FloatArray, least_s: float) -> IntArray:
    """(k, 2) first and last sample of each stretch of least_s or more over which (n,) recorded counts stay the same; empty cells are
    passed over."""
    found = []
    first = last = -1
    for i in range(len(recorded) + 1):
        if i < len(recorded) and math.isnan(recorded[i]):
            continue
        if first >= 0 and i < len(recorded) and recorded[i] == recorded[first]:
            last = i
            continue
        if first >= 0 and time_s[last] - time_s[first] >= least_s:
            found.append((first, last))
        first = last = i
    out = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        out[k, 0], out[k, 1] = found[k]
    return out
