"""U95 of figures: the law written out, and how often it holds the truth where errors are as large as what they are of."""

from dataclasses import replace

import numpy as np
import pytest
from honest import assert_honest
from synthetic_trajectories import UNIT, StatedErrors, by_name, dwells, some_law, synthetic_campaign, trajectory_of

from lmeasure.core import FloatArray
from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.iso9283.characteristic import Characteristic
from lmeasure.iso9283.clauses.pose import _alike
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.uncertainty import NORMAL_95_ONE_SIDED, propagate, reduction, reduction_of_mean
from lmeasure.recording import Program
from lmeasure.trajectory import PoseErrors

EXACT = StatedErrors()


def test_linear_law_and_monte_carlo_are_the_law_written_out() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, -0.4, 1.2]), 0.1)
    random, shared = some_law(1), np.asarray(np.linalg.cholesky(some_law(2)))
    found = by_name(
        evaluate(
            trajectory, Program.model_validate(program), StatedErrors(random, shared), settings=CertificationSettings(trials=20000, seed=3)
        )
    )
    mean = np.array([c.value for n in "xyz" if (c := found[f"AP_{n}", "P1"])])
    n = mean / np.linalg.norm(mean)
    u_random, u_systematic = np.sqrt(n @ random[3:, 3:] @ n / 30), np.sqrt(n @ (shared @ shared.T)[3:, 3:] @ n)
    ap = found["AP_p", "P1"]
    assert ap.u_random == pytest.approx(u_random, rel=0.08)
    assert ap.u_systematic == pytest.approx(u_systematic, rel=0.08)
    # where the offset is many times its uncertainty, 95 % of a normal law
    assert ap.u95 == pytest.approx(1.96 * np.hypot(u_random, u_systematic), rel=0.03)
    # RP_l = l-bar + 3 S: its gradient by difference quotients, errors independent from cycle to cycle
    x = evaluate(trajectory, Program.model_validate(program), EXACT).poses[0].poses[:, :3]

    def repeatability(points: FloatArray) -> float:
        distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
        return float(distance.mean() + 3 * distance.std(ddof=1))

    gradient = np.zeros_like(x)
    for i in range(len(x)):
        for k in range(3):
            step = np.zeros_like(x)
            step[i, k] = 1e-5
            gradient[i, k] = (repeatability(x + step) - repeatability(x - step)) / 2e-5
    u = np.sqrt(np.einsum("ik,kl,il->", gradient, random[3:, 3:], gradient))
    rp = found["RP_l", "P1"]
    assert rp.u_random == pytest.approx(u, rel=0.08)
    assert rp.u_systematic is not None
    assert rp.u_systematic < 1e-6
    assert rp.u95 == pytest.approx(1.96 * u, rel=0.1)
    # the error of the calibration is common to both ends of a distance
    assert found["AD_p", "P1-P2"].u_systematic == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("offset", [0.0, 0.01])
def test_a_small_offset_has_an_honest_interval(offset: float) -> None:
    # an instrument that errs by 0.01 mm per axis makes a robot that is off by less look worse than it is
    shared = np.zeros((6, 3))
    shared[3:] = 0.01 * np.eye(3)
    ratios = []
    for seed in range(60):
        error = 0.01 * np.random.default_rng(seed).normal(size=3)
        trajectory, program = synthetic_campaign(np.array([offset, 0.0, 0.0]) + error, 0.0, cycles=2, seed=seed, names=("P1",))
        found = evaluate(
            trajectory, Program.model_validate(program), StatedErrors(shared=shared), settings=CertificationSettings(trials=300)
        )
        ap = by_name(found)["AP_p", "P1"]
        ratios.append((ap.value - offset) / ap.u95)
    # a distance errs more to one side, and its U95 is that of the farther one
    assert_honest(ratios, within_half=0.8)


def test_repeatability_of_a_still_robot_is_not_said_to_be_known() -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.0)
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.005**2 * np.eye(3)
    errors = StatedErrors(random)
    errors.rounded = True
    rp = by_name(evaluate(trajectory, Program.model_validate(program), errors))["RP_l", "P1"]
    assert rp.value == pytest.approx(0.0, abs=1e-9)
    # scatter of half a count would not be seen: 0.005 mm is a count of 0.017
    assert 0.01 < rp.u95 < 0.03
    assert not rp.capable


