"""What counts at a pose would tell: the calibration's information matrix as a sum over poses.

The estimator (`refine`) weighs residuals with V = diag(counts) + pose errors, where the errors of the zero pose are shared by all equations
of its cables. With these shared errors as unknowns of their own (prior: a unit normal), what is left of V is a block per pose, and the
information of a campaign is a sum over its poses,

    M = I + sum_c A_c^T A_c,    A_c = V_c^{-1/2} [J_c W, Z],

J_c the derivatives of the residuals at pose c by the unknowns, W their prior widths, Z those by the zero pose's errors, each in units of
its standard uncertainty, V_c = diag(counts) + P_c U P_c^T. By Woodbury's identity the unknowns' block of M^{-1} is the covariance of the
generalised least squares with V. I is the prior.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.unknowns import Model, Unknowns, unknowns_of
from lmeasure.kernels import cable as cable_kernels
from lmeasure.lengths import count_variance
from lmeasure.poses import Poses
from lmeasure.rig import Cable, Rig

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Zero:
    """Where the counters are zeroed: rows (z, 7) of distinct poses, of (m,) which of them each cable has, and their standard uncertainties
    u_position_mm, u_rotation_rad (z,)."""

    rows: FloatArray
    of: IntArray
    u_position_mm: FloatArray
    u_rotation_rad: FloatArray


class Instrument:
    """A rig about to be calibrated: its measured cables (m), the unknowns (p) and the noise of a reference pose.

    u_position_mm, u_rotation_rad: standard uncertainty of each coordinate and each small rotation of a pose to be measured. Everything is
    linearised at the rig's own values.
    """

    def __init__(self, rig: Rig, cables: tuple[Cable, ...], solve: tuple[str, ...], u_position_mm: float, u_rotation_rad: float) -> None:
        self.rig, self.cables = rig, cables
        self.u_position_mm, self.u_rotation_rad = u_position_mm, u_rotation_rad
        self.unknowns: Unknowns = unknowns_of(self._campaign(np.zeros((0, 7)), np.zeros((0, 7)), np.zeros(0, np.int64), ()), solve)
        self._variance = count_variance(rig, cables)

    def zero(self, row: FloatArray) -> Zero:
        """All counters zeroed at one pose (7,), known as well as any other."""
        return Zero(row[None, :], np.zeros(len(self.cables), np.int64), np.array([self.u_position_mm]), np.array([self.u_rotation_rad]))

    def _campaign(self, zeros: FloatArray, rows: FloatArray, of: IntArray, cables: tuple[Cable, ...]) -> Campaign:
        """What the rig would count, not rounded, at the zero poses (z, 7) and then at rows (n, 7)."""
        every = np.ascontiguousarray(np.vstack([zeros, rows]))
        none = np.zeros(len(every))
        poses = Poses(tuple(str(i + 1) for i in range(len(every))), every, none, none)
        if not cables:
            return Campaign(self.rig, poses, self.cables, np.zeros((0, len(self.cables))), np.zeros(len(self.cables), np.int64))
        kernel_rows = self.rig.cable_rows(cables)
        lengths = cable_kernels.span_lengths(kernel_rows, every)
        counts = cable_kernels.counts_from_changes(kernel_rows, lengths - lengths[of, np.arange(len(cables))])
        counts[: len(zeros)] = np.nan
        counts[of, np.arange(len(cables))] = 0.0
        return Campaign(self.rig, poses, cables, counts, of)

    def gradients(self, rows: FloatArray, zero: FloatArray, of: IntArray, cables: tuple[Cable, ...]) -> FloatArray:
        """(n, m, p) derivatives of modelled less measured changes [mm] at usable poses rows (n, 7), since the zero poses zero (z, 7) that
        of (m,) names, by the unknowns in units of their prior widths."""
        model = Model(self._campaign(zero, rows, of, cables), self.unknowns)
        return (model.jacobian(self.unknowns.nominal) * self.unknowns.width).reshape(len(rows), len(cables), -1)

    def blocks(self, rows: FloatArray, zero: Zero) -> FloatArray:
        """(n, m, p + 6 z) the matrices A_c of usable poses rows (n, 7)."""
        n, m, z = len(rows), len(self.cables), len(zero.rows)
        kernel_rows = self.rig.cable_rows(self.cables)
        A = np.zeros((n, m, len(self.unknowns.names) + 6 * z))
        A[:, :, : len(self.unknowns.names)] = self.gradients(rows, zero.rows, zero.of, self.cables)
        for i in range(z):
            own = zero.of == i
            first = len(self.unknowns.names) + 6 * i
            sigma = np.repeat([zero.u_rotation_rad[i], zero.u_position_mm[i]], 3)
            A[:, own, first : first + 6] = -cable_kernels.span_rows(kernel_rows, zero.rows[i])[own] * sigma
        sigma = np.repeat([self.u_rotation_rad, self.u_position_mm], 3)
        if not sigma.any():
            return A / np.sqrt(self._variance)[:, None]
        P = np.array([cable_kernels.span_rows(kernel_rows, row) for row in np.ascontiguousarray(rows)]).reshape(n, m, 6) * sigma
        V = np.diag(self._variance) + P @ P.transpose(0, 2, 1)
        return np.asarray(np.linalg.solve(np.linalg.cholesky(V), A))

    def recorded(self, campaign: Campaign) -> tuple[FloatArray, Zero]:
        """(q, q) information of poses already counted, without the prior, and their zero poses; q = p + 6 z.

        Gaps and cables zeroed at different poses are as in the campaign; counts are those the rig predicts.
        """
        distinct, of = np.unique(campaign.zero, return_inverse=True)
        poses = campaign.poses
        zero = Zero(poses.rows[distinct], of.astype(np.int64), poses.u_position_mm[distinct], poses.u_rotation_rad[distinct])
        kernel_rows = self.rig.cable_rows(self.cables)
        lengths = cable_kernels.span_lengths(kernel_rows, np.ascontiguousarray(poses.rows))
        changes = lengths - lengths[campaign.zero, np.arange(len(self.cables))]
        counts = np.where(np.isfinite(campaign.counts), cable_kernels.counts_from_changes(kernel_rows, changes), np.nan)
        model = Model(Campaign(self.rig, poses, self.cables, counts, campaign.zero), self.unknowns)
        J = model.jacobian(self.unknowns.nominal) * self.unknowns.width
        sigma = np.column_stack([np.repeat(poses.u_rotation_rad[:, None], 3, 1), np.repeat(poses.u_position_mm[:, None], 3, 1)])
        errors = (model.pose_jacobian(self.unknowns.nominal) * sigma).transpose(1, 0, 2)
        others = np.setdiff1d(np.arange(len(poses)), distinct)
        A = np.hstack([J, *errors[distinct], *errors[others]]) / np.sqrt(self._variance[model.cable_index])[:, None]
        M = A.T @ A
        kept = J.shape[1] + 6 * len(distinct)
        # the errors of the other poses concern nothing else: out with them, by Schur's complement
        aside = M[kept:, kept:] + np.eye(len(M) - kept)
        return np.asarray(M[:kept, :kept] - M[:kept, kept:] @ np.linalg.solve(aside, M[kept:, :kept])), zero


def parameter_information(M: FloatArray, p: int) -> FloatArray:
    """(p, p) information about the unknowns alone, from (q, q) without a prior on them: the zero pose's errors eliminated."""
    if len(M) == p:
        return M
    return np.asarray(M[:p, :p] - M[:p, p:] @ np.linalg.solve(M[p:, p:] + np.eye(len(M) - p), M[p:, :p]))


def estimated_covariance(information: FloatArray) -> tuple[FloatArray, int]:
    """(p, p) covariance in units of prior widths as the estimator states it, and how many directions the data determine.

    A direction better known from the data than from the prior is left to the data, any other to the prior (see `refine`).
    """
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    known = values > 1.0
    variance = np.where(known, 1.0 / np.where(known, values, 1.0), 1.0)
    return np.asarray((vectors * variance) @ vectors.T), int(known.sum())
