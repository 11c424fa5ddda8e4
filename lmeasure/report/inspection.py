"""Page of any file: what it is in one line, its picture, and what its reader has to say of it."""

from collections.abc import Sequence
from pathlib import Path

import plotly.graph_objects as go

from lmeasure.report import html
from lmeasure.text import Message


def write_inspection_page(path: Path, title: str, what: Message, lines: Sequence[str], figure: go.Figure | None, language: str) -> None:
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
    shown = [line.text(language) if isinstance(line, Message) else line for line in lines]
    body = [html.paragraph(what.text(language))]
    if figure is not None:
        body.append(html.figure(figure, "picture", first=True, language=language))
    if shown:
        body.append(f"<pre>{html.text(chr(10).join(shown))}</pre>")
    html.write_page(path, title, body, language)
