"""The problem of a campaign: its residuals and their errors."""

import copy
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Self

import numpy as np

from lmeasure.calibration.campaign.campaign import Break, Campaign
from lmeasure.calibration.solve.noise import Noise
from lmeasure.calibration.solve.reference_field import field_covariance
from lmeasure.calibration.solve.residuals import Residuals
from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.estimation import Fit, Parameters
from lmeasure.kernels import BY_ATTACHMENT, COUNT_LENGTH, length_gradients
from lmeasure.recording import Poses
from lmeasure.rig import Rig, SensorTable, with_values
from lmeasure.sensors import ATTACHMENT, ECCENTRICITY, PART_ECCENTRICITY, PART_RUN_OUT, PLAY, RUN_OUT, Unsolved, Variable, Zero

TURNING = {RUN_OUT: PART_RUN_OUT, ECCENTRICITY: PART_ECCENTRICITY}
"""Errors that depend on the angle of drum and pulley at zeroing, and their kind in `sensors.Parts`."""

DOUBTED = 0.3
"""Typical excess of an error over its stated size, as a part of that size."""
SLIP_MM, MOVE_MM = 1000.0, 10.0
"""Prior standard uncertainties of a slip and of each component of a move that are solved for: hardly any."""
TRAVEL = "travel"
"""Play of cables that came straight from pose to pose, among the sizes of a model."""


def doubt_of(v: Variable) -> float:
    """Return the part of an error's size that residuals determine: all of an unstated one."""
    return 1.0 if v.assumed else DOUBTED


def factor_of(v: Variable, sizes: Mapping[str, float]) -> float:
    """Return the factor of an error's size: of an unstated one the size of its kind, of a stated one that of the excess beside 1."""
    return sizes.get(v.kind.code, 1.0) if v.assumed else math.hypot(1.0, DOUBTED * sizes.get(v.kind.code, 0.0))


