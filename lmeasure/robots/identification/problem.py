"""An identification as a problem of `estimation`: residuals, derivatives, priors and covariance, and the noise estimated from the
residuals.

Errors of different stays do not correlate, and common errors of all rows are unknowns of their own: `estimation.normal_equations` takes the
residuals whitened stay by stay, which forms no covariance of all of them. Other users of a problem may form it. Rows of one stay share the
robot's noise there: a shift, and a turn about the mean position of the stay's rows. Its variances and those of readings without a statement
are found by restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.estimation import (
    EXCLUDED,
    Optimum,
    Parameters,
    Problem as estimation_Problem,
    biweights,
    deletion_squares,
    normal_deviates,
    optimum,
    scatter,
    trust,
)
from lmeasure.robots.identification.measurements import COMPONENTS, KINDS, POSITION, ROTATION, Measurements, Scatter
from lmeasure.robots.identification.unknowns import R, Unknowns

LEAST_MM, LEAST_RAD = 1e-6, 1e-9
"""Least noise where none is stated: exact numbers are weighed as rounded to a nanometre."""
ROUNDS = 12
SETTLED = 1e-3
WEIGHT_ROUNDS = 40
NORMAL_MEDIAN = 0.6745
"""Median of |z|."""
LEAST_LEFT = 1e-3
"""Least variance of a component's residual, as a part of its stated one."""
NOTHING = Scatter(np.zeros(2), np.zeros(2))


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the robot's own noise at a stay, in each coordinate of a target and each component of its turn, and of a
    reading without a statement."""

    position_mm: float
    rotation_rad: float
    reading_mm: float = 0.0
    reading_rad: float = 0.0

    @property
    def variance(self) -> FloatArray:
        """(6,) of components (rotation; position), of the robot."""
        return np.repeat([self.rotation_rad**2, self.position_mm**2], 3)

    @property
    def of_reading(self) -> FloatArray:
        """(6,) the same of a reading."""
        return np.repeat([self.reading_rad**2, self.reading_mm**2], 3)

    @property
    def parts(self) -> FloatArray:
        """(4,) variances: turns and positions at a stay, turns and positions of a reading."""
        return np.array([self.rotation_rad, self.position_mm, self.reading_rad, self.reading_mm]) ** 2


@dataclass(frozen=True)
class Problem(estimation_Problem, Generic[R]):
    """Residuals of rows under a noise, in standard deviations, against changes theta of the unknowns in the units of their names."""

    unknowns: Unknowns[R]
    rows: Measurements
    noise: Noise
    own_noise: bool = True
    """Whether the noise is looked for in the residuals, or as it is."""
    weight: FloatArray | None = None
    """(N,) weights of rows, `estimation.robust.biweights` of their distance from all others; None: all alike."""
    trust: float = 1.0
    """Value of the weighted rows together (`estimation.robust.trust`)."""
    scatter: Scatter = NOTHING
    """Scatter of readings about the rows, which are their means."""
    parameters: Parameters = field(init=False, compare=False, repr=False)
    """The unknowns as changes, about nothing."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", Parameters(self.names, np.zeros(len(self.names)), self.width))

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) of the unknowns."""
        return self.unknowns.names

    @cached_property
    def width(self) -> FloatArray:
        """(p,) prior standard uncertainties in the units of the names."""
        return self.unknowns.width / self.unknowns.size

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) modelled minus measured, of the components that were measured."""
        return -self.linearised(theta).residuals[self.rows.known]

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, p)."""
        return self.linearised(theta).jacobian[self.rows.known]

    def covariance(self, theta: FloatArray) -> FloatArray:
        """(e, e)."""
        n, known = len(self.rows), self.rows.known
        out = np.zeros((n, COMPONENTS, n, COMPONENTS))
        for of in self.stays:
            parts = self.of_stays(of).reshape(len(of), of.shape[1], COMPONENTS, of.shape[1], COMPONENTS)
            for rows, part in zip(of, parts, strict=True):
                out[rows[:, None], :, rows[None], :] = part.transpose(0, 2, 1, 3) / max(float(self.counts[rows[0]]), EXCLUDED)
        return np.asarray(out.reshape(n * COMPONENTS, -1)[np.ix_(known.reshape(-1), known.reshape(-1))])

    @property
    def counts(self) -> FloatArray:
        """(N,) how much the rows' information counts, the same for all of a stay."""
        return np.ones(len(self.rows)) if self.weight is None else self.trust * self.weight

    @cached_property
    def stays(self) -> tuple[IntArray, ...]:
        """(S, m) the rows of every stay, those of stays with as many rows together, m = 1 first."""
        _, of, counts = np.unique(self.rows.stay, return_inverse=True, return_counts=True)
        order, ends = np.argsort(of, kind="stable"), np.cumsum(counts)
        return tuple(order[(ends - counts)[counts == m, None] + np.arange(m)] for m in np.unique(counts).tolist())

    @property
    def several(self) -> bool:
        """Return whether any stay has several rows."""
        return bool(self.stays[-1].shape[1] > 1) if self.stays else False

    @cached_property
    def levers(self) -> FloatArray:
        """(N, 6, 6), see `Unknowns.levers`."""
        return self.unknowns.levers(self.rows)

    @cached_property
    def _of_rows(self) -> FloatArray:
        """Return (N, 6, 6) covariance of the errors that rows do not share, the identity for missing measurements."""
        known = self.rows.known
        out = self.rows.covariance + np.diag(self.noise.of_reading) / self.rows.readings[:, None, None]
        out = out * (known[:, :, None] & known[:, None, :])
        return np.asarray(out + (~known)[:, :, None] * np.eye(COMPONENTS))

    @cached_property
    def blocks(self) -> FloatArray:
        """(N, 6, 6) of a row's components, the identity where nothing was measured."""
        if self.several:
            return np.asarray(self._of_rows + self.levers @ np.diag(self.noise.variance) @ np.swapaxes(self.levers, 1, 2))
        return np.asarray(self._of_rows + np.where(self.rows.known, self.noise.variance, 0.0)[:, :, None] * np.eye(COMPONENTS))

    def of_stays(self, of: IntArray) -> FloatArray:
        """(S, 6 m, 6 m) of the components of rows (S, m) that stays have in common."""
        if of.shape[1] == 1:
            return self.blocks[of[:, 0]]
        count, m = of.shape
        out = self.joined(of, self.noise.variance)
        parts = out.reshape(count, m, COMPONENTS, m, COMPONENTS)
        parts[:, np.arange(m), :, np.arange(m)] += np.swapaxes(self._of_rows[of], 0, 1)
        return out

    def joined(self, of: IntArray, variance: FloatArray) -> FloatArray:
        """Return (S, 6 m, 6 m) covariance of a stay's noise in rows (S, m), by variances (6,) of its turn and shift."""
        count, m = of.shape
        levers = self.levers[of].reshape(count, m * COMPONENTS, COMPONENTS)
        return np.asarray((levers * variance) @ np.swapaxes(levers, 1, 2))

    @cached_property
    def _whitening(self) -> list[tuple[IntArray, FloatArray]]:
        """Return for the rows (S, m) of stays, (S, 6 m, 6 m), or (S, 6, 1) for uncorrelated components."""
        out = []
        for of in self.stays:
            C, root = self.of_stays(of), np.sqrt(self.counts[of[:, 0]])[:, None, None]
            variance = np.einsum("nii->ni", C)
            if of.shape[1] == 1 and np.count_nonzero(C) == variance.size:
                out.append((of, root / np.sqrt(variance)[:, :, None]))
            else:
                out.append((of, root * np.linalg.inv(np.linalg.cholesky(C))))
        return out

    def linearised(self, theta: FloatArray) -> "Linear":
        """Return the prediction at theta (p,) and its derivatives."""
        residuals, jacobian = self.unknowns.linearised(theta * self.unknowns.size, self.rows)
        return Linear(residuals, jacobian * self.unknowns.size)

    def shifted(self, at: "Linear", step: FloatArray) -> "Linear":
        """The same a small step (p,) farther."""
        return Linear(at.residuals - at.jacobian @ step, at.jacobian)

    def whitened(self, at: "Linear") -> tuple[FloatArray, FloatArray]:
        """Return (e,) residuals, measured minus predicted, in standard deviations, and (e, p) derivatives of the prediction."""
        known, p = self.rows.known, at.jacobian.shape[2]
        residuals, jacobian = np.empty_like(at.residuals), np.empty_like(at.jacobian)
        for of, W in self._whitening:
            r, j = at.residuals[of].reshape(len(of), -1, 1), at.jacobian[of].reshape(len(of), -1, p)
            r, j = (r * W, j * W) if W.shape[2] == 1 else (W @ r, W @ j)
            residuals[of], jacobian[of] = r.reshape(*of.shape, COMPONENTS), j.reshape(*of.shape, COMPONENTS, p)
        return residuals[known], jacobian[known]


