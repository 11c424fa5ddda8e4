"""Study of a mechanism: at a pose, along its coordinates, over a grid of places, and at the poses of a table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, GeometryError, IntArray, se3
from lmeasure.kernels import radius_95
from lmeasure.linkages import mobility
from lmeasure.robots.model import joint_columns
from lmeasure.robots.parallel.dyads import KINDS as COMPLETED, completed
from lmeasure.robots.parallel.file import ParallelFile
from lmeasure.robots.parallel.legs import Leg
from lmeasure.robots.parallel.limits import RING, Checks, checked, hooke_joints, own_roots, ranges
from lmeasure.robots.parallel.model import COMPONENTS, EQUATIONS, Jacobians, Singular, nearness, singular, velocities
from lmeasure.text import message

BLOCK = 20000
"""Poses that are looked at together."""
MOST_RAD, MOST = 0.6, 0.5
"""Limits of the search for ranges: turns but that about the vertical, and shifts in parts of the reach."""
YAWS = 72
FEWEST = 4
"""Poses from which a cubic spline has speeds and accelerations."""
PLACES = 20_000_000
"""Most places of a grid: each is a byte; poses are looked at block by block, however many."""
AXES = ("rx", "ry", "rz", "x", "y", "z")
SINGULAR = {Singular.NO: "no", Singular.DRIVES: "type 1", Singular.OUTPUT: "type 2", Singular.BOTH: "type 3"}


class Workspace(NamedTuple):
    """inside (len(x), len(y), len(z)) at evenly spaced nodes; an axis with one node is no extent."""

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    inside: BoolArray

    @property
    def size(self) -> tuple[str, float]:
        """Return the nodes inside times the cell of the grid, and its name: `volume_mm3`, `area_mm2` or `length_mm`."""
        return self.size_of(self.inside)

    def size_of(self, inside: BoolArray) -> tuple[str, float]:
        """Return `size` for other nodes (len(x), len(y), len(z))."""
        steps = [float(a[1] - a[0]) for a in self[:3] if len(a) > 1]
        return SIZES[len(steps)], float(inside.sum() * np.prod(steps))


SIZES = ("places", "length_mm", "area_mm2", "volume_mm3")


@dataclass(frozen=True)
class Grid:
    """A workspace; poses: how many were looked at; yaw_free: at every turn about the vertical; ended_by: which limits ended it how often,
    of one orientation; every (len(x), len(y), len(z)): nodes inside at all orientations, None of one."""

    found: Workspace
    poses: int
    yaw_free: bool = False
    ended_by: dict[str, int] = field(default_factory=dict)
    every: BoolArray | None = None


@dataclass(frozen=True)
class Turns:
    """Orientations R = Exp(a, b, c) R0 that a workspace is looked for at: each of a, b, c over so many equal steps from -tilt_rad to
    tilt_rad, one step meaning 0; yaw_free: c at `YAWS` over a whole turn."""

    tilt_rad: float = 0.0
    steps: int = 1
    yaw_free: bool = False

    def of(self, orientation: FloatArray, components: Sequence[str]) -> FloatArray:
        """(k, 4) quaternions beside an orientation (4,); only the turns among components are taken."""
        still = np.zeros(1)
        tilts = np.linspace(-self.tilt_rad, self.tilt_rad, self.steps) if self.steps > 1 else still
        each = [tilts if name in components else still for name in COMPONENTS[:3]]
        if self.yaw_free:
            each[2] = np.asarray(2.0 * np.pi / YAWS * np.arange(YAWS))
        turns = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)
        if self.yaw_free:
            # tilts as seen from the vertical, then the turn about it
            about = Rotation.from_rotvec(turns * [0.0, 0.0, 1.0]) * Rotation.from_rotvec(turns * [1.0, 1.0, 0.0])
            return np.asarray((about * Rotation.from_quat(orientation)).as_quat())
        return np.asarray((Rotation.from_rotvec(turns) * Rotation.from_quat(orientation)).as_quat())


def described(file: ParallelFile, pose: FloatArray | None = None) -> dict[str, Any]:
    """Describe the mechanism at a pose (7,), by default home: joints, distance from a singular pose, ranges, turns of legs on Hooke joints.
    GeometryError if it cannot be there."""
    robot = file.model
    at = robot.home if pose is None else robot.nearest(pose[None])[0]
    joints = own_roots(robot, at[None])
    kept = checked(robot, file.limits, at[None])
    if np.isnan(at).any() or not kept.reached[0]:
        raise GeometryError(message("error.its_legs_do_not", where=file.name))
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
        **_rates(file, jacobians),
        "mobility": mobility_of(file),
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


CHAINS: dict[str, tuple[int, dict[int, int], int]] = {
    "strut": (2, {5: 1, 4: 1, 3: 1}, 0),
    "rod": (1, {3: 2}, 1),
    "carriage": (2, {5: 1, 3: 2}, 1),
    "crank": (2, {5: 1, 3: 2}, 1),
    "slider": (2, {5: 1, 3: 2}, 1),
    "radial": (3, {5: 3, 3: 1}, 0),
    "radial-arm": (3, {5: 3, 3: 1}, 0),
    "plane": (0, {1: 1}, 0),
    "way": (0, {}, 0),
}
"""Bodies of each kind of leg, its pairs by class, and turns of bodies about themselves."""


def mobility_of(file: ParallelFile) -> dict[str, Any]:
    """Bodies n and pairs P_i of each class of a mechanism, its freedoms by Somov and Malyshev, and those of them that only turn rods about
    themselves."""
    bodies, own, pairs = 1, 0, dict.fromkeys((5, 4, 3, 2, 1), 0)
    for leg in file.leg:
        n, of, turns = CHAINS[leg.type]
        bodies, own = bodies + n, own + turns
        for cls, count in of.items():
            pairs[cls] += count
    return {
        "bodies": bodies,
        "pairs": {f"P{cls}": count for cls, count in pairs.items()},
        "freedoms": mobility(bodies, pairs) - own,
        "rods_turn": own,
    }


def _rates(file: ParallelFile, jacobians: Jacobians) -> dict[str, Any]:
    """Return A, B and V of a pose, displacements (turn [rad]; shift of the platform's origin [mm]), drives in rad or mm; and the pose's
    change by the drives' steps."""
    V = velocities(Jacobians(jacobians.output[0], jacobians.drives[0]))
    out: dict[str, Any] = {"A": jacobians.output[0].tolist(), "B": jacobians.drives[0].tolist()}
    out["V"] = V.tolist() if np.isfinite(V).all() else None
    # anywhere within a step, and within the error of its place: both uniform
    steps = np.nan_to_num(file.drives("resolution")), np.nan_to_num(file.drives("resolution_error"))
    u = np.sqrt(steps[0] ** 2 / 12.0 + steps[1] ** 2 / 3.0)
    if u.any() and np.isfinite(V).all():
        C = (V * u**2) @ V.T
        own = C[3:, 3:]
        out["by_steps"] = {
            "u95_position_mm": float(radius_95(own[0, 0], own[1, 1], own[2, 2], own[0, 1], own[0, 2], own[1, 2])),
            "u_position_mm": np.sqrt(np.diag(own)).tolist(),
            "u_rotation_deg": np.degrees(np.sqrt(np.diag(C)[:3])).tolist(),
        }
    return out


def inside(file: ParallelFile, poses: FloatArray) -> BoolArray:
    """(N,) whether poses (N, 7) keep every limit."""
    parts = [checked(file.model, file.limits, part).all for part in np.array_split(poses, max(1, -(-len(poses) // BLOCK)))]
    return np.concatenate(parts)


def over_grid(
    file: ParallelFile,
    axes: tuple[FloatArray, FloatArray, FloatArray],
    orientation: FloatArray,
    turns: Turns = Turns(),
    *,
    progress: Callable[[float], None] = lambda share: None,
) -> Grid:
    """Return the workspace over positions at an orientation (4,) and its neighbours: positions that the platform reaches at one of them.

    A robot of fewer than six freedoms is given its commanded coordinates, and its positions are the cells that it then reaches.
    GeometryError for too many positions.
    """
    robot = file.model
    _countable(axes)
    every = turns.of(orientation, robot.commanded)
    full = len(robot.joint_names) == EQUATIONS
    requested = [a if full or name in robot.commanded else np.array([h]) for name, a, h in zip("xyz", axes, robot.home[:3], strict=True)]
    shape = [len(a) for a in requested]
    count = int(np.prod(shape))
    cells = [len(a) for a in axes]
    times = np.zeros(int(np.prod(cells)), dtype=np.int32)
    together = max(1, BLOCK // count)
    for first in range(0, len(every), together):
        group = every[first : first + together]
        met: list[IntArray] = []
        for begin in range(0, count, BLOCK):
            at = np.stack(np.unravel_index(np.arange(begin, min(begin + BLOCK, count)), shape), axis=-1)
            places = np.stack([a[at[:, i]] for i, a in enumerate(requested)], axis=-1)
            poses = np.column_stack([np.tile(places, (len(group), 1)), np.repeat(group, len(places), axis=0)])
            own, kept = _cells(file, axes, poses if full else _followed(file, poses))
            met.append(np.unique(kept // len(places) * len(times) + own))
            progress((first + len(group) * min(1.0, (begin + BLOCK) / count)) / len(every))
        # a cell counts once per orientation, for any number of poses in it
        times += np.bincount(np.unique(np.concatenate(met)) % len(times), minlength=len(times)).astype(np.int32)
    times = times.reshape(cells)
    found = Workspace(*axes, times > 0)
    if len(every) > 1:
        return Grid(found, count * len(every), turns.yaw_free, every=times == len(every))
    return Grid(found, count, ended_by=_ended_by(file, found, orientation) if full else {})


def _cells(file: ParallelFile, axes: tuple[FloatArray, ...], poses: FloatArray) -> tuple[IntArray, IntArray]:
    """(k,) flat nodes in whose cells those of poses (n, 7) lie that keep every limit, and (k,) which they are; NaN poses are none."""
    which = np.flatnonzero(~np.isnan(poses[:, 0]))
    which = which[inside(file, poses[which])] if len(which) else which
    index = np.stack([np.rint((poses[which, i] - a[0]) / _step(a)).astype(np.int64) for i, a in enumerate(axes)], axis=-1)
    within = ((index >= 0) & (index < [len(a) for a in axes])).all(axis=1)
    return np.ravel_multi_index(tuple(index[within].T), [len(a) for a in axes]), which[within]


def _step(axis: FloatArray) -> float:
    """Return the step of an axis, 1 mm with one node."""
    return float(axis[1] - axis[0]) if len(axis) > 1 else 1.0


def _followed(file: ParallelFile, requested: FloatArray) -> FloatArray:
    """(n, 7) poses of a robot of fewer freedoms with the commanded coordinates of poses (n, 7); NaN where it has none."""
    robot = file.model
    idle = [not robot.legs[i].of.drives for i in robot.owners]
    still = np.tile(robot.home_joints, (len(requested), 1))
    off = np.abs(robot.residuals(requested, still)[:, idle]).max(axis=1) > 1e-9
    if off.any():
        requested[off] = robot.nearest(requested[off])
    return requested


def over_drives(
    file: ParallelFile,
    axes: tuple[FloatArray, FloatArray, FloatArray],
    count: int,
    *,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Grid, FloatArray, FloatArray]:
    """Return the workspace by enumerating the drives (source 003, figure 7): each at so many values between its limits, and the cells that
    the platform then reaches; with it the joint values (k, n) and poses (k, 7) that keep every limit.

    GeometryError for too many positions or values.
    """
    robot = file.model
    _countable(axes)
    low, high = robot.limits
    total = count ** len(low)
    if total > PLACES:
        raise GeometryError(message("error.combinations_of_drives_at", total=total, places=PLACES))
    values = np.linspace(low, high, count)
    met = np.zeros(int(np.prod([len(a) for a in axes])), dtype=np.bool_)
    joints, poses = [np.empty((0, len(low)))], [np.empty((0, 7))]
    for begin in range(0, total, BLOCK):
        index = np.stack(np.unravel_index(np.arange(begin, min(begin + BLOCK, total)), (count,) * len(low)), axis=-1)
        own = values[index, np.arange(len(low))]
        found = robot.forward(own)
        there = ~np.isnan(found[:, 0])
        own, found = own[there], found[there]
        good = inside(file, found) if len(found) else np.zeros(0, dtype=np.bool_)
        joints.append(own[good])
        poses.append(found[good])
        met[_cells(file, axes, found[good])[0]] = True
        progress(min(1.0, (begin + BLOCK) / total))
    return Grid(Workspace(*axes, met.reshape([len(a) for a in axes])), total), np.concatenate(joints), np.concatenate(poses)


def _countable(axes: tuple[FloatArray, ...]) -> None:
    count = int(np.prod([len(a) for a in axes]))
    if count > PLACES:
        raise GeometryError(message("error.places_at_most_are", count=count, places=PLACES))


def _ended_by(file: ParallelFile, found: Workspace, orientation: FloatArray) -> dict[str, int]:
    """Return the numbers of places outside beside one inside: how many break each limit."""
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
    """Return [deg] by which legs between Hooke joints turn about themselves at a pose (7,), signed."""
    robot = file.model
    joints = hooke_joints(robot, file.limits)
    if joints is None:
        return {}
    spanned = [leg for leg in robot.legs if leg.kind not in ("plane", "way")]
    struts = [spanned[i] for i in joints.legs]
    away = np.array([se3.apply(pose, leg.point) - leg.values[:3] for leg in struts])
    e = np.zeros((len(spanned), 3))
    e[list(joints.legs)] = away / np.linalg.norm(away, axis=1, keepdims=True)
    turns = joints.turns(e, se3.matrices(pose[None])[0])
    return {leg.name: float(np.degrees(turn)) for leg, turn in zip(struts, turns, strict=True)}


def at_poses(file: ParallelFile, poses: FloatArray, time_s: FloatArray | None = None) -> dict[str, FloatArray]:
    """Columns: joint values at poses (N, 7), NaN where a leg does not reach, how near to singular, and 1 where all limits are kept; at
    rising times (N,) also speeds and accelerations of the joints, by a cubic spline, with the drives' limits.

    GeometryError for times where a leg does not reach, or fewer than four.
    """
    robot = file.model
    joints, kept = own_roots(robot, poses), checked(robot, file.limits, poses)
    joints = np.where(kept.reached[:, None], joints, np.nan)
    near = np.full(len(poses), np.nan)
    if kept.reached.any():
        near[kept.reached] = nearness(robot.jacobians(poses[kept.reached], joints[kept.reached]).output, robot.units)
    good = kept.all
    columns = joint_columns(robot, joints)
    if time_s is not None:
        if len(poses) < FEWEST or not kept.reached.all():
            raise GeometryError(message("error.speeds_need_poses_or", where=file.name, fewest=FEWEST))
        whole = np.where(robot.sliding, joints, np.unwrap(joints, axis=0))
        spline = CubicSpline(time_s, whole)
        for order, (key, end) in enumerate((("max_speed", "_s"), ("max_acceleration", "_s2")), 1):
            rates = spline(time_s, order)
            columns |= {name + end: values for name, values in joint_columns(robot, rates).items()}
            good = good & ~(np.abs(rates) > file.drives(key, end) * (1.0 + 1e-9)).any(axis=1)
    return columns | {"nearness": near, "kept": good.astype(np.float64)}


def completions(file: ParallelFile, kind: str, given: FloatArray) -> tuple[IntArray, FloatArray]:
    """(k,) rows of given (N, 7) and (k, 7) poses that the first rods of the mechanism complete of them, see `completion.KINDS`."""
    rods = [(leg.base_mm, leg.platform_mm, leg.rod_mm) for leg in file.leg if leg.type == "rod"]
    need = COMPLETED.get(kind)
    if need is None:
        raise GeometryError(message("error.is_none_of", kind=kind, kinds=", ".join(COMPLETED)))
    if len(rods) < need:
        raise GeometryError(message("error.a_is_completed_by_rods", where=file.name, kind=kind, need=need, n_rods=len(rods)))
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


ROUND = 120


@dataclass(frozen=True)
class MechanismOutline:
    """Strips (k, 3) [mm]: base: guides and the outline of fixed parts; arms: cranks and lower arms; legs; platform, closed; hinges (m, 3)
    on it, by names."""

    base: list[FloatArray]
    arms: list[FloatArray]
    legs: list[FloatArray]
    platform: FloatArray
    hinges: FloatArray
    names: list[str]


def mechanism_outline(file: ParallelFile, pose: FloatArray) -> MechanismOutline:
    """Return the drawing at a pose (7,) in the base's frame."""
    robot = file.model
    joints = np.split(own_roots(robot, pose[None])[0], np.cumsum([len(leg.of.drives) for leg in robot.legs])[:-1])
    base: list[FloatArray] = []
    arms: list[FloatArray] = []
    legs: list[FloatArray] = []
    feet = []
    for leg, q in zip(robot.legs, joints, strict=True):
        top = se3.apply(pose, leg.point)
        if leg.kind == "way":
            nodes = np.linspace(leg.low[0], leg.high[0], ROUND)
            base.append(np.asarray(leg.carried(nodes)))
        if leg.kind in ("way", "plane"):
            continue
        end = np.real(leg.equations(q[None])[0].end)[0]
        legs.append(np.array([end, top]))
        foot = _foot(leg, q)
        if foot is None:
            feet.append(end)
        else:
            arms.append(np.array([foot, end]))
        if leg.kind in RING:
            u = np.linspace(0.0, 2.0 * np.pi, ROUND)
            base.append(np.column_stack([leg.values[0] * np.cos(u), leg.values[0] * np.sin(u), np.full(ROUND, leg.values[1])]))
        if leg.kind == "slider":
            base.append(np.real(leg.equations(np.array([leg.low, leg.high]))[0].end))
        if leg.kind == "crank":
            feet.append(leg.values[:3])
    still = [leg for leg in robot.legs if leg.kind in ("strut", "rod", "crank")]
    if len(still) >= 3:
        base.append(outline(np.array(feet)))
    hinges = np.array([leg.point for leg in robot.legs])
    return MechanismOutline(base, arms, legs, se3.apply(pose, outline(hinges)), se3.apply(pose, hinges), [leg.name for leg in robot.legs])


def _foot(leg: Leg, q: FloatArray) -> FloatArray | None:
    """Return the beginning of an arm or a crank before the leg; None without one."""
    if leg.kind == "crank":
        return leg.values[:3]
    if leg.kind == "radial-arm":
        return np.asarray(np.real(leg.equations(q[None])[1].end)[0])
    return None


def outline(points: FloatArray) -> FloatArray:
    """(k, 3) the points in order round their middle, closed."""
    places = np.unique(points.round(6), axis=0)
    centred = places - places.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    order = np.argsort(np.arctan2(centred @ axes[1], centred @ axes[0]))
    return np.asarray(places[np.append(order, order[0])])
