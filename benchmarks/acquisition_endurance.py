"""Ten minutes of six encoders at 1 kHz between two processes: 3.6 million counts, none lost, none changed.

`python benchmarks/acquisition_endurance.py [--minutes 10] [udp_multicast socketcand] [--write]`

The feed is the tests' own process, which knows nothing of lmeasure.
"""

import os
import platform
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

for folder in ("helpers", "acquisition"):
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / folder))

from study import options, show, table  # noqa: E402
from test_buses import positions, record_from  # noqa: E402

from lmeasure.recording import read_run  # noqa: E402

RATE_HZ = 1000.0


def run(what: str, minutes: float) -> list[Any]:
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
    return [what, f"{minutes:g}", counts.size, recording.frames, "yes" if same else "NO", faults, f"{share:.0f} %"]


def main() -> None:
    """Run what was asked for, print and keep the table."""
    parser = options(__doc__)
    parser.add_argument("what", nargs="*", default=["udp_multicast", "socketcand"])
    parser.add_argument("--minutes", type=float, default=10.0)
    asked = parser.parse_args()
    rows = [run(what, asked.minutes) for what in asked.what]
    head = ["bus", "minutes", "counts sent", "frames received", "all counts bit-identical, in order", "faults"]
    head += ["recorder's share of a core"]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    about = f"# Six encoders at {RATE_HZ:g} Hz between two processes\n\n`python benchmarks/acquisition_endurance.py --write`, {machine}."
    show(asked, f"{about}\n\n{table(head, rows)}", "acquisition_endurance")


if __name__ == "__main__":
    main()
