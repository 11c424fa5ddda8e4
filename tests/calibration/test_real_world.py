"""Campaigns whose world is not as stated, by an independent forward model: what is the matter is told, and the rig stays good."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import real_rig
from in_process import refused
from real_rig import Flaws
from real_world import Case, RealCampaign, make, reported, score, score_of

from lmeasure.calibration import Calibration, CalibrationSettings, Model, calibrate
from lmeasure.calibration.solve import solve
from lmeasure.calibration.validation import explanations
from lmeasure.calibration.validation.misfit import Explained, explain_misfit
from lmeasure.estimation import Fit
from lmeasure.recording import write_poses
from lmeasure.rig import Finding, rig_from_dict, write_rig
from lmeasure.sensors import counts_from_poses


def misfits(result: Calibration) -> list[Finding]:
    """What residuals were put down to."""
    return [w for w in result.record.warnings if w.code == "misfit"]


def calibrated(case: Case, seed: int) -> tuple[RealCampaign, Calibration]:
    """A drawn rig, and what its campaign gives."""
    made = make(case, seed)
    return made, calibrate(made.campaign)


def test_forward_models_agree() -> None:
    """Without flaws the independent model counts what the rig file says."""
    rig = real_rig.draw(3, Flaws(phase=False))
    poses = real_rig.scattered(np.random.default_rng(1), 20)
    assert np.abs(rig.true_counts(poses, poses[0]) - counts_from_poses(rig_from_dict(rig.nominal()), poses, poses[0])).max() < 1e-9


def test_sound_data_raise_no_alarm() -> None:
    """Nothing is explained where nothing is the matter."""
    for seed in range(2):
        made, result = calibrated(Case(), seed)
        assert not misfits(result)
        assert result.refused is None
        assert not result.record.u_length_mm
        assert score_of(result, made).error_mm < 0.05


@pytest.mark.parametrize(
    ("case", "size", "unit"),
    [(Case(u_rad=100e-6), np.degrees(86.6e-6), "deg"), (Case(u_mm=0.15), 0.141, "mm")],
    ids=["orientations", "positions"],
)
def test_what_can_be_stated_costs_no_more_than_stating_it(case: Case, size: float, unit: str) -> None:
    """The error is at most half more than with the truth stated, the finding names what is the matter, and its size."""
    made, result = calibrated(case, 0)
    text = misfits(result)[0].text
    assert "more error than stated" in text
    told_size = re.search(rf"([0-9.e-]+) {unit}", text.split("reference poses with")[1])
    assert told_size is not None
    assert float(told_size[1]) == pytest.approx(size, rel=0.4)
    stated = calibrate(reported(made, case), CalibrationSettings(("position", "guide")))
    assert score_of(result, made).error_mm < 1.5 * score_of(stated, made).error_mm


@pytest.mark.parametrize(
    ("flaws", "u_mm"), [(Flaws(run_out_mm=0.02), 0.02 / np.sqrt(2)), (Flaws(friction_counts=8.0), 4 * 0.012)], ids=["run-out", "friction"]
)
def test_what_cannot_be_stated_is_an_error_of_lengths(flaws: Flaws, u_mm: float) -> None:
    """Lengths that err on their own are told from poses that do, with their size, and the run's uncertainties hold it."""
    made, result = calibrated(Case(flaws), 0)
    # of few micrometres it may not be told whether poses err or lengths: then both are reckoned with
    assert "length errors of" in misfits(result)[0].text
    found = score_of(result, made)
    assert found.error_mm < score(made.campaign.rig, None, made).error_mm
    assert found.inside > 0.8
    assert np.sqrt(np.mean(np.square(list(result.record.u_length_mm.values())))) == pytest.approx(u_mm, rel=0.35)


def test_poses_that_state_nothing() -> None:
    """Their uncertainty is estimated where residuals tell it, taken as exact where these ask for none, and assumed where they are few."""
    _, result = calibrated(Case(u_mm=0.5, u_rad=np.radians(0.1), stated=None), 0)
    values = {w.code: w.value or 0.0 for w in result.record.warnings}
    assert values["assumed_position"] == pytest.approx(0.5, rel=0.3)
    assert values["assumed_rotation"] == pytest.approx(0.1, rel=0.3)
    assert "misfit" not in values
    _, result = calibrated(Case(u_mm=0.0, u_rad=0.0, stated=None), 0)
    values = {w.code: w.value or 0.0 for w in result.record.warnings}
    assert values["assumed_position"] < 0.005
    made, result = calibrated(Case(u_mm=0.0, u_rad=0.0, stated=None, poses=4), 0)
    assert {w.code: w.value for w in result.record.warnings}["assumed_position"] == 0.1
    one = calibrate(replace(made.campaign, poses=made.campaign.poses.with_uncertainty(0.0, 0.0)))
    assert not [w for w in one.record.warnings if w.code.startswith("assumed")]
    assert one.record.predicted["position_rms_mm"] < result.record.predicted["position_rms_mm"]


