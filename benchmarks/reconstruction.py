"""Reconstruction of a log, side by side with SciPy's `least_squares` per pose on the same model, on one core.

    python benchmarks/reconstruction.py [--long SAMPLES] [--write]

The comparison is what a user would write: the rig's lengths in vectorised NumPy, each pose started from the one before. Every line is
measured in this run, on the same log; ratios are against the first line. Kernels are timed by the processor time of their one thread, the
best of several, and commands by theirs, so that other work on the machine does not count; latencies by the clock. --long adds a log from
file to file: 36 million samples are ten hours at 1 kHz. --write keeps the table in results/reconstruction.md.
"""

import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from study import options, show

from lmeasure.io import files
from lmeasure.kernels import cable, lanes, lanes_redundant, least_squares as least, screw
from lmeasure.kernels.decorators import kernel
from lmeasure.recording import Counts, Run, write_run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import counts_from_poses, recorded_from_counts, span_lengths
from lmeasure.trajectory import LivePose

FloatArray = NDArray[np.float64]

NOISE_MM = 0.02
SAMPLES = 200_000
DIVIDER_BOUND = 33e6  # Newton steps per second and core, divisions alone
START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def cell() -> Rig:
    """Six drums around a cell, two cables to each corner of a triangle."""
    positions = [(-754, 293, 833), (1354, -63, 412), (402, -807, 1199), (110, -1284, -478), (537, -1183, 1360), (1312, 1347, 689)]
    tool = {"P1": (0.0, 150.0, 0.0), "P2": (-130.0, -75.0, 10.0), "P3": (130.0, -75.0, -10.0)}
    points = []
    for i, (x, y, z) in enumerate(positions):
        drum = {"counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 1.2, "tangent_length_mm": 180.0}
        points.append(
            {
                "name": f"B{i + 1}",
                "position_mm": (x, y, z),
                "guide_alpha_deg": float(np.degrees(np.arctan2(-z, np.hypot(x, y)))) + 8.0,
                "guide_beta_deg": float(np.degrees(np.arctan2(x, y))) - 5.0,
                "pulley_radius_mm": 14.0 + 2 * i,
                "drum": drum | {"axial_offset_mm": 25.0, "counter_bits": 32},
            }
        )
    cables = [{"name": f"c{i + 1}", "channel": f"ch{i + 1}", "from": f"B{i + 1}", "to": f"P{i // 2 + 1}"} for i in range(6)]
    return rig_from_dict(
        {
            "schema": "lmeasure.rig/1",
            "unstated": "exact",
            "name": "benchmark cell",
            "observation_point": points,
            "tool": tool,
            "cable": cables,
        }
    )


def with_swivels() -> Rig:
    """The same with an absolute encoder of 17 bits on each swivel pulley: twelve channels."""
    data = cell().to_dict()
    data["swivel"] = [{"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 2**17, "zero_deg": 0.0} for i in range(1, 7)]
    return rig_from_dict(data)


def motion(n: int, rate_hz: float = 1000.0) -> tuple[FloatArray, FloatArray]:
    """(times [s], (n, 7) poses) of `at`."""
    t = np.arange(n) / rate_hz
    return t, at(t)


def at(t: FloatArray) -> FloatArray:
    """(n, 7) poses: a smooth motion of +-200 mm and +-0.2 rad, up to 0.8 m/s."""
    w = 2.0 * np.pi * np.array([0.31, 0.43, 0.37])
    position = 200.0 * np.sin(np.outer(t, w)) * [1.0, -0.8, 0.6]
    rotation = Rotation.from_rotvec(0.2 * np.sin(np.outer(t, w[::-1])) * [0.9, 0.7, -1.0])
    return np.column_stack([position, rotation.as_quat()])


def noisy_changes(rig: Rig, poses: FloatArray, noise_mm: float) -> FloatArray:
    """(n, 6) changes of the free cables with Gaussian noise [mm]."""
    lengths = span_lengths(rig, poses) - span_lengths(rig, START[None])
    return lengths + np.random.default_rng(0).normal(0.0, noise_mm, lengths.shape)


def by_scipy(rows: FloatArray, changes: FloatArray) -> FloatArray:
    """(n, 6) poses (position, rotation vector) as a user would write it: NumPy over the cables, SciPy per pose."""
    B, u, R, P = rows[:, 0:3], rows[:, 3:6], rows[:, 6], rows[:, 7:10]

    def lengths(x: FloatArray) -> FloatArray:
        d = x[:3] + Rotation.from_rotvec(x[3:]).apply(P) - B
        q = np.einsum("ij,ij->i", d, u)
        p = np.linalg.norm(d - q[:, None] * u, axis=1)
        t = np.sqrt(q**2 + (p - R) ** 2 - R**2)
        phi = np.arctan2(q * R + (p - R) * t, q * t - (p - R) * R) % (2 * np.pi)
        return np.asarray(R * phi + t)

    zero = lengths(np.zeros(6))
    scale = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
    out, x = np.empty((len(changes), 6)), np.zeros(6)
    for i, change in enumerate(changes):
        x = least_squares(lambda y, c=change: lengths(y) - zero - c, x, x_scale=scale, xtol=1e-12, ftol=1e-12, gtol=1e-12).x
        out[i] = x
    return out


@kernel
def repeat_steps(tile: FloatArray, targets: FloatArray, rows: FloatArray, n: int) -> None:
    for _ in range(n):
        lanes._step(tile, targets, rows)


def best_time(work: Callable[[], object], repeats: int) -> float:
    """Shortest processor time [s] of several."""
    times = []
    for _ in range(repeats):
        t = time.process_time()
        work()
        times.append(time.process_time() - t)
    return min(times)


def command_time(arguments: list[str], environment: dict[str, str] | None = None) -> float:
    """Processor time [s] of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run(arguments, check=True, stdout=subprocess.DEVNULL, env=kept | (environment or {}))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def machine() -> str:
    """The processor's name, as the operating system states it."""
    info = Path("/proc/cpuinfo")
    names = (
        [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    )
    name = names[0] if names else platform.processor() or platform.machine()
    return f"{name}, one core of {os.cpu_count()}, Python {platform.python_version()}, NumPy {np.__version__}"


def kernels(lines: list[str]) -> None:
    """Poses per second, kernels only: lengths in, poses with status, residual and pressure angle out."""
    rig = cell()
    rows, u = rig.cable_rows(), np.full(6, NOISE_MM)
    _, poses = motion(SAMPLES)
    changes = noisy_changes(rig, poses, NOISE_MM)
    flags = np.zeros(SAMPLES, np.int64)
    few = 300
    by_hand = by_scipy(rows, changes[:few])
    scipy_rate = few / best_time(lambda: by_scipy(rows, changes[:few]), 3)

    def plain() -> FloatArray:
        return np.asarray(screw.resume_screw(rows, START, screw.new_state(START), changes, flags, u)[0])

    def in_lanes() -> FloatArray:
        return np.asarray(lanes.follow_lanes(rows, START, screw.new_state(START), changes, flags, u)[0])

    one, many = plain(), in_lanes()
    difference = np.abs(by_hand[:, :3] - one[:few, :3]).max()
    between = np.abs(one[:, :3] - many[:, :3]).max()
    plain_rate, lane_rate = SAMPLES / best_time(plain, 5), SAMPLES / best_time(in_lanes, 7)
    steps = lanes_rate()
    lines += [
        f"Log of {SAMPLES:,} samples with {NOISE_MM} mm of noise on every length ({few} of them for SciPy).",
        "",
        "| what | poses per second | against SciPy |",
        "|---|---|---|",
        f"| SciPy `least_squares` per pose, model in NumPy | {scipy_rate:,.0f} | 1 |",
        f"| screw method, sample by sample | {plain_rate:,.0f} | {plain_rate / scipy_rate:,.0f} |",
        f"| screw method, in lanes over time | {lane_rate:,.0f} | {lane_rate / scipy_rate:,.0f} |",
        "",
        f"The same poses: SciPy's differ by at most {difference:.1e} mm, the lanes' by {between:.1e} mm from those sample by sample.",
        f"The lanes make {steps / 1e6:.1f} million Newton steps per second, {steps / DIVIDER_BOUND:.2f} of the bound that the divider sets",
        f"to the straight-line form with a full elimination ({DIVIDER_BOUND / 1e6:.0f} million); a pose takes two, and a pass to judge it.",
        "",
    ]


def redundant(lines: list[str]) -> None:
    """Poses per second from twelve channels, kernels only, and one sample at a time beside six cables."""
    rig = with_swivels()
    rows, free = rig.cable_rows(rig.observed), np.arange(6)
    _, poses = motion(SAMPLES)
    absolute = np.array([rig.counter(o).codes is not None for o in rig.observed])
    unit = np.array([rig.counter(o).per_count for o in rig.observed])
    begun = cable.span_lengths(rows, START[None])[0]
    zero = np.where(absolute, 0.0, begun)
    changes = np.round((cable.span_lengths(rows, poses) - zero) / unit) * unit
    flags, u = np.zeros(SAMPLES, np.int64), unit / np.sqrt(12.0)
    state = np.concatenate([START, np.where(absolute, begun, 0.0), [0.0]])

    def by(follow: Callable[..., tuple[FloatArray, ...]]) -> FloatArray:
        return follow(rows, START, zero, state.copy(), changes, flags, u, free)[0]

    one, many = by(least.follow_least_squares), by(lanes_redundant.follow_redundant_lanes)
    between = np.abs(one[:, :3] - many[:, :3]).max()
    plain_rate, lane_rate = (
        SAMPLES / best_time(partial(by, f), n) for f, n in ((least.follow_least_squares, 3), (lanes_redundant.follow_redundant_lanes, 7))
    )
    lines += [
        f"Twelve channels, six drums and six swivel encoders of 17 bits, counts rounded, {SAMPLES:,} samples:",
        "",
        "| what | poses per second | against sample by sample |",
        "|---|---|---|",
        f"| least squares, sample by sample | {plain_rate:,.0f} | 1 |",
        f"| the same in lanes over time | {lane_rate:,.0f} | {lane_rate / plain_rate:.1f} |",
        "",
        f"The poses differ by at most {between:.1e} mm.",
        "",
    ]


def lanes_rate() -> float:
    """Newton steps per second of a tile of lanes."""
    rig = cell()
    tile = np.zeros((lanes.TILE_ROWS, lanes.WIDTH))
    tile[:7] = motion(lanes.WIDTH)[1].T
    targets = span_lengths(rig, motion(lanes.WIDTH)[1]).T.ravel()
    flat, rows = tile.ravel(), rig.cable_rows()[[0, 2, 4, 1, 3, 5]]
    targets = targets.reshape(6, -1)[[0, 2, 4, 1, 3, 5]].ravel()
    repeat_steps(flat.copy(), targets, rows, 1)
    return 20_000 * lanes.WIDTH / best_time(lambda: repeat_steps(flat.copy(), targets, rows, 20_000), 3)


def latency(lines: list[str]) -> None:
    """One sample at a time, as while recording: of six cables, and of twelve channels whose run was learned before."""
    reported = []
    for name, rig in (("six cables", cell()), ("twelve channels", with_swivels())):
        times, poses = motion(20_000)
        counts = counts_from_poses(rig, poses, START, rig.observed)
        recorded = recorded_from_counts(rig, counts, rig.observed)
        live = LivePose(rig, START)
        for i in range(2_000):
            live.update(times[i], recorded[i])
        live.learns = False  # learning goes on in a thread of its own while a run is recorded
        taken = np.empty(18_000)
        for i in range(18_000):
            t = time.perf_counter()
            live.update(times[2_000 + i], recorded[2_000 + i])
            taken[i] = time.perf_counter() - t
        reported.append(1e6 * np.percentile(taken, [50, 99, 100]))
        half, most, worst = reported[-1]
        lines.append(
            f"Live, {name}, one sample at a time: median {half:.1f} us, 99 % within {most:.1f} us, the longest of 18,000 {worst:.0f} us."
        )
    lines += [f"Twelve channels take {reported[1][0] / reported[0][0]:.1f} times as long as six cables (medians).", ""]


def long_log(lines: list[str], samples: int) -> None:
    """A long log at 1 kHz from file to file, in a process of its own: its time and its largest memory."""
    piece = min(samples, 1_000_000)
    rig = cell()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        first = Counts(np.zeros(1), tuple(c.channel for c in rig.cable), np.zeros((1, 6)))
        write_run(folder, Run(rig, START, (first,), unstated="exact"), suffix=".parquet")
        with files.table_writer(folder / "pass1.parquet") as write:
            for begin in range(0, samples, piece):
                times = np.arange(begin, begin + piece) / 1000.0
                recorded = recorded_from_counts(rig, counts_from_poses(rig, at(times), START))
                write(Counts(times, first.channels, recorded).columns())
        # not getrusage: its ru_maxrss keeps the memory of the process that started this one
        script = (
            "from lmeasure.cli.app import main\n"
            "try: main()\n"
            "except SystemExit: pass\n"
            "import pathlib, sys\n"
            "status = pathlib.Path('/proc/self/status').read_text()\n"
            "print(status.split('VmHWM:')[1].split()[0], file=sys.stderr)"
        )
        arguments = [sys.executable, "-c", script, "reconstruct", str(folder), "--out", f"{name}/out.parquet"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        done = subprocess.run(arguments, check=True, capture_output=True, text=True)
        seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        memory = int(done.stderr.split()[-1]) / 1024
        size = Path(name, "out.parquet").stat().st_size / 2**30
    lines += [
        f"{samples:,} samples from file to file with covariances: {seconds:.0f} s of the processor ({samples / seconds:,.0f} samples per",
        f"second), largest memory {memory:.0f} MB, {size:.1f} GB written.",
        "",
    ]


def commands(lines: list[str]) -> None:
    """Cold and warm starts of the command line."""
    rig = cell()
    times, poses = motion(10_000)
    recorded = recorded_from_counts(rig, counts_from_poses(rig, poses, START))
    run = Run(rig, START, (Counts(times, tuple(c.channel for c in rig.cable), recorded),), unstated="exact")
    with tempfile.TemporaryDirectory() as folder:
        write_run(Path(folder) / "run", run)
        lmeasure = [sys.executable, "-m", "lmeasure"]
        reconstruct = [*lmeasure, "reconstruct", f"{folder}/run", "--out", f"{folder}/out.parquet"]
        cache = {"NUMBA_CACHE_DIR": f"{folder}/cache", "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        cold = command_time(reconstruct, cache)
        warm = min(command_time(reconstruct, cache) for _ in range(3))
        shown = min(command_time([*lmeasure, "--help"], cache) for _ in range(3))
    lines += [
        "| command | processor seconds |",
        "|---|---|",
        f"| `lmeasure --help` | {shown:.2f} |",
        f"| `lmeasure reconstruct`, 10,000 samples, nothing compiled before | {cold:.2f} |",
        f"| the same again | {warm:.2f} |",
        "",
    ]


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--long", type=int, metavar="SAMPLES", help="also a log of as many samples, such as 36000000")
    parser.add_argument("--only", choices=("redundant", "latency"), nargs="*", help="these parts alone")
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    lines = ["# Reconstruction", "", f"Machine: {machine()}.", ""]
    parts = {"kernels": kernels, "redundant": redundant, "latency": latency, "commands": commands}
    for name in arguments.only or parts:
        parts[name](lines)
    if arguments.long:
        long_log(lines, arguments.long)
    show(arguments, "\n".join(lines), "reconstruction")


if __name__ == "__main__":
    main()
