"""Planning of reference poses."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from lmeasure.core import CalibrationError, SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.identify import frames_of, nominal
from lmeasure.workflows.settings import (
    BOX,
    RERUN,
    Box,
    Names,
    Numbers,
    Paths,
    Recording,
    UnitQuaternion,
    WholeNumbers,
    Writing,
    option,
    pose_of,
    radians_of,
    then,
)

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from lmeasure.calibration import Campaign, Region
    from lmeasure.core import FloatArray
    from lmeasure.rig import Rig


LIMITS = "What a cable allows"
ROBOT = "Poses of a robot"
STATED = "default exact, with --extend the largest recorded one"

OPTIONS = ("free", "candidates", "columns", "keep_out", "zone", "base", "tool", "tip", "base_link")
"""Options of a robot alone."""


class PlanPosesSettings(Writing):
    OUT_FILE: ClassVar[str] = "planned.csv"
    rig: Annotated[
        Path | None,
        option("Nominal rig; its u_... are the priors. With --robot: the instrument for the robot.", metavar="RIG.toml", positional=True),
    ] = None
    poses: Annotated[int, option("Number of poses; with --extend, number of additional poses.", ge=1, also=("--count",))]
    out: Annotated[Path, option("reference_poses.csv to write; its first pose is the zero pose. With --robot: table of joint values.")]
    box: Annotated[
        Box | None, option("Region of the tool origin [mm]; default with --extend: that of the recorded poses.", metavar=BOX, unit="mm")
    ] = None
    tilt_deg: Annotated[float, option("Largest component of the tilt's rotation vector.", ge=0, le=90)] = 15.0
    quaternion: Annotated[UnitQuaternion | None, option("Centre orientation of the tilts.", metavar="X,Y,Z,W")] = None
    zone_box: Annotated[Box | None, option("Region with the smallest uncertainty; default the box.", metavar=BOX, unit="mm")] = None
    zone_tilt_deg: Annotated[float | None, option("Tilt in the zone; default that of the poses.", ge=0, le=90)] = None
    criterion: Annotated[
        Literal["G", "I", "D"], option("G: least worst variance over the zone; I: least mean variance; D: least determinant.")
    ] = "G"
    extend: Annotated[Path | None, option("Recorded calibration folder to extend; its counters continue.", metavar="FOLDER")] = None
    u_position_mm: Annotated[float | None, option(f"Standard uncertainty of a pose's coordinates; {STATED}.", ge=0)] = None
    u_rotation_deg: Annotated[float | None, option(f"Standard uncertainty of a pose's rotations; {STATED}.", ge=0)] = None
    solve: Annotated[Names, option("Parameters of the later calibration, as in `lmeasure calibrate`.")] = ("position", "guide")
    passes: Annotated[WholeNumbers, option("Passes with measured cables.", flag="--pass", metavar="N,...")] = (1,)
    max_wrap_deg: Annotated[float, option("Largest angle wrapped on a swivel pulley.", ge=1, le=360, panel=LIMITS)] = 170.0
    min_span_mm: Annotated[float, option("Shortest free span from the pulley.", ge=0, panel=LIMITS)] = 100.0
    max_length_mm: Annotated[float, option("Longest cable from B to the attachment point.", ge=1, panel=LIMITS)] = 1e6
    clearance_mm: Annotated[float, option("Least distance between free spans, and to other pulleys.", ge=0, panel=LIMITS)] = 10.0
    min_tension_n: Annotated[float, option("Least tension at drums with a stated tension.", ge=0, panel=LIMITS)] = 0.0
    singular_deg: Annotated[float, option("Least distance to singular orientations of the rig's angles.", ge=0, le=45, panel=LIMITS)] = 2.0
    further: Annotated[int, option("Number of further poses in the table.", ge=0, le=50)] = 3
    rounded: Annotated[bool, option("Round the poses to 0.1 mm and 0.01 degrees in the rig's angles.", flag="--rounded/--exact")] = True
    quaternions: Annotated[bool, option("Write quaternions instead of the rig's angles.")] = False
    seed: Annotated[int, option("Seed of candidates and starts.", ge=0)] = 0
    robot: Annotated[
        str | None, option("Plan poses of this robot for `identify`: a name, a robot.toml or a .urdf.", metavar="NAME_OR_FILE", panel=ROBOT)
    ] = None
    free: Annotated[
        Names, option("Further parameters that `identify` will free, besides links and harmonics.", metavar="FAMILY,...", panel=ROBOT)
    ] = ()
    candidates: Annotated[Path | None, option("Candidate joint values; default all allowed ones.", metavar="FILE", panel=ROBOT)] = None
    columns: Annotated[str, option("Meaning and unit of each column of the candidates.", metavar="NAME=COLUMN[UNIT],...", panel=ROBOT)] = ""
    keep_out: Annotated[Box | None, option("Box [robot's base] without links and targets.", metavar=BOX, unit="mm", panel=ROBOT)] = None
    zone: Annotated[Path | None, option("Zone of the instrument for all targets.", metavar="zone.nc", panel=ROBOT)] = None
    base: Annotated[Numbers | None, option("Robot base in the instrument's frame.", metavar="X,Y,Z[,QX,QY,QZ,QW]", panel=ROBOT)] = None
    tool: Annotated[Numbers | None, option("Target on the flange.", metavar="X,Y,Z[,QX,QY,QZ,QW]", panel=ROBOT)] = None
    tip: Annotated[str | None, option("Flange link of a .urdf; the chain ends there.", metavar="LINK", panel=ROBOT)] = None
    base_link: Annotated[str | None, option("Base link of a .urdf; the chain starts there.", metavar="LINK", panel=ROBOT)] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        if self.robot is not None:
            return then("identify --robot {robot} --measurements measured.csv --out identified", robot=self.robot)
        return then("capture {rig} --poses {out} --bus socketcan:can0 --out campaign", rig=self.rig, out=self.out)

    def paths(self) -> Paths:
        if self.robot is not None:
            outputs, inputs = files_of(self)
            return Paths(outputs, (*present(self.rig), *inputs))
        extended = () if self.extend is None else inside(self.extend, "rig.toml", "reference_poses.csv", "counts.csv")
        return Paths((self.out, *present(self.rerun)), (*present(self.rig), *extended))


def poses_file(out: Path) -> Path:
    """Return the path for the poses of a joint table."""
    return out.with_name(f"{out.stem}_poses.csv")


def files_of(settings: "PlanPosesSettings") -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Outputs, and inputs besides the rig."""
    robot = Path(str(settings.robot))
    return (settings.out, poses_file(settings.out)), present(robot if robot.suffix else None, settings.candidates, settings.zone)


