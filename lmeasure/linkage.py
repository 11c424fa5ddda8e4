"""Points and links of a rig or a sketch, and all that is known of them as a structure: what `lmeasure structure` prints and writes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from lmeasure import files
from lmeasure.arrays import FloatArray
from lmeasure.checked import Name, Strict, checked
from lmeasure.errors import FileFormatError
from lmeasure.kernels.layout import ATTACHMENT_XYZ, BASE_XYZ
from lmeasure.lcoordinate import singularity, starts, straight
from lmeasure.lcoordinate.architecture import architecturally_singular
from lmeasure.lcoordinate.structures import LINKS, Structure, incidence, somov_malyshev, structures
from lmeasure.rig import rig_from_dict

SCHEMA = "lmeasure.structure/1"
Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
Points = Annotated[dict[Name, tuple[Coordinate, Coordinate, Coordinate]], Field(min_length=1)]


class Link(Strict):
    from_point: Annotated[str, Field(alias="from")]
    to_point: Annotated[str, Field(alias="to")]
    length_mm: Annotated[float, Field(gt=0, le=1e7)] | None = None


class StructureFile(Strict):
    schema_: Annotated[Literal["lmeasure.structure/1"], Field(alias="schema")]
    base: Points
    platform: Points
    link: Annotated[tuple[Link, ...], Field(min_length=1)]


@dataclass(frozen=True)
class Linkage:
    """Six straight links."""

    base: FloatArray
    """(6, 3) where each begins [mm, base frame]"""
    platform: FloatArray
    """(6, 3) where each ends [mm, platform's frame]"""
    lengths: FloatArray | None = None
    """(6,) [mm]"""


def read_linkage(path: Path) -> Linkage:
    """The links of a structure file, or the cables of a rig.toml as straight ones; FileFormatError names file and key."""
    data = files.read_toml(path)
    if data.get("schema") != SCHEMA and "observation_point" in data:
        rows = rig_from_dict(data, str(path)).cable_rows()
        base, platform, lengths = rows[:, BASE_XYZ], rows[:, ATTACHMENT_XYZ], None
    else:
        base, platform, lengths = _of_file(data, path)
    if len(base) != LINKS:
        raise FileFormatError(f"{path}: has {len(base)} links; structures are of {LINKS}")
    return Linkage(base, platform, lengths)


def _of_file(data: dict[str, Any], path: Path) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    table = checked(data, StructureFile, str(path))
    ends: dict[str, list[tuple[float, float, float]]] = {"base": [], "platform": []}
    for i, link in enumerate(table.link, 1):
        for side, name, points in (("base", link.from_point, table.base), ("platform", link.to_point, table.platform)):
            if name not in points:
                raise FileFormatError(f"{path}: link {i}: the {side} has no point {name!r}; it has {', '.join(points)}")
            ends[side].append(points[name])
    stated = [link.length_mm for link in table.link if link.length_mm is not None]
    if stated and len(stated) < len(table.link):
        without = next(i for i, link in enumerate(table.link, 1) if link.length_mm is None)
        raise FileFormatError(f"{path}: link {without}: length_mm is missing; all links have it or none")
    return np.array(ends["base"]), np.array(ends["platform"]), np.array(stated) if stated else None


def described(linkage: Linkage, pose: FloatArray | None = None) -> dict[str, Any]:
    """All that is known of links, as `lmeasure structure` writes it; pose (7,) base_from_platform, or None."""
    base, platform = linkage.base, linkage.platform
    structure = incidence(base, platform).structure
    singular = structure.degenerate or architecturally_singular(base, platform)
    record = _listed(structure) | {
        "freedoms": somov_malyshev()[0],
        "degenerate_reason": structure.degenerate,
        "architecturally_singular": singular is not None,
        "architecturally_singular_reason": singular,
    }
    if linkage.lengths is not None and singular is not None:
        # at special lengths all poses of a motion, at others none
        record |= {"assemblies": [], "complex_assemblies_found": 0, "complex_assemblies_expected": 0, "status": straight.NOT_PROVED}
    elif linkage.lengths is not None:
        found = straight.assemblies(base, platform, linkage.lengths)
        each = zip(found.poses.tolist(), found.certified.tolist(), strict=True)
        record["assemblies"] = [{"position_mm": pose[:3], "quaternion_xyzw": pose[3:], "certified": sure} for pose, sure in each]
        record["complex_assemblies_found"], record["status"] = found.complex_found, found.status
        record["complex_assemblies_expected"] = found.complex_expected
    if pose is not None:
        record |= _at_pose(base, platform, pose)
    return record


def _listed(structure: Structure) -> dict[str, Any]:
    return {
        "notation": structure.notation,
        "class": structure.class_name,
        "closed_form": structure.closed_form,
        "complex_assemblies": starts.complex_assemblies(structure),
        "degenerate": structure.degenerate is not None,
    }


def all_structures() -> list[dict[str, Any]]:
    """Every structure, platform and base told apart, as `lmeasure structure --list` writes it."""
    return [_listed(s) | {"degenerate_reason": s.degenerate, "koliskor": s.koliskor} for s in structures()]


def _at_pose(base: FloatArray, platform: FloatArray, pose: FloatArray) -> dict[str, Any]:
    if not (singularity.link_rows(base, platform, pose)[1] > 0.0).all():
        raise FileFormatError("--position-mm: a link has no length at this pose")
    hold = singularity.hold(base, platform, pose)
    return {
        "determinant": float(singularity.determinants(base, platform, pose)),
        "rank": hold.rank,
        "condition": hold.condition if np.isfinite(hold.condition) else None,
        "gradient": singularity.gradients(base, platform, pose).tolist(),
        "pressure_angles_deg": np.degrees(singularity.pressure_angles(base, platform, pose)).tolist(),
    }


def told(record: dict[str, Any]) -> list[str]:
    """A record of `described` in lines for a person."""
    how = ", in closed form" if record["closed_form"] else ", followed from a start system"
    number = f"{record['complex_assemblies']} complex assemblies{'' if record['degenerate'] else how}"
    lines = [f"{record['notation']}: {record['freedoms']} freedoms, {number}"]
    if record["architecturally_singular"]:
        lines.append(f"singular at every pose: {record['architecturally_singular_reason']}")
        if "assemblies" in record:
            lines.append("no lengths tell a pose of it")
    elif "assemblies" in record:
        found = record["assemblies"]
        number = f"{len(found)} real {'assembly' if len(found) == 1 else 'assemblies'}"
        of = f"{record['complex_assemblies_found']} with complex ones of {record['complex_assemblies_expected']}"
        lines.append(f"{number}, {of}: {record['status']}")
        for one in found:
            place = ", ".join(f"{x:.4f}" for x in one["position_mm"])
            turn = ", ".join(f"{x:.6f}" for x in one["quaternion_xyzw"])
            lines.append(f"  ({place}) mm, quaternion ({turn}){'' if one['certified'] else ', not certified'}")
    if "determinant" in record:
        condition = "" if record["condition"] is None else f", condition {record['condition']:.4g}"
        lines.append(f"determinant {record['determinant']:.6g} mm^3, rank {record['rank']}{condition}")
        lines.append(f"gradient (omega; v): {', '.join(f'{x:.6g}' for x in record['gradient'])}")
        lines.append(f"pressure angles: {', '.join(f'{x:.1f}' for x in record['pressure_angles_deg'])} degrees")
    return lines


def told_list(records: list[dict[str, Any]]) -> list[str]:
    """Every structure in a line each."""
    lines = []
    for r in records:
        how = r["degenerate_reason"] or ("closed form" if r["closed_form"] else "homotopy")
        lines.append(f"{r['notation']:<32} {r['koliskor']}  {r['complex_assemblies']:>2}  {how}")
    return lines
