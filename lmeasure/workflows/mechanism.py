"""Study of a mechanism: at a pose, along its coordinates, over a grid of places, at the poses of a table."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from lmeasure.core import FileFormatError, GeometryError, SettingsError
from lmeasure.text import composed, message, of_terminal, reason, settled
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, workflow
from lmeasure.workflows.settings import (
    LANGUAGE,
    RERUN,
    Paths,
    Point,
    Quaternion,
    Range,
    Recording,
    Writing,
    option,
    places_of,
    pose_with,
    radians_of,
    refuse,
    then,
)

if TYPE_CHECKING:
    from lmeasure.core import FloatArray
    from lmeasure.robots import Grid, ParallelFile

AT_A_POSE, WORKSPACE, TABLE = "At a pose", "Workspace", "Poses of a table"
PLACES = "start:stop:step of the tested positions."
KINDS = Literal["point-on-a-line", "line-in-a-plane", "line", "point", "plane"]


class MechanismSettings(Writing):
    OUT_FILE: ClassVar[str] = "mechanism.json"
    robot: Annotated[
        str,
        option("Mechanism: a name (such as rotopod, crank-platform) or a robot.toml of kind parallel.", metavar="ROBOT", positional=True),
    ]
    out: Annotated[Path | None, option("JSON file to write all results to.", metavar="FILE.json")] = None
    position_mm: Annotated[
        Point | None, option("Position of the platform in the base frame; default home.", metavar="X,Y,Z", panel=AT_A_POSE)
    ] = None
    quaternion: Annotated[Quaternion | None, option("Orientation of the platform; default home.", metavar="X,Y,Z,W", panel=AT_A_POSE)] = (
        None
    )
    matrices: Annotated[bool, option("Print the Jacobians A and B, and the velocity matrix V.", panel=AT_A_POSE)] = False
    x: Annotated[Range | None, option(PLACES, metavar="START:STOP:STEP", panel=WORKSPACE, unit="mm")] = None
    y: Annotated[Range | None, option(PLACES, metavar="START:STOP:STEP", panel=WORKSPACE, unit="mm")] = None
    z: Annotated[Range | None, option(PLACES, metavar="START:STOP:STEP", panel=WORKSPACE, unit="mm")] = None
    yaw_free: Annotated[bool, option("Count a position as inside if any turn about the vertical is inside.", panel=WORKSPACE)] = False
    tilt_deg: Annotated[
        float | None,
        option("Also test orientations: each component of the rotation vector from -TILT to TILT.", panel=WORKSPACE, ge=0.0, le=85.0),
    ] = None
    tilt_rad: Annotated[float | None, option("The same in radians, in place of --tilt-deg.", panel=WORKSPACE, ge=0.0, le=1.5)] = None
    tilt_steps: Annotated[int, option("Steps of each component.", panel=WORKSPACE, ge=1, le=99)] = 3
    drives: Annotated[
        int | None, option("Find the workspace by enumerating the drives, each at this number of values.", panel=WORKSPACE, ge=2, le=2000)
    ] = None
    poses: Annotated[Path | None, option("Poses of the platform: x_mm, y_mm, z_mm, qx, qy, qz, qw.", panel=TABLE)] = None
    joints: Annotated[Path | None, option("Table of their joint values to write.", metavar="FILE.csv", panel=TABLE)] = None
    angles: Annotated[str, option("Convention of angle columns.", panel=TABLE)] = "puma-oat"
    complete: Annotated[
        KINDS | None,
        option("Coordinates that the poses state; the first rods determine the others, and all solutions are written.", panel=TABLE),
    ] = None
    report: Annotated[Path | None, option("Write mechanism.html, with pictures, into this folder.", metavar="DIR")] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        if self.report is None:
            return then("mechanism {robot} --report mechanism", robot=self.robot)
        return then("plan-poses --robot {robot} --poses 30 --out planned.csv", robot=self.robot)

    def paths(self) -> Paths:
        robot = Path(self.robot)
        report = () if self.report is None else inside(self.report, "mechanism.html")
        inputs = present(self.poses, robot if robot.suffix else None)
        return Paths((*present(self.out, self.joints, self.rerun), *report), inputs)


@workflow
def run_mechanism(settings: MechanismSettings, progress: Progress = silent) -> Result:
    """Describe the mechanism, and write the requested files."""
    from lmeasure.io import files
    from lmeasure.robots import described

    _check(settings)
    file = _mechanism(settings.robot)
    try:
        record = described(file, _pose(settings, file))
        grid, reached = _grid(settings, file, progress)
    except GeometryError as error:
        raise SettingsError("position_mm" if settings.x is None else "x", reason(error)) from None
    progress(0.9, "mechanism")
    lines = _result_lines(record, grid)
    if settings.matrices:
        lines += [
            message("mechanism_line.matrix", name=name, values=tuple(settled(v) for v in row))
            for name in "ABV" for row in record[name] or ()
        ]  # fmt: skip
    if grid is not None:
        record["workspace"] = {
            **dict([grid.found.size]),
            **({} if grid.every is None else {f"every_orientation_{n}": v for n, v in [grid.found.size_of(grid.every)]}),
            "poses": grid.poses,
            "places": int(grid.found.inside.sum()),
            "yaw_free": grid.yaw_free,
            "ended_by": grid.ended_by,
        }
    if settings.poses is not None and settings.joints is not None:
        lines.append(_table(settings, file, settings.poses, settings.joints))
    if reached is not None and settings.joints is not None:
        lines.append(_enumerated(file, settings.joints, reached))
    if settings.out is not None:
        files.write_json(settings.out, record)
    if settings.report is not None:
        from lmeasure.report import write_mechanism_page

        write_mechanism_page(settings.report / "mechanism.html", file, record, grid, language=settings.language or of_terminal())
    if settings.rerun is not None:
        from lmeasure.view import write_mechanism_recording

        write_mechanism_recording(settings.rerun, file)
    progress(1.0, "mechanism")
    lines += [message("line.written", files=settings.report / "mechanism.html")] if settings.report is not None else []
    figures = {"freedoms": float(record["freedoms"]), "nearness": record["nearness"]}
    figures |= {} if grid is None else dict([grid.found.size])
    return Result(record, tuple(lines), figures)


def _check(settings: MechanismSettings) -> None:
    axes = (settings.x, settings.y, settings.z)
    if any(a is None for a in axes) and not all(a is None for a in axes):
        raise SettingsError("x, y, z", message("error.give_all_three_for"))
    if settings.x is None:
        refuse(settings, message("refuse.coordinates"), "yaw_free", "tilt_deg", "tilt_rad", "drives")
    if settings.drives is not None:
        refuse(settings, message("refuse.not_drives"), "yaw_free", "tilt_deg", "tilt_rad", "poses")
    if settings.tilt_deg is not None and settings.tilt_rad is not None:
        raise SettingsError("tilt_rad", message("error.is_given_and_so_is"))
    if settings.drives is None and (settings.poses is None) != (settings.joints is None):
        raise SettingsError("poses", message("error.goes_with_joints_file"))
    if settings.complete is not None and settings.poses is None:
        raise SettingsError("complete", message("error.goes_with_poses_and"))


def _mechanism(name: str) -> "ParallelFile":
    from lmeasure.robots import ParallelFile
    from lmeasure.workflows.identify import nominal

    found = nominal(name)
    if not isinstance(found, ParallelFile):
        raise SettingsError("robot", message("error.is_of_kind_a", name=name, kind=found.kind))
    return found


def _pose(settings: MechanismSettings, file: "ParallelFile") -> "FloatArray | None":
    if settings.position_mm is None and settings.quaternion is None:
        return None
    home = file.model.home
    quaternion = tuple(home[3:]) if settings.quaternion is None else settings.quaternion
    return pose_with(home[:3] if settings.position_mm is None else settings.position_mm, quaternion)


def _grid(
    settings: MechanismSettings, file: "ParallelFile", progress: Progress
) -> "tuple[Grid | None, tuple[FloatArray, FloatArray] | None]":
    """The workspace, and the joint values and poses that were enumerated for it."""
    from lmeasure.robots import Turns, over_drives, over_grid

    if settings.x is None or settings.y is None or settings.z is None:
        return None, None
    x, y, z = (places_of(span, name, 1, 2000) for name, span in (("x", settings.x), ("y", settings.y), ("z", settings.z)))
    if settings.drives is not None:
        grid, joints, poses = over_drives(file, (x, y, z), settings.drives, progress=lambda share: progress(0.9 * share, "mechanism"))
        return grid, (joints, poses)
    pose = _pose(settings, file)
    orientation = (file.model.home if pose is None else pose)[3:]
    tilt = settings.tilt_rad or radians_of(settings.tilt_deg) or 0.0
    turns = Turns(tilt, settings.tilt_steps if tilt else 1, settings.yaw_free)
    return over_grid(file, (x, y, z), orientation, turns, progress=lambda share: progress(0.9 * share, "mechanism")), None


def _enumerated(file: "ParallelFile", out: Path, reached: "tuple[FloatArray, FloatArray]") -> str:
    """Write joint values and poses that were enumerated."""
    from lmeasure.io import files
    from lmeasure.recording import pose_columns, poses_from_rows
    from lmeasure.robots import joint_columns

    joints, poses = reached
    files.write_table(
        out, pose_columns(poses_from_rows(poses, [str(i + 1) for i in range(len(poses))])) | joint_columns(file.model, joints)
    )
    return message("workflows.poses_enumerated", count=len(poses), file=out)


def _result_lines(record: dict[str, Any], grid: "Grid | None") -> list[str]:
    lines: list[str] = [
        message("mechanism_line.freedoms", name=record["name"], freedoms=record["freedoms"], parameters=record["parameters"])
    ]
    lines.append(message("mechanism_line.pose", place=tuple(map(float, record["position_mm"]))))
    joints = tuple(message("mechanism_line.joint", name=name, value=value) for name, value in record["joints"].items())
    lines.append(message("mechanism_line.joints", values=joints))
    lines.append(
        message(
            "workflows.singular_smallest_over_largest",
            kind=message(f"mechanism.singular_{record['singular'].replace(' ', '_')}"),
            near=record["nearness"],
        )
    )
    mobility = record["mobility"]
    pairs = tuple(f"{name} = {count}" for name, count in mobility["pairs"].items() if count)
    lines.append(
        message("mechanism_line.mobility", bodies=mobility["bodies"], pairs=pairs, n=mobility["freedoms"], own=mobility["rods_turn"])
    )
    if "by_steps" in record:
        steps = record["by_steps"]
        lines.append(message("mechanism_line.by_steps", mm=steps["u95_position_mm"], deg=max(steps["u_rotation_deg"])))
    broken = [name for name, kept in record["limits_kept"].items() if not kept]
    if broken:
        lines.append(message("workflows.outside_limits", names=tuple(broken)))
    if "ranges" in record:
        codes = {name: f"mechanism_line.range_{'deg' if name.startswith('r') else 'mm'}" for name in record["ranges"]}
        ranges = tuple(message(codes[n], name=n, low=a, high=b) for n, (a, b) in record["ranges"].items())
        lines.append(message("mechanism_line.goes", ranges=ranges))
    if "commanded" in record:
        lines.append(message("workflows.told_others_follow", names=tuple(record["commanded"])))
    if "leg_turns_deg" in record:
        turns = tuple(map(float, record["leg_turns_deg"].values()))
        lines.append(message("mechanism_line.legs", values=turns))
    if grid is not None:
        from lmeasure.report import workspace_words

        lines.append(message("workflows.workspace", words=workspace_words(grid)))
    return lines


def _table(settings: MechanismSettings, file: "ParallelFile", poses: Path, out: Path) -> str:
    """Return joint values of a table's poses, or the rest of its columns."""
    import numpy as np

    from lmeasure.io import files
    from lmeasure.recording import pose_columns, poses_from_rows, read_poses
    from lmeasure.robots import at_poses, completions

    given = read_poses(poses, settings.angles, unnamed=True)
    if settings.complete is None:
        try:
            columns = at_poses(file, given.rows, _times(poses))
        except GeometryError as error:
            raise FileFormatError(composed("{where}: {error}", where=poses, error=error)) from None
        files.write_table(out, {"pose": list(given.names), **columns})
        kept = int(columns["kept"].sum())
        return message(
            "workflows.poses_reached_within_all",
            count=len(given.rows),
            reached=int(np.isfinite(columns["nearness"]).sum()),
            kept=kept,
            file=out,
        )
    try:
        rows, found = completions(file, settings.complete.replace("-", " "), given.rows)
    except GeometryError as error:
        raise FileFormatError(composed("{where}: {error}", where=poses, error=error)) from None
    names = [f"{given.names[row]}_{1 + int((rows[:k] == row).sum())}" for k, row in enumerate(rows)]
    files.write_table(out, pose_columns(poses_from_rows(found, names)))
    return message("workflows.poses_completed_completions", count=len(given.rows), done=len(np.unique(rows)), all=len(found), file=out)


def _times(poses: Path) -> "FloatArray | None":
    """Times of a table of poses; None where it has none. FileFormatError where they do not rise."""
    import numpy as np

    from lmeasure.io import files

    table = files.read_table(poses)
    if "time_s" not in table.columns:
        return None
    time_s = table.numbers("time_s")
    if not (np.diff(time_s) > 0.0).all():
        row = int(np.argmin(np.diff(time_s) > 0.0)) + 2
        raise FileFormatError(message("error.row_time_s_does", where=poses, row=row))
    return time_s