@dataclass(frozen=True)
class Linear:
    """residuals (N, 6), measured minus predicted; jacobian (N, 6, p) of the prediction by the unknowns in the units of their names."""

    residuals: FloatArray
    jacobian: FloatArray


@dataclass(frozen=True)
class Fit(Optimum[Linear], Generic[R]):
    """The optimum of an identification: theta (p,) are changes in the units of the names."""

    problem: Problem[R]

    @property
    def counted(self) -> float:
        """Residuals, each as much as the weight of its row."""
        weight = self.problem.weight
        return float(self.equations) if weight is None else float(weight @ self.problem.rows.known.sum(axis=1))

    @cached_property
    def spare(self) -> float:
        """Return the number of residuals minus determined unknowns; if rows share stays or are means of readings, at most the degrees of
        freedom of a position's variance (Satterthwaite, Biometrics Bulletin 2, 1946)."""
        every = self.counted - self.determined
        if not self.problem.own_noise or not (self.problem.several or self.problem.scatter.freedom.any()):
            return every
        variance, (_, information) = self.problem.noise.parts, _scores(self)
        weight = np.array([0.0, 1.0, 0.0, 1.0 / float(self.problem.rows.readings.mean())])
        of = np.flatnonzero(_sought(self.problem) & (weight > 0.0))
        if not len(of):
            return every
        known = float(weight[of] @ _inverse(information[np.ix_(of, of)]) @ weight[of])
        return min(every, float(weight @ variance) ** 2 / known) if known > 0.0 else every

    @property
    def freedom(self) -> float:
        """The same, as degrees of freedom: 1 at least."""
        return max(self.spare, 1.0)

    @property
    def x(self) -> FloatArray:
        """(p,) changes in rad and mm."""
        return self.theta * self.problem.unknowns.size


