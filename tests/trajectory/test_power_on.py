"""Runs whose start nobody stated: absolute encoders of swivels tell it, through the command that a user calls."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from campaigns import write_campaign
from in_process import ran, refused
from test_truth import AUTHORITY, truth_of

from lmeasure.core import TrajectoryError, se3
from lmeasure.recording import Run, read_run
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import length_residuals, span_lengths
from lmeasure.trajectory import align, prepare, read_trajectory, reconstruct
from lmeasure.trajectory.faults.redundancy import repeats
from lmeasure.trajectory.origin import start


def copied(name: str, tmp_path: Path) -> Path:
    return Path(shutil.copytree(AUTHORITY / name, tmp_path / name))


def test_six_swivels_and_a_motion_tell_the_start(tmp_path: Path) -> None:
    folder, out = copied("swivel-run", tmp_path), tmp_path / "t.csv"
    ran("reconstruct", folder, "--out", out)
    found, truth = pd.read_csv(out), truth_of("swivel-run")[:, 1:]
    assert (found.status == "ok").all()
    poses = found[["x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"]].to_numpy()
    error = se3.displacement(poses, truth)
    # the generic optimiser's figures (tests/authorities/truth)
    assert np.sqrt((error[:, 3:] ** 2).sum(axis=1).mean()) == pytest.approx(0.004527, rel=0.05)
    assert np.sqrt((error[:, :3] ** 2).sum(axis=1).mean()) == pytest.approx(3.751e-5, rel=0.05)
    assert np.linalg.norm(error[0, 3:]) < 0.0034
    u = found[["u_x_mm", "u_y_mm", "u_z_mm"]].to_numpy()
    assert 0.7 < np.sqrt((error[:, 3:] ** 2).mean() / (u**2).mean()) < 1.3


def test_origins_are_found_as_well_as_is_stated() -> None:
    """Pieces in memory give what the stream does, and what the drums had out is what they had."""
    run = read_run(AUTHORITY / "swivel-run")
    reconstruction = prepare(align(run))
    determined, budget = reconstruction.budget.estimate, reconstruction.budget
    assert determined is not None
    phases = 0.012 * np.array(json.loads((AUTHORITY / "swivel-run" / "truth.json").read_text())["phase_counts"])
    zero = span_lengths(run.rig, truth_of("swivel-run")[:1, 1:])[0] - span_lengths(run.rig, reconstruction.model.zero_pose[None])[0]
    off = budget.offsets(np.zeros(1))[0, :6] - (phases - zero)
    columns = budget.origin_lengths(np.zeros(1))[0, :6] @ determined.mix[-len(determined.mean) :]
    covariance = columns @ columns.T
    assert float(off @ np.linalg.solve(covariance, off)) < 25.0
    assert np.sqrt(np.diag(covariance)).max() < 0.01
    assert 0.8 < determined.chi_squared / determined.freedom < 1.2


def test_by_monte_carlo_the_origins_err_as_by_the_linear_law() -> None:
    run = read_run(AUTHORITY / "swivel-run")
    (counts,) = run.passes
    run = replace(run, passes=(replace(counts, time_s=counts.time_s[::100], recorded=counts.recorded[::100]),))
    linear, drawn = reconstruct(run), reconstruct(run, trials=120, seed=1)
    for part in ("random", "systematic"):
        ratio = np.einsum("nii->ni", getattr(drawn, part)).mean(axis=0) / np.einsum("nii->ni", getattr(linear, part)).mean(axis=0)
        # a variance of 120 draws is known to 13 %
        assert 0.65 < ratio.min() < ratio.max() < 1.4


def test_every_command_that_takes_a_run_takes_one_without_a_start(tmp_path: Path) -> None:
    folder = copied("swivel-run", tmp_path)
    given = folder / "pass1.csv"
    given.write_text("\n".join(given.read_text().splitlines()[:301]) + "\n")
    found = tmp_path / "t.parquet"
    for words in (
        ["reconstruct", folder, "--out", found, "--rerun", tmp_path / "t.rrd"],
        ["report", folder, "--out", tmp_path / "page"],
        ["motion", found, "--out", tmp_path / "motion.csv"],
    ):
        ran(*words)
    # residuals without what was out nobody knows where: none is larger than some counts
    left = length_residuals(read_run(folder), read_trajectory(found).poses)
    assert 0.001 < np.abs(left).max() < 0.04
    for words, why in (
        (["check-instrument", folder, "--out", tmp_path / "c"], "A check needs rests"),
        (["calibrate", folder, "--self", "--out", tmp_path / "k"], "start"),
    ):
        assert why in refused(*words)


def test_a_certificate_holds_the_start_that_nobody_stated(tmp_path: Path) -> None:
    """Its uncertainty is common to all poses; figures of differences know it."""
    write_campaign(tmp_path, rig=read_run(AUTHORITY / "swivel-run").rig)
    given = ("trajectory.parquet", "--run", "run", "--program", "program.toml", "--out", "certificate", "--trials", "150")
    ran("certify", *(w if w.startswith("-") or w == "150" else str(tmp_path / w) for w in given))
    content = json.loads((tmp_path / "certificate" / "certificate.json").read_text())
    assert "origins of the channels" in json.dumps(content)
    assert content["instrument"]["systematic_sha256"] is None


def test_without_an_absolute_channel_or_with_too_few_it_is_said(tmp_path: Path) -> None:
    folder, out = copied("swivel-run", tmp_path), tmp_path / "t.csv"
    rig = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(rig[: rig.index("[[swivel]]")])
    assert "its channels are not absolute" in refused("reconstruct", folder, "--out", out)
    assert not out.exists()
    folder = copied("swivel-three", tmp_path)
    determined = (folder / "run.toml").read_text()
    (folder / "run.toml").write_text(re.sub(r"\[start\]\n(?:\w.*\n)+", "", determined))
    needed = "At most 3 of its absolute channels can be read at once, with 6 channels in all. To find the start, 6 absolute channels"
    assert needed in refused("reconstruct", folder, "--out", out)
    assert not out.exists()


def with_swivels(some: list[int], every: int = 4) -> Run:
    """swivel-run, its start unknown, with some of its encoders and every so many samples."""
    run = read_run(AUTHORITY / "swivel-run")
    data, (counts,) = run.rig.to_dict(), run.passes
    data["swivel"] = [data["swivel"][i] for i in some]
    fewer = replace(counts, time_s=counts.time_s[::every], recorded=counts.recorded[::every])
    return replace(run, rig=rig_from_dict(data), start=None, passes=(fewer,))


@pytest.mark.parametrize("some", [[1, 3]])
def test_fewer_than_six_absolute_angles_tell_the_start_over_a_motion(some: list[int]) -> None:
    found = reconstruct(with_swivels(some))
    assert (found.status == 0).all()
    error = np.linalg.norm(found.poses[:, :3] - truth_of("swivel-run")[::4, 1:4], axis=1)
    assert error.max() < 0.03
    assert (error / np.linalg.norm(found.u[:, :3], axis=1)).max() < 3.0


def test_a_start_that_the_run_soon_contradicts_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three angles fit a short way from where the tool was not."""
    monkeypatch.setattr(start, "TRIED", 4)  # nothing is there to be found
    monkeypatch.setattr(start, "DRAWN", 300)
    run = with_swivels([0, 2, 4], every=8)
    (counts,) = run.passes
    recorded = counts.recorded.copy()
    n = len(recorded)
    for j, sign in ((0, 1.0), (3, -1.0), (4, 1.0)):
        recorded[:, j] += np.rint(sign * 4000.0 * np.clip(np.arange(n) / n - 0.3, 0.0, 1.0))
    with pytest.raises(TrajectoryError, match=r"3 absolute channels, fits no start that was found( beyond its first \d+ %)?: a"):
        reconstruct(replace(run, passes=(replace(counts, recorded=recorded),)))


