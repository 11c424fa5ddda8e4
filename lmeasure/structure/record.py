"""Data of links, put together for the output of `lmeasure structure`.

Search for limits of lengths within which a mechanism is never singular (thesis 4.2, 4.3).

If tetrahedra lead from the base to the platform, it is singular where one of them is flat. If they consist of links and sides alone, as
those of L-321-321, that is proved for all assemblies at once (`linkages.flat_tetrahedra`). Of the other structures that tetrahedra solve it
is proved for one assembly, the additional coordinates l7 and l8 followed through its tetrahedra (`linkages.chain`): that of a stated pose,
or the highest one at one of many lengths drawn within the limits. Of all others it is proved around a stated pose
(`linkages.chain.Around`).
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lmeasure import linkages
from lmeasure.core import DataFrame, FloatArray, Shown, StructureError, framed
from lmeasure.linkages import LINKS, Around, Chain, Incidence, Tetrahedron, adjusted, clear, closed_form, grown, heights, incidence, proved
from lmeasure.structure import measures
from lmeasure.structure.assemblies import WITHIN_MM, apart_mm, found_of, lengths_at, six_of
from lmeasure.structure.links import Linkage
from lmeasure.structure.slices import bounds_of, slices, window_mm
from lmeasure.structure.text import described_lines
from lmeasure.text import message

DRAWN = 4096  # sets of lengths in the search for the highest tetrahedra
BOXES = 2000  # most boxes of one proof, so that sixty proofs take seconds
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


NEAR = 0.2  # Of the distance from the base to the platform: another assembly no farther away can be taken for the right one


@dataclass(frozen=True)
class Workspace:
    """Requested part of the workspace: boundary slices of a plane (`xy`, `xz`, `yz`) at levels [mm], in a window of reach_mm to either
    side of the pose, where pressure angles and lengths keep their limits."""

    plane: str
    levels: tuple[float, ...] = ()
    reach_mm: float | None = None
    limit_deg: float | None = None
    length_mm: tuple[float, float] | None = None


def described(
    linkage: Linkage,
    pose: FloatArray | None = None,
    *,
    to: FloatArray | None = None,
    workspace: Workspace | None = None,
    design: bool = False,
    near_singular: bool = False,
    within_mm: float = WITHIN_MM,
) -> dict[str, Any]:
    """All that is known of links, as `lmeasure structure` writes it.

    pose (7,) base_from_platform, to (7,) another to which the platform goes straight; workspace: around the pose; design: limits of the
    links' lengths within which nothing is singular, of the pose's assembly where one is stated; near_singular: the singular pose nearest to
    the pose.
    """
    base, platform, m = linkage.base, linkage.platform, len(linkage.base)
    structure = linkages.incidence(base, platform).structure if m == linkages.LINKS and linkage.straight else None
    reason = None if structure is None else structure.degenerate
    singular = reason or (linkages.architecturally_singular(base, platform) if linkage.straight else None)
    record: dict[str, Any] = (
        {"notation": None, "class": linkages.class_of(base, platform)} if structure is None else _listed(structure)
    ) | {
        "links": m,
        "freedoms": linkages.somov_malyshev(links=m)[0],
        "redundant": m - linkages.LINKS,
        "degenerate": reason is not None,
        "degenerate_reason": reason,
        "architecturally_singular": singular is not None,
        "architecturally_singular_reason": singular,
    }
    if structure is None:
        solved = [linkage.names[i][0] for i in (six_of(linkage) if linkage.straight else range(m))]
        record |= {"closed_form": False, "complex_assemblies": None, "assemblies_of_links": solved}
    if linkage.rods is not None:
        record |= {"rods": len(linkage.rods.rods), "straight_links": linkage.straight}
    if linkage.lengths is not None and singular is not None:
        # at special lengths all poses of a motion, at others none
        record |= {"assemblies": [], "complex_assemblies_found": 0, "complex_assemblies_expected": 0, "status": linkages.NOT_PROVED}
    elif linkage.lengths is not None:
        record |= _assemblies(linkage, linkage.lengths, within_mm)
    if pose is not None:
        record |= measures.at_pose(linkage, pose)
        if singular is None:
            record |= measures.others_near(linkage, pose) | {"near_mm": NEAR * _away(linkage, pose)}
        if linkage.lengths is not None:
            record["forward"] = measures.forward(linkage, pose, linkage.lengths)
        if near_singular:
            record["singular_pose"] = measures.at_singular(linkage, pose)
        if to is not None:
            record["way"] = measures.along(linkage, pose, to)
        if workspace is not None:
            record["boundary"] = _boundary(linkage, pose, workspace)
    if design:
        record["design"] = asdict(designed(linkage, pose))
    return record


def _assemblies(linkage: Linkage, lengths: FloatArray, within_mm: float) -> dict[str, Any]:
    found = found_of(linkage, lengths, within_mm)
    each = zip(found.poses.tolist(), found.certified.tolist(), found.misses_mm.tolist(), strict=True)
    return {
        "assemblies": [{"position_mm": p[:3], "quaternion_xyzw": p[3:], "certified": sure, "misses_mm": miss} for p, sure, miss in each],
        "complex_assemblies_found": found.complex_found,
        "complex_assemblies_expected": found.complex_expected,
        "status": found.status,
        "within_mm": within_mm if len(lengths) > linkages.LINKS else None,
        "next_misses_mm": found.next_misses_mm if np.isfinite(found.next_misses_mm) else None,
    }


def _boundary(linkage: Linkage, pose: FloatArray, requested: Workspace) -> dict[str, Any]:
    bounds = bounds_of(linkage, pose, requested.limit_deg, requested.length_mm)
    axis = "xyz".index(next(x for x in "xyz" if x not in requested.plane))
    reach = window_mm(linkage, pose) if requested.reach_mm is None else requested.reach_mm
    pieces, said = slices(bounds, pose, requested.plane, requested.levels or (float(pose[axis]),), reach_mm=reach)
    lines = [*(piece.line("xyz"[axis]) for piece in pieces), *said]
    return {"plane": requested.plane, "reach_mm": reach, "slices": [piece.as_dict() for piece in pieces], "lines": lines}


def _away(linkage: Linkage, pose: FloatArray) -> float:
    """Return the distance from the middle of the base points to the platform [mm]."""
    return max(float(np.linalg.norm(pose[:3] - linkage.base.mean(axis=0))), linkages.rim_mm(linkage.platform))


def _listed(structure: linkages.Structure) -> dict[str, Any]:
    return {
        "notation": structure.notation,
        "class": structure.class_name,
        "closed_form": structure.closed_form,
        "complex_assemblies": linkages.complex_assemblies(structure),
        "degenerate": structure.degenerate is not None,
    }


def all_structures() -> list[dict[str, Any]]:
    """Every structure, platform and base distinguished, as `lmeasure structure --list` writes it."""
    return [
        _listed(s)
        | {"degenerate_reason": s.degenerate, "koliskor": s.koliskor, "variants": None if s.degenerate else linkages.Variants(s).record}
        for s in linkages.structures()
    ]


@dataclass(frozen=True, repr=False)
class Boundary(Shown):
    """Slices of the boundary of a workspace, as `lmeasure structure --boundary` writes them; pose (7,) around which they lie."""

    content: dict[str, Any]
    pose: FloatArray

    def about(self) -> dict[str, str]:
        """Return plane, slices, and remarks on levels without one."""
        return {"plane": self.content["plane"], "slices": str(len(self.content["slices"]))}

    def to_frame(self) -> DataFrame:
        """A row for each place of each slice [mm], with the limit that is met there."""
        rows = [
            dict(zip(("x_mm", "y_mm", "z_mm"), place, strict=True)) | {"level_mm": piece["level_mm"], "limit": limit}
            for piece in self.content["slices"]
            for place, limit in zip(piece["places_mm"], piece["limits"], strict=True)
        ]
        return framed(rows)


@dataclass(frozen=True, repr=False)
class Described(Shown):
    """Analysis of a mechanism: its links, and the results of `lmeasure structure`.

    Examples
    --------
    >>> found = lm.analyse_structure(rig, np.array([0.0, 0, 0, 0, 0, 0, 1]))
    >>> found.record["links"], found.pose.shape
    (6, (7,))
    """

    linkage: Linkage
    """Links of the mechanism."""
    record: dict[str, Any]
    """Results, as `lmeasure structure --json` writes them."""
    pose: FloatArray | None = None
    """(7,) analysed pose base_from_platform: x, y, z [mm], qx, qy, qz, qw; or None."""

    def about(self) -> dict[str, str]:
        """Structure, assemblies, and how well a pose is held."""
        out = {"structure": str(self.record["notation"] or self.record["class"]), "freedoms": str(self.record["freedoms"])}
        if "assemblies" in self.record:
            out["assemblies"] = f"{len(self.record['assemblies'])} ({self.record['status']})"
        if self.record.get("mm_per_mm") is not None:
            out["rim per mm of length"] = f"{self.record['mm_per_mm']:.4g} mm"
        return out

    def to_frame(self) -> DataFrame:
        """A row for each link: where it begins and ends [mm], and its length where it is known."""
        base, platform = self.linkage.base, self.linkage.platform
        columns: dict[str, Any] = dict(zip(("link", "from", "to"), zip(*self.linkage.names, strict=True), strict=True))
        columns |= {f"{axis}_mm": base[:, i] for i, axis in enumerate("xyz")}
        columns |= {f"platform_{axis}_mm": platform[:, i] for i, axis in enumerate("xyz")}
        return framed(columns | ({} if self.linkage.lengths is None else {"length_mm": self.linkage.lengths}))

    def lines(self) -> list[str]:
        """All of it in lines for a person."""
        return described_lines(self.record)

    @property
    def boundary(self) -> Boundary | None:
        """Return the boundary of the workspace, if requested."""
        found = self.record.get("boundary")
        return None if found is None or self.pose is None else Boundary(found, self.pose)
