"""Start of a run without a stated one: the poses that its absolute channels allow.

Six or more angles of absolute encoders at one sample determine the pose up to a few assembly modes; all are searched from many positions
and orientations. Fewer determine it with the changes of the other channels over a motion, as they do if six are nearly singular. The motion
selects the right one: with each the origins of the other channels are found (`origins`), and wrong ones contradict the run. The data cannot
distinguish the remaining ones.

Let n channels read absolute values, and m channels count from their zeroing. One sample has n equations for the six unknowns of its pose. A
pose of that sample gives the offsets of the m others. Each further sample then has n + m equations for six unknowns, so it adds n + m - 6
equations. One absolute angle and six drums, or four angles and four drums, determine the start if the tool moves far enough. Six channels
or fewer never do. Least squares over samples spread over the run find the start, from many poses that fit the first readings.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lmeasure import kernels
from lmeasure.core import BoolArray, FloatArray, GeometryError, Status, TrajectoryError, se3
from lmeasure.recording import known
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import Lengths
from lmeasure.text import message
from lmeasure.trajectory.faults.redundancy import Epochs
from lmeasure.trajectory.origin.origins import estimate_origins
from lmeasure.trajectory.reconstruction.run_model import FREEDOMS
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.uncertainty.sources import LOOSE_RAD, OriginEstimate, rough_columns, zeros_of

SAMPLES = 32  # Samples of the run for its start
DRAWN = 3000
"""Poses from which ones that fit the first readings are sought: of 600 none lay near enough to where one run of 25 with three encoders
began."""
TRIED = 48  # Of these, from which the start is sought: those that the run contradicts least
SOUND = 3.0  # Chi-squared per degree of freedom up to which a run does not contradict where it began
MET_STARTS = 3  # Times that each start must have been met for no others to be sought
STEPS = 40
APART_MM = 1.0  # Two ways to one start end this near to each other
FITS = 1e-3  # Angles [rad] up to which a drawn pose fits the first readings
LOST = 1e4  # Of a residual, in standard uncertainties, where a run cannot be followed
ANYWHERE_MM = 1e6  # Standard uncertainty of a start that is not stated: least squares need one where a motion does not determine all of it


@dataclass(frozen=True)
class StartCandidate:
    """A pose (7,) at which a run may have begun, chi-squared of the run's readings and their degrees of freedom, the largest standard
    uncertainty [mm] of a direction of the start, turns as ways about the tool's size, and (k,) the zeros in standard uncertainties."""

    pose: FloatArray
    chi_squared: float
    freedom: int
    u_mm: float
    zeros: FloatArray

    @property
    def sound(self) -> bool:
        """Return whether the run does not contradict it."""
        return self.chi_squared <= SOUND * self.freedom


