"""The whole way of a user from an empty folder, by commands alone."""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lmeasure.cli import main
from lmeasure.rig import Rig, read_rig
from lmeasure.simulation import campaign_at

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "capture"))
from capture_bench import RATE_HZ, motion  # noqa: E402


def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: Any, code: int = 0) -> str:
    """What a command prints; how long it took goes to the report."""
    begin = time.monotonic()
    monkeypatch.setattr("sys.argv", ["lmeasure", *map(str, words)])
    with pytest.raises(SystemExit) as stopped:
        main()
    out, err = capsys.readouterr()
    assert (stopped.value.code or 0) == code, err
    with capsys.disabled():
        print(f"\n{words[0]}: {time.monotonic() - begin:.1f} s", end="")
    return out


def built_like(nominal: Rig) -> Rig:
    """The rig that was built: points up to 15 mm and guides up to 2 degrees beside what the file says."""
    true = campaign_at(
        nominal, np.array([[0.0, 0, 0, 0, 0, 0, 1]]), np.random.default_rng(5), nominal_shift_mm=15.0, nominal_shift_deg=2.0
    ).nominal
    quick = [p.model_copy(update={"drum": p.drum.model_copy(update={"max_cable_speed_mm_s": 1e6})}) for p in true.observation_point]
    return true.model_copy(update={"observation_point": tuple(quick)})


def test_an_engineer_from_a_log_that_nobody_described_to_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The log is one of a simulated bus; its `[can]` table is the one that the scan guesses."""
    from lmeasure.acquisition.decoders import counter_fields
    from lmeasure.acquisition.feed import frames_from_counts
    from lmeasure.acquisition.growing_files import candump_lines

    monkeypatch.chdir(tmp_path)
    said(monkeypatch, capsys, "init", "cell", "--template", "six-cables")
    rig = built_like(read_rig(Path("cell/rig.toml")))
    poses = np.array([[0.0, 0, 0, 0, 0, 0, 1], [120.0, -60.0, 80.0, 0, 0, 0, 1], [0.0, 0, 0, 0, 0, 0, 1]])
    made = motion(rig, poses, 0.3, speed_mm_s=400.0)
    fields = counter_fields(rig)
    frames = frames_from_counts(np.arange(len(made.recorded)) / RATE_HZ, made.recorded, fields, rig.can_table.sync_id)
    Path("drive.log").write_bytes(candump_lines(frames))
    guess = said(monkeypatch, capsys, "import", "drive.log", "--scan")
    # what a person does with the guess
    Path("rig.toml").write_text(Path("cell/rig.toml").read_text() + guess[guess.index("\n[can]") :])
    told = said(monkeypatch, capsys, "import", "drive.log", "--rig", "rig.toml", "--out", "run", "--start", "0,0,0,0,-90,90")
    assert "no faults" in told
    said(monkeypatch, capsys, "reconstruct", "run", "--out", "trajectory.parquet")
    said(monkeypatch, capsys, "report", "run", "--out", "page")
    assert Path("page/trajectory.html").stat().st_size > 10_000
