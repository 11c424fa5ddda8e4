"""The certificate as a digital calibration certificate, DCC 3.3.0 (PTB), with D-SI values.

The schema belongs to its makers and is not part of this program: you name the XSD file by which the XML is checked.
"""

import calendar
import datetime
import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from lmeasure.core import CertificationError, FileFormatError
from lmeasure.io import files
from lmeasure.text import Message, message

DCC = "https://ptb.de/dcc"
SI = "https://ptb.de/si"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
VERSION = "3.3.0"
UNITS = {
    "mm": r"\milli\metre", "deg": r"\degree", "rad": r"\radian", "s": r"\second", "ms": r"\milli\second", "%": r"\percent", "Hz": r"\hertz",
    "mm/s": r"\milli\metre\second\tothe{-1}", "mm/N": r"\milli\metre\newton\tothe{-1}",
}  # fmt: skip
COUNTRIES = (
    "AD AE AF AG AI AL AM AO AQ AR AS AT AU AW AX AZ BA BB BD BE BF BG BH BI BJ BL BM BN BO BQ BR BS BT BV BW BY BZ CA CC CD "
    "CF CG CH CI CK CL CM CN CO CR CU CV CW CX CY CZ DE DJ DK DM DO DZ EC EE EG EH ER ES ET FI FJ FK FM FO FR GA GB GD GE GF "
    "GG GH GI GL GM GN GP GQ GR GS GT GU GW GY HK HM HN HR HT HU ID IE IL IM IN IO IQ IR IS IT JE JM JO JP KE KG KH KI KM KN "
    "KP KR KW KY KZ LA LB LC LI LK LR LS LT LU LV LY MA MC MD ME MF MG MH MK ML MM MN MO MP MQ MR MS MT MU MV MW MX MY MZ NA "
    "NC NE NF NG NI NL NO NP NR NU NZ OM PA PE PF PG PH PK PL PM PN PR PS PT PW PY QA RE RO RS RU RW SA SB SC SD SE SG SH SI "
    "SJ SK SL SM SN SO SR SS ST SV SX SY SZ TC TD TF TG TH TJ TK TL TM TN TO TR TT TV TW TZ UA UG UM US UY UZ VA VC VE VG VI "
    "VN VU WF WS YE YT ZA ZM ZW "
)
"""Codes of ISO 3166-1."""
NOT_STATED = "not stated"
VERDICTS = {True: "U95 small enough", False: "no verdict (uncertainty)", None: "no verdict (no uncertainty is stated)"}
"""Verdicts as printed on the certificate, by whether U95 is small enough for a result; None: no U95 is stated."""
OWN = "en"
"""Language of this module's own texts; texts of the laboratory have no language, since none is stated."""


def dcc_xml(certificate: dict[str, Any], xsd: Path | None = None) -> bytes:
    """Return the bytes of the XML.

    Raises
    ------
    CertificationError
        If no country is stated, or with the first line that does not keep to the XSD.
    FileFormatError
        If the XSD cannot be read.
    """
    country = certificate["details"].get("country")
    if country not in COUNTRIES.split():
        found = "country is missing" if country is None else f"country = {country!r} is no code"
        raise CertificationError(message("error.details_a_dcc_needs", found=found))
    root = etree.Element(f"{{{DCC}}}digitalCalibrationCertificate", nsmap={"dcc": DCC, "si": SI, "xsi": XSI})
    root.set("schemaVersion", VERSION)
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {DCC}/v{VERSION}/dcc.xsd")
    _administrative(root, certificate)
    results = _add(root, "measurementResults")
    result = _add(results, "measurementResult")
    _named(result, "ISO 9283:1998 characteristics", OWN)
    methods = _add(result, "usedMethods")
    method = _add(methods, "usedMethod")
    _named(method, certificate["details"].get("method", "ISO 9283:1998"))
    _software(_add(result, "usedSoftware"), certificate)
    _conditions(_add(result, "influenceConditions"), certificate["details"].get("conditions") or {"text": NOT_STATED})
    _results(_add(result, "results"), certificate)
    content = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    if xsd is not None:
        check_xml(content, xsd)
    return bytes(content)


