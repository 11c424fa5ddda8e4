"""Planned poses of a robot leave less uncertainty than random ones, by covariances worked out the long way."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from in_process import ran, refused

from lmeasure.core import RobotError, se3
from lmeasure.recording import read_poses
from lmeasure.rig import read_rig
from lmeasure.robots import Allowed, ParallelFile, any_shipped, freed, nearness, read_measurements
from lmeasure.robots.identification.measurements import POSITION, measured
from lmeasure.robots.identification.observability import chosen
from lmeasure.robots.identification.unknowns import Frames, Unknowns
from lmeasure.robots.parallel.model import Parallel
from lmeasure.robots.parallel.study import inside
from lmeasure.robots.robot import shipped

ROOT = Path(__file__).parents[2]


def test_planned_poses_are_better_than_random_ones() -> None:
    rng = np.random.default_rng(7)
    robot = shipped("generic6").model
    joints, zone = rng.uniform(-2, 2, (150, 6)), rng.uniform(-2, 2, (40, 6))
    here = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    tool = here + [50.0, 20.0, 90.0, 0.0, 0.0, 0.0, 0.0]
    rows = measured(joints, np.zeros((150, 3)))
    unknowns = Unknowns(robot, freed(robot, ("links",)), Frames(here[0], tool, np.zeros((0, 3)), 0.0, np.ones(150, bool)), rows)

    def mean_variance(of: np.typing.NDArray[np.int64]) -> float:
        J = unknowns.linearised(np.zeros(len(unknowns)))[1][of][:, POSITION].reshape(-1, len(unknowns)) / 0.05
        C = np.linalg.inv(J.T @ J + np.diag(1.0 / unknowns.width**2))
        over = unknowns.linearised(np.zeros(len(unknowns)), measured(zone, np.zeros((40, 3))))[1][:, POSITION]
        return float(np.einsum("nip,pq,niq->", over, C, over) / len(zone))

    plan = chosen(unknowns, joints, zone, 15, u_mm=0.05)
    assert len(set(plan.tolist())) == 15
    random = [mean_variance(rng.permutation(150)[:15]) for _ in range(20)]
    assert mean_variance(plan) < 0.9 * min(random)


def test_planned_poses_keep_to_what_is_allowed() -> None:
    robot = shipped("ur5").model
    box = np.array([[[200.0, 2000.0], [-2000.0, 2000.0], [-2000.0, 100.0]]])
    tool = np.array([30.0, 20.0, 120.0, 0.0, 0.0, 0.0, 1.0])
    allowed = Allowed(robot, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), tool, box)
    joints = allowed.candidates(200)
    low, high = robot.limits
    assert ((joints >= low) & (joints <= high)).all()
    target = se3.compose(robot.forward(joints), np.tile(tool, (200, 1)))
    assert not ((target[:, 0] > 200.0) & (target[:, 2] < 100.0)).any()
    # arms through the box whose target is outside it are found too
    through = np.radians([[180.0, 20.0, -60.0, -50.0, 90.0, 0.0]])
    bare = Allowed(robot, allowed.instrument_from_base, tool, box[:0])
    assert bare(through)[0]
    assert not allowed(through)[0]


def test_targets_stay_in_the_instruments_zone() -> None:
    zone = xr.Dataset(
        {"in_zone": (("x", "y", "z"), np.ones((2, 2, 2), np.int8)), "quaternion_xyzw": (("o", "c"), [[0.0, 0.0, 0.0, 1.0]])},
        {"x": [800.0, 2200.0], "y": [-1000.0, 1000.0], "z": [-500.0, 1500.0]},
    )
    zone["in_zone"][0] = 0
    robot, here = shipped("ur5").model, np.array([1500.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    tool = np.array([30.0, 20.0, 120.0, 0.0, 0.0, 0.0, 1.0])
    found = Allowed(robot, here, tool, np.zeros((0, 3, 2)), zone).candidates(100)
    at = se3.compose(np.tile(here, (100, 1)), se3.compose(robot.forward(found), np.tile(tool, (100, 1))))
    assert ((at[:, :3] >= [1500.0, -2000.0, -1500.0]) & (at[:, :3] <= [2900.0, 2000.0, 2500.0])).all()
    with pytest.raises(RobotError, match="State where the robot is"):
        Allowed(robot, here + [8000.0, 0, 0, 0, 0, 0, 0], tool, np.zeros((0, 3, 2)), zone).candidates(100)


def test_poses_of_a_mechanism_are_planned_within_all_its_limits(tmp_path: Path) -> None:
    """At random hardly any joint values of six carriages are those of a pose; the poses planned are in the workspace, and reached."""
    out = tmp_path / "joints.csv"
    done = ran("plan-poses", "--robot", "rotopod-cell", "--poses", "12", "--tool", "30,20,60", "--out", out)
    file = any_shipped("rotopod-cell")
    assert isinstance(file, ParallelFile)
    rows = read_measurements(out, file.model, joints_alone=True)
    flange = file.model.forward(rows.joints)
    assert inside(file, flange).all()
    # one that was built a little otherwise must be there too
    near = nearness(file.model.jacobians(flange, rows.joints).output, file.model.units)
    assert near.min() >= 0.3 * nearness(file.model.jacobians(file.model.home[None], file.model.home_joints[None]).output, file.model.units)
    # spread over what it can do, and better than as many at random
    assert np.ptp(flange[:, 2]) > 10.0
    line = next(line for line in done.splitlines() if line.startswith("  after  12: "))
    expected, random = (float(v) for v in line.removeprefix("  after  12: ").replace(" mm, with random poses", "").split())
    assert expected < random


def test_a_platform_is_not_planned_behind_a_singular_pose_of_the_cables() -> None:
    """A rotopod turns without end; cables that would run as well half a turn on cannot tell how it came there."""
    robot, rig = any_shipped("rotopod-cell").model, read_rig(ROOT / "tests" / "authorities" / "truth" / "cell-run" / "rig.toml")
    assert isinstance(robot, Parallel)
    base = np.array([0.0, 0.0, -400.0, 0.0, 0.0, 0.0, 1.0])
    turned = robot.home_joints + np.radians([[10.0], [40.0], [-40.0], [170.0], [-170.0]])
    for zone, expected in ((None, [True] * 5), (rig, [True, True, True, False, False])):
        allowed = Allowed(robot, base, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.zeros((0, 3, 2)), zone)
        assert allowed(turned).tolist() == expected


def test_plan_poses_of_a_robot_from_the_command_line(tmp_path: Path) -> None:
    """The table is read by `identify --predict` and as candidates; the poses are those of the target."""
    out, poses = tmp_path / "joints.csv", tmp_path / "joints_poses.csv"
    requested = ["plan-poses", "--robot", "ur5", "--poses", "12", "--tool", "30,20,120"]
    ran(*requested, "--base", "1500,0,0", "--out", out)
    rows = read_measurements(out, shipped("ur5").model, joints_alone=True)
    assert len(rows) == 12
    at = read_poses(poses, "puma-oat").rows
    own = se3.compose(np.tile([1500.0, 0, 0, 0, 0, 0, 1.0], (12, 1)), shipped("ur5").model.forward(rows.joints))
    assert at[:, :3] == pytest.approx(se3.apply(own, np.array([30.0, 20.0, 120.0])), abs=1e-6)
    ran(*requested[:3], "--poses", "5", "--candidates", out, "--out", tmp_path / "five.csv")
    assert set(read_measurements(tmp_path / "five.csv", shipped("ur5").model, joints_alone=True).names) < set(rows.names)
    refused("plan-poses", "rig.toml", "--poses", "3", "--tool", "1,2,3", "--out", tmp_path / "no.csv", code=2)
