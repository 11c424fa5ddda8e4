"""Cables of the oracles as the kernels' rows, and a cell of six of them."""

import math

import numpy as np
import oracles
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from lmeasure.kernels import CABLE_COLUMNS, cable

FloatArray = NDArray[np.float64]

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])


def row_of(c: oracles.Cable) -> FloatArray:
    """The kernels' row of an oracle's cable, in doubles."""
    row = np.zeros(CABLE_COLUMNS)
    row[0:3] = [float(v) for v in c.base]
    a, b = float(c.alpha), float(c.beta)
    row[3:6] = [-math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b), math.sin(a)]
    row[6] = float(c.radius)
    row[7:10] = [float(v) for v in c.attachment]
    row[10:14] = float(c.tangent), float(c.axial), float(c.pitch) / c.counts_per_revolution, float(c.count_length)
    row[14:17] = a, b, c.counts_per_revolution
    return row


def straight_row(base: ArrayLike, attachment: ArrayLike) -> FloatArray:
    """The row of a straight cable from a fixed point: pulley of radius 0."""
    b, p = (tuple(np.asarray(x, dtype=np.float64).tolist()) for x in (base, attachment))
    return row_of(oracles.Cable(base=b, alpha=0.3, beta=0.2, radius=0.0, attachment=p))


def cell(seed: int = 0) -> list[oracles.Cable]:
    """Six drums around a cell of a few metres, two cables to each of three attachment points; well away from singular near HOME."""
    g = np.random.default_rng(seed)
    out = []
    for i in range(6):
        a = math.radians(60 * i + 15 + 10 * (-1) ** i)
        base = np.array([1300 * math.cos(a), 1300 * math.sin(a), 900 if i % 2 else -500]) + g.uniform(-60, 60, 3)
        p = math.radians(120 * (((i + 1) // 2) % 3) + 40)
        attachment = np.array([180 * math.cos(p), 180 * math.sin(p), g.uniform(-20, 20)])
        u = -base / np.linalg.norm(base) + g.normal(0, 0.2, 3)
        u /= np.linalg.norm(u)
        out.append(
            oracles.Cable(
                base=tuple(base.tolist()), alpha=math.asin(u[2]), beta=math.atan2(-u[0], -u[1]), radius=float(g.uniform(12, 30)),
                attachment=tuple(attachment.tolist()), tangent=float(g.uniform(150, 250)), axial=float(g.uniform(15, 35)),
                pitch=float(g.uniform(0.8, 1.6)),
            )
        )  # fmt: skip
    return out


def cell_rows(seed: int = 0) -> FloatArray:
    """(6, 17) rows of `cell`."""
    return np.array([row_of(c) for c in cell(seed)])


def turned(angles: FloatArray) -> FloatArray:
    """(n, 7) poses of a tool that turns about one axis in its place."""
    rotation = Rotation.from_rotvec(np.outer(angles, [0.0, 0.0, -1.0])) * Rotation.from_quat(HOME[3:])
    return np.column_stack([np.tile(HOME[:3], (len(angles), 1)), rotation.as_quat()])


def singular_angle(rows: FloatArray) -> float:
    """The least angle at which the tool of `turned` is in a singular pose."""
    angles = np.linspace(0.0, 2.0, 2001)
    sides = np.array([np.linalg.det(cable.span_rows(rows, pose)) for pose in turned(angles)])
    first = int(np.argmax(sides * sides[0] < 0.0))
    assert first > 0
    return float(angles[first - 1] + 1e-3 * sides[first - 1] / (sides[first - 1] - sides[first]))
