"""Links read from a structure file or a rig.toml."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from lmeasure.core import FileFormatError, FloatArray
from lmeasure.io import Strict, checked, files, of_key
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, RADIUS
from lmeasure.linkages import LINKS
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.text import message

SCHEMA = "lmeasure.structure/1"
MOST_LINKS = 24


def _printable(value: str) -> str:
    if not value.isprintable():
        raise ValueError(message("error.must_be_printable_text"))
    return value


Name = Annotated[str, Field(min_length=1, max_length=64), AfterValidator(_printable)]
"""Of a point: it names no channel or column, and may have blanks and dots."""
Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
Points = Annotated[dict[Name, tuple[Coordinate, Coordinate, Coordinate]], Field(min_length=1)]
Length = Annotated[float, Field(gt=0, le=1e7)]


class Link(Strict):
    """Straight link between two points."""

    from_point: Annotated[str, Field(alias="from")]
    """Point of the base."""
    to_point: Annotated[str, Field(alias="to")]
    """Point of the platform."""
    length_mm: Length | None = None
    """Length; state it for all links or for none."""
    limits_mm: tuple[Length, Length] | None = None
    """Smallest and largest length; state them for all links or for none."""

    @model_validator(mode="after")
    def _rising(self) -> "Link":
        if self.limits_mm is not None and not self.limits_mm[0] < self.limits_mm[1]:
            raise of_key("limits_mm", message("error.is_not_below", limits_mm=self.limits_mm[0], limits_mm2=self.limits_mm[1]))
        return self


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


@dataclass(frozen=True)
class Linkage:
    """Six or more links."""

    base: FloatArray
    """(m, 3) where each begins [mm, base frame]"""
    platform: FloatArray
    """(m, 3) where each ends [mm, platform's frame]"""
    names: Sequence[tuple[str, str, str]]
    """Of each link, of the point where it begins and of that where it ends."""
    lengths: FloatArray | None = None
    """(m,) [mm]; of a cable from the observation point over its pulley"""
    limits: FloatArray | None = None
    """(m, 2) least and greatest length [mm]"""
    cables: FloatArray | None = None
    """(m, columns) the cables of a rig (`kernels.layout`), None where the links are rods"""

    @property
    def wrapped(self) -> FloatArray | None:
        """The cables of a rig some of whose pulleys have a radius, else None: then every link is straight from point to point."""
        return self.cables if self.cables is not None and (self.cables[:, RADIUS] > 0.0).any() else None

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
        raise FileFormatError(
            message("error.has_a_pose_needs", where=path, m=m, value="link" if m == 1 else "links", links=LINKS, most_links=MOST_LINKS)
        )
    return found


def _of_file(data: dict[str, Any], path: Path) -> Linkage:
    table = checked(data, StructureFile, str(path))
    ends: dict[str, list[tuple[float, float, float]]] = {"base": [], "platform": []}
    for i, link in enumerate(table.link, 1):
        for side, name, points in (("base", link.from_point, table.base), ("platform", link.to_point, table.platform)):
            if name not in points:
                raise FileFormatError(message("error.link_the_has_no", where=path, i=i, side=side, name=name, points=", ".join(points)))
            ends[side].append(points[name])
    return Linkage(
        np.array(ends["base"]),
        np.array(ends["platform"]),
        [(f"link {i}", link.from_point, link.to_point) for i, link in enumerate(table.link, 1)],
        _all_or_none([link.length_mm for link in table.link], "length_mm", path),
        _all_or_none([link.limits_mm for link in table.link], "limits_mm", path),
    )


def _all_or_none(values: Sequence[Any], key: str, path: Path) -> FloatArray | None:
    if all(value is None for value in values):
        return None
    if any(value is None for value in values):
        raise FileFormatError(message("error.link_is_missing_all", where=path, index=values.index(None) + 1, key=key))
    return np.array(values, dtype=np.float64)
