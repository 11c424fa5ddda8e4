"""What becomes of a run when a counter errs: kinds of faults by rigs of six, seven and eight cables, silent, partly caught or caught.

    python benchmarks/faults.py --rigs 12 --keep faults.jsonl [--cables 6 7 8] [--limits False True] [--kind NAME ...] [--write]
    python benchmarks/faults.py --alarms 300 [--cables 7]

Rigs and counts come from an independent forward model (tests/helpers/real_rig.py); each rig is calibrated by twenty poses of a robot
(0.05 mm, 50
microradians) and then goes round five places twice, at 250 or 1000 samples a second, with one fault in one channel from a random moment
on. A sample is wrong when it is `ok` and its position errs by more than max(6 u, 0.05 mm). A run is silent when samples are wrong and
nothing is said of any, partly caught when samples are wrong and something is said, caught when none is wrong and something is said,
harmless when none is wrong and nothing is said. A fault is detectable when the best of the run's samples shows it, at a false-alarm rate of
1e-3 per run, with a power of 99.9 %; it is separable when leaving out any other cable is refuted likewise. Named: the
summary calls its cable faulty, and no other.
"""

import itertools
import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, ncx2
from study import Study

TESTS = Path(__file__).parent.parent / "tests"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from real_rig import Flaws  # noqa: E402
from real_world import Case, make  # noqa: E402

from lmeasure.calibration import calibrate  # noqa: E402
from lmeasure.recording import Counts, Run  # noqa: E402
from lmeasure.trajectory import RunModel, reconstruct, reconstruction_of  # noqa: E402

FloatArray = NDArray[np.float64]

COUNT_MM = 0.012
SIGNIFICANCE, POWER, JUDGED = 1e-3, 0.999, 40
DURATION_S, DWELL_S = 24.0, 0.4
LIMITS = {"max_cable_speed_mm_s": 2000.0, "max_cable_acceleration_mm_s2": 20000.0}


