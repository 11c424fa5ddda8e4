"""The shell of a self-contained page: everything in one file, every text from outside escaped, nothing fetched and nothing sent."""

import base64
import hashlib
import html
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure.core import FloatArray
from lmeasure.io import files
from lmeasure.report.labels import place_labels
from lmeasure.report.text import with_indices
from lmeasure.text import texts

_STYLE = Path(__file__).with_name("page.css")

_SCRIPT_OF_PAGE = Path(__file__).with_name("page.js").read_text(encoding="utf-8")
"""Puts sections beside each other and fits plots to their places."""

_PAGE = """<!doctype html>
<html lang="{language}">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
<h1>{head}</h1>
{body}
</body>
</html>
"""


class Ready(str):
    """A piece of HTML that is whole and safe: it is not escaped again."""

    __slots__ = ()


def text(value: object) -> str:
    """Text from outside, safe inside a page."""
    return value if isinstance(value, Ready) else html.escape(str(value))


_PLAIN = r"mm|m|s|ms|deg|rad|mrad|kg|Hz|K|counts|мм|м|с|мс|рад|мрад|кг|Гц|К|отсч\."
_PER = "s|N|mm|m|K|с|Н|мм|м|К"
_UNIT = rf"(?:{_PLAIN})(?:/(?:{_PER}))?[²³]?(?!\w)|%|°"
_TOGETHER = re.compile(
    rf"(?<=[\d⁰¹²³⁴-⁹]) (?={_UNIT})"  # a number and its unit,
    r"|(?<=\bp) (?==)|(?<=[=<>]) (?=[-+\d])|(?<=\(u) (?=\d)"  # p = 0.01, < 1, (u 0.2)
    r"|(?<=\d) (?=[:×±] \d)|(?<=\d [:×±]) (?=\d)"  # 100 : 1, 2 × 3, 21 ± 1
    r"|(?<=\bmm,) (?=mm\b)|(?<=\bмм,) (?=мм\b)|(?<=\bper) (?=mm\b)|(?<=\bна) (?=мм\b)"  # a unit alone in the second line
)
_PLACE = re.compile(r"\([-+\d.,]+(?:[,;] [-+\d.,]+)+\)")
_WHOLE = re.compile(
    r"(?<![\w&;-])(?:--[a-z][\w-]*(?: \w+:\w+)?|LM-[\dA-F]{8}-[\dA-F]{8}(?![\w-])|\d{4}-\d\d-\d\d(?![\w-]))"  # options, numbers, dates
    rf"|(?<![\w&;/-])(?:{_PLAIN})/(?:{_PER})[²³]?(?![\w/])"  # units: a browser breaks behind a slash
)
_LONG = re.compile(r"[^\s<>&;]{20,}")
_JOINT = re.compile(r"(?<=[_/])(?=\w)")


def joined(said: str) -> str:
    """A plain text in which no line breaks between a number and its unit or within coordinates."""
    return _PLACE.sub(lambda place: place[0].replace(" ", "\u00a0"), _TOGETHER.sub("\u00a0", said))


def kept(value: object) -> str:
    """Text from outside, safe inside a page, whose numbers and units, coordinates, dates and options no line breaks; a long name is broken
    at its joints first."""
    if isinstance(value, Ready):
        return value
    marked = _WHOLE.sub(lambda found: f'<span class="kept">{found[0]}</span>', text(joined(str(value))))
    return _LONG.sub(lambda name: _JOINT.sub("<wbr>", name[0]), marked)