class Model(Residuals):
    """`Residuals` with their covariance: of counts, reference poses, physical effects, and the rig's stated uncertainties."""

    changes: FloatArray = np.zeros(0)
    """(4 b,) found changes of cables during the campaign, in prior standard uncertainties."""

    @property
    def covariance_varies(self) -> bool:  # type: ignore[override]
        """Derivatives by the poses do, wherever these err."""
        return self.noise.stated

    def with_noise(self, noise: Noise) -> Self:
        """The same with other uncertainties."""
        out = copy.copy(self)
        out.noise = noise
        return out

    def with_break(self, found: Break) -> Self:
        """Return it with a further change of a cable during the campaign."""
        out = copy.copy(self)
        out.campaign = replace(self.campaign, breaks=(*self.campaign.breaks, found))
        out.changes = np.append(self.changes, np.zeros(4)) if len(self.changes) else self.changes
        return out

    def with_changes(self, found: Fit) -> Self:
        """Return it with the changes of cables during the campaign as they are most probable by a fit."""
        out, F = copy.copy(self), self.break_shifts(found.theta)
        r = found.residuals - (F @ self.changes if len(self.changes) else 0.0)
        out.changes = -F.T @ np.linalg.solve(found.V, r)
        return out

    def break_shifts(self, theta: FloatArray) -> FloatArray:
        """(e, 4 b) how the residuals [mm] would change by one prior standard uncertainty of each change of a cable during the campaign: of
        the slip, and of the move of its observation point. The solved point is where it was afterwards."""
        campaign, columns = self.campaign, []
        J = self.pose_jacobian(theta) if campaign.breaks else np.zeros((self.equations, 0, 6))
        every, channels = np.arange(self.equations), [c.channel for c in campaign.cables]
        for one in campaign.breaks:
            if one.channel not in channels:
                continue
            j = channels.index(one.channel)
            when = campaign.counted_at(j)
            before = when < when[campaign.poses.names.index(one.pose)]
            at, zero = before[self.pose_index], before[self._zero] & self._since
            columns.append(SLIP_MM * ((self.cable_index == j) & self._since) * (zero.astype(np.float64) - at)[:, None].T)
            point = np.array([c.is_cable and c.from_point == campaign.cables[j].from_point for c in campaign.cables])[self.cable_index]
            columns.append(MOVE_MM * point * (J[every, self.pose_index, 3:].T * at + J[every, self._zero, 3:].T * zero))
        return np.concatenate(columns).T if columns else np.zeros((self.equations, 0))

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) of `Residuals`, with the found changes of cables."""
        r = super().residuals(theta)
        return r + self.break_shifts(theta) @ self.changes if len(self.changes) else r

    def with_sizes(self, sizes: Mapping[str, float]) -> Self:
        """Return the model with other sizes of its errors, by the code of their kind (`factor_of`)."""
        out, campaign = copy.copy(self), self.campaign
        out.sizes = sizes
        own = [replace(v, u=v.u * factor_of(v, sizes)) for v in self.variables]
        out.unsolved = Unsolved(campaign.rig, [v for v in own if v.u], campaign.drums)
        return out

    def without_assumed(self) -> Self:
        """Return it with unstated errors as exact."""
        return self.with_sizes({v.kind.code: 0.0 for v in self.variables})

    def reading_covariance(self) -> FloatArray:
        """(e, e) covariance of the residuals [mm^2] from reading the counters."""
        own, shared, _ = self.readings
        return np.asarray(np.diag(own) + shared @ shared.T)

    @property
    def readings(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the residuals' errors from reading the counters: whole counts, or means of dwells as in `Campaign`.

        (e,) variances [mm^2] of the readings at the poses; (e, z) the residuals' errors [mm] by one standard deviation of each zero
        reading's error, which residuals of a cable share; (z,) whether that is uniform: the place within a whole count.
        """
        campaign, j = self.campaign, self.cable_index
        # uniform within half a count is a twelfth
        of_count, single = (v * self._per_unit**2 for v in (12.0 * campaign.channels.rounding, campaign.channels.variance))
        own = single[j] if campaign.dwell_variance is None else of_count[j] * campaign.dwell_variance[self.pose_index, j]
        u_zero, reading = np.sqrt(of_count * campaign.zero_variances), campaign.zero_readings
        uncertain = np.unique(reading[u_zero > 0.0])
        shared = np.where(reading[j][:, None] == uncertain, u_zero[j][:, None], 0.0)
        whole = self.whole(campaign.zero, np.arange(len(campaign.cables)))
        return np.asarray(own), shared, np.array([whole[reading == number].all() for number in uncertain], dtype=np.bool_)

    def whole(self, poses: IntArray, cables: IntArray) -> BoolArray:
        """Return whether the recorded counts of cables at poses, index by index, are rounded to whole numbers, not averaged or
        interpolated."""
        recorded = self.campaign.counts[poses, cables] * self._scales[cables]
        return np.asarray(np.abs(recorded - np.rint(recorded)) <= 1e-9 * np.maximum(1.0, np.abs(recorded)))

    @property
    def whole_counts(self) -> BoolArray:
        """(e,) whether the recorded count behind each residual is a whole number."""
        return self.whole(self.pose_index, self.cable_index)

    def effect_covariance(self, theta: FloatArray) -> FloatArray | None:
        """Return the (e, e) covariance of the residuals [mm^2] from uncertain temperature, stretch and sag; None without any.

        Errors of cables and frame are the same everywhere. A pose's temperature is one error of all its cables, a tension of one cable.
        """
        if self._effects is None:
            return None
        rows, _, counts = self.cables(theta)
        poses = self.poses(theta)
        zero, every, k, warm = self._situation(poses, counts)
        rows = rows[: self._drums]
        at, given = (self.pose_index, self.cable_index), (rows, zero, every, k)
        columns = [self._of_drums(shift)[at] for shift in self._effects.property_shifts(*given, temperature_c=warm)]
        temperature = self._effects.temperature_shifts(*given, temperature_c=warm)
        if temperature is not None:
            first, later = (self._of_drums(shift)[at] for shift in temperature)
            for i in range(len(poses)):
                columns.append(np.where(self._zero == i, first, 0.0) + np.where(self.pose_index == i, later, 0.0))
        friction = self._effects.tension_shift(rows, poses)
        if friction is not None:
            friction = self._of_drums(friction)
            for j in range(self._drums):
                columns.append(np.where(self.cable_index == j, friction[self._zero, self.cable_index], 0.0))
        shifts = np.array(columns).reshape(-1, self.equations)
        V = shifts.T @ shifts
        if friction is not None:
            V += np.diag(friction[at] ** 2)
        return np.asarray(V) if V.any() else None

    def unsolved_shifts(self, theta: FloatArray) -> FloatArray:
        """(e, q) how the residuals [mm] would change by one standard uncertainty of each of the `unsolved` variables but play."""
        rows, scales, counts = self.cables(theta)
        m = self._drums
        poses, zero = self.poses(theta), self.campaign.zero[:m]
        begun = Zero(poses[zero], counts[zero, np.arange(m)], np.zeros(m))
        drawn = self.unsolved.shifts(rows[:m], begun, poses, np.ascontiguousarray(counts[:, :m]))
        out = np.asarray(self._of_drums(drawn)[self.pose_index, self.cable_index])
        if any(v.kind in TURNING for v in self.unsolved.variables):
            # by the phases that the rig states
            there, at_zero = self._parts.added(*self._of_parts(theta), travel=self._travel)
            by_part = self._of_drums(there.by_values - at_zero.by_values)[self.pose_index, self.cable_index]
            column = 0
            for v in self.unsolved.variables:
                if v.kind in TURNING:
                    own = np.array([c.from_point == v.owner for c in self.campaign.cables])[self.cable_index]
                    out[own, column : column + len(v.names)] = v.u * by_part[own, TURNING[v.kind]]
                column += len(v.names)
        if len(rows) == m or not any(v.kind is ATTACHMENT for v in self.unsolved.variables):
            return out
        # an encoder sees where its cable is tied to the tool too
        g = length_gradients(rows, poses, counts, scales) * self._per_unit[:, None]
        by_point = self.since_zero(g)[:, BY_ATTACHMENT : BY_ATTACHMENT + 3]
        column = 0
        for v in self.unsolved.variables:
            if v.kind is ATTACHMENT:
                tied = np.array([c.to_point == v.owner for c in self.campaign.cables])[self.cable_index] & self._turned
                out[tied, column : column + 3] = v.u * by_point[tied]
            column += len(v.names)
        return out

    @property
    def _play_mm(self) -> tuple[FloatArray, FloatArray]:
        """Return (m,) half widths of the band in which a reading lies by its unknown direction of approach: of every reading, and of the
        zeroing, whose approach is never known."""
        half = [
            math.radians(getattr(self.campaign.rig.counter(c), "backlash_deg", None) or 0.0) / 2.0
            for c in self.campaign.cables[self._drums :]
        ]
        of_angles = half * self._per_unit[self._drums :]
        counts = np.where(self._further[:, PLAY] >= 0, self.parameters.width[self._further[:, PLAY]], np.abs(self._parts.values[:, PLAY]))
        begun = np.hypot(self.unsolved.play_mm, counts * self._rows[: self._drums, COUNT_LENGTH] / self._scales[: self._drums])
        return np.concatenate([self.unsolved.play_mm, of_angles]), np.concatenate([begun, of_angles])

    def unsolved_covariance(self, theta: FloatArray) -> FloatArray | None:
        """Return the (e, e) covariance of the residuals [mm^2] from the rig's stated, unsolved uncertainties; None without any.

        Dimensions, runout and eccentric pulleys have one error in all equations. The direction of a cable's last motion is not
        recorded: play is a new error at each reading, and once for all equations of a cable where it was zeroed.
        """
        play, begun = self._play_mm
        if not (self.unsolved or begun.any() or TRAVEL in self.sizes):
            return None
        shifts = self.unsolved_shifts(theta)
        V = np.asarray(shifts @ shifts.T + self.play_covariance(play, begun))
        return V + self.sizes[TRAVEL] ** 2 * self.travel_covariance(self.doubted_play_mm) if TRAVEL in self.sizes else V

    @property
    def doubted_play_mm(self) -> FloatArray:
        """Return (m,) half widths of the band [mm] that a size of 1 adds, 0 of channels without a band."""
        band = [replace(v, u=v.u * doubt_of(v)) for v in self.variables if v.kind.adds is None]
        # encoders of angles have none
        return np.append(Unsolved(self.campaign.rig, band, self.campaign.drums).play_mm, np.zeros(len(self._scales) - self._drums))

    def travel_covariance(self, play: FloatArray) -> FloatArray:
        """Return the (e, e) covariance [mm^2] of play (m,) [mm] if each cable came straight from its previous pose: its band is the same at
        all poses, and the side of it at zeroing is unknown."""
        own = self.travel_shifts(play)
        same = self.cable_index[:, None] == self.cable_index
        return np.asarray(own @ own.T + same * np.outer(play[self.cable_index] ** 2, self._since))

    def travel_shifts(self, play: FloatArray) -> FloatArray:
        """(e, d) how the residuals [mm] follow half a band, play (m,) [mm], of each of the d cables that come from drums."""
        j = self.cable_index
        way = self._travel[self.pose_index, np.minimum(j, self._drums - 1)] * play[j]
        return np.where(j[:, None] == np.arange(self._drums), -way[:, None], 0.0)

    def play_covariance(self, play: FloatArray, begun: FloatArray | None = None) -> FloatArray:
        """(e, e) [mm^2] of play (m,) [mm] of every reading, and of where the counters were zeroed, default the same."""
        j = self.cable_index
        same = (j[:, None] == j) & self._since
        return np.asarray(np.diag(play[j] ** 2) + np.where(same, (play if begun is None else begun)[j] ** 2, 0.0))

    def measurement_covariance(self, theta: FloatArray) -> FloatArray:
        """(e, e) covariance of the residuals [mm^2] from whole counts and reference poses."""
        V = self.reading_covariance()
        campaign, noise = self.campaign, self.noise
        if noise.stated or campaign.u_visit is not None:
            J = self.pose_jacobian(theta)
            shared = noise.scaled(J)
            if campaign.reference is not None:
                shared = np.einsum("eni,nr->eri", shared, campaign.reference_of[:, None] == np.arange(len(campaign.poses)))
            flat = shared.reshape(len(J), -1)
            V = V + flat @ flat.T
            if campaign.u_visit is not None:
                own = (J * campaign.u_visit).reshape(len(J), -1)
                # the robot comes anew in every pass
                passage = np.array([c.passage for c in campaign.cables])[self.cable_index]
                V = V + (own @ own.T) * (passage[:, None] == passage)
        return np.asarray(V)

    def covariance(self, theta: FloatArray) -> FloatArray:
        """Return `measurement_covariance`, stated errors of physical effects and dimensions, errors of the lengths, and those of a robust
        loss."""
        V, noise = self.measurement_covariance(theta), self.noise
        effects = self.effect_covariance(theta)
        if effects is not None:
            V = V + effects
        unsolved = self.unsolved_covariance(theta)
        if unsolved is not None:
            V = V + unsolved
        if self.campaign.breaks:
            shifts = self.break_shifts(theta)
            V = V + shifts @ shifts.T
        if any(name.startswith("field_") for name in self.sizes):
            V = V + field_covariance(self.sizes, self.poses(theta), self.pose_jacobian(theta))
        if noise.robust_variance_mm2 is not None:
            campaign = self.campaign
            same = self.cable_index[:, None] == self.cable_index
            reference, poses = campaign.reference_of, np.arange(len(campaign.poses))
            # a length at the zero pose is in every residual of its cable
            at, zero = reference[self.pose_index], reference[campaign.zero[self.cable_index]]
            h = (at[:, None] == poses).astype(np.float64) - ((zero[:, None] == poses) & self._since[:, None])
            V = V + same * ((h * noise.robust_variance_mm2) @ h.T)
        if noise.u_length_mm is not None:
            own = noise.u_length_mm[self.cable_index] ** 2
            V = V + np.diag(own) + np.where((self.cable_index[:, None] == self.cable_index) & self._since, own, 0.0)
        return np.asarray(V)

    def uniform(self) -> tuple[FloatArray, FloatArray]:
        """Rounding to whole counts, and where within one the counters were zeroed."""
        own, shared, uniform = self.readings
        return np.where(self.whole_counts, own, 0.0), shared[:, uniform]

    @property
    def taken_back(self) -> FloatArray | None:
        """(e,) [mm^2] by the robust loss of the poses."""
        variance = self.noise.robust_variance_mm2
        return None if variance is None else variance[self.pose_index]

    def found_poses(self, theta: FloatArray, covariance: FloatArray) -> Poses:
        """Return the poses at theta. Unknown components have the uncertainty of the unknowns' covariance (P, P), others that of the file,
        or the assumed one."""
        stated = self.campaign.poses
        own = self.noise if self.places_known and "position" in stated.absent else self._stated()
        if not len(self.free):
            return stated
        both = np.zeros((len(stated), 6, 6)) if own.covariance is None else own.covariance.copy()
        if own.covariance is None:
            both[:, [3, 4, 5], [3, 4, 5]] = own.u_position_mm[:, None] ** 2
        d = len(self.free)
        turns = se3.left_jacobians(self.shifts(theta)[:, :3])
        for k, i in enumerate(self.at):
            rows = self.own + d * k + np.arange(d)
            to_pose = np.eye(6)
            to_pose[:3, :3] = turns[i]
            to_pose = to_pose[:, self.free] * self._unit_of_poses
            both[i] += to_pose @ covariance[np.ix_(rows, rows)] @ to_pose.T
        variance = np.einsum("nii->ni", both)
        place, turn = np.sqrt(variance[:, 3:].mean(axis=1)), np.sqrt(variance[:, :3].mean(axis=1))
        return Poses(stated.names, self.poses(theta), place, turn, both, stated.oriented)


def rig_with(campaign: Campaign, unknowns: Parameters, theta: FloatArray, calibration: str | None, *, u: FloatArray | None = None) -> Rig:
    """The rig with the unknowns set to theta (p,), guide angles brought back to their ranges; zeros of sensors state their standard
    uncertainties u (p,) too."""
    rig = with_values(campaign.rig, dict(zip(unknowns.names, theta.tolist(), strict=True)))
    known = {} if u is None else dict(zip(unknowns.names, u.tolist(), strict=True))

    def zero(sensor: SensorTable) -> dict[str, float]:
        name = f"{sensor.channel}.{sensor.zero}"
        return {f"u_{sensor.zero}": min(known[name], 360.0) if sensor.codes else known[name]} if name in known else {}

    return rig.with_sensors(zero).model_copy(update={"calibration": calibration})
