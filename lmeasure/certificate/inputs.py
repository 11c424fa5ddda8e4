"""Evaluation of a measurement from its files: `certify` does it once, and `verify` again from the copies."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from lmeasure.certificate.bundle import INPUTS, safe_name
from lmeasure.certificate.details import Details, Logo, read_details, read_logo, with_reference
from lmeasure.certificate.signature import digest
from lmeasure.core import QUATERNION_COLUMNS, CertificationError, OtherTrajectoryError
from lmeasure.io import columns_of, files
from lmeasure.iso9283 import CertificationSettings, Evaluation, evaluate, undecided
from lmeasure.recording import POSITION_COLUMNS, Program, Run, read_program, read_run, read_run_head
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.robots import any_shipped, read_joint_log, read_robot
from lmeasure.sensors import OTHERS, stated as unsolved_stated
from lmeasure.text import Message, message
from lmeasure.trajectory import (
    ErrorModel,
    ErrorsOfCurve,
    ErrorsOfRun,
    Stated,
    Trajectory,
    align,
    read_trajectory,
    reconstruct,
    reconstruct_curve,
)

Progress = Callable[[int, int], None]

MAIN = ("AP_p", "RP_l", "AD_p", "RD", "AT_p", "RT_p", "AV", "RV", "FV", "CR", "CO")  # Results that a certificate states without the log
SAME_POSITION_MM = 1e-6
SAME_QUATERNION = 1e-9
SAME_TIME_S = 1e-9
_BESIDE = {"columns": str, "u_position_mm": float, "u_rotation_deg": float, "continuous": bool, "robot": str}
"""Settings that `Inputs.stated` keeps where they are used, with their types."""


@dataclass(frozen=True)
class Inputs:
    """The files a certificate is made of; rig replaces the run's own, details may be missing.

    constraint, repeatability_mm, continuous, joints, robot: settings of `reconstruct`, where a run is given.
    """

    trajectory: Path
    program: Path
    run: Path | None = None
    rig: Path | None = None
    details: Path | None = None
    constraint: str | None = None
    repeatability_mm: float = 0.0
    continuous: bool = False
    joints: Path | None = None
    robot: str | None = None
    columns: str = ""
    """Assignment of columns of another instrument's trajectory, in the form of `--columns`."""
    u_position_mm: float | None = None
    u_rotation_deg: float | None = None
    """Standard uncertainties of the trajectory, instead of the file's."""
    sealed: bool = False
    """True for files in a sealed folder: lines of the trajectory's file that were ignored at sealing are ignored again."""

    @property
    def beside(self) -> Stated:
        """Return the messages about the trajectory's file beside it."""
        turn = None if self.u_rotation_deg is None else math.radians(self.u_rotation_deg)
        return Stated(columns_of(self.columns), self.u_position_mm, turn, of_others=self.sealed)

    def copies(self) -> dict[str, Path]:
        """Every file that is read, by its name in the bundle. CertificationError when one lies where no copy of the folder can keep it."""
        out = {f"{INPUTS}/trajectory{self.trajectory.suffix.lower()}": self.trajectory, f"{INPUTS}/program.toml": self.program}
        if self.details is not None:
            place = f"{INPUTS}/details.toml"
            out[place] = self.details
            stated = read_details(self.details)
            links = {"logo": stated.logo, "reference.dcc": None if stated.reference is None else stated.reference.dcc}
            for key, link in links.items():
                if link is not None:
                    out[_beside(place, link, f"{self.details}: {key}")] = self.details.parent / link
        if self.joints is not None:
            out[self._joints] = self.joints
        if self._robot is not None:
            out[f"{INPUTS}/robot.toml"] = self._robot
        if self.run is not None:
            head = read_run_head(self.run, self.rig)
            out[f"{INPUTS}/run/run.toml"] = self.run / "run.toml"
            for counts in head.counts:
                out[f"{INPUTS}/run/{_inside(counts, self.run)}"] = counts
            rig = self.run / files.read_toml(self.run / "run.toml")["rig"] if self.rig is None else self.rig
            place = f"{INPUTS}/run/{_inside(rig, self.run)}" if self.rig is None else f"{INPUTS}/rig/rig.toml"
            out[place] = rig
            if head.rig.calibration is not None:
                out[_beside(place, head.rig.calibration, f"{rig}: calibration")] = rig.parent / head.rig.calibration
        taken: dict[str, str] = {}
        for name in out:
            first = taken.setdefault(safe_name(name).casefold(), name)
            if first != name:
                raise CertificationError(message("error.its_copy_would_have", where=out[name], out=out[first]))
        return out

    @property
    def _joints(self) -> str:
        return f"{INPUTS}/joints{'' if self.joints is None else self.joints.suffix.lower()}"

    @property
    def _robot(self) -> Path | None:
        """The robot's file, None for a robot that comes along."""
        return None if self.robot is None or not Path(self.robot).suffix else Path(self.robot)

    def stated(self) -> dict[str, Any]:
        """Return the settings of `inputs_in` besides the files, for certificate.json."""
        return {
            "trajectory": f"{INPUTS}/trajectory{self.trajectory.suffix.lower()}",
            "program": f"{INPUTS}/program.toml",
            "run": None if self.run is None else f"{INPUTS}/run",
            "rig": None if self.rig is None else f"{INPUTS}/rig/rig.toml",
            "details": None if self.details is None else f"{INPUTS}/details.toml",
            "constraint": self.constraint,
            "repeatability_mm": self.repeatability_mm,
            **{name: getattr(self, name) for name in _BESIDE if getattr(self, name) not in (None, "", False)},
            **({} if self.joints is None else {"joints": self._joints}),
            **({} if self._robot is None else {"robot": f"{INPUTS}/robot.toml"}),
        }


