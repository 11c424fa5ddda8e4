"""A real UR5 under a laser tracker: five folds, planned beside random poses, and speed beside SciPy's least squares.

    python benchmarks/identification.py [--robots 10] [--write]

The measurements are datasets/ur5: 1,000 poses. Errors are distances of measured from predicted places at poses that the identification has
not seen. Simulated robots: 0.3 mm and 0.5 mrad on every parameter of the links, places measured with 0.02 mm in each coordinate. SciPy has
the same unknowns, residuals and start, with a numerical Jacobian. --write keeps the tables in results/identification.md.
"""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.optimize
import scipy.stats
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import options, show

from lmeasure.core import se3
from lmeasure.robots import (
    Measurements,
    Settings,
    beyond,
    cross_validation,
    freed,
    identify,
    identify_with_choice,
    predict,
    to_plan,
    worth_freeing,
)
from lmeasure.robots.identification.hold_out import FALSE_ALARM
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import chosen, determined_parameters
from lmeasure.robots.identification.problem import Noise, Problem
from lmeasure.robots.identification.unknowns import Unknowns, find_frames
from lmeasure.robots.robot import shipped

FloatArray = NDArray[np.float64]
DATA = Path(__file__).parents[1] / "datasets" / "ur5" / "grid.csv"
FREE: dict[str, tuple[str, ...] | None] = {
    "links": ("links",),
    "links and harmonics": ("links", "harmonics"),
    "what the measurements ask for": None,
}
DEGREE = np.radians(1.0)
SEED, FOLDS, PLANNED, SETS, PARTS, U_MM = 18, 5, 60, 20, 12, 0.02


def real() -> Measurements:
    table = np.genfromtxt(DATA, delimiter=",", names=True)
    joints = np.radians(np.column_stack([table[f"joint_{i}"] for i in range(1, 7)]))
    return measured(joints, np.column_stack([table[f"{axis}_t"] + table[f"{axis}_dif"] for axis in "xyz"]))


def judged(
    rows: Measurements, train: NDArray[np.int64], test: NDArray[np.int64], free: tuple[str, ...] | None
) -> tuple[FloatArray, FloatArray]:
    """Errors and u95 [mm] at the rows `test` of an identification from the rows `train`; free: None as the command has it."""
    robot, own = shipped("ur5").model, rows.of(train)
    found = identify_with_choice(robot, own) if free is None else identify(robot, own, Settings(free))
    held = cross_validation(found)
    found = replace(found, misfit=1.0 if held is None else held.misfit, beyond=beyond(found))
    predicted = predict(found, rows.joints[test])
    return np.linalg.norm(rows.position[test] - predicted.pose[:, :3], axis=1), predicted.u95_mm


def folds(rows: Measurements) -> list[str]:
    lines = ["| freed | mean, mm | worst, mm | within u95, % | mean u95, mm |", "|---|---|---|---|---|"]
    order = np.random.default_rng(SEED).permutation(len(rows))
    for name, free in FREE.items():
        parts = [judged(rows, np.setdiff1d(order, part), part, free) for part in np.array_split(order, FOLDS)]
        error, radius = (np.concatenate(each) for each in zip(*parts, strict=True))
        lines.append(f"| {name} | {error.mean():.4f} | {error.max():.3f} | {100 * np.mean(error <= radius):.1f} | {radius.mean():.3f} |")
        print(lines[-1], flush=True)
    return lines


def planned(rows: Measurements) -> list[str]:
    lines = [
        f"| freed | {PLANNED} planned, mm | {SETS} random sets: median, mm | best, mm | worst, mm | within u95 (planned), % |",
        "|---|---|---|---|---|---|",
    ]
    robot, every = shipped("ur5").model, np.arange(len(rows))
    for name, free in FREE.items():
        frames = find_frames(robot.forward(rows.joints), rows)
        plan = chosen(to_plan(robot, (), frames.base, frames.targets[0], joints=rows.joints), rows.joints, rows.joints, PLANNED, u_mm=0.06)
        error, radius = judged(rows, np.sort(plan), np.setdiff1d(every, plan), free)
        random = []
        for k in range(SETS):
            own = np.sort(np.random.default_rng([SEED, k]).permutation(len(rows))[:PLANNED])
            random.append(judged(rows, own, np.setdiff1d(every, own), free)[0].mean())
        inside = 100 * np.mean(error <= radius)
        lines.append(f"| {name} | {error.mean():.4f} | {np.median(random):.4f} | {min(random):.4f} | {max(random):.4f} | {inside:.1f} |")
        print(lines[-1], flush=True)
    return lines


