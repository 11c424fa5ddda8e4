"""Plotly figures as pages draw them: colours, room for labels and legends from a telephone to a wall, and light or dark paper."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from lmeasure.core import FloatArray
from lmeasure.kernels import BASE_XYZ, wrap_geometry
from lmeasure.report import html
from lmeasure.report.labels import place_labels
from lmeasure.rig import ObservationPoint
from lmeasure.text import Say, texts

UNUSED = ("sendChartToCloud", "lasso2d", "select2d", "resetCameraLastSave3d")
"""Buttons of a figure: nothing is sent anywhere, and nothing is to be selected."""


ROOM = 40
SEPARATORS = {"en": ".,", "ru": ",\u00a0"}
"""Decimal mark and thousands separator."""
DATES = {
    "ru": {
        "months": ["январь", "февраль", "март", "апрель", "май", "июнь", "июль", "август", "сентябрь", "октябрь", "ноябрь", "декабрь"],
        "shortMonths": ["янв", "фев", "мар", "апр", "май", "июн", "июл", "авг", "сен", "окт", "ноя", "дек"],
        "days": ["воскресенье", "понедельник", "вторник", "среда", "четверг", "пятница", "суббота"],
        "shortDays": ["вс", "пн", "вт", "ср", "чт", "пт", "сб"],
        "date": "%d.%m.%Y",
    }
}
"""Formats of dates for plotly in other languages than English."""
_SECOND, _DAY = 1000, 86_400_000
_STEPS = ((_SECOND, "%H:%M:%S.%L"), (60 * _SECOND, "%H:%M:%S"), (_DAY, "%H:%M"), ("M1", "{day}"), ("M12", "%b"), (None, "%Y"))
"""Formats of times at an axis by the largest distance of its marks, in milliseconds or months."""
_BENEATH = {"%H:%M": "{day} %Y", "{day}": "%Y", "%b": "%Y"}
"""Text that is written once below the first of them, and wherever it changes."""
_DAYS = {"en": "%b %-d", "ru": "%-d %b"}


def of_dates(language: str) -> dict[str, Any]:
    """An axis of dates as a language writes them, in two lines, so that they find room beside each other on a telephone."""
    stops, since = [], None
    for until, form in _STEPS:
        reported = "\n".join(part for part in (form, _BENEATH.get(form, "")) if part).format(day=_DAYS[language])
        stops.append({"dtickrange": [since, until], "value": reported})
        since = until
    return {"tickformatstops": stops, "tickangle": 0}


PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6b7280", "#882255", "#999933", "#117733")
"""Default colours of lines and points, distinguishable without colour vision (Okabe and Ito; Tol)."""
LEGEND = {"orientation": "h", "x": 0.0, "xanchor": "left", "y": 0.0, "yref": "container", "yanchor": "bottom"}
"""Under its figure: beside it, it would take a telephone's whole width, and above it are the buttons."""
BAR = {"orientation": "h", "y": -0.02, "yanchor": "top", "thickness": 14, "len": 0.9}
"""A colour bar under its figure, for the same reason."""
CAMERA = {"eye": {"x": 1.6, "y": 1.6, "z": 1.05}, "center": {"x": 0.0, "y": 0.0, "z": -0.26}}
TELEPHONE, SIGN, LETTER = 358, 40, 7
"""Width of a figure on a telephone, and of a name in its legend: its sign and each letter, in pixels."""
LEGEND_HIGH, LINE = 10, 19
"""Height of a legend and of each of its lines, in pixels."""
MOST_HIGH, WIDE, LABELLED = 80.0, 90.0, 1.9
"""Largest height and width of a scene on a telephone, in hundredths of the window's width, and the factor for figures and names at its
axes."""
GRID = "rgba(122, 135, 148, 0.4)"
"""Lines that are seen on light and on dark paper."""
POINT = "#6b7280"
"""Marks without a meaning of their own, on both."""
WALL = {"showbackground": False, "gridcolor": "#a9b4bf", "zerolinecolor": "#a9b4bf"}
"""Axes of a scene with lines alone: a filled wall would hide the part of a label behind it, and labels are large on a telephone."""
FLAT_WIDE = 70.0
"""Width of a drawing of one scale on a telephone without figures and margins, in hundredths of the window's."""
COLOURS = 70
"""Height of a colour bar under a scene, in pixels."""
UNDER = 80
"""Room for it under a scene: where plotly has to find more, as in a window made narrower, it draws the bar too low at first."""
NEARER = 0.96
"""Factor by which the eye comes nearer to the scene of a first screen, which is wider than high."""
HALF_VIEW = math.tan(math.pi / 8)
"""Half of the height that plotly's eye sees at the distance one."""
FLATTEST = 0.05
"""Least side of a scene, as a part of its widest side."""
FOOT = 0.12
"""Height of the upright axis's first figure above its foot, as a part of a scene's widest side: another axis has its own there."""
BEYOND = 0.08
"""Room around a scene, as a part of its extent, so that labels are not cut off."""


