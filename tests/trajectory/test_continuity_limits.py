"""What a run's counts tell of its channels, at the limits: just inside and just outside of each, by runs made for it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cells import FloatArray, cell, observation_point
from test_continuity_definition import COUNT_MM, RIG, lengths

from lmeasure.core import Status
from lmeasure.rig import Rig
from lmeasure.sensors import Reason
from lmeasure.trajectory.faults.continuity import Break, Continuity, ContinuityFinder

RATE_HZ = 250.0
SHARE = np.array([1.0, -0.8, 0.6, 0.9, -0.7, 0.5])


def going(mm_s: float, n: int = 800, rate_hz: float = RATE_HZ) -> tuple[FloatArray, FloatArray]:
    """Times, and lengths of six channels that go evenly, each by its share."""
    time_s = np.arange(n) / rate_hz
    return time_s, mm_s * np.outer(time_s, SHARE)


def found_in(time_s: FloatArray, mm: FloatArray, rows: int | None = None, rig: Rig = RIG) -> Continuity:
    """In whole counts, in pieces of so many rows."""
    finder, mm = ContinuityFinder(rig), COUNT_MM * np.rint(mm / COUNT_MM)
    for begin in range(0, len(time_s), rows or len(time_s)):
        part = slice(begin, begin + (rows or len(time_s)))
        finder.add(lengths(time_s[part], mm[part]))
    return finder.found()


def test_where_a_scale_refines_counts_rounding_is_that_of_what_is_recorded() -> None:
    """A drum of 0.012 mm a count whose counter is read in quarters of it."""
    point = observation_point("B1", (900.0, 0.0, 0.0), 32)
    points = [point | {"drum": point["drum"] | {"scale": 4.0}}, *cell().to_dict()["observation_point"][1:]]
    least = found_in(*going(0.0), rig=cell(observation_point=points)).least_mm
    np.testing.assert_allclose(least, [0.2 + 2.0 * COUNT_MM / 4.0, *[0.2 + 2.0 * COUNT_MM] * 5])


@pytest.mark.parametrize(("samples", "seen"), [(3, False), (4, True)])
def test_four_samples_tell_a_step(samples: int, seen: bool) -> None:
    time_s, mm = going(10.0, samples)
    mm[2:, 0] += 5.0
    found = found_in(time_s, mm)
    assert [b.cable for b in found.breaks] == [0] * seen
    assert np.isfinite(found.least_mm).all() == seen


@pytest.mark.parametrize(
    ("gaps", "enough"),
    [
        ((0, 4), False), ((1, 5), False), ((2, 6), False), ((3, 7), False), ((4,), True), ((1, 6), True), ((0, 5), True),
        ((0, 1, 2, 3), True),
    ],
)  # fmt: skip
def test_four_counts_on_end_are_needed_of_each_channel(gaps: tuple[int, ...], enough: bool) -> None:
    """Of three on end, whatever there is besides, nothing would have been seen."""
    time_s, mm = going(10.0, 8)
    mm[gaps, 1] = np.nan
    assert np.isfinite(found_in(time_s, mm).least_mm).tolist() == [True, enough, True, True, True, True]


@pytest.mark.parametrize(("samples", "determined"), [(25, "away"), (26, "breaks")])
def test_within_a_tenth_of_a_second_a_channel_is_back(samples: int, determined: str) -> None:
    """From after 0.1 s, for as many samples."""
    time_s, mm = going(50.0)
    mm[25 : 26 + samples, 3] += 4.0
    found = found_in(time_s, mm)
    if determined == "away":
        ((cable, after, until),) = ((a.cable, a.after_s, a.until_s) for a in found.away)
        assert (cable, after, until) == (3, time_s[24], time_s[26 + samples])
        assert found.breaks == ()
    else:
        assert found.away == ()
        assert [b.before_s for b in found.breaks] == [time_s[24], time_s[25 + samples]]


@pytest.mark.parametrize(("samples", "determined"), [(6, 1), (11, 2)])
def test_a_channel_that_runs_off_where_it_stepped_is_told_once(samples: int, determined: int) -> None:
    """Accelerations are taken over 20 ms either way: one and a half times as far a step is seen as one that runs off, too."""
    time_s, mm = going(50.0, 2000)
    mm[30:, 0] += 4.0
    mm[:, 0] += 100.0 * np.maximum(time_s - time_s[30 + samples], 0.0)
    assert len(found_in(time_s, mm).breaks) == determined


@pytest.mark.parametrize("rows", [None, *range(398, 412)])
def test_what_runs_off_gently_is_seen_over_the_longer_stretch_alone(rows: int | None) -> None:
    """By 80 mm/s: over 20 ms 4 m/s2, of which a cable that slips may make 1, over 4 ms what a slip is by itself. From sample to sample all
    tremble by more, which is nothing over 20 ms; wherever the run is cut."""
    time_s, mm = going(50.0)
    mm += 0.03 * np.where(np.arange(len(time_s)) % 2, 1.0, -1.0)[:, None]
    mm[:, 2] += 80.0 * np.maximum(time_s - time_s[404], 0.0)
    (found,) = found_in(time_s, mm, rows).breaks
    assert found.cable == 2
    assert found.before_s <= time_s[404] <= found.after_s
    assert np.isnan(found.by_mm)
    assert found.speed_mm_s[1] - found.speed_mm_s[0] == pytest.approx(80.0, abs=25.0)


def test_where_a_channel_that_stood_goes_on_something_is_lost() -> None:
    """So slowly that neither where it stops nor where it goes on a speed is seen to change; to the end nothing goes on."""
    time_s, mm = going(0.0, 4000)
    mm = np.outer(9.0 * time_s, [1.0, 0.9, 0.8, 0.7, 0.6, 0.5])
    mm[1000:3000, 0] = mm[1000, 0]
    mm[3000:, 0] -= mm[3000, 0] - mm[2999, 0]
    mm[2500:, 2] = mm[2500, 2]
    mm[:, [1, 3]] *= 8.0
    found = found_in(time_s, mm)
    assert [(s.cable, s.until_s) for s in found.stood] == [(0, time_s[3000]), (2, np.inf)]
    (lost,) = (b for b in found.breaks if b.cable == 0)
    assert (lost.before_s, lost.after_s) == (time_s[3000], np.nextafter(time_s[3000], np.inf))
    assert np.isnan([lost.by_mm, lost.u_mm]).all()
    assert all(b.before_s < np.inf for b in found.breaks)


def jumps(mm: FloatArray, at: int, rows: int | None = None) -> tuple[Break, ...]:
    """Of lengths (n, 6) of which the first channel's sample is said to be a jump."""
    time_s, finder = np.arange(len(mm)) / RATE_HZ, ContinuityFinder(RIG)
    for begin in range(0, len(mm), rows or len(mm)):
        part = slice(begin, begin + (rows or len(mm)))
        mask = (np.arange(len(mm)) == at)[part]
        said: Any = None
        reasons = ((Reason(~mask, Status.GAP, said), Reason(mask, Status.JUMP, said)), *[()] * 5)
        finder.add(replace(lengths(time_s[part], mm[part]), reasons=reasons))
    return finder.found().breaks


