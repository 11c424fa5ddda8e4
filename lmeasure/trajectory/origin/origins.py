"""What channels count from, told by a run whose channels are redundant: start pose, phases of zeroing, zeros of encoders.

A reading is f(pose) less an origin that all samples share, plus its own error. What is known of the origins before is a few variables of
unit variance (`Budget.origins`): the start pose, if one was stated, else anything; where within a count each counter was zeroed; the zeros
of encoders. Of a sample counts what no motion of the tool makes: with N a basis of that, A^T N = 0, and V the readings' own variances,
P = N (N^T V N)^-1 N^T weighs residuals r. With the errors L of the readings by all shared variables, those of the origins (z) and all
others (y: calibration, drums, ...), the least squares of the run have the normal equations

    (1 + sum L^T P L) (z, y) = sum L^T P r,    C = (1 + sum L^T P L)^-1.

Only z is applied: y stays the calibration's business. So what is left over are errors of covariance C of z, 1 of y as before, and C between
the two, since what z absorbs of y errs with it. (Such y are consider parameters: Schmidt 1966.) As least squares and parities of one sample
do not correlate, what a pose errs by of its own stays independent of z.

The rounding of a count that stands still is one error, however often it is read: a reading that is repeated k times on end has k times its
variance. Where a channel moves on from sample to sample that is nothing.
"""

import numpy as np

from lmeasure.core import FloatArray, IntArray, symmetric_root
from lmeasure.trajectory.faults.redundancy import Epochs, repeats
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.uncertainty.sources import Told

MOST = 4096
"""Samples of a run that have a part in it, spread over it."""
CHUNK = 512
ROUNDS = 12
SETTLED = 1e-3
"""Of a standard uncertainty."""


def chosen(epochs: Epochs, most: int = MOST) -> Epochs:
    """Most of them at most, spread over the run."""
    return epochs.at(np.unique(np.linspace(0, len(epochs) - 1, min(len(epochs), most)).round().astype(np.intp)))


def learn(reconstruction: Reconstruction, epochs: Epochs, most: int = MOST) -> Told | None:
    """Find the origins of a run from its epochs, as `Reconstruction.examined` gives them, most of them at most, and have the reconstruction
    use them; None where nothing is uncertain of them or nothing tells."""
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    assert budget.told is None, "epochs are those of a reconstruction that has not learned"
    names = budget.origin_names
    epochs = chosen(epochs, most)
    if redundancy is None or not names or not len(epochs):
        return None
    loose = reconstruction.loose
    tells = np.isfinite(np.delete(epochs.change_mm, loose, axis=1)).any(axis=0)
    if tells.sum() < len(reconstruction.scheme.free):
        return None
    variance = epochs.variance_mm2 * repeats(epochs.gone_on_mm)
    columns = budget.origin_lengths(epochs.time_s)
    mean = _first(reconstruction, epochs, columns, loose) if len(loose) else np.zeros(columns.shape[2])
    known = np.zeros(len(epochs), np.bool_)
    C: FloatArray = np.eye(len(budget.sources))
    total, freedom, poses = np.nan, 0, np.full((len(epochs), 7), np.nan)
    o, whole = len(mean), np.zeros(len(budget.sources))
    for _ in range(ROUNDS):
        changes = epochs.change_mm - columns @ mean
        poses = reconstruction.solve_from_told(changes)
        known = np.isfinite(poses[:, 0])
        if not known.any():
            return None
        # the epochs are less what is supposed of the origins
        information, towards = np.eye(len(budget.sources)), np.concatenate([np.zeros(len(whole) - o), -budget.supposed])
        total, freedom = 0.0, 0
        for begin in range(0, len(epochs), CHUNK):
            part = np.flatnonzero(known[begin : begin + CHUNK]) + begin
            if not len(part):
                continue
            at, there = epochs.at(part), poses[part]
            used = np.isfinite(at.change_mm)
            L = redundancy.shared(at, there, used)
            basis, residual, own = redundancy.basis(there, used), redundancy.residuals(there, changes[part]), variance[part]
            r, P = redundancy.weighed(basis, np.where(used, residual, 0.0), np.where(used, own, 1.0))
            weighed = P @ L
            information += np.einsum("nmk,nml->kl", L, weighed)
            # what is applied already belongs to the data
            towards += np.einsum("nmk,nm->k", weighed, r + L[:, :, -o:] @ mean)
            total += float(np.einsum("nm,nmp,np->", r, P, r))
            freedom += int(np.maximum(used.sum(axis=1) - len(redundancy.free), 0).sum())
        C = np.asarray(np.linalg.inv(information))
        whole = np.asarray(C @ towards)
        new = whole[-o:]
        step, mean = np.abs(new - mean), new
        if (step <= SETTLED * np.sqrt(np.diag(C)[-o:])).all():
            break
    told = Told(budget.supposed + mean, _mixed(C, o), total, freedom, poses, C, whole[:-o])
    reconstruction.use(told)
    return told


def _mixed(C: FloatArray, o: int) -> FloatArray:
    """A root (K, K) of the covariance whose block of the other variables is 1: z = C_zy y + the rest of its own."""
    k = len(C) - o
    mix = np.eye(len(C))
    mix[k:, :k] = C[k:, :k]
    own = C[k:, k:] - C[k:, :k] @ C[:k, k:]
    mix[k:, k:] = symmetric_root((own + own.T) / 2.0)
    return mix


def _first(reconstruction: Reconstruction, epochs: Epochs, columns: FloatArray, loose: IntArray) -> FloatArray:
    """(o,) variables of the origins by which the loose channels agree with the poses that the others tell."""
    redundancy = reconstruction.redundancy
    assert redundancy is not None
    changes = epochs.change_mm.copy()
    changes[:, loose] = np.nan
    poses = reconstruction.solve_from_told(changes)
    known = np.isfinite(poses[:, 0])
    residual = redundancy.residuals(poses[known], epochs.change_mm[known])[:, loose]
    mean = np.zeros(columns.shape[2])
    for j, values in zip(loose, residual.T, strict=True):
        seen = values[np.isfinite(values)]
        if len(seen):
            column = int(np.argmax(np.abs(columns[0, j])))
            # a mean on the circle
            mean[column] = np.angle(np.exp(1j * seen).mean()) / columns[0, j, column]
    return mean
