"""Random recordings with restarts of encoders, wraps and late stamps: which counts are wrong, and whether the log's events state it.

    python benchmarks/recordings_study.py [--count 1000] [--seed 1] [--write]

Each recording has counters of 16, 24 or 32 bits of six cables on smooth random ways, and at random: an encoder that starts again, with a
boot-up frame, a reset by the master, or no word, behind a gap or none; late stamps; wrong stamps; a clock that starts again; a silent
channel; lost frames. A log is written as by candump -L and imported. A count is wrong where it differs from the truth by more than the
steps that the events state for the gaps before it; behind a word of the device, where it differs at all. --write writes the table to
benchmarks/results/recordings_study.md.
"""

import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from study import options, show

from lmeasure.acquisition import import_logs
from lmeasure.rig import Rig, read_rig, rig_from_dict

FloatArray = NDArray[np.float64]


RIG = Path(__file__).parent.parent / "tests" / "authorities" / "sixteen-bits-one-late-stamp" / "rig.toml"


STATED = re.compile(r"a step below (\d+) units")


PERIOD_S, SAMPLES, BEGIN_S = 0.01, 600, 1_700_000_000.0


DELAYS_S = 2e-4 * np.arange(1, 7)


@dataclass(frozen=True)
class Recording:
    """Frames in the order of their reception: true instants and stamps [s], identifiers, data; counts (n, 6) at the SYNCs, or at the
    readings of the first channel; late_s: by how much stamps are late at most."""

    timing: str
    bits: int
    true_s: FloatArray
    stamps_s: FloatArray
    identifier: list[int]
    data: list[bytes]
    counts: FloatArray
    late_s: float = 0.0


def motion(rng: np.random.Generator, speed_mm_s: float) -> Callable[[FloatArray], FloatArray]:
    """Return counts (n, 6) at times (n,) of cables that swing at up to so many mm/s."""
    frequency = rng.uniform(0.1, 0.5, (3, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 6))
    size = speed_mm_s / (2.0 * np.pi * frequency) / 3.0 / 0.012

    def counts(time_s: FloatArray) -> FloatArray:
        angle = 2.0 * np.pi * frequency * time_s[:, None, None] + phase
        return np.asarray(np.rint((size * (np.sin(angle) - np.sin(phase))).sum(axis=1)))

    return counts


