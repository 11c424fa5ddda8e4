"""The budget of a run: what samples share and what they do not, against what real reconstructions scatter by."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from cells import START, FloatArray, cell, motion, record
from scipy.spatial.transform import Rotation
from test_uncertainty import SAMPLES, calibrated, deviations, drawn, repeated, samples_of

from lmeasure import covariances
from lmeasure.accuracy.zone import covariance_factor
from lmeasure.core import FileFormatError, TrajectoryError
from lmeasure.recording import Run, read_run, write_run
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import counts_from_poses, lengths_from_counts
from lmeasure.trajectory import Budget, RunModel, read_trajectory, reconstruct, reconstruction_of, write_trajectory
from lmeasure.trajectory.reconstruction.screw_method import by_monte_carlo
from lmeasure.trajectory.uncertainty.sources import PassClock

TRIALS = 200  # a standard deviation of as many draws is known to 5 %
RUNS = 100  # 7 %
U_START = (0.3, 0.001)
AS_FILE = [3, 4, 5, 0, 1, 2]


def off(start: FloatArray, generator: np.random.Generator, u: tuple[float, float] = U_START) -> FloatArray:
    """A true start whose stated place is `start`."""
    turned = Rotation.from_rotvec(generator.normal(0.0, u[1], 3)) * Rotation.from_quat(start[3:])
    return np.r_[start[:3] + generator.normal(0.0, u[0], 3), turned.as_quat()]


def test_factors_are_what_whole_runs_err_by_together() -> None:
    """True rigs and true starts drawn: covariances within a sample and between samples of one run."""
    rig, record_ = calibrated()
    times, poses = samples_of()
    run = Run(rig, START, record(rig, times, poses, exact=True).passes, record_, U_START, unstated="exact")
    stated = reconstruct(run)
    assert stated.covers == "counts of half a unit, the start pose and the linked calibration"
    budget = covariances(stated, run)
    generator = np.random.default_rng(3)
    shifts = generator.multivariate_normal(np.zeros(len(record_.parameters)), record_.covariance_matrix(), RUNS, method="cholesky")
    counts = [record(drawn(rig, record_, s), times, poses, start=off(START, generator), exact=True).passes[0].recorded for s in shifts]
    found = deviations(repeated(rig, np.array(counts)), poses)[..., AS_FILE]
    scatter = np.cov(found.reshape(RUNS, -1).T)
    stacked = budget.factors.reshape(6 * len(SAMPLES), -1)
    expected = stacked @ stacked.T
    u = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(np.sqrt(np.diag(scatter)), u, rtol=0.24)
    np.testing.assert_allclose(scatter / np.outer(u, u), expected / np.outer(u, u), atol=0.4)
    # the errors of one run move together: that is what makes them systematic
    assert np.abs((expected / np.outer(u, u))[:6, 6:]).max() > 0.5
    np.testing.assert_allclose(budget.systematic, stated.systematic, rtol=1e-9, atol=1e-16)
    np.testing.assert_allclose(budget.random, stated.random, rtol=1e-12)


def test_at_the_start_the_pose_is_as_uncertain_as_was_stated() -> None:
    rig = cell()
    run = replace(record(rig, *motion(3)), u_start=U_START)
    found = reconstruct(run)
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", found.systematic))[0], np.repeat(U_START[::-1], 3), rtol=1e-9)
    assert found.covers == "counts of half a unit and the start pose: the rig has no linked calibration"
    assert set(covariances(found, run).sources) == {"start pose"}


def test_monte_carlo_draws_the_start_too() -> None:
    rig = cell(None)
    run = replace(record(rig, *samples_of()), u_start=U_START)
    reconstruction = reconstruction_of(RunModel(rig, START, u_start=U_START))
    lengths = lengths_from_counts(run)
    linear = reconstruction.trajectory(lengths)
    found = by_monte_carlo(reconstruction, lengths, linear, TRIALS, seed=1)
    u = np.sqrt(np.einsum("nii->ni", linear.systematic))
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", found.systematic)), u, rtol=0.17)


def two_passes() -> tuple[Rig, Run]:
    data = cell(None).to_dict()
    for number, cable in enumerate(data["cable"]):
        cable["pass"] = 1 + number % 2
    rig = cell(None, cable=data["cable"])
    return rig, record(rig, *motion(1500))


def test_passes_have_sources_of_their_own() -> None:
    _, run = two_passes()
    found = reconstruct(run, repeatability_mm=0.05)
    budget = covariances(found, run, slice(100, 200), repeatability_mm=0.05)
    assert budget.sources == ("position of pass 1",) * 3 + ("position of pass 2",) * 3
    np.testing.assert_allclose(budget.systematic, found.systematic[100:200], rtol=1e-9)
    # both passes displaced alike displace the pose alike, whatever the rig
    np.testing.assert_allclose(
        budget.factors[:, :, :3] + budget.factors[:, :, 3:], np.tile(0.05 * np.eye(6)[:, 3:], (100, 1, 1)), atol=1e-12
    )


def test_monte_carlo_and_the_linear_law_agree_on_passes() -> None:
    rig, run = two_passes()
    times = run.passes[0].time_s
    chosen = [0, 700, 1499]
    few = Run(rig, START, tuple(replace(p, time_s=times[chosen], recorded=p.recorded[chosen]) for p in run.passes), unstated="exact")
    reconstruction = reconstruction_of(RunModel(rig, START, clocks=(PassClock(), PassClock(0.001)), repeatability_mm=0.05))
    lengths = lengths_from_counts(few)
    linear = reconstruction.trajectory(lengths)
    found = by_monte_carlo(reconstruction, lengths, linear, TRIALS, seed=2)
    u = np.sqrt(np.einsum("nii->ni", linear.systematic))
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", found.systematic)), u, rtol=0.17)


def test_a_point_is_as_uncertain_as_start_and_arm_make_it() -> None:
    """Three cables to one point: a turned start displaces the point by its arm."""
    data = cell().to_dict()
    rig = cell(cable=[dict(c, to="P1") for c in data["cable"][:3]])
    run = replace(record(rig, *motion(4)), u_start=U_START)
    found = reconstruct(run)
    budget = covariances(found, run)
    arm = np.array(rig.tool["P1"])
    across = np.array([[0.0, arm[2], -arm[1]], [-arm[2], 0.0, arm[0]], [arm[1], -arm[0], 0.0]])
    expected = U_START[0] ** 2 * np.eye(3) + U_START[1] ** 2 * across @ across.T
    np.testing.assert_allclose(budget.systematic[0, 3:, 3:], expected, rtol=1e-9, atol=1e-15)
    assert np.isnan(budget.systematic[:, :3]).all()
    np.testing.assert_allclose(budget.systematic, found.systematic, rtol=1e-9)


def test_what_a_constraint_holds_is_exact_in_the_start() -> None:
    rig = cell(constraint="planar")
    run = replace(record(rig, *motion(3, reach_mm=0.0, tilt_rad=0.0)), u_start=U_START)
    u = np.sqrt(np.einsum("nii->ni", reconstruct(run).systematic))[0]
    np.testing.assert_allclose(u[[2, 3, 4]], [U_START[1], U_START[0], U_START[0]], rtol=1e-9)
    np.testing.assert_array_equal(u[[0, 1, 5]], 0.0)


def test_a_trajectory_read_back_tells_the_same(tmp_path: Path) -> None:
    rig, record_ = calibrated()
    run = Run(rig, START, record(rig, *motion(50)).passes, record_, U_START, unstated="exact")
    write_run(tmp_path / "run", run)
    again = read_run(tmp_path / "run")
    assert again.u_start == pytest.approx(U_START, rel=1e-14)
    found = reconstruct(again)
    write_trajectory(tmp_path / "out.parquet", found)
    kept = read_trajectory(tmp_path / "out.parquet")
    np.testing.assert_allclose(np.einsum("nii->ni", kept.systematic), np.einsum("nii->ni", found.systematic), rtol=1e-12)
    np.testing.assert_allclose(np.einsum("nii->ni", kept.random), np.einsum("nii->ni", found.random), rtol=1e-6)
    a, b = covariances(kept, again), covariances(found, run)
    np.testing.assert_allclose(a.factors, b.factors, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(a.random, b.random)


def test_another_runs_trajectory_is_refused() -> None:
    rig = cell()
    run, other = record(rig, *motion(20)), record(rig, *motion(30))
    with pytest.raises(TrajectoryError, match="has 30 samples, the trajectory has 20 or at other times"):
        covariances(reconstruct(run), other)


@pytest.mark.parametrize("value", [-0.1, "wide", True, float("nan")])
def test_an_uncertainty_of_the_start_that_is_none_is_refused(tmp_path: Path, value: object) -> None:
    write_run(tmp_path, record(cell(), *motion(3)))
    text = (tmp_path / "run.toml").read_text()
    shown = str(value).lower() if not isinstance(value, str) else f'"{value}"'
    (tmp_path / "run.toml").write_text(text.replace("[start]", f"[start]\nu_position_mm = {shown}"))
    with pytest.raises(FileFormatError, match=r"run.toml:\d+: start.u_position_mm: "):
        read_run(tmp_path)


@pytest.mark.parametrize(
    ("column", "value", "determined"),
    [
        ("u_x_mm", -1.0, "row 2: u_x_mm = -1 is no standard uncertainty"),
        ("u_systematic_rz_rad", -0.5, "row 2: u_systematic_rz_rad = -0.5 is no standard uncertainty"),
        ("y_mm", 1e300, r"row 2: y_mm = 1e\+300 is beyond 1000000 mm"),
    ],
)
def test_a_trajectory_with_a_value_that_cannot_be_is_refused(column: str, value: float, determined: str, tmp_path: Path) -> None:
    write_trajectory(tmp_path / "t.parquet", reconstruct(record(cell(), *motion(5))))
    table = pa.parquet.read_table(tmp_path / "t.parquet")
    values = table[column].to_numpy().copy()
    values[2] = value
    pa.parquet.write_table(table.set_column(table.column_names.index(column), column, pa.array(values)), tmp_path / "t.parquet")
    with pytest.raises(FileFormatError, match=determined):
        read_trajectory(tmp_path / "t.parquet")


def recorded(parameters: dict[str, float], rig: Rig) -> CalibrationRecord:
    """A record of independent parameters with these standard uncertainties."""
    return CalibrationRecord.model_validate(
        {
            "rig": rig.name, "parameters": [{"name": name, "value": 0.0, "u": u, "prior_u": 1.0} for name, u in parameters.items()],
            "covariance": np.diag(np.square(list(parameters.values()))).tolist(), "residuals": [], "equations": 0,
            "unknowns": len(parameters), "rank": len(parameters),
        }
    )  # fmt: skip


def test_a_well_known_angle_stays_beside_a_wide_prior() -> None:
    """A thousandth of a degree, 1.7e-5 rad, is as much a source of error beside 0.3 m of another parameter as alone: no unit is small."""
    rig = cell(None)
    run = record(rig, *samples_of(), exact=True)
    angle, wide = {"B1.guide_beta_deg": 0.001}, {"B2.axial_offset_mm": 300.0}
    found = reconstruct(run)
    alone, other, both = (
        covariances(found, replace(run, calibration=recorded(parameters, rig))).factors for parameters in (angle, wide, angle | wide)
    )
    assert alone.shape[2] == other.shape[2] == 1
    assert np.abs(alone).max() > 1e-6
    expected = np.concatenate([alone, other], axis=2)
    order = np.argsort([np.abs(both[..., k]).max() for k in range(both.shape[2])])
    np.testing.assert_allclose(np.abs(both[..., order]), np.abs(expected), rtol=1e-9, atol=1e-12 * np.abs(alone).max())
    of_zone = covariance_factor(rig, recorded(angle | wide, rig))
    np.testing.assert_allclose(np.sqrt((of_zone**2).sum(axis=0)), np.sort([np.radians(0.001), 300.0]), rtol=1e-12)


def test_a_point_that_is_measured_itself_does_not_err_by_where_it_is_on_the_tool() -> None:
    """Cables to one point measure that point: a record's attachment point has no part in its place, whatever it has in the tool's."""
    body = cell()
    rig = cell(cable=[dict(c, to="P1") for c in body.to_dict()["cable"]])
    attachment, own = {"tool.P1.x_mm": 0.5, "tool.P1.z_mm": 0.5}, {"B1.x_mm": 0.05, "B4.pulley_radius_mm": 0.02}
    # correlated with what does have a part
    both = recorded(own | attachment, rig)
    tied = np.array(both.covariance)
    tied[[0, 2, 1, 3], [2, 0, 3, 1]] = 0.5 * np.repeat([0.05 * 0.5, 0.02 * 0.5], 2)
    both = both.model_copy(update={"covariance": tuple(map(tuple, tied.tolist()))})
    run = record(rig, *motion(40))
    alone, found = (covariances(reconstruct(r), r) for r in (replace(run, calibration=c) for c in (recorded(own, rig), both)))
    assert np.sqrt(np.einsum("nii->ni", alone.systematic[:, 3:, 3:])).max() > 1e-4
    np.testing.assert_allclose(found.systematic[:, 3:, 3:], alone.systematic[:, 3:, 3:], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(
        reconstruct(replace(run, calibration=both)).systematic[:, 3:, 3:], alone.systematic[:, 3:, 3:], rtol=1e-9, atol=1e-15
    )
    # in a pose it has
    run = record(body, *motion(40))
    without, with_it = (
        covariances(reconstruct(r), r) for r in (replace(run, calibration=recorded(c, body)) for c in (own, own | attachment))
    )
    assert with_it.systematic[-1].trace() > 1.1 * without.systematic[-1].trace()


def test_a_cable_that_was_left_out_moves_no_pose() -> None:
    """The twists of a pose by the lengths are those of the cables that were used."""
    body = cell().to_dict()
    pairs = [(c["from"], c["to"]) for c in body["cable"]] + [("B1", "P2"), ("B4", "P3")]
    eight = cell(cable=[{"name": f"c{i}", "channel": f"ch{i}", "from": a, "to": b} for i, (a, b) in enumerate(pairs)])
    seven = cell(cable=[{"name": f"c{i}", "channel": f"ch{i}", "from": a, "to": b} for i, (a, b) in enumerate(pairs) if i != 2])
    _, poses = motion(3)
    counts = counts_from_poses(eight, poses, START)
    twists = [
        Budget(RunModel(rig, START)).twists(poses, k, unused, True)
        for rig, k, unused in (
            (eight, counts, np.eye(8, dtype=np.bool_)[[2, 2, 3]] & [[True], [True], [False]]),
            (seven, np.delete(counts, 2, axis=1), None),
        )
    ]
    assert (twists[0][:2, :, 2] == 0.0).all()
    assert (twists[0][2, :, 2] != 0.0).any()
    np.testing.assert_allclose(np.delete(twists[0][:2], 2, axis=2), twists[1][:2], rtol=1e-9, atol=1e-15)
    counts[1, 5] = np.nan
    gap = Budget(RunModel(eight, START)).twists(poses, counts, None, True)
    assert (gap[1, :, 5] == 0.0).all()
