"""Synthesis of mechanisms of links between ball joints from poses of the body: least squares link by link, and minimax of all at once.

A link (A, B, l) misses pose i by d_i = |R_i B + o_i - A| - l. Least squares over the seven parameters of each link by itself: fitting
spheres to the points and back in turn, as source 004 does, needs thousands of rounds in its curved valley, and so do Gauss and Newton's
steps. With the second derivatives D'(1 - e e')D / |R B + o - A|, D = (-1, R), Newton's steps take some thirty, of all starts together.
Minimax binds the links together by coordinates of the poses that are left open (`OPEN`): the largest |d_ij| of all links j is least where
a sequence of linear programs, each within a trust region, gains no more (source 004, 7 to 10; HiGHS).

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

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.linkages import assemblies
from lmeasure.text import message

PARAMETERS = 7
ITERATIONS = 200
NEWTON = 500
SETTLED = 1e-14
"""Part of the sum of squares: a start whose next step would gain less has converged."""
EXACT = 1e-11
"""Part of the farthest point: links with smaller misses at every pose fit all of them exactly."""
OPEN: dict[str, tuple[int, ...]] = {
    "point on a line": (2,),
    "line in a plane": (3,),
    "line": (2, 5),
    "point": (0, 1, 2),
    "plane": (2, 3, 4),
}
"""Coordinates that each kind of table 5 leaves open: of a displacement (turn; shift) in the body's axes."""


def _silent(share: float) -> None:
    pass


class Dyad(NamedTuple):
    """anchor A (3,) in the base, point B (3,) on the body, length; misses (n,) of its poses."""

    anchor: FloatArray
    point: FloatArray
    length: float
    misses: FloatArray


class Minimax(NamedTuple):
    """anchors (m, 3), points (m, 3), lengths (m,), poses (n, 7) with their open coordinates determined, largest miss."""

    anchors: FloatArray
    points: FloatArray
    lengths: FloatArray
    poses: FloatArray
    largest: float


