"""Agreement of the channels of a check, and parts moved since the calibration if they disagree.

Parities y of all stops, combinations that no pose of the tool changes (`trajectory.faults.redundancy`), have the covariance V of whole
counts and of all that the calibration leaves uncertain, one draw for the whole run. y' V^-1 y is chi-squared if the rig has not changed.
A cause (an observation point that moved, an encoder that slipped on its pulley, a drum whose count is of another length, a wrong start)
adds y = A d, and removes A (A' V^-1 A)^-1 A' V^-1 y of chi-squared, with the degrees of freedom of d (Baarda 1968). It is named if no other
comes near: their remaining chi-squared, with twice their degrees of freedom on top (Akaike), must be more by `APART`.

The contradictions of some samples, as far from each other as can be, are whitened together by all their expected errors (`moved.Together`:
roundings, calibration, origins; for a rig without a calibration also its points and guides within their priors). Laws of effects
(`calibration.solve.effect_candidates`) and of moved parts compete for them by F tests. One is named if chance, times their number
(Bonferroni), is under `CHANCE`; those within odds of a hundred are named with it; then the remainder is tried. Nothing is named if a
channel that reads differently from some sample on explains as much: then it slipped or lost counts. Nor is anything named if the final
remainder still contradicts itself.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lmeasure.calibration import CHANCE, MOST, NEAR, Campaign, Effect, Model, effects, size_of, spread, tested, unknowns_of
from lmeasure.core import FloatArray
from lmeasure.estimation import Parameters, Remainder, fall_test
from lmeasure.kernels import BY_ANGLE_ZERO, BY_ATTACHMENT, BY_BASE, BY_SCALE, length_gradients, span_rows
from lmeasure.procedures.intermediate_check.closures import Stops
from lmeasure.recording import Poses
from lmeasure.sensors import changes_from_counts
from lmeasure.text import Message, message
from lmeasure.trajectory import FREEDOMS, UNKNOWN_MM, Epochs, Reconstruction, Redundancy, shifted

APART = 9.2
"""Twice the logarithm of odds of a hundred."""
POWER = 0.8


@dataclass(frozen=True)
class Cause:
    """Possible change: kind (point, attachment, encoder, drum, start), name, size of the change and its standard uncertainty in unit; rest:
    remaining chi-squared, with twice its degrees of freedom; detectable: the size that would be detected with `POWER`, the mean over
    directions."""

    kind: str
    name: str
    size: float
    u: float
    unit: str
    rest: float
    detectable: float


@dataclass(frozen=True)
class Verdict:
    """chi_squared of the parities, degrees of freedom, probability of as much by chance; causes: the likeliest first; named: those that
    cannot be determined from the likeliest, none while all agrees."""

    chi_squared: float
    freedom: int
    probability: float
    causes: tuple[Cause, ...]
    named: tuple[Cause, ...]


def agreement(reconstruction: Reconstruction, stops: Stops, alarm: float) -> Verdict | None:
    """Return the agreement of the stops with the given rate of false alarms; None without redundant channels."""
    # origins determined by the run are not compared with it: they keep their earlier uncertainty
    readings = stops.readings + reconstruction.budget.offsets(stops.begin_s)
    reconstruction = reconstruction.with_estimate(None)
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    if redundancy is None:
        return None
    n, m = readings.shape
    counts, variance = np.nan_to_num(stops.counts), np.broadcast_to(budget.variance, (n, m))
    epochs = Epochs(stops.begin_s, readings, np.nan_to_num(readings), counts, np.zeros((n, m)), variance, None, stops.travel)
    parities = StopContradictions(reconstruction, redundancy, epochs, stops.poses)
    total, freedom = float(parities.y @ parities.y), parities.freedom
    probability = float(scipy.stats.chi2.sf(total, freedom))
    causes = sorted(parities.causes(alarm), key=lambda c: c.rest)
    named = tuple(c for c in causes if c.rest < causes[0].rest + APART) if probability < alarm and causes else ()
    return Verdict(total, freedom, probability, tuple(causes), named)


class StopContradictions:
    """Samples of a run at poses (n, 7) near the true ones, all their contradictions together: y (f,) whitened, and how causes change them.
    more (n, m, q): further errors of the readings that they share, by variables of unit variance at most."""

    def __init__(
        self, reconstruction: Reconstruction, redundancy: Redundancy, epochs: Epochs, poses: FloatArray, *, more: FloatArray | None = None
    ) -> None:
        budget, used = reconstruction.budget, np.isfinite(epochs.change_mm)
        self._budget, self._epochs, self._poses, self._unit = budget, epochs, poses, redundancy.unit
        basis = redundancy.basis(poses, used)
        # unit vectors of channels that were not read are in it: their rows are left out
        self._basis = [b[:, np.abs(b[~seen]).sum(axis=0) < 0.5] if not seen.all() else b for b, seen in zip(basis, used, strict=True)]
        residual = np.where(used, redundancy.residuals(poses, epochs.gone_on_mm), 0.0) / redundancy.unit
        self._residual, own = residual, epochs.variance_mm2 / redundancy.unit**2
        errors = redundancy.shared(epochs, poses, used) * redundancy.unit[:, None]
        # restored origins are faults, not expected errors
        errors = errors[:, :, : errors.shape[2] - len(budget.restored)]
        shared = self.seen(errors)
        # an unstated start is unknown and uses its degrees of freedom
        origins = np.abs(budget.origin_lengths(epochs.time_s)[:, :, : len(budget.origin_names) - len(budget.restored)])
        origins = origins.max(axis=(0, 1), initial=0.0)
        anywhere = shared[:, shared.shape[1] - len(origins) :][:, origins > UNKNOWN_MM / 2.0]
        self.start_known = not anywhere.shape[1]
        V = scipy.linalg.block_diag(*(b.T @ (own[i][:, None] * b) for i, b in enumerate(self._basis))) + shared @ shared.T
        self.freedom = len(V) - int(np.linalg.matrix_rank(anywhere))
        if more is not None:
            wide = self.seen(np.where(used[:, :, None], more, 0.0))
            against = np.linalg.svd(scipy.linalg.solve_triangular(np.linalg.cholesky(V), wide, lower=True), compute_uv=False) ** 2
            # they may be none: as many degrees of freedom as they could take
            self.freedom -= math.ceil(float(np.sum(against / (1.0 + against))))
            V = V + wide @ wide.T
        self._L = np.linalg.cholesky(V)
        y = np.concatenate([b.T @ r for b, r in zip(self._basis, residual, strict=True)])
        self.y = scipy.linalg.solve_triangular(self._L, y, lower=True)

    def remainder(self) -> Remainder:
        """The contradictions as residuals (n m,) in the units of `columns`."""
        n, m = self._residual.shape
        S = self.whitened(np.eye(n * m).reshape(n, m, n * m) * self._unit[:, None])
        return Remainder(S.T @ S, self._residual.ravel(), self.freedom)

    def columns(self, errors: FloatArray) -> FloatArray:
        """Return (n m, q) effects on the readings of errors (n, m, q) [mm, rad]."""
        return np.asarray((errors / self._unit[:, None]).reshape(-1, errors.shape[2]))

    def whitened(self, errors: FloatArray) -> FloatArray:
        """Return (f, q) effects on y of errors (n, m, q) of the readings [mm, rad]."""
        return np.asarray(scipy.linalg.solve_triangular(self._L, self.seen(errors), lower=True))

    def seen(self, errors: FloatArray) -> FloatArray:
        """(f, q) parities by errors (n, m, q) of readings [mm, rad]."""
        scaled = errors / self._unit[:, None]
        return np.concatenate([b.T @ e for b, e in zip(self._basis, scaled, strict=True)])

    def causes(self, alarm: float) -> Iterator[Cause]:
        """Yield each possible change, alone, that the stops determine."""
        for kind, name, unit, factor, errors in self.errors():
            A = self.whitened(errors)
            U, s, Vt = np.linalg.svd(A, full_matrices=False)
            kept = s > 1e-6 * max(float(s[0]), 1e-300)
            if not s[0] > 0.0:
                continue
            fitted = U[:, kept].T @ self.y
            change, freedom = Vt[kept].T @ (fitted / s[kept]), int(kept.sum())
            u = float(np.sqrt(np.sum(s[kept] ** -2.0) / freedom))
            rest = float(self.y @ self.y - fitted @ fitted) + 2.0 * freedom
            size = float(np.linalg.norm(change if len(change) < 6 else change[3:]))
            yield Cause(kind, name, size * factor, u * factor, unit, rest, u * factor * _noncentrality(alarm, freedom))

    def errors(self) -> Iterator[tuple[str, str, str, float, FloatArray]]:
        """kind, name, unit and its size, and errors (n, m, q) of the readings by one mm or rad of it."""
        budget, poses = self._budget, self._poses
        rows, observed = budget.scheme.rows, budget.rig.observed
        counts = np.nan_to_num(self._epochs.counts)
        since = ~budget.absolute
        g = length_gradients(rows, np.ascontiguousarray(poses), counts, budget.scales)
        at_start = length_gradients(rows, budget.model.zero_pose[None], np.zeros((1, len(rows))), budget.scales)[0]
        g = g - np.where(since[:, None], at_start, 0.0)
        for point in budget.rig.observation_point:
            own = np.array([o.from_point == point.name for o in observed])
            if own.any():
                yield "point", point.name, "mm", 1.0, np.where(own[:, None], g[:, :, BY_BASE : BY_BASE + 3], 0.0)
        for name in budget.rig.tool:
            own = np.array([o.to_point == name for o in observed])
            if own.any():
                yield "attachment", name, "mm", 1.0, np.where(own[:, None], g[:, :, BY_ATTACHMENT : BY_ATTACHMENT + 3], 0.0)
        for o in {o.channel: o for o in observed}.values():  # several passes read one drum, one encoder
            own = np.array([other.channel == o.channel for other in observed])
            if budget.rig.counter(o).absolute:
                unit, size = ("mm", 1.0) if o.is_length else ("deg", float(np.degrees(1.0)))
                yield "encoder", o.channel, unit, size, np.where(own, g[:, :, BY_ANGLE_ZERO], 0.0)[:, :, None]
            elif o.is_cable:
                yield "drum", o.from_point, "%", 100.0, np.where(own, g[:, :, BY_SCALE], 0.0)[:, :, None]
        if not self.start_known:
            return
        begun = np.where(since[:, None], span_rows(rows, budget.model.zero_pose), 0.0)
        yield "start", "start pose", "mm", 1.0, np.broadcast_to(begun, (len(poses), *begun.shape))


def _noncentrality(alarm: float, freedom: int) -> float:
    """Size, in standard uncertainties, that a test of so many degrees of freedom sees with `POWER`."""
    limit = float(scipy.stats.chi2.isf(alarm, freedom))
    seen = scipy.optimize.brentq(lambda x: scipy.stats.ncx2.sf(limit, freedom, x) - POWER, 1e-6, 1e4)
    return float(np.sqrt(seen))


SAMPLES = 40
LEFT = 1e-4
"""Probability of the remainder under which the named laws do not explain it."""
FEW = 8
"""Samples with a pose from which something is named."""
LAWS = {
    "physical.run_out": "run_out",
    "physical.eccentric_pulley": "eccentricity",
    "physical.swivel_offset": "offset",
    "physical.play": "play",
    "physical.diameter": "diameter",
    "physical.pitch": "pitch",
    "physical.radius": "radius",
    "physical.eccentric_encoder": "encoder.eccentricity",
    "physical.groove_beside": "encoder.beside",
    "physical.tilted_encoder": "encoder.tilt",
    "point": "moved.point",
    "attachment": "moved.attachment",
    "encoder": "moved.encoder",
    "start": "moved.start",
}
"""Names of kinds in the catalogues: of an effect by the id of its message, of a moved part by its word."""


def explained(reconstruction: Reconstruction) -> tuple[Message, ...]:
    """Report on a prepared run; empty without redundant channels, with several passes or a fixed part of the motion, or with temperature,
    stretch and sag to be corrected."""
    model, samples = reconstruction.model, reconstruction.samples
    rig, free = model.rig, len(model.scheme.free)
    if samples is None or model.correction is not None or rig.passes > 1 or free < len(FREEDOMS):
        return ()
    # lost counts are searched in the residuals, and would falsify poses
    right = changes_from_counts(rig, shifted(reconstruction.doubts.shifts, samples.time_s, samples.counts), rig.observed)
    changes = np.where(np.isfinite(samples.change_mm), right, np.nan)
    poses = reconstruction.poses_of(changes - reconstruction.budget.offsets(samples.time_s))
    known = np.flatnonzero(np.isfinite(poses[:, 0]) & (np.isfinite(samples.change_mm).sum(axis=1) > free))
    if len(known) < FEW:
        return ()
    chosen = known[spread(poses[known], SAMPLES)]
    epochs, poses = samples.at(chosen), np.ascontiguousarray(poses[chosen])
    return tuple(_named(reconstruction.with_estimate(None), epochs, poses))


def _named(reconstruction: Reconstruction, epochs: Epochs, poses: FloatArray) -> Iterator[Message]:
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    assert redundancy is not None
    campaign = _campaign(reconstruction, epochs, poses)
    anywhere = None
    if not budget.calibrated:
        nominal = Model(campaign, unknowns_of(campaign, ("position", "guide")))
        anywhere = _readings(nominal, nominal.jacobian(nominal.start)[:, : nominal.own] * nominal.parameters.width)
    together = StopContradictions(reconstruction, redundancy, epochs, poses, more=anywhere)
    left = together.remainder()
    model = Model(campaign, Parameters((), np.zeros(0), np.zeros(0)))
    travel = np.vstack([np.zeros((1, len(budget.rig.observed))), np.zeros_like(epochs.counts) if epochs.travel is None else epochs.travel])
    tried = [replace(e, columns=together.columns(_readings(model, e.columns))) for e in effects(model, np.zeros(0), travel)]
    for kind, name, unit, factor, errors in together.errors():
        # a drum that counts otherwise is among the effects; of a start its place is the size
        if kind == "start":
            tried.append(Effect(kind, name, together.columns(errors[:, :, [3, 4, 5, 0, 1, 2]]), unit, factor, "", 3))
        elif kind != "drum":
            tried.append(Effect(kind, name, together.columns(errors), unit, factor, ""))
    slips, places = together.columns(_slips(epochs)), math.log(len(epochs))
    out: list[Message] = []
    while len(out) < MOST:
        judged = sorted(tested(left, tried), key=lambda pair: pair[0])
        if not judged or judged[0][0] + math.log(len(judged)) > math.log(CHANCE):
            break
        near = [effect for log_p, effect in judged if log_p <= judged[0][0] + NEAR]
        fall = float(left.falls(slips).max(initial=0.0))
        slip = fall_test(fall, 1.0, left.chi_squared - fall, left.freedom - 1.0)
        if slip is not None and slip[1] + places <= judged[0][0] + NEAR:
            return
        out.append(_said(left, near, len(judged), math.exp(judged[0][0] + math.log(len(judged)))))
        left = left.freed(near[0].columns)
        tried = [effect for effect in tried if effect is not near[0]]
    if scipy.stats.chi2.sf(left.chi_squared, left.freedom) >= LEFT:
        yield from out


def _said(left: Remainder, near: list[Effect], tried: int, p: float) -> Message:
    laws = tuple(message(f"effect.{LAWS[getattr(e.kind, 'code', e.kind)]}", channel=e.channel, size=size_of(left, e)) for e in near[:4])
    of = {"laws": laws, "p": p, "tried": tried}
    key = near[0].key
    if ":" in key:
        return message("effects.named.solve", **of, key=key)
    return message("effects.named.state", **of, key=key) if key else message("effects.named", **of)


def _campaign(reconstruction: Reconstruction, epochs: Epochs, poses: FloatArray) -> Campaign:
    """The samples as a campaign whose first pose is the start; nothing is fitted to it."""
    model = reconstruction.model
    rig, m = model.rig, len(model.rig.observed)
    counts = np.vstack([np.zeros(m), np.where(np.isfinite(epochs.change_mm), epochs.counts, np.nan)])
    counts[0, model.absolute] = np.nan
    names = ("start", *(f"{t:.3f} s" for t in epochs.time_s))
    stated = Poses(names, np.vstack([model.zero_pose, poses]), np.zeros(len(names)), np.zeros(len(names)))
    return Campaign(rig, stated, rig.observed, counts, np.zeros(m, np.int64), free_of_play=True)


def _readings(model: Model, columns: FloatArray) -> FloatArray:
    """(n, m, c) of the readings at the poses behind the start [mm, rad], from columns (e, c) of a model's residuals."""
    campaign = model.campaign
    out = np.zeros((len(campaign.poses), len(campaign.cables), columns.shape[1]))
    out[model.pose_index, model.cable_index] = columns / campaign.mm_per_unit[model.cable_index, None]
    return out[1:]


def _slips(epochs: Epochs) -> FloatArray:
    """(n, m, m (n - 1)) each channel reading more from each sample on but the first."""
    n, m = epochs.counts.shape
    behind = np.arange(n)[:, None] >= np.arange(1, n)
    return np.einsum("nk,jl->njlk", behind.astype(np.float64), np.eye(m)).reshape(n, m, m * (n - 1))
