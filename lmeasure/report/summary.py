"""Summary of a certificate at a glance: the results that matter most, chosen from certificate.json, never computed."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from lmeasure.certificate import chosen, gathered
from lmeasure.report import certificate_text as say
from lmeasure.report.text import word


def sentence(certificate: dict[str, Any]) -> str:
    """Return the result in one sentence: the worst of the first two most informative names, with speed and load."""
    language, found = certificate["language"], chosen(certificate)[:2]
    if not found:
        return word(language, "no_results")
    parts: list[str] = []
    for one in found:
        shown = say.result(certificate, one.figure)
        values = {"name": shown.name, "value": value_of(shown), "place": say.place_of(language, one.figure)}
        part = word(language, "sentence.worst" if one.of > 1 and not parts else "sentence.other", **values)
        parts.append(part if one.figure["capable"] is not False else f"{part} ({word(language, 'not_capable')})")
    load, speed = say.load_and_speed(certificate)
    text = ", ".join([*parts, *([word(language, "sentence.speed", speed=speed)] if speed else []), *([load] if load else [])])
    return f"{text[:1].upper()}{text[1:]}."


class Glance(NamedTuple):
    """A certificate in three lines: the worst value of the most informative result, its part, and the outcome against the stated tolerances
    with its state (good, warn, bad, or empty without any)."""

    value: str
    about: str
    state: str
    outcome: str


def glance(certificate: Mapping[str, Any], language: str) -> Glance:
    """Return one certificate for a list, in a language of its own."""
    own = {**certificate, "language": language}
    state, outcome = say.outcome(own)
    if not (found := chosen(own)[:1]):
        return Glance("\u2013", word(language, "no_results"), state, outcome)
    shown = say.result(own, found[0].figure)
    about = ", ".join((shown.name, say.place_of(language, found[0].figure), *([robot(own)] if own["details"].get("item") else [])))
    return Glance(value_of(shown), about, state, outcome)


def value_of(result: say.Result) -> str:
    """Return a value with its U95 and unit, in one piece."""
    return "\u00a0".join(t for t in (result.value, result.u95, result.unit) if t)


def limits(certificate: dict[str, Any]) -> str:
    """Return the largest source of the first result's uncertainty, and sources that U95 omits."""
    language, found = certificate["language"], chosen(certificate)[:1]
    parts: list[str] = []
    if found and found[0].figure["u95"] is None:
        parts.append(word(language, "limited.unknown"))
    elif found:
        largest = gathered(found[0].figure["budget"]).rows[:1] if found[0].figure.get("budget") else []
        parts += [say.largest_source(certificate, found[0].figure, row) for row in largest]
    return " ".join([*parts, *filter(None, [say.left_out(certificate)])])


def counted(certificate: Mapping[str, Any]) -> list[str]:
    """Return how many figures there are, how many have U95 small enough for a verdict, and how many keep their tolerances."""
    language, figures = certificate["language"], certificate["characteristics"]
    lines = [word(language, "counted", figures=len(figures), capable=sum(bool(f["capable"]) for f in figures))]
    held = [f["conformity"]["verdict"] for f in figures if "conformity" in f]
    if held:
        counts = ((v, held.count(v)) for v in ("conforms", "does not conform", "not decided"))
        shown = ", ".join(f"{word(language, v.replace(' ', '_'))}: {n}" for v, n in counts if n)
        lines.append(word(language, "tolerances_counted", number=len(held), reported=shown))
    return lines


def robot(certificate: Mapping[str, Any]) -> str:
    """The robot in a few words, as far as the details state it."""
    item = certificate["details"].get("item", {})
    parts = [say.visible(item[key]) for key in ("maker", "model", "description") if key in item]
    if "serial" in item:
        parts.append(f"{word(certificate['language'], 'item.serial')} {say.visible(item['serial'])}")
    return ", ".join(parts) or word(certificate["language"], "not_stated")


def facts(certificate: dict[str, Any]) -> say.Rows:
    """Return (name, value): robot, laboratory, customer, date, program and instrument; customer and laboratory if stated."""
    language, details = certificate["language"], certificate["details"]
    dates = details.get("dates", {})
    measured = " \u2013 ".join(dict.fromkeys(dates[k] for k in ("measured_from", "measured_to") if k in dates))
    rows: say.Rows = [(word(language, "summary.robot"), robot(certificate))]
    rows += [(word(language, k), say.visible(details[k]["name"])) for k in ("laboratory", "customer") if details.get(k, {}).get("name")]
    rows.append(
        (word(language, "dates.measured"), measured) if measured else (word(language, "created"), say.moment(certificate["created"]))
    )
    load, speed = (text or word(language, "not_stated") for text in say.load_and_speed(certificate))
    rows += [(word(language, "column.load"), load), (word(language, "column.speed"), speed)]
    program = certificate["program"]
    rows.append(
        (word(language, "summary.commanded"), word(language, "summary.program", poses=len(program["pose"]), paths=len(program["path"])))
    )
    rows.append((word(language, "summary.instrument"), "; ".join(say.instrument(certificate))))
    return rows
