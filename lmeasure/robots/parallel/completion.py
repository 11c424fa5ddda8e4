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

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.linkages import assemblies
from lmeasure.robots.parallel.dyads import misses
from lmeasure.text import message

_SAMPLES = 16
"""Of trigonometric polynomials of degree four, which nine would determine."""
KINDS = {"point on a line": 1, "line in a plane": 1, "line": 2, "point": 3, "plane": 3}
"""Kinds, and how many links complete each."""


def completed(kind: str, given: FloatArray, anchors: FloatArray, points: FloatArray, *, lengths: FloatArray) -> FloatArray:
    """(k, 7) all poses of a kind of `KINDS` through given (7,) that the links allow; k may be 0. GeometryError for another number of links,
    or where they leave a continuum of poses."""
    if kind not in KINDS:
        raise GeometryError(message("error.is_none_of", kind=kind, kinds=", ".join(KINDS)))
    if len(anchors) != KINDS[kind]:
        raise GeometryError(message("error.a_is_completed_by", kind=kind, kinds=KINDS[kind], n_anchors=len(anchors)))
    links = se3.apply(se3.inverse(given), anchors), points, lengths
    found = {"point on a line": _turned, "line in a plane": _slid, "line": _turned_and_slid, "point": _about, "plane": _over}[kind](*links)
    return se3.compose(given, found)


def _turned(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Turns about z: c cos + s sin = m."""
    a, b = anchors[0], points[0]
    c, s = a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]
    m = 0.5 * (a @ a + b @ b - lengths[0] ** 2) - a[2] * b[2]
    far = np.hypot(c, s)
    if far <= 1e-12 * lengths[0] ** 2:
        raise GeometryError(message("error.the_link_s_point"))
    if abs(m) > far:
        return np.empty((0, 7))
    half = np.arctan2(np.sqrt(far**2 - m**2), m)
    angles = np.arctan2(s, c) + np.array([-half, half])
    return _of(np.zeros(2), angles)


def _slid(anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """Shifts along x: the line lies along the body's x, in the plane across its z."""
    x, y, z = anchors[0] - points[0]
    square = lengths[0] ** 2 - (y**2 + z**2)
    out = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (2 if square >= 0.0 else 0, 1))
    out[:, 0] = x + np.sqrt(max(square, 0.0)) * np.array([-1.0, 1.0])[: len(out)]
    return out


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
        raise GeometryError(message("error.the_links_leave_the"))
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
    return poses[np.abs(misses(poses, anchors, points, lengths)).max(axis=1) < 1e-8 * size]


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
    found = PlanarPlatform(anchors[:, :2], points[:, :2], np.sqrt(square)).assemblies()
    place = np.column_stack([found[:, :2], np.zeros(len(found))])
    return se3.pose(place, Rotation.from_rotvec(found[:, 2:] * [0.0, 0.0, 1.0])) if len(found) else np.empty((0, 7))


