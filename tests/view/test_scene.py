"""Recordings of commands that are about no single run: each figure read back is the one in the command's own file."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from in_process import ran
from recordings import SINGLE, scalars, stored
from test_interim import run_of, true_rig

from lmeasure.acquisition import Check
from lmeasure.acquisition.check.self_test import CableCheck
from lmeasure.recording import write_run
from lmeasure.workflows import record

SEALED = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run" / "inputs"


def bands(path: Path, entity: str, timeline: str) -> np.ndarray:
    return np.sqrt(scalars(path, entity, timeline, "Measurements:variances"))


def test_a_motion_has_speeds_with_their_uncertainties(tmp_path: Path) -> None:
    """A straight line at 100 mm/s in x, whose positions are known to 0.01 mm."""
    time_s = np.arange(400) / 200.0
    table = {"time_s": time_s, "x_mm": 100.0 * time_s, "y_mm": 0.0 * time_s, "z_mm": 50.0 + 0.0 * time_s}
    pd.DataFrame(table).to_csv(tmp_path / "line.csv", index=False)
    ran("motion", tmp_path / "line.csv", "--u-position-mm", 0.01, "--out", tmp_path / "m.parquet", "--rerun", tmp_path / "m.rrd")
    written = pd.read_parquet(tmp_path / "m.parquet")
    speed = scalars(tmp_path / "m.rrd", "/velocity/vx_mm_s", component="Measurements:values")
    known = np.isfinite(speed)
    assert known.sum() > 380
    np.testing.assert_allclose(speed[known], 100.0, rtol=1e-9)
    np.testing.assert_allclose(bands(tmp_path / "m.rrd", "/speed/speed_mm_s", "time"), written["u_speed_mm_s"], rtol=1e-12)
    (strip,) = stored(tmp_path / "m.rrd", "/world/path", "LineStrips3D:strips")[1][0]
    np.testing.assert_allclose(strip, np.column_stack([0.1 * time_s, 0.0 * time_s, 0.05 + 0.0 * time_s])[known], rtol=SINGLE, atol=1e-9)


def test_a_program_shows_its_poses_and_paths(tmp_path: Path) -> None:
    """P1 is the middle of the cube; the square keeps to its plane."""
    box = [word for axis in "xyz" for word in (f"--{axis}", "0:500")]
    ran("program", *box, "--tests", "pose,path", "--out", tmp_path / "program", "--rerun", tmp_path / "p.rrd")
    places = stored(tmp_path / "p.rrd", "/world/commanded/poses", "Points3D:positions")[1][0]
    names = stored(tmp_path / "p.rrd", "/world/commanded/poses", "Points3D:labels")[1][0]
    assert [str(name).partition(" ")[0] for name in names[:5]] == ["P1", "P2", "P3", "P4", "P5"]
    np.testing.assert_allclose(places[0], [0.25] * 3, rtol=SINGLE)
    for strip in stored(tmp_path / "p.rrd", "/world/commanded/paths", "LineStrips3D:strips")[1][0]:
        assert (np.abs(np.array(strip) - 0.25) <= 0.25 + 1e-6).all()
        assert np.linalg.norm(np.diff(strip, axis=0), axis=1).max() <= 0.010001


def test_a_certificate_shows_each_result_with_its_u95(tmp_path: Path) -> None:
    words = [SEALED / "trajectory.parquet", "--run", SEALED / "run", "--program", SEALED / "program.toml", "--trials", 100]
    ran("certify", *words, "--out", tmp_path / "certificate", "--rerun", tmp_path / "c.rrd")
    content = json.loads((tmp_path / "certificate" / "certificate.json").read_text())
    expected = [(c["value"], c["u95"]) for c in content["characteristics"] if c["name"] == "AP_p"]
    values = scalars(tmp_path / "c.rrd", "/AP_mm/AP_p", "row", "Measurements:values")
    np.testing.assert_allclose(np.column_stack([values, bands(tmp_path / "c.rrd", "/AP_mm/AP_p", "row")]), expected, rtol=1e-12)
    attained = stored(tmp_path / "c.rrd", "/world/attained", "Points3D:positions")[1][0]
    np.testing.assert_allclose(attained, [np.divide(a["mean_mm"], 1000.0) for a in content["attained"]], rtol=SINGLE, atol=1e-9)
    assert stored(tmp_path / "c.rrd", "/world/rig/observation_points", "Points3D:positions")[1]


def test_an_intermediate_check_shows_its_closures(tmp_path: Path) -> None:
    write_run(tmp_path / "run", run_of(true_rig(), 0)[0])
    ran("check-instrument", tmp_path / "run", "--out", tmp_path / "out", "--rerun", tmp_path / "check.rrd")
    closures = json.loads((tmp_path / "out" / "check.json").read_text())["closures"]
    for kind in {c["kind"] for c in closures}:
        expected = [c["u95_mm"] for c in closures if c["kind"] == kind]
        np.testing.assert_allclose(bands(tmp_path / "check.rrd", f"/closure_mm/{kind}", "row"), expected, rtol=1e-12)


def test_a_self_test_shows_its_strokes_and_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lmeasure.rig import write_rig

    write_rig(tmp_path / "rig.toml", true_rig(swivels=False))
    cables = (CableCheck("c1", "ch1", "ch1", 1, stroke_mm=312.5, slack_mm=0.5), CableCheck("c2", "ch2", faults=("no channel moved",)))
    monkeypatch.setattr("lmeasure.acquisition.self_test", lambda *_, **__: Check(200.0, {}, cables, ()))
    settings = record.CheckSettings(rig=tmp_path / "rig.toml", bus="virtual:scene", rerun=tmp_path / "check.rrd")
    record.run_check(settings, ask=lambda step: "")
    assert scalars(tmp_path / "check.rrd", "/stroke_mm/c1", "row").tolist() == [312.5]
    assert np.isnan(scalars(tmp_path / "check.rrd", "/stroke_mm/c2", "row")).all()
    assert "no channel moved" in stored(tmp_path / "check.rrd", "/notes", "TextDocument:text")[1][0][0]
