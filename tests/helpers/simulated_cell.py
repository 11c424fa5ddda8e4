"""A robot cell in a process of its own: drums that count on a real bus, a person who pulls cables and turns drums, a robot that is sent to
poses.

    python simulated_cell.py RIG.toml PLANNED.csv '{"interface": "udp_multicast", ...}'

RIG.toml is the rig as it was built. What is done stands on standard input, a line each: `pull c1`, `let c1`, `turn B1`, `rest all` (what
was pulled or turned goes back), `go 3` (the pose of that name); `done` on standard output when it is. Counters were zeroed at the first
pose, where the robot stands.
"""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

SAMPLES_S = 0.01
SPEED_MM_S = 1600.0
PULL_MM = 100.0


def main(rig_file: str, planned: str, bus: dict[str, Any]) -> None:
    """Send, and do what is asked, until standard input ends."""
    import can
    import numpy as np
    from capture_bench import motion

    from lmeasure.acquisition import counter_fields
    from lmeasure.acquisition.bus.feed import frames_from_counts, send
    from lmeasure.recording import read_poses
    from lmeasure.rig import read_rig

    rig = read_rig(Path(rig_file))
    poses, fields = read_poses(Path(planned), rig.angles), counter_fields(rig)
    column = {c: j for j, c in enumerate(rig.channels)}
    order = [column[f.channel] for f in fields]
    ways: queue.SimpleQueue[np.ndarray] = queue.SimpleQueue()
    ended = threading.Event()

    def play() -> None:
        row = np.zeros(len(order))
        with can.Bus(**bus) as sender:
            while not ended.is_set():
                way = None if ways.empty() else ways.get()
                rows = row[None] if way is None else way
                for row in rows:
                    send(frames_from_counts(np.zeros(1), np.rint(row[order])[None], fields, rig.can_table.sync_id), sender, paced=False)
                    time.sleep(SAMPLES_S)  # a host that is busy makes the robot slow, not the drums fast
                if way is not None:
                    print("done", flush=True)

    def counted(here: int, there: int) -> np.ndarray:
        # it stands at the end: the last sample of a motion lies up to a sample before its end
        way = motion(rig, poses.rows[[here, there]], 0.02, zero=poses.rows[0], speed_mm_s=SPEED_MM_S).recorded
        return np.vstack([way[::2], way[-1:]])  # twice as quick, and to the end

    thread = threading.Thread(target=play)
    thread.start()
    now, here = np.zeros(len(order)), 0
    for line in sys.stdin:
        what, name = line.split()
        if what == "go":
            there = poses.names.index(name)
            way = counted(here, there)
            ways.put(way)
            here, now = there, way[-1]
            continue
        goal = counted(here, here)[-1]
        if what != "rest":
            point = name if what == "turn" else next(c.from_point for c in rig.cable if c.name == name)
            j, drum = column[next(c.channel for c in rig.cable if c.from_point == point)], rig.point(point).drum
            paid_out = {"pull": PULL_MM / drum.count_length_mm, "let": 0.0, "turn": drum.counts_per_revolution}[what]
            goal[j] += drum.count_sign * paid_out
        ways.put(np.linspace(now, goal, 12)[1:])
        now = goal
    ended.set()
    thread.join()


def exchanged(rig: Any, first: int, other: int) -> dict[str, Any]:
    """The content of a rig built like this one, but with the plugs of two cables' encoders exchanged: frames stay with the encoders."""
    data: dict[str, Any] = rig.to_dict()
    data["can"] = {"decoder": "raw", "channel": [{"channel": c.channel, "id": c.id} for c in rig.can_table.channel]}
    a, b = data["cable"][first], data["cable"][other]
    a["channel"], b["channel"] = b["channel"], a["channel"]
    return data


@contextmanager
def cell(folder: Path, rig_file: Path, planned: Path, bus: dict[str, Any]) -> Iterator["Person"]:
    """The process, and who is asked to do something there."""
    root = str(Path(__file__).parents[2])
    words = [sys.executable, __file__, str(rig_file), str(planned), json.dumps(bus)]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, cwd=folder, env=os.environ | {"PYTHONPATH": root}, **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield Person(process.stdin, process.stdout)
        finally:
            process.stdin.close()


class Person:
    """Does in the cell what commands ask in English."""

    def __init__(self, cell: IO[str], reported: IO[str]) -> None:
        self._cell, self._reports, self._asked = cell, reported, 0

    def do(self, text: str) -> None:
        """What a step of `lmeasure check` asks, or a line of `lmeasure capture` that names a pose."""
        words = text.replace(",", "").split()
        if words[0] == "Pull":
            self._tell("pull", words[2])
        elif words[0] == "Let":
            self._tell("let", words[2])
        elif words[0] == "Turn":
            self._tell("turn", words[4])
        elif words[0] == "Leave" or "ready" in words:
            self._tell("rest", "all")
        elif "pose" in words and "of" in words:
            self._tell("go", words[words.index("pose") + 1])

    def done(self) -> None:
        """Wait until all that was asked is done: on a machine that is busy, the cell takes its time."""
        while self._asked:
            assert self._reports.readline() == "done\n"
            self._asked -= 1

    def _tell(self, what: str, name: str) -> None:
        self._asked += 1
        print(what, name, file=self._cell, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
