"""Contents of a log with unknown counters: identifiers, rates, motion of bytes, and a guess at the `[can]` table.

A drum's counter moves little from frame to frame compared with its range. A cyclic number counts frames; a checksum moves at random. So
bytes are a counter if its steps, modulo the range, are a small part of the range and not all the same.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, REMOTE, Frames
from lmeasure.acquisition.bus.network import REGULAR, every, ordinal
from lmeasure.acquisition.bus.sources import Source
from lmeasure.acquisition.logs.read import log_batches
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.core import AcquisitionError, DataFrame, FileFormatError, FloatArray, IntArray, Shown, framed
from lmeasure.rig import SYNC_ID
from lmeasure.text import composed, message

KEPT = 200_000
"""Frames of an identifier that are looked at."""
LEAST = 8
"""Fewest frames from which the motion of bytes can be judged."""
SMALL = 1.0 / 16.0
"""Part of a field's range that a counter steps by at most, but for a few of its steps."""
FEW = 0.01
MANY = 4.0
"""Mean steps in the range of a counter; bytes without a pattern go three."""
SUMMED = 10
ALIKE = 0.98
"""Frames whose steps are summed, and their least correlation with a speed."""
SELECTED = 32
"""Counters that one identifier carries in turn, at most."""
SPREAD = 0.25
"""Most periods of a SYNC by which the delays of its answers differ."""
WIDTHS = (4, 3, 2)
DATED_S = 1e8
"""Seconds since 1970 are more, those of a device's own clock less."""
Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Field:
    """Counter-like number at bytes first .. first + size of a frame: its order, first and last value, and largest step."""

    first: int
    size: int
    order: str
    least: int
    most: int
    step: int
    moves: int
    """Frames at which its low byte differs from that of the frame before."""
    values: IntArray = field(default_factory=lambda: np.empty(0, np.int64), repr=False, compare=False)
    """(n,) whole counts of the frames that were looked at."""

    @property
    def low(self) -> int:
        """Place of its low byte."""
        return self.first if self.order == "little" else self.first + self.size - 1

    @property
    def cyclic(self) -> bool:
        """Whether it counts the frames, up or down."""
        return bool(self.step == 1 and abs(self.values[-1] - self.values[0]) == len(self.values) - 1)

    @property
    def span(self) -> str:
        """Its bytes."""
        return f"{self.first}-{self.first + self.size - 1}"

    @property
    def text(self) -> str:
        """In words."""
        values = {"span": self.span, "bits": 8 * self.size, "least": self.least, "most": self.most, "step": self.step}
        return message(f"scan.counter_{self.order}", **values)


@dataclass(frozen=True)
class ScannedIdentifier:
    """An identifier on a bus: how many frames, how many a second, their lengths, the counter-like numbers in them, and in words how their
    other bytes move."""

    identifier: int
    extended: bool
    bus: str
    frames: int
    rate_hz: float
    lengths: tuple[int, ...]
    counters: tuple[Field, ...]
    others: tuple[str, ...]
    answers: int | None = None
    """It answers every n-th SYNC; None if it does not answer."""
    multiplexed: bool = False
    """It carries several counters in turn, which no `[can]` table can say without a DBC file."""
    time_s: FloatArray = field(default_factory=lambda: np.empty(0), repr=False, compare=False)
    """(n,) times of the frames that were looked at."""

    @property
    def name(self) -> str:
        """Return the identifier in the notation of logs."""
        return f"{self.identifier:08X}x" if self.extended else f"{self.identifier:03X}"

    def lines(self) -> list[str]:
        """Return a line, and one for each number in its bytes."""
        size = ",".join(map(str, self.lengths))
        head = message("acquisition.s_bytes", name=self.name, bus=self.bus, frames=self.frames, rate_hz=self.rate_hz, size=size)
        reported = [message("acquisition.answers_every_sync", n=ordinal(self.answers))] if self.answers not in (None, 1) else []
        return [head, *(composed("           {text}", text=text) for text in (*(c.text for c in self.counters), *self.others, *reported))]


