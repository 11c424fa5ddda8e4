"""The interim check: sound instruments pass as often as stated, and what has moved is named where the data can tell it."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.api import reconstruct
from lmeasure.calibration import Campaign, Distance, calibrate
from lmeasure.core import TrajectoryError, se3
from lmeasure.procedures import Checked, Limits, check_instrument, verdict_text
from lmeasure.recording import Poses, Run
from lmeasure.report.interim import verdict
from lmeasure.rig import CalibrationRecord, Rig, rig_from_dict, with_values
from lmeasure.sensors import counts_from_poses, recorded_from_counts
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
TRUTH = Path(__file__).parents[1] / "authorities" / "truth"


def true_rig(*, swivels: bool = True) -> Rig:
    data = cell_rig(3).to_dict()
    if swivels:
        data["swivel"] = [
            {"point": f"B{i + 1}", "channel": f"sw{i + 1}", "counts_per_revolution": 2**17, "zero_deg": 20.0 * i, "u_zero_deg": 1.0}
            for i in range(6)
        ]
    return rig_from_dict(data)


@cache
def calibrated(*, swivels: bool = True) -> tuple[Rig, CalibrationRecord]:
    """A rig and its record by 24 poses known to 0.02 mm."""
    rig, rng = true_rig(swivels=swivels), np.random.default_rng(1)
    n = 24
    rows = np.column_stack([rng.uniform(-300, 300, (n, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (n, 3))).as_quat()])
    counts = recorded_from_counts(rig, counts_from_poses(rig, rows, rows[0], rig.observed), rig.observed)
    stated = rows.copy()
    stated[:, :3] += rng.normal(0, 0.02, (n, 3))
    poses = Poses(tuple(str(i) for i in range(n)), stated, np.full(n, 0.02), np.zeros(n))
    found = calibrate(Campaign(rig, poses, rig.observed, counts, np.zeros(len(rig.observed), np.int64)))
    return found.rig, found.record


PLACES = [(200.0, 100.0, 50.0), (-150.0, 200.0, -100.0), (100.0, -200.0, 150.0), (-200.0, -100.0, -50.0)]


def run_of(true: Rig, seed: int = 0, *, swivels: bool = True, off_mm: float = 0.0) -> tuple[Run, np.ndarray]:
    """A run of two rounds over four places and home, by a rig that counts as the true one does."""
    rng = np.random.default_rng(seed)
    legs = []
    for places in (PLACES, [(0.0, 0.0, 0.0)], PLACES[::-1], [(0.0, 0.0, 0.0)]):
        for place in places:
            there = np.array(place) + rng.normal(0, 0.01, 3) + (off_mm if not any(place) else 0.0)
            turn = Rotation.from_rotvec(np.array(place) / 1000.0)
            legs.append(Leg(se3.pose(there, turn), 800.0, 60.0, 0.5))
    time_s, poses = smooth_path(HOME, legs, 50.0)
    # it stands still before it goes
    time_s, poses = np.r_[np.arange(30) / 50.0, time_s + 0.6], np.vstack([np.repeat(poses[:1], 30, axis=0), poses])
    simulated = simulate_run(true, time_s, poses, noise_mm=0.0, rng=rng)
    rig, record = calibrated(swivels=swivels)
    return replace(simulated.run, rig=rig, calibration=record), poses


LIMITS = Limits(repeatability_mm=0.01)


def checked(true: Rig, seed: int = 0, distances: tuple[Distance, ...] = (), **options: bool | float) -> Checked:
    return check_instrument(run_of(true, seed, **options)[0], distances, LIMITS)  # type: ignore[arg-type]


def test_a_sound_instrument_passes_and_says_what_it_saw() -> None:
    found = checked(true_rig(), 1, (Distance("P1", "P2", float(np.linalg.norm(PLACES[0])), 0.02),))
    assert found.passed
    assert not found.causes
    assert len(found.stops) == 11
    kinds = [c.kind for c in found.closures]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {"return": 1, "revisit": 5, "reversal": 6, "drift": 6, "distance": 1}
    assert all(0.0 < c.u95_mm < 0.2 for c in found.closures)
    assert found.agreement is not None
    assert found.agreement.freedom == 66
    assert verdict_text(found).startswith("passed")


@pytest.mark.parametrize(("point", "mm"), [("B3", 0.3), ("B3", 1.0), ("B5", 1.0)])
def test_a_point_that_moved_is_named_with_its_distance(point: str, mm: float) -> None:
    rig = true_rig()
    place, way = rig.point(point).position_mm, np.array([2.0, -2.0, 1.0]) / 3.0 * mm
    moved = with_values(rig, {f"{point}.{k}": v + d for k, v, d in zip(("x_mm", "y_mm", "z_mm"), place, way, strict=True)})
    found = checked(moved, 2)
    named = {(c.kind, c.name): c for c in found.causes}
    cause = named["point", point]
    assert abs(cause.size - mm) < 4.0 * cause.u < 1.0
    # by a third of a millimetre only its own encoder could look like it; by more, nothing
    assert set(named) <= {("point", point), ("encoder", "sw3")} if mm < 1.0 else set(named) == {("point", point)}
    assert f"point {point} has moved" in verdict_text(found)


def test_other_changes_are_named_for_what_they_are() -> None:
    rig = true_rig()
    turned = with_values(rig, {"sw4.zero_deg": 60.0 + 0.05})
    found = checked(turned, 3)
    assert [(c.kind, c.name) for c in found.causes] == [("encoder", "sw4")]
    assert abs(found.causes[0].size - 0.05) < 0.01
    data = rig.to_dict()
    data["observation_point"][1]["drum"]["count_length_mm"] *= 1.002
    found = checked(rig_from_dict(data), 4)
    assert [(c.kind, c.name) for c in found.causes] == [("drum", "B2")]
    assert abs(found.causes[0].size - 0.2) < 0.05


def test_six_cables_alone_cannot_tell_what_moved_but_a_known_distance_fails() -> None:
    rig = true_rig(swivels=False)
    data = rig.to_dict()
    for p in data["observation_point"]:
        p["drum"]["count_length_mm"] *= 1.002
    known = (Distance("P2", "P3", float(np.linalg.norm(np.subtract(PLACES[0], PLACES[1]))), 0.02),)
    found = checked(rig_from_dict(data), 5, known, swivels=False)
    assert found.agreement is None
    assert [c.kind for c in found.failed] == ["distance"]
    assert "cannot be determined" in verdict_text(found)
    assert "six" in found.notes


def test_a_start_with_another_orientation_is_not_taken_for_a_part_that_moved() -> None:
    """Half a turn about x was "point B2 has moved 419 mm"; a start that the channels tell is said to be the start."""
    run, _ = run_of(true_rig(), 1)
    start = np.array(run.known_start)
    upside_down = check_instrument(replace(run, start=np.array([*start[:3], 1.0, 0.0, 0.0, 0.0])), (), LIMITS)
    for said in (verdict_text(upside_down), verdict(upside_down, "en")):
        assert said.lower().startswith("no result: the run differs by 4")
        assert "Most likely the start pose is wrong" in said
    assert "начальная поза" in verdict(upside_down, "ru")
    beside = check_instrument(replace(run, start=start + [100.0, 0, 0, 0, 0, 0, 0]), (), LIMITS)
    assert verdict_text(beside).startswith("the start pose differs from the stated one by 102 mm")


def one_point(*, place: tuple[float, float, float], drum: float = 1.0) -> Run:
    """A run of four cables to one point of a tool; the first drum pays out `drum` times as much as its rig says."""
    data = cell_rig(3).to_dict()
    data["cable"] = [c | {"to": "P1"} for c in data["cable"]][:4]
    data["observation_point"], data["tool"] = data["observation_point"][:4], {"P1": place}
    rig = rig_from_dict(data)
    legs = [Leg(np.array([*there, 0.0, 0.0, 0.0, 1.0]), 800.0, 60.0, 0.5) for there in (*PLACES, (0, 0, 0), *PLACES[::-1], (0, 0, 0))]
    time_s, poses = smooth_path(HOME, legs, 50.0)
    time_s, poses = np.r_[np.arange(30) / 50.0, time_s + 0.6], np.vstack([np.repeat(poses[:1], 30, axis=0), poses])
    data["observation_point"][0]["drum"]["count_length_mm"] *= drum
    return replace(simulate_run(rig_from_dict(data), time_s, poses, noise_mm=0.0, rng=np.random.default_rng(2)).run, rig=rig)


def test_cables_to_one_point_are_checked_by_its_position() -> None:
    """Every stop was taken for one place: four cables' readings are fewer than six."""
    found = check_instrument(one_point(place=(30.0, -20.0, 80.0)), (), LIMITS)
    assert found.stops.place.tolist() == [0, 1, 2, 3, 4, 0, 4, 3, 2, 1, 0]
    np.testing.assert_allclose(found.stops.poses[1, :3], np.add(PLACES[0], (30.0, -20.0, 80.0)), atol=0.05)
    assert found.passed
    wrong = check_instrument(one_point(place=(30.0, -20.0, 80.0), drum=1.003), (), LIMITS)
    assert wrong.disagrees
    assert ("drum", "B1") in {(c.kind, c.name) for c in wrong.causes}


