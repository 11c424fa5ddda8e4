"""Single faults of drawn sizes in runs of six drums with six swivel encoders, and of eight drums: found, named, restored, or not.

    python benchmarks/single_faults.py --rig 6+6 --faults 500 --keep faults.jsonl [--write]     (goes on from what is kept)

Each cell, drawn anew for every 20 faults, is a rig, a motion of 4 s at 250 Hz and phases of its counters; its start is stated. A fault is
of one channel, at a drawn time, of a size drawn evenly in its logarithm from the smallest that a single sample shows there (Baarda) to a
turn. Detectable: some sample contradicts itself beyond the alarm's limit with a probability of 99.9 %, whatever else is found; separable:
it does with any other channel left out. Rigs are those of the forward model, known exactly.

Missed detections, as they are stated before a fault is made: of every sample that errs, the chance that it gives no alarm by itself (non-
central chi-squared), times the chance that the error, left in, brings the place beyond its 99.9 % region. What is found besides is that
a fault is judged over its run.
"""

import sys
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, chi2, ncx2
from study import Asked, Study

from lmeasure.core import Status, se3
from lmeasure.rig import Cable, Rig, rig_from_dict
from lmeasure.sensors import lengths_from_counts
from lmeasure.simulation import cell_rig, simulate_run
from lmeasure.text import is_of
from lmeasure.trajectory import RESTORED_ORIGIN, Redundancy, RunModel, Situation, Trajectory, reconstruct, reconstruction_of
from lmeasure.trajectory.faults.consistency import JUDGED, SIGNIFICANCE
from lmeasure.trajectory.faults.redundancy import Reliability, reliability

FloatArray = NDArray[np.float64]
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TIME_S = np.arange(0.0, 4.0, 0.004)
CODES = 2**17
RIGS = ("6+6", "8")
KINDS = ("jump", "slip", "hang", "frozen", "spike")
A_CELL = 20
POWER = 0.999
REGION = 0.999


@dataclass(frozen=True)
class Found:
    """What became of a fault. sizes in units of the smallest that is detected; outside: `ok` samples beyond their 99.9 % region; missed: as
    many as are stated to be there by missed detections."""

    rig: str
    number: int
    kind: str
    channel: str
    size: float
    detectable: bool
    separable: bool
    alarmed: bool
    named: bool
    misnamed: bool
    restored: bool
    ok: int
    outside: int
    missed: float
    samples: int


def rig_of(name: str, rng: np.random.Generator) -> Rig:
    """A cell of six drums and six encoders, or of eight drums."""
    data = cell_rig(int(rng.integers(1, 1000))).to_dict()
    if name == "6+6":
        data["swivel"] = [
            {
                "point": f"B{i}",
                "channel": f"sw{i}",
                "counts_per_revolution": CODES,
                "zero_deg": float(rng.uniform(-180, 180)),
                "u_zero_deg": 0.0,
            }
            for i in range(1, 7)
        ]
        return rig_from_dict(data)
    for i, like in ((7, 1), (8, 4)):
        point = dict(data["observation_point"][like - 1])
        at = np.array(point["position_mm"]) * [-1.0, -1.0, 1.0] + rng.uniform(-150.0, 150.0, 3)
        point |= {"name": f"B{i}", "position_mm": at.tolist(), "guide_beta_deg": float(np.degrees(np.arctan2(at[0], at[1])))}
        point["guide_alpha_deg"] = float(np.degrees(np.arctan2(-at[2], np.hypot(at[0], at[1]))))
        data["observation_point"].append(point)
        used = sorted({c["to"] for c in data["cable"]})
        data["cable"].append({"name": f"c{i}", "channel": f"ch{i}", "from": f"B{i}", "to": used[i % len(used)]})
    return rig_from_dict(data)


