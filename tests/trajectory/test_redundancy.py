"""What redundant cables tell of each other, against generalised least squares written out, and against draws of what a run shares."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cells import TOOL, FloatArray, motion, record
from scipy.linalg import block_diag, null_space, sqrtm
from test_schemes import EIGHT, SEVEN, rig_of
from test_truth import AUTHORITY, truth_of

from lmeasure.kernels import span_lengths, span_rows_of
from lmeasure.recording import read_run
from lmeasure.rig import Rig
from lmeasure.sensors import changes_from_counts, lengths_from_counts
from lmeasure.trajectory import Budget, Epochs, Reconstruction, Redundancy, RunModel, reconstruction_of
from lmeasure.trajectory.faults.redundancy import chance_of, repeats

N = 40


def zeroed_anywhere(rig: Rig) -> Rig:
    """The same rig, its counters zeroed anywhere within a count and its drums uncertain."""
    points = [
        p.model_copy(update={"drum": p.drum.model_copy(update={"zero_exact": False, "u_count_length_mm": 1e-6, "u_axial_offset_mm": 0.2})})
        for p in rig.observation_point
    ]
    return rig.model_copy(update={"observation_point": tuple(points)})


def prepared(
    pairs: list[tuple[str, str]], seed: int = 0, **changes: Any
) -> tuple[Reconstruction, Redundancy, FloatArray, FloatArray, FloatArray]:
    """A redundant rig's reconstruction, poses (N, 7), errors of its lengths (N, m) as drawn, their covariance (N m, N m) and residuals."""
    rig = zeroed_anywhere(rig_of(pairs, **changes))
    times, poses = motion(N, rate_hz=20.0)
    reconstruction = reconstruction_of(RunModel(rig, poses[0], None))
    redundancy = Redundancy(reconstruction.budget)
    epochs = redundancy.epochs(lengths_from_counts(record(rig, times, poses, exact=True)), None)
    used = np.ones((N, len(pairs)), np.bool_)
    shared = redundancy.shared(epochs, poses, used)
    rng = np.random.default_rng(seed)
    own = np.sqrt(epochs.variance_mm2)
    errors = own * rng.standard_normal(own.shape) + shared @ rng.standard_normal(shared.shape[2])
    flat = shared.reshape(-1, shared.shape[2])
    return reconstruction, redundancy, poses, errors, flat @ flat.T + np.diag((own**2).ravel())


@pytest.mark.parametrize("pairs", [SEVEN, EIGHT])
def test_chi_squared_and_errors_are_those_of_generalised_least_squares(pairs: list[tuple[str, str]]) -> None:
    """Min over the pose of (r - A x)^T S^-1 (r - A x), and the estimate of one more unknown, an error of cable j."""
    reconstruction, redundancy, poses, errors, covariance = prepared(pairs)
    m = len(pairs)
    rig = reconstruction.model.rig
    epochs = redundancy.epochs(lengths_from_counts(record(rig, *motion(N, rate_hz=20.0), exact=True)), None)
    epochs.gone_on_mm[:] += errors
    parities = redundancy.parities(epochs, poses)
    rows = span_rows_of(rig.cable_rows(), poses)
    alone, u = parities.errors
    for i in range(0, N, 7):
        S = covariance.reshape(N, m, N, m)[i, :, i]
        r = redundancy.residuals(poses[i : i + 1], epochs.gone_on_mm[i : i + 1])[0]
        np.testing.assert_allclose(r, errors[i], atol=1e-6)

        def left(A: FloatArray, S: FloatArray = S, r: FloatArray = r) -> tuple[float, FloatArray, FloatArray]:
            normal = A.T @ np.linalg.solve(S, A)
            x = np.linalg.solve(normal, A.T @ np.linalg.solve(S, r))
            v = r - A @ x
            return float(v @ np.linalg.solve(S, v)), x, np.linalg.inv(normal)

        A = rows[i] * np.repeat([1.0 / 150.0, 1.0], 3)
        assert parities.chi_squared[i] == pytest.approx(left(A)[0], rel=1e-6)
        for j in range(m):
            chi, x, cov = left(np.column_stack([A, np.eye(m)[j]]))
            assert alone[i, j] == pytest.approx(x[-1], rel=1e-5, abs=1e-9)
            assert u[i, j] == pytest.approx(np.sqrt(cov[-1, -1]), rel=1e-5)
            assert parities.chi_squared[i] - (alone[i, j] / u[i, j]) ** 2 == pytest.approx(chi, abs=1e-6)


