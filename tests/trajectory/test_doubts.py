"""What becomes of breaks, moments and stands: from when until when a channel is in doubt, what proves it right, and what is said."""

from dataclasses import replace

import numpy as np
import pytest
from cells import FloatArray, cell, motion, record

from lmeasure.core import Status
from lmeasure.recording import Counts, Run
from lmeasure.rig import Rig
from lmeasure.sensors import COUNTER_STATE, lengths_from_counts
from lmeasure.text import message
from lmeasure.trajectory.faults.continuity import EVERY, Away, Break, Continuity, Doubt, Doubts, Shift, StuckCounter
from lmeasure.trajectory.faults.rest_evidence import doubts_of, unseen_steps
from lmeasure.trajectory.faults.rests import Rests

NO_RESTS = Rests(np.empty(0), np.empty(0), np.empty((0, 6)))


def found(
    *breaks: Break,
    away: tuple[Away, ...] = (),
    stood: tuple[StuckCounter, ...] = (),
    clock_s: tuple[float, ...] = (),
    least_mm: float = 0.3,
) -> Continuity:
    return Continuity(breaks, away, stood, 1234.0, np.full(6, least_mm), clock_s)


def at(cable: int, before_s: float, by_mm: float = 2.4, u_mm: float = 0.3) -> Break:
    return Break(cable, before_s, before_s + 0.1, by_mm, u_mm)


def resting(*apart: tuple[float, FloatArray]) -> Rests:
    """Rests that begin at times, with lengths (6,)."""
    begin = np.array([b for b, _ in apart])
    return Rests(begin, begin + 1.0, np.array([length for _, length in apart]))


PLACE = np.array([100.0, -50.0, 30.0, 80.0, -70.0, 20.0])
ELSEWHERE = -PLACE


def off(cable: int, by_mm: float) -> FloatArray:
    return by_mm * np.eye(6)[cable]


def spans(doubts: Doubts) -> list[tuple[int, float, float]]:
    return [(d.cable, d.after_s, d.until_s) for d in doubts.every]


def test_each_break_doubts_its_channel_up_to_the_next() -> None:
    doubts = doubts_of(cell(), found(at(2, 5.0), at(2, 9.0, -1.2), at(4, 7.0, np.nan)), NO_RESTS)
    assert spans(doubts) == [(2, 5.0, 9.0), (4, 7.0, np.inf), (2, 9.0, np.inf)]
    assert {d.status for d in doubts.every} == {Status.ORIGIN_LOST}
    sign = cell().observation_point[2].drum.count_sign
    first = f"channel ch3 jumped by about {sign * 200:+d} counts (within 25) between 5 and 5.1 s: its origin is lost"
    assert tuple(map(str, doubts.notes)) == (
        f"{first}. It fails again at 9 s",
        "channel ch5 does not follow the smooth motion of the tool between 7 and 7.1 s: its origin is lost",
        f"channel ch3 jumped by about {sign * -100:+d} counts (within 25) between 9 and 9.1 s: its origin is lost",
    )


def test_a_doubt_is_about_the_samples_behind_its_beginning_up_to_its_end() -> None:
    doubt = Doubt(1, 2.0, 3.0, Status.JUMP, message("contradiction"))
    assert doubt.mask(np.array([1.9, 2.0, 2.1, 3.0, 3.1])).tolist() == [False, False, True, True, False]
    doubts = Doubts((doubt,))
    assert [doubts.about(1, t) for t in (2.0, 2.1, 3.0, 3.1)] == [False, True, True, False]
    assert not doubts.about(2, 2.5)
    assert EVERY not in range(6)


@pytest.mark.parametrize("piece", [1, 2, 3, 5, 12, 30])
def test_pieces_of_a_run_are_doubted_as_the_whole_is(piece: int) -> None:
    """Doubts and shifts that begin and end between pieces, at their first and last samples, before and behind all; the first and the last
    sample they are about, and none beside."""
    rig = cell()
    time_s, poses = motion(30, rate_hz=10.0)
    run = record(rig, time_s, poses)
    said = message("contradiction")
    ends = [(0, -1.0, 0.3), (1, 0.4, 0.5), (2, 0.9, 1.4), (3, 2.8, 9.0), (4, 5.0, 6.0), (5, -2.0, -1.0), (0, 1.1, 1.1), (EVERY, 1.9, 2.1)]
    doubts = Doubts(
        every=tuple(Doubt(c, float(a), float(b), Status.JUMP, said) for c, a, b in ends),
        shifts=(Shift(1, 0.7, 1.6, 25.0), Shift(1, 2.2, np.inf, -40.0), Shift(5, -1.0, 0.2, 3.0)),
    )
    counters, parts = np.zeros((6, COUNTER_STATE)), []
    for i in range(0, 30, piece):
        own = Counts(time_s[i : i + piece], run.passes[0].channels, run.passes[0].recorded[i : i + piece], source="pass1")
        parts.append(doubts.applied(rig, lengths_from_counts(Run(rig, run.start, (own,), unstated="exact"), counters)))
    counts, flags = np.concatenate([p.counts for p in parts]), np.concatenate([p.flags for p in parts])
    expected = lengths_from_counts(run).counts.copy()
    for shift in doubts.shifts:
        mine = (time_s > shift.after_s) & (time_s <= shift.until_s)
        expected[mine, shift.cable] -= shift.counts
    bad = np.zeros((30, 6), np.bool_)
    for cable, after_s, until_s in ends:
        bad[(time_s > after_s) & (time_s <= until_s), slice(None) if cable == EVERY else cable] = True
    expected[bad] = np.nan
    np.testing.assert_array_equal(counts, expected)
    np.testing.assert_array_equal(flags, np.where(bad.any(axis=1), Status.JUMP, Status.OK))


