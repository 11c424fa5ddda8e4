"""Information of counts at a pose, which `estimation.observability` sums, for a rig's cables.

Errors at the zero pose are shared by all equations of its cables: the pose, its approach by the robot, the sub-count offset at zeroing.
These shared errors of the cables are L eta, L L^T their covariance; a pose's own are diag(counts) + P_c U P_c^T. Poses already recorded may
share more than that (visits, several zero poses); with K the covariance of their errors with eta they bring [J W, K]^T (V - K K^T)^{-1} [J
W, K], W the prior widths. Temperature, stretch and sag are omitted: no choice of poses reduces their uncertainty.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign, extended
from lmeasure.calibration.solve.residuals import parameters_of
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import CalibrationError, FloatArray, IntArray
from lmeasure.estimation import Parameters, blocks
from lmeasure.kernels import counts_from_changes, length_gradients, span_lengths, span_rows
from lmeasure.recording import poses_from_rows
from lmeasure.rig import Observed, Rig
from lmeasure.sensors import Channels, counts_from_poses, phase_columns
from lmeasure.text import message


@dataclass(frozen=True)
class Zero:
    """Zero poses of the counters: rows (z, 7) of distinct poses, (m,) the index of each cable's, and a root (m, r) of the covariance [mm^2]
    of the cables' residuals from errors there."""

    rows: FloatArray
    of: IntArray
    root: FloatArray


@dataclass(frozen=True)
class _Channels:
    """Channels (m) at the rig's own values, which of whose parameters is which unknown (channel, parameter, unknown), and the unknowns'
    prior widths (p,) in the kernels' units."""

    of: Channels
    place: tuple[IntArray, IntArray, IntArray]
    width: FloatArray


def _channels(rig: Rig, cables: tuple[Observed, ...], unknowns: Parameters) -> _Channels:
    number, of = {name: i for i, name in enumerate(unknowns.names)}, Channels.of_rig(rig, channels=cables, covariance=False)
    where = np.array([[number.get(name, -1) for name in own] for own in of.parameters])
    channel, parameter = np.nonzero(where >= 0)
    unit = np.array([math.radians(1.0) if name.endswith("_deg") else 1.0 for name in unknowns.names])
    return _Channels(of, (channel, parameter, where[channel, parameter]), unit * unknowns.width)


