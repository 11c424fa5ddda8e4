"""A session of a capture, fed sample by sample: what it reads, refuses, takes back, and what it leaves."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture_bench import POSES, QUICK, RATE_HZ, RIG, Bench, going, joined, motion, nominal_of, some_poses, write_inputs

from lmeasure.acquisition import Event, Samples, counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.recorder import candump_lines
from lmeasure.calibration import calibrate, mean_variance, pooled_scatter, read_campaign
from lmeasure.cli.app import main
from lmeasure.io.tables import read_table
from lmeasure.procedures import Session, open_folder, state_of
from lmeasure.procedures.capture.folder import MOST_ROWS
from lmeasure.rig import rig_from_dict, write_rig
from lmeasure.sensors import span_lengths


def test_a_robot_that_goes_through_the_poses_leaves_a_folder_that_calibrates(tmp_path: Path) -> None:
    bench = Bench(tmp_path, u_position_mm=np.zeros(8), u_rotation_deg=np.zeros(8))
    bench.show(going(np.vstack([POSES, POSES[:1]]), 0.25), piece=50)
    assert bench.read == [*"12345678", "1"]
    assert bench.session.finished
    assert bench.session.closure is not None
    assert bench.session.closure.beyond == ()
    assert bench.heard("closed: at most 1.2 counts, which is within rounding")
    assert all(len(line) <= 110 for line in bench.said)
    campaign = read_campaign(tmp_path / "cal")
    assert campaign.poses.names[-1] == "1 (visit 2)"
    found = calibrate(campaign)
    # lengths at other poses, as the truth has them
    other = some_poses(50, seed=7)
    error = span_lengths(found.rig, other) - span_lengths(RIG, other)
    error -= error[0]
    worth = bench.session.worth
    assert worth is not None
    assert worth.enough(8)
    assert np.abs(error).max() < 3.0 * worth.worst_mm < 3.0
    # what was said of all poses in advance is what they turned out to bring, the visit aside
    assert bench.heard("predicted for all 8 poses:")
    assert bench.said[1].startswith("  U95: lengths ")


def test_a_rest_whose_first_counts_are_missing_is_read_once_they_come(tmp_path: Path) -> None:
    """A busy machine loses frames. The robot stays where it is, and nobody presses a key: the rest is read when its last dwell is whole."""
    bench = Bench(tmp_path)
    bench.show(bench.at(0))
    bench.show(going(POSES[[0, 1]], 0.0))
    rest = bench.at(1, 0.6)
    rest.recorded[[i for i in range(40) if i % 5], 0] = np.nan
    bench.show(Samples(rest.time_s[:40], rest.recorded[:40]))
    assert bench.read == ["1"]
    assert sum("of the dwell has no counts" in line for line in bench.said) == 1
    bench.show(Samples(rest.time_s[40:], rest.recorded[40:]))
    assert bench.read == ["1", "2"]


def test_each_reading_says_what_it_was_worth(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(going(POSES, 0.25))
    assert bench.heard("2 of at least 6 poses: too few for the counts to determine any parameter")
    reported = [float(line.split("lengths ")[1].split()[0]) for line in bench.said if line.startswith("  U95 by now")]
    assert len(reported) == 3
    assert reported == sorted(reported, reverse=True)


def test_the_mean_of_a_dwell_is_that_of_its_counts_and_as_uncertain_as_they_make_it(tmp_path: Path) -> None:
    """A trembling channel is averaged; one that stands on a count is known no better than one reading."""
    bench = Bench(tmp_path, replace(QUICK, dwell_s=2.0))
    rng = np.random.default_rng(4)
    for pose in (0, 1):
        still = bench.at(pose, 2.3)
        noise = np.column_stack([np.rint(rng.normal(0.3, 0.8, len(still.time_s))), np.zeros(len(still.time_s))])
        bench.show(joined([going(POSES[[0, pose]], 0.0), Samples(still.time_s, still.recorded + noise)]))
    assert bench.read == ["1", "2"]
    reading = bench.out.readings[1]
    assert len(reading.counts) == MOST_ROWS
    assert np.ptp(reading.time_s) == pytest.approx(2.0, abs=0.02)
    assert reading.spread[0] > 2
    scatter = pooled_scatter([r.counts[:, 0] for r in bench.out.readings])
    campaign = read_campaign(tmp_path / "cal")
    assert campaign.dwell_variance is not None
    np.testing.assert_allclose(campaign.dwell_variance[1], [mean_variance(scatter, MOST_ROWS), 1 / 12])
    assert np.sqrt(campaign.dwell_variance[1, 0]) < 0.15
    np.testing.assert_allclose(campaign.counts[1], reading.counts.mean(axis=0))
    assert bench.heard(f"ch2 {reading.mean[1]:.2f} (u 0.29)")


def test_keys_read_where_the_robot_stands_and_are_refused_where_it_moves(tmp_path: Path) -> None:
    bench = Bench(tmp_path, replace(QUICK, by="key"))
    bench.show(bench.at(0))
    assert bench.read == []
    bench.session.command("")
    bench.show(bench.at(0, 0.02))
    assert bench.read == ["1"]
    way = going(POSES[:2], 0.0)
    half = len(way.time_s) // 2
    bench.show(Samples(way.time_s[:half], way.recorded[:half]))
    bench.session.command("take")
    assert bench.said[-1].startswith("not recorded: the robot moves (ch")
    bench.show(Samples(way.time_s[half:], way.recorded[half:]))
    bench.show(bench.at(1, 0.12))
    bench.session.command("take")
    bench.show(going(POSES[[1, 2]], 0.0))
    assert bench.said[-1] == "not recorded: the robot moved during the dwell"
    assert bench.read == ["1"]


def test_the_last_readings_are_taken_back_one_by_one(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(going(POSES[:3], 0.25))
    for left, pose in (("12", "3"), ("1", "2"), ("", "1")):
        bench.session.command("undo")
        assert bench.session.goal == pose
        assert bench.read == list(left)
        assert (tmp_path / "cal" / "counts.csv").exists() is bool(left)
    bench.session.command("undo")
    assert bench.said[-1] == "no reading to delete"
    bench.show(going(POSES[:2], 0.25))
    assert bench.read == ["1", "2"]


def test_what_was_taken_back_is_not_read_at_once_by_the_rest_that_read_it(tmp_path: Path) -> None:
    """Where a person can say so: Enter reads it anew, and so does another rest."""
    bench = Bench(tmp_path, replace(QUICK, by="both"))
    bench.show(bench.at(0, 0.2))
    bench.session.command("")
    bench.show(bench.at(0, 0.2))
    bench.show(going(POSES[:2], 0.25))
    assert bench.read == ["1", "2"]
    bench.session.command("undo")
    bench.show(bench.at(1, 0.5))
    assert (bench.read, bench.session.goal) == (["1"], "2")
    bench.session.command("")
    bench.show(bench.at(1, 0.2))
    assert bench.read == ["1", "2"]
    bench.session.command("undo")
    bench.show(going(POSES[[1, 0, 1]], 0.25))
    assert bench.read == ["1", "2"]


def test_a_channel_that_lost_its_origin_is_not_called_silent(tmp_path: Path) -> None:
    """Its frames come, its counts are empty from there on: no plug is to be looked at, and going back to a pose shows nothing."""
    bench = Bench(tmp_path)
    bench.show(going(POSES[:2], 0.25))
    lost = bench.at(2, 2.0)
    lost.recorded[:, 1] = np.nan
    bench.events = [Event(0, 1.0, RIG.channels[1], "reset", "from 900 to 0")]
    bench.show(lost)
    reported = f"{RIG.channels[1]}: origin lost. Quit here, and record the other poses in a new folder"
    assert bench.said[-1] == f"not recorded: {reported}"
    assert (state_of(bench.session)["state"], state_of(bench.session)["doubted"]) == ("lost", reported)
    assert bench.session.line().startswith(f"pose 3  no origin: {RIG.channels[1]}")
    bench.events = []
    fresh = Bench(tmp_path / "other")
    silent = fresh.at(0, 2.0)
    silent.recorded[:, 1] = np.nan
    fresh.show(silent)
    assert state_of(fresh.session)["state"] == "silent"
    assert "Check the encoder, its plug and its cable" in state_of(fresh.session)["doubted"]


def test_a_bus_from_which_nothing_comes_is_not_a_robot_that_stands(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(bench.at(0))
    assert state_of(bench.session)["state"] == "still"
    bench.session.look([], idle_s=3.0)
    state = state_of(bench.session)
    assert (state["state"], state["doubted"]) == ("silent", "the bus sends no counts")
    assert all(channel["silent"] for channel in state["channels"])


def test_a_return_that_was_taken_back_is_read_again(tmp_path: Path) -> None:
    bench = Bench(tmp_path, replace(QUICK, dwell_s=0.1))
    bench.show(going(np.vstack([POSES, POSES[:1]]), 0.25))
    assert bench.session.finished
    bench.session.command("undo")
    assert not bench.session.finished
    assert bench.session.closure is None
    assert bench.session.goal == "1"
    bench.show(bench.at(0))
    assert bench.session.finished


def test_poses_are_left_out_and_taken_in_another_order(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.session.command("skip")
    bench.session.command("go 4")
    bench.show(bench.at(3))
    assert (bench.read, bench.session.goal) == (["4"], "2")
    bench.session.command("go nowhere")
    assert bench.said[-1] == "no pose 'nowhere'. The poses are 1, 2, 3, 4, 5, 6, 7, 8"
    bench.session.command("dance")
    assert bench.said[-1].startswith("'dance' is not a command. Enter (or take): record")


def test_a_rest_elsewhere_is_no_reading(tmp_path: Path) -> None:
    """A robot's program may wait on its way; once some poses are read, a place that is not the pose is told."""
    bench = Bench(tmp_path)
    bench.show(going(POSES[:7], 0.25))
    assert bench.read == list("1234567")
    beside = POSES[7].copy()
    beside[:3] += 6.0
    bench.show(going(np.array([POSES[6], beside]), 0.4))
    assert bench.read == list("1234567")
    assert bench.heard("the robot stopped, but not at pose 8: differs from the prediction: c")
    bench.show(going(np.array([beside, POSES[7]]), 0.4))
    assert bench.read == list("12345678")


