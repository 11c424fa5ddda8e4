"""What a run's counts tell of its channels against its definition, written out sample by sample, over random motions with faults."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from math import isfinite

import numpy as np
import pytest
from cells import FloatArray, cell, motion, record

from lmeasure.sensors import Lengths
from lmeasure.trajectory import align
from lmeasure.trajectory.faults.continuity import BINS, Away, Break, Continuity, ContinuityFinder, StandingFinder, off_usual_s, steps_seen

COUNT_MM = 0.012
CHANNELS, RATE_HZ = 6, 250.0
RIG = cell()
PLAIN = align(record(RIG, *motion(10, rate_hz=RATE_HZ)))._all_lengths


def lengths(time_s: FloatArray, mm: FloatArray) -> Lengths:
    """Of counts that went on so, nothing being said of them."""
    return replace(PLAIN, time_s=time_s, gone_on=mm / COUNT_MM, change_mm=mm, reasons=((),) * CHANNELS)


def drawn(seed: int) -> tuple[FloatArray, FloatArray]:
    """Times and lengths (n, m) of channels that follow one motion, each by its share of it, whole counts, with faults."""
    rng = np.random.default_rng(seed)
    # what a cable does for a fiftieth of a run is its habit
    n = 160 if seed % 6 else 640
    time_s = np.arange(n) / RATE_HZ
    bends = np.sort(rng.uniform(0.0, time_s[-1], 4))
    speed = np.interp(time_s, bends, rng.choice([0.0, 80.0, 300.0, -500.0], 4)) if seed % 6 else np.full(n, 400.0)
    share = rng.uniform(-1.0, 1.0, CHANNELS)
    mm = np.outer(np.cumsum(speed) / RATE_HZ, share)
    mm += np.sin(np.outer(time_s, rng.uniform(5.0, 9.0, CHANNELS)))
    # where nothing else bends, one that stops or runs off is seen by that alone
    for kind in rng.integers(6, size=3).tolist() if seed % 6 else [2 + seed % 4 // 2]:
        j, i = int(rng.integers(CHANNELS)) if seed % 6 else int(np.argmax(np.abs(share))), int(rng.integers(20, n - 30))
        match kind:
            case 0:
                mm[i:, j] += rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 4.0)
            case 1:
                mm[i : i + int(rng.integers(1, 32)), j] += rng.uniform(0.5, 5.0)
            case 2:
                mm[i:, j] += rng.uniform(50.0, 600.0) * (time_s[i:] - time_s[i])
            case 3:
                held = i + int(rng.integers(2, 24))
                mm[i:held, j] = mm[i, j]
            case 4:  # the clock
                mm[i:] += rng.uniform(0.01, 0.05) * RATE_HZ * (mm[i] - mm[i - 1])
            case 5:
                mm[i : i + int(rng.integers(1, 9)), j] = np.nan
    if seed % 3 == 1:  # read more often than it counts
        mm[:, 2] = mm[np.arange(n) // 2 * 2, 2]
    if seed % 4 == 2:
        time_s += np.where(rng.random(n) < 0.2, rng.uniform(0.0, 0.0015, n), 0.0)
    if seed % 5 == 3:
        kept = np.sort(rng.permutation(n)[: n - 12])
        time_s, mm = time_s[kept], mm[kept]
    return time_s, COUNT_MM * np.round(mm / COUNT_MM)


def sizes(stamps: FloatArray, mm: FloatArray, w: int, interval: float, off_s: float) -> FloatArray:
    """(n - 2 w, m) accelerations by three samples, less what whole counts and stamps that are off by off_s may make of them."""
    n, m = mm.shape
    time_s, rows = stamps.tolist(), mm.tolist()  # Python's own numbers are quicker one by one
    uneven = (
        max([0.0, *(abs(time_s[i + w] - time_s[i] - w * interval) for i in (*range(n - 2 * w), *range(w, n - w)))]) > 0.02 * w * interval
    )
    out = np.empty((max(n - 2 * w, 0), m))
    for i in range(n - 2 * w):
        before, after = time_s[i + w] - time_s[i], time_s[i + 2 * w] - time_s[i + w]
        for j in range(m):
            a, b, c = rows[i][j], rows[i + w][j], rows[i + 2 * w][j]
            out[i, j] = (abs(a - 2.0 * b + c) - 4.0 * COUNT_MM) / (w * interval) ** 2
            if uneven and isfinite(out[i, j]):
                v1, v2 = (b - a) / before, (c - b) / after
                missed = 2.0 * COUNT_MM + 2.0 * off_s * max(abs(v1), abs(v2))
                by_stamps = (abs(v2 - v1) - missed * (1.0 / before + 1.0 / after)) / ((before + after) / 2.0)
                out[i, j] = min(out[i, j], by_stamps)
    return out


def usual(size: FloatArray) -> float:
    """Of one channel's accelerations (n,), of which each fourth is looked at, the bin up to which all but two hundredths are."""
    some = np.nan_to_num(size[::4])
    return next(float(b) for b in BINS if (some <= b).sum() >= 0.98 * len(some))


