"""The details file: statements of a report besides its results (ISO/IEC 17025:2017, 7.8.2 to 7.8.4).

Everything is optional: a missing statement is printed as not stated, never guessed.
"""

import datetime
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import lxml.etree
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from lmeasure.certificate.dcc import read_dcc
from lmeasure.core import CertificationError, FileFormatError
from lmeasure.io import Strict, checked, files
from lmeasure.text import Message, message

SCHEMA = "lmeasure.report/1"


def _printable(value: str) -> str:
    if not value.strip():
        raise ValueError(message("error.must_not_be_empty"))
    if not all(line.isprintable() for line in value.split("\n")):
        raise ValueError(message("error.must_be_printable_text"))
    return value.strip()


def _day(value: Any) -> Any:
    """A date of TOML, or text like 2026-03-31, as that text."""
    if isinstance(value, datetime.datetime):
        raise ValueError(message("error.must_be_a_date_such"))  # noqa: TRY004
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, str):
        try:
            return datetime.date.fromisoformat(value).isoformat()
        except ValueError:
            pass
    raise ValueError(message("error.must_be_a_date"))


Text = Annotated[str, Field(max_length=4000), AfterValidator(_printable)]
Day = Annotated[str, BeforeValidator(_day)]


class Party(Strict):
    """Laboratory or customer."""

    name: Text | None = None
    """Name."""
    address: Text | None = None
    """Postal address."""
    contact: Text | None = None
    """Telephone number or e-mail address."""


class Item(Strict):
    """Robot under test."""

    maker: Text | None = None
    """Manufacturer."""
    model: Text | None = None
    """Model."""
    serial: Text | None = None
    """Serial number."""
    controller: Text | None = None
    """Controller and its version."""
    description: Text | None = None
    """Other identification."""
    condition: Text | None = None
    """Condition that matters to the results: state on receipt, load, tool, warm-up."""


class Dates(Strict):
    """Dates of receipt, measurement and issue."""

    received: Day | None = None
    """Date of receipt of the robot."""
    measured_from: Day | None = None
    """First day of the measurement."""
    measured_to: Day | None = None
    """Last day of the measurement."""
    issued: Day | None = None
    """Date of issue of the report."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        stated = [(key, day) for key, day in self if day is not None]
        for (before, a), (after, b) in itertools.pairwise(stated):
            if b < a:
                raise ValueError(message("error.lies_before", after=after, b=b, before=before, a=a))
        return self


class Conditions(Strict):
    """Environmental conditions during the measurement."""

    text: Text | None = None
    """Conditions in words."""
    temperature_c: Annotated[float, Field(gt=-100, lt=200)] | None = None
    """Mean air temperature."""
    temperature_range_c: Annotated[float, Field(ge=0, lt=200)] | None = None
    """Largest minus smallest temperature."""
    humidity_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    """Relative humidity."""


class Authoriser(Strict):
    """Person responsible for the report."""

    name: Text | None = None
    """Name."""
    role: Text | None = None
    """Function."""


class Reference(Strict):
    """Reference instrument of the measuring instrument's calibration."""

    dcc: Text
    """DCC of the reference instrument (.xml), path relative to this file."""
    expires: Day | None = None
    """Last day of its validity; default: as the DCC states it."""


class Accreditation(Strict):
    """Accreditation of the laboratory. Without this table, the report is a test report without accreditation."""

    statement: Text
    """Statement to print."""
    body: Text
    """Accreditation body."""
    number: Text
    """Registration number."""


