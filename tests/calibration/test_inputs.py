"""What a calibration folder may hold beside one exact pose per reading: a tracker's covariances, dwells, and visits that come again."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.calibration import CalibrationSettings, Model, calibrate, mean_variance, pooled_scatter, read_campaign, unknowns_of
from lmeasure.calibration.campaign.dwells import noise_of, rounding_left
from lmeasure.calibration.solve.noise import Noise
from lmeasure.core import CalibrationError, FileFormatError, FloatArray
from lmeasure.io import write_table
from lmeasure.io.tables import read_table
from lmeasure.recording import read_poses
from lmeasure.sensors import counts_from_poses
from lmeasure.simulation import cell_rig, write_campaign
from lmeasure.simulation.instrument import simulate_campaign

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])


def folder_of(path: Path, count: int = 12, **given: Any) -> Path:
    made = simulate_campaign(
        cell_rig(3), count, np.random.default_rng(4), centre=HOME, half_mm=(300, 300, 300), tilt_rad=0.3, nominal_shift_mm=5.0, **given
    )
    write_campaign(path, made)
    if not given:
        # nothing is said of how exact the poses are: the tests say it in ways of their own
        edit(path / "reference_poses.csv", lambda c: {k: v for k, v in c.items() if not k.startswith("u_")})
    return path


def edit(path: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    table = read_table(path)
    columns: dict[str, Any] = {c: list(table.text(c)) if c == "pose" else table.numbers(c) for c in table.columns}
    write_table(path, change(columns))


def covariance_of(folder: Path) -> tuple[FloatArray, Model]:
    campaign = read_campaign(folder)
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    return model.with_noise(Noise.of(campaign.poses).bare()).covariance(model.start), model


AXES = {"u_x_mm": 0.02, "u_y_mm": 0.02, "u_z_mm": 0.02, "u_rx_deg": 0.01, "u_ry_deg": 0.01, "u_rz_deg": 0.01}


def test_equal_axes_are_the_same_as_one_uncertainty(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    edit(folder / "reference_poses.csv", lambda c: c | {k: np.full(12, v) for k, v in AXES.items()})
    by_axes, _ = covariance_of(folder)
    edit(
        folder / "reference_poses.csv",
        lambda c: {k: v for k, v in c.items() if k not in AXES} | {"u_position_mm": np.full(12, 0.02), "u_rotation_deg": np.full(12, 0.01)},
    )
    assert by_axes == pytest.approx(covariance_of(folder)[0], rel=1e-9)


def test_a_tracker_s_covariance_is_that_of_drawn_poses(tmp_path: Path) -> None:
    """Along its beam a tracker measures well, across it badly: rows with a correlation, against draws through the exact model."""
    folder = folder_of(tmp_path)
    stated = {"u_x_mm": 0.01, "u_y_mm": 0.06, "u_z_mm": 0.05, "u_rx_deg": 0.005, "u_ry_deg": 0.01, "u_rz_deg": 0.02}
    correlations = {"rho_x_y": -0.8, "rho_z_rx": 0.5}
    edit(folder / "reference_poses.csv", lambda c: c | {k: np.full(12, v) for k, v in (stated | correlations).items()})
    V, model = covariance_of(folder)
    campaign = model.campaign
    C = campaign.poses.covariance
    assert C is not None
    assert C[0, 3, 4] == pytest.approx(-0.8 * 0.01 * 0.06)
    assert C[0, 0, 5] == pytest.approx(0.5 * np.radians(0.005) * 0.05)
    rng, base, drawn = np.random.default_rng(0), model.residuals(model.parameters.nominal), []
    for _ in range(600):
        error = np.array([rng.multivariate_normal(np.zeros(6), c) for c in C])
        rows = campaign.poses.rows.copy()
        rows[:, :3] += error[:, 3:]
        rows[:, 3:] = (Rotation.from_rotvec(error[:, :3]) * Rotation.from_quat(rows[:, 3:])).as_quat()
        other = Model(replace(campaign, poses=replace(campaign.poses, rows=rows)), model.parameters)
        drawn.append(other.residuals(model.parameters.nominal) - base)
    counts = 0.012**2 / 12
    ratio = np.var(drawn, axis=0) / (np.diag(V) - counts)
    # a variance of 600 draws is known to 6 %, the mean of all to less
    assert ratio == pytest.approx(1.0, abs=0.25)
    assert ratio.mean() == pytest.approx(1.0, abs=0.04)
    assert read_poses(folder / "reference_poses.csv", "puma-oat").u_position_mm[0] == pytest.approx(np.sqrt((1 + 36 + 25) / 3) * 0.01)


@pytest.mark.parametrize(
    ("columns", "text"),
    [
        ({"u_x_mm": 0.1}, "column 'u_y_mm' is missing, but 'u_x_mm' is present"),
        (AXES | {"u_position_mm": 0.1}, "has 'u_x_mm' and 'u_position_mm'. State"),
        (AXES | {"u_rx_deg": -0.1}, "column 'u_rx_deg': a standard uncertainty is negative"),
        (AXES | {"rho_x_y": 1.5}, ":2: no six quantities can have these correlations"),
        (AXES | {"rho_x_x": 0.5}, "column 'rho_x_x': a correlation is named by two of rx, ry, rz, x, y, z"),
        ({"u_repeatability_mm": -1.0}, "column 'u_repeatability_mm': a standard uncertainty is negative"),
        ({"temperature_c": 500.0}, "column 'temperature_c' = 500 is no temperature"),
    ],
)
def test_columns_that_cannot_be(tmp_path: Path, columns: dict[str, float], text: str) -> None:
    folder = folder_of(tmp_path)
    edit(folder / "reference_poses.csv", lambda c: c | {k: np.full(12, v) for k, v in columns.items()})
    with pytest.raises(FileFormatError, match=text) as error:
        read_campaign(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.2, 0.3, 0.5, 1.5])
@pytest.mark.parametrize("n", [1, 5, 50])
def test_variance_of_a_dwell_s_mean_is_that_of_rounded_readings(sigma: float, n: int) -> None:
    """Means of rounded noisy readings of values anywhere between two counts."""
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 1, 20_000)
    readings = np.rint(x[:, None] + sigma * rng.normal(size=(len(x), n)))
    met = float(np.mean((readings.mean(axis=1) - x) ** 2))
    if n == 1:
        assert met == pytest.approx(sigma**2 + 1 / 12, rel=0.05)
        return
    scatter = pooled_scatter(list(readings))
    assert noise_of(scatter) == pytest.approx(sigma, abs=0.01)
    assert mean_variance(scatter, n) == pytest.approx(met, rel=0.06)


def test_a_still_counter_gains_nothing_from_being_read_often() -> None:
    assert rounding_left(0.0) == pytest.approx(1 / 12)
    assert mean_variance(0.0, 1) == mean_variance(0.0, 1000) == pytest.approx(1 / 12)


def dwell(folder: Path, sigma: float, n: int) -> None:
    """Each reading n times, with noise before it is rounded."""
    rng = np.random.default_rng(2)
    made = simulate_campaign(cell_rig(3), 12, np.random.default_rng(4), centre=HOME, half_mm=(300,) * 3, tilt_rad=0.3, nominal_shift_mm=5.0)
    true = counts_from_poses(made.true, made.poses, made.poses[0])
    readings = np.rint(np.repeat(true, n, axis=0) + sigma * rng.normal(size=(12 * n, 6)))
    names = [name for name in made.measured.names for _ in range(n)]
    write_table(folder / "counts.csv", {"pose": names} | {c: readings[:, j] for j, c in enumerate(made.channels)})


def test_dwells_that_move_are_worth_more_and_still_ones_are_not(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    one, _ = covariance_of(folder)
    dwell(folder, 0.0, 20)
    still, _ = covariance_of(folder)
    assert still == pytest.approx(one, rel=1e-9)
    dwell(folder, 0.6, 100)
    moving, model = covariance_of(folder)
    assert np.diag(moving).max() < 0.2 * np.diag(one).min()
    found = calibrate(model.campaign, CalibrationSettings()).record
    assert found.noise["residual_rms_mm"] < 0.0015
    assert 0.3 < found.noise["chi_squared"] / found.noise["degrees_of_freedom"] < 2.0


def test_a_pose_visited_again_shares_its_error(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, u_position_mm=0.05)
    edit(folder / "counts.csv", lambda c: {k: [*v, v[0], v[3]] if k == "pose" else np.r_[v, v[0], v[3]] for k, v in c.items()})
    V, model = covariance_of(folder)
    campaign = model.campaign
    assert campaign.poses.names[-2:] == ("1 (visit 2)", "4 (visit 2)")
    assert len(campaign.poses) == 14
    # the zero pose seen again: its place is that of the zero, and the error of its place drops out
    back = model.pose_index == 12
    # but for the reading, and where within a count the counter was zeroed
    assert np.diag(V)[back] == pytest.approx(2 * 0.012**2 / 12)
    first, again = (np.flatnonzero((model.pose_index == i) & (model.cable_index == 0))[0] for i in (3, 13))
    assert V[first, again] == pytest.approx(V[first, first] - 0.012**2 / 12)
    assert any("later visit(s)" in w.text for w in calibrate(campaign, CalibrationSettings()).record.warnings)
    # with the robot's repeatability each visit has an error of its own
    edit(folder / "reference_poses.csv", lambda c: c | {"u_repeatability_mm": np.full(12, 0.02), "u_repeatability_deg": np.zeros(12)})
    V, model = covariance_of(folder)
    assert np.diag(V)[back] == pytest.approx(2 * 0.012**2 / 12 + 2 * 0.02**2, rel=0.05)
    assert not any(
        "no u_repeatability_mm is stated, so the robot's repeatability is NOT in the uncertainty" in n for n in model.campaign.notes
    )


def test_a_channel_that_never_counts_is_refused_unless_its_cable_may_have_kept_its_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All counts zero: an encoder that is not connected, or a braked winch. The rig says so, or its geometry does."""
    folder = folder_of(tmp_path)
    edit(folder / "counts.csv", lambda c: c | {"ch1": np.zeros(12)})
    with pytest.raises(CalibrationError, match="channel ch1 does not move: all its counts are zero, but the cable of the nominal rig"):
        read_campaign(folder)
    rig = (folder / "rig.toml").read_text(encoding="utf-8")
    (folder / "rig.toml").write_text(rig.replace("count_sign = 1\n", "count_sign = 1\nbraked = true\n"), encoding="utf-8")
    note = "channel ch1: all counts are zero, so its cable counts as unchanged in length. Check the encoder"
    assert note in read_campaign(folder).notes
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    monkeypatch.setattr("lmeasure.calibration.campaign.files.STILL_PART", 2.0)
    assert note in read_campaign(folder).notes
