"""Legs of a parallel robot by kinds: a leg's lower end and length at its drives, and the drives for a position of its upper end.

A leg's equation is |a - c| = l with a the point on the platform, c the lower end and l the length, or n . (a - c) = l if a is kept in a
plane. A kind is one function of its values and drives, made of sums, products, sines and cosines alone: derivatives are those of complex
steps (Squire and Trapp, SIAM Review 40, 1998), exact to the last digits, and no formula is written twice. Angles are rad, lengths mm; u is
a carriage's azimuth, r = (cos u, sin u, 0) its direction outwards and t = (-sin u, cos u, 0) the one along the guide.

    strut     l = scale q + offset, c fixed: a hexapod's leg
    rod       c and l fixed
    carriage  c on a circle about the base's z, at its radius and height; l fixed (source 002)
    crank     c = foot + crank (t sin f + k cos f), f = q + offset from upright, t at the azimuth, k tilted about t (source 003)
    slider    c = foot + q along a straight guide of an azimuth and an elevation; l fixed: a PRR chain (source 001)
    radial    a carriage with a hinge, its axis along the guide, turned and tilted by its errors: a stays in the plane across it, and a
              second drive is the distance, or (radial-arm) the lift of a lower arm above the way inwards, from whose end the upper one
              goes to a
    plane     a stays at a height: three of them make a platform planar
    way       a stays in the plane across a way of its own, a drive away: what moves a guide of one freedom along (source 004)

Five equations |R B_j + o - A_j| = l_j leave a pose one freedom. Its path is followed by arc length, |ds|^2 = |do|^2 + (size |omega|)^2: a
single coordinate is a bad parameter where it stops, as the turn phi about the body's axis does between poses 5 and 6 of the source. Angles
there are R = Rz(psi) Rx(theta) Rz(phi), unique among all orders and signs for its tables.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import null_space

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.robots.model import Parameter
from lmeasure.text import message

STEP = 1e-30
"""Step of complex derivatives: its square is negligible."""


class Equation(NamedTuple):
    """end (N, 3), length (N,), and normal (N, 3) or None: |a - end| = length, or normal . (a - end) = length."""

    end: Any
    length: Any
    normal: Any = None


Values: TypeAlias = Any
"""(k,) of a leg's keys, real or complex."""
Equations = Callable[[Values, Any, Any], list[Equation]]
"""Equations from values, drives (N, d), and further data of the leg."""
Roots = Callable[[Values, FloatArray, Any], FloatArray]
"""(N, roots, d) drives that take the upper end to places (N, 3); NaN where there are none."""


@dataclass(frozen=True)
class Kind:
    """keys: of its values besides the point on the platform; drives: end of the joint's name and whether it slides."""

    keys: tuple[str, ...]
    drives: tuple[tuple[str, bool], ...]
    equations: Equations
    roots: Roots


def _point(x: Any, y: Any, z: Any) -> Any:
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def _of(like: Any, value: Any) -> Any:
    return value + np.zeros(len(like))


def _strut(v: Values, q: Any, _: Any) -> list[Equation]:
    x, y, z, offset, scale = v
    return [Equation(_point(*(_of(q, c) for c in (x, y, z))), scale * q[:, 0] + offset)]


def _strut_roots(v: Values, a: FloatArray, _: Any) -> FloatArray:
    return np.asarray(((np.linalg.norm(a - np.array(v[:3]), axis=-1) - v[3]) / v[4])[:, None, None])


def _rod(v: Values, q: Any, _: Any) -> list[Equation]:
    return [Equation(_point(*(_of(q, c) for c in v[:3])), _of(q, v[3]))]


def _nothing(v: Values, a: FloatArray, _: Any) -> FloatArray:
    return np.zeros((len(a), 1, 0))


def _carriage(v: Values, q: Any, _: Any) -> list[Equation]:
    ring, height, offset, rod = v
    u = q[:, 0] + offset
    return [Equation(_point(ring * np.cos(u), ring * np.sin(u), _of(q, height)), _of(q, rod))]


def _carriage_roots(v: Values, a: FloatArray, _: Any) -> FloatArray:
    ring, height, offset, rod = v
    return (_circled(a - [0.0, 0.0, height], ring, rod) - offset)[:, :, None]


def _circled(a: FloatArray, ring: float, rod: float) -> FloatArray:
    """(N, 2) azimuths of points on a circle about z that are rod from places (N, 3)."""
    far = np.hypot(a[:, 0], a[:, 1])
    m = (ring**2 + far**2 + a[:, 2] ** 2 - rod**2) / (2.0 * ring)
    return np.arctan2(a[:, 1], a[:, 0])[:, None] + _halves(m, far)


