"""Where a run starts: the [start] table of run.toml, a pose or the lengths of the cables there."""

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from lmeasure.core import FileFormatError, FloatArray, conventions
from lmeasure.io import Strict, files
from lmeasure.kernels import ATTACHMENT_XYZ
from lmeasure.recording.poses import poses_from_rows
from lmeasure.rig import TYPICAL_SIZES, Rig, Unstated
from lmeasure.text import joined, message

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
    """What a --start option states: numbers with commas or blanks, x, y, z [mm] and three angles in the rig's convention, or qx, qy, qz,
    qw, or a file with a table start.

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
    """(7,) the pose that a --start option states for a rig; FileFormatError says what is wrong with it."""
    stated = stated_start(text)
    return start_of_rig(stated.table, rig, stated.source)


def start_from(path: Path) -> StatedStart:
    """The table start of a file; FileFormatError when there is none."""
    start = files.read_toml(path).get("start")
    if start is None:
        raise FileFormatError(message("error.start_is_missing_the", where=path))
    return StatedStart(start, str(path))


def start_of_rig(start: Any, rig: Rig, path: Path | str) -> FloatArray:
    """(7,) the pose of a [start] table: as stated, or that whose cables have its lengths_mm.

    Lengths fit several assemblies. The rig's `side` and the table's own position and orientation, which then only say about where the tool
    is, choose among them. Where the search may have missed some, only a stated place chooses. FileFormatError names the path, and lists the
    assemblies among which nothing chooses.
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
            raise FileFormatError(
                message("error.start_lengths_mm_fit_none", where=path, listed=_listed(found, all_of_them), side=list(rig.side))
            )
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
    """The place and the orientation (quaternion) that a table with lengths states, or None for what it leaves open."""
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
        """Return them with typical sizes for what is not stated, or 0. A pose that comes from lengths errs with these alone."""
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
