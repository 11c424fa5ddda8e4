"""The zone's report: opened in a browser, its controls clicked; the PDF read back."""

from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import pytest
import xarray as xr
from browser import LOOK, opened
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import lmeasure as lm
from lmeasure.accuracy import Limits, axis, ellipsoids, extent, radii_95, scan_zone, tilts
from lmeasure.accuracy.zone_dataset import within
from lmeasure.report import write_zone_report
from lmeasure.report.readable import page_text, pdf_text
from lmeasure.report.zone_maps import log_colours, maps, ticks
from lmeasure.report.zone_pdf import _edge
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.text import ENGLISH


@pytest.fixture(scope="module")
def rig() -> Rig:
    positions = [(-754, 293, 833), (1354, -63, 412), (402, -807, 1199), (110, -1284, -478), (537, -1183, 1360), (1312, 1347, 689)]
    drum = {"counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 1.2, "tangent_length_mm": 180.0}
    points: list[dict[str, Any]] = [
        {
            "name": f"B{i}",
            "position_mm": at,
            "guide_alpha_deg": float(np.degrees(np.arctan2(-at[2], np.hypot(at[0], at[1])))) + 8.0,
            "guide_beta_deg": float(np.degrees(np.arctan2(at[0], at[1]))) - 5.0,
            "pulley_radius_mm": 14.0 + 2 * i,
            "drum": drum | {"axial_offset_mm": 25.0},
        }
        for i, at in enumerate(positions, 1)
    ]
    tool = {"P1": (0.0, 150.0, 0.0), "P2": (-130.0, -75.0, 10.0), "P3": (130.0, -75.0, -10.0)}
    cables = [{"name": f"c{i + 1}", "channel": f"ch{i + 1}", "from": f"B{i + 1}", "to": f"P{i // 2 + 1}"} for i in range(6)]
    name = "cell <b>&</b> co"
    return rig_from_dict(
        {"schema": "lmeasure.rig/1", "unstated": "exact", "name": name, "observation_point": points, "tool": tool, "cable": cables}
    )


@pytest.fixture(scope="module")
def zone(rig: Rig) -> xr.Dataset:
    return scan_zone(rig, None, x=axis(-400, 400, 100), y=axis(-400, 400, 100), z=axis(-300, 300, 100), rotations=tilts(0.3, 3), full=True)


@pytest.fixture(scope="module")
def folder(rig: Rig, zone: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write_zone_report(folder, zone, rig)
    return folder


def test_page_opens_and_its_slider_in_space_works_without_a_console_error(folder: Path, zone: xr.Dataset, tmp_path: Path) -> None:
    levels = zone.sizes["z"]
    with opened(folder / "zone.html") as page:
        page.wait("document.querySelectorAll('.slider-container').length === 1")
        page.wait("document.querySelector('#space canvas') !== null")
        page.evaluate("document.getElementById('space').closest('details').open = true")
        shown = f"document.getElementById('space').data.slice(0, {levels}).map(t => t.visible === true)"
        assert page.evaluate(shown).index(True) == levels // 2
        # the right and the left end of the slider's way
        for across, level in ((0.995, levels - 1), (0.005, 0)):
            page.click("#space .slider-rail-touch-rect", across=across)
            page.wait(f"document.getElementById('space').layout.sliders[0].active === {level}")
            page.wait(f"JSON.stringify({shown}.map((v, i) => v ? i : -1).filter(i => i >= 0)) === '[{level}]'")
        page.click("#space .legendtoggle")
        page.wait("document.getElementById('space').data.some(t => t.visible === 'legendonly')")
        text = page_text((folder / "zone.html").read_bytes())
        assert page.evaluate(LOOK) == []
        assert page.errors == []
    assert "Accuracy zone of cell <b>&</b> co" in text
    assert f"The zone contains {zone.attrs['nodes_in_zone']} of them" in text
    for heading in (
        "Results",
        "Test cube of ISO 9283 in the zone",
        "Both criteria side by side",
        "Reasons for nodes outside the zone",
        "The rig",
    ):
        assert heading in text


def test_sliders_of_the_limits_and_a_clicked_place_answer(folder: Path, zone: xr.Dataset, rig: Rig, tmp_path: Path) -> None:
    """Maps are those of the dataset, the zone within other limits is what `within` gives, a place has the ellipsoid of its covariance."""

    def move(name: str, value: float) -> str:
        return f"(() => {{ const e = document.getElementById('{name}'); e.value = {value}; e.dispatchEvent(new Event('input')); }})()"

    with opened(folder / "zone.html") as page:
        page.wait("document.getElementById('left').textContent !== ''")
        assert f"{zone.attrs['nodes_in_zone']} of {zone['in_zone'].size}" in page.evaluate("document.getElementById('left').textContent")
        page.evaluate(move("level", 1))
        reported = page.evaluate("document.getElementById('map-angle').data[0].z")
        np.testing.assert_allclose(reported, zone["worst_pressure_angle_deg"].values[:, :, 1].T, rtol=1e-6)
        radius = page.evaluate("document.getElementById('map-u95').data[0].z")
        np.testing.assert_allclose(10.0 ** np.array(radius), zone["u95_position_mm"].values[:, :, 1].T, rtol=1e-5)
        page.evaluate(move("angle", 40))
        page.evaluate(move("u95", 500))
        shown = page.evaluate("[document.getElementById('u95-reported'), document.getElementById('left')].map(e => e.textContent)")
        limit = float(shown[0].removesuffix("\u00a0mm"))
        expected = within(zone, Limits(angle_deg=40.0, u95_mm=limit))["in_zone"].values.sum()
        # the limit is the figure that is printed
        assert int(shown[1].split(": ")[1].split()[0]) == int(expected)
        page.evaluate(
            "(() => { const f = document.getElementById('map-u95'), p = {x: f.data[0].x[2], y: f.data[0].y[5]};"
            "f.emit('plotly_click', {points: [p]}); })()"
        )
        at = np.array([float(zone[n][k]) for n, k in zip("xyz", (2, 5, 1), strict=True)])
        turns = zone["quaternion_xyzw"].values
        start = np.array(zone.attrs["zero_pose_xyz_mm_qxyzw"])
        found = ellipsoids(rig, None, at[None], Rotation.from_quat(turns[len(turns) // 2]), start=start)
        text = page.evaluate("document.getElementById('place').innerText")
        assert f"({', '.join(f'{v:g}' for v in at)})\u00a0mm".replace("-", "\u2212") in text
        assert f"{rig.cable[int(found.weakest[0])].name}: pressure angle {found.angle_deg[0]:.1f}°" in text
        x, y, z = (np.array(page.evaluate(f"document.getElementById('ellipsoid').data[0].{n}")).ravel() for n in "xyz")
        surface = np.column_stack([x, y, z])
        # every point of it is as many standard deviations away
        whitened = np.einsum("ni,ij,nj->n", surface, np.linalg.inv(found.covariance[0]), surface)
        np.testing.assert_allclose(whitened, chi2.ppf(0.95, 3), rtol=1e-3)
        # figures away from the corners, where those of two axes would touch
        for axis, own in zip("xyz", surface.T, strict=True):
            marks = np.array(page.evaluate(f"document.getElementById('ellipsoid').layout.scene.{axis}axis.tickvals"))
            assert list(np.sign(marks)) == [-1, 0, 1]
            assert 0.3 < marks[2] / own.max() < 0.7
        assert page.errors == []


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.15)])
def test_ellipsoids_have_the_radius_and_the_angle_of_the_zone(rig: Rig, turned: tuple[float, float, float]) -> None:
    """One orientation: what the compiled scan gives, worked out another way."""
    nodes, turn = axis(-400, 400, 200), Rotation.from_rotvec(turned)
    one = scan_zone(rig, None, x=nodes, y=nodes, z=nodes, rotations=Rotation.from_quat([turn.as_quat()]))
    places = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    found = ellipsoids(rig, None, places, turn, start=np.array(one.attrs["zero_pose_xyz_mm_qxyzw"]))
    reported = np.isfinite(found.angle_deg) & (one["worst_pressure_angle_deg"].values.ravel() < 89.9)
    np.testing.assert_allclose(radii_95(found.covariance[reported]), one["u95_position_mm"].values.ravel()[reported], rtol=1e-9)
    np.testing.assert_allclose(found.angle_deg[reported], one["worst_pressure_angle_deg"].values.ravel()[reported], atol=1e-7)
    assert reported.sum() > 50


def test_each_variable_of_a_zone_is_drawn_level_by_level(zone: xr.Dataset) -> None:
    angle = zone["worst_pressure_angle_deg"]
    shown = [heat.z for heat in lm.plot(angle).data]
    np.testing.assert_array_equal(shown, np.float32(angle.transpose("z", "y", "x").values))
    with pytest.raises(lm.LMeasureError, match="quaternion_xyzw"):
        lm.plot(zone["quaternion_xyzw"])


def test_a_scale_of_logarithms_is_labelled_by_round_values() -> None:
    assert ticks(0.011, 0.53) == pytest.approx([0.02, 0.05, 0.1, 0.2, 0.5])
    assert ticks(0.21, 0.3) == [0.21, 0.3]
    assert log_colours(0.9, 110.0)["ticktext"] == ["1", "2", "5", "10", "20", "50", "100"]


def test_pdf_is_whole_and_the_same_each_time(folder: Path, zone: xr.Dataset, rig: Rig, tmp_path: Path) -> None:
    pdf = (folder / "zone.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-1.7")
    assert b"pdfaid" in pdf
    write_zone_report(tmp_path, zone, rig)
    assert (tmp_path / "zone.pdf").read_bytes() == pdf


def test_the_first_level_is_one_with_the_zone(rig: Rig, zone: xr.Dataset) -> None:
    """The middle one where the zone is there, else that with most of it."""

    def level(held: dict[int, int]) -> int:
        inside = np.zeros_like(zone["in_zone"].values)
        for k, n in held.items():
            inside[:n, 0, k] = 1
        (name, _, low, high, value, _), *_ = maps(zone.assign(in_zone=(zone["in_zone"].dims, inside)), rig, None, ENGLISH)["sliders"]
        assert (name, low, high) == ("level", 0, 6)
        return int(value)

    assert [level(held) for held in ({}, {0: 2, 3: 1}, {0: 1, 1: 3, 6: 2})] == [3, 3, 1]


def test_the_edge_of_a_zone_is_not_that_of_the_box() -> None:
    """Cells x, y; X to the right, Y up. What lies beyond the box nobody scanned."""
    assert _edge(np.ones((2, 3), bool)) == ""
    lower = np.zeros((2, 3), bool)
    lower[:, 0] = True
    assert _edge(lower) == "M0 2h1M1 2h1"
    left = np.zeros((2, 3), bool)
    left[0] = True
    assert _edge(left) == "M1 2v1M1 1v1M1 0v1"


@pytest.mark.parametrize("limit", [1.0, 30.0, 60.0, 89.0])
def test_a_limit_stands_below_its_colour(rig: Rig, limit: float, tmp_path: Path) -> None:
    """On paper: as far from both ends as its angle is, but for the width of what is written there."""
    nodes = axis(0, 100, 100)
    write_zone_report(tmp_path, scan_zone(rig, None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.1, 2), limit_deg=limit), rig)
    document = pypdfium2.PdfDocument(tmp_path / "zone.pdf")
    sheet = document[0]
    text = sheet.get_textpage()
    boxes = {text.get_text_bounded(*box): box for box in (text.get_rect(i) for i in range(text.count_rects()))}
    line = next(box for said, box in boxes.items() if f"limit {limit:g}°" in said)
    place = (line[0] + line[2]) / 2 / sheet.get_width()
    # the scale is 70 % of what is within margins of 20 mm of 210
    expected = (20 + 170 * (0.15 + 0.7 * limit / 90)) / 210
    assert place == pytest.approx(expected, abs=0.07 if limit in (1.0, 89.0) else 0.01)
    document.close()


@pytest.mark.parametrize(("limit_deg", "edge"), [(1.0, False), (50.0, True), (89.0, False)])
def test_only_a_zone_that_ends_within_the_box_has_an_edge(rig: Rig, tmp_path: Path, limit_deg: float, edge: bool) -> None:
    nodes = axis(-300, 300, 150)
    found = scan_zone(rig, None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 2), limit_deg=limit_deg)
    assert bool(found["in_zone"].values.any()) is (limit_deg > 1.0)
    write_zone_report(tmp_path, found, rig)
    page = page_text((tmp_path / "zone.html").read_bytes())
    assert ("The orange surface is the edge of the zone" in page) is edge
    assert ("The white line is the edge of the zone" in pdf_text((tmp_path / "zone.pdf").read_bytes())) is edge


