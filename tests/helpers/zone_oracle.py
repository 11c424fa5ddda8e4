"""Pressure angles and covariances worked out without lmeasure, from the definitions, in plain NumPy."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def cable_length(point: FloatArray, base: FloatArray, guide: FloatArray, radius: float) -> float:
    """A string laid around a disc: from the guide line at B along the rim, turning towards the point, straight once the tangent hits it."""
    d = point - base
    if radius == 0.0:
        return float(np.linalg.norm(d))
    along = d @ guide
    side = d - along * guide
    side = side / np.linalg.norm(side)
    away = np.array([along, d @ side - radius])  # from the pulley's centre, in the plane (guide, side)
    straight = np.sqrt(away @ away - radius**2)
    # the tangent point seen from the centre is turned by acos(R/|away|) back from the direction to the point
    turn = np.arctan2(away[1], away[0]) - np.arccos(radius / np.linalg.norm(away)) + np.pi / 2
    return float(radius * (turn % (2 * np.pi)) + straight)


def length_rows(position: FloatArray, rotation: FloatArray, cables: list[dict[str, FloatArray]]) -> FloatArray:
    """(6, 6) rates of the lengths by (omega; v) about the tool origin, by central differences of the lengths themselves."""
    rows = np.empty((len(cables), 6))
    step = 1e-3
    for j, cable in enumerate(cables):
        arm = rotation @ cable["P"]
        for c in range(6):
            axis = np.eye(3)[c % 3]
            shift = np.cross(axis, arm) if c < 3 else axis
            size = step / max(float(np.linalg.norm(shift)), 1e-9) if c < 3 else step
            ahead, behind = (
                cable_length(position + arm + sign * size * shift, cable["B"], cable["u"], float(cable["R"])) for sign in (1, -1)
            )
            rows[j, c] = (ahead - behind) / (2 * size)
    return rows


def pressure_angles(position: FloatArray, rotation: FloatArray, cables: list[dict[str, FloatArray]]) -> FloatArray:
    """(6,) angles [rad] between the gradient of length i at its attachment point and that point's velocity when only length i changes."""
    rows = length_rows(position, rotation, cables)
    out = np.empty(len(cables))
    for i, cable in enumerate(cables):
        twist = np.linalg.solve(rows, np.eye(6)[i])
        velocity = twist[3:] + np.cross(twist[:3], rotation @ cable["P"])
        span = rows[i, 3:]
        out[i] = np.arccos(abs(span @ velocity) / np.linalg.norm(span) / np.linalg.norm(velocity))
    return out


def sphere_radius(covariance: FloatArray, random: np.random.Generator, samples: int = 400_000) -> float:
    """Radius that holds 95 % of a Gaussian, by drawing from it."""
    draws = random.standard_normal((samples, 3)) @ np.linalg.cholesky(covariance).T
    return float(np.quantile(np.linalg.norm(draws, axis=1), 0.95))
