"""Random recordings with restarts of encoders, wraps and late stamps: which counts are wrong, and whether the log's events state it.

    python benchmarks/recordings_study.py [--count 1000] [--seed 1] [--write]

Each recording has counters of 16, 24 or 32 bits of six cables on smooth random ways, and at random: an encoder that starts again, with a
boot-up frame, a reset by the master, or no word, behind a gap or none; late stamps; wrong stamps; a clock that starts again; a silent
channel; lost frames. A log is written as by candump -L and imported. A count is wrong where it differs from the truth by more than the
steps that the events state for the gaps before it; behind a word of the device, where it differs at all. --write writes the table to
benchmarks/results/recordings_study.md.
"""

import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from recordings_clock import BEGIN_S, PERIOD_S, SAMPLES, Recording, away, by_candump, held, judged, lost, recorded, stamped
from study import options, show

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
    asked = parser.parse_args()
    lines, bad = study(asked.count, asked.seed)
    head = ["# Random restarts, wraps and late stamps", "", f"`python benchmarks/recordings_study.py --count {asked.count}`", ""]
    text = "\n".join([*head, *lines, ""])
    show(asked, text, "recordings_study")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
