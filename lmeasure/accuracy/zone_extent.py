"""What fits into a zone: its volume with the grid's error, the largest box and ball, and the test cube of ISO 9283."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt

from lmeasure.core import BoolArray, FloatArray, IntArray

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
    edge = inside & ~binary_erosion(inside, border_value=1)
    box = _largest_box(inside, spacing, cube=False)
    cube = _largest_box(inside, spacing, cube=True)
    return Extent(
        float(inside.sum() * cell),
        0.5 * float(edge.sum()) * cell,
        None if box is None else (_at(axes, box[0]), _at(axes, box[1])),
        _largest_ball(inside, axes, spacing),
        None if cube is None else _cube(axes, cube),
        () if cube is None else _iso_points(zone, *_cube(axes, cube)),
    )


def _at(axes: list[FloatArray], index: IntArray) -> FloatArray:
    return np.array([a[i] for a, i in zip(axes, index, strict=True)])


def _cube(axes: list[FloatArray], corners: tuple[IntArray, IntArray]) -> tuple[FloatArray, float]:
    low, high = _at(axes, corners[0]), _at(axes, corners[1])
    return 0.5 * (low + high), float((high - low).min())


def _largest_ball(inside: BoolArray, axes: list[FloatArray], spacing: FloatArray) -> tuple[FloatArray, float] | None:
    """Centre and radius of the largest ball about a node that holds no node outside the zone and stays within the scanned box."""
    if not inside.any() or not (spacing > 0).all():
        return None
    # what was not scanned is not in the zone: one layer outside
    distance = distance_transform_edt(np.pad(inside, 1), sampling=spacing)[1:-1, 1:-1, 1:-1] - 0.0
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
