"""Reference poses chosen in advance: the prediction against the estimator itself, the search against trying everything."""

import math
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import ran
from planned import CELL, IDENTITY, RIG, random_rows, two_drums
from scipy.spatial.transform import Rotation
from zeroed import zeroed_exactly

import lmeasure as lm
from lmeasure.calibration import (
    Campaign,
    Instrument,
    Limits,
    Model,
    Plan,
    PlanSettings,
    Region,
    Usable,
    calibrate,
    extended,
    plan_poses,
    read_campaign,
)
from lmeasure.calibration.plan.candidates import APART, candidates
from lmeasure.calibration.solve.noise import Noise
from lmeasure.calibration.solve.unknowns import rig_with
from lmeasure.cli.app import main as command
from lmeasure.core import CalibrationError
from lmeasure.estimation import Criterion, empty, estimated_covariance, fit, grown, improved, parameter_information
from lmeasure.io import write_table
from lmeasure.io.tables import read_table
from lmeasure.recording import Poses, pose_columns, read_poses
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
from lmeasure.sensors import counts_from_poses, recorded_from_counts, span_lengths

TRUTH = Path(__file__).parent.parent / "authorities" / "truth"
NEVER = np.zeros(6)  # a robot that comes back exactly


def sigma_of(u_position_mm: float, u_rotation_rad: float) -> np.ndarray:
    return np.repeat([u_rotation_rad, u_position_mm], 3)


def campaign_of(rig: Rig, rows: np.ndarray, u_position_mm: float, u_rotation_rad: float) -> Campaign:
    """Exact counts, not rounded, at poses whose uncertainty is stated."""
    n = len(rows)
    poses = Poses(tuple(str(i + 1) for i in range(n)), rows, np.full(n, u_position_mm), np.full(n, u_rotation_rad))
    return Campaign(rig, poses, rig.cable, counts_from_poses(rig, rows, rows[0]), np.zeros(len(rig.cable), np.int64))


def estimated(campaign: Campaign, instrument: Instrument) -> tuple[np.ndarray, int]:
    """The estimator's own covariance in prior widths and rank, from a fit that starts at its optimum."""
    model = Model(campaign, instrument.unknowns)
    found = fit(model, model.start)
    return found.covariance / np.outer(instrument.unknowns.width, instrument.unknowns.width), found.rank


@pytest.fixture(scope="module")
def eight() -> Plan:
    return plan_poses(RIG, PlanSettings(8, CELL))


@pytest.mark.parametrize(("u_position_mm", "u_rotation_rad"), [(0.0, 0.0), (0.05, 2e-4)])
def test_information_summed_over_poses_is_the_estimators(u_position_mm: float, u_rotation_rad: float) -> None:
    instrument = Instrument(RIG, RIG.cable, ("position", "guide", "radius"), sigma_of(u_position_mm, u_rotation_rad), visit=NEVER)
    rows = random_rows(12, 1)
    A = instrument.blocks(rows[1:], instrument.zero(rows[0])).reshape(-1, 36 + 6)
    covariance, rank = estimated_covariance(parameter_information(A.T @ A, 36))
    expected, expected_rank = estimated(campaign_of(RIG, rows, u_position_mm, u_rotation_rad), instrument)
    assert rank == expected_rank
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-9)


def test_recorded_poses_with_gaps_and_several_zero_poses_count_in_full() -> None:
    instrument = Instrument(RIG, RIG.cable, ("position", "guide"), sigma_of(0.05, 2e-4), visit=NEVER)
    rows = random_rows(11, 2)
    whole = campaign_of(RIG, rows, 0.05, 2e-4)
    zero = np.array([0, 2, 0, 0, 2, 0])
    counts = whole.counts.copy()
    for j in np.flatnonzero(zero):
        counts[:, j] = counts_from_poses(RIG, rows, rows[2], (RIG.cable[j],))[:, 0]
    counts[4, 1] = counts[5, 3] = np.nan
    full = Campaign(RIG, whole.poses, RIG.cable, counts, zero)
    first = Poses(whole.poses.names[:8], rows[:8], whole.poses.u_position_mm[:8], whole.poses.u_rotation_rad[:8])
    before, zeros = instrument.recorded(Campaign(RIG, first, RIG.cable, counts[:8], zero))
    more = instrument.blocks(rows[8:], zeros).reshape(-1, len(before))
    covariance, rank = estimated_covariance(parameter_information(before + more.T @ more, 30))
    expected, expected_rank = estimated(full, instrument)
    assert rank == expected_rank
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-9)