def solved(problem: Problem[R], start: FloatArray, at: Linear | None = None) -> Fit[R]:
    """Return the optimum near start (p,), with the priors everywhere, which are too wide to move determined values.

    at: the prediction near start, if already known.
    """
    return Fit(**vars(optimum(problem, start, at)), problem=problem)


def with_noise(problem: Problem[R], start: FloatArray) -> Fit[R]:
    """Return the optimum with the robot's noise from the residuals: their scatter beyond the instrument's stated one."""
    fit = solved(problem, start)
    for _ in range(ROUNDS if problem.own_noise else 0):
        before = fit.problem.noise
        now = _noise(fit)
        fit = solved(replace(fit.problem, noise=now), fit.theta, fit.at)
        if all(_near(*pair) for pair in zip(np.sqrt(before.parts), np.sqrt(now.parts), strict=True)):
            break
    return fit


def weighted(fit: Fit[R]) -> Fit[R]:
    """Return the optimum with every stay weighted by Tukey's biweight of its distance from all others, starting with the weights of the
    fit.

    Weights and the robot's noise are found together. The first judge is the median of all stays, which tolerates bad ones up to half: a
    noise estimated with bad stays would hide them.
    """
    middle = 1.0
    for again in range(WEIGHT_ROUNDS):
        square, components, first = stay_distances(fit)
        seen = components > 0
        one = seen & first
        z = normal_deviates(square[seen], components[seen])
        middle = float(np.median(z[first[seen]])) / NORMAL_MEDIAN if not again else 1.0
        weight = np.zeros(len(components))
        weight[seen] = biweights(z / middle)
        before = fit.problem.weight
        problem = replace(fit.problem, weight=weight, trust=trust(square[one], components[one], weight[one], fit.determined))
        problem = replace(problem, noise=_noise(replace(fit, problem=problem))) if problem.own_noise else problem
        fit = solved(problem, fit.theta, fit.at)
        if before is not None and np.abs(weight - before).max() < SETTLED:
            break
    return fit


