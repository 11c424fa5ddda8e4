"""What a mechanism is and does: at a pose, along its coordinates, over a grid of places, and at the poses of a table."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, GeometryError, IntArray, se3
from lmeasure.robots.model import joint_columns
from lmeasure.robots.parallel.completion import KINDS as COMPLETED, completed
from lmeasure.robots.parallel.file import ParallelFile, Strut
from lmeasure.robots.parallel.jacobians import Singular, nearness, singular
from lmeasure.robots.parallel.limits import Checks, checked, own_roots, ranges
from lmeasure.robots.parallel.model import COMPONENTS, EQUATIONS

BLOCK = 20000
"""Poses that are looked at together."""
MOST_RAD, MOST = 0.6, 0.5
"""How far ranges are looked for: turns but that about the vertical, and shifts in parts of the reach."""
YAWS = 72
NODES = 2_000_000
AXES = ("rx", "ry", "rz", "x", "y", "z")
SINGULAR = {Singular.NO: "no", Singular.DRIVES: "type 1", Singular.OUTPUT: "type 2", Singular.BOTH: "type 3"}


class Workspace(NamedTuple):
    """inside (len(x), len(y), len(z)) at evenly spaced nodes, at least two each way."""

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    inside: BoolArray

    @property
    def volume_mm3(self) -> float:
        """Nodes inside times the cell of the grid."""
        return float(self.inside.sum() * np.prod([a[1] - a[0] for a in self[:3]]))


@dataclass(frozen=True)
class Grid:
    """A workspace, over which nodes it was looked for at every turn about the vertical, and which limits ended it how often."""

    found: Workspace
    yaw_free: bool
    ended_by: dict[str, int]


def described(file: ParallelFile, pose: FloatArray | None = None) -> dict[str, Any]:
    """What the mechanism is, and what it does at a pose (7,), by default home: joints, how near a singular pose, ranges, turns of legs on
    Hooke joints. GeometryError where it cannot be there."""
    robot = file.model
    at = robot.home if pose is None else robot.nearest(pose[None])[0]
    joints = own_roots(robot, at[None])
    kept = checked(robot, file.limits, at[None])
    if np.isnan(at).any() or not kept.reached[0]:
        raise GeometryError(f"{file.name}: its legs do not reach this pose")
    jacobians = robot.jacobians(at[None], joints)
    kind = Singular(int(singular(jacobians, robot.units)[0])) if len(joints[0]) == EQUATIONS else Singular.NO
    out: dict[str, Any] = {
        "name": file.name,
        "legs": {leg.name: leg.type for leg in file.leg},
        "freedoms": len(robot.joint_names),
        "parameters": len(robot.parameters),
        "position_mm": at[:3].tolist(),
        "quaternion_xyzw": at[3:].tolist(),
        "joints": {name: float(v) for name, v in joint_columns(robot, joints[0]).items()},
        "joint_limits": {name: ends.tolist() for name, ends in joint_columns(robot, np.array(robot.limits)).items()},
        "singular": SINGULAR[kind],
        "nearness": float(nearness(jacobians.output, robot.units)[0]),
        "limits_kept": {name: bool(getattr(kept, name)[0]) for name in Checks.__dataclass_fields__},
    }
    if len(joints[0]) == EQUATIONS:
        far = max(float(np.linalg.norm(at[:3])), robot.size_mm)
        most = np.array([MOST_RAD, MOST_RAD, np.pi, *(MOST * far,) * 3])
        reach = ranges(lambda poses: inside(file, poses), at, most)
        scale = np.repeat([np.degrees(1.0), 1.0], 3)[:, None]
        out["ranges"] = dict(zip(AXES, (reach * scale).tolist(), strict=True))
    else:
        out["commanded"] = list(robot.commanded)
    turns = leg_turns(file, at)
    if turns:
        out["leg_turns_deg"] = turns
    return out


def inside(file: ParallelFile, poses: FloatArray) -> BoolArray:
    """(N,) whether poses (N, 7) keep every limit."""
    parts = [checked(file.model, file.limits, part).all for part in np.array_split(poses, max(1, -(-len(poses) // BLOCK)))]
    return np.concatenate(parts)


def over_grid(file: ParallelFile, axes: tuple[FloatArray, FloatArray, FloatArray], orientation: FloatArray, *, yaw_free: bool) -> Grid:
    """The workspace over places at an orientation (4,), or at any turn of it about the base's vertical; GeometryError for too many."""
    count = int(np.prod([len(a) for a in axes]))
    if count * (YAWS if yaw_free else 1) > NODES:
        raise GeometryError(f"{count} places{f' at {YAWS} turns each' if yaw_free else ''}: at most {NODES} poses are looked at")
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    every = np.zeros(count, dtype=np.bool_)
    yaws = 2.0 * np.pi / YAWS * np.arange(YAWS) if yaw_free else np.zeros(1)
    for yaw in yaws:
        turn = (Rotation.from_rotvec([0.0, 0.0, yaw]) * Rotation.from_quat(orientation)).as_quat()
        every |= inside(file, np.concatenate([places, np.broadcast_to(turn, (count, 4))], axis=1))
    found = Workspace(*axes, every.reshape([len(a) for a in axes]))
    return Grid(found, yaw_free, {} if yaw_free else _ended_by(file, found, orientation))


