"""The tests of ISO 9283 in a robot's work space, as a program."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.core import SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, workflow
from lmeasure.workflows.settings import (
    COLUMNS,
    RERUN,
    Edges,
    Names,
    Numbers,
    Pair,
    Paths,
    Quaternion,
    Recording,
    Writing,
    known_convention,
    notes_of_file,
    option,
    refuse,
    then,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from lmeasure.core import FloatArray
    from lmeasure.iso9283 import Cube
    from lmeasure.linkages import Kept
    from lmeasure.recording import Program
    from lmeasure.text import Message

KEPT = "Paths within the zone"
EDGES = "Box that the robot uses most, mm."


class Settings(Writing):
    """Settings of `lmeasure program`."""

    out: Annotated[Path, option("Folder for program.toml, commands.csv and robodk.csv.", metavar="DIR")]
    zone: Annotated[Path | None, option("Use the largest cube in this accuracy zone instead of a box.", metavar="FILE.nc")] = None
    x: Annotated[Edges | None, option(EDGES, metavar="START:STOP[:STEP]", unit="mm")] = None
    y: Annotated[Edges | None, option(EDGES, metavar="START:STOP[:STEP]", unit="mm")] = None
    z: Annotated[Edges | None, option(EDGES, metavar="START:STOP[:STEP]", unit="mm")] = None
    plane: Annotated[str, option("Diagonal plane of the cube with P1 to P5 and the paths.")] = "C1-C2-C7-C8"
    quaternion: Annotated[Quaternion, option("Orientation of the tool, base_from_tool.", metavar="x,y,z,w")] = (0.0, 0.0, 0.0, 1.0)
    tests: Annotated[
        Names, option("Tests: pose, approach, stabilisation, drift, path, reorientation, posing, compliance, weaving; or all.")
    ] = ("pose", "approach", "stabilisation", "path", "reorientation")
    speed: Annotated[float, option("Rated speed between poses, mm/s.", unit="mm/s")] = 1000.0
    path_speed: Annotated[float, option("Rated speed on paths, mm/s.", unit="mm/s")] = 500.0
    speeds: Annotated[Numbers, option("Speeds in percent of the rated ones; all other tests use the first.", unit="%")] = (
        100.0,
        50.0,
        10.0,
    )
    loads: Annotated[Numbers, option("Loads of pose and path tests, kg; all other tests use the first.", unit="kg")] = (0.0,)
    cycles: Annotated[str | None, option("Numbers of cycles, if not the standard's (pose=30, path=10, ...).", metavar="TEST=N,...")] = None
    dwell: Annotated[float, option("Rest time at a measured pose, s.", unit="s")] = 1.5
    angles: Annotated[str | None, option("Convention of component-wise angles; default the rig's.")] = None
    limit_band: Annotated[
        float, option("Distance from a pose that counts as arrival, for stabilisation and posing time, mm.", unit="mm")
    ] = 0.1
    ran: Annotated[
        Path | None, option("Only fill in the times of this run into program.toml and commands.csv in --out.", metavar="TRAJECTORY")
    ] = None
    columns: Annotated[str, COLUMNS] = ""
    align: Annotated[bool, option("With --ran: find the program's frame from the rests, because the trajectory has its own frame.")] = False
    loaded: Annotated[
        Path | None, option("With --ran: start_s, end_s of each force of the compliance test, in order.", metavar="FILE.csv")
    ] = None
    correct: Annotated[
        Path | None,
        option("Change the paths of this program to stay within the limits of --rig; their ends stay.", metavar="PROGRAM.toml", panel=KEPT),
    ] = None
    rig: Annotated[Path | None, option("Rig, for --correct and for the faults that returns show.", metavar="RIG.toml")] = None
    robot: Annotated[
        str | None,
        option(
            "In place of --rig, for --correct: a platform by name, its robot.toml, or a table of points and links.",
            metavar="ROBOT",
            panel=KEPT,
        ),
    ] = None
    limit_deg: Annotated[
        float | None,
        option("With --correct: largest pressure angle; default 60 for a rig, else only no singular pose.", panel=KEPT, within=(0.0, 90.0)),
    ] = None
    length_mm: Annotated[Pair | None, option("With --correct: cable lengths.", metavar="MIN:MAX", panel=KEPT)] = None
    drift_hours: Annotated[float, option("Duration of the drift test.", unit="h")] = 8.0
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        """Return the command that records the program, or certifies by it."""
        if self.ran is None:
            return then("record rig.toml --bus socketcan:can0 --out run")
        return then("certify {ran} --program {out}/program.toml --out certificate", ran=self.ran, out=self.out)

    def paths(self) -> Paths:
        """A program, perhaps from a zone. With --ran, program.toml gets its windows in its place and is no output."""
        if self.ran is not None:
            return Paths(present(self.rerun), present(self.ran, self.loaded))
        if self.correct is not None:
            return Paths((*inside(self.out, "program.toml", "corrected.csv"), *present(self.rerun)), present(self.correct, self.rig))
        outputs = inside(self.out, "program.toml", "commands.csv", "robodk.csv")
        return Paths((*outputs, *present(self.rerun)), present(self.zone, self.rig))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Program]":
    """Write the program and its commands; or fill in when it ran."""
    from lmeasure.iso9283 import TESTS, Tests, campaign, duration_s, write_campaign

    if settings.ran is not None:
        return _filled_in(settings, settings.ran)
    refuse(settings, message("refuse.ran"), "loaded", "columns", "align")
    if settings.correct is not None:
        return _corrected(settings, settings.correct)
    cube = _cube(settings)
    chosen = Tests(
        tests=TESTS if settings.tests == ("all",) else settings.tests,
        quaternion=settings.quaternion,
        speed_mm_s=settings.speed,
        path_speed_mm_s=settings.path_speed,
        speeds_percent=settings.speeds,
        loads_kg=settings.loads,
        dwell_s=settings.dwell,
        cycles=_cycles(settings.cycles),
        drift_s=3600.0 * settings.drift_hours,
        limit_band_mm=settings.limit_band,
        angles=settings.angles,
    )
    plan = campaign(cube, chosen)
    write_campaign(settings.out, plan)
    _record(settings, plan.program)
    minutes = duration_s(plan) / 60.0
    lasts = message("workflow.minutes", minutes=minutes) if minutes >= 1.0 else message("workflow.seconds", seconds=60.0 * minutes)
    return Result(
        plan.program,
        (
            message("workflows.cube_mm_about_mm", edge=cube.edge_mm, centre=tuple(map(float, cube.centre)), plane=cube.plane),
            message(
                "workflow.program", poses=len(plan.program.pose), paths=len(plan.program.path), commands=len(plan.commands), lasts=lasts
            ),
            message("workflows.program_toml_commands_csv", folder=settings.out),
            *_returns(settings, plan.program),
        ),
        {"edge_mm": float(cube.edge_mm), "minutes": minutes},
    )


def _record(settings: Settings, program: "Program", moving: "tuple[FloatArray, FloatArray] | None" = None) -> None:
    """Draw the commanded poses and paths, the rig, and the measured motion."""
    if settings.rerun is None:
        return
    from lmeasure.rig import read_linked_rig
    from lmeasure.view import write_scene

    rig = None if settings.rig is None else read_linked_rig(settings.rig)[0]
    write_scene(settings.rerun, program.name or "program", rig=rig, program=program, moving=moving)


def _returns(settings: Settings, program: "Program") -> "list[Message]":
    """Propose the returns that show slow faults of a rig with six cables."""
    import numpy as np

    from lmeasure.rig import read_rig
    from lmeasure.trajectory import proposed_returns

    if settings.rig is None:
        return []
    poses = {p.name: [*p.position_mm, *p.quaternion_xyzw] for p in program.pose}
    speed = settings.path_speed if program.path else None
    return proposed_returns(read_rig(settings.rig), np.array(list(poses.values())).reshape(-1, 7), tuple(poses), speed)


def _corrected(settings: Settings, commanded: Path) -> "Result[Program]":
    """A program whose paths keep the limits of a rig."""
    from scipy.spatial.transform import Rotation

    from lmeasure.accuracy import corrected, correction_columns
    from lmeasure.io import files
    from lmeasure.recording import read_program, write_program

    if (settings.rig is None) == (settings.robot is None):
        raise SettingsError("correct", message("error.needs_rig_whose_limits"))
    if settings.zone is not None or (settings.x, settings.y, settings.z) != (None, None, None):
        raise SettingsError("correct", message("error.corrects_a_program_it"))
    program = read_program(commanded)
    made, found = corrected(_limits(settings), program, Rotation.from_quat(settings.quaternion))
    with files.whole(settings.out / "program.toml") as written, files.whole(settings.out / "corrected.csv") as table:
        write_program(written, made)
        files.write_table(table, correction_columns(found))
    _record(settings, made)
    left = tuple(one.line() for one in found if one.left)
    return Result(made, tuple(one.line() for one in found), {"led_around": float(sum(one.changed for one in found))}, left)


def _limits(settings: Settings) -> "Callable[[FloatArray], Kept | None]":
    """The limits of --rig or --robot: those of a mechanism's legs, drives and joints, or pressure angles and lengths of links."""
    from lmeasure.accuracy import keeping, within
    from lmeasure.core import se3
    from lmeasure.io import files
    from lmeasure.linkages import LINKS, Behind
    from lmeasure.rig import read_linked_rig
    from lmeasure.robots import SCHEMA, ParallelFile, PathLimits, PlatformFile
    from lmeasure.structure import linkage_of, read_linkage
    from lmeasure.workflows.identify import nominal
    from lmeasure.workflows.structure import of_robot

    if settings.rig is not None:
        limit = 60.0 if settings.limit_deg is None else settings.limit_deg
        if not 0.0 < limit < 90.0:
            raise SettingsError("limit_deg", message("error.does_not_lie_between", limit_deg=limit))
        return within(linkage_of(read_linked_rig(settings.rig)[0]), limit, settings.length_mm)
    assert settings.robot is not None
    limit, path = 90.0 if settings.limit_deg is None else settings.limit_deg, Path(settings.robot)
    if path.suffix == ".toml" and files.read_toml(path).get("schema") != SCHEMA:
        return within(read_linkage(path), limit, settings.length_mm)
    robot = nominal(settings.robot)
    if isinstance(robot, PlatformFile):
        links, tool = of_robot(path), robot.tool_pose
        assert links is not None
        own = within(links, limit, settings.length_mm)

        def on_tool(pose: "FloatArray") -> "Kept | None":
            kept = own(se3.compose(pose, se3.inverse(tool)))
            return None if kept is None else Behind(kept, tool)

        return on_tool
    if not isinstance(robot, ParallelFile) or len(robot.model.joint_names) != LINKS:
        raise SettingsError("robot", message("error.corrects_paths_of_platforms", name=settings.robot))
    refuse(settings, message("refuse.not_mechanism"), "limit_deg", "length_mm")
    limits = Behind(PathLimits(robot.model, robot.limits), robot.tool_pose)
    return lambda pose: keeping(limits, pose)


