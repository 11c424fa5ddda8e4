"""Effects on the length of a cable besides its parameters: how uncertain drums, pulleys and attachment points are, and what that does.

With F and D of `kernels.cable`, N counts per turn, k the true count, every error as what it adds to f = F(P) - D(k):

    count length    c + dc:               -k dc
    groove pitch    g + dg:               a(k)/h(k) k/N dg
    attachment      P + dP in the tool:   (R^T e) . dP
    swivel axis     d beside the groove:  -d sin phi                                (`sensors.imperfect_parts`)
    other cable     o thicker:            o/2 phi - k dl, dl that of a count
    run-out         the drum pays out a cos(2 pi k/N) + b sin(2 pi k/N) more:  minus that
    eccentricity    below
    play            the true count is k + s w, s = 1 paying out, s = -1 winding in:  -s c w

each minus the same at the pose and count where the counter was zeroed. Of the play, s is that of the last travel: where a run has got
to it is known, where the counter was zeroed it is not, and as either sign is as likely the two errors are uncorrelated, each of the
variance of w. Play between drum and encoder and friction along the cable obey the same law: a reading stays constant until the band of
width 2 w is crossed. (While it is crossed s lies between its two values, and the last one is taken.) Temperature, tension and weight
need more than one number and have a module of their own (`lmeasure.sensors.cable_effects`).

Swivel pulley off its axle
--------------------------
Cable does not slip on the pulley, so D(k) turns it by psi = D(k)/R, from u towards n (module docstring of `kernels.cable`). Its groove is a
circle about O + x, with x = x1 (cos psi u + sin psi n) + x2 (cos psi n - sin psi u) fixed to the pulley. A tight cable pulls the pulley by
its tension times e - u, so that by virtual work the length changes by dF = x . (u - e) to first order, second orders being x^2/R:

    dF = x1 (cos psi (1 - cos phi) - sin psi sin phi) - x2 (sin psi (1 - cos phi) + cos psi sin phi)

Parts as numbers of the rig
---------------------------
Parts of a cable's way that are not as drawn, as numbers of the rig: drums that run out, eccentric pulleys, swivel axes beside the
groove, another cable, play. What each adds to f = F(P) - D(k), F and D of `kernels.cable`, N counts per turn, c the length of a count:

    run-out        -(a cos 2 pi k'/N + b sin 2 pi k'/N)
    pulley         F(P - X) + X.u - F(P) with X the way of its groove's centre from where it should be, in the pulley's plane (u, n)
    other cable    F with R + o/2 instead of R about the same axle, and D with the helix of the drum's radius + o/2
    play           -s w D'(k), s the sign of the last travel

each minus the same where the counter was zeroed.

The pulley (checked against taut strings in `tests/sensors/test_parts.py`)
------------------------------------------------------------------------------
The cable comes along u, up to the groove of radius R about C = B + R n + X, and leaves for P. Seen from C all is as in `kernels.cable`,
with P - X for P, but that the cable before the groove is longer by X.u. The way from the fixed pulley is turned by X.n over its length,
which lengthens it by the square of that alone and is left out. X has two parts. An eccentric groove turns with the pulley,
X = x1 (cos psi u + sin psi n) + x2 (cos psi n - sin psi u), psi = (cable passed)/R as the cable does not slip; the groove's own
eccentricity changes psi by x/R and X by x^2/R, which is left out: 1e-4 mm of 0.05 mm on 20 mm. A swivel axis that passes the groove at the
distance d keeps C at R + d from it: X = d n, whatever way the pulley is turned, and as the cable before the groove is then turned alike in
every position, F(P - d n) is exact. To first order x1 and x2 act as `sensors.imperfect_parts` has it, and dF/dd = -sin phi. A cable
that is thicker by o has its middle at R + o/2 from an axle that stays where it is, X = -o/2 n: dF/do = phi/2.

What `k'` and psi count from: the rig's `phase_length_mm`, a length L of the cable from B to P. Where a counter was zeroed with F0 of
cable, k' = k - D^-1(L - F0), and the cable passed is D(k) + F0 - L. Without it drum and pulley are as stated where it was zeroed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmeasure import kernels
from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.kernels import RADIUS, TRAVEL, TURN_COUNTS
from lmeasure.rig import FURTHER, PHASED, Cable, Rig, further_names, value_of
from lmeasure.sensors.wrap import Drum, Span, arms, by_guide, drum_of, guide, span
from lmeasure.text import Message, message


class Acted(NamedTuple):
    """A cable at n samples: its row of the kernels, base_from_tool turns (n, 3, 3), true counts (n,), and how it runs."""

    row: FloatArray
    turns: FloatArray
    counts: FloatArray
    span: Span

    @property
    def drum(self) -> Drum:
        """Return the drum of the cable."""
        return drum_of(self.row)


@dataclass(frozen=True)
class CableEffect:
    """A kind of error. key: the rig's key that states it; text: its name, and code: the name's in the catalogues; of: the stated value for
    a relative typical size; parameter: its name in a calibration, if that can solve it; adds: effect of one unit of each of its components
    on F(P) - D(k), (n, components) [mm], None for play, which depends on the direction of travel."""

    key: str
    text: str
    code: str
    of: str | None = None
    parameter: str | None = None
    adds: Callable[[Acted], FloatArray] | None = None

    @property
    def said(self) -> Message:
        """Return its name, in every language."""
        return message(f"exact.{self.code}")


def _of_pitch(at: Acted) -> FloatArray:
    a = at.drum.axial_mm + at.drum.travel_mm * at.counts
    return (a / np.maximum(np.hypot(at.drum.tangent_mm, a), 1e-300) * at.counts / at.row[TURN_COUNTS])[:, None]


def _of_run_out(at: Acted) -> FloatArray:
    angle = 2.0 * np.pi * at.counts / at.row[TURN_COUNTS]
    return -np.column_stack([np.cos(angle), np.sin(angle)])


def _of_eccentricity(at: Acted) -> FloatArray:
    psi = at.drum.paid_out(at.counts) / at.row[RADIUS]
    lift, sine, c, s = 1.0 - at.span.cosine, at.span.sine, np.cos(psi), np.sin(psi)
    return np.column_stack([c * lift - s * sine, -s * lift - c * sine])


def _of_offset(at: Acted) -> FloatArray:
    return -at.span.sine[:, None]


def _of_oversize(at: Acted) -> FloatArray:
    turn = at.row[TURN_COUNTS]
    _, by_over = thicker(at.drum.count_mm * turn, at.row[TRAVEL] * turn, 0.0)
    return (0.5 * at.span.angle * (at.row[RADIUS] > 0.0) - at.counts / turn * by_over)[:, None]


def thicker(turn_mm: ArrayLike, pitch_mm: ArrayLike, over: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the extra length of a turn on drums (...) of such pitches, with turn_mm of cable in it, for cables thicker by over; and its
    derivative."""
    turn, pitch, half = (np.asarray(v, dtype=np.float64) for v in (turn_mm, pitch_mm, 0.5 * np.asarray(over)))
    r = np.sqrt(turn**2 - pitch**2) / (2.0 * np.pi)
    # a difference of two lengths would lose the digits of a small one
    longer = np.hypot(2.0 * np.pi * (r + half), pitch)
    return 4.0 * np.pi**2 * half * (2.0 * r + half) / (longer + turn), 2.0 * np.pi**2 * (r + half) / longer