def on_paper(content: Any) -> Any:
    """What a sheet is set from, its texts `joined`; drawings stay as they are."""
    if isinstance(content, dict):
        return {key: on_paper(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [on_paper(value) for value in content]
    return joined(content) if isinstance(content, str) and not content.startswith("<svg") else content


def indexed(value: str) -> Ready:
    """A text with the indices of its symbols set as such."""
    return pieces(with_indices(value))


def pieces(value: Sequence[tuple[str, str]]) -> Ready:
    """Pieces of a text, each with the index behind it."""
    return Ready("".join(kept(plain) + (f"<sub>{text(index)}</sub>" if index else "") for plain, index in value))


def paragraph(value: object, kind: str = "") -> str:
    """A paragraph of plain text; kind is its CSS class."""
    return f'<p class="{kind}">{kept(value)}</p>' if kind else f"<p>{kept(value)}</p>"


def warning(said: object, code: str) -> str:
    """Something that must be known, with the code by which it is looked up."""
    return f'<p class="warning">{kept(said)} <code>{text(code)}</code></p>'


def heading(value: object, level: int = 2, anchor: str = "") -> str:
    """A section heading, to which an anchor leads where it is given."""
    return f'<h{level} id="{anchor}">{kept(value)}</h{level}>' if anchor else f"<h{level}>{kept(value)}</h{level}>"


def table(header: Sequence[object], rows: Iterable[Sequence[object]], kind: str = "") -> str:
    """A table of plain texts; kind is a CSS class besides. An empty header is none."""
    head = f"<thead><tr>{''.join(f'<th>{kept(c)}</th>' for c in header)}</tr></thead>" if header else ""
    body = "".join("<tr>" + "".join(f"<td>{kept(c)}</td>" for c in row) + "</tr>" for row in rows)
    classes = f"scroll {kind}".strip()
    return f'<div class="{classes}"><table>{head}<tbody>{body}</tbody></table></div>'


def drawn(svgs: Iterable[str], caption: str, kind: str = "") -> str:
    """Drawings that belong together, with what is said under them; kind is a CSS class."""
    return f'<figure class="{kind}"><div class="drawn">{"".join(svgs)}</div><figcaption>{kept(caption)}</figcaption></figure>'


_KINDS = {"svg": "svg+xml", "png": "png", "jpg": "jpeg"}


def picture(content: bytes, kind: str, said: str) -> str:
    """A picture from a file; scripts in it never run."""
    data = base64.b64encode(content).decode()
    return f'<img src="data:image/{_KINDS[kind]};base64,{data}" alt="{text(said)}">'


def label(value: object) -> str:
    """A text from outside for a figure, which reads some markup, but knows no signs for quotation marks."""
    return html.escape(str(value), quote=False)


def cut(name: str, most: int = 16) -> str:
    """A name for a place that has room for so many letters."""
    return name if len(name) <= most else name[: most - 1] + "…"


UNUSED = ("sendChartToCloud", "lasso2d", "select2d", "resetCameraLastSave3d")
"""Buttons of a figure: nothing is sent anywhere, and nothing is to be selected."""


ROOM = 40
SEPARATORS = {"en": ".,", "ru": ",\u00a0"}
"""Decimal mark and what stands between thousands."""
DATES = {
    "ru": {
        "months": ["январь", "февраль", "март", "апрель", "май", "июнь", "июль", "август", "сентябрь", "октябрь", "ноябрь", "декабрь"],
        "shortMonths": ["янв", "фев", "мар", "апр", "май", "июн", "июл", "авг", "сен", "окт", "ноя", "дек"],
        "days": ["воскресенье", "понедельник", "вторник", "среда", "четверг", "пятница", "суббота"],
        "shortDays": ["вс", "пн", "вт", "ср", "чт", "пт", "сб"],
        "date": "%d.%m.%Y",
    }
}
"""What plotly is to write of times, where that is not English."""
_SECOND, _DAY = 1000, 86_400_000
_STEPS = ((_SECOND, "%H:%M:%S.%L"), (60 * _SECOND, "%H:%M:%S"), (_DAY, "%H:%M"), ("M1", "{day}"), ("M12", "%b"), (None, "%Y"))
"""How times are written at an axis whose marks lie less than so far apart, in milliseconds or months."""
_BENEATH = {"%H:%M": "{day} %Y", "{day}": "%Y", "%b": "%Y"}
"""What is written once below the first of them, and wherever it changes."""
_DAYS = {"en": "%b %-d", "ru": "%-d %b"}


def of_dates(language: str) -> dict[str, Any]:
    """An axis of dates as a language writes them, in two lines, so that they find room beside each other on a telephone."""
    stops, since = [], None
    for until, form in _STEPS:
        reported = "\n".join(part for part in (form, _BENEATH.get(form, "")) if part).format(day=_DAYS[language])
        stops.append({"dtickrange": [since, until], "value": reported})
        since = until
    return {"tickformatstops": stops, "tickangle": 0}


PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#882255", "#999933", "#7f7f7f")
"""What lines and points are distinguished by where nothing else gives them a colour, also without colour vision (Okabe and Ito; Tol)."""
LEGEND = {"orientation": "h", "x": 0.0, "xanchor": "left", "y": 0.0, "yref": "container", "yanchor": "bottom"}
"""Under its figure: beside it, it would take a telephone's whole width, and above it are the buttons."""
BAR = {"orientation": "h", "y": -0.02, "yanchor": "top", "thickness": 14, "len": 0.9}
"""A colour bar under its figure, for the same reason."""
CAMERA = {"eye": {"x": 1.6, "y": 1.6, "z": 1.05}, "center": {"x": 0.0, "y": 0.0, "z": -0.2}}
TELEPHONE, SIGN, LETTER = 358, 40, 7
"""Width of a figure on a telephone, and of a name in its legend: its sign and each letter, in pixels."""
LEGEND_HIGH, LINE = 10, 19
"""Of a legend, in pixels: what it takes, and each line of it."""
MOST_HIGH, WIDE, LABELLED = 80.0, 90.0, 1.9
"""Of a scene on a telephone: its largest height and its width in hundredths of the window's, and what figures and names at its axes take
beside it."""
WALL = {"showbackground": False, "gridcolor": "#dfe8f3", "zerolinecolor": "#c8d4e3"}
"""Of a scene: lines alone, for a wall that is filled hides what of a label lies behind it, and on a telephone labels are large."""
FLAT_WIDE = 70.0
"""Of a drawing of one scale on a telephone: its width without figures and margins, in hundredths of the window's."""
COLOURS = 70
"""Of a colour bar under a scene: its height in pixels."""
UNDER = 80
"""Room for it under a scene: where plotly has to find more, as in a window made narrower, it draws the bar too low at first."""
HALF_VIEW = math.tan(math.pi / 8)
"""Half of what plotly's eye sees from top to bottom, at the distance one."""
FLATTEST = 0.05
"""Of the widest side of a scene: what a side of none counts for."""
FOOT = 0.12
"""Of the widest side of a scene: how far above its foot the upright axis has its first figure, as another axis has its own there."""
BEYOND = 0.08
"""Of the extent: room around a scene, beyond which labels would be cut off."""


def figure(drawing: go.Figure, name: str, *, first: bool, language: str = "en") -> str:
    """A figure as wide as the page, under a name of its own in it, its buttons in the page's language; the first one brings what draws
    all of them."""
    settled(drawing)
    drawing.update_layout(separators=SEPARATORS[language])
    scene = any(_in_space(trace) for trace in drawing.data)
    one_scale = drawing.layout.xaxis.scaleanchor == "y"
    given = drawing.layout.height or 640
    if scene or one_scale:
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
    ready = str(drawing.to_html(full_html=False, include_plotlyjs=first, div_id=name, config=config))
    if not scene and not one_scale:
        return ready
    high = _high(drawing) if scene else _high_flat(drawing)
    under = UNDER if drawing.layout.margin.b is None else drawing.layout.margin.b
    beside = ROOM + max(under, _legend_high(drawing) + COLOURS * any(_has_bar(trace) for trace in drawing.data))
    return f'<div class="scene" style="height:min({given / 16:g}rem, calc({high:.0f}vw + {beside}px))">{ready}</div>'


def settled(drawing: go.Figure) -> go.Figure:
    """The figure with room for its buttons, labels and legend at every width, where it does not say itself how it wants them."""
    legend, margin = drawing.layout.legend, drawing.layout.margin
    drawing.update_layout(colorway=PALETTE)
    if legend.orientation is None and legend.x is None:
        drawing.update_layout(legend=LEGEND)
    # figures at the corner of two axes would touch
    drawing.update_xaxes(ticklabelstandoff=5).update_yaxes(ticklabelstandoff=5, exponentformat="power")
    for trace in drawing.data:
        for part in (trace, getattr(trace, "marker", None), getattr(trace, "line", None)):
            if part is not None and getattr(part, "showscale", False):
                # 4 µ beside "mm" would be no size at all
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
    """Of the legend on a telephone, in pixels: in as many columns as its longest name leaves."""
    names = [str(trace.name) for trace in drawing.data if trace.showlegend is not False and trace.name]
    if len(names) < 2:
        return 0
    columns = max(1, TELEPHONE // (SIGN + LETTER * max(map(len, names))))
    return LEGEND_HIGH + LINE * math.ceil(len(names) / columns)


def _has_bar(trace: Any) -> bool:
    """Whether a colour bar is asked for under the figure."""
    parts = (trace, getattr(trace, "marker", None), getattr(trace, "line", None))
    return any(getattr(getattr(part, "colorbar", None), "orientation", None) == BAR["orientation"] for part in parts)


def _high(drawing: go.Figure) -> float:
    """How high a scene may be, in hundredths of the window's width, that nothing in it is cut off at the sides: plotly draws as large as
    a scene is high, however narrow."""
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
    """How high a drawing of one scale is between its margins on a telephone, in hundredths of the window's width."""
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
    """From where to where a scene's data go, by axis."""
    own = [trace for trace in drawing.data if _in_space(trace) and trace.visible != "legendonly"]
    values = {axis: np.concatenate([np.ravel(np.array(trace[axis], dtype=np.float64)) for trace in own]) for axis in "xyz"} if own else {}
    return {axis: (float(np.nanmin(each)), float(np.nanmax(each))) for axis, each in values.items() if np.isfinite(each).any()}


def _most(side: float, widest: float) -> int:
    """Figures at a side of a scene."""
    return max(2, round(5.0 * side / widest)) if widest else 5


def _upright(low: float, high: float, widest: float) -> list[float] | None:
    """Round figures of the upright axis that stand clear of its foot; where there are none, plotly's own."""
    foot = low + min(FOOT * widest, (high - low) / 2.0) if widest else low
    most = _most(high - low, widest)
    # of four pieces and more one lies in the upper half
    for least in ((high - low) / most, (high - low) / (2 * most), (high - low) / (4 * most)):
        power = 10.0 ** math.floor(math.log10(least))
        step = next(power * n for n in (1.0, 2.0, 5.0, 10.0) if power * n > 0.999 * least)
        every = [float(f"{n * step:.9g}") for n in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]
        if found := [value for value in every if value > foot]:
            return found
    return None


def _with_room(drawing: go.Figure) -> None:
    """Figures at the axes that do not stand in each other where one is short beside the others, ranges in which labels have room, and an
    eye that sees all of it."""
    own = [trace for trace in drawing.data if _in_space(trace) and trace.visible != "legendonly"]
    ends = _ends(drawing)
    widest = max((high - low for low, high in ends.values()), default=0.0)
    labelled = any("text" in str(getattr(trace, "mode", "")) for trace in own)
    # as large along an axis that is short: a label beside its wall would go behind the next one
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
        # of sides whose product is kept what is flat or long is drawn larger than a cube, and the eye goes back as much
        away = float(np.linalg.norm(sides) / np.cbrt(np.prod(sides)) / np.sqrt(3.0))
        eye = drawing.layout.scene.camera.eye
        drawing.update_scenes({"camera": {"eye": {axis: away * eye[axis] for axis in "xyz"}}})
    if labelled:
        place_labels(drawing)


_SCRIPT = re.compile(r"<script\b[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)


def policy(body: str) -> str:
    """The Content-Security-Policy of a page: only the very scripts that stand in it run, and nothing is fetched or sent.

    plotly compiles its drawing of space from text that it writes itself ('unsafe-eval'), which a script must be let in for first; it sets
    styles, keeps pictures as data and reads its own pictures back as blobs.
    """
    hashes = {
        base64.b64encode(hashlib.sha256(code.encode("utf-8", "backslashreplace")).digest()).decode() for code in _SCRIPT.findall(body)
    }
    scripts = " ".join(["'unsafe-eval'", *(f"'sha256-{value}'" for value in sorted(hashes))]) if hashes else "'none'"
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'none'; "
        "base-uri 'none'; form-action 'none'"
    )


def page(title: str, body: Iterable[str], language: str = "en") -> str:
    """The text of a page of ready HTML parts under an escaped title."""
    whole = "\n".join(_in_sections(body))
    style = _STYLE.read_text(encoding="utf-8")
    return _PAGE.format(title=text(title), head=kept(title), body=whole, language=language, policy=policy(whole), style=style)


def _in_sections(body: Iterable[str]) -> list[str]:
    """The parts, each heading of the second level with what follows it in a section: on a wide screen they stand beside each other."""
    head: list[str] = []
    sections: list[list[str]] = []
    for part in body:
        sections += [[]] if part.startswith("<h2") else []
        (sections[-1] if sections else head).append(part)
    script = [f"<script>{_SCRIPT_OF_PAGE}</script>"] if sections or any("plotly-graph-div" in part for part in head) else []
    own = [line for section in sections for line in ("<section>", *section, "</section>")]
    return ["<header>", *head, "</header>", *(["<main>", *own, "</main>"] if own else []), *script]


def write_page(path: Path, title: str, body: Iterable[str], language: str = "en") -> None:
    """Write a page of ready HTML parts under an escaped title, whole or not at all."""
    files.write_text(path, page(title, body, language))
