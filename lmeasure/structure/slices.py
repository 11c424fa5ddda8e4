"""The boundary of the workspace, slice by slice, each followed, closed or open (thesis 5.3)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmeasure.core import BoolArray, FloatArray, StructureError
from lmeasure.kernels import COUNT_LENGTH
from lmeasure.linkages import Boundary, Bounds, Slice, boundary, first_met
from lmeasure.structure.links import Linkage
from lmeasure.structure.measures import lines_of
from lmeasure.text import Message, composed, message

PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}  # Both directions of a plane, and that of its levels
RAYS = 72  # directions of the search for the boundary
SAME = 2e-3  # of the reach: a ray that meets a limit so near to a followed boundary meets that one, whose corners may be cut by less
ALONG = 48  # places of a straight line at which it is seen whether it keeps the limits
POINTS = 200  # steps across the window
SEEDS = 15  # places in each direction at which a level is looked at for one that keeps the limits


@dataclass(frozen=True)
class Piece:
    """A boundary at a level [mm]: places (n, 3) in the base frame, the limit met at each, whether it is closed, its area, the largest
    distance of straight lines between the places from it, and whether it encloses a hole in the workspace."""

    level_mm: float
    places: FloatArray
    limits: tuple[str, ...]
    closed: bool
    area_mm2: float | None
    off_mm: float
    hole: bool = False

    def line(self, axis: str) -> str:
        """One line for a person."""
        code = "open" if self.area_mm2 is None else "hole" if self.hole else "closed"
        met = tuple(dict.fromkeys(map(one_limit, self.limits)))
        level = composed("{axis} = {mm:g} {unit}", axis=axis, mm=self.level_mm, unit=message("unit_sign.mm"))
        return message(f"structure.boundary_{code}", level=level, area=self.area_mm2, met=met)

    def as_dict(self) -> dict[str, Any]:
        return {
            "level_mm": self.level_mm,
            "closed": self.closed,
            "hole": self.hole,
            "area_mm2": self.area_mm2,
            "lines_off_mm": self.off_mm,
            "places_mm": self.places.tolist(),
            "limits": list(self.limits),
        }


def bounds_of(
    linkage: Linkage, pose: FloatArray, limit_deg: float | None, lengths_mm: tuple[float, float] | None, *, turns: FloatArray | None = None
) -> Bounds:
    """Return the limits that links keep, in the assembly of a pose (7,): cables with their pulleys, more than six weighted by their counts
    as in a run. lengths_mm: in place of the links' own limits.

    StructureError if they do not fix the platform at the pose, or for more than six without any limit that has a boundary.
    """
    limit = None if limit_deg is None or limit_deg >= 90.0 else float(np.radians(limit_deg))
    lines = None if linkage.wrapped is None and linkage.rods is None else lines_of(linkage)
    kept = linkage.limits.T if lengths_mm is None and linkage.limits is not None else lengths_mm
    weights = None if linkage.cables is None else (linkage.cables[:, COUNT_LENGTH].min() / linkage.cables[:, COUNT_LENGTH]) ** 2
    called = [name for name, _, _ in linkage.names]
    return Bounds(
        linkage.base, linkage.platform, pose, limit, kept, lines=lines, turns=turns, weights=weights, called=called,
        further=linkage.further,
    )  # fmt: skip


def slices(bounds: Bounds, pose: FloatArray, plane: str, levels: Sequence[float], *, reach_mm: float) -> tuple[list[Piece], list[str]]:
    """The boundary of the workspace that holds a pose (7,), in slices of a plane (`xy`, `xz`, `yz`) at levels of the third axis [mm], in a
    window of reach_mm to either side of the pose; and messages about levels without one.

    At each level it is the boundary around the place nearest to the pose's own that can be reached from the pose within the limits. It may
    be several pieces: arms that leave the window, and holes. Pieces that no ray from that place meets, behind others, are not looked for.
    """
    a, b, axis = PLANES[plane]
    across = np.eye(3)[[a, b]]
    reached = _Reached(bounds, Slice(np.asarray(pose, dtype=np.float64), across, reach_mm), axis)
    pieces: list[Piece] = []
    said: list[str] = []
    for level in levels:
        seed = reached.at(float(level))
        name = composed("{axis} = {mm:g} {unit}", axis="xyz"[axis], mm=level, unit=message("unit_sign.mm"))
        if seed is None:
            said.append(message("structure.boundary_no_place_window", level=name))
            continue
        found, failed = followed(bounds, Slice(seed, across, reach_mm), level)
        said += [composed("{name}: {error}", name=name, error=error) for error in failed]
        if not (found or failed):
            said.append(message("structure.boundary_none_within_mm", level=name, mm=reach_mm))
        pieces += found
    return pieces, said


def one_limit(limit: str) -> str:
    """Return a limit without the orientation in which it is met."""
    return limit.values["name"] if isinstance(limit, Message) and limit.code == "linkages.orientation" else limit


def followed(bounds: Bounds, plane: Slice, level: float) -> tuple[list[Piece], list[str]]:
    """Every boundary that rays from the slice's origin meet within the window, its places in the base frame, and why others could not be
    followed, each reason once."""
    turns = 2.0 * np.pi * (np.arange(RAYS) + 0.37) / RAYS
    rays = np.column_stack([np.cos(turns), np.sin(turns)])
    met = first_met(bounds, plane, rays)
    hits = met[:, None] * rays
    found: dict[int, Boundary] = {}
    failed: dict[int, str] = {}
    for i in (int(i) for i in np.argsort(met) if np.isfinite(met[i])):
        if _known(hits[i], found.values(), plane.reach_mm):
            continue
        try:
            # a boundary much smaller than the window is followed in steps of its own size
            step = min(2.0 * plane.reach_mm / POINTS, 0.2 * float(met[i]) + 1e-4 * plane.reach_mm)
            found[i] = boundary(bounds, plane, rays[i], step)
        except StructureError as error:
            failed[i] = str(error)
    # another ray may have followed a boundary that this one missed in a gap narrower than its step
    own = [one for i, one in found.items() if not any(other.crosses(hits[i]) for j, other in found.items() if j != i)]
    left = dict.fromkeys(why for i, why in failed.items() if not _known(hits[i], own, plane.reach_mm))
    return [_piece(bounds, plane, one, level) for one in own], list(left)


def _known(place: FloatArray, found: Iterable[Boundary], reach_mm: float) -> bool:
    """Return whether the meeting of a ray with a limit lies on or behind known boundaries."""
    return any(one.distance_mm(place) < SAME * reach_mm or one.crosses(place) for one in found)


def _piece(bounds: Bounds, plane: Slice, found: Boundary, level: float) -> Piece:
    met = tuple(bounds.names[int(i)] for i in found.limit)
    hole = found.closed and not found.surrounds_origin
    return Piece(float(level), plane.poses(found.places)[:, :3], met, found.closed, found.area_mm2, found.off_mm, hole)


class _Reached:
    """Places of a grid that one straight line, or several one after the other, reach from a pose within the limits. Cells separated by an
    even number of singular sheets have the same sign of the determinant, so the sign alone does not decide whether a place is in the
    workspace."""

    def __init__(self, bounds: Bounds, plane: Slice, axis: int) -> None:
        """plane: the slice of the pose; axis: that of the levels."""
        self._bounds, self._plane, self._axis = bounds, plane, axis
        steps = np.linspace(-1.0, 1.0, SEEDS) * plane.reach_mm
        grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        self._grid = grid[np.argsort(np.linalg.norm(grid, axis=1), kind="stable")]
        self._apart = float(steps[1] - steps[0])

    def at(self, level: float) -> FloatArray | None:
        """The pose (7,) at a level that is nearest to the pose's own place there; None where none is reached."""
        start = self._plane.origin[:3]
        ends = self._places(level)
        direct = self._clear(np.broadcast_to(start, ends.shape), ends)
        if not direct.any():
            rise = level - float(start[self._axis])
            levels = start[self._axis] + rise * np.arange(0, n := int(np.ceil(abs(rise) / self._apart)) + 1) / max(n - 1, 1)
            direct = self._flooded(levels)
        chosen = np.flatnonzero(direct)
        return None if not len(chosen) else self._pose(ends[chosen[0]])

    def _places(self, level: float) -> FloatArray:
        out = np.asarray(self._plane.origin[:3] + self._grid @ self._plane.across)
        out[:, self._axis] = level
        return out

    def _pose(self, place: FloatArray) -> FloatArray:
        return np.r_[place, self._plane.origin[3:]]

    def _clear(self, begin: FloatArray, end: FloatArray) -> BoolArray:
        """(n,) whether the straight lines from places (n, 3) to others keep the limits."""
        part = np.arange(ALONG + 1)[:, None] / ALONG
        places = begin[:, None] + part * (end - begin)[:, None]
        poses = np.concatenate([places, np.broadcast_to(self._plane.origin[3:], (*places.shape[:2], 4))], axis=2)
        with np.errstate(invalid="ignore"):
            return np.asarray(self._bounds.inside(poses).all(axis=1))

    def _flooded(self, levels: FloatArray) -> BoolArray:
        """(n,) whether the last of the levels' places is reached from the pose, from neighbour to neighbour through all levels."""
        places = np.stack([self._places(level) for level in levels])
        count = len(self._grid)
        index = np.rint(self._grid / self._apart).astype(np.int64)
        where = {(int(i), int(j)): k for k, (i, j) in enumerate(index)}
        beside = [[where.get((int(i) + di, int(j) + dj)) for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1))] for i, j in index]
        reached = np.zeros((len(levels), count), dtype=bool)
        front = [(0, 0)]
        reached[0, 0] = True  # the grid's middle is the pose's own place
        while front:
            pairs = [((k, n), (k, m)) for k, n in front for m in beside[n] if m is not None]
            pairs += [((k, n), (k + s, n)) for k, n in front for s in (-1, 1) if 0 <= k + s < len(levels)]
            pairs = [(a, b) for a, b in pairs if not reached[b]]
            if not pairs:
                break
            clear = self._clear(np.array([places[a] for a, _ in pairs]), np.array([places[b] for _, b in pairs]))
            front = list({b for (_, b), good in zip(pairs, clear, strict=True) if good})
            for b in front:
                reached[b] = True
        return reached[-1]


def window_mm(linkage: Linkage, pose: FloatArray) -> float:
    """Return how far a window reaches by default: the size of the rig with the platform at the pose [mm]."""
    points = np.vstack([linkage.base, pose[None, :3], linkage.platform + pose[:3]])
    return float(np.ptp(points, axis=0).max())
