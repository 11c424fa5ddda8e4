"""Singular poses of a body on links: determinant of the rows, its gradient as a twist, and the neighbourhood of a singular pose.

Everything is in the base frame: twists (omega; v) have v at its origin, and a link's row is (direction; moment) = (e; B x e), as the thesis
prints its determinants (Rashoyan 2021, chapter 4). `pluecker.pluecker_rows` has the halves the other way round: the determinant's sign, no
other difference. Points are joined in pairs: link i from base[i], in the base frame, to body[i], in the body's.

The gradient in closed form. With C the cofactors of the rows M, C_i = (c_i; d_i) those of link i, and a small motion by (omega; v),

    d det = sum_i c_i . de_i + d_i . (B_i x de_i) = sum_i (c_i + d_i x B_i) . de_i,     de_i = (1 - e_i e_i') (v + omega x P_i) / l_i,

so that with g_i = (1 - e_i e_i')(c_i + d_i x B_i) / l_i the gradient is K = (sum_i P_i x g_i ; sum_i g_i). The cofactors exist at singular
poses too. The increments that the thesis prints one by one (4.5, eqs. 4.30, 4.31; 4.6) are the columns of this sum, with a dozen misprints:
r of B for r of P, squares missing, signs of the moments' third components.

Architecturally singular rigs, whose links depend on each other at every pose, are determined from coordinates at poses taken at random:
dimensions that fix a body anywhere fix it at almost all poses. The names are of the known kinds: all points of a body on one line, four
links between points in the same ratios on two lines, and plane figures on conics, one a projective image of the other, as regular hexagons
are (Roeschel and Mick, Characterisation of architecturally shaky platforms, 1998).

Information of links that do not determine the pose: the lost screw, and the determined part of a motion.

At a singular pose the rows have a twist that changes no length: the screw that is lost. Any twist is the sum of a multiple of it and a part
that the lengths determine (thesis 4.5, 4.6: the twist reciprocal to all rows, and the twists orthogonal to it, a turn counted by its way at
the platform's rim). Near such a pose the same split holds for the screw that the lengths determine least.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.text import Message, message

SHIFT_RAD_PER_MM = 1e-6  # a screw that turns less than this per mm is a shift: its axis would be a kilometre away


@dataclass(frozen=True)
class Screw:
    """A screw that the lengths of links see least at a pose of the body. direction (3,) unit vector; point (3,) of the axis nearest to the
    body's origin [mm]; pitch_mm along it per turn; of a shift, which has no axis, point is that origin and pitch_mm is infinite. mm_per_mm:
    change of length per mm that the body moves by it."""

    direction: FloatArray
    point: FloatArray
    pitch_mm: float
    mm_per_mm: float

    @property
    def said(self) -> Message:
        """Return its messages."""
        along = tuple(float(x) for x in self.direction)
        if np.isinf(self.pitch_mm):
            return message("screw.shift", along=along)
        at = tuple(float(x) for x in self.point)
        if abs(self.pitch_mm) < 0.5:
            return message("screw.turn", at=at, along=along)
        return message("screw", at=at, along=along, mm=self.pitch_mm)


class Split:
    """The split of the motions at a place (3,) of the body's origin: links by their Pluecker rows (m, 6) about it, with the free components
    free (f,), and uncertainties u (m,) [mm] of the lengths; size_mm: the body's rim, at which a turn is counted."""

    def __init__(self, rows: FloatArray, place: FloatArray, free: IntArray, u: FloatArray, *, size_mm: float) -> None:
        self.metric = np.repeat([size_mm**2, 1.0], 3)
        """(6,) weights of the squares of a twist's components, a turn counted at the body's rim."""
        self._scale = np.where(free < 3, 1.0 / size_mm, 1.0)
        self._free = free
        J = rows[:, free] * self._scale
        U, s, V = np.linalg.svd(J / u[:, None])
        determined = min(len(rows), len(free) - 1)
        self.lost = self._screw(V[-1], place, float(np.linalg.norm(J @ V[-1])))
        self.twist = self._twist(V[-1])
        """(6,) the screw as a twist (rotation; origin) that moves the body by 1 mm, a turn counted at its rim."""
        self._inverse = (V[:determined].T / s[:determined]) @ (U[:, :determined].T / u)
        self._u = u

    def _twist(self, x: FloatArray) -> FloatArray:
        out = np.zeros((*x.shape[:-1], 6))
        out[..., self._free] = x * self._scale
        return out

    def _screw(self, x: FloatArray, place: FloatArray, seen: float) -> Screw:
        twist = self._twist(x)
        omega, v = twist[:3], twist[3:]
        turn, speed = float(np.linalg.norm(omega)), float(np.linalg.norm(v))
        if turn <= SHIFT_RAD_PER_MM * speed:
            direction = v / speed
            return Screw(direction * _sign(direction), place.copy(), float("inf"), seen)
        direction = omega / turn
        point = place + np.cross(omega, v) / turn**2
        return Screw(direction * _sign(direction), point, float(2.0 * np.pi * (omega @ v) / turn**2), seen)

    def determined(self, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 6) determined parts of the twists (rotation; origin) that change the lengths by changes (n, m) [mm], to first order, and
        (6,) their standard uncertainties."""
        u = np.linalg.norm(self._inverse * self._u, axis=1)
        return self._twist(changes @ self._inverse.T), self._twist(u)


def _sign(direction: FloatArray) -> float:
    """Return the sign that makes the largest component positive."""
    return 1.0 if direction[np.argmax(np.abs(direction))] > 0.0 else -1.0


def pluecker_rows(arms: FloatArray, directions: FloatArray) -> FloatArray:
    """(..., m, 6) rows (r x e ; e) of links whose unit directions (..., m, 3) point from the base to the body, r (..., m, 3) being the arms
    from the reference point to the attachment points, in the same axes: row . (omega; v) is the rate of a link's length."""
    return np.concatenate([np.cross(arms, directions), directions], axis=-1)


