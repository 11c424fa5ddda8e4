"""Labels in space stand away from markers, lines and each other, as the page opens."""

import numpy as np
import plotly.graph_objects as go
import pytest

from lmeasure.report import html
from lmeasure.report.labels import GAP


def drawn(points: list[tuple[float, float, float]], names: list[str], *more: go.Scatter3d) -> go.Scatter3d:
    x, y, z = zip(*points, strict=True)
    figure = go.Figure([*more, go.Scatter3d(x=x, y=y, z=z, mode="markers+text", text=names)])
    figure.update_layout(scene={"camera": {"eye": {"x": 0.0, "y": -2.0, "z": 0.0}}})  # X to the right, Z upwards
    return html.settled(figure).data[-1]


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
