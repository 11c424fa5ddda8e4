"""The zone's volume from a coarse grid: only the cells along its edge are looked at more closely."""

from collections.abc import Callable

import numpy as np

from lmeasure.core import BoolArray, FloatArray

MOST_PARTS = 16
POINTS_AT_ONCE = 400_000


def refined_volume(inside: BoolArray, axes: list[FloatArray], ask: Callable[[FloatArray], BoolArray], tolerance: float) -> dict[str, float]:
    """Volume of the zone within the box of the nodes, and how much the last refinement changed it.

    inside (nx, ny, nz): nodes in the zone; axes: their coordinates [mm]; ask: whether (n, 3) places are in the zone. A cell of eight nodes
    counts whole or not at all when all its nodes and those of its neighbours agree; the others are cut into 2, 4, 8 and 16 parts a side,
    each judged by its middle, until the volume changes by less than the tolerance (relative). Returns the attributes
    refined_volume_mm3, refined_volume_change_mm3 (the last change), refined_parts (parts a side).
    """
    steps = [np.diff(a) for a in axes]
    if any(len(s) == 0 for s in steps):
        return {"refined_volume_mm3": 0.0, "refined_volume_change_mm3": 0.0, "refined_parts": 1}
    corners = [inside[i : i + inside.shape[0] - 1, j : j + inside.shape[1] - 1, k : k + inside.shape[2] - 1]
               for i in (0, 1) for j in (0, 1) for k in (0, 1)]  # fmt: skip
    some, every = np.any(corners, axis=0), np.all(corners, axis=0)
    # a neighbour's edge may bulge into a cell whose own nodes agree
    mixed = _spread(some & ~every) | (_spread(some) & ~some)
    cell = steps[0][:, None, None] * steps[1][None, :, None] * steps[2][None, None, :]
    whole = float(cell[every & ~mixed].sum())
    cut = np.argwhere(mixed)
    low = np.column_stack([axes[d][cut[:, d]] for d in range(3)])
    size = np.column_stack([steps[d][cut[:, d]] for d in range(3)])
    volume = whole + float((cell * np.mean(corners, axis=0))[mixed].sum())
    change, parts = abs(volume), 1
    while parts < MOST_PARTS and change > tolerance * max(volume, 1e-300):
        parts *= 2
        finer = whole + _judged(low, size, parts, ask)
        change, volume = abs(finer - volume), finer
    return {"refined_volume_mm3": volume, "refined_volume_change_mm3": change, "refined_parts": parts}


def _spread(mask: BoolArray) -> BoolArray:
    """The mask and its six neighbours."""
    out = mask.copy()
    for axis in range(3):
        first, last = [slice(None)] * 3, [slice(None)] * 3
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        out[tuple(first)] |= mask[tuple(last)]
        out[tuple(last)] |= mask[tuple(first)]
    return out


def _judged(low: FloatArray, size: FloatArray, parts: int, ask: Callable[[FloatArray], BoolArray]) -> float:
    """Volume of the parts whose middle is in the zone."""
    middle = (np.arange(parts) + 0.5) / parts
    fraction = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    total = 0.0
    stride = max(1, POINTS_AT_ONCE // len(fraction))
    for first in range(0, len(low), stride):
        at, extent = low[first : first + stride], size[first : first + stride]
        points = (at[:, None] + fraction[None] * extent[:, None]).reshape(-1, 3)
        hits = ask(points).reshape(len(at), -1).mean(axis=1)
        total += float((hits * extent.prod(axis=1)).sum())
    return total
