"""Extended variants of a structure: drives on neighbouring links, and rods that carry the platform out of their zone (thesis 2.2, 2.3).

The drawings of tables 2.3 to 2.6 are lost. The numbers here follow from the incidence graph, and agree with every number of the text
(`tests/linkages/test_variants.py`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from lmeasure.core import StructureError
from lmeasure.linkages.topology import Structure, somov_malyshev
from lmeasure.text import composed


@dataclass(frozen=True)
class Variants:
    """Variants of a structure that determines a pose."""

    structure: Structure

    def __post_init__(self) -> None:
        """StructureError of a structure that determines no pose."""
        if self.structure.degenerate is not None:
            raise StructureError(composed("{where}: {error}", where=self.structure.notation, error=self.structure.degenerate))

    @cached_property
    def moved(self) -> tuple[int, int]:
        """(platform, base) how many ends of drives can be put from points of the body onto neighbouring links: all but one of each point.

        Its distances from the link's ends give back the link that was (`rods`), so that poses and singular poses stay as they are.
        """
        platform, base = (len(degrees) for degrees in self.structure.degrees)
        return len(self.structure.links) - platform, len(self.structure.links) - base

    @property
    def arrangements(self) -> int:
        """Arrangements of table 2.3: from either body that has points in common, onto rods or cylinders of the neighbours."""
        return 2 * sum(ends > 0 for ends in self.moved)

    @property
    def record(self) -> dict[str, Any]:
        """Return the numbers for platform and base, as JSON has them."""
        both = [self.rods(0), self.rods(1)]
        return {"drives_moved": list(self.moved), "rods": [n for n, _ in both], "bent_rods": [bent for _, bent in both]}

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
