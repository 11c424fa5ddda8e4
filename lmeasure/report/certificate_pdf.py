"""The certificate on paper: PDF/A-2b by typst, texts handed over as data and never as markup."""

import json
import re
from pathlib import Path
from typing import Any

import typst

from lmeasure.certificate import Measured
from lmeasure.core import CertificationError
from lmeasure.report import certificate_pictures as pictures, certificate_text as say, drawings, html, summary
from lmeasure.report.text import with_indices, word

TEMPLATE = Path(__file__).with_name("certificate.typ")
_NO_GLYPH = re.compile(r'the text `"(.*?)"` could not be displayed')
_ESCAPE = re.compile(r"\\u\{([0-9a-fA-F]+)\}|\\(.)")


def certificate_pdf(certificate: dict[str, Any], measured: Measured) -> bytes:
    """The PDF's bytes: the same certificate gives the same bytes. CertificationError when it cannot be printed.

    A character that the built-in fonts have no glyph for is printed as its number, since an archive file must not hold holes.
    """
    content = json.dumps(html.on_paper(_content(certificate, measured)), ensure_ascii=False)
    for _ in range(8):
        try:
            return bytes(
                typst.compile(TEMPLATE.read_bytes(), sys_inputs={"content": content}, pdf_standards=["a-2b"], ignore_system_fonts=True)
            )
        except typst.TypstError as error:
            missing = {c for text in _NO_GLYPH.findall(str(error)) for c in _ESCAPE.sub(_unescaped, text)}
            if not missing:
                raise CertificationError(f"the PDF cannot be printed: {str(error).splitlines()[0]}") from None
            for character in missing:
                content = content.replace(character, f"[U+{ord(character):04X}]")
    raise CertificationError("the PDF cannot be printed: too many characters without a glyph")


def _unescaped(match: re.Match[str]) -> str:
    return chr(int(match[1], 16)) if match[1] else match[2]


def _content(certificate: dict[str, Any], measured: Measured) -> dict[str, Any]:
    language = certificate["language"]
    logo = measured.logo
    sections = ("summary", "contents", "about", "results", "commanded", "excluded", "uncertainty", "notes", "inputs", "program")
    return {
        "title": say.title(certificate),
        "id": certificate["id"],
        "language": language,
        "date": [int(part) for part in certificate["created"][:10].split("-")],
        "only": word(language, "only_item"),
        "page": word(language, "page"),
        "of": word(language, "of"),
        "logo": None if logo is None else {"format": logo.kind, "bytes": list(logo.content)},
        "code": drawings.code(certificate["id"], certificate["id"]),
        "statements": say.statements(certificate),
        "summary": _summary(certificate),
        "about": say.about(certificate),
        "header": [
            with_indices(word(language, f"column.{key}")) for key in ("characteristic", "clause", "value_with_u95", "k", "n", "verdict")
        ],
        "results": _results(certificate, measured),
        "commanded": say.commanded(certificate),
        "excluded": say.excluded(certificate),
        "uncertainty": [with_indices(line) for line in say.uncertainty(certificate)],
        "notes": [with_indices(line) for line in say.notes(certificate)],
        "inputs": say.inputs(certificate),
        "program": say.program(certificate),
        "authoriser": say.authoriser(certificate),
        "words": {
            **{key: word(language, f"section.{key}") for key in sections},
            "none": word(language, "no_results"),
            "nothing": word(language, "nothing_excluded"),
            "commanded_header": say.commanded_header(language),
            "excluded_header": [word(language, "column.part"), word(language, "column.reason")],
            "inputs_header": [word(language, "column.file"), "SHA-256"],
            "bullseye": word(language, "bullseye.text"),
            "authoriser": word(language, "authoriser"),
            "signature": word(language, "signature"),
            "end": word(language, "end"),
        },
    }


def _summary(certificate: dict[str, Any]) -> dict[str, Any]:
    language = certificate["language"]
    space = pictures.errors_in_space(certificate)
    figures = [
        {
            "symbol": say.symbol_pieces(f.result.symbol),
            "name": f.result.name,
            "where": f.where,
            "value": _value(f.result),
            "k": f.result.k,
            "limits": f.result.limits,
            "verdict": f.result.verdict,
            "conformity": f.result.conformity,
            "bar": f.bar,
        }
        for f in pictures.figures(certificate)
    ]
    columns = ("characteristic", "value_with_u95", "k", "bar", "verdict")
    return {
        "facts": summary.facts(certificate),
        "counted": summary.counted(certificate),
        "title": word(language, "summary.figures"),
        "header": [with_indices(word(language, f"column.{key}")) for key in columns],
        "figures": figures,
        "bars": with_indices(word(language, "summary.bars")),
        "space": None if space is None else {"title": word(language, "errors"), "svg": space.svgs[0], "caption": space.caption},
    }


def _value(result: say.Result) -> str:
    return f"{' '.join(t for t in (result.value, result.u95) if t)}\u00a0{result.unit}"


def _results(certificate: dict[str, Any], measured: Measured) -> list[dict[str, Any]]:
    drawn = pictures.beside(certificate["language"], measured.evaluation)
    out = []
    for (kind, name), place, rows in say.results(certificate):
        picture = drawn.get((kind, name))
        table = [
            [
                say.symbol_pieces(r.symbol),
                r.name,
                r.clause,
                _value(r),
                r.k,
                r.cycles,
                "\n".join(t for t in (r.verdict, " ".join(t for t in (r.limits, r.conformity) if t)) if t),
            ]
            for r in rows
        ]
        shown = None if picture is None else {"svgs": picture.svgs, "caption": picture.caption}
        out.append({"kind": kind, "place": place, "rows": table, "picture": shown})
    return out
