"""Slips in the files of a campaign as hypotheses: misread angles, exchanged poses, single numbers that are wrong."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.calibration.campaign.campaign import Break, Campaign
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.hold_out import poses_and_visits, shifted_lengths
from lmeasure.core import BoolArray, FileFormatError, FloatArray, GeometryError, IntArray, conventions, se3
from lmeasure.sensors import counts_from_poses
from lmeasure.text import message

SAME_RAD = 1e-6
SOLVED = 4  # values of a counter that slipped, or whose point moved


@dataclass(frozen=True)
class Hypothesis:
    """Another reading of a campaign: code and text of its finding, and the campaign, with its rig, as they would be.

    removed: how many readings it sets aside, or spends on values of its own; curable: whether the rig is corrected with it.
    """

    code: str
    text: str
    campaign: Campaign
    channel: str | None = None
    pose: str | None = None
    value: float | None = None
    removed: int = 0
    curable: bool = True


def misread_poses(campaign: Campaign) -> Iterator[Hypothesis]:
    """Yield other readings of the whole file of poses: angles in another convention, columns or rows in another
    order."""
    yield from _conventions(campaign)
    for order in [o for o in itertools.permutations(range(3)) if o != (0, 1, 2)]:
        text = message("calibration.reference_poses_fit_when", order=tuple("xyz"[i] for i in order))
        rows = campaign.poses.rows[:, [*order, 3, 4, 5, 6]]
        yield Hypothesis("columns", text, replace(campaign, poses=replace(campaign.poses, rows=rows)))
    yield from _exchanged(campaign)


def _conventions(campaign: Campaign) -> Iterator[Hypothesis]:
    """Yield the poses with their angles, or quaternions, read in each other way that occurs."""
    own = campaign.rig.angles
    for name, rotation in _readings(campaign):
        rows = se3.pose(campaign.poses.rows[:, :3], rotation)
        text = message("calibration.reference_poses_fit_when_their", name=name, own=own)
        yield Hypothesis("angles", text, replace(campaign, poses=replace(campaign.poses, rows=rows), angles=None))


def _readings(campaign: Campaign) -> Iterator[tuple[str, Rotation]]:
    own, poses = conventions.convention(campaign.rig.angles), campaign.poses
    files = _both_branches(own, poses.rotation)
    if campaign.angles is not None and _write(own, campaign.angles, poses.rotation):
        files = [campaign.angles]
    to_degrees = np.degrees(1.0) if own.axes == "rotvec" else 1.0
    for values in files:
        for order in itertools.permutations(range(3)):
            for other in conventions.CONVENTIONS.values():
                straight = order == (0, 1, 2)
                if other.axes == "rotvec" and not straight:
                    continue
                to_other = np.radians(1.0) if other.axes == "rotvec" else 1.0
                for factor in (1.0, np.degrees(1.0)):
                    if (other is own and straight and factor == 1.0) or (other.axes == "rotvec" and factor != 1.0 and own.axes == "rotvec"):
                        continue
                    given = values[:, order] * to_degrees * to_other * factor
                    reading = message("slips.convention" if factor == 1.0 else "slips.other_unit", name=other.name)
                    if not straight:
                        order_shown = ", ".join(own.columns[i] for i in order)
                        code = "slips.order" if factor == 1.0 else "slips.order_other_unit"
                        reading = message(code, name=other.name, order=order_shown)
                    try:
                        yield reading, conventions.rotation_from_angles(other.name, given)
                    except FileFormatError:
                        continue
    yield message("slips.inverse", name=own.name), poses.rotation.inv()
    for name, shift in (("qw, qx, qy, qz", -1), ("qy, qz, qw, qx", 1)):
        yield message("slips.quaternion_order", order=name), Rotation.from_quat(np.roll(poses.rows[:, 3:], shift, axis=1))


def _write(own: conventions.AngleConvention, angles: FloatArray, rotation: Rotation) -> bool:
    """Return whether angles (n, 3) write these rotations."""
    return bool((conventions.rotation_from_angles(own.name, angles) * rotation.inv()).magnitude().max() < SAME_RAD)


def _both_branches(own: conventions.AngleConvention, rotation: Rotation) -> list[FloatArray]:
    """Return both triples of angles (n, 3) that write the same rotations; a rotation vector is one."""
    angles = conventions.angles_from_rotation(own.name, rotation)
    if own.axes == "rotvec":
        return [angles]
    turned = angles + np.asarray(own.offset_deg)
    middle = -turned[:, 1] if own.axes[0] == own.axes[2] else 180.0 - turned[:, 1]
    other = np.column_stack([turned[:, 0] + 180.0, middle, turned[:, 2] + 180.0]) - np.asarray(own.offset_deg)
    return [angles, np.asarray(180.0 - np.mod(180.0 - other, 360.0))]


def _exchanged(campaign: Campaign) -> Iterator[Hypothesis]:
    """Yield the campaign with poses exchanged as the nominal rig's lengths have it: every cycle alone, and all of them."""
    drums = [j for j, c in enumerate(campaign.cables) if c.is_cable]
    counted = np.isfinite(campaign.counts[:, drums]).all(axis=1)
    reference = np.setdiff1d(campaign.reference_of, campaign.reference_of[~counted])
    order = _assigned(campaign, reference)
    if order is None:
        return
    cycles = _cycles(order)
    if not cycles:
        return
    for some in [*([cycle] for cycle in cycles), *([cycles] if len(cycles) > 1 else [])]:
        rows = np.arange(len(reference))
        for cycle in some:
            rows[cycle] = order[cycle]
        names = [campaign.poses.names[reference[i]] for cycle in some for i in cycle]
        text = message("calibration.poses_counts_fit_when", poses=tuple(names[:-1]), last=names[-1])
        place = np.arange(len(campaign.poses))
        place[reference] = reference[rows]
        moved = place[campaign.reference_of]
        poses = campaign.poses
        other = replace(poses.of(moved), names=poses.names)
        angles = None if campaign.angles is None else campaign.angles[moved]
        yield Hypothesis("exchanged_poses", text, replace(campaign, poses=other, angles=angles), pose=names[0], value=float(len(names)))


