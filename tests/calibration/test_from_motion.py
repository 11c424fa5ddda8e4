"""Calibrations by a motion of which no pose is known, with one length, and records that go on from ordinary runs."""

import csv
import gzip
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from in_process import ran, refused
from scipy import stats
from scipy.spatial.transform import Rotation
from test_with_encoders import campaign_of as campaign_at, swivelled

from lmeasure.calibration import CalibrationSettings, Distance, calibrate, continued, unknowns_of
from lmeasure.calibration.campaign.known_lengths import distance_of
from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.run_samples import campaign_of
from lmeasure.core import CalibrationError, FloatArray, se3
from lmeasure.recording import Run, read_run, write_run
from lmeasure.rig import CalibrationRecord, Rig, rig_from_dict, value_of, with_values
from lmeasure.sensors import phased, stated
from lmeasure.simulation import Leg, simulate_run, smooth_path

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])


def truth_of(name: str) -> FloatArray:
    with gzip.open(TRUTH / name / "truth.csv.gz", "rt") as file:
        rows = list(csv.reader(file))[1:]
    return np.array([[float(v) for v in row[:8]] for row in rows])


def shaken(rig: Rig, mm: float, deg: float, seed: int = 1) -> Rig:
    """The rig as a tape measure and a protractor tell it."""
    rng, data = np.random.default_rng(seed), rig.to_dict()
    for p in data["observation_point"]:
        p["position_mm"] = [float(v) for v in np.array(p["position_mm"]) + rng.uniform(-mm, mm, 3)]
        p["guide_alpha_deg"] += float(rng.uniform(-deg, deg))
        p["guide_beta_deg"] += float(rng.uniform(-deg, deg))
        p |= {"u_position_mm": mm / 2, "u_guide_deg": deg / 2}
    for s in data.get("swivel", []):
        s["u_zero_deg"] = 1.0
    return rig_from_dict(data)


def test_a_motion_without_a_pose_calibrates_six_cables_and_six_encoders() -> None:
    run, true = read_run(TRUTH / "swivel-run"), truth_of("swivel-run")
    begun = true[0, 1:] + np.r_[5.0, -3.0, 4.0, 0, 0, 0, 0]
    campaign = campaign_of(replace(run, rig=shaken(run.rig, 10.0, 2.0), start=begun), 40)
    before = campaign.poses.rows[1:, :3]
    found = calibrate(campaign, CalibrationSettings(self_calibration=True))
    assert found.record.rank == found.record.unknowns - 6
    assert 0.7 < found.record.noise["chi_squared"] / found.record.noise["degrees_of_freedom"] < 1.3
    # the same shape as the true motion, wherever the frame is
    names = found.campaign.poses.names[1:]
    right = true[[int(np.argmin(np.abs(true[:, 0] - float(n.split()[0])))) for n in names], 1:4]
    off = [_off(places, right) for places in (before, found.campaign.poses.rows[1:, :3])]
    assert off[0] > 0.2
    assert off[1] < 0.02