@dataclass(frozen=True)
class Motion:
    """Samples of a run: rows (m, columns) of its channels, their changes (n, m) [mm, rad], standard uncertainties u (m,) of readings,
    absolute (m,) readings among them, and zeros (m, k): effects on the readings of one standard deviation of each uncertain zero."""

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
        """Return some of its samples, and the readings at the first of them."""
        changes = self.changes[index]
        used = np.isfinite(changes[0])
        rows, changes = np.ascontiguousarray(self.rows[used]), np.ascontiguousarray(changes[:, used])
        return Motion(rows, changes, self.u[used], self.absolute[used], self.zeros[used])

    def residuals(self, pose: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n m + k,) residuals, in standard uncertainties, of a run that began at a pose with zeros z (k,), those of the zeros last, zero
        where nothing is read; and (n, 7) the poses of the run."""
        seen = kernels.span_lengths(self.rows, pose[None])[0]
        if not np.isfinite(seen).all():
            return np.full(self.changes.size + len(z), LOST), np.full((len(self.changes), 7), np.nan)
        changes = self.changes - self.zeros @ z
        zero = np.where(self.absolute, 0.0, seen - changes[0])
        state = np.concatenate([pose, np.where(self.absolute, seen, changes[0]), [0.0]])
        flags = np.full(len(changes), Status.GAP, np.int64)
        poses = kernels.follow_least_squares(self.rows, pose, zero, state, changes, flags, self.u, np.arange(6))[0]
        # the start is the pose of the first sample; were that solved for, fewer than six drums would not depend on all of the start
        poses[0] = pose
        lost = ~np.isfinite(poses[:, 0])
        off = changes - (kernels.span_lengths(self.rows, np.where(lost[:, None], pose, poses)) - zero)
        angles = self.rows[:, kernels.KIND] > kernels.CABLE
        off[:, angles] -= 2.0 * np.pi * np.round(off[:, angles] / (2.0 * np.pi))
        off = np.nan_to_num(off / self.u)
        off[lost] = LOST
        return np.concatenate([off.ravel(), z]), poses

    def slopes(self, pose: FloatArray, poses: FloatArray, size: float) -> FloatArray:
        """(n m + k, 6 + k) derivatives of the residuals by a motion of the start pose, turns at the tool's size, and by the zeros; zero at
        samples that have no pose."""
        n, k = len(poses), self.zeros.shape[1]
        units = np.repeat([1.0 / size, 1.0], 3)
        of_start = np.where(self.absolute[:, None], 0.0, kernels.span_rows_of(self.rows, pose[None])[0] * units)
        D = np.column_stack([of_start, np.where(self.absolute[:, None], -self.zeros, 0.0)])
        used, there = np.isfinite(self.changes), np.isfinite(poses[:, 0])
        A = np.nan_to_num(kernels.span_rows_of(self.rows, np.where(there[:, None], poses, pose)))
        reach = 1.0 / np.maximum(np.abs(kernels.span_rows_of(self.rows, pose[None])[0] * units).max(axis=1), 1e-9)
        weights = np.where(used, (self.u * reach).min() / self.u, 0.0)
        G = np.nan_to_num(kernels.twists(self.rows, np.ascontiguousarray(poses), weights, np.arange(6)))
        way = G @ D
        way[0] = np.diag(np.append(units, np.zeros(k)))[:6]
        moved = np.where((used & there[:, None])[:, :, None], (D - A @ way) / self.u[:, None], 0.0)
        return np.concatenate([moved.reshape(n * len(self.u), 6 + k), np.eye(k, 6 + k, 6)])


def starts(motion: Motion, near: FloatArray, zeros: FloatArray) -> list[StartCandidate]:
    """Poses at the first of some samples of a run that fit all of them, best first, sought from poses near (k, 7) and
    zeros (k, q) that may be near."""
    size = kernels.platform_size(motion.rows)
    chi = [float((motion.residuals(pose, z)[0] ** 2).sum()) for pose, z in zip(near, zeros, strict=True)]
    found: list[StartCandidate] = []
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
        # a start with a many times larger contradiction is rejected, however often it is found
        if met[best] >= MET_STARTS and sum(met) >= TRIED // 4 and found[best].sound:
            break
    return sorted(found, key=lambda other: other.chi_squared)


def fitting(rows: FloatArray, readings: FloatArray, zeros: FloatArray, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Return (k, 7) poses, drawn anywhere and moved no farther than needed, at which angles with rows (n, columns) have readings (n,) minus
    the effects of drawn zeros, zeros (n, q) by one standard deviation, and (k, q) these."""
    rng, size = np.random.default_rng(seed), kernels.platform_size(rows)
    middle, wide = rows[:, kernels.BASE_XYZ].mean(axis=0), float(np.linalg.norm(np.ptp(rows[:, kernels.BASE_XYZ], axis=0)))
    wide = max(wide, 2.0 * float(np.linalg.norm(rows[:, kernels.ATTACHMENT_XYZ], axis=1).max()), 1000.0)
    poses = se3.pose(middle + wide * rng.uniform(-1.0, 1.0, (DRAWN, 3)), scipy.spatial.transform.Rotation.random(DRAWN, rng=rng))
    drawn = rng.standard_normal((DRAWN, zeros.shape[1]))
    aims = readings - drawn @ zeros.T
    fit = np.zeros(DRAWN, np.bool_)
    for _ in range(STEPS):
        far = np.flatnonzero(~fit)
        off = aims[far] - kernels.span_lengths(rows, poses[far])
        off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
        fit[far] = (np.abs(off) < FITS).all(axis=1)  # NaN never fits
        far, off = far[~fit[far]], off[~fit[far]]
        A = kernels.span_rows_of(rows, poses[far])
        A[:, :, :3] /= size
        step = np.einsum("nck,nk->nc", np.linalg.pinv(np.nan_to_num(A), rcond=1e-6), np.nan_to_num(off))
        step *= np.minimum(1.0, 200.0 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
        step[:, :3] /= size
        poses[far] = se3.displaced(poses[far], step)
    return np.ascontiguousarray(poses[fit]), drawn[fit]


def nearest(motion: Motion, pose: FloatArray, z: FloatArray, u_start: FloatArray | None = None) -> StartCandidate | None:
    """The start that is found from a pose and zeros z (k,); the pose is known to u_start (6,) [rad; mm], nothing where it is exact, or not
    at all. None where the run cannot be followed from it."""
    size = kernels.platform_size(motion.rows)
    units, k = np.repeat([1.0 / size, 1.0], 3), motion.zeros.shape[1]
    u = np.full(6, ANYWHERE_MM) if u_start is None else u_start / units
    free = np.append(u > 0.0, np.ones(k, np.bool_))
    prior = (np.eye(6 + k)[:6] / np.where(u > 0.0, u, 1.0)[:, None])[u > 0.0]
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
    return StartCandidate(moved(found.x), 2.0 * float(found.cost), motion.freedom, u_mm, whole(found.x)[6:])


def _apart(a: FloatArray, b: FloatArray, size: float) -> float:
    """Return how far two poses are apart [mm], turns as ways about the tool's size."""
    way = se3.displacement(a[None], b[None])[0]
    return float(np.linalg.norm(np.concatenate([size * way[:3], way[3:]])))


STARTS = 4000
MET = 3  # Times that each assembly must have been met for others to be taken for impossible
BATCHES = 6
ALIKE_MM, ALIKE_RAD = 1.0, 1e-3  # Two solutions of one pose, at most, within the rounding of the angles
WORSE = 40.0
"""Increase of chi-squared that rules out another beginning, times that of a degree of freedom for an imperfect model."""
LISTED = 8
TOLD_MM = 10.0  # Largest standard uncertainty of a start from `SAMPLES` samples, in its worst direction; the whole run determines it better
NOTHING_MM = 1000.0
BEGINNINGS = (1.0, 0.5, 0.25, 0.12)  # Parts of a run that test its start; the first one without contradictions counts
LEAST = 0.5  # Part of a run that must agree with a start from fewer than six absolute channels
TRIAL = 400  # Samples for the test of beginnings

Begin = Callable[[FloatArray, FloatArray, FloatArray | None], tuple[Reconstruction, Epochs | None]]
"""Returns a reconstruction from a start pose (7,), the changes (m,) there and the rough zeros (k,), None where they are as stated, and
the epochs of the run by it, None without redundancy."""


def absolute_channels(rig: Rig) -> FloatArray:
    """(m,) standard uncertainties [rad] of the zeros of absolute encoders that are known well enough to find a pose by; NaN for others."""
    u = zeros_of(rig, None)
    usable = [rig.counter(o).absolute and u[j] <= LOOSE_RAD for j, o in enumerate(rig.observed)]
    return np.where(usable, u, np.nan)


def enough_absolute(rig: Rig) -> bool:
    """Return whether a rig has enough absolute channels to determine a start, at once or, with redundant channels, over a motion."""
    absolute = int(np.isfinite(absolute_channels(rig)).sum())
    return absolute >= len(FREEDOMS) or (absolute > 0 and len(rig.observed) > len(FREEDOMS))


def first_sample(rig: Rig, lengths: Lengths, source: str) -> int:
    """The first sample at which enough absolute channels are read, of fewer the first with most channels; TrajectoryError where there is
    none or nothing to spare."""
    usable = np.isfinite(absolute_channels(rig))
    if not usable.any():
        return int(known(None, source, rig)[0])
    read = np.isfinite(lengths.change_mm)
    seen, every = read[:, usable].sum(axis=1), read.sum(axis=1)
    enough = np.flatnonzero(seen >= len(FREEDOMS))
    if len(enough):
        return int(enough[0])
    most, of_all = int(seen.max(initial=0)), int(every[seen > 0].max(initial=0))
    if not most or of_all <= len(FREEDOMS):
        needed = {"n_freedoms": len(FREEDOMS), "n_freedoms2": len(FREEDOMS) + 1, "state": message("start.state")}
        raise TrajectoryError(message("error.the_start_pose_of_this", where=source, most=most, of_all=of_all, **needed))
    return int(np.flatnonzero((seen > 0) & (every == of_all))[0])


def assemblies(rows: FloatArray, readings: FloatArray, u: FloatArray, seed: int = 0) -> tuple[FloatArray, bool]:
    """(k, 7) poses that fit readings (m,) of channels, rows (m, columns), of standard uncertainties u (m,), best first, and whether each
    was met MET times."""
    free, rng = np.arange(len(FREEDOMS)), np.random.default_rng(seed)
    found: list[FloatArray] = []
    met: list[int] = []
    worst: list[float] = []
    points = rows[rows[:, kernels.KIND] == (kernels.SWIVEL if (rows[:, kernels.KIND] == kernels.SWIVEL).any() else kernels.CABLE)]
    middle, size = points[:, kernels.BASE_XYZ].mean(axis=0), np.linalg.norm(np.ptp(points[:, kernels.BASE_XYZ], axis=0))
    arm = float(np.linalg.norm(points[:, kernels.ATTACHMENT_XYZ], axis=1).max())
    spare = max(len(rows) - len(free), 1)
    for batch in range(BATCHES):
        places = middle + (size + arm) * rng.uniform(-1.0, 1.0, (STARTS, 3))
        starts = se3.pose(places, scipy.spatial.transform.Rotation.random(STARTS, rng=rng))
        poses, chi = kernels.damped_search(rows, readings, u, free, np.ascontiguousarray(starts))
        good = np.flatnonzero(chi <= WORSE * spare)
        for pose, off in zip(poses[good], chi[good], strict=True):
            k = next((i for i, other in enumerate(found) if _alike(pose, other)), len(found))
            if k == len(found):
                found.append(pose)
                met.append(0)
                worst.append(float(off))
            met[k] += 1
            if off < worst[k]:
                found[k], worst[k] = pose, float(off)
        if batch and met and min(met) >= MET:
            break
    order = np.argsort(worst)
    every = np.array(found).reshape(-1, 7)[order]
    # of the two quaternions of an orientation, the usual one
    every[:, 3:] *= np.where(every[:, 6:] < 0.0, -1.0, 1.0)
    return every, bool(met) and min(met) >= MET


def _alike(a: FloatArray, b: FloatArray) -> bool:
    turn = 2.0 * min(float(np.linalg.norm(a[3:] - b[3:])), float(np.linalg.norm(a[3:] + b[3:])))
    return bool(np.abs(a[:3] - b[:3]).max() <= ALIKE_MM and turn <= ALIKE_RAD)


def find_start(rig: Rig, lengths: Lengths, source: str, begin: Begin) -> Reconstruction:
    """Return the reconstruction of a run with an unknown start, its origins found; lengths are at least those of its beginning.
    TrajectoryError if too few channels are absolute, no pose fits them, or the run does not distinguish several: all are listed."""
    i = first_sample(rig, lengths, source)
    rows, zero_u = rig.cable_rows(rig.observed), absolute_channels(rig)
    used = np.isfinite(zero_u) & np.isfinite(lengths.change_mm[i])
    resolution = np.array([rig.counter(o).per_count for o in rig.observed]) / np.sqrt(12.0)
    u = np.hypot(resolution, np.nan_to_num(zero_u))
    poses = np.empty((0, 7))
    zeros: list[FloatArray | None] = []
    if used.sum() >= len(FREEDOMS):
        poses, _ = assemblies(rows[used], lengths.change_mm[i, used], u[used])
        zeros = [None] * len(poses)
    if not len(poses):
        found = _over_motion(motion_of(rig, lengths, i), float(lengths.time_s[i]), source)
        poses, zeros = np.array([begun.pose for begun in found]).reshape(-1, 7), [begun.zeros for begun in found]
    if rig.side is not None and len(poses):
        from lmeasure.linkages import by_side

        kept = by_side(poses, rig.cable_rows(), np.array(rig.side))
        zeros = [z for pose, z in zip(poses, zeros, strict=True) if (pose == kept).all(axis=1).any()]
        poses = kept
    if not len(poses):
        raise TrajectoryError(message("error.no_pose_was_found", where=source, time_s=lengths.time_s[i]))
    begun = np.where(np.isfinite(lengths.change_mm[i]), lengths.change_mm[i], 0.0)
    beginnings: list[tuple[Reconstruction, Epochs | None]] = []
    failed: Exception | None = None
    for pose, z in zip(poses, zeros, strict=True):
        try:
            beginnings.append(begin(pose, begun, z))
        except (GeometryError, TrajectoryError) as error:
            failed = error
    candidates: list[Reconstruction] = []
    for share in BEGINNINGS:
        candidates = []
        for reconstruction, epochs in beginnings:
            try:
                few = None if epochs is None else epochs.at(slice(0, max(1, int(share * len(epochs)))))
                estimate = None if few is None else estimate_origins(reconstruction, few, TRIAL)
                candidates.append(reconstruction.with_estimate(estimate))
            except (GeometryError, TrajectoryError) as error:
                failed = error
        # a fault contradicts every beginning alike: before it they are distinguished
        chi, freedom = _contradictions(candidates)
        if chi.min(initial=np.inf) <= SOUND * freedom:
            break
    if not candidates:
        assert failed is not None
        raise failed
    left = _likely(candidates)
    if len(left) > 1:
        listed = "; ".join(_text(r.model.zero_pose) for r in left[:LISTED])
        raise TrajectoryError(message("error.the_start_pose_of_this_run", where=source, n_left=len(left), listed=listed))
    return left[0]


def motion_of(rig: Rig, lengths: Lengths, first: int = 0, record: CalibrationRecord | None = None) -> Motion:
    """A run from a sample on, with the zeros of its absolute encoders that are uncertain by more than first order allows as unknowns."""
    zero_u = absolute_channels(rig)
    columns = rough_columns(rig, record)
    resolution = np.array([rig.counter(o).per_count for o in rig.observed]) / np.sqrt(12.0)
    u = np.hypot(resolution, np.where(columns.any(axis=1), 0.0, np.nan_to_num(zero_u)))
    usable = np.isfinite(zero_u)
    return Motion(rig.cable_rows(rig.observed), lengths.change_mm[first:], np.where(usable, u, np.sqrt(2.0) * u), usable, columns)


def evenly(n: int, share: float) -> NDArray[np.intp]:
    """`SAMPLES` of n samples at most, spread over a share of them from the first on."""
    last = max(int(share * (n - 1)), 1)
    return np.unique(np.linspace(0, last, min(SAMPLES, last + 1)).round().astype(np.intp))


def zeros_by_motion(motion: Motion, start: FloatArray, u_start: FloatArray) -> FloatArray | None:
    """(k,) the rough zeros of a run that began at a stated pose (7,) known to u_start (6,) [rad; mm], in standard uncertainties; None where
    the motion contradicts all that it can be followed from."""
    off = motion.changes[0] - kernels.span_lengths(motion.rows, start[None])[0]
    off = np.where(motion.absolute & np.isfinite(off), np.angle(np.exp(1j * off)), 0.0)
    z = np.asarray(np.linalg.pinv(motion.zeros) @ off, dtype=np.float64)
    for share in BEGINNINGS:
        begun = nearest(motion.at(evenly(len(motion.changes), share)), start, z, u_start)
        if begun is not None and begun.sound:
            return begun.zeros
    return None


def _over_motion(motion: Motion, time_s: float, source: str) -> list[StartCandidate]:
    """Return possible poses at the first sample of a motion, which is at a time, by all of its readings."""
    changes, usable = motion.changes, motion.absolute
    used = usable & np.isfinite(changes[0])
    anywhere, zeros = fitting(motion.rows[used], changes[0, used], motion.zeros[used])

    def of(share: float, near: FloatArray, z: FloatArray) -> list[StartCandidate]:
        return starts(motion.at(evenly(len(changes), share)), near, z)

    every: list[StartCandidate] = []
    longest = 0.0
    for k, share in enumerate(BEGINNINGS):
        found = of(share, anywhere, zeros)
        every = every or found
        # a short part finds a start from farther away; longer parts confirm it
        for longer in (share, *reversed(BEGINNINGS[:k])):
            if longer != share:
                sound = [begun for begun in found if begun.sound]
                found = of(longer, np.array([begun.pose for begun in sound]), np.array([begun.zeros for begun in sound]))
            if not found or not found[0].sound:
                break
            if longer > longest:
                every, longest = found, longer
        if longest >= LEAST:
            break
    if not every:
        return []
    best = every[0]
    least, determined = best.u_mm * max(np.sqrt(best.chi_squared / best.freedom), 1.0), ""
    if longest < LEAST:
        determined = message("start.fits_none_beyond", percent=100.0 * longest) if longest else message("start.fits_none")
    elif least > TOLD_MM:
        determined = message("start.weak", mm=least) if least < NOTHING_MM else message("start.undetermined")
    if determined:
        why = {"usable": int(usable.sum()), "determined": determined, "state": message("start.state")}
        raise TrajectoryError(message("error.the_start_pose_of_this_run_is", where=source, time_s=time_s, **why))
    limit = best.chi_squared + WORSE * max(best.chi_squared / best.freedom, 1.0)
    return [begun for begun in every if begun.chi_squared <= limit]


def _contradictions(candidates: list[Reconstruction]) -> tuple[FloatArray, int]:
    """Return (k,) chi-squared by which a run contradicts beginnings, scaled to equally many readings, and its degrees of freedom: all zero
    without redundancy. Samples lost from a beginning count as contradictions."""
    estimates = [candidate.budget.estimate for candidate in candidates]
    followed = np.array([0 if e is None else int(np.isfinite(e.poses[:, 0]).sum()) for e in estimates])
    most = max((e.freedom for e in estimates if e is not None), default=0)
    chi = np.array([0.0 if e is None else e.chi_squared * most / max(e.freedom, 1) for e in estimates])
    return chi + WORSE * (followed.max(initial=0) - followed), most


def _likely(candidates: list[Reconstruction]) -> list[Reconstruction]:
    """Return those that the run does not contradict more than the best of them, each once: as it begins nearest to where it is found to."""
    chi, most = _contradictions(candidates)
    limit = chi.min() + WORSE * max(chi.min() / max(most, 1), 1.0)
    moved = [0.0 if c.budget.estimate is None else float(np.linalg.norm(c.budget.estimate.mean)) for c in candidates]
    out: list[Reconstruction] = []
    for k in np.argsort(moved, kind="stable"):
        if chi[k] <= limit and not any(_same(candidates[k].budget.estimate, other.budget.estimate) for other in out):
            out.append(candidates[k])
    return out


def _same(a: OriginEstimate | None, b: OriginEstimate | None) -> bool:
    """Return whether the poses of two ways through a run are the same, where both have one."""
    if a is None or b is None:
        return False
    both = np.flatnonzero(np.isfinite(a.poses[:, 0]) & np.isfinite(b.poses[:, 0]))
    return bool(len(both)) and _alike(a.poses[both[0]], b.poses[both[0]])


def _text(pose: FloatArray) -> str:
    return message("start.pose", place=", ".join(f"{x:.1f}" for x in pose[:3]), turn=", ".join(f"{x:.3f}" for x in pose[3:]))
