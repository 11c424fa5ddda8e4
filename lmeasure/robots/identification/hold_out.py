"""Accuracy of an identification at validation poses: validation rows, error against number of poses, and useful families of parameters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.estimation import fall_test, scatter
from lmeasure.robots.identification.identify import FAMILIES, Identified, Prediction, Settings, family, identify, predicted
from lmeasure.robots.identification.measurements import POSITION, STILL, Beyond, Measurements, Noted, noted
from lmeasure.robots.identification.problem import Fit, solved, weighted, with_noise
from lmeasure.robots.identification.unknowns import Frames, R, Unknowns

FOLDS = 5
SIZES = (15, 20, 30, 45, 60, 100, 160, 320, 640)
DRAWS = 5
JUDGES = 200
"""Most validation rows for one identification of the learning curve."""
MOST_ROWS = 500
"""Most validation rows for all draws of one size together."""
PARTS = (1.0 / 3.0, 0.5, 2.0 / 3.0)
"""Fractions of the rows that predict the others."""
MEASURED = 0.95
"""Quantile of the measured poses' leverages, from which on a pose is far from them."""
FALSE = 1e-4
"""Probability of widening the predictions of a robot whose model is complete."""
LEAST_LEFT = 5.0
"""Degrees of freedom that a cut must leave."""
EXCESS = 1.25
"""Errors of unseen halves, in units of their stated ones, beyond any family of the robot: 0.9 to 1.15 for simulated robots."""
DETERMINED = 0.8
"""Share of the parameters determined by all rows that a part must determine to predict the others."""


