"""Independent statements of the instrument, for tests only: nothing here imports lmeasure or shares its formulas.

Everything is written from the text of the rig file (angles, pulley, drum) in high precision, the slow way: the wrap as a string laid around
a disc until it can leave, the drum as a hypotenuse, rotations as products of elementary matrices, derivatives as difference quotients
with 40 digits. Millimetres and radians; vectors are tuples.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

mp.mp.dps = 40


def rx(angle: float) -> FloatArray:
    """Rotation about X by an angle in degrees."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def ry(angle: float) -> FloatArray:
    """Rotation about Y by an angle in degrees."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rz(angle: float) -> FloatArray:
    """Rotation about Z by an angle in degrees."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def puma_oat(o: float, a: float, t: float) -> FloatArray:
    """The matrix of the PUMA's O, A, T in degrees, element by element (thesis Rashoyan 2021, 5.5, misprints corrected)."""
    so, sa, st = np.sin(np.radians([o, a, t]))
    co, ca, ct = np.cos(np.radians([o, a, t]))
    return np.array(
        [
            [-sa * so * ct + co * st, sa * so * st + co * ct, so * ca],
            [sa * co * ct + so * st, -sa * co * st + so * ct, -co * ca],
            [-ca * ct, ca * st, -sa],
        ]
    )


def matrix_of_quaternion(q: ArrayLike) -> FloatArray:
    """Rotation matrix of x, y, z, w, element by element."""
    x, y, z, w = (float(v) for v in np.asarray(q, dtype=np.float64))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def skew(a: ArrayLike) -> FloatArray:
    """Matrix of the cross product a x."""
    x, y, z = (float(v) for v in np.asarray(a, dtype=np.float64))
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


@dataclass(frozen=True)
class Cable:
    """One cable as a rig file describes it, with its recorded count; angles in radians, attachment point in the tool frame."""

    base: tuple[Any, Any, Any]
    alpha: Any
    beta: Any
    radius: Any
    attachment: tuple[Any, Any, Any]
    tangent: Any = 180.0
    axial: Any = 25.0
    pitch: Any = 1.0
    counts_per_revolution: int = 6000
    count_length: Any = 0.012
    scale: Any = 1.0

    def moved(self, name: str, step: Any) -> "Cable":
        """The cable with one of its parameters (the names of the calibration record, angles in rad) changed by a step."""
        if name in {"x_mm", "y_mm", "z_mm"}:
            i = "xyz".index(name[0])
            return replace(self, base=tuple(mp.mpf(v) + (step if c == i else 0) for c, v in enumerate(self.base)))
        if name.startswith("attachment_"):
            i = "xyz".index(name[11])
            return replace(self, attachment=tuple(mp.mpf(v) + (step if c == i else 0) for c, v in enumerate(self.attachment)))
        key = {
            "guide_alpha_rad": "alpha", "guide_beta_rad": "beta", "pulley_radius_mm": "radius", "scale": "scale",
            "tangent_length_mm": "tangent", "axial_offset_mm": "axial", "groove_pitch_mm": "pitch",
        }[name]  # fmt: skip
        return replace(self, **{key: mp.mpf(getattr(self, key)) + step})


Vector = tuple[Any, Any, Any]


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _norm(a: Vector) -> Any:
    return mp.sqrt(_dot(a, a))


def _sum(*terms: tuple[Any, Vector]) -> Vector:
    """Linear combination of vectors, from (factor, vector)."""
    x, y, z = (mp.fsum(k * v[c] for k, v in terms) for c in range(3))
    return x, y, z


def guide(alpha: Any, beta: Any) -> Vector:
    """Unit direction in which the cable travels at B: against the way from B to the fixed pulley.

    That way goes down by alpha and its horizontal projection lies beta from +Y towards +X.
    """
    way = (mp.cos(alpha) * mp.sin(beta), mp.cos(alpha) * mp.cos(beta), -mp.sin(alpha))
    return -way[0], -way[1], -way[2]