class Details(Strict):
    """Administrative details of a test report (ISO/IEC 17025)."""

    schema_: Annotated[Literal["lmeasure.report/1"], Field(alias="schema")] = "lmeasure.report/1"
    """Kind and version of the file."""
    number: Text | None = None
    """Report number of the laboratory."""
    country: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = None
    """Country of the laboratory (ISO 3166-1 code), for the DCC."""
    location: Text | None = None
    """Location of the test."""
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] | None = None
    """Location of the test as a DCC code."""
    method: Text | None = None
    """Test method; default: ISO 9283 as lmeasure implements it."""
    deviations: Text | None = None
    """Additions to, deviations or exclusions from the method."""
    sampling: Text | None = None
    """Selection of robot, poses or time."""
    traceability: Text | None = None
    """Metrological traceability of the instrument's calibration; default: the certificate of the reference."""
    supplied: Text | None = None
    """Information supplied by the customer."""
    external: Text | None = None
    """Results from external providers."""
    remarks: Text | None = None
    """Other remarks."""
    logo: Text | None = None
    """Logo of the laboratory for the first page: .svg, .png or .jpg, path relative to this file."""
    show_not_stated: bool | None = None
    """true: one row for each missing detail; default: one row that lists all of them."""
    language: Literal["en", "ru"] | None = None
    """Language of the report, if the command states none."""
    rule: Literal["simple", "guarded"] | None = None
    """Decision rule for tolerances, if the command states none."""
    laboratory: Party = Party()
    """Laboratory that measured."""
    customer: Party = Party()
    """Customer."""
    item: Item = Item()
    """Robot under test."""
    dates: Dates = Dates()
    """Dates."""
    conditions: Conditions = Conditions()
    """Environmental conditions."""
    authoriser: Authoriser = Authoriser()
    """Person responsible for the report."""
    reference: Reference | None = None
    """Reference instrument."""
    accreditation: Accreditation | None = None
    """Accreditation; for accredited laboratories only."""

    def stated(self) -> dict[str, Any]:
        """Return the stated values, as the tables of the file; nothing else."""
        return {key: value for key, value in self.model_dump(by_alias=True, exclude_none=True).items() if value != {}}


MOST_LOGO_BYTES = 2**20


@dataclass(frozen=True)
class Logo:
    """Picture: the bytes of its file, and their kind."""

    content: bytes
    kind: Literal["svg", "png", "jpg"]


def read_logo(details: Path, stated: Details) -> Logo | None:
    """The logo that a details file names, None where it names none; CertificationError names a file that is no picture."""
    if stated.logo is None:
        return None
    path = details.parent / stated.logo
    content = files.read_bytes(path)
    if len(content) > MOST_LOGO_BYTES:
        raise CertificationError(message("error.a_logo_of_bytes", where=path, n_content=len(content), most_logo_bytes=MOST_LOGO_BYTES))
    if content.startswith(b"\x89PNG\r\n\x1a\n"):
        return Logo(content, "png")
    if content.startswith(b"\xff\xd8\xff"):
        return Logo(content, "jpg")
    try:
        root = lxml.etree.fromstring(content, lxml.etree.XMLParser(resolve_entities=False, no_network=True))
    except lxml.etree.XMLSyntaxError:
        root = None
    if root is None or lxml.etree.QName(root).localname != "svg":
        raise CertificationError(message("error.is_no_picture_a", where=path))
    return Logo(content, "svg")


def with_reference(details: Details, path: Path) -> tuple[Details, tuple[Message, ...]]:
    """Return the details of a file with the traceability from the reference's DCC, and the faults of the reference at its use."""
    if details.reference is None:
        return details, ()
    dcc = read_dcc(path.parent / details.reference.dcc)
    if details.reference.expires is not None:
        dcc = replace(dcc, expires=datetime.date.fromisoformat(details.reference.expires))
    day = details.dates.measured_to or details.dates.measured_from
    doubts = dcc.doubts(None if day is None else datetime.date.fromisoformat(day))
    return details.model_copy(update={"traceability": details.traceability or dcc.traceability}), doubts


def read_details(path: Path) -> Details:
    """Read a details file; FileFormatError names the file and the key."""
    data = files.read_toml(path)
    if data.get("schema") != SCHEMA:
        raise FileFormatError(message("error.schema_this_program_reads", where=path, stated=data.get("schema"), schema=SCHEMA))
    return checked(data, Details, str(path))
