"""`lmeasure zone` as a user types it."""

from pathlib import Path

import numpy as np
import pytest
from in_process import ran, refused
from zone_rigs import cell, published

from lmeasure.accuracy import box_around, read_zone
from lmeasure.rig import rig_from_dict, write_rig


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    write_rig(tmp_path / "rig.toml", cell())
    return tmp_path / "rig.toml"


def box(span: str) -> list[str]:
    return ["--x", span, "--y", span, "--z", span]


def test_zone_is_written_with_its_page(rig_file: Path) -> None:
    out = rig_file.with_name("zone.nc")
    arguments = ["zone", str(rig_file), *box("-200:200:100"), "--tilt-rad", "0.3", "--tilt-steps", "3", "--limit-deg", "60"]
    result = ran(*arguments, "--out", out, "--report", rig_file.parent / "report")
    zone = read_zone(out)
    assert dict(zone.sizes) == {"x": 5, "y": 5, "z": 5, "orientation": 27, "component": 4}
    assert zone.attrs["zone_volume_mm3"] == int(zone["in_zone"].sum()) * 1e6
    assert f"{int(zone['in_zone'].sum())} of 125 nodes" in result
    page = (rig_file.parent / "report" / "zone.html").read_text(encoding="utf-8")
    assert "Plotly.newPlot" in page
    assert 'src="http' not in page


