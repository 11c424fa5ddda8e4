"""How start systems are grown, kept and told apart, and what tetrahedra say of heights."""

from pathlib import Path

import numpy as np
import pytest
from linkages import lengths_at, rig

from lmeasure.core import ComplexArray, IntArray, se3
from lmeasure.kernels import homotopy
from lmeasure.linkages import Structure, incidence, parse, start_systems, straight_links, structures, study_quadric, tetrahedra


def named(text: str) -> Structure:
    return parse(text)[0]


def test_a_grown_system_has_every_assembly_of_its_links(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_systems, "QUIET", 3)
    structure = named("L-321-321")
    links, points = start_systems.grown(structure, np.random.default_rng(5))
    assert points.shape == (8, 8)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-12)
    residuals = np.einsum("ni,kij,nj->nk", points, study_quadric.quadrics(links), points)
    assert np.abs(residuals).max() < 1e-10
    assert np.abs((points[:, :4] ** 2).sum(axis=1)).min() > 1e-6


def test_links_at_random_have_the_structures_points_in_common() -> None:
    structure = named("L-2211-321:ab-ac-a-b")
    links = start_systems.random_links(structure, np.random.default_rng(2))
    assert links.shape == (6, 7)
    for columns, side in ((slice(3, 6), 0), (slice(0, 3), 1)):
        same = (links[:, None, columns] == links[None, :, columns]).all(axis=2)
        ends = np.array([link[side] for link in structure.links])
        np.testing.assert_array_equal(same, ends[:, None] == ends)
    every = links[:, [6]]
    assert len(np.unique(every)) == 6
    assert (np.abs(links.imag) > 0.0).all()


def test_what_is_kept_is_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = start_systems.of_its_own()
    assert len(own) == sum(s.degenerate is None for s in structures() if start_systems.one_of_two(s) == s)
    before = [start_systems.start_of(s) for s in own]
    monkeypatch.setattr(start_systems, "FILE", tmp_path / "starts.npz")
    start_systems.write([(links, points[: 3 + i % 2]) for i, (links, points) in enumerate(before)])
    with np.load(tmp_path / "starts.npz") as kept:
        assert kept["counts"].tolist() == [3 + i % 2 for i in range(len(own))]
        np.testing.assert_array_equal(kept["links"], [links for links, _ in before])
        np.testing.assert_array_equal(kept["points"][3:7], before[1][1][:4])


@pytest.mark.parametrize("structure", [s for s in structures() if s.closed_form][1::5], ids=lambda s: s.notation)
def test_heights_are_those_of_tetrahedra_at_the_pose(structure: Structure) -> None:
    """Of each corner over the three by which it is placed, as part of the squares of one edge to it and of one between those."""
    base, platform, poses = rig(structure, 9, 5)
    lengths = lengths_at(base, platform, poses)
    found, heights = tetrahedra.closed_form(base, platform, lengths)[0], tetrahedra.heights(base, platform, lengths)
    order = incidence(base, platform).order
    for n, pose in enumerate(poses):
        there = {("B", b): base[order[i]] for i, (_, b) in enumerate(structure.links)}
        there |= {("P", p): se3.apply(pose, platform[order[i]]) for i, (p, _) in enumerate(structure.links)}
        parts = []
        for side, i, corners in structure.placements or ():
            a, b, c = (there[corner] for corner in corners)
            apex, normal = there[side, i], np.cross(b - a, c - a)
            height = (apex - a) @ normal / np.linalg.norm(normal)
            parts.append(height**2 / (((apex - a) ** 2).sum() + ((b - a) ** 2).sum()))
        k = int(np.abs(se3.displacement(found[n], pose)).max(axis=1).argmin())
        assert heights[n, k] == pytest.approx(min(parts), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("shape", [(6,), (3, 6), (2, 0, 6)])
def test_what_tetrahedra_do_not_solve_has_no_assemblies_in_closed_form(shape: tuple[int, ...]) -> None:
    structure = next(s for s in structures() if not s.closed_form and s.degenerate is None)
    base, platform, _ = rig(structure, 1)
    poses, closes = tetrahedra.closed_form(base, platform, np.ones(shape))
    assert poses.shape == (*shape[:-1], 0, 7)
    assert closes.shape == (*shape[:-1], 0)


# what becomes of paths that are lost


def test_each_way_to_the_assemblies_is_another(monkeypatch: pytest.MonkeyPatch) -> None:
    base, platform, (pose,) = rig(named("L-222-3111:ab-ac-ad"), 3)
    a, b = base / 300.0, platform / 300.0
    found, rows = incidence(base, platform), study_quadric.links(a, b, (lengths_at(base, platform, pose) / 300.0) ** 2)
    ways: list[list[ComplexArray]] = []

    def follow(start: ComplexArray, aim: ComplexArray, points: ComplexArray) -> tuple[ComplexArray, IntArray]:
        ways[-1].append(aim)
        return homotopy.follow_homotopy(start, aim, points)

    monkeypatch.setattr(straight_links, "follow_homotopy", follow)
    ends = []
    for attempt in range(3):
        ways.append([])
        ends.append(straight_links._followed(found, rows, a, b, attempt)[0])
    assert [len(way) for way in ways] == [1, 2, 2]
    assert not np.allclose(ways[1][0], ways[2][0])
    assert len(start_systems.distinct(start_systems.unit(np.concatenate(ends)))) == len(ends[0]) == len(ends[1]) == len(ends[2])


@pytest.mark.parametrize(
    ("found", "expected", "status"), [(1, 1, straight_links.ALL), (0, 0, straight_links.NOT_PROVED), (7, 8, straight_links.NOT_PROVED)]
)
def test_all_are_accounted_for_where_there_are_any(found: int, expected: int, status: str) -> None:
    assert straight_links.Assemblies(np.empty((0, 7)), np.empty(0, np.bool_), found, expected).status == status


# what is not proved


def test_a_pose_of_long_links_is_led_to_its_lengths() -> None:
    """Far from the base, where an arm about another place would be a wrong one."""
    base, platform, _ = rig(named("L-222-111111"), 4)
    a, b = base / 300.0, platform / 300.0
    true = np.array([3.0, -6.0, 8.0, 0.1, 0.2, -0.1, np.sqrt(0.94)])
    lengths = lengths_at(a, b, true)
    near = se3.displaced(true, 0.08 * np.array([1.0, -1.0, 0.5, 1.0, 1.0, -1.0]))
    found = straight_links._folds(a, b, lengths, near[None], np.empty((0, 7)))
    assert len(found) == 1
    assert np.abs(se3.displacement(found[0], true)).max() < 1e-8
    # known already, or beside what is
    for off, new in ((0.9e-5, False), (1.2e-5, True)):
        known = se3.displaced(true, np.array([off, 0.0, 0.0, 0.0, 0.0, 0.0]))
        assert len(straight_links._folds(a, b, lengths, near[None], known[None])) == new


def test_a_start_that_is_no_pose_or_has_a_link_without_a_length_leads_nowhere() -> None:
    base, platform, _ = rig(named("L-222-111111"), 4)
    a, b = base / 300.0, platform / 300.0
    on = np.array([*(a[2] - b[2]), 0.0, 0.0, 0.0, 1.0])
    for near in (np.array([np.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), on):
        assert not len(straight_links._folds(a, b, np.ones(6), near[None], np.empty((0, 7))))
