"""Global stage: LP-search (Sobol's LP-tau points) over position and guide angles of one point, then coordinate descent (thesis 5.5)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from lmeasure.calibration.campaign import Campaign
from lmeasure.kernels import search
from lmeasure.lengths import changes_from_counts

FloatArray = NDArray[np.float64]

CANDIDATES_LOG2 = 13
SWEEPS = 60


@dataclass(frozen=True)
class Box:
    """Where to search for a point: centre and half widths (5,) of x, y, z [mm], alpha, beta [rad]."""

    centre: FloatArray
    half: FloatArray

    def holds(self, candidate: FloatArray) -> bool:
        """Whether a candidate lies inside and not at the edge (the outer hundredth)."""
        away = candidate - self.centre
        away[4] = math.remainder(away[4], 2 * math.pi)
        return bool(
            (np.abs(away) <= 0.99 * self.half).all() or (self.half[4] >= math.pi and (np.abs(away[:4]) <= 0.99 * self.half[:4]).all())
        )


@dataclass(frozen=True)
class PointData:
    """All counted poses of one observation point: (e, 3) attachment points there and at the zero pose [mm, base frame], (e,) changes of
    the cable [mm], pulley radius [mm]."""

    points: FloatArray
    zero: FloatArray
    changes: FloatArray
    radius: float


def point_data(campaign: Campaign, point: str) -> PointData:
    """The data of all cables that leave one observation point."""
    points, zero, changes = [], [], []
    used = campaign.used
    for j, c in enumerate(campaign.cables):
        if c.from_point != point:
            continue
        every = campaign.poses.points(campaign.rig.tool[c.to_point])
        change = changes_from_counts(campaign.rig, campaign.counts[:, [j]], (c,))[:, 0]
        rows = np.flatnonzero(used[:, j])
        points.append(every[rows])
        zero.append(np.repeat(every[campaign.zero[j]][None, :], len(rows), axis=0))
        changes.append(change[rows] - change[campaign.zero[j]])
    return PointData(np.vstack(points), np.vstack(zero), np.concatenate(changes), campaign.rig.point(point).pulley_radius_mm)


def search_point(data: PointData, boxes: list[Box], seed: int, keep: int = 4) -> Iterator[FloatArray]:
    """The best candidates (x, y, z [mm], alpha, beta [rad]) of each box after coordinate descent, best first within a box.

    Scrambled Sobol points, seeded; radius fixed at the nominal.
    """
    radii = np.array([data.radius])
    for number, box in enumerate(boxes):
        unit = qmc.Sobol(5, scramble=True, rng=np.random.default_rng([seed, number])).random_base2(CANDIDATES_LOG2)
        candidates = np.ascontiguousarray(box.centre + (2 * unit - 1) * box.half)
        values = search.scan(candidates, radii, data.points, data.changes, data.zero)
        found = []
        for i in np.argsort(values)[:keep]:
            if not np.isfinite(values[i]):
                continue
            best, value = search.descend(candidates[i], box.half / 16, SWEEPS, radii, data.points, data.changes, data.zero)
            found.append((value, best))
        yield from (best for _, best in sorted(found, key=lambda pair: pair[0]))
