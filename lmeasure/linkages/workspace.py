"""Boundary of the workspace in a plane of places, by following it (thesis Rashoyan 2021, 5.3).

A slice is a plane through a place inside, the orientation kept: where the thesis scans along rays in small steps, here the boundary is met
once by a ray and then followed along its tangent, each point put onto it by Newton's method. Where another limit takes over, the corner is
solved for, and the walk continues along the other. It ends at its beginning (closed), or at the window's edge (open): then it is followed
in the other direction too.

The walk's steps find the course of the boundary. The distances of the straight lines between its points from it are then measured, all at
once, and points are added until they are within the tolerance.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray, StructureError
from lmeasure.linkages.bounds import Bounds
from lmeasure.text import message

ON_MM = 1e-6  # of the reach: the last step onto the boundary but one, after which the error is its square
NOISE_MM = 1e-8  # of the reach: steps that small may stay as large as they are, where a limit is so flat that rounding moves its edge
STILL_MM = 1e-10  # of the reach: the last step to a corner, and one that need be no smaller than that before
MARCH = 400  # steps along a ray to the window's edge, before a change of sign is halved
MOST = 5_000  # most points of one boundary
TURN = 0.2  # rad: largest turn of the tangent between two points
STUCK = 1e-7  # of the reach: a step that small means a corner
BESIDE, CHECKED = 0.2, 21  # in steps: distance beside the step, and number of positions, at which the inside is tested
FROM, BEYOND, TO_CORNER = 0.1, 1.1, 0.9  # in steps: the tested part of a step, which overlaps the next or ends before a corner
GROWN, FARTHEST = 5.0, 0.02  # of the radius at which one looks around a corner: its growth, and its greatest size in parts of the reach
DRAWN = 0.01  # of that radius: how far Newton's method may move the place that was found there
LOOK = 720  # directions that are tested around a corner
WITHIN = 1e-5  # relative to the reach: default distance of lines between points from the boundary
QUARTERS = np.array([0.25, 0.5, 0.75])  # of a line: where it is measured
HALVINGS = 24  # of a line, at most


@dataclass(frozen=True)
class Slice:
    """A plane of places: origin (7,) a pose inside it; across (2, 3): unit directions a and b [base frame]; reach_mm: half the width of
    the window around the origin."""

    origin: FloatArray
    across: FloatArray
    reach_mm: float

    def poses(self, ab: FloatArray) -> FloatArray:
        """(..., 7) poses at coordinates (..., 2) [mm]."""
        out = np.broadcast_to(self.origin, (*ab.shape[:-1], 7)).copy()
        out[..., :3] += ab @ self.across
        return out

    @property
    def displacements(self) -> FloatArray:
        """(2, 6) of the two directions."""
        return np.hstack([np.zeros((2, 3)), self.across])


@dataclass(frozen=True)
class Boundary:
    """A boundary in a slice: places (n, 2) [mm] in order; limit (n,): number of the limit of `Bounds.names` met there; closed or open;
    off_mm: how far straight lines between the places are beside it at most, as measured."""

    places: FloatArray
    limit: IntArray
    closed: bool
    off_mm: float

    @property
    def area_mm2(self) -> float | None:
        """Enclosed, None where it is open."""
        if not self.closed:
            return None
        a, b = self.places.T
        return float(abs(np.sum(a * np.roll(b, -1) - b * np.roll(a, -1)))) / 2.0

    @property
    def lines(self) -> tuple[FloatArray, FloatArray]:
        """Beginnings (m, 2) and ways (m, 2) of the straight lines between the places [mm]."""
        way = np.diff(self.places, axis=0, append=self.places[:1] if self.closed else np.empty((0, 2)))
        return self.places[: len(way)], way

    def distance_mm(self, place: FloatArray) -> float:
        """Return the distance from a place (2,) to the nearest of the lines between the places."""
        begin, way = self.lines
        along = np.einsum("ij,ij->i", place - begin, way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
        return float(np.linalg.norm(begin + np.clip(along, 0.0, 1.0)[:, None] * way - place, axis=1).min())

    def crosses(self, place: FloatArray) -> bool:
        """Return whether the straight line from the slice's origin to a place (2,) crosses one of the lines between the places."""
        begin, way = self.lines
        across = way[:, 0] * place[1] - way[:, 1] * place[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (way[:, 0] * begin[:, 1] - way[:, 1] * begin[:, 0]) / across
            beside = (place[0] * begin[:, 1] - place[1] * begin[:, 0]) / across
        return bool(((along > 0.0) & (along < 1.0) & (beside >= 0.0) & (beside <= 1.0)).any())

    @property
    def surrounds_origin(self) -> bool:
        """Return whether it is closed around the slice's origin: then it bounds its inside, else it is the edge of a hole."""
        begin, way = self.lines
        end = begin + way
        turned = np.arctan2(begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0], np.einsum("ij,ij->i", begin, end)).sum()
        return self.closed and abs(float(turned)) > np.pi


