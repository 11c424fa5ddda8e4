"""What a run's sources of error put into its lengths, on rigs with encoders beside their drums and with parts that have play."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cells import START, FloatArray, cell, motion

from lmeasure.core import se3
from lmeasure.recording import Counts, Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import Lengths, counts_from_poses, effects_of, lengths_from_counts, span_lengths
from lmeasure.trajectory import Budget, RunModel
from lmeasure.trajectory.uncertainty.budget import PHYSICAL, RESTORED
from lmeasure.trajectory.uncertainty.sources import OriginEstimate, PassClock, Situation

TIMES, POSES = motion(5, rate_hz=2.0)
PLAY, SCALE, COUNT_MM = 3.0, 1.25, 0.012


def rig_of(*, encoders: bool, **drum: Any) -> Rig:
    """The cell, or with an encoder on the swivels of its first two points; what is given of the drum of B2."""
    data = cell().to_dict()
    for point in data["observation_point"]:
        if point["name"] == "B2":
            point["drum"] |= drum
            point["phase_length_mm"] = 1500.0
    swivels = [{"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 2**17, "zero_deg": 3.0, "u_zero_deg": 0.01} for i in (1, 2)]
    return rig_from_dict(data | ({"swivel": swivels} if encoders else {}))


def budget_of(rig: Rig, **given: Any) -> Budget:
    return Budget(RunModel(rig, START, **given))


def lengths(budget: Budget, rig: Rig) -> dict[str, list[FloatArray]]:
    """(n, m) errors of the lengths by one standard deviation of each variable, by the names of the sources."""
    counts = counts_from_poses(rig, POSES, START, rig.observed)
    every = budget.lengths_of(Situation(TIMES, POSES, counts, np.zeros_like(counts)), budget.every)
    out: dict[str, list[FloatArray]] = {}
    for k, name in enumerate(budget.sources):
        out.setdefault(name, []).append(every[:, :, k])
    return out


def test_play_of_a_drum_is_as_many_counts_as_its_rig_states() -> None:
    """Recorded counts, of which the scale makes fewer or more of the drum's."""
    rig = rig_of(encoders=False, backlash_counts=PLAY, scale=SCALE)
    (played,) = lengths(budget_of(rig), rig)["play of drums"]
    expected = np.zeros((len(TIMES), 6))
    expected[:, 1] = PLAY * COUNT_MM / SCALE
    np.testing.assert_allclose(np.abs(played), expected, rtol=1e-12)


@pytest.mark.parametrize("physical", [False, True])
def test_what_acts_on_cables_does_not_act_on_the_encoders_behind_them(physical: bool) -> None:
    """With encoders the cables' errors are those without, and the encoders have none by drums, stretch or sag."""
    drum: dict[str, Any] = {"backlash_counts": PLAY, "u_run_out_mm": 0.02, "u_groove_pitch_mm": 0.01}
    if physical:
        drum = {"cable_tension_n": 6.0, "cable_stiffness_n": 9000.0, "u_cable_tension_change_n": 0.2, "u_cable_stiffness_n": 500.0}
    alone, beside = (rig_of(encoders=encoders, **drum) for encoders in (False, True))
    found = []
    for rig in (alone, beside):
        given: dict[str, Any] = {}
        if physical:
            effects = effects_of(rig)
            assert effects is not None
            given["temperature_c"] = 20.0
        found.append(lengths(budget_of(rig, **given), rig))
    names = [name for name in found[0] if name != "zero phase"]
    assert names
    assert (PHYSICAL in names) == physical
    for name in names:
        assert len(found[0][name]) == len(found[1][name])
        for one, other in zip(found[0][name], found[1][name], strict=True):
            np.testing.assert_allclose(other[:, :6], one, atol=1e-12)
            np.testing.assert_array_equal(other[:, 6:], 0.0)


def test_a_restored_origin_errs_from_when_until_when_it_goes_on() -> None:
    """Behind the first, up to the second; a length may be a metre off, an angle anywhere on the circle."""
    rig = rig_of(encoders=True)
    budget = budget_of(rig)
    before = budget.sources
    budget = budget.with_restored(2, 0.5, 1.5)
    budget = budget.with_restored(7, 1.0)
    assert budget.sources == (*before, RESTORED, RESTORED)
    assert len(budget.uniform) == len(budget.sources)
    assert budget.origin_names[-2:] == (RESTORED, RESTORED)
    expected = np.zeros((2, len(TIMES), 8))
    expected[0, [2, 3], 2] = 1000.0
    expected[1, [3, 4], 7] = 2.0 * np.pi / np.sqrt(12.0)
    np.testing.assert_allclose(lengths(budget, rig)[RESTORED], expected, rtol=1e-12)
    np.testing.assert_allclose(np.moveaxis(budget.origin_lengths(TIMES)[:, :, -2:], 2, 0), expected, rtol=1e-12)


