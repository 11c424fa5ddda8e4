"""Log files to counts: `lmeasure` beside python-can's readers with cantools, in one run, on the same files, to the same counts.

    python benchmarks/log_files.py [--samples 60000] [--repeat 5] [--write]

The log is that of six encoders at 1 kHz: SYNC and six frames of 4 bytes per sample. The other side is what a user would write: iterate
over `can.LogReader`, decode each counter frame with cantools, take a row at every SYNC. Both run in turns; least CPU time of each.
--write writes the table to benchmarks/results/log_files.md.
"""

import os
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
from numpy.typing import NDArray
from study import options, show

from lmeasure.acquisition import LogReport, counter_fields
from lmeasure.acquisition.counters.assembly import counts_from_frames
from lmeasure.acquisition.logs.read import log_batches
from lmeasure.rig import Rig, rig_from_dict

FIRST_IDENTIFIER, SYNC = 0x181, 0x80
CABLES = 6
GOALS = {".blf": 20, ".asc": 50, ".log": 50}


def six_cables() -> Rig:
    """A rig whose encoders send what CiA 406 encoders send by default."""
    drum = {"counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 1.0, "tangent_length_mm": 180.0}
    points = [
        {
            "name": f"B{i}",
            "position_mm": [500.0 * (i % 3), -1500.0 + 300.0 * i, 1400.0],
            "guide_alpha_deg": 47.0,
            "guide_beta_deg": 30.0 * i,
            "pulley_radius_mm": 20.0,
            "drum": {**drum, "axial_offset_mm": 25.0, "counter_bits": 32},
        }
        for i in range(1, CABLES + 1)
    ]
    cables = [{"name": f"c{i}", "channel": f"ch{i}", "from": f"B{i}", "to": f"P{i % 3}"} for i in range(1, CABLES + 1)]
    tool = {"P0": [14.0, -14.0, 5.0], "P1": [-20.0, 3.0, 5.0], "P2": [3.0, 20.0, -5.0]}
    return rig_from_dict({"schema": "lmeasure.rig/1", "name": "six", "observation_point": points, "tool": tool, "cable": cables})


def write_logs(folder: Path, counts: NDArray[np.int64]) -> list[Path]:
    """The counts (n, 6) as BLF, ASC and candump logs."""
    paths = [folder / f"log{suffix}" for suffix in GOALS]
    with can.BLFWriter(paths[0]) as blf, can.ASCWriter(paths[1]) as asc, can.CanutilsLogWriter(paths[2]) as candump:
        for i, row in enumerate(counts):
            t = 1_700_000_000 + i * 1e-3
            messages = [can.Message(timestamp=t, arbitration_id=SYNC, is_extended_id=False, channel=0)]
            for j, count in enumerate(row):
                data = int(count).to_bytes(4, "little", signed=True)
                messages.append(
                    can.Message(
                        timestamp=t + (j + 1) * 1.2e-4, arbitration_id=FIRST_IDENTIFIER + j, is_extended_id=False, channel=0, data=data
                    )
                )
            for message in messages:
                for writer in (blf, asc, candump):
                    writer.on_message_received(message)
    return paths


def dbc() -> str:
    """The six counters as a DBC file."""
    blocks = [
        f'BO_ {FIRST_IDENTIFIER + j} Count{j + 1}: 4 Encoder\n SG_ ch{j + 1} : 0|32@1- (1,0) [0|0] "" Encoder\n' for j in range(CABLES)
    ]
    return 'VERSION ""\n\nBU_: Encoder\n\n' + "\n".join(blocks)


def by_libraries(path: Path) -> NDArray[np.float64]:
    """(n, 6) counts by python-can and cantools."""
    database: Any = cantools.database.load_string(dbc(), database_format="dbc")
    place = {FIRST_IDENTIFIER + j: (j, f"ch{j + 1}") for j in range(CABLES)}
    rows: list[list[float]] = []
    row: list[float] | None = None
    with can.LogReader(path) as reader:
        for message in reader:
            if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
                continue
            if message.arbitration_id == SYNC:
                row = [float("nan")] * CABLES
                rows.append(row)
            elif row is not None and message.arbitration_id in place:
                j, signal = place[message.arbitration_id]
                row[j] = database.decode_message(message.arbitration_id, message.data, decode_choices=False)[signal]
    return np.array(rows)


def by_lmeasure(path: Path) -> NDArray[np.float64]:
    """(n, 6) counts by `lmeasure`, every check of the import included."""
    rig = six_cables()
    return counts_from_frames(rig, log_batches(path, LogReport()), counter_fields(rig), source=str(path)).counts.recorded


def only_read(path: Path) -> int:
    """Frames read by the scan alone."""
    return sum(len(batch) for batch in log_batches(path, LogReport()))


def only_read_by_library(path: Path) -> int:
    """Frames read by python-can alone."""
    with can.LogReader(path) as reader:
        return sum(1 for _ in reader)


def best(*calls: tuple[Callable[[Path], object], int], path: Path) -> list[float]:
    """Shortest CPU time [s] of each call, threads included: what else a busy machine does falls on neither. They run in turns."""
    shortest = [float("inf")] * len(calls)
    for turn in range(max(repeat for _, repeat in calls)):
        for k, (call, repeat) in enumerate(calls):
            if turn < repeat:
                begin = time.process_time()
                call(path)
                shortest[k] = min(shortest[k], time.process_time() - begin)
    return shortest


def main() -> None:
    """Measure and print the table."""
    parser = options(__doc__)
    parser.add_argument("--samples", type=int, default=60_000)
    parser.add_argument("--repeat", type=int, default=5)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    counts = np.cumsum(rng.integers(-40, 41, (arguments.samples, CABLES)), axis=0)
    frames = (CABLES + 1) * arguments.samples
    lines = [
        f"{frames} frames of {arguments.samples} samples, {CABLES} encoders and SYNC; {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, python-can {can.__version__}, load {os.getloadavg()[0]:.1f}",
        "",
        "| log | MB | python-can + cantools, to counts | lmeasure, to counts | ratio | goal | frames only: python-can | the scan | ratio |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for path in write_logs(Path(folder), counts):
            mine, theirs = by_lmeasure(path), by_libraries(path)
            if not (np.array_equal(mine, theirs) and np.array_equal(mine, counts)):
                raise SystemExit(f"{path.suffix}: the counts differ")
            t = best(
                (by_libraries, 2), (by_lmeasure, arguments.repeat), (only_read_by_library, 2), (only_read, arguments.repeat), path=path
            )
            cells = [f"{frames / s / 1e6:.3g} M/s" for s in t]
            lines.append(
                f"| {path.suffix} | {path.stat().st_size / 1e6:.1f} | {cells[0]} | {cells[1]} | {t[0] / t[1]:.0f} | {GOALS[path.suffix]} "
                f"| {cells[2]} | {cells[3]} | {t[2] / t[3]:.0f} |"
            )
    show(arguments, "# Log files to counts\n\n`python benchmarks/log_files.py --write`\n\n" + "\n".join(lines), "log_files")


if __name__ == "__main__":
    main()
