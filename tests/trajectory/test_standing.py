"""Channels that stand on one count: from when until when, by how much their point moves, whatever the pieces a run comes in."""

import numpy as np
import pytest
from cells import FloatArray, cell

from lmeasure.trajectory.faults.continuity import StandingFinder, StuckCounter

RATE_HZ = 100.0
FIRST, LAST = 100, 199  # samples at which the first cable stands


def ways(partner_mm: float = 60.0, others_mm: float = 10.0, moving: int = 4, samples: int = 400) -> tuple[FloatArray, FloatArray]:
    """Times and lengths (n, 6): all cables go evenly, but the first stands from FIRST to LAST, in which time its partner is drawn by
    partner_mm, as many more as are moving by others_mm and the rest by 1 mm."""
    part = np.arange(samples) / (LAST - FIRST)
    drawn = np.array([30.0, partner_mm, *np.where(np.arange(4) < moving, others_mm, 1.0)])
    mm = np.outer(part, drawn)
    mm[FIRST : LAST + 1, 0] = mm[FIRST, 0]
    return np.arange(samples) / RATE_HZ, mm


def stood(time_s: FloatArray, mm: FloatArray, piece: int = 10**6) -> tuple[StuckCounter, ...]:
    finder = StandingFinder(cell())
    for begin in range(0, len(time_s), piece):
        finder.add(time_s[begin : begin + piece], mm[begin : begin + piece])
    return finder.found()


@pytest.mark.parametrize("piece", [1, 7, 100, 101, 10**6])
def test_from_its_first_sample_to_its_last_in_pieces_of_any_size(piece: int) -> None:
    time_s, mm = ways()
    assert stood(time_s, mm, piece) == (StuckCounter(0, time_s[FIRST], time_s[LAST]),)
    # to the end
    assert stood(time_s[: LAST + 1], mm[: LAST + 1], piece) == (StuckCounter(0, time_s[FIRST], np.inf),)


@pytest.mark.parametrize(
    ("partner_mm", "others_mm", "moving", "determined"),
    [(50.1, 5.1, 2, True), (49.9, 5.1, 2, False), (50.1, 5.1, 1, False), (50.1, 4.9, 2, False), (-50.1, -5.1, 4, True)],
)
def test_its_point_moves_far_and_the_tool_with_it(partner_mm: float, others_mm: float, moving: int, determined: bool) -> None:
    time_s, mm = ways(partner_mm, others_mm, moving)
    assert bool(stood(time_s, mm)) is determined


@pytest.mark.parametrize(("samples", "determined"), [(22, True), (20, False)])
def test_it_stands_for_a_fifth_of_a_second(samples: int, determined: bool) -> None:
    """So fast that the point moves far enough in less."""
    time_s, mm = ways(400.0, 60.0)
    mm[FIRST + samples : LAST + 1, 0] += np.arange(1, LAST + 2 - FIRST - samples)
    assert bool(stood(time_s, mm)) is determined


@pytest.mark.parametrize(("samples", "determined"), [(21, True), (20, False)])
def test_a_fifth_of_a_second_from_its_first_sample_to_its_last_is_enough(samples: int, determined: bool) -> None:
    """From 0.2 s to 0.4 s or a sample less."""
    time_s, mm = ways(400.0, 60.0)
    mm[FIRST + samples : LAST + 1, 0] += np.arange(1, LAST + 2 - FIRST - samples)
    assert bool(stood(time_s[: -FIRST + 20], mm[FIRST - 20 :])) is determined


@pytest.mark.parametrize("piece", [1, 7, 50, 10**6])
def test_it_may_stand_from_the_first_sample_on(piece: int) -> None:
    """It is told from there, once its point has moved far; what moves little is not, though nothing was seen of before."""
    time_s, mm = ways()
    later = slice(FIRST, None)
    assert stood(time_s[later], mm[later], piece) == (StuckCounter(0, time_s[FIRST], time_s[LAST]),)
    time_s, mm = ways(40.0, 10.0)
    assert stood(time_s[later], mm[later], piece) == ()


def test_as_short_as_this_it_does_not_stand_at_the_end_of_a_run_either() -> None:
    """A tenth of a second, in which the point moves far."""
    time_s, mm = ways(800.0, 120.0)
    end = FIRST + 11
    assert stood(time_s[:end], mm[:end]) == ()
    assert stood(time_s[: end + 20], mm[: end + 20]) == (StuckCounter(0, time_s[FIRST], np.inf),)


def test_every_time_it_stands_is_told_and_of_each_channel() -> None:
    time_s, mm = ways(samples=800)
    mm[500:600, 0] = mm[500, 0]
    mm[650:, 1] = mm[650, 1]
    mm[:, 0] *= 3.0
    assert stood(time_s, mm) == (StuckCounter(0, time_s[FIRST], time_s[LAST]), StuckCounter(0, 5.0, 5.99), StuckCounter(1, 6.5, np.inf))
    assert stood(time_s, mm, 13) == stood(time_s, mm)


@pytest.mark.parametrize(("empty", "determined"), [(19, True), (21, False)])
def test_empty_cells_end_it_when_they_last(empty: int, determined: bool) -> None:
    """Half-way: neither half alone is long enough for the point to move so far."""
    time_s, mm = ways()
    mm[150 : 150 + empty, 0] = np.nan
    assert bool(stood(time_s, mm)) is determined
    # a piece in which the channel has nothing at all
    assert stood(time_s, mm, 5) == stood(time_s, mm)


@pytest.mark.parametrize(
    ("partner_mm", "by_mm", "determined"), [(44.0, 30.0, False), (-44.0, -30.0, False), (46.0, 30.0, True), (48.0, 3.0, True)]
)
def test_a_partner_that_steps_is_drawn_by_five_millimetres_at_most(partner_mm: float, by_mm: float, determined: bool) -> None:
    time_s, mm = ways(partner_mm)
    mm[150:, 1] += by_mm
    assert bool(stood(time_s, mm)) is determined
    assert bool(stood(time_s, mm, 150)) is determined


@pytest.mark.parametrize(("others_mm", "determined"), [(8.0, False), (9.0, True)])
def test_or_by_twice_the_next_largest_way_between_two_samples(others_mm: float, determined: bool) -> None:
    """At ten samples a second, the partner going 20 mm from one to the next, of which 16 or 18 are believed."""
    mm = np.outer(np.arange(4), [0.0, 20.0, others_mm, 2.0, -3.0, 1.0])
    assert bool(stood(np.arange(4) / 10.0, mm)) is determined
