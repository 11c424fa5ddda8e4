"""A simulated cell: six drums around a robot, placed so that all of its work space is well measured."""

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.rig import Cable, Drum, ObservationPoint, Rig

# Found by a random search over places outside a 1400 mm cube: over a 600 mm cube and tilts up to 0.3 rad the worst pressure angle of six
# straight cables is 35 degrees.
PLACES_MM = (
    (861.4, 3.2, 2022.2),
    (-1107.0, 156.7, 668.8),
    (-1011.1, 1935.5, -220.7),
    (-242.4, 356.2, 2154.2),
    (-332.4, -773.5, 2031.2),
    (-1139.0, -1565.1, -591.6),
)
TOOL_RADIUS_MM = 150.0
TOOL_AZIMUTH_DEG = (90.0, 210.0, 330.0)
WORK_SPACE_MM = 300.0
"""Half the edge of the cube about the origin that the cell measures."""
WORK_TILT_RAD = 0.3

# Planned (`calibration.plan.pose_choice`) for the cell of seed 0: 20 poses in its work space, known to 0.02 mm and
# 0.003 degrees: x, y, z and
# rotation vector, mm and rad. They leave half of the uncertainty of the lengths that as many scattered poses leave.
REFERENCE_POSES = (
    (-67.0, 81.8, 119.4, 0.300, -0.297, 0.300),
    (300.0, 168.9, -300.0, 0.300, 0.102, 0.300),
    (300.0, -300.0, -300.0, 0.300, 0.300, -0.300),
    (-300.0, 300.0, 300.0, -0.300, 0.300, 0.300),
    (-300.0, -300.0, -300.0, 0.300, -0.300, 0.300),
    (-300.0, 300.0, -300.0, -0.300, 0.300, 0.300),
    (300.0, -300.0, 300.0, 0.042, -0.300, 0.300),
    (300.0, 300.0, 300.0, -0.300, 0.300, 0.300),
    (-300.0, -300.0, 300.0, -0.300, -0.150, -0.300),
    (300.0, 300.0, -300.0, 0.300, -0.300, -0.300),
    (-21.6, 0.0, 11.4, 0.300, 0.150, -0.300),
    (-294.9, -300.0, -233.1, -0.300, 0.005, -0.300),
    (20.7, -23.1, 0.0, -0.300, 0.300, 0.300),
    (-300.0, 300.0, -166.2, 0.150, 0.300, 0.300),
    (-300.0, 30.2, 300.0, -0.300, -0.300, -0.300),
    (-28.4, 300.0, 252.3, 0.300, -0.300, 0.000),
    (-300.0, -300.0, 300.0, 0.300, 0.300, 0.150),
    (300.0, 300.0, 300.0, -0.186, 0.300, -0.300),
    (300.0, -300.0, -300.0, 0.300, -0.300, -0.300),
    (55.4, -300.0, 236.2, -0.300, -0.300, 0.300),
)


def reference_poses() -> FloatArray:
    """(20, 7) poses about the origin at which the cell is calibrated."""
    rows = np.array(REFERENCE_POSES)
    return se3.pose(rows[:, :3], Rotation.from_rotvec(rows[:, 3:]))


def cell_rig(seed: int = 0) -> Rig:
    """A rig of six drums, two cables to each of three points of the tool, as no two are built: mounting and drums vary with the seed.

    Its cables cover the cube of `WORK_SPACE_MM` about the origin with rotations up to `WORK_TILT_RAD`.
    """
    rng = np.random.default_rng(seed)
    points = tuple(_observation_point(f"B{i}", place, rng) for i, place in enumerate(PLACES_MM, 1))
    tool = {
        f"P{i}": (TOOL_RADIUS_MM * math.cos(math.radians(a)), TOOL_RADIUS_MM * math.sin(math.radians(a)), 0.0)
        for i, a in enumerate(TOOL_AZIMUTH_DEG, 1)
    }
    ends = [(i, f"B{i}", f"P{(i + 1) // 2}") for i in range(1, len(points) + 1)]
    cables = tuple(Cable(name=f"c{i}", channel=f"ch{i}", from_point=first, to_point=last) for i, first, last in ends)
    return Rig(name=f"simulated cell {seed}", unstated="exact", observation_point=points, tool=tool, cable=cables)


def _observation_point(name: str, place: tuple[float, float, float], rng: np.random.Generator) -> ObservationPoint:
    """Mounted within 20 mm of its place, its drum outside and below, so that the cable comes up and over the pulley."""
    x, y, z = place + rng.uniform(-20.0, 20.0, 3)
    guide: dict[str, Any] = {
        "guide_alpha_deg": rng.uniform(45.0, 60.0),
        "guide_beta_deg": math.degrees(math.atan2(x, y)) + rng.uniform(-5.0, 5.0),
    }
    radius, pitch, tangent, axial = (rng.uniform(*within) for within in ((12.0, 30.0), (0.8, 1.6), (130.0, 240.0), (20.0, 30.0)))
    geometry: dict[str, Any] = {"groove_pitch_mm": pitch, "tangent_length_mm": tangent, "axial_offset_mm": axial}
    drum = Drum(counts_per_revolution=6000, count_length_mm=0.012, **geometry)
    return ObservationPoint(name=name, position_mm=(x, y, z), **guide, pulley_radius_mm=radius, drum=drum)
