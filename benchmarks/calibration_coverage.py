"""Slow study over random rigs and campaigns: do calibrations reach the Cramer-Rao bound, do their 95 % regions hold the truth in 95 %?

    python benchmarks/calibration_coverage.py --case all --campaigns 500 --keep campaigns.jsonl

The campaign is the unit: one drawn rig, one set of poses, one draw of the noise; its number is the seed. What
benchmarks/results/calibration_coverage.md shows is printed; --keep goes on from what is kept.
"""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import Study, table, two_sided

from lmeasure.calibration import Calibration, CalibrationSettings, Model, calibrate, unknowns_of
from lmeasure.calibration.solve.noise import Noise
from lmeasure.estimation import fit
from lmeasure.estimation.least_squares import Whitened
from lmeasure.kernels import cable as cable_kernels
from lmeasure.sensors import cable_covariance, counts_from_poses, span_lengths

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from random_campaigns import RandomCampaign, at_truth, draw, true_values

FloatArray = NDArray[np.float64]

CASES = {
    "gaussian, exact poses": ("gaussian", 0.0, 1, 10),
    "gaussian, poses 0.05 mm": ("gaussian", 0.05, 6, 30),
    "rounded, exact poses": ("rounded", 0.0, 1, 10),
    "rounded, poses 0.05 mm": ("rounded", 0.05, 6, 30),
}
"""Noise of the counts, standard uncertainty of the reference poses [mm], observation points, least number of poses (up to ten more)."""

STRAIGHT = 0.1  # bend up to which the linear bound is what can be reached
SAID = {"misfit", "edge", "not_converged", "scale", "sign", "attachment", "swapped", "angles", "outlier", "slip", "ambiguous"}


def bound(drawn: RandomCampaign) -> FloatArray:
    """Cramer-Rao bound (p, p) of the parameters, from the information at the truth."""
    campaign = at_truth(drawn)
    noise = Noise(campaign.poses.u_position_mm, campaign.poses.u_rotation_rad)
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")), noise)
    J, V = model.jacobian(model.start), model.covariance(model.start)
    return np.asarray(np.linalg.inv(J.T @ np.linalg.solve(V, J)))


