"""How good an identification is where it was not made: rows held out, error against number of rows, and what was worth freeing."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.estimation.deletion import fall_test
from lmeasure.estimation.robust import scatter
from lmeasure.robots.frame_start import Frames
from lmeasure.robots.identify import FAMILIES, Identified, Prediction, family, predict
from lmeasure.robots.problem import Fit, Problem, solved, weighted, with_noise
from lmeasure.robots.unknowns import R, Unknowns

FOLDS = 5
SIZES = (15, 20, 30, 45, 60, 100, 160, 320, 640)
DRAWS = 5
JUDGES = 200
"""Rows left out by which one identification of the learning curve is judged, at most."""
MOST_ROWS = 500
"""Of all draws of one size together."""


@dataclass(frozen=True)
class HeldOut:
    """Errors (k,) [mm] and u95 (k,) at rows (k,) that were held out in turn.

    misfit: rms of the errors in units of what was stated of them, rows counted by their weights, 1 at least: a model that lacks something
    fits its own rows better than others, the more the farther these lie apart. u95_mm is widened by it, as are predictions
    of an identification that knows it.
    """

    rows: IntArray
    error_mm: FloatArray
    u95_mm: FloatArray
    misfit: float

    @property
    def within(self) -> float:
        """Part of the errors within their u95."""
        return float(np.mean(self.error_mm <= self.u95_mm))


@dataclass(frozen=True)
class Worth:
    """A family of parameters: whether it was freed, how many of them, by how much chi-squared falls with it, the probability of so much by
    chance, and by how much Akaike's and Schwarz's criteria change with it: below 0 it is worth freeing."""

    family: str
    freed: bool
    parameters: int
    drop: float
    chance: float
    aic: float
    bic: float


def held_out(found: Identified[R], folds: int = FOLDS, seed: int = 0) -> HeldOut | None:
    """Each fold of the rows with positions predicted by an identification from the others; None where they are too few."""
    rows = np.flatnonzero(found.kept & found.rows.placed)
    order = np.random.default_rng(seed).permutation(rows)
    parts = np.array_split(order, folds)
    other = np.flatnonzero(found.kept & ~found.rows.placed)
    least = found.fit.counted * (1.0 - 1.0 / folds)
    if len(rows) < 2 * folds or least < _unknown(found.fit) + 6:
        return None
    errors, radii, squares = np.empty(len(order)), np.empty(len(order)), np.empty(len(order))
    found = replace(found, misfit=1.0)
    place = {int(row): i for i, row in enumerate(order)}
    for part in parts:
        again = _refitted(found, np.sort(np.concatenate([np.setdiff1d(order, part), other])))
        error, predicted = _errors(again, part)
        at = [place[int(row)] for row in part]
        errors[at], radii[at] = error, predicted.u95_mm
        squares[at] = error**2 / np.einsum("nii->n", predicted.covariance)
    weight = found.weight[order]
    # what weights take from the errors of a robot of which nothing is wrong is no fit
    if found.fit.problem.weight is not None:
        squares = squares / np.array([scatter(int(m)) for m in found.rows.known[order].sum(axis=1)])
    misfit = max(1.0, float(np.sqrt(np.average(squares, weights=weight))))
    return HeldOut(order, errors, misfit * radii, misfit)


def learning_curve(found: Identified[R], seed: int = 0) -> list[tuple[int, float, float, float]]:
    """(rows, median, least and largest mean error [mm] at the rows left out) for random sets of growing numbers."""
    rows = np.flatnonzero(found.kept & found.rows.placed)
    rng = np.random.default_rng(seed)
    out = []
    for size in SIZES:
        if 3 * size < _unknown(found.fit) + 6 or size > 0.7 * len(rows):
            continue
        means = []
        for _ in range(min(DRAWS, max(1, MOST_ROWS // size))):
            order = rng.permutation(rows)
            again = _refitted(found, np.sort(order[:size]))
            means.append(float(_errors(again, order[size : size + JUDGES])[0].mean()))
        out.append((size, float(np.median(means)), min(means), max(means)))
    return out


def worth_freeing(found: Identified[R]) -> list[Worth]:
    """Every family of the robot's parameters: those freed by what they explain, the others by what they would (a score test)."""
    fit = found.fit
    every = found.nominal.parameters
    wide = Unknowns(found.nominal, np.arange(len(every)), _frames(fit), fit.problem.rows, widths=fit.problem.unknowns.widths)
    inside = {p.name: i for i, p in enumerate(fit.problem.unknowns.own)}
    theta = np.zeros(len(wide))
    for i, p in enumerate(every):
        if p.name in inside:
            theta[i] = fit.theta[inside[p.name]]
    frames = len(fit.theta) - len(inside)
    theta[len(every) :] = fit.theta[len(inside) :] if frames else theta[len(every) :]
    problem = Problem(wide, fit.problem.rows, fit.problem.noise, weight=fit.problem.weight, trust=fit.problem.trust)
    residuals, jacobian = problem.whitened(problem.linearised(theta))
    prior = 1.0 / (wide.width / wide.size) ** 2
    now = np.array([p.name in inside for p in every] + [True] * frames)
    out = []
    for name in FAMILIES:
        of = np.zeros(len(wide), np.bool_)
        of[: len(every)] = [family(p.name) == name for p in every]
        of &= np.abs(jacobian).max(axis=0) > 0.0
        if not of.any():
            continue
        freed = bool(now[of].any())
        full, less = (now | of), (now & ~of)
        # at the optimum of the freed ones, the others at their nominal values
        target = residuals + jacobian[:, now] @ theta[now]
        drop = _left(jacobian[:, less], target, prior[less]) - _left(jacobian[:, full], target, prior[full])
        count = _determined(jacobian, prior, full) - _determined(jacobian, prior, less)
        if count < 1:
            continue
        n, rest = len(residuals), _left(jacobian[:, full], target, prior[full])
        # a noise that the residuals tell they tell from so many of them
        tested = fall_test(drop, count, rest, fit.spare - (0 if freed else count)) if fit.problem.own_noise else None
        chance = float(chi2.sf(drop, count)) if tested is None else math.exp(tested[1])
        out.append(Worth(name, freed, count, drop, chance, 2.0 * count - drop, count * math.log(n) - drop))
    return out