def test_a_cable_that_was_not_read_is_named() -> None:
    """Only the stops before it were checked, and they passed."""
    run, _ = run_of(true_rig(swivels=False), 1, swivels=False)
    counts = run.passes[0]
    recorded = counts.recorded.copy()
    recorded[counts.time_s > 2.0, 1] = np.nan
    lost = replace(counts, recorded=recorded)
    with pytest.raises(TrajectoryError, match=r"ch2 has no counts in .* % of the run, first at 2.02 s"):
        check_instrument(replace(run, passes=(lost,)), (), LIMITS)


def test_a_robot_that_does_not_come_back_fails_its_return() -> None:
    found = checked(true_rig(), 6, off_mm=0.4)
    assert {c.kind for c in found.failed} >= {"return"}
    assert not found.disagrees


def test_false_alarms_are_as_rare_as_stated() -> None:
    """Of 12 sound checks with an alarm rate of 25 %: no more than a binomial law exceeds four times in ten thousand."""
    alarms = [not check_instrument(run_of(true_rig(), 100 + seed)[0], (), replace(LIMITS, alarm=0.25)).passed for seed in range(12)]
    assert sum(alarms) <= 8


def test_what_is_no_check_is_refused() -> None:
    run, _ = run_of(true_rig(), 0)
    with pytest.raises(TrajectoryError, match="P9' is none of the positions"):
        check_instrument(run, (Distance("P1", "P9", 1.0, 0.1),), LIMITS)
    short = replace(run, passes=tuple(replace(p, time_s=p.time_s[:20], recorded=p.recorded[:20]) for p in run.passes))
    with pytest.raises(TrajectoryError, match=r"is at rest \d time"):
        check_instrument(short, (), LIMITS)


