"""Limits of a parallel robot's workspace besides its joints: carriages that meet, joints that bend, singular poses, weight that tips."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.linkages import HookeJoints
from lmeasure.robots.model import Limits, nearest_turns
from lmeasure.robots.parallel.model import EQUATIONS, Parallel, Rows, nearness

RING = ("carriage", "radial", "radial-arm")
STEPS = 200
"""Steps in which a range is searched, each way."""


@dataclass(frozen=True)
class Checks:
    """(N,) whether each limit is kept; poses that are not reached keep none."""

    reached: BoolArray
    """Every leg reaches its platform's joint."""
    gaps: BoolArray
    """Between neighbouring carriages of a circular guide."""
    base_cone: BoolArray
    """Legs to the base's z."""
    platform_cone: BoolArray
    """Legs to the platform's z."""
    hooke: BoolArray
    """Turns of legs about themselves, and angles of their Hooke joints."""
    regular: BoolArray
    """Away from singular poses."""
    stands: BoolArray
    """The centre of mass over the polygon of the legs' lower ends."""
    joints: BoolArray
    """Joint values within their limits."""

    @property
    def all(self) -> BoolArray:
        """(N,) all of them."""
        return np.asarray(np.logical_and.reduce([getattr(self, f.name) for f in fields(self)]))


def checked(robot: Parallel, limits: Limits, poses: FloatArray) -> Checks:
    """Return the limits that poses (N, 7) keep, each leg at the root that it has at home."""
    drives = own_roots(robot, poses)
    reached = np.asarray(np.isfinite(drives).all(axis=1))
    safe, there = np.where(reached[:, None], drives, robot.home_joints), np.where(reached[:, None], poses, robot.home)
    rows = robot.rows(there, safe)
    idle = np.array([not robot.legs[i].of.drives for i in robot.owners])
    off = np.abs(robot.residuals(there, safe)[:, idle])
    reached = reached & (off.max(axis=1, initial=0.0) < 1e-6)
    low, high = robot.limits
    within = ((safe >= low - 1e-9) & (safe <= high + 1e-9)).all(axis=1)
    legs = np.array([robot.legs[i].kind not in ("plane", "way") for i in robot.owners])
    first = np.flatnonzero(legs & np.append(True, robot.owners[1:] != robot.owners[:-1]))
    spans = rows.spans[:, first]
    feet = rows.places[:, first] - spans
    far = np.linalg.norm(spans, axis=-1)
    normal = se3.matrices(there)[:, :, 2]
    every = np.ones(len(poses), np.bool_)

    def cone(axis: FloatArray, most: float | None) -> BoolArray:
        if most is None:
            return every
        cos = np.einsum("nic,nc->ni", spans, axis) / far
        return np.asarray((np.degrees(np.arccos(np.clip(cos, -1.0, 1.0))) <= most + 1e-9).all(axis=1))

    return Checks(
        reached=reached,
        joints=reached & within,
        gaps=_gaps(robot, limits, safe),
        base_cone=cone(np.broadcast_to([0.0, 0.0, 1.0], normal.shape), limits.base_cone_deg),
        platform_cone=cone(normal, limits.platform_cone_deg),
        hooke=_hooked(robot, limits, spans / far[..., None], there),
        regular=reached & (nearness(robot.jacobians(there, safe).output, robot.units) > limits.singular),
        stands=every if limits.mass_mm is None else _stands(feet, se3.apply(there, np.tile(limits.mass_mm, (len(there), 1)))),
    )


def ranges(inside: Callable[[FloatArray], BoolArray], home: FloatArray, most: FloatArray) -> FloatArray:
    """Return (6, 2) least and largest displacement (turns about the base's axes [rad], shifts [mm]) from the pose home (7,), one coordinate
    at a time, without leaving the inside on the path; searched to +-most (6,) in `STEPS` steps each way. Zeros where home is outside."""
    out = np.zeros((6, 2))
    for axis in range(6):
        for way, sign in enumerate((-1.0, 1.0)):
            delta = np.zeros((STEPS + 1, 6))
            delta[:, axis] = sign * most[axis] * np.linspace(0.0, 1.0, STEPS + 1)
            kept = inside(se3.displaced(home, delta))
            last = int(np.argmin(kept)) - 1 if not kept.all() else STEPS
            out[axis, way] = delta[max(last, 0), axis]
    return out


