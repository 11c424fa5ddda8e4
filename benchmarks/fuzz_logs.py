"""Mutated logs, DBC files and rig files for as long as asked: each is read, or refused in one line.

    python benchmarks/fuzz_logs.py [--seconds 60] [--seed 0] [--keep]

--seconds are of CPU.

Every log that is read is also put to python-can, and must hold the same frames. A file that misbehaves (a traceback, other frames) is
counted as neither and kept in the folder named; one that takes longer than a minute ends the run. --keep writes counts and rates to
benchmarks/results/fuzz_logs.md.
"""

import argparse
import faulthandler
import logging
import platform
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "acquisition"))

import log_fuzz

LONGEST_S = 60.0


def main() -> None:
    """Run, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", action="store_true")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)  # python-can's remarks about the mutated files
    outcomes: Counter[tuple[str, str]] = Counter()
    folder = Path(tempfile.mkdtemp(prefix="fuzz-logs-"))
    slowest, last = 0.0, 0.0
    peak_before = 0

    def done(kind: str, outcome: str) -> None:
        nonlocal slowest, last
        now = time.perf_counter()
        slowest, last = max(slowest, now - last), now
        faulthandler.dump_traceback_later(LONGEST_S, exit=True)
        outcomes[kind, outcome] += 1

    log_fuzz.run(folder, 50, asked.seed, lambda kind, outcome: None)  # compiles everything
    peak_before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    last, cpu = time.perf_counter(), time.process_time()
    turn = 0
    while time.process_time() - cpu < asked.seconds:
        turn += 1
        log_fuzz.run(folder, 500, asked.seed * 1_000_000 + turn, done, go_on=True)
    faulthandler.cancel_dump_traceback_later()
    cpu = time.process_time() - cpu
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_before
    kinds = sorted({kind for kind, _ in outcomes})
    lines = [
        f"{outcomes.total()} files in {cpu:.0f} s of CPU, {outcomes.total() / cpu:.0f} a second; slowest {slowest:.2f} s; memory grew by "
        f"{grown / 1024:.0f} MB; {platform.machine()}, Python {platform.python_version()}, seed {asked.seed}",
        "",
        "| kind | accepted | refused in one line | neither |",
        "|---|---|---|---|",
        *(f"| {kind} | {outcomes[kind, 'accepted']} | {outcomes[kind, 'refused']} | {outcomes[kind, 'neither']} |" for kind in kinds),
    ]
    table = "\n".join(lines)
    print(table)
    if any(outcome == "neither" for _, outcome in outcomes):
        print(f"kept: {folder}")
    if asked.keep:
        target = Path(__file__).parent / "results" / "fuzz_logs.md"
        target.parent.mkdir(exist_ok=True)
        command = f"python benchmarks/fuzz_logs.py --seconds {asked.seconds:g} --seed {asked.seed} --keep"
        target.write_text(f"# Mutated logs, DBC files and rig files\n\n`{command}`\n\n{table}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
