"""Results of an identification: its record, the corrected robot, and predictions as files have them.

It can be seen from frames that others state: the position of its base, and of its tool.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import scipy

from lmeasure.accuracy import radii_95
from lmeasure.core import BoolArray, FileFormatError, FloatArray, IntArray, se3
from lmeasure.io import files
from lmeasure.robots.identification.hold_out import CrossValidation, Worth
from lmeasure.robots.identification.identify import Identified, Prediction
from lmeasure.robots.identification.measurements import NOWHERE, Beyond, Noted
from lmeasure.robots.identification.observability import determined_parameters, unknown_frames, unobservable_directions
from lmeasure.robots.identification.reach import PredictionMap, worst_pose
from lmeasure.robots.model import Frame, Parameter, Place, RobotModel
from lmeasure.robots.robot import AnyRobot, Robot, read_robot
from lmeasure.text import message

SCHEMA = "lmeasure.identified/1"


def record(
    found: Identified[Any],
    inputs: Sequence[Path],
    held: CrossValidation | None,
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
    silent = [*unobservable_directions(fit), *unknown_frames(fit)]
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


def summary(
    found: Identified[Any], held: CrossValidation | None, findings: Sequence[Noted], over: PredictionMap | None = None
) -> list[str]:
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


def _held_out(held: CrossValidation) -> dict[str, float]:
    error = held.error_mm
    rms = float(np.sqrt(np.mean(error**2)))
    return {"mean_mm": float(error.mean()), "rms_mm": rms, "max_mm": float(error.max()), "within_u95": held.within, "misfit": held.misfit}


def _pose(row: FloatArray) -> dict[str, Any]:
    return {"position_mm": [float(v) for v in row[:3]], "quaternion_xyzw": [float(v) for v in row[3:]]}


def _place(row: FloatArray) -> Place:
    p, q = row[:3], row[3:] / np.linalg.norm(row[3:])
    return Place(position_mm=(float(p[0]), float(p[1]), float(p[2])), quaternion_xyzw=(float(q[0]), float(q[1]), float(q[2]), float(q[3])))


@dataclass(frozen=True)
class Placed:
    """`RobotModel` of a robot whose own base is at `stand` (7,) in the stated base, and the stated flange at `seat` (7,) in its own:
    forward is stand, the robot's own forward, seat, in this order."""

    robot: RobotModel
    stand: FloatArray
    seat: FloatArray

    @property
    def name(self) -> str:
        return self.robot.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.robot.joint_names

    @property
    def sliding(self) -> BoolArray:
        return self.robot.sliding

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        return self.robot.limits

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.robot.parameters

    @property
    def reach_mm(self) -> float:
        return self.robot.reach_mm + float(np.linalg.norm(self.stand[:3]) + np.linalg.norm(self.seat[:3]))

    def moved(self, change: FloatArray) -> Self:
        return replace(self, robot=self.robot.moved(change))

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        return self._seen(self.robot.forward(joints, side))

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        poses, by_joints, by_parameters = self.robot.derivatives(joints, side, of)
        carried = se3.adjoint(self.stand).T
        return self._seen(poses), by_joints @ carried, by_parameters @ carried

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        return self.robot.inverse(se3.compose(se3.compose(se3.inverse(self.stand), pose), se3.inverse(self.seat)), seed)

    def _seen(self, poses: FloatArray) -> FloatArray:
        known = ~np.isnan(poses).any(axis=1)
        out = np.full_like(poses, np.nan)
        out[known] = se3.compose(se3.compose(self.stand, poses[known]), self.seat)
        return out


