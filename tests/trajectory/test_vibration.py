"""Dwells of a robot that vibrates: one signal, against sinusoids of known rests and counts that are rounded."""

import numpy as np
import pytest
from honest import assert_honest
from scipy.special import j0
from synthetic_trajectories import UNIT, StatedErrors, by_name, trajectory_of

from lmeasure.core import FloatArray, symmetric_root
from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.recording import Program
from lmeasure.trajectory import PoseErrors, averaged, with_rest
from lmeasure.trajectory.motion.vibration import Swing, Vibration, vibration

COUNT = 0.012
LAW = np.zeros((6, 6))
LAW[3:, 3:] = COUNT**2 / 12.0 * np.eye(3)


def swinging(
    amplitude_mm: float, hz: float, window_s: float, dwells: int, seed: int, *, rate_hz: float = 200.0, locked: bool = False
) -> tuple[list[FloatArray], FloatArray, FloatArray]:
    """Times of each dwell, true positions (dwells, k, 3) [mm] and rests (dwells, 3) of a swing in one direction."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(window_s * rate_hz) + 1) / rate_hz
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    phases = np.full(dwells, rng.uniform(0, 2 * np.pi)) if locked else rng.uniform(0, 2 * np.pi, dwells)
    rests = rng.uniform(0.0, 1.0, (dwells, 3))
    waves = amplitude_mm * np.sin(2 * np.pi * hz * t + phases[:, None])
    return [t + 10.0 * i for i in range(dwells)], rests[:, None] + waves[:, :, None] * direction, rests


def looked_at(times: list[FloatArray], positions: FloatArray) -> Vibration:
    away = np.zeros((*positions.shape[:2], 6))
    away[:, :, 3:] = positions - positions.mean(axis=1, keepdims=True)
    return vibration(list(zip(times, away, strict=True)))


@pytest.mark.parametrize(("hz", "window_s"), [(5.0, 0.15), (5.0, 0.3), (7.3, 0.5), (13.0, 0.5), (11.0, 1.0), (4.0, 0.13)])
def test_a_mean_misses_the_rest_by_what_the_swing_says(hz: float, window_s: float) -> None:
    times, positions, rests = swinging(0.03, hz, window_s, 80, seed=1)
    seen = COUNT * np.rint(positions / COUNT)
    found = looked_at(times, seen)
    missed = positions.mean(axis=1) - rests
    actual = float((missed**2).sum(axis=1).mean())
    # a window of whole periods misses nothing, if the frequency were known and did not wander: at most a quarter of a period is allowed for
    wandering = 0.5 * 0.03**2 * 0.2 / (np.pi * hz * window_s) ** 2
    assert 0.8 * actual < np.trace(found.of_mean[3:, 3:]) < 1.35 * actual + wandering
    assert found.frequencies_hz[0] == pytest.approx(hz, rel=0.06)


def test_one_dwell_tells_its_own_frequency_and_rest() -> None:
    times, positions, rests = swinging(0.05, 6.0, 0.35, 1, seed=2)
    found = looked_at(times, positions)
    np.testing.assert_allclose(found.swings[0].missed[3:], positions[0].mean(axis=0) - rests[0], atol=1e-3)
    assert found.frequencies_hz[0] == pytest.approx(6.0, abs=0.1)


def test_what_is_new_at_every_sample_is_no_swing() -> None:
    rng = np.random.default_rng(3)
    times = [np.arange(100) / 200.0 + i for i in range(10)]
    number = sum(bool(looked_at(times, rng.normal(size=(10, 100, 3))).frequencies_hz) for _ in range(40))
    assert number <= 2
    still = looked_at(times, np.zeros((10, 100, 3)))
    assert still.frequencies_hz == ()
    assert not still.of_mean.any()


def test_multiples_that_rounding_makes_of_a_swing_are_not_taken_for_others() -> None:
    times, positions, _ = swinging(0.013, 6.0, 0.5, 10, seed=4)
    found = looked_at(times, COUNT * np.rint(positions / COUNT))
    assert len(found.frequencies_hz) == 1
    # two swings that are there are both found
    other = swinging(0.02, 10.0, 0.5, 10, seed=5)[1]
    both = looked_at(times, positions + other)
    assert sorted(round(f) for f in both.frequencies_hz) == [6, 10]


def test_swings_of_one_phase_miss_alike() -> None:
    groups = np.zeros(10, dtype=np.int64)
    errors = PoseErrors.of(np.zeros((10, 6, 0)), np.zeros((10, 6, 0)))
    shares = {}
    for locked in (True, False):
        times, positions, rests = swinging(0.03, 7.0, 0.4, 10, seed=6, locked=locked)
        found = looked_at(times, positions)
        shares[locked] = found.alike(groups)
        law = with_rest(errors, found, groups)
        misses = positions.mean(axis=1) - rests
        of_mean = law.random.mean(axis=0) / 10 + law.factors.mean(axis=0) @ law.factors.mean(axis=0).T
        assert np.trace(of_mean[3:, 3:]) > 0.5 * float((misses.mean(axis=0) ** 2).sum())
        np.testing.assert_allclose(law.random[0], found.of_mean, atol=1e-15)
    assert shares[True] > 0.99
    assert shares[False] < 0.4
    # dwells that stand alone have nothing in common with any
    assert not with_rest(errors, found, np.arange(10)).local.any()


@pytest.mark.parametrize("counts", [0.5, 1.0, 4.0])
def test_roundings_along_a_swing_are_kept_as_a_sawtooth_keeps_them(counts: float) -> None:
    """Against the errors of means of rounded lengths, and against Bessel's function of a sinusoid of many periods."""
    times, positions, _ = swinging(counts * COUNT, 9.0, 1.0, 400, seed=7, rate_hz=100.0)
    seen = COUNT * np.rint(positions / COUNT)
    single = PoseErrors.of(symmetric_root(np.tile(LAW, (400, 1, 1))), np.zeros((400, 6, 0)), rounded=True)
    found = looked_at(times, seen)
    factor = averaged(single, found, np.full(400, 100))[:, 3:]
    actual = 12.0 * ((seen - positions).mean(axis=1) / COUNT) ** 2
    k = np.arange(1, 60)
    amplitudes = np.abs(np.linalg.svd(positions[0] - positions[0].mean(axis=0))[2][0]) * counts
    for axis in range(3):
        bessel = 6.0 / np.pi**2 * (j0(2 * np.pi * k * amplitudes[axis]) ** 2 / k**2).sum()
        assert actual[:, axis].mean() == pytest.approx(bessel, abs=0.08)
        assert 0.7 * actual[:, axis].mean() < factor[:, axis].mean() < 1.5 * actual[:, axis].mean() + 0.06


