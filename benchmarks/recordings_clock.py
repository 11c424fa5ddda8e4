"""Recordings whose clocks are wrong, and SYNC as CiA 301 has it: written by python-can or by own bytes, imported, compared with the truth.

    python benchmarks/recordings_clock.py [--write]

Six encoders move on smooth random ways. A row of the table is one recording: its fault, who wrote it, and what the import made of it. A
count is wrong where it is there and differs from the truth by more than half a count and the steps that the events state for its gaps;
where encoders have timers of their own, also by more than the motion within the lateness of the stamps. --write writes the table to
benchmarks/results/recordings_clock.md.
"""

import csv
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import can
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


def by_gvret(path: Path, one: Recording) -> Path:
    """Microseconds of the device's clock."""
    path = path.with_suffix(".csv")
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["Time Stamp", "ID", "Extended", "Dir", "Bus", "LEN", *(f"D{i}" for i in range(1, 9))])
        for t, i, d in zip(one.stamps_s, one.identifier, one.data, strict=True):
            out.writerow([round(t * 1e6), f"{i:08X}", "false", "Rx", 0, len(d), *(f"{b:02X}" for b in d), *[""] * (8 - len(d))])
    return path


def by_python_can(path: Path, one: Recording) -> Path:
    """Its CSV, the one of its writers that takes stamps as they are."""
    path = path.with_suffix(".csv")
    with can.CSVWriter(path) as out:
        for t, i, d in zip(one.stamps_s, one.identifier, one.data, strict=True):
            out(can.Message(timestamp=float(t), arbitration_id=i, is_extended_id=False, data=d))
    return path


WRITERS: dict[str, Callable[[Path, Recording], Path]] = {"candump": by_candump, "GVRET": by_gvret, "python-can": by_python_can}
Law = Callable[[np.random.Generator, Recording], Recording]


def again(modulus: float, after_s: float) -> Law:
    """A clock that starts again after so long."""
    return lambda rng, r: stamped(r, (r.true_s + modulus - after_s) % modulus)


def set_by(step_s: float, at_s: float = 2.0) -> Law:
    return lambda rng, r: stamped(r, r.stamps_s + step_s * (r.true_s >= at_s))


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


def ticks(tick_s: float) -> Law:
    """An adapter that hands over every so often what came."""

    def law(rng: np.random.Generator, r: Recording) -> Recording:
        at = np.ceil(r.true_s / tick_s) * tick_s
        return stamped(r, r.stamps_s[0] + at + 2e-5 * (np.arange(len(at)) - np.searchsorted(at, at)), tick_s)

    return law


def blocks(first: int, second: int) -> Law:
    def law(rng: np.random.Generator, r: Recording) -> Recording:
        at = len(r.true_s) // 3
        order = np.arange(len(r.true_s))
        order[at : at + first + second] = np.r_[order[at + first : at + first + second], order[at : at + first]]
        return replace(
            r,
            true_s=r.true_s[order],
            stamps_s=r.stamps_s[order],
            identifier=[r.identifier[i] for i in order],
            data=[r.data[i] for i in order],
        )

    return law


def lost(r: Recording, keep: NDArray[np.bool_]) -> Recording:
    rows = np.flatnonzero(keep)
    return replace(
        r, true_s=r.true_s[rows], stamps_s=r.stamps_s[rows], identifier=[r.identifier[i] for i in rows], data=[r.data[i] for i in rows]
    )


def stopped(length_s: float, at_s: float = 2.0) -> Law:
    return lambda rng, r: lost(r, (r.true_s < at_s - 1e-4) | (r.true_s >= at_s + length_s - 1e-4))


def silent(channel: int, length_s: float, at_s: float = 2.0) -> Law:
    return lambda rng, r: lost(r, (np.array(r.identifier) != 0x180 + channel) | (r.true_s < at_s) | (r.true_s >= at_s + length_s))


def nothing(rng: np.random.Generator, r: Recording) -> Recording:
    return r


