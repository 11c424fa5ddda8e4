"""Results of an identification: its record, the corrected robot, and predictions as files have them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.io import files
from lmeasure.robots.file_fields import Frame, Place
from lmeasure.robots.identification.hold_out import HeldOut, Worth
from lmeasure.robots.identification.identify import Identified, Prediction
from lmeasure.robots.identification.measurements import Noted
from lmeasure.robots.identification.observability import determined_parameters, silent_directions, unknown_frames
from lmeasure.robots.identification.reach import PredictionMap, worst_pose
from lmeasure.robots.robot import AnyRobot, Robot
from lmeasure.text import message

SCHEMA = "lmeasure.identified/1"


def record(
    found: Identified[Any],
    inputs: Sequence[Path],
    held: HeldOut | None,
    curve: Sequence[tuple[int, float, float, float]],
    *,
    worth: Sequence[Worth],
    findings: Sequence[Noted],
    over: PredictionMap | None = None,
) -> dict[str, Any]:
    """The content of identified.json. Values of `base.r..` and `tool.r..` are rotation vectors, their uncertainties those of a small turn
    about the axes of the frame that the pose leads to."""
    fit, state = found.fit, found.state
    unknowns = fit.problem.unknowns
    u = np.sqrt(np.diag(fit.covariance))
    nominal = {p.name: p.value for p in found.nominal.parameters}
    units = {p.name: p.unit for p in found.nominal.parameters}
    determined = determined_parameters(fit)
    parameters = [
        {
            "name": name,
            "value": float(value),
            "nominal": nominal.get(name),
            "u": float(u[i]),
            "unit": units.get(name, "deg" if name.endswith("_deg") else "mm"),
            "prior_u": float(fit.problem.width[i]) if name in nominal else None,
            "determined": bool(determined[i]),
        }
        for i, (name, value) in enumerate(zip(unknowns.names[: unknowns.asked], unknowns.values(fit.x), strict=False))
    ]
    silent = [*silent_directions(fit), *unknown_frames(fit)]
    targets = {
        name: _pose(state.targets[i]) | {"oriented": bool(unknowns.turned[i])}
        for i, name in enumerate(found.rows.targets)
        if unknowns.target_at[i].stop > unknowns.target_at[i].start
    }
    return {
        "schema": SCHEMA,
        "robot": found.nominal.name,
        "freed": list(found.settings.free),
        "weights": found.settings.weights,
        "parameters": parameters,
        "covariance": fit.covariance[: unknowns.asked, : unknowns.asked].tolist(),
        "base": _pose(state.base),
        "tool": next(iter(targets.values()), _pose(state.targets[0])),
        "targets": targets,
        "stations": dict(zip(found.rows.stations, state.stations.tolist(), strict=True)),
        "noise": {
            "position_mm": found.robot_mm if found.tells_noise else None,
            "rotation_deg": float(np.degrees(found.noise.rotation_rad)) if found.rows.oriented.any() and found.tells_noise else None,
            "reading_mm": found.noise.reading_mm or None,
        },
        "stays": found.stays,
        "beyond": {"factor": found.beyond.factor, "from_mm2": found.beyond.from_mm2},
        "equations": fit.equations,
        "freedom": fit.freedom,
        "rows": float(found.weight.sum()),
        "unobservable": [{"direction": s.direction, "text": s.text, "finding": s.said.stated()} for s in silent],
        "residuals": _residuals(found),
        "held_out": None if held is None else _held_out(held),
        "learning_curve": [{"poses": n, "mean_mm": m, "least_mm": a, "largest_mm": b} for n, m, a, b in curve],
        "workspace": None if over is None else _workspace(found, over),
        "worth_freeing": [w.__dict__ for w in worth],
        "warnings": [f.stated() for f in findings],
        "inputs": [{"file": str(path), "sha256": files.sha256(path)} for path in inputs],
    }


def write_record(path: Path, content: dict[str, Any]) -> None:
    """Write identified.json, whole or not at all."""
    files.write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def corrected(robot: AnyRobot, found: Identified[Any]) -> AnyRobot:
    """The robot with the values that were found, and its first target as its tool."""
    values = {p.name: p.value for p in found.state.robot.parameters}
    names = {p.name for p in found.fit.problem.unknowns.own}
    with_values = robot.with_values({name: value for name, value in values.items() if name in names})
    return with_values.model_copy(update={"tool": _place(found.state.targets[0])})


def nominal_frames(robot: AnyRobot) -> dict[str, Any]:
    """Return the controller's base and flange of a serial arm for identified.json; robot.toml has them too."""
    frames = {key: getattr(robot, key, None) or Frame() for key in ("base", "flange")} if isinstance(robot, Robot) else {}
    return {f"nominal_{key}": frame.model_dump(exclude_none=True, mode="json") for key, frame in frames.items()}


