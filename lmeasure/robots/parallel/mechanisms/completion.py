"""Poses of which only an element of the body is given, completed by links of known lengths (source 004, table 5).

Each kind leaves the freedom of a pair that would join the body to the base, and as many links between ball joints take it: a loop of
Assur's kind, whose assemblies are all found.

    given                                left   pair          links
    a point on a directed line (o, z)    1      revolute      1     a circle and a sphere
    a directed line in a directed plane  1      prismatic     1     a line and a sphere
    a directed line                      2      cylindrical   2     one equation in the turn, of degree four
    a point                              3      spherical     3     three links more to the point: six straight links
    a directed plane                     3      planar        3     three circles: a planar platform on three rods

The element is given by a pose base_from_body whose other coordinates do not matter: the body's origin is the point, its z axis the line or
the plane's normal. Links are anchors A (m, 3) in the base, points B (m, 3) on the body and lengths (m,).
"""

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.linkages import assemblies
from lmeasure.robots.parallel.mechanisms.prr import CarriagePlatform, carriages

_SAMPLES = 16
KINDS = {"point on a line": 1, "line in a plane": 1, "line": 2, "point": 3, "plane": 3}
"""Kinds, and how many links complete each."""


def completed(kind: str, given: FloatArray, anchors: FloatArray, points: FloatArray, *, lengths: FloatArray) -> FloatArray:
    """(k, 7) all poses of a kind of `KINDS` through given (7,) that the links allow; k may be 0. GeometryError for another number of links,
    or where they leave a continuum of poses."""
    if kind not in KINDS:
        raise GeometryError(f"{kind!r} is none of {', '.join(KINDS)}")
    if len(anchors) != KINDS[kind]:
        raise GeometryError(f"a {kind} is completed by {KINDS[kind]} links, not by {len(anchors)}")
    links = se3.apply(np.broadcast_to(se3.inverse(given), (len(anchors), 7)), anchors), points, lengths
    found = {"point on a line": _turned, "line in a plane": _slid, "line": _turned_and_slid, "point": _about, "plane": _over}[kind](*links)
    return se3.compose(np.broadcast_to(given, found.shape), found)


def _turned(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Turns about z: c cos + s sin = m."""
    a, b = anchors[0], points[0]
    c, s = a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]
    m = 0.5 * (a @ a + b @ b - lengths[0] ** 2) - a[2] * b[2]
    far = np.hypot(c, s)
    if far <= 1e-12 * lengths[0] ** 2:
        raise GeometryError("the link's point or anchor lies on the line: it does not tell the turn")
    if abs(m) > far:
        return np.empty((0, 7))
    half = np.arctan2(np.sqrt(far**2 - m**2), m)
    angles = np.arctan2(s, c) + np.array([-half, half])
    return _of(np.zeros(2), angles)


def _slid(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Shifts along x: the line lies along the body's x, in the plane across its z."""
    both = carriages(anchors[0] - points[0], np.array([1.0, 0.0, 0.0]), lengths[0])
    out = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (2, 1))
    out[:, 0] = both
    return out[np.isfinite(both)]


