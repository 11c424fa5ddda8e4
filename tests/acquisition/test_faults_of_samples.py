"""What becomes of single frames that are lost, doubled, late or wrong: the sample, the event, its number, time and channel; and when
samples are given, against the rule written out."""

import itertools
from dataclasses import replace

import can
import numpy as np
import pytest
from rigged_feed import PER_SAMPLE, cell, frames_of, motion, order_of

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.frames import Frames, TimestampSource, frames_from_messages, join, no_frames
from lmeasure.acquisition.counters.assembly import counts_from_frames, new_assembler
from lmeasure.acquisition.counters.samples import SyncAssembler
from lmeasure.rig import rig_from_dict

RIG = cell()
COUNTS = motion(RIG)
FIELDS = counter_fields(RIG)
N, PERIOD_S = 10, 0.002
STEPS = np.arange(1.0, N + 1)
MOVING = replace(COUNTS, time_s=PERIOD_S * STEPS, recorded=np.multiply.outer(STEPS, np.arange(10.0, 70.0, 10.0)))
FRAMES = replace(frames_of(RIG, MOVING), timestamp_source="kernel")


def at(sample: int, channel: int = 0) -> int:
    """Where a channel's frame of a sample stands, or its SYNC."""
    return PER_SAMPLE * sample + channel


def moved(*moves: tuple[int, int]) -> list[int]:
    """The frames' order with one of them behind another, once or several times."""
    order = list(range(len(FRAMES)))
    for first, behind in moves:
        order.remove(first)
        order.insert(order.index(behind) + 1, first)
    return order


def more(*doubled: tuple[int, int]) -> list[int]:
    """The frames' order, with a frame once more behind another."""
    order = list(range(len(FRAMES)))
    for frame, behind in doubled:
        order.insert(order.index(behind) + 1, frame)
    return order


def pieces(frames: Frames, size: int) -> list[Frames]:
    return [frames.take(slice(a, a + size)) for a in range(0, len(frames), size)]


