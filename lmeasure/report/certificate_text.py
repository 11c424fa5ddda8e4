"""Contents of a certificate, as texts and tables in its language: the same for paper and for the screen. No arithmetic but rounding."""

import datetime
import math
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from lmeasure.certificate import chosen, gathered, halving, with_u95 as with_u95
from lmeasure.iso9283 import key_of, quantity_of
from lmeasure.report.text import unit, word
from lmeasure.text import Message, decimal, from_stated, number, numbers, sentence, settled, signs, texts

Rows = list[tuple[str, ...]]


def visible(value: object) -> str:
    """A text from outside with nothing hidden in it: control, direction and private characters are written as their numbers."""
    return "".join(c if c == "\n" or unicodedata.category(c)[0] != "C" else f"\\u{{{ord(c):X}}}" for c in str(value))


def title(certificate: dict[str, Any]) -> str:
    """A certificate only where the user states accreditation, else a test report."""
    return word(certificate["language"], "title.accredited" if "accreditation" in certificate["details"] else "title")


def about(certificate: dict[str, Any]) -> Rows:
    """Return the information that ISO/IEC 17025 requires besides results. Missing statements are named in one row, or in a row each if the
    details request it."""
    language, details = certificate["language"], certificate["details"]

    def stated(*path: str) -> str | None:
        here: Any = details
        for key in path:
            here = here.get(key) if isinstance(here, dict) else None
        return None if here is None else visible(here)

    def row(key: str, value: str | None) -> tuple[str, str]:
        return word(language, key), value if value is not None else word(language, "not_stated")

    measured = [d for d in (stated("dates", "measured_from"), stated("dates", "measured_to")) if d is not None]
    rows: Rows = [
        row("id", certificate["id"]),
        *([row("number", stated("number"))] if "number" in details else []),
        row("created", moment(certificate["created"])),
        row("laboratory", stated("laboratory", "name")),
        row("laboratory.address", stated("laboratory", "address")),
        row("laboratory.contact", stated("laboratory", "contact")),
        row("location", stated("location")),
        row("customer", stated("customer", "name")),
        row("customer.address", stated("customer", "address")),
        row("customer.contact", stated("customer", "contact")),
        *(row(f"item.{key}", stated("item", key)) for key in ("maker", "model", "serial", "controller")),
        *([row("item.description", stated("item", "description"))] if stated("item", "description") else []),
        row("item.condition", stated("item", "condition")),
        row("dates.received", stated("dates", "received")),
        row("dates.measured", " – ".join(dict.fromkeys(measured)) or None),
        row("dates.issued", stated("dates", "issued")),
        row("method", stated("method") or word(language, "method.default")),
        row("deviations", stated("deviations")),
        row("sampling", stated("sampling")),
        row("conditions", _conditions(language, details.get("conditions", {}))),
        row("traceability", stated("traceability")),
        *([row(key, stated(key)) for key in ("supplied", "external", "remarks") if key in details]),
        row("authoriser", ", ".join(t for t in (stated("authoriser", "name"), stated("authoriser", "role")) if t) or None),
    ]
    if "accreditation" in details:
        reported = [stated("accreditation", key) or "" for key in ("statement", "body", "number")]
        rows.append(row("accreditation", "; ".join(reported)))
    if details.get("show_not_stated"):
        return rows
    missing = word(language, "not_stated")
    lacking = [key for key, value in rows if value == missing]
    rows = [row for row in rows if row[1] != missing]
    return [*rows, (missing, "; ".join(lacking))] if lacking else rows


def authoriser(certificate: dict[str, Any]) -> str:
    """Return the person responsible for the report, or that none is stated."""
    stated = certificate["details"].get("authoriser", {})
    reported = ", ".join(visible(stated[key]) for key in ("name", "role") if key in stated)
    return reported or word(certificate["language"], "not_stated")


