"""How exactly an identified robot is predicted wherever its target can be: the u95 of its places over the reach, within joint limits."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.robots.identification.identify import Identified, predict
from lmeasure.robots.identification.reach import Allowed
from lmeasure.robots.identification.unknowns import R

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
        """Of workspace.csv, one row for each cell."""
        place = dict(zip(("x_mm", "y_mm", "z_mm"), self.cells.T, strict=True))
        return {**place, "u95_mm": self.median_mm, "largest_u95_mm": self.largest_mm, "poses": self.poses}


def workspace(found: Identified[R], samples: int = SAMPLES, seed: int = 0) -> PredictionMap | None:
    """The u95 over all that the robot's limits allow; None where hardly any joint values lead to a pose, or the robot's own noise is not
    determined."""
    if not found.tells_noise:
        return None
    robot, tool = found.state.robot, found.state.targets[0]
    allowed = Allowed(robot, found.state.base, tool, np.zeros((0, 3, 2)))
    joints = allowed.spread(qmc.Sobol(len(robot.joint_names), rng=np.random.default_rng(seed)).random(samples))
    joints = joints[allowed(joints)]
    if len(joints) < CELLS:
        return None
    flange = robot.forward(joints)
    places = se3.apply(flange, np.broadcast_to(tool[:3], (len(flange), 3)))
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
    joints = over.joints[int(np.argmax(over.u95_mm))]
    robot = found.nominal
    values = np.where(robot.sliding, joints, np.degrees(joints))
    units = ["mm" if slides else "deg" for slides in robot.sliding]
    return {f"{name}_{unit}": float(v) for name, unit, v in zip(robot.joint_names, units, values, strict=True)}