@dataclass(frozen=True)
class CrossValidation:
    """Errors (k,) [mm] and u95 (k,) at validation rows (k,) of the fit, in turn.

    misfit: rms of the errors in units of the stated ones, or 95 % quantile in units of their stated radii if that is more; rows counted by
    their weights, 1 at least. An incomplete model fits its own rows better than others, the more so the farther apart they are. u95_mm is
    widened by it, as are predictions of an identification with it.
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


@dataclass(frozen=True)
class Unseen:
    """Effect of a family of parameters on predictions of unseen halves of the workspace.

    times: errors with the family, in units of those without it; excess: in units of their covariance.
    """

    times: float
    excess: float

    @property
    def good(self) -> bool:
        """Return whether predictions gain by the family, or lose no more than their uncertainty."""
        return self.times < 1.0 or self.excess < EXCESS


def cross_validation(found: Identified[R], folds: int = FOLDS, seed: int = 0) -> CrossValidation | None:
    """Predict each fold of the poses with positions by an identification from the others; None with too few.

    All rows of the same joint values are in one fold: they share the robot's noise and the errors of its model.
    """
    rows = found.fit.problem.rows
    of = _poses(found)
    parts = np.array_split(np.random.default_rng(seed).permutation(len(of)), folds)
    if len(of) < 2 * folds or found.fit.counted * (1.0 - 1.0 / folds) < found.fit.determined + 6:
        return None
    found = replace(found, misfit=1.0, beyond=Beyond())
    order, errors, radii, squares = [], [], [], []
    for part in parts:
        own = np.concatenate([of[i] for i in part])
        rest = np.setdiff1d(np.arange(len(rows)), own)
        again = _refitted(found, rest)
        error, determined = _errors(again, rows.of(own))
        order.append(own)
        errors.append(error)
        radii.append(determined.u95_mm)
        squares.append(error**2 / np.einsum("nii->n", determined.covariance))
    at, square = np.concatenate(order), np.concatenate(squares)
    weight = found.fit.problem.weight
    # the effect of weights on the errors of a sound robot is not fitting
    if weight is not None:
        square = square / np.array([scatter(int(m)) for m in rows.known[at].sum(axis=1)])
    counts = np.ones(len(at)) if weight is None else weight[at]
    error, radius = np.concatenate(errors), np.concatenate(radii)
    # with joints of different repeatability a few errors are larger than a common covariance predicts, and more are smaller
    farthest = float(np.quantile(error / radius, 0.95, weights=counts, method="inverted_cdf"))
    misfit = max(1.0, float(np.sqrt(np.average(square, weights=counts))), farthest)
    return CrossValidation(at, error, misfit * radius, misfit)


def learning_curve(found: Identified[R], seed: int = 0) -> list[tuple[int, float, float, float]]:
    """(poses, median, least and largest mean error [mm] at the poses left out) for random sets of growing numbers."""
    rows = found.fit.problem.rows
    of = _poses(found)
    rng = np.random.default_rng(seed)
    out = []
    for size in SIZES:
        if 3 * size < found.fit.determined + 6 or size > 0.7 * len(of):
            continue
        means = []
        for _ in range(min(DRAWS, max(1, MOST_ROWS // size))):
            order = rng.permutation(len(of))
            again = _refitted(found, np.sort(np.concatenate([of[i] for i in order[:size]])))
            means.append(float(_errors(again, rows.of(np.concatenate([of[i] for i in order[size : size + JUDGES]])))[0].mean()))
        out.append((size, float(np.median(means)), min(means), max(means)))
    return out


def beyond(found: Identified[R]) -> Beyond:
    """Return the widening of predictions far from the measured joint values, from predictions between blocks of the measurements.

    The rows are cut in two along each joint, each coordinate and the distance from the robot's base, at a third, the middle and two thirds,
    and each part predicts the other. Where the parts' parameters differ by more than their covariances allow (a Chow test over all cuts),
    the largest factor counts, widened for an estimate from as many draws as joints have moved.
    """
    fit, problem = found.fit, found.fit.problem
    rows = problem.rows
    residuals, jacobian = problem.whitened(fit.at)
    owner, prior = np.nonzero(rows.known)[0], np.diag(1.0 / problem.width**2)
    total = float(residuals @ residuals + fit.theta @ prior @ fit.theta)
    own = np.einsum("nii->n", problem.blocks[:, POSITION, POSITION])
    shift = fit.at.jacobian[:, POSITION]
    chances, factors = [], []
    cuts = _cuts(found)
    for inside in cuts:
        halves = [_half(jacobian[on], residuals[on], prior, fit.theta) for on in (inside[owner], ~inside[owner])]
        (step, covariance, determined, chi_squared, whole), (_, _, told_other, chi_other, whole_other) = halves
        bought, left = determined + told_other - fit.determined, len(residuals) - determined - told_other
        if bought < 1.0 or left < LEAST_LEFT or determined < DETERMINED * fit.determined:
            continue
        rest = chi_squared + chi_other
        tested = fall_test(total - whole - whole_other, bought, rest, left)
        if tested is None:
            continue
        chances.append(tested[1])
        leverage = np.einsum("nip,nip->n", shift @ covariance, shift)
        other = ~inside & rows.placed
        square = ((fit.at.residuals[other, POSITION] - shift[other] @ step) ** 2).sum(axis=1)
        excess = np.maximum(leverage[other] - np.quantile(leverage[inside], MEASURED), 0.0).sum()
        more = float((square - own[other] - leverage[other]).sum())
        factors.append(max(more, 0.0) / float(excess) if excess > 0.0 else 0.0)
    if not chances or min(chances) > math.log(FALSE / len(cuts)):
        return Beyond()
    moved = int((np.ptp(rows.joints, axis=0) > 0.0).sum())
    factor = float(np.sqrt(max(factors)) * scipy.stats.t.ppf(0.975, moved) / scipy.stats.t.ppf(0.975, np.inf))
    leverage = np.einsum("nip,nip->n", shift @ fit.covariance, shift)
    return Beyond(factor, float(np.quantile(leverage[rows.placed], MEASURED)), problem.width)


def _cuts(found: Identified[R]) -> list[BoolArray]:
    """(N,) which rows of the fit lie on one side of each cut."""
    rows = found.fit.problem.rows
    if not rows.placed.all():
        return []
    from_base = np.linalg.norm(rows.position - found.state.base[:3], axis=1)
    along = np.column_stack([rows.joints, rows.position, from_base])
    along = along[:, np.ptp(along, axis=0) > 0.0]
    return [side * value < np.quantile(side * value, part) for value in along.T for part in PARTS for side in (1.0, -1.0)]


def _half(
    jacobian: FloatArray, residuals: FloatArray, prior: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray, float, float, float]:
    """Return from whitened rows alone, near theta: the step to their optimum, its covariance, the number of determined unknowns,
    chi-squared, and that with the priors."""
    information = jacobian.T @ jacobian
    normal = information + prior
    size = np.sqrt(np.diagonal(normal))
    # base and target of a gantry move alike: combinations that only wide priors separate do not change predictions
    covariance = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-14, hermitian=True) / np.outer(size, size)
    step = covariance @ (jacobian.T @ residuals - prior @ theta)
    left, at = residuals - jacobian @ step, theta + step
    return step, np.asarray(covariance), float(np.trace(covariance @ information)), float(left @ left), float(left @ left + at @ prior @ at)


def _poses(found: Identified[R]) -> list[IntArray]:
    """The rows of the fit with positions by the joint values that they have in common, in their order."""
    rows = found.fit.problem.rows
    placed = np.flatnonzero(rows.placed)
    values = np.where(found.nominal.sliding, rows.joints, np.degrees(rows.joints))[placed]
    _, first, of = np.unique(np.round(values / STILL), axis=0, return_index=True, return_inverse=True)
    of = np.argsort(np.argsort(first))[of.reshape(-1)]
    order = np.argsort(of, kind="stable")
    return np.split(placed[order], np.flatnonzero(np.diff(of[order])) + 1)


def worth_freeing(found: Identified[R]) -> list[Worth]:
    """Return every family of the robot's parameters: freed ones with their explanation, the others with their possible one (a score
    test)."""
    fit, wide = found.fit, _wide(found)
    jacobian, prior, now = wide.jacobian, wide.prior, wide.now
    # at the optimum of the freed ones, the others at their nominal values
    target = wide.residuals + jacobian[:, now] @ wide.theta[now]
    stay = np.unique(fit.problem.rows.stay[wide.owner], return_inverse=True)[1]
    out = []
    for name in FAMILIES:
        of = wide.of(name)
        if not of.any():
            continue
        freed = bool(now[of].any())
        full, less = (now | of), (now & ~of)
        drop = _left(jacobian[:, less], target, prior[less]) - _left(jacobian[:, full], target, prior[full])
        count = _determined(jacobian, prior, full) - _determined(jacobian, prior, less)
        if count < 1:
            continue
        n, rest = len(target), _left(jacobian[:, full], target, prior[full])
        # degrees of freedom of the noise that the residuals determine
        spare = fit.counted - fit.determined - (0 if freed else count)
        left = min(spare, fit.spare - (0 if freed else count))
        tested = fall_test(drop, count, rest * left / spare, left) if fit.problem.own_noise and spare > 0.0 else None
        chance = float(scipy.stats.chi2.sf(drop, count)) if tested is None else math.exp(tested[1])
        if fit.problem.several and not freed:
            rest_of = wide.residuals - jacobian[:, now] @ _step(jacobian[:, now], wide.residuals, prior[now])
            chance = max(chance, _by_stays(jacobian[:, of] / np.sqrt(prior[of]), jacobian[:, now], rest_of, stay, count=count))
        out.append(Worth(name, freed, count, drop, chance, 2.0 * count - drop, count * math.log(n) - drop))
    return out


def unseen_halves(found: Identified[R], name: str) -> Unseen:
    """Predict each half of every joint's range from the other, with and without a family that is not freed.

    Errors that the model lacks look like a family where a joint turns by a part of a turn only; beyond that part it makes them larger.
    """
    wide = _wide(found)
    rows, residuals = found.fit.problem.rows, wide.residuals
    joints = rows.joints[np.searchsorted(rows.stay, rows.stay)][wide.owner]
    halves = [
        inside for value in joints.T for inside in (value < np.median(value), value >= np.median(value)) if 0 < inside.sum() < len(value)
    ]
    met, said = np.zeros(2), np.zeros(2)
    for i, of in enumerate((wide.now, wide.now | wide.of(name))):
        jacobian, prior, theta = wide.jacobian[:, of], np.diag(wide.prior[of]), wide.theta[of]
        _, _, determined, chi_squared, _ = _half(jacobian, residuals, prior, theta)
        variance = chi_squared / max(len(residuals) - determined, 1.0)
        for inside in halves:
            step, covariance, _, _, _ = _half(jacobian[inside], residuals[inside], prior, theta)
            other = jacobian[~inside]
            met[i] += ((residuals[~inside] - other @ step) ** 2).sum()
            said[i] += variance * (len(other) + ((other @ covariance) * other).sum())
    return Unseen(float(np.sqrt(met[1] / met[0])), float(np.sqrt(met[1] / said[1]))) if halves else Unseen(0.0, 0.0)


@dataclass(frozen=True)
class _Wide:
    """Hold the problem of an identification, whitened, about its optimum, with every parameter of its robot.

    residuals (e,) of rows owner (e,); jacobian (e, p); prior (p,): inverse variances; now (p,): whether an unknown is free; theta (p,);
    families: of the robot's parameters, which are the first unknowns.
    """

    residuals: FloatArray
    owner: IntArray
    jacobian: FloatArray
    prior: FloatArray
    now: BoolArray
    theta: FloatArray
    families: tuple[str, ...]

    def of(self, name: str) -> BoolArray:
        """(p,) which unknowns are of a family and move anything."""
        out = np.zeros(len(self.theta), np.bool_)
        out[: len(self.families)] = [f == name for f in self.families]
        return np.asarray(out & (np.abs(self.jacobian).max(axis=0) > 0.0))


def _wide(found: Identified[R]) -> _Wide:
    fit, every = found.fit, found.nominal.parameters
    rows, old = fit.problem.rows, fit.problem.unknowns
    unknowns = Unknowns(found.nominal, np.arange(len(every)), _frames(fit), rows, widths=old.widths)
    now = np.ones(len(unknowns), np.bool_)
    now[: len(every)] = np.isin(np.arange(len(every)), old.freed)
    theta = np.zeros(len(unknowns))
    theta[old.freed], theta[len(every) :] = fit.theta[: len(old.freed)], fit.theta[len(old.freed) :]
    problem = replace(fit.problem, unknowns=unknowns)
    residuals, jacobian = problem.whitened(problem.linearised(theta))
    families = tuple(family(p.name) for p in every)
    return _Wide(residuals, np.nonzero(rows.known)[0], jacobian, 1.0 / problem.width**2, now, theta, families)


def _left(jacobian: FloatArray, target: FloatArray, prior: FloatArray) -> float:
    """Chi-squared that is left of a target by least squares with priors about nothing."""
    return float(target @ target - (jacobian.T @ target) @ _step(jacobian, target, prior))


def _step(jacobian: FloatArray, target: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the least-squares unknowns of a target; 0 for those that nothing determines, as the place of an axis that slides."""
    normal = jacobian.T @ jacobian + np.diag(prior)
    size = np.sqrt(np.diagonal(normal))
    size[size == 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(normal / np.outer(size, size), (jacobian.T @ target) / size, rcond=1e-14)[0] / size)


