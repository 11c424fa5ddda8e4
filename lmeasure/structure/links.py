"""Links read from a structure file or a rig.toml."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from lmeasure.core import FileFormatError, FloatArray, se3
from lmeasure.io import Strict, checked, files, of_key
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, RADIUS, wrap_geometry
from lmeasure.linkages import LINKS, End, Further, HookeJoints, RodLinks, rim_mm
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.text import composed, message

SCHEMA = "lmeasure.structure/1"
MOST_LINKS = 24


def _printable(value: str) -> str:
    if not value.isprintable():
        raise ValueError(message("error.must_be_printable_text"))
    return value


Name = Annotated[str, Field(min_length=1, max_length=64), AfterValidator(_printable)]
"""Name of a point: no channel or column has it, and it may have blanks and dots."""
Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
Points = Annotated[dict[Name, tuple[Coordinate, Coordinate, Coordinate]], Field(min_length=1)]
Length = Annotated[float, Field(gt=0, le=1e7)]
Cone = Annotated[float, Field(gt=0.0, le=180.0)]


def _direction(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(axis):
        raise ValueError(message("error.is_no_direction"))
    return axis


Axis = Annotated[tuple[Coordinate, Coordinate, Coordinate], AfterValidator(_direction)]


class Link(Strict):
    """Straight link between two points."""

    from_point: Annotated[str, Field(alias="from")]
    """Point of the base, or a rod."""
    to_point: Annotated[str, Field(alias="to")]
    """Point of the platform, or a rod."""
    length_mm: Length | None = None
    """Length; state it for all links or for none."""
    limits_mm: tuple[Length, Length] | None = None
    """Smallest and largest length; state them for all links or for none."""
    base_axis: Axis | None = None
    """Direction of the first axis of the Hooke joint at the base, in its frame; default: a ball joint."""
    platform_axis: Axis | None = None
    """Direction of the first axis of the Hooke joint at the platform, in its frame."""

    @model_validator(mode="after")
    def _rising(self) -> "Link":
        if self.limits_mm is not None and not self.limits_mm[0] < self.limits_mm[1]:
            raise of_key("limits_mm", message("error.is_not_below", limits_mm=self.limits_mm[0], limits_mm2=self.limits_mm[1]))
        return self


class Rod(Strict):
    """Rod that begins in a joint of one body; links can end at its other end."""

    name: Name
    """Name for `from` and `to` of links."""
    base: str
    """Point of the base on the rod's axis."""
    platform: str
    """Point of the platform on the rod's axis."""
    joint: Literal["base", "platform"]
    """Body at whose point the rod begins; its axis goes through the other point."""
    length_mm: Length
    """Length from the joint to the end."""
    end: Literal["beyond", "between"] = "beyond"
    """End of the rod: beyond the other point, through which it slides, or between both points, on a neighbouring link."""


class HookeLimits(Strict):
    """Limits of legs between Hooke joints."""

    leg_turn_deg: Cone | None = None
    """Largest rotation of a leg about itself."""
    hooke_deg: Cone | None = None
    """Largest bend of a Hooke joint."""


class StructureFile(Strict):
    """Points and links of a mechanism with at least six links."""

    schema_: Annotated[Literal["lmeasure.structure/1"], Field(alias="schema")]
    """Kind and version of the file."""
    base: Points
    """Points of the base by name, base frame [mm]."""
    platform: Points
    """Points of the platform by name, platform frame [mm]."""
    link: Annotated[tuple[Link, ...], Field(min_length=1)]
    """Links, one table `[[link]]` each."""
    rod: tuple[Rod, ...] = ()
    """Rods, one table `[[rod]]` each: they carry drives out of the work zone."""
    limits: HookeLimits = HookeLimits()
    """Limits of Hooke joints."""


