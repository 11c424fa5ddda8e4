"""Run folders: read, written, and every way in which they contradict themselves in one line."""

import tomllib
from pathlib import Path

import numpy as np
import oracles
import pytest
import test_rig

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.recording import Counts, Run, read_run, write_run
from lmeasure.rig import rig_from_dict

RUN = """
schema = "lmeasure.run/1"
rig = "rig.toml"
[start]
position_mm = [1.0, 2, 3]
quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]
[[pass]]
counts = "pass1.csv"
[[pass]]
counts = "pass2.csv"
"""


def folder(tmp_path: Path, run: str = RUN) -> Path:
    (tmp_path / "rig.toml").write_text(test_rig.RIG)
    for name in ("pass1.csv", "pass2.csv"):
        (tmp_path / name).write_text("time_s,ch1,ch2\n0,0,0\n0.001,5,7\n")
    (tmp_path / "run.toml").write_text(run)
    return tmp_path


def test_a_run_folder_is_read(tmp_path: Path) -> None:
    run = read_run(folder(tmp_path))
    assert run.known_start.tolist() == [1, 2, 3, 0, 0, 0, 1]
    assert [c.source for c in run.passes] == [str(tmp_path / "pass1.csv"), str(tmp_path / "pass2.csv")]
    assert run.passes[1].of("ch2").tolist() == [0, 7]
    assert run.calibration is None


def test_angles_of_the_rig_s_controller(tmp_path: Path) -> None:
    run = read_run(folder(tmp_path, RUN.replace("quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]", "o_a_t_deg = [10, 20, 30]")))
    assert oracles.matrix_of_quaternion(run.known_start[3:]) == pytest.approx(oracles.puma_oat(10, 20, 30), abs=1e-15)


def test_another_rig_can_be_given(tmp_path: Path) -> None:
    other = tmp_path / "elsewhere"
    other.mkdir()
    (other / "better.toml").write_text(test_rig.RIG.replace('"demo"', '"better"'))
    (tmp_path / "run").mkdir()
    run = read_run(folder(tmp_path / "run"), other / "better.toml")
    assert run.rig.name == "better"


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_run_comes_back(tmp_path: Path, suffix: str) -> None:
    g = np.random.default_rng(0)
    passes = tuple(
        Counts(np.arange(20) / 7, ("ch1", "ch2"), np.rint(g.normal(0, 1e4, (20, 2))), (np.arange(20) > 3).astype(np.float64)) for _ in "12"
    )
    start = np.r_[0.1, 0.2, 0.3, np.array([0.5, 0.5, 0.5, 0.5])]
    write_run(tmp_path / "new" / "run", Run(rig_from_dict(test_rig.data()), start, passes, unstated="exact"), {"note": "by hand"}, suffix)
    back = read_run(tmp_path / "new" / "run")
    assert np.array_equal(back.known_start, start)
    assert back.rig == rig_from_dict(test_rig.data())
    for a, b in zip(back.passes, passes, strict=True):
        assert np.array_equal(a.time_s, b.time_s)
        assert np.array_equal(a.recorded, b.recorded)
        assert np.array_equal(a.sync, b.sync)  # type: ignore[arg-type]
    assert tomllib.loads((tmp_path / "new" / "run" / "run.toml").read_text())["note"] == "by hand"