def rushes(
    time_s: FloatArray, mm: FloatArray, size: FloatArray, least: FloatArray, w: int, limit: float, interval: float
) -> Iterator[tuple[float, Break]]:
    """Changes of speed that one channel makes by itself, and their size: the least of its own beside what the others may have."""
    slips = 0.4 / (w * interval) ** 2
    there, beside = np.maximum(np.nan_to_num(least), 0.0), np.maximum(np.nan_to_num(size), 0.0)
    for i in range(len(size)):
        at = i + w
        if there[i].max() <= limit + slips:
            continue
        v1, v2 = ((mm[at + k] - mm[at + k - w]) / (time_s[at + k] - time_s[at + k - w]) for k in (0, w))
        for j in range(mm.shape[1]):
            others = [k for k in range(mm.shape[1]) if k != j]
            going = min(np.nan_to_num(np.abs(v[others])).max() for v in (v1, v2)) > 5.0
            alone = there[i, j] > 8.0 * np.sqrt((beside[i, others] ** 2).sum() / len(others))
            largest = np.nan_to_num(least[max(i - w, 0) : i + w + 1, j], nan=-np.inf).max()
            if there[i, j] > limit + slips and alone and going and there[i, j] >= largest:
                length, speed = (float(mm[at, j]), float(mm[at, j])), (float(v1[j]), float(v2[j]))
                yield (float(there[i, j] - slips), Break(j, float(time_s[at - 1]), float(time_s[at + 1]), np.nan, np.nan, length, speed))


