"""The curve of a run: a pose at any time, its velocity, acceleration and jerk, with covariances.

The place is a B-spline, the turn a cumulative B-spline on SO(3) (Kim, Kim, Shin, SIGGRAPH 1995), both of `ORDER` with the same uniform
knots: R(t) = R_i Exp(c_1 d_1) ... Exp(c_5 d_5), d_j the turns between neighbouring control poses, c_j(t) sums of basis functions. Not on
SE(3): there the tool origin between two control poses follows a screw, so the curve would depend on where the tool origin is.

Body rates follow by one recursion over j (Sommer et al., CVPR 2020), with A = Exp(c d), x = A^T w', y = A^T a', z = A^T b':

    w = x + c' d,    a = y + c' x * d + c'' d,    b = z + 2 c' y * d + c'' x * d + c'^2 (x * d) * d + c''' d      (* the cross product)

An error delta(t) of the curve is a turn in base axes and a shift. Of R_true = Exp(delta) R the error of the angular velocity is
delta' + delta * w, of the acceleration delta'' + delta' * w + delta * a, of the jerk delta''' + delta'' * w + 2 delta' * a + delta * b.
"""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, PPoly
from scipy.spatial.transform import Rotation

from lmeasure.core import QUATERNION_COLUMNS, DataFrame, FloatArray, IntArray, Shown, TrajectoryError, framed
from lmeasure.io import files
from lmeasure.kernels import spline_covariances, spline_poses, spline_steps
from lmeasure.recording import POSITION_COLUMNS
from lmeasure.text import message
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.motion.motion import Motion
from lmeasure.trajectory.motion.spectrum import HIGHEST
from lmeasure.trajectory.time.stamps import sound

ORDER = 6  # Control poses that act at an instant: five derivatives are continuous but the last, so jerk is smooth
RATES = 3  # Derivatives: velocity, acceleration, jerk
CHUNK = 1024


@cache
def basis_polynomials() -> FloatArray:
    """Return (4, k, k) polynomials of the k basis functions of a span of unit knots and of their derivatives, lowest power first."""
    k = ORDER
    table = np.zeros((RATES + 1, k, k))
    for p in range(k):
        pieces = PPoly.from_spline(BSpline.basis_element(np.arange(p - k + 1.0, p + 2.0), extrapolate=False))
        here = int(np.flatnonzero((np.abs(pieces.x[:-1]) < 0.5) & (np.diff(pieces.x) > 0.5))[0])
        table[0, p] = pieces.c[::-1, here]
    for d in range(RATES):
        table[d + 1, :, :-1] = table[d, :, 1:] * np.arange(1, k)
    return table


def tables(spacing_s: float) -> tuple[FloatArray, FloatArray]:
    """Return (4, k, k) polynomials of basis functions and of their sums from each on, derivatives by time."""
    own = basis_polynomials() / spacing_s ** np.arange(RATES + 1.0)[:, None, None]
    return own, np.ascontiguousarray(np.cumsum(own[:, ::-1], axis=1)[:, ::-1])


@dataclass(frozen=True, repr=False)
class Instants(Shown):
    """Poses and rates of a curve at n times, in base axes.

    Covariances are of (rotation [rad]; tool origin [mm]) and of its derivatives by time.

    Examples
    --------
    >>> there = curve.at(0.25, rates=1)
    >>> there.poses.shape, there.rates.shape, there.u.shape
    ((1, 7), (1, 2, 6), (1, 2, 6))
    """

    time_s: FloatArray
    """(n,) times [s]."""
    poses: FloatArray
    """(n, 7) poses base_from_tool."""
    rates: FloatArray
    """(n, 1 + r, 6) of the derivative d: zeros for d = 0, then velocity, acceleration, jerk (rotation; tool origin) [rad, mm per s^d]."""
    random: FloatArray
    """(n, 1 + r, 6, 6) covariance by the readings' own errors: neighbours share it within some knots."""
    shared: FloatArray
    """(n, 1 + r, 6, b) error by one standard deviation of each variable that the whole run shares."""

    @property
    def systematic(self) -> FloatArray:
        """Return (n, 1 + r, 6, 6) covariances by the shared variables."""
        return np.asarray(self.shared @ np.swapaxes(self.shared, -1, -2))

    @property
    def u(self) -> FloatArray:
        """Return (n, 1 + r, 6) standard uncertainties of the pose and of its derivatives."""
        return np.sqrt(np.einsum("ndii->ndi", self.random) + np.einsum("ndib,ndib->ndi", self.shared, self.shared))

    def about(self) -> dict[str, str]:
        """Number of times, derivatives, largest uncertainty."""
        u_mm = np.linalg.norm(self.u[:, 0, 3:], axis=1).max(initial=0.0)
        return {"times": str(len(self.time_s)), "derivatives": str(self.rates.shape[1] - 1), "largest u": f"{u_mm:.3g} mm"}

    def to_frame(self) -> DataFrame:
        """Return a row for each time."""
        out = {"time_s": self.time_s} | dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), self.poses.T, strict=True))
        u, axes = self.u, ("rx_rad", "ry_rad", "rz_rad", "x_mm", "y_mm", "z_mm")
        for d in range(u.shape[1]):
            per = "" if d == 0 else "_s" if d == 1 else f"_s{d}"
            for i, axis in enumerate(axes):
                out |= {f"rate_{axis}{per}": self.rates[:, d, i]} if d else {}
                out |= {f"u_{axis}{per}": u[:, d, i]}
        return framed(out)


