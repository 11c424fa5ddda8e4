"""MCAP files that ROS's own reader understands: poses, covariances, stamps."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import cell, motion, record, with_recorded
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from lmeasure.core import TrajectoryError
from lmeasure.recording import write_run
from lmeasure.trajectory import reconstruct, write_trajectory


def test_messages_hold_what_the_trajectory_does(tmp_path: Path) -> None:
    run = record(cell(), *motion(300))
    recorded = run.passes[0].recorded.copy()
    recorded[100:110, 2] = np.nan
    run = replace(with_recorded(run, recorded), u_start=(0.2, 0.001))
    found = reconstruct(run)
    path = tmp_path / "out.mcap"
    write_trajectory(path, found)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        read = list(reader.iter_decoded_messages())
        (metadata,) = reader.iter_metadata()
    known = np.flatnonzero(~np.isnan(found.poses[:, 0]))
    assert len(read) == len(known) == 290
    order = [3, 4, 5, 0, 1, 2]
    unit = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    for i, (schema, channel, message, said) in zip(known, read, strict=True):
        assert channel.topic == "/lmeasure/pose"
        assert schema is not None
        assert schema.name == "geometry_msgs/msg/PoseWithCovarianceStamped"
        assert said.header.frame_id == "base"
        stamp = said.header.stamp.sec + 1e-9 * said.header.stamp.nanosec
        assert stamp == pytest.approx(found.time_s[i], abs=1e-9)
        assert message.log_time == round(1e9 * found.time_s[i])
        p, q = said.pose.pose.position, said.pose.pose.orientation
        np.testing.assert_allclose([p.x, p.y, p.z], found.poses[i, :3] / 1000.0, rtol=1e-15)
        np.testing.assert_array_equal([q.x, q.y, q.z, q.w], found.poses[i, 3:])
        covariance = (found.random[i] + found.systematic[i])[np.ix_(order, order)] * np.outer(unit, unit)
        np.testing.assert_allclose(np.reshape(said.pose.covariance, (6, 6)), covariance, rtol=1e-14)
    assert metadata.metadata == {"uncertainty_covers": found.covers}


def test_times_before_zero_are_refused_and_leave_nothing(tmp_path: Path) -> None:
    times, poses = motion(5)
    with pytest.raises(TrajectoryError, match=r"out.mcap: time_s = -1.0 is before 0"):
        write_trajectory(tmp_path / "out.mcap", reconstruct(record(cell(), times - 1.0, poses)))
    assert list(tmp_path.iterdir()) == []


def test_without_the_package_one_line_says_what_to_install(tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(5)))
    code = "import sys; sys.modules['mcap'] = None; from lmeasure.cli.app import main; main()"
    words = ["reconstruct", str(tmp_path / "run"), "--out", str(tmp_path / "out.mcap")]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    folder = Path(__file__).parents[2]  # no index has a package of this name
    assert done.stderr.strip().endswith(f"out.mcap: MCAP needs the package mcap: {sys.executable} -m pip install '{folder}[ros]'")
    assert len(done.stderr.strip().splitlines()) == 1
