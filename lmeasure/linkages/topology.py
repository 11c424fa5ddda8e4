"""Structures of six links: the links that meet in each point (thesis 2.1, 4.1, table 1.1).

A class L(n, m) and its degrees, `L-321-222`, platform first, count the links that meet in each point of the platform and of the base. They
do not name them: a class has several incidence graphs, and each is a structure of its own, written `L-321-222:abc-ab-c`, the base points of
each platform point by letters. With platform and base distinguished, there are 60; 59 can determine a pose (Arzumanyan's number).

The drawings of tables 2.3 to 2.6 with the extended variants (thesis 2.2, 2.3) are lost. The numbers of `Variants` follow from the incidence
graph, and agree with every number of the text (`tests/linkages/test_variants.py`).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain, combinations, groupby, pairwise, permutations, product
from math import factorial, prod
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from lmeasure.core import FileFormatError, FloatArray, StructureError
from lmeasure.text import composed, message

LINKS = 6
DEGREES = ((3, 2, 1), (2, 2, 2), (3, 1, 1, 1), (2, 2, 1, 1), (2, 1, 1, 1, 1), (1, 1, 1, 1, 1, 1))
"""Numbers of links that may meet in points of one side: three to six points, at most three links in one, since a fourth would only repeat
these."""
CLOSED_FORM_ASSEMBLIES = 8  # Complex assemblies of every structure that tetrahedra solve: three corners, each on either side of a plane

Links = tuple[tuple[int, int], ...]
Placement = tuple[str, int, tuple[tuple[str, int], ...]]
"""A corner that tetrahedra find: its side and number, and the three points whose distances from it are known."""


@dataclass(frozen=True)
class Structure:
    """Links (platform point, base point), numbered from the point of most links, in the one order that represents all numberings."""

    links: Links

    @property
    def degrees(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Links that meet in each point of the platform, of the base."""
        platform, base = (_degrees([link[side] for link in self.links]) for side in (0, 1))
        return platform, base

    @property
    def class_name(self) -> str:
        """`L-321-222`: platform first."""
        return "L-" + "-".join("".join(map(str, degrees)) for degrees in self.degrees)

    @property
    def notation(self) -> str:
        """`L-321-222:abc-ab-c`: the class and, point by point of the platform, its base points."""
        words: dict[int, str] = {}
        for platform, base in self.links:
            words[platform] = words.get(platform, "") + "abcdef"[base]
        return f"{self.class_name}:{'-'.join(words[p] for p in sorted(words))}"

    @property
    def koliskor(self) -> str:
        """Return `S3332`: points of the platform and of the base, most links in one of either; Koliskor's notation without its last two
        digits, which distinguish structures of one class in an unrecorded way."""
        platform, base = self.degrees
        return f"S{len(platform)}{len(base)}{platform[0]}{base[0]}"

    @cached_property
    def swapped(self) -> "Structure":
        """Return the structure with platform and base swapped."""
        return structure_of([(b, p) for p, b in self.links])

    @cached_property
    def degenerate(self) -> str | None:
        """Return why this structure cannot determine a pose whatever its dimensions are, or None."""
        platform, base = self.degrees
        if min(len(platform), len(base)) < 3:
            return "links that meet in less than three points of a body leave it a turn"
        if max(platform[0], base[0]) > 3:
            return "four links at one point say no more than three"
        if len(set(self.links)) < len(self.links):
            return "two links join the same two points"
        triples = [[i for i, degree in enumerate(degrees) if degree == 3] for degrees in self.degrees]
        if any((p, b) not in self.links for p in triples[0] for b in triples[1]):
            return message("linkages.turn_about_line")
        return None

    @cached_property
    def placements(self) -> tuple[Placement, ...] | None:
        """Return the corners by which tetrahedra lead to a pose, in order; None if they do not (thesis 4.1, corrected).

        A point of the platform ("P") is placed in the base's frame as soon as three of its distances to points placed there are known, one
        of the base ("B") in the platform's frame likewise. Each placed point has known distances to all points of the other body: these are
        the additional coordinates l7, l8.
        """
        if self.degenerate is not None:
            return None
        points = [("P", i) for i in range(len(self.degrees[0]))] + [("B", i) for i in range(len(self.degrees[1]))]
        known = {(("P", p), ("B", b)) for p, b in self.links}
        found: list[Placement] = []
        placed: dict[str, list[tuple[str, int]]] = {"P": [], "B": []}
        for _ in points:
            for point in points:
                side, own = point[0], placed[point[0]]
                far = [q for q in points if q[0] != side and ((point, q) in known or (q, point) in known)]
                if point in own or len(far) + len(own) < 3:
                    continue
                # links first: a distance that was measured is better known than one that was found
                far.sort(key=lambda q: q in placed[q[0]])
                corners = (far + own)[:3]
                found.append((side, point[1], tuple(corners)))
                own.append(point)
                known |= {(point, q) for q in points if q[0] != side}
                break
            if _settled(placed):
                return tuple(found)
        return None

    @property
    def closed_form(self) -> bool:
        """Return whether tetrahedra find all assemblies."""
        return self.placements is not None


