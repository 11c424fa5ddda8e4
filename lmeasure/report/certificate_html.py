"""The certificate on the screen: one self-contained page with the pictures a person wants."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.colors import qualitative
from plotly.subplots import make_subplots

from lmeasure.arrays import FloatArray
from lmeasure.catalogue import DECIMAL_MARK
from lmeasure.catalogue import decimal as number
from lmeasure.certification.evaluate import AttainedPath, Evaluation
from lmeasure.certification.measure import Measured
from lmeasure.certification.pictures import magnification, targets, way
from lmeasure.report import certificate_text as say
from lmeasure.report import html
from lmeasure.report.words import THOUSANDS, unit, word
from lmeasure.trajectory.attained import AttainedPose

SCALE = "Viridis"
COMMANDED, ATTAINED, MEAN, ELLIPSE = "#7a8194", "#30343f", "#b3261e", "#1a7f4b"
MOST_CYCLES = 30


def certificate_html(certificate: dict[str, Any], measured: Measured) -> str:
    """The page's text: the same certificate gives the same bytes."""
    language = certificate["language"]
    header = say.results_header(language, any("conformity" in c for c in certificate["characteristics"]))
    body = [
        html.paragraph(certificate["id"]),
        *(html.paragraph(line) for line in say.statements(certificate)),
        html.heading(word(language, "section.results")),
        *_results(certificate, header),
        html.heading(word(language, "section.excluded")),
        html.table((word(language, "column.part"), word(language, "column.reason")), say.excluded(certificate))
        if certificate["excluded"]
        else html.paragraph(word(language, "nothing excluded")),
        html.heading(word(language, "section.commanded")),
        html.table(say.commanded_header(language), say.commanded(certificate), "text"),
        *_pictures(language, measured),
        html.heading(word(language, "section.uncertainty")),
        *(html.paragraph(line) for line in say.uncertainty(certificate)),
        html.heading(word(language, "section.notes")),
        *(html.paragraph(line) for line in say.notes(certificate)),
        html.heading(word(language, "section.about")),
        html.table(("", ""), say.about(certificate), "text"),
        html.heading(word(language, "section.inputs")),
        html.table((word(language, "column.file"), "SHA-256"), say.inputs(certificate)),
        html.paragraph(f"{word(language, 'section.program')}: {say.program(certificate)}"),
        html.paragraph(f"— {word(language, 'end')} {certificate['id']} —"),
    ]
    return html.page(f"{say.title(certificate)} {certificate['id']}", body, language)


def _results(certificate: dict[str, Any], header: tuple[str, ...]) -> list[str]:
    groups = say.results(certificate)
    if not groups:
        return [html.paragraph(word(certificate["language"], "no results"))]
    parts = []
    for place, rows in groups:
        parts += [f"<h3>{html.text(place)}</h3>", html.table(header, rows)]
    return parts


def _pictures(language: str, measured: Measured) -> list[str]:
    evaluation = measured.evaluation
    if not evaluation.poses and not evaluation.paths:
        return []
    factor = magnification(evaluation)
    figures = [
        (
            word(language, "space"),
            word(language, "space.text", factor=number(language, f"{factor:g}")),
            "space",
            _space(language, measured, factor),
        ),
    ]
    if evaluation.poses:
        figures.append((word(language, "bullseye"), word(language, "bullseye.text"), "bullseye", _bullseye(language, evaluation)))
        figures.append((word(language, "drift"), "", "drift", _drift(language, evaluation)))
    if evaluation.paths:
        figures.append((word(language, "deviation"), word(language, "deviation.text"), "deviation", _along(language, evaluation)))
        figures.append((word(language, "speed"), "", "speed", _speed(language, evaluation)))
    out = []
    for i, (title, told, name, figure) in enumerate(figures):
        out += [html.heading(title), *([html.paragraph(told)] if told else [])]
        figure.update_layout(separators=DECIMAL_MARK[language] + THOUSANDS[language])
        out.append(figure.to_html(full_html=False, include_plotlyjs=i == 0, div_id=name))
    return out


