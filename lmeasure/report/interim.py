"""Values of the page of an intermediate check: its verdict, every closure beside its U95, possible changes, and the trend."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from lmeasure.procedures import Cause, Checked, Closure, Trend, said
from lmeasure.report import figures, html
from lmeasure.text import Say, number, texts

FINE, FAILED = "#009e73", "#c1272d"


def write_check_page(
    path: Path, found: Checked, trend: Trend | None, *, inputs: Sequence[tuple[str, str]], language: str = "en", when: str = ""
) -> None:
    """Write a self-contained HTML page of the check, whole or not at all; inputs: files with their SHA-256."""
    say = Say(language)
    plots = {} if trend is None else {"trend": figures.figure(trend_figure(trend, language), "trend", language)}
    html.write_page(
        path, "check.html", answer(found, when, say), say,
        closures=_rows(found, language), limit=say.number(100 * found.limit, ".2g"), agreement=found.agreement,
        chance="" if found.agreement is None else _chance(language, found.agreement.probability),
        causes=_causes(found, language), plots=plots, notes=said(found, language), inputs=inputs,
    )  # fmt: skip


def answer(found: Checked, when: str, say: Say) -> html.Answer:
    """Return the first screen: passed or the moved part, the worst closure relative to its limit, and the next step."""
    words = texts(say.language, "interim")
    rows = [
        html.Number(
            say("interim.closed"),
            say("page.of", n=len(found.closures) - len(found.failed), of=len(found.closures)),
            say("interim.closed_note"),
        )
    ]
    limits = say("interim.limited_none")
    if found.closures:
        worst = max(found.closures, key=lambda c: abs(c.value_mm) / c.u95_mm)
        name = f"{words['kind.' + worst.kind]} {_of(worst)}"
        values = {"value": say.number(worst.value_mm, ".3f"), "u95": say.number(worst.u95_mm, ".3f")}
        rows.append(html.Number(say("interim.worst"), say("interim.value_u95", **values), name, "bad" if worst in found.failed else ""))
        limits = say("interim.limited_u95", mm=max(c.u95_mm for c in found.closures))
    if found.agreement is not None:
        chance = _chance(say.language, found.agreement.probability)
        rows.append(
            html.Number(
                words["agreement"],
                f"p {chance}" if chance.startswith("<") else f"p = {chance}",
                say("interim.significance", limit=say.number(found.limit, ".2g")),
                "bad" if found.disagrees else "",
            )
        )
        parts = [c.detectable for c in found.agreement.causes if c.kind == "point"]
        if parts:
            limits += " " + say("interim.limited_detectable", mm=max(parts))
    if found.passed:
        steps = (html.Step(say("interim.next_go_on"), "lmeasure reconstruct RUN --out trajectory.parquet"),)
    else:
        steps = (html.Step(say("interim.next_calibrate"), "lmeasure calibrate FOLDER --out calibrated"),)
    subject = say("interim.when", when=_when(when), stops=len(found.stops), tests=len(found.closures)) if when else ""
    return html.Answer(
        words["title"].format(rig=found.rig), verdict(found, say.language), "good" if found.passed else "bad", tuple(rows), limits, steps,
        figures.figure(closures_figure(found, say.language), "closures", say.language, hero=True), subject,
        words["closures.text"].format(limit=say.number(100 * found.limit, ".2g")),
    )  # fmt: skip


def verdict(found: Checked, language: str) -> str:
    """The verdict in a sentence of the language."""
    words = texts(language, "interim")
    if found.passed:
        return words["passed"]
    if found.astray_mm:
        return words["astray"].format(mm=number(language, found.astray_mm, ".3g"))
    if len(found.causes) == 1:
        only = found.causes[0]
        return words["one.start" if only.kind == "start" else "one"].format(cause=cause_text(only, language))
    if found.causes:
        return words["several"].format(causes="; ".join(cause_text(c, language) for c in found.causes))
    failed = "; ".join(f"{words['kind.' + c.kind]} {c.name}" for c in found.failed)
    return words["unknown"].format(failed=failed or words["agreement"])


def cause_text(c: Cause, language: str) -> str:
    """Return a possible change and its size."""
    words = texts(language, "interim")
    size, u = (number(language, value, ".2g") for value in (c.size, c.u))
    return words[f"cause.{c.kind}"].format(name=c.name, size=size, u=u, unit=_unit(c, language))


def _chance(language: str, probability: float) -> str:
    return number(language, probability, ".2g") if probability >= 1e-9 else "< 10⁻⁹"


def _when(when: str) -> str:
    """A time as people write it: 2026-03-05 09:00:00 UTC for 2026-03-05T09:00:00Z."""
    day, mark, time = when.partition("T")
    return f"{day} {time.removesuffix('Z')} UTC" if mark and time.endswith("Z") else when


def _of(closure: Closure) -> str:
    """Return the closure's position, in signs of every language and in one piece."""
    name = closure.name.replace(" to ", "\u2060–\u2060") if closure.kind == "distance" else closure.name
    return name.replace(" ", "\u00a0")


