"""Information of readings of every kind, drums with cables, swivels and inclinations, about a pose in a cell, and the faults that they
would show.

With A the readings' rows at a pose, and V the covariance of the errors of single readings: counts, the sub-count offset at zeroing and the
zero of each encoder, the pose is that of

    G = (A^T V^-1 A)^-1 A^T V^-1,    of covariance (A^T V^-1 A)^-1 + (G L)(G L)^T,

with L the errors of the readings from all else: calibration, dimensions, run-out of drums. A run weighs its readings in this way, and
determines their origins better than a single pose (`trajectory.origin.origins`). With S = V + L L^T the contradictions of the readings
weigh W = S^-1 - S^-1 A (A^T S^-1 A)^-1 A^T S^-1, from which their reliability follows (`trajectory.faults.redundancy`).
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy

from lmeasure import kernels
from lmeasure.core import BoolArray, FloatArray, IntArray, RigError, se3
from lmeasure.rig import CABLES_FOR_A_POSE, CalibrationRecord, Rig
from lmeasure.sensors import Channels, phase_columns
from lmeasure.text import message
from lmeasure.trajectory import Faults, faults_shown, radii_95 as radii_95, zero_columns


def exact_radius_95(eigenvalues: FloatArray, coverage: float = 0.95) -> float:
    """Radius that holds the coverage of a Gaussian with these three variances along its axes (same unit squared).

    In coordinates whitened by the variances the sphere reaches r^2/(n.Lambda n) along the direction n, so the probability is the mean over
    all directions of the chi-square distribution (3 degrees of freedom) there: Gauss-Legendre in the cosine to the longest axis,
    midpoints in the angle about it, both spectrally accurate. scipy.special.gammainc(3/2, x/2) is that distribution.
    """
    scaled = np.sort(np.asarray(eigenvalues, dtype=np.float64))[::-1]
    scale = scaled[0]
    if not scale > 0.0:
        return 0.0
    scaled = scaled / scale
    node, weight = np.polynomial.legendre.leggauss(80)
    cosine2 = (0.5 * (node + 1.0)) ** 2
    turn = (np.arange(24) + 0.5) / 24 * np.pi / 2
    along = cosine2[:, None] * scaled[0] + (1 - cosine2[:, None]) * (scaled[1] * np.cos(turn) ** 2 + scaled[2] * np.sin(turn) ** 2)

    def excess(square: float) -> float:
        return float(0.5 * weight @ scipy.special.gammainc(1.5, 0.5 * square / along).mean(axis=1)) - coverage

    low, high = (2.0 * scipy.special.gammaincinv(freedom / 2.0, coverage) for freedom in (1, 3))
    return float(np.sqrt(scale * scipy.optimize.brentq(excess, 0.9 * low, 1.1 * high, xtol=1e-13)))


def stated_radii_95(covariances: FloatArray) -> FloatArray:
    """(n,) `radii_95`; NaN where nothing is stated: no covariance, or a zero one, which no measurement has."""
    out = np.full(len(covariances), np.nan)
    stated = np.isfinite(covariances).all(axis=(1, 2)) & (np.einsum("nii->n", covariances) > 0.0)
    out[stated] = radii_95(covariances[stated])
    return out


CHUNK = 2048  # Poses at once
TURNS_ALONE = 1e-7  # Force of a channel, over its moment, below which it is rounding: it sees turns alone
SINGULAR = 1e-12  # Least eigenvalue of the rows' normal equations, of the largest


@dataclass(frozen=True)
class Readings:
    """The readings of a rig, as arrays, cables first. rows (M, columns) of the kernels; cables: how many of them are; V (M, M) [mm, rad];
    white (M, M), white^T white = V^-1; drums (M,) variance of lengths by drums that run out; scales (M,); factor (13 M, r) with factor
    factor^T the parameters' covariance; relative (M,) 1 of channels that count from the start pose (7,), 0 of absolute ones."""

    rows: FloatArray
    cables: int
    V: FloatArray
    white: FloatArray
    drums: FloatArray
    scales: FloatArray
    factor: FloatArray
    relative: FloatArray
    start: FloatArray

    @property
    def angular(self) -> BoolArray:
        """(M,) whether a reading is an angle."""
        return np.asarray(self.rows[:, kernels.KIND] > kernels.CABLE)

    def arrays(self) -> dict[str, FloatArray]:
        """Return the arrays by name, for a digest."""
        return {f"channels.{f.name}": np.asarray(getattr(self, f.name)) for f in fields(self)}

    def copied(self) -> "Readings":
        """Return a copy with arrays of its own."""
        own: dict[str, Any] = {f.name: value.copy() for f in fields(self) if isinstance(value := getattr(self, f.name), np.ndarray)}
        return replace(self, **own)


