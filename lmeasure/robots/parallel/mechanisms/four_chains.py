"""The platform on four carriages of a circular guide: two radial chains with a second drive each, two plain rods (source 002, 3.2, 4.2).

Chains 1 and 2 stand in the vertical plane through the guide's axis and their carriage, since their first hinge lies along the guide: the
carriage is commanded to A, q = azimuth of A, and the second drive how far: a slide of the length d between the hinges (variant 2.1 of
the source), or a hinge at the carriage that lifts a lower arm a by the angle theta above the way inwards, from whose end the upper arm b
goes to A (variant 2.2). Chains 3 and 4 are rods of the length L. Six equations for six coordinates, in mm each:

    t . A = 0 (t along the guide at the carriage),  |A - C| = d or b (C the carriage or the lower arm's end),  |A - C| = L.

The source has t . A over sin q cos q, which fails at every quarter. Twelve links and pairs leave 8 freedoms by Somov and Malyshev; two
are turns of the plain rods about themselves, which a finger in one ball joint of each holds: 6.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.robots.parallel.mechanisms.jacobians import Jacobians, nearness
from lmeasure.robots.parallel.mechanisms.legs import Placed
from lmeasure.robots.parallel.mechanisms.ring_limits import RingChecks, RingLimits, checked

RADIAL, PLAIN = slice(0, 2), slice(2, 4)
MOST_TURN = 0.4  # rad in a step
STARTS = 400


@dataclass(frozen=True)
class FourChains:
    """points (4, 3) hinges of the platform, radial chains first, in order round the guide; ring R and rod L [mm]; arms (2,) a and b of
    both radial chains, None where they slide; slide (2,) shortest and longest [mm]; sides (2,) +-1 elbows of the plain rods, raised (2,)
    +-1 of the arms. Drives (..., 6): q1, q2, q3, q4 [rad], then both slides [mm] or angles theta [rad]."""

    points: FloatArray
    ring: float
    rod: float
    arms: FloatArray | None = None
    slide: tuple[float, float] = (0.0, np.inf)
    sides: tuple[float, float] = (1.0, -1.0)
    raised: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        lengths = {"ring": self.ring, "rod": self.rod} | ({} if self.arms is None else {"arms": float(np.min(self.arms))})
        for name, value in lengths.items():
            if not value > 0.0:
                raise GeometryError(f"{name} is {value:g} mm; it must be positive")

    def inverse(self, poses: FloatArray) -> FloatArray:
        """(..., 6) drives at poses (..., 7), angles of carriages in [0, 2 pi); NaN where a chain does not reach."""
        a = self.uppers(poses)
        far, azimuth = np.hypot(a[..., 0], a[..., 1]), np.arctan2(a[..., 1], a[..., 0])
        m = (self.ring**2 + far**2 + a[..., 2] ** 2 - self.rod**2) / (2.0 * self.ring)
        square = (far**2 - m**2)[..., PLAIN]
        delta = np.arctan2(np.sqrt(np.where(square >= 0.0, square, np.nan)), m[..., PLAIN])
        q = np.mod(np.concatenate([azimuth[..., RADIAL], azimuth[..., PLAIN] + np.array(self.sides) * delta], axis=-1), 2.0 * np.pi)
        inwards, above = self.ring - far[..., RADIAL], a[..., RADIAL, 2]
        return np.concatenate([q, self._second(inwards, above)], axis=-1)

    def residuals(self, poses: FloatArray, drives: FloatArray) -> FloatArray:
        """(..., 6) [mm]: off the planes of the radial chains, their reach, then the plain rods."""
        a, ends, tangent = self.uppers(poses), self._ends(drives), self._tangents(drives)
        off = np.einsum("...nc,...nc->...n", tangent[..., RADIAL, :], a[..., RADIAL, :])
        return np.concatenate([off, np.linalg.norm(a - ends, axis=-1) - self._reach(drives)], axis=-1)

    def jacobians(self, poses: FloatArray, drives: FloatArray) -> Jacobians:
        """Of the residuals by displacements (omega [rad]; shift of the platform's origin [mm]) in base axes, and by the drives.

        Rows of the output are wrenches that the chains pass on: forces along the guide through A1, A2, then along the rods.
        """
        a, ends, tangent = self.uppers(poses), self._ends(drives), self._tangents(drives)
        arm = a - poses[..., None, :3]
        e = (a - ends) / np.linalg.norm(a - ends, axis=-1, keepdims=True)
        forces = np.concatenate([tangent[..., RADIAL, :], e], axis=-2)
        arms = np.concatenate([arm[..., RADIAL, :], arm], axis=-2)
        by = np.zeros((*drives.shape[:-1], 6, 6))
        outwards, along = self._outwards(drives), np.einsum("...nc,...nc->...n", e, tangent)
        for i in range(2):
            by[..., i, i] = -np.einsum("...c,...c->...", outwards[..., i, :], a[..., i, :])
            # a lower arm turns with its carriage
            by[..., 2 + i, i] = -along[..., i] * np.einsum("...c,...c->...", ends[..., i, :], outwards[..., i, :])
            by[..., 2 + i, 4 + i] = -1.0 if self.arms is None else -np.einsum("...c,...c->...", e[..., i, :], self._lifted(drives, i))
            by[..., 4 + i, 2 + i] = -self.ring * along[..., 2 + i]
        return Jacobians(np.concatenate([np.cross(arms, forces), forces], axis=-1), by)

    def forward(self, drives: FloatArray, start: FloatArray, iterations: int = 40) -> Placed:
        """Poses at drives (n, 6) by Newton's method from start (7,) or (n, 7); NaN where the loops do not close from there."""
        poses = np.array(np.broadcast_to(start, (len(drives), 7)))
        still = np.arange(len(drives))
        for _ in range(iterations):
            lacks, rows = self.residuals(poses[still], drives[still]), self.jacobians(poses[still], drives[still]).output
            step = -(np.linalg.pinv(rows * self.units) @ lacks[..., None])[..., 0] * self.units
            step /= np.maximum(1.0, np.linalg.norm(step[:, :3], axis=1, keepdims=True) / MOST_TURN)
            poses[still] = se3.displaced(poses[still], step)
            still = still[(np.abs(step) > 1e-13 * np.array([1.0] * 3 + [self.ring] * 3)).any(axis=1)]
            if not len(still):
                break
        found = np.abs(self.residuals(poses, drives)).max(axis=1, initial=0.0) < 1e-10 * self.ring
        poses[~found] = np.nan
        return Placed(poses, found)

    def assemblies(self, drives: FloatArray, seed: int = 0) -> FloatArray:
        """(k, 7) poses that drives (6,) allow, found from many starts; that there are no others is not proved."""
        rng = np.random.default_rng(seed)
        reach = 2.0 * self.ring
        starts = np.concatenate([rng.uniform(-reach, reach, (STARTS, 3)), rng.normal(size=(STARTS, 4))], axis=1)
        starts[:, 3:] /= np.linalg.norm(starts[:, 3:], axis=1, keepdims=True)
        poses = self.forward(np.tile(drives, (STARTS, 1)), starts)
        out: list[FloatArray] = []
        for pose in poses.poses[poses.found]:
            if all(np.abs(se3.displacement(pose, other) / self.units).max() > 1e-6 * self.ring for other in out):
                out.append(pose)
        return np.array(out).reshape(-1, 7)

    def checks(self, poses: FloatArray, limits: RingLimits) -> RingChecks:
        """Which limits of the workspace poses (..., 7) keep; a rod of a radial chain is the line between its hinges."""
        drives = self.inverse(poses)
        q, upper = drives[..., :4], self.uppers(poses)
        feet = self.ring * self._outwards(drives)
        rods = (upper - feet) / np.linalg.norm(upper - feet, axis=-1, keepdims=True)
        mass = se3.apply(poses, np.broadcast_to(limits.mass, (*poses.shape[:-1], 3)))
        reached = np.asarray(np.isfinite(drives).all(axis=-1))
        if self.arms is None:
            slid = drives[..., 4:]
            reached = reached & ((slid >= self.slide[0]) & (slid <= self.slide[1])).all(axis=-1)
        rows = np.where(reached[..., None, None], self.jacobians(poses, drives).output, 0.0)
        return checked(limits, reached, q, feet, rods=rods, normals=se3.matrices(poses)[..., 2], mass=mass, near=nearness(rows, self.units))

    def uppers(self, poses: FloatArray) -> FloatArray:
        """(..., 4, 3) hinges in the base frame [mm] at poses (..., 7)."""
        return np.asarray(poses[..., None, :3] + np.einsum("...ij,nj->...ni", se3.matrices(poses), self.points))

    @property
    def units(self) -> FloatArray:
        """(6,) turns and shifts of the platform that move its hinges alike."""
        size = float(np.linalg.norm(self.points, axis=1).max())
        return np.array([1.0 / size] * 3 + [1.0] * 3)

    def _second(self, inwards: FloatArray, above: FloatArray) -> FloatArray:
        """(..., 2) slides or angles that take a radial chain so far inwards from its carriage and above it."""
        if self.arms is None:
            return np.hypot(inwards, above)
        lower, upper = self.arms
        far = np.hypot(inwards, above)
        m = (far**2 + lower**2 - upper**2) / (2.0 * lower)
        square = far**2 - m**2
        half = np.arctan2(np.sqrt(np.where(square >= 0.0, square, np.nan)), m)
        return np.asarray(np.arctan2(above, inwards) + np.array(self.raised) * half)

    def _outwards(self, drives: FloatArray) -> FloatArray:
        q = drives[..., :4]
        return np.stack([np.cos(q), np.sin(q), np.zeros_like(q)], axis=-1)

    def _tangents(self, drives: FloatArray) -> FloatArray:
        q = drives[..., :4]
        return np.stack([-np.sin(q), np.cos(q), np.zeros_like(q)], axis=-1)

    def _ends(self, drives: FloatArray) -> FloatArray:
        """(..., 4, 3) where the rods, slides and upper arms begin."""
        ends = self.ring * self._outwards(drives)
        if self.arms is not None:
            theta = drives[..., 4:, None]
            up = np.array([0.0, 0.0, 1.0])
            ends[..., RADIAL, :] += self.arms[0] * (np.sin(theta) * up - np.cos(theta) * self._outwards(drives)[..., RADIAL, :])
        return ends

    def _lifted(self, drives: FloatArray, i: int) -> FloatArray:
        """(..., 3) how the end of lower arm i moves with its angle."""
        theta = drives[..., 4 + i, None]
        lower = 0.0 if self.arms is None else self.arms[0]
        return np.asarray(lower * (np.cos(theta) * [0.0, 0.0, 1.0] + np.sin(theta) * self._outwards(drives)[..., i, :]))

    def _reach(self, drives: FloatArray) -> FloatArray:
        radial = drives[..., 4:] if self.arms is None else np.full((*drives.shape[:-1], 2), self.arms[1])
        return np.concatenate([radial, np.full((*drives.shape[:-1], 2), self.rod)], axis=-1)
