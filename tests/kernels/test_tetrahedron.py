"""The apex of a tetrahedron: at its distances, on the side that is said, and told when there is none."""

import math

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lmeasure.kernels.tetrahedron import apex

points = st.lists(st.floats(-2000, 2000), min_size=3, max_size=3).map(np.array)


@settings(deadline=None)
@given(points, points, points, points)
def test_apex_has_the_distances(a: np.ndarray, b: np.ndarray, c: np.ndarray, p: np.ndarray) -> None:
    normal = np.cross(b - a, c - a)
    assume(np.linalg.norm(normal) > 1e4)
    above, below, square = apex(tuple(a), tuple(b), tuple(c), *(float(np.linalg.norm(p - q)) for q in (a, b, c)))
    height = (p - a) @ normal / np.linalg.norm(normal)
    assume(abs(height) > 1.0)
    found = np.array(above if height > 0 else below)
    size = max(np.linalg.norm(q) for q in (a, b, c, p)) + 1.0
    blow = size**3 / (np.linalg.norm(normal) * abs(height))  # how badly the foot is determined, over the height
    np.testing.assert_allclose(found, p, rtol=0, atol=1e-12 * size * max(1.0, blow) ** 2)
    assert math.isclose(math.sqrt(square), abs(height), rel_tol=1e-9 * max(1.0, blow) ** 2)


def test_the_thesis_first_apex() -> None:
    """4.1 with the coordinates corrected: P1 over B2, B3, B4."""
    above, below, _ = apex((3.0, 3.0, 0.0), (4.0, 2.0, 0.0), (1.0, 1.0, 0.0), 10.0, 10.5, 11.0)
    np.testing.assert_allclose(sorted([above, below], key=lambda p: -p[2])[0], (2.5625, 6.6875, 9.284985), atol=1e-6)


def test_no_tetrahedron_and_no_plane() -> None:
    above, below, square = apex((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (0.0, 10.0, 0.0), 1.0, 2.0, 3.0)
    assert square < 0.0
    assert above == below
    assert math.isnan(apex((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), 1.0, 1.0, 1.0)[0][0])
