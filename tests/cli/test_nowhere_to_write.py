"""On a full disk and in a folder that is read-only, every command that writes ends in one line, which names the file and says what to do;
no file is left, neither half-written nor one that the next command would take for somebody's."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lmeasure import files
from lmeasure.acquisition.decoders import counter_fields
from lmeasure.acquisition.feed import frames_from_counts
from lmeasure.acquisition.growing_files import candump_lines
from lmeasure.certification.bundle import opened_zip, write_zip
from lmeasure.certification.signature import new_key
from lmeasure.errors import LMeasureError
from lmeasure.run import read_run
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
)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("desk")
    shutil.copytree(SEALED, here / "sealed")
    shutil.copytree(RUN, here / "run")
    run = read_run(RUN)
    frames = frames_from_counts(run.passes[0].time_s[:50], run.passes[0].recorded[:50], counter_fields(run.rig), run.rig.can_table.sync_id)
    (here / "drive.log").write_bytes(candump_lines(frames))
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
