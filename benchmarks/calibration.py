"""Calibration, side by side in one run: the LP-search of one point against a search a user would write, and a whole campaign.

    python benchmarks/calibration.py

Prints a table for benchmarks/results/calibration.md.
"""

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import qmc

from lmeasure.calibration import CalibrationSettings, Model, calibrate, read_campaign, unknowns_of
from lmeasure.calibration.solve.lp_search import Box, point_data, search_point
from lmeasure.calibration.solve.noise import Noise
from lmeasure.estimation import fit

FloatArray = NDArray[np.float64]
TRUTH = Path(__file__).parent.parent / "tests" / "authorities" / "truth"
LOG2 = 16


def best_time(work: Callable[[], Any], repeats: int) -> float:
    """The shortest processor time of several runs [s]: what the work takes when nothing else disturbs it."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def residuals(candidate: FloatArray, radius: float, points: FloatArray, change: FloatArray) -> FloatArray:
    """The model as a user writes it in NumPy: all poses of one candidate at once; the first pose is the zero pose."""
    base, alpha, beta = candidate[:3], candidate[3], candidate[4]
    u = -np.array([np.cos(alpha) * np.sin(beta), np.cos(alpha) * np.cos(beta), -np.sin(alpha)])
    d = points - base
    q = d @ u
    p = np.linalg.norm(d - q[:, None] * u, axis=1)
    x = p - radius
    t = np.sqrt(q * q + x * x - radius * radius)
    length = radius * np.mod(np.arctan2(q * radius + x * t, q * t - x * radius), 2 * np.pi) + t
    return np.asarray(length[1:] - length[0] - change[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--per-candidate", type=int, default=2**12, help="candidates of the plain search that are timed, then scaled up")
    arguments = parser.parse_args()
    campaign = read_campaign(TRUTH / "cell-20-poses-noisy")
    name = "B1"
    nominal = campaign.rig.point(name)
    data = point_data(campaign, name)
    angles = np.radians([nominal.guide_alpha_deg, nominal.guide_beta_deg])
    box = Box(np.array([*nominal.position_mm, *angles]), np.array([100.0, 100.0, 100.0, *np.radians([15.0, 15.0])]))
    one = [j for j, c in enumerate(campaign.cables) if c.from_point == name]
    own = type(campaign)(
        campaign.rig,
        campaign.poses,
        tuple(campaign.cables[j] for j in one),
        np.ascontiguousarray(campaign.counts[:, one]),
        campaign.zero[one],
    )
    noise = Noise(np.full(len(own.poses), 0.05), np.zeros(len(own.poses)))
    model = Model(own, unknowns_of(own, ("position", "guide")), noise)

    def ours() -> FloatArray:
        candidate = next(search_point(data, [box], 0, LOG2, keep=1))
        return fit(model, np.array([*candidate[:3], *np.degrees(candidate[3:])])).theta

    def plain() -> FloatArray:
        candidates = qmc.scale(qmc.Sobol(5, rng=0).random(arguments.per_candidate), box.centre - box.half, box.centre + box.half)
        misfit = [float(np.sum(residuals(c, data.radius, data.points, data.changes) ** 2)) for c in candidates]
        return np.asarray(candidates[int(np.argmin(misfit))])

    found = ours()
    start = np.array([*found[:3], *np.radians(found[3:])])
    polish = best_time(lambda: least_squares(residuals, start * 1.0001, args=(data.radius, data.points, data.changes)), 3)
    t_ours = best_time(ours, 25)
    t_plain = best_time(plain, 5) * 2**LOG2 / arguments.per_candidate + polish
    calibrate(campaign, CalibrationSettings())
    t_campaign = best_time(lambda: calibrate(campaign, CalibrationSettings()), 5)
    print(f"{cpu()}, Python {platform.python_version()}, one process; processor time, shortest of several runs")
    print()
    print("| work | lmeasure | plain Python per candidate | ratio |")
    print("|---|---|---|---|")
    what = f"LP-search of 2^{LOG2} candidates over 20 poses, polish, one point"
    print(f"| {what} | {1e3 * t_ours:.1f} ms | {t_plain:.2f} s | {t_plain / t_ours:.0f} |")
    print(f"| campaign of six points, 20 poses, with diagnosis and predictions | {t_campaign:.2f} s | | |")


def cpu() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor())


if __name__ == "__main__":
    main()
