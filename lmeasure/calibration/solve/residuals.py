"""Unknowns of a calibration, and the residuals of a campaign as a function of it."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.noise import Noise
from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.estimation import Nuisance, Parameters, Problem
from lmeasure.kernels import (
    ALPHA,
    AXIAL,
    BETA,
    BY_ALPHA,
    BY_BETA,
    GUIDE_XYZ,
    TRAVEL,
    changes_from_counts,
    counts_from_changes,
    guide_direction,
    length_gradients,
    span_lengths,
    span_rows,
)
from lmeasure.rig import FACTORS, SCALE, UNSIGNED, ZEROS, Observed, Rig, Slots, further_names, solved_parameters, tilt_names, value_of
from lmeasure.sensors import PART_ECCENTRICITY, PLAY, Parts, Unsolved, Zero, effects_of, every_part, stated
from lmeasure.text import message

Frame = Literal["rig", "poses"]

COMPONENTS = ("rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm")
ROTATIONS = (0, 1, 2)


def unknowns_of(campaign: Campaign, solve: tuple[str, ...]) -> Parameters:
    """Return the unknowns: the named groups, and every assumed value, for the points with measured cables."""
    return parameters_of(campaign.rig, campaign.cables, solve)


def parameters_of(rig: Rig, cables: tuple[Observed, ...], solve: tuple[str, ...]) -> Parameters:
    """The same before anything is counted."""
    found = solved_parameters(rig, cables, solve)
    return Parameters(tuple(p.name for p in found), np.array([p.value for p in found]), np.array([p.prior_u for p in found]))


class Residuals(Problem):
    """Residuals of a campaign as a function of its unknowns, with analytic derivatives.

    The residual of cable j at pose i is [F(P_i) - D(k_i)] - [F(P_0) - D(k_0)]: modelled minus measured change since the zero pose [mm]. The
    residual of an angle is also modelled minus measured, the shortest way around, in millimetres at `ARM_MM`; an absolute encoder counts
    from its zero, not from a pose.

    The unknowns are the rig's, and behind them, where components of the poses are free (which of `COMPONENTS`), rotations and shifts of the
    counted poses, at, from the stated ones, base axes, R = Exp(rotation) R_stated. They have no prior, and the file's statements about them
    and their variation between visits are unused: every visit of a pose has unknowns of its own. frame: the choice of the frame then, None
    if positions fix it. noise: by default that of the poses' file.
    """

    def __init__(
        self,
        campaign: Campaign,
        unknowns: Parameters,
        noise: Noise | None = None,
        *,
        free: tuple[int, ...] = (),
        frame: Frame | None = None,
    ) -> None:
        self.parameters, self.free, self.frame = unknowns, np.array(free, dtype=np.int64), frame
        self.at = np.flatnonzero(np.isfinite(campaign.counts).any(axis=1)) if free else np.zeros(0, np.int64)
        if not self.places_known:
            campaign = replace(campaign, reference=None)
        if free and campaign.u_visit is not None:
            own = campaign.u_visit.copy()
            own[:, self._unstated] = 0.0
            campaign = replace(campaign, u_visit=own if own.any() else None)
        self.campaign = campaign
        self.noise = self._stated() if noise is None else noise
        self._rows, self._scales = campaign.channels.rows.copy(), campaign.channels.scale
        self._rows[:, AXIAL] -= self._rows[:, TRAVEL] * campaign.rig.paid_out(campaign.cables)
        lengths_mm = np.array([getattr(c, "zero_length_mm", None) for c in campaign.cables], dtype=np.float64)
        self._with_length = np.flatnonzero(np.isfinite(lengths_mm))
        self._lengths_mm = lengths_mm[self._with_length]
        self._poses = np.ascontiguousarray(campaign.poses.rows)
        self.pose_index, self.cable_index = np.nonzero(campaign.used)
        self._zero = campaign.zero[self.cable_index]
        self._per_unit = campaign.mm_per_unit
        since = campaign.from_zero
        self._since = since[self.cable_index]
        self._turned = campaign.channels.angular[self.cable_index]
        self._turn_mm = 2.0 * math.pi * self._per_unit[self.cable_index]
        drums = campaign.drums
        place = {name: i for i, name in enumerate(unknowns.names)}
        self._where = np.array([[place.get(n, -1) for n in row] for row in campaign.channels.parameters])
        self._drums = len(drums)
        self._effects = effects_of(campaign.rig, drums, with_parts=False)
        self._parts = every_part(campaign.rig, drums)
        self._further = np.array([[place.get(n, -1) for n in row] for row in further_names(campaign.rig, drums)])
        self._tilt = _Tilt(campaign.rig, campaign.cables, place, self._where[:, [BY_ALPHA, BY_BETA]] >= 0)
        self._travel = campaign.travel[:, : len(drums)]
        self.sizes: Mapping[str, float] = {}
        self.variables = stated(campaign.rig, drums, unknowns.names)
        self.unsolved = Unsolved(campaign.rig, self.variables, drums)
        self._slots = slots = Slots(self._rows, self._where >= 0)
        self._in_slots = self._where[slots.cable, slots.parameter]
        self._scaled = np.flatnonzero(self._where[:, SCALE] >= 0)
        own = self._where[self.cable_index]
        equation, parameter = np.nonzero(own >= 0)
        tilted, which = np.nonzero(self._tilt.unknown[self.cable_index] >= 0)
        self._derivatives = (
            np.append(equation, tilted),
            np.append(parameter, BY_ALPHA + which),
            np.append(own[equation, parameter], self._tilt.unknown[self.cable_index][tilted, which]),
        )
        self._radius = np.array([n.rpartition(".")[2] in UNSIGNED for n in unknowns.names], dtype=np.bool_)
        self._factor = np.array([math.radians(1.0) if n.endswith("_deg") else 1.0 for n in unknowns.names])
        self._unit_of_poses = np.where(self.free < 3, math.radians(1.0), 1.0)
        if free:
            names = tuple(f"pose {campaign.poses.names[i]}.{COMPONENTS[c]}" for i in self.at for c in free)
            block = np.searchsorted(self.at, self.pose_index)
            self.nuisance = Nuisance(len(free), names, block, np.searchsorted(self.at, np.unique(campaign.zero[since])))

    @property
    def equations(self) -> int:
        """Number of residuals."""
        return len(self.pose_index)

    @property
    def pose_unknowns(self) -> int:
        """Return how many unknowns each pose has of its own."""
        return len(self.free)

    @property
    def places_known(self) -> bool:
        """Return whether positions of the poses are those of the file, with the uncertainty stated there."""
        return 3 not in self.free

    def undetermined_block(self, block: int) -> str:
        """Return the message about a pose that its cables do not determine."""
        name = self.campaign.poses.names[self.at[block]]
        return message("calibration.pose_undetermined", name=name)

    @property
    def _unstated(self) -> list[int]:
        """Components of a pose about which nothing stated counts: the free ones, and the rotation of a tool that is but one free point."""
        return list(range(6)) if 3 in self.free else list(ROTATIONS)

    def _stated(self) -> Noise:
        """Return the noise of the poses' file for the known components."""
        poses = self.campaign.poses
        stated = Noise.of(poses)
        if not len(self.free):
            return stated
        place, turn = stated.u_position_mm.copy(), np.zeros(len(poses))
        covariance = None if stated.covariance is None else stated.covariance.copy()
        if covariance is not None:
            covariance[:, self._unstated] = 0.0
            covariance[:, :, self._unstated] = 0.0
        if not self.places_known:
            place, covariance = np.zeros(len(poses)), None
        # assumed sizes of unknown components have no effect
        absent = tuple(name for name in stated.absent if name == "position" and self.places_known)
        return Noise(place, turn, covariance, absent=absent)

    def shifts(self, theta: FloatArray) -> FloatArray:
        """(n, 6) rotation [rad] and shift [mm] of each pose from the stated one."""
        out = np.zeros((len(self.campaign.poses), 6))
        own = theta[self.own :].reshape(len(self.at), len(self.free))
        out[np.ix_(self.at, self.free)] = own * self._unit_of_poses
        return out

    @property
    def arms(self) -> FloatArray:
        """(n, 3) from the origin of a pose to the point that a motion of the whole carries along [mm, base frame]: the one attachment
        point, where the tool itself does not turn."""
        if 0 in self.free:
            return np.zeros((len(self.campaign.poses), 3))
        tool = self.campaign.rig.tool[self.campaign.cables[0].to_point]
        return self.campaign.poses.rotation.apply(np.array(tool))

    def poses(self, theta: FloatArray) -> FloatArray:
        """(n, 7) poses when the unknowns are theta (P,): the stated ones, shifted where they are unknown."""
        return se3.displaced(self._poses, self.shifts(theta)) if len(self.free) else self._poses

    def cables(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The kernels' rows, the decoding scales and the true counts when the unknowns are theta (P,)."""
        scales = self._scales.copy()
        scales[self._scaled] = theta[self._where[self._scaled, SCALE]]
        counts = np.where(np.isfinite(self.campaign.counts), self.campaign.counts, 0.0) * (self._scales / scales)
        rows = self._slots.filled(self._rows, theta[self._in_slots] * self._factor[self._in_slots])
        rows, own = self._tilt.added(rows, theta), self._with_length
        if len(own):
            # where the pay-out points were at the zero poses follows from the lengths there, and these from the unknowns
            zero, drums = self.campaign.zero[own], rows[own]
            longer = np.diag(span_lengths(drums, self.poses(theta)[zero])) - self._lengths_mm
            paid = counts_from_changes(drums, longer[None])[0] - counts[zero, own]
            rows[own, AXIAL] += drums[:, TRAVEL] * np.where(np.isfinite(paid), paid, 0.0)
        return rows, scales, counts

    def parts(self, theta: FloatArray) -> Parts | None:
        """The parts that are not as drawn when the unknowns are theta (P,); None where there are none."""
        solved = self._further >= 0
        if not (solved.any() or self._parts.values.any()):
            return None
        pulleys = bool(solved[:, PART_ECCENTRICITY.start : PLAY].any())
        return replace(self._parts, values=np.where(solved, theta[self._further], self._parts.values), pulleys=pulleys)

    def _of_parts(self, theta: FloatArray) -> tuple[FloatArray, tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
        """Return the input of `Parts`: rows, zero poses and counts, poses, and counts of the drums."""
        rows, _, counts = self.cables(theta)
        poses, zero = self.poses(theta), self.campaign.zero[: self._drums]
        k = np.ascontiguousarray(counts[:, : self._drums])
        return rows[: self._drums], (poses[zero], k[zero, np.arange(self._drums)]), poses, k

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) modelled minus measured changes [mm]; infinite where a cable cannot run."""
        rows, _, counts = self.cables(theta)
        poses = self.poses(theta)
        f = (span_lengths(rows, poses) - changes_from_counts(rows, counts)) * self._per_unit
        r = self.since_zero(f)
        r[self._turned] -= (self._turn_mm * np.round(r / self._turn_mm))[self._turned]
        if self._effects is not None:
            zero, every, k, warm = self._situation(poses, counts)
            excess = self._effects.excess(rows[: self._drums], zero, every, k, temperature_c=warm)
            r = r + self._of_drums(excess)[self.pose_index, self.cable_index]
        parts = self.parts(theta)
        if parts is not None:
            there, begun = parts.added(*self._of_parts(theta), travel=self._travel)
            r = r + self._of_drums(there.mm - begun.mm)[self.pose_index, self.cable_index]
        return np.where(np.isfinite(r), r, 1e6)

    def since_zero(self, every: FloatArray) -> FloatArray:
        """(e, ...) of each residual's pose and channel from (n, m, ...), minus the same at the zero pose where it counts from there."""
        begun = every[self._zero, self.cable_index]
        begun[~self._since] = 0.0
        return np.asarray(every[self.pose_index, self.cable_index] - begun)

    def _of_drums(self, values: FloatArray) -> FloatArray:
        """(n, m, ...) of all channels from the cables' (n, drums, ...): nothing of the others."""
        out = np.zeros((len(values), len(self._rows), *values.shape[2:]))
        out[:, : self._drums] = values
        return out

    def _situation(self, poses: FloatArray, counts: FloatArray) -> tuple[Zero, FloatArray, FloatArray, FloatArray]:
        """Return each cable's zero pose, the poses (n, 7), true counts and temperatures (n, drums): the input of the effects."""
        assert self._effects is not None
        m, warm = self._drums, self.campaign.temperature_c
        counts = np.ascontiguousarray(counts[:, :m])
        warm = np.full(counts.shape, self._effects.reference_c) if warm is None else np.ascontiguousarray(warm[:, :m])
        zero = self.campaign.zero[:m]
        start = zero, np.arange(m)
        return Zero(poses[zero], counts[start], warm[start]), poses, counts, warm

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, P) derivatives of the residuals by the unknowns, in the units of their names."""
        rows, scales, counts = self.cables(theta)
        g = self.since_zero(length_gradients(rows, self.poses(theta), counts, scales) * self._per_unit[:, None])
        J = np.zeros((self.equations, self.own))
        equation, parameter, unknown = self._derivatives
        J[equation, unknown] = g[equation, parameter]
        J *= np.where(self._radius & (theta[: self.own] < 0), -self._factor, self._factor)
        parts = self.parts(theta)
        if parts is not None:
            J += self._by_parts(parts, theta)
        J = np.where(np.isfinite(J), J, 0.0)
        if not len(self.free):
            return J
        by_pose = self.pose_jacobian(theta)
        by_pose[:, :, :3] = np.einsum("eni,nij->enj", by_pose[:, :, :3], se3.left_jacobians(self.shifts(theta)[:, :3]))
        by_pose = np.where(np.isfinite(by_pose), by_pose, 0.0)[:, self.at[:, None], self.free] * self._unit_of_poses
        return np.hstack([J, by_pose.reshape(len(J), -1)])

    def _by_parts(self, parts: Parts, theta: FloatArray) -> FloatArray:
        """Return the (e, P) derivatives of the parts' lengths by the unknowns of the rig."""
        by_values, by_kernels, _ = parts.by_parameters(*self._of_parts(theta), travel=self._travel)
        out = np.zeros((self.equations, self.own))
        of_drum = np.flatnonzero(self.cable_index < self._drums)
        i, j = self.pose_index[of_drum], self.cable_index[of_drum]
        tilts, where = self._tilt.unknown, self._where
        for unknown, by in (
            *zip(self._further.T, np.moveaxis(by_values, 2, 0), strict=True),
            *zip(where.T, np.moveaxis(by_kernels, 2, 0) * FACTORS[:, None, None], strict=True),
            *((tilts[:, c], by_kernels[:, :, BY_ALPHA + c] * math.radians(1.0)) for c in range(2)),
        ):
            solved = unknown[j] >= 0
            out[of_drum[solved], unknown[j][solved]] += by[i, j][solved]
        return np.where(np.isfinite(out), np.where(self._radius & (theta[: self.own] < 0), -out, out), 0.0)

    def pose_jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, n, 6) derivatives of the residuals by small errors (rotation [rad]; translation [mm]) of each reference pose."""
        rows, _, _ = self.cables(theta)
        by_pose = np.array([span_rows(rows, pose) for pose in self.poses(theta)]) * self._per_unit[:, None]
        out = np.zeros((self.equations, len(by_pose), 6))
        every, since = np.arange(self.equations), np.flatnonzero(self._since)
        out[every, self.pose_index] += by_pose[self.pose_index, self.cable_index]
        out[since, self._zero[since]] -= by_pose[self._zero[since], self.cable_index[since]]
        parts = self.parts(theta)
        return out if parts is None else out + self._parts_by_pose(parts, theta)

    def _parts_by_pose(self, parts: Parts, theta: FloatArray) -> FloatArray:
        """Return the (e, n, 6) `pose_jacobian` of the parts' lengths."""
        _, _, (there, begun) = parts.by_parameters(*self._of_parts(theta), travel=self._travel)
        out = np.zeros((self.equations, len(there), 6))
        of_drum = np.flatnonzero(self.cable_index < self._drums)
        i, j = self.pose_index[of_drum], self.cable_index[of_drum]
        out[of_drum, i] += there[i, j]
        out[of_drum, self.campaign.zero[j]] += begun[i, j]
        return np.where(np.isfinite(out), out, 0.0)

    def zeros_begun(self, theta: FloatArray) -> FloatArray:
        """theta with the zeros of encoders where all their readings together put them, the rest being as it is."""
        out, r = theta.copy(), self.residuals(theta)
        for i, name in enumerate(self.parameters.names):
            channel, _, key = name.rpartition(".")
            if key in ZEROS:
                own = np.array([c.channel == channel for c in self.campaign.cables])[self.cable_index]
                angles = r[own] / self._per_unit[self.cable_index[own]]
                if not self._turned[own].any():
                    out[i] = theta[i] + angles.mean()
                    continue
                out[i] = math.remainder(theta[i] + math.degrees(np.angle(np.exp(1j * angles).sum())), 360.0)
        return out