def pressure_angles(rows: FloatArray, arms: FloatArray) -> FloatArray:
    """(..., 6) pressure-angle analogues [rad] of six links, rows (..., 6, 6) with the arms (..., 6, 3) (thesis 5.1, 5.7).

    The angle between link i and the velocity v_i of its attachment point when only link i changes. At unit rate e_i . v_i = 1, so that it
    is arccos(1/|v_i|). LinAlgError where the rows are singular.
    """
    unit_twists = np.swapaxes(np.linalg.inv(rows), -1, -2)
    v = unit_twists[..., 3:] + np.cross(unit_twists[..., :3], arms)
    return np.asarray(np.arccos(1.0 / np.sqrt(np.maximum(1.0, (v * v).sum(axis=-1)))))


LOST = 1e-9  # of the largest singular value, turns counted at the rim: below it a row adds nothing
STEP = 1e-4  # step of a turn and of the rim: errors are its square, and rounding divided by it
FLAT = 1e-6  # relative to a significant size: curvature over a length, a gradient against curvature


ROUNDING = 1e-13
SOUND = 1e-3  # Determinant of rows of length one from which an inverse is as good as any


def rim_mm(body: FloatArray) -> float:
    """Return the rim at which turns of a body with the points (m, 3) are counted: the largest distance of a point from their middle [mm],
    never 0."""
    return max(float(np.linalg.norm(body - body.mean(axis=0), axis=1).max()), 1e-3)


