"""What decides whether a robot misses its poses or is in another frame."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.certification.attainment import _besides_a_frame


@pytest.mark.parametrize("grown", [0.0, 0.01])
def test_what_a_frame_does_not_explain_is_how_far_poses_are_off(grown: float) -> None:
    """Corners of a tetrahedron in another frame, and larger by a part, which no frame makes good."""
    corners = 100.0 * np.array([(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)])
    moved = np.array([5.0, -7.0, 300.0]) + (1.0 + grown) * Rotation.from_rotvec([0.3, -0.2, 0.9]).apply(corners)
    orientation = Rotation.identity(3)
    poses: list[Any] = [
        SimpleNamespace(commanded=np.r_[place, 0, 0, 0, 1], poses=se3.pose(np.tile(at, (3, 1)), orientation))
        for place, at in zip(corners, moved, strict=True)
    ]
    assert _besides_a_frame(poses) == pytest.approx(grown * 100.0 * np.sqrt(3.0), abs=1e-9)
    assert _besides_a_frame(poses[:2]) == np.inf
