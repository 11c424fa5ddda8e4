"""Entry of a register for a document: its kind, digest, subject, date, results, and the documents it was made with."""

import datetime
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lmeasure.certificate import CERTIFICATE, canonical, read_certificate, read_dcc
from lmeasure.core import CertificationError
from lmeasure.io import files
from lmeasure.procedures import COLUMNS
from lmeasure.rig import read_calibration_record
from lmeasure.text import message

CALIBRATION = "calibration.json"
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Result:
    """A result: value with its standard uncertainty in a unit; u is None where none is stated."""

    value: float
    u: float | None
    unit: str


@dataclass(frozen=True)
class Entry:
    """A document. kind: "calibration", "check", "certificate" or "reference"; digest: SHA-256 of its file; subject: serial number of the
    robot, name of the rig or of the reference instrument; made: day of the measurement; uses: digests of documents it depends on."""

    kind: str
    digest: str
    path: str
    subject: str
    made: datetime.date
    results: Mapping[str, Result] = field(default_factory=dict)
    uses: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> bytes:
        """Return the bytes that the chain of digests covers."""
        results = {name: [r.value, r.u, r.unit] for name, r in sorted(self.results.items())}
        about = {"kind": self.kind, "digest": self.digest, "path": self.path, "subject": self.subject, "made": self.made.isoformat()}
        return canonical(about | {"results": results, "uses": sorted(self.uses), "settings": dict(self.settings)})


def read_entries(path: Path, made: datetime.date | None = None) -> tuple[Entry, ...]:
    """Read a certificate's folder, a calibration's folder, a file of intermediate checks, or a DCC of a reference instrument.

    Parameters
    ----------
    path
        The document.
    made
        Day of the measurement; by default that which the document states, or today.

    Raises
    ------
    CertificationError
        If it is none of these.
    FileFormatError
        If it cannot be read.
    """
    if path.is_dir() and (path / CERTIFICATE).is_file():
        return (_of_certificate(path / CERTIFICATE, made),)
    if path.is_dir() and (path / CALIBRATION).is_file():
        return (_of_calibration(path / CALIBRATION, made),)
    if path.suffix.lower() == ".xml":
        return (_of_dcc(path, made),)
    if path.suffix.lower() == ".csv":
        return tuple(_of_checks(path))
    raise CertificationError(message("error.is_no_folder_of_a_certificate", where=path))


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(files.read_bytes(path)).hexdigest()


def _of_certificate(path: Path, made: datetime.date | None) -> Entry:
    content = read_certificate(path)
    details = content["details"]
    dates, item = details.get("dates", {}), details.get("item", {})
    stated = dates.get("measured_to") or dates.get("measured_from") or content["created"][:10]
    results = {}
    for figure in content["characteristics"]:
        where = " ".join(str(figure[key]) for key in ("pose", "path", "part") if figure.get(key) is not None)
        u = None if figure["u95"] is None else figure["u95"] / (figure.get("coverage_factor") or NORMAL_95)
        results[f"{figure['name']} {where}".strip()] = Result(float(figure["value"]), u, figure["unit"])
    used = (content.get("measured_with") or {}).get("calibration") or {}
    digests = [
        used.get("sha256"),
        *(i["sha256"] for i in content["inputs"] if Path(i["file"]).name == CALIBRATION or i["file"].endswith(".xml")),
    ]
    return Entry(
        kind="certificate",
        digest=digest_of(path),
        path=str(path),
        subject=item.get("serial") or item.get("description") or content["id"],
        made=made or datetime.date.fromisoformat(str(stated)),
        results=results,
        uses=tuple(dict.fromkeys(d for d in digests if d)),
        settings=content["settings"] | {"id": content["id"], "lmeasure": content["environment"].get("lmeasure", "")},
    )


def _of_calibration(path: Path, made: datetime.date | None) -> Entry:
    record = read_calibration_record(path)
    unit = {"mm": "mm", "deg": "deg"}
    results = {p.name: Result(p.value, p.u, unit.get(p.name.rpartition("_")[2], "")) for p in record.parameters}
    uses = tuple(i.sha256 for i in record.inputs if i.file.endswith(".xml"))
    return Entry("calibration", digest_of(path), str(path), record.rig, made or datetime.date.today(), results, uses, record.settings)


def _of_dcc(path: Path, made: datetime.date | None) -> Entry:
    dcc = read_dcc(path)
    results = {r.name: Result(r.value, r.u, r.unit) for r in dcc.results}
    day = made or dcc.performed or datetime.date.today()
    about = {"id": dcc.identifier, "laboratory": dcc.laboratory}
    return Entry("reference", digest_of(path), str(path), dcc.item or dcc.identifier, day, results, (), about)


def _of_checks(path: Path) -> Iterator[Entry]:
    """Yield one entry for each time at which the instrument was checked."""
    table = files.read_table(path)
    if tuple(table.columns) != COLUMNS:
        raise CertificationError(message("error.is_no_file_of_intermediate", where=path, columns=", ".join(COLUMNS)))
    rows = list(zip(*(table.text(name) for name in COLUMNS), strict=True))
    for time in dict.fromkeys(row[0] for row in rows):
        own = [row for row in rows if row[0] == time]
        results = {f"{kind} {name}": Result(float(v), float(u) / NORMAL_95, "mm") for _, _, kind, name, v, u, _, _ in own}
        content = json.dumps(own).encode()
        day = datetime.date.fromisoformat(time[:10])
        verdict = {"time": time, "verdict": own[0][7]}
        yield Entry("check", hashlib.sha256(content).hexdigest(), str(path), own[0][1], day, results, (), verdict)
