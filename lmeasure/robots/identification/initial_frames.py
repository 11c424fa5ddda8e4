"""Where a robot stands and where targets sit on its flange, from nothing: the start of every identification.

For a rotation R of the robot's base in the instrument's frame everything else is linear: R^T y = base_from_flange c + b for a measured
place y, the target's place c on the flange and b = R^T t; for a measured orientation M likewise R^T M = A X, A that of base_from_flange.
Projected onto what c, b and X cannot explain, the sum of squares is a quadratic form in the nine entries of R alone. It is minimised over
rotations from many starts at once, which costs the same whether there are ten rows or a thousand.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, RobotError, se3
from lmeasure.robots.identification.measurements import Measurements
from lmeasure.text import message

STARTS = 96
STEPS = 40
ARM_MM = 300.0
"""Length by which an error of orientation is weighed against one of place."""
LEAST_ROWS = 3
ROUNDS = 6
FAR = 6.0
"""In median deviations: rows beyond it are left out of the next round."""


@dataclass(frozen=True)
class Frames:
    """base (7,): instrument_from_base; targets (k, 7): flange_from_target, identity rotations where none was measured; stations (s, 3)
    [mm, instrument's frame]; rms_mm: of the rows that were used."""

    base: FloatArray
    targets: FloatArray
    stations: FloatArray
    rms_mm: float
    used: BoolArray


def find_frames(flange: FloatArray, rows: Measurements, seed: int = 0) -> Frames:
    """The frames that fit best with base_from_flange (N, 7) as they are; RobotError where there are too few rows to begin with."""
    if not rows.placed.any():
        return _from_lengths(flange, rows)
    used = rows.placed.copy()
    if used.sum() < LEAST_ROWS:
        raise RobotError(message("error.rows_have_a_position", used=used.sum(), least_rows=LEAST_ROWS))
    for _ in range(ROUNDS):
        base, targets = _fitted(flange[used], rows.of(np.flatnonzero(used)), seed)
        off = np.linalg.norm(_places(flange, rows, base, targets) - rows.position, axis=1)
        near = rows.placed & ~(off > FAR * np.nanmedian(off[rows.placed]) / 0.6745)
        if (near == used).all() or near.sum() < max(LEAST_ROWS, 0.5 * rows.placed.sum()):
            break
        used = near
    rms = float(np.sqrt(np.mean(off[used] ** 2)))
    return Frames(base, targets, _stations(_places(flange, rows, base, targets), rows), rms, used)


def _places(flange: FloatArray, rows: Measurements, base: FloatArray, targets: FloatArray) -> FloatArray:
    return se3.apply(base, se3.apply(flange, targets[rows.target_of, :3]))


def _fitted(flange: FloatArray, rows: Measurements, seed: int) -> tuple[FloatArray, FloatArray]:
    """base (7,) and targets (k, 7) of rows with positions."""
    n, k = len(rows), len(rows.targets)
    turn, middle = se3.matrices(flange), rows.position.mean(axis=0)
    of_target = np.eye(k)[rows.target_of]
    # unknowns besides R: where each target sits (3 k), b (3), each target's rotation column by column (9 k)
    first = np.zeros((n, 3, 12 * k + 3))
    first[:, :, : 3 * k] = np.einsum("nt,nij->nitj", of_target, turn).reshape(n, 3, 3 * k)
    first[:, :, 3 * k : 3 * k + 3] = np.eye(3)
    linear, entries, known = [first], [_transposed(rows.position - middle)], [flange[:, :3]]
    oriented = rows.oriented
    measured = se3.matrices(np.column_stack([rows.position, rows.quaternion])[oriented])
    for column in range(3 if oriented.any() else 0):
        part = np.zeros((len(measured), 3, 12 * k + 3))
        for t in range(k):
            at = 3 * k + 3 + 9 * t + 3 * column
            part[:, :, at : at + 3] = ARM_MM * of_target[oriented, t, None, None] * turn[oriented]
        linear.append(part)
        entries.append(_transposed(ARM_MM * measured[:, :, column]))
        known.append(np.zeros((len(measured), 3)))
    a, m, flat = np.concatenate(linear).reshape(-1, 12 * k + 3), np.concatenate(entries).reshape(-1, 9), np.concatenate(known).reshape(-1)
    u, size, _ = np.linalg.svd(a, full_matrices=False)
    q = u[:, size > 1e-9 * size[0]]
    left, rest = m - q @ (q.T @ m), flat - q @ (q.T @ flat)
    best = _least(left.T @ left, left.T @ rest, seed)
    solved = np.linalg.lstsq(a, m @ best.as_matrix().reshape(-1) - flat, rcond=1e-9)[0]
    targets = np.zeros((k, 7))
    targets[:, :3], targets[:, 6] = solved[: 3 * k].reshape(k, 3), 1.0
    for t in np.unique(rows.target_of[oriented]):
        own = solved[3 * k + 3 + 9 * t : 3 * k + 12 + 9 * t].reshape(3, 3).T
        targets[t, 3:] = Rotation.from_matrix(_proper(own)).as_quat()
    return se3.pose(middle + best.apply(solved[3 * k : 3 * k + 3]), best), targets


def _transposed(vectors: FloatArray) -> FloatArray:
    """(n, 3, 9) the maps from a rotation's entries, row after row, to R^T v of vectors v (n, 3)."""
    return np.asarray(np.einsum("nk,ij->nikj", vectors, np.eye(3)).reshape(-1, 3, 9))


def _proper(matrix: FloatArray) -> FloatArray:
    """The rotation nearest to a matrix (3, 3)."""
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, float(np.linalg.det(u @ v))]) @ v)


