"""How uncertain an identified robot is far from the joint values at which it was measured.

The covariance of the parameters is right where the model is right. A real robot has errors that the model lacks, and the parameters absorb
part of them. Near the measured joint values this does no harm; far from them the parameters extrapolate it. The leverage of a pose, the
variance of its place by the parameters, measures how far it is away. Up to the leverage of the measured poses nothing is added. The rest
grows by a factor that blocks of the measurements show of each other (`judged.beyond`).
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import FloatArray


@dataclass(frozen=True)
class Beyond:
    """factor: of standard deviations; from_mm2: variance of all three coordinates together from which on it counts."""

    factor: float = 0.0
    from_mm2: float = 0.0

    def widened(self, covariance: FloatArray) -> FloatArray:
        """Covariances (N, 3, 3) [mm²] of places by the parameters, widened beyond the measured poses."""
        if not self.factor:
            return covariance
        size = np.maximum(np.einsum("nii->n", covariance), 1e-300)
        return np.asarray(covariance * (1.0 + self.factor**2 * np.maximum(1.0 - self.from_mm2 / size, 0.0))[:, None, None])


NOWHERE = Beyond()
"""A robot of which the model lacks nothing."""
