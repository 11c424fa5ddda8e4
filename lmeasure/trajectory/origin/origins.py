"""Origins of channels, determined by a run whose channels are redundant: start pose, phases of zeroing, zeros of encoders.

A reading is f(pose) minus an origin that all samples share, plus its own error. The prior of the origins is a few variables of unit
variance (`Budget.origins`): the start pose, if stated, else any; the sub-count offset of each counter at zeroing; the zeros of encoders. A
sample's information is the part that no motion of the tool makes: with N a basis of that, A^T N = 0, and V the readings' own variances, P =
N (N^T V N)^-1 N^T weighs residuals r. With the errors L of the readings by all shared variables, those of the origins (z) and all others
(y: calibration, drums, ...), the least squares of the run have the normal equations

    (1 + sum L^T P L) (z, y) = sum L^T P r,    C = (1 + sum L^T P L)^-1.

Only z is applied: y stays the calibration's business. The remaining errors have the covariance C of z, 1 of y as before, and C between the
two, since z absorbs a part of y. (Such y are consider parameters: Schmidt 1966.) As least squares and parities of one sample do not
correlate, the own error of a pose stays independent of z.

The rounding of an unchanged count is one error, however often it is read: a reading repeated k times in a row has k times its variance. A
channel that moves from sample to sample is not affected.

A channel may change its origin, as a counter that jumped or slipped little by little. The others determine the poses and so the error e of
this channel at every sample, with a variance of its own (rounding) and a common one of neighbours (calibration). A channel that slipped has
one constant error up to some sample and another one from a later sample on: behind that it can be used again, from an origin that the run
determines. The likelihood of a ramp between the two determines the end of the one and the beginning of the other, by extremes that are not
much less likely than the best. A cable that hung returns to its former constant; a channel with changing errors at the end of the run has
no new origin.

A channel may slip too little for any single sample to show it, while all of them together do. Let channel j read b too much behind a time
t. By the weights P of the samples (`origins`) its score is s = sum (P (r - L y))_j over the samples behind t, with y the run's estimate for
calibration, drums and the like: it is applied to no pose, but without it the readings would show steps. Correlation C of b with the run's
common variables leaves the information I = sum P_jj - g^T C g with g = sum (L^T P)_j. Then s^2/I is chi-squared of one degree of freedom
where nothing slipped, for any channel and time (Baarda's data snooping, 1968, with a step as the error).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmeasure.core import FloatArray, IntArray, Status, symmetric_root
from lmeasure.rig import Observed, Rig
from lmeasure.sensors import Lengths, changes_from_counts, channel_message
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.consistency import IN_TIME, collect_epochs, consistent
from lmeasure.trajectory.faults.continuity import EVERY, Doubt, Doubts, Shift
from lmeasure.trajectory.faults.redundancy import Epochs, repeats
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.uncertainty.sources import ANYWHERE, UNKNOWN_MM, OriginEstimate

MOST = 4096  # Samples of a run that have a part in it, spread over it
CHUNK = 512
ROUNDS = 12
SETTLED = 1e-3  # Of a standard uncertainty


def chosen(epochs: Epochs, most: int = MOST) -> Epochs:
    """Most of them at most, spread over the run."""
    return epochs.at(np.unique(np.linspace(0, len(epochs) - 1, min(len(epochs), most)).round().astype(np.intp)))


def estimate_origins(reconstruction: Reconstruction, epochs: Epochs, most: int = MOST) -> OriginEstimate | None:
    """Estimate the origins of a run from its epochs, most of them at most, by a reconstruction that has no estimate yet; None where nothing
    is uncertain of them or nothing determines them."""
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    assert budget.estimate is None, "epochs are those of a reconstruction without an estimate"
    names = budget.origin_names
    epochs = chosen(epochs, most)
    if redundancy is None or not names or not len(epochs):
        return None
    loose = reconstruction.model.loose_zeros
    tells = np.isfinite(np.delete(epochs.change_mm, loose, axis=1)).any(axis=0)
    if tells.sum() < len(budget.scheme.free):
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
        poses = reconstruction.poses_of(changes)
        known = np.isfinite(poses[:, 0])
        if not known.any():
            return None
        # the assumed origins are subtracted from the epochs
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
            # applied corrections belong to the data
            towards += np.einsum("nmk,nm->k", weighed, r + L[:, :, -o:] @ mean)
            total += float(np.einsum("nm,nmp,np->", r, P, r))
            freedom += int(np.maximum(used.sum(axis=1) - len(redundancy.free), 0).sum())
        C = np.asarray(np.linalg.inv(information))
        whole = np.asarray(C @ towards)
        new = whole[-o:]
        step, mean = np.abs(new - mean), new
        if (step <= SETTLED * np.sqrt(np.diag(C)[-o:])).all():
            break
    return OriginEstimate(budget.supposed + mean, _mixed(C, o), total, freedom, poses, C, whole[:-o])


def _mixed(C: FloatArray, o: int) -> FloatArray:
    """A root (K, K) of the covariance whose block of the other variables is 1: z = C_zy y + the rest of its own."""
    k = len(C) - o
    mix = np.eye(len(C))
    mix[k:, :k] = C[k:, :k]
    own = C[k:, k:] - C[k:, :k] @ C[:k, k:]
    mix[k:, k:] = symmetric_root((own + own.T) / 2.0)
    return mix


def _first(reconstruction: Reconstruction, epochs: Epochs, columns: FloatArray, loose: IntArray) -> FloatArray:
    """Return (o,) variables of the origins by which the loose channels agree with the poses of the others."""
    redundancy = reconstruction.redundancy
    assert redundancy is not None
    changes = epochs.change_mm.copy()
    changes[:, loose] = np.nan
    poses = reconstruction.poses_of(changes)
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


BEYOND = 4.0  # Largest difference of a sample, or a mean of a few, from the constant, in standard uncertainties
FEW = 25  # Samples of such a mean
LEAST_CONSTANT = 50  # Samples, and for so long, that a constant lasts
LEAST_S = 0.2
APART = 4.0  # Least difference of the two constants, in standard uncertainties
LIKELY = 16.0  # Largest excess of chi-squared of a ramp over the best one
ENDS = 24  # Places of either end of a ramp that are tried at once, again and again between those that are likely
CHANGE_ROUNDS = 3  # Rounds of correction of a channel that is followed by itself
MOST_ERRORS = 2048  # Samples, or means of neighbours, for their test


@dataclass(frozen=True)
class OriginChange:
    """Behind from_s a channel began to read otherwise, and behind after_s [s] it reads too much by so much more than before [mm, rad], of
    standard uncertainty u. Infinite and NaN where it does not come to another constant in time."""

    from_s: float
    after_s: float
    by: float
    u: float


def origin_change(reconstruction: Reconstruction, epochs: Epochs, j: int, since_s: float) -> OriginChange | None:
    """Find the change of channel j, by a reconstruction without an estimate and the epochs of its run; since_s: time up to which nothing
    contradicts it. None if it does not continue from another origin."""
    seen, e, own, common, lost = _errors(reconstruction, epochs, epochs.excluding([j]), j)
    if len(seen) < 2 * LEAST_CONSTANT:
        return None
    first, last = _between(e, own, common)
    # lost counts are constant in counts, not in lengths
    for _ in range(CHANGE_ROUNDS if lost else 1):
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
    if first < max(LEAST_CONSTANT, least[0]) or not _constant(e[:first], own[:first], common[:first]):
        return None
    if len(e) - last < max(LEAST_CONSTANT, least[1]) or not _constant(e[last:], own[last:], common[last:]):
        # near the place is not there: by that no channel is left out from earlier on
        return None if lost else OriginChange(float(time_s[first - 1]), np.inf, np.nan, np.nan)
    (before, u_before), (behind, u_behind) = (_mean(e[part], own[part], common[part]) for part in (slice(first), slice(last, None)))
    by, u = behind - before, float(np.hypot(u_before, u_behind))
    if abs(by) < APART * u:
        return None
    return OriginChange(float(time_s[first - 1]), float(np.nextafter(time_s[last], -np.inf)), by, u)


def _errors(
    reconstruction: Reconstruction, epochs: Epochs, others: Epochs, j: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, bool]:
    """Return epochs (k,) at which the others determine the error of channel j, the error (k,) there, its standard uncertainties, its own
    (k,) and the common one (k,), and whether the others determine no pose somewhere: there the nearby pose from all channels is used.
    others: the epochs by which the run is followed."""
    estimate = estimate_origins(reconstruction, others)
    reconstruction = reconstruction.with_estimate(estimate)
    redundancy = reconstruction.redundancy
    assert redundancy is not None
    offsets = reconstruction.budget.estimated_offsets(epochs.time_s)
    poses = reconstruction.poses_of(others.change_mm - offsets)
    lost = np.isnan(poses[:, 0])
    if lost.any():
        poses[lost] = reconstruction.poses_of(epochs.change_mm - offsets)[lost]
    used = np.isfinite(epochs.change_mm)
    used[:, j] = np.isfinite(epochs.gone_on_mm[:, j])
    o = 0 if estimate is None else len(estimate.mean)
    error, own, common = redundancy.error_of(j, epochs, poses, used, offsets=offsets, apart_from=o)
    seen = np.flatnonzero(used[:, j] & np.isfinite(error) & np.isfinite(poses[:, 0]))
    return seen, error[seen], own[seen], common[seen], bool(lost.any())


def _put_right(reconstruction: Reconstruction, epochs: Epochs, j: int, by: float, since_s: float) -> Epochs:
    """Epochs whose channel j shows behind a time as many counts less as make about a length or angle."""
    rig, behind = reconstruction.model.rig, epochs.time_s > since_s
    counts = epochs.counts.copy()
    counts[behind, j] -= by / rig.counter(rig.observed[j]).per_count
    by_counts = changes_from_counts(rig, counts, rig.observed)[:, j] - changes_from_counts(rig, epochs.counts, rig.observed)[:, j]
    change, gone_on = epochs.change_mm.copy(), epochs.gone_on_mm.copy()
    change[:, j] += by_counts
    gone_on[:, j] += by_counts
    return replace(epochs, change_mm=change, gone_on_mm=gone_on, counts=counts)


def _between(e: FloatArray, own: FloatArray, common: FloatArray) -> tuple[int, int]:
    """Return how many of the first of n errors, and from which on the last, are one constant each."""
    first, last = _ramp(e, 1.0 / (own**2 + common**2))
    # a ramp is not all that a channel may have done in between
    constant = _lasts(e, own, common), len(e) - _lasts(e[::-1], own[::-1], common[::-1])
    return (min(first, constant[0]), max(last, constant[1])) if constant[0] <= constant[1] else (first, last)


def _ramp(e: FloatArray, weight: FloatArray) -> tuple[int, int]:
    """Return, for n errors with weights (n,): how many of the first, and from which on the last, lie beside every ramp between two
    constants that is likely."""
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
    starts = np.arange(inside.start, inside.stop, max(1, -(-(inside.stop - inside.start) // MOST_ERRORS)))
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
    """Return how many of the first of n errors are one constant."""
    good, bad = 0, len(e) + 1
    while bad - good > 1:
        middle = (good + bad) // 2
        if _constant(e[:middle], own[:middle], common[:middle]):
            good = middle
        else:
            bad = middle
    return good


def _constant(e: FloatArray, own: FloatArray, common: FloatArray) -> bool:
    """Return whether errors (n,) are one constant: neither single ones nor the mean of the last few differ from it."""
    mean = _mean(e, own, common)[0]
    single: bool = bool((np.abs(e - mean) <= BEYOND * np.hypot(own, common)).all())
    few = slice(max(0, len(e) - FEW), None)
    u = float(np.hypot(own[few].mean() / np.sqrt(len(e[few])), common[few].mean()))
    return single and bool(abs(e[few].mean() - mean) <= BEYOND * u)


def _mean(e: FloatArray, own: FloatArray, common: FloatArray) -> tuple[float, float]:
    weight = 1.0 / (own**2 + common**2)
    mean = float((weight * e).sum() / weight.sum())
    return mean, float(np.sqrt(1.0 / (1.0 / own**2).sum() + common.min() ** 2))


SLIPPED = 40.0
"""Chi-squared from which a step is not rounding: once in 3e9 for one channel and time, of some ten thousand in a run."""
CLEARER = 16.0  # Least advantage in chi-squared over any other channel at any time: four standard uncertainties
LEAST_INFORMATION = 1e-3  # Relative to the information without shared errors: less is rounding


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


def slip(reconstruction: Reconstruction, epochs: Epochs) -> Slip | None:
    """Find the most significant step of a run, epochs being those of the estimate of its origins; None without one."""
    redundancy, budget, estimate = reconstruction.redundancy, reconstruction.budget, reconstruction.budget.estimate
    assert redundancy is not None
    assert estimate is not None
    # the covariance of the estimate is that of the variables before it: once it is used, those of the origins are mixed
    variables = reconstruction.with_estimate(None).redundancy
    assert variables is not None
    epochs = chosen(epochs)
    m, K = epochs.change_mm.shape[1], len(estimate.covariance)
    known = np.flatnonzero(np.isfinite(estimate.poses[:, 0]))
    variance = epochs.variance_mm2 * repeats(epochs.gone_on_mm)
    changes = epochs.change_mm - budget.estimated_offsets(epochs.time_s)
    score, own, common = np.zeros((len(known), m)), np.zeros((len(known), m)), np.zeros((len(known), m, K))
    for begin in range(0, len(known), CHUNK):
        part = known[begin : begin + CHUNK]
        at, there, out = epochs.at(part), estimate.poses[part], slice(begin, begin + len(part))
        used = np.isfinite(at.change_mm)
        residual = np.where(used, redundancy.residuals(there, changes[part]), 0.0)
        r, P = redundancy.weighed(redundancy.basis(there, used), residual, np.where(used, variance[part], 1.0))
        P = np.where(used[:, :, None] & used[:, None, :], P, 0.0)
        score[out], own[out] = np.einsum("nmp,np->nm", P, r), np.einsum("nmm->nm", P)
        common[out] = P @ variables.shared(at, there, used)
        score[out] -= common[out, :, : len(estimate.aside)] @ estimate.aside
    # sums over each sample and all behind it
    behind, information, g = (np.cumsum(values[::-1], axis=0)[::-1] for values in (score, own, common))
    left = information - np.einsum("nmk,kl,nml->nm", g, estimate.covariance, g)
    enough = left > LEAST_INFORMATION * information.max(axis=0, initial=1e-300)
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


STEPPED = "origin.stepped"
UNDETERMINED = "origin.untold"  # Of a channel whose new origin the run does not determine
HARDLY = 0.5  # Relative to the uncertainty of an origin before the run: above it the run did not determine the origin
DOUBTED = (Status.INCONSISTENT, Status.ORIGIN_LOST)
OF_NOBODY = frozenset({*(IN_TIME[code] for code in IN_TIME if code.startswith("contradiction")), "rig.uncalibrated", "passes.not_repeated"})
LEFT_OUT = (IN_TIME["cable.left_out"], IN_TIME["cable.left_out.unknown"])
SLIPS = 8  # Found one after the other

Pieces = Callable[[Doubts], Iterable[Lengths]]  # The lengths of a run, piece by piece, without the doubtful ones


def settle_origins(reconstruction: Reconstruction, pieces: Pieces) -> tuple[Reconstruction, Epochs]:
    """Return the reconstruction of a run with redundant channels after estimating its origins, searching slips and judging restored
    channels, and the epochs used."""
    rig = reconstruction.model.rig
    reconstruction = _changed_origins(_restored(reconstruction.with_estimate(None)), pieces)
    for _ in range(SLIPS):
        reconstruction, epochs = _estimated(reconstruction, pieces)
        budget, found = reconstruction.budget, reconstruction.doubts
        # with drums alone every sample is equally informative, and calibration errors over many samples would look like slips
        if budget.estimate is None or not budget.absolute.any():
            break
        # so would early readings of a channel that hung undetected
        slipped = slip(reconstruction, epochs.excluding(_wrong(reconstruction)))
        if slipped is None:
            break
        reconstruction = reconstruction.with_estimate(None)
        again = any(cable == slipped.channel for cable, _, _ in budget.restored)
        change = None
        if not (slipped.others or budget.absolute[slipped.channel] or again):
            change = origin_change(reconstruction, epochs.excluding(_wrong(reconstruction)), slipped.channel, slipped.from_s)
        if change is None or np.isinf(change.after_s):
            reconstruction = replace(reconstruction, doubts=_with_slip(found, slipped, rig))
        else:
            after_s = max(slipped.after_s, change.after_s)
            why = _sized("slip", rig.observed[slipped.channel], change.by, change.u)
            found = _meanwhile(found, slipped.channel, min(slipped.from_s, change.from_s), after_s, why)
            found = replace(found, shifts=(*found.shifts, _shift(rig, slipped.channel, after_s, by=change.by)))
            reconstruction = replace(reconstruction, budget=reconstruction.budget.with_restored(slipped.channel, after_s), doubts=found)
    if unknown := _undetermined(reconstruction):
        reconstruction, epochs = _estimated(replace(reconstruction, doubts=reconstruction.doubts.with_more(*unknown)), pieces)
    if reconstruction.budget.restored:
        # a continued channel must agree with the others, which may have reached another assembly mode without it
        judged = _except_contradictions(reconstruction.doubts)
        after = consistent(reconstruction, pieces(judged), judged)
        if after is not reconstruction.doubts:
            reconstruction, epochs = _estimated(replace(reconstruction, doubts=after), pieces)
        found = reconstruction.doubts
        notes = (*found.notes, *_restored_notes(reconstruction))
        reconstruction = replace(reconstruction, doubts=replace(found, notes=notes))
    return reconstruction, epochs


def _estimated(reconstruction: Reconstruction, pieces: Pieces) -> tuple[Reconstruction, Epochs]:
    """Estimate the origins of a run, and add the shifts of channels with a changed origin to its doubts."""
    while True:
        reconstruction, doubts = reconstruction.with_estimate(None), reconstruction.doubts
        epochs = collect_epochs(reconstruction, pieces(doubts))[0]
        reconstruction = reconstruction.with_estimate(estimate_origins(reconstruction, epochs))
        known = {(s.cable, s.after_s) for s in doubts.shifts}
        new = tuple(
            _shift(reconstruction.model.rig, cable, after_s, until_s, by=by)
            for cable, after_s, until_s, by, _ in reconstruction.budget.restored_origins()
            if (cable, after_s) not in known
        )
        if not any(s.counts for s in new):
            return reconstruction, epochs
        reconstruction = replace(reconstruction, doubts=replace(doubts, shifts=(*doubts.shifts, *new)))


def _shift(rig: Rig, channel: int, after_s: float, until_s: float = np.inf, *, by: float) -> Shift:
    """Return the correction of a channel's counts behind a time, for a length or an angle by which it reads too much."""
    return Shift(channel, after_s, until_s, float(np.rint(by / rig.counter(rig.observed[channel]).per_count)))