def _settled(placed: dict[str, list[tuple[str, int]]]) -> bool:
    """Return whether three points are known in both frames: those of either body that are placed in the other's."""
    return len(placed["P"]) + len(placed["B"]) >= 3


def _degrees(ends: Sequence[int]) -> tuple[int, ...]:
    return tuple(sorted((ends.count(i) for i in set(ends)), reverse=True))


def structure_of(links: Sequence[tuple[int, int]]) -> Structure:
    """The structure of links between points of the platform and of the base, however these are numbered."""
    return Structure(_numbered(tuple(links))[0])


Numbered = tuple[Links, dict[int, int], dict[int, int]]


@cache
def _numbered(links: Links) -> Numbered:
    """The links in their one order, and the new numbers of the points of the platform and of the base. Points with more links come first.
    The side with fewer such numberings is tried in all of them, and numbers the other one; that whose links come first in the order of
    words is taken."""
    if _numberings([b for _, b in links]) < _numberings([p for p, _ in links]):
        turned, of_base, of_platform = _by_platform([(b, p) for p, b in links])
        return tuple(sorted((p, b) for b, p in turned)), of_platform, of_base
    return _by_platform(links)


def _by_platform(links: Sequence[tuple[int, int]]) -> Numbered:
    found: list[Numbered] = []
    for platform in _orders([p for p, _ in links]):
        of_base = {b: sorted(platform[p] for p, c in links if c == b) for _, b in links}
        order = sorted(of_base, key=lambda b: (-len(of_base[b]), of_base[b]))
        base = {b: i for i, b in enumerate(order)}
        found.append((tuple(sorted((platform[p], base[b]) for p, b in links)), platform, base))
    return min(found, key=lambda numbered: numbered[0])


def _numberings(ends: Sequence[int]) -> int:
    degrees = [ends.count(i) for i in set(ends)]
    return prod(factorial(degrees.count(degree)) for degree in set(degrees))


def _orders(ends: Sequence[int]) -> Iterator[dict[int, int]]:
    """Numberings of points in which those with more links come first."""
    points = sorted(set(ends), key=lambda i: -ends.count(i))
    groups = [list(group) for _, group in groupby(points, key=ends.count)]
    for order in product(*(permutations(group) for group in groups)):
        yield {point: i for i, point in enumerate(chain(*order))}


@cache
def structures() -> tuple[Structure, ...]:
    """All 60, platform and base distinguished, degenerate ones included, by class and notation."""
    found = {structure_of(links) for platform in DEGREES for base in DEGREES for links in _incidences(platform, base)}
    rank = {degrees: i for i, degrees in enumerate(DEGREES)}
    return tuple(sorted(found, key=lambda s: (*(rank[d] for d in s.degrees), s.notation)))


def _incidences(platform: tuple[int, ...], base: tuple[int, ...]) -> Iterator[list[tuple[int, int]]]:
    """Ways to link points with these degrees, no two links between the same points; of points alike only in one order."""
    ends = [list(combinations(range(len(base)), degree)) for degree in platform]
    for words in product(*ends):
        alike = all(one <= other for one, other in pairwise(words) if len(one) == len(other))
        if alike and all(sum(i in word for word in words) == degree for i, degree in enumerate(base)):
            yield [(i, b) for i, word in enumerate(words) for b in word]


@cache
def _by_name() -> dict[str, tuple[Structure, ...]]:
    named: dict[str, tuple[Structure, ...]] = {}
    for structure in structures():
        for name in (structure.notation, structure.class_name, structure.koliskor):
            named[name] = (*named.get(name, ()), structure)
    return named


