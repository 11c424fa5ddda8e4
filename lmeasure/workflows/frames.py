"""From poses of a robot and of an instrument to where they stand to each other."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from lmeasure.core import RobotError, SettingsError
from lmeasure.text import composed, message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, known_convention, option, radians_of

if TYPE_CHECKING:
    from lmeasure.robots import GivenPoses, Identified


class Settings(Writing):
    """Settings of `lmeasure frames`."""

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
        """Frames from two tables of poses."""
        return Paths((self.out,), (self.robot, self.measured))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Identified[GivenPoses]]":
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
    # where the residuals tell what the poses scatter by, they do so from so many of them
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
