"""Work that is watched: how far it is, its end by whoever watches, what it gives and what it has written."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from in_process import refused

from lmeasure.cli.progress import FACES
from lmeasure.core import CancelledError, OverwriteError
from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig, write_campaign
from lmeasure.simulation.instrument import simulate_campaign
from lmeasure.workflows import load

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
BOX = {"x": (-50.0, 50.0, 50.0), "y": (-50.0, 50.0, 50.0), "z": (-50.0, 50.0, 50.0)}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration folder, a run folder and a task of placement."""
    folder = tmp_path_factory.mktemp("cell")
    made = simulate_campaign(
        cell_rig(3), 12, np.random.default_rng(4), centre=HOME, half_mm=(300, 300, 300), tilt_rad=0.3, nominal_shift_mm=5.0
    )
    write_campaign(folder / "campaign", made)
    shutil.copytree(TRUTH / "cell-run", folder / "run")
    return folder


class Watch:
    """Keeps what it is told, and ends the work at the call with that number."""

    def __init__(self, end_at: int = -1) -> None:
        self.reported: list[tuple[float, str]] = []
        self.end_at = end_at

    def __call__(self, fraction: float, text: str) -> None:
        self.reported.append((fraction, text))
        if len(self.reported) - 1 == self.end_at:
            raise CancelledError


def requested(command: str, cell: Path, out: Path) -> Any:
    given: dict[str, dict[str, Any]] = {
        "calibrate": {"folder": cell / "campaign", "out": out / "calibrated", "rerun": out / "c.rrd"},
        "zone": {"rig": cell / "run" / "rig.toml", **BOX, "out": out / "zone.nc", "report": out / "report"},
        "plan-poses": {"rig": cell / "campaign" / "rig.toml", "poses": 8, "box": ((-200.0, 200.0),) * 3, "out": out / "poses.csv"},
        "reconstruct": {"run": cell / "run", "out": out / "t.parquet"},
    }
    return load(command).settings(**given[command])


WRITTEN = {
    "calibrate": {"calibrated/rig.toml", "calibrated/calibration.json", "calibrated/report.html", "c.rrd"},
    "zone": {"zone.nc", "report/zone.html", "report/zone.pdf"},
    "reconstruct": {"t.parquet"},
}


@pytest.mark.parametrize("command", WRITTEN)
def test_work_tells_how_far_it_is_and_what_it_wrote_and_ends_when_it_is_told(command: str, cell: Path, tmp_path: Path) -> None:
    """Ended at any of its steps, from the first to the last, no file is there, nor a half of one."""
    whole, run = Watch(), load(command).run
    result = run(requested(command, cell, tmp_path / "out"), whole)
    fractions = [fraction for fraction, _ in whole.reported]
    assert fractions[-1] == 1.0
    assert all(0.0 <= f <= 1.0 for f in fractions)
    assert {p.relative_to(tmp_path / "out").as_posix() for p in result.files} == WRITTEN[command]
    assert result.summary
    for end_at in (0, len(whole.reported) - 1):
        watch = Watch(end_at)
        with pytest.raises(CancelledError, match="Nothing was left half-written"):
            run(requested(command, cell, tmp_path / f"ended{end_at}"), watch)
        assert len(watch.reported) == end_at + 1
        assert [p for p in (tmp_path / f"ended{end_at}").rglob("*") if p.is_file()] == []


def test_what_is_not_its_own_is_not_written_over_by_scripts_either(cell: Path, tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text("mine")
    with pytest.raises(OverwriteError):
        load("plan-poses").run(requested("plan-poses", cell, tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["poses.csv"]


def test_a_command_that_is_ended_is_as_by_ctrl_c(cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FACES, "reconstruct", lambda workflow, settings: workflow.run(settings, Watch(0)))
    said = refused("reconstruct", cell / "run", "--out", tmp_path / "t.csv", code=130)
    assert said == "interrupted. Nothing was left half-written"
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_is_ended_is_kept_and_whole(tmp_path: Path) -> None:
    """As by Ctrl-C: a measurement cannot be made again."""
    write_rig(tmp_path / "rig.toml", cell_rig(6))
    scenario = {"schema": "lmeasure.scenario/1", "rig": "rig.toml", "rate_hz": 200.0, "waypoint": [{"position_mm": [60.0, -40.0, 30.0]}]}
    (tmp_path / "scenario.toml").write_text(tomli_w.dumps(scenario))
    workflow, watch = load("record"), Watch(1)
    settings = workflow.settings.model_validate(
        {"rig": tmp_path / "rig.toml", "bus": f"simulated:{tmp_path / 'scenario.toml'}", "out": tmp_path / "run"}
    )
    result = workflow.run(settings, watch)
    assert result.made.ended == "complete"
    assert not result.failure
    assert [w.split(":")[1].split(".")[0] for w in result.warnings] == [" no --start pose"]
    assert (tmp_path / "run" / "pass1.csv").stat().st_size > 0
