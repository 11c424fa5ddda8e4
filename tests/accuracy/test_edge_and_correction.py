"""The zone's edge by following it, and paths led around its limits: against nodes and against the zone's own figures."""

import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from in_process import ran, refused
from scipy.spatial.transform import Rotation

from lmeasure import zone
from lmeasure.accuracy import Limits, Scan, edges, tilts
from lmeasure.core import FloatArray, StructureError
from lmeasure.io import files
from lmeasure.linkages import Slice, detour, first_met
from lmeasure.recording import CommandedPath, Program, read_program, write_program
from lmeasure.report import write_zone_page
from lmeasure.rig import read_rig
from lmeasure.robots import ParallelFile, any_shipped
from lmeasure.structure import bounds_of, read_linkage

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
RIG = TRUTH / "cell-run" / "rig.toml"


EIGHT = TRUTH / "eight-run" / "rig.toml"


def angle_at(place: np.ndarray, turns: Rotation, rig: Path = RIG) -> float:
    """Worst pressure angle [deg] that `zone` gives for a place."""
    x, y, z = (float(v) for v in place)
    data = zone(rig, x=(x, x, 1), y=(y, y, 1), z=(z, z, 1), rotations=turns)
    return float(data["worst_pressure_angle_deg"].values[0, 0, 0])