def test_what_a_motion_cannot_tell_of_a_start_is_said() -> None:
    run = with_swivels([0, 2, 4])
    (counts,) = run.passes
    still = replace(counts, time_s=counts.time_s[:40], recorded=np.repeat(counts.recorded[:1], 40, axis=0))
    with pytest.raises(TrajectoryError, match="with 3 absolute channels, does not determine it: move the tool farther"):
        reconstruct(replace(run, passes=(still,)))


def test_a_still_reading_that_fits_several_assemblies_lists_them(tmp_path: Path) -> None:
    """Of six angles alone there are up to eight; nothing moves that could tell them apart."""
    folder, out = copied("swivel-run", tmp_path), tmp_path / "t.csv"
    counts = (folder / "pass1.csv").read_text().splitlines()
    (folder / "pass1.csv").write_text("\n".join([counts[0], *[f"{0.001 * i:.3f},{counts[1].split(',', 1)[1]}" for i in range(20)]]) + "\n")
    done = refused("reconstruct", folder, "--out", out)
    assert "assembly modes: " in done
    assert "(0." in done
    assert not out.exists()


def test_a_reading_that_is_repeated_counts_once() -> None:
    readings = np.array([[1.0, 5.0], [1.0, 6.0], [2.0, 6.0], [2.0, 6.0]])
    np.testing.assert_array_equal(repeats(readings), [[2, 1], [2, 3], [2, 3], [2, 3]])


def test_an_exact_run_with_a_start_stays_exact() -> None:
    found = reconstruct(read_run(AUTHORITY / "swivel-run-exact"))
    assert (found.status == 0).all()
    assert np.abs(se3.displacement(found.poses, truth_of("swivel-run-exact")[:, 1:])[:, 3:]).max() < 1e-9