def spread(robot: Parallel, unit: FloatArray, *, most_rad: float) -> FloatArray:
    """(k, n) joint values of those of N poses, spread over its workspace by points unit (N, 6) of the unit cube, that keep its limits.

    Of joint values taken at random hardly any are those of a pose where carriages share a guide or cones are narrow; poses are taken
    instead, between how far each coordinate goes from home alone, turns by most_rad at most.
    """
    assert unit.shape[1] == EQUATIONS

    def inside(poses: FloatArray) -> BoolArray:
        return checked(robot, robot.bounds, poses).all

    far = np.array([most_rad] * 3 + [max(float(np.linalg.norm(robot.home[:3])), robot.size_mm)] * 3)
    reach = ranges(inside, robot.home, far)
    poses = se3.displaced(np.tile(robot.home, (len(unit), 1)), reach[:, 0] + np.clip(unit, 0.0, 1.0) * (reach[:, 1] - reach[:, 0]))
    return own_roots(robot, poses[inside(poses)])


def own_roots(robot: Parallel, poses: FloatArray) -> FloatArray:
    """(N, n) joint values at poses (N, 7), of each leg the root that it has at home, turning ones nearest to the middle of their limits."""
    at_home, here = robot.roots(robot.home[None]), robot.roots(poses)
    low, high = robot.limits
    out: list[FloatArray] = []
    for leg, home, every in zip(robot.legs, at_home, here, strict=True):
        begin = sum(part.shape[1] for part in out)
        own = slice(begin, begin + len(leg.of.drives))
        slides = robot.sliding[own]
        away = nearest_turns(home[0], robot.home_joints[own], slides) - robot.home_joints[own]
        root = every[:, int(np.argmin(np.nan_to_num(np.abs(away), nan=np.inf).max(axis=1, initial=0.0)))]
        out.append(nearest_turns(root, 0.5 * (low[own] + high[own]), slides))
    return np.concatenate(out, axis=1)


def _stands(feet: FloatArray, mass: FloatArray) -> BoolArray:
    """(N,) whether masses (N, 3) are over the polygon of feet (N, n, 3)."""
    return np.asarray((_over(feet, mass) > 0.0).all(axis=1))


def _over(feet: FloatArray, mass: FloatArray) -> FloatArray:
    """(N, n) how far masses (N, 3) are left of the sides of a polygon of feet (N, n, 3) [mm], convex and taken in their order round their
    middle."""
    away = feet - feet.mean(axis=1, keepdims=True)
    order = np.argsort(np.arctan2(away[..., 1], away[..., 0]), axis=1)
    feet = np.take_along_axis(feet, order[..., None], axis=1)
    chord, to_mass = np.roll(feet, -1, axis=1) - feet, mass[:, None, :] - feet
    across = chord[..., 0] * to_mass[..., 1] - chord[..., 1] * to_mass[..., 0]
    return np.asarray(across / np.linalg.norm(chord[..., :2], axis=-1))


def hooke_joints(robot: Parallel, limits: Limits) -> HookeJoints | None:
    """Return the Hooke joints of the struts with their limits, numbered among the legs that reach from the base to the platform."""
    spanned = [leg for leg in robot.legs if leg.kind not in ("plane", "way")]
    at = [i for i, leg in enumerate(spanned) if leg.kind == "strut" and leg.carried is not None]
    if not at:
        return None
    axes = np.array([spanned[i].carried for i in at])
    most = (None if v is None else float(np.radians(v)) for v in (limits.leg_turn_deg, limits.hooke_deg))
    return HookeJoints(at, axes[:, 0], axes[:, 1], *most)


def _hooked(robot: Parallel, limits: Limits, directions: FloatArray, poses: FloatArray) -> BoolArray:
    """(N,) whether struts between Hooke joints keep their limits; directions (N, k, 3) of the legs that have one."""
    joints = hooke_joints(robot, limits)
    if joints is None:
        return np.ones(len(poses), np.bool_)
    return np.asarray((joints.values(directions, se3.matrices(poses)) >= -1e-9).all(axis=1))


def _output(rows: Rows, poses: FloatArray) -> FloatArray:
    """(N, 6, 6) rows by displacements of the platform's origin."""
    return np.concatenate([np.cross(rows.places - poses[:, None, :3], rows.directions), rows.directions], axis=-1)


