"""How long a certificate takes: an hour at 1 kHz, from files to a sealed folder.

    python benchmarks/certify.py [--write] [--minutes M] [--profile]

A simulated robot runs five poses and a line over and over; the run is written as CSV, reconstructed to Parquet, and certified by the
command
in a process of its own, counts, trajectory, PDF, page, copies and digests included. The kernels are compiled before (a first
certificate of a minute). Beside it: what copying and hashing the same files takes alone, since no certificate can be faster.
--profile prints where the time goes.
"""

import cProfile
import hashlib
import os
import platform
import pstats
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tomli_w
from study import options, show, table

from lmeasure.certificate import Inputs
from lmeasure.iso9283 import CertificationSettings
from lmeasure.recording import Run, read_run_head, write_run
from lmeasure.report import Choices, write_certificate
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import reconstruct_stream

RATE_HZ, DWELL_S, SPEED_MM_S = 1000.0, 1.0, 300.0
PLACES = {"P1": (0.0, 0.0, 0.0), "P2": (150.0, 150.0, -150.0), "P3": (150.0, -150.0, -150.0), "P4": (-150.0, -150.0, 150.0),
          "P5": (-150.0, 150.0, 150.0)}  # fmt: skip
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def write_measurement(folder: Path, minutes: float) -> int:
    """run/, trajectory.parquet and program.toml of so many minutes; the number of samples."""
    rng = np.random.default_rng(0)
    samples = round(minutes * 60 * RATE_HZ)
    legs, names = [], []
    time_s, poses = np.zeros(0), np.zeros((0, 7))
    while len(time_s) < samples:
        for _ in range(max(1, round(minutes))):
            for name, place in PLACES.items():
                quaternion = np.array([*rng.normal(0.0, 1e-4, 3), 1.0])
                pose = np.concatenate([np.array(place) + rng.normal(0.0, 0.05, 3), quaternion / np.linalg.norm(quaternion)])
                legs.append(Leg(pose, SPEED_MM_S, 1.0, DWELL_S))
                names.append(name)
        time_s, poses = smooth_path(HOME, legs, RATE_HZ)
    time_s, poses = time_s[:samples], poses[:samples]
    still = np.concatenate([[False], np.abs(np.diff(poses, axis=0)).max(axis=1) < 1e-12, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    rests = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=False) if b - a > 0.8 * DWELL_S * RATE_HZ]
    windows: dict[str, list[list[float]]] = {name: [] for name in PLACES}
    lines = []
    for k, (name, (a, b)) in enumerate(zip(names, rests, strict=False)):
        windows[name].append([float(time_s[a]) + 0.1, float(time_s[b - 1]) - 0.1])
        if name == "P2" and k + 1 < len(rests):
            lines.append([float(time_s[b - 1]), float(time_s[rests[k + 1][0]])])
    path = {"name": "line", "kind": "linear", "start_mm": list(PLACES["P2"]), "end_mm": list(PLACES["P3"]), "speed_mm_s": SPEED_MM_S}
    program = {
        "schema": "lmeasure.program/1",
        "pose": [
            {"name": name, "position_mm": list(place), "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "windows_s": windows[name][:30]}
            for name, place in PLACES.items()
        ],
        "path": [path | {"windows_s": lines[:10]}],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "program.toml").write_text(tomli_w.dumps(program), encoding="utf-8")
    run: Run = simulate_run(cell_rig(0), time_s, poses, noise_mm=0.0, rng=rng).run
    write_run(folder / "run", run)
    reconstruct_stream(read_run_head(folder / "run"), folder / "trajectory.parquet")
    return samples


def certify(folder: Path) -> float:
    """Wall seconds of the command."""
    command = [sys.executable, "-m", "lmeasure", "certify", "trajectory.parquet", "--run", "run", "--program", "program.toml"]
    begin = time.perf_counter()
    subprocess.run([*command, "--out", "certificate"], check=True, capture_output=True, cwd=folder)
    return time.perf_counter() - begin


def copy_and_hash(folder: Path) -> tuple[float, int]:
    """Wall seconds to copy and hash the inputs once, and their bytes."""
    begin, total = time.perf_counter(), 0
    for name in ("run/pass1.csv", "trajectory.parquet"):
        shutil.copyfile(folder / name, folder / "copy")
        with (folder / "copy").open("rb") as file:
            hashlib.file_digest(file, "sha256")
        total += (folder / "copy").stat().st_size
    (folder / "copy").unlink()
    return time.perf_counter() - begin, total


def main() -> None:
    """Measure, print, and keep the table when asked."""
    parser = options(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--profile", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        small, large = Path(scratch) / "small", Path(scratch) / "large"
        write_measurement(small, 1.0)
        first = certify(small)
        samples = write_measurement(large, given.minutes)
        if given.profile:
            inputs = Inputs(large / "trajectory.parquet", large / "program.toml", large / "run")
            with cProfile.Profile() as profile:
                write_certificate(large / "profiled", inputs, CertificationSettings(), Choices())
            pstats.Stats(profile).sort_stats("cumulative").print_stats(45)
        bare, total = copy_and_hash(large)
        wall = certify(large)
        verify = time.perf_counter()
        subprocess.run([sys.executable, "-m", "lmeasure", "verify", "certificate"], check=True, capture_output=True, cwd=large)
        verify = time.perf_counter() - verify
    rows = [
        ("samples", f"{samples}"),
        ("bytes of counts and trajectory", f"{total / 1e6:.0f} MB"),
        ("`lmeasure certify`, wall", f"{wall:.1f} s"),
        ("of it: as much as copying and hashing the files alone", f"{bare:.1f} s"),
        ("certify per copying and hashing", f"{wall / bare:.1f} times"),
        ("`lmeasure verify` of the folder, wall", f"{verify:.1f} s"),
        ("certify of one minute before, kernels perhaps not compiled", f"{first:.1f} s"),
    ]
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    head = f"# Speed of a certificate\n\n`python benchmarks/certify.py --minutes {given.minutes:g} --write`. Machine: {machine}."
    show(given, f"{head}\n\n{table(['', ''], rows)}", "certify")


if __name__ == "__main__":
    main()
