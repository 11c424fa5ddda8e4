"""Scan of an accuracy zone, side by side with batched NumPy on the same rig, poses and figures.

    python benchmarks/zone.py [--write]

The comparison is what a user would write: the rows of all poses of a batch by vectorised NumPy, inverted by `numpy.linalg.inv`, of more
than six cables by their normal equations, the worst pressure angle, the 95 % radius, with a calibration its part by the columns of its
covariance's factor, lengths, wraps, determinant and norm of the inverse from them. Every line is measured in this run; ratios are against
NumPy at the same task. --write keeps the table in results/zone.md.
"""

import os
import platform
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from study import options, show

from lmeasure.accuracy import axis, scan_zone, tilts
from lmeasure.accuracy.scan import Plan, run
from lmeasure.accuracy.zone import make_plan
from lmeasure.kernels import RADIUS_95, zone as kernels
from lmeasure.rig import Rig, rig_from_dict

FloatArray = NDArray[np.float64]

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def cell(cables: int = 6) -> Rig:
    """Six drums around a cell, two cables to each corner of a triangle; or eight."""
    positions = [(-754, 293, 833), (1354, -63, 412), (402, -807, 1199), (110, -1284, -478), (537, -1183, 1360), (1312, 1347, 689)]
    positions += [(-1200, -900, 500), (-500, 1400, -300)][: cables - 6]
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
    leads = [{"name": f"c{i + 1}", "channel": f"ch{i + 1}", "from": f"B{i + 1}", "to": f"P{i // 2 % 3 + 1}"} for i in range(cables)]
    return rig_from_dict(
        {
            "schema": "lmeasure.rig/1",
            "unstated": "exact",
            "name": "benchmark cell",
            "observation_point": points,
            "tool": tool,
            "cable": leads,
        }
    )


def by_numpy(plan: Plan, count: int) -> FloatArray:
    """(8, count) figures of the first nodes, a batch of nodes per orientation: worst pressure angle [rad], 95 % radius, shortest and
    longest cable [mm], wrap [rad], norm of the inverse, extremes of six cables' determinant."""
    B, u, R = plan.cables[:, 0:3], plan.cables[:, 3:6], plan.cables[:, 6]
    size = np.linalg.norm(plan.cables[:, 7:10], axis=1).max()
    coefficients = np.zeros((6, 6))
    for i, row in enumerate(RADIUS_95):
        coefficients[i, : len(row)] = row
    matrices = np.array([_matrix(q) for q in plan.quaternions])
    out = np.zeros((8, count))
    out[2], out[6], out[7] = np.inf, np.inf, -np.inf
    sigma, q2, six = np.sqrt(plan.variance), plan.weights**2, len(plan.cables) == 6
    factor = plan.factor.reshape(len(plan.cables), 13, -1)[:, :5]
    begun = _gradients(plan, plan.start[None, :3], _matrix(plan.start[3:]))
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
            weighted = np.swapaxes(rows * q2[:, None], 1, 2)
            twists = np.linalg.inv(rows) if six else np.linalg.solve(weighted @ rows, weighted)
            v = np.swapaxes(twists[:, 3:], 1, 2) + np.cross(np.swapaxes(twists[:, :3], 1, 2), arm)
            c = twists[:, 3:] * sigma
            if factor.size:
                moved = twists[:, 3:] @ np.einsum("njk,jkr->njr", _gradients(plan, x, m) - begun, factor)
                c = np.concatenate([c, moved], axis=2)
            covariance = c @ np.swapaxes(c, 1, 2)
            e1, e3 = np.trace(covariance, axis1=1, axis2=2), np.linalg.det(covariance)
            e2 = 0.5 * (e1**2 - np.einsum("ijk,ikj->i", covariance, covariance))
            radius = np.sqrt(e1) * np.polynomial.polynomial.polyval2d(3 * e2 / e1**2, 27 * e3 / e1**3, coefficients)
            wrapped = phi % (2 * np.pi)
            lengths = R * wrapped + t
            part = out[:, first : first + len(x)]
            part[0] = np.maximum(part[0], np.arccos(1 / np.maximum(1.0, np.linalg.norm(v, axis=-1))).max(axis=1))
            part[1] = np.maximum(part[1], radius)
            part[2], part[3] = np.minimum(part[2], lengths.min(axis=1)), np.maximum(part[3], lengths.max(axis=1))
            part[4] = np.maximum(part[4], wrapped.max(axis=1))
            part[5] = np.maximum(part[5], (twists[:, 3:] ** 2).sum(axis=(1, 2)) + size**2 * (twists[:, :3] ** 2).sum(axis=(1, 2)))
            if six:
                det = np.linalg.det(rows) / size**3
                part[6], part[7] = np.minimum(part[6], det), np.maximum(part[7], det)
    return out


