"""Correction: programs that take an identified robot to the intended poses."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from lmeasure.core import RobotError, SettingsError
from lmeasure.text import composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, workflow
from lmeasure.workflows.settings import (
    BOX,
    COLUMNS,
    LANGUAGE,
    RERUN,
    Box,
    Edges,
    Names,
    Numbers,
    Pair,
    Paths,
    Quaternion,
    Recording,
    Spans,
    Writing,
    known_convention,
    notes_of_file,
    option,
    pose_of,
    refuse,
    then,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from lmeasure.core import FloatArray
    from lmeasure.iso9283 import Campaign, Cube
    from lmeasure.linkages import PathBounds
    from lmeasure.recording import Program
    from lmeasure.robot_programs import Corrected, Dialect, Listing
    from lmeasure.robots import Limits
    from lmeasure.text import Message


class CorrectSettings(Writing):
    NEXT: ClassVar[str] = "compare before after --corrections {out}/corrections.json --page comparison.html"
    programs: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option(
            "Files of one program: KRL .src and .dat, RAPID .mod, FANUC .ls, Universal Robots .script, .csv.",
            metavar="FILE...",
            positional=True,
        ),
    ]
    out: Annotated[Path, option("Folder for the corrected files, corrections.json and corrections.html.")]
    identified: Annotated[Path | None, option("Output folder of `lmeasure identify`.", metavar="FOLDER")] = None
    map: Annotated[
        Path | None, option("Measured errors over the region, instead of a robot model (docs/correction.md).", metavar="FILE")
    ] = None
    columns: Annotated[
        str,
        option(
            "Meaning and unit of each column of a table of targets or a map (mm, m, cm, um, in, deg, rad).", metavar="NAME=COLUMN[UNIT],..."
        ),
    ] = ""
    dialect: Annotated[str, option("Robot language, if file names do not determine it: krl, rapid, fanuc, ur-script, csv or robodk.")] = ""
    frames: Annotated[
        Path | None, option("Values of frames and tools that the program only names (docs/correction.md).", metavar="FILE.toml")
    ] = None
    near: Annotated[
        Numbers | None, option("Joint values (deg, mm) near the first target, to choose one of its joint solutions.", metavar="Q1,Q2,...")
    ] = None
    base: Annotated[
        Numbers | None,
        option(
            "Nominal robot base in the instrument's frame, in mm, for the corrected program. Default: the base from the kinematic "
            "calibration.",
            metavar="X,Y,Z,QX,QY,QZ,QW",
        ),
    ] = None
    tool: Annotated[
        Numbers | None,
        option("Nominal target on the flange, in mm. Default: the target from the kinematic calibration.", metavar="X,Y,Z,QX,QY,QZ,QW"),
    ] = None
    most_mm: Annotated[float, option("Largest correction of a position.", ge=0)] = 5.0
    most_deg: Annotated[float, option("Largest correction of an orientation.", ge=0)] = 1.0
    clip: Annotated[bool, option("Shorten larger corrections instead of excluding their targets.")] = False
    keep_out: Annotated[Box | None, Spans(","), option("Forbidden box for the tool, in the robot's base.", metavar=BOX)] = None
    skip: Annotated[Names, option("Targets without correction.", metavar="NAME,...")] = ()
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def paths(self) -> Paths:
        outputs = inside(self.out, "corrections.json", "corrections.html", *(path.name for path in self.programs))
        known = () if self.identified is None else inside(self.identified, "identified.json", "robot.toml")
        return Paths(outputs, (*self.programs, *present(self.frames, self.map), *known))


@workflow
def run_correct(settings: CorrectSettings, progress: Progress = silent) -> Result:
    """Correct, and write the programs and their changes."""
    import numpy as np

    from lmeasure.demo import write_correction
    from lmeasure.robot_programs import dialect_names, is_dialect

    names = [path.name for path in settings.programs]
    if len(set(names)) != len(names):
        raise SettingsError("programs", message("error.two_files_of_one"))
    if (settings.identified is None) == (settings.map is None):
        raise SettingsError("identified", message("error.state_a_folder_of"))
    if settings.dialect and not is_dialect(settings.dialect):
        raise SettingsError("dialect", message("error.is_none_of", kind=settings.dialect, kinds=", ".join(dialect_names())))
    listing, dialect = _listing(settings)
    correcting = _by_model(settings) if settings.identified is not None else _by_map(settings)
    progress(0.2, "correcting")
    found, lines = correcting(listing, dialect)
    progress(0.9, "writing")
    written = write_correction(settings.out, found, listing, inputs=settings.paths().inputs, language=settings.language or of_terminal())
    done = found.done
    lines.insert(
        0,
        message(
            "workflows.targets_corrected_positions_not",
            n=found.changed,
            of=len(found.outcomes),
            dialect=dialect.name,
            unread=len(listing.unread),
        ),
    )
    figures: dict[str, float] = {"corrected": found.changed}
    if done:
        size, was = (max(getattr(o.correction, key) for o in done) for key in ("size_mm", "was_mm"))
        worst = max(o.u95_mm for o in done)
        code = "workflow.largest_correction_identified" if settings.map is None else "workflow.largest_correction"
        lines.append(message(code, size=size, was=was))
        lines.append(message("workflows.u95_where_goes_now", u=worst) if np.isfinite(worst) else message("workflow.u95_where_goes_now"))
        figures |= {"largest_correction_mm": size, "largest_error_before_mm": was, "largest_u95_mm": worst}
    at = "{file}:{line}: {name}: {why}"
    left = [composed(at, file=o.file, line=o.target.line, name=o.target.name, why=o.left) for o in found.outcomes if o.left]
    remarks = [*left, *(u.text for u in listing.unread)]
    lines += [message("workflow.left", what=text) for text in remarks]
    lines.append(message("line.written", files=tuple(str(settings.out / name) for name in written)))
    return Result(found, tuple(lines), figures, tuple(remarks))


Correcting = Callable[["Listing", "Dialect"], "tuple[Corrected, list[str]]"]
"""Function that corrects a program, and reports on it."""


def _by_model(settings: CorrectSettings) -> Correcting:
    from lmeasure.robot_programs import corrected_program
    from lmeasure.robots import read_identified

    assert settings.identified is not None
    robot = read_identified(settings.identified)
    if settings.near and len(settings.near) != len(robot.nominal.joint_names):
        raise SettingsError(
            "near", message("error.joint_values_the_robot", n_near=len(settings.near), n_joint_names=len(robot.nominal.joint_names))
        )
    base, tool = _frame(settings.base, "base"), _frame(settings.tool, "tool")
    seen = robot if base is None and tool is None else robot.stated(base, tool)
    return lambda listing, dialect: (corrected_program(listing, dialect, seen, limits=_limits(settings), near=settings.near or ()), [])


def _by_map(settings: CorrectSettings) -> Correcting:
    import numpy as np

    from lmeasure.io import columns_of
    from lmeasure.robot_programs import mapped_program
    from lmeasure.robots import error_map, read_map

    assert settings.map is not None
    refuse(settings, message("refuse.identified"), "near", "base")
    given = read_map(settings.map, columns_of(settings.columns))
    try:
        errors = error_map(given.poses, given.errors_mm, given.turns, turned=given.turned)
    except RobotError as error:
        raise RobotError(composed("{where}: {error}", where=settings.map, error=error)) from None
    off = np.linalg.norm(errors.place.left_out, axis=1)
    lines: list[str] = [message("workflows.map_points_left_out", n=len(off), mean=off.mean(), most=off.max(), percent=100 * errors.within)]
    if not given.turned:
        lines.append(message("workflow.note_map_has_no"))
    tool = _frame(settings.tool, "tool")
    if tool is None:
        lines.append(message("workflow.note_no_tool_stated"))
    return lambda listing, dialect: (mapped_program(listing, dialect, errors, limits=_limits(settings), tool=tool), lines)


def _frame(values: tuple[float, ...] | None, name: str) -> "FloatArray | None":
    return None if values is None else pose_of(values, name)


def _limits(settings: CorrectSettings) -> "Limits":
    import numpy as np

    from lmeasure.robots import Limits

    box = () if settings.keep_out is None else (np.array(settings.keep_out),)
    return Limits(settings.most_mm, float(np.radians(settings.most_deg)), settings.clip, box)


def _listing(settings: CorrectSettings) -> "tuple[Listing, Dialect]":
    """The program with the frames that are stated, without the targets that are skipped; RobotError where nothing is left."""
    from lmeasure.io import columns_of
    from lmeasure.robot_programs import Unread, dialect_of, opened

    names = [path.name for path in settings.programs]
    sources = opened(settings.programs)
    columns = columns_of(settings.columns) if settings.map is None else None
    dialect = dialect_of(settings.programs, sources, settings.dialect, columns)
    stated = {} if settings.frames is None else read_frames(settings.frames)
    listing = dialect.read(sources).stated(stated)
    strange = [name for name in settings.skip if name not in {t.name for t in listing.targets}]
    if strange:
        raise SettingsError("skip", message("error.the_program_has_no", strange=strange[0]))
    left = tuple(
        Unread(sources[t.source].name, t.line, message("workflows.skipped", name=t.name))
        for t in listing.targets
        if t.name in settings.skip
    )
    listing = replace(listing, targets=tuple(t for t in listing.targets if t.name not in settings.skip), unread=(*listing.unread, *left))
    if not listing.targets:
        first = message("workflow.first_left", first=listing.unread[0]) if listing.unread else ""
        raise RobotError(message("error.no_target_that_can", where=", ".join(names), name=dialect.name, first=first))
    return listing, dialect


def read_frames(path: Path) -> "dict[str, FloatArray]":
    """Frames by the names that a program has for them: tables with position_mm, and quaternion_xyzw or angles of a convention."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from lmeasure.core import CONVENTIONS, MAX_LENGTH_MM, FileFormatError, rotation_from_angles, se3
    from lmeasure.io import files
    from lmeasure.recording import UNIT_TOLERANCE

    out = {}
    for name, table in dict(files.read_toml(path)).items():
        if name == "schema":
            continue
        where = f"{path}: [{name}]"
        if not isinstance(table, dict):
            raise FileFormatError(message("error.must_be_a_table", where=where))
        angles = {f"{c.name.replace('-', '_')}_{'rad' if c.axes == 'rotvec' else 'deg'}": c.name for c in CONVENTIONS.values()}
        known = {"position_mm", "quaternion_xyzw", *angles}
        for key, value in table.items():
            numbers = value if isinstance(value, list) else []
            if key not in known:
                raise FileFormatError(message("error.is_not_known_known", where=where, key=key, known=", ".join(sorted(known))))
            if len(numbers) != (4 if key == "quaternion_xyzw" else 3) or not all(isinstance(v, int | float) for v in numbers):
                raise FileFormatError(message("error.must_be_numbers", where=where, key=key, value=4 if key == "quaternion_xyzw" else 3))
        place = np.array(table.get("position_mm", [0.0, 0.0, 0.0]), dtype=np.float64)
        if not (np.abs(place) <= MAX_LENGTH_MM).all():
            raise FileFormatError(message("error.position_mm_must_be", where=where, max_length_mm=MAX_LENGTH_MM))
        turned = [key for key in table if key != "position_mm"]
        if len(turned) > 1:
            raise FileFormatError(message("error.an_orientation_is_stated", where=where, turned=", ".join(turned)))
        if not turned:
            turn = Rotation.identity()
        elif turned == ["quaternion_xyzw"]:
            quaternion = np.array(table["quaternion_xyzw"], dtype=np.float64)
            if not abs(np.linalg.norm(quaternion) - 1.0) <= UNIT_TOLERANCE:
                raise FileFormatError(message("error.quaternion_xyzw_is_of", where=where, norm=np.linalg.norm(quaternion)))
            turn = Rotation.from_quat(quaternion)
        else:
            turn = rotation_from_angles(angles[turned[0]], table[turned[0]])
        out[str(name)] = se3.pose(place, turn)
    return out