WIDE = 1e5
"""Prior of frames, in degrees or millimetres."""
TURNS, PLACES = ("rx_deg", "ry_deg", "rz_deg"), ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class IdentifiedRobot:
    """nominal and found: models; base, tool (7,): instrument_from_base, flange_from_target; names (p,) of the unknowns, covariance (p, p)
    in the units of the names; noise_mm of the robot in each coordinate, NaN if undetermined; freedom of that; misfit: factor from stated to
    actual errors of validation rows; turned: whether the target's orientation was measured; seen: the found robot in the program's frames,
    itself without a statement of these (`stated`); beyond: widening far from the measured poses."""

    nominal: RobotModel
    found: RobotModel
    base: FloatArray
    tool: FloatArray
    names: tuple[str, ...]
    covariance: FloatArray
    noise_mm: float
    freedom: float
    misfit: float
    turned: bool
    seen: RobotModel
    beyond: Beyond = NOWHERE

    def stated(self, base: FloatArray | None, tool: FloatArray | None) -> "IdentifiedRobot":
        """Return it with the program's base in the instrument's frame, and the intended pose (7,) of the measured target on the flange;
        None keeps the found ones. The found robot is then right in the instrument's frame, not only in its own."""
        here = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        stand = here if base is None else se3.compose(se3.inverse(base), self.base)
        seat = here
        if tool is not None:
            sits = self.tool if self.turned else np.concatenate([self.tool[:3], tool[3:]])
            seat = se3.compose(sits, se3.inverse(tool))
        return replace(self, seen=Placed(self.found, stand, seat))

    def u_mm(self, joints: FloatArray) -> FloatArray:
        """(N,) [mm] standard uncertainty of the target's place by identification alone, all coordinates together."""
        rows = self._rows(joints)
        spread = self.misfit**2 * self.beyond.places(rows, self.covariance)
        return np.asarray(np.sqrt(np.einsum("nii->n", spread)))

    def u95_mm(self, joints: FloatArray) -> FloatArray:
        """(N,) [mm] radius that holds 95 % of where the target is from where it is predicted at joint values (N, n): by identification and
        the robot itself, without the instrument. NaN where the robot's own part could not be determined."""
        rows = self._rows(joints)
        own = self.noise_mm**2 * np.eye(3)
        spread = self.misfit**2 * (self.beyond.places(rows, self.covariance) + own)
        if np.isnan(self.noise_mm):
            return np.full(len(joints), np.nan)
        return np.asarray(float(scipy.stats.t.ppf(0.975, self.freedom) / scipy.stats.norm.ppf(0.975)) * radii_95(spread))

    def _rows(self, joints: FloatArray) -> FloatArray:
        """(N, 3, p) derivatives of the target's place in the instrument's frame by the unknowns, in the units of their names."""
        own = {p.name: (i, p.size) for i, p in enumerate(self.found.parameters)}
        flange, _, twists = self.found.derivatives(joints)
        in_base = se3.apply(flange, self.tool[:3])
        turn = se3.matrices(self.base)
        out = np.zeros((len(joints), 3, len(self.names)))
        degree = np.radians(1.0)
        for k, name in enumerate(self.names):
            owner, _, key = name.rpartition(".")
            if name in own:
                i, size = own[name]
                out[:, :, k] = (twists[:, i, 3:] + np.cross(twists[:, i, :3], in_base)) @ turn.T * size
            elif owner == "base" and key in TURNS:
                out[:, :, k] = np.cross(np.eye(3)[TURNS.index(key)], in_base @ turn.T) * degree
            elif owner == "base":
                out[:, PLACES.index(key), k] = 1.0
            elif owner == self._first_target and key in PLACES:
                out[:, :, k] = (turn @ se3.matrices(flange))[:, :, PLACES.index(key)]
        return out

    @property
    def _first_target(self) -> str:
        return next((name.rpartition(".")[0] for name in self.names if name.startswith(("tool.", "target_"))), "")


def read_identified(folder: Path) -> IdentifiedRobot:
    """The robot of a folder that `lmeasure identify` wrote; FileFormatError where identified.json is not of it."""
    path = folder / "identified.json"
    robot = read_robot(folder / "robot.toml")
    try:
        data = json.loads(files.read_bytes(path))
        parameters = data["parameters"]
        nominal = {p["name"]: float(p["nominal"]) for p in parameters if p["nominal"] is not None}
        noise, held = data["noise"]["position_mm"], data["held_out"] or {}
        covariance = np.array(data["covariance"], dtype=np.float64)
        width = np.array([WIDE if p["prior_u"] is None else float(p["prior_u"]) for p in parameters])
        names = tuple(str(p["name"]) for p in parameters)
        base, tool = (np.array([*data[key]["position_mm"], *data[key]["quaternion_xyzw"]], dtype=np.float64) for key in ("base", "tool"))
        freedom = float(data["freedom"])
        scale, misfit = float("nan") if noise is None else float(noise), float(held.get("misfit", 1.0))
        beyond = Beyond(float(data["beyond"]["factor"]), float(data["beyond"]["from_mm2"]), width)
        turned = any(bool(t["oriented"]) for t in list(data.get("targets", {}).values())[:1])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(message("error.not_what_lmeasure_identify", where=path, error=error)) from None
    if covariance.shape != (len(names), len(names)) or not np.isfinite(covariance).all():
        raise FileFormatError(message("error.the_covariance_is_not", where=path, n_names=len(names)))
    found = robot.model
    known = names, covariance, scale, max(freedom, 1.0), misfit
    return IdentifiedRobot(_nominal(robot, nominal, path), found, base, tool, *known, turned, found, beyond)


def _nominal(robot: AnyRobot, values: dict[str, float], path: Path) -> RobotModel:
    known = {p.name for p in robot.model.parameters}
    strange = sorted(set(values) - known)
    if strange:
        raise FileFormatError(message("error.is_no_parameter_of", where=path, strange=strange[0]))
    return robot.with_values(values).model
