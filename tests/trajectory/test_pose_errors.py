"""Errors of several poses: how they are correlated, said by one method, whatever the model is."""

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_trajectories import UNIT, by_name, dwells, trajectory_of

from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.recording import Program
from lmeasure.trajectory import PoseErrors, Trajectory

IntArray = NDArray[np.int64]


def test_the_covariance_of_a_sum_is_that_of_all_errors_together() -> None:
    rng = np.random.default_rng(3)
    n, place = 5, np.array([0, 1, 1, 0, 2])
    own, local, shared = (rng.normal(size=(n, 6, q)) for q in (3, 2, 4))
    errors = PoseErrors(own, local, place, shared)
    whole = np.zeros((n, 6, n, 6))
    for i in range(n):
        for j in range(n):
            whole[i, :, j] = shared[i] @ shared[j].T + (place[i] == place[j]) * local[i] @ local[j].T + (i == j) * own[i] @ own[i].T
    weights = rng.normal(size=(3, n))
    expected = np.einsum("kn,kp,nipj->kij", weights, weights, whole)
    np.testing.assert_allclose(errors.covariance_of(weights), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(errors.covariance_of(np.eye(n)), errors.covariance, rtol=1e-12)
    assert not PoseErrors.of(own, shared).rounded  # nobody said that they are of whole counts


class Fading:
    """Errors along X of 0.02 mm that fade from sample to sample with a time constant [s]: correlated, as of a smoother."""

    def __init__(self, constant_s: float) -> None:
        self.constant_s = constant_s

    def at(self, trajectory: Trajectory, samples: IntArray) -> tuple[PoseErrors, str]:
        """See `lmeasure.iso9283.ErrorModel`."""
        time_s = trajectory.time_s[samples]
        covariance = 0.02**2 * np.exp(-np.abs(time_s[:, None] - time_s) / self.constant_s)
        shared = np.zeros((len(samples), 6, len(samples)))
        shared[:, 3] = np.linalg.cholesky(covariance)
        return PoseErrors.of(np.zeros((len(samples), 6, 1)), shared), "errors that fade"


@pytest.mark.parametrize("constant_s", [1e-3, 3.0, 1e4])
def test_a_model_states_correlation_between_samples(constant_s: float) -> None:
    """U95 of a mean over cycles a second apart: of errors new in each, partly the same, or the same in all."""
    cycles = 10
    time_s, position, windows = dwells(np.tile([1.0, 0.0, 0.0], (cycles, 1)))
    pose = {"name": "P1", "position_mm": (0.0, 0.0, 0.0), "quaternion_xyzw": UNIT, "windows_s": windows}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose]})
    model = Fading(constant_s)
    found = by_name(evaluate(trajectory_of(time_s, position), program, model, settings=CertificationSettings(trials=4000)))["AP_x", "P1"]
    apart = np.abs(np.subtract.outer(np.arange(cycles), np.arange(cycles)))
    u = 0.02 * np.sqrt(np.exp(-apart / constant_s).mean())
    assert found.u95 == pytest.approx(1.96 * u, rel=0.05)
