"""Robots measured through a cable cell: whether what `identify` states of them holds.

    python benchmarks/identified_through_cables.py --robots 200 [--kinds NAME ...] [--built False] --keep FILE --write

Each robot has normal errors of 0.3 mm and 0.5 mrad in every parameter of its links (0.3 mm in every point and offset of the hexapod;
of mechanisms in every value of their legs) and repeats to 0.02 mm in each coordinate. The cell is the six-cable rig of
tests/authorities; at each pose whole counts are read, off by where within a count each drum was zeroed, which is drawn once for a robot,
and by their rounding. Poses come from these counts by the linear law of the cell at the true pose; stated of them is the
covariance of the rounding, and as systematic, which all poses of a robot share, what a zeroing does at each of them. The probabilities are
two-sided, of one determined parameter and one prediction of each robot, which are independent, within
their 95 %. With `--built True` it is stated of the robots how exactly they were built, from which they are drawn; then all parameters are
judged, those too that hardly anything but their drawing tells.
"""

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from study import Study, percent, table, two_sided

from lmeasure.core import se3
from lmeasure.kernels import span_lengths
from lmeasure.rig import read_rig
from lmeasure.robots import Measurements, Settings, any_shipped, checked, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined_parameters
from lmeasure.robots.model import Limits
from lmeasure.robots.parallel.limits import own_roots
from lmeasure.robots.parallel.model import Parallel

