"""Robots identified from a trajectory's file whose systematic errors are not as even over the places as `identify` takes them for.

    python benchmarks/uneven_fields.py [--robots 100] [--out benchmarks/results/uneven_fields.md]

A six-axis arm with normal errors of 0.3 mm and 0.5 mrad in every parameter of its links, 60 poses in the cable cell of tests/authorities,
stated of each: 0.01 mm and 0.03 mrad by itself, and systematic ones. What the latter really are is drawn for each robot: a constant with
slopes along the axes; normal fields in each coordinate whose correlation falls with the distance d as exp(-d^2 / 2 L^2), L in parts of the
places' rms distance from their middle; and what a cable cell's zeroings and points do that are off by 0.02 mm each, as after a
calibration. At each place their standard uncertainties are those stated. The probabilities are two-sided, of one parameter and one
prediction of each robot.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import scipy.stats
from identified_through_cables import RIG, Cell, joints_of, true_robot
from numpy.typing import NDArray

from lmeasure.core import se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, span_lengths
from lmeasure.rig import read_rig
from lmeasure.robots import Settings, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined
from lmeasure.robots.identification.trajectory_rests import fields_over, independent

FloatArray = NDArray[np.float64]
SEED, POSES, LATER, POINT_MM = 17, 60, 20, 0.02
OWN, STATED = np.repeat([3e-5, 0.01], 3), np.repeat([1e-4, 0.03], 3)
Field = Callable[[FloatArray, np.random.Generator], tuple[FloatArray, FloatArray]]
"""Of poses (n, 7): errors (n, 6) and their covariances (n, 6, 6)."""


def even(poses: FloatArray) -> FloatArray:
    """(n, 4) a constant and a slope along each axis, of the same variance at the typical place."""
    off = (poses[:, :3] - poses[:, :3].mean(axis=0)) / spread(poses) * np.sqrt(3.0)
    basis = np.column_stack([np.ones(len(off)), off])
    return np.asarray(basis / np.linalg.norm(basis, axis=1)[:, None])


def even_field(poses: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """A constant and slopes."""
    basis = even(poses)
    return basis @ rng.normal(size=(basis.shape[1], 6)) * STATED, np.tile(np.diag(STATED**2), (len(poses), 1, 1))


def falling(part: float) -> Field:
    def field(poses: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        off = poses[:, None, :3] - poses[None, :, :3]
        values, vectors = np.linalg.eigh(np.exp(-0.5 * (off**2).sum(axis=2) / (part * spread(poses)) ** 2))
        drawn = vectors * np.sqrt(np.maximum(values, 0.0)) @ rng.normal(size=(len(poses), 6))
        return drawn * STATED, np.tile(np.diag(STATED**2), (len(poses), 1, 1))

    return field


def spread(poses: FloatArray) -> float:
    return float(np.sqrt(((poses[:, :3] - poses[:, :3].mean(axis=0)) ** 2).sum(axis=1).mean()))


def of_a_calibration(poses: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    cell = Cell()
    G, rows = cell.twists(poses), read_rig(RIG).cable_rows()
    by = [np.broadcast_to(np.eye(6)[None], (len(poses), 6, 6))]
    for columns in (BASE_XYZ, ATTACHMENT_XYZ):
        for axis in range(3):
            moved = rows.copy()
            moved[:, np.arange(moved.shape[1])[columns][axis]] += 0.1
            change = (span_lengths(moved, np.ascontiguousarray(poses)) - span_lengths(rows, np.ascontiguousarray(poses))) / 0.1
            by.append(change[:, :, None] * np.eye(6))
    factors = POINT_MM * G @ np.concatenate(by, axis=2)
    return factors @ rng.normal(size=factors.shape[2]), factors @ np.swapaxes(factors, 1, 2)


FIELDS: dict[str, Field] = {
    "even": even_field,
    **{f"L = {part:g}": falling(part) for part in (3.0, 1.0, 0.5, 0.25, 0.1)},
    "a cable cell's calibration": of_a_calibration,
}


def row(name: str, field: Field, robots: int) -> str:
    inside, one, within, single, sizes = [], [], [], [], []
    for k in range(robots):
        rng = np.random.default_rng([SEED, k])
        nominal, true = true_robot("generic6", rng)
        joints, stand = joints_of(nominal, POSES + LATER, rng)
        there = se3.compose(np.tile(stand, (len(joints), 1)), true.forward(joints))
        errors, covariance = field(there, rng)
        seen = se3.displaced(there, errors + OWN * rng.normal(size=errors.shape))
        rows = measured(joints, seen[:, :3], seen[:, 3:], u_position_mm=1.0, u_rotation_rad=1.0)
        roots = np.linalg.cholesky(covariance[:POSES])
        basis = fields_over(seen[:POSES])
        factors = independent(np.einsum("nij,nb->nijb", roots, basis).reshape(POSES, 6, -1))
        used = replace(rows.of(np.arange(POSES)), covariance=np.tile(np.diag(OWN**2), (POSES, 1, 1)), systematic=factors)
        found = identify(nominal, used, Settings(outliers=False))
        value = {p.name: p.value for p in true.parameters}
        told, u, unknowns = determined(found.fit), np.sqrt(np.diag(found.fit.covariance)), found.fit.problem.unknowns
        values = zip(unknowns.names, unknowns.values(found.fit.x), u, told, strict=True)
        own = [(abs(v - value[n]) / s) for n, v, s, t in values if t and n in value]
        sizes += own
        inside += [off <= 1.96 for off in own]
        one.append(bool(own[int(rng.integers(len(own)))] <= 1.96))
        predicted = predict(found, joints[POSES:])
        good = np.linalg.norm(predicted.pose[:, :3] - seen[POSES:, :3], axis=1) <= predicted.u95_mm
        within.append(good.mean())
        single.append(bool(good[0]))
    p = [scipy.stats.binomtest(sum(v), len(v), 0.95).pvalue for v in (one, single)]
    return (
        f"| {name} | {robots} | {100 * np.mean(inside):.1f} | {np.sqrt(np.mean(np.square(sizes))):.2f} | {100 * np.mean(one):.1f} "
        f"| {p[0]:.2g} | {100 * np.mean(within):.1f} | {100 * np.mean(single):.1f} | {p[1]:.2g} |"
    )


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--fields", default=",".join(FIELDS))
    parser.add_argument("--out", type=Path, help="page to write")
    asked = parser.parse_args()
    lines = ["# Systematic errors of a trajectory's file that are not even", "", f"`python benchmarks/uneven_fields.py`, seed {SEED}.", ""]
    lines += [
        "| field | robots | parameters within 95 %, % | rms of error / u | one of each robot: % | two-sided p "
        "| predictions within u95, % | one of each robot: % | two-sided p |",
        "|---" * 9 + "|",
    ]
    for name in asked.fields.split(","):
        lines.append(row(name, FIELDS[name], asked.robots))
        print(lines[-1], flush=True)
    if asked.out:
        asked.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
