"""Velocity, acceleration and jerk: exact for cubics, and as uncertain as they say."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cells import cell, motion, position_error, record
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, TrajectoryError
from lmeasure.kernels import local_cubics
from lmeasure.trajectory import motion_of, read_trajectory, reconstruct, write_motion


def turned(time_s: FloatArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R(t) = Exp(a t + b t^2), and its angular velocity in base axes by central differences of the rotation itself."""

    def at(t: FloatArray) -> Rotation:
        return Rotation.from_rotvec(np.outer(t, a) + np.outer(t**2, b))

    h = 1e-5
    return at(time_s).as_quat(), (at(time_s + h) * at(time_s - h).inv()).as_rotvec() / (2 * h)


def test_derivatives_of_a_cubic_and_of_a_turn() -> None:
    generator = np.random.default_rng(0)
    t = np.sort(generator.uniform(0.0, 1.0, 3000))
    coefficients = generator.normal(size=(4, 3)) * 100
    powers = np.vander(t, 4, increasing=True)
    quaternions, spin = turned(t, np.array([0.4, -0.8, 0.5]), np.array([0.9, 0.3, -0.6]))
    smooth, derivatives, _ = local_cubics(t, np.column_stack([powers @ coefficients, quaternions]), 0.02)
    middle = slice(100, -100)
    np.testing.assert_allclose(smooth[middle, :3], (powers @ coefficients)[middle], atol=1e-9)
    assert (Rotation.from_quat(smooth[middle, 3:]) * Rotation.from_quat(quaternions[middle]).inv()).magnitude().max() < 1e-9
    for order in (1, 2, 3):
        c = np.zeros((4, 3))
        for k in range(order, 4):
            c[k - order] = coefficients[k] * np.prod(np.arange(k - order + 1, k + 1))
        np.testing.assert_allclose(derivatives[middle, order - 1, 3:], (powers @ c)[middle], atol=1e-3 * 10 ** (order - 1), rtol=1e-5)
    np.testing.assert_allclose(derivatives[middle, 0, :3], spin[middle], atol=1e-5)
    # angular acceleration and jerk against differences of the angular velocity on a finer grid
    fine = np.arange(0.05, 0.95, 0.001)
    _, w = turned(fine, np.array([0.4, -0.8, 0.5]), np.array([0.9, 0.3, -0.6]))
    first = np.gradient(w, fine, axis=0)
    second = np.gradient(first, fine, axis=0)
    for axis in range(3):
        found = np.interp(fine[5:-5], t, derivatives[:, 1, axis])
        np.testing.assert_allclose(found, first[5:-5, axis], atol=1e-3)
        found = np.interp(fine[5:-5], t, derivatives[:, 2, axis])
        np.testing.assert_allclose(found, second[5:-5, axis], atol=2e-2)


def test_smoothing_beats_the_quantum_and_errors_are_as_stated() -> None:
    times, truth = motion(3000)
    raw = reconstruct(record(cell(), times, truth))
    smooth = motion_of(raw)
    errors = position_error(smooth.poses, truth)
    assert np.sqrt(np.mean(errors**2)) < 0.003
    assert np.sqrt(np.mean(errors**2)) < 0.4 * np.sqrt(np.mean(position_error(raw.poses, truth) ** 2))
    assert np.mean(errors**2) == pytest.approx(np.mean((smooth.u_pose[:, 3:] ** 2).sum(axis=1)), rel=0.3)
    w = 2.0 * np.pi * np.array([0.31, 0.43, 0.37])
    velocity = 200.0 * w * np.cos(np.outer(times, w)) * [1.0, -0.8, 0.6]
    acceleration = -200.0 * w**2 * np.sin(np.outer(times, w)) * [1.0, -0.8, 0.6]
    for found, true, u in ((smooth.velocity, velocity, smooth.u_velocity), (smooth.acceleration, acceleration, smooth.u_acceleration)):
        # of a normal error the median square is 0.455 of the mean; counts of a cable that turns back may look like vibration
        ratio = np.median((found[:, 3:] - true) ** 2) / (0.455 * np.median(u[:, 3:] ** 2))
        assert 0.5 < ratio < 1.6
    np.testing.assert_allclose(smooth.speed_mm_s, np.linalg.norm(velocity, axis=1), atol=1.0)
    length = np.linalg.norm(np.diff(truth[:, :3], axis=0), axis=1).sum()
    assert smooth.path_mm[-1] == pytest.approx(length, abs=0.05)


def test_gaps_stay_gaps_and_short_pieces_say_nothing() -> None:
    times, truth = motion(200)
    truth[50:100] = np.nan
    truth[105:] = np.nan
    smooth, derivatives, factors = local_cubics(times, truth, 0.02)
    known = ~np.isnan(smooth[:, 0])
    assert known[:50].all()
    assert not known[50:].any()
    for values in (derivatives[:, 0, 0], factors[:, 0]):
        np.testing.assert_array_equal(~np.isnan(values), known)
    # at the end the window has one side only
    assert factors[49, 0] > 1.5 * factors[25, 0]


