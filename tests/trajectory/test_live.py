"""Sample by sample a run gives the poses that it gives at once."""

from dataclasses import replace

import numpy as np
import pytest
from cells import START, cell, motion, record
from test_truth import AUTHORITY, truth_of

from lmeasure.core import WORDS, TrajectoryError
from lmeasure.recording import Run, read_run
from lmeasure.rig import rig_from_dict
from lmeasure.trajectory import LivePose, align, prepare, reconstruct
from lmeasure.trajectory.reconstruction.live import START_UNKNOWN, AnyChannels, LiveSample


def first_of(run: Run, n: int) -> Run:
    """The first n samples of a run of one pass."""
    counts = run.passes[0]
    return replace(run, passes=(replace(counts, time_s=counts.time_s[:n], recorded=counts.recorded[:n].copy()),))


def followed(live: LivePose, run: Run) -> list[LiveSample]:
    counts = run.passes[0]
    return [live.update(t, recorded) for t, recorded in zip(counts.time_s, counts.recorded, strict=True)]


def test_live_is_the_same_run() -> None:
    rig = cell(16)
    run = record(rig, *motion(1500, reach_mm=520.0, tilt_rad=0.1))
    first = run.passes[0]
    first.recorded[300:310, 2] = np.nan
    first.recorded[700:720, 4] += 8000.0
    at_once = reconstruct(run)
    pose = LivePose(rig, START, unstated="exact")
    assert pose.channels == first.channels
    for i, (t, recorded) in enumerate(zip(first.time_s, first.recorded, strict=True)):
        found = pose.update(t, recorded)
        # who does not know yet that it comes back takes its origin for lost
        assert found.status == ("origin_lost" if 700 < i < 720 else WORDS[at_once.status[i]])
        # a short run may be solved without compiled code, to other last digits
        np.testing.assert_allclose(found.pose, at_once.poses[i], rtol=0, atol=1e-11)
        np.testing.assert_allclose(found.worst_pressure_angle_deg, at_once.worst_pressure_angle_deg[i])


def test_a_rig_that_has_no_pose_yet_is_refused() -> None:
    data = cell().to_dict()
    for i, c in enumerate(data["cable"]):
        c["channel"], c["pass"] = f"ch{i % 3 + 1}", i // 3 + 1
    with pytest.raises(TrajectoryError, match="in one pass"):
        LivePose(cell(cable=data["cable"]), START, unstated="exact")


def test_drums_and_swivels_live_are_the_same_run() -> None:
    run = first_of(read_run(AUTHORITY / "swivel-three"), 400)
    run.passes[0].recorded[200:203, 4] = np.nan
    found = followed(LivePose(run.rig, run.start, unstated="exact"), run)
    at_once = reconstruct(run)
    assert [s.status for s in found] == [WORDS[s] for s in at_once.status]
    np.testing.assert_allclose(np.array([s.pose for s in found]), at_once.poses, rtol=0, atol=1e-9)
    np.testing.assert_allclose([s.worst_pressure_angle_deg for s in found], at_once.worst_pressure_angle_deg, atol=1e-9)


def test_from_power_on_live_is_what_the_run_so_far_tells() -> None:
    """Nobody stated a start, and encoders miss samples: where the run is learned the pose is that of `reconstruct`; and what the whole run
    told is followed sample by sample as at once."""
    run = first_of(read_run(AUTHORITY / "swivel-run"), 100)
    for first, last, channel in ((60, 75, 7), (70, 95, 10), (85, 95, 2)):
        run.passes[0].recorded[first:last, channel] = np.nan
    found = followed(LivePose(run.rig, None, unstated="exact"), run)
    assert {s.status for s in found[:49]} == {START_UNKNOWN}
    assert {s.status for s in found[49:]} == {"ok"}
    for n in (50, 100):
        at_once = reconstruct(first_of(run, n))
        assert (at_once.status == 0).all()
        np.testing.assert_allclose(found[n - 1].pose, at_once.poses[-1], rtol=0, atol=1e-9)
    determined = AnyChannels(prepare(align(run)))
    counts = run.passes[0]
    way = [determined.step(t, recorded)[1] for t, recorded in zip(counts.time_s, counts.recorded, strict=True)]
    np.testing.assert_allclose(np.array(way), at_once.poses, rtol=0, atol=1e-9)


def test_a_cable_that_contradicts_the_others_is_no_pose_until_it_is_left_out() -> None:
    run = first_of(read_run(AUTHORITY / "eight-run"), 400)
    sound = reconstruct(run).poses
    run.passes[0].recorded[150:, 2] -= np.minimum(10.0 * np.arange(250), 300.0)
    found = followed(LivePose(run.rig, run.start, unstated="exact"), run)
    statuses = [s.status for s in found]
    assert set(statuses[:150]) == {"ok"}
    assert "inconsistent" in statuses[150:160]
    assert set(statuses[-150:]) == {"ok"}
    away = [np.abs(s.pose[:3] - at[:3]).max() for s, at in zip(found, sound, strict=True) if s.status == "ok"]
    assert max(away) < 0.1


def test_what_live_does_not_do_is_said() -> None:
    swivels = read_run(AUTHORITY / "swivel-run").rig.to_dict()["swivel"]
    run = read_run(AUTHORITY / "eight-run")
    with pytest.raises(TrajectoryError, match="its channels are not absolute"):
        LivePose(run.rig, None, unstated="exact")
    with pytest.raises(TrajectoryError, match="does not include the play of swivels"):
        LivePose(cell(swivel=[swivels[0] | {"point": "B1", "backlash_deg": 0.1}]), START, unstated="exact")


@pytest.mark.slow
def test_two_absolute_angles_tell_a_live_start_once_the_tool_has_moved() -> None:
    whole = read_run(AUTHORITY / "swivel-run")
    data, counts = whole.rig.to_dict(), whole.passes[0]
    data["swivel"] = [data["swivel"][i] for i in (1, 3)]
    live = LivePose(rig_from_dict(data), None, unstated="exact")
    columns = [counts.channels.index(name) for name in live.channels]
    fewer = replace(counts, time_s=counts.time_s[::16], channels=live.channels, recorded=counts.recorded[::16, columns].copy(order="C"))
    run = replace(whole, rig=rig_from_dict(data), passes=(fewer,))
    found = followed(live, run)
    assert found[0].status == START_UNKNOWN
    assert [sample.status for sample in found[100:]] == ["ok"] * 25
    assert np.linalg.norm(found[-1].pose[:3] - truth_of("swivel-run")[::16][-1, 1:4]) < 0.1
