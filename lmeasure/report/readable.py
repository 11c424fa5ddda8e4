"""The text that people read in a PDF, a page or an XML file: what stays the same when other versions write other bytes."""

from html.parser import HTMLParser

import lxml.etree
import pypdfium2

_UNSEEN = {"script", "style"}
_WITHIN = {"span", "wbr"}
"""What stands within a word or beside one."""


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
    """Collects what stands between the tags, but for what nobody sees."""

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


def xml_text(content: bytes) -> str:
    """All elements, attributes and texts of an XML file; ValueError when it cannot be read."""
    try:
        root = lxml.etree.fromstring(content, lxml.etree.XMLParser(resolve_entities=False, no_network=True))
    except lxml.etree.XMLSyntaxError as error:
        raise ValueError(f"is no XML: {error}") from None
    return str(lxml.etree.tostring(root, method="c14n").decode("utf-8"))


def _squeezed(text: str) -> str:
    return " ".join(text.split())
