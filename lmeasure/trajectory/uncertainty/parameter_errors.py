"""What the rig's own values make lengths err by: those of the calibration, dimensions as stated, parts that are not as drawn."""

import numpy as np

from lmeasure.core import BoolArray, FloatArray, covariance_root
from lmeasure.kernels import PARAMETERS, length_gradients
from lmeasure.rig import FURTHER, TABLE, CalibrationRecord, Owner, Rig
from lmeasure.sensors import cable_covariance, every_part, further_solved, solved_covariance, unsolved_columns, width_of
from lmeasure.trajectory.reconstruction.scheme import Scheme


class ParameterErrors:
    """Errors of a rig's channels by independent variables of unit variance: solved of them by the linked calibration, dimensions more by
    what the rig states to be uncertain. zero (7,): where counting began, by the scheme; cancels: whether what acts there too cancels, as it
    does not where the start came from lengths."""

    def __init__(self, rig: Rig, scheme: Scheme, calibration: CalibrationRecord | None, zero: FloatArray, *, cancels: bool) -> None:
        observed, self._wide = rig.observed, further_solved(calibration)
        self._rows, self._scales, self._zero, self._cables = scheme.rows, rig.scales(observed), zero, len(rig.cable)
        self._cancels = cancels
        self._absolute = np.array([rig.counter(o).codes is not None for o in observed])
        enters = _entering(scheme, wide=self._wide)
        # of what is solved by itself the rest may be rounding: the whole says how wide each parameter is
        width = np.sqrt(np.diag(cable_covariance(rig, calibration, observed, wide=self._wide)))
        of_record = solved_covariance(rig, calibration, observed, wide=self._wide)
        solved = covariance_root(np.where(enters[:, None] & enters, of_record, 0.0), width)
        dimensions = np.where(enters[:, None], unsolved_columns(rig, calibration, observed, wide=self._wide), 0.0)
        dimensions = dimensions[:, dimensions.any(axis=0)]
        self.solved, self.dimensions = solved.shape[1], dimensions.shape[1]
        every = np.column_stack([solved, dimensions])
        every = every.reshape(len(observed), width_of(wide=self._wide), every.shape[1])
        self._of_kernels = np.ascontiguousarray(every[:, : len(PARAMETERS)])
        self._of_parts = every[: self._cables, len(PARAMETERS) :]
        self._parts = every_part(rig, rig.cable)

    @property
    def root(self) -> FloatArray:
        """(13 m, r) errors of the kernels' parameters by the variables."""
        m, width, r = self._of_kernels.shape
        return self._of_kernels.reshape(m * width, r)

    def lengths(self, poses: FloatArray, counts: FloatArray, travel: FloatArray | None) -> FloatArray:
        """(n, m, r) errors of the lengths by the variables, at (n, 7) poses and true counts (n, m) whose last travel is travel (n, m), 0
        where it is None. A parameter acts at the pose and at the zero pose, where counting began."""
        gradients = length_gradients(self._rows, poses, counts, self._scales)
        if self._cancels:
            begun = length_gradients(self._rows, self._zero[None], np.zeros((1, len(self._rows))), self._scales)[0]
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


def _entering(scheme: Scheme, *, wide: bool) -> BoolArray:
    """(13 m,) whether a parameter enters; where the point itself is measured its place in the tool frame does not."""
    table = (*TABLE, *FURTHER) if wide else TABLE
    return np.tile([scheme.point is None or p.owner is not Owner.ATTACHMENT for p in table], len(scheme.rows))
