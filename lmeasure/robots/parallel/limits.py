"""What bounds a parallel robot's workspace besides its joints: carriages that meet, joints that bend, singular poses, weight that tips."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.robots.file_fields import Limits
from lmeasure.robots.model import nearest_turns
from lmeasure.robots.parallel.jacobians import nearness
from lmeasure.robots.parallel.model import EQUATIONS, Parallel

RING = ("carriage", "radial", "radial-arm")
STEPS = 200
"""In which a range is searched, each way."""


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
    """Which limits poses (N, 7) keep, each leg at the root that it has at home."""
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
    """(6, 2) least and largest displacement (turns about the base's axes [rad], shifts [mm]) from the pose home (7,), one coordinate at
    a time, without leaving what is inside on the way; searched to +-most (6,) in `STEPS` steps each way. Zeros where home is outside."""
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
    """(N,) whether masses (N, 3) are over the polygon of feet (N, n, 3), convex and taken in their order round their middle: left of all
    its sides."""
    away = feet - feet.mean(axis=1, keepdims=True)
    order = np.argsort(np.arctan2(away[..., 1], away[..., 0]), axis=1)
    feet = np.take_along_axis(feet, order[..., None], axis=1)
    chord, to_mass = np.roll(feet, -1, axis=1) - feet, mass[:, None, :] - feet
    return np.asarray((chord[..., 0] * to_mass[..., 1] - chord[..., 1] * to_mass[..., 0] > 0.0).all(axis=1))


def hooke_turns(e: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """(...,) rad by which a leg of unit direction e (..., 3) turns about itself, signed, against where both crosses, of first axes low and
    high (..., 3), are parallel: atan2(e . (e x h) x (e x k), (e x h) . (e x k)) (thesis 5.8)."""
    one, other = np.cross(e, low), np.cross(e, high)
    return np.asarray(np.arctan2((e * np.cross(one, other)).sum(axis=-1), (one * other).sum(axis=-1)))


def _hooked(robot: Parallel, limits: Limits, directions: FloatArray, poses: FloatArray) -> BoolArray:
    """(N,) whether struts between Hooke joints keep their limits; directions (N, k, 3) of the legs that have one."""
    kept = np.ones(len(poses), np.bool_)
    if limits.leg_turn_deg is None and limits.hooke_deg is None:
        return kept
    turn = se3.matrices(poses)
    spanned = [leg for leg in robot.legs if leg.kind not in ("plane", "way")]
    for e, leg in zip(np.moveaxis(directions, 1, 0), spanned, strict=True):
        if leg.kind != "strut" or leg.carried is None:
            continue
        low, high = leg.carried[0], turn @ leg.carried[1]
        if limits.leg_turn_deg is not None:
            kept &= np.degrees(np.abs(hooke_turns(e, low, high))) <= limits.leg_turn_deg + 1e-9
        if limits.hooke_deg is not None:
            sines = np.abs(np.stack([e @ low, (e * high).sum(axis=1)]))
            kept &= np.degrees(np.arcsin(np.minimum(sines, 1.0))).max(axis=0) <= limits.hooke_deg + 1e-9
    return kept


def _gaps(robot: Parallel, limits: Limits, drives: FloatArray) -> BoolArray:
    """Carriages one after the other round the guide, in the order in which they stand at home, however the legs are listed."""
    first = np.cumsum([0, *(len(leg.of.drives) for leg in robot.legs)])
    at = [int(j) for j, leg in zip(first, robot.legs, strict=False) if leg.kind in RING]
    if len(at) < 2 or (limits.least_gap_deg is None and limits.most_gap_deg is None):
        return np.ones(len(drives), np.bool_)
    zero = np.array([leg.values[2] for leg in robot.legs if leg.kind in RING])
    order = np.argsort(np.mod(robot.home_joints[at] + zero, 2.0 * np.pi))
    angles = (drives[:, at] + zero)[:, order]
    gap = np.degrees(np.mod(np.roll(angles, -1, axis=1) - angles, 2.0 * np.pi))
    least, most = limits.least_gap_deg or 0.0, 360.0 if limits.most_gap_deg is None else limits.most_gap_deg
    # once round the guide: who has passed a neighbour goes round twice and more
    kept = (gap >= least - 1e-9) & (gap <= most + 1e-9)
    return np.asarray(kept.all(axis=1) & (gap.sum(axis=1) < 540.0))
