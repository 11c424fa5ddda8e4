"""Every clause of ISO 9283 against examples worked by hand, and laws that hold for any cycles."""

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray
from lmeasure.iso9283 import formulas

EXAMPLES = tomllib.loads((Path(__file__).parent.parent / "authorities" / "iso9283" / "examples.toml").read_text())


def function(name: str) -> Any:
    """The function of that name."""
    return getattr(formulas, name)


@pytest.mark.parametrize("name", EXAMPLES)
def test_worked_by_hand(name: str) -> None:
    given_ = [np.array(a) if isinstance(a, list) else a for a in EXAMPLES[name]["given"]]
    np.testing.assert_allclose(function(name)(*given_), EXAMPLES[name]["expected"], rtol=0, atol=2e-10)


def test_every_figure_has_an_example() -> None:
    helpers = {"wrapped", "barycentre", "three_deviations", "largest_distance", "distances", "largest_change", "rotation_accuracy"}
    helpers |= {
        "rotation_repeatability", "first_arrival", "last_arrival", "crossing", "arrivals", "departure", "mean_over_cycles",
        "deviation_over_cycles",
    }  # fmt: skip
    helpers |= {"length", "spread"}
    public = {
        name
        for name, value in vars(formulas).items()
        if callable(value) and not name.startswith("_") and getattr(value, "__module__", "").startswith("lmeasure")
    }
    assert public - helpers == set(EXAMPLES)


