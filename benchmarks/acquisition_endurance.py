"""Ten minutes of six encoders at 1 kHz between two processes: 3.6 million counts, none lost, none changed.

`python benchmarks/acquisition_endurance.py [--minutes 10] [udp_multicast socketcand]` prints a table and writes it to
benchmarks/results/acquisition_endurance.md. The feed is the tests' own process, which knows nothing of lmeasure.
"""

import argparse
import os
import platform
import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from test_buses import positions, record_from  # noqa: E402

from lmeasure.recording import read_run  # noqa: E402

RATE_HZ = 1000.0
TITLE = f"# Six encoders at {RATE_HZ:g} Hz between two processes"


def run(what: str, minutes: float) -> str:
    """A row of the table."""
    counts = positions(round(minutes * 60 * RATE_HZ), RATE_HZ)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begin, used = time.monotonic(), time.process_time()
        recording, _ = record_from(what, counts, RATE_HZ, folder)
        seconds, busy = time.monotonic() - begin, time.process_time() - used
        recorded = read_run(folder / "run").passes[0].recorded
        same = recorded.shape == counts.shape and np.array_equal(recorded, counts)
        faults = ", ".join(f"{n} {k}" for k, n in sorted(recording.faults.items())) or "none"
        events = folder / "run" / "pass1.events.csv"
        if events.exists():  # where in the run it lay
            print(events.read_text()[:4000])
    print(what, recording.summary(), "bit-identical" if same else "NOT the counts that were sent", flush=True)
    share = 100 * busy / seconds
    return f"| {what} | {minutes:g} | {counts.size} | {recording.frames} | {'yes' if same else 'NO'} | {faults} | {share:.0f} % |"


def main() -> None:
    """Run what was asked for, print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", default=["udp_multicast", "socketcand"])
    parser.add_argument("--minutes", type=float, default=10.0)
    asked = parser.parse_args()
    rows = [run(what, asked.minutes) for what in asked.what]
    text = "\n".join(
        [
            TITLE,
            "",
            f"`python benchmarks/acquisition_endurance.py --minutes {asked.minutes:g}`, {platform.machine()}, {os.cpu_count()} cores, "
            f"Python {platform.python_version()}.",
            "",
            "| bus | minutes | counts sent | frames received | all counts bit-identical, in order | faults | recorder's share of a core |",
            "|---|---|---|---|---|---|---|",
            *rows,
            "",
        ]
    )
    print(text)
    target = HERE / "results" / "acquisition_endurance.md"
    # the sections of other runs stay
    before = target.read_text() if target.exists() else ""
    others = [part for part in re.split(r"(?m)^(?=# )", before) if part.strip() and not part.startswith(TITLE)]
    target.parent.mkdir(exist_ok=True)
    target.write_text("\n".join([text, *others]))


if __name__ == "__main__":
    main()
