"""The run folder: run.toml, the rig (with its calibration record when linked) and the counts of each pass.

Its run.toml states how the passes were recorded too: whether the counts are the recorded ones, and the events meanwhile.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field

from lmeasure.core import DataFrame, FileFormatError, FloatArray, Shown, TrajectoryError, conventions, framed
from lmeasure.io import Strict, checked, files, inside, no_folder
from lmeasure.kernels import ATTACHMENT_XYZ
from lmeasure.recording.counts import Counts, read_counts, write_counts
from lmeasure.recording.poses import poses_from_rows
from lmeasure.rig import (
    TYPICAL_SIZES,
    CalibrationRecord,
    Rig,
    Unstated,
    read_linked_rig as read_linked_rig,
    write_calibration_record,
    write_rig,
)
from lmeasure.text import Message, count_of, joined, message, numbers

LENGTHS = "lengths_mm"
TYPED = "angles"  # Three angles in whatever convention the rig has, as a person types them behind --start
START_UNCERTAINTY = ("u_position_mm", "u_rotation_deg", "u_length_mm")
CLEARLY = 2.0  # times farther than the nearest assembly the next one must be from the place that is stated


Triple = tuple[float, float, float]


class StartTable(Strict):
    """Pose at which the counters were zeroed. State position and orientation, or the lengths of all cables."""

    position_mm: Triple | None = None
    """Position of the tool origin, base frame; approximate if you state `lengths_mm`."""
    quaternion_xyzw: tuple[float, float, float, float] | None = None
    """Orientation base_from_tool."""
    o_a_t_deg: Triple | None = None
    """Orientation in angles, for rigs with `angles = "puma-oat"`."""
    a_b_c_deg: Triple | None = None
    """Orientation in angles, for rigs with `angles = "kuka-abc"`."""
    w_p_r_deg: Triple | None = None
    """Orientation in angles, for rigs with `angles = "fanuc-wpr"`."""
    rx_ry_rz_deg: Triple | None = None
    """Orientation in angles, for rigs with `angles = "staubli-xyz"`."""
    phi_theta_psi_deg: Triple | None = None
    """Orientation in angles, for rigs with `angles = "zyz"`."""
    rx_ry_rz_rad: Triple | None = None
    """Orientation as a rotation vector, for rigs with `angles = "ur-rotation-vector"`."""
    lengths_mm: dict[str, float] | None = None
    """Length of each cable by its name, along the cable from observation point to attachment point."""
    u_position_mm: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty of each coordinate; default: see `unstated`."""
    u_rotation_deg: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty of the rotation about each axis; default: see `unstated`."""
    u_length_mm: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty of each length; default: see `unstated`."""


@dataclass(frozen=True)
class StatedStart:
    """A [start] table and where it was stated, for messages."""

    table: Any
    source: str


def stated_start(text: str) -> StatedStart:
    """Return the start of a --start option: numbers with commas or blanks, x, y, z [mm] and three angles in the rig's convention, or qx,
    qy, qz, qw, or a file with a table start.

    FileFormatError names the option or the file.
    """
    parts, turns = re.split(r"\s*,\s*|\s+", text.strip()), {6: TYPED, 7: "quaternion_xyzw"}
    if len(parts) in turns:
        with suppress(ValueError):
            numbers = [float(part) for part in parts]
            return StatedStart({"position_mm": numbers[:3], turns[len(parts)]: numbers[3:]}, f"--start {text!r}")
    if not Path(text).is_file():
        raise FileFormatError(message("error.start_is_neither_six", text=text))
    return start_from(Path(text))


def start_from_text(text: str, rig: Rig) -> FloatArray:
    """Return the (7,) pose of a --start option for a rig; FileFormatError names its fault."""
    stated = stated_start(text)
    return start_of_rig(stated.table, rig, stated.source)


def start_from(path: Path) -> StatedStart:
    """The table start of a file; FileFormatError when there is none."""
    start = files.read_toml(path).get("start")
    if start is None:
        raise FileFormatError(message("error.start_is_missing_the", where=path))
    return StatedStart(start, str(path))


