"""Which reference poses to measure."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from lmeasure.errors import CalibrationError, SettingsError
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.plan_robot import OPTIONS, files_of, run_robot
from lmeasure.workflows.settings import (
    BOX,
    RERUN,
    Asked,
    Box,
    Names,
    Numbers,
    Paths,
    Recording,
    UnitQuaternion,
    WholeNumbers,
    option,
)

if TYPE_CHECKING:
    from lmeasure.calibration import Campaign
    from lmeasure.calibration.reach import Region

LIMITS = "What a cable allows"
ROBOT = "Poses of a robot"
STATED = "by default exact, with --extend the largest recorded"


class Settings(Asked):
    """What `lmeasure plan-poses` is asked."""

    rig: Annotated[
        Path | None,
        option(
            "The rig as far as it is known; its u_... are the priors. With --robot the instrument that must see the robot.",
            metavar="RIG.toml",
            positional=True,
        ),
    ] = None
    poses: Annotated[int, option("How many poses to choose; with --extend, how many more.", ge=1)]
    out: Annotated[
        Path, option("The reference_poses.csv to write; its first pose is the zero pose. With --robot the table of joint values.")
    ]
    box: Annotated[
        Box | None, option("Where the tool origin may go [mm]; with --extend by default as it went.", metavar=BOX, unit="mm")
    ] = None
    tilt_deg: Annotated[float, option("Largest component of the tilt's rotation vector.", ge=0, le=90)] = 15.0
    quaternion: Annotated[UnitQuaternion | None, option("Orientation that is tilted.", metavar="X,Y,Z,W")] = None
    zone_box: Annotated[Box | None, option("Where lengths matter; by default the box.", metavar=BOX, unit="mm")] = None
    zone_tilt_deg: Annotated[float | None, option("Tilt in the zone; by default that of the poses.", ge=0, le=90)] = None
    criterion: Annotated[
        Literal["G", "I", "D"],
        option("G: least worst variance over the zone; I: least mean variance; D: least determinant."),
    ] = "G"
    extend: Annotated[Path | None, option("Calibration folder already recorded: its counters go on.", metavar="FOLDER")] = None
    u_position_mm: Annotated[float | None, option(f"Standard uncertainty of a pose's coordinates; {STATED}.", ge=0)] = None
    u_rotation_deg: Annotated[float | None, option(f"Standard uncertainty of a pose's rotations; {STATED}.", ge=0)] = None
    solve: Annotated[Names, option("What the calibration will solve for, as `lmeasure calibrate` has it.")] = ("position", "guide")
    passes: Annotated[WholeNumbers, option("Whose cables are measured.", flag="--pass", metavar="N,...")] = (1,)
    max_wrap_deg: Annotated[float, option("Largest angle wrapped on a swivel pulley.", ge=1, le=360, panel=LIMITS)] = 170.0
    min_span_mm: Annotated[float, option("Shortest free span from the pulley.", ge=0, panel=LIMITS)] = 100.0
    max_length_mm: Annotated[float, option("Longest cable from B to the attachment point.", ge=1, panel=LIMITS)] = 1e6
    clearance_mm: Annotated[float, option("Between free spans, and to other pulleys.", ge=0, panel=LIMITS)] = 10.0
    min_tension_n: Annotated[float, option("Least tension at a drum whose tension the rig states.", ge=0, panel=LIMITS)] = 0.0
    singular_deg: Annotated[float, option("Least distance to where the rig's angles are not unique.", ge=0, le=45, panel=LIMITS)] = 2.0
    further: Annotated[int, option("Poses beyond the plan to weigh in the table.", ge=0, le=50)] = 3
    rounded: Annotated[
        bool, option("Plan poses that can be typed: 0.1 mm and 0.01 degrees in the rig's angles.", flag="--rounded/--exact")
    ] = True
    quaternions: Annotated[bool, option("Write quaternions, not the rig's angles.")] = False
    seed: Annotated[int, option("Seed of candidates and starts.", ge=0)] = 0
    robot: Annotated[
        str | None, option("Plan poses of this robot for `identify`: a name, a robot.toml or a .urdf.", metavar="NAME_OR_FILE", panel=ROBOT)
    ] = None
    free: Annotated[Names, option("What else `identify` will free beside links and harmonics.", metavar="FAMILY,...", panel=ROBOT)] = ()
    candidates: Annotated[Path | None, option("Joint values to choose from, by default all allowed.", metavar="FILE", panel=ROBOT)] = None
    keep_out: Annotated[
        Box | None, option("Box [robot's base] that no link and no target may enter.", metavar=BOX, unit="mm", panel=ROBOT)
    ] = None
    zone: Annotated[Path | None, option("Zone of the instrument, where targets must stay.", metavar="zone.nc", panel=ROBOT)] = None
    base: Annotated[
        Numbers | None, option("Where the robot stands in the instrument's frame.", metavar="X,Y,Z[,QX,QY,QZ,QW]", panel=ROBOT)
    ] = None
    tool: Annotated[Numbers | None, option("Where the target sits on the flange.", metavar="X,Y,Z[,QX,QY,QZ,QW]", panel=ROBOT)] = None
    tip: Annotated[str | None, option("Link of a .urdf at which the chain ends.", metavar="LINK", panel=ROBOT)] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        """Planned poses from a rig, and from the campaign that they extend."""
        if self.robot is not None:
            outputs, inputs = files_of(self)
            return Paths(outputs, (*present(self.rig), *inputs))
        extended = () if self.extend is None else inside(self.extend, "rig.toml", "reference_poses.csv", "counts.csv")
        return Paths((self.out, *present(self.rerun)), (*present(self.rig), *extended))


@workflow("plan-poses")
def run(settings: Settings, progress: Progress = silent) -> "Result[Any]":
    """Plan, and write the poses."""
    import numpy as np

    from lmeasure.calibration import planning
    from lmeasure.calibration.campaign import further_columns
    from lmeasure.calibration.plan_summary import summary
    from lmeasure.calibration.reach import Limits
    from lmeasure.conventions import convention, rounded_angles
    from lmeasure.files import write_table
    from lmeasure.poses import pose_columns
    from lmeasure.rig import read_rig

    out, extend = settings.out, settings.extend
    if settings.robot is not None:
        if out.suffix.lower() != ".csv":
            raise SettingsError("out", f"{str(out)!r} does not end in .csv")
        return run_robot(settings, progress)
    stray = next((name for name in OPTIONS if getattr(settings, name)), None)
    if stray is not None:
        raise SettingsError(stray, "goes with --robot")
    if settings.rig is None:
        raise SettingsError("rig", "is missing: the rig whose reference poses are planned, or --robot")
    if out.suffix.lower() != ".csv":
        raise SettingsError("out", f"{str(out)!r} does not end in .csv")
    if settings.box is None and extend is None:
        raise SettingsError("box", "say where the robot may go")
    rig = read_rig(settings.rig)
    u = settings.u_position_mm, None if settings.u_rotation_deg is None else math.radians(settings.u_rotation_deg)
    recorded = None if extend is None else _recorded(extend, u[0] or 0.0, u[1] or 0.0)
    u_position, u_rotation = _uncertainties(u, recorded)
    tilt, zone_tilt = settings.tilt_deg, settings.zone_tilt_deg
    region = _region(settings.box, tilt, settings.quaternion, recorded)
    zone = None
    if settings.zone_box is not None or zone_tilt is not None:
        zone = _region(settings.zone_box or settings.box, tilt if zone_tilt is None else zone_tilt, settings.quaternion, recorded)
    chosen = planning.Settings(
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
    plan = planning.plan_poses(rig, chosen, recorded, steps(progress, "planning"))
    more = {} if extend is None or recorded is None else further_columns(extend, len(plan.poses) - plan.recorded)
    # planned as if exact where nothing is said of it; how exactly they will be known nobody has stated yet
    unsaid = {"position": plan.poses.u_position_mm, "rotation": plan.poses.u_rotation_rad}
    planned = replace(plan.poses, absent=tuple(name for name, u in unsaid.items() if plan.poses.covariance is None and not u.any()))
    columns = pose_columns(planned, None if settings.quaternions else rig.angles) | more
    if settings.rounded and not settings.quaternions:
        for name in convention(rig.angles).columns:  # as they are typed, not as they come back from a rotation
            columns[name] = np.concatenate([columns[name][: plan.recorded], rounded_angles(rig.angles, columns[name][plan.recorded :])])
    write_table(out, columns)
    if settings.rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(settings.rerun, rig, reference=plan.poses)
    fill_in = "; fill in temperature_c of the new poses when they are counted" if "temperature_c" in more else ""
    return Result(plan, (*summary(plan).splitlines(), f"written: {out}{fill_in}"))


def _recorded(folder: Path, u_position_mm: float, u_rotation_rad: float) -> "Campaign":
    """The campaign; poses that state no uncertainty take that of the new ones."""
    from lmeasure.calibration import read_campaign

    campaign = read_campaign(folder)
    old = campaign.poses
    if not old.oriented:
        raise CalibrationError(
            f"{folder}: its reference poses have no orientations; planning needs whole poses, as poses.csv of a calibration"
        )
    return replace(campaign, poses=old.or_uncertain(u_position_mm, u_rotation_rad))


def _uncertainties(given: tuple[float | None, float | None], recorded: "Campaign | None") -> tuple[float, float]:
    """Of the new poses [mm, rad]: what is given, else the largest of the recorded ones, else none."""
    if recorded is None:
        return given[0] or 0.0, given[1] or 0.0
    stated = recorded.poses.u_position_mm.max(), recorded.poses.u_rotation_rad.max()
    position, rotation = (float(most) if u is None else u for u, most in zip(given, stated, strict=True))
    return position, rotation


def _region(box: Box | None, tilt_deg: float, quaternion: UnitQuaternion | None, recorded: "Campaign | None") -> "Region":
    """The box given, or that of the recorded poses; tilts about the orientation given, the recorded ones' mean, or the identity."""
    import numpy as np

    from lmeasure.calibration.reach import Region

    if box is not None:
        low, high = np.array(box).T
    else:
        assert recorded is not None
        low, high = recorded.poses.rows[:, :3].min(axis=0), recorded.poses.rows[:, :3].max(axis=0)
    middle = np.array([0.0, 0.0, 0.0, 1.0]) if recorded is None else recorded.poses.rotation.mean().as_quat()
    if quaternion is not None:
        middle = np.array(quaternion) / np.linalg.norm(quaternion)
    return Region(low, high, math.radians(tilt_deg), middle)
