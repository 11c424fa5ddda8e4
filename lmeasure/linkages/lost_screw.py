"""Information of links that do not determine the pose: the lost screw, and the determined part of a motion.

At a singular pose the rows have a twist that changes no length: the screw that is lost. Any twist is the sum of a multiple of it and a part
that the lengths determine (thesis 4.5, 4.6: the twist reciprocal to all rows, and the twists orthogonal to it, a turn counted by its way at
the platform's rim). Near such a pose the same split holds for the screw that the lengths determine least.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray
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
