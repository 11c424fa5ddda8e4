"""The screw method for links between base and platform, and for drives outside the work zone: the thesis' example 4.4, to all digits."""

import numpy as np
import pytest
from linkages import lengths_at

from lmeasure.core import FloatArray, Status, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, CABLE_COLUMNS, GUIDE_XYZ, screw
from lmeasure.linkages import End, RodLinks, singularity

BASE = np.array([(0, 3, 0), (-2, 1, 0), (0, 1, -2), (1, 0, -2), (3, 0, 0), (-1, 0, -2)], dtype=float)
POINTS = np.array([(0, 1, 0), (1, 0, 0), (-1, 0, 0)], dtype=float)
PLATFORM = POINTS[[0, 0, 0, 1, 1, 2]]
CHANGE = np.array([0.1, 0.1, 0.1, 0.0, 0.0, 0.1])
HERE = np.array([0.0, 0, 0, 0, 0, 0, 1])
# (4.27)
MATRIX = np.array(
    [(0, -1, 0, 0, 0, 0), (1, 0, 0, 0, 0, -1), (0, 0, 1, 1, 0, 0), (0, 0, 1, 0, -1, 0), (-1, 0, 0, 0, 0, 0), (0, 0, 1, 0, 1, 0)]
)


def moved(twist: FloatArray) -> FloatArray:
    """(3, 3) the points by the twist (omega; v) to first order, as the thesis moves them."""
    return np.asarray(POINTS + twist[3:] + np.cross(twist[:3], POINTS))


def twist_of(rows: FloatArray, change: FloatArray) -> FloatArray:
    """(6,) twist (omega; v) of changes of lengths by rows (e; B x e)."""
    return np.asarray(np.linalg.solve(rows[:, [3, 4, 5, 0, 1, 2]], change))


def test_the_example_of_4_4() -> None:
    """P1's z is printed with the wrong sign, as the printed residuals show."""
    rows, _, _ = singularity.link_rows(BASE, PLATFORM, HERE)
    np.testing.assert_array_equal(rows, MATRIX)
    assert singularity.determinants(BASE, PLATFORM, HERE) == pytest.approx(-2.0, abs=1e-12)
    twist = twist_of(rows, CHANGE)
    np.testing.assert_allclose(twist, [0.05, 0.05, -0.1, 0.0, -0.1, 0.05], atol=1e-15)
    assert np.linalg.norm(twist[:3]) == pytest.approx(0.122474, abs=1e-6)
    np.testing.assert_allclose(moved(twist), [(0.1, 0.9, 0.1), (1.0, -0.2, 0.0), (-1.0, 0.0, 0.1)], atol=1e-15)
    off = np.linalg.norm(moved(twist)[[0, 0, 0, 1, 1, 2]] - BASE, axis=1) - (2.0 + CHANGE)
    np.testing.assert_allclose(off, [0.004757] * 3 + [0.009975] * 2 + [0.0], atol=1e-6)


def test_its_transformed_mechanism() -> None:
    """Rods of equal arms through B3 and B4: drives 1, 2 and 5 pull the other way, the rest is the same."""
    twist = twist_of(MATRIX * np.array([-1.0, -1.0, 1.0, 1.0, -1.0, 1.0])[:, None], CHANGE)
    np.testing.assert_allclose(twist, [0.05, 0.05, 0.1, 0.0, 0.1, 0.05], atol=1e-15)
    np.testing.assert_allclose(moved(twist), [(-0.1, 1.1, 0.1), (1.0, 0.2, 0.0), (-1.0, 0.0, 0.1)], atol=1e-15)


def test_the_finite_motion_by_the_kernels() -> None:
    """Points moved along lines stretch the platform; the kernel's screw motions keep it, and close the lengths."""
    rows = np.zeros((6, CABLE_COLUMNS))
    rows[:, BASE_XYZ], rows[:, GUIDE_XYZ], rows[:, ATTACHMENT_XYZ] = BASE, (0.0, 0.0, 1.0), PLATFORM
    status, (pose,) = screw.solve_poses(rows, 2.0 + CHANGE, HERE[None])
    assert status.tolist() == [Status.OK]
    np.testing.assert_allclose(lengths_at(BASE, PLATFORM, pose), 2.0 + CHANGE, atol=1e-9)
    np.testing.assert_allclose(se3.apply(pose, POINTS), moved(twist_of(MATRIX, CHANGE)), atol=0.05)


def test_drives_outside_the_zone_by_the_kernels() -> None:
    """Lengths of drives become those of links, and rates of drives those of links: the first step of the screw method."""
    base, points = [tuple(b) for b in BASE.tolist()], [tuple(p) for p in POINTS.tolist()]
    rods = [End(True, points[i], base[b], 4.0) for i, b in enumerate((2, 3, 5))]
    mechanism = RodLinks([(End(False, base[b]), rods[i]) for i, b in ((0, 0), (0, 1), (0, 2), (1, 3), (1, 4), (2, 5))])
    drives = mechanism.drives_of_links(np.full(6, 2.0))
    np.testing.assert_allclose(mechanism.links_of_drives(drives), 2.0, atol=1e-14)
    np.testing.assert_allclose(drives[[2, 3, 5]], 2.0)  # along rods of equal arms
    change = 1e-5 * CHANGE
    rows = np.zeros((6, CABLE_COLUMNS))
    rows[:, BASE_XYZ], rows[:, GUIDE_XYZ], rows[:, ATTACHMENT_XYZ] = BASE, (0.0, 0.0, 1.0), PLATFORM
    status, (pose,) = screw.solve_poses(rows, mechanism.links_of_drives(drives + change), HERE[None])
    assert status.tolist() == [Status.OK]
    np.testing.assert_allclose(mechanism.drives_of_links(lengths_at(BASE, PLATFORM, pose)), drives + change, atol=1e-9)
    step = twist_of(MATRIX.astype(float), mechanism.rates_of_drives(drives) @ change)
    np.testing.assert_allclose(se3.log(pose), step, atol=1e-10)
