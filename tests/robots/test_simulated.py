"""The simulated robot: what is switched off leaves no trace, and what is switched on is as large as it should be."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError
from lmeasure.robots import Command, Performance, SimulatedRobot, cell_robot
from lmeasure.robots.serial import SerialArm

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
RATE = 1000.0


def pose(x: float, y: float, z: float, *tilt: float) -> FloatArray:
    return np.array([x, y, z, *Rotation.from_rotvec(tilt or (0.0, 0.0, 0.0)).as_quat()])


def perfect() -> SimulatedRobot:
    robot = cell_robot()
    nothing = np.zeros(6)
    fast = np.full(6, 5000.0)
    return replace(
        robot, built=robot.nominal, natural_rad_s=fast, damping=np.ones(6), joint_noise_rad=nothing, backlash_rad=nothing, growth=0.0
    )


def go(robot: SimulatedRobot, *commands: Command, seed: int = 0) -> Performance:
    return robot.perform(commands, HOME, RATE, np.random.default_rng(seed))


def to(*places: FloatArray, speed: float = 500.0, dwell: float = 0.3, **more: object) -> Command:
    return Command(np.array(places), speed, dwell, **more)  # type: ignore[arg-type]


def resting(performance: Performance) -> FloatArray:
    """(k, 7) true poses at the ends of the commands."""
    return performance.poses[[math.ceil(s.end_s * RATE - 1e-6) - 1 for s in performance.spans]]


def test_a_perfect_robot_is_where_it_is_told_to_be() -> None:
    targets = [pose(200, -150, 80, 0.2, -0.1, 0.3), pose(-200, 150, 0), pose(-200, 150, 0, 0.1, 0, 0)]
    done = go(perfect(), *(to(t) for t in targets))
    assert resting(done)[:, :3] == pytest.approx(np.array(targets)[:, :3], abs=1e-8)
    assert np.abs((resting(done)[:, 3:] * np.array(targets)[:, 3:]).sum(axis=1)) == pytest.approx(1.0, abs=1e-14)
    # two poles at 5000 rad/s are 0.4 ms behind
    assert np.abs(done.poses[:, :3] - done.commanded[:, :3]).max() < 0.4e-3 * 500.0 * 1.01


def test_spans_are_ways_ramps_and_rests() -> None:
    robot = perfect()
    done = go(robot, to(pose(100, 0, 0), speed=400.0), to(pose(100, 0, 0, 0, 0, 0.2), dwell=0.1))
    first, second = done.spans
    assert (first.begin_s, first.arrival_s, first.end_s) == pytest.approx((0.0, 0.25 + sum(robot.ramp_s), 0.25 + sum(robot.ramp_s) + 0.3))
    assert second.begin_s == first.end_s
    assert second.arrival_s - second.begin_s == pytest.approx(0.2 / 1.0 + sum(robot.ramp_s))
    assert done.time_s[-1] == pytest.approx(second.end_s, abs=1.0 / RATE)
    moving = np.flatnonzero(np.abs(np.diff(done.commanded[:, 0])) > 1e-9) / RATE
    assert moving[0] == pytest.approx(0.0, abs=2e-3)
    assert moving[-1] == pytest.approx(first.arrival_s, abs=5e-3)


def test_setpoints_keep_to_the_speed_and_to_what_the_ramps_allow() -> None:
    robot = perfect()
    done = go(robot, to(pose(250, 0, 0), speed=500.0))
    speed = np.diff(done.commanded[:, 0]) * RATE
    assert speed.max() == pytest.approx(500.0, rel=1e-9)
    assert np.abs(np.diff(speed)).max() * RATE <= 500.0 / max(robot.ramp_s) * 1.001


def test_a_corner_is_cut_by_what_two_averages_cut() -> None:
    robot = perfect()
    done = go(robot, to(pose(200, 0, 0), pose(200, 200, 0), speed=400.0))
    # ways before and behind the corner are symmetric about it: the mean of |t - corner| v / 2 over both averages, along each side
    grid = np.linspace(-0.5, 0.5, 2001)
    a, b = robot.ramp_s
    mean = np.abs(a * grid[:, None] + b * grid[None, :]).mean()
    cut = math.sqrt(2.0) * 400.0 * mean / 2.0
    assert np.linalg.norm(done.commanded[:, :2] - [200, 0], axis=1).min() == pytest.approx(cut, rel=1e-3)


def test_a_servo_is_its_differential_equation() -> None:
    w, z = np.linspace(30.0, 80.0, 6), np.linspace(0.4, 1.2, 6)
    robot = replace(perfect(), natural_rad_s=w, damping=z)
    time_s = np.arange(400) / RATE
    requested = 0.1 + np.stack([np.interp(time_s, [0.05, 0.15], [0.0, 0.3 + 0.1 * i]) for i in range(6)], axis=1)
    got = robot._servo(requested, RATE)
    for i in range(6):

        def flow(t: float, y: FloatArray, i: int = i) -> list[float]:
            u = float(np.interp(t, time_s, requested[:, i]))
            return [y[1], w[i] ** 2 * (u - y[0]) - 2 * z[i] * w[i] * y[1]]

        solved = solve_ivp(flow, (0.0, time_s[-1]), [0.1, 0.0], t_eval=time_s, rtol=1e-9, atol=1e-11, max_step=1e-3).y[0]
        assert got[:, i] == pytest.approx(solved, abs=1e-8)


def test_each_rest_keeps_one_rounding_of_the_joints_and_cycles_scatter_as_stated() -> None:
    robot = replace(perfect(), joint_noise_rad=np.full(6, 2e-5))
    cycles = 200
    done = go(robot, *(to(p, speed=2000.0, dwell=0.1) for _ in range(cycles) for p in (pose(50, 0, 0), HOME)))
    span = done.spans[7]
    rest = done.poses[math.ceil((span.arrival_s + 0.01) * RATE) : math.floor(span.end_s * RATE)]
    assert np.ptp(rest, axis=0).max() < 1e-9
    scatter = resting(done)[1::2, :3].std(axis=0, ddof=1)
    joints = robot.nominal.follow(HOME[None], robot.rest)[0]
    h = 1e-6
    jacobian = np.array([(robot.nominal.forward(joints + h * e)[:3] - robot.nominal.forward(joints)[:3]) / h for e in np.eye(6)])
    stated = 2e-5 * np.sqrt((jacobian**2).sum(axis=0))
    assert scatter == pytest.approx(stated, rel=0.2)


def test_backlash_shows_between_opposite_approaches_only() -> None:
    robot = replace(perfect(), backlash_rad=np.full(6, 1e-4))
    done = resting(go(robot, to(pose(0, 80, 0)), to(HOME), to(pose(0, -80, 0)), to(HOME), to(pose(0, 80, 0)), to(HOME)))
    assert done[5] == pytest.approx(done[1], abs=1e-9)
    # the first joint turns the tool about the foot, 1100 mm away
    assert np.linalg.norm(done[3, :3] - done[1, :3]) > 1e-4 * 1000.0


def test_heat_moves_the_tool_outwards_by_the_links_growth() -> None:
    robot = replace(perfect(), growth=1e-4, growth_s=2.0)
    done = go(robot, to(HOME, dwell=10.0))
    arm = robot.nominal
    assert isinstance(arm, SerialArm)
    at, _ = arm.flange(arm.follow(HOME[None], robot.rest))
    moved = np.linalg.norm(done.poses[-1, :3] - HOME[:3])
    assert moved == pytest.approx(1e-4 * (1 - math.exp(-done.time_s[-1] / 2.0)) * np.linalg.norm(at[0]), rel=1e-6)


def test_a_load_pulls_the_tool_down_and_a_force_along_itself() -> None:
    robot = perfect()
    done = resting(go(robot, to(HOME, load_kg=10.0), to(HOME, force_n=np.array([0.0, 100.0, 0.0])), to(HOME)))
    assert done[0, 2] < -0.01
    assert done[1, 1] > 0.01
    assert done[2] == pytest.approx(HOME, abs=1e-9)


def test_the_same_seed_gives_the_same_robot_and_the_same_cycles() -> None:
    a, b = (go(cell_robot(3), to(pose(50, 60, 70)), to(HOME), seed=5).poses for _ in range(2))
    assert (a == b).all()
    assert not (go(cell_robot(4), to(pose(50, 60, 70)), to(HOME), seed=5).poses == a).all()


def test_a_command_out_of_reach_is_named() -> None:
    with pytest.raises(RobotError, match=r"command 2 \(P7, cycle 3\): sample \d+: the arm cannot reach x"):
        go(cell_robot(), to(pose(10, 0, 0)), to(pose(-5000, 0, 0), target="P7", cycle=3))
