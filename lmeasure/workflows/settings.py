"""Settings of commands: frozen models with unit, range and help of every option, for command lines, forms and scripts."""

import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import core_schema

from lmeasure.core import FileFormatError, SettingsError, pasted, rotation_from_angles, words_of
from lmeasure.io import complaints
from lmeasure.text import message, reason

if TYPE_CHECKING:
    from lmeasure.core import FloatArray
    from lmeasure.text import Message
    from lmeasure.trajectory import Stated

START = "x,y,z in mm and three angles in the rig's convention, or x,y,z and qx,qy,qz,qw, or a file with a table start"
BOX = "X0:X1,Y0:Y1,Z0:Z1"
_COUNTS = {2: "two", 3: "three", 4: "four"}
_UNITS = {"mm": "mm", "mm_s": "mm/s", "deg": "deg", "rad": "rad", "s": "s", "n": "N", "percent": "%"}


class Paths(NamedTuple):
    """Files that a command may write, and files that it reads."""

    outputs: tuple[Path, ...] = ()
    inputs: tuple[Path, ...] = ()


class CommandSettings(BaseModel):
    """Settings of a command. SettingsError, in one line, for an option that is missing, unknown, or out of its range."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    NEXT: ClassVar[str] = ""
    """Words of the command to type next, with the names of options in braces for their values."""

    def paths(self) -> Paths:
        """Return the paths that the command may write and read, for the rule of `lmeasure.workflows.flow`."""
        return Paths()

    def following(self) -> str:
        """Return the command to type next, unless the result names another."""
        return then(self.NEXT, **dict(self))

    @model_validator(mode="wrap")
    @classmethod
    def _in_one_line(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(data)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = str(first["loc"][0]) if first["loc"] else ""
            if first["type"] == "literal_error":
                text: str = message("error.is_not_one_of_2", name=first["input"], templates=", ".join(_choices(cls.model_fields[name])))
            elif first["type"] == "value_error":
                text = reason(first["ctx"]["error"])
            else:
                text = complaints(error, data, cls)[0][1]
            raise SettingsError(name, text) from None


def _choices(field: FieldInfo) -> list[str]:
    return [str(choice) for part in (field.annotation, *get_args(field.annotation)) for choice in get_args(part) if isinstance(choice, str)]


def option(
    text: str,
    *,
    flag: str | None = None,
    also: tuple[str, ...] = (),
    metavar: str | None = None,
    panel: str | None = None,
    unit: str | None = None,
    ge: float | None = None,
    le: float | None = None,
    within: tuple[float, float] | None = None,
    positional: bool = False,
    words: str | None = None,
) -> Any:
    """Return the field of an option.

    Parameters
    ----------
    text
        Help.
    flag
        Option as it is typed; by default `--` and the name.
    also
        Other flags for it, such as the former option of an argument.
    panel
        Group in the help, and in a form.
    unit
        Unit; by default that in which the name ends.
    ge, le
        Range, both ends included.
    within
        Range that the stage itself checks.
    words
        Names that it may be, as module:NAME, for completion.
    """
    extra: dict[str, Any] = {
        "flag": flag,
        "also": also or None,
        "metavar": metavar,
        "panel": panel,
        "unit": unit,
        "positional": positional or None,
        "words": words,
    }
    if within is not None:
        extra |= {"minimum": within[0], "maximum": within[1]} if math.isfinite(within[1]) else {"minimum": within[0]}
    return Field(description=text, ge=ge, le=le, json_schema_extra={key: value for key, value in extra.items() if value is not None})


def then(words: str, **values: object) -> str:
    """Return a command line to copy: the words with values in braces, which are quoted where a shell needs it."""
    filled = words.format(**{name: pasted(value) for name, value in values.items()})
    return f"{os.environ.get('LMEASURE_PROGRAM', 'lmeasure')} {filled}" if filled else ""


class Writing(CommandSettings):
    """Settings of a command that writes files."""

    OUT_FILE: ClassVar[str] = ""
    """Name of the file that --out names, where the command writes one; empty where --out is a folder."""

    force: Annotated[bool, option("Replace existing files, but never inputs and recordings.", flag="--force")] = False

    @field_validator("out", mode="before", check_fields=False)
    @classmethod
    def _file_in_folder(cls, value: Any) -> Any:
        """Return the file in a folder: `--out results/` of a command that writes one file."""
        if cls.OUT_FILE and isinstance(value, str | Path) and (str(value).endswith(("/", os.sep)) or Path(value).is_dir()):
            return Path(value) / cls.OUT_FILE
        return value


def unit_of(name: str, field: FieldInfo) -> str:
    """Unit of an option: the stated one, else that in which its name ends; empty where it has none."""
    stated = said_of(field).get("unit")
    return str(stated) if stated else next((unit for end, unit in _UNITS.items() if name.endswith(f"_{end}")), "")


def said_of(field: FieldInfo) -> dict[str, Any]:
    """Return the arguments of `option` beside help and range."""
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


@dataclass(frozen=True)
class Separated:
    """Marks values that a command line and a form write as one text, with `mark` between them; Python gives them as a tuple."""

    mark: str
    kind: Callable[[str], Any] = float
    count: int | None = None
    finite: bool = False
    """Whether numbers that are not finite are refused here, not by the stage."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.parsed, handler(source))

    def parsed(self, value: Any) -> Any:
        """Return the tuple of a text; ValueError names its fault."""
        if not isinstance(value, str):
            return value
        try:
            out = tuple(self.kind(part) for part in parts_of(value, self.mark))
        except ValueError:
            out = ()
        endless = self.finite and not all(map(math.isfinite, out))
        if not out or endless or (self.count is not None and len(out) != self.count):
            what = "whole numbers" if self.kind is int else "numbers"
            between = f"{self.mark!r} or a blank" if self.mark == "," else f"{self.mark!r}"
            raise ValueError(
                message("error.is_not_with_between", value=value, stated=_COUNTS.get(self.count or 0, "some"), what=what, between=between)
            )
        return out

    def written(self, values: Any) -> str:
        """The text of a tuple."""
        return self.mark.join(v if isinstance(v, str) else f"{v:g}" for v in values)


