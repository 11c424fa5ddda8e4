"""Bounds of what happens between samples, against samples drawn from known paths."""

import numpy as np
import pytest

from lmeasure.core import FloatArray
from lmeasure.iso9283.sample_gaps import Chords, between

SPEED, STEP_S = 240.0, 0.0125
INTO, OUT = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def cornered(radius: float, slowest: float, outwards: float) -> tuple[FloatArray, FloatArray]:
    """Return fine times (n,) [s] and places (n, 3) [mm] past a right-angled corner at the origin.

    An arc of the radius; the speed falls to a part of SPEED there; outwards [mm]: how far the path swings out.
    """
    way = np.arange(-60.0, 60.0, 0.005)
    turn = np.clip(way / radius, 0.0, np.pi / 2)
    behind = np.maximum(way - radius * np.pi / 2, 0.0)
    places = np.outer(np.minimum(way, 0.0) - radius * (1.0 - np.sin(turn)), INTO) + np.outer(radius * (1.0 - np.cos(turn)) + behind, OUT)
    swing = outwards * np.exp(-((np.linalg.norm(places, axis=1) / 8.0) ** 2))
    places += swing[:, None] * (INTO - OUT) / np.sqrt(2.0)
    pace = SPEED * (1.0 - (1.0 - slowest) * np.exp(-((way / 4.0) ** 2)))
    return np.cumsum(0.005 / pace), places


@pytest.mark.parametrize("shape", [(1e-3, 1.0, 0.0), (2.0, 1.0, 0.0), (5.0, 1.0, 0.0), (2.0, 0.5, 0.0), (1e-3, 0.3, 0.0), (2.0, 1.0, 2.0)])
def test_a_corner_is_passed_within_what_times_allow(shape: tuple[float, float, float]) -> None:
    """Right angles of several shapes at drawn phases, samples without errors."""
    time_s, places = cornered(*shape)
    truth = float(np.linalg.norm(places, axis=1).min())
    rng, widths = np.random.default_rng(1), []
    for phase in rng.random(40):
        at = np.arange(time_s[0] + phase * STEP_S, time_s[-1], STEP_S)
        samples = np.column_stack([np.interp(at, time_s, column) for column in places.T])
        least, most = Chords.about(at, samples).passes(0.0, 0.0, outside=shape[2] > 0.0)
        assert least - 1e-3 <= truth <= most + 1e-3
        widths.append(most - least)
    # of a corner of 2 mm, samples 3 mm apart: little more than half the apex of a sharp one, 1.06 mm
    assert shape != (2.0, 1.0, 0.0) or np.median(widths) < 0.6


def test_a_step_may_be_longer_by_as_much_as_samples_err() -> None:
    places = np.outer(np.arange(-4.5, 5.0), OUT) + [2.0, 0.0, 0.0]
    chords = Chords.about(np.arange(10, dtype=np.float64) * STEP_S, places)
    # half the small axis of an ellipse of a string 2 standard deviations longer than the step of 1 mm
    for noise_mm, u_time_s, longer in ((0.01, 0.0, 0.02), (0.0, 1e-4, 2e-4 / STEP_S)):
        width = 0.5 * np.sqrt((1.0 + longer) ** 2 - 1.0)
        assert chords.passes(noise_mm, u_time_s, outside=False) == pytest.approx((2.0 - width, 2.0), rel=1e-9)
        assert chords.passes(noise_mm, u_time_s, outside=True) == pytest.approx((2.0 - width, 2.0 + width), rel=1e-9)


def test_times_in_error_hide_nothing_that_their_size_explains() -> None:
    """A straight motion, sampled when asked and stamped late: in 200 draws of 40 steps."""
    rng, u = np.random.default_rng(2), 3e-4
    seen, blind = [], []
    for _ in range(200):
        true = np.cumsum(rng.uniform(4e-3, 6e-3, 40))
        places = SPEED * true[:, None] * INTO + 0.003 * rng.normal(size=(40, 3))
        steps = between(true + u * rng.normal(size=40), places)
        seen.append(np.linalg.norm(steps.bound(0.003**2 * np.eye(3), u)[0], axis=1))
        blind.append(np.linalg.norm(steps.bound(0.003**2 * np.eye(3))[0], axis=1))
    assert np.mean(np.array(seen) > 0.0) < 0.01
    assert np.mean(np.array(blind) > 0.0) > 0.5


def test_times_in_error_do_not_hide_a_corner_across_the_motion() -> None:
    """A turn by 0.2 rad between samples, and times that move samples along the path by as much as they lie off the cubics."""
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(4e-3, 6e-3, 40))
    way = SPEED * (time_s - 0.5 * (time_s[19] + time_s[20]))
    places = np.outer(np.minimum(way, 0.0), INTO) + np.outer(np.maximum(way, 0.0), 0.98 * INTO + 0.2 * OUT)
    steps = between(time_s, places)
    still, late = (steps.bound(1e-6 * np.eye(3), u)[0][19] for u in (0.0, 0.05 / SPEED))
    apex = np.linalg.norm(places[19:21].mean(axis=0))
    assert np.linalg.norm(still) == pytest.approx(apex, rel=0.1)
    assert np.linalg.norm(late) == pytest.approx(apex, rel=0.1)
