"""The vector of what a calibration solves for, and the residuals it is judged by."""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.calibration.campaign import Campaign
from lmeasure.effects import Zero, effects_of
from lmeasure.kernels import cable as cable_kernels
from lmeasure.lengths import count_variance
from lmeasure.observation.parameters import FACTORS, SCALE, UNSIGNED, Slots, parameter_names, solved_parameters, with_values
from lmeasure.rig import Rig
from lmeasure.unsolved import Unsolved, stated


@dataclass(frozen=True)
class Unknowns:
    """Names (p) of the solved values, their nominal values and prior standard uncertainties (p,), in the units of their names."""

    names: tuple[str, ...]
    nominal: FloatArray
    width: FloatArray

    def owner(self, i: int) -> str:
        """The observation point or attachment point that value i belongs to."""
        return self.names[i].rsplit(".", 1)[0]

    def of(self, owner: str) -> IntArray:
        """Indices of one owner's values."""
        return np.array([i for i in range(len(self.names)) if self.owner(i) == owner], dtype=np.int64)


def unknowns_of(campaign: Campaign, solve: tuple[str, ...]) -> Unknowns:
    """What to solve for: the named groups, and every assumed value, for the points whose cables were measured."""
    found = solved_parameters(campaign.rig, campaign.cables, solve)
    return Unknowns(tuple(p.name for p in found), np.array([p.value for p in found]), np.array([p.prior_u for p in found]))