def check_xml(content: bytes, xsd: Path) -> None:
    """Hold XML against an XSD; schemas it includes are read from beside it, never from a network."""
    files.read_bytes(xsd)  # raises an error if it cannot be read
    parser = etree.XMLParser(no_network=True, resolve_entities=False)
    try:
        schema = etree.XMLSchema(etree.parse(str(xsd), parser))
    except (etree.XMLSyntaxError, etree.XMLSchemaParseError, OSError) as error:
        raise CertificationError(message("error.cannot_be_used_as", where=xsd, error=str(error).splitlines()[0])) from None
    if not schema.validate(etree.fromstring(content, parser)):
        first = schema.error_log[0]
        raise CertificationError(message("error.the_dcc_does_not", where=xsd, line=first.line, message=first.message))


def _add(parent: Any, name: str, text: object = None) -> Any:
    space, _, local = name.rpartition(":")
    child = etree.SubElement(parent, f"{{{SI if space == 'si' else DCC}}}{local}")
    if text is not None:
        child.text = _xml_text(str(text))
    return child


# characters that XML 1.0 cannot contain, not even escaped
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def _xml_text(text: str) -> str:
    return _FORBIDDEN.sub(lambda m: f"\\u{{{ord(m[0]):X}}}", text)


def _content(parent: Any, text: object, language: str | None = None) -> None:
    """One content, as DCC writes texts."""
    content = _add(parent, "content", text)
    if language is not None:
        content.set("lang", language)


def _named(parent: Any, text: object, language: str | None = None) -> None:
    """A name with one content."""
    _content(_add(parent, "name"), text, language)


def _administrative(root: Any, certificate: dict[str, Any]) -> None:
    details = certificate["details"]
    dates = details.get("dates", {})
    part = _add(root, "administrativeData")
    _software(_add(part, "dccSoftware"), certificate)
    core = _add(part, "coreData")
    _add(core, "countryCodeISO3166_1", details["country"])
    _add(core, "usedLangCodeISO639_1", OWN)
    _add(core, "mandatoryLangCodeISO639_1", OWN)
    _add(core, "uniqueIdentifier", certificate["id"])
    if "number" in details:
        _identified(core, "calibrationLaboratory", details["number"], "number of the report")
    made = certificate["created"][:10]
    if "received" in dates:
        _add(core, "receiptDate", dates["received"])
    _add(core, "beginPerformanceDate", dates.get("measured_from", dates.get("measured_to", made)))
    _add(core, "endPerformanceDate", dates.get("measured_to", dates.get("measured_from", made)))
    _add(core, "performanceLocation", details.get("performed_at", "other"))
    if "issued" in dates:
        _add(core, "issueDate", dates["issued"])
    items = _add(part, "items")
    item = _add(items, "item")
    robot = details.get("item", {})
    _named(item, robot.get("description", "industrial robot"))
    if "maker" in robot:
        _named(_add(item, "manufacturer"), robot["maker"])
    if "model" in robot:
        _add(item, "model", robot["model"])
    _identified(item, "manufacturer", robot.get("serial", NOT_STATED), "serial number")
    laboratory = _add(part, "calibrationLaboratory")
    if "accreditation" in details:
        _add(laboratory, "calibrationLaboratoryCode", details["accreditation"]["number"])
    _party(_add(laboratory, "contact"), details.get("laboratory", {}))
    persons = _add(part, "respPersons")
    person = _add(persons, "respPerson")
    authoriser = details.get("authoriser", {})
    _named(_add(person, "person"), authoriser.get("name", NOT_STATED))
    if "role" in authoriser:
        _add(person, "role", authoriser["role"])
    _party(_add(part, "customer"), details.get("customer", {}))
    _statements(_add(part, "statements"), details)


def _software(parent: Any, certificate: dict[str, Any]) -> None:
    """Write the program and its release: a letter and at most three numbers."""
    software = _add(parent, "software")
    _named(software, "lmeasure", OWN)
    numbers = re.match(r"\d{1,3}(\.\d{1,3}){0,2}", certificate["environment"].get("lmeasure", ""))
    _add(software, "release", f"v{numbers[0] if numbers else '0'}")


def _identified(parent: Any, issuer: str, value: str, name: str) -> None:
    identification = _add(_add(parent, "identifications"), "identification")
    _add(identification, "issuer", issuer)
    _add(identification, "value", value)
    _named(identification, name, OWN)


