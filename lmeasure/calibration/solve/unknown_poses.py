"""Poses that are found with the rig: the unknown components, whether the counts determine them, and initial orientations."""

import math
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.calibration.campaign.campaign import Campaign, of_cables
from lmeasure.calibration.solve.residuals import ROTATIONS
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import CalibrationError, FloatArray, IntArray, se3
from lmeasure.estimation import Parameters
from lmeasure.kernels import CABLE, KIND, span_lengths, span_rows
from lmeasure.text import message

TURNS = 512  # orientations of a single pose that are looked at
FOLLOWED = 4  # and of these, followed up
CANDIDATES = 3  # orientations of all poses that are followed up


def free_components(campaign: Campaign, trusted: bool) -> tuple[int, ...]:
    """Return the unknown ones of `unknowns.COMPONENTS` of the poses: none of trusted whole poses.

    CalibrationError if nothing determines them.
    """
    used = list(dict.fromkeys(c.to_point for c in campaign.drums))
    if len(used) == 1:
        name = used[0]
        if not campaign.poses.oriented and any(campaign.rig.tool[name]):
            raise CalibrationError(message("error.reference_poses_csv_has", name=name))
        free: tuple[int, ...] = () if trusted else (3, 4, 5)
    elif trusted:
        free = () if campaign.poses.oriented else ROTATIONS
    else:
        free = (0, 1, 2, 3, 4, 5)
    what = message("calibration.without_orientations") if trusted else "--self"
    if not trusted and len(campaign.cables) <= len(free):
        body, least = (message("calibration.one_point"), 4) if len(free) == 3 else (message("calibration.a_body"), 7)
        kind = message("calibration.of_cables" if len(campaign.drums) == len(campaign.cables) else "calibration.of_channels")
        raise CalibrationError(
            message("error.self_bring_equations_at", n_cables=len(campaign.cables), kind=kind, n=len(free), body=body, least=least)
        )
    if 0 in free:
        points = np.array([campaign.rig.tool[name] for name in used])
        if np.linalg.matrix_rank(points - points[0], tol=1e-6 * max(1.0, float(np.ptp(points)))) < 2:
            raise CalibrationError(message("error.the_attachment_points_lie", where=what, used=", ".join(used)))
    return free


def counted_poses(campaign: Campaign) -> Campaign:
    """The campaign without the poses at which nothing was counted: of these nothing can be determined."""
    keep = np.flatnonzero(np.isfinite(campaign.counts).any(axis=1))
    if len(keep) == len(campaign.poses):
        return campaign
    place = np.full(len(campaign.poses), -1)
    place[keep] = np.arange(len(keep))
    # a reference pose counted only at later visits takes the first of these
    _, first, group = np.unique(campaign.reference_of[keep], return_index=True, return_inverse=True)
    p = campaign.poses
    poses = replace(
        p,
        names=tuple(p.names[i] for i in keep),
        rows=p.rows[keep],
        u_position_mm=p.u_position_mm[keep],
        u_rotation_rad=p.u_rotation_rad[keep],
        covariance=_kept(p.covariance, keep),
    )
    return replace(
        campaign,
        poses=poses,
        counts=campaign.counts[keep],
        zero=place[campaign.zero],
        temperature_c=_kept(campaign.temperature_c, keep),
        dwell_variance=_kept(campaign.dwell_variance, keep),
        reference=None if campaign.reference is None else first[group],
        u_visit=_kept(campaign.u_visit, keep),
        counted=None if campaign.counted is None else campaign.counted[keep],
    )


def _kept(values: FloatArray | None, keep: NDArray[np.intp]) -> FloatArray | None:
    return None if values is None else values[keep]