def by_definition(time_s: FloatArray, mm: FloatArray) -> tuple[Continuity, set[str]]:
    """What is to be found, and what of it there was besides."""
    n, m = mm.shape
    steps = np.diff(time_s)
    interval, seen = float(np.median(steps)), set[str]()
    off = off_usual_s(time_s, interval)
    every = [c for k in (1, 2) for c in steps_seen(time_s, mm, mm.T, 0, stride=k, count_mm=np.full(m, COUNT_MM), off_s=off)]
    windows = [max(1, round(s / interval)) for s in (0.02, 0.005)]
    # of a motion what it may be, of a channel that is suspected what it is at least
    size, least_size = ([sizes(time_s, mm, w, interval, off_s) for w in windows] for off_s in (0.0, float(off.max())))
    hardest, surely = (
        [max([0.0, *(np.sort(np.nan_to_num(row, nan=-np.inf))[-2] for row in own)]) for own in of] for of in (size, least_size)
    )
    habit = [np.array([usual(column) for column in own.T]) for own in least_size]
    allowed_for = np.maximum(surely[0], habit[0])

    # a channel that steps in more than a tenth of the intervals in which it moves holds its counts, for eight intervals at most
    held = np.zeros(m)
    for j in range(m):
        stepping = [
            (abs(c.by[i, j]), abs(c.going_mm_s[i, j])) for c in every for i in range(len(c.by)) if abs(c.by[i, j]) > c.allowed_mm[i, j]
        ]
        moving = sum(abs(b - a) > COUNT_MM for a, b in pairwise(mm[:, j]))
        if len(stepping) > 0.1 * moving:
            held[j] = min(2.0 * np.quantile([by / max(going, 5.0) for by, going in stepping], 0.95), 8.0 * interval)
            seen.add("held")

    breaks: list[Break] = []
    clock = set[float]()

    def add(new: Break, within_s: float) -> None:
        of_cable = [old for old in breaks if old.cable == new.cable]
        if all(new.before_s >= old.after_s + within_s or new.after_s <= old.before_s - within_s for old in of_cable):
            breaks.append(new)

    for c in every:
        for i in range(len(c.by)):
            allowed = c.allowed_mm[i] + 2.0 * allowed_for * c.geometry_s2[i] + held * np.abs(c.going_mm_s[i])
            beyond = np.abs(c.by[i]) > allowed
            if beyond.sum() >= 2 and np.any(c.going_mm_s[i]):
                late_s = np.linalg.lstsq(c.going_mm_s[i][:, None], c.by[i], rcond=None)[0][0]
                left = np.abs(c.by[i] - late_s * c.going_mm_s[i])
                if np.all(left <= np.maximum(allowed, 0.25 * np.abs(c.by[i]).max())):
                    clock.add(float(c.before_s[i]))
                    continue
            for beyond_it in np.flatnonzero(beyond).tolist():
                add(c.at(i, beyond_it, float(allowed[beyond_it])), 0.0)
    for number, w in enumerate(windows):
        limit = 5.0 * max(hardest[: number + 1])
        for by, one in rushes(time_s, mm, size[number], least_size[number], w, limit, interval):
            if by > limit + 2.0 * habit[number][one.cable]:
                add(one, 1.5 * max((0.02, 0.005)[number], interval))
    standing = StandingFinder(RIG)
    standing.add(time_s, mm)
    for stood in standing.found():
        if stood.until_s < np.inf:
            add(Break(stood.cable, stood.until_s, float(np.nextafter(stood.until_s, np.inf)), np.nan, np.nan), interval)

    lost: list[Break] = []
    away: list[Away] = []
    for new in sorted(breaks, key=lambda b: b.before_s):
        old = next((b for b in reversed(lost) if b.cable == new.cable), None)
        back = False
        if old is not None and new.before_s - old.after_s <= 0.1:
            if np.isfinite(old.by_mm):
                back = abs(old.by_mm + new.by_mm) <= old.u_mm + new.u_mm
            else:
                # where it would be by the mean of its speeds, to within a change of speed in the middle
                gone_s = new.after_s - old.before_s
                missed = abs(new.length_mm[1] - old.length_mm[0] - gone_s * 0.5 * (old.speed_mm_s[0] + new.speed_mm_s[1]))
                back = missed <= 0.2 + 2.0 * surely[0] * gone_s**2 / 4.0 + new.u_mm <= abs(new.by_mm) / 2.0
                seen.add("stopped and came back") if back else None
        if back and old is not None:
            lost.remove(old)
            away.append(Away(new.cable, old.before_s, new.after_s))
        else:
            lost.append(new)

    fine = [k for k in range(n - 1) if steps[k] <= 2.5 * interval]
    geometry = max(float(steps[k]) ** 2 for k in fine)
    least = np.full(m, np.inf)
    for j in range(m):
        ways = [off[k] * abs(mm[k + 1, j] - mm[k, j]) / max(steps[k], interval) for k in fine if np.isfinite(mm[k + 1, j] - mm[k, j])]
        least[j] = 0.2 + 2.0 * COUNT_MM + 2.0 * allowed_for[j] * geometry + 4.0 * max(ways)
    seen |= {"step" if np.isfinite(b.by_mm) else "rush" for b in lost} | ({"away"} if away else set()) | ({"clock"} if clock else set())
    return Continuity(tuple(lost), tuple(away), standing.found(), surely[0], least, tuple(sorted(clock))), seen


def determined(one: Break) -> FloatArray:
    return np.array([one.cable, one.before_s, one.after_s, one.by_mm, one.u_mm, *one.length_mm, *one.speed_mm_s])