def recorded(
    rng: np.random.Generator,
    timing: str = "sync",
    bits: int = 32,
    speed_mm_s: float = 1500.0,
    every: tuple[int, ...] = (1,) * 6,
    counter: bool = False,
) -> Recording:
    """Return a recording without any fault."""
    law = motion(rng, speed_mm_s)
    instants: FloatArray = PERIOD_S * np.arange(SAMPLES, dtype=np.float64)
    true_s, identifier, data = [], [], []
    latched = law(instants)
    own = np.stack([law(np.asarray(instants + d))[:, c] for c, d in enumerate(DELAYS_S)], axis=1)
    for k, at in enumerate(instants):
        if timing == "sync":
            true_s.append(at)
            identifier.append(0x80)
            data.append(bytes([k % 240 + 1]) if counter else b"")
        for c in range(6):
            if k % every[c] == 0:
                value = int((latched if timing == "sync" else own)[k, c])
                true_s.append(at + DELAYS_S[c])
                identifier.append(0x181 + c)
                data.append((value % 2**bits).to_bytes(bits // 8, "little"))
    times = np.array(true_s)
    counts = latched[:: int(np.lcm.reduce(every))] if timing == "sync" else law(np.asarray(instants + DELAYS_S[0]))
    return Recording(timing, bits, times, BEGIN_S + times, identifier, data, counts)


def stamped(one: Recording, stamps_s: FloatArray, late_s: float = 0.0) -> Recording:
    """Return the recording with other stamps."""
    return replace(one, stamps_s=stamps_s, late_s=max(one.late_s, late_s))


def by_candump(path: Path, one: Recording) -> Path:
    path = path.with_suffix(".log")
    rows = zip(one.stamps_s, one.identifier, one.data, strict=True)
    path.write_text("".join(f"({t:.6f}) can0 {i:03X}#{d.hex().upper()}\n" for t, i, d in rows))
    return path


Law = Callable[[np.random.Generator, Recording], Recording]


def away(step_s: float, frames: int, at_s: float = 3.0) -> Law:
    def law(rng: np.random.Generator, r: Recording) -> Recording:
        first = int(np.searchsorted(r.true_s, at_s))
        out = r.stamps_s.copy()
        out[first : first + frames] += step_s
        return stamped(r, out)

    return law


def held(*holds: tuple[float, float]) -> Law:
    """A host that gets round to its frames late: from when, and for how long."""

    def law(rng: np.random.Generator, r: Recording) -> Recording:
        out = r.stamps_s.copy()
        for begin, length in holds:
            inside = (r.true_s >= begin) & (r.true_s < begin + length)
            out[inside] = r.stamps_s[0] + begin + length + 1e-6 * np.arange(inside.sum())
        return stamped(r, np.maximum.accumulate(out), max(length for _, length in holds))

    return law


def lost(r: Recording, keep: NDArray[np.bool_]) -> Recording:
    rows = np.flatnonzero(keep)
    return replace(
        r, true_s=r.true_s[rows], stamps_s=r.stamps_s[rows], identifier=[r.identifier[i] for i in rows], data=[r.data[i] for i in rows]
    )


def rig_of(one: Recording) -> Rig:
    channels = [{"channel": f"ch{c}", "id": 0x180 + c, "bits": one.bits} for c in range(1, 7)]
    table = {"decoder": "raw", "timing": one.timing, "channel": channels}
    return rig_from_dict(read_rig(RIG).to_dict() | {"can": table})


@dataclass(frozen=True)
class Outcome:
    """Samples, cells without a count, counts that are wrong, largest error of a time [ms], kinds of events; cells (n, 6) that are empty,
    and that differ from the truth whatever the events state; whether the summary states the steps that gaps may hide."""

    samples: int
    empty: int
    wrong: int
    time_ms: float
    events: dict[str, int]
    void: NDArray[np.bool_]
    differs: NDArray[np.bool_]
    stated: bool


def judged(path: Path, one: Recording) -> Outcome:
    """Import a log and compare each sample with the truth. Samples are found by their counts, or by their times where those are true."""
    result = import_logs([path], rig_of(one), None)
    counts, events = result.run.passes[0], dict(result.logs[0].events.tally)
    n, truth = len(counts.time_s), one.counts
    instants = PERIOD_S * (SAMPLES // len(truth)) * np.arange(len(truth)) if one.timing == "sync" else PERIOD_S * np.arange(SAMPLES)
    if n == len(truth):
        rows = np.arange(n)
    else:  # frames are missing: what there is lies at its own time
        rows = np.clip(np.rint((counts.time_s + instants[0]) / (instants[1] - instants[0])).astype(int), 0, len(truth) - 1)
    off = np.abs(counts.recorded - truth[rows])
    allowed = 0.5
    if one.timing == "free":  # others are interpolated between whole counts, and late stamps move them
        bend = np.abs(np.diff(truth, 2, axis=0)).max() / 2.0  # over two periods at most
        allowed = 1.5 + float(bend) + float(np.abs(np.diff(truth, axis=0)).max()) / PERIOD_S * 2.0 * one.late_s
    stated = np.zeros(off.shape)
    for event in result.logs[0].events.kept:
        if event.kind == "gap_step" and (found := STATED.search(event.text)):
            stated[event.sample :, int(event.channel[2:]) - 1] += float(found[1])
    moved = counts.time_s - (instants[rows] - instants[rows[0]])
    void, wrong = np.isnan(off), int((off > allowed + stated).sum())
    said = "gap_step" not in events or "a gap can hide" in result.summary()
    return Outcome(n, int(void.sum()), wrong, 1e3 * float(np.abs(moved).max()), events, void, off > allowed, said)


GAPS = (0, 1, 2, 5, 10, 30, 60)
"""Samples without an answer before a restart."""


def restarted(rng: np.random.Generator, one: Recording) -> tuple[Recording, int, int, str]:
    """Return a recording in which an encoder starts again, its place, the sample, and the word of it."""
    channel, at, gap = int(rng.integers(6)), int(rng.integers(100, SAMPLES - 100)), int(rng.choice(GAPS))
    word = str(rng.choice(["boot-up", "reset", "no word"])) if gap else "boot-up"
    first = int(rng.choice([0, 1, int(rng.integers(-5000, 5000)), int(rng.integers(-(2**15), 2**15))]))
    mine = np.array(one.identifier) == 0x181 + channel
    later = np.flatnonzero(mine & (one.true_s >= at * PERIOD_S))
    offset, data = first - int.from_bytes(one.data[later[0]], "little"), list(one.data)
    for i in later:
        data[i] = ((int.from_bytes(data[i], "little") + offset) % 2**one.bits).to_bytes(one.bits // 8, "little")
    one = lost(replace(one, data=data), ~(mine & (one.true_s >= (at - gap) * PERIOD_S) & (one.true_s < at * PERIOD_S)))
    if word != "no word":
        row, t = int(np.searchsorted(one.true_s, at * PERIOD_S - 0.001)), at * PERIOD_S - 0.001
        said = (0x701 + channel, b"\0") if word == "boot-up" else (0, bytes([0x81, channel + 1]))
        identifier, data = [*one.identifier[:row], said[0], *one.identifier[row:]], [*one.data[:row], said[1], *one.data[row:]]
        true_s, stamps_s = np.insert(one.true_s, row, t), np.insert(one.stamps_s, row, BEGIN_S + t)
        one = replace(one, true_s=true_s, stamps_s=stamps_s, identifier=identifier, data=data)
    return one, channel, at, word


def drawn(rng: np.random.Generator) -> tuple[Recording, tuple[int, int, str] | None, list[str]]:
    """Return a random recording; place, sample and word of a restart; and its faults."""
    bits = int(rng.choice([16, 16, 24, 32]))
    one = recorded(rng, str(rng.choice(["sync", "sync", "free"])), bits, float(rng.choice([50.0, 500.0, 2500.0])))
    names: list[str] = []
    restart: tuple[int, int, str] | None = None
    if rng.random() < 0.6:
        one, channel, at, word = restarted(rng, one)
        restart = channel, at, word
        names.append(f"restart, {word}")
    if rng.random() < 0.5:
        one = held((rng.uniform(0.5, 4.0), float(10.0 ** rng.uniform(-2.0, 0.0))))(rng, one)
        names.append("late stamps")
    if rng.random() < 0.4:
        one = away(float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(0.0, 4.0)), int(rng.integers(1, 9)), rng.uniform(0.3, 5.5))(rng, one)
        names.append("wrong stamps")
    if rng.random() < 0.4:
        modulus = float(rng.choice([60.0, 65.536, 3600.0, 2**32 / 1e6]))
        one = stamped(one, (one.stamps_s - BEGIN_S + modulus - rng.uniform(0.5, 5.5)) % modulus)
        names.append("clock starts again")
    if rng.random() < 0.4:
        channel, begin = int(rng.integers(1, 7)), rng.uniform(0.5, 3.0)
        mine = np.array(one.identifier) == 0x180 + channel
        one = lost(one, ~(mine & (one.true_s >= begin) & (one.true_s < begin + 10.0 ** rng.uniform(-2.0, 0.3))))
        names.append("silent channel")
    if rng.random() < 0.3:
        others = (np.array(one.identifier) < 0x181) | (np.array(one.identifier) > 0x186)
        one = lost(one, (rng.random(len(one.true_s)) > 0.01) | others)
        names.append("lost frames")
    return one, restart, names


def study(count: int, seed: int) -> tuple[list[str], int]:
    """Return the lines of the table, and how many recordings are not right."""
    rng = np.random.default_rng(seed)
    tally: Counter[str] = Counter()
    fates: dict[str, Counter[str]] = {}
    cells = bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for k in range(count):
            one, restart, names = drawn(rng)
            got = judged(by_candump(Path(folder) / "log", one), one)
            tally.update(["empty"] * got.empty, wrong=got.wrong > 0, silent=not got.stated)
            cells += got.void.size
            behind = False
            if restart is not None:
                channel, at, word = restart
                rows = slice(min(at, got.samples - 1) + 2 * (one.timing == "free"), None)
                differs, void = got.differs[rows, channel], got.void[rows, channel]
                behind = word != "no word" and bool(differs.any())
                fate = "smaller than the step stated" if differs.any() else "empty to the end" if void.all() else "true counts"
                fates.setdefault(word, Counter())[fate] += 1
            tally["behind"] += behind
            if got.wrong or behind or not got.stated:
                bad += 1
                print(f"recording {k}: {got.wrong} wrong; {one.timing}, {one.bits} bits; {', '.join(names)}; {got.events}", file=sys.stderr)
    lines = ["| restart | empty to the end | true counts | off by less than the step stated |", "|---|---|---|---|"]
    kinds = ("empty to the end", "true counts", "smaller than the step stated")
    lines += [f"| {word} | {' | '.join(str(of[kind]) for kind in kinds)} |" for word, of in sorted(fates.items())]
    lines += ["", f"{count} recordings of {SAMPLES} samples; {tally['empty'] / cells:.2%} of the cells are empty."]
    lines += [f"{tally['wrong']} have a count that is off by more than the steps that its events state;"]
    lines += [f"{tally['behind']} have a count that is off behind a word of the device;"]
    return [*lines, f"{tally['silent']} have events with such a step and a summary without."], bad


def main() -> int:
    """Print the table; 1 where a recording is not right."""
    parser = options(__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    lines, bad = study(arguments.count, arguments.seed)
    head = ["# Random restarts, wraps and late stamps", "", f"`python benchmarks/recordings_study.py --count {arguments.count}`", ""]
    text = "\n".join([*head, *lines, ""])
    show(arguments, text, "recordings_study")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
