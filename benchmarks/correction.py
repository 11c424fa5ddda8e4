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

import math
import os
import sys
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from study import Study, table as as_table

from lmeasure.core import se3
from lmeasure.robots import Limits, Settings, any_shipped, corrections, identify, predict
from lmeasure.robots.identification.measurements import measured

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


def one(seed: int, visits: int, oriented: bool, name: str) -> dict[str, Any]:
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
    reported = predict(found, solved)
    own = reported.covariance - (found.noise.position_mm**2) * found.shape * found.misfit**2
    spread = own + NOISE_MM**2 / CYCLES * np.eye(3)
    draws = np.einsum("nij,knj->kni", np.linalg.cholesky(spread + 1e-12 * np.eye(3)), rng.normal(size=(400, len(targets), 3)))
    floor = np.linalg.norm(draws, axis=2).mean()
    # where one visit of the means that were measured would lie: of single visits as stated
    single = np.linalg.norm(seen(solved) + rng.normal(0.0, NOISE_MM / math.sqrt(visits), (len(targets), 3)) - wanted, axis=1)
    counts = int(kept.sum()), int((~kept).sum()), int((single < reported.u95_mm).sum())
    values = [float(before.mean()), float(after.mean()), float(floor), *counts]
    return {"kind": name, "oriented": oriented, "visits": visits, "values": values}


def page(found: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    bare = NOISE_MM / math.sqrt(CYCLES) * math.sqrt(8.0 / math.pi)  # the mean of |N(0, s^2 I)| in space
    head = ["robot", "measured", "visits", "robots", "AP before", "after", "floor, mm", "after / floor", "with what is not known"]
    head += ["after / that", "improvement: least, 5, 50, 95 %, most", "refused", "in u95"]
    cases: dict[tuple[str, bool, int], list[list[float]]] = {}
    for one in found:
        cases.setdefault((one["kind"], one["oriented"], one["visits"]), []).append(one["values"])
    rows = []
    for (name, oriented, visits), values in cases.items():
        before, after, floor, kept, refused, inside = np.array(values).T
        cells = [name, "places and orientations" if oriented else "places", visits, len(values), f"{before.mean():.3f}"]
        cells += [f"{after.mean():.4f}", f"{bare:.4f}", f"{after.mean() / bare:.2f}", f"{floor.mean():.4f}"]
        improvement = ", ".join(f"{v:.0f}" for v in np.quantile(before / after, (0.0, 0.05, 0.5, 0.95, 1.0)))
        shares = f"{100 * refused.sum() / (refused + kept).sum():.1f} %", f"{100 * inside.sum() / kept.sum():.1f} %"
        rows.append([*cells, f"{after.mean() / floor.mean():.2f}", improvement, *shares])
    return (
        f"# Corrected robots\n\n`python benchmarks/correction.py`: {ROWS} poses measured, once or {CYCLES} times each, by places alone or "
        f"with orientations; 40 others, of a hexapod 10, corrected and visited {CYCLES} times. `gough` is a hexapod.\n\n"
        + as_table(head, rows)
    )


STUDY = Study(
    "correction", one, page, "robots", 200,
    {"visits": (CYCLES, 1), "oriented": (False, True), "kinds": ("generic6", "generic7", "gough")},
    "{kinds} {oriented} {visits} {seed}",
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
