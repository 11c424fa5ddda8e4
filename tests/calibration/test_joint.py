"""Rig and poses estimated together: recovered from simulated campaigns whose reference poses are wrong, or lack orientations."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import ran, refused
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Calibration, CalibrationSettings, Campaign, calibrate, read_campaign, unknowns_of
from lmeasure.calibration.solve.frame import model_of, motions, moved
from lmeasure.calibration.solve.joint_estimation import solve_jointly
from lmeasure.calibration.solve.unknown_poses import free_components
from lmeasure.core import CalibrationError, FloatArray
from lmeasure.io import write_table
from lmeasure.io.tables import read_table
from lmeasure.recording import read_poses
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import span_lengths
from lmeasure.simulation import cell_rig, write_campaign
from lmeasure.simulation.instrument import simulate_campaign

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
PLACES = {"B7": (1500.0, 900.0, 300.0), "B8": (600.0, -1500.0, 1200.0)}


def body_rig(seed: int = 1) -> Rig:
    """The cell with two more cables."""
    data = cell_rig(seed).to_dict()
    for i, (name, place) in enumerate(PLACES.items()):
        beta = math.degrees(math.atan2(place[0], place[1]))
        data["observation_point"].append({**data["observation_point"][i], "name": name, "position_mm": list(place), "guide_beta_deg": beta})
        data["cable"].append({"name": f"c{7 + i}", "channel": f"ch{7 + i}", "from": name, "to": f"P{2 + i}", "pass": 1})
    return rig_from_dict(data)


def point_rig(seed: int = 1, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Rig:
    """Five cables to one point of the tool."""
    data = cell_rig(seed).to_dict()
    data["tool"], data["cable"] = {"P": list(offset)}, [c | {"to": "P"} for c in data["cable"][:5]]
    data["observation_point"] = data["observation_point"][:5]
    return rig_from_dict(data)


def simulated(rig: Rig, count: int, u_mm: float, u_rad: float, seed: int = 0, shift_mm: float = 10.0) -> tuple[Campaign, FloatArray]:
    """A campaign whose stated poses are wrong by so much, and the true poses."""
    made = simulate_campaign(
        rig, count, np.random.default_rng(seed), centre=HOME, half_mm=(300,) * 3, tilt_rad=0.4, u_position_mm=u_mm, u_rotation_rad=u_rad,
        nominal_shift_mm=shift_mm, nominal_shift_deg=2.0,
    )  # fmt: skip
    counts = made.recorded
    return Campaign(made.nominal, made.measured, rig.cable, counts, np.zeros(len(rig.cable), np.int64)), made.poses


def aligned(poses: FloatArray, true: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) errors of positions and rotations that no motion of the whole explains."""
    a, b = poses[:, :3], true[:, :3]
    turn, _ = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))
    place = turn.apply(a - a.mean(axis=0)) + b.mean(axis=0) - b
    return place, (turn * Rotation.from_quat(poses[:, 3:]) * Rotation.from_quat(true[:, 3:]).inv()).as_rotvec()


def free_lengths(result: Calibration, true_rig: Rig, true: FloatArray, count: int = 40) -> FloatArray:
    """(n, m) errors of changes of length along a motion of the tool that both rigs make, each from its own first pose in its own frame."""
    rng = np.random.default_rng(9)
    moves = Rotation.from_rotvec(rng.uniform(-0.2, 0.2, (count, 3))), rng.uniform(-150, 150, (count, 3))

    def lengths(rig: Rig, start: FloatArray) -> FloatArray:
        R = Rotation.from_quat(start[3:])
        rows = np.column_stack([start[:3] + R.apply(moves[1]), (R * moves[0]).as_quat()])
        all_lengths = span_lengths(rig, np.vstack([start, rows]))
        return np.asarray(all_lengths[1:] - all_lengths[0])

    return lengths(result.rig, result.campaign.poses.rows[0]) - lengths(true_rig, true[0])


def test_derivatives_and_motions_of_the_whole() -> None:
    campaign, _ = simulated(body_rig(), 8, 5.0, 0.02)
    model = model_of(campaign, unknowns_of(campaign, ("position", "guide")), (0, 1, 2, 3, 4, 5), "rig")
    theta = model.start + np.random.default_rng(1).normal(size=len(model.names))
    J, h = model.jacobian(theta), 1e-4
    numeric = np.array([(model.residuals(theta + d) - model.residuals(theta - d)) / (2 * h) for d in h * np.eye(len(theta))]).T
    assert pytest.approx(numeric, abs=1e-6) == J
    # no length changes when everything moves together
    assert np.abs(J @ motions(model, theta)).max() < 1e-9
    campaign, _ = simulated(point_rig(offset=(10.0, -30.0, 80.0)), 8, 5.0, 0.0)
    point = model_of(campaign, unknowns_of(campaign, ("position", "guide")), (3, 4, 5), "rig")
    assert np.abs(point.jacobian(point.start) @ motions(point, point.start)).max() < 1e-9