def slow(seed: int) -> tuple[FloatArray, FloatArray]:
    """Twenty-five samples a second, which are farther apart than accelerations are taken over."""
    time_s, mm = drawn(seed)
    return 10.0 * time_s, mm


def trembling(seed: int) -> tuple[FloatArray, FloatArray]:
    """All channels together from sample to sample, which over longer stretches is nothing."""
    time_s, mm = drawn(seed)
    return time_s, mm + COUNT_MM * np.rint(15.0 * np.cos(np.pi * np.arange(len(time_s))))[:, None]


def nearly_even(seed: int) -> tuple[FloatArray, FloatArray]:
    """Stamps that are off by a hundredth of an interval are as even as can be; by four they are so over the longer stretches alone."""
    time_s, mm = drawn(seed)
    off = np.random.default_rng(seed).uniform(-1.0, 1.0, len(time_s))
    return time_s + (0.005 if seed % 2 else 0.03) / RATE_HZ * off, mm


def short(seed: int) -> tuple[FloatArray, FloatArray]:
    """From four samples, of which alone a step is told, to a few more than accelerations are taken over."""
    time_s, mm = drawn(seed)
    part = slice(30, 34 + seed // 2)
    return time_s[part], mm[part] + np.outer(np.arange(len(mm[part])) >= 2, [0.0, 3.0, 0.0, 0.0, 0.0, 0.0])


def is_the_definitions(time_s: FloatArray, mm: FloatArray, told_of: str) -> set[str]:
    """Held against it; what was found."""
    finder = ContinuityFinder(RIG)
    finder.add(lengths(time_s, mm))
    found = finder.found()
    expected, seen = by_definition(time_s, mm)
    assert len(found.breaks) == len(expected.breaks), told_of
    for one, other in zip(found.breaks, expected.breaks, strict=True):
        np.testing.assert_allclose(determined(one), determined(other), rtol=1e-7, atol=1e-9, err_msg=told_of)
    assert found.away == expected.away, told_of
    assert (found.stood, found.clock_s) == (expected.stood, expected.clock_s), told_of
    assert found.acceleration_mm_s2 == pytest.approx(expected.acceleration_mm_s2, rel=1e-7)
    np.testing.assert_allclose(found.least_mm, expected.least_mm, rtol=1e-7, err_msg=told_of)
    return seen


def test_what_is_found_is_what_the_definition_says() -> None:
    kinds = set[str]()
    for seed in (*range(24), 90):
        kinds |= is_the_definitions(*drawn(seed), f"{seed}")
    assert kinds >= {"step", "rush", "away", "clock", "held", "stopped and came back"}


@pytest.mark.parametrize("kind", [slow, trembling, nearly_even, short])
def test_at_other_rates_and_of_few_samples_too(kind: Callable[[int], tuple[FloatArray, FloatArray]]) -> None:
    kinds = set[str]()
    for seed in range(20) if kind is short else (1, 2, 3, 4, 5, 12):
        kinds |= is_the_definitions(*kind(seed), f"{kind.__name__} {seed}")
    assert kinds >= {"step", *({"rush"} if kind is not short else {})}


@pytest.mark.parametrize(("seed", "kind"), [(2, drawn), (9, drawn), (12, drawn), (15, drawn), (20, drawn), (2, slow)])
def test_wherever_a_run_is_cut_the_same_breaks_are_found(seed: int, kind: Callable[[int], tuple[FloatArray, FloatArray]]) -> None:
    """In two pieces, the border before, within and behind each fault: what is seen of a fault needs samples of both."""
    time_s, mm = kind(seed)
    whole = ContinuityFinder(RIG)
    whole.add(lengths(time_s, mm))
    # what is allowed for is by habits, of which each piece is asked at samples of its own
    expected = [np.delete(determined(b), 4) for b in whole.found().breaks]
    for cut in range(4, len(time_s), 3 if len(time_s) < 200 else 11):
        finder = ContinuityFinder(RIG)
        for part in (slice(None, cut), slice(cut, None)):
            finder.add(lengths(time_s[part], mm[part]))
        found = [np.delete(determined(b), 4) for b in finder.found().breaks]
        assert len(found) == len(expected), cut
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9, err_msg=f"{cut}")