def _halves(m: FloatArray, far: FloatArray) -> FloatArray:
    """(N, 2) angles x, the smaller first, with far cos x = m; NaN where there are none."""
    square = far**2 - m**2
    half = np.arctan2(np.sqrt(np.where(square >= 0.0, square, np.nan)), m)
    return np.stack([-half, half], axis=-1)


def _crank_axes(azimuth: Any, tilt: Any) -> tuple[Any, Any]:
    """Directions in which a crank goes, t and k."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return _point(-s, c, 0.0 * c), _point(np.sin(tilt) * c, np.sin(tilt) * s, np.cos(tilt) + 0.0 * c)


def _crank(v: Values, q: Any, _: Any) -> list[Equation]:
    x, y, z, azimuth, tilt, crank, offset, rod = v
    f = q[:, :1] + np.reshape(offset, (-1, 1))
    t, k = _crank_axes(_of(q, azimuth), _of(q, tilt))
    foot = _point(*(_of(q, c) for c in (x, y, z)))
    return [Equation(foot + np.reshape(crank, (-1, 1)) * (np.sin(f) * t + np.cos(f) * k), _of(q, rod))]


def _crank_roots(v: Values, a: FloatArray, _: Any) -> FloatArray:
    azimuth, tilt, crank, offset, rod = v[3:]
    t, k = _crank_axes(azimuth, tilt)
    d = a - np.array(v[:3])
    along, above = d @ t, d @ k
    m = ((d**2).sum(axis=-1) + crank**2 - rod**2) / (2.0 * crank)
    return (np.arctan2(along, above)[:, None] + _halves(m, np.hypot(along, above)) - offset)[:, :, None]


def _slider_along(azimuth: Any, elevation: Any) -> Any:
    return _point(np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))


def _slider(v: Values, q: Any, _: Any) -> list[Equation]:
    x, y, z, azimuth, elevation, rod = v
    u = _slider_along(_of(q, azimuth), _of(q, elevation))
    return [Equation(_point(*(_of(q, c) for c in (x, y, z))) + q[:, :1] * u, _of(q, rod))]


def _slider_roots(v: Values, a: FloatArray, _: Any) -> FloatArray:
    d, u = a - np.array(v[:3]), _slider_along(v[3], v[4])
    middle = d @ u
    square = v[5] ** 2 - ((d - middle[:, None] * u) ** 2).sum(axis=-1)
    root = np.sqrt(np.where(square >= 0.0, square, np.nan))
    return np.stack([middle - root, middle + root], axis=-1)[:, :, None]


def _hinge(u: Any, turn: Any, tilt: Any) -> tuple[Any, Any, Any]:
    """Return the axes of a carriage's hinge: outwards, its axis, and upwards; Rz(u + turn) Rx(tilt)."""
    c, s = np.cos(u + turn), np.sin(u + turn)
    ct, st = np.cos(tilt), np.sin(tilt)
    return _point(c, s, 0.0 * c), _point(-s * ct, c * ct, st + 0.0 * c), _point(s * st, -c * st, ct + 0.0 * c)


def _radial_carriage(v: Values, q: Any) -> tuple[Any, tuple[Any, Any, Any]]:
    ring, height, offset, turn, tilt = v[:5]
    u = q[:, 0] + offset
    return _point(ring * np.cos(u), ring * np.sin(u), _of(q, height)), _hinge(u, turn, tilt)


def _radial(v: Values, q: Any, _: Any) -> list[Equation]:
    foot, (_, axis, _) = _radial_carriage(v, q)
    return [Equation(foot, q[:, 1] + v[5]), Equation(foot, 0.0 * q[:, 0], axis)]


def _radial_arm(v: Values, q: Any, _: Any) -> list[Equation]:
    foot, (out, axis, up) = _radial_carriage(v, q)
    lift, (lower, upper) = q[:, 1:] + np.reshape(v[5], (-1, 1)), v[6:]
    knee = foot + np.reshape(lower, (-1, 1)) * (np.sin(lift) * up - np.cos(lift) * out)
    return [Equation(knee, _of(q, upper)), Equation(foot, 0.0 * q[:, 0], axis)]


