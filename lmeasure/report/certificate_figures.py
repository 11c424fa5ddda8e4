"""The measurement on the screen as figures that can be turned and enlarged: in space, over time, along the paths."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.colors import qualitative

from lmeasure.certificate import Measured, magnification, way
from lmeasure.core import FloatArray
from lmeasure.iso9283 import AttainedPath, Evaluation
from lmeasure.report import certificate_text as say, figures, html
from lmeasure.report.certificate_pictures import MOST_CYCLES
from lmeasure.report.text import unit, word
from lmeasure.text import number
from lmeasure.trajectory import AttainedPose

SCALE = "Viridis"
LONGEST = 30
COMMANDED, MEAN = "#7a8194", "#b3261e"


def plots(language: str, measured: Measured) -> list[tuple[str, str, Markup]]:
    """Return (title, explanation, plot) of the measurement in space, over time and along the paths; none where there is nothing to draw."""
    evaluation = measured.evaluation
    if not evaluation.poses and not evaluation.paths:
        return []
    factor = magnification(evaluation)
    drawn = [("space", word(language, "space.text", factor=number(language, factor, "g")), _space(language, measured, factor))]
    if evaluation.poses:
        drawn.append(("drift", "", _drift(language, evaluation)))
    if evaluation.paths:
        drawn.append(("deviation", word(language, "deviation.text"), _along(language, evaluation)))
        drawn.append(("speed", word(language, "speed.text"), _speed(language, evaluation)))
    return [(word(language, name), text, figures.figure(plot, name, language)) for name, text, plot in drawn]


def _name(value: object) -> str:
    """A name from outside inside a figure, as long as a telephone is wide: plotly takes some markup in texts."""
    return html.label(html.cut(say.visible(value), LONGEST))


def _group(value: object) -> str:
    """Return the common group of traces of one pose or path."""
    return html.label(say.visible(value))


def _mm(language: str) -> str:
    return unit(language, "mm")


def _drift(language: str, evaluation: Evaluation) -> go.Figure:
    """Distance of each cycle from the commanded position, over the time of the cycle."""
    figure = go.Figure()
    for pose in evaluation.poses:
        distance = np.linalg.norm(pose.poses[:, :3] - pose.commanded[:3], axis=1)
        figure.add_scatter(x=pose.time_s, y=distance, mode="lines+markers", name=_name(pose.name), legendgroup=_group(pose.name))
    _one_of(figure, language, [pose.name for pose in evaluation.poses])
    figure.update_xaxes(title_text=word(language, "axis.time"))
    figure.update_yaxes(title_text=word(language, "axis.deviation"), rangemode="tozero")
    return figure


def _cycles(figure: go.Figure, path: AttainedPath, x: FloatArray, values: FloatArray, language: str, colour: str) -> None:
    for cycle in range(min(len(values), MOST_CYCLES)):
        figure.add_scatter(
            x=x, y=values[cycle], mode="lines", line={"color": colour, "width": 1}, opacity=0.6, legendgroup=_group(path.name),
            showlegend=cycle == 0, name=_name(path.name), hovertemplate=f"%{{x:.1f}}: %{{y:.4f}} ({word(language, 'cycle')} {cycle + 1})",
        )  # fmt: skip


_LINES = (*figures.PALETTE, *qualitative.Dark24)


def _one_of(figure: go.Figure, language: str, names: Sequence[object]) -> None:
    """Add a list above the figure to show one pose or path alone; many on top of each other are unreadable."""
    shown = [(word(language, "all"), [True] * len(figure.data))]
    for name in dict.fromkeys(names):
        shown.append((html.label(html.cut(say.visible(name))), [trace.legendgroup == _group(name) for trace in figure.data]))
    buttons = [{"label": label, "method": "update", "args": [{"visible": visible}]} for label, visible in shown]
    menu = {"buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "pad": {"b": 8}}
    figure.update_layout(height=440, margin={"t": 90}, showlegend=True, updatemenus=[menu])


def _along(language: str, evaluation: Evaluation) -> go.Figure:
    figure = go.Figure()
    for k, path in enumerate(evaluation.paths):
        _cycles(figure, path, path.arc_mm, path.deviation_mm, language, _LINES[k % len(_LINES)])
    _one_of(figure, language, [path.name for path in evaluation.paths])
    figure.update_xaxes(title_text=word(language, "axis.arc"))
    figure.update_yaxes(title_text=word(language, "axis.deviation"), rangemode="tozero")
    return figure


def _speed(language: str, evaluation: Evaluation) -> go.Figure:
    """Speed of each cycle along its path, and the commanded speed."""
    figure = go.Figure()
    for k, path in enumerate(evaluation.paths):
        colour = _LINES[k % len(_LINES)]
        _cycles(figure, path, 0.5 * (path.arc_mm[1:] + path.arc_mm[:-1]), path.speed_mm_s, language, colour)
        if path.commanded_speed_mm_s is not None:
            figure.add_scatter(
                x=path.arc_mm[[0, -1]], y=[path.commanded_speed_mm_s] * 2, mode="lines", line={"color": colour, "dash": "dash"},
                legendgroup=_group(path.name), name=f"{_name(path.name)}: {word(language, 'commanded')}", showlegend=False,
            )  # fmt: skip
    _one_of(figure, language, [path.name for path in evaluation.paths])
    figure.update_xaxes(title_text=word(language, "axis.arc"))
    figure.update_yaxes(title_text=word(language, "axis.speed"), rangemode="tozero")
    return figure


def _space(language: str, measured: Measured, factor: float) -> go.Figure:
    """The measured way, commanded and attained poses and paths; deviations enlarged, those of paths in colour."""
    figure = go.Figure()
    x, y, z = np.round(way(measured.trajectory), 4).T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="lines", line={"color": "#c8ccd4", "width": 1}, name=word(language, "measured_path"), hoverinfo="skip"
    )
    worst = max((float(np.nanmax(p.deviation_mm, initial=0.0)) for p in measured.evaluation.paths), default=0.0)
    poses = measured.evaluation.poses
    for k, path in enumerate(measured.evaluation.paths):
        _path_in_space(figure, path, factor, worst, language, first=k == 0, named=not poses)
    names: dict[bytes, list[str]] = {}
    for pose in poses:
        names.setdefault(np.round(pose.commanded[:3], 3).tobytes(), []).append(_name(html.cut(pose.name)))
    for k, pose in enumerate(poses):
        # of poses at one place the first bears the names of all
        here = names.pop(np.round(pose.commanded[:3], 3).tobytes(), [])
        _pose_in_space(figure, pose, factor, language, "<br>".join(here), first=k == 0)
    axes = {f"{axis}axis_title": f"{axis.upper()}, {_mm(language)}" for axis in "xyz"}
    figure.update_layout(
        height=680,
        # under the scene its colours, and under them two rows of the legend
        margin={"b": 150},
        scene={
            **axes,
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.5, "y": 1.5, "z": 1.2}, "center": figures.CAMERA["center"] | {"z": -0.28}},
        },
    )
    return figure


def _path_in_space(figure: go.Figure, path: AttainedPath, factor: float, worst: float, language: str, *, first: bool, named: bool) -> None:
    """A path; the first one brings the colour bar, and where it is to be named the legend's word for all that is commanded."""
    x, y, z = path.commanded.T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="lines", line={"color": COMMANDED, "width": 2}, name=word(language, "commanded"), legendgroup="commanded",
        showlegend=first and named, hoverinfo="skip",
    )  # fmt: skip
    enlarged = path.commanded + factor * (path.attained - path.commanded)
    gap = np.full((1, 3), np.nan)
    cycles = range(min(len(enlarged), MOST_CYCLES))
    line = np.concatenate([part for i in cycles for part in (enlarged[i], gap)])
    colour = np.concatenate([part for i in cycles for part in (path.deviation_mm[i], [0.0])])
    figure.add_scatter3d(
        x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", showlegend=False, name=_name(path.name),
        line={"width": 4, "color": np.nan_to_num(colour), "colorscale": SCALE, "cmin": 0.0, "cmax": worst or 1.0, "showscale": first,
              "colorbar": figures.BAR | {"title": {"text": word(language, "axis.deviation"), "side": "top"}}},
    )  # fmt: skip


def _pose_in_space(figure: go.Figure, pose: AttainedPose, factor: float, language: str, label: str, *, first: bool) -> None:
    enlarged = pose.commanded[:3] + factor * (pose.poses[:, :3] - pose.commanded[:3])
    figure.add_scatter3d(
        x=enlarged[:, 0], y=enlarged[:, 1], z=enlarged[:, 2], mode="markers", marker={"size": 3, "color": MEAN},
        name=word(language, "attained"), legendgroup="attained", showlegend=first, hovertemplate=_name(pose.name),
    )  # fmt: skip
    figure.add_scatter3d(
        x=pose.commanded[:1], y=pose.commanded[1:2], z=pose.commanded[2:3], mode="markers+text", text=[label],
        marker={"size": 4, "color": COMMANDED, "symbol": "cross"}, name=word(language, "commanded"), legendgroup="commanded",
        showlegend=first, hoverinfo="skip",
    )  # fmt: skip
