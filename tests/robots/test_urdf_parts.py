"""URDFs with the odd parts that public ones have, against kinematics of their own: forks, mimic and fixed joints, base and flange links.

Forty arms are drawn from seeds. What is expected of each is computed from what it was drawn from, by matrices, and by no code of lmeasure.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from kinematics_readers import Matrix, by_table, by_urdf, shift, turn

from lmeasure.core import RobotError, se3
from lmeasure.robots import Settings, identify, read_measurements, read_robot, read_urdf, write_robot, write_urdf


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
            limit = (
                ""
                if odd(0.5)
                else '<limit effort="1" velocity="1"/>'
                if odd(0.5)
                else '<limit lower="-1e6" upper="1e6" effort="1" velocity="1"/>'
            )
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
            parts.append(
                Part(f"{side}_finger_joint", "prismatic", "palm", f"{side}_tip", some(0.1), limit='<limit lower="0" upper="0.04"/>')
            )
        if odd(0.5):
            parts[-1].mimic = ("left_finger_joint", 1.0, 0.0)
    if odd(0.5):  # wheels, a head, a body on a plane: none of the arm
        parts.append(Part("wheel", "continuous", f"{prefix}base_link", "wheel_link", limit='<limit lower="-1e16" upper="1e16"/>'))
        parts.append(Part("ball", "planar", f"{prefix}base_link", "ball_link"))
    extra = '<sensor:camera name="c"/><gazebo reference="x"><material>Gazebo/Grey</material></gazebo>'
    extra += '<transmission name="t"><joint name="joint_1"/></transmission>'
    return Arm(base, flange, parts, variables, limits, extra)


@pytest.mark.parametrize("seed", range(10))
def test_ten_arms_of_odd_parts(seed: int, tmp_path: Path) -> None:
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


def test_a_coupled_arm_is_reached_and_identified(tmp_path: Path) -> None:
    """Like a palletiser: a parallelogram keeps the arm's third link upright, a second one its hand level."""
    up, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    limit = '<limit lower="-1.2" upper="1.3"/>'
    parts = [
        Part("j1", "revolute", "base_link", "l1", (0, 0, 0.5), axis=up, limit=limit),
        Part("j2", "revolute", "l1", "l2", (0.3, 0, 0), axis=across, limit=limit),
    ]
    parts += [
        Part("j3", "revolute", "l2", "l3", (0, 0, 1.0), axis=across, limit=limit),
        Part("p3", "revolute", "l3", "l4", (0.01, 0, 0), axis=across, mimic=("j2", -1.0, 0.0)),
    ]
    parts += [Part("j4", "revolute", "l4", "l5", (1.2, 0, 0), axis=(1.0, 0.0, 0.0), limit=limit)]
    parts += [
        Part("j5", "revolute", "l5", "l6", (0.1, 0, 0), axis=across, limit=limit),
        Part("j6", "revolute", "l6", "l7", axis=(1.0, 0.1, 0.0), limit=limit),
    ]
    parts += [Part("to_tool0", "fixed", "l7", "tool0", (0.15, 0, 0), (0.0, 1.5, 0.0))]
    arm = Arm("base_link", "tool0", parts, ["j1", "j2", "j3", "j4", "j5", "j6"], {})
    robot = read_urdf(arm.write(tmp_path / "arm.urdf"))
    model = robot.model
    assert robot.joint[3].follows == "j2"
    assert robot.joint[3].ratio == -1.0
    rng = np.random.default_rng(3)
    joints = rng.uniform(-0.9, 0.9, (40, 6))
    pose = model.forward(joints[:1])[0]
    ways = model.inverse(pose)
    assert np.abs(ways - joints[0]).max(axis=1).min() < 1e-7
    for way in ways:
        np.testing.assert_allclose(arm.pose(dict(zip(arm.variables, way, strict=True)))[:3, 3], pose[:3], atol=1e-5)
    # built with another lower arm and a bar of the parallelogram that is 0.2 degrees off
    arm.by_name["j3"].xyz, arm.by_name["p3"].mimic = (0.0, 0.0, 1.0008), ("j2", -1.0, float(np.radians(0.2)))
    at = [arm.pose(dict(zip(arm.variables, q, strict=True))) for q in joints]
    rows = [
        f"p{i}," + ",".join(map(repr, [*np.degrees(q), *(m @ [50.0, 20.0, 120.0, 1.0])[:3]]))
        for i, (q, m) in enumerate(zip(joints.tolist(), at, strict=True))
    ]
    header = "name," + ",".join(f"j{i}_deg" for i in range(1, 7)) + ",x_mm,y_mm,z_mm"
    (tmp_path / "m.csv").write_text(
        "\n".join([header, *(row.replace("np.float64(", "").replace(")", "") for row in rows)]), encoding="utf-8"
    )
    found = identify(model, read_measurements(tmp_path / "m.csv", model), Settings())
    assert np.linalg.norm(found.nominal_errors_mm(), axis=1).mean() > 0.2
    assert np.linalg.norm(found.errors_mm(), axis=1).max() < 1e-3
    assert "p3.theta_deg" in [p.name for p in model.parameters]
    assert not any(p.name.startswith("p3.s") for p in model.parameters)  # scale and harmonics are those of the motor