class Model:
    """Length residuals of a campaign as a function of its unknowns, with analytic derivatives.

    The residual of cable j at pose i is [F(P_i) - D(k_i)] - [F(P_0) - D(k_0)]: modelled less measured change since the zero pose [mm].
    """

    def __init__(self, campaign: Campaign, unknowns: Unknowns) -> None:
        self.campaign = campaign
        self.unknowns = self.rig = unknowns
        self._rows = campaign.rig.cable_rows(campaign.cables)
        self._scales = campaign.rig.scales(campaign.cables)
        self._poses = np.ascontiguousarray(campaign.poses.rows)
        self.pose_index, self.cable_index = np.nonzero(campaign.used)
        self._zero = campaign.zero[self.cable_index]
        place = {name: i for i, name in enumerate(unknowns.names)}
        self._where = np.array([[place.get(n, -1) for n in row] for row in parameter_names(campaign.rig, campaign.cables)])
        self._effects = effects_of(campaign.rig, campaign.cables)
        self.unsolved = Unsolved(campaign.rig, stated(campaign.rig, campaign.cables, unknowns.names), campaign.cables)
        self._slots = slots = Slots(self._rows, self._where >= 0)
        self._in_slots, self._unit = self._where[slots.cable, slots.parameter], FACTORS[slots.parameter]
        self._scaled = np.flatnonzero(self._where[:, SCALE] >= 0)
        own = self._where[self.cable_index]
        equation, parameter = np.nonzero(own >= 0)
        self._derivatives = equation, parameter, own[equation, parameter]
        self._radius = np.array([n.rsplit(".", 1)[1] in UNSIGNED for n in unknowns.names])
        self._factor = np.array([math.radians(1.0) if n.endswith("_deg") else 1.0 for n in unknowns.names])

    @property
    def equations(self) -> int:
        """Number of residuals."""
        return len(self.pose_index)

    @property
    def own(self) -> int:
        """How many unknowns are the rig's: they are the first, and `rig` has their names."""
        return len(self.rig.names)

    @property
    def pose_unknowns(self) -> int:
        """How many unknowns each pose has of its own: none, but see `calibration.joint_model`."""
        return 0

    @property
    def places_known(self) -> bool:
        """Whether positions of the poses are taken from the file, with the uncertainty stated there."""
        return True

    def poses(self, theta: FloatArray) -> FloatArray:
        """(n, 7) poses when the unknowns are theta (p,): those of the campaign, unless they are unknown too (`calibration.joint`)."""
        return self._poses

    def cables(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The kernels' rows, the decoding scales and the true counts when the unknowns are theta (p,)."""
        scales = self._scales.copy()
        scales[self._scaled] = theta[self._where[self._scaled, SCALE]]
        counts = np.where(np.isfinite(self.campaign.counts), self.campaign.counts, 0.0) * (self._scales / scales)
        return self._slots.filled(self._rows, theta[self._in_slots] * self._unit), scales, counts

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) modelled less measured changes [mm]; infinite where a cable cannot run."""
        rows, _, counts = self.cables(theta)
        poses = self.poses(theta)
        f = cable_kernels.span_lengths(rows, poses) - cable_kernels.changes_from_counts(rows, counts)
        r = f[self.pose_index, self.cable_index] - f[self._zero, self.cable_index]
        if self._effects is not None:
            r = r + self._effects.excess(rows, *self._situation(poses, counts))[self.pose_index, self.cable_index]
        return np.where(np.isfinite(r), r, 1e6)

    def _situation(self, poses: FloatArray, counts: FloatArray) -> tuple[Zero, FloatArray, FloatArray, FloatArray]:
        """Where each cable's equations start, the poses (n, 7), true counts and temperatures (n, m): what the effects depend on."""
        assert self._effects is not None
        warm = np.full(counts.shape, self._effects.reference_c) if self.campaign.temperature_c is None else self.campaign.temperature_c
        start = self.campaign.zero, np.arange(counts.shape[1])
        return Zero(poses[self.campaign.zero], counts[start], warm[start]), poses, counts, warm

    def reading_covariance(self) -> FloatArray:
        """(e, e) covariance of the residuals [mm^2] from reading the counters."""
        own, shared, _ = self.readings
        return np.asarray(np.diag(own) + shared @ shared.T)

    @property
    def readings(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """What the residuals err by from reading the counters: whole counts, or means of dwells as `Campaign` has them.

        (e,) variances [mm^2] of the readings at the poses; (e, z) the residuals' errors [mm] by one standard deviation of what each zero
        reading is off, which residuals of a cable share; (z,) whether that is uniform: where within a whole count the counter was zeroed,
        or stood.
        """
        campaign, j = self.campaign, self.cable_index
        # uniform within half a count is a twelfth
        of_count = 12.0 * count_variance(campaign.rig, campaign.cables)
        own = of_count[j] / 12.0 if campaign.dwell_variance is None else of_count[j] * campaign.dwell_variance[self.pose_index, j]
        u_zero, reading = np.sqrt(of_count * campaign.zero_variances), campaign.zero_readings
        uncertain = np.unique(reading[u_zero > 0.0])
        shared = np.where(reading[j][:, None] == uncertain, u_zero[j][:, None], 0.0)
        whole = self.whole(campaign.zero, np.arange(len(campaign.cables)))
        return np.asarray(own), shared, np.array([whole[reading == number].all() for number in uncertain], dtype=np.bool_)

    def whole(self, poses: IntArray, cables: IntArray) -> BoolArray:
        """Whether the recorded counts of cables at poses, index by index, are whole numbers: rounded, and not averaged or interpolated."""
        recorded = self.campaign.counts[poses, cables] * self._scales[cables]
        return np.asarray(np.abs(recorded - np.rint(recorded)) <= 1e-9 * np.maximum(1.0, np.abs(recorded)))

    def effect_covariance(self, theta: FloatArray) -> FloatArray | None:
        """(e, e) covariance of the residuals [mm^2] from what is uncertain in temperature, stretch and sag; None when nothing is.

        Properties of cables and frame err alike everywhere; a pose's temperature errs for all its cables, a tension for one cable there.
        """
        if self._effects is None:
            return None
        rows, _, counts = self.cables(theta)
        poses = self.poses(theta)
        situation = self._situation(poses, counts)
        at = self.pose_index, self.cable_index
        columns = [shift[at] for shift in self._effects.property_shifts(rows, *situation)]
        temperature = self._effects.temperature_shifts(rows, *situation)
        if temperature is not None:
            first, later = (shift[at] for shift in temperature)
            for i in range(len(poses)):
                columns.append(np.where(self._zero == i, first, 0.0) + np.where(self.pose_index == i, later, 0.0))
        friction = self._effects.tension_shift(rows, poses)
        if friction is not None:
            for j in range(counts.shape[1]):
                columns.append(np.where(self.cable_index == j, friction[self._zero, self.cable_index], 0.0))
        shifts = np.array(columns).reshape(-1, self.equations)
        V = shifts.T @ shifts
        if friction is not None:
            V += np.diag(friction[at] ** 2)
        return np.asarray(V) if V.any() else None

    def unsolved_shifts(self, theta: FloatArray) -> FloatArray:
        """(e, q) how the residuals [mm] would change by one standard uncertainty of each of the `unsolved` variables but play."""
        rows, _, counts = self.cables(theta)
        poses, zero = self.poses(theta), self.campaign.zero
        begun = Zero(poses[zero], counts[zero, np.arange(len(zero))], np.zeros(len(zero)))
        return np.asarray(self.unsolved.shifts(rows, begun, poses, counts)[self.pose_index, self.cable_index])

    def unsolved_covariance(self, theta: FloatArray) -> FloatArray | None:
        """(e, e) covariance of the residuals [mm^2] from what the rig states to be uncertain and is not solved; None for nothing.

        A dimension, a drum that runs out, an eccentric pulley err alike in all equations. Which way a cable was pulled to where it rests
        nobody recorded: play errs for each reading on its own, and once for all equations of a cable where it was zeroed.
        """
        if not self.unsolved:
            return None
        shifts, play = self.unsolved_shifts(theta), self.unsolved.play_mm[self.cable_index] ** 2
        same = self.cable_index[:, None] == self.cable_index
        return np.asarray(shifts @ shifts.T + np.diag(play) + np.where(same, play, 0.0))

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, p) derivatives of the residuals by the unknowns, in the units of their names."""
        rows, scales, counts = self.cables(theta)
        g = cable_kernels.length_gradients(rows, self.poses(theta), counts, scales)
        g = g[self.pose_index, self.cable_index] - g[self._zero, self.cable_index]
        J = np.zeros((self.equations, len(self.unknowns.names)))
        equation, parameter, unknown = self._derivatives
        J[equation, unknown] = g[equation, parameter]
        J *= np.where(self._radius & (theta < 0), -self._factor, self._factor)
        return np.where(np.isfinite(J), J, 0.0)

    def pose_jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, n, 6) derivatives of the residuals by small errors (rotation [rad]; translation [mm]) of each reference pose."""
        rows, _, _ = self.cables(theta)
        by_pose = np.array([cable_kernels.span_rows(rows, pose) for pose in self.poses(theta)])
        out = np.zeros((self.equations, len(by_pose), 6))
        every = np.arange(self.equations)
        out[every, self.pose_index] += by_pose[self.pose_index, self.cable_index]
        out[every, self._zero] -= by_pose[self._zero, self.cable_index]
        return out


def rig_with(campaign: Campaign, unknowns: Unknowns, theta: FloatArray, calibration: str | None) -> Rig:
    """The rig with the unknowns set to theta (p,), guide angles brought back to their ranges."""
    rig = with_values(campaign.rig, dict(zip(unknowns.names, theta.tolist(), strict=True)))
    return rig.model_copy(update={"calibration": calibration})
