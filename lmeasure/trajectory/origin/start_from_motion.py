"""Find where a run began by its motion, when too few channels are absolute to determine a pose at once.

Let n channels read absolute values, and m channels count from where they were zeroed. One sample has n equations for the six unknowns of
its pose. A pose of that sample gives the offsets of the m others. Each further sample then has n + m equations for six unknowns, so it adds
n + m - 6 equations. One absolute angle and six drums, or four angles and four drums, determine the start if the tool moves far enough. Six
channels or fewer never do. Least squares over samples spread over the run find the start, from many poses that fit the first readings.
"""

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, Status, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, CABLE, KIND, follow_least_squares, platform_size, span_lengths, span_rows_of, twists

SAMPLES = 32
"""Of the run, by which its start is told."""
DRAWN = 3000
"""Poses from which ones that fit the first readings are sought: of 600 none lay near enough to where one run of 25 with three encoders
began."""
TRIED = 48
"""Of these, from which the start is sought: those that the run contradicts least."""
SOUND = 3.0
"""Chi-squared per degree of freedom up to which a run does not contradict where it began."""
MET = 3
"""Times that each start must have been met for no others to be sought."""
STEPS = 40
APART_MM = 1.0
"""Two ways to one start end this near to each other."""
FITS = 1e-3
"""Angles [rad] up to which a drawn pose fits the first readings."""
LOST = 1e4
"""Of a residual, in standard uncertainties, where a run cannot be followed."""
ANYWHERE_MM = 1e6
"""Standard uncertainty of a start that is not stated: least squares need one where a motion does not determine all of it."""


@dataclass(frozen=True)
class Begun:
    """A pose (7,) at which a run may have begun, chi-squared of the run's readings and their degrees of freedom, the largest standard
    uncertainty [mm] of a direction of the start, turns as ways about the tool's size, and (k,) the zeros in standard uncertainties."""

    pose: FloatArray
    chi_squared: float
    freedom: int
    u_mm: float
    zeros: FloatArray

    @property
    def sound(self) -> bool:
        """Whether the run does not contradict it."""
        return self.chi_squared <= SOUND * self.freedom


@dataclass(frozen=True)
class Motion:
    """Samples of a run: rows (m, columns) of its channels, their changes (n, m) [mm, rad], standard uncertainties u (m,) of readings,
    absolute (m,) readings among them, and zeros (m, k): what one standard deviation of each uncertain zero makes of the readings."""

    rows: FloatArray
    changes: FloatArray
    u: FloatArray
    absolute: BoolArray
    zeros: FloatArray

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi-squared."""
        return max(int(np.isfinite(self.changes).sum()) - 6 * len(self.changes) - int((~self.absolute).sum()), 1)

    def at(self, index: NDArray[np.intp]) -> "Motion":
        """Some samples of it, and what is read at the first of them."""
        changes = self.changes[index]
        used = np.isfinite(changes[0])
        rows, changes = np.ascontiguousarray(self.rows[used]), np.ascontiguousarray(changes[:, used])
        return Motion(rows, changes, self.u[used], self.absolute[used], self.zeros[used])

    def residuals(self, pose: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n m + k,) residuals, in standard uncertainties, of a run that began at a pose with zeros z (k,), those of the zeros last, zero
        where nothing is read; and (n, 7) the poses of the run."""
        seen = span_lengths(self.rows, pose[None])[0]
        if not np.isfinite(seen).all():
            return np.full(self.changes.size + len(z), LOST), np.full((len(self.changes), 7), np.nan)
        changes = self.changes - self.zeros @ z
        zero = np.where(self.absolute, 0.0, seen - changes[0])
        state = np.concatenate([pose, np.where(self.absolute, seen, changes[0]), [0.0]])
        flags = np.full(len(changes), Status.GAP, np.int64)
        poses = follow_least_squares(self.rows, pose, zero, state, changes, flags, self.u, np.arange(6))[0]
        # the start is the pose of the first sample; were that solved for, fewer than six drums would not depend on all of the start
        poses[0] = pose
        lost = ~np.isfinite(poses[:, 0])
        off = changes - (span_lengths(self.rows, np.where(lost[:, None], pose, poses)) - zero)
        angles = self.rows[:, KIND] != CABLE
        off[:, angles] -= 2.0 * np.pi * np.round(off[:, angles] / (2.0 * np.pi))
        off = np.nan_to_num(off / self.u)
        off[lost] = LOST
        return np.concatenate([off.ravel(), z]), poses

    def slopes(self, pose: FloatArray, poses: FloatArray, size: float) -> FloatArray:
        """(n m + k, 6 + k) derivatives of the residuals by a motion of the start pose, turns at the tool's size, and by the zeros; zero at
        samples that have no pose."""
        n, k = len(poses), self.zeros.shape[1]
        units = np.repeat([1.0 / size, 1.0], 3)
        of_start = np.where(self.absolute[:, None], 0.0, span_rows_of(self.rows, pose[None])[0] * units)
        D = np.column_stack([of_start, np.where(self.absolute[:, None], -self.zeros, 0.0)])
        used, there = np.isfinite(self.changes), np.isfinite(poses[:, 0])
        A = np.nan_to_num(span_rows_of(self.rows, np.where(there[:, None], poses, pose)))
        reach = 1.0 / np.maximum(np.abs(span_rows_of(self.rows, pose[None])[0] * units).max(axis=1), 1e-9)
        weights = np.where(used, (self.u * reach).min() / self.u, 0.0)
        G = np.nan_to_num(twists(self.rows, np.ascontiguousarray(poses), weights, np.arange(6)))
        way = G @ D
        way[0] = np.diag(np.append(units, np.zeros(k)))[:6]
        moved = np.where((used & there[:, None])[:, :, None], (D - A @ way) / self.u[:, None], 0.0)
        return np.concatenate([moved.reshape(n * len(self.u), 6 + k), np.eye(k, 6 + k, 6)])


