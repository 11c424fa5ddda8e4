"""The skin of an accuracy zone as a closed mesh."""

from typing import TYPE_CHECKING

import numpy as np

from lmeasure.core import FloatArray, IntArray

if TYPE_CHECKING:
    import xarray as xr


def zone_surface(zone: "xr.Dataset") -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) [mm, base frame] and triangles (m, 3) of the zone's skin, their corners counter-clockwise seen from outside.

    One vertex in each cell of the grid that has nodes on both sides, in the mean of the places where its edges leave the zone: where the
    pressure angle passes its limit, else half-way between the nodes (surface nets; Gibson, MERL TR99-24, 1999). The zone ends at the
    scanned box, so the mesh is closed. Empty for an empty zone.
    """
    inside = np.pad(zone["in_zone"].transpose("x", "y", "z").to_numpy() == 1, 1)
    angle = np.pad(zone["worst_pressure_angle_deg"].transpose("x", "y", "z").to_numpy().astype(np.float64), 1, constant_values=np.nan)
    left = float(zone.attrs["limit_deg"]) - angle
    # nodes that another limit keeps out do not tell where the edge passes; the layer around the box stands on its face
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