def link_rows(base: FloatArray, body: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(..., m, 6) rows (e; B x e), (..., m) lengths [mm] and (..., m, 3) places of the body's points in the base frame, at poses (..., 7)
    base_from_body; NaN rows where a link has no length."""
    points = se3.apply(poses[..., None, :], body)
    along = points - base
    lengths = np.linalg.norm(along, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        e = along / lengths[..., None]
    return np.concatenate([e, np.cross(base, e)], axis=-1), lengths, points


def determinants(base: FloatArray, body: FloatArray, poses: FloatArray) -> FloatArray:
    """(...,) determinants [mm^3] of the rows of six links at poses (..., 7)."""
    return np.asarray(np.linalg.det(link_rows(base, body, poses)[0]))


def cofactors(M: FloatArray) -> FloatArray:
    """(..., k, k) cofactors d det / d M of matrices (..., k, k), singular ones too: det M^-T, and where that is nearly nothing times
    nearly infinite, det U det V U diag(products of the others) V'."""
    det = np.linalg.det(M)
    if (np.abs(det) > SOUND * np.linalg.norm(M, axis=-1).prod(axis=-1)).all():
        return np.asarray(det[..., None, None] * np.swapaxes(np.linalg.inv(M), -1, -2))
    U, s, Vt = np.linalg.svd(M)
    others = np.where(np.eye(s.shape[-1], dtype=np.bool_), 1.0, s[..., None, :]).prod(axis=-1)
    sign = np.linalg.det(U) * np.linalg.det(Vt)
    return np.asarray((sign[..., None] * others)[..., None, :] * U @ Vt)


def gradients(base: FloatArray, body: FloatArray, poses: FloatArray) -> FloatArray:
    """(..., 6) the gradient of the determinant at poses (..., 7): its rate by the twist T is K . T."""
    M, lengths, points = link_rows(base, body, poses)
    C, e = cofactors(M), M[..., :3]
    w = C[..., :3] + np.cross(C[..., 3:], base)
    g = (w - (w * e).sum(axis=-1, keepdims=True) * e) / lengths[..., None]
    K = np.concatenate([np.cross(points, g).sum(axis=-2), g.sum(axis=-2)], axis=-1)
    # a sum of rounding errors counts as zero
    size = np.abs(g).max(axis=(-2, -1))
    far = np.abs(points).max(axis=(-2, -1))
    least = ROUNDING * np.stack([size * far] * 3 + [size] * 3, axis=-1)
    return np.where(np.abs(K) < least, 0.0, K)


def moved(poses: FloatArray, twists: FloatArray) -> FloatArray:
    """(..., 7) poses (..., 7) after the screw motions of twists (..., 6) of the base frame."""
    return se3.compose(se3.exp(twists), poses)


@dataclass(frozen=True)
class Hold:
    """Quality of a body's support by links, turns counted at its rim. rank of the rows; condition: of the rows, infinite if they do not fix
    it; mm_per_mm: largest motion of the rim by length errors of 1 mm together, which you can judge without the determinant's units."""

    rank: int
    condition: float
    mm_per_mm: float


def hold(base: FloatArray, body: FloatArray, pose: FloatArray) -> Hold:
    """Return how well links hold the body at a pose (7,)."""
    M, _, points = link_rows(base, body, pose)
    # about the middle of the points, so that it does not matter where the base frame is
    arms = points - points.mean(axis=0)
    rows = np.hstack([M[:, :3], np.cross(arms, M[:, :3]) / rim_mm(body)])
    s = np.linalg.svd(rows, compute_uv=False)
    rank = int((s > LOST * s[0]).sum())
    if rank < 6:
        return Hold(rank, float("inf"), float("inf"))
    return Hold(rank, float(s[0] / s[5]), float(1.0 / s[5]))


@dataclass(frozen=True)
class Neighbourhood:
    """Neighbourhood of a singular pose, in displacements of the body's origin (`core.se3.displaced`): turns about it, shifts of it
    (thesis 4.6).

    gradient (6,) of the determinant, as `gradients`; twists (5, 6) or (6, 6), of the base frame: each leads to singular poses to first
    order. There are five, with no rate of the determinant, or six where the gradient vanishes. About the body's origin, turns counted in
    units of a length, they are orthonormal and principal: bend (5,) or (6,) [1/mm] are the curvatures along them, of the surface of
    singular poses, or of the determinant where there is no gradient, as parts of the largest.
    """

    gradient: FloatArray
    twists: FloatArray
    bend: FloatArray
    size_mm: float

    @property
    def topology(self) -> str:
        """Return `plane` for singular poses on a surface without curvature, to second order; `surface` for a curved one. If the gradient
        vanishes: `point` if determinants around have one sign, `cone` if both, `higher order` if curvature does not decide."""
        size = float(np.abs(self.bend).max())
        if len(self.twists) == 5:
            return "plane" if size * self.size_mm < FLAT else "surface"
        if size == 0.0:
            return "higher order"
        seen = self.bend[np.abs(self.bend) > FLAT * size]
        return "point" if len(seen) == 6 and (np.sign(seen) == np.sign(seen[0])).all() else "cone"


def neighbourhood(base: FloatArray, body: FloatArray, pose: FloatArray, size_mm: float | None = None) -> Neighbourhood:
    """The neighbourhood of a singular pose (7,); size_mm: the length at which turns are counted, by default the body's rim. The thesis
    takes 1, and in its second example lists two of the twists with the halves exchanged."""
    size = rim_mm(body) if size_mm is None else size_mm
    unit, to_base = np.repeat([1.0 / size, 1.0], 3), se3.at_points(-pose[:3])
    K = displacement_gradients(base, body, pose, np.zeros(6)) * unit
    H = second_rates(base, body, pose) * np.outer(unit, unit)
    scale, steep = float(np.abs(H).max()), float(np.linalg.norm(K))
    if steep <= FLAT * scale * size:
        values, vectors = np.linalg.eigh(H)
        # rounding of a determinant that does not change at all is no curvature
        determined = scale * size**2 > FLAT * rim_mm(body) ** 3
        return Neighbourhood(gradients(base, body, pose), vectors.T * unit @ to_base.T, values / scale if determined else np.zeros(6), size)
    tangent = np.linalg.svd(K[None])[2][1:]
    values, vectors = np.linalg.eigh(-(tangent @ H @ tangent.T) / steep)
    return Neighbourhood(gradients(base, body, pose), (vectors.T @ tangent) * unit @ to_base.T, values, size)


def second_rates(base: FloatArray, body: FloatArray, pose: FloatArray) -> FloatArray:
    """(6, 6) second derivatives of the determinant by displacements of the body's origin at a pose (7,): differences of the gradient."""
    step = STEP * np.repeat([1.0, rim_mm(body)], 3)
    ahead, behind = (np.array([displacement_gradients(base, body, pose, d) for d in np.diag(sign * step)]) for sign in (1.0, -1.0))
    rates = (ahead - behind) / (2.0 * step[:, None])
    return np.asarray((rates + rates.T) / 2.0)


def displacement_gradients(base: FloatArray, body: FloatArray, pose: FloatArray, delta: FloatArray) -> FloatArray:
    """(6,) derivatives of the determinant by the displacement delta (6,) from a pose (7,)."""
    there = se3.displaced(pose, delta)
    K = gradients(base, body, there) @ se3.at_points(-there[:3])
    return np.concatenate([K[:3] @ se3.left_jacobians(delta[:3]), K[3:]])


def dependent(M: FloatArray) -> IntArray:
    """Return links (k,) whose rows (6, 6) depend on each other, those without effect on a lost twist; empty if the body is fixed."""
    U, s, _ = np.linalg.svd(M)
    lost = U[:, int((s > LOST * s[0]).sum()) :]
    return np.flatnonzero(np.linalg.norm(lost, axis=1) > 1e-6)


def link_pressure_angles(base: FloatArray, body: FloatArray, pose: FloatArray) -> FloatArray:
    """(6,) pressure-angle analogues [rad] of the links at a pose (7,), at a singular one too (thesis 5.1).

    Angle between link i and the velocity of its point when only link i changes. At a singular pose the links whose rows depend on each
    other have 90 degrees: the limit from all sides. A link that takes no part in the dependence still moves the body, but beside a motion
    that no link sees; its angle is that of the least motion, a turn counted at the rim.
    """
    M, _, points = link_rows(base, body, pose)
    return line_pressure_angles(M, points, points.mean(axis=0), rim_mm(body))


def line_pressure_angles(M: FloatArray, points: FloatArray, middle: FloatArray, rim: float) -> FloatArray:
    """(m,) angles of `link_pressure_angles`, and of more links than six those of least squares.

    M (m, 6): rows; points (m, 3) of the body, or (m, 3, 6) rates of ends by twists, as of `bounds.Lines`; middle (3,): where a turn counts
    nothing; rim [mm]: where it counts.
    """
    e = M[:, :3]
    rows = np.hstack([(M[:, 3:] - np.cross(middle, e)) / rim, e])
    s = np.linalg.svd(rows, compute_uv=False)
    unit = np.linalg.pinv(rows, rcond=LOST).T
    omega = unit[:, :3] / rim
    if points.ndim == 2:
        v = unit[:, 3:] + np.cross(omega, points - middle)
    else:
        v = (points @ np.hstack([omega, unit[:, 3:] - np.cross(omega, middle)])[..., None])[..., 0]
    rate = np.einsum("ij,ij->i", rows, unit)
    out = np.arccos(np.clip(np.abs(rate) / np.maximum(np.linalg.norm(v, axis=1), 1e-300), 0.0, 1.0))
    if s[-1] <= LOST * s[0]:
        out[dependent(M)] = np.pi / 2.0
    return np.asarray(out)


POSES = 6
SINGULAR = 1e-5
"""Part of the largest singular value below which, at every pose, links depend. Rigs that fix a body have 1e-3 and more at most poses.
Coordinates of a dependent rig of half a metre, rounded to the micrometre, make some 1e-6."""
STRAIGHT = 1e-5  # of a figure's size: points so near to one line or plane are on it


def architecturally_singular(base: FloatArray, platform: FloatArray) -> str | None:
    """Return why links from points base (6, 3) to points platform (6, 3) depend on each other at every pose; None if they do not."""
    a, b = base - base.mean(axis=0), platform - platform.mean(axis=0)
    size = max(np.abs(a).max(), np.abs(b).max())
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(0)
    poses = se3.pose(rng.normal(size=(POSES, 3)), Rotation.random(POSES, rng=rng))
    s = np.linalg.svd(link_rows(a / size, b / size, poses)[0], compute_uv=False)
    if not (s[:, -1] < SINGULAR * s[:, 0]).all():
        return None
    for points, name in ((a, "base"), (b, "platform")):
        if _flatness(points, 1):
            return message("linkages.all_points_lie_one", body=message(f"linkages.{name}"))
    four = next((list(i) for i in itertools.combinations(range(6), 4) if _flatness(a[list(i)], 1) and _flatness(b[list(i)], 1)), None)
    if four is not None:
        return message("linkages.links_join_points_same", links=tuple(str(i + 1) for i in four))
    if _flatness(a, 2) and _flatness(b, 2):
        return message("linkages.conics_similar" if _similar(a, b) else "linkages.conics")
    return message("linkages.links_depend_each_other")


def _flatness(points: FloatArray, dimensions: int) -> bool:
    """Return whether points (k, 3) span no more than so many dimensions."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(s[dimensions] <= STRAIGHT * s[0])


def _similar(a: FloatArray, b: FloatArray) -> bool:
    """Return whether the distances of both figures are in one ratio."""
    of_a, of_b = (np.linalg.norm(points[:, None] - points, axis=2) for points in (a, b))
    ratio = np.sqrt((of_b**2).sum() / (of_a**2).sum())
    return bool(np.abs(of_b - ratio * of_a).max() <= STRAIGHT * of_b.max())