def stay_distances(fit: Fit[R]) -> tuple[FloatArray, IntArray, BoolArray]:
    """(N,) of each row, `distances` of its stay, the components of that, and whether it is the stay's first row."""
    problem, n = fit.problem, len(fit.problem.rows)
    square, components, first = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, np.bool_)
    for of in problem.stays:
        square[of] = distances(fit, problem, fit.at, of, counts=problem.counts[of[:, 0]])[:, None]
        components[of] = problem.rows.known[of].sum(axis=(1, 2))[:, None]
        first[of[:, 0]] = True
    return square, components, first


def distances(fit: Fit[R], problem: Problem[R], at: Linear, of: IntArray, *, counts: FloatArray) -> FloatArray:
    """(S,) squared distance of the residuals of rows (S, m) of stays of a problem, seen at the fit's optimum, from nothing in their own
    covariance, that of the prediction included; as in a fit without them where they counted (S,) in this one."""
    known = problem.rows.known[of].reshape(len(of), -1)
    jacobian = at.jacobian[of].reshape(*known.shape, -1)
    explained = jacobian @ fit.covariance @ np.swapaxes(jacobian, 1, 2) * (known[:, :, None] & known[:, None, :])
    residuals = np.where(known, at.residuals[of].reshape(known.shape), 0.0)
    return deletion_squares(residuals, problem.of_stays(of), explained, counts)


def _noise(fit: Fit[R]) -> Noise:
    """A step of Fisher's scoring to the variances of the restricted likelihood, none of them negative."""
    problem = fit.problem
    score, information = _scores(fit)
    before, of = problem.noise.parts, np.flatnonzero(_sought(problem))
    step, held = np.zeros(4), np.zeros(4, np.bool_)
    while True:
        free = of[~held[of]]
        step[held] = -before[held]
        pull = score[free] - information[np.ix_(free, np.flatnonzero(held))] @ step[held]
        step[free] = _inverse(information[np.ix_(free, free)]) @ pull if len(free) else 0.0
        below = free[(before + step)[free] < 0.0]
        if not len(below):
            break
        held[below[np.argmin((before + step)[below])]] = True
    size = np.sqrt(np.maximum(before + step, 0.0))
    for kind, (own, least) in enumerate(((ROTATION, LEAST_RAD), (POSITION, LEAST_MM))):
        known = problem.rows.known[:, own]
        if not known.any():
            size[kind] = max(float(size[kind]), least)
        elif not np.einsum("nii->ni", problem.rows.covariance)[:, own][known].all():
            size[kind] = max(float(size[kind]), least)
            size[kind + 2] = max(float(size[kind + 2]), least) if _sought(problem)[kind + 2] else 0.0
    return Noise(float(size[1]), float(size[0]), float(size[3]), float(size[2]))


def _inverse(information: FloatArray) -> FloatArray:
    """Return the pseudo-inverse of an information (k, k) of variances, each in its own unit: rad² and mm² may differ by 10^22."""
    size = np.sqrt(np.diagonal(information))
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(np.linalg.pinv(information / np.outer(size, size), hermitian=True) / np.outer(size, size))