ROWS: list[tuple[str, str, dict[str, Any], Law, str]] = [
    *((f"clock starts again after {m:.6g} s", w, {"timing": t}, again(m, 2.5), "clock_wrap") for m, w, t in (
        (2**32 / 1e6, "GVRET", "free"), (2**32 / 1e6, "GVRET", "sync"), (60.0, "candump", "sync"), (60.0, "python-can", "free"),
        (65.536, "candump", "free"), (3600.0, "python-can", "sync"), (86400.0, "candump", "sync"))),
    *((f"clock set by {s:+g} s", w, {"timing": t}, set_by(s), "time") for s, w, t in (
        (-3.7, "candump", "sync"), (-86_321.5, "python-can", "free"), (-0.4, "python-can", "sync"), (3600.0, "candump", "sync"),
        (0.8, "candump", "free"), (1e9, "GVRET", "sync"))),
    *((f"{n} frame(s) stamped {s:+g} s", w, {"timing": t}, away(s, n), "stamp") for n, s, w, t in (
        (1, 6.2, "candump", "sync"), (1, -6.2, "python-can", "sync"), (7, 6.2, "GVRET", "sync"), (3, -1234.5, "candump", "free"),
        (1, 0.4, "python-can", "free"), (20, 77.0, "candump", "sync"))),
    *((f"stamps late: {n}", w, {"timing": t, "bits": 16}, law, "") for n, law, w, t in (
        ("15 ms once", held((2.0, 0.0151)), "candump", "sync"), ("150 ms once", held((2.0, 0.15)), "python-can", "sync"),
        ("40 ms, thrice", held((1.0, 0.04), (2.0, 0.04), (3.003, 0.04)), "candump", "sync"),
        ("0.9 s once", held((2.0, 0.9)), "GVRET", "sync"),
        ("every 16 ms", ticks(0.016), "candump", "sync"), ("100 ms once", held((2.0, 0.1)), "candump", "free"))),
    *((f"blocks of {a} and {b} frames exchanged", w, {"timing": t}, blocks(a, b), "reordered") for a, b, w, t in (
        (40, 40, "candump", "sync"), (300, 300, "python-can", "sync"), (20, 300, "candump", "sync"), (300, 25, "GVRET", "free"),
        (100, 200, "candump", "free"))),
    *((f"transmission types {','.join(map(str, e))}{', SYNC counts' * c}", w, {"every": e, "counter": c}, nothing, k) for e, c, w, k in (
        ((1,) * 6, True, "candump", ""), ((5,) * 6, False, "python-can", "unanswered"), ((5,) * 6, True, "candump", "unanswered"),
        ((2, 2, 2, 4, 4, 1), True, "GVRET", "unanswered"), ((1, 1, 1, 1, 1, 3), False, "candump", "unanswered"),
        ((60,) * 6, True, "candump", "unanswered"))),
    *((f"SYNC stops for {s:g} s", w, {"bits": b}, stopped(s), "pause") for s, b, w in (
        (2.0, 32, "candump"), (0.5, 32, "python-can"), (2.0, 16, "candump"), (1.0, 16, "GVRET"), (3.0, 32, "GVRET"))),
    *((f"ch{c} is silent for {s:g} s", w, {"bits": 16, "speed_mm_s": v}, silent(c, s), "gap") for c, s, v, w in (
        (3, 1.5, 60.0, "candump"), (1, 0.2, 300.0, "python-can"), (6, 2.5, 30.0, "GVRET"), (2, 1.0, 100.0, "candump"),
        (5, 2.0, 2500.0, "candump"))),
]  # fmt: skip


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


def main() -> None:
    """Make the table."""
    parser = options(__doc__)
    asked = parser.parse_args()
    lines = [
        "# Recordings with wrong clocks, and SYNC as CiA 301 has it",
        "",
        "`python benchmarks/recordings_clock.py --write`",
        "",
        "| recording | written by | timing | bits | samples | empty cells | wrong counts | time off [ms] | events |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, writer, settings, law, kind) in enumerate(ROWS):
            rng = np.random.default_rng(k)
            one = law(rng, recorded(rng, **settings))
            got = judged(WRITERS[writer](Path(folder) / f"log{k}", one), one)
            events = ", ".join(f"{n} {e}" for e, n in sorted(got.events.items()))
            good = got.wrong == 0 and (kind in got.events or not kind) and got.time_ms <= 1e3 * max(one.late_s, 5e-6) + 1.0
            failed += not good
            cells = (one.timing, one.bits, got.samples, got.empty, got.wrong, f"{got.time_ms:.3g}", events)
            lines.append(f"| {name}{'' if good else ' **WRONG**'} | {writer} | {' | '.join(map(str, cells))} |")
        lines += ["", f"{len(ROWS)} recordings, {failed} wrong."]
    show(asked, "\n".join(lines), "recordings_clock")


if __name__ == "__main__":
    main()
