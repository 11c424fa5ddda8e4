"""Drives at a singular pose: the pose itself, the changes of lengths that lead out of it, and the extra drives that close it (thesis 4.2,
4.5).

**Out of a flat pose.** Rows of rank 5 have one dependence u, sum u_i row_i = 0, and one lost twist T = (omega; v). Along T the lengths
change by t^2 s_i / 2, s_i = (|a_i|^2 - (a_i . e_i)^2)/l_i + (omega x a_i) . e_i, a_i = v + omega x P_i; the second order of a further
motion is a sum of the rows and has no part along u. So u . dl = t^2 (u . s) / 2 of all changes dl that can be reached: a drive whose u_i
has the sign of u . s leads out if it lengthens and jams if it shortens; for the other sign it is the reverse.

**Extra drives.** A link is the chain of a universal joint at the base, a sliding pair, and a spherical one at the body. A twist is a sum of
the chain's unit screws; a pair with a part of a lost twist moves by it, and a drive there acts with the force screw that does no work on
the chain's other pairs. At rank n it takes 6 - n drives, whose screws bring the rows to rank 6.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from lmeasure.core import FloatArray, IntArray, StructureError, se3
from lmeasure.linkages.singularity import LOST, determinants, displacement_gradients, link_rows, rim_mm
from lmeasure.text import message

FREEDOMS = 6
LEAST_RANK = 3
STEPS = 100
NO_PART = 1e-9
CUSP = 0.05  # Of the sum of the curvature's parts: below it other assembly modes are so near that the signs hold for tiny changes only
SETS = 20  # Sets of several extra drives that are listed


@dataclass(frozen=True)
class Drive:
    """A passive pair of a link's chain that may carry an extra drive.

    link; pair: `base` or `body`; axis (3,) of its turn; rates (k,): of the pair by each lost twist with turn or shift 1; exit_rate: by the
    exit screw, NaN without one; wrench (6,) unit force screw (direction; moment) by which it acts on the body.
    """

    link: int
    pair: str
    axis: FloatArray
    rates: FloatArray
    exit_rate: float
    wrench: FloatArray


@dataclass(frozen=True)
class Closing:
    """Drives that close a singular pose; spared: links whose rows theirs replace; determinant: of the rows then."""

    drives: tuple[Drive, ...]
    spared: tuple[int, ...]
    determinant: float


def nearest_singular(base: FloatArray, body: FloatArray, pose: FloatArray) -> FloatArray:
    """(7,) the singular pose nearest to a pose (7,), a turn counted at the body's rim; the pose itself where it is singular.

    StructureError where the determinant leads to none.
    """
    unit = np.repeat([1.0 / rim_mm(body), 1.0], 3)
    x, there = np.zeros(6), pose
    for _ in range(STEPS):
        if _rank(link_rows(base, body, there)[0]) < FREEDOMS:
            return there
        K = displacement_gradients(base, body, pose, unit * x) * unit
        step = K * (K @ x - float(determinants(base, body, there))) / max(float(K @ K), 1e-300) - x
        # half a turn at most in all, so that a flat determinant throws nothing far away
        x = x + step * min(1.0, rim_mm(body) / max(float(np.linalg.norm(step)), 1e-300))
        there = se3.displaced(pose, unit * x)
    raise StructureError(message("error.singular_no_singular_pose"))


def lost_twists(base: FloatArray, body: FloatArray, pose: FloatArray) -> FloatArray:
    """(k, 6) twists (omega; v) that change no length at a pose (7,): of a unit turn, or a unit shift where there is no turn."""
    M = link_rows(base, body, pose)[0]
    Vt = np.linalg.svd(M)[2][_rank(M) :]
    twists = np.concatenate([Vt[:, 3:], Vt[:, :3]], axis=1)
    turn, shift = (np.linalg.norm(part, axis=1, keepdims=True) for part in (twists[:, :3], twists[:, 3:]))
    return np.asarray(twists / np.where(turn > 1e-9 * shift, turn, shift))


def leading_out(base: FloatArray, body: FloatArray, pose: FloatArray, rates: FloatArray | None = None) -> IntArray | None:
    """(m,) of six links at a pose (7,) of rank 5: 1 where lengthening it leads out and shortening it jams, -1 the other way round, 0 where
    first order does not decide. None of another rank, and near a cusp. rates (m, m): of the links by drives, which take
    the links' place."""
    M, lengths, points = link_rows(base, body, pose)
    if _rank(M) != FREEDOMS - 1:
        return None
    u, (twist,) = np.linalg.svd(M)[0][:, -1], lost_twists(base, body, pose)
    a, e = twist[3:] + np.cross(twist[:3], points), M[:, :3]
    parts = u * (((a**2).sum(axis=1) - (a * e).sum(axis=1) ** 2) / lengths + (np.cross(twist[:3], a) * e).sum(axis=1))
    bend = float(parts.sum())
    if abs(bend) <= CUSP * float(np.abs(parts).sum()):
        return None
    u = u if rates is None else u @ rates
    return np.where(np.abs(u) > 1e-6 * np.abs(u).max(), np.sign(u) * np.sign(bend), 0.0).astype(np.int64)


