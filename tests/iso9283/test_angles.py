"""Where component-wise angles tell nothing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.iso9283.figure import PLAIN, angle_rates, angles_deg, singular


@pytest.mark.parametrize(("times", "reported"), [(9.9, False), (10.1, True)])
@pytest.mark.parametrize("pitch", [1.0, -1.0])
def test_angles_are_singular_from_ten_degrees_per_degree_on(times: float, reported: bool, pitch: float) -> None:
    """Of W, P, R about fixed axes the squared rates are 2/cos(P)^2 + 1 together."""
    angle = pitch * np.arccos(np.sqrt(2.0 / (times**2 - 1.0)))
    rotation = Rotation.from_euler("xyz", [[0.3, angle, -0.7], [0.2, 0.1, 0.4]])
    assert np.linalg.norm(np.radians(angle_rates(PLAIN, rotation)[0])) == pytest.approx(times, rel=1e-6)
    assert singular(PLAIN, rotation) is reported
    assert singular(PLAIN, rotation[1:]) is False
    np.testing.assert_allclose(angles_deg(PLAIN, rotation), rotation.as_euler("xyz", degrees=True), atol=1e-10)
