"""Drives at rods: lengths both ways and rows against points in space, the thesis' ranges, and poses found without straight links."""

import numpy as np
import pytest
from linkages import nearest

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import ALL, End, RodLinks, assemblies

# figure 4.3: drives C1 B1 (1), C2 B1 (2), C1 B2 (3), C2 B2 (4), C3 B2 (5), C3 B3 (6); rods P1 C1, P2 C2, P3 C3 through B1, B2, B3
BASE = [(0.0, 0.0, 0.0), (300.0, 20.0, 0.0), (120.0, 280.0, 10.0)]
PLATFORM = [(-50.0, -40.0, 0.0), (70.0, -30.0, 5.0), (10.0, 80.0, -5.0)]
LINKS = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (2, 2)]  # rod, base point
LONG = (900.0, 950.0, 1000.0)
SHORT = (150.0, 170.0, 140.0)
HOME = np.array([140.0, 100.0, 420.0, 0.0, 0.0, 0.0, 1.0])
# figure 3.1: rods from the base through C of the platform, drives from their ends to further points of it
THROUGH = [(200.0, 0.0, 0.0), (-100.0, 170.0, 0.0), (-100.0, -170.0, 0.0)]
FEET = [(300.0, 0.0, 0.0), (-150.0, 260.0, 0.0), (-150.0, -260.0, 0.0)]
POINTS = [(240.0, 60.0, 20.0), (230.0, -70.0, 10.0), (10.0, 190.0, 0.0), (-180.0, 150.0, 15.0), (-160.0, -160.0, 5.0), (20.0, -210.0, 12.0)]
INPUT = [0, 0, 0, 1, 1, 2]


def pierced() -> RodLinks:
    rods = [End(True, p, b, length) for p, b, length in zip(PLATFORM, BASE, LONG, strict=True)]
    return RodLinks([(End(False, BASE[b]), rods[r]) for r, b in LINKS])


def beside() -> RodLinks:
    """Table 2.3: links P1 B1, P2 B2 and P3 B3, the other drives end on them."""
    rods = [End(True, p, b, length, True) for p, b, length in zip(PLATFORM, BASE, SHORT, strict=True)]
    return RodLinks([(End(False, BASE[b]), End(True, PLATFORM[r]) if r == b else rods[r]) for r, b in LINKS])


def fed() -> RodLinks:
    rods = [End(False, foot, c, 800.0) for foot, c in zip(FEET, THROUGH, strict=True)]
    return RodLinks([(rods[r], End(True, p)) for r, p in zip(INPUT, POINTS, strict=True)])


def in_space(links: RodLinks, pose: FloatArray) -> FloatArray:
    """(6,) lengths from points alone."""

    def place(end: End) -> FloatArray:
        own, other = (
            np.asarray(se3.apply(pose, p)) if moves else np.array(p)
            for moves, p in ((end.carried, end.point), (not end.carried, end.through))
        )
        away = other - own
        return own if end.rod_mm == 0.0 else own + away / np.linalg.norm(away) * end.rod_mm

    return np.array([np.linalg.norm(place(a) - place(b)) for a, b in links.ends])


def some_pose(seed: int) -> FloatArray:
    return se3.displaced(HOME, np.random.default_rng(seed).normal(size=6) * np.repeat([0.2, 30.0], 3))


@pytest.mark.parametrize("links", [pierced(), beside(), fed()])
@pytest.mark.parametrize("seed", range(3))
def test_lengths_and_rows_are_those_of_points_in_space(links: RodLinks, seed: int) -> None:
    pose = some_pose(seed)
    found = links.placed(pose)
    np.testing.assert_allclose(found.lengths, in_space(links, pose), rtol=1e-12)
    for i, step in enumerate(np.diag(np.repeat([1e-5, 1e-3], 3))):
        ahead, behind = (in_space(links, se3.compose(se3.exp(sign * step), pose)) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found.rows[:, i], (ahead - behind) / (2.0 * step[i]), rtol=1e-6, atol=1e-5)
    at = np.linalg.det(links.lines(pose)[0])
    twist = np.array([0.2, -0.3, 0.1, 20.0, 10.0, -15.0])
    ahead, behind = (np.linalg.det(links.lines(se3.compose(se3.exp(s * 1e-4 * twist), pose))[0]) for s in (1.0, -1.0))
    assert links.gradient(pose) @ twist == pytest.approx((ahead - behind) / 2e-4, rel=1e-4, abs=1e-6 * abs(at))