@pytest.mark.parametrize("rows", [None, 4, 5])
def test_a_jump_is_told_from_the_last_count_before_it(rows: int | None) -> None:
    """Within twice the most that it went from sample to sample in the three before, and what slips."""
    mm = np.zeros((9, 6))
    mm[:, 0] = [0.0, 30.0, 33.0, 35.0, 36.0, np.nan, 3000.0, np.nan, np.nan]
    found = max(jumps(mm, 6, rows), key=lambda one: one.by_mm)
    assert (found.cable, found.before_s, found.after_s) == (0, 4 / RATE_HZ, 6 / RATE_HZ)
    assert found.by_mm == pytest.approx(2964.0)
    if rows is None:
        assert found.u_mm == pytest.approx(0.2 + 2.0 * 1.0)
        mm[5:7, 0] = 3000.0, np.nan
        assert max(jumps(mm, 5), key=lambda one: one.by_mm).u_mm == pytest.approx(0.2 + 2.0 * 2.0)
    # of two samples before there is one way
    mm[:, 0] = [0.0, 30.0, 3000.0, *[np.nan] * 6]
    (found,) = jumps(mm, 2)
    assert found.by_mm == pytest.approx(2970.0)
    assert found.u_mm == pytest.approx(60.2)
    # with nothing before there is nothing to tell, nor of an empty cell
    assert jumps(mm, 0) == ()
    assert jumps(mm, 4) == ()
    assert jumps(np.where(np.arange(9)[:, None] == 2, 9.0, np.nan) * np.ones(6), 2) == ()


def test_a_jump_may_be_the_first_sample_of_a_piece() -> None:
    mm = np.zeros((8, 6))
    mm[:, 0] = [1.0, 5.0, 7.0, np.nan, 900.0, np.nan, np.nan, np.nan]
    (found,) = jumps(mm, 4, 4)
    assert (found.before_s, found.after_s) == (2 / RATE_HZ, 4 / RATE_HZ)
    assert found.by_mm == pytest.approx(893.0)
    assert found.u_mm == pytest.approx(0.2 + 2.0 * 2.0, abs=4.0)


@pytest.mark.parametrize(("mm_s", "determined"), [(6.6, True), (4.2, False)])
def test_a_channel_that_runs_off_is_told_where_another_shows_the_tool_on_its_way(mm_s: float, determined: bool) -> None:
    """From 5 mm/s on."""
    time_s, mm = going(mm_s, 2000)
    mm[:, 5] += 80.0 * np.maximum(time_s - time_s[900], 0.0)
    assert [b.cable for b in found_in(time_s, mm).breaks] == [5] * determined