def lengths(drawn: RandomCampaign, result: Calibration, information: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, m) errors of predicted changes since the zero pose, their bounds and their stated uncertainties [mm], at held-out poses."""
    rng = np.random.default_rng(9)
    rows = np.column_stack([rng.uniform(-300, 300, (100, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (100, 3))).as_quat()])
    rows = np.vstack([drawn.campaign.poses.rows[:1], rows])
    wrong = span_lengths(result.rig, rows) - span_lengths(drawn.truth, rows)
    linked = result.record.model_copy(update={"tangent_covariance": tuple(map(tuple, information.tolist()))})
    return wrong[1:] - wrong[0], _predicted(drawn, result, linked, rows), _predicted(drawn, result, result.record, rows)


def _predicted(drawn: RandomCampaign, result: Calibration, record: object, rows: FloatArray) -> FloatArray:
    rig = result.rig
    cables, scales = rig.cable_rows(), rig.scales()
    # the geometry alone: what the drum makes of a count is known here
    counts = counts_from_poses(rig, rows, rows[0])
    g = cable_kernels.length_gradients(cables, np.ascontiguousarray(rows), counts, scales)
    g = g[1:] - g[0]
    covariance, width = cable_covariance(rig, record, rig.cable), g.shape[2]  # type: ignore[arg-type]
    blocks = np.array([covariance[j * width : (j + 1) * width, j * width : (j + 1) * width] for j in range(g.shape[1])])
    return np.asarray(np.sqrt(np.einsum("nma,mab,nmb->nm", g, blocks, g)))


def study(seed: int, case: str) -> dict[str, object]:
    """One campaign, drawn and calibrated."""
    noise, u, points, poses = CASES[case]
    drawn = draw(seed, points=points, poses=poses + seed % 11, noise=noise, u_position_mm=u, phased=True)
    result = calibrate(drawn.campaign, CalibrationSettings())
    record = result.record
    codes = {w.code for w in record.warnings}
    out: dict[str, object] = {"case": case, "seed": seed, "determined": record.rank == record.unknowns, "said": bool(codes & SAID)}
    if not out["determined"]:
        return out
    names = [p.name for p in record.parameters]
    truth = true_values(drawn, names)
    error = np.array([p.value for p in record.parameters]) - truth
    information = bound(drawn)
    own = float(error @ np.linalg.solve(record.covariance_matrix(), error))
    wrong, best, stated = lengths(drawn, result, information)
    # the minimum that a start at the truth leads to
    of_poses = Noise(drawn.campaign.poses.u_position_mm, drawn.campaign.poses.u_rotation_rad)
    model = Model(drawn.campaign, unknowns_of(drawn.campaign, ("position", "guide")), of_poses)
    reached = fit(model, truth)
    apart = np.array([p.value for p in record.parameters]) - reached.theta
    elsewhere = float(apart @ np.linalg.solve(reached.covariance, apart)) > 0.1
    at_truth_chi2 = float(np.sum(Whitened(model, reached.V).residuals((truth - model.parameters.nominal) / model.parameters.width) ** 2))
    ratio = error / np.sqrt(np.diag(information))
    return out | {
        "bend": record.region["bend"],
        "values_to_bound": float(np.mean(ratio**2)),
        "joint_to_bound": float(error @ np.linalg.solve(information, error)) / len(error),
        "lengths_to_bound": float(np.mean((wrong / best) ** 2)),
        "inside": own <= record.region["factor"] ** 2,
        "inside_gaussian": own <= scipy.stats.chi2.ppf(0.95, len(error)),
        "values_inside": float(np.mean([abs(e) <= p.U95 for e, p in zip(error, record.parameters, strict=True)])),
        "lengths_inside": float(np.mean(np.abs(wrong) <= 1.959964 * stated)),
        "wrong": elsewhere or at_truth_chi2 - reached.chi2 > scipy.stats.chi2.isf(1e-6, len(error)),
    }


HEADER = (
    "case", "campaigns", "determined", "values / bound", "lengths / bound", "of these straight", "joint / bound",
    "in 95 % region", "p", "Gaussian region", "values in U95", "lengths in 1.96 u", "another minimum, said", "unsaid",
)  # fmt: skip


def root(squares: pd.Series) -> str:
    """Root of the mean of squared ratios, one a campaign, with its standard error."""
    if len(squares) < 2:
        return "none"
    m = squares.astype(float)
    return f"{np.sqrt(m.mean()):.3f} ± {m.std() / np.sqrt(len(m)) / 2 / np.sqrt(m.mean()):.3f}"


def row(case: str, own: pd.DataFrame, known: pd.DataFrame, regions: pd.DataFrame, minima: pd.DataFrame, straight: float) -> list[str]:
    """A case's line: of its own campaigns those known are held to the bound, regions to their coverage, minima to having said so; straight
    is the bend below which the linear bound is what can be reached."""
    least_bent = known[known["bend"] < straight]
    p = two_sided(regions["inside"])
    wrong, said = minima["wrong"].astype(bool), minima["said"].astype(bool)
    cells = (
        case, len(own), len(known), root(known["values_to_bound"]), root(known["lengths_to_bound"]), len(least_bent),
        root(least_bent["joint_to_bound"]), f"{100 * regions['inside'].mean():.1f} %", f"{p:.3f}",
        f"{100 * regions['inside_gaussian'].mean():.1f} %", f"{100 * regions['values_inside'].mean():.1f} %",
        f"{100 * regions['lengths_inside'].mean():.1f} %", int((wrong & said).sum()), int((wrong & ~said).sum()),
    )  # fmt: skip
    return [str(c) for c in cells]


def coverage(
    name: str, draw: Callable[[int, str], dict[str, Any]], cases: Iterable[str], line: Callable[[str, pd.DataFrame], list[str] | None]
) -> Study:
    """Return a study of calibrations against their truth; line: the cells of a case, None where it has none."""

    def page(found: list[dict[str, Any]]) -> str:
        data = pd.DataFrame(found)
        return table(HEADER, filter(None, (line(case, data[data["case"] == case]) for case in cases)))

    return Study(name, draw, page, "campaigns", factors={"case": tuple(cases)})


def line(case: str, own: pd.DataFrame) -> list[str] | None:
    """The case's line of the table, of determined campaigns."""
    known = own[own["determined"].astype(bool)]
    return None if known.empty else row(case, own, known, known, known, STRAIGHT)


STUDY = coverage("calibration_coverage", study, CASES, line)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