U_MM = 0.05
"""Standard uncertainty of a measured coordinate, robot and instrument together, where none is stated."""
CANDIDATES = 1500


def run_robot(settings: PlanPosesSettings, progress: Progress) -> Result:
    """Plan poses of a robot, and write its joint values and the poses expected at them."""
    import numpy as np

    from lmeasure.core import se3
    from lmeasure.io import columns_of, files
    from lmeasure.recording import pose_columns, poses_from_rows
    from lmeasure.robots import REGULAR, Allowed, freed, joint_columns, planned, read_measurements, to_plan

    robot = nominal(str(settings.robot), settings.tip, settings.base_link)
    model = robot.model
    freed(model, settings.free)  # raises an error for unknown names before any computation
    base = pose_of(settings.base, "base") if settings.base else None
    tool = pose_of(settings.tool, "tool") if settings.tool else None
    sits = tool if tool is not None else robot.tool_pose
    stands = base if base is not None else np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    boxes = np.array([settings.keep_out] if settings.keep_out else []).reshape(-1, 3, 2)
    allowed = Allowed(model, stands, sits, boxes, _zone(settings), REGULAR)
    progress(0.0, "candidates")
    if settings.candidates is not None:
        given = read_measurements(settings.candidates, model, columns_of(settings.columns), joints_alone=True)
        keep = np.flatnonzero(allowed(given.joints))
        joints, names = given.joints[keep], [given.names[i] for i in keep]
        if len(joints) < settings.poses:
            raise SettingsError(
                "candidates",
                message(
                    "error.rows_of_are_allowed", where=settings.candidates, n_joints=len(joints), n_given=len(given), poses=settings.poses
                ),
            )
    else:
        joints, names = allowed.candidates(CANDIDATES, settings.seed), []
        joints = _typed(joints, model.sliding)
        joints = joints[allowed(joints)]
    progress(0.3, "choosing")
    u = settings.u_position_mm or U_MM
    plan = planned(to_plan(model, settings.free, stands, sits, joints=joints), joints, joints, settings.poses, u_mm=u, seed=settings.seed)
    order = plan.order
    own = [names[i] for i in order] if names else [f"P{i + 1}" for i in range(len(order))]
    at = se3.compose(model.forward(joints[order]), np.broadcast_to(sits, (len(order), 7)))
    files.write_table(settings.out, {"name": own, **joint_columns(model, joints[order])})
    expected = replace(poses_from_rows(se3.compose(np.broadcast_to(stands, at.shape), at), own), absent=("position", "rotation"))
    files.write_table(poses_file(settings.out), pose_columns(expected))
    lines: list[str] = [
        message("workflows.poses_candidates_left_uncertain", n=len(order), all=len(joints), u=u),
        *(
            message("workflow.after_mm_random", k=k, expected_mm=plan.expected_mm[k - 1], random_mm=plan.random_mm[k - 1])
            for k in _steps(len(order))
        ),
    ]
    if tool is None and robot.tool is None:
        lines.append(message("workflow.note_no_tool_stated_tool"))
    if base is None and (settings.zone is not None or settings.rig is not None):
        lines.append(message("workflow.note_no_place_robot"))
    lines += [*frames_of(robot), message("workflow.written_6", out=settings.out, poses_file=poses_file(settings.out))]
    figures = {"expected_mm": float(plan.expected_mm[-1]), "random_mm": float(plan.random_mm[-1])}
    return Result(plan, tuple(lines), figures)


