"""Readers of robot.urdf and robot.toml for the tests, which share no code with lmeasure: base_from_tip as (4, 4) matrices in mm."""

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def turn(axis: Sequence[float], angle: float) -> Matrix:
    """About an axis through the origin: Rodrigues' formula."""
    k = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    K = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    out = np.eye(4)
    out[:3, :3] = np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)
    return out


def shift(place: Sequence[float]) -> Matrix:
    out = np.eye(4)
    out[:3, 3] = place
    return out


def by_urdf(path: Path, values: dict[str, float], tip: str) -> Matrix:
    """At joint values [rad, mm] by name, as the URDF specification has it: origin, then the motion about or along the joint's axis."""
    joints = {j.find("child").attrib["link"]: j for j in ElementTree.parse(path).getroot().iter("joint")}  # type: ignore[union-attr]
    slides = {j.attrib["name"]: j.attrib["type"] == "prismatic" for j in joints.values()}
    out = np.eye(4)
    while tip in joints:
        joint = joints[tip]
        origin, axis, parent = joint.find("origin"), joint.find("axis"), joint.find("parent")
        assert origin is not None
        assert parent is not None
        roll, pitch, yaw = (float(v) for v in origin.attrib["rpy"].split())
        own = shift([1000.0 * float(v) for v in origin.attrib["xyz"].split()])
        own = own @ turn([0, 0, 1], yaw) @ turn([0, 1, 0], pitch) @ turn([1, 0, 0], roll)
        if joint.attrib["type"] != "fixed":
            assert axis is not None
            along, mimic = [float(v) for v in axis.attrib["xyz"].split()], joint.find("mimic")
            if mimic is None:
                value = values[joint.attrib["name"]]
            else:  # of metres and radians
                leader, size = mimic.attrib["joint"], 1000.0 if joint.attrib["type"] == "prismatic" else 1.0
                si = values[leader] / 1000.0 if slides[leader] else values[leader]
                value = size * (float(mimic.attrib.get("multiplier", 1)) * si + float(mimic.attrib.get("offset", 0)))
            own = own @ (shift([value * v for v in along]) if joint.attrib["type"] == "prismatic" else turn(along, value))
        out, tip = own @ out, parent.attrib["link"]
    return out


def by_table(path: Path, values: dict[str, float]) -> Matrix:
    """At joint values [rad, mm] by name: base, then Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) of every link, then the flange."""
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    out = _place(data.get("base"))
    for joint in data["joint"]:
        theta, alpha, beta = (math.radians(joint.get(f"{key}_deg", 0.0)) for key in ("theta", "alpha", "beta"))
        d = joint.get("d_mm", 0.0)
        leader = next(j for j in data["joint"] if j["name"] == joint.get("follows", joint["name"]))
        in_file = [1.0 if j.get("type") == "prismatic" else math.degrees(1.0) for j in (joint, leader)]
        value = joint.get("ratio", 1.0) * leader.get("scale", 1.0) * values[leader["name"]] * in_file[1] / in_file[0]
        if joint.get("type", "revolute") == "prismatic":
            d += value
        else:
            theta += value
        out = out @ turn([0, 0, 1], theta) @ shift([0.0, 0.0, d]) @ shift([joint.get("a_mm", 0.0), 0.0, 0.0])
        out = out @ turn([1, 0, 0], alpha) @ turn([0, 1, 0], beta)
    return out @ _place(data.get("flange"))


def _place(table: dict[str, list[float]] | None) -> Matrix:
    if table is None:
        return np.eye(4)
    x, y, z, w = table.get("quaternion_xyzw", [0.0, 0.0, 0.0, 1.0])
    size = math.sqrt(x * x + y * y + z * z)
    return shift(table["position_mm"]) @ (turn([x, y, z], 2.0 * math.atan2(size, w)) if size else np.eye(4))
