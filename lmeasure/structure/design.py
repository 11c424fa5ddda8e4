"""Search for limits of lengths within which a mechanism is never singular (thesis 4.2, 4.3).

If tetrahedra lead from the base to the platform, it is singular where one of them is flat. If they consist of links and sides alone, as
those of L-321-321, that is proved for all assemblies at once (`linkages.flat_tetrahedra`). Of the other structures that tetrahedra solve it
is proved for one assembly, the additional coordinates l7 and l8 followed through its tetrahedra (`linkages.chain`): that of a stated pose,
or the highest one at one of many lengths drawn within the limits. Of all others it is proved around a stated pose
(`linkages.length_limits`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, StructureError
from lmeasure.linkages import LINKS, Around, Chain, Incidence, Tetrahedron, adjusted, clear, closed_form, grown, heights, incidence, proved
from lmeasure.structure.assemblies import apart_mm, lengths_at
from lmeasure.structure.links import Linkage
from lmeasure.text import message

DRAWN = 4096  # lengths among which the place is looked for at which tetrahedra stand highest
BOXES = 2000  # of one proof, so that some sixty of them take seconds
SAME_MM = 1e-3  # a pose this near to an assembly in closed form is that one

Limits = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Design:
    """Links by name with their limits [mm]: given ones, and those within which nothing is singular; and the message on each tetrahedron, in
    order, up to the first that may be flat."""

    given: Limits
    free: Limits
    tetrahedra: tuple[str, ...]
    clear_as_given: tuple[bool, ...]
    assembly: tuple[float, ...] | None = None
    """Pose (7,) of the assembly for which it is proved, at lengths within the limits; None: for every one."""


def tetrahedra_of(linkage: Linkage, found: Incidence) -> tuple[list[Tetrahedron], Limits]:
    """The tetrahedra of six links by names of their edges, and the fixed lengths of those that are sides of a body. Edges that are neither,
    the additional coordinates, are named by their ends and have no limits."""
    structure = found.structure
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
        return links.get((p[1], b[1]), f"{names[p]} from {names[b]}")

    out = []
    for side, i, (one, two, three) in structure.placements or ():
        apex = (side, i)
        out.append(Tetrahedron(edge(one, two), edge(apex, one), edge(apex, two), edge(three, one), edge(three, two), edge(apex, three)))
    return out, sides


def designed(linkage: Linkage, pose: FloatArray | None = None) -> Design:
    """Limits of the links within those given at which nothing is singular, and everything can be assembled. pose (7,): of the assembly that
    is meant. StructureError where the links have no limits, none are found, or a pose is needed."""
    if linkage.limits is None:
        raise StructureError(message("error.design_the_links_have"))
    if len(linkage.base) != LINKS:
        raise StructureError(message("error.design_has_links_limits", n_base=len(linkage.base)))
    found = incidence(linkage.base, linkage.platform)
    if found.structure.degenerate is not None:
        of = {"notation": found.structure.notation, "degenerate": found.structure.degenerate}
        raise StructureError(message("error.design_is_singular_at", **of))
    if not linkage.straight:
        raise StructureError(message("error.design_takes_no_such_rods"))
    corners, sides = tetrahedra_of(linkage, found)
    given = {name[0]: (float(low), float(high)) for name, (low, high) in zip(linkage.names, linkage.limits, strict=True)}
    texts = tuple(", ".join(vars(t).values()) for t in corners)
    if corners and all(edge in given or edge in sides for t in corners for edge in vars(t).values()):
        if linkage.rods is not None:
            return _of_rods(linkage, corners, given, sides, texts)
        limits = given | sides
        as_given = tuple(_clear(t, limits) for t in corners)
        free = adjusted(corners, limits, list(given))
        return Design(given, {name: free[name] for name in given}, texts, as_given)
    if corners:
        return _of_one_assembly(linkage, found, pose, given, texts)
    if pose is None:
        raise StructureError(message("error.design_is_not_solved", notation=found.structure.notation))
    lengths = _lengths_within(linkage, pose)
    free_box = _cut(_on_drives(linkage, Around(linkage.base, linkage.platform, pose).sound), lengths, linkage.limits)
    return Design(given, _named(given, free_box), (), (), tuple(pose.tolist()))


def _of_rods(linkage: Linkage, corners: list[Tetrahedron], given: Limits, sides: Limits, texts: tuple[str, ...]) -> Design:
    """Limits of drives that end at rods, by the tetrahedra of the lengths between the bodies (thesis 4.3)."""
    assert linkage.rods is not None
    assert linkage.limits is not None
    box = linkage.rods.link_box(linkage.limits)

    def sound(links: FloatArray) -> bool:
        limits = _named(given, links) | sides
        return all(_clear(t, limits) for t in corners)

    as_given = tuple(bool(np.isfinite(box).all()) and _clear(t, _named(given, box) | sides) for t in corners)
    free = linkage.limits if all(as_given) else _cut(_on_drives(linkage, sound), _highest(linkage)[0], linkage.limits)
    return Design(given, _named(given, free), texts, as_given)


def _on_drives(linkage: Linkage, sound: Callable[[FloatArray], bool]) -> Callable[[FloatArray], bool]:
    """A proof for limits (6, 2) of links, as one for limits of the drives that move them."""
    rods = linkage.rods
    if rods is None:
        return sound

    def of_drives(box: FloatArray) -> bool:
        links = rods.link_box(box)
        return bool(np.isfinite(links).all()) and sound(links)

    return of_drives


def _links_of(linkage: Linkage, drives: FloatArray) -> FloatArray:
    return drives if linkage.rods is None else linkage.rods.links_of_drives(drives)


def _of_one_assembly(linkage: Linkage, found: Incidence, pose: FloatArray | None, given: Limits, texts: tuple[str, ...]) -> Design:
    """Design by tetrahedra with additional coordinates, and around the pose if that proves more."""
    assert linkage.limits is not None
    if pose is None:
        centre, pose, which = _highest(linkage)
    else:
        centre = _lengths_within(linkage, pose)
        poses, closes = closed_form(linkage.base, linkage.platform, _links_of(linkage, centre))
        away = np.where(closes, apart_mm(poses, pose, float(np.ptp(linkage.platform, axis=0).max())), np.inf)
        which = int(np.argmin(away))
        if not away[which] < SAME_MM:
            raise StructureError(message("error.design_the_stated_pose"))
    sides = (1.0 if which % 2 == 0 else -1.0, 1.0 if which // 2 % 2 == 0 else -1.0)
    tetra, near = Chain(found, linkage.base, linkage.platform, sides), Around(linkage.base, linkage.platform, pose)
    free = _cut(_on_drives(linkage, lambda box: near.sound(box) or proved(tetra.judge, box, BOXES)), centre, linkage.limits)
    unchanged = bool((free == linkage.limits).all())
    each = [_on_drives(linkage, lambda box, k=k: proved(lambda b: tetra.judge(b, k), box, BOXES)) for k in range(3)]  # type: ignore[misc]
    as_given = tuple(unchanged or one(linkage.limits) for one in each)
    return Design(given, _named(given, free), texts, as_given, tuple(pose.tolist()))


def _highest(linkage: Linkage) -> tuple[FloatArray, FloatArray, int]:
    """Return, of lengths within the limits, their middle and many drawn at random, those (6,) at which an assembly has the highest of
    lowest tetrahedra; its pose (7,) and number. StructureError where nothing can be assembled."""
    assert linkage.limits is not None
    low, high = linkage.limits.T
    drawn = np.vstack([(low + high) / 2.0, np.random.default_rng(0).uniform(low, high, (DRAWN, LINKS))])
    links = _links_of(linkage, drawn)
    known = np.isfinite(links).all(axis=1)
    drawn, links = drawn[known], links[known]
    poses, closes = closed_form(linkage.base, linkage.platform, links)
    height = np.where(closes, heights(linkage.base, linkage.platform, links), -np.inf)
    if not len(drawn):
        raise StructureError(message("error.design_none_of_lengths", drawn=DRAWN))
    i, k = np.unravel_index(int(np.argmax(height)), height.shape)
    if not height[i, k] > 0.0:
        raise StructureError(message("error.design_none_of_lengths", drawn=DRAWN))
    return drawn[i], poses[i, k], int(k)


def _lengths_within(linkage: Linkage, pose: FloatArray) -> FloatArray:
    """(6,) lengths at a pose (7,); StructureError names the first that is not within its limits."""
    assert linkage.limits is not None
    lengths = np.asarray(lengths_at(linkage, pose[None])[0])
    for name, length, (low, high) in zip(linkage.names, lengths, linkage.limits, strict=True):
        if not low <= length <= high:
            raise StructureError(message("error.design_is_mm_long", name=name[0], length=length, low=low, high=high))
    return lengths


def _cut(sound: Callable[[FloatArray], bool], centre: FloatArray, given: FloatArray) -> FloatArray:
    free = given if sound(given) else grown(sound, centre, given)
    if free is None:
        raise StructureError(message("error.design_nothing_is_proved"))
    return free


def _named(given: Limits, box: FloatArray) -> Limits:
    return {name: (float(low), float(high)) for name, (low, high) in zip(given, box, strict=True)}


def _clear(tetrahedron: Tetrahedron, limits: Limits) -> bool:
    try:
        return clear(tetrahedron, limits)
    except StructureError:
        return False
