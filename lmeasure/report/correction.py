"""The page of a corrected program: how many targets were corrected, by how much, what is left, and every target with its line."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lmeasure.report import html
from lmeasure.report.text import axes
from lmeasure.robot_programs import Corrected, Listing, Outcome
from lmeasure.text import ENGLISH, Say

ARROWS = 0.1
"""Of the targets' extent: length at which the largest correction is drawn."""
BEFORE, AFTER, U95 = "#d55e00", "#0072b2", "#009e73"
MOST_ROWS = 500


def write_correction_page(
    path: Path, found: Corrected, listing: Listing, *, inputs: Sequence[tuple[str, str]], language: str = "en"
) -> None:
    """Write a self-contained HTML page of what became of a program, whole or not at all; inputs: files with their SHA-256."""
    say = Say(language)
    done = found.done
    body = [html.paragraph(*_verdict(found, listing, say)), html.table((), _figures(found, say), "text")]
    if done:
        reported = say("correction.how_far_robot_known")
        space, times = space_figure(done, say)
        enlarged = say("correction.how_much_controller_told", times=times)
        body += [html.heading(say("correction.errors_before_after")), html.paragraph(reported)]
        body += [html.figure(errors_figure(done, say), "errors", first=True, language=language)]
        body += [html.heading(say("correction.corrections_space")), html.paragraph(enlarged)]
        body += [html.figure(space, "space", first=False, language=language)]
    body += _targets(found, say)
    if listing.unread:
        lines = "".join(f"<li>{html.kept(say.message(u.text))}</li>" for u in listing.unread)
        body += [html.heading(say("correction.positions_were_not_read")), f"<ul>{lines}</ul>"]
    body += [html.heading(say("page.inputs")), html.table((say("page.file"), "SHA-256"), inputs, "text hashes")]
    html.write_page(path, say("correction.corrected_program", name=", ".join(source.name for source in listing.sources)), body, language)


def _verdict(found: Corrected, listing: Listing, say: Say) -> tuple[str, str]:
    left = len(found.outcomes) - found.changed
    if left or listing.unread:
        reported = say("correction.targets_were_left_they", left=left, unread=len(listing.unread))
        return reported, "verdict doubt" if found.changed else "verdict bad"
    return say("correction.every_target_corrected"), "verdict"


def _whole(said: str) -> str:
    """A number that is not parted from its unit."""
    return said.replace(" ", "\u00a0")


def _figures(found: Corrected, say: Say) -> list[tuple[str, str]]:
    rows = [(say("correction.targets_corrected"), _whole(say("page.of", n=found.changed, of=len(found.outcomes))))]
    done = found.done
    if done:
        corrections = [o.correction for o in done if o.correction is not None]
        u95 = max(o.u95_mm for o in done)
        rows += [
            (say("correction.largest_correction"), _whole(say("correction.mm", mm=max(c.size_mm for c in corrections)))),
            (say("correction.largest_error_before_those"), _whole(say("correction.mm", mm=max(c.was_mm for c in corrections)))),
            (say("correction.largest_error_left_those"), _whole(say("correction.mm", mm=max(c.left_mm for c in corrections)))),
            (
                say("correction.largest_u95_where_goes"),
                _whole(say("correction.mm", mm=u95)) if np.isfinite(u95) else say("correction.cannot_told"),
            ),
        ]
    # what nobody corrected is as wrong as before; without this the page looks as if nothing were wrong any more
    stays = [o.correction.was_mm for o in found.outcomes if o.left and o.correction is not None]
    if stays:
        rows.append((say("correction.largest_error_those_left"), _whole(say("correction.mm", mm=max(stays)))))
    return rows


def errors_figure(done: Sequence[Outcome], say: Say = ENGLISH) -> go.Figure:
    """Error of each target before, and on a scale of their own below what is left and the U95 of where the robot goes."""
    names = [html.label(o.target.name) for o in done]
    columns = (
        (1, say("page.before"), BEFORE, "circle", [o.correction.was_mm for o in done if o.correction is not None]),
        (2, say("correction.left"), AFTER, "circle", [o.correction.left_mm for o in done if o.correction is not None]),
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
    """Flange, or tool where a map corrected it, at the targets in the robot's base, what the controller gets minus before, and how many
    times that is enlarged."""
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


def _targets(found: Corrected, say: Say) -> list[str]:
    """Every target: where it stands, by how much it changes, what remains, and why it was left."""
    number = say.number
    rows = []
    for o in found.outcomes[:MOST_ROWS]:
        c = o.correction
        sizes = ("", "", "") if c is None else (number(c.size_mm, ".3f"), number(np.degrees(c.size_rad), ".4f"), number(c.was_mm, ".3f"))
        u95 = number(o.u95_mm, ".3f") if np.isfinite(o.u95_mm) else ""
        left = say("correction.shortened") if c is not None and c.clipped and not o.left else say.message(o.left)
        rows.append((o.target.name, f"{o.file}:{o.target.line}", *sizes, u95, left))
    header = (
        say("correction.target"),
        say("correction.line"),
        say("correction.correction_mm"),
        say("correction.correction_2"),
        say("correction.error_before_mm"),
        say("page.u95_mm"),
        say("correction.remark"),
    )
    more = len(found.outcomes) - len(rows)
    note = [html.paragraph(say("correction.more_corrections_json", n=more))] if more else []
    return [html.heading(say("correction.targets_2")), html.table(header, rows, "targets"), *note]
