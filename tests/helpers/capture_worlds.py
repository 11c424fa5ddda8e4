"""A capture in a simulated world: a robot, six drums, a person, bus, clocks and disk, all from one seed; and what must be true after it.

The robot goes where the session wants it, after a while, and rests there; the counts at each pose are known. A session that was killed or
ended early is followed by another one on a machine without faults. It must come to the same readings.
"""

import hashlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

import can
import numpy as np
from capture_bench import nominal_of, some_poses, true_rig, write_inputs
from simulated_machine import BEGIN_S, RECORDER, Frame, Killed, Machine, content, simulated
from worlds import FloatArray, Outcome

from lmeasure.acquisition import Link, counter_fields, import_logs
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.core import CancelledError, LMeasureError
from lmeasure.io import files
from lmeasure.procedures import Session
from lmeasure.recording import read_counts, read_run
from lmeasure.simulation import simulate_run
from lmeasure.workflows.capture import CaptureSettings, run_capture

POSES, CHANNELS = some_poses(5), 6
PERIOD_S = 0.05
FAR = 3000
"""Counts from zero at which an encoder starts again: a rest beside it is none at the same pose."""
MOVE_S = 3.0
"""Time that the robot takes from pose to pose."""
PATIENCE_S = 150.0
"""After which the person ends the session."""
CLOCKS = (*RECORDER, "lmeasure.workflows.capture")


@cache
def inputs() -> tuple[Any, Any, FloatArray]:
    """Return the rig, the nominal rig, and the counts at the poses (n, m)."""
    rig = true_rig(CHANNELS)
    run = simulate_run(rig, np.arange(len(POSES) + 1.0), np.vstack([POSES[:1], POSES]), noise_mm=0.0, rng=np.random.default_rng(2)).run
    return rig, nominal_of(rig), run.passes[0].recorded[1:]


