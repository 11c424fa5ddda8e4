"""What a person is told of poses, readings and what they are worth, in lines of a terminal."""

import numpy as np

from lmeasure.core import BoolArray, FloatArray, conventions
from lmeasure.procedures.capture.folder import Reading
from lmeasure.procedures.capture.forecast import Expected, Worth
from lmeasure.recording import Poses

SURPRISED = 5.0
SURPRISED_MM = 2.0
"""Standard uncertainties, and mm at least, by which counts are off what is expected before a pose is doubted."""
IN_A_LINE = 3


def pose_line(poses: Poses, name: str, angles: str) -> str:
    """A pose as it is typed into a controller."""
    i = poses.names.index(name)
    values = [f"{c[0]} {v:.1f}" for c, v in zip(("x", "y", "z"), poses.rows[i, :3] + 0.0, strict=True)]
    if poses.oriented:
        typed = conventions.rounded_angles(angles, conventions.angles_from_rotation(angles, poses.rotation[i]))
        columns = conventions.convention(angles).columns
        values += [f"{c.rsplit('_', 1)[0]} {v:g}" for c, v in zip(columns, typed, strict=True)]
    return f"pose {name} ({i + 1} of {len(poses)}): {'  '.join(values)}"


def reading_lines(reading: Reading, channels: tuple[str, ...], u: FloatArray) -> list[str]:
    """What was counted: means with their standard uncertainties u (m,) [counts]."""
    lasts = reading.time_s[-1] - reading.time_s[0]
    lines = [f"  read: {len(reading.counts)} counts of each channel over {lasts:.2f} s, within {reading.spread.max():.0f} of each other"]
    told = [f"{c} {mean:.2f} (u {err:.2f})" for c, mean, err in zip(channels, reading.mean, u, strict=True)]
    return lines + [f"    {'  '.join(told[i : i + IN_A_LINE])}" for i in range(0, len(told), IN_A_LINE)]


def worth_line(worth: Worth, readings: int) -> str:
    """How well lengths and positions would be known if nothing more were read."""
    if not worth.enough(readings):
        return f"  {readings} of at least {worth.least} poses: too few yet to determine anything by counts alone"
    held = "" if worth.rank == worth.unknowns else f"; {worth.unknowns - worth.rank} of {worth.unknowns} directions are the rig's own yet"
    position = "" if worth.position_mm is None else f", position {worth.position_mm:.2g}"
    return f"  U95 by now: lengths {worth.rms_mm:.2g} mm rms, {worth.worst_mm:.2g} at worst ({worth.worst_cable}){position}{held}"


def surprising(expected: Expected) -> BoolArray:
    """(m,) whether lengths are off what is expected."""
    return np.abs(expected.off_mm) > np.maximum(SURPRISED * expected.u_mm, SURPRISED_MM)


def surprise(expected: Expected) -> str:
    """The lengths that are farthest off."""
    order = [j for j in np.argsort(-np.abs(expected.off_mm) / expected.u_mm) if surprising(expected)[j]][:IN_A_LINE]
    told = ", ".join(f"{expected.cables[j].name} by {expected.off_mm[j]:+.1f} mm (u {expected.u_mm[j]:.2g})" for j in order)
    return f"off what is expected: {told}"


def expected_line(expected: Expected) -> str:
    """How the counts agree with what was expected of them."""
    if surprising(expected).any():
        return f"  ! {surprise(expected)}\n    another pose, a wrong sign or channel, or lost counts? `undo` takes the reading back"
    j = int(np.argmax(np.abs(expected.off_mm)))
    return f"  as expected within {abs(expected.off_mm[j]):.2g} mm (u {expected.u_mm[j]:.2g}, cable {expected.cables[j].name})"
