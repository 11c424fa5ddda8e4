"""The corrected table of links and URDF say, to readers of their own, the robot that was identified."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kinematics_readers import by_table, by_urdf
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.robots import Robot, read_urdf, write_robot, write_urdf
from lmeasure.robots.robot import robot_from_dict, serial, shipped


def chain(kinds: str, seed: int) -> Robot:
    """Turning (R), sliding (P) and backwards counting (r, p) axes, skew, parallel and crossing, on a base, with a tool."""
    rng = np.random.default_rng(seed)
    joints: list[dict[str, Any]] = []
    for i, kind in enumerate(kinds):
        twist = [0.0, 90.0, -90.0, 180.0, float(rng.uniform(-180, 180))][int(rng.integers(5))]
        unit, low, high = ("mm", -400.0, 900.0) if kind in "Pp" else ("deg", -170.0, 170.0)
        own = {"name": f"axis_{i}", "type": "prismatic" if kind in "Pp" else "revolute", f"min_{unit}": low, f"max_{unit}": high}
        own |= {"theta_deg": rng.uniform(-180, 180), "d_mm": rng.uniform(-400, 400), "a_mm": rng.uniform(-600, 600), "alpha_deg": twist}
        own |= {"beta_deg": rng.uniform(-1, 1) if twist == 0.0 else 0.0} | ({"scale": -1.0} if kind.islower() else {})
        joints.append(own)
    # pitched by a quarter, where fixed angles are at their worst
    turned = Rotation.from_euler("xyz", [0.3, 0.5 * np.pi - [0.0, 1e-7, 1e-3][seed % 3], -1.1]).as_quat().tolist()
    base = {"position_mm": [1200.0, -300.0, 450.0], "quaternion_xyzw": turned}
    tool = {"position_mm": [12.5, -40.0, 180.0], "quaternion_xyzw": turned[::-1]}
    return serial(
        robot_from_dict({"schema": "lmeasure.robot/1", "name": "chain", "base": base, "tool": tool, "joint": joints}, "chain"), "chain"
    )


def erring(robot: Robot, seed: int) -> Robot:
    """As identified: every parameter of its links moved."""
    rng, values = np.random.default_rng(seed), {}
    for p in robot.model.parameters:
        if p.name.rpartition(".")[2] in ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg"):
            values[p.name] = p.value + rng.normal() * (0.3 if p.unit == "mm" else 0.03)
    return robot.with_values(values)


ROBOTS = [shipped(name) for name in ("generic6", "generic7", "ur5")]
ROBOTS += [chain(kinds, seed) for seed, kinds in enumerate(("R", "P", "PPP", "RRPR", "PRRRRRR", "RPRPRPR", "rRPpr", "rrrrrr", "RRRRRRPP"))]


@pytest.mark.parametrize("nominal", ROBOTS, ids=lambda r: f"{r.name}-{''.join('RP'[s] for s in r.sliding)}")
def test_the_files_of_a_corrected_robot_say_its_poses(nominal: Robot, tmp_path: Path) -> None:
    robot = erring(nominal, 4)
    write_robot(tmp_path / "robot.toml", robot)
    write_urdf(tmp_path / "robot.urdf", robot)
    model, again = robot.model, read_urdf(tmp_path / "robot.urdf")
    low, high = model.limits
    np.testing.assert_allclose(again.model.limits, model.limits, atol=1e-9)
    for joints in np.random.default_rng(5).uniform(low, high, (12, len(low))):
        values = dict(zip(model.joint_names, joints, strict=True))
        pose = model.forward(joints[None])[0]
        flange = np.eye(4)
        flange[:3, :3], flange[:3, 3] = se3.matrices(pose), pose[:3]
        for determined in (by_table(tmp_path / "robot.toml", values), by_urdf(tmp_path / "robot.urdf", values, "flange")):
            np.testing.assert_allclose(determined[:3, 3], flange[:3, 3], rtol=0, atol=1e-9)
            np.testing.assert_allclose(determined[:3, :3], flange[:3, :3], rtol=0, atol=1e-11)
        # and read back by the program itself it is the same motion
        assert (
            np.abs(
                se3.displacement(se3.compose(again.model.forward(joints[None])[0], again.tool_pose), se3.compose(pose, robot.tool_pose))
            ).max()
            < 1e-8
        )
        if robot.tool is not None:
            tip = se3.compose(pose, robot.tool_pose)
            determined = by_urdf(tmp_path / "robot.urdf", values, "tool")
            np.testing.assert_allclose(determined[:3, 3], tip[:3], rtol=0, atol=1e-9)
            np.testing.assert_allclose(determined[:3, :3], se3.matrices(tip), rtol=0, atol=1e-11)