@dataclass(frozen=True, repr=False)
class Curve(Shown):
    """Trajectory in continuous time, from begin_s to end_s: K control poses, one for each knot interval and five more.

    Examples
    --------
    >>> trajectory, curve = lm.reconstruct_curve(simulated, rig=calibration)
    >>> curve.poses([0.1, 0.2]).shape
    (2, 7)
    """

    begin_s: float
    """First time [s] of the curve."""
    end_s: float
    """Last time [s]."""
    spacing_s: float
    """Interval of the knots [s]."""
    points: FloatArray
    """(K, 3) places of the control poses [mm]."""
    turns: FloatArray
    """(K, 4) their orientations, unit quaternions."""
    band: FloatArray
    """(6 K, 36) band of the covariance of their displacements, by the readings' own errors."""
    factor: FloatArray
    """(6 K, 36) band of the Cholesky factor of the inverse of this covariance: element (c + d, c) at [c, d]."""
    shared: FloatArray
    """(K, 6, b) their displacement by one standard deviation of each variable that the run shares."""
    sources: tuple[str, ...]
    """Source of each of these variables."""
    assumed: tuple[str, ...]
    """Key of the typical size of each of these variables; empty for stated or calibrated ones."""
    channels: tuple[str, ...]
    """Names of the channels, m."""
    clocks_s: FloatArray
    """(m,) by how much a channel's stamps are late against the mean of all [s]; empty where channels are latched together."""
    clock_rates: FloatArray
    """(m,) by how much its clock is slow against the mean of all."""
    u_clocks_s: FloatArray
    """(m,) standard uncertainty of `clocks_s`; as wide as before the run where that shows nothing of them."""
    u_clock_rates: FloatArray
    """(m,) standard uncertainty of `clock_rates`."""
    u_before_s: float = 0.0
    """Standard uncertainty of `clocks_s` before the run was looked at."""
    evidence: float = np.nan
    """Logarithm of the evidence of the readings for its smoothness."""

    @property
    def _grid(self) -> tuple[float, float]:
        return self.begin_s, self.spacing_s

    def about(self) -> dict[str, str]:
        """Duration, knots and clocks."""
        out = {
            "duration": f"{self.end_s - self.begin_s:.6g} s",
            "knots": f"{len(self.points) - ORDER + 2}, {1e3 * self.spacing_s:.4g} ms apart",
            "order": str(ORDER),
        }
        if len(self.clocks_s):
            late = zip(self.channels, 1e3 * self.clocks_s, 1e3 * self.u_clocks_s, strict=True)
            out["clocks"] = ", ".join(f"{name} {value:+.4f} ms (u {u:.4f})" for name, value, u in late)
        return out

    def to_frame(self) -> DataFrame:
        """Return the control poses and the times about which they act."""
        return framed(self.columns())

    def columns(self) -> dict[str, FloatArray]:
        """Return the columns of a curve file: a row for each control pose."""
        at = self.begin_s + self.spacing_s * (np.arange(len(self.points)) - 0.5 * (ORDER - 2))
        return {"time_s": at} | dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), np.hstack([self.points, self.turns]).T, strict=True))

    def poses(self, time_s: FloatArray | list[float] | float) -> FloatArray:
        """Return (n, 7) poses at times (n,). TrajectoryError outside the curve."""
        return self._poses(self._checked(time_s))

    def at(self, time_s: FloatArray | list[float] | float, rates: int = RATES) -> Instants:
        """Return poses, as many derivatives as `rates` and the covariances at times (n,) [s].

        Raises
        ------
        TrajectoryError
            If a time is outside the curve, or more derivatives are requested than it has.
        """
        if not 0 <= rates <= RATES:
            raise TrajectoryError(message("curve.rates", has=RATES, rates=rates))
        time_s = self._checked(time_s)
        parts = [self._at(time_s[i : i + CHUNK], rates) for i in range(0, max(len(time_s), 1), CHUNK)]
        poses, moving, random, shared = (np.concatenate(each) for each in zip(*parts, strict=True))
        return Instants(time_s, poses, moving, random, shared)

    def _checked(self, time_s: FloatArray | list[float] | float) -> FloatArray:
        time_s = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        outside = ~((time_s >= self.begin_s) & (time_s <= self.end_s))
        if outside.any():
            at = float(time_s[np.argmax(outside)])
            raise TrajectoryError(message("curve.outside", at_s=at, begin_s=self.begin_s, end_s=self.end_s))
        return time_s

    def weights(self, time_s: FloatArray, rates: int) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the first control poses (n,) of times (n,), weights (1 + rates, n, k) and cumulative weights."""
        place = (time_s - self.begin_s) / self.spacing_s
        first = np.clip(np.floor(place).astype(np.int64), 0, len(self.points) - ORDER)
        powers = (place - first)[:, None] ** np.arange(ORDER)
        own, cumulative = (np.einsum("dpe,ne->dnp", table[: 1 + rates], powers) for table in tables(self.spacing_s))
        return first, own, cumulative

    def _poses(self, time_s: FloatArray) -> FloatArray:
        own, cumulative = tables(self.spacing_s)
        return np.asarray(
            spline_poses(time_s, self._grid, (own[:2], cumulative[:2]), self.points, self.turns, np.asarray(spline_steps(self.turns)))
        )

    def _rates(self, time_s: FloatArray, rates: int) -> FloatArray:
        """(n, 1 + rates, 6) derivatives in base axes, zeros for none."""
        first, weights, cumulative = self.weights(time_s, rates)
        places = np.einsum("dnp,npx->dnx", weights, self.points[first[:, None] + np.arange(ORDER)])
        turn, steps = Rotation.from_quat(self.turns[first]), np.asarray(spline_steps(self.turns))
        body = np.zeros((RATES, len(time_s), 3))
        for j in range(1, ORDER):
            i = first + j - 1
            d = steps[i]
            step = Rotation.from_rotvec(cumulative[0, :, j, None] * d)
            turn = turn * step
            x, y, z = (step.inv().apply(rate) for rate in body)
            c1, c2, c3 = (cumulative[r, :, j, None] if r <= rates else 0.0 for r in (1, 2, 3))
            across = np.cross(x, d)
            jerk = z + 2.0 * c1 * np.cross(y, d) + c2 * across + c1 * c1 * np.cross(across, d) + c3 * d
            body = np.stack([x + c1 * d, y + c1 * across + c2 * d, jerk])
        out = np.zeros((len(time_s), 1 + rates, 6))
        # in base axes R' = R [w] turns the derivative of the body's acceleration too
        body[2] += np.cross(body[0], body[1])
        for r in range(1, 1 + rates):
            out[:, r, :3], out[:, r, 3:] = turn.apply(body[r - 1]), places[r]
        return out

    def _at(self, time_s: FloatArray, rates: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        poses, moving = self._poses(time_s), np.zeros((len(time_s), 1, 6))
        n, D = len(time_s), 1 + rates
        joint = spline_covariances(time_s, self._grid, tables(self.spacing_s)[0][:D], self.band)
        first, weights, _ = self.weights(time_s, rates)
        shared = np.einsum("dnp,npxb->ndxb", weights, self.shared[first[:, None] + np.arange(ORDER)])
        if rates:
            moving = self._rates(time_s, rates)
            T = _errors_of_rates(moving)
            joint = T @ joint @ np.swapaxes(T, 1, 2)
            shared = (T @ shared.reshape(n, 6 * D, -1)).reshape(shared.shape)
        random = np.einsum("ndxdy->ndxy", joint.reshape(n, D, 6, D, 6))
        return poses, moving, random, shared


def _errors_of_rates(moving: FloatArray) -> FloatArray:
    """(n, 6 D, 6 D) errors of the pose and its derivatives (n, D, 6) by those of the displacement and its derivatives."""
    n, D, _ = moving.shape
    T = np.zeros((n, D, 6, D, 6))
    for d in range(D):
        T[:, d, range(6), d, range(6)] = 1.0
        # Leibniz: delta^(d) and binomial(d - 1, e) delta^(e) * w^(d - 1 - e)
        for e in range(d):
            T[:, d, :3, e, :3] = math.comb(d - 1, e) * np.cross(np.eye(3), moving[:, d - e, None, :3]).swapaxes(1, 2)
    return T.reshape(n, 6 * D, 6 * D)


def write_curve(path: Path, curve: Curve) -> None:
    """Write the control poses of a curve, complete or not at all.

    Parameters
    ----------
    path
        .csv or .parquet to write. Parquet keeps the spacing of the knots and the clocks too.
    curve
        Curve to write.

    Examples
    --------
    >>> lm.write_curve(Path("trajectory.curve.parquet"), curve)
    """
    about = {"order": str(ORDER), "spacing_s": repr(curve.spacing_s), "begin_s": repr(curve.begin_s), "end_s": repr(curve.end_s)}
    for name in ("clocks_s", "clock_rates", "u_clocks_s", "u_clock_rates"):
        about[name] = " ".join(map(repr, getattr(curve, name).tolist()))
    files.write_table(path, curve.columns(), about)


SAME_MM = 1e-6
FINER = 4  # Points between samples for the length of the path


def motion_of_curve(trajectory: Trajectory, curve: Curve, of_run: Trajectory | None = None) -> Motion:
    """Return the motion of a curve at the samples of its trajectory.

    The uncertainties include errors by the smoothness of the curve, and common errors of the whole run. TrajectoryError names the first
    sample that differs from that of the run's own curve, of_run.
    """
    known = np.isfinite(trajectory.poses[:, 0])
    if of_run is not None:
        here, there = (np.nan_to_num(np.column_stack([each.time_s, each.poses[:, :3]])) for each in (trajectory, of_run))
        if len(here) != len(there):
            raise TrajectoryError(message("curve.other_length", samples=len(here), of_run=len(there)))
        other = np.abs(here - there).max(axis=1) > SAME_MM
        if other.any():
            raise TrajectoryError(message("curve.other_trajectory", sample=int(np.argmax(other))))
    n, time_s = len(trajectory.time_s), trajectory.time_s
    at = curve.at(time_s[known])
    rates, u, u_speed = np.full((4, n, 6), np.nan), np.full((4, n, 6), np.nan), np.full(n, np.nan)
    rates[:, known], u[:, known] = np.swapaxes(at.rates, 0, 1), np.swapaxes(at.u, 0, 1)
    velocity = at.rates[:, 1, 3:]
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    unit = np.divide(velocity, speed, out=np.full_like(velocity, np.sqrt(1.0 / 3.0)), where=speed > 0.0)
    both = at.random[:, 1, 3:, 3:] + at.systematic[:, 1, 3:, 3:]
    u_speed[known] = np.sqrt(np.einsum("ni,nij,nj->n", unit, both, unit))
    poses = np.full_like(trajectory.poses, np.nan)
    poses[known] = at.poses
    if np.isnan(trajectory.poses[known, 3:]).all():
        poses[:, 3:] = rates[:, :, :3] = u[:, :, :3] = np.nan
    path = np.full(n, np.nan)
    path[known] = _path(curve, time_s[known])
    (_, velocity, acceleration, jerk), uncertain = rates, (u[0], u[1], u[2], u[3], u_speed)
    highest_hz = HIGHEST / float(np.median(np.diff(time_s)))
    smooth = time_s, poses, velocity, acceleration, jerk
    return Motion(*smooth, *uncertain, path, curve.spacing_s, sound(time_s), highest_hz=highest_hz)


def _path(curve: Curve, time_s: FloatArray) -> FloatArray:
    """Return the way (n,) [mm] of the tool origin since the first of times (n,)."""
    part = np.arange(FINER) / FINER
    fine = np.append((time_s[:-1, None] + part * np.diff(time_s)[:, None]).ravel(), time_s[-1])
    steps = np.linalg.norm(np.diff(curve.poses(fine)[:, :3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])[::FINER]
