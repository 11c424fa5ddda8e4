"""The boundary of the workspace, slice by slice, each followed and said to be closed or open (thesis 5.3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.errors import StructureError
from lmeasure.kernels.layout import COUNT_LENGTH
from lmeasure.lcoordinate.bounds import Bounds
from lmeasure.lcoordinate.workspace import Boundary, Slice, boundary, first_met
from lmeasure.linkage.links import Linkage
from lmeasure.linkage.measures import lines_of

PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}
"""Both directions of a plane, and that of its levels."""
RAYS = 24  # directions in which the boundary is looked for
POINTS = 200  # steps across the window
SEEDS = 15  # places in each direction at which a level is looked at for one that keeps the limits


@dataclass(frozen=True)
class Piece:
    """A boundary at a level [mm]: places (n, 3) in the base frame, the limit met at each, whether it is closed, its area, and how far
    straight lines between the places are beside it at most."""

    level_mm: float
    places: FloatArray
    limits: tuple[str, ...]
    closed: bool
    area_mm2: float | None
    off_mm: float

    def line(self, axis: str) -> str:
        """One line for a person."""
        met = ", ".join(dict.fromkeys(limit.split(" in orientation")[0] for limit in self.limits))
        size = f"closed, {self.area_mm2:.6g} mm^2" if self.area_mm2 is not None else "open: it leaves the window"
        return f"boundary at {axis} = {self.level_mm:g} mm: {size}; met: {met}"

    def as_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "level_mm": self.level_mm,
            "closed": self.closed,
            "area_mm2": self.area_mm2,
            "lines_off_mm": self.off_mm,
            "places_mm": self.places.tolist(),
            "limits": list(self.limits),
        }


def bounds_of(
    linkage: Linkage, pose: FloatArray, limit_deg: float | None, lengths_mm: tuple[float, float] | None, *, turns: FloatArray | None = None
) -> Bounds:
    """Limits that links keep, in the assembly of a pose (7,): cables as they run over their pulleys, more than six weighed by their counts
    as in a run.

    StructureError where they do not hold the platform at the pose, or more than six are asked for nothing that has a boundary.
    """
    limit = None if limit_deg is None or limit_deg >= 90.0 else float(np.radians(limit_deg))
    lines = None if linkage.wrapped is None else lines_of(linkage)
    weights = None if linkage.cables is None else (linkage.cables[:, COUNT_LENGTH].min() / linkage.cables[:, COUNT_LENGTH]) ** 2
    called = [name for name, _, _ in linkage.names]
    return Bounds(linkage.base, linkage.platform, pose, limit, lengths_mm, lines=lines, turns=turns, weights=weights, called=called)


def slices(bounds: Bounds, pose: FloatArray, plane: str, levels: Sequence[float], *, reach_mm: float) -> tuple[list[Piece], list[str]]:
    """The boundary around a pose (7,) in slices of a plane (`xy`, `xz`, `yz`) at levels of the third axis [mm], in a window of reach_mm to
    either side of the pose; and what there is to say of levels without one.

    At each level it is that around the pose's own place there, or, where that does not keep the limits, around the place nearest to it of
    a grid over the window that does.
    """
    a, b, axis = PLANES[plane]
    across = np.eye(3)[[a, b]]
    pieces, said = [], []
    for level in levels:
        origin = np.array(pose, dtype=np.float64)
        origin[axis] = level
        seed = _seed(bounds, Slice(origin, across, reach_mm))
        name = f"{'xyz'[axis]} = {level:g} mm"
        if seed is None:
            said.append(f"boundary at {name}: no place of the window keeps the limits")
            continue
        try:
            found = followed(bounds, Slice(seed, across, reach_mm), level)
        except StructureError as error:
            said.append(f"{name}: {error}")
            continue
        if found is None:
            said.append(f"boundary at {name}: none within {reach_mm:g} mm")
            continue
        pieces.append(found)
    return pieces, said


def followed(bounds: Bounds, plane: Slice, level: float) -> Piece | None:
    """The boundary around the slice's origin, its places in the base frame; None where there is none within the window. StructureError
    where it cannot be followed."""
    found = _around(bounds, plane)
    if found is None:
        return None
    met = tuple(bounds.names[int(i)] for i in found.limit)
    return Piece(float(level), plane.poses(found.places)[:, :3], met, found.closed, found.area_mm2, found.off_mm)


def _seed(bounds: Bounds, plane: Slice) -> FloatArray | None:
    """A pose (7,) of the slice that keeps the limits, its origin or the one of a grid that is nearest to it; None for none."""
    steps = np.linspace(-1.0, 1.0, SEEDS) * plane.reach_mm
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[np.argsort(np.linalg.norm(grid, axis=1), kind="stable")]
    poses = plane.poses(np.vstack([[0.0, 0.0], grid]))
    with np.errstate(invalid="ignore"):
        good = np.flatnonzero(bounds.inside(poses))
    return poses[good[0]] if len(good) else None


def _around(bounds: Bounds, plane: Slice) -> Boundary | None:
    """The boundary around the slice's origin, as the ray that meets it first finds it; None where no ray meets one within the window."""
    turns = 2.0 * np.pi * (np.arange(RAYS) + 0.37) / RAYS
    rays = np.column_stack([np.cos(turns), np.sin(turns)])
    met = first_met(bounds, plane, rays)
    failed: StructureError | None = None
    for i in np.argsort(met):
        if not np.isfinite(met[i]):
            break
        try:
            # a boundary much smaller than the window is followed in steps of its own size
            step = min(2.0 * plane.reach_mm / POINTS, 0.2 * float(met[i]) + 1e-4 * plane.reach_mm)
            return boundary(bounds, plane, rays[i], step)
        except StructureError as error:
            failed = failed or error
    if failed is not None:
        raise failed
    return None


def window_mm(linkage: Linkage, pose: FloatArray) -> float:
    """How far a window reaches by default: the size of the rig with the platform at the pose [mm]."""
    points = np.vstack([linkage.base, pose[None, :3], linkage.platform + pose[:3]])
    return float(np.ptp(points, axis=0).max())