def misses(poses: FloatArray, anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """(n, m) d_ij of m links at poses (n, 7)."""
    ends = poses[:, None, :3] + np.einsum("kij,nj->kni", se3.matrices(poses), points)
    return np.asarray(np.linalg.norm(ends - anchors, axis=-1) - lengths)


def gradients(poses: FloatArray, anchors: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, m, 7) of the misses by (A, B, l) of each link, and (n, m, 6) by displacements (turn; shift) in the body's axes."""
    turns = se3.matrices(poses)
    span = poses[:, None, :3] + np.einsum("kij,nj->kni", turns, points) - anchors
    e = span / np.linalg.norm(span, axis=-1, keepdims=True)
    own = np.einsum("kij,kni->knj", turns, e)
    return np.concatenate([-e, own, -np.ones((*e.shape[:2], 1))], axis=-1), np.concatenate([np.cross(points, own), own], axis=-1)


def fitted(poses: FloatArray, starts: FloatArray, progress: Callable[[float], None] = _silent) -> FloatArray:
    """Links (s, 7) of least squares for poses (n, 7), n >= 7, each found from a start (s, 6) of its anchor and point; its length starts as
    the mean distance.

    Newton's steps, damped by a part of the identity that falls with each step that gains and rises with each that does not.
    """
    turns = se3.matrices(poses)
    D = np.concatenate([np.broadcast_to(-np.eye(3), turns.shape), turns], axis=-1)

    def spans(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        span = poses[:, :3] + np.einsum("nij,sj->sni", D, x[:, :6])
        return span, np.linalg.norm(span, axis=-1)

    x = np.column_stack([starts, spans(starts)[1].mean(axis=1)])
    size = np.maximum(x[:, 6], 1e-300)
    cost = ((spans(x)[1] - x[:, 6:]) ** 2).sum(axis=1)
    damping, going = np.full(len(x), 1e-2), np.ones(len(x), dtype=np.bool_)
    for k in range(NEWTON):
        at = np.flatnonzero(going)
        progress(max(k / NEWTON, 1.0 - len(at) / len(x)))
        if not len(at):
            break
        span, far = spans(x[at])
        d, e = far - x[at, 6:], span / far[..., None]
        along = np.einsum("nij,sni->snj", D, e)
        J = np.concatenate([along, -np.ones((*d.shape, 1))], axis=-1)
        weight = d / far
        H = np.einsum("sni,snj->sij", J, J)
        H[:, :6, :6] += np.einsum("sn,nki,nkj->sij", weight, D, D, optimize=True) - np.einsum("sn,sni,snj->sij", weight, along, along)
        values, vectors = np.linalg.eigh(H)
        slope = np.einsum("sij,sni,sn->sj", vectors, J, d, optimize=True)
        newton = slope / (np.abs(values) + damping[at, None])
        step = -np.einsum("sij,sj->si", vectors, newton)
        tried = x[at] + step
        now = ((spans(tried)[1] - tried[:, 6:]) ** 2).sum(axis=1)
        gains = now < cost[at]
        little = (slope * newton).sum(axis=1) <= SETTLED * cost[at] + (1e-15 * size[at]) ** 2
        going[at] = ~little & (damping[at] < 1e8) & np.isfinite(cost[at])
        x[at[gains]], cost[at[gains]] = tried[gains], now[gains]
        damping[at] = np.where(gains, 0.2 * damping[at], 10.0 * damping[at])
    return x


def all_fitted(poses: FloatArray, reach: float, starts: int, seed: int = 0, *, progress: Callable[[float], None] = _silent) -> list[Dyad]:
    """Different links of least squares from so many random starts within reach of the poses' mean, the best first."""
    rng, middle = np.random.default_rng(seed), poses[:, :3].mean(axis=0)
    begun = rng.uniform(-reach, reach, (starts, 6)) + np.r_[middle, np.zeros(3)]
    out: list[Dyad] = []
    found = fitted(poses, begun, progress)
    for x in found[np.isfinite(found).all(axis=1)]:
        if all(np.abs(x[:6] - np.concatenate(other[:2])).max() > 1e-5 * reach for other in out):
            out.append(Dyad(x[:3], x[3:6], float(x[6]), misses(poses, x[None, :3], x[None, 3:6], x[6:])[:, 0]))
    return sorted(out, key=lambda d: float(np.abs(d.misses).max()))


def minimax(
    poses: FloatArray, links: tuple[FloatArray, FloatArray, FloatArray], free: str = "", progress: Callable[[float], None] = _silent
) -> Minimax:
    """Return links (m, 3), (m, 3), (m,) whose largest miss of poses (n, 7) is least near a start; free: a kind of `OPEN` whose coordinates
    of each pose are open, empty for none.

    One linear program per step: the least t with |d + gradient . step| <= t and |step| <= radius; the radius grows if the linear model
    predicted the step well and shrinks if it did not.
    """
    anchors, points, lengths = links
    n, m, open_ = len(poses), len(anchors), list(OPEN[free]) if free else []
    q, own_count = len(open_), PARAMETERS * m
    arm = max(float(np.abs(points).max()), 1e-12)
    radius, best = 0.05 * arm, float(np.abs(misses(poses, anchors, points, lengths)).max())
    unit = np.array([1.0] * own_count + [1.0 / arm if i < 3 else 1.0 for i in open_] * n)
    for k in range(ITERATIONS):
        progress(k / ITERATIONS)
        by, by_pose = gradients(poses, anchors, points)
        rows = np.zeros((n, m, own_count + n * q))
        for j in range(m):
            rows[:, j, PARAMETERS * j : PARAMETERS * (j + 1)] = by[:, j]
        for i in range(n):
            rows[i, :, own_count + q * i : own_count + q * (i + 1)] = by_pose[i][:, open_]
        flat, off = rows.reshape(n * m, -1) * unit, misses(poses, anchors, points, lengths).ravel()
        a = np.block([[flat, -np.ones((n * m, 1))], [-flat, -np.ones((n * m, 1))]])
        found = linprog(
            np.r_[np.zeros(flat.shape[1]), 1.0],
            A_ub=a,
            b_ub=np.r_[-off, off],
            bounds=[(-radius, radius)] * flat.shape[1] + [(0.0, None)],
            method="highs",
        )
        if not found.success:
            break
        step = unit * found.x[:-1]
        own = step[:own_count].reshape(m, PARAMETERS)
        tried = anchors + own[:, :3], points + own[:, 3:6], lengths + own[:, 6]
        moved = np.zeros((n, 6))
        moved[:, open_] = step[own_count:].reshape(n, q)
        there = se3.compose(poses, se3.exp(moved)) if q else poses
        value = float(np.abs(misses(there, *tried)).max())
        determined = best - float(found.x[-1])
        if value < best:
            (anchors, points, lengths), poses = tried, there
            radius *= 2.0 if best - value > 0.5 * determined else 1.0
            best = value
        else:
            radius *= 0.25
        if determined < 1e-9 * best or radius < 1e-10 or best < EXACT * arm:
            break
    return Minimax(anchors, points, lengths, poses, best)


_SAMPLES = 16
"""Samples of trigonometric polynomials of degree four, which nine would determine."""
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
