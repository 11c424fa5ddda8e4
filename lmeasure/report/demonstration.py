"""Page of a demo: each step in one sentence, one picture, one link, and the command that made it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import plotly.graph_objects as go
from markupsafe import Markup

from lmeasure.report import figures, html
from lmeasure.text import Message, Say

HEIGHT_PX = 440
"""Height of every picture: two are side by side on a wide screen."""


class Part(NamedTuple):
    """A step of the demo: heading, sentence, picture, file beside the page to open, and the command that makes the same."""

    heading: Message
    sentence: Message
    figure: go.Figure
    link: str
    command: str


def write_demo_page(path: Path, title: Message, verdict: Message, parts: Sequence[Part], *, language: str) -> None:
    """Write a self-contained page, whole or not at all."""
    say = Say(language)
    shown = [
        {
            "heading": part.heading.text(language),
            "sentence": part.sentence.text(language),
            "plot": figures.figure(part.figure.update_layout(height=HEIGHT_PX), f"picture-{number}", language),
            "link": part.link,
            "command": part.command,
        }
        for number, part in enumerate(parts)
    ]
    answer = html.Answer(title.text(language), verdict.text(language), "good", (), "", (), Markup())
    html.write_page(path, "demo.html", answer, say, parts=shown)
