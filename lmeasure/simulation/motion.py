"""Motions of a robot: smooth paths through waypoints, and scattered poses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FileFormatError, FloatArray, se3
from lmeasure.text import message

PEAK = 1.875  # Largest rate of the minimum-jerk profile 10 s^3 - 15 s^4 + 6 s^5 over its mean rate: at s = 1/2
MAX_SAMPLES = 50_000_000


@dataclass(frozen=True)
class Leg:
    """A straight way to a pose (7,) and a rest there. Speeds are the largest on the way, of the tool origin and of the rotation."""

    pose: FloatArray
    speed_mm_s: float = 500.0
    rotation_speed_rad_s: float = 1.0
    dwell_s: float = 0.0


def smooth_path(start: FloatArray, legs: Sequence[Leg], rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """(n,) times [s] and (n, 7) poses along the legs, from rest to rest on each, sampled at rate_hz.

    The tool origin runs straight and the rotation about a fixed axis, both by the minimum-jerk profile (Flash and Hogan 1985): position,
    velocity and acceleration are continuous. The slower of the two sets the duration. FileFormatError beyond `MAX_SAMPLES`.
    """
    edges, ways = [0.0], []
    here = np.asarray(start, dtype=np.float64)
    for leg in legs:
        turn = (se3.rotation(here).inv() * se3.rotation(leg.pose)).as_rotvec()
        shift = leg.pose[:3] - here[:3]
        moving = PEAK * max(float(np.linalg.norm(shift)) / leg.speed_mm_s, float(np.linalg.norm(turn)) / leg.rotation_speed_rad_s)
        ways.append((here, shift, turn, moving))
        edges.append(edges[-1] + moving + leg.dwell_s)
        here = np.asarray(leg.pose, dtype=np.float64)
    n = math.floor(edges[-1] * rate_hz + 1e-9) + 1
    if n > MAX_SAMPLES:
        raise FileFormatError(message("error.the_motion_takes_s", edges=edges[-1], n=n, rate_hz=rate_hz, max_samples=MAX_SAMPLES))
    time_s = np.arange(n) / rate_hz
    rows = np.tile(np.asarray(start, dtype=np.float64), (n, 1))
    of = np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, len(ways) - 1)
    for i, (origin, shift, turn, moving) in enumerate(ways):
        mine = of == i
        s = np.clip((time_s[mine] - edges[i]) / moving, 0.0, 1.0) if moving > 0 else np.ones(int(mine.sum()))
        part = (s**3 * (10.0 + s * (6.0 * s - 15.0)))[:, None]
        rows[mine] = se3.pose(origin[:3] + part * shift, se3.rotation(origin) * Rotation.from_rotvec(part * turn))
    return time_s, rows


def scattered_poses(count: int, half_mm: Sequence[float], tilt_rad: float, centre: FloatArray, *, rng: np.random.Generator) -> FloatArray:
    """(count, 7) poses, uniform over a box of half widths (3,) [mm] about the centre pose (7,), each component of the rotation vector
    uniform up to tilt_rad, in base axes."""
    shift, turn = rng.uniform(-1.0, 1.0, (count, 3)) * np.asarray(half_mm), rng.uniform(-tilt_rad, tilt_rad, (count, 3))
    return se3.displaced(centre, np.column_stack([turn, shift]))
