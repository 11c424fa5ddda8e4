"""The self-test against drums that a thread turns, over a real (virtual) bus: the rig as it is, and wired wrongly in every way."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from rigged_feed import cell
from test_buses import a_group

from lmeasure.acquisition import Check, Link, Step, corrected, counter_fields, self_test
from lmeasure.acquisition.bus.feed import frames_from_counts, send, virtual_place
from lmeasure.acquisition.bus.frames import frames_from_messages
from lmeasure.acquisition.bus.network import BusWatch
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.acquisition.check.self_test import CableCheck
from lmeasure.core import AcquisitionError
from lmeasure.io import files
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
from lmeasure.workflows import record as check_workflow

pytestmark = pytest.mark.live

RIG = cell(max_cable_speed_mm_s=1e6)  # this person moves in no time


def two_cables() -> Rig:
    data = RIG.to_dict()
    data["cable"] = data["cable"][:2]
    return rig_from_dict(data)


class Bench:
    """Six drums sending at SYNC, and a person who does what is asked; wiring: which channel each cable's drum really counts on."""

    def __init__(self, rig: Rig = RIG, bus: dict[str, Any] | None = None, **faults: Any) -> None:
        self.rig = rig
        self.bus = bus or {"interface": "virtual", "channel": virtual_place()}
        self.fields = counter_fields(rig)
        self.counts = np.linspace(5000.0, 10000.0, len(self.fields))
        self.faults = faults
        self.shown: list[str] = []
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        with can.Bus(**self.bus) as bus:
            k = 0
            while not self._done.is_set():
                k += 1
                shown = np.array(self.counts, np.float64)
                if "trembling" in self.faults:
                    shown[self.faults["trembling"]] += 5 * (k % 3)
                if "foreign" in self.faults:
                    bus.send(can.Message(arbitration_id=self.faults["foreign"], is_extended_id=False, data=b"\0"))
                if "silent" in self.faults:
                    send(frames_from_counts(np.zeros(1), shown[None, :5], self.fields[:5], 0x80), bus, paced=False)
                else:
                    send(frames_from_counts(np.zeros(1), shown[None, :], self.fields, 0x80), bus, paced=False)
                time.sleep(0.005)

    def ask(self, step: Step) -> str:
        assert 1 <= step.number <= step.of
        self.shown.append(step.look() if len(self.shown) < 4 else "")
        self.do(step.text)
        self.shown.append(step.look())
        return ""

    def do(self, text: str) -> None:
        words = text.split()
        names = [c.name for c in self.rig.cable]
        points = [c.from_point for c in self.rig.cable]
        if words[0] == "Pull":
            self._move(names.index(words[2]), 100.0 / 0.012)
        elif text.startswith("Let the swivel"):
            self._turn([s.point for s in self.rig.swivel].index(words[5]), -45.0 + self.faults.get("play_deg", 0.0))
        elif words[0] == "Let":
            self._move(names.index(words[2]), -(100.0 - self.faults.get("slip_mm", 0.0)) / 0.012)
        elif text.startswith("Turn the drum"):
            self._move(points.index(words[4]), 6000.0 * self.faults.get("scale", 1.0))
        elif text.startswith("Turn the swivel"):
            self._turn([s.point for s in self.rig.swivel].index(words[5]), 45.0)
        elif words[0] == "Tilt":
            self._turn(len(self.rig.swivel), -5.0 if "back" in words else 5.0)

    def _turn(self, encoder: int, degrees: float) -> None:
        """As a person does, nearly; codes begin anew after a revolution."""
        at = len(self.rig.cable) + self.faults.get("encoders", range(9))[encoder]
        e = self.rig.sensors[encoder]
        self.counts[at] = (self.counts[at] + round(degrees * 1.1 / 360.0 * self.faults.get("codes", e.counts_per_revolution))) % 2**17

    def _move(self, cable: int, counts: float) -> None:
        wiring = self.faults.get("wiring", range(6))
        self.counts[wiring[cable]] += round(counts) * self.faults.get("sign", 1)
        # the pulley turns a little with its cable
        if self.rig.sensors:
            self.counts[len(self.rig.cable) + cable] += 90

    def check(self) -> Check:
        source = BusSource(lambda: can.Bus(**self.bus), "virtual:bench")
        try:
            return self_test(self.rig, Link(source, self.fields), self.ask, turns=self.faults.get("turns", True), settle_s=0.05)
        finally:
            source.close()

    def close(self) -> None:
        self._done.set()
        self._thread.join()


def run(rig: Rig = RIG, **faults: Any) -> Check:
    bench = Bench(rig, **faults)
    try:
        return bench.check()
    finally:
        bench.close()


