"""Errors after correction without a model and with one: a real UR5 by folds, and simulated arms with a map of their errors.

    python benchmarks/error_map.py [--robots 100] [--write] [--keep FILE] [--seconds S]

The UR5's 1,000 poses (datasets/ur5) stand in five folds, or in random sets of fewer. Of the poses left out it is predicted by how much the
robot is off: what is left of that is how far a corrected robot would be from where it was sent. `none`: the errors as they were measured,
less the frame that fits best; `model`: as `lmeasure identify` finds it; `map`: as `lmeasure correct --map` does, with the orientations that
the joint angles have in the nominal robot. The stated radius is to hold 95 % of what is left. What a map refuses counts as refused.

Simulated arms: generic6 with 0.3 mm and 0.5 mrad on every parameter of the links, scattered poses within 500 mm and 0.25 rad about one,
0.02 mm noise; 40 others of the middle part, and 40 that lie 0 to 250 mm outside the measured region, which a map is to refuse. --keep and
--seconds run it in pieces.
"""

import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import replace

import numpy as np
import scipy.spatial.transform
import scipy.stats
from numpy.typing import NDArray
from study import Kept, options, show

from lmeasure.core import se3
from lmeasure.robots import cross_validation, error_map, identify_with_choice, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.robot import shipped

FloatArray = NDArray[np.float64]
DATA = Path(__file__).parents[1] / "datasets" / "ur5" / "grid.csv"
SEED, FOLDS, SIZES, LATER = 21, 5, (60, 100, 200, 400), 200
HALF_MM, TILT_RAD, NOISE_MM, POINTS = 250.0, 0.25, 0.02, (60, 120)
NEAR = np.radians([0.0, 10.0, 10.0, 0.0, 60.0, 0.0])
HEADER = [
    "| {} | method | left, mean mm | 95 % | worst | stated u95, mean | within u95, % | refused, % |",
    "|---|---|---|---|---|---|---|---|",
]


