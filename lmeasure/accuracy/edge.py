"""The edge of an accuracy zone by following it, level by level: exact where a grid of nodes has steps (thesis 5.3)."""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from lmeasure.core import AccuracyError, BoolArray, StructureError
from lmeasure.linkages import Slice
from lmeasure.rig import CABLES_FOR_A_POSE, Rig
from lmeasure.structure import Piece, bounds_of, followed, linkage_of
from lmeasure.text import message

if TYPE_CHECKING:
    import xarray as xr

LEVELS = 60  # of a zone that are followed


def edges(
    rig: Rig, zone: "xr.Dataset", rotations: Rotation, lengths_mm: tuple[float, float] | None = None
) -> tuple[list[Piece], list[str]]:
    """The edge of every part of a scanned zone at every level, in the plane XY, with the holes in it, and messages about those without one.

    Of the angle and of the lengths' limits, in all the orientations it was scanned with; other limits asked for cut the zone further. Parts
    come from the grid. A part whose edge leaves the scanned box is open. AccuracyError unless the rig
    has six cables or more and the levels are few enough.
    """
    if rig.sensors:
        raise AccuracyError(f"--boundary: the edge is followed by cables alone, and rig {rig.name!r} has encoders beside them")
    if len(rig.cable) < CABLES_FOR_A_POSE:
        raise AccuracyError(f"--boundary: the edge of the zone is followed for six cables and more, this rig has {len(rig.cable)}")
    if len(zone["z"]) > LEVELS:
        raise AccuracyError(f"--boundary: {len(zone['z'])} levels; at most {LEVELS} are followed")
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
    labels, count = ndimage.label(nodes)
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
