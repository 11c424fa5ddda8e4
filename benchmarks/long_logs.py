"""Long logs on two workers: processor time of a sample and largest memory of a process, from 10^5 to 10^8 samples.

    python benchmarks/long_logs.py [--samples 100000 1000000 10000000 100000000] [--job import reconstruct] [--keep FILE] [--write]

`import` reads a BLF log of six encoders, seven frames a sample, in uncompressed containers: 336 bytes a sample, so that 30 million samples
are 10 GB. `reconstruct` takes a run folder to poses with covariances on two worker processes, part by part. The motion repeats every 100 s:
logs are written as fast as the disk takes them. They are deleted after each draw.
"""

import os
import resource
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it

import can
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from cluster import two_workers
from numpy.typing import NDArray
from reconstruction import START, at, cell
from study import Study, table

from lmeasure.io import files
from lmeasure.recording import Counts, Run, write_run
from lmeasure.rig import write_rig
from lmeasure.sensors import counts_from_poses, recorded_from_counts

PERIOD = 100_000
"""Samples of 1 ms after which the motion repeats."""
FIRST_IDENTIFIER, SYNC = 0x181, 0x80
OBJECT = np.dtype(
    [("signature", "S4"), ("header", "<u2"), ("version", "<u2"), ("size", "<u4"), ("kind", "<u4"), ("flags", "<u4"), ("client", "<u2")]
    + [("object_version", "<u2"), ("time_ns", "<u8"), ("channel", "<u2"), ("direction", "u1"), ("length", "u1"), ("identifier", "<u4")]
    + [("data", "<i4", 2)]
)  # fmt: skip
"""CAN_MESSAGE of BLF with both of its headers."""
SAMPLES_OF_CONTAINER = 390
"""About 128 KiB, as recorders write them."""


def one_period() -> NDArray[np.int64]:
    """(PERIOD, 6) counts."""
    rig = cell()
    return np.rint(recorded_from_counts(rig, counts_from_poses(rig, at(np.arange(PERIOD) / 1000.0), START))).astype(np.int64)


def write_log(path: Path, samples: int) -> None:
    """Write a BLF log: a SYNC and six frames of 4 bytes every millisecond."""
    counts, m = one_period(), 7
    objects = np.zeros((PERIOD, m), OBJECT)
    for name, value in (("signature", b"LOBJ"), ("header", 32), ("version", 1), ("size", 48), ("kind", 1), ("flags", 2), ("channel", 1)):
        objects[name] = value
    objects["identifier"] = [SYNC, *range(FIRST_IDENTIFIER, FIRST_IDENTIFIER + 6)]
    objects["length"][:, 1:] = 4
    objects["data"][:, 1:, 0] = counts
    with can.BLFWriter(path) as head:
        head.on_message_received(can.Message(timestamp=1_700_000_000.0, arbitration_id=0x700, is_extended_id=False))
    with path.open("r+b") as out:
        header = bytearray(out.read(144))
        out.seek(144)
        out.truncate()
        for begin in range(0, samples, PERIOD):
            some = objects[: min(PERIOD, samples - begin)]
            some["time_ns"] = (begin + np.arange(len(some)))[:, None] * 1_000_000 + np.arange(m) * 120_000
            for first in range(0, len(some), SAMPLES_OF_CONTAINER):
                body = some[first : first + SAMPLES_OF_CONTAINER].tobytes()
                out.write(struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(body), 10) + struct.pack("<H6xL4x", 0, len(body)) + body)
        struct.pack_into("<QQLL", header, 16, out.tell(), out.tell(), m * samples, 0)
        out.seek(0)
        out.write(header)


def write_counts_of(folder: Path, samples: int) -> None:
    """Write a run folder with counts in Parquet."""
    rig, counts = cell(), one_period()
    channels = tuple(c.channel for c in rig.cable)
    write_run(folder, Run(rig, START, (Counts(np.zeros(1), channels, np.zeros((1, 6))),), unstated="exact"), suffix=".parquet")
    with files.table_writer(folder / "pass1.parquet") as write:
        for begin in range(0, samples, PERIOD):
            some = counts[: samples - begin].astype(np.float64)
            write(Counts((begin + np.arange(len(some))) / 1000.0, channels, some).columns())