def test_residuals_are_no_measure_beside_a_channel_that_was_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a gross diagnosis has named is to be mended first: nothing is explained, and the covariance covers the residuals."""
    seen: list[tuple[Model, Fit]] = []

    def first(model: Model, found: Fit, blamed: list[str]) -> Explained:
        seen.append((model, found))
        return explain_misfit(model, found, blamed)

    monkeypatch.setattr(solve, "explain_misfit", first)
    for case, codes in (
        (Case(u_mm=0.5), ["misfit"]),
        (Case(u_mm=0.5, stated=None, poses=30), ["assumed_position", "assumed_rotation", "misfit"]),
    ):
        calibrate(make(case, 1).campaign)
        model, found = seen[-1]
        explained = explain_misfit(model, found, ["c2", "slip"])
        assert [w.code for w in explained.findings] == codes
        rms = float(np.sqrt(np.mean(found.residuals**2)))
        assert explained.findings[-1].text == f"residuals of {rms:.3g} mm rms exceed the noise. First check the causes above (c2, slip)"
        assert explained.findings[-1].value == rms
        assert explained.model is model
        excess = found.chi2 / found.freedom
        assert excess > 1.5
        assert explained.fit.excess == excess
        np.testing.assert_allclose(explained.fit.covariance, found.covariance * excess, rtol=1e-12)
        assert explained.estimated
        assert (explained.u_length_mm > 0.02).all()
    # the sizes of errors widen what is stated
    noise, arm = model.noise.bare().widened(0.05, 1e-4), explanations.arm_mm(model)
    channel = model.campaign.cables[1].channel
    for errors, place, turn, lengths in (
        ([("stated", None, 0.75)], 1.25 * 0.05, 1.25e-4, None),
        ([("stated", None, 0.75), ("position", None, 0.1)], np.hypot(1.25 * 0.05, 0.1), 1.25e-4, None),
        ([("rotation", None, 0.2)], 0.05, np.hypot(1e-4, 0.2 / arm), None),
        ([("pose", None, 0.2)], np.hypot(0.05, 0.2), np.hypot(1e-4, 0.2 / arm), None),
        ([("length", None, 0.3), ("length", channel, 0.4)], 0.05, 1e-4, [0.3, 0.5, 0.3, 0.3, 0.3, 0.3]),
    ):
        wide = explanations.Otherwise(noise).widened(model, {(n, c): u for n, c, u in errors}).noise
        np.testing.assert_allclose(wide.u_position_mm, place, rtol=1e-12)
        np.testing.assert_allclose(wide.u_rotation_rad, turn, rtol=1e-12)
        assert (wide.u_length_mm is None) == (lengths is None)
        if wide.u_length_mm is not None and lengths is not None:
            np.testing.assert_allclose(wide.u_length_mm, np.array(lengths), rtol=1e-12)
    # where residuals are as stated there is nothing to be said
    calibrate(make(Case(), 1).campaign)
    sound = explain_misfit(*seen[-1], ["c2"])
    assert (sound.findings, sound.estimated, sound.fit) == ([], False, seen[-1][1])


@pytest.fixture
def blundering(monkeypatch: pytest.MonkeyPatch) -> Callable[[bool], None]:
    """Makes calibrations blunder: they believe no pose any more, and lose the rig along what the counts see weakly; always, or only where
    no prior holds it."""

    def begin(always: bool) -> None:
        def blunder(model: Model, found: Fit, blamed: list[str]) -> Explained:
            if found.prior_everywhere and not always:
                return explain_misfit(model, found, blamed)
            astray = found.theta + 60.0 * model.parameters.width * found.directions[2]
            lost = replace(found, theta=astray, residuals=model.residuals(astray))
            return Explained(model, lost, [], False, np.zeros(len(model.campaign.cables)))

        monkeypatch.setattr(solve, "explain_misfit", blunder)

    return begin


def test_rig_that_is_worse_than_its_drawing_is_not_delivered(blundering: Callable[[bool], None], tmp_path: Path) -> None:
    """It is tried again with the drawing as a prior, and refused when that is no cure: then no rig is written, and the exit code is 1."""
    made = make(Case(), 1)
    sound = against_nominal_of(calibrate(made.campaign))
    assert sound["p_worse"] > 0.999
    blundering(False)
    kept = calibrate(made.campaign)
    assert "kept_nominal" in {w.code for w in kept.record.warnings}
    assert kept.refused is None
    assert score_of(kept, made).error_mm < 0.1
    blundering(True)
    worse = calibrate(made.campaign)
    assert worse.refused is not None
    assert "worse than the nominal one" in worse.refused
    assert against_nominal_of(worse)["p_worse"] < 1e-3

    folder, out = tmp_path / "campaign", tmp_path / "out"
    folder.mkdir()
    write_rig(folder / "rig.toml", made.campaign.rig)
    write_poses(folder / "reference_poses.csv", made.campaign.poses)
    counted = zip(made.campaign.poses.names, made.campaign.counts, strict=True)
    rows = "\n".join(f"{name},{','.join(f'{k:.0f}' for k in row)}" for name, row in counted)
    (folder / "counts.csv").write_text(f"pose,{','.join(c.channel for c in made.campaign.cables)}\n{rows}\n")
    refused("calibrate", folder, "--out", out)
    assert sorted(p.name for p in out.iterdir() if not p.name.startswith(".")) == ["calibration.json", "report.html"]


def against_nominal_of(result: Calibration) -> dict[str, float]:
    """The comparison in the record."""
    told_there: dict[str, float] = result.record.validation["against_nominal"]
    return told_there