def test_a_robot_that_stands_still_has_one_reading() -> None:
    still = vibration([(np.arange(50) / 100.0, np.zeros((50, 6)))] * 3)
    single = PoseErrors.of(symmetric_root(np.tile(LAW, (3, 1, 1))), np.zeros((3, 6, 0)), rounded=True)
    np.testing.assert_allclose(averaged(single, still, np.ones(3, dtype=np.int64)), 1.0)


def test_dwells_of_which_only_later_ones_swing() -> None:
    """More still ones first than are looked at for the shape of the swing."""
    wave = np.zeros((50, 6))
    wave[:, 3] = 0.05 * np.sin(2.0 * np.pi * 8.0 * np.arange(50) / 100.0)
    swings = tuple(Swing(motion, np.zeros((6, 6)), np.zeros(6)) for motion in [np.zeros((50, 6))] * 60 + [wave] * 3)
    single = PoseErrors.of(symmetric_root(np.tile(LAW, (63, 1, 1))), np.zeros((63, 6, 0)), rounded=True)
    found = averaged(single, Vibration(swings, np.zeros((6, 6)), (8.0,)), np.full(63, 50))
    assert np.isfinite(found).all()
    assert (found[:, 3] < 1.0).all()


@pytest.mark.parametrize(("amplitude_mm", "window_s", "rate_hz"), [(0.02, 0.4, 100.0), (0.05, 0.12, 400.0)])
def test_u95_of_a_vibrating_robot_holds_where_it_rests(amplitude_mm: float, window_s: float, rate_hz: float) -> None:
    """5 to 13 Hz, three axes read in counts: half of the figures lay outside where samples were taken as independent."""
    ratios: dict[str, list[float]] = {}
    for seed in range(25):
        rng = np.random.default_rng(1000 + seed)
        t, positions, _ = swinging(amplitude_mm, rng.uniform(5.0, 13.0), window_s, 8, seed, rate_hz=rate_hz)
        rests = 0.1 * rng.normal(size=3) + 0.02 * rng.normal(size=(8, 3))
        # the same draws without a swing are its rests
        waves = positions - swinging(0.0, 1.0, window_s, 8, seed, rate_hz=rate_hz)[1]
        seen = COUNT * np.rint((rests[:, None] + waves) / COUNT)
        time_s = np.concatenate([[-1.0], *t])
        windows = [(float(x[0]), float(x[-1])) for x in t]
        pose = {"name": "P1", "position_mm": (0, 0, 0), "quaternion_xyzw": UNIT, "windows_s": windows}
        program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose]})
        trajectory = trajectory_of(time_s, np.concatenate([np.zeros((1, 3)), *seen]))
        law = StatedErrors(LAW, rounded=True)
        found = by_name(evaluate(trajectory, program, law, settings=CertificationSettings(trials=300, seed=seed)))
        mean = rests.mean(axis=0)
        distance = np.linalg.norm(rests - mean, axis=1)
        expected = dict(zip(("AP_x", "AP_y", "AP_z"), mean, strict=True))
        expected |= {"AP_p": np.linalg.norm(mean), "RP_l": distance.mean() + 3.0 * distance.std(ddof=1)}
        for name, value in expected.items():
            ratios.setdefault(name, []).append((found[name, "P1"].value - value) / found[name, "P1"].u95)
    for names in (("AP_x", "AP_y", "AP_z"), ("AP_p",), ("RP_l",)):
        own = np.abs(np.transpose([ratios[name] for name in names]))
        if window_s > 0.2 and names != ("RP_l",):
            assert_honest(own)
        # what a swing leaves of windows shorter than itself is known less well: U95 is wide there, but not more than twice as wide
        assert np.mean(own <= 1.0) >= (0.85 if names == ("RP_l",) else 0.9)
        assert np.quantile(own, 0.95) > 0.45
