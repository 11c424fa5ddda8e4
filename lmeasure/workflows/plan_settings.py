"""Settings of `lmeasure plan-poses`, for a rig and for a robot."""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from lmeasure.workflows.flow import inside, present
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
    then,
)

LIMITS = "What a cable allows"
ROBOT = "Poses of a robot"
STATED = "default exact, with --extend the largest recorded one"

OPTIONS = ("free", "candidates", "columns", "keep_out", "zone", "base", "tool", "tip", "base_link")
"""Options of a robot alone."""


class Settings(Writing):
    """Settings of `lmeasure plan-poses`."""

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
        """Return the command that goes through the poses, or evaluates them."""
        if self.robot is not None:
            return then("identify --robot {robot} --measurements measured.csv --out identified", robot=self.robot)
        return then("capture {rig} --poses {out} --bus socketcan:can0 --out campaign", rig=self.rig, out=self.out)

    def paths(self) -> Paths:
        """Planned poses from a rig, and from the campaign that they extend."""
        if self.robot is not None:
            outputs, inputs = files_of(self)
            return Paths(outputs, (*present(self.rig), *inputs))
        extended = () if self.extend is None else inside(self.extend, "rig.toml", "reference_poses.csv", "counts.csv")
        return Paths((self.out, *present(self.rerun)), (*present(self.rig), *extended))


def poses_file(out: Path) -> Path:
    """Where the poses of a joint table go."""
    return out.with_name(f"{out.stem}_poses.csv")


def files_of(settings: "Settings") -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Outputs, and inputs besides the rig."""
    robot = Path(str(settings.robot))
    return (settings.out, poses_file(settings.out)), present(robot if robot.suffix else None, settings.candidates, settings.zone)