def test_what_a_run_tells_of_its_origins_is_used_and_forgotten() -> None:
    rig = rig_of(encoders=True, u_run_out_mm=0.02)
    budget = budget_of(rig, u_start=(0.3, 0.001))
    budget = budget.with_restored(2, 0.5, 1.5)
    budget = budget.with_restored(7, 1.0)
    assert budget.restored_origins() == []
    np.testing.assert_array_equal(budget.offsets(TIMES), np.zeros((1, 8)))
    own, sources = len(budget.origin_names), budget.sources
    every = len(sources)
    assert every > own > 2
    mean = np.arange(1.0, own + 1.0)
    mix = np.diag(np.arange(1.0, every + 1.0))
    before = budget.lengths_of(situation := situation_of(rig), budget.every)
    budget = budget.with_estimate(OriginEstimate(mean, mix, 0.0, 1, POSES, mix**2, np.zeros(every - own)))
    # as many as there are variables in all: the restored ones are the last
    circle = 2.0 * np.pi / np.sqrt(12.0)
    assert budget.restored_origins() == [
        pytest.approx((2, 0.5, 1.5, mean[-2] * 1000.0, (every - 1) * 1000.0)),
        pytest.approx((7, 1.0, np.inf, mean[-1] * circle, every * circle)),
    ]
    np.testing.assert_allclose(budget.lengths_of(situation, budget.every), before @ mix)
    np.testing.assert_allclose(budget.lengths_of(situation, budget.origins), before[:, :, -own:])
    np.testing.assert_allclose(budget.offsets(TIMES), before[:, :, -own:] @ mean)
    assert budget.sources == (*sources[: every - own], *["origins of the channels"] * own)
    assert not any(budget.uniform[-own:])
    np.testing.assert_array_equal(budget.length_variance, budget.variance)
    budget = budget.with_estimate(None)
    assert budget.sources == sources
    np.testing.assert_allclose(budget.lengths_of(situation, budget.every), before)


def situation_of(rig: Rig) -> Situation:
    counts = counts_from_poses(rig, POSES, START, rig.observed)
    return Situation(TIMES, POSES, counts, np.zeros_like(counts))


@pytest.mark.parametrize(
    ("exact", "said"), [(True, "the counts' resolution only"), (False, "the counts' resolution and the sub-count offset at zeroing only")]
)
def test_counts_alone_are_said_to_be_counts_alone(exact: bool, said: str) -> None:
    data = cell().to_dict()
    for point in data["observation_point"]:
        point["drum"]["zero_exact"] = exact
    assert budget_of(rig_from_dict(data)).covers == f"{said}: the rig has no linked calibration"
    determined = budget_of(rig_from_dict(data), u_start=(0.3, 0.001)).covers
    assert determined.startswith("counts of half a unit")
    assert determined.endswith("the start pose: the rig has no linked calibration") == exact


def two_passes() -> Rig:
    data = cell().to_dict()
    for number, cable in enumerate(data["cable"]):
        cable["pass"] = 1 + number % 2
    return rig_from_dict(data)


def aligned(rig: Rig, *, u_time: bool = False) -> Lengths:
    counts = counts_from_poses(rig, POSES, START, rig.observed)
    determined = Counts(
        TIMES, rig.channels, counts * [rig.counter(o).count_sign for o in rig.observed], u_time_s=np.full(5, 1e-4) if u_time else None
    )
    return lengths_from_counts(Run(rig, START, (determined,), unstated="exact"))


def test_the_cables_of_a_pass_are_displaced_together_and_late_together() -> None:
    """A place of 0.1 mm per axis shortens a cable by its direction's part; a clock by its speed."""
    rig = two_passes()
    budget = budget_of(rig, repeatability_mm=0.1, clocks=(PassClock(), PassClock(0.001)))
    counts = counts_from_poses(rig, POSES, START, rig.observed)
    speed = np.arange(1.0, 31.0).reshape(5, 6)
    every = budget.lengths_of(Situation(TIMES, POSES, counts, speed), budget.every)
    step = 1e-4
    own = {name: [every[:, :, k] for k, n in enumerate(budget.sources) if n == name] for name in budget.sources}
    passage = np.array([c.passage for c in rig.cable])
    for number in (1, 2):
        for axis, found in enumerate(own[f"position of pass {number}"]):
            moved = POSES.copy()
            moved[:, axis] += step
            rate = (span_lengths(rig, moved) - span_lengths(rig, POSES)) / step
            np.testing.assert_allclose(found, np.where(passage == number, 0.1 * rate, 0.0), atol=1e-6)
    (late,) = own["clock of pass 2"]
    np.testing.assert_allclose(late, np.where(passage == 2, 0.001 * speed, 0.0), rtol=1e-12)
    assert set(own) == {"position of pass 1", "position of pass 2", "clock of pass 2"}


