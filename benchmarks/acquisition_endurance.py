"""Ten minutes of six encoders at 1 kHz between two processes: 3.6 million counts, none lost, none changed.

`python benchmarks/acquisition_endurance.py [--minutes 10] [udp_multicast socketcand]` prints a table and writes it to
benchmarks/results/acquisition_endurance.md. The feed is the tests' own process, which knows nothing of lmeasure.
"""

import argparse
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "acquisition"))

from test_buses import a_group, feeding, positions, record_all, the_rig  # noqa: E402

from lmeasure.acquisition.session import connect  # noqa: E402
from lmeasure.run import read_run  # noqa: E402

RATE_HZ = 1000.0


def run(what: str, minutes: float) -> str:
    """A row of the table."""
    counts, rig = positions(round(minutes * 60 * RATE_HZ), RATE_HZ), the_rig()
    group = a_group()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begin, used = time.monotonic(), time.process_time()
        with feeding(what, counts, RATE_HZ, group if what == "udp_multicast" else {}, folder) as (said, process):
            if what == "udp_multicast":
                link = connect(rig, folder, f"udp_multicast:{group['channel']}", options={"port": group["port"]})
            else:
                link = connect(rig, folder, "socketcand:can0", options={"host": "127.0.0.1", "port": int(said)})
            recording = record_all(rig, link, process, folder / "run")
        seconds, busy = time.monotonic() - begin, time.process_time() - used
        recorded = read_run(folder / "run").passes[0].recorded
        same = recorded.shape == counts.shape and np.array_equal(recorded, counts)
        faults = ", ".join(f"{n} {k}" for k, n in sorted(recording.faults.items())) or "none"
    print(what, recording.summary(), "bit-identical" if same else "NOT the counts that were sent", flush=True)
    share = 100 * busy / seconds
    return f"| {what} | {counts.size} | {recording.frames} | {'yes' if same else 'NO'} | {faults} | {share:.0f} % |"


def main() -> None:
    """Run what was asked for, print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", default=["udp_multicast", "socketcand"])
    parser.add_argument("--minutes", type=float, default=10.0)
    asked = parser.parse_args()
    rows = [run(what, asked.minutes) for what in asked.what]
    text = "\n".join(
        [
            f"# Six encoders at {RATE_HZ:g} Hz for {asked.minutes:g} minutes between two processes",
            "",
            f"`python benchmarks/acquisition_endurance.py --minutes {asked.minutes:g}`, {platform.machine()}, {os.cpu_count()} cores",
            f"shared with other work, Python {platform.python_version()}.",
            "",
            "| bus | counts sent | frames received | all counts bit-identical, in order | faults | recorder's share of a core |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
        ]
    )
    (HERE / "results").mkdir(exist_ok=True)
    (HERE / "results" / "acquisition_endurance.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
