"""Catalogues and code agree: every id that the code uses has a text, every text is used, and each language has them all."""

import ast
import re
import string
from functools import cache
from pathlib import Path

import pytest

from lmeasure.cli.commands import command
from lmeasure.iso9283.clauses import CLAUSES
from lmeasure.text import LANGUAGES, texts
from lmeasure.text.catalogue import LOCALE, read_catalogue
from lmeasure.workflows import COMMANDS, JOBS, command_help, help_of, job_name, panel_of

ROOT = Path(__file__).parents[2] / "lmeasure"
OTHERS = sorted(set(LANGUAGES) - {"en"})
SUBJECTS = ("certificate", "interim", "trajectory")
"""Subjects whose texts are read by the rest of their ids (`texts(language, subject)`)."""
ENDINGS = ("csv", "css", "html", "js", "json", "nc", "parquet", "pdf", "svg", "toml", "typ", "urdf", "xml")


@cache
def own(language: str) -> dict[str, str]:
    return read_catalogue(LOCALE / f"{language}.po")


def stated_in_code() -> set[str]:
    """Ids of texts whose English stands in the code beside what it is of: help of commands, and ISO's names of characteristics."""
    out = {f"certificate.name.{quantity.symbol}" for clause in CLAUSES for quantity in clause.quantities}
    out |= {"cli.help", *(f"cli.option.{name}" for name in ("version", "help", "install_completion", "show_completion"))}
    out |= {job_name(job).code for job in JOBS} | {command_help(name).code for name in COMMANDS}
    for name in COMMANDS:
        for one in command(name).params:
            if one.help:
                out.add(help_of(name, one.name, one.help).code)
            if one.rich_help_panel:
                out.add(panel_of(one.rich_help_panel).code)
    return out


def fields_of(text: str) -> set[tuple[str, str | None, str | None]]:
    """Names of values with how they are written; the forms of a word differ between languages."""
    fields = string.Formatter().parse(text)
    return {(name, spec, conversion) for _, name, spec, conversion in fields if name is not None and "|" not in (spec or "")}


@pytest.mark.parametrize("language", OTHERS)
def test_a_language_has_every_id_and_its_values(language: str) -> None:
    other, english = own(language), own("en")
    assert sorted(set(english) - set(other)) == [], f"add them to {language}.po"
    assert sorted(set(other) - set(english) - stated_in_code()) == []
    assert sorted(stated_in_code() - set(other)) == [], f"add them to {language}.po"
    assert [key for key, text in other.items() if not text] == []
    assert [key for key in english if fields_of(english[key]) != fields_of(other[key])] == []


@pytest.mark.parametrize(("language", "forms"), [("en", 2), ("ru", 3)])
def test_words_after_counts_have_the_forms_of_their_language(language: str, forms: int) -> None:
    found = {key: spec for key, text in own(language).items() for _, _, spec, _ in string.Formatter().parse(text) if spec and "|" in spec}
    assert found
    assert [key for key, spec in found.items() if spec.count("|") != forms - 1] == []


def test_texts_that_scripts_fill_in_have_no_forms_of_words() -> None:
    """A script puts a value at `{name}` and knows no forms."""
    pages = [path.read_text(encoding="utf-8") for path in (ROOT / "workbench" / "templates").glob("*.html")]
    named = {key for text in pages for key in re.findall(r"""data-[\w-]+="[^"]*_\('([\w.]+)'\)""", text)}
    assert "workbench.iso_iec_17025_asks" in named
    assert [key for key in named if "|" in own("en").get(key, "") or "|" in own("ru").get(key, "")] == []


@cache
def constants() -> tuple[frozenset[str], tuple[re.Pattern[str], ...], tuple[tuple[str, ast.Call, str], ...]]:
    """Texts of the code, patterns of those that are put together, and calls with an id: where, and which."""
    plain, patterns, calls = set(), set(), []
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                plain.add(node.value)
            elif isinstance(node, ast.JoinedStr):
                parts = [str(part.value) if isinstance(part, ast.Constant) else None for part in node.values]
                if re.fullmatch(r"[\w.%/ -]{3,}", "".join(filter(None, parts))):
                    patterns.add("".join(r"[\w.%/ -]*" if part is None else re.escape(part) for part in parts))
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("message", "say", "word", "Message"):
                calls += [
                    (f"{path.name}:{node.lineno}", node, str(a.value)) for a in node.args[:1] if isinstance(a, ast.Constant) and a.value
                ]
    for path in (*(ROOT / "workbench").rglob("*.*"), *(ROOT / "report").rglob("*.html")):
        if path.suffix in (".html", ".svg"):
            plain |= set(re.findall(r"""['">]([\w./%]+)['"<]""", path.read_text(encoding="utf-8")))
    return frozenset(plain), tuple(map(re.compile, sorted(patterns))), tuple(calls)


def test_every_text_is_used() -> None:
    plain, patterns, _ = constants()
    unused = []
    for key in own("en"):
        head, _, rest = key.partition(".")
        names = {key, rest} if head in SUBJECTS else {key}
        dynamic = head in ("fault", "source") or key.startswith(
            ("workbench.kind.", "workbench.state.", "workbench.unit.", "label.", "rig_form.", "cli.stage.")
        )
        if not dynamic and not names & plain and not any(pattern.fullmatch(name) for pattern in patterns for name in names):
            unused.append(key)
    assert unused == []


def test_every_id_of_the_code_has_a_text() -> None:
    known = own("en")
    assert sorted({key for _, call, key in constants()[2] if getattr(call.func, "id", "") != "word"} - set(known)) == []
    templates = [path.read_text(encoding="utf-8") for package in ("workbench", "report") for path in (ROOT / package).rglob("*.html")]
    assert [key for text in templates for key in re.findall(r"""\b(?:_|say)\(["']([\w./%]+)["'][,)]""", text) if key not in known] == []
    begin = {key.partition(".")[0] for key in known} - set(SUBJECTS)
    named = {text for text in constants()[0] if re.fullmatch(r"[a-z_]+(\.[a-z0-9_/%]+)+", text) and not text.endswith(ENDINGS)}
    assert sorted(text for text in named if text.startswith("workbench.") and text.partition(".")[0] in begin and text not in known) == []


def test_catalogues_are_sorted_by_id() -> None:
    for language in LANGUAGES:
        assert list(own(language)) == sorted(own(language)), language


def test_a_label_has_words() -> None:
    labels = {key: text for key, text in texts("en").items() if key.startswith("label.")}
    assert labels
    assert [key for key, text in labels.items() if "_" in text] == []


def test_a_call_gives_every_value_that_its_text_names() -> None:
    known, lacking = own("en"), []
    for where, call, key in constants()[2]:
        given = {keyword.arg for keyword in call.keywords}
        if getattr(call.func, "id", "") != "Message" and key in known and None not in given and len(call.args) == 1:
            wanted = {name for name, _, _ in fields_of(known[key])}
            if given and not wanted <= given:
                lacking.append(f"{where}: {key}: {sorted(wanted - given)}")
    assert lacking == []