def _undetermined(reconstruction: Reconstruction) -> list[Doubt]:
    """Doubt channels whose new origin the run does not determine: they are not used behind it."""
    out = []
    for cable, after_s, until_s, _, u in reconstruction.budget.restored_origins():
        covered = any(d.cable == cable and d.after_s <= after_s and d.until_s >= until_s for d in reconstruction.doubts.every)
        if _is_undetermined(reconstruction, cable, u) and not covered:
            cause = message(UNDETERMINED, what=channel_message(reconstruction.model.rig.observed[cable]), after_s=after_s)
            out.append(Doubt(cable, after_s, until_s, Status.ORIGIN_LOST, cause))
    return out


def _is_undetermined(reconstruction: Reconstruction, channel: int, u: float) -> bool:
    """Return whether a standard uncertainty of a channel's new origin is hardly less than its prior one."""
    return u > HARDLY * (UNKNOWN_MM if reconstruction.model.rig.observed[channel].is_length else ANYWHERE)


def _except_contradictions(doubts: Doubts) -> Doubts:
    """Return the doubts except those of samples with contradicting channels whose fault is unknown."""
    every = tuple(d for d in doubts.every if not (d.cable == EVERY and d.said.code in IN_TIME))
    if len(every) == len(doubts.every):
        return doubts
    return replace(doubts, every=every, notes=tuple(note for note in doubts.notes if note.code not in OF_NOBODY))