def _unit(c: Cause, language: str) -> str:
    """Its unit, behind its number."""
    unit = texts(language, "interim")[f"unit.{c.unit}"]
    return unit if unit == "°" else f"\u00a0{unit}"


def _rows(found: Checked, language: str) -> list[tuple[str, ...]]:
    words = texts(language, "interim")
    return [
        (
            words[f"kind.{c.kind}"],
            _of(c),
            number(language, c.value_mm, ".4f"),
            number(language, c.u95_mm, ".4f"),
            _chance(language, c.probability) + (" !" if c in found.failed else ""),
        )
        for c in found.closures
    ]


def closures_figure(found: Checked, language: str) -> go.Figure:
    """Each closure over its U95."""
    words, figure = texts(language, "interim"), go.Figure()
    names = [html.label(f"{words['kind.' + c.kind]} {_of(c)}") for c in found.closures]
    part = [abs(c.value_mm) / c.u95_mm for c in found.closures]
    colour = [FAILED if c in found.failed else FINE for c in found.closures]
    figure.add_bar(x=part, y=names, orientation="h", marker={"color": colour}, showlegend=False)
    figure.add_vline(x=1.0, line={"dash": "dot"})
    figure.update_layout(
        height=160 + 20 * len(names),
        margin={"t": 20, "l": 180},
        # the line of the limit is not cut off
        xaxis={"title": words["part"], "range": [0.0, 1.06 * max([1.0, *part])]},
        yaxis={"autorange": "reversed", "dtick": 1},
    )
    return figure


def trend_figure(trend: Trend, language: str) -> go.Figure:
    """The largest closure of each kind over its U95, check by check."""
    words, figure = texts(language, "interim"), go.Figure()
    times = list(dict.fromkeys(trend.time))
    for kind in dict.fromkeys(trend.kind):
        own = [[p for t, k, p in zip(trend.time, trend.kind, trend.part, strict=True) if t == time and k == kind] for time in times]
        worst = [max(parts) if parts else np.nan for parts in own]
        figure.add_scatter(x=times, y=worst, mode="lines+markers", name=words[f"kind.{kind}"])
    figure.add_hline(y=1.0, line={"dash": "dot"})
    figure.update_layout(height=420, margin={"t": 20}, yaxis={"title": words["part"], "rangemode": "tozero"})
    figure.update_xaxes(title=words["time"], **figures.of_dates(language))
    return figure


def _causes(found: Checked, language: str) -> list[tuple[str, ...]]:
    words = texts(language, "interim")
    return [
        (
            words[f"cause.{c.kind}"].split("{")[0].strip() + f" {c.name}" if c.kind != "start" else words["start"],
            *(number(language, value, ".3g") + _unit(c, language) for value in (c.size, c.u, c.detectable)),
            number(language, c.rest, ".1f"),
        )
        for c in (found.agreement.causes if found.agreement else ())
    ]
