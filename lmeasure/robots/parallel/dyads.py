"""Synthesis of mechanisms of links between ball joints from poses of the body: least squares link by link, and minimax of all at once.

A link (A, B, l) misses pose i by d_i = |R_i B + o_i - A| - l. Least squares over the seven parameters of each link by itself: fitting
spheres to the points and back in turn, as source 004 does, needs thousands of rounds in its curved valley, and so do Gauss and Newton's
steps. With the second derivatives D'(1 - e e')D / |R B + o - A|, D = (-1, R), Newton's steps take some thirty, of all starts together.
Minimax binds the links together by coordinates of the poses that are left open (`OPEN`): the largest |d_ij| of all links j is least where
a sequence of linear programs, each within a trust region, gains no more (source 004, 7 to 10; HiGHS).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from lmeasure.core import FloatArray, se3

PARAMETERS = 7
ITERATIONS = 200
NEWTON = 500
SETTLED = 1e-14
"""Of the sum of squares: a start whose next step promises to gain less has arrived."""
EXACT = 1e-11
"""Of the farthest point: links that miss every pose by less take all of them exactly."""
OPEN: dict[str, tuple[int, ...]] = {
    "point on a line": (2,),
    "line in a plane": (3,),
    "line": (2, 5),
    "point": (0, 1, 2),
    "plane": (2, 3, 4),
}
"""Coordinates that each kind of table 5 leaves open: of a displacement (turn; shift) in the body's axes."""


def _silent(share: float) -> None:
    pass


class Dyad(NamedTuple):
    """anchor A (3,) in the base, point B (3,) on the body, length; misses (n,) of its poses."""

    anchor: FloatArray
    point: FloatArray
    length: float
    misses: FloatArray


class Minimax(NamedTuple):
    """anchors (m, 3), points (m, 3), lengths (m,), poses (n, 7) with their open coordinates determined, largest miss."""

    anchors: FloatArray
    points: FloatArray
    lengths: FloatArray
    poses: FloatArray
    largest: float