def test_what_cannot_be_fitted_is_refused(tmp_path: Path) -> None:
    trajectory = reconstruct(record(cell(), *motion(40)))
    with pytest.raises(TrajectoryError, match="no window"):
        motion_of(trajectory, 0.001)
    with pytest.raises(TrajectoryError, match=r"a window of \+-100 s reaches farther to either side than the trajectory lasts, "):
        motion_of(trajectory, 100.0)
    with pytest.raises(TrajectoryError, match="not positive"):
        motion_of(trajectory, 0.0)
    write_motion(tmp_path / "m.csv", motion_of(trajectory))
    table = pd.read_csv(tmp_path / "m.csv")
    assert {"speed_mm_s", "path_mm", "vx_mm_s", "u_vx_mm_s", "wz_rad_s", "ax_mm_s2", "jx_mm_s3", "u_betaz_rad_s3"} <= set(table.columns)


def shaken(path: Path, rate_hz: float, swings: list[tuple[int, float, float]], u_mm: float = 0.003) -> tuple[FloatArray, FloatArray]:
    """Write a table of a tool that moves slowly and swings along axes by (axis, Hz, mm/s); its true velocity and acceleration (n, 3)."""
    rng, t = np.random.default_rng(3), np.arange(round(4.0 * rate_hz)) / rate_hz
    w = 2.0 * np.pi * np.array([0.31, 0.43, 0.37])
    place = 60.0 * np.sin(np.outer(t, w))
    velocity, acceleration = 60.0 * w * np.cos(np.outer(t, w)), -60.0 * w**2 * np.sin(np.outer(t, w))
    for axis, hz, speed in swings:
        turned, phase = 2.0 * np.pi * hz, rng.uniform(0.0, 2.0 * np.pi)
        place[:, axis] += speed / turned * np.sin(turned * t + phase)
        velocity[:, axis] += speed * np.cos(turned * t + phase)
        acceleration[:, axis] -= speed * turned * np.sin(turned * t + phase)
    table = np.column_stack([t, place + u_mm * rng.normal(size=place.shape), np.full((len(t), 3), u_mm)])
    pd.DataFrame(table, columns=["time_s", "x_mm", "y_mm", "z_mm", "u_x_mm", "u_y_mm", "u_z_mm"]).to_csv(path, index=False)
    return velocity, acceleration


@pytest.mark.parametrize(("rate_hz", "hz"), [(1000.0, 5.0), (1000.0, 18.8), (1000.0, 50.0), (1000.0, 100.0), (200.0, 18.8), (200.0, 70.0)])
def test_velocities_of_a_vibrating_tool_are_as_uncertain_as_stated(tmp_path: Path, rate_hz: float, hz: float) -> None:
    velocity, acceleration = shaken(tmp_path / "t.csv", rate_hz, [(0, hz, 8.0), (1, hz, 3.0), (2, hz, 5.0)])
    found = motion_of(read_trajectory(tmp_path / "t.csv"))
    for values, true, u in ((found.velocity, velocity, found.u_velocity), (found.acceleration, acceleration, found.u_acceleration)):
        assert np.mean(np.abs(values[:, 3:] - true) <= 2.0 * u[:, 3:]) >= 0.93
    assert found.highest_hz == pytest.approx(0.35 * rate_hz)


def test_frequencies_and_amplitudes_of_vibration(tmp_path: Path) -> None:
    shaken(tmp_path / "t.csv", 1000.0, [(0, 18.8, 8.0), (1, 25.0, 1.0)])
    found = motion_of(read_trajectory(tmp_path / "t.csv")).vibration
    assert [v.axis for v in found] == ["x", "y"]
    for v, hz, speed in zip(found, (18.8, 25.0), (8.0, 1.0), strict=True):
        assert abs(v.frequency_hz - hz) <= 1.5 * v.u95_frequency_hz < 0.05
        assert abs(v.amplitude_mm - speed / (2.0 * np.pi * hz)) <= 1.5 * v.u95_amplitude_mm < 0.1 * v.amplitude_mm
        assert v.speed_mm_s == pytest.approx(speed, rel=0.05)
    # a tool that moves without vibration has none, and uncertainties of noise alone
    shaken(tmp_path / "t.csv", 1000.0, [])
    still = motion_of(read_trajectory(tmp_path / "t.csv"))
    assert still.vibration == ()
    assert still.half_width_s == 0.02
    _, _, factors = local_cubics(still.time_s, still.poses, 0.02)
    np.testing.assert_allclose(np.median(still.u_velocity[:, 3:]), 0.003 * np.median(factors[:, 1]), rtol=1e-3)