def _name(value: object) -> str:
    """A name from outside inside a figure: plotly takes some markup in texts."""
    return html.text(say.visible(value))


def _bullseye(language: str, evaluation: Evaluation) -> go.Figure:
    """Three views of one pose at a time, chosen by a list above."""
    poses = evaluation.poses
    views = [targets(pose) for pose in poses]
    titles = ["XYZ"[t.axes[0]] + "XYZ"[t.axes[1]] for t in views[0]]
    figure = make_subplots(1, 3, subplot_titles=titles, horizontal_spacing=0.07)
    each = 0
    for k, seen in enumerate(views):
        before = len(figure.data)
        for column, target in enumerate(seen, 1):
            shown = {"row": 1, "col": column, "visible": k == 0, "showlegend": column == 1}
            x, y = target.deviations.T
            numbers = [f"{word(language, 'cycle')} {i + 1}" for i in range(len(x))]
            figure.add_scatter(
                x=x, y=y, mode="markers", text=numbers, marker={"color": ATTAINED, "size": 6}, name=word(language, "attained"), **shown
            )
            line = target.ellipse if target.ellipse is not None else np.full((1, 2), np.nan)
            figure.add_scatter(x=line[:, 0], y=line[:, 1], mode="lines", line={"color": ELLIPSE}, name=word(language, "ellipse"), **shown)
            figure.add_scatter(
                x=target.mean[:1], y=target.mean[1:], mode="markers", marker={"color": MEAN, "symbol": "cross", "size": 10},
                name=word(language, "mean"), **shown,
            )  # fmt: skip
        each = len(figure.data) - before
    buttons = []
    for k, seen in enumerate(views):
        r = 1.06 * seen[0].radius
        axes = {f"{axis}axis{number}.range": [-r, r] for axis in "xy" for number in ("", "2", "3")}
        visible = [i // each == k for i in range(len(figure.data))]
        buttons.append({"label": _name(poses[k].name), "method": "update", "args": [{"visible": visible}, axes]})
    radius = 1.06 * views[0][0].radius
    for column, target in enumerate(views[0], 1):
        figure.update_xaxes(
            title_text=f"{'XYZ'[target.axes[0]]}, {_mm(language)}", range=[-radius, radius], constrain="domain", row=1, col=column
        )
        figure.update_yaxes(
            title_text=f"{'XYZ'[target.axes[1]]}, {_mm(language)}", range=[-radius, radius], scaleanchor=f"x{column if column > 1 else ''}",
            constrain="domain", row=1, col=column,
        )  # fmt: skip
    figure.update_layout(
        height=480,
        margin={"t": 80},
        updatemenus=[{"buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.25, "yanchor": "top"}],
        legend={"orientation": "h", "y": -0.2},
    )
    return figure


def _mm(language: str) -> str:
    return unit(language, "mm")


def _drift(language: str, evaluation: Evaluation) -> go.Figure:
    """Distance of each cycle from the commanded position, over the time of the cycle."""
    figure = go.Figure()
    for pose in evaluation.poses:
        distance = np.linalg.norm(pose.poses[:, :3] - pose.commanded[:3], axis=1)
        figure.add_scatter(x=pose.time_s, y=distance, mode="lines+markers", name=_name(pose.name), legendgroup=_name(pose.name))
    _one_of(figure, language)
    figure.update_xaxes(title_text=word(language, "axis.time"))
    figure.update_yaxes(title_text=word(language, "axis.deviation"), rangemode="tozero")
    return figure


def _cycles(figure: go.Figure, path: AttainedPath, x: FloatArray, values: FloatArray, language: str, colour: str) -> None:
    for cycle in range(min(len(values), MOST_CYCLES)):
        figure.add_scatter(
            x=x, y=values[cycle], mode="lines", line={"color": colour, "width": 1}, opacity=0.6, legendgroup=_name(path.name),
            showlegend=cycle == 0, name=_name(path.name), hovertemplate=f"%{{x:.1f}}: %{{y:.4f}} ({word(language, 'cycle')} {cycle + 1})",
        )  # fmt: skip


_LINES = tuple(qualitative.Dark24)


def _one_of(figure: go.Figure, language: str) -> None:
    """A list above the figure to look at one pose or path alone; many over one another tell nothing."""
    groups = list(dict.fromkeys(trace.legendgroup for trace in figure.data))
    shown = {word(language, "all"): [True] * len(figure.data)}
    shown |= {group: [trace.legendgroup == group for trace in figure.data] for group in groups}
    buttons = [{"label": label, "method": "update", "args": [{"visible": visible}]} for label, visible in shown.items()]
    menu = {"buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.2, "yanchor": "top"}
    figure.update_layout(height=440, margin={"t": 70}, showlegend=True, updatemenus=[menu])


def _along(language: str, evaluation: Evaluation) -> go.Figure:
    figure = go.Figure()
    for k, path in enumerate(evaluation.paths):
        _cycles(figure, path, path.arc_mm, path.deviation_mm, language, _LINES[k % len(_LINES)])
    _one_of(figure, language)
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
                legendgroup=_name(path.name), name=f"{_name(path.name)}: {word(language, 'commanded')}",
            )  # fmt: skip
    _one_of(figure, language)
    figure.update_xaxes(title_text=word(language, "axis.arc"))
    figure.update_yaxes(title_text=word(language, "axis.speed"), rangemode="tozero")
    return figure


def _space(language: str, measured: Measured, factor: float) -> go.Figure:
    """The measured way, commanded and attained poses and paths; deviations enlarged, those of paths in colour."""
    figure = go.Figure()
    x, y, z = np.round(way(measured.trajectory), 4).T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="lines", line={"color": "#c8ccd4", "width": 1}, name=word(language, "measured path"), hoverinfo="skip"
    )
    worst = max((float(np.nanmax(p.deviation_mm, initial=0.0)) for p in measured.evaluation.paths), default=0.0)
    for k, path in enumerate(measured.evaluation.paths):
        _path_in_space(figure, path, factor, worst, language, first=k == 0)
    poses = measured.evaluation.poses
    names: dict[bytes, list[str]] = {}
    for pose in poses:
        names.setdefault(np.round(pose.commanded[:3], 3).tobytes(), []).append(_name(pose.name))
    for k, pose in enumerate(poses):
        # of poses at one place the first bears the names of all
        here = names.pop(np.round(pose.commanded[:3], 3).tobytes(), [])
        _pose_in_space(figure, pose, factor, language, "<br>".join(here), first=k == 0)
    axes = {f"{axis}axis_title": f"{axis.upper()}, {_mm(language)}" for axis in "xyz"}
    figure.update_layout(
        height=640,
        margin={"t": 10, "l": 0, "r": 0},
        scene={**axes, "aspectmode": "data", "camera": {"eye": {"x": 1.5, "y": 1.5, "z": 1.2}}},
        legend={"orientation": "h"},
    )
    return figure


def _path_in_space(figure: go.Figure, path: AttainedPath, factor: float, worst: float, language: str, *, first: bool) -> None:
    x, y, z = path.commanded.T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="lines", line={"color": COMMANDED, "width": 2}, name=word(language, "commanded"), legendgroup="commanded path",
        showlegend=first, hoverinfo="skip",
    )  # fmt: skip
    enlarged = path.commanded + factor * (path.attained - path.commanded)
    gap = np.full((1, 3), np.nan)
    cycles = range(min(len(enlarged), MOST_CYCLES))
    line = np.concatenate([part for i in cycles for part in (enlarged[i], gap)])
    colour = np.concatenate([part for i in cycles for part in (path.deviation_mm[i], [0.0])])
    figure.add_scatter3d(
        x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", showlegend=False, name=_name(path.name),
        line={"width": 4, "color": np.nan_to_num(colour), "colorscale": SCALE, "cmin": 0.0, "cmax": worst or 1.0, "showscale": first,
              "colorbar": {"title": word(language, "axis.deviation"), "len": 0.6}},
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
