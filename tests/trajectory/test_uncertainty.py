"""The stated covariances against what real reconstructions scatter by, counts redrawn and the rig drawn from its calibration."""

import numpy as np
import pytest
from cells import START, FloatArray, cell, motion, record
from scipy.spatial.transform import Rotation

from lmeasure.core import TrajectoryError
from lmeasure.kernels import PARAMETERS
from lmeasure.recording import Counts, Run
from lmeasure.rig import CalibrationRecord, Rig, parameter_names, rig_from_dict
from lmeasure.sensors import lengths_from_counts
from lmeasure.trajectory import RunModel, reconstruct, reconstruction_of
from lmeasure.trajectory.reconstruction.screw_method import by_monte_carlo, moved_rows

TRIALS = 600
SAMPLES = (0, 700, 1500, 2999)
# a standard deviation of 600 draws is known to 1/sqrt(1200) = 2.9 %: four times that
TOLERANCE = 0.12


def deviations(poses: FloatArray, truth: FloatArray) -> FloatArray:
    """(..., 6) errors found less true, (tool origin [mm]; rotation vector in base axes [rad])."""
    turn = Rotation.from_quat(poses[..., 3:]) * Rotation.from_quat(np.broadcast_to(truth, poses.shape)[..., 3:]).inv()
    return np.concatenate([poses[..., :3] - truth[..., :3], turn.as_rotvec()], axis=-1)


def samples_of(n: int = 3000) -> tuple[FloatArray, FloatArray]:
    times, poses = motion(n)
    return times[list(SAMPLES)], poses[list(SAMPLES)]


def repeated(rig: Rig, counts: FloatArray) -> FloatArray:
    """Poses (trials, samples, 7) of counts (trials, samples, cables) of runs from one start, gone through as one run: all trials of a
    sample before those of the next."""
    trials, samples, _ = counts.shape
    inline = np.swapaxes(counts, 0, 1).reshape(trials * samples, -1)
    run = Run(
        rig, START, (Counts(np.arange(len(inline), dtype=np.float64), tuple(c.channel for c in rig.cable), inline),), unstated="exact"
    )
    return np.swapaxes(reconstruct(run).poses.reshape(samples, trials, 7), 0, 1)


def test_the_counts_resolution_is_what_repeated_runs_scatter_by() -> None:
    """Rounding of a count at an unknown place within its step: a uniform error of half a count."""
    rig = cell(None)
    times, poses = samples_of()
    exact = record(rig, times, poses, exact=True)
    stated = reconstruct(exact)
    counts = exact.passes[0].recorded
    noise = np.random.default_rng(1).uniform(-0.5, 0.5, (TRIALS, *counts.shape))
    found = deviations(repeated(rig, counts + noise), poses)
    scatter = np.std(found, axis=0)
    np.testing.assert_allclose(scatter, stated.u, rtol=TOLERANCE)
    covariance = np.array([np.cov(found[:, i].T) for i in range(len(SAMPLES))])
    order = [3, 4, 5, 0, 1, 2]
    for i in range(len(SAMPLES)):
        u = stated.u[i]
        correlation = stated.random[i][np.ix_(order, order)] / np.outer(u, u)
        np.testing.assert_allclose(covariance[i] / np.outer(u, u), correlation, atol=3 * TOLERANCE)


CALIBRATED = {
    "x_mm": 0.05, "y_mm": 0.04, "z_mm": 0.06, "guide_alpha_deg": 0.02, "guide_beta_deg": 0.03, "pulley_radius_mm": 0.01,
    "tangent_length_mm": 0.5, "axial_offset_mm": 0.3,
}  # fmt: skip


def _value(rig: Rig, name: str, key: str) -> float:
    point = rig.point(name)
    holder = point if hasattr(point, key) else point.drum
    return point.position_mm["xyz".index(key[0])] if key in ("x_mm", "y_mm", "z_mm") else float(getattr(holder, key))


def calibrated() -> tuple[Rig, CalibrationRecord]:
    """A rig with a record whose parameters are correlated within each point."""
    rig = cell(None)
    generator = np.random.default_rng(7)
    names = [f"{point.name}.{key}" for point in rig.observation_point for key in CALIBRATED]
    u = np.array(list(CALIBRATED.values()) * len(rig.observation_point))
    k = len(CALIBRATED)
    covariance = np.zeros((len(names), len(names)))
    for i in range(0, len(names), k):
        factor = np.linalg.qr(generator.normal(size=(k, k)))[0] * generator.uniform(0.3, 1.0, k)
        correlation = factor @ factor.T
        d = np.sqrt(np.diag(correlation))
        covariance[i : i + k, i : i + k] = correlation / np.outer(d, d) * np.outer(u[i : i + k], u[i : i + k])
    values = [_value(rig, *name.rsplit(".", 1)) for name in names]
    parameters = [{"name": n, "value": v, "u": float(s), "prior_u": 1.0} for n, v, s in zip(names, values, u, strict=True)]
    record_ = CalibrationRecord.model_validate(
        {
            "schema": "lmeasure.calibration/1", "rig": rig.name, "parameters": parameters, "covariance": covariance.tolist(),
            "residuals": [], "equations": 0, "unknowns": len(names), "rank": len(names),
        }
    )  # fmt: skip
    return rig, record_


