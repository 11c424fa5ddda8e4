"""Limits of lengths between which no tetrahedron of a mechanism can become flat (thesis 4.2, 4.3), proved and not scanned.

Where the assemblies of a structure are built up corner by corner of tetrahedra, it is singular if one of them is flat. With five edges of a
tetrahedron X Y P Q given, the sixth, PQ, is shortest when it is flat with P and Q on one side of XY, and longest with them on both sides;
it can be assembled between these and is flat at these only. In a plane with X at the origin and Y at (D, 0),

    u_P = (D^2 + PX^2 - PY^2) / 2D,  h_P^2 = PX^2 - u_P^2,  and so for Q:    near, far = hypot(u_P - u_Q, h_P -+ h_Q),

the two roots in PQ^2 of the Cayley-Menger determinant. The thesis' (4.14) to (4.18) are these for its three tetrahedra, with misprints:
squares of sides missing in the angles of (4.15), l4 for l2 in gamma of (4.17).

Over limits of the five edges near and far have ranges, which are enclosed by halving boxes of edges with intervals. What makes that short:
a flat tetrahedron has an affine dependence sum a_i p_i = 0, sum a_i = 0, and sum_{i<j} a_i a_j d(l_ij^2) = 0, so that the rate of PQ by
each other edge has the sign of a product of four areas. While no three points of a box can be on a line, extremes are at corners.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmeasure.core import BoolArray, FloatArray, StructureError
from lmeasure.linkages import intervals as iv
from lmeasure.text import message

BOXES = 40_000  # in all, after which an enclosure is as wide as it is
TOLERANCE = 1e-5  # of the largest edge: an enclosure no wider is sharp
EDGES = ("xy", "px", "py", "qx", "qy")  # The five edges of `Tetrahedron`, in the order of boxes (..., 5, 2)

Limits = Mapping[str, tuple[float, float]]  # Least and greatest length [mm] of every edge that varies or does not, by its name


def flat(edges: Sequence[FloatArray] | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances PQ (near, far) [mm] at which a tetrahedron with the other edges, in the order of `EDGES` and of any shape (...,), is flat:
    P and Q on one side of XY, and on both; NaN where a face cannot be assembled."""
    xy, px, py, qx, qy = edges
    with np.errstate(invalid="ignore"):
        up, uq = (xy**2 + px**2 - py**2) / (2.0 * xy), (xy**2 + qx**2 - qy**2) / (2.0 * xy)
        hp, hq = np.sqrt(px**2 - up**2), np.sqrt(qx**2 - uq**2)
    return np.hypot(up - uq, hp - hq), np.hypot(up - uq, hp + hq)


@dataclass(frozen=True)
class Band:
    """Least and greatest value of a flat edge over all limits, each between two numbers [mm] that are proved."""

    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def sharp(self) -> float:
        """Return how far the proved numbers are apart at most [mm]."""
        return max(self.low[1] - self.low[0], self.high[1] - self.high[0])


@dataclass(frozen=True)
class Flat:
    """Lengths of an edge at which a tetrahedron is flat: near and far bands, and the interval between them, safe, in which it never is."""

    near: Band
    far: Band

    @property
    def safe(self) -> tuple[float, float] | None:
        """Return the lengths of the edge [mm] at which the tetrahedron exists whatever the others are, and is never flat; None without
        any."""
        low, high = self.near.high[1], self.far.low[0]
        return (low, high) if low < high else None


@dataclass(frozen=True)
class Tetrahedron:
    """Names of the six edges: between X and Y, P and Q, and each of P and Q with X and Y."""

    xy: str
    px: str
    py: str
    qx: str
    qy: str
    pq: str

    def seen_from(self, edge: str) -> "Tetrahedron":
        """The same tetrahedron named so that PQ is the edge."""
        place = next((k for k, name in vars(self).items() if name == edge), None)
        if place is None:
            names = ", ".join((*(getattr(self, e) for e in EDGES), self.pq))
            raise StructureError(message("error.tetrahedron_has_no_edge", names=names, edge=edge))
        if place == "pq":
            return self
        if place == "xy":
            return Tetrahedron(self.pq, self.px, self.qx, self.py, self.qy, self.xy)
        # the edge's corner P or Q and its corner X or Y change places with the two others
        p, x = place[0], place[1]
        q, y = "q" if p == "p" else "p", "y" if x == "x" else "x"
        # new XY: q and y of the old; new P and Q: the edge's ends p and x
        return Tetrahedron(getattr(self, q + y), self.pq, getattr(self, p + y), getattr(self, q + x), self.xy, edge)


