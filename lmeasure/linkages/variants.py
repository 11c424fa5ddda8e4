"""Extended variants of a structure: drives on neighbouring links, rods that carry the platform out of their zone (thesis 2.2, 2.3).

Of tables 2.3 to 2.6 the text at hand has the captions and what is said of them; their drawings are lost. What follows here follows from the
incidence graph and is held against every number the text states (`tests/linkages/test_variants.py`).

Drives that are not between base and platform: the lengths between their points for those of drives, and back (thesis 2.2, 4.1, 4.3).

One map serves all of these variants. On a ray from a vertex lie a near and a far point; a third point stands beside it. Its distance from
the far point follows from those from the vertex and the near point (law of cosines, twice):

    d(far)^2 = b^2 + A^2 - A (a^2 + b^2 - c^2)/a,   a = |vertex near|, A = |vertex far|, b = |vertex third|, c = |near third|

which is (4.11), (4.12) and (4.22) to (4.24) with the misprinted (4.11) corrected, and, with the far point between the others, a drive that
ends on a neighbouring link instead of its end (table 2.3). Its inverse is itself: near and far change places.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from lmeasure.core import FloatArray, StructureError
from lmeasure.linkages.topology import Structure, somov_malyshev
from lmeasure.text import composed, message


@dataclass(frozen=True)
class Variants:
    """What can be made of a structure that determines a pose."""

    structure: Structure

    def __post_init__(self) -> None:
        """StructureError of a structure that determines no pose."""
        if self.structure.degenerate is not None:
            raise StructureError(composed("{where}: {error}", where=self.structure.notation, error=self.structure.degenerate))

    @cached_property
    def moved(self) -> tuple[int, int]:
        """(platform, base) how many ends of drives can be put from points of the body onto neighbouring links: all but one of each point.

        Its distances from the link's ends give back the link that was (`lever`), so that poses and singular poses stay as they are.
        """
        platform, base = (len(degrees) for degrees in self.structure.degrees)
        return len(self.structure.links) - platform, len(self.structure.links) - base

    @property
    def arrangements(self) -> int:
        """Arrangements of table 2.3: from either body that has points in common, onto rods or cylinders of the neighbours."""
        return 2 * sum(ends > 0 for ends in self.moved)

    def rods(self, side: int) -> tuple[int, int]:
        """(rods, bent ones) when every point of the platform (side 0) or base (1) is carried by a rod through a point of the other body to
        which it is linked: of the rods through one point one is straight and all others are bent around it (figure 2.7). The fewest that
        must be: those left over by a matching of points to points (Koenig)."""
        counts = [len(degrees) for degrees in self.structure.degrees]
        pairs = np.array(self.structure.links).T[[side, 1 - side]]
        graph = csr_array((np.ones(len(self.structure.links)), (pairs[0], pairs[1])), shape=(counts[side], counts[1 - side]))
        matched = int((maximum_bipartite_matching(graph, perm_type="column") >= 0).sum())
        return counts[side], counts[side] - matched

    def freedoms(self, side: int) -> tuple[int, int]:
        """(of the platform, turns of parts about themselves) of the variant with rods, each with a finger, by Somov and Malyshev."""
        return somov_malyshev(rods=self.rods(side)[0])


def lever(near: FloatArray, vertex: FloatArray, third: FloatArray, far: FloatArray) -> FloatArray:
    """Distances of a third point from the far point of a ray: near and far (...,) how far its points are from the vertex, vertex (...,) and
    third (...,) how far the third point is from the vertex and from the near point [mm]; NaN where there is no such triangle."""
    with np.errstate(invalid="ignore", divide="ignore"):
        square = vertex**2 + far**2 - far * (near**2 + vertex**2 - third**2) / near
        closes = (third <= near + vertex) & (third >= np.abs(near - vertex))
        return np.where(closes, np.sqrt(np.maximum(square, 0.0)), np.nan)


@dataclass(frozen=True)
class Rods:
    """Six links whose platform was moved out of the zone of the drives (thesis 2.2, figures 2.7 and 4.3).

    Each platform point p is the end of a rod that slides through the base point of one of p's links; the drives end at its other end C and
    at the base points. links: pairs (platform point, base point), six; base: places of the base points; rods: for each platform point its
    length and the base point through which it goes. With base and platform exchanged these are rods through the platform (table 2.5).
    """

    links: Sequence[tuple[int, int]]
    base: FloatArray
    rods: Mapping[int, tuple[float, int]]

    def __post_init__(self) -> None:
        for p in sorted({p for p, _ in self.links}):
            if p not in self.rods or (p, self.rods[p][1]) not in self.links:
                raise StructureError(message("error.platform_point_needs_a", p=p + 1))

    def links_of_drives(self, drives: FloatArray) -> FloatArray:
        """(..., 6) distances from base points to platform points for lengths (..., 6) of the drives; NaN where no mechanism has them."""
        return self._mapped(drives)

    def drives_of_links(self, lengths: FloatArray) -> FloatArray:
        """(..., 6) lengths of the drives for distances (..., 6) from base points to platform points."""
        return self._mapped(lengths)

    def _mapped(self, known: FloatArray) -> FloatArray:
        """From one end of the rods to the other: along a rod what is left of it, beside it by the lever from the end that is known."""
        out = np.empty_like(known)
        for i, (p, b) in enumerate(self.links):
            rod, through = self.rods[p]
            along = known[..., self.links.index((p, through))]
            with np.errstate(invalid="ignore"):
                if b == through:
                    out[..., i] = np.where((along > 0.0) & (along < rod), rod - along, np.nan)
                else:
                    across = np.linalg.norm(self.base[b] - self.base[through])
                    out[..., i] = lever(along, known[..., i], np.asarray(across), np.asarray(rod))
        return np.where(np.isfinite(out).all(axis=-1, keepdims=True), out, np.nan)

    def rates(self, drives: FloatArray) -> FloatArray:
        """(6, 6) derivatives of the distances by lengths (6,) of the drives: they turn rates of drives into those of links (thesis 4.4)."""
        lengths, out = self.links_of_drives(drives), np.zeros((6, 6))
        for i, (p, b) in enumerate(self.links):
            rod, through = self.rods[p]
            own = self.links.index((p, through))
            if b == through:
                out[i, i] = -1.0
                continue
            a, m, q = drives[own], drives[i], lengths[i]
            across = np.linalg.norm(self.base[b] - self.base[through])
            out[i, i] = m / q * (1.0 - rod / a)
            out[i, own] = -rod / (2.0 * q) * (1.0 - (m**2 - across**2) / a**2)
        return out
