"""On a full disk and in a folder that is read-only, every command that writes ends in one line, which names the file and says what to do;
no file is left, neither half-written nor one that the next command would take for somebody's."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "capture"))
from capture_bench import POSES, RIG, going, nominal_of, write_inputs

from lmeasure import files
from lmeasure.acquisition.decoders import counter_fields
from lmeasure.acquisition.feed import frames_from_counts
from lmeasure.acquisition.growing_files import candump_lines
from lmeasure.capture.folder import CaptureFolder, open_folder
from lmeasure.certification.bundle import opened_zip, write_zip
from lmeasure.certification.signature import new_key
from lmeasure.errors import LMeasureError
from lmeasure.files import write_table
from lmeasure.rig import read_rig
from lmeasure.run import read_run
from lmeasure.workflows import init
from lmeasure.written import LEDGER, writing

HERE = Path(__file__).parents[1]
SEALED = HERE / "authorities" / "sealed-before" / "with-run"
RUN = HERE / "authorities" / "truth" / "cell-run"
GRID = "--x=0:50:50 --y=0:50:50 --z=0:50:50"
LINES = (
    "schema rig --out OUT/rig.json",
    "key --out OUT/key",
    "import drive.log --rig run/rig.toml --out OUT/imported --start 0,0,0,0,0,0",
    "record --rig run/rig.toml --bus replay:drive.log --fast --out OUT/recorded --start 0,0,0,0,0,0",
    "reconstruct run --out OUT/t.parquet",
    "reconstruct run --out OUT/t.csv",
    "reconstruct run --out OUT/t.tum",
    "reconstruct run --out OUT/t.mcap",
    "reconstruct run --out t.parquet --rerun OUT/t.rrd",
    f"zone run/rig.toml {GRID} --out OUT/zone.nc",
    "program --out OUT/program --x 0:500 --y 0:500 --z 0:500 --tests pose",
    "certify sealed/inputs/trajectory.parquet --program sealed/inputs/program.toml --run sealed/inputs/run --out OUT/c --trials 100",
    "mechanism rotopod --out OUT/m.json",
    "init OUT/cell --template three-drums",
    "capture plan/rig.toml --poses plan/planned.csv --bus replay:plan/drive.log --fast --by rest --out OUT/campaign",
    "frames --robot plan/planned.csv --measured plan/planned.csv --out OUT/frames.json",
    "correct plan/points.csv --map plan/map.csv --out OUT/corrected",
    "dyads plan/planned.csv --links 1 --starts 5 --out OUT/links",
)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("desk")
    shutil.copytree(SEALED, here / "sealed")
    shutil.copytree(RUN, here / "run")
    run = read_run(RUN)
    frames = frames_from_counts(run.passes[0].time_s[:50], run.passes[0].recorded[:50], counter_fields(run.rig), run.rig.can_table.sync_id)
    (here / "drive.log").write_bytes(candump_lines(frames))
    (here / "plan").mkdir()
    write_inputs(here / "plan", nominal_of(RIG), POSES)
    counts = going(POSES[:1], 1.0)
    (here / "plan" / "drive.log").write_bytes(
        candump_lines(frames_from_counts(counts.time_s, counts.recorded, counter_fields(RIG), RIG.can_table.sync_id))
    )
    places = np.random.default_rng(0).uniform(-300.0, 300.0, (50, 3))
    table = dict(zip(("x_mm", "y_mm", "z_mm"), places.T, strict=True))
    turn = {"qx": np.zeros(50), "qy": np.zeros(50), "qz": np.zeros(50), "qw": np.ones(50)}
    off = {f"d{axis}_mm": np.sin(places[:, k] / 300.0) for k, axis in enumerate("xyz")}
    write_table(here / "plan" / "map.csv", table | turn | off)
    (here / "plan" / "points.csv").write_text("name,x_mm,y_mm,z_mm,qx,qy,qz,qw\nA,10,20,30,0,0,0,1\n")
    return here


@pytest.mark.skipif(sys.platform != "linux", reason="limits and rights of a process there")
@pytest.mark.parametrize("mode", ["full", "closed"])
def test_a_command_with_nowhere_to_write_ends_in_one_line(mode: str, desk: Path) -> None:
    words = [sys.executable, str(HERE / "cli" / "starved.py"), mode, str(desk / "out")]
    done = subprocess.run(words, input="\n".join(LINES), capture_output=True, text=True, cwd=desk, check=True)
    for line, text in zip(LINES, done.stdout.splitlines(), strict=True):
        code, said, left = json.loads(text)
        if code == "root":
            pytest.skip("root here may not give up its right to write everywhere")
        assert (code, len(said), left) == (1, 1, []), (line, said)
        assert str(desk / "out") in said[0], line
        assert said[0].endswith(tuple(files.TO_DO.values())), line


def test_a_capture_that_could_not_begin_is_begun_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stayed of it would be a capture's folder, perhaps of another rig than the next one's."""
    write_inputs(tmp_path, nominal_of(RIG), POSES)
    rig, usual = read_rig(tmp_path / "rig.toml"), files.write_table

    def full(path: Path, *_: object) -> None:
        raise LMeasureError(files.not_written(path, OSError(28, "")))

    def opened() -> CaptureFolder:
        return open_folder(tmp_path / "cal", rig, rig.channels, 1, planned=tmp_path / "planned.csv", beside={"a.dbc": b"1"})

    monkeypatch.setattr(files, "write_table", full)
    with pytest.raises(LMeasureError, match=r"reference_poses\.csv: cannot be written: No space left on device; make room"):
        opened()
    assert list((tmp_path / "cal").iterdir()) == []
    monkeypatch.setattr(files, "write_table", usual)
    assert len(opened().poses) == len(POSES)


def test_init_writes_all_of_its_files_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It writes over nothing, so what a full disk left of it would keep it from being called again."""
    usual = files.write_text

    def full(path: Path, text: str) -> None:
        if path.name == "scenario.toml":
            raise LMeasureError(files.not_written(path, OSError(28, "")))
        usual(path, text)

    monkeypatch.setattr(files, "write_text", full)
    with pytest.raises(LMeasureError, match=r"scenario\.toml: cannot be written: No space left"):
        init.run(init.Settings(out=tmp_path, template="six-cables"))
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_what_cannot_be_entered_is_taken_away_again(tmp_path: Path) -> None:
    """Else the same command, after room was made, would take it for somebody's."""
    (tmp_path / LEDGER).mkdir()  # it cannot be written

    def full() -> None:
        with writing("import", [tmp_path / "a", tmp_path / "b"]):
            (tmp_path / "a").write_text("whole")
            raise LMeasureError("the second of two files found no room")

    with pytest.raises(LMeasureError, match="the second"):
        full()
    assert [p.name for p in tmp_path.iterdir()] == [LEDGER]


def test_half_a_pair_of_keys_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, text: str) -> None:
        raise LMeasureError(files.not_written(path, OSError(28, "")))

    monkeypatch.setattr(files, "write_text", full)
    with pytest.raises(LMeasureError, match=r"key\.pub: cannot be written: No space left on device; make room there"):
        new_key(tmp_path / "key")
    assert list(tmp_path.iterdir()) == []


def test_a_zip_that_finds_no_room_was_not_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_zip(tmp_path / "c.zip", SEALED)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lmeasure.certification.bundle.shutil.copyfileobj", full)
    with (
        pytest.raises(LMeasureError, match=r"c\.zip cannot be unpacked there: No space left on device; make room"),
        opened_zip(tmp_path / "c.zip", tmp_path),
    ):
        pass
