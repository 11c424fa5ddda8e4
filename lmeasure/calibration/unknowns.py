"""The vector of what a calibration solves for, and the residuals it is judged by."""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.cable_parameters import parameter_names
from lmeasure.calibration.campaign import Campaign
from lmeasure.effects import Zero, effects_of
from lmeasure.errors import CalibrationError
from lmeasure.kernels import cable as cable_kernels
from lmeasure.lengths import count_variance
from lmeasure.rig import ObservationPoint, Rig, rig_from_dict
from lmeasure.unsolved import Unsolved, stated

GROUPS = {
    "position": ("x_mm", "y_mm", "z_mm"),
    "guide": ("guide_alpha_deg", "guide_beta_deg"),
    "radius": ("pulley_radius_mm",),
    "scale": ("scale",),
    "tangent": ("tangent_length_mm",),
    "axial": ("axial_offset_mm",),
    "pitch": ("groove_pitch_mm",),
    "attachment": (),
}
"""What `--solve` names, as keys of an observation point; attachment points are the tool's."""

DEFAULT_WIDTH = {
    "x_mm": 30.0,
    "y_mm": 30.0,
    "z_mm": 30.0,
    "guide_alpha_deg": 5.0,
    "guide_beta_deg": 5.0,
    "pulley_radius_mm": 1.0,
    "scale": 0.01,
    "tangent_length_mm": 5.0,
    "axial_offset_mm": 5.0,
    "groove_pitch_mm": 0.05,
    "attachment": 0.5,
}
"""Prior standard uncertainty of a nominal value whose rig file states none: a drawing, a tape measure, a protractor."""

ASSUMED_WIDTH = {
    "x_mm": 300.0,
    "y_mm": 300.0,
    "z_mm": 300.0,
    "guide_alpha_deg": 26.0,  # anywhere within +-45 degrees
    "guide_beta_deg": 104.0,  # anywhere on the circle: 360/sqrt(12)
    "pulley_radius_mm": 10.0,
    "scale": 0.3,
    "tangent_length_mm": 60.0,
    "axial_offset_mm": 20.0,
    "groove_pitch_mm": 1.0,
    "attachment": 20.0,
}
"""Prior standard uncertainty of a value in the rig's `assumed` list: nobody measured it."""

_STATED = {
    "x_mm": "u_position_mm",
    "y_mm": "u_position_mm",
    "z_mm": "u_position_mm",
    "guide_alpha_deg": "u_guide_deg",
    "guide_beta_deg": "u_guide_deg",
    "pulley_radius_mm": "u_pulley_radius_mm",
}
_DRUM_KEYS = ("scale", "tangent_length_mm", "axial_offset_mm", "groove_pitch_mm")
_ASSUMED_ALIAS = {"position_mm": ("x_mm", "y_mm", "z_mm"), "count_length_mm": ("scale",)}


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


def unknowns_of(campaign: Campaign, solve: tuple[str, ...], fixed_assumed: bool = False) -> Unknowns:
    """What to solve for: the named groups, and every assumed value, for the points whose cables were measured."""
    for group in solve:
        if group not in GROUPS:
            raise CalibrationError(f"--solve: {group!r} is not one of {', '.join(GROUPS)}")
    rig = campaign.rig
    assumed = _assumed(rig)
    names: list[str] = []
    nominal: list[float] = []
    width: list[float] = []
    for name in dict.fromkeys(c.from_point for c in campaign.cables):
        point = rig.point(name)
        for key in DEFAULT_WIDTH:
            if key == "attachment":
                continue
            wanted = any(key in GROUPS[g] for g in solve)
            if not wanted and (f"{name}.{key}" not in assumed or fixed_assumed):
                continue
            names.append(f"{name}.{key}")
            nominal.append(_value(point, key))
            width.append(_width(point, key, f"{name}.{key}" in assumed))
    for name in dict.fromkeys(c.to_point for c in campaign.cables):
        if "attachment" in solve or (name in assumed and not fixed_assumed):
            for axis in range(3):
                names.append(f"tool.{name}.{'xyz'[axis]}_mm")
                nominal.append(rig.tool[name][axis])
                usual = (ASSUMED_WIDTH if name in assumed else DEFAULT_WIDTH)["attachment"]
                width.append(usual if rig.u_attachment_mm is None else max(rig.u_attachment_mm, 1e-9))
    if not names:
        raise CalibrationError("--solve: nothing is left to solve for")
    return Unknowns(tuple(names), np.array(nominal), np.array(width))