def test_moments_away_and_stands() -> None:
    away = Away(0, 1.0, 1.2), Away(0, 4.0, 4.2), Away(5, 3.0, 3.2)
    doubts = doubts_of(cell(), found(away=away, stood=(StuckCounter(3, 6.0, np.inf),)), NO_RESTS)
    assert spans(doubts) == [
        (0, 1.0, np.nextafter(1.2, 0.0)), (5, 3.0, np.nextafter(3.2, 0.0)), (0, 4.0, np.nextafter(4.2, 0.0)), (3, 6.0, np.inf)
    ]  # fmt: skip
    assert [d.status for d in doubts.every] == [Status.JUMP] * 3 + [Status.ORIGIN_LOST]
    assert tuple(map(str, doubts.notes)) == (
        "channel ch1 had a short wrong value 2 times, first after 1 s",
        "channel ch6 had a short wrong value after 3 s",
        "channel ch4 does not count from 6 s, although its point moves far",
    )


def test_what_is_said_behind_a_stand() -> None:
    stood = (StuckCounter(3, 6.0, 8.0),)
    goes_on = doubts_of(cell(), found(Break(3, 8.0, np.nextafter(8.0, 9.0), np.nan, np.nan), stood=stood), NO_RESTS)
    assert str(goes_on.notes[-1]) == "channel ch4 did not count until 8 s: its origin is lost"
    assert str(goes_on.notes[0]) == "channel ch4 does not count from 6 s, although its point moves far"
    assert spans(goes_on) == [(3, 6.0, 8.0), (3, 8.0, np.inf)]
    # that of another channel, and what began elsewhere, is something else
    for other in (Break(2, 8.0, 8.1, np.nan, np.nan), Break(3, 7.0, 7.1, np.nan, np.nan)):
        assert any(
            "does not follow the smooth motion" in note for note in map(str, doubts_of(cell(), found(other, stood=stood), NO_RESTS).notes)
        )


@pytest.mark.parametrize(
    ("length", "proved"),
    [
        (PLACE, True),
        (PLACE + off(2, 0.035), True),
        (PLACE + off(2, 0.037), False),
        # three scatters of the others are more than three counts, up to a tenth of a millimetre
        (PLACE + off(2, 0.08) + 0.03 * np.array([1, -1, 0, 1, -1, 1]), True),
        (PLACE + off(2, 0.095) + 0.03 * np.array([1, -1, 0, 1, -1, 1]), False),
        (PLACE + off(2, 0.11) + 0.3 * np.array([1, -1, 0, 1, -1, 1]), False),
        (PLACE + off(2, 0.09) + 0.3 * np.array([1, -1, 0, 1, -1, 1]), True),
        (PLACE + off(4, 0.49), True),
        (PLACE + off(4, 0.51), False),
        (ELSEWHERE, False),
        # where counting began is a place as well
        (np.zeros(6), True),
        (off(2, 0.037), False),
    ],
)
def test_a_rest_where_all_is_back_proves_it(length: FloatArray, proved: bool) -> None:
    rests = resting((1.0, PLACE), (6.0, length))
    doubts = doubts_of(cell(), found(at(2, 3.0)), rests)
    assert bool(doubts.every) is not proved
    assert ("But at the rest at 6 s it is back: no counts are lost" in str(doubts.notes[0])) is proved