def prediction_columns(names: Sequence[str], predicted: Prediction) -> dict[str, Any]:
    """Columns of predictions.csv."""
    place = dict(zip(("x_mm", "y_mm", "z_mm"), predicted.pose[:, :3].T, strict=True))
    return {"name": list(names), **place, "u95_mm": predicted.u95_mm}


def summary(found: Identified[Any], held: HeldOut | None, findings: Sequence[Noted], over: PredictionMap | None = None) -> list[str]:
    """Lines for the reader, line by line."""
    before, after = (np.linalg.norm(e[found.kept & found.rows.placed], axis=1) for e in (found.nominal_errors_mm(), found.errors_mm()))
    lines = []
    if len(after):
        code = "robots.rows_stays" if found.stays < found.kept.sum() else "robots.rows"
        lines.append(message(code, rows=found.kept.sum(), stays=found.stays, before=before.mean(), after=after.mean()))
    if found.settings.weights == "biweight":
        lines.append(message("robots.weighed_tukeys_biweight_they", rows=found.weight.sum()))
    lines.append(message("robots.freed", names=tuple(found.settings.free)))
    determined = determined_parameters(found.fit)[: len(found.fit.problem.unknowns.own)]
    lines.append(message("robots.parameters_determined_measurements_others", count=determined.sum(), of=len(determined)))
    size = message("robots.scatter_size", mm=found.robot_mm) if found.tells_noise else message("robots.cannot_tell")
    apart = found.rows.stated[0] or found.noise.reading_mm > 0.0
    lines.append(message("robots.scatter" if apart else "robots.scatter_both", size=size))
    if found.noise.reading_mm > 0.0:
        lines.append(message("robots.one_reading_mm_one", noise=found.noise.reading_mm))
    if held is None:
        lines.append(message("robots.rows_held_out_none"))
    else:
        error = held.error_mm
        lines.append(message("robots.held_out", mean=error.mean(), most=error.max(), part=100 * held.within))
    if found.beyond.factor:
        lines.append(message("robots.far", times=found.beyond.factor))
    if over is not None:
        median, most, largest = over.quantiles_mm
        lines.append(message("robots.predicted", median=median, most=most, largest=largest, there=over.at_measured_mm))
    return [*lines, *(message("line.warning", code=f.code, text=f.text) for f in findings)]


def _workspace(found: Identified[Any], over: PredictionMap) -> dict[str, Any]:
    median, most, largest = over.quantiles_mm
    figures = {"median_u95_mm": median, "quantile_95_u95_mm": most, "largest_u95_mm": largest, "measured_u95_mm": over.at_measured_mm}
    return figures | {"poses": len(over.u95_mm), "worst_pose": worst_pose(found, over)}


def _residuals(found: Identified[Any]) -> list[dict[str, Any]]:
    rows, errors = found.rows, found.errors_mm()
    lengths = found.fit.problem.unknowns.residuals(found.fit.x, rows)[:, 3]
    out, weight = [], found.weight
    for i, name in enumerate(rows.names):
        one: dict[str, Any] = {"name": name, "target": rows.targets[rows.target_of[i]], "used": bool(found.kept[i])}
        one["weight"] = float(weight[i])
        one |= {"mm": errors[i].tolist()} if rows.placed[i] else {"length_mm": float(lengths[i])}
        out.append(one)
    return out


def _held_out(held: HeldOut) -> dict[str, float]:
    error = held.error_mm
    rms = float(np.sqrt(np.mean(error**2)))
    return {"mean_mm": float(error.mean()), "rms_mm": rms, "max_mm": float(error.max()), "within_u95": held.within, "misfit": held.misfit}


def _pose(row: FloatArray) -> dict[str, Any]:
    return {"position_mm": [float(v) for v in row[:3]], "quaternion_xyzw": [float(v) for v in row[3:]]}


def _place(row: FloatArray) -> Place:
    p, q = row[:3], row[3:] / np.linalg.norm(row[3:])
    return Place(position_mm=(float(p[0]), float(p[1]), float(p[2])), quaternion_xyzw=(float(q[0]), float(q[1]), float(q[2]), float(q[3])))