@pytest.mark.parametrize("turned", [90.0, -90.0, 179.95, 180.0, -179.95, 37.0])
def test_orientations_are_as_accurate_wherever_the_command_points(turned: float) -> None:
    """Angles are attained modulo a turn, and written between -180 and 180 degrees."""
    off = np.array([[0.1, -0.2, 0.05], [-0.15, 0.1, 0.0], [0.2, 0.05, -0.1], [0.05, -0.1, 0.15]])
    attained = (turned + off + 180.0) % 360.0 - 180.0
    commanded = np.full(3, turned)
    np.testing.assert_allclose(formulas.orientation_accuracy(attained, commanded), off.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(formulas.orientation_repeatability(attained, commanded), 3.0 * off.std(axis=0, ddof=1), atol=1e-12)


Values = arrays(np.float64, (5, 3), elements=st.floats(-10, 10, width=32))
Turns = arrays(np.float64, (3,), elements=st.floats(-3, 3))


@settings(max_examples=50, deadline=None)
@given(Values, Values, Turns)
def test_a_rigid_motion_of_everything_changes_nothing(cycles: FloatArray, others: FloatArray, turn: FloatArray) -> None:
    rotation, shift, commanded = Rotation.from_rotvec(turn), np.array([100.0, -20.0, 7.0]), np.array([1.0, 2.0, 3.0])

    def moved(points: FloatArray) -> FloatArray:
        return np.asarray(rotation.apply(points) + shift)

    near: dict[str, Any] = {"rel": 1e-9, "abs": 1e-9}
    assert float(formulas.pose_accuracy(moved(cycles), moved(commanded))) == pytest.approx(
        float(formulas.pose_accuracy(cycles, commanded)), **near
    )
    for f in (formulas.pose_repeatability, formulas.rotation_repeatability):
        assert float(f(moved(cycles))) == pytest.approx(float(f(cycles)), **near)
    for g in (formulas.distance_repeatability, lambda a, b: formulas.distance_accuracy(a, b, 5.0)):
        assert float(g(moved(cycles), moved(others))) == pytest.approx(float(g(cycles, others)), **near)
    groups = [cycles, others]
    assert float(formulas.exchangeability([moved(g) for g in groups])) == pytest.approx(float(formulas.exchangeability(groups)), **near)


@settings(max_examples=50, deadline=None)
@given(Values, st.permutations(range(5)))
def test_the_order_of_cycles_changes_nothing(cycles: FloatArray, order: list[int]) -> None:
    commanded = np.array([1.0, 2.0, 3.0])
    for f in (
        lambda x: formulas.pose_accuracy(x, commanded),
        formulas.pose_repeatability,
        lambda x: formulas.orientation_repeatability(x, commanded),
        lambda x: formulas.path_repeatability(x[None]),
        formulas.cornering_round_off,
    ):
        np.testing.assert_allclose(f(cycles[order]), f(cycles), rtol=1e-12, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(Values, Turns)
def test_a_constant_offset_changes_accuracy_and_not_repeatability(cycles: FloatArray, offset: FloatArray) -> None:
    mean = cycles.mean(axis=0)
    assert float(formulas.pose_accuracy(cycles + offset, mean)) == pytest.approx(float(np.linalg.norm(offset)), abs=1e-9)
    assert float(formulas.pose_repeatability(cycles + offset)) == pytest.approx(float(formulas.pose_repeatability(cycles)), abs=1e-9)
    planes = np.stack([cycles, 2.0 * cycles])
    assert float(formulas.path_repeatability(planes + offset)) == pytest.approx(float(formulas.path_repeatability(planes)), abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(Values, st.integers(1, 4))
def test_draws_in_front_are_only_more_of_the_same(cycles: FloatArray, draws: int) -> None:
    many = np.stack([cycles + i for i in range(draws)])
    one = [float(formulas.pose_repeatability(c)) for c in many]
    np.testing.assert_allclose(formulas.pose_repeatability(many), one)


def test_what_the_robot_does_not_reach_is_nan() -> None:
    time_s = np.array([0.0, 0.1, 0.2])
    assert math.isnan(formulas.stabilisation_time(time_s, np.array([5.0, 4.0, 3.0]), 1.0))
    assert math.isnan(formulas.excursion(np.array([5.0, 4.0, 3.0]), 1.0))
    assert math.isnan(formulas.departure(time_s, np.array([2.0, 3.0, 4.0]), 1.0))
    assert math.isnan(formulas.stabilisation_length(time_s, np.array([2.0, 0.5, 2.0]), 1.0))
    # and what it never leaves is zero
    assert formulas.stabilisation_time(time_s, np.zeros(3), 1.0) == 0.0
    assert formulas.overshoot(formulas.excursion(np.array([[5.0, 0.5, 0.6], [5.0, 0.2, 0.3]]), 1.0), 1.0) == 0.0
    assert formulas.stabilisation_length(time_s, np.zeros(3), 1.0) == 0.0


DRAWN = {
    **dict.fromkeys(
        ("distance_accuracy", "distance_accuracy_components", "distance_repeatability", "distance_repeatability_components"), (0, 1)
    ),
    **dict.fromkeys(("stabilisation_time", "stabilisation_length"), (1,)),
    "posing_time": (1, 2),
}
"""Which of a figure's arguments are drawn, where it is not the first alone."""
GROUPED = {name for name in EXAMPLES if name.startswith(("multidirectional", "drift", "exchangeability"))}


@pytest.mark.parametrize("name", EXAMPLES)
def test_draws_and_their_draws_in_front_of_every_figure(name: str) -> None:
    """Two axes of draws give what each draw gives alone."""
    given_ = [np.array(a) if isinstance(a, list) else a for a in EXAMPLES[name]["given"]]
    rng = np.random.default_rng(1)
    axis = 1 if name in GROUPED else 0
    drawn = {i: given_[i] * (1.0 + 0.1 * rng.random((2, 3, *given_[i].shape))) for i in DRAWN.get(name, (0,))}

    def at(select: Any) -> Any:
        return function(name)(*(select(drawn[i], i) if i in drawn else a for i, a in enumerate(given_)))

    together = np.asarray(at(lambda values, i: np.moveaxis(values, 2, 0) if axis else values))
    assert together.shape[:2] == (2, 3)
    for j, k in np.ndindex(2, 3):
        np.testing.assert_allclose(together[j, k], at(lambda values, i, j=j, k=k: values[j, k]), rtol=1e-12, atol=1e-12)


def test_on_the_limit_is_within_it() -> None:
    time_s = np.array([0.0, 0.1, 0.2, 0.3])
    # it enters with its second sample and stays on the limit
    assert formulas.stabilisation_time(time_s, np.array([5.0, 1.0, 1.0, 0.5]), 1.0) == 0.0
    assert formulas.last_arrival(np.array([5.0, 1.0, 1.0]), 1.0) == 1
    assert formulas.first_arrival(np.array([5.0, 1.0, 1.0]), 1.0) == 1
    assert formulas.overshoot(np.array([0.5, 1.0]), 1.0) == 0.0
    assert formulas.excursion(np.array([1.0, 2.0, 0.5]), 1.0) == 2.0
    assert formulas.departure(time_s, np.array([1.0, 1.0, 3.0, 4.0]), 1.0) == pytest.approx(0.1)
    assert formulas.stabilisation_length(time_s, np.array([3.0, 1.0, 1.0, 1.0]), 1.0) == pytest.approx(0.1)
    assert formulas.stabilisation_length(time_s, np.array([5.0, 1.0, 0.0, 0.0]), 2.0) == pytest.approx(0.075)


def test_compliance_by_forces_of_all_axes_and_small_ones() -> None:
    """C is found whatever the forces are, also those below a newton, and its columns where one acted."""
    rng = np.random.default_rng(2)
    compliance, forces = rng.normal(size=(3, 3)), rng.normal(size=(6, 3)) * 0.1
    positions = np.array([10.0, 20.0, 30.0]) + forces @ compliance.T
    np.testing.assert_allclose(formulas.static_compliance(positions, forces), compliance, rtol=1e-9)
    forces[:, 1] = 5.0  # a load that stays is none
    found = formulas.static_compliance(np.array([1.0, 2.0, 3.0]) + forces @ compliance.T, forces)
    assert np.isnan(found[:, 1]).all()
    np.testing.assert_allclose(found[:, [0, 2]], compliance[:, [0, 2]], rtol=1e-9)


def test_a_band_that_is_kept_from_the_first_sample_on_is_entered_there() -> None:
    assert formulas.crossing(np.array([2.0, 3.0]), np.array([0.5, 0.4]), np.array(0), 1.0) == 2.0


def moment(time_s: FloatArray, distance: FloatArray, i: int) -> float:
    """When the band of 2 mm is crossed on the way to sample i, by similar triangles."""
    if i == 0:
        return float(time_s[0])
    return float(time_s[i - 1] + (time_s[i] - time_s[i - 1]) * (distance[i - 1] - 2.0) / (distance[i - 1] - distance[i]))


def looked_at(time_s: FloatArray, distance: FloatArray) -> tuple[float, float, float, float]:
    """First entry into a band of 2 mm, entry to stay, largest distance behind the first and first way out, sample by sample."""
    inside = [d <= 2.0 for d in distance]
    first = next((i for i, within in enumerate(inside) if within), None)
    last = next((i for i in range(len(inside)) if all(inside[i:])), None)
    out = next((i for i, within in enumerate(inside) if not within), None)
    farthest = math.nan if first is None else max(distance[first:])
    left = math.nan if out in (0, None) else moment(time_s, distance, out)
    if first is None or last is None:
        return math.nan, math.nan, farthest, left
    return moment(time_s, distance, first), moment(time_s, distance, last), farthest, left


def test_times_are_those_that_looking_at_one_sample_after_the_other_gives() -> None:
    """Of distances that often lie just on the limit, that stay, and whose samples are not equally spaced."""
    rng = np.random.default_rng(5)
    time_s = np.array([-1.0, 0.5, 0.75, 2.0, 4.0])
    distance, other = rng.integers(0, 5, (2, 30, 20, 5)).astype(float)
    alone = np.array([[looked_at(time_s, d) for d in row] for row in distance])
    there = np.array([[looked_at(time_s, d)[1] for d in row] for row in other])
    first, last, farthest, left = np.moveaxis(alone, -1, 0)
    assert (np.isnan(alone).any(axis=(0, 1)) & (alone == time_s[0]).any(axis=(0, 1)))[[0, 1]].all()
    entered = formulas.arrivals(time_s, distance, 2.0)
    np.testing.assert_allclose(entered, [first, last], rtol=0, atol=1e-12)
    np.testing.assert_allclose(formulas.stabilisation_time(time_s, distance, 2.0), last - first, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(formulas.excursion(distance, 2.0), farthest)
    np.testing.assert_allclose(formulas.departure(time_s, distance, 2.0), left, rtol=0, atol=1e-12)
    np.testing.assert_allclose(formulas.posing_time(time_s, distance, other, 2.0), there - left, rtol=0, atol=1e-12)
    reached = farthest[~np.isnan(farthest).any(axis=1)]
    np.testing.assert_array_equal(formulas.overshoot(reached, 2.0), [max([0.0, *(x for x in row if x > 2.0)]) for row in reached])
