"""From when to when a channel came to read from another origin, as a counter does that jumped, or slipped little by little.

The others tell the poses, and what they share with the channel in question: by them it errs by e at every sample, with a variance of its
own (rounding) and one that neighbours have in common (calibration). A channel that slipped errs by one constant up to some sample and by
another one from a later sample on: behind that it can be used again, from an origin that the run tells. When the one ended and the other
began is told by the likelihood of a ramp between the two, its extremes that are not much less likely than the best. One that hung comes
back to the constant it had; one that still errs otherwise at the end of the run goes on from none.
"""

from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.sensors import changes_from_counts
from lmeasure.trajectory.faults.redundancy import Epochs
from lmeasure.trajectory.origin.origins import learn
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction

BEYOND = 4.0
"""Standard uncertainties by which no sample, and no mean of a few, differs from the constant."""
FEW = 25
"""Samples of such a mean."""
LEAST = 50
"""Samples, and for so long, that a constant lasts."""
LEAST_S = 0.2
APART = 4.0
"""Standard uncertainties by which the two constants differ."""
LIKELY = 16.0
"""Chi-squared by which a ramp is worse than the best one at most."""
ENDS = 24
"""Places of either end of a ramp that are tried at once, again and again between those that are likely."""
ROUNDS = 3
"""In which a channel that is followed by itself is put right, by what it seems to be off by each time."""
MOST = 2048
"""Samples, or means of neighbours, by which they are tried."""


@dataclass(frozen=True)
class Moved:
    """Behind from_s a channel began to read otherwise, and behind after_s [s] it reads too much by so much more than before [mm, rad], of
    standard uncertainty u. Infinite and NaN where it does not come to another constant in time."""

    from_s: float
    after_s: float
    by: float
    u: float


def moved(reconstruction: Reconstruction, epochs: Epochs, j: int, since_s: float) -> Moved | None:
    """Of channel j, by a reconstruction that has learned nothing and the epochs of its run; since_s: up to when nothing speaks against it.
    None where it does not go on from another origin. The reconstruction has learned nothing afterwards."""
    seen, e, own, common, lost = _errors(reconstruction, epochs, epochs.without([j]), j)
    if len(seen) < 2 * LEAST:
        return None
    first, last = _between(e, own, common)
    # what a counter lost is a constant in counts, not in lengths
    for _ in range(ROUNDS if lost else 1):
        if not (first > 0 and last < len(e)):
            break
        by = _mean(e[last:], own[last:], common[last:])[0] - _mean(e[:first], own[:first], common[:first])[0]
        begin_s, end_s = float(epochs.time_s[seen[first - 1]]), float(epochs.time_s[seen[last]])
        begin_s = min(max(begin_s, since_s), end_s) if lost else begin_s
        right = _put_right(reconstruction, epochs, j, by, begin_s)
        if lost:
            # by the channel itself, now that it is known about how much it is off by
            meanwhile = (epochs.time_s > begin_s) & (epochs.time_s < end_s)
            change = right.change_mm.copy()
            change[meanwhile, j] = np.nan
            seen, e, own, common, _ = _errors(reconstruction, right, replace(right, change_mm=change), j)
            e = e + by * (epochs.time_s[seen] > begin_s)
        else:
            bent = epochs.gone_on_mm[seen, j] - right.gone_on_mm[seen, j] - by
            e = e - np.where(epochs.time_s[seen] > begin_s, bent, 0.0)
        first, last = _between(e, own, common)
    time_s = epochs.time_s[seen]
    least = [int(np.searchsorted(since, LEAST_S)) for since in (time_s - time_s[0], time_s[-1] - time_s[::-1])]
    if first < max(LEAST, least[0]) or not _constant(e[:first], own[:first], common[:first]):
        return None
    if len(e) - last < max(LEAST, least[1]) or not _constant(e[last:], own[last:], common[last:]):
        # near the place is not there: by that no channel is left out from earlier on
        return None if lost else Moved(float(time_s[first - 1]), np.inf, np.nan, np.nan)
    (before, u_before), (behind, u_behind) = (_mean(e[part], own[part], common[part]) for part in (slice(first), slice(last, None)))
    by, u = behind - before, float(np.hypot(u_before, u_behind))
    if abs(by) < APART * u:
        return None
    return Moved(float(time_s[first - 1]), float(np.nextafter(time_s[last], -np.inf)), by, u)


def _errors(
    reconstruction: Reconstruction, epochs: Epochs, without: Epochs, j: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, bool]:
    """Epochs (k,) at which the others tell by how much channel j errs, the error (k,) there, its standard uncertainties, its own (k,) and
    that in common (k,), and whether the others lose the way somewhere, because they tell no pose: there it is taken by all channels, which
    is near the place. without: the epochs by which the run is followed."""
    redundancy = reconstruction.redundancy
    assert redundancy is not None
    told = learn(reconstruction, without)
    offsets = reconstruction.budget.told_offsets(epochs.time_s)
    poses = reconstruction.solve_from_told(without.change_mm - offsets)
    lost = np.isnan(poses[:, 0])
    if lost.any():
        poses[lost] = reconstruction.solve_from_told(epochs.change_mm - offsets)[lost]
    used = np.isfinite(epochs.change_mm)
    used[:, j] = np.isfinite(epochs.gone_on_mm[:, j])
    o = 0 if told is None else len(told.mean)
    error, own, common = redundancy.error_of(j, epochs, poses, used, offsets=offsets, apart_from=o)
    reconstruction.use(None)
    seen = np.flatnonzero(used[:, j] & np.isfinite(error) & np.isfinite(poses[:, 0]))
    return seen, error[seen], own[seen], common[seen], bool(lost.any())


