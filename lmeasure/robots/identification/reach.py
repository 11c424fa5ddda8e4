"""Reach of a robot for measurements, and the accuracy of predictions wherever its target can be."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from lmeasure.calibration import Limits, Usable
from lmeasure.core import BoolArray, FloatArray, IntArray, RobotError, se3
from lmeasure.kernels import wrap_geometry
from lmeasure.rig import Rig
from lmeasure.robots.identification.identify import Identified, predict
from lmeasure.robots.identification.unknowns import R
from lmeasure.robots.model import RobotModel, joint_columns
from lmeasure.robots.parallel import limits
from lmeasure.robots.parallel.model import EQUATIONS, Parallel, nearness
from lmeasure.robots.platform import Platform
from lmeasure.robots.serial import SerialRobot, reach_mm
from lmeasure.text import message

if TYPE_CHECKING:
    import xarray as xr

STRETCH = 1.2
"""Factor on the limits over which candidates are spread and then cut: the most informative poses lie at the limits."""
TURN_RAD = np.pi
"""Turn to both sides beyond which a joint gives no new information."""
BETWEEN = 9
"""Points of each link that are compared with the boxes."""
WRIST, CLEARANCE = 3, 0.1
"""Joints whose links may come near each other, and parts of the reach by which flange and target keep away from the others, as links alone
do not show an arm's collisions with itself."""
LEAST_PART = 0.1
"""Part of the cables' determinant at home below which a singular pose of the instrument is near."""
REGULAR = 0.3
"""`Allowed.regular` of planned poses: four chains with 0.2 mm errors of construction are lost at 1 to 5 % of poses that keep a tenth."""
ON_THE_WAY = 41
"""Points of the way from home that are looked at, home and the pose among them."""
FACTOR = 64
"""Most candidates tried for each one that is wanted."""