def settled(t: FloatArray, swing_mm: float) -> FloatArray:
    """Places (n,) [mm] at times (n,) [s] of a move of 100 mm in 0.3 s, with a swing behind it that dies down."""
    part = np.clip((t - 0.3) / 0.3, 0.0, 1.0)
    swing = np.where(t > 0.6, swing_mm * np.exp(-(t - 0.6) / 0.1) * np.sin(2 * np.pi * 8 * (t - 0.6)), 0.0)
    return np.asarray(100.0 * part**3 * (10.0 + part * (6.0 * part - 15.0)) + swing)


SETTLING = {
    "schema": "lmeasure.program/1",
    "pose": [
        {"name": "P1", "position_mm": (0.0, 0.0, 0.0), "quaternion_xyzw": UNIT},
        {"name": "P2", "position_mm": (100.0, 0, 0), "quaternion_xyzw": UNIT, "settling_s": [(0.5, 1.498)], "limit_band_mm": 0.5},
    ],
    "posing": [{"from": "P1", "to": "P2", "windows_s": [(0.1, 1.498)], "limit_band_mm": 0.5}],
}


def test_the_u95_of_times_holds_what_it_says() -> None:
    t, fine = np.arange(0, 1.5, 2e-3), np.arange(0, 1.5, 1e-5)
    program = Program.model_validate(SETTLING)
    count, ratios = 0.02, []
    random = np.zeros((6, 6))
    random[3:, 3:] = count**2 / 12.0 * np.eye(3)
    for seed in range(25):
        generator = np.random.default_rng(seed)
        begin, swing_mm = generator.uniform(), generator.uniform(3.0, 5.0)
        moved = settled(fine, swing_mm)
        away = np.abs(moved - settled(np.array([1.45]), swing_mm))
        first, last, leaves = (fine[i] for i in (np.argmax(away < 0.5), np.flatnonzero(away > 0.5)[-1], np.argmax(moved > 0.5)))
        true = {"t_s": last - first, "t_min": last - leaves, "OV": away[fine > first].max()}
        # counts of a cable that lies along the move, from wherever counting began
        read = count * (np.rint(settled(t, swing_mm) / count + begin) - begin)
        trajectory, law = trajectory_of(t, np.column_stack([read, 0 * t, 0 * t])), StatedErrors(random, rounded=True)
        found = by_name(evaluate(trajectory, program, law, settings=CertificationSettings(trials=300)))
        every = [found["t_s", "P2"], found["t_min", "P1-P2"], found["OV", "P2"]]
        ratios.append([(c.value - true[c.name]) / c.u95 for c in every])
        # a lobe of the swing that may or may not leave the band is half a period more or less
        assert every[0].u95 < 2e-3 or every[0].u95 > 0.04
        assert every[1].u95 < 2e-3 or every[1].u95 > 0.04
        assert every[2].u95 < 1.5 * count
    for each in np.transpose(ratios):
        assert_honest(each)


def test_what_a_trajectory_calls_systematic_cancels_about_a_place() -> None:
    count, t = 0.02, np.arange(0, 1.5, 2e-3)
    trajectory = trajectory_of(t, np.column_stack([count * np.rint(settled(t, 4.0) / count), 0 * t, 0 * t]))
    places, program = dwells(np.random.default_rng(1).normal(0.0, 0.05, (8, 3))), Program.model_validate(SETTLING)
    rests = Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": [
                {"name": "P1", "position_mm": (0, 0, 0), "quaternion_xyzw": UNIT, "windows_s": places[2], "approaches": ["x", "y"] * 4}
            ],
        }
    )
    rounded, common = np.zeros((6, 6)), np.zeros((6, 6))
    rounded[3:, 3:], common[3:, 3:] = count**2 / 12.0 * np.eye(3), 0.05**2 * np.eye(3)
    found: dict[tuple[str, float], Characteristic] = {}
    for systematic in (0.0, 1.0):
        for run, requested in ((trajectory, program), (trajectory_of(*places[:2]), rests)):
            n = len(run.time_s)
            stated = replace(run, random=np.tile(rounded, (n, 1, 1)), systematic=np.tile(systematic * common, (n, 1, 1)))
            found |= {
                (c.name, systematic): c for c in evaluate(stated, requested, settings=CertificationSettings(trials=1000)).characteristics
            }
    for name in ("t_s", "OV", "t_min", "RP_l", "vAP_p"):
        assert found[name, 1.0].u95 == pytest.approx(found[name, 0.0].u95, rel=0.05), name
    assert found["t_s", 1.0].u95 < 1e-3 * 2
    assert found["AP_x", 1.0].u95 == pytest.approx(1.96 * 0.05, rel=0.1)


