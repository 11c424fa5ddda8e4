"""Encoders that start again, and values that are no counts: which cells are empty, and what is said of them."""

import sys
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from rigged_feed import cell, frames_of, motion, record_frames

from lmeasure.acquisition import counter_fields, import_logs, write_import
from lmeasure.acquisition.bus.frames import frames_from_messages, join
from lmeasure.acquisition.counters.assembly import counts_from_frames
from lmeasure.acquisition.counters.decoders import is_no_value
from lmeasure.io.tables import read_table
from lmeasure.recording import read_run
from lmeasure.rig import read_rig, rig_from_dict
from lmeasure.text import Say

CASES = Path(__file__).parents[1] / "authorities"
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import recordings_origins as inputs  # noqa: E402
from recordings_study import study  # noqa: E402


def imported(case: str, log: str, folder: Path) -> tuple[np.ndarray, Any, Any]:
    """Counts, the events' table, and the import."""
    found = import_logs([CASES / case / log], read_rig(CASES / case / "rig.toml"), np.array([0.0, 0, 0, 0, 0, 0, 1]))
    write_import(folder, found)
    return read_run(folder).passes[0].recorded, read_table(folder / "pass1.events.csv"), found


def test_a_boot_up_ends_the_origin_wherever_the_count_goes_on(tmp_path: Path) -> None:
    got, events, _ = imported("boot-up-off-zero", "boot.log", tmp_path / "run")
    want = np.arange(40)[:, None] * np.array([10.0, -14, 30, -28, 50, -42])
    want[20:, 2] = np.nan
    np.testing.assert_array_equal(got, want)
    reported = dict(zip(events.text("kind"), zip(events.text("sample"), events.numbers("time_s"), strict=True), strict=True))
    time_s = read_run(tmp_path / "run").passes[0].time_s
    assert reported["heartbeat"] == reported["reset"] == ("24", time_s[24])


def test_values_that_mean_not_available_are_no_counts(tmp_path: Path) -> None:
    got, events, found = imported("j1939-not-available", "na.log", tmp_path / "run")
    want = np.arange(20)[:, None] * np.array([10.0, 14, 30, 28, 50, 42])
    want[8:11, 1] = want[12, 2] = np.nan
    np.testing.assert_array_equal(got, want)
    rows = [r for r in zip(events.text("kind"), events.text("sample"), events.text("channel"), strict=True) if r[0] != "gap_step"]
    assert rows == [("no_value", s, c) for s, c in (("8", "ch2"), ("9", "ch2"), ("10", "ch2"), ("12", "ch3"))]
    # 3 of 20 values are more than a twentieth, and what gaps may hide is stated
    assert "channel ch2: 15 % of its values are reserved, error or not available in J1939" in found.summary()
    assert (
        "which are no counts: the sensor reports errors, or its message uses all values; if they are counts, set whole_range = true"
        in found.summary()
    )
    assert "largest counter jump that a gap can hide: ch2 38 units (0.46 mm) at sample 11, ch3 37 units" in found.summary()
    russian = "\n".join(map(Say("ru").message, found.summary().splitlines()))
    assert "наибольший скачок счётчика, который может скрыть пропуск: ch2: 38 единиц (0,46 мм) в замере 11, ch3: 37 единиц" in russian


ALL = {name: (rig, messages, check) for name, rig, messages, check in [*inputs.restarts(), *inputs.no_values()]}


@pytest.mark.parametrize("name", ALL)
def test_inputs_of_an_independent_writer(name: str) -> None:
    rig, messages, check = ALL[name]
    if rig.can_table.decoder == "cia406":  # nobody is there to be asked
        assert check(inputs.read(rig, messages).logs[0].counts.recorded) == ""
        return
    for size in (len(messages), 11):
        pieces = [frames_from_messages(messages[a : a + size], "log") for a in range(0, len(messages), size)]
        assert check(counts_from_frames(rig, pieces, counter_fields(rig)).counts.recorded) == ""


def test_random_reboots_leave_no_count_wrong_by_more_than_the_stated_step() -> None:
    lines, wrong = study(40, seed=2)
    assert wrong == 0, "\n".join(lines)


@pytest.mark.parametrize(("name", "content", "reported"), inputs.error_frames(), ids=[name for name, _, _ in inputs.error_frames()])
def test_states_of_controllers_are_told_apart_in_every_dialect(
    name: str, content: str | bytes | list[can.Message], reported: list[Any]
) -> None:
    assert inputs.errors_of(name, content)[0] == reported