@dataclass(kw_only=True)
class Cell(Machine):
    """A machine with a robot: where it is and where it goes, the faults of its frames, and what a session has acknowledged."""

    faults: list[str] = field(default_factory=list)
    lost: float = 0.0
    doubled: float = 0.0
    late: float = 0.0
    junk: float = 0.0
    starts_again: tuple[float, int, bool] | None = None
    """When an encoder starts again, which, and whether it says so."""
    silent: tuple[float, float, int] | None = None
    """From when for how long no frame of a channel comes."""
    pause: tuple[float, float] | None = None
    off: tuple[float, float] | None = None
    clock: tuple[float, float] | None = None
    """When the clock of the interface is set, and by how much."""
    by: Literal["key", "rest", "both"] = "rest"
    words: list[tuple[float, str]] = field(default_factory=list)
    """What the person types besides Enter."""
    step_s: float = 0.5
    sent: int = 0
    goal: int = 0
    begun_s: float = 0.0
    origin: FloatArray = field(default_factory=lambda: np.zeros(CHANNELS))
    """Counts that the encoders have forgotten."""
    at: FloatArray = field(default_factory=lambda: inputs()[2][0])
    gone_from: FloatArray = field(default_factory=lambda: inputs()[2][0])
    pressed_s: float = 0.0
    gone: bool = False
    acknowledged: dict[str, list[tuple[str, tuple[float, ...]]]] = field(default_factory=lambda: {"readings": []})
    said: list[str] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def next_s(self) -> float:
        """Return when the next frame comes; the robot moves on meanwhile."""
        while self.position >= len(self.due):
            self._sample()
        return self.due[self.position][0]

    def _sample(self) -> None:
        """Add the frames of the next sample."""
        at_s = self.sent * PERIOD_S
        self.sent += 1
        if self.pause is not None and at_s >= self.pause[0]:
            self.sent += round(self.pause[1] / PERIOD_S)
            self.pause = None
        if self.off is not None and at_s >= self.off[0]:
            self.back_s = at_s + self.off[1]
            self.due.append((at_s, can.CanOperationError("bus off")))
            self.sent += round(self.off[1] / PERIOD_S) + 1
            self.off = None
            return
        share = 0.5 - 0.5 * np.cos(np.pi * min(max((at_s - self.begun_s) / MOVE_S, 0.0), 1.0))
        self.at = np.rint(self.gone_from + share * (inputs()[2][self.goal] - self.gone_from))
        frames: list[tuple[float, bytes, int]] = [(0.0, b"", 0x80)]
        if self.starts_again is not None and at_s >= self.starts_again[0] and abs(self.at[self.starts_again[1]]) > FAR:
            _, j, says = self.starts_again
            self.origin[j], self.starts_again = self.at[j], None
            if says:
                frames.insert(0, (-1e-4, b"\0", 0x701 + j))
        for j, one in enumerate(counter_fields(inputs()[0])):
            value = int(self.at[j] - self.origin[j]) % 2**32
            frames.append((1e-4 * (j + 1), value.to_bytes(one.bytes_needed, "little"), one.identifier))
        for delay, data, identifier in frames:
            if self.rng.random() < self.lost:
                continue
            if self.silent is not None and identifier == 0x181 + self.silent[2] and 0.0 <= at_s - self.silent[0] < self.silent[1]:
                continue
            late = PERIOD_S * self.rng.uniform(0.3, 0.9) * (self.rng.random() < self.late) * (identifier != 0x80)
            for _ in range(1 + (self.rng.random() < self.doubled)):
                self.due.append((at_s + delay + late, self._frame(identifier, data, at_s + delay + late)))
        if self.rng.random() < self.junk:
            self.due.append((at_s + 0.02, self._frame(int(self.rng.integers(0x400, 0x580)), self.rng.bytes(8), at_s + 0.02)))
        self.due[self.position :] = sorted(self.due[self.position :], key=lambda one: one[0])

    def _frame(self, identifier: int, data: bytes, at_s: float) -> Frame:
        stamp = BEGIN_S + at_s + (self.clock[1] if self.clock is not None and at_s >= self.clock[0] else 0.0)
        return can.Message(timestamp=stamp, arbitration_id=identifier, data=data, is_extended_id=False, is_rx=True)

    # --- the person

    def show(self, session: Session) -> None:
        """Look at the session: send the robot to the wanted pose, or back to one that was read while the counters are doubted."""
        self.acknowledged["readings"] = [(one.pose, tuple(one.counts[0].tolist())) for one in session.folder.readings]
        wanted = session.goal
        if session.folder.of_pass and not session.trust.whole:
            wanted = session.folder.of_pass[-1].pose
        if wanted is not None and (there := session.poses.names.index(wanted)) != self.goal:
            self.gone_from, self.goal, self.begun_s = self.at, there, self.now + float(self.rng.uniform(0.2, 2.0))

    def typed(self) -> list[str]:
        """Return what was typed: Enter while the robot rests, and the words of the seed."""
        lines = [word for at_s, word in self.words if at_s <= self.now]
        self.words = [one for one in self.words if one[0] > self.now]
        if self.now - max(self.begun_s + MOVE_S, self.pressed_s) > 2.0:
            self.pressed_s = self.now
            lines.append("")
        return lines

    def progress(self, share: float, text: str) -> None:
        """End the session where nothing comes of it."""
        del share, text
        if self.now > PATIENCE_S:
            raise CancelledError


