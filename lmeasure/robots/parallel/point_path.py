"""The way of a point of a body on five rods, which are all that hold it: what drives a guide of one freedom along."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.robots.parallel.mechanisms.seven_link import SevenLink

RODS = 5
MOST_STEPS = 2000
LEAST_PART = 0.02
"""Of a step: least that the point moves in it."""


@dataclass(frozen=True)
class Driver:
    """point of the body that is driven; step between nodes; limits: how far the way is needed, from home [mm]."""

    point: tuple[float, float, float]
    step_mm: float
    limits: tuple[float, float]


Rods = tuple[tuple[tuple[float, ...], tuple[float, ...], float], ...]
"""Of each its lower end in the base, its upper one on the body, and its length [mm]."""


@lru_cache(maxsize=8)
def way_of(rods: Rods, home: tuple[float, ...], driver: Driver) -> tuple[FloatArray, CubicSpline]:
    """The pose (7,) nearest to home (7,) that five rods allow, and the way of the point from there, by its length in chords [mm], a little
    farther than the driver's limits each way. GeometryError where they allow none, do not leave one freedom, or go less far."""
    if len(rods) != RODS:
        raise GeometryError(f"a way is that of a body on {RODS} rods; there are {len(rods)}")
    link = SevenLink(*(np.array(part) for part in zip(*rods, strict=True)))
    closed = link.closed(np.array(home))
    moved = link.tangent(closed)
    shift = moved[3:] + np.cross(moved[:3], se3.matrices(closed) @ np.array(driver.point))
    # ahead is where the point's fastest coordinate rises
    ahead = np.sign(shift[np.argmax(np.abs(shift))]) * moved
    least, most = driver.limits
    forth, back = (_walked(link, closed, way, driver, far) for way, far in ((ahead, most), (-ahead, -least)))
    poses = np.array([*back[::-1], closed, *forth])
    places = se3.apply(poses, np.broadcast_to(driver.point, (len(poses), 3)))
    chords = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if not (chords > LEAST_PART * driver.step_mm).all():
        raise GeometryError("its point hardly moves somewhere on the way: drive another one, or not so far")
    along = np.concatenate([[0.0], np.cumsum(chords)])
    return closed, CubicSpline(along - along[len(back)], places)


def _walked(link: SevenLink, closed: FloatArray, way: FloatArray, driver: Driver, far: float) -> list[FloatArray]:
    """Poses after the one that is closed, until the point has gone so far and two steps more."""
    out, gone, last = [], 0.0, se3.apply(closed, driver.point)
    for pose in link.walk(closed, way, driver.step_mm):
        place = se3.apply(pose, driver.point)
        out.append(pose)
        gone, last = gone + float(np.linalg.norm(place - last)), place
        if gone > max(far, 0.0) + 2.0 * driver.step_mm:
            return out
        if len(out) >= MOST_STEPS:
            raise GeometryError(
                f"its point goes {gone:.4g} mm in {MOST_STEPS} steps of {driver.step_mm:g} mm, less than its limits of {far:g}"
            )
    raise GeometryError(f"the way comes back to its beginning after {gone:.4g} mm, within its limits of {far:g}")
