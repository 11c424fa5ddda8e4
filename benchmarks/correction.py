"""Simulated robots corrected: measured, identified, told corrected joint values, measured again; improvement and what is left.

    python benchmarks/correction.py [--robots 200] [--kinds generic6,generic7,gough] [--keep FILE --seconds S] [--write]

Every parameter of the links errs by 0.3 mm and 0.5 mrad, of a hexapod every point and length by 0.3 mm; the robot repeats to 0.02 mm in
each coordinate, the instrument adds 0.01 mm. Identified from 100 poses, each visited once or 30 times as a certificate's poses are, from
places alone or with orientations known to 0.02 degrees besides; 40 others, 10 of a hexapod, are visited 30 times each, before and after
correction. AP is the distance of the mean from where the nominal robot would be, seen from where the robot was found to stand. Two floors:
what repeatability and the instrument leave over the root of the cycles, were the robot known; and the same with what the identification
says that it does not know: the mean of |N(0, covariance)|. Improvement is AP before over after, of each robot. --keep and --seconds run it
in pieces. --write keeps the table in results/correction.md.
"""

import argparse
import itertools
import math
import os
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from pieces import Pieces

from lmeasure.core import se3
from lmeasure.robots import Limits, Settings, any_shipped, corrections, identify, predict
from lmeasure.robots.identification.measurements import measured

RESULTS = Path(__file__).parent / "results" / "correction.md"
SIZES = {"theta_deg": 5e-4, "alpha_deg": 5e-4, "beta_deg": 5e-4, "d_mm": 0.3, "a_mm": 0.3, "offset_mm": 0.3}
SIZES |= {f"{end}_{axis}_mm": 0.3 for end in ("base", "platform") for axis in "xyz"}
PLACE_MM, TILT_RAD = 120.0, 0.25
"""Of a hexapod, about its home pose."""
TURN_RAD = np.radians(0.02)
REPEAT_MM, INSTRUMENT_MM, ROWS, CYCLES = 0.02, 0.01, 100, 30
NOISE_MM = math.hypot(REPEAT_MM, INSTRUMENT_MM)
"""Of one visit, in each coordinate."""
TARGETS = {"generic6": 40, "generic7": 40, "gough": 10}
BASE = np.array([1000.0, 50.0, -30.0, 0.0, 0.0, np.sin(0.6), np.cos(0.6)])
TOOL = np.array([10.0, 20.0, 150.0, 0.0, 0.0, 0.0, 1.0])