def inputs_in(folder: Path, stated: dict[str, Any]) -> Inputs:
    """Return the inputs of a bundle, from the output of `Inputs.stated`; CertificationError if it is anything else."""
    places: dict[str, Any] = {}
    for key in ("trajectory", "program", "run", "rig", "details", "joints"):
        name = stated.get(key)
        if isinstance(name, str):
            places[key] = folder / safe_name(name)
        elif name is not None or key in ("trajectory", "program"):
            raise CertificationError(message("error.certificate_json_measurement_is", key=key))
    constraint, repeatability = stated.get("constraint"), stated.get("repeatability_mm")
    if not isinstance(constraint, str | None) or not isinstance(repeatability, float):
        raise CertificationError(message("error.certificate_json_measurement_constraint"))
    beside = {name: stated[name] for name in _BESIDE if name in stated}
    if not all(isinstance(value, _BESIDE[name]) for name, value in beside.items()):
        raise CertificationError(message("error.certificate_json_measurement_columns"))
    if Path(beside.get("robot", "")).suffix:
        beside["robot"] = str(folder / safe_name(beside["robot"]))
    return replace(Inputs(**places), constraint=constraint, repeatability_mm=repeatability, sealed=True, **beside)


def settings_from(stated: Any, *, earlier: bool = False) -> CertificationSettings:
    """Return settings from the output of `settings_stated`; CertificationError if it is anything else. earlier: later settings may be
    missing."""
    known = {f.name for f in fields(CertificationSettings)}
    if not isinstance(stated, dict) or not set(stated) <= known or (set(stated) != known and not earlier):
        raise CertificationError(message("error.certificate_json_settings_are"))
    try:
        return TypeAdapter(CertificationSettings).validate_python(stated)
    except ValidationError:
        raise CertificationError(message("error.certificate_json_settings_hold")) from None


def settings_stated(settings: CertificationSettings) -> dict[str, Any]:
    """All settings, for certificate.json; None where there is no limit."""
    return {f.name: _listed(getattr(settings, f.name)) for f in fields(CertificationSettings)}


def _listed(value: Any) -> Any:
    return [_listed(v) for v in value] if isinstance(value, tuple) else value


def _inside(path: Path, folder: Path) -> str:
    return PurePosixPath(*path.relative_to(folder).parts).as_posix()


def _beside(place: str, link: str, what: str) -> str:
    """Return the name in the bundle of a file that a copied one, at its place there, links to by a relative name; what: file and key of the
    link."""
    parts = list(PurePosixPath(place).parent.parts)
    target = PurePosixPath(link.replace("\\", "/"))
    for part in target.parts:
        if part != "..":
            parts.append(part)
        elif len(parts) > 1:
            parts.pop()
        else:
            parts = []
            break
    if target.is_absolute() or not parts:
        raise CertificationError(message("error.lies_too_far_from", what=what, link=link))
    return "/".join(parts)


@dataclass(frozen=True)
class Measured:
    """Result of a measurement. trajectory: the poses that were evaluated, from the counts when there is a run.

    systematic_sha256: digest of the rig and its calibration, where nothing else is systematic in the run: measurements that have it in
    common share their systematic errors. None where that is not so, or not known.
    """

    evaluation: Evaluation
    trajectory: Trajectory
    program: Program
    details: Details
    rig: Rig | None = None
    calibration: CalibrationRecord | None = None
    systematic_sha256: str | None = None
    notes: tuple[Message | str, ...] = ()
    logo: Logo | None = None