def start_of_rig(start: Any, rig: Rig, path: Path | str) -> FloatArray:
    """Return the (7,) pose of a [start] table: as stated, or the one whose cables have its lengths_mm.

    Lengths fit several assemblies. The rig's `side` and the table's own position and orientation, which are then only approximate, choose
    among them. If the search may have missed some, only a stated position chooses. FileFormatError names the path, and lists the assemblies
    among which nothing chooses.
    """
    if not isinstance(start, dict) or LENGTHS not in start:
        return start_pose(start, rig.angles, path)
    from lmeasure.linkages import by_side, distances, wrapped_assemblies

    about = _about(start, rig, path)
    rig.require_pose()
    lengths, rows = _lengths(start[LENGTHS], rig, path), rig.cable_rows()
    found, all_of_them = wrapped_assemblies(rows, lengths)
    if len(found) == 0:
        raise FileFormatError(message("error.start_no_pose_of", where=path, name=rig.name))
    if rig.side is not None:
        there = by_side(found, rows, np.array(rig.side))
        if len(there) == 0:
            listed = _listed(found, all_of_them)
            raise FileFormatError(message("error.start_lengths_mm_fit_none", where=path, listed=listed, side=list(rig.side)))
        found = there
    if about[0] is not None:
        far = distances(found, about[0], about[1], _size(rows))
        found = found[np.argsort(far)]
        far = np.sort(far)
        if len(found) == 1 or far[1] > CLEARLY * far[0]:
            found = found[:1]
    if len(found) > 1 or not (all_of_them or about[0] is not None):
        hint = message("start.state_side")
        raise FileFormatError(message("error.start_lengths_mm_fit", where=path, listed=_listed(found, all_of_them), hint=hint))
    return np.asarray(found[0])


def _size(rows: FloatArray) -> float:
    """The largest arm of an attachment point [mm]."""
    return float(np.linalg.norm(rows[:, ATTACHMENT_XYZ], axis=1).max())