def drawn(seed: int) -> Cell:
    """Return the cell of a seed."""
    rng = np.random.default_rng([seed, 51])
    cell, faults = Cell(seed=seed, rng=rng), list[str]()

    def happens(name: str, chance: float) -> bool:
        if rng.random() >= chance:
            return False
        faults.append(name)
        return True

    def moment() -> float:
        return float(rng.uniform(1.0, 30.0))

    ways: tuple[Literal["key", "rest", "both"], ...] = ("rest", "key", "both")
    cell.by = ways[int(rng.integers(3))]
    if happens("lost", 0.3):
        cell.lost = float(rng.choice([0.002, 0.05]))
    if happens("doubled", 0.2):
        cell.doubled = 0.02
    if happens("late", 0.2):
        cell.late = 0.01
    if happens("junk", 0.2):
        cell.junk = 0.2
    if happens("encoder starts again", 0.25):
        cell.starts_again = moment(), int(rng.integers(CHANNELS)), bool(rng.random() < 0.5)
    if happens("silent channel", 0.15):
        cell.silent = moment(), float(rng.uniform(0.2, 8.0)), int(rng.integers(CHANNELS))
    if happens("pause", 0.2):
        cell.pause = moment(), float(rng.uniform(0.5, 20.0))
    if happens("bus off", 0.15):
        cell.off = moment(), float(rng.choice([0.3, 5.0, 60.0]))
    if happens("clock set", 0.2):
        cell.clock = moment(), float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(0.0, 3.5))
    if happens("typed", 0.3):
        cell.words = [(moment(), str(rng.choice(["undo", "skip", "status", "return", "go 2", "quit", "nonsense"]))) for _ in range(3)]
    if happens("disk", 0.6):
        answer = str(rng.choice(["full", "part", "error", "interrupted", "killed", "killed", "killed"]))
        number = int(10.0 ** rng.uniform(0.0, 3.2))
        cell.disk = {number: answer} if answer != "full" else {-number: "", 0: "full"}
        faults[-1] = f"disk: {answer}"
    if happens("slow disk", 0.15):
        cell.slow = int(rng.integers(20, 200))
    cell.short = int(rng.choice([10**9, 100]))
    cell.faults = faults
    return cell