def test_all_that_recorded_poses_share_counts_in_full() -> None:
    """Per-axis covariances, visits (one of the zero pose), the robot's repeatability, dwells, two passes, two zero poses."""
    data = RIG.to_dict()
    for cable in data["cable"][4:]:
        cable["pass"] = 2
    rig = rig_from_dict(data)
    rng, n, visit = np.random.default_rng(5), 8, np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02, 0.02])
    first, later = random_rows(n, 6), random_rows(3, 7)
    reference = np.array([*range(n), 2, 0, 5])
    root = rng.normal(size=(n, 6, 6)) * np.array([1e-4, 1e-4, 1e-4, 0.03, 0.03, 0.03])[:, None]
    C = (root @ root.transpose(0, 2, 1))[reference]
    sigma = np.sqrt(np.einsum("nii->ni", C))
    names = tuple(str(i) for i in range(len(reference)))
    poses = Poses(names, first[reference], sigma[:, 3:].mean(axis=1), sigma[:, :3].mean(axis=1), C)
    recorded = Campaign(
        rig, poses, rig.cable, np.zeros((len(reference), 6)), np.array([0, 2, 0, 0, 2, 0]),
        dwell_variance=rng.uniform(0.01, 1 / 12, (len(reference), 6)), zero_variance=rng.uniform(0.0, 0.05, 6), reference=reference,
        u_visit=np.tile(visit, (len(reference), 1)),
    )  # fmt: skip
    recorded.counts[4, 1] = recorded.counts[9, 3] = np.nan
    instrument = Instrument(rig, rig.cable, ("position", "guide"), sigma_of(0.05, 2e-4), visit=visit)
    before, zeros = instrument.recorded(recorded)
    more = instrument.blocks(later, zeros).reshape(-1, len(before))
    covariance, rank = estimated_covariance(parameter_information(before + more.T @ more, 30))
    new = Poses(("a", "b", "c"), later, np.full(3, 0.05), np.full(3, 2e-4))
    whole = instrument.predicted(extended(recorded, new, np.zeros((3, 6)), np.tile(visit, (3, 1))))
    expected, expected_rank = estimated(whole, instrument)
    assert rank == expected_rank > 15
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("kind", ["I", "G", "D"])
def test_exchange_is_no_worse_than_every_choice_of_the_candidates(kind: str) -> None:
    rig = two_drums()
    instrument = Instrument(rig, rig.cable, ("position", "guide"), sigma_of(0.02, 0.0), visit=NEVER)
    region = Region(np.full(3, -300.0), np.full(3, 300.0), 0.0, IDENTITY)
    usable = Usable(rig, rig.cable, Limits(), CELL.centre)
    rng = np.random.default_rng(3)
    pool = region.candidates(3, rng)
    rows = region.rows(np.vstack([np.full(6, 0.5), pool]))
    checks = instrument.gradients(random_rows(20, 4), rows[:1], np.zeros(2, np.int64), rig.cable).reshape(-1, 10)
    criterion = Criterion(kind, checks)
    zero = instrument.zero(rows[0])
    blocks = instrument.blocks(rows[1:], zero)
    prior = np.eye(12)
    every = [
        criterion.value(prior + sum((blocks[k].T @ blocks[k] for k in chosen), np.zeros((12, 12)))) for chosen in combinations(range(8), 4)
    ]
    space = candidates(instrument, region, usable, pool, taken=np.zeros((0, 6)), zero=zero)
    design = improved(grown(empty(space, prior), 4, criterion, rng), criterion, rng)
    assert criterion.value(design.information) <= min(every) + 1e-9


