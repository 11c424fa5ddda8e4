"""Sound runs of drawn rigs, of drums and encoders of every kind: are they used whole, and do their poses err as stated?

    python benchmarks/random_rigs.py --rigs 200 --keep rigs.jsonl [--write]     (goes on from what is kept)

Each draw is a rig of three to nine drums anywhere around, over, below or beside the tool, with one to six attachment points at each of
which cables may meet, pulleys of 0 to 60 mm, some parts that are not as drawn and stated so, and swivel encoders and inclinometers of which
it is drawn whether their zeros are known well, to a degree, or not at all, and whether they are incremental; and a motion of 1 to 6 s at 50
to 1,000 Hz. Its start is stated exactly, or to 0.5 mm and 1 mrad and drawn so, or not at all. Nothing is wrong with any of them. Counts
and zeros are drawn as the rig states them. Whole: every sample has a pose. In part: some do not, for an assembly ends or a pose is
singular. Contradicting: some are refused because channels contradict each other, which a sound run should not be more often than once in
a thousand. Held: of one sample in the middle of those that have a pose, whether its place and orientation lie in their 95 % region.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2
from study import Study

from lmeasure.core import LMeasureError, Status, se3
from lmeasure.recording import Run
from lmeasure.rig import CABLES_FOR_A_POSE, Rig, rig_from_dict
from lmeasure.simulation import simulate_run
from lmeasure.trajectory import covariances, reconstruct

FloatArray = NDArray[np.float64]
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
U_START = (0.5, 0.001)
ZEROS: dict[str, Callable[[float], dict[str, Any]]] = {
    "known": lambda zero: {"zero_deg": zero, "u_zero_deg": 0.002},
    "about": lambda zero: {"zero_deg": zero, "u_zero_deg": 1.0},
    "unknown": lambda _: {},
    "incremental": lambda _: {"absolute": False},
}
ENDS = ("whole", "in part", "contradicting", "no pose", "start refused", "refused")
GROUPS = ("redundant, zeros known", "redundant, zeros about or unknown", "as many as unknowns")


@dataclass(frozen=True)
class RunResult:
    """What became of a run; square: of a sample's error in units of its covariance, NaN without one; error and u [mm] of its place."""

    number: int
    group: str
    start: str
    end: str
    square: float
    error_mm: float
    u_mm: float
    said: str


def drawn_rig(rng: np.random.Generator) -> dict[str, Any]:
    """The rig as it is stated."""
    n, radius = int(rng.choice([3, 4, 5, 6, 6, 6, 7, 8, 9])), rng.uniform(800.0, 2500.0)
    where = str(rng.choice(["around", "beside", "over", "below"]))
    places: list[FloatArray] = []
    while len(places) < n:
        way = rng.normal(size=3)
        place = way / np.linalg.norm(way) * radius * rng.uniform(0.8, 1.2)
        place[1] = radius * rng.uniform(0.9, 1.1) if where == "beside" else place[1]
        place[2] = {"over": abs(place[2]) + 0.3 * radius, "below": -abs(place[2]) / 2.0 - 100.0}.get(where, place[2])
        if all(np.linalg.norm(place - other) > 0.2 * radius for other in places):
            places.append(place)
    corners, size = int(rng.integers(3, min(n, 6) + 1)), rng.uniform(80.0, 300.0)
    turns = 2.0 * np.pi * np.arange(corners) / corners
    ring = np.column_stack([np.cos(turns), np.sin(turns), 0.4 * (-1.0) ** np.arange(corners)])
    body = size * (ring + 0.7 * rng.normal(size=(corners, 3)))
    points = [_point(i, place, rng) for i, place in enumerate(places, 1)]
    some = max(int(min(rng.choice([0, 1, 2, 3, n]), n)), min(n, CABLES_FOR_A_POSE - n))
    swivels = []
    for i in rng.choice(n, some, replace=False):
        points[i]["pulley_radius_mm"] = points[i]["pulley_radius_mm"] or 25.0
        off = {"eccentricity_deg": float(rng.uniform(0.0, 0.1)), "eccentricity_phase_deg": float(rng.uniform(-180.0, 180.0))}
        swivels.append(
            {"channel": f"sw{i + 1}", "point": f"B{i + 1}", "counts_per_revolution": int(rng.choice([2**13, 2**17, 2**19, 36000]))}
            | {"count_sign": int(rng.choice([-1, 1]))}
            | ZEROS[str(rng.choice(["known", *ZEROS]))](float(rng.uniform(-180.0, 180.0)))
            | (off if rng.random() < 0.15 else {})
        )
    inclined = rng.random() < 0.25
    level = [{"channel": f"inc{k}", "counts_per_revolution": 2**16, "axis": axis, "zero_deg": 0.0, "u_zero_deg": 0.01} for k, axis in
             enumerate(([1, 0, 0], [0, 1, 0]))]  # fmt: skip
    return {
        "schema": "lmeasure.rig/1",
        "unstated": "exact",
        "name": "drawn",
        "observation_point": points,
        "tool": {f"P{j}": row.tolist() for j, row in enumerate(body, 1)},
        "cable": [{"name": f"c{i}", "channel": f"ch{i}", "from": f"B{i}", "to": f"P{(i - 1) % corners + 1}"} for i in range(1, n + 1)],
        **({"swivel": swivels} if swivels else {}),
        **({"inclination": level} if inclined else {}),
    }