def _about(start: dict[str, Any], rig: Rig, path: Path | str) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the position and the orientation (quaternion) that a table with lengths states, or None for missing ones."""
    place = {key: start[key] for key in start if key != LENGTHS}
    turned = any(key not in ("position_mm", *START_UNCERTAINTY) for key in place)
    if turned and "position_mm" not in place:
        raise FileFormatError(message("error.start_an_orientation_without", where=path))
    if not turned:
        place["quaternion_xyzw"] = [0.0, 0.0, 0.0, 1.0]
    if "position_mm" not in place:
        start_pose(place | {"position_mm": [0.0, 0.0, 0.0]}, rig.angles, path)
        return None, None
    pose = start_pose(place, rig.angles, path)
    return pose[:3], pose[3:] if turned else None


def _lengths(table: Any, rig: Rig, path: Path | str) -> FloatArray:
    names = [c.name for c in rig.cable]
    if not isinstance(table, dict) or set(table) != set(names):
        raise FileFormatError(message("error.start_lengths_mm_must", where=path, names=", ".join(names)))
    lengths = np.array([_numbers({name: [table[name]]}, name, 1, path)[0] for name in names])
    if not (lengths > 0.0).all():
        raise FileFormatError(message("error.start_lengths_mm_is", where=path, names=names[int(np.argmin(lengths))], lengths=lengths.min()))
    return lengths


def _listed(poses: FloatArray, all_of_them: bool) -> str:
    """Assemblies for a person, and whether there may be others."""
    texts = []
    for pose in poses:
        place = ", ".join(f"{x:.1f}" for x in pose[:3])
        texts.append(message("start.pose", place=place, turn=", ".join(f"{x:.3f}" for x in pose[3:])))
    return message("start.assemblies" if all_of_them else "start.assemblies_at_least", count=len(poses), poses=joined(texts))


def start_pose(start: Any, angles: str, path: Path | str) -> FloatArray:
    """(7,) the pose of a [start] table, its angles in the given convention; FileFormatError names the path and key."""
    if not isinstance(start, dict):
        raise FileFormatError(message("error.start_is_missing_the", where=path))
    convention = conventions.convention(angles)
    unit = convention.columns[0].rsplit("_", 1)[1]
    angle_key = "_".join(c.rsplit("_", 1)[0] for c in convention.columns) + f"_{unit}"
    if TYPED in start:
        start = {angle_key if key == TYPED else key: value for key, value in start.items()}
    known = ("position_mm", "quaternion_xyzw", angle_key, LENGTHS, *START_UNCERTAINTY)
    unknown = sorted(set(start) - set(known))
    if unknown:
        raise FileFormatError(message("error.start_unknown_key_known", where=path, unknown=unknown[0], known=", ".join(known)))
    position = _numbers(start, "position_mm", 3, path)
    if ("quaternion_xyzw" in start) == (angle_key in start):
        raise FileFormatError(message("error.start_give_either_quaternion", where=path, angle_key=angle_key))
    if "quaternion_xyzw" in start:
        quaternion = _numbers(start, "quaternion_xyzw", 4, path)
    else:
        turned = _numbers(start, angle_key, 3, path)
        conventions.check_angles(turned, f"{path}: start: {angle_key}")
        quaternion = conventions.rotation_from_angles(angles, turned).as_quat()
    try:
        return np.asarray(poses_from_rows(np.concatenate([position, quaternion])).rows[0])
    except FileFormatError as error:
        raise FileFormatError(message("error.start", where=path, error=error)) from None


UStart = tuple[float | None, ...]
"""Standard uncertainties of a start as stated, None where they are not: of each coordinate [mm], about each axis [rad], of each length."""


@dataclass(frozen=True)
class StartErrors:
    """Standard uncertainties of a start pose, in the order of `UStart`; assumed: which typical size each is, empty of a stated one."""

    u: tuple[float, ...]
    assumed: tuple[str, ...]

    @classmethod
    def of(cls, stated: UStart, unstated: Unstated) -> "StartErrors":
        """Return them with typical sizes for unstated ones, or 0. A pose from lengths has these errors alone."""
        keys = [key if u is None and unstated == "typical" else "" for key, u in zip(START_UNCERTAINTY, stated, strict=False)]
        if len(stated) > 2:
            keys[:2] = "", ""
        sizes = (0.0 if not key else TYPICAL_SIZES[key].value * (math.radians(1.0) if key.endswith("_deg") else 1.0) for key in keys)
        return cls(tuple(size if u is None else u for u, size in zip(stated, sizes, strict=True)), tuple(keys))


def start_uncertainty(start: dict[str, Any], path: Path | str) -> UStart:
    """(mm, rad) standard uncertainties of a [start] table, per coordinate and per axis, and behind them that of each length [mm] where the
    pose comes from lengths; None where it states none."""
    values: list[float | None] = []
    for key in START_UNCERTAINTY:
        value = start.get(key)
        if value is None:
            values.append(None)
            continue
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= conventions.MAX_LENGTH_MM:
            raise FileFormatError(message("error.start_is_not_a", where=path, key=key, value=value))
        values.append(float(value))
    from_lengths = LENGTHS in start or START_UNCERTAINTY[2] in start
    return values[0], None if values[1] is None else math.radians(values[1]), *(values[2:] if from_lengths else ())


def uncertainty_entries(u_start: UStart) -> dict[str, float]:
    """The entries of a [start] table that `start_uncertainty` reads."""
    values = (u_start[0], None if u_start[1] is None else math.degrees(u_start[1]), *u_start[2:])
    return {key: value for key, value in zip(START_UNCERTAINTY, values, strict=False) if value is not None}


def _numbers(table: dict[str, Any], key: str, count: int, path: Path | str) -> FloatArray:
    values = table.get(key)
    if isinstance(values, list) and len(values) == count and all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        with suppress(OverflowError):  # an integer of hundreds of digits
            numbers = np.array([float(v) for v in values])
            if np.isfinite(numbers).all():
                return numbers
    raise FileFormatError(message("error.start_must_be_numbers", where=path, key=key, count=count))


SCHEMA = "lmeasure.run/1"


def _temperature(value: float) -> float:
    conventions.check_temperature(value, "temperature")
    return value


class RunPass(Strict):
    """Pass of the motion."""

    counts: str
    """Counts file of the pass, .csv or .parquet, in the run folder."""


class RunFile(Strict):
    """Recorded run: rig, counts and start pose."""

    schema_: Annotated[Literal["lmeasure.run/1"], Field(alias="schema")]
    """Kind and version of the file."""
    rig: str | None = None
    """Rig file in the run folder; not needed with `--rig`."""
    unstated: Unstated = "typical"
    """Meaning of a missing uncertainty of the start or of a missing temperature: typical, a typical size; exact, none."""
    passes: Annotated[tuple[RunPass, ...], Field(alias="pass")]
    """Passes in order, one table `[[pass]]` each."""
    temperature_c: Annotated[float, AfterValidator(_temperature)] | None = None
    """Temperature at the start pose, and of passes without recorded temperatures."""
    start: StartTable | None = None
    """Pose at which the counters were zeroed; default: unknown."""
    note: Any = None
    """Remark."""
    recording: Any = None
    """Bus, clock, faults, closure and digests of each pass, written by `record` and `import`. Do not edit."""


HARMLESS = ("duplicate", "duplicate_sync", "reordered", "wrap", "stamp", "clock_wrap", "unanswered")
"""Faults that do not change the counts."""


@dataclass(frozen=True)
class Recorded:
    """Recording conditions of one pass.

    early: the recording broke off, why: the reason; faults: number of each kind; closure_counts: by channel, the recorder's mean of the
    last rest minus that of the first; sha256: digests of the recorder's files, by name.
    """

    passage: int
    early: bool = False
    why: str = ""
    faults: Mapping[str, int] = field(default_factory=dict)
    closure_counts: Mapping[str, float] = field(default_factory=dict)
    sha256: Mapping[str, str] = field(default_factory=dict)

    def notes(self) -> list[Message]:
        """Return the notes for a reader of poses."""
        out = []
        if self.early:
            early = {"number": self.passage}
            out.append(message("recording.early.why", **early, why=self.why) if self.why else message("recording.early", **early))
        faults = tuple(count_of(kind, n) for kind, n in sorted(self.faults.items()) if n and kind not in HARMLESS)
        if faults:
            out.append(message("recording.faults", number=self.passage, faults=faults))
        return out


def recording_at(path: Path) -> bool:
    """Return whether a file is part of a recording: of a run that `record` has made, or of a campaign that `capture` has made.

    A recording is the counts and frames of a folder, and the run.toml that describes them.
    """
    folder, name = Path(path).parent, Path(path).name
    if (folder / "capture.toml").is_file():
        return name in ("capture.toml", "counts.csv")
    if not re.fullmatch(r"run\.toml|rig\.toml|pass\d+\.(csv|log|events\.csv)", name):
        return False
    try:
        entries = files.read_toml(folder / "run.toml").get("recording", [])
    except (FileFormatError, OSError):
        return False
    return any("frames" in entry for entry in entries if isinstance(entry, dict)) if isinstance(entries, list) else False


class RecordedTable(Strict):
    """Entry of `record` and `import` for a pass, as far as it is read again."""

    model_config = ConfigDict(extra="ignore")
    passage: Annotated[int | None, Field(alias="pass")] = None
    ended: Any = None
    why: str = ""
    faults: dict[str, int] = Field(default_factory=dict)
    closure_counts: dict[str, float] = Field(default_factory=dict)
    sha256: dict[str, str] = Field(default_factory=dict)
    frames: Any = None

    def recorded(self, number: int) -> Recorded:
        """Return how the pass was recorded; number: of the table, which is the pass's where it states none."""
        # an import's digests are of logs that lie elsewhere, perhaps under the name of its counts
        digests = {} if self.frames is None else self.sha256
        return Recorded(self.passage or number, self.ended == "early", self.why, self.faults, self.closure_counts, digests)