def _assigned(campaign: Campaign, reference: IntArray) -> IntArray | None:
    """Return (r,) the best reference pose for each one's counts, each used once; None if the nominal rig does not determine it.

    Lengths since the zero pose differ from those since another by a constant of each cable, which the means over all poses take off.
    """
    cost = np.zeros((len(reference), len(reference)))
    for j, cable in enumerate(campaign.cables):
        if not cable.is_cable:
            continue
        rows = campaign.poses.rows
        try:
            predicted = counts_from_poses(campaign.rig, rows, rows[campaign.zero[j]], (cable,))[reference, 0]
        except GeometryError:
            return None
        own = np.array([campaign.counts[campaign.reference_of == i, j].mean() for i in reference])
        drum = campaign.rig.point(cable.from_point).drum
        off = (own - own.mean())[:, None] - (predicted - predicted.mean())
        cost += (off * drum.count_length_mm) ** 2
    if not cost.any():
        return None
    return np.asarray(scipy.optimize.linear_sum_assignment(cost)[1], dtype=np.int64)


def _cycles(order: IntArray) -> list[list[int]]:
    """Return the cycles of a permutation that move anything."""
    out, seen = [], set[int]()
    for first in range(len(order)):
        cycle: list[int] = []
        i = first
        while i not in seen:
            seen.add(i)
            cycle.append(i)
            i = int(order[i])
        if len(cycle) > 1:
            out.append(cycle)
    return out


def set_aside(model: Model, theta: FloatArray, most: int) -> list[Hypothesis]:
    """Return the campaigns without one pose or one reading, or with a counter that slipped, those that a linear fit prefers: linearised at
    the nominal rig, and at theta."""
    candidates = [*_poses_aside(model), *_readings_aside(model), *_counters_aside(model)]
    best: dict[int, float] = {}
    for at in [start for start in (model.start, theta) if np.isfinite(model.residuals(start)).all()]:
        J = model.jacobian(at)
        along = J * model.parameters.width
        P = np.asarray(np.linalg.inv(model.covariance(at) + along @ along.T), dtype=np.float64)
        seen = P @ (model.residuals(at) - J @ (at - model.parameters.nominal))
        left = [_fall(P, seen, columns) - 2.0 * removed for columns, removed, _ in candidates]
        for i in np.argsort(left)[::-1][:most].tolist():
            first = candidates[i][0][:, 0]
            best[i] = float(first @ seen / (first @ P @ first))
    every = [(candidates[i][2](), size) for i, size in best.items()]
    # modelled less measured: a counter that lost counts reads less than the model
    return [replace(h, value=-size) if h.code == "slip" else h for h, size in every]


