"""A robot that vibrates while it rests: the samples of a dwell are one signal, not so many independent draws.

In a dwell a robot is seen at

    p(t) = rest + sum over j of (a_j cos w_j t + b_j sin w_j t) + noise new at every sample,

and two effects follow from the swing, whose phase is random.

The mean over the window misses the rest: by a variance of 1/2 (a a' + b b') |D(w)|^2 for each frequency, with D(w) the mean of exp(i w t)
over the samples - at most 1 / (pi f T) of f T periods, all of it in a window much shorter than one. It follows from the autocorrelation of
the signal, a sum of cosines, for the mean of so many samples. The autocorrelation of a dwell about its own mean sums to zero for any
signal, and does not determine it: hence the fit, with frequencies that all dwells of a pose share and amplitudes of each dwell's own.

A dither is a swing that the program states, of triangular waves along x, y and z, one, two and three in each period. Its middle is the
rest, so the fitted constant is the attained pose, and the window's mean misses nothing. K of each length follows from its own motion.

Counts are rounded along the swing m(t) (counts of a cable) and not anew at every sample: a rounding error is a sawtooth of the length, and
the mean of many of them keeps of the variance of one

    K = 6 / pi^2 sum over k of |G_k|^2 / k^2,    G_k = mean of exp(2 pi i k m) over the samples.

Without a swing |G| is 1, and K as well; for a sinusoid of amplitude A counts G_k approaches the Bessel function J_0(2 pi k A), which falls
with the root of A only: three hundredths at two counts. The remainder about the swing is averaged over all readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from lmeasure.core import ComplexArray, FloatArray, IntArray, symmetric_root
from lmeasure.trajectory.uncertainty.pose_errors import PoseErrors
from lmeasure.trajectory.uncertainty.rounding import kept, per_count, scatter_counts

LEVER = np.repeat([100.0, 1.0], 3)
"""mm per radian and per mm: motion of a body's points by a turn, so that all components share one search for frequencies."""
FEWEST_PERIODS, MOST_PERIODS, STEP = 0.5, 32.0, 0.25
"""Frequencies that are looked for, times the longest window: slower is a drift, faster hardly moves a mean."""
FREQUENCIES = 3
LEAST = 0.05  # Relative to the squares that the strongest frequency explains: weaker ones may be rounding along the vibration
CHANCE = 1e-3  # Probability that independent noise counts as vibration
MOST_SAMPLES = 128  # Samples of a dwell for its frequencies: means of neighbours if there are more
UNCERTAIN = 0.25  # Times the window: to either side of a frequency it may wander, so that whole periods are not counted on
HARMONICS = np.arange(1, 33)
SIZES = np.concatenate([np.linspace(0.0, 0.5, 26), np.geomspace(0.52, 40.0, 60)])  # Sizes of vibration [counts, rms] at which K is computed
MOST_SHAPES = 8  # Dwells for its shape

PACES = np.geomspace(0.5, 1.25, 301)  # Tried frequencies, relative to the stated dither's: a robot needs time to reverse
OVERTONES = np.arange(1, 10)  # Multiples of the fundamental frequency in the fitted shape
STATED = 0.5  # Least share of the squares that waves along three axes explain if the robot carries out a dither
NEAR = np.linspace(0.85, 1.15, 13)  # Sizes of a dither over the measured one: K has zeros and maxima, and the largest counts

WIGGLES = 3.0  # Standard uncertainties of a curve that it may move by in a dwell though the robot rests


@dataclass(frozen=True)
class Swing:
    """A dwell of k samples: motion (k, 6) (rotation [rad]; position [mm]) of its frequencies about its mean, left (6, 6) the covariance of
    the remainder, missed (6,) the distance of its mean from the rest by the fit."""

    motion: FloatArray
    left: FloatArray
    missed: FloatArray


