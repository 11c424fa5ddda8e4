"""Temperature, stretch and sag of one cable against its mechanics integrated along the cable, from a statement of its own."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from lmeasure.core import FloatArray
from lmeasure.kernels import counts_from_changes, effects, span_lengths
from lmeasure.kernels.cable import drum_change
from lmeasure.kernels.decorators import kernel


@kernel
def arc(across: float, height: float, weight: float, tension: float) -> float:
    return float(effects.arc_length(across, height, weight, tension))


@kernel
def material(cable: FloatArray, effect: FloatArray, point: FloatArray, k: float, warm: float) -> float:
    return float(effects.material_length(cable, effect, (point[0], point[1], point[2]), k, warm))


@kernel
def wound(cable: FloatArray, effect: FloatArray, k: float, warm: float) -> float:
    return float(effects.wound_length(cable, effect, k, warm))


@kernel
def change(k: float, cable: FloatArray) -> float:
    return float(drum_change(k, cable[10], cable[11], cable[12], cable[13]))


def catenary(across: float, height: float, weight: float, tension: float) -> float:
    """Length of a catenary that starts with that tension, from the horizontal tension H by its two boundary conditions."""

    def slope(H: float) -> float:
        # the angle at the start follows from the chord: z(across) - z(0) = height
        a = H / weight
        return math.asinh(height / (2 * a * math.sinh(across / (2 * a)))) - across / (2 * a)

    def excess(H: float) -> float:
        return H * math.cosh(slope(H)) - tension

    # the tension falls with H to its least and rises again: the tight cable is the larger root
    H = brentq(excess, 0.3 * tension * across / math.hypot(across, height), 1.01 * tension, xtol=1e-13)
    a = H / weight
    return a * (math.sinh(slope(H) + across / a) - math.sinh(slope(H)))


@pytest.mark.parametrize("height", [-1200.0, -50.0, 0.0, 400.0, 1500.0])
@pytest.mark.parametrize("weight", [1e-6, 1e-5, 5e-5, 1e-3])
def test_arc_is_the_catenary(height: float, weight: float) -> None:
    tension = 6.0
    # the kernel is given the mean of the two end tensions
    assert arc(1300.0, height, weight, tension + weight * height / 2) == pytest.approx(catenary(1300.0, height, weight, tension), abs=1e-9)


def test_arc_of_small_sag_is_the_parabola_s() -> None:
    chord, slope, weight, tension = 1800.0, 0.6, 2e-5, 8.0
    longer = arc(chord * math.cos(slope), chord * math.sin(slope), weight, tension) - chord
    assert longer == pytest.approx((weight * math.cos(slope)) ** 2 * chord**3 / (24 * tension**2), rel=1e-4)
    assert 1e-3 < longer < 1e-2


def test_arc_of_a_vertical_cable_is_its_chord_and_a_slack_one_has_none() -> None:
    assert arc(0.0, 900.0, 1e-5, 5.0) == pytest.approx(900.0, abs=1e-12)
    assert math.isnan(arc(1000.0, 0.0, 1e-2, 1.0))


def hanging(radius: float, u: FloatArray, point: FloatArray, weight: float, tension: float, per_newton: float) -> float:
    """Unstrained length from B in a vertical plane (x, z), by integration along the cable: round the pulley with that tension, then free
    under its weight and strain to the point."""
    n = np.array([-u[1], u[0]]) * np.sign(u[0] * point[1] - u[1] * point[0])
    centre = radius * n

    def end(phi: float, length: float) -> FloatArray:
        begin = centre + radius * (math.sin(phi) * u - math.cos(phi) * n)
        e = math.cos(phi) * u + math.sin(phi) * n

        def along(_: float, y: FloatArray) -> list[float]:
            force = tension * e + np.array([0.0, weight * y[2]])
            size = float(np.linalg.norm(force))
            return [*(force / size * (1 + size * per_newton)), 1.0]

        return np.asarray(solve_ivp(along, (0.0, length), [*begin, 0.0], method="DOP853", rtol=1e-13, atol=1e-11).y[:2, -1])

    def chord_angle(phi: float) -> float:
        begin = centre + radius * (math.sin(phi) * u - math.cos(phi) * n)
        e, way = math.cos(phi) * u + math.sin(phi) * n, point - begin
        return float(e[0] * way[1] - e[1] * way[0])

    guess = brentq(chord_angle, 1e-6, 2.5)
    begin = centre + radius * (math.sin(guess) * u - math.cos(guess) * n)
    found = fsolve(lambda x: end(x[0], 1e3 * x[1]) - point, [guess, float(np.linalg.norm(point - begin)) / 1e3], xtol=1e-13)
    return float(radius * found[0] / (1 + tension * per_newton) + 1e3 * found[1])


@pytest.mark.parametrize(
    ("weight", "accuracy_mm"),
    [
        # 1 g/m, as of a rope of 0.5 mm: what is left out is a thousandth of the effect
        (1e-5, 5e-7),
        # 4 g/m, as of 1 mm
        (4e-5, 2.5e-6),
    ],
)
@pytest.mark.parametrize("end", [(900.0, 700.0), (1500.0, -300.0), (1200.0, 50.0)])
def test_free_cable_against_its_mechanics(weight: float, accuracy_mm: float, end: tuple[float, float]) -> None:
    radius, tension, per_newton = 20.0, 6.0, 1 / 9000.0
    u = np.array([-0.3, math.sqrt(1 - 0.09)])  # travelling up and back at B
    cable = np.zeros(17)
    cable[3:6] = u[0], 0.0, u[1]
    cable[6] = radius
    cable[13] = 0.012
    effect = np.array([0.0, 0.0, 0.0, per_newton, weight, tension, 0.0, math.nan, 0.0])
    point = np.array(end)
    expected = hanging(radius, u, point, weight, tension, per_newton)
    got = material(cable, effect, np.array([end[0], 0.0, end[1]]), 0.0, 0.0)
    assert got == pytest.approx(expected, abs=accuracy_mm)
    straight = material(cable, effect * np.array([1, 1, 1, 1, 0, 1, 1, 1, 1]), np.array([end[0], 0.0, end[1]]), 0.0, 0.0)
    assert abs(got - straight) > 10 * accuracy_mm


def test_wound_material_is_the_integral_over_the_turns() -> None:
    cable = np.zeros(17)
    cable[13] = 0.012
    effect = np.array([1.6e-5, 2.3e-5, 0.0, 1 / 9000.0, 0.0, 6.0, 0.5e-3, math.nan, 0.0])
    warm, k = 7.0, 90_000.0
    middle = (np.arange(200_000) + 0.5) / 200_000 * k
    strain = (6.0 + 0.5e-3 * 0.012 * middle) / 9000.0
    expected = np.mean(0.012 * (1 + 2.3e-5 * warm) / ((1 + 1.6e-5 * warm) * (1 + strain))) * k
    assert wound(cable, effect, k, warm) == pytest.approx(expected, abs=1e-9)
    # a winding tension of its own
    effect[7] = 3.0
    assert wound(cable, effect, k, warm) == pytest.approx(
        0.012 * k * (1 + 2.3e-5 * warm) / ((1 + 1.6e-5 * warm) * (1 + 3 / 9000)), abs=1e-9
    )


def rows() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    cable = np.zeros((1, 17))
    cable[0] = [800, -300, 1500, -0.2, 0.3, math.sqrt(1 - 0.13), 20, 10, 20, 0, 180, 25, 1 / 6000, 0.012, 0, 0, 6000]
    zero = np.array([[0.0, 0, 0, 0, 0, 0, 1]])
    poses = np.array([[100.0, 50, -80, 0, 0, math.sin(0.1), math.cos(0.1)], [-200.0, 0, 150, math.sin(0.1), 0, 0, math.cos(0.1)]])
    counts = np.array([[9000.0], [-14000.0]])
    return cable, zero, poses, counts


def excess(effect: list[float], warm_zero: float = 0.0, warm: float = 0.0) -> FloatArray:
    cable, zero, poses, counts = rows()
    return np.asarray(
        effects.excesses(cable, np.array([effect]), zero, np.zeros(1), poses, counts, np.full(1, warm_zero), np.full((2, 1), warm))
    )


def test_a_constant_tension_and_one_temperature_have_no_effect_where_lengths_agree_with_counts() -> None:
    cable, zero, poses, counts = rows()
    plain = np.array([[change(k, cable[0])] for k in counts[:, 0]])
    # a pose at which the counts agree with the geometry has no excess whatever the constant strain; elsewhere strain scales the misfit
    lengths = span_lengths(cable, np.vstack([zero, poses]))
    exact = counts_from_changes(cable, lengths[1:] - lengths[0])
    effect = np.array([[0.0, 0.0, 0.0, 1 / 9000.0, 0.0, 6.0, 0.0, math.nan, 300.0]])
    assert effects.excesses(cable, effect, zero, np.zeros(1), poses, exact, np.zeros(1), np.zeros((2, 1))) == pytest.approx(0, abs=1e-9)
    # cable, drum and frame of one material at one other temperature: everything is larger by one factor, the tool is not
    grown = 1 + 1.2e-5 * 10
    large = cable.copy()
    large[:, [0, 1, 2, 6, 10, 11, 12, 13]] *= grown
    lengths = span_lengths(large, np.vstack([zero, poses]))
    exact = counts_from_changes(large, lengths[1:] - lengths[0])
    same = np.array([[1.2e-5, 1.2e-5, 1.2e-5, 0.0, 0.0, 0.0, 0.0, math.nan, 300.0]])
    got = effects.excesses(cable, same, zero, np.zeros(1), poses, exact, np.full(1, 10.0), np.full((2, 1), 10.0))
    lengths = span_lengths(cable, np.vstack([zero, poses]))
    plain = np.array([[change(k, cable[0])] for k in exact[:, 0]])
    # the pitch is the drum's way per turn and stays: 1e-4 of a millimetre
    assert lengths[1:] - lengths[0] + got == pytest.approx(plain, abs=2e-3)


def test_a_warmer_cable_is_longer() -> None:
    cable, _, poses, _ = rows()
    free = math.hypot(180, 25) + 300.0  # and what leads from B to the tool
    length = span_lengths(cable, poses)[:, 0] + free
    got = excess([1.6e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, 300.0], 0.0, 5.0)[:, 0]
    cold = excess([1.6e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, 300.0])[:, 0]
    assert cold == pytest.approx(0.0, abs=1e-12)
    # the same counts now hold more cable: modelled less measured falls by the expansion of what is free
    assert got == pytest.approx(-1.6e-5 * 5 * length, rel=0.1)


def test_what_carries_no_tension_is_nan() -> None:
    assert np.isnan(excess([0, 0, 0, 1 / 9000.0, 0, 0.02, 1e-3, math.nan, 0])[1, 0])
