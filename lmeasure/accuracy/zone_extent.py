"""Extent of a zone, its skin and its edge: volume with the grid's error, largest box and ball, test cube of ISO 9283, a closed mesh,
and the edge followed level by level, exact where a grid of nodes has steps (thesis 5.3)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.core import AccuracyError, BoolArray, FloatArray, IntArray, StructureError
from lmeasure.linkages import Slice
from lmeasure.rig import CABLES_FOR_A_POSE, Rig
from lmeasure.structure import Piece, bounds_of, followed, linkage_of
from lmeasure.text import message

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Extent:
    """Figures of a zone [mm, base frame]; None where nothing fits.

    volume_mm3 with volume_error_mm3 (half the cells that a grid line to a neighbour leaves the zone from: the edge lies somewhere within
    them); box: low and high corner of the largest box of nodes; ball: centre and radius; cube: centre and edge of the largest cube;
    cube_points: for P1 to P5 of ISO 9283 in that cube their position and the worst figures of the node nearest to it.
    """

    volume_mm3: float
    volume_error_mm3: float
    box: tuple[FloatArray, FloatArray] | None
    ball: tuple[FloatArray, float] | None
    cube: tuple[FloatArray, float] | None
    cube_points: tuple[dict[str, Any], ...]


def extent(zone: "xr.Dataset") -> Extent:
    """The figures of a scanned zone. A box lies in the zone when all its nodes do; a ball when it ends a step before any other node."""
    inside = zone["in_zone"].values.astype(bool)
    axes = [zone[name].values for name in "xyz"]
    spacing = np.array(zone.attrs["node_spacing_mm"], dtype=np.float64)
    cell = float(np.prod(spacing))
    edge = inside & ~scipy.ndimage.binary_erosion(inside, border_value=1)
    box = _largest_box(inside, spacing, cube=False)
    cube = _largest_box(inside, spacing, cube=True)
    volume = float(inside.sum() * cell), 0.5 * float(edge.sum()) * cell
    fits = None if box is None else (_at(axes, box[0]), _at(axes, box[1])), _largest_ball(inside, axes, spacing)
    test = None if cube is None else _cube(axes, cube)
    return Extent(*volume, *fits, test, () if test is None else _iso_points(zone, *test))


def _at(axes: list[FloatArray], index: IntArray) -> FloatArray:
    return np.array([a[i] for a, i in zip(axes, index, strict=True)])


def _cube(axes: list[FloatArray], corners: tuple[IntArray, IntArray]) -> tuple[FloatArray, float]:
    low, high = _at(axes, corners[0]), _at(axes, corners[1])
    return 0.5 * (low + high), float((high - low).min())


def _largest_ball(inside: BoolArray, axes: list[FloatArray], spacing: FloatArray) -> tuple[FloatArray, float] | None:
    """Centre and radius of the largest ball about a node that holds no node outside the zone and stays within the scanned box."""
    if not inside.any() or not (spacing > 0).all():
        return None
    # nodes that were not scanned are outside the zone: one layer around the box
    distance = scipy.ndimage.distance_transform_edt(np.pad(inside, 1), sampling=spacing)[1:-1, 1:-1, 1:-1] - 0.0
    best = np.unravel_index(int(np.argmax(distance)), inside.shape)
    centre = _at(axes, np.array(best))
    # the nearest bad node may lie a whole step away from the edge; a good radius ends one step before it
    radius = float(distance[best] - spacing.max())
    return (centre, radius) if radius > 0.0 else None


def _largest_box(inside: BoolArray, spacing: FloatArray, cube: bool) -> tuple[IntArray, IntArray] | None:
    """Index corners of the box of nodes, all in the zone, with the largest volume (or the largest cube)."""
    if min(inside.shape) < 2 or not inside.any():
        return None
    counts = np.zeros(np.array(inside.shape) + 1, dtype=np.int64)
    counts[1:, 1:, 1:] = inside.cumsum(0).cumsum(1).cumsum(2)
    best: tuple[IntArray, IntArray] | None = None
    largest = 0.0
    for steps in _sizes(inside.shape, spacing, cube):
        volume = float(np.prod(np.array(steps) * spacing))
        if volume <= largest:
            continue
        i, j, k = (s + 1 for s in steps)
        total = (
            counts[i:, j:, k:] - counts[:-i, j:, k:] - counts[i:, :-j, k:] - counts[i:, j:, :-k]
            + counts[:-i, :-j, k:] + counts[:-i, j:, :-k] + counts[i:, :-j, :-k] - counts[:-i, :-j, :-k]
        )  # fmt: skip
        found = np.argwhere(total == i * j * k)
        if len(found):
            middle = found[np.argmin(((found - found.mean(axis=0)) ** 2).sum(axis=1))]
            best, largest = (middle, middle + np.array(steps)), volume
    return best


def _sizes(shape: tuple[int, ...], spacing: FloatArray, cube: bool) -> list[tuple[int, ...]]:
    """Box sizes in steps, largest volume first."""
    if cube:
        edge = np.arange(1, max(shape)) * spacing.max()
        steps = np.floor(edge[:, None] / spacing + 1e-9).astype(int)
        return [tuple(int(v) for v in s) for s in steps[::-1] if (s < np.array(shape)).all() and np.ptp(s * spacing) < 1e-6 * spacing.max()]
    grid = np.stack(np.meshgrid(*(np.arange(1, n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    return [tuple(int(v) for v in grid[i]) for i in np.argsort(-np.prod(grid * spacing, axis=1))]


def _iso_points(zone: "xr.Dataset", centre: FloatArray, edge: float) -> tuple[dict[str, Any], ...]:
    """P1 to P5 of ISO 9283:1998 6.8: on the plane C1-C2-C7-C8, P1 in the middle, the others 10 % of a diagonal from its ends."""
    half = 0.4 * edge
    # the plane holds the lower edge towards +X and the upper one towards -X
    offsets = [(0, 0, 0), (1, 1, -1), (-1, 1, 1), (-1, -1, 1), (1, -1, -1)]
    out = []
    for name, offset in zip(("P1", "P2", "P3", "P4", "P5"), offsets, strict=True):
        at = centre + half * np.array(offset, dtype=np.float64)
        node = zone.sel(x=at[0], y=at[1], z=at[2], method="nearest")
        figures = {str(key): float(node[key]) for key in FIGURES if key in node}
        out.append({"name": name, "position_mm": [float(v) for v in at]} | figures)
    return tuple(out)


FIGURES = ("worst_pressure_angle_deg", "u95_position_mm", "u95_rotation_deg", "u95_attachment_mm")


def zone_surface(zone: "xr.Dataset") -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) [mm, base frame] and triangles (m, 3) of the zone's skin, their corners counter-clockwise seen from outside.

    One vertex in each cell of the grid that has nodes on both sides, in the mean of the places where its edges leave the zone: where the
    pressure angle passes its limit, else half-way between the nodes (surface nets; Gibson, MERL TR99-24, 1999). The zone ends at the
    scanned box, so the mesh is closed. Empty for an empty zone.
    """
    inside = np.pad(zone["in_zone"].transpose("x", "y", "z").to_numpy() == 1, 1)
    angle = np.pad(zone["worst_pressure_angle_deg"].transpose("x", "y", "z").to_numpy().astype(np.float64), 1, constant_values=np.nan)
    left = float(zone.attrs["limit_deg"]) - angle
    # nodes excluded by another limit do not show the edge; the layer around the box is on its face
    left = np.where(inside == (left >= 0.0), left, np.nan)
    axes = [np.pad(zone[name].to_numpy().astype(np.float64), 1, mode="edge") for name in "xyz"]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    cells = tuple(n - 1 for n in inside.shape)
    total, times, quads = np.zeros((np.prod(cells), 3)), np.zeros(np.prod(cells), np.int64), [np.empty((0, 4), np.int64)]
    for axis in range(3):
        here = tuple(slice(None, -1) if d == axis else slice(None) for d in range(3))
        next_ = tuple(slice(1, None) if d == axis else slice(None) for d in range(3))
        edges = np.argwhere(inside[here] != inside[next_])
        first, second = tuple(edges.T), tuple((edges + np.eye(3, dtype=np.int64)[axis]).T)
        part = left[first] / (left[first] - left[second])
        place = nodes[first] + np.where(np.isfinite(part), part, 0.5)[:, None] * (nodes[second] - nodes[first])
        # the four cells around the edge, in turn about it
        b, c = (axis + 1) % 3, (axis + 2) % 3
        around = np.stack([edges - np.eye(3, dtype=np.int64)[b] * i - np.eye(3, dtype=np.int64)[c] * j for i, j in _AROUND], axis=1)
        corners = np.ravel_multi_index(tuple(np.moveaxis(around, -1, 0)), cells)
        for k in range(4):
            np.add.at(total, corners[:, k], place)
            np.add.at(times, corners[:, k], 1)
        quads.append(np.where(inside[first][:, None], corners, corners[:, ::-1]))
    used = np.flatnonzero(times)
    number = np.zeros(len(times), np.int64)
    number[used] = np.arange(len(used))
    quad = number[np.concatenate(quads)]
    return total[used] / times[used, None], np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


