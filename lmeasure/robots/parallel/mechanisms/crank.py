"""A platform with three freedoms on three cranks and three plain rods (source 003).

Hinges lie in pairs on two circles, pairs 120 degrees apart. Rods 1, 3, 5 go from cranks to the platform, rods 2, 4, 6 from the base. A
crank at the azimuth gamma turns in the plane that touches the base circle there: C = Rz(gamma) (R, L sin f, L cos f), f = 0 upright. (Of
the three, equations 6 to 8 of the source, the third is missing in print; it is that of C2 with 240 degrees.) The platform has six
coordinates and the plain rods take three: a height and the direction of its normal can be commanded, the rest follows.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, GeometryError, IntArray, se3
from lmeasure.robots.parallel.mechanisms import legs
from lmeasure.robots.parallel.mechanisms.legs import Legs

DRIVEN, PLAIN = np.array([0, 2, 4]), np.array([1, 3, 5])
THIRD = 2.0 * math.pi / 3.0
MOST_TURN = 0.3  # rad in a step
CLOSES_MM = 1e-6
"""How far a plain rod may be from its length at a pose that is said to be one of the mechanism's."""


@dataclass(frozen=True)
class CrankPlatform:
    """crank: length of the cranks [mm]; feet (6, 3) lower hinges, of driven legs the cranks' axes; points (6, 3) upper
    hinges in the platform's frame, whose x axis halves the first pair; rods (6,) [mm]; home (7,) base_from_platform with all cranks
    upright. GeometryError where a length is not positive."""

    feet: FloatArray
    points: FloatArray
    rods: FloatArray
    crank: float
    home: FloatArray

    @classmethod
    def regular(
        cls, base_mm: float, platform_mm: float, base_pair: float, platform_pair: float, *, crank_mm: float, height_mm: float
    ) -> Self:
        """Circles of these radii, angles [rad] between the hinges of a pair, pairs of both circles at the same azimuths (the first hinge of
        the base at azimuth 0), and rods as long as a level platform at this height over upright cranks makes them."""
        for name, value in (("base_mm", base_mm), ("platform_mm", platform_mm), ("crank_mm", crank_mm), ("height_mm", height_mm)):
            if not value > 0.0:
                raise GeometryError(f"{name} is {value:g}; it must be positive")
        feet = _ring(base_mm, 0.5 * base_pair + _pairs(base_pair))
        points = _ring(platform_mm, _pairs(platform_pair))
        home = se3.pose([0.0, 0.0, height_mm], Rotation.from_rotvec([0.0, 0.0, 0.5 * base_pair]))
        made = cls(feet, points, np.ones(6), crank_mm, home)
        rods = np.linalg.norm(legs.uppers(made, home) - made.legs(np.zeros(3)).ends, axis=1)
        return cls(feet, points, rods, crank_mm, home)

    def legs(self, drives: FloatArray) -> Legs:
        """At crank angles (..., 3) [rad]."""
        shape = np.shape(drives)[:-1]
        tangent, up = self._planes()
        sin, cos = np.sin(drives)[..., None], np.cos(drives)[..., None]
        ends = np.array(np.broadcast_to(self.feet, (*shape, 6, 3)))
        ends[..., DRIVEN, :] += self.crank * (sin * tangent + cos * up)
        by = np.zeros((*shape, 6, 3, 3))
        by[..., DRIVEN, :, np.arange(3)] = np.moveaxis(self.crank * (cos * tangent - sin * up), -2, 0)
        return Legs(ends, np.broadcast_to(self.rods, (*shape, 6)), by, np.zeros((*shape, 6, 3)))

    def inverse(self, poses: FloatArray) -> FloatArray:
        """(..., 3, 2) both crank angles [rad] at poses (..., 7): the second is the first turned further; NaN where the rod does not reach.

        With d from the crank's axis to the upper hinge, d.t sin f + d.k cos f = (|d|^2 + L^2 - l^2) / (2 L) = m, so f lies at
        atan2(sqrt(h^2 - m^2), m) on either side of the direction of d, h its length in the crank's plane. Plain rods are not looked at:
        `misfit` says whether the pose is one of the mechanism's.
        """
        tangent, up = self._planes()
        d = legs.uppers(self, poses)[..., DRIVEN, :] - self.feet[DRIVEN]
        along, above = np.einsum("...ic,ic->...i", d, tangent), np.einsum("...ic,ic->...i", d, up)
        m = (np.einsum("...ic,...ic->...i", d, d) + self.crank**2 - self.rods[DRIVEN] ** 2) / (2.0 * self.crank)
        square = along**2 + above**2 - m**2
        middle, half = np.arctan2(along, above), np.arctan2(np.sqrt(np.where(square >= 0.0, square, np.nan)), m)
        both = np.stack([middle - half, middle + half], axis=-1)
        return np.asarray(both - 2.0 * np.pi * np.round(both.mean(axis=-1, keepdims=True) / (2.0 * np.pi)))

    def misfit(self, poses: FloatArray) -> FloatArray:
        """(...) [mm] by how much the worst plain rod is off its length at poses (..., 7)."""
        away = legs.uppers(self, poses)[..., PLAIN, :] - self.feet[PLAIN]
        return np.asarray(np.abs(np.linalg.norm(away, axis=-1) - self.rods[PLAIN]).max(axis=-1))

    def sides(self, poses: FloatArray, drives: FloatArray) -> IntArray:
        """(..., 3) which of the two roots of `inverse` each crank stands at, 0 or 1, or -1 at a dead point, where both are one.

        The side is the sign of what a crank does to its rod; along a motion it changes only where a crank passes a dead point, and an
        inverse that kept its root would there leave the mechanism's way.
        """
        own = legs.jacobians(self, poses, drives).drives[..., DRIVEN, np.arange(3)]
        return np.where(np.abs(own) <= 1e-9 * self.crank, -1, np.where(own > 0.0, 1, 0))

    def nearest(self, poses: FloatArray) -> tuple[FloatArray, BoolArray]:
        """The mechanism's poses (n, 7) of the heights and normals of these (n, 7), and whether each exists (n,).

        Newton's method over x, y and the turn about the normal, which the three plain rods determine, from home.
        """
        at = _same_normal(np.broadcast_to(self.home, poses.shape), poses)
        at[..., 2] = poses[..., 2]
        normal = se3.matrices(at)[..., 2]
        for _ in range(30):
            upper = legs.uppers(self, at)[..., PLAIN, :]
            span = upper - self.feet[PLAIN]
            length = np.linalg.norm(span, axis=-1)
            e = span / length[..., None]
            moments = np.cross(upper - at[..., None, :3], e)
            rows = np.concatenate([e[..., :2], np.einsum("...ic,...c->...i", moments, normal)[..., None]], axis=-1)
            step = (np.linalg.pinv(rows) @ (self.rods[PLAIN] - length)[..., None])[..., 0]
            step /= np.maximum(1.0, np.abs(step[..., 2:]) / MOST_TURN)
            shift = np.concatenate([step[..., :2], np.zeros_like(step[..., :1])], axis=-1)
            at = se3.displaced(at, np.concatenate([step[..., 2:] * normal, shift], axis=-1))
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        return at, self.misfit(at) < CLOSES_MM

    def _planes(self) -> tuple[FloatArray, FloatArray]:
        """(3, 3) tangents of the base circle at the cranks' axes, and the vertical."""
        across = self.feet[DRIVEN]
        tangent = np.cross([0.0, 0.0, 1.0], across)
        return tangent / np.linalg.norm(tangent, axis=1)[:, None], np.tile([0.0, 0.0, 1.0], (3, 1))


def _same_normal(poses: FloatArray, wanted: FloatArray) -> FloatArray:
    """Poses (n, 7) turned by the least turn that brings their z axes to those of wanted (n, 7)."""
    z, to = se3.matrices(poses)[..., 2], se3.matrices(wanted)[..., 2]
    axis = np.cross(z, to)
    sin, cos = np.linalg.norm(axis, axis=-1), np.einsum("...i,...i->...", z, to)
    scale = np.where(sin > 0.0, np.arctan2(sin, cos) / np.where(sin > 0.0, sin, 1.0), 0.0)
    turn = Rotation.from_rotvec(axis * scale[..., None])
    return se3.pose(poses[..., :3], turn * se3.rotation(poses))


def _pairs(angle: float) -> FloatArray:
    """(6,) azimuths of three pairs, the first about zero."""
    return np.asarray([THIRD * pair + side * 0.5 * angle for pair in range(3) for side in (-1.0, 1.0)])


def _ring(radius: float, azimuths: FloatArray) -> FloatArray:
    return np.column_stack([radius * np.cos(azimuths), radius * np.sin(azimuths), np.zeros(len(azimuths))])
