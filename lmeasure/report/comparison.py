"""The page of two certificates side by side: what changed, whether by chance, by how much the robot is nearer, and what keeps it
from being nearer still."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure.certificate import SIGNIFICANT, Comparison, Improvement, Pair, with_u95
from lmeasure.report import html
from lmeasure.report.text import axes, unit
from lmeasure.text import ENGLISH, Say, decimal, message

ARROWS = 0.15
"""Of the poses' extent: length at which the largest error is drawn."""
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
    say = Say(language)
    body: list[str] = []
    if better is not None:
        body += _improved(better, say, language)
    for pair in found.pairs:
        body += _pair(pair, say, several=len(found.pairs) > 1)
    body += [html.paragraph(say("comparison.note", note=say.message(note))) for note in found.notes]
    rows = [(name, content["id"], content["created"][:10], len(content["characteristics"])) for name, content in certificates]
    header = (say("comparison.certificate"), say("comparison.number"), say("comparison.written"), say("comparison.figures"))
    body += [html.heading(say("comparison.certificates")), html.table(header, rows, "text")]
    html.write_page(path, say("comparison.certificates_side_side"), body, language)


def reported(better: Improvement) -> list[str]:
    """What a person reads of an improvement, line by line."""
    low, high = better.factor_95
    before, after = better.before_mm[0], better.after_mm[0]
    within = f"{low:.3g} to {high:.3g}" if math.isfinite(high) else f"{low:.3g} or more"
    parts = better.parts
    found = "" if parts.identified_mm is None else f", identification {parts.identified_mm:.4f}"
    limits = f"instrument {parts.instrument_mm:.4f}, robot's scatter {parts.scatter_mm:.4f}{found} mm"
    return [
        message("report.mean_distance_from_commanded", before=before, after=after),
        f"improvement: {better.factor:.3g} times ({within}, at 95 %)",
        f"noise floor {better.floor_mm:.4f} mm: {limits}",
        "what is left is at the noise floor" if after <= AT_THE_FLOOR * better.floor_mm else "what is left is above the noise floor",
    ]


def _improved(better: Improvement, say: Say, language: str) -> list[str]:
    low, high = better.factor_95
    values = {"before": better.before_mm[0], "after": better.after_mm[0], "factor": better.factor, "low": low, "high": high}
    reported = say("comparison.robot_stood_mm_from", **values)
    nearer = say("comparison.times_nearer_95" if math.isfinite(high) else "comparison.times_nearer_more_95", **values)
    floor = {"floor": better.floor_mm}
    if better.after_mm[0] <= AT_THE_FLOOR * better.floor_mm:
        at = say("comparison.robot_without_any_error", **floor)
    else:
        at = say("comparison.robot_without_any_error_but", **floor)
    vectors, times = vectors_figure(better, say)
    enlarged = say("comparison.errors_attained_means_each", times=times)
    return [
        html.paragraph(f"{reported} {nearer}", "verdict" if low > 1.0 else "verdict doubt"),
        html.heading(say("comparison.limits")),
        html.table((say("comparison.attained_mean"), say("comparison.standard_uncertainty_mm")), _parts(better, say), "text"),
        html.paragraph(at),
        html.heading(say("comparison.before_after")),
        html.figure(distances_figure(better, say), "distances", first=True, language=language),
        html.paragraph(enlarged),
        html.figure(vectors, "vectors", first=False, language=language),
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


def _pair(pair: Pair, say: Say, *, several: bool) -> list[str]:
    title = say("comparison.against", later=pair.later, first=pair.first) if several else say("comparison.figures_side_side")
    shared = say("comparison.both_were_measured_one") if pair.shared else say("comparison.two_have_no_calibration")
    rows = []
    for c in pair.changes:
        first, later, change = (with_u95(v, c.u95)[0] for v in (c.first, c.later, c.later - c.first))
        u95 = with_u95(0.0, c.u95)[1]
        cells = (decimal(say.language, v) for v in (first, later, change, u95))
        symbol, _, where = c.figure.partition(" of ")
        name = say("comparison.of", figure=symbol, pose=where) if where else c.figure
        rows.append((html.indexed(name), *cells, unit(say.language, c.unit), say("page.yes") if c.beyond else ""))
    header = (
        say("page.figure"),
        say("page.before"),
        say("comparison.after"),
        say("comparison.difference"),
        "U95",
        say("page.unit"),
        say("comparison.beyond_u95"),
    )
    beyond, many = sum(c.beyond for c in pair.changes), len(pair.changes)
    chance = say("comparison.figures_differ_more_than", beyond=beyond, many=many, chance=0.05 * many)
    return [html.heading(title), html.paragraph(shared), *_moved(pair, say), html.paragraph(chance), html.table(header, rows, "changes")]


def _moved(pair: Pair, say: Say) -> list[str]:
    number = say.number
    rows = []
    for s in pair.shifts:
        if s.probability is None:
            verdict, chance = say("comparison.too_few_cycles_tell"), ""
        else:
            verdict, chance = say("page.moved") if s.moved else say("comparison.not_shown_have_moved"), number(s.probability, ".2g")
        rows.append((s.pose, number(s.distance_mm, ".4f"), number(s.u95_mm, ".4f"), chance, verdict))
    header = (say("page.pose"), say("comparison.shift_mean_mm"), "U95", say("comparison.probability_chance"), say("comparison.verdict"))
    reported = say("comparison.pose_said_have_moved", percent=100.0 * SIGNIFICANT)
    return [html.table(header, rows, "text moved"), html.paragraph(reported)] if rows else []
