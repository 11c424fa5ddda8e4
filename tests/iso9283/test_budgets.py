"""Budgets of results: recomputed by GTC, and the published examples of JCGM 100, 101 and 102 through the same propagation.

Published numbers: JCGM 100:2008, annex H; JCGM 101:2008, clause 9; JCGM 102:2011, clause 9. They are printed with two or three digits.
"""

from collections.abc import Callable, Sequence
from typing import Any

import GTC
import numpy as np
import pytest
from made_trajectories import StatedErrors, made_campaign, some_law

from lmeasure.core import FloatArray
from lmeasure.iso9283 import CertificationSettings, Subject, evaluate
from lmeasure.iso9283.figure import Function
from lmeasure.iso9283.uncertainty import Spread, propagate
from lmeasure.recording import Program
from lmeasure.trajectory import PoseErrors

AT = Subject("pose", "P1")
TRIALS = 100_000
Model = Callable[[FloatArray], FloatArray]


class Inputs:
    """Input quantities (k,) as errors of poses, six a pose, which the root (k, k) of their covariance mixes."""

    def __init__(self, values: Sequence[float] | FloatArray, root: FloatArray, rectangular: Sequence[bool]) -> None:
        k = len(values)
        poses = -(-k // 6)
        self.values, self.root, self.positions = np.array(values, dtype=np.float64), root, np.zeros((poses, 3))
        shared = np.eye(6 * poses, k).reshape(poses, 6, k)
        self.errors = PoseErrors.of(np.zeros((poses, 6, 0)), shared, uniform=tuple(rectangular))

    def state(self, errors: FloatArray, reduced: bool) -> FloatArray:
        z = errors.reshape(*errors.shape[:-2], -1)[..., : len(self.values)]
        return np.asarray(self.values + z @ self.root.T)


def of(
    model: Model | Sequence[Model],
    values: Sequence[float] | FloatArray,
    u: Sequence[float] | FloatArray,
    rectangular: Sequence[bool] = (),
    correlation: FloatArray | None = None,
) -> list[Spread]:
    """Propagate input quantities through functions of (..., k)."""
    root = np.diag(np.asarray(u, dtype=np.float64))
    if correlation is not None:
        root = root @ np.linalg.cholesky(correlation)
    part = Inputs(values, root, rectangular or [False] * len(values))
    models = [model] if callable(model) else model
    return propagate({AT: part}, [_at(f) for f in models], trials=TRIALS, seed=1)


def _at(model: Model) -> Function:
    return lambda states: model(states[AT])


def u_of(found: Spread) -> float:
    return float(np.hypot(found.u_random, found.u_systematic))


def correlation_of(one: Spread, other: Spread) -> float:
    return float(one.sensitivities @ other.sensitivities / np.linalg.norm(one.sensitivities) / np.linalg.norm(other.sensitivities))


@pytest.fixture(scope="module")
def certified() -> Any:
    trajectory, program = made_campaign(np.array([0.3, -0.2, 0.1]), 0.05)
    model = StatedErrors(some_law(1), some_law(2))
    return evaluate(trajectory, Program.model_validate(program), model, settings=CertificationSettings(trials=500))


def test_another_program_recomputes_every_result_from_its_budget(certified: Any) -> None:
    for c in certified.characteristics:
        table = c.as_dict()
        rows = [
            r["sensitivity"] * GTC.ureal(r["value"], r["u"], r["degrees_of_freedom"] or np.inf)
            for r in table["budget"]
            if r["contribution"]
        ]
        y = sum(rows, start=GTC.ureal(table["value"], 0.0))
        assert GTC.value(y) == pytest.approx(table["value"], rel=1e-12)
        assert GTC.uncertainty(y) == pytest.approx(table["u"], rel=1e-6, abs=1e-15), c.key
        assert table["u"] == pytest.approx(np.hypot(c.u_random, c.u_systematic), rel=1e-9)
        assert table["u95"] == pytest.approx(table["u"] * table["coverage_factor"], rel=1e-9)
        assert sum(r["share_percent"] for r in table["budget"]) == pytest.approx(100.0, rel=1e-9)
        freedom = GTC.dof(y)
        assert (table.get("degrees_of_freedom") or np.inf) == (pytest.approx(freedom, rel=1e-6) if freedom < 1e4 else np.inf)


def test_means_distances_and_their_correlation_are_those_of_gtc(certified: Any) -> None:
    """Independent errors of each cycle and common ones, written out for GTC: the linear results to 1e-6, lengths to the step's square."""
    rng = np.random.default_rng(3)
    cycles, own, common = 7, 0.02 * rng.normal(size=(3, 3)), 0.1 * rng.normal(size=(3, 2))
    places = {Subject("pose", n): rng.normal(size=(cycles, 3)) for n in ("P1", "P2")}

    class Cycles:
        def __init__(self, positions: FloatArray) -> None:
            self.positions = positions
            own_, shared = np.zeros((cycles, 6, 3)), np.zeros((cycles, 6, 2))
            own_[:, 3:], shared[:, 3:] = own, common
            self.errors = PoseErrors.of(own_, shared)

        def state(self, errors: FloatArray, reduced: bool) -> FloatArray:
            return np.asarray(self.positions + errors[..., 3:])

    one, two = places
    figures = [
        lambda s: s[one].mean(axis=-2)[..., 0],
        lambda s: s[two].mean(axis=-2)[..., 1],
        lambda s: np.linalg.norm(s[one].mean(axis=-2) - s[two].mean(axis=-2), axis=-1),
    ]
    found = propagate({k: Cycles(p) for k, p in places.items()}, figures, trials=200, seed=1)
    z = [GTC.ureal(0.0, 1.0) for _ in range(2)]
    means = {}
    for k, p in places.items():
        poses = []
        for at in p:
            w = [GTC.ureal(0.0, 1.0) for _ in range(3)]
            poses.append([at[i] + sum(own[i, j] * w[j] for j in range(3)) + sum(common[i, j] * z[j] for j in range(2)) for i in range(3)])
        means[k] = [sum(pose[i] for pose in poses) / cycles for i in range(3)]
    apart = [a - b for a, b in zip(means[one], means[two], strict=True)]
    wanted = [means[one][0], means[two][1], GTC.sqrt(sum(d * d for d in apart))]
    for mine, theirs, close in zip(found, wanted, (1e-6, 1e-6, 1e-4), strict=True):
        assert u_of(mine) == pytest.approx(GTC.uncertainty(theirs), rel=close)
    for a, b, close in ((0, 1, 1e-6), (0, 2, 1e-3), (1, 2, 1e-3)):
        assert correlation_of(found[a], found[b]) == pytest.approx(GTC.get_correlation(wanted[a], wanted[b]), abs=close)


def test_jcgm_100_h1_end_gauge() -> None:
    """l = l_S + d - l_S (d_alpha theta + alpha_S d_theta): of 25, 9.7, 2.9 and 16.6 nm.

    First order gives u = 32 nm, with second order it is 34 nm.
    """
    nominal = 50.000623e6  # nm

    def length(x: FloatArray) -> FloatArray:
        ls, d, random, systematic, dalpha, mean, cyclic, alpha, dtheta = np.moveaxis(x, -1, 0)
        return np.asarray(ls + d + random + systematic - ls * (dalpha * (mean + cyclic) + alpha * dtheta))

    values = (nominal, 215.0, 0.0, 0.0, 0.0, -0.1, 0.0, 11.5e-6, 0.0)
    half = (1.0, 1.0, 1.0, 1.0, 1e-6 / 3**0.5, 1.0, 0.5 / 2**0.5, 2e-6 / 3**0.5, 0.05 / 3**0.5)
    u = (25.0, 5.8, 3.9, 6.7, half[4], 0.2, half[6], half[7], half[8])
    rectangular = (False, False, False, False, True, False, False, True, True)
    (found,) = of(length, values, u, rectangular)
    rows = np.array(found.sensitivities)
    assert np.hypot.reduce(np.abs(rows[[1, 2, 3]])) == pytest.approx(9.7, abs=0.05)
    assert abs(rows[4]) == pytest.approx(2.9, abs=0.05)
    assert abs(rows[8]) == pytest.approx(16.6, abs=0.05)
    assert u_of(found) == pytest.approx(32.0, abs=0.5)
    assert found.u_drawn == pytest.approx(34.0, abs=0.7)


def test_jcgm_100_h2_resistance_and_reactance() -> None:
    """R = V cos(phi) / I, X = V sin(phi) / I, Z = V / I of correlated means: u 0.071, 0.295 and 0.236."""
    r = np.array([[1.0, -0.36, 0.86], [-0.36, 1.0, -0.65], [0.86, -0.65, 1.0]])
    models = [
        lambda x: x[..., 0] / x[..., 1] * np.cos(x[..., 2]),
        lambda x: x[..., 0] / x[..., 1] * np.sin(x[..., 2]),
        lambda x: x[..., 0] / x[..., 1],
    ]
    resistance, reactance, impedance = of(models, (4.9990, 19.6610e-3, 1.04446), (0.0032, 0.0095e-3, 0.00075), correlation=r)
    assert [u_of(resistance), u_of(reactance), u_of(impedance)] == pytest.approx([0.071, 0.295, 0.236], rel=0.015)
    assert correlation_of(resistance, reactance) == pytest.approx(-0.588, abs=0.02)
    assert correlation_of(resistance, impedance) == pytest.approx(-0.485, abs=0.02)
    assert correlation_of(reactance, impedance) == pytest.approx(0.993, abs=0.002)


def test_jcgm_100_h3_thermometer() -> None:
    """A line of 11 corrections: y1 = -0.1712, u 0.0029; y2 = 0.00218, u 0.00067; r = -0.930; at 30 degrees b = -0.1494, u 0.0041."""
    t = np.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511])
    b = np.array([-0.171, -0.169, -0.166, -0.159, -0.164, -0.165, -0.156, -0.157, -0.159, -0.161, -0.160])
    A = np.column_stack([np.ones(11), t - 20.0])
    P = np.linalg.pinv(A)
    s = np.sqrt(np.sum((b - A @ P @ b) ** 2) / 9)
    y1, y2, b30 = of([lambda x: x @ P[0], lambda x: x @ P[1], lambda x: x @ (P[0] + 10.0 * P[1])], b, np.full(11, s))
    assert P @ b == pytest.approx([-0.1712, 0.00218], abs=6e-5)
    assert [u_of(y1), u_of(y2), u_of(b30)] == pytest.approx([0.0029, 0.00067, 0.0041], rel=0.02)
    assert correlation_of(y1, y2) == pytest.approx(-0.930, abs=1e-3)


