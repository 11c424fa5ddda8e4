"""Test whether a mechanism that tetrahedra solve can be singular within limits of its lengths, for all 24 such structures (thesis 4.2,
4.3).

The thesis proves limits for tetrahedra built on links and sides alone, as those of L-321-321. In the others some edges are additional
coordinates, l7 and l8 of 4.1: distances of a corner that is placed from points of the other body, which follow from the links before it.
The determinant is a product of volumes all the same: |det| times the six lengths is 6V1 6V2 6V3 for every one of them. (The first apex
moves by 6V1 of its three links. A second one of the other body, at the distance l7 from it, sweeps l7^2 of a turn and 6V2/l7 of its links;
about the line of both the third turns by 6V3/l7: the division by l7 and the multiplication by it cancel.) So a mechanism is singular where
a tetrahedron is flat, and nowhere else.

Boxes of the six lengths go through the tetrahedra one by one with intervals: is each certain to exist (PQ between its flat values), what
are the coordinates of its apex, and its distances from the base of the next tetrahedron. Undecided boxes are halved.

Limits of lengths within which the assembly of one pose is never singular, for links of any structure, proved around that pose.

If no tetrahedra lead to a pose, edges do not determine the singular poses. With the pose for the origin, its Study coordinates are x = (1,
e; g), y = (e; g) is small, and each link is a quadric J_k y + y Q_k y = d_k (1 + e.e), d_k the change of its squared length; the seventh is
Study's. In u = J y, the changes to first order,

    u = T(u) = d (1 + e.e) - u B u / 2,     B_k = 2 A' Q_k A,  A = J^-1,

whose second derivatives are constants. If |T| < U over |u| < U and all |d| < D, and T contracts there, then all lengths between have one
and only one assembly in that box, which changes smoothly with them, and the links hold the platform at it (Kantorovich; Rump, Verification
methods, 2010, 13.3). The box of one pose is not the whole free region: beyond it there is no statement.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.linkages import intervals as iv, study_quadric
from lmeasure.linkages.flat_tetrahedra import enclosed, halved
from lmeasure.linkages.topology import Incidence

BOXES = 60_000  # in all, after which nothing is proved
STANDS, UNKNOWN, FALLS = 1, 0, -1  # State of a box: every tetrahedron exists everywhere; undecided; one exists nowhere

Point = tuple[str, int]
Judge = Callable[[FloatArray], IntArray]  # Function of boxes (n, 6, 2) of lengths: (n,) STANDS, UNKNOWN or FALLS


@dataclass(frozen=True)
class Chain:
    """The tetrahedra of six links in one assembly.

    found: of the links, of a structure that tetrahedra solve; base, platform (6, 3) [mm]; sides: of the first and second apex, 1 or -1 to
    where (c1 - c0) x (c2 - c0) of its three corners shows or against it. The last one's side makes no difference.
    """

    found: Incidence
    base: FloatArray
    platform: FloatArray
    sides: tuple[float, float]

    @cached_property
    def _place(self) -> dict[Point, FloatArray]:
        """Return the coordinates of each point in its own body's frame."""
        order = self.found.order
        links = self.found.structure.links
        at_base = {("B", b): self.base[order[i]] for i, (_, b) in enumerate(links)}
        return {("P", p): self.platform[order[i]] for i, (p, _) in enumerate(links)} | at_base

    def judge(self, boxes: FloatArray, last: int = 2) -> IntArray:
        """(n,) of boxes (n, 6, 2) of lengths [mm], in the order of the links, and the tetrahedra up to the last: STANDS, UNKNOWN or
        FALLS."""
        links = {link: boxes[:, self.found.order[i]] for i, link in enumerate(self.found.structure.links)}
        determined = np.full(len(boxes), STANDS)
        placed: dict[Point, FloatArray] = {}
        known: dict[frozenset[Point], FloatArray] = {frozenset({("P", p), ("B", b)}): box for (p, b), box in links.items()}

        def distance(u: Point, v: Point) -> FloatArray:
            if u[0] == v[0]:
                length = float(np.linalg.norm(self._place[u] - self._place[v]))
                return np.broadcast_to(_around(length), (len(boxes), 2))
            return known[frozenset({u, v})]

        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for step, (side, i, corners) in enumerate(self.found.structure.placements or ()):
                apex = (side, i)
                five = self._five(apex, corners, distance)
                determined = np.minimum(determined, _standing(five, distance(apex, corners[2])))
                if step == last or not (determined == STANDS).any():
                    break
                placed[apex] = self._apex(apex, corners, five, distance, placed, self.sides[step])
                a = corners[0]
                for other in self._place:
                    if other[0] != side and frozenset({apex, other}) not in known:
                        known[frozenset({apex, other})] = self._to(placed[apex], self._place[a], distance(apex, a), self._place[other])
        return np.asarray(determined)

    def _five(self, apex: Point, corners: tuple[Point, ...], distance: Callable[[Point, Point], FloatArray]) -> FloatArray:
        x, y, q = corners
        return np.stack([distance(x, y), distance(apex, x), distance(apex, y), distance(q, x), distance(q, y)], axis=1)

    def _apex(
        self,
        apex: Point,
        corners: tuple[Point, ...],
        five: FloatArray,
        distance: Callable[[Point, Point], FloatArray],
        placed: dict[Point, FloatArray],
        side: float,
    ) -> FloatArray:
        """(n, 3, 2) coordinates of an apex in the frame of the body of its first two corners."""
        a, b = self._place[corners[0]], self._place[corners[1]]
        along = (b - a) / np.linalg.norm(b - a)
        third = placed.get(corners[2]) if corners[2][0] == apex[0] else None
        if third is None:  # a point of the body in whose frame the apex is placed
            third = np.broadcast_to(_around(self._place[corners[2]]), (len(five), 3, 2))
        d, px, py, qx, qy = (five[:, i] for i in range(5))
        u, v = _foot(d, px, py), _foot(d, qx, qy)
        h2 = iv.sub(iv.square(px), iv.square(u))
        rise = iv.root(iv.sub(iv.square(qx), iv.square(v)))
        r = distance(apex, corners[2])
        # (PX^2 - PQ^2 + QX^2 - 2 u v) / 2 h_Q, along the third corner's direction from the hinge
        squares = iv.add(iv.mul(iv.sub(px, r), iv.add(px, r)), iv.square(qx))
        forward = iv.div(iv.sub(squares, 2.0 * iv.mul(u, v)), 2.0 * rise)
        up = iv.root(iv.sub(h2, iv.square(forward)))
        across = np.eye(3) - np.outer(along, along)
        y = iv.div(_times(across, iv.sub(third, _around(a))), rise[:, None])
        z = _times(np.array([[0.0, -along[2], along[1]], [along[2], 0.0, -along[0]], [-along[1], along[0], 0.0]]), y)
        up = up if side > 0.0 else -up[:, ::-1]
        out = iv.add(_around(a), iv.mul(u[:, None], _around(along)))
        return iv.add(out, iv.add(iv.mul(forward[:, None], y), iv.mul(up[:, None], z)))

    @staticmethod
    def _to(place: FloatArray, a: FloatArray, r: FloatArray, other: FloatArray) -> FloatArray:
        """Return (n, 2) distances of places (n, 3, 2), at the distances r from a point a, from another: by two formulas, both valid."""
        w = _around(a - other)
        turned = iv.mul(iv.sub(place, _around(a)), w)
        by_cosines = iv.add(iv.square(r), _around(float((a - other) @ (a - other))))
        for k in range(3):
            by_cosines = iv.add(by_cosines, 2.0 * turned[:, k])
        apart = iv.square(iv.sub(place, _around(other)))
        direct = iv.add(iv.add(apart[:, 0], apart[:, 1]), apart[:, 2])
        both = np.stack([np.fmax(by_cosines[:, 0], direct[:, 0]), np.fmin(by_cosines[:, 1], direct[:, 1])], axis=-1)
        return iv.root(both)


