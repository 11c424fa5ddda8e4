"""What do the tests see of faults that nobody wrote a test for? Some are drawn from all faults of the core, and tried in the order drawn.

    python benchmarks/mutants_unseen.py --seed 23 --faults 70 --folder FOLDER

`mutants.py` says what a fault is. What was tried is kept in FOLDER, so that the command goes on where it was ended; ended early, what was
tried is a smaller draw of the same kind, for the order is drawn too. Kernels are not compiled: what only longer tests would see survives. A
fault is seen where tests fail with it and what failed passes without it. Writes `benchmarks/results/mutants_unseen.md`.
"""

import argparse
import json
import random
from functools import partial
from pathlib import Path

import scipy.stats
from core_tests import CORE, PLAIN
from mutants import RESULTS, equivalents, faults_of, load_libraries
from mutated_copy import Copy
from mutations import Mutant
from pieces import Pieces

OUT = RESULTS / "mutants_unseen.md"


def written(seed: int, every: int, tried: list[tuple[Mutant, bool]]) -> str:
    """The report."""
    known = equivalents()
    same = [m for m, seen in tried if not seen and m.key in known]
    dead, told = sum(seen for _, seen in tried), len(tried) - len(same)
    least = scipy.stats.beta.ppf(0.025, dead, told - dead + 1) if dead else 0.0
    most = scipy.stats.beta.ppf(0.975, dead + 1, told - dead) if dead < told else 1.0
    lines = [
        "# What tests see of faults that no test was written for",
        "",
        f"`python benchmarks/mutants_unseen.py --seed {seed}`: {len(tried)} faults drawn from all {every} of the core.",
        "",
        f"**{dead} of {told} killed ({100 * dead / max(told, 1):.1f} %), {len(same)} equivalent ones apart;** of all faults it is "
        f"{100 * least:.1f} to {100 * most:.1f} % (95 %, Clopper and Pearson).",
        "",
        "| file | line | fault | |",
        "|---|---|---|---|",
    ]
    for m, seen in sorted(tried, key=lambda one: (one[0].file, one[0].start)):
        end = "killed" if seen else f"equivalent: {known[m.key]}" if m.key in known else "**survives**"
        cells = (m.file, f"{m.line}: `{m.source}`", f"`{m.change}`", end)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Draw, try, write after each."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--faults", type=int, required=True)
    parser.add_argument("--limit-s", type=float, default=600.0, help="longest time of a file's tests")
    parser.add_argument("--folder", type=Path, required=True, help="kept for the next time: what was tried, and what is compiled")
    asked = parser.parse_args()
    load_libraries()
    every = [m for file in CORE for m in faults_of(file)]
    order = random.Random(asked.seed).sample(every, min(asked.faults, len(every)))
    asked.folder.mkdir(parents=True, exist_ok=True)
    seen = Pieces(asked.folder / f"unseen-{asked.seed}.jsonl")
    known = equivalents()
    copies = {quick: Copy(asked.folder / str(quick), quick) for quick in (False, True)}
    tried: list[tuple[Mutant, bool]] = []

    def killed(m: Mutant) -> bool:
        kernel = m.file.startswith("kernels/")
        tests = PLAIN.get(m.file, CORE[m.file])
        return m.key not in known and copies[kernel].killed(m, tests, asked.limit_s, plain=kernel, recorded=not kernel)

    for number, m in enumerate(order, 1):
        tried.append((m, seen(json.dumps(m.key), partial(killed, m))))
        print(f"{number}: {m.file}:{m.line} {m.change}: {'killed' if tried[-1][1] else 'SURVIVES'}", flush=True)
        OUT.write_text(written(asked.seed, len(every), tried), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