class _Recordings(Strict):
    model_config = ConfigDict(extra="ignore")
    recording: tuple[RecordedTable, ...] = ()


def recorded_in(data: dict[str, Any], path: Path) -> tuple[Recorded, ...]:
    """Return the [[recording]] tables of a run.toml; FileFormatError names one in another form than that of `record` and `import`."""
    return tuple(one.recorded(number) for number, one in enumerate(checked(data, _Recordings, str(path)).recording, 1))


def check_digests(recorded: tuple[Recorded, ...], counts: Mapping[str, Path], path: Path) -> None:
    """FileFormatError names the first of the counts files, by their names in run.toml, whose bytes are not those that were recorded."""
    for entry in recorded:
        for name, digest in entry.sha256.items():
            if name in counts and files.sha256(counts[name]) != digest.lower():
                raise FileFormatError(message("error.is_not_the_file", where=counts[name], path=path))


def notes_of(recorded: tuple[Recorded, ...]) -> tuple[Message, ...]:
    """Return the notes on the recording for a reader of poses."""
    return tuple(note for entry in recorded for note in entry.notes())


@dataclass(frozen=True, repr=False)
class Run(Shown):
    """Recorded run: rig, start pose and the counts of each pass.

    Examples
    --------
    >>> run.rig.name, len(run.passes)
    ('simulated cell 1', 1)
    """

    rig: Rig
    """Instrument."""
    start: FloatArray | None
    """(7,) pose base_from_tool at which the counters were zeroed: x, y, z [mm], qx, qy, qz, qw. None: unknown."""
    passes: tuple[Counts, ...]
    """Counts of each pass."""
    calibration: CalibrationRecord | None = None
    """Linked calibration record of the rig, or None."""
    u_start: UStart = (None, None)
    """Standard uncertainties of the start pose: each coordinate [mm], rotation about each axis [rad], and each length [mm] if stated.
    None: not stated."""
    temperature_c: float | None = None
    """Temperature at the start pose, and of passes without recorded temperatures [°C]."""
    recorded: tuple[Recorded, ...] = ()
    """Recording conditions of the passes, if known."""
    unstated: Unstated = "typical"
    """Whether missing uncertainties of the start and a missing temperature mean typical sizes, or none ("exact")."""

    def __post_init__(self) -> None:
        _zero(self)

    def by_frames(self) -> "Run":
        """Return the run whose channels have the counts of their own frames, each at its own time."""
        return self if all(one.frames is None for one in self.passes) else replace(self, passes=tuple(p.by_frames() for p in self.passes))

    def about(self) -> dict[str, str]:
        """Rig, samples, start, calibration."""
        return {
            "rig": self.rig.name,
            "samples": ", ".join(f"{len(c.time_s)} over {c.time_s[-1] - c.time_s[0]:.6g} s" for c in self.passes),
            "start": "unknown" if self.start is None else numbers("en", self.start[:3], ".6g") + " mm",
            "calibration": "none" if self.calibration is None else f"of {len(self.calibration.parameters)} parameters",
        }

    def to_frame(self) -> DataFrame:
        """The recorded counts of all passes, one under the other."""
        import pandas as pd

        return pd.concat([framed(counts.columns()).assign(**{"pass": n}) for n, counts in enumerate(self.passes, 1)], ignore_index=True)

    @property
    def known_start(self) -> FloatArray:
        """Return the (7,) start pose; TrajectoryError, with the remedy, if it is unknown."""
        return known(self.start, self.passes[0].source if self.passes else "", self.rig)

    @property
    def start_errors(self) -> StartErrors:
        """The standard uncertainties of the start pose, typical ones where none are stated."""
        return StartErrors.of(self.u_start, self.unstated)