def _around(values: FloatArray | float) -> FloatArray:
    """(..., 2) numbers with a rounding to both sides, as they come out of a few operations."""
    values = np.asarray(values, dtype=np.float64)
    return np.stack([values - 2e-15 * np.abs(values) - 1e-300, values + 2e-15 * np.abs(values) + 1e-300], axis=-1)


def _times(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """(n, 3, 2) a matrix, a rounding to both sides, times vectors."""
    terms = iv.mul(_around(matrix), vectors[:, None])
    return iv.add(iv.add(terms[:, :, 0], terms[:, :, 1]), terms[:, :, 2])


def _foot(d: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """(n, 2) how far along XY, from X, a point at the distances x and y is."""
    return iv.div(iv.add(iv.square(d), iv.mul(iv.sub(x, y), iv.add(x, y))), 2.0 * d)


def _standing(five: FloatArray, pq: FloatArray) -> IntArray:
    """Return (n,) whether tetrahedra with edges five (n, 5, 2) (`flat.EDGES`) and pq (n, 2) exist, all of a box."""
    determined = np.full(len(five), STANDS)
    for side, way in ((1.0, 1.0), (-1.0, -1.0)):  # near flat values from above, far ones from below
        square, rates, whole = enclosed(five, side)
        ends = five.copy()
        at_top, at_foot = (way * rates > 0.0) & whole[:, None], (way * rates < 0.0) & whole[:, None]
        ends[:, :, 0] = np.where(at_top, five[:, :, 1], five[:, :, 0])
        ends[:, :, 1] = np.where(at_foot, five[:, :, 0], five[:, :, 1])
        edge = iv.root(enclosed(ends, side)[0])
        sure = whole & (edge[:, 1] < pq[:, 0] if way > 0.0 else pq[:, 1] < edge[:, 0])
        whole_edge = iv.root(square)
        never = whole_edge[:, 0] > pq[:, 1] if way > 0.0 else pq[:, 0] > whole_edge[:, 1]
        never |= np.isnan(square).any(axis=1) & np.isfinite(five).all(axis=(1, 2)) & ~_faces(five)
        determined = np.minimum(determined, np.where(sure, STANDS, np.where(never, FALLS, UNKNOWN)))
    return determined


def _faces(five: FloatArray) -> BoolArray:
    """(n,) whether both faces at XY can be triangles somewhere in a box."""
    d, px, py, qx, qy = (five[:, i] for i in range(5))
    can = np.ones(len(five), dtype=np.bool_)
    for x, y in ((px, py), (qx, qy)):
        for p, q, r in ((d, x, y), (x, y, d), (y, d, x)):
            can &= p[:, 0] <= q[:, 1] + r[:, 1]
    return np.asarray(can)


def proved(judge: Judge, box: FloatArray, most: int = BOXES) -> bool:
    """Return whether every tetrahedron is proved to exist in all of a box (6, 2) of lengths."""
    corners = np.array(np.meshgrid(*box, indexing="ij")).reshape(6, -1).T
    if (judge(np.stack([corners, corners], axis=-1)) != STANDS).any():
        return False
    boxes, used = box[None], 0
    while len(boxes):
        used += len(boxes)
        if used > most:
            return False
        determined = judge(boxes)
        if (determined == FALLS).any():
            return False
        boxes = halved(boxes[determined == UNKNOWN])
    return True


def grown(sound: Callable[[FloatArray], bool], centre: FloatArray, given: FloatArray) -> FloatArray | None:
    """Limits (6, 2) around lengths (6,) within those given (6, 2) that are sound: all drawn in alike, then each let out again as far as it
    goes, in quarters; None where not even a thousandth of those given is."""

    def drawn(share: float) -> FloatArray:
        return centre[:, None] + share * (given - centre[:, None])

    low, high = 0.0, 1.0
    for _ in range(10):
        middle = (low + high) / 2.0
        low, high = (middle, high) if sound(drawn(middle)) else (low, middle)
    if low == 0.0:
        return None
    box = drawn(low)
    for i, end in np.ndindex(6, 2):
        for share in (1.0, 0.5, 0.25):
            tried = box.copy()
            tried[i, end] += share * (given[i, end] - box[i, end])
            if sound(tried):
                box = tried
                break
    return box


SLACK = 1e-11  # Of every term: far more than all roundings of it together, quadrics and an inverse of a condition below CONDITION included
CONDITION = 1e4  # with coordinates in parts of the rig's size
STEPS = 200


class Around:
    """Six links from base (6, 3) to platform (6, 3) [mm] around a pose (7,), base_from_platform."""

    def __init__(self, base: FloatArray, platform: FloatArray, pose: FloatArray) -> None:
        here = se3.apply(se3.inverse(pose), base)
        middle = platform.mean(axis=0)
        self.lengths = np.linalg.norm(platform - here, axis=1)
        self._unit = float(2.0 ** np.round(np.log2(np.ptp(np.vstack([here, platform]), axis=0).max())))
        a, b = (here - middle) / self._unit, (platform - middle) / self._unit
        Q = study_quadric.quadrics(study_quadric.links(a, b, (self.lengths / self._unit) ** 2)).real
        J = 2.0 * Q[:, 1:, 0]
        self._holds = bool(np.linalg.cond(J) < CONDITION)
        A = np.linalg.inv(J) if self._holds else np.zeros((7, 7))
        self._B = np.abs(2.0 * np.einsum("pi,kpq,qj->kij", A, Q[:, 1:, 1:], A)) * (1.0 + SLACK)
        self._C = np.abs(A[:3].T @ A[:3]) * (1.0 + SLACK)

    def sound(self, box: FloatArray) -> bool:
        """Return whether the assembly of the pose is proved to continue, never singular, over a box (6, 2) of lengths [mm] around its
        own."""
        if not self._holds or not ((box[:, 0] <= self.lengths) & (self.lengths <= box[:, 1])).all():
            return False
        off = np.abs(box**2 - (self.lengths**2)[:, None]).max(axis=1) / self._unit**2
        D = np.append(off, 0.0) * (1.0 + SLACK) + SLACK
        U = D.copy()
        for _ in range(STEPS):
            wider = 1.0001 * np.maximum(*self._moved(D, U)) + 2.0 * SLACK
            if not (np.isfinite(wider).all() and (wider < 1e3).all()):
                return False
            if (wider <= U).all():
                break
            U = np.maximum(U, wider)
        reach, slope = self._moved(D, U)
        return bool((reach + SLACK < U).all() and (slope + SLACK < U).all())

    def _moved(self, D: FloatArray, U: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(7,) bounds of |T| and of |DT| U over |u| < U, |d| < D."""
        bent, turned = np.einsum("kij,i,j->k", self._B, U, U), float(U @ self._C @ U)
        return D * (1.0 + turned) + 0.5 * bent, bent + 2.0 * D * turned