def test_jcgm_100_h4_radioactivity() -> None:
    """A_x = A_S (m_S / m_x) R_x / R_S = 0.430 Bq/g, u 0.0083, with r(R_x, R_S) = 0.646 of R_x 652.46, u 6.42 and R_S 206.09, u 3.79."""
    r = np.eye(5)
    r[3, 4] = r[4, 3] = 0.646
    values = (0.1368, 5.0192, 5.0571, 652.46, 206.09)
    (found,) = of(
        lambda x: x[..., 0] * x[..., 1] / x[..., 2] * x[..., 3] / x[..., 4], values, (0.0018, 0.005, 0.001, 6.42, 3.79), correlation=r
    )
    assert values[0] * values[1] / values[2] * values[3] / values[4] == pytest.approx(0.430, abs=5e-4)
    assert u_of(found) == pytest.approx(0.0083, abs=1e-4)


def test_jcgm_100_h5_voltages_of_ten_days() -> None:
    """The mean of 10 days whose means scatter by 57 uV has u = 18 uV."""
    (mean,) = of(lambda x: x.mean(axis=-1), np.zeros(10), np.full(10, 57.0))
    assert u_of(mean) == pytest.approx(18.0, abs=0.1)


def test_jcgm_100_h6_hardness() -> None:
    """h = 100 - d - Dc - Db - DS = 64.0 Rockwell units with u 0.55: d of 5 indentations that scatter by 0.45, read to 0.1, DS 0.5.

    The comparison of the two machines, Dc, has less than 0.11; Db, of the standard machine in time, nothing.
    """
    values, u = (36.0, 0.0, 0.0, 0.0, 0.0), (0.45 / 5**0.5, 0.1 / 12**0.5, 0.11, 0.0, 0.5)
    (found,) = of(lambda x: 100.0 - x.sum(axis=-1), values, u, (False, True, False, False, False))
    assert 100.0 - sum(values) == 64.0
    assert [u_of(found), found.u_drawn] == pytest.approx([0.55, 0.55], abs=0.006)
    assert [abs(one) for one in found.sensitivities if one] == pytest.approx([0.201, 0.0289, 0.11, 0.5], abs=1e-3)