KEPT = "Paths within the zone"
EDGES = "Box that the robot uses most, mm."


class ProgramSettings(Writing):
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
    dither: Annotated[
        float | None,
        option(
            "Swing the tool about each measured pose by this to each side along x, y, z, mm: its mean is finer than a count. "
            "With --rig it says what this brings.",
            unit="mm",
        ),
    ] = None
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
        if self.ran is None:
            return then("record rig.toml --bus socketcan:can0 --out run")
        same = " --align" * self.align + " --columns {columns}" * bool(self.columns)
        words = "certify {ran} --program {out}/program.toml" + same + " --out certificate"
        return then(words, ran=self.ran, out=self.out, columns=self.columns)

    def paths(self) -> Paths:
        if self.ran is not None:
            return Paths(present(self.rerun), present(self.ran, self.loaded))
        if self.correct is not None:
            return Paths((*inside(self.out, "program.toml", "corrected.csv"), *present(self.rerun)), present(self.correct, self.rig))
        outputs = inside(self.out, "program.toml", "commands.csv", "robodk.csv")
        return Paths((*outputs, *present(self.rerun)), present(self.zone, self.rig))


@workflow
def run_program(settings: ProgramSettings, progress: Progress = silent) -> Result:
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
    plan, dither_lines, dither_figures = _with_dither(settings, campaign(cube, chosen), chosen.settle_s)
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
            *dither_lines,
            *_returns(settings, plan.program),
        ),
        {"edge_mm": float(cube.edge_mm), "minutes": minutes, **dither_figures},
    )


