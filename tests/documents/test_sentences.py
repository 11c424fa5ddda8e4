"""Sentences of the documentation and of the program are short enough for readers whose language is not English."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from lmeasure.text.catalogue import LOCALE, read_catalogue
from lmeasure.workflows import COMMANDS, fields_of, load

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
MEAN, LONG, LONG_SHARE, LONGEST = 16.0, 30, 0.03, 40
"""Words: of a mean sentence, of a long one, the share of long ones, and of the longest."""
END = re.compile(r"(?<=[.!?:])[\"')*]*\s+(?=[A-Z0-9\"'(*`])|(?<=;)\s+")
ITEM = re.compile(r"^\s*(?:[-*+]|\d+\.|#+|>)\s+")


def blocks(text: str) -> Iterator[str]:
    """Return paragraphs, items, headings and long cells of tables of a Markdown page, without code and formulas."""
    text = re.sub(r"^(```|\$\$).*?^\1\s*$|<!--.*?-->", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`]*`", "X", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text))
    for block in re.split(r"\n\s*\n", text):
        if block.lstrip().startswith("|"):
            yield from (cell for row in block.splitlines() for cell in row.strip(" |").split("|"))
            continue
        item: list[str] = []
        for line in block.splitlines():
            if ITEM.match(line) and item:
                yield " ".join(item)
                item = []
            item.append(ITEM.sub("", line).strip())
        yield " ".join(item)


def lengths(text: str) -> list[tuple[int, str]]:
    """Return the words of each sentence, and the sentence."""
    found = [s for block in blocks(text) for s in END.split(block)]
    counted = [(sum(bool(re.search(r"\w", word)) for word in s.split()), s) for s in found]
    return [(n, s) for n, s in counted if n > 2]


def test_sentences_are_counted() -> None:
    text = "# A plain heading\n\nOne two three. Four `a b c` five six; seven eight\nnine.\n\n"
    text += "- ten eleven twelve\n- a b c d\n\n```sh\nno words here\n```\n"
    assert [n for n, _ in lengths(text)] == [3, 3, 4, 3, 3, 4]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_sentences_are_short(page: Path) -> None:
    found = lengths(page.read_text(encoding="utf-8"))
    longest = max(found)
    assert longest[0] <= LONGEST, longest[1]
    assert sum(n for n, _ in found) / len(found) <= MEAN
    long = [s for n, s in found if n > LONG]
    assert len(long) <= max(1, LONG_SHARE * len(found)), "\n".join(long)


PRIVATE = re.compile(
    r"\b(told|tells|stands|held against|of which|by which|reckon\w*|dear|goes on|though it were|zero phase|interim|95 % radius"
    r"|attained less|left out|held out|whoever|nobody (?:has )?measured)\b"
)
"""Words that only this project used, and old ones, where its field has a term (docs/glossary.md)."""


def shown() -> dict[str, str]:
    """Return every text of the program by its id: the catalogue, and the help of commands and options."""
    texts = dict(read_catalogue(LOCALE / "en.po"))
    for name in COMMANDS:
        workflow = load(name)
        texts[f"{name}: help"] = workflow.help
        texts |= {f"{name}: {key}": field.description or "" for key, field in fields_of(workflow.settings).items()}
    return texts


def test_sentences_of_the_program_are_short() -> None:
    found = [(n, s) for text in shown().values() for line in text.split("\n") for n, s in lengths(re.sub(r"\{[^{}]*\}", "x", line))]
    assert max(found)[0] <= LONGEST, max(found)
    assert sum(n for n, _ in found) / len(found) <= MEAN
    long = [s for n, s in found if n > LONG]
    assert len(long) <= LONG_SHARE * len(found), "\n".join(long)


def test_texts_of_the_program_have_the_words_of_the_field() -> None:
    assert {key: text for key, text in shown().items() if PRIVATE.search(re.sub(r"\{[^{}]*\}", "x", text))} == {}