REFUSALS = [
    ("schema", 'schema = "lmeasure.run/1"', 'schema = "lmeasure.run/2"', "schema: must be 'lmeasure.run/1', is 'lmeasure.run/2'"),
    ("no schema", 'schema = "lmeasure.run/1"', "", "schema: is missing"),
    ("unknown key", 'rig = "rig.toml"', 'rig = "rig.toml"\nrigg = 1', "unknown key 'rigg'. Did you mean 'rig'?"),
    ("no rig", 'rig = "rig.toml"', "", "rig: is missing"),
    ("rig is a number", 'rig = "rig.toml"', "rig = 5", "rig: must be text, is 5"),
    ("rig outside", 'rig = "rig.toml"', 'rig = "../rig.toml"', "rig = '../rig.toml' lies outside the run folder"),
    ("rig absolute", 'rig = "rig.toml"', 'rig = "/etc/passwd"', "rig = '/etc/passwd' lies outside the run folder"),
    ("rig not there", 'rig = "rig.toml"', 'rig = "other.toml"', "other.toml: cannot be read: No such file"),
    ("rig with a zero byte", 'rig = "rig.toml"', 'rig = "a\\u0000b"', "rig = 'a\\x00b'"),
    ("rig is the folder", 'rig = "rig.toml"', 'rig = "."', "cannot be read: Is a directory"),
    ("no start", "[start]", "[begin]", "unknown key 'begin'"),
    ("start unit", "position_mm", "position_m", "start.position_m: unknown key 'position_m'. The unit is part of the name: 'position_mm'"),
    ("start two", "[1.0, 2, 3]", "[1.0, 2]", "start.position_mm: number 3 is missing"),
    ("start text", "[1.0, 2, 3]", '[1.0, 2, "3"]', "start.position_mm: number 3 must be a number, is '3'"),
    ("start bool", "[1.0, 2, 3]", "[1.0, 2, true]", "start.position_mm: number 3 must be a number, is true"),
    ("start nan", "[1.0, 2, 3]", "[1.0, 2, nan]", "start.position_mm: number 3 must be a finite number"),
    ("start huge integer", "[1.0, 2, 3]", "[1.0, 2, 1" + "0" * 400 + "]", "start.position_mm: number 3 must be a number"),
    ("start far", "[1.0, 2, 3]", "[1.0, 2, 1e300]", "start: pose 1: lies more than 1000000 mm from the origin"),
    ("not unit", "[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 0.9]", "start: pose 1: the quaternion's length is 0.9, not 1"),
    ("both", "quaternion_xyzw", "o_a_t_deg = [0, 0, 0]\nquaternion_xyzw", "start: give either quaternion_xyzw or o_a_t_deg"),
    ("neither", "quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]", "", "start: give either quaternion_xyzw or o_a_t_deg"),
    ("wrong angles", "quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]", "a_b_c_deg = [0, 0, 0]", "start: unknown key 'a_b_c_deg'"),
    ("one pass short", '[[pass]]\ncounts = "pass2.csv"', "", "has 1 [[pass]], but the rig's cables need 2"),
    ("pass is no array", '[[pass]]\ncounts = "pass1.csv"\n[[pass]]\ncounts = "pass2.csv"', "note = 3", "[[pass]] is missing"),
    ("counts missing", 'counts = "pass2.csv"', 'count = "pass2.csv"', "[pass 2].count: unknown key 'count'. Did you mean 'counts'?"),
    ("counts empty", 'counts = "pass2.csv"', "", "[pass 2].counts: is missing"),
    ("counts outside", "pass2.csv", "../pass2.csv", "pass 2: counts = '../pass2.csv' lies outside the run folder"),
    ("counts not there", "pass2.csv", "pass3.csv", "pass3.csv: cannot be read: No such file"),
    ("counts of another kind", "pass2.csv", "rig.toml", "rig.toml: is neither .csv nor .parquet"),
    ("not TOML", "[start]", "[start", "run.toml: is not TOML"),
]


@pytest.mark.parametrize(("old", "new", "line"), [r[1:] for r in REFUSALS], ids=[r[0] for r in REFUSALS])
def test_one_line_names_the_key(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert old in RUN
    with pytest.raises(FileFormatError) as caught:
        read_run(folder(tmp_path, RUN.replace(old, new, 1)))
    assert line in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_pass_at_all(tmp_path: Path) -> None:
    text = RUN[: RUN.index("[[pass]]")]
    with pytest.raises(FileFormatError, match=r"\[\[pass\]\] is missing"):
        read_run(folder(tmp_path, text))


def test_what_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="is not a run folder"):
        read_run(tmp_path / "nowhere")
    with pytest.raises(FileFormatError, match=r"run.toml: cannot be read: No such file"):
        read_run(tmp_path)


def test_a_linked_calibration_must_be_there(tmp_path: Path) -> None:
    path = folder(tmp_path)
    text = test_rig.RIG.replace('name = "demo"', 'name = "demo"\ncalibration = "calibration.json"', 1)
    (path / "rig.toml").write_text(text)
    with pytest.raises(FileFormatError, match=r"calibration.json: cannot be read"):
        read_run(path)
    (path / "calibration.json").write_text("{}")
    with pytest.raises(FileFormatError, match=r"calibration.json: rig: is missing"):
        read_run(path)


def test_a_folder_without_run_toml_is_not_whole(tmp_path: Path) -> None:
    """run.toml is written last."""
    counts = Counts(np.arange(2.0), ("ch1", "ch2"), np.zeros((2, 2)))
    (tmp_path / "run" / "pass2.csv").mkdir(parents=True)  # the second pass cannot be written
    with pytest.raises(LMeasureError, match="cannot be written"):
        write_run(tmp_path / "run", Run(rig_from_dict(test_rig.data()), np.r_[np.zeros(6), 1], (counts, counts), unstated="exact"))
    assert not (tmp_path / "run" / "run.toml").exists()
