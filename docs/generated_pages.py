"""Parts of the site that come from the program: toctrees, commands, Python names, schemas and codes. Needs only lmeasure itself."""

import contextlib
import inspect
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import lmeasure

ROOT = Path(__file__).parents[1]
PARTS = ("start", "how-to", "hardware", "reference", "explanation")
"""Pages that list the pages of one part of the documentation."""
INDEXES = ("docs/README", *(f"docs/{part}" for part in PARTS), "docs/decisions/README")
ENTRY = re.compile(r"^(?:- |\| )\[[^\]]+\]\(([^)#]+)\.md\)", re.MULTILINE)
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([\w/.-]+)(?:#[\w-]*)?\)")
PAGES = ("docs/*.md", "docs/decisions/*.md", "benchmarks/results/*.md", "README.md", "CHANGELOG.md", "CONTRIBUTING.md")
"""Sources of the site's pages, from the folder of the project."""
SUBJECTS = {
    "api": "Stages",
    "rig": "Rigs",
    "recording": "Counts, poses, programs and runs",
    "sensors": "Lengths",
    "calibration": "Calibration",
    "acquisition": "Frames of a bus",
    "trajectory": "Trajectories",
    "accuracy": "Accuracy zones",
    "structure": "Structures",
    "robots": "Robots",
    "iso9283": "Characteristics",
    "certificate": "Certificates",
    "core": "Angles and errors",
}
"""Headings of the Python reference, by the package that defines a name."""


@cache
def sources() -> frozenset[Path]:
    """Return the files of all pages of the site."""
    return frozenset(path for pattern in PAGES for path in ROOT.glob(pattern))


NOTES = (
    *("angles", "cable", "cables", "cause", "certify", "channel", "channels", "clock", "contradiction", "counts", "effect", "effects"),
    *("encoder", "exact", "excluded", "expansion", "fault", "markers", "orientation", "origin", "passes", "posing", "recording"),
    *("redundancy", "reliability", "rig.size", "rig.uncalibrated", "scheme", "settling", "slip", "stabilisation", "stamps", "start"),
    *("steps", "temperature", "time", "uncertainty", "verdict", "windows", "zone.angle", "zone.radius", "zone.unknown"),
)
"""Beginnings of the ids of messages that warn or note, in the catalogue of texts."""
NAMES = (
    "channel.cable",
    "channel.distance",
    "channel.inclination",
    "channel.sensor",
    "channel.swivel",
    "time.at",
    "time.beginning",
    "time.end",
)
"""Ids of names that such messages contain."""


def begins(code: str, prefixes: Iterable[str]) -> bool:
    """Return whether an id is one of these, or begins with one of them and a point."""
    return any(code == one or code.startswith(f"{one}.") for one in prefixes)


def notes() -> dict[str, str]:
    """Return the English text of every message that warns or notes, by its id."""
    from lmeasure.text import texts

    return {code: text for code, text in texts("en").items() if begins(code, NOTES) and not begins(code, NAMES)}


def codes() -> str:
    """Return a table of all notes."""
    rows = (f"| `{code}` | {escaped(text)} |" for code, text in sorted(notes().items()))
    return "\n".join(["## Texts of all codes", "", "`{name}` is a value.", "", "| code | text |", "|---|---|", *rows, ""])


def completed(page: str, text: str) -> str:
    """Return the source of a page with its toctree and its generated parts, and without links to folders."""
    parts = {"docs/commands": commands, "docs/python": names, "docs/schemas": schemas, "docs/troubleshooting": codes}
    text = without_foreign_links(ROOT / f"{page}.md", text)
    if page == "docs/gallery":
        text = with_figures(text)
    if page in parts:
        text = f"{text.rstrip()}\n\n{parts[page]()}"
    if page in INDEXES:
        text = f"{cards(text) if page == INDEXES[0] else text.rstrip()}\n\n{toctree(entries(text))}"
    if page == "docs/results":
        text = f"{text.rstrip()}\n\n{toctree(['../benchmarks/results/*'], 'glob')}"
    return text


def with_figures(text: str) -> str:
    """Return the gallery with the figure of each block below it: the blocks are run here, in the folder of the project."""
    names: dict[str, Any] = {}

    def drawn(block: re.Match[str]) -> str:
        first = not names
        with contextlib.chdir(ROOT):
            exec(compile(block[1], "docs/gallery.md", "exec"), names)
        figure = names["figure"].to_html(full_html=False, include_plotlyjs=first, include_mathjax=False)
        return f"{block[0]}\n\n````{{raw}} html\n{figure}\n````"

    return re.sub(r"^```python\n(.*?)^```$", drawn, text, flags=re.MULTILINE | re.DOTALL)


def entries(text: str) -> list[str]:
    """Return the pages that an index page lists: the first link of each item of a list and of each row of a table."""
    return list(dict.fromkeys(ENTRY.findall(text)))


def toctree(pages: Iterable[str], *options: str) -> str:
    """Return the toctree of pages; the list on the page itself shows them."""
    return "\n".join(["```{toctree}", ":hidden:", *(f":{option}:" for option in options), "", *pages, "```", ""])


def cards(text: str) -> str:
    """Return the first page with a card for each item of its list."""
    grid = re.sub(r"^- (\[[^\]]+\]\([^)]+\)): ([^\n]+(?:\n  [^\n]+)*)$", r"```{grid-item-card} \1\n\2\n```", text, flags=re.MULTILINE)
    first, last = grid.index("```{"), grid.rindex("```") + 3
    return f"{grid[:first]}````{{grid}} 1 2 2 2\n:gutter: 3\n\n{grid[first:last]}\n````{grid[last:]}"


def without_foreign_links(page: Path, text: str) -> str:
    """Return a text without links to folders, and to documents that are no pages of the site: a code host shows these, a site does not."""

    def replaced(link: re.Match[str]) -> str:
        target = (page.parent / link[2]).resolve()
        foreign = target.suffix == ".md" and target not in sources()
        return link[1] if target.is_dir() or foreign else link[0]

    return LINK.sub(replaced, text)


def escaped(text: str) -> str:
    """Return a text in which no sign has a meaning in Markdown, except around code."""
    parts = re.split(r"(`[^`|]+`)", " ".join(text.split()))
    return "".join(part if i % 2 else re.sub(r"([\\`*_{}\[\]<>|#$~])", r"\\\1", part) for i, part in enumerate(parts))


def sentence(text: str) -> str:
    """Return a phrase as a sentence."""
    return f"{text[0].upper()}{text[1:]}."


def commands() -> str:
    """Return every command with its arguments and options, by job, from the definitions that the command line uses."""
    from lmeasure.workflows import JOBS

    return "\n".join(line for job, of_job in JOBS.items() for line in (f"## {job}", "", *(x for name in of_job for x in _command(name))))


def _command(name: str) -> Iterator[str]:
    from lmeasure.cli.commands import command

    made = command(name)
    context = made.make_context(name, [], resilient_parsing=True)
    yield from (f"### {name}", "")
    for paragraph in (made.help or "").split("\n\n"):
        yield from (escaped(paragraph), "")
    yield from ("```text", f"lmeasure {name} {' '.join(made.collect_usage_pieces(context))}", "```", "")
    for parameter in made.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            yield from (f"`{record[0]}`", f": {escaped(record[1]) or '–'}", "")


def names() -> str:
    """Return a section per subject with the documentation of each public name, as autodoc directives."""
    out: list[str] = []
    for package, title in SUBJECTS.items():
        out += [f"## {title}", "", "```{eval-rst}"]
        for name in names_of(package):
            kind = _directive(getattr(lmeasure, name))
            out += [f".. {kind}:: lmeasure.{name}", *(["   :members:"] if kind == "autoclass" else []), ""]
        out += ["```", ""]
    return "\n".join(out)


def _directive(named: Any) -> str:
    if not inspect.isclass(named):
        return "autofunction"
    return "autoexception" if issubclass(named, BaseException) else "autoclass"


def names_of(package: str) -> list[str]:
    """Return the public names that a package defines, functions first."""
    own = [name for name in lmeasure.__all__ if _package(getattr(lmeasure, name)) == package]
    return sorted(own, key=lambda name: (inspect.isclass(getattr(lmeasure, name)), name))


def _package(named: Any) -> str:
    return str(named.__module__).split(".")[1]


def schemas() -> str:
    """Return the JSON Schema of every file that has one, folded."""
    from lmeasure.io import FILE_KINDS, shipped
    from lmeasure.text import message

    out: list[str] = []
    for name, kind in FILE_KINDS.items():
        out += [f"## {kind.file}", "", f"{sentence(escaped(message('schema.' + name)))} `lmeasure schema {name}` prints this schema.", ""]
        out += [f"````{{dropdown}} Schema of {kind.file}", "```json", shipped(name).strip(), "```", "````", ""]
    return "\n".join(out)
