"""Random cells of channels of every kind, and poses in them."""

import numpy as np
from numpy.typing import NDArray
from reference.cable import CableLength
from reference.distance import Distance
from reference.inclination import Inclination
from reference.swivel import SwivelAngle
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.kernels import CABLE_COLUMNS, COUNT_LENGTH, TURN_COUNTS
from lmeasure.rig import FACTORS, TABLE, Parameter, with_kernel_values

FloatArray = NDArray[np.float64]

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
COUNT_MM = 0.012
CODE_RAD = 2.0 * np.pi / 2**17
POINTS = 180.0 * np.column_stack([np.cos(np.radians([40.0, 160.0, 280.0])), np.sin(np.radians([40.0, 160.0, 280.0])), np.zeros(3)])


def directions(m: int) -> FloatArray:
    """(m, 3) ways from the middle to observation points all around, the upper and the lower in turn."""
    i = np.arange(m)
    turn = np.radians(360.0 / m * i + 15.0 + 10.0 * (-1.0) ** i)
    return np.column_stack([np.cos(turn), np.sin(turn), np.where(np.arange(m) % 2, 0.7, -0.4)])


def cable(g: np.random.Generator, i: int, m: int, radius: float | None = None, zeroed_at: FloatArray | None = HOME) -> CableLength:
    """The i-th of m cables around a cell of some metres to three attachment points, its numbers drawn by g."""
    base = 1300.0 * directions(m)[i] + g.uniform(-80.0, 80.0, 3)
    u = -base / np.linalg.norm(base) + g.normal(0.0, 0.2, 3)
    u /= np.linalg.norm(u)
    guide = np.degrees([np.arcsin(u[2]), np.arctan2(-u[0], -u[1])])
    pulley = g.uniform(12.0, 30.0) if radius is None else radius
    drum = g.uniform(150.0, 250.0), g.uniform(15.0, 35.0), g.uniform(0.8, 1.6)
    values = (*base, *guide, pulley, 1.0, *drum[:2], *POINTS[(i + 1) // 2 % 3] + g.uniform(-15.0, 15.0, 3), drum[2])
    own = [
        Parameter(f"{'P' if 'attachment' in p.group else 'B'}{i}.{p.key}", v, p.default_u, p.unit)
        for p, v in zip(TABLE, values, strict=True)
    ]
    zero = Parameter(f"c{i}.zero_mm", 0.0, COUNT_MM / np.sqrt(12.0))
    return CableLength(f"c{i}", (*own, zero), COUNT_MM**2 / 12.0, COUNT_MM, 6000, zeroed_at)


def swivel(of: CableLength, zero_deg: float) -> SwivelAngle:
    """The angle of a cable's pulley."""
    own = (*of.parameters[:5], *of.parameters[9:12], Parameter(f"{of.name}.swivel_deg", zero_deg, 1.0, "deg"))
    return SwivelAngle(f"s-{of.name}", own, CODE_RAD**2 / 12.0)


def inclination(g: np.random.Generator, name: str) -> Inclination:
    """An axis of the tool that leans little, and a base that is nearly level."""
    axis, up = Rotation.random(rng=g).apply([1.0, 0.2, 0.1]), np.array([0.01, -0.02, 1.0])
    own = [Parameter(f"{name}.{key}", v, 1e-3, "") for key, v in zip(("x", "y", "z", "up_x", "up_y", "up_z"), (*axis, *up), strict=True)]
    return Inclination(name, (*own, Parameter(f"{name}.zero_deg", 0.3, 1.0, "deg")), 1e-10)


def distance(g: np.random.Generator, name: str) -> Distance:
    """To a fixed point of the cell."""
    values = (*g.uniform(600.0, 1500.0, 3), *g.uniform(-150.0, 150.0, 3), 12.0)
    keys = ("x_mm", "y_mm", "z_mm", "to_x_mm", "to_y_mm", "to_z_mm", "zero_mm")
    return Distance(name, tuple(Parameter(f"{name}.{key}", v, 1.0) for key, v in zip(keys, values, strict=True)), 1e-4)


def cables(seed: int, m: int = 6, radius: float | None = None) -> list[CableLength]:
    """A cell of m cables."""
    g = np.random.default_rng(seed)
    return [cable(g, i, m, radius) for i in range(m)]


def poses(seed: int, n: int, reach_mm: float = 180.0, turn_rad: float = 0.2) -> FloatArray:
    """(n, 7) poses about the middle."""
    g = np.random.default_rng(seed)
    shift, turn = g.uniform(-reach_mm, reach_mm, (n, 3)), g.uniform(-turn_rad, turn_rad, (n, 3))
    return se3.displaced(HOME, np.column_stack([turn, shift]))


def path(n: int, reach_mm: float = 150.0, turn_rad: float = 0.15) -> FloatArray:
    """(n, 7) poses of a smooth motion from the middle, 300 a second."""
    t = np.arange(n)[:, None] / 300.0
    w = 2.0 * np.pi * np.array([0.31, 0.43, 0.37])
    shift = reach_mm * np.sin(t * w) * [1.0, -0.8, 0.6]
    return se3.displaced(HOME, np.column_stack([turn_rad * np.sin(t * w[::-1]), shift]))


def rows_of(channels: list[CableLength]) -> FloatArray:
    """(m, columns) the same cables as the kernels' rows."""
    rows = np.zeros((len(channels), CABLE_COLUMNS))
    rows[:, COUNT_LENGTH], rows[:, TURN_COUNTS] = np.array([(o.count_length_mm, o.counts_per_revolution) for o in channels]).T
    return with_kernel_values(rows, np.array([[q.value for q in o.parameters[:-1]] for o in channels]) * FACTORS)
