"""Limits that a mechanism must keep, as smooth functions of its pose that are positive inside: never singular, pressure angles, lengths.

With C_i = (c_i; d_i) the cofactors of link i's row, the motion by link i alone is C_i over the determinant, so that the velocity of its
point is (c_i + d_i x P_i)/det and the pressure-angle analogue has cos = |det| / |c_i + d_i x P_i| (thesis Rashoyan 2021, 5.1). Multiplied
out,

    side det - cos(limit) |c_i + d_i x P_i| >= 0,        side the sign of the determinant where the mechanism works,

is smooth, holds nothing infinite at singular poses, and is negative in other assemblies. For no limit angle (90 degrees) it is the
determinant itself.

Of more links, rows J with weights W, a unit of length i moves the body by the least squares of a run, N^-1 J_i w_i with N = J'WJ, and
the same holds with det N for the determinant and adj N J_i w_i for the cofactors (`docs/decisions/0034`). det N has no sign: rows of more
than six links lose their rank on curves, which part nothing, so that without a limit angle there is nothing to keep of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from lmeasure.core import BoolArray, FloatArray, StructureError, se3
from lmeasure.linkages.singularity import cofactors, link_rows, rim_mm
from lmeasure.linkages.topology import LINKS
from lmeasure.text import message

STEP = 1e-6  # of a displacement in units of the rim, for central differences


Lines = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""Function of poses (..., 7) that gives rows (..., m, 6), lengths (..., m) and places (..., m, 3) of the body's points, as
`singularity.link_rows` does.

For links of rods, rates (..., m, 3, 6) of what their ends move by twists (omega; v) take the place of points."""


class PathBounds(Protocol):
    """Limits that a path keeps, as `Bounds` has them: base (m, 3) and body (m, 3), points that size turns and shifts; names (k,) of the
    limits; values (..., k) at poses (..., 7), smooth, positive where a limit is kept, NaN where the mechanism cannot be."""

    @property
    def base(self) -> FloatArray: ...
    @property
    def body(self) -> FloatArray: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    def values(self, poses: FloatArray) -> FloatArray: ...


@dataclass(frozen=True)
class ToolLimits:
    """The limits of a body that carries a tool, at poses of the tool; tool (7,): body_from_tool, or (n, 7) of n bodies on one tool."""

    own: PathBounds
    tool: FloatArray

    @property
    def base(self) -> FloatArray:
        """(m, 3) of the base."""
        return self.own.base

    @property
    def body(self) -> FloatArray:
        """(m, 3) of the body."""
        return self.own.body

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies' limits."""
        return self.own.names * len(np.atleast_2d(self.tool))

    def values(self, poses: FloatArray) -> FloatArray:
        """(..., n k) at poses (..., 7) of the tool."""
        tools = se3.inverse(np.atleast_2d(self.tool))
        shape = (*poses.shape[:-1], *tools.shape)
        found = self.own.values(se3.compose(np.broadcast_to(poses[..., None, :], shape), np.broadcast_to(tools, shape)))
        return found.reshape(*poses.shape[:-1], -1)