def instrument(certificate: dict[str, Any]) -> list[str]:
    """The instrument in words: cables, encoders, calibration, zone. Certificates sealed before do not describe it."""
    language, reported = certificate["language"], certificate.get("measured_with")
    limit = certificate["settings"].get("limit_angle_deg")
    if reported is None:
        return [word(language, "instrument.file" if certificate["instrument"] is None else "instrument.undescribed")]

    def rounded(values: list[float]) -> str:
        return " \u2026 ".join(dict.fromkeys(number(language, v, ".4g") for v in (values[0], values[-1])))

    encoders = {"counts": rounded(reported["counts_per_revolution"]), "length": rounded(reported["count_length_mm"])}
    passes = [] if reported["passes"] == 1 else [word(language, "instrument.passes", passes=reported["passes"])]
    lines = [word(language, "instrument.cables", cables=reported["cables"], points=reported["observation_points"]), *passes]
    lines.append(word(language, "instrument.encoders", **encoders))
    record = reported["calibration"]
    if record is None:
        lines.append(word(language, "instrument.uncalibrated"))
    else:
        rms = record["residual_rms_mm"]
        residuals = "" if rms is None else word(language, "instrument.residuals", rms=number(language, rms, ".2g"))
        lines.append(word(language, "instrument.calibrated", poses=record["reference_poses"]) + residuals)
    if limit is not None and reported["worst_pressure_angle_deg"] is not None:
        angles = {"limit": f"{limit:g}", "largest": f"{reported['worst_pressure_angle_deg']:.1f}"}
        lines.append(word(language, "instrument.zone", **{k: decimal(language, v) for k, v in angles.items()}))
    return lines


def moment(created: str) -> str:
    """The moment of creation for a person, to the second."""
    return f"{datetime.datetime.fromisoformat(created):%Y-%m-%d %H:%M:%S} UTC"


def _conditions(language: str, conditions: dict[str, Any]) -> str | None:
    parts = []
    if "temperature_c" in conditions:
        spread = f" ± {conditions['temperature_range_c']:g}" if "temperature_range_c" in conditions else ""
        temperature = decimal(language, f"{conditions['temperature_c']:g}{spread}")
        parts.append(f"{word(language, 'conditions.temperature')} {temperature} °C")
    if "humidity_percent" in conditions:
        humidity = number(language, conditions["humidity_percent"], "g")
        parts.append(f"{word(language, 'conditions.humidity')} {humidity} %")
    if "text" in conditions:
        parts.append(visible(conditions["text"]))
    return "; ".join(parts) or None


def part_of(language: str, figure: Mapping[str, Any]) -> str:
    """Return the part of a pose or path, such as a corner; empty for the whole."""
    part = str(figure.get("part") or "")
    corner = part.removeprefix("corner ")
    return word(language, "part.corner", number=corner) if corner != part and corner.isdecimal() else visible(part)


def characteristic_name(language: str, name: str) -> str:
    """Return the name of a characteristic such as AP_x, with its component; empty where no installed package knows it."""
    known = quantity_of(name)
    if known is None:
        return ""
    own = texts(language, "certificate").get(f"name.{known.symbol}") or known.labels.get(language, known.label)
    of = component(language, name)
    return f"{own}, {of}" if of and name.partition("_")[2] not in WHOLE else own


WHOLE = ("p", "l")
"""Indices for the whole, without a component."""


def component(language: str, name: str) -> str:
    """Return the component of a characteristic in words, such as along X for AP_x; empty where it has none."""
    return texts(language, "certificate").get(f"component.{name.partition('_')[2]}", "")


def symbol_pieces(name: str) -> list[tuple[str, str]]:
    """Return a characteristic's name as `with_indices` does: AP_p is AP with the index p."""
    stem, _, index = name.partition("_")
    return [(stem, index)]


class Result(NamedTuple):
    """A characteristic as it is printed: symbol such as AP_p, name in words, its component alone, numbers
    and verdicts; empty where there is nothing."""

    symbol: str
    name: str
    component: str
    clause: str
    value: str
    u95: str
    unit: str
    cycles: str
    k: str
    verdict: str
    limits: str
    conformity: str


def result(certificate: dict[str, Any], figure: Mapping[str, Any]) -> Result:
    """A figure of the certificate as it is printed, its value never without its U95 and its verdict."""
    language = certificate["language"]
    stated = figure["u95"] is not None
    value, u95 = with_u95(float(figure["value"]), float(figure["u95"])) if stated else (f"{settled(figure['value']):.6g}", "")
    name = characteristic_name(language, str(figure["name"]))
    extension = f"({word(language, 'extension')})" if figure.get("extension") else ""
    part = part_of(language, figure)
    k = figure.get("coverage_factor")
    of = component(language, str(figure["name"]))
    full, short = (" ".join(filter(None, (", ".join(filter(None, (own, part))), extension))) for own in (name, of))
    return Result(
        symbol=visible(figure["name"]),
        name=full,
        component=short,
        clause=visible(figure.get("clause", "")),
        value=decimal(language, value),
        u95=f"±\u00a0{decimal(language, u95)}" if stated else "",
        unit=unit(language, visible(figure["unit"])),
        cycles=str(figure.get("cycles", "")),
        k="" if k is None else number(language, k, ".2f"),
        verdict=verdict(language, figure),
        **dict(
            zip(("limits", "conformity"), tolerance(language, figure.get("conformity"), name_rule=len(rules(certificate)) > 1), strict=True)
        ),
    )