def planned_of_parts(rows: Measurements) -> list[str]:
    """Planned out of 300 poses drawn from the 1,000, again and again: what one plan shows by chance is told from what all do."""
    lines = [f"| freed | {PLANNED} planned of 300, mean of {PARTS}, mm | within u95, mean % | least | most |", "|---|---|---|---|---|"]
    robot, every = shipped("ur5").model, np.arange(len(rows))
    frames = find_frames(robot.forward(rows.joints), rows)
    for name, free in FREE.items():
        means, inside = [], []
        for k in range(PARTS):
            part = np.sort(np.random.default_rng([SEED, 7, k]).permutation(len(rows))[:300])
            unknowns = to_plan(robot, (), frames.base, frames.targets[0], joints=rows.joints)
            plan = part[chosen(unknowns, rows.joints[part], rows.joints, PLANNED, u_mm=0.06)]
            error, radius = judged(rows, np.sort(plan), np.setdiff1d(every, plan), free)
            means.append(error.mean())
            inside.append(100 * np.mean(error <= radius))
        lines.append(f"| {name} | {np.mean(means):.4f} | {np.mean(inside):.1f} | {min(inside):.1f} | {max(inside):.1f} |")
        print(lines[-1], flush=True)
    return lines


def speed(rows: Measurements) -> list[str]:
    lines = ["| poses | identify, s | SciPy least_squares, numerical Jacobian, s | times |", "|---|---|---|---|"]
    robot = shipped("ur5").model
    for count in (100, 1000):
        own = rows.of(np.arange(count) * (len(rows) // count))
        began = time.perf_counter()
        identify(robot, own)
        ours = time.perf_counter() - began
        unknowns = Unknowns(robot, freed(robot, ("links",)), find_frames(robot.forward(own.joints), own), own)
        problem = Problem(unknowns, own, Noise(0.06, 1e-4))

        def residuals(z: FloatArray, problem: Any = problem) -> FloatArray:
            theta = z * problem.width
            state = problem.unknowns.state(theta * problem.unknowns.size)
            off = problem.rows.position - state.predicted(problem.rows)[:, :3]
            return np.concatenate([off.reshape(-1) / problem.noise.position_mm, z])

        began = time.perf_counter()
        scipy.optimize.least_squares(residuals, np.zeros(len(unknowns)), x_scale="jac")
        theirs = time.perf_counter() - began
        lines.append(f"| {count} | {ours:.2f} | {theirs:.2f} | {theirs / ours:.1f} |")
        print(lines[-1], flush=True)
    return lines


def simulated(robots: int) -> list[str]:
    lines = [
        "| robot | robots | parameters determined | within 95 %, % | two-sided p | places within u95, % | error met / stated, rms |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in ("generic6", "generic7", "ur5", "puma560"):
        inside, within, ratio = [], [], []
        for k in range(robots):
            rng = np.random.default_rng([SEED, k])
            nominal = shipped(name).model
            size = np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters])
            links = np.isin(np.arange(len(size)), freed(nominal, ("links",)))
            true = nominal.moved(rng.normal(size=len(size)) * size * links)
            base = se3.pose(rng.uniform(-2000, 2000, 3), Rotation.random(rng=rng))
            tool = np.array([*rng.uniform(-150, 150, 3), 0.0, 0.0, 0.0, 1.0])
            low, high = (np.clip(limit, -2.5, 2.5) for limit in nominal.limits)

            def seen(
                count: int, true: Any = true, base: Any = base, tool: Any = tool, ends: Any = (low, high), rng: Any = rng
            ) -> Measurements:
                joints = rng.uniform(*ends, (count, len(ends[0])))
                place = se3.compose(se3.compose(base, true.forward(joints)), tool)[:, :3]
                return measured(joints, place + U_MM * rng.normal(size=place.shape), u_position_mm=U_MM)

            found = identify(nominal, seen(80))
            value = {p.name: p.value for p in true.parameters}
            reported, u = determined_parameters(found.fit), np.sqrt(np.diag(found.fit.covariance))
            for i, (own, got) in enumerate(zip(found.fit.problem.names, found.fit.problem.unknowns.values(found.fit.x), strict=True)):
                if own in value and reported[i]:
                    inside.append(abs(got - value[own]) <= 1.96 * u[i])
            later = seen(50)
            predicted = predict(found, later.joints)
            off = np.linalg.norm(predicted.pose[:, :3] - later.position, axis=1)
            within.append(np.mean(off <= predicted.u95_mm))
            ratio.append(np.mean(off**2 / np.einsum("nii->n", predicted.covariance)))
        p = scipy.stats.binomtest(sum(inside), len(inside), 0.95).pvalue
        lines.append(
            f"| {name} | {robots} | {len(inside)} | {100 * np.mean(inside):.1f} | {p:.2g} | {100 * np.mean(within):.1f} "
            f"| {np.sqrt(np.mean(ratio)):.3f} |"
        )
        print(lines[-1], flush=True)
    return lines


def halves(rows: Measurements) -> list[str]:
    """The real robot, identified in one half of its workspace and predicted in the other."""
    halves = (
        f"{half}: mean, mm | u95, mm | within, % | with harmonics: mean, mm" for half in ("trained on the lower half", "on the upper")
    )
    lines = [f"| cut by | {' | '.join(halves)} |", "|---|---|---|---|---|---|---|---|---|"]
    place, joints = rows.position, rows.joints
    along = dict(zip(("x", "y", "z"), place.T, strict=True)) | {f"joint {i + 1}": joints[:, i] for i in range(6)}
    along |= {"distance from the first axis": np.hypot(place[:, 0], place[:, 1]), "distance from the base": np.linalg.norm(place, axis=1)}
    along |= {f"chance, {k + 1}": np.random.default_rng([SEED, 13, k]).random(len(rows)) for k in range(4)}
    for name, value in along.items():
        low, parts = value < np.median(value), []
        for own in (low, ~low):
            error, radius = judged(rows, np.flatnonzero(own), np.flatnonzero(~own), None)
            free = predict(identify(shipped("ur5").model, rows.of(np.flatnonzero(own)), Settings(("links", "harmonics"))), joints[~own])
            apart = np.linalg.norm(rows.position[~own] - free.pose[:, :3], axis=1).mean()
            parts.append(f"{error.mean():.3f} | {radius.mean():.2f} | {100 * np.mean(error <= radius):.1f} | {apart:.3f}")
        lines.append(f"| {name} | {' | '.join(parts)} |")
        print(lines[-1], flush=True)
    return lines


def asked_for(robots: int) -> list[str]:
    """Families that a robot has nothing of: how often a test asks for them all the same."""
    lines = ["| robot | places | tests | below 5 %, % | two-sided p | below 0.1 % |", "|---|---|---|---|---|---|"]
    for name in ("ur5", "generic7"):
        for count in (30, 80):
            chances: list[float] = []
            for k in range(robots):
                rng = np.random.default_rng([SEED, 5, k, count])
                nominal = shipped(name).model
                size = np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters])
                links = np.isin(np.arange(len(size)), freed(nominal, ("links",)))
                true = nominal.moved(rng.normal(size=len(size)) * size * links)
                low, high = (np.clip(limit, -2.5, 2.5) for limit in nominal.limits)
                joints = rng.uniform(low, high, (count, len(low)))
                place = se3.compose(true.forward(joints), np.array([30.0, 40.0, 50.0, 0.0, 0.0, 0.0, 1.0]))[:, :3]
                found = identify(nominal, measured(joints, place + U_MM * rng.normal(size=place.shape)))
                chances += [w.chance for w in worth_freeing(found) if not w.freed]
            below = int((np.array(chances) < 0.05).sum())
            p = scipy.stats.binomtest(below, len(chances), 0.05).pvalue
            alarms = int((np.array(chances) < FALSE_ALARM).sum())
            lines.append(f"| {name} | {count} | {len(chances)} | {100 * below / len(chances):.1f} | {p:.2g} | {alarms} |")
            print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--parts", default="", help="numbers of the tables, from 1, all by default")
    arguments = parser.parse_args()
    rows = real()
    tables: dict[str, Callable[[], list[str]]] = {
        "Five folds of 1,000 poses": lambda: folds(rows),
        "Planned and random poses": lambda: planned(rows),
        "Planned out of parts of them": lambda: planned_of_parts(rows),
        "Speed": lambda: speed(rows),
        "What is not there and asked for": lambda: asked_for(arguments.robots),
        "Simulated robots, 80 places of 0.02 mm": lambda: simulated(arguments.robots),
        "One half of the workspace from the other": lambda: halves(rows),
    }
    wanted = [int(n) for n in arguments.parts.split(",") if n] or range(1, len(tables) + 1)
    parts = [(title, table()) for n, (title, table) in enumerate(tables.items(), 1) if n in wanted]
    head = (
        f"# Identification of robots\n\n`python benchmarks/identification.py --robots {arguments.robots} --write`, seed {SEED}, "
        "one thread; "
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}.\n"
    )
    show(arguments, head + "".join(f"\n## {title}\n\n" + "\n".join(lines) + "\n" for title, lines in parts), "identification")


if __name__ == "__main__":
    main()