def test_a_plan_beats_random_poses_and_counts_its_own_figures(eight: Plan) -> None:
    instrument = Instrument(RIG, RIG.cable, ("position", "guide"), sigma_of(0.0, 0.0), visit=NEVER)
    held_out = random_rows(150, 5)
    checks = instrument.gradients(held_out, CELL.centre[None, :], np.zeros(6, np.int64), RIG.cable)

    def variance(rows: np.ndarray) -> np.ndarray:
        A = instrument.blocks(rows[1:], instrument.zero(rows[0])).reshape(-1, 36)
        covariance, _ = estimated_covariance(parameter_information(A.T @ A, 30))
        return np.asarray(np.sum((checks @ covariance) * checks, axis=2))

    own = variance(eight.poses.rows)
    drawn = [variance(random_rows(8, 100 + k)) for k in range(30)]
    assert math.sqrt(own.max()) < 0.5 * min(math.sqrt(v.max()) for v in drawn)
    assert math.sqrt(own.mean()) < 0.7 * min(math.sqrt(v.mean()) for v in drawn)
    # the corners of the zone are worse than what is drawn inside it, so the stated worst is not beaten
    assert math.sqrt(own.max()) <= eight.outlook.worst_mm
    assert math.sqrt(own.mean()) == pytest.approx(eight.outlook.rms_mm, rel=0.1)
    assert (eight.outlook.rank, eight.equations) == (30, 42)
    assert not eight.undetermined


def test_a_plan_keeps_to_the_robot_and_repeats_nothing(eight: Plan) -> None:
    rows = eight.poses.rows
    assert eight.poses.names == tuple("12345678")
    assert (np.abs(rows[:, :3]) <= 300.0 + 1e-9).all()
    assert (np.abs(Rotation.from_quat(rows[:, 3:]).as_rotvec()) <= 0.3 + 1e-12).all()
    assert Usable(RIG, RIG.cable, Limits(), CELL.centre)(rows).all()
    unit = CELL.unit(rows)
    for i, j in combinations(range(8), 2):
        assert np.abs(unit[i] - unit[j]).max() >= APART - 1e-9


def test_a_plan_is_the_same_for_the_same_seed() -> None:
    once, again, other = (plan_poses(two_drums(), PlanSettings(4, CELL, criterion="I", seed=seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(again.poses.rows, once.poses.rows)
    assert again.course == once.course
    assert np.abs(other.poses.rows - once.poses.rows).max() > 1.0


def test_the_course_falls_and_each_pose_is_worth_something(eight: Plan) -> None:
    counts = [count for count, _ in eight.course]
    assert counts == list(range(2, 12))
    rms = [outlook.rms_mm for _, outlook in eight.course]
    assert all(later <= earlier * (1 + 1e-9) for earlier, later in pairwise(rms))
    assert eight.course[6][1].rms_mm == pytest.approx(eight.outlook.rms_mm, rel=1e-9)
    assert [name for name, _ in eight.without] == list("2345678")
    assert all(outlook.rms_mm > eight.outlook.rms_mm for _, outlook in eight.without)


def test_predicted_uncertainty_is_what_calibrations_of_simulated_counts_show(eight: Plan) -> None:
    """60 campaigns at the planned poses with rounded counts and pose errors: rms length error against the predicted rms."""
    u_position_mm, u_rotation_rad = 0.01, 3e-5
    plan = plan_poses(RIG, PlanSettings(10, CELL, criterion="I", u_position_mm=u_position_mm, u_rotation_rad=u_rotation_rad))
    rng = np.random.default_rng(8)
    held_out = CELL.rows(rng.uniform(0.0, 1.0, (100, 6)))
    instrument = Instrument(RIG, RIG.cable, ("position", "guide"), sigma_of(u_position_mm, u_rotation_rad), visit=NEVER)
    noise = Noise(plan.poses.u_position_mm, plan.poses.u_rotation_rad)
    width = instrument.unknowns.width
    errors = []
    for _ in range(60):
        # the truth scatters about the rig as its priors say where the counts are silent, and less than that elsewhere
        theta = instrument.unknowns.nominal + 0.2 * width * rng.normal(size=30)
        nominal = campaign_of(RIG, plan.poses.rows, u_position_mm, u_rotation_rad)
        true = rig_with(nominal, instrument.unknowns, theta, None)
        rows = plan.poses.rows.copy()
        rows[:, :3] += u_position_mm * rng.normal(size=(10, 3))
        rows[:, 3:] = (Rotation.from_rotvec(u_rotation_rad * rng.normal(size=(10, 3))) * Rotation.from_quat(rows[:, 3:])).as_quat()
        counts = recorded_from_counts(true, counts_from_poses(true, rows, rows[0]))
        model = Model(Campaign(RIG, plan.poses, RIG.cable, counts, nominal.zero), instrument.unknowns, noise)
        found = fit(model, model.start)
        result = rig_with(nominal, instrument.unknowns, found.theta, None)
        every = np.vstack([CELL.centre, held_out])
        error = span_lengths(result, every) - span_lengths(true, every)
        errors.append(error[1:] - error[0])
    checks = instrument.gradients(held_out, CELL.centre[None, :], np.zeros(6, np.int64), RIG.cable)
    blocks = instrument.blocks(plan.poses.rows[1:], instrument.zero(plan.poses.rows[0])).reshape(-1, 36)
    covariance, rank = estimated_covariance(parameter_information(blocks.T @ blocks, 30))
    predicted = math.sqrt(float(np.mean(np.sum((checks @ covariance) * checks, axis=2))))
    assert rank == plan.outlook.rank == 30
    assert float(np.sqrt(np.mean(np.square(errors)))) == pytest.approx(predicted, rel=0.15)
    assert plan.outlook.rms_mm == pytest.approx(predicted, rel=0.1)


def test_four_poses_leave_two_directions_of_each_point() -> None:
    rig = read_rig(TRUTH / "thesis-4-poses" / "rig.toml")
    region = Region(np.array([-300.0, -900.0, 200.0]), np.array([300.0, -300.0, 700.0]), 0.3, IDENTITY)
    plan = plan_poses(rig, PlanSettings(4, region, further=2))
    assert (plan.outlook.rank, plan.equations, len(plan.parameters)) == (9, 9, 15)
    assert [u.point for u in plan.undetermined] == ["B1", "B1", "B2", "B2", "B3", "B3"]
    assert [(count, outlook.rank) for count, outlook in plan.course] == [(2, 3), (3, 6), (4, 9), (5, 12), (6, 15)]


def test_recorded_poses_are_kept_and_built_upon() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "thesis-4-poses"))
    rows = campaign.poses.rows
    region = Region(rows[:, :3].min(axis=0), rows[:, :3].max(axis=0), 0.3, campaign.poses.rotation.mean().as_quat())
    plan = plan_poses(campaign.rig, PlanSettings(2, region, further=0), campaign)
    assert plan.recorded == 4
    assert plan.poses.names == ("1", "2", "3", "4", "5", "6")
    np.testing.assert_array_equal(plan.poses.rows[:4], rows)
    assert [(count, outlook.rank) for count, outlook in plan.course] == [(4, 9), (5, 12), (6, plan.outlook.rank)]
    assert plan.outlook.rank >= 14
    assert plan.course[-1][1].worst_mm < 0.1 * plan.course[0][1].worst_mm


def test_recorded_cables_that_are_not_the_rigs_are_refused() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "thesis-4-poses"))
    with pytest.raises(CalibrationError, match=r"cable .* of the recorded campaign is not one of its cables"):
        plan_poses(RIG, PlanSettings(2, CELL), campaign)