def check_equations(campaign: Campaign, rig: Parameters, free: tuple[int, ...]) -> None:
    """CalibrationError where the counts are too few for the rig and the free components of the counted poses."""
    channels = np.isfinite(campaign.counts).sum(axis=1)
    n, m, d = int((channels > 0).sum()), len(campaign.cables), len(free)
    trusted, equations = free == ROTATIONS, int(campaign.used.sum())
    # a frame of six motions need not be determined where the poses do not hold it
    needed = d * n + (len(rig.names) if trusted else 0)
    if equations < needed:
        of = {"equations": equations, "unknowns": d, "poses": n, "values": len(rig.names), "cables": m}
        least = math.ceil((m + len(rig.names)) / (m - d)) if m > d else None
        code = "calibration.no_orientations" if trusted else "calibration.poses_not_trusted"
        raise CalibrationError(message(code if m > d else f"{code}_few", **of, least=least))
    few = (channels > 0) & (channels < d)
    if few.any():
        pose = int(np.argmax(few))
        raise CalibrationError(message("error.counts_csv_pose_counted", names=campaign.poses.names[pose], channels=channels[pose], d=d))


def oriented(campaign: Campaign, seed: int) -> list[Campaign]:
    """The campaign with orientations that the counts fit best at the nominal rig, from several orientations of all poses at first."""
    spread = Rotation.concatenate([Rotation.create_group("O"), Rotation.random(12, rng=np.random.default_rng([seed, 17]))])
    drums = of_cables(campaign, list(range(len(campaign.drums))))
    model = Model(drums, Parameters((), np.zeros(0), np.zeros(0)), free=ROTATIONS)
    found = []
    for turn in np.degrees(spread.as_rotvec()):
        done = scipy.optimize.least_squares(
            model.residuals, np.tile(turn, len(model.at)), jac=model.jacobian, method="lm", ftol=1e-6, xtol=1e-6, max_nfev=30
        )
        found.append((float(done.cost), done.x))
    found.sort(key=lambda pair: pair[0])
    chosen: list[FloatArray] = []
    for _, theta in found:
        rows = model.poses(theta)
        if all(np.abs((se3.rotation(rows) * se3.rotation(o).inv()).magnitude()).max() > 0.02 for o in chosen):
            chosen.append(rows)
    return [replace(campaign, poses=replace(campaign.poses, rows=rows, oriented=True)) for rows in chosen[:CANDIDATES]]


def fit_pose(
    rows: FloatArray, per_unit: FloatArray, readings: FloatArray, stated: FloatArray, *, free: IntArray, begun: FloatArray, seed: int
) -> FloatArray:
    """The free components (d,) [deg, mm] of a pose's shift from the stated one (7,) at which the free spans of the cables, rows (m,
    CABLE_COLUMNS), are of the given lengths (m,), and encoders read the given angles, in the least squares sense, per_unit (m,) [mm]: the
    best that begun (d,) and, where orientations are free, those of many that miss the readings least lead to."""
    turned = rows[:, KIND] > CABLE
    unit = np.where(free < 3, math.radians(1.0), 1.0)

    def shift(v: FloatArray) -> FloatArray:
        out = np.zeros(6)
        out[free] = v * unit
        return out

    def pose(v: FloatArray) -> FloatArray:
        return se3.displaced(stated, shift(v))

    def missed(poses: FloatArray) -> FloatArray:
        off = span_lengths(rows, poses) - readings
        off[:, turned] -= 2.0 * np.pi * np.round(off[:, turned] / (2.0 * np.pi))
        return np.asarray(np.nan_to_num(off * per_unit, nan=1e6))

    def residuals(v: FloatArray) -> FloatArray:
        return np.asarray(missed(pose(v)[None])[0])

    def jacobian(v: FloatArray) -> FloatArray:
        J = np.nan_to_num(span_rows(rows, pose(v))) * per_unit[:, None]
        J[:, :3] = J[:, :3] @ se3.left_jacobians(shift(v)[None, :3])[0]
        return np.asarray(J[:, free] * unit)

    starts = [begun]
    if 0 in free:
        turns = Rotation.random(TURNS, rng=np.random.default_rng([seed, 29]))
        there = se3.pose(stated[:3], turns * se3.rotation(stated))
        miss = np.sum(missed(there) ** 2, axis=1)
        nearest = np.degrees(turns[np.argsort(miss)[:FOLLOWED]].as_rotvec())
        starts += [np.r_[turn, np.zeros(len(free) - 3)] for turn in nearest]
    found = [scipy.optimize.least_squares(residuals, v, jac=jacobian, method="lm", ftol=1e-12, xtol=1e-12, max_nfev=50) for v in starts]
    return np.asarray(min(found, key=lambda f: f.cost).x)