def ur5() -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, 6) joint angles, (N, 7) commanded poses and (N, 3) errors."""
    table = np.genfromtxt(DATA, delimiter=",", names=True)
    joints = np.radians(np.column_stack([table[f"joint_{i}"] for i in range(1, 7)]))
    place, errors = (np.column_stack([table[f"{axis}_{kind}"] for axis in "xyz"]) for kind in ("t", "dif"))
    return joints, np.column_stack([place, shipped("ur5").model.forward(joints)[:, 3:]]), errors


def by_model(joints: FloatArray, places: FloatArray, train: NDArray[np.int64], test: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """What is left (k,) and its stated radius at poses that the identification has not seen."""
    found = identify_with_choice(shipped("ur5").model, measured(joints[train], places[train]))
    held = cross_validation(found)
    reported = predict(found if held is None else replace(found, misfit=held.misfit), joints[test])
    return np.linalg.norm(places[test] - reported.pose[:, :3], axis=1), reported.u95_mm


def by_map(poses: FloatArray, errors: FloatArray, train: NDArray[np.int64], test: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """The same by a map; NaN at poses that it refuses."""
    found = error_map(poses[train], errors[train])
    left = np.linalg.norm(errors[test] - found.errors(poses[test])[:, 3:], axis=1)
    return np.where([bool(found.outside(p)) for p in poses[test]], np.nan, left), found.u95_mm(poses[test])


def line(first: str, method: str, left: FloatArray, radius: FloatArray | None) -> str:
    there = ~np.isnan(left)
    kept = left[there]
    cells = [first, method, f"{kept.mean():.4f}", f"{np.quantile(kept, 0.95):.4f}", f"{kept.max():.3f}"]
    stated = ("", "") if radius is None else (f"{radius[there].mean():.3f}", f"{100 * np.mean(kept <= radius[there]):.1f}")
    out = f"| {' | '.join([*cells, *stated, f'{100 * np.mean(~there):.1f}'])} |"
    print(out, flush=True)
    return out


def real(known: Kept) -> list[str]:
    joints, poses, errors = ur5()
    places = poses[:, :3] + errors
    turn, _ = scipy.spatial.transform.Rotation.align_vectors(places - places.mean(axis=0), poses[:, :3] - poses[:, :3].mean(axis=0))
    as_is = np.linalg.norm(places - places.mean(axis=0) - turn.apply(poses[:, :3] - poses[:, :3].mean(axis=0)), axis=1)
    lines = [HEADER[0].format("measured"), HEADER[1], line("", "none", as_is, None)]
    for size in (800, *SIZES):
        order = np.random.default_rng([SEED, size]).permutation(len(joints))
        parts = np.array_split(order, FOLDS) if size == 800 else [order[size : size + LATER]]
        train = [np.setdiff1d(order, part) if size == 800 else order[:size] for part in parts]
        for method in ("model", "map"):
            each = []
            for k, (own, part) in enumerate(zip(train, parts, strict=True)):
                given = (joints, places) if method == "model" else (poses, errors)
                by = by_model if method == "model" else by_map
                each.append(known(f"ur5 {size} {method} {k}", partial(plainly, by, *given, own, part)))
            each = [one for one in each if one is not None]
            if not each:
                continue
            left, radius = (np.concatenate(values) for values in zip(*each, strict=True))
            lines.append(line(f"{size}{f', {len(each)} of five folds' * (size == 800)}", method, left, radius))
    return lines


def plain(values: tuple[FloatArray, ...]) -> list[list[float]]:
    return [v.tolist() for v in values]


def plainly(by: Callable[..., tuple[FloatArray, ...]], *given: FloatArray | NDArray[np.int64]) -> list[list[float]]:
    return plain(by(*given))


def arm(seed: int, points: int) -> list[list[float]]:
    """Of one simulated arm at 40 poses within the region: errors before, what the map leaves (NaN where it refuses) and its radius; and
    which of 40 places outside it refuses, with how far off it would have been there."""
    nominal = shipped("generic6").model
    middle = nominal.forward(NEAR[None])[0]
    size = np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters])
    size *= [p.name.rpartition(".")[2] in ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg") for p in nominal.parameters]
    rng = np.random.default_rng([SEED, seed, points])
    true = nominal.moved(rng.normal(size=len(size)) * size)
    reach = np.repeat([[1.0], [0.8]], [points, 40], axis=0)
    moves = reach * rng.uniform(-1.0, 1.0, (points + 40, 6)) * np.repeat([TILT_RAD, HALF_MM], 3)
    beyond = rng.uniform(-1.0, 1.0, (40, 6)) * np.repeat([TILT_RAD, HALF_MM], 3)
    axis = rng.integers(3, 6, 40)
    beyond[np.arange(40), axis] = rng.choice([-1.0, 1.0], 40) * rng.uniform(1.0, 2.0, 40) * HALF_MM
    poses = se3.displaced(middle, np.concatenate([moves, beyond]))
    ways = [nominal.inverse(p) for p in poses]
    joints = np.array([w[np.argmin(np.abs(w - NEAR).max(axis=1))] if len(w) else np.full(6, np.nan) for w in ways])
    there = ~np.isnan(joints).any(axis=1)
    assert there[: points + 40].all()
    errors = np.full((len(poses), 3), np.nan)
    errors[there] = (true.forward(joints[there]) - poses[there])[:, :3]
    noisy = errors + rng.normal(0.0, NOISE_MM, errors.shape)
    off, radius = by_map(poses[there], noisy[there], np.arange(points), np.arange(points, there.sum()))
    outside = np.isnan(off[40:]).astype(float)
    return plain((np.linalg.norm(errors[points : points + 40], axis=1), off[:40], radius[:40], outside))


def simulated(robots: int, known: Kept) -> list[str]:
    lines = [HEADER[0].format("points, arms"), HEADER[1]]
    for points in POINTS:
        every = [known(f"arm {points} {seed}", partial(arm, seed, points)) for seed in range(robots)]
        every = [one for one in every if one is not None]
        if not every:
            continue
        before, left, radius, refused = (np.concatenate(part) for part in zip(*every, strict=True))
        first = f"{points}, {len(every)} arms"
        lines += [line(first, "none", before, None), line(first, "map", left, radius)]
        one = []
        for seed, (_, off, r, _) in enumerate(every):
            there = np.flatnonzero(~np.isnan(off))
            if len(there):
                pick = there[int(np.random.default_rng([SEED, seed]).integers(len(there)))]
                one.append(off[pick] <= r[pick])
        p = scipy.stats.binomtest(sum(one), len(one), 0.95).pvalue
        lines.append(f"| {points} | one pose of each robot | | | | | {100 * np.mean(one):.1f} (two-sided p {p:.2g}) | |")
        lines.append(f"| {points} | map, at places outside | | | | | | {100 * np.mean(refused):.1f} |")
        print(*lines[-2:], sep="\n", flush=True)
    return lines


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--keep", type=Path, help="file of what has run, to continue from")
    parser.add_argument("--seconds", type=float, default=math.inf, help="begin nothing new after this time")
    arguments = parser.parse_args()
    known = Kept(arguments.keep, arguments.seconds)
    parts = {"A real UR5": real(known), "Simulated arms": simulated(arguments.robots, known)}
    tables = "".join(f"\n## {title}\n\n" + "\n".join(lines) + "\n" for title, lines in parts.items())
    head = (
        f"# Errors after correction, without a model and with one\n\n`python benchmarks/error_map.py --robots {arguments.robots} --write`\n"
    )
    show(arguments, head + tables, "error_map")


if __name__ == "__main__":
    main()