def _of_attachment(at: Acted) -> FloatArray:
    return np.asarray(np.einsum("nij,ni->nj", at.turns, at.span.direction))


COUNT_LENGTH = CableEffect("u_count_length_mm", "count length", "count_length", "count_length_mm", "scale", lambda at: -at.counts[:, None])
PITCH = CableEffect("u_groove_pitch_mm", "groove pitch", "groove_pitch", parameter="groove_pitch_mm", adds=_of_pitch)
RUN_OUT = CableEffect("u_run_out_mm", "run-out of drums", "run_out", adds=_of_run_out)
ECCENTRICITY = CableEffect("u_pulley_eccentricity_mm", "eccentric pulleys", "pulleys", adds=_of_eccentricity)
ATTACHMENT = CableEffect("u_attachment_mm", "attachment points", "attachment", parameter="attachment", adds=_of_attachment)
OFFSET = CableEffect("u_swivel_offset_mm", "swivel axes off the groove", "swivels", adds=_of_offset)
OVERSIZE = CableEffect("u_cable_oversize_mm", "cable diameter", "cable_diameter", adds=_of_oversize)
BACKLASH = CableEffect("u_backlash_counts", "backlash", "backlash")
FRICTION = CableEffect("u_friction_counts", "friction", "friction")

DIMENSIONS = (COUNT_LENGTH, PITCH, ATTACHMENT)
"""Dimensions of the rig, the same in every run and calibration."""
OTHERS = (RUN_OUT, ECCENTRICITY, BACKLASH, FRICTION, OFFSET, OVERSIZE)
"""Effects that depend on the angles of drum and pulley and their direction, and effects without a typical size."""
EFFECTS = (COUNT_LENGTH, PITCH, RUN_OUT, ECCENTRICITY, ATTACHMENT, BACKLASH, FRICTION, OFFSET)
"""Effects with a typical size if not stated."""
STATED = (*EFFECTS, OVERSIZE)  # Effects that a rig may state to be uncertain