@pytest.mark.parametrize(
    ("u", "rectangular", "expected", "half"),
    [((1, 1, 1, 1), False, 2.0, 3.92), ((1, 1, 1, 1), True, 2.0, 3.88), ((1, 1, 1, 10), True, 10.1, 17.0)],
)
def test_jcgm_101_9_2_additive_models(u: tuple[float, ...], rectangular: bool, expected: float, half: float) -> None:
    (found,) = of(lambda x: x.sum(axis=-1), (0, 0, 0, 0), u, [rectangular] * 4)
    assert [u_of(found), found.u_drawn] == pytest.approx([expected, expected], rel=0.01)
    assert found.u95 == pytest.approx(half, rel=0.01)


def test_jcgm_101_9_3_mass() -> None:
    """dm = (m_Rc + dm_Rc) (1 + (rho_a - 1.2) (1/rho_W - 1/rho_R)) - 100 000 mg: 1.2340 mg; u 0.0539 by first order, 0.0754 by Monte Carlo,
    with the interval [1.0834, 1.3825]."""

    def mass(x: FloatArray) -> FloatArray:
        m, d, air, weight, reference = np.moveaxis(x, -1, 0)
        return np.asarray((m + d) * (1.0 + (air - 1.2) * (1.0 / weight - 1.0 / reference)))

    u = (0.05, 0.02, 0.1 / 3**0.5, 1000 / 3**0.5, 50 / 3**0.5)
    (found,) = of(mass, (1e5, 1.234, 1.2, 8000, 8000), u, (False, False, True, True, True))
    assert [u_of(found), found.u_drawn] == pytest.approx([0.0539, 0.0754], abs=6e-4)
    assert found.u95 == pytest.approx(0.1495, abs=2e-3)