def _least(square: FloatArray, pull: FloatArray, seed: int) -> Rotation:
    """The rotation whose entries r (9,), row after row, make r . square r - 2 pull . r least, by Levenberg's steps from many starts."""
    size = max(float(np.trace(square)), 1e-300)
    square, pull = square / size, pull / size
    at = Rotation.concatenate([Rotation.create_group("O"), Rotation.random(STARTS - 24, rng=np.random.default_rng(seed))])

    def cost(rotation: Rotation) -> FloatArray:
        r = rotation.as_matrix().reshape(-1, 9)
        return np.asarray(np.einsum("si,si->s", r @ square, r) - 2.0 * r @ pull)

    now, damping = cost(at), np.full(len(at), 1e-3)
    for _ in range(STEPS):
        r = at.as_matrix()
        # Exp(w) R: the entries move by those of the skew matrix of w times R
        tangent = np.stack([(_SKEW[k] @ r).reshape(-1, 9) for k in range(3)], axis=-1)
        slope = np.einsum("sik,si->sk", tangent, r.reshape(-1, 9) @ square - pull)
        bend = np.swapaxes(tangent, 1, 2) @ square @ tangent + damping[:, None, None] * np.eye(3)
        step = np.linalg.solve(bend, -slope[..., None])[..., 0]
        tried = Rotation.from_rotvec(step) * at
        then = cost(tried)
        better = then < now
        if np.abs(step[better]).max(initial=0.0) < 1e-12:
            break
        at = Rotation.from_quat(np.where(better[:, None], tried.as_quat(), at.as_quat()))
        now, damping = np.where(better, then, now), np.where(better, 0.1 * damping, 10.0 * damping)
    return at[int(np.argmin(now))]


_SKEW = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]], dtype=np.float64
)


def _from_lengths(flange: FloatArray, rows: Measurements) -> Frames:
    """Targets and stations in the robot's own base frame, which no length can tell from another: squares of lengths are linear in c, s and
    their products, and from there by least squares."""
    targets, stations = np.zeros((len(rows.targets), 7)), np.zeros((len(rows.stations), 3))
    targets[:, 6] = 1.0
    turn, at, square = se3.matrices(flange), flange[:, :3], rows.length_mm**2
    for s in range(len(stations)):
        own = rows.ranged & (rows.station_of == s)
        of = own & (rows.target_of == np.bincount(rows.target_of[own]).argmax())
        if of.sum() < 8:
            raise RobotError(message("error.station_lengths_of_one", stations=rows.stations[s], of=of.sum()))
        p, r = at[of], turn[of]
        straight = [2.0 * np.einsum("ni,nij->nj", p, r), -2.0 * p, np.ones((len(p), 1))]
        crossed = [-2.0 * r.reshape(-1, 9)] if len(p) >= 20 else []
        a = np.concatenate([*straight, *crossed], axis=1)
        found = np.linalg.lstsq(a / np.abs(a).max(axis=0), square[of] - (p**2).sum(axis=1), rcond=1e-9)[0] / np.abs(a).max(axis=0)
        targets[rows.target_of[of][0], :3], stations[s] = found[:3], found[3:6]

    def off(x: FloatArray) -> FloatArray:
        c, s = x[: 3 * len(targets)].reshape(-1, 3), x[3 * len(targets) :].reshape(-1, 3)
        reached = at + np.einsum("nij,nj->ni", turn, c[rows.target_of])
        return np.asarray((np.linalg.norm(reached - s[rows.station_of], axis=1) - rows.length_mm)[rows.ranged])

    start = np.concatenate([targets[:, :3].reshape(-1), stations.reshape(-1)])
    best = least_squares(off, start, loss="soft_l1", f_scale=max(float(np.median(np.abs(off(start)))), 1e-3)).x
    targets[:, :3], stations = best[: 3 * len(targets)].reshape(-1, 3), best[3 * len(targets) :].reshape(-1, 3)
    base = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    return Frames(base, targets, stations, float(np.sqrt(np.mean(off(best) ** 2))), rows.ranged)


def _stations(places: FloatArray, rows: Measurements) -> FloatArray:
    """(s, 3) [mm] where stations stand whose lengths to known places (N, 3) were measured."""
    out = np.zeros((len(rows.stations), 3))
    for s in range(len(out)):
        of = rows.ranged & (rows.station_of == s)
        if of.sum() < 4:
            raise RobotError(message("error.station_lengths_at_least", stations=rows.stations[s], of=of.sum()))
        p, d = places[of], rows.length_mm[of]
        middle = p.mean(axis=0)
        a = np.column_stack([-2.0 * (p - middle), np.ones(len(p))])
        start = np.linalg.lstsq(a, d**2 - ((p - middle) ** 2).sum(axis=1), rcond=1e-9)[0][:3] + middle
        out[s] = least_squares(lambda x, p=p, d=d: np.linalg.norm(p - x, axis=1) - d, start).x
    return out
