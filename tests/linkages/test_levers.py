"""Drives outside the work zone: lengths both ways against points in space, the thesis' ranges, rates against differences."""

import numpy as np
import pytest
from linkages import nearest

from lmeasure.core import FloatArray, StructureError, se3
from lmeasure.linkages import straight_links
from lmeasure.linkages.variants import Rods, lever

# figure 4.3: drives C1 B1 (1), C2 B1 (2), C1 B2 (3), C2 B2 (4), C3 B2 (5), C3 B3 (6); rods P1 C1, P2 C2, P3 C3 through B1, B2, B3
LINKS = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (2, 2)]
BASE = np.array([(0.0, 0.0, 0.0), (300.0, 20.0, 0.0), (120.0, 280.0, 10.0)])
PLATFORM = np.array([(-50.0, -40.0, 0.0), (70.0, -30.0, 5.0), (10.0, 80.0, -5.0)])
MECHANISM = Rods(LINKS, BASE, {0: (900.0, 0), 1: (950.0, 1), 2: (1000.0, 2)})
OF_PLATFORM, OF_BASE = np.array(LINKS).T


def at(pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths of links and of drives (6,) at a pose, from points in space."""
    points = se3.apply(pose, PLATFORM)
    through = BASE - points
    ends = points + through / np.linalg.norm(through, axis=1, keepdims=True) * np.array([[900.0], [950.0], [1000.0]])
    return np.linalg.norm(points[OF_PLATFORM] - BASE[OF_BASE], axis=1), np.linalg.norm(ends[OF_PLATFORM] - BASE[OF_BASE], axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_lengths_of_drives_and_links_both_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = se3.displaced(np.array([140.0, 100.0, 420.0, 0.0, 0.0, 0.0, 1.0]), rng.normal(size=6) * np.repeat([0.2, 30.0], 3))
    lengths, drives = at(pose)
    np.testing.assert_allclose(MECHANISM.links_of_drives(drives), lengths, rtol=1e-12)
    np.testing.assert_allclose(MECHANISM.drives_of_links(lengths), drives, rtol=1e-12)
    batch = np.stack([drives, drives + 1.0])
    np.testing.assert_array_equal(MECHANISM.links_of_drives(batch)[0], MECHANISM.links_of_drives(drives))
    # 4.10 to 4.13: the pose from the drives
    found = straight_links.assemblies(BASE[OF_BASE], PLATFORM[OF_PLATFORM], MECHANISM.links_of_drives(drives))
    assert found.status == straight_links.ALL
    assert nearest(found.poses, pose) < 1e-6


def test_rates_are_the_derivatives() -> None:
    _, drives = at(np.array([140.0, 100.0, 420.0, 0.05, -0.02, 0.03, np.sqrt(1.0 - 0.0038)]))
    for i, step in enumerate(1e-3 * np.eye(6)):
        ahead, behind = (MECHANISM.links_of_drives(drives + sign * step) for sign in (1.0, -1.0))
        np.testing.assert_allclose(MECHANISM.rates(drives)[:, i], (ahead - behind) / 2e-3, atol=1e-7)


def test_ranges_of_tables_4_1_and_4_2() -> None:
    """(4.22) with rods of 70, base points 20 apart, drives of 38 to 45: the shortest at (45, 45), the longest at (38, 38)."""
    l1, l2 = np.meshgrid(np.linspace(38.0, 45.0, 29), np.linspace(38.0, 45.0, 29))
    found = lever(l1, l2, np.asarray(20.0), np.asarray(70.0))
    assert found.min() == pytest.approx(35.316034, abs=1e-6)
    assert found.max() == pytest.approx(41.962389, abs=1e-6)
    assert (found[-1, -1], found[0, 0]) == (found.min(), found.max())


def test_a_drive_that_ends_on_a_neighbouring_link() -> None:
    """Table 2.3: from B2 to a point 150 mm along the link B1 P1 instead of to P1."""
    B1, B2, P1 = np.array([0.0, 0, 0]), np.array([250.0, 30, 0]), np.array([100.0, 60, 400])
    on = P1 / np.linalg.norm(P1) * 150.0
    d = [np.linalg.norm(x - y) for x, y in ((B1, B2), (on, B2), (B1, P1), (P1, B2))]
    near, far, b = np.array(150.0), np.array(d[2]), np.array(d[0])
    assert lever(near, b, np.array(d[1]), far) == pytest.approx(d[3], rel=1e-13)
    assert lever(far, b, np.array(d[3]), near) == pytest.approx(d[1], rel=1e-13)


def test_what_no_mechanism_has() -> None:
    _, drives = at(np.array([140.0, 100.0, 420.0, 0.0, 0.0, 0.0, 1.0]))
    assert np.isnan(MECHANISM.links_of_drives(drives + np.eye(6)[0] * 900.0)).all()  # a drive longer than its rod
    assert np.isnan(MECHANISM.links_of_drives(drives + np.eye(6)[2] * 2000.0)).all()  # no triangle
    with pytest.raises(StructureError, match="platform point 3: needs a rod through a base point to which it is linked"):
        Rods(LINKS, BASE, {0: (900.0, 0), 1: (950.0, 1), 2: (1000.0, 0)})


def test_without_a_ray_there_is_no_lever() -> None:
    """A vertex at its near end has no far end; so has nothing that closes no triangle. Neither warns."""
    near, third = np.array([0.0, 0.0, 2.0]), np.array([3.0, 5.0, 9.0])
    assert np.isnan(lever(near, np.full(3, 5.0), third, np.full(3, 7.0))).all()