def bands(tetrahedron: Tetrahedron, limits: Limits, edge: str) -> Flat:
    """Return the lengths of the edge at which it is flat while the other five are anywhere within their limits. StructureError if a face
    cannot be assembled at all."""
    named = tetrahedron.seen_from(edge)
    box = np.array([limits[getattr(named, e)] for e in EDGES], dtype=np.float64)
    if not (np.isfinite(box).all() and (box[:, 0] > 0.0).all() and (box[:, 0] <= box[:, 1]).all()):
        raise StructureError(message("error.limits_of_must_be", edges=", ".join(getattr(named, e) for e in EDGES)))
    return Flat(*(Band(_extreme(box, side, -1.0), _extreme(box, side, 1.0)) for side in (1.0, -1.0)))


def _extreme(box: FloatArray, side: float, way: float) -> tuple[float, float]:
    """(lower, upper) bounds of the least (way -1) or greatest (way 1) flat PQ over a box (5, 2); side: 1 near, -1 far."""
    boxes = box[None]
    tolerance = TOLERANCE * float(box.max())
    # largest way * PQ: `reached` at a point of the box, `possible` in the remaining boxes
    reached, closed, used = -np.inf, -np.inf, 0
    while len(boxes):
        was = (boxes[:, :, 0] == boxes[:, :, 1]).all(axis=1)
        square, rates, whole = enclosed(boxes, side)
        top = way * iv.root(square)[:, 1 if way > 0 else 0]
        can = np.isfinite(top)
        boxes, top, rates, whole, was = boxes[can], top[can], rates[can], whole[can], was[can]
        # where an edge can only make it greater it is at its end
        up = (way * rates > 0.0) & whole[:, None]
        down = (way * rates < 0.0) & whole[:, None]
        boxes = boxes.copy()
        boxes[:, :, 0] = np.where(up, boxes[:, :, 1], boxes[:, :, 0])
        boxes[:, :, 1] = np.where(down, boxes[:, :, 0], boxes[:, :, 1])
        middle = boxes.mean(axis=2)
        values = way * flat(middle.T)[0 if side > 0 else 1]
        reached = max(reached, float(np.nanmax(values, initial=-np.inf)))
        # a corner has been enclosed as a box if it has just become one
        corner = (boxes[:, :, 0] == boxes[:, :, 1]).all(axis=1)
        done = (was & corner) | (top <= reached + tolerance)
        closed = max(closed, float(top[done].max(initial=-np.inf)))
        boxes, top = boxes[~done], top[~done]
        used += len(boxes)
        if used > BOXES:
            closed = max(closed, float(top.max(initial=-np.inf)))
            break
        boxes = np.concatenate([boxes[corner[~done]], halved(boxes[~corner[~done]])])
    if not np.isfinite(closed):
        raise StructureError(message("error.limits_a_face_of"))
    return (reached, closed) if way > 0 else (-closed, -reached)


def halved(boxes: FloatArray) -> FloatArray:
    """(2 n, 5, 2) the halves of boxes (n, 5, 2) across their widest edges."""
    every = np.arange(len(boxes))
    widest = (boxes[:, :, 1] - boxes[:, :, 0]).argmax(axis=1)
    middle = boxes[every, widest].mean(axis=1)
    lower, upper = boxes.copy(), boxes.copy()
    lower[every, widest, 1] = middle
    upper[every, widest, 0] = middle
    return np.concatenate([lower, upper])