def test_a_reading_by_key_at_another_pose_is_doubted(tmp_path: Path) -> None:
    bench = Bench(tmp_path, replace(QUICK, by="both"))
    bench.session.command("")
    bench.show(bench.at(0))
    assert bench.read == []  # it was moving when the key came: nothing had been seen of it
    bench.session.command("")
    bench.show(going(POSES[:5], 0.25))
    assert bench.read == list("12345")
    bench.show(going(POSES[[4, 7]], 0.4))
    bench.session.command("")
    bench.show(bench.at(7))
    assert bench.read == list("123456")
    assert bench.heard("  ! differs from the prediction: c")


def test_a_silent_channel_is_named_and_nothing_is_read(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(going(POSES[:2], 0.25))
    still = bench.at(2, 1.0)
    still.recorded[:, 1] = np.nan
    bench.show(joined([going(POSES[[1, 2]], 0.0), still]))
    assert bench.read == ["1", "2"]
    assert bench.said[-2] == "not recorded: ch2 (100%) of the dwell has no counts"
    assert bench.said[-1].startswith("not recorded: ch2: no counts. Check the encoder, its plug and its cable")
    bench.session.command("")
    assert bench.said[-1].startswith("not recorded: ch2: no counts. Check the encoder, its plug and its cable")
    assert bench.session.line().startswith("pose 3  silent: ch2")
    gaps = bench.at(2, 1.0)
    gaps.recorded[::3, 0] = np.nan
    gaps.recorded[1::3, 0] = np.nan
    bench.show(joined([going(POSES[[2, 1, 2]], 0.0), gaps]))
    assert bench.read == ["1", "2"]
    assert bench.said[-1].startswith("not recorded: ch1 (6")
    assert not bench.said[-2].startswith("not recorded: ch1 (6")  # once of a rest
    bench.session.look([], idle_s=2.0)
    bench.session.command("")
    assert bench.said[-1] == "not recorded: the bus sends no counts"


def test_a_bus_from_which_nothing_comes_is_told_once_though_nobody_asks(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for idle_s in (0.2, 3.0, 4.0):
        bench.session.look([], idle_s=idle_s)
    assert (
        sum(
            line.startswith("the bus sends no counts. Check that it is connected and on. `lmeasure check` shows the frames that arrive")
            for line in bench.said
        )
        == 1
    )
    assert bench.session.line().startswith("pose 1  no counts  ")
    bench.show(going(POSES[:1], 0.25))
    bench.session.look([], idle_s=3.0)
    assert (
        sum(
            line.startswith("the bus sends no counts. Check that it is connected and on. `lmeasure check` shows the frames that arrive")
            for line in bench.said
        )
        == 2
    )


def test_a_dwell_of_which_most_was_not_seen_is_no_reading(tmp_path: Path) -> None:
    """A machine that is busy, or a bus that pauses: where the robot was meanwhile nobody knows."""
    bench = Bench(tmp_path)
    bench.show(going(POSES[:2], 0.25))
    assert bench.read == ["1", "2"]
    still = bench.at(2, 1.0)
    seen = np.r_[0:3, 120:123]  # 15 ms at the beginning, and as much more than half a second later
    bench.show(going(POSES[[1, 2]], 0.0))
    bench.show(Samples(still.time_s[seen], still.recorded[seen]), piece=1)
    assert bench.read == ["1", "2"]
    bench.show(bench.at(2, 0.2))
    assert bench.read == ["1", "2", "3"]


@pytest.mark.parametrize("reported", ["leap", "event"])
def test_a_channel_that_leaps_is_believed_again_where_it_was_read(reported: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.show(going(POSES[:3], 0.25))
    bench.show(going(POSES[[2, 3]], 0.0))
    here = bench.at(3)
    if reported == "leap":
        here.recorded[10:, 0] += 500.0
    else:
        bench.events = [Event(3, 0.1, "ch1", "jump", "many units")]
    bench.show(here)
    assert bench.read == list("123")
    assert bench.heard(
        "channel ch1 jumped by +500 counts" if reported == "leap" else "channel ch1 moved faster than its drum can turn (many units)"
    )
    lost = np.array([500.0, 0.0]) if reported == "leap" else np.zeros(2)
    bench.show(bench.at(1, off=lost))
    if reported == "leap":
        # two channels: half of them agree with a pose, which is not enough to know it
        assert bench.said[-1].endswith("This is not a recorded pose")
        bench.session.command("trust")
        assert bench.out.notes == ["trusted before reading 4: ch1 jumped by +500 counts while no other channel moved"]
    else:
        assert bench.heard("the counters agree with pose 2: no counts were lost")
        bench.show(going(POSES[[1, 3]], 0.3))
        assert bench.read == list("1234")


def test_absolute_encoders_begin_anew_after_a_turn(tmp_path: Path) -> None:
    """An encoder of 4096 codes on a swivel, which stands at its last code: read, written as it shows, and seen again."""
    data = nominal_of(RIG).to_dict()
    data["swivel"] = [{"point": data["observation_point"][0]["name"], "channel": "sw1", "counts_per_revolution": 4096}]
    rig = rig_from_dict(data)
    write_rig(tmp_path / "rig.toml", rig)
    write_inputs(tmp_path / "poses", rig, POSES)
    (tmp_path / "poses" / "planned.csv").rename(tmp_path / "planned.csv")
    channels = tuple(rig.counters_of(1))
    assert channels == ("ch1", "ch2", "sw1")
    rng = np.random.default_rng(0)
    for turn in range(2):
        folder = open_folder(tmp_path / "cal", rig, channels, 1, planned=tmp_path / "planned.csv", beside={})
        said: list[str] = []
        session = Session(folder, QUICK, said.append)
        for k, codes in enumerate(([4095, 0], [1000, 1000], [4094, 1])[turn:]):
            drums = motion(RIG, POSES[[0, k + turn]], 0.0).recorded[-1]
            n = 60
            shown = np.column_stack([np.tile(drums, (n, 1)), rng.choice(codes, n)])
            session.feed(Samples(np.arange(n) / RATE_HZ + k, shown))
            session.look([])
        assert [r.pose for r in folder.readings] == ["1", "2", "3"]
        table = read_table(tmp_path / "cal" / "counts.csv")
        assert set(table.numbers("sw1")) <= {4095, 0, 1000, 4094, 1}
        assert folder.readings[0].spread[2] == 1.0
    assert any("the counters agree with pose 2" in line for line in said)
    session.command("return")
    n = 60
    still = np.column_stack([np.tile(motion(RIG, POSES[[0, 0]], 0.0).recorded[-1], (n, 1)), rng.choice([4095, 0], n)])
    session.feed(Samples(np.arange(n) / RATE_HZ + 9.0, still))
    session.look([])
    assert session.closure is not None
    assert session.closure.beyond == ()


def test_how_well_poses_are_known_is_written_beside_what_they_are(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    planned = read_table(tmp_path / "planned.csv")
    bench.out.state_uncertainty({"u_position_mm": 0.05, "u_rotation_deg": 0.01})
    table = read_table(tmp_path / "cal" / "reference_poses.csv")
    assert set(table.numbers("u_position_mm")) == {0.05}
    for name in planned.columns[1:]:
        np.testing.assert_array_equal(table.numbers(name), planned.numbers(name))
    assert bench.out.poses.absent == ()
    bench.out.state_uncertainty({"u_position_mm": 0.1})
    assert set(read_table(tmp_path / "cal" / "reference_poses.csv").numbers("u_position_mm")) == {0.1}


@pytest.mark.parametrize(
    ("way", "lost", "reported"),
    [
        ([0, 1, 2, 0], 0, ""),
        ([0, 1, 2, 0], 40, "cal: the counts of ch2 differ at the return to the first pose"),
        ([0, 1], 0, "cal: stopped before pose 3. Run the same command to continue"),
    ],
)
def test_the_command_ends_with_1_where_poses_or_counts_are_missing(
    way: list[int], lost: int, reported: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a log that is played to it; what was read is there in any case."""
    write_inputs(tmp_path, nominal_of(RIG), POSES[:3])
    driven = going(POSES[way], 0.4)
    # lost one after the other on the last way, as by a cable that slips: no leap tells of it
    last = len(driven.recorded) - int(0.5 * RATE_HZ)
    driven.recorded[:, 1] += np.rint(np.interp(np.arange(len(driven.recorded)), [last - 20, last], [0, lost]))
    fields = counter_fields(RIG)
    frames = frames_from_counts(np.arange(len(driven.recorded)) / RATE_HZ, driven.recorded, fields, RIG.can_table.sync_id)
    (tmp_path / "drive.log").write_bytes(candump_lines(frames))
    monkeypatch.chdir(tmp_path)
    words = ["capture", "rig.toml", "--poses", "planned.csv", "--bus", "replay:drive.log", "--fast", "--out", "cal", "--by", "rest"]
    monkeypatch.setattr("sys.argv", ["lmeasure", *words, "--dwell-s", "0.2", "--settle-s", "0.1"])
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(SystemExit) as end:
        main()
    out, err = capsys.readouterr()
    assert end.value.code == (1 if reported else 0), out
    assert [line for line in err.splitlines() if line.startswith("lmeasure: ")] == ([f"lmeasure: {reported}"] if reported else [])
    assert f"{len(set(way))} of 3 poses recorded, {len(way)} readings: cal" in out
    assert len(dict.fromkeys(read_table(tmp_path / "cal" / "counts.csv").text("pose"))) == len(set(way))
