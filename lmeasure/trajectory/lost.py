"""What the cables still tell where they do not tell the pose: the lost screw named, and the part of the motion that is determined.

At a singular pose the rows have a twist that changes no length: the screw that is lost. Any twist is a multiple of it and a part that the
lengths do determine (thesis 4.5, 4.6: the twist reciprocal to all rows, and the twists orthogonal to it, a turn counted by what it moves
at the platform's rim). Near one the same split holds for the screw that the lengths see least.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.trajectory.at_once import span_rows

SHIFT_RAD_PER_MM = 1e-6  # a screw that turns less than this per mm is a shift: its axis would be a kilometre away
NEARLY = 88.0  # worst pressure angle [deg] from which a pose that is known says what is seen badly


@dataclass(frozen=True)
class LostScrew:
    """The screw that the lengths of the cables see least at a pose.

    direction (3,) unit vector; point (3,) of the axis nearest to the tool origin [mm]; pitch_mm along it per turn; of a shift, which has no
    axis, point is the tool origin and pitch_mm is infinite. mm_per_mm: change of length per mm that the tool moves by it.
    """

    direction: FloatArray
    point: FloatArray
    pitch_mm: float
    mm_per_mm: float

    def text(self) -> str:
        """In words."""
        along = ", ".join(f"{x:.3f}" for x in self.direction)
        if np.isinf(self.pitch_mm):
            return f"a shift along ({along})"
        at = ", ".join(f"{x:.1f}" for x in self.point)
        turn = f"a turn about the axis through ({at}) mm along ({along})"
        return turn if abs(self.pitch_mm) < 0.5 else f"{turn} that goes {self.pitch_mm:.0f} mm along it per turn"


class Split:
    """The split at a pose (7,) of cables rows (m, columns) with free components free (f,) of the twist and uncertain by u (m,) [mm]."""

    def __init__(self, rows: FloatArray, pose: FloatArray, free: IntArray, u: FloatArray) -> None:
        self._size = max(float(np.linalg.norm(rows[:, 7:10], axis=1).max()), 1e-3)
        self.metric = np.repeat([self._size**2, 1.0], 3)
        """(6,) by which the squares of a twist's components are weighed, a turn counted at the platform's rim."""
        self._scale = np.where(free < 3, 1.0 / self._size, 1.0)
        self._free = free
        J = span_rows(rows, pose[None])[1][0][:, free] * self._scale
        U, s, V = np.linalg.svd(J / u[:, None], full_matrices=False)
        self.lost = self._screw(V[-1], pose, float(np.linalg.norm(J @ V[-1])))
        self.twist = self._twist(V[-1])
        """(6,) the screw as a twist (rotation; tool origin) that moves the tool by 1 mm, a turn counted at the platform's rim."""
        self._inverse = (V[:-1].T / s[:-1]) @ (U[:, :-1].T / u)
        self._u = u

    def _twist(self, x: FloatArray) -> FloatArray:
        out = np.zeros((*x.shape[:-1], 6))
        out[..., self._free] = x * self._scale
        return out

    def _screw(self, x: FloatArray, pose: FloatArray, seen: float) -> LostScrew:
        twist = self._twist(x)
        omega, v = twist[:3], twist[3:]
        turn, speed = float(np.linalg.norm(omega)), float(np.linalg.norm(v))
        if turn <= SHIFT_RAD_PER_MM * speed:
            direction = v / speed
            return LostScrew(direction * _sign(direction), pose[:3].copy(), float("inf"), seen)
        direction = omega / turn
        point = pose[:3] + np.cross(omega, v) / turn**2
        return LostScrew(direction * _sign(direction), point, float(2.0 * np.pi * (omega @ v) / turn**2), seen)

    def determined(self, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 6) determined parts of the twists (rotation; tool origin) that change the lengths by changes (n, m) [mm], to first order, and
        (6,) their standard uncertainties."""
        u = np.linalg.norm(self._inverse * self._u, axis=1)
        return self._twist(changes @ self._inverse.T), self._twist(u)


def explain(split: Split, changes: FloatArray) -> list[str]:
    """For each of n samples with changes (n, m) [mm] since the pose of the split: what is lost there, and what is determined."""
    twists, u = split.determined(changes)
    lost = f"not determined: {split.lost.text()}"
    within = f"within {np.linalg.norm(u[3:]):.3g} mm and {np.degrees(np.linalg.norm(u[:3])):.2g} deg"
    texts = []
    for twist in twists:
        if not np.isfinite(twist).all():
            texts.append(lost)
            continue
        shift, turn = (", ".join(f"{x:.3f}" for x in part) for part in (twist[3:], np.degrees(twist[:3])))
        texts.append(f"{lost}; determined since the last pose, {within}: a shift by ({shift}) mm and a turn by ({turn}) deg")
    return texts


def _sign(direction: FloatArray) -> float:
    """That which makes the largest component positive."""
    return 1.0 if direction[np.argmax(np.abs(direction))] > 0.0 else -1.0