def _by_stays(more: FloatArray, jacobian: FloatArray, residuals: FloatArray, stay: IntArray, *, count: int) -> float:
    """Return the probability of chance for the explanation of residuals (e,) by further columns (e, k), judged by its variation between
    stays (e,).

    Hotelling's test of the stays' scores in the columns' strongest directions is valid for any correlation of the rows of one stay: joints
    that repeat differently make turns of a stay likelier about some axes.
    """
    scores = more - jacobian @ np.linalg.lstsq(jacobian, more, rcond=1e-12)[0]
    strongest = np.linalg.svd(scores, full_matrices=False)[2][:count].T
    count = strongest.shape[1]
    of = np.zeros((int(stay.max()) + 1, count))
    np.add.at(of, stay, (scores @ strongest) * residuals[:, None])
    stays, total = len(of), of.sum(axis=0)
    if stays <= count:
        return 1.0
    square = float(total @ np.linalg.pinv(of.T @ of, hermitian=True) @ total)
    return float(scipy.stats.f.sf((stays - count) / count * square / max(stays - square, 1e-300), count, stays - count))


def _determined(jacobian: FloatArray, prior: FloatArray, which: BoolArray) -> int:
    """Return how many directions the rows determine among these unknowns."""
    white = jacobian[:, which] / np.sqrt(prior[which])
    return int((np.linalg.eigvalsh(white.T @ white) > 1.0).sum())