def test_an_angle_is_told_as_well_as_it_is_measured() -> None:
    # c is measured ten times as well as a and b, and turns far less than those err
    rng = np.random.default_rng(5)
    time_s, position, windows = dwells(np.zeros((20, 3)))
    turns = np.zeros((len(time_s), 3))
    for start, end in windows:
        turns[(time_s >= start - 1e-9) & (time_s <= end + 1e-9)] = [*rng.normal(0.0, 1e-4, 2), rng.normal(0.0, 3e-5)]
    program = {"schema": "lmeasure.program/1", "angles": "fanuc-wpr", "pose": [
        {"name": "P1", "position_mm": (0, 0, 0), "quaternion_xyzw": UNIT, "windows_s": windows, "approaches": ["x", "y"] * 10}
    ]}  # fmt: skip
    reported = []
    for others in (1e-4, 1e-5):
        law = np.diag([others**2, others**2, 1e-10, 0.0, 0.0, 0.0])
        found = by_name(evaluate(trajectory_of(time_s, position, turns), Program.model_validate(program), StatedErrors(law)))
        reported.append([found[name, "P1"].u95 for name in ("AP_c", "RP_c", "vAP_c")])
    assert reported[0] == pytest.approx(reported[1], rel=0.02)


@pytest.mark.parametrize("scatter", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("cycles", [5, 30])
def test_scatter_below_that_of_the_errors_has_an_honest_interval(scatter: float, cycles: int) -> None:
    rng = np.random.default_rng(3)
    true = scatter * rng.normal(size=(1000, cycles))
    measured, errors = true + rng.normal(size=true.shape), rng.normal(size=(200, 1, cycles))
    deviation = [x.std(axis=-1, ddof=1) for x in (true, measured)]
    likely = reduction(deviation[1] ** 2, 1.0, cycles - 1)[:, None] * (measured - measured.mean(axis=-1, keepdims=True))
    drawn = np.abs((likely + errors).std(axis=-1, ddof=1) - likely.std(axis=-1, ddof=1))
    inside = np.abs(deviation[1] - deviation[0]) <= np.quantile(drawn, 0.95, axis=0)
    assert 0.92 <= inside.mean() <= 0.975


def test_a_repeatability_that_does_not_drift_has_an_honest_interval() -> None:
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.01**2 * np.eye(3)
    # three times the same places: in truth nothing drifts
    places = np.tile(0.03 * np.random.default_rng(1).normal(size=(10, 3)), (3, 1))
    ratios = []
    for seed in range(50):
        _, program = synthetic_campaign(np.zeros(3), 0.0, cycles=30, names=("P1",))
        time_s, position, windows = dwells(places + 0.01 * np.random.default_rng(seed).normal(size=places.shape))
        program["pose"][0] |= {"windows_s": windows}
        program["drift"] = [{"pose": "P1", "group": 10}]
        trajectory, model = trajectory_of(time_s, position), Program.model_validate(program)
        found = by_name(evaluate(trajectory, model, StatedErrors(random), settings=CertificationSettings(trials=300, seed=seed)))
        ratios.append(found["dRP_l", "P1"].value / found["dRP_l", "P1"].u95)
    assert_honest(ratios)


@pytest.mark.parametrize("apart", [0.0, 0.05])
def test_a_small_variation_by_approach_has_an_honest_interval(apart: float) -> None:
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.01**2 * np.eye(3)
    ratios = []
    for seed in range(60):
        _, program = synthetic_campaign(np.zeros(3), 0.0, cycles=12, names=("P1",))
        places = 0.01 * np.random.default_rng(seed).normal(size=(12, 3))
        places[::3, 0] += apart
        time_s, position, windows = dwells(places)
        program["pose"][0] |= {"windows_s": windows, "approaches": ["x", "y", "z"] * 4}
        settings_ = CertificationSettings(trials=300, seed=seed)
        found = by_name(
            evaluate(trajectory_of(time_s, position), Program.model_validate(program), StatedErrors(random), settings=settings_)
        )
        ratios.append((found["vAP_p", "P1"].value - apart) / found["vAP_p", "P1"].u95)
    assert_honest(ratios)


def test_the_least_vector_that_could_have_been_measured_so_long() -> None:
    """Of one axis: shorter by 1.64 standard deviations, so that errors make it as long as it was measured once in twenty times."""
    length, u = 2.0, 0.3
    least = length * float(reduction_of_mean(length**2, u**2, 1))
    measured = least + u * np.random.default_rng(5).normal(size=200_000)
    assert np.mean(measured > length) == pytest.approx(0.05, abs=0.002)
    # of three, an error across it lengthens it too: two thirds of their trace are taken away first
    across = np.sqrt(length**2 - 2 * u**2)
    assert float(reduction_of_mean(length**2, 3 * u**2, 3)) == pytest.approx(
        (across - NORMAL_95_ONE_SIDED * np.sqrt(3) * u) / length, rel=1e-12
    )
    # what may as well be nothing is nothing, and what has no errors stays
    few = NORMAL_95_ONE_SIDED**2 + 2.0 / 3.0
    for observed, factor in ((0.0, 0.0), (0.5, 0.0), (0.999 * few, 0.0)):
        assert float(reduction_of_mean(observed, 1.0, 3)) == factor
    assert 0.0 < float(reduction_of_mean(1.001 * few, 1.0, 3)) < 0.01
    np.testing.assert_allclose(reduction_of_mean(np.array([4.0, 9.0]), np.zeros(2), 3), 1.0)
    assert float(reduction_of_mean(0.0, 0.0, 3)) == 0.0


def test_the_least_scatter_that_could_have_been_observed() -> None:
    """Errors add their mean square to that of the deviations; of few degrees of freedom the observed one may be larger than its law."""
    assert float(reduction(4.0, 1.0)) == pytest.approx(np.sqrt(3.0 / 4.0), rel=1e-12)
    least = 4.0 / (1.0 + NORMAL_95_ONE_SIDED * np.sqrt(2.0 / 8.0))
    assert float(reduction(4.0, 1.0, 8)) == pytest.approx(np.sqrt((least - 1.0) / 4.0), rel=1e-12)
    np.testing.assert_array_equal(reduction(np.array([1.0, 0.0, 0.9]), 1.0), 0.0)
    np.testing.assert_array_equal(reduction(np.array([1.0, 2.0]), 0.0), 1.0)


AT = Subject("pose", "P1")


class Places:
    """Four positions along x, for the law of their errors alone."""

    def __init__(self, errors: PoseErrors) -> None:
        self.errors = errors
        self.positions = np.outer([1.0, 2.0, 4.0, 8.0], np.eye(3)[0])

    def state(self, errors: FloatArray, reduced: bool) -> FloatArray:
        return np.asarray([1.0, 2.0, 4.0, 8.0] + errors[..., 3])


def test_what_errors_at_one_place_have_in_common() -> None:
    """Own errors at every pose, local ones at every place, shared ones in the run; those of the counts are random whatever they share."""
    along = np.eye(6)[3][:, None]
    own, local, shared = (np.tile(u * along, (4, 1, 1)) for u in (0.1, 0.3, 0.5))
    place = np.array([0, 0, 1, 1])
    figures = [
        lambda states: states[AT].mean(axis=-1),
        lambda states: states[AT][..., 1] - states[AT][..., 0],
        lambda states: states[AT][..., 2] - states[AT][..., 1],
    ]
    errors = PoseErrors(own, local, place, shared)
    mean, within, across = propagate({AT: Places(errors)}, figures, trials=4000, seed=1)
    assert mean.u_random == pytest.approx(0.1 / 2, rel=0.1)
    assert mean.u_systematic == pytest.approx(np.hypot(0.3 / np.sqrt(2), 0.5), rel=0.1)
    assert mean.u95 == pytest.approx(1.96 * np.sqrt(0.1**2 / 4 + 0.3**2 / 2 + 0.5**2), rel=0.06)
    assert within.u_random == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert within.u_systematic == pytest.approx(0.0, abs=1e-9)
    assert within.u95 == pytest.approx(1.96 * 0.1 * np.sqrt(2), rel=0.06)
    assert across.u_systematic == pytest.approx(0.3 * np.sqrt(2), rel=0.1)
    counted = propagate({AT: Places(replace(errors, counted=(True,), uniform=(True,)))}, figures, trials=4000, seed=1)[0]
    assert counted.u_random == pytest.approx(np.hypot(0.1 / 2, 0.5), rel=0.1)
    assert counted.u_systematic == pytest.approx(0.3 / np.sqrt(2), rel=0.1)
    # uniform: hardly beyond 0.95 of its half width, sqrt(3) standard deviations
    alone = propagate({AT: Places(PoseErrors.of(0.0 * own, shared, uniform=(True,)))}, figures[:1], trials=4000, seed=2)[0]
    assert alone.u95 == pytest.approx(0.95 * np.sqrt(3) * 0.5, rel=0.01)
    assert abs(alone.bias) < 0.03
    # the same whoever counts along, and however many are drawn at once
    seen: list[tuple[int, int]] = []
    again = propagate({AT: Places(errors)}, figures, trials=4000, seed=1, progress=lambda done, of: seen.append((done, of)))
    assert again == [mean, within, across]
    assert seen[-1] == (4000, 4000)


def test_a_group_that_was_attained_the_same_every_time_stays_so() -> None:
    away = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.1], [-0.3, 0.0, -0.1]])
    alike = _alike(away, np.array([0, 0, 1, 1]), 1e-9 * np.eye(3), 0.1, 1.0)
    np.testing.assert_array_equal(alike[:2], 0.0)
    np.testing.assert_allclose(alike[2:], away[2:], rtol=1e-3)