class _Tilt:
    """Tilts of swivel axes, which are added to the guides' angles: unknown (m, 2) which of the unknowns they are, -1 for none."""

    def __init__(self, rig: Rig, cables: tuple[Observed, ...], place: dict[str, int], guided: BoolArray) -> None:
        names = [tilt_names(c) for c in cables]
        self._guided = [j for j, own in enumerate(names) if own]
        self.unknown = np.array([[place.get(n, -1) for n in own] or [-1, -1] for own in names])
        self._stated = np.radians([[value_of(rig, n) or 0.0 for n in own] or [0.0, 0.0] for own in names])
        # rows state the sum of both: of a guide that is solved they have the new angle alone
        self._in_rows = np.where(guided, 0.0, self._stated)

    def added(self, rows: FloatArray, theta: FloatArray) -> FloatArray:
        """The kernels' rows (m, columns) with the tilts when the unknowns are theta (P,)."""
        solved = self.unknown >= 0
        if not (solved.any() or self._stated.any()):
            return rows
        tilt = np.where(solved, np.radians(theta[self.unknown]), self._stated)
        rows[:, [ALPHA, BETA]] += tilt - self._in_rows
        for j in self._guided:
            rows[j, GUIDE_XYZ] = guide_direction(rows[j, ALPHA], rows[j, BETA])
        return rows