@pytest.mark.parametrize("links", [pierced(), beside()])
@pytest.mark.parametrize("seed", range(3))
def test_straight_links_have_the_same_poses(links: RodLinks, seed: int) -> None:
    pose = some_pose(seed)
    base, platform = links.bodies
    drives, straight = in_space(links, pose), np.linalg.norm(se3.apply(pose, platform) - base, axis=1)
    np.testing.assert_allclose(links.links_of_drives(np.stack([drives, drives])), [straight, straight], rtol=1e-11)
    np.testing.assert_allclose(links.drives_of_links(straight), drives, rtol=1e-11)
    for i, step in enumerate(1e-3 * np.eye(6)):
        ahead, behind = (links.links_of_drives(drives + sign * step) for sign in (1.0, -1.0))
        np.testing.assert_allclose(links.rates_of_drives(drives)[:, i], (ahead - behind) / 2e-3, atol=1e-6)
    # 4.10 to 4.13: the pose from the drives
    found = assemblies(base, platform, links.links_of_drives(drives))
    assert found.status == ALL
    assert nearest(found.poses, pose) < 1e-6


def test_limits_of_drives_as_limits_of_links() -> None:
    """Tables 4.1 and 4.2: rods of 70, base points 20 apart, drives of 38 to 45; and of rods at large against a grid."""
    rod = End(True, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 70.0)
    near, far = End(False, (0.0, 0.0, 0.0)), End(False, (20.0, 0.0, 0.0))
    own = RodLinks([(near, rod), (far, rod)])
    np.testing.assert_allclose(own.link_box(np.array([[38.0, 45.0]] * 2)), [[25.0, 32.0], [35.316034, 41.962389]], atol=1e-6)
    for links, pose in ((pierced(), HOME), (beside(), HOME)):
        drives = in_space(links, pose)[:, None] + [-25.0, 25.0]
        box, grid = links.link_box(drives), np.random.default_rng(0).uniform(drives[:, 0], drives[:, 1], (20000, 6))
        every = links.links_of_drives(grid)
        assert ((every >= box[:, 0]) & (every <= box[:, 1])).all()
        corners = links.links_of_drives(np.array(np.meshgrid(*drives, indexing="ij")).reshape(6, -1).T)
        assert (np.abs(np.ptp(every, axis=0) - np.diff(box)[:, 0]) < 0.05 * np.diff(box)[:, 0]).all()
        assert (corners.min(axis=0) >= box[:, 0] - 1e-9).all()


def test_poses_from_many_starts_are_those_of_the_proof() -> None:
    links, pose = pierced(), some_pose(1)
    drives = in_space(links, pose)
    proved = assemblies(*links.bodies, links.links_of_drives(drives)).poses
    found = links.poses_of(drives)
    assert len(found) == len(proved)
    assert all(nearest(proved, one) < 1e-6 for one in found)
    own = fed()
    assert own.gauges is None
    found = own.poses_of(in_space(own, pose))
    assert nearest(found, pose) < 1e-6
    np.testing.assert_allclose([in_space(own, one) for one in found], [in_space(own, pose)] * len(found), rtol=1e-9)


def test_drives_that_no_mechanism_has() -> None:
    links = pierced()
    drives = in_space(links, HOME)
    assert np.isnan(links.links_of_drives(drives + np.eye(6)[0] * 900.0)).all()  # a drive longer than its rod
    assert np.isnan(links.links_of_drives(drives + np.eye(6)[2] * 2000.0)).all()  # no triangle
    assert np.isnan(links.link_box(np.stack([drives, drives + 2000.0], axis=1))).any()
    assert (links.margins(HOME) > 0.0).all()
    assert (links.margins(HOME + [0, 0, 900.0, 0, 0, 0, 0]) < 0.0).any()
