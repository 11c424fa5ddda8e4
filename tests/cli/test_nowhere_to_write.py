"""On a full disk and in a folder that is read-only, every command that writes ends in one line, which names the file and says what to do;
no file is left, neither half-written nor one that stands in the way of the next command."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from capture_bench import POSES, RIG, nominal_of, write_inputs
from desk import LONG, RECORDINGS, SEALED, SHORT

from lmeasure.certificate import opened_zip, write_zip
from lmeasure.core import LMeasureError
from lmeasure.io import files
from lmeasure.procedures import CaptureFolder, open_folder
from lmeasure.rig import read_rig
from lmeasure.text import message
from lmeasure.workflows import init

HERE = Path(__file__).parents[1]
NAMES = (
    "schema", "key", "import", "reconstruct", "reconstruct tum", "reconstruct mcap", "zone", "program", "certify", "mechanism", "init",
    "frames", "correct", "dyads", "record", "capture",
)  # fmt: skip
EVERY = SHORT | LONG | RECORDINGS
LINES = (*(EVERY[name] for name in NAMES), "reconstruct run --out OUT/t.csv", "reconstruct run --out again.parquet --rerun OUT/t.rrd")


@pytest.mark.skipif(sys.platform != "linux", reason="limits and rights of a process there")
@pytest.mark.parametrize("mode", ["full", "closed"])
def test_a_command_with_nowhere_to_write_ends_in_one_line(mode: str, desk: Path) -> None:
    lines = LINES if mode == "full" else LINES[::4]  # what a command says of both is one sentence
    words = [sys.executable, str(HERE / "helpers" / "starved.py"), mode, str(desk / "out")]
    done = subprocess.run(words, input="\n".join(lines), capture_output=True, text=True, cwd=desk, check=True)
    remedies = tuple(message(f"os.remedy.{remedy}").lower() for remedy in files.TO_DO.values())
    for line, text in zip(lines, done.stdout.splitlines(), strict=True):
        code, said, left = json.loads(text)
        if code == "root":
            pytest.skip("root here may not give up its right to write everywhere")
        assert (code, len(said), left) == (1, 1, []), (line, said)
        assert str(desk / "out") in said[0], line
        assert said[0].lower().endswith(remedies), line


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
    usual = Path.write_text

    def full(path: Path, text: str, **how: Any) -> int:
        if "scenario.toml" in path.name:
            raise OSError(28, "")
        return usual(path, text, **how)

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(LMeasureError, match=r"scenario\.toml: cannot be written: No space left"):
        init.run_init(init.InitSettings(out=tmp_path, template="six-cables"))
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_zip_that_finds_no_room_was_not_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_zip(tmp_path / "c.zip", SEALED)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lmeasure.certificate.bundle.shutil.copyfileobj", full)
    with (
        pytest.raises(LMeasureError, match=r"c\.zip cannot be unpacked there: No space left on device; make room"),
        opened_zip(tmp_path / "c.zip", tmp_path),
    ):
        pass