@dataclass(frozen=True)
class Vibration:
    """The dwells of a pose: swings, one each; of_mean (6, 6): covariance of a dwell's mean about the rest; frequencies_hz. dither_hz: that
    of a stated dither, 0 where there is none. Its middles are the rests (n, 6), displacements from the means. instants_s (n,): times from
    the mean time of each window at which a dither is in its longest straight piece: all channels travel in the same direction there in
    every dwell, and play has the same error."""

    swings: tuple[Swing, ...]
    of_mean: FloatArray
    frequencies_hz: tuple[float, ...] = ()
    dither_hz: float = 0.0
    instants_s: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def middles(self) -> FloatArray:
        """Return the displacements (n, 6) of the rests from the means, by a dither; else zero."""
        return np.array([-s.missed if self.dither_hz else np.zeros(6) for s in self.swings])

    def alike(self, groups: IntArray) -> float:
        """Return the part of the means' errors that is common to dwells of one group (n,): all of it if they swing in the same phase."""
        missed = np.array([s.missed for s in self.swings]) * LEVER
        together = whole = 0.0
        for group in np.unique(groups):
            own = missed[groups == group]
            square = float((own**2).sum())
            together += float((own.sum(axis=0) ** 2).sum()) - square
            whole += (len(own) - 1) * square
        return float(np.clip(together / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def vibration(dwells: Sequence[tuple[FloatArray, FloatArray]], dither_s: float | None = None) -> Vibration:
    """Return the swings in dwells of one pose: times (k,) [s] and displacements (k, 6) (rotation [rad]; position [mm]) from their mean.

    dither_s: period of a dither that the program states.
    """
    centred = [(t - t.mean(), x * LEVER) for t, x in dwells]
    dither = 0.0 if dither_s is None else _dither(centred, dither_s)
    stated: list[float] = (dither * OVERTONES).tolist() if dither else []
    found = [*stated, *_frequencies(centred, stated)]
    swings, squares, missed = [], np.zeros((6, 6)), np.zeros((6, 6))
    for time_s, away in dwells:
        t = time_s - time_s.mean()
        most = max((len(t) - 2) // 2, 0)
        hz = found[:most]
        design = np.column_stack([np.ones(len(t)), *(wave for f in hz for wave in (np.cos(2 * np.pi * f * t), np.sin(2 * np.pi * f * t)))])
        fit = np.linalg.lstsq(design, away, rcond=1e-6)[0]
        # exactly nothing where no frequency is
        motion = design[:, 1:] @ fit[1:]
        left = away - fit[0] - motion
        freedom = max(len(t) - design.shape[1], 1)
        swings.append(Swing(motion - motion.mean(axis=0), left.T @ left / freedom, -fit[0]))
        for f, pair in list(zip(hz, fit[1:].reshape(-1, 2, 6), strict=True))[len(stated) :]:
            squares += 0.5 * _of_mean(f, t) * pair.T @ pair
        missed += 0.0 if dither else np.outer(fit[0], fit[0])
    # vibration of one phase has a larger or smaller error than the average over phases: at least the observed one
    size, seen = (float(np.trace(m * LEVER * LEVER[:, None])) for m in (squares, missed))
    more = max(1.0, seen / size) if size > 0.0 else 1.0
    instants_s = np.zeros(len(dwells))
    if dither:
        swings, instants_s = _alike_in_all(swings, [t for t, _ in centred], dither)
    return Vibration(tuple(swings), more * squares / max(len(dwells), 1), tuple(found), dither, instants_s)


def _alike_in_all(swings: list[Swing], times: Sequence[FloatArray], hz: float) -> tuple[list[Swing], FloatArray]:
    """Return the swings of a dither with the mean motion of all dwells, each in its own phase, at times (k,) about zero, and `instants_s`.

    The fit of a single dwell follows its rounded counts. The longest straight piece is about the half period, where x passes zero
    downwards: x alone has the fundamental.
    """
    waves = [np.exp(2j * np.pi * hz * np.outer(OVERTONES, t)) for t in times]
    fits = [np.linalg.lstsq(np.hstack([w.real.T, -w.imag.T]), s.motion, rcond=1e-6)[0] for w, s in zip(waves, swings, strict=True)]
    sizes = np.array([fit[: len(OVERTONES)] + 1j * fit[len(OVERTONES) :] for fit in fits])
    phases = np.angle((sizes[:, 0] * LEVER**2 * sizes[0, 0].conj()).sum(axis=1))
    turned = np.exp(1j * np.outer(phases, OVERTONES))
    mean = (sizes * turned.conj()[:, :, None]).mean(axis=0)
    motions = [np.real((wave * turn[:, None]).T @ mean) for wave, turn in zip(waves, turned, strict=True)]
    ahead = np.angle(1j * np.exp(-1j * np.angle(sizes[:, 0, 3])))
    return [replace(s, motion=m - m.mean(axis=0)) for s, m in zip(swings, motions, strict=True)], ahead / (2.0 * np.pi * hz)


def _dither(dwells: Sequence[tuple[FloatArray, FloatArray]], period_s: float) -> float:
    """Return the frequency [Hz] of a dither of about a period, in times (k,) about zero and displacements (k, 6) [mm]; 0 where the robot
    does not carry it out, or a window is shorter than one period."""
    moving = [_fewer(t, x) for t, x in dwells if len(t) >= 2 * (2 * len(OVERTONES) + 1)]
    square = sum(float((x**2).sum()) for _, x in moving)
    if len(moving) < len(dwells) or square == 0.0:
        return 0.0
    grid = PACES / period_s
    waves = (1, 2, 3)
    explained = np.sum([_explained(np.exp(-2j * np.pi * np.outer(n * grid, t)), x) for t, x in moving for n in waves], axis=0)
    best = int(np.argmax(explained))
    whole = min(float(np.ptp(t)) for t, _ in moving) * grid[best] >= 1.0
    return float(grid[best]) if whole and explained[best] > STATED * square else 0.0


def _of_mean(hz: float, t: FloatArray) -> float:
    """Square of the mean of exp(i w t) over times (k,) about zero; or, if larger, its average over frequencies that may be meant."""
    about = hz + np.linspace(-UNCERTAIN, UNCERTAIN, 9) / max(float(np.ptp(t)) * len(t) / max(len(t) - 1, 1), 1e-9)
    square = np.abs(np.exp(2j * np.pi * np.outer(about, t)).mean(axis=1)) ** 2
    return float(max(square[4], square.mean()))


def _frequencies(dwells: Sequence[tuple[FloatArray, FloatArray]], stated: Sequence[float]) -> list[float]:
    """Frequencies [Hz] that explain more of all dwells together, times (k,) about zero and displacements (k, 6) [mm], than chance does; the
    strongest first. stated: those of a dither, which are explained already."""
    moving = [_fewer(t, x - x.mean(axis=0)) for t, x in dwells if len(t) >= 4 and x.any()]
    if not moving:
        return []
    longest = max(float(np.ptp(t)) for t, _ in moving)
    step_s = min(float(np.median(np.diff(t))) for t, _ in moving)
    grid = np.arange(FEWEST_PERIODS, min(MOST_PERIODS, 0.4 * longest / step_s), STEP) / longest
    if len(grid) == 0:
        return []
    waves = [np.exp(-2j * np.pi * np.outer(grid, t)) for t, _ in moving]
    left = [_without(stated, t, x) for t, x in moving]
    free = np.ones(len(grid), dtype=np.bool_)
    out: list[float] = []
    strongest = sum(float((x**2).sum()) for _, x in moving) if stated else 0.0
    if stated:
        # what is rounded along it errs by its multiples, and is rounded alike in all its swings
        free &= np.abs(grid - np.maximum(np.rint(grid / stated[0]), 1.0) * stated[0]) > 1.0 / longest
    for _ in range(FREQUENCIES if free.any() else 0):
        explained = np.sum([_explained(w, x) for w, x in zip(waves, left, strict=True)], axis=0)
        best = int(np.argmax(np.where(free, explained, -1.0)))
        square = sum(float((x**2).sum()) for x in left)
        number = sum(len(x) for x in left) - len(left) * (1 + 2 * (len(out) + 1))
        if number < 2 or square == 0.0:
            break
        # effective number of axes with equal errors
        axes = np.linalg.eigvalsh(sum(x.T @ x for x in left))
        several = axes.sum() ** 2 / (axes**2).sum()
        freedom = 2.0 * several * len(left)
        noise = max(square - explained[best], 1e-30) / (number * several)
        if explained[best] / noise < scipy.stats.chi2.isf(CHANCE / (2.0 * MOST_PERIODS), freedom) or explained[best] < LEAST * strongest:
            break
        strongest = max(strongest, float(explained[best]))
        fine = grid[best] + np.linspace(-STEP, STEP, 33) / longest
        fine = fine[fine > 0.0]
        sharper = np.sum([_explained(np.exp(-2j * np.pi * np.outer(fine, t)), x) for (t, _), x in zip(moving, left, strict=True)], axis=0)
        hz = float(fine[int(np.argmax(sharper))])
        out.append(hz)
        # rounding along a vibration has multiples of its frequency
        free &= np.abs(grid - np.maximum(np.rint(grid / hz), 1.0) * hz) > 1.0 / longest
        left = [_without([*stated, *out], t, x) for t, x in moving]
    return out


def _fewer(t: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means of as many neighbours as leave `MOST_SAMPLES` at most."""
    size = -(-len(t) // MOST_SAMPLES)
    n = len(t) // size * size
    return t[:n].reshape(-1, size).mean(axis=1), x[:n].reshape(-1, size, 6).mean(axis=1)


def _explained(waves: ComplexArray, x: FloatArray) -> FloatArray:
    """Return the (F,) sum of squares of displacements (k, 6) that a cosine and a sine of each frequency, waves (F, k), explain beyond a
    constant."""
    k = len(x)
    one, two, product = waves.sum(axis=1), (waves**2).sum(axis=1), waves @ (x - x.mean(axis=0))
    cc, ss = 0.5 * (k + two.real) - one.real**2 / k, 0.5 * (k - two.real) - one.imag**2 / k
    cs = 0.5 * two.imag - one.real * one.imag / k
    det = np.maximum(cc * ss - cs**2, 1e-9 * k * k)
    c, s = product.real, product.imag
    return np.asarray((ss[:, None] * c**2 - 2.0 * cs[:, None] * c * s + cc[:, None] * s**2).sum(axis=1) / det)


def _without(hz: Sequence[float], t: FloatArray, x: FloatArray) -> FloatArray:
    design = np.column_stack([np.ones(len(t)), *(w for f in hz for w in (np.cos(2 * np.pi * f * t), np.sin(2 * np.pi * f * t)))])
    return np.asarray(x - design @ np.linalg.lstsq(design, x, rcond=1e-6)[0])


def averaged(errors: PoseErrors, found: Vibration, readings: IntArray) -> FloatArray:
    """Return (n, q) the variance of the mean of each dwell over that of one rounding, for each of the q lengths; readings (n,) the number
    of different ones. errors: of single samples.

    A length that swings by less than a count shows all of one or nothing, by its place within a count. So for swinging dwells the swing of
    each length follows from the variation of its counts in all of them: 12 s^2 + 1 - K(s) for a swing of s counts, rms.
    """
    lengths = [per_count(own) for own in errors.own]
    covariance = np.array([s.left + s.motion.T @ s.motion / len(s.motion) for s in found.swings])
    varies = 12.0 * np.array([np.einsum("qi,ij,qj->q", c, v, c) for c, v in zip(lengths, covariance, strict=True)])
    ranks = [max(int(np.linalg.matrix_rank(c)), 1) for c in lengths]
    left = np.array([12.0 * np.trace(c @ s.left @ c.T) / r for c, s, r in zip(lengths, found.swings, ranks, strict=True)])
    if found.dither_hz:
        # it is known sample by sample, so K has all of its rounding, and what is left beyond that is noise
        keeps = np.array([kept_on(c @ s.motion.T) for c, s in zip(lengths, found.swings, strict=True)])
        return np.asarray(keeps.mean(axis=0) + (np.maximum(left - 1.0, 0.0) / readings)[:, None])
    swings = any(s.motion.any() for s in found.swings)
    keeps = _kept_swinging(found, varies.mean(axis=0))[None, :] if swings else kept(scatter_counts(left))[:, None]
    return np.asarray(keeps + (left / readings)[:, None])


def _kept_swinging(found: Vibration, varies: FloatArray) -> FloatArray:
    """(q,) K of lengths whose counts vary by so much (q,), in units of 1/12, as the dwells swing."""
    moving = [s for s in found.swings[:MOST_SHAPES] if s.motion.any()] or [s for s in found.swings if s.motion.any()][:MOST_SHAPES]
    curves = [_harmonics(_shape(s)) for s in moving]
    curve = np.mean(curves, axis=0)
    shown = np.maximum.accumulate(12.0 * SIZES**2 + 1.0 - curve)
    size = np.where(varies < shown[-1], np.interp(varies, shown, SIZES), SIZES[-1])
    return np.interp(size, SIZES, curve)


def kept_on(motion: FloatArray) -> FloatArray:
    """Return K (q,) of q lengths that move by (q, k) [counts] at k samples: the largest of sizes near it."""
    out = np.zeros(len(motion))
    for near in NEAR:
        turned = np.exp(2j * np.pi * near * motion)
        square, wave = np.zeros(len(motion)), np.ones_like(turned)
        for k in HARMONICS:
            wave = wave * turned
            square += np.abs(wave.mean(axis=1)) ** 2 / k**2
        out = np.maximum(out, square)
    return out / np.sum(1.0 / HARMONICS**2)


def _shape(swing: Swing) -> FloatArray:
    """Return the (k,) time course of a swing, of unit mean square, along its largest direction."""
    x = swing.motion[:: -(-len(swing.motion) // MOST_SAMPLES)] * LEVER
    along = x @ np.linalg.svd(x, full_matrices=False)[2][0]
    return np.asarray(along / np.sqrt((along**2).mean()))


def _harmonics(shape: FloatArray) -> FloatArray:
    """(m,) K of swings of SIZES (m,) counts of a shape (k,)."""
    turned = np.exp(2j * np.pi * np.outer(SIZES, shape))
    out, wave = np.zeros(len(SIZES)), np.ones_like(turned)
    for k in HARMONICS:
        wave = wave * turned
        out += np.abs(wave.mean(axis=1)) ** 2 / k**2
    return out / np.sum(1.0 / HARMONICS**2)


def with_rest(errors: PoseErrors, found: Vibration, groups: IntArray) -> PoseErrors:
    """Return errors of means of n dwells as positions of rest, groups (n,), with the error of the window's mean. The part common to dwells
    of a group is added in full: how much of it is new is unknown."""
    if errors.joint:
        errors = errors.alone()
        if np.trace(found.of_mean) <= WIGGLES**2 * np.trace(errors.random.mean(axis=0)):
            # a curve that moves by as little may do so by its errors, which are counted already
            return errors
    if not found.of_mean.any():
        return errors
    root = np.tile(symmetric_root(found.of_mean[None]), (len(errors), 1, 1))
    several = (np.bincount(groups)[groups] > 1)[:, None, None]
    common = np.where(several, np.sqrt(found.alike(groups)) * root, 0.0)
    local, own = np.concatenate([errors.local, common], axis=2), np.concatenate([errors.own, root], axis=2)
    return replace(errors, own=own, local=local, place=groups)
