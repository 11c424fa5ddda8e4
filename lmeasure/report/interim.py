"""The page of an interim check: the verdict first, every closure against what may be expected, what may have moved, and the trend."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from lmeasure.io import files
from lmeasure.procedures import Cause, Checked, Closure, Trend, said
from lmeasure.report import html
from lmeasure.text import number, texts

FINE, FAILED = "#009e73", "#c1272d"


def write_check_page(
    path: Path, found: Checked, trend: Trend | None, *, inputs: Sequence[tuple[str, str]], language: str = "en", when: str = ""
) -> None:
    """Write a self-contained HTML page of the check, whole or not at all; inputs: files with their SHA-256."""
    words = texts(language, "interim")
    body = [
        html.paragraph(verdict(found, language), "verdict" if found.passed else "verdict bad"),
        html.paragraph(words["when"].format(when=_when(when), stops=len(found.stops), tests=len(found.closures))) if when else "",
        html.heading(words["closures"]),
        html.paragraph(words["closures.text"].format(limit=number(language, 100 * found.limit, ".2g"))),
        html.figure(closures_figure(found, language), "closures", first=True, language=language),
        html.table([words[f"column.{c}"] for c in ("kind", "name", "value", "u95", "probability")], _rows(found, language)),
        *_agreement(found, language),
    ]
    if trend is not None:
        body += [html.heading(words["trend"]), html.paragraph(words["trend.text"])]
        body.append(html.figure(trend_figure(trend, language), "trend", first=False, language=language))
    if found.notes:
        body += [html.heading(words["notes"]), *(html.paragraph(note) for note in said(found, language))]
    body += [html.heading(words["inputs"]), html.table((words["file"], "SHA-256"), inputs, "text hashes")]
    files.write_text(path, html.page(words["title"].format(rig=found.rig), body, language))


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
    """What may have changed, and by how much."""
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
    """Of what it is, in signs of every language and in one piece."""
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
    figure.update_xaxes(title=words["time"], **html.of_dates(language))
    return figure


def _agreement(found: Checked, language: str) -> list[str]:
    words, reported = texts(language, "interim"), found.agreement
    if reported is None:
        return []
    values = {
        "chi2": number(language, reported.chi_squared, ".4g"),
        "freedom": reported.freedom,
        "probability": _chance(language, reported.probability),
    }
    header = [words[f"column.{c}"] for c in ("cause", "size", "u", "detectable", "rest")]
    rows = [
        (
            words[f"cause.{c.kind}"].split("{")[0].strip() + f" {c.name}" if c.kind != "start" else words["start"],
            *(number(language, value, ".3g") + _unit(c, language) for value in (c.size, c.u, c.detectable)),
            number(language, c.rest, ".1f"),
        )
        for c in reported.causes
    ]
    return [
        html.heading(words["agreement"]),
        html.paragraph(words["agreement.text"].format(**values)),
        html.table(header, rows),
        html.paragraph(words["causes.text"]),
    ]
