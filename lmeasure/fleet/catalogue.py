"""Catalogue of a store: what has been done, by which version, from which inputs, and what came of it."""

import datetime
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import sqlalchemy as sa

from lmeasure.core import LMeasureError
from lmeasure.text import message

DONE, FAILED = "done", "failed"
_meta = sa.MetaData()
_item = sa.Table(
    "item", _meta,
    sa.Column("command", sa.String(32), primary_key=True),
    sa.Column("robot", sa.String(255), primary_key=True),
    sa.Column("day", sa.String(255), primary_key=True),
    sa.Column("name", sa.String(255), primary_key=True),
    sa.Column("state", sa.String(8), nullable=False, index=True),
    sa.Column("line", sa.Text, nullable=False),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("output", sa.Text, nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("figures", sa.JSON, nullable=False),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("seconds", sa.Double, nullable=False),
    sa.Column("version", sa.String(32), nullable=False),
    sa.Column("finished", sa.String(20), nullable=False),
)  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """Outcome of an item.

    digest: SHA-256 of the command, its options and the bytes of its inputs; sha256: of what it wrote; line: why it failed.
    """

    command: str
    robot: str
    day: str
    name: str
    state: str
    line: str = ""
    digest: str = ""
    output: str = ""
    sha256: str = ""
    figures: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    version: str = ""
    finished: str = ""

    @property
    def item(self) -> tuple[str, str, str]:
        """Return robot, day and name."""
        return self.robot, self.day, self.name


class Catalogue:
    """Table of items in an SQLite file, or behind a database's URL.

    Parameters
    ----------
    place
        File, or an SQLAlchemy URL such as `postgresql+psycopg://host/name`.
    """

    def __init__(self, place: str) -> None:
        url = place if "://" in place else f"sqlite:///{Path(place)}"
        self.name = place if "://" not in place else sa.make_url(url).render_as_string()
        try:
            self._engine = sa.create_engine(url, connect_args={"timeout": 60} if url.startswith("sqlite:") else {})
            with self._engine.begin() as connection:
                if url.startswith("sqlite:"):
                    connection.exec_driver_sql("PRAGMA journal_mode = WAL")
                _meta.create_all(connection)
        except (sa.exc.SQLAlchemyError, ModuleNotFoundError) as error:
            raise LMeasureError(message("error.cannot_be_opened_as", where=self.name, error=str(error).splitlines()[0])) from None

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def add(self, outcomes: Sequence[Outcome]) -> None:
        """Write outcomes over earlier ones of the same items, all or none."""
        now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        rows = [{**asdict(one), "warnings": list(one.warnings), "finished": now} for one in outcomes]
        try:
            with self._engine.begin() as connection:
                for row in rows:
                    same = sa.and_(*(_item.c[key] == row[key] for key in ("command", "robot", "day", "name")))
                    connection.execute(sa.delete(_item).where(same))
                    connection.execute(_item.insert().values(**row))
        except sa.exc.SQLAlchemyError as error:
            raise LMeasureError(message("error.cannot_be_written_2", where=self.name, error=str(error).splitlines()[0])) from None

    def outcomes(self, command: str = "") -> tuple[Outcome, ...]:
        """Return the outcomes of a command, or of all, by robot, day and name."""
        chosen = sa.select(_item).order_by(_item.c.command, _item.c.robot, _item.c.day, _item.c.name)
        chosen = chosen.where(_item.c.command == command) if command else chosen
        with self._engine.connect() as connection:
            return tuple(_outcome(row._mapping) for row in connection.execute(chosen))


def _outcome(row: "sa.RowMapping") -> Outcome:
    values = {str(key): value for key, value in row.items()}
    return Outcome(**values | {"warnings": tuple(values["warnings"])})


def failures(found: Iterable[Outcome]) -> list[Outcome]:
    """Return those that failed."""
    return [one for one in found if one.state == FAILED]