@dataclass(frozen=True)
class Linkage:
    """Six or more links."""

    base: FloatArray
    """(m, 3) where each begins [mm, base frame]"""
    platform: FloatArray
    """(m, 3) where each ends [mm, platform's frame]"""
    names: Sequence[tuple[str, str, str]]
    """Names of each link, of its first and of its last point."""
    lengths: FloatArray | None = None
    """(m,) [mm]; of a cable from the observation point over its pulley"""
    limits: FloatArray | None = None
    """(m, 2) least and greatest length [mm]"""
    cables: FloatArray | None = None
    """(m, columns) the cables of a rig (`kernels.layout`), None where the links are straight"""
    rods: RodLinks | None = None
    """The links where some end at rods; base and platform are then the points that they join (`RodLinks.bodies`)."""
    hooke: HookeJoints | None = None
    """Hooke joints of the links with their limits."""

    @property
    def wrapped(self) -> FloatArray | None:
        """The cables of a rig some of whose pulleys have a radius, else None: then every link is straight from point to point."""
        return self.cables if self.cables is not None and (self.cables[:, RADIUS] > 0.0).any() else None

    @property
    def straight(self) -> bool:
        """Return whether the poses of lengths are those of straight links between base and platform, found with proof."""
        return self.rods is None or self.rods.gauges is not None

    def strips(self, pose: FloatArray) -> FloatArray:
        """(m, k, 3) lines that draw the links at a pose (7,): over a pulley, or along a rod."""
        if self.rods is not None:
            found = self.rods.strips(pose)
            return np.concatenate([found[:, 0], found[:, 1, ::-1]], axis=1)
        starts = self.base if self.wrapped is None else wrap_geometry(np.ascontiguousarray(self.wrapped), pose[None])[1][0]
        return np.stack([self.base, starts, se3.apply(pose, self.platform)], axis=1)

    @property
    def further(self) -> Further | None:
        """Limits of rods and Hooke joints, as smooth functions of poses."""
        rods, hooke = self.rods, self.hooke
        called = [name for name, _, _ in self.names]
        names: tuple[str, ...] = () if rods is None else tuple(message("linkages.rod_end", number=i + 1) for i in range(len(rods.rods)))
        names += () if hooke is None else hooke.names(called)
        if not names:
            return None

        def values(poses: FloatArray) -> FloatArray:
            parts = [] if rods is None else [rods.margins(poses) / rim_mm(self.base)]
            if hooke is not None:
                along = se3.apply(poses[..., None, :], self.platform) - self.base
                turn = se3.matrices(poses.reshape(-1, 7)).reshape(*poses.shape[:-1], 3, 3)
                parts.append(hooke.values(along / np.linalg.norm(along, axis=-1, keepdims=True), turn))
            return np.concatenate(parts, axis=-1)

        return Further(names, values)

    def with_lengths(self, lengths: Sequence[float], option: str) -> "Linkage":
        """The links with these lengths [mm]; FileFormatError names the option."""
        if len(lengths) != len(self.base):
            raise FileFormatError(message("error.lengths_for_links", where=option, n_lengths=len(lengths), n_base=len(self.base)))
        if not all(0.0 < length <= 1e7 for length in lengths):
            worst = next(i for i, length in enumerate(lengths) if not 0.0 < length <= 1e7)
            raise FileFormatError(message("error.that_of_is_which", where=option, names=self.names[worst][0], lengths=lengths[worst]))
        return replace(self, lengths=np.array(lengths, dtype=np.float64))


def linkage_of(rig: Rig) -> Linkage:
    """The cables of a rig, of all its passes."""
    rows = rig.cable_rows()
    names = [(c.name, c.from_point, c.to_point) for c in rig.cable]
    return Linkage(rows[:, BASE_XYZ], rows[:, ATTACHMENT_XYZ], names, cables=rows)


def read_linkage(path: Path) -> Linkage:
    """The links of a structure file, or the cables of a rig.toml; FileFormatError names file and key."""
    data = files.read_toml(path)
    if data.get("schema") != SCHEMA and "observation_point" in data:
        found = linkage_of(rig_from_dict(data, str(path)))
    else:
        found = _of_file(data, path)
    m = len(found.base)
    if not LINKS <= m <= MOST_LINKS:
        numbers = {"m": m, "value": "link" if m == 1 else "links", "links": LINKS, "most_links": MOST_LINKS}
        raise FileFormatError(message("error.has_a_pose_needs", where=path, **numbers))
    return found


