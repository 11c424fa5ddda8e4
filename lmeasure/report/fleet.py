"""The page of a batch: how many items are done, the worst robots, and one result of each robot over its days."""

import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lmeasure.report import figures, html
from lmeasure.text import Say

MOST = 24
"""Robots with a plot of their own: those with the largest values."""
COLUMNS = 4
MOST_ROWS = 500


class FleetItem(NamedTuple):
    """One item of a batch: a value of the shown result, or the line with the reason of its failure."""

    robot: str
    day: str
    name: str
    value: float | None
    line: str = ""


def write_fleet_page(path: Path, command: str, result: str, items: Sequence[FleetItem], *, language: str) -> None:
    """Write a self-contained page, whole or not at all.

    Parameters
    ----------
    path
        Page to write.
    command
        Command that was done.
    result
        Name of the result in `items`, which is larger where a robot is worse.
    items
        Result of each item, by robot and day.
    language
        Language of the page.
    """
    say = Say(language)
    failed = [one for one in items if one.line]
    robots: dict[str, list[FleetItem]] = {}
    for one in items:
        robots.setdefault(one.robot, []).append(one)
    largest = {robot: max((one.value for one in found if one.value is not None), default=-math.inf) for robot, found in robots.items()}
    order = sorted(robots, key=lambda robot: -largest[robot])
    known = [robot for robot in order if math.isfinite(largest[robot])]
    numbers = [
        html.Number(say("fleet.items"), str(len(items))),
        html.Number(say("fleet.failed"), str(len(failed)), "", "bad" if failed else "good"),
    ]
    numbers.append(html.Number(say("fleet.robots"), str(len(robots))))
    verdict, limits = (
        say("fleet.all_done" if not failed else "fleet.some_failed", failed=len(failed), count=len(items)),
        say("fleet.no_values"),
    )
    if known:
        middle = median(one.value for one in items if one.value is not None)
        numbers.append(html.Number(result, say("fleet.values", worst=largest[known[0]], middle=middle)))
        limits = say("fleet.worst", robot=known[0], result=result, value=largest[known[0]])
    step = html.Step(say("fleet.next_failed" if failed else "fleet.next_done"), f"lmeasure batch {command} ITEMS --out STORE")
    picture = figures.figure(robots_figure(robots, known[:MOST], result), "robots", language, hero=True)
    caption = say("fleet.caption", shown=min(MOST, len(known)), count=len(robots), result=result)
    answer = html.Answer(
        say("fleet.title", command=command), verdict, "bad" if failed else "good", tuple(numbers), limits, (step,), picture, "", caption
    )
    rows = [_row(robot, robots[robot], say) for robot in order]
    lines = [(one.robot, one.day, one.name, one.line) for one in failed]
    html.write_page(
        path, "fleet.html", answer, say, rows=rows[:MOST_ROWS], lines=lines[:MOST_ROWS], result=result, left=max(0, len(rows) - MOST_ROWS)
    )


def _row(robot: str, found: list[FleetItem], say: Say) -> tuple[str, ...]:
    values = [one.value for one in found if one.value is not None]
    shown = [say.number(value, ".4g") for value in (max(values), median(values), values[-1])] if values else ["", "", ""]
    return robot, str(len(found)), str(sum(bool(one.line) for one in found)), *shown


def robots_figure(robots: dict[str, list[FleetItem]], shown: Sequence[str], result: str) -> go.Figure:
    """Return small multiples: the result of each robot over its days, on one scale."""
    columns = min(COLUMNS, max(1, len(shown)))
    rows = max(1, math.ceil(len(shown) / columns))
    titles = [html.label(html.cut(robot, 24)) for robot in shown]
    drawing = make_subplots(rows=rows, cols=columns, shared_xaxes="all", shared_yaxes="all", subplot_titles=titles or None)
    for n, robot in enumerate(shown):
        found = [one for one in robots[robot] if one.value is not None]
        names = [html.label(f"{one.day} {one.name}") for one in found]
        place = {"row": n // columns + 1, "col": n % columns + 1}
        drawing.add_scatter(
            x=[html.label(one.day) for one in found], y=[one.value for one in found], text=names, mode="lines+markers",
            line={"color": "#0072b2"}, showlegend=False, **place,
        )  # fmt: skip
    drawing.update_yaxes(rangemode="tozero").update_xaxes(type="category", nticks=4)
    if shown:
        drawing.update_yaxes(title=html.label(html.cut(result, 32)), col=1)
    return drawing