def _wrong(reconstruction: Reconstruction) -> list[int]:
    """Return channels that contradict the others for a while, or lost their origins, except restored ones."""
    restored = {cable for cable, _, _ in reconstruction.budget.restored}
    return sorted({d.cable for d in reconstruction.doubts.every if d.cable != EVERY and d.status in DOUBTED} - restored)


def _restored(reconstruction: Reconstruction) -> Reconstruction:
    """Restore channels that stepped and count on: with redundant channels the others determine the new origin. A stuck or hanging one shows
    no length at all."""
    budget, doubts = reconstruction.budget, reconstruction.doubts
    lost = [d for d in doubts.every if d.said.code == STEPPED and d.cable != EVERY and not budget.absolute[d.cable]]
    # a channel with repeated errors has not slipped
    once = [d for d in lost if sum(other.cable == d.cable for other in doubts.every) == 1]
    if not once or len(once) > budget.scheme.redundancy:
        return reconstruction
    for d in once:
        budget = budget.with_restored(d.cable, d.after_s, d.until_s)
    return replace(reconstruction, budget=budget, doubts=replace(doubts, every=tuple(d for d in doubts.every if d not in once)))


def _restored_notes(reconstruction: Reconstruction) -> list[Message]:
    """Return the notes on restored channels."""
    out, rig = [], reconstruction.model.rig
    for cable, after_s, _, left, u in reconstruction.budget.restored_origins():
        o, shifts = rig.observed[cable], reconstruction.doubts.shifts
        by = left + sum(s.counts for s in shifts if (s.cable, s.after_s) == (cable, after_s)) * rig.counter(o).per_count
        of = {"what": channel_message(o), "after_s": after_s}
        out.append(message(UNDETERMINED, **of) if _is_undetermined(reconstruction, cable, u) else _sized("origin.restored", o, by, u, **of))
    return out


