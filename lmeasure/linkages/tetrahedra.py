"""Assemblies of straight links in closed form, corner by corner of tetrahedra, of any number of sets of lengths at once (thesis 4.1).

The structure gives the order (`Structure.placements`): points of the platform are placed in the base's frame, points of the base in the
platform's, as soon as three distances are known. Placed points give the additional coordinates l7, l8 of the thesis. Each corner is on one
of two sides, which makes eight ways. The formulas are the same for real and for complex points: all products are bilinear.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import BoolArray, ComplexArray, FloatArray
from lmeasure.linkages import study_quadric
from lmeasure.linkages.topology import CLOSED_FORM_ASSEMBLIES, Incidence, incidence

Array = NDArray[Any]
FLAT = 1e-7
"""A tetrahedron whose squared height is above minus this part of its squared edges counts as flat: two assemblies have met. Lengths cannot
distinguish it from one that is not, since a height of 3e-4 of the edges changes them by less than 1e-7."""
CLOSES = 1e-9  # of the rig's size
PIECE = 2000  # sets of lengths at a time, so that their data stay in the cache


def closed_form(base: FloatArray, platform: FloatArray, lengths: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(..., 8, 7) poses base_from_platform for lengths (..., 6) [mm] of links from base (6, 3) to platform (6, 3), and (..., 8) which are
    assemblies; the others miss the lengths by least, corner by corner. Of a structure that tetrahedra do not solve, (..., 0, 7).
    """
    shape, lengths = lengths.shape[:-1], lengths.reshape(-1, 6)
    found = incidence(base, platform)
    if not found.structure.closed_form:
        return np.empty((*shape, 0, 7)), np.empty((*shape, 0), dtype=np.bool_)
    size = float(lengths.max(initial=0.0) + np.ptp(platform, axis=0).max())
    pieces = [_piece(found, base, platform, lengths[i : i + PIECE], size) for i in range(0, max(1, len(lengths)), PIECE)]
    poses, closes = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return poses.reshape(*shape, CLOSED_FORM_ASSEMBLIES, 7), closes.reshape(*shape, CLOSED_FORM_ASSEMBLIES)


def _piece(found: Incidence, base: FloatArray, platform: FloatArray, lengths: FloatArray, size: float) -> tuple[FloatArray, BoolArray]:
    """(n, 8, 7) poses for lengths (n, 6), and (n, 8) which are assemblies of a rig of this size [mm]."""
    at, of = base.mean(axis=0), platform.mean(axis=0)
    x, lowest = _solved(found, base - at, platform - of, lengths)
    poses = study_quadric.poses(x)
    poses[..., :3] += at - np.einsum("...ij,j->...i", study_quadric.turns(x), of)
    return poses, (lowest > -FLAT) & (_missed(poses, base, platform, lengths) < CLOSES * size)


def heights(base: FloatArray, platform: FloatArray, lengths: FloatArray) -> FloatArray:
    """(n, 8) of the assemblies in closed form of lengths (n, 6) the lowest squared height of a tetrahedron, as part of its squared edges:
    0 where two assemblies meet, negative where there is none."""
    at, of = base.mean(axis=0), platform.mean(axis=0)
    return _solved(incidence(base, platform), base - at, platform - of, lengths)[1]


def complex_points(found: Incidence, base: FloatArray, platform: FloatArray, lengths: FloatArray) -> ComplexArray:
    """(8, 8) Study coordinates of all assemblies, complex ones included, of one set of lengths (6,)."""
    x, _ = _solved(found, base.astype(np.complex128), platform.astype(np.complex128), lengths[None].astype(np.complex128))
    return np.asarray(x[0])


