"""Data of links, put together for the output of `lmeasure structure`."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lmeasure import linkages
from lmeasure.core import DataFrame, FloatArray, Shown, framed
from lmeasure.structure import measures
from lmeasure.structure.assemblies import WITHIN_MM, found_of, six_of
from lmeasure.structure.design import designed
from lmeasure.structure.links import Linkage
from lmeasure.structure.slices import bounds_of, slices, window_mm
from lmeasure.structure.text import described_lines

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


def _boundary(linkage: Linkage, pose: FloatArray, asked: Workspace) -> dict[str, Any]:
    bounds = bounds_of(linkage, pose, asked.limit_deg, asked.length_mm)
    axis = "xyz".index(next(x for x in "xyz" if x not in asked.plane))
    reach = window_mm(linkage, pose) if asked.reach_mm is None else asked.reach_mm
    pieces, said = slices(bounds, pose, asked.plane, asked.levels or (float(pose[axis]),), reach_mm=reach)
    lines = [*(piece.line("xyz"[axis]) for piece in pieces), *said]
    return {"plane": asked.plane, "reach_mm": reach, "slices": [piece.as_dict() for piece in pieces], "lines": lines}


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
