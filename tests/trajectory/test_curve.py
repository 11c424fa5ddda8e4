"""Trajectories in continuous time, against runs of other simulators and laws that hold for any curve."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from moving_robot import TRUTH, FreeRunning, Instrument, Moves, Shaken, Waves, errors
from scipy.spatial.transform import Rotation
from zeroed import zeroed_exactly

import lmeasure as lm
from lmeasure.cli.app import main
from lmeasure.core import FileFormatError, FloatArray, TrajectoryError
from lmeasure.kernels import band_inverse, spline_covariances, spline_equations, spline_poses
from lmeasure.recording import Counts, Run, read_counts, read_run, write_counts
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import Channels
from lmeasure.trajectory import Curve, align, motion_of, motion_of_curve, prepare, reconstruct, reconstruct_curve
from lmeasure.trajectory.curve.fit import Fit, readings_of

ORIGIN = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def exact_run(name: str, *, zeroed: bool = False) -> Run:
    run = read_run(TRUTH / name)
    run = replace(run, rig=run.rig.model_copy(update={"unstated": "exact"}), unstated="exact")
    return zeroed_exactly(run) if zeroed else run


@pytest.fixture(scope="module")
def cell() -> tuple[lm.Trajectory, Curve]:
    return reconstruct_curve(exact_run("cell-run", zeroed=True))


def truth_of(name: str) -> FloatArray:
    return np.asarray(np.loadtxt(TRUTH / name / "truth.csv.gz", delimiter=",", skiprows=1))


@pytest.mark.parametrize(("name", "limit_mm"), [("cell-run", 0.001), ("eight-run", 0.005329), ("swivel-run", 0.004527)])
def test_all_readings_together_beat_a_fit_of_each_sample(name: str, limit_mm: float) -> None:
    trajectory, curve = reconstruct_curve(exact_run(name, zeroed=name == "cell-run"))
    truth = truth_of(name)
    moved = trajectory.poses[:, :3] - truth[:, 1:4]
    turned = (Rotation.from_quat(trajectory.poses[:, 3:]) * Rotation.from_quat(truth[:, 4:]).inv()).as_rotvec()
    assert np.sqrt((moved**2).sum(axis=1).mean()) < limit_mm
    z = np.hstack([moved, turned]) / trajectory.u
    # a run has some sixty knots, and one draw of its sub-count offsets
    assert np.sqrt((z**2).mean()) < 1.4
    assert (np.abs(z) < 1.96).mean() > 0.85
    np.testing.assert_allclose(curve.poses(truth[:, 0]), trajectory.poses, atol=1e-12)


def test_rates_are_the_derivatives_of_the_poses(cell: tuple[lm.Trajectory, Curve]) -> None:
    curve, step = cell[1], 1e-4
    at = np.linspace(0.1, 1.8, 9)
    before, here, behind = (curve.at(at + by) for by in (-step, 0.0, step))
    spin = (Rotation.from_quat(behind.poses[:, 3:]) * Rotation.from_quat(before.poses[:, 3:]).inv()).as_rotvec() / (2.0 * step)
    speed = (behind.poses[:, :3] - before.poses[:, :3]) / (2.0 * step)
    np.testing.assert_allclose(here.rates[:, 1], np.hstack([spin, speed]), rtol=1e-5, atol=1e-5)
    for d in (2, 3):
        differences = (behind.rates[:, d - 1] - before.rates[:, d - 1]) / (2.0 * step)
        scale = np.abs(differences).max(axis=0)
        np.testing.assert_allclose(here.rates[:, d] / scale, differences / scale, atol=1e-3)


def test_a_band_of_the_inverse_is_that_of_the_dense_inverse() -> None:
    rng, k, knots = np.random.default_rng(0), 6, 11
    n, width = 6 * knots, 6 * k
    lower: Any = np.tril(rng.standard_normal((n, n))) * (np.subtract.outer(np.arange(n), np.arange(n)) < width) + 9.0 * np.eye(n)
    inverse: FloatArray = np.linalg.inv(lower @ lower.T)

    def banded(of: FloatArray) -> FloatArray:
        return np.array([[of[c + d, c] if c + d < n else 0.0 for d in range(width)] for c in range(n)])

    Z: FloatArray = band_inverse(banded(lower))
    np.testing.assert_allclose(Z, banded(inverse), 1e-9, 1e-15)
    # with any weights, of a value and a derivative
    table, times = rng.standard_normal((2, k, k)), rng.uniform(0.0, knots - k + 1.0, 5)
    found = spline_covariances(times, (0.0, 1.0), table, Z)
    for covariance, t in zip(found, times, strict=True):
        first = min(int(t), knots - k)
        weights = table @ (t - first) ** np.arange(k)
        B = np.zeros((12, n))
        for d in range(2):
            for p in range(k):
                B[6 * d : 6 * d + 6, 6 * (first + p) : 6 * (first + p) + 6] = weights[d, p] * np.eye(6)
        np.testing.assert_allclose(covariance, B @ inverse @ B.T, rtol=1e-9, atol=1e-12)


def test_equations_are_those_of_difference_quotients(cell: tuple[lm.Trajectory, Curve]) -> None:
    """By moving each control pose a little: rows of readings, of a shared error and of the clocks."""
    curve, k = cell[1], 6
    rig = exact_run("cell-run", zeroed=True).rig
    rows, few, m = Channels.of_rig(rig).rows, 8, 6
    points, turns = curve.points[:few].copy(), curve.turns[:few].copy()
    spacing, rng = curve.spacing_s, np.random.default_rng(1)
    powers = np.array(basis(k))
    own = powers / spacing ** np.arange(2.0)[:, None, None]
    tables = own, np.ascontiguousarray(np.cumsum(own[:, ::-1], axis=1)[:, ::-1])
    times = rng.uniform(0.0, (few - k + 1) * spacing, (40, m))
    shared, late, slow = rng.standard_normal((40, m, 1)), rng.standard_normal((m, 1)), rng.standard_normal((m, 1))

    def steps(of: FloatArray) -> FloatArray:
        every = Rotation.from_quat(of)
        return np.asarray((every[:-1].inv() * every[1:]).as_rotvec())

    def readings(points: FloatArray, turns: FloatArray, at: FloatArray) -> FloatArray:
        poses = [spline_poses(np.ascontiguousarray(at[:, j]), (0.0, spacing), tables, points, turns, steps(turns)) for j in range(m)]
        return np.stack([lm_lengths(rows[j : j + 1], poses[j])[:, 0] for j in range(m)], axis=1)

    N, g, X = np.zeros((6 * few, 6 * k)), np.zeros(6 * few), np.zeros((6 * few, 3))
    S, s, here = np.zeros((3, 3)), np.zeros(3), readings(points, turns, times)
    late_of = late, slow, 0.0
    total = spline_equations(
        rows, np.zeros(m), here + 1e-3, times, np.ones((40, m)), (0.0, spacing), tables, points, turns, steps(turns), shared, late_of,
        N, g, X, S, s,
    )  # fmt: skip
    J = []
    for column in range(6 * few):
        sides = []
        for by in (1e-5, -1e-5):
            p, t, i, c = points.copy(), turns.copy(), *divmod(column, 6)
            if c < 3:
                t[i] = (Rotation.from_rotvec(by * np.eye(3)[c]) * Rotation.from_quat(t[i])).as_quat()
            else:
                p[i, c - 3] += by
            sides.append(readings(p, t, times))
        J.append(((sides[0] - sides[1]) / 2e-5).ravel())
    A = np.array(J)
    dense = np.array([[N[min(i, j), abs(i - j)] if abs(i - j) < 6 * k else 0.0 for j in range(6 * few)] for i in range(6 * few)])
    np.testing.assert_allclose(dense, A @ A.T, atol=2e-4 * np.abs(A @ A.T).max())
    np.testing.assert_allclose(g, A @ np.full(40 * m, 1e-3), rtol=1e-3, atol=1e-6 * np.abs(g).max())
    assert total == pytest.approx(40 * m * 1e-6, rel=1e-6)
    rate = (readings(points, turns, times + 1e-6) - readings(points, turns, times - 1e-6)) / 2e-6
    L = np.stack([shared[..., 0], rate * late[:, 0], rate * slow[:, 0] * times], axis=2).reshape(-1, 3)
    np.testing.assert_allclose(X, A @ L, atol=2e-4 * np.abs(A @ L).max())
    np.testing.assert_allclose(S, L.T @ L, rtol=1e-4)


def test_the_evidence_of_a_fit_is_that_of_dense_equations_where_it_ends() -> None:
    """Rounds follow the equations by their slopes. Here they are made anew, and their matrix is dense."""

    run, spacing = exact_run("eight-run"), 0.03
    first = run.passes[0]
    run = replace(run, passes=(replace(first, time_s=first.time_s[:150], recorded=first.recorded[:150]),))
    reconstruction = prepare(align(run))
    lengths = align(run).lengths_of(reconstruction.doubts)
    fit = Fit(readings_of(reconstruction, lengths, reconstruction.trajectory(lengths)), spacing, reconstruction.budget.origins)
    begun = fit.equations(fit.begin())[5]
    solution = fit.solve(fit.begin(), most=0)
    N, *_, total = fit.equations(solution.control)
    assert total < 1e-3 * begun
    n = len(N)
    D = np.kron(np.diff(np.eye(n // 6), 4, axis=0), np.eye(6))
    prior, off = 1.0 / solution.control.snap.ravel(), solution.control.differences().ravel()
    dense = np.array([[N[min(i, j), abs(i - j)] if abs(i - j) < N.shape[1] else 0.0 for j in range(n)] for i in range(n)])
    evidence = -0.5 * (total + prior @ off**2) + 0.5 * np.log(prior).sum() - 0.5 * np.linalg.slogdet(dense + D.T @ (prior[:, None] * D))[1]
    # coefficients of cubics by time, instead of by knots
    assert solution.evidence == pytest.approx(evidence - 6 * (0 + 1 + 2 + 3) * np.log(spacing), rel=1e-7)


def basis(k: int) -> list[FloatArray]:
    """Polynomials of uniform basis functions and of their derivatives, by the recurrence of de Boor on powers of u, not of the product."""
    pieces = [np.array([1.0])]
    for order in range(2, k + 1):
        new = [np.zeros(order) for _ in range(order)]
        for p, piece in enumerate(pieces):
            # the function that begins order - 1 - p knots before the span takes up with (u + that) and dies away behind
            begun = order - 1 - p
            new[p] += np.convolve(piece, [1.0 - 0.0 + p, -1.0])[:order] / (order - 1.0)
            new[p + 1] += np.convolve(piece, [begun - 1.0, 1.0])[:order] / (order - 1.0)
        pieces = new
    table = np.array(pieces)
    return [table, np.pad(table[:, 1:] * np.arange(1, k), ((0, 0), (0, 1)))]


def lm_lengths(rows: FloatArray, poses: FloatArray) -> FloatArray:
    from lmeasure.kernels import span_lengths

    return np.asarray(span_lengths(rows, poses))


def free_running(
    name: str, seed: int | list[int], lasts: float = 2.0, *, late_s: float = 0.0, waves: bool = False
) -> tuple[Run, FreeRunning, Moves | Waves]:
    """A run whose channels send by themselves at 100 Hz, at up to 1 m/s and 10 m/s^2."""
    rng, instrument = np.random.default_rng(seed), Instrument(name)
    m = len(instrument.channels)
    motion = Waves(rng, lasts) if waves else Moves(rng, lasts)
    frames = FreeRunning(rng, m, lasts, 100.0, late_s, 1e-2 * late_s)
    phases = rng.uniform(-0.5, 0.5, m) if late_s else 0.0
    recorded = instrument.recorded(motion, frames.true_s, phases)
    u = np.full(len(recorded), late_s / np.sqrt(3.0)) if late_s else None
    run = exact_run(name, zeroed=not late_s)
    counts = Counts(frames.time_s, instrument.channels, recorded, u_time_s=u, stamp_s=frames.stamp_s)
    return replace(run, passes=(counts,), start=ORIGIN), frames, motion


def test_six_free_running_drums_with_true_stamps() -> None:
    run, frames, motion = free_running("cell-run", 3, waves=True)
    curve = reconstruct_curve(run)[1]
    at = np.linspace(0.1, 1.9, 60)
    pose, velocity, acceleration = errors(motion, at, curve.at(at, rates=2))
    assert np.sqrt((pose[:, 3:] ** 2).sum(axis=1).mean()) < 0.02
    u = curve.at(at, rates=2).u
    for d, error in enumerate((pose, velocity, acceleration)):
        assert (np.abs(error) < 1.96 * u[:, d]).mean() > 0.85
    # lengths between frames by cubics, sample by sample
    place = motion.at(frames.time_s)[0]
    off = np.linalg.norm(reconstruct(run).poses[:, :3] - place, axis=1)
    assert np.sqrt(np.nanmean(off**2)) > 0.004


def test_clocks_of_redundant_channels_are_found_and_of_six_they_keep_their_prior() -> None:
    run, frames, motion = free_running("eight-run", 1, 4.0, late_s=5e-3)
    trajectory, curve = reconstruct_curve(run)
    at = np.linspace(0.1, 1.9, 60)
    there = curve.at(at, rates=1)
    pose = errors(motion, frames.common(at), there)[0]
    assert np.sqrt((pose[:, 3:] ** 2).sum(axis=1).mean()) < 0.02
    assert (np.abs(pose) < 1.96 * there.u[:, 0]).mean() > 0.85
    late = frames.late_s - frames.late_s.mean()
    assert np.abs(curve.clocks_s - late).max() < 20e-6
    assert np.abs((curve.clocks_s - late) / curve.u_clocks_s).max() < 4.0
    assert trajectory.notes[-1].code == "curve.clocks"
    run, frames, motion = free_running("cell-run", 4, late_s=5e-3)
    trajectory, curve = reconstruct_curve(run)
    assert trajectory.notes[-1].code == "curve.clocks_unseen"
    np.testing.assert_allclose(curve.u_clocks_s, curve.u_before_s, rtol=1e-9)
    there = curve.at(at, rates=0)
    pose = errors(motion, frames.common(at), there)[0]
    assert (np.abs(pose) < 3.0 * there.u[:, 0]).mean() > 0.9
    assert there.u[:, 0, 3:].max() > 0.5


def test_knots_that_turn_out_too_far_apart_are_halved() -> None:
    run, frames, motion = free_running("eight-run", [71, 4], 4.0, late_s=5e-3, waves=True)
    curve = reconstruct_curve(run)[1]
    at = np.linspace(0.1, 3.9, 30)
    there = curve.at(at, rates=0)
    pose = errors(motion, frames.common(at), there)[0]
    assert np.sqrt((pose[:, 3:] ** 2).sum(axis=1).mean()) < 0.02
    assert (np.abs(pose) < 1.96 * there.u[:, 0]).mean() > 0.85


def shaken(by: Callable[[FloatArray], FloatArray], rate_hz: float) -> tuple[Curve, Shaken]:
    """The curve of 1.2 s of a moving robot that is shaken besides."""
    motion, instrument = Shaken(Waves(np.random.default_rng(1), 1.2), by), Instrument("cell-run")
    time_s = np.arange(0.0, 1.2, 1.0 / rate_hz)
    recorded = instrument.recorded(motion, np.tile(time_s[:, None], (1, len(instrument.channels))))
    run = exact_run("cell-run", zeroed=True)
    return reconstruct_curve(replace(run, passes=(Counts(time_s, instrument.channels, recorded),), start=ORIGIN))[1], motion


def test_a_vibration_is_kept_and_an_impact_is_smeared_by_less_than_its_uncertainty() -> None:
    curve, motion = shaken(lambda t: np.asarray(0.03 * np.sin(40.0 * np.pi * t)), 100.0)
    at = np.arange(0.2, 1.0, 0.002)
    swing = curve.poses(at)[:, 0] - motion.motion.at(at)[0][:, 0]
    amplitude = 2.0 * np.abs((swing * np.exp(40j * np.pi * at)).mean())
    assert amplitude == pytest.approx(0.03, rel=0.05)

    def pushed(t: FloatArray) -> FloatArray:
        u = np.clip((t - 0.5) / 0.02, 0.0, 1.0)
        return np.asarray(0.5 * u**3 * (10.0 - 15.0 * u + 6.0 * u**2))

    curve, motion = shaken(pushed, 1000.0)
    at = np.arange(0.45, 0.57, 0.0013)
    there = curve.at(at, rates=0)
    off = errors(motion, at, there)[0]
    assert (np.abs(off) < 1.96 * there.u[:, 0]).mean() > 0.85
    assert (np.abs(off) < 4.0 * there.u[:, 0]).all()


def test_the_motion_of_a_curve_is_less_uncertain_than_that_of_samples(cell: tuple[lm.Trajectory, Curve]) -> None:
    trajectory, curve = cell
    found, single = motion_of_curve(trajectory, curve), motion_of(reconstruct(exact_run("cell-run", zeroed=True)))
    there = curve.at(trajectory.time_s)
    np.testing.assert_array_equal(found.acceleration, there.rates[:, 2])
    inside = slice(100, -100)
    for name in ("u_velocity", "u_acceleration", "u_jerk"):
        one, other = (np.nanmedian(np.linalg.norm(getattr(each, name)[inside, 3:], axis=1)) for each in (found, single))
        assert one < 0.7 * other, name
    ways = np.linalg.norm(np.diff(truth_of("cell-run")[:, 1:4], axis=0), axis=1).sum()
    assert found.path_mm[-1] == pytest.approx(ways, abs=0.05)
    other = replace(trajectory, poses=trajectory.poses + 1e-3)
    with pytest.raises(TrajectoryError, match=r"^sample 0 is not that of the run's curve"):
        motion_of_curve(other, curve, trajectory)


def test_a_short_gap_is_bridged_and_a_long_one_is_not() -> None:
    run = exact_run("cell-run", zeroed=True)
    recorded = run.passes[0].recorded.copy()
    recorded[500:620, 2] = np.nan
    recorded[1000:1700] = np.nan
    trajectory, _ = reconstruct_curve(replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    truth, u = truth_of("cell-run"), np.linalg.norm(trajectory.u[:, :3], axis=1)
    assert (trajectory.status[500:620] == 0).all()
    assert trajectory.cause[560].code == "cause.bridged"
    assert u[560] > 1.5 * u[450]
    off = np.abs(trajectory.poses[500:620, :3] - truth[500:620, 1:4])
    assert (off < 3.0 * trajectory.u[500:620, :3]).all()
    assert trajectory.status[1350] != 0
    assert np.isnan(trajectory.poses[1350]).all()


def test_what_a_curve_cannot_say_is_refused_in_one_line(cell: tuple[lm.Trajectory, Curve]) -> None:
    with pytest.raises(TrajectoryError, match=r"^curve: 2\.5 s is outside the run, which lasts from 0 s to 1\.999 s$"):
        cell[1].at([1.0, 2.5])
    with pytest.raises(TrajectoryError, match="has 3 derivatives"):
        cell[1].at(1.0, rates=4)
    with pytest.raises(TrajectoryError, match="must be a positive time, not -1 s"):
        reconstruct_curve(exact_run("cell-run"), spacing_s=-1.0)
    with pytest.raises(TrajectoryError, match="the rig has 2 passes"):
        reconstruct_curve(exact_run("three-drums-two-passes"))
    run = exact_run("cell-run", zeroed=True)
    data = run.rig.to_dict()
    point = replace(run, rig=rig_from_dict(data | {"cable": [c | {"to": "P1"} for c in data["cable"]]}))
    with pytest.raises(TrajectoryError, match="the rig measures 3 of six freedoms"):
        reconstruct_curve(point)
    first = run.passes[0]
    short = replace(first, time_s=first.time_s[:4], recorded=first.recorded[:4])
    with pytest.raises(TrajectoryError, match="the run has 4 poses, and a curve needs at least 6"):
        reconstruct_curve(replace(run, passes=(short,)))


def test_times_of_channels_are_kept_by_files(tmp_path: Path) -> None:
    counts = Counts(np.arange(3.0), ("a", "b"), np.arange(6.0).reshape(3, 2), stamp_s=np.arange(6.0).reshape(3, 2) / 2.0)
    write_counts(tmp_path / "counts.csv", counts)
    found = read_counts(tmp_path / "counts.csv")
    assert found.channels == ("a", "b")
    assert found.stamp_s is not None
    np.testing.assert_array_equal(found.stamp_s, counts.stamp_s)
    text = (tmp_path / "counts.csv").read_text()
    (tmp_path / "one.csv").write_text("\n".join(line.rsplit(",", 1)[0] for line in text.splitlines()))
    with pytest.raises(FileFormatError, match="column 'b_time_s' is missing: either every channel has its own times, or none has"):
        read_counts(tmp_path / "one.csv")
    with pytest.raises(FileFormatError, match=r"sample 1: b_time_s = 0\.5 does not follow 0\.5"):
        replace(counts, stamp_s=np.array([[0.0, 0.5], [1.0, 0.5], [2.0, 2.5]]))


def test_the_command_writes_the_same_columns_and_the_control_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(*more: str) -> int:
        out = ["--out", str(tmp_path / "found.csv")]
        monkeypatch.setattr("sys.argv", ["lmeasure", "reconstruct", str(TRUTH / "cell-run"), *out, *more])
        with pytest.raises(SystemExit) as stop:
            main()
        return int(stop.value.code or 0)

    assert command("--continuous") == 0
    assert "curve in continuous time, knots every" in capsys.readouterr().out
    found, curve = (tmp_path / name for name in ("found.csv", "found.curve.csv"))
    assert curve.read_text().startswith("time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n")
    header = found.read_text().splitlines()[0]
    found.unlink()
    curve.unlink()
    assert command() == 0
    assert found.read_text().splitlines()[0] == header
    assert command("--continuous", "--uncertainty", "monte-carlo") == 2