def test_a_restart_is_recorded_live_as_it_is_imported(tmp_path: Path) -> None:
    """By an independent count: channel 6 is empty from the first SYNC behind the boot-up."""
    rig = cell()
    counts = motion(rig)
    frames = frames_of(rig, counts)
    middle = 7 * 300
    boot = frames_from_messages([can.Message(arbitration_id=0x706, is_extended_id=False, data=[0], timestamp=counts.time_s[300] - 1e-4)])
    whole = join([frames.take(slice(middle)), boot, frames.take(slice(middle, None))])
    recording, run, events = record_frames(rig, whole, tmp_path / "run")
    want = counts.recorded.copy()
    want[300:, 5] = np.nan
    np.testing.assert_array_equal(run.passes[0].recorded, want)
    assert recording.faults == {"heartbeat": 1, "reset": 1}
    assert [int(s) for s in events["sample"]] == [300, 300]
    again = import_logs([tmp_path / "run" / "pass1.log"], rig, None)
    np.testing.assert_array_equal(again.logs[0].counts.recorded, want)


@pytest.mark.parametrize("moving", [0, 1])
def test_encoders_that_are_switched_on_while_nothing_moves_lose_nothing(moving: int) -> None:
    """A boot-up before the first count; where the others had moved by then nobody knows from where that encoder counts."""
    messages = inputs.Recording(
        lambda row, n: None if n == 3 and row < 30 else moving * 10 * n * row + 5, others=((30, inputs.boot(3)),)
    ).messages()
    rig = inputs.rig()
    got = counts_from_frames(rig, [frames_from_messages(messages, "log")], counter_fields(rig))
    assert np.isfinite(got.counts.recorded[30:, 2]).all() == (not moving)


def test_by_their_own_timers_restarts_and_missing_values_empty_the_same_cells() -> None:
    channel = [{"channel": f"ch{n}", "pgn": 65268, "source_address": n} for n in range(1, 7)]
    rig = inputs.rig({"decoder": "j1939", "channel": channel})
    rows, instead = np.arange(60), {(20, 2): 0xFFFFFFFF}
    messages = [m for m in inputs.sent_by_j1939(32, "little", instead) if m.arbitration_id != 0x80]
    recorded = counts_from_frames(rig, [frames_from_messages(messages, "log")], counter_fields(rig)).counts.recorded
    # a row lies between two readings of the others
    assert set(np.flatnonzero(np.isnan(recorded[1:-1, 1])) + 1) == {20, 21}
    np.testing.assert_array_equal(recorded[:, 0], 3 * rows)
    messages = inputs.Recording(others=((30, inputs.boot(3)),)).messages()
    free = rig_from_dict(inputs.rig().to_dict() | {"can": {"decoder": "raw", "timing": "free", "channel": [
        {"channel": f"ch{n}", "id": 0x180 + n} for n in range(1, 7)]}})  # fmt: skip
    got = counts_from_frames(free, [frames_from_messages(messages, "log")], counter_fields(free))
    assert np.isfinite(got.counts.recorded[1:29, 2]).all()
    assert np.isnan(got.counts.recorded[31:, 2]).all()
    assert {(e.kind, e.sample) for e in got.events.kept} >= {("heartbeat", 30), ("reset", 30)}


def test_names_of_values_that_are_none() -> None:
    for name in ("Invalid", "SNA", "NotAvailable", "not available", "Signal_Not_Available", "SensorError", "ERR", "n/a", "No_Value"):
        assert is_no_value(name)
    for name in ("No error", "NoError", "ErrorFree", "valid", "Off", "Snap", "Inverted"):
        assert not is_no_value(name)


def test_error_frames_keep_their_class_in_the_log_that_is_recorded(tmp_path: Path) -> None:
    rig = cell()
    counts = motion(rig)
    frames = frames_of(rig, counts).take(slice(0, 7 * 50))
    said = [(0x40, b""), (0x04, b"\x00\x20"), (0x04, b"\x00\x01"), (0x88, b"\x00\x00\x02")]
    errors = frames_from_messages(
        [can.Message(arbitration_id=i, is_error_frame=True, data=d, timestamp=counts.time_s[20] - 1e-4) for i, d in said]
    )
    recording, _, events = record_frames(
        rig, join([frames.take(slice(7 * 20)), errors, frames.take(slice(7 * 20, None))]), tmp_path / "run"
    )
    assert recording.faults == {"bus_off": 1, "error_passive": 1, "bus_error": 2}
    assert events["sample"] == ["20"] * 4
    assert "20000004#0020" in (tmp_path / "run" / "pass1.log").read_text()
