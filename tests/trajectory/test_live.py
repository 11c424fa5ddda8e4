"""Sample by sample a run gives the poses that it gives at once."""

import numpy as np
import pytest
from cells import START, cell, motion, record

from lmeasure.errors import TrajectoryError
from lmeasure.status import WORDS
from lmeasure.trajectory import reconstruct
from lmeasure.trajectory.live import LivePose


def test_live_is_the_same_run() -> None:
    rig = cell(16)
    run = record(rig, *motion(1500, reach_mm=520.0, tilt_rad=0.1))
    first = run.passes[0]
    first.recorded[300:310, 2] = np.nan
    first.recorded[700:720, 4] += 8000.0
    at_once = reconstruct(run)
    pose = LivePose(rig, START)
    assert pose.channels == first.channels
    for i, (t, recorded) in enumerate(zip(first.time_s, first.recorded, strict=True)):
        found = pose.update(t, recorded)
        # who does not know yet that it comes back takes its origin for lost
        assert found.status == ("origin_lost" if 700 < i < 720 else WORDS[at_once.status[i]])
        np.testing.assert_array_equal(found.pose, at_once.poses[i])
        np.testing.assert_allclose(found.worst_pressure_angle_deg, at_once.worst_pressure_angle_deg[i])


def test_a_rig_that_has_no_pose_yet_is_refused() -> None:
    data = cell().to_dict()
    for i, c in enumerate(data["cable"]):
        c["channel"], c["pass"] = f"ch{i % 3 + 1}", i // 3 + 1
    with pytest.raises(TrajectoryError, match="in one pass"):
        LivePose(cell(cable=data["cable"]), START)
