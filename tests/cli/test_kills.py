"""A kill leaves every file whole or as it was, a power failure what was announced as written, and the same command goes on from there."""

import os
import sys
from pathlib import Path

import pytest
from desk import RECORDINGS, SHORT
from kills import content, ended, looked_at, made, torn, watched

from lmeasure.certificate import new_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="not every other system brings folders to the disk")


@pytest.mark.parametrize("name", ["schema", "key", "frames", "import"])
def test_what_a_kill_leaves_is_whole_and_no_obstacle(name: str, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    found = looked_at(SHORT[name], desk / "out")
    assert found.wrong == []
    assert found.calls >= 8
    assert found.reruns >= 3, "before the file, beside its unfinished one, and with it"


def test_a_recording_is_on_the_disk_at_the_end(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(desk)
    (desk / "recordings").mkdir()
    with watched(desk / "recordings") as seen:
        assert ended(RECORDINGS["record"], desk / "recordings") == 0
    assert [text for text in seen.wrong if text.endswith("at the end")] == []


def test_a_certificate_is_replaced_in_one_step(tmp_path: Path) -> None:
    out = tmp_path / "certificate"
    for number in (b"1", b"2"):
        before = content(tmp_path)
        with watched(tmp_path) as seen, new_folder(out, force=True) as folder:
            (folder / "inputs").mkdir()
            for name in ("certificate.json", "inputs/run.toml"):
                (folder / name).write_bytes(number)
            (folder / "manifest.json").write_text(
                '{"schema": "lmeasure.bundle/1", "files": [{"file": "certificate.json"}, {"file": "inputs/run.toml"}]}'
            )
        assert seen.wrong == []
        final = made(content(tmp_path))
        assert [wrong for state in seen.states for wrong in torn(made(state), made(before), final)] == []


@pytest.mark.parametrize("left_out", ["replace", "fsync", "fsync of the folder"])
def test_what_is_left_out_is_seen(left_out: str, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else here would tell that it looks."""
    from lmeasure.io import files

    usual = files.to_disk

    def no_rename(path: Path, target: Path) -> None:
        target.write_bytes(path.read_bytes())
        os.unlink(path)  # noqa: PTH108

    monkeypatch.chdir(desk)
    if left_out == "replace":
        monkeypatch.setattr(Path, "replace", no_rename)
    else:
        monkeypatch.setattr(files, "to_disk", lambda path: None if path.is_dir() == left_out.endswith("folder") else usual(path))
    assert [text for text in looked_at(SHORT["schema"], desk / "out").wrong if "on the disk" in text]
