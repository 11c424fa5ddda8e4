"""Campaigns that come back to a pose: what its visits share, what they do not, and what is said when one of them is wrong."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.calibration import CalibrationSettings, Campaign, Model, calibrate, read_campaign, unknowns_of
from lmeasure.calibration.validation.hold_out import deletion_residuals
from lmeasure.core import FileFormatError, FloatArray
from lmeasure.estimation import fit
from lmeasure.io import write_table
from lmeasure.io.tables import read_table
from lmeasure.recording import Poses
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import counts_from_poses
from lmeasure.simulation import cell_rig, write_campaign
from lmeasure.simulation.instrument import simulate_campaign

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
RIG = cell_rig(3)


def campaign_of(order: list[int], rows: FloatArray, stated: FloatArray, u_mm: float, counts: FloatArray | None = None) -> Campaign:
    """True counts, rounded, at true poses rows in the order given (a pose may come again), with the stated poses."""
    n = 1 + max(order)
    first = [order.index(i) for i in range(n)]
    again = [k for k in range(len(order)) if k not in first]
    place = [*first, *again]
    reference = np.array(order)[place]
    names = tuple(str(i + 1) for i in range(n)) + tuple(f"{order[k] + 1} (visit 2)" for k in again)
    every = np.rint(counts_from_poses(RIG, rows[order], rows[order[0]])) if counts is None else counts
    poses = Poses(names, stated[reference], np.full(len(place), u_mm), np.zeros(len(place)))
    return Campaign(
        RIG, poses, RIG.cable, every[place], np.zeros(6, np.int64), reference=reference,
        counted=np.repeat(np.array(place)[:, None], 6, axis=1),
    )  # fmt: skip


def poses_of(count: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    rows = np.column_stack([rng.uniform(-300, 300, (count, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (count, 3))).as_quat()])
    rows[0] = HOME
    return rows


TWICE = [*range(14), 4, 7, 0, 9]


def write_visits(folder: Path, again: tuple[str, ...], **columns: Any) -> Path:
    """A folder of twelve poses whose named poses are read once more at the end, where they were."""
    made = simulate_campaign(RIG, 12, np.random.default_rng(4), centre=HOME, half_mm=(300,) * 3, tilt_rad=0.3, nominal_shift_mm=5.0)
    write_campaign(folder, made)
    table = read_table(folder / "counts.csv")
    names = list(table.text("pose"))
    rows = [*range(12), *(names.index(name) for name in again)]
    counts = {c: table.numbers(c)[rows] for c in table.columns if c != "pose"}
    write_table(folder / "counts.csv", {"pose": [names[i] for i in rows]} | counts | columns)
    return folder


def test_holding_a_pose_out_holds_all_its_visits_out(tmp_path: Path) -> None:
    folder = write_visits(tmp_path, ("5", "8"))
    whole = calibrate(read_campaign(folder)).record
    record = calibrate(read_campaign(folder), CalibrationSettings(hold_out=("5",))).record
    assert whole.equations - record.equations == 2 * 6
    determined = [p["pose"] for p in record.validation["held_out"]["poses"]]
    assert determined == ["5"] * 6 + ["5 (visit 2)"] * 6


def test_leaving_a_pose_out_leaves_out_its_visits() -> None:
    """A pose whose stated place is 0.2 mm wrong, seen twice: without it the fit tells that both its visits are off by all of it."""
    rows = poses_of(14, 0)
    stated = rows.copy()
    stated[4, 0] += 0.2
    campaign = campaign_of(TWICE, rows, stated, 0.01)
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    found = fit(model, model.start)
    left_out = dict(deletion_residuals(model, found))
    kept = np.flatnonzero(campaign.reference_of != 4)
    alone = replace(campaign, counts=np.where(np.isin(np.arange(len(campaign.poses)), kept)[:, None], campaign.counts, np.nan))
    without = Model(alone, model.parameters)
    refit = fit(without, model.start)
    errors = model.residuals(refit.theta)[np.isin(model.pose_index, np.flatnonzero(campaign.reference_of == 4))]
    assert left_out["5"] == pytest.approx(float(np.sqrt(np.mean(errors**2))), rel=0.02)
    assert left_out["5"] > 0.05
    assert "5 (visit 2)" not in left_out


@pytest.mark.parametrize("wrong", [0])
def test_a_wrong_pose_seen_twice_is_named_and_taken_back(wrong: int) -> None:
    rows = poses_of(14, 1)
    stated = rows.copy()
    stated[wrong, :3] += (0.8, -0.5, 0.6)
    campaign = campaign_of(TWICE, rows, stated, 0.01)
    outlier = next(w for w in calibrate(campaign).record.warnings if w.code == "outlier")
    assert outlier.pose == str(wrong + 1)
    record = calibrate(campaign, CalibrationSettings(robust=True)).record
    weights = {w["pose"]: w["weight"] for w in record.robust["weights"]}
    assert weights[str(wrong + 1)] == weights[f"{wrong + 1} (visit 2)"] <= 1e-6
    assert sum(w < 0.5 for w in weights.values()) == 2
    true = {f"{p.name}.{k}": v for p in RIG.observation_point for k, v in zip(("x_mm", "y_mm", "z_mm"), p.position_mm, strict=True)}
    for p in record.parameters:
        if p.name in true:
            assert abs(p.value - true[p.name]) < 4 * p.u


def test_a_visit_that_missed_its_pose_is_named_alone() -> None:
    rows = poses_of(14, 2)
    order = list(TWICE)
    there = rows[order]
    there[15, :3] += (0.0, 0.9, 0.4)  # the second visit of pose 8
    counts = np.rint(counts_from_poses(RIG, there, rows[0]))
    outlier = next(w for w in calibrate(campaign_of(order, rows, rows, 0.01, counts)).record.warnings if w.code == "outlier")
    assert outlier.pose == "8 (visit 2)"


def test_a_slip_is_told_in_the_order_of_counting() -> None:
    """The counter loses 40 counts after the first pose has been seen again, in the middle of the campaign."""
    order = [0, 1, 2, 3, 4, 5, 6, 0, 3, 7, 8, 9, 10, 11, 12, 13]
    rows = poses_of(14, 3)
    counts = np.rint(counts_from_poses(RIG, rows[order], rows[0]))
    counts[9:, 2] -= 40
    slip = next(w for w in calibrate(campaign_of(order, rows, rows, 0.0, counts)).record.warnings if w.code == "slip")
    assert (slip.channel, slip.pose) == ("ch3", "8")
    assert slip.value == pytest.approx(-40 * 0.012, abs=0.02)


def test_two_passes_share_a_pose_s_error_and_not_the_robot_s() -> None:
    """Covariance of the residuals against draws: the reference pose errs once, the robot comes anew in each pass."""
    data = RIG.to_dict()
    for cable in data["cable"][3:]:
        cable["pass"] = 2
    rig = rig_from_dict(data)
    rows, n = poses_of(5, 4), 5
    shared, own = 0.03, 0.05
    poses = Poses(tuple("12345"), rows, np.full(n, shared), np.zeros(n))
    counts = counts_from_poses(rig, rows, rows[0], rig.cable)
    u_visit = np.repeat([[0.0, 0, 0, own, own, own]], n, axis=0)
    campaign = Campaign(rig, poses, rig.cable, counts, np.zeros(6, np.int64), u_visit=u_visit)
    model = Model(campaign, unknowns_of(campaign, ("position",)))
    V = model.covariance(model.start) - model.reading_covariance()
    rng, drawn, passage = np.random.default_rng(0), [], np.array([c.passage for c in rig.cable])
    for _ in range(600):
        stated, errors = rng.normal(0, shared, (n, 3)), {}
        for number in (1, 2):
            moved = rows.copy()
            moved[:, :3] += stated + rng.normal(0, own, (n, 3))
            errors[number] = Model(replace(campaign, poses=replace(poses, rows=moved)), model.parameters).residuals(
                model.parameters.nominal
            )
        drawn.append(np.where(passage[model.cable_index] == 1, errors[1], errors[2]))
    met = np.cov(np.array(drawn).T)
    scale = np.sqrt(np.outer(np.diag(V), np.diag(V)))
    # a correlation of 600 draws is known to 0.04
    assert np.abs((met - V) / scale).max() < 0.18
    across = passage[model.cable_index][:, None] != passage[model.cable_index]
    assert 0.05 < np.abs((V / scale)[across]).max() < shared**2 / (shared**2 + own**2) + 1e-9


def test_temperatures_of_readings_are_those_of_their_visits(tmp_path: Path) -> None:
    folder = write_visits(tmp_path, ("1", "6"), temperature_c=np.arange(14) + 10.0)
    warm = read_campaign(folder).temperature_c
    assert warm is not None
    assert warm.shape == (14, 6)
    assert warm[:, 0].tolist() == [*(np.arange(12) + 10.0), 22.0, 23.0]


def test_a_dwell_s_temperature_is_its_mean(tmp_path: Path) -> None:
    folder = write_visits(tmp_path, ("12", "12"), temperature_c=np.r_[np.full(11, 20.0), 20.0, 23.0, 26.0])
    warm = read_campaign(folder).temperature_c
    assert warm is not None
    assert warm[:, 3].tolist() == [*np.full(11, 20.0), 23.0]


def test_temperatures_are_stated_in_one_place(tmp_path: Path) -> None:
    folder = write_visits(tmp_path, (), temperature_c=np.full(12, 21.0))
    table = read_table(folder / "reference_poses.csv")
    columns: dict[str, Any] = {c: list(table.text(c)) if c == "pose" else table.numbers(c) for c in table.columns}
    write_table(folder / "reference_poses.csv", columns | {"temperature_c": np.full(12, 21.0)})
    with pytest.raises(FileFormatError, match="has 'temperature_c', and so has reference_poses"):
        read_campaign(folder)


@pytest.mark.parametrize("value", [500.0, -200.0])
def test_temperatures_that_cannot_be(tmp_path: Path, value: float) -> None:
    folder = write_visits(tmp_path, (), temperature_c=np.full(12, value))
    with pytest.raises(FileFormatError, match="is no temperature"):
        read_campaign(folder)


def test_a_second_visit_s_warmth_is_in_its_residual(tmp_path: Path) -> None:
    """Cables that grow, a pose seen again 6 K warmer: stated with the readings, nothing is left of it."""
    warm = np.r_[np.full(12, 20.0), np.full(3, 26.0)]
    data = RIG.to_dict()
    for p in data["observation_point"]:
        p["drum"]["cable_expansion_per_k"] = 3e-5
    rig = rig_from_dict(data)
    rows = poses_of(12, 5)
    order = [*range(12), 3, 5, 7]
    counts = np.rint(counts_from_poses(rig, rows[order], rows[0], temperature_c=warm, zero_temperature_c=20.0))
    made = simulate_campaign(rig, 12, np.random.default_rng(4), centre=HOME, half_mm=(300,) * 3, tilt_rad=0.3)
    write_campaign(tmp_path, replace(made, measured=Poses(made.measured.names, rows, np.zeros(12), np.zeros(12))))
    columns = {"pose": [str(i + 1) for i in order]} | {f"ch{j + 1}": counts[:, j] for j in range(6)}
    worst = []
    for stated in (columns, columns | {"temperature_c": warm}):
        write_table(tmp_path / "counts.csv", stated)
        campaign = read_campaign(tmp_path)
        model = Model(campaign, unknowns_of(campaign, ("position",)))
        worst.append(np.abs(model.residuals(model.parameters.nominal)).max())
    assert worst[0] > 0.1
    assert worst[1] < 0.012
