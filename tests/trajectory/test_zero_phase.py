"""Counters that were zeroed anywhere within a count: one draw for a whole run, in the covariances and in what it really errs by."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import mpmath as mp
import numpy as np
import oracles
import pytest
from cells import START, cell, motion, position_error, record, rotation_error
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from test_truth import AUTHORITY, rms, truth_of
from zeroed import exactly

from lmeasure import PoseCovariances, Trajectory, covariances
from lmeasure.core import FloatArray, Status
from lmeasure.recording import Counts, Run, read_run
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
from lmeasure.sensors import count_variance, counts_from_poses, drawn_phases, lengths_from_counts, recorded_from_counts, span_lengths
from lmeasure.simulation import cell_rig, simulate_run
from lmeasure.trajectory import RunModel, Situation, reconstruct, reconstruction_of
from lmeasure.trajectory.reconstruction.screw_method import by_monte_carlo

COUNT_MM = 0.012


def phased(**changes: Any) -> Rig:
    """The cell with counters zeroed anywhere within a count."""
    data = cell(None, **changes).to_dict()
    for point in data["observation_point"]:
        del point["drum"]["zero_exact"]
    return rig_from_dict(data)


def mean_error_squared(found: Trajectory, truth: FloatArray, law: PoseCovariances) -> float:
    """Square of the run's mean error (n, 7 truth) in units of what its random and systematic parts say of it: chi-squared with 6."""
    turn = (Rotation.from_quat(truth[:, 3:]) * Rotation.from_quat(found.poses[:, 3:]).inv()).as_rotvec()
    mean = np.hstack([turn, truth[:, :3] - found.poses[:, :3]]).mean(axis=0)
    common = law.factors.mean(axis=0)
    covariance = common @ common.T + law.random.mean(axis=0) / len(truth)
    return float(mean @ np.linalg.solve(covariance, mean))


def test_a_run_with_phases_errs_as_much_as_was_met_and_stated() -> None:
    run, truth = read_run(AUTHORITY / "cell-run-phase"), truth_of("cell-run-phase")[:, 1:]
    found = reconstruct(run)
    assert rms(position_error(found.poses, truth)) == pytest.approx(0.005714, rel=1e-3)
    assert rms(rotation_error(found.poses, truth)) == pytest.approx(6.878e-5, rel=1e-3)
    assert found.covers == "the counts' resolution and the sub-count offset at zeroing only: the rig has no linked calibration"
    stated = mean_error_squared(found, truth, covariances(found, run))
    assert 0.01 < chi2.sf(stated, 6) < 0.99
    # with zeros taken as exact it is told beyond doubt that something is wrong
    sure = replace(run, rig=exactly(run.rig))
    assert chi2.sf(mean_error_squared(found, truth, covariances(found, sure)), 6) < 1e-6


def test_eight_cables_with_phases_too() -> None:
    """No cable contradicts the others, and a generic optimiser that solves for the phases too does no better."""
    run, truth = read_run(AUTHORITY / "eight-run"), truth_of("eight-run")[:, 1:]
    found = reconstruct(run)
    assert (found.status == 0).all()
    assert set(found.cable) == {""}
    assert rms(position_error(found.poses, truth)) == pytest.approx(0.005329, rel=0.05)
    assert 0.01 < chi2.sf(mean_error_squared(found, truth, covariances(found, run)), 6) < 0.99
    assert found.chi_squared is not None
    # two degrees of freedom
    assert found.chi_squared.mean() == pytest.approx(2.0, rel=0.2)
    # and a zero that is not exact contradicts the others where it is taken to be
    sure = reconstruct(replace(run, rig=exactly(run.rig)))
    assert (sure.status == Status.INCONSISTENT).any()


