"""Rigs that are singular at every pose: known kinds, and near relatives that are not."""

import numpy as np
import pytest
from linkages import DIETMAIER, rig

from lmeasure.core import FloatArray
from lmeasure.linkages import architecturally_singular, structures

RNG = np.random.default_rng(6)
ANGLES = np.array([0.1, 0.9, 2.0, 3.1, 4.4, 5.6])
FLAT = np.zeros((6, 1))
AWAY = np.array([3e5, -2e5, 1e5])
CIRCLE = 500.0 * np.column_stack([np.cos(ANGLES), np.sin(ANGLES), FLAT])
ANYHOW = 500.0 * np.column_stack([RNG.normal(size=(6, 2)), FLAT])
SPACE = 200.0 * RNG.normal(size=(6, 3))
SHEAR = np.array([[0.5, 0.2, 0.0], [-0.1, 0.3, 0.0], [0.0, 0.0, 1.0]])
TURN = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def on_line(points: FloatArray, count: int, at: FloatArray, along: FloatArray) -> FloatArray:
    """The points, so many of them moved to a line, in the ratios of 0, 1, 3, 7, ..."""
    out = points.copy()
    out[:count] = at + np.outer(2.0 ** np.arange(count) - 1.0, along)
    return out


ONE, OTHER = np.array([30.0, 40.0, 10.0]), np.array([-20.0, 5.0, 60.0])


@pytest.mark.parametrize(
    ("base", "platform", "words"),
    [
        (CIRCLE, 0.3 * CIRCLE @ TURN.T + [10.0, 20.0, 30.0], "similar plane figures on conics"),
        (CIRCLE, CIRCLE @ SHEAR.T, "base and platform are plane figures on conics that map onto each other"),
        (CIRCLE, 0.4 * CIRCLE * [1.0, -1.0, 1.0], "similar plane figures on conics"),
        (on_line(SPACE, 6, SPACE[0], ONE), SPACE[::-1], "all points of the base lie on one line"),
        (SPACE, on_line(SPACE, 6, SPACE[0], ONE), "all points of the platform lie on one line"),
        (
            on_line(SPACE, 4, SPACE[0], ONE),
            on_line(SPACE[::-1], 4, SPACE[2], OTHER),
            "links 1, 2, 3, 4 connect points in the same ratios on two lines",
        ),
    ],
)
def test_known_kinds_are_named(base: FloatArray, platform: FloatArray, words: str) -> None:
    assert words in (architecturally_singular(base, platform) or "")
    # coordinates of a drawing, rounded to the micrometre
    assert words in (architecturally_singular(base.round(3), platform.round(3)) or "")
    # in the frame of a tracker that stands far off
    assert words in (architecturally_singular(base + AWAY, platform - AWAY) or "")


@pytest.mark.parametrize(
    ("base", "platform"),
    [
        (ANYHOW, 0.3 * ANYHOW @ TURN.T),  # similar hexagons, but on no conic
        (CIRCLE, 0.3 * np.roll(CIRCLE, 1, axis=0)),
        (ANYHOW, ANYHOW @ SHEAR.T),
        (on_line(SPACE, 4, SPACE[0], ONE), SPACE[::-1]),
        DIETMAIER[:2],
    ],
)
def test_their_relatives_are_not_singular(base: FloatArray, platform: FloatArray) -> None:
    assert architecturally_singular(base, platform) is None
    assert architecturally_singular(base + AWAY, platform - AWAY) is None


def test_dimensions_at_random_are_singular_only_of_the_degenerate_structure() -> None:
    for i, s in enumerate(structures()):
        assert (architecturally_singular(*rig(s, i)[:2]) is not None) == (s.degenerate is not None), s.notation


@pytest.mark.parametrize("side", [0, 1])
def test_two_triples_in_a_plane_are_no_points_on_lines_nor_on_conics(side: int) -> None:
    """Three links to one point of a body are on a line with any other there, and the plane figure is of one body alone."""
    degenerate = next(s for s in structures() if s.degenerate)
    bodies = list(rig(degenerate, 3)[:2])
    bodies[side] = bodies[side] * [1.0, 1.0, 0.0]
    assert architecturally_singular(*bodies) == "the links are dependent at every pose"


def test_points_that_are_one_lie_on_a_line() -> None:
    assert architecturally_singular(np.tile(ONE, (6, 1)), SPACE) == "all points of the base lie on one line"