@pytest.mark.parametrize("apart", [5, 6])
def test_of_two_changes_of_speed_within_a_stretch_the_larger_is_reported(apart: int) -> None:
    """Of two farther apart the first, beside which the second is none of its own."""
    time_s, mm = going(50.0, 2000)
    for k, by in ((700, 80.0), (700 + apart, 88.0)):
        mm[:, 1] += by * np.maximum(time_s - time_s[k], 0.0)
    (found,) = found_in(time_s, mm).breaks
    assert found.before_s == time_s[(705 if apart == 5 else 700) - 1]


def test_a_change_of_speed_is_seen_as_soon_as_a_stretch_lies_behind_it() -> None:
    time_s, mm = going(50.0, 706)
    mm[:, 1] += 80.0 * np.maximum(time_s - time_s[700], 0.0)
    (found,) = found_in(time_s, mm).breaks
    assert (found.before_s, found.after_s) == (time_s[699], time_s[701])


@pytest.mark.parametrize(("others", "part", "determined"), [(5, 8.2, True), (5, 7.8, False), (3, 6.35, True), (3, 6.05, False)])
def test_a_channel_changes_its_speed_alone_by_eight_times_what_the_others_do(others: int, part: float, determined: bool) -> None:
    """In the root mean square of five others, of which all change it or some; counts may bend each by four."""
    time_s, mm = going(50.0, 2000)
    of_counts = 4.0 * COUNT_MM / 0.004
    later = np.maximum(time_s - time_s[900], 0.0)
    mm[:, 5] += (1200.0 + of_counts) * later
    for j in range(others):
        mm[:, j] += np.sign(SHARE[j]) * (1200.0 / part + of_counts) * later
    assert [b.cable for b in found_in(time_s, mm).breaks] == [5] * determined


def test_two_channels_that_step_while_nothing_moves_have_not_been_stamped_late() -> None:
    time_s, mm = going(0.0)
    mm[300:, [1, 4]] += [3.0, -2.0]
    found = found_in(time_s, mm)
    assert [(b.cable, b.before_s) for b in found.breaks] == [(1, time_s[299]), (4, time_s[299])]
    assert found.clock_s == ()


@pytest.mark.parametrize(("left", "clock"), [(0.2, True), (0.5, False)])
def test_a_clock_that_stepped_leaves_a_quarter_of_the_largest_step_at_most(left: float, clock: bool) -> None:
    """A tenth of a second, in which the first cable goes 50 mm; the last is off by a part of that besides."""
    time_s, mm = going(500.0)
    mm[300:] += 0.1 * 500.0 * SHARE
    mm[300:, 5] += left * 50.0
    found = found_in(time_s, mm)
    assert (time_s[299] in found.clock_s) == clock
    assert {b.cable for b in found.breaks} == (set() if clock else set(range(6)))


def test_steps_of_one_interval_after_the_other_are_two() -> None:
    time_s, mm = going(50.0)
    mm[300, 2] += 5.0
    mm[301:, 2] += 2.0
    assert [(b.before_s, round(b.by_mm, 1)) for b in found_in(time_s, mm).breaks] == [(time_s[299], 5.0), (time_s[300], -3.0)]


@pytest.mark.parametrize(("every", "held"), [(37, True), (43, False)])
@pytest.mark.parametrize("rows", [None, 4])
def test_a_channel_that_steps_in_a_tenth_of_its_intervals_holds_its_counts(every: int, held: bool, rows: int | None) -> None:
    """Each sample that is late is four steps: there and back, over one interval and over two. What a channel does by nature is no fault; it
    hides steps of twice as much as it is late."""
    time_s, mm = going(300.0, 1200)
    late = np.flatnonzero(np.arange(1160) % every == 5)
    mm[late, 1] = mm[late - 1, 1]
    mm[1180:, 1] += 30.0
    found = found_in(time_s, mm, rows)
    (step,) = (b for b in found.breaks if b.after_s == time_s[1180])
    if held:
        assert len(found.away) + len(found.breaks) == 1
        # by one sample, 0.96 mm, of a speed over twelve of which one is late; over 20 ms it bends the way besides, by twice as much
        bent = (2.0 * 0.96 - 4.0 * COUNT_MM) / 0.02**2
        assert rows or step.u_mm == pytest.approx(0.224 + 2.0 * 0.96 * 12.0 / 11.0 + 2.0 * bent * 0.004**2, rel=0.03)
    else:
        assert len(found.away) == len(late)


def test_a_channel_that_never_moves_holds_nothing() -> None:
    time_s, mm = going(50.0, 60)
    mm[:, 4] = 7.0
    mm[30:, 0] += 4.0
    (step,) = found_in(time_s, mm).breaks
    assert (step.cable, step.before_s) == (0, time_s[29])