def _steps(count: int) -> list[int]:
    return sorted({k for k in (10, 15, 20, 30, 45, 60, 80, 100, 150) if k < count} | {count})


def _typed(joints: "FloatArray", sliding: "np.typing.NDArray[np.bool_]") -> "FloatArray":
    """Joint values as they are typed: to 0.01 degrees or 0.1 mm."""
    import numpy as np

    return np.asarray(np.where(sliding, np.round(joints, 1), np.radians(np.round(np.degrees(joints), 2))))


def _zone(settings: PlanPosesSettings) -> "xr.Dataset | Rig | None":
    from lmeasure.accuracy import read_zone
    from lmeasure.rig import read_rig

    if settings.zone is not None and settings.rig is not None:
        raise SettingsError("zone", message("error.a_zone_or_a"))
    if settings.zone is not None:
        return read_zone(settings.zone)
    return None if settings.rig is None else read_rig(settings.rig)


@workflow
def run_plan_poses(settings: PlanPosesSettings, progress: Progress = silent) -> Result:
    """Plan, and write the poses."""
    import numpy as np

    from lmeasure.calibration import Limits, PlanSettings, further_columns, plan_details, plan_poses, plan_summary
    from lmeasure.core import convention, rounded_angles
    from lmeasure.io import write_table
    from lmeasure.recording import pose_columns
    from lmeasure.rig import read_rig
    from lmeasure.trajectory import proposed_returns

    out, extend = settings.out, settings.extend
    if out.suffix.lower() != ".csv":
        raise SettingsError("out", message("error.does_not_end_in", trend=str(out)))
    if settings.robot is not None:
        return run_robot(settings, progress)
    stray = next((name for name in OPTIONS if getattr(settings, name)), None)
    if stray is not None:
        raise SettingsError(stray, message("error.goes_with_robot"))
    if settings.rig is None:
        raise SettingsError("rig", message("error.is_missing_the_rig"))
    if settings.box is None and extend is None:
        raise SettingsError("box", message("error.say_where_the_robot"))
    rig = read_rig(settings.rig)
    u = settings.u_position_mm, radians_of(settings.u_rotation_deg)
    recorded = None if extend is None else _recorded(extend, u[0] or 0.0, u[1] or 0.0)
    u_position, u_rotation = _uncertainties(u, recorded)
    tilt, zone_tilt = settings.tilt_deg, settings.zone_tilt_deg
    region = _region(settings.box, tilt, settings.quaternion, recorded)
    zone = None
    if settings.zone_box is not None or zone_tilt is not None:
        zone = _region(settings.zone_box or settings.box, tilt if zone_tilt is None else zone_tilt, settings.quaternion, recorded)
    chosen = PlanSettings(
        settings.poses,
        replace(region, angles=rig.angles if settings.rounded else None),
        zone,
        settings.criterion,
        settings.solve,
        u_position,
        u_rotation,
        settings.passes,
        Limits(
            settings.max_wrap_deg,
            settings.min_span_mm,
            settings.max_length_mm,
            settings.clearance_mm,
            settings.min_tension_n,
            settings.singular_deg,
        ),
        settings.further,
        settings.seed,
    )
    plan = plan_poses(rig, chosen, recorded, steps(progress, "planning"))
    more = {} if extend is None or recorded is None else further_columns(extend, len(plan.poses) - plan.recorded)
    # planned as exact without a statement; their later uncertainty is not stated yet
    unsaid = {"position": plan.poses.u_position_mm, "rotation": plan.poses.u_rotation_rad}
    planned = replace(plan.poses, absent=tuple(name for name, u in unsaid.items() if plan.poses.covariance is None and not u.any()))
    columns = pose_columns(planned, None if settings.quaternions else rig.angles) | more
    if settings.rounded and not settings.quaternions:
        for name in convention(rig.angles).columns:  # as they are typed, not as they come back from a rotation
            columns[name] = np.concatenate([columns[name][: plan.recorded], rounded_angles(rig.angles, columns[name][plan.recorded :])])
    write_table(out, columns)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, rig, reference=plan.poses)
    fill_in = message("workflow.fill_in_temperature") if "temperature_c" in more else ""
    figures = {"poses": len(plan.poses), "recorded": plan.recorded, "usable_part": plan.usable, "equations": plan.equations}
    figures |= {"unknowns": len(plan.parameters), "directions_determined": plan.outlook.rank}
    figures |= {"u_length_rms_mm": plan.outlook.rms_mm, "u_length_worst_mm": plan.outlook.worst_mm}
    answer = message("workflow.planned", poses=len(plan.poses), mm=plan.outlook.worst_mm, out=out, fill_in=fill_in)
    returns = proposed_returns(rig, plan.poses.rows, plan.poses.names)
    lines = (answer, *returns, *plan_summary(plan).splitlines())
    return Result(plan, lines, figures, details=tuple(plan_details(plan).splitlines()))


