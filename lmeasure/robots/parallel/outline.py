"""A parallel robot as strips of points in its base's frame: what pictures of it, on pages and in recordings, are made of."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.robots.parallel.file import ParallelFile
from lmeasure.robots.parallel.legs import Leg
from lmeasure.robots.parallel.limits import RING, own_roots

ROUND = 120


@dataclass(frozen=True)
class Drawn:
    """Strips (k, 3) [mm]: base: guides and the outline of what stands still; arms: cranks and lower arms; legs; platform, closed; hinges
    (m, 3) on it, by names."""

    base: list[FloatArray]
    arms: list[FloatArray]
    legs: list[FloatArray]
    platform: FloatArray
    hinges: FloatArray
    names: list[str]


def drawn(file: ParallelFile, pose: FloatArray) -> Drawn:
    """At a pose (7,) in the base's frame."""
    robot = file.model
    joints = np.split(own_roots(robot, pose[None])[0], np.cumsum([len(leg.of.drives) for leg in robot.legs])[:-1])
    base: list[FloatArray] = []
    arms: list[FloatArray] = []
    legs: list[FloatArray] = []
    feet = []
    for leg, q in zip(robot.legs, joints, strict=True):
        top = se3.apply(pose, leg.point)
        if leg.kind == "way":
            nodes = np.linspace(leg.low[0], leg.high[0], ROUND)
            base.append(np.asarray(leg.carried(nodes)))
        if leg.kind in ("way", "plane"):
            continue
        end = np.real(leg.equations(q[None])[0].end)[0]
        legs.append(np.array([end, top]))
        foot = _foot(leg, q)
        if foot is None:
            feet.append(end)
        else:
            arms.append(np.array([foot, end]))
        if leg.kind in RING:
            u = np.linspace(0.0, 2.0 * np.pi, ROUND)
            base.append(np.column_stack([leg.values[0] * np.cos(u), leg.values[0] * np.sin(u), np.full(ROUND, leg.values[1])]))
        if leg.kind == "slider":
            base.append(np.real(leg.equations(np.array([leg.low, leg.high]))[0].end))
        if leg.kind == "crank":
            feet.append(leg.values[:3])
    still = [leg for leg in robot.legs if leg.kind in ("strut", "rod", "crank")]
    if len(still) >= 3:
        base.append(outline(np.array(feet)))
    hinges = np.array([leg.point for leg in robot.legs])
    return Drawn(base, arms, legs, se3.apply(pose, outline(hinges)), se3.apply(pose, hinges), [leg.name for leg in robot.legs])


def _foot(leg: Leg, q: FloatArray) -> FloatArray | None:
    """Where an arm or a crank before the leg begins; None where there is none."""
    if leg.kind == "crank":
        return leg.values[:3]
    if leg.kind == "radial-arm":
        return np.asarray(np.real(leg.equations(q[None])[1].end)[0])
    return None


def outline(points: FloatArray) -> FloatArray:
    """(k, 3) the points in order round their middle, closed."""
    places = np.unique(points.round(6), axis=0)
    centred = places - places.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    order = np.argsort(np.arctan2(centred @ axes[1], centred @ axes[0]))
    return np.asarray(places[np.append(order, order[0])])