class ResultTable(NamedTuple):
    """The results of one test of the standard: its heading, and each figure with its pose or path."""

    title: str
    rows: list[tuple[str, Result]]


def results(certificate: dict[str, Any]) -> list[ResultTable]:
    """Return all figures, by test: clause and quantity."""
    language, out = certificate["language"], dict[tuple[str, str], ResultTable]()
    for figure in certificate["characteristics"]:
        known = quantity_of(str(figure["name"]))
        symbol = str(figure["name"]).partition("_")[0] if known is None else known.symbol
        clause = visible(figure.get("clause", ""))
        if (clause, symbol) not in out:
            own = "" if known is None else texts(language, "certificate").get(f"name.{symbol}") or known.labels.get(language, known.label)
            name = own[:1].upper() + own[1:]
            out[clause, symbol] = ResultTable(" ".join(t for t in (clause, name, symbol.partition("_")[0]) if t), [])
        out[clause, symbol].rows.append((place_of(language, figure), result(certificate, figure)))
    return list(out.values())


def outcome(certificate: dict[str, Any]) -> tuple[str, str]:
    """Return state and sentence of pass or fail against the stated tolerances."""
    language = certificate["language"]
    held = [f["conformity"]["verdict"] for f in certificate["characteristics"] if "conformity" in f and not f.get("excluded")]
    counts = {"number": len(held), "failed": held.count("does not conform"), "open": held.count("not decided")}
    if not held:
        return "", word(language, "outcome.none")
    if counts["failed"]:
        return "bad", word(language, "outcome.fail", **counts)
    return ("warn", word(language, "outcome.open", **counts)) if counts["open"] else ("good", word(language, "outcome.pass", **counts))


def load_and_speed(certificate: dict[str, Any]) -> tuple[str, str]:
    """Return the loads and the speeds of the program; empty where none is stated."""
    language, program = certificate["language"], certificate["program"]
    parts = [*program["pose"], *program["path"]]

    def joined(values: Iterable[float | None], sign: str) -> str:
        known = sorted({v for v in values if v is not None})
        ends = dict.fromkeys(number(language, v, "g") for v in (known[0], known[-1])) if known else ()
        return " … ".join(ends) + f"\u00a0{unit(language, sign)}" if known else ""

    loads = joined((part.get("load_kg", program.get("load_kg")) for part in parts), "kg")
    speeds = joined((part.get("speed_percent") for part in parts), "%"), joined((part.get("speed_mm_s") for part in parts), "mm/s")
    return loads, ", ".join(filter(None, speeds))


def left_out(certificate: dict[str, Any]) -> str:
    """Return the assumed part of U95 and the statement that would help most; empty if all is stated."""
    every = (from_stated(e) for e in certificate.get("findings", ()))
    found = [m.text(certificate["language"]) for m in every if m is not None and m.code.startswith("assumed.")]
    text = "; ".join(found[:2])
    return text and f"{text[0].upper()}{text[1:]}."


def verdict(language: str, figure: Mapping[str, Any]) -> str:
    """Return whether U95 is small enough for a verdict; for a component also its own verdict, if different."""
    if figure.get("excluded"):
        return word(language, "excluded")
    if figure["capable"] is None:
        return word(language, "no_verdict")
    reported = word(language, "capable" if figure["capable"] else "not_capable")
    alone = figure.get("capable_alone", figure["capable"])
    return reported if alone == figure["capable"] else f"{reported}; {word(language, 'alone_capable' if alone else 'alone_not_capable')}"


def rules(certificate: dict[str, Any]) -> set[str]:
    """The rules of decision that occur."""
    return {c["conformity"]["rule"] for c in certificate["characteristics"] if "conformity" in c}


