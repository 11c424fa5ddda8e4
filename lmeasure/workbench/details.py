"""Details of a certificate besides its results, as a form: lamps for missing statements of ISO/IEC 17025, and the printed form in both
languages."""

import copy
import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lmeasure.certificate import SCHEMA, Details
from lmeasure.core import LMeasureError
from lmeasure.io import checked, files
from lmeasure.report import about, title, word
from lmeasure.text import faults
from lmeasure.workbench.text import said


class Entry(NamedTuple):
    """A field: its key in the file; its row of the certificate, empty for an optional one; its name if that row has several; its kind:
    text, day, number, long."""

    key: str
    row: str
    label: str = ""
    kind: str = "text"


FORM = {
    "workbench.laboratory": (
        Entry("number", "", "workbench.number_report"),
        Entry("laboratory.name", "laboratory"),
        Entry("laboratory.address", "laboratory.address", kind="long"),
        Entry("laboratory.contact", "laboratory.contact"),
        Entry("location", "location"),
        Entry("logo", "", "workbench.picture_mark_svg_png"),
    ),
    "workbench.customer": (
        Entry("customer.name", "customer"),
        Entry("customer.address", "customer.address", kind="long"),
        Entry("customer.contact", "customer.contact"),
    ),
    "workbench.robot_under_test": (
        Entry("item.maker", "item.maker", "workbench.maker"),
        Entry("item.model", "item.model"),
        Entry("item.serial", "item.serial"),
        Entry("item.controller", "item.controller"),
        Entry("item.condition", "item.condition", kind="long"),
        Entry("item.description", "", "workbench.anything_else_known"),
    ),
    "workbench.days": (
        Entry("dates.received", "dates.received", "workbench.day_receipt", "day"),
        Entry("dates.measured_from", "dates.measured", "workbench.first_day_measuring", "day"),
        Entry("dates.measured_to", "dates.measured", "workbench.last_day_measuring", "day"),
        Entry("dates.issued", "dates.issued", "workbench.day_issue", "day"),
    ),
    "workbench.method_conditions": (
        Entry("method", "", "workbench.method_where_not_iso"),
        Entry("deviations", "deviations", kind="long"),
        Entry("sampling", "sampling", kind="long"),
        Entry("traceability", "traceability", kind="long"),
        Entry("conditions.temperature_c", "conditions", "workbench.temperature_c", "number"),
        Entry("conditions.temperature_range_c", "conditions", "workbench.largest_less_smallest_temperature", "number"),
        Entry("conditions.humidity_percent", "conditions", "workbench.relative_humidity", "number"),
        Entry("conditions.text", "conditions", "workbench.other_conditions"),
        Entry("supplied", "", "workbench.customer_supplied", "long"),
        Entry("external", "", "workbench.results_from_others", "long"),
        Entry("remarks", "", "workbench.remarks", "long"),
    ),
    "workbench.who_answers": (
        Entry("authoriser.name", "authoriser", "workbench.name"),
        Entry("authoriser.role", "authoriser", "workbench.function"),
    ),
    "workbench.accreditation_only_accredited_laboratory": (
        Entry("accreditation.statement", "", "workbench.statement"),
        Entry("accreditation.body", "", "workbench.accreditation_body"),
        Entry("accreditation.number", "", "workbench.registration_number"),
    ),
}
ENTRIES = tuple(entry for entries in FORM.values() for entry in entries)


def label(entry: Entry, language: str) -> str:
    """Return the name of a field: as its row of the certificate, where it alone fills that."""
    text = said(language, entry.label) if entry.label else word(language, entry.row)
    return text[:1].upper() + text[1:]


def read(path: Path) -> dict[str, str]:
    """The texts of the fields of a details file, empty where there is none."""
    content: Any = files.read_toml(path) if path.is_file() else {}
    return {entry.key: _text(_at(content, entry.key)) for entry in ENTRIES}


def _at(content: Any, key: str) -> Any:
    for name in key.split("."):
        content = content.get(name) if isinstance(content, Mapping) else None
    return content


def _text(value: Any) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def filled(before: Mapping[str, Any], form: Mapping[str, str]) -> dict[str, Any]:
    """Return the content of a file with the form's values; keys without a field stay, emptied ones go."""
    content = {"schema": SCHEMA, **copy.deepcopy(dict(before))}
    for entry in ENTRIES:
        text, (*tables, name) = form.get(entry.key, "").replace("\r\n", "\n").strip(), entry.key.split(".")
        here = content
        for table in tables:
            here = here.setdefault(table, {})
        here.pop(name, None) if not text else here.update({name: _value(text, entry, here.get(name))})
    return {key: value for key, value in content.items() if value != {}}


def _value(text: str, entry: Entry, before: Any) -> Any:
    if before is not None and _text(before) == text:
        return before
    if entry.kind != "number":
        return text
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return text


def complaints(content: Mapping[str, Any], name: str) -> list[str]:
    """Return all faults of a content as a details file."""
    try:
        checked(dict(content), Details, name)
    except LMeasureError as error:
        return list(faults(error))
    return []


def missing(content: Mapping[str, Any]) -> list[str]:
    """Return rows that ISO/IEC 17025:2017, 7.8.2 requires and nothing fills."""
    rows = dict.fromkeys(entry.row for entry in ENTRIES if entry.row)
    return [row for row in rows if all(_at(content, entry.key) in (None, "") for entry in ENTRIES if entry.row == row)]


def printed(content: Mapping[str, Any], language: str) -> tuple[str, list[tuple[str, ...]]]:
    """Title and rows as a certificate with these details has them; its number and moment are those of now."""
    details = {**checked(dict(content), Details, "details").stated(), "show_not_stated": True}
    now = datetime.datetime.now(datetime.UTC).isoformat()
    certificate = {"language": language, "details": details, "id": "LM-…", "created": now}
    return title(certificate), about(certificate)
