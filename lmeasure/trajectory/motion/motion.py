"""Motion of the tool: velocity, acceleration and jerk from a trajectory, by local cubics over a window that the data choose."""

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from lmeasure.core import QUATERNION_COLUMNS, FloatArray, IntArray, TrajectoryError, se3
from lmeasure.io import files
from lmeasure.kernels import LEAST, TERMS, local_cubics
from lmeasure.recording import POSITION_COLUMNS
from lmeasure.text import message
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.motion.spectrum import HIGHEST, Vibration, smoothing_bias, vibrations
from lmeasure.trajectory.time.stamps import Stamps, stamps_of

HALF_WIDTH_S = 0.02  # The widest window that is chosen, unless the usual interval needs a wider one
NARROWER = 1.5  # Times as narrow as the one before that the next window is, among which one is chosen
GAIN = 0.8  # Relative to the error of the widest window: a narrower one is chosen below it
CHOSEN_BY = 20_000  # Samples for the choice of a window, in pieces
FULL = 0.5 * (LEAST + 1)
"""Periods of a half width that holds enough samples on both sides."""
WIDEST_S = 1.0
"""Widest default interval; if more is needed, times are likely in another unit."""
COVERAGE = 0.95
NEAR = 6.0  # Standard uncertainties below the largest speed that another may lie and still be the one that erred most
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Motion:
    """Smoothed poses and their derivatives, NaN where there is no pose or too few neighbours.

    time_s (n,); poses (n, 7) base_from_tool; velocity, acceleration, jerk (n, 6) of (rotation [rad]; tool origin [mm]) per s, s^2, s^3, in
    base axes; u_pose, u_velocity, u_acceleration, u_jerk (n, 6) standard uncertainties in the same order, from the independent errors
    of the samples and the bias of the window (`spectrum.smoothing_bias`): an error that all samples share moves the poses and hardly their
    derivatives. u_speed_mm_s (n,): of the speed. path_mm (n,): way of the tool origin since the beginning, over gaps as the crow flies.
    half_width_s: of the window, or the knot interval of a curve. stamps: when the samples were taken, which is time_s; where the recorded
    stamps jitter, all uncertainties hold it. vibration: of the tool origin, strongest first; highest_hz: the samples show nothing faster.
    """

    time_s: FloatArray
    poses: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    u_pose: FloatArray
    u_velocity: FloatArray
    u_acceleration: FloatArray
    u_jerk: FloatArray
    u_speed_mm_s: FloatArray
    path_mm: FloatArray
    half_width_s: float
    stamps: Stamps
    vibration: tuple[Vibration, ...] = ()
    highest_hz: float = np.nan

    @property
    def speed_mm_s(self) -> FloatArray:
        """(n,) speed of the tool origin."""
        return np.asarray(np.linalg.norm(self.velocity[:, 3:], axis=1))

    def largest_speed(self) -> tuple[float, float]:
        """Return the largest of all speeds [mm/s] and its U95: the largest of many has an upward error, at most that of as many independent
        windows as have about its speed (Bonferroni)."""
        speed = self.speed_mm_s
        top = int(np.nanargmax(speed))
        u = float(self.u_speed_mm_s[top])
        near = speed >= speed[top] - NEAR * u
        windows = max(1.0, float(np.diff(self.time_s, prepend=self.time_s[0])[near].sum()) / self.half_width_s)
        return float(speed[top]), float(-scipy.special.ndtri(0.5 * (1.0 - COVERAGE) / windows) * u)

    def columns(self) -> dict[str, Any]:
        """Columns of a motion file; with the recorded stamps and the uncertainty of the times where those jitter."""
        out: dict[str, Any] = {"time_s": self.time_s}
        out |= dict(zip(POSITION_COLUMNS, self.poses[:, :3].T, strict=True))
        out |= dict(zip(QUATERNION_COLUMNS, self.poses[:, 3:].T, strict=True))
        out |= {"speed_mm_s": self.speed_mm_s, "u_speed_mm_s": self.u_speed_mm_s, "path_mm": self.path_mm}
        for letters, power, values, u in (
            (("v", "w"), "", self.velocity, self.u_velocity),
            (("a", "alpha"), "2", self.acceleration, self.u_acceleration),
            (("j", "beta"), "3", self.jerk, self.u_jerk),
        ):
            for prefix, table in (("", values), ("u_", u)):
                out |= {f"{prefix}{letters[0]}{axis}_mm_s{power}": table[:, 3 + i] for i, axis in enumerate(_AXES)}
                out |= {f"{prefix}{letters[1]}{axis}_rad_s{power}": table[:, i] for i, axis in enumerate(_AXES)}
        if self.stamps.kind != "sound":
            out |= {"stamp_s": self.stamps.stamp_s, "u_time_s": np.full(len(self.time_s), self.stamps.u_time_s)}
        return out


