"""Values of the page of a corrected program: targets corrected, errors before and left, and every target with its line."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.subplots import make_subplots

from lmeasure.report import figures, html
from lmeasure.report.text import axes
from lmeasure.robot_programs import Corrected, Listing, Outcome
from lmeasure.text import ENGLISH, Say

ARROWS = 0.1
"""Length of the largest correction's arrow, as a part of the targets' extent."""
BEFORE, AFTER, U95 = "#d55e00", "#0072b2", "#009e73"
MOST_ROWS = 500


def write_correction_page(
    path: Path, found: Corrected, listing: Listing, *, inputs: Sequence[tuple[str, str]], language: str = "en"
) -> None:
    """Write a self-contained HTML page of a corrected program, whole or not at all; inputs: files with their SHA-256."""
    say, plots, times = Say(language), {}, 0.0
    if found.done:
        space, times = space_figure(found.done, say)
        plots["space"] = figures.figure(space, "space", language)
    html.write_page(
        path, "correction.html", answer(found, listing, say), say,
        plots=plots, times=times, targets=_targets(found, say), more=max(0, len(found.outcomes) - MOST_ROWS), unread=listing.unread,
        inputs=inputs,
    )  # fmt: skip


def answer(found: Corrected, listing: Listing, say: Say) -> html.Answer:
    """Return the first screen: whether every target was corrected, errors before and after, their limits, and the next step."""
    left, done = len(found.outcomes) - found.changed, found.done
    state, verdict = "good", say("correction.every_target_corrected")
    if left or listing.unread:
        state = "warn" if found.changed else "bad"
        verdict = say("correction.targets_were_left_they", left=left, unread=len(listing.unread))
    corrections = [o.correction for o in done if o.correction is not None]

    def mm(value: float) -> str:
        return say("correction.mm", mm=value)

    rows = [html.Number(say("correction.targets_corrected"), say("page.of", n=found.changed, of=len(found.outcomes)))]
    limits = say("correction.limited_nothing")
    if corrections:
        both = say("comparison.before_after_mm", before=max(c.was_mm for c in corrections), after=max(c.left_mm for c in corrections))
        rows.append(html.Number(say("correction.largest_error"), both, say("correction.of_those")))
        u95 = max(o.u95_mm for o in done)
        known = mm(u95) if np.isfinite(u95) else say("correction.cannot_told")
        rows.append(html.Number(say("correction.largest_u95_where_goes"), known, say("correction.of_those")))
        rows.append(html.Number(say("correction.largest_correction"), mm(max(c.size_mm for c in corrections))))
        limits = say("correction.limited_identification")
    # uncorrected targets keep their errors; without this line the page would hide them
    stays = [o.correction.was_mm for o in found.outcomes if o.left and o.correction is not None]
    if stays:
        rows.append(html.Number(say("correction.largest_error_those_left"), mm(max(stays)), "", "warn"))
        limits += " " + say("correction.limited_left", left=left)
    picture = figures.figure(errors_figure(done, say), "errors", say.language, hero=True) if done else Markup()
    name = ", ".join(source.name for source in listing.sources)
    return html.Answer(
        say("correction.corrected_program", name=name), verdict, state, tuple(rows), limits,
        (html.Step(say("correction.next_measure"), "lmeasure certify TRAJECTORY --program program.toml --out certificate-after"),
         html.Step(say("correction.next_compare"), "lmeasure compare certificate certificate-after --page comparison.html")),
        picture, say("correction.subject", targets=len(found.outcomes)), say("correction.errors_before_after"),
    )  # fmt: skip


def errors_figure(done: Sequence[Outcome], say: Say = ENGLISH) -> go.Figure:
    """Return the error of each target before, and on a scale of its own below the remaining error and U95 of the corrected robot."""
    names = [html.label(o.target.name) for o in done]
    columns = (
        (1, say("page.before"), BEFORE, "circle", [o.correction.was_mm for o in done if o.correction is not None]),
        (2, say("comparison.after"), AFTER, "circle", [o.correction.left_mm for o in done if o.correction is not None]),
        (2, "U95", U95, "line-ew-open", [o.u95_mm for o in done]),
    )
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.08)
    place = list(range(1, len(done) + 1))
    for row, name, colour, symbol, values in columns:
        look = {"color": colour, "size": 7, "symbol": symbol}
        figure.add_scatter(x=place, y=values, text=names, mode="markers", name=name, marker=look, row=row, col=1)
    figure.update_layout(height=520, margin={"t": 20})
    figure.update_xaxes(title=say("correction.corrected_target_programs_order"), row=2)
    return figure.update_yaxes(title=say("page.mm"), rangemode="tozero")


def space_figure(done: Sequence[Outcome], say: Say = ENGLISH) -> tuple[go.Figure, float]:
    """Return the flange (or the tool of a map) at the targets in the robot's base, the new minus the old commands, and their
    enlargement."""
    corrections = [o.correction for o in done if o.correction is not None]
    places = np.array([c.wanted[:3] for c in corrections])
    change = np.array([c.flange[:3] for c in corrections]) - places
    extent = float(np.ptp(places, axis=0).max()) or 100.0
    times = ARROWS * extent / max(float(np.linalg.norm(change, axis=1).max()), 1e-9)
    names = [html.label(o.target.name) for o in done]
    line = np.stack([places, places + times * change, np.full_like(places, np.nan)], axis=1).reshape(-1, 3)
    figure = go.Figure()
    figure.add_scatter3d(
        x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", name=say("correction.correction"), line={"color": BEFORE, "width": 5}
    )
    x, y, z = places.T
    figure.add_scatter3d(x=x, y=y, z=z, mode="markers", text=names, name=say("correction.targets"), marker={"size": 3, "color": AFTER})
    figure.update_layout(scene=axes(say), height=640, margin={"t": 10, "b": 10})
    return figure, times


def _targets(found: Corrected, say: Say) -> list[tuple[str, ...]]:
    """Return every target: its line, its change, the remaining error, and the reason if it was not corrected."""
    number = say.number
    rows: list[tuple[str, ...]] = []
    for o in found.outcomes[:MOST_ROWS]:
        c = o.correction
        sizes = ("", "", "") if c is None else (number(c.size_mm, ".3f"), number(np.degrees(c.size_rad), ".4f"), number(c.was_mm, ".3f"))
        u95 = number(o.u95_mm, ".3f") if np.isfinite(o.u95_mm) else ""
        left = say("correction.shortened") if c is not None and c.clipped and not o.left else say.message(o.left)
        rows.append((o.target.name, f"{o.file}:{o.target.line}", *sizes, u95, left))
    return rows
