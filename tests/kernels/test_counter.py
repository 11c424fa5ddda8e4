"""A finite counter against its rules said again, slowly, on counters so small that every limit is met."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels import BELIEVED_AT, EMPTY, FOLLOWED, FOREIGN, JUMPED, PAUSE, STATE, UNSURE, WENT_ON, resume_counting, runs_on
from lmeasure.kernels.counter import RETURN_S, shortest


def follow(recorded: FloatArray, time_s: FloatArray, max_rate: float, full: float) -> tuple[FloatArray, IntArray]:
    """Return what a whole recording is, in one piece."""
    found: tuple[FloatArray, IntArray] = resume_counting(recorded, time_s, max_rate, full, np.zeros(STATE), 0.0)
    return found


def nearest(step: float, full: int) -> float:
    """Of all steps that look alike the one from half a range back to less than half a range on."""
    return next(step + k * full for k in range(-9, 10) if -full / 2 <= step + k * full < full / 2) if full else step


@dataclass
class Sample:
    recorded: float
    time_s: float
    count: float = 0.0


class Reference:
    """A counter as its rules say it."""

    def __init__(self, max_rate: float, full: int, least_s: float, believed: float) -> None:
        self.max_rate, self.full, self.least_s, self.believed = max_rate, full, least_s, believed
        self.seen: Sample | None = None
        self.good: Sample | None = None
        self.lost = self.unsure = False

    def way(self, sample: Sample, time_s: float) -> float:
        """How far it may have gone since a sample, and a count of rounding."""
        return self.max_rate * max(time_s - sample.time_s, self.least_s) + 1.0

    def next(self, x: float, time_s: float) -> tuple[float, int]:
        if np.isnan(x):
            return np.nan, EMPTY
        if self.full and not -self.full / 2 <= x < self.full:
            return np.nan, FOREIGN
        if self.seen is None:
            self.seen = Sample(x, time_s, nearest(x, self.full))
            return self.seen.count, FOLLOWED
        since = self.seen
        jumped = abs(nearest(x - since.recorded, self.full)) > self.way(since, time_s)
        if jumped and not self.lost:
            # a step that could not be loses the origin
            self.lost, self.good = True, since
        elif jumped and self.good is not None and time_s - self.good.time_s <= RETURN_S:
            # another one finds it again, soon, and where it could have come
            self.lost = abs(nearest(x - self.good.recorded, self.full)) > self.way(self.good, time_s)
            since = since if self.lost else self.good
        self.seen = Sample(x, time_s, since.count + nearest(x - since.recorded, self.full))
        if self.lost:
            return self.seen.count, JUMPED if jumped else WENT_ON
        pause = max(time_s - since.time_s, self.least_s)
        if self.believed and pause <= PAUSE * self.least_s:
            return self.seen.count, UNSURE if self.unsure else FOLLOWED
        other = self.full / 2 if self.believed else self.full - abs(nearest(x - since.recorded, self.full))
        if self.full and (self.believed or self.max_rate) * pause + 1.0 >= other:
            self.unsure = True
        return self.seen.count, UNSURE if self.unsure else FOLLOWED


@settings(max_examples=600, deadline=None, derandomize=True)
@given(
    steps=st.lists(st.tuples(st.integers(-9, 9), st.sampled_from([0.0, 0.02, 0.04, 0.11]), st.integers(0, 9)), min_size=1, max_size=14),
    full=st.sampled_from([0, 16, 8]),
    rate=st.sampled_from([50.0, 100.0]),
    least_s=st.sampled_from([0.0, 0.03]),
    cut=st.integers(0, 14),
    believed=st.sampled_from([0.0, 25.0]),
)
def test_a_counter_is_what_its_rules_say(
    steps: list[tuple[int, float, int]], full: int, rate: float, least_s: float, cut: int, believed: float
) -> None:
    x, t = 0, 10.0
    recorded, times = [], []
    for step, pause, kind in steps:
        x, t = x + step, t + pause
        shown = (x + full // 2) % full - full // 2 if full else x
        # an empty cell, what no counter shows, a signed counter or one from zero on
        other = {0: np.nan, 1: full + 0.0, 2: -full / 2 - 1.0} | dict.fromkeys((3, 4, 5), float(x % full)) if full else {0: np.nan}
        recorded.append(other.get(kind, float(shown)))
        times.append(t)
    reference = Reference(rate, full, least_s, believed)
    expected = [reference.next(a, b) for a, b in zip(recorded, times, strict=True)]
    values, time_s, state = np.array(recorded), np.array(times), np.zeros(STATE)
    state[BELIEVED_AT] = believed
    parts = [
        resume_counting(values[part], time_s[part], rate, float(full), state, least_s) for part in (slice(None, cut), slice(cut, None))
    ]
    np.testing.assert_array_equal(np.concatenate([p[1] for p in parts]), [kind for _, kind in expected])
    np.testing.assert_array_equal(np.concatenate([p[0] for p in parts]), [count for count, _ in expected])
    if least_s == 0.0 and not believed:
        whole = follow(values, time_s, rate, float(full))
        np.testing.assert_array_equal(whole[0], [count for count, _ in expected])
        np.testing.assert_array_equal(whole[1], [kind for _, kind in expected])


@pytest.mark.parametrize(
    ("step", "full", "found"), [(8.0, 16.0, -8.0), (-8.0, 16.0, -8.0), (7.5, 16.0, 7.5), (25.0, 16.0, -7.0), (99.0, 0.0, 99.0)]
)
def test_the_shortest_step(step: float, full: float, found: float) -> None:
    assert shortest(step, full) == found


def test_limits_of_what_a_counter_shows() -> None:
    """Signed or from zero on: -8 to 15, and neither 16 nor -8.5; the first count is a signed one."""
    counts, what = follow(np.array([15.0, 16.0, -1.0, -8.5, 0.0, -8.0]), np.arange(6.0), 2.0, 16.0)
    assert what.tolist() == [FOLLOWED, FOREIGN, FOLLOWED, FOREIGN, FOLLOWED, JUMPED]
    np.testing.assert_array_equal(counts, [-1.0, np.nan, -1.0, np.nan, 0.0, -8.0])
    assert follow(np.array([-8.0]), np.zeros(1), 2.0, 16.0)[0][0] == -8.0


@settings(max_examples=400, deadline=None, derandomize=True)
@given(
    steps=st.lists(st.tuples(st.integers(-5, 5), st.sampled_from([0.0, 1.0, 2.0])), min_size=0, max_size=5), start=st.integers(-4, 4),
    full=st.sampled_from([0, 6, 8]), most=st.sampled_from([2.0, 3.0, 5.0]), zero=st.integers(0, 2), least=st.integers(0, 3),
    longest=st.sampled_from([1.5, np.inf]),
)  # fmt: skip
def test_a_counter_to_which_nothing_happens_runs_on(
    steps: list[tuple[int, float]], start: int, full: int, most: float, zero: int, least: int, longest: float
) -> None:
    values = start + np.cumsum([0, *(s for s, _ in steps)])
    times = 7.0 + np.cumsum([0.0, *(t for _, t in steps)])
    allowed = 2.0 * np.diff(times) + 1.0
    step = np.diff(values)
    expected = bool(
        (np.abs(step) <= allowed).all()
        and (allowed <= most).all()
        and (np.diff(times) <= longest).all()
        and (not full or ((step >= -(full // 2)) & (step < full // 2)).all())
        and not ((np.abs(values[1:]) <= zero) & (np.abs(step) > least)).any()
    )
    assert runs_on(values[1:].astype(np.int64), times[1:], start, 7.0, full, 2.0, most, zero, least, longest) == expected


@pytest.mark.parametrize(("back_s", "again"), [(0.1, FOLLOWED), (0.125, WENT_ON)])
def test_a_jump_back_within_a_tenth_of_a_second_was_a_wrong_number(back_s: float, again: int) -> None:
    counts, what = follow(np.array([100.0, 9000.0, 101.0, 102.0]), np.array([0.0, 0.0625, back_s, back_s + 0.0625]), 50.0, 0.0)
    assert what.tolist() == [FOLLOWED, JUMPED, again if again == FOLLOWED else JUMPED, again]
    np.testing.assert_array_equal(counts, [100.0, 9000.0, 101.0, 102.0])


@pytest.mark.parametrize(
    ("believed", "least_s", "pause_s", "full", "kind"),
    [
        # in a pause of 4 s it may have gone 0.5 * 4 and a count of rounding: half a range of 6, and less than half of one of 8
        (0.5, 1.0, 4.0, 6.0, UNSURE),
        (0.5, 1.0, 4.0, 8.0, FOLLOWED),
        # two and a half usual intervals are no pause yet, and within none it goes nowhere, whatever is believed
        (100.0, 1.0, 2.5, 6.0, FOLLOWED),
        (100.0, 1.0, 2.75, 6.0, UNSURE),
        (100.0, 1.0, 1.0, 4.0, FOLLOWED),
    ],
)
def test_what_a_motion_makes_believe_of_pauses(believed: float, least_s: float, pause_s: float, full: float, kind: int) -> None:
    state = np.zeros(STATE)
    state[BELIEVED_AT] = believed
    _, what = resume_counting(np.array([0.0, 1.0]), np.array([10.0, 10.0 + pause_s]), 1000.0, full, state, least_s)
    assert what.tolist() == [FOLLOWED, kind]
