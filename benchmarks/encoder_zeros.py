"""Four drums and four swivel encoders: does the uncertainty grow with that of the encoders' zeros, and is it right?

    python benchmarks/encoder_zeros.py --rigs 200 --keep benchmarks/results/encoder_zeros.jsonl [--starts about none] [--write]

Each draw is a cell of four drums, zeroed anywhere within a count, with absolute encoders of 17 bits on their swivels. Its motion is sampled
at 50 Hz for 5 s, or for 10 s without a start. Zeros are drawn from their stated uncertainty, 0.01 to 2 degrees, by the same draw at all
levels. The start is stated to 0.5 mm and 1 mrad (about), or not at all (none). Drums c1, c3 and c5 are in every cell. A fourth
drum c4 keeps the cell far from singular poses. With c2 or c6 the worst pressure angle is above 70 degrees on most of the way. Half of
their motions of 5 s, and four of five of those of 10 s, pass 88 degrees. Behind such a pose no sample is used.

Whole: every sample has a pose; in part: some; refused: none. Held: whether the pose of one sample in the middle lies in its 95 % region.
u: standard uncertainty of its position, median of the runs that are whole at all levels. Not falling: number of these runs whose u never
falls by more than 5 % from a level to a higher one.
"""

import sys
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binom, chi2
from study import Study

from lmeasure.core import LMeasureError, Status, se3
from lmeasure.recording import Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig, simulate_run
from lmeasure.trajectory import reconstruct

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
LASTS_S = {"about": 5.0, "none": 10.0}
LEVELS_DEG = (0.01, 0.05, 0.3, 1.0, 2.0)
U_START = (0.5, 0.001)
STARTS = tuple(LASTS_S)


FOURTH = {"c4": (3,), "c2 or c6": (1, 5)}
"""Fourth drums by their effect on the cell: indices of its cables."""


@dataclass(frozen=True)
class ZeroResult:
    """Hold the share of samples with a pose, and of one its squared error in units of its covariance, and its u [mm]."""

    number: int
    start: str
    level_deg: float
    share: float
    square: float = np.nan
    u_mm: float = np.nan


def cell_of(number: int) -> tuple[int, int]:
    """Return the seed of a cell, and the index of its fourth drum."""
    rng = np.random.default_rng([number, 5])
    return int(rng.integers(1, 1000)), int(rng.choice([1, 3, 5]))


def rig_with(number: int, zeros_deg: np.ndarray, u_deg: float) -> Rig:
    """Return four drums of a cell, all three points of the tool among them, and their encoders."""
    seed, fourth = cell_of(number)
    data = cell_rig(seed).to_dict()
    data["cable"] = [data["cable"][i] for i in (0, 2, 4, fourth)]
    of = [cable["from"] for cable in data["cable"]]
    data["observation_point"] = [point for point in data["observation_point"] if point["name"] in of]
    common = {"counts_per_revolution": 2**17, "u_zero_deg": u_deg}
    swivels = [{"point": p, "channel": f"sw{p}", "zero_deg": float(z), **common} for p, z in zip(of, zeros_deg, strict=True)]
    return rig_from_dict(data | {"swivel": swivels})


def drawn_run(number: int, start: str, u_deg: float) -> tuple[Run, np.ndarray]:
    """A run and its true poses."""
    rng, time_s = np.random.default_rng([number, 6]), np.arange(0.0, LASTS_S[start], 0.02)
    zeros, off = rng.uniform(-180.0, 180.0, 4), rng.standard_normal(4)
    size, way = np.repeat([0.2, 150.0], 3) * rng.uniform(0.4, 1.0, 6), rng.uniform(1.0, 2.5, (2, 6))
    begin = se3.displaced(HOME, np.repeat([0.1, 80.0], 3) * rng.uniform(-1.0, 1.0, 6))
    poses = se3.displaced(begin, size * (np.sin(way[0] * time_s[:, None]) + 0.4 * np.sin(3.0 * way[1] * time_s[:, None])))
    near = se3.displaced(poses[0], np.repeat(U_START[::-1], 3) * rng.normal(size=6))
    run = simulate_run(rig_with(number, zeros + u_deg * off, u_deg), time_s, poses, noise_mm=0.0, rng=rng).run
    run = replace(run, rig=rig_with(number, zeros, u_deg), start=None)
    return (replace(run, start=near, u_start=U_START) if start == "about" else run), poses


def draw(number: int, start: str, level_deg: float) -> ZeroResult:
    """One run."""
    run, poses = drawn_run(number, start, level_deg)
    try:
        found = reconstruct(run)
    except LMeasureError:
        return ZeroResult(number, start, level_deg, 0.0)
    good = np.flatnonzero(found.status == Status.OK)
    if not len(good):
        return ZeroResult(number, start, level_deg, 0.0)
    k = good[len(good) // 2]
    covariance = found.random[k] + found.systematic[k]
    error = se3.displacement(found.poses[k : k + 1], poses[k : k + 1])[0]
    square, u_mm = float(error @ np.linalg.solve(covariance, error)), float(np.sqrt(np.trace(covariance[3:, 3:])))
    return ZeroResult(number, start, level_deg, len(good) / len(poses), square, u_mm)


def table(every: list[ZeroResult]) -> str:
    """Return the page of results."""
    about = "\n\n".join((__doc__ or "").split("\n\n")[2:])
    lines = ["# Zeros of encoders that poses need", "", about.strip(), ""]
    lines += ["| start | fourth drum | u of zeros [deg] | runs | whole | in part | refused | samples ok | held | consistent | u [mm] |"]
    lines += ["|" + "---|" * 11]
    ends = []
    for start in STARTS:
        by = {(d.number, d.level_deg): d for d in every if d.start == start}
        complete = sorted({n for n, _ in by if all((n, level) in by for level in LEVELS_DEG)})
        for fourth, drums in FOURTH.items():
            numbers = [n for n in complete if cell_of(n)[1] in drums]
            whole = [n for n in numbers if all(by[n, level].share == 1.0 for level in LEVELS_DEG)]
            for level in LEVELS_DEG if numbers else ():
                own = [by[n, level] for n in numbers]
                shares = np.array([d.share for d in own])
                squares = [d.square for d in own if np.isfinite(d.square)]
                held = sum(s <= chi2.ppf(0.95, 6) for s in squares)
                low, high = (int(binom.ppf(q, len(squares), 0.95)) for q in (0.005, 0.995))
                u = f"{np.median([by[n, level].u_mm for n in whole]):.4f}" if whole else ""
                ended = (shares == 1.0).sum(), ((shares > 0.0) & (shares < 1.0)).sum(), (shares == 0.0).sum()
                lines.append(
                    f"| {start} | {fourth} | {level:g} | {len(own)} | {' | '.join(map(str, ended))} | {shares.mean():.1%} | "
                    f"{held} of {len(squares)} | {low} to {high} | {u} |"
                )
            us = np.array([[by[n, level].u_mm for level in LEVELS_DEG] for n in whole]).reshape(-1, len(LEVELS_DEG))
            falling = int((us[:, 1:] >= 0.95 * us[:, :-1]).all(axis=1).sum())
            ends.append(f"Start {start}, fourth drum {fourth}: not falling {falling} of {len(us)}.")
    return "\n".join([*lines, "", *ends, ""])


STUDY = Study(
    "encoder_zeros", draw, table, "rigs", 200, {"starts": STARTS, "levels": LEVELS_DEG}, "{seed} {starts} {levels}", record=ZeroResult
)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