def _sized(code: str, o: Observed, by: float, u: float, **of: Any) -> Message:
    """Return a text on a length [mm] or an angle [rad] of a channel, and its standard uncertainty."""
    if o.is_length:
        return message(f"{code}.length", mm=by, u_mm=u, **of)
    return message(f"{code}.angle", deg=float(np.degrees(by)), u_deg=float(np.degrees(u)), **of)


def _changed_origins(reconstruction: Reconstruction, pieces: Pieces) -> Reconstruction:
    """Restore drums that contradicted the others and continue from another origin; the time of the change stays in doubt."""
    rig, budget, doubts = reconstruction.model.rig, reconstruction.budget, reconstruction.doubts
    restored = {cable for cable, _, _ in budget.restored}
    wrong = {d.cable for d in doubts.every if d.status in DOUBTED and d.cable != EVERY and not budget.absolute[d.cable]}
    for j in sorted(wrong - restored):
        # faults of other channels are no evidence about this one
        others = replace(doubts, every=tuple(d for d in doubts.every if d.cable != j))
        reconstruction = replace(reconstruction, budget=budget)
        epochs = collect_epochs(reconstruction, pieces(others))[0]
        since_s = min(d.after_s for d in doubts.every if d.cable == j)
        change = origin_change(reconstruction, epochs.excluding(sorted(wrong - restored - {j})), j, since_s)
        if change is None:
            continue
        name = rig.observed[j].name
        if np.isinf(change.after_s):
            doubts = _since(doubts, j, name, change.from_s)
        else:
            budget = budget.with_restored(j, change.after_s)
            why = _sized("slip", rig.observed[j], change.by, change.u)
            notes = tuple(note for note in doubts.notes if not (note.code in LEFT_OUT and note.values.get("cable") == name))
            shifts = (*others.shifts, _shift(rig, j, change.after_s, by=change.by))
            doubts = _meanwhile(replace(others, shifts=shifts, notes=notes), j, change.from_s, change.after_s, why)
    return replace(reconstruction, budget=budget, doubts=doubts)


