"""Reliability of redundant channels as geodesists state it (Baarda, A testing procedure for use in geodetic networks, 1968).

With A the rows of a sample's channels, P their weights and G = (A^T P A)^-1 A^T P, a reading's *redundancy number* is r_j = 1 - (A G)_jj:
the part of an error of it that shows in its own residual; they sum to the number of channels to spare. Let W be the weight of the
contradictions (`redundancy`, with everything that the readings share in their covariance). The error that channel j alone would have is
told with the variance 1/W_jj, so the smallest fault that a test of significance alpha finds with a power is

    m_j = (z(1 - alpha/2) + z(power)) / sqrt(W_jj)

(*internal reliability*), and one that is just not found moves the pose by G_j m_j (*external reliability*). The statistics of two channels
correlate by rho = W_jk / sqrt(W_jj W_kk): near 1 a fault of either looks like one of the other (Foerstner 1983). Without channel k that of
j weighs W_jj (1 - rho^2), by the Schur complement: so a fault of m_j / sqrt(1 - rho^2) is found even where k is left out, and told apart
from one of k. The smallest that is told apart from every other is that of the largest rho.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from lmeasure.core import BoolArray, FloatArray
from lmeasure.kernels import span_rows_of
from lmeasure.rig import Rig
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.redundancy import Epochs
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction

ALPHA, POWER = 1e-3, 0.8
"""Baarda's: of a single sample and channel."""
SHIFT = float(ndtri(POWER) - ndtri(ALPHA / 2.0))
"""Standard uncertainties of the smallest fault that is found: 4.13."""
PLACES = 64
"""Samples of a run, spread over it, at which it is worked out."""


APART = 1e-9
"""Of 1 - rho^2 from which two channels are not one."""
UNCONTROLLED = 1e-9
"""Of a channel's own weight that must be left of it."""


@dataclass(frozen=True)
class Faults:
    """smallest, apart (n, m): smallest fault of a channel that is found, and that is told apart from one of any other, infinite where there
    is none; correlation (n, m, m) of the channels' tests, NaN where one is not controlled."""

    smallest: FloatArray
    apart: FloatArray
    correlation: FloatArray


def faults_shown(weight: FloatArray, controlled: BoolArray | None = None) -> Faults:
    """By the weights W (n, m, m) of contradictions; controlled (n, m): channels that the others control, those with more than rounding of a
    weight, in units of which readings scatter by about 1, where it is None."""
    diagonal = np.einsum("njj->nj", weight)
    controlled = diagonal > UNCONTROLLED if controlled is None else controlled
    root = np.sqrt(np.where(controlled, diagonal, np.nan))
    smallest = np.where(controlled, SHIFT / np.where(controlled, root, 1.0), np.inf)
    correlation = weight / (root[:, :, None] * root[:, None, :])
    others = np.nan_to_num(correlation**2) * (1.0 - np.eye(weight.shape[1]))
    left = 1.0 - others.max(axis=2)
    return Faults(smallest, np.where(left > APART, smallest / np.sqrt(np.maximum(left, APART)), np.inf), correlation)


@dataclass(frozen=True)
class Reliability:
    """At n samples of m channels: redundancy number (n, m); smallest fault that is found (n, m) [mm, rad], and that is told apart from one
    of any other channel, infinite where nothing controls a channel; effect (n, m) on the tool's place [mm] of one that is just not
    found; correlation (n, m, m) of the channels' tests, NaN where a channel is not controlled. NaN of a channel that is not used."""

    time_s: FloatArray
    redundancy: FloatArray
    smallest: FloatArray
    apart: FloatArray
    effect_mm: FloatArray
    correlation: FloatArray