def _radial_azimuth(v: Values, a: FloatArray) -> FloatArray:
    """(N,) the drive of a carriage whose hinge's plane goes through places (N, 3), on their side of the guide: t(w) . a = m at
    w = u + turn, since r(u) . t(w) = -sin turn."""
    ring, height, offset, turn, tilt = v[:5]
    m = -ring * np.sin(turn) - np.tan(tilt) * (a[:, 2] - height)
    far = np.hypot(a[:, 0], a[:, 1])
    return np.asarray(np.arctan2(a[:, 1], a[:, 0]) - np.arcsin(np.where(far >= np.abs(m), m / far, np.nan)) - turn - offset)


def _radial_roots(v: Values, a: FloatArray, _: Any) -> FloatArray:
    u = _radial_azimuth(v, a)
    foot, _ = _radial_carriage(v, u[:, None])
    return np.stack([u, np.linalg.norm(a - foot, axis=-1) - v[5]], axis=-1)[:, None]


def _radial_arm_roots(v: Values, a: FloatArray, _: Any) -> FloatArray:
    u = _radial_azimuth(v, a)
    foot, (out, _, up) = _radial_carriage(v, u[:, None])
    lift, lower, upper = v[5:]
    d = a - foot
    inwards, above = -np.einsum("nc,nc->n", d, out), np.einsum("nc,nc->n", d, up)
    m = (inwards**2 + above**2 + lower**2 - upper**2) / (2.0 * lower)
    both = np.arctan2(above, inwards)[:, None] + _halves(m, np.hypot(inwards, above)) - lift
    return np.stack([np.broadcast_to(u[:, None], both.shape), both], axis=-1)


def _plane(v: Values, q: Any, _: Any) -> list[Equation]:
    nothing = 0.0 * _of(q, v[0])
    return [Equation(_point(nothing, nothing, nothing), _of(q, v[0]), _point(nothing, nothing, nothing + 1.0))]


def _way(v: Values, q: Any, way: CubicSpline) -> list[Equation]:
    """A spline knows no complex step: its own derivatives are taken."""
    own = q[:, 0] + v[0]
    at, by = own.real, own.imag[:, None]
    place, tangent, bend = (way(at, n) for n in range(3))
    return [Equation(place + 1j * by * tangent, 0.0 * own, tangent + 1j * by * bend)]


def _way_roots(v: Values, a: FloatArray, way: CubicSpline) -> FloatArray:
    """The foot of each place's perpendicular, from the nearest node."""
    nodes = way.x[np.argmin(np.linalg.norm(way(way.x)[None] - a[:, None], axis=-1), axis=1)]
    for _ in range(20):
        off, tangent, bend = a - way(nodes), way(nodes, 1), way(nodes, 2)
        slope = np.einsum("nc,nc->n", bend, off) - np.einsum("nc,nc->n", tangent, tangent)
        nodes = np.clip(nodes - np.einsum("nc,nc->n", tangent, off) / slope, way.x[0], way.x[-1])
    off = np.einsum("nc,nc->n", way(nodes, 1), a - way(nodes))
    return np.where(np.abs(off) < 1e-9, nodes - v[0], np.nan)[:, None, None]


_BASE = ("base_x_mm", "base_y_mm", "base_z_mm")
_RING = ("ring_mm", "height_mm", "offset_deg")
_HINGE = (*_RING, "turn_deg", "tilt_deg")
TURNS, SLIDES = ("", False), ("", True)
KINDS: dict[str, Kind] = {
    "strut": Kind((*_BASE, "offset_mm", "scale"), (SLIDES,), _strut, _strut_roots),
    "rod": Kind((*_BASE, "rod_mm"), (), _rod, _nothing),
    "carriage": Kind((*_RING, "rod_mm"), (TURNS,), _carriage, _carriage_roots),
    "crank": Kind((*_BASE, "azimuth_deg", "tilt_deg", "crank_mm", "offset_deg", "rod_mm"), (TURNS,), _crank, _crank_roots),
    "slider": Kind((*_BASE, "azimuth_deg", "elevation_deg", "rod_mm"), (SLIDES,), _slider, _slider_roots),
    "radial": Kind((*_HINGE, "slide_offset_mm"), (TURNS, ("_slide", True)), _radial, _radial_roots),
    "radial-arm": Kind((*_HINGE, "lift_deg", "lower_mm", "upper_mm"), (TURNS, ("_lift", False)), _radial_arm, _radial_arm_roots),
    "plane": Kind(("height_mm",), (), _plane, _nothing),
    "way": Kind(("way_offset_mm",), (SLIDES,), _way, _way_roots),
}
"""Kinds by the `type` of a robot.toml's `[[leg]]`."""