def test_together_epochs_are_one_draw_of_what_they_share() -> None:
    reconstruction, redundancy, poses, errors, covariance = prepared(EIGHT)
    m, few = 8, np.array([3, 11, 20, 33])
    epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
    epochs.gone_on_mm[:] += errors
    used = np.ones((len(few), m), np.bool_)
    used[:, 2] = False
    together, alone, freedom = redundancy.jointly(epochs.at(few), poses[few], used)
    assert freedom == 1
    rows = span_rows_of(reconstruction.model.rig.cable_rows(), poses[few]) * np.repeat([1.0 / 150.0, 1.0], 3)
    kept = np.flatnonzero(used.ravel())
    index = (few[:, None] * m + np.arange(m)).ravel()[kept]
    S, r, A = covariance[np.ix_(index, index)], errors.ravel()[index], block_diag(*rows)[kept]
    v = r - A @ np.linalg.solve(A.T @ np.linalg.solve(S, A), A.T @ np.linalg.solve(S, r))
    assert together == pytest.approx(float(v @ np.linalg.solve(S, v)), rel=1e-6)
    every = redundancy.parities(epochs.at(few), poses[few], used)
    np.testing.assert_allclose(alone, every.chi_squared, rtol=1e-6)
    # correlated, so not the sum of its parts
    assert abs(together - alone.sum()) > 1e-3


def test_chi_squared_has_its_degrees_of_freedom_over_draws_of_the_run() -> None:
    """The mean over runs; within a run all samples share most of their errors."""
    found = []
    for seed in range(60):
        reconstruction, redundancy, poses, errors, _ = prepared(EIGHT, seed)
        epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
        epochs.gone_on_mm[:] += errors
        found.append(redundancy.parities(epochs.at(slice(10, N, 10)), poses[10::10]).chi_squared)
    assert np.mean(found) == pytest.approx(2.0, abs=4.0 * 2.0 / np.sqrt(60))
    assert np.mean(np.array(found) < 5.99) == pytest.approx(0.95, abs=0.06)


def test_what_nothing_controls_has_no_error() -> None:
    """Of seven cables one is not used: six tell a pose and nothing else."""
    reconstruction, redundancy, poses, errors, _ = prepared(SEVEN)
    epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
    epochs.gone_on_mm[:] += errors
    epochs.change_mm[:, 4] = np.nan
    parities = redundancy.parities(epochs, poses)
    assert (parities.freedom == 0).all()
    np.testing.assert_array_equal(parities.chi_squared, 0.0)
    assert np.isinf(parities.errors[1]).all()


def test_two_cables_side_by_side_control_each_other_alone() -> None:
    """The seventh runs where the first does: what the other five err by nobody sees."""
    reconstruction, redundancy, poses, errors, _ = prepared([*SEVEN[:6], SEVEN[0]])
    epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
    epochs.gone_on_mm[:] += errors
    parities = redundancy.parities(epochs, poses)
    assert (parities.freedom == 1).all()
    u = parities.errors[1]
    assert np.isinf(u[:, 1:6]).all()
    assert (u[:, [0, 6]] < 1.0).all()
    np.testing.assert_allclose(parities.errors[0][:, 0], errors[:, 0] - errors[:, 6], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("apart_mm", "controlled"), [(0.1, False), (10.0, True)])
def test_what_the_others_could_hardly_show_is_not_controlled(apart_mm: float, controlled: bool) -> None:
    """A seventh cable beside the first: the five turn the tool by their errors over its radius of 0.15 m, and what that moves the two
    apart by is a 1e-7 of their variance, or a thousandth."""
    beside = TOOL | {"P4": [apart_mm, 150.0, 0.0]}
    reconstruction, redundancy, poses, _, _ = prepared([*SEVEN[:6], ("B1", "P4")], tool=beside)
    epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
    u = redundancy.parities(epochs, poses).errors[1]
    assert np.isfinite(u[:, [0, 6]]).all()
    assert np.isfinite(u[:, 1:6]).any() == controlled