@dataclass(frozen=True)
class Allowed:
    """robot; instrument_from_base, tool (7,): assumed frames of its base and target; keep_out (k, 3, 2): boxes [mm, robot's base] that
    neither its links nor its target may enter; zone: of `lmeasure zone`, or a rig whose cables must be usable, None: all; regular: part of
    its home's distance from singular poses that a mechanism keeps, so that the pose also exists with errors of construction."""

    robot: RobotModel
    instrument_from_base: FloatArray
    tool: FloatArray
    keep_out: FloatArray
    zone: "xr.Dataset | Rig | None" = None
    regular: float = 0.0

    def __call__(self, joints: FloatArray) -> BoolArray:
        """(N,) whether joint values (N, n) are allowed."""
        low, high = self.robot.limits
        flange = self.robot.forward(joints)
        there = ~np.isnan(flange).any(axis=1)
        if not there.all():  # legs of lengths that no pose has
            out = np.zeros(len(joints), np.bool_)
            out[there] = self(joints[there]) if there.any() else False
            return out
        target = se3.compose(flange, self.tool)
        good = np.asarray(((joints >= low) & (joints <= high)).all(axis=1) & np.isfinite(target).all(axis=1))
        if isinstance(self.robot, Parallel):
            good &= limits.checked(self.robot, self.robot.bounds, flange).all
            good[good] = self._regular(self.robot, joints[good])
        body = self._body(joints, flange, target)
        for box in self.keep_out:
            good &= ~((body >= box[:, 0]) & (body <= box[:, 1])).all(axis=2).any(axis=1)
        good &= self._apart(joints, flange, target)
        if self.zone is None:
            return good
        seen = se3.compose(self.instrument_from_base, target)
        if isinstance(self.zone, Rig):
            cables = tuple(c for c in self.zone.cable if c.passage == 1)
            usable = Usable(self.zone, cables, Limits(), seen[0])
            return np.asarray(good & usable(seen) & self._determined(self.zone.cable_rows(cables), seen))
        return good & _in_zone(self.zone, seen)

    def _regular(self, robot: Parallel, joints: FloatArray) -> BoolArray:
        """(N,) whether the mechanism keeps away from singular poses all the way from home to joint values (N, n), all driven together."""
        if not self.regular:
            return np.ones(len(joints), np.bool_)
        part = np.linspace(0.0, 1.0, ON_THE_WAY)[:, None, None]
        drives = (robot.home_joints + part * (joints - robot.home_joints)).reshape(-1, joints.shape[1])
        poses = robot.forward(drives)
        near = np.full(len(poses), -np.inf)
        there = ~np.isnan(poses[:, 0])
        near[there] = nearness(robot.jacobians(poses[there], drives[there]).output, robot.units)
        return np.asarray((near.reshape(ON_THE_WAY, -1) >= self.regular * near[0]).all(axis=0))

    def _determined(self, cables: FloatArray, seen: FloatArray) -> BoolArray:
        """Return (N,) whether six cables determine target poses (N, 7) of a platform: on its home's side of the cables' singular poses."""
        if not isinstance(self.robot, Parallel | Platform) or len(cables) != EQUATIONS:
            return np.ones(len(seen), np.bool_)
        home = se3.compose(self.instrument_from_base, se3.compose(self.robot.home, self.tool))
        det = _determinants(cables, np.concatenate([home[None], seen]))
        return np.asarray(det[1:] > LEAST_PART * det[0] if det[0] > 0.0 else det[1:] < LEAST_PART * det[0])

    def _body(self, joints: FloatArray, flange: FloatArray, target: FloatArray) -> FloatArray:
        """(N, k, 3) points of the links, or where these are not known of the flange and the target."""
        corners = [flange[:, None, :3], target[:, None, :3]]
        if isinstance(self.robot, SerialRobot):
            corners.insert(0, self.robot.arm.axes(joints)[0])
        points = np.concatenate(corners, axis=1)
        part = np.linspace(0.0, 1.0, BETWEEN)[:, None]
        way = points[:, :-1, None] + part * (points[:, 1:] - points[:, :-1])[:, :, None]
        return np.asarray(way.reshape(len(points), -1, 3))

    def _apart(self, joints: FloatArray, flange: FloatArray, target: FloatArray) -> BoolArray:
        """(N,) whether flange and target keep away from the arm as far as three joints before the flange."""
        if not isinstance(self.robot, SerialRobot) or joints.shape[1] <= WRIST:
            return np.ones(len(joints), np.bool_)
        axes = self.robot.arm.axes(joints)[0][:, : joints.shape[1] - WRIST + 1]
        arm = np.concatenate([np.broadcast_to(self.robot.arm.foot[:3], (len(joints), 1, 3)), axes], axis=1)
        part = np.linspace(0.0, 1.0, BETWEEN)[:, None]
        way = (arm[:, :-1, None] + part * (arm[:, 1:] - arm[:, :-1])[:, :, None]).reshape(len(joints), -1, 3)
        ends = np.stack([flange[:, :3], target[:, :3]], axis=1)
        near = np.linalg.norm(ends[:, :, None] - way[:, None], axis=3).min(axis=(1, 2))
        return np.asarray(near >= CLEARANCE * reach_mm(self.robot.arm))

    def candidates(self, count: int, seed: int = 0) -> FloatArray:
        """Return (count, n) joint values spread evenly over the allowed ones; RobotError if hardly any are allowed."""
        count_joints = len(self.robot.joint_names)
        draw = scipy.stats.qmc.Sobol(count_joints, rng=np.random.default_rng(seed))
        found = np.zeros((0, count_joints))
        block = 1 << int(np.ceil(np.log2(max(count, 64))))
        for _ in range(FACTOR):
            unit = np.clip(0.5 + STRETCH * (draw.random(block) - 0.5), 0.0, 1.0)
            joints = self.spread(unit)
            found = np.concatenate([found, joints[self(joints)]])
            if len(found) >= count:
                return found[:count]
        if len(found) < max(count // 10, 10):
            raise RobotError(message("error.of_joint_values_tried", factor=FACTOR * block, n_found=len(found)))
        return found

    def spread(self, unit: FloatArray) -> FloatArray:
        """(k, n) joint values by points (N, n) of the unit cube: between the joints' limits, of mechanisms of six freedoms at poses between
        how far these go."""
        if isinstance(self.robot, Parallel) and unit.shape[1] == EQUATIONS:
            return limits.spread(self.robot, unit, most_rad=TURN_RAD)
        low, high = (np.where(self.robot.sliding, v, np.clip(v, -TURN_RAD, TURN_RAD)) for v in self.robot.limits)
        return np.asarray(low + unit * (high - low))


def _determinants(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(N,) of the Pluecker coordinates of six cables' free spans about the target at poses (N, 7); NaN where one cannot run."""
    _, tangent, attachment, _ = wrap_geometry(cables, np.ascontiguousarray(poses))
    span = attachment - tangent
    d = span / np.linalg.norm(span, axis=-1, keepdims=True)
    return np.asarray(np.linalg.det(np.concatenate([np.cross(attachment - poses[:, None, :3], d), d], axis=-1)))


def _in_zone(zone: "xr.Dataset", poses: FloatArray) -> BoolArray:
    """(N,) whether the node nearest to each place is in the zone, and the orientation among those that the zone was scanned with."""
    inside = zone["in_zone"].values.astype(bool)
    good, index = np.ones(len(poses), np.bool_), []
    for axis, name in enumerate("xyz"):
        nodes, at = zone[name].values, poses[:, axis]
        near = np.abs(nodes[None] - at[:, None]).argmin(axis=1)
        half = 0.5 * (np.diff(nodes).max() if len(nodes) > 1 else 0.0)
        good &= np.abs(nodes[near] - at) <= half + 1e-9
        index.append(near)
    good &= inside[tuple(index)]
    scanned = zone["quaternion_xyzw"].values.reshape(-1, 4)
    if len(scanned) > 1:
        apart = 2.0 * np.arccos(np.clip(np.abs(scanned @ scanned.T), 0.0, 1.0))
        step = float(np.where(apart > 1e-9, apart, np.inf).min(axis=1).max())
        away = 2.0 * np.arccos(np.clip(np.abs(poses[:, 3:] @ scanned.T), 0.0, 1.0)).min(axis=1)
        good &= away <= step
    return np.asarray(good)


SAMPLES = 4096
CELLS = 12
"""Along the longest extent of the reach."""
LEAST = 3
"""Poses of a cell from which its figures are reported."""


@dataclass(frozen=True)
class PredictionMap:
    """joints (n, k) spread evenly over the joints' ranges, places (n, 3) of the target [mm, robot's base], u95_mm (n,): radius that holds
    95 % of where it is from where it is predicted, by identification and robot without the instrument; at_measured_mm: its median at the
    poses that were measured; cells (c, 3) centres of cubes of edge_mm, of each the median and the largest u95 and how many of the poses it
    holds."""

    joints: FloatArray
    places: FloatArray
    u95_mm: FloatArray
    at_measured_mm: float
    edge_mm: float
    cells: FloatArray
    median_mm: FloatArray
    largest_mm: FloatArray
    poses: IntArray

    @property
    def quantiles_mm(self) -> tuple[float, float, float]:
        """Median, 95 % quantile and largest of u95."""
        return float(np.median(self.u95_mm)), float(np.quantile(self.u95_mm, 0.95)), float(self.u95_mm.max())

    def columns(self) -> dict[str, FloatArray | IntArray]:
        """Return the columns of workspace.csv, one row for each cell."""
        place = dict(zip(("x_mm", "y_mm", "z_mm"), self.cells.T, strict=True))
        return {**place, "u95_mm": self.median_mm, "largest_u95_mm": self.largest_mm, "poses": self.poses}


def workspace(found: Identified[R], samples: int = SAMPLES, seed: int = 0) -> PredictionMap | None:
    """The u95 over all that the robot's limits allow; None where hardly any joint values lead to a pose, or the robot's own noise is not
    determined."""
    if not found.tells_noise:
        return None
    robot, tool = found.state.robot, found.state.targets[0]
    allowed = Allowed(robot, found.state.base, tool, np.zeros((0, 3, 2)))
    joints = allowed.spread(scipy.stats.qmc.Sobol(len(robot.joint_names), rng=np.random.default_rng(seed)).random(samples))
    joints = joints[allowed(joints)]
    if len(joints) < CELLS:
        return None
    flange = robot.forward(joints)
    places = se3.apply(flange, tool[:3])
    u95 = predict(found, joints, u_position_mm=0.0).u95_mm
    own = found.rows.joints[found.kept]
    edge = float(np.ptp(places, axis=0).max()) / CELLS
    _, of, counts = np.unique(np.floor(places / edge).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    determined = np.flatnonzero(counts >= LEAST)
    parts = [np.flatnonzero(of.reshape(-1) == cell) for cell in determined]
    return PredictionMap(
        joints,
        places,
        u95,
        float(np.median(predict(found, own, u_position_mm=0.0).u95_mm)),
        edge,
        np.array([(np.floor(places[part[0]] / edge) + 0.5) * edge for part in parts]).reshape(-1, 3),
        np.array([np.median(u95[part]) for part in parts]),
        np.array([u95[part].max() for part in parts]),
        counts[determined],
    )


def worst_pose(found: Identified[R], over: PredictionMap) -> dict[str, float]:
    """Joint values by name, in degrees or mm, where the u95 is largest."""
    return {name: float(v) for name, v in joint_columns(found.nominal, over.joints[int(np.argmax(over.u95_mm))]).items()}