def test_thesis_scan_by_its_own_angles(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", published())
    angle = "-17.188733853924695:17.188733853924695:17.188733853924695"
    arguments = ["zone", str(tmp_path / "rig.toml"), "--x", "-750:750:250", "--y", "-750:750:250", "--z", "-300:700:250"]
    arguments += ["--o", angle, "--a", angle, "--t", angle, "--length-mm", "700:2300", "--out", str(tmp_path / "zone.nc")]
    result = ran(*arguments)
    assert "0 of 245 nodes are in the zone (27 orientations each" in result


def test_without_ranges_the_box_is_around_the_rig_and_said(rig_file: Path) -> None:
    out = rig_file.with_name("zone.nc")
    result = ran("zone", rig_file, "--limit-deg", "45", "--out", out)
    (x, y, z), rig = box_around(cell()), cell()
    written = " ".join(f"--{name} {a:g}:{b:g}:{step:g}" for name, (a, b, step) in zip("xyz", (x, y, z), strict=True))
    assert result.startswith(f"no range stated. The box is {written}, around the rig\n")
    zone, points = read_zone(out), np.array([p.position_mm for p in rig.observation_point])
    for axis, name in enumerate("xyz"):
        nodes = zone[name].values
        assert nodes[0] <= min(points[:, axis].min(), 0.0)
        assert nodes[-1] >= max(points[:, axis].max(), 0.0)
        assert 5 < len(nodes) < 40
    # what it says is what does it again
    again = ran("zone", rig_file, "--limit-deg", "45", *written.split(), "--force", "--out", out)
    assert result.splitlines()[1:3] == again.splitlines()[:2]
    assert "no range" not in again
    some = written.split()[:2]
    part = ran("zone", rig_file, "--limit-deg", "45", *some, "--force", "--out", out)
    assert part.startswith(f"no range stated for --y, --z. The box is {' '.join(written.split()[2:])}, around the rig\n")


@pytest.mark.parametrize("places", [[(0, 0, 0)], [(10, 20, 3000), (900, -700, 3000)], [(1e5, 0, 0), (0, 1, 0)]])
def test_a_box_around_points_of_any_shape(places: list[tuple[float, float, float]]) -> None:
    data = cell().to_dict()
    for i, p in enumerate(data["observation_point"]):
        p["position_mm"] = [float(v) for v in places[i % len(places)]]
    ranges = box_around(rig_from_dict(data))
    counts = [(b - a) / step for a, b, step in ranges]
    assert all(abs(n - round(n)) < 1e-9 for n in counts)
    assert max(counts) <= 24
    assert min(counts) >= 5
    for axis, (a, b, _) in enumerate(ranges):
        assert all(a <= p[axis] <= b for p in (*places, (0, 0, 0)))


def test_an_empty_zone_says_what_to_do(rig_file: Path) -> None:
    result = ran("zone", rig_file, *box("-100:100:100"), "--limit-deg", "1", "--out", rig_file.parent / "z.nc")
    assert "no position of the box is in the zone: pressure angle alone excludes 27 nodes" in result
    assert f"lmeasure place {rig_file} --task placement.toml --out placed" in result
    whole = rig_file.parent / "z-whole.nc"
    assert result.splitlines()[-1] == f"next: lmeasure zone {rig_file} --out {whole}"
    # the box around the rig has no node within a degree either: then the points have to move
    again = ran("zone", rig_file, "--limit-deg", "1", "--out", whole)
    assert again.splitlines()[-1] == f"next: lmeasure place {rig_file} --task placement.toml --out placed"


@pytest.mark.parametrize(
    "wrong",
    [
        ["--x", "0:10:3"], ["--x", "0:10"], ["--x", "a:b:c"], ["--quaternion", "1,1,0,0"], ["--length-mm", "700"], ["--o", "0:0:1"],
        ["--tilt-steps", "0"], ["--x", "0:1e300:1e299"], ["--tilt-rad", "0.1", "--o", "0:0:1", "--a", "0:0:1", "--t", "0:0:1"],
        ["--o", "0:100:1", "--a", "0:100:1", "--t", "0:100:1"],
    ],
)  # fmt: skip
def test_wrong_usage_is_exit_2_and_writes_nothing(rig_file: Path, wrong: list[str]) -> None:
    out = rig_file.with_name("zone.nc")
    refused("zone", rig_file, *box("0:0:1"), "--out", out, *wrong, code=2)
    assert not out.exists()


def test_every_limit_and_way_of_computing_by_options(rig_file: Path) -> None:
    folder = rig_file.parent
    (folder / "bodies.toml").write_text(
        'schema = "lmeasure.bodies/1"\n[[body]]\nname = "column"\nfrom_mm = [600, 0, -500]\nto_mm = [600, 0, 900]\nradius_mm = 80\n'
    )
    arguments = [
        "zone", str(rig_file), *box("-200:200:100"), "--tilt-rad", "0.2", "--limit-deg", "85", "--u95-mm", "5", "--wrap-deg", "300",
    ]  # fmt: skip
    arguments += ["--u95-rotation-deg", "2", "--u95-attachment-mm", "8", "--clearance-mm", "5", "--bodies", str(folder / "bodies.toml")]
    arguments += ["--singularity", "0.001", "--one-assembly", "--length-mm", "200:3000", "--refine", "0.05", "--workers", "1"]
    arguments += ["--checkpoint", str(folder / "kept"), "--out", str(folder / "zone.nc")]
    first = ran(*arguments)
    zone = read_zone(folder / "zone.nc")
    for name in ("u95_rotation_deg", "u95_attachment_mm", "clearance_mm", "largest_wrap_deg", "assembly", "singularity_distance"):
        assert name in zone
    assert "refined_volume_mm3" in zone.attrs
    assert zone.attrs["limit_clearance_mm"] == 5.0
    # the kept chunks give the same again
    assert ran(*arguments, "--force") == first
    assert read_zone(folder / "zone.nc").attrs["result_sha256"] == zone.attrs["result_sha256"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--limit-deg", "95"], "95 degrees"),
        (["--u95-mm", "-1"], "u95_mm"),
        (["--bodies", "nowhere.toml"], "nowhere.toml"),
        (["--length-mm", "5:1"], "5 to 1 mm"),
        (["--refine", "nan"], "refine = nan"),
        (["--refine", "-1"], "refine = -1"),
        (["--tilt-rad", "0.1", "--tilt-steps", "1000"], "1000000000 orientations"),
        (["--scheduler", "nonsense"], "'nonsense': is no address such as tcp://"),
    ],
)
def test_limits_that_make_no_sense_are_one_line(rig_file: Path, wrong: list[str], said: str) -> None:
    out = rig_file.with_name("zone.nc")
    assert said in refused("zone", rig_file, *box("0:0:1"), "--out", out, *wrong)
    assert not out.exists()


def test_a_broken_chunk_is_named(rig_file: Path) -> None:
    kept = rig_file.with_name("kept")
    words = ["zone", str(rig_file), *box("0:0:1"), "--out", str(rig_file.with_name("zone.nc")), "--checkpoint", str(kept)]
    ran(*words)
    for content in (b"", b"garbage", (kept / "chunk-000000.npz").read_bytes()[:300]):
        (kept / "chunk-000000.npz").write_bytes(content)
        assert "chunk-000000.npz: is no chunk of a scan" in refused(*words, "--force")
