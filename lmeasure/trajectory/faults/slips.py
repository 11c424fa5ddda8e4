"""Whether a channel slipped in a run whose origins were found: too little for any single sample to show, but all of them together do.

Suppose one channel j reads b too much behind a time t. By the weights P of the samples (`origins`) its score is
s = sum (P (r - L y))_j over the samples behind t, with y what the run says of calibration, drums and the like: it is applied to no pose,
and left in the readings it would pass for steps. What b has in common with all that the run shares, C, leaves it the information
I = sum P_jj - g^T C g with g = sum (L^T P)_j. Then s^2/I is chi-squared of one degree of freedom where nothing slipped, whatever channel
and time are asked about (Baarda's data snooping, 1968, with a step as the error).
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.trajectory.faults.redundancy import Epochs, repeats
from lmeasure.trajectory.origin.origins import CHUNK, chosen
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.uncertainty.sources import Told

SLIPPED = 40.0
"""Chi-squared from which a step is none of rounding: once in 3e9 for one channel and time, of which a run has some ten thousand."""
CLEARER = 16.0
"""Chi-squared by which no other channel may explain as much, at any time: four standard uncertainties."""
LEAST = 1e-3
"""Of the information without what the run shares: what is left of less is rounding."""


@dataclass(frozen=True)
class Slip:
    """A step of a channel (index) at some time behind from_s and up to after_s [s], by so much [mm, rad] with its standard uncertainty;
    others (k,): channels that explain the readings as well, nothing where it is certain."""

    channel: int
    from_s: float
    after_s: float
    by: float
    u: float
    others: tuple[int, ...]


def slip(reconstruction: Reconstruction, epochs: Epochs, told: Told) -> Slip | None:
    """The most significant step of a run, epochs being those that told of its origins; None where none is."""
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    assert redundancy is not None
    epochs = chosen(epochs)
    m, K = epochs.change_mm.shape[1], len(told.covariance)
    known = np.flatnonzero(np.isfinite(told.poses[:, 0]))
    variance = epochs.variance_mm2 * repeats(epochs.gone_on_mm)
    changes = epochs.change_mm - budget.told_offsets(epochs.time_s)
    score, own, common = np.zeros((len(known), m)), np.zeros((len(known), m)), np.zeros((len(known), m, K))
    for begin in range(0, len(known), CHUNK):
        part = known[begin : begin + CHUNK]
        at, there, out = epochs.at(part), told.poses[part], slice(begin, begin + len(part))
        used = np.isfinite(at.change_mm)
        r, P = redundancy.weighed(
            redundancy.basis(there, used),
            np.where(used, redundancy.residuals(there, changes[part]), 0.0),
            np.where(used, variance[part], 1.0),
        )
        P = np.where(used[:, :, None] & used[:, None, :], P, 0.0)
        score[out], own[out] = np.einsum("nmp,np->nm", P, r), np.einsum("nmm->nm", P)
        common[out] = P @ redundancy.shared(at, there, used)
        score[out] -= common[out, :, : len(told.aside)] @ told.aside
    behind, information, g = (_behind(values) for values in (score, own, common))
    left = information - np.einsum("nmk,kl,nml->nm", g, told.covariance, g)
    enough = left > LEAST * information.max(axis=0, initial=1e-300)
    # a step behind no sample, or before the first, is none
    enough[:1] = False
    gain = np.where(enough, behind**2 / np.where(enough, left, 1.0), 0.0)
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(gain)), gain.shape))
    if not gain[i, j] >= SLIPPED:
        return None
    best = gain.max(axis=0)
    others = tuple(int(k) for k in np.flatnonzero(best > gain[i, j] - CLEARER) if k != j)
    unit = float(redundancy.unit[j])
    size, u = float(behind[i, j] / left[i, j]) * unit, float(left[i, j] ** -0.5) * unit
    likely = np.flatnonzero(gain[:, j] < gain[i, j] - CLEARER)
    first = int(likely[likely < i].max(initial=0)) + 1
    last = int(likely[likely > i].min(initial=len(known))) - 1
    time_s = epochs.time_s[known]
    return Slip(j, float(time_s[first - 1]), float(np.nextafter(time_s[last], -np.inf)), size, u, others)


def _behind(values: FloatArray) -> FloatArray:
    """Sums over each sample and all behind it."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])