def _statements(parent: Any, details: dict[str, Any]) -> None:
    """State the declarations of the whole: a name in our words, a declaration that may be the laboratory's."""

    def state(name: str, declaration: str, language: str | None = OWN) -> None:
        statement = _add(parent, "statement")
        _named(statement, name, OWN)
        _content(_add(statement, "declaration"), declaration, language)

    state("scope", "The results relate only to the item tested.")
    if not {"measured_from", "measured_to"} & set(details.get("dates", {})):
        state("dates", "The dates of the measurement are not stated; those given are of this document.")
    if "accreditation" in details:
        state("accreditation", "; ".join(details["accreditation"][key] for key in ("statement", "body", "number")), None)
    else:
        state("accreditation", "Test report; no accreditation is stated.")
    for key, name in (("traceability", "traceability"), ("location", "place of the test"), ("deviations", "deviations from the method")):
        if key in details:
            state(name, details[key], None)
    if "traceability" not in details:
        state("traceability", NOT_STATED)


def _party(parent: Any, party: dict[str, Any]) -> None:
    _named(parent, party.get("name", NOT_STATED))
    if "contact" in party:
        _add(parent, "eMail" if "@" in party["contact"] else "phone", party["contact"])
    location = _add(parent, "location")
    _content(_add(location, "further"), party.get("address", NOT_STATED))


def _conditions(parent: Any, conditions: dict[str, Any]) -> None:
    for key, name, unit in (("temperature_c", "temperature", r"\degreecelsius"), ("humidity_percent", "relative humidity", r"\percent")):
        if key in conditions:
            condition = _add(parent, "influenceCondition")
            _named(condition, name, OWN)
            quantity = _add(_add(condition, "data"), "quantity")
            real = _add(quantity, "si:real")
            _add(real, "si:value", _number(conditions[key]))
            _add(real, "si:unit", unit)
    if "text" in conditions:
        condition = _add(parent, "influenceCondition")
        _named(condition, "conditions", OWN)
        # a laboratory's own text has no language that we know; the DCC wants one
        _content(_add(_add(condition, "data"), "text"), conditions["text"], OWN if conditions["text"] == NOT_STATED else None)


def _results(parent: Any, certificate: dict[str, Any]) -> None:
    for figure in certificate["characteristics"]:
        result = _add(parent, "result")
        where = " ".join(str(figure[key]) for key in ("pose", "path", "part") if figure.get(key) is not None)
        stated = figure["u95"] is not None
        verdict = "excluded" if figure.get("excluded") else VERDICTS[bool(figure["capable"]) if stated else None]
        _named(result, f"{figure['name']} {where}".strip())
        alone = figure.get("capable_alone", figure["capable"])
        besides = "" if alone == figure["capable"] else f"; component alone: {VERDICTS[bool(alone)]}"
        _content(_add(result, "description"), f"ISO 9283:1998, {figure.get('clause', '')}; {verdict}{besides}", OWN)
        quantity = _add(_add(result, "data"), "quantity")
        real = _add(quantity, "si:real")
        _add(real, "si:value", _number(figure["value"]))
        _add(real, "si:unit", UNITS.get(figure["unit"], figure["unit"]))
        if stated:
            expanded = _add(_add(real, "si:measurementUncertaintyUnivariate"), "si:expandedMU")
            _add(expanded, "si:valueExpandedMU", _number(figure["u95"]))
            _add(expanded, "si:coverageFactor", _number(figure.get("coverage_factor") or 1.96))
            _add(expanded, "si:coverageProbability", "0.95")
        if figure.get("conformity"):
            _conformity(_add(_add(quantity, "measurementMetaData"), "metaData"), figure)


def _conformity(parent: Any, figure: dict[str, Any]) -> None:
    """The decision on a tolerance; cases between acceptance and rejection are conditional, on the side of the limit where the value
    lies."""
    found = figure["conformity"]
    lower, upper = found.get("lower"), found.get("upper")
    limits = [f"{sign} {_number(limit)} {figure['unit']}" for sign, limit in (("at least", lower), ("at most", upper)) if limit is not None]
    within = (lower is None or lower <= figure["value"]) and (upper is None or figure["value"] <= upper)
    status = {"conforms": "pass", "does not conform": "fail"}.get(found["verdict"], "conditionalPass" if within else "conditionalFail")
    _named(parent, "conformity", OWN)
    _content(_add(parent, "declaration"), f"{' and '.join(limits)}; {found['rule']} acceptance (JCGM 106)", OWN)
    _add(parent, "conformity", status)


def _number(value: float) -> str:
    """Shortest text that reads back to the same double."""
    return repr(float(value))


@dataclass(frozen=True)
class DccResult:
    """A result: its name, value and unit, and its standard uncertainty, None where there is none."""

    name: str
    value: float
    unit: str
    u: float | None


