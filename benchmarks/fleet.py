"""A batch of runs: what an item costs beyond its own work, how much faster two workers are, and the same bytes though workers are killed.

    python benchmarks/fleet.py [--runs 1000] [--samples 10000] [--repeats 5] [--kills 20] [--keep FILE] [--write]

Runs of a simulated cell, no two equal, are reconstructed by `lmeasure batch` in one process, and by two worker processes on loopback.
Beside it: the same reconstructions one after the other without a store. Overhead per item: wall time of the batch in one process less
that, over the number of runs. Then workers are killed at random moments, and new ones begun in their place; the store must hold the same
bytes. Times are wall times, medians of the repeats: a machine that does other things makes them long. A start with the `--keep` of another
continues it after its last repeat.
"""

import hashlib
import os
import random
import shutil
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from cluster import two_workers, worker
from study import Kept, options, show, table

from lmeasure.recording import write_run
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.workflows import load

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def write_runs(folder: Path, runs: int, samples: int) -> None:
    """Write runs of a cell that moves between places of its own."""
    for k in range(runs):
        rng = np.random.default_rng(k)
        legs = [
            Leg(np.concatenate([rng.uniform(-100.0, 100.0, 3), [0.0, 0.0, 0.0, 1.0]]), 300.0, 1.0, 0.2) for _ in range(samples // 500 + 2)
        ]
        time_s, poses = smooth_path(HOME, legs, 1000.0)
        run = simulate_run(cell_rig(0), time_s[:samples], poses[:samples], noise_mm=0.0, rng=rng).run
        write_run(folder / f"robot={k % 20}" / f"day={k // 20}" / f"run{k}", run)


def batch(folder: Path, store: Path, scheduler: str | None = None) -> tuple[float, dict[str, float]]:
    """Return wall seconds and figures of a batch."""
    flow = load("batch")
    begun = time.perf_counter()
    settings = {"command": "reconstruct", "items": [f"{folder}/*/*/*"], "out": str(store), "scheduler": scheduler}
    result = flow.run(flow.settings.model_validate(settings))
    return time.perf_counter() - begun, dict(result.figures)


def alone(runs: Sequence[Path], out: Path) -> float:
    """Return wall seconds of the same reconstructions without a store."""
    flow, begun = load("reconstruct"), time.perf_counter()
    for n, run in enumerate(runs):
        flow.run(flow.settings.model_validate({"run": run, "out": out / f"{n}.parquet", "force": True}))
    return time.perf_counter() - begun


def digest(store: Path) -> str:
    """Return one digest of all trajectories by their names."""
    found = sorted((store / "trajectory").rglob("*.parquet"))
    names = [(str(path.relative_to(store)), hashlib.sha256(path.read_bytes()).hexdigest()) for path in found]
    return hashlib.sha256(repr(names).encode()).hexdigest()


def repeat(here: Path) -> dict[str, Any]:
    """Return wall seconds of the three ways through all runs, those of a batch with nothing left to do, and the digest of the results."""
    runs = here / "runs"
    plain = alone(sorted(runs.glob("*/*/*")), here)
    one, _ = batch(runs, here / "one")
    with two_workers() as cluster:
        two, _ = batch(runs, here / "two", cluster.address)
    again, figures = batch(runs, here / "one")
    assert figures["unchanged"] == figures["items"], figures
    same = digest(here / "one")
    assert digest(here / "two") == same
    for store in ("one", "two"):
        shutil.rmtree(here / store)
    return {"alone": plain, "one": one, "two": two, "again": again, "digest": same}


def with_kills(folder: Path, store: Path, kills: int, seconds: float) -> dict[str, Any]:
    """Return how many workers were killed during a batch, its wall seconds, and the digest of its results."""
    rng, killed, over = random.Random(0), 0, threading.Event()
    with two_workers() as cluster:

        def kill() -> None:
            nonlocal killed
            while killed < kills and not over.wait(rng.uniform(0.5, 1.5) * seconds / kills):
                victim = rng.randrange(2)
                os.kill(cluster.workers[victim].pid, signal.SIGKILL)
                cluster.workers[victim].wait()
                cluster.workers[victim] = worker(cluster.address)
                killed += 1

        thread = threading.Thread(target=kill)
        thread.start()
        try:
            took, figures = batch(folder, store, cluster.address)
        finally:
            over.set()
            thread.join()
    assert figures["failed"] == 0, figures
    return {"killed": killed, "seconds": took, "digest": digest(store)}


def main() -> None:
    """Run the parts and print the table."""
    parser = options(__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--keep", type=Path, help="file of what has run, to continue from")
    arguments = parser.parse_args()
    kept = Kept(arguments.keep)
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        write_runs(here / "runs", arguments.runs, arguments.samples)
        alone(list((here / "runs" / "robot=0").glob("*/*")), here)  # compiles
        repeats = [kept(f"{arguments.runs} {arguments.samples} repeat {n}", partial(repeat, here)) for n in range(arguments.repeats)]
        plain, one, two, again = (statistics.median(r[way] for r in repeats) for way in ("alone", "one", "two", "again"))
        (same,) = {r["digest"] for r in repeats}
        rows = [
            ("reconstructions alone", f"{plain:.1f} s"),
            ("batch in one process", f"{one:.1f} s"),
            ("overhead per item", f"{1000.0 * statistics.median(r['one'] - r['alone'] for r in repeats) / arguments.runs:.1f} ms"),
            ("batch on two workers", f"{two:.1f} s"),
            ("speed-up", f"{statistics.median(r['one'] / r['two'] for r in repeats):.2f}"),
            ("batch of what is done", f"{1000 * again / arguments.runs:.1f} ms an item"),
        ]
        if arguments.kills:
            one_more = partial(with_kills, here / "runs", here / "killed", arguments.kills, two)
            found = kept(f"{arguments.runs} {arguments.samples} {arguments.kills} kills", one_more)
            bytes_ = "the same" if found["digest"] == same else "OTHER"
            rows.append((f"batch with {found['killed']} workers killed", f"{found['seconds']:.1f} s, {bytes_} bytes"))
    stated = {name: getattr(arguments, name) for name in ("runs", "samples", "repeats", "kills")}
    command = " ".join(["python benchmarks/fleet.py", *(f"--{name} {value}" for name, value in stated.items())])
    size = f"{arguments.runs} runs of {arguments.samples} samples, {os.cpu_count()} processors, medians of {arguments.repeats}"
    show(arguments, f"# A batch of runs\n\n`{command}`: {size}.\n\n{table(['what', 'result'], rows)}", "fleet")


if __name__ == "__main__":
    main()