def string_around_disc(point: Vector, base: Vector, u: Vector, radius: Any, steps: int = 45) -> tuple[Any, Any, Vector]:
    """(length, wrapped angle, unit vector of the free span) of a string that arrives at base along u and is laid on the disc.

    The disc touches the line of arrival at base, in the plane of u and the point, on the point's side. The string is laid on, a small
    step at a time, until the straight way to the point no longer cuts into the disc: from there it is straight. Found by walking and
    bisecting, from nothing but that picture.
    """
    radius = mp.mpf(radius)
    d = _sum((1, point), (-1, base))
    if radius == 0:
        length = _norm(d)
        return length, mp.mpf(0), _sum((1 / length, d))
    across = _sum((1, d), (-_dot(d, u), u))
    n = _sum((1 / _norm(across), across))
    centre = _sum((1, base), (radius, n))

    def out(angle: Any) -> Vector:
        """From the centre to where the string ends that is laid so far."""
        return _sum((mp.sin(angle), u), (-mp.cos(angle), n))

    def free(angle: Any) -> Any:
        """Positive when the point is on the outer side of the tangent: the straight way does not cut into the disc."""
        return _dot(_sum((1, point), (-1, centre)), out(angle)) - radius

    # where `free` rises through zero, and not where it falls, the point lies ahead of the string's end
    before = mp.mpf(0)
    for i in range(1, steps + 1):
        angle = 2 * mp.pi * i / steps
        if free(before) <= 0 < free(angle):
            low, high = before, angle
            # the length is stationary at the tangent: an angle good to 1e-21 makes it exact
            for _ in range(70):
                middle = (low + high) / 2
                low, high = (middle, high) if free(middle) <= 0 else (low, middle)
            straight = _sum((1, point), (-1, centre), (-radius, out(high)))
            return radius * high + _norm(straight), high, _sum((mp.cos(high), u), (mp.sin(high), n))
        before = angle
    raise ValueError("the string never leaves the disc: the point is inside")


def drum_change(k: Any, cable: Cable) -> Any:
    """Change of the free cable after k counts are paid out: the cable of k counts less what the slanted stretch to the pulley took."""

    def stretch(turns: Any) -> Any:
        return mp.hypot(mp.mpf(cable.tangent), mp.mpf(cable.axial) + turns * mp.mpf(cable.pitch))

    return mp.mpf(k) * mp.mpf(cable.count_length) - (stretch(mp.mpf(k) / cable.counts_per_revolution) - stretch(mp.mpf(0)))


def attachment_in_base(cable: Cable, pose: ArrayLike) -> Vector:
    """Attachment point in the base frame at a pose x, y, z, qx, qy, qz, qw, in full precision."""
    x, y, z, a, b, c, w = (mp.mpf(float(v)) for v in np.asarray(pose, dtype=np.float64))
    columns = (
        (1 - 2 * (b * b + c * c), 2 * (a * b + c * w), 2 * (a * c - b * w)),
        (2 * (a * b - c * w), 1 - 2 * (a * a + c * c), 2 * (b * c + a * w)),
        (2 * (a * c + b * w), 2 * (b * c - a * w), 1 - 2 * (a * a + b * b)),
    )
    return _sum((1, (x, y, z)), *((mp.mpf(k), column) for k, column in zip(cable.attachment, columns, strict=True)))


def free_length(cable: Cable, pose: ArrayLike) -> Any:
    """Length from B over the swivel pulley to the attachment point at a pose."""
    return string_around_disc(attachment_in_base(cable, pose), cable.base, guide(cable.alpha, cable.beta), cable.radius)[0]


def misclosure(cable: Cable, pose: ArrayLike, recorded: Any) -> Any:
    """Free length at the pose less the change told by a recorded count, decoded by the cable's scale."""
    return free_length(cable, pose) - drum_change(mp.mpf(recorded) / mp.mpf(cable.scale), cable)


def derivative(function: Callable[[Any], Any], step: float = 1e-9) -> float:
    """Central difference quotient of a function of one step, in 40 digits: error of the order step^2."""
    h = mp.mpf(step)
    return float((function(h) - function(-h)) / (2 * h))


def compose(pose: ArrayLike, rotation_vector: ArrayLike, translation: ArrayLike) -> FloatArray:
    """The pose turned by a rotation vector (base axes, about the tool origin) and shifted, as a row; by Rodrigues' formula."""
    pose = np.asarray(pose, dtype=np.float64)
    w = np.asarray(rotation_vector, dtype=np.float64)
    t = float(np.linalg.norm(w))
    axis = w / t if t > 0 else np.zeros(3)
    p, q = np.r_[np.sin(t / 2) * axis, np.cos(t / 2)], pose[3:]
    product = np.r_[p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3]), p[3] * q[3] - p[:3] @ q[:3]]
    return np.r_[pose[:3] + np.asarray(translation, dtype=np.float64), product / np.linalg.norm(product)]
