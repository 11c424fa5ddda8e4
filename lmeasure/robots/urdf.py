"""Robots from URDF, and as URDF: the chain of joints from the root to the tip, by lxml, which fetches nothing and expands nothing.

URDF states metres, radians, and for each joint a frame (fixed XYZ angles) with an axis in it. A chain is taken over as Denavit-Hartenberg
links by the lines of its axes alone: between skew or crossing axes by their common normal, between parallel ones
by the normal that leaves no d, with Hayati's beta. What is left behind the last axis is the tool.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from lmeasure import files, se3
from lmeasure.arrays import FloatArray
from lmeasure.errors import RobotError
from lmeasure.opened import read_regular
from lmeasure.robots.robot import GEOMETRY, MOST_JOINTS, Prismatic, Robot, robot_from_dict, serial
from lmeasure.robots.serial_robot import NEARLY_PARALLEL

LARGEST = 1 << 24
MM = 1e3
MOVING = ("revolute", "continuous", "prismatic")
_HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class _Joint:
    """A joint of a file: parent_from_joint (7,) [mm], its axis (3,) in the joint's own frame, limits [rad, mm]."""

    name: str
    kind: str
    parent: str
    child: str
    frame: FloatArray
    axis: FloatArray
    low: float
    high: float


def read_urdf(path: Path, tip: str | None = None) -> Robot:
    """The chain from the root to the link `tip`, by default that with the most joints that move; RobotError names what cannot be read."""
    root = _parsed(path)
    joints = [_joint(element, path) for element in root.iterfind("joint")]
    chain = _chain(joints, tip, path)
    moving = [j for j in chain if j.kind in MOVING]
    if not 1 <= len(moving) <= MOST_JOINTS:
        end = chain[-1].child if chain else "its root"
        raise RobotError(f"{path}: the chain to {end!r} has {len(moving)} joints that move; 1 to {MOST_JOINTS} can be read")
    at = _HERE
    axes: list[tuple[FloatArray, FloatArray]] = []
    for j in chain:
        at = se3.compose(at, j.frame)
        if j.kind in MOVING:
            axes.append((at[:3], se3.rotation(at).apply(j.axis)))
    foot, links, left = _links(axes, at)
    tables = []
    for j, (theta, d, a, alpha, beta) in zip(moving, links, strict=True):
        slides = j.kind == "prismatic"
        unit, low, high = ("mm", j.low, j.high) if slides else ("deg", math.degrees(j.low), math.degrees(j.high))
        table = {
            "name": _name(j.name),
            "type": "prismatic" if slides else "revolute",
            "d_mm": d,
            "a_mm": a,
            f"min_{unit}": low,
            f"max_{unit}": high,
        }
        table |= {f"{key}_deg": math.degrees(v) for key, v in (("theta", theta), ("alpha", alpha), ("beta", beta))}
        tables.append(table)
    data: dict[str, object] = {"schema": "lmeasure.robot/1", "name": _name(root.get("name") or "robot"), "joint": tables}
    data |= {key: _place(pose) for key, pose in (("base", foot), ("tool", left)) if not np.allclose(pose, _HERE, rtol=0, atol=1e-12)}
    return serial(robot_from_dict(data, str(path)), str(path))


def write_urdf(path: Path, robot: Robot) -> None:
    """Write the robot's geometry as URDF, whole or not at all; what it has no words for a comment names."""
    root = etree.Element("robot", name=robot.name)
    left_out = sorted(
        {key for j in robot.to_dict()["joint"] for key in j if key not in GEOMETRY and not (key == "scale" and j[key] == -1.0)}
    )
    if left_out:
        root.append(etree.Comment(f" not in this file, which has no words for it: {', '.join(left_out)} "))
    etree.SubElement(root, "link", name="base")
    at = _HERE if robot.base is None else robot.base.row
    parent = "base"
    for j, (theta, d, a, alpha, beta) in zip(robot.joint, robot.arm.links, strict=True):
        child = f"{j.name}_link"
        etree.SubElement(root, "link", name=child)
        slides = isinstance(j, Prismatic)
        element = _element(root, j.name, "prismatic" if slides else "revolute", parent, child, se3.compose(at, _about("z", theta)))
        # a joint that counts the other way turns or slides about the axis reversed
        etree.SubElement(element, "axis", xyz="0 0 1" if j.scale > 0.0 else "0 0 -1")
        low, high = (j.min_mm / MM, j.max_mm / MM) if isinstance(j, Prismatic) else (math.radians(j.min_deg), math.radians(j.max_deg))
        etree.SubElement(element, "limit", lower=repr(low), upper=repr(high), effort="0", velocity="0")
        shift = se3.pose([a, 0.0, d], Rotation.identity())
        at = se3.compose(shift, se3.compose(_about("x", alpha), _about("y", beta)))
        parent = child
    etree.SubElement(root, "link", name="flange")
    _element(root, "flange_fixed", "fixed", parent, "flange", at)
    if robot.tool is not None:
        etree.SubElement(root, "link", name="tool")
        _element(root, "tool_fixed", "fixed", "flange", "tool", robot.tool.row)
    files.write_bytes(path, etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True))


