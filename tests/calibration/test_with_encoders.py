"""Calibrations with encoders of angles beside drums: what they tell, against the truth, finite differences and what is known elsewhere."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from lmeasure.calibration import CalibrationSettings, Campaign, Instrument, Model, calibrate, read_campaign, unknowns_of
from lmeasure.calibration.solve.frame import condition, free_motions, model_of, motions, moved
from lmeasure.core import CalibrationError, FileFormatError, FloatArray
from lmeasure.estimation import parameter_information
from lmeasure.recording import Poses
from lmeasure.rig import GUIDE, PLACE, Rig, rig_from_dict, with_values
from lmeasure.sensors import counts_from_poses, drawn_phases, recorded_from_counts, span_lengths
from lmeasure.simulation import cell_rig

TRUTH = Path(__file__).parents[1] / "authorities" / "truth" / "swivel-12-poses"


def swivelled(seed: int = 1, *, leaning: bool = False, absolute: bool = True, u_zero_deg: float | None = 2.0) -> Rig:
    """The cell with an encoder on every pulley, and an inclinometer."""
    rng, data = np.random.default_rng([seed, 5]), cell_rig(seed).to_dict()
    zero = {} if u_zero_deg is None or not absolute else {"u_zero_deg": u_zero_deg}
    data["swivel"] = [
        {
            "point": f"B{i + 1}", "channel": f"sw{i + 1}", "counts_per_revolution": 131072, "absolute": absolute,
            "count_sign": 1 - 2 * (i % 2),
        }
        | ({"zero_deg": float(rng.uniform(-180, 180))} | zero if absolute else {})
        for i in range(6)
    ]  # fmt: skip
    if leaning:
        axes = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        data["inclination"] = [
            {"channel": f"level{i}", "axis": axis, "counts_per_revolution": 3600000, "zero_deg": 1.0, "u_zero_deg": 0.5}
            for i, axis in enumerate(axes)
        ]
    return rig_from_dict(data)


def campaign_of(rig: Rig, poses: int, seed: int = 0, *, u_mm: float = 0.05, shift: float = 1.0) -> tuple[Campaign, FloatArray]:
    """A campaign of recorded counts with a nominal rig that is off by its priors times shift, and the true poses."""
    rng = np.random.default_rng([seed, 9])
    rows = np.column_stack([rng.uniform(-300, 300, (poses, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (poses, 3))).as_quat()])
    recorded = recorded_from_counts(
        rig, counts_from_poses(rig, rows, rows[0], rig.observed), rig.observed, drawn_phases(rig, rng, rig.observed)
    )
    counts = recorded * np.array([rig.counter(o).count_sign for o in rig.observed])
    stated = rows.copy()
    stated[:, :3] += rng.normal(0, u_mm, (poses, 3))
    names = tuple(str(i + 1) for i in range(poses))
    right = Campaign(rig, Poses(names, rows, np.zeros(poses), np.zeros(poses)), rig.observed, counts, np.zeros(len(rig.observed), np.int64))
    unknowns = unknowns_of(right, ("position", "guide"))
    off = unknowns.nominal + shift * rng.normal(size=len(unknowns.names)) * np.minimum(unknowns.width, 10.0) / 3.0
    nominal = with_values(rig, dict(zip(unknowns.names, off.tolist(), strict=True)))
    reference = Poses(names, stated, np.full(poses, u_mm), np.zeros(poses))
    return Campaign(nominal, reference, rig.observed, counts, np.zeros(len(rig.observed), np.int64)), rows


def test_the_truth_of_the_independent_simulator_is_told_as_well_as_stated(tmp_path: Path) -> None:
    campaign = read_campaign(TRUTH)
    n = len(campaign.poses)
    campaign = replace(campaign, poses=campaign.poses.with_uncertainty(0.05, 0.0))
    found, truth = calibrate(campaign), json.loads((TRUTH / "truth.json").read_text())
    assert not [w for w in found.record.warnings if w.code != "note"]
    names = [p.name for p in found.record.parameters]
    own = [names.index(f"sw{i + 1}.zero_deg") for i in range(6)]
    off = np.array([found.record.parameters[i].value for i in own]) - truth["zero_deg"]
    C = np.array(found.record.tangent_covariance)[np.ix_(own, own)]
    assert stats.chi2.ppf(5e-4, 6) < off @ np.linalg.solve(C, off) < stats.chi2.ppf(1 - 5e-4, 6)
    assert [s.zero_deg for s in found.rig.swivel] == pytest.approx([found.record.parameters[i].value for i in own])
    assert [s.u_zero_deg for s in found.rig.swivel] == pytest.approx(np.sqrt(np.diag(C)))
    # lengths and angles at poses that took no part, against the true rig's, in what is stated of them
    values = {f"sw{i + 1}.zero_deg": z for i, z in enumerate(truth["zero_deg"])}
    for name, t in truth["points"].items():
        there = (*t["B"], t["alpha_deg"], t["beta_deg"], t["R"])
        values |= dict(zip([f"{name}.{k}" for k in (*PLACE, *GUIDE, "pulley_radius_mm")], there, strict=True))
    true = with_values(campaign.rig, values)
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.uniform(-300, 300, (150, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (150, 3))).as_quat()])
    determined, right = (span_lengths(rig, rows, rig.observed) for rig in (found.rig, true))
    off = (determined - right)[:, :6]
    u = [e["rms_mm"] for e in found.record.predicted["lengths"]]
    assert (np.sqrt(np.mean((off - off.mean(axis=0)) ** 2, axis=0)) < 2.5 * np.array(u)).all()
    assert np.abs(np.degrees(determined - right)[:, 6:]).max() < 0.02
    assert found.record.equations == 6 * (n - 1) + 6 * n


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 1000), leaning=st.booleans(), absolute=st.booleans(), free=st.booleans())
def test_derivatives_are_those_of_finite_differences(seed: int, leaning: bool, absolute: bool, free: bool) -> None:
    campaign, _ = campaign_of(swivelled(seed % 5 + 1, leaning=leaning, absolute=absolute), 5, seed)
    model = model_of(
        campaign, unknowns_of(campaign, ("position", "guide", "tilt", "radius", "attachment")), tuple(range(6)) if free else ()
    )
    theta, J = model.start, model.jacobian(model.start)
    for i in range(len(theta)):
        step = np.zeros(len(theta))
        step[i] = 1e-3
        numeric = (model.residuals(theta + step) - model.residuals(theta - step)) / 2e-3
        np.testing.assert_allclose(J[:, i], numeric, atol=2e-5 * max(1.0, np.abs(numeric).max()))


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 1000), leaning=st.booleans(), known=st.booleans())
def test_no_reading_tells_where_the_whole_stands(seed: int, leaning: bool, known: bool) -> None:
    campaign, _ = campaign_of(swivelled(seed % 5 + 1, leaning=leaning, u_zero_deg=0.0 if known else 2.0), 5, seed)
    model = model_of(campaign, unknowns_of(campaign, ("position", "guide")), tuple(range(6)), "rig")
    theta = model.start + np.random.default_rng(seed).normal(0, 0.1, len(model.names))
    free = free_motions(model)
    assert free.shape[1] == (4 if leaning or known else 6)
    assert np.abs(model.jacobian(theta) @ motions(model, theta) @ free).max() < 1e-6
    move = free @ np.random.default_rng(seed).normal(0, 1, free.shape[1]) * np.repeat([0.05, 20.0], 3)
    np.testing.assert_allclose(model.residuals(moved(model, theta, move)), model.residuals(theta), atol=1e-8)
    C = condition(model, theta, "rig")
    weight = np.r_[model.parameters.width**-2.0, np.zeros(len(theta) - model.own)]
    for i in np.random.default_rng(seed).choice(model.own, 6, replace=False):
        ends = []
        for sign in (1.0, -1.0):
            at = theta.copy()
            at[i] += sign * 1e-4
            ends.append(motions(model, at).T @ (weight * (at - model.start)))
        np.testing.assert_allclose(C[:, i], (ends[0] - ends[1]) / 2e-4, rtol=1e-4, atol=1e-6 * np.abs(C[:, i]).max())


def test_zeros_that_nobody_knows_are_found_and_known_ones_are_kept() -> None:
    known, _ = campaign_of(swivelled(u_zero_deg=0.0), 10)
    data = known.rig.to_dict()
    for s in data["swivel"]:
        del s["zero_deg"], s["u_zero_deg"]
    blind = replace(known, rig=rig_from_dict(data))
    found = calibrate(blind)
    zeros = {p.name: p for p in found.record.parameters if p.name.endswith("zero_deg")}
    assert len(zeros) == 6
    assert not found.record.unobservable
    for s in known.rig.swivel:
        p = zeros[f"{s.channel}.zero_deg"]
        assert abs(math.remainder(p.value - (s.zero_deg or 0.0), 360.0)) < 5.0 * p.u < 1.0
    sure = calibrate(known)
    assert not any(p.name.endswith("zero_deg") for p in sure.record.parameters)
    assert [s.zero_deg for s in sure.rig.swivel] == [s.zero_deg for s in known.rig.swivel]
    # what is known more leaves less uncertain
    u = [{p.name: p.u for p in f.record.parameters} for f in (found, sure)]
    assert all(u[1][name] <= 1.05 * u[0][name] for name in u[1])


@pytest.mark.parametrize("slip", ["sign", "swapped"])
def test_encoders_that_are_mistaken_are_named(slip: str) -> None:
    campaign, _ = campaign_of(swivelled(), 10)
    counts = campaign.counts.copy()
    if slip == "sign":
        counts[:, 8] *= -1
    else:
        counts[:, [7, 9]] = counts[:, [9, 7]]
    found = [w for w in calibrate(replace(campaign, counts=counts)).record.warnings if w.code == slip]
    assert [w.channel for w in found] == ["sw3" if slip == "sign" else "sw2"]


def test_an_encoder_that_errs_is_named_and_reckoned_with() -> None:
    campaign, _ = campaign_of(swivelled(), 12)
    counts = campaign.counts.copy()
    counts[:, 9] += np.random.default_rng(4).normal(0, 0.05 / 360 * 131072, len(counts))
    found = [w for w in calibrate(replace(campaign, counts=counts)).record.warnings if w.code == "misfit"]
    assert [w.channel for w in found] == ["sw4"]
    assert "encoder sw4" in found[0].text


def test_files_with_too_little_or_too_much_are_read_or_refused(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    shutil.copytree(TRUTH, folder)
    lines = [line.split(",") for line in (folder / "counts.csv").read_text().splitlines()]

    def written(rows: list[list[str]]) -> None:
        (folder / "counts.csv").write_text("\n".join(",".join(r) for r in rows) + "\n")

    written([r[:-1] for r in lines])
    campaign = read_campaign(folder)
    assert [o.channel for o in campaign.cables if not o.is_cable] == ["sw1", "sw2", "sw3", "sw4", "sw5"]
    assert any("sw6" in note for note in campaign.notes)
    written([[*r[:-1], "131072"] if i == 3 else r for i, r in enumerate(lines)])
    with pytest.raises(FileFormatError, match=r"counts.csv:4: channel sw6: 131072 is no code"):
        read_campaign(folder)
    written([[*r[:-1], "7"] if i else r for i, r in enumerate(lines)])
    with pytest.raises(CalibrationError, match=r"channel sw6 does not move"):
        read_campaign(folder)


def test_a_plan_reckons_with_encoders() -> None:
    """The sum over measurements is the estimator's information, at poses that err in all readings, drums' from a zero pose."""
    rig, sigma = swivelled(leaning=True), np.repeat([2e-4, 0.05], 3)
    _, rows = campaign_of(rig, 8)
    instrument = Instrument(rig, rig.observed, ("position", "guide"), sigma, visit=np.zeros(6))
    blocks = instrument.blocks(rows[1:], instrument.zero(rows[0]))
    determined = parameter_information(np.einsum("nmp,nmq->pq", blocks, blocks), len(instrument.unknowns.names))
    reference = Poses(tuple(map(str, range(8))), rows, np.full(8, 0.05), np.full(8, 2e-4))
    nothing = np.zeros((8, len(rig.observed)))
    campaign = instrument.predicted(Campaign(rig, reference, rig.observed, nothing, np.zeros(len(rig.observed), np.int64)))
    campaign.counts[0, 6:] = np.nan  # what absolute encoders tell at the zero pose is beside the sum
    model = Model(campaign, instrument.unknowns)
    J = model.jacobian(model.start) * instrument.unknowns.width
    right = J.T @ np.linalg.solve(model.measurement_covariance(model.start), J)
    np.testing.assert_allclose(determined, right, rtol=1e-5, atol=1e-6 * determined.max())


def test_six_cables_and_six_encoders_calibrate_themselves() -> None:
    """Nothing is known of the poses but about where they are; distances between them are told as well as stated."""
    campaign, rows = campaign_of(swivelled(2), 20, 4, u_mm=2.0)
    found = calibrate(campaign, CalibrationSettings(self_calibration=True))
    determined = found.campaign.poses
    assert determined.covariance is not None
    way, right = (p[1:, :3] - p[:1, :3] for p in (determined.rows, rows))
    off = np.linalg.norm(way, axis=1) - np.linalg.norm(right, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.1
    assert np.abs(off).max() < 5.0 * determined.u_position_mm.max()
    assert found.record.rank == found.record.unknowns - 6
