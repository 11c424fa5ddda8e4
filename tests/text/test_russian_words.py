"""Russian has one word for each thing, that of docs/glossary.md, in all catalogues."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from lmeasure.text import texts
from lmeasure.text.catalogue import LOCALE

GLOSSARY = Path(__file__).parents[2] / "docs" / "glossary.md"
ENDING = "[а-яё]{0,3}"


def reported() -> Iterator[tuple[str, str, str]]:
    """Return id, English and Russian of every text."""
    english = texts("en")
    for key, russian in texts("ru").items():
        yield key, english.get(key, key), russian


def pattern(phrase: str) -> re.Pattern[str]:
    """A phrase in any case and number: a stem for each word; what is written in capitals is so."""
    if phrase.isupper():
        return re.compile(rf"\b{phrase}\b")
    stems = [re.sub(r"(?:ая|ое|[аяеиы])$", "", word) for word in phrase.split()]
    return re.compile(r"\b" + r"\s+".join(rf"{stem}{ENDING}\b" for stem in stems), re.IGNORECASE)


def test_a_phrase_is_found_in_every_case_and_number() -> None:
    assert pattern("блок").search("поворотного блока")
    assert pattern("блок").search("блоки")
    assert not pattern("блок").search("блокировка")
    assert pattern("особое положение").search("от особого положения")
    assert pattern("особое положение").search("Особые положения")
    assert not pattern("СКО").search("сколько, Скорость")


def test_catalogues_keep_to_the_glossary() -> None:
    table = GLOSSARY.read_text(encoding="utf-8").split("## In Russian")[1]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 15
    every = list(reported())
    for word, russian, never in rows:
        assert any(pattern(russian).search(text) for _, _, text in every), word
        for phrase in filter(None, never.split(", ")):
            found = [(domain, text) for domain, _, text in every if pattern(phrase).search(text)]
            assert not found, f"{word} is {russian}, not {phrase}: {found}"


@pytest.mark.parametrize("path", sorted(LOCALE.glob("*.po")), ids=lambda path: path.stem)
def test_no_text_stands_twice_in_a_catalogue(path: Path) -> None:
    """Of two translations of one, it could not be told which is read."""
    entries = re.findall(r'^msgid ((?:"(?:[^"\\]|\\.)*"\n)+)', path.read_text(encoding="utf-8"), re.MULTILINE)
    twice = [text for text, number in Counter(entries).items() if number > 1]
    assert entries
    assert twice == []


def test_a_pose_is_no_position() -> None:
    wrong = [
        (domain, english, russian)
        for domain, english, russian in reported()
        if re.search(r"\bposes?\b", english, re.IGNORECASE)
        and not re.search(r"position|place|platform|where a robot|mount|stood", english, re.IGNORECASE)
        and re.search(r"(?<!пред)(?<!особ.. )(?<!особ... )положени", russian, re.IGNORECASE)
    ]
    assert wrong == []
