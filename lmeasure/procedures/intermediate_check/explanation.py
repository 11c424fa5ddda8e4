"""Which physical effect, or what has moved, would explain how the channels of an ordinary run contradict each other.

The contradictions of some samples, as far from each other as can be, are whitened together by all that they are expected to err by
(`moved.Together`: roundings, calibration, origins; of a rig that links no calibration its places and guides within their priors too).
Laws of effects (`calibration.solve.effect_candidates`) and of what may have moved compete for them by F tests. One is named where chance,
times their number (Bonferroni), is under `CHANCE`; those within odds of a hundred are named with it; then what the rest leave. Nothing is
named where a channel that reads otherwise from some sample on does as well, for then it slipped or lost counts, or where what is left in
the end contradicts itself still: then none of them is an explanation.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from lmeasure.calibration import CHANCE, MOST, NEAR, Campaign, Effect, Model, effects, size_of, spread, tested, unknowns_of
from lmeasure.core import FloatArray
from lmeasure.estimation import Parameters, Remainder, fall_test
from lmeasure.procedures.intermediate_check.moved_parts import Together
from lmeasure.recording import Poses
from lmeasure.sensors import changes_from_counts
from lmeasure.text import Message, message
from lmeasure.trajectory import FREEDOMS, Epochs, Reconstruction, shifted

SAMPLES = 40
LEFT = 1e-4
"""Probability of what the named laws leave, under which they do not explain it."""
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
"""The catalogues' name of each kind: of an effect by the id of its message, of what may have moved by its word."""


def explained(reconstruction: Reconstruction) -> tuple[Message, ...]:
    """What is to be said of a run that is prepared: nothing where it has one channel for each unknown, several passes, a part of the motion
    held, or temperature, stretch and sag to be taken off."""
    model, samples = reconstruction.model, reconstruction.samples
    rig, free = model.rig, len(model.scheme.free)
    if samples is None or model.correction is not None or rig.passes > 1 or free < len(FREEDOMS):
        return ()
    # what a counter lost is looked for among what is left, and would lead poses astray
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
    together = Together(reconstruction, redundancy, epochs, poses, more=anywhere)
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
