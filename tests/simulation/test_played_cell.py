"""A simulated cell that is played with: what is pulled, let back, driven to and run is what its counters show."""

from pathlib import Path

import numpy as np
import pytest

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.demo import Built, PlayedCell
from lmeasure.demo.interactive_cell import built_rig
from lmeasure.iso9283 import Tests, campaign, largest_cube, read_commands, write_campaign
from lmeasure.recording import poses_from_rows
from lmeasure.sensors import counts_from_poses
from lmeasure.simulation import cell_rig, scattered_poses

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
RIG = cell_rig(0)


def played(**more: object) -> PlayedCell:
    return PlayedCell(RIG, HOME, 50.0, **more)  # type: ignore[arg-type]


def done(cell: PlayedCell, text: str) -> np.ndarray:
    """Counts when it has been done."""
    cell.do(text)
    while cell.moves:
        cell.take(10)
    return np.asarray(cell.take(1)[0])


def test_a_hand_moves_one_cable_and_lets_it_back() -> None:
    cell = played()
    pulled = done(cell, "pull c2")
    assert pulled[1] == pytest.approx(100.0 / 0.012, abs=1)
    assert not pulled[[0, 2, 3, 4, 5]].any()
    assert cell.out == ["c2"]
    assert not done(cell, "let c2").any()
    assert cell.out == []
    assert done(cell, "turn B3")[2] == 6000
    for wrong in ("pull c9", "pull c1 much", "dance", "go 3", "home now"):
        with pytest.raises(LMeasureError):
            cell.do(wrong)
    assert not cell.moves


def test_a_drum_that_was_turned_is_wound_back_before_the_robot_goes_anywhere() -> None:
    """Its spring takes the loose cable up, or all that is counted afterwards would be a turn off."""
    cell = played(poses=poses_from_rows(np.array([HOME, [50.0, 0, 0, 0, 0, 0, 1.0]])))
    there = done(cell, "go 2")
    done(cell, "home")
    assert done(cell, "turn c1")[0] == 6000
    assert np.array_equal(done(cell, "go 2"), there)
    done(cell, "turn c1")
    assert np.array_equal(done(cell, "let c1"), there)
    done(cell, "turn c3")
    assert not done(cell, "home").any()


def test_a_cable_that_was_pulled_comes_back_to_where_it_was_pulled_from() -> None:
    """A self-test that is done again finds its drums a turn on, and each cable that it has pulled where it was before."""
    cell = played()
    turned = done(cell, "turn c1")
    done(cell, "pull c1")
    assert np.array_equal(done(cell, "let c1"), turned)
    assert not done(cell, "let c1").any()


def test_exchanged_encoders_count_the_other_cable() -> None:
    cell = played(how=Built(exchanged=("ch1", "ch4")))
    assert np.flatnonzero(done(cell, "pull c1")).tolist() == [3]
    with pytest.raises(LMeasureError, match="two of the channels"):
        played(how=Built(exchanged=("ch1",)))


def test_the_robot_stands_where_it_is_sent_in_the_cell_as_it_was_built() -> None:
    rows = scattered_poses(3, (150.0,) * 3, 0.1, HOME, rng=np.random.default_rng(3))
    how = Built(off_mm=5.0, off_deg=1.0)
    cell = played(how=how, poses=poses_from_rows(rows), seed=4)
    built = built_rig(RIG, how, np.random.default_rng(4))
    assert done(cell, "go 2") == pytest.approx(counts_from_poses(built, rows[1:2], HOME)[0], abs=1.0)
    assert done(cell, "go 2") == pytest.approx(counts_from_poses(built, rows[1:2], HOME)[0], abs=1.0)  # it stays
    assert np.abs(counts_from_poses(built, rows[1:2], HOME) - counts_from_poses(RIG, rows[1:2], HOME)).max() > 5.0
    assert not done(cell, "home").any()


def test_a_list_of_commands_is_read_as_it_was_meant(tmp_path: Path) -> None:
    """Circles, which the list has as two arcs and more, among them; and the cell runs it and comes home."""
    plan = campaign(
        largest_cube((-100.0,) * 3, (100.0,) * 3), Tests(tests=("pose", "path"), cycles={"pose": 2, "path": 2}, dwell_s=0.2, settle_s=0.1)
    )
    write_campaign(tmp_path, plan)
    listed = read_commands(tmp_path / "commands.csv")
    assert [(c.target, c.role, c.cycle, c.speed_mm_s, c.dwell_s, c.load_kg) for c in listed] == [
        (c.target, c.role if c.target else "pose", c.cycle, c.speed_mm_s, c.dwell_s, c.load_kg) for c in plan.commands
    ]
    for mine, meant in zip(listed, plan.commands, strict=True):
        np.testing.assert_allclose(mine.poses, meant.poses, atol=1e-6)
    assert max(len(c.poses) for c in listed) > 700
    cell = played(commands=tmp_path / "commands.csv")
    cell.do("run")
    rows = cell.take(100_000)
    assert not cell.moves
    assert not rows[-1].any()
    assert np.abs(rows).max() > 5000
    text = (tmp_path / "commands.csv").read_text()
    (tmp_path / "commands.csv").write_text(text.replace('"via"', '"hop"'))
    with pytest.raises(FileFormatError, match="'hop'"):
        read_commands(tmp_path / "commands.csv")
