"""Labels in space stand away from markers, lines and each other, as the page opens."""

import re

import numpy as np
import plotly.graph_objects as go
import pytest

from lmeasure.report import figures
from lmeasure.report.labels import GAP


def drawn(points: list[tuple[float, float, float]], names: list[str], *more: go.Scatter3d) -> go.Scatter3d:
    x, y, z = zip(*points, strict=True)
    figure = go.Figure([*more, go.Scatter3d(x=x, y=y, z=z, mode="markers+text", text=names)])
    figure.update_layout(scene={"camera": {"eye": {"x": 0.0, "y": -2.0, "z": 0.0}}})  # X to the right, Z upwards
    return figures.settled(figure).data[-1]


def test_a_label_goes_where_nothing_stands() -> None:
    wide = [(-500.0, 0.0, 0.0), (500.0, 0.0, 300.0)]
    # c stands to the right of b, and a line goes up and down from it
    line = go.Scatter3d(x=[20.0, 20.0], y=[0.0, 0.0], z=[-400.0, 400.0], mode="lines")
    found = drawn([*wide, (0.0, 0.0, 0.0), (20.0, 50.0, 0.0)], ["far", "away", "b", "c"], line)
    assert found.textposition == ("middle right", "middle right", "middle left", "middle right")
    assert found.text == (f"{GAP}far", f"{GAP}away", f"b{GAP}", f"{GAP}c")


def test_labels_of_one_place_stand_apart() -> None:
    found = drawn([(0.0, 0.0, 0.0)] * 4 + [(1000.0, 0.0, 0.0)], ["a", "b", "c", "", "d"])
    assert len(set(found.textposition[:3])) == 3
    assert found.text[3] == ""


@pytest.mark.filterwarnings("error")
def test_what_is_hidden_or_nowhere_is_in_nobodys_way() -> None:
    hidden = go.Scatter3d(x=[60.0], y=[0.0], z=[0.0], mode="markers", visible="legendonly")
    found = drawn([(0.0, 0.0, 0.0), (np.nan, 0.0, 0.0), (1000.0, 0.0, 0.0)], ["a", "b", "c"], hidden)
    assert found.textposition == ("middle right",) * 3


def test_a_flat_drawing_has_a_side_of_its_own_and_is_seen_whole() -> None:
    corners = go.Scatter3d(x=[0.0, 1000.0], y=[0.0, 800.0], z=[3.0, 3.0], mode="lines")
    scene = figures.settled(go.Figure([corners], {"scene": {"aspectmode": "data"}})).layout.scene
    assert scene.zaxis.range == pytest.approx((3.0 - 25.0, 3.0 + 25.0))
    sides = np.array([scene.aspectratio[axis] for axis in "xyz"])
    assert scene.aspectmode == "manual"
    np.testing.assert_allclose(sides / sides[0], [1.0, 0.8, 0.05])
    eye = np.array([scene.camera.eye[axis] for axis in "xyz"])
    cube = go.Scatter3d(x=[0.0, 9.0], y=[0.0, 9.0], z=[0.0, 9.0], mode="lines")
    plain = figures.settled(go.Figure([cube], {"scene": {"aspectmode": "data"}})).layout.scene
    assert plain.aspectmode == "data"
    # as far away, in diagonals of what is drawn
    assert np.linalg.norm(eye) / np.linalg.norm(sides) == pytest.approx(np.linalg.norm([plain.camera.eye[a] for a in "xyz"]) / np.sqrt(3.0))


@pytest.mark.parametrize(
    ("names", "bar", "beside"),
    [
        (["before", "after", "asked"], {}, 40 + 29),  # as plotly draws their legend: in one line of 358 pixels,
        (["points of observation"] * 4 + ["way"] * 4, {}, 40 + 162),  # in one column,
        ([""], {"orientation": "h"}, 40 + 80),  # and a bar alone
    ],
)
def test_a_scene_is_as_much_higher_as_what_stands_under_it(names: list[str], bar: dict[str, str], beside: int) -> None:
    figure = go.Figure([go.Scatter3d(x=[0, 1], y=[0, 1], z=[0, 1], name=name, marker_colorbar=bar) for name in names])
    figure.update_layout(height=640)
    found = re.search(r"vw \+ (\d+)px", figures.figure(figure, "scene"))
    assert found is not None
    assert int(found[1]) == beside


def test_no_wall_of_a_scene_is_filled() -> None:
    """What is filled hides what of a label lies behind it."""
    named = go.Scatter3d(x=[0.0, 9.0], y=[0.0, 9.0], z=[0.0, 9.0], mode="markers+text", text=["a", "b"])
    scene = figures.settled(go.Figure([named])).layout.scene
    assert [scene[f"{axis}axis"].showbackground for axis in "xyz"] == [False] * 3


@pytest.mark.parametrize(
    ("low", "high", "wide", "expected"),
    [
        (0.0, 40.0, 200.0, (40.0,)),  # flat: 0 stands where another axis begins, 20 has no room above it
        (-100.0, 110.0, 230.0, (-50.0, 0.0, 50.0, 100.0)),
        (0.0, 0.3, 0.3, (0.1, 0.2, 0.3)),
        (0.0, 100.0, 900.0, (100.0,)),
        (3.0, 3.0, 1000.0, (20.0,)),  # 50 lies beyond the range that it is given, 0 at its foot
        (-3e-7, 9e-7, 1e-6, (0.0, 5e-7)),
        (0.0, 0.0, 0.0, None),
    ],
)
def test_figures_of_the_upright_axis_stand_clear_of_its_foot(
    low: float, high: float, wide: float, expected: tuple[float, ...] | None
) -> None:
    line = go.Scatter3d(x=[0.0, wide], y=[0.0, 0.0], z=[low, high], mode="lines")
    assert figures.settled(go.Figure([line])).layout.scene.zaxis.tickvals == expected


@pytest.mark.parametrize(("up", "high"), [(20.0, 140), (5.0, 35)])
def test_a_drawing_of_one_scale_is_no_higher_than_it_is_drawn(up: float, high: int) -> None:
    figure = go.Figure(go.Scatter(x=[0.0, 10.0], y=[0.0, up]), {"height": 600, "xaxis": {"scaleanchor": "y"}})
    assert f'style="height:min(37.5rem, calc({high}vw + {figures.ROOM + figures.UNDER}px))"' in figures.figure(figure, "one")


def test_lines_that_ask_for_no_colour_are_told_apart_without_colour_vision() -> None:
    figure = figures.settled(go.Figure([go.Scatter(y=[1.0, 2.0])] * 2))
    assert figure.layout.colorway[:3] == ("#0072b2", "#d55e00", "#009e73")
    assert len(set(figures.PALETTE)) == len(figures.PALETTE)
