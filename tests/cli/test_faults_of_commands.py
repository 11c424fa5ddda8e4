"""Whatever happens, a command ends in one line with its exit code: no traceback, no message of thousands of characters."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import lmeasure.cli.app as cli
from lmeasure.accuracy import read_zone
from lmeasure.core import FileFormatError, LMeasureError, rotation_from_angles
from lmeasure.core.errors import LONGEST_TEXT
from lmeasure.recording import read_run
from lmeasure.trajectory import reconstruct

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return Path(shutil.copytree(TRUTH / "cell-run", tmp_path / "run"))


def edit(path: Path, pattern: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    changed = re.sub(pattern, new, text, count=1, flags=re.MULTILINE)
    assert changed != text
    path.write_text(changed, encoding="utf-8")


def refused(run: Path, words: str) -> None:
    with pytest.raises(LMeasureError) as caught:
        reconstruct(read_run(run))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("radius", [0.0, 18.0])
def test_an_observation_point_on_its_attachment_point(run: Path, radius: float) -> None:
    data = read_run(run).rig
    at = data.tool[data.cable[0].to_point]  # the start pose is the identity
    edit(run / "rig.toml", r"^position_mm = \[.*\]", f"position_mm = {list(at)}")
    edit(run / "rig.toml", r"^pulley_radius_mm = .*", f"pulley_radius_mm = {radius}")
    refused(run, "lies on B1: the cable has no direction there")


def test_a_scale_that_no_decoder_has(run: Path) -> None:
    edit(run / "rig.toml", r"^count_sign = 1", "count_sign = 1\nscale = 1e-300")
    refused(run, "[observation_point B1].drum.scale: must be at least 1e-06, is 1e-300")


def test_an_angle_of_1e20(run: Path) -> None:
    edit(run / "run.toml", r"^quaternion_xyzw = .*", "o_a_t_deg = [0.0, 1e20, 0.0]")
    refused(run, "run.toml: start: o_a_t_deg: an angle of 1e+20 is too large. The limit is 1e+06")
    with pytest.raises(FileFormatError, match="kuka-abc: an angle of 1e"):
        rotation_from_angles("kuka-abc", [[0.0, 0.0, 1e20]])


def zone_file(path: Path, **changed: Any) -> Path:
    """A zone of two nodes along each axis, with some of its parts exchanged."""
    nodes = {name: changed.get(name, np.array([0.0, 50.0])) for name in "xyz"}
    inside = changed.get("in_zone", np.ones((2, 2, 2), np.int8))
    attributes = {"schema": "lmeasure.zone/1", "node_spacing_mm": [50.0] * 3, "zone_volume_mm3": 1e6, "limit_deg": 60.0}
    data = xr.Dataset({"in_zone": (("x", "y", "z"), inside)}, nodes, attributes | changed.get("attributes", {}))
    data.to_netcdf(path, engine="h5netcdf", format="NETCDF4")
    return path


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"x": np.array([0.0, np.nan])}, "coordinate x must contain finite, rising numbers"),
        ({"y": np.array([50.0, 0.0])}, "coordinate y must contain finite, rising numbers"),
        ({"z": np.array(["a", "b"])}, "coordinate z must contain finite, rising numbers"),
        ({"in_zone": np.full((2, 2, 2), np.nan)}, "variable in_zone must contain only 0 and 1"),
        ({"in_zone": np.full((2, 2, 2), "yes")}, "variable in_zone must contain numbers over x, y, z"),
        ({"attributes": {"node_spacing_mm": "fifty"}}, "attribute node_spacing_mm must contain 3 finite number(s)"),
        ({"attributes": {"zone_volume_mm3": np.nan}}, "attribute zone_volume_mm3 must contain 1 finite number(s)"),
    ],
)
def test_a_zone_with_something_else_in_place_of_numbers(tmp_path: Path, changed: dict[str, Any], words: str) -> None:
    assert read_zone(zone_file(tmp_path / "whole.nc")).sizes == {"x": 2, "y": 2, "z": 2}
    with pytest.raises(FileFormatError, match=r"zone\.nc") as caught:
        read_zone(zone_file(tmp_path / "zone.nc", **changed))
    assert words in str(caught.value)


def test_messages_end_somewhere() -> None:
    text = str(LMeasureError("begin " + "x" * 5000 + " end"))
    assert len(text) == LONGEST_TEXT
    assert text.startswith("begin x")
    assert text.endswith("x end")


def test_what_no_module_foresaw_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fails(**options: object) -> None:
        raise ZeroDivisionError("by\nnothing " + "x" * 5000)

    monkeypatch.setattr(cli, "app", fails)
    monkeypatch.delenv("LMEASURE_DEBUG", raising=False)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("lmeasure: a fault of this program, ZeroDivisionError in test_faults_of_commands.py:")
    assert "No file is half-written. Please report this line, the command and its files. For details set LMEASURE_DEBUG=1" in line
    assert len(line) < 1400
    monkeypatch.setenv("LMEASURE_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli.main()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_standard_output(run: Path, tmp_path: Path) -> None:
    for words in (["--help"], ["reconstruct", str(run), "--out", str(tmp_path / "t.csv")]):
        with Path("/dev/full").open("w") as full:
            done = subprocess.run(
                [sys.executable, "-m", "lmeasure", *words], stdout=full, stderr=subprocess.PIPE, text=True, env=os.environ, check=False
            )
        assert done.returncode == 1
        assert done.stderr.startswith("lmeasure: standard output cannot be written: No space left on device")
        assert done.stderr.count("\n") == 1
    assert (tmp_path / "t.csv").stat().st_size > 100_000