def test_what_is_done_is_told_in_order_until_it_is_all() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, -0.4, 1.2]), 0.1)
    reported: list[tuple[int, int]] = []
    model = Program.model_validate(program)
    evaluate(
        trajectory, model, StatedErrors(some_law(1)), settings=CertificationSettings(trials=300), progress=lambda *at: reported.append(at)
    )
    assert reported == sorted(reported)
    assert reported[-1][0] == reported[-1][1]


@pytest.mark.parametrize(("absent", "without"), [(("position", "rotation"), {"mm", "deg"}), (("rotation",), {"deg"}), ((), set[str]())])
def test_figures_of_which_a_trajectory_states_no_uncertainty_have_none(absent: tuple[str, ...], without: set[str]) -> None:
    """But by a model of its errors they have."""
    trajectory, program = synthetic_campaign(np.array([0.3, -0.4, 1.2]), 0.1)
    foreign, model, settings = replace(trajectory, absent=absent), Program.model_validate(program), CertificationSettings(trials=300)
    found = evaluate(foreign, model, settings=settings)
    kept = evaluate(foreign, model, StatedErrors(some_law(1)), settings=settings)
    assert {c.unit for c in found.characteristics} == {"mm", "deg"}
    for c, other in zip(found.characteristics, kept.characteristics, strict=True):
        assert np.isnan(c.u95) == (c.unit in without)
        assert np.isfinite(other.u95)
    codes = [getattr(f, "code", None) for f in found.notes]
    assert ("uncertainty.unstated" in codes) == bool(without)
    assert "uncertainty.unstated" not in [getattr(f, "code", None) for f in kept.notes]