def test_a_rig_that_is_wired_right_passes() -> None:
    result = run()
    assert result.all_faults == []
    assert [c.moved for c in result.cables] == [f"ch{i}" for i in range(1, 7)]
    assert [c.counts_per_turn for c in result.cables] == [6000.0] * 6
    assert all(c.stroke_mm == pytest.approx(100.0, abs=0.02) and c.slack_mm == 0.0 and c.direction == 1 for c in result.cables)
    assert 20 < result.rate_hz < 250


@pytest.mark.parametrize(
    ("faults", "reported"),
    [
        (
            {"turns": False, "wiring": [1, 0]},
            ["cable c1: channel ch2 moved, but the rig has channel ch1", "cable c2: channel ch1 moved, but the rig has channel ch2"],
        ),
        ({"scale": 0.5}, [f"cable c{i}: 3000 counts per turn, but the rig has 6000. This is 0.5 times as many" for i in (1, 2)]),
        ({"turns": False, "slip_mm": 2.0}, [f"cable c{i}: came back +1.99" for i in (1, 2)]),
        ({"turns": False, "trembling": 1}, ["channel ch2: moves by 10 counts while at rest"]),
    ],
)
def test_each_wrong_wiring_is_reported(faults: dict[str, Any], reported: list[str]) -> None:
    """Of two cables; exchanged signs are below, where a person is walked through it."""
    lines = run(two_cables(), **faults).all_faults
    assert len(lines) == len(reported)
    for line, start in zip(lines, reported, strict=True):
        assert line.startswith(start)


def test_a_channel_that_does_not_show_stops_the_test() -> None:
    with pytest.raises(AcquisitionError, match="no counts of ch6 within 1 s"):
        run(silent=True)


@pytest.mark.parametrize(
    ("faults", "code", "verdicts", "error"),
    [
        ({}, 0, ["c1 ch1 ch1 +1 100.0 +0.000 6000 / 6000 ok", "c2 ch2 ch2 +1 100.0 +0.000 6000 / 6000 ok", "No corrections"], ""),
        (
            {"wiring": [1, 0], "turns": False, "sign": -1, "foreign": 0x1F5},
            1,
            [
                "fault: cable c1: channel ch2 moved, but the rig has channel ch1",
                "fault: cable c2: channel ch1 moved, but the rig has channel ch2",
                "frames) from a sender that is not in the rig file",
                "cable c1: channel ch1 -> ch2 cable c2: channel ch2 -> ch1 drum of B1: count_sign 1 -> -1 drum of B2: count_sign 1 -> -1",
            ],
            "the first: 1F5h (",
        ),
    ],
)
def test_a_person_is_walked_through_it(faults: dict[str, Any], code: int, verdicts: list[str], error: str, tmp_path: Path) -> None:
    """The command in a process of its own on a real bus; the person reads what it asks, does it, and presses Enter."""
    write_rig(tmp_path / "rig.toml", two_cables())
    group = a_group()
    bench = Bench(two_cables(), {"interface": "udp_multicast", **group}, **faults)
    command = [sys.executable, "-m", "lmeasure", "check", "--rig", str(tmp_path / "rig.toml"), "--write", str(tmp_path / "wired.toml")]
    command += ["--bus", f"udp_multicast:{group['channel']}", "--bus-option", f"port={group['port']}"]
    turns = faults.get("turns", True)
    command += [] if turns else ["--no-turns"]
    requested, after = [], []
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            for line in process.stdout:
                if not line.rstrip().endswith("then press Enter"):
                    after.append(line.rstrip())
                    continue
                number, _, text = line.partition(" ")
                requested.append((number, text))
                bench.do(text)
                # the first fault is looked at again, once
                again = "Type r" in text and sum("Type r" in one for _, one in requested) == 1
                process.stdin.write("r\n" if again else "\n")
                process.stdin.flush()
            complaint = process.stderr.read()
        finally:
            process.kill()
            bench.close()
    assert process.wait() == code, complaint
    assert requested[0][1].startswith("Leave all cables at rest")
    steps = 1 + 2 * (5 if turns else 3)
    assert requested[-1][0].startswith(f"{steps}/{steps}")
    # a question for each cable that was wrong, and the first of them done again
    assert len(requested) == steps + (2 + 1 + 3 if faults else 0)
    shown = " ".join(" ".join(after).split())
    for verdict in verdicts:
        assert verdict in shown
    assert max(map(len, after[: 1 + 2])) <= 80, "the table"
    assert error in complaint
    assert len(complaint.splitlines()) == bool(error)
    wired = read_rig(tmp_path / "wired.toml")
    if faults:
        assert [c.channel for c in wired.cable] == ["ch2", "ch1"]
        # the frames stay with the encoders, though the rig had no table [can] and its channels have another order now
        assert {f.channel: f.identifier for f in counter_fields(wired)} == {"ch1": 0x181, "ch2": 0x182}
        assert [wired.point(c.from_point).drum.count_sign for c in wired.cable] == [-1, -1]
        # frames stay whose they were: without a [can] table the first channel's would be those of node 1
        assert {f.channel: f.identifier for f in counter_fields(wired)} == {f.channel: f.identifier for f in counter_fields(two_cables())}
    else:
        assert wired == two_cables()


