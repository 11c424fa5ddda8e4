"""Simulated robots corrected: measured, identified, told corrected joint values, measured again; improvement and what is left.

    python benchmarks/correction.py [--robots 200]

Every parameter of the links errs by 0.3 mm and 0.5 mrad, the robot repeats to 0.02 mm in each coordinate, the instrument adds 0.01 mm.
Identified from 100 places; 40 others are visited 30 times each, before and after correction. AP is the distance of the mean from where
the nominal robot would be, seen from where the robot was found to stand. Its floor is what repeatability over the root of the cycles and
what is not known of the robot leave: the mean of |N(0, covariance)| of both together. Writes benchmarks/results/correction.md.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from lmeasure import se3
from lmeasure.robots.correction import Limits, correct
from lmeasure.robots.identify import Settings, identify, predict
from lmeasure.robots.measurements import measured
from lmeasure.robots.robot import shipped

RESULTS = Path(__file__).parent / "results" / "correction.md"
SIZES = {"theta_deg": 5e-4, "alpha_deg": 5e-4, "beta_deg": 5e-4, "d_mm": 0.3, "a_mm": 0.3}
REPEAT_MM, INSTRUMENT_MM, ROWS, TARGETS, CYCLES = 0.02, 0.01, 100, 40, 30
BASE = np.array([1000.0, 50.0, -30.0, 0.0, 0.0, np.sin(0.6), np.cos(0.6)])
TOOL = np.array([10.0, 20.0, 150.0, 0.0, 0.0, 0.0, 1.0])


def one(name: str, seed: int) -> tuple[float, float, float, int, int, int]:
    """Mean AP before, after, and its floor [mm]; targets corrected, refused, and how many within u95 of single visits."""
    rng, nominal = np.random.default_rng([seed, len(name)]), shipped(name).model
    true = nominal.moved(np.array([rng.normal() * SIZES.get(p.name.rpartition(".")[2], 0.0) for p in nominal.parameters]))
    low, high = nominal.limits
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    reach = np.minimum(half, 2.0) * 0.9

    def seen(q: np.ndarray) -> np.ndarray:
        return np.asarray(se3.compose(se3.compose(BASE, true.forward(q)), np.broadcast_to(TOOL, (len(q), 7)))[:, :3])

    q = middle + rng.uniform(-reach, reach, (ROWS, len(low)))
    noise = float(np.hypot(REPEAT_MM, INSTRUMENT_MM))
    found = identify(nominal, measured(q, seen(q) + rng.normal(0.0, noise, (ROWS, 3))), Settings())
    targets = middle + rng.uniform(-reach, reach, (TARGETS, len(low)))
    done = [correct(nominal, found.state.robot, t, Limits()) for t in targets]
    kept = np.array([not c.refused for c in done])
    targets, solved = targets[kept], np.array([c.joints for c in done])[kept]
    base, tool = found.state.base, found.state.targets[0]
    wanted = se3.compose(se3.compose(base, nominal.forward(targets)), np.broadcast_to(tool, (len(targets), 7)))[:, :3]
    mean = rng.normal(0.0, noise / np.sqrt(CYCLES), (2, len(targets), 3))
    before, after = (np.linalg.norm(seen(p) + m - wanted, axis=1) for p, m in zip((targets, solved), mean, strict=True))
    told = predict(found, solved)
    own = told.covariance - (found.noise.position_mm**2) * found.shape * found.misfit**2
    spread = own + noise**2 / CYCLES * np.eye(3)
    draws = np.einsum("nij,knj->kni", np.linalg.cholesky(spread + 1e-12 * np.eye(3)), rng.normal(size=(400, len(targets), 3)))
    floor = np.linalg.norm(draws, axis=2).mean()
    single = np.linalg.norm(seen(solved) + rng.normal(0.0, noise, (len(targets), 3)) - wanted, axis=1)
    return float(before.mean()), float(after.mean()), float(floor), int(kept.sum()), int((~kept).sum()), int((single < told.u95_mm).sum())


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, default=200)
    robots = parser.parse_args().robots
    lines = [
        "# Corrected robots",
        "",
        f"`python benchmarks/correction.py --robots {robots}`: {ROWS} places measured, {TARGETS} others corrected, per robot.",
        "",
        "| robot | robots | AP before | after | floor, mm | after / floor | improvement: least, median, most | refused | in u95 |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in ("generic6", "generic7"):
        rows = np.array([one(name, seed) for seed in range(robots)])
        before, after, floor, kept, refused, inside = rows.T
        ratio = before / after
        share = inside.sum() / kept.sum()
        lines.append(
            f"| {name} | {robots} | {before.mean():.3f} | {after.mean():.4f} | {floor.mean():.4f} | {after.mean() / floor.mean():.2f} "
            f"| {ratio.min():.0f}, {np.median(ratio):.0f}, {ratio.max():.0f} | {100 * refused.sum() / (refused + kept).sum():.1f} % "
            f"| {100 * share:.1f} % |"
        )
        print(lines[-1], flush=True)
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
