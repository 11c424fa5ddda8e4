"""Values of a certificate's page: the answers of its first screen, results by test, and pictures."""

from typing import Any

from markupsafe import Markup

from lmeasure.certificate import Measured
from lmeasure.report import certificate_pictures as pictures, certificate_text as texts_of, drawings, html, summary
from lmeasure.report.certificate_figures import plots
from lmeasure.text import Say, from_stated

SHOWN = 4
"""Numbers of the first screen."""


def certificate_html(certificate: dict[str, Any], measured: Measured) -> str:
    """Return the page's text: the same certificate gives the same bytes."""
    language, say = certificate["language"], Say(certificate["language"])
    logo = "" if measured.logo is None else html.picture(measured.logo.content, measured.logo.kind, "logo")
    space = pictures.errors_in_space(certificate)
    drawn = pictures.beside(language, measured.evaluation)
    if space is None and drawn:
        space = pictures.Picture(next(iter(drawn.values())).svgs[:1], next(iter(drawn.values())).caption)
    return html.page(
        "certificate.html", answer(certificate, space, say), say,
        certificate=certificate, logo=logo, code=Markup(drawings.code(certificate["id"], certificate["id"])),
        facts=summary.facts(certificate), figures=pictures.figures(certificate), counted=summary.counted(certificate),
        tests=texts_of.results(certificate), pictures=[(*key, picture) for key, picture in drawn.items()],
        plots=plots(language, measured), value_of=summary.value_of, pieces=lambda name: html.pieces(texts_of.symbol_pieces(name)),
        excluded=texts_of.excluded(certificate), commanded_header=texts_of.commanded_header(language),
        commanded=texts_of.commanded(certificate), uncertainty=texts_of.uncertainty(certificate), notes=texts_of.notes(certificate),
        budgets=texts_of.budgets(certificate), budget_header=texts_of.budget_header(language),
        correlations=texts_of.correlations(certificate), contributions=texts_of.contributions(certificate),
        about=texts_of.about(certificate), inputs=texts_of.inputs(certificate), program=texts_of.program(certificate),
        statements=texts_of.statements(certificate), authoriser=texts_of.authoriser(certificate),
    )  # fmt: skip


def answer(certificate: dict[str, Any], space: pictures.Picture | None, say: Say) -> html.Answer:
    """Return the first screen: the result in a sentence, pass or fail, the worst results, their limits, and the next step."""
    state, outcome = texts_of.outcome(certificate)
    rows = []
    for shown in pictures.figures(certificate)[:SHOWN]:
        note = "; ".join(t for t in (shown.where, shown.result.limits, shown.result.conformity) if t)
        if not shown.result.conformity and shown.result.verdict != say("certificate.capable"):
            note += f"; {shown.result.verdict}"
        name = shown.result.name[:1].upper() + shown.result.name[1:]
        rows.append(
            html.Number(
                html.kept(f"{name} ") + html.pieces(texts_of.symbol_pieces(shown.result.symbol)), summary.value_of(shown.result), note
            )
        )
    rows += html.assumed_numbers(map(from_stated, certificate.get("findings", ())), say)
    load, speed = texts_of.load_and_speed(certificate)
    robot = summary.robot(certificate)
    robot = say("certificate.robot_not_stated") if robot == say("certificate.not_stated") else robot
    subject = " · ".join(t for t in (certificate["id"], robot, load, speed) if t)
    steps = [html.Step(say("certificate.next_verify"), "lmeasure verify FOLDER")]
    if state in ("bad", "warn"):
        steps.insert(
            0, html.Step(say("certificate.next_identify"), "lmeasure identify --robot ROBOT --measurements FILE.csv --out identified")
        )
    steps.append(html.Step(say("certificate.next_compare"), "lmeasure compare EARLIER LATER --page comparison.html"))
    picture = Markup() if space is None else Markup('<div class="drawn">{}</div>').format(html.themed(space.svgs[0]))
    return html.Answer(
        texts_of.title(certificate), f"{summary.sentence(certificate)} {outcome}", state, tuple(rows), summary.limits(certificate),
        tuple(steps), picture, subject, "" if space is None else space.caption,
    )  # fmt: skip
