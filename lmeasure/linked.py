"""A rig file and the calibration record that it links to: read together, and refused when they are not of one calibration."""

import math
from pathlib import Path

from lmeasure.calibration_record import CalibrationRecord, Dimension, Parameter, read_calibration_record
from lmeasure.errors import FileFormatError
from lmeasure.opened import inside
from lmeasure.rig import ObservationPoint, Rig, read_rig

ROUNDING = 1e-6
"""Of a value, or of 1 where that is more: what is left when a value is written with few digits."""
BESIDE_U = 0.01
"""Of the value's standard uncertainty: rounding that matters to nobody."""

_PLACE = ("x_mm", "y_mm", "z_mm")
_GUIDE = ("guide_alpha_deg", "guide_beta_deg")


def read_linked_rig(path: Path) -> tuple[Rig, CalibrationRecord | None]:
    """A rig and the calibration record that its `calibration` key names, which must be there, in the rig's folder, and hold the
    values of this rig.

    FileFormatError names the parameter and both values where they differ.
    """
    rig = read_rig(path)
    if rig.calibration is None:
        return rig, None
    beside = inside(Path(path).parent, rig.calibration, f"{path}: calibration", "the rig's folder")
    record = read_calibration_record(beside)
    check_linked(rig, record, path, beside)
    return rig, record


def check_linked(rig: Rig, record: CalibrationRecord, rig_path: Path | str, record_path: Path | str) -> None:
    """FileFormatError when the record is of a rig of another name, or a parameter of its has another value there than the rig has.

    A radius has no sign, and guide angles that name one direction are the same. Parameters of kinds that a rig does not hold are passed
    over.
    """
    if record.rig != rig.name:
        raise FileFormatError(f"{record_path}: is the calibration of rig {record.rig!r}; {rig_path} is rig {rig.name!r}")
    values: list[Parameter | Dimension] = [*record.parameters, *record.dimensions]
    for p in values:
        owner, _, key = p.name.rpartition(".")
        found = _value(rig, owner, key)
        if isinstance(found, str):
            raise FileFormatError(f"{record_path}: parameter {p.name}: {found} {rig_path}")
        if found is None:
            continue
        allowed = max(ROUNDING * max(1.0, abs(found)), BESIDE_U * abs(p.u))
        if not _apart(key, p.value, found) <= allowed:
            raise FileFormatError(
                f"{record_path}: parameter {p.name} = {p.value:.9g}, but {rig_path} has {found:.9g}: it is not the calibration of this rig"
            )


def _value(rig: Rig, owner: str, key: str) -> float | str | None:
    """What the rig has in a parameter's place; what is missing there, in words; None for a kind of parameter that it does not hold."""
    if owner.startswith("tool."):
        name = owner.removeprefix("tool.")
        if key not in _PLACE:
            return None
        return rig.tool[name][_PLACE.index(key)] if name in rig.tool else f"there is no point {name} in [tool] of"
    point = next((p for p in rig.observation_point if p.name == owner), None)
    if key in _PLACE:
        return f"there is no observation point {owner} in" if point is None else point.position_mm[_PLACE.index(key)]
    for holder in () if point is None else (point, point.drum):
        if key in type(holder).model_fields:
            value = getattr(holder, key)
            return float(value) if isinstance(value, int | float) else None
    known = {*ObservationPoint.model_fields, "scale", "tangent_length_mm", "axial_offset_mm", "groove_pitch_mm"}
    return f"there is no observation point {owner} in" if point is None and key in known else None


def _apart(key: str, a: float, b: float) -> float:
    """How far two values of a parameter are apart."""
    if key == "pulley_radius_mm":
        return abs(abs(a) - abs(b))
    if key in _GUIDE:
        # one direction has the angles (alpha, beta) and (180 - alpha, beta + 180)
        other = 180.0 - a if key == _GUIDE[0] else a + 180.0
        return min(abs(math.remainder(value - b, 360.0)) for value in (a, other))
    return abs(a - b)