def _fall(P: FloatArray, seen: FloatArray, columns: FloatArray) -> float:
    """Return by how much chi-squared falls with columns (e, c) free."""
    pull = columns.T @ seen
    return float(pull @ np.linalg.pinv(columns.T @ P @ columns, hermitian=True) @ pull)


_Candidate = tuple[FloatArray, int, "partial[Hypothesis]"]


def _poses_aside(model: Model) -> Iterator[_Candidate]:
    campaign = model.campaign
    for visits in poses_and_visits(campaign):
        which = np.isin(np.arange(len(campaign.counts)), visits)[:, None] & np.isfinite(campaign.counts)
        columns = shifted_lengths(model, visits)
        name = campaign.poses.names[visits[0]]
        text = message("calibration.pose_other_poses_contradict_agree", pose=name)
        if columns.shape[1] and _left(campaign, which):
            yield columns, int(which.sum()), partial(_without, campaign, which, "outlier", text, pose=name)


def _readings_aside(model: Model) -> Iterator[_Candidate]:
    campaign = model.campaign
    for e, (i, j) in enumerate(zip(model.pose_index, model.cable_index, strict=True)):
        column = np.zeros((model.equations, 1))
        column[e] = 1.0
        yield column, 1, _one_reading(campaign, int(i), int(j))
    for j in np.flatnonzero(campaign.from_zero):
        if _left(campaign, _one(campaign, int(campaign.zero[j]), int(j))):
            yield (model.cable_index == j).astype(np.float64)[:, None], 1, _one_reading(campaign, int(campaign.zero[j]), int(j))


def _one(campaign: Campaign, pose: int, channel: int) -> BoolArray:
    which = np.zeros(campaign.counts.shape, dtype=np.bool_)
    which[pose, channel] = True
    return which


def _one_reading(campaign: Campaign, pose: int, j: int) -> "partial[Hypothesis]":
    name, channel = campaign.poses.names[pose], campaign.cables[j].channel
    counter = campaign.rig.counter(campaign.cables[j])
    recorded = float(campaign.counts[pose, j] * counter.scale / counter.count_sign)
    text = message("calibration.pose_channel_all_other", pose=name, channel=channel, count=recorded)
    return partial(_without, campaign, _one(campaign, pose, j), "outlier", text, channel=channel, pose=name, value=recorded)


def _counters_aside(model: Model) -> Iterator[_Candidate]:
    campaign = model.campaign
    for j in np.flatnonzero(campaign.from_zero):
        counted = np.flatnonzero(np.isfinite(campaign.counts[:, j]))
        order = counted if campaign.counted is None else counted[np.argsort(campaign.counted[counted, j], kind="stable")]
        for k in range(2, len(order) - 1):
            column = ((model.cable_index == j) & np.isin(model.pose_index, order[k:])).astype(np.float64)[:, None]
            name, channel = campaign.poses.names[order[k]], campaign.cables[j].channel
            text = message("calibration.slipped", channel=channel, pose=name)
            other = replace(campaign, breaks=(*campaign.breaks, Break(channel, name)))
            yield column, SOLVED, partial(Hypothesis, "slip", text, other, channel, name, removed=SOLVED)


def _left(campaign: Campaign, which: BoolArray) -> bool:
    """Return whether every channel keeps two readings."""
    return bool((np.isfinite(np.where(which, np.nan, campaign.counts)).sum(axis=0) >= 2).all())


def _without(
    campaign: Campaign,
    which: BoolArray,
    code: str,
    text: str,
    *,
    channel: str | None = None,
    pose: str | None = None,
    value: float | None = None,
) -> Hypothesis:
    """Return the campaign without the readings which (n, m); a channel whose zero pose is among them counts from another pose."""
    counts, zero = np.where(which, np.nan, campaign.counts), campaign.zero.copy()
    for j in np.flatnonzero(which[campaign.zero, np.arange(len(zero))] & campaign.from_zero):
        zero[j] = int(np.flatnonzero(np.isfinite(counts[:, j]))[0])
    other = replace(campaign, counts=counts, zero=zero)
    if campaign.zero_variance is not None and campaign.dwell_variance is not None:
        moved = zero != campaign.zero
        other = replace(other, zero_variance=np.where(moved, campaign.dwell_variance[zero, np.arange(len(zero))], campaign.zero_variance))
    return Hypothesis(code, text, other, channel, pose, value, removed=int(which.sum()))