def tolerance(language: str, conformity: dict[str, Any] | None, *, name_rule: bool) -> tuple[str, str]:
    """Return limits and the decision on them, with the rule if there are several."""
    if not conformity:
        return "", ""
    lower, upper = conformity.get("lower"), conformity.get("upper")
    limits = (
        f"{lower:g} … {upper:g}"
        if lower is not None and upper is not None
        else f"≥\u00a0{lower:g}"
        if upper is None
        else f"≤\u00a0{upper:g}"
    )
    rule = f", {word(language, 'rule.' + conformity['rule'])}" if name_rule else ""
    probability = decimal(language, _percent(conformity["probability"]))
    return decimal(language, limits), f"{word(language, conformity['verdict'].replace(' ', '_'))} ({probability}{rule})"


def _percent(probability: float) -> str:
    """A probability that is never rounded to certainty."""
    if probability >= 0.9995:
        return ">\u00a099.9\u00a0%"
    return "<\u00a00.1\u00a0%" if probability < 0.0005 else f"{100 * probability:.1f}\u00a0%"


def place_of(language: str, figure: Mapping[str, Any]) -> str:
    """The pose or path of a figure, with its kind: pose P1."""
    for kind in ("pose", "path"):
        if figure.get(kind) is not None:
            known = quantity_of(str(figure["name"]))
            named = (known and known.between) or kind
            return f"{word(language, f'kind.{named}')} {visible(figure[kind])}"
    return word(language, "kind.program")


def commanded(certificate: dict[str, Any]) -> Rows:
    """Return the commands of the program's poses and paths, with speed and load."""
    language, program = certificate["language"], certificate["program"]
    rows: Rows = []
    for kind, reported in (("pose", _commanded_pose), ("path", _commanded_path)):
        for part in program[kind]:
            percent = f"{part['speed_percent']:g}\u00a0%" if "speed_percent" in part else ""
            speed = f"{part['speed_mm_s']:g}\u00a0{unit(language, 'mm/s')}" if "speed_mm_s" in part else ""
            load = part.get("load_kg", program["load_kg"])
            loaded = "" if load is None else decimal(language, f"{load:g}\u00a0{unit(language, 'kg')}")
            said = [texts(language)["number.between"].join(decimal(language, s) for s in (speed, percent) if s), loaded]
            name = f"{word(language, f'kind.{kind}')} {visible(part['name'])}"
            rows.append((name, reported(language, part), *(s or word(language, "not_stated") for s in said)))
    return rows


def _commanded_pose(language: str, pose: dict[str, Any]) -> str:
    return word(
        language, "commanded.pose", position=_seven(language, pose["position_mm"]), quaternion=_seven(language, pose["quaternion_xyzw"])
    )


def _commanded_path(language: str, path: dict[str, Any]) -> str:
    def at(value: list[float]) -> str:
        return f"({_seven(language, value)})"

    kind = path["kind"]
    if kind == "linear":
        said = {"start": at(path["start_mm"]), "end": at(path["end_mm"])}
    elif kind == "circular":
        said = {"centre": at(path["centre_mm"]), "radius": number(language, path["radius_mm"], "g"), "start": at(path["start_mm"])}
    elif kind == "rectangular":
        said = {"corners": ", ".join(map(at, path["corners_mm"]))}
    else:
        said = {"count": str(len(path["points_mm"])), "start": at(path["points_mm"][0]), "end": at(path["points_mm"][-1])}
    parts = [word(language, f"commanded.{kind}", **said)]
    if "end_quaternion_xyzw" in path:
        parts.append(word(language, "commanded.turning"))
    if "weave_stroke_mm" in path:
        said = {key: number(language, path[f"weave_{key}_mm"], "g") for key in ("stroke", "distance")}
        parts.append(word(language, "commanded.weave", **said))
    return "; ".join(parts)


def _seven(language: str, values: list[float]) -> str:
    return numbers(language, values, ".7g")


def commanded_header(language: str) -> tuple[str, ...]:
    """Return the header of the table of commands."""
    return tuple(word(language, f"column.{key}") for key in ("part", "commanded", "speed", "load"))


def excluded(certificate: dict[str, Any]) -> Rows:
    """Parts without a verdict, and why."""
    language = certificate["language"]
    out: Rows = []
    for part in certificate["excluded"]:
        kind = word(language, f"kind.{part['kind']}") if part["kind"] in ("pose", "path") else visible(part["kind"])
        out.append((f"{kind} {visible(part['name'])}", phrase(certificate, part["reason"])))
    return out


