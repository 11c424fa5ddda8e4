"""Tables of source 004 and its mechanism with the last length as recomputed; mechanisms of sources 002 and 003 as robots."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.robots import ParallelFile
from lmeasure.robots.parallel.legs import SevenLink

# table 1: X, Y, Z, psi, theta, and phi as it was begun with; table 3: phi as it was found
TABLE_1 = np.array(
    [
        [5.002, 4.005, 2.998, 6.709, 48.771, 109.357],
        [4.941, 3.950, 3.161, 6.129, 51.907, 107.786],
        [4.737, 3.746, 3.678, 7.621, 60.315, 103.811],
        [4.457, 3.555, 4.181, 11.045, 71.083, 101.072],
        [4.175, 3.486, 4.517, 14.656, 80.383, 100.432],
        [3.854, 3.497, 4.786, 18.317, 88.596, 100.600],
        [3.628, 3.570, 4.907, 19.573, 92.861, 99.771],
        [3.324, 4.006, 4.784, 14.138, 93.633, 91.446],
        [3.070, 4.522, 4.485, 8.398, 90.039, 83.861],
        [2.840, 5.011, 4.100, 4.257, 85.597, 78.948],
    ]
)
TABLE_3 = np.array([109.31628, 107.71351, 103.72216, 100.98456, 100.36138, 100.55560, 99.75441, 91.45164, 83.87869, 78.96665])
TABLE_2 = np.array(
    [
        [0.0719, 0.1017, 0.0870, 0.0360, -0.0041, 0.0017, 6.9443, 0.0010],
        [-0.0577, 1.0088, 6.0376, 5.6409, -0.0029, 3.0300, 5.8457, 0.0005],
        [8.0163, -5.0071, -1.0001, 6.0916, -1.7899, -2.658, 17.1448, 0.0016],
        [6.0091, 1.0059, 3.9998, 11.8596, 4.4247, 0.8208, 14.2324, 0.0008],
        [4.9661, 6.0074, 6.9915, 8.9407, -14.607, -2.036, 14.2527, 0.0006],
    ]
)
TABLE_4 = np.array(
    [
        [5.00192, 4.00319, 2.99812], [4.94099, 3.95164, 3.16127], [4.73656, 3.74450, 3.68020], [4.45688, 3.55451, 4.18139],
        [4.17501, 3.48542, 4.51670], [3.85521, 3.49785, 4.78396], [3.62933, 3.57108, 4.90523], [3.32300, 4.00503, 4.78555],
        [3.07022, 4.52121, 4.48532], [2.83974, 5.01125, 4.09979],
    ]
)  # fmt: skip
MINIMAX_L5 = 14.2531
"""Half of the range; 14.2527 is printed."""


def pose_of(coordinates: np.ndarray) -> np.ndarray:
    """(..., 7) poses of rows (X, Y, Z, psi, theta, phi), angles [rad]: R = Rz(psi) Rx(theta) Rz(phi)."""
    flat = np.asarray(coordinates).reshape(-1, 6)
    return se3.pose(flat[:, :3], Rotation.from_euler("ZXZ", flat[:, 3:])).reshape(*np.shape(coordinates)[:-1], 7)


def turn_of(poses: np.ndarray) -> np.ndarray:
    """(...) phi of poses (..., 7) [rad], theta in [0, pi]."""
    return np.asarray(se3.rotation(poses.reshape(-1, 7)).as_euler("ZXZ")[:, 2].reshape(poses.shape[:-1]))


def poses(phi: np.ndarray) -> np.ndarray:
    return pose_of(np.column_stack([TABLE_1[:, :3], np.radians(TABLE_1[:, 3:5]), np.radians(phi)]))


def mechanism() -> SevenLink:
    lengths = TABLE_2[:, 6].copy()
    lengths[4] = MINIMAX_L5
    return SevenLink(TABLE_2[:, :3], TABLE_2[:, 3:6], lengths)


def robot(legs: Sequence[dict[str, Any]], height: float, **top: Any) -> ParallelFile:
    """A robot on these legs with its home at a height [mm]."""
    named = [{"name": f"leg_{i + 1}", **leg} for i, leg in enumerate(legs)]
    file = {"schema": "lmeasure.robot/1", "name": "mechanism", "kind": "parallel", "home": {"position_mm": [0.0, 0.0, height]}}
    return ParallelFile.model_validate(file | {"leg": named} | top)


def rotopod(rod: float = 980.0, corner: float = 1024.0, height: float = 700.0, **top: Any) -> ParallelFile:
    """Source 002, 4.1: hinges on a triangle whose corners are cut off at 87 mm; odd rods run back, even ones on."""
    azimuth = 2.0 * np.pi / 3.0 * np.arange(3)
    corners = corner * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)])
    part = 87.0 / np.linalg.norm(corners[1] - corners[0])
    points = [c + part * (corners[k % 3] - c) for i, c in enumerate(corners) for k in (i - 1, i + 1)]
    ring = {"type": "carriage", "ring_mm": 1019.8, "rod_mm": rod, "min_deg": -400.0, "max_deg": 800.0}
    return robot([ring | {"platform_mm": p.tolist(), "elbow": 1 + i % 2} for i, p in enumerate(points)], height, **top)


def vehicle(height: float = 172.0, arms: tuple[float, float] | None = None) -> ParallelFile:
    """Source 002, 4.2 [mm]: radial chains at (1, 2) and (-1, 2), rods at (-1, -2) and (1, -2) that run straight outwards at home."""
    points = 1000.0 * np.array([[1.0, 2.0, 0.0], [-1.0, 2.0, 0.0], [-1.0, -2.0, 0.0], [1.0, -2.0, 0.0]])
    ring = {"ring_mm": 3000.0, "min_deg": -400.0, "max_deg": 800.0}
    radial = {"type": "radial", "slide_min_mm": 1.0, "slide_max_mm": 3000.0}
    if arms is not None:
        radial = {"type": "radial-arm", "lower_mm": arms[0], "upper_mm": arms[1]}
    rod = {"type": "carriage", "rod_mm": 1000.0 * float(np.hypot(np.sqrt(8.0) - 2.0, height / 1000.0))}
    kinds = (radial, radial, rod | {"elbow": 2}, rod | {"elbow": 1})
    return robot([ring | kind | {"platform_mm": p.tolist()} for kind, p in zip(kinds, points, strict=True)], height)


def crank_platform(pair: float = 100.0, height: float = 200.0, base: float = 20.0) -> ParallelFile:
    """Source 003 [mm, deg]: hinges in pairs on circles of 300 and 200 mm, cranks of 50 mm, upright at home."""
    low, high = ([120.0 * (i // 2) + side * angle for i, side in enumerate((-0.5, 0.5) * 3)] for angle in (base, pair))
    legs: list[dict[str, Any]] = []
    for i, (g, p) in enumerate(zip(np.radians(low) + np.radians(0.5 * base), np.radians(high), strict=True)):
        foot = 300.0 * np.array([np.cos(g), np.sin(g), 0.0])
        point = 200.0 * np.array([np.cos(p), np.sin(p), 0.0])
        upper = Rotation.from_rotvec([0.0, 0.0, np.radians(0.5 * base)]).apply(point) + [0.0, 0.0, height]
        end = foot + [0.0, 0.0, 50.0 * (i % 2 == 0)]
        leg = {"platform_mm": point.tolist(), "base_mm": foot.tolist(), "rod_mm": float(np.linalg.norm(upper - end))}
        crank = {"type": "crank", "azimuth_deg": 60.0 * i, "crank_mm": 50.0, "min_deg": -90.0, "max_deg": 90.0}
        legs.append(leg | (crank if i % 2 == 0 else {"type": "rod"}))
    half = np.radians(0.25 * base)
    home = {"position_mm": [0.0, 0.0, height], "quaternion_xyzw": [0.0, 0.0, np.sin(half), np.cos(half)]}
    return robot(legs, height, home=home, commanded=("rx", "ry", "z"))


def hexapod(x: float = -147.5) -> ParallelFile:
    """Thesis 5.8: six legs from the ends of one at rest, crosses a tenth of the leg from either plate, turned by thirds and mirrored.

    Upper x is printed as -0.147, and by its difference 0.312 as -0.148.
    """
    low, high = np.array([-460.0, -421.0, 0.0]), np.array([x, -490.0, 793.0])
    a, b = low + 0.1 * (high - low), high - 0.1 * (high - low)
    axis = -np.array([b[0], b[1], 0.0]) / np.hypot(b[0], b[1])
    legs = []
    for k in range(3):
        turn = Rotation.from_rotvec([0.0, 0.0, 2.0 * np.pi / 3.0 * k])
        for mirror in ([1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]):
            foot, point, cross = (turn.apply(v * mirror).tolist() for v in (a, b, axis))
            ends = {"base_mm": foot, "platform_mm": point, "base_axis": cross, "platform_axis": cross}
            legs.append({"type": "strut", "min_mm": 1.0, "max_mm": 5000.0} | ends)
    return robot(legs, 0.0)
