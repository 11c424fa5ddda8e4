"""10,000 poses from six lengths by a generic optimiser: `python make.py` writes poses.npz beside this file.

It shares nothing with the program: the cables are written in NumPy from the rig's description (a string around a disc that
swivels), and SciPy's `least_squares` (trust region, numerical Jacobian) looks for the pose in position and rotation vector,
started from the centre of the cell. The lengths carry 0.02 mm of noise, so that the answers are no round numbers.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

POSES, SEED, NOISE_MM = 10_000, 20260, 0.02


def cell(generator: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """(base (6, 3), alpha (6,), beta (6,), radius (6,), attachment (6, 3)) in mm and rad."""
    base = np.array(
        [[-754, 293, 833], [1354, -63, 412], [402, -807, 1199], [110, -1284, -478], [537, -1183, 1360], [1312, 1347, 689]], dtype=np.float64
    )
    attachment = np.array([[0, 150, 0], [0, 150, 0], [-130, -75, 10], [-130, -75, 10], [130, -75, -10], [130, -75, -10]], dtype=np.float64)
    towards = -base / np.linalg.norm(base, axis=1)[:, None] + generator.normal(0.0, 0.2, (6, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    return base, np.arcsin(towards[:, 2]), np.arctan2(-towards[:, 0], -towards[:, 1]), generator.uniform(12, 30, 6), attachment


def main() -> None:
    generator = np.random.default_rng(SEED)
    base, alpha, beta, radius, attachment = cell(generator)
    along = np.column_stack([-np.cos(alpha) * np.sin(beta), -np.cos(alpha) * np.cos(beta), np.sin(alpha)])

    def lengths(x: FloatArray) -> FloatArray:
        points = x[:3] + Rotation.from_rotvec(x[3:]).apply(attachment)
        d = points - base
        side = d - (d * along).sum(axis=1)[:, None] * along
        side /= np.linalg.norm(side, axis=1)[:, None]
        centre = base + radius[:, None] * side
        # the tangent from the point to the disc, by the right triangle of centre, tangent point and point
        c = points - centre
        distance = np.linalg.norm(c, axis=1)
        straight = np.sqrt(distance**2 - radius**2)
        to_point = np.arctan2((c * side).sum(axis=1), (c * along).sum(axis=1))
        # angle of the free span against the way of travel, which is the angle wrapped
        wrapped = (to_point + np.arcsin(radius / distance)) % (2 * np.pi)
        return np.asarray(radius * wrapped + straight)

    scale = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
    given, found = np.empty((POSES, 6)), np.empty((POSES, 6))
    for i in range(POSES):
        truth = np.concatenate([generator.uniform(-250, 250, 3), generator.uniform(-0.25, 0.25, 3)])
        given[i] = lengths(truth) + generator.normal(0.0, NOISE_MM, 6)
        solution = least_squares(lambda x, g=given[i]: lengths(x) - g, np.zeros(6), x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if not np.abs(solution.fun).max() < 1e-9:
            raise RuntimeError(f"pose {i}: residual {np.abs(solution.fun).max():.1e} mm")
        found[i] = solution.x
    np.savez_compressed(
        Path(__file__).with_name("poses.npz"), base_mm=base, alpha_rad=alpha, beta_rad=beta, radius_mm=radius, attachment_mm=attachment,
        lengths_mm=given, position_mm=found[:, :3], rotation_vector_rad=found[:, 3:],
    )  # fmt: skip


if __name__ == "__main__":
    main()
