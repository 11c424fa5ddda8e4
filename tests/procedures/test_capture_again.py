"""A capture that is begun again, and one that comes back: counters are believed once they are seen to have kept their counts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture_bench import POSES, RATE_HZ, RIG, Bench, going, joined, motion, nominal_of, some_poses, true_rig, write_inputs

from lmeasure.acquisition import Samples
from lmeasure.core import AcquisitionError, FileFormatError, OverwriteError
from lmeasure.procedures import open_folder
from lmeasure.rig import read_rig, rig_from_dict


def test_a_session_begun_again_goes_on_once_the_counters_are_seen_to_have_kept_their_counts(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(going(POSES[:3], 0.25))
    before = (tmp_path / "cal" / "counts.csv").read_bytes()
    again = Bench(tmp_path)
    assert again.read == list("123")
    assert again.session.goal == "4"
    again.show(again.at(3))
    assert again.said[-1].endswith("This is not a recorded pose")
    assert (tmp_path / "cal" / "counts.csv").read_bytes() == before
    again.show(going(POSES[[3, 1]], 0.25))
    assert again.heard("the counters agree with pose 2")
    again.show(going(np.vstack([POSES[[1]], POSES[3:], POSES[:1]]), 0.25))
    assert again.session.finished
    assert again.read == [*"12345678", "1"]
    # whole lines from before, and what came since behind them
    assert (tmp_path / "cal" / "counts.csv").read_bytes().startswith(before)
    third = Bench(tmp_path)
    assert third.session.finished
    assert third.said[-1] == "all poses are recorded. Run `lmeasure calibrate` on the folder"


def test_counters_zeroed_over_the_coffee_are_not_believed(tmp_path: Path) -> None:
    rig = rig_from_dict(true_rig(4).to_dict())
    write_inputs(tmp_path, rig, POSES)
    bench = Bench(tmp_path)
    bench.show(motion(rig, POSES[:3], 0.25))
    assert bench.read == list("123")
    again = Bench(tmp_path)
    here = motion(rig, POSES[[0, 2]], 0.3).recorded[-1]
    still = Samples(np.arange(100) / RATE_HZ, np.tile(here - [0.0, 0.0, 777.0, 0.0], (100, 1)))
    again.show(still)
    assert again.said[-1] == (
        "not recorded: the other channels agree with pose 3, but these do not: ch3 by -777 counts. Counts were lost. "
        "Start in a new folder, or type `trust`"
    )


@pytest.mark.parametrize(
    ("off", "u_repeatability_mm", "lost", "reported"),
    [
        ((0.0, 0.0), 0.0, (), "closed: at most 1.2 counts, which is within rounding"),
        ((2.0, 0.0), 0.0, (), "difference larger than rounding (ch1), but within 0.024 mm"),
        ((2.0, 0.0), 0.02, (), "closed: at most 7.2 counts, which is within rounding"),
        ((0.0, 40.0), 0.02, ("ch2",), "! ch2 differs by +40 counts (+0.480 mm) after its return: lost counts, or a slipped cable"),
    ],
)
def test_the_return_is_judged(
    off: tuple[float, float], u_repeatability_mm: float, lost: tuple[str, ...], reported: str, tmp_path: Path
) -> None:
    more: dict[str, Any] = {"u_repeatability_mm": np.full(8, u_repeatability_mm)} if u_repeatability_mm else {}
    bench = Bench(tmp_path, **more)
    bench.show(going(POSES[:3], 0.25))
    bench.session.command("return")
    bench.show(joined([going(POSES[[2, 0]], 0.0), bench.at(0, 0.4, off=np.array(off))]))
    assert bench.session.closure is not None
    assert bench.session.closure.lost == lost
    assert bench.heard(reported)


def test_a_folder_of_something_else_and_another_rig_are_refused(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    rig = read_rig(tmp_path / "rig.toml")
    with pytest.raises(AcquisitionError, match=r"rig\.toml: is another rig than the one given"):
        open_folder(tmp_path / "cal", nominal_of(RIG, seed=5), rig.channels, 1, planned=tmp_path / "planned.csv", beside={})
    with pytest.raises(OverwriteError, match=r"is no folder of a capture. Nothing was overwritten"):
        open_folder(tmp_path, rig, rig.channels, 1, planned=tmp_path / "planned.csv", beside={})
    moved = POSES.copy()
    moved[2, 0] += 1.0
    write_inputs(tmp_path / "other", rig, moved)
    with pytest.raises(FileFormatError, match="pose '3' is another than in"):
        open_folder(tmp_path / "cal", rig, rig.channels, 1, planned=tmp_path / "other" / "planned.csv", beside={})
    assert bench.read == []


def test_poses_planned_later_are_joined_to_the_folder(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(going(POSES[:2], 0.25))
    write_inputs(tmp_path, read_rig(tmp_path / "rig.toml"), np.vstack([POSES, some_poses(3, seed=9)]))
    longer = Bench(tmp_path)
    assert longer.out.poses.names == tuple(str(i + 1) for i in range(11))
    assert longer.read == ["1", "2"]