@dataclass(frozen=True)
class PathLimits:
    """Limits of a mechanism with six joints as smooth functions of its pose, positive if kept, for the detours of a path."""

    robot: Parallel
    limits: Limits

    @property
    def base(self) -> FloatArray:
        """(m, 3) lower ends of the legs at home."""
        rows = self.robot.rows(self.robot.home[None], self.robot.home_joints[None])
        return np.asarray((rows.places - rows.spans)[0])

    @property
    def body(self) -> FloatArray:
        """(m, 3) points of the platform."""
        return np.array([leg.point for leg in self.robot.legs])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the limits, in the order of `values`."""
        at_home = self._parts(self.robot.home[None], self.robot.home_joints[None])
        return tuple(name for name, part in at_home for _ in range(part.shape[1]))

    @cached_property
    def _side(self) -> float:
        """The determinant's sign at home."""
        return float(
            np.sign(np.linalg.det(_output(self.robot.rows(self.robot.home[None], self.robot.home_joints[None]), self.robot.home[None]))[0])
        )

    def values(self, poses: FloatArray) -> FloatArray:
        """(..., k) at poses (..., 7); NaN where a leg does not reach."""
        flat = poses.reshape(-1, 7)
        drives = own_roots(self.robot, flat)
        reached = np.isfinite(drives).all(axis=1)
        out = np.full((len(flat), len(self.names)), np.nan)
        if reached.any():
            out[reached] = np.concatenate([part for _, part in self._parts(flat[reached], drives[reached])], axis=1)
        return out.reshape(*poses.shape[:-1], -1)

    def _parts(self, poses: FloatArray, drives: FloatArray) -> list[tuple[str, FloatArray]]:
        """Names with values (N, j) each, at poses (N, 7) and drives (N, n)."""
        robot, limits = self.robot, self.limits
        low, high = robot.limits
        rows = robot.rows(poses, drives)
        first = np.flatnonzero(np.append(True, robot.owners[1:] != robot.owners[:-1]))
        spans = rows.spans[:, first]
        e, turn = spans / np.linalg.norm(spans, axis=-1, keepdims=True), se3.matrices(poses)
        output = _output(rows, poses)
        near = np.sign(np.linalg.det(output)) * self._side * nearness(output, robot.units) - limits.singular
        out = [("joints", (drives - low) / (high - low)), ("joints", (high - drives) / (high - low)), ("regular", near[:, None])]
        for name, axis, most in (
            ("base_cone", np.broadcast_to([0.0, 0.0, 1.0], turn[:, :, 2].shape), limits.base_cone_deg),
            ("platform_cone", turn[:, :, 2], limits.platform_cone_deg),
        ):
            if most is not None:
                out.append((name, np.einsum("nic,nc->ni", e, axis) - np.cos(np.radians(most))))
        gaps = _gap_angles(robot, drives)
        if gaps is not None and limits.least_gap_deg is not None:
            out.append(("gaps", np.radians(gaps - limits.least_gap_deg)))
        if gaps is not None and limits.most_gap_deg is not None:
            out.append(("gaps", np.radians(limits.most_gap_deg - gaps)))
        joints = hooke_joints(robot, limits)
        if joints is not None:
            out.append(("hooke", joints.values(e, turn)))
        if limits.mass_mm is not None:
            mass = se3.apply(poses, np.tile(limits.mass_mm, (len(poses), 1)))
            out.append(("stands", _over(rows.places[:, first] - spans, mass) / robot.size_mm))
        return out


def _gaps(robot: Parallel, limits: Limits, drives: FloatArray) -> BoolArray:
    """(N,) whether carriages keep their gaps."""
    gap = _gap_angles(robot, drives)
    if gap is None or (limits.least_gap_deg is None and limits.most_gap_deg is None):
        return np.ones(len(drives), np.bool_)
    least, most = limits.least_gap_deg or 0.0, 360.0 if limits.most_gap_deg is None else limits.most_gap_deg
    # once around the guide: a carriage that passed a neighbour would go around twice or more
    kept = (gap >= least - 1e-9) & (gap <= most + 1e-9)
    return np.asarray(kept.all(axis=1) & (gap.sum(axis=1) < 540.0))


def _gap_angles(robot: Parallel, drives: FloatArray) -> FloatArray | None:
    """Return (N, k) [deg] from each carriage to the next round the guide, in their order at home, however the legs are listed; None for
    fewer than two."""
    first = np.cumsum([0, *(len(leg.of.drives) for leg in robot.legs)])
    at = [int(j) for j, leg in zip(first, robot.legs, strict=False) if leg.kind in RING]
    if len(at) < 2:
        return None
    zero = np.array([leg.values[2] for leg in robot.legs if leg.kind in RING])
    order = np.argsort(np.mod(robot.home_joints[at] + zero, 2.0 * np.pi))
    angles = (drives[:, at] + zero)[:, order]
    return np.degrees(np.mod(np.roll(angles, -1, axis=1) - angles, 2.0 * np.pi))