def test_the_edge_of_a_zone_lies_on_its_limit(tmp_path: Path) -> None:
    """Closed, of the size that nodes count, and at each place the worst angle of all orientations is the limit."""
    rig, turns = read_rig(RIG), tilts(0.1, 2)
    data = zone(RIG, x=(-1500, 1500, 50), y=(-1500, 1500, 50), z=(0, 0, 1), rotations=turns, scan=Scan(limits=Limits(45.0)))
    (found,), said = edges(rig, data, turns)
    assert (found.closed, said) == (True, [])
    counted = float(data["in_zone"].values.sum()) * 50.0**2
    assert found.area_mm2 == pytest.approx(counted, rel=0.02)
    assert found.area_mm2 is not None
    write_zone_page(tmp_path / "zone.html", data, rig, followed=[found])
    assert all(words in (tmp_path / "zone.html").read_text() for words in ("Traced edge", f"closed, {found.area_mm2 / 1e6:.4g}"))
    assert {limit.split(" in ")[0] for limit in found.limits} <= {f"pressure angle of {c.name}" for c in rig.cable}
    for place in found.places[:: len(found.places) // 4]:
        assert angle_at(place, turns) == pytest.approx(45.0, abs=1e-6)


def test_the_boundary_of_eight_cables_is_the_zones_limit() -> None:
    """More cables than six have no determinant: their angles are those of a run's least squares, and so are the zone's."""
    linkage, up = read_linkage(EIGHT), np.array([0.0, 0.0, 0.0, 1.0])
    places = np.stack(np.meshgrid(np.arange(-900.0, 901.0, 300.0), np.arange(-900.0, 901.0, 300.0), [0.0]), axis=-1).reshape(-1, 3)
    poses = np.column_stack([places, np.tile(up, (len(places), 1))])
    bounds = bounds_of(linkage, poses[len(poses) // 2], 70.0, None)
    best = poses[int(np.argmax(np.nan_to_num(bounds.values(poses).min(axis=1), nan=-np.inf)))]
    plane = Slice(best, np.eye(3)[:2], 3000.0)
    (met,) = first_met(bounds, plane, np.array([[1.0, 0.0]]))
    on = best[:3] + [met, 0.0, 0.0]
    assert angle_at(on, Rotation.identity(1), EIGHT) == pytest.approx(70.0, abs=1e-6)
    # a path over it and back is led along it
    beyond = best + np.append([met + 20.0, 0.0, 0.0], np.zeros(4))
    found = detour(bounds, np.stack([best, beyond, best]), turns=False)
    assert bounds.inside(found.poses).all() or (bounds.values(found.poses) > -1e-7).all()
    assert 0.0 < found.norm_mm.max() <= 20.0 + 1e-6
    with pytest.raises(StructureError, match="state a limit angle or lengths"):
        bounds_of(linkage, best, None, None)


def test_an_edge_beyond_the_box_is_open() -> None:
    data = zone(RIG, x=(-100, 100, 50), y=(-1500, 1500, 50), z=(0, 0, 1), scan=Scan(limits=Limits(45.0)))
    (found,), _ = edges(read_rig(RIG), data, Rotation.identity(1))
    assert found.closed  # the window is the box's larger side
    data = zone(RIG, x=(-100, 100, 50), y=(-100, 100, 50), z=(0, 0, 1), scan=Scan(limits=Limits(45.0)))
    assert edges(read_rig(RIG), data, Rotation.identity(1)) == ([], ["edge at z = 0 mm: none within the scanned box"])


PATHS = (
    CommandedPath(name="inside", kind="linear", start_mm=(200.0, -300.0, 0.0), end_mm=(250.0, -300.0, 0.0)),
    CommandedPath(
        name="round", kind="circular", centre_mm=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), radius_mm=700.0, start_mm=(0.0, 700.0, 0.0)
    ),
    CommandedPath(name="out", kind="linear", start_mm=(0.0, 0.0, 0.0), end_mm=(5000.0, 0.0, 0.0)),
    CommandedPath(name="end", kind="linear", start_mm=(500.0, 0.0, 0.0), end_mm=(690.0, 0.0, 0.0)),
    CommandedPath(
        name="weave", kind="linear", start_mm=(600.0, -50.0, 0.0), end_mm=(600.0, 50.0, 0.0), weave_stroke_mm=80.0, weave_distance_mm=10.0
    ),
)


def within_ball(count: int, radius: float) -> FloatArray:
    """Places (count, 3) within a ball about the origin."""
    rng = np.random.default_rng(0)
    away = rng.normal(size=(count, 3))
    return np.asarray(away * radius * rng.uniform(0.0, 1.0, (count, 1)) ** (1 / 3) / np.linalg.norm(away, axis=1, keepdims=True))


def test_a_path_that_leaves_the_zone_is_led_around(tmp_path: Path) -> None:
    write_program(tmp_path / "program.toml", Program(schema_="lmeasure.program/1", path=PATHS))
    words = ["program", "--out", tmp_path / "led", "--correct", tmp_path / "program.toml", "--rig", RIG, "--limit-deg", 45]
    done = ran(*words)
    lines = done.splitlines()
    assert "path inside: within the limits" in lines
    assert "path out: NOT CHANGED: no pose near the commanded one keeps the limits" in done
    inside, led, out, end, weave = read_program(tmp_path / "led" / "program.toml").path
    assert (inside, out, led.kind) == (PATHS[0], PATHS[2], "points")
    points = led.points(5.0)
    np.testing.assert_allclose(points[[0, -1]], [(0.0, 700.0, 0.0)] * 2, atol=1e-9)
    angles = np.array([angle_at(p, Rotation.identity(1)) for p in points[::120]])
    assert angles.max() < 45.0 + 1e-3
    assert np.array([angle_at(p, Rotation.identity(1)) for p in PATHS[1].points(5.0)[::200]]).max() > 50.0
    # the deviation is the least: no place nearer to the command keeps the limit
    linkage = read_linkage(RIG)
    bounds = bounds_of(linkage, np.array([200.0, -300.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 45.0, None)
    table = pd.read_csv(tmp_path / "led" / "corrected.csv")
    k = int(table["deviation_mm"].argmax())
    deviation = float(table["deviation_mm"].to_numpy()[k])
    commanded = table[["commanded_x_mm", "commanded_y_mm", "commanded_z_mm"]].to_numpy(dtype=np.float64)[k]

    def inside_at(places: FloatArray) -> Any:
        return bounds.inside(np.column_stack([places, np.tile([0.0, 0.0, 0.0, 1.0], (len(places), 1))]))

    assert not inside_at(commanded + within_ball(3000, 0.99 * deviation)).any()
    # an end beyond the limit goes to the nearest place that keeps it
    moved = float(np.linalg.norm(end.points(5.0)[-1] - (690.0, 0.0, 0.0)))
    assert f"its start by 0 mm, its end by {moved:.4g} mm" in done
    assert inside_at(end.points(5.0)).all()
    assert not inside_at(np.array([690.0, 0.0, 0.0]) + within_ball(3000, 0.99 * moved)).any()
    # a weave is shifted as a whole: all around its line; a polygon stands for the circle, which costs up to 3.3 mm
    shift = np.subtract(weave.start_mm or (), (600.0, -50.0, 0.0))
    assert (weave.kind, weave.weave_stroke_mm) == ("linear", 80.0)
    np.testing.assert_allclose(np.subtract(weave.end_mm or (), (600.0, 50.0, 0.0)), shift, atol=1e-9)
    turn, along = np.meshgrid(np.radians(np.arange(0.0, 360.0, 5.0)), np.linspace(-50.0, 50.0, 21))
    around = np.column_stack([600.0 + 40.0 * np.cos(turn.ravel()), along.ravel(), 40.0 * np.sin(turn.ravel())])
    assert inside_at(around + shift).all()
    assert not any(inside_at(around + less).all() for less in within_ball(300, float(np.linalg.norm(shift)) - 3.4))


def gaps(file: ParallelFile, poses: FloatArray) -> FloatArray:
    """(n, 6) [deg] between neighbouring carriages of the rotopod, whose rods reach from them to the platform."""
    legs: list[Any] = list(file.leg)
    at = poses[:, None, :3] + np.einsum("nij,mj->nmi", Rotation.from_quat(poses[:, 3:]).as_matrix(), [leg.platform_mm for leg in legs])
    azimuth = file.model.follow(poses, file.model.home_joints) + np.radians([leg.offset_deg for leg in legs])
    ring, height = (np.array([getattr(leg, key) for leg in legs]) for key in ("ring_mm", "height_mm"))
    feet = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), np.zeros_like(azimuth) + height], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(at - feet, axis=-1) - [leg.rod_mm for leg in legs], 0.0, atol=1e-6)
    order = np.sort(np.degrees(azimuth) % 360.0, axis=1)
    return np.diff(np.column_stack([order, order[:, 0] + 360.0]), axis=1)


def test_a_path_that_turns_is_led_around_the_limits_of_a_mechanism(tmp_path: Path) -> None:
    """The rotopod's workspace turns with its platform, and the led path turns along its own length."""
    file = any_shipped("rotopod")
    assert isinstance(file, ParallelFile)
    path = PATHS[1].model_copy(update={
        "centre_mm": (0.0, 0.0, 965.0), "radius_mm": 100.0, "start_mm": (0.0, 100.0, 965.0),
        "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "end_quaternion_xyzw": (0.0, 0.0, 0.5, np.sqrt(0.75)),
    })  # fmt: skip
    write_program(tmp_path / "program.toml", Program(schema_="lmeasure.program/1", path=(path,)))
    words = ["program", "--out", str(tmp_path / "led"), "--correct", str(tmp_path / "program.toml"), "--robot"]
    ran(*words, "rotopod")
    (led,) = read_program(tmp_path / "led" / "program.toml").path
    assert (led.kind, led.end_quaternion_xyzw) == ("points", path.end_quaternion_xyzw)
    angles = []
    for one in (path, led):
        points = one.points(5.0)
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        turns = one.orientation(gone / gone[-1])
        assert turns is not None
        angles.append(gaps(file, np.column_stack([points, turns.as_quat()])[::3]))
    assert angles[0].min() < 11.0
    assert 12.0 - 1e-3 < angles[1].min() < angles[1].max() < 120.0 + 1e-3
    np.testing.assert_allclose(led.points(5.0)[[0, -1]], [(0.0, 100.0, 965.0)] * 2, atol=1e-9)
    assert "paths are corrected for platforms with six joints" in refused(*words, "crank-platform", "--force", code=2)


def test_limits_of_hooke_joints_end_the_boundary_of_logos(tmp_path: Path) -> None:
    """5.8: where a leg turns or a joint bends as far as the file allows, by the text's vectors."""
    legs = files.read_toml(Path(str(resources.files("lmeasure.robots").joinpath("shipped/logos.toml"))))
    legs["limits"] = {"leg_turn_deg": 8.0, "hooke_deg": 16.0}
    files.write_toml(tmp_path / "logos.toml", legs)
    turn = Rotation.from_euler("z", 8.0, degrees=True)
    words = ["structure", str(tmp_path / "logos.toml"), "--position-mm", "0,0,713.7", "--quaternion", "fixed-xyz:0,0,8", "--boundary", "xy"]
    ran(*words, "--out", tmp_path / "s.json")
    (piece,) = json.loads((tmp_path / "s.json").read_text())["boundary"]["slices"]
    assert {limit.partition(": ")[2] for limit in piece["limits"]} == {"it turns about itself too far", "a Hooke joint bends too far"}
    for place, limit in list(zip(piece["places_mm"], piece["limits"], strict=True))[::15]:
        leg = next(leg for leg in legs["leg"] if limit.startswith(leg["name"]))
        E4 = np.array(place) + turn.apply(leg["platform_mm"]) - leg["base_mm"]
        E2, E6 = np.array(leg["base_axis"]), turn.apply(leg["platform_axis"])
        E3, E5 = np.cross(E4, E2), np.cross(E4, E6)
        away = np.degrees(np.arccos(E3 @ E5 / np.linalg.norm(E3) / np.linalg.norm(E5)))
        bends = [90.0 - np.degrees(np.arccos(abs(E4 @ E) / np.linalg.norm(E4) / np.linalg.norm(E))) for E in (E2, E6)]
        assert min(abs(away - 8.0), *(abs(bend - 16.0) for bend in bends)) < 1e-3


@pytest.mark.parametrize(("words", "said"), [(["--rig", str(RIG)], "--x"), (["--correct", "p.toml"], "correct")])
def test_a_correction_needs_program_and_rig(tmp_path: Path, words: list[str], said: str) -> None:
    assert said in refused("program", "--out", tmp_path, *words, code=2)