def figure(drawing: go.Figure, name: str, language: str = "en", *, hero: bool = False) -> Markup:
    """Return a figure as wide as its place, under a name of its own in the page, its buttons in the page's language.

    hero: the picture of the first screen, whose height the page rules.
    """
    settled(drawing)
    drawing.update_layout(separators=SEPARATORS[language])
    scene = any(_in_space(trace) for trace in drawing.data)
    one_scale = drawing.layout.xaxis.scaleanchor == "y"
    given = drawing.layout.height or 640
    if hero or scene or one_scale:
        # on a telephone less high than wide, or the sides of a scene would be cut off, and one scale for both axes leaves the rest empty
        drawing.layout.height = None
    known = texts(language, "certificate")
    buttons = {key.removeprefix("plot."): text for key, text in known.items() if key.startswith("plot.")}
    config = {
        "responsive": True,
        "displaylogo": False,
        "modeBarButtonsToRemove": UNUSED,
        "locale": language,
        "locales": {language: {"dictionary": buttons, "format": DATES.get(language, {})}},
    }
    if hero and scene:
        eye = drawing.layout.scene.camera.eye
        drawing.update_scenes({"camera": {"eye": {axis: NEARER * eye[axis] for axis in "xyz"}}})
    ready = str(drawing.to_html(full_html=False, include_plotlyjs=False, div_id=name, config=config))
    if not (hero or scene or one_scale):
        return Markup(ready)
    high = _high(drawing) if scene else _high_flat(drawing) if one_scale else 0.8 * MOST_HIGH
    under = UNDER if drawing.layout.margin.b is None else drawing.layout.margin.b
    beside = ROOM + max(under, _legend_high(drawing) + COLOURS * any(_has_bar(trace) for trace in drawing.data))
    narrow = f"calc({high:.0f}vw + {beside}px)"
    return Markup(f'<div class="scene" style="{f"--high:{narrow}" if hero else f"height:min({given / 16:g}rem, {narrow})"}">{ready}</div>')


def cable_ways(rows: FloatArray, pose: FloatArray) -> FloatArray:
    """(m, 3, 3) places of cables (m, columns) with the tool at a pose (7,): observation, tangent and attachment point."""
    _, tangent, attachment, _ = wrap_geometry(rows, pose[None, :])
    return np.stack([rows[:, BASE_XYZ], tangent[0], attachment[0]], axis=1)


def add_cables(drawing: go.Figure, ways: FloatArray, name: str, **look: Any) -> None:
    """Add cables as one trace: their ways (m, k, 3)."""
    x, y, z = np.concatenate([ways, np.full((len(ways), 1, 3), np.nan)], axis=1).reshape(-1, 3).T
    drawing.add_scatter3d(x=x, y=y, z=z, mode="lines", name=name, hoverinfo="skip", **look)


def add_points(drawing: go.Figure, points: Iterable[ObservationPoint], say: Say, **look: Any) -> None:
    """Add observation points with their names."""
    points = list(points)
    x, y, z = np.array([p.position_mm for p in points]).T
    usual = {"marker": {"size": 4, "color": POINT}, "name": say("page.observation_points")}
    drawing.add_scatter3d(x=x, y=y, z=z, mode="markers+text", text=[html.label(p.name) for p in points], **usual | look)