@pytest.mark.parametrize("rig", [body_rig(), point_rig(), point_rig(offset=(10.0, -30.0, 80.0))])
def test_moved_as_a_whole_nothing_fits_worse(rig: Rig) -> None:
    campaign, _ = simulated(rig, 8, 5.0, 0.02)
    model = model_of(campaign, unknowns_of(campaign, ("position", "guide")), free_components(campaign, trusted=False), "rig")
    there = moved(model, model.start, np.array([0.3, -0.2, 0.5, 100.0, -50.0, 20.0]))
    assert model.residuals(there) == pytest.approx(model.residuals(model.start), abs=1e-9)


@pytest.mark.parametrize("frame", ["rig", "poses"])
def test_a_body_on_eight_cables_calibrates_itself(frame: Any) -> None:
    """Poses stated 5 mm and one degree wrong come out to hundredths, shapes of rig and poses as the counts have them."""
    rig = body_rig()
    campaign, true = simulated(rig, 45, 5.0, 0.02)
    result = calibrate(campaign, CalibrationSettings(self_calibration=True, frame=frame))
    record = result.record
    assert (record.equations, record.unknowns) == (8 * 44, 40 + 6 * 45)
    assert next(w for w in record.warnings if w.code == "frame").value == 6
    assert 0.5 < record.noise["chi_squared"] / record.noise["degrees_of_freedom"] < 1.5
    assert not [w for w in record.warnings if w.code in {"misfit", "not_converged"}]
    before, _ = aligned(campaign.poses.rows, true)
    place, turn = aligned(result.campaign.poses.rows, true)
    assert np.sqrt(np.mean(before**2)) > 3.0
    assert np.sqrt(np.mean(place**2)) < 0.05
    assert np.sqrt(np.mean(turn**2)) < 2e-4
    assert np.sqrt(np.mean(free_lengths(result, rig, true) ** 2)) < 0.1
    stated = np.array([[p[f"u_{c}_mm"] for c in "xyz"] for p in record.poses])
    if frame == "poses":
        # nearest to the stated poses as a whole
        assert np.abs((result.campaign.poses.rows - campaign.poses.rows)[:, :3].mean(axis=0)).max() < 1e-9
        assert 0.2 < np.sqrt(np.mean(place**2)) / np.sqrt(np.mean(stated**2)) < 2.0


def test_errors_are_those_that_the_covariance_states() -> None:
    """Over repeated campaigns the shape of the poses errs as stated in the frame of the poses."""
    rig, ratios = body_rig(2), []
    for seed in range(4):
        campaign, true = simulated(rig, 40, 2.0, 0.01, seed, shift_mm=5.0)
        model, found = solve_jointly(campaign, ("position", "guide"), False, free_components(campaign, False), frame="poses", seed=0)
        place, _ = aligned(model.poses(found.theta), true)
        own = np.arange(model.own, len(found.theta)).reshape(-1, 6)[:, 3:].ravel()
        ratios.append(float(np.mean(place**2) / np.mean(np.diag(found.covariance)[own])))
    assert 0.3 < np.mean(ratios) < 2.0


def test_one_point_on_five_cables_calibrates_itself() -> None:
    rig = point_rig()
    campaign, true = simulated(rig, 40, 5.0, 0.0)
    result = calibrate(campaign, CalibrationSettings(self_calibration=True))
    place, _ = aligned(np.column_stack([result.campaign.poses.rows[:, :3], true[:, 3:]]), true)
    assert result.record.unknowns == 25 + 3 * 40
    assert np.sqrt(np.mean(place**2)) < 0.15
    assert [set(p) & {"u_x_mm", "u_rx_deg"} for p in result.record.poses[:1]] == [{"u_x_mm"}]


def test_what_the_counts_cannot_do_is_refused_in_one_line() -> None:
    for rig, text in ((cell_rig(1), "6 cables give 6 equations at a pose of 6 unknowns"), (point_rig(), "")):
        campaign, _ = simulated(rig, 12, 1.0, 0.01)
        if text:
            with pytest.raises(CalibrationError, match=text) as error:
                calibrate(campaign, CalibrationSettings(self_calibration=True))
            assert "\n" not in str(error.value)
    campaign, _ = simulated(body_rig(), 3, 1.0, 0.01)
    with pytest.raises(CalibrationError, match=r"16 equations cannot determine 6 unknowns of each of 3 poses and 40 values"):
        calibrate(campaign, CalibrationSettings(self_calibration=True))
    with pytest.raises(CalibrationError, match="--self: needs position and guide in --solve"):
        calibrate(campaign, CalibrationSettings(("position",), self_calibration=True))


def test_too_few_poses_say_what_they_leave_open() -> None:
    campaign, _ = simulated(body_rig(), 14, 2.0, 0.01)
    record = calibrate(campaign, CalibrationSettings(self_calibration=True)).record
    assert any(
        w.code == "underdetermined" and "parameters undetermined, so their nominal values are used (effect on lengths" in w.text
        for w in record.warnings
    )
    assert record.rank < record.unknowns - 6