def _assumed(rig: Rig) -> set[str]:
    out = set()
    for name in rig.assumed:
        if name in rig.tool:
            out.add(name)
            continue
        point, key = name.split(".", 1)
        out |= {f"{point}.{k}" for k in _ASSUMED_ALIAS.get(key, (key,))}
    return out


def _value(point: ObservationPoint, key: str) -> float:
    if key in ("x_mm", "y_mm", "z_mm"):
        return point.position_mm["xyz".index(key[0])]
    return float(getattr(point.drum if key in _DRUM_KEYS else point, key))


def _width(point: ObservationPoint, key: str, assumed: bool) -> float:
    holder = point.drum if key in _DRUM_KEYS else point
    u = getattr(holder, _STATED.get(key, f"u_{key}"), None)
    if u is None and key == "scale" and point.drum.u_count_length_mm is not None:
        u = point.drum.u_count_length_mm / point.drum.count_length_mm * point.drum.scale
    if u is not None:
        return max(float(u), 1e-9)
    return (ASSUMED_WIDTH if assumed else DEFAULT_WIDTH)[key]


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
        own = self._where[self.cable_index]
        equation, parameter = np.nonzero(own >= 0)
        self._derivatives = equation, parameter, own[equation, parameter]
        self._radius = np.array([n.endswith("radius_mm") for n in unknowns.names])
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
        rows, scales = self._rows.copy(), self._scales.copy()
        columns = (0, 1, 2, 14, 15, 6, -1, 10, 11, 7, 8, 9, 12)
        for j in range(len(rows)):
            for parameter, column in enumerate(columns):
                i = self._where[j, parameter]
                if i < 0:
                    continue
                value = theta[i] * self._factor[i]
                if column == 6:
                    # a radius has no sign: a step below zero comes out on the other side
                    rows[j, 6] = abs(value)
                elif column == -1:
                    scales[j] = value
                elif column == 12:
                    rows[j, 12] = value / rows[j, 16]
                else:
                    rows[j, column] = value
            rows[j, 3:6] = cable_kernels.guide_direction(rows[j, 14], rows[j, 15])
        counts = np.where(np.isfinite(self.campaign.counts), self.campaign.counts, 0.0) * (self._scales / scales)
        return rows, scales, counts

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
    data = campaign.rig.to_dict()
    points = {p["name"]: p for p in data["observation_point"]}
    for name, number in zip(unknowns.names, theta, strict=True):
        value = abs(float(number)) if name.endswith("radius_mm") else float(number)
        owner, key = name.rsplit(".", 1)
        if owner.startswith("tool."):
            data["tool"][owner.removeprefix("tool.")]["xyz".index(key[0])] = value
        elif key in ("x_mm", "y_mm", "z_mm"):
            points[owner]["position_mm"]["xyz".index(key[0])] = value
        elif key in _DRUM_KEYS:
            points[owner]["drum"][key] = value
        else:
            points[owner][key] = value
    for p in points.values():
        alpha, beta = p["guide_alpha_deg"], p["guide_beta_deg"]
        alpha = math.remainder(alpha, 360.0)
        if abs(alpha) > 90.0:
            alpha, beta = math.copysign(180.0, alpha) - alpha, beta + 180.0
        p["guide_alpha_deg"], p["guide_beta_deg"] = alpha, math.remainder(beta, 360.0) if abs(beta) > 360.0 else beta
    data.pop("calibration", None)
    if calibration is not None:
        data["calibration"] = calibration
    return rig_from_dict(data, "calibrated rig")