def uncertainty(certificate: dict[str, Any]) -> list[str]:
    """Return the meaning of U95 and the verdicts."""
    language, settings = certificate["language"], certificate["settings"]
    covers = phrase(certificate, certificate["uncertainty_covers"])
    out = [
        word(language, "uncertainty.u95", covers=covers),
        word(language, "uncertainty.k"),
        word(language, "uncertainty.capable", percent=number(language, 100 * settings["capability"], "g")),
        word(language, "uncertainty.signed"),
    ]
    out += [word(language, f"uncertainty.{rule}") for rule in ("simple", "guarded") if rule in rules(certificate)]
    out += [line for line in (left_out(certificate),) if line]
    if rules(certificate):
        out.append(word(language, "conformity.percent"))
    if settings.get("limit_angle_deg") is not None:
        out.append(word(language, "zone.angle", limit=number(language, settings["limit_angle_deg"], "g")))
    if settings.get("limit_u95_mm") is not None:
        out.append(word(language, "zone.u95", limit=number(language, settings["limit_u95_mm"], "g")))
    return out


def notes(certificate: dict[str, Any]) -> list[str]:
    """Return remarks for the reader: frame, point, angles, data, and notes of the computation."""
    language, settings = certificate["language"], certificate["settings"]
    figures, instrument, span = certificate["characteristics"], certificate["instrument"], certificate["trajectory"]
    frame = certificate["base_from_program"]
    out = [
        word(
            language,
            "samples",
            samples=span["samples"],
            ok=span["ok"],
            **{k: number(language, span[f"{k}_s"], "g") for k in ("start", "end")},
        ),
        word(language, "no_run" if instrument is None else "with_run"),
    ]
    if instrument is not None and not instrument["calibrated"]:
        out.append(word(language, "calibration.none"))
    if instrument is not None and instrument["assumed"]:
        out.append(word(language, "assumed", names=", ".join(map(visible, instrument["assumed"]))))
    if frame is None:
        out.append(word(language, "frame.none"))
    else:
        out.append(word(language, "frame.fitted", frame=f"[{numbers(language, frame, '.9g')}]"))
    if any(settings["tool_offset_mm"]):
        out.append(word(language, "tool_offset", offset=numbers(language, settings["tool_offset_mm"], "g")))
    if any(c.get("angles") for c in figures):
        out.append(word(language, "angles", angles=visible(certificate["angles"])))
    if any(c.get("extension") for c in figures):
        out.append(word(language, "extension.text"))
    out += [visible(signs(sentence(_finding(certificate, note), language))) for note in certificate["notes"]]
    # the origin of a component's verdict is stated once
    codes = {entry["text"]: entry["code"] for entry in certificate.get("findings", [])}
    own = [c for c in figures if c.get("note") and codes.get(c["note"]) != "verdict.of_vector"]
    for c in own:
        part = f" {part_of(language, c)}" if c.get("part") else ""
        out.append(f"{visible(c['name'])}{part}, {place_of(language, c)}: {phrase(certificate, c['note'])}")
    return list(dict.fromkeys(out))


def phrase(certificate: dict[str, Any], text: str) -> str:
    """Return a text of the computation in the certificate's language by the id that the certificate has for it, else as it is."""
    found = _finding(certificate, text)
    return visible(signs(found.text(certificate["language"]) if isinstance(found, Message) else found))


def _finding(certificate: dict[str, Any], text: str) -> str:
    entry = next((e for e in certificate.get("findings", []) if e["text"] == text), None)
    return text if entry is None else from_stated(entry) or text


class Budget(NamedTuple):
    """The budget of a result: its heading, rows by size, and lines under them."""

    title: str
    rows: Rows
    lines: list[str]


LEAST_SHOWN = 0.01
"""Part of u below which contributions have an empty cell."""
BUDGET = ("source", "estimate", "u", "distribution", "sensitivity", "freedom", "contribution", "share")


def budget_header(language: str) -> tuple[str, ...]:
    """Header of a budget."""
    return tuple(word(language, f"budget.{key}") for key in BUDGET)


def budgets(certificate: dict[str, Any]) -> list[Budget]:
    """Return the budgets of the results that matter most."""
    return [_budget(certificate, one.figure) for one in chosen(certificate) if one.figure.get("budget")]