def test_one_motion_is_what_passes_repeat_exactly() -> None:
    assert budget_of(two_passes()).one_motion
    assert not budget_of(two_passes(), repeatability_mm=0.1).one_motion
    assert not budget_of(cell()).one_motion
    # which is nothing to a single pass
    assert budget_of(cell(), repeatability_mm=0.1).sources == ()
    assert budget_of(two_passes()).sources == ()


def test_a_start_from_lengths_errs_by_each_of_them() -> None:
    """Absolute encoders count from no start."""
    rig = rig_of(encoders=True)
    budget = budget_of(rig, u_start=(0.0, 0.0, 0.02))
    np.testing.assert_allclose(lengths(budget, rig)["start pose"], np.repeat(0.02 * np.eye(6, 8)[:, None], 5, axis=1), atol=1e-15)
    by_pose = np.array(lengths(budget_of(rig, u_start=(0.3, 0.001)), rig)["start pose"])
    assert by_pose.shape == (6, 5, 8)
    assert (by_pose[:, :, :6] != 0.0).any(axis=(0, 1)).all()
    np.testing.assert_array_equal(by_pose[:, :, 6:], 0.0)
    # one standard deviation of each, rotation [rad] first: against differences at the start
    for c in range(6):
        d = np.zeros((1, 6))
        d[0, c] = 1e-5
        rate = (span_lengths(rig, se3.displaced(START[None], d)) - span_lengths(rig, se3.displaced(START[None], -d)))[0] / 2e-5
        np.testing.assert_allclose(by_pose[c, 0, :6], rate * (0.001 if c < 3 else 0.3), rtol=1e-5, atol=1e-9)


def test_what_the_rig_errs_by_cancels_where_counting_began_unless_the_start_came_from_lengths() -> None:
    rig = rig_from_dict(rig_of(encoders=True).to_dict() | {"u_attachment_mm": 0.2})
    np.testing.assert_array_equal(POSES[0], START)
    stated = np.array(lengths(budget_of(rig, u_start=(0.3, 0.001)), rig)["dimensions as stated"])
    assert len(stated) == 9
    np.testing.assert_allclose(stated[:, 0, :6], 0.0, atol=1e-12)
    from_lengths = np.array(lengths(budget_of(rig, u_start=(0.0, 0.0, 0.02)), rig)["dimensions as stated"])
    # a cable is longer or shorter by all that its point is off along it
    np.testing.assert_allclose(np.linalg.norm(from_lengths[:, 0, :6], axis=0), 0.2, rtol=1e-9)
    # elsewhere they differ by what does not cancel
    np.testing.assert_allclose((from_lengths - stated)[:, :, :6], np.repeat(from_lengths[:, :1, :6], len(TIMES), axis=1), atol=1e-12)