def lived(cell: Cell, folder: Path) -> Outcome:
    """Capture in a cell, again on a machine without faults where it ended early, and judge the files."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_inputs(folder, inputs()[1], POSES, u_position_mm=np.full(len(POSES), 0.05), u_rotation_deg=np.full(len(POSES), 0.01))
    ended, wrong = _session(cell, folder)
    after = _whole(folder / "cal")
    wrong += _judged(cell, folder, ended)
    seconds, typed = cell.now, "typed" in cell.faults
    if ended != "complete":
        origin = cell.origin.copy()
        begun = bool(_readings(folder / "cal"))  # else the person has sent the robot to the first pose
        at = cell.at if begun else inputs()[2][0]
        healthy = Cell(seed=cell.seed, rng=np.random.default_rng(cell.seed), at=at, gone_from=at, goal=cell.goal if begun else 0)
        healthy.origin, healthy.begun_s = origin, -MOVE_S
        again, more = _session(healthy, folder)
        wrong += [f"again: {text}" for text in [*more, *_judged(healthy, folder, again)]]
        if again != "complete" and not origin.any():
            wrong.append(f"again: {again}")
        seconds += healthy.now
    if (ended if ended == "complete" else again) == "complete" and not typed:
        read = {pose for pose, *_ in _readings(folder / "cal")}
        if read != {str(n + 1) for n in range(len(POSES))}:
            wrong.append(f"complete with the poses {sorted(read)}")
    digest = files_digest(after)
    return Outcome(cell.seed, ended, seconds, digest, cell.faults, len(cell.acknowledged["readings"]), wrong)


def files_digest(after: dict[str, bytes]) -> str:
    """Return a digest of the names and bytes of files."""
    return hashlib.sha256(b"".join(name.encode() + data for name, data in sorted(after.items()))).hexdigest()[:16]


def _whole(folder: Path) -> dict[str, bytes]:
    return {name: data for name, data in content(folder).items() if ".part" not in name} if folder.exists() else {}


def _session(cell: Cell, folder: Path) -> tuple[str, list[str]]:
    """Run one session; return how it ended, and what it reported falsely."""
    rig, out = inputs()[0], folder / "cal"
    settings = CaptureSettings(
        rig=folder / "rig.toml", poses=folder / "planned.csv", bus="socketcan:can0", out=out, by=cell.by, dwell_s=0.5, settle_s=0.3
    )
    fields = counter_fields(rig)

    def connect(*args: Any, **more: Any) -> Link:
        del args, more
        return Link(BusSource(cell.bus, "socketcan:can0", patience_s=30.0), fields)

    wrong: list[str] = []
    with simulated(cell, out, CLOCKS), patch("lmeasure.acquisition.connect", connect):
        try:
            result = run_capture(settings, cell.progress, say=cell.said.append, keys=None if cell.by == "rest" else cell, show=cell.show)
            ended = str(result.failure) or "complete"
        except Killed:
            result, ended = None, "killed"
        except LMeasureError as error:
            result, ended = None, f"refused: {error}"
    for one in cell.opened:
        one.close()
    if cell.left is not None:
        shutil.rmtree(out, ignore_errors=True)
        for name, data in cell.left.items():
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (out / name).write_bytes(data)
    if result is not None and (reported := round(result.figures["readings"])) != (there := len(_readings(out))):
        wrong.append(f"reports {reported} readings, {there} are in the file")
    if result is not None and ended == "complete" and len({pose for pose, *_ in _readings(out)}) < len(POSES):
        ended = "ended by the person"
    return ended, wrong


def _readings(out: Path) -> list[tuple[str, int, FloatArray, FloatArray]]:
    """Return pose, recording, times and counts of each reading in counts.csv."""
    if not (out / "counts.csv").exists():
        return []
    table = files.read_table(out / "counts.csv")
    names, recording, time_s = table.text("pose"), table.numbers("recording"), table.numbers("time_s")
    counts = table.matrix(tuple(f.channel for f in counter_fields(inputs()[0])))
    edges = [i for i in range(len(names)) if i == 0 or names[i] != names[i - 1]]
    return [(names[a], int(recording[a]), time_s[a:b], counts[a:b]) for a, b in zip(edges, [*edges[1:], len(names)], strict=True)]


def _judged(cell: Cell, folder: Path, ended: str) -> Iterator[str]:
    out = folder / "cal"
    if ended.startswith("refused") and not cell.disk and not {"bus off"} & set(cell.faults):
        yield ended
    if not out.exists():
        return
    if ended != "killed" and (left := [name for name in content(out) if ".part" in name]):
        yield f"left: {left}"
    for name in _whole(out):
        if name.endswith(".toml"):
            files.read_toml(out / name)
    kept = _readings(out)
    shown, there = cell.acknowledged["readings"], [(pose, tuple(counts[0].tolist())) for pose, _, _, counts in kept]
    if there[: len(shown)] != shown:
        yield f"{len(shown)} readings were acknowledged, {len(there)} are in the file"
    first_s: dict[int, Any] = {}
    for pose, number, time_s, counts in kept:
        if (counts != inputs()[2][int(pose) - 1]).any():
            yield f"pose {pose}: counts off by {np.abs(counts - inputs()[2][int(pose) - 1]).max(axis=0).tolist()}"
        path = out / "frames" / str(number)
        run = first_s.setdefault(number, read_counts(path / "pass1.csv", torn=True))
        rows = np.searchsorted(run.time_s, time_s - 5e-7)
        if rows.max() >= len(run.time_s) or not np.array_equal(run.recorded[rows], counts):
            yield f"pose {pose}: its samples are not in recording {number}"
    for path in sorted(out.glob("frames/*")):
        yield from _recorded(path)


def _recorded(path: Path) -> Iterator[str]:
    """Judge a recording of a session: the frames give its counts again."""
    if not (path / "pass1.csv").exists() or not (path / "run.toml").exists():
        return
    try:
        recorded = read_counts(path / "pass1.csv", torn=True).recorded
    except LMeasureError:
        return  # killed before its first line
    if "complete" in (path / "run.toml").read_text():
        read_run(path)
    try:
        again = import_logs([path / "pass1.log"], inputs()[0], None).run.passes[0].recorded
    except LMeasureError as error:
        if not np.isnan(recorded).all(axis=0).any():
            yield f"{path.name}: the log cannot be imported: {error}"
        return
    n = min(len(again), len(recorded))
    both = np.isfinite(again[:n]) & np.isfinite(recorded[:n])
    if len(again) < len(recorded) or (again[:n][both] != recorded[:n][both]).any():
        yield f"{path.name}: the log gives other counts"
