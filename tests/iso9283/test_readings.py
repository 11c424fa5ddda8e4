"""What figures read from a motion err by: between samples, and by the counts."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from synthetic_trajectories import StatedErrors, trajectory_of

from lmeasure.core import FloatArray
from lmeasure.iso9283 import CertificationSettings, formulas
from lmeasure.iso9283.motion_readings import Finer, Motion, Reading, Reported, Stretch
from lmeasure.trajectory import Frame, PoseErrors, Trajectory, phases, roundings
from lmeasure.trajectory.time.stamps import sound

UNIT = np.array([0.0, 0.0, 0.0, 1.0])


def rows(seed: int, cables: int = 6) -> FloatArray:
    """(6, m) what one standard deviation of each rounded length makes of a pose [rad; mm]."""
    own = np.random.default_rng(seed).normal(size=(6, cables))
    own[:3] *= 1e-5
    own[3:] *= 3e-3
    return own


@pytest.mark.parametrize("cables", [6, 8])
def test_roundings_are_those_of_the_lengths(cables: int) -> None:
    own, rng, trials, k = rows(1, cables), np.random.default_rng(2), 3000, 5
    per_pose = np.sqrt(12.0) * own
    lengths = 40.0 * rng.normal(size=(k, cables))
    lengths[0] = 0.0
    lengths[1] = lengths[0] + 0.3
    moved = lengths @ per_pose.T
    reached = moved @ np.linalg.pinv(per_pose).T
    phase, away = rng.random((trials, cables)), rng.random((trials, cables))
    found = roundings(own, moved, phase, away)
    # where the robot stands, and as it has moved less than a count, every length by itself
    for sample in (0, 1):
        truth = phase + reached[sample] + np.minimum(np.abs(reached[sample]), 1.0) * away
        np.testing.assert_allclose(found[:, sample], (np.rint(truth) - truth) @ per_pose.T, atol=1e-9)
    # anywhere: uniform, of the stated covariance
    stated = own @ own.T
    size = np.sqrt(np.diag(stated))
    for sample in range(k):
        covariance = np.cov(found[:, sample].T)
        np.testing.assert_allclose(covariance / np.outer(size, size), stated / np.outer(size, size), atol=0.08)
    # far away from each other, nothing in common
    far = np.corrcoef(found[:, 0].T, found[:, 3].T)[:6, 6:]
    assert np.abs(far).max() < 0.08


def test_visits_within_a_count_share_where_they_lie() -> None:
    own = rows(3)
    law = PoseErrors.of(np.tile(own, (4, 1, 1)), np.zeros((4, 6, 0)), rounded=True)
    rng = np.random.default_rng(4)
    same = phases(law, np.zeros((4, 6)), rng, 100)
    assert np.ptp(same, axis=1).max() == 0.0
    # by two counts: no visit tells where the lengths of another lie
    counts = 2.0 * rng.normal(size=(4, 6))
    apart = phases(law, (counts - counts.mean(axis=0)) @ (np.sqrt(12.0) * own).T, rng, 4000)
    error = np.rint(apart) - apart
    assert abs(np.corrcoef(error[:, 0, 0], error[:, 1, 0])[0, 1]) < 0.08
    assert error.var() == pytest.approx(1.0 / 12.0, rel=0.05)


def test_between_samples_lies_the_spline_and_halving_tells_how_far_it_is_off() -> None:
    def way(t: FloatArray) -> FloatArray:
        return np.sin(2 * np.pi * 9.0 * t)

    t = np.arange(0.0, 0.5, 4e-3)
    stretch = Stretch(np.arange(len(t)), t, np.column_stack([way(t), 0 * t, 0 * t, np.tile(UNIT, (len(t), 1))]), (Stretch.begun(),))
    finer = stretch.finer(10.0)
    assert finer.pieces == 16
    off = np.abs(finer.read(way(t)) - way(finer.time_s))
    reported = np.abs(finer.read(way(t), 2) - finer.read(way(t))) / 7.0
    inner = slice(20 * finer.pieces, -20 * finer.pieces)
    assert off[inner].max() < reported[inner].max() < 30.0 * off[inner].max()
    # straight lines are off by 200 times as much
    assert np.abs(np.interp(finer.time_s, t, way(t)) - way(finer.time_s))[inner].max() > 100.0 * off[inner].max()
    # no step of a fast motion is longer than a quarter of the limit
    assert np.abs(np.diff(stretch.finer(0.05).read(way(t)))).max() < 0.05 / 4


def motion_of(trajectory: Trajectory, law: StatedErrors, *, trials: int) -> Motion:
    """A motion in the base frame with errors by one law."""
    stamps, settings = sound(trajectory.time_s), CertificationSettings(trials=trials, seed=1)
    return Motion(trajectory, Frame(np.zeros(3)), lambda i: [law.at(trajectory, i)[0]], stamps=stamps, settings=settings)


def test_u95_holds_what_a_spline_is_off() -> None:
    # a swing so fast that its samples hardly tell it: eight to a period
    t = np.arange(0.0, 1.0, 4e-3)
    swing = np.exp(-t / 0.15) * np.cos(2 * np.pi * 31.25 * t + 0.4)
    trajectory = trajectory_of(t, np.column_stack([swing, 0 * t, 0 * t]))
    law = StatedErrors(rounded=True)
    motion = motion_of(trajectory, law, trials=10)

    def at(time_s: FloatArray, vectors: FloatArray) -> FloatArray:
        return np.asarray(formulas.stabilisation_time(time_s, np.abs(vectors[..., 0]), 0.05)[..., None])

    reported = motion.read([motion.stretch(0.0, 1.0, "window", begins=False)], Reading(at, lambda v: np.abs(v[..., 0]), 0.05, np.ones(1)))
    fine = np.arange(0.0, 1.0, 1e-5)
    away = np.abs(np.exp(-fine / 0.15) * np.cos(2 * np.pi * 31.25 * fine + 0.4))
    off = abs(float(reported.values[0, 0]) - float(formulas.stabilisation_time(fine, away, 0.05)))
    assert 0.0 < off < reported.u95(0, np.mean) < 100.0 * off + 1e-3


def test_errors_are_read_as_the_whole_spline_reads_them() -> None:
    rng = np.random.default_rng(5)
    t = np.array([1e-3 * i for i in range(300)])
    errors = rng.normal(size=(4, 300, 3))
    finer = Finer(t, 4, np.arange(299 * 4 + 1) / 4 * 1e-3)
    points = np.r_[0, 401:423, 900:907, 299 * 4]
    requested: list[int] = []

    def of_samples(samples: NDArray[np.int64]) -> FloatArray:
        requested.extend(samples)
        return errors[:, samples]

    found = finer.errors(points, of_samples)
    np.testing.assert_allclose(found, CubicSpline(t, errors, axis=1)(finer.time_s[points]), atol=1e-5)
    assert len(requested) < 120


@pytest.mark.parametrize("shared", [0.0, 0.02])
def test_a_way_back_within_a_limit_errs_by_the_error_over_the_slope(shared: float) -> None:
    # deviation 2 exp(-s / 15), which falls by 1/15 of it per mm: at 0.5 by 0.0333
    t = np.arange(0.0, 0.5, 2e-3)
    s = 200.0 * t
    trajectory = trajectory_of(t, np.column_stack([s, 2.0 * np.exp(-s / 15.0), 0 * t]))
    random, common = np.diag([0, 0, 0, 1.0, 1.0, 1.0]) * 0.003**2, np.zeros((6, 1))
    common[4] = shared
    law = StatedErrors(random, common, rounded=True)
    motion = motion_of(trajectory, law, trials=2000)

    def back(_: FloatArray, vectors: FloatArray) -> FloatArray:
        return formulas.stabilisation_length(vectors[..., 0], np.abs(vectors[..., 1]), 0.5)[..., None]

    stretch = Stretch(np.arange(len(t)), t, trajectory.poses, (np.array([0]),))
    reported = motion.read([stretch], Reading(back, lambda v: np.abs(v[..., 1]), 0.5, np.array([100.0]), origin=np.zeros(3)))
    assert reported.values[0, 0] == pytest.approx(15.0 * np.log(4.0), abs=1e-3)
    # the crossing lies between two samples, each rounded by itself, uniformly: half to all of the variance
    least, most = np.sqrt(0.5) * 1.645 * 0.003, 1.96 * 0.003
    per_mm = 15.0 / 0.5
    assert 0.9 * per_mm * np.hypot(least, 1.96 * shared) < reported.u95(0, np.mean) < 1.1 * per_mm * np.hypot(most, 1.96 * shared)


def test_whether_a_robot_leaves_the_band_again_is_told_as_well_as_it_is_known() -> None:
    """Of three cycles the largest excursion is 0.104 mm, the band 0.1 mm, an excursion known to 0.005 mm: OV may as well be zero."""
    rng = np.random.default_rng(7)
    base = np.array([[0.05], [0.104], [0.06]])
    reported = Reported(base, np.zeros((3, 1)), ((base, base + 0.005 * rng.normal(size=(4000, 3, 1))),))

    def largest(excursions: FloatArray, axis: int = -1) -> FloatArray:
        return formulas.overshoot(excursions, 0.1, axis)

    assert largest(reported.values[:, 0]) == 0.104
    assert reported.u95(0, largest, above=0.1) >= 0.1
    # nor when an entry that is missed now and then makes every cycle uncertain, and the two others do not leave the band
    grazed = np.where(rng.random((4000, 3, 1)) < 0.3, 0.0499, base)
    missed = Reported(base, np.zeros((3, 1)), ((base, grazed + 0.0001 * rng.normal(size=(4000, 3, 1))),))
    assert missed.u95(0, largest, above=0.1) >= 0.1
    # far from the band it is known like any distance
    far = Reported(base + 0.1, np.zeros((3, 1)), ((base + 0.1, base + 0.1 + 0.005 * rng.normal(size=(4000, 3, 1))),))
    assert far.u95(0, largest) == pytest.approx(1.96 * 0.005, rel=0.1)


def test_cycles_add_their_errors_and_what_splines_are_off() -> None:
    rng = np.random.default_rng(6)
    base, errors = np.array([[1.0], [1.0], [1.0]]), 0.1 * rng.normal(size=(20_000, 3, 1))
    alone = Reported(base, np.zeros((3, 1)), ((base, base + errors),))
    assert alone.u95(0, np.mean) == pytest.approx(1.96 * 0.1 / np.sqrt(3.0), rel=0.03)
    both = Reported(base, np.full((3, 1), 0.3), ((base, base + errors), (base, base + 2.0 * errors)))
    assert both.u95(0, np.mean) == pytest.approx(np.hypot(1.96 * 0.2 / np.sqrt(3.0), 0.3), rel=0.03)