def measure(
    inputs: Inputs,
    settings: CertificationSettings,
    progress: Progress | None = None,
    *,
    same: bool = True,
    trajectory: Trajectory | None = None,
) -> Measured:
    """Evaluate a measurement from its files.

    With a run the poses are those of its counts, and the trajectory file must contain the same; else CertificationError names the row.
    same: False for a file by another method, which may contain other poses. trajectory: that of the run by the same settings, if it is
    already known. Raises the errors of the files' readers, of `reconstruct` and of `evaluate`.
    """
    program = read_program(inputs.program)
    found = _measured(inputs, program, settings, progress, same=same, known=trajectory)
    unused = undecided(found.evaluation.characteristics, program.tolerance)
    if unused is not None:
        where = "".join(f" at {name}" for name in (unused.pose, unused.path) if name is not None)
        raise CertificationError(
            message("error.tolerance_of_no_characteristic", where=inputs.program, characteristic=unused.characteristic, where2=where)
        )
    return found


def _measured(
    inputs: Inputs, program: Program, settings: CertificationSettings, progress: Progress | None, *, same: bool, known: Trajectory | None
) -> Measured:
    details, logo = Details(), None
    doubts: tuple[Message, ...] = ()
    if inputs.details is not None:
        details = read_details(inputs.details)
        logo = read_logo(inputs.details, details)
        details, doubts = with_reference(details, inputs.details)
    if inputs.run is None:
        trajectory = read_trajectory(inputs.trajectory, replace(inputs.beside, angles=settings.angles, likely=program.angles))
        evaluation = evaluate(trajectory, program, settings=settings, progress=progress)
        return Measured(evaluation, trajectory, program, details, logo=logo, notes=(*doubts, *trajectory.notes))
    run = read_run(inputs.run, inputs.rig)
    aligned = align(run)
    model: ErrorModel
    without: tuple[Message, ...] = ()
    if inputs.continuous:
        joints = None
        if inputs.joints is not None and inputs.robot is not None:
            robot = any_shipped(inputs.robot) if inputs._robot is None else read_robot(inputs._robot)
            joints = read_joint_log(inputs.joints, robot.model)
        trajectory, curve = reconstruct_curve(aligned, inputs.constraint, joints=joints)
        if joints is not None:
            alone, own = reconstruct_curve(aligned, inputs.constraint)
            without = _without_log(evaluate(alone, program, ErrorsOfCurve(own), run=run, settings=settings))
        model = ErrorsOfCurve(curve)
    else:
        trajectory = reconstruct(aligned, inputs.constraint, inputs.repeatability_mm, covariances=False) if known is None else known
        model = ErrorsOfRun(aligned, inputs.constraint, inputs.repeatability_mm)
    if same:
        _check_same(inputs.trajectory, trajectory)
    evaluation = evaluate(trajectory, program, model, run=run, settings=settings, progress=progress)
    notes: tuple[Message | str, ...] = (*doubts, *trajectory.notes, *without, *trajectory.assumed.lines)
    return Measured(evaluation, trajectory, program, details, run.rig, run.calibration, _systematic(run), notes, logo)


def _without_log(found: Evaluation) -> tuple[Message, ...]:
    """Return a note on each main result without the joint log."""
    every = [c for c in found.characteristics if c.name in MAIN]
    return tuple(
        message("curve.without_log", name=c.name, where=c.pose or c.path or "", value=c.value, unit=c.unit, u95=c.u95) for c in every
    )


def _systematic(run: Run) -> str | None:
    # errors of the start pose, clocks of passes and temperature differ from run to run
    of_run = any(run.start_errors.u) or run.rig.passes > 1 or run.temperature_c is not None or run.unstated == "typical"
    if run.calibration is None or of_run:
        return None
    # angles of drums and pulleys differ from run to run
    if unsolved_stated(run.rig, kinds=OTHERS):
        return None
    return digest([run.rig.model_dump(mode="json"), run.calibration.model_dump(mode="json")])


def _check_same(path: Path, trajectory: Trajectory) -> None:
    """OtherTrajectoryError names the first row in which a trajectory file is not the trajectory of the run."""
    names = ("time_s", *POSITION_COLUMNS, *QUATERNION_COLUMNS)
    table = files.read_table(path, only=names)
    if len(table) != len(trajectory.time_s):
        raise OtherTrajectoryError(message("error.has_rows_but_the", where=path, n_table=len(table), n_time_s=len(trajectory.time_s)))
    allowed = [SAME_TIME_S, *[SAME_POSITION_MM] * 3, *[SAME_QUATERNION] * 4]
    for i, name in enumerate(names):
        expected = trajectory.time_s if i == 0 else trajectory.poses[:, i - 1]
        found = table.numbers(name, gaps=name != "time_s")
        same = (np.abs(found - expected) <= allowed[i]) | (np.isnan(found) & np.isnan(expected))
        if not same.all():
            row = int(np.argmax(~same))
            raise OtherTrajectoryError(
                message("error.row_is_not_what", where=path, row=row, name=name, found=found[row], expected=expected[row])
            )