def _gradients(plan: Plan, x: FloatArray, m: FloatArray) -> FloatArray:
    """(n, cables, 5) derivatives of the lengths by place and guide of their observation points."""
    u, R, alpha, beta = plan.cables[:, 3:6], plan.cables[:, 6], plan.cables[:, 14], plan.cables[:, 15]
    d = x[:, None, :] + plan.cables[:, 7:10] @ m.T - plan.cables[:, 0:3]
    q = np.einsum("ijk,jk->ij", d, u)
    n = d - q[..., None] * u
    p = np.linalg.norm(n, axis=-1)
    t = np.sqrt(q**2 + (p - R) ** 2 - R**2)
    phi = np.arctan2(q * R + (p - R) * t, q * t - (p - R) * R)
    by_u = np.cos(phi) - np.sin(phi) * q / p
    e = np.cos(phi)[..., None] * u + np.sin(phi)[..., None] * n / p[..., None]
    by_alpha = np.stack([np.sin(alpha) * np.sin(beta), np.sin(alpha) * np.cos(beta), np.cos(alpha)], axis=-1)
    by_beta = np.stack([-np.cos(alpha) * np.cos(beta), np.cos(alpha) * np.sin(beta), np.zeros(len(R))], axis=-1)
    guides = [by_u * np.einsum("ijk,jk->ij", d, by) for by in (by_alpha, by_beta)]
    return np.concatenate([-e, np.stack(guides, axis=-1)], axis=-1)


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
    return make_plan(rig, None, positions, tilts(0.3, steps), start=START, full=full, near=near)


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


def linked_to(plan: Plan) -> Plan:
    """The plan with a calibration of five unknowns a cable."""
    m = len(plan.cables)
    factor = np.zeros((m, 13, 5 * m))
    factor[:, :5] = 0.02 * np.random.default_rng(0).standard_normal((m, 5, 5 * m))
    return replace(plan, factor=factor.reshape(13 * m, 5 * m))


def by_scalar(plan: Plan, count: int) -> FloatArray:
    """(F, count) figures of the first nodes by the pivoted scalar kernel."""
    found = kernels.scan(
        plan.cables, plan.positions[:count], plan.quaternions, plan.variance, plan.weights, plan.scales, plan.factor, START, plan.points,
        plan.pairs, plan.bodies,
    )  # fmt: skip
    return np.asarray(found[0])


def differences(plan: Plan, count: int) -> tuple[float, float]:
    """Largest difference of the lanes' figures of some nodes from NumPy's: of the pressure angle [rad], and of the others, relative."""
    fast, plain = run(replace(plan, positions=plan.positions[:count]), workers=1)[0], by_numpy(plan, count)
    others = [kernels.U95_POSITION, kernels.SHORTEST, kernels.LONGEST, kernels.WRAP, kernels.NORM2]
    if len(plan.cables) == 6:
        others += [kernels.DET_LOW, kernels.DET_HIGH]
    angle = np.abs(np.arccos(1 / np.sqrt(fast[kernels.SPEED2])) - plain[0]).max()
    return float(angle), float(np.abs(fast[others] / plain[1 : 1 + len(others)] - 1.0).max())


def table() -> str:
    """The measured table as Markdown."""
    six, eight, few = plan_of(cell(), 10.0, 3), plan_of(cell(8), 10.0, 3), 4096
    tasks = {
        "six cables": six,
        "six, a calibration of 30 unknowns": linked_to(six),
        "eight cables": eight,
        "eight, a calibration of 40 unknowns": linked_to(eight),
    }
    poses, some = len(six.positions) * len(six.quaternions), few * len(six.quaternions)
    lines = ["| million poses/s, one core | batched NumPy | scalar kernel | lanes | lanes to NumPy |", "|---|---|---|---|---|"]
    largest = []
    for name, plan in tasks.items():
        by_scalar(plan, 1)
        largest.append(differences(plan, few))
        numpy_rate = some / best_time(partial(by_numpy, plan, few)) / 1e6
        scalar_rate = some / best_time(partial(by_scalar, plan, few)) / 1e6
        rate = poses / best_time(partial(run, plan, workers=1)) / 1e6
        lines.append(f"| {name} | {numpy_rate:.3g} | {scalar_rate:.3g} | {rate:.3g} | {rate / numpy_rate:.3g} |")
    full, near = plan_of(cell(), 10.0, 3, full=True), plan_of(cell(), 10.0, 3, full=True, near=True)
    more = {
        "six cables, lanes, all cores (wall time)": poses / best_time(lambda: run(six), clock=time.perf_counter),
        "with orientation and attachment points, one core": poses / best_time(lambda: run(full, workers=1)),
        "the same with distances between cables, one core": poses / best_time(lambda: run(near, workers=1)),
        "orientation and attachment points with a calibration, one core": poses / best_time(lambda: run(linked_to(full), workers=1)),
    }
    lines += ["", "| six cables | million poses/s |", "|---|---|", *(f"| {name} | {rate / 1e6:.3g} |" for name, rate in more.items())]
    with get_context("spawn").Pool(1) as alone:
        large, seconds, peak = alone.apply(large_scan)
    angle, relative = np.max(largest, axis=0)
    lines += [
        "",
        f"Largest difference of the worst pressure angle from NumPy's: {angle:.1e} rad; of the others, relative: {relative:.1e}.",
        f"`scan_zone` of {large / 1e6:.1f} million poses on all cores, in a process of its own: {seconds:.1f} s, {peak:.0f} MB.",
    ]
    return "\n".join(lines)


def large_scan() -> tuple[int, float, float]:
    """Poses, wall time [s] and the process's peak memory [MB] of 131^3 nodes in 27 orientations."""
    nodes = axis(-650, 650, 10.0)
    t = time.perf_counter()
    scan_zone(cell(), None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.3, 3))
    seconds = time.perf_counter() - t
    return len(nodes) ** 3 * 27, seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Measure and print; keep the table when asked."""
    parser = options(__doc__)
    arguments = parser.parse_args()
    text = f"# Zone scan\n\n{machine()}. `python benchmarks/zone.py --write`\n\n{table()}\n"
    show(arguments, text, "zone")


if __name__ == "__main__":
    main()