WIDTHS = {"mm": 3.0, "deg": 0.5, "": 0.003}
"""Possible errors of legs' values, as standard uncertainties: wider than those of any real leg."""


@dataclass(frozen=True)
class Leg:
    """name, kind: of `KINDS`; point (3,) on the platform [mm]; values (k,) of the kind's keys, mm and rad; low, high (d,) limits of its
    drives; carried: further data of its kind."""

    name: str
    kind: str
    point: FloatArray
    values: FloatArray
    low: FloatArray
    high: FloatArray
    carried: Any = None

    @property
    def of(self) -> Kind:
        """Return its kind."""
        return KINDS[self.kind]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The point's three coordinates, then the kind's values, in the units of the names."""
        names = [f"platform_{axis}_mm" for axis in "xyz"] + list(self.of.keys)
        out = []
        for key, value in zip(names, (*self.point, *self.values), strict=True):
            unit = key.rpartition("_")[2] if key.endswith(("_mm", "_deg")) else ""
            size = float(np.radians(1.0)) if unit == "deg" else 1.0
            out.append(Parameter(f"{self.name}.{key}", unit, float(value) / size, size, WIDTHS[unit]))
        return tuple(out)

    def moved(self, change: FloatArray) -> Self:
        """Return it with (3 + k,) added to its point and values."""
        return replace(self, point=self.point + change[:3], values=self.values + change[3:])

    def equations(self, drives: FloatArray) -> list[Equation]:
        """Return its equations at drives (N, d)."""
        return self.of.equations(self.values, drives, self.carried)

    def derivatives(self, drives: FloatArray) -> list[tuple[Equation, bool]]:
        """Equations' derivatives by the drives and then by the values, and whether they are by a drive; as many as equations for each."""
        out = []
        for i in range(drives.shape[1]):
            step = STEP * 1j * np.eye(drives.shape[1])[i]
            out += [(_imaginary(e), True) for e in self.of.equations(self.values, drives + step, self.carried)]
        for i in range(len(self.values)):
            step = STEP * 1j * np.eye(len(self.values))[i]
            out += [(_imaginary(e), False) for e in self.of.equations(self.values + step, drives + 0j, self.carried)]
        return out


def _imaginary(equation: Equation) -> Equation:
    return Equation(*(None if part is None else np.imag(part) / STEP for part in equation))


RODS = 5
MOST_STEPS = 2000
LEAST_PART = 0.02
"""Least motion of the point in a step, as a part of it."""
ITERATIONS = 50
CLOSES = 1e-12
"""Closing error of loops, as a part of the longest link."""