def reliability(reconstruction: Reconstruction, epochs: Epochs, poses: FloatArray) -> Reliability:
    """Of epochs at poses (n, 7), NaN where there is none."""
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    assert redundancy is not None
    known = np.isfinite(poses[:, 0])
    epochs, poses = epochs.at(known), np.ascontiguousarray(poses[known])
    used = np.isfinite(epochs.change_mm)
    weight = redundancy.parities(epochs, poses).weight
    G = budget.twists(poses, np.where(used, epochs.counts, np.nan), ~used, True)
    rows = span_rows_of(budget.scheme.rows, poses)
    diagonal = np.einsum("njj->nj", weight)
    controlled = used & (diagonal > 0.0)
    shown = faults_shown(weight, controlled)
    smallest, apart = (np.where(used, values, np.nan) for values in (shown.smallest, shown.apart))
    number = np.where(used, 1.0 - np.einsum("njc,ncj->nj", rows, G), np.nan)
    with np.errstate(invalid="ignore"):
        effect = np.linalg.norm(G[:, 3:], axis=1) * smallest
    return Reliability(epochs.time_s, number, smallest, apart, effect, shown.correlation)


def reliability_of_run(reconstruction: Reconstruction, epochs: Epochs) -> Reliability | None:
    """Return the reliability at `PLACES` samples of a run; None where no channel is to spare or no pose is known."""
    if reconstruction.redundancy is None or not len(epochs):
        return None
    epochs = epochs.at(np.unique(np.linspace(0, len(epochs) - 1, min(len(epochs), PLACES)).round().astype(np.intp)))
    poses = reconstruction.poses_of(epochs.change_mm - reconstruction.budget.estimated_offsets(epochs.time_s))
    found = reliability(reconstruction, epochs, poses)
    return found if len(found.time_s) else None


def reliability_notes(rig: Rig, found: Reliability | None) -> tuple[Message, ...]:
    """Return the least redundancy number with the largest fault that is not found, and the smallest faults that are told apart."""
    return () if found is None else (_largest_fault(rig, found), _smallest_faults(rig, found))


def _largest_fault(rig: Rig, found: Reliability) -> Message:
    """In a line: the least redundancy number, the largest fault that is not found, what it does to the tool, and which two channels are
    hardest to tell apart."""
    observed = rig.observed
    names = [o.name for o in observed]
    number = np.where(np.isnan(found.redundancy), np.inf, found.redundancy)
    least = int(np.argmin(number.min(axis=0)))
    effect = np.where(np.isnan(found.effect_mm), -np.inf, found.effect_mm)
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(effect)), effect.shape))
    size = float(found.smallest[i, j])
    length = observed[j].is_length
    about = {
        "alpha": 100.0 * ALPHA,
        "power": 100.0 * POWER,
        "number": max(float(number.min()), 0.0),
        "least": names[least],
        "channel": names[j],
        "s": float(found.time_s[i]),
        "effect_mm": float(effect[i, j]),
    }
    if not np.isfinite(size):
        return message("reliability.uncontrolled", channel=names[j], s=float(found.time_s[i]))
    alike = np.abs(found.correlation)
    with np.errstate(invalid="ignore"):
        worst = np.nan_to_num(alike).max(axis=0)
    np.fill_diagonal(worst, 0.0)
    a, b = (int(k) for k in np.unravel_index(int(np.argmax(worst)), worst.shape))
    pair = {"one": names[min(a, b)], "other": names[max(a, b)], "correlation": float(worst[a, b])}
    if length:
        return message("reliability.length", **about, **pair, mm=size)
    return message("reliability.angle", **about, **pair, deg=float(np.degrees(size)))


def _smallest_faults(rig: Rig, found: Reliability) -> Message:
    """In a line: of every channel the smallest fault that a sample tells apart from one of any other, at the best and the worst of them."""
    told = []
    for o, sizes in zip(rig.observed, found.apart.T, strict=True):
        seen = sizes[~np.isnan(sizes)]
        if not np.isfinite(seen).any():
            told.append(message("reliability.apart.never", channel=o.name))
            continue
        kind, unit, per = ("length", "mm", 1.0) if o.is_length else ("angle", "deg", float(np.degrees(1.0)))
        size = {f"least_{unit}": float(seen.min()) * per}
        if np.isinf(seen).any():
            told.append(message(f"reliability.apart.{kind}.partly", channel=o.name, **size))
        else:
            told.append(message(f"reliability.apart.{kind}", channel=o.name, **size, **{f"most_{unit}": float(seen.max()) * per}))
    return message("reliability.apart", alpha=100.0 * ALPHA, power=100.0 * POWER, channels=tuple(told))
