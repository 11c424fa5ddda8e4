"""What keeps a platform on a circular guide in its workspace: carriages, rods and joints that do not meet, and weight that does not tip it.

Source 002, chapters 3.1 and 3.2, corrected: the least gap of carriages is 12 degrees (printed 120 in 3.1, the largest), and it is an
atan2 of cross and dot product, since an arcsine cannot tell 80 degrees from 100; a rod's angle is to the normal (the printed formula is
the elevation, with which no pose is left); the platform's normal is M (0, 0, 1, 0), a direction, printed with 1; moments of Pluecker rows
take the unit vector; what must not be zero is the distance from a singular pose, printed |det E| >= 0.
"""

from dataclasses import dataclass, fields

import numpy as np

from lmeasure.core import BoolArray, FloatArray


@dataclass(frozen=True)
class RingLimits:
    """Angles in rad; singular: least singular value over the largest (`jacobians.nearness`); mass (3,): on the platform [mm]."""

    least_gap: float = float(np.radians(12.0))
    most_gap: float = float(np.radians(120.0))
    base_cone: float = float(np.radians(11.0))
    platform_cone: float = float(np.radians(22.0))
    singular: float = 1e-3
    mass: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RingChecks:
    """(...) whether each limit is kept; NaN poses keep none."""

    reached: BoolArray
    """Every rod reaches its carriage, within its shortest and longest where it has such."""
    gaps: BoolArray
    """Between neighbouring carriages, in their order: rods do not cross."""
    base_cone: BoolArray
    """Rods to the guide's normal."""
    platform_cone: BoolArray
    """Rods to the platform's normal."""
    regular: BoolArray
    """Away from singular poses."""
    stands: BoolArray
    """The centre of mass over the polygon of the carriages."""

    @property
    def all(self) -> BoolArray:
        """(...) all of them."""
        return np.asarray(np.logical_and.reduce([getattr(self, f.name) for f in fields(self)]))


def gaps(angles: FloatArray) -> FloatArray:
    """(..., n) [rad] from each carriage to the next, the last one's to the first, for angles (..., n) in their order round the guide; in
    (-pi, pi], negative where they have passed each other."""
    turn = np.roll(angles, -1, axis=-1) - angles
    return np.asarray(np.arctan2(np.sin(turn), np.cos(turn)))


def checked(
    limits: RingLimits,
    reached: BoolArray,
    angles: FloatArray,
    feet: FloatArray,
    *,
    rods: FloatArray,
    normals: FloatArray,
    mass: FloatArray,
    near: FloatArray,
) -> RingChecks:
    """Of carriage angles (..., n) in their order, their points feet (..., n, 3), directions of rods (..., n, 3) upwards, the platform's
    normals (..., 3), centres of mass (..., 3) in the base frame, and how near to singular the poses are (...)."""
    with np.errstate(invalid="ignore"):
        gap = gaps(angles)
        slack = 1e-12
        to_base = np.arctan2(np.hypot(rods[..., 0], rods[..., 1]), rods[..., 2])
        along = np.einsum("...nc,...c->...n", rods, normals)
        to_platform = np.arctan2(np.linalg.norm(np.cross(rods, normals[..., None, :]), axis=-1), along)
        return RingChecks(
            reached,
            _each((gap >= limits.least_gap - slack) & (gap <= limits.most_gap + slack)),
            _each(to_base <= limits.base_cone + slack),
            _each(to_platform <= limits.platform_cone + slack),
            near > limits.singular,
            stands(feet, mass),
        )


def stands(feet: FloatArray, mass: FloatArray) -> BoolArray:
    """(...) whether masses (..., 3) lie over the polygon of feet (..., n, 3), convex and taken in the order in which they stand round their
    middle: left of all its sides."""
    away = feet - feet.mean(axis=-2, keepdims=True)
    order = np.argsort(np.arctan2(away[..., 1], away[..., 0]), axis=-1)
    feet = np.take_along_axis(feet, order[..., None], axis=-2)
    chord, to_mass = np.roll(feet, -1, axis=-2) - feet, mass[..., None, :] - feet
    return _each(chord[..., 0] * to_mass[..., 1] - chord[..., 1] * to_mass[..., 0] > 0.0)


def _each(kept: BoolArray) -> BoolArray:
    return np.asarray(kept.all(axis=-1))