@dataclass(frozen=True)
class RunHead:
    """A run folder without its counts: the files that hold them, and which of them broke off while they were recorded."""

    rig: Rig
    start: FloatArray | None
    counts: tuple[Path, ...]
    torn: tuple[bool, ...]
    calibration: CalibrationRecord | None = None
    u_start: UStart = (None, None)
    temperature_c: float | None = None
    recorded: tuple[Recorded, ...] = ()
    unstated: Unstated = "typical"

    def __post_init__(self) -> None:
        _zero(self)

    @property
    def known_start(self) -> FloatArray:
        return known(self.start, str(self.counts[0]), self.rig)

    @property
    def start_errors(self) -> StartErrors:
        return StartErrors.of(self.u_start, self.unstated)


def _zero(run: Run | RunHead) -> None:
    """Take the counters of a run's rig as zeroed at the run's start, where it is known."""
    if run.start is not None:
        object.__setattr__(run, "rig", run.rig.zeroed_at(run.start))


def known(start: FloatArray | None, source: str, rig: Rig) -> FloatArray:
    """(7,) the start pose; TrajectoryError, which names the source, where it is unknown."""
    if start is None:
        run = f"{source}: " if source else ""
        absolute = any(rig.counter(o).absolute for o in rig.observed)
        why = "what is asked needs it stated" if absolute else "its channels are not absolute"
        raise TrajectoryError(message("error.the_start_pose_of", run=run, why=why))
    return start


