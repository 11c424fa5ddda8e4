"""Placement: the search finds rigs that a random search does not, and keeps the rules."""

import json
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from in_process import ran
from zone_oracle import pressure_angles
from zone_rigs import cell

from lmeasure.accuracy import Placement, axis, place, read_placement, scan_zone, tilts
from lmeasure.accuracy.placement import Box, Search, Where, Work
from lmeasure.core import AccuracyError, FileFormatError
from lmeasure.rig import read_rig, write_rig

TASK = Work(low_mm=(-300, -300, -300), high_mm=(300, 300, 300), nodes=3, tilt_rad=0.3, tilt_steps=2)


def everywhere() -> Placement:
    return Placement(
        task=TASK,
        mount=tuple(Where(points=(f"B{i}",), low_mm=(-1500, -1500, -1500), high_mm=(1500, 1500, 1500)) for i in range(1, 7)),
        keep_out=(Box(low_mm=(-700, -700, -700), high_mm=(700, 700, 700)),),
        length_mm=(400, 2600),
        tolerance_mm=5.0,
    )


def test_placed_rig_is_far_better_than_random_ones_and_keeps_the_rules() -> None:
    rig, wanted = cell(), everywhere()
    placed = place(rig, wanted, generations=24)
    # the best of 3,000 random rigs is about 65 degrees
    assert placed.after["worst_pressure_angle_deg"] < 55.0 < placed.before["worst_pressure_angle_deg"]
    assert placed.after["robust_pressure_angle_deg"] >= placed.after["worst_pressure_angle_deg"]
    nodes = axis(-300, 300, 300)
    zone = scan_zone(placed.rig, None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.3, 2))
    assert float(zone["worst_pressure_angle_deg"].max()) == pytest.approx(placed.after["worst_pressure_angle_deg"], abs=1e-9)
    assert float(zone["u95_position_mm"].max()) == pytest.approx(placed.after["u95_position_mm"], rel=1e-9)
    assert float(zone["shortest_cable_mm"].min()) > 399.8
    assert float(zone["longest_cable_mm"].max()) < 2600.2
    for p in placed.rig.observation_point:
        assert max(map(abs, p.position_mm)) > 699.8
        assert max(map(abs, p.position_mm)) <= 1500.0
    # an independent word on one pose of it
    rows = placed.rig.cable_rows()
    plain = [{"B": r[0:3], "u": r[3:6], "R": r[6], "P": r[7:10]} for r in rows]
    here = scan_zone(placed.rig, None, x=np.zeros(1), y=np.zeros(1), z=np.zeros(1), rotations=tilts(0, 1))
    assert here["worst_pressure_angle_deg"].item() == pytest.approx(
        np.degrees(pressure_angles(np.zeros(3), np.eye(3), plain).max()), abs=1e-4
    )


@pytest.mark.parametrize("objective", ["pressure_angle", "u95"])
def test_rejected_candidates_are_left_early_and_the_search_finds_the_same(
    monkeypatch: pytest.MonkeyPatch, objective: Literal["pressure_angle", "u95"]
) -> None:
    search = Search(cell(), everywhere().model_copy(update={"objective": objective, "length_mm": None}))
    sample = np.random.default_rng(2).uniform(search.low, search.high, (200, len(search.low)))
    whole = search.worth(sample)
    known = np.random.default_rng(3).permutation(whole)
    limited = search.worth(sample, known)
    # a candidate as good as the known one has its own value, to the rounding of a sum in another order; a worse one has a worse value
    better = whole <= known
    assert 50 < better.sum() < 150
    np.testing.assert_allclose(limited[better], whole[better], rtol=1e-12)
    assert (limited[~better] > known[~better]).all()
    assert (limited[~better] < whole[~better] - 1e-6).any()
    # the limit is the known value itself, not one near it
    np.testing.assert_allclose(search.worth(sample, whole), whole, rtol=1e-12)
    assert (search.worth(sample, whole - 1e-6) > whole - 1e-6).all()
    np.testing.assert_array_equal(search.best_of(sample, 30), sample[np.argsort(whole)[:30]])
    placed = place(cell(), search.wanted, generations=4)
    monkeypatch.setattr(Search, "worth", lambda self, x, known=None, worth=Search.worth: worth(self, x))
    again = place(cell(), search.wanted, generations=4)
    np.testing.assert_allclose(again.rig.cable_rows(), placed.rig.cable_rows(), rtol=0, atol=1e-9)