@dataclass(frozen=True)
class Determined:
    """Readings at n poses: lengths (n, cables) [mm], NaN where a cable cannot run; runs, known (n,) whether all do, and the pose is
    determined. Of
    the k known ones: rows A (k, M, 6), G (k, 6, M), covariance (k, 6, 6) of (rotation [rad]; tool origin [mm]), L (k, M, r), norm2 (k,)
    squared Frobenius norm of the pseudo-inverse of the rows, moments divided by the platform's size and angles taken as lengths where they
    are seen, and speed (k, M) of each channel's point, at least 1 where it is seen best, under the twist that its reading alone makes by
    least squares in which all readings count alike."""

    lengths: FloatArray
    runs: BoolArray
    known: BoolArray
    A: FloatArray
    G: FloatArray
    covariance: FloatArray
    L: FloatArray
    norm2: FloatArray
    speed: FloatArray


def readings_of(rig: Rig, calibration: CalibrationRecord | None, start: FloatArray, drums: FloatArray) -> Readings:
    """Return the readings of a rig whose counters are zeroed at the start pose (7,); drums (cables,) variances [mm^2]. RigError where
    there are fewer than six channels, or cables to points on one line and nothing else."""
    channels = Channels.of_rig(rig, calibration)
    m = len(channels)
    if m < CABLES_FOR_A_POSE:
        raise RigError(message("error.rig_has_channels_a", name=rig.name, m=m, cables_for_a_pose=CABLES_FOR_A_POSE))
    if not rig.measures_turns:
        rig.require_spread()
    origins = np.column_stack([phase_columns(rig, rig.observed), zero_columns(rig, calibration)[0]])
    V = np.diag(channels.variance) + origins @ origins.T
    by_drums = np.concatenate([drums, np.zeros(m - len(drums))])
    law = channels.scale, channels.root, np.where(channels.absolute, 0.0, 1.0), np.asarray(start, dtype=np.float64)
    return Readings(channels.rows, channels.cables, V, np.linalg.inv(np.linalg.cholesky(V)), by_drums, *law)


