"""What the instrument may err by at poses of a run: its random part from the counts, its systematic part from the calibration."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.kernels import cable
from lmeasure.run import Run, RunHead
from lmeasure.trajectory import Reconstruction, Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class PoseErrors:
    """Errors (rotation [rad]; tool origin [mm]), base axes, R_true = Exp(delta) R, of n poses of one part of the program.

    random (n, 6, 6): covariance of what is independent of other poses. own (n, 6, L), shared (n, 6, K): factors of what the poses have in
    common; error = own z + shared s with standard normal z (L,), drawn once for this part, and s (K,), drawn once for the run.
    """

    random: FloatArray
    own: FloatArray
    shared: FloatArray

    def moved(self, matrices: FloatArray) -> "PoseErrors":
        """The errors of T delta, T (n, 6, 6)."""
        return PoseErrors(matrices @ self.random @ matrices.transpose(0, 2, 1), matrices @ self.own, matrices @ self.shared)


def roots(covariance: FloatArray) -> FloatArray:
    """(n, k, k) symmetric square roots of covariances (n, k, k); NaN (what is not measured) counts as zero."""
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2))


class ErrorModel(Protocol):
    """Where errors of poses come from. covers: what they hold, in words."""

    covers: str
    rounded: bool
    """Whether the random part is the rounding of counts, which a robot standing still repeats."""

    def at(self, trajectory: Trajectory, samples: IntArray, poses: FloatArray) -> PoseErrors:
        """Errors of n poses (n, 7), measured at these samples (n,)."""
        ...


class ErrorsOfRun:
    """Errors by the rig of a run: every count anywhere within half a unit, the rig's parameters as its linked calibration knows them, the
    start pose as `run.toml` states it."""

    rounded = True

    def __init__(self, run: Run | RunHead, constraint: str | None = None) -> None:
        self._solver = Reconstruction(run.rig, run.start, run.calibration, constraint, run.u_start, temperature_c=run.temperature_c)
        self.covers = self._solver.covers

    def at(self, trajectory: Trajectory, samples: IntArray, poses: FloatArray) -> PoseErrors:
        """See `ErrorModel`."""
        solver, rows = self._solver, self._solver.scheme.rows
        n, m = len(poses), len(rows)
        here = np.array(poses)
        if solver.scheme.point is not None:
            here[:, 3:] = (0.0, 0.0, 0.0, 1.0)
        counts = cable.counts_from_changes(rows, cable.span_lengths(rows, here) - cable.span_lengths(rows, solver.start[None, :]))
        found = solver.budget.of(here, counts, np.zeros((n, m)))
        return PoseErrors(found.random, np.zeros((n, 6, 0)), found.factors)


class ErrorsOfFile:
    """Errors by the standard uncertainties of a trajectory file alone, which do not say what its poses have in common.

    together: all poses of a part share them, else each has its own; neither is always the worse, so that a figure takes the larger of both.
    """

    rounded = False

    def __init__(self, together: bool) -> None:
        self.together = together
        self.covers = (
            "the standard uncertainties of the trajectory file, taken as shared by a pose's cycles or as independent, whichever is worse"
        )

    def at(self, trajectory: Trajectory, samples: IntArray, poses: FloatArray) -> PoseErrors:
        """See `ErrorModel`."""
        n = len(samples)
        covariance = trajectory.random[samples] + trajectory.systematic[samples]
        if not self.together:
            return PoseErrors(covariance, np.zeros((n, 6, 0)), np.zeros((n, 6, 0)))
        return PoseErrors(np.zeros((n, 6, 6)), roots(covariance), np.zeros((n, 6, 0)))


def at_tool_point(poses: FloatArray, offset_mm: FloatArray) -> FloatArray:
    """(n, 6, 6) matrices that take the error of the tool origin to that of a point offset_mm (3,) in the tool frame, at (n, 7) poses."""
    matrices = np.tile(np.eye(6), (len(poses), 1, 1))
    r = Rotation.from_quat(poses[:, 3:]).apply(offset_mm)
    # v_point = v + w x r = v - [r] w
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[:, 3 + i, j], matrices[:, 3 + i, k] = r[:, k], -r[:, j]
    return matrices