def test_page_of_an_empty_zone_says_so(rig: Rig, tmp_path: Path) -> None:
    empty = scan_zone(rig, None, x=axis(0, 100, 50), y=axis(0, 100, 50), z=axis(0, 100, 50), rotations=tilts(0.3, 3), limit_deg=10.0)
    write_zone_report(tmp_path / "empty", empty, rig)
    with opened(tmp_path / "empty" / "zone.html") as page:
        page.wait("document.getElementById('left').textContent.startsWith('Within these limits: 0 of')")
        assert "No position lies in the zone. The best one has a worst pressure angle of" in page.evaluate("document.body.innerText")
        assert page.errors == []


def test_extent_of_a_ball() -> None:
    """A zone that is a ball of 400 mm: its volume, and the cube, box and ball that fit."""
    nodes = np.arange(-500.0, 501.0, 50.0)
    x, y, z = np.meshgrid(nodes, nodes, nodes, indexing="ij")
    inside = x**2 + y**2 + z**2 <= 400.0**2
    dims = ("x", "y", "z")
    zone = xr.Dataset(
        {"in_zone": (dims, inside.astype(np.int8)), "worst_pressure_angle_deg": (dims, np.where(inside, 50.0, 70.0))},
        coords={"x": nodes, "y": nodes, "z": nodes},
        attrs={"node_spacing_mm": [50.0, 50.0, 50.0]},
    )
    found = extent(zone)
    exact = 4 / 3 * np.pi * 400.0**3
    assert abs(found.volume_mm3 - exact) <= found.volume_error_mm3
    assert found.ball is not None
    assert found.ball[0] == pytest.approx(0.0, abs=1e-9)
    assert 300.0 <= found.ball[1] <= 400.0
    assert found.cube is not None
    assert found.cube[0] == pytest.approx(0.0, abs=1e-9)
    # the largest even cube whose corners lie in the ball: edge 2 * 400 / sqrt(3) = 461.9
    assert found.cube[1] == 400.0
    assert found.box is not None
    assert np.prod(found.box[1] - found.box[0]) >= 400.0**3
    assert [p["name"] for p in found.cube_points] == ["P1", "P2", "P3", "P4", "P5"]
    assert found.cube_points[1]["position_mm"] == pytest.approx([160.0, 160.0, -160.0])
