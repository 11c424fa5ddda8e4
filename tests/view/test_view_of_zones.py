"""Zones and calibrations in the viewer: clouds, skin, colours, a timeline of their own."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from recordings import HOME, SINGLE, scalars, stored

from lmeasure.accuracy import zone_surface
from lmeasure.recording import poses_from_rows
from lmeasure.rig import CalibrationRecord
from lmeasure.simulation import cell_rig, scattered_poses
from lmeasure.view import write_recording

IntArray = NDArray[np.int64]


def zone() -> xr.Dataset:
    x, y, z = np.array([-100.0, 0.0, 100.0]), np.array([-50.0, 50.0]), np.array([0.0, 200.0])
    angle = np.linspace(20.0, 85.0, 12).reshape(3, 2, 2)
    angle[2, 1, 1] = np.nan
    data = {"worst_pressure_angle_deg": (("x", "y", "z"), angle), "in_zone": (("x", "y", "z"), (angle <= 60.0).astype(np.int8))}
    return xr.Dataset(data, coords={"x": x, "y": y, "z": z}, attrs={"limit_deg": 60.0})


def test_zone_as_two_clouds(tmp_path: Path) -> None:
    data, path = zone(), tmp_path / "zone.rrd"
    write_recording(path, cell_rig(0), zone=data)
    nodes = {}
    for side in ("inside", "outside"):
        at = np.array(stored(path, f"/world/zone/{side}", "Points3D:positions")[1][0])
        angle = stored(path, f"/world/zone/{side}", "worst_pressure_angle_deg")[1][0]
        colour = stored(path, f"/world/zone/{side}", "Points3D:colors")[1][0]
        nodes[side] = [(*(np.rint(1e3 * p)), a) for p, a in zip(at, angle, strict=True)]
        assert len(colour) == len(at)
    for side, low, high in (("inside", 0.0, 60.0), ("outside", 60.0, 90.0)):
        expected = [
            (x, y, z, float(a))
            for i, x in enumerate(data.x.values)
            for j, y in enumerate(data.y.values)
            for k, z in enumerate(data.z.values)
            if low < (a := data["worst_pressure_angle_deg"].values[i, j, k]) <= high
        ]
        assert sorted(nodes[side]) == sorted(expected)
    notes = stored(path, "/notes", "TextDocument:text")[1][0][0]
    assert "7 of 12 nodes" in notes
    assert "1 node has no angle and is not drawn" in notes


def test_zone_has_a_skin(tmp_path: Path) -> None:
    write_recording(tmp_path / "zone.rrd", cell_rig(0), zone=zone())
    at = np.array(stored(tmp_path / "zone.rrd", "/world/zone/surface", "Mesh3D:vertex_positions")[1][0])
    corners = np.array(stored(tmp_path / "zone.rrd", "/world/zone/surface", "Mesh3D:triangle_indices")[1][0])
    vertices, triangles = zone_surface(zone())
    assert at == pytest.approx(1e-3 * vertices, rel=1e-6, abs=1e-9)
    assert (corners == triangles).all()


def test_zone_is_coloured_by_angle(tmp_path: Path) -> None:
    write_recording(tmp_path / "zone.rrd", cell_rig(0), zone=zone())
    redness = []
    for side in ("inside", "outside"):
        angle = np.array(stored(tmp_path / "zone.rrd", f"/world/zone/{side}", "worst_pressure_angle_deg")[1][0])
        colour = np.array(stored(tmp_path / "zone.rrd", f"/world/zone/{side}", "Points3D:colors")[1][0], dtype=np.uint32)
        blue = (colour >> 8) & 0xFF
        red, green = (colour >> 24) & 0xFF, (colour >> 16) & 0xFF
        assert (np.diff(blue[np.argsort(angle)].astype(int)) <= 0).all() or side == "outside"
        redness += list(zip(angle, red.astype(int) - green.astype(int), strict=True))
    redness.sort()
    assert (np.diff([value for _, value in redness]) > 0).all()


def test_zone_is_coloured_by_its_radius_where_that_is_known(tmp_path: Path) -> None:
    """Each tenfold radius is as far along the colours as the one before, whatever the angles are."""
    data = zone()
    radius = 10.0 ** np.linspace(-2.0, 0.0, 12).reshape(3, 2, 2)
    radius[0, 0, 0] = np.inf
    write_recording(tmp_path / "zone.rrd", cell_rig(0), zone=data.assign(u95_position_mm=(("x", "y", "z"), radius[::-1])))
    shown = []
    for side in ("inside", "outside"):
        angle = np.array(stored(tmp_path / "zone.rrd", f"/world/zone/{side}", "worst_pressure_angle_deg")[1][0])
        colour = np.array(stored(tmp_path / "zone.rrd", f"/world/zone/{side}", "Points3D:colors")[1][0], dtype=np.uint32)
        shown += list(zip(angle, ((colour >> 24) & 0xFF).astype(int) - ((colour >> 16) & 0xFF).astype(int), strict=True))
    angles = data["worst_pressure_angle_deg"].values
    by_radius = sorted((radius[::-1][np.isclose(angles, a)][0], redness) for a, redness in shown)
    assert (np.diff([redness for r, redness in by_radius]) >= 0).all()
    assert by_radius[0][1] < by_radius[-1][1] - 100
    assert "colours of /world/zone are U95 of the position" in stored(tmp_path / "zone.rrd", "/notes", "TextDocument:text")[1][0][0]


def test_calibration_on_its_own_timeline(tmp_path: Path) -> None:
    rig = cell_rig(1)
    poses = poses_from_rows(scattered_poses(4, (200.0,) * 3, 0.2, HOME, rng=np.random.default_rng(2)), ["a", "b", "c", "d"])
    record = CalibrationRecord.model_validate(
        {
            "schema": "lmeasure.calibration/1", "rig": "rig.toml", "parameters": [], "covariance": [],
            "residuals": [{"pose": p, "channel": "ch2", "mm": 0.01 * i} for i, p in enumerate("bcd", 1)], "equations": 18, "unknowns": 30,
            "rank": 18, "unobservable": [{"point": "B1", "direction": {"B1.x_mm": 1.0}, "text": "moves along its line of sight"}],
            "warnings": [{"code": "underdetermined", "text": "three equations, five unknowns"}],
        }
    )  # fmt: skip
    path = tmp_path / "calibration.rrd"
    write_recording(path, rig, nominal=cell_rig(2), reference=poses, record=record)
    numbers, translation = stored(path, "/world/tool", "Transform3D:translation", "pose")
    assert numbers.tolist() == [1, 2, 3, 4]
    np.testing.assert_allclose([cell[0] for cell in translation], poses.rows[:, :3] / 1000.0, rtol=SINGLE)
    numbers, _ = stored(path, "/calibration_residual_mm/ch2", "Scalars:scalars", "pose")
    assert numbers.tolist() == [2, 3, 4]
    np.testing.assert_array_equal(scalars(path, "/calibration_residual_mm/ch2", "pose"), [0.01, 0.02, 0.03])
    assert stored(path, "/world/reference_poses", "Points3D:labels")[1][0] == ["a", "b", "c", "d"]
    notes = stored(path, "/notes", "TextDocument:text")[1][0][0]
    assert "undetermined at B1: moves along its line of sight" in notes
    assert "**underdetermined**: three equations, five unknowns" in notes


def test_notes_are_in_the_language_of_the_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    write_recording(tmp_path / "zone.rrd", cell_rig(0), zone=zone())
    (text,) = stored(tmp_path / "zone.rrd", "/notes", "TextDocument:text")[1][0]
    assert "зона: " in text
    assert not re.search("[a-z]{4,}", re.sub(r"#.*|/world/\w+|Parquet", "", text))