def test_sensitivity_is_the_change_by_a_millimetre() -> None:
    rig = cell()
    wanted = Placement(task=TASK, mount=(Where(points=("B1",), low_mm=(900, -300, 500), high_mm=(1500, 300, 1100)),))
    placed = place(rig, wanted, generations=5)
    assert place(rig, wanted, generations=5).rig == placed.rig
    moved = placed.rig.observation_point[0].position_mm
    search = Search(rig, wanted)
    x = np.array(moved)
    angles = np.degrees(np.arccos(1 / np.sqrt(search.figures(np.stack([x, x + [0, 1, 0], x - [0, 1, 0]]))[:, 0])))
    changes = angles[1:] - angles[0]
    assert placed.sensitivity["B1"][1] == pytest.approx(changes[np.argmax(np.abs(changes))], abs=1e-6)


def test_attachment_points_and_radius_can_be_asked_for() -> None:
    wanted = Placement(
        objective="u95", task=TASK, attachment=(Where(points=("P1", "P2"), low_mm=(-200, -200, -50), high_mm=(200, 200, 50)),)
    )
    placed = place(cell(), wanted, generations=30)
    assert placed.after["u95_position_mm"] < placed.before["u95_position_mm"]
    assert placed.rig.tool["P3"] == cell().tool["P3"]
    assert placed.rig.tool["P1"] != cell().tool["P1"]
    assert placed.rig.observation_point == cell().observation_point


def test_the_uncertainty_of_a_placed_rig_includes_what_nobody_stated() -> None:
    rig = cell().model_copy(update={"unstated": "typical"})
    wanted = Placement(objective="u95", task=TASK, mount=(Where(points=("B1",), low_mm=(900, -300, 500), high_mm=(1500, 300, 1100)),))
    placed, nodes = place(rig, wanted, generations=3), axis(-300, 300, 300)
    zone = scan_zone(placed.rig, None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.3, 2))
    assert float(zone["u95_position_mm"].max()) == pytest.approx(placed.after["u95_position_mm"], rel=1e-9)
    assert placed.after["u95_position_mm"] > 10.0 * place(cell(), wanted, generations=1).after["u95_position_mm"]
    assert placed.after["u95_position_mm"] < placed.before["u95_position_mm"]
    assert 0.9 < placed.assumed.part_mm / placed.after["u95_position_mm"] < 1.05
    assert "state the " in placed.summary()


def test_what_makes_no_sense_is_refused(tmp_path: Path) -> None:
    rig = cell()
    box = {"low_mm": (0, 0, 0), "high_mm": (1, 1, 1)}
    with pytest.raises(AccuracyError, match="may be moved"):
        place(rig, Placement(task=TASK))
    with pytest.raises(AccuracyError, match="'B9' is no point"):
        place(rig, Placement(task=TASK, mount=(Where(points=("B9",), **box),)))
    with pytest.raises(AccuracyError, match="placed twice"):
        place(rig, Placement(task=TASK, mount=(Where(points=("B1", "B1"), **box),)))
    with pytest.raises(AccuracyError, match="no places were found"):
        place(rig, Placement(task=TASK, length_mm=(1, 2), mount=(Where(points=("B1",), **box),)), generations=3)
    (tmp_path / "bad.toml").write_text('schema = "lmeasure.placement/1"\n[task]\nlow_mm = [0, 0, 0]\nhigh_mm = [1, 1, -1]\n')
    with pytest.raises(FileFormatError, match=r"bad\.toml:\d+: task"):
        read_placement(tmp_path / "bad.toml")


def test_command_writes_a_rig_and_what_it_is_worth(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", cell())
    (tmp_path / "task.toml").write_text(
        'schema = "lmeasure.placement/1"\n[task]\nlow_mm = [-200, -200, -200]\nhigh_mm = [200, 200, 200]\ntilt_rad = 0.1\n'
        '[[mount]]\npoints = ["B1", "B2"]\nlow_mm = [-1500, -1500, 800]\nhigh_mm = [1500, 1500, 1500]\n'
    )
    arguments = ["place", str(tmp_path / "rig.toml"), "--task", str(tmp_path / "task.toml"), "--out", str(tmp_path / "placed")]
    ran(*arguments, "--generations", "20")
    rig = read_rig(tmp_path / "placed" / "rig.toml")
    record = json.loads((tmp_path / "placed" / "placement.json").read_text())
    assert all(800 <= rig.point(name).position_mm[2] <= 1500 for name in ("B1", "B2"))
    assert record["after"]["worst_pressure_angle_deg"] < record["before"]["worst_pressure_angle_deg"]
    assert set(record["sensitivity_deg_per_mm"]) == {"B1", "B2"}
