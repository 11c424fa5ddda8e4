"""What residuals say of groups, of outliers and of what may be wrong, by lines and parabolas through readings."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from problems import Line, Plane, Readings, Stations, plane

from lmeasure.core import FloatArray
from lmeasure.estimation import (
    Deletion,
    Explained,
    Explanation,
    Group,
    evidence,
    explained,
    fall_test,
    fit,
    improbable,
    normal_deviates,
    robust_fit,
    settled,
    validation_residuals,
)
from lmeasure.estimation.explanations import Evidence, embedded

GROUPS = np.repeat(np.arange(10), 3)
"""Readings are taken three at a place."""


def readings(seed: int, *, u: float = 0.1) -> Readings:
    rng = np.random.default_rng(seed)
    x = np.repeat(np.linspace(-1.0, 1.0, 10), 3) + rng.uniform(-0.02, 0.02, 30)
    return Readings(x, 0.3 + 2.0 * x + rng.normal(0, u, 30), u)


def columns(group: int) -> FloatArray:
    """A group errs by one shift."""
    return np.asarray(group == GROUPS, dtype=np.float64)[:, None]


def without(data: Readings, group: int) -> Line:
    keep = group != GROUPS
    return Line(Readings(data.x[keep], data.y[keep], data.u))


@pytest.mark.parametrize("prior", [False, True])
def test_deletion_is_a_fit_without_the_group(prior: bool) -> None:
    data = readings(0)
    problem = Line(data)
    deletion = Deletion(fit(problem, problem.start, prior))
    left_out = deletion.deleted(GROUPS)
    assert [rows.tolist() for rows, _ in left_out] == [[3 * g, 3 * g + 1, 3 * g + 2] for g in range(10)]
    for group in (0, 4, 9):
        other = without(data, group)
        found = fit(other, other.start, prior)
        rows, errors = left_out[group]
        # in an orthonormal basis of its own
        np.testing.assert_allclose(np.linalg.norm(errors), np.linalg.norm(problem.residuals(found.theta)[rows]), rtol=1e-6)


def test_from_beside_the_optimum_deletion_stays_beside_it() -> None:
    data = readings(0)
    problem = Line(data)
    found, off = fit(problem, problem.start), np.array([0.05, -0.1])
    beside = replace(found, theta=found.theta + off, residuals=problem.residuals(found.theta + off))
    for rows, errors in Deletion(beside).deleted(GROUPS):
        other = without(data, int(GROUPS[rows[0]]))
        expected = problem.residuals(fit(other, other.start).theta + off)[rows]
        assert np.linalg.norm(errors) == pytest.approx(np.linalg.norm(expected), rel=1e-6)


def test_a_shift_is_tested_as_by_solving_for_it() -> None:
    """The square of a group's shift is the fall of chi-squared when the shift is solved for, and its F test that of regression."""
    data = readings(1)
    problem = Line(replace(data, y=data.y + np.where(GROUPS == 6, 0.3, 0.0)))
    found = fit(problem, problem.start)
    deletion, column = Deletion(found), columns(6)
    A = np.hstack([problem.jacobian(found.theta), column])
    solution, rest, *_ = np.linalg.lstsq(A, problem.readings.y)
    fall = found.chi2 - float(rest[0]) / 0.1**2
    judged, step = deletion.shift(column), deletion.step(column[:, 0])
    assert judged is not None
    assert step is not None
    assert judged.freedom == 1
    assert judged.square == pytest.approx(fall)
    assert step == pytest.approx((-solution[2], fall))
    tested = deletion.test(fall, 1)
    assert tested is not None
    assert tested[0] == pytest.approx(fall / (float(rest[0]) / 0.1**2 / 27))
    assert tested[1] == pytest.approx(scipy.stats.f.logsf(tested[0], 1, 27))
    assert deletion.test(fall, 26) is None
    # what the line itself explains nobody can contradict, and of nothing nothing is said
    assert deletion.shift(np.ones((30, 1))) is None
    assert deletion.step(np.ones(30)) is None
    assert deletion.shift(np.zeros((30, 0))) is None
    # an extra variance that the shift was given takes no part in the verdict
    wide = Line(replace(problem.readings, more=0.5 * column @ column.T))
    again = Deletion(fit(wide, wide.start)).shift(column, 0.5)
    assert again is not None
    assert again.square == pytest.approx(fall, rel=1e-6)


