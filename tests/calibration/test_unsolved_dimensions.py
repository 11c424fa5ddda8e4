"""Calibrations of rigs whose dimensions err as the rig states: neither counted twice nor forgotten, in values and in runs that follow."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import real_rig
import scipy.stats
from test_unsolved import delta, drawn_flaws, run_of, stating

from lmeasure import covariances
from lmeasure.calibration import CalibrationSettings, Campaign, calibrate
from lmeasure.core import FileFormatError, FloatArray
from lmeasure.recording import Poses, Run
from lmeasure.rig import CalibrationRecord, read_calibration_record, write_calibration_record
from lmeasure.sensors import cable_covariance, unsolved_dimensions
from lmeasure.trajectory import reconstruct

DRAWS = 5
U_MM, U_RAD = 0.02, 1e-4
START = np.array([0.0, 0, 0, 0, 0, 0, 1])


def campaign_of(true: real_rig.RealRig, names: tuple[str, ...], rng: np.random.Generator, poses: int = 16) -> Campaign:
    """A campaign on a rig as drawn, whose drawing states what may be wrong with it."""
    # drums and pulleys stand in a run as they do here
    rows = np.vstack([START, real_rig.scattered(rng, poses - 1)])
    data = true.drawing(rng, 2.0, 0.5)
    for point in data["observation_point"]:
        point["drum"]["zero_exact"] = True
    rig = stating(data, *names)
    way = rng.choice([-1.0, 1.0], (poses, 6))
    counts = true.counts(rows, rows[0], way)
    # the reading at the zero pose is 0, whichever way it was come from
    counts = counts - np.rint(way[0] * true.flaws.band_counts / 2) if true.flaws.band_counts else counts
    counts[0] = 0.0
    stated = real_rig.stated(rng, rows, U_MM, U_RAD)
    reference = Poses(tuple(str(i) for i in range(poses)), stated, np.full(poses, U_MM), np.full(poses, U_RAD))
    return Campaign(rig, reference, rig.cable, counts, np.zeros(6, dtype=np.int64))


def drawn(seed: int, names: tuple[str, ...]) -> tuple[real_rig.RealRig, np.random.Generator]:
    rng = np.random.default_rng([seed, 17])
    flaws: dict[str, Any] = {}
    for name in names:
        flaws |= drawn_flaws(rng, name)
    return real_rig.without(real_rig.draw(seed, real_rig.Flaws(phase=False)), **flaws), rng


def true_dimensions(true: real_rig.RealRig, record: CalibrationRecord) -> FloatArray:
    out = []
    for d in record.dimensions:
        owner, key = d.name.rsplit(".", 1)
        if owner.startswith("tool."):
            i = int(owner[-1]) - 1
            out.append((true.tool + true.flaws.tool)[i]["xyz".index(key[0])])
        else:
            j = int(owner[1:]) - 1
            lengths = real_rig.COUNT_MM * (1.0 + true.flaws.stretch)
            out.append(lengths[j] if key == "count_length_mm" else (true.pitch + true.flaws.pitch_mm)[j])
    return np.array(out)


@pytest.mark.parametrize("names", [("count length", "attachment", "groove pitch"), ("run-out", "eccentricity")], ids=" ".join)
def test_runs_after_a_calibration_err_as_is_stated(names: tuple[str, ...]) -> None:
    """The same drums in campaign and run: what the calibration made up for is taken off, exactly for dimensions."""
    square, of_dimensions, many = 0.0, 0.0, 0
    apart: list[float] = []
    for seed in range(DRAWS):
        true, rng = drawn(seed, names)
        found = calibrate(campaign_of(true, names, rng))
        assert not [w for w in found.record.warnings if w.code == "misfit"], seed
        start = START
        poses = np.vstack([start[None], real_rig.scattered(rng, 1, 200.0, 0.2)])
        way = np.linspace(0.0, 1.0, 30)[:, None]
        poses = np.hstack([way * poses[1, :3], way * poses[1, 3:] + (1 - way) * start[3:]])
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
        run = run_of(found.rig, true.counts(poses, start))
        run = Run(found.rig, start, run.passes, found.record, unstated="exact")
        measured = reconstruct(run)
        budget = covariances(measured, run, np.array([29]))
        error = delta(measured.poses, poses)[29]
        square += float(error @ np.linalg.solve(budget.random[0] + budget.systematic[0], error))
        unlinked = run_of(found.rig, run.passes[0].recorded)
        independent = Run(found.rig, start, unlinked.passes, found.record.model_copy(update={"dimensions": ()}), unstated="exact")
        twice = covariances(measured, independent, np.array([29])).systematic[0][3:, 3:]
        apart.append(np.sqrt(np.trace(twice) / np.trace(budget.systematic[0][3:, 3:])))
        if "attachment" in names:
            off = true_dimensions(true, found.record) - [d.value for d in found.record.dimensions]
            own = np.array([d.covariance[-len(off) :] for d in found.record.dimensions])
            width = np.sqrt(np.diag(own))
            of_dimensions += float((off / width) @ np.linalg.solve(own / np.outer(width, width), off / width))
            many += len(off)
    p = scipy.stats.chi2.cdf(square, 6 * DRAWS)
    assert 0.005 < p < 0.995, square / (6 * DRAWS)
    if many:
        p = scipy.stats.chi2.cdf(of_dimensions, many)
        assert 0.005 < p < 0.995, of_dimensions / many
        # without what values and dimensions have in common the same run would be said to be several times worse
        assert np.mean(apart) > 2.0


def test_what_is_solved_is_not_counted_again() -> None:
    """With --solve scale a stated count length is the prior of scale, and no error beside it."""
    true, rng = drawn(2, ("count length",))
    campaign = campaign_of(true, ("count length", "attachment"), rng)
    found = calibrate(campaign, CalibrationSettings(solve=("position", "guide", "scale")))
    assert {own.name for own in found.record.dimensions} == {f"tool.P{i}.{axis}_mm" for i in (1, 2, 3) for axis in "xyz"}
    columns = unsolved_dimensions(found.rig, found.record)[0].reshape(6, 13, -1)
    assert columns.shape[2] == 9
    scale = next(p for p in found.record.parameters if p.name == "B1.scale")
    assert scale.prior_u == pytest.approx(6e-6 / real_rig.COUNT_MM)
    # scale is in the calibration alone
    without = found.record.model_copy(update={"dimensions": ()})
    bare = found.rig.model_copy(update={"u_attachment_mm": None})
    np.testing.assert_allclose(
        np.diag(cable_covariance(bare, without)).reshape(6, 13)[:, 6],
        [next(p for p in found.record.parameters if p.name == f"B{i}.scale").u ** 2 for i in range(1, 7)],
        rtol=0.2,
    )


def test_corrected_dimensions_are_those_that_solving_would_give() -> None:
    true, rng = drawn(3, ("count length",))
    campaign = campaign_of(true, ("count length",), rng, poses=24)
    determined, solved = calibrate(campaign), calibrate(campaign, CalibrationSettings(solve=("position", "guide", "scale"), prior=True))
    for d in determined.record.dimensions:
        scale = next(p for p in solved.record.parameters if p.name == d.name.replace("count_length_mm", "scale"))
        assert d.value / real_rig.COUNT_MM == pytest.approx(1.0 / scale.value, abs=0.25 * scale.u)
        assert d.u / real_rig.COUNT_MM == pytest.approx(scale.u, rel=0.05)
    rms = [np.sqrt(np.mean([r.mm**2 for r in c.record.residuals])) for c in (determined, solved)]
    assert rms[0] == pytest.approx(rms[1], rel=0.02)


def test_record_of_unsolved_dimensions_is_written_and_read(tmp_path: Path) -> None:
    true, rng = drawn(1, ("count length", "attachment"))
    found = calibrate(campaign_of(true, ("count length", "attachment"), rng))
    write_calibration_record(tmp_path / "calibration.json", found.record)
    again = read_calibration_record(tmp_path / "calibration.json")
    np.testing.assert_array_equal(unsolved_dimensions(found.rig, again)[0], unsolved_dimensions(found.rig, found.record)[0])
    # the parts of the covariance make the whole, in every length
    total = cable_covariance(found.rig, again)
    names = [[f"{c.from_point}.x_mm", f"{c.from_point}.y_mm"] for c in found.rig.cable]
    solved = found.record.cable_covariance(names)
    np.testing.assert_allclose(total[:2, :2], solved[:2, :2], rtol=1e-9)
    text = (tmp_path / "calibration.json").read_text()
    own = found.record.dimensions[0]
    (tmp_path / "calibration.json").write_text(text.replace(str(own.covariance[0]), str(own.covariance[0] + 1e3), 1))
    with pytest.raises(FileFormatError, match=r"dimensions: covariance: is not positive semidefinite"):
        read_calibration_record(tmp_path / "calibration.json")


def test_a_rig_that_states_nothing_is_calibrated_as_ever() -> None:
    true, rng = drawn(1, ())
    found = calibrate(campaign_of(true, (), rng))
    assert found.record.dimensions == ()
    assert unsolved_dimensions(found.rig, found.record)[0].shape[1] == 0
