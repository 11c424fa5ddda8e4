"""Pictures as SVG, the same on paper and on pages: a result in its tolerance, errors in space, targets, curves, a QR code.

Values are computed elsewhere; here they are only scaled to the picture. Colours can be distinguished without colour vision.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import segno
from markupsafe import escape

from lmeasure.certificate import Target, round_scale, round_up
from lmeasure.core import FloatArray
from lmeasure.text import number, settled

INK, SOFT, LINE, RED, GREEN, WITHIN, BEYOND = "#30343f", "#7a8194", "#c8ccd4", "#b3261e", "#1a7f4b", "#cfe8d8", "#f5d9d6"
# font of typst, and fonts of browsers
FONT = 'font-family="Libertinus Serif, system-ui, sans-serif"'
CHARACTER = 0.56
"""Width of a letter in a figure, in heights of its type: to keep labels off each other."""


def _svg(box: tuple[float, float, float, float], content: str, label: str = "") -> str:
    said = f'role="img" aria-label="{escape(label)}"' if label else 'aria-hidden="true"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{" ".join(f"{v:g}" for v in box)}" {FONT} {said}>{content}</svg>'


def _line(points: Iterable[Any], colour: str, width: float, more: str = "") -> str:
    path = "L".join(f"{x:.2f} {y:.2f}" for x, y in points)
    return f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="{width:g}" {more}/>'


def _text(x: float, y: float, size: float, text: str, anchor: str = "start", colour: str = INK) -> str:
    return f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'


def bar(figure: Mapping[str, Any], label: str) -> str:
    """A value with its U95, where known, on a scale of its own from zero, within a stated tolerance; hollow where the instrument is not
    capable of it."""
    value, u95 = float(figure["value"]), float(figure["u95"] or 0.0)
    held = figure.get("conformity") or {}
    limits = [float(held[k]) for k in ("lower", "upper") if held.get(k) is not None]
    ends = (0.0, value - u95, value + u95, *limits)
    low, high = min(ends), max(ends)
    margin = 0.08 * (high - low) or 1.0
    low, high = low - margin, high + margin

    def at(v: float) -> float:
        return 200.0 * (v - low) / (high - low)

    parts = [f'<rect x="0" y="6" width="200" height="10" fill="{BEYOND if limits else "#eceef2"}"/>']
    if limits:
        first, last = (at(float(held[k])) if held.get(k) is not None else end for k, end in (("lower", 0.0), ("upper", 200.0)))
        parts.append(f'<rect x="{first:.2f}" y="6" width="{last - first:.2f}" height="10" fill="{WITHIN}"/>')
        parts += [_line([(at(v), 3), (at(v), 19)], GREEN, 1.4) for v in limits]
    parts.append(_line([(at(0.0), 4), (at(0.0), 18)], SOFT, 0.8))
    x, whisker = at(value), (at(value - u95), at(value + u95))
    parts.append(_line([(whisker[0], 11), (whisker[1], 11)], INK, 1.4) + "".join(_line([(e, 7.5), (e, 14.5)], INK, 1.4) for e in whisker))
    fill = INK if figure["capable"] else "white"
    parts.append(f'<circle cx="{x:.2f}" cy="11" r="4" fill="{fill}" stroke="{INK}" stroke-width="1.4"/>')
    return _svg((-5, 0, 210, 22), "".join(parts), label)


class Label(NamedTuple):
    """A text that belongs to a place of the picture."""

    x: float
    y: float
    text: str


def placed(labels: Sequence[Label], size: float, taken: Sequence[tuple[float, float, float, float]] = ()) -> list[Label]:
    """Return the places of texts, by their left end and base line, so that none covers another or a taken box (x, y, width, height); texts
    without room are omitted."""
    boxes = list(taken)
    out = []
    for label in labels:
        width = CHARACTER * size * len(label.text)
        for dx, dy in itertools.product((1.0, -1.0, 0.0), (-1.0, 1.0, 0.0)):
            x = label.x + (0.5 * size if dx > 0 else -0.5 * size - width if dx < 0 else -0.5 * width)
            y = label.y + dy * (0.5 * size if dx else 1.1 * size) - 0.5 * size
            box = (x, y, width, size)
            if not any(x < b[0] + b[2] and b[0] < x + width and y < b[1] + b[3] and b[1] < y + size for b in boxes):
                boxes.append(box)
                out.append(Label(x, y + 0.82 * size, label.text))
                break
    return out


_TURN, _RISE = np.radians(28.0), np.radians(22.0)
# from +X, a little from +Y and from above: unequal angles, so that a cube's corners do not fall upon each other
_VIEW = np.array([[-np.sin(_TURN), np.cos(_TURN), 0.0], [-np.sin(_RISE) * np.cos(_TURN), -np.sin(_RISE) * np.sin(_TURN), np.cos(_RISE)]])


def errors_in_space(names: Sequence[str], commanded: FloatArray, errors: FloatArray, label: str) -> tuple[str, float, FloatArray]:
    """The box around commanded places (n, 3) [mm] with an arrow of each error (n, 3); their enlargement, and the box's sides [mm]."""
    low, high = commanded.min(axis=0), commanded.max(axis=0)
    sides = high - low
    extent = float(np.linalg.norm(sides)) or 100.0
    largest = float(np.linalg.norm(errors, axis=1).max())
    factor = max(1.0, round_up(0.08 * extent / largest)) if largest > 0.0 else 1.0
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    ends = commanded + factor * errors
    seen = np.concatenate([corners, commanded, ends]) @ _VIEW.T * [1.0, -1.0]
    first, last = seen.min(axis=0), seen.max(axis=0)
    scale = 260.0 / max(float((last - first).max()), 1e-9)

    def at(points: FloatArray) -> FloatArray:
        return np.asarray((points @ _VIEW.T * [1.0, -1.0] - first) * scale)

    parts = []
    for i, j in itertools.combinations(range(8), 2):
        if bin(i ^ j).count("1") == 1:
            parts.append(_line(at(corners[[i, j]]), LINE, 1.0))
    taken = []
    for start, end in zip(at(commanded), at(ends), strict=True):
        parts.append(_line([start - [3, 0], start + [3, 0]], SOFT, 1.0) + _line([start - [0, 3], start + [0, 3]], SOFT, 1.0))
        parts.append(_arrow(start, end))
        corner = np.minimum(start, end) - 2.0
        taken.append((*corner, *(np.abs(end - start) + 4.0)))
    size = 11.0
    shown = placed([Label(float(x), float(y), name) for name, (x, y) in zip(names, at(commanded), strict=True) if name], size, taken)
    parts += [_text(text.x, text.y, size, text.text) for text in shown]
    width, height = (last - first) * scale
    axes = _axes(np.array([0.0, height + 34.0]))
    return _svg((-36, -18, width + 72, height + 70), "".join(parts) + axes, label), factor, sides