@dataclass(frozen=True)
class Dcc:
    """A digital calibration certificate, as far as others build on it."""

    identifier: str
    laboratory: str
    item: str
    performed: datetime.date | None
    """Last day of the calibration."""
    results: tuple[DccResult, ...]
    serial: str = ""
    """Serial number of the item."""
    traceable: bool | None = None
    """True if a statement calls the results traceable; None without one."""
    expires: datetime.date | None = None
    """Last day of validity, by a statement with a date and a period."""

    @property
    def traceability(self) -> str:
        """The reference in a sentence, as a report states where its own traceability comes from."""
        item = f"{self.item}, serial number {self.serial}" if self.serial else self.item
        laboratory = f" of {self.laboratory}" if self.laboratory else ""
        day = f", {self.performed.isoformat()}" if self.performed else ""
        return f"{item or 'reference instrument'}: calibration certificate {self.identifier}{laboratory}{day}"

    def doubts(self, day: datetime.date | None) -> tuple[Message, ...]:
        """Return the faults of the reference on the day of its use (None if unknown): expired, not yet calibrated, or not traceable."""
        out = []
        if self.expires is not None and (day is None or day > self.expires):
            code = "dcc.undated" if day is None else "dcc.expired"
            out.append(message(code, id=self.identifier, expires=self.expires.isoformat(), day=str(day)))
        if day is not None and self.performed is not None and day < self.performed:
            out.append(message("dcc.later", id=self.identifier, performed=self.performed.isoformat(), day=day.isoformat()))
        if self.traceable is False:
            out.append(message("dcc.not_traceable", id=self.identifier))
        return tuple(out)


