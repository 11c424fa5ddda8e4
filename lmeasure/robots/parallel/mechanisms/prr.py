"""Planar platforms on carriages: chains of a sliding drive and two hinges with parallel axes (PRR), and their dyad in spatial chains.

A carriage C stands at the distance s from A along the guide AB; a rod of length l joins it to the hinge D of the platform, whose pose is
(x, y, phi): D = E + R(phi) D'. With the guide's direction u and r = D - A, |r - s u|^2 = l^2, or

    s^2 - 2 s (r . u) + |r|^2 - l^2 = 0

(source 001, equation 4: there b = -2 (AB . AD) / |AB|, whose minus is missing in print). Both roots are carriages; those off the guide,
s < 0 or s > |AB|, do not exist. Rates come from differentiating this equation: no angle is taken from a cosine, whose derivative fails
at the ends. In space the equation is the same as long as D moves in the plane through the guide across the hinges' axes.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, GeometryError
from lmeasure.robots.parallel.mechanisms.jacobians import Jacobians

_SAMPLES = 16
"""Of a trigonometric polynomial of degree 4, which 9 would determine."""


def carriages(reach: FloatArray, along: FloatArray, rod: FloatArray) -> FloatArray:
    """(..., 2) both distances s of a carriage from A, the smaller first, for D - A = reach (..., d) in the plane or in space, guides of
    unit direction along (..., d), rods (...). NaN where the rod does not reach the guide. At a dead point both are one."""
    middle = np.einsum("...i,...i->...", reach, along)
    # |r|^2 - (r.u)^2 without the loss of digits: the part of r across the guide
    across = reach - middle[..., None] * along
    square = np.asarray(rod) ** 2 - np.einsum("...i,...i->...", across, across)
    root = np.sqrt(np.where(square >= 0.0, square, np.nan))
    return np.stack([middle - root, middle + root], axis=-1)


@dataclass(frozen=True)
class CarriagePlatform:
    """A planar n-PRR mechanism: a, b (n, 2) ends of the guides in the base, hinges (n, 2) D' on the platform, rods (n,).

    GeometryError where a guide or a rod has no length.
    """

    a: FloatArray
    b: FloatArray
    hinges: FloatArray
    rods: FloatArray

    def __post_init__(self) -> None:
        for i, (length, rod) in enumerate(zip(self.guides, self.rods, strict=True)):
            if not length > 0.0:
                raise GeometryError(f"chain {i + 1}: A and B are one point; a guide needs two")
            if not rod > 0.0:
                raise GeometryError(f"chain {i + 1}: a rod of length {rod:g}; it must be positive")

    @property
    def guides(self) -> FloatArray:
        """(n,) lengths of the guides."""
        return np.asarray(np.linalg.norm(self.b - self.a, axis=1))

    @property
    def along(self) -> FloatArray:
        """(n, 2) unit directions of the guides."""
        return np.asarray((self.b - self.a) / self.guides[:, None])

    def ends(self, poses: FloatArray) -> FloatArray:
        """(..., n, 2) hinges D in the base at poses (..., 3) (x, y, phi [rad])."""
        return np.asarray(poses[..., None, :2] + _turned(poses[..., 2], self.hinges))

    def inverse(self, poses: FloatArray) -> FloatArray:
        """(..., n, 2) both distances of every carriage at poses (..., 3); NaN where the rod does not reach or the carriage would leave its
        guide. Any choice of one finite root per chain is a way of assembling the mechanism."""
        s = carriages(self.ends(poses) - self.a, self.along, self.rods)
        slack = 1e-12 * (self.guides + self.rods)[:, None]
        return np.where((s >= -slack) & (s <= self.guides[:, None] + slack), s, np.nan)

    def residuals(self, poses: FloatArray, s: FloatArray) -> FloatArray:
        """(..., n) |D - C|^2 - l^2 at poses (..., 3) with carriages (..., n)."""
        w = self._rods_at(poses, s)
        return np.asarray(np.einsum("...i,...i->...", w, w) - self.rods**2)

    def jacobians(self, poses: FloatArray, s: FloatArray) -> Jacobians:
        """Of the residuals by (x, y, phi) and by the carriages; half of them, which loses nothing and reads easier."""
        w, lever = self._rods_at(poses, s), _quarter(_turned(poses[..., 2], self.hinges))
        output = np.concatenate([w, np.einsum("...i,...i->...", w, lever)[..., None]], axis=-1)
        drives = -np.einsum("...i,...i->...", w, np.broadcast_to(self.along, w.shape))
        return Jacobians(output, drives[..., None] * np.eye(len(self.rods)))

    def assemblies(self, s: FloatArray) -> FloatArray:
        """(k, 3) all poses of a platform on three chains whose carriages stand at s (3,): at most six, sorted by phi; k may be 0.

        With P = D_1 and the other carriages seen from the first, the difference of circles gives two equations linear in P whose
        determinant and right sides are trigonometric of degree one in phi; the circle of chain 1 then is one equation in phi, of degree
        three, whose six zeros are eigenvalues. Every zero is polished on the three circles. GeometryError where the platform can move
        although the carriages stand (equal, parallel rods), and for another number of chains.
        """
        if len(self.rods) != 3:
            raise GeometryError(f"assemblies are found of three chains, not of {len(self.rods)}")
        c = self.a + np.asarray(s, dtype=np.float64)[:, None] * self.along
        size = float(self.rods.max() + np.abs(c - c[0]).max() + np.abs(self.hinges - self.hinges[0]).max())
        phi = 2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES
        value, scale = self._eliminated(c, phi)
        wave = np.fft.fft(value) / _SAMPLES
        # e^{-4 i phi} ... e^{4 i phi}, as a polynomial in z = e^{i phi}
        polynomial = np.concatenate([wave[4::-1], wave[:-5:-1]])
        small = 1e-11 * float(scale.max())
        if np.abs(polynomial).max() <= small:
            raise GeometryError("the carriages leave the platform a continuum of poses: it turns freely")
        # the ends vanish but for rounding: the elimination has degree three
        keep = np.flatnonzero(np.abs(polynomial) > small)
        zeros = np.roots(polynomial[keep[0] : keep[-1] + 1])
        starts = np.angle(zeros[np.abs(np.abs(zeros) - 1.0) < 1e-3])
        return self._polished(c, starts, size)

    def _rods_at(self, poses: FloatArray, s: FloatArray) -> FloatArray:
        return np.asarray(self.ends(poses) - self.a - s[..., None] * self.along)

    def _linear(self, c: FloatArray, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows (k, 2, 2) and right sides (k, 2) of what the differences of circles say of D_1 - C_1."""
        away = _turned(phi, self.hinges[1:] - self.hinges[0]) - (c[1:] - c[0])
        return away, 0.5 * (self.rods[1:] ** 2 - self.rods[0] ** 2 - (away**2).sum(axis=-1))

    def _eliminated(self, c: FloatArray, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        rows, right = self._linear(c, phi)
        det = rows[:, 0, 0] * rows[:, 1, 1] - rows[:, 0, 1] * rows[:, 1, 0]
        x = rows[:, 1, 1] * right[:, 0] - rows[:, 0, 1] * right[:, 1]
        y = rows[:, 0, 0] * right[:, 1] - rows[:, 1, 0] * right[:, 0]
        return x**2 + y**2 - (self.rods[0] * det) ** 2, x**2 + y**2 + (self.rods[0] * det) ** 2

    def _centres(self, c: FloatArray, phi: float) -> FloatArray:
        """(k, 2) places of D_1 - C_1 that the circles allow at a turn: one where the linear equations are of rank two, those of a line and
        the first circle where they are of rank one."""
        rows, right = (part[0] for part in self._linear(c, np.array([phi])))
        axes, values, across = np.linalg.svd(rows)
        best = (axes[:, 0] @ right) / values[0] * across[0]
        if values[1] > 1e-6 * values[0]:
            return np.asarray(best + (axes[:, 1] @ right) / values[1] * across[1])[None]
        half = np.sqrt(max(self.rods[0] ** 2 - best @ best, 0.0))
        return np.array([best + half * across[1], best - half * across[1]])

    def _polished(self, c: FloatArray, starts: FloatArray, size: float) -> FloatArray:
        s = np.einsum("ni,ni->n", c - self.a, self.along)
        found: list[FloatArray] = []
        for phi in starts:
            for centre in self._centres(c, float(phi)):
                pose = self._closed(np.array([*(c[0] + centre - _turned(phi, self.hinges[:1])[0]), phi]), s, size)
                if np.abs(self._linear(c, pose[2:])[0]).max() < 1e-9 * size:
                    raise GeometryError("the carriages leave the platform a continuum of poses: its rods are equal and parallel")
                apart = [np.abs(pose[:2] - p[:2]).max() + size * abs(np.exp(1j * pose[2]) - np.exp(1j * p[2])) for p in found]
                if min(apart, default=np.inf) > 1e-7 * size and np.abs(self.residuals(pose, s)).max() < 1e-11 * size**2:
                    found.append(pose)
        return np.array(sorted(found, key=lambda p: float(p[2]))).reshape(-1, 3)

    def _closed(self, pose: FloatArray, s: FloatArray, size: float) -> FloatArray:
        """The pose (3,) after Newton's steps on the three circles, its turn within half a turn of zero."""
        for _ in range(20):
            step = np.linalg.lstsq(self.jacobians(pose, s).output, -0.5 * self.residuals(pose, s), rcond=1e-12)[0]
            pose = pose + step
            if np.abs(step * [1.0, 1.0, size]).max() < 1e-14 * size:
                break
        return np.array([*pose[:2], np.angle(np.exp(1j * pose[2]))])


def _turned(phi: FloatArray, points: FloatArray) -> FloatArray:
    """(..., n, 2) points (n, 2) turned by phi (...)."""
    cos, sin = np.cos(phi)[..., None], np.sin(phi)[..., None]
    return np.stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]], axis=-1)


def _quarter(vectors: FloatArray) -> FloatArray:
    """Vectors (..., 2) turned by a quarter: their derivative by the angle."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)