def _arrow(start: FloatArray, end: FloatArray) -> str:
    way = end - start
    length = float(np.linalg.norm(way))
    if length < 1.0:
        return f'<circle cx="{start[0]:.2f}" cy="{start[1]:.2f}" r="1.6" fill="{RED}"/>'
    along, across = way / length, np.array([-way[1], way[0]]) / length
    back = end - min(6.0, 0.6 * length) * along
    head = " ".join(f"{x:.2f},{y:.2f}" for x, y in (end, back + 2.4 * across, back - 2.4 * across))
    return _line([start, back], RED, 1.6) + f'<polygon points="{head}" fill="{RED}"/>'


def _axes(origin: FloatArray) -> str:
    parts = []
    for name, way in zip("XYZ", _VIEW.T * [1.0, -1.0] * 20.0, strict=True):
        tip, name_at = origin + way, origin + 1.45 * way
        parts.append(_line([origin, tip], SOFT, 1.2) + _text(name_at[0], name_at[1] + 3.5, 10, name, "middle", SOFT))
    return "".join(parts)


RINGS = {10: 5, 15: 3, 20: 4, 30: 3, 40: 4, 50: 5, 60: 3, 80: 4}
"""Number of rings of a target by the first two digits of its radius, so that they are round numbers apart."""


def ring_step(radius: float) -> float:
    """Return how far apart [mm] the rings of a target are whose radius is `round_scale` of something."""
    leading = radius / 10.0 ** np.floor(np.log10(radius) + 1e-9)
    return radius / RINGS[round(10.0 * leading)]


