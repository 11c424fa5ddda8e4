"""A register of calibrations, intermediate checks, certificates and references: append-only, each row chained to the row before.

    hash of a row = SHA-256(hash of the row before, its content as canonical JSON, author and time)

A changed, removed or inserted row breaks the chain from there on (`Register.faults`); the newest hash, kept elsewhere, shows that no row
was removed at the end. The database refuses changes too (triggers). SQLAlchemy speaks to SQLite and to PostgreSQL, so that several machines
may share a register. The table `version` has the number of each version that the register went through.
"""

import datetime
import hashlib
import itertools
import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import sqlalchemy as sa

from lmeasure.certificate import CERTIFICATE, canonical, read_certificate, read_dcc
from lmeasure.core import CertificationError, FloatArray
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


FILE = "register.sqlite"
AT_ONCE = 500
"""Documents that are read or written together."""
VERSION = 2
ORIGIN = "0" * 64
"""The hash before the first row."""
_meta = sa.MetaData()
_entry = sa.Table(
    "entry", _meta,
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("kind", sa.String(16), nullable=False, index=True),
    sa.Column("digest", sa.String(64), nullable=False, unique=True),
    sa.Column("path", sa.Text, nullable=False),
    sa.Column("subject", sa.Text, nullable=False),
    sa.Column("made", sa.String(10), nullable=False),
    sa.Column("settings", sa.JSON, nullable=False),
    sa.Column("added", sa.String(20), nullable=False),
    sa.Column("who", sa.Text, nullable=False),
    sa.Column("hash", sa.String(64), nullable=False),
)  # fmt: skip
_result = sa.Table(
    "result", _meta,
    sa.Column("entry", sa.ForeignKey("entry.number"), primary_key=True),
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("value", sa.Double, nullable=False),
    sa.Column("u", sa.Double),
    sa.Column("unit", sa.Text, nullable=False),
    sa.Index("result_name", "name", "entry"),
)  # fmt: skip
_use = sa.Table(
    "use", _meta,
    sa.Column("entry", sa.ForeignKey("entry.number"), primary_key=True),
    sa.Column("digest", sa.String(64), primary_key=True, index=True),
)  # fmt: skip
_version = sa.Table("version", _meta, sa.Column("number", sa.Integer, primary_key=True))
_by_subject = sa.Index("entry_of_subject", _entry.c.subject, _entry.c.kind, _entry.c.made)


def _index_subjects_by_kind(connection: sa.Connection) -> None:
    connection.execute(sa.text("DROP INDEX IF EXISTS ix_entry_subject"))
    _by_subject.create(connection, checkfirst=True)


STEPS: dict[int, Callable[[sa.Connection], None]] = {2: _index_subjects_by_kind}
"""SQL statements that bring a register from the version before to each version. Rows do not change, so the chain still verifies."""


class Subject(NamedTuple):
    """A subject of a register: how many documents of a kind it has, and the day of the last."""

    subject: str
    kind: str
    documents: int
    last: str


class Series(NamedTuple):
    """A result over time, oldest first: days since 1970, values and standard uncertainties (NaN where none), (n,) each, and the unit."""

    days: FloatArray
    values: FloatArray
    u: FloatArray
    unit: str