def motion_of(trajectory: Trajectory, half_width_s: float | None = None, stamps: Stamps | None = None) -> Motion:
    """Return the motion of a trajectory by cubics over +- half_width_s, or wider if even times for jittering stamps need it; by default
    that of `_chosen`, at most `HALF_WIDTH_S` or the need of the usual interval. None goes over a gap. stamps: known judgement of the times,
    else by the motion itself.

    Without measured orientations there are no rotations; without a stated uncertainty there is none. TrajectoryError if no window is full.
    """
    requested = half_width_s is not None
    half_width_s = HALF_WIDTH_S if half_width_s is None else half_width_s
    if not half_width_s > 0:
        raise TrajectoryError(message("error.half_width_of_the", half_width_s=half_width_s))
    placed = np.asarray(~np.isnan(trajectory.poses[:, :3]).any(axis=1))
    turned = not (np.isnan(trajectory.poses[:, 3:]).all() and placed.any())
    given = np.ascontiguousarray(trajectory.poses) if turned else np.where(placed[:, None], trajectory.poses, np.nan)
    if not turned:
        given[placed, 3:] = (0.0, 0.0, 0.0, 1.0)
    stamps = stamps or stamps_of(trajectory)
    time_s = stamps.time_s
    if (stamps.kind == "even" or not requested) and placed.sum() > 1:
        # a window that ends at a sample holds it or not by the last digit of the period
        needed = FULL * float(np.median(np.diff(time_s[placed])))
        half_width_s = max(half_width_s, needed) if requested or needed <= WIDEST_S else half_width_s
    if half_width_s > (lasts := float(time_s[-1] - time_s[0])) > 0.0:
        raise TrajectoryError(message("error.motion_a_window_of", half_width_s=half_width_s, lasts=lasts))
    u = np.sqrt(np.einsum("nii->ni", trajectory.random))
    u[:, :3] += np.nan if not turned or "rotation" in trajectory.absent else 0.0
    u[:, 3:] += np.nan if "position" in trajectory.absent else 0.0
    parts = _parts(given, stamps.stretch)
    if not requested:
        half_width_s = _chosen(time_s, given, u, stamps, parts, half_width_s)
    poses, derivatives, factors = _local_cubics(time_s, given, half_width_s, stamps.stretch)
    if np.isnan(poses[:, 0]).all():
        apart = float(np.median(np.diff(time_s[placed]))) if placed.sum() > 1 else np.nan
        determined = "" if np.isnan(apart) else message("motion.too_far_apart", seconds=apart)
        raise TrajectoryError(message("error.motion_no_window_of", half_width_s=half_width_s, least=LEAST, determined=determined))
    if not turned:
        poses[:, 3:] = derivatives[:, :, :3] = np.nan
    steps = np.diff(poses[~np.isnan(poses[:, 0]), :3], axis=0)
    path = np.full(len(poses), np.nan)
    path[~np.isnan(poses[:, 0])] = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    rates = [derivatives[:, a] for a in range(3)]
    u_speed = factors[:, 1] * _along(rates[0][:, 3:], u[:, 3:])
    if stamps.kind != "sound":
        # an error of an instant is one of the pose by the twist there, one of the rate is one of each derivative by its order
        speed = np.linalg.norm(rates[0][:, 3:], axis=1)
        u = np.hypot(u, np.abs(rates[0]) * stamps.u_time_s)
        u_speed = np.hypot(u_speed, speed * np.hypot(factors[:, 1] * stamps.u_time_s, stamps.u_rate))
    bias = _bias(time_s, given, poses, u, factors, parts, half_width_s)
    u_speed = np.hypot(u_speed, _along(rates[0][:, 3:], bias[:, 1, 3:]))
    u_pose, *u_rates = (np.hypot(factors[:, a, None] * u, bias[:, a]) for a in range(TERMS))
    if stamps.kind != "sound":
        u_rates = [np.hypot(v, order * stamps.u_rate * np.abs(rate)) for order, v, rate in zip((1, 2, 3), u_rates, rates, strict=True)]
    velocity, acceleration, jerk = rates
    u_velocity, u_acceleration, u_jerk = u_rates
    smooth, uncertain = (time_s, poses, velocity, acceleration, jerk), (u_pose, u_velocity, u_acceleration, u_jerk, u_speed)
    highest_hz = HIGHEST / float(np.median(np.diff(time_s[placed]))) if placed.sum() > 1 else np.nan
    return Motion(*smooth, *uncertain, path, half_width_s, stamps, vibrations(time_s, given[:, :3], parts), highest_hz)


def _parts(poses: FloatArray, stretch: IntArray | None) -> list[slice]:
    """Runs of samples that have poses (n, 7), with no gap between stretches (n,) in them."""
    known = ~np.isnan(poses[:, 0])
    same = known[1:] & known[:-1]
    if stretch is not None:
        same &= np.diff(stretch) == 0
    edges = [0, *(np.flatnonzero(~same) + 1).tolist(), len(poses)]
    return [slice(a, b) for a, b in pairwise(edges) if known[a]]