def _with_dither(settings: ProgramSettings, plan: "Campaign", settle_s: float) -> "tuple[Campaign, list[Message], dict[str, float]]":
    """Return the campaign with the requested swings about its poses, and what they bring."""
    import numpy as np

    from lmeasure.accuracy import dither_gain
    from lmeasure.iso9283 import dithered
    from lmeasure.rig import read_rig

    if settings.dither is None:
        return plan, [], {}
    measured = [c.poses[-1] for c in plan.commands if c.target and c.role == "pose"]
    if not measured:
        raise SettingsError("dither", message("error.dither_no_pose"))
    plan = dithered(plan, settings.dither, settle_s)
    if settings.rig is None:
        return plan, [message("workflow.dither_no_rig")], {}
    rest, swinging = dither_gain(read_rig(settings.rig), np.unique(np.array(measured), axis=0), settings.dither)
    worst = int(np.argmax(swinging))
    figures = {"u_rest_um": 1e3 * float(rest[worst]), "u_dither_um": 1e3 * float(swinging[worst])}
    return plan, [message("workflow.dither", mm=settings.dither, **figures)], figures


def _record(settings: ProgramSettings, program: "Program", moving: "tuple[FloatArray, FloatArray] | None" = None) -> None:
    """Draw the commanded poses and paths, the rig, and the measured motion."""
    if settings.rerun is None:
        return
    from lmeasure.rig import read_linked_rig
    from lmeasure.view import write_scene

    rig = None if settings.rig is None else read_linked_rig(settings.rig)[0]
    write_scene(settings.rerun, program.name or "program", rig=rig, program=program, moving=moving)


