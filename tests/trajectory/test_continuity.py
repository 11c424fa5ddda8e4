"""What a run's counts tell of its channels, whatever the pieces it comes in: sizes, limits and moments by hand."""

from dataclasses import replace

import numpy as np
import pytest
from cells import FloatArray, cell, record, with_recorded
from test_counter_faults import CORNERS, along, continuity_of, round_trip

from lmeasure.recording import Run
from lmeasure.sensors import Reason
from lmeasure.trajectory import align
from lmeasure.trajectory.faults.continuity import Away, Break, Continuity, ContinuityFinder

COUNT_MM = 0.012


def in_pieces(run: Run, rows: int) -> Continuity:
    """As `continuity_of`, by pieces of so many rows."""
    whole, finder = align(run)._all_lengths, ContinuityFinder(run.rig)
    assert whole.gone_on is not None
    for begin in range(0, len(whole.time_s), rows):
        part = slice(begin, begin + rows)
        reasons = tuple(tuple(Reason(r.mask[part], r.status, r.said) for r in of_cable) for of_cable in whole.reasons)
        piece = replace(
            whole,
            time_s=whole.time_s[part],
            change_mm=whole.change_mm[part],
            counts=whole.counts[part],
            flags=whole.flags[part],
            cause=whole.cause[part],
            cable=whole.cable[part],
            gone_on=whole.gone_on[part],
            reasons=reasons,
        )
        finder.add(piece)
    return finder.found()


def rounded(one: Break) -> tuple[float, ...]:
    return tuple(round(x, 6) for x in (one.cable, one.before_s, one.after_s, np.nan_to_num(one.by_mm), np.nan_to_num(one.u_mm)))


def faulty() -> Run:
    """A step, a moment away, a channel that runs off, one that stands and counts again, jumps behind empty cells and at once."""
    run = round_trip(cell())
    recorded = run.passes[0].recorded.copy()
    recorded[330:, 1] += 400.0
    recorded[720:722, 0] += 3000.0
    recorded[1000:, 4] = recorded[1000, 4] + 33.0 * np.arange(len(recorded) - 1000)
    recorded[100:640, 2] = recorded[100, 2]
    recorded[600:630, 3] = np.nan
    recorded[630:, 3] += 300_000.0
    recorded[1100:, 5] -= 500_000.0
    return with_recorded(run, recorded)


@pytest.mark.parametrize("rows", [23, 101, 331, 1000])
def test_in_pieces_of_any_size_the_same_is_found(rows: int) -> None:
    run = faulty()
    whole, found = continuity_of(run), in_pieces(run, rows)
    assert [(b.cable, round(250 * b.before_s)) for b in whole.breaks] == [(1, 329), (3, 599), (2, 639), (4, 999), (5, 1099)]
    assert whole.away == (Away(0, 719 / 250, 722 / 250),)
    assert [s.cable for s in whole.stood] == [2]
    # summed up in another order, the last digits may differ
    assert [rounded(b) for b in found.breaks] == [rounded(b) for b in whole.breaks]
    assert (found.away, found.stood, found.clock_s) == (whole.away, whole.stood, whole.clock_s)
    assert found.acceleration_mm_s2 == pytest.approx(whole.acceleration_mm_s2, rel=1e-9)
    np.testing.assert_allclose(found.least_mm, whole.least_mm, rtol=1e-9)


def test_jumps_state_the_way_about_them() -> None:
    """Beside 0.2 mm twice the most that the channel goes between two samples just before."""
    run = round_trip(cell())
    recorded = run.passes[0].recorded.copy()
    recorded[750:755, 3] = np.nan
    recorded[755:, 3] += 300_000.0
    (found,) = continuity_of(with_recorded(run, recorded)).breaks
    mm = COUNT_MM * run.rig.observation_point[3].drum.count_sign * recorded[:, 3]
    assert found.by_mm == pytest.approx(mm[755] - mm[749], rel=1e-9)
    assert (found.before_s, found.after_s) == (749 / 250, 755 / 250)
    assert found.u_mm == pytest.approx(0.2, abs=1e-9)
    recorded[:, 3] = run.passes[0].recorded[:, 3] + np.where(np.arange(len(recorded)) < 750, 0.0, 300_000.0)
    (found,) = (b for b in continuity_of(with_recorded(run, recorded)).breaks if abs(b.by_mm) > 3000.0)
    assert found.cable == 3