def _chosen(time_s: FloatArray, poses: FloatArray, u: FloatArray, stamps: Stamps, parts: list[slice], widest_s: float) -> float:
    """The half width, at most widest_s, whose velocities have the least noise and bias together; the widest where none is much better."""
    if not np.isfinite(u[:, 3:]).any() or max((p.stop - p.start for p in parts), default=0) < 2:
        return widest_s
    narrowest = FULL * float(np.median(np.concatenate([np.diff(time_s[p]) for p in parts])))
    widths = widest_s / NARROWER ** np.arange(int(max(np.log(widest_s / narrowest) / np.log(NARROWER), 0.0)) + 1)
    if len(widths) < 2:
        return widest_s
    most = max(CHOSEN_BY // len(parts), 500)
    pieces = [slice(a, min(a + most, p.stop)) for p in parts for a in [p.start + max((p.stop - p.start - most) // 2, 0)]]
    errors = []
    for width in widths:
        square = []
        for p in pieces:
            found, _, factors = local_cubics(np.ascontiguousarray(time_s[p]), np.ascontiguousarray(poses[p]), float(width))
            own = u[p]
            if stamps.kind != "sound":
                own = np.hypot(own, stamps.u_time_s * _speeds(time_s[p], poses[p]))
            bias = _bias(time_s[p], poses[p], found, own, factors, [slice(0, len(own))], float(width))
            square.append(((factors[:, 1, None] * own[:, 3:]) ** 2 + bias[:, 1, 3:] ** 2).ravel())
        errors.append(float(np.sqrt(np.nanmean(np.concatenate(square)))) if square else np.inf)
    best = int(np.nanargmin(errors)) if np.isfinite(errors).any() else 0
    return float(widths[best if errors[best] < GAIN * errors[0] else 0])


def _speeds(time_s: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 1) speed [mm/s] between neighbouring samples."""
    return np.linalg.norm(np.gradient(poses[:, :3], time_s, axis=0), axis=1)[:, None] if len(time_s) > 1 else np.zeros((len(time_s), 1))


def _bias(
    time_s: FloatArray, poses: FloatArray, smooth: FloatArray, u: FloatArray, factors: FloatArray, parts: list[slice], half_width_s: float
) -> FloatArray:
    """Return the (n, 4, 6) standard uncertainty of smoothed poses (n, 7) and of their derivatives by smoothing; at ends, where the window
    has one side, it is larger like that of noise."""
    out = np.zeros((len(time_s), TERMS, 6))
    usual = np.nanmedian(factors, axis=0)
    for p in parts:
        there = np.flatnonzero(~np.isnan(smooth[p, 0])) + p.start
        if len(there) < 2:
            continue
        left = np.zeros((len(there), 6))
        left[:, 3:] = poses[there, :3] - smooth[there, :3]
        if not np.isnan(u[there, :3]).all() and not np.isnan(smooth[there, 3]).any():
            left[:, :3] = (se3.rotation(poses[there]) * se3.rotation(smooth[there]).inv()).as_rotvec()
        noise = np.nan_to_num(u[there])
        found = smoothing_bias(left, noise, float(np.median(np.diff(time_s[there]))), half_width_s)
        out[there] = found * np.maximum(factors[there] / usual, 1.0)[:, :, None]
    return np.asarray(out)


def _local_cubics(
    time_s: FloatArray, poses: FloatArray, half_width_s: float, stretch: IntArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`kernels.local_cubics`, none of them over a gap between stretches (n,)."""
    edges = [] if stretch is None else (np.flatnonzero(np.diff(stretch)) + 1).tolist()
    parts = [
        local_cubics(np.ascontiguousarray(time_s[a:b]), np.ascontiguousarray(poses[a:b]), half_width_s)
        for a, b in pairwise([0, *edges, len(time_s)])
    ]
    found, derivatives, factors = (np.concatenate(each) for each in zip(*parts, strict=True))
    return found, derivatives, factors


def _along(velocity: FloatArray, u: FloatArray) -> FloatArray:
    """(n,) standard uncertainty of a length along velocities (n, 3), from those of its components (n, 3)."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    unit = np.divide(velocity, speed, out=np.full_like(velocity, np.sqrt(1.0 / 3.0)), where=speed > 0.0)
    return np.asarray(np.linalg.norm(unit * u, axis=1))


def write_motion(path: Path, motion: Motion) -> None:
    """Write .parquet or .csv, whole or not at all."""
    notes = motion.stamps.notes
    about = {"half_width_s": repr(motion.half_width_s), "highest_hz": repr(motion.highest_hz)}
    if motion.vibration:
        about["vibration"] = json.dumps([{"axis": v.axis} | v.values() for v in motion.vibration])
    if notes:
        about["note"] = "; ".join(map(str, notes))
    files.write_table(path, motion.columns(), about)
