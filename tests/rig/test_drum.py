"""The drum of thesis 5.5: the recomputed example, a cable laid on a drum in 3-D, uncertainties, refusals, the rig file it fills."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_rig
import tomli_w
from in_process import ran, refused
from scipy.optimize import brentq

from lmeasure.core import FileFormatError, RigError
from lmeasure.rig import DrumMeasurement, choose, drum_geometry, drum_summary, read_drums, read_rig, rig_from_dict, with_drums
from lmeasure.rig.drum_measurement import drum_uncertainty


def values(**changes: Any) -> dict[str, Any]:
    """The example whose numbers were recomputed from the thesis: K0, t0, t1 and the rest are known to six digits."""
    out = {
        "point": "B1", "counts_per_revolution": 6000, "groove_pitch_mm": 1.5, "drum_radius_mm": 11.456669, "fixed_pulley_radius_mm": 20.0,
        "centre_distance_mm": 150.0, "pulley_plane_mm": 40.0, "cable_end_mm": 5.0, "full_wind_counts": 60000.0,
    } | changes  # fmt: skip
    return {key: value for key, value in out.items() if value is not None}


def measurement(**changes: Any) -> DrumMeasurement:
    return DrumMeasurement.model_validate(values(**changes))


def test_recomputed_example() -> None:
    g = drum_geometry(measurement())
    assert g.groove_angle == pytest.approx(0.020835, abs=1e-6)
    assert g.engaging_angle == pytest.approx(1.494051, abs=1e-6)
    assert g.drum_radius_mm * g.engaging_angle == pytest.approx(17.116849, abs=1e-6)
    assert g.engaging_counts * g.count_length_mm == pytest.approx(17.120565, abs=1e-6)
    assert g.engaging_counts == pytest.approx(1426.7137, abs=1e-4)
    assert g.engaging_travel_mm == pytest.approx(0.356678, abs=1e-6)
    assert g.winding_travel_mm == pytest.approx(14.643322, abs=1e-6)
    assert g.tangent_length_mm == pytest.approx(149.756507, abs=1e-6)
    assert g.axial_offset_mm == pytest.approx(20.0, abs=1e-9)
    assert g.stretch_mm == pytest.approx(151.086106, abs=1e-6)
    assert g.count_length_mm == pytest.approx(0.012, abs=1e-9)


def test_the_length_of_a_count_gives_the_radius() -> None:
    g = drum_geometry(measurement(drum_radius_mm=None, count_length_mm=0.012))
    assert g.drum_radius_mm == pytest.approx(11.456669, abs=1e-6)
    both = drum_geometry(measurement(drum_radius_mm=11.5, count_length_mm=0.012))
    assert both == g, "the length of a count is believed"


def test_tangent_by_laying_a_cable_on_two_circles() -> None:
    """The taut line over two discs, found by search for where it touches them."""
    for r1, r2, a in ((11.456669, 20.0, 150.0), (40.0, 10.0, 90.0), (15.0, 15.0, 60.0)):
        g = drum_geometry(measurement(drum_radius_mm=r1, fixed_pulley_radius_mm=r2, centre_distance_mm=a, full_wind_counts=1e6))

        def ends(angle: float, r1: float = r1, r2: float = r2, a: float = a) -> tuple[float, float]:
            """From the drum's to the pulley's rim at one direction from their centres."""
            return a + (r2 - r1) * math.cos(angle), (r2 - r1) * math.sin(angle)

        # the outer tangent touches both at the same direction: there the line between the rims is square to the radius
        touching = brentq(lambda x: ends(x)[0] * math.cos(x) + ends(x)[1] * math.sin(x), 0.1, math.pi - 0.1, xtol=1e-14)
        assert g.tangent_length_mm == pytest.approx(math.hypot(*ends(touching)), abs=1e-10)


def test_the_radii_do_not_enter_the_offset() -> None:
    for changes in ({"fixed_pulley_radius_mm": 35.0}, {"centre_distance_mm": 400.0}, {"drum_radius_mm": 20.0}):
        assert drum_geometry(measurement(**changes)).axial_offset_mm == pytest.approx(40 - 5 - 60000 * 1.5 / 6000, abs=1e-9)


@pytest.mark.parametrize("by", ["drum_radius_mm", "count_length_mm"])
def test_uncertainties_against_difference_quotients(by: str) -> None:
    size = {"drum_radius_mm": 11.5} if by == "drum_radius_mm" else {"drum_radius_mm": None, "count_length_mm": 0.012}
    u = {
        by: 0.05 if by == "drum_radius_mm" else 1e-5, "groove_pitch_mm": 0.02, "fixed_pulley_radius_mm": 0.1, "centre_distance_mm": 0.5,
        "pulley_plane_mm": 0.3, "cable_end_mm": 0.2, "full_wind_counts": 200.0,
    }  # fmt: skip
    total = np.zeros(2)
    for key, width in u.items():
        ends = []
        for sign in (1, -1):
            base = values(**size)
            g = drum_geometry(DrumMeasurement.model_validate(base | {key: base[key] + sign * 1e-3 * width}))
            ends.append(np.array([g.tangent_length_mm, g.axial_offset_mm]))
        alone = (ends[0] - ends[1]) / 2e-3
        assert drum_uncertainty(measurement(**size, **{f"u_{key}": width})) == pytest.approx(np.abs(alone), rel=1e-6, abs=1e-10), key
        total += alone**2
    assert drum_uncertainty(measurement(**size, **{f"u_{key}": width for key, width in u.items()})) == pytest.approx(
        np.sqrt(total), rel=1e-6
    )
    assert drum_uncertainty(measurement()) == (0, 0)


REFUSALS = [
    ({"centre_distance_mm": 31.0}, "centre_distance_mm: 31 mm is not more than the radii of drum and pulley together, 31.4567 mm"),
    ({"centre_distance_mm": 5.0}, "centre_distance_mm: 5 mm is not more than the radii"),
    ({"full_wind_counts": 1400.0}, "full_wind_counts: 1400 is not more than the 1427 counts that bring the cable to the tangent"),
    ({"full_wind_counts": -60000}, "full_wind_counts: must be positive"),
    ({"count_length_mm": 0.0125}, "drum_radius_mm gives 72 mm of cable per turn, count_length_mm gives 75 mm"),
    ({"drum_radius_mm": None}, "drum_radius_mm or count_length_mm is missing"),
    ({"drum_radius_mm": None, "count_length_mm": 1e-4}, "groove_pitch_mm: must be less than the cable of one turn, 0.6 mm"),
    ({"groove_pitch_mm": -1.5}, "groove_pitch_mm: must be positive"),
    ({"cable_end_mm": "5"}, "cable_end_mm: must be a number, is '5'"),
    ({"u_cable_end_mm": -1}, "u_cable_end_mm: must be at least 0"),
    ({"pulley_plane_cm": 4}, "unknown key 'pulley_plane_cm'. The unit is part of the name: 'pulley_plane_mm'"),
    ({"centre_distance_mm": math.nan}, "centre_distance_mm: must be a finite number"),
]


@pytest.mark.parametrize(("changes", "line"), REFUSALS, ids=[line[:40] for _, line in REFUSALS])
def test_one_line_names_the_key(tmp_path: Path, changes: dict[str, Any], line: str) -> None:
    path = tmp_path / "drums.toml"
    path.write_text(tomli_w.dumps({"schema": "lmeasure.drum/1", "drum": [values(**changes)]}))
    with pytest.raises(FileFormatError) as caught:
        read_drums(path)
    assert str(caught.value).startswith(f"{path}:")
    assert ": [drum B1]" in str(caught.value)
    assert line in str(caught.value)


def test_what_is_no_measurements_file(tmp_path: Path) -> None:
    path = tmp_path / "drums.toml"
    for document, line in (
        ({"drum": [values()]}, "schema: is missing"),
        ({"schema": "lmeasure.drum/1", "drum": []}, "drum: must not be empty"),
        ({"schema": "lmeasure.drum/1", "drum": [values(), values()]}, "drum: the point 'B1' is given 2 times"),
    ):
        path.write_text(tomli_w.dumps(document))
        with pytest.raises(FileFormatError, match=line):
            read_drums(path)


def test_the_rig_is_filled() -> None:
    before = rig_from_dict(test_rig.data() | {"calibration": "calibration.json", "assumed": ["B1.axial_offset_mm", "B1.scale", "P1"]})
    after = with_drums(before, (measurement(u_centre_distance_mm=0.5, u_cable_end_mm=0.3, groove_pitch_mm=1.2),))
    drum = after.point("B1").drum
    assert drum.axial_offset_mm == pytest.approx(40 - 5 - 60000 * 1.2 / 6000)
    assert drum.groove_pitch_mm == 1.2, "positive: paying out takes the pay-out point away from the pulley's plane"
    assert drum.u_axial_offset_mm == 0.3
    assert drum.u_tangent_length_mm == pytest.approx(0.5, rel=0.01)
    assert drum.counter_bits == before.point("B1").drum.counter_bits
    assert after.point("B2") == before.point("B2")
    assert after.assumed == ("B1.scale", "P1")
    assert after.calibration is None
    assert with_drums(after, (measurement(),)).point("B1").drum.u_axial_offset_mm is None
    with pytest.raises(RigError, match=r"rig 'demo': has no observation_point 'B7'. It has B1, B2"):
        with_drums(before, (measurement(point="B7"),))
    with pytest.raises(FileFormatError, match=r"drums.toml: has no drum of 'B2'. It has B1"):
        choose((measurement(),), ["B2"], "drums.toml")


def test_the_command(tmp_path: Path) -> None:
    (tmp_path / "drums.toml").write_text(
        tomli_w.dumps({"schema": "lmeasure.drum/1", "drum": [values(u_pulley_plane_mm=0.3), values(point="B2")]})
    )
    (tmp_path / "rig.toml").write_text(test_rig.RIG.replace('"demo"', '"demo"\ncalibration = "calibration.json"', 1))
    arguments = ["drum", str(tmp_path / "drums.toml"), "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "out.toml")]
    done = ran(*arguments, "--point", "B1")
    assert "B1: tangent 149.757 mm (u not stated), axial offset 20.000 mm (u 0.300), 0.012 mm per count, groove angle 1.194 deg" in done
    assert "note: the link to calibration.json is removed, because it belongs to the earlier drums. Calibrate again" in done
    rig = read_rig(tmp_path / "out.toml")
    assert rig.point("B1").drum.tangent_length_mm == pytest.approx(149.756507, abs=1e-6)
    assert rig.point("B2").drum.tangent_length_mm == 0
    ran(*arguments, "--force")
    assert read_rig(tmp_path / "out.toml").point("B2").drum.axial_offset_mm == pytest.approx(20)
    refused("drum", code=2)


def test_drums_that_are_alike_are_told_in_one_line() -> None:
    determined = drum_summary([measurement(), measurement(point="B2", centre_distance_mm=160.0), measurement(point="B3")])
    assert [line.partition(" tangent")[0] for line in determined] == ["B1, B3:", "B2:"]


COMMENTED = (Path(__file__).parent / "inputs" / "commented-rig.toml").read_text(encoding="utf-8")


def test_a_rig_without_drums_gets_them_and_keeps_its_comments(tmp_path: Path) -> None:
    """What a mechanic has before the drums are measured is read as it is."""
    (tmp_path / "drums.toml").write_text(tomli_w.dumps({"schema": "lmeasure.drum/1", "drum": [values(), values(point="B2")]}))
    (tmp_path / "rig.toml").write_text(COMMENTED)
    arguments = ["drum", str(tmp_path / "drums.toml"), "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "out.toml")]
    ran(*arguments)
    rig, text = read_rig(tmp_path / "out.toml"), (tmp_path / "out.toml").read_text()
    assert rig.point("B1").drum.counts_per_revolution == 6000
    assert rig.point("B1").drum.axial_offset_mm == drum_geometry(measurement()).axial_offset_mm
    assert rig.point("B2").drum.count_sign == -1
    assert rig.assumed == ("P1",)
    comments = [line.partition("#")[2].strip() for line in COMMENTED.splitlines() if "#" in line]
    assert [c for c in comments if f"# {c}" not in text] == []
    (tmp_path / "drums.toml").write_text(tomli_w.dumps({"schema": "lmeasure.drum/1", "drum": [values(point="B2")]}))
    assert "rig.toml:6: [observation_point B1].drum: is missing" in refused(*arguments, "--force")
    assert read_rig(tmp_path / "out.toml") == rig
