"""A rig file and the calibration record that it links to: read together, and refused when they are not of one calibration."""

import math
from pathlib import Path

from lmeasure.core import FileFormatError, RigError
from lmeasure.io import inside
from lmeasure.rig.calibration_record import CalibrationRecord, Dimension, RecordedParameter, read_calibration_record
from lmeasure.rig.parameters import GUIDE, UNSIGNED, same_direction, value_of
from lmeasure.rig.rig import Rig, read_rig
from lmeasure.text import message

ROUNDING = 1e-6
"""Of a value, or of 1 where that is more: what is left when a value is written with few digits."""
BESIDE_U = 0.01
"""Of the value's standard uncertainty: rounding that matters to nobody."""


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
        raise FileFormatError(message("error.is_the_calibration_of", where=record_path, rig=record.rig, rig_path=rig_path, name=rig.name))
    values: list[RecordedParameter | Dimension] = [*record.parameters, *record.dimensions]
    for p in values:
        try:
            found = value_of(rig, p.name)
        except RigError as missing:
            raise FileFormatError(message("error.parameter", where=record_path, name=p.name, missing=missing, rig_path=rig_path)) from None
        if found is None:
            continue
        allowed = max(ROUNDING * max(1.0, abs(found)), BESIDE_U * abs(p.u))
        if not _apart(p.name.rpartition(".")[2], p.value, found) <= allowed:
            raise FileFormatError(
                message("error.parameter_but_has_it", where=record_path, name=p.name, value=p.value, rig_path=rig_path, found=found)
            )


def _apart(key: str, a: float, b: float) -> float:
    """How far two values of a parameter are apart."""
    if key in GUIDE:
        return min(abs(math.remainder(value - b, 360.0)) for value in same_direction(key, a))
    return abs(abs(a) - abs(b)) if key in UNSIGNED else abs(a - b)
