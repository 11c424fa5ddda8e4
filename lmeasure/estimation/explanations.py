"""Residuals larger than the stated noise: competing explanations, and their evidence.

Each explanation adds a covariance u^2 F F' to that of the residuals: unstated errors, or an inexact value taken as exact (F then contains
the residuals' derivatives by it, in prior widths). With r' = N'L^-1 r, L L' the covariance so far and N a basis of the space that the
solved unknowns cannot explain, twice the restricted log likelihood (Patterson and Thompson, Biometrika 58, 1971) rises by

    gain(u) = sum_i y_i^2 u^2 s_i^2/(1 + u^2 s_i^2) - log(1 + u^2 s_i^2),

s_i the singular values of N'L^-1 F and y = U'r'. Each explanation has one number, so that their gains are comparable: the largest gain is
taken first, as long as it exceeds chance. Errors widen the covariance, values are solved for.
"""

from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
import scipy

from lmeasure.core import FloatArray
from lmeasure.estimation.least_squares import fit
from lmeasure.estimation.problem import Fit, Problem

CHANCE = 1e-3
"""Probability under which residuals are not put down to chance."""

NEEDED = 12.0
"""Least gain in twice the log likelihood for which an explanation is taken: chance has it once in thousands, and there are a dozen."""

SURE = 20.0  # The same of a further explanation, when chi-squared is no longer beyond chance: residuals that could be left as they are

MOST_TAKEN = 3  # Most explanations that are accepted for one problem

ROUNDS = 2  # the second settles a size where the first moved the optimum

ASKED = 4.0  # Least gain of an explanation in addition to others

ALLOWED = 0.5
"""Fall of twice the log likelihood down to which residuals allow an unstated error: it may exist without showing.

The largest such size is below the true one in 24 of 100 cases (chi-squared of one degree of freedom), with a fall of 1.0 in 16. More would
make uncertainties larger than they need be: with 0.5 they are already twice the errors of a campaign of 20 noisy poses of known truth.
"""

REFUTED = 9.2  # By how much less a lasting error must gain than another, so that it need not be reckoned with: odds of a hundred

LEAST, MOST = 1e-6, 1e3  # sizes between which an explanation is looked for; neither is a result
GRID = 60
SWEEPS = 4

Key = tuple[str, str | None]


@dataclass(frozen=True)
class Explanation:
    """name; F (e, c) change of the residuals by its independent standard errors, for the size 1; label: its object among several; lasting:
    whether the same errors are in all later measurements."""

    name: str
    F: FloatArray
    label: str | None = None
    lasting: bool = False

    @property
    def key(self) -> Key:
        """Return the key that distinguishes it from others."""
        return self.name, self.label


P = TypeVar("P", bound=Problem)


class Alternatives(Protocol[P]):
    """Alternatives to a problem that its maker can state."""

    def errors(self, problem: P, theta: FloatArray) -> list[Explanation]:
        """Return explanations that are unstated errors."""

    def widened(self, problem: P, sizes: dict[Key, float]) -> P:
        """Return the problem with errors of these sizes beside the stated ones."""

    @property
    def values(self) -> tuple[str, ...]:
        """Groups of values that are taken as exact, and whose errors look like nothing else."""

    def freed(self, problem: P, group: str) -> P | None:
        """The problem with a group solved for too; None where it is already."""


@dataclass(frozen=True)
class Explained(Generic[P]):
    """The present problem and its fit, under the explanations so far: groups of values that are solved for too, and errors with their
    sizes. doubt: size of a lasting error that explains nearly as well the part explained by another. unstated: errors without a stated
    size; if they do not show, they are as large as the residuals allow."""

    problem: P
    fit: Fit
    groups: tuple[str, ...] = ()
    sizes: dict[Key, float] = field(default_factory=dict)
    doubt: float = 0.0
    unstated: tuple[Key, ...] = ()


def improbable(found: Fit, chance: float = CHANCE) -> bool:
    """Return whether chi-squared of a fit is beyond chance."""
    freedom = found.freedom
    return freedom >= 1 and bool(scipy.stats.chi2.sf(found.chi2, freedom) < chance)


def explained(state: Explained[P], alternatives: Alternatives[P]) -> Explained[P]:
    """Return the best explanation of the residuals beside those so far, one after another."""
    begun = state.problem
    for _ in range(MOST_TAKEN):
        gains = _gains(state, alternatives)
        best = max(gains, key=lambda each: each.gain, default=None)
        if best is None or best.gain < _needed(state):
            break
        state = _pruned(_with(state, best, gains, alternatives), begun, alternatives)
    return state


def settled(state: Explained[P], alternatives: Alternatives[P]) -> Explained[P]:
    """The state with the sizes of its errors estimated together, and the fit under them."""
    for _ in range(ROUNDS if state.sizes else 0):
        theta = state.fit.theta
        every = {x.key: x for x in alternatives.errors(state.problem, theta)}
        judge = evidence(state.fit, alternatives.widened(state.problem, {}).covariance(theta))
        found = judge.together([every[key] for key in state.sizes], [key in state.unstated for key in state.sizes])
        sizes = dict(zip(state.sizes, found, strict=True))
        problem = alternatives.widened(state.problem, sizes)
        state = replace(state, problem=problem, sizes=sizes, fit=fit(problem, theta, state.fit.prior_everywhere))
    return state


def embedded(problem: Problem, theta: FloatArray, wider: Problem) -> FloatArray:
    """theta of a problem as values of one that solves for more: nominal where it has none."""
    known = dict(zip(problem.names, theta, strict=True))
    return np.array([known.get(n, v) for n, v in zip(wider.names, wider.start, strict=True)])


