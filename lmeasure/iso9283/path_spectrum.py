"""Deviations along a path, as likely as the measured ones: what the errors have added is taken away frequency by frequency.

Errors of single crossings scatter from plane to plane; a robot's deviations go on over several. Among cosines along the path the errors
of crossings have the same power at every frequency, systematic ones the lowest alone, and a robot's power falls with frequency. What is
observed less what the errors add is therefore averaged, by isotonic regression, to a power that falls (Barlow et al., Statistical Inference
under Order Restrictions, 1972), and every wave made as large as that: the estimate of an unknown spectrum under known noise.
"""

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray

KNOWN = 1e-9
"""Waves whose errors have less than as much of the largest power are exact: directions that a plane does not have."""


def cosines(stretch: IntArray) -> FloatArray:
    """(q, q) orthonormal rows by rising frequency: cosines along each stretch of a path between corners, where deviations may jump;
    stretch (q,): number of that in which each place stands."""
    sizes = np.unique(stretch, return_counts=True)[1]
    rows = scipy.linalg.block_diag(*(scipy.fft.dct(np.eye(k), axis=0, norm="ortho") for k in sizes))
    frequency = np.concatenate([np.arange(k) / k for k in sizes])
    return np.asarray(rows[np.argsort(frequency, kind="stable")])


def reduced(waves: FloatArray, added: FloatArray, freedom: int, doubt: float) -> FloatArray:
    """Waves (q, r, c) by rising frequency, of r cycles with that many degrees of freedom, reduced to the power that they have without what
    errors have added (q, c).

    A power of k degrees of freedom is known to sqrt((2 E^2 + 4 E S) / k), E of the errors, S without them: it is taken smaller by doubt
    times as much, for the less the robot deviates in truth, the more the errors enlarge figures made of it.
    """
    power = (waves**2).sum(axis=1) / freedom
    out = waves.copy()
    for i in range(waves.shape[2]):
        unknown = added[:, i] > KNOWN * added[:, i].max()
        if not unknown.any():
            continue
        of_errors = added[unknown, i]
        fitted = scipy.optimize.isotonic_regression(power[unknown, i] - of_errors, weights=of_errors**-2.0, increasing=False)
        sizes = np.diff(fitted.blocks)
        mean = np.repeat(np.add.reduceat(of_errors, fitted.blocks[:-1]) / sizes, sizes)
        true = np.maximum(fitted.x, 0.0)
        least = true - doubt * np.sqrt((2.0 * mean**2 + 4.0 * mean * true) / (np.repeat(sizes, sizes) * freedom))
        out[unknown, :, i] *= np.sqrt(np.maximum(least, 0.0) / (true + mean))[:, None]
    return out