@dataclass(frozen=True, repr=False)
class Scan(Shown):
    """Identifiers of a log, its dialect, the time of its first frame [s], its duration [s], and its unread lines."""

    path: Path
    dialect: str
    begins_s: float
    lasts_s: float
    carried: tuple[ScannedIdentifier, ...]
    notes: tuple[str, ...]
    sync: ScannedIdentifier | None = None
    """The frame that the counters answer, each after a delay of its own; it has no data, or one byte that counts (CiA 301)."""

    def about(self) -> dict[str, str]:
        """Length, dialect, identifiers, and how many numbers move as a counter does."""
        counters = sum(len(c.counters) for c in self.carried)
        lasts = f"{sum(c.frames for c in self.carried)} over {self.lasts_s:.6g} s"
        return {"frames": lasts, "dialect": self.dialect, "identifiers": str(len(self.carried)), "counters": str(counters)}

    def to_frame(self) -> DataFrame:
        """A row for each identifier."""
        return framed(
            [
                {"identifier": c.name, "bus": c.bus, "frames": c.frames, "rate_hz": c.rate_hz, "counters": len(c.counters)}
                for c in self.carried
            ]
        )

    @property
    def times(self) -> str:
        """Return the kind of its times in words."""
        return message("log.times_of_day" if self.begins_s > DATED_S else "log.times_own")

    def table(self) -> list[str]:
        """The guess as the lines of a `[can]` table, none where nothing looks like a counter."""
        found = [(c, f) for c in self.carried for f in c.counters]
        if not found:
            return []
        timing = ['timing = "free"'] if self.sync is None else ['timing = "sync"', f"sync_id = {self.sync.identifier:#x}"]
        lines = ["[can]", 'decoder = "raw"', *timing]
        for number, (carried, one) in enumerate(found, 1):
            bits = 32 if one.size == 4 else 8 * one.size
            lines += ["", "[[can.channel]]", f'channel = "ch{number}"', f"id = {carried.identifier:#x}"]
            lines += ["extended = true"] * carried.extended
            lines += [f"byte_offset = {one.first}", f"bits = {bits}", f'byte_order = "{one.order}"']
            if self.sync is not None and carried.answers != 1:
                answers = (
                    message("acquisition.answers_no_sync")
                    if carried.answers is None
                    else message("acquisition.answers_every_sync", n=ordinal(carried.answers))
                )
                lines[-1] += f"  # {answers}"
        return lines

    def lines(self) -> list[str]:
        """Return lines with the identifiers, then the guess."""
        out = [
            message(
                "scan.head",
                file=self.path,
                frames=sum(c.frames for c in self.carried),
                seconds=self.lasts_s,
                dialect=self.dialect,
                times=self.times,
            ),
            *(line for c in self.carried for line in c.lines()),
            *self.notes,
        ]
        table = self.table()
        if not table:
            return out if any(c.multiplexed for c in self.carried) else [*out, message("acquisition.nothing_moves_like_counter")]
        guess = message("acquisition.guess_rig_toml_drum")
        return [*out, "", guess, "", *table]


def scan_log(path: Path, progress: Callable[[int, int], None] | None = None) -> Scan:
    """Look at all frames of a log; FileFormatError where it has none, or is no log."""
    report, heard = LogReport(), ScannedFrames()
    for batch in log_batches(path, report, progress):
        heard.add(batch)
    if not heard.found:
        raise FileFormatError(report.empty(path))
    return heard.scan(path, report.dialect, tuple(report.notes()))