class Row:
    """Positions along x (n,), half as large where they are as likely as those measured; for the law of their errors alone."""

    def __init__(self, x: FloatArray, errors: PoseErrors) -> None:
        self.x, self.errors = x, errors
        self.positions = np.outer(x, np.eye(3)[0])

    def state(self, errors: FloatArray, reduced: bool) -> FloatArray:
        return np.asarray((0.5 if reduced else 1.0) * self.x + errors[..., 3])


def along_x(n: int, *u: float) -> FloatArray:
    """(n, 6, k) factors of errors along x."""
    return np.asarray(np.tile(np.eye(6)[3][:, None] * np.array(u).reshape(1, -1), (n, 1, 1)))


def test_parts_have_the_errors_of_the_run_in_common_and_no_others() -> None:
    """One of them knows of fewer of these than the others."""
    one, other, less = (Subject("pose", name) for name in ("P1", "P2", "P3"))
    parts = {
        less: Row(np.zeros(1), PoseErrors.of(along_x(1, 0.2), along_x(1, 0.5))),
        one: Row(np.zeros(1), PoseErrors.of(along_x(1, 0.1), along_x(1, 0.5, 0.4))),
        other: Row(np.zeros(1), PoseErrors.of(along_x(1, 0.1), along_x(1, 0.5, -0.4))),
    }
    figures = [
        lambda s: s[one][..., 0] - s[other][..., 0],
        lambda s: s[one][..., 0] + s[other][..., 0],
        lambda s: s[one][..., 0] - s[less][..., 0],
    ]
    apart, both, fewer = propagate(parts, figures, trials=4000, seed=3)
    assert [apart.u_random, apart.u_systematic] == pytest.approx([0.1 * np.sqrt(2), 0.8], rel=0.1)
    assert [both.u_random, both.u_systematic] == pytest.approx([0.1 * np.sqrt(2), 1.0], rel=0.1)
    assert [fewer.u_random, fewer.u_systematic] == pytest.approx([np.hypot(0.1, 0.2), 0.4], rel=0.1)
    assert apart.u95 == pytest.approx(1.96 * np.hypot(0.1 * np.sqrt(2), 0.8), rel=0.05)
    # what a fitted frame takes of them, it takes of all
    nothing = propagate(parts, figures, trials=50, seed=3, fitted=lambda errors: {key: 0.0 * e for key, e in errors.items()})
    assert [(s.u95, s.u_random, s.u_systematic, s.bias) for s in nothing] == [(0.0, 0.0, 0.0, 0.0)] * 3
    assert propagate({}, [], trials=10, seed=1) == []


