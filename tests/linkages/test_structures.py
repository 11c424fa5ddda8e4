"""Structures: their number, names and notations, and which of them tetrahedra solve."""

import itertools

import numpy as np
import pytest
from linkages import rig

from lmeasure.core import FileFormatError
from lmeasure.linkages import Structure, incidence, parse, singularity, somov_malyshev, structures
from lmeasure.linkages.topology import structure_of


def alike(one: Structure, other: Structure) -> bool:
    """Whether two structures differ by the numbers of their points alone, by trying all numberings of the base."""
    if one.degrees != other.degrees:
        return False
    wanted = sorted(sorted(b for p, b in one.links if p == q) for q in range(6))
    every = itertools.permutations(range(len(one.degrees[1])))
    return any(sorted(sorted(n[b] for p, b in other.links if p == q) for q in range(6)) == wanted for n in every)


def test_there_are_60_of_which_59_can_determine_a_pose() -> None:
    """Arzumanyan's 59 (thesis, chapter 1), in 21 classes (2.1) when platform and base are not told apart."""
    every = structures()
    assert (len(every), sum(s.degenerate is None for s in every)) == (60, 59)
    assert len({frozenset(s.class_name[2:].split("-")) for s in every}) == 21
    assert len({frozenset((s, s.swapped)) for s in every}) == 35
    assert not any(alike(one, other) for one, other in itertools.combinations(every, 2))


def test_none_is_missing() -> None:
    """Links drawn at random end in no other structure, and in every one."""
    rng = np.random.default_rng(1)
    met = set()
    for _ in range(8_000):
        n, m = rng.integers(3, 7, 2)
        links = {(int(p), int(b)) for p, b in zip(rng.integers(0, n, 6), rng.integers(0, m, 6), strict=True)}
        ends = [[link[side] for link in links] for side in (0, 1)]
        if len(links) == 6 and all(len(set(e)) >= 3 and max(e.count(i) for i in e) <= 3 for e in ends):
            met.add(structure_of(sorted(links)))
    assert met <= set(structures())
    assert len(met) > 50


def test_two_triples_without_a_common_link_never_determine_a_pose() -> None:
    (degenerate,) = (s for s in structures() if s.degenerate)
    assert degenerate.notation == "L-3111-3111:bcd-a-a-a"
    for structure, rank in ((degenerate, 5), (parse("L-3111-3111:abc-a-a-d")[0], 6)):
        base, platform, poses = rig(structure, 3)
        assert singularity.hold(base, platform, poses[0]).rank == rank


def test_the_criterion_of_4_1_as_corrected() -> None:
    """Three links at one point and two at another: of the same body; or of the other body, where two of its links are no links to the
    first. The thesis asks only that the two points are not linked: so are not the two triples that determine nothing, and linked triples
    are solved."""
    for s in structures():
        solved = False
        for side, p in [(k, p) for k in (0, 1) for p, degree in enumerate(s.degrees[k]) if degree == 3]:
            own = any(degree >= 2 for q, degree in enumerate(s.degrees[side]) if q != p)
            to_it = [link[1 - side] for link in s.links if link[side] == p]
            other = any(degree - (q in to_it) == 2 for q, degree in enumerate(s.degrees[1 - side]))
            solved |= own or other
        assert s.closed_form == solved, s.notation
    assert sum(s.closed_form for s in structures()) == 24


@pytest.mark.parametrize(
    ("koliskor", "name", "solved"),
    [
        ("S5423-11", "L-21111-3111", True), ("S4423-01", "L-2211-3111", True), ("S5433-10", "L-3111-3111", True),
        ("S4433-10", "L-3111-3111", True), ("S4532-11", "L-3111-21111", True), ("S4432-01", "L-3111-2211", True),
        ("S3631-11", "L-321-111111", True), ("S3522-10", "L-321-21111", True), ("S3532-00", "L-321-21111", True),
        ("S4320-00", "L-2211-321", True), ("S4334-10", "L-2211-321", True), ("S4323-00VI", "L-2211-321", True),
        ("S3333-00", "L-321-321", True), ("S3323-00", "L-222-321", True),
    ],
)  # fmt: skip
def test_koliskors_notations_of_4_1(koliskor: str, name: str, solved: bool) -> None:
    found = parse(koliskor)
    assert {s.class_name for s in found} == {name}
    assert any(s.closed_form for s in found) == solved


def test_l_222_21111_is_not_solved_by_tetrahedra() -> None:
    """4.1 lists it among those that are, through S3522, a misprint of S3532."""
    (structure,) = parse("S3522", misprints=False)
    assert (structure.class_name, structure.closed_form) == ("L-222-21111", False)


def test_names_are_read_back() -> None:
    for s in structures():
        assert parse(s.notation) == (s,)
        assert s in parse(s.class_name)
        assert s in parse(s.koliskor, misprints=False)
        assert s.swapped.swapped == s
    assert parse("L-321-321:cab-bc-c") == parse("L-321-321")


@pytest.mark.parametrize("text", ["L-411-222", "L-321", "S9999-00", "L-321-222:abc-ab-a", "L-321-222:abc-ab", "L-222-222:aa-bb-cc", ""])
def test_other_notations_are_refused(text: str) -> None:
    with pytest.raises(FileFormatError, match="is no structure of six links"):
        parse(text)


@pytest.mark.parametrize("seed", range(6))
def test_the_structure_of_points_in_space(seed: int) -> None:
    structure = structures()[11 * seed]
    base, platform, _ = rig(structure, seed)
    found = incidence(base, platform)
    assert found.structure == structure
    # the order of the links: each joins the points that the structure's link of that number joins
    for side, points in ((0, platform), (1, base)):
        place: dict[int, list[float]] = {}
        for i, link in zip(found.order, structure.links, strict=True):
            assert place.setdefault(link[side], points[i].tolist()) == points[i].tolist()


def test_freedoms_by_somov_and_malyshev() -> None:
    """2.1 and chapter 3: six whatever rods are added and merged; 15 = 6 + 9 with three rods before fingers keep links from turning."""
    assert all(somov_malyshev(rods, merged) == (6, 0) for rods in range(7) for merged in range(rods + 1))
    assert somov_malyshev(3, fingers=False) == (6, 9)
    assert somov_malyshev(fingers=False) == (6, 6)


@pytest.mark.parametrize("structure", [s for s in structures() if s.closed_form], ids=lambda s: s.notation)
def test_each_corner_is_placed_by_three_known_distances(structure: Structure) -> None:
    """Three corners in all; measured distances before those that corners found earlier give."""
    placements = structure.placements or ()
    linked = {(("P", p), ("B", b)) for p, b in structure.links}
    linked |= {(b, p) for p, b in linked}
    placed: set[tuple[str, int]] = set()
    for side, number, corners in placements:
        point = (side, number)
        assert point not in placed
        assert len(set(corners)) == 3
        # a corner stands in the frame that this point is placed in: of the other body, with a distance to it, or placed there itself
        other = [corner for corner in corners if corner[0] != side]
        assert all((point, corner) in linked or corner in placed for corner in other)
        assert all(corner in placed for corner in corners if corner[0] == side)
        found = [corner for corner in corners if corner in placed]
        measured = [corner for own, corner in linked if own == point and corner not in placed]
        assert not found or set(measured) <= set(corners)
        placed.add(point)
    assert len(placed) == len(placements) == 3