def test_command_extends_with_all_that_the_folder_states(tmp_path: Path) -> None:
    """Covariances by axis, a second visit, the robot's repeatability and temperatures are in the new file; the visit is no pose of it."""
    folder = tmp_path / "campaign"
    rig, rows = two_drums(), random_rows(6, 3)
    write_rig(folder / "rig.toml", rig)
    sigma = np.array([1e-4, 1e-4, 2e-4, 0.01, 0.02, 0.03])
    poses = Poses(tuple("123456"), rows, np.full(6, 0.02), np.full(6, 1e-4), np.tile(np.diag(sigma**2), (6, 1, 1)))
    columns = pose_columns(poses) | {"u_repeatability_mm": np.linspace(0.01, 0.02, 6), "temperature_c": np.full(6, 21.0)}
    write_table(folder / "reference_poses.csv", columns)
    order = [0, 1, 2, 3, 4, 5, 2]
    counts = recorded_from_counts(rig, counts_from_poses(rig, rows[order], rows[0]))
    write_table(folder / "counts.csv", {"pose": [str(i + 1) for i in order]} | {c.channel: counts[:, j] for j, c in enumerate(rig.cable)})
    out = tmp_path / "more.csv"
    arguments = ["plan-poses", str(folder / "rig.toml"), "--poses", "2", "--extend", str(folder), "--tilt-deg", "15", "--out", str(out)]
    assert "temperature_c" in ran(*arguments, "--u-position-mm", "0.05", "--quaternions")
    table, found = read_table(out), read_poses(out, rig.angles)
    assert found.names == tuple("12345678")
    assert found.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", found.covariance[:6])), np.tile(sigma, (6, 1)), rtol=1e-9)
    # what the command does not say is as in the poses recorded: 1, 1 and 2 make 1.41 rms
    new = [*np.full(3, np.sqrt(2.0) * 1e-4), 0.05, 0.05, 0.05]
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", found.covariance[6:])), np.tile(new, (2, 1)), rtol=1e-9)
    np.testing.assert_allclose(table.numbers("u_repeatability_mm"), [*np.linspace(0.01, 0.02, 6), 0.02, 0.02])
    np.testing.assert_array_equal(table.numbers("temperature_c", gaps=True), [*np.full(6, 21.0), np.nan, np.nan])