FloatArray = NDArray[np.float64]
RIG = Path(__file__).parents[1] / "tests" / "authorities" / "truth" / "cell-run" / "rig.toml"
SEED, POSES, COUNT_MM, REPEATS_MM = 18, 60, 0.012, 0.02
PLACE_MM, TILT_RAD, REGULAR = 220.0, 0.35, 0.05
KINDS = ("generic6", "generic7", "gough", "rotopod-cell", "four-chains", "four-chains-arms", "logos", "crank-platform")
HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Cell:
    """The cell as an instrument of poses near its middle: lengths by their derivatives, rounded to counts."""

    def __init__(self) -> None:
        self.rows = read_rig(RIG).cable_rows()

    def twists(self, poses: FloatArray) -> FloatArray:
        """(N, 6, 6) errors (rotation; place) of poses by errors of the lengths, from differences of the spans."""
        out = np.empty((len(poses), 6, 6))
        for k in range(6):
            h = (1e-5 if k < 3 else 1e-2) * np.eye(6)[k]
            ahead, behind = (
                span_lengths(self.rows, np.ascontiguousarray(se3.displaced(poses, s * np.tile(h, (len(poses), 1))))) for s in (1, -1)
            )
            out[:, :, k] = (ahead - behind) / (2.0 * h[k])
        return np.asarray(np.linalg.inv(out), dtype=np.float64)

    def seen(self, poses: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Poses (N, 7) as counts tell them, the covariance (N, 6, 6) of their rounding and the factors (N, 6, 6) of the six zeroings, each
        uniform over a count."""
        G = self.twists(poses)
        phase = COUNT_MM * rng.uniform(-0.5, 0.5, 6)
        lengths = span_lengths(self.rows, np.ascontiguousarray(poses)) + phase
        read = COUNT_MM * np.round(lengths / COUNT_MM)
        delta = np.einsum("nij,nj->ni", G, read - lengths + phase)
        factors = COUNT_MM / np.sqrt(12.0) * G
        return se3.displaced(poses, delta), factors @ np.swapaxes(factors, 1, 2), factors


U_MM, U_RAD = 0.3, 5e-4
BUILT = Settings(outliers=False, u_links_mm=U_MM, u_links_deg=float(np.degrees(U_RAD)))


def true_robot(name: str, rng: np.random.Generator) -> tuple[Any, Any]:
    """The nominal robot and one that was built."""
    nominal = any_shipped(name).model
    size = np.array([U_MM if p.unit == "mm" else U_RAD for p in nominal.parameters])
    links = [not any(k in p.name for k in ("scale", "sin", "cos", "compliance", "backlash")) for p in nominal.parameters]
    return nominal, nominal.moved(rng.normal(size=len(size)) * size * links)


def joints_of(nominal: Any, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Joint values (count, n), and where the robot stands so that its tool is in the cell: reached by Newton's steps from drawn ones."""
    if isinstance(nominal, Parallel):
        return of_mechanism(nominal, count + 20, rng), se3.compose(HERE, se3.inverse(nominal.home))
    low, high = (np.clip(v, -2.5, 2.5) if not nominal.sliding.all() else v for v in nominal.limits)
    middle = nominal.inverse(nominal.home)[0] if nominal.sliding.all() else np.clip(rng.uniform(-1.0, 1.0, len(low)), low, high)
    centre = nominal.forward(middle[None])[0]
    stand = se3.compose(HERE, se3.inverse(centre))
    out: list[FloatArray] = []
    reach = 0.25 if nominal.sliding.all() else 1.0
    while len(out) < count:
        moves = np.concatenate([reach * TILT_RAD * rng.uniform(-1, 1, 3), reach * PLACE_MM * rng.uniform(-1, 1, 3)])
        if nominal.sliding.all():
            found = nominal.inverse(se3.displaced(centre[None], moves[None])[0])
            out += [found[0]] if len(found) else []
            continue
        many = 4 * count
        moves = rng.uniform(-1, 1, (many, 6)) * np.repeat([TILT_RAD, PLACE_MM], 3)
        joints, goal = middle + 0.6 * rng.uniform(-1, 1, (many, len(low))), se3.displaced(np.tile(centre, (many, 1)), moves)
        scale = np.array([500.0, 500.0, 500.0, 1.0, 1.0, 1.0])
        for _ in range(20):
            pose, by_joints, _ = nominal.derivatives(joints)
            off = se3.displacement(goal, pose)
            at = np.swapaxes(se3.at_points(pose[:, :3]) @ np.swapaxes(by_joints, 1, 2), 1, 2)
            joints = joints + np.einsum("nij,nj->ni", np.linalg.pinv(np.swapaxes(at * scale, 1, 2), rcond=1e-3), scale * off)
        good = (np.abs(off[:, 3:]).max(axis=1) < 1e-6) & ((joints > low) & (joints < high)).all(axis=1)
        out += list(joints[good][: count - len(out)])
    return np.array(out), stand


def of_mechanism(nominal: Parallel, count: int, rng: np.random.Generator) -> FloatArray:
    """Joint values (count, n): of poses about home, well away from singular ones, where it has six joints, else any that its limits
    allow."""
    low, high = nominal.limits
    if len(low) < 6:
        joints = rng.uniform(low, high, (4 * count, len(low)))
        return joints[~np.isnan(nominal.forward(joints)[:, 0])][:count]
    moves = 0.25 * rng.uniform(-1, 1, (8 * count, 6)) * np.repeat([TILT_RAD, PLACE_MM], 3)
    poses = se3.displaced(np.tile(nominal.home, (8 * count, 1)), moves)
    joints = own_roots(nominal, poses[checked(nominal, Limits(singular=REGULAR), poses).all])
    return joints[~np.isnan(nominal.forward(joints)[:, 0])][:count]


def measured_in(cell: Cell, true: Any, joints: FloatArray, stand: FloatArray, rng: np.random.Generator) -> Measurements:
    there = se3.compose(np.tile(stand, (len(joints), 1)), true.forward(joints))
    there = se3.displaced(there, np.column_stack([np.zeros((len(joints), 3)), REPEATS_MM * rng.normal(size=(len(joints), 3))]))
    poses, covariance, systematic = cell.seen(there, rng)
    rows = measured(joints, poses[:, :3], poses[:, 3:], u_position_mm=1.0, u_rotation_rad=1.0)
    return replace(rows, covariance=covariance, systematic=systematic)


def off_true(found: Any, true: Any, *, every: bool = False) -> list[float]:
    """Return errors of determined parameters, or of all, in parts of their standard uncertainty."""
    value = {p.name: p.value for p in true.parameters if p.unit}  # scales were not drawn
    reported, u, unknowns = determined_parameters(found.fit), np.sqrt(np.diag(found.fit.covariance)), found.fit.problem.unknowns
    values = zip(unknowns.names, unknowns.values(found.fit.x), u, reported, strict=True)
    return [float(abs(v - value[n]) / s) for n, v, s, t in values if (t or every) and n in value]


def robot(seed: int, built: bool, name: str) -> dict[str, Any]:
    """Return errors of one robot's parameters in parts of their standard uncertainty, one of them drawn, and which predictions hold."""
    rng = np.random.default_rng([SEED, seed, KINDS.index(name)])
    nominal, true = true_robot(name, rng)
    joints, stand = joints_of(nominal, POSES + 20, rng)
    # near a singular pose of the drawing the robot that was built may have none
    joints = joints[~np.isnan(true.forward(joints)).any(axis=1)][: POSES + 20]
    rows = measured_in(Cell(), true, joints, stand, rng)
    found = identify(nominal, rows.of(np.arange(POSES)), BUILT if built else Settings(outliers=False))
    sizes = off_true(found, true, every=built)
    one = sizes[int(rng.integers(len(sizes)))] if sizes else None
    later = rows.of(np.arange(POSES, POSES + 20))
    predicted = predict(found, later.joints)
    good = np.linalg.norm(predicted.pose[:, :3] - later.position, axis=1) <= predicted.u95_mm
    return {"kind": name, "built": built, "sizes": sizes, "one": one, "good": good}


def robots(found: list[dict[str, Any]]) -> str:
    """Return the table of robots."""
    rows = []
    for built, name in dict.fromkeys((f["built"], f["kind"]) for f in found):
        own = [f for f in found if (f["built"], f["kind"]) == (built, name)]
        sizes, good = np.concatenate([f["sizes"] for f in own]), np.concatenate([f["good"] for f in own])
        one, single = [f["one"] <= 1.96 for f in own if f["one"] is not None], [f["good"][0] for f in own]
        cells = [f"{name}{', as built' * built}", len(own), len(sizes), percent(sizes <= 1.96), percent(one), f"{two_sided(one):.2g}"]
        rows.append([*cells, percent(good), percent(single), f"{two_sided(single):.2g}"])
    head = [
        "robot",
        "robots",
        "parameters determined (as built: of links and legs)",
        "within 95 %, %",
        "one of each robot: %",
        "two-sided p",
    ]
    return table([*head, "predictions within u95, %", "one of each robot: %", "two-sided p"], rows)


def page(found: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    return f"# Robots identified through cables\n\n`python benchmarks/{STUDY.name}.py`, seed {SEED}.\n\n{robots(found)}"


STUDY = Study("identified_through_cables", robot, page, "robots", 200, {"built": (False, True), "kinds": KINDS})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