def test_f_tests_are_those_of_the_textbook() -> None:
    """Each sum of squares by its degrees of freedom; with fewer than three left none is made."""
    value, log_probability = fall_test(10.0, 2, 8.0, 4) or (0.0, 0.0)
    assert value == pytest.approx((10.0 / 2.0) / (8.0 / 4.0))
    assert np.exp(log_probability) == pytest.approx(scipy.stats.f.sf(2.5, 2, 4))
    assert (fall_test(6.0, 3, 4.0, 3) or (0.0,))[0] == pytest.approx(1.5)
    assert fall_test(6.0, 3, 4.0, 2) is None


@pytest.mark.parametrize("unit", [1e-8, 1.0, 1e8])
def test_what_is_told_is_told_in_whatever_unit(unit: float) -> None:
    """Of a shift that the line explains itself nothing is, nor of none; of another as much as in millimetres."""
    data = readings(1)
    other = Line(Readings(data.x, unit * data.y, unit * data.u))
    other.parameters = replace(other.parameters, width=unit * other.parameters.width)
    plain, scaled = (Deletion(fit(p, p.start)) for p in (Line(data), other))
    offset, nothing, column = np.ones((30, 1)), np.zeros((30, 1)), columns(6)
    for silent in (offset, nothing):
        assert scaled.added(silent) is None
        assert scaled.step(silent[:, 0]) is None
        assert scaled.freed(silent).freedom == plain.freedom
    assert scaled.falls(np.hstack([offset, nothing])).tolist() == [0.0, 0.0]
    added, expected = scaled.added(np.hstack([column, offset])), plain.added(column)
    assert added is not None
    assert expected is not None
    assert added.freedom == 1
    assert added.square == pytest.approx(expected.square)
    step, by = scaled.step(column[:, 0]), plain.step(column[:, 0])
    assert step is not None
    assert by is not None
    assert step == pytest.approx((unit * by[0], by[1]))
    np.testing.assert_allclose(scaled.falls(column), plain.falls(column))


