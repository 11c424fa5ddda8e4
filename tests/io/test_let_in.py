"""Nothing is let in: what a folder from elsewhere names stays inside it, and only regular files of bounded size are read."""

import os
import shutil
from pathlib import Path

import pytest

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.io import read_regular, read_toml
from lmeasure.io.files import read_bytes
from lmeasure.io.tables import read_table_in_pieces
from lmeasure.recording import read_run
from lmeasure.rig import read_linked_rig
from lmeasure.view.recording import check_recording

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return Path(shutil.copytree(TRUTH / "cell-run", tmp_path / "run"))


@pytest.mark.parametrize("name", ["/dev/zero", "../calibration.json", "linked.json", "circle.json"])
def test_a_rig_s_calibration_stays_in_its_folder(run: Path, name: str) -> None:
    (run.parent / "calibration.json").write_text("{}")
    (run / "linked.json").symlink_to("../calibration.json")
    (run / "circle.json").symlink_to("circle.json")
    rig = run / "rig.toml"
    rig.write_text(rig.read_text(encoding="utf-8").replace('name = "', f'calibration = "{name}"\nname = "', 1), encoding="utf-8")
    words = "is not the name of a file" if name == "circle.json" else "lies outside the rig's folder"
    with pytest.raises(FileFormatError, match=words) as caught:
        read_linked_rig(rig)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("what", ["pipe", "circle", "device", "folder"])
def test_counts_that_are_no_regular_file(run: Path, what: str) -> None:
    """A pipe was waited for for ever; a link to itself ended in a traceback."""
    counts = run / "pass1.csv"
    counts.unlink()
    if what == "pipe":
        os.mkfifo(counts)
    elif what == "circle":
        counts.symlink_to(counts.name)
    elif what == "device":
        counts.symlink_to("/dev/zero")
    else:
        counts.mkdir()
    with pytest.raises(FileFormatError, match=r"pass1\.csv") as caught:
        read_run(run)
    assert "\n" not in str(caught.value)
    assert what != "pipe" or "it is no regular file but a pipe or a device" in str(caught.value)


def test_every_reader_refuses_a_pipe(tmp_path: Path) -> None:
    for suffix in (".csv", ".parquet", ".toml", ".rrd"):
        os.mkfifo(tmp_path / f"pipe{suffix}")
    for read in (
        lambda: read_bytes(tmp_path / "pipe.toml"),
        lambda: read_toml(tmp_path / "pipe.toml"),
        lambda: list(read_table_in_pieces(tmp_path / "pipe.csv")),
        lambda: list(read_table_in_pieces(tmp_path / "pipe.parquet")),
        lambda: check_recording(tmp_path / "pipe.rrd"),
    ):
        with pytest.raises(LMeasureError, match="it is no regular file but a pipe or a device"):
            read()  # type: ignore[no-untyped-call]


def test_sizes_are_bounded(tmp_path: Path) -> None:
    """A sparse file of 100 MB called rig.toml costs nothing to make."""
    path = tmp_path / "rig.toml"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(FileFormatError, match=r"rig\.toml: cannot be read: 100000000 bytes, 67108864 are the most"):
        read_toml(path)
    assert len(read_regular(path)) == 100_000_000