def first_met(bounds: Bounds, plane: Slice, directions: FloatArray) -> FloatArray:
    """(n,) distances [mm] from the slice's origin along directions (n, 2) at which a limit is first met, to 1e-12 of the reach; infinite
    where none is up to the reach. Two crossings within a step of the march, a 400th of the reach, are not seen."""
    d = np.asarray(directions, dtype=np.float64) / np.linalg.norm(directions, axis=1, keepdims=True)
    r = plane.reach_mm * np.arange(1, MARCH + 1) / MARCH
    with np.errstate(invalid="ignore"):
        inside = bounds.inside(plane.poses(d[:, None, :] * r[None, :, None]))
    met = ~inside.all(axis=1)
    step = np.argmin(inside, axis=1)
    low, high = np.where(step > 0, r[step - 1], 0.0), r[step]
    for _ in range(60):
        middle = (low + high) / 2.0
        good = bounds.inside(plane.poses(d * middle[:, None]))
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(met, (low + high) / 2.0, np.inf)


def boundary(bounds: Bounds, plane: Slice, direction: FloatArray, step_mm: float, *, within_mm: float | None = None) -> Boundary:
    """The boundary that a ray along direction (2,) meets, points step_mm apart or nearer where it bends, and so near that straight lines
    between them keep within_mm of it, by default a hundred-thousandth of the reach.

    StructureError where the origin is outside, or the ray meets nothing within the reach.
    """
    if not bounds.inside(plane.origin):
        raise StructureError(message("error.boundary_the_place_to"))
    radius = float(first_met(bounds, plane, np.asarray(direction, dtype=np.float64)[None])[0])
    if not np.isfinite(radius):
        raise StructureError(message("error.boundary_nothing_is_met", reach_mm=plane.reach_mm))
    first = radius * np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    which = int(np.argmin(bounds.values(plane.poses(first))))
    begun = _onto(bounds, plane, first, which)
    if np.isnan(begun).any():
        raise StructureError(message("error.boundary_the_limit_has"))
    places, limits, closed = _walk(bounds, plane, begun, which, 1.0, step_mm)
    if not closed:
        back, behind, _ = _walk(bounds, plane, begun, which, -1.0, step_mm)
        places, limits = back[:0:-1] + places, behind[:0:-1] + limits
    within = WITHIN * plane.reach_mm if within_mm is None else within_mm
    return _filled(bounds, plane, np.array(places), np.array(limits), closed=closed, within_mm=within)


def _filled(bounds: Bounds, plane: Slice, places: FloatArray, limits: IntArray, *, closed: bool, within_mm: float) -> Boundary:
    """The boundary of these places with as many more between them as it takes for lines to keep within_mm of it."""
    off = np.zeros(0)
    for again in range(HALVINGS + 1):
        begin, way = places[: len(places) - (not closed)], np.diff(places, axis=0, append=places[:1] if closed else np.empty((0, 2)))
        off, nearest = _beside_lines(bounds, plane, begin, way)
        long = np.flatnonzero((off > within_mm) & (np.linalg.norm(way, axis=1) > within_mm))
        if again == HALVINGS or not len(long):
            break
        between = _onto(bounds, plane, begin[long] + 0.5 * way[long], nearest[long])
        gone = np.linalg.norm(between - begin[long] - 0.5 * way[long], axis=1)
        found = gone < 0.5 * np.linalg.norm(way[long], axis=1)
        if not found.any():
            break  # where none can be put between them they stay as they are
        at = long[found] + 1
        places, limits = np.insert(places, at, between[found], axis=0), np.insert(limits, at, nearest[long[found]])
    return Boundary(places, limits, closed, float(np.minimum(off, np.linalg.norm(way, axis=1)).max(initial=0.0)))


def _beside_lines(bounds: Bounds, plane: Slice, begin: FloatArray, way: FloatArray) -> tuple[FloatArray, IntArray]:
    """(n,) how far lines from begin (n, 2) along way (n, 2) are beside the boundary [mm], at three places of each; and the limit that is
    nearest to being broken, or broken most, at its middle. Infinite where a limit has no slope."""
    values, rates = bounds.with_rates(plane.poses(begin[:, None] + QUARTERS[:, None] * way[:, None]), plane.displacements)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.nan_to_num(values / np.linalg.norm(rates, axis=-1), nan=np.inf, posinf=np.inf, neginf=-np.inf)
    return np.abs(far.min(axis=2)).max(axis=1), np.asarray(far[:, 1].argmin(axis=1))


