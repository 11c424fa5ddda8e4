"""How a place of the cell is determined: the ellipsoid of the position, and the cable that tells it worst."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.accuracy.readings import Readings, determined
from lmeasure.accuracy.zone import make_plan
from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.kernels import ATTACHMENT_XYZ, WIDTH, counts_from_changes, length_gradients, span_lengths, span_rows_of
from lmeasure.rig import CalibrationRecord, Rig

CHUNK = 4096


class Ellipsoids(NamedTuple):
    """covariance (n, 3, 3) [mm^2] of the tool origin, base axes; weakest (n,) index of the cable with the largest pressure angle, angle_deg
    (n,) that angle. Where a cable cannot run or the pose is singular: NaN, 0 and 90."""

    covariance: FloatArray
    weakest: IntArray
    angle_deg: FloatArray


def ellipsoids(rig: Rig, calibration: CalibrationRecord | None, places: FloatArray, turn: Rotation, *, start: FloatArray) -> Ellipsoids:
    """Of (n, 3) places of the tool origin [mm] at one orientation base_from_tool, by the laws of `accuracy.zone.map_zone`; start (7,): pose
    at which the counters are zeroed."""
    one = Rotation.from_quat([turn.as_quat()])
    plan = make_plan(rig, calibration, places, one, start=start)
    if plan.channels is not None:
        return _of_channels(plan.channels, se3.pose(places, turn))
    found = [
        _some(rig, plan.variance, plan.factor, se3.pose(some, turn), start) for some in np.split(places, range(CHUNK, len(places), CHUNK))
    ]
    return Ellipsoids(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _of_channels(readings: Readings, poses: FloatArray) -> Ellipsoids:
    found = determined(readings, poses)
    covariance, weakest, angle = np.full((len(poses), 3, 3), np.nan), np.zeros(len(poses), dtype=np.int64), np.full(len(poses), 90.0)
    covariance[found.known] = found.covariance[:, 3:, 3:]
    cables = found.speed[:, : readings.cables]
    weakest[found.known] = cables.argmax(axis=1)
    angle[found.known] = np.degrees(np.arccos(1.0 / np.maximum(cables.max(axis=1), 1.0)))
    return Ellipsoids(covariance, weakest, angle)


def _some(rig: Rig, variance: FloatArray, factor: FloatArray, poses: FloatArray, start: FloatArray) -> Ellipsoids:
    rows, m = rig.cable_rows(), len(rig.cable)
    lengths = span_lengths(rows, poses)
    A = span_rows_of(rows, poses)
    size = max(float(np.linalg.norm(rows[:, :3], axis=1).max()), 1.0)
    # moments in lengths of the rig: else a radian and a millimetre would be weighed against each other
    scaled = A / np.array([size] * 3 + [1.0] * 3)
    runs = np.isfinite(lengths).all(axis=1) & np.isfinite(scaled).all(axis=(1, 2))
    runs[runs] = np.linalg.cond(scaled[runs]) < 1e9
    covariance = np.full((len(poses), 3, 3), np.nan)
    weakest, angle = np.zeros(len(poses), dtype=np.int64), np.full(len(poses), 90.0)
    if not runs.any():
        return Ellipsoids(covariance, weakest, angle)
    weights = 1.0 / np.sqrt(variance)
    twists = np.linalg.pinv(scaled[runs] * weights[:, None]) * weights
    turns, gain = np.swapaxes(twists[:, :3] / size, 1, 2), twists[:, 3:]
    every = gain * np.sqrt(variance)
    if factor.shape[1]:
        begun = span_lengths(rows, start[None])
        counts = counts_from_changes(rows, np.ascontiguousarray(lengths[runs] - begun))
        scales = rig.scales()
        moved = length_gradients(rows, np.ascontiguousarray(poses[runs]), counts, scales)
        moved = moved - length_gradients(rows, start[None], np.zeros((1, m)), scales)
        errors = np.einsum("nmw,mwr->nmr", moved, factor.reshape(m, WIDTH, -1))
        every = np.concatenate([every, gain @ errors], axis=2)
    covariance[runs] = every @ np.swapaxes(every, 1, 2)
    # the pressure angle is that between a cable and the way of its attachment point while the other lengths stay
    arms = se3.rotation(poses[0]).apply(rows[:, ATTACHMENT_XYZ])
    speeds = np.linalg.norm(np.swapaxes(gain, 1, 2) + np.cross(turns, arms), axis=2)
    weakest[runs] = speeds.argmax(axis=1)
    angle[runs] = np.degrees(np.arccos(np.minimum(1.0, 1.0 / speeds.max(axis=1))))
    return Ellipsoids(covariance, weakest, angle)
