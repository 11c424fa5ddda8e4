"""Page of any file: what it is in one line, its picture, and what its reader has to say of it."""

from collections.abc import Sequence
from pathlib import Path

import plotly.graph_objects as go
from markupsafe import Markup

from lmeasure.report import figures, html
from lmeasure.text import Message, Say


def write_inspection_page(path: Path, title: str, what: Message, *, lines: Sequence[str], figure: go.Figure | None, language: str) -> None:
    """Write a self-contained page, whole or not at all.

    Parameters
    ----------
    path
        Page to write.
    title
        Name of the file.
    what
        Kind of file, in one line.
    lines
        Remarks, a line each.
    figure
        Picture of the content.
    language
        Language of the page.
    """
    say = Say(language)
    shown = [line.text(language) if isinstance(line, Message) else line for line in lines]
    plot = Markup() if figure is None else figures.figure(figure, "picture", language)
    answer = html.Answer(title, what.text(language), "", (), "", (), Markup())
    indented = any(line.startswith(" ") for line in shown)
    html.write_page(
        path,
        "inspection.html",
        answer,
        say,
        plot=plot,
        text="\n".join(map(str, shown)) if indented else "",
        blocks=[] if indented else html.blocks(html.joined(line) for line in shown),
    )
