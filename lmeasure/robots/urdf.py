"""Robots from URDF, and as URDF: the requested chain of joints, by lxml, which fetches nothing and expands nothing.

URDF states metres, radians, and for each joint a frame (fixed XYZ angles) with an axis in it. A chain is taken over as Denavit-Hartenberg
links by the lines of its axes alone: between skew or crossing axes by their common normal, between parallel ones by the normal that leaves
no d, with Hayati's beta. Fixed joints before the first axis are the robot's base, those behind the last axis its flange. Joints that mimic
another are the same variable. `urdf_tree` finds the links of the chain.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from lmeasure.core import MAX_LENGTH_MM, FloatArray, RobotError, se3
from lmeasure.io import files, read_regular
from lmeasure.robots.robot import GEOMETRY, MOST_JOINTS, Joint, Prismatic, Robot, robot_from_dict, serial
from lmeasure.robots.serial import NEARLY_PARALLEL
from lmeasure.robots.urdf_tree import CARRIED, MOVING, Branch, Mimic, Tree
from lmeasure.text import message

LARGEST = 1 << 24
MM = 1e3
ENDLESS_RAD = 100.0
"""Limits [rad, m] from here on mean that a joint has none."""
_HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class _Joint:
    """A joint of the chain: parent_from_joint (7,) [mm], its axis (3,) in the joint's own frame, limits [rad, mm] or None where it states
    none, and how its value follows that of the joint `leader` [rad, mm], where it does."""

    name: str
    slides: bool
    frame: FloatArray
    axis: FloatArray
    limits: tuple[float, float] | None
    leader: str = ""
    ratio: float = 1.0
    offset: float = 0.0


def read_urdf(path: Path, tip: str | None = None, base: str | None = None) -> Robot:
    """Read the chain from the link `base` to the link `tip`; by default from the controller's base to its flange (`urdf_tree`).

    RobotError names unreadable parts of the chain; other parts of the file are not read.
    """
    root = _parsed(path)
    tree = Tree(path, [_branch(element) for element in root.iterfind("joint")])
    elements = dict(zip(map(id, tree.branches), root.iterfind("joint"), strict=True))
    end = tree.tip(tip)
    start, above, chain = tree.chain(end, base)

    def fixed(branches: list[Branch]) -> FloatArray:
        at = _HERE
        for branch in branches:
            at = se3.compose(at, _frame(elements[id(branch)], branch.name, path))
        return at

    at = se3.inverse(fixed(above))
    axes: list[tuple[FloatArray, FloatArray]] = []
    moving: list[_Joint] = []
    for branch in chain:
        if branch.kind in MOVING:
            joint = _joint(elements[id(branch)], branch, path)
            at = se3.compose(at, joint.frame)
            axes.append((at[:3], se3.rotation(at).apply(joint.axis)))
            moving.append(joint)
        elif branch.kind == "fixed":
            at = se3.compose(at, _frame(elements[id(branch)], branch.name, path))
        else:
            known = ", ".join((*MOVING, "fixed"))
            advice = message("robots.state_base_link") if branch.kind in CARRIED else ""
            raise RobotError(
                message("error.joint_type_is_none", where=path, name=branch.name, kind=branch.kind, known=known, advice=advice)
            )
    if not 1 <= len(moving) <= MOST_JOINTS:
        raise RobotError(message("error.the_chain_to_has", where=path, end=end, n_moving=len(moving), most_joints=MOST_JOINTS))
    joints = _coupled(moving, tree, path)
    foot, links, seat = _links(axes, at)
    data: dict[str, object] = {"schema": "lmeasure.robot/1", "name": _name(root.get("name") or "robot")}
    data |= {"joint": [_table(j, link, joints) for j, link in zip(joints, links, strict=True)]}
    data |= {"base": _place(foot) | {"link": _name(start)}, "flange": _place(seat) | {"link": _name(end)}}
    if tip is None and (tool := tree.fixed_to(end, "tool")) is not None:
        data["tool"] = _place(fixed([tool]))
    return serial(robot_from_dict(data, str(path)), str(path))


def write_urdf(path: Path, robot: Robot) -> None:
    """Write the robot's geometry as URDF, whole or not at all; a comment names the parts that URDF cannot describe."""
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
        leader = next((k for k in robot.joint if k.name == j.follows), None)
        if leader is not None:
            # metres and radians of both instead of mm and degrees
            ratio = math.copysign(j.ratio, j.ratio * leader.scale) * _si(slides) / _si(isinstance(leader, Prismatic))
            etree.SubElement(element, "mimic", joint=leader.name, multiplier=repr(ratio), offset="0")
            ends = sorted(ratio * v for v in _limits(leader))
        else:
            ends = _limits(j)
        etree.SubElement(element, "limit", lower=repr(ends[0]), upper=repr(ends[1]), effort="0", velocity="0")
        shift = se3.pose([a, 0.0, d], Rotation.identity())
        at = se3.compose(shift, se3.compose(_about("x", alpha), _about("y", beta)))
        parent = child
    etree.SubElement(root, "link", name="flange")
    seat = _HERE if robot.flange is None else robot.flange.row
    _element(root, "flange_fixed", "fixed", parent, "flange", se3.compose(at, seat))
    if robot.tool is not None:
        etree.SubElement(root, "link", name="tool")
        _element(root, "tool_fixed", "fixed", "flange", "tool", robot.tool.row)
    files.write_bytes(path, etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True))


