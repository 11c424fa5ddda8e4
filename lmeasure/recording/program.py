"""The robot's program: commanded poses and paths, as program.toml writes them, and, once it has run, when."""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from lmeasure.core import DataFrame, FloatArray, Shown, conventions, framed
from lmeasure.io import Strict, Whole, checked, files, of_key
from lmeasure.text import message

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

NEEDS = {
    "linear": ("start_mm", "end_mm"),
    "circular": ("centre_mm", "normal", "radius_mm", "start_mm"),
    "rectangular": ("corners_mm",),
    "points": ("points_mm",),
}


def _one_line(value: str) -> str:
    if not value.isprintable():
        raise ValueError(message("error.must_be_one_line"))
    return value


def _in_order(windows: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    for number, (start, end) in enumerate(windows, 1):
        if not start < end:
            raise ValueError(message("error.window_s_does_not", number=number, start=start, end=end))
    for number, ((_, end), (start, _)) in enumerate(itertools.pairwise(windows), 1):
        if start < end:
            raise ValueError(message("error.window_starts_at_s", number=number + 1, start=start, number2=number, end=end))
    return windows


def _unit(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    length = math.hypot(*value)
    if abs(length - 1.0) > 1e-6:
        raise ValueError(message("error.is_not_of_length", length=length))
    return value


Label = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_one_line)]
Coordinate = Annotated[float, Field(ge=-conventions.MAX_LENGTH_MM, le=conventions.MAX_LENGTH_MM)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Quaternion = Annotated[tuple[float, float, float, float], AfterValidator(_unit)]
Positive = Annotated[float, Field(gt=0)]
Cycles = Annotated[Whole, Field(ge=1, le=100_000)]
Windows = Annotated[tuple[tuple[float, float], ...], AfterValidator(_in_order)]
"""Intervals of time [s], one per cycle, in order."""


class _Run(Strict):
    """Common keys of poses and paths: name, cycles, speed and load."""

    name: Label
    """Name in certificates."""
    windows_s: Windows = ()
    """Times [begin, end] of the dwells or runs, one per cycle; default: found by `certify`."""
    cycles: Cycles | None = None
    """Number of cycles; another number of windows is refused."""
    speed_percent: Annotated[float, Field(gt=0, le=100)] | None = None
    """Speed in percent of the rated speed."""
    load_kg: Annotated[float, Field(ge=0)] | None = None
    """Load at the flange; default: the load of the program."""

    @model_validator(mode="after")
    def _all_cycles(self) -> Self:
        if self.cycles is not None and self.windows_s and len(self.windows_s) != self.cycles:
            raise ValueError(message("error.has_windows_for_cycles", n_windows_s=len(self.windows_s), cycles=self.cycles))
        return self


class CommandedPose(_Run):
    """Pose that the robot is commanded to reach. Its windows are dwells."""

    position_mm: Vector
    """Position of the tool origin, base frame."""
    quaternion_xyzw: Quaternion
    """Orientation base_from_tool."""
    approaches: tuple[Label, ...] = ()
    """Direction of approach of each dwell (7.2.3), one per window."""
    units: tuple[Label, ...] = ()
    """Robot of each dwell (7.7), one per window."""
    settling_s: Windows = ()
    """Times [before arrival, at rest], one per cycle, for stabilisation time and overshoot (7.4, 7.5)."""
    limit_band_mm: Positive | None = None
    """Limit band around the final pose for the same; default: the pose repeatability."""
    dither_mm: Vector | None = None
    """Largest displacements of the tool in the swings about the pose while it is measured, base frame."""
    dither_s: Positive | None = None
    """Duration of one swing to and fro; needs dither_mm."""

    @model_validator(mode="after")
    def _one_per_window(self) -> Self:
        if (self.dither_mm is None) != (self.dither_s is None):
            raise ValueError(message("error.dither_needs_both"))
        for key in ("approaches", "units"):
            given = getattr(self, key)
            if given and self.windows_s and len(given) != len(self.windows_s):
                raise ValueError(message("error.has_for_windows_one", n_given=len(given), key=key, n_windows_s=len(self.windows_s)))
        return self


class CommandedPath(_Run):
    """Path of the tool origin at a commanded speed, base frame. Its windows are runs."""

    kind: Literal["linear", "circular", "rectangular", "points"]
    """Shape of the path; it decides which other keys are required."""
    start_mm: Vector | None = None
    """Start of a linear path, or a point on a circular path."""
    end_mm: Vector | None = None
    """End of a linear path."""
    centre_mm: Vector | None = None
    """Centre of a circular path."""
    normal: Vector | None = None
    """Axis of a circular path; the motion is right-handed about it."""
    radius_mm: Positive | None = None
    """Radius of a circular path."""
    corners_mm: Annotated[tuple[Vector, ...], Field(min_length=3)] | None = None
    """Corners of a rectangular path, in order."""
    points_mm: Annotated[tuple[Vector, ...], Field(min_length=2)] | None = None
    """Corners of a path of straight segments, in order."""
    speed_mm_s: Positive | None = None
    """Commanded speed."""
    quaternion_xyzw: Quaternion | None = None
    """Orientation base_from_tool on the path, or at its start."""
    end_quaternion_xyzw: Quaternion | None = None
    """Orientation at the end (8.4); default: that of the start. Between them the tool turns at a constant rate."""
    stabilisation_mm: Positive | None = None
    """Deviation from the path below which a corner's error has settled (8.5)."""
    weave_stroke_mm: Positive | None = None
    """Stroke of a weave across a linear path, peak to peak (11)."""
    weave_distance_mm: Positive | None = None
    """Length of one weave along the path (11)."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        for key in NEEDS[self.kind]:
            if getattr(self, key) is None:
                raise ValueError(message("error.kind_needs", kind=self.kind, key=key))
        for key in {k for keys in NEEDS.values() for k in keys} - set(NEEDS[self.kind]):
            if getattr(self, key) is not None:
                raise ValueError(message("error.kind_has_no", kind=self.kind, key=key))
        if self.normal is not None and math.hypot(*self.normal) == 0.0:
            raise ValueError(message("error.normal_has_no_length"))
        if self.end_quaternion_xyzw is not None and self.quaternion_xyzw is None:
            raise ValueError(message("error.end_quaternion_xyzw_needs"))
        if (self.weave_stroke_mm is None) != (self.weave_distance_mm is None) or (self.weave_stroke_mm and self.kind != "linear"):
            raise ValueError(message("error.a_weave_is_a"))
        corners = self.corners()
        steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        if (steps == 0.0).any():
            raise ValueError(message("error.point_is_the_one", row=int(np.argmin(steps)) + 2))
        if self.kind == "circular" and np.linalg.norm(self._from_centre()) < 1e-9:
            raise ValueError(message("error.start_mm_lies_on"))
        return self

    def corners(self) -> FloatArray:
        """(k, 3) corners [mm] of a path made of straight lines, back at the start when it is rectangular; a circle's start alone."""
        if self.kind == "linear":
            return np.array([self.start_mm, self.end_mm], dtype=np.float64)
        if self.kind == "rectangular":
            assert self.corners_mm is not None
            return np.array([*self.corners_mm, self.corners_mm[0]], dtype=np.float64)
        if self.kind == "points":
            return np.array(self.points_mm, dtype=np.float64)
        return np.array([self.start_mm], dtype=np.float64)

    def circle(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return, for a circular path, centre (3,), and radii (3,) to its start and to a quarter turn behind it, right-handed about the
        normal."""
        assert self.radius_mm is not None
        out = self._from_centre()
        out *= self.radius_mm / np.linalg.norm(out)
        return np.array(self.centre_mm, dtype=np.float64), out, np.cross(self._axis(), out)

    def _axis(self) -> FloatArray:
        normal = np.array(self.normal, dtype=np.float64)
        return np.asarray(normal / np.linalg.norm(normal))

    def _from_centre(self) -> FloatArray:
        out = np.array(self.start_mm, dtype=np.float64) - np.array(self.centre_mm, dtype=np.float64)
        return np.asarray(out - (out @ self._axis()) * self._axis())

    def orientation(self, share: FloatArray) -> "Rotation | None":
        """Commanded rotations (n,) base_from_tool where these shares (n,) of the path's length are gone; None where it states none."""
        if self.quaternion_xyzw is None:
            return None
        from scipy.spatial.transform import Rotation, Slerp

        ends = Rotation.from_quat([self.quaternion_xyzw, self.end_quaternion_xyzw or self.quaternion_xyzw])
        return Slerp([0.0, 1.0], ends)(np.clip(share, 0.0, 1.0))

    def points(self, step_mm: float) -> FloatArray:
        """(n, 3) points along the path [mm], at most step_mm apart; a closed kind comes back to its start."""
        if self.kind == "circular":
            assert self.radius_mm is not None
            centre, out, across = self.circle()
            turn = np.linspace(0, 2 * math.pi, max(8, math.ceil(2 * math.pi * self.radius_mm / step_mm)) + 1)
            return np.asarray(centre + np.cos(turn)[:, None] * out + np.sin(turn)[:, None] * across)
        corners = self.corners()
        parts = [corners[:1]]
        for a, b in itertools.pairwise(corners):
            n = max(1, math.ceil(float(np.linalg.norm(b - a)) / step_mm))
            parts.append(a + (np.arange(1, n + 1) / n)[:, None] * (b - a))
        return np.concatenate(parts)


class Distance(Strict):
    """Two poses for distance accuracy and repeatability (7.3)."""

    from_pose: Annotated[Label, Field(alias="from")]
    """Name of the first pose."""
    to_pose: Annotated[Label, Field(alias="to")]
    """Name of the second pose."""

    @property
    def name(self) -> str:
        """Return the name in the form of the certificate."""
        return f"{self.from_pose}-{self.to_pose}"


class Posing(Distance):
    """Moves between two poses for the posing time (9). On arrival, the robot stays within the limit band."""

    windows_s: Windows = ()
    """Times [before departure, at rest], one per cycle."""
    limit_band_mm: Positive | None = None
    """Limit band for the arrival; default: the repeatability of the final pose."""


class Drift(Strict):
    """Pose for the drift of pose characteristics (7.6)."""

    pose: Label
    """Name of the pose."""
    group: Annotated[Whole, Field(ge=2, le=100_000)] = 10
    """Successive cycles that are evaluated together."""


class Compliance(Strict):
    """Dwells at a pose under forces on the tool (10)."""

    pose: Label
    """Name of the pose."""
    force_n: tuple[tuple[float, float, float], ...]
    """Force on the tool, base frame, one per window."""
    windows_s: Windows = ()
    """Times [begin, end] of the dwells, one per force."""

    @model_validator(mode="after")
    def _one_per_window(self) -> Self:
        if self.windows_s and len(self.force_n) != len(self.windows_s):
            numbers = {"n_force_n": len(self.force_n), "n_windows_s": len(self.windows_s)}
            raise ValueError(message("error.compliance_of_force_n", pose=self.pose, **numbers))
        return self


class Tolerance(Strict):
    """Limits of a characteristic, at one pose or path or at all."""

    characteristic: Label
    """Name of the characteristic, such as AP_p."""
    pose: Label | None = None
    """Pose of the characteristic; default: all poses."""
    path: Label | None = None
    """Path of the characteristic; default: all paths."""
    lower: float | None = None
    """Smallest allowed value, in the characteristic's unit."""
    upper: float | None = None
    """Largest allowed value, in the characteristic's unit."""
    rule: Literal["simple", "guarded"] | None = None
    """Decision rule (JCGM 106); default: the rule of the evaluation."""

    @model_validator(mode="after")
    def _limits(self) -> Self:
        if self.lower is None and self.upper is None:
            raise ValueError(message("error.tolerance_of_needs_lower", characteristic=self.characteristic))
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise ValueError(message("error.tolerance_of_lower_is", characteristic=self.characteristic, lower=self.lower, upper=self.upper))
        return self


class Program(Shown, Strict):
    """Test program of a robot: commanded poses and paths, and the characteristics to certify.

    Numbers in parentheses in the fields are clauses of ISO 9283.

    Examples
    --------
    >>> program.pose[0].position_mm
    (100.0, 0.0, 0.0)
    """

    schema_: Annotated[Literal["lmeasure.program/1"], Field(alias="schema")]
    """Kind and version of the file."""
    name: Label | None = None
    """Name of the program."""
    angles: str | None = None
    """Angle convention of component-wise characteristics; default: that of the rig."""
    load_kg: Annotated[float, Field(ge=0)] | None = None
    """Load at the flange."""
    characteristics: tuple[Label, ...] = ()
    """Characteristics of other packages, by the names of their entry points (docs/extending.md)."""
    pose: tuple[CommandedPose, ...] = ()
    """Commanded poses."""
    path: tuple[CommandedPath, ...] = ()
    """Commanded paths."""
    distance: tuple[Distance, ...] = ()
    """Pairs of poses for distance characteristics (7.3)."""
    drift: tuple[Drift, ...] = ()
    """Poses for drift (7.6)."""
    posing: tuple[Posing, ...] = ()
    """Moves for the posing time (9)."""
    compliance: tuple[Compliance, ...] = ()
    """Poses under forces (10)."""
    tolerance: tuple[Tolerance, ...] = ()
    """Limits of characteristics."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.angles is not None and self.angles not in conventions.CONVENTIONS:
            raise of_key("angles", message("error.is_not_one_of_2", name=self.angles, templates=", ".join(conventions.CONVENTIONS)))
        poses, paths = [p.name for p in self.pose], [p.name for p in self.path]
        for kind, names in (("pose", poses), ("path", paths)):
            for name, times in Counter(names).items():
                if times > 1:
                    raise of_key(kind, message("error.the_name_is_given", name=name, times=times))
        requested = [(f"distance {d.name}", n) for d in (*self.distance, *self.posing) for n in (d.from_pose, d.to_pose)]
        requested += [("drift", d.pose) for d in self.drift] + [("compliance", c.pose) for c in self.compliance]
        others = {d.name for d in (*self.distance, *self.posing)}
        requested += [("tolerance", t.pose) for t in self.tolerance if t.pose and t.pose not in others]
        for what, name in requested:
            if name not in poses:
                raise of_key(what, message("error.there_is_no_pose_2", name=name))
        for t in self.tolerance:
            if t.path is not None and t.path not in paths:
                raise of_key("tolerance", message("error.there_is_no_path", path=t.path))
        _apart("pose", self.pose)
        _apart("path", self.path)
        return self

    def with_windows(self, windows: Mapping[tuple[str, str], Sequence[tuple[float, float]]]) -> "Program":
        """The program with windows by kind (`pose`, `settling`, `path`, `posing`, `compliance`) and name; those not named have none."""

        def of(kind: str, name: str) -> tuple[tuple[float, float], ...]:
            return tuple(windows.get((kind, name), ()))

        return self.model_copy(
            update={
                "pose": tuple(
                    p.model_copy(update={"windows_s": of("pose", p.name), "settling_s": of("settling", p.name)}) for p in self.pose
                ),
                "path": tuple(p.model_copy(update={"windows_s": of("path", p.name)}) for p in self.path),
                "posing": tuple(p.model_copy(update={"windows_s": of("posing", p.name)}) for p in self.posing),
                "compliance": tuple(c.model_copy(update={"windows_s": of("compliance", c.pose)}) for c in self.compliance),
            }
        )

    def about(self) -> dict[str, str]:
        """Return the name, and a report."""
        parts = {"poses": self.pose, "paths": self.path, "distances": self.distance, "posings": self.posing, "tolerances": self.tolerance}
        return ({} if self.name is None else {"name": self.name}) | {name: str(len(part)) for name, part in parts.items() if part}

    def to_frame(self) -> DataFrame:
        """A row for each commanded pose."""
        columns = ("pose", "x_mm", "y_mm", "z_mm", *conventions.QUATERNION_COLUMNS, "windows")
        rows = [(p.name, *p.position_mm, *p.quaternion_xyzw, len(p.windows_s)) for p in self.pose]
        return framed([dict(zip(columns, row, strict=True)) for row in rows])

    def to_dict(self) -> dict[str, Any]:
        """Return the content of program.toml without empty keys."""
        return {"schema": self.schema_} | self.model_dump(by_alias=True, exclude_defaults=True, mode="json")


def _apart(kind: str, parts: Sequence[_Run]) -> None:
    """The robot cannot be at two poses at once."""
    windows = sorted((start, end, p.name) for p in parts for start, end in p.windows_s)
    for (_, end, one), (start, _, other) in itertools.pairwise(windows):
        if start < end:
            raise ValueError(message("error.a_window_starts_at", kind=kind, other=other, start=start, one=one, end=end))


def read_program(path: Path) -> Program:
    """Read a program.toml.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Program
        Commanded poses and paths.

    Raises
    ------
    FileFormatError
        If the file is wrong. The message names file and key.

    Examples
    --------
    >>> lm.write_program(Path("program.toml"), program)
    >>> lm.read_program(Path("program.toml")).pose[0].name
    'P1'
    """
    return checked(files.read_toml(path), Program, str(path))


def write_program(path: Path, program: Program) -> None:
    """Write a program.toml, complete or not at all.

    Parameters
    ----------
    path
        File to write.
    program
        Commanded poses and paths.

    Examples
    --------
    >>> lm.write_program(Path("program.toml"), program)
    """
    files.write_toml(path, program.to_dict())
