"""Errors of a robot between the poses at which they were measured, without a model of it: universal kriging of scattered points.

Each component of an error is an affine function of the position, which covers the robot's base and its scale, plus a Gaussian process of
Matern's covariance with nu = 5/2 (Stein, Interpolation of Spatial Data, 1999), plus noise. Poses are as far from each other as their places
in parts of one length and their rotation matrices in parts of an angle (their chord, |R - R'| / sqrt 2, is the angle for small ones; a
Euclidean distance, so that the covariance is one). Length, angle and the noise's share are those of the largest restricted likelihood
(Patterson and Thompson, Biometrika 58, 1971), in common for the three components; each has its own size. Stated uncertainties are widened
if predictions of each point from the others (Dubrule, Math. Geology 15, 1983, in closed form), or of newly tuned folds, show them too
small.

A controller knows the nominal robot. Commanded to a pose, it goes to joint values q with nominal(q) = pose, and the real flange is at
found(q). Corrected joint values q* solve found(q*) = nominal(q) by Newton's method from q, which stays on q's branch; the pose that makes
the controller go to them is nominal(q*). The remaining error is that of the robot's model and its repeatability.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.spatial import Delaunay, QhullError
from scipy.spatial.distance import cdist

from lmeasure.accuracy import radii_95
from lmeasure.core import MAX_LENGTH_MM, BoolArray, FileFormatError, FloatArray, RobotError, se3
from lmeasure.io import Column, ForeignTable
from lmeasure.robots.model import RobotModel, joint_value
from lmeasure.text import message

LEAST, MOST = 40, 4000
"""Points of a map: of fewer its stated radii hold too little (77 % at 30 of a real arm), more take too long."""
TURN_RAD = math.radians(5.0)
"""Largest difference of an orientation from the nearest measured one."""
FLAT = 1e-3
"""Part of the largest extent below which a direction is not one of the region."""
FOLDS = 5
STARTS = [[0.5, 1e-2, 0.5], [0.2, 0.3, 2.0], [5.0, 1e-4, 5.0]]
"""Length in parts of the extent, noise's share and angle from which the largest likelihood is looked for."""
TUNED = 300
"""Most points, drawn from all, for the search of length, angle and noise."""
NUGGET = 1e-10
SPREAD = (1e-6, 1e3)
"""Least and largest of the noise's variance in parts of the process's."""


