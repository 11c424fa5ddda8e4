"""`inspect` says what a file is, draws it where a page is wanted, and refuses what it does not know."""

import os
import pty
import struct
from pathlib import Path

import pytest
from in_process import ran, refused

from lmeasure.acquisition import scan_log
from lmeasure.cli.progress import opens_pages
from lmeasure.workflows import load

TESTS = Path(__file__).parents[1]
TRUTH = TESTS / "authorities" / "truth"
RUN = TRUTH / "cell-run"
ROBOTS = TESTS.parent / "lmeasure" / "robots" / "shipped"
SEALED = TESTS / "authorities" / "sealed" / "with-run"


def candump(path: Path, counts: list[int]) -> Path:
    """Write a log of one counter, a frame each 10 ms."""
    data = (struct.pack("<i", count).hex().upper() for count in counts)
    path.write_text("".join(f"({10 + 0.01 * i:.6f}) can0 201#{one}\n" for i, one in enumerate(data)))
    return path


@pytest.mark.parametrize(
    ("path", "line", "following"),
    [
        (RUN, "run folder, passes: 1, 2000 samples in 1.999 s", "reconstruct"),
        (RUN / "rig.toml", "6 cables from 6 observation points, not calibrated", "zone"),
        (ROBOTS / "ur5.toml", "robot ur5", "identify"),
        (ROBOTS / "four-chains.toml", "robot four-chains", "mechanism"),
        (SEALED, "52 characteristics. Not verified here", "verify"),
        (SEALED / "inputs" / "program.toml", "test program, ", "record"),
        (SEALED / "inputs" / "trajectory.parquet", "trajectory, ", "certify"),
    ],
)
def test_a_file_is_named_in_one_line_with_what_to_do_next(path: Path, line: str, following: str) -> None:
    done = ran("inspect", path)
    first, second = done.splitlines()
    assert first.startswith(f"{path}: ")
    assert line in first
    assert second.startswith(f"next: lmeasure {following} ")


def test_either_table_of_a_calibration_folder_names_it() -> None:
    folder = TRUTH / "cell-12-poses"
    for name in ("counts.csv", "reference_poses.csv"):
        assert ran("inspect", folder / name).startswith(f"{folder}: calibration folder, 12 reference poses")


def test_the_page_of_a_log_draws_its_counts_over_time(tmp_path: Path) -> None:
    """The counts by their own formula: they go round a quarter of a circle and back."""
    counts = [round(5000 * (i / 100) * (2 - i / 100)) for i in range(200)]
    log = candump(tmp_path / "drive.log", counts)
    for words in (["inspect", str(log), "--out"], ["import", str(log), "--scan", "--report"]):
        page = tmp_path / f"{words[0]}.html"
        ran(*words, page)
        assert "201, bytes 0-3" in page.read_text(encoding="utf-8")
    (one,) = scan_log(log).carried
    (counter,) = one.counters
    assert counter.values.tolist() == counts
    assert one.time_s[[0, -1]].tolist() == pytest.approx([10.0, 11.99])


@pytest.mark.parametrize("content", ["# words\n", "[project]\nname = 'x'\n", '{"schema": "other/1"}'])
@pytest.mark.parametrize("name", ["some.toml", "some.json", "some.csv", "some.xyz"])
def test_an_unknown_file_is_refused_in_one_line(name: str, content: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(content)
    (line,) = refused("inspect", path, "--out", tmp_path / "page.html").splitlines()
    assert str(path) in line
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_browser_opens_only_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = load("inspect").settings
    requested, refused = settings.model_validate({"file": "x"}), settings.model_validate({"file": "x", "browser": False})
    monkeypatch.setattr("sys.argv", ["lmeasure", "inspect", "x"])
    ends = pty.openpty()
    with os.fdopen(ends[1], "w") as terminal, Path(os.devnull).open("w") as nowhere:
        monkeypatch.setattr("sys.stdout", terminal)
        on_terminal = opens_pages(requested), opens_pages(refused)
        monkeypatch.setattr("sys.stdout", nowhere)
        elsewhere = opens_pages(requested)
    os.close(ends[0])
    assert (on_terminal, elsewhere) == ((True, False), False)