def _put_right(reconstruction: Reconstruction, epochs: Epochs, j: int, by: float, since_s: float) -> Epochs:
    """Epochs whose channel j shows behind a time as many counts less as make about a length or angle."""
    rig, behind = reconstruction.rig, epochs.time_s > since_s
    counts = epochs.counts.copy()
    counts[behind, j] -= by / rig.counter(rig.observed[j]).per_count
    by_counts = changes_from_counts(rig, counts, rig.observed)[:, j] - changes_from_counts(rig, epochs.counts, rig.observed)[:, j]
    change, gone_on = epochs.change_mm.copy(), epochs.gone_on_mm.copy()
    change[:, j] += by_counts
    gone_on[:, j] += by_counts
    return replace(epochs, change_mm=change, gone_on_mm=gone_on, counts=counts)


def _between(e: FloatArray, own: FloatArray, common: FloatArray) -> tuple[int, int]:
    """How many of the first of n errors, and from which on the last, are one constant each."""
    first, last = _ramp(e, 1.0 / (own**2 + common**2))
    # a ramp is not all that a channel may have done in between
    constant = _lasts(e, own, common), len(e) - _lasts(e[::-1], own[::-1], common[::-1])
    return (min(first, constant[0]), max(last, constant[1])) if constant[0] <= constant[1] else (first, last)


def _ramp(e: FloatArray, weight: FloatArray) -> tuple[int, int]:
    """Of n errors with weights (n,): how many of the first, and from which on the last, lie beside every ramp between two constants that is
    likely."""
    n = len(e)
    firsts, lasts = (0, n), (0, n)
    while True:
        begins, ends = (np.unique(np.linspace(*within, ENDS).round().astype(np.intp)) for within in (firsts, lasts))
        begin, end = (values.ravel() for values in np.meshgrid(begins, ends, indexing="ij"))
        good = end >= begin
        begin, end = begin[good], end[good]
        chi = _beside(e, weight, begin, end)
        likely = chi <= chi.min() + LIKELY
        new = []
        for values, chosen in ((begins, begin[likely]), (ends, end[likely])):
            k = np.searchsorted(values, [chosen.min(), chosen.max()])
            new.append((int(values[max(k[0] - 1, 0)]), int(values[min(k[1] + 1, len(values) - 1)])))
        if (new[0], new[1]) == (firsts, lasts) or (len(begins) == firsts[1] - firsts[0] + 1 and len(ends) == lasts[1] - lasts[0] + 1):
            return int(begin[likely].min()), int(end[likely].max())
        firsts, lasts = new[0], new[1]


def _beside(e: FloatArray, weight: FloatArray, begin: IntArray, end: IntArray) -> FloatArray:
    """(k,) chi-squared of n errors beside ramps from one constant, up to sample begin (k,), to another, from sample end (k,) on, less that
    of the errors."""
    inside = slice(int(begin.min()), int(end.max()))
    starts = np.arange(inside.start, inside.stop, max(1, -(-(inside.stop - inside.start) // MOST)))
    blocks = np.concatenate([[0], starts[starts > 0], [inside.stop] if inside.stop < len(e) else []]).astype(np.intp)
    blocks = np.unique(blocks)
    w, we = np.add.reduceat(weight, blocks), np.add.reduceat(weight * e, blocks)
    at = 0.5 * (blocks + np.append(blocks[1:], len(e)) - 1.0)
    s = np.clip((at - begin[:, None] + 1.0) / (end - begin + 1.0)[:, None], 0.0, 1.0)
    s[:, at < inside.start], s[:, at >= inside.stop] = 0.0, 1.0
    A, B, C = (w * (1.0 - s) ** 2).sum(axis=1), (w * s * (1.0 - s)).sum(axis=1), (w * s**2).sum(axis=1)
    p, q = (we * (1.0 - s)).sum(axis=1), (we * s).sum(axis=1)
    determinant = A * C - B * B
    sound = determinant > 1e-12 * A * C
    gain = (C * p * p - 2.0 * B * p * q + A * q * q) / np.where(sound, determinant, 1.0)
    return np.asarray(-np.where(sound, gain, we.sum() ** 2 / w.sum()))


def _lasts(e: FloatArray, own: FloatArray, common: FloatArray) -> int:
    """How many of the first of n errors are one constant."""
    good, bad = 0, len(e) + 1
    while bad - good > 1:
        middle = (good + bad) // 2
        if _constant(e[:middle], own[:middle], common[:middle]):
            good = middle
        else:
            bad = middle
    return good


def _constant(e: FloatArray, own: FloatArray, common: FloatArray) -> bool:
    """Whether errors (n,) are one, neither single ones nor the mean of the last few differing from it."""
    mean = _mean(e, own, common)[0]
    single: bool = bool((np.abs(e - mean) <= BEYOND * np.hypot(own, common)).all())
    few = slice(max(0, len(e) - FEW), None)
    u = float(np.hypot(own[few].mean() / np.sqrt(len(e[few])), common[few].mean()))
    return single and bool(abs(e[few].mean() - mean) <= BEYOND * u)


def _mean(e: FloatArray, own: FloatArray, common: FloatArray) -> tuple[float, float]:
    weight = 1.0 / (own**2 + common**2)
    mean = float((weight * e).sum() / weight.sum())
    return mean, float(np.sqrt(1.0 / (1.0 / own**2).sum() + common.min() ** 2))
