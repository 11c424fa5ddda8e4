"""Uncertainty of a campaign's poses and cable lengths: components of the covariance of its residuals."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lmeasure.core import FloatArray, symmetric_root
from lmeasure.recording import Poses

ASSUMED = {"position": 0.1, "rotation": np.radians(0.02)}
"""Standard uncertainty [mm, rad] of reference poses that state none and cannot be judged by their residuals: an industrial robot's."""


@dataclass(frozen=True)
class Noise:
    """Standard uncertainties of the reference poses (n,): of each coordinate [mm] and each small rotation [rad]."""

    u_position_mm: FloatArray
    u_rotation_rad: FloatArray
    covariance: FloatArray | None = None
    """(n, 6, 6) of (rotation; position), where more is stated than the two, which are then its root mean squares."""
    robust_variance_mm2: FloatArray | None = None
    """(n,) the variance with which a robust loss takes every length of a reference pose back; None without one."""
    u_length_mm: FloatArray | None = None
    """(m,) independent errors of the lengths of each cable at every pose, the zero pose among them; None without any."""
    absent: tuple[str, ...] = ()
    """Parts "position" and "rotation" that the poses do not state; sizes are assumed for them."""

    @classmethod
    def of(cls, poses: Poses) -> Self:
        """Return the noise that the poses' file states, with assumed sizes for unstated parts."""
        none = cls(poses.u_position_mm, poses.u_rotation_rad, poses.covariance, absent=poses.absent)
        return none.widened(*(size if name in poses.absent else 0.0 for name, size in ASSUMED.items()))

    def bare(self) -> Self:
        """Return it without assumed sizes. A covariance by axes has the other part alone."""
        place, turn = ("position" not in self.absent, "rotation" not in self.absent)
        own = None if self.covariance is None else self.covariance * np.outer(*2 * (np.repeat([turn, place], 3),))
        return replace(self, u_position_mm=self.u_position_mm * place, u_rotation_rad=self.u_rotation_rad * turn, covariance=own)

    def widened(self, u_mm: float, u_rad: float) -> Self:
        """Return it with an independent error of these standard uncertainties in each coordinate and each component of a small rotation."""
        more = None if self.covariance is None else self.covariance + np.diag(np.repeat([u_rad**2, u_mm**2], 3))
        return replace(
            self, u_position_mm=np.hypot(self.u_position_mm, u_mm), u_rotation_rad=np.hypot(self.u_rotation_rad, u_rad), covariance=more
        )

    def times(self, factor: float) -> Self:
        """Return it with all standard uncertainties of the poses multiplied."""
        return replace(
            self,
            u_position_mm=self.u_position_mm * factor,
            u_rotation_rad=self.u_rotation_rad * factor,
            covariance=None if self.covariance is None else self.covariance * factor**2,
        )

    def with_lengths(self, u_mm: FloatArray) -> Self:
        """Return it with independent errors (m,) of the cables' lengths."""
        return replace(self, u_length_mm=np.hypot(0.0 if self.u_length_mm is None else self.u_length_mm, u_mm))

    @property
    def stated(self) -> bool:
        """Return whether any pose is uncertain."""
        return bool(self.u_position_mm.any() or self.u_rotation_rad.any())

    def scaled(self, J: FloatArray) -> FloatArray:
        """(e, n, 6) derivatives by the errors of each pose in units of independent standard ones."""
        if self.covariance is None:
            return np.concatenate([J[:, :, :3] * self.u_rotation_rad[:, None], J[:, :, 3:] * self.u_position_mm[:, None]], axis=2)
        return np.asarray(np.einsum("eni,nij->enj", J, symmetric_root(self.covariance)))
