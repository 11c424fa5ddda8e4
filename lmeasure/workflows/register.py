"""A register of calibrations, checks and certificates over years."""

import datetime
import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from lmeasure.core import CertificationError, SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, option

if TYPE_CHECKING:
    from lmeasure.register import Due, Entry, Register
    from lmeasure.text import Message


class RegisterSettings(Writing):
    NEXT: ClassVar[str] = "register {register_dir} --add certificate"
    register_dir: Annotated[Path, option("Folder of the register; it is made if it does not exist.", metavar="DIR", positional=True)]
    add: Annotated[
        tuple[Path, ...], option("Add certificates, calibrations, files of checks, or DCCs of reference instruments.", metavar="PATH")
    ] = ()
    who: Annotated[str, option("Name of the person who adds; default: the user of this computer.", metavar="NAME")] = ""
    made: Annotated[str, option("Day of the measurement, if the document does not state it.", metavar="YYYY-MM-DD")] = ""
    verify: Annotated[bool, option("Check that no row was changed or removed since it was added.")] = False
    recall: Annotated[Path | None, option("List the documents that depend on this calibration or reference.", metavar="PATH")] = None
    subject: Annotated[str, option("Show the results of this robot, rig or reference instrument.", metavar="NAME")] = ""
    result: Annotated[str, option("With --subject: show this result over time, with control charts and forecast.", metavar="NAME")] = ""
    kind: Annotated[
        Literal["certificate", "calibration", "check", "reference"], option("With --subject: kind of the documents that state the result.")
    ] = "certificate"
    baseline: Annotated[int, Field(ge=5), option("Number of first values that set up the control charts.")] = 10
    export: Annotated[Path | None, option("Write all results as a table.", metavar="FILE.csv")] = None
    backup: Annotated[Path | None, option("Write a copy of the register while others use it.", metavar="FILE.sqlite")] = None
    database: Annotated[str, option("Keep the register in this database (SQLAlchemy URL), not in the folder.", metavar="URL")] = ""

    def paths(self) -> Paths:
        return Paths(present(self.export, self.backup), (*self.add, *present(self.recall)))


@workflow
def run_register(settings: RegisterSettings, progress: Progress = silent) -> Result:
    """Add entries, and answer questions."""
    from lmeasure.register import FILE, Register, due, read_entries, read_limits

    if settings.result and not settings.subject:
        raise SettingsError("result", message("error.goes_with_subject"))
    made = _day(settings.made)
    limits = read_limits(settings.register_dir)
    # nothing is added before all that is to be added has been read
    entries = [entry for path in settings.add for entry in _signed(settings.register_dir, path, read_entries(path, made))]
    if not settings.database and not settings.add and not (settings.register_dir / FILE).is_file():
        raise CertificationError(message("error.holds_no_register_add", where=settings.register_dir))
    register = Register(settings.database or settings.register_dir)
    try:
        added = register.add(entries, settings.who or getpass.getuser())
        progress(0.5, "register")
        lines: list[Message] = [message("register.added", count=len(added), known=len(entries) - len(added))] if settings.add else []
        faults = register.faults() if settings.verify else ()
        if settings.verify and not faults:
            lines.append(message("register.sound", newest=register.newest))
        if settings.recall is not None:
            lines += _recalled(register, settings.recall)
        if settings.subject:
            lines += _of_subject(register, settings)
        waiting = due(register, limits)
        subjects = register.subjects()
        kinds = {kind: sum(s.documents for s in subjects if s.kind == kind) for kind in _KINDS}
        if not (settings.recall or settings.subject or settings.verify):
            lines.append(message("register.holds", count=sum(kinds.values()), name=register.name, **kinds))
            lines += [d.said(datetime.date.today()) for d in waiting]
        if settings.export is not None:
            _export(settings.export, register.entries())
        if settings.backup is not None:
            register.backup(settings.backup)
        answer: dict[str, object] = {"newest": register.newest, "faults": list(faults), "due": [_due_json(d) for d in waiting]}
    finally:
        register.close()
    figures = {"entries": float(sum(kinds.values())), "added": float(len(added)), "faults": float(len(faults))}
    figures["overdue"] = float(sum(d.overdue(datetime.date.today()) for d in waiting))
    written = present(register.path if settings.add else None)
    return Result(answer, tuple(lines), figures, files=written, failure="; ".join(faults))