Said = list[tuple[int, str, str, str]]
CASES: dict[str, tuple[list[int], list[tuple[int, int]], Said]] = {
    "a gap in the last sample": ([i for i in range(len(FRAMES)) if i != at(9, 4)], [(9, 4)], [(9, "ch4", "gap", "")]),
    "a double": (more((at(5, 2), at(5, 2))), [], [(5, "ch2", "duplicate", "")]),
    "a double in the last sample": (more((at(9, 2), at(9, 6))), [], [(9, "ch2", "duplicate", "")]),
    "thrice the same": (more((at(5, 2), at(5, 2)), (at(5, 2), at(5, 4))), [], 2 * [(5, "ch2", "duplicate", "")]),
    "two values": (more((at(6, 3), at(5, 4))), [(5, 3)], [(5, "ch3", "conflict", "180, 210")]),
    "five values": (
        more(*((at(i, 3), at(5, 6)) for i in range(4))), [(5, 3)], [(5, "ch3", "conflict", "180, 120, 90, 60")]
    ),
    "late": (moved((at(4, 5), at(5, 3))), [], [(4, "ch5", "reordered", "after the next SYNC")]),
    "late twice in a row": (
        moved((at(4, 5), at(5, 3)), (at(5, 5), at(6, 3))), [], [(i, "ch5", "reordered", "after the next SYNC") for i in (4, 5)]
    ),
    "late from the first sample": (moved((at(0, 1), at(1))), [], [(0, "ch1", "reordered", "after the next SYNC")]),
    "early into the last sample": (moved((at(9, 2), at(8, 6))), [], [(9, "ch2", "reordered", "before its SYNC")]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_single_frames(name: str) -> None:
    order, empty, said = CASES[name]
    expected = MOVING.recorded.copy()
    for sample, channel in empty:
        expected[sample, channel - 1] = np.nan
    for size in (len(order), 3 * PER_SAMPLE, 5):
        got = counts_from_frames(RIG, pieces(order_of(FRAMES, order), size), FIELDS)
        np.testing.assert_array_equal(got.counts.recorded, expected)
        np.testing.assert_allclose(got.counts.time_s, MOVING.time_s, rtol=0, atol=1e-12)
        faults = [e for e in got.events.kept if e.kind != "gap_step"]
        assert [(e.sample, e.channel, e.kind, e.text) for e in faults] == said
        assert [e.time_s for e in faults] == [MOVING.time_s[sample] for sample, *_ in said]


@pytest.mark.parametrize(("later", "same"), [(0.0, True), (0.24, True), (0.3, False)])
def test_a_sync_at_once_after_another_is_the_same(later: float, same: bool) -> None:
    """By a quarter of the period; the start input goes with the SYNCs that are kept."""
    rig = rig_from_dict(RIG.to_dict() | {"can": RIG.can_table.model_dump() | {"start_input": {"id": 0x300}}})
    before, double, after = FRAMES.take(slice(0, at(6) + 1)), FRAMES.take(slice(at(6), at(6) + 1)), FRAMES.take(slice(at(6) + 1, None))
    double = replace(double, time_s=double.time_s + later * PERIOD_S)
    cut = at(8) - at(6) - 1
    high = can.Message(timestamp=float(after.time_s[cut]), arbitration_id=0x300, is_extended_id=False, data=[1])
    rises = frames_from_messages([high], "kernel")
    frames = join([before, double, after.take(slice(0, cut)), rises, after.take(slice(cut, None))])
    got = counts_from_frames(rig, [frames], FIELDS)
    kept = np.arange(N) if same else np.r_[np.arange(6), 6, np.arange(6, N)]
    assert got.events.tally["gap"] == (0 if same else 6)
    assert len(got.counts.time_s) == len(kept)
    known = np.isfinite(got.counts.recorded)
    np.testing.assert_array_equal(
        got.counts.recorded[known], (MOVING.recorded if same else np.insert(MOVING.recorded, 6, 0, axis=0))[known]
    )
    assert known.sum() >= (N - 3) * len(RIG.channels)  # a count that comes an interval late may be in doubt for a few samples
    np.testing.assert_array_equal(got.counts.sync, kept >= 8)
    event = got.events.kept[0]
    assert (event.channel, event.time_s) == (("", double.time_s[0]) if same else ("ch1", FRAMES.time_s[at(6)]))


def test_a_sync_that_comes_too_early_with_frames_before_it_is_one() -> None:
    """And of three SYNCs nobody knows the period."""
    stamps = FRAMES.time_s.copy()
    stamps[at(6) : at(7)] = stamps[at(5)] + 0.1 * PERIOD_S
    got = counts_from_frames(RIG, [replace(FRAMES, time_s=stamps)], FIELDS)
    np.testing.assert_allclose(got.counts.time_s, stamps[::PER_SAMPLE], rtol=0, atol=1e-12)
    assert "duplicate_sync" not in got.events.tally
    for count, left in ((4, 3), (3, 3)):
        syncs = FRAMES.take(np.array([at(i) for i in range(count)]))
        times = np.r_[syncs.time_s[:-1], syncs.time_s[-2] + 0.1 * PERIOD_S]
        assert len(new_assembler(RIG, FIELDS).feed(replace(syncs, time_s=times), last=True).time_s) == left


def test_the_start_input_is_remembered_and_read_where_it_stands() -> None:
    """From one batch to the next; a frame that ends before its byte says nothing."""
    rig = rig_from_dict(RIG.to_dict() | {"can": RIG.can_table.model_dump() | {"start_input": {"id": 0x300, "byte_offset": 1, "bit": 2}}})
    reported = [can.Message(timestamp=0.0, arbitration_id=0x300, is_extended_id=False, data=data) for data in ([0, 4], [0])]
    high, short = (frames_from_messages([message], "kernel") for message in reported)
    parts = [FRAMES.take(slice(at(a), at(b))) for a, b in ((0, 3), (3, 5), (5, 8), (8, N))]
    got = counts_from_frames(rig, [parts[0], high, parts[1], join([short, parts[2]]), parts[3]], FIELDS)
    np.testing.assert_array_equal(got.counts.sync, np.arange(N) >= 3)


def test_what_devices_say_and_frames_that_do_not_fit_are_told_with_the_next_sample() -> None:
    assembler = new_assembler(RIG, FIELDS)
    assembler.feed(FRAMES.take(slice(0, at(5))))
    emergency = can.Message(
        timestamp=float(FRAMES.time_s[at(5) - 1]), arbitration_id=0x83, is_extended_id=False, data=[0x10, 0x42, 9, 0, 0, 0, 0, 0]
    )
    short = can.Message(timestamp=emergency.timestamp, arbitration_id=0x182, is_extended_id=False, data=[1, 2])
    assert assembler.given == 0
    assembler.feed(frames_from_messages([emergency, short], "kernel"))
    assert not assembler.events.kept  # until their sample is known
    assembler.feed(FRAMES.take(slice(at(5), at(8))), last=True)
    said, unfit = (e for e in assembler.events.kept if e.channel and e.kind != "gap")
    assert (said.sample, said.time_s, said.channel, said.kind) == (5, MOVING.time_s[5], "ch3", "emcy")
    # that of the SYNC before it
    assert (unfit.sample, unfit.time_s, unfit.channel, unfit.kind, unfit.text) == (
        4, MOVING.time_s[4], "ch2", "short_frame", "fewer than 4 bytes",
    )  # fmt: skip
    before = new_assembler(RIG, FIELDS)
    before.feed(frames_from_messages([short], "kernel"), last=True)
    assert (before.events.kept[0].sample, before.events.kept[0].time_s) == (0, emergency.timestamp)
    table = {"decoder": "raw", "channel": [{"channel": c, "id": 0x181 + i, "bits": 16} for i, c in enumerate(RIG.channels)]}
    rig = rig_from_dict(RIG.to_dict() | {"can": table})
    far = replace(MOVING, recorded=MOVING.recorded + 65536 - 55 - 10.0 * np.arange(6) * (np.arange(6) > 0))
    wider = new_assembler(rig, counter_fields(rig))
    wider.feed(replace(frames_of(RIG, far), timestamp_source="kernel"), last=True)
    event = next(e for e in wider.events.kept if e.kind == "wider")
    column = far.of(event.channel)
    passes = int(np.flatnonzero(column[:-1] // 65536 != column[1:] // 65536)[0]) + 1
    assert (event.sample, event.time_s, event.text) == (passes, MOVING.time_s[passes], "the byte behind its 16 bits counts on")


@pytest.mark.parametrize("source", ["kernel", "host"])
def test_a_sample_is_given_when_nothing_can_change_it(source: TimestampSource) -> None:
    """The next but one has begun, and 16 intervals show the period; by stamps of a host, the first second is over too."""
    slowly = 500.0 if source == "host" else 1.0
    many = replace(MOVING, time_s=PERIOD_S * np.arange(1.0, 21.0), recorded=np.ones((20, 6)))
    frames = replace(frames_of(RIG, many), timestamp_source=source)
    if source == "host":
        assert len(new_assembler(RIG, FIELDS).feed(frames).time_s) == 0
    for samples, given in ((5, 3 if source == "host" else 0), (16, 14 if source == "host" else 0), (17, 15), (20, 18)):
        assembler = new_assembler(RIG, FIELDS)
        first = assembler.feed(replace(frames, time_s=frames.time_s * slowly).take(slice(0, at(samples))))
        assert assembler.given == len(first.time_s) == given
        rest = assembler.feed(no_frames(), last=True)
        np.testing.assert_array_equal(np.vstack([first.recorded, rest.recorded]), many.recorded[:samples])


@pytest.mark.parametrize("seed", range(3))
def test_stamps_of_a_busy_host_by_the_rule_written_out(seed: int) -> None:
    """Each is the earliest that 0.95 of the period before every later one allows, and no earlier than a tenth of that after what was given.
    What is 0.3 s old is given, else what three intervals of that length follow; nothing before the first second is over."""
    rng = np.random.default_rng(seed)
    pace = np.where(rng.random(260) < 0.9, 0.01, 0.0)
    # for half a second always two at once, so that none is at its own pace
    pace[214:260:2], pace[215:260:2] = 0.0199, 1e-4
    for begin, length in ((60, 20), (100, 3), (140, 45), (200, 12)):
        pace[begin] += 0.01 * length
        pace[begin + 1 : begin + length] = 1e-4
    stamps = np.cumsum(pace + 1e-5 * rng.random(260))
    many = replace(MOVING, time_s=stamps, recorded=np.ones((260, 6)))
    frames = replace(frames_of(RIG, many), time_s=np.repeat(stamps, PER_SAMPLE), timestamp_source="host")
    assembler, given, last_s = new_assembler(RIG, FIELDS), 0, -np.inf
    assert isinstance(assembler, SyncAssembler)
    cuts = np.unique(np.r_[0, 2, rng.integers(3, 260, 60), 260])
    for begin, end in itertools.pairwise(cuts.tolist()):
        got = assembler.feed(frames.take(slice(at(begin), at(end))))
        waiting = stamps[given:end]
        expected, known = waiting.copy(), len(waiting)
        if end <= 3:
            known = 0  # nobody knows the period yet
        elif len(waiting) > 1:
            intervals = np.diff(stamps[:end])
            lag = min(64, len(intervals) // 8) or 1
            means = sorted(intervals[i : i + lag].mean() for i in range(len(intervals) - lag + 1))
            third = len(means) // 3
            least = 0.95 * float(np.mean(means[third : len(means) - third]))
            for i in range(len(waiting)):
                expected[i] = min(waiting[j] - (j - i) * least for j in range(i, len(waiting)))
                expected[i] = max(expected[i], last_s + 0.1 * least * (i + 1))
            follow = [i + 1 for i in range(len(waiting) - 3) if (np.diff(waiting)[i : i + 3] >= least).all()]
            known = int((waiting < waiting[-1] - (0.3 if given else 1.0)).sum())
            known = max([known, *(follow if given or known else ())])
        ready = min(max(len(waiting) - 2, 0), known)
        np.testing.assert_allclose(got.time_s, expected[:ready], rtol=0, atol=1e-12)
        given, last_s = given + ready, float(expected[ready - 1]) if ready else last_s
    assert given == assembler.given > 200
    assert assembler.stamps_moved_s > 0.1


def test_where_a_clock_goes_back_times_go_on_by_a_period() -> None:
    """By that of the SYNCs, or a millisecond where they do not tell it; the next double where a period is lost in the time."""
    back = np.where(np.arange(len(FRAMES)) >= at(6), FRAMES.time_s - 1.0, FRAMES.time_s)
    for size in (len(FRAMES), 5):
        got = counts_from_frames(RIG, pieces(replace(FRAMES, time_s=back), size), FIELDS)
        np.testing.assert_allclose(got.counts.time_s, MOVING.time_s, rtol=0, atol=1e-9)
        (event,) = got.events.kept
        assert (event.sample, event.kind, event.text) == (6, "time", "back by 0.998 s")
    for times, expected in (([5.0, 4.0], [5.0, 5.001]), ([1e17] * 4, 1e17 + 16.0 * np.arange(4))):
        syncs = replace(FRAMES.take(np.array([0, 1] * len(times))), time_s=np.repeat(times, 2))
        np.testing.assert_allclose(new_assembler(RIG, FIELDS).feed(syncs, last=True).time_s, expected, rtol=2e-16)


def test_a_leap_is_told_with_the_number_of_its_sample() -> None:
    """Whatever batch it is in."""
    changed = MOVING.recorded + 100_000.0
    changed[7:, 1] -= 90_000.0
    frames = replace(frames_of(RIG, replace(MOVING, recorded=changed)), timestamp_source="kernel")
    for size in (len(frames), 9):
        got = counts_from_frames(RIG, pieces(frames, size), FIELDS)
        assert [(e.sample, e.kind, e.channel, e.time_s) for e in got.events.kept] == [(7, "jump", "ch2", MOVING.time_s[7])]


def test_of_the_last_two_that_were_stamped_at_once_the_earlier_is_brought_back() -> None:
    """Behind a pause of the host, when nothing else is held back."""
    stamps = np.r_[0.01 * np.arange(150.0), 3.0, 3.0001]
    many = replace(MOVING, time_s=stamps, recorded=np.ones((152, 6)))
    frames = replace(frames_of(RIG, many), time_s=np.repeat(stamps, PER_SAMPLE), timestamp_source="host")
    assembler = new_assembler(RIG, FIELDS)
    first = assembler.feed(frames)
    np.testing.assert_allclose(first.time_s, stamps[:150], rtol=0, atol=1e-12)
    rest = assembler.feed(no_frames(), last=True)
    np.testing.assert_allclose(rest.time_s, [3.0001 - 0.95 * 0.01, 3.0001], rtol=0, atol=1e-12)
    assert assembler.stamps_moved_s == pytest.approx(0.95 * 0.01 - 0.0001)
