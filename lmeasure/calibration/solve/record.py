"""The calibration record of a fit: values, their uncertainties and correlations."""

from dataclasses import asdict

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.dimensions import Dimensions
from lmeasure.calibration.solve.prediction import Prediction
from lmeasure.calibration.solve.residuals import COMPONENTS
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.guard import AgainstNominal
from lmeasure.calibration.validation.hold_out import ValidationPose, deletion_residuals
from lmeasure.core import QUATERNION_COLUMNS, FloatArray
from lmeasure.estimation import PROBABILITY, Fit, Parameters, Regions
from lmeasure.kernels import changes_from_counts, span_lengths
from lmeasure.recording import POSITION_COLUMNS
from lmeasure.rig import CalibrationRecord, Finding, RecordedParameter, Residual, Rig, Unobservable

CORRELATED = 0.95
GAUSS_95 = 1.959963984540054
UNSEEN = 1e6  # prior standard uncertainties that the counts leave of a direction: more is as good as all


def make_record(
    campaign: Campaign,
    model: Model,
    found: Fit,
    where: Regions,
    *,
    findings: list[Finding],
    silent: list[Unobservable],
    rig: Rig,
    dimensions: Dimensions,
) -> CalibrationRecord:
    """The record of a fit; coarse solutions, ranges, predictions and settings are added by the caller that has them. campaign: with the
    poses found, where they were unknown; rig: as calibrated, with the corrections of its dimensions."""
    unknowns, own = model.parameters, model.own
    u = np.sqrt(np.maximum(np.diag(where.covariance), 0.0))
    reference = {"reference_u_position_mm": float(np.sqrt(np.mean(model.noise.u_position_mm**2)))} if model.places_known else {}
    if not model.pose_unknowns:
        reference["reference_u_rotation_deg"] = float(np.degrees(np.sqrt(np.mean(model.noise.u_rotation_rad**2))))
    return CalibrationRecord(
        rig=campaign.rig.name,
        parameters=tuple(
            RecordedParameter(name=n, value=float(v), u=float(s), prior_u=float(w), U95=float(half))
            for n, v, s, w, half in zip(unknowns.names, found.theta[:own], u, unknowns.width, where.U95, strict=True)
        ),
        covariance=_rows(where.covariance),
        tangent_covariance=_rows(found.covariance[:own, :own]),
        dimensions=dimensions.entries(rig),
        temperature_c=None if campaign.temperature_c is None else float(np.mean(campaign.temperature_c[np.isfinite(campaign.counts)])),
        region={"probability": PROBABILITY, "factor": where.factor, "bend": where.bend, "whole_counts": bool(model.whole_counts.all())},
        residuals=tuple(
            Residual(pose=campaign.poses.names[i], channel=campaign.cables[j].channel, mm=-float(r))
            for i, j, r in zip(model.pose_index, model.cable_index, dimensions.residuals, strict=True)
        ),
        equations=model.equations,
        unknowns=len(found.theta),
        rank=found.rank,
        unobservable=tuple(silent),
        warnings=tuple(findings),
        inputs=campaign.inputs,
        spectrum=tuple(_spectrum(unknowns, found)),
        correlations=tuple(_correlations(unknowns.names, where.covariance, np.maximum(u, 1e-300))),
        poses=tuple(_poses(campaign, model, found)),
        zero_length_mm=_zero_lengths(campaign, rig),
        validation=_validation(model, found),
        noise={
            "chi_squared": found.chi2,
            "degrees_of_freedom": float(found.freedom),
            "residual_rms_mm": float(np.sqrt(np.mean(dimensions.residuals**2))),
        }
        | reference,
    )


def _zero_lengths(campaign: Campaign, rig: Rig) -> dict[str, float]:
    """Return the length of each cable where its counter was zeroed [mm]."""
    drums = campaign.drums
    zero, rows = campaign.zero[: len(drums)], rig.cable_rows(drums)
    begun = np.nan_to_num(campaign.counts[zero, np.arange(len(drums))])
    lengths = np.diag(span_lengths(rows, np.ascontiguousarray(campaign.poses.rows[zero]))) - changes_from_counts(rows, begun[None])[0]
    return {c.name: round(float(length), 3) for c, length in zip(drums, lengths, strict=True) if np.isfinite(length)}


