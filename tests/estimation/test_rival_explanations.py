"""Explanations beside each other: which one leaves a doubt, which one is idle once others are taken, and sizes at the ends of what is
looked for."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from problems import Line, Readings, arc

from lmeasure.estimation import Parameters, Problem, fit
from lmeasure.estimation.explanations import Evidence, Explained, Explanation, evidence, explained

FloatArray = NDArray[np.float64]

X = np.linspace(-1.0, 1.0, 40)
U = 0.1
RIGHT = (X > 0.0).astype(np.float64)


@dataclass(frozen=True)
class Noises:
    """All readings err more than stated, and will again, or those of the right half do."""

    stated: Readings
    values: tuple[str, ...] = ()

    def errors(self, problem: Line, theta: FloatArray) -> list[Explanation]:
        return [Explanation("all", np.eye(40), lasting=True), Explanation("right", np.eye(40)[:, 20:])]

    def widened(self, problem: Line, sizes: dict[tuple[str, str | None], float]) -> Line:
        share = {"all": np.ones(40), "right": RIGHT}
        more = sum((u**2 * share[name] for (name, _), u in sizes.items()), start=np.zeros(40))
        return Line(replace(self.stated, more=np.diag(more)))

    def freed(self, problem: Line, group: str) -> Line | None:
        return None


def test_a_lasting_error_that_gains_nearly_as_much_leaves_a_doubt() -> None:
    """By less than 9.2 in twice the log likelihood; one that was taken leaves none."""
    noise = np.random.default_rng(3).normal(size=40)
    seen: dict[float, bool] = {}
    for left in np.linspace(0.5, 2.6, 43):
        data = Readings(X, 1.0 + 2.0 * X + U * noise * np.where(RIGHT > 0, 3.0, left), U)
        problem, doubts = Line(data), Noises(data)
        state = Explained(problem, fit(problem, problem.start))
        judge, (lasting, right) = evidence(state.fit, state.fit.V), doubts.errors(problem, state.fit.theta)
        (size, of_all), (_, of_right) = judge.best(lasting), judge.best(right)
        found = explained(state, doubts)
        assert found.sizes
        if of_right > of_all:
            seen[of_right - of_all] = found.doubt > 0.0
            assert found.doubt in (0.0, pytest.approx(size))
        else:
            assert found.doubt == 0.0
    assert seen == {less: less < 9.2 for less in seen}
    assert [less for less in seen if 6.5 < less < 9.2]
    assert [less for less in seen if 9.2 < less < 13.0]


COLUMNS = {"a": np.sin(7.0 * X), "b": np.cos(11.0 * X), "z": np.sign(np.sin(29.0 * X))}
COLUMNS["mixed"] = COLUMNS["a"] + COLUMNS["b"] + 0.9 * np.cos(17.0 * X)


class Sum(Problem):
    """A line and sizes of chosen columns, known before to be nothing or as many as width."""

    def __init__(self, y: FloatArray, groups: tuple[str, ...] = (), *, width: float = 10.0) -> None:
        self.y, self.groups, self.width = y, groups, width
        names = ("line.offset", "line.slope", *(f"column.{g}" for g in groups))
        self.parameters = Parameters(names, np.zeros(len(names)), np.r_[10.0, 10.0, np.full(len(groups), width)])

    def residuals(self, theta: FloatArray) -> FloatArray:
        return np.asarray(self.jacobian(theta) @ theta - self.y)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        return np.column_stack([np.ones(40), X, *(COLUMNS[g] for g in self.groups)])

    def covariance(self, theta: FloatArray) -> FloatArray:
        return U**2 * np.eye(40)


@dataclass(frozen=True)
class Values:
    """Which columns may be solved for."""

    values: tuple[str, ...]

    def errors(self, problem: Sum, theta: FloatArray) -> list[Explanation]:
        return []

    def widened(self, problem: Sum, sizes: dict[tuple[str, str | None], float]) -> Sum:
        return problem

    def freed(self, problem: Sum, group: str) -> Sum | None:
        return None if group in problem.groups else Sum(problem.y, (*problem.groups, group), width=problem.width)


@pytest.mark.parametrize("solved", [(), ("z",)])
def test_what_others_have_made_idle_is_given_back(solved: tuple[str, ...]) -> None:
    """A column that looks like two is taken before them, and given back when both are; whatever is solved for already stays."""
    y = 1.0 + 2.0 * X + 1.5 * (COLUMNS["a"] + COLUMNS["b"]) + U * np.random.default_rng(2).normal(size=40)
    problem = Sum(y, solved)
    state, values = Explained(problem, fit(problem, problem.start)), Values(("a", "b", "mixed"))
    judge = evidence(state.fit, state.fit.V)
    gains = {g: judge.best(Explanation(g, 10.0 * COLUMNS[g][:, None]))[1] for g in values.values}
    assert max(gains, key=lambda g: gains[g]) == "mixed"
    found = explained(state, values)
    assert set(found.groups) == {"a", "b"}
    assert found.problem.groups == (*solved, *found.groups)
    assert found.fit.theta[-2:] == pytest.approx([1.5, 1.5], abs=0.1)


def test_a_value_is_looked_for_in_its_prior_width() -> None:
    """From a millionth of it to a thousand of it: an effect of 1.5 that could be ten thousand, and one that could be a thousandth."""
    y = 1.0 + 2.0 * X + 1.5 * COLUMNS["a"] + U * np.random.default_rng(2).normal(size=40)
    for width, groups in ((1e4, ("a",)), (1e-3, ())):
        problem = Sum(y, width=width)
        assert explained(Explained(problem, fit(problem, problem.start)), Values(("a",))).groups == groups


def test_sizes_at_the_ends_are_no_result() -> None:
    """A millionth and a thousand: nothing beyond is told; well inside they are."""
    r, J, noise = np.random.default_rng(5).normal(size=40), np.ones((40, 1)), Explanation("all", np.eye(40))
    for scale, told in ((1e-7, False), (1e-4, True), (10.0, True), (1e5, False)):
        size, gain = Evidence(scale * r, J, (1e-3 * scale) ** 2 * np.eye(40)).best(noise)
        assert (gain > 0.0) == told
        assert size == pytest.approx(scale * float(np.std(r, ddof=1)) if told else 0.0, rel=1e-3)


def test_the_last_size_is_the_best_beside_the_others() -> None:
    rng = np.random.default_rng(8)
    judge = Evidence(rng.normal(size=40) * np.where(RIGHT > 0, 1.0, 0.3), np.ones((40, 1)), 1e-4 * np.eye(40))
    both = [Explanation("all", np.eye(40)), Explanation("right", np.eye(40)[:, 20:])]
    first, second = judge.together(both, 0.0)
    assert second == pytest.approx(judge.best(both[1], first**2 * np.eye(40))[0], rel=1e-9)
    assert first == pytest.approx(judge.best(both[0], second**2 * np.diag(RIGHT))[0], rel=0.02)
    assert min(first, second) > 0.1


def test_what_only_nominal_values_hold_is_as_uncertain_as_they_are() -> None:
    """Of a short arc: the likelihood with their errors in the covariance, written out."""
    problem = arc(0.05, 12, 0.1, 2)
    found = fit(problem, problem.start)
    assert np.abs(found.undetermined).max() > 1e-3
    F, J, r = np.eye(12)[:, :6] * 2.0, found.determined, found.residuals
    V = found.V + found.undetermined @ found.undetermined.T

    def likelihood(u: float) -> float:
        W = np.linalg.inv(V + u**2 * F @ F.T)
        left = r - J @ np.linalg.solve(J.T @ W @ J, J.T @ W @ r)
        return float(np.linalg.slogdet(W)[1] - np.linalg.slogdet(J.T @ W @ J)[1] - left @ W @ left)

    judge = evidence(replace(found, residuals=8.0 * r), found.V)
    r = 8.0 * r
    size, gain = judge.best(Explanation("noise", F))
    assert size > 0.0
    assert gain == pytest.approx(likelihood(size) - likelihood(0.0), rel=1e-6)