class Cell:
    """A rig, a motion, the counts of a sound run, and what they can show."""

    def __init__(self, name: str, number: int) -> None:
        rng = np.random.default_rng([number, RIGS.index(name)])
        rig = rig_of(name, rng)
        size, way = np.repeat([0.2, 150.0], 3) * rng.uniform(0.3, 1.0, 6), rng.uniform(0.6, 1.8, (2, 6))
        swing = np.sin(way[0] * TIME_S[:, None]) + 0.4 * np.sin(3.0 * way[1] * TIME_S[:, None])
        self.poses = se3.displaced(HOME, size * swing * rng.choice([-1.0, 1.0], 6))
        self.run = simulate_run(rig, TIME_S, self.poses, noise_mm=0.0, rng=rng).run
        self._reconstruction = reconstruction_of(RunModel(rig, self.poses[0]))
        self.redundancy = Redundancy(self._reconstruction.budget)
        self.epochs = self.redundancy.epochs(lengths_from_counts(self.run), None)
        self.per_count = np.array([rig.counter(o).per_count for o in rig.observed])

    @cached_property
    def reliability(self) -> Reliability:
        """Of all samples."""
        return reliability(self.redundancy, self.epochs, self.poses)

    @cached_property
    def covariance(self) -> FloatArray:
        """(n, 3, 3) of the places."""
        counts = self.epochs.counts
        errors = self._reconstruction.budget.of(Situation(TIME_S, self.poses, counts, np.zeros_like(counts)))
        return np.asarray((errors.random + errors.systematic)[:, 3:, 3:])

    @cached_property
    def ways(self) -> FloatArray:
        """(n, 3, m) of the place, by errors of the readings."""
        counts = self.epochs.counts
        return self._reconstruction.budget.twists(self.poses, counts, np.zeros(counts.shape, np.bool_), compiled=True)[:, 3:]

    @cached_property
    def alarm(self) -> float:
        """Chi-squared of a sample from which a run has an alarm."""
        return self._limit(np.ones(len(self.per_count), np.bool_), SIGNIFICANCE / len(TIME_S))

    @cached_property
    def without(self) -> list[float]:
        """Chi-squared of a sample from which what is left without each channel is none of chance."""
        m = len(self.per_count)
        return [self._limit(np.arange(m) != k, SIGNIFICANCE / 2.0 / JUDGED) for k in range(m)]

    def _limit(self, used: NDArray[np.bool_], chance: float) -> float:
        """Of chi-squared of some channels, that a sound sample exceeds with this chance."""
        return self.redundancy.chance(self.epochs, self.poses, used).limit(chance)


@lru_cache(maxsize=2)
def cell(name: str, number: int) -> Cell:
    """Warm for the faults of one rig."""
    return Cell(name, number)


def fault(kind: str, size: float, i: int, rng: np.random.Generator, codes: FloatArray) -> FloatArray:
    """(n,) counts that are added, of a size in counts, from sample i on."""
    n, behind = len(TIME_S), np.arange(len(TIME_S)) - i
    if kind == "jump":
        return np.where(behind >= 0, round(size), 0.0)
    if kind == "slip":
        return np.rint(size * np.clip((behind + 1) / 25.0, 0.0, 1.0))
    if kind == "hang":
        return np.where((behind >= 0) & (behind < 250), np.rint(size * np.sin(np.pi * behind / 250.0)), 0.0)
    if kind == "spike":
        return np.where(behind == 0, round(size), 0.0)
    until = min(i + int(rng.integers(50, 500)), n)
    return np.where((behind >= 0) & (np.arange(n) < until), codes[i] - codes, 0.0)


def shows(noncentrality: float, freedom: int, limit: float) -> bool:
    """Whether a contradiction of this size alarms nearly always."""
    return bool(ncx2.sf(limit, freedom, noncentrality) >= POWER)


