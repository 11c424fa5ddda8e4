"""A cable over its swivel pulley and around its drum in NumPy; `kernels.cable` derives the formulas and has the compiled ones."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmeasure import kernels
from lmeasure.core import FloatArray, se3
from lmeasure.linkages import pluecker_rows

NEWTON_STEPS = 50


class Span(NamedTuple):
    """A cable from its observation point B, arrays over any batch: length [mm] over the pulley to the attachment point; direction (..., 3)
    of the free span; angle [rad] that is wrapped, its cosine and sine."""

    length: FloatArray
    direction: FloatArray
    angle: FloatArray
    cosine: FloatArray
    sine: FloatArray


def span(way: FloatArray, u: FloatArray, radius: ArrayLike) -> Span:
    """Return the wrap of cables to points at way (..., 3) from B that travel along u (..., 3) there, over pulleys of radius (...) [mm],
    straight ones where
    it is 0, all in one frame; NaN where no cable can run. Of a straight one the angle is that between u and the cable."""
    R = np.asarray(radius, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        q = np.einsum("...i,...i->...", way, u)
        away = way - q[..., None] * u
        p = np.linalg.norm(away, axis=-1)
        p = np.where(p < kernels.ON_AXIS_MM, np.nan, p)
        x = p - R
        t = np.sqrt(q * q + x * x - R * R)
        k = 1.0 / (q * q + x * x)
        cosine, sine = k * (q * t - x * R), k * (q * R + x * t)
        angle = np.arctan2(sine, cosine) % (2.0 * np.pi)
        straight = np.linalg.norm(way, axis=-1)
        length = np.where(R == 0.0, straight, R * angle + t)
        e = cosine[..., None] * u + (sine / p)[..., None] * away
        e = np.where((R == 0.0)[..., None], way / straight[..., None], e)
    return Span(length, e, angle, cosine, sine)


def spans(cables: FloatArray, poses: FloatArray, arm: FloatArray) -> Span:
    """Return, for m cables, the kernels' rows (m, columns), at (n, 7) poses with their `arms`: arrays (n, m)."""
    return span(poses[:, None, :3] + arm - cables[:, kernels.BASE_XYZ], cables[:, kernels.GUIDE_XYZ], cables[:, kernels.RADIUS])


def arms(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, m, 3) from the tool origin to the attachment points of the kernels' rows (m, columns) [mm], base axes."""
    return np.asarray(np.einsum("nij,mj->nmi", se3.matrices(poses), cables[:, kernels.ATTACHMENT_XYZ]))


def span_rows(cables: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, m) lengths from B to the attachment point and (n, m, 6) rows (arm x e ; e) about the tool origin, at (n, 7) poses; of channels of
    another kind their readings [rad], as `kernels.angles` has them."""
    arm = arms(cables, poses)
    found = spans(cables, poses, arm)
    readings, rows = found.length, pluecker_rows(arm, found.direction)
    laws = {kernels.SWIVEL: _swivel, kernels.INCLINATION: _inclination}
    for j in np.flatnonzero(cables[:, kernels.KIND] != kernels.CABLE):
        law = laws.get(int(cables[j, kernels.KIND]), _compiled)
        readings[:, j], rows[:, j] = law(cables[j], poses, arm[:, j])
    return readings, rows


def _compiled(channel: FloatArray, poses: FloatArray, arm: FloatArray) -> tuple[FloatArray, FloatArray]:
    row, at = np.ascontiguousarray(channel[None]), np.ascontiguousarray(poses)
    return kernels.span_lengths(row, at)[:, 0], kernels.span_rows_of(row, at)[:, 0]


def _swivel(channel: FloatArray, poses: FloatArray, arm: FloatArray) -> tuple[FloatArray, FloatArray]:
    frame = guide(channel[kernels.ALPHA], channel[kernels.BETA])
    way = poses[:, :3] + arm - channel[kernels.BASE_XYZ]
    x, y = way @ frame[1], way @ frame[2]
    theta, phase = np.arctan2(y, x), channel[kernels.ECCENTRIC_PHASE]
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = (1.0 + channel[kernels.ECCENTRICITY] * np.cos(theta - phase)) / (x * x + y * y)
        gradient = gain[:, None] * (x[:, None] * frame[2] - y[:, None] * frame[1])
    return theta + channel[kernels.ECCENTRICITY] * np.sin(theta - phase) - channel[kernels.ANGLE_ZERO], pluecker_rows(arm, gradient)


def _inclination(channel: FloatArray, poses: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    across = np.cross(axis, channel[kernels.BASE_XYZ])
    size = np.linalg.norm(across, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        omega = across / size[:, None]
    return np.arctan2(axis @ channel[kernels.BASE_XYZ], size) - channel[kernels.ANGLE_ZERO], np.concatenate(
        [omega, np.zeros((len(poses), 3))], axis=1
    )


def guide(alpha: float, beta: float) -> FloatArray:
    """(3, 3) rows u, the unit direction of cable travel at B, e0 normal to it and upward, and e1 = u x e0, by the guide's angles [rad]."""
    ca, cb, sa, sb = math.cos(alpha), math.cos(beta), math.sin(alpha), math.sin(beta)
    return np.array([[-ca * sb, -ca * cb, sa], [sa * sb, sa * cb, ca], [-cb, sb, 0.0]])


def by_guide(frame: FloatArray, way: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return (n, 2) derivatives by alpha and beta of a function of the vectors (n, 3) from B to a point in the `guide` frame, from its
    gradient (n, 3). Alpha turns the frame about e1, beta about the base's -Z; turning it turns the vector back."""
    return np.stack([(gradient * np.cross(way, axis)).sum(axis=1) for axis in (frame[2], [0.0, 0.0, -1.0])], axis=1)


class Drum(NamedTuple):
    """tangent_mm and axial_mm: where the cable leaves the drum, across and along it, from the fixed pulley; travel_mm along it and count_mm
    of cable per count."""

    tangent_mm: float
    axial_mm: float
    travel_mm: float
    count_mm: float

    def paid_out(self, k: FloatArray) -> FloatArray:
        """(...) cable [mm] past the fixed pulley when k (...) counts are paid out: D(k)."""
        a = self.axial_mm + self.travel_mm * k
        h = np.hypot(self.tangent_mm, a) + np.hypot(self.tangent_mm, self.axial_mm)
        # a difference of two square roots would lose the digits that one count moves
        return np.asarray(k * self.count_mm - self.travel_mm * k * (a + self.axial_mm) / np.maximum(h, 1e-300))

    def slope(self, k: FloatArray) -> FloatArray:
        """(...) cable [mm] of one more count, D'(k)."""
        a = self.axial_mm + self.travel_mm * k
        return np.asarray(self.count_mm - self.travel_mm * a / np.maximum(np.hypot(self.tangent_mm, a), 1e-300))

    def counts(self, change: FloatArray) -> FloatArray:
        """(...) the k whose D(k) is the change (...) [mm]: Newton's, monotone because a turn's travel is less than its cable."""
        k = change / self.count_mm
        for _ in range(NEWTON_STEPS):
            step = (change - self.paid_out(k)) / self.slope(k)
            k = k + step
            if not (np.abs(step) > 1e-13 * np.maximum(1.0, np.abs(k))).any():
                break
        return np.asarray(k)


def drum_of(row: FloatArray) -> Drum:
    """Return the drum of a cable from the kernels' row (columns,)."""
    return Drum(row[kernels.TANGENT], row[kernels.AXIAL], row[kernels.TRAVEL], row[kernels.COUNT_LENGTH])
