"""Robots identified from a trajectory's file whose systematic errors are not as even over the places as `identify` takes them for.

    python benchmarks/uneven_fields.py [--robots 100] [--fields NAME ...] [--write]

A six-axis arm with normal errors of 0.3 mm and 0.5 mrad in every parameter of its links, 60 poses in the cable cell of tests/authorities,
stated of each: 0.01 mm and 0.03 mrad by itself, and systematic ones. What the latter really are is drawn for each robot: a constant with
slopes along the axes; normal fields in each coordinate whose correlation falls with the distance d as exp(-d^2 / 2 L^2), L in parts of the
places' rms distance from their middle; and what a cable cell's zeroings and points do that are off by 0.02 mm each, as after a
calibration. At each place their standard uncertainties are those stated. The probabilities are two-sided, of one parameter and one
prediction of each robot.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from identified_through_cables import RIG, Cell, joints_of, off_true, true_robot
from numpy.typing import NDArray
from study import Study, percent, table, two_sided

from lmeasure.core import se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, span_lengths
from lmeasure.rig import read_rig
from lmeasure.robots import Settings, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.read_measurements import fields_over, independent

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


def draw(seed: int, name: str) -> dict[str, Any]:
    """Return the errors of one robot's parameters in parts of their standard uncertainty, one of them drawn, and which predictions hold."""
    rng = np.random.default_rng([SEED, seed])
    nominal, true = true_robot("generic6", rng)
    joints, stand = joints_of(nominal, POSES + LATER, rng)
    there = se3.compose(np.tile(stand, (len(joints), 1)), true.forward(joints))
    errors, covariance = FIELDS[name](there, rng)
    seen = se3.displaced(there, errors + OWN * rng.normal(size=errors.shape))
    rows = measured(joints, seen[:, :3], seen[:, 3:], u_position_mm=1.0, u_rotation_rad=1.0)
    roots = np.linalg.cholesky(covariance[:POSES])
    factors = independent(np.einsum("nij,nb->nijb", roots, fields_over(seen[:POSES])).reshape(POSES, 6, -1))
    used = replace(rows.of(np.arange(POSES)), covariance=np.tile(np.diag(OWN**2), (POSES, 1, 1)), systematic=factors)
    found = identify(nominal, used, Settings(outliers=False))
    sizes = off_true(found, true)
    predicted = predict(found, joints[POSES:])
    good = np.linalg.norm(predicted.pose[:, :3] - seen[POSES:, :3], axis=1) <= predicted.u95_mm
    return {"field": name, "sizes": sizes, "one": sizes[int(rng.integers(len(sizes)))], "good": good}


def page(found: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    rows = []
    for name in FIELDS:
        own = [f for f in found if f["field"] == name]
        if own:
            sizes, good = np.concatenate([f["sizes"] for f in own]), np.concatenate([f["good"] for f in own])
            one, single = [f["one"] <= 1.96 for f in own], [f["good"][0] for f in own]
            cells = [name, len(own), percent(sizes <= 1.96), f"{np.sqrt(np.mean(np.square(sizes))):.2f}", percent(one)]
            rows.append([*cells, f"{two_sided(one):.2g}", percent(good), percent(single), f"{two_sided(single):.2g}"])
    head = ["field", "robots", "parameters within 95 %, %", "rms of error / u", "one of each robot: %", "two-sided p"]
    head += ["predictions within u95, %", "one of each robot: %", "two-sided p"]
    return (
        f"# Systematic errors of a trajectory's file that are not even\n\n`python benchmarks/uneven_fields.py`, seed {SEED}.\n\n"
        + table(head, rows)
    )


STUDY = Study("uneven_fields", draw, page, "robots", 100, {"fields": tuple(FIELDS)})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
