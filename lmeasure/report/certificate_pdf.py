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
from lmeasure.text import message

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
                raise CertificationError(message("error.the_pdf_cannot_be_printed", error=str(error).splitlines()[0])) from None
            for character in missing:
                content = content.replace(character, f"[U+{ord(character):04X}]")
    raise CertificationError(message("error.the_pdf_cannot_be"))


def _unescaped(match: re.Match[str]) -> str:
    return chr(int(match[1], 16)) if match[1] else match[2]


def _content(certificate: dict[str, Any], measured: Measured) -> dict[str, Any]:
    language, logo = certificate["language"], measured.logo
    sections = (
        "summary", "about", "results", "budget", "correlations", "contributions", "pictures", "commanded", "excluded", "uncertainty",
        "notes", "inputs", "program",
    )  # fmt: skip
    words = ("authoriser", "signature", "end", "page", "of", "only_item", "no_results", "nothing_excluded", "bullseye.text")
    state, outcome = say.outcome(certificate)
    return {
        "title": say.title(certificate),
        "id": certificate["id"],
        "language": language,
        "date": [int(part) for part in certificate["created"][:10].split("-")],
        "logo": None if logo is None else {"format": logo.kind, "bytes": list(logo.content)},
        "code": drawings.code(certificate["id"], certificate["id"]),
        "statements": say.statements(certificate),
        "summary": _summary(certificate),
        "result": with_indices(summary.sentence(certificate)),
        "outcome": {"state": state, "text": outcome, "rules": [word(language, f"uncertainty.{r}") for r in sorted(say.rules(certificate))]},
        "limits": summary.limits(certificate),
        "about": say.about(certificate),
        "header": [with_indices(word(language, f"column.{key}")) for key in ("characteristic", "value_with_u95", "k", "n", "verdict")],
        "results": [{"title": one.title, "rows": [_row(place, row) for place, row in one.rows]} for one in say.results(certificate)],
        "pictures": [
            {"kind": kind, "name": say.visible(name), "svgs": drawn.svgs, "caption": drawn.caption}
            for (kind, name), drawn in pictures.beside(language, measured.evaluation).items()
        ],
        "commanded": say.commanded(certificate),
        "commanded_header": say.commanded_header(language),
        "excluded": say.excluded(certificate),
        "excluded_header": [word(language, "column.part"), word(language, "column.reason")],
        "uncertainty": [with_indices(line) for line in say.uncertainty(certificate)],
        "budgets": [
            {"title": with_indices(b.title), "rows": b.rows, "lines": list(map(with_indices, b.lines))} for b in say.budgets(certificate)
        ],
        "budget_header": say.budget_header(language),
        "budget_text": with_indices(word(language, "budget.text")),
        "correlations": say.correlations(certificate),
        "contributions": say.contributions(certificate),
        "notes": [with_indices(line) for line in say.notes(certificate)],
        "inputs": say.inputs(certificate),
        "inputs_header": [word(language, "column.file"), "SHA-256"],
        "program": say.program(certificate),
        "authoriser": say.authoriser(certificate),
        "words": {key: word(language, f"section.{key}") for key in sections} | {key: word(language, key) for key in words},
    }


def _row(place: str, r: say.Result) -> list[Any]:
    decided = " ".join(t for t in (r.limits, r.conformity) if t)
    verdict = "\n".join(t for t in (r.verdict, decided) if t)
    return [place, say.symbol_pieces(r.symbol), r.component, summary.value_of(r), r.k, r.cycles, verdict]


def _summary(certificate: dict[str, Any]) -> dict[str, Any]:
    language = certificate["language"]
    space = pictures.errors_in_space(certificate)
    figures = [
        {
            "symbol": say.symbol_pieces(f.result.symbol),
            "value": summary.value_of(f.result),
            "bar": f.bar,
            "where": f.where,
            **{key: getattr(f.result, key) for key in ("name", "k", "limits", "verdict", "conformity")},
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
