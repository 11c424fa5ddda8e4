"""A hexapod whose legs end in Hooke joints, and by how much each leg turns about itself (thesis 5.8, the trainer LOGOS).

A leg's lower cross has one axis h fixed in the base and the other across it and the leg, e x h; its upper cross likewise with an axis k
fixed in the platform, e x k. Where the platform turns, these two are no longer parallel, and the leg must turn about itself by the angle
from the one to the other: atan2(e . (e x h) x (e x k), (e x h) . (e x k)), signed and over the whole turn, where the source's arccos of
a normalised product has neither. Vectors E5 of the source has the opposite sign in print; with it the arccos would give 163.4 degrees.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.robots.parallel.mechanisms import legs
from lmeasure.robots.parallel.mechanisms.legs import Legs

STUB = 0.1
"""Of a leg's shortest length: from the plate to the centre of its cross, at either end (thesis 5.8)."""


@dataclass(frozen=True)
class HookeHexapod:
    """Centres of the crosses: feet (6, 3) in the base frame, points (6, 3) in the platform's [mm]; unit axes feet_axes (6, 3) fixed in the
    base, point_axes (6, 3) in the platform. Drives (..., 6): lengths between the centres [mm]. GeometryError where an axis is nothing."""

    feet: FloatArray
    points: FloatArray
    feet_axes: FloatArray
    point_axes: FloatArray

    def __post_init__(self) -> None:
        for name, axes in (("feet_axes", self.feet_axes), ("point_axes", self.point_axes)):
            if not np.allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-9):
                raise GeometryError(f"{name}: each row must be of length one")

    @classmethod
    def of_leg(cls, lower_mm: FloatArray, upper_mm: FloatArray) -> "HookeHexapod":
        """Six legs from the ends (3,) of one at rest, on the base and on the platform, whose frames then agree: turned by thirds about Z
        and mirrored in the plane x = 0, which the source's drawing leaves open. The upper axes point across to the vertical through the
        platform's origin, and the lower ones are parallel to them at rest."""
        a, b = lower_mm + STUB * (upper_mm - lower_mm), upper_mm - STUB * (upper_mm - lower_mm)
        axis = -np.array([b[0], b[1], 0.0]) / np.hypot(b[0], b[1])
        mirror = np.array([-1.0, 1.0, 1.0])
        turns = Rotation.from_rotvec(np.outer(2.0 * np.pi / 3.0 * np.arange(3), [0.0, 0.0, 1.0])).as_matrix()
        feet, points, axes = (np.einsum("tij,kj->tki", turns, np.array([x, x * mirror])).reshape(6, 3) for x in (a, b, axis))
        return cls(feet, points, axes, axes)

    def legs(self, drives: FloatArray) -> Legs:
        """At lengths (..., 6) [mm]."""
        shape = drives.shape
        by = np.broadcast_to(np.eye(6), (*shape, 6))
        return Legs(np.broadcast_to(self.feet, (*shape, 3)), drives, np.zeros((*shape, 3, 6)), by)

    def inverse(self, poses: FloatArray) -> FloatArray:
        """(..., 6) lengths between the crosses [mm] at poses (..., 7)."""
        return np.asarray(np.linalg.norm(legs.uppers(self, poses) - self.feet, axis=-1))

    def leg_turns(self, poses: FloatArray) -> FloatArray:
        """(..., 6) [rad] by which the legs turn about themselves, from the base to the platform, at poses (..., 7); in (-pi, pi].

        NaN where a leg lies along the axis of a cross, which then has no second axis.
        """
        away = legs.uppers(self, poses) - self.feet
        e = away / np.linalg.norm(away, axis=-1, keepdims=True)
        upper = np.einsum("...ij,nj->...ni", se3.matrices(poses), self.point_axes)
        low, high = np.cross(e, self.feet_axes), np.cross(e, upper)
        sin, cos = np.einsum("...c,...c->...", e, np.cross(low, high)), np.einsum("...c,...c->...", low, high)
        lost = np.minimum(np.linalg.norm(low, axis=-1), np.linalg.norm(high, axis=-1)) < 1e-12
        return np.where(lost, np.nan, np.arctan2(sin, cos))

    def bends(self, poses: FloatArray) -> FloatArray:
        """(..., 6, 2) [rad] angles between each leg and the planes across the fixed axes of its lower and upper cross: how far the crosses
        are bent about their second axes."""
        away = legs.uppers(self, poses) - self.feet
        e = away / np.linalg.norm(away, axis=-1, keepdims=True)
        upper = np.einsum("...ij,nj->...ni", se3.matrices(poses), self.point_axes)
        sines = [np.einsum("...c,...c->...", e, np.broadcast_to(axes, e.shape)) for axes in (self.feet_axes, upper)]
        return np.asarray(np.arcsin(np.clip(np.stack(sines, axis=-1), -1.0, 1.0)))