def oracle_counts(rig: Rig, poses: FloatArray) -> FloatArray:
    """(n, m) true counts at poses, zeroed at the start, by the independent statements of `oracles`."""
    out = np.empty((len(poses), len(rig.cable)))
    for j, c in enumerate(rig.cable):
        p = rig.point(c.from_point)
        cable = oracles.Cable(
            p.position_mm, mp.radians(p.guide_alpha_deg), mp.radians(p.guide_beta_deg), p.pulley_radius_mm, rig.tool[c.to_point],
            p.drum.tangent_length_mm, p.drum.axial_offset_mm, p.drum.groove_pitch_mm, p.drum.counts_per_revolution, p.drum.count_length_mm,
        )  # fmt: skip
        zero = oracles.free_length(cable, START)
        for i, pose in enumerate(poses):
            change, k = oracles.free_length(cable, pose) - zero, mp.mpf(0)
            for _ in range(6):
                k += (change - oracles.drum_change(k, cable)) / mp.mpf(cable.count_length)
            out[i, j] = float(k)
    return out


def test_ten_rigs_err_as_their_covariances_say() -> None:
    """Whole-run mean errors of runs by an independent forward model, each with its own rig, poses and phases: neither larger nor smaller
    than stated."""
    generator, squares = np.random.default_rng(8), []
    for seed in range(10):
        rig = cell_rig(seed)
        poses = np.column_stack(
            [generator.uniform(-250, 250, (3, 3)), Rotation.from_rotvec(generator.uniform(-0.25, 0.25, (3, 3))).as_quat()]
        )
        recorded = np.rint(oracle_counts(rig, poses) + generator.uniform(-0.5, 0.5, 6))
        run = Run(
            rig, START, (Counts(np.arange(3.0) * 100.0, tuple(c.channel for c in rig.cable), recorded, source="drawn"),), unstated="exact"
        )
        found = reconstruct(run)
        assert (found.status == 0).all()
        squares.append(mean_error_squared(found, poses, covariances(found, run)))
    assert 0.01 < chi2.sf(sum(squares), 6 * len(squares)) < 0.99


def test_linked_or_not_the_file_says_what_phases_do() -> None:
    """Both ways to the covariances tell the same, and without anything else the phase doubles the variance."""
    rig = phased()
    run = record(rig, *motion(40))
    found, law = reconstruct(run), covariances(reconstruct(run), run)
    assert law.sources == ("zero phase",) * 6
    assert law.uniform == (True,) * 6
    np.testing.assert_allclose(found.systematic, law.systematic, rtol=1e-9)
    np.testing.assert_allclose(found.systematic, found.random, rtol=1e-9)
    timed = replace(run, passes=(replace(run.passes[0], u_time_s=np.full(40, 1e-4)),))
    later, law = reconstruct(timed), covariances(reconstruct(timed), timed)
    np.testing.assert_allclose(later.systematic, law.systematic, rtol=1e-9)
    np.testing.assert_allclose(later.systematic, found.random, rtol=1e-9)
    assert (later.random[20] - found.random[20])[0, 0] > 0.0


def test_an_exact_zero_has_no_phase() -> None:
    data = phased().to_dict()
    data["observation_point"][1]["drum"]["zero_exact"] = True
    data["observation_point"][4]["drum"]["scale"] = 2.0
    rig = rig_from_dict(data)
    assert "zero_exact" not in rig.to_dict()["observation_point"][0]["drum"]
    assert rig.to_dict()["observation_point"][1]["drum"]["zero_exact"] is True
    run = record(rig, *motion(5))
    law = covariances(reconstruct(run), run)
    assert law.sources == ("zero phase",) * 5
    others = [0, 2, 3, 4, 5]
    np.testing.assert_allclose(law.factors, law.own[:, :, others], rtol=1e-9, atol=1e-12)
    # a phase is within a recorded count, of which a channel decoded at 2 has more
    J = np.linalg.inv(law.own[0])
    assert J @ law.factors[0] == pytest.approx(np.eye(6)[:, others], abs=1e-9)
    assert np.sqrt(count_variance(rig)[4]) == pytest.approx(COUNT_MM / 2.0 / np.sqrt(12.0))
    sure = record(exactly(rig), *motion(5))
    assert covariances(reconstruct(sure), sure).factors.shape == (5, 6, 0)
    assert reconstruct(sure).covers == "the counts' resolution only: the rig has no linked calibration"