class Watched:
    """Largest memory [MB] and processor seconds of processes, while they live."""

    def __init__(self, pids: Sequence[int]) -> None:
        self.memory_mb = dict.fromkeys(pids, 0.0)
        self.seconds = dict.fromkeys(pids, 0.0)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(0.1):
            self.look()

    def look(self) -> None:
        """Read what the system says of each that lives."""
        for pid in self.memory_mb:
            try:
                status, stat = Path(f"/proc/{pid}/status").read_text(), Path(f"/proc/{pid}/stat").read_text()
            except OSError:
                continue
            if "VmHWM" in status:
                self.memory_mb[pid] = int(status.split("VmHWM:")[1].split()[0]) / 1024
            self.seconds[pid] = sum(map(int, stat.rpartition(")")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        """Stop."""
        self._over.set()
        self._thread.join()


def measured(arguments: list[str], workers: Sequence[int] = ()) -> dict[str, Any]:
    """Return the processor seconds of a command and its workers, and the largest memory of each [MB]."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = subprocess.Popen([sys.executable, "-m", "lmeasure", *arguments, "-q"], stdout=subprocess.DEVNULL)
    watched = Watched([command.pid, *workers])
    earlier = sum(watched.seconds[pid] for pid in workers)
    try:
        if command.wait():
            raise SystemExit(f"{' '.join(arguments)}: exit code {command.returncode}")
        watched.look()
    finally:
        watched.end()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    own_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "seconds": own_s + sum(watched.seconds[pid] for pid in workers) - earlier,
        "wall_s": time.perf_counter() - begun,
        "command_mb": watched.memory_mb[command.pid],
        "worker_mb": max((watched.memory_mb[pid] for pid in workers), default=0.0),
    }


def draw(seed: int, job: str, samples: int) -> dict[str, Any]:
    """Write the input, do the job, and delete both."""
    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        if job == "import":
            write_log(here / "long.blf", samples)
            write_rig(here / "rig.toml", cell())
            size = (here / "long.blf").stat().st_size
            found = measured(["import", f"{here}/long.blf", "--rig", f"{here}/rig.toml", "--out", f"{here}/run", "--parquet"])
        else:
            write_counts_of(here / "run", samples)
            size = (here / "run" / "pass1.parquet").stat().st_size
            with two_workers() as cluster:
                arguments = ["reconstruct", f"{here}/run", "--out", f"{here}/t.parquet", "--scheduler", cluster.address]
                found = measured(arguments, [process.pid for process in cluster.workers])
        return {"job": job, "samples": samples, "gigabytes": size / 1e9, "load": os.getloadavg()[0]} | found


def page(records: list[dict[str, Any]]) -> str:
    """Return the table: cost of each sample beyond those of the shortest log, so that starting counts for nothing."""
    rows = []
    for job in ("import", "reconstruct"):
        mine = sorted((r for r in records if r["job"] == job), key=lambda r: r["samples"])
        for r in mine:
            more = r["samples"] - mine[0]["samples"]
            per = f"{1e6 * (r['seconds'] - mine[0]['seconds']) / more:.2f}" if more else ""
            row = [job, f"{r['samples']:,}", f"{r['gigabytes']:.2f}", f"{r['seconds']:.0f}", per]
            rows.append([*row, f"{r['command_mb']:.0f}", f"{r['worker_mb']:.0f}" if r["worker_mb"] else "", f"{r['load']:.0f}"])
    head = ["job", "samples", "input [GB]", "processor [s]", "µs a further sample", "command [MB]", "each worker at most [MB]", "load"]
    return f"# Long logs\n\n`python benchmarks/long_logs.py --write`\n\n{table(head, rows)}"


STUDY = Study(
    "long_logs",
    draw,
    page,
    count=1,
    factors={"job": ("import", "reconstruct"), "samples": (100_000, 1_000_000, 10_000_000, 30_000_000, 100_000_000)},
)

if __name__ == "__main__":
    raise SystemExit(STUDY.command(__doc__))