def test_a_check_whose_rig_finds_no_room_keeps_what_it_showed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A person has pulled every cable: the table and what would have been corrected are said with the error."""
    write_rig(tmp_path / "rig.toml", RIG)
    found = Check(200.0, {}, tuple(CableCheck(f"c{i}", f"ch{i}", f"ch{i}", -1) for i in range(1, 7)), ())

    def full(path: Path, document: object) -> None:
        raise AcquisitionError(files.not_written(path, OSError(28, "")))

    monkeypatch.setattr(files, "rewrite_toml", full)
    monkeypatch.setattr("lmeasure.acquisition.self_test", lambda *_, **__: found)
    settings = check_workflow.CheckSettings(rig=tmp_path / "rig.toml", bus=f"virtual:{virtual_place()}", write=tmp_path / "wired.toml")
    reported = check_workflow.run_check(settings, ask=lambda step: "")
    assert (
        reported.failure
        == f"{tmp_path / 'wired.toml'}: cannot be written: No space left on device; make room there, or write to another disk"
    )
    assert reported.made is found
    assert "drum of B1: count_sign 1 -> -1" in reported.summary
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def with_encoders(**swivel: Any) -> Rig:
    """Two cables, the encoders of their swivels, and an axis of an inclinometer."""
    data = two_cables().to_dict()
    data["swivel"] = [
        {"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 2**17, "max_speed_deg_s": 1e6} | swivel for i in (1, 2)
    ]
    data["inclination"] = [{"channel": "level", "axis": [1.0, 0.0, 0.0], "counts_per_revolution": 2**17, "max_speed_deg_s": 1e6}]
    return rig_from_dict(data)


@pytest.mark.parametrize(
    ("faults", "reported", "corrected_to"),
    [
        ({}, [], []),
        (
            {"turns": False, "encoders": [1, 0, 2], "count_sign": -1},
            [
                "swivel of B1: channel sw2 turned, but the rig has channel sw1",
                "swivel of B1: counts up, but the rig has count_sign = -1",
                "swivel of B2: channel sw1 turned, but the rig has channel sw2",
                "swivel of B2: counts up, but the rig has count_sign = -1",
            ],
            ["swivel of B1: channel sw1 -> sw2. Check that zero_deg belongs to this encoder", "swivel of B2: count_sign -1 -> 1"],
        ),
        pytest.param(
            {"codes": 2**15, "play_deg": 4.0, "encoders": [0, 2, 2]},
            [
                "swivel of B1: came back +1.10 degrees from its start: it is loose on its shaft, or the cable slips",
                "swivel of B1: turned by 12 degrees with counts_per_revolution = 131072. If you turned it by about 45,",
                "swivel of B2: no swivel turned by 5 degrees, but level moved by 12 degrees",
            ],
            [],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_encoders_are_turned_and_reported(faults: dict[str, Any], reported: list[str], corrected_to: list[str]) -> None:
    """Codes that stand next to their end, and pulleys that turn a little while their cables are pulled."""
    rig = with_encoders(**{key: faults[key] for key in ("count_sign",) if key in faults})
    bench = Bench(rig, **faults)
    bench.counts[2:] = 2**17 - 400
    try:
        result = bench.check()
    finally:
        bench.close()
    assert len(result.all_faults) == len(reported), result.all_faults
    for line, start in zip(result.all_faults, reported, strict=True):
        assert line.startswith(start)
    said = corrected(rig.to_dict(), result)[1]
    assert all(any(line.startswith(start) for line in said) for start in corrected_to)
    if not reported:
        assert [e.moved for e in result.encoders] == ["sw1", "sw2", "level"]
        assert any("deg: sw1 -49.5  sw2 +0.0  level +0.0" in line for line in bench.shown)
        assert [e.turned_deg for e in result.encoders] == pytest.approx([49.5, 49.5, 5.5], abs=0.01)
        assert said == []


def watched(*batches: tuple[int, int]) -> BusWatch:
    """A watch that has seen so many frames of each identifier; an identifier of -1: error frames."""
    watch = BusWatch(counter_fields(RIG), 0x80)
    for identifier, count in batches:
        error = identifier < 0
        messages = [
            can.Message(arbitration_id=max(identifier, 0), is_extended_id=False, is_error_frame=error, data=b"\0" * 4) for _ in range(count)
        ]
        watch.feed(frames_from_messages(messages, "host", "test"))
    return watch


def test_what_a_cable_that_did_not_move_leaves_open_is_said_and_not_guessed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two plugs are exchanged, and a third cable was not pulled: the channels stay, and a sign that another drum's counter showed too."""
    seen = [
        CableCheck("c1", "ch1", "ch2", -1, faults=("channel ch2 moved, but the rig has channel ch1",)),
        CableCheck("c2", "ch2", "ch1", 1, faults=("channel ch1 moved, but the rig has channel ch2",)),
        CableCheck("c3", "ch3", faults=("no channel moved by 20 mm",)),
        *(CableCheck(f"c{i}", f"ch{i}", f"ch{i}", -1 if i == 6 else 1) for i in (4, 5, 6)),
    ]
    write_rig(tmp_path / "rig.toml", RIG)
    monkeypatch.setattr("lmeasure.acquisition.self_test", lambda *_, **__: Check(200.0, {}, tuple(seen), ()))
    settings = check_workflow.CheckSettings(rig=tmp_path / "rig.toml", bus=f"virtual:{virtual_place()}", write=tmp_path / "wired.toml")
    reported = check_workflow.run_check(settings, ask=lambda step: "").summary
    assert reported == (
        "drum of B6: count_sign 1 -> -1",
        "channels are unchanged, because some cables share a channel or moved none. Check again, then --write",
        f"written: {tmp_path / 'wired.toml'}. Check it again",
    )
    wired = read_rig(tmp_path / "wired.toml")
    assert [c.channel for c in wired.cable] == [c.channel for c in RIG.cable]
    assert [p.drum.count_sign for p in wired.observation_point] == [1, 1, 1, 1, 1, -1]
    seen[5] = CableCheck("c6", "ch6", "ch6", 1)
    reported = check_workflow.run_check(settings.model_copy(update={"force": True}), ask=lambda step: "").summary
    assert reported[0].startswith("channels are unchanged, because some cables share a channel or moved none. Check again, then --write")
    assert reported[1].endswith("Check it again")  # "with nothing to correct" is of a rig that is right