def test_a_rig_keeps_the_key(tmp_path: Any) -> None:
    write_rig(tmp_path / "rig.toml", exactly(phased()))
    assert (tmp_path / "rig.toml").read_text().count("zero_exact = true") == 6
    assert read_rig(tmp_path / "rig.toml") == exactly(phased())
    write_rig(tmp_path / "rig.toml", phased())
    assert "zero_exact" not in (tmp_path / "rig.toml").read_text()


def test_monte_carlo_draws_the_phase() -> None:
    rig = phased()
    times, poses = motion(3, rate_hz=2.0)
    run = record(rig, times, poses)
    reconstruction = reconstruction_of(RunModel(rig, START))
    lengths = lengths_from_counts(run)
    linear = reconstruction.trajectory(lengths)
    found = by_monte_carlo(reconstruction, lengths, linear, 300, seed=4)
    u = np.sqrt(np.einsum("nii->ni", linear.systematic))
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", found.systematic)), u, rtol=0.17)


def led(*cables: tuple[str, str, str, int]) -> Rig:
    """The cell with these cables: (channel, from, to, pass)."""
    keys = ("channel", "from", "to", "pass")
    return phased(cable=[{"name": f"c{i}"} | dict(zip(keys, c, strict=True)) for i, c in enumerate(cables)])


def test_passes_share_a_phase_unless_the_counter_was_zeroed_again() -> None:
    rig = led(
        ("ch1", "B1", "P1", 1), ("ch2", "B2", "P1", 1), ("ch3", "B3", "P2", 1), ("ch4", "B4", "P2", 1),
        ("ch1", "B1", "P1", 2), ("ch2", "B2", "P3", 2), ("ch3", "B5", "P3", 2), ("ch4", "B6", "P2", 2),
        ("ch2", "B2", "P1", 3),
    )  # fmt: skip
    # ch1 leads the same cable again; ch2 another and then the first one anew; ch3 and ch4 serve other drums
    assert rig.zeroings().tolist() == [0, 1, 2, 3, 0, 4, 5, 6, 7]
    run = record(rig, *motion(30))
    # as they are before redundant cables tell of them
    lengths, found = lengths_from_counts(run), reconstruct(run)
    budget, nothing = reconstruction_of(RunModel(rig, run.known_start)).budget, np.zeros(lengths.counts.shape)
    law = budget.of(Situation(lengths.time_s, found.poses, lengths.counts, nothing))
    assert law.sources == ("zero phase",) * 8
    np.testing.assert_allclose(law.factors[:, :, 0], law.own[:, :, 0] + law.own[:, :, 4], rtol=1e-9, atol=1e-12)
    determined = covariances(found, run)
    assert determined.sources == ("origins of the channels",) * 8
    np.testing.assert_allclose(found.systematic, determined.systematic, rtol=1e-9, atol=1e-15)
    assert (np.linalg.eigvalsh(law.systematic - determined.systematic) > -1e-12).all()


@given(st.lists(st.tuples(st.sampled_from("ab"), st.sampled_from(["B1", "B2"]), st.sampled_from(["P1", "P2"])), min_size=1, max_size=5))
def test_a_zeroing_lasts_until_the_cable_is_changed(passes: list[tuple[str, str, str]]) -> None:
    """One cable a pass: two of a channel share their zeroing when no other cable came between them, and channels never share."""
    cables = [(channel, start, end, i) for i, (channel, start, end) in enumerate(passes, 1)]
    of = led(*cables).zeroings().tolist()
    assert sorted(set(of)) == list(range(len(set(of))))
    for channel in "ab":
        own = [(c[1:3], number) for c, number in zip(cables, of, strict=True) if c[0] == channel]
        for (cable, number), (later, later_number) in pairwise(own):
            assert (number == later_number) == (cable == later)
    numbers = {channel: {n for c, n in zip(cables, of, strict=True) if c[0] == channel} for channel in "ab"}
    assert not numbers["a"] & numbers["b"]