def _turned_and_slid(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Turns about z and shifts h along it: |Rz(t) b + h z - a|^2 = l^2 is h^2 + 2 h d + f(t), d = b_z - a_z. The difference of two gives
    h = (f1 - f2) / (2 (d2 - d1)); in the first, an equation of degree two in cos t, sin t: four roots. Where d1 = d2 the turn comes of the
    difference and h of a square."""
    d = points[:, 2] - anchors[:, 2]

    def flat(t: FloatArray) -> FloatArray:
        c, s = np.cos(t)[:, None], np.sin(t)[:, None]
        x, y = c * points[:, 0] - s * points[:, 1] - anchors[:, 0], s * points[:, 0] + c * points[:, 1] - anchors[:, 1]
        return np.asarray(x**2 + y**2 + d**2 - lengths**2)

    size = float(np.abs(flat(np.linspace(0.0, 2.0 * np.pi, 8))).max() ** 0.5 + np.abs(d).max() + lengths.max())

    def lacks(t: FloatArray) -> FloatArray:
        f = flat(t)
        h2 = f[:, 0] - f[:, 1]
        return h2 if same else np.asarray(h2**2 + 4.0 * (d[1] - d[0]) * h2 * d[0] + 4.0 * (d[1] - d[0]) ** 2 * f[:, 0])

    same = abs(d[1] - d[0]) <= 1e-9 * size
    t = 2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    wave = np.fft.fft(lacks(t)) / _SAMPLES
    polynomial = np.concatenate([wave[2::-1], wave[:-3:-1]])
    if np.abs(polynomial).max() <= 1e-13 * size ** (2 if same else 4):
        raise GeometryError("the links leave the body a continuum of poses")
    zeros = np.roots(np.trim_zeros(np.where(np.abs(polynomial) > 1e-14 * np.abs(polynomial).max(), polynomial, 0.0)))
    angles = np.angle(zeros[np.abs(np.abs(zeros) - 1.0) < 1e-4])
    out: list[tuple[float, float]] = []
    for angle in angles:
        f = flat(np.array([angle]))[0]
        square = d[0] ** 2 - f[0]
        heights = (
            ([-d[0] - np.sqrt(square), -d[0] + np.sqrt(square)] if square >= 0.0 else [])
            if same
            else [(f[0] - f[1]) / (2.0 * (d[1] - d[0]))]
        )
        out += [(float(h), float(angle)) for h in heights]
    return _apart(_polished(np.array(out).reshape(-1, 2), anchors, points, lengths, size), size)


def _polished(found: FloatArray, anchors: FloatArray, points: FloatArray, lengths: FloatArray, size: float) -> FloatArray:
    """Poses of (h, t) after Newton's steps on both links; those that do not close are dropped."""
    for _ in range(8):
        c, s = np.cos(found[:, 1, None]), np.sin(found[:, 1, None])
        x, y = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
        span = np.stack([x - anchors[:, 0], y - anchors[:, 1], points[:, 2] + found[:, :1] - anchors[:, 2]], axis=-1)
        far = np.linalg.norm(span, axis=-1)
        rows = np.stack([span[..., 2], x * span[..., 1] - y * span[..., 0]], axis=-1) / far[..., None]
        found = found + (np.linalg.pinv(rows, rcond=1e-9) @ (lengths - far)[..., None])[..., 0]
    poses = _of(found[:, 0], found[:, 1])
    return poses[_closing(poses, anchors, points, lengths) < 1e-8 * size]


def _about(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Turns about the origin: three straight links more, that hold the body's origin at the base's, as three faces of a cube."""
    reach = float(lengths.max())
    held = reach * np.array([[1.0, 0.1, 0.2], [-0.2, 1.0, 0.1], [0.1, -0.2, 1.0]])
    found = assemblies(
        np.concatenate([held, anchors]), np.concatenate([np.zeros((3, 3)), points]), np.concatenate([np.linalg.norm(held, axis=1), lengths])
    )
    # the three hold the origin at its mirror image too
    return found.poses[np.linalg.norm(found.poses[:, :3], axis=1) < 1e-6 * reach]


def _over(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Motions in the plane z = 0: each link leaves its point a circle there about its anchor."""
    square = lengths**2 - (points[:, 2] - anchors[:, 2]) ** 2
    if (square <= 0.0).any():
        return np.empty((0, 7))
    along = np.array([1.0, 0.0])
    found = CarriagePlatform(anchors[:, :2], anchors[:, :2] + along, points[:, :2], np.sqrt(square)).assemblies(np.zeros(3))
    place = np.column_stack([found[:, :2], np.zeros(len(found))])
    return se3.pose(place, Rotation.from_rotvec(found[:, 2:] * [0.0, 0.0, 1.0])) if len(found) else np.empty((0, 7))


def _of(heights: FloatArray, angles: FloatArray) -> FloatArray:
    if not len(heights):
        return np.empty((0, 7))
    return se3.pose(np.outer(heights, [0.0, 0.0, 1.0]), Rotation.from_rotvec(np.outer(angles, [0.0, 0.0, 1.0])))


def _closing(poses: FloatArray, anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    ends = poses[:, None, :3] + np.einsum("kij,nj->kni", se3.matrices(poses), points)
    return np.asarray(np.abs(np.linalg.norm(ends - anchors, axis=-1) - lengths).max(axis=1))


def _apart(poses: FloatArray, size: float) -> FloatArray:
    weigh, kept = np.array([size] * 3 + [1.0] * 3), list[FloatArray]()
    for pose in poses:
        if all(np.abs(se3.displacement(pose, other) * weigh).max() > 1e-7 * size for other in kept):
            kept.append(pose)
    return np.array(kept).reshape(-1, 7)