def xyz_folder(path: Path, rig: Rig, count: int = 18, u_mm: float = 0.0) -> tuple[Path, FloatArray]:
    made = simulate_campaign(
        rig, count, np.random.default_rng(5), centre=np.array([50.0, -20, 30, *Rotation.from_rotvec([0.9, -1.2, 0.4]).as_quat()]),
        half_mm=(300,) * 3, tilt_rad=0.4, u_position_mm=u_mm, nominal_shift_mm=10.0, nominal_shift_deg=2.0,
    )  # fmt: skip
    write_campaign(path, made)
    table = read_table(path / "reference_poses.csv")
    columns: dict[str, Any] = {"pose": list(table.text("pose"))} | {c: table.numbers(c) for c in ("x_mm", "y_mm", "z_mm")}
    columns["u_position_mm"] = np.full(count, u_mm)
    write_table(path / "reference_poses.csv", columns)
    return path, made.poses


def test_positions_alone_that_state_nothing_say_what_is_taken(tmp_path: Path) -> None:
    """What a file of positions does not state is estimated, and said, as it is where orientations are known."""
    folder, _ = xyz_folder(tmp_path, cell_rig(1), u_mm=0.02)
    campaign = read_campaign(folder)
    result = calibrate(replace(campaign, poses=replace(campaign.poses, u_position_mm=np.zeros(18), absent=("position",))))
    said = {w.code: w.value for w in result.record.warnings}
    assert said["assumed_position"] == pytest.approx(0.02, rel=0.6)
    assert "assumed_rotation" not in said
    # poses.csv has what was taken, not the size that was assumed before anything was known
    assert result.campaign.poses.u_position_mm == pytest.approx(np.full(18, said["assumed_position"]))


@pytest.mark.parametrize("u_mm", [0.0, 0.02])
def test_positions_alone_calibrate_and_the_counts_tell_the_orientations(tmp_path: Path, u_mm: float) -> None:
    rig = cell_rig(1)
    folder, true = xyz_folder(tmp_path, rig, u_mm=u_mm)
    result = calibrate(read_campaign(folder), CalibrationSettings())
    turn = (Rotation.from_quat(result.campaign.poses.rows[:, 3:]) * Rotation.from_quat(true[:, 3:]).inv()).magnitude()
    assert turn.max() < (0.002 if u_mm == 0.0 else 0.05)
    assert result.record.unknowns == 30 + 3 * 18
    assert np.sqrt(np.mean(free_lengths(result, rig, true) ** 2)) < (0.05 if u_mm == 0.0 else 1.0)
    stated = np.radians([[p[f"u_r{c}_deg"] for c in "xyz"] for p in result.record.poses])
    assert 0.2 < np.sqrt(np.mean(turn**2) / 3) / np.sqrt(np.mean(stated**2)) < 3.0


def test_positions_alone_with_too_few_equations_are_refused(tmp_path: Path) -> None:
    folder, _ = xyz_folder(tmp_path, cell_rig(1), 8)
    with pytest.raises(CalibrationError, match=r"has no orientations, and 42 equations cannot determine 3 unknowns.*at least 12 poses"):
        calibrate(read_campaign(folder), CalibrationSettings())


def test_positions_of_one_point_need_no_orientation(tmp_path: Path) -> None:
    folder, _ = xyz_folder(tmp_path / "a", point_rig(), 14)
    result = calibrate(read_campaign(folder), CalibrationSettings())
    assert result.record.noise["residual_rms_mm"] < 0.005
    assert result.rig.observation_point[0].position_mm == pytest.approx(point_rig().observation_point[0].position_mm, abs=20.0)
    folder, _ = xyz_folder(tmp_path / "b", point_rig(offset=(0.0, 0.0, 50.0)), 14)
    with pytest.raises(CalibrationError, match=r"all cables lead to P: give the positions of P itself and P = \[0\.0, 0\.0, 0\.0\]"):
        calibrate(read_campaign(folder), CalibrationSettings())


def test_the_command_writes_the_poses_it_found(tmp_path: Path) -> None:
    rig = body_rig()
    made = simulate_campaign(
        rig, 40, np.random.default_rng(0), centre=HOME, half_mm=(300,) * 3, tilt_rad=0.4, u_position_mm=2.0, nominal_shift_mm=5.0
    )
    write_campaign(tmp_path / "folder", made)
    done = ran("calibrate", tmp_path / "folder", "--out", tmp_path / "out", "--self", "--frame", "poses")
    assert "6 motions of rig and poses together are free. The frame minimizes the shifts from" in done
    poses = read_poses(tmp_path / "out" / "poses.csv", "puma-oat")
    place, _ = aligned(poses.rows, made.poses)
    assert np.sqrt(np.mean(place**2)) < 0.05
    assert len(json.loads((tmp_path / "out" / "calibration.json").read_text())["poses"]) == 40
    assert (
        "6 motions of rig and poses together are free. The frame minimizes the shifts from"
        in (tmp_path / "out" / "report.html").read_text()
    )
    refused("calibrate", tmp_path / "folder", "--out", tmp_path / "out", "--frame", "floor", code=2)