def drawn(rig: Rig, record_: CalibrationRecord, shift: FloatArray) -> Rig:
    """The rig with its calibrated values moved by the shifts, one per parameter of the record."""
    data = rig.to_dict()
    points = {p["name"]: p for p in data["observation_point"]}
    for parameter, delta in zip(record_.parameters, shift, strict=True):
        name, key = parameter.name.split(".")
        point = points[name]
        if key in ("x_mm", "y_mm", "z_mm"):
            point["position_mm"]["xyz".index(key[0])] += delta
        elif key in point:
            point[key] += delta
        else:
            point["drum"][key] += delta
    return rig_from_dict(data)


def test_the_calibration_covariance_is_what_true_rigs_drawn_from_it_scatter_by() -> None:
    rig, record_ = calibrated()
    times, poses = samples_of()
    stated = reconstruct(Run(rig, START, record(rig, times, poses, exact=True).passes, record_, unstated="exact"))
    assert "calibration" in stated.covers
    generator = np.random.default_rng(3)
    shifts = generator.multivariate_normal(np.zeros(len(record_.parameters)), record_.covariance_matrix(), TRIALS, method="cholesky")
    counts = np.array([record(drawn(rig, record_, shift), times, poses, exact=True).passes[0].recorded for shift in shifts])
    scatter = np.std(deviations(repeated(rig, counts), poses), axis=0)
    u = np.sqrt(np.einsum("nii->ni", stated.systematic))[:, [3, 4, 5, 0, 1, 2]]
    # at the start pose the counters were zeroed there: a wrong rig does not show
    assert scatter[0].max() < 1e-9
    assert u[0].max() < 1e-9
    np.testing.assert_allclose(scatter[1:], u[1:], rtol=TOLERANCE)


def test_monte_carlo_and_the_linear_law_agree() -> None:
    """JCGM 101 against JCGM 100, each kind of error by itself: standard uncertainties and correlations."""
    rig, record_ = calibrated()
    times, poses = samples_of()
    run = Run(rig, START, record(rig, times, poses).passes, record_, unstated="exact")
    reconstruction = reconstruction_of(RunModel(rig, START, record_))
    lengths = lengths_from_counts(run)
    linear = reconstruction.trajectory(lengths)
    determined: list[int] = []
    found = by_monte_carlo(reconstruction, lengths, linear, TRIALS, seed=5, progress=lambda done, of: determined.append(of - done))
    assert determined == list(range(2 * TRIALS - 1, -1, -1))
    assert "Monte Carlo" in found.covers
    np.testing.assert_array_equal(found.poses, linear.poses)
    for name in ("random", "systematic"):
        a, b = getattr(found, name)[1:], getattr(linear, name)[1:]
        u = np.sqrt(np.einsum("nii->ni", b))
        np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", a)), u, rtol=TOLERANCE)
        outer = u[:, :, None] * u[:, None, :]
        np.testing.assert_allclose(a / outer, b / outer, atol=3 * TOLERANCE)


def test_too_few_trials_are_refused() -> None:
    rig = cell()
    run = record(rig, *motion(3))
    reconstruction = reconstruction_of(RunModel(rig, START))
    lengths = lengths_from_counts(run)
    with pytest.raises(TrajectoryError, match="1 trials"):
        by_monte_carlo(reconstruction, lengths, reconstruction.trajectory(lengths), 1)


def test_moved_rows_are_those_of_the_moved_rig() -> None:
    rig, record_ = calibrated()
    shift = np.random.default_rng(0).normal(size=len(record_.parameters)) * 0.1
    names = [p.name for p in record_.parameters]
    by_cable = np.zeros((6, len(PARAMETERS)))
    for j, own in enumerate(parameter_names(rig)):
        for i, name in enumerate(own):
            if name in names:
                by_cable[j, i] = shift[names.index(name)] * (np.radians(1.0) if name.endswith("_deg") else 1.0)
    np.testing.assert_allclose(moved_rows(rig.cable_rows(), by_cable), drawn(rig, record_, shift).cable_rows(), rtol=1e-13, atol=1e-13)