def test_the_chance_of_contradictions_is_the_mean_of_places_spread_over_the_run() -> None:
    """One cable is not used; what is rounded, within a count, and what is normal are told apart, in a basis of SciPy's."""
    reconstruction, redundancy, poses, _, _ = prepared(EIGHT)
    budget, rows = reconstruction.budget, span_rows_of(reconstruction.model.rig.cable_rows(), poses)
    epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
    epochs = replace(epochs, variance_mm2=epochs.variance_mm2 + np.arange(8.0) * 1e-6)
    used = np.arange(8) != 2
    shared = redundancy.shared(epochs, poses, np.tile(used, (N, 1)))[:, used]
    uniform = np.array(budget.uniform, dtype=np.bool_)
    places = [0, 13, 26, 39]
    U, V = [], []
    for i in places:
        basis = null_space((rows[i, used] * np.repeat([1.0 / 150.0, 1.0], 3)).T).T
        own, rounding = epochs.variance_mm2[i, used], np.broadcast_to(budget.variance, 8)[used]
        assert (own > rounding).any()
        u = basis @ np.column_stack([np.diag(np.sqrt(np.minimum(own, rounding))), shared[i][:, uniform]])
        v = basis @ np.column_stack([np.diag(np.sqrt(np.maximum(own - rounding, 0.0))), shared[i][:, ~uniform]])
        whiten = np.linalg.inv(sqrtm(u @ u.T + v @ v.T))
        U.append(whiten @ u)
        V.append(whiten @ v)
    expected = chance_of(np.array(U), np.array(V))
    at = expected.limit(1e-3) * np.array([0.3, 1.0, 2.0])
    np.testing.assert_allclose(redundancy.chance(epochs, poses, used).above(at), expected.above(at), rtol=1e-6)
    each = [redundancy.chance(epochs.at(slice(i, i + 1)), poses[i : i + 1], used).above(at) for i in places]
    np.testing.assert_allclose(np.mean(each, axis=0), expected.above(at), rtol=2e-2)


def with_swivels() -> tuple[Redundancy, Epochs, FloatArray]:
    """Six drums and six swivels at 40 samples of a run, and poses near the true ones."""
    run = read_run(AUTHORITY / "swivel-run")
    poses = truth_of("swivel-run")[:: len(run.passes[0].time_s) // N, 1:][:N]
    (counts,) = run.passes
    few = replace(counts, time_s=counts.time_s[::50][:N], recorded=counts.recorded[::50][:N])
    redundancy = Redundancy(reconstruction_of(RunModel(run.rig, poses[0], None, u_start=(0.05, 1e-4))).budget)
    return redundancy, redundancy.epochs(lengths_from_counts(replace(run, passes=(few,), start=poses[0])), None), poses


def with_eight() -> tuple[Redundancy, Epochs, FloatArray]:
    reconstruction, redundancy, poses, errors, _ = prepared(EIGHT)
    epochs = redundancy.epochs(lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0), exact=True)), None)
    epochs.gone_on_mm[:] += errors
    return redundancy, epochs, poses


def test_the_chance_of_contradictions_does_not_hang_on_the_units_of_readings() -> None:
    """Angles beside lengths, each in a unit of its own or of its scatter."""
    redundancy, epochs, poses = with_swivels()
    used, at = np.ones(12, np.bool_), np.array([5.0, 15.0])
    chance = redundancy.chance(epochs, poses, used).above(at)
    redundancy.unit = redundancy.unit * np.random.default_rng(0).uniform(0.3, 3.0, 12)
    np.testing.assert_allclose(redundancy.chance(epochs, poses, used).above(at), chance, rtol=2e-3)


