"""URDFs with the odd parts that public ones have, against kinematics of their own: forks, mimic joints, fixed joints, base and flange links.

Forty arms are drawn from seeds. What is expected of each is computed from what it was drawn from, by matrices, and by no code of lmeasure.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from kinematics_readers import Matrix, by_table, by_urdf, shift, turn

from lmeasure import se3
from lmeasure.errors import RobotError
from lmeasure.robots.robot import read_robot, write_robot
from lmeasure.robots.urdf import read_urdf, write_urdf


@dataclass
class Part:
    """A joint as it is drawn: metres, radians, fixed XYZ angles."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limit: str = ""
    mimic: tuple[str, float, float] | None = None

    def xml(self) -> str:
        words = f'<parent link="{self.parent}"/><child link="{self.child}"/>'
        words += f'<origin xyz="{" ".join(map(repr, self.xyz))}" rpy="{" ".join(map(repr, self.rpy))}"/>'
        words += "" if self.kind == "fixed" else f'<axis xyz="{" ".join(map(repr, self.axis))}"/>'
        if self.mimic:
            words += f'<mimic joint="{self.mimic[0]}" multiplier="{self.mimic[1]!r}" offset="{self.mimic[2]!r}"/>'
        return f'<joint name="{self.name}" type="{self.kind}">{words}{self.limit}</joint>'

    def moved(self, value: float) -> Matrix:
        """parent_from_child at a value [rad, m], in mm."""
        roll, pitch, yaw = self.rpy
        at = shift([1000.0 * v for v in self.xyz]) @ turn([0, 0, 1], yaw) @ turn([0, 1, 0], pitch) @ turn([1, 0, 0], roll)
        if self.kind == "fixed":
            return at
        along = np.array(self.axis) / np.linalg.norm(self.axis)
        return at @ (shift(1000.0 * value * along) if self.kind == "prismatic" else turn(along, value))


@dataclass
class Arm:
    """An arm as it is drawn, the links that are its controller's base and flange, and the names of its variables."""

    base: str
    flange: str
    parts: list[Part]
    variables: list[str]
    limits: dict[str, tuple[float, float]]
    extra: str = ""
    by_name: dict[str, Part] = field(init=False)

    def __post_init__(self) -> None:
        self.by_name = {p.name: p for p in self.parts}

    def value(self, name: str, values: dict[str, float]) -> float:
        part = self.by_name[name]
        if part.mimic is None:
            return values.get(name, 0.0)
        return part.mimic[1] * self.value(part.mimic[0], values) + part.mimic[2]

    def place(self, link: str, values: dict[str, float]) -> Matrix:
        """root_from_link."""
        above = {p.child: p for p in self.parts}
        at = np.eye(4)
        while link in above:
            part = above[link]
            at, link = part.moved(0.0 if part.kind in ("fixed", "floating") else self.value(part.name, values)) @ at, part.parent
        return at

    def pose(self, values: dict[str, float]) -> Matrix:
        """base_from_flange."""
        return np.asarray(np.linalg.inv(self.place(self.base, values)) @ self.place(self.flange, values))

    def write(self, path: Path) -> Path:
        links = dict.fromkeys(link for p in self.parts for link in (p.parent, p.child))
        mesh = '<visual><geometry><mesh filename="package://none/there.stl"/></geometry></visual>'
        words = "".join(f'<link name="{link}">{mesh}</link>' for link in links) + "".join(p.xml() for p in self.parts)
        path.write_text(f'<?xml version="1.0"?>\n<robot name="drawn arm">{words}{self.extra}</robot>', encoding="utf-8")
        return path


