"""Page of any file: its kind, its picture, the next step, and the reader's remarks."""

import re
from collections.abc import Sequence
from pathlib import Path

import plotly.graph_objects as go
import xarray as xr
from markupsafe import Markup

from lmeasure.accuracy import extent
from lmeasure.report import figures, html, zone_text
from lmeasure.text import Message, Say, typeset


def write_inspection_page(
    path: Path, title: str, what: Message, *, lines: Sequence[str], figure: go.Figure | None, command: str = "", language: str
) -> None:
    """Write a self-contained page of a file, whole or not at all. what: its kind, in one line that begins with its name; lines: remarks;
    command: what to type next."""
    say = Say(language)
    shown = [say.message(line) if isinstance(line, Message) else typeset(line) for line in lines]
    kind = re.sub(r"^\W+", "", Message(what.code, {**what.values, "file": ""}).text(language))
    picture = Markup() if figure is None else figures.figure(figure, "picture", language, hero=True)
    steps = (html.Step("", command),) if command else ()
    answer = html.Answer(title, f"{kind[:1].upper()}{kind[1:]}", "", (), "", steps, picture)
    indented = any(line.startswith(" ") for line in shown)
    html.write_page(
        path,
        "inspection.html",
        answer,
        say,
        text="\n".join(map(str, shown)) if indented else "",
        blocks=[] if indented else html.blocks(html.joined(line) for line in shown),
    )


def zone_lines(zone: xr.Dataset, language: str) -> list[str]:
    """Return the results of a zone, a sentence each."""
    say = Say(language)
    return [*zone_text.findings(zone, extent(zone), say), *zone_text.assumed(zone, say)]