def misses(poses: FloatArray, anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """(n, m) d_ij of m links at poses (n, 7)."""
    ends = poses[:, None, :3] + np.einsum("kij,nj->kni", se3.matrices(poses), points)
    return np.asarray(np.linalg.norm(ends - anchors, axis=-1) - lengths)


def gradients(poses: FloatArray, anchors: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, m, 7) of the misses by (A, B, l) of each link, and (n, m, 6) by displacements (turn; shift) in the body's axes."""
    turns = se3.matrices(poses)
    span = poses[:, None, :3] + np.einsum("kij,nj->kni", turns, points) - anchors
    e = span / np.linalg.norm(span, axis=-1, keepdims=True)
    own = np.einsum("kij,kni->knj", turns, e)
    return np.concatenate([-e, own, -np.ones((*e.shape[:2], 1))], axis=-1), np.concatenate([np.cross(points, own), own], axis=-1)


def fitted(poses: FloatArray, starts: FloatArray, progress: Callable[[float], None] = _silent) -> FloatArray:
    """Links (s, 7) of least squares for poses (n, 7), n >= 7, each found from a start (s, 6) of its anchor and point; its length starts as
    the mean distance.

    Newton's steps, damped by a part of the identity that falls with each step that gains and rises with each that does not.
    """
    turns = se3.matrices(poses)
    D = np.concatenate([np.broadcast_to(-np.eye(3), turns.shape), turns], axis=-1)

    def spans(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        span = poses[:, :3] + np.einsum("nij,sj->sni", D, x[:, :6])
        return span, np.linalg.norm(span, axis=-1)

    x = np.column_stack([starts, spans(starts)[1].mean(axis=1)])
    size = np.maximum(x[:, 6], 1e-300)
    cost = ((spans(x)[1] - x[:, 6:]) ** 2).sum(axis=1)
    damping, going = np.full(len(x), 1e-2), np.ones(len(x), dtype=np.bool_)
    for k in range(NEWTON):
        at = np.flatnonzero(going)
        progress(max(k / NEWTON, 1.0 - len(at) / len(x)))
        if not len(at):
            break
        span, far = spans(x[at])
        d, e = far - x[at, 6:], span / far[..., None]
        along = np.einsum("nij,sni->snj", D, e)
        J = np.concatenate([along, -np.ones((*d.shape, 1))], axis=-1)
        weight = d / far
        H = np.einsum("sni,snj->sij", J, J)
        H[:, :6, :6] += np.einsum("sn,nki,nkj->sij", weight, D, D, optimize=True) - np.einsum("sn,sni,snj->sij", weight, along, along)
        values, vectors = np.linalg.eigh(H)
        slope = np.einsum("sij,sni,sn->sj", vectors, J, d, optimize=True)
        newton = slope / (np.abs(values) + damping[at, None])
        step = -np.einsum("sij,sj->si", vectors, newton)
        tried = x[at] + step
        now = ((spans(tried)[1] - tried[:, 6:]) ** 2).sum(axis=1)
        gains = now < cost[at]
        little = (slope * newton).sum(axis=1) <= SETTLED * cost[at] + (1e-15 * size[at]) ** 2
        going[at] = ~little & (damping[at] < 1e8) & np.isfinite(cost[at])
        x[at[gains]], cost[at[gains]] = tried[gains], now[gains]
        damping[at] = np.where(gains, 0.2 * damping[at], 10.0 * damping[at])
    return x


def all_fitted(poses: FloatArray, reach: float, starts: int, seed: int = 0, *, progress: Callable[[float], None] = _silent) -> list[Dyad]:
    """Different links of least squares from so many random starts within reach of the poses' mean, the best first."""
    rng, middle = np.random.default_rng(seed), poses[:, :3].mean(axis=0)
    begun = rng.uniform(-reach, reach, (starts, 6)) + np.r_[middle, np.zeros(3)]
    out: list[Dyad] = []
    found = fitted(poses, begun, progress)
    for x in found[np.isfinite(found).all(axis=1)]:
        if all(np.abs(x[:6] - np.concatenate(other[:2])).max() > 1e-5 * reach for other in out):
            out.append(Dyad(x[:3], x[3:6], float(x[6]), misses(poses, x[None, :3], x[None, 3:6], x[6:])[:, 0]))
    return sorted(out, key=lambda d: float(np.abs(d.misses).max()))


def minimax(
    poses: FloatArray, links: tuple[FloatArray, FloatArray, FloatArray], free: str = "", progress: Callable[[float], None] = _silent
) -> Minimax:
    """Links (m, 3), (m, 3), (m,) whose largest miss of poses (n, 7) is least near a start; free: a kind of `OPEN` whose coordinates of each
    pose are open, empty for none.

    One linear program per step: the least t with |d + gradient . step| <= t and |step| <= radius; the radius grows with what the
    linear model foretold well and shrinks with what it did not.
    """
    anchors, points, lengths = links
    n, m, open_ = len(poses), len(anchors), list(OPEN[free]) if free else []
    q, own_count = len(open_), PARAMETERS * m
    arm = max(float(np.abs(points).max()), 1e-12)
    radius, best = 0.05 * arm, float(np.abs(misses(poses, anchors, points, lengths)).max())
    unit = np.array([1.0] * own_count + [1.0 / arm if i < 3 else 1.0 for i in open_] * n)
    for k in range(ITERATIONS):
        progress(k / ITERATIONS)
        by, by_pose = gradients(poses, anchors, points)
        rows = np.zeros((n, m, own_count + n * q))
        for j in range(m):
            rows[:, j, PARAMETERS * j : PARAMETERS * (j + 1)] = by[:, j]
        for i in range(n):
            rows[i, :, own_count + q * i : own_count + q * (i + 1)] = by_pose[i][:, open_]
        flat, off = rows.reshape(n * m, -1) * unit, misses(poses, anchors, points, lengths).ravel()
        a = np.block([[flat, -np.ones((n * m, 1))], [-flat, -np.ones((n * m, 1))]])
        found = linprog(
            np.r_[np.zeros(flat.shape[1]), 1.0],
            A_ub=a,
            b_ub=np.r_[-off, off],
            bounds=[(-radius, radius)] * flat.shape[1] + [(0.0, None)],
            method="highs",
        )
        if not found.success:
            break
        step = unit * found.x[:-1]
        own = step[:own_count].reshape(m, PARAMETERS)
        tried = anchors + own[:, :3], points + own[:, 3:6], lengths + own[:, 6]
        moved = np.zeros((n, 6))
        moved[:, open_] = step[own_count:].reshape(n, q)
        there = se3.compose(poses, se3.exp(moved)) if q else poses
        value = float(np.abs(misses(there, *tried)).max())
        determined = best - float(found.x[-1])
        if value < best:
            (anchors, points, lengths), poses = tried, there
            radius *= 2.0 if best - value > 0.5 * determined else 1.0
            best = value
        else:
            radius *= 0.25
        if determined < 1e-9 * best or radius < 1e-10 or best < EXACT * arm:
            break
    return Minimax(anchors, points, lengths, poses, best)