@dataclass(frozen=True)
class Process:
    """Three components of an error at poses (N, 7): coefficients (N + 4, 3) of the predictor; sizes (3,) variances of the process; length
    [mm], angle [rad] and noise share of its covariance; left_out (N, 3), left_out_u (N, 3): differences of the errors from the prediction
    by all others, and their standard uncertainties before widening; misfit: the factor of widening."""

    poses: FloatArray
    factor: FloatArray
    weights: FloatArray
    trend: FloatArray
    trend_factor: FloatArray
    sizes: FloatArray
    length_mm: float
    angle_rad: float
    share: float
    left_out: FloatArray
    left_out_u: FloatArray
    misfit: float

    def at(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M, 3) errors at poses (M, 7), and (M, 3) their standard uncertainties without noise."""
        K = _covariance(_apart(poses, self.poses), self.length_mm, self.angle_rad)
        H = _affine(poses, self.poses)
        value = K @ self.weights + H @ self.trend
        white = solve_triangular(self.factor, K.T, lower=True)
        loose = H.T - solve_triangular(self.factor, _affine(self.poses, self.poses), lower=True).T @ white
        added = (solve_triangular(self.trend_factor, loose, lower=True) ** 2).sum(axis=0)
        variance = np.maximum(1.0 - (white**2).sum(axis=0), 0.0) + added
        return value, self.misfit * np.sqrt(variance[:, None] * self.sizes)

    @property
    def noise(self) -> FloatArray:
        """Return (3,) standard deviations of the part that does not repeat from point to point."""
        return np.asarray(self.misfit * np.sqrt(self.share * self.sizes))


@dataclass(frozen=True)
class ErrorMap:
    """Commanded poses (N, 7) of a target in the robot's base, and processes of the errors of its place [mm] and, where these were measured,
    of its orientation [rad]. turned: whether the poses' orientations are known."""

    poses: FloatArray
    place: Process
    turn: Process | None
    turned: bool
    largest_mm: float
    """Radius that holds 95 % of the measured errors: the robot's accuracy without correction."""
    most_rad: float
    """Largest difference of an orientation from the nearest measured one: as between those, or `TURN_RAD`."""

    def errors(self, poses: FloatArray) -> FloatArray:
        """(M, 6) errors (rotation [rad]; place [mm]) at commanded poses (M, 7), rotations nothing where they were not measured."""
        turn = np.zeros((len(poses), 3)) if self.turn is None else self.turn.at(poses)[0]
        return np.concatenate([turn, self.place.at(poses)[0]], axis=1)

    def u_mm(self, poses: FloatArray) -> FloatArray:
        """(M,) [mm] standard uncertainty of a place's error by the map alone, all coordinates together."""
        return np.asarray(np.linalg.norm(self.place.at(poses)[1], axis=1))

    def u95_mm(self, poses: FloatArray) -> FloatArray:
        """(M,) [mm] radius that holds 95 % of where a corrected robot is from where it was sent, noise included."""
        u = self.place.at(poses)[1]
        variance = u**2 + self.place.noise**2
        freedom = max(len(self.poses) - 4, 1)
        return np.asarray(float(scipy.stats.t.ppf(0.975, freedom) / scipy.stats.norm.ppf(0.975)) * radii_95(variance[:, None] * np.eye(3)))

    def outside(self, pose: FloatArray) -> str:
        """Return why the map does not apply to a pose (7,); empty if it does."""
        if not inside(self.poses[:, :3], pose[None, :3])[0]:
            return message("robots.outside_region_where_errors")
        if self.turned:
            away = float(_angles(self.poses, pose[None]).min())
            if away > self.most_rad:
                return message("robots.orientation_deg_from_nearest", deg=math.degrees(away))
        if self.u95_mm(pose[None])[0] >= self.largest_mm:
            return message("robots.map_no_surer_there")
        return ""

    @property
    def within(self) -> float:
        """Part of the points that lie within the U95 that all others state of them."""
        u = self.place.misfit * self.place.left_out_u
        return float(np.mean(np.linalg.norm(self.place.left_out, axis=1) <= radii_95(u[:, :, None] ** 2 * np.eye(3))))


def error_map(poses: FloatArray, errors_mm: FloatArray, turns: FloatArray | None = None, *, turned: bool = True) -> ErrorMap:
    """Return the map of errors (N, 3) [mm] of positions and, if measured, of turns (N, 3) [rad] about the base's axes at commanded poses
    (N, 7).

    turned: whether the orientations of the poses are known. RobotError for too few or too many points, or equal ones at one pose, so that
    the variation of errors is unknown.
    """
    n = len(poses)
    if not LEAST <= n <= MOST:
        raise RobotError(message("error.a_map_of_errors", least=LEAST, most=MOST, n=n))
    if not turned:
        poses = np.concatenate([poses[:, :3], np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))], axis=1)
    if np.linalg.matrix_rank(_affine(poses, poses)) == 1:
        raise RobotError(message("error.all_points_of_the"))
    largest = float(np.quantile(np.linalg.norm(errors_mm, axis=1), 0.95))
    apart = _angles(poses, poses) + np.diag(np.full(n, np.inf))
    most = max(TURN_RAD, float(apart.min(axis=0).max()))
    return ErrorMap(poses, _process(poses, errors_mm), None if turns is None else _process(poses, turns), turned, largest, most)


def inside(places: FloatArray, points: FloatArray) -> BoolArray:
    """(M,) whether points (M, 3) are in the convex hull of places (N, 3), which may be flat: then at its plane, or line."""
    middle = places.mean(axis=0)
    _, size, axes = np.linalg.svd(places - middle, full_matrices=False)
    rank = int((size > FLAT * size[0]).sum())
    of, at = (places - middle) @ axes.T, (points - middle) @ axes.T
    slack = 1e-6 * float(np.ptp(of[:, 0])) + 1e-9
    near = np.asarray((np.abs(at[:, rank:]) <= max(FLAT * float(np.ptp(of[:, 0])), slack)).all(axis=1))
    if rank == 1:
        return near & (at[:, 0] >= of[:, 0].min() - slack) & (at[:, 0] <= of[:, 0].max() + slack)
    try:
        hull = Delaunay(of[:, :rank])
    except QhullError:
        return np.zeros(len(points), np.bool_)
    # a target at the edge is in the region: its neighbours were measured
    return np.asarray(near & (hull.find_simplex(at[:, :rank], tol=1e-6) >= 0))


