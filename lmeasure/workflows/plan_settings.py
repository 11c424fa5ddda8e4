"""What `lmeasure plan-poses` is asked, of a rig and of a robot."""

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
STATED = "by default exact, with --extend the largest recorded"

OPTIONS = ("free", "candidates", "columns", "keep_out", "zone", "base", "tool", "tip", "base_link")
"""What is asked of a robot alone."""


class Settings(Writing):
    """What `lmeasure plan-poses` is asked."""

    OUT_FILE: ClassVar[str] = "planned.csv"
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
        Literal["G", "I", "D"], option("G: least worst variance over the zone; I: least mean variance; D: least determinant.")
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
    columns: Annotated[
        str, option("Which column of the candidates is which, and its unit.", metavar="NAME=COLUMN[UNIT],...", panel=ROBOT)
    ] = ""
    keep_out: Annotated[
        Box | None, option("Box [robot's base] that no link and no target may enter.", metavar=BOX, unit="mm", panel=ROBOT)
    ] = None
    zone: Annotated[Path | None, option("Zone of the instrument, where targets must stay.", metavar="zone.nc", panel=ROBOT)] = None
    base: Annotated[
        Numbers | None, option("Where the robot stands in the instrument's frame.", metavar="X,Y,Z[,QX,QY,QZ,QW]", panel=ROBOT)
    ] = None
    tool: Annotated[Numbers | None, option("Where the target sits on the flange.", metavar="X,Y,Z[,QX,QY,QZ,QW]", panel=ROBOT)] = None
    tip: Annotated[
        str | None, option("Link of a .urdf that is the controller's flange; the chain ends there.", metavar="LINK", panel=ROBOT)
    ] = None
    base_link: Annotated[
        str | None, option("Link of a .urdf that is the controller's base; the chain begins there.", metavar="LINK", panel=ROBOT)
    ] = None
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
