"""Component-wise angles: how a convention's angles change with the rotation, and where they tell nothing."""

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, conventions
from lmeasure.iso9283.formulas import pose as iso
from lmeasure.text import Message, message

PLAIN = "fanuc-wpr"
"""Turns about the fixed X, Y and Z: the standard's a, b, c, where a controller's own angles are singular."""
SINGULAR_DEG_PER_DEG = 10.0
"""A turn of a degree that moves an angle by more than as many degrees: the angles are near a singular orientation and tell nothing."""


def angles_deg(name: str, rotation: Rotation) -> FloatArray:
    """Angles of a convention, always in degrees."""
    values = conventions.angles_from_rotation(name, rotation)
    return np.degrees(values) if conventions.convention(name).columns[0].endswith("_rad") else values


def angle_rates(name: str, rotation: Rotation) -> FloatArray:
    """(n, 3, 3) derivatives of a convention's angles [deg] by a small rotation [rad] in base axes, at n rotations."""
    step = 1e-6
    columns = []
    for axis in np.eye(3):
        there, back = (angles_deg(name, Rotation.from_rotvec(sign * step * axis) * rotation) for sign in (1.0, -1.0))
        columns.append(iso.wrapped(there - back) / (2.0 * step))
    return np.stack(columns, axis=-1)


def singular(name: str, rotation: Rotation) -> bool:
    """Whether the angles tell nothing at one of the rotations."""
    rates = np.radians(angle_rates(name, rotation))
    return bool(np.linalg.norm(rates, axis=(-2, -1)).max() > SINGULAR_DEG_PER_DEG)


def convention_at(angles: str, rotation: Rotation, part: object, *, stated: bool) -> tuple[str | None, tuple[Message, ...]]:
    """The convention in which angles at these rotations tell something, None where there is none, and what is to be said of it. stated:
    angles were asked for, and are not replaced by others."""
    if not singular(angles, rotation):
        return angles, ()
    if stated or singular(PLAIN, rotation):
        return None, (message("angles.none", part=part, angles=angles),)
    return PLAIN, (message("angles.other", part=part, angles=angles, instead=PLAIN),)
