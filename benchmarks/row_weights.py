"""Robots identified with rows set aside or weighed: whether what is stated holds, and what it costs where nothing is wrong.

    python benchmarks/row_weights.py [--robots 200] [--kinds NAME,...] [--write]

Six-axis arms with normal errors of 0.3 mm and 0.5 mrad in every parameter of their links, 60 places each, measured with normal errors of
0.05 mm in each coordinate, of which nothing is stated. Of some rows the errors are four or ten times as large; "heavy tails" are Student's
with 3 degrees of freedom. Every robot is identified three times: all rows alike, contradicted ones set aside (the default), and weighed.
Efficiency: variance of the determined parameters against that of all rows alike without bad rows, in the mean of its logarithm. Stated:
their standard uncertainties against the errors found, in the mean over robots of the mean square. Predictions: sound measurements at 20
other poses. p is two-sided, of one parameter or prediction of each robot.
"""

import argparse
import os
import platform
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from lmeasure.core import se3
from lmeasure.robots import Settings, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined
from lmeasure.robots.robot import shipped

FloatArray = NDArray[np.float64]
RESULTS = Path(__file__).parent / "results" / "row_weights.md"
SEED, POSES, LATER, U_MM = 181, 60, 20, 0.05
WAYS = {"all alike": Settings(outliers=False), "set aside": Settings(), "biweight": Settings(weights="biweight")}
BASE = np.array([2000.0, -300.0, 500.0, 0.18, 0.83, -0.42, 0.32])
TOOL = np.array([40.0, -25.0, 110.0, 0.0, 0.0, 0.0, 1.0])


def errors(kind: str, rng: np.random.Generator) -> FloatArray:
    """(POSES, 3) [mm]."""
    normal = rng.normal(size=(POSES, 3))
    if kind == "heavy tails":
        # scaled so that the middle half is that of the normal ones
        return U_MM * scipy.stats.norm.ppf(0.75) / scipy.stats.t.ppf(0.75, 3) * rng.standard_t(3, size=(POSES, 3))
    part, times = {"none": (0.0, 1.0), "10 % tenfold": (0.1, 10.0), "20 % fourfold": (0.2, 4.0), "30 % tenfold": (0.3, 10.0)}[kind]
    bad = rng.permutation(POSES) < round(part * POSES)
    return U_MM * normal * np.where(bad, times, 1.0)[:, None]


def study(kind: str, robots: int) -> list[str]:
    nominal = shipped("generic6").model
    links = np.array([p.name.rsplit(".", 1)[1] in {"theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg"} for p in nominal.parameters])
    size = np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters]) * links
    base = np.array([*BASE[:3], *BASE[3:] / np.linalg.norm(BASE[3:])])
    told: dict[str, list[Any]] = {way: [] for way in ("reference", *WAYS)}
    for k in range(robots):
        rng = np.random.default_rng([SEED, k])
        true = nominal.moved(rng.normal(size=len(size)) * size)
        low, high = (np.clip(v, -2.5, 2.5) for v in nominal.limits)
        joints = rng.uniform(low, high, (POSES + LATER, len(low)))
        place = se3.compose(se3.compose(np.tile(base, (len(joints), 1)), true.forward(joints)), TOOL)[:, :3]
        later = place[POSES:] + U_MM * rng.normal(size=(LATER, 3))
        sound = place[:POSES] + errors("none", np.random.default_rng([SEED, 1, k]))
        seen = place[:POSES] + errors(kind, np.random.default_rng([SEED, 1, k]))
        value = {p.name: p.value for p in true.parameters}
        for way, settings, at in (("reference", WAYS["all alike"], sound), *((w, s, seen) for w, s in WAYS.items())):
            found = identify(nominal, measured(joints[:POSES], at), settings)
            names, u = found.fit.problem.unknowns.names, np.sqrt(np.diag(found.fit.covariance))
            now = zip(names, found.fit.problem.unknowns.values(found.fit.x), u, determined(found.fit), strict=True)
            off = {n: ((v - value[n]) / s, v - value[n]) for n, v, s, t in now if n in value and t}
            predicted = predict(found, joints[POSES:])
            within = np.linalg.norm(predicted.pose[:, :3] - later, axis=1) <= predicted.u95_mm
            pick = np.random.default_rng([SEED, 2, k])
            one = list(off.values())[int(pick.integers(len(off)))][0] if off else np.nan
            told[way].append((off, within, one, found.weight.sum(), predicted.u95_mm.mean()))
    lines = []
    for way in WAYS:
        z = [np.array([a for a, _ in off.values()]) for off, *_ in told[way]]
        factor = scipy.stats.t.ppf(0.975, 3 * POSES - 30)
        inside = np.concatenate([np.abs(v) <= factor for v in z])
        one = np.abs([o for _, _, o, *_ in told[way]]) <= factor
        common = set.intersection(*(set(off) for w in ("reference", way) for off, *_ in told[w]))
        square = {w: np.mean([[off[n][1] ** 2 for n in sorted(common)] for off, *_ in told[w]], axis=0) for w in ("reference", way)}
        efficiency = float(np.exp(np.mean(np.log(square["reference"] / square[way]))))
        within = np.concatenate([w for _, w, *_ in told[way]])
        single = [bool(w[0]) for _, w, *_ in told[way]]
        p = [scipy.stats.binomtest(int(np.sum(v)), len(v), 0.95).pvalue for v in (one, single)]
        ratio = 1.0 / np.sqrt(np.mean([np.mean(v**2) for v in z]))
        count, u95 = np.mean([t[3] for t in told[way]]), np.mean([t[4] for t in told[way]])
        cells = (kind, way, f"{count:.1f}", f"{100 * efficiency:.0f}", f"{ratio:.3f}", f"{100 * inside.mean():.1f}", f"{p[0]:.2g}")
        lines.append(f"| {' | '.join(cells)} | {100 * within.mean():.1f} | {p[1]:.2g} | {u95:.4f} |")
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--kinds", default="none,10 % tenfold,20 % fourfold,30 % tenfold,heavy tails")
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    head = ["bad rows", "rows are", "they count as", "efficiency, %", "u stated / found", "parameters within 95 %, %", "p"]
    head += ["predictions within u95, %", "p", "mean u95, mm"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for kind in asked.kinds.split(","):
        lines += study(kind, asked.robots)
    where = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}"
    run = f"`python benchmarks/{Path(__file__).name} --robots {asked.robots} --write`, seed {SEED}; {where}."
    if asked.write:
        RESULTS.write_text(f"# Rows set aside and rows weighed\n\n{run}\n\n" + "\n".join(lines) + "\n", encoding="utf-8")
    sys.exit(0)


if __name__ == "__main__":
    main()