def test_readings_are_weighed_by_their_zero_phase_until_the_run_has_told_it() -> None:
    """A count of c mm scatters by c^2/12, and its zero phase by as much again where a counter was zeroed anywhere."""
    budget = budget_of(rig_of(encoders=False, zero_exact=False))
    own = np.full(6, COUNT_MM**2 / 12.0)
    anywhere = own * [1.0, 2.0, 1.0, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(budget.length_variance, anywhere)
    np.testing.assert_allclose(budget.weights, np.sqrt(own[0] / anywhere))
    budget = budget.with_estimate(OriginEstimate(np.zeros(1), np.eye(1), 0.0, 1, POSES, np.eye(1), np.zeros(0)))
    np.testing.assert_allclose(budget.length_variance, own)
    np.testing.assert_allclose(budget.weights, 1.0)


def test_a_start_that_is_drawn_from_lengths_has_drawn_lengths() -> None:
    rig = cell()
    budget = budget_of(rig, u_start=(0.0, 0.0, 0.02))
    z = np.random.default_rng(4).standard_normal(6)
    drawn = budget.drawn_start(np.random.default_rng(4), rig.cable_rows())
    expected = span_lengths(rig, START[None])[0] + 0.02 * z
    np.testing.assert_allclose(span_lengths(rig, drawn[None])[0], expected, atol=1e-9)
    assert drawn.shape == (7,)
    # that of a stated pose is displaced, rotation first
    stated = budget_of(rig, u_start=(0.3, 0.001)).drawn_start(np.random.default_rng(4), rig.cable_rows())
    np.testing.assert_allclose(se3.displacement(stated, START), z * np.repeat([0.001, 0.3], 3), atol=1e-12)


def test_origins_are_the_start_the_phases_and_the_zeros_and_stand_last() -> None:
    data = rig_of(encoders=True, u_run_out_mm=0.02).to_dict()
    for point in data["observation_point"]:
        point["drum"]["zero_exact"] = False
    rig = rig_from_dict(data)
    budget = budget_of(rig, u_start=(0.3, 0.0))
    # phases of six drums and of six zeroings; absolute encoders have none
    assert budget.origin_names == ("start pose",) * 3 + ("zero phase",) * 6 + ("zero",) * 2
    assert budget.sources[-11:] == budget.origin_names
    assert set(budget.sources[:-11]) & set(budget.origin_names) == set()
    assert len(budget.sources) > 11
    assert [n for n, uniform in zip(budget.sources, budget.uniform, strict=True) if uniform] == ["zero phase"] * 6
    before = budget.uniform
    budget = budget.with_estimate(None)
    assert budget.uniform == before
    assert not budget.calibrated
    out = budget_of(rig, begun=np.zeros(8))
    assert out.origin_names == ("zero phase",) * 6 + ("unknown start",) * 6 + ("zero",) * 2


@pytest.mark.parametrize("chunk", [2, 100])
@pytest.mark.parametrize("phased", [False, True])
@pytest.mark.parametrize("timed", [False, True])
def test_covariances_in_pieces_are_those_of_the_factors(monkeypatch: pytest.MonkeyPatch, chunk: int, phased: bool, timed: bool) -> None:
    """Of all that a run may have, and after it told of its origins."""
    monkeypatch.setattr("lmeasure.trajectory.uncertainty.budget.CHUNK", chunk)
    data = cell().to_dict()
    for point in data["observation_point"]:
        point["drum"] |= {"zero_exact": not phased, "u_run_out_mm": 0.02}
    rig = rig_from_dict(data)
    budget, found = budget_of(rig, u_start=(0.3, 0.001)), aligned(rig, u_time=timed)
    unused = np.zeros((5, 6), np.bool_)
    for determined in (False, True):
        if determined:
            own, every = len(budget.origin_names), len(budget.sources)
            mix = np.tril(np.arange(1.0, every**2 + 1.0).reshape(every, every)) / every**2
            budget = budget.with_estimate(OriginEstimate(np.zeros(own), mix, 0.0, 1, POSES, mix @ mix.T, np.zeros(every - own)))
        whole = budget.of(Situation(TIMES, POSES, found.counts, budget.speed_mm_s(found)), found.u_mm, unused)
        random, systematic, assumed_mm = budget.covariances(POSES, found, unused)
        np.testing.assert_allclose(random, whole.random, rtol=1e-12)
        np.testing.assert_allclose(systematic, whole.systematic, rtol=1e-9, atol=1e-15)
        assert (np.einsum("nii->ni", systematic) > 0.0).all()
        # of poses that are not known nothing is
        lost = POSES.copy()
        lost[1] = np.nan
        assert not assumed_mm.any()
        for part in budget.covariances(lost, found, unused):
            assert np.isnan(part[1]).all()
            assert np.isfinite(part[[0, 2, 3, 4]]).all()


def test_without_sources_nothing_is_systematic() -> None:
    rig = cell()
    budget, found = budget_of(rig), aligned(rig)
    random, systematic, _ = budget.covariances(POSES, found)
    assert (np.einsum("nii->ni", random) > 0.0).all()
    np.testing.assert_array_equal(systematic, 0.0)
    assert budget.of(Situation(TIMES, POSES, found.counts, found.counts)).factors.shape == (5, 6, 0)


def test_which_way_cables_went_counts_where_there_is_play() -> None:
    """A way back of a few recorded counts is a flicker, whatever the scale makes of them."""
    assert budget_of(cell()).travel(aligned(cell())) is None
    for play in ({"backlash_counts": PLAY}, {"u_backlash_counts": PLAY}):
        rig = rig_of(encoders=False, scale=4.0, **play)
        budget, found = budget_of(rig), aligned(rig)
        assert budget.travel(found) is not None
        turns = np.zeros((4, 6))
        turns[:, 1] = [0.0, 100.0, 99.0, 95.0]
        way = budget.travel(replace(found, counts=turns))
        assert way is not None
        # one count of the drum are four recorded ones, a way back of two and a half of which is seen
        assert way[:, 1].tolist() == [0.0, 1.0, -1.0, -1.0]