def _left(jacobian: FloatArray, target: FloatArray, prior: FloatArray) -> float:
    """Chi-squared that is left of a target by least squares with priors about nothing."""
    normal = jacobian.T @ jacobian + np.diag(prior)
    pull = jacobian.T @ target
    return float(target @ target - pull @ np.linalg.solve(normal, pull))


def _determined(jacobian: FloatArray, prior: FloatArray, which: BoolArray) -> int:
    """How many directions the rows determine among these unknowns."""
    white = jacobian[:, which] / np.sqrt(prior[which])
    return int((np.linalg.eigvalsh(white.T @ white) > 1.0).sum())


def _unknown(fit: Fit[R]) -> float:
    return fit.counted - fit.freedom


def _refitted(found: Identified[R], rows: IntArray) -> Identified[R]:
    problem = replace(found.fit.problem, rows=found.rows.of(rows))
    if problem.weight is None:
        fit = with_noise(problem, found.fit.theta)
    else:
        fit = weighted(solved(replace(problem, weight=found.weight[rows]), found.fit.theta))
    kept = np.zeros(len(found.rows), np.bool_)
    kept[rows] = True
    return replace(found, fit=fit, kept=kept)


def _errors(found: Identified[R], rows: IntArray) -> tuple[FloatArray, Prediction]:
    """(k,) distances of measured from predicted places, and the prediction."""
    of = found.rows.of(rows)
    predicted = predict(found, of.joints, of.target_of, of.side)
    return np.linalg.norm(of.position - predicted.pose[:, :3], axis=1), predicted


def _frames(fit: Fit[R]) -> Frames:
    start = fit.problem.unknowns.start
    return Frames(start.base, start.targets, start.stations, 0.0, np.ones(len(fit.problem.rows), np.bool_))