class Instrument:
    """A rig about to be calibrated: its measured cables (m), the unknowns (p) and the noise of a reference pose.

    sigma, visit (6,): standard uncertainties (rotations [rad]; coordinates [mm]) of a pose to be measured, and of the robot's coming to it
    anew in every pass. Everything is linearised at the rig's own values.
    """

    def __init__(self, rig: Rig, cables: tuple[Observed, ...], solve: tuple[str, ...], sigma: FloatArray, *, visit: FloatArray) -> None:
        self.rig, self.cables, self.sigma, self.visit = rig.without_effects(), cables, sigma, visit
        self.unknowns: Parameters = parameters_of(self.rig, cables, solve)
        self._known: dict[tuple[Observed, ...], _Channels] = {}
        self._own = own = self._channels(cables).of
        read = {name for names in own.parameters for name in names}
        if lost := sorted({name.rpartition(".")[2] for name in self.unknowns.names if name not in read}):
            raise CalibrationError(message("error.solve_calibrate_finds_it", lost=", ".join(lost)))
        self._passage = own.passage
        self._variance, self._phases = own.variance * own.per_unit**2, phase_columns(self.rig, cables)

    def zero(self, row: FloatArray) -> Zero:
        """All counters zeroed at one pose (7,), known as well as any other, each anywhere within a count unless its zero is exact. Absolute
        encoders count from no pose."""
        per_unit = np.where(self._own.absolute, 0.0, self._own.per_unit)[:, None]
        P = span_rows(self._own.rows, row) * per_unit
        phases = self._phases * per_unit
        anew = [np.where((self._passage == n)[:, None], P * self.visit, 0.0) for n in np.unique(self._passage) if self.visit.any()]
        shared = np.hstack([P * self.sigma, *anew, phases])
        return Zero(row[None, :], np.zeros(len(self.cables), np.int64), _root(shared @ shared.T)[1])

    def gradients(self, rows: FloatArray, zero: FloatArray, of: IntArray, cables: tuple[Observed, ...]) -> FloatArray:
        """(n, m, p) derivatives of modelled minus measured changes [mm] at usable poses rows (n, 7), since the zero poses zero (z, 7) that
        of (m,) names, by the unknowns in units of their prior widths."""
        known, own = self._channels(cables), self._channels(cables).of
        every, j = np.ascontiguousarray(np.vstack([zero, rows])), np.arange(len(cables))
        lengths = span_lengths(own.rows, every)
        counts = counts_from_changes(own.rows, lengths - np.where(own.absolute, 0.0, lengths[of, j]))
        g = length_gradients(own.rows, every, counts, own.scale) * own.per_unit[:, None]
        g = g[len(zero) :] - np.where(own.absolute[:, None], 0.0, g[of, j])
        out = np.zeros((len(rows), len(cables), len(known.width)))
        channel, parameter, unknown = known.place
        out[:, channel, unknown] = g[:, channel, parameter]
        return np.where(np.isfinite(out), out, 0.0) * known.width

    def _channels(self, cables: tuple[Observed, ...]) -> "_Channels":
        if cables not in self._known:
            self._known[cables] = _channels(self.rig, cables, self.unknowns)
        return self._known[cables]

    def blocks(self, rows: FloatArray, zero: Zero) -> FloatArray:
        """(n, m, p + r) the matrices A_c of usable poses rows (n, 7)."""
        n, m = len(rows), len(self.cables)
        A = np.concatenate(
            [self.gradients(rows, zero.rows, zero.of, self.cables), np.broadcast_to(zero.root, (n, *zero.root.shape))], axis=2
        )
        if not (self.sigma.any() or self.visit.any()):
            return blocks(A, self._variance)
        P = np.array([span_rows(self._own.rows, row) for row in np.ascontiguousarray(rows)]).reshape(n, m, 6)
        P *= self._own.per_unit[:, None]
        stated, anew = ((P * u**2) @ P.transpose(0, 2, 1) for u in (self.sigma, self.visit))
        V = np.diag(self._variance) + stated + np.where(self._passage[:, None] == self._passage, anew, 0.0)
        return blocks(A, V)

    def predicted(self, campaign: Campaign) -> Campaign:
        """The campaign with the counts that the rig predicts at its poses, not rounded; gaps and zero poses are as they are."""
        counts, rows = np.full(campaign.counts.shape, np.nan), campaign.poses.rows
        for j, c in enumerate(self.cables):
            counted = np.isfinite(campaign.counts[:, j])
            counts[counted, j] = counts_from_poses(self.rig, rows[counted], rows[campaign.zero[j]], (c,))[:, 0]
        return replace(campaign, rig=self.rig, cables=self.cables, counts=counts, zero_variance=campaign.zero_variances)

    def recorded(self, campaign: Campaign) -> tuple[FloatArray, Zero]:
        """(p + m, p + m) information of poses already counted, without the prior, and their zero poses."""
        m, theta = len(self.cables), self.unknowns.nominal
        distinct, of = np.unique(campaign.zero, return_inverse=True)
        # with exact poses and exact readings, the residuals at the zero poses are the errors there
        exact = poses_from_rows(campaign.poses.rows[distinct], [f"zero {i}" for i in distinct])
        probes = np.where(of == np.arange(len(distinct))[:, None], 0.0, np.nan)
        model = Model(extended(self.predicted(campaign), exact, probes, reading=0.0), self.unknowns)
        V = model.measurement_covariance(theta)
        own = model.pose_index < len(campaign.poses)
        probe = np.flatnonzero(~own)[np.argsort(model.cable_index[~own])]
        vectors, root = _root(V[np.ix_(probe, probe)])
        scale = np.linalg.norm(root, axis=0)
        known = scale > 1e-9 * max(float(scale.max()), 1e-300)
        K = V[np.ix_(own, probe)] @ (vectors * np.where(known, 1.0 / np.where(known, scale, 1.0), 0.0))
        A = np.hstack([model.jacobian(theta)[own] * self.unknowns.width, K])
        M = A.T @ np.linalg.solve(V[np.ix_(own, own)] - K @ K.T, A)
        return np.asarray(M + M.T) / 2, Zero(campaign.poses.rows[distinct], of.astype(np.int64), root.reshape(m, m))


def _root(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (m, m) eigenvectors of a covariance (m, m), also scaled to its root, with as many columns as cables."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors), np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
