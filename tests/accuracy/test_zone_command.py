"""`lmeasure zone` as a user types it."""

from pathlib import Path

import pytest
from typer.testing import CliRunner
from zone_rigs import cell, published

from lmeasure.accuracy import read_zone
from lmeasure.cli import app
from lmeasure.rig import write_rig


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    write_rig(tmp_path / "rig.toml", cell())
    return tmp_path / "rig.toml"


def box(span: str) -> list[str]:
    return ["--x", span, "--y", span, "--z", span]


def test_zone_is_written_with_its_page(rig_file: Path) -> None:
    out = rig_file.with_name("zone.nc")
    arguments = ["zone", str(rig_file), *box("-200:200:100"), "--tilt-rad", "0.3", "--tilt-steps", "3", "--limit-deg", "60"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(out), "--report", str(rig_file.parent / "report")])
    assert result.exit_code == 0, result.output
    zone = read_zone(out)
    assert dict(zone.sizes) == {"x": 5, "y": 5, "z": 5, "orientation": 27, "component": 4}
    assert zone.attrs["zone_volume_mm3"] == int(zone["in_zone"].sum()) * 1e6
    assert f"{int(zone['in_zone'].sum())} of 125 nodes" in result.output
    page = (rig_file.parent / "report" / "zone.html").read_text(encoding="utf-8")
    assert "Plotly.newPlot" in page
    assert 'src="http' not in page


def test_thesis_scan_by_its_own_angles(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", published())
    angle = "-17.188733853924695:17.188733853924695:17.188733853924695"
    arguments = ["zone", str(tmp_path / "rig.toml"), "--x", "-750:750:250", "--y", "-750:750:250", "--z", "-300:700:250"]
    arguments += ["--o", angle, "--a", angle, "--t", angle, "--length-mm", "700:2300", "--out", str(tmp_path / "zone.nc")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "0 of 245 nodes are in the zone (27 orientations each" in result.output


@pytest.mark.parametrize(
    "wrong",
    [
        ["--x", "0:10:3"],
        ["--x", "0:10"],
        ["--x", "a:b:c"],
        ["--quaternion", "1,1,0,0"],
        ["--length-mm", "700"],
        ["--o", "0:0:1"],
        ["--tilt-steps", "0"],
    ],
)
def test_wrong_usage_is_exit_2_and_writes_nothing(rig_file: Path, wrong: list[str]) -> None:
    out = rig_file.with_name("zone.nc")
    result = CliRunner().invoke(app, ["zone", str(rig_file), *box("0:0:1"), "--out", str(out), *wrong])
    assert result.exit_code == 2, result.output
    assert not out.exists()
