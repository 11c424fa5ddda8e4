"""A cable that loses the tool for a while: those samples are marked, with the cable, and nothing else is."""

from typing import Any

import numpy as np
import pytest
from cells import FloatArray, cell, motion, position_error, record, with_recorded

from lmeasure.core import Status
from lmeasure.rig import Rig
from lmeasure.sensors.rejected_samples import slack_samples
from lmeasure.trajectory import reconstruct

LIMIT = 30000.0


def limited(limit: float | None = LIMIT) -> Rig:
    points: list[dict[str, Any]] = cell().to_dict()["observation_point"]
    for point in points:
        if limit is not None:
            point["drum"]["max_cable_acceleration_mm_s2"] = limit
    return cell(observation_point=points)


def slackened(recorded: FloatArray, cable: int, begin: int, end: int) -> FloatArray:
    """The drum stands from one sample on while the tool comes nearer, until the cable snaps taut."""
    out = recorded.copy()
    out[begin:end, cable] = out[begin, cable]
    return out


def fastest(recorded: FloatArray) -> int:
    """A sample in the middle of the run at which the cable moves fast."""
    return 500 + int(np.argmax(np.abs(np.gradient(recorded))[500:2500]))


def test_a_slack_cable_is_marked_and_the_rest_of_the_run_is_right() -> None:
    rig = limited()
    times, poses = motion(3000)
    run = record(rig, times, poses)
    begin = fastest(run.passes[0].recorded[:, 2])
    found = reconstruct(with_recorded(run, slackened(run.passes[0].recorded, 2, begin, begin + 30)))
    marked = np.flatnonzero(found.status == Status.SLACK)
    assert begin - 3 <= marked[0] <= begin
    assert begin + 29 <= marked[-1] <= begin + 33
    assert (np.diff(marked) == 1).all()
    assert set(found.cable[marked]) == {"c3"}
    assert "channel ch3 does not follow: its speed changed faster than max_cable_acceleration_mm_s2 = 30000" in str(found.cause[marked[0]])
    ok = found.status == Status.OK
    assert ok.sum() == 3000 - len(marked)
    assert position_error(found.poses[ok], poses[ok]).max() < 0.05


def test_without_a_limit_the_motion_itself_is_the_limit() -> None:
    rig = limited(None)
    times, poses = motion(3000)
    run = record(rig, times, poses)
    begin = fastest(run.passes[0].recorded[:, 2])
    found = reconstruct(with_recorded(run, slackened(run.passes[0].recorded, 2, begin, begin + 30)))
    wrong = np.arange(begin + 2, begin + 30)
    assert (found.status[wrong] != Status.OK).all()
    assert set(found.cable[wrong]) == {"c3"}
    ok = found.status == Status.OK
    assert ok.sum() > 2950
    assert position_error(found.poses[ok], poses[ok]).max() < 0.05


def test_a_lively_motion_within_the_limit_is_not_marked() -> None:
    times, poses = motion(3000, rate_hz=250.0)
    assert (reconstruct(record(limited(), times, poses)).status == Status.OK).all()


@pytest.mark.parametrize("rate_hz", [200.0, 1000.0, 5000.0])
def test_rounding_alone_is_never_slack(rate_hz: float) -> None:
    t = np.arange(4000) / rate_hz
    limit = LIMIT / 0.012
    # as fast as the limit allows
    counts = np.rint(1e4 * np.sin(np.sqrt(limit / 1e4) * t))
    assert not slack_samples(counts, t, limit, 1.0).any()
    corner = np.rint(np.abs(t - t[2000]) * 30.0 * np.sqrt(limit))
    assert slack_samples(corner, t, limit, 1.0)[2000]


def test_few_samples_and_gaps_tell_nothing() -> None:
    t = np.arange(10) / 1000.0
    assert not slack_samples(np.zeros(2), t[:2], 1e6, 1.0).any()
    assert not slack_samples(np.full(10, np.nan), t, 1e6, 1.0).any()
