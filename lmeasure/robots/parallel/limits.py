"""What bounds a parallel robot's workspace besides its joints: carriages that meet, joints that bend, singular poses, weight that tips."""

from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
from pydantic import Field

from lmeasure import se3
from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.checked import Strict
from lmeasure.robots.fields import Length
from lmeasure.robots.mechanisms.jacobians import nearness
from lmeasure.robots.mechanisms.ring_limits import gaps
from lmeasure.robots.parallel.model import Parallel

Cone = Annotated[float, Field(gt=0.0, le=180.0)]
RING = ("carriage", "radial", "radial-arm")


class Limits(Strict):
    """Angles are of legs to the base's z and to the platform's; gaps between neighbouring carriages of one circle, in the order of legs."""

    least_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Least angle between neighbouring carriages."""
    most_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Largest angle between neighbouring carriages."""
    base_cone_deg: Cone | None = None
    """Largest angle of a leg to the base's z."""
    platform_cone_deg: Cone | None = None
    """Largest angle of a leg to the platform's z."""
    singular: Annotated[float, Field(ge=0.0, lt=1.0)] = 1e-3
    """Least distance from a singular pose: smallest over largest singular value of the rows."""
    mass_mm: tuple[Length, Length, Length] | None = None
    """Centre of mass, in the flange's frame: must stay over the polygon of the legs' lower ends."""


@dataclass(frozen=True)
class Checks:
    """(N,) whether each limit is kept; what is not reached keeps none."""

    reached: BoolArray
    """Every leg reaches, and the idle ones fit."""
    joints: BoolArray
    """Joint values within their limits."""
    gaps: BoolArray
    """Between neighbouring carriages."""
    base_cone: BoolArray
    """Legs to the base's z."""
    platform_cone: BoolArray
    """Legs to the platform's z."""
    regular: BoolArray
    """Away from singular poses."""
    stands: BoolArray
    """The centre of mass over the lower ends."""

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
        reached,
        reached & within,
        _gaps(robot, limits, safe),
        cone(np.broadcast_to([0.0, 0.0, 1.0], normal.shape), limits.base_cone_deg),
        cone(normal, limits.platform_cone_deg),
        reached & (nearness(robot.jacobians(there, safe).output, robot.units) > limits.singular),
        every if limits.mass_mm is None else _stands(feet, se3.apply(there, np.tile(limits.mass_mm, (len(there), 1)))),
    )


def own_roots(robot: Parallel, poses: FloatArray) -> FloatArray:
    """(N, n) joint values at poses (N, 7), of each leg the root that it has at home, turning ones nearest to the middle of their limits."""
    at_home, here = robot.roots(robot.home[None]), robot.roots(poses)
    low, high = robot.limits
    out: list[FloatArray] = []
    for leg, home, every in zip(robot.legs, at_home, here, strict=True):
        begin = sum(part.shape[1] for part in out)
        own = slice(begin, begin + len(leg.of.drives))
        slides = robot.sliding[own]
        away = home[0] - robot.home_joints[own]
        away = away - np.where(slides, 0.0, 2.0 * np.pi * np.round(away / (2.0 * np.pi)))
        root = every[:, int(np.argmin(np.nan_to_num(np.abs(away), nan=np.inf).max(axis=1, initial=0.0)))]
        turns = np.where(slides, 0.0, np.round((root - 0.5 * (low[own] + high[own])) / (2.0 * np.pi)))
        out.append(root - 2.0 * np.pi * turns)
    return np.concatenate(out, axis=1)


def _gaps(robot: Parallel, limits: Limits, drives: FloatArray) -> BoolArray:
    """Carriages one after the other round the guide, in the order of the legs."""
    angles, joint = [], 0
    for leg in robot.legs:
        if leg.kind in RING:
            angles.append(drives[:, joint] + leg.values[2])
        joint += len(leg.of.drives)
    kept = np.ones(len(drives), np.bool_)
    if len(angles) < 2 or (limits.least_gap_deg is None and limits.most_gap_deg is None):
        return kept
    gap = np.degrees(gaps(np.stack(angles, axis=1)))
    least, most = limits.least_gap_deg or 0.0, 180.0 if limits.most_gap_deg is None else limits.most_gap_deg
    return np.asarray(((gap >= least - 1e-9) & (gap <= most + 1e-9)).all(axis=1))


def _stands(feet: FloatArray, mass: FloatArray) -> BoolArray:
    """Whether the mass lies left of every side of the polygon of feet (N, k, 3), in their order."""
    chord, to_mass = np.roll(feet, -1, axis=1) - feet, mass[:, None] - feet
    left = chord[..., 0] * to_mass[..., 1] - chord[..., 1] * to_mass[..., 0]
    return np.asarray((left > 0.0).all(axis=1))