@pytest.mark.parametrize(("made", "channel", "apart_from"), [(with_eight, 6, 3), (with_swivels, 8, 2), (with_swivels, 1, 0)])
def test_what_a_channel_errs_by_is_the_best_estimate_that_no_motion_moves(
    made: Callable[[], tuple[Redundancy, Epochs, FloatArray]], channel: int, apart_from: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Generalised least squares of the pose and one more unknown, whose weights say what of its error is a sample's own and what samples
    share. A channel that is not used has no part; one that the others do not control, and a place without a pose, tell nothing."""
    monkeypatch.setattr("lmeasure.trajectory.faults.redundancy.CHUNK", 7)
    redundancy, epochs, poses = made()
    n, m = epochs.change_mm.shape
    rows, offsets = span_rows_of(redundancy._rows, poses) * np.repeat([1.0 / 150.0, 1.0], 3), 0.003 * np.arange(1.0, m + 1.0)[None]
    used = np.ones((n, m), np.bool_)
    used[5:9, 2], used[10, channel] = False, False
    used[20] = np.arange(m) > m - 6
    used[20, channel] = True
    there = poses.copy()
    there[15] = np.nan
    error, own, common = redundancy.error_of(channel, epochs, there, used, offsets=offsets, apart_from=apart_from)
    parities = redundancy.parities(replace(epochs, gone_on_mm=epochs.gone_on_mm - offsets), there, used)
    alone, u = parities.errors
    nothing = {10, 15, 20}
    assert set(np.flatnonzero(np.isnan(error))) == nothing
    assert np.isnan(own).tolist() == np.isnan(common).tolist() == np.isnan(error).tolist()
    every = redundancy.shared(epochs, poses, np.ones_like(used)) * redundancy.unit[:, None]
    residual = redundancy.residuals(poses, epochs.gone_on_mm - offsets)
    for i in sorted(set(range(n)) - nothing):
        mine = used[i]
        B = np.column_stack([rows[i], np.eye(m)[channel]])[mine]
        for last, found in ((apart_from, None), (0, alone[i, channel])):
            L = every[i][mine, : every.shape[2] - last]
            S = L @ L.T + np.diag(epochs.variance_mm2[i][mine])
            scale = 1.0 / np.sqrt(np.diag(S))
            white, b = np.linalg.inv(np.linalg.cholesky(S * np.outer(scale, scale))), (B.T * scale).T
            h = (np.linalg.pinv(white @ b, rcond=1e-12) @ white)[-1] * scale
            if found is None:
                assert error[i] == pytest.approx(h @ residual[i][mine], rel=1e-5, abs=1e-10)
                assert own[i] == pytest.approx(np.sqrt((h**2 * epochs.variance_mm2[i][mine]).sum()), rel=1e-5)
                assert common[i] == pytest.approx(np.linalg.norm(h @ L), rel=1e-5)
            else:
                assert found == pytest.approx(h @ residual[i][mine], rel=1e-5, abs=1e-10)
                assert u[i, channel] == pytest.approx(np.sqrt(h @ S @ h), rel=1e-5)
    assert parities.freedom.tolist() == [0 if i in (15, 20) else int(used[i].sum()) - 6 for i in range(n)]
    assert (parities.residual_mm[~parities.used] == 0.0).all()
    assert (parities.weight[~parities.used] == 0.0).all()
    assert np.isinf(u[20]).all()
    np.testing.assert_array_equal(alone[20], 0.0)


def test_weights_of_samples_without_what_they_share() -> None:
    """N (N^T V N)^-1 N^T is V^-1 less what the pose takes of it."""
    redundancy, epochs, poses = with_swivels()
    m = epochs.change_mm.shape[1]
    used, rows = (
        np.ones((N, m), np.bool_),
        span_rows_of(redundancy._rows, poses) * np.repeat([1.0 / 150.0, 1.0], 3) / redundancy.unit[:, None],
    )
    residual, variance = redundancy.residuals(poses, epochs.gone_on_mm), epochs.variance_mm2 * np.arange(1.0, m + 1.0)
    r, P = redundancy.weighed(redundancy.basis(poses, used), residual, variance)
    np.testing.assert_allclose(r, residual / redundancy.unit)
    for i in range(0, N, 9):
        V = np.diag(redundancy.unit**2 / variance[i])
        expected = V - V @ rows[i] @ np.linalg.solve(rows[i].T @ V @ rows[i], rows[i].T @ V)
        np.testing.assert_allclose(P[i], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_epochs_hold_what_was_used_and_what_was_shown() -> None:
    reconstruction, redundancy, _, _, _ = prepared(EIGHT)
    lengths = lengths_from_counts(record(reconstruction.model.rig, *motion(N, rate_hz=20.0)))
    assert lengths.gone_on is not None
    lengths.change_mm[3, 5] = np.nan
    u_mm = 0.001 * np.arange(8.0) * np.ones((N, 1))
    epochs = redundancy.epochs(replace(lengths, missed_mm=u_mm), None)
    assert np.isnan(epochs.change_mm[3, 5])
    # of what is not used the counts alone tell
    shown = changes_from_counts(reconstruction.model.rig, lengths.gone_on, reconstruction.model.rig.cable)
    assert epochs.gone_on_mm[3, 5] == pytest.approx(shown[3, 5])
    np.testing.assert_array_equal(np.delete(epochs.gone_on_mm.ravel(), 29), np.delete(lengths.change_mm.ravel(), 29))
    np.testing.assert_allclose(epochs.variance_mm2, reconstruction.budget.variance + u_mm**2)
    gone_on = lengths.gone_on + 5.0
    np.testing.assert_array_equal(redundancy.epochs(replace(lengths, gone_on=gone_on), None).counts, gone_on)
    np.testing.assert_array_equal(redundancy.epochs(replace(lengths, gone_on=None), None).counts, lengths.counts)
    without = epochs.excluding([1, 4])
    assert np.isnan(without.change_mm[:, [1, 4]]).all()
    assert np.isfinite(np.delete(without.change_mm, [1, 4, 5], axis=1)).all()
    assert np.isfinite(epochs.change_mm[:, [1, 4]]).all()


def test_how_often_a_reading_is_repeated() -> None:
    readings = np.array([[1.0, 2.0], [1.0, 3.0], [1.0, 3.0], [4.0, 2.0], [1.0, 2.0], [1.0, 5.0]])
    np.testing.assert_array_equal(repeats(readings), [[3, 1], [3, 2], [3, 2], [1, 2], [2, 2], [2, 1]])


def test_readings_count_from_the_start_or_from_where_they_were_zeroed() -> None:
    reconstruction, redundancy, poses, _, _ = prepared(EIGHT)
    spans = span_lengths(reconstruction.model.scheme.rows, poses[:1])[0]
    np.testing.assert_allclose(redundancy.zero, spans)
    begun = np.arange(8.0)
    np.testing.assert_allclose(Redundancy(Budget(replace(reconstruction.model, begun=begun))).zero, spans - begun)
    run = read_run(AUTHORITY / "swivel-run")
    absolute = Redundancy(reconstruction_of(RunModel(run.rig, poses[0], None)).budget)
    assert (absolute.zero[6:] == 0.0).all()
    # on the circle: a turn more is the same
    few = np.zeros((1, 12))
    np.testing.assert_allclose(
        absolute.residuals(poses[:1], few + 2.0 * np.pi * np.r_[np.zeros(6), np.ones(6)]), absolute.residuals(poses[:1], few), atol=1e-12
    )
    assert np.abs(absolute.residuals(poses[:1], few)[0, 6:]).max() <= np.pi


def test_angles_are_compared_in_units_of_about_the_scatter_of_lengths() -> None:
    redundancy, _, _ = with_swivels()
    variance = redundancy.budget.variance
    np.testing.assert_array_equal(redundancy.unit[:6], 1.0)
    np.testing.assert_allclose(variance[6:] / redundancy.unit[6:] ** 2, variance[:6].min())


def test_an_error_that_is_known_to_centimetres_only_is_known() -> None:
    """Whatever the unit: readings that scatter by 20 mm tell one of 40 mm."""
    redundancy, epochs, poses = with_eight()
    coarse = replace(epochs, variance_mm2=np.full_like(epochs.variance_mm2, 400.0))
    error, u = redundancy.parities(coarse, poses).errors
    assert u.min() > 20.0
    assert np.isfinite(u).all()
    assert (error != 0.0).all()
