"""The page of two certificates side by side: changes, whether by chance, the robot's improvement, and the limits of further improvement."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure.certificate import SIGNIFICANT, Comparison, Improvement, Pair, with_u95
from lmeasure.report import figures, html
from lmeasure.report.text import axes, unit
from lmeasure.text import ENGLISH, Say, decimal, message

ARROWS = 0.15
"""Length of the largest error's arrow, as a part of the poses' extent."""
BEFORE, AFTER, FLOOR = "#d55e00", "#0072b2", "#009e73"
AT_THE_FLOOR = 1.2
"""Times the floor up to which a mean distance is at it."""


def write_comparison_page(
    path: Path,
    found: Comparison,
    certificates: Sequence[tuple[str, dict[str, Any]]],
    better: Improvement | None = None,
    *,
    language: str = "en",
) -> None:
    """Write a self-contained HTML page of the comparison, whole or not at all; certificates: by name, content; better: of a robot that was
    corrected between the first and the later of two."""
    say, plots = Say(language), {}
    values: dict[str, Any] = {}
    if better is not None:
        vectors, times = vectors_figure(better, say)
        plots["vectors"] = figures.figure(vectors, "vectors", language)
        values = {"times": times, "floor": better.floor_mm, "at_floor": better.after_mm[0] <= AT_THE_FLOOR * better.floor_mm}
    html.write_page(
        path, "comparison.html", answer(found, better, certificates, say), say,
        pairs=[_pair(pair, say, several=len(found.pairs) > 1) for pair in found.pairs], plots=plots, notes=found.notes, better=better,
        parts=[] if better is None else _parts(better, say), percent=100.0 * SIGNIFICANT, **values,
        certificates=[(name, content["id"], content["created"][:10], len(content["characteristics"])) for name, content in certificates],
    )  # fmt: skip


def answer(found: Comparison, better: Improvement | None, certificates: Sequence[tuple[str, dict[str, Any]]], say: Say) -> html.Answer:
    """Return the first screen: the robot's improvement or change, its limits, and the next step."""
    changes = [c for pair in found.pairs for c in pair.changes]
    beyond = sum(c.beyond for c in changes)
    moved = [s for pair in found.pairs for s in pair.shifts if s.moved]
    rows = [
        html.Number(
            say("comparison.beyond"), say("page.of", n=beyond, of=len(changes)), say("comparison.by_chance", chance=0.05 * len(changes))
        )
    ]
    rows.append(html.Number(say("comparison.poses_moved"), say("page.of", n=len(moved), of=sum(len(pair.shifts) for pair in found.pairs))))
    if better is None:
        state, verdict = ("warn", say("comparison.has_moved")) if moved else ("good", say("comparison.has_not_moved"))
        limits = say("comparison.both_were_measured_one" if all(p.shared for p in found.pairs) else "comparison.two_have_no_calibration")
        picture = figures.figure(changes_figure(found, say), "changes", say.language, hero=True)
        step = html.Step(say("comparison.next_identify"), "lmeasure identify --robot ROBOT --measurements FILE.csv --out identified")
        caption = say("comparison.changes_caption")
    else:
        low, high = better.factor_95
        values = {"before": better.before_mm[0], "after": better.after_mm[0], "factor": better.factor, "low": low, "high": high}
        verdict = say("comparison.times_nearer_95" if math.isfinite(high) else "comparison.times_nearer_more_95", **values)
        state = "good" if low > 1.0 else "warn"
        rows.insert(0, html.Number(say("comparison.mean_distance"), say("comparison.before_after_mm", **values)))
        rows.insert(1, html.Number(say("comparison.noise_floor"), say("comparison.mm", mm=better.floor_mm), say("comparison.floor_note")))
        at_floor = better.after_mm[0] <= AT_THE_FLOOR * better.floor_mm
        limits = say("comparison.robot_without_any_error" if at_floor else "comparison.robot_without_any_error_but", floor=better.floor_mm)
        picture = figures.figure(distances_figure(better, say), "distances", say.language, hero=True)
        step = html.Step(
            say("comparison.next_keep" if at_floor else "comparison.next_identify_again"),
            "lmeasure identify --robot ROBOT --measurements FILE.csv --out identified",
        )
        caption = say("comparison.distances_caption")
    subject = " · ".join(f"{'/'.join(Path(name).parts[-2:])}, {content['created'][:10]}" for name, content in certificates)
    return html.Answer(say("comparison.certificates_side_side"), verdict, state, tuple(rows), limits, (step,), picture, subject, caption)


MOST_CHANGES = 12


def changes_figure(found: Comparison, say: Say = ENGLISH) -> go.Figure:
    """Return the largest differences over their U95."""
    known = [(abs(c.later - c.first) / c.u95, c) for pair in found.pairs for c in pair.changes if c.u95 > 0.0]
    largest = sorted(known, key=lambda one: -one[0])[:MOST_CHANGES]
    figure = go.Figure()
    colour = [BEFORE if c.beyond else AFTER for _, c in largest]
    figure.add_bar(x=[part for part, _ in largest], y=[html.label(c.figure) for _, c in largest], orientation="h", marker={"color": colour})
    figure.add_vline(x=1.0, line={"dash": "dot"})
    return figure.update_xaxes(title=say("comparison.difference_u95")).update_yaxes(autorange="reversed", dtick=1, automargin=True)