def enclosed(boxes: FloatArray, side: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Enclosures (n, 2) of PQ^2, NaN where no face can be assembled; (n, 5) signs of its rates by the edges, 0 where they change; (n,)
    whether everything in the box can be assembled."""
    xy, px, py, qx, qy = (boxes[:, i] for i in range(5))
    xy2, px2, qx2 = (iv.square(edge) for edge in (xy, px, qx))
    twice = 2.0 * xy
    # u = (D + (PX - PY)(PX + PY)/D)/2: each edge once more seldom than in the law of cosines
    up, uq = (iv.div(iv.add(xy2, iv.mul(iv.sub(a, b), iv.add(a, b))), twice) for a, b in ((px, py), (qx, qy)))
    hp2, hq2 = iv.sub(px2, iv.square(up)), iv.sub(qx2, iv.square(uq))
    whole = (hp2[:, 0] > 0.0) & (hq2[:, 0] > 0.0)
    hp, hq = iv.root(hp2), iv.root(hq2)
    yq = hq if side > 0 else -hq[:, ::-1]
    square = iv.add(iv.square(iv.sub(up, uq)), iv.square(iv.sub(hp, yq)))
    # areas, twice: of X Y Q, of X Y P, of P Y Q, of X P Q, signed, as the affine dependence has them
    a_p, a_q = iv.mul(xy, yq), -iv.mul(xy, hp)[:, ::-1]
    ahead_p, ahead_q = iv.sub(up, xy), iv.sub(uq, xy)
    a_x = iv.sub(iv.mul(ahead_p, yq), iv.mul(hp, ahead_q))
    a_y = iv.sub(iv.mul(hp, uq), iv.mul(up, yq))
    p, q, x, y = (iv.sign(a) for a in (a_p, a_q, a_x, a_y))
    pq = p * q
    rates = np.stack([-x * y * pq, -p * x * pq, -p * y * pq, -q * x * pq, -q * y * pq], axis=1)
    return square, rates, whole


def safe_band(tetrahedra: Sequence[Tetrahedron], limits: Limits, edge: str) -> tuple[float, float] | None:
    """Lengths of an edge between which none of the tetrahedra that it belongs to can be flat or fail to assemble; None: there are none."""
    own = [t for t in tetrahedra if edge in vars(t).values()]
    safe = [bands(t, limits, edge).safe for t in own]
    found = [band for band in safe if band is not None]
    if not own or len(found) < len(own):
        return None
    low, high = max(b[0] for b in found), min(b[1] for b in found)
    return (low, high) if low < high else None


def clear(tetrahedron: Tetrahedron, limits: Limits) -> bool:
    """Return whether a tetrahedron is proved neither flat nor impossible anywhere within the limits."""
    safe = bands(tetrahedron, limits, tetrahedron.pq).safe
    low, high = limits[tetrahedron.pq]
    return safe is not None and safe[0] < low and high < safe[1]


def adjusted(
    tetrahedra: Sequence[Tetrahedron], limits: Limits, adjustable: Sequence[str], margin: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Limits within those given between which no tetrahedron is ever flat, by cutting the adjustable edges' one after the other, and again
    until all are clear (thesis 4.2's and 4.3's loop); margin [mm] is kept from flat values.

    An edge whose limits have nothing in common with the safe band is put into its middle as far as it was wide before. StructureError when
    a round changes nothing, or an edge has no safe band.
    """
    now = {name: (float(a), float(b)) for name, (a, b) in limits.items()}
    for _ in range(4 * max(1, len(adjustable))):
        if all(clear(t, now) for t in tetrahedra):
            return now
        before = dict(now)
        for edge in adjustable:
            band = safe_band(tetrahedra, now, edge)
            if band is None:
                continue
            low, high = band[0] + margin + 1e-9, band[1] - margin - 1e-9
            if low >= high:
                continue
            a, b = max(now[edge][0], low), min(now[edge][1], high)
            if a >= b:
                half = min(now[edge][1] - now[edge][0], high - low) / 2.0
                a, b = (low + high) / 2.0 - half, (low + high) / 2.0 + half
            now[edge] = (a, b)
        if now == before:
            break
    stuck = next(t for t in tetrahedra if not clear(t, now))
    named = {"values": ", ".join(vars(stuck).values()), "adjustable": ", ".join(adjustable)}
    raise StructureError(message("error.limits_tetrahedron_may_be", **named))