class Register:
    """A register in a folder, or behind a database's URL.

    Parameters
    ----------
    place
        Folder of the register, made if it is not there; or an SQLAlchemy URL such as `postgresql+psycopg://host/name`.

    Raises
    ------
    CertificationError
        If the database cannot be opened, or a newer program wrote it.
    """

    def __init__(self, place: Path | str) -> None:
        url = str(place)
        self.path = None if "://" in url else Path(place) / FILE
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            url = f"sqlite:///{self.path}"
        self.name = str(self.path or sa.make_url(url).render_as_string())
        try:
            self._engine = sa.create_engine(url)
            if self.path is not None:
                sa.event.listen(self._engine, "connect", _prepared)
            found = self._version()
            if found is not None and found < VERSION and self.path is not None:
                self.backup(self.path.with_name(f"{self.path.stem}-v{found}{self.path.suffix}"))
            if found is None or found < VERSION:
                self._update()
        except (sa.exc.SQLAlchemyError, ModuleNotFoundError) as error:
            raise CertificationError(message("error.cannot_be_opened", where=self.name, error=str(error).splitlines()[0])) from None
        if found is not None and found > VERSION:
            raise CertificationError(message("error.is_of_version_this", where=self.name, found=found, version=VERSION))

    def _version(self) -> int | None:
        """Return the version of the database's tables; None where there are none."""
        with self._engine.connect() as connection:
            if not sa.inspect(connection).has_table(_version.name):
                return None
            return connection.execute(sa.select(sa.func.max(_version.c.number))).scalar()

    def _update(self) -> None:
        """Make the tables, or bring them to this version, all or nothing; another process may have done so meanwhile."""
        with self._alone("SELECT pg_advisory_xact_lock(9283)") as connection:
            _meta.create_all(connection)
            found = connection.execute(sa.select(sa.func.max(_version.c.number))).scalar() or VERSION
            for number in range(found + 1, VERSION + 1):
                STEPS[number](connection)
            if connection.execute(sa.select(_version.c.number).where(_version.c.number == VERSION)).first() is None:
                connection.execute(_version.insert().values(number=VERSION))
            for text in _REFUSALS.get(self._engine.dialect.name, ()):
                connection.exec_driver_sql(text)

    @contextmanager
    def _alone(self, postgresql: str) -> Iterator[sa.Connection]:
        """Give a connection that writes, all or nothing, while no other does."""
        with self._stated_errors(), self._engine.begin() as connection:
            if self._engine.dialect.name == "sqlite":
                connection.exec_driver_sql("BEGIN IMMEDIATE")
            elif self._engine.dialect.name == "postgresql":
                connection.exec_driver_sql(postgresql)
            yield connection

    @contextmanager
    def _reading(self) -> Iterator[sa.Connection]:
        with self._stated_errors(), self._engine.connect() as connection:
            yield connection

    @contextmanager
    def _stated_errors(self) -> Iterator[None]:
        """Raise CertificationError for an error of the database, in one line."""
        try:
            yield
        except sa.exc.SQLAlchemyError as error:
            reason = str(error).splitlines()[0]
            raise CertificationError(message("error.database_refuses", where=self.name, error=reason)) from None

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def add(self, entries: Iterable[Entry], who: str, now: datetime.datetime | None = None) -> tuple[Entry, ...]:
        """Append documents, all or none; the ones that were added: a document that is there already is passed over."""
        moment = (now or datetime.datetime.now(datetime.UTC)).strftime("%Y-%m-%dT%H:%M:%SZ")
        added = []
        # two machines would else give two rows one number
        with self._alone("LOCK TABLE entry IN EXCLUSIVE MODE") as connection:
            last = connection.execute(sa.select(_entry.c.number, _entry.c.hash).order_by(_entry.c.number.desc()).limit(1)).first()
            number, before = (0, ORIGIN) if last is None else (last.number, last.hash)
            left, known = iter(entries), set[str]()
            while part := tuple(itertools.islice(left, AT_ONCE)):
                there = sa.select(_entry.c.digest).where(_entry.c.digest.in_([entry.digest for entry in part]))
                known |= set(connection.execute(there).scalars())
                rows: dict[Any, list[dict[str, Any]]] = {_entry: [], _result: [], _use: []}
                for entry in part:
                    if entry.digest in known:
                        continue
                    known.add(entry.digest)
                    number, before = number + 1, _chained(before, entry, moment, who)
                    row = {"number": number, "kind": entry.kind, "digest": entry.digest, "path": entry.path, "subject": entry.subject}
                    row |= {"made": entry.made.isoformat(), "settings": dict(entry.settings), "added": moment, "who": who, "hash": before}
                    rows[_entry].append(row)
                    rows[_result] += [
                        {"entry": number, "name": n, "value": r.value, "u": r.u, "unit": r.unit} for n, r in entry.results.items()
                    ]
                    rows[_use] += [{"entry": number, "digest": d} for d in dict.fromkeys(entry.uses)]
                    added.append(entry)
                for table, new in rows.items():
                    if new:
                        connection.execute(table.insert(), new)
        return tuple(added)

    def subjects(self) -> tuple[Subject, ...]:
        """Return the subjects of the register by kind of document, in order of their names."""
        e = _entry.c
        chosen = sa.select(e.subject, e.kind, sa.func.count(), sa.func.max(e.made))
        with self._reading() as connection:
            rows = connection.execute(chosen.group_by(e.subject, e.kind).order_by(e.subject, e.kind)).all()
        return tuple(Subject(*row) for row in rows)

    def used(self, most: int = 1000) -> tuple[Entry, ...]:
        """Return the registered documents that others depend on, the newest first."""
        chosen = sa.select(_entry).where(_entry.c.digest.in_(sa.select(_use.c.digest))).order_by(_entry.c.made.desc()).limit(most)
        with self._reading() as connection:
            return tuple(entry for _, entry in self._whole(connection, connection.execute(chosen).all()))

    def entries(self, kind: str = "", subject: str = "") -> tuple[Entry, ...]:
        """Return documents, oldest measurement first: all, of one kind, of one subject."""
        chosen = sa.select(_entry).order_by(_entry.c.made, _entry.c.number)
        chosen = chosen.where(_entry.c.kind == kind) if kind else chosen
        chosen = chosen.where(_entry.c.subject == subject) if subject else chosen
        with self._reading() as connection:
            return tuple(entry for _, entry in self._whole(connection, connection.execute(chosen).all()))

    def series(self, subject: str, result: str, kind: str = "certificate") -> Series:
        """Return a result of a subject over time."""
        return self.series_of([(subject, result, kind)])[subject, result, kind]

    def series_of(self, wanted: Iterable[tuple[str, str, str]]) -> dict[tuple[str, str, str], Series]:
        """Return results over time by subject, name of the result and kind of document."""
        rows: dict[tuple[str, str, str], list[Any]] = {key: [] for key in wanted}
        together: dict[tuple[str, str], list[str]] = {}
        for subject, result, kind in rows:
            together.setdefault((result, kind), []).append(subject)
        columns = (_entry.c.subject, _entry.c.made, _result.c.value, _result.c.u, _result.c.unit)
        chosen = sa.select(*columns).join(_result, _result.c.entry == _entry.c.number).order_by(_entry.c.made, _entry.c.number)
        with self._reading() as connection:
            for (result, kind), subjects in together.items():
                of = chosen.where(_entry.c.kind == kind, _result.c.name == result)
                for part in (subjects[i : i + AT_ONCE] for i in range(0, len(subjects), AT_ONCE)):
                    for subject, *row in connection.execute(of.where(_entry.c.subject.in_(part))).all():
                        rows[subject, result, kind].append(row)
        return {key: self._series(key, found) for key, found in rows.items()}

    def _series(self, key: tuple[str, str, str], rows: Sequence[Any]) -> Series:
        made, values, u, units = zip(*rows, strict=True) if rows else ((), (), (), ())
        if len(unit := sorted(set(units))) > 1:
            raise CertificationError(
                message("error.of_is_stated_in", where=self.name, result=key[1], subject=key[0], units=" and ".join(unit))
            )
        days = np.array(made, dtype="datetime64[D]").astype(np.float64)
        return Series(days, np.array(values, dtype=np.float64), np.array(u, dtype=np.float64), unit[0] if unit else "")

    def results(self, subject: str, kind: str = "certificate") -> tuple[str, ...]:
        """Return the names of the results of a subject."""
        chosen = sa.select(_result.c.name).join(_entry, _entry.c.number == _result.c.entry).distinct()
        chosen = chosen.where(_entry.c.subject == subject, _entry.c.kind == kind).order_by(_result.c.name)
        with self._reading() as connection:
            return tuple(connection.execute(chosen).scalars())

    def recall(self, digest: str) -> tuple[Entry, ...]:
        """Return the documents that depend on a document, directly or by others, oldest first."""
        found: dict[int, Entry] = {}
        with self._reading() as connection:
            left = [digest]
            while left:
                chosen = sa.select(_entry).join(_use, _use.c.entry == _entry.c.number).where(_use.c.digest.in_(left))
                new = {n: e for n, e in self._whole(connection, connection.execute(chosen).all()) if n not in found}
                found |= new
                left = [entry.digest for entry in new.values()]
        return tuple(found[n] for n in sorted(found))

    def knows(self, digests: Sequence[str]) -> bool:
        """Return whether one of these documents is registered."""
        with self._reading() as connection:
            return connection.execute(sa.select(_entry.c.number).where(_entry.c.digest.in_(digests))).first() is not None

    def faults(self) -> tuple[str, ...]:
        """Return the faults of the chain: one line for each row that is not as it was added."""
        out, before, wanted = [], ORIGIN, 1
        with self._reading() as connection:
            rows = connection.execute(sa.select(_entry).order_by(_entry.c.number)).all()
            for row, (number, entry) in zip(rows, self._whole(connection, rows), strict=True):
                if number != wanted:
                    out.append(f"{self.name}: rows {wanted} to {number - 1} are missing")
                if _chained(before, entry, row.added, row.who) != row.hash:
                    out.append(f"{self.name}: row {number} ({entry.kind} of {entry.subject}, {entry.made}) is not as it was added")
                before, wanted = row.hash, number + 1
        return tuple(out)

    @property
    def newest(self) -> str:
        """The hash of the newest row: written down elsewhere, it proves that no row was cut off."""
        with self._reading() as connection:
            return connection.execute(sa.select(_entry.c.hash).order_by(_entry.c.number.desc()).limit(1)).scalar() or ORIGIN

    def backup(self, path: Path) -> None:
        """Write a copy of an SQLite register while others use it."""
        if self.path is None:
            raise CertificationError(message("error.is_no_file_back", where=self.name))
        with closing(sqlite3.connect(self.path)) as source, closing(sqlite3.connect(path)) as target:
            source.backup(target)

    def _whole(self, connection: Any, rows: Sequence[Any]) -> Iterator[tuple[int, Entry]]:
        """Yield rows with their results and uses."""
        numbers = [row.number for row in rows]
        results: dict[int, dict[str, Result]] = {}
        uses: dict[int, list[str]] = {}
        for part in (numbers[i : i + AT_ONCE] for i in range(0, len(numbers), AT_ONCE)):
            for r in connection.execute(sa.select(_result).where(_result.c.entry.in_(part))):
                results.setdefault(r.entry, {})[r.name] = Result(r.value, r.u, r.unit)
            for r in connection.execute(sa.select(_use).where(_use.c.entry.in_(part))):
                uses.setdefault(r.entry, []).append(r.digest)
        for row in rows:
            made, used = datetime.date.fromisoformat(row.made), tuple(uses.get(row.number, ()))
            yield row.number, Entry(row.kind, row.digest, row.path, row.subject, made, results.get(row.number, {}), used, row.settings)


_TABLES = (_entry.name, _result.name, _use.name)
_REFUSALS = {
    "sqlite": tuple(
        f"CREATE TRIGGER IF NOT EXISTS {name}_{change.lower()} BEFORE {change} ON {name} "
        "BEGIN SELECT RAISE(ABORT, 'a register is append-only'); END"
        for name in _TABLES
        for change in ("UPDATE", "DELETE")
    ),
    "postgresql": (
        "CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql "
        "AS 'BEGIN RAISE EXCEPTION ''a register is append-only''; END'",
        *(
            f"CREATE OR REPLACE TRIGGER {name}_change BEFORE UPDATE OR DELETE OR TRUNCATE ON {name} "
            "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
            for name in _TABLES
        ),
    ),
}
"""Triggers of each database that refuse changes."""


def _prepared(connection: Any, record: Any) -> None:
    """Set up a connection of SQLite: a log beside the file, so that readers do not wait; foreign keys are checked."""
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA foreign_keys = ON")
    connection.execute("PRAGMA busy_timeout = 10000")


def _chained(before: str, entry: Entry, added: str, who: str) -> str:
    content = b"\n".join((before.encode(), entry.as_json(), added.encode(), who.encode()))
    return hashlib.sha256(content).hexdigest()
