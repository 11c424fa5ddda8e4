"""Kinematic calibration: a robot's errors from measurements."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from lmeasure.core import RobotError, SettingsError
from lmeasure.text import composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, workflow
from lmeasure.workflows.settings import LANGUAGE, RERUN, Names, Paths, Recording, Writing, known_convention, option, radians_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lmeasure.robots import AnyRobot, CrossValidation, Identified, Measurements, Noted


MAPPING = "NAME=COLUMN[UNIT],..."
TIP = option("Flange link of a .urdf; the chain ends there.", metavar="LINK")
BASE_LINK = option("Base link of a .urdf; the chain starts there.", metavar="LINK")


class IdentifySettings(Writing):
    NEXT: ClassVar[str] = "correct program.csv --identified {out} --out corrected"
    robot: Annotated[str, option("Nominal robot: a name (such as ur5, generic7, gough), a robot.toml or a .urdf.", metavar="NAME_OR_FILE")]
    measurements: Annotated[
        Path, option("Joint values with measured poses; with --joints: points, a run folder, or a trajectory.", metavar="FILE|RUN")
    ]
    out: Annotated[Path, option("Folder for identified.json, robot.toml, robot.urdf and report.html.")]
    joints: Annotated[
        Path | None, option("Separate table of joint values: for points by name, for rests by time or in order.", metavar="FILE")
    ] = None
    predict: Annotated[Path | None, option("Joint values for predicted positions, written to predictions.csv.", metavar="FILE")] = None
    harmonics: Annotated[bool, option("Also free the joints' errors once and twice per turn.")] = False
    free: Annotated[
        Names,
        option(
            "Parameters to free besides links: once, twice (or harmonics for both), scale, stiffness, backlash; links: no others. "
            "Default: chosen by the measurements.",
            metavar="FAMILY,...",
        ),
    ] = ()
    columns: Annotated[str, option("Meaning and unit of each column (mm, m, cm, um, in, deg, rad).", metavar=MAPPING)] = ""
    tip: Annotated[str | None, TIP] = None
    base_link: Annotated[str | None, BASE_LINK] = None
    u_position_mm: Annotated[float | None, option("Standard uncertainty of each measured coordinate; default from the file.", ge=0)] = None
    u_rotation_deg: Annotated[float | None, option("Standard uncertainty of a measured orientation about each axis.", ge=0)] = None
    u_links_mm: Annotated[
        float | None, option("Standard uncertainty of the nominal lengths of links or legs; default 3.", ge=1e-6, le=1000)
    ] = None
    u_links_deg: Annotated[float | None, option("Standard uncertainty of the nominal angles; default 0.5.", ge=1e-6, le=180)] = None
    keep_outliers: Annotated[bool, option("Also use rows that contradict the others.")] = False
    weights: Annotated[Literal["cut", "biweight"], option("Weights of contradicting rows: excluded, full weight, or Tukey's biweight.")] = (
        "cut"
    )
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    seed: Annotated[int, option("Seed of starts, folds and random sets.", ge=0)] = 0
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        outputs = inside(self.out, "identified.json", "robot.toml", "robot.urdf", "report.html", "workspace.csv")
        outputs += inside(self.out, "predictions.csv") if self.predict is not None else ()
        robot = Path(self.robot)
        measured = in_run_folder(self.measurements) if self.measurements.is_dir() else (self.measurements,)
        return Paths((*outputs, *present(self.rerun)), (*measured, *present(self.joints, self.predict, robot if robot.suffix else None)))


@workflow
def run_identify(settings: IdentifySettings, progress: Progress = silent) -> Result:
    """Identify, and write record, robot, page and predictions."""
    import numpy as np

    from lmeasure.demo import judge, write_identification
    from lmeasure.io import columns_of, files
    from lmeasure.robots import (
        FAMILIES,
        Settings as Chosen,
        check_foreign,
        identify,
        identify_with_choice,
        mended,
        predict,
        prediction_columns,
        read_measurements,
        read_robot_measurements,
        summary,
        unmoved_in,
    )
    from lmeasure.trajectory import Stated

    unknown = [f for f in settings.free if f not in (*FAMILIES, "harmonics")]
    if unknown:
        known = ", ".join((*FAMILIES, "harmonics"))
        raise SettingsError("free", message("error.is_nothing_that_can_be", unknown=unknown[0], names=known))
    if settings.keep_outliers and settings.weights == "biweight":
        raise SettingsError("keep_outliers", message("error.with_weights_biweight_every"))
    out, columns = settings.out, columns_of(settings.columns)
    robot = nominal(settings.robot, settings.tip, settings.base_link)
    if "stiffness" in settings.free and getattr(robot, "payload", None) is None:
        raise SettingsError("free", message("error.stiffness_needs_a_load"))
    turn = None if settings.u_rotation_deg is None else math.radians(settings.u_rotation_deg)
    measured = read_robot_measurements(settings.measurements, settings.joints, robot.model, Stated(columns, settings.u_position_mm, turn))
    rows = measured.rows
    # read before any computation, so that errors appear at once
    requested = None if settings.predict is None else read_measurements(settings.predict, robot.model, columns, joints_alone=True)
    unasked: list[str] = []
    if requested is not None:
        requested, unasked = _measured_targets(requested, rows, settings.predict)
    progress(0.05, "looking for slips")
    mend = mended(robot, rows, settings.seed)
    progress(0.2, "identifying")
    families = tuple(dict.fromkeys(("links", *(("harmonics",) if settings.harmonics else ()), *settings.free)))
    chosen = Chosen(
        families,
        not settings.keep_outliers,
        settings.seed,
        weights=settings.weights,
        u_links_mm=settings.u_links_mm,
        u_links_deg=settings.u_links_deg,
    )
    try:
        if settings.free or settings.harmonics:
            found = identify(mend.robot.model, mend.rows, chosen)
        else:
            found = identify_with_choice(mend.robot.model, mend.rows, chosen)
        check_foreign(found)
    except RobotError as error:
        raise RobotError(message("error.robot", where=settings.measurements, name=robot.name, error=error)) from None
    findings = (*measured.notes, *mend.findings, *found.findings)
    progress(0.5, "holding rows out")
    done = judge(found, [path for path in settings.paths().inputs if path.is_file()], findings, settings.seed)
    found, record = done.found, done.record
    progress(0.9, "writing")
    names = write_identification(out, mend.robot, done, settings.language or of_terminal())
    if requested is not None:
        of = np.array([rows.targets.index(requested.targets[i]) for i in requested.target_of])
        joints = mend.joints(requested.joints)
        predicted = predict(found, joints, of)
        findings = (*findings, *unmoved_in(found, joints, predicted.u95_mm, str(settings.predict)))
        files.write_table(out / "predictions.csv", prediction_columns(requested.names, predicted))
        names.insert(names.index("report.html") + 1, "predictions.csv")
    if settings.rerun is not None:
        _record(settings.rerun, found, done.held, findings)
    figures = {p["name"]: p["value"] for p in record["parameters"]} | {"noise_mm": record["noise"]["position_mm"]}
    written = message("line.written", files=tuple(str(out / name) for name in names))
    reported = (*(f"{f.code}: {f.text}" for f in findings), *unasked)
    lines = (*summary(found, done.held, findings, done.over), *(f"warning {text}" for text in unasked), *frames_of(robot))
    return Result(found, (*lines, written), figures, reported)


def _record(path: Path, found: "Identified[Any]", held: "CrossValidation | None", findings: "Iterable[Noted]") -> None:
    """Draw the measured positions, and the errors of the nominal and the identified robot, at validation rows with their U95."""
    import numpy as np

    from lmeasure.view import Series, write_scene

    before, after = (np.linalg.norm(e, axis=1) for e in (found.nominal_errors_mm(), found.errors_mm()))
    series = {("error_mm", "nominal"): Series(before), ("error_mm", "identified"): Series(after)}
    if held is not None:
        series["validation_mm", "error"] = Series(held.error_mm, held.u95_mm)
    points = {"measured": (found.rows.names, found.rows.position)}
    write_scene(path, found.nominal.name, points=points, series=series, notes=[f"{f.code}: {f.text}" for f in findings])


def _measured_targets(requested: "Measurements", rows: "Measurements", path: Path | None) -> "tuple[Measurements, list[str]]":
    """Return the rows to predict whose target was measured, and a line for each target that was not; SettingsError where none was."""
    import numpy as np

    strange = [name for name in requested.targets if name not in rows.targets]
    keep = np.array([requested.targets[i] not in strange for i in requested.target_of], dtype=np.bool_)
    measured = ", ".join(rows.targets)
    if not keep.any():
        raise SettingsError("predict", message("error.target_was_not_measured", where=path, strange=strange[0], measured=measured))
    counts = {name: int((requested.target_of == requested.targets.index(name)).sum()) for name in strange}
    reported: list[str] = [message("workflows.target_not_measured", name=name, measured=measured, n=n) for name, n in counts.items()]
    return requested.of(np.flatnonzero(keep)), reported


def frames_of(robot: "AnyRobot") -> list[str]:
    """Return which links of a .urdf are the controller's base and flange."""
    links = [getattr(getattr(robot, frame, None), "link", None) for frame in ("base", "flange")]
    return [message("workflows.urdf_base_base_link", base=links[0], flange=links[1])] if all(links) else []


