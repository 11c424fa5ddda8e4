"""The assemblers, fed in pieces: where a batch ends must not matter, and channels on their own timers meet at one instant."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from rigged_feed import PER_SAMPLE, cell, frames_of, motion, order_of

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.frames import PIECE_FRAMES, Frames, TimestampSource, frames_from_messages, join, no_frames, pieces
from lmeasure.acquisition.counters.assembly import counts_from_frames, new_assembler
from lmeasure.acquisition.counters.samples import pace
from lmeasure.core import AcquisitionError
from lmeasure.rig import Rig, rig_from_dict

RIG = cell()
COUNTS = motion(RIG)
FRAMES = frames_of(RIG, COUNTS).take(slice(0, 100 * PER_SAMPLE))
FIELDS = counter_fields(RIG)


ROWS = st.integers(1, 60) | st.integers(1, len(FRAMES) - 2)
"""Of frames: more of them at the start, while little is known."""


@settings(deadline=None, max_examples=60)
@given(
    faults=st.lists(st.tuples(ROWS, st.sampled_from(["drop", "double", "swap"])), max_size=12),
    source=st.sampled_from(["log", "kernel", "host"]),
    cuts=st.lists(ROWS, max_size=8),
)
@example(faults=[*[(8, "drop")] * 4, (7, "double"), (9, "drop"), *[(1, "drop")] * 6], source="log", cuts=[3])
@example(faults=[*[(8, "drop")] * 4, (7, "drop"), (9, "double"), *[(1, "drop")] * 6], source="host", cuts=[7])
def test_where_a_batch_ends_does_not_matter(faults: list[tuple[int, str]], source: TimestampSource, cuts: list[int]) -> None:
    order = list(range(len(FRAMES)))
    for i, what in faults:
        if what == "drop" and i < len(order):
            del order[i]
        elif what == "double" and i < len(order):
            order.insert(i, order[i])
        elif what == "swap" and i + 1 < len(order):
            order[i], order[i + 1] = order[i + 1], order[i]
    frames = replace(order_of(FRAMES, order), timestamp_source=source)
    ends = sorted(min(cut, len(frames)) for cut in cuts)
    batches = [frames.take(slice(a, b)) for a, b in zip([0, *ends], [*ends, len(frames)], strict=True)]
    whole, cut = counts_from_frames(RIG, [frames], FIELDS), counts_from_frames(RIG, batches, FIELDS)
    np.testing.assert_array_equal(cut.counts.recorded, whole.counts.recorded)
    # the SYNC's period is estimated from what is known by then, so a burst's times may differ by parts of a period
    np.testing.assert_allclose(cut.counts.time_s, whole.counts.time_s, rtol=0, atol=2e-3)
    assert cut.events.tally == whole.events.tally


@pytest.mark.parametrize("later_s", [0.0, 2e-5])
@pytest.mark.parametrize("source", ["log", "host"])
def test_a_stream_in_which_every_frame_is_doubled_is_used_once(later_s: float, source: TimestampSource) -> None:
    doubled = FRAMES.take(np.repeat(np.arange(len(FRAMES)), 2))
    stamps = doubled.time_s + later_s * (np.arange(len(doubled)) % 2)
    got = counts_from_frames(RIG, [replace(doubled, time_s=stamps, timestamp_source=source)], FIELDS)
    np.testing.assert_array_equal(got.counts.recorded, COUNTS.recorded[:100])
    np.testing.assert_allclose(got.counts.time_s, COUNTS.time_s[:100], rtol=0, atol=1e-4)
    assert got.events.tally == {"duplicate_sync": 100, "duplicate": 600}


def test_a_log_that_was_stamped_in_ticks_keeps_its_length() -> None:
    """Of 16 ms, as by Windows: three of four SYNCs have the stamp of the one before."""
    counts = motion(RIG, 400.0, 200.0)
    frames = frames_of(RIG, counts)
    stamps = np.ceil(frames.time_s / 0.016) * 0.016
    got = counts_from_frames(RIG, [replace(frames, time_s=stamps, timestamp_source="log")], FIELDS)
    np.testing.assert_array_equal(got.counts.recorded, counts.recorded)
    np.testing.assert_allclose(got.counts.time_s, counts.time_s, rtol=0, atol=0.016)
    assert not got.events.tally


def test_a_log_is_assembled_in_pieces_of_its_own() -> None:
    """Whatever batches the reader of its format hands over."""
    frames = frames_of(RIG, COUNTS)
    many = join([frames] * (PIECE_FRAMES // len(frames) + 2))
    whole = list(pieces([many]))
    for size in (1000, PIECE_FRAMES + 1):
        cut = list(pieces(many.take(slice(a, a + size)) for a in range(0, len(many), size)))
        assert [len(p) for p in cut] == [len(p) for p in whole] == [PIECE_FRAMES, len(many) - PIECE_FRAMES]
        np.testing.assert_array_equal(join(cut).identifier, many.identifier)


def test_stamps_of_a_busy_host_are_brought_back_before_its_pause() -> None:
    stamps = FRAMES.time_s.copy()
    # nothing was stamped between 30 and 60 ms; then all of it at once
    late = (stamps > 0.03) & (stamps < 0.06)
    stamps[late] = 0.06 - 1e-5 * np.arange(late.sum())[::-1] / late.sum()
    assembler = new_assembler(RIG, FIELDS)
    got = assembler.feed(replace(FRAMES, time_s=stamps, timestamp_source="host"), last=True)
    np.testing.assert_array_equal(got.recorded, COUNTS.recorded[:100])
    # 5 % of 30 ms: the SYNCs in between are only known to keep 0.95 of the period
    np.testing.assert_allclose(got.time_s, COUNTS.time_s[:100], rtol=0, atol=1.6e-3)
    assert 0.025 < assembler.stamps_moved_s < 0.03
    assert got.u_time_s is None  # latched together


def free_rig(**table: Any) -> Rig:
    data = RIG.to_dict()
    data["can"] = {
        "decoder": "j1939",
        "channel": [{"channel": f"ch{i}", "pgn": 0xFF00 + i, "byte_order": "big", "start": 1_000_000} for i in range(1, 7)],
    } | table
    return rig_from_dict(data)


def free_frames(rig: Rig, jitter_s: float = 0.0) -> tuple[Frames, Any]:
    """Each channel sends every 10 ms by its own timer, out of step with the others: 30 mm/s on channel 1 and so on."""
    import can

    rng = np.random.default_rng(0)
    messages = []
    for i in range(6):
        for k in range(150):
            t = 0.01 * k + 0.0017 * i
            value = 1_000_000 + round((i + 1) * 2500.0 * t)
            stamp = t + jitter_s * rng.standard_normal()
            data = value.to_bytes(4, "big") + bytes(4)
            messages.append(can.Message(timestamp=stamp, arbitration_id=0x0CFF0020 + ((i + 1) << 8), data=data))
    return frames_from_messages(sorted(messages, key=lambda m: m.timestamp), "kernel"), rng


def test_channels_on_their_own_timers_meet_at_one_instant() -> None:
    rig = free_rig()
    frames, _ = free_frames(rig)
    got = counts_from_frames(rig, [frames.take(slice(0, 331)), frames.take(slice(331, None))], counter_fields(rig))
    counts = got.counts
    inside = (counts.time_s >= 0.01) & (counts.time_s < 1.48)
    want = counts.time_s[:, None] * 2500.0 * np.arange(1, 7)
    # each reading is rounded to a whole count
    assert np.abs(counts.recorded - want)[inside].max() <= 0.5 + 1e-6
    assert set(got.events.tally) <= {"gap"}
    assert np.isnan(counts.recorded[0, 1:]).all()
    assert counts.u_time_s is not None
    assert counts.u_time_s.max() < 1e-9


def test_the_jitter_of_the_stamps_is_reported() -> None:
    rig = free_rig()
    frames, _ = free_frames(rig, jitter_s=3e-4)
    counts = counts_from_frames(rig, [frames], counter_fields(rig)).counts
    assert counts.u_time_s is not None
    assert counts.u_time_s[-1] == pytest.approx(3e-4, rel=0.25)
    want = counts.time_s[:, None] * 2500.0 * np.arange(1, 7)
    inside = (counts.time_s >= 0.02) & (counts.time_s < 1.47)
    error_s = (counts.recorded - want)[inside, 5] / 15000.0
    # 1.5 ms before a reading and 8.5 ms after the one before it: a weighted mean of two stamps
    assert error_s.std() == pytest.approx(3e-4 * np.hypot(0.85, 0.15), rel=0.25)


def test_a_stuck_channel_by_its_own_timer_has_no_frames_either() -> None:
    rig = free_rig()
    frames, _ = free_frames(rig)
    own = (frames.identifier >> 8) & 0xFF == 3
    late = own & (frames.time_s > 0.4)
    data = frames.data.copy()
    data[late] = data[np.flatnonzero(own & ~late)[-1]]
    got = counts_from_frames(rig, [replace(frames, data=data)], counter_fields(rig))
    counts = got.counts
    assert counts.frames is not None
    assert got.events.tally["stall"] == 1
    stuck = np.isnan(counts.of("ch3"))
    assert np.isnan(counts.frames[1:][stuck[1:], 2]).all()
    assert stuck[50:].all()
    assert np.isfinite(counts.frames[50:-2, [0, 1, 3, 4, 5]]).all()


@pytest.mark.parametrize("tick_s", [0.004, 0.016, 0.020])
def test_timers_behind_a_serial_adapter_make_no_jumps_and_their_uncertainty_is_reported(tick_s: float) -> None:
    """Encoders that send every 10 ms, given over every 16 ms: most intervals are 0.02 or 16 ms, whose median deviation is nothing."""
    rig = free_rig()
    frames, _ = free_frames(rig)
    ticks = np.ceil(frames.time_s / tick_s - 1e-9) * tick_s
    stamps = ticks + 2e-5 * (np.arange(len(ticks)) - np.searchsorted(ticks, ticks))
    got = counts_from_frames(rig, [replace(frames, time_s=stamps, timestamp_source="host")], counter_fields(rig))
    assert set(got.events.tally) <= {"gap"}
    assert got.counts.u_time_s is not None
    rate = 2500.0 * np.arange(1, 7)
    off_s = (got.counts.recorded / rate - got.counts.time_s[:, None])[5:-5]
    # late by half a tick all of them, which moves nothing against another
    off_s -= off_s.mean()
    assert off_s.std() < got.counts.u_time_s[-1] < 4.0 * max(off_s.std(), 1e-3)


def test_a_silent_channel_leaves_gaps_and_doubles_are_used_once() -> None:
    rig = free_rig()
    frames, _ = free_frames(rig)
    third = (frames.identifier >> 8) & 0xFF == 3
    kept = frames.take(~(third & (frames.time_s > 0.5) & (frames.time_s < 0.7)))
    doubled = join([kept.take(slice(0, 100)), kept.take(slice(99, 100)), kept.take(slice(100, None))])
    got = counts_from_frames(rig, [doubled], counter_fields(rig))
    silent = np.isnan(got.counts.recorded[:, 2])
    assert (got.counts.time_s[silent][1:-1] > 0.49).all()
    assert 18 <= silent.sum() <= 23
    assert got.events.tally["duplicate"] == 1


def as_recorded(frames: Frames) -> tuple[Any, list[Any]]:
    """The assembler of frames that are taken every 50 ms, as the recorder does, and what it gave."""
    cuts = np.searchsorted(frames.time_s, np.arange(0.0, frames.time_s[-1] + 0.05, 0.05))
    assembler = new_assembler(RIG, FIELDS)
    parts = [assembler.feed(frames.take(slice(a, b))) for a, b in zip(cuts, [*cuts[1:], len(frames)], strict=True)]
    return assembler, [*parts, assembler.feed(no_frames(), last=True)]


def test_a_long_pause_of_a_busy_host_does_not_pass_for_a_faster_sync() -> None:
    """A seventh of a second stamped at once: more of the SYNCs at hand follow each other in microseconds than at their own pace."""
    frames = frames_of(RIG, COUNTS).take(slice(0, 400 * PER_SAMPLE))
    late = (frames.time_s > 0.2) & (frames.time_s < 0.35)
    stamps = np.where(late, 0.35 - 1e-6 * np.arange(len(late))[::-1] / len(late), frames.time_s)
    busy = replace(frames, time_s=stamps, timestamp_source="host")
    assembler, parts = as_recorded(busy)
    time_s = np.concatenate([p.time_s for p in parts])
    # of the little that there is before the first second is over
    np.testing.assert_allclose(time_s, COUNTS.time_s[:400], rtol=0, atol=0.025)
    assert not assembler.events.tally


@pytest.mark.parametrize("rate_hz", [175.0, 667.0, 1000.0])
@pytest.mark.parametrize("tick_s", [0.004, 0.016])
def test_an_adapter_that_hands_over_many_frames_at_once_makes_no_jumps(rate_hz: float, tick_s: float) -> None:
    """A serial adapter gives every 16 ms what came meanwhile: most SYNCs are stamped 0.14 ms after the last one."""
    counts = motion(RIG, 1800.0, rate_hz)
    frames = frames_of(RIG, counts)
    ticks = np.ceil(frames.time_s / tick_s - 1e-9) * tick_s
    stamps = ticks + 2e-5 * (np.arange(len(ticks)) - np.searchsorted(ticks, ticks))
    busy = replace(frames, time_s=stamps, timestamp_source="host")
    assembler, parts = as_recorded(busy)
    np.testing.assert_array_equal(np.vstack([p.recorded for p in parts]), counts.recorded)
    assert not assembler.events.tally
    np.testing.assert_allclose(np.concatenate([p.time_s for p in parts]), counts.time_s, rtol=0, atol=tick_s)


@pytest.mark.parametrize("from_s", [0.05, 0.1])
def test_a_host_that_is_busy_at_once_makes_no_jumps(from_s: float) -> None:
    """30 SYNCs are stamped at once behind the first ten or twenty: their own pace is in the minority for long."""
    counts = motion(RIG, 1800.0, 200.0)
    frames = frames_of(RIG, counts)
    late = (frames.time_s > from_s) & (frames.time_s < from_s + 0.15)
    stamps = np.where(late, from_s + 0.15 - 1e-6 * np.arange(len(late))[::-1] / len(late), frames.time_s)
    busy = replace(frames, time_s=stamps, timestamp_source="host")
    assembler, parts = as_recorded(busy)
    assert not assembler.events.tally
    np.testing.assert_allclose(np.concatenate([p.time_s for p in parts]), counts.time_s, rtol=0, atol=0.025)


def test_pauses_of_the_bus_do_not_pass_for_a_slower_sync() -> None:
    rng = np.random.default_rng(3)
    intervals = 0.005 + 1e-5 * rng.standard_normal(1000)
    for stops in (1, 3, 5):
        stopped = intervals.copy()
        stopped[rng.choice(1000, stops, replace=False)] = 10.0
        assert pace(stopped) == pytest.approx(0.005, rel=1e-3)


@pytest.mark.parametrize(("at_once", "intervals"), [(64, 512), (64, 1024), (32, 256), (16, 135), (1, 15), (1, 1)])
def test_a_host_that_hands_over_as_many_at_once_as_are_compared_is_timed_exactly(at_once: int, intervals: int) -> None:
    """Of stretches of 64 intervals, or an eighth of all, each has the same length."""
    stamped = np.zeros(intervals)
    stamped[at_once - 1 :: at_once] = 0.005 * at_once
    assert pace(stamped) == pytest.approx(0.005, rel=1e-9)


@pytest.mark.parametrize("stops", [4, 6])
def test_a_pause_counts_where_it_is_in_a_third_of_the_stretches(stops: int) -> None:
    """Each is in 64 of the 961 stretches of 1024 intervals."""
    intervals = np.full(1024, 0.005)
    intervals[150 * np.arange(1, stops + 1)] = 1.0
    assert (pace(intervals) == pytest.approx(0.005, rel=1e-9)) == (stops < 5)


def test_the_start_input_goes_by_the_order_of_the_frames_not_by_their_stamps() -> None:
    """A busy host stamps 30 ms of frames at once; the SYNCs among them are brought back, and the input with them. The first batch holds no
    sample, and the column is there all the same."""
    import can

    rig = rig_from_dict(RIG.to_dict() | {"can": RIG.can_table.model_dump() | {"start_input": {"id": 0x300}}})
    rise = frames_from_messages([can.Message(timestamp=0.0405, arbitration_id=0x300, is_extended_id=False, data=[1])])
    at = 41 * PER_SAMPLE
    mixed = join([FRAMES.take(slice(0, at)), rise, FRAMES.take(slice(at, None))])
    late = (mixed.time_s > 0.03) & (mixed.time_s < 0.06)
    stamps = np.where(late, 0.06 - 1e-6 * np.arange(len(late))[::-1], mixed.time_s)
    busy = replace(mixed, time_s=stamps, timestamp_source="host")
    for batches in ([busy], [busy.take(slice(0, 3)), busy.take(slice(3, None))]):
        counts = counts_from_frames(rig, batches, counter_fields(rig)).counts
        assert counts.sync is not None
        np.testing.assert_array_equal(counts.sync, np.arange(100) >= 41)


def test_the_start_input_of_free_running_encoders_goes_by_time() -> None:
    import can

    table = RIG.can_table.model_dump() | {"start_input": {"id": 0x300}, "timing": "free"}
    rig = rig_from_dict(RIG.to_dict() | {"can": table})
    changes = [(0.0202, 1), (0.0602, 0), (0.0802, 1)]
    reported = frames_from_messages([can.Message(timestamp=t, arbitration_id=0x300, is_extended_id=False, data=[s]) for t, s in changes])
    mixed = join([FRAMES, reported])
    mixed = mixed.take(np.argsort(mixed.time_s, kind="stable"))
    for batches in ([mixed], [mixed.take(slice(a, a + 50)) for a in range(0, len(mixed), 50)]):
        counts = counts_from_frames(rig, batches, counter_fields(rig)).counts
        assert counts.sync is not None
        expected = (counts.time_s >= 0.0202) & ~((counts.time_s >= 0.0602) & (counts.time_s < 0.0802))
        np.testing.assert_array_equal(counts.sync, expected)
        assert 55 < counts.sync.sum() < 65


def test_nothing_at_all_says_what_was_missed() -> None:
    with pytest.raises(AcquisitionError, match="7 frames, but no SYNC 0x80 among them"):
        counts_from_frames(RIG, [replace(FRAMES.take(slice(0, 7)), identifier=np.full(7, 0x333, np.uint32))], FIELDS)
    assert len(new_assembler(RIG, FIELDS).feed(no_frames(), last=True).time_s) == 0


def test_a_clock_that_goes_back_in_a_log_is_marked() -> None:
    stamps = FRAMES.time_s - np.where(np.arange(len(FRAMES)) >= 50 * PER_SAMPLE, 3.0, 0.0)
    for cut in (0, 200, 50 * PER_SAMPLE, 353):
        frames = replace(FRAMES, time_s=stamps, timestamp_source="log")
        got = counts_from_frames(RIG, [frames.take(slice(0, cut)), frames.take(slice(cut, None))], FIELDS)
        np.testing.assert_array_equal(got.counts.recorded, COUNTS.recorded[:100])
        np.testing.assert_allclose(got.counts.time_s, COUNTS.time_s[:100], rtol=0, atol=1e-9)
        assert got.events.tally == {"time": 1}


def held(assembler: Any) -> int:
    """How many numbers an assembler keeps."""
    arrays = [*vars(assembler).values(), *(a for pair in getattr(assembler, "_old", []) + getattr(assembler, "_new", []) for a in pair)]
    return sum(a.size for a in arrays if isinstance(a, np.ndarray))


def test_nothing_grows_when_the_sync_stops() -> None:
    assembler = new_assembler(RIG, FIELDS)
    assembler.feed(FRAMES)
    orphans = FRAMES.take(FRAMES.identifier != 0x80)
    sizes = []
    for _ in range(20):
        assembler.feed(orphans)
        sizes.append(held(assembler))
    assert sizes[-1] == sizes[0] < 3000
    assert assembler.events.tally["missing_sync"] >= 19


def test_a_sync_that_is_missing_takes_its_sample_with_it() -> None:
    """Its frames belong to no sample; the one before keeps its own. A channel or two that send twice are no missing SYNC."""
    gone = 20 * PER_SAMPLE
    frames = FRAMES.take(np.delete(np.arange(len(FRAMES)), gone))
    for batches in ([frames], [frames.take(slice(a, a + 5)) for a in range(0, len(frames), 5)]):
        got = counts_from_frames(RIG, batches, FIELDS)
        kept = np.delete(np.arange(100), 20)
        np.testing.assert_array_equal(got.counts.recorded, COUNTS.recorded[kept])
        np.testing.assert_allclose(got.counts.time_s, COUNTS.time_s[kept], rtol=0, atol=1e-12)
        assert got.events.tally == {"missing_sync": 1}
        (event,) = got.events.kept
        assert (event.sample, event.kind, event.channel) == (20, "missing_sync", "")
        assert event.text == "0.002 s without SYNC, frames of 6 channels without a sample"
    for channels in (1, 3, 4):
        # of so many channels the frames of the sample without its SYNC have come
        frames = FRAMES.take(np.delete(np.arange(len(FRAMES)), [gone, *range(gone + 1 + channels, gone + PER_SAMPLE)]))
        assert counts_from_frames(RIG, [frames], FIELDS).events.tally == {"missing_sync": 1}
    # at the SYNC's own pace a channel that sends twice contradicts itself
    twice = FRAMES.take(np.sort(np.r_[np.arange(len(FRAMES)), np.arange(gone + 1, gone + PER_SAMPLE)]))
    assert counts_from_frames(RIG, [twice], FIELDS).events.tally == {"duplicate": 6}


def test_frames_that_come_before_their_sync_are_put_back() -> None:
    """A channel's frame of a sample before that sample's SYNC; one that only says the same again may as well be a duplicate."""
    moving = replace(COUNTS, recorded=np.multiply.outer(np.arange(len(COUNTS.time_s)), np.arange(10, 70, 10)).astype(np.float64))
    every = frames_of(RIG, moving).take(slice(0, len(FRAMES)))
    order = list(range(len(every)))
    for s in range(3, 97, 3):
        sync, channel = PER_SAMPLE * s, 1 + s % 6
        order.insert(sync, order.pop(sync + channel))
    for size in (len(every), 5):
        frames = order_of(every, order)
        pieces = [frames.take(slice(a, a + size)) for a in range(0, len(frames), size)]
        got = counts_from_frames(RIG, pieces, FIELDS)
        np.testing.assert_array_equal(got.counts.recorded, moving.recorded[:100])
        assert got.events.tally == {"reordered": 32}
        assert {e.text for e in got.events.kept} == {"before its SYNC"}
        assert [e.sample for e in got.events.kept] == list(range(3, 97, 3))
        assert got.events.kept[0].channel == FIELDS[3].channel


def test_two_syncs_with_one_stamp_are_two_instants() -> None:
    stamps = FRAMES.time_s.copy()
    stamps[50 * PER_SAMPLE : 51 * PER_SAMPLE] = stamps[49 * PER_SAMPLE]
    got = counts_from_frames(RIG, [replace(FRAMES, time_s=stamps, timestamp_source="log")], FIELDS)
    assert (np.diff(got.counts.time_s) > 0).all()
    assert got.events.tally == {"time": 1}
    np.testing.assert_array_equal(got.counts.recorded, COUNTS.recorded[:100])


def test_nothing_grows_when_the_first_channel_falls_silent() -> None:
    rig = free_rig()
    frames, _ = free_frames(rig)
    others = frames.take((frames.identifier >> 8) & 0xFF != 1)
    assembler = new_assembler(rig, counter_fields(rig))
    assembler.feed(frames)
    sizes = []
    for k in range(1, 15):
        assembler.feed(replace(others, time_s=others.time_s + 1.5 * k))
        sizes.append(held(assembler))
    assert max(sizes[3:]) <= max(sizes[:3]) < 5000


def test_a_late_frame_is_put_back_even_while_its_sample_is_held() -> None:
    # frame 6 of each third sample comes after the next SYNC; every batch ends somewhere else, stamps of a host hold samples back
    order = list(range(len(FRAMES)))
    for s in range(3, 97, 3):
        a, b = PER_SAMPLE * s + 6, PER_SAMPLE * (s + 1)
        order[a], order[b] = order[b], order[a]
    moving = replace(COUNTS, recorded=np.multiply.outer(np.arange(len(COUNTS.time_s)), np.arange(10, 70, 10)).astype(np.float64))
    frames = replace(order_of(frames_of(RIG, moving).take(slice(0, len(FRAMES))), order), timestamp_source="host")
    for size in range(1, 40):
        assembler = new_assembler(RIG, FIELDS)
        pieces = [assembler.feed(frames.take(slice(a, a + size))) for a in range(0, len(frames), size)]
        pieces.append(assembler.feed(no_frames(), last=True))
        np.testing.assert_array_equal(np.vstack([p.recorded for p in pieces]), moving.recorded[:100])
        assert assembler.events.tally == {"reordered": 32}


def test_a_slow_encoder_that_starts_again_is_found_by_its_leap() -> None:
    changed = np.tile(np.arange(100.0)[:, None] * 3.0, (1, 6)) + 1000.0
    changed[60:, 1] = np.arange(40.0) * 3.0
    fast = cell(max_cable_speed_mm_s=20000.0)  # 1666 counts per sample would be possible
    frames = frames_of(fast, replace(COUNTS, time_s=COUNTS.time_s[:100], recorded=changed))
    got = counts_from_frames(fast, [frames], FIELDS)
    changed[60:, 1] = np.nan
    np.testing.assert_array_equal(got.counts.recorded, changed)
    assert got.events.tally == {"reset": 1}


def test_times_rise_though_a_host_stamps_ever_faster() -> None:
    """For longer than samples are held back: what was given stays before what is brought back later."""
    pace = np.concatenate([np.full(600, 1e-3), np.full(500, 2e-4), np.full(100, 1e-3)])
    still = replace(COUNTS, time_s=np.cumsum(pace), recorded=np.tile(COUNTS.recorded[:1], (len(pace), 1)))
    frames = replace(frames_of(RIG, still), timestamp_source="host")
    _, parts = as_recorded(frames)
    time_s = np.concatenate([p.time_s for p in parts])
    assert len(time_s) == len(pace)
    assert (np.diff(time_s) > 0.0).all()
    assert (time_s <= still.time_s + 1e-9).all()
