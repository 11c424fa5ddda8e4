"""Limits of results that a laboratory keeps in its register's folder, and when each subject is due for its next calibration."""

import datetime
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from lmeasure.core import CertificationError, FileFormatError
from lmeasure.io import Strict, checked, files, of_key
from lmeasure.register.drift import LEAST, forecast
from lmeasure.register.register import Register
from lmeasure.text import Message, message

LIMITS = "limits.toml"
EPOCH = datetime.date(1970, 1, 1)


class Limit(Strict):
    """Limits that a result must keep until the next calibration."""

    subject: Annotated[str, Field(min_length=1)]
    """Serial number of the robot, or name of the rig or reference instrument."""
    result: Annotated[str, Field(min_length=1)]
    """Name of the result, such as "AP_p P1"."""
    kind: Literal["certificate", "calibration", "check", "reference"] = "certificate"
    """Kind of the documents that state it."""
    lower: float | None = None
    """Lower limit, in the unit of the result."""
    upper: float | None = None
    """Upper limit, in the unit of the result."""
    risk_percent: Annotated[float, Field(gt=0, lt=50)] = 5.0
    """Accepted probability that the value is beyond a limit on the day of the next calibration."""
    longest_days: Annotated[float, Field(ge=1, le=36500)] = 730.0
    """Longest time between two calibrations, whatever the drift."""

    @model_validator(mode="after")
    def _limits_something(self) -> "Limit":
        if self.lower is None and self.upper is None:
            raise of_key("upper", message("error.state_upper_lower_or"))
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise of_key("upper", message("error.must_be_above_lower"))
        return self


class Limits(Strict):
    """File limits.toml of a register."""

    schema_: Annotated[Literal["lmeasure.limits/1"], Field(alias="schema")] = "lmeasure.limits/1"
    """Kind and version of the file."""
    limit: tuple[Limit, ...] = ()
    """One table for each result with limits."""


@dataclass(frozen=True)
class Due:
    """When a subject is due, by a result. day: None where nothing is registered; last: value of the last calibration; drift: per year, with
    its standard uncertainty, None where too few calibrations determine it; beyond: whether the last value is beyond its limits."""

    limit: Limit
    unit: str
    day: datetime.date | None
    last: float | None = None
    drift: tuple[float, float] | None = None
    beyond: bool = False

    def overdue(self, today: datetime.date) -> bool:
        """Return whether the next calibration should have been made by today."""
        return self.beyond or (self.day is not None and self.day <= today)

    def said(self, today: datetime.date) -> Message:
        """Return the line of a list of what is due."""
        about = {"subject": self.limit.subject, "result": self.limit.result, "unit": self.unit, "risk": self.limit.risk_percent}
        if self.day is None:
            return message("register.never", **about)
        code = "beyond" if self.beyond else "overdue" if self.day <= today else "due"
        return message(f"register.{code}", **about, day=self.day.isoformat(), last=self.last)


def read_limits(folder: Path) -> Limits:
    """Read limits.toml of a register's folder; without the file there are no limits."""
    path = folder / LIMITS
    if not path.is_file():
        return Limits()
    data = files.read_toml(path)
    if data.get("schema") != "lmeasure.limits/1":
        raise FileFormatError(message("error.schema_this_program_reads_lmeasure", where=path, stated=data.get("schema")))
    return checked(data, Limits, str(path))


def due(register: Register, limits: Limits) -> tuple[Due, ...]:
    """Return when each subject is due, the first first.

    Three calibrations or more determine a drift: the next calibration is due when the risk is reached. With fewer of them it is due after
    half the longest time.
    """
    out = []
    for limit in limits.limit:
        days, values, u, unit = register.series(limit.subject, limit.result, limit.kind)
        if not len(days):
            out.append(Due(limit, unit, None))
            continue
        lower, upper = (-float("inf") if limit.lower is None else limit.lower), (float("inf") if limit.upper is None else limit.upper)
        beyond, last = not lower <= values[-1] <= upper, float(values[-1])
        try:
            found = forecast(days, values, u)
        except CertificationError:
            wait = limit.longest_days / (2.0 if len(days) < LEAST else 1.0)
            out.append(Due(limit, unit, _day(days[-1] + (0.0 if beyond else wait)), last, None, beyond))
            continue
        at = found.last if beyond else found.due(lower, upper, limit.risk_percent / 100.0, limit.longest_days)
        out.append(Due(limit, unit, _day(at), last, (365.25 * found.drift, 365.25 * found.u_drift), beyond))
    return tuple(sorted(out, key=lambda d: d.day or datetime.date.min))


def _day(days: float) -> datetime.date:
    return EPOCH + datetime.timedelta(days=int(days))
