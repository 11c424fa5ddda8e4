"""A start that nobody stated is unknown: no pose, no certificate, whatever an earlier version wrote in its place."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from campaigns import write_campaign
from cells import cell, motion, record
from in_process import code_and_text

from lmeasure.core import TrajectoryError
from lmeasure.recording import read_run, read_run_head, write_run
from lmeasure.sensors import length_residuals, lengths_from_counts
from lmeasure.trajectory import covariances, read_trajectory, reconstruct

ZERO = {"position_mm": [0.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
UNKNOWN = r"the start pose of this run is not known.*: state \[start\] in run.toml, a pose or lengths_mm, or give it .* --start"


def without_start(folder: Path) -> None:
    """Take [start] out of a run.toml."""
    data = tomllib.loads((folder / "run.toml").read_text())
    del data["start"]
    (folder / "run.toml").write_text(tomli_w.dumps(data))


def test_nothing_is_reconstructed_from_an_unknown_start(tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(40)))
    without_start(tmp_path / "run")
    run = read_run(tmp_path / "run")
    assert run.start is None
    assert np.isfinite(lengths_from_counts(run).change_mm).all()  # what needs no start is there
    known = record(cell(), *motion(40))
    for use in (
        lambda: reconstruct(run),
        lambda: covariances(reconstruct(known), run),
        lambda: read_run_head(tmp_path / "run").known_start,
    ):
        with pytest.raises(TrajectoryError, match=r"pass1\.csv: " + UNKNOWN):
            use()
    # at poses that are known otherwise what is left needs no start
    left = length_residuals(run, motion(40)[1])
    np.testing.assert_allclose(left.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(left, (whole := length_residuals(known, motion(40)[1])) - whole.mean(axis=0), atol=1e-9)
    for extra in ((), ("--uncertainty", "monte-carlo")):
        code, text = code_and_text("reconstruct", tmp_path / "run", "--out", tmp_path / "t.csv", *extra)
        assert code == 1
        assert "is not known" in text
        assert not (tmp_path / "t.csv").exists()


def test_a_stated_zero_is_a_start(tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(40)))
    assert read_run(tmp_path / "run").known_start.tolist() == [0, 0, 0, 0, 0, 0, 1]
    data = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    (tmp_path / "run" / "run.toml").write_text(tomli_w.dumps({**data, "note": "by hand"}))
    assert read_run(tmp_path / "run").start is not None


def test_an_unknown_start_is_written_as_none(tmp_path: Path) -> None:
    write_run(tmp_path / "run", replace(record(cell(), *motion(5)), start=None))
    assert "start" not in tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert read_run(tmp_path / "run").start is None


def test_reconstruct_takes_the_start_that_is_given(tmp_path: Path) -> None:
    times, poses = motion(40)
    run = record(cell(), times, poses)
    write_run(tmp_path / "run", run)
    write_run(tmp_path / "other", replace(run, start=poses[30]))
    without_start(tmp_path / "run")
    given = {"numbers": "0,0,0,0,0,0,1", "file": str(tmp_path / "start.toml")}
    (tmp_path / "start.toml").write_text(tomli_w.dumps({"start": ZERO | {"u_position_mm": 0.1}}))
    expected = reconstruct(run)
    for name, start in given.items():
        assert code_and_text("reconstruct", tmp_path / "run", "--start", start, "--out", tmp_path / f"{name}.csv")[0] == 0
        found = read_trajectory(tmp_path / f"{name}.csv")
        np.testing.assert_allclose(found.poses, expected.poses, atol=1e-9)
        assert (np.sqrt(found.systematic[:, 3, 3]).min() > 0.05) == (name == "file")
    # instead of the run's own, too
    assert code_and_text("reconstruct", tmp_path / "other", "--start", given["numbers"], "--out", tmp_path / "again.csv")[0] == 0
    np.testing.assert_allclose(read_trajectory(tmp_path / "again.csv").poses, expected.poses, atol=1e-9)


@pytest.mark.parametrize(
    ("start", "complaint"),
    [
        ("1,2,3", "'1,2,3' is 3 numbers. Wanted are x,y,z in mm and three angles"),
        ("a,b,c,d,e,f,g", "is neither six numbers"),
        ("0,0,0,0,0,0,2", "the quaternion's length is 2, not 1"),
        ("nan,0,0,0,0,0,1", "position_mm must be 3 numbers"),
        ("{run}/rig.toml", r"rig.toml: [start] is missing"),
        ("{run}/run.toml", r"run.toml: [start] is missing"),
    ],
)
def test_a_start_that_is_none_is_refused_in_one_line(start: str, complaint: str, tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(5)))
    without_start(tmp_path / "run")
    code, text = code_and_text("reconstruct", tmp_path / "run", "--start", start.format(run=tmp_path / "run"), "--out", tmp_path / "t.csv")
    assert code == (2 if "Wanted are" in complaint else 1)
    assert complaint in text
    assert code == 2 or "\n" not in text


def test_nothing_is_certified_from_an_unknown_start(tmp_path: Path) -> None:
    write_campaign(tmp_path)
    without_start(tmp_path / "run")
    given = (tmp_path / "trajectory.parquet", "--run", tmp_path / "run", "--program", tmp_path / "program.toml")
    code, text = code_and_text("certify", *given, "--out", tmp_path / "certificate")
    assert code == 1
    assert "the start pose of this run is not known" in text
    assert not (tmp_path / "certificate").exists()