def extra_drives(
    base: FloatArray, body: FloatArray, pose: FloatArray, *, axes: FloatArray | None = None, exit_twist: FloatArray | None = None
) -> list[Closing]:
    """Return sets of passive pairs that can carry the extra drives which close a singular pose (7,) of rank 5, 4 or 3: those at the base
    first, the best first.

    axes (m, 2, 3): of the universal joint of each link; default: the axis about which the first lost twist turns the link, and that across.
    exit_twist (6,): the screw of the exit from the pose.
    """
    M, _, points = link_rows(base, body, pose)
    U, rank = np.linalg.svd(M)[0], _rank(M)
    if not LEAST_RANK <= rank < FREEDOMS:
        return []
    lost, missing = lost_twists(base, body, pose), FREEDOMS - rank
    spared = max(combinations(range(len(M)), missing), key=lambda rows: abs(float(np.linalg.det(U[np.array(rows), rank:]))))
    drives: list[Drive] = []
    for i, e in enumerate(M[:, :3]):
        pair = _across(e, lost[0], points[i]) if axes is None else np.asarray(axes[i], dtype=np.float64)
        drives += _of_chain(i, base[i], points[i], np.vstack([e, pair]), lost=lost, exit_twist=exit_twist)
    # work of each force screw on the lost twists: a set closes the pose where its work has full rank
    work = np.array([d.wrench[3:] @ lost[:, :3].T + d.wrench[:3] @ lost[:, 3:].T for d in drives]).reshape(-1, missing)
    every = np.array(list(combinations(range(len(drives)), missing)), dtype=np.int64).reshape(-1, missing)
    size = np.abs(np.linalg.det(work[every]))
    # a drive is better at the base, which does not move (thesis 4.5)
    carried = np.array([d.pair == "body" for d in drives])[every].sum(axis=1)
    order = [k for k in np.lexsort((-size, carried)) if size[k] > NO_PART * size.max()]
    out = []
    for k in order[: SETS if missing > 1 else None]:
        rows = M.copy()
        rows[list(spared)] = [drives[i].wrench for i in every[k]]
        out.append(Closing(tuple(drives[i] for i in every[k]), spared, float(np.linalg.det(rows))))
    return out


def _of_chain(
    link: int, base: FloatArray, point: FloatArray, axes: FloatArray, *, lost: FloatArray, exit_twist: FloatArray | None
) -> list[Drive]:
    """Drives of a chain whose slide and universal joint have the axes (3, 3); none where its pairs do not span all twists."""
    joints = [("base", base, axes[1]), ("base", base, axes[2]), *(("body", point, axis) for axis in np.eye(3))]
    screws = np.array([np.r_[axis, np.cross(at, axis)] for _, at, axis in joints] + [np.r_[np.zeros(3), axes[0]]])
    if np.linalg.matrix_rank(screws) < FREEDOMS:
        return []
    rates = np.linalg.solve(screws.T, lost.T)
    leaving = np.full(FREEDOMS, np.nan) if exit_twist is None else np.linalg.solve(screws.T, exit_twist)
    out = []
    for k, (pair, _, axis) in enumerate(joints):
        if np.abs(rates[k]).max() < NO_PART * np.abs(rates).max():
            continue
        # reciprocal to the other five: (moment; force) . (omega; v) = 0
        wrench = np.linalg.svd(np.delete(screws, k, axis=0))[2][5]
        force = np.linalg.norm(wrench[3:])
        wrench = wrench / (force if force > NO_PART else np.linalg.norm(wrench))
        out.append(Drive(link, pair, axis, rates[k], float(leaving[k]), np.r_[wrench[3:], wrench[:3]]))
    return out


def _across(e: FloatArray, twist: FloatArray, point: FloatArray) -> FloatArray:
    """(2, 3) directions normal to a link e and to each other: the first that about which the twist turns the link, if it does."""
    turn = np.cross(e, twist[3:] + np.cross(twist[:3], point))
    size = float(np.linalg.norm(turn))
    if size < NO_PART * (float(np.linalg.norm(point)) * float(np.linalg.norm(twist[:3])) + float(np.linalg.norm(twist[3:]))):
        return np.asarray(np.linalg.svd(e[None])[2][1:])
    axis = turn / size * (1.0 if turn[np.argmax(np.abs(turn))] > 0.0 else -1.0)
    return np.array([axis, np.cross(e, axis)])


def _rank(M: FloatArray) -> int:
    s = np.linalg.svd(M, compute_uv=False)
    return int((s > LOST * s[0]).sum())