def _poses(campaign: Campaign, model: Model, found: Fit) -> list[dict[str, object]]:
    """Return each pose that was found with the rig, and the standard uncertainties of its unknowns, in the frame."""
    if not model.pose_unknowns:
        return []
    u = np.sqrt(np.maximum(np.diag(found.covariance)[model.own :], 0.0)).reshape(len(model.at), -1)
    columns = (*POSITION_COLUMNS, *QUATERNION_COLUMNS)
    return [
        {"pose": campaign.poses.names[i]}
        | dict(zip(columns, campaign.poses.rows[i].tolist(), strict=True))
        | dict(zip([f"u_{COMPONENTS[c]}" for c in model.free], own.tolist(), strict=True))
        for i, own in zip(model.at, u, strict=True)
    ]


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(x) for x in row) for row in matrix)


def _correlations(names: tuple[str, ...], covariance: FloatArray, u: FloatArray) -> list[dict[str, object]]:
    rho = covariance / np.outer(u, u)
    pairs = [(abs(rho[i, j]), i, j) for i in range(len(u)) for j in range(i) if abs(rho[i, j]) > CORRELATED]
    return [{"a": names[j], "b": names[i], "value": float(rho[i, j])} for _, i, j in sorted(pairs, reverse=True)]


def _validation(model: Model, found: Fit) -> dict[str, object]:
    """Each pose predicted by a fit without it."""
    left_out = deletion_residuals(model, found)
    if not left_out:
        return {}
    rms = float(np.sqrt(np.mean([value**2 for _, value in left_out])))
    return {"left_out_rms_mm": rms, "poses": [{"pose": name, "rms_mm": value} for name, value in left_out]}


def held_out_entry(poses: list[ValidationPose]) -> dict[str, object]:
    """Return the prediction errors of validation poses, beside those expected from the record's uncertainties."""
    if not poses:
        return {}
    error, u = np.concatenate([p.error_mm for p in poses]), np.concatenate([p.u_mm for p in poses])
    return {
        "held_out": {
            "rms_mm": float(np.sqrt(np.mean(error**2))),
            "expected_mm": float(np.sqrt(np.mean(u**2))),
            "within_95": float(np.mean(np.abs(error) <= GAUSS_95 * u)),
            "poses": [
                {"pose": p.pose, "channel": c, "error_mm": float(e), "u_mm": float(s)}
                for p in poses
                for c, e, s in zip(p.channels, p.error_mm, p.u_mm, strict=True)
            ],
        }
    }


def nominal_entry(compared: AgainstNominal | None) -> dict[str, object]:
    """Return how poses left out were predicted by the calibrated and by the nominal rig."""
    return {} if compared is None else {"against_nominal": asdict(compared)}


def _spectrum(unknowns: Parameters, found: Fit) -> list[dict[str, object]]:
    """Each direction: how many prior standard uncertainties the counts leave of it, and the owner of most of the values it is made of."""
    out = []
    determined = len(found.s) - found.motions
    for s, direction, known in zip(found.s[:determined], found.directions, found.known, strict=False):
        weight: dict[str, float] = {}
        for i, part in enumerate(direction**2):
            weight[unknowns.owner(i)] = weight.get(unknowns.owner(i), 0.0) + float(part)
        owner = max(weight, key=lambda name: weight[name])
        out.append({"point": owner, "left": min(1.0 / max(float(s), 1e-300), UNSEEN), "known": bool(known)})
    return out + [{"point": "frame", "left": UNSEEN, "known": False}] * found.motions


def predicted_entry(campaign: Campaign, predicted: Prediction) -> dict[str, object]:
    """Predicted standard uncertainties over the workspace of the reference poses, from the calibration alone."""
    u = predicted.length_mm
    out: dict[str, object] = {
        "poses": len(predicted.rows),
        "lengths": [
            {"cable": c.name, "rms_mm": float(np.sqrt(np.mean(u[:, j] ** 2))), "worst_mm": float(u[:, j].max())}
            for j, c in enumerate(campaign.drums)
        ],
    }
    if predicted.pose.size:
        position = np.linalg.norm(predicted.pose[:, :3], axis=1)
        rotation = np.linalg.norm(predicted.pose[:, 3:], axis=1)
        out |= {
            "position_rms_mm": float(np.sqrt(np.mean(position**2))),
            "position_worst_mm": float(position.max()),
            "rotation_rms_deg": float(np.degrees(np.sqrt(np.mean(rotation**2)))),
            "rotation_worst_deg": float(np.degrees(rotation.max())),
        }
    return out
