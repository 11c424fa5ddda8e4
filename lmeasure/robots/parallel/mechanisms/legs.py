"""Platforms on six legs whose drives move the legs' lower ends, or change their lengths: hexapods, cranks, carriages on a circle.

Leg i runs straight from its lower end c_i(q) in the base to a_i = p + R b_i on the platform and has the length l_i(q). Its equation is

    F_i = |a_i - c_i| - l_i = 0,   dF_i = e_i . (v + w x R b_i) - e_i . c_i' - l_i',

with the leg's direction e_i from c_i to a_i and the platform's displacement (w; v), w about the tool's origin: rows (R b_i x e_i ; e_i),
Pluecker coordinates of the leg. Multiplied by 2 l_i these are rows of the equations |a - c|^2 - l^2 = 0 of source 002.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from lmeasure.core import BoolArray, FloatArray, Status, se3
from lmeasure.kernels import placed
from lmeasure.linkages import Assemblies, assemblies as straight_assemblies
from lmeasure.robots.parallel.mechanisms.jacobians import Jacobians


class Legs(NamedTuple):
    """Lower ends (..., 6, 3) [mm, base frame] and lengths (..., 6) [mm] and their derivatives by n drives: (..., 6, 3, n), (..., 6, n)."""

    ends: FloatArray
    lengths: FloatArray
    ends_by: FloatArray
    lengths_by: FloatArray


class LegPlatform(Protocol):
    """A mechanism of this kind."""

    @property
    def points(self) -> FloatArray:
        """(6, 3) upper hinges in the platform's frame [mm]."""
        ...

    def legs(self, drives: FloatArray) -> Legs:
        """At drives (..., n)."""
        ...


@dataclass(frozen=True)
class Placed:
    """poses (n, 7) base_from_platform, NaN where found (n,) is False: Newton's method has not closed the loops from its start."""

    poses: FloatArray
    found: BoolArray


def residuals(mechanism: LegPlatform, poses: FloatArray, drives: FloatArray) -> FloatArray:
    """(..., 6) [mm] by how much the legs are too short for poses (..., 7) at drives (..., n)."""
    legs = mechanism.legs(drives)
    return np.asarray(np.linalg.norm(uppers(mechanism, poses) - legs.ends, axis=-1) - legs.lengths)


def jacobians(mechanism: LegPlatform, poses: FloatArray, drives: FloatArray) -> Jacobians:
    """Of the residuals by displacements (omega [rad]; shift of the platform's origin [mm]) in base axes, and by the drives."""
    legs, upper = mechanism.legs(drives), uppers(mechanism, poses)
    away = upper - legs.ends
    e = away / np.linalg.norm(away, axis=-1, keepdims=True)
    output = np.concatenate([np.cross(upper - poses[..., None, :3], e), e], axis=-1)
    return Jacobians(output, -np.einsum("...ic,...icn->...in", e, legs.ends_by) - legs.lengths_by)


def forward(mechanism: LegPlatform, drives: FloatArray, start: FloatArray) -> Placed:
    """Poses at drives (n, d), each by Newton's method from start (7,) or (n, 7), in the assembly that it leads to."""
    legs = mechanism.legs(drives)
    starts = np.array(np.broadcast_to(start, (len(drives), 7)))
    ends = np.ascontiguousarray(legs.ends)
    status, poses = placed(mechanism.points, ends, np.ascontiguousarray(legs.lengths), np.zeros_like(ends), starts)
    found = status == Status.OK
    poses[~found] = np.nan
    return Placed(poses, found)


def followed(mechanism: LegPlatform, drives: FloatArray, start: FloatArray) -> Placed:
    """Poses along drives (n, d) that change little from one to the next, each started from the one before: one assembly, kept. What comes
    after a place where the loops do not close is not found."""
    poses = np.full((len(drives), 7), np.nan)
    at = start
    for i, one in enumerate(drives):
        step = forward(mechanism, one[None], at)
        if not step.found[0]:
            break
        at = poses[i] = step.poses[0]
    return Placed(poses, np.isfinite(poses[:, 0]))


def assemblies(mechanism: LegPlatform, drives: FloatArray) -> Assemblies:
    """Every pose that drives (d,) allow, each proved, and whether there can be others (`linkages.straight_links`)."""
    legs = mechanism.legs(drives)
    return straight_assemblies(legs.ends, mechanism.points, legs.lengths)


def uppers(mechanism: LegPlatform, poses: FloatArray) -> FloatArray:
    """(..., 6, 3) upper hinges in the base frame [mm] at poses (..., 7)."""
    return np.asarray(poses[..., None, :3] + np.einsum("...ij,nj->...ni", se3.matrices(poses), mechanism.points))