class ScannedFrames:
    """Frames, by their identifiers, as they come."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, int, bool], IdentifierFrames] = {}
        self._frames = 0

    def add(self, batch: Frames) -> None:
        """The next frames."""
        _take(batch, self.found, self._frames)
        self._frames += len(batch)

    def scan(self, path: Path, dialect: str, notes: tuple[str, ...] = ()) -> Scan:
        """Return the scan of the frames so far; there must be some."""
        carried = tuple(_carried(key, self.found[key]) for key in sorted(self.found))
        carried, sync = _synchronised(carried, [self.found[key] for key in sorted(self.found)])
        begins = min(seen.first_s for seen in self.found.values())
        lasts = max(seen.last_s for seen in self.found.values()) - begins
        return Scan(Path(path), dialect, begins, lasts, carried, notes, sync)


@dataclass
class IdentifierFrames:
    """Frames of one identifier so far."""

    first_s: float
    last_s: float = 0.0
    count: int = 0
    kept: int = 0
    lengths: frozenset[int] = frozenset()
    data: tuple[Bytes, ...] = ()
    at: tuple[tuple[IntArray, FloatArray], ...] = ()
    """Places of those among all frames, and their times."""
    newest: bytes = b""

    @property
    def rate_hz(self) -> float:
        """Frames a second."""
        return (self.count - 1) / (self.last_s - self.first_s) if self.last_s > self.first_s else 0.0


def _take(batch: Frames, found: dict[tuple[str, int, bool], IdentifierFrames], before: int) -> None:
    good = (batch.flags & (ERROR | REMOTE)) == 0
    key = batch.identifier.astype(np.int64) * 2 + ((batch.flags & EXTENDED) != 0) + (batch.channel.astype(np.int64) << 32)
    for one in np.unique(key[good]):
        rows = np.flatnonzero(good & (key == one))
        place = batch.buses[int(one >> 32)], int(one & 0xFFFFFFFF) >> 1, bool(one & 1)
        seen = found.setdefault(place, IdentifierFrames(float(batch.time_s[rows[0]])))
        seen.last_s, seen.count = float(batch.time_s[rows[-1]]), seen.count + len(rows)
        seen.newest = batch.data[rows[-1], : batch.length[rows[-1]]].tobytes()
        seen.lengths |= frozenset(np.unique(batch.length[rows]).tolist())
        if seen.kept < KEPT:
            seen.data, seen.kept = (*seen.data, batch.data[rows]), seen.kept + len(rows)
            seen.at = (*seen.at, (rows + before, batch.time_s[rows]))


def _synchronised(
    carried: tuple[ScannedIdentifier, ...], seen: list[IdentifierFrames]
) -> tuple[tuple[ScannedIdentifier, ...], ScannedIdentifier | None]:
    """Return the carried objects, each counter with the SYNCs that it answers, and the SYNC: that which most counters answer, 80h before
    others."""
    best: tuple[tuple[int, bool, int], int, dict[int, int]] | None = None
    counters = [i for i, c in enumerate(carried) if c.counters]
    for i, one in enumerate(carried):
        if i in counters or one.extended or not _may_be_sync(one, seen[i]):
            continue
        answers = {j: n for j in counters if carried[j].bus == one.bus and (n := _answers(seen[i], seen[j])) is not None}
        rank = len(answers), one.identifier == SYNC_ID, -one.identifier
        if answers and (best is None or rank > best[0]):
            best = rank, i, answers
    if best is None or 2 * best[0][0] < len(counters):
        return carried, None
    _, at, of = best
    reported = [replace(c, answers=of.get(i)) for i, c in enumerate(carried)]
    if reported[at].lengths == (1,):
        reported[at] = replace(reported[at], others=(message("acquisition.byte_0_syncs_counter"),))
    return tuple(reported), reported[at]


def _may_be_sync(one: ScannedIdentifier, seen: IdentifierFrames) -> bool:
    """Return whether frames have no data, or one byte that counts up and starts again at 0 or 1."""
    if one.frames < LEAST or one.lengths not in {(0,), (1,)}:
        return False
    if one.lengths == (0,):
        return True
    value = np.concatenate([part[:, 0] for part in seen.data]).astype(np.int64)
    counts = np.diff(value) == 1
    again = (value[1:] <= 1) & (value[:-1] > 1)
    return bool(np.mean(counts | again) >= 1.0 - FEW and counts.any())


def _answers(sync: IdentifierFrames, seen: IdentifierFrames) -> int | None:
    """n where frames follow every n-th SYNC, one at a time and after the same delay but for a part of the SYNC's period."""
    place, time_s = (np.concatenate(parts) for parts in zip(*sync.at, strict=True))
    own, own_s = (np.concatenate(parts) for parts in zip(*seen.at, strict=True))
    window = np.searchsorted(place, own) - 1
    inside = (window >= 0) & (window < len(place) - 1)
    answered, counts = np.unique(window[inside], return_counts=True)
    if len(answered) < LEAST or np.mean(counts == 1) < REGULAR:
        return None
    n = every(answered)
    delays = own_s[inside] - time_s[window[inside]]
    low, high = np.percentile(delays, [10, 90])
    regular = n is not None and np.mean(np.diff(answered) % n == 0) >= REGULAR and np.mean(np.diff(answered) == n) >= REGULAR
    return n if regular and high - low <= SPREAD * np.median(np.diff(time_s)) else None