def test_command_writes_poses_that_calibrate(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    rig = two_drums()
    write_rig(folder / "rig.toml", rig)
    arguments = ["plan-poses", str(folder / "rig.toml"), "--poses", "8", "--box=-300:300,-300:300,-300:300", "--tilt-deg", "17"]
    result = ran(*arguments, "--criterion", "I", "--out", folder / "reference_poses.csv")
    assert "14 equations, 10 parameters, 10 combinations determined by the counts" in result
    poses = read_poses(folder / "reference_poses.csv", rig.angles)
    assert len(poses) == 8
    assert poses.absent == ("position", "rotation")  # how well they are known is not said by planning them
    counts = recorded_from_counts(rig, counts_from_poses(rig, poses.rows, poses.rows[0]))
    write_table(folder / "counts.csv", {"pose": list(poses.names)} | {c.channel: counts[:, j] for j, c in enumerate(rig.cable)})
    campaign = read_campaign(folder)
    record = calibrate(replace(campaign, poses=campaign.poses.with_uncertainty(0.0, 0.0))).record
    plan = plan_poses(rig, PlanSettings(8, Region(CELL.low, CELL.high, math.radians(17), IDENTITY), criterion="I"))
    assert record.rank == 10
    # linearised at the nominal rig there, at the estimate here
    for found, (name, predicted, _) in zip(record.parameters, plan.parameters, strict=True):
        assert found.name == name
        assert found.u == pytest.approx(predicted, rel=0.1)


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (["--poses", "4"], 2, "state the region of the robot"),
        (["--poses", "4", "--box", "0:1,0:1"], 2, "is not X0:X1"),
        (["--poses", "4", "--box", "0:1,0:1,0:x"], 2, "is not two numbers"),
        (["--poses", "4", "--box", "0:9,0:9,0:9", "--criterion", "X"], 2, "is not one of"),
        (["--poses", "4", "--box", "0:9,0:9,0:9", "--quaternion", "1,1,0,0"], 2, "unit"),
        (["--poses", "1", "--box", "0:9,0:9,0:9"], 1, "a plan of 1 poses"),
        (["--poses", "4", "--box", "9:0,0:9,0:9"], 1, "is empty"),
        (["--poses", "4", "--box", "0:nan,0:9,0:9"], 1, "is empty"),
        (["--poses", "4", "--box", "0:9,0:9,0:9", "--solve", "colour"], 1, "colour"),
        (["--poses", "4", "--box", "0:9,0:9,0:9", "--pass", "3"], 1, "no cable belongs to pass 3"),
    ],
)
def test_what_makes_no_sense_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, options: list[str], code: int, text: str
) -> None:
    write_rig(tmp_path / "rig.toml", RIG)
    out = tmp_path / "reference_poses.csv"
    monkeypatch.setattr("sys.argv", ["lmeasure", "plan-poses", str(tmp_path / "rig.toml"), *options, "--out", str(out)])
    with pytest.raises(SystemExit) as stopped:
        command()
    said = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert stopped.value.code == code
    assert text in said
    assert "Traceback" not in said
    assert not out.exists()


@pytest.mark.parametrize("names", ["position, guide,", ("position", "guide")])
def test_lists_of_names_are_texts_with_commas_too(names: Any) -> None:
    poses: Any = "P1,P2"
    settings = lm.CalibrationSettings(solve=names, hold_out=poses)
    assert (settings.solve, settings.hold_out) == (("position", "guide"), ("P1", "P2"))
    found = [lm.plan_poses(RIG, poses=2, box=((-1.0, 1.0),) * 3, solve=chosen, further=0) for chosen in (names, ("position", "guide"))]
    assert found[0].course == found[1].course