_AROUND = ((1, 1), (0, 1), (0, 0), (1, 0))
LEVELS = 60  # of a zone that are followed


def edges(
    rig: Rig, zone: "xr.Dataset", rotations: Rotation, lengths_mm: tuple[float, float] | None = None
) -> tuple[list[Piece], list[str]]:
    """Return the edge of every part of a scanned zone at every level, in the plane XY, with the holes in it, and messages about those
    without one.

    Levels are of the angle and of the lengths' limits, in all scanned orientations; other limits cut the zone further. Parts come from the
    grid. A part whose edge leaves the scanned box is open. AccuracyError unless the rig has six cables or more and the levels are few
    enough.
    """
    if rig.sensors:
        raise AccuracyError(message("error.boundary_the_edge_is", name=rig.name))
    if len(rig.cable) < CABLES_FOR_A_POSE:
        raise AccuracyError(message("error.boundary_the_edge_of", n_cable=len(rig.cable)))
    if len(zone["z"]) > LEVELS:
        raise AccuracyError(message("error.boundary_levels_at_most", n_zone=len(zone["z"]), levels=LEVELS))
    linkage = linkage_of(rig)
    x, y, z = (zone[name].values for name in "xyz")
    limit, inside = float(zone.attrs["limit_deg"]), zone["in_zone"].values.astype(bool)
    turns = np.atleast_2d(rotations.as_quat())
    pieces: list[Piece] = []
    said: list[str] = []
    for k, level in enumerate(z):
        for nodes in _parts(inside[:, :, k]):
            margin = np.where(nodes, limit - zone["worst_pressure_angle_deg"].values[:, :, k], -np.inf)
            i, j = np.unravel_index(int(np.argmax(margin)), margin.shape)
            seed = np.array([x[i], y[j], level, 0.0, 0.0, 0.0, 1.0])
            low, high = np.array([x[0], y[0]]) - seed[:2], np.array([x[-1], y[-1]]) - seed[:2]
            plane = Slice(seed, np.eye(3)[:2], float(max(np.abs(low).max(), np.abs(high).max())))
            try:
                bounds = bounds_of(linkage, np.array([*seed[:3], *turns[0]]), limit, lengths_mm, turns=turns)
            except StructureError as error:
                said.append(message("edge.error", level=level, error=error))
                continue
            found, failed = followed(bounds, plane, level)
            said += [message("edge.error", level=level, error=error) for error in failed]
            if not (found or failed):
                said.append(message("edge.none", level=level))
            pieces += found
    return pieces, said


def _parts(nodes: BoolArray) -> list[BoolArray]:
    """The connected parts of the nodes of a level."""
    labels, count = scipy.ndimage.label(nodes)
    return [labels == i + 1 for i in range(count)]


def columns(pieces: list[Piece]) -> dict[str, Any]:
    """Columns of a table over all places of all edges."""
    places = np.concatenate([p.places for p in pieces] or [np.empty((0, 3))])
    return {
        "part": np.array([i + 1 for i, p in enumerate(pieces) for _ in p.places], dtype=np.int64),
        "closed": np.array([int(p.closed) for p in pieces for _ in p.places], dtype=np.int64),
        **{f"{axis}_mm": places[:, i] for i, axis in enumerate("xyz")},
        "limit": [limit for p in pieces for limit in p.limits],
    }