def determined(readings: Readings, poses: FloatArray) -> Determined:
    """Return the information of the readings at poses (n, 7)."""
    rows, m, poses = readings.rows, len(readings.rows), np.ascontiguousarray(poses)
    values = kernels.span_lengths(rows, poses)
    A = kernels.span_rows_of(rows, poses)
    runs = np.isfinite(values).all(axis=1) & np.isfinite(A).all(axis=(1, 2))
    size = kernels.platform_size(rows)
    scaled = A / np.repeat([size, 1.0], 3)
    # an angle, converted to lengths at the attachment points
    force = np.linalg.norm(A[:, :, 3:], axis=2)
    looks = ~(force <= TURNS_ALONE * np.linalg.norm(A[:, :, :3], axis=2))
    seen = np.where(looks, force, 1.0 / size)
    seen[:, rows[:, kernels.KIND] == kernels.CABLE] = 1.0
    alike = scaled[runs] / seen[runs, :, None]
    eigenvalues = np.linalg.eigvalsh(np.swapaxes(alike, 1, 2) @ alike)
    good = eigenvalues[:, 0] > SINGULAR * eigenvalues[:, -1]
    known = runs.copy()
    known[runs] = good
    A, poses = A[known], poses[known]
    white = readings.white @ scaled[known]
    inverse = np.linalg.inv(np.swapaxes(white, 1, 2) @ white)
    units = np.repeat([1.0 / size, 1.0], 3)
    G = (inverse @ np.swapaxes(white, 1, 2) @ readings.white) * units[:, None]
    covariance = inverse * np.outer(units, units)
    covariance += (G * readings.drums) @ np.swapaxes(G, 1, 2)
    L = np.zeros((len(poses), m, 0))
    if readings.factor.shape[1]:
        begun = kernels.span_lengths(rows, readings.start[None])
        counts = kernels.counts_from_changes(rows, np.ascontiguousarray(values[known] - readings.relative * begun))
        moved = kernels.length_gradients(rows, poses, counts, readings.scales)
        moved -= readings.relative[:, None] * kernels.length_gradients(rows, readings.start[None], np.zeros((1, m)), readings.scales)
        L = -np.einsum("nmw,mwr->nmr", moved, readings.factor.reshape(m, kernels.WIDTH, -1))
        shift = G @ L
        covariance += shift @ np.swapaxes(shift, 1, 2)
    # a pressure angle is geometry: there all readings count alike, however well they are known
    plain = alike[good]
    by_each = np.linalg.inv(np.swapaxes(plain, 1, 2) @ plain) @ np.swapaxes(plain, 1, 2) / seen[known, None] * units[:, None]
    turns, moves = np.swapaxes(by_each[:, :3], 1, 2), np.swapaxes(by_each[:, 3:], 1, 2)
    arms = (se3.rotation(poses).as_matrix()[:, None] @ rows[:, kernels.ATTACHMENT_XYZ, None])[..., 0]
    looks = looks[known]
    speed = np.linalg.norm(np.where(looks[:, :, None], moves + np.cross(turns, arms), turns), axis=2)
    speed *= np.where(looks, seen[known], 1.0)
    return Determined(values[:, : readings.cables], runs, known, A, G, covariance, L, (1.0 / eigenvalues[good]).sum(axis=1), speed)


def faults_at(readings: Readings, found: Determined) -> tuple[Faults, FloatArray]:
    """Return the faults that the readings would show at k known poses, and the effect (k, M) on the tool position [mm] of one just not
    found."""
    m = len(readings.rows)
    S = readings.V + np.diag(readings.drums) + found.L @ np.swapaxes(found.L, 1, 2)
    # angles and lengths in units of their standard deviations
    unit = np.sqrt(np.diag(readings.V))
    root = np.linalg.inv(np.linalg.cholesky(S / np.outer(unit, unit)))
    white = root @ (found.A / unit[:, None] / np.linalg.norm(found.A / unit[:, None], axis=1, keepdims=True))
    basis = np.linalg.qr(white)[0]
    weight = np.swapaxes(root, 1, 2) @ (np.eye(m) - basis @ np.swapaxes(basis, 1, 2)) @ root
    faults = faults_shown(weight)
    faults = Faults(faults.smallest * unit, faults.apart * unit, faults.correlation)
    with np.errstate(invalid="ignore"):
        effect = np.linalg.norm(found.G[:, 3:], axis=1) * faults.smallest
    return faults, effect


