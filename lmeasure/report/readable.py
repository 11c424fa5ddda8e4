"""The readable text of a PDF, a page or an XML file: the part that stays the same if other versions write other bytes."""

import base64
import hashlib
import math
import re
from html.parser import HTMLParser

import lxml.etree
import numpy as np
import pypdfium2

_UNSEEN = {"script", "style"}
_WITHIN = {"span", "wbr"}
"""Characters within a word or beside one."""


def pdf_text(content: bytes) -> str:
    """All text of a PDF, page by page; ValueError when it cannot be read."""
    try:
        document = pypdfium2.PdfDocument(content)
        try:
            return "\f".join(_squeezed(page.get_textpage().get_text_bounded()) for page in document)
        finally:
            document.close()
    except pypdfium2.PdfiumError as error:
        raise ValueError(f"is no PDF: {error}") from None


class _Reader(HTMLParser):
    """Collector of the visible text between tags."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[str] = []
        self._hidden = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._hidden += tag in _UNSEEN
        self._apart(tag)

    def handle_endtag(self, tag: str) -> None:
        self._hidden -= tag in _UNSEEN and self._hidden > 0
        self._apart(tag)

    def _apart(self, tag: str) -> None:
        if tag not in _WITHIN:
            self.parts.append(" ")

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.parts.append(data)


def page_text(content: bytes) -> str:
    """All text of an HTML page that is not drawn by its scripts; ValueError when it is no UTF-8."""
    reader = _Reader()
    reader.feed(content.decode("utf-8"))
    reader.close()
    return _squeezed("".join(reader.parts))


_NUMBER = re.compile(r"(?<![\w.])(-?\d+\.\d+(?:e[-+]?\d+)?|-?\d+e[-+]?\d+)(?![\w.])")
DRAWN = 1e-7
"""Numbers of a picture that differ by less [mm] are drawn at the same place."""


_SCRIPT = re.compile(r"<script[^>]*>(.*?)</script>", re.DOTALL)
_ARRAY = re.compile(r'"dtype":"(f[48])","bdata":"([^"]*)"')


def page_alike(one: bytes, other: bytes) -> bool:
    """Return whether two pages are the same, scripts and styles included, but for the last digits of numbers that are not whole."""
    lines = [_without_hashes(content.decode("utf-8", "backslashreplace")).split("\n") for content in (one, other)]
    return len(lines[0]) == len(lines[1]) and all(a == b or line_alike(a, b) for a, b in zip(*lines, strict=True))


def _without_hashes(page: str) -> str:
    """Return the page, the hash of each of its own scripts in its security policy replaced by the number of the script, in order."""
    for number, script in enumerate(_SCRIPT.findall(page)):
        value = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
        page = page.replace(f"'sha256-{value}'", f"'script{number:04}'")
    return re.sub(r"'script\d{4}'(?: 'script\d{4}')*", lambda found: " ".join(sorted(found[0].split(" "))), page)


def line_alike(one: str, other: str) -> bool:
    """Return whether two texts are the same but for the last digits of numbers that are not whole."""
    a, b = (_NUMBER.split(_ARRAY.sub(_numbers, line)) for line in (one, other))
    return len(a) == len(b) and all(
        x == y or (i % 2 == 1 and math.isclose(float(x), float(y), rel_tol=1e-6, abs_tol=DRAWN))
        for i, (x, y) in enumerate(zip(a, b, strict=True))
    )


def _numbers(found: re.Match[str]) -> str:
    """Return an array of plotly, which is written as bytes, as its numbers."""
    try:
        values = np.frombuffer(base64.b64decode(found[2].replace("\\u002f", "/"), validate=True), f"<{found[1]}")
    except ValueError:
        return found[0]
    return f'"dtype":"{found[1]}","values":[{", ".join(map(repr, values.tolist()))}]'


def xml_text(content: bytes) -> str:
    """All elements, attributes and texts of an XML file; ValueError when it cannot be read."""
    try:
        root = lxml.etree.fromstring(content, lxml.etree.XMLParser(resolve_entities=False, no_network=True))
    except lxml.etree.XMLSyntaxError as error:
        raise ValueError(f"is no XML: {error}") from None
    return str(lxml.etree.tostring(root, method="c14n").decode("utf-8"))


def _squeezed(text: str) -> str:
    return " ".join(text.split())