def _onto(bounds: Bounds, plane: Slice, places: FloatArray, which: int | IntArray) -> FloatArray:
    """(..., 2) the places on the limits which (...,), by Newton's method along their gradients; NaN where that fails."""
    out, numbers = np.atleast_2d(places).copy(), np.atleast_1d(which)
    going, before = np.arange(len(out)), np.full(len(out), np.inf)
    for _ in range(20):
        values, rates = bounds.with_rates(plane.poses(out[going]), plane.displacements)
        k = numbers[going]
        value, rate = values[np.arange(len(k)), k], rates[np.arange(len(k)), k]
        with np.errstate(divide="ignore", invalid="ignore"):
            step = -(value / (rate**2).sum(axis=1))[:, None] * rate
        size, last = np.linalg.norm(step, axis=1), before[going] <= ON_MM * plane.reach_mm
        # too far, or no nearer than before, as on a cliff
        step[~(size <= plane.reach_mm) | (last & (size > np.maximum(0.1 * before[going], NOISE_MM * plane.reach_mm)))] = np.nan
        out[going] += step
        before[going] = size
        going = going[~(last | np.isnan(step[:, 0]))]
        if not len(going):
            break  # all have settled or failed
    out[going] = np.nan
    return out.reshape(np.shape(places))


def _corner(bounds: Bounds, plane: Slice, place: FloatArray, one: int, other: int) -> FloatArray | None:
    """The place where two limits are met; None where Newton's method finds none."""
    for _ in range(20):
        values, rates = (found[[one, other]] for found in bounds.with_rates(plane.poses(place), plane.displacements))
        if abs(float(np.linalg.det(rates))) < 1e-14 * float(np.linalg.norm(rates)) ** 2 or not np.isfinite(values).all():
            return None
        step = -np.linalg.solve(rates, values)
        place = place + step
        if float(np.linalg.norm(step)) <= STILL_MM * plane.reach_mm:
            return place
    return None


def _tangent(bounds: Bounds, plane: Slice, place: FloatArray, which: int, way: float) -> FloatArray:
    """(2,) unit tangent at a place with the inside on the left of way 1."""
    return _along(bounds.with_rates(plane.poses(place), plane.displacements)[1][which], way)


def _along(rate: FloatArray, way: float) -> FloatArray:
    """(2,) unit vector across a limit's gradient, the greater values on the left of way 1."""
    along = way * np.array([rate[1], -rate[0]])
    return np.asarray(along / np.linalg.norm(along))


def _walk(
    bounds: Bounds, plane: Slice, begun: FloatArray, which: int, way: float, step_mm: float
) -> tuple[list[FloatArray], list[int], bool]:
    """Places from the first one on, the limits met there, and whether the walk came back to it."""
    place, tangent = begun, _tangent(bounds, plane, begun, which, way)
    places, limits, h, gone, corner_mm = [begun], [which], step_mm, 0.0, 1000.0 * STUCK * plane.reach_mm
    turned_at: tuple[FloatArray, FloatArray, float] | None = None  # the last corner that was walked around: place, tangent, radius
    while len(places) <= MOST:
        if h < STUCK * plane.reach_mm:
            if gone > 1.5 * step_mm and float(np.linalg.norm(place - begun)) <= corner_mm:
                return places, limits, True
            if turned_at is not None and float(np.linalg.norm(place - turned_at[0])) < 1.5 * turned_at[2]:
                # no step leads away: the corner is still too near, and is left again, farther off
                places.pop()
                limits.pop()
                turned_at = (*turned_at[:2], GROWN * turned_at[2])
            else:
                turned_at = (place, tangent, corner_mm)
            place, tangent, which, radius = _around(bounds, plane, *turned_at[:2], way, turned_at[2])
            turned_at = (*turned_at[:2], radius)
            places.append(place)
            limits.append(which)
            h = 100.0 * STUCK * plane.reach_mm
        ahead = _onto(bounds, plane, place + h * tangent, which)
        if not 0.3 * h < float(np.linalg.norm(ahead - place)) < 2.0 * h:
            h /= 2.0
            continue
        others, rates = bounds.with_rates(plane.poses(ahead), plane.displacements)
        turned = _along(rates[which], way)
        others[which] = np.inf
        other, corner = int(np.argmin(others)), None
        if others[other] < 0.0:
            corner = _corner(bounds, plane, ahead, which, other)
            beyond = corner is not None and float(bounds.values(plane.poses(corner)).min()) < -1e-9
            if corner is None or beyond or float(np.linalg.norm(corner - place)) > 2.0 * h:
                h /= 2.0
                continue
            ahead, turned = corner, tangent
        far, to = float(np.linalg.norm(ahead - place)), BEYOND if corner is None else TO_CORNER
        if far > STUCK * plane.reach_mm and not _beside(bounds, plane, place, ahead, tangent, turned, way, to):
            h /= 2.0
            continue
        gone += float(np.linalg.norm(ahead - place))
        # the other limit of a pointed corner passes near the place where the walk began, but does not come to it
        near = gone > 1.5 * step_mm and float(np.linalg.norm(ahead - begun)) <= corner_mm
        if _passes(place, ahead, begun) if which == limits[0] else near:
            return places, limits, True
        places.append(ahead)
        limits.append(which)
        if np.abs(ahead).max() > plane.reach_mm:
            return places, limits, False
        if corner is not None:
            which, turned = other, _tangent(bounds, plane, corner, other, way)
        place, tangent, h = ahead, turned, min(step_mm, 2.0 * h)
    raise StructureError(message("error.boundary_points_of_mm", most=MOST, step_mm=step_mm))