def settled(drawing: go.Figure) -> go.Figure:
    """Return the figure with room for its buttons, labels and legend at every width, unless it sets its own."""
    legend, margin = drawing.layout.legend, drawing.layout.margin
    clear = "rgba(0, 0, 0, 0)"
    drawing.update_layout(
        colorway=PALETTE,
        paper_bgcolor=clear,
        plot_bgcolor=clear,
        legend_bgcolor=clear,
        modebar={"bgcolor": clear, "color": POINT, "activecolor": PALETTE[0]},
    )
    for one in drawing.layout.sliders:
        one.update(bgcolor="#8ea3b8", bordercolor=POINT)
    for one in drawing.layout.updatemenus:
        one.update(bgcolor="#8ea3b8", bordercolor=POINT, font_color="#16202a")
    drawing.update_xaxes(gridcolor=GRID, zerolinecolor=GRID, gridwidth=0.5).update_yaxes(gridcolor=GRID, zerolinecolor=GRID, gridwidth=0.5)
    if legend.orientation is None and legend.x is None:
        drawing.update_layout(legend=LEGEND)
    # figures at the corner of two axes would touch
    drawing.update_xaxes(ticklabelstandoff=5).update_yaxes(ticklabelstandoff=5, exponentformat="power")
    for trace in drawing.data:
        for part in (trace, getattr(trace, "marker", None), getattr(trace, "line", None)):
            if part is not None and getattr(part, "showscale", False):
                # 4 µ beside "mm" would be wrong
                part.colorbar.exponentformat = "power"
    if drawing.layout.modebar.orientation != "v":
        # room for the buttons
        drawing.update_layout(margin={"t": ROOM if margin.t is None else max(ROOM, margin.t)})
    if any(_in_space(trace) for trace in drawing.data):
        drawing.update_layout(margin={side: 0 for side in "lrb" if margin[side] is None})
        if any(_has_bar(trace) for trace in drawing.data):
            drawing.update_layout(margin={"b": max(UNDER, drawing.layout.margin.b)})
        if drawing.layout.scene.camera.eye.x is None:
            drawing.update_scenes(camera=CAMERA)
        drawing.update_scenes({f"{axis}axis": WALL for axis in "xyz"})
        _with_room(drawing)
    else:
        drawing.update_layout(margin={"r": 16 if margin.r is None else margin.r})
    return drawing


def _in_space(trace: Any) -> bool:
    return trace.type.endswith("3d") or trace.type in ("surface", "isosurface")


