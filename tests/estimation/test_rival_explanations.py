"""Explanations beside each other: which one leaves a doubt, which one is idle once others are taken, and sizes at the ends of what is
looked for."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.stats
from problems import Line, Readings, arc

from lmeasure.core import FloatArray
from lmeasure.estimation import Explained, Explanation, Parameters, Problem, evidence, explained, fit, improbable
from lmeasure.estimation.explanations import Evidence

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


@dataclass(frozen=True)
class ValuesAndNoises(Values):
    """The same, and readings at either end may err more than stated."""

    def errors(self, problem: Sum, theta: FloatArray) -> list[Explanation]:
        return [Explanation("noise", np.eye(40)[:, on], end) for end, on in ENDS.items()]

    def widened(self, problem: Sum, sizes: dict[tuple[str, str | None], float]) -> Sum:
        more = np.asarray(sum((u**2 * ENDS[str(end)] for (_, end), u in sizes.items()), start=np.zeros(40)), dtype=np.float64)
        return Noisy(problem.y, problem.groups, width=problem.width, more=more)

    def freed(self, problem: Sum, group: str) -> Sum | None:
        more = problem.more if isinstance(problem, Noisy) else np.zeros(40)
        return None if group in problem.groups else Noisy(problem.y, (*problem.groups, group), width=problem.width, more=more)


class Noisy(Sum):
    """Variances more (40,) are added."""

    def __init__(self, y: FloatArray, groups: tuple[str, ...], *, width: float, more: FloatArray) -> None:
        super().__init__(y, groups, width=width)
        self.more = more

    def covariance(self, theta: FloatArray) -> FloatArray:
        return np.diag(U**2 + self.more)


ENDS = {"left": X < -0.4, "right": X > 0.4}


@pytest.mark.parametrize("seed", [4, 6, 8])
def test_a_value_that_noise_has_made_idle_is_given_back(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A column that happens to be somewhat like the noise of both ends explains more than that of either, and nothing beside both."""
    rng = np.random.default_rng(seed)
    ends = ENDS["left"] | ENDS["right"]
    noise, other = np.zeros(40), np.zeros(40)
    noise[ends], other[ends] = 0.5 * rng.normal(size=(2, ends.sum()))
    y = 1.0 + 2.0 * X + U * rng.normal(size=40) + noise
    monkeypatch.setitem(COLUMNS, "alike", np.sqrt(0.55) * noise + np.sqrt(0.45) * other)
    problem, doubts = Sum(y), ValuesAndNoises(("alike",))
    state = Explained(problem, fit(problem, problem.start))
    judge = evidence(state.fit, state.fit.V)
    of_noise = [judge.best(one)[1] for one in doubts.errors(problem, state.fit.theta)]
    assert judge.best(Explanation("alike", 10.0 * COLUMNS["alike"][:, None]))[1] > max(of_noise)
    found = explained(state, doubts)
    assert found.groups == ()
    assert {key[1]: u > 0.2 for key, u in found.sizes.items()} == {"left": True, "right": True}