def _solved(found: Incidence, base: Array, platform: Array, lengths: Array) -> tuple[Array, FloatArray]:
    """(n, 8, 8) Study coordinates, and (n, 8) the lowest of the three squared heights as part of the squared edges."""
    links = [found.structure.links[i] for i in range(6)]
    order = list(found.order)
    own = {"P": {p: platform[order[i]] for i, (p, _) in enumerate(links)}, "B": {b: base[order[i]] for i, (_, b) in enumerate(links)}}
    measured = {link: lengths[:, order[i], None] for i, link in enumerate(links)}
    placed: dict[tuple[str, int], Array] = {}
    lowest = np.full((len(lengths), 1), np.inf)

    def there(point: tuple[str, int], side: str) -> Array:
        """A corner, in the frame in which points of that side are placed."""
        return placed[point] if point[0] == side else own[point[0]][point[1]]

    def distance(side: str, i: int, corner: tuple[str, int]) -> Array:
        if corner[0] == side:
            return _norm(own[side][i] - own[side][corner[1]])
        link = (i, corner[1]) if side == "P" else (corner[1], i)
        # a placed corner is in the frame of the requested point
        return measured[link] if link in measured else _norm(own[side][i] - placed[corner])

    for side, i, corners in found.structure.placements or ():
        spots = [np.broadcast_to(there(corner, side), (*lowest.shape, 3)) for corner in corners]
        up, down, height = _apex(spots, [distance(side, i, corner) for corner in corners])
        lowest = np.concatenate([np.minimum(lowest, height)] * 2, axis=1)
        placed = {point: np.concatenate([spot, spot], axis=1) for point, spot in placed.items()}
        placed[side, i] = np.concatenate([up, down], axis=1)
    three = list(placed)
    in_base = [placed[point] if point[0] == "P" else own["B"][point[1]] for point in three]
    in_platform = [placed[point] if point[0] == "B" else own["P"][point[1]] for point in three]
    in_base, in_platform = list(np.broadcast_arrays(*in_base)), list(np.broadcast_arrays(*in_platform))
    return _pose(in_base, in_platform), lowest


def _dot(u: Array, v: Array) -> Array:
    return np.asarray((u * v).sum(axis=-1))


def _norm(v: Array) -> Array:
    return np.asarray(np.sqrt(_dot(v, v)))


def _apex(corners: list[Array], r: list[Array]) -> tuple[Array, Array, FloatArray]:
    """Both apexes (n, k, 3) over three corners at the distances r from them, and the squared height (n, k) as part of the squared edges. A
    real height that would be imaginary is 0: the foot of the tetrahedron that misses least."""
    a, ab, ac = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    d, normal = _norm(ab), np.cross(ab, ac)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, z = ab / d[..., None], normal / _norm(normal)[..., None]
        y = np.cross(z, x)
        i, j = _dot(x, ac), _dot(y, ac)
        px = (r[0] ** 2 - r[1] ** 2 + d * d) / (2.0 * d)
        py = (r[0] ** 2 - r[2] ** 2 + i * i + j * j - 2.0 * i * px) / (2.0 * j)
        square = r[0] ** 2 - px * px - py * py
        part = np.real(square / (r[0] ** 2 + d * d))
    pz = np.sqrt(square if np.iscomplexobj(square) else np.maximum(square, 0.0))
    foot, rise = a + px[..., None] * x + py[..., None] * y, pz[..., None] * z
    return foot + rise, foot - rise, part


def _triad(points: list[Array]) -> Array:
    """(..., 3, 3) the axes of three points, in columns."""
    u, w = points[1] - points[0], points[2] - points[0]
    n = np.cross(u, w)
    x, z = u / _norm(u)[..., None], n / _norm(n)[..., None]
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _pose(in_base: list[Array], in_platform: list[Array]) -> Array:
    """(..., 8) Study coordinates of the pose at which three points, known in both frames, meet."""
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = _triad(in_base) @ _triad(in_platform).swapaxes(-1, -2)
    shift = sum(in_base) / 3.0 - np.einsum("...ij,...j->...i", turn, np.broadcast_to(sum(in_platform) / 3.0, (*turn.shape[:-2], 3)))
    return study_quadric.points_of(shift, turn)


def _missed(poses: FloatArray, base: FloatArray, platform: FloatArray, lengths: FloatArray) -> FloatArray:
    """(n, 8) by how much the lengths are missed at most; infinite where there is no pose."""
    away = poses[..., None, :3] + np.einsum("...ij,kj->...ki", study_quadric.turns(study_quadric.points(poses)), platform) - base
    missed = np.abs(np.linalg.norm(away, axis=-1) - lengths[:, None]).max(axis=-1)
    return np.nan_to_num(missed, nan=np.inf)