MISPRINTED = {"S5433": "S4433", "S3522": "S3532", "S4320": "S4323", "S4334": "S4323"}
"""Koliskor's notations as the thesis (4.1) misprints them: a point too many, a pair for a triple, a nought.
S3522 is right for L-222-21111, which 4.1 lists among structures that tetrahedra solve and is not one of them."""
_NOTATION = re.compile(r"L-([1-6]+)-([1-6]+)(?::([a-f]+(?:-[a-f]+)*))?")


def parse(text: str, misprints: bool = True) -> tuple[Structure, ...]:
    """The structures of a notation: one of `L-321-222:abc-ab-c`, all of the class of `L-321-222` and of Koliskor's `S3332-00`.

    misprints: whether an S-notation is one of the thesis', whose misprints are then mapped. FileFormatError where nothing has it.
    """
    name = text.strip().replace(" ", "")
    if name.startswith("S"):
        name = name.split("-")[0]
        name = MISPRINTED.get(name, name) if misprints else name
    match = _NOTATION.fullmatch(name)
    if match and match[3]:
        links = [(i, "abcdef".index(letter)) for i, word in enumerate(match[3].split("-")) for letter in word]
        if len(links) == LINKS:
            found = structure_of(links)
            if found in structures() and found.class_name == name.split(":")[0]:
                return (found,)
    elif name in _by_name():
        return _by_name()[name]
    raise FileFormatError(message("error.is_no_structure_of", text=text))


def mobility(bodies: int, pairs: Mapping[int, int]) -> int:
    """Freedoms W = 6 n - sum of i P_i of n moving bodies and P_i pairs of class i, which take i freedoms each (Somov and Malyshev)."""
    return 6 * bodies - sum(cls * count for cls, count in pairs.items())


def somov_malyshev(rods: int = 0, merged: int = 0, fingers: bool = True, links: int = LINKS) -> tuple[int, int]:
    """(freedoms of the platform, turns of links about themselves) W = 6n - 5 P5 - 4 P4 - 3 P3 - 2 P2 of links, all of whose lengths may
    change (thesis 2.1, chapter 3).

    Derived again from the drawings. Each link has two parts on a sliding pair (P5), a spherical joint at one end (P3) and at the other one
    whose finger keeps the link from turning about itself (P4): 13 moving bodies with the platform when there are six, whichever ends are
    joined in one point. An input rod adds a body, a joint with a finger and a sphere in which it slides (P2); a rod that is merged with a
    link takes all three away again. Without fingers every P4 is a P3, and each link and rod turns about itself: 15 = 6 + 9 with three rods.
    """
    k = rods - merged
    n, P5, P4, P3, P2 = 2 * links + 1 + k, links, links + k, links, k
    if not fingers:
        P4, P3 = 0, P3 + P4
    whole = mobility(n, {5: P5, 4: P4, 3: P3, 2: P2})
    own = 0 if fingers else links + k
    return whole - own, own


@dataclass(frozen=True)
class Incidence:
    """A structure found in coordinates: for each of its platform and base points one place, and the order of the links."""

    structure: Structure
    order: tuple[int, ...]
    """Index of each of the structure's links among the given ones."""


def incidence(base: FloatArray, platform: FloatArray) -> Incidence:
    """The structure of links between base points (6, 3) and platform points (6, 3): ends at one place are one point."""
    ends = [_same_places(platform), _same_places(base)]
    links = tuple(zip(*ends, strict=True))
    numbered, of_platform, of_base = _numbered(links)
    new = [(of_platform[p], of_base[b]) for p, b in links]
    return Incidence(Structure(numbered), tuple(sorted(range(len(new)), key=lambda i: new[i])))


def class_of(base: FloatArray, platform: FloatArray) -> str:
    """`L-2222-2222`: how many of any number of links, from base (m, 3) to platform (m, 3), meet in each point; platform first."""
    return "L-" + "-".join("".join(map(str, _degrees(_same_places(points)))) for points in (platform, base))


def _same_places(points: FloatArray) -> list[int]:
    """Return for each point the first one at its position."""
    return [int(np.flatnonzero((points == point).all(axis=1))[0]) for point in points]


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