def test_no_more_than_three_things_are_taken() -> None:
    """Of four that are there, those that gain most."""
    sizes = {"a": 4.0, "b": 3.0, "z": 2.0, "slow": 1.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(COLUMNS, "slow", np.cos(3.0 * X))
        y = sum((size * COLUMNS[g] for g, size in sizes.items()), start=X + U * np.random.default_rng(2).normal(size=40))
        problem = Sum(y)
        found = explained(Explained(problem, fit(problem, problem.start)), Values(tuple(sizes)))
    assert len(found.groups) == 3
    assert improbable(found.fit)


def test_beyond_chance_less_is_asked_of_an_explanation() -> None:
    """A gain of 12, where 20 are asked for of residuals that could be left as they are."""
    noise = 0.17 * np.random.default_rng(2).normal(size=40)
    taken: dict[float, bool] = {}
    for size in np.linspace(0.05, 0.35, 31):
        problem = Sum(X + noise + size * COLUMNS["a"])
        state = Explained(problem, fit(problem, problem.start))
        assert improbable(state.fit)
        gain = evidence(state.fit, state.fit.V).best(Explanation("a", 10.0 * COLUMNS["a"][:, None]))[1]
        taken[gain] = explained(state, Values(("a",))).groups == ("a",)
    assert [gain for gain in taken if 12.0 < gain < 18.0]
    assert [gain for gain in taken if 8.0 < gain < 12.0]
    assert taken == {gain: gain > 12.0 for gain in taken}


def test_beyond_chance_is_what_happens_less_than_once_in_a_thousand() -> None:
    """Also of a single degree of freedom; with none there is no telling."""
    found = fit(Sum(X), np.zeros(2))
    assert found.freedom == 38
    odds = {0.0012: False, 0.0008: True}
    assert {p: improbable(replace(found, chi2=float(scipy.stats.chi2.isf(p, 38)))) for p in odds} == odds
    for left, determined in ((1, True), (0, False)):
        one = replace(found, lost=38.0 - left, chi2=30.0)
        assert one.freedom == left
        assert improbable(one) == determined


def test_what_gains_nothing_has_no_size() -> None:
    """Two errors of one size: of the first so little is there that the other, however large, does not make up for it. At its own likeliest
    size the two together are less likely than without."""
    for square, determined in ((44.7, False), (60.0, True)):
        F = np.diag([1e8, 1.0])
        judge = Evidence(np.array([0.0, np.sqrt(square), 0.0]), np.eye(3)[:, 2:], np.eye(3))
        size, gain = judge.best(Explanation("both", np.vstack([F, np.zeros((1, 2))])))
        assert (size > 0.0, gain > 0.0) == (determined, determined)


def test_a_value_is_looked_for_in_its_prior_width() -> None:
    """From a millionth of it to a thousand of it: an effect of 1.5 that could be ten thousand, and one that could be a thousandth."""
    y = 1.0 + 2.0 * X + 1.5 * COLUMNS["a"] + U * np.random.default_rng(2).normal(size=40)
    for width, groups in ((1e4, ("a",)), (1e-3, ())):
        problem = Sum(y, width=width)
        assert explained(Explained(problem, fit(problem, problem.start)), Values(("a",))).groups == groups


def test_sizes_at_the_ends_are_no_result() -> None:
    """A millionth and a thousand: nothing beyond is told; well inside they are."""
    r, J, noise = np.random.default_rng(5).normal(size=40), np.ones((40, 1)), Explanation("all", np.eye(40))
    for scale, determined in (
        (1e-7, False),
        (0.7e-6, False),
        (1.4e-6, True),
        (1e-4, True),
        (10.0, True),
        (700.0, True),
        (1200.0, False),
        (1e5, False),
    ):
        scale /= float(np.std(r, ddof=1))
        size, gain = Evidence(scale * r, J, (1e-3 * scale) ** 2 * np.eye(40)).best(noise)
        assert (gain > 0.0) == determined
        assert size == pytest.approx(scale * float(np.std(r, ddof=1)) if determined else 0.0, rel=1e-3)


def test_the_last_size_is_the_best_beside_the_others() -> None:
    rng = np.random.default_rng(8)
    judge = Evidence(rng.normal(size=40) * np.where(RIGHT > 0, 1.0, 0.3), np.ones((40, 1)), 1e-4 * np.eye(40))
    both = [Explanation("all", np.eye(40)), Explanation("right", np.eye(40)[:, 20:])]
    first, second = judge.together(both, [False, False])
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


def test_an_error_that_nobody_stated_and_that_does_not_show_is_as_large_as_residuals_allow() -> None:
    """Readings in groups, each group with an error about as large as that of its mean: taken as none, it leaves 7 of 8 intervals right."""
    groups, readings, own, shared = 16, 6, 0.1, 0.04
    F = np.asarray(np.kron(np.eye(groups), np.ones((readings, 1))), dtype=np.float64)
    ones = np.ones((groups * readings, 1))
    rng = np.random.default_rng(8)
    inside: dict[bool, list[bool]] = {True: [], False: []}
    for _ in range(300):
        values = shared * F @ rng.normal(size=groups) + own * rng.normal(size=groups * readings)
        judge = Evidence(values - values.mean(), ones, own**2 * np.eye(groups * readings))
        for unstated, held in inside.items():
            (size,) = judge.together([Explanation("group", F)], [unstated])
            held.append(abs(values.mean()) <= scipy.stats.t.ppf(0.975, groups - 1) * np.sqrt((size**2 + own**2 / readings) / groups))
    assert np.mean(inside[True]) > 0.93
    assert np.mean(inside[False]) < 0.9
