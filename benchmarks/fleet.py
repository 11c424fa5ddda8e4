"""A batch of runs: what an item costs beyond its own work, how much faster two workers are, and the same bytes though workers are killed.

    python benchmarks/fleet.py [--runs 1000] [--samples 10000] [--repeats 5] [--kills 20] [--write]

Runs of a simulated cell, no two equal, are reconstructed by `lmeasure batch` in one process, and by two worker processes on loopback.
Beside it: the same reconstructions one after the other without a store. Overhead per item: wall time of the batch in one process less
that, over the number of runs. Then workers are killed at random moments, and new ones begun in their place; the store must hold the same
bytes. Times are wall times, medians of the repeats: a machine that does other things makes them long.
"""

import hashlib
import os
import random
import signal
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from cluster import two_workers, worker
from study import options, show, table

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
    arguments = {"command": "reconstruct", "items": [f"{folder}/*/*/*"], "out": str(store), "scheduler": scheduler}
    result = flow.run(flow.settings.model_validate(arguments))
    return time.perf_counter() - begun, dict(result.figures)


def alone(folder: Path, out: Path) -> float:
    """Return wall seconds of the same reconstructions without a store."""
    flow, begun = load("reconstruct"), time.perf_counter()
    for n, run in enumerate(sorted(folder.glob("*/*/*"))):
        flow.run(flow.settings.model_validate({"run": run, "out": out / f"{n}.parquet", "force": True}))
    return time.perf_counter() - begun


def digests(store: Path) -> dict[str, str]:
    """Return the digest of each trajectory."""
    found = sorted((store / "trajectory").rglob("*.parquet"))
    return {str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def with_kills(folder: Path, store: Path, kills: int, seconds: float) -> tuple[int, float]:
    """Return how many workers were killed during a batch, and its wall seconds."""
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
    return killed, took


def main() -> None:
    """Run the parts and print the table."""
    parser = options(__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--kills", type=int, default=20)
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        write_runs(here / "runs", arguments.runs, arguments.samples)
        alone(here / "runs", here)  # compiles
        plain, one, two = [], [], []
        for n in range(arguments.repeats):
            plain.append(alone(here / "runs", here))
            one.append(batch(here / "runs", here / f"one{n}")[0])
            with two_workers() as cluster:
                two.append(batch(here / "runs", here / f"two{n}", cluster.address)[0])
            assert digests(here / f"one{n}") == digests(here / f"two{n}") == digests(here / "one0")
        again, figures = batch(here / "runs", here / "one0")
        assert figures["unchanged"] == arguments.runs
        overhead = 1000.0 * (statistics.median(one) - statistics.median(plain)) / arguments.runs
        rows += [
            ("reconstructions alone", f"{statistics.median(plain):.1f} s"),
            ("batch in one process", f"{statistics.median(one):.1f} s"),
            ("overhead per item", f"{overhead:.1f} ms"),
            ("batch on two workers", f"{statistics.median(two):.1f} s"),
            ("speed-up", f"{statistics.median(a / b for a, b in zip(one, two, strict=True)):.2f}"),
            ("batch of what is done", f"{1000 * again / arguments.runs:.1f} ms an item"),
        ]
        if arguments.kills:
            killed, took = with_kills(here / "runs", here / "killed", arguments.kills, statistics.median(two))
            same = digests(here / "killed") == digests(here / "one0")
            rows.append((f"batch with {killed} workers killed", f"{took:.1f} s, {'the same' if same else 'OTHER'} bytes"))
    runs, samples, repeats, kills = arguments.runs, arguments.samples, arguments.repeats, arguments.kills
    command = f"python benchmarks/fleet.py --runs {runs} --samples {samples} --repeats {repeats} --kills {kills}"
    size = f"{arguments.runs} runs of {arguments.samples} samples, {os.cpu_count()} processors, medians of {arguments.repeats}"
    show(arguments, f"# A batch of runs\n\n`{command}`: {size}.\n\n{table(['what', 'result'], rows)}", "fleet")


if __name__ == "__main__":
    main()
