"""Unknowns of an identification, and the dependence of the measurements on them: residuals, their derivatives, priors and names.

The unknowns x are changes from a start: of the robot's freed parameters (rad, mm, from their nominal values), of the base's pose in the
instrument's frame, of every target's position, and pose if measured, on the flange, and of every station's position. Turns are rotation
vectors applied from the left, about the axes of the frame that the pose leads to. Behind them are the variables of the instrument's common
errors, of unit variance: their effect on the robot is then in the covariance, complete and with its sign.

For a rotation R of the robot's base in the instrument's frame everything else is linear: R^T y = base_from_flange c + b for a measured
place y, the target's place c on the flange and b = R^T t; for a measured orientation M likewise R^T M = A X, A that of base_from_flange.
Projected onto the space that c, b and X cannot explain, the sum of squares is a quadratic form in the nine entries of R alone. It is
minimised over rotations from many starts at once, which costs the same for ten rows or a thousand.
"""

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, IntArray, RobotError, se3
from lmeasure.robots.identification.measurements import COMPONENTS, LENGTH, POSITION, ROTATION, Measurements
from lmeasure.robots.model import Parameter, RobotModel
from lmeasure.text import message

STARTS = 96
STEPS = 40
ARM_MM = 300.0
"""Lever arm that compares an error of orientation with one of position."""
LEAST_ROWS = 3
ROUNDS = 6
FAR = 6.0
"""Median deviations beyond which rows are omitted in the next round."""


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
    """Return targets and stations in the robot's own base frame, which no length can distinguish from another: squares of lengths are
    linear in c, s and their products, and the start of least squares."""
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
    """Return (s, 3) [mm] positions of stations from lengths to known positions (N, 3)."""
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


R = TypeVar("R", bound=RobotModel)
WIDE_MM, WIDE_RAD = 1e5, 1e2
"""Prior of unknown frames: too wide to move anything, and enough to leave no equation singular."""
NO_POSE = 1e100
"""Residual of a robot that has no pose at some of the joint values: worse than any that has."""
_AXES = ("x_mm", "y_mm", "z_mm")
_TURNS = ("rx_deg", "ry_deg", "rz_deg")


@dataclass(frozen=True)
class State(Generic[R]):
    """Values of all unknowns: the robot, base (7,) instrument_from_base, targets (k, 7) flange_from_target, stations (s, 3)."""

    robot: R
    base: FloatArray
    targets: FloatArray
    stations: FloatArray

    def predicted(self, rows: Measurements) -> FloatArray:
        """(N, 7) instrument_from_target at the rows' joint values."""
        flange = self.robot.forward(rows.joints, rows.side)
        return se3.compose(se3.compose(self.base, flange), self.targets[rows.target_of])