@dataclass(frozen=True)
class Further:
    """Further limits: names (j,), and a function of poses (..., 7) to smooth values (..., j), positive where they are kept."""

    names: tuple[str, ...]
    values: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Bounds:
    """Six links or more from base (m, 3) to body (m, 3) and their limits.

    at: a pose (7,) of the mechanism, whose sign of the determinant is kept; limit_rad: of every pressure angle, None: only never singular;
    lengths_mm: least and greatest length of a link, or (2, m) of each; determinant: least |det| [mm^3], of rows with unit directions.
    lines: of links that are not straight from point to point, cables over pulleys; turns (k, 4): quaternions by which the body is turned at
    every place, and has to keep its limits in all of these orientations; weights (m,) of more than six lengths' squares, default all 1;
    called: the links' names, default `link 1` and so on; further: limits besides these.
    """

    base: FloatArray
    body: FloatArray
    at: FloatArray
    limit_rad: float | None = None
    lengths_mm: tuple[float, float] | FloatArray | None = None
    determinant: float = 0.0
    lines: Lines | None = None
    turns: FloatArray | None = None
    weights: FloatArray | None = None
    called: Sequence[str] | None = None
    further: Further | None = None

    def __post_init__(self) -> None:
        """StructureError where the mechanism is singular at the pose from which it starts."""
        M, _, points = self._lines(self.at)
        sound = len(self.base) >= LINKS and bool(np.isfinite(M).all())
        if sound and len(self.base) == LINKS:
            sound = abs(float(np.linalg.det(M))) > 1e-12 * float(np.linalg.norm(M, axis=1).prod())
        elif sound:
            sound = float(np.linalg.cond(self._normal(M, points)[1])) < 1e12
        if not sound:
            raise StructureError(message("error.bounds_the_links_do"))
        if len(self.base) > LINKS and (self.determinant > 0.0 or (self.limit_rad is None and self.lengths_mm is None)):
            most = f"bounds: {len(self.base)} links have no determinant and lose hold of the body on curves only"
            raise StructureError(message("error.state_a_limit_angle", where=most))

    @cached_property
    def _start(self) -> float:
        """The determinant at the pose `at`, that of N where there are more links than six."""
        M, _, points = self._lines(self.at)
        return float(np.linalg.det(M if len(self.base) == LINKS else self._normal(M, points)[1]))

    def _normal(self, M: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(..., m, 6) rows (e; arm x e) about the middle of the points, in parts of the rim, (..., 6, 6) N, and the arms."""
        arms = (points - points.mean(axis=-2, keepdims=True)) / rim_mm(self.body)
        J = np.concatenate([M[..., :3], np.cross(arms, M[..., :3])], axis=-1)
        return J, np.asarray(np.swapaxes(J, -1, -2) @ (self._weights[:, None] * J)), arms

    @property
    def _weights(self) -> FloatArray:
        return np.ones(len(self.base)) if self.weights is None else self.weights

    def _lines(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return link_rows(self.base, self.body, poses) if self.lines is None else self.lines(poses)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the limits, in the order of `values`."""
        links = self.called or [message("linkages.link", v0=i + 1) for i in range(len(self.base))]
        none = (message("linkages.singular"),) if len(links) == LINKS else ()
        angles = none if self.limit_rad is None else tuple(message("linkages.pressure_angle", name=link) for link in links)
        least = (message("linkages.determinant"),) if self.determinant > 0.0 else ()
        lengths = (
            () if self.lengths_mm is None else tuple(message(f"linkages.{way}", link=link) for way in ("short", "long") for link in links)
        )
        once = angles + least + lengths + (() if self.further is None else self.further.names)
        if self.turns is None:
            return once
        return tuple(message("linkages.orientation", name=name, v1=i + 1) for i in range(len(self.turns)) for name in once)

    def values(self, poses: FloatArray) -> FloatArray:
        """(..., k) of each limit at poses (..., 7), positive where it is kept: of angles and determinants in parts of the determinant at
        the pose `at`, of lengths in parts of the greatest. NaN where a link has no length."""
        if self.turns is None:
            return self._values(poses)
        values = self._values(_turned(poses, self.turns))
        return np.asarray(values.reshape(*values.shape[:-2], -1))

    def _values(self, poses: FloatArray) -> FloatArray:
        M, lengths, points = self._lines(poses)
        known = np.asarray(np.isfinite(M).all(axis=(-1, -2)))
        M = np.where(known[..., None, None], M, 0.0)
        det, speeds = self._moved(M, points)
        start = self._start
        whole = np.where(known, det, np.nan) / start
        kept = [whole[..., None]] if len(self.base) == LINKS else []
        if self.limit_rad is not None:
            kept = [whole[..., None] - np.cos(self.limit_rad) * speeds / abs(start)]
        if self.determinant > 0.0:
            kept.append(whole[..., None] - self.determinant / abs(start))
        if self.lengths_mm is not None:
            least, greatest = self.lengths_mm
            kept += [(lengths - least) / greatest, (greatest - lengths) / greatest]
        if self.further is not None:
            kept.append(self.further.values(poses))
        return np.concatenate(kept, axis=-1)

    def _moved(self, M: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(...,) the determinant, and (..., m) how fast each body point moves by its own link alone, times the determinant's size."""
        if len(self.base) == LINKS:
            C = cofactors(M)
            if points.ndim > C.ndim:
                twists = np.concatenate([C[..., 3:], C[..., :3]], axis=-1)
                return np.asarray(np.linalg.det(M)), np.linalg.norm((points @ twists[..., None])[..., 0], axis=-1)
            return np.asarray(np.linalg.det(M)), np.linalg.norm(C[..., :3] + np.cross(C[..., 3:], points), axis=-1)
        J, N, arms = self._normal(M, points)
        by = (J * self._weights[:, None]) @ cofactors(N)
        return np.asarray(np.linalg.det(N)), np.linalg.norm(by[..., :3] + np.cross(by[..., 3:], arms), axis=-1)

    def inside(self, poses: FloatArray) -> BoolArray:
        """(...,) whether every limit is kept at poses (..., 7)."""
        return np.asarray((self.values(poses) > 0.0).all(axis=-1))

    def with_rates(self, poses: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., k) the limits at poses (..., 7), and (..., k, q) their rates by displacements (q, 6) of the body (`core.se3.displaced`), by
        central differences."""
        step = STEP * rim_mm(self.body) / np.maximum(np.abs(directions * np.repeat([rim_mm(self.body), 1.0], 3)).max(axis=1), 1e-300)
        off, q = step[:, None] * directions, len(directions)
        beside = se3.displaced(poses[..., None, :], np.concatenate([np.zeros((1, 6)), off, -off]))
        values = np.moveaxis(self.values(beside), -2, 0)
        rates = (values[1 : 1 + q] - values[1 + q :]) / (2.0 * step.reshape(-1, *[1] * (values.ndim - 1)))
        return values[0], np.moveaxis(rates, 0, -1)


def _turned(poses: FloatArray, turns: FloatArray) -> FloatArray:
    """(..., k, 7) poses (..., 7) with their bodies turned about their origins by quaternions (k, 4), in base axes."""
    (x, y, z, w), (a, b, c, d) = turns.T, np.moveaxis(poses[..., None, 3:], -1, 0)
    turned = (w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d, w * d - x * a - y * b - z * c)
    places = np.broadcast_to(poses[..., None, :3], (*poses.shape[:-1], len(turns), 3))
    return np.concatenate([places, np.stack(turned, axis=-1)], axis=-1)
