"""Robots identified with rows set aside or weighed: whether what is stated holds, and what it costs where nothing is wrong.

    python benchmarks/row_weights.py [--robots 200] [--kinds NAME,...] [--write]

Six-axis arms with normal errors of 0.3 mm and 0.5 mrad in every parameter of their links, 60 places each, measured with normal errors of
0.05 mm in each coordinate, of which nothing is stated. Of some rows the errors are four or ten times as large; "heavy tails" are Student's
with 3 degrees of freedom. Every robot is identified three times: all rows alike, contradicted ones set aside (the default), and weighed.
Efficiency: variance of the determined parameters against that of all rows alike without bad rows, in the mean of its logarithm. Stated:
their standard uncertainties against the errors found, in the mean over robots of the mean square. Predictions: sound measurements at 20
other poses. p is two-sided, of one parameter or prediction of each robot.
"""

import os
import sys
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.stats
from numpy.typing import NDArray
from study import Study, percent, table, two_sided

from lmeasure.core import se3
from lmeasure.robots import Settings, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined_parameters
from lmeasure.robots.robot import shipped

FloatArray = NDArray[np.float64]
SEED, POSES, LATER, U_MM = 181, 60, 20, 0.05
WAYS = {"all alike": Settings(outliers=False), "set aside": Settings(), "biweight": Settings(weights="biweight")}
PARTS = {"none": (0.0, 1.0), "10 % tenfold": (0.1, 10.0), "20 % fourfold": (0.2, 4.0), "30 % tenfold": (0.3, 10.0)}
BAD = (*PARTS, "heavy tails")
BASE = np.array([2000.0, -300.0, 500.0, 0.18, 0.83, -0.42, 0.32])
TOOL = np.array([40.0, -25.0, 110.0, 0.0, 0.0, 0.0, 1.0])


def errors(kind: str, rng: np.random.Generator) -> FloatArray:
    """(POSES, 3) [mm]."""
    normal = rng.normal(size=(POSES, 3))
    if kind == "heavy tails":
        # scaled so that the middle half is that of the normal ones
        return U_MM * scipy.stats.norm.ppf(0.75) / scipy.stats.t.ppf(0.75, 3) * rng.standard_t(3, size=(POSES, 3))
    part, times = PARTS[kind]
    bad = rng.permutation(POSES) < round(part * POSES)
    return U_MM * normal * np.where(bad, times, 1.0)[:, None]


def draw(seed: int, kind: str) -> dict[str, Any]:
    """Return what one robot is identified as, by each way and, without bad rows, by all rows alike (reference)."""
    nominal = shipped("generic6").model
    links = np.array([p.name.rsplit(".", 1)[1] in {"theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg"} for p in nominal.parameters])
    size = np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters]) * links
    base = np.array([*BASE[:3], *BASE[3:] / np.linalg.norm(BASE[3:])])
    rng = np.random.default_rng([SEED, seed])
    true = nominal.moved(rng.normal(size=len(size)) * size)
    low, high = (np.clip(v, -2.5, 2.5) for v in nominal.limits)
    joints = rng.uniform(low, high, (POSES + LATER, len(low)))
    place = se3.compose(se3.compose(np.tile(base, (len(joints), 1)), true.forward(joints)), TOOL)[:, :3]
    later = place[POSES:] + U_MM * rng.normal(size=(LATER, 3))
    sound, seen = (place[:POSES] + errors(of, np.random.default_rng([SEED, 1, seed])) for of in ("none", kind))
    value = {p.name: p.value for p in true.parameters}
    out: dict[str, Any] = {"kind": kind}
    for way, settings, at in (("reference", WAYS["all alike"], sound), *((w, s, seen) for w, s in WAYS.items())):
        found = identify(nominal, measured(joints[:POSES], at), settings)
        names, u = found.fit.problem.unknowns.names, np.sqrt(np.diag(found.fit.covariance))
        now = zip(names, found.fit.problem.unknowns.values(found.fit.x), u, determined_parameters(found.fit), strict=True)
        off = {n: (float((v - value[n]) / s), float(v - value[n])) for n, v, s, t in now if n in value and t}
        predicted = predict(found, joints[POSES:])
        within = np.linalg.norm(predicted.pose[:, :3] - later, axis=1) <= predicted.u95_mm
        pick = np.random.default_rng([SEED, 2, seed])
        one = list(off.values())[int(pick.integers(len(off)))][0] if off else None
        out[way] = {"off": off, "within": within, "one": one, "weight": float(found.weight.sum()), "u95": float(predicted.u95_mm.mean())}
    return out


def line(kind: str, way: str, found: list[dict[str, Any]]) -> list[str]:
    """Return the cells of one way to weigh rows."""
    own, reference = [f[way] for f in found], [f["reference"] for f in found]
    z = [np.array([a for a, _ in f["off"].values()]) for f in own]
    factor = scipy.stats.t.ppf(0.975, 3 * POSES - 30)
    one = [f["one"] is not None and abs(f["one"]) <= factor for f in own]
    common = sorted(set.intersection(*(set(f["off"]) for f in (*own, *reference))))
    square, best = (np.mean([[f["off"][n][1] ** 2 for n in common] for f in of], axis=0) for of in (own, reference))
    within, single = np.concatenate([f["within"] for f in own]), [f["within"][0] for f in own]
    ratio = 1.0 / np.sqrt(np.mean([np.mean(v**2) for v in z]))
    count, u95 = (np.mean([f[key] for f in own]) for key in ("weight", "u95"))
    cells = [kind, way, f"{count:.1f}", f"{100 * np.exp(np.mean(np.log(best / square))):.0f}", f"{ratio:.3f}"]
    cells += [
        percent(np.abs(np.concatenate(z)) <= factor),
        f"{two_sided(one):.2g}",
        percent(within),
        f"{two_sided(single):.2g}",
        f"{u95:.4f}",
    ]
    return cells


def page(found: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    by = {kind: [f for f in found if f["kind"] == kind] for kind in BAD}
    head = ["bad rows", "rows are", "they count as", "efficiency, %", "u stated / found", "parameters within 95 %, %", "p"]
    rows = [line(kind, way, own) for kind, own in by.items() if own for way in WAYS]
    run = f"`python benchmarks/row_weights.py --write`, seed {SEED}, {max(map(len, by.values()))} robots."
    return f"# Rows set aside and rows weighed\n\n{run}\n\n" + table([*head, "predictions within u95, %", "p", "mean u95, mm"], rows)


STUDY = Study("row_weights", draw, page, "robots", 200, {"kinds": BAD})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