def _cube(settings: Settings) -> "Cube":
    from lmeasure.iso9283 import cube_in_zone, largest_cube

    edges = [edge for edge in (settings.x, settings.y, settings.z) if edge is not None]
    if settings.zone is not None and not edges:
        return cube_in_zone(settings.zone, settings.plane)
    if settings.zone is not None or len(edges) != 3:
        raise SettingsError("x, y, z", message("error.give_the_box_by_x"))
    return largest_cube([e[0] for e in edges], [e[1] for e in edges], settings.plane)


def _filled_in(settings: Settings, ran: Path) -> "Result[Program]":
    from dataclasses import replace

    from lmeasure.io import columns_of
    from lmeasure.iso9283 import windows_from_rests
    from lmeasure.recording import read_program, write_program
    from lmeasure.trajectory import Stated, read_trajectory, stamps_of

    if settings.zone is not None or (settings.x, settings.y, settings.z) != (None, None, None):
        raise SettingsError("ran", message("error.fills_in_the_program"))
    written = settings.out / "program.toml"
    reported = settings.out / "commands.csv"
    stated = Stated(columns_of(settings.columns), angles=known_convention(settings.angles))
    before = read_program(written)
    trajectory = read_trajectory(ran, replace(stated, likely=before.angles))
    program, notes = windows_from_rests(before, reported, trajectory, loaded=settings.loaded, align=settings.align)
    write_program(written, program)
    _record(settings, program, (trajectory.time_s, trajectory.poses))
    windows = [p.windows_s for p in program.pose] + [p.windows_s for p in program.path]
    windows += [p.windows_s for p in program.posing] + [c.windows_s for c in program.compliance]
    count = sum(map(len, windows))
    lines, warnings = notes_of_file((*trajectory.notes, *stamps_of(trajectory).notes, *notes))
    return Result(
        program,
        (message("workflows.windows_filled", count=count, file=written), *lines),
        {"windows": float(count)},
        warnings,
        files=(written,),
    )


def _cycles(text: str | None) -> dict[str, int]:
    out = {}
    for part in text.split(",") if text else []:
        name, _, number = part.partition("=")
        if not number.strip().isdigit():
            raise SettingsError("cycles", message("error.must_be_test_n", part=part))
        out[name.strip()] = int(number)
    return out