@pytest.mark.parametrize("stated", [True, False])
def test_what_a_calibration_leaves_uncertain_passes_for_no_slip(stated: bool) -> None:
    """Runs by a calibrated rig: all samples `ok`, no channel said to have slipped, and errors as stated."""
    run, poses = run_of(true_rig(), 2)
    found = reconstruct(run if stated else replace(run, start=None))
    assert (found.status == 0).all()
    assert not any("slipped" in str(note) for note in found.notes)
    error = se3.displacement(found.poses, poses)
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.random + found.systematic), error)
    # 0.1 and 99.9 % of six degrees of freedom
    assert 0.38 < np.median(square) < 22.5


def test_a_run_that_begins_nobody_knows_where_is_checked_as_one_with_a_start() -> None:
    """Absolute encoders tell the start: closures are the same, and what moved is named; of the freedom the start takes six."""
    rig = true_rig()
    run, _ = run_of(rig, 1)
    known, found = check_instrument(run, (), LIMITS), check_instrument(replace(run, start=None), (), LIMITS)
    assert found.passed
    assert [c.name for c in found.closures] == [c.name for c in known.closures]
    for here, there in zip(found.closures, known.closures, strict=True):
        assert abs(here.value_mm - there.value_mm) < 0.01
        assert here.u95_mm == pytest.approx(there.u95_mm, rel=0.05)
    assert found.agreement is not None
    assert known.agreement is not None
    assert found.agreement.freedom == known.agreement.freedom - 6
    np.testing.assert_allclose(found.stops.poses[:, :3], known.stops.poses[:, :3], atol=0.3)
    assert not any(c.kind == "start" for c in found.agreement.causes)
    place = rig.point("B3").position_mm
    moved = with_values(rig, {"B3.x_mm": place[0] + 0.7})
    off = check_instrument(replace(run_of(moved, 2)[0], start=None), (), LIMITS)
    assert off.disagrees
    assert ("point", "B3") in {(c.kind, c.name) for c in off.causes}


def test_a_run_without_start_and_absolute_encoders_says_what_to_state() -> None:
    run, _ = run_of(true_rig(swivels=False), 1, swivels=False)
    with pytest.raises(TrajectoryError, match=r"start pose of this run is not known.*state \[start\]"):
        check_instrument(replace(run, start=None), (), LIMITS)