def reported(better: Improvement) -> list[str]:
    """Return the lines about an improvement."""
    low, high = better.factor_95
    before, after = better.before_mm[0], better.after_mm[0]
    within = message("report.factor_within", low=low, high=high) if math.isfinite(high) else message("report.factor_least", low=low)
    parts = better.parts
    code = "report.floor" if parts.identified_mm is None else "report.floor_identified"
    of = {"instrument": parts.instrument_mm, "scatter": parts.scatter_mm, "identified": parts.identified_mm}
    return [
        message("report.mean_distance_from_commanded", before=before, after=after),
        message("report.improvement", factor=better.factor, within=within),
        message(code, floor=better.floor_mm, **of),
        message("report.at_the_floor" if after <= AT_THE_FLOOR * better.floor_mm else "report.above_the_floor"),
    ]


def _parts(better: Improvement, say: Say) -> list[tuple[str, str]]:
    parts = better.parts
    rows = [
        (say("comparison.instrument"), parts.instrument_mm),
        (say("comparison.robots_scatter_over_root"), parts.scatter_mm),
        (say("comparison.identification_left"), parts.identified_mm),
    ]
    return [(name, say("comparison.not_stated") if value is None else say.number(value, ".4f")) for name, value in rows]


def distances_figure(better: Improvement, say: Say = ENGLISH) -> go.Figure:
    """Distance of each attained mean from its commanded pose, before and after, and the noise floor."""
    names = [html.label(name) for name in better.poses]
    figure = go.Figure()
    for name, colour, errors in ((say("page.before"), BEFORE, better.before), (say("comparison.after"), AFTER, better.after)):
        figure.add_bar(x=names, y=np.linalg.norm(errors, axis=1), name=name, marker={"color": colour})
    figure.add_scatter(
        x=names, y=[better.floor_mm] * len(names), mode="lines", name=say("comparison.noise_floor"), line={"color": FLOOR, "dash": "dash"}
    )
    figure.update_layout(height=420, barmode="group")
    return figure.update_xaxes(type="category").update_yaxes(title=say("comparison.ap_mm"), rangemode="tozero")


def vectors_figure(better: Improvement, say: Say = ENGLISH) -> tuple[go.Figure, float]:
    """Errors before and after as arrows from the commanded places, and how many times they are enlarged."""
    places = better.commanded
    extent = float(np.ptp(places, axis=0).max()) or 100.0
    largest = max(float(np.linalg.norm(e, axis=1).max()) for e in (better.before, better.after))
    times = ARROWS * extent / max(largest, 1e-9)
    figure = go.Figure()
    for name, colour, errors in ((say("page.before"), BEFORE, better.before), (say("comparison.after"), AFTER, better.after)):
        line = np.stack([places, places + times * errors, np.full_like(places, np.nan)], axis=1).reshape(-1, 3)
        figure.add_scatter3d(x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", name=name, line={"color": colour, "width": 6})
    x, y, z = places.T
    names = [html.label(name) for name in better.poses]
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="markers+text", text=names, name=say("comparison.commanded"), marker={"size": 3, "color": "#444444"}
    )
    figure.update_layout(scene=axes(say), height=640)
    return figure, times


def _pair(pair: Pair, say: Say, *, several: bool) -> dict[str, Any]:
    """Return title, sentences and rows of two certificates side by side."""
    rows = []
    for c in pair.changes:
        first, later, change = (with_u95(v, c.u95)[0] for v in (c.first, c.later, c.later - c.first))
        cells = (decimal(say.language, v) for v in (first, later, change, with_u95(0.0, c.u95)[1]))
        symbol, _, where = c.figure.partition(" of ")
        name = say("comparison.of", figure=symbol, pose=where) if where else c.figure
        rows.append((html.indexed(name), *cells, unit(say.language, c.unit), say("page.yes") if c.beyond else ""))
    beyond, many = sum(c.beyond for c in pair.changes), len(pair.changes)
    return {
        "title": say("comparison.against", later=pair.later, first=pair.first) if several else say("comparison.figures_side_side"),
        "shared": say("comparison.both_were_measured_one") if pair.shared else say("comparison.two_have_no_calibration"),
        "chance": say("comparison.figures_differ_more_than", beyond=beyond, many=many, chance=0.05 * many),
        "rows": rows,
        "shifts": [_shift(s, say) for s in pair.shifts],
    }


def _shift(s: Any, say: Say) -> tuple[str, ...]:
    number = say.number
    if s.probability is None:
        verdict, chance = say("comparison.too_few_cycles_tell"), ""
    else:
        verdict, chance = say("page.moved") if s.moved else say("comparison.not_shown_have_moved"), number(s.probability, ".2g")
    return s.pose, number(s.distance_mm, ".4f"), number(s.u95_mm, ".4f"), chance, verdict
