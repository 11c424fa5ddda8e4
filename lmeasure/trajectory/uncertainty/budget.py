"""Sources of a pose's uncertainty, sample by sample: errors new at every sample, and common errors of a whole run.

A pose error is delta = G dl, G the inverse of its rows. Random are the lengths' own errors, independent from sample to sample. Systematic
are a few errors common to all samples of the run: of the calibration, of the sub-count offset at zeroing, of the start pose, of a pass's
clock and position. Each is a variable z_k of unit variance, normal or uniform; the pose error is sum_k factor_k z_k, with factors of its
own at every sample and the same z: from the factors the errors of differences, means and lines follow, which do not follow from covariances
of single samples (JCGM 102, 6.2; GTC). For the sources see `trajectory.uncertainty.sources`.

A variable is stated, calibrated or assumed: of a typical size without a statement. `Source.assumed` names it.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmeasure import kernels, sensors
from lmeasure.core import BoolArray, DataFrame, FloatArray, Shown, covariance_root, framed, se3
from lmeasure.rig import FURTHER, STEEL_PER_K, TABLE, WARMER_K, Owner
from lmeasure.sensors import length_variance
from lmeasure.text import message
from lmeasure.trajectory.reconstruction.run_model import RunModel
from lmeasure.trajectory.uncertainty.assumed import Assumed, assumed_of, place_of, positions_95
from lmeasure.trajectory.uncertainty.sources import (
    ANYWHERE,
    NEAR_RAD,
    UNKNOWN_MM,
    ZERO,
    OriginEstimate,
    Situation,
    Source,
    angle_of,
    beyond_first,
    is_rough,
    own_lengths,
    second_order_variables,
    unknown_start,
    unknown_zeros,
    variance_until_determined,
    zero_columns,
    zero_phase,
    zeros_of,
)


@dataclass(frozen=True, repr=False)
class PoseCovariances(Shown):
    """Errors of n poses: random errors of m channels and K shared systematic errors.

    An error is delta = (rotation [rad]; tool origin [mm]) in the base frame, R_true = Exp(delta_rotation) R; NaN where there is no pose.
    The systematic errors at samples i and j have the covariance factors[i] @ factors[j].T.

    Examples
    --------
    >>> poses = lm.covariances(trajectory, simulated.run.run)
    >>> poses.random.shape, len(poses.sources) == poses.factors.shape[2]
    ((58, 6, 6), True)
    """

    own: FloatArray
    """(n, 6, m) random error own @ u, with u (m,) of unit variance and independent at each sample."""
    factors: FloatArray
    """(n, 6, K) systematic error factors @ z, with one z (K,) of unit variance for the whole run."""
    sources: tuple[str, ...]
    """Source of each systematic error, K, such as "calibration" or "start pose"."""
    uniform: tuple[bool, ...] = ()
    """Whether each systematic error is uniform instead of normal, K; empty: all normal."""
    assumed: tuple[str, ...] = ()
    """Key of the typical size of each systematic error, K, empty for stated or calibrated ones; empty: none is assumed."""

    def about(self) -> dict[str, str]:
        """Return the number of poses, their largest errors, and common errors."""
        random, shared = (np.sqrt(np.einsum("nii->ni", c)) for c in (self.random, self.systematic))
        largest = {name: np.nanmax(u[:, 3:], initial=0.0) for name, u in (("random u", random), ("shared u", shared))}
        sources = {source: self.sources.count(source) for source in self.sources}
        return {
            "poses": str(len(self.own)),
            **{f"largest {name}": f"{value:.3g} mm" for name, value in largest.items()},
            "shared by": ", ".join(f"{source} ({n})" for source, n in sources.items()) or "nothing",
        }

    def to_frame(self) -> DataFrame:
        """Return standard uncertainties of each pose, base axes: its own, and common ones."""
        names = ("rx_rad", "ry_rad", "rz_rad", "x_mm", "y_mm", "z_mm")
        parts = (("u", self.random), ("u_systematic", self.systematic))
        return framed({f"{part}_{name}": np.sqrt(c[:, i, i]) for part, c in parts for i, name in enumerate(names)})

    @property
    def random(self) -> FloatArray:
        """Return the (n, 6, 6) covariance of the part that is independent between samples."""
        return np.asarray(self.own @ np.swapaxes(self.own, 1, 2))

    @property
    def systematic(self) -> FloatArray:
        """(n, 6, 6) covariance of the systematic error at each sample."""
        return np.asarray(self.factors @ np.swapaxes(self.factors, 1, 2))


class ParameterErrors:
    """Errors of a rig's channels by independent variables of unit variance: solved from the linked calibration, dimensions also from the
    rig's stated uncertainties. cancels: whether errors that also act at the start of counting cancel, unless the start came from
    lengths."""

    def __init__(self, model: RunModel, *, cancels: bool) -> None:
        rig, scheme, calibration = model.rig, model.scheme, model.calibration
        observed, self._wide = rig.observed, sensors.further_solved(calibration)
        self._rows, self._scales, self._zero, self._cables = scheme.rows, rig.scales(observed), model.zero_pose, len(rig.cable)
        self._cancels, self._absolute = cancels, model.absolute
        table = (*TABLE, *FURTHER) if self._wide else TABLE
        # where a point itself is measured its place in the tool frame has no part
        enters = np.tile([scheme.point is None or p.owner is not Owner.ATTACHMENT for p in table], len(scheme.rows))
        # the remainder of separately solved parameters may be rounding: take the width from the whole
        width = np.sqrt(np.diag(sensors.cable_covariance(rig, calibration, observed, wide=self._wide)))
        of_record = sensors.solved_covariance(rig, calibration, observed, wide=self._wide)
        solved = covariance_root(np.where(enters[:, None] & enters, of_record, 0.0), width)
        columns, assumed = sensors.unsolved_dimensions(rig, calibration, observed, wide=self._wide)
        dimensions = np.where(enters[:, None], columns, 0.0)
        acting = np.asarray(dimensions.any(axis=0))
        dimensions = dimensions[:, acting]
        self.assumed = ("",) * solved.shape[1] + tuple(key for key, acts in zip(assumed, acting.tolist(), strict=True) if acts)
        """(r,) typical size of each variable, empty for stated or calibrated ones."""
        self.solved, self.dimensions = solved.shape[1], dimensions.shape[1]
        every = np.column_stack([solved, dimensions])
        every = every.reshape(len(observed), sensors.width_of(wide=self._wide), every.shape[1])
        self._of_kernels = np.ascontiguousarray(every[:, : len(kernels.PARAMETERS)])
        # a groove's pitch moved the pay-out point on the way to where the counter was zeroed
        turns = np.array([rig.paid_out((c,))[0] / rig.counter(c).counts_per_revolution for c in rig.cable])
        self._of_kernels[: self._cables, kernels.BY_AXIAL] += turns[:, None] * self._of_kernels[: self._cables, kernels.BY_PITCH]
        self._of_parts = every[: self._cables, len(kernels.PARAMETERS) :]
        self._parts = sensors.every_part(rig, rig.cable)

    @property
    def root(self) -> FloatArray:
        """(13 m, r) errors of the kernels' parameters by the variables."""
        m, width, r = self._of_kernels.shape
        return self._of_kernels.reshape(m * width, r)

    def lengths(self, poses: FloatArray, counts: FloatArray, travel: FloatArray | None) -> FloatArray:
        """(n, m, r) errors of the lengths by the variables, at (n, 7) poses and true counts (n, m) whose last travel is travel (n, m), 0
        where it is None. A parameter acts at the pose and at the zero pose, where counting began."""
        gradients = kernels.length_gradients(self._rows, poses, counts, self._scales)
        if self._cancels:
            begun = kernels.length_gradients(self._rows, self._zero[None], np.zeros((1, len(self._rows))), self._scales)[0]
            gradients -= np.where(self._absolute[:, None], 0.0, begun)
        out = -np.swapaxes(np.swapaxes(gradients, 0, 1) @ self._of_kernels, 0, 1)
        return out + self.of_parts(poses, counts, travel) if self._wide else out

    def of_parts(self, poses: FloatArray, counts: FloatArray, travel: FloatArray | None) -> FloatArray:
        """(n, m, r) the share of `sensors.imperfect_parts` in `lengths`; (1, 1, r) zeros where the calibration solved none."""
        if not self._wide:
            return np.zeros((1, 1, self._of_kernels.shape[2]))
        m = self._cables
        ways = None if travel is None else travel[:, :m]
        zero = np.tile(self._zero, (m, 1)), np.zeros(m)
        k = np.ascontiguousarray(counts[:, :m])
        gradients = self._parts.gradient(self._rows[:m], zero, poses, k, travel=ways, since=self._cancels)
        out = np.zeros((*counts.shape, self._of_parts.shape[2]))
        out[:, :m] = -np.einsum("nmk,mkr->nmr", gradients, self._of_parts)
        return out