def _carried(key: tuple[str, int, bool], seen: IdentifierFrames) -> ScannedIdentifier:
    bus, identifier, extended = key
    size = min(seen.lengths)
    data = np.vstack([part[:, :size] for part in seen.data])
    counters = _counters(data) if len(data) >= LEAST else ()
    time_s = np.concatenate([part for _, part in seen.at])
    covered = {b for c in counters for b in range(c.first, c.first + c.size)}
    others = tuple(text for b in range(size) if b not in covered and (text := _movement(b, data[:, b])))
    speeds = {one: of for one in counters for of in counters if _is_speed(one, of)}
    cyclic = [c for c in counters if c.cyclic]
    counters = tuple(c for c in counters if c not in speeds and c not in cyclic)
    named = [message("scan.frame_counter", span=c.span) for c in cyclic]
    others = (*named, *(message("scan.speed", span=one.span, of=of.span) for one, of in speeds.items()), *others)
    carried = ScannedIdentifier(
        identifier, extended, bus, seen.count, seen.rate_hz, tuple(sorted(seen.lengths)), counters, others, time_s=time_s
    )
    selector = _selector(data, counters)
    if selector is None:
        return carried
    return replace(carried, counters=(), others=(message("scan.multiplexed", place=selector[0], count=selector[1]),), multiplexed=True)


def _counters(data: Bytes) -> tuple[Field, ...]:
    """Find the counter-like numbers that do not overlap: of the liveliest low bytes first, there the smoothest and then the widest.

    A number that lacks its low byte, or takes a neighbour's byte for its own, moves less or jumps more than the right one.
    """
    places = [(first, size, order) for first in range(data.shape[1] - 1) for size in WIDTHS for order in ("little", "big")]
    fits = [f for first, size, order in places if first + size <= data.shape[1] if (f := _counter(data, first, size, order)) is not None]
    found: list[Field] = []
    for fit in sorted(fits, key=lambda f: (-f.moves, f.low, f.step, -f.size, f.first)):
        if all(fit.first >= f.first + f.size or f.first >= fit.first + fit.size for f in found):
            found.append(fit)
    return tuple(sorted(found, key=lambda f: f.first))