def worst_figures(
    readings: Readings, positions: FloatArray, quaternions: FloatArray, *, points: FloatArray, pairs: IntArray, bodies: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Figures (F, n) and flags (n,) at (n, 3) positions over (k, 4) orientations, as `kernels.zone.scan` gives them."""
    out = np.repeat(np.array(kernels.WORST_START)[:, None], len(positions), axis=1)
    flags = np.zeros(len(positions), np.int64)
    for begin in range(0, len(positions), CHUNK):
        part = slice(begin, begin + CHUNK)
        for turn in quaternions:
            _worse(out[:, part], flags[part], readings, _at(positions[part], turn), points=points, pairs=pairs, bodies=bodies)
    return out, flags


def _at(positions: FloatArray, turn: FloatArray) -> FloatArray:
    return np.column_stack([positions, np.broadcast_to(turn, (len(positions), 4))])


def _worse(
    out: FloatArray, flags: IntArray, readings: Readings, poses: FloatArray, *, points: FloatArray, pairs: IntArray, bodies: FloatArray
) -> None:
    found = determined(readings, poses)
    flags |= np.where(found.known, 0, np.where(found.runs, kernels.SINGULAR, kernels.CANNOT_RUN))
    figures = np.repeat(np.array(kernels.WORST_START)[:, None], len(poses), axis=1)
    figures[[kernels.SPEED2, kernels.NORM2, kernels.U95_POSITION, kernels.U95_ROTATION, kernels.U95_ATTACHMENT]] = np.inf
    figures[kernels.SHORTEST], figures[kernels.LONGEST] = np.nan, np.nan
    if readings.cables:
        figures[kernels.SHORTEST], figures[kernels.LONGEST] = found.lengths.min(axis=1), found.lengths.max(axis=1)
        around = kernels.around(np.ascontiguousarray(readings.rows[: readings.cables]), np.ascontiguousarray(poses), pairs, bodies)
        figures[kernels.WRAP], figures[kernels.CLEARANCE] = around[:, 0], around[:, 1]
    known, covariance = found.known, found.covariance
    figures[kernels.SPEED2, known] = np.maximum(found.speed.max(axis=1), 1.0) ** 2
    figures[kernels.NORM2, known] = found.norm2
    figures[kernels.U95_POSITION, known] = radii_95(covariance[:, 3:, 3:])
    if len(points):
        figures[kernels.U95_ROTATION, known] = radii_95(covariance[:, :3, :3])
        of_points = [_of_point(covariance, se3.rotation(poses[known]).apply(point)) for point in points]
        figures[kernels.U95_ATTACHMENT, known] = np.max(of_points, axis=0)
    for row in (kernels.SHORTEST, kernels.CLEARANCE):
        out[row] = np.fmin(out[row], figures[row])
    for row in (
        kernels.SPEED2, kernels.NORM2, kernels.U95_POSITION, kernels.U95_ROTATION, kernels.U95_ATTACHMENT, kernels.LONGEST, kernels.WRAP,
    ):  # fmt: skip
        out[row] = np.fmax(out[row], figures[row])


def _of_point(covariance: FloatArray, arms: FloatArray) -> FloatArray:
    """(n,) 95 % radii of points at arms (n, 3) from the tool origin, which move by t + w x arm."""
    zero = np.zeros(len(arms))
    x, y, z = arms.T
    crossed = np.stack([np.stack(row, axis=1) for row in ((zero, z, -y), (-z, zero, x), (y, -x, zero))], axis=1)
    J = np.concatenate([crossed, np.broadcast_to(np.eye(3), crossed.shape)], axis=2)
    return radii_95(J @ covariance @ np.swapaxes(J, 1, 2))


def worst_faults(readings: Readings, positions: FloatArray, quaternions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, M) each, the worst of all (k, 4) orientations at (n, 3) positions: smallest fault of each channel that is found [mm, rad],
    smallest that is distinguished from one of any other, and the effect on the tool's place [mm] of one that is just not found; infinite
    where a channel is not controlled or the pose is not determined."""
    out = np.zeros((3, len(positions), len(readings.rows)))
    for begin in range(0, len(positions), CHUNK):
        part = slice(begin, begin + CHUNK)
        for turn in quaternions:
            found = determined(readings, _at(positions[part], turn))
            faults, effect = faults_at(readings, found)
            here = np.full((3, len(found.known), len(readings.rows)), np.inf)
            here[:, found.known] = faults.smallest, faults.apart, effect
            out[:, part] = np.maximum(out[:, part], here)
    return out[0], out[1], out[2]
