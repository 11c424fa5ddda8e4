"""Scan of an accuracy zone, side by side with batched NumPy on the same rig, poses and figures.

    python benchmarks/zone.py [--write]

The comparison is what a user would write: the rows of all poses of a batch by vectorised NumPy, inverted by `numpy.linalg.inv`, the
worst pressure angle, the 95 % radius, lengths, wraps, determinant and norm of the inverse from them. Every line is measured in this run;
ratios are against the first. --write keeps the table in results/zone.md.
"""

import argparse
import os
import platform
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from lmeasure.accuracy.scan import Plan, run
from lmeasure.accuracy.zone import axis, make_plan, scan_zone, tilts
from lmeasure.kernels import zone as kernels
from lmeasure.kernels.gaussian import RADIUS_95
from lmeasure.rig import Rig, rig_from_dict

FloatArray = NDArray[np.float64]

RESULTS = Path(__file__).parent / "results" / "zone.md"
START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def cell() -> Rig:
    """Six drums around a cell, two cables to each corner of a triangle."""
    positions = [(-754, 293, 833), (1354, -63, 412), (402, -807, 1199), (110, -1284, -478), (537, -1183, 1360), (1312, 1347, 689)]
    tool = {"P1": (0.0, 150.0, 0.0), "P2": (-130.0, -75.0, 10.0), "P3": (130.0, -75.0, -10.0)}
    drum = {"counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 1.2, "tangent_length_mm": 180.0}
    points = [
        {
            "name": f"B{i + 1}",
            "position_mm": (x, y, z),
            "guide_alpha_deg": float(np.degrees(np.arctan2(-z, np.hypot(x, y)))) + 8.0,
            "guide_beta_deg": float(np.degrees(np.arctan2(x, y))) - 5.0,
            "pulley_radius_mm": 14.0 + 2 * i,
            "drum": drum | {"axial_offset_mm": 25.0},
        }
        for i, (x, y, z) in enumerate(positions)
    ]
    cables = [{"name": f"c{i + 1}", "channel": f"ch{i + 1}", "from": f"B{i + 1}", "to": f"P{i // 2 + 1}"} for i in range(6)]
    return rig_from_dict({"schema": "lmeasure.rig/1", "name": "benchmark cell", "observation_point": points, "tool": tool, "cable": cables})


def by_numpy(plan: Plan, count: int) -> FloatArray:
    """(8, count) figures of the first nodes, a batch of nodes per orientation: worst pressure angle [rad], 95 % radius, shortest and
    longest cable [mm], wrap [rad], extremes of the determinant, norm of the inverse."""
    B, u, R = plan.cables[:, 0:3], plan.cables[:, 3:6], plan.cables[:, 6]
    size = np.linalg.norm(plan.cables[:, 7:10], axis=1).max()
    coefficients = np.zeros((6, 6))
    for i, row in enumerate(RADIUS_95):
        coefficients[i, : len(row)] = row
    matrices = np.array([_matrix(q) for q in plan.quaternions])
    out = np.zeros((8, count))
    out[2], out[5], out[6] = np.inf, np.inf, -np.inf
    sigma = np.sqrt(plan.variance)
    for m in matrices:
        arm = plan.cables[:, 7:10] @ m.T
        for first in range(0, count, 4096):
            x = plan.positions[first : min(first + 4096, count)]
            d = x[:, None, :] + arm - B
            q = np.einsum("ijk,jk->ij", d, u)
            n = d - q[..., None] * u
            p = np.linalg.norm(n, axis=-1)
            t = np.sqrt(q**2 + (p - R) ** 2 - R**2)
            phi = np.arctan2(q * R + (p - R) * t, q * t - (p - R) * R)
            e = np.cos(phi)[..., None] * u + np.sin(phi)[..., None] * n / p[..., None]
            rows = np.concatenate([np.cross(np.broadcast_to(arm, e.shape), e), e], axis=-1)
            twists = np.linalg.inv(rows)
            v = np.swapaxes(twists[:, 3:], 1, 2) + np.cross(np.swapaxes(twists[:, :3], 1, 2), arm)
            c = twists[:, 3:] * sigma
            covariance = c @ np.swapaxes(c, 1, 2)
            e1, e3 = np.trace(covariance, axis1=1, axis2=2), np.linalg.det(covariance)
            e2 = 0.5 * (e1**2 - np.einsum("ijk,ikj->i", covariance, covariance))
            radius = np.sqrt(e1) * np.polynomial.polynomial.polyval2d(3 * e2 / e1**2, 27 * e3 / e1**3, coefficients)
            wrapped = phi % (2 * np.pi)
            lengths = R * wrapped + t
            det = np.linalg.det(rows) / size**3
            part = out[:, first : first + len(x)]
            part[0] = np.maximum(part[0], np.arccos(1 / np.linalg.norm(v, axis=-1)).max(axis=1))
            part[1] = np.maximum(part[1], radius)
            part[2], part[3] = np.minimum(part[2], lengths.min(axis=1)), np.maximum(part[3], lengths.max(axis=1))
            part[4] = np.maximum(part[4], wrapped.max(axis=1))
            part[5], part[6] = np.minimum(part[5], det), np.maximum(part[6], det)
            part[7] = np.maximum(part[7], (twists[:, 3:] ** 2).sum(axis=(1, 2)) + size**2 * (twists[:, :3] ** 2).sum(axis=(1, 2)))
    return out


def _matrix(q: FloatArray) -> FloatArray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def plan_of(rig: Rig, step: float, steps: int, full: bool = False, near: bool = False) -> Plan:
    """The scan of a cube of 600 mm."""
    nodes = axis(-300, 300, step)
    positions = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    return make_plan(rig, None, positions, tilts(0.3, steps), START, full=full, near=near)


def best_time(work: Callable[[], object], repeats: int = 5, clock: Callable[[], float] = time.process_time) -> float:
    """Shortest time [s] of several; processor time unless said otherwise, which others on the machine disturb less."""
    times = []
    for _ in range(repeats):
        t = clock()
        work()
        times.append(clock() - t)
    return min(times)


def machine() -> str:
    """The processor's name, as the operating system states it."""
    info = Path("/proc/cpuinfo")
    names = (
        [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    )
    name = names[0] if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def table() -> str:
    """The measured table as Markdown."""
    rig = cell()
    plan, full, near = plan_of(rig, 10.0, 3), plan_of(rig, 10.0, 3, full=True), plan_of(rig, 10.0, 3, full=True, near=True)
    few = 4096
    poses = len(plan.positions) * len(plan.quaternions)
    for each in (plan, full, near):
        run(each, workers=1)
    sample = plan.positions[:few]
    fast, numpy_result = run(plan, workers=1)[0][:, :few], by_numpy(plan, few)
    difference = np.abs(np.arccos(1 / np.sqrt(fast[kernels.SPEED2])) - numpy_result[0]).max()
    others = [kernels.U95_POSITION, kernels.SHORTEST, kernels.LONGEST, kernels.WRAP, kernels.DET_LOW, kernels.DET_HIGH, kernels.NORM2]
    relative = np.abs(fast[others] / numpy_result[1:] - 1.0).max()

    def scalar_of(plan: Plan) -> None:
        kernels.scan(
            plan.cables, sample, plan.quaternions, plan.variance, plan.scales, plan.factor, START, plan.points, plan.pairs, plan.bodies
        )  # fmt: skip

    def scalar() -> None:
        scalar_of(plan)

    scalar()
    factor = np.zeros((6, 13, 30))
    factor[:, :5] = 0.02 * np.random.default_rng(0).standard_normal((6, 5, 30))
    linked = replace(plan_of(rig, 20.0, 3), factor=factor.reshape(78, 30))
    run(linked, workers=1)
    some = few * len(plan.quaternions)
    rates = {
        "batched NumPy": some / best_time(lambda: by_numpy(plan, few)),
        "pivoted scalar kernel, one core": some / best_time(scalar),
        "lanes, one core": poses / best_time(lambda: run(plan, workers=1)),
        "lanes, all cores (wall time)": poses / best_time(lambda: run(plan), clock=time.perf_counter),
        "lanes with orientation and attachment points, one core": poses / best_time(lambda: run(full, workers=1)),
        "the same with distances between cables, one core": poses / best_time(lambda: run(near, workers=1)),
        "lanes with a calibration of 30 unknowns, one core": len(linked.positions) * 27 / best_time(lambda: run(linked, workers=1)),
        "scalar kernel with it, one core": some / best_time(lambda: scalar_of(linked)),
    }
    first = next(iter(rates.values()))
    lines = ["| way | million poses/s | ratio |", "|---|---|---|"]
    lines += [f"| {name} | {rate / 1e6:.3g} | {rate / first:.3g} |" for name, rate in rates.items()]
    with get_context("spawn").Pool(1) as alone:
        large, seconds, peak = alone.apply(large_scan)
    lines += [
        "",
        f"Largest difference of the worst pressure angle from NumPy's: {difference:.1e} rad; of the others, relative: {relative:.1e}.",
        f"`scan_zone` of {large / 1e6:.1f} million poses on all cores, in a process of its own: {seconds:.1f} s, {peak:.0f} MB.",
    ]
    return "\n".join(lines)


def large_scan() -> tuple[int, float, float]:
    """Poses, wall time [s] and the process's peak memory [MB] of 131^3 nodes in 27 orientations."""
    nodes = axis(-650, 650, 10.0)
    t = time.perf_counter()
    scan_zone(cell(), None, nodes, nodes, nodes, tilts(0.3, 3))
    seconds = time.perf_counter() - t
    return len(nodes) ** 3 * 27, seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Measure and print; keep the table when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"keep the table in {RESULTS.relative_to(Path(__file__).parent)}")
    arguments = parser.parse_args()
    text = f"# Zone scan\n\n{machine()}. `python benchmarks/zone.py --write`\n\n{table()}\n"
    sys.stdout.write(text)
    if arguments.write:
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