def nominal(name: str, tip: str | None = None, base_link: str | None = None) -> "AnyRobot":
    """A robot by the name under which it comes along, or from a robot.toml or .urdf."""
    from lmeasure.robots import any_shipped, read_robot, read_urdf, shipped_names

    path = Path(name)
    if path.suffix.lower() == ".urdf":
        return read_urdf(path, tip, base_link)
    if path.suffix.lower() == ".xacro":
        raise SettingsError("robot", message("error.is_a_template_of", name=name, name2=path.name))
    for option_name, link in (("tip", tip), ("base_link", base_link)):
        if link is not None:
            raise SettingsError(option_name, message("error.goes_with_a_urdf"))
    if not path.suffix and name not in shipped_names():
        raise SettingsError("robot", message("error.is_no_robot_that", name=name, shipped_names=", ".join(shipped_names())))
    return read_robot(path) if path.suffix else any_shipped(name)


class FramesSettings(Writing):
    NEXT: ClassVar[str] = "inspect {out}"
    OUT_FILE: ClassVar[str] = "frames.json"
    robot: Annotated[
        Path, option("Poses of the flange in the robot's base: pose, x_mm, y_mm, z_mm, angles or quaternions.", metavar="FILE")
    ]
    measured: Annotated[Path, option("Poses of the target in the instrument's frame, under the same names.", metavar="FILE")]
    out: Annotated[Path, option("File for base and tool with their covariance.", metavar="FILE.json")]
    angles: Annotated[str, option("Convention of angle columns.")] = "puma-oat"
    columns: Annotated[
        str, option("Meaning and unit of each column of the two tables (mm, m, cm, um, in, deg, rad).", metavar="NAME=COLUMN[UNIT],...")
    ] = ""
    u_position_mm: Annotated[float | None, option("Standard uncertainty of each measured coordinate; default from the file.", ge=0)] = None
    u_rotation_deg: Annotated[float | None, option("Standard uncertainty of a measured orientation about each axis.", ge=0)] = None
    seed: Annotated[int, option("Seed of starts.", ge=0)] = 0

    def paths(self) -> Paths:
        return Paths((self.out,), (self.robot, self.measured))


