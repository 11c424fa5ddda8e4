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

from lmeasure.acquisition.check import Check, check
from lmeasure.acquisition.decoders import counter_fields
from lmeasure.acquisition.feed import frames_from_counts, send, virtual_place
from lmeasure.acquisition.session import Link
from lmeasure.acquisition.sources import BusSource
from lmeasure.errors import AcquisitionError
from lmeasure.rig import Rig, rig_from_dict, write_rig

RIG = cell(max_cable_speed_mm_s=1e6)  # this person moves in no time


class Bench:
    """Six drums sending at SYNC, and a person who does what is asked; wiring: which channel each cable's drum really counts on."""

    def __init__(self, rig: Rig = RIG, bus: dict[str, Any] | None = None, **faults: Any) -> None:
        self.rig = rig
        self.bus = bus or {"interface": "virtual", "channel": virtual_place()}
        self.fields = counter_fields(rig)
        self.counts = np.linspace(5000.0, 10000.0, len(self.fields))
        self.faults = faults
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
                if "silent" in self.faults:
                    send(frames_from_counts(np.zeros(1), shown[None, :5], self.fields[:5], 0x80), bus, paced=False)
                else:
                    send(frames_from_counts(np.zeros(1), shown[None, :], self.fields, 0x80), bus, paced=False)
                time.sleep(0.005)

    def ask(self, text: str) -> None:
        words = text.split()
        names = [c.name for c in self.rig.cable]
        points = [c.from_point for c in self.rig.cable]
        if words[0] == "Pull":
            self._move(names.index(words[2]), 100.0 / 0.012)
        elif words[0] == "Let":
            self._move(names.index(words[2]), -(100.0 - self.faults.get("slip_mm", 0.0)) / 0.012)
        elif words[0] == "Turn":
            self._move(points.index(words[4]), 6000.0 * self.faults.get("scale", 1.0))

    def _move(self, cable: int, counts: float) -> None:
        wiring = self.faults.get("wiring", range(6))
        self.counts[wiring[cable]] += round(counts) * self.faults.get("sign", 1)

    def check(self) -> Check:
        source = BusSource(lambda: can.Bus(**self.bus), "virtual:bench")
        try:
            return check(self.rig, Link(source, self.fields), self.ask, turns=self.faults.get("turns", True), settle_s=0.05)
        finally:
            source.close()

    def close(self) -> None:
        self._done.set()
        self._thread.join()


def run(**faults: Any) -> Check:
    bench = Bench(**faults)
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
    ("faults", "told"),
    [
        (
            {"turns": False, "wiring": [0, 4, 2, 3, 1, 5]},
            ["cable c2: channel ch5 moved, the rig says ch2", "cable c5: channel ch2 moved, the rig says ch5"],
        ),
        ({"turns": False, "sign": -1}, [f"cable c{i}: counts down when paid out, the rig says count_sign = 1" for i in range(1, 7)]),
        ({"scale": 0.5}, [f"cable c{i}: 3000 counts in a turn, the rig says 6000: 0.5 times as many" for i in range(1, 7)]),
        ({"turns": False, "slip_mm": 2.0}, [f"cable c{i}: came back +1.99" for i in range(1, 7)]),
        ({"turns": False, "trembling": 3}, ["channel ch4: moves by 10 counts at rest"]),
    ],
)
def test_each_wrong_wiring_is_told(faults: dict[str, Any], told: list[str]) -> None:
    lines = run(**faults).all_faults
    assert len(lines) == len(told)
    for line, start in zip(lines, told, strict=True):
        assert line.startswith(start)


def test_a_channel_that_does_not_show_stops_the_test() -> None:
    with pytest.raises(AcquisitionError, match="no counts of ch6 within 1 s"):
        run(silent=True)


def two_cables() -> Rig:
    data = RIG.to_dict()
    data["cable"] = data["cable"][:2]
    return rig_from_dict(data)


@pytest.mark.parametrize(
    ("faults", "code", "verdicts", "error"),
    [
        ({}, 0, ["c1 ch1 ch1 +1 100.0 +0.000 6000 of 6000 ok", "c2 ch2 ch2 +1 100.0 +0.000 6000 of 6000 ok"], ""),
        (
            {"wiring": [1, 0], "turns": False},
            1,
            ["channel ch2 moved, the rig says ch1", "channel ch1 moved, the rig says ch2"],
            "rig.toml: 2 fault(s), the first: cable c1: channel ch2 moved, the rig says ch1",
        ),
    ],
)
def test_a_person_is_walked_through_it(faults: dict[str, Any], code: int, verdicts: list[str], error: str, tmp_path: Path) -> None:
    """The command in a process of its own; the person reads what it asks, does it, and presses Enter."""
    write_rig(tmp_path / "rig.toml", two_cables())
    group = a_group()
    bench = Bench(two_cables(), {"interface": "udp_multicast", **group}, **faults)
    command = [sys.executable, "-m", "lmeasure", "check", "--rig", str(tmp_path / "rig.toml")]
    command += ["--bus", f"udp_multicast:{group['channel']}", "--bus-option", f"port={group['port']}"]
    turns = faults.get("turns", True)
    command += [] if turns else ["--no-turns"]
    asked = []
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"COLUMNS": "200"}
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            said = ""
            while char := process.stdout.read(1):
                said += char
                if said.endswith("then press Enter "):
                    asked.append(said)
                    bench.ask(said)
                    said = ""
                    process.stdin.write("\n")
                    process.stdin.flush()
            complaint = process.stderr.read()
        finally:
            process.kill()
            bench.close()
    assert process.wait() == code
    assert asked[0].startswith("Leave all cables at rest")
    assert len(asked) == 1 + 2 * (5 if turns else 3)
    shown = " ".join(said.split())
    for verdict in verdicts:
        assert verdict in shown
    assert complaint.endswith(f"{error}\n" if error else "")
    assert len(complaint.splitlines()) == bool(error)
