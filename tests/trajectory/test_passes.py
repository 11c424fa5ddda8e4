"""Two passes of three drums: clocks by their sync edges, refused when they are not the same motion, uncertain by time and repetition."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import START, FloatArray, cell, position_error, record
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lmeasure import covariances
from lmeasure.core import Status, TrajectoryError
from lmeasure.recording import Counts, Run
from lmeasure.rig import Rig
from lmeasure.sensors import lengths_from_counts
from lmeasure.trajectory import align, reconstruct

SHIFT_S, RATE = 3.7, 1.0 - 150e-6


def rig_of_two_passes() -> Rig:
    data = cell().to_dict()
    for i, c in enumerate(data["cable"]):
        c["channel"], c["pass"] = f"ch{i % 3 + 1}", i // 3 + 1
    return cell(cable=data["cable"])


def path(times: FloatArray) -> FloatArray:
    """Rest, a way out and back, rest: 4 s."""
    s = np.sin(np.pi * np.clip((times - 0.5) / 3.0, 0.0, 1.0)) ** 2
    rotation = Rotation.from_rotvec(np.outer(0.2 * s, [0.5, -0.7, 0.4]))
    return np.column_stack([200 * s, -150 * s, 90 * s, rotation.as_quat()])


def two_passes(sync: bool = True, exact: bool = True, late_s: float = 0.0) -> tuple[Run, FloatArray]:
    """Pass 2 on a clock of its own; its sync edges may be late against the motion."""
    rig = rig_of_two_passes()
    times = np.arange(4000) / 1000.0
    own = (np.arange(4100) - 30) / 1000.0
    first = record(rig, times, path(times), exact=exact).passes[0]
    second = record(rig, own, path(own - late_s), exact=exact).passes[1]

    def pulses(t: FloatArray) -> FloatArray:
        return np.where((t >= 0.2 - 1e-9) & (t < 0.3) | (t >= 3.7 - 1e-9) & (t < 3.8), 1.0, 0.0)

    if sync:
        first = replace(first, sync=pulses(times))
        second = replace(second, sync=pulses(own))
    second = replace(second, time_s=(own - SHIFT_S) / RATE if sync else own)
    return Run(rig, START, (first, second), unstated="exact"), path(times)


def test_clocks_are_found_by_two_edges() -> None:
    run, truth = two_passes()
    trajectory = reconstruct(run)
    assert (trajectory.status == Status.OK).all()
    # what is left is interpolation between samples
    assert position_error(trajectory.poses, truth).max() < 2e-3
    assert any("rate 0.99985" in note for note in map(str, trajectory.notes))


def pulses_at(begins: FloatArray, t: FloatArray) -> FloatArray:
    """Sync at the instants t: pulses of 50 ms."""
    return np.array([float(((begins <= at) & (at < begins + 0.05)).any()) for at in t])


@pytest.mark.parametrize("steady", [False, True])
def test_many_edges_are_worth_more_than_the_first_unless_they_keep_step(steady: bool) -> None:
    """Twenty pulses, each seen up to a sample late by either pass: pass 2 comes within what its clock's u says, a tenth of a sample, where
    the first edge alone is off by four; pulses that keep step with the samples are all late by the same, and u says so."""
    rig = rig_of_two_passes()
    times = np.arange(4000) / 1000.0
    late, found, alone, u = 0.00037, [], [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        own = times + rng.uniform(0, 1e-3)
        begins = 0.1 + rng.uniform(0, 1e-3) + 0.19 * np.arange(20) + rng.uniform(0, 0.0 if steady else 0.1, 20)
        first = replace(record(rig, times, path(times)).passes[0], sync=pulses_at(begins, times))
        second = record(rig, own, path(own)).passes[1]
        second = replace(second, sync=pulses_at(begins, own), time_s=own - late)
        aligned = align(Run(rig, START, (first, second), unstated="exact"))
        moved = aligned.run.passes[1]
        # a count at its true time
        found.append(float(np.mean(moved.time_s - own)) / aligned.clocks[1].u_s)
        alone.append(first.rising()[0] - second.rising()[0] - late)
        u.append(aligned.clocks[1].u_s)
        lengths = lengths_from_counts(aligned.run)
        j = next(i for i, c in enumerate(rig.cable) if c.passage == 2)
        recorded = second.of(rig.cable[j].channel) * rig.point(rig.cable[j].from_point).drum.count_sign
        for i in range(5, 3995, 399):
            about = np.searchsorted(moved.time_s, times[i]) + np.arange(-2, 2)
            assert lengths.counts[i, j] == pytest.approx(BarycentricInterpolator(moved.time_s[about], recorded[about])(times[i]), abs=1e-6)
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=0.4)
    assert np.std(alone) > 0.25e-3
    assert bool(np.median(u) > 0.35e-3) is steady


def test_uncertainty_of_the_clocks_is_what_late_edges_do() -> None:
    run, truth = two_passes(exact=False)
    stated = reconstruct(run)
    plain = reconstruct(two_passes(sync=False, exact=False)[0])
    fast = 2000
    assert stated.u[0, :3] == pytest.approx(plain.u[0, :3], rel=1e-6)
    assert (stated.u[1000:3000, :3].max(axis=0) > 2 * plain.u[1000:3000, :3].max(axis=0)).all()
    # a delay of one standard uncertainty moves the pose by the systematic standard uncertainty that the clocks added
    u_time = align(run).clocks[1].u_s
    late = reconstruct(two_passes(late_s=u_time)[0])
    moved = np.abs(late.poses[:, :3] - truth[:, :3])
    added = np.sqrt(np.einsum("nii->ni", stated.systematic))[:, 3:]
    np.testing.assert_allclose(moved[1200], added[1200], rtol=0.05, atol=2e-3)
    assert added[fast].max() < added[1200].max()


def test_repeatability_is_carried_to_the_pose() -> None:
    run, _ = two_passes()
    without, with_it = reconstruct(run), reconstruct(run, repeatability_mm=0.05)
    assert (with_it.u[:, :3] > without.u[:, :3]).all()
    assert any("repeatability" in note for note in map(str, without.notes))
    assert not any("repeatability" in note for note in map(str, with_it.notes))
    # both passes displaced alike displace the pose alike; here they are independent: at least 0.05 mm along some axis
    assert (np.linalg.norm(with_it.u[:, :3], axis=1) > 0.05).all()


def test_without_sync_the_clocks_are_taken_as_one_and_that_is_said() -> None:
    run, truth = two_passes(sync=False)
    trajectory = reconstruct(run)
    assert position_error(trajectory.poses, truth).max() < 1e-6
    assert any("no sync edges" in note for note in map(str, trajectory.notes))


@pytest.mark.parametrize("rate_hz", [20, 50])
def test_a_later_pass_is_read_between_its_samples_as_well_as_they_were_counted(rate_hz: int) -> None:
    """Pass 2 is sampled half-way between the samples of pass 1, where straight lines would be 0.07 and 0.012 mm off."""
    rig, times = rig_of_two_passes(), np.arange(4 * rate_hz) / rate_hz
    own, squares = times + 0.5 / rate_hz, []
    for exact in (True, False):
        passes = record(rig, times, path(times), exact=exact).passes[0], record(rig, own, path(own), exact=exact).passes[1]
        found = reconstruct(Run(rig, START, passes, unstated="exact"))
        assert (found.status[1:] == Status.OK).all()
        error = found.poses[1:, :3] - path(times)[1:, :3]
        stated = (found.random + found.systematic)[1:, 3:, 3:]
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(stated), error))
        if exact and rate_hz == 50:
            assert np.linalg.norm(error, axis=1).max() < 1e-3
    # where the motion comes on at once the straight lines that are left are in the uncertainty
    assert squares[0].max() < chi2.isf(1e-3, 3) / 2
    assert squares[1].max() < chi2.isf(1e-4, 3)
    assert np.mean(squares[1]) == pytest.approx(3.0, rel=0.4)


def changed(run: Run, **second: object) -> Run:
    return replace(run, passes=(run.passes[0], replace(run.passes[1], **second)))  # type: ignore[arg-type]


def test_passes_of_another_motion_are_refused() -> None:
    run, _ = two_passes()
    second = run.passes[1]
    assert second.sync is not None
    with pytest.raises(TrajectoryError, match="1 rising sync edges, pass 1 has 2"):
        align(changed(run, sync=np.where(np.arange(len(second.sync)) > 2000, 0.0, second.sync)))
    with pytest.raises(TrajectoryError, match=r"clock runs 0\.98"):
        align(changed(run, time_s=second.time_s * 1.02))
    plain, _ = two_passes(sync=False)
    with pytest.raises(TrajectoryError, match=r"pass 2 begins to move 0\.\d+ s after"):
        align(changed(plain, time_s=plain.passes[1].time_s + 0.6))
    with pytest.raises(TrajectoryError, match="ends to move"):
        align(changed(plain, time_s=0.5 + 1.3 * (plain.passes[1].time_s - 0.5)))


def test_channels_counted_at_different_instants_add_speed_times_skew(tmp_path: Path) -> None:
    rig = cell()
    times = np.arange(4000) / 1000.0
    run = record(rig, times, path(times))
    plain = reconstruct(run)
    first: Counts = replace(run.passes[0], u_time_s=np.full(4000, 1e-3))
    skewed = reconstruct(replace(run, passes=(first,)))
    np.testing.assert_array_equal(skewed.poses, plain.poses)
    np.testing.assert_allclose(skewed.u[100], plain.u[100])
    # independent errors of speed x 1 ms on every length, against as many drawn
    generator = np.random.default_rng(0)
    i = 1200
    rates = np.gradient(run.passes[0].recorded, times, axis=0)[i]
    drawn = run.passes[0].recorded[i] + generator.normal(0.0, 1e-3, (2000, 6)) * rates
    found = reconstruct(Run(rig, START, (Counts(np.arange(2000.0), first.channels, drawn),), unstated="exact"))
    added = np.sqrt(skewed.u[i] ** 2 - plain.u[i] ** 2)
    np.testing.assert_allclose(found.poses[:, :3].std(axis=0), added[:3], rtol=0.1)


def jittering(rng: np.random.Generator, law: str, edge: bool) -> tuple[Run, FloatArray, FloatArray]:
    """Two passes of whole counts, nominally every 5 ms, stamped by a host up to 10 ms late; true poses and instants of pass 1's samples.
    Without an edge both are sampled in step, so that interpolation makes no mean of two roundings. law "asked": samples come 1 to 9 ms
    after each other and are stamped up to 2 ms late."""
    rig, passes, instants, within = rig_of_two_passes(), [], [], rng.random(2) if edge else np.zeros(2)
    begins = rng.uniform(0.2, 0.3, 1)
    for number in range(2):
        if law == "even":
            true, latest_s = 0.005 * (np.arange(800) + within[number]), 0.01
        else:
            true, latest_s = np.cumsum(rng.uniform(1e-3, 9e-3, 800)), 0.002
        counts = record(rig, true, path(true)).passes[number]
        stamps = np.maximum.accumulate(true + rng.uniform(0.0, latest_s, 800) - 5e-5 * np.arange(800)) + 5e-5 * np.arange(800)
        passes.append(replace(counts, time_s=stamps, sync=pulses_at(begins, true) if edge else None))
        instants.append(true)
    return Run(rig, START, tuple(passes), unstated="exact"), path(instants[0]), instants[0]


@pytest.mark.parametrize(("law", "edge"), [("even", True), ("asked", False)])
def test_stamps_that_jitter_in_either_pass_are_carried_into_poses(law: str, edge: bool) -> None:
    """Squared errors over the stated covariances, at one sample of each of 9 runs, are chi-squared; taken as they are the stamps put the
    poses of pass 1 together with counts of pass 2 that are up to 10 ms from them."""
    squares = []
    for seed in range(9):
        rng = np.random.default_rng([seed, len(law)])
        run, truth, instants = jittering(rng, law, edge)
        found = reconstruct(run)
        np.testing.assert_array_equal(found.time_s, run.passes[0].time_s)
        fast = np.flatnonzero((np.abs(instants - 1.25) < 0.4) | (np.abs(instants - 2.75) < 0.4))
        i = int(rng.choice(fast))
        turn = Rotation.from_quat(truth[i, 3:]) * Rotation.from_quat(found.poses[i, 3:]).inv()
        error = np.concatenate([turn.as_rotvec(), truth[i, :3] - found.poses[i, :3]])
        squares.append(float(error @ np.linalg.solve(found.random[i] + found.systematic[i], error)))
        law_of_file = covariances(found, run, np.array([i]))
        np.testing.assert_allclose(law_of_file.systematic[0], found.systematic[i], rtol=1e-6, atol=1e-18)
    assert sum("time stamps are irregular" in note for note in map(str, found.notes)) == 2
    assert 0.005 < chi2.sf(sum(squares), 6 * len(squares)) < 0.995, np.mean(squares) / 6