def read_run(folder: Path, rig_path: Path | None = None, start: StatedStart | None = None) -> Run:
    """Read a run folder.

    Parameters
    ----------
    folder
        Folder with a run.toml.
    rig_path
        rig.toml that replaces the run's own.
    start
        Start pose that replaces the run's [start].

    Returns
    -------
    Run
        Rig, calibration, start pose and counts.

    Raises
    ------
    FileFormatError
        If a file is wrong, the counts are not those that were recorded, or the calibration belongs to another rig.

    Examples
    --------
    >>> lm.read_run(Path("run")).start.tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    """
    head = read_run_head(folder, rig_path, start)
    passes = tuple(read_counts(path, torn=torn) for path, torn in zip(head.counts, head.torn, strict=True))
    return Run(head.rig, head.start, passes, head.calibration, head.u_start, head.temperature_c, head.recorded, head.unstated)


def read_run_head(folder: Path, rig_path: Path | None = None, start: StatedStart | None = None) -> RunHead:
    """`read_run` without the counts."""
    folder = Path(folder)
    path = folder / "run.toml"
    if not folder.is_dir():
        raise FileFormatError(message("error.is_not_a_run", where=folder, hint=no_folder(folder, path.name)))
    data = files.read_toml(path)
    if not isinstance(data.get("pass"), list) or not data["pass"]:
        raise FileFormatError(message("error.pass_is_missing", where=path))
    table = checked(data, RunFile, str(path))
    if table.rig is None and rig_path is None:
        raise FileFormatError(message("error.rig_is_missing_it", where=path))
    rig, calibration = read_linked_rig(rig_path or inside(folder, table.rig or "", f"{path}: rig", message("run.the_folder")))
    if len(table.passes) < rig.passes:
        raise FileFormatError(message("error.has_pass_but_the", where=path, n_passes=len(table.passes), passes=rig.passes))
    names = [one.counts for one in table.passes]
    counts = [inside(folder, name, f"{path}: pass {n}: counts", message("run.the_folder")) for n, name in enumerate(names, 1)]
    recorded = recorded_in(data, path)
    check_digests(recorded, dict(zip(names, counts, strict=True)), path)
    torn = tuple(any(r.early and r.passage == number for r in recorded) for number in range(1, len(counts) + 1))
    stated, where = (data.get("start"), str(path)) if start is None else (start.table, start.source)
    pose = None if stated is None else start_of_rig(stated, rig, where)
    u_start = (None, None) if stated is None else start_uncertainty(stated, where)
    return RunHead(rig, pose, tuple(counts), torn, calibration, u_start, table.temperature_c, recorded, table.unstated)


Write = Callable[[Path, Counts], None]


def write_run(
    folder: Path, run: Run, extra: dict[str, Any] | None = None, suffix: str = ".csv", *, writers: Sequence[Write] | None = None
) -> None:
    """Write a run folder: counts first, run.toml last, so that a folder with a run.toml is complete.

    Parameters
    ----------
    folder
        Folder to write.
    run
        Run to write, with its rig and calibration.
    extra
        Further content of run.toml.
    suffix
        ".csv" or ".parquet" for the counts.
    writers
        Writers of the counts of each pass, for passes that are not whole in memory.

    Examples
    --------
    >>> lm.write_run(Path("copy"), run, suffix=".parquet")
    >>> sorted(path.name for path in Path("copy").iterdir())
    ['pass1.parquet', 'rig.toml', 'run.toml']
    """
    folder = Path(folder)
    rig = run.rig.model_copy(update={"calibration": "calibration.json" if run.calibration else None})
    if run.calibration:
        write_calibration_record(folder / "calibration.json", run.calibration)
    write_rig(folder / "rig.toml", rig)
    names = [f"pass{i + 1}{suffix}" for i in range(len(run.passes))]
    for name, counts, write in zip(names, run.passes, writers or [write_counts] * len(names), strict=True):
        write(folder / name, counts)
    start: dict[str, Any] = {}
    if run.start is not None:
        pose = {"position_mm": run.start[:3].tolist(), "quaternion_xyzw": run.start[3:].tolist()}
        start = {"start": pose | uncertainty_entries(run.u_start)}
    files.write_toml(
        folder / "run.toml",
        {"schema": SCHEMA, "rig": "rig.toml"}
        | ({} if run.unstated == "typical" else {"unstated": run.unstated})
        | ({} if run.temperature_c is None else {"temperature_c": run.temperature_c})
        | start
        | {"pass": [{"counts": n} for n in names]}
        | (extra or {}),
    )