def _beside(
    bounds: Bounds, plane: Slice, place: FloatArray, ahead: FloatArray, tangent: FloatArray, turned: FloatArray, way: float, to: float
) -> bool:
    """Return whether the step from a place on a limit to the next turns little, and everything beside it on the inner side is inside.
    Without this the walk would go straight through a place where a limit crosses itself, or where two cells meet. Where an odd number of
    branches meet, the region beyond is inside again and no slope changes its sign; the outside shows beside the step alone, over a length
    as small as the distance from it. So the parts looked at overlap from step to step: `to` is where this one ends, in parts of the
    step."""
    if float(turned @ tangent) < np.cos(TURN):
        return False
    chord = ahead - place
    inner = way * BESIDE * np.array([-chord[1], chord[0]])
    beside = place + np.linspace(FROM, to, CHECKED)[:, None] * chord + inner
    return bool(bounds.inside(plane.poses(beside)).all())


def _around(
    bounds: Bounds, plane: Slice, place: FloatArray, tangent: FloatArray, way: float, radius: float
) -> tuple[FloatArray, FloatArray, int, float]:
    """Return the boundary's continuation from a corner without a tangent: a place at a radius, the tangent and the limit there, and the
    radius. The search goes around, from the incoming side through the inside to its other end, farther off if a limit is so flat beside the
    corner that Newton's method fails, as where three of its branches meet."""
    while True:
        on, along, which = _at_radius(bounds, plane, place, tangent, way, radius)
        if on is not None:
            return on, along, which, radius
        radius *= GROWN
        if radius > FARTHEST * plane.reach_mm:
            break
    raise StructureError(message("error.boundary_cannot_be_followed", place=place[0], place2=place[1]))


def _at_radius(
    bounds: Bounds, plane: Slice, place: FloatArray, tangent: FloatArray, way: float, radius: float
) -> tuple[FloatArray | None, FloatArray, int]:
    """Return the result of `_around` at one radius; no place if none is found."""
    back = float(np.arctan2(-tangent[1], -tangent[0]))
    angles = back - way * 2.0 * np.pi * (np.arange(LOOK) + 0.5) / LOOK
    inside = bounds.inside(plane.poses(place + radius * np.column_stack([np.cos(angles), np.sin(angles)])))
    if not inside.any() or inside.all():
        return None, tangent, 0
    begin = int(np.argmax(inside))
    end = begin + int(np.argmin(np.r_[inside[begin:], False]))
    low, high = np.append(angles, back - way * 2.0 * np.pi)[[end - 1, end]]
    for _ in range(40):
        middle = (low + high) / 2.0
        if bounds.inside(plane.poses(place + radius * np.array([np.cos(middle), np.sin(middle)]))):
            low = middle
        else:
            high = middle
    along = np.array([np.cos(low), np.sin(low)])
    there = place + radius * along
    which = int(np.argmin(bounds.values(plane.poses(there))))
    on = _onto(bounds, plane, there, which)
    # `there` is on the limit already, by halving; if Newton's method leaves it, it was attracted by the corner
    return on if float(np.linalg.norm(on - there)) <= DRAWN * radius else None, along, which


def _passes(place: FloatArray, ahead: FloatArray, begun: FloatArray) -> bool:
    """Return whether the first place lies between one place and the next."""
    way, to = ahead - place, begun - place
    length = float(np.linalg.norm(way))
    along = float(way @ to) / max(length, 1e-300)
    return 0.0 < along <= length * (1.0 + 1e-9) and abs(float(way[0] * to[1] - way[1] * to[0])) <= 0.3 * length * length
