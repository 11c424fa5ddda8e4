"""Links as a noun of the pipeline: what is known of them, and the boundary of their workspace, to be shown and drawn."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lmeasure.core import DataFrame, FloatArray, Shown, framed
from lmeasure.structure.links import Linkage
from lmeasure.structure.record import Workspace, described
from lmeasure.structure.text import described_lines


@dataclass(frozen=True, repr=False)
class Boundary(Shown):
    """Slices of the boundary of a workspace, as `lmeasure structure --boundary` writes them; pose (7,) around which they lie."""

    content: dict[str, Any]
    pose: FloatArray

    def about(self) -> dict[str, str]:
        """Plane, slices, and what is to be said of levels without one."""
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
        """The boundary of the workspace, where it was asked for."""
        found = self.record.get("boundary")
        return None if found is None or self.pose is None else Boundary(found, self.pose)


def structure_of(
    linkage: Linkage,
    pose: FloatArray | None = None,
    *,
    to: FloatArray | None = None,
    workspace: Workspace | None = None,
    design: bool = False,
) -> Described:
    """`described` as a noun."""
    at, there = (None if p is None else np.asarray(p, dtype=np.float64) for p in (pose, to))
    return Described(linkage, described(linkage, at, to=there, workspace=workspace, design=design), at)
