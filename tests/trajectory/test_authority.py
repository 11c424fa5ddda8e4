"""Poses against an independent implementation, recorded: see tests/authorities/generic-optimiser."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import Status
from lmeasure.kernels import CABLE_COLUMNS, screw

AUTHORITY = Path(__file__).parents[1] / "authorities" / "generic-optimiser" / "poses.npz"
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def test_ten_thousand_poses_of_a_generic_optimiser() -> None:
    known = np.load(AUTHORITY)
    rows = np.zeros((6, CABLE_COLUMNS))
    alpha, beta = known["alpha_rad"], known["beta_rad"]
    rows[:, 0:3] = known["base_mm"]
    rows[:, 3:6] = np.column_stack([-np.cos(alpha) * np.sin(beta), -np.cos(alpha) * np.cos(beta), np.sin(alpha)])
    rows[:, 6], rows[:, 7:10] = known["radius_mm"], known["attachment_mm"]
    found = np.empty((len(known["lengths_mm"]), 7))
    for i, lengths in enumerate(known["lengths_mm"]):
        status, _, worst, found[i] = screw.solve_pose(rows, lengths, HOME)
        assert status == Status.OK
        assert worst < 1e-9
    assert len(found) == 10_000
    assert np.abs(found[:, :3] - known["position_mm"]).max() < 1e-8
    turn = Rotation.from_quat(found[:, 3:]) * Rotation.from_rotvec(known["rotation_vector_rad"]).inv()
    assert turn.magnitude().max() < 1e-10