def _point(number: int, place: FloatArray, rng: np.random.Generator) -> dict[str, Any]:
    """An observation point whose guide leads about outwards and down."""
    out = place / np.linalg.norm(place) + 0.3 * rng.normal(size=3) - [0.0, 0.0, 0.3]
    out /= np.linalg.norm(out)
    alpha = float(np.degrees(np.arcsin(-out[2])))
    drum = {
        "counts_per_revolution": 6000,
        "count_length_mm": 0.012,
        "groove_pitch_mm": float(rng.choice([-1, 1]) * rng.uniform(0.5, 2.0)),
        "tangent_length_mm": float(rng.uniform(80.0, 300.0)),
        "axial_offset_mm": float(rng.uniform(-30.0, 30.0)),
        "count_sign": int(rng.choice([-1, 1])),
    }
    if rng.random() < 0.15:
        drum["run_out_mm"] = (0.02 * rng.normal(size=2)).tolist()
    if rng.random() < 0.15:
        drum["scale"] = float(rng.choice([0.5, 2.0, 4.0]))
    pulley = float(rng.choice([0.0, 20.0, rng.uniform(10.0, 60.0)]))
    eccentric = {"pulley_eccentricity_mm": (0.03 * rng.normal(size=2)).tolist()} if pulley and rng.random() < 0.15 else {}
    return {
        "name": f"B{number}",
        "position_mm": place.tolist(),
        "guide_alpha_deg": alpha if abs(alpha) < 80.0 else float(np.copysign(60.0, alpha)),
        "guide_beta_deg": float(np.degrees(np.arctan2(out[0], out[1]))),
        "pulley_radius_mm": pulley,
        "drum": drum,
        **eccentric,
    }


def true_rig(stated: dict[str, Any], rng: np.random.Generator) -> Rig:
    """The rig with zeros drawn from what is stated of them."""

    def drawn(e: dict[str, Any]) -> dict[str, Any]:
        if not e.get("absolute", True):
            return e
        zero = e["zero_deg"] + e["u_zero_deg"] * rng.normal() if "zero_deg" in e else rng.uniform(-180.0, 180.0)
        return {k: v for k, v in e.items() if k != "u_zero_deg"} | {"zero_deg": float(zero)}

    return rig_from_dict(stated | {kind: [drawn(e) for e in stated[kind]] for kind in ("swivel", "inclination") if kind in stated})


