"""The rotopod: six rods of one length between a platform and carriages on a circular guide (source 002, chapters 3.1 and 4.1).

Carriage i stands at the angle q_i on the circle of radius R about the base's Z. A rod of length L from it reaches the platform's hinge A
where |A - R (cos q, sin q, 0)|^2 = L^2: with A at the azimuth phi and the distance l from the axis, and rho^2 = L^2 - z^2,

    q = phi -+ delta,   cos delta = (R^2 + l^2 - rho^2) / (2 R l).

Which elbow a rod has is a matter of how it was built: minus for the odd and plus for the even ones keeps neighbours apart (the text of
the source states the reverse of what its own example has). The hinges are the corners of a triangle cut off: 2 half-widths of a cut.
"""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.robots.parallel.mechanisms import legs
from lmeasure.robots.parallel.mechanisms.jacobians import nearness
from lmeasure.robots.parallel.mechanisms.legs import Legs
from lmeasure.robots.parallel.mechanisms.ring_limits import RingChecks, RingLimits, checked

SIDES = np.array([-1.0, 1.0] * 3)
"""Elbows as they are built: odd rods run back, even ones on."""


@dataclass(frozen=True)
class Rotopod:
    """points (6, 3) hinges of the platform, ring R and rod L [mm]; sides (6,) +-1 the elbows. GeometryError where a length is not so."""

    points: FloatArray
    ring: float
    rod: float
    sides: FloatArray

    def __post_init__(self) -> None:
        for name, value in (("ring", self.ring), ("rod", self.rod)):
            if not value > 0.0:
                raise GeometryError(f"{name} is {value:g} mm; it must be positive")

    @classmethod
    def of_triangle(cls, corner_mm: float, cut_mm: float, ring_mm: float, rod_mm: float) -> "Rotopod":
        """Hinges on an equilateral triangle with corners at this distance, its corners cut off at this length of the sides."""
        s = math.sin(math.pi / 3.0)
        azimuth = 2.0 * math.pi / 3.0 * np.arange(3)
        corners = corner_mm * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)])
        before, after = (np.roll(corners, shift, axis=0) - corners for shift in (1, -1))
        side = 2.0 * s * corner_mm
        points = np.stack([corners + before * cut_mm / side, corners + after * cut_mm / side], axis=1).reshape(6, 3)
        return cls(points, ring_mm, rod_mm, SIDES)

    def legs(self, drives: FloatArray) -> Legs:
        """At carriage angles (..., 6) [rad]."""
        cos, sin, zero = np.cos(drives), np.sin(drives), np.zeros_like(drives)
        by = np.zeros((*drives.shape, 3, 6))
        index = np.arange(6)
        by[..., index, :, index] = np.moveaxis(self.ring * np.stack([-sin, cos, zero], axis=-1), -2, 0)
        ends = self.ring * np.stack([cos, sin, zero], axis=-1)
        return Legs(ends, np.full(drives.shape, self.rod), by, np.zeros((*drives.shape, 6)))

    def both(self, poses: FloatArray) -> FloatArray:
        """(..., 6, 2) both carriage angles [rad] of every rod at poses (..., 7), in (-2 pi, 2 pi); NaN where the rod does not reach."""
        a = legs.uppers(self, poses)
        far = np.hypot(a[..., 0], a[..., 1])
        m = (self.ring**2 + far**2 + a[..., 2] ** 2 - self.rod**2) / (2.0 * self.ring)
        square = far**2 - m**2
        delta = np.arctan2(np.sqrt(np.where(square >= 0.0, square, np.nan)), m)
        return np.asarray(np.arctan2(a[..., 1], a[..., 0])[..., None] + np.stack([-delta, delta], axis=-1))

    def inverse(self, poses: FloatArray) -> FloatArray:
        """(..., 6) carriage angles [rad] in [0, 2 pi) with the elbows of `sides`; NaN where a rod does not reach."""
        own = np.where(self.sides < 0.0, *np.moveaxis(self.both(poses), -1, 0))
        return np.asarray(np.mod(own, 2.0 * np.pi))

    def checks(self, poses: FloatArray, limits: RingLimits) -> RingChecks:
        """Which limits of the workspace poses (..., 7) keep."""
        q = self.inverse(poses)
        feet, upper = self.legs(q).ends, legs.uppers(self, poses)
        rods = (upper - feet) / self.rod
        mass = se3.apply(poses, np.broadcast_to(limits.mass, (*poses.shape[:-1], 3)))
        reached = np.asarray(np.isfinite(q).all(axis=-1))
        rows = np.concatenate([np.cross(upper - poses[..., None, :3], rods), rods], axis=-1)
        near = nearness(np.where(reached[..., None, None], rows, 0.0), self.units)
        return checked(limits, reached, q, feet, rods=rods, normals=se3.matrices(poses)[..., 2], mass=mass, near=near)

    @property
    def units(self) -> FloatArray:
        """(6,) turns and shifts of the platform that move its hinges alike: for `jacobians.nearness`."""
        size = float(np.linalg.norm(self.points, axis=1).max())
        return np.array([1.0 / size] * 3 + [1.0] * 3)