def _si(slides: bool) -> float:
    """Metres or radians in a mm or degree."""
    return 1.0 / MM if slides else math.radians(1.0)


def _limits(joint: Joint) -> list[float]:
    """Least and largest value [m, rad]."""
    return (
        [joint.min_mm / MM, joint.max_mm / MM]
        if isinstance(joint, Prismatic)
        else [math.radians(joint.min_deg), math.radians(joint.max_deg)]
    )


def _parsed(path: Path) -> etree._Element:
    raw = read_regular(Path(path), LARGEST).lstrip()
    parser = etree.XMLParser(
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
        recover=True,
    )
    try:
        root = etree.fromstring(raw, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise RobotError(message("error.is_not_urdf", where=path, value=error)) from None
    # an undeclared prefix, as simulators leave behind, is no fault of the chain
    faults = [e for e in parser.error_log if not e.type_name.startswith("NS_")]
    if faults or root is None:
        raise RobotError(
            message(
                "error.is_not_urdf", where=path, value=f"{faults[0].message}, line {faults[0].line}" if faults else "it has no elements"
            )
        )
    if root.getroottree().docinfo.doctype:
        raise RobotError(message("error.states_a_document_type", where=path))
    if root.tag != "robot":
        raise RobotError(message("error.is_not_urdf_its", where=path, tag=root.tag))
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise RobotError(message("robots.is_xacro", file=path))
    return root


def _branch(element: etree._Element) -> Branch:
    """Return a joint of the file with the links that it joins, as far as stated."""
    ends = [link.get("link") or "" if (link := element.find(end)) is not None else "" for end in ("parent", "child")]
    mimic = element.find("mimic")
    followed = None if mimic is None else Mimic(mimic.get("joint") or "", mimic.get("multiplier"), mimic.get("offset"))
    limit = element.find("limit")
    endless = limit is not None and any(_magnitude(limit.get(key)) >= ENDLESS_RAD for key in ("lower", "upper"))
    return Branch(element.get("name") or "", element.get("type") or "", ends[0], ends[1], followed, endless)


def _magnitude(text: str | None) -> float:
    try:
        return abs(float(text or 0.0))
    except ValueError:
        return 0.0


def _frame(element: etree._Element, joint: str, path: Path) -> FloatArray:
    """parent_from_joint (7,) [mm] of a joint."""
    origin = element.find("origin")
    xyz, rpy = (_vector(None if origin is None else origin.get(key), joint, path) for key in ("xyz", "rpy"))
    return se3.pose(MM * xyz, Rotation.from_euler("xyz", rpy))


def _joint(element: etree._Element, branch: Branch, path: Path) -> _Joint:
    slides = branch.kind == "prismatic"
    axis, limit = element.find("axis"), element.find("limit")
    along = _vector(axis.get("xyz"), branch.name, path) if axis is not None else np.array([1.0, 0.0, 0.0])
    length = float(np.linalg.norm(along))
    if not length > 1e-9:
        raise RobotError(message("error.joint_its_axis_has", where=path, name=branch.name))
    size, most = (MM, MAX_LENGTH_MM) if slides else (1.0, ENDLESS_RAD)
    limits = None
    if branch.kind != "continuous" and limit is not None:
        low, high = (size * _number(limit.get(key), 0.0, branch.name, path) for key in ("lower", "upper"))
        limits = (low, high) if low < high and max(abs(low), abs(high)) <= most else None
    return _Joint(branch.name, slides, _frame(element, branch.name, path), along / length, limits)


def _coupled(moving: list[_Joint], tree: Tree, path: Path) -> list[_Joint]:
    """Return the joints with the index of the one that each follows; if that is not in the chain, the first that follows it replaces it."""
    own = {j.name: j for j in moving}
    leads: dict[str, tuple[str, float, float]] = {}  # by joint of the file: the joint of the chain that has its value, and how
    out: list[_Joint] = []
    for j in moving:
        end, way = tree.leader(j.name)
        ratio, offset = 1.0, 0.0
        for mimic in way:
            factor, shift = _number(mimic.multiplier, 1.0, j.name, path), _number(mimic.offset, 0.0, j.name, path)
            ratio, offset = ratio * factor, offset + ratio * shift
        if not way:
            out.append(j)
            continue
        if ratio == 0.0:
            raise RobotError(message("error.joint_follows_by_nothing", where=path, name=j.name, end=end))
        size = MM if j.slides else 1.0
        ratio, offset = ratio * size / (MM if tree.by_name[end].kind == "prismatic" else 1.0), offset * size
        if end not in own and end not in leads:
            leads[end] = j.name, ratio, offset
            out.append(j)
            continue
        name, of, before = leads.get(end, (end, 1.0, 0.0))
        out.append(replace(j, leader=name, ratio=ratio / of, offset=offset - ratio / of * before))
    return [j if j.leader else replace(j, limits=_common_limits(j, out, path)) for j in out]


def _common_limits(joint: _Joint, joints: list[_Joint], path: Path) -> tuple[float, float]:
    """Limits of a joint and of those that follow it."""
    bounds = [joint.limits or ((-math.inf, math.inf) if joint.slides else (-2.0 * math.pi, 2.0 * math.pi))]
    for j in joints:
        if j.leader == joint.name and j.limits is not None:
            first, last = sorted((v - j.offset) / j.ratio for v in j.limits)
            bounds.append((first, last))
    low, high = max(b[0] for b in bounds), min(b[1] for b in bounds)
    if math.isinf(high - low):
        raise RobotError(message("error.joint_limit_is_missing", where=path, name=joint.name))
    if not low < high:
        followers = ", ".join(repr(j.name) for j in joints if j.leader == joint.name)
        raise RobotError(message("error.joint_its_limits_and", where=path, name=joint.name, followers=followers))
    return low, high


def _table(joint: _Joint, link: FloatArray, joints: list[_Joint]) -> dict[str, object]:
    """The joint as robot.toml states it."""
    theta, d, a, alpha, beta = link
    unit = "mm" if joint.slides else "deg"
    out: dict[str, object] = {"name": _name(joint.name), "type": "prismatic" if joint.slides else "revolute"}
    if joint.leader:
        leader = next(j for j in joints if j.name == joint.leader)
        theta, d = (theta, d + joint.offset) if joint.slides else (theta + joint.offset, d)
        in_file = [1.0 if j.slides else math.degrees(1.0) for j in (joint, leader)]
        out |= {"follows": _name(leader.name), "ratio": joint.ratio * in_file[0] / in_file[1]}
    elif joint.limits is not None:
        out |= {f"{key}_{unit}": v if joint.slides else math.degrees(v) for key, v in zip(("min", "max"), joint.limits, strict=True)}
    out |= {"d_mm": d, "a_mm": a}
    return out | {f"{key}_deg": math.degrees(v) for key, v in (("theta", theta), ("alpha", alpha), ("beta", beta))}


def _number(text: str | None, usual: float, joint: str, path: Path) -> float:
    try:
        value = usual if text is None or not text.strip() else float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        advice = message("robots.maybe_xacro") if "${" in str(text) else ""
        raise RobotError(message("error.joint_is_not_a", where=path, joint=joint, text=str(text)[:60], advice=advice))
    return value


def _vector(text: str | None, joint: str, path: Path) -> FloatArray:
    try:
        values = np.array([float(v) for v in (text or "0 0 0").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.isfinite(values).all() or np.abs(values).max() > 1e6:
        advice = message("robots.maybe_xacro") if "${" in str(text) else ""
        raise RobotError(message("error.joint_is_not_three", where=path, joint=joint, text=str(text)[:60], advice=advice))
    return values


def _links(axes: list[tuple[FloatArray, FloatArray]], end: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """base_from_foot (7,), links (n, 5), flange_from_tool (7,) of axes (point, direction) in the base frame, and the last frame (7,)."""
    point, along = axes[0]
    # the foot keeps the base's own origin and directions as far as the first axis lets it
    start = point - (point @ along) * along if abs(along[2]) < 1.0 - 1e-12 or np.linalg.norm(point[:2]) > 1e-9 else np.zeros(3)
    # the shortest turn of z to the axis; from -z where that is nearer, for half turns are ill determined
    over = Rotation.from_rotvec([math.pi, 0.0, 0.0]) if along[2] < -0.9 else Rotation.identity()
    x, y, z = over.apply(along, inverse=True)
    foot = frame = se3.pose(start, over * Rotation.from_quat([-y, x, 0.0, 1.0 + z]))
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
    rpy = _fixed_angles(se3.matrices(frame))
    etree.SubElement(element, "origin", xyz=" ".join(repr(float(v) / MM) for v in frame[:3]), rpy=" ".join(repr(float(v)) for v in rpy))
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)
    return element


def _fixed_angles(matrix: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a rotation (3, 3), to the last digits at a pitch of a quarter turn too: there any yaw will do."""
    yaw = math.atan2(matrix[1, 0], matrix[0, 0])
    rest = Rotation.from_rotvec([0.0, 0.0, -yaw]).as_matrix() @ matrix
    return math.atan2(-rest[1, 2], rest[1, 1]), math.atan2(-rest[2, 0], rest[0, 0]), yaw


def _place(pose: FloatArray) -> dict[str, list[float]]:
    return {"position_mm": [float(v) for v in pose[:3]], "quaternion_xyzw": [float(v) for v in pose[3:]]}


def _name(text: str) -> str:
    """A name of ours from one of theirs."""
    return "".join("_" if c.isspace() or c in ".,;" or not c.isprintable() else c for c in text)[:64] or "joint"