def _off(a: FloatArray, b: FloatArray) -> float:
    """Root mean square distance [mm] of places (n, 3) after the best motion of the whole."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    turn, _ = Rotation.align_vectors(b, a)
    return float(np.sqrt(np.mean(np.sum((turn.apply(a) - b) ** 2, axis=1))))


def test_one_length_gives_the_scale_that_counts_do_not() -> None:
    """Every drum is half a per cent larger than stated; a length of 0.02 mm says so."""
    true = swivelled(2)
    campaign, rows = campaign_at(true, 24, 4, u_mm=2.0)
    data = campaign.rig.to_dict()
    for p in data["observation_point"]:
        p["drum"]["count_length_mm"] *= 0.995
        p["drum"]["u_scale"] = 0.01
    data["u_attachment_mm"] = 0.3
    campaign = replace(campaign, rig=rig_from_dict(data))
    known = float(np.linalg.norm(rows[3, :3] - rows[7, :3]))
    names = campaign.poses.names
    solve = ("position", "guide", "scale")
    blind, determined = (
        calibrate(campaign, CalibrationSettings(self_calibration=True, solve=solve, distances=given))
        for given in ((), (Distance(names[3], names[7], known, 0.02),))
    )
    way = np.linalg.norm(determined.campaign.poses.rows[3, :3] - determined.campaign.poses.rows[7, :3])
    assert abs(way - known) < 0.05
    # the other lengths follow, and are known better than before
    away = [np.linalg.norm(p[1:, :3] - p[0, :3], axis=1) for p in (blind.campaign.poses.rows, determined.campaign.poses.rows, rows)]
    off = [found - away[2] for found in away[:2]]
    assert np.sqrt(np.mean(off[1] ** 2)) < 0.3 * max(0.3, np.sqrt(np.mean(off[0] ** 2)))
    u = [{p.name: p.u for p in f.record.parameters}["B1.scale"] for f in (blind, determined)]
    assert u[1] < u[0]


def test_derivatives_of_a_distance_are_those_of_finite_differences() -> None:
    campaign, _ = campaign_at(swivelled(1), 5, 0)
    model = model_of(campaign, unknowns_of(campaign, ("position", "guide")), tuple(range(6)), "rig")
    requested = Distance("2", "4", 100.0, 0.1)
    _, g = distance_of(model, model.start, requested)
    for i in np.flatnonzero(g):
        step = np.zeros(len(g))
        step[i] = 1e-4
        numeric = (distance_of(model, model.start + step, requested)[0] - distance_of(model, model.start - step, requested)[0]) / 2e-4
        assert abs(g[i] - numeric) < 1e-6
    for wrong, text in ((Distance("2", "9", 1.0, 0.1), "'9' is none of the counted poses"), (Distance("2", "2", 1.0, 0.1), "are one pose")):
        with pytest.raises(CalibrationError, match=text):
            distance_of(model, model.start, wrong)


@cache
def recorded(unstated: Literal["exact", "typical"], seed: int = 3) -> tuple[Rig, Rig, CalibrationRecord]:
    """The true rig, and the calibrated one with its record, by 14 poses known to 0.05 mm; typical: its dimensions err by typical sizes."""
    true = swivelled(seed).model_copy(update={"unstated": unstated})
    dimensions: dict[str, float] = {}
    if unstated == "typical":
        rng, solved = np.random.default_rng(seed), unknowns_of(campaign_at(true, 2, seed)[0], ()).names
        errors = {n: v.u for v in stated(true, None, solved) if v.kind.adds is not None for n in v.names}
        dimensions = {name: value_of(true, name) or 0.0 for name in errors}
        begun = np.tile(campaign_at(true, 14, seed)[1][0], (len(true.cable), 1))
        true = with_values(phased(true, (*errors,), begun, true.cable), {n: dimensions[n] + u * rng.normal() for n, u in errors.items()})
    campaign = campaign_at(true, 14, seed)[0]
    found = calibrate(replace(campaign, rig=with_values(campaign.rig, dimensions)))
    return true, found.rig, found.record


def ordinary(true: Rig, seed: int = 0) -> Run:
    """A motion over the cell, simulated by the true rig and said to be of the calibrated one."""
    rng, (_, rig, record) = np.random.default_rng(seed), recorded(true.unstated)
    legs = [
        Leg(se3.pose(rng.uniform(-250, 250, 3), Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3))), 800.0, 60.0, 0.0) for _ in range(12)
    ]
    time_s, poses = smooth_path(HOME, legs, 100.0)
    return replace(simulate_run(true, time_s, poses, noise_mm=0.0, rng=rng).run, rig=rig, calibration=record)


@pytest.mark.parametrize("unstated", ["exact", "typical"])
def test_a_record_goes_on_from_a_run_and_knows_more(unstated: Literal["exact", "typical"]) -> None:
    true, _, before = recorded(unstated)
    assert bool(before.dimensions) == (unstated == "typical")
    campaign = campaign_of(ordinary(true), 30)
    found = continued(campaign, before)
    # the run was zeroed elsewhere than the calibration, and nobody stated where axial offsets hold
    here = continued(campaign, before.model_copy(update={"zero_length_mm": {}}))
    assert here.record.names == found.record.names
    assert (here.chi_squared > found.chi_squared) == (unstated == "typical")
    assert found.moved is None
    assert found.probability > 1e-3
    after = found.record
    both = [
        {p.name: (p.value, p.u) for p in record.parameters} | {d.name: (d.value, d.u) for d in record.dimensions}
        for record in (before, after)
    ]
    assert all(both[1][name][1] <= old[1] * (1 + 1e-9) for name, old in both[0].items())
    places = [np.sum([p.u**2 for p in record.parameters if p.name.endswith("_mm")]) for record in (before, after)]
    assert places[1] < 0.9 * places[0]
    assert all(value_of(found.rig, d.name) == pytest.approx(d.value, rel=1e-12) for d in after.dimensions)
    # and what it says is consistent with the truth
    off, C = np.array([both[1][name][0] - (value_of(true, name) or 0.0) for name in after.names]), after.joint_matrix()
    width = np.sqrt(np.diag(C))
    chi2 = float(off / width @ np.linalg.solve(C / np.outer(width, width), off / width))
    assert stats.chi2.ppf(1e-4, len(off)) < chi2 < stats.chi2.ppf(1 - 1e-4, len(off))


def test_a_motion_alone_finds_dimensions() -> None:
    campaign = campaign_at(recorded("typical")[0], 10, 3, u_mm=2.0)[0]
    record = calibrate(campaign, CalibrationSettings(self_calibration=True)).record
    u = [(d.u, d.prior_u) for d in record.dimensions if d.name.endswith("count_length_mm")]
    assert len(u) == 6
    assert all(now < before for now, before in u)


def test_a_rig_that_has_moved_is_refused_and_what_moved_is_named(tmp_path: Path) -> None:
    true, rig, _ = recorded("exact")
    place = true.point("B5").position_mm
    moved = with_values(true, {"B5.x_mm": place[0] + 1.0, "B5.y_mm": place[1] - 1.0, "B5.z_mm": place[2] + 1.0})
    run = ordinary(moved, 1)
    write_run(tmp_path / "run", run)
    out = tmp_path / "out"
    result = refused("calibrate", tmp_path / "run", "--continue", "--out", out)
    assert "contradicts the record" in result
    assert "B5" in result
    assert not (out / "rig.toml").exists()
    assert rig.name == run.rig.name


def test_counts_that_were_lost_are_no_point_that_moved() -> None:
    true, _, record = recorded("exact")
    run = ordinary(true, 2)
    counts = run.passes[0]
    readings, half = counts.recorded.copy(), len(counts.time_s) // 2
    readings[half:, 8] += 40.0
    found = continued(campaign_of(replace(run, passes=(replace(counts, recorded=readings),)), 30), record)
    assert found.moved is not None
    assert "channel sw3 reads" in found.moved
    # to the sample of the thirty before it and behind it
    behind = float(found.moved.split(" s on")[0].rsplit(" ", 1)[1])
    assert abs(behind - counts.time_s[half]) < 0.15 * counts.time_s[-1]


def test_commands_write_a_new_rig_or_one_line(tmp_path: Path) -> None:
    true, _, _ = recorded("typical")
    write_run(tmp_path / "run", ordinary(true, 2))
    requested = ["calibrate", tmp_path / "run", "--out"]
    assert "the region of the predicted lengths" in ran(*requested, tmp_path / "new", "--continue", "--samples", "20")
    assert (tmp_path / "new" / "rig.toml").exists()
    for more, text in (
        ([], "a run has no reference poses"),
        (["--self", "--distance", "start,99,100,0.1"], "99 s lies outside of"),
        (["--continue", "--rig", tmp_path / "new" / "rig.toml"], "the record already contains its counts"),
    ):
        assert text in refused(*requested, tmp_path / "x", *more)
    refused(*requested, tmp_path / "x", "--self", "--distance", "start,100,0.1", code=2)
    assert not (tmp_path / "x" / "rig.toml").exists()
