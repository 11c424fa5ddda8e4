"""The certificate on the screen: one self-contained page, the summary first, every picture beside its table."""

from typing import Any

from lmeasure.certificate import Measured
from lmeasure.report import certificate_pictures as pictures, certificate_text as say, drawings, html, summary
from lmeasure.report.certificate_figures import figures
from lmeasure.report.text import word


def certificate_html(certificate: dict[str, Any], measured: Measured) -> str:
    """The page's text: the same certificate gives the same bytes."""
    language = certificate["language"]
    excluded = (
        html.table((word(language, "column.part"), word(language, "column.reason")), say.excluded(certificate), "text")
        if certificate["excluded"]
        else html.paragraph(word(language, "nothing_excluded"))
    )
    closer = figures(language, measured)
    sections = {
        "summary": _summary(certificate),
        "results": _results(certificate, measured),
        **({"zoom": closer} if closer else {}),
        "excluded": [excluded],
        "commanded": [html.table(say.commanded_header(language), say.commanded(certificate), "text")],
        "uncertainty": [html.paragraph(html.indexed(line)) for line in say.uncertainty(certificate)],
        "notes": ["<ul>", *(f"<li>{html.indexed(line)}</li>" for line in say.notes(certificate)), "</ul>"],
        "about": [html.table((), say.about(certificate), "text")],
        "inputs": [
            html.table((word(language, "column.file"), "SHA-256"), say.inputs(certificate), "text hashes"),
            html.paragraph(f"{word(language, 'section.program')}: {say.program(certificate)}"),
        ],
    }
    titles = {key: word(language, "zoom" if key == "zoom" else f"section.{key}") for key in sections}
    links = "".join(f'<a href="#{key}">{html.text(title)}</a>' for key, title in titles.items())
    body = [
        _identity(certificate, measured),
        *(html.paragraph(line, "small") for line in say.statements(certificate)),
        f'<nav aria-label="{html.text(word(language, "section.contents"))}">{links}</nav>',
        *(part for key, parts in sections.items() for part in (html.heading(titles[key], anchor=f"{key}"), *parts)),
        html.paragraph(f"{word(language, 'authoriser')}: {say.authoriser(certificate)}"),
        html.paragraph(f"— {word(language, 'end')} {certificate['id']} —"),
    ]
    return html.page(f"{say.title(certificate)} {certificate['id']}", body, language)


def _identity(certificate: dict[str, Any], measured: Measured) -> str:
    """Logo and code beside each other."""
    logo = "" if measured.logo is None else html.picture(measured.logo.content, measured.logo.kind, "logo")
    code = drawings.code(certificate["id"], certificate["id"])
    return f'<div class="identity"><div class="code">{code}</div>{logo}</div>'


def _summary(certificate: dict[str, Any]) -> list[str]:
    language = certificate["language"]
    facts = html.table((), summary.facts(certificate), "text")
    shown = pictures.figures(certificate)
    parts = [facts]
    if shown:
        head = [html.indexed(word(language, f"column.{key}")) for key in ("characteristic", "value_with_u95", "bar", "verdict")]
        rows = [
            (
                html.Ready(f"{html.pieces(say.symbol_pieces(f.result.symbol))} {html.kept(f.result.name)}{_small(f.where)}"),
                html.Ready(f"<b>{html.kept(_value(f.result))}</b>{_small(_k(f.result))}"),
                html.Ready(f'<div class="bar">{f.bar}</div>{_small(f.result.limits)}'),
                html.Ready(f"{html.kept(f.result.verdict)}{_small(f.result.conformity)}"),
            )
            for f in shown
        ]
        parts += ['<div class="beside"><div>', html.heading(word(language, "summary.figures"), 3), html.table(head, rows, "text results")]
        parts += [html.paragraph(html.indexed(word(language, "summary.bars")), "small"), "</div><div>"]
        space = pictures.errors_in_space(certificate)
        if space is not None:
            parts += [html.heading(word(language, "errors"), 3), html.drawn(space.svgs, space.caption, "space-drawing")]
        parts.append("</div></div>")
    return [*parts, *(html.paragraph(line, "strong") for line in summary.counted(certificate))]


def _small(text: str) -> str:
    return f"<small>{html.kept(text)}</small>" if text else ""


def _value(result: say.Result) -> str:
    return f"{' '.join(t for t in (result.value, result.u95) if t)}\u00a0{result.unit}"


def _k(result: say.Result) -> str:
    return f"k = {result.k}" if result.k else ""


def _results(certificate: dict[str, Any], measured: Measured) -> list[str]:
    language = certificate["language"]
    groups = say.results(certificate)
    if not groups:
        return [html.paragraph(word(language, "no_results"))]
    drawn = pictures.beside(language, measured.evaluation)
    head = [html.indexed(word(language, f"column.{key}")) for key in ("characteristic", "value_with_u95", "verdict")]
    parts = [html.paragraph(word(language, "bullseye.text"))] if measured.evaluation.poses else []
    for key, place, rows in groups:
        table = html.table(head, [_row(language, row) for row in rows], "text results")
        picture = drawn.get(key)
        parts.append(html.heading(place, 3))
        if picture is None:
            parts.append(table)
        else:
            parts.append(f'<div class="beside"><div>{table}</div>{html.drawn(picture.svgs, picture.caption, key[0])}</div>')
    return parts


def _row(language: str, row: say.Result) -> tuple[html.Ready, ...]:
    cycles = f"{word(language, 'column.n')} = {row.cycles}" if row.cycles else ""
    about = "; ".join(text for text in (row.clause, cycles, _k(row)) if text)
    decided = " ".join(text for text in (row.limits, row.conformity) if text)
    return (
        html.Ready(f"{html.pieces(say.symbol_pieces(row.symbol))} {html.kept(row.name)}{_small(about)}"),
        html.Ready(html.kept(_value(row))),
        html.Ready(f"{html.kept(row.verdict)}{_small(decided)}"),
    )