FORK = [
    Part("a1", "revolute", "base_link", "l1", (0, 0, 0.4)),
    Part("a2", "revolute", "l1", "l2", (0.1, 0, 0), axis=(0.0, 1.0, 0.0)),
    Part("a3", "revolute", "l2", "l3", (0, 0, 0.5), axis=(0.0, 1.0, 0.0)),
    Part("a4", "revolute", "l3", "l4", (0.4, 0, 0), axis=(1.0, 0.0, 0.0)),
]


def arm_of(*more: Part, path: Path, tip: str | None = None, base: str | None = None) -> tuple[list[str], str | None, str | None]:
    """Names of the joints, base and flange of the common arm with more parts."""
    robot = read_urdf(Arm("", "", [*FORK, *more], [], {}).write(path / "arm.urdf"), tip, base)
    assert robot.base is not None
    assert robot.flange is not None
    return [j.name for j in robot.joint], robot.base.link, robot.flange.link


def test_which_end_is_meant(tmp_path: Path) -> None:
    four = ["a1", "a2", "a3", "a4"]
    slide = "prismatic"
    # two fingers without a name that says so, alone or one following the other, at the last link or on a plate
    for link, parts in (("l4", []), ("plate", [Part("f", "fixed", "l4", "plate")])):
        for mimic in (None, ("g1", 1.0, 0.0)):
            fingers = [Part(f"g{i}", slide, link, f"g{i}", mimic=mimic if i == 2 else None) for i in (1, 2)]
            assert arm_of(*parts, *fingers, path=tmp_path) == (four, "base_link", link)
    # a tool0 on it, a hand behind that, and a camera on another fixed joint
    hand = [
        Part("f", "fixed", "l4", "tool0"),
        Part("h", "fixed", "tool0", "hand"),
        Part("g1", slide, "hand", "g1"),
        Part("g2", slide, "hand", "g2"),
    ]
    assert arm_of(*hand, Part("c", "fixed", "l4", "camera"), path=tmp_path) == (four, "base_link", "tool0")
    assert arm_of(*hand, path=tmp_path, tip="hand") == (four, "base_link", "hand")
    # wheels and a head before it
    head = [Part("w", "continuous", "base_link", "w"), Part("n1", "revolute", "base_link", "n1"), Part("n2", "revolute", "n1", "n2")]
    assert arm_of(*head, path=tmp_path)[0] == four
    # a vehicle under it, and a lift that is part of it unless the base is stated
    assert arm_of(Part("v", "floating", "odom", "base_link"), path=tmp_path) == (four, "base_link", "l4")
    endless = '<limit lower="-999999" upper="999999"/>'
    drive = [Part("turn", "revolute", "odom", "v1", limit=endless), Part("drive", slide, "v1", "base_link", limit=endless)]
    assert arm_of(*drive, path=tmp_path) == (four, "base_link", "l4")
    # an axis whose link is called after the gripper that it carries, and prefixes that a simulator has left undeclared
    grip = [Part("a5", "revolute", "l4", "gripper_link"), Part("gripper", slide, "gripper_link", "prop", axis=(1.0, 0.0, 0.0))]
    grip += [Part(f"{side}_finger", slide, "gripper_link", side) for side in ("left", "right")]
    assert arm_of(*grip, path=tmp_path) == ([*four, "a5"], "base_link", "gripper_link")
    lift = Part("lift", slide, "ground", "base_link", axis=(0.0, 0.0, 1.0), limit='<limit lower="0" upper="0.5"/>')
    assert arm_of(lift, path=tmp_path) == (["lift", *four], "ground", "l4")
    assert arm_of(lift, path=tmp_path, base="base_link") == (four, "base_link", "l4")
    assert arm_of(Part("b", "fixed", "l1", "shoulder"), path=tmp_path, base="shoulder") == (["a2", "a3", "a4"], "shoulder", "l4")


SECOND_ARM = [Part(f"b{i}", "revolute", f"m{i - 1}" if i > 1 else "base_link", f"m{i}") for i in range(1, 5)]
TOOLS = [Part("f", "fixed", "l4", "left_tool0"), Part("g", "fixed", "m4", "right_tool0")]
SOME = '<limit lower="0" upper="1"/>'


@pytest.mark.parametrize(
    ("more", "options", "said"),
    [
        (SECOND_ARM, {}, r"to 'l4' \(4 joints\), 'm4' \(4 joints\). State one with --tip"),
        ([*SECOND_ARM, *TOOLS], {}, r"to 'left_tool0' \(4 joints\), 'right_tool0'"),
        ([Part("ring", "revolute", "l4", "l4")], {}, "link 'l4' is the child of two joints"),
        ([], {"tip": "a3"}, "it is a joint, whose link is 'l3'"),
        ([], {"tip": "nowhere"}, "links that end a chain: l4"),
        ([], {"base": "l9"}, "link 'l9' is not fixed to any link of the chain to 'l4'"),
        ([Part("p", "planar", "l4", "l5"), Part("q", "revolute", "l5", "l6")], {}, "type 'planar' is none of .*State with --base-link"),
        ([Part("s", "prismatic", "l4", "tool0")], {}, "joint 's': <limit> is missing, which a prismatic joint needs"),
        ([Part("s", "prismatic", "l4", "tool0", limit=SOME, mimic=("a1", 0.0, 0.0))], {}, "multiplier 0"),
    ],
)
def test_what_is_ambiguous_or_unreadable_says_what_to_state(more: list[Part], options: dict[str, str], said: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=said) as caught:
        arm_of(*more, path=tmp_path, **options)
    assert "\n" not in str(caught.value)