def _refitted(found: Identified[R], rows: IntArray) -> Identified[R]:
    problem = found.fit.problem
    again = replace(problem, rows=problem.rows.of(rows))
    if problem.weight is None:
        fit = with_noise(again, found.fit.theta)
    else:
        fit = weighted(solved(replace(again, weight=problem.weight[rows]), found.fit.theta))
    return replace(found, fit=fit)


def _errors(found: Identified[R], rows: Measurements) -> tuple[FloatArray, Prediction]:
    """(k,) distances of measured from predicted places of rows of the fit, and the prediction with the errors that these have."""
    reading = found.noise.reading_mm**2 / rows.readings
    instrument = rows.covariance[:, POSITION, POSITION] + reading[:, None, None] * np.eye(3)
    instrument = instrument + rows.systematic[:, POSITION] @ np.swapaxes(rows.systematic[:, POSITION], 1, 2)
    determined = predicted(found, rows, instrument)
    return np.linalg.norm(rows.position - determined.pose[:, :3], axis=1), determined


def _frames(fit: Fit[R]) -> Frames:
    start = fit.problem.unknowns.start
    return Frames(start.base, start.targets, start.stations, 0.0, np.ones(len(fit.problem.rows), np.bool_))


FALSE_ALARM = 1e-3
"""Probability with which a family that the robot has nothing of is freed."""
AMONG = ("once", "twice", "scale", "stiffness")
"""Families that are freed without a request. Play is not among them: only rows in the order of the motion show its side, and other changes
in that order, such as heat, look like it."""