class Unknowns(Generic[R]):
    """The unknowns of the measurements `rows` of a robot with its nominal values, from frames that a start has found."""

    def __init__(self, robot: R, freed: IntArray, frames: Frames, rows: Measurements, *, widths: FloatArray | None = None) -> None:
        """widths (all parameters,): prior standard uncertainties in the units of the names, by default the parameters' own."""
        self.start = State(robot, frames.base, frames.targets, frames.stations)
        self.freed = freed
        self.rows = rows
        every = robot.parameters
        if widths is not None:
            every = tuple(replace(p, width=float(w)) for p, w in zip(every, widths, strict=True))
        self.widths = widths
        self.own: tuple[Parameter, ...] = tuple(every[i] for i in freed)
        self._all = len(every)
        measured = rows.placed | rows.ranged
        self.turned: BoolArray = np.array([bool((rows.oriented & (rows.target_of == t)).any()) for t in range(len(rows.targets))])
        self.based = bool(rows.placed.any())
        """Whether anything determines the robot's base; lengths alone do not."""
        free = len(freed)
        self.base_at = slice(free, free + 6 * self.based)
        at = self.base_at.stop
        names = [p.name for p in self.own] + [f"base.{key}" for key in (*_TURNS, *_AXES) if self.based]
        sizes = [p.size for p in self.own] + [np.radians(1.0)] * (3 * self.based) + [1.0] * (3 * self.based)
        self.target_at: list[slice] = []
        for t, name in enumerate(rows.targets):
            if not (measured & (rows.target_of == t)).any():
                self.target_at.append(slice(at, at))
                continue
            label = "tool" if len(rows.targets) == 1 else f"target_{name}"
            names += [f"{label}.{key}" for key in (_TURNS if self.turned[t] else ()) + _AXES]
            sizes += [np.radians(1.0)] * (3 * int(self.turned[t])) + [1.0] * 3
            self.target_at.append(slice(at, len(names)))
            at = len(names)
        self.station_at = slice(at, at + 3 * len(rows.stations))
        names += [f"station_{name}.{key}" for name in rows.stations for key in _AXES]
        sizes += [1.0] * (3 * len(rows.stations))
        self.asked = len(names)
        """Number of requested unknowns: all but the instrument's errors, which are the last."""
        shared = rows.systematic.shape[2]
        names += [f"instrument.error_{k + 1}" for k in range(shared)]
        sizes += [1.0] * shared
        self.names = tuple(names)
        self.size: FloatArray = np.array(sizes)
        """(p,) rad or mm in one of the unit that the name ends with."""
        wide = np.where(self.size == 1.0, WIDE_MM, WIDE_RAD)
        self.width: FloatArray = np.concatenate([[p.width * p.size for p in self.own], wide[free : self.asked], np.ones(shared)])
        """(p,) standard uncertainty of the prior, rad or mm."""

    def __len__(self) -> int:
        return len(self.names)

    def of_robot(self, x: FloatArray) -> FloatArray:
        """(all parameters,) changes of the robot's parameters."""
        change = np.zeros(self._all)
        change[self.freed] = x[: len(self.freed)]
        return change

    def state(self, x: FloatArray) -> State[R]:
        """The values at x (p,)."""
        s = self.start
        base = se3.displaced(s.base, x[self.base_at]) if self.based else s.base
        targets = s.targets.copy()
        for t, at in enumerate(self.target_at):
            if at.stop > at.start:
                targets[t] = se3.displaced(s.targets[t], np.concatenate([np.zeros(3 * (not self.turned[t])), x[at]]))
        return State(s.robot.moved(self.of_robot(x)), base, targets, s.stations + x[self.station_at].reshape(-1, 3))

    def values(self, x: FloatArray) -> FloatArray:
        """(p,) values in the units of the names: parameters as the robot's, turns as rotation vectors."""
        state = self.state(x)
        parameters = state.robot.parameters
        out = [parameters[i].value for i in self.freed]
        poses = [state.base] * self.based + [t for t, at in zip(state.targets, self.target_at, strict=True) if at.stop > at.start]
        turned = [True] * self.based + [bool(turned) for turned, at in zip(self.turned, self.target_at, strict=True) if at.stop > at.start]
        for pose, whole in zip(poses, turned, strict=True):
            out += [*(np.degrees(se3.rotation(pose).as_rotvec()) if whole else ()), *pose[:3]]
        return np.array([*out, *state.stations.reshape(-1), *x[self.asked :]])

    def levers(self, rows: Measurements) -> FloatArray:
        """Return (N, 6, 6) derivatives of the rows' components by the robot's noise at their stay: a turn, about the mean position of the
        stay's rows, and a shift (rotation [rad]; position [mm], instrument's axes)."""
        place = self.start.predicted(rows)[:, :3]
        _, of, counts = np.unique(rows.stay, return_inverse=True, return_counts=True)
        middle = np.zeros((len(counts), 3))
        np.add.at(middle, of, place)
        arm = place - (middle / counts[:, None])[of]
        out = np.tile(np.eye(COMPONENTS), (len(rows), 1, 1))
        out[:, POSITION, ROTATION] = -np.cross(np.eye(3)[None], arm[:, None])
        if rows.ranged.any():
            way = (place - self.start.stations[rows.station_of])[rows.ranged]
            along = (way / np.linalg.norm(way, axis=1)[:, None])[:, None]
            out[rows.ranged, LENGTH] = (along @ out[rows.ranged, POSITION])[:, 0]
        return np.asarray(np.where(rows.known[:, :, None], out, 0.0))

    def residuals(self, x: FloatArray, rows: Measurements | None = None) -> FloatArray:
        """(N, 6) measured minus predicted components (rotation [rad]; position or length [mm]), 0 where nothing was measured."""
        return self.linearised(x, rows)[0]

    def linearised(self, x: FloatArray, rows: Measurements | None = None) -> tuple[FloatArray, FloatArray]:
        """Return (N, 6) residuals and (N, 6, p) derivatives of the prediction, the negative ones of the residuals."""
        rows = self.rows if rows is None else rows
        state = self.state(x)
        flange, _, twists = state.robot.derivatives(rows.joints, rows.side, self.freed)
        n, free = len(rows), len(self.freed)
        if np.isnan(flange).any():
            return np.full((n, COMPONENTS), NO_POSE), np.zeros((n, COMPONENTS, len(self)))
        to_flange = se3.matrices(flange)
        local = state.targets[rows.target_of]
        in_base = se3.apply(flange, local[:, :3])
        turn = se3.matrices(state.base)
        place = in_base @ turn.T + state.base[:3]
        out, jacobian = np.zeros((n, COMPONENTS)), np.zeros((n, COMPONENTS, len(self)))

        shift = twists[..., 3:] + np.cross(twists[..., :3], in_base[:, None])
        if self.turned.any():
            jacobian[:, ROTATION, :free] = np.swapaxes(twists[..., :3] @ turn.T, 1, 2)
        jacobian[:, POSITION, :free] = np.swapaxes(shift @ turn.T, 1, 2)
        if self.based:
            about = se3.left_jacobians(x[self.base_at][:3])
            first = self.base_at.start
            jacobian[:, ROTATION, first : first + 3] = about
            jacobian[:, POSITION, first : first + 3] = np.cross(about.T[None], (place - state.base[:3])[:, None]).swapaxes(1, 2)
            jacobian[:, POSITION, first + 3 : first + 6] = np.eye(3)
        outer = turn @ to_flange
        for t, at in enumerate(self.target_at):
            own = np.flatnonzero(rows.target_of == t)
            if at.stop == at.start or len(own) == 0:
                continue
            jacobian[own[:, None], np.arange(3, 6)[None], at.stop - 3 : at.stop] = outer[own]
            if self.turned[t]:
                jacobian[own[:, None], np.arange(3)[None], at.start : at.start + 3] = outer[own] @ se3.left_jacobians(x[at][:3])

        placed, oriented, ranged = rows.placed, rows.oriented, rows.ranged
        out[placed, POSITION] = (rows.position - place)[placed]
        if oriented.any():
            # instrument axes: measured = Exp(residual) predicted
            predicted = se3.compose(se3.compose(state.base, flange), local)[oriented]
            read = se3.pose(predicted[:, :3], se3.rotation(np.column_stack([predicted[:, :3], rows.quaternion[oriented]])))
            residual = se3.displacement(read, predicted)[:, :3]
            out[oriented, ROTATION] = residual
            back = np.linalg.inv(se3.left_jacobians(-residual))
            jacobian[oriented, ROTATION] = back @ jacobian[oriented, ROTATION]
        jacobian[~oriented, ROTATION] = 0.0
        if ranged.any():
            way = place[ranged] - state.stations[rows.station_of[ranged]]
            length = np.linalg.norm(way, axis=1)
            along = way / length[:, None]
            out[ranged, LENGTH] = rows.length_mm[ranged] - length
            jacobian[ranged, LENGTH] = np.einsum("ni,nip->np", along, jacobian[ranged, POSITION])
            jacobian[ranged, LENGTH + 1 :] = 0.0
            for i, station in zip(np.flatnonzero(ranged), rows.station_of[ranged], strict=True):
                first = self.station_at.start + 3 * int(station)
                jacobian[i, LENGTH, first : first + 3] = -along[np.count_nonzero(ranged[:i])]
        unknown = ~(placed | ranged)
        jacobian[unknown, POSITION] = 0.0
        if rows.systematic.shape[2]:
            shared = slice(self.asked, len(self))
            jacobian[:, :, shared] = np.where(rows.known[:, :, None], rows.systematic, 0.0)
            out -= jacobian[:, :, shared] @ x[shared]
        return out, jacobian