def evidence(found: Fit, V: FloatArray) -> "Evidence":
    """Return the evidence under a covariance V of the residuals; deciding nominal values have their prior uncertainty."""
    silent = found.undetermined
    return Evidence(found.residuals, found.determined, V + silent @ silent.T)


@dataclass(frozen=True)
class _Gain:
    """Gain of an explanation of a size beside those taken."""

    explanation: Explanation
    size: float
    gain: float


def _needed(state: Explained[P]) -> float:
    return NEEDED if improbable(state.fit) else SURE


def _gains(state: Explained[P], alternatives: Alternatives[P]) -> list[_Gain]:
    """Return the gain of each further explanation."""
    problem, theta = state.problem, state.fit.theta
    every = [x for x in alternatives.errors(problem, theta) if x.key not in state.sizes]
    for group in alternatives.values:
        wider = alternatives.freed(problem, group)
        new = np.zeros(0, np.bool_) if wider is None else ~np.isin(wider.parameters.names, problem.parameters.names)
        if wider is not None and new.any():
            J = wider.jacobian(embedded(problem, theta, wider))[:, : wider.own]
            every.append(Explanation(group, J[:, new] * wider.parameters.width[new]))
    judge = evidence(state.fit, state.fit.V)
    return [_Gain(x, *judge.best(x)) for x in every]


def _with(state: Explained[P], taken: _Gain, gains: list[_Gain], alternatives: Alternatives[P]) -> Explained[P]:
    """The state with a further explanation, the best of some."""
    one = taken.explanation
    problem = alternatives.freed(state.problem, one.name) if one.name in alternatives.values else None
    if problem is None:
        if not one.lasting:
            # with few data they look alike; only a lasting error returns in later measurements
            rival = next((g for g in gains if g.explanation.lasting), None)
            if rival is not None and rival.gain > taken.gain - REFUTED:
                state = replace(state, doubt=rival.size)
        return settled(replace(state, sizes={**state.sizes, one.key: 0.0}), alternatives)
    return _solved_for(state, problem, (*state.groups, one.name), alternatives)


def _solved_for(state: Explained[P], problem: P, groups: tuple[str, ...], alternatives: Alternatives[P]) -> Explained[P]:
    """The state with a problem that solves for these groups, from where it was."""
    problem = alternatives.widened(problem, state.sizes)
    found = fit(problem, embedded(state.problem, state.fit.theta, problem), state.fit.prior_everywhere)
    return settled(replace(state, problem=problem, fit=found, groups=groups), alternatives)


def _pruned(state: Explained[P], begun: P, alternatives: Alternatives[P]) -> Explained[P]:
    """Return the state without groups of values that later explanations have made idle: errors can look like anything."""
    for group in state.groups[:-1] if not state.sizes else state.groups:
        problem, others = begun, tuple(g for g in state.groups if g != group)
        for name in others:
            problem = alternatives.freed(problem, name) or problem
        trial = _solved_for(state, problem, others, alternatives)
        if next(g.gain for g in _gains(trial, alternatives) if g.explanation.name == group) < _needed(trial):
            state = trial
    return state


class Evidence:
    """Gains of explanations over a covariance V (e, e) of residuals (e,) with derivatives J (e, p) by the solved parameters."""

    def __init__(self, residuals: FloatArray, J: FloatArray, V: FloatArray) -> None:
        self._r, self._J, self._V = residuals, J, V

    def best(self, explanation: Explanation, others: FloatArray | None = None) -> tuple[float, float]:
        """Size u and gain of one explanation beside others, a covariance (e, e) [mm^2]; (0, 0) where there is none within the bounds."""
        return self._best(explanation, others)[:2]

    def _best(self, explanation: Explanation, others: FloatArray | None) -> tuple[float, float, float]:
        """`best`, and the largest size that the residuals allow."""
        L = np.linalg.cholesky(self._V if others is None else self._V + others)
        whiten = scipy.linalg.solve_triangular(L, np.column_stack([self._J, self._r, explanation.F]), lower=True)
        p = self._J.shape[1]
        Q, _ = np.linalg.qr(whiten[:, :p], mode="complete")
        rest = Q[:, p:].T @ whiten[:, p:]
        U, s, _ = np.linalg.svd(rest[:, 1:], full_matrices=False)
        y, square = (U.T @ rest[:, 0]) ** 2, s**2

        def loss(log_u: float) -> float:
            x = np.exp(2.0 * log_u) * square
            return float(np.sum(np.log1p(x) - y * x / (1.0 + x)))

        grid = np.linspace(np.log(LEAST), np.log(MOST), GRID)
        losses = [loss(x) for x in grid]
        i = int(np.argmin(losses))
        most = float(np.exp(max(x for x, z in zip(grid, losses, strict=True) if z <= losses[i] + ALLOWED)))
        if i in (0, GRID - 1) or losses[i] >= 0.0:
            return 0.0, 0.0, most
        found = scipy.optimize.minimize_scalar(loss, bounds=(grid[i - 1], grid[i + 1]), method="bounded", options={"xatol": 1e-4})
        return float(np.exp(found.x)), -float(found.fun), most

    def together(self, explanations: list[Explanation], unstated: list[bool]) -> list[float]:
        """Sizes of several explanations at once, each the best beside the others. For one that gains less than `ASKED` beside them: 0, or
        the largest that the residuals allow if its size is unstated."""
        sizes = [0.0] * len(explanations)
        for _ in range(SWEEPS if len(explanations) > 1 else 1):
            for i, each in enumerate(explanations):
                others = sum(
                    (u**2 * x.F @ x.F.T for j, (u, x) in enumerate(zip(sizes, explanations, strict=True)) if j != i and u),
                    start=np.zeros_like(self._V),
                )
                u, gain, most = self._best(each, others)
                sizes[i] = u if gain >= ASKED else most * unstated[i]
        return sizes
