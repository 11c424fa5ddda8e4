"""Stays of a robot: rows that were measured while it stood still, and the mean of the readings of each target at each stay.

What the robot adds at a stay is one draw. Rows of one stay share it, however many they are; only what the instrument adds differs from
reading to reading. Readings of one target at one stay have the same derivatives, so that their mean and their scatter about it say all
that they can say.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.robots.identification.measurements import POSITION, ROTATION, Measurements

STILL, COARSE = 0.01, 0.1
"""Degrees or millimetres by which joint values of one stay may differ: the last digit they are stated with, between these two."""
DIGITS = 6
OUTLYING = 1e-6
"""Probability, over all readings, with which one of Gaussian errors would be taken for an outlier of its stay."""
HEAVY = 2.0
"""Times the scale of readings, about their median, that tails of a drift or a vibration may be longer than Gaussian ones."""
OTHER = 1e-3
"""Probability of the scatter of readings under what is stated of them, below which it is another."""
KINDS = (ROTATION, POSITION)


@dataclass(frozen=True)
class Scatter:
    """Scatter of readings about the mean of their stay: sum of squares and degrees of freedom, each (2,) of turns [rad²] and of positions
    and lengths [mm²]."""

    square: FloatArray
    freedom: FloatArray

    @property
    def variance(self) -> FloatArray:
        """(2,) of one reading in each component, 0 where nothing was read twice."""
        return np.asarray(self.square / np.maximum(self.freedom, 1.0))


@dataclass(frozen=True)
class Stays:
    """rows: one for each target, and station, of each stay, the mean of its readings, with `stay` and `readings`; of (N,): which of them
    each reading is part of, -1 where of none; scatter of the readings about these; times (2,): how many times the stated variances of turns
    and positions the readings scatter by, 1 where they are as stated or nothing is stated or read twice."""

    rows: Measurements
    of: IntArray
    scatter: Scatter
    times: FloatArray


def stays_of(joints: FloatArray, sliding: BoolArray) -> IntArray:
    """(N,) the number of each row's stay: rows that follow each other with the same joint values (N, n) [rad, mm], within their resolution.

    The same joint values visited later are another stay.
    """
    values = np.where(sliding, joints, np.degrees(joints))
    digits = next((k for k in range(DIGITS) if np.allclose(values * 10.0**k, np.round(values * 10.0**k), rtol=0.0, atol=1e-6)), DIGITS)
    still = 1.01 * np.clip(10.0**-digits, STILL, COARSE)
    out, first = np.zeros(len(values), dtype=np.int64), 0
    for i in range(1, len(values)):
        moved = bool((np.abs(values[i] - values[first]) > still).any())
        first = i if moved else first
        out[i] = out[i - 1] + moved
    return out


def read_at_stays(rows: Measurements, used: BoolArray) -> Stays:
    """The means of the readings that are used (N,), in the order of the rows."""
    of = np.full(len(rows), -1, dtype=np.int64)
    kinds = np.column_stack([rows.stay, rows.target_of, rows.station_of, rows.oriented, rows.placed])[used]
    _, first, inverse, counts = np.unique(kinds, axis=0, return_index=True, return_inverse=True, return_counts=True)
    place = np.argsort(np.argsort(first))
    of[used] = place[inverse.reshape(-1)]
    firsts, counts = np.flatnonzero(used)[np.sort(first)], counts[np.argsort(first)]
    means, scatter = rows.of(firsts), Scatter(np.zeros(2), np.zeros(2))
    if (counts == 1).all():
        return Stays(means, of, scatter, np.ones(2))

    def mean(values: FloatArray) -> FloatArray:
        out = np.zeros((len(firsts), *values.shape[1:]))
        np.add.at(out, of[used], values[used])
        return out / counts.reshape(-1, *[1] * (values.ndim - 1))

    quaternion = means.quaternion.copy()
    for i in np.flatnonzero((counts > 1) & means.oriented):
        quaternion[i] = Rotation.from_quat(rows.quaternion[of == i]).mean().as_quat()
    # joint values that are the same stay so to the last digit
    joints = means.joints + mean(np.where(of[:, None] >= 0, rows.joints - means.joints[of], 0.0))
    means = replace(means, joints=joints, position=mean(rows.position), quaternion=quaternion, length_mm=mean(rows.length_mm))
    means = replace(means, covariance=mean(rows.covariance), systematic=mean(rows.systematic), readings=counts)
    again = used & (counts[of] > 1)
    own = of[again]
    off = np.zeros((len(own), 6))
    off[:, POSITION] = np.nan_to_num(rows.position[again] - means.position[own])
    turned = rows.oriented[again]
    if turned.any():
        to = Rotation.from_quat(rows.quaternion[again][turned])
        off[turned, ROTATION] = (to * Rotation.from_quat(means.quaternion[own][turned]).inv()).as_rotvec()
    off[:, 3] += np.nan_to_num(rows.length_mm[again] - means.length_mm[own])
    known = rows.known[again]
    share = 1.0 - 1.0 / counts[own]
    stated = np.einsum("nii->ni", rows.covariance[again])
    square, freedom, times = np.zeros(2), np.zeros(2), np.ones(2)
    for kind, part in enumerate(KINDS):
        square[kind], freedom[kind] = (off[:, part] ** 2).sum(), (known[:, part] * share[:, None]).sum()
        if rows.stated[1 - kind] and freedom[kind] > 0.0 and stated[:, part][known[:, part]].all():
            met = float((off[:, part] ** 2 / np.where(known[:, part], stated[:, part], 1.0)).sum())
            if min(chi2.sf(met, freedom[kind]), chi2.cdf(met, freedom[kind])) < OTHER / 2.0:
                times[kind] = met / freedom[kind]
    # errors that are stated and not seen between readings are the same in all of them
    size = np.repeat(np.sqrt(times[:, None] / counts + np.maximum(1.0 - times[:, None], 0.0)), 3, axis=0).T
    means = replace(means, covariance=means.covariance * size[:, :, None] * size[:, None, :])
    return Stays(means, of, Scatter(square, freedom), times)


def agreeing(rows: Measurements, used: BoolArray) -> BoolArray:
    """(N,) which of the used rows agree with the median of three or more readings of their stay; others are not asked."""
    kinds = np.column_stack([rows.stay, rows.target_of, rows.station_of])
    _, of, counts = np.unique(kinds[used], axis=0, return_inverse=True, return_counts=True)
    of, at = of.reshape(-1), np.flatnonzero(used)
    out = used.copy()
    values = np.column_stack([rows.position, rows.length_mm])[at]
    values = np.where(np.isnan(values), 0.0, values)
    asked = counts[of] > 2
    if not asked.any():
        return out
    square = np.zeros(len(at))
    order = np.argsort(of, kind="stable")
    for part in np.split(order, np.cumsum(counts)[:-1]):
        if len(part) > 2:
            square[part] = ((values[part] - np.median(values[part], axis=0)) ** 2).sum(axis=1)
    stated = np.einsum("nii->n", rows.covariance[:, POSITION, POSITION])[at] / 3.0
    scale = np.maximum(float(np.median(square[asked])) / chi2.ppf(0.5, 3), stated)
    out[at] &= ~asked | (square <= HEAVY**2 * scale * chi2.isf(OUTLYING / len(rows), 3))
    return out
