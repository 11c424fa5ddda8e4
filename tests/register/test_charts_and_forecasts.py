"""Control charts against their exact average run lengths, forecasts against simulated instruments."""

import numpy as np
import pytest

from lmeasure.core import LMeasureError
from lmeasure.register import charts_of, control_charts, forecast


def run_lengths(shift: float, count: int, longest: int) -> dict[str, float]:
    """Return the average run length of each chart over as many simulated instruments."""
    rng = np.random.default_rng([7, int(10 * shift)])
    out: dict[str, list[int]] = {}
    for _ in range(count):
        for chart in charts_of(rng.normal(size=longest) + shift):
            out.setdefault(chart.name, []).append(chart.signals[0] + 1 if chart.signals else longest)
    return {name: float(np.mean(lengths)) for name, lengths in out.items()}


def test_a_shift_is_found_as_soon_as_published() -> None:
    """By one standard deviation: 43.9 (Montgomery, table 9.1), 9 and 10 values on average; the means of 400 scatter by 5 %."""
    assert run_lengths(1.0, 400, 600) == {
        "Shewhart": pytest.approx(43.9, rel=0.15),
        "EWMA": pytest.approx(9.0, rel=0.12),
        "CUSUM": pytest.approx(9.9, rel=0.12),
    }


def test_sound_instruments_alarm_once_in_370_values() -> None:
    for name, length in run_lengths(0.0, 300, 2000).items():
        assert length == pytest.approx(370.0, rel=0.2), name


@pytest.mark.parametrize("baseline", [5, 10, 17, 40])
def test_a_short_baseline_gives_no_more_false_alarms(baseline: int) -> None:
    """Within 20 values as many sound instruments signal as with a known mean and spread; shares of 1,500 scatter by 0.6 %."""
    rng, count = np.random.default_rng(baseline), 1500
    signalled = dict.fromkeys(("Shewhart", "EWMA", "CUSUM"), 0)
    for _ in range(count):
        for chart in control_charts(rng.normal(size=baseline + 20), baseline):
            signalled[chart.name] += any(i >= baseline for i in chart.signals)
    for name, expected in {"Shewhart": 0.0527, "EWMA": 0.057, "CUSUM": 0.039}.items():
        assert signalled[name] / count == pytest.approx(expected, abs=0.018), name


def test_a_step_is_out_of_control_and_named_by_its_index() -> None:
    rng = np.random.default_rng(3)
    values = 0.5 + 0.01 * rng.normal(size=40)
    values[30:] += 0.05
    assert all(chart.signals and min(chart.signals) in range(30, 34) for chart in control_charts(values, 20))


@pytest.mark.parametrize(("values", "baseline"), [(np.ones(9), 9), (np.arange(9.0), 4), (np.arange(9.0), 10)])
def test_a_baseline_that_says_nothing_is_refused(values: np.ndarray, baseline: int) -> None:
    with pytest.raises(LMeasureError):
        control_charts(values, baseline)


def test_forecasts_hold_their_probability() -> None:
    """Instruments of 3 to 10 calibrations, whose walk is between a tenth and ten times the measurement's uncertainty."""
    rng, held, low = np.random.default_rng(11), 0, 0
    count = 800
    for _ in range(count):
        n, u = int(rng.integers(3, 11)), 10.0 ** rng.uniform(-3, 0)
        t = np.concatenate([[0.0], np.sort(rng.uniform(30, 400 * n, n - 1)), [0.0]])
        t[-1] = t[-2] + rng.uniform(30, 500)
        walk = 10.0 ** rng.uniform(-1, 1) * u / np.sqrt(np.mean(np.diff(t[:-1])))
        true = 5.0 + 0.01 * u * rng.normal() * t + np.concatenate([[0.0], np.cumsum(walk * np.sqrt(np.diff(t)) * rng.normal(size=n))])
        found = forecast(t[:-1], true[:-1] + u * rng.normal(size=n), np.full(n, u))
        begin, end = found.interval(t[-1])
        held += begin <= true[-1] <= end
        low += true[-1] < begin
    assert held / count == pytest.approx(0.95, abs=0.02)
    assert low / count == pytest.approx(0.025, abs=0.015)


def test_each_walk_is_forecast_as_by_conditioning_a_gaussian() -> None:
    """Height and slope of the line have a prior so wide that it tells nothing; all covariances written out."""
    rng = np.random.default_rng(2)
    t, u, later = np.array([0.0, 90.0, 210.0, 400.0]), np.array([0.2, 0.1, 0.3, 0.1]), 600.0
    x = 5.0 + 0.001 * t + rng.normal(size=4) * u
    mean, sigma = forecast(t, x, u).at(later)
    every = np.append(t, later)
    A = np.column_stack([np.ones(5), every])
    for i, ratio in enumerate(np.geomspace(1e-2, 1e2, 25)):
        q = ratio * np.mean(u**2) / np.mean(np.diff(t))
        V = A @ np.diag([1e4, 1.0]) @ A.T + q * np.minimum(every[:, None], every[None, :])
        gain = np.linalg.solve(V[:4, :4] + np.diag(u**2), V[:4, 4])
        assert mean[i] == pytest.approx(gain @ x, abs=1e-3)
        assert sigma[i] == pytest.approx(np.sqrt(V[4, 4] - gain @ V[:4, 4]), rel=1e-3)


def test_without_a_walk_it_is_the_line_of_least_squares() -> None:
    """A drift of 0.001 a day, read to 1e-6: the limit is reached where the line reaches it."""
    t = np.arange(0.0, 1000.0, 100.0)
    found = forecast(t, 1.0 + 0.001 * t, np.full(10, 1e-6))
    assert found.drift == pytest.approx(0.001, abs=1e-6)
    assert found.due(-np.inf, 2.5) == pytest.approx(1500.0, abs=5.0)
    assert found.due(-np.inf, 1e9, longest=730.0) == pytest.approx(900.0 + 730.0)


def test_too_few_calibrations_determine_no_drift() -> None:
    with pytest.raises(LMeasureError, match="3 or more"):
        forecast(np.array([0.0, 10.0]), np.zeros(2), np.ones(2))
    with pytest.raises(LMeasureError, match="above zero"):
        forecast(np.arange(4.0), np.zeros(4), np.zeros(4))