def judged(at: Cell, j: int, error: FloatArray) -> tuple[bool, bool, float]:
    """Whether errors (n,) of a channel's readings can be detected, and told from those of every other, and at how many samples they are
    missed and bring the place beyond its region."""
    some = np.unique(np.concatenate([np.flatnonzero(error)[:: max(1, np.count_nonzero(error) // 60)], [int(np.argmax(np.abs(error)))]]))
    m, epochs, e = len(at.per_count), at.epochs.at(some), error[some]

    def shown(used: NDArray[np.bool_]) -> FloatArray:
        return np.asarray(e**2 * at.redundancy.parities(epochs, at.poses[some], used).weight[:, j, j])

    every = np.ones((len(some), m), np.bool_)
    of_all, off = shown(every), at.ways[some, :, j] * e[:, None]
    beyond = np.einsum("ni,ni->n", off, np.linalg.solve(at.covariance[some], off[:, :, None])[:, :, 0])
    chance = ncx2.cdf(at.alarm, m - 6, of_all) * ncx2.sf(chi2.isf(1.0 - REGION, 3), 3, beyond)
    missed = float(chance.mean() * np.count_nonzero(error))
    if not shows(float(of_all.max()), m - 6, at.alarm):
        return False, False, missed
    apart = (shows(float(shown(every & (np.arange(m) != k)).max()), m - 7, at.without[k]) for k in range(m) if k != j)
    return True, all(apart), missed


def study(number: int, name: str) -> Found:
    """One fault."""
    at, rng = cell(name, number // A_CELL), np.random.default_rng([number, 7])
    rig, counts = at.run.rig, at.run.passes[0]
    m, kind = len(at.per_count), KINDS[number % len(KINDS)]
    j, i = int(rng.integers(m)), int(rng.integers(150, 800))
    o = rig.observed[j]
    least = float(at.reliability.smallest[i, j]) / at.per_count[j]
    turn = CODES / 2.0 if not isinstance(o, Cable) else 6000.0
    size = float(np.exp(rng.uniform(np.log(min(least, turn)), np.log(turn)))) * rng.choice([-1.0, 1.0])
    added = fault(kind, size, i, rng, counts.recorded[:, j])
    recorded = counts.recorded.copy()
    recorded[:, j] += added
    if not isinstance(o, Cable):
        added = (added + CODES / 2.0) % CODES - CODES / 2.0
        recorded[:, j] %= CODES
    detectable, separable, missed = judged(at, j, added * at.per_count[j]) if added.any() else (False, False, 0.0)
    found = reconstruct(replace(at.run, passes=(replace(counts, recorded=recorded),)))
    ok = found.status == Status.OK
    reported = {name for cable in found.cable[ok] for name in cable.split(", ") if name}
    reported |= {
        p.name
        for p in rig.observed
        for note in found.notes
        if getattr(note, "code", "").startswith("origin.restored") and f" {p.name} " in f" {note} "
    }
    reported |= {
        p.name
        for p in rig.observed
        for note in found.notes
        if f"channel {p.channel} " in str(note) and not getattr(note, "code", "").startswith("steps.")
    }
    last = np.array([is_of(cause, RESTORED_ORIGIN) for cause in found.cause[-50:]])
    return Found(
        name, number, kind, o.name, abs(size) / least, detectable, separable, bool((~ok).any() or reported), reported == {o.name},
        bool(reported - {o.name}), bool(last.all()), int(ok.sum()), outside(found, at.poses), missed, len(ok),
    )  # fmt: skip


def outside(found: Trajectory, poses: FloatArray) -> int:
    """`ok` samples whose place is beyond its 99.9 % region."""
    ok = found.status == Status.OK
    error = found.poses[ok, :3] - poses[ok, :3]
    covariance = (found.random + found.systematic)[ok][:, 3:, 3:]
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return int((square > chi2.isf(1.0 - REGION, 3)).sum())


def share(part: int, of: int) -> str:
    """In per cent, with the Clopper-Pearson interval of 95 %."""
    if not of:
        return "none"
    low = beta.ppf(0.025, part, of - part + 1) if part else 0.0
    high = beta.ppf(0.975, part + 1, of - part) if part < of else 1.0
    return f"{100 * part / of:.2f} % of {of} ({100 * low:.2f} to {100 * high:.2f})"


def table(every: list[Found]) -> str:
    """The page of results."""
    lines = ["# Single faults", "", (__doc__ or "").split("\n\n", 2)[2].strip(), ""]
    for name in RIGS:
        mine = [f for f in every if f.rig == name]
        if not mine:
            continue
        separable, jumps = [f for f in mine if f.separable], [f for f in mine if f.separable and f.kind in ("jump", "slip")]
        drums = [f for f in jumps if f.channel.startswith("c")]
        blurred = [f for f in mine if f.detectable and not f.separable]
        lines += [
            f"## {name}: {len(mine):,} faults, {sum(f.detectable for f in mine):,} detectable, {len(separable):,} separable",
            "",
            f"- separable and named alone: {share(sum(f.named for f in separable), len(separable))}",
            f"- separable and another channel named: {share(sum(f.misnamed for f in separable), len(separable))}",
            f"- separable jumps and slips of drums that go on restored: {share(sum(f.restored for f in drums), len(drums))}",
            f"- detectable, not separable, and said: {share(sum(f.alarmed for f in blurred), len(blurred))}",
            *beyond(mine),
            "",
            "| kind | detectable | said | separable | named | another named |",
            "|---|---|---|---|---|---|",
        ]
        for kind in KINDS:
            of = [f for f in mine if f.kind == kind]
            seen, apart = [f for f in of if f.detectable], [f for f in of if f.separable]
            figures = len(seen), sum(f.alarmed for f in seen), len(apart), sum(f.named for f in apart), sum(f.misnamed for f in apart)
            lines.append(f"| {kind} | {' | '.join(map(str, figures))} |")
        lines.append("")
    return "\n".join(lines)


def beyond(faults: list[Found]) -> list[str]:
    """Of `ok` samples that are beyond their region, of faults that can be detected and of others, against what is stated."""
    lines = [
        "",
        "| `ok` samples beyond their region | of `ok` | part | of the region | by missed detections | asked at most |",
        "|---|---|---|---|---|---|",
    ]
    groups = (
        ("all faults", faults),
        *((f"{word}detectable", [f for f in faults if f.detectable == seen]) for word, seen in (("", True), ("un", False))),
    )
    for name, some in groups:
        ok, wrong, missed = sum(f.ok for f in some), sum(f.outside for f in some), sum(f.missed for f in some)
        if ok:
            of_region = (1.0 - REGION) * ok
            parts = (wrong, of_region, missed, of_region + missed)
            lines.append(f"| {name}: {wrong:,} | {ok:,} | " + " | ".join(f"{100 * part / ok:.3f} %" for part in parts) + " |")
    return [*lines, ""]


def rigs_of(asked: Asked, seed: int) -> list[tuple[str]]:
    """Return every rig, if the kind of this seed is asked for."""
    return [(rig,) for rig in asked.rig if KINDS[seed % len(KINDS)] in asked.kind]


STUDY = Study(
    "single_faults", study, table, "faults", factors={"rig": RIGS, "kind": KINDS}, key="{rig} {seed}", cases=rigs_of, record=Found
)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
