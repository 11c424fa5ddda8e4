"""Legs of a parallel robot by kinds: where a leg begins and how long it is at its drives, and the drives for a place of its upper end.

A leg's equation is |a - c| = l with a the point on the platform, c the lower end and l the length, or n . (a - c) = l where something holds
a in a plane. What a kind states is one function of its values and drives, made of sums, products, sines and cosines alone: derivatives are
those of complex steps (Squire and Trapp, SIAM Review 40, 1998), exact to the last digits, and no formula is written twice. Angles are rad,
lengths mm; u is a carriage's azimuth, r = (cos u, sin u, 0) its direction outwards and t = (-sin u, cos u, 0) the one along the guide.

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
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from lmeasure.core import FloatArray
from lmeasure.robots.model import Parameter

STEP = 1e-30
"""Of complex steps: its square is nothing."""


class Equation(NamedTuple):
    """end (N, 3), length (N,), and normal (N, 3) or None: |a - end| = length, or normal . (a - end) = length."""

    end: Any
    length: Any
    normal: Any = None


Values: TypeAlias = Any
"""(k,) of a leg's keys, real or complex."""
Equations = Callable[[Values, Any, Any], list[Equation]]
"""Of values, drives (N, d), and what the leg carries besides."""
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
"""By the `type` of a robot.toml's `[[leg]]`."""


WIDTHS = {"mm": 3.0, "deg": 0.5, "": 0.003}
"""What values of legs may be off by, as standard uncertainties: wider than those of any that is built."""


@dataclass(frozen=True)
class Leg:
    """name, kind: of `KINDS`; point (3,) on the platform [mm]; values (k,) of the kind's keys, mm and rad; low, high (d,) limits of its
    drives; carried: what its kind needs besides."""

    name: str
    kind: str
    point: FloatArray
    values: FloatArray
    low: FloatArray
    high: FloatArray
    carried: Any = None

    @property
    def of(self) -> Kind:
        """Return what its kind does."""
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
        """With (3 + k,) added to its point and values."""
        return replace(self, point=self.point + change[:3], values=self.values + change[3:])

    def equations(self, drives: FloatArray) -> list[Equation]:
        """At drives (N, d)."""
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
