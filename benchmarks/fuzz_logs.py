"""Mutated logs, DBC files and rig files: each is read, or refused in one line, and no line or object of a log is lost without a word.

    python benchmarks/fuzz_logs.py [--mutations 200] [--seed 0] [--write]

--mutations are of each kind of file: half of those of text logs change lines and words, the others bytes. Every log that is read must
account for all lines or BLF objects, counted independently (silent: it does not). Its frames must be those that python-can reads, where it
reads that kind. A file that misbehaves otherwise (a traceback, other frames) is "neither". Both are kept in the folder named; a file that
takes longer than a minute ends the run. --write writes the table to benchmarks/results/fuzz_logs.md.
"""

import faulthandler
import logging
import platform
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import log_fuzz
from study import options, show

LONGEST_S = 60.0
OUTCOMES = ("accepted", "refused", "silent", "neither")


def main() -> None:
    """Run, and print the table."""
    parser = options(__doc__)
    parser.add_argument("--mutations", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    logging.disable(logging.WARNING)  # python-can's remarks about the mutated files
    outcomes: Counter[tuple[str, str]] = Counter()
    folder = Path(tempfile.mkdtemp(prefix="fuzz-logs-"))
    slowest, last = 0.0, 0.0

    def done(kind: str, outcome: str) -> None:
        nonlocal slowest, last
        now = time.perf_counter()
        slowest, last = max(slowest, now - last), now
        faulthandler.dump_traceback_later(LONGEST_S, exit=True)
        outcomes[kind, outcome] += 1

    kinds = list(log_fuzz.seeds(folder))
    log_fuzz.run(folder, 5 * len(kinds), asked.seed + 1, lambda kind, outcome: None)  # compiles everything
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    last, cpu = time.perf_counter(), time.process_time()
    log_fuzz.run(folder, asked.mutations * len(kinds), asked.seed, done, go_on=True)
    faulthandler.cancel_dump_traceback_later()
    cpu = time.process_time() - cpu
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    lines = [
        f"{outcomes.total()} files in {cpu:.0f} s of CPU, {outcomes.total() / cpu:.0f} a second; slowest {slowest:.2f} s; memory grew by "
        f"{grown / 1024:.0f} MB; {platform.machine()}, Python {platform.python_version()}, seed {asked.seed}",
        "",
        "| kind | read | refused in one line | silent | neither |",
        "|---|---|---|---|---|",
        *(f"| {kind} | {' | '.join(str(outcomes[kind, outcome]) for outcome in OUTCOMES)} |" for kind in sorted(kinds)),
    ]
    command = f"python benchmarks/fuzz_logs.py --mutations {asked.mutations} --seed {asked.seed} --write"
    show(asked, f"# Mutated logs, DBC files and rig files\n\n`{command}`\n\n" + "\n".join(lines), "fuzz_logs")
    if any(outcome in ("silent", "neither") for _, outcome in outcomes):
        print(f"kept: {folder}")


if __name__ == "__main__":
    main()