def read_dcc(path: Path) -> Dcc:
    """Read a DCC of version 2 or 3 of any program.

    Raises
    ------
    FileFormatError
        If it is no DCC, or a number in it is none.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(files.read_bytes(path), parser)
    except etree.XMLSyntaxError as error:
        raise FileFormatError(message("error.cannot_be_read_as_xml", where=path, error=str(error).splitlines()[0])) from None
    if root.tag != f"{{{DCC}}}digitalCalibrationCertificate":
        raise FileFormatError(message("error.is_no_dcc_it", where=path, localname=etree.QName(root).localname))

    def text(at: Any, where: str) -> str:
        return " ".join("".join(one.itertext()).strip() for one in at.iterfind(where, {"dcc": DCC, "si": SI})).strip()

    def named(at: Any, where: str) -> str:
        """Return a name in English, or in the first language that has it."""
        contents = at.findall(f"{where}/dcc:content", {"dcc": DCC})
        contents.sort(key=lambda content: content.get("lang") != OWN)
        return "".join(contents[0].itertext()).strip() if contents else ""

    def numbers(at: Any, name: str, count: int | None = None) -> tuple[float, ...]:
        """Return the numbers of an element or a list, as many as the values they belong to; none where the element is missing."""
        found = next(at.iterfind(f".//si:{name}", {"si": SI}), None)
        words = [] if found is None else "".join(found.itertext()).split()
        try:
            values = tuple(float(word) for word in words)
        except ValueError:
            values = (math.nan,)
        line = at.sourceline
        if not all(math.isfinite(value) for value in values):
            raise FileFormatError(message("error.is_no_number", where=path, line=line, localname=name, found=" ".join(words)[:40]))
        if count is not None and len(values) not in (0, 1, count):
            raise FileFormatError(message("error.dcc_list_length", where=path, line=line, name=name, found=len(values), count=count))
        return values if count is None or len(values) != 1 else values * count

    def date(found: str, name: str) -> datetime.date | None:
        try:
            # a day of XML may have a time zone
            return datetime.date.fromisoformat(found[:10]) if found else None
        except ValueError:
            raise FileFormatError(message("error.is_no_date_2", where=path, name=name, found=found[:40])) from None

    core = "dcc:administrativeData/dcc:coreData/dcc:"
    day = date(text(root, f"{core}endPerformanceDate"), "endPerformanceDate")
    traceable, ends = set(), []
    for statement in root.iterfind("dcc:administrativeData/dcc:statements/dcc:statement", {"dcc": DCC}):
        traceable.add(text(statement, "dcc:traceable"))
        begun, period = date(text(statement, "dcc:date"), "statement: date"), text(statement, "dcc:period")
        if period and (begun or day):
            ends.append(_after(begun or day, period, path))
    results: list[DccResult] = []
    seen: Counter[str] = Counter()
    for result in root.iterfind(".//dcc:result", {"dcc": DCC}):
        own = named(result, "dcc:name")
        for quantity in result.iterfind(".//dcc:quantity", {"dcc": DCC}):
            stated = (one for tag in ("real", "realListXMLList") for one in quantity.iter(f"{{{SI}}}{tag}"))
            # a hybrid states the same value in other units
            if (real := next(stated, None)) is None:
                continue
            suffix = "XMLList" if real.tag.endswith("XMLList") else ""
            values = numbers(real, f"value{suffix}")
            n = len(values)
            expanded = numbers(real, f"valueExpandedMU{suffix}", n) or numbers(real, f"uncertainty{suffix}", n)
            factors = numbers(real, f"coverageFactor{suffix}", n) or (2.0,) * n
            standard = tuple(U / (k or 2.0) for U, k in zip(expanded, factors, strict=False)) or numbers(
                real, f"valueStandardMU{suffix}", n
            )
            units = text(real, f"si:unit{suffix}").split() or [""]
            units = units * n if len(units) == 1 else units
            if len(units) != n:
                line = real.sourceline
                raise FileFormatError(
                    message("error.dcc_list_length", where=path, line=line, name="unitXMLList", found=len(units), count=n)
                )
            name = ": ".join(filter(None, (own, named(quantity, "dcc:name"))))
            for i, (value, u, unit) in enumerate(zip(values, standard or (0.0,) * n, units, strict=True)):
                factor, short = _own_unit(unit)
                one = f"{name} [{i + 1}]" if n > 1 else name
                seen[one] += 1
                one = one if seen[one] == 1 else f"{one} ({seen[one]})"
                results.append(DccResult(one, factor * value, short, factor * u if u > 0.0 else None))
    return Dcc(
        identifier=text(root, f"{core}uniqueIdentifier"),
        laboratory=named(root, "dcc:administrativeData/dcc:calibrationLaboratory/dcc:contact/dcc:name"),
        item=named(root, "dcc:administrativeData/dcc:items/dcc:item/dcc:name"),
        performed=day,
        results=tuple(results),
        serial=text(root, "dcc:administrativeData/dcc:items/dcc:item/dcc:identifications/dcc:identification/dcc:value"),
        traceable=False if traceable & {"false", "0"} else True if traceable & {"true", "1"} else None,
        expires=min(ends, default=None),
    )


_LENGTH = re.compile(r"(?:\\(kilo|deci|centi|milli|micro|nano))?\\metre(\\second\\tothe\{-1\}|\\per\\second)?")
_ANGLE = re.compile(r"(?:\\(milli|micro|nano))?\\radian|\\(degree|arcminute|arcsecond)")
_PREFIXES = {None: 1.0, "kilo": 1e3, "deci": 1e-1, "centi": 1e-2, "milli": 1e-3, "micro": 1e-6, "nano": 1e-9}
_DEGREES = {None: 180.0 / math.pi, "degree": 1.0, "arcminute": 1.0 / 60.0, "arcsecond": 1.0 / 3600.0}


def _own_unit(unit: str) -> tuple[float, str]:
    """Return the unit in which certificates state a length, speed or angle of D-SI, and the factor to it; any other unit as it is."""
    if found := _LENGTH.fullmatch(unit):
        return _PREFIXES[found[1]] / 1e-3, "mm/s" if found[2] else "mm"
    if found := _ANGLE.fullmatch(unit):
        return _PREFIXES[found[1]] * _DEGREES[found[2]], "deg"
    return 1.0, next((short for short, long in UNITS.items() if long == unit), unit)


_PERIOD = re.compile(r"P(?:(\d{1,4})Y)?(?:(\d{1,5})M)?(?:(\d{1,6})D)?(?:T[\dHMS.]+)?")


def _after(begun: datetime.date | None, period: str, path: Path) -> datetime.date:
    """Return the day a period of XML (P1Y6M) behind another."""
    found = _PERIOD.fullmatch(period)
    if begun is None or found is None or period in ("P", "PT"):
        raise FileFormatError(message("error.statement_period_is_no", where=path, period=period[:40]))
    years, months, days = (int(part or 0) for part in found.groups())
    months += 12 * (begun.year + years) + begun.month - 1
    year, month = divmod(months, 12)
    try:
        last = calendar.monthrange(year, month + 1)[1]
        return datetime.date(year, month + 1, min(begun.day, last)) + datetime.timedelta(days=days)
    except (ValueError, OverflowError, calendar.IllegalMonthError):
        raise FileFormatError(message("error.statement_period_ends_at", where=path, period=period[:40])) from None
