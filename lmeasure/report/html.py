"""The shell of a self-contained page: everything in one file, every text from outside escaped, nothing fetched and nothing sent."""

import base64
import hashlib
import html
import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from lmeasure.io import files
from lmeasure.report.text import with_indices
from lmeasure.text import Message, Say

HERE = Path(__file__).parent
BASE_STYLE = HERE / "base.css"
"""Colours, sizes and the parts that all pages have, those of the workbench too."""


@dataclass(frozen=True)
class Number:
    """One of the numbers that matter: its name, value with unit, a note in small type, and a state (good, warn, bad) or none."""

    name: str
    value: str
    note: str = ""
    state: str = ""


def assumed_numbers(lines: Iterable[object], say: Say) -> tuple[Number, ...]:
    """Return how much of U95 is assumed, with the statement that would help most, from lines about it; none where nothing is assumed."""
    by_code = {line.code: line for line in reversed([one for one in lines if isinstance(one, Message)])}
    if "assumed.part" not in by_code:
        return ()
    best = by_code.get("assumed.statement", "")
    return (Number(say("page.assumed"), say("zone.in_mm", mm=by_code["assumed.part"].values["part"]), say.message(best), "warn"),)


@dataclass(frozen=True)
class Step:
    """Next step, and the command to copy for it."""

    text: str
    command: str = ""


@dataclass(frozen=True)
class Answer:
    """The first screen of a page: the subject, its uncertainty, the verdict, its limits, and the next step."""

    title: str
    verdict: str
    state: str
    """State of the verdict: good, warn or bad."""
    numbers: tuple[Number, ...]
    limits: str
    steps: tuple[Step, ...]
    picture: Markup
    subject: str = ""
    caption: str = ""


_PLAIN = r"mm|m|s|ms|deg|rad|mrad|kg|Hz|K|counts|мм|м|с|мс|рад|мрад|кг|Гц|К|отсч\."
_PER = "s|N|mm|m|K|с|Н|мм|м|К"
_UNIT = rf"(?:{_PLAIN})(?:/(?:{_PER}))?[²³]?(?!\w)|%|°"
_TOGETHER = re.compile(
    rf"(?<=[\d⁰¹²³⁴-⁹]) (?={_UNIT})"  # a number and its unit,
    r"|(?<=\bp) (?==)|(?<=[=<>]) (?=[-+\d])|(?<=\(u) (?=\d)"  # p = 0.01, < 1, (u 0.2)
    r"|(?<=\d) (?=[:×±] \d)|(?<=\d [:×±]) (?=\d)"  # 100 : 1, 2 × 3, 21 ± 1
    r"|(?<=\bmm,) (?=mm\b)|(?<=\bмм,) (?=мм\b)|(?<=\bper) (?=mm\b)|(?<=\bна) (?=мм\b)"  # a unit alone in the second line
)
_MINUS = re.compile(r"(?<![\w.,)\]°%-])-(?=\d+(?:[.,]\d+)?(?![\d.,]*[\w-]))")
_PLACE = re.compile(r"\([-+\d.,]+(?:[,;] [-+\d.,]+)+\)")
_WHOLE = re.compile(
    r"(?<![\w&;-])(?:--[a-z][\w-]*(?: \w+:\w+)?|LM-[\dA-F]{8}-[\dA-F]{8}(?![\w-])|\d{4}-\d\d-\d\d(?![\w-]))"  # options, numbers, dates
    rf"|(?<![\w&;/-])(?:{_PLAIN})/(?:{_PER})[²³]?(?![\w/])"  # units: a browser breaks behind a slash
)
_LONG = re.compile(r"[^\s<>&;]{20,}")
_JOINT = re.compile(r"(?<=[_/])(?=\w)")


def joined(said: str) -> str:
    """Return a plain text that no line breaks between number and unit or within coordinates, with true minus signs."""
    return _MINUS.sub("\u2212", _PLACE.sub(lambda place: place[0].replace(" ", "\u00a0"), _TOGETHER.sub("\u00a0", said)))


def kept(value: object) -> Any:
    """Text from outside, safe inside a page, whose numbers and units, coordinates, dates and options no line breaks; a long name is broken
    at its joints first."""
    if isinstance(value, Markup):
        return value
    marked = _WHOLE.sub(lambda found: f'<span class="kept">{found[0]}</span>', html.escape(joined(str(value))))
    return Markup(_LONG.sub(lambda name: _JOINT.sub("<wbr>", name[0]), marked))