@dataclass(frozen=True)
class PlanarPlatform:
    """A platform in a plane on three rods: anchors (3, 2) in the base, hinges (3, 2) on the platform, rods (3,), all of one unit.

    The hinges are D = E + R(phi) D' at a pose (x, y, phi). With P = D_1 and the other anchors seen from the first, the difference of
    circles gives two equations linear in P whose determinant and right sides are trigonometric of degree one in phi. The circle of rod 1
    then is one equation in phi, of degree three.
    """

    anchors: FloatArray
    hinges: FloatArray
    rods: FloatArray

    def residuals(self, pose: FloatArray) -> FloatArray:
        """(3,) |D - A|^2 - l^2 at a pose (3,)."""
        return np.asarray((self._spans(pose) ** 2).sum(axis=1) - self.rods**2)

    def assemblies(self) -> FloatArray:
        """(k, 3) all poses, at most six, sorted by phi; k may be 0. Its zeros are eigenvalues, each polished on the three circles.

        GeometryError where the rods are equal and parallel: the platform can move.
        """
        size = float(self.rods.max() + sum(np.abs(part - part[0]).max() for part in (self.anchors, self.hinges)))
        value, scale = self._eliminated(2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES)
        wave = np.fft.fft(value) / _SAMPLES
        # e^{-4 i phi} ... e^{4 i phi}, as a polynomial in z = e^{i phi}
        polynomial = np.concatenate([wave[4::-1], wave[:-5:-1]])
        small = 1e-11 * float(scale.max())
        if np.abs(polynomial).max() <= small:
            raise GeometryError(message("error.the_rods_leave_the"))
        # the ends vanish but for rounding: the elimination has degree three
        keep = np.flatnonzero(np.abs(polynomial) > small)
        zeros = np.roots(polynomial[keep[0] : keep[-1] + 1])
        found: list[FloatArray] = []
        for phi in np.angle(zeros[np.abs(np.abs(zeros) - 1.0) < 1e-3]):
            for centre in self._centres(phi):
                pose = self._closed(np.array([*(self.anchors[0] + centre - _turned_in_plane(phi, self.hinges[:1])[0]), phi]), size)
                if np.abs(self._linear(pose[2:])[0]).max() < 1e-9 * size:
                    raise GeometryError(message("error.the_rods_leave_the_platform"))
                apart = [np.abs(pose[:2] - p[:2]).max() + size * abs(np.exp(1j * pose[2]) - np.exp(1j * p[2])) for p in found]
                if min(apart, default=np.inf) > 1e-7 * size and np.abs(self.residuals(pose)).max() < 1e-11 * size**2:
                    found.append(pose)
        return np.array(sorted(found, key=lambda p: float(p[2]))).reshape(-1, 3)

    def _spans(self, pose: FloatArray) -> FloatArray:
        return np.asarray(pose[:2] + _turned_in_plane(pose[2], self.hinges) - self.anchors)

    def _linear(self, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows (k, 2, 2) and right sides (k, 2) of the equations that the differences of circles give for D_1 - A_1."""
        away = _turned_in_plane(phi, self.hinges[1:] - self.hinges[0]) - (self.anchors[1:] - self.anchors[0])
        return away, 0.5 * (self.rods[1:] ** 2 - self.rods[0] ** 2 - (away**2).sum(axis=-1))

    def _eliminated(self, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        rows, right = self._linear(phi)
        det = rows[:, 0, 0] * rows[:, 1, 1] - rows[:, 0, 1] * rows[:, 1, 0]
        x = rows[:, 1, 1] * right[:, 0] - rows[:, 0, 1] * right[:, 1]
        y = rows[:, 0, 0] * right[:, 1] - rows[:, 1, 0] * right[:, 0]
        return x**2 + y**2 - (self.rods[0] * det) ** 2, x**2 + y**2 + (self.rods[0] * det) ** 2

    def _centres(self, phi: float) -> FloatArray:
        """(k, 2) places of D_1 - A_1 that the circles allow at a turn: one where the linear equations are of rank two, those of a line and
        the first circle where they are of rank one."""
        rows, right = (part[0] for part in self._linear(np.array([phi])))
        axes, values, across = np.linalg.svd(rows)
        best = (axes[:, 0] @ right) / values[0] * across[0]
        if values[1] > 1e-6 * values[0]:
            return np.asarray(best + (axes[:, 1] @ right) / values[1] * across[1])[None]
        half = np.sqrt(max(self.rods[0] ** 2 - best @ best, 0.0))
        return np.array([best + half * across[1], best - half * across[1]])

    def _closed(self, pose: FloatArray, size: float) -> FloatArray:
        """The pose (3,) after Newton's steps on the three circles, its turn within half a turn of zero."""
        for _ in range(20):
            span, arm = self._spans(pose), _turned_in_plane(pose[2] + 0.5 * np.pi, self.hinges)
            rows = np.column_stack([span, (span * arm).sum(axis=1)])
            step = np.linalg.lstsq(rows, -0.5 * self.residuals(pose), rcond=1e-12)[0]
            pose = pose + step
            if np.abs(step * [1.0, 1.0, size]).max() < 1e-14 * size:
                break
        return np.array([*pose[:2], np.angle(np.exp(1j * pose[2]))])


def _turned_in_plane(phi: FloatArray, points: FloatArray) -> FloatArray:
    """(..., n, 2) points (n, 2) turned by phi (...)."""
    cos, sin = np.cos(phi)[..., None], np.sin(phi)[..., None]
    return np.stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]], axis=-1)


def _of(heights: FloatArray, angles: FloatArray) -> FloatArray:
    if not len(heights):
        return np.empty((0, 7))
    return se3.pose(np.outer(heights, [0.0, 0.0, 1.0]), Rotation.from_rotvec(np.outer(angles, [0.0, 0.0, 1.0])))


def _apart(poses: FloatArray, size: float) -> FloatArray:
    weigh, kept = np.array([size] * 3 + [1.0] * 3), list[FloatArray]()
    for pose in poses:
        if all(np.abs(se3.displacement(pose, other) * weigh).max() > 1e-7 * size for other in kept):
            kept.append(pose)
    return np.array(kept).reshape(-1, 7)