def _angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """(M, N) angles between orientations."""
    return np.asarray(2.0 * np.arccos(np.clip(np.abs(a[:, 3:] @ b[:, 3:].T), 0.0, 1.0)))


def _affine(poses: FloatArray, of: FloatArray) -> FloatArray:
    """(N, 1 + k) constant and the places in parts of the extent, along the directions in which they differ."""
    middle = of[:, :3].mean(axis=0)
    _, size, axes = np.linalg.svd(of[:, :3] - middle, full_matrices=False)
    kept = axes[size > FLAT * max(size[0], 1e-300)]
    scale = max(float(np.ptp(of[:, :3], axis=0).max()), 1e-9)
    return np.column_stack([np.ones(len(poses)), (poses[:, :3] - middle) @ kept.T / scale])


def _apart(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squares of the distances of places [mm2] and of orientations [rad2], (M, N) each."""
    turns = (se3.matrices(p).reshape(len(p), 9) / math.sqrt(2.0) for p in (a, b))
    return cdist(a[:, :3], b[:, :3], "sqeuclidean"), cdist(*turns, "sqeuclidean")


def _covariance(apart: tuple[FloatArray, FloatArray], length_mm: float, angle_rad: float) -> FloatArray:
    """(M, N) Matern 5/2."""
    r = np.sqrt(5.0 * (apart[0] / length_mm**2 + apart[1] / angle_rad**2))
    return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))


def _process(poses: FloatArray, errors: FloatArray) -> Process:
    """Widened by folds of points that are in neither the prediction nor its tuning."""
    found = _fitted(poses, errors)
    order, ratios = np.random.default_rng(1).permutation(len(poses)), []
    for part in np.array_split(order, FOLDS):
        others = np.setdiff1d(order, part)
        fold = replace(_fitted(poses[others], errors[others], found), misfit=1.0)
        value, u = fold.at(poses[part])
        stated = radii_95((u**2 + fold.noise**2)[:, :, None] * np.eye(3))
        ratios += list(np.linalg.norm(errors[part] - value, axis=1) / np.maximum(stated, 1e-300))
    return replace(found, misfit=max(found.misfit, float(np.quantile(ratios, 0.95))))


def _fitted(poses: FloatArray, errors: FloatArray, near: Process | None = None) -> Process:
    """Return the process; near: initial values of its tuning."""
    n = len(poses)
    part = np.arange(n) if n <= TUNED else np.sort(np.random.default_rng(0).permutation(n)[:TUNED])
    length, angle, share = _tuned(poses[part], errors[part], near)
    H = _affine(poses, poses)
    L, M, trend, rest = _solved(_covariance(_apart(poses, poses), length, angle), H, errors, share=share)
    sizes = (rest**2).sum(axis=0) / (n - H.shape[1])
    weights = solve_triangular(L, rest, lower=True, trans=1)
    whole = cho_solve((L, True), np.eye(n))
    of_trend = cho_solve((M, True), (whole @ H).T)
    diagonal = np.diag(whole) - np.einsum("nq,qn->n", whole @ H, of_trend)
    # Q e = K^-1 (e - H beta): omitted points differ by their parts of the diagonal
    left_out, u = weights / diagonal[:, None], np.sqrt(sizes / diagonal[:, None])
    misfit = max(1.0, float(np.sqrt(np.mean((left_out / np.maximum(u, 1e-300)) ** 2))))
    return Process(poses, L, weights, trend, M, sizes, length, angle, share, left_out, u, misfit)


def _tuned(poses: FloatArray, errors: FloatArray, near: Process | None) -> tuple[float, float, float]:
    """Length [mm], angle [rad] and the noise's share of the largest restricted likelihood; of orientations that are all one, an angle
    without meaning."""
    H, apart = _affine(poses, poses), _apart(poses, poses)
    n, q = H.shape
    extent = max(float(np.ptp(poses[:, :3], axis=0).max()), 1e-9)
    flat = np.ptp(se3.matrices(poses).reshape(n, 9), axis=0).max() < 1e-6

    def read(log: FloatArray) -> tuple[float, float, float]:
        return extent * math.exp(log[0]), 1e3 if flat else math.exp(log[2]), math.exp(log[1])

    def unlikely(log: FloatArray) -> float:
        length, angle, share = read(log)
        L, M, _, rest = _solved(_covariance(apart, length, angle), H, errors, share=share)
        sizes = (rest**2).sum(axis=0) / (n - q)
        determinants = 2.0 * (np.log(np.diag(L)).sum() + np.log(np.diag(M)).sum())
        return float(errors.shape[1] * determinants + (n - q) * np.log(np.maximum(sizes, 1e-300)).sum())

    parts = 2 if flat else 3
    bounds = list(zip(np.log([0.02, SPREAD[0], 0.02])[:parts], np.log([20.0, SPREAD[1], 20.0])[:parts], strict=True))
    begin = STARTS if near is None else [[near.length_mm / extent, near.share, near.angle_rad]]
    low, high = np.array(bounds).T
    starts = np.clip(np.log(np.array(begin)[:, :parts]), low, high)
    found = [minimize(unlikely, start, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}) for start in starts]
    return read(min(found, key=lambda f: float(f.fun)).x)


def _solved(K: FloatArray, H: FloatArray, errors: FloatArray, *, share: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return, for a covariance (N, N) and a trend's basis (N, q): Cholesky factors of the covariance with noise and of the trend's
    information, the trend's coefficients, and the whitened rest (N, 3)."""
    L = cholesky(K + (share + NUGGET) * np.eye(len(K)), lower=True)
    white, basis = solve_triangular(L, errors, lower=True), solve_triangular(L, H, lower=True)
    M = cholesky(basis.T @ basis, lower=True)
    trend = cho_solve((M, True), basis.T @ white)
    return L, M, trend, white - basis @ trend


LARGEST_MM, LARGEST_DEG = 100.0, 10.0
"""Errors beyond which frames or units are others than stated."""


@dataclass(frozen=True)
class MeasuredErrors:
    """poses (N, 7) that were commanded, base from the measured target; errors_mm (N, 3), turns (N, 3) [rad] of the attained less these,
    about the base's axes, None where orientations were not measured; turned: whether the commanded orientations are stated."""

    poses: FloatArray
    errors_mm: FloatArray
    turns: FloatArray | None
    turned: bool


def read_map(path: Path, columns: Mapping[str, Column] | None = None) -> MeasuredErrors:
    """Read `x_mm, y_mm, z_mm` commanded, with an orientation of any convention, and `dx_mm, dy_mm, dz_mm` errors, or the attained
    `attained_x_mm` ... instead; optional `drx_deg, dry_deg, drz_deg`, a small turn about the base's axes.

    FileFormatError names file, line and column, and errors too large to be those of a robot.
    """
    table = ForeignTable(path, columns)
    if len(table) == 0:
        raise FileFormatError(message("error.has_no_rows", where=path))
    place = np.column_stack([table.numbers(axis, "mm") for axis in "xyz"])
    if table.find("dx", "mm") is None and table.find("attained_x", "mm") is not None:
        errors = np.column_stack([table.numbers(f"attained_{axis}", "mm") for axis in "xyz"]) - place
    else:
        errors = np.column_stack([table.numbers(f"d{axis}", "mm") for axis in "xyz"])
    turns = None
    if table.find("drx", "deg") is not None:
        turns = np.column_stack([table.numbers(f"dr{axis}", "deg") for axis in "xyz"])
        _limited(table, np.abs(turns).max(axis=1), LARGEST_DEG, "deg")
    _limited(table, np.linalg.norm(errors, axis=1), LARGEST_MM, "mm")
    far = (np.abs(place) > MAX_LENGTH_MM).any(axis=1)
    if far.any():
        raise FileFormatError(message("error.lies_more_than_mm", where=table.row(int(np.argmax(far))), max_length_mm=MAX_LENGTH_MM))
    quaternion = table.orientation()
    table.nothing_else()
    here = np.tile([0.0, 0.0, 0.0, 1.0], (len(table), 1))
    poses = np.concatenate([place, here if quaternion is None else quaternion], axis=1)
    return MeasuredErrors(poses, errors, None if turns is None else np.radians(turns), quaternion is not None)


def _limited(table: ForeignTable, size: FloatArray, most: float, unit: str) -> None:
    if (size > most).any():
        row = int(np.argmax(size > most))
        raise FileFormatError(message("error.an_error_of_more", where=table.row(row), size=size[row], unit=unit, most=most))


STEPS = 30
SETTLED = 1e-10
"""Rad, and mm over a metre: when Newton's steps have ended."""
MOST_JOINT_RAD = np.radians(5.0)
MOST_JOINT_MM = 50.0
"""A joint that a correction moves farther leaves its branch or is near a singular pose, where errors of the robot are no small changes."""

NO_POSE = message("robots.no_pose_nominal_identified")
BETWEEN = 9
"""Joint values between nominal and corrected ones at which the branch is looked at."""


@dataclass(frozen=True)
class Limits:
    """most_mm, most_rad: largest correction of the flange; clip: shorten larger ones instead of refusing them; keep_out: boxes (3, 2) in
    the robot's base frame in which the tool's origin must not be [mm]."""

    most_mm: float = 5.0
    most_rad: float = float(np.radians(1.0))
    clip: bool = False
    keep_out: tuple[FloatArray, ...] = ()


@dataclass(frozen=True)
class Correction:
    """Correction of one target. before, joints (n,): commanded and corrected joint values; wanted, flange (7,): nominal poses of both;
    size_mm,
    size_rad: by how much the commanded pose changes; left_mm: by how much the identified robot then is off, not nothing where it was
    clipped or has fewer joints than a pose; was_mm: the same without correction; refused: why it stays as it was, empty where it does
    not."""

    before: FloatArray
    joints: FloatArray
    wanted: FloatArray
    flange: FloatArray
    size_mm: float
    size_rad: float
    was_mm: float
    left_mm: float
    clipped: bool
    refused: str


def correct(nominal: RobotModel, found: RobotModel, joints: FloatArray, limits: Limits) -> Correction:
    """The correction of the target that the nominal robot reaches at joint values (n,); RobotError as `corrections`."""
    return corrections(nominal, found, joints[None], limits)[0]


def corrections(nominal: RobotModel, found: RobotModel, joints: FloatArray, limits: Limits) -> list[Correction]:
    """The corrections of N targets that the nominal robot reaches at joint values (N, n), each for itself and all at once.

    RobotError where the nominal or the identified robot has no pose at some, as a platform at lengths that do not close.
    """
    wanted, was = nominal.forward(joints), found.forward(joints)
    if not np.isfinite([wanted, was]).all():
        raise RobotError(NO_POSE)
    solved, off = _inverted(found, joints, wanted)
    refused = _refused(nominal, found, joints, solved, off=off)
    solved = np.where(np.array([bool(why) for why in refused])[:, None], joints, solved)
    determined = nominal.forward(solved)
    clipped = np.zeros(len(joints), np.bool_)
    for i, (told_at, aim) in enumerate(zip(determined, wanted, strict=True)):
        if not np.isfinite(told_at).all():
            refused[i] = NO_POSE
        elif not refused[i] and (why := too_large(se3.displacement(told_at, aim), limits)):
            if limits.clip:
                clipped[i], solved[i] = True, _shortened(nominal, joints[i], solved[i], wanted=aim, limits=limits)
            else:
                refused[i] = why
    kept = np.array([not why for why in refused])[:, None]
    solved = np.where(kept, solved, joints)
    determined = np.where(kept, nominal.forward(solved), wanted)
    at = found.forward(solved)
    size_mm, size_rad = _sizes(se3.displacement(determined, wanted))
    left_mm, _ = _sizes(se3.displacement(at, wanted))
    was_mm, _ = _sizes(se3.displacement(was, wanted))
    columns = (joints, solved, wanted, determined, size_mm, size_rad, was_mm, left_mm, clipped.tolist(), refused)
    return [Correction(*row) for row in zip(*columns, strict=True)]


def _sizes(changes: FloatArray) -> tuple[list[float], list[float]]:
    """Shifts (N,) [mm] and turns (N,) [rad] of displacements (N, 6)."""
    return np.linalg.norm(changes[:, 3:], axis=1).tolist(), np.linalg.norm(changes[:, :3], axis=1).tolist()


def _shortened(nominal: RobotModel, joints: FloatArray, solved: FloatArray, *, wanted: FloatArray, limits: Limits) -> FloatArray:
    """Joint values (n,) on the way from the commanded to the corrected ones at which the commanded pose changes by no more than is
    allowed."""
    while too_large(change := se3.displacement(nominal.forward(solved[None])[0], wanted), limits):
        size = np.array([np.linalg.norm(change[3:]), np.linalg.norm(change[:3])])
        # joints do not shorten quite as places do: once more where a little is left
        part = float((np.array([limits.most_mm, limits.most_rad]) / np.maximum(size, 1e-300)).min())
        solved = joints + 0.999999 * min(part, 1.0) * (solved - joints)
    return solved


def too_large(change: FloatArray, limits: Limits) -> str:
    """Return why a change (6,) of the command is refused; empty if it is small enough."""
    size_mm, size_rad = float(np.linalg.norm(change[3:])), float(np.linalg.norm(change[:3]))
    if size_mm <= limits.most_mm and size_rad <= limits.most_rad:
        return ""
    most = {"most_mm": limits.most_mm, "most_deg": float(np.degrees(limits.most_rad))}
    return message("robots.correction_limit", mm=size_mm, deg=float(np.degrees(size_rad)), **most)


def in_keep_out(limits: Limits, places: FloatArray) -> int | None:
    """The first of places (k, 3) [mm, base frame], taken as the corners of one way, from which on the way is in a box; None where it is in
    none. Ways between targets are taken as straight, which a controller's joint motions are not."""
    for i, place in enumerate(places):
        before = places[max(i - 1, 0)]
        if any(_crosses(box, before, place) for box in limits.keep_out):
            return i
    return None


def ways(nominal: RobotModel, flange: FloatArray, near: FloatArray | None) -> FloatArray:
    """(k, n) joint values that take the nominal flange to a pose (7,), with the whole turns within the limits that are nearest to joint
    values (n,) where those are given; the nearest first."""
    found = nominal.inverse(flange)
    if near is None or not len(found):
        return found
    low, high = nominal.limits
    turns = np.where(nominal.sliding, 0.0, np.round((near - found) / (2.0 * np.pi)))
    turned = found + 2.0 * np.pi * turns
    turned = np.where((turned >= low) & (turned <= high), turned, found)
    away = np.where(nominal.sliding, 0.0, turned - near)
    return np.asarray(turned[np.argsort(np.abs(away).max(axis=1), kind="stable")])


def whole_turns(nominal: RobotModel, joints: FloatArray) -> FloatArray:
    """(k, n) joint values that differ from (n,) by whole turns of turning joints, all that the limits allow."""
    low, high = nominal.limits
    every = []
    for value, least, most, slides in zip(joints, low, high, nominal.sliding, strict=True):
        first, last = math.ceil((least - value) / (2.0 * math.pi) - 1e-12), math.floor((most - value) / (2.0 * math.pi) + 1e-12)
        every.append([value] if slides else [value + 2.0 * math.pi * turn for turn in range(first, last + 1)])
    return np.array(list(itertools.product(*every))).reshape(-1, len(joints))


def _inverted(found: RobotModel, joints: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return joint values (N, n) at which the robot is at the wanted pose, and the remainder (N, 6); NaN if steps led to values without a
    pose."""
    solved, scale = joints.copy(), np.array([1.0] * 3 + [1e3] * 3)
    on = np.arange(len(joints))
    for _ in range(STEPS):
        pose, rows = _rows(found, solved[on])
        there = np.isfinite(pose).all(axis=1) & np.isfinite(rows).all(axis=(1, 2))
        on, rows = on[there], rows[there]
        off = se3.displacement(wanted[on], pose[there]) / scale
        step = np.einsum("nij,ni->nj", np.linalg.pinv(rows, rcond=1e-9), off)
        largest = np.abs(step).max(axis=1)
        if not found.sliding.any():
            step = step / np.maximum(1.0, largest / 0.1)[:, None]
        solved[on] += step
        on = on[np.abs(step).max(axis=1) >= SETTLED]
        if not len(on):
            break
    pose = found.forward(solved)
    there = np.isfinite(pose).all(axis=1)
    left = np.full((len(joints), 6), np.nan)
    left[there] = se3.displacement(wanted[there], pose[there])
    return solved, left


def _rows(robot: RobotModel, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Flange poses (N, 7), and derivatives (N, n, 6) by the joints: turns, and the flange's shifts in metres."""
    poses, twists, _ = robot.derivatives(joints, of=np.empty(0, dtype=np.int64))
    shifts = (twists[:, :, 3:] + np.cross(twists[:, :, :3], poses[:, None, :3])) / 1e3
    return poses, np.concatenate([twists[:, :, :3], shifts], axis=2)


def _one_branch(robot: RobotModel, joints: FloatArray, solved: FloatArray) -> BoolArray:
    """(N,) whether no singular pose of a robot of six joints lies between: near one, another branch is as near as the right one."""
    count, n = joints.shape
    if n != 6:
        return np.ones(count, np.bool_)
    between = joints[:, None] + np.linspace(0.0, 1.0, BETWEEN)[:, None] * (solved - joints)[:, None]
    signs = np.sign(np.linalg.det(_rows(robot, between.reshape(-1, n))[1])).reshape(count, BETWEEN)
    return np.asarray((signs == signs[:, :1]).all(axis=1) & (signs[:, 0] != 0.0))


def _refused(nominal: RobotModel, found: RobotModel, joints: FloatArray, solved: FloatArray, *, off: FloatArray) -> list[str]:
    """Return why each correction is impossible; empty if it is possible."""
    low, high = nominal.limits
    moved = np.abs(solved - joints)
    lost = np.asarray(~np.isfinite(np.hstack([solved, off])).all(axis=1))
    if joints.shape[1] >= 6:
        lost |= np.abs(off / ([1.0] * 3 + [1e3] * 3)).max(axis=1) > 1e-6
    far = moved / np.where(nominal.sliding, MOST_JOINT_MM, MOST_JOINT_RAD)
    near = np.flatnonzero(~lost & (far.max(axis=1) <= 1.0))
    one = np.zeros(len(joints), np.bool_)
    one[near] = _one_branch(nominal, joints[near], solved[near]) & _one_branch(found, joints[near], solved[near])
    out: list[str] = []
    for i, at in enumerate(solved):
        beyond = np.flatnonzero((at < low) | (at > high))
        if lost[i]:
            out.append(message("robots.identified_robot_does_not"))
        elif far[i].max() > 1.0:
            j = int(np.argmax(far[i]))
            by, unit = joint_value(nominal, j, moved[i, j])
            out.append(message("robots.would_move_near_singular", joint=nominal.joint_names[j], size=by, unit=unit))
        elif not one[i]:
            out.append(message("robots.singular_pose_lies_between"))
        elif len(beyond):
            j = int(beyond[0])
            value, unit = joint_value(nominal, j, at[j])
            out.append(message("robots.would_beyond_limit", joint=nominal.joint_names[j], value=value, unit=unit))
        else:
            out.append("")
    return out


def _crosses(box: FloatArray, start: FloatArray, stop: FloatArray) -> bool:
    """Return whether the straight line between two points meets a box (3, 2), by slabs."""
    way = stop - start
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = (box[:, 0] - start) / way, (box[:, 1] - start) / way
    still = way == 0.0
    inside = (start >= box[:, 0]) & (start <= box[:, 1])
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(first, last))
    leave = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(first, last))
    return bool(max(enter.max(), 0.0) <= min(leave.min(), 1.0))