def drawn(seed: int) -> Arm:
    """An arm of 3 to 7 variables with a selection of odd parts."""
    rng = np.random.default_rng(seed)

    def some(size: float) -> tuple[float, float, float]:
        return tuple(float(v) for v in rng.uniform(-size, size, 3))  # type: ignore[return-value]

    def axis() -> tuple[float, float, float]:
        plain = np.roll([1.0, 0.0, 0.0], rng.integers(3)) * rng.choice([-1.0, 1.0])
        return tuple(float(v) for v in (plain if rng.random() < 0.6 else 2.0 * rng.normal(size=3)))  # type: ignore[return-value]

    def odd(chance: float) -> bool:
        return bool(rng.random() < chance)

    prefix = "robot1_" if odd(0.2) else ""
    parts, variables, limits = list[Part](), list[str](), dict[str, tuple[float, float]]()
    base = link = f"{prefix}base_link"
    if odd(0.3):
        parts.append(Part("to_world", "floating" if odd(0.5) else "fixed", "world", link, some(1.0), some(3.0)))
        base = "world" if parts[-1].kind == "fixed" else link
    if odd(0.5):  # the controller's base, turned against base_link
        base = f"{prefix}base"
        parts.append(Part("to_base", "fixed", link, base, some(0.3), (0.0, 0.0, float(np.pi))))
    for i in range(int(rng.integers(3, 8))):
        if odd(0.3):
            parts.append(Part(f"fixed_{i}", "fixed", link, f"plate_{i}", some(0.2), some(3.0)))
            link = f"plate_{i}"
        kind = str(rng.choice(["revolute", "revolute", "continuous", "prismatic"]))
        low, high = -2.5 + 0.1 * i, 2.6
        limit = f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
        if kind == "continuous" or (kind == "revolute" and odd(0.3)):
            low, high = -2 * np.pi, 2 * np.pi
            limit = "" if odd(0.5) else '<limit effort="1" velocity="1"/>' if odd(0.5) else '<limit lower="-1e6" upper="1e6" effort="1" velocity="1"/>'
        name, child = f"joint_{i + 1}", f"link_{i + 1}"
        parts.append(Part(name, kind, link, child, some(0.6), some(3.0), axis(), limit))
        variables.append(name)
        limits[name] = (low, high)
        if odd(0.4):  # a cylinder beside it, which moves nothing of the arm
            parts.append(Part(f"rod_{i}", "prismatic" if odd(0.5) else "revolute", link, f"rod_{i}", some(0.3), mimic=(name, 0.5, 0.0)))
        link = child
        if odd(0.3):  # a parallelogram: the next link keeps its direction, or follows in some other way
            leader = str(rng.choice(variables))
            follows = "prismatic" if odd(0.2) else "revolute"
            ratio, offset = float(rng.choice([-1.0, 0.5, 1.5])), float(rng.choice([0.0, 0.3]))
            parts.append(Part(f"follower_{i}", follows, link, f"bar_{i}", some(0.5), some(3.0), axis(), mimic=(leader, ratio, offset)))
            link = f"bar_{i}"
            if odd(0.3):  # which another one follows in its turn
                parts.append(Part(f"second_{i}", "revolute", link, f"plate2_{i}", some(0.3), mimic=(f"follower_{i}", 2.0, -0.1)))
                link = f"plate2_{i}"
    flange = link
    ending = int(rng.integers(4))
    if ending == 0:  # as ROS-Industrial has it
        parts.append(Part("to_flange", "fixed", link, f"{prefix}flange", some(0.2)))
        parts.append(Part("to_tool0", "fixed", f"{prefix}flange", f"{prefix}tool0", (0.0, 0.0, 0.0), (1.5707963, 0.0, 1.5707963)))
        flange = f"{prefix}tool0"
        parts.append(Part("to_camera", "fixed", link, "camera", some(0.2)))
    elif ending == 1:
        parts.append(Part("to_flange", "fixed", link, f"{prefix}flange", some(0.2), some(3.0)))
        flange = f"{prefix}flange"
    elif ending == 2:  # an end without a name that says so
        parts.append(Part("to_end", "fixed", link, "last", some(0.2), some(3.0)))
        flange = "last"
    if odd(0.5):  # a gripper of two equal fingers
        parts.append(Part("to_hand", "fixed", flange, "palm", some(0.1), some(3.0)))
        flange = "palm" if ending >= 2 else flange
        for side in ("left", "right"):
            parts.append(Part(f"{side}_finger_joint", "prismatic", "palm", f"{side}_tip", some(0.1), limit='<limit lower="0" upper="0.04"/>'))
        if odd(0.5):
            parts[-1].mimic = ("left_finger_joint", 1.0, 0.0)
    if odd(0.5):  # wheels, a head, a body on a plane: none of the arm
        parts.append(Part("wheel", "continuous", f"{prefix}base_link", "wheel_link", limit='<limit lower="-1e16" upper="1e16"/>'))
        parts.append(Part("ball", "planar", f"{prefix}base_link", "ball_link"))
    extra = '<gazebo reference="x"><material>Gazebo/Grey</material></gazebo><transmission name="t"><joint name="joint_1"/></transmission>'
    return Arm(base, flange, parts, variables, limits, extra)


@pytest.mark.parametrize("seed", range(40))
def test_forty_arms_of_odd_parts(seed: int, tmp_path: Path) -> None:
    arm = drawn(seed)
    robot = read_urdf(arm.write(tmp_path / "arm.urdf"))
    model = robot.model
    assert list(model.joint_names) == arm.variables
    assert (robot.base is not None and robot.base.link, robot.flange is not None and robot.flange.link) == (arm.base, arm.flange)
    write_robot(tmp_path / "robot.toml", robot)
    write_urdf(tmp_path / "robot.urdf", robot)
    assert read_robot(tmp_path / "robot.toml") == robot
    again = read_urdf(tmp_path / "robot.urdf")
    np.testing.assert_allclose(again.model.limits, model.limits, atol=1e-9)
    slides = model.sliding
    for name, sliding, low, high in zip(arm.variables, slides, *model.limits, strict=True):
        size = 1000.0 if sliding else 1.0
        assert size * arm.limits[name][0] - 1e-9 <= low < high <= size * arm.limits[name][1] + 1e-9
    rng = np.random.default_rng(seed)
    for joints in rng.uniform(-1.0, 1.0, (4, len(slides))):
        want = arm.pose(dict(zip(arm.variables, joints, strict=True)))
        values = np.where(slides, 1000.0 * joints, joints)
        named = dict(zip(arm.variables, values, strict=True))
        pose = model.forward(values[None])[0]
        by_program = np.eye(4)
        by_program[:3, :3], by_program[:3, 3] = se3.matrices(pose), pose[:3]
        table, urdf = by_table(tmp_path / "robot.toml", named), by_urdf(tmp_path / "robot.urdf", named, "flange")
        for got in (by_program, table, urdf):
            np.testing.assert_allclose(got[:3, 3], want[:3, 3], rtol=0, atol=1e-6)
            np.testing.assert_allclose(got[:3, :3], want[:3, :3], rtol=0, atol=1e-9)
        assert np.abs(se3.displacement(again.model.forward(values[None])[0], pose)).max() < 1e-7
        # derivatives by the joints: a coupled joint moves its followers too
        poses, twists, _ = model.derivatives(values[None])
        for k, h in enumerate(np.where(slides, 1e-3, 1e-6)):
            two = [model.forward((values + sign * h * np.eye(len(values))[k])[None])[0] for sign in (1.0, -1.0)]
            moved = np.array(two[0][:3] - two[1][:3]) / (2.0 * h)
            np.testing.assert_allclose(twists[0, k, 3:] + np.cross(twists[0, k, :3], poses[0, :3]), moved, rtol=1e-5, atol=1e-3)