@workflow
def run_frames(settings: FramesSettings, progress: Progress = silent) -> Result:
    """Find base and tool, and write them."""
    import math

    import numpy as np
    import scipy.stats

    from lmeasure.io import ForeignTable, columns_of, files
    from lmeasure.recording import read_poses
    from lmeasure.robots import frames, unknown_frames

    known_convention(settings.angles)
    columns = columns_of(settings.columns)
    paths = (settings.robot, settings.measured)
    there = {name for path in paths for name in ForeignTable(path, columns, part=True).mapped} if columns else set()
    stray = next((name for name in columns if name not in there), None)
    if stray is not None:
        raise SettingsError(
            "columns", message("error.neither_nor_has_such", stray=stray, name=columns[stray].name, paths=paths[0], paths2=paths[1])
        )
    robot = read_poses(settings.robot, settings.angles, columns, part=True)
    seen = read_poses(settings.measured, settings.angles, columns, positions_alone=True, part=True)
    try:
        found = frames(robot, seen.with_uncertainty(settings.u_position_mm, radians_of(settings.u_rotation_deg)), settings.seed)
    except RobotError as error:
        raise RobotError(composed("{robot}, {measured}: {error}", robot=settings.robot, measured=settings.measured, error=error)) from None
    alone = tuple(
        message("workflows.pose_stands_alone_left", name=name, path=path)
        for path, own, other in ((settings.robot, robot, seen), (settings.measured, seen, robot))
        for name in own.names
        if name not in set(other.names)
    )
    progress(0.9, "writing")
    fit, state = found.fit, found.state
    u = np.sqrt(np.diag(fit.covariance))
    # degrees of freedom if the residuals determine the scatter of the poses
    factor = float(scipy.stats.t.ppf(0.975, fit.freedom if found.settings.own_noise else np.inf))
    parameters: list[dict[str, Any]] = [
        {"name": name, "value": float(value), "u": float(s), "u95": factor * float(s), "unit": "deg" if name.endswith("_deg") else "mm"}
        for name, value, s in zip(fit.problem.names, fit.problem.unknowns.values(fit.x), u, strict=True)
    ]
    silent_texts = [s.text for s in unknown_frames(fit)]
    content: dict[str, Any] = {
        "schema": "lmeasure.frames/1",
        "base": _pose(state.base),
        "tool": _pose(state.targets[0]),
        "parameters": parameters,
        "covariance": fit.covariance.tolist(),
        "chi_squared": fit.chi2,
        "freedom": fit.freedom,
        "noise": {"position_mm": found.noise.position_mm, "rotation_deg": math.degrees(found.noise.rotation_rad)},
        "unobservable": [{"text": text} for text in silent_texts],
        "warnings": [f.stated() for f in found.findings] + [{"code": "unmatched", "text": text} for text in alone],
        "inputs": [{"file": str(p), "sha256": files.sha256(p)} for p in (settings.robot, settings.measured)],
    }
    files.write_json(settings.out, content)
    row = "{name:12s} {value:14.5f}  u {u:.3g}, U95 {u95:.3g} {unit}"
    lines: list[str] = [composed(row, **p | {"unit": message(f"acquisition.unit.{p['unit']}")}) for p in parameters]
    lines += [
        message(
            "workflows.poses_residuals_mm_mean", count=found.kept.sum(), mean=np.linalg.norm(found.errors_mm()[found.kept], axis=1).mean()
        )
    ]
    lines += [*silent_texts, *(message("line.warning", code=f.code, text=f.text) for f in found.findings)]
    lines += [*(message("workflow.unmatched", text=text) for text in alone), message("line.written", files=settings.out)]
    return Result(found, tuple(lines), {p["name"]: p["value"] for p in parameters}, (*(f.text for f in found.findings), *alone))


def _pose(row: Any) -> dict[str, Any]:
    return {"position_mm": [float(v) for v in row[:3]], "quaternion_xyzw": [float(v) for v in row[3:]]}
