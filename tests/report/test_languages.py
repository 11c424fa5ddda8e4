"""Pages in every language: each text that the code says is in the catalogue, and no Russian page says anything in English."""

import json
import re
from html.parser import HTMLParser

import pypdfium2
import pytest
from pages import PAGES, PDFS, ROOT, page_of

from lmeasure.text import Say, message, number, typed
from lmeasure.text.catalogue import Writer

QUICK = ("calibration", "zone", "structures")
KINDS = [kind if kind in QUICK else pytest.param(kind, marks=pytest.mark.slow) for kind in PAGES if kind != "certificate-in-full"]
"""All but the one whose names are in several languages."""
NAMES = {
    "lmeasure", "place", "docs", "csv", "json", "toml", "alpha", "beta", "SHA", "ISO", "JCGM", "UTC", "rot", "start", "tool", "run",
    "puma", "oat", "python", "numpy", "scipy", "numba", "llvmlite", "pandas", "pyarrow", "pydantic", "plotly", "typst", "segno", "Linux",
    "xarray", "cell", "simulated", "thesis", "earlier", "tracker", "line", "rows", "generic", "eight", "correct", "pick", "inputs",
    "four", "chains", "arms", "unstated", "exact",
}  # fmt: skip
"""Of programs, files and values, which are the same in every language."""
WORD = re.compile(r"[A-Za-z]{3,}")
IDENTIFIER = re.compile(r"--solve \w+|--[\w-]+|'[\w-]+'|\b\w+(?:[_./]\w|\d)[\w./-]*|\b[a-f]+(?:-[a-f]+)+\b|\b[AR][DPT](?:[plxyzabc]|rot)\b")
SHOWN = {"name", "text", "title", "label", "prefix", "suffix", "hovertemplate", "ticktext", "dictionary"}


class Words(HTMLParser):
    """The texts of a page that a person reads: of its body but for codes, and of its figures."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._within: list[str] = []
        self._figures = ""
        self.feed(page)
        for found in re.finditer(r"Plotly\.newPlot\(", self._figures):
            self._figure(self._figures[found.end() :])

    def _figure(self, arguments: str) -> None:
        decoder = json.JSONDecoder()
        while (arguments := arguments.lstrip(" \n,")) and arguments[0] in '"[{':
            value, end = decoder.raw_decode(arguments)
            self._shown(value, shown=False)
            arguments = arguments[end:]

    def _shown(self, value: object, *, shown: bool) -> None:
        if isinstance(value, dict):
            for key, own in value.items():
                if key not in ("template", "locales"):
                    self._shown(own, shown=shown or key in SHOWN)
        elif isinstance(value, list):
            for own in value:
                self._shown(own, shown=shown)
        elif isinstance(value, str) and shown and value not in ("top", "right"):
            self.texts.append(re.sub(r"%\{[^}]*\}|<[^>]*>", " ", value))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._within.append(tag)
        self.texts += [value for key, value in attrs if key in ("alt", "title", "aria-label") and value]

    def handle_endtag(self, tag: str) -> None:
        while self._within and self._within.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if "script" in self._within:
            self._figures += data
        elif not {"style", "code"} & set(self._within):
            self.texts.append(data)


def in_english(texts: list[str]) -> dict[str, list[str]]:
    """Texts with words that are English."""
    found = {text.strip()[:120]: [w for w in WORD.findall(IDENTIFIER.sub(" ", text)) if w not in NAMES] for text in texts}
    return {text: words for text, words in found.items() if words}


@pytest.mark.parametrize("kind", KINDS)
def test_no_russian_page_says_anything_in_english(kind: str) -> None:
    page = page_of(kind, "ru")
    read = Words(page.read_text(encoding="utf-8"))
    assert sum(bool(re.search("[а-яё]", text)) for text in read.texts) > 10
    assert in_english(read.texts) == {}
    for name in PDFS:
        if (page.parent / name).exists():
            document = pypdfium2.PdfDocument(page.parent / name)
            lines = [line for sheet in document for line in sheet.get_textpage().get_text_bounded().splitlines()]
            document.close()
            assert in_english(lines) == {}


@pytest.mark.parametrize("kind", KINDS)
def test_no_english_page_says_anything_in_russian(kind: str) -> None:
    read = Words(page_of(kind, "en").read_text(encoding="utf-8"))
    assert [text for text in read.texts if re.search("[а-яё]", text)] == []


def test_what_a_computation_said_is_told_again() -> None:
    say = Say("ru")
    moves = message("calibration.silent.along", mm=0.31, x=0.1, y=-0.2, z=0.97)
    turns = message("calibration.silent.changes_deg", name=message("parameter.guide_alpha_deg"), value=0.5)
    both = message("calibration.silent.moves_while", moves=moves, turns=turns)
    moved = message("calibration.silent", what=message("calibration.silent.owner", owner="B1", what=both))
    assert moved == (
        "B1 moves 0.31 mm along its line of sight (0.10, -0.20, 0.97) while guide alpha changes by +0.5 deg: "
        "no count changes, so the nominal value is used"
    )
    assert say.message(moved) == (
        "B1 смещается на 0,31 мм вдоль линии визирования (0,10; -0,20; 0,97), при этом угол alpha направляющей меняется на +0,5°: отсчёты "
        "не меняются, взято номинальное значение"
    )
    assert say.message("nothing that anybody has words for") == "nothing that anybody has words for"
    assert say("calibration.mm_rms", mm=0.0123) == "0,0123 мм СКЗ"
    assert Say("en")("calibration.mm_rms", mm=0.0123) == "0.0123 mm rms"
    # what is rounded to nothing has no sign
    assert [say.number(-1e-9, form) for form in (".2f", "+.2f", "z.2f")] == ["0,00", "+0,00", "0,00"]


def test_a_zero_has_no_sign_and_the_last_bits_of_a_computation_are_zero() -> None:
    """They differ between processors, and a page that was written by another one would be another."""
    forms = {(-0.0, "g"): "0", (-0.001, ".2f"): "0.00", (-1e-9, "+.1f"): "+0.0", (-2.5, "8.1f"): "    -2.5"}
    assert {key: number("en", *key) for key in forms} == forms
    assert Say().numbers((2.2e-17, -1e-12, -0.25), ".6g") == "0, 0, -0.25"
    assert Say("ru").numbers((-0.0, 0.5), ".4g") == "0; 0,5"
    assert Writer("ru").vformat("{a:.1f} {b}", (), {"a": -0.01, "b": 3}) == "0,0 3"
    assert typed((0.1 + 0.2, -1e-17, 0.70710678118)) == "0.3,0,0.707106781"


def test_pages_of_the_workbench_print_numbers_by_their_filter() -> None:
    templates = sorted((ROOT / "lmeasure" / "workbench" / "templates").glob("*.html"))
    assert len(templates) > 20
    assert [path.name for path in templates if re.search(r"\|\s*(?:format|round)\b", path.read_text(encoding="utf-8"))] == []