def _parsed(path: Path) -> etree._Element:
    raw = read_regular(Path(path), LARGEST)
    parser = etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        root = etree.fromstring(raw, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise RobotError(f"{path}: is not URDF: {error}") from None
    if root.getroottree().docinfo.doctype:
        raise RobotError(f"{path}: states a document type, which no URDF needs and a hostile one abuses; remove the DOCTYPE")
    if root.tag != "robot":
        raise RobotError(f"{path}: is not URDF: its first element is {root.tag!r}, not 'robot'")
    return root


def _joint(element: etree._Element, path: Path) -> _Joint:
    name, kind = element.get("name") or "", element.get("type") or ""
    if kind not in (*MOVING, "fixed"):
        raise RobotError(f"{path}: joint {name!r}: type {kind!r} is none of {', '.join(MOVING)}, fixed")
    if element.find("mimic") is not None:
        raise RobotError(f"{path}: joint {name!r}: follows another joint (mimic), which is no joint of its own")
    ends = []
    for end in ("parent", "child"):
        link = element.find(end)
        if link is None or not link.get("link"):
            raise RobotError(f"{path}: joint {name!r}: <{end} link=...> is missing")
        ends.append(str(link.get("link")))
    origin, axis, limit = element.find("origin"), element.find("axis"), element.find("limit")
    xyz, rpy = (_vector(None if origin is None else origin.get(key), name, path) for key in ("xyz", "rpy"))
    along = _vector(axis.get("xyz"), name, path) if axis is not None else np.array([1.0, 0.0, 0.0])
    length = float(np.linalg.norm(along))
    if kind in MOVING and not length > 1e-9:
        raise RobotError(f"{path}: joint {name!r}: its axis has no direction")
    low, high = -2.0 * math.pi, 2.0 * math.pi
    if kind in ("revolute", "prismatic"):
        if limit is None:
            raise RobotError(f"{path}: joint {name!r}: <limit> is missing, which a {kind} joint needs")
        low, high = (float(_vector(f"{limit.get(key) or 0} 0 0", name, path)[0]) for key in ("lower", "upper"))
    size = MM if kind == "prismatic" else 1.0
    frame = se3.pose(MM * xyz, Rotation.from_euler("xyz", rpy))
    return _Joint(name, kind, ends[0], ends[1], frame, along / max(length, 1e-9), low * size, high * size)


def _vector(text: str | None, joint: str, path: Path) -> FloatArray:
    try:
        values = np.array([float(v) for v in (text or "0 0 0").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.isfinite(values).all() or np.abs(values).max() > 1e6:
        raise RobotError(f"{path}: joint {joint!r}: {str(text)[:60]!r} is not three numbers")
    return values


def _chain(joints: list[_Joint], tip: str | None, path: Path) -> list[_Joint]:
    above = {j.child: j for j in joints}
    if len(above) < len(joints):
        twice = next(j.child for j in joints if sum(k.child == j.child for k in joints) > 1)
        raise RobotError(f"{path}: link {twice!r} is the child of two joints: no chain leads there")
    parents = {j.parent for j in joints}
    ends = [tip] if tip is not None else [j.child for j in joints if j.child not in parents]
    chains = []
    for end in ends:
        chain: list[_Joint] = []
        while end in above and len(chain) <= len(joints):
            chain.insert(0, above[end])
            end = above[end].parent
        chains.append(chain)
    moving = [sum(j.kind in MOVING for j in chain) for chain in chains]
    if not moving or max(moving) == 0 or len(chains[int(np.argmax(moving))]) > len(joints):
        raise RobotError(f"{path}: no chain of joints leads from a root to {'a tip' if tip is None else repr(tip)}")
    best = [chain for chain, count in zip(chains, moving, strict=True) if count == max(moving)]
    if len({tuple(j.name for j in chain if j.kind in MOVING) for chain in best}) > 1:
        raise RobotError(
            f"{path}: chains to {', '.join(repr(c[-1].child) for c in best)} have {max(moving)} joints each; state which tip is meant"
        )
    # of tips behind the same joints the farthest: the tool behind the flange
    return max(best, key=len)


def _links(axes: list[tuple[FloatArray, FloatArray]], end: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """base_from_foot (7,), links (n, 5), flange_from_tool (7,) of axes (point, direction) in the base frame, and the last frame (7,)."""
    point, along = axes[0]
    # the foot keeps the base's own origin and directions as far as the first axis lets it
    start = point - (point @ along) * along if abs(along[2]) < 1.0 - 1e-12 or np.linalg.norm(point[:2]) > 1e-9 else np.zeros(3)
    foot = frame = se3.pose(
        start,
        Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0] if along[2] > -1.0 + 1e-12 else Rotation.from_rotvec([math.pi, 0.0, 0.0]),
    )
    links = np.zeros((len(axes), 5))
    for i, (point, along) in enumerate(axes[1:]):
        back = se3.inverse(frame)
        here, way = se3.apply(back, point), se3.rotation(back).apply(along)
        links[i] = _link(here, way)
        frame = se3.compose(frame, _past(links[i]))
    return foot, links, se3.between(se3.compose(frame, _past(links[-1])), end)


def _link(point: FloatArray, along: FloatArray) -> FloatArray:
    """(5,) the link from a frame whose z is one axis to one whose z is the next, a line given in the first frame."""
    across = math.hypot(along[0], along[1])
    if across < NEARLY_PARALLEL and abs(along[2]) > 0.5:
        # the plane z = 0 cuts the next axis: no d; x points there
        foot = point - along * (point[2] / along[2])
        a, d = math.hypot(foot[0], foot[1]), 0.0
        theta = math.atan2(foot[1], foot[0]) if a > 1e-9 else 0.0
    else:
        # x along the common normal, to whichever side leaves a not negative
        theta = math.atan2(along[0], -along[1])
        x, y = np.array([math.cos(theta), math.sin(theta), 0.0]), np.array([0.0, 0.0, 1.0])
        a = float(point @ x)
        if a < -1e-12:
            theta, x, a = theta + math.pi, -x, -a
        # d z + a x + s along = point
        d = float(np.linalg.lstsq(np.column_stack([y, -along]), point - a * x, rcond=None)[0][0])
    local = Rotation.from_rotvec([0.0, 0.0, -theta]).apply(along)
    # Rx(alpha) Ry(beta) z = (sin beta, -sin alpha cos beta, cos alpha cos beta)
    beta = math.asin(max(-1.0, min(1.0, float(local[0]))))
    return np.array([math.remainder(theta, 2.0 * math.pi), d, a, math.atan2(-local[1], local[2]), beta if abs(beta) > 1e-15 else 0.0])


def _past(link: FloatArray) -> FloatArray:
    theta, d, a, alpha, beta = link
    slid = se3.compose(_about("z", theta), se3.pose([a, 0.0, d], Rotation.identity()))
    return se3.compose(slid, se3.compose(_about("x", alpha), _about("y", beta)))


def _about(axis: str, angle: float) -> FloatArray:
    return se3.pose(np.zeros(3), Rotation.from_euler(axis, angle))


def _element(root: etree._Element, name: str, kind: str, parent: str, child: str, frame: FloatArray) -> etree._Element:
    element = etree.SubElement(root, "joint", name=name, type=kind)
    rpy = se3.rotation(frame).as_euler("xyz", suppress_warnings=True)
    etree.SubElement(element, "origin", xyz=" ".join(repr(float(v) / MM) for v in frame[:3]), rpy=" ".join(repr(float(v)) for v in rpy))
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)
    return element


def _place(pose: FloatArray) -> dict[str, list[float]]:
    return {"position_mm": [float(v) for v in pose[:3]], "quaternion_xyzw": [float(v) for v in pose[3:]]}


def _name(text: str) -> str:
    """A name of ours from one of theirs."""
    return "".join("_" if c.isspace() or c in ".,;" or not c.isprintable() else c for c in text)[:64] or "joint"