@dataclass(frozen=True)
class Turned(Separated):
    """Marks a quaternion x, y, z, w, or the angles of a convention behind its name: `kuka-abc:10,20,30`."""

    def parsed(self, value: Any) -> Any:
        name, colon, rest = value.partition(":") if isinstance(value, str) else ("", "", "")
        if not colon:
            return super().parsed(value)
        angles = Separated(",", count=3, finite=True).parsed(rest)
        try:
            return tuple(rotation_from_angles(name.strip(), angles).as_quat().tolist())
        except FileFormatError as error:
            raise ValueError(str(error)) from None


def parts_of(text: str, mark: str = ",") -> list[str]:
    """Return the parts of a text between its marks; for commas, blanks are marks too."""
    return re.split(r"\s*,\s*|\s+", text.strip()) if mark == "," else text.split(mark)


@dataclass(frozen=True)
class Pose:
    """Marks a text that may be the numbers of a pose, or something else."""

    count: int = 7


@dataclass(frozen=True)
class Words(Separated):
    """Marks words that are written as one text with commas; blanks around them, and empty ones, are nothing."""

    def parsed(self, value: Any) -> Any:
        return words_of(value) if isinstance(value, str) else value


@dataclass(frozen=True)
class Spans(Separated):
    """Marks a box that is written as three low:high with commas."""

    def parsed(self, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        spans = value.split(self.mark)
        if len(spans) != 3:
            raise ValueError(message("error.is_not", value=value, box=BOX))
        return tuple(Separated(":", count=2).parsed(span) for span in spans)


@dataclass(frozen=True)
class Ends(Separated):
    """Marks the ends of a range, which may be written with its step, as other commands take it."""

    def parsed(self, value: Any) -> Any:
        ends, _, step = value.rpartition(self.mark) if isinstance(value, str) and value.count(self.mark) == 2 else (value, "", "")
        return super().parsed(ends if not step or super().parsed(f"0:{step}") else value)


def _recording(path: Path) -> Path:
    if path.suffix.lower() != ".rrd":
        raise ValueError(message("error.does_not_end_in_rrd", path=str(path)))
    return path


def _unit(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if not abs(sum(v * v for v in value) - 1.0) < 1e-3:
        raise ValueError(message("error.is_not_a_unit", names=",".join(f"{v:g}" for v in value)))
    return value


def _six_or_seven(value: str) -> str:
    """Numbers alone are no name of a file."""
    numbers = 0
    with suppress(ValueError):
        numbers = len([float(part) for part in parts_of(value)])
    if numbers not in (0, 6, 7):
        raise ValueError(message("error.is_numbers_wanted_are", value=value, numbers=numbers, start=START))
    return value


def _listed(value: Any) -> Any:
    return tuple(part.strip() for part in value.split(";") if part.strip()) if isinstance(value, str) else value


def _are_distances(values: tuple[str, ...]) -> tuple[str, ...]:
    for value in values:
        parts = value.split(",")
        try:
            numbers = [float(part) for part in parts[2:]]
        except ValueError:
            numbers = []
        if len(parts) != 4 or len(numbers) != 2 or not (0.0 < numbers[0] < 1e5 and 0.0 <= numbers[1] < 1e3):
            raise ValueError(message("error.is_not_name1_name2", value=value))
    return values


def distances(values: tuple[str, ...]) -> list[tuple[str, str, float, float]]:
    """Names, distance and standard uncertainty [mm] of texts that were checked."""
    return [(a.strip(), b.strip(), float(mm), float(u)) for a, b, mm, u in (value.split(",") for value in values)]


Distances = Annotated[tuple[str, ...], BeforeValidator(_listed), AfterValidator(_are_distances)]
"""NAME1,NAME2,mm,u with ';' between several."""
Range = Annotated[tuple[float, float, float], Separated(":", count=3)]
"""start:stop:step, both ends included."""
Edges = Annotated[tuple[float, float], Ends(":", count=2)]
"""start:stop, or start:stop:step, whose step is of no use here."""
Pair = Annotated[tuple[float, float], Separated(":", count=2)]
Box = Annotated[tuple[tuple[float, float], tuple[float, float], tuple[float, float]], Spans(",")]
"""Low and high along X, Y and Z."""
Point = Annotated[tuple[float, float, float], Separated(",", count=3, finite=True)]
Numbers = Annotated[tuple[float, ...], Separated(",")]
WholeNumbers = Annotated[tuple[int, ...], Separated(",", int)]
Quaternion = Annotated[tuple[float, float, float, float], Turned(",", count=4)]
UnitQuaternion = Annotated[tuple[float, float, float, float], AfterValidator(_unit), Turned(",", count=4)]
Names = Annotated[tuple[str, ...], Words(",", str)]
Recording = Annotated[Path, AfterValidator(_recording)]
Start = Annotated[str, AfterValidator(_six_or_seven), Pose()]
"""A pose as text, or a file that has it."""
LANGUAGE = option("Language of the report (en, ru); default that of the terminal (LANG).")
RIG = option("rig.toml; its table [can] assigns frames to counters.", metavar="RIG", positional=True, also=("--rig",))
BROWSER = option("Open the page in this machine's browser, if standard output is a terminal.", flag="--browser/--no-browser")
RERUN = option("Also write a 3-D recording for `lmeasure view`.", metavar="FILE.rrd")
TRAJECTORY = "Trajectory from `reconstruct` or another instrument: .csv, .parquet, .tum, EuRoC, Motive, Nexus, .mcap."
COLUMNS = option("Meaning and unit of each column (mm, m, cm, um, in, deg, rad, s, ms, us, ns).", metavar="NAME=COLUMN[UNIT],...")
ANGLES = option(
    "Convention of the file's angles, if its units do not determine it.",
    metavar="CONVENTION",
    words="lmeasure.core.conventions:CONVENTIONS",
)
ALIGN = option("Transform the poses into the frame of this program, by a fit to its poses in their windows.", metavar="program.toml")
U_POSITION = option("Standard uncertainty of each measured coordinate; default from the file.", ge=0)
U_ROTATION = option("Standard uncertainty of a measured orientation about each axis.", ge=0)


def stated_beside(settings: Any) -> "Stated":
    """Return the statements of a command's options on a trajectory's file: columns, uncertainties, convention of angles."""
    from lmeasure.io import columns_of
    from lmeasure.trajectory import Stated

    turn = radians_of(settings.u_rotation_deg)
    return Stated(columns_of(settings.columns), settings.u_position_mm, turn, angles=known_convention(settings.angles))


def notes_of_file(notes: "Iterable[Message]") -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the lines on the reading of a file and its faults, and the latter alone."""
    lines = {message("line.note", text=note): note.code not in ("orientation.read", "time.of_day") for note in notes}
    return tuple(lines), tuple(line for line, wrong in lines.items() if wrong)


def known_convention(name: str | None) -> str | None:
    """Return the name of a convention of angles; SettingsError lists the known ones."""
    from lmeasure.core import CONVENTIONS

    if name is not None and name not in CONVENTIONS:
        raise SettingsError("angles", message("error.is_not_one_of_2", name=name, templates=", ".join(CONVENTIONS)))
    return name


def refuse(settings: CommandSettings, why: str, *names: str) -> None:
    """Raise SettingsError with the reason for the first of these options that is given."""
    for name in names:
        value = getattr(settings, name)
        if value is not None and value is not False and value not in ("", ()):
            raise SettingsError(name, why)


def places_of(span: tuple[float, float, float], name: str, least: int, most: int) -> "FloatArray":
    """Places of a start:stop:step, both ends included; SettingsError for fewer or more."""
    import numpy as np

    start, stop, step = span
    count = math.floor((stop - start) / step + 1e-9) + 1 if step > 0.0 and stop >= start else 0
    if not least <= count <= most:
        raise SettingsError(name, message("error.must_be_to_places", least=least, most=most))
    return np.asarray(start + step * np.arange(count), dtype=np.float64)


def pose_with(position_mm: "Sequence[float] | FloatArray", quaternion: Sequence[float]) -> "FloatArray":
    """(7,) of --position-mm and --quaternion; SettingsError where the latter is not of length 1."""
    import numpy as np

    from lmeasure.recording import UNIT_TOLERANCE, poses_from_rows

    length = math.hypot(*quaternion)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise SettingsError("quaternion", message("error.its_length_is_not", length=length))
    return np.asarray(poses_from_rows(np.array([[*position_mm, *quaternion]])).rows[0])


def radians_of(deg: float | None) -> float | None:
    """Radians of degrees; None of None."""
    return None if deg is None else math.radians(deg)


def pose_of(values: tuple[float, ...], name: str) -> "FloatArray":
    """(7,) of x,y,z in mm, or of these and a quaternion."""
    import numpy as np

    length = float(np.linalg.norm(values[3:])) if len(values) == 7 else 0.0
    if len(values) not in (3, 7) or not np.isfinite(values).all() or (len(values) == 7 and abs(length - 1.0) > 1e-3):
        raise SettingsError(name, message("error.is_x_y_z"))
    turn = np.array(values[3:]) / length if len(values) == 7 else np.array([0.0, 0.0, 0.0, 1.0])
    return np.concatenate([values[:3], turn])