def starts(motion: Motion, near: FloatArray, zeros: FloatArray) -> list[Begun]:
    """Poses at the first of some samples of a run that fit all of them, best first, sought from poses near (k, 7) and
    zeros (k, q) that may be near."""
    size = platform_size(motion.rows)
    chi = [float((motion.residuals(pose, z)[0] ** 2).sum()) for pose, z in zip(near, zeros, strict=True)]
    found: list[Begun] = []
    met: list[int] = []
    for k in np.argsort(chi, kind="stable")[:TRIED]:
        begun = nearest(motion, near[k], zeros[k])
        if begun is None:
            continue
        i = next((i for i, other in enumerate(found) if _apart(begun.pose, other.pose, size) < APART_MM), len(found))
        if i == len(found):
            found.append(begun)
            met.append(0)
        met[i] += 1
        best = int(np.argmin([other.chi_squared for other in found]))
        # what is contradicted many times as much is no start, however often it is met
        if met[best] >= MET and sum(met) >= TRIED // 4 and found[best].sound:
            break
    return sorted(found, key=lambda other: other.chi_squared)


def fitting(rows: FloatArray, readings: FloatArray, zeros: FloatArray, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """(k, 7) poses, drawn anywhere and moved no farther than they must, at which angles with rows (n, columns) read readings (n,) less what
    drawn zeros make of them, zeros (n, q) by one standard deviation, and (k, q) these."""
    rng, size = np.random.default_rng(seed), platform_size(rows)
    middle, wide = rows[:, BASE_XYZ].mean(axis=0), float(np.linalg.norm(np.ptp(rows[:, BASE_XYZ], axis=0)))
    wide = max(wide, 2.0 * float(np.linalg.norm(rows[:, ATTACHMENT_XYZ], axis=1).max()), 1000.0)
    poses = se3.pose(middle + wide * rng.uniform(-1.0, 1.0, (DRAWN, 3)), Rotation.random(DRAWN, rng=rng))
    drawn = rng.standard_normal((DRAWN, zeros.shape[1]))
    aims = readings - drawn @ zeros.T
    fit = np.zeros(DRAWN, np.bool_)
    for _ in range(STEPS):
        far = np.flatnonzero(~fit)
        off = aims[far] - span_lengths(rows, poses[far])
        off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
        fit[far] = (np.abs(off) < FITS).all(axis=1)  # none of what is NaN
        far, off = far[~fit[far]], off[~fit[far]]
        A = span_rows_of(rows, poses[far])
        A[:, :, :3] /= size
        step = np.einsum("nck,nk->nc", np.linalg.pinv(np.nan_to_num(A), rcond=1e-6), np.nan_to_num(off))
        step *= np.minimum(1.0, 200.0 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
        step[:, :3] /= size
        poses[far] = se3.displaced(poses[far], step)
    return np.ascontiguousarray(poses[fit]), drawn[fit]


def nearest(motion: Motion, pose: FloatArray, z: FloatArray, u_start: FloatArray | None = None) -> Begun | None:
    """The start that is found from a pose and zeros z (k,); the pose is known to u_start (6,) [rad; mm], nothing where it is exact, or not
    at all. None where the run cannot be followed from it."""
    size = platform_size(motion.rows)
    units, k = np.repeat([1.0 / size, 1.0], 3), motion.zeros.shape[1]
    u = np.full(6, ANYWHERE_MM) if u_start is None else u_start / units
    free = np.append(u > 0.0, np.ones(k, np.bool_))
    prior = np.eye(6 + k)[:6] / np.where(u > 0.0, u, 1.0)[:, None]
    prior = prior[u > 0.0]
    last: list[FloatArray] = []

    def whole(x: FloatArray) -> FloatArray:
        out = np.zeros(6 + k)
        out[free] = x
        return out

    def moved(x: FloatArray) -> FloatArray:
        return np.asarray(se3.displaced(pose[None], (whole(x)[:6] * units)[None])[0])

    def residuals(x: FloatArray) -> FloatArray:
        left, poses = motion.residuals(moved(x), whole(x)[6:])
        last[:] = [x.copy(), poses]
        return np.concatenate([left, prior @ whole(x)])

    def slopes(x: FloatArray) -> FloatArray:
        if not np.array_equal(last[0], x):
            residuals(x)
        return np.asarray(np.concatenate([motion.slopes(moved(x), last[1], size), prior])[:, free])

    begin = np.concatenate([np.zeros(6), z])[free]
    found = scipy.optimize.least_squares(residuals, begin, slopes, max_nfev=STEPS)
    if (np.abs(found.fun) >= LOST).any():
        return None
    of_start = int(free[:6].sum())
    _, s, V = np.linalg.svd(found.jac, full_matrices=False)
    u_mm = float(np.linalg.norm(V[:, :of_start] / np.maximum(s, 1e-12)[:, None], 2)) if of_start else 0.0
    return Begun(moved(found.x), 2.0 * float(found.cost), motion.freedom, u_mm, whole(found.x)[6:])


def _apart(a: FloatArray, b: FloatArray, size: float) -> float:
    """How far two poses are apart [mm], turns as ways about the tool's size."""
    way = se3.displacement(a[None], b[None])[0]
    return float(np.linalg.norm(np.concatenate([size * way[:3], way[3:]])))