def test_simulated_counts_have_one_phase_for_each_zeroing() -> None:
    rig = led(*[(f"ch{i}", f"B{i}", f"P{(i + 1) // 2}", p) for p in (1, 2) for i in range(1, 7)])
    time_s, poses = motion(4000)
    run = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(5)).run
    again = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(5)).run
    np.testing.assert_array_equal(run.passes[1].recorded, again.passes[1].recorded)
    np.testing.assert_array_equal(run.passes[0].recorded, run.passes[1].recorded)
    true = counts_from_poses(rig, poses, START, rig.cables_of(1))
    signs = np.array([rig.point(c.from_point).drum.count_sign for c in rig.cables_of(1)])
    off = run.passes[0].recorded - signs * true
    # the counts of a moving cable are off by the phase on average: as drawn, and no more than half a count
    assert np.abs(off).max() <= 1.0
    assert 0.15 < off.mean(axis=0).std() < 0.45
    sure = simulate_run(exactly(rig), time_s, poses, noise_mm=0.0, rng=np.random.default_rng(5)).run
    assert np.abs((sure.passes[0].recorded - signs * true).mean(axis=0)).max() < 0.05
    phases = drawn_phases(rig, np.random.default_rng(1))
    np.testing.assert_array_equal(phases[:6], phases[6:])
    assert len(np.unique(phases)) == 6
    assert not drawn_phases(exactly(rig), np.random.default_rng(1)).any()


def test_phases_do_not_cancel_where_the_start_came_from_lengths() -> None:
    """The lengths are what was measured at the zero pose and what was counted since: the phase is in all of them."""
    rig, u_length = phased(), 0.004
    _, poses = motion(60, rate_hz=20.0)
    generator, found = np.random.default_rng(2), []
    true = counts_from_poses(rig, poses, START)
    channels = tuple(c.channel for c in rig.cable)
    law = None
    for _ in range(50):
        reconstruction = reconstruction_of(RunModel(rig, START, u_start=(0.0, 0.0, u_length)))
        start = reconstruction.budget.drawn_start(generator, reconstruction.model.scheme.rows)
        recorded = recorded_from_counts(rig, true, phase=drawn_phases(rig, generator))
        run = Run(
            rig, start, (Counts(np.arange(60) / 20.0, channels, recorded, source="drawn"),), u_start=(0.0, 0.0, u_length), unstated="exact"
        )
        trajectory = reconstruct(run)
        law = law or covariances(trajectory, run)
        found.append((trajectory.poses[:, :3] - poses[:, :3])[30:].mean(axis=0))
    assert law is not None
    common = law.factors[30:].mean(axis=0)[3:]
    u = np.sqrt(np.einsum("ij,ij->i", common, common))
    np.testing.assert_allclose(np.std(found, axis=0), u, rtol=0.25)
    # without the phase it would be a quarter less
    alone = common[:, [name != "zero phase" for name in law.sources]]
    assert (np.sqrt(np.einsum("ij,ij->i", alone, alone)) < 0.8 * u).all()


def test_redundant_cables_contradict_each_other_no_more_than_phases_let_them() -> None:
    """Chi-squared of the residuals has one degree of freedom a redundant cable, phases and all."""
    points = cell(None).to_dict()["observation_point"]
    more = [
        dict(points[0], name="B7", position_mm=[-700.0, -600.0, 1100.0]),
        dict(points[1], name="B8", position_mm=[300.0, 1400.0, 900.0]),
    ]
    own = [(f"B{i}", f"P{(i + 1) // 2}") for i in range(1, 7)] + [("B7", "P1"), ("B8", "P2")]
    cables = [{"name": f"c{i}", "channel": f"ch{i}", "from": a, "to": b} for i, (a, b) in enumerate(own, 1)]
    rig = phased(observation_point=points + more, cable=cables)
    assert np.isfinite(span_lengths(rig, START[None])).all()
    time_s, poses = motion(50, rate_hz=20.0)
    means = []
    for seed in range(30):
        # of 5,162 such runs 4 raised an alarm, as stated, of the first 30 one: without these
        found = reconstruct(simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(1000 + seed)).run)
        assert found.chi_squared is not None
        means.append(found.chi_squared.mean())
    assert np.mean(means) == pytest.approx(2.0, rel=0.25)