def test_what_proves_nothing() -> None:
    back = (6.0, PLACE)
    # a rest before it, one behind its next step, and one while it stands
    assert doubts_of(cell(), found(at(2, 6.0)), resting((1.0, PLACE), back)).every
    assert len(doubts_of(cell(), found(at(2, 3.0), at(2, 5.0)), resting((1.0, PLACE), back)).every) == 1
    assert doubts_of(cell(), found(at(2, 5.0)), resting((1.0, PLACE), back)).every == ()
    stood = (StuckCounter(2, 5.5, 6.5),)
    kept = doubts_of(cell(), found(at(2, 3.0), stood=stood), resting((1.0, PLACE), back))
    assert spans(kept) == [(2, 3.0, np.inf), (2, 5.5, 6.5)]
    assert len(doubts_of(cell(), found(at(2, 3.0), stood=(StuckCounter(2, 5.5, 5.9),)), resting((1.0, PLACE), back)).every) == 1
    # a place that is known of this channel from while it was in doubt itself
    assert doubts_of(cell(), found(at(2, 3.0)), resting((4.0, PLACE), back)).every
    # as many others as a pose asks for, of which three are enough and two are not
    others = [at(j, 5.0, 0.5) for j in (0, 1)]
    assert len(doubts_of(cell(), found(at(2, 3.0), *others), resting((1.0, PLACE), (6.0, PLACE + off(0, 9.0) + off(1, 9.0)))).every) == 2
    others = [at(j, 5.0, 0.5) for j in (0, 1, 3)]
    moved = PLACE + off(0, 9.0) + off(1, 9.0) + off(3, 9.0)
    assert len(doubts_of(cell(), found(at(2, 3.0), *others), resting((1.0, PLACE), (6.0, moved))).every) == 4


def test_what_is_proved_right_proves_others() -> None:
    """Two of them, of whom only the first is back at a place that both know; with its help the second is back where it was meanwhile."""
    first = resting((1.0, PLACE), (4.0, PLACE), (5.0, ELSEWHERE), (8.0, ELSEWHERE))
    doubts = doubts_of(cell(), found(at(0, 3.0), at(1, 3.5, -1.0), at(3, 3.6), at(2, 7.0)), first)
    assert doubts.every == ()


def test_of_many_notes_the_first_are_reported() -> None:
    doubts = doubts_of(cell(), found(*(at(j % 6, 1.0 + j) for j in range(15))), NO_RESTS)
    assert len(doubts.every) == 15
    assert len(doubts.notes) == 13
    assert str(doubts.notes[-1]) == "and 3 more of this kind"
    assert len(doubts_of(cell(), found(*(at(j % 6, 1.0 + j) for j in range(12))), NO_RESTS).notes) == 12


@pytest.mark.parametrize(
    ("clock_s", "determined"),
    [((4.0, 5.0), "4, 5 s"), ((1.0, 2.0, 3.0), "1, 2, 3 s"), ((1.0, 2.0, 3.0, 4.0, 5.0), "1, 2, 3 s and at 2 other times")],
)
def test_steps_of_the_clock_are_said(clock_s: tuple[float, ...], determined: str) -> None:
    (said,) = doubts_of(cell(), found(clock_s=clock_s), NO_RESTS).notes
    assert str(said) == f"all channels jump as if the clock had stepped, after {determined}"


def scaled(scale: float) -> Rig:
    points = cell().observation_point
    return cell().model_copy(
        update={"observation_point": tuple(p.model_copy(update={"drum": p.drum.model_copy(update={"scale": scale})}) for p in points)}
    )


def test_steps_are_said_in_recorded_counts_of_the_channel_that_shows_least() -> None:
    least = np.array([0.3, 0.6, 0.3, np.inf, 0.3, 0.3])
    said = unseen_steps(scaled(2.0), Continuity((), (), (), 1234.0, least))
    assert str(said) == (
        "counter jumps of 100 counts (0.6 mm) or more are detected. The limit comes from the motion's own acceleration, 1230 mm/s2"
        ". Jumps of ch4 are not detected: no four consecutive counts"
    )
    assert "too slowly" not in str(unseen_steps(cell(), found(least_mm=1.0)))
    assert str(unseen_steps(cell(), found(least_mm=1.01))).endswith("For smaller jumps, the sampling is too slow for this speed")
    jitter = replace(found(least_mm=1.5), jitter_mm=np.full(6, 1.0))
    assert str(unseen_steps(cell(), jitter)).endswith("counts (1.5 mm) or more are detected. The limit comes from irregular time stamps")
    for rounded in (0.0, 2.2e-11):
        still = replace(found(least_mm=0.1), acceleration_mm_s2=rounded, jitter_mm=np.zeros(6))
        assert str(unseen_steps(cell(), still)).endswith(
            "counts (0.1 mm) or more are detected. The limit comes from the rounding of the counts"
        )
    (stepped,) = doubts_of(scaled(0.5), found(at(0, 1.0, cell().observation_point[0].drum.count_sign * 2.4)), NO_RESTS).notes
    assert "+100 counts" in str(stepped)