PART_RUN_OUT, PART_ECCENTRICITY, PART_OFFSET, PART_OVERSIZE, PLAY = slice(0, 2), slice(2, 4), 4, 5, 6
"""Index of each among `FURTHER`."""
Zeroed = tuple[FloatArray, FloatArray]  # Poses (m, 7) at which counting began, and the counts (m,) there


class Added(NamedTuple):
    """Contribution of parts to F(P) - D(k) [mm], (n, m), its derivatives by their values (n, m, 7), by the way from B to P (n, m, 3) in
    base axes, by the pulley's radius, by the pulley's angle psi and the drum's angle theta (n, m)."""

    mm: FloatArray
    by_values: FloatArray
    by_way: FloatArray
    by_radius: FloatArray
    by_psi: FloatArray
    by_theta: FloatArray


@dataclass(frozen=True)
class Parts:
    """Imperfect parts of m cables: values (m, 7) of `parameters.FURTHER`, mm and counts; phase_mm (m,) the length at which they are stated,
    NaN for that at zeroing; scales (m,) of the counters; pulleys: whether derivatives by those of pulleys are needed even if all are 0."""

    values: FloatArray
    phase_mm: FloatArray
    scales: FloatArray
    pulleys: bool = True

    def excess(self, rows: FloatArray, zero: Zeroed, poses: FloatArray, counts: FloatArray) -> FloatArray:
        """Return the (n, m) effects on modelled minus measured changes [mm], for the kernels' rows (m, columns), at (n, 7) poses and true
        counts (n, m) that are free of play, zeroed at poses (m, 7) with counts (m,). NaN where pose or count is NaN, or a cable cannot
        run."""
        known: BoolArray = np.isfinite(poses[:, 0])
        there, begun = self.added(rows, zero, poses[known], counts[known], travel=np.zeros(counts[known].shape))
        return _where(known, there.mm - begun.mm)

    def gradient(
        self, rows: FloatArray, zero: Zeroed, poses: FloatArray, counts: FloatArray, *, travel: FloatArray | None = None, since: bool = True
    ) -> FloatArray:
        """(n, m, 7) derivatives of `excess` by the values, NaN where the pose is; travel (n, m): signs of the last travel; since: as
        there, minus those where counting began."""
        known: BoolArray = np.isfinite(poses[:, 0])
        travel = np.zeros(counts.shape) if travel is None else travel
        there, begun = self.added(rows, zero, poses[known], counts[known], travel=travel[known])
        return _where(known, there.by_values - begun.by_values if since else there.by_values)

    def added(self, rows: FloatArray, zero: Zeroed, poses: FloatArray, counts: FloatArray, *, travel: FloatArray) -> tuple[Added, Added]:
        """Return the effects at (n, 7) poses, with counts (n, m) that have the play of travel (n, m), and (1, m) at the start of
        counting."""
        way = poses[:, None, :3] + arms(rows, poses) - rows[:, kernels.BASE_XYZ]
        begun, passed = self._begun(rows, zero)
        k0 = zero[1][None]
        return self._at(rows, way, counts, travel, passed), self._at(rows, begun, k0, np.zeros(k0.shape), passed)

    def _begun(self, rows: FloatArray, zero: Zeroed) -> tuple[FloatArray, FloatArray]:
        """Return the way from B to P where counting began, (1, m, 3), and D(k) there less the cable passed since phase 0, (1, m) [mm]."""
        begun = (zero[0][:, :3] + np.einsum("mmi->mi", arms(rows, zero[0])) - rows[:, kernels.BASE_XYZ])[None]
        plain = span(begun, rows[:, kernels.GUIDE_XYZ], rows[:, kernels.RADIUS])
        since = np.where(np.isnan(self.phase_mm), 0.0, plain.length - self.phase_mm)
        return begun, drum_of(rows.T).paid_out(zero[1][None]) - since

    def _at(self, rows: FloatArray, way: FloatArray, k: FloatArray, s: FloatArray, at_phase: FloatArray) -> Added:
        a, b, x1, x2, offset, over, play = self.values.T
        drum, turn, R, u = drum_of(rows.T), rows[:, kernels.TURN_COUNTS], rows[:, kernels.RADIUS], rows[:, kernels.GUIDE_XYZ]
        w = play / self.scales
        slope = drum.slope(k)
        theta = 2.0 * np.pi * (k - drum.counts(at_phase)) / turn
        c, sine = np.cos(theta), np.sin(theta)
        longer, by_over = thicker(drum.count_mm * turn, rows[:, kernels.TRAVEL] * turn, over)
        mm = -a * c - b * sine - k * longer / turn - s * w * slope
        by = np.stack([-c, -sine, *np.zeros((3, *k.shape)), -k * by_over / turn, -s * slope / self.scales], axis=2)
        by_theta = a * sine - b * c
        nothing = np.zeros(k.shape)
        wrapped = R > 0.0
        if not (wrapped.any() and (self.pulleys or self.values[:, PART_ECCENTRICITY.start : PLAY].any())):
            return Added(mm, by, np.zeros(way.shape), nothing, nothing, by_theta)
        safe = np.where(wrapped, R, 1.0)
        psi = (drum.paid_out(k) - at_phase) / safe
        c, sine = np.cos(psi), np.sin(psi)
        along, outward = x1 * c - x2 * sine, x1 * sine + x2 * c + offset - 0.5 * over
        away = way - np.einsum("nmi,mi->nm", way, u)[:, :, None] * u
        n = away / np.linalg.norm(away, axis=2)[:, :, None]
        plain = span(way, u, R)
        moved = span(way - along[:, :, None] * u - outward[:, :, None] * n, u, R + 0.5 * over)
        lift, across = 1.0 - moved.cosine, -moved.sine
        by[:, :, PART_ECCENTRICITY] = np.stack([c * lift + sine * across, -sine * lift + c * across], axis=2)
        by[:, :, PART_OFFSET] = across
        by[:, :, PART_OVERSIZE] += np.where(wrapped, 0.5 * moved.angle, 0.0)
        by[:, :, PART_ECCENTRICITY.start : PART_OFFSET + 1] *= wrapped[:, None]
        by_psi = (-x1 * sine - x2 * c) * lift + (x1 * c - x2 * sine) * across
        by_way = (moved.cosine - plain.cosine)[:, :, None] * u + (moved.sine - plain.sine)[:, :, None] * n
        by_radius = moved.angle - moved.sine - plain.angle + plain.sine - by_psi * psi / safe
        of_pulley = moved.length + along - plain.length
        of_pulley, by_radius, by_psi = (np.where(wrapped, values, 0.0) for values in (of_pulley, by_radius, by_psi))
        return Added(mm + of_pulley, by, np.where(wrapped[:, None], by_way, 0.0), by_radius, by_psi, by_theta)

    def by_parameters(
        self, rows: FloatArray, zero: Zeroed, poses: FloatArray, counts: FloatArray, *, travel: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives of `excess`, with the play of travel (n, m): (n, m, 7) by the values, (n, m, 13) by the kernels' parameters, and
        (2, n, m, 6) by small motions (omega; v) of the pose and of where counting began, base axes."""
        there, begun = self.added(rows, zero, poses, counts, travel=travel)
        scales, m = self.scales, len(rows)
        at = np.arange(m)
        g = kernels.length_gradients(rows, np.ascontiguousarray(poses), counts, scales)
        g0 = kernels.length_gradients(rows, np.ascontiguousarray(zero[0]), np.tile(zero[1], (m, 1)), scales)[at, at][None]
        R, turn, drum = rows[:, kernels.RADIUS], rows[:, kernels.TURN_COUNTS], drum_of(rows.T)
        stated = np.isfinite(self.phase_mm)[:, None]
        phase = drum.counts(self._begun(rows, zero)[1])[0]
        per_mm = 2.0 * np.pi / (drum.slope(phase) * turn)
        of_drum = np.isin(np.arange(kernels.WIDTH), [kernels.BY_SCALE, kernels.BY_TANGENT, kernels.BY_AXIAL, kernels.BY_PITCH])
        # cable passed since: D(k) - D(k0) + F0 - L, and f = F - D
        begun_by = np.where(stated & ~of_drum, g0, 0.0)
        at_phase = kernels.length_gradients(rows, np.ascontiguousarray(zero[0]), np.tile(phase, (m, 1)), scales)[at, at][None]
        radius = np.where(R > 0.0, R, 1.0)

        def by_kernels(side: Added, at: FloatArray, k: FloatArray, by: FloatArray, *, of_start: bool) -> FloatArray:
            passed = np.where(of_drum, g0 - by, 0.0) + begun_by
            turned = np.repeat(np.where(of_drum, g0 - at_phase, begun_by) * per_mm[:, None], len(k), axis=0)
            turned[:, :, kernels.BY_SCALE] = per_mm * g0[:, :, kernels.BY_SCALE] - 2.0 * np.pi * k / (turn * scales)
            own = side.by_theta[:, :, None] * turned + (side.by_psi / radius)[:, :, None] * passed
            own[:, :, kernels.BY_RADIUS] += side.by_radius
            return own + self._of_lengths(rows, at, side, k, of_start=of_start)

        of_kernels = by_kernels(there, poses, counts, g, of_start=False) - by_kernels(begun, zero[0], zero[1][None], g0, of_start=True)
        arm = arms(rows, poses), np.einsum("mmi->mi", arms(rows, zero[0]))[None]
        moved = [np.concatenate([np.cross(way, side.by_way), side.by_way], axis=2) for way, side in ((arm[0], there), (arm[1], begun))]
        # the phase follows the cable length where counting began
        rate = np.where(np.isfinite(self.phase_mm), 1.0, 0.0)
        shift = np.array([kernels.span_rows(rows[j : j + 1], pose)[0] for j, pose in enumerate(zero[0])])
        by_begun = rate * (there.by_theta - begun.by_theta) * per_mm
        by_begun = by_begun + rate * (there.by_psi - begun.by_psi) / radius
        return there.by_values - begun.by_values, of_kernels, np.stack([moved[0], by_begun[:, :, None] * shift - moved[1]])

    def _of_lengths(self, rows: FloatArray, poses: FloatArray, side: Added, k: FloatArray, *, of_start: bool) -> FloatArray:
        """(n, m, 13) derivatives at fixed angles of drum and pulley, but by the radius."""
        n, m = side.mm.shape
        out = np.zeros((n, m, kernels.WIDTH))
        arm, turns = arms(rows, poses), se3.matrices(poses)
        arm, turns = (np.einsum("mmi->mi", arm)[None], turns[None]) if of_start else (arm, np.broadcast_to(turns[:, None], (n, m, 3, 3)))
        at = np.broadcast_to(poses[:, :3][None] if of_start else poses[:, None, :3], arm.shape)
        way = at + arm - rows[:, kernels.BASE_XYZ]
        out[:, :, kernels.BY_BASE : kernels.BY_BASE + 3] = -side.by_way
        for j, row in enumerate(rows):
            frame = guide(row[kernels.ALPHA], row[kernels.BETA])
            out[:, j, kernels.BY_ALPHA : kernels.BY_BETA + 1] = by_guide(frame, way[:, j], side.by_way[:, j])
        out[:, :, kernels.BY_ATTACHMENT : kernels.BY_ATTACHMENT + 3] = np.einsum("nmji,nmj->nmi", turns, side.by_way)
        over, drum, turn = self.values[:, PART_OVERSIZE], drum_of(rows.T), rows[:, kernels.TURN_COUNTS]
        pitch = rows[:, kernels.TRAVEL] * turn
        longer, _ = thicker(drum.count_mm * turn, pitch, over)
        r = np.sqrt((drum.count_mm * turn) ** 2 - pitch**2) / (2.0 * np.pi)
        out[:, :, kernels.BY_SCALE] = k * longer / turn / self.scales
        out[:, :, kernels.BY_PITCH] = k / turn * pitch * over / (2.0 * r * (drum.count_mm * turn + longer))
        return out


def _where(known: BoolArray, values: FloatArray) -> FloatArray:
    """(n, ...) values (k, ...) of the k samples whose pose is known, NaN of the others."""
    out = np.full((len(known), *values.shape[1:]), np.nan)
    out[known] = values
    return out


def parts_of(rig: Rig, cables: tuple[Cable, ...] | None = None) -> Parts | None:
    """Those that a rig's keys state for the given cables, default all; None when it states none but play, which is taken off counts."""
    parts = every_part(rig, rig.cable if cables is None else cables)
    return parts if parts.values[:, :PLAY].any() else None


def every_part(rig: Rig, cables: tuple[Cable, ...]) -> Parts:
    """The same, where there is none too."""
    values = np.array([[value_of(rig, name) or 0.0 for name in own] for own in further_names(rig, cables)])
    points = [rig.point(c.from_point) for c in cables]
    phase = np.array([np.nan if p.phase_length_mm is None else p.phase_length_mm for p in points])
    return Parts(values.reshape(len(cables), len(FURTHER)), phase, np.array([p.drum.scale for p in points]))


def phased(rig: Rig, names: tuple[str, ...], poses: FloatArray, cables: tuple[Cable, ...]) -> Rig:
    """Return the rig with a `phase_length_mm` at all points with named rotating parts. If it states none, it is about the cable length at
    zeroing, at poses (m, 7), in whole millimetres."""
    requested = {owner for owner, _, key in (name.rpartition(".") for name in names) if key in PHASED}
    lengths: dict[str, float] = {}
    for row, pose, c in zip(rig.cable_rows(cables), poses, cables, strict=True):
        if c.from_point in requested and rig.point(c.from_point).phase_length_mm is None and c.from_point not in lengths:
            way = pose[:3] + arms(row[None], pose[None])[0, 0] - row[kernels.BASE_XYZ]
            lengths[c.from_point] = float(np.rint(np.linalg.norm(way)))
    points = tuple(p.model_copy(update={"phase_length_mm": lengths[p.name]}) if p.name in lengths else p for p in rig.observation_point)
    return rig.model_copy(update={"observation_point": points}) if lengths else rig
