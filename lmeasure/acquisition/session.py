"""A recording session: rig, bus and devices brought together, as `lmeasure record` does it."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition.decoders import counter_fields
from lmeasure.acquisition.recorder import Progress, Recording, record
from lmeasure.acquisition.sources import open_source
from lmeasure.errors import AcquisitionError
from lmeasure.poses import poses_from_rows
from lmeasure.rig import read_rig

FloatArray = NDArray[np.float64]


def record_session(
    rig_path: Path,
    bus: str,
    folder: Path,
    *,
    seconds: float | None = None,
    start: str | None = None,
    passage: int = 1,
    options: Sequence[str] = (),
    paced: bool = True,
    show: Callable[[Progress], None] | None = None,
) -> Recording:
    """Open what the rig's `[can]` table and the bus's name ask for and record a pass; see `recorder.record`.

    start: seven numbers with commas, x, y, z [mm], qx, qy, qz, qw; options: KEY=VALUE for the interface. AcquisitionError in one line.
    """
    rig = read_rig(rig_path)
    if passage > rig.passes:
        raise AcquisitionError(f"{rig_path}: its cables need {rig.passes} pass(es); there is no pass {passage}")
    pose = None if start is None else pose_from_text(start)
    fields = counter_fields(rig, passage, Path(rig_path).parent)
    source = open_source(bus, rig.can_table.bit_rate, options_from_text(options), paced=paced)
    try:
        return record(rig, source, fields, folder, start=pose, passage=passage, seconds=seconds, show=show)
    finally:
        source.close()


def pose_from_text(text: str) -> FloatArray:
    """(7,) pose from seven numbers with commas; AcquisitionError says what is wrong with them."""
    try:
        numbers = np.array([float(part) for part in text.split(",")])
        return np.asarray(poses_from_rows(numbers.reshape(1, 7)).rows[0])
    except ValueError as error:
        raise AcquisitionError(f"--start {text!r}: x,y,z in mm and qx,qy,qz,qw: {error}") from None


def options_from_text(options: Sequence[str]) -> dict[str, str]:
    """KEY=VALUE texts as a dictionary."""
    for option in options:
        if "=" not in option:
            raise AcquisitionError(f"--bus-option {option!r}: is not KEY=VALUE")
    return dict(option.split("=", 1) for option in options)
