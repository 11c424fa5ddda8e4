"""Where a run began whose absolute channels are too few to tell a pose at once: by its motion.

Of n channels with absolute readings and m that count from where they were zeroed, one sample has n equations for six unknowns. But given
the pose at that sample every other one follows from the changes of all channels, n + m of them: where these are more than six, each sample
adds n + m - 6 equations and no unknown. So one absolute angle and six drums tell the start if the tool moves far
enough, and the better the more of them are absolute; six channels or fewer leave nothing over, whatever the motion. The start is found by
least squares over samples spread over the run, from many poses that fit the first readings.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.kernels import least_squares
from lmeasure.kernels.cable import span_lengths, span_rows_of
from lmeasure.kernels.layout import ATTACHMENT_XYZ, BASE_XYZ, CABLE, KIND
from lmeasure.kernels.screw import platform_size
from lmeasure.status import Status

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
STEP_MM = 1e-3


@dataclass(frozen=True)
class Begun:
    """A pose (7,) at which a run may have begun, chi-squared of the run's readings and their degrees of freedom, and the largest standard
    uncertainty [mm] of a direction of the start, turns as ways about the tool's size."""

    pose: FloatArray
    chi_squared: float
    freedom: int
    u_mm: float

    @property
    def sound(self) -> bool:
        """Whether the run does not contradict it."""
        return self.chi_squared <= SOUND * self.freedom


def starts(rows: FloatArray, changes: FloatArray, *, u: FloatArray, absolute: BoolArray, near: FloatArray) -> list[Begun]:
    """Poses at the first of n samples of a run that fit all of them, changes (n, m) [mm, rad] of channels with rows (m, columns), of
    standard uncertainties u (m,), absolute (m,) readings among them; best first. They are sought from poses (k, 7) that may be near."""
    used = np.isfinite(changes[0])
    rows, changes, u, absolute = np.ascontiguousarray(rows[used]), np.ascontiguousarray(changes[:, used]), u[used], absolute[used]
    size = platform_size(rows)
    residuals = partial(_residuals, rows, changes, u, absolute)
    chi = [float((residuals(pose) ** 2).sum()) for pose in near]
    freedom = max(int(np.isfinite(changes).sum()) - 6 * len(changes) - int((~absolute).sum()), 1)
    found: list[Begun] = []
    met: list[int] = []
    for k in np.argsort(chi, kind="stable")[:TRIED]:
        begun = _nearest(residuals, near[k], size, freedom)
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


def _residuals(rows: FloatArray, changes: FloatArray, u: FloatArray, absolute: BoolArray, pose: FloatArray) -> FloatArray:
    """(n m,) residuals, in standard uncertainties, of a run that began at a pose; zero where nothing is read."""
    seen = span_lengths(rows, pose[None])[0]
    if not np.isfinite(seen).all():
        return np.full(changes.size, LOST)
    zero = np.where(absolute, 0.0, seen - changes[0])
    state = np.concatenate([pose, np.where(absolute, seen, changes[0]), [0.0]])
    flags = np.full(len(changes), Status.GAP, np.int64)
    poses = least_squares.follow(rows, pose, zero, state, changes, flags, u, np.arange(6))[0]
    lost = ~np.isfinite(poses[:, 0])
    off = changes - (span_lengths(rows, np.where(lost[:, None], pose, poses)) - zero)
    angles = rows[:, KIND] != CABLE
    off[:, angles] -= 2.0 * np.pi * np.round(off[:, angles] / (2.0 * np.pi))
    off = np.nan_to_num(off / u)
    off[lost] = LOST
    return np.asarray(off.ravel())


def fitting(rows: FloatArray, readings: FloatArray, seed: int = 0) -> FloatArray:
    """(k, 7) poses, drawn anywhere and moved no farther than they must, at which angles with rows (n, columns) read readings (n,)."""
    rng, size = np.random.default_rng(seed), platform_size(rows)
    middle, wide = rows[:, BASE_XYZ].mean(axis=0), float(np.linalg.norm(np.ptp(rows[:, BASE_XYZ], axis=0)))
    wide = max(wide, 2.0 * float(np.linalg.norm(rows[:, ATTACHMENT_XYZ], axis=1).max()), 1000.0)
    poses = se3.pose(middle + wide * rng.uniform(-1.0, 1.0, (DRAWN, 3)), Rotation.random(DRAWN, rng=rng))
    fit = np.zeros(DRAWN, np.bool_)
    for _ in range(STEPS):
        far = np.flatnonzero(~fit)
        off = readings - span_lengths(rows, poses[far])
        off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
        fit[far] = (np.abs(off) < FITS).all(axis=1)  # none of what is NaN
        far, off = far[~fit[far]], off[~fit[far]]
        A = span_rows_of(rows, poses[far])
        A[:, :, :3] /= size
        step = np.einsum("nck,nk->nc", np.linalg.pinv(np.nan_to_num(A), rcond=1e-6), np.nan_to_num(off))
        step *= np.minimum(1.0, 200.0 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
        step[:, :3] /= size
        poses[far] = se3.displaced(poses[far], step)
    return np.ascontiguousarray(poses[fit])


def _nearest(residuals: "partial[FloatArray]", pose: FloatArray, size: float, freedom: int) -> Begun | None:
    """The start that is found from a pose; None where the run cannot be followed from it."""

    def moved(x: FloatArray) -> FloatArray:
        return np.asarray(se3.displaced(pose[None], np.concatenate([x[:3] / size, x[3:]])[None])[0])

    def slopes(x: FloatArray) -> FloatArray:
        ways = STEP_MM * np.eye(6)
        return np.array([(residuals(moved(x + way)) - residuals(moved(x - way))) / (2.0 * STEP_MM) for way in ways]).T

    found = scipy.optimize.least_squares(lambda x: residuals(moved(x)), np.zeros(6), slopes, max_nfev=STEPS)
    if (np.abs(found.fun) >= LOST).any():
        return None
    size_of = np.linalg.svd(found.jac, compute_uv=False)
    return Begun(moved(found.x), 2.0 * float(found.cost), freedom, float(1.0 / max(size_of[-1], 1e-12)))


def _apart(a: FloatArray, b: FloatArray, size: float) -> float:
    """How far two poses are apart [mm], turns as ways about the tool's size."""
    way = se3.displacement(a[None], b[None])[0]
    return float(np.linalg.norm(np.concatenate([size * way[:3], way[3:]])))
