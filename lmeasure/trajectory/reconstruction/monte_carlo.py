"""Uncertainty by propagation of distributions (JCGM 101): the run is reconstructed again and again with its inputs drawn."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lmeasure.core import FloatArray, TrajectoryError, se3
from lmeasure.kernels import BY_RADIUS, BY_SCALE, CABLE, KIND, WIDTH, changes_from_counts
from lmeasure.rig import kernel_values, with_kernel_values
from lmeasure.sensors import Lengths
from lmeasure.text import message
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.uncertainty.budget import Budget
from lmeasure.trajectory.uncertainty.sources import OriginEstimate, Situation, drawn, standard

Progress = Callable[[int, int], None]

TRIALS = 400  # a standard deviation of as many draws is known to 3.5 %


def by_monte_carlo(
    reconstruction: Reconstruction,
    lengths: Lengths,
    trajectory: Trajectory,
    trials: int = TRIALS,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trajectory:
    """The trajectory with covariances from as many trials, each kind of error by itself.

    Random: every count is anywhere within half a unit of what was recorded, and off by whatever else its length is uncertain by at that
    sample (`Lengths.u_mm`). Systematic: the rig's parameters, the start pose and whatever else acts on the lengths are drawn from their own
    laws, once per trial for the whole run. Poses that a trial does not find are left out. TrajectoryError for fewer than 2 trials.
    """
    if trials < 2:
        raise TrajectoryError(message("error.monte_carlo_trials_tell", trials=trials))
    generator = np.random.default_rng(seed)
    budget, model = reconstruction.budget, reconstruction.model
    start = model.zero_pose
    rows, counts, factor = model.scheme.rows, lengths.counts, budget.by_parameter.root
    u_mm = lengths.u_mm
    of = trials * (2 if budget.sources else 1)
    lengths = reconstruction.corrected(lengths)
    # what temperature, stretch and sag, and origins that the run determined, have taken off the changes stays with the trials
    corrected = model.correction is not None or budget.estimate is not None
    offset = lengths.change_mm - changes_from_counts(rows, counts) if corrected else 0.0
    situation = Situation(lengths.time_s, trajectory.poses, counts, lengths.speed_mm_s, lengths.temperature_c, budget.travel(lengths))
    shifts = np.empty(0) if budget.estimate is not None else np.nan_to_num(budget.lengths_of(situation, budget.by_length))
    by_parts = np.nan_to_num(budget.by_parameter.of_parts(trajectory.poses, counts, situation.travel))

    def random_trial() -> FloatArray:
        within = counts + generator.uniform(-0.5, 0.5, counts.shape) / budget.scales
        changes = changes_from_counts(rows, within) + offset
        if u_mm is not None:
            changes += u_mm * generator.standard_normal(changes.shape)
        return reconstruction.solve(rows, start, changes, lengths.flags)

    def by_other_parameters(shift: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows and changes of the lengths when the parameters are off by shift (13 m,)."""
        each = shift.reshape(len(rows), WIDTH)
        moved, scales = moved_rows(rows, each), budget.scales
        k = counts * scales / (scales + each[:, BY_SCALE])
        return moved, changes_from_counts(moved, k) + offset

    def systematic_trial() -> FloatArray:
        if budget.estimate is not None:
            shift, errors = _drawn_by_estimate(budget, budget.estimate, situation, generator)
            moved, changes = by_other_parameters(shift)
            return reconstruction.solve(moved, start, changes + np.nan_to_num(errors), lengths.flags)
        values = generator.standard_normal(factor.shape[1])
        moved, changes = by_other_parameters(factor @ values)
        changes = changes + shifts @ drawn(budget.by_length, generator) + by_parts @ values
        return reconstruction.solve(moved, budget.drawn_start(generator, moved), changes, lengths.flags)

    done = itertools.count(1)

    def step() -> None:
        if progress is not None:
            progress(next(done), of)

    base = reconstruction.solve(rows, start, lengths.change_mm, lengths.flags)
    random = _scatter(random_trial, base, trials, step)
    systematic = _scatter(systematic_trial, base, trials, step) if budget.sources else np.zeros_like(random)
    unknown = np.isnan(trajectory.random)
    random[unknown] = systematic[unknown] = np.nan
    covers = message("trajectory.monte_carlo_trials_jcgm", sources=trajectory.covers, trials=trials)
    return replace(trajectory, random=random, systematic=systematic, covers=covers)


def _drawn_by_estimate(
    budget: Budget, estimate: OriginEstimate, situation: Situation, generator: "np.random.Generator"
) -> tuple[FloatArray, FloatArray]:
    """A draw of all that a run shares which determined of its origins: errors of the rig's parameters (13 m,), and of the readings (n, m)
    by whatever else there is. What an origin took up of a parameter errs with it."""
    own = [standard(generator, (len(s.names),), s.uniform and s not in budget.origins) for s in budget.every]
    root = budget.by_parameter.root
    drawn, r = estimate.mix @ np.concatenate(own), root.shape[1]
    # those of the parameters stand first
    others = [budget.lengths_of(situation, (source,)) for source in (budget.every[1:] if r else budget.every)]
    by_parts = budget.by_parameter.of_parts(situation.poses, situation.counts, situation.travel) @ drawn[:r]
    return np.asarray(root @ drawn[:r]), np.asarray(np.concatenate(others, axis=2) @ drawn[r:] + by_parts)


def moved_rows(rows: FloatArray, shift: FloatArray) -> FloatArray:
    """(m, columns) rows of cables whose parameters are moved by shift (m, 13), in the order of `PARAMETERS`; scale has no place there."""
    values = kernel_values(rows) + shift
    cables = rows[:, KIND] == CABLE
    # an encoder has its zero there
    values[cables, BY_RADIUS] = np.maximum(values[cables, BY_RADIUS], 0.0)
    return with_kernel_values(rows, values)


def _scatter(trial: Callable[[], FloatArray], base: FloatArray, trials: int, step: Callable[[], None]) -> FloatArray:
    """(n, 6, 6) covariance of (rotation; tool origin) of the trials' poses about their mean."""
    n = len(base)
    good = ~np.isnan(base[:, 0])
    count, total, squares = np.zeros(n), np.zeros((n, 6)), np.zeros((n, 6, 6))
    for _ in range(trials):
        poses = trial()
        found = ~np.isnan(poses[good, 0])
        delta = np.zeros((int(good.sum()), 6))
        delta[found] = se3.displacement(poses[good][found], base[good][found])
        count[good] += found
        total[good] += delta
        squares[good] += delta[:, :, None] * delta[:, None, :]
        step()
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count[:, None]
        out = (squares - count[:, None, None] * mean[:, :, None] * mean[:, None, :]) / (count - 1)[:, None, None]
    out[count < 2] = np.nan
    return np.asarray(out)