def on_paper(content: Any) -> Any:
    """Return the data of a printed sheet, its texts `joined`; drawings stay the same."""
    if isinstance(content, dict):
        return {key: on_paper(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [on_paper(value) for value in content]
    return joined(content) if isinstance(content, str) and not content.startswith("<svg") else content


def indexed(value: str) -> Markup:
    """A text with the indices of its symbols set as such."""
    return pieces(with_indices(value))


def pieces(value: Sequence[tuple[str, str]]) -> Markup:
    """Pieces of a text, each with the index behind it."""
    return Markup("").join(kept(plain) + (Markup("<sub>{}</sub>").format(index) if index else "") for plain, index in value)


_KINDS = {"svg": "svg+xml", "png": "png", "jpg": "jpeg"}


def picture(content: bytes, kind: str, said: str) -> Markup:
    """A picture from a file; scripts in it never run."""
    data = base64.b64encode(content).decode()
    return Markup(f'<img src="data:image/{_KINDS[kind]};base64,{data}" alt="{html.escape(said)}">')


def label(value: object) -> str:
    """A text from outside for a figure, which reads some markup, but knows no signs for quotation marks."""
    return html.escape(str(value), quote=False)


def cut(name: str, most: int = 16) -> str:
    """A name for a place that has room for so many letters."""
    return name if len(name) <= most else name[: most - 1] + "…"


_SCRIPT = re.compile(r"<script\b[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)


def _hashes(body: str) -> frozenset[str]:
    codes = (code.encode("utf-8", "backslashreplace") for code in _SCRIPT.findall(body))
    return frozenset(base64.b64encode(hashlib.sha256(code).digest()).decode() for code in codes)


@cache
def _plotly() -> tuple[str, frozenset[str]]:
    """Return the scripts that draw, and their hashes."""
    scripts = f'<script>window.PlotlyConfig = {{MathJaxConfig: "local"}};</script><script>{get_plotlyjs()}</script>'
    return scripts, _hashes(scripts)


def policy(body: str, drawing: frozenset[str] = frozenset()) -> str:
    """Return the Content-Security-Policy of a page: only its own scripts run, and nothing is fetched or sent.

    plotly compiles its 3-D drawing from text that it writes itself ('unsafe-eval'), sets styles, keeps pictures as data and reads its own
    pictures back as blobs.
    """
    hashes = drawing | _hashes(body)
    scripts = " ".join(["'unsafe-eval'", *(f"'sha256-{value}'" for value in sorted(hashes))]) if hashes else "'none'"
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'none'; "
        "base-uri 'none'; form-action 'none'"
    )


@cache
def _templates() -> Environment:
    """Return the templates of pages; each text that they print is `kept`."""
    made = Environment(
        loader=FileSystemLoader(HERE / "templates"), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        finalize=kept,
    )  # fmt: skip
    made.filters |= {"attr": lambda value: Markup(html.escape(str(value))), "themed": themed, "indexed": indexed, "command": command}
    return made


def command(text: str) -> Markup:
    """Return a command to copy, none of whose words a line breaks unless it is long."""
    words = (html.escape(word) for word in text.split(" "))
    return Markup(" ".join(f'<span class="kept">{word}</span>' if len(word) < MOST_WORD else word for word in words))


MOST_WORD = 32
"""Letters of a word that find room on a telephone."""
INKS = {
    "#30343f": "ink",
    "#7a8194": "soft",
    "#c8ccd4": "line",
    "#b3261e": "bad",
    "#1a7f4b": "good",
    "#cfe8d8": "within",
    "#f5d9d6": "beyond",
}
"""Colours of drawings on paper, and the tokens of a page that take their place there."""


def themed(svg: str) -> Markup:
    """Return a drawing in the colours of the page, light or dark."""
    svg = re.sub("#[0-9a-f]{6}", lambda found: f"var(--{INKS[found[0]]})" if found[0] in INKS else found[0], svg)
    return Markup(svg.replace('"white"', '"var(--paper)"'))


def page(template: str, answer: Answer, say: Say, **values: Any) -> str:
    """Return the text of a page from its template, its first screen and the values that the template names."""
    read = [Markup((HERE / name).read_text(encoding="utf-8")) for name in ("base.css", "page.css", "page.js")]
    whole = _templates().get_template(template).render(answer=answer, say=say, style=read[0] + read[1], script=read[2], **values)
    plotly, drawing = _plotly() if 'class="plotly-graph-div' in whole else ("", frozenset())
    return whole.replace("@policy@", policy(whole, drawing), 1).replace("@plotly@", plotly, 1)


def write_page(path: Path, template: str, answer: Answer, say: Say, **values: Any) -> None:
    """Write a page, whole or not at all."""
    files.write_text(path, page(template, answer, say, **values))


def blocks(lines: Iterable[str]) -> list[list[list[str]]]:
    """Return the lines of a result as blocks of rows of cells: lines in columns one after the other are a table, any other is by itself.
    A first row that begins farther right than the second names the columns behind the first."""
    rows = [(line, re.split(r"\s{2,}", line.strip())) for text in lines for line in text.splitlines() if line.strip()]
    out: list[list[list[str]]] = []
    for columns, group in itertools.groupby(rows, key=lambda row: len(row[1]) > 1):
        own = list(group)
        cells = [row for _, row in own]
        if columns and len(own) > 1 and _indent(own[0][0]) > _indent(own[1][0]) + 1:
            cells[0] = ["", *cells[0]]
        out += [cells] if columns else [[row] for row in cells]
    return out


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())