def _sought(problem: Problem[R]) -> BoolArray:
    """Return (4,) the variances (`Noise.parts`) that the rows can separate: those of readings without a statement if stays have several
    rows or readings, that of a stay's turn also if stays have several targets."""
    known, stated, shared = problem.rows.known, problem.rows.stated[::-1], problem.several
    out = np.zeros(4, np.bool_)
    for kind, own in enumerate(KINDS):
        out[kind] = known[:, own].any()
        out[kind + 2] = out[kind] and not stated[kind] and (shared or problem.scatter.freedom[kind] > 0.0)
    if shared and not out[0]:
        out[0] = bool((np.abs(problem.levers[:, POSITION, ROTATION]).max(axis=(1, 2)) > 1.0).any())
    return out


def _scores(fit: Fit[R]) -> tuple[FloatArray, FloatArray]:
    """(4,) and (4, 4): twice the slope of the restricted likelihood by the variances (`Noise.parts`), and twice its information.

    With V_k the derivative of the covariance V of a stay by the k-th: r' V^-1 V_k V^-1 r - tr(V^-1 V_k V^-1 X), X = V - J C J' the
    covariance of residuals r; the information is tr(V^-1 V_k V^-1 V_l V^-1 X), exact where each stay is one block of its own.
    """
    problem = fit.problem
    sought = np.flatnonzero(_sought(problem))
    score, information = np.zeros(4), np.zeros((4, 4))
    for of in problem.stays:
        known = problem.rows.known[of].reshape(len(of), -1)
        V, counts, n = problem.of_stays(of), problem.counts[of[:, 0]][:, None, None], known.shape[1]
        jacobian = fit.at.jacobian[of].reshape(len(of), n, -1)
        inverse = np.linalg.inv(V)
        share = jacobian @ fit.covariance @ np.swapaxes(jacobian, 1, 2) @ inverse
        # with weights: residual of a fit without the stay, times the weight of the stay
        left = (np.eye(n) - counts * share) @ (np.eye(n) - counts * share + share) @ V
        # a component that is used up by the unknowns shows no noise
        diagonal, least = np.einsum("nii->ni", left), LEAST_LEFT * np.einsum("nii->ni", V)
        left = left + np.maximum(least - diagonal, 0.0)[:, :, None] * np.eye(n)
        weight, normal = np.ones(len(of)), np.ones(len(of))
        if problem.weight is not None:
            weight = problem.weight[of[:, 0]]
            normal = np.array([scatter(int(m)) if m else 1.0 for m in known.sum(axis=1)])
        r = np.where(known, fit.at.residuals[of].reshape(len(of), n), 0.0)
        pulled = np.einsum("nij,nj->ni", inverse, r)
        rest, by = inverse @ left, {}
        for k in sought.tolist():
            by[k] = inverse @ _derivative(problem, of, k)
            score[k] += weight @ (np.einsum("ni,nij,nj->n", r, by[k], pulled) / normal - np.einsum("nij,nji->n", by[k], rest))
        for k in by:
            for m in by:
                information[k, m] += weight @ np.einsum("nij,njk,nki->n", by[k], by[m], rest, optimize=True)
    for kind in range(2):
        k, now = kind + 2, float(problem.noise.parts[kind + 2])
        if k in sought and problem.scatter.freedom[kind] > 0.0:
            score[k] += problem.scatter.square[kind] / now**2 - problem.scatter.freedom[kind] / now
            information[k, k] += problem.scatter.freedom[kind] / now**2
    return score, 0.5 * (information + information.T)


def _derivative(problem: Problem[R], of: IntArray, part: int) -> FloatArray:
    """(S, 6 m, 6 m) of the covariance of rows (S, m) of stays by one of the variances."""
    own = np.zeros(COMPONENTS)
    own[KINDS[part % 2]] = 1.0
    known = problem.rows.known[of].reshape(len(of), -1)
    if part < 2 and of.shape[1] > 1:
        return problem.joined(of, own)
    size = own if part < 2 else own / problem.rows.readings[of][:, :, None]
    return np.asarray(np.where(known, np.broadcast_to(size, (*of.shape, COMPONENTS)).reshape(known.shape), 0.0)[:, :, None]) * np.eye(
        known.shape[1]
    )


def _near(one: float, other: float) -> bool:
    return abs(one - other) <= SETTLED * max(one, other)