def _counter(data: Bytes, first: int, size: int, order: str) -> Field | None:
    """Return the field, where it moves as a counter does: in small steps, over a range of many steps, a byte less often than
    the one below it, and as smoothly as its low byte alone: a byte that does not take the carry belongs to another number."""
    part = data[:, first : first + size].astype(np.int64)
    part = part if order == "big" else part[:, ::-1]
    moves = (part[1:] != part[:-1]).sum(axis=0)
    # constant bytes above those that move are a sign
    if moves[-1] == 0 or (np.diff(moves) < 0).any() or not np.isin(part[0, moves == 0], (0x00, 0xFF)).all():
        return None
    span = 256**size
    value: IntArray = np.asarray(part @ 256 ** np.arange(size - 1, -1, -1), np.int64)
    steps, of_low_byte = _steps(value, span), _steps(part[:, -1], 256)
    rough, least = (int(np.abs(one).max()) for one in (np.diff(steps), np.diff(of_low_byte)))
    if np.mean(np.abs(steps) > SMALL * span) > FEW or rough > 2 * least + 2:
        return None
    whole = value[0] + np.concatenate([[0], np.cumsum(steps)]) - (span if value[0] >= span // 2 else 0)
    if np.ptp(whole) < MANY * np.mean(np.abs(steps)):
        return None
    return Field(first, size, order, int(whole.min()), int(whole.max()), int(np.abs(steps).max()), int(moves[-1]), whole)


def _is_speed(one: Field, of: Field) -> bool:
    """Return whether a number follows the steps of another, summed over `SUMMED` frames, as encoders send their speed beside the count."""
    n = len(of.values) // SUMMED * SUMMED
    if n < LEAST * SUMMED or one is of:
        return False
    way, mean = np.diff(of.values[:n:SUMMED]), one.values[1 : n - SUMMED + 1].reshape(-1, SUMMED).mean(axis=1)
    return bool(np.ptp(way) > 0 and np.ptp(mean) > 0 and np.corrcoef(way, mean)[0, 1] > ALIKE)


def _selector(data: Bytes, counters: tuple[Field, ...]) -> tuple[int, int] | None:
    """Return the byte that says which counter a multiplexed frame carries, and how many there are; None where no byte does.

    Frames of one counter hold numbers that all frames together do not have, or have with larger steps.
    """
    together = {c.low: c.step for c in counters}
    for place in range(data.shape[1]):
        values, each = np.unique(data[:, place], return_counts=True)
        turns = np.mean(data[1:, place] != data[:-1, place])
        if not 1 < len(values) <= SELECTED or each.min() < LEAST or turns < 0.5:
            continue
        parts = [_counters(np.where(np.arange(data.shape[1]) == place, 0, data[data[:, place] == value])) for value in values]
        if all(any(c.step < together.get(c.low, np.inf) for c in part) for part in parts):
            return place, len(values)
    return None


def _steps(value: IntArray, span: int) -> IntArray:
    """Differences of numbers that begin anew after span, the shorter way."""
    return np.asarray(np.mod(np.diff(value) + span // 2, span) - span // 2, np.int64)


def _movement(place: int, values: Bytes) -> str:
    """Return how a byte moves that belongs to no counter; nothing of one that does not."""
    different = np.unique(values)
    if len(different) == 1:
        return ""
    steps = np.mod(np.diff(values.astype(np.int64)), 256)
    if len(np.unique(steps)) == 1:
        return message("acquisition.byte_counts_frames", place=place, step=int(steps[0]))
    if len(different) == 2:
        return message("acquisition.byte_toggles_between", place=place, one=different[0], other=different[1])
    return message("acquisition.byte_values_no_counter", place=place, count=len(different))


LOOK_S = 0.1
LIT_S = 0.6
"""Time that a byte which has moved is shown as moving."""
Key = tuple[str, int, bool]


@dataclass(frozen=True)
class LiveIdentifier:
    """An identifier by now: how often it came, frames a second, its last bytes, and which of them have moved just now."""

    name: str
    frames: int
    rate_hz: float
    data: bytes
    lit: tuple[bool, ...]


class _Lights:
    """Times at which each byte of each identifier moved last."""

    def __init__(self) -> None:
        self._before: dict[Key, bytes] = {}
        self._moved_at: dict[Key, list[float]] = {}

    def of(self, key: Key, seen: IdentifierFrames, now: float) -> LiveIdentifier:
        """The identifier by now."""
        data, before = seen.newest, self._before.get(key, seen.newest)
        at = self._moved_at.setdefault(key, [])
        at += [-LIT_S] * (len(data) - len(at))
        for i, (a, b) in enumerate(zip(data, before, strict=False)):
            if a != b:
                at[i] = now
        self._before[key] = data
        name = f"{key[1]:08X}x" if key[2] else f"{key[1]:03X}"
        return LiveIdentifier(name, seen.count, seen.rate_hz, data, tuple(now - at[i] < LIT_S for i in range(len(data))))


def listen(
    source: Source,
    seconds: float,
    *,
    show: Callable[[float, tuple[LiveIdentifier, ...]], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Scan:
    """Listen for so many seconds, or until `stop` is true, without sending. show gets the seconds and the senders so far.

    AcquisitionError if no frame comes, or frames cannot be read.
    """
    heard, lights, errors = ScannedFrames(), _Lights(), 0
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < seconds and not stop():
        frames = source.receive(LOOK_S)
        if frames is None:
            break
        errors += int(((frames.flags & ERROR) != 0).sum())
        heard.add(frames)
        if show is not None:
            show(now, tuple(lights.of(key, heard.found[key], now) for key in sorted(heard.found)))
    if not heard.found:
        why = message("bus.only_errors", count=errors, rate=message("bus.other_rate"))
        silent = message("bus.nothing")
        raise AcquisitionError(composed("{where}: {error}", where=source.name, error=why if errors else silent))
    notes = (message("acquisition.error_frames", count=errors),) if errors else ()
    return heard.scan(Path(source.name), message("acquisition.bus"), notes)