def joints_of(nominal: Any, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, n) joint values over the middle of what an arm's joints allow, or about a hexapod's home."""
    low, high = nominal.limits
    if nominal.sliding.all():
        out: list[np.ndarray] = []
        while len(out) < count:
            move = np.concatenate([TILT_RAD * rng.uniform(-1, 1, 3), PLACE_MM * rng.uniform(-1, 1, 3)])
            out += list(nominal.inverse(se3.displaced(nominal.home, move)))[:1]
        return np.array(out)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    reach = np.minimum(half, 2.0) * 0.9
    return np.asarray(middle + rng.uniform(-reach, reach, (count, len(low))))


def one(name: str, seed: int, oriented: bool, visits: int) -> list[float]:
    """Mean AP before, after, and its floor with what is not known of the robot [mm]; targets corrected, refused, and how many within u95
    of single visits."""
    rng, nominal = np.random.default_rng([seed, len(name)]), any_shipped(name).model
    true = nominal.moved(np.array([rng.normal() * SIZES.get(p.name.rpartition(".")[2], 0.0) for p in nominal.parameters]))

    def poses(q: np.ndarray) -> np.ndarray:
        return np.asarray(se3.compose(se3.compose(BASE, true.forward(q)), np.broadcast_to(TOOL, (len(q), 7))))

    def seen(q: np.ndarray) -> np.ndarray:
        return poses(q)[:, :3]

    q = joints_of(nominal, rng, ROWS)
    place = seen(q) + rng.normal(0.0, NOISE_MM / math.sqrt(visits), (ROWS, 3))
    turns = rng.normal(0.0, TURN_RAD / math.sqrt(visits), (ROWS, 3))
    turned = se3.displaced(poses(q), np.column_stack([turns, np.zeros((ROWS, 3))]))[:, 3:]
    rows = measured(q, place, turned if oriented else None)
    found = identify(nominal, rows, Settings())
    targets = joints_of(nominal, rng, TARGETS[name])
    done = corrections(nominal, found.state.robot, targets, Limits())
    kept = np.array([not c.refused for c in done])
    targets, solved = targets[kept], np.array([c.joints for c in done])[kept]
    base, tool = found.state.base, found.state.targets[0]
    wanted = se3.compose(se3.compose(base, nominal.forward(targets)), np.broadcast_to(tool, (len(targets), 7)))[:, :3]
    mean = rng.normal(0.0, NOISE_MM / math.sqrt(CYCLES), (2, len(targets), 3))
    before, after = (np.linalg.norm(seen(p) + m - wanted, axis=1) for p, m in zip((targets, solved), mean, strict=True))
    told = predict(found, solved)
    own = told.covariance - (found.noise.position_mm**2) * found.shape * found.misfit**2
    spread = own + NOISE_MM**2 / CYCLES * np.eye(3)
    draws = np.einsum("nij,knj->kni", np.linalg.cholesky(spread + 1e-12 * np.eye(3)), rng.normal(size=(400, len(targets), 3)))
    floor = np.linalg.norm(draws, axis=2).mean()
    # where one visit of the means that were measured would lie: of single visits as stated
    single = np.linalg.norm(seen(solved) + rng.normal(0.0, NOISE_MM / math.sqrt(visits), (len(targets), 3)) - wanted, axis=1)
    counts = int(kept.sum()), int((~kept).sum()), int((single < told.u95_mm).sum())
    return [float(before.mean()), float(after.mean()), float(floor), *counts]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--kinds", default="generic6,generic7,gough")
    parser.add_argument("--keep", type=Path, help="file for what has run, to go on from")
    parser.add_argument("--seconds", type=float, default=math.inf, help="when to stop, with --keep")
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    known, robots = Pieces(asked.keep, asked.seconds), asked.robots
    bare = NOISE_MM / math.sqrt(CYCLES) * math.sqrt(8.0 / math.pi)  # the mean of |N(0, s^2 I)| in space
    header = ["robot", "measured", "visits", "robots", "AP before", "after", "floor, mm", "after / floor", "with what is not known"]
    header += ["after / that", "improvement: least, 5, 50, 95 %, most", "refused", "in u95"]
    lines = [
        "# Corrected robots",
        "",
        f"`python benchmarks/correction.py --robots {robots}`: {ROWS} poses measured, once or {CYCLES} times each, by places alone or with "
        f"orientations; 40 others, of a hexapod 10, corrected and visited {CYCLES} times. `gough` is a hexapod.",
        "",
        f"| {' | '.join(header)} |",
        "|---" * len(header) + "|",
    ]
    # as a certificate measures first: where the time does not reach, the others have fewer robots
    cases = [(name, oriented, visits) for visits, oriented, name in itertools.product((CYCLES, 1), (False, True), asked.kinds.split(","))]
    found: dict[tuple[str, bool, int], list[list[float]]] = {case: [] for case in cases}
    for case, seed in itertools.product(cases, range(robots)):
        name, oriented, visits = case
        row = known(f"{name} {oriented} {visits} {seed}", partial(one, name, seed, oriented, visits))
        if row is not None:
            found[case].append(row)
    for (name, oriented, visits), rows in found.items():
        if not rows:
            continue
        before, after, floor, kept, refused, inside = np.array(rows).T
        cells = [name, "places and orientations" if oriented else "places", str(visits), str(len(rows)), f"{before.mean():.3f}"]
        cells += [f"{after.mean():.4f}", f"{bare:.4f}", f"{after.mean() / bare:.2f}", f"{floor.mean():.4f}"]
        cells += [
            f"{after.mean() / floor.mean():.2f}",
            ", ".join(f"{v:.0f}" for v in np.quantile(before / after, (0.0, 0.05, 0.5, 0.95, 1.0))),
        ]
        cells += [f"{100 * refused.sum() / (refused + kept).sum():.1f} %", f"{100 * inside.sum() / kept.sum():.1f} %"]
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    if asked.write:
        RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