def _since(doubts: Doubts, cable: int, name: str, from_s: float) -> Doubts:
    """Return the doubts, the last one of a cable that is not used to the end from its first error on."""
    last = next((d for d in doubts.every if d.cable == cable and np.isinf(d.until_s) and d.after_s > from_s), None)
    if last is None:
        return doubts
    within = [d for d in doubts.every if d.cable == cable and d.after_s >= from_s]
    every = tuple(d for d in doubts.every if d not in within)
    notes = []
    for note in doubts.notes:
        of_cable = note.code in LEFT_OUT and note.values["cable"] == name
        if of_cable and any(note.values["begin"].values.get("s") == d.after_s for d in within):
            if note.values["end"].code != "time.end":
                continue
            note = message(note.code, **{**note.values, "begin": message("time.at", s=from_s)})
        notes.append(note)
    return replace(doubts, every=every, notes=tuple(notes)).with_more(replace(last, after_s=from_s))


def _meanwhile(doubts: Doubts, cable: int, from_s: float, after_s: float, cause: Message) -> Doubts:
    """Return the doubts and one for the time within which a channel slipped, at an unknown instant."""
    return doubts.with_more(Doubt(cable, from_s, after_s, Status.INCONSISTENT, cause)) if after_s > from_s else doubts


def _with_slip(doubts: Doubts, slipped: Slip, rig: Rig) -> Doubts:
    """Return the doubts with those of a slip: its channel is not used behind it, or no sample if others explain the readings as well."""
    observed, when = rig.observed, {"begin": message("time.at", s=slipped.from_s), "end": message("time.end")}
    if slipped.others:
        cable = EVERY
        cause = message("slip.among", names=", ".join(observed[j].name for j in (slipped.channel, *slipped.others)))
        note = message("channels.contradict", **when, said=cause)
    else:
        cable = slipped.channel
        cause = _sized("slip", observed[cable], slipped.by, slipped.u)
        note = message("channel.left_out", **when, what=channel_message(observed[cable]), said=cause)
    doubts = doubts.with_more(Doubt(cable, slipped.from_s, np.inf, Status.INCONSISTENT, cause))
    return replace(doubts, notes=(*doubts.notes, note))
