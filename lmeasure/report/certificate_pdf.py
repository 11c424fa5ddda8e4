"""The certificate on paper: PDF/A-2b by typst, texts handed over as data and never as markup."""

import json
import re
from pathlib import Path
from typing import Any

import typst

from lmeasure.arrays import FloatArray
from lmeasure.catalogue import decimal as number
from lmeasure.certification.evaluate import Evaluation
from lmeasure.certification.pictures import Target, targets
from lmeasure.errors import CertificationError
from lmeasure.report import certificate_text as say
from lmeasure.report.words import word

TEMPLATE = Path(__file__).with_name("certificate.typ")
MOST_TARGETS = 9
COLOURS = ("#30343f", "#b3261e", "#1a7f4b")
_NO_GLYPH = re.compile(r'the text `"(.*?)"` could not be displayed')
_ESCAPE = re.compile(r"\\u\{([0-9a-fA-F]+)\}|\\(.)")


def certificate_pdf(certificate: dict[str, Any], evaluation: Evaluation) -> bytes:
    """The PDF's bytes: the same certificate gives the same bytes. CertificationError when it cannot be printed.

    A character that the built-in fonts have no glyph for is printed as its number, since an archive file must not hold holes.
    """
    content = json.dumps(_content(certificate, evaluation), ensure_ascii=False)
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


def _content(certificate: dict[str, Any], evaluation: Evaluation) -> dict[str, Any]:
    language = certificate["language"]
    figures = certificate["characteristics"]
    about = say.about(certificate)
    day = certificate["created"][:10].split("-")
    return {
        "title": say.title(certificate),
        "id": certificate["id"],
        "language": language,
        "date": [int(part) for part in day],
        "only": word(language, "only item"),
        "page": word(language, "page"),
        "of": word(language, "of"),
        "statements": say.statements(certificate),
        "about": about,
        "header": say.results_header(language, any("conformity" in c for c in figures)),
        "results": [{"place": place, "rows": rows} for place, rows in say.results(certificate)],
        "commanded": say.commanded(certificate),
        "excluded": say.excluded(certificate),
        "uncertainty": say.uncertainty(certificate),
        "targets": _targets(language, evaluation),
        "notes": say.notes(certificate),
        "inputs": say.inputs(certificate),
        "program": say.program(certificate),
        "authoriser": next(value for key, value in reversed(about) if key == word(language, "authoriser")),
        "words": {
            **{key: word(language, f"section.{key}") for key in
               ("about", "results", "commanded", "pictures", "excluded", "uncertainty", "notes", "inputs", "program")},
            "none": word(language, "no results"),
            "nothing": word(language, "nothing excluded"),
            "commanded_header": say.commanded_header(language),
            "excluded_header": [word(language, "column.part"), word(language, "column.reason")],
            "inputs_header": [word(language, "column.file"), "SHA-256"],
            "bullseye": word(language, "bullseye.text"),
            "authoriser": word(language, "authoriser"),
            "signature": word(language, "signature"),
            "end": word(language, "end"),
        },
    }  # fmt: skip


def _targets(language: str, evaluation: Evaluation) -> list[list[dict[str, str]]]:
    """Rows of three views each, of the first poses."""
    out = []
    for pose in evaluation.poses[:MOST_TARGETS]:
        row = []
        for target in targets(pose, readable=True):
            axes = word(
                language,
                "bullseye.axes",
                horizontal="XYZ"[target.axes[0]],
                vertical="XYZ"[target.axes[1]],
                radius=number(language, f"{target.radius:g}"),
            )
            if target.enlarged > 1.0:
                axes = f"{axes}; {word(language, 'bullseye.enlarged', factor=number(language, f'{target.enlarged:g}'))}"
            name = say.visible(target.pose)
            row.append({"svg": target_svg(target), "name": name, "axes": axes, "alt": f"{name}: {axes}"})
        out.append(row)
    return out


def target_svg(target: Target) -> str:
    """SVG of one target: rings, the cycles, their mean, the ellipse; the second coordinate up."""
    scale = 100.0 / target.radius

    def at(points: FloatArray) -> list[tuple[str, str]]:
        return [(f"{x * scale:.2f}", f"{-y * scale:.2f}") for x, y in points]

    rings = "".join(f'<circle r="{r}" fill="none" stroke="#c8ccd4" stroke-width="0.7"/>' for r in (25, 50, 75, 100))
    cross = '<path d="M-104 0H104M0 -104V104" stroke="#c8ccd4" stroke-width="0.7"/>'
    dots = "".join(f'<circle cx="{x}" cy="{y}" r="2.2" fill="{COLOURS[0]}"/>' for x, y in at(target.deviations))
    ellipse = ""
    if target.ellipse is not None:
        line = "L".join(f"{x} {y}" for x, y in at(target.ellipse))
        ellipse = f'<path d="M{line}Z" fill="none" stroke="{COLOURS[2]}" stroke-width="1.4"/>'
    ((x, y),) = at(target.mean[None, :])
    mean = f'<path d="M{x} {y}m-5 0h10m-5 -5v10" stroke="{COLOURS[1]}" stroke-width="1.6"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-106 -106 212 212">{rings}{cross}{ellipse}{dots}{mean}</svg>'