def _returns(settings: ProgramSettings, program: "Program") -> "list[Message]":
    """Propose the returns that show slow faults of a rig with six cables."""
    import numpy as np

    from lmeasure.rig import read_rig
    from lmeasure.trajectory import proposed_returns

    if settings.rig is None:
        return []
    poses = {p.name: [*p.position_mm, *p.quaternion_xyzw] for p in program.pose}
    speed = settings.path_speed if program.path else None
    return proposed_returns(read_rig(settings.rig), np.array(list(poses.values())).reshape(-1, 7), tuple(poses), speed)


def _corrected(settings: ProgramSettings, commanded: Path) -> Result:
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
    made, found = corrected(_limits_of_program(settings), program, Rotation.from_quat(settings.quaternion))
    with files.whole(settings.out / "program.toml") as written, files.whole(settings.out / "corrected.csv") as table:
        write_program(written, made)
        files.write_table(table, correction_columns(found))
    _record(settings, made)
    left = tuple(one.line() for one in found if one.left)
    return Result(made, tuple(one.line() for one in found), {"led_around": float(sum(one.changed for one in found))}, left)


def _limits_of_program(settings: ProgramSettings) -> "Callable[[FloatArray], PathBounds | None]":
    """The limits of --rig or --robot: those of a mechanism's legs, drives and joints, or pressure angles and lengths of links."""
    from lmeasure.accuracy import keeping, within
    from lmeasure.core import se3
    from lmeasure.io import files
    from lmeasure.linkages import LINKS, ToolLimits
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

        def on_tool(pose: "FloatArray") -> "PathBounds | None":
            kept = own(se3.compose(pose, se3.inverse(tool)))
            return None if kept is None else ToolLimits(kept, tool)

        return on_tool
    if not isinstance(robot, ParallelFile) or len(robot.model.joint_names) != LINKS:
        raise SettingsError("robot", message("error.corrects_paths_of_platforms", name=settings.robot))
    refuse(settings, message("refuse.not_mechanism"), "limit_deg", "length_mm")
    limits = ToolLimits(PathLimits(robot.model, robot.limits), robot.tool_pose)
    return lambda pose: keeping(limits, pose)


def _cube(settings: ProgramSettings) -> "Cube":
    from lmeasure.iso9283 import cube_in_zone, largest_cube

    edges = [edge for edge in (settings.x, settings.y, settings.z) if edge is not None]
    if settings.zone is not None and not edges:
        return cube_in_zone(settings.zone, settings.plane)
    if settings.zone is not None or len(edges) != 3:
        raise SettingsError("x, y, z", message("error.give_the_box_by_x"))
    return largest_cube([e[0] for e in edges], [e[1] for e in edges], settings.plane)


def _filled_in(settings: ProgramSettings, ran: Path) -> Result:
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
