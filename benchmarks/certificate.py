"""How long the evaluation of an hour at 1 kHz takes.

    python benchmarks/certificate.py [--minutes 60]

A robot runs five poses of the cube and a line again and again; trajectory and run are in memory, as `lmeasure certify` has them after
reading. Printed: seconds of processor and of the clock for each stage, and samples per second.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from lmeasure.certification import evaluate
from lmeasure.program import Program
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import reconstruct

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
CUBE = {"P1": (0, 0, 0), "P2": (150, 150, 150), "P3": (-150, 150, 150), "P4": (-150, -150, -150), "P5": (150, -150, -150)}
RATE_HZ, DWELL_S, CYCLES = 1000.0, 2.0, 30


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--minutes", type=float, default=60.0)
    minutes = parser.parse_args().minutes
    legs = []
    for place in CUBE.values():
        pose = START.copy()
        pose[:3] = np.array(place) + 0.2
        legs.append(Leg(pose, 400.0, 1.0, DWELL_S))
    time_s, one = smooth_path(START, legs + [Leg(START, 400.0, 1.0, DWELL_S)], RATE_HZ)
    cycles = max(1, int(minutes * 60.0 * RATE_HZ / len(one)))
    poses = np.tile(one, (cycles, 1))
    poses[:, :3] += (
        0.02 * np.random.default_rng(1).normal(size=(cycles, 3)).repeat(len(one), axis=0) * (np.arange(len(poses)) > len(one))[:, None]
    )
    times = np.arange(len(poses)) / RATE_HZ
    rests = {n: time_s[np.flatnonzero((np.abs(one - leg.pose) < 1e-9).all(axis=1))] for n, leg in zip(CUBE, legs, strict=True)}
    length = len(one) / RATE_HZ
    chosen = np.arange(0, cycles, max(1, cycles // CYCLES))
    windows = {n: [(float(r[100] + j * length), float(r[-10] + j * length)) for j in chosen] for n, r in rests.items()}
    ways = [(float(rests["P2"][-20] + j * length), float(rests["P3"][50] + j * length)) for j in chosen[:10]]
    program = Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": [{"name": n, "position_mm": p, "quaternion_xyzw": (0, 0, 0, 1), "windows_s": windows[n]} for n, p in CUBE.items()],
            "path": [
                {"name": "line", "kind": "linear", "start_mm": CUBE["P2"], "end_mm": CUBE["P3"], "speed_mm_s": 250.0, "windows_s": ways}
            ],
        }
    )
    run = simulate_run(cell_rig(1), times, poses, 0.0, np.random.default_rng(1)).run
    stages = {"reconstruct": lambda: reconstruct(run)}
    kept = {}
    for name, stage in stages.items():
        kept[name] = measured(name, stage, len(times))
    trajectory = replace(kept["reconstruct"])
    evaluate(trajectory, program, run=run)  # compile
    measured("evaluate with the run", lambda: evaluate(trajectory, program, run=run), len(times))
    measured("evaluate the trajectory alone", lambda: evaluate(trajectory, program), len(times))


def measured(name: str, stage, samples: int):  # type: ignore[no-untyped-def]
    """The stage's result, with a line on what it took."""
    clock, processor = time.perf_counter(), time.process_time()
    out = stage()
    clock, processor = time.perf_counter() - clock, time.process_time() - processor
    print(f"{name}: {clock:.2f} s, {processor:.2f} s of processor, {samples / clock / 1e6:.2f} million samples/s")
    return out


if __name__ == "__main__":
    main()