def _legend_high(drawing: go.Figure) -> int:
    """Return the height of the legend on a telephone, in pixels: in as many columns as its longest name leaves."""
    names = [str(trace.name) for trace in drawing.data if trace.showlegend is not False and trace.name]
    if len(names) < 2:
        return 0
    columns = max(1, TELEPHONE // (SIGN + LETTER * max(map(len, names))))
    return LEGEND_HIGH + LINE * math.ceil(len(names) / columns)


def _has_bar(trace: Any) -> bool:
    """Return whether the figure needs a colour bar below."""
    parts = (trace, getattr(trace, "marker", None), getattr(trace, "line", None))
    return any(getattr(getattr(part, "colorbar", None), "orientation", None) == BAR["orientation"] for part in parts)


def _high(drawing: go.Figure) -> float:
    """Return the largest height of a scene, in hundredths of the window's width, at which nothing is cut off at the sides: plotly scales a
    scene by its height, however narrow it is."""
    scene = drawing.layout.scene
    ratio, camera = scene.aspectratio, scene.camera
    half = np.array([ratio[axis] or 1.0 for axis in "xyz"]) / 2.0 if scene.aspectmode == "manual" else _sides(drawing) / 2.0
    eye, centre = (np.array([point[axis] or 0.0 for axis in "xyz"]) for point in (camera.eye, camera.center))
    ahead = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half - eye
    widest = float(np.max(np.abs(corners @ right) / (corners @ ahead)))
    return min(MOST_HIGH, WIDE * HALF_VIEW / (widest * LABELLED))


def _high_flat(drawing: go.Figure) -> float:
    """Return how high a drawing of one scale is between its margins on a telephone, in hundredths of the window's width."""
    across, up = (np.concatenate([np.ravel(np.array(trace[axis], dtype=np.float64)) for trace in drawing.data]) for axis in "xy")
    wide, high = float(np.nanmax(across) - np.nanmin(across)), float(np.nanmax(up) - np.nanmin(up))
    return FLAT_WIDE * high / wide if wide > 0.0 else MOST_HIGH


def _sides(drawing: go.Figure) -> FloatArray:
    """The sides of a scene as plotly draws them: by its data, their product being one."""
    ends = _ends(drawing)
    sides = np.array([ends[axis][1] - ends[axis][0] if axis in ends else 1.0 for axis in "xyz"])
    ranges = [drawing.layout.scene[f"{axis}axis"].range for axis in "xyz"]
    sides = np.array([side if given is None else given[1] - given[0] for side, given in zip(sides, ranges, strict=True)])
    return sides / np.cbrt(np.prod(sides)) if drawing.layout.scene.aspectmode == "data" and min(sides) > 0.0 else np.ones(3)


def _ends(drawing: go.Figure) -> dict[str, tuple[float, float]]:
    """Return the ranges of a scene's data by axis."""
    own = [trace for trace in drawing.data if _in_space(trace) and trace.visible != "legendonly"]
    values = {axis: np.concatenate([np.ravel(np.array(trace[axis], dtype=np.float64)) for trace in own]) for axis in "xyz"} if own else {}
    return {axis: (float(np.nanmin(each)), float(np.nanmax(each))) for axis, each in values.items() if np.isfinite(each).any()}


def _most(side: float, widest: float) -> int:
    """Figures at a side of a scene."""
    return max(2, round(5.0 * side / widest)) if widest else 5


def _upright(low: float, high: float, widest: float) -> list[float] | None:
    """Return round figures of the upright axis that are clear of its foot; None for plotly's own."""
    foot = low + min(FOOT * widest, (high - low) / 2.0) if widest else low
    most = _most(high - low, widest)
    # of four or more pieces, one is in the upper half
    for least in ((high - low) / most, (high - low) / (2 * most), (high - low) / (4 * most)):
        power = 10.0 ** math.floor(math.log10(least))
        step = next(power * n for n in (1.0, 2.0, 5.0, 10.0) if power * n > 0.999 * least)
        every = [float(f"{n * step:.9g}") for n in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]
        if found := [value for value in every if value > foot]:
            return found
    return None


def _with_room(drawing: go.Figure) -> None:
    """Set ticks that do not overlap on short axes, ranges with room for labels, and an eye that sees everything."""
    own = [trace for trace in drawing.data if _in_space(trace) and trace.visible != "legendonly"]
    ends = _ends(drawing)
    widest = max((high - low for low, high in ends.values()), default=0.0)
    labelled = any("text" in str(getattr(trace, "mode", "")) for trace in own)
    # as large along a short axis: a label beside its wall would be hidden by the next one
    room = max(BEYOND * widest, 1.0) if labelled else 0.0
    for axis in "xyz":
        low, high = ends.get(axis, (0.0, 0.0))
        drawing.update_scenes({f"{axis}axis": {"nticks": _most(high - low, widest)}})
    if widest or labelled:
        whole = {}
        for axis in "xyz":
            low, high = ends.get(axis, (0.0, 0.0))
            flat = max(FLATTEST * widest - (high - low), 0.0) / 2.0
            whole[axis] = (low - flat - room, high + flat + room)
            if labelled or flat:
                drawing.update_scenes({f"{axis}axis": {"range": list(whole[axis])}})
        drawing.update_scenes(zaxis_tickvals=_upright(*whole["z"], widest))
        sides = np.array([high - low for low, high in whole.values()])
        if drawing.layout.scene.aspectmode == "data" and min(sides) <= FLATTEST * max(sides) * 1.001:
            # plotly would go by the data, which have no height
            drawing.update_scenes(aspectmode="manual", aspectratio=dict(zip("xyz", sides / np.cbrt(np.prod(sides)), strict=True)))
        # with a fixed product of sides, flat or long boxes are drawn larger than a cube, so the eye moves back
        away = float(np.linalg.norm(sides) / np.cbrt(np.prod(sides)) / np.sqrt(3.0))
        eye = drawing.layout.scene.camera.eye
        drawing.update_scenes({"camera": {"eye": {axis: away * eye[axis] for axis in "xyz"}}})
    if labelled:
        place_labels(drawing)