def motion(rng: np.random.Generator, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """(n,) times and (n, 7) poses of a robot that goes round five places, with ramps of speed, and rests at each."""
    places = np.vstack([np.zeros((1, 6)), np.column_stack([rng.uniform(-200, 200, (4, 3)), rng.uniform(-0.2, 0.2, (4, 3))])])
    acceleration, speed = rng.uniform(1000.0, 4000.0), rng.uniform(150.0, 400.0)
    parts, order = [np.repeat(places[:1], round(0.2 * rate_hz), axis=0)], [0, 1, 2, 3, 4] * 20
    for a, b in itertools.pairwise(order):
        length = float(np.linalg.norm(places[b, :3] - places[a, :3]))
        ramp = min(speed / acceleration, np.sqrt(length / acceleration))
        whole = length / (acceleration * ramp) + ramp
        t = np.arange(0.0, whole, 1.0 / rate_hz)
        gone = np.where(
            t < ramp,
            0.5 * acceleration * t**2,
            np.where(
                t < whole - ramp, acceleration * ramp * (t - 0.5 * ramp), length - 0.5 * acceleration * np.maximum(whole - t, 0.0) ** 2
            ),
        )
        parts += [
            places[a] + (gone / length)[:, None] * (places[b] - places[a]),
            np.repeat(places[b : b + 1], round(DWELL_S * rate_hz), axis=0),
        ]
        if b == 0 and sum(map(len, parts)) > DURATION_S * rate_hz:
            break
    way = np.vstack(parts)
    return np.arange(len(way)) / rate_hz, np.column_stack([way[:, :3], Rotation.from_rotvec(way[:, 3:]).as_quat()])


def _lost(recorded: FloatArray, j: int, i: int, counts: float, over: int) -> FloatArray:
    out = recorded.copy()
    out[i:, j] -= np.rint(counts * np.minimum(np.arange(1, len(out) - i + 1) / over, 1.0))
    return out


def spoiled(kind: str, recorded: FloatArray, t: FloatArray, j: int, i: int, rng: np.random.Generator) -> FloatArray:
    """The recorded counts (n, m) with a fault of channel j, from sample i on where it begins somewhere."""
    rate = 1.0 / (t[1] - t[0])
    out = recorded.copy()
    if kind == "bit 10 flipped once":
        out[i, j] = float(int(out[i, j]) ^ 1024)
    elif kind.endswith("counts lost at once"):
        out = _lost(recorded, j, i, float(kind.split()[0]), 1)
    elif kind.endswith("counts lost over 0.1 s"):
        out = _lost(recorded, j, i, float(kind.split()[0]), round(0.1 * rate))
    elif kind == "two channels swapped":
        k = (j + 1 + int(rng.integers(out.shape[1] - 1))) % out.shape[1]
        out[:, [j, k]] = out[:, [k, j]]
    elif kind == "one sign":
        out[:, j] *= -1
    elif kind == "all signs":
        out *= -1
    elif kind == "5 mm of slack for 1 s":
        n = round(rate)
        out[i : i + n, j] -= np.rint(5.0 / COUNT_MM * np.sin(np.pi * np.arange(n) / n))[: len(out) - i]
    elif kind == "frozen":
        out[i:, j] = out[i, j]
    elif kind == "1 ms late":
        out[:, j] = np.rint(np.interp(t - 1e-3, t, out[:, j]))
    elif kind == "zeroed 100 samples late":
        first = int(np.argmax(np.abs(np.diff(out[:, j])) > 0)) + 100
        out[:, j] -= out[first, j]
    elif kind == "scale 0.1 % off":
        out[:, j] = np.rint(out[:, j] * 1.001)
    elif kind == "narrow counter not stated":
        out = (out + 2.0**15) % 2.0**16 - 2.0**15
    elif kind == "a second jump later":
        out = _lost(_lost(recorded, j, i, 2000.0, 1), j, min(i + round(9.0 * rate), len(out) - 50), -900.0, 1)
    else:
        assert kind == "sound"
    return out


KINDS = (
    "bit 10 flipped once",
    *(f"{n} counts lost at once" for n in (100, 1000, 6000)),
    *(f"{n} counts lost over 0.1 s" for n in (100, 1000, 6000)),
    "two channels swapped",
    "one sign",
    "all signs",
    "5 mm of slack for 1 s",
    "frozen",
    "1 ms late",
    "zeroed 100 samples late",
    "scale 0.1 % off",
    "narrow counter not stated",
    "a second jump later",
)
OF_SEVERAL = ("two channels swapped", "all signs", "narrow counter not stated")


class Cell:
    """A calibrated rig of some cables, and a sound run of it."""

    def __init__(self, seed: int, cables: int, limits: bool) -> None:
        rng = np.random.default_rng([seed, cables, 3])
        made = make(Case(Flaws()), seed, cables=cables)
        result = calibrate(made.campaign)
        rig = result.rig.model_copy(update={"calibration": None})
        if limits:
            points = [p.model_copy(update={"drum": p.drum.model_copy(update=LIMITS)}) for p in rig.observation_point]
            rig = rig.model_copy(update={"observation_point": tuple(points)})
        self.rig, self.record, self.truth = rig, result.record, made.truth
        self.rate = 1000.0 if seed % 2 else 250.0
        self.time_s, self.poses = motion(rng, self.rate)
        phase = rng.uniform(-0.5, 0.5, cables)
        self.recorded = self.truth.counts(self.poses, self.poses[0], None, 0.0, phase)

    def run(self, recorded: FloatArray) -> Run:
        """A run with these recorded counts."""
        counts = Counts(self.time_s, tuple(c.channel for c in self.rig.cable), recorded)
        return Run(self.rig, self.poses[0], (counts,), self.record, unstated="exact")


def errors_mm(found: Any, poses: FloatArray) -> FloatArray:
    """(n,) distances of the tool's place from the truth."""
    return np.asarray(np.linalg.norm(found.poses[:, :3] - poses[:, :3], axis=1))


def words(found: Any) -> FloatArray:
    """(n,) statuses in words."""
    return np.asarray(found.columns()["status"])


def named(found: Any) -> set[str]:
    """Numbers of the cables that the summary calls faulty."""
    reported = re.findall(r"channel ch(\d+) (?:stepped|stands|stood|does not)|cable c(\d+) does not", " ".join(map(str, found.notes)))
    return {one or other for one, other in reported} | {
        n.removeprefix("c") for names in found.cable[words(found) == "ok"] for n in names.split(", ") if n
    }


cell_of = lru_cache(1)(Cell)


def study(seed: int, cables: int, limits: bool, kind: str) -> dict[str, object]:
    """One fault in one run of a cell."""
    cell = cell_of(seed, cables, limits)
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    m = cell.recorded.shape[1]
    j = int(rng.integers(m))
    i = int(rng.integers(round(0.15 * len(cell.time_s)), round(0.6 * len(cell.time_s))))
    recorded = spoiled(kind, cell.recorded, cell.time_s, j, i, rng)
    found = reconstruct(cell.run(recorded))
    ok = words(found) == "ok"
    u = np.linalg.norm(found.u[:, :3], axis=1)
    with np.errstate(invalid="ignore"):
        wrong = ok & (errors_mm(found, cell.poses) > np.maximum(6.0 * u, 0.05))
    names = {name for cable in found.cable[ok] for name in cable.split(", ") if name}
    said = bool((~ok).any() or names or any("suspected" in str(cause) for cause in found.cause))
    outcome = ("partly" if said else "silent") if wrong.any() else ("caught" if said else "harmless")
    detectable, separable = power(cell, recorded, j if kind not in OF_SEVERAL else None)
    return {
        "cables": m,
        "seed": seed,
        "kind": kind,
        "cable": cell.rig.cable[j].name,
        "outcome": outcome,
        "wrong": float(wrong.mean()),
        "ok": float(ok.mean()),
        "worst_mm": float(np.nanmax(np.where(ok, errors_mm(found, cell.poses), 0.0))),
        "named": named(found) == {str(j + 1)} and kind not in OF_SEVERAL,
        "left_out": ", ".join(sorted(names)),
        "detectable": detectable,
        "separable": separable,
        "limits": limits,
    }


def power(cell: Cell, recorded: FloatArray, j: int | None) -> tuple[bool, bool]:
    """Whether a fault can be detected, and told from one of any other cable."""
    m = cell.recorded.shape[1]
    if m == 6:
        return False, False
    from lmeasure.sensors import changes_from_counts, lengths_from_counts
    from lmeasure.trajectory import Redundancy

    reconstruction = reconstruction_of(RunModel(cell.rig, cell.poses[0], cell.record))
    redundancy = Redundancy(reconstruction.budget)
    some = np.unique(np.concatenate([np.arange(0, len(cell.time_s), 5), np.flatnonzero((recorded != cell.recorded).any(axis=1))[:50]]))
    epochs = redundancy.epochs(lengths_from_counts(cell.run(cell.recorded)), None).at(some)
    drums = [p.drum for p in cell.rig.observation_point]
    signs = np.array([d.count_sign / d.scale for d in drums])
    shown, true = recorded[some].copy(), cell.recorded[some]
    if np.abs(np.diff(recorded, axis=0)).max() > 40000:  # wraps, which are undone
        shown = true
    error = changes_from_counts(cell.rig, shown * signs) - changes_from_counts(cell.rig, true * signs)

    def largest(used: NDArray[np.bool_]) -> float:
        weight = redundancy.parities(epochs, cell.poses[some], used).weight
        return float(np.einsum("nj,njk,nk->n", error, weight, error).max())

    def shows(noncentrality: float, freedom: int, significance: float) -> bool:
        return bool(ncx2.sf(chi2.isf(significance, freedom), freedom, noncentrality) >= POWER) if freedom > 0 else False

    every = np.ones((len(some), m), np.bool_)
    detectable = shows(largest(every), m - 6, SIGNIFICANCE / len(cell.time_s))
    if j is None or not detectable:
        return detectable, False
    without = [every & (np.arange(m) != k) for k in range(m) if k != j]
    return detectable, all(shows(largest(used), m - 7, SIGNIFICANCE / 2.0 / JUDGED) for used in without)


def alarm(seed: int, cables: int) -> str:
    """Return the summary of a sound run that is called anything else."""
    cell = Cell(seed, cables, limits=False)
    found = reconstruct(cell.run(cell.recorded))
    alarmed = (words(found) != "ok").any() or set(found.cable) != {""}
    return f"rig {seed}, {cables} cables: {found.summary()}" if alarmed else ""


def alarms(found: list[str]) -> str:
    """Return how many of the sound runs are called anything else, and which."""
    return "\n".join([f"{sum(map(bool, found))} of {len(found)} sound runs alarmed", *filter(None, found)])


def _shares(data: pd.DataFrame) -> str:
    """Silent, partly and caught (with harmless) runs of a group, out of all."""
    if not len(data):
        return ""
    counts = data.outcome.value_counts()
    return " / ".join(str(counts.get(name, 0)) for name in ("silent", "partly")) + f" / {counts.get('caught', 0)} of {len(data)}"


def table(found: list[dict[str, Any]]) -> str:
    """The page of results."""
    data = pd.DataFrame(found)
    columns = [("6", 6, False), ("6, limits stated", 6, True), ("7", 7, False), ("8", 8, False)]
    head = [name for name, *_ in columns]
    lines = [
        "# What becomes of a run when a counter errs",
        "",
        "`python benchmarks/faults.py`: runs that stay silent / are partly caught / are caught, of all with that fault. The rest were",
        "harmless: no sample was wrong and nothing was said. Wrong: `ok`, and off by more than max(6 u, 0.05 mm).",
        "",
        f"| kind | {' | '.join(head)} |",
        f"|---|{'---|' * len(head)}",
    ]
    for kind in KINDS:
        cells = [_shares(data[(data.kind == kind) & (data.cables == cables) & (data.limits == limits)]) for _, cables, limits in columns]
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    lines.append("")
    for _, cables, limits in columns:
        of = data[(data.cables == cables) & (data.limits == limits)]
        if len(of):
            share = (of.outcome == "silent").mean()
            rigs = f"{cables} cables{', limits stated' if limits else ''}"
            lines.append(f"- {rigs}: {share:.0%} of {len(of)} runs silent, {of.wrong.mean():.1%} of samples wrong.")
    eight = data[data.cables == 8]
    for cables in (7, 8):
        of = data[(data.cables == cables) & data.detectable]
        if len(of):
            silent, partly = ((of.outcome == name).sum() for name in ("silent", "partly"))
            lines.append(f"- Of {len(of)} faults of {cables} cables that can be detected {silent} stay silent, {partly} are partly caught.")
    separable = eight[eight.separable]
    if len(separable):
        worse = ((~eight.separable & eight.detectable) & eight.outcome.isin(["silent", "partly"])).sum()
        lines.append(
            f"- Of {len(separable)} faults of eight cables that can be told from others' {separable.named.sum()} are named rightly."
        )
        lines.append(f"- Of {(~eight.separable & eight.detectable).sum()} that cannot, {worse} have a sample that is wrong and `ok`.")
    return "\n".join(lines)


STUDY = Study(
    "faults", study, table, "rigs", 12, {"cables": (6, 7, 8), "limits": (False, True), "kind": KINDS}, "{cables} {limits} {seed} {kind}"
)
ALARMS = Study("faults", alarm, alarms, "alarms", 300, {"cables": (6, 7, 8)})

if __name__ == "__main__":
    sys.exit((ALARMS if "--alarms" in sys.argv else STUDY).command(__doc__))
