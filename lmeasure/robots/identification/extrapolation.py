"""Uncertainty of an identified robot far from the joint values at which it was measured.

The covariance of the parameters is right where the model is right. A real robot has errors that the model lacks, and the parameters absorb
part of them. Near the measured joint values this does no harm; far from them the parameters extrapolate it. The leverage of a pose, the
variance of its place by the parameters, measures how far it is away. Up to the leverage of the measured poses nothing is added. The rest
grows by a factor that blocks of the measurements show of each other (`hold_out.beyond`).
"""

from dataclasses import dataclass, field

import numpy as np

from lmeasure.core import FloatArray

MOST = 4.0
"""Times its prior: how far a parameter may be off that absorbs errors which the model lacks."""


@dataclass(frozen=True, eq=False)
class Beyond:
    """factor: of standard deviations; from_mm2: variance of all three coordinates together from which on it counts; width (p,): standard
    uncertainties of the priors of the unknowns."""

    factor: float = 0.0
    from_mm2: float = 0.0
    width: FloatArray = field(default_factory=lambda: np.ones(0))

    def places(self, jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return covariances (N, 3, 3) [mm²] of places with derivatives (N, 3, p) by unknowns of a covariance (p, p), widened beyond the
        measured poses.

        No combination of unknowns becomes less certain than `MOST` times its prior.
        """
        known = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
        if not self.factor:
            return np.asarray(known)
        width = self.width
        size, axes = np.linalg.eigh(covariance / np.outer(width, width))
        more = (axes * np.clip(MOST**2 - size, 0.0, self.factor**2 * np.maximum(size, 0.0))) @ axes.T * np.outer(width, width)
        far = np.maximum(1.0 - self.from_mm2 / np.maximum(np.einsum("nii->n", known), 1e-300), 0.0)
        return np.asarray(known + far[:, None, None] * (jacobian @ more @ np.swapaxes(jacobian, 1, 2)))


NOWHERE = Beyond()
"""A robot of which the model lacks nothing."""
