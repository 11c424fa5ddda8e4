"""Record 12 encoders at 1 kHz from a bus between two processes, part after part: no count lost or changed, and memory flat.

    python benchmarks/acquisition_endurance.py --keep FILE [--parts N] [--what BUS ...] [--minutes M ...] [--write]

Another process sends, which knows nothing of lmeasure. Each start adds its parts to the record of the starts before.
"""

import platform
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from study import Study, table

for folder in ("helpers", "acquisition"):
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / folder))

from test_buses import positions, record_from, the_rig  # noqa: E402

from lmeasure.recording import read_run  # noqa: E402
from lmeasure.rig import Rig, rig_from_dict  # noqa: E402

RATE_HZ = 1000.0
CHANNELS = 12
EVERY_S = 5.0
"""Time between two looks at the memory."""


def rig_of_twelve() -> Rig:
    """Return the rig of the tests with its six drums twice."""
    data = the_rig().to_dict()
    for kind in ("observation_point", "cable"):
        data[kind] += [one | {"name": f"{one['name']}b"} for one in data[kind]]
    for n, cable in enumerate(data["cable"], 1):
        cable |= {"channel": f"ch{n}", "from": cable["from"] + ("b" if n > CHANNELS // 2 else "")}
    return rig_from_dict(data)


def memory_mb() -> float:
    """Return the memory of this process that is its own."""
    resident, shared = Path("/proc/self/statm").read_text().split()[1:3]
    return (int(resident) - int(shared)) * 4096 / 1e6


def draw(seed: int, what: str, minutes: float) -> dict[str, Any]:
    """Record one part, and compare every count with what was sent."""
    six = positions(round(minutes * 60 * RATE_HZ), RATE_HZ)
    counts = np.hstack([six, six[::-1] + seed])
    looks: list[float] = []
    done = threading.Event()

    def look() -> None:
        while not done.wait(EVERY_S):
            looks.append(memory_mb())

    watch = threading.Thread(target=look)
    with tempfile.TemporaryDirectory() as name:
        run = Path(name) / "run"
        watch.start()
        begun, used = time.monotonic(), time.process_time()
        try:
            recording, _ = record_from(what, counts, RATE_HZ, Path(name), rig_of_twelve())
        finally:
            done.set()
            watch.join()
        seconds, busy = time.monotonic() - begun, time.process_time() - used
        recorded = read_run(run).passes[0].recorded
        same = recorded.shape == counts.shape and np.array_equal(recorded, counts)
    quarter = max(len(looks) // 4, 1)
    return {
        "what": what, "minutes": seconds / 60.0, "counts": counts.size, "frames": recording.frames, "same": bool(same),
        "ended": recording.ended, "faults": dict(recording.faults), "share": busy / seconds,
        "first_mb": float(np.median(looks[quarter : 2 * quarter] or [0.0])), "last_mb": float(np.median(looks[-quarter:] or [0.0])),
    }  # fmt: skip


def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
    """Return the table of parts by bus."""
    rows = []
    for what in dict.fromkeys(one["what"] for one in records):
        own = [one for one in records if one["what"] == what]
        faults: dict[str, int] = {}
        for one in own:
            faults |= {kind: faults.get(kind, 0) + n for kind, n in one["faults"].items()}
        minutes = sum(one["minutes"] for one in own)
        rows.append([
            what, len(own), f"{minutes:.1f}", sum(one["counts"] for one in own), sum(one["frames"] for one in own),
            f"{sum(one['same'] for one in own)} of {len(own)}", ", ".join(f"{n} {kind}" for kind, n in sorted(faults.items())) or "none",
            f"{max((one['last_mb'] - one['first_mb'] for one in own), default=0.0):+.1f}",
            f"{100 * sum(one['share'] * one['minutes'] for one in own) / minutes:.0f} %",
        ])  # fmt: skip
    head = ["bus", "parts", "minutes", "counts sent", "frames received", "parts with every count, in order", "faults"]
    head += ["memory from the second to the last quarter [MB], worst part", "recorder's share of a core"]
    lines = [
        f"# {CHANNELS} encoders at {RATE_HZ:g} Hz between two processes",
        f"`python benchmarks/acquisition_endurance.py --keep FILE --write`, {platform.machine()}, Python {platform.python_version()}.",
        f"{sum(one['minutes'] for one in records) / 60.0:.2f} hours. A pause is a sender that the machine held up.",
        table(head, rows),
    ]
    return "\n\n".join(lines), all(one["same"] for one in records)


STUDY = Study(
    "acquisition_endurance", draw, page, "parts", 1,
    {"what": ("udp_multicast", "socketcand"), "minutes": (10.0, 0.5, 30.0, 60.0)}, "{what} {minutes} {seed}",
    lambda options, seed: [(what, options.minutes[0]) for what in options.what],
)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(STUDY.command(__doc__))