def test_errors_are_those_about_what_is_likely_and_standard_uncertainties_those_about_what_was_measured() -> None:
    """Of the square of 6 mm, which are 3 mm as likely; and an error adds its own square on average."""
    part = Row(np.array([6.0]), PoseErrors.of(along_x(1, 0.03), along_x(1, 0.04)))
    (found,) = propagate({AT: part}, [lambda s: s[AT][..., 0] ** 2], trials=20_000, seed=4)
    assert [found.u_random, found.u_systematic] == pytest.approx([12.0 * 0.03, 12.0 * 0.04], rel=0.1)
    assert found.u95 == pytest.approx(1.96 * 6.0 * 0.05, rel=0.03)
    (wide,) = propagate({AT: Row(np.zeros(1), part.errors)}, [lambda s: s[AT][..., 0] ** 2], trials=20_000, seed=4)
    assert wide.bias == pytest.approx(0.05**2, rel=0.05)
    assert wide.u95 == pytest.approx((1.96 * 0.05) ** 2, rel=0.05)


def test_many_poses_are_drawn_in_pieces_of_which_each_counts() -> None:
    """A hundred thousand at once; of standard uncertainties the first five hundred draws."""
    n, reported = 1200, []
    part = Row(np.zeros(n), PoseErrors.of(along_x(n, 3.0), along_x(n, 0.2)))
    figures = [lambda s: s[AT].mean(axis=-1), lambda s: s[AT][..., 0]]
    mean, single = propagate({AT: part}, figures, trials=630, seed=5, progress=lambda *at: reported.append(at))
    assert reported == [*((83 * k, 630) for k in range(1, 8)), (630, 630)]
    assert [mean.u_random, mean.u_systematic] == pytest.approx([3.0 / np.sqrt(n), 0.2], rel=0.12)
    assert [single.u_random, single.u_systematic] == pytest.approx([3.0, 0.2], rel=0.12)
    assert mean.u95 == pytest.approx(1.96 * np.hypot(0.2, 3.0 / np.sqrt(n)), rel=0.12)
    assert single.u95 == pytest.approx(1.96 * np.hypot(0.2, 3.0), rel=0.12)


def test_draws_of_a_part_do_not_depend_on_how_much_the_run_has_in_common() -> None:
    found = []
    for shared in (0, 1, 3):
        part = Row(np.zeros(2), PoseErrors.of(along_x(2, 0.1), along_x(2, *([0.0] * shared))))
        (one,) = propagate({AT: part}, [lambda s: s[AT].mean(axis=-1)], trials=40, seed=6)
        found.append((one.u95, one.bias, one.u_random, one.u_systematic))
    assert found[0] == found[1] == found[2]