def draw(number: int) -> RunResult | None:
    """One run, or None where the drawn rig is none, or cannot make the motion."""
    rng = np.random.default_rng([number, 78])
    stated = drawn_rig(rng)
    time_s = np.arange(0.0, float(rng.choice([1.0, 3.0, 6.0])), 1.0 / float(rng.choice([50.0, 250.0, 1000.0])))
    size, way = np.repeat([0.2, 150.0], 3) * rng.uniform(0.2, 1.0, 6), rng.uniform(0.5, 2.0, (2, 6))
    begin = se3.displaced(HOME, np.repeat([0.1, 60.0], 3) * rng.uniform(-1.0, 1.0, 6))
    poses = se3.displaced(begin, size * (np.sin(way[0] * time_s[:, None]) + 0.3 * np.sin(3.0 * way[1] * time_s[:, None])))
    try:
        rig = rig_from_dict(stated)
        run = simulate_run(true_rig(stated, rng), time_s, poses, noise_mm=0.0, rng=rng).run
    except LMeasureError:
        return None
    angles = [*stated.get("swivel", ()), *stated.get("inclination", ())]
    absolute = sum(e.get("u_zero_deg", 9.0) < 1.0 for e in angles)
    start = str(rng.choice(["exact", "about", "none"] if absolute >= 3 and len(rig.observed) > CABLES_FOR_A_POSE else ["exact", "about"]))
    near = se3.displaced(poses[0], np.repeat(U_START[::-1], 3) * rng.normal(size=6))
    of_start: dict[str, Any] = {"exact": {"start": poses[0]}, "about": {"start": near, "u_start": U_START}, "none": {"start": None}}[start]
    rough = any(e.get("absolute", True) and e.get("u_zero_deg", 9.0) >= 1.0 for e in angles)
    group = GROUPS[2 if len(rig.observed) == CABLES_FOR_A_POSE else int(rough)]
    return _judged(replace(run, rig=rig, **of_start), poses, RunResult(number, group, start, "", np.nan, np.nan, np.nan, ""))


def _judged(run: Run, poses: FloatArray, as_drawn: RunResult) -> RunResult:
    try:
        found = reconstruct(run)
        good = np.flatnonzero(found.status == Status.OK)
        if not len(good):
            contradict = (found.status == Status.INCONSISTENT).any()
            return replace(as_drawn, end="contradicting" if contradict else "no pose", said="; ".join(map(str, found.notes[:2])))
        both = covariances(found, run)
    except LMeasureError as refused:
        return replace(as_drawn, end="start refused" if run.start is None else "refused", said=str(refused))
    covariance = both.random + both.factors @ np.swapaxes(both.factors, 1, 2)
    k = good[len(good) // 2]
    error = se3.displacement(found.poses[k : k + 1], poses[k : k + 1])[0]
    # at an exact start all that is common is nothing: in what is not known at all, to rounding, no error is looked for
    scale = np.repeat([1e-3, 1.0], 3)
    values, vectors = np.linalg.eigh(covariance[k] / np.outer(scale, scale))
    known = values > 1e-12 * values.max()
    square = float((((vectors.T @ (error / scale)) ** 2)[known] / values[known]).sum())
    end = "contradicting" if (found.status == Status.INCONSISTENT).any() else "whole" if len(good) == len(poses) else "in part"
    u_mm = float(np.sqrt(np.trace(covariance[k, 3:, 3:])))
    return replace(as_drawn, end=end, square=square, error_mm=float(np.linalg.norm(error[3:])), u_mm=u_mm)


def table(every: list[RunResult]) -> str:
    """The page of results."""
    lines = ["# Sound runs of drawn rigs", "", (__doc__ or "").split("\n\n")[2].strip(), ""]
    lines += [f"| channels | start | runs | {' | '.join(ENDS)} | held |", "|---|---|---|" + "---|" * (len(ENDS) + 1)]
    limit = chi2.ppf(0.95, 6)
    for group in GROUPS:
        for start in ("exact", "about", "none"):
            own = [d for d in every if d.group == group and d.start == start]
            if not own:
                continue
            ends = " | ".join(str(sum(d.end == end for d in own)) for end in ENDS)
            squares = [d.square for d in own if np.isfinite(d.square)]
            n = len(squares)
            low, high = (int(binom.ppf(q, n, 0.95)) for q in (0.005, 0.995))
            held = sum(s <= limit for s in squares)
            lines.append(f"| {group} | {start} | {len(own)} | {ends} | {held} of {n} ({low} to {high}) |")
    odd = [d for d in every if d.end in ("contradicting", "no pose", "refused") and d.group != GROUPS[2]]
    lines += ["", "Of redundant channels, what was refused:", "", *(f"- {d.number}, {d.start}: {d.said[:200]}" for d in odd)] if odd else []
    wide = [d for d in every if np.isfinite(d.square) and d.square > chi2.ppf(0.9999, 6)]
    lines += ["", "Beyond their 99.99 % region:", ""] if wide else []
    lines += [f"- {d.number}, {d.group}, {d.start}: off by {d.error_mm:.3g} mm, u {d.u_mm:.3g} mm, square {d.square:.3g}" for d in wide]
    return "\n".join([*lines, ""])


STUDY = Study("random_rigs", draw, table, "rigs", 200, record=RunResult)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