def identify_with_choice(robot: R, rows: Measurements, settings: Settings | None = None, among: Sequence[str] = AMONG) -> Identified[R]:
    """`identify` with the families of `settings`, and of those `among` the ones that the measurements ask for.

    The one least likely by chance is freed first, until none is below `FALSE_ALARM`. A family that predicts unseen halves of the
    workspace worse stays out (`hold_out.Unseen`). `findings` name the families that the measurements ask for and that are not freed.
    """
    settings = settings or Settings()
    found = identify(robot, rows, settings)
    while True:
        requested = [w for w in worth_freeing(found) if not w.freed and w.chance < FALSE_ALARM and w.aic < 0.0]
        requested.sort(key=lambda w: (w.chance, w.aic))
        unseen = {w.family: unseen_halves(found, w.family) for w in requested if w.family in among}
        best = next((name for name, halves in unseen.items() if halves.good), None)
        if best is None:
            notes = [_noted(w) for w in requested if w.family not in unseen]
            if unseen:
                families, times = ", ".join(unseen), max(u.times for u in unseen.values())
                notes.append(noted("worth-freeing", "worse_unseen", families, times, families=families, times=times))
            return replace(found, findings=(*found.findings, *notes))
        settings = replace(settings, free=(*settings.free, best))
        found = identify(robot, rows, settings)


def _noted(worth: Worth) -> Noted:
    return noted("worth-freeing", "worth_freeing", worth.family, worth.chance, family=worth.family, chance=worth.chance)
