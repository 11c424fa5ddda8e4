"""Slow study over random rigs whose poses are found with them: do calibrations reach the Cramer-Rao bound, do their regions hold the truth?

    python benchmarks/self_calibration_coverage.py --case all --campaigns 100 --keep self.jsonl     (goes on from what is kept)

The campaign is the unit; its number is the seed. Self-calibrations have no frame of the truth: the true rig and poses are moved as a whole
to where the choice of the frame puts them, and lengths are compared along motions that start from each one's own zero pose. The bound is
the inverse of the information at the truth, bordered with the frame's conditions, all poses unknown: not the estimator's own way.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.stats
from calibration_coverage import coverage, row
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Calibration, CalibrationSettings, Model, calibrate, unknowns_of
from lmeasure.calibration.solve.frame import condition, model_of
from lmeasure.calibration.solve.unknown_poses import free_components
from lmeasure.calibration.solve.unknowns import rig_with
from lmeasure.estimation import Fit, fit
from lmeasure.sensors import span_lengths

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from random_campaigns import RandomCampaign, draw, errors, shifted, square_of, true_unknowns

FloatArray = NDArray[np.float64]

BODY = {"points": 10, "poses": 40, "off": (3.0, 0.01), "spread": (500.0, 0.6)}
POINT = {"points": 6, "poses": 40, "attachments": 1, "off": (3.0, 0.0), "spread": (500.0, 0.3)}
XYZ = {"points": 6, "poses": 36, "oriented": False, "u_position_mm": 0.02, "spread": (500.0, 0.4)}
CASES = {
    "body, frame rig, gaussian": (BODY | {"noise": "gaussian"}, CalibrationSettings(self_calibration=True)),
    "body, frame poses, rounded": (BODY | {"noise": "rounded"}, CalibrationSettings(self_calibration=True, frame="poses")),
    "point, frame rig, rounded": (POINT | {"noise": "rounded"}, CalibrationSettings(self_calibration=True)),
    "point, frame poses, gaussian": (POINT | {"noise": "gaussian"}, CalibrationSettings(self_calibration=True, frame="poses")),
    "positions alone, gaussian": (XYZ | {"noise": "gaussian"}, CalibrationSettings()),
    "positions alone, rounded": (XYZ | {"noise": "rounded"}, CalibrationSettings()),
}
"""How campaigns are drawn, and the options of their calibration."""

STRAIGHT = 0.3  # bend up to which the linear bound is what can be reached
SAID = {"misfit", "edge", "not_converged", "scale", "sign", "attachment", "swapped", "outlier", "slip"}


def found_again(drawn: RandomCampaign, result: Calibration, settings: CalibrationSettings, free: tuple[int, ...]) -> tuple[Model, Fit]:
    """The model and the fit behind a result, begun where it ended."""
    campaign = drawn.campaign if drawn.campaign.poses.oriented else replace(drawn.campaign, poses=result.campaign.poses)
    rig = unknowns_of(campaign, settings.groups)
    model = model_of(campaign, rig, free, settings.frame if settings.self_calibration else None)
    theta = shifted(model, np.array([p.value for p in result.record.parameters]), result.campaign.poses.rows)
    return model, fit(model, theta, near=True)


def bound(model: Model, theta: FloatArray, V: FloatArray) -> FloatArray:
    """(P, P) Cramer-Rao bound in the frame."""
    J = model.jacobian(theta)
    M = J.T @ np.linalg.solve(V, J)
    scale = 1.0 / np.sqrt(np.diag(M))
    M = M * np.outer(scale, scale)
    if model.frame is None:
        return np.asarray(scale[:, None] * np.linalg.inv(M) * scale)
    C = condition(model, theta, model.frame) * scale
    C /= np.linalg.norm(C, axis=1)[:, None]
    bordered = np.linalg.inv(np.block([[M, C.T], [C, np.zeros((6, 6))]]))[: len(M), : len(M)]
    return np.asarray(scale[:, None] * bordered * scale)


def lengths(model: Model, theta: FloatArray, rows: FloatArray) -> FloatArray:
    """(n m,) changes of length [mm] along motions (n, 7) of the tool from the zero pose, or, where positions hold the frame, at poses."""
    rig = rig_with(model.campaign, model.parameters, theta[: model.own], None)
    start = model.poses(theta)[0] if model.frame is not None else np.array([0.0, 0, 0, 0, 0, 0, 1])
    R = Rotation.from_quat(start[3:])
    there = np.column_stack([start[:3] + R.apply(rows[:, :3]), (R * Rotation.from_quat(rows[:, 3:])).as_quat()])
    found = span_lengths(rig, np.vstack([start, there]))
    return np.asarray((found[1:] - found[0]).reshape(-1))


def study(seed: int, case: str) -> dict[str, object]:
    """One campaign, drawn and calibrated."""
    given, settings = CASES[case]
    drawn = draw(seed, phased=True, **given)  # type: ignore[arg-type]
    result = calibrate(drawn.campaign, settings)
    record = result.record
    free = free_components(drawn.campaign, trusted=not settings.self_calibration)
    model, first = found_again(drawn, result, settings, free)
    silent = len(first.silent)
    codes = {w.code for w in record.warnings}
    truth = true_unknowns(model, drawn)
    own = model.own
    error, k = errors(drawn, record, settings), own - first.motions
    square = square_of(record, error)
    reached = fit(model, truth)
    apart = first.theta[:own] - reached.theta[:own]
    angle = np.array([name.endswith("_deg") for name in model.parameters.names])
    apart = np.where(angle, (apart + 180.0) % 360.0 - 180.0, apart) / model.parameters.width
    elsewhere = float(np.linalg.norm((reached.s * (reached.directions @ apart))[reached.known])) > 0.3
    r = model.residuals(truth)
    at_truth = float(r @ np.linalg.solve(reached.V, r)) - reached.chi2
    rng = np.random.default_rng(9)
    if model.frame is None:
        rows = np.column_stack([rng.uniform(-500, 500, (60, 3)), Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (60, 3))).as_quat()])
    else:
        turns = np.zeros((60, 3)) if len(free) == 3 else rng.uniform(-0.3, 0.3, (60, 3))
        rows = np.column_stack([rng.uniform(-250, 250, (60, 3)), Rotation.from_rotvec(turns).as_quat()])
    wrong = lengths(model, first.theta, rows) - lengths(model, truth, rows)
    reported = np.arange(own + len(free))
    h = np.where(reported < own, 1e-4, 1e-5)
    h = np.diag(np.r_[h, np.zeros(len(truth) - len(reported))])[: len(reported)]
    g = np.array([lengths(model, first.theta + d, rows) - lengths(model, first.theta - d, rows) for d in h]).T / (2 * h.max(axis=1))
    stated = np.sqrt(np.einsum("na,ab,nb->n", g, first.covariance[np.ix_(reported, reported)], g))
    out: dict[str, object] = {
        "case": case,
        "seed": seed,
        "silent": silent,
        "said": bool(codes & SAID),
        "bend": record.region["bend"],
        "chi2": first.chi2 / first.freedom,
        "inside": square <= record.region["factor"] ** 2,
        "inside_gaussian": square <= scipy.stats.chi2.ppf(0.95, k),
        "values_inside": float(np.mean([abs(e) <= p.U95 for e, p in zip(error, record.parameters, strict=True)])),
        "lengths_inside": float(np.mean(np.abs(wrong) <= 1.959964 * stated)),
        "wrong": elsewhere or at_truth > scipy.stats.chi2.isf(1e-6, first.rank),
    }
    if silent:
        return out
    C = bound(model, truth, model.covariance(truth))
    best = np.sqrt(np.einsum("na,ab,nb->n", g, C[np.ix_(reported, reported)], g))
    least, axes = np.linalg.eigh(C[:own, :own] / np.outer(model.parameters.width, model.parameters.width))
    return out | {
        "values_to_bound": float(np.mean(error**2 / np.diag(C)[:own])),
        "joint_to_bound": float(np.sum((axes[:, -k:].T @ (error / model.parameters.width)) ** 2 / least[-k:])) / k,
        "lengths_to_bound": float(np.mean((wrong / best) ** 2)),
    }


def line(case: str, own: pd.DataFrame) -> list[str] | None:
    """The case's line of the table: a warning of a misfit takes a campaign out of ratios and regions."""
    plain = own[~own["said"].astype(bool)]
    return None if own.empty else row(case, own, plain[plain["silent"] == 0], plain, own, STRAIGHT)


STUDY = coverage("self_calibration_coverage", study, CASES, line)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
