"""Rigs whose links depend on each other at every pose, determined from coordinates: architecturally singular ones.

A structure does not tell them; the places of its points do. Whether the links depend is seen at poses taken at random: dimensions at which
they hold a body anywhere hold it at almost all poses. The names are of the known kinds: all points of a body on one line, four links
between points in the same ratios on two lines, and plane figures on conics of which one is a projective image of the other, as regular
hexagons are (Roeschel and Mick, Characterisation of architecturally shaky platforms, 1998). Similar plane hexagons whose corners lie on no
conic are not among them.
"""

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.linkages.singularity import link_rows
from lmeasure.text import message

POSES = 6
SINGULAR = 1e-5
"""Of the largest singular value: below it at every pose, links depend. Rigs that hold a body have 1e-3 and more at most poses; coordinates
of such a rig of half a metre that were rounded to the micrometre make some 1e-6."""
STRAIGHT = 1e-5  # of a figure's size: points so near to one line or plane are on it


def architecturally_singular(base: FloatArray, platform: FloatArray) -> str | None:
    """Why links from points base (6, 3) to points platform (6, 3) depend on each other at every pose; None where they do not."""
    a, b = base - base.mean(axis=0), platform - platform.mean(axis=0)
    size = max(np.abs(a).max(), np.abs(b).max())
    rng = np.random.default_rng(0)
    poses = se3.pose(rng.normal(size=(POSES, 3)), Rotation.random(POSES, rng=rng))
    s = np.linalg.svd(link_rows(a / size, b / size, poses)[0], compute_uv=False)
    if not (s[:, -1] < SINGULAR * s[:, 0]).all():
        return None
    for points, name in ((a, "base"), (b, "platform")):
        if _flatness(points, 1):
            return message("linkages.all_points_lie_one", body=message(f"linkages.{name}"))
    four = next((list(i) for i in itertools.combinations(range(6), 4) if _flatness(a[list(i)], 1) and _flatness(b[list(i)], 1)), None)
    if four is not None:
        return message("linkages.links_join_points_same", links=tuple(str(i + 1) for i in four))
    if _flatness(a, 2) and _flatness(b, 2):
        return message("linkages.conics_similar" if _similar(a, b) else "linkages.conics")
    return message("linkages.links_depend_each_other")


def _flatness(points: FloatArray, dimensions: int) -> bool:
    """Whether points (k, 3) span no more than so many dimensions."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(s[dimensions] <= STRAIGHT * s[0])


def _similar(a: FloatArray, b: FloatArray) -> bool:
    """Whether the distances of both figures are in one ratio."""
    of_a, of_b = (np.linalg.norm(points[:, None] - points, axis=2) for points in (a, b))
    ratio = np.sqrt((of_b**2).sum() / (of_a**2).sum())
    return bool(np.abs(of_b - ratio * of_a).max() <= STRAIGHT * of_b.max())
