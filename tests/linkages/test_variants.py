"""Extended variants against every number that the text of 2.2 and 2.3 states of tables 2.3 to 2.6."""

import pytest

from lmeasure.core import StructureError
from lmeasure.linkages import parse, structures
from lmeasure.linkages.topology import Variants


def of_class(name: str) -> list[Variants]:
    """Of each structure of a class, of either body first, that determines a pose."""
    swapped = "L-" + "-".join(reversed(name.split("-")[1:]))
    return [Variants(s) for n in {name, swapped} for s in parse(n) if s.degenerate is None]


@pytest.mark.parametrize(
    ("name", "arrangements", "moved"),
    [
        ("L-222-321", 4, {3}), ("L-222-3111", 4, {3, 2}), ("L-321-111111", 2, {3, 0}), ("L-222-111111", 2, {3, 0}),
        ("L-2211-3111", 4, {2}), ("L-3111-3111", 4, {2}), ("L-2211-2211", 4, {2}), ("L-3111-111111", 2, {2, 0}),
        ("L-2211-111111", 2, {2, 0}), ("L-21111-111111", 2, {1, 0}), ("L-111111-111111", 0, {0}),
    ],
)  # fmt: skip
def test_drives_on_neighbouring_links(name: str, arrangements: int, moved: set[int]) -> None:
    """Table 2.3: four arrangements, two where one body has six points of its own, none of L-111111-111111; three drives or two moved."""
    for one in of_class(name):
        assert one.arrangements == arrangements
        assert set(one.moved) == moved


@pytest.mark.parametrize(
    ("name", "rods", "bent"),
    [
        ("L-222-321", 3, 0), ("L-321-321", 3, 0), ("L-222-222", 3, 0), ("L-321-3111", 4, 1), ("L-321-21111", 5, 2), ("L-222-21111", 5, 2),
        ("L-321-111111", 6, 3), ("L-222-111111", 6, 3), ("L-2211-2211", 4, 0), ("L-21111-111111", 6, 1), ("L-111111-111111", 6, 0),
    ],
)  # fmt: skip
def test_rods_out_of_the_zone_of_the_drives(name: str, rods: int, bent: int) -> None:
    """Tables 2.4 and 2.5, the body with more points carried; the text's rods that cannot be straight are as many."""
    found = {max(one.rods(0), one.rods(1)) for one in of_class(name)}
    assert (rods, bent) in found
    assert all(r == rods and b >= bent for r, b in found)
    assert all(one.freedoms(side) == (6, 0) for one in of_class(name) for side in (0, 1))


def test_where_the_text_of_2_3_contradicts_itself() -> None:
    """Of L-3111-21111, L-2211-21111, L-3111-111111 and L-2211-111111 it says that no two rods meet, as of L-321-3111 that two do: four rods
    through five or six points need not, five or six through four must. And L-3111-3111 needs one bent rod, not the two that are stated."""
    for name, bent in (("L-3111-21111", 1), ("L-2211-21111", 1), ("L-3111-111111", 2), ("L-2211-111111", 2)):
        for one in of_class(name):
            many, few = sorted((one.rods(0), one.rods(1)), reverse=True)
            assert many[1] >= bent
            assert few[1] >= 0
        assert any(min(one.rods(0), one.rods(1)) == (4, 0) for one in of_class(name))
    assert {one.rods(side) for one in of_class("L-3111-3111") for side in (0, 1)} == {(4, 1)}


def test_every_structure_has_its_variants() -> None:
    for s in structures():
        if s.degenerate is None:
            one = Variants(s)
            assert one.rods(0) == Variants(s.swapped).rods(1)
            assert 0 <= one.rods(0)[1] < one.rods(0)[0]
        else:
            with pytest.raises(
                StructureError,
                match="three links at one point of the platform and three at one point of the base allow a turn about their line",
            ):
                Variants(s)