def test_targets_that_are_left_out_are_judged_by_what_their_places_leave_over() -> None:
    """Two targets together: of ten distances the four coordinates of their places can take away as many, and the rest is as far off as it
    is from a network without them, wherever the two are put there."""
    problem = plane(1, since_first=False)
    groups = problem.target // 2
    deletion = Deletion(fit(problem, problem.start))
    found = {int(groups[rows[0]]): errors for rows, errors in deletion.deleted(groups)}
    assert {group: len(errors) for group, errors in found.items()} == dict.fromkeys(range(6), 10 - 4)
    distance = np.zeros((12, 5))
    distance[problem.target, problem.station] = problem.measured
    for group in (0, 3):
        kept = np.array([i for i in range(12) if i // 2 != group])
        nominal = problem.nominal
        fewer = Stations(Plane(nominal.stations, nominal.targets[kept], nominal.seen[kept]), distance[kept], problem.u, since_first=False)
        stations = fit(fewer, fewer.start).theta[: problem.own].reshape(-1, 2)

        def misses(at: FloatArray, i: int, stations: FloatArray = stations) -> FloatArray:
            return np.asarray(np.linalg.norm(at - stations, axis=1) - distance[i])

        places = [scipy.optimize.least_squares(misses, nominal.targets[i], args=(i,)) for i in (2 * group, 2 * group + 1)]
        square = sum(2.0 * place.cost for place in places)
        assert found[group] @ found[group] == pytest.approx(square, rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_readings_that_alone_tell_something_contradict_nobody(seed: int) -> None:
    """One reading far from others at one place makes the slope what it wants: without it there is no line to judge it by."""
    y = 1.0 + np.random.default_rng(seed).normal(0, 0.1, 10)
    problem = Line(Readings(np.r_[np.zeros(9), 2.0], y))
    deletion = Deletion(fit(problem, problem.start))
    assert [rows.tolist() for rows, _ in deletion.deleted(np.arange(10))] == [[i] for i in range(9)]
    assert deletion.shift(np.eye(10)[:, 9:]) is None
    assert deletion.shift(np.ones((10, 1))) is None
    of_one = deletion.shift(np.eye(10)[:, :1])
    assert of_one is not None
    assert of_one.square == pytest.approx((y[0] - y[1:9].mean()) ** 2 / (0.1**2 * (1.0 + 1.0 / 8.0)))


def test_what_is_freed_is_solved_for_by_the_rest() -> None:
    """Against regressions with one column more, and with two."""
    data = readings(4)
    problem = Line(replace(data, y=data.y + np.where(GROUPS == 6, 0.3, 0.0) + np.where(GROUPS == 2, 0.2, 0.0)))
    found, one, two = fit(problem, problem.start), columns(6), np.hstack([columns(2), 3.0 * columns(2)])
    deletion = Deletion(found)

    def rest(*more: FloatArray) -> float:
        A = np.hstack([problem.jacobian(found.theta), *more])
        return float(np.sum((problem.readings.y - A @ np.linalg.lstsq(A, problem.readings.y)[0]) ** 2)) / 0.1**2

    added, freed = deletion.added(one), deletion.freed(one)
    assert added is not None
    assert (added.freedom, freed.freedom) == (1, 27)
    assert added.square == pytest.approx(rest() - rest(one))
    after = freed.added(two)
    assert after is not None
    # both columns are one law
    assert after.freedom == 1
    assert after.square == pytest.approx(rest(one) - rest(one, two[:, :1]))
    assert freed.test(after.square, 1) == pytest.approx(fall_test(after.square, 1, rest(one, two[:, :1]), 26))
    assert freed.added(one) is None
    # what a column of unit size leaves: its variance when it is solved for
    J = np.hstack([problem.jacobian(found.theta), one])
    assert 1.0 / deletion.information(one)[0, 0] == pytest.approx(np.linalg.inv(J.T @ J)[-1, -1] * 0.1**2)


def test_before_anything_is_fitted_groups_do_not_speak_about_each_other() -> None:
    problem = Line(readings(2))
    found = fit(problem, problem.start)
    for rows, errors in Deletion(found, at_start=True).deleted(GROUPS):
        assert np.linalg.norm(errors) == pytest.approx(np.linalg.norm(problem.residuals(problem.start)[rows]))


def test_readings_held_out_are_predicted_with_their_covariance() -> None:
    """The errors are those of a fit without them; they and the result share an error of all readings."""
    data = readings(3)
    shared = 0.04 * np.ones((30, 30))
    whole = Line(replace(data, more=shared))
    keep = GROUPS != 5
    other = Line(Readings(data.x[keep], data.y[keep], data.u, more=shared[np.ix_(keep, keep)]))
    found = fit(other, other.start)
    r, C = validation_residuals(whole, found.theta, found, np.flatnonzero(keep))
    np.testing.assert_allclose(r, whole.residuals(found.theta))
    J, V = whole.jacobian(found.theta), whole.covariance(found.theta)
    K = np.linalg.inv(J[keep].T @ np.linalg.solve(V[np.ix_(keep, keep)], J[keep])) @ J[keep].T @ np.linalg.inv(V[np.ix_(keep, keep)])
    error = np.eye(30)
    error[:, keep] -= J @ K
    exact = error @ V @ error.T
    np.testing.assert_allclose(C[np.ix_(~keep, ~keep)], exact[np.ix_(~keep, ~keep)], atol=1e-9)


def test_a_robust_loss_takes_back_the_group_that_is_wrong() -> None:
    """It is named, and the line is that of the others, however far it is off."""
    data = readings(4)
    groups = [Group(columns(g), np.flatnonzero(g == GROUPS)) for g in range(10)]
    for off in (2.0, 2000.0):
        wrong = replace(data, y=data.y + np.where(GROUPS == 9, off, 0.0))

        def weighted(variance: FloatArray, wrong: Readings = wrong) -> Line:
            more = sum((v * columns(g) @ columns(g).T for g, v in enumerate(variance)), start=np.zeros((30, 30)))
            return Line(replace(wrong, more=more, taken=variance[GROUPS]))

        begun = Line(wrong)
        problem, found, weights = robust_fit(fit(begun, begun.start), groups, weighted)
        assert weights.weight[9] <= 1.01e-6
        assert (weights.weight[:9] > 0.5).all()
        assert weights.scale < 1.6
        other = without(wrong, 9)
        clean = fit(other, other.start)
        u = np.sqrt(np.diag(clean.covariance))
        assert (np.abs(found.theta - clean.theta) < u).all()
        assert (np.sqrt(np.diag(found.covariance)) > 0.99 * u).all()
        assert found.problem is problem
        # a weight is a variance on top of the stated one, in units of the noise that there is
        believed = weights.weight[:9]
        taken = 0.1**2 * weights.scale**2 * (1.0 / believed - 1.0)
        assert problem.readings.taken is not None
        np.testing.assert_allclose(problem.readings.taken, np.r_[taken, 0.1**2 / 1e-6][GROUPS], rtol=1e-9)
        # Tukey's biweight of what each group is off, in scales of 4.685
        shifts = [Deletion(found).shift(columns(g), float(problem.readings.taken[3 * g])) for g in range(9)]
        far = np.sqrt([s.square for s in shifts if s is not None]) / (4.685 * weights.scale)
        assert far.max() > 0.2
        np.testing.assert_allclose(believed, (1.0 - far**2) ** 2, atol=2e-3)
        # three readings less, and a little for the weights of the others
        assert 20 <= found.freedom <= 25
    # of several members more are believed: two groups against one that stands for five
    two = [Group(columns(g), np.flatnonzero(g == GROUPS), members=1 + 4 * (g == 0)) for g in range(10)]
    assert robust_fit(fit(begun, begun.start), two, weighted)[2].scale >= 1.0


def test_a_misfit_is_told_by_the_normal_deviate_as_improbable() -> None:
    # the last beyond doubles' reach
    square, freedom = np.array([4.0, 9.0, 9.0, 9.0, 1e6]), np.array([1, 2, 3, 7, 3])
    deviate = normal_deviates(square, freedom)
    assert deviate[[0, -1]] == pytest.approx([2.0, 1000.0])
    assert 2.0 * scipy.stats.norm.sf(deviate[1:4]) == pytest.approx(scipy.stats.chi2.sf(9.0, freedom[1:4]))


@dataclass(frozen=True)
class Doubts:
    """A line's readings may err more than stated, all or those of the right half, or it may be bent."""

    stated: Readings

    @property
    def values(self) -> tuple[str, ...]:
        return ("bend",)

    def errors(self, problem: Line, theta: FloatArray) -> list[Explanation]:
        every = np.eye(30)
        return [Explanation("noise", every, lasting=True), Explanation("noise", every[:, 15:], "right")]

    def widened(self, problem: Line, sizes: dict[tuple[str, str | None], float]) -> Line:
        share: dict[str | None, FloatArray] = {None: np.ones(30), "right": np.repeat([0.0, 1.0], 15)}
        more = np.diag(sum((u**2 * share[label] for (_, label), u in sizes.items()), start=np.zeros(30)))
        return Line(replace(self.stated, more=more), problem.degree)

    def freed(self, problem: Line, group: str) -> Line | None:
        return Line(problem.readings, 2) if problem.degree == 1 else None


def begun(data: Readings) -> tuple[Explained[Line], Doubts]:
    problem = Line(data)
    return Explained(problem, fit(problem, problem.start)), Doubts(data)


def test_what_is_wrong_is_found_among_what_could_be() -> None:
    """A bend is solved for, noise gets its size, and where nothing is wrong nothing is taken."""
    x, rng = np.linspace(-1.0, 1.0, 30), np.random.default_rng(5)
    data = Readings(x, 0.3 + 2.0 * x + rng.normal(0, 0.1, 30))
    sound, doubts = begun(data)
    assert not improbable(sound.fit)
    assert explained(sound, doubts) == sound
    bent, doubts = begun(replace(data, y=data.y + 1.5 * x**2))
    assert improbable(bent.fit)
    found = explained(bent, doubts)
    assert (found.groups, found.sizes, found.doubt) == (("bend",), {}, 0.0)
    assert found.problem.degree == 2
    assert found.fit.theta[2] == pytest.approx(1.5, abs=0.3)
    assert embedded(bent.problem, bent.fit.theta, found.problem).tolist() == [*bent.fit.theta.tolist(), 0.0]
    half, doubts = begun(replace(data, y=data.y + np.where(x > 0, rng.normal(0, 0.6, 30), 0.0)))
    found = explained(half, doubts)
    assert list(found.sizes) == [("noise", "right")]
    assert found.sizes["noise", "right"] == pytest.approx(0.6, rel=0.5)
    assert not improbable(found.fit)
    # the size is the likeliest: restricted likelihood, by brute force
    J = half.problem.jacobian(half.fit.theta)

    def likelihood(u: float) -> float:
        V = 0.01 * np.eye(30) + np.diag(np.where(np.arange(30) >= 15, u**2, 0.0))
        information = J.T @ np.linalg.solve(V, J)
        solution = np.linalg.solve(information, J.T @ np.linalg.solve(V, half.problem.readings.y))
        r = half.problem.readings.y - J @ solution
        return -float(r @ np.linalg.solve(V, r)) - float(np.linalg.slogdet(V)[1]) - float(np.linalg.slogdet(information)[1])

    size, gain = evidence(half.fit, half.fit.V).best(doubts.errors(half.problem, half.fit.theta)[1])
    assert gain == pytest.approx(likelihood(size) - likelihood(0.0), rel=1e-6)
    assert likelihood(size) >= max(likelihood(0.98 * size), likelihood(1.02 * size))


def test_sizes_are_estimated_together() -> None:
    """Of two errors of one kind each is found beside the other; one that nothing asks for is nothing."""
    x, rng = np.linspace(-1.0, 1.0, 30), np.random.default_rng(7)
    data = Readings(x, 2.0 * x + np.where(x > 0, 1.0, 0.2) * rng.normal(0, 1.0, 30), 0.01)
    state, doubts = begun(data)
    both = settled(replace(state, sizes={("noise", "right"): 0.0, ("noise", None): 0.0}), doubts)
    assert both.sizes["noise", None] == pytest.approx(0.2, rel=0.4)
    assert both.sizes["noise", "right"] == pytest.approx(1.0, rel=0.4)
    quiet = Readings(x, 2.0 * x + rng.normal(0, 0.1, 30), 0.1)
    state, doubts = begun(quiet)
    assert settled(replace(state, sizes={("noise", None): 0.0}), doubts).sizes == {("noise", None): 0.0}
    J = state.problem.jacobian(state.fit.theta)
    assert Evidence(state.fit.residuals, J, 100.0 * state.fit.V).best(Explanation("noise", np.eye(30))) == (0.0, 0.0)


def test_what_is_asked_for_begins_at_the_gains_that_are_stated() -> None:
    """A size is taken from a gain of 4 on, a value from 20 on where chi-squared is not beyond chance."""
    x, rng = np.linspace(-1.0, 1.0, 30), np.random.default_rng(7)
    noise = 0.1 * rng.normal(size=30)
    taken = {}
    for scale in np.linspace(1.0, 2.0, 40):
        state, doubts = begun(Readings(x, scale * noise))
        gain = evidence(state.fit, state.fit.V).best(doubts.errors(state.problem, state.fit.theta)[0])[1]
        if gain > 2.0:
            taken[gain] = settled(replace(state, sizes={("noise", None): 0.0}), doubts).sizes["noise", None] > 0.0
    assert [gain for gain in taken if 4.0 < gain < 6.0]
    assert taken == {gain: gain >= 4.0 for gain in taken}
    bent = {}
    for size in np.linspace(0.1, 0.3, 21):
        state, doubts = begun(Readings(x, 0.5 * noise + size * x**2))
        column = Explanation("bend", 10.0 * x[:, None] ** 2)
        gain = evidence(state.fit, state.fit.V).best(column)[1]
        if not improbable(state.fit):
            bent[gain] = explained(state, doubts).groups == ("bend",)
    assert [gain for gain in bent if 20.0 < gain < 30.0]
    assert bent == {gain: gain >= 20.0 for gain in bent}


def test_evidence_of_correlated_residuals() -> None:
    """The gain is that of the restricted likelihood, written out."""
    i, rng = np.arange(30), np.random.default_rng(9)
    V = 0.01 * (np.eye(30) + 0.8 ** np.abs(i[:, None] - i))
    J, F = np.vander(np.linspace(-1.0, 1.0, 30), 2), np.eye(30)[:, 15:]
    r = np.linalg.cholesky(V) @ rng.normal(size=30) + 0.5 * F @ rng.normal(size=15)

    def likelihood(u: float) -> float:
        W = np.linalg.inv(V + u**2 * F @ F.T)
        left = r - J @ np.linalg.solve(J.T @ W @ J, J.T @ W @ r)
        return float(np.linalg.slogdet(W)[1] - np.linalg.slogdet(J.T @ W @ J)[1] - left @ W @ left)

    size, gain = Evidence(r, J, V).best(Explanation("noise", F))
    assert gain == pytest.approx(likelihood(size) - likelihood(0.0), rel=1e-6)
