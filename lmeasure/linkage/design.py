"""Limits of lengths within which a mechanism is never singular, for structures that tetrahedra solve (thesis 4.2, 4.3).

Such a mechanism is singular where one of the tetrahedra that lead from the base to the platform is flat. Their edges are links and sides of
both bodies; where one is another distance, the additional coordinates l7 and l8, its limits follow from no link alone, and nothing is told.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.errors import StructureError
from lmeasure.lcoordinate.flat import Tetrahedron, adjusted, clear
from lmeasure.lcoordinate.structures import LINKS, incidence
from lmeasure.linkage.links import Linkage

Limits = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Design:
    """Links by name with their limits [mm]: given, and those within which no tetrahedron is flat; and what was said of each tetrahedron."""

    given: Limits
    free: Limits
    tetrahedra: tuple[str, ...]
    clear_as_given: tuple[bool, ...]

    @property
    def unchanged(self) -> bool:
        """Whether the limits were free of singular poses as they were given."""
        return self.given == self.free


def tetrahedra_of(linkage: Linkage) -> tuple[list[Tetrahedron], Limits]:
    """The tetrahedra of six links by names of their edges, and the fixed lengths of those that are sides of a body.

    StructureError where the structure is not solved by tetrahedra, or one has an edge that is neither a link nor a side.
    """
    if len(linkage.base) != LINKS:
        raise StructureError(f"design: has {len(linkage.base)} links; limits are proved for six")
    found = incidence(linkage.base, linkage.platform)
    structure = found.structure
    if structure.placements is None:
        raise StructureError(f"design: {structure.notation} is not solved by tetrahedra, which tell where it is singular")
    place, names, links = {}, {}, {}
    for number, (p, b) in zip(found.order, structure.links, strict=True):
        place["P", p], place["B", b] = linkage.platform[number], linkage.base[number]
        links[p, b], names["B", b], names["P", p] = linkage.names[number]
    sides: Limits = {}

    def edge(u: tuple[str, int], v: tuple[str, int]) -> str:
        if u[0] == v[0]:
            name = "-".join(sorted((names[u], names[v]))) + (" of the base" if u[0] == "B" else " of the platform")
            length = float(np.linalg.norm(place[u] - place[v]))
            sides[name] = (length, length)
            return name
        p, b = (u, v) if u[0] == "P" else (v, u)
        if (p[1], b[1]) not in links:
            raise StructureError(
                f"design: {structure.notation}: a tetrahedron stands on the distance of {names[p]} from {names[b]}, "
                "which no link holds within limits"
            )
        return links[p[1], b[1]]

    out = []
    for side, i, (one, two, three) in structure.placements:
        apex = (side, i)
        out.append(Tetrahedron(edge(one, two), edge(apex, one), edge(apex, two), edge(three, one), edge(three, two), edge(apex, three)))
    return out, sides


def designed(linkage: Linkage, margin_mm: float = 0.0) -> Design:
    """Limits within those given at which no tetrahedron can be flat, or fail to be assembled, by cutting those of the links one after the
    other. StructureError where the links have no limits, or none are found."""
    if linkage.limits is None:
        raise StructureError("design: the links have no limits_mm")
    tetrahedra, sides = tetrahedra_of(linkage)
    given = {name[0]: (float(low), float(high)) for name, (low, high) in zip(linkage.names, linkage.limits, strict=True)}
    limits = given | sides
    texts = tuple(", ".join(vars(t).values()) for t in tetrahedra)
    as_given = tuple(_clear(t, limits) for t in tetrahedra)
    free = adjusted(tetrahedra, limits, list(given), margin_mm)
    return Design(given, {name: free[name] for name in given}, texts, as_given)


def _clear(tetrahedron: Tetrahedron, limits: Limits) -> bool:
    try:
        return clear(tetrahedron, limits)
    except StructureError:
        return False