_KINDS = ("calibration", "check", "certificate", "reference")


def _day(text: str) -> datetime.date | None:
    try:
        return datetime.date.fromisoformat(text) if text else None
    except ValueError:
        raise SettingsError("made", message("error.is_no_date_such", text=text)) from None


def _signed(folder: Path, path: Path, entries: "tuple[Entry, ...]") -> "tuple[Entry, ...]":
    """Return the entries of a document; a certificate's only if an authorised key signed it, where the register's folder has keys."""
    from lmeasure.certificate import check_seal, fingerprint, read_public_key

    keys = sorted((folder / "keys").glob("*.pub"))
    if keys and any(entry.kind == "certificate" for entry in entries):
        seal = check_seal(path)
        if seal.differences:
            raise CertificationError(message("error.a_changed_certificate_is", where=path, differences=seal.differences[0].line()))
        if seal.signer not in {fingerprint(read_public_key(key)) for key in keys}:
            signer = f"key {seal.signer}" if seal.signer else "nobody"
            raise CertificationError(message("error.is_signed_by_the", where=path, signer=signer, folder=folder / "keys"))
    return entries


def _recalled(register: "Register", path: Path) -> "list[Message]":
    from lmeasure.register import digest_of, read_entries

    digests = [entry.digest for entry in read_entries(path)] if path.is_dir() else [digest_of(path)]
    found = [entry for digest in digests for entry in register.recall(digest)]
    if not found and not register.knows(digests):
        raise CertificationError(message("error.is_not_in_the", where=path))
    lines = [message("register.recalled", count=len(found), path=str(path))]
    return lines + [message("register.entry", kind=e.kind, subject=e.subject, made=e.made.isoformat(), path=e.path) for e in found]


def _of_subject(register: "Register", settings: RegisterSettings) -> "list[Message]":
    """Return the results of a subject, or one of them over time."""
    from lmeasure.register import control_charts, forecast

    names = register.results(settings.subject, settings.kind)
    if not names:
        known = ", ".join(f"{s.subject} ({s.kind})" for s in register.subjects()[:10])
        about = {"kind": settings.kind, "subject": settings.subject, "known": known}
        raise CertificationError(message("error.no_of_is_registered", where=register.name, **about))
    if not settings.result:
        return [message("register.results", subject=settings.subject, names=", ".join(names))]
    if settings.result not in names:
        raise CertificationError(
            message("error.has_no_result_it", where=register.name, subject=settings.subject, result=settings.result, names=", ".join(names))
        )
    days, values, u, unit = register.series(settings.subject, settings.result, settings.kind)
    dates = [(datetime.date(1970, 1, 1) + datetime.timedelta(days=int(d))).isoformat() for d in days]
    lines = [message("register.value", made=d, value=float(v), u=float(s), unit=unit) for d, v, s in zip(dates, values, u, strict=True)]
    if len(values) >= settings.baseline:
        for chart in control_charts(values, settings.baseline):
            signals = ", ".join(dates[i] for i in chart.signals)
            lines.append(message("register.signals" if signals else "register.in_control", chart=chart.name, dates=signals))
    else:
        lines.append(message("register.few_values", count=len(values), baseline=settings.baseline))
    try:
        ahead = forecast(days, values, u)
    except CertificationError as error:
        return [*lines, message("register.no_forecast", reason=error)]
    low, high = ahead.interval(float(ahead.last) + 365.25)
    drift = {"drift": 365.25 * ahead.drift, "u": 365.25 * ahead.u_drift}
    return [*lines, message("register.forecast", unit=unit, low=low, high=high, **drift)]


def _due_json(due: "Due") -> dict[str, object]:
    day = None if due.day is None else due.day.isoformat()
    about = {"subject": due.limit.subject, "result": due.limit.result, "day": day}
    return about | {"last": due.last, "drift_per_year": due.drift, "beyond": due.beyond}


def _export(path: Path, entries: "tuple[Entry, ...]") -> None:
    import pandas as pd

    from lmeasure.io import files, harmless

    rows = [
        (e.made.isoformat(), e.kind, harmless(e.subject), harmless(n), r.value, r.u, r.unit, e.digest)
        for e in entries
        for n, r in e.results.items()
    ]
    table = pd.DataFrame(rows, columns=["made", "kind", "subject", "result", "value", "u", "unit", "sha256"])
    files.write_text(path, table.to_csv(index=False))