def _budget(certificate: dict[str, Any], figure: Mapping[str, Any]) -> Budget:
    language, found = certificate["language"], gathered(figure["budget"])
    of_result = unit(language, visible(figure["unit"]))

    def short(value: float | None, sign: str = "") -> str:
        return "\u221e" if value is None else f"{number(language, value, '.3g')}\u00a0{unit(language, sign)}".rstrip("\u00a0")

    rows: Rows = [
        (phrase(certificate, row["source"]), short(row["value"]), short(row["u"], row["unit"] or "sd"),
         word(language, f"distribution.{row['distribution']}"), short(row["sensitivity"]), short(row["degrees_of_freedom"]),
         short(row["contribution"], of_result), number(language, row["share_percent"], ".1f"))
        for row in found.rows
    ]  # fmt: skip
    if found.small:
        size, share = found.together
        name = word(language, "budget.small", number=len(found.small))
        rows.append((name, "", "", "", "", "", short(size, of_result), number(language, share, ".2g")))
    rows.append(
        (word(language, "budget.sum"), "", "", "", "", short(figure.get("degrees_of_freedom")), short(figure["u"], of_result), "100")
    )
    shown = result(certificate, figure)
    values = {"u": short(figure["u"], of_result), "k": shown.k, "u95": f"{shown.u95}\u00a0{shown.unit}"}
    lines = [word(language, "budget.expanded", **values)]
    if "u_drawn" in figure:
        lines.append(word(language, "budget.drawn", u=short(figure["u_drawn"], of_result), bias=short(figure["bias"], of_result)))
    sources, factor = halving(figure["budget"])
    if sources:
        names = ", ".join(phrase(certificate, name) for name in sources)
        lines.append(word(language, "budget.halve", sources=names, factor=number(language, factor, ".2g")))
    return Budget(", ".join((f"{shown.symbol} {shown.name}", place_of(language, figure))), rows, lines)


def largest_source(certificate: dict[str, Any], figure: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """Return the largest source of a result's uncertainty in a sentence."""
    values = {"name": result(certificate, figure).name, "source": phrase(certificate, row["source"])}
    return word(certificate["language"], "limited.source", **values, share=number(certificate["language"], row["share_percent"], ".0f"))


def contributions(certificate: dict[str, Any]) -> tuple[tuple[str, ...], Rows, list[str]]:
    """Return the contribution of each source to each result: header, rows, and the sources behind the numbers of the columns."""
    language = certificate["language"]
    figures = [f for f in certificate["characteristics"] if f.get("budget")]
    sources = list(dict.fromkeys(row["source"] for f in figures for row in f["budget"]))
    rows: Rows = []
    for f in figures:
        name = " ".join(filter(None, (visible(f["name"]), place_of(language, f), part_of(language, f))))
        size = [math.hypot(*(row["contribution"] for row in f["budget"] if row["source"] == s)) for s in sources]
        shown = (number(language, v, ".2g") if v >= LEAST_SHOWN * f["u"] else "" for v in size)
        rows.append((f"{name}, {unit(language, visible(f['unit']))}", number(language, f["u"], ".2g"), *shown))
    header = (word(language, "column.characteristic"), "u", *(str(i) for i in range(1, len(sources) + 1)))
    named = [f"{i}: {phrase(certificate, s)}" for i, s in enumerate(sources, 1)]
    return header, rows, [*named, word(language, "contributions.small", percent=f"{100 * LEAST_SHOWN:g}")]


def correlations(certificate: dict[str, Any]) -> tuple[tuple[str, ...], Rows]:
    """Return the correlations between the results that matter most: header and rows; empty where they are not known."""
    found, language = certificate.get("correlations") or {"results": []}, certificate["language"]
    places = {str(key_of(f)): f"{visible(f['name'])} {place_of(language, f)}" for f in certificate["characteristics"]}
    names = [places.get(name, visible(name)) for name in found["results"]]
    if len(names) < 2:
        return (), []
    rows = [(name, *(number(language, v + 0.0, ".2f") for v in row)) for name, row in zip(names, found["coefficients"], strict=True)]
    return ("", *names), rows


def statements(certificate: dict[str, Any]) -> list[str]:
    """Return statements that every report must contain."""
    language = certificate["language"]
    out = [word(language, "only_item"), word(language, "in_full")]
    return out if "accreditation" in certificate["details"] else [*out, word(language, "not_accredited")]


def inputs(certificate: dict[str, Any]) -> Rows:
    """Files with their digests."""
    return [(visible(entry["file"]), visible(entry["sha256"])) for entry in certificate["inputs"]]


def program(certificate: dict[str, Any]) -> str:
    """Versions in one line."""
    words = texts(certificate["language"], "certificate")
    named = ((words.get(f"environment.{key}", visible(key)), visible(value)) for key, value in certificate["environment"].items())
    return "; ".join(f"{key} {value}" for key, value in named)