def _recorded(folder: Path, u_position_mm: float, u_rotation_rad: float) -> "Campaign":
    """The campaign; poses that state no uncertainty take that of the new ones."""
    from lmeasure.calibration import read_campaign

    campaign = read_campaign(folder)
    old = campaign.poses
    if not old.oriented:
        raise CalibrationError(message("error.its_reference_poses_have", where=folder))
    return replace(campaign, poses=old.or_uncertain(u_position_mm, u_rotation_rad))


def _uncertainties(given: tuple[float | None, float | None], recorded: "Campaign | None") -> tuple[float, float]:
    """Return the uncertainty of the new poses [mm, rad]: the given one, else the largest of the recorded ones, else none."""
    if recorded is None:
        return given[0] or 0.0, given[1] or 0.0
    stated = recorded.poses.u_position_mm.max(), recorded.poses.u_rotation_rad.max()
    position, rotation = (float(most) if u is None else u for u, most in zip(given, stated, strict=True))
    return position, rotation


def _region(box: Box | None, tilt_deg: float, quaternion: UnitQuaternion | None, recorded: "Campaign | None") -> "Region":
    """The box given, or that of the recorded poses; tilts about the orientation given, the recorded ones' mean, or the identity."""
    import numpy as np

    from lmeasure.calibration import Region

    if box is not None:
        low, high = np.array(box).T
    else:
        assert recorded is not None
        low, high = recorded.poses.rows[:, :3].min(axis=0), recorded.poses.rows[:, :3].max(axis=0)
    middle = np.array([0.0, 0.0, 0.0, 1.0]) if recorded is None else recorded.poses.rotation.mean().as_quat()
    if quaternion is not None:
        middle = np.array(quaternion) / np.linalg.norm(quaternion)
    return Region(low, high, math.radians(tilt_deg), middle)
