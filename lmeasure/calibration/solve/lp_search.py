"""Global stage: LP-search (Sobol's LP-tau points) over position and guide angles of one point, then coordinate descent (thesis 5.5)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.core import BoolArray, FloatArray
from lmeasure.kernels import best_of, descend
from lmeasure.sensors import changes_from_counts

CANDIDATES_LOG2 = 13
SWEEPS = 60


@dataclass(frozen=True)
class Box:
    """Search region of a point: centre and half widths (5,) of x, y, z [mm], alpha, beta [rad]."""

    centre: FloatArray
    half: FloatArray

    def holds(self, candidate: FloatArray) -> bool:
        """Return whether a candidate lies inside and not at the edge (the outer hundredth)."""
        away = candidate - self.centre
        away[4] = math.remainder(away[4], 2 * math.pi)
        return bool(
            (np.abs(away) <= 0.99 * self.half).all() or (self.half[4] >= math.pi and (np.abs(away[:4]) <= 0.99 * self.half[:4]).all())
        )


@dataclass(frozen=True)
class PointData:
    """All counted poses of one observation point, cable by cable, each beginning with its zero pose.

    points (e, 3) attachment points [mm, base frame], changes (e,) of the cables [mm], zeroed (e,) True at the zero poses, radius of the
    pulley [mm].
    """

    points: FloatArray
    changes: FloatArray
    zeroed: BoolArray
    radius: float


def point_data(campaign: Campaign, point: str) -> PointData:
    """The data of all cables that leave one observation point."""
    points, changes, zeroed = [], [], []
    for j, c in enumerate(campaign.cables):
        if c.from_point != point or not c.is_cable:
            continue
        rows = np.concatenate([[campaign.zero[j]], np.flatnonzero(campaign.used[:, j])])
        points.append(campaign.poses.points(campaign.rig.tool[c.to_point])[rows])
        changes.append(changes_from_counts(campaign.rig, campaign.counts[rows][:, [j]], (c,))[:, 0])
        zeroed.append(np.arange(len(rows)) == 0)
    radius = campaign.rig.point(point).pulley_radius_mm
    return PointData(np.vstack(points), np.concatenate(changes), np.concatenate(zeroed), radius)


def search_point(data: PointData, boxes: list[Box], seed: int, log2: int = CANDIDATES_LOG2, *, keep: int = 4) -> Iterator[FloatArray]:
    """The best candidates (x, y, z [mm], alpha, beta [rad]) of each box after coordinate descent, best first within a box.

    2^log2 scrambled Sobol points a box, seeded; the radius stays the nominal one.
    """
    known = (data.radius, data.points, data.changes, data.zeroed)
    for number, box in enumerate(boxes):
        unit = scipy.stats.qmc.Sobol(5, scramble=True, rng=np.random.default_rng([seed, number])).random_base2(log2)
        # in place: the pages of a fresh array cost as much as the numbers in it
        unit *= 2 * box.half
        unit += box.centre - box.half
        candidates = np.ascontiguousarray(unit)
        found = []
        for i, value in zip(*best_of(candidates, keep, *known), strict=True):
            if np.isfinite(value):
                best, value = descend(candidates[i], box.half / 16, SWEEPS, *known)
                found.append((value, best))
        yield from (best for _, best in sorted(found, key=lambda pair: pair[0]))