def _of_file(data: dict[str, Any], path: Path) -> Linkage:
    table = checked(data, StructureFile, str(path))
    rods = _rods(table, path)
    ends: list[tuple[End, End]] = []
    for i, link in enumerate(table.link, 1):
        pair = []
        for side, name, points in (("base", link.from_point, table.base), ("platform", link.to_point, table.platform)):
            if name not in points and name not in rods:
                known = ", ".join([*points, *rods])
                raise FileFormatError(message("error.link_the_has_no", where=path, i=i, side=side, name=name, points=known))
            pair.append(End(side == "platform", points[name]) if name in points else rods[name])
        if pair[0] == pair[1]:
            raise FileFormatError(message("error.link_joins_a_rod_to_itself", where=path, i=i, name=link.from_point))
        ends.append((pair[0], pair[1]))
    unused = [name for name in rods if not any(name in (link.from_point, link.to_point) for link in table.link)]
    if unused:
        raise FileFormatError(message("error.rod_has_no_link", where=path, name=unused[0]))
    if rods and len(ends) != LINKS:
        raise FileFormatError(message("error.rods_go_with_six_links", where=path, n=len(ends)))
    joined = RodLinks(ends)
    base, platform = joined.bodies
    links = [(f"link {i}", link.from_point, link.to_point) for i, link in enumerate(table.link, 1)]
    lengths = _all_or_none([link.length_mm for link in table.link], "length_mm", path)
    limits = _all_or_none([link.limits_mm for link in table.link], "limits_mm", path)
    return Linkage(base, platform, links, lengths, limits, rods=joined if rods else None, hooke=_hooke(table, path))


def _rods(table: StructureFile, path: Path) -> dict[str, End]:
    """The rods by name."""
    out: dict[str, End] = {}
    for i, rod in enumerate(table.rod, 1):
        if rod.name in table.base or rod.name in table.platform or rod.name in out:
            raise FileFormatError(message("error.rod_name_is_taken", where=path, name=rod.name))
        for side, name, points in (("base", rod.base, table.base), ("platform", rod.platform, table.platform)):
            if name not in points:
                raise FileFormatError(message("error.rod_the_has_no", where=path, i=i, side=side, name=name, points=", ".join(points)))
        at = (table.base[rod.base], table.platform[rod.platform])
        carried = rod.joint == "platform"
        out[rod.name] = End(carried, at[carried], at[not carried], rod.length_mm, rod.end == "between")
    return out


def _hooke(table: StructureFile, path: Path) -> HookeJoints | None:
    both = [i for i, link in enumerate(table.link) if link.base_axis is not None and link.platform_axis is not None]
    for i, link in enumerate(table.link, 1):
        if (link.base_axis is None) != (link.platform_axis is None):
            raise FileFormatError(composed("{where}: {error}", where=f"{path}: link {i}", error=message("error.base_axis_and_platform")))
        rods = [rod.name for rod in table.rod]
        if link.base_axis is not None and (link.from_point in rods or link.to_point in rods):
            raise FileFormatError(message("error.hooke_joints_at_a_rod", where=path, i=i))
    most = table.limits.leg_turn_deg, table.limits.hooke_deg
    if not both:
        if most != (None, None):
            raise FileFormatError(message("error.limits_of_no_hooke_joint", where=path))
        return None
    axes = np.array([(table.link[i].base_axis, table.link[i].platform_axis) for i in both], dtype=np.float64)
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    return HookeJoints(both, axes[:, 0], axes[:, 1], *(None if v is None else float(np.radians(v)) for v in most))


def _all_or_none(values: Sequence[Any], key: str, path: Path) -> FloatArray | None:
    if all(value is None for value in values):
        return None
    if any(value is None for value in values):
        raise FileFormatError(message("error.link_is_missing_all", where=path, index=values.index(None) + 1, key=key))
    return np.array(values, dtype=np.float64)