def _ended_by(file: ParallelFile, found: Workspace, orientation: FloatArray) -> dict[str, int]:
    """Of places outside beside one inside: how many break each limit."""
    inner = np.pad(found.inside, 1)
    beside = np.zeros_like(found.inside)
    for axis in range(3):
        for shift in (-1, 1):
            beside |= np.roll(inner, shift, axis)[1:-1, 1:-1, 1:-1]
    at = np.argwhere(beside & ~found.inside)
    if not len(at):
        return {}
    places = np.column_stack([axis[at[:, i]] for i, axis in enumerate(found[:3])])
    poses = np.column_stack([places, np.tile(orientation, (len(places), 1))])
    kept = checked(file.model, file.limits, poses)
    counts = {name: int((~getattr(kept, name)).sum()) for name in Checks.__dataclass_fields__}
    return {name: n for name, n in counts.items() if n}


def leg_turns(file: ParallelFile, pose: FloatArray) -> dict[str, float]:
    """[deg] by which legs between Hooke joints turn about themselves at a pose (7,), signed, against where both crosses are parallel:
    atan2(e . (e x h) x (e x k), (e x h) . (e x k)) of the leg's direction e and the crosses' fixed axes h, k (thesis 5.8)."""
    out = {}
    for leg in file.leg:
        if isinstance(leg, Strut) and leg.base_axis is not None and leg.platform_axis is not None:
            away = se3.apply(pose, np.array(leg.platform_mm)) - np.array(leg.base_mm)
            e = away / np.linalg.norm(away)
            low, high = np.cross(e, leg.base_axis), np.cross(e, se3.matrices(pose) @ np.array(leg.platform_axis))
            out[leg.name] = float(np.degrees(np.arctan2(e @ np.cross(low, high), low @ high)))
    return out


def at_poses(file: ParallelFile, poses: FloatArray) -> dict[str, FloatArray]:
    """Columns: joint values at poses (N, 7), NaN where a leg does not reach, how near to singular, and 1 where all limits are kept."""
    robot = file.model
    joints, kept = own_roots(robot, poses), checked(robot, file.limits, poses)
    joints = np.where(kept.reached[:, None], joints, np.nan)
    near = np.full(len(poses), np.nan)
    if kept.reached.any():
        near[kept.reached] = nearness(robot.jacobians(poses[kept.reached], joints[kept.reached]).output, robot.units)
    return joint_columns(robot, joints) | {"nearness": near, "kept": kept.all.astype(np.float64)}


def completions(file: ParallelFile, kind: str, given: FloatArray) -> tuple[IntArray, FloatArray]:
    """(k,) rows of given (N, 7) and (k, 7) poses that the first rods of the mechanism complete of them, see `completion.KINDS`."""
    rods = [(leg.base_mm, leg.platform_mm, leg.rod_mm) for leg in file.leg if leg.type == "rod"]
    need = COMPLETED.get(kind)
    if need is None:
        raise GeometryError(f"{kind!r} is none of {', '.join(COMPLETED)}")
    if len(rods) < need:
        raise GeometryError(f"{file.name}: a {kind} is completed by {need} rods; it has {len(rods)}")
    anchors, points, lengths = (np.array(part) for part in zip(*rods[:need], strict=True))
    found = [completed(kind, pose, anchors, points, lengths=lengths) for pose in given]
    rows = np.repeat(np.arange(len(given)), [len(poses) for poses in found])
    return rows, np.concatenate([np.empty((0, 7)), *found])


def motion(file: ParallelFile, samples: int = 60) -> tuple[FloatArray, FloatArray]:
    """(k, 7) poses and (k, n) joint values of a motion from home along each of its coordinates, there and back, as far as it goes."""
    robot = file.model
    swing = np.sin(np.linspace(0.0, 2.0 * np.pi, samples))
    poses = []
    for i, name in enumerate(COMPONENTS):
        if name not in robot.commanded:
            continue
        for part in (1.0, 0.7, 0.4, 0.2, 0.1):
            delta = np.zeros((samples, 6))
            delta[:, i] = part * swing * (np.pi / 6.0 if i == 2 else 0.2 * robot.size_mm * (robot.units[i] if i < 3 else 1.0))
            way = robot.nearest(se3.displaced(np.tile(robot.home, (samples, 1)), delta))
            there = ~np.isnan(way[:, 0])
            if there.all() and checked(robot, file.limits, way).reached.all():
                poses.append(way)
                break
    every = np.concatenate([robot.home[None], *poses])
    return every, own_roots(robot, every)