@dataclass(frozen=True)
class SevenLink:
    """anchors A (m, 3) in the base, points B (m, 3) on the body, lengths (m,), one unit throughout; m = 5 leaves one freedom."""

    anchors: FloatArray
    points: FloatArray
    lengths: FloatArray

    @property
    def size(self) -> float:
        """Return the largest distance of a point from the body's origin, the lever arm of a radian."""
        return float(max(np.linalg.norm(self.points, axis=1).max(), 1e-9 * self.lengths.max()))

    def residuals(self, poses: FloatArray) -> FloatArray:
        """(..., m) by how much the links are too short for poses (..., 7)."""
        return np.asarray(np.linalg.norm(self._spans(poses), axis=-1) - self.lengths)

    def rows(self, poses: FloatArray) -> FloatArray:
        """(..., m, 6) derivatives of the residuals by displacements (omega; shift of the body's origin)."""
        span = self._spans(poses)
        e = span / np.linalg.norm(span, axis=-1, keepdims=True)
        arm = np.einsum("...ij,nj->...ni", se3.matrices(poses), self.points)
        return np.concatenate([np.cross(arm, e), e], axis=-1)

    def closed(self, pose: FloatArray) -> FloatArray:
        """(7,) the pose of the mechanism nearest to one (7,) by steps of least length in the metric of the path. GeometryError where the
        links do not meet."""
        scale = np.array([1.0 / self.size] * 3 + [1.0] * 3)
        for _ in range(ITERATIONS):
            lacks = self.residuals(pose)
            step = -scale * np.linalg.lstsq(self.rows(pose) * scale, lacks, rcond=1e-12)[0]
            step /= max(1.0, float(np.linalg.norm(step[:3])) / 0.3)
            pose = se3.displaced(pose, step)
            if np.abs(step / scale).max() < CLOSES * self.lengths.max():
                break
        if np.abs(self.residuals(pose)).max() > 1e3 * CLOSES * self.lengths.max():
            raise GeometryError(message("error.the_links_do_not", abs=np.abs(self.residuals(pose)).max()))
        return pose

    def tangent(self, pose: FloatArray) -> FloatArray:
        """(6,) displacement (omega; shift) of unit arc length along the path. GeometryError where the mechanism has more freedoms."""
        scale = np.array([1.0 / self.size] * 3 + [1.0] * 3)
        free = null_space(self.rows(pose) * scale, rcond=1e-9)
        if free.shape[1] != 1:
            raise GeometryError(message("error.a_singular_pose_freedoms", shape=free.shape[1]))
        return np.asarray(scale * free[:, 0])

    def walk(self, first: FloatArray, way: FloatArray, step: float) -> Iterator[FloatArray]:
        """The poses (7,) after one that closes, by steps of arc length the way of a displacement (6,), until they come back to it."""
        weigh = np.array([self.size] * 3 + [1.0] * 3)
        pose, sign = first, way * weigh
        for k in count():
            own = self.tangent(pose)
            own = own if (own * weigh) @ sign >= 0.0 else -own
            following = self.closed(se3.displaced(pose, step * own))
            left = float(np.linalg.norm(se3.displacement(following, first) * weigh))
            if k > 1 and left < 0.75 * step:
                if left > 0.25 * step:
                    yield following
                return
            yield following
            pose, sign = following, own * weigh

    def _spans(self, poses: FloatArray) -> FloatArray:
        return np.asarray(poses[..., None, :3] + np.einsum("...ij,nj->...ni", se3.matrices(poses), self.points) - self.anchors)


@dataclass(frozen=True)
class Driver:
    """point of the body that is driven; step between nodes; limits: how far the way is needed, from home [mm]."""

    point: tuple[float, float, float]
    step_mm: float
    limits: tuple[float, float]


Rods = tuple[tuple[tuple[float, ...], tuple[float, ...], float], ...]
"""Rods: the lower end in the base, the upper one on the body, and the length [mm]."""


@lru_cache(maxsize=8)
def way_of(rods: Rods, home: tuple[float, ...], driver: Driver) -> tuple[FloatArray, CubicSpline]:
    """The pose (7,) nearest to home (7,) that five rods allow, and the way of the point from there, by its length in chords [mm], a little
    farther than the driver's limits each way. GeometryError where they allow none, do not leave one freedom, or go less far."""
    if len(rods) != RODS:
        raise GeometryError(message("error.a_way_is_that", rods=RODS, n_rods=len(rods)))
    link = SevenLink(*(np.array(part) for part in zip(*rods, strict=True)))
    closed = link.closed(np.array(home))
    moved = link.tangent(closed)
    shift = moved[3:] + np.cross(moved[:3], se3.matrices(closed) @ np.array(driver.point))
    # ahead is where the point's fastest coordinate rises
    ahead = np.sign(shift[np.argmax(np.abs(shift))]) * moved
    least, most = driver.limits
    forth, back = (_walked(link, closed, way, driver, far) for way, far in ((ahead, most), (-ahead, -least)))
    poses = np.array([*back[::-1], closed, *forth])
    places = se3.apply(poses, driver.point)
    chords = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if not (chords > LEAST_PART * driver.step_mm).all():
        raise GeometryError(message("error.its_point_hardly_moves"))
    along = np.concatenate([[0.0], np.cumsum(chords)])
    return closed, CubicSpline(along - along[len(back)], places)


def _walked(link: SevenLink, closed: FloatArray, way: FloatArray, driver: Driver, far: float) -> list[FloatArray]:
    """Poses after the one that is closed, until the point has gone so far and two steps more."""
    out, gone, last = [], 0.0, se3.apply(closed, driver.point)
    for pose in link.walk(closed, way, driver.step_mm):
        place = se3.apply(pose, driver.point)
        out.append(pose)
        gone, last = gone + float(np.linalg.norm(place - last)), place
        if gone > max(far, 0.0) + 2.0 * driver.step_mm:
            return out
        if len(out) >= MOST_STEPS:
            raise GeometryError(message("error.its_point_goes_mm", gone=gone, most_steps=MOST_STEPS, step_mm=driver.step_mm, far=far))
    raise GeometryError(message("error.the_way_comes_back", gone=gone, far=far))
