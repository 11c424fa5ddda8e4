"""Synthesis of mechanisms of links between ball joints from poses of the body: least squares link by link, and minimax of all at once.

A link (A, B, l) misses pose i by d_i = |R_i B + o_i - A| - l. Least squares over the seven parameters of each link by itself, by
Levenberg's method: fitting spheres to the points and back in turn, as source 004 does, needs thousands of rounds in its curved valley.
Minimax binds the links together by coordinates of the poses that are left open, here the turn phi about the body's z: the largest |d_ij|
of all links j is least where a sequence of linear programs, each within a trust region, gains no more (source 004, 7 to 10; HiGHS).
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, linprog
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3

PARAMETERS = 7
ITERATIONS = 200


class Dyad(NamedTuple):
    """anchor A (3,) in the base, point B (3,) on the body, length; misses (n,) of its poses."""

    anchor: FloatArray
    point: FloatArray
    length: float
    misses: FloatArray


class Minimax(NamedTuple):
    """anchors (m, 3), points (m, 3), lengths (m,), turns (n,) [rad] about the body's z that were added to the poses, largest miss."""

    anchors: FloatArray
    points: FloatArray
    lengths: FloatArray
    turns: FloatArray
    largest: float


def misses(poses: FloatArray, anchors: FloatArray, points: FloatArray, lengths: FloatArray) -> FloatArray:
    """(n, m) d_ij of m links at poses (n, 7)."""
    ends = poses[:, None, :3] + np.einsum("kij,nj->kni", se3.matrices(poses), points)
    return np.asarray(np.linalg.norm(ends - anchors, axis=-1) - lengths)


def gradients(poses: FloatArray, anchors: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, m, 7) of the misses by (A, B, l) of each link, and (n, m) by a turn about the body's z."""
    turns = se3.matrices(poses)
    span = poses[:, None, :3] + np.einsum("kij,nj->kni", turns, points) - anchors
    e = span / np.linalg.norm(span, axis=-1, keepdims=True)
    own = np.einsum("kij,kni->knj", turns, e)
    by = np.concatenate([-e, own, -np.ones((*e.shape[:2], 1))], axis=-1)
    return by, own[..., 1] * points[:, 0] - own[..., 0] * points[:, 1]


def fitted(poses: FloatArray, anchor: FloatArray, point: FloatArray) -> Dyad:
    """The link of least squares for poses (n, 7), n >= 7, found from a start (3,), (3,); its length starts as the mean distance."""
    ends = se3.apply(poses, point)
    start = np.concatenate([anchor, point, [float(np.linalg.norm(ends - anchor, axis=1).mean())]])
    size = float(start[6])

    def of(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return x[None, :3], x[None, 3:6], x[6:]

    found = least_squares(
        lambda x: misses(poses, *of(x))[:, 0] / size,
        start,
        jac=lambda x: gradients(poses, *of(x)[:2])[0][:, 0] / size,
        method="lm",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=20000,
    ).x
    return Dyad(found[:3], found[3:6], float(found[6]), misses(poses, *of(found))[:, 0])


def all_fitted(poses: FloatArray, reach: float, starts: int, seed: int = 0) -> list[Dyad]:
    """Different links of least squares from so many random starts within reach of the poses' mean, the best first."""
    rng, middle = np.random.default_rng(seed), poses[:, :3].mean(axis=0)
    out: list[Dyad] = []
    for _ in range(starts):
        dyad = fitted(poses, middle + rng.uniform(-reach, reach, 3), rng.uniform(-reach, reach, 3))
        place = np.concatenate([dyad.anchor, dyad.point])
        if np.isfinite(place).all() and all(np.abs(place - np.concatenate(other[:2])).max() > 1e-5 * reach for other in out):
            out.append(dyad)
    return sorted(out, key=lambda d: float(np.abs(d.misses).max()))


def minimax(poses: FloatArray, anchors: FloatArray, points: FloatArray, lengths: FloatArray, *, turn_free: bool) -> Minimax:
    """Links (m, 3), (m, 3), (m,) whose largest miss of poses (n, 7) is least near a start, the poses' turns about the body's z free or not.

    One linear program per step: the least t with |d + gradient . step| <= t and |step| <= radius; the radius grows with what the
    linear model foretold well and shrinks with what it did not.
    """
    n, m = len(poses), len(anchors)
    turns = np.zeros(n)
    radius, best = 0.05 * float(np.abs(points).max()), float(np.abs(misses(poses, anchors, points, lengths)).max())
    unit = np.array([1.0] * (PARAMETERS * m) + [1.0 / max(float(np.abs(points).max()), 1e-12)] * n)
    for _ in range(ITERATIONS):
        at = turned(poses, turns)
        d = misses(at, anchors, points, lengths)
        by, by_turn = gradients(at, anchors, points)
        rows = np.zeros((n, m, PARAMETERS * m + n))
        for j in range(m):
            rows[:, j, PARAMETERS * j : PARAMETERS * (j + 1)] = by[:, j]
        rows[np.arange(n), :, PARAMETERS * m + np.arange(n)] = by_turn * turn_free
        flat, off = rows.reshape(n * m, -1) * unit, d.ravel()
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
        own = step[: PARAMETERS * m].reshape(m, PARAMETERS)
        tried = anchors + own[:, :3], points + own[:, 3:6], lengths + own[:, 6]
        new_turns = turns + step[PARAMETERS * m :] * turn_free
        value = float(np.abs(misses(turned(poses, new_turns), *tried)).max())
        determined = best - float(found.x[-1])
        if value < best:
            (anchors, points, lengths), turns = tried, new_turns
            radius *= 2.0 if best - value > 0.5 * determined else 1.0
            best = value
        else:
            radius *= 0.25
        if determined < 1e-9 * best or radius < 1e-10:
            break
    return Minimax(anchors, points, lengths, turns, best)


def turned(poses: FloatArray, turns: FloatArray) -> FloatArray:
    """Poses (n, 7) turned by turns (n,) about their own z."""
    return se3.pose(poses[:, :3], se3.rotation(poses) * Rotation.from_rotvec(np.outer(turns, [0.0, 0.0, 1.0])))