BY_CALIBRATION = "calibration"
RESTORED = "restored origin"
RESTORED_ORIGIN = "cause.restored"
"""Cause of a sample with a channel whose origin was restored."""
ORIGINS = "origins of the channels"
PHYSICAL = "temperature, stretch and sag"
DIMENSIONS = "dimensions as stated"
TEMPERATURE = "temperature"
SAMPLED = 64  # Poses of a piece at which the effect of assumed sizes is computed
CHUNK = 2048  # poses whose factors are in memory at once


class Budget:
    """The sources of error of one run.

    Origins that the run determined, and channels with a changed one, make a new budget: `with_estimate`, `with_restored`.
    """

    estimate: OriginEstimate | None = None
    """Origins as the run determined them."""
    restored: tuple[tuple[int, float, float], ...] = ()
    """Channels (index) with another origin behind a time and until one [s]."""

    def __init__(self, model: RunModel) -> None:
        rig, scheme, calibration, u_start, assumed_start = model.rig, model.scheme, model.calibration, model.u_start, model.assumed_start
        self.model, self.rig, self.scheme, self.correction = model, rig, scheme, model.correction
        observed, self._cables = rig.observed, len(rig.cable)
        self.scales, self.variance = rig.scales(observed), sensors.count_variance(rig, observed)
        self._before = length_variance(rig, observed)
        if scheme.redundancy:
            self._before = self._before + variance_until_determined(zeros_of(rig, calibration), len(scheme.free)) / angle_of(rig) ** 2
        rough = zero_columns(rig, calibration)[0]
        # without further information, pose errors far exceed their first-order part
        self._rough = rough[:, (rough * angle_of(rig)[:, None] > NEAR_RAD).any(axis=0)] if not scheme.redundancy else rough[:, :0]
        self.absolute, self._zero = model.absolute, model.zero_pose
        # constrained values are exact; the position of a point takes part in all
        moving = np.ones(6, np.bool_) if scheme.point is not None else np.isin(np.arange(6), scheme.free_index)
        self._u_start = np.where(moving, np.repeat([u_start[1], u_start[0]], 3), 0.0)
        at_start = sensors.span_rows(rig.cable_rows(observed), model.start[None])[1][0]
        errs = self._u_start > 0.0
        self._start_lengths = np.where(self.absolute[:, None], 0.0, at_start * self._u_start)[:, errs]
        of_start = tuple(np.repeat([assumed_start[1], assumed_start[0]], 3)[errs].tolist())
        # a start from lengths has the errors of the rig: then nothing cancels where counting began
        self._u_length = u_start[2] if len(u_start) > 2 else None
        if self._u_length:
            self._start_lengths = np.column_stack([self._start_lengths, self._u_length * np.eye(len(observed), len(rig.cable))])
            of_start += (assumed_start[2],) * len(rig.cable)
        self.by_parameter = ParameterErrors(model, cancels=self._u_length is None)
        solved, dimensions = self.by_parameter.solved, self.by_parameter.dimensions
        self._passage = np.array([c.passage for c in observed], dtype=np.int64)
        self._clocks, self._repeatability_mm = model.clocks, model.repeatability_mm if rig.passes > 1 else 0.0
        late = tuple(message("source.clock", number=p) for p, clock in enumerate(model.clocks, 1) for _ in range(clock.variables))
        several = range(1, rig.passes + 1) if self._repeatability_mm else ()
        places = tuple(message("source.place", number=p) for p in several for _ in range(3))
        physical = (PHYSICAL,) * (0 if model.correction is None else model.correction.sources)
        known = () if calibration is None else calibration.names
        errors = [*sensors.stated(rig, None, known, sensors.OTHERS), *sensors.phase_errors(rig, known, model.start)]
        self.unsolved = sensors.Unsolved(rig, errors)
        play = np.abs(sensors.every_part(rig, rig.cable).values[:, sensors.PLAY])
        self._played_mm = play * [rig.counter(c).per_count for c in rig.cable] / rig.scales()
        self._begun, self._quantum = sensors.zero_at(self._zero, len(rig.cable), 0.0), 1.0 / self.scales
        playing = int(np.count_nonzero(self._played_mm))
        of_drums = self.unsolved.sources + self.unsolved.play_sources + (message("source.play"),) * playing
        of_assumed = self.unsolved.assumed + self.unsolved.play_assumed + ("",) * playing
        said_of_drums = tuple(dict.fromkeys(said for said, key in zip(of_drums, of_assumed, strict=True) if not key))
        self._phase, key = zero_phase(rig), self.by_parameter.assumed
        parameters = (BY_CALIBRATION,) * solved + (DIMENSIONS,) * dimensions, (message("source.dimensions"),) * (not all(key[solved:]))
        start = ("start pose",) * self._start_lengths.shape[1], (message("covers.of.start"),) * (not all(of_start))
        moved = (
            Source(*parameters, lambda at: self.by_parameter.lengths(at.poses, at.counts, at.travel), assumed=key),
            Source(*start, lambda _: self._start_lengths, assumed=of_start),
        )
        start_columns = unknown_start(rig, self.absolute) if model.begun is not None else Source((), (), lambda _: np.empty((0, 0)))
        by_length = (
            self._phase,
            start_columns,
            Source((*late, *places), (message("covers.of.passes"),), self._pass_lengths),
            Source(physical, (message("source.effects"),), self._physical_lengths),
            Source(of_drums, said_of_drums, self._drum_lengths, assumed=of_assumed),
            Source((TEMPERATURE,) * len(model.temperatures_assumed), (), self._warm_lengths, assumed=model.temperatures_assumed),
            own_lengths(rig, calibration),
            unknown_zeros(rig, calibration),
        )
        self.by_length = tuple(source for source in by_length if source.names)
        """The sources that act on the lengths as such, not by the rig or the start pose: Monte Carlo draws them so."""
        every = (*(source for source in moved if source.names), *self.by_length)
        self.origins = tuple(source for source in every if source in (moved[1], self._phase, start_columns, by_length[-1]))
        """Sources of the origins of counting."""
        self.every = (*(source for source in every if source not in self.origins), *self.origins)
        """All sources of systematic error, the origins last."""
        self.supposed = np.zeros(len(self.origin_names))
        """(o,) values of the origins' variables before a run has determined them."""
        said = [text for source in self.every for text in source.said]
        said += [message("covers.of.assumed")] * any(map(any, (s.assumed for s in self.every)))
        self.covers = _covers(calibration is not None, said)

    def with_estimate(self, estimate: OriginEstimate | None) -> "Budget":
        """Return the budget after a run determined its origins; before it where the estimate is None."""
        return self._changed(estimate=estimate)

    def with_restored(self, cable: int, after_s: float, until_s: float = np.inf) -> "Budget":
        """Return the budget of a run whose channel continues from another origin behind a time, for the run to determine."""
        u = ANYWHERE if self.scheme.rows[cable, kernels.KIND] > kernels.CABLE else UNKNOWN_MM
        own = np.where(np.arange(len(self.scheme.rows)) == cable, u, 0.0)[:, None]

        def lengths(at: Situation) -> FloatArray:
            return np.asarray(((at.time_s > after_s) & (at.time_s <= until_s))[:, None, None] * own)

        source = Source((RESTORED,), (message("covers.of.restored"),), lengths)
        more = {"origins": (*self.origins, source), "every": (*self.every, source), "supposed": np.append(self.supposed, 0.0)}
        return self._changed(**more, restored=(*self.restored, (cable, after_s, until_s)), estimate=None)

    def with_zeros(self, zeros: FloatArray) -> "Budget":
        """Return the budget that takes rough zeros (k,), of `rough_columns`, in standard uncertainties, for these from the beginning."""
        columns = zero_columns(self.rig, self.model.calibration)[0]
        of_zeros = np.flatnonzero([name == ZERO for name in self.origin_names])
        supposed = self.supposed.copy()
        supposed[of_zeros[is_rough(self.rig, columns)]] = zeros
        return self._changed(supposed=supposed)

    def _changed(self, **values: Any) -> "Budget":
        changed = copy(self)
        vars(changed).update(values)
        return changed

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the source of each variable of the systematic errors, as in `PoseCovariances.sources`."""
        mixed = () if self.estimate is None else self.origins
        names = (ORIGINS if source in mixed else name for source in self.every for name in source.names)
        return (*names, *(ZERO,) * second_order_variables(self._rough.shape[1]))

    @property
    def uniform(self) -> tuple[bool, ...]:
        """Return whether each variable of the systematic errors is uniform, or normal."""
        mixed = () if self.estimate is None else self.origins
        uniform = (source.uniform and source not in mixed for source in self.every for _ in source.names)
        return (*uniform, *(False,) * second_order_variables(self._rough.shape[1]))

    def restored_origins(self) -> list[tuple[int, float, float, float, float]]:
        """Return, for each restored channel its index, from when and until when [s], by how much its readings were too large, and the
        standard uncertainty of that, as the run determined."""
        if self.estimate is None:
            return []
        out, n = [], len(self.restored)
        for k, (cable, after_s, until_s) in enumerate(self.restored, len(self.estimate.mean) - n):
            u = ANYWHERE if self.scheme.rows[cable, kernels.KIND] > kernels.CABLE else UNKNOWN_MM
            i = len(self.estimate.covariance) - len(self.estimate.mean) + k
            out.append((cable, after_s, until_s, float(self.estimate.mean[k]) * u, float(np.sqrt(self.estimate.covariance[i, i])) * u))
        return out

    @property
    def length_variance(self) -> FloatArray:
        """Return the (m,) variance [mm^2, rad^2] of a single reading, with the offset at zeroing and the zero if the run has not determined
        them: readings are weighted and distinguished by it."""
        return self._before if self.estimate is None else self.variance

    @property
    def weights(self) -> FloatArray:
        """(m,) of readings against each other, about 1 of lengths."""
        return np.asarray(np.sqrt(self.length_variance[: self._cables].min() / self.length_variance))

    @property
    def origin_names(self) -> tuple[str, ...]:
        """Return (o,) the sources of the origins' variables."""
        return tuple(name for source in self.origins for name in source.names)

    def origin_lengths(self, time_s: FloatArray) -> FloatArray:
        """(n, m, o) errors of the readings at times (n,) by the variables of the origins, as they were before a run determined of them."""
        n, m = len(time_s), len(self.scheme.rows)
        nowhere = Situation(time_s, np.empty((n, 0)), np.empty((n, m)), np.empty((n, m)))
        return self._lengths_of(nowhere, self.origins)

    def offsets(self, time_s: FloatArray) -> FloatArray:
        """Return (n, m) corrections of readings at times (n,) from the origins that the run determined."""
        mean = self.supposed if self.estimate is None else self.estimate.mean
        return np.asarray(self.origin_lengths(time_s) @ mean) if mean.any() else np.zeros((1, len(self.scheme.rows)))

    def estimated_offsets(self, time_s: FloatArray) -> FloatArray:
        """Return (n, m) corrections of readings at times (n,), minus the supposed ones, from the origins that the run determined."""
        if self.estimate is None:
            return np.zeros((1, len(self.scheme.rows)))
        return np.asarray(self.origin_lengths(time_s) @ (self.estimate.mean - self.supposed))

    @property
    def calibrated(self) -> bool:
        """Return whether a calibration is linked."""
        return self.model.calibration is not None

    @property
    def one_motion(self) -> bool:
        """Return whether several passes count as one motion, exactly repeated."""
        return self.rig.passes > 1 and self._repeatability_mm == 0.0

    def of(
        self, at: Situation, u_mm: FloatArray | None = None, unused: BoolArray | None = None, *, compiled: bool = True
    ) -> PoseCovariances:
        """Covariances and factors of poses in a situation, travel as `travel` gives it; u_mm: as `Lengths.u_mm`; unused (n, m): cables
        that were left out; compiled: by the kernels, for many poses."""
        G, own = self._own(at.poses, at.counts, u_mm, unused, compiled)
        factors = self._factors(G, at, self.every)[0]
        mixed = () if self.estimate is None else self.origins
        assumed = tuple("" if source in mixed else key for source in self.every for key in _assumed_in(source))
        return PoseCovariances(own, factors, self.sources, self.uniform, assumed + ("",) * (len(self.sources) - len(assumed)))

    def lengths_of(self, situation: Situation, sources: tuple[Source, ...]) -> FloatArray:
        """(n, m, K) errors of the lengths [mm] by one standard deviation of each variable of these sources; of all, as a run determined."""
        lengths = self._lengths_of(situation, sources)
        return lengths if self.estimate is None or sources is not self.every else np.asarray(lengths @ self.estimate.mix)

    def _lengths_of(self, situation: Situation, sources: tuple[Source, ...]) -> FloatArray:
        n, m = situation.counts.shape
        every = [np.empty((n, m, 0))]
        for source in sources:
            lengths = source.lengths(situation)
            every.append(np.broadcast_to(lengths, (n, *lengths.shape[-2:])))
        return np.concatenate(every, axis=2)

    def speed_mm_s(self, lengths: sensors.Lengths) -> FloatArray:
        """(n, m) speeds of the cables, for `of`; zero where nothing of this run is uncertain in time, and no speed matters."""
        timed = lengths.u_time_s is not None or any(clock.variables for clock in self._clocks)
        return lengths.speed_mm_s if timed else np.broadcast_to(0.0, lengths.counts.shape)

    def travel(self, lengths: sensors.Lengths, state: FloatArray | None = None) -> FloatArray | None:
        """(n, m) which way the cables of a run travelled last, as `last_travel` has it and its state; None where nothing depends on it."""
        return sensors.last_travel(lengths.counts, self._quantum, state) if self.unsolved.play_mm.any() or self._played_mm.any() else None

    def covariances(
        self,
        poses: FloatArray,
        lengths: sensors.Lengths,
        unused: BoolArray | None = None,
        compiled: bool = True,
        *,
        travel: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n, 6, 6) random and systematic covariances of the (n, 7) poses of a run, as `of`, in little memory for many poses; and (n,) the
        radius that holds 95 % of the position's errors by assumed sizes alone [mm], NaN where there is no pose."""
        random, systematic, assumed_mm = np.empty((len(poses), 6, 6)), np.empty((len(poses), 6, 6)), np.empty(len(poses))
        speed_mm_s, u_mm = self.speed_mm_s(lengths), lengths.u_mm
        # each counter zeroed by itself, and all anywhere: the phases scatter as the counts do, and cost nothing
        alike = self.estimate is None and u_mm is None and len(self._phase.names) == len(self.variance)
        sources = tuple(source for source in self.every if source is not self._phase) if alike else self.every
        for begin in range(0, len(poses), CHUNK):
            part = slice(begin, begin + CHUNK)
            own_mm, warm, gone = (None if of is None else of[part] for of in (u_mm, lengths.temperature_c, travel))
            left = None if unused is None else unused[part]
            G, own = self._own(poses[part], lengths.counts[part], own_mm, left, compiled)
            random[part] = own @ np.swapaxes(own, 1, 2)
            systematic[part] = random[part] if alike else np.where(np.isnan(random[part]), np.nan, 0.0)
            assumed_mm[part] = np.where(np.isnan(poses[part, 0]), np.nan, 0.0)
            if sources:
                at = Situation(lengths.time_s[part], poses[part], lengths.counts[part], speed_mm_s[part], warm, gone)
                factors, of_assumed = self._factors(G, at, sources)
                systematic[part] += factors @ np.swapaxes(factors, 1, 2)
                if of_assumed.shape[2]:
                    assumed_mm[part] = positions_95(of_assumed)
        return random, systematic, assumed_mm

    def assumed_of_run(
        self, poses: FloatArray, lengths: sensors.Lengths, unused: BoolArray | None = None, *, travel: FloatArray | None = None
    ) -> Assumed:
        """Return the effect of assumed sizes on the uncertainty at some of the (n, 7) poses of a run."""
        known = np.flatnonzero(~np.isnan(poses[:, 0]))
        some = known[:: -(-len(known) // SAMPLED)] if len(known) else known
        u_mm, warm, gone = (None if of is None else of[some] for of in (lengths.u_mm, lengths.temperature_c, travel))
        at = Situation(lengths.time_s[some], poses[some], lengths.counts[some], self.speed_mm_s(lengths)[some], warm, gone)
        return self.assumed(at, u_mm, None if unused is None else unused[some])

    def assumed(self, at: Situation, u_mm: FloatArray | None = None, unused: BoolArray | None = None, *, places: bool = False) -> Assumed:
        """Return the effect of assumed sizes on the uncertainty of poses; u_mm, unused: as in `of`; places: and where they are largest."""
        keys = np.array([key for source in self.every for key in _assumed_in(source)])
        exact = self.rig.unstated == "exact" and self.model.exact
        if not keys.any() or not len(at.poses):
            return Assumed(exact=exact)
        poses = np.ascontiguousarray(at.poses)
        if self.scheme.point is not None:
            poses[:, 3:] = (0.0, 0.0, 0.0, 1.0)
        at = replace(at, poses=poses)
        G, own = self._own(poses, at.counts, u_mm, unused, compiled=False)
        columns = self._lengths_of(at, self.every)
        columns = np.where(np.isfinite(columns), columns, 0.0)
        mix = np.eye(columns.shape[2]) if self.estimate is None else self.estimate.mix

        def part(of: BoolArray) -> FloatArray:
            return np.asarray(G @ columns[:, :, of] @ mix[of])

        groups = {key: part(keys == key) for key in dict.fromkeys(keys[keys != ""].tolist())}
        found = assumed_of(own, part(np.ones(len(keys), np.bool_)), groups)
        return replace(found, where=place_of(poses, positions_95(part(keys != "")))) if places else found

    def drawn_start(self, generator: "np.random.Generator", moved: FloatArray) -> FloatArray:
        """(7,) the start as the scheme takes it, displaced by a draw of its errors; by the rig's moved rows where it came from lengths."""
        if self._u_length is not None:
            lengths = kernels.span_lengths(self.scheme.rows, self._zero[None])[0] + self._u_length * generator.standard_normal(len(moved))
            return np.asarray(kernels.solve_pose(moved, lengths, self._zero)[3])
        delta = self._u_start * generator.standard_normal(6)
        return self.scheme.start_of(se3.displaced(self.model.start, delta))

    def _own(
        self, poses: FloatArray, counts: FloatArray, u_mm: FloatArray | None, unused: BoolArray | None, compiled: bool
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 6, m) each: twists per unit of each length, and the random errors as `PoseCovariances.own` has them."""
        G = self.twists(np.ascontiguousarray(poses), counts, unused, compiled)
        whole = np.sqrt(self.variance + (0.0 if u_mm is None else u_mm**2))
        return G, G * np.broadcast_to(whole, counts.shape)[:, None, :]

    def _factors(self, G: FloatArray, situation: Situation, sources: tuple[Source, ...]) -> tuple[FloatArray, FloatArray]:
        """(n, 6, K) errors of poses whose twists per unit of each length are G (n, 6, m), by the variables of these sources; and those by
        the assumed sizes among them."""
        if not sources:
            return G[:, :, :0], G[:, :, :0]
        lengths = self._lengths_of(situation, sources)
        of = np.array([bool(key) for source in sources for key in _assumed_in(source)], dtype=np.bool_)
        mix = self.estimate.mix if self.estimate is not None and sources is self.every else None

        def errors(columns: FloatArray) -> FloatArray:
            # a cable without a count, or left out, has no part in the pose
            return np.asarray(G @ np.where(np.isfinite(columns), columns, 0.0))

        factors = errors(lengths if mix is None else lengths @ mix)
        assumed = factors[:, :, of] if mix is None else factors[:, :, :0] if not of.any() else errors(lengths[:, :, of] @ mix[of])
        if not self._rough.shape[1]:
            return factors, assumed
        rows = self.scheme.rows
        beyond = beyond_first(rows, situation.poses, G=G, F=G @ self._rough, angles=rows[:, kernels.KIND] > kernels.CABLE)
        return np.concatenate([factors, beyond], axis=2), assumed

    def _pass_lengths(self, at: Situation) -> FloatArray:
        """(n, m, k) errors of the lengths by the passes' clocks and places: the cables of a pass are late and displaced together."""
        columns = [
            np.where(self._passage == p, at.speed_mm_s, 0.0)[:, :, None] * clock.late_s(at.time_s)[:, None, :]
            for p, clock in enumerate(self._clocks, 1)
        ]
        if self._repeatability_mm:
            shifts = kernels.span_rows_of(self.scheme.rows, np.ascontiguousarray(at.poses))[:, :, 3:] * self._repeatability_mm
            columns += [np.where((self._passage == p)[:, None], shifts, 0.0) for p in range(1, self._passage.max() + 1)]
        return np.concatenate(columns, axis=2)

    def _physical_lengths(self, at: Situation) -> FloatArray:
        """(n, m, q) errors of the lengths per variable of temperature, stretch and sag."""
        assert self.correction is not None
        # a modelled cable that is longer has a shorter measured length to agree with
        return self._padded(-self.correction.shifts(*self._of_cables(at)))

    def _drum_lengths(self, at: Situation) -> FloatArray:
        """(n, m, k) errors of the lengths per variable of drums and pulleys that run out, and of play."""
        poses, counts, _ = self._of_cables(at)
        played = self.unsolved.play(np.ones(counts.shape) if at.travel is None else at.travel[:, : self._cables])
        # a modelled cable that is longer has a shorter measured length to agree with
        shifts = self.unsolved.shifts(self.scheme.rows[: self._cables], self._begun, poses, counts)
        # the position within the band of stated play at zeroing is unknown
        begun = np.eye(self._cables)[:, self._played_mm > 0.0] * self._played_mm[:, None]
        return self._padded(-np.concatenate([shifts, played, np.broadcast_to(begun, (len(poses), *begun.shape))], axis=2))

    def _warm_lengths(self, at: Situation) -> FloatArray:
        """Return (n, m, k) errors of the lengths by unstated temperatures: that of the run, that of the calibration, the expansion of
        cables. With a the expansion, T0 and T the temperatures at zeroing and now, Tc that at which a count has its length, a cable of
        paid-out length D and free length L (D plus that at zeroing) changes by a (T0 - Tc) D + a (T - T0) L."""
        poses, counts, warm = self._of_cables(at)
        rows, model = self.scheme.rows[: self._cables], self.model
        paid = np.stack([sensors.drum_of(row).paid_out(counts[:, j]) for j, row in enumerate(rows)], axis=1)
        free = paid + np.hypot(rows[:, kernels.TANGENT], rows[:, kernels.AXIAL]) + sensors.free_lengths(rows, self._begun.poses)
        stated_per_k = [self.rig.point(c.from_point).drum.cable_expansion_per_k for c in self.rig.cable]
        per_k = np.array([STEEL_PER_K if value is None else value for value in stated_per_k])

        def grown(key: str) -> FloatArray:
            if key == "temperature_c":
                return per_k * WARMER_K * free
            begun = model.temperature_stated_c
            assert begun is not None
            if key == "calibration.temperature_c":
                if self.correction is not None and self.correction.thermal:
                    return self.correction.reference_shift(poses, counts, warm, WARMER_K)
                return per_k * WARMER_K * paid
            now = begun if warm is None else np.where(np.isfinite(warm), warm, begun)
            off = 0.0 if model.reference_c is None else begun - model.reference_c
            return per_k * (off * paid + (now - begun) * free)

        return self._padded(-np.stack([grown(key) for key in model.temperatures_assumed], axis=2))

    def _of_cables(self, at: Situation) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        warm = None if at.temperature_c is None else at.temperature_c[:, : self._cables]
        return at.poses, at.counts[:, : self._cables], warm

    def _padded(self, lengths: FloatArray) -> FloatArray:
        """(n, m, k) errors of all channels from those (n, cables, k) of the cables."""
        return np.pad(lengths, ((0, 0), (0, len(self.scheme.rows) - self._cables), (0, 0)))

    def twists(self, poses: FloatArray, counts: FloatArray, unused: BoolArray | None, compiled: bool) -> FloatArray:
        """Return (n, 6, m) motions of the poses per mm of each length."""
        if self.scheme.six:
            return np.asarray((kernels.pose_twists if compiled else twists_of_six)(self.scheme.rows, poses))
        weights = np.where(np.isnan(counts), 0.0, self.weights)
        if unused is not None:
            weights[unused] = 0.0
        return np.asarray(kernels.twists(self.scheme.rows, poses, weights, self.scheme.free_index))


def twists_of_six(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """Return the result of `kernels.pose_twists` without compiling: (n, 6, 6), NaN where the pose is NaN."""
    out = np.full((len(poses), 6, len(cables)), np.nan)
    known = ~np.isnan(poses[:, 0])
    out[known] = np.linalg.inv(sensors.span_rows(cables, poses[known])[1])
    return out


def _assumed_in(source: Source) -> tuple[str, ...]:
    """(k,) which typical size each variable of a source is, empty of the others."""
    return source.assumed or ("",) * len(source.names)


def _covers(calibrated: bool, more: list[str]) -> str:
    """Return the sources in the standard uncertainties, in words."""
    if not calibrated and set(more) <= {str(message("covers.of.phase"))}:
        return message("covers.resolution_phase" if more else "covers.resolution")
    parts = [message("covers.of.half_unit"), *more, *([message("covers.of.calibration")] if calibrated else [])]
    covered = message("covers.list", parts=tuple(parts[:-1]), last=parts[-1])
    return covered if calibrated else message("trajectory.rig_links_no_calibration", sources=covered)
