"""What a report must say besides its figures (ISO/IEC 17025:2017, 7.8.2 to 7.8.4): the details file.

Everything is optional: what is not stated is named as not stated, never guessed.
"""

import datetime
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import lxml.etree
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from lmeasure.core import CertificationError, FileFormatError
from lmeasure.io import Strict, checked, files

SCHEMA = "lmeasure.report/1"


def _printable(value: str) -> str:
    if not value.strip():
        raise ValueError("must not be empty; leave the key out when there is nothing to state")
    if not all(line.isprintable() for line in value.split("\n")):
        raise ValueError("must be printable text")
    return value.strip()


def _day(value: Any) -> Any:
    """A date of TOML, or text like 2026-03-31, as that text."""
    if isinstance(value, datetime.datetime):
        raise ValueError("must be a date such as 2026-03-31, without a time")  # noqa: TRY004
    if isinstance(value, datetime.date):
        return value.isoformat()
    if isinstance(value, str):
        try:
            return datetime.date.fromisoformat(value).isoformat()
        except ValueError:
            pass
    raise ValueError("must be a date such as 2026-03-31")


Text = Annotated[str, Field(max_length=4000), AfterValidator(_printable)]
Day = Annotated[str, BeforeValidator(_day)]


class Party(Strict):
    """The laboratory or the customer."""

    name: Text | None = None
    """Name."""
    address: Text | None = None
    """Address."""
    contact: Text | None = None
    """Telephone or mail."""


class Item(Strict):
    """The robot under test. condition: in which it came, and what of it matters to the result (load, tool, warm-up)."""

    maker: Text | None = None
    """Maker."""
    model: Text | None = None
    """Model."""
    serial: Text | None = None
    """Serial number."""
    controller: Text | None = None
    """Controller and its version."""
    description: Text | None = None
    """Anything else by which it is known."""
    condition: Text | None = None
    """In which it came, and what of it matters to the result."""


class Dates(Strict):
    """Days of receipt, of the measurement's begin and end, and of issue."""

    received: Day | None = None
    """Day on which the robot was received."""
    measured_from: Day | None = None
    """First day of measuring."""
    measured_to: Day | None = None
    """Last day of measuring."""
    issued: Day | None = None
    """Day of issue."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        stated = [(key, day) for key, day in self if day is not None]
        for (before, a), (after, b) in itertools.pairwise(stated):
            if b < a:
                raise ValueError(f"{after} {b} lies before {before} {a}")
        return self


class Conditions(Strict):
    """Environmental conditions during the measurement."""

    text: Text | None = None
    """In words."""
    temperature_c: Annotated[float, Field(gt=-100, lt=200)] | None = None
    """Temperature in the middle."""
    temperature_range_c: Annotated[float, Field(ge=0, lt=200)] | None = None
    """Largest less smallest temperature."""
    humidity_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    """Relative humidity."""


class Authoriser(Strict):
    """Who answers for the report."""

    name: Text | None = None
    """Name."""
    role: Text | None = None
    """Function."""


class Accreditation(Strict):
    """Stated by the user only: without it the report is a test report of no accredited laboratory."""

    statement: Text
    """What is printed."""
    body: Text
    """Accreditation body."""
    number: Text
    """Registration number."""


class Details(Strict):
    """A details file, `schema = "lmeasure.report/1"`."""

    schema_: Annotated[Literal["lmeasure.report/1"], Field(alias="schema")] = "lmeasure.report/1"
    """What the file is, and in which version."""
    number: Text | None = None
    """The laboratory's own number of the report."""
    country: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = None
    """ISO 3166-1 code of the laboratory's country, for the DCC."""
    location: Text | None = None
    """Where the test was done."""
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] | None = None
    """Where the test was done, in the DCC's words."""
    method: Text | None = None
    """Method of test, where it is not ISO 9283 as this program follows it."""
    deviations: Text | None = None
    """Additions to, deviations or exclusions from the method."""
    sampling: Text | None = None
    """How robot, poses or time were chosen."""
    traceability: Text | None = None
    """To what the instrument's calibration is traceable."""
    supplied: Text | None = None
    """Information that the customer supplied."""
    external: Text | None = None
    """Results from external providers."""
    remarks: Text | None = None
    """Anything else."""
    logo: Text | None = None
    """The laboratory's mark on the first page: an .svg, .png or .jpg file, relative to this one."""
    show_not_stated: bool | None = None
    """A row of its own for everything that is not stated, instead of one row that names it all."""
    laboratory: Party = Party()
    """Who measured."""
    customer: Party = Party()
    """For whom."""
    item: Item = Item()
    """The robot."""
    dates: Dates = Dates()
    """Days."""
    conditions: Conditions = Conditions()
    """Of the environment."""
    authoriser: Authoriser = Authoriser()
    """Who answers for the report."""
    accreditation: Accreditation | None = None
    """Only of an accredited laboratory."""

    def stated(self) -> dict[str, Any]:
        """What is stated, as the tables of the file; nothing else."""
        return {key: value for key, value in self.model_dump(by_alias=True, exclude_none=True).items() if value != {}}


MOST_LOGO_BYTES = 2**20


@dataclass(frozen=True)
class Logo:
    """A picture: the bytes of its file, and what kind they are."""

    content: bytes
    kind: Literal["svg", "png", "jpg"]


def read_logo(details: Path, stated: Details) -> Logo | None:
    """The logo that a details file names, None where it names none; CertificationError names a file that is no picture."""
    if stated.logo is None:
        return None
    path = details.parent / stated.logo
    content = files.read_bytes(path)
    if len(content) > MOST_LOGO_BYTES:
        raise CertificationError(f"{path}: a logo of {len(content)} bytes; at most {MOST_LOGO_BYTES} are printed")
    if content.startswith(b"\x89PNG\r\n\x1a\n"):
        return Logo(content, "png")
    if content.startswith(b"\xff\xd8\xff"):
        return Logo(content, "jpg")
    try:
        root = lxml.etree.fromstring(content, lxml.etree.XMLParser(resolve_entities=False, no_network=True))
    except lxml.etree.XMLSyntaxError:
        root = None
    if root is None or lxml.etree.QName(root).localname != "svg":
        raise CertificationError(f"{path}: is no picture: a logo is an SVG, PNG or JPEG file")
    return Logo(content, "svg")


def read_details(path: Path) -> Details:
    """Read a details file; FileFormatError names the file and the key."""
    data = files.read_toml(path)
    if data.get("schema") != SCHEMA:
        raise FileFormatError(f"{path}: schema = {data.get('schema')!r}; this program reads {SCHEMA!r}")
    return checked(data, Details, str(path))
