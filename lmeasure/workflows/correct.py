"""From an identified robot to programs that take it where they were meant to."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from lmeasure.core import RobotError, SettingsError
from lmeasure.text import composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, workflow
from lmeasure.workflows.settings import BOX, LANGUAGE, Box, Names, Numbers, Paths, Spans, Writing, option, pose_of, refuse

if TYPE_CHECKING:
    from lmeasure.core import FloatArray
    from lmeasure.robot_programs import Corrected, Dialect, Listing
    from lmeasure.robots import Limits


class Settings(Writing):
    """Settings of `lmeasure correct`."""

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
        """Corrected files from programs and an identification."""
        outputs = inside(self.out, "corrections.json", "corrections.html", *(path.name for path in self.programs))
        known = () if self.identified is None else inside(self.identified, "identified.json", "robot.toml")
        return Paths(outputs, (*self.programs, *present(self.frames, self.map), *known))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Corrected]":
    """Correct, and write the programs and what was done."""
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
"""Corrects a program, and says what is to be known of how."""


def _by_model(settings: Settings) -> Correcting:
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


def _by_map(settings: Settings) -> Correcting:
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


def _limits(settings: Settings) -> "Limits":
    import numpy as np

    from lmeasure.robots import Limits

    box = () if settings.keep_out is None else (np.array(settings.keep_out),)
    return Limits(settings.most_mm, float(np.radians(settings.most_deg)), settings.clip, box)


def _listing(settings: Settings) -> "tuple[Listing, Dialect]":
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
