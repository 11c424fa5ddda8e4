"""What do the tests see of faults that nobody wrote a test for? Some are drawn from all faults of the core, and tried in the order drawn.

    python benchmarks/mutants_unseen.py --seed 23 --faults 70 --folder FOLDER [--processes 2] [--seconds 3600] [--write]

`mutants.py` says what a fault is. What was tried is kept in FOLDER, so that the command goes on where it was ended. Those of a file are
tried together, --batch at a time; what counts is what was drawn before the first that was not tried. After --seconds nothing new is
begun; what was begun is ended and counts too, as else the slow ones, which survive more often, would be missing. Writes
`benchmarks/results/mutants_unseen.md`.
"""

import argparse
import itertools
import json
import math
import multiprocessing
import random
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import scipy.stats
from core_tests import CORE
from mutants import RESULTS, equivalents, faults_of, load_libraries
from mutations import Mutant
from study import Kept
from trials import try_all

OUT = RESULTS / "mutants_unseen.md"


def written(seed: int, every: int, tried: list[tuple[Mutant, bool]]) -> str:
    """The report."""
    known = equivalents()
    same = [m for m, seen in tried if not seen and m.key in known]
    dead, reported = sum(seen for _, seen in tried), len(tried) - len(same)
    least = scipy.stats.beta.ppf(0.025, dead, reported - dead + 1) if dead else 0.0
    most = scipy.stats.beta.ppf(0.975, dead + 1, reported - dead) if dead < reported else 1.0
    lines = [
        "# What tests see of faults that no test was written for",
        "",
        f"`python benchmarks/mutants_unseen.py --seed {seed}`: {len(tried)} faults drawn from all {every} of the core.",
        "",
        f"**{dead} of {reported} killed ({100 * dead / max(reported, 1):.1f} %), {len(same)} equivalent ones apart;** of all faults it is "
        f"{100 * least:.1f} to {100 * most:.1f} % (95 %, Clopper and Pearson). "
        f"What is equivalent is told by looking at what survives: with nothing excused it is {dead} of {len(tried)} "
        f"({100 * dead / max(len(tried), 1):.1f} %).",
        "",
        "| file | line | fault | |",
        "|---|---|---|---|",
    ]
    for m, seen in sorted(tried, key=lambda one: (one[0].file, one[0].start)):
        end = "killed" if seen else f"equivalent: {known[m.key]}" if m.key in known else "**survives**"
        cells = (m.file, f"{m.line}: `{m.source}`", f"`{m.change}`", end)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _try(mutants: list[Mutant], kept: Path, until: float) -> None:
    """Try faults of one file, and keep what comes of each, unless it is later than until."""
    if time.monotonic() > until:
        return
    seen = Kept(kept)

    def tell(m: Mutant, killed: bool) -> None:
        seen(json.dumps(m.key), lambda: killed)
        print(f"{m.file}:{m.line} `{m.source}`: `{m.change}`: {'killed' if killed else 'SURVIVES'}", flush=True)

    known = equivalents()
    for m in mutants:
        if m.key in known:
            tell(m, False)
    if left := [m for m in mutants if m.key not in known]:
        try_all(left, CORE[left[0].file], keep=kept.parent, tell=tell)


def _told(order: list[Mutant], kept: Path) -> list[tuple[Mutant, bool]]:
    """The faults before the first that was not tried, and whether tests see each."""
    seen = Kept(kept).known
    return [(m, seen[json.dumps(m.key)]) for m in itertools.takewhile(lambda m: json.dumps(m.key) in seen, order)]


def main() -> None:
    """Draw, try, write after each batch."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--faults", type=int, required=True)
    parser.add_argument("--batch", type=int, default=50, help="faults that are drawn together")
    parser.add_argument("--processes", type=int, default=1, help="files that are tried beside each other")
    parser.add_argument("--seconds", type=float, default=math.inf, help="when to begin nothing new")
    parser.add_argument("--folder", type=Path, required=True, help="kept for the next time: what was tried, and which lines tests pass")
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    load_libraries()
    every, until = [m for file in CORE for m in faults_of(file)], time.monotonic() + asked.seconds
    order = random.Random(asked.seed).sample(every, min(asked.faults, len(every)))
    asked.folder.mkdir(parents=True, exist_ok=True)
    kept = asked.folder / f"unseen-{asked.seed}.jsonl"
    for first in range(0, len(order), asked.batch):
        left = [m for m in order[first : first + asked.batch] if json.dumps(m.key) not in Kept(kept).known]
        files = [[m for m in left if m.file == file] for file in dict.fromkeys(m.file for m in left)]
        with ProcessPoolExecutor(asked.processes, multiprocessing.get_context("fork")) as pool:
            list(pool.map(_try, files, itertools.repeat(kept), itertools.repeat(until)))
        tried = _told(order, kept)
        text = written(asked.seed, len(every), tried)
        print(text.splitlines()[4], flush=True)
        if asked.write:
            OUT.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
