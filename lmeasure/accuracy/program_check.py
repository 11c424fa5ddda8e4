"""A robot program held against the zone: what the instrument can say along it."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lmeasure.accuracy.scan import run
from lmeasure.accuracy.zone import make_plan, named_figures
from lmeasure.core import FloatArray
from lmeasure.recording import CommandedPath, Program
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.text import message

if TYPE_CHECKING:
    import xarray as xr

STEP_MM = 5.0


@dataclass(frozen=True)
class Part:
    """A pose or path of the program: points (n, 3) [mm], worst pressure angle [deg] and 95 % radius [mm] (n,) at each with the orientation
    there, distance (n,) to the nearest node outside the zone or the scanned box's face [mm], 0 where the point itself is outside."""

    name: str
    points: FloatArray
    angle_deg: FloatArray
    u95_mm: FloatArray
    to_edge_mm: FloatArray

    def line(self) -> str:
        """One line for a person."""
        edge = self.to_edge_mm.min()
        where = message("guard.inside", edge=edge) if edge > 0 else message("guard.leaves")
        return message("guard.line", name=self.name, angle=self.angle_deg.max(), u95=self.u95_mm.max(), where=where)


def guard(
    rig: Rig, calibration: CalibrationRecord | None, zone: "xr.Dataset", program: Program, *, rotation: Rotation, step_mm: float = STEP_MM
) -> list[Part]:
    """Each pose and path of the program against a scanned zone of the same rig.

    Poses and paths have the orientations the program states; a path without one is taken with `rotation`. The distance to the edge is that
    of the zone's nodes, at all the orientations it was scanned with: no finer than its grid. Raises what `scan_zone` does.
    """
    places = [
        (f"pose {p.name}", np.array([p.position_mm], dtype=np.float64), Rotation.from_quat([p.quaternion_xyzw])) for p in program.pose
    ]
    places += [(f"path {p.name}", *_along(p, rotation, step_mm)) for p in program.path]
    start = np.array(zone.attrs["zero_pose_xyz_mm_qxyzw"], dtype=np.float64)
    out = []
    for name, points, turns in places:
        plan = make_plan(rig, calibration, points, turns, start=start)
        # a scan tries every orientation at every place: where each place has its own, one scan for each
        own = plan.quaternions[:, None]
        plans = [plan] if len(own) == 1 else [replace(plan, positions=points[i : i + 1], quaternions=own[i]) for i in range(len(points))]
        found = [run(part, workers=1) for part in plans]
        both = np.hstack([f for f, _ in found]), np.hstack([flags for _, flags in found])
        figures = named_figures(*both, full=False, near=False, six=plan.six)
        out.append(Part(name, points, figures["worst_pressure_angle_deg"], figures["u95_position_mm"], _to_edge(zone, points)))
    return out


def _along(path: CommandedPath, rotation: Rotation, step_mm: float) -> tuple[FloatArray, Rotation]:
    """Points (n, 3) of a path [mm] and its orientation: one, or one for each point where the tool turns on the way."""
    points = path.points(step_mm)
    if path.end_quaternion_xyzw is None:
        return points, Rotation.from_quat([rotation.as_quat() if path.quaternion_xyzw is None else path.quaternion_xyzw])
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    turns = path.orientation(gone / gone[-1])
    assert turns is not None
    return points, turns


def _to_edge(zone: "xr.Dataset", points: FloatArray) -> FloatArray:
    axes = [zone[name].values for name in "xyz"]
    low, high = np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])
    distance = np.minimum(points - low, high - points).min(axis=1)
    inside = zone["in_zone"].values.astype(bool)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    if (~inside).any():
        distance = np.minimum(distance, cKDTree(nodes[~inside]).query(points)[0])
    nearest = cKDTree(nodes.reshape(-1, 3)).query(points)[1]
    return np.where(inside.ravel()[nearest], np.maximum(distance, 0.0), 0.0)


def guard_columns(parts: list[Part]) -> dict[str, Any]:
    """Columns of a table over all points of all parts."""
    return {
        "part": [part.name for part in parts for _ in part.points],
        **{f"{axis}_mm": np.concatenate([part.points[:, i] for part in parts]) for i, axis in enumerate("xyz")},
        "pressure_angle_deg": np.concatenate([part.angle_deg for part in parts]),
        "u95_position_mm": np.concatenate([part.u95_mm for part in parts]),
        "to_edge_mm": np.concatenate([part.to_edge_mm for part in parts]),
    }
