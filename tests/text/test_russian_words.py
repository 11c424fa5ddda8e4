"""Russian has one word for each thing, that of docs/glossary.md, in all catalogues; and `play` and `scan` speak it."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from lmeasure.cli.text import retold
from lmeasure.text import texts
from lmeasure.text.catalogue import LOCALE

GLOSSARY = Path(__file__).parents[2] / "docs" / "glossary.md"
ENDING = "[а-яё]{0,3}"


def told() -> Iterator[tuple[str, str, str]]:
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
    every = list(told())
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
        for domain, english, russian in told()
        if re.search(r"\bposes?\b", english, re.IGNORECASE)
        and not re.search(r"position|place|platform|where a robot|mount|stood", english, re.IGNORECASE)
        and re.search(r"(?<!пред)положени", russian, re.IGNORECASE)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    "line",
    [
        "demo speaks on udp_multicast:239.74.163.2, 200 samples/s of ch1, ch2",
        "c1 is pulled out by 100.5 mm",
        "sw1 is turned by 45 degrees",
        "c2 is let back",
        "c1: its drum is turned once",
        "the robot goes home",
        "the robot goes to pose P1",
        "the robot runs its motion, 12 s",
        "3412 samples were sent",
        "not done: there is no pose 'x'; they are 1, 2",
        "not done: there is no pose 'x'; none was given by --poses",
        "not done: 'c9': there is no such cable; they are c1, c2",
        "not done: 'abc' is no number",
        "drive.log: 1200 frames in 12.3456 s; candump, times of day",
        "drive.log: 1200 frames in 12.3456 s; candump, times from a beginning of its own",
        "      181  can0         1200     100.0/s      4 bytes",
        "           bytes 0-3: counter, 32 bits little, -120 .. 3400, steps to 12",
        "           byte 4: counts the frames, by 1",
        "           byte 5: toggles between 00 and FF",
        "           byte 6: 14 values, no counter (a checksum, or a measurement)",
        "3 error frames",
        "no adapter is found; interfaces and their names: docs/acquisition.md",
        "the driver of slcan did not answer",
    ],
)
def test_what_play_and_scan_say_is_said_in_russian(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    russian = retold(line)
    names = r"udp_multicast|can0|candump|drive\.log|sw1|c[129]|ch[12]|docs/acquisition\.md|slcan|demo|--poses|P1|abc|FF|0x|x"
    assert not re.search("[a-zA-Z]", re.sub(names, "", russian)), russian
    assert re.findall(r"\d+", russian) == re.findall(r"\d+", line) or "little" in line
    assert len(russian) - len(russian.lstrip()) == len(line) - len(line.lstrip())
