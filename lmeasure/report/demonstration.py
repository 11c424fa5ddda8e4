"""Page of a demo: each step in one sentence, one picture, one link, and the command that made it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import plotly.graph_objects as go

from lmeasure.report import html
from lmeasure.text import Message


class Part(NamedTuple):
    """A step of the demo: heading, sentence, picture, file beside the page to open, and the command that makes the same; picture and file
    are absent of a step that the command has yet to make."""

    heading: Message
    sentence: Message
    figure: go.Figure | None
    link: str
    command: str


def write_demo_page(path: Path, title: Message, parts: Sequence[Part], language: str) -> None:
    """Write a self-contained page, whole or not at all."""
    body: list[str] = []
    for number, part in enumerate(parts):
        link = f'<a href="{html.text(part.link)}">{html.text(part.link)}</a> ' if part.link else ""
        body += [html.heading(part.heading.text(language)), html.paragraph(part.sentence.text(language))]
        if part.figure is not None:
            body.append(html.figure(part.figure, f"picture-{number}", first=number == 0, language=language))
        body.append(f"<p>{link}<code>{html.text(part.command)}</code></p>")
    html.write_page(path, title.text(language), body, language)