def test_jcgm_101_9_4_mismatch() -> None:
    """dY = x1^2 + x2^2 with u 0.005: at 0 the linear law has nothing, Monte Carlo 50e-6 and [0, 150]e-6.

    At 0.050 they have 500e-6 and 502e-6.
    """
    model = lambda x: (x**2).sum(axis=-1)  # noqa: E731
    (zero,) = of(model, (0.0, 0.0), (0.005, 0.005))
    assert u_of(zero) == pytest.approx(0.0, abs=1e-7)
    assert [zero.bias, zero.u_drawn, zero.u95] == pytest.approx([50e-6, 50e-6, 150e-6], rel=0.02)
    (far,) = of(model, (0.05, 0.0), (0.005, 0.005))
    assert [u_of(far), far.u_drawn] == pytest.approx([500e-6, 502e-6], rel=0.01)


def test_jcgm_101_9_5_gauge_block() -> None:
    """838 nm with u 32 nm by first order and 36 nm by Monte Carlo, which holds 99 % in [745, 932] nm."""

    def length(x: FloatArray) -> FloatArray:
        ls, d, d1, d2, alpha, theta, cyclic, dalpha, dtheta = np.moveaxis(x, -1, 0)
        return np.asarray(ls + d + d1 + d2 - ls * (dalpha * (theta + cyclic) + alpha * dtheta))

    values = (50000623.0, 215.0, 0.0, 0.0, 11.5e-6, -0.1, 0.0, 0.0, 0.0)
    # of t with so many degrees of freedom the variance is larger; limits that are uncertain by d add d^2 / 9 to a rectangular one
    of_t = [u * (nu / (nu - 2)) ** 0.5 for u, nu in ((25, 18), (6, 24), (4, 5), (7, 8))]
    limits = [((a**2) / 3 + (d**2) / 9) ** 0.5 for a, d in ((1e-6, 0.1e-6), (0.05, 0.025))]
    u = (*of_t, 2e-6 / 3**0.5, 0.2, 0.5 / 2**0.5, *limits)
    (found,) = of(length, values, u, (False,) * 4 + (True, False, False, True, True))
    assert found.u_drawn == pytest.approx(36.0, abs=0.5)


def test_jcgm_102_9_2_additive_bivariate() -> None:
    """Y1 = X1 + X3, Y2 = X2 + X3 of unit variances: u = sqrt(2), r = 0.5; with u(X3) = 10 they are 10.05 and r = 0.990."""
    models = [lambda x: x[..., 0] + x[..., 2], lambda x: x[..., 1] + x[..., 2]]
    for u3, u, r in ((1.0, 2**0.5, 0.5), (10.0, 101**0.5, 100 / 101)):
        one, two = of(models, (0, 0, 0), (1.0, 1.0, u3))
        assert [u_of(one), u_of(two), correlation_of(one, two)] == pytest.approx([u, u, r], rel=1e-6)


def test_jcgm_102_9_3_polar_coordinates() -> None:
    """Amplitude and phase of X_R = 0.001, X_I = 0, u 0.01: far from linear. At X_R = 0.1 they are 0.010 and 0.1 rad, uncorrelated."""
    models = [lambda x: np.hypot(x[..., 0], x[..., 1]), lambda x: np.arctan2(x[..., 1], x[..., 0])]
    near, _ = of(models, (0.001, 0.0), (0.01, 0.01))
    assert [near.bias + 0.001, near.u_drawn] == pytest.approx([0.0126, 0.0066], rel=0.02)
    far, phase = of(models, (0.1, 0.0), (0.01, 0.01))
    assert [u_of(far), u_of(phase), far.u_drawn] == pytest.approx([0.010, 0.1, 0.010], rel=0.02)
    assert correlation_of(far, phase) == pytest.approx(0.0, abs=1e-3)