@pytest.mark.parametrize(("samples", "lost", "determined"), [(2, 150, False), (2, 450, True), (5, 330, True)])
def test_counts_that_are_read_more_often_than_made_hide_no_more_than_they_may(samples: int, lost: int, determined: bool) -> None:
    """Held for two samples, a channel may be late by as much as it goes in them, twice: 3.2 mm where it goes 200 mm/s. By more than in
    eight samples it may not."""
    times, poses = along(CORNERS, 250.0, 250.0, 0.1, 0.5)
    run = record(cell(), times, poses)
    held = run.passes[0].recorded[np.arange(len(times)) // samples * samples].copy()
    speed = np.abs(np.gradient(run.passes[0].recorded[:, 2] * COUNT_MM, times))
    i = int(np.flatnonzero(speed > 200.0)[20]) // samples * samples
    held[i:, 2] += lost * np.sign(run.passes[0].recorded[i + 5, 2] - run.passes[0].recorded[i - 5, 2])
    assert bool(continuity_of(with_recorded(run, held)).breaks) is determined


def test_the_acceleration_is_the_second_largest_over_the_longer_stretch() -> None:
    """Of a motion that speeds up evenly by 2 m/s2 along one axis, as the cables see it."""
    t = np.arange(300) / 500.0
    poses = np.zeros((300, 7))
    poses[:, 0], poses[:, 6] = 1000.0 * np.maximum(t - 0.1, 0.0) ** 2, 1.0
    run = record(cell(), t, poses, exact=True)
    lengths = align(run)._all_lengths
    finder = ContinuityFinder(run.rig)
    finder.add(lengths)
    assert lengths.gone_on is not None
    mm: FloatArray = lengths.gone_on * COUNT_MM
    w = 10
    # whole counts may bend it by four
    sizes = (np.abs(mm[2 * w :] - 2.0 * mm[w:-w] + mm[: -2 * w]) - 4.0 * COUNT_MM) / (w / 500.0) ** 2
    found = finder.found()
    assert found.acceleration_mm_s2 == pytest.approx(np.sort(sizes, axis=1)[:, -2].max(), rel=1e-9)
    # between even samples an acceleration from -A to A is dt^2 A, and twice A is allowed for
    assert found.least_mm.min() == pytest.approx(0.2 + 2.0 * COUNT_MM + 2.0 * found.acceleration_mm_s2 / 500.0**2, rel=1e-9)


@pytest.mark.parametrize(("samples", "determined"), [(3, False), (20, True)])
def test_a_channel_that_holds_its_counts_for_long_does_not_follow(samples: int, determined: bool) -> None:
    run = round_trip(cell())
    held = run.passes[0].recorded.copy()
    held[:, 2] = held[np.arange(len(held)) // samples * samples, 2]
    assert bool(continuity_of(with_recorded(run, held)).breaks) is determined


@pytest.mark.parametrize("lost", [0, 300])
def test_a_channel_that_stops_for_a_moment_and_is_where_it_would_be_has_lost_nothing(lost: int) -> None:
    """At 300 mm/s and more, for 48 ms; with counts lost besides it is not where it would be."""
    run = record(cell(), *along(CORNERS, 400.0, 250.0, 0.2, 0.3))
    recorded = run.passes[0].recorded.copy()
    speed = np.abs(np.gradient(recorded[:, 2] * COUNT_MM, run.passes[0].time_s))
    i = int(np.flatnonzero(speed > 300.0)[10])
    recorded[i : i + 12, 2] = recorded[i, 2]
    recorded[i + 12 :, 2] += lost
    found = continuity_of(with_recorded(run, recorded))
    if lost:
        assert found.away == ()
        assert {b.cable for b in found.breaks} == {2}
    else:
        assert found.breaks == ()
        (away,) = found.away
        assert away.cable == 2
        assert away.after_s <= i / 250 < (i + 12) / 250 <= away.until_s
        assert away.until_s - away.after_s < 0.07