def target(seen: Target, label: str) -> str:
    """Rings about the commanded position, every cycle as a point of its own, their mean, the ellipse; the second coordinate up."""
    scale = 100.0 / seen.radius

    def at(points: FloatArray) -> list[tuple[float, float]]:
        return [(float(x) * scale, float(-y) * scale) for x, y in points]

    count = round(seen.radius / ring_step(seen.radius))
    rings = "".join(f'<circle r="{100 * k / count:g}" fill="none" stroke="{LINE}" stroke-width="0.8"/>' for k in range(1, count + 1))
    cross = f'<path d="M-104 0H104M0 -104V104" stroke="{LINE}" stroke-width="0.8"/>'
    ellipse = "" if seen.ellipse is None else _line(at(seen.ellipse), GREEN, 1.5)
    dots = "".join(
        f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2.6" fill="{INK}" fill-opacity="0.6" stroke="white" stroke-width="0.6"/>'
        for x, y in at(seen.deviations)
    )
    ((x, y),) = at(seen.mean[None, :])
    mean = f'<path d="M{x:.2f} {y:.2f}m-6 0h12m-6 -6v12" stroke="{RED}" stroke-width="1.8"/>'
    axes = "XYZ"[seen.axes[0]], "XYZ"[seen.axes[1]]
    named = _text(108, -3, 11, axes[0], "end", SOFT) + _text(4, -97, 11, axes[1], "start", SOFT)
    return _svg((-110, -110, 220, 220), rings + cross + named + ellipse + dots + mean, label)


class Curves(NamedTuple):
    """Curves (n, m) over x (m,), with a straight line at a height if wanted, and the names of the axes."""

    x: FloatArray
    values: FloatArray
    across: str
    up: str
    level: float | None = None


MOST_POINTS = 240


def curves(drawn: Curves, language: str, label: str) -> str:
    """Curves over a common axis, from zero up."""
    step = max(1, -(-len(drawn.x) // MOST_POINTS))
    x, values = drawn.x[::step], drawn.values[:, ::step]
    known = values[np.isfinite(values)]
    top = round_scale(max([float(known.max()) if len(known) else 0.0, drawn.level or 0.0, 1e-9]))
    first, last = float(x[0]), max(float(x[-1]), float(x[0]) + 1e-9)
    left, right, upper, lower = 46.0, 290.0, 14.0, 122.0

    def across(v: Any) -> Any:
        return left + (right - left) * (v - first) / (last - first)

    def up(v: Any) -> Any:
        return lower - (lower - upper) * v / top

    parts = []
    for tick in np.linspace(0.0, top, 5)[::2]:
        parts.append(_line([(left, up(tick)), (right, up(tick))], LINE, 0.7))
        parts.append(_text(left - 4, up(tick) + 3.5, 11, number(language, settled(tick), ".4g"), "end", SOFT))
    for tick, anchor in ((first, "start"), (last, "end")):
        parts.append(_text(across(tick), lower + 14, 11, number(language, settled(tick), ".4g"), anchor, SOFT))
    for row in values:
        ok = np.isfinite(row)
        for part in np.split(np.arange(len(row)), np.flatnonzero(np.diff(ok.astype(int))) + 1):
            if ok[part[0]] and len(part) > 1:
                parts.append(_line(np.column_stack([across(x[part]), up(row[part])]).tolist(), INK, 0.7, 'stroke-opacity="0.5"'))
    if drawn.level is not None:
        parts.append(_line([(left, up(drawn.level)), (right, up(drawn.level))], GREEN, 1.3, 'stroke-dasharray="5 3"'))
    parts.append(_text(left, 7, 11, drawn.up) + _text((left + right) / 2, lower + 14, 11, drawn.across, "middle"))
    return _svg((0, -4, 300, 146), "".join(parts), label)


def code(text: str, label: str) -> str:
    """A QR code with its quiet zone."""
    rows = list(segno.make(text, error="m", micro=False).matrix)
    size = len(rows) + 8
    cells = "".join(f"M{i + 4} {j + 4}h1v1h-1z" for j, row in enumerate(rows) for i, dark in enumerate(row) if dark)
    return _svg((0, 0, size, size), f'<rect width="{size}" height="{size}" fill="white"/><path d="{cells}" fill="black"/>', label)