def test_who_else_is_on_the_bus_is_named() -> None:
    six = tuple((0x181 + i, 100) for i in range(6))
    assert watched((0x80, 100), *six, (0x701, 3), (0x81, 1), (0, 2)).foreign() == []
    assert watched((0x80, 100), *six).twice() == []
    assert watched((0x80, 100), *six, (0x2A0, 7)).foreign() == ["2A0h (7 frames)"]
    assert watched((0x80, 100), *six, (0x183, 100)).twice() == [
        "channel ch3: 200 frames 183h for 100 SYNCs. Several devices send this identifier"
    ]
    (line,) = watched((0x80, 200), *six).twice()
    assert line == "200 SYNCs for 100 frames of one counter. Several programs send SYNC, such as a second recording"


@pytest.mark.parametrize(
    ("batches", "reported"),
    [
        ([(-1, 40)], "40 error frames and none that can be read: another bit rate than the 500000 bit/s of the rig, or a line without"),
        ([], "no frame at all: nothing is connected or switched on, or another bit rate"),
        ([(0x300, 9), (0x80, 9)], "frames come, but of 300h (9 frames). The rig's counters are in 181h, 182h"),
        (
            [(0x80, 9), (0x181, 9), (0x300, 7)],
            "its counters' frames do not come. There are frames of 300h (7 frames), which the rig does not name",
        ),
        (
            [(0x80, 90), (0x181, 90), (0x182, 180), (0x300, 7)],
            "channel ch2: 180 frames 182h for 90 SYNCs. Several devices send this identifier",
        ),
        ([(0x181, 9), (0x300, 9)], "the counters' frames arrive, but no SYNC 080h: no device sends it, or sync_id of the rig is wrong"),
    ],
)
def test_why_no_count_comes(batches: list[tuple[int, int]], reported: str) -> None:
    assert watched(*batches).silence(500_000).startswith(reported)


def test_error_frames_alone_are_named_over_a_real_bus() -> None:
    """What an adapter delivers at a wrong bit rate, over sockets."""
    group = a_group()
    place: dict[str, Any] = {"interface": "udp_multicast", **group}
    done = threading.Event()

    def noise() -> None:
        with can.Bus(**place) as bus:
            while not done.is_set():
                bus.send(can.Message(is_error_frame=True))
                time.sleep(0.01)

    thread = threading.Thread(target=noise)
    thread.start()
    source = BusSource(lambda: can.Bus(**place), "udp_multicast:test", 250_000)
    try:
        with pytest.raises(AcquisitionError, match=r"error frames and none that can be read: another bit rate than the 250000 bit/s"):
            self_test(RIG, Link(source, counter_fields(RIG)), lambda step: "", turns=False, settle_s=0.05)
    finally:
        done.set()
        thread.join()
        source.close()
