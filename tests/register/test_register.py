"""The register by its command and face: what is added is found again, changes are noticed, drift and recall follow."""

import datetime
import json
import multiprocessing
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy
from in_process import code_and_text, ran
from postgresql import postgresql

from lmeasure.certificate import canonical
from lmeasure.core import LMeasureError
from lmeasure.register import Entry, Register, Result, due, read_limits

SEALED = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run"
DAY = datetime.date(2026, 3, 1)


def entry(number: int, kind: str = "certificate", uses: tuple[str, ...] = (), subject: str = "R-1", **results: float) -> Entry:
    made = DAY + datetime.timedelta(days=number)
    values = {name.replace("_P", "_p P"): Result(value, 0.01, "mm") for name, value in results.items()}
    return Entry(kind, f"{number:064x}", f"/c/{number}", subject, made, values, uses)


def run(*arguments: object) -> tuple[int, str]:
    code, text = code_and_text("register", *arguments)
    return code, " ".join(text.split())


@pytest.fixture
def register(tmp_path: Path) -> Any:
    one = Register(tmp_path / "reg")
    yield one
    one.close()


def certificate_folder(folder: Path, value: float, day: str, calibration: str) -> Path:
    """A certificate as far as a register reads it."""
    folder.mkdir()
    content = json.loads((SEALED / "certificate.json").read_text())
    figure = {"name": "AP_p", "pose": "P1", "value": value, "unit": "mm", "u95": 0.02, "coverage_factor": 2.0, "capable": True}
    details = {"item": {"serial": "0042"}, "dates": {"measured_to": day}}
    used = [*content["inputs"], {"file": "inputs/run/calibration.json", "bytes": 1, "sha256": calibration}]
    content |= {"details": content["details"] | details, "characteristics": [content["characteristics"][0] | figure], "inputs": used}
    (folder / "certificate.json").write_bytes(canonical(content))
    return folder


def test_certificates_are_added_once_and_found(tmp_path: Path) -> None:
    folders = [certificate_folder(tmp_path / f"c{i}", 0.5 + 0.01 * i, f"2026-0{i + 1}-15", "ab" * 32) for i in range(5)]
    added = [word for folder in folders for word in ("--add", folder)]
    code, text = run(tmp_path / "reg", *added, "--who", "A. Head")
    assert (code, "5 added" in text, "5 certificates" in text) == (0, True, True), text
    assert "0 added, 5 registered before" in run(tmp_path / "reg", *added)[1]
    code, text = run(tmp_path / "reg", "--subject", "0042", "--result", "AP_p P1")
    assert (code, text.count("± 0.01 mm"), "drift" in text) == (0, 5, True), text
    code, text = run(tmp_path / "reg", "--export", tmp_path / "all.csv", "--backup", tmp_path / "copy.sqlite", "--json")
    assert code == 0
    assert (tmp_path / "all.csv").read_text().count("AP_p P1") == 5
    with closing(sqlite3.connect(tmp_path / "copy.sqlite")) as copy:
        assert copy.execute("select count(*) from entry").fetchone() == (5,)


def test_what_is_no_document_adds_nothing(tmp_path: Path) -> None:
    good = certificate_folder(tmp_path / "c", 0.5, "2026-01-15", "ab" * 32)
    (tmp_path / "empty").mkdir()
    code, text = run(tmp_path / "reg", "--add", good, "--add", tmp_path / "empty")
    assert (code, "is no folder of a certificate" in text) == (1, True)
    assert "Begin one with --add" in run(tmp_path / "reg")[1]
    assert not (tmp_path / "reg").exists()


def test_an_unsigned_certificate_is_refused_where_keys_are_kept(tmp_path: Path) -> None:
    good = certificate_folder(tmp_path / "c", 0.5, "2026-01-15", "ab" * 32)
    (tmp_path / "reg" / "keys").mkdir(parents=True)
    ran("key", "--out", tmp_path / "lab.pem")
    (tmp_path / "lab.pem.pub").rename(tmp_path / "reg" / "keys" / "lab.pem.pub")
    code, text = run(tmp_path / "reg", "--add", good)
    assert (code, "is not registered" in text) == (1, True), text


@pytest.mark.parametrize(
    "change",
    [
        "update result set value = 0.4 where entry = 2",
        "update entry set subject = 'R-2' where number = 2",
        "update entry set made = '2020-01-01' where number = 2",
        "update entry set who = 'B' where number = 2",
        "delete from result where entry = 2",
        "delete from entry where number = 2",
        "update use set digest = 'x' where entry = 2",
        "insert into result values (2, 'more', 1.0, null, 'mm')",
    ],
)
def test_every_change_is_noticed(register: Register, change: str) -> None:
    """The database refuses a change; whoever takes the triggers away is found by the chain. Only an insertion needs no trigger."""
    register.add([entry(n, uses=("f" * 64,), AP_P1=0.5) for n in range(1, 5)], "A")
    assert register.faults() == ()
    with closing(sqlite3.connect(str(register.path))) as database:
        if not change.startswith("insert"):
            with pytest.raises(sqlite3.IntegrityError, match="append-only"):
                database.execute(change)
        for (name,) in database.execute("select name from sqlite_master where type = 'trigger'").fetchall():
            database.execute(f"drop trigger {name}")
        database.execute(change)
        database.commit()
    assert any("2" in fault for fault in register.faults())
    code, text = run(Path(str(register.path)).parent, "--verify")
    assert (code, "not as it was added" in text) == (1, True), text


def test_recall_follows_every_use(register: Register) -> None:
    calibration, check = entry(1, "calibration"), entry(2, "check", (f"{1:064x}",))
    register.add(
        [calibration, check, entry(3, uses=(check.digest,)), entry(4, uses=("e" * 64,)), entry(5, uses=(calibration.digest,))], "A"
    )
    assert [e.digest for e in register.recall(calibration.digest)] == [f"{n:064x}" for n in (2, 3, 5)]


def test_recall_of_what_nobody_knows_is_refused(register: Register, tmp_path: Path) -> None:
    register.add([entry(1)], "A")
    (tmp_path / "other.json").write_text("{}")
    code, text = run(tmp_path / "reg", "--recall", tmp_path / "other.json")
    assert (code, "is not in the register" in text) == (1, True), text


def test_the_next_calibration_is_due_when_the_drift_reaches_the_limit(register: Register, tmp_path: Path) -> None:
    today = datetime.date.today()
    drifting = [
        Entry("certificate", f"{n:064x}", "", "R-1", today - datetime.timedelta(days=100 * (5 - n)),
              {"AP_p P1": Result(0.5 + 0.02 * n, 1e-4, "mm")})
        for n in range(6)
    ]  # fmt: skip
    register.add(drifting, "A")
    (tmp_path / "reg" / "limits.toml").write_text(
        'schema = "lmeasure.limits/1"\n[[limit]]\nsubject = "R-1"\nresult = "AP_p P1"\nupper = 0.64\n'
        '[[limit]]\nsubject = "R-9"\nresult = "AP_p P1"\nupper = 0.64\n'
    )
    code, text = run(tmp_path / "reg", "--json")
    assert code == 0, text
    made = json.loads(text)["made"]["due"]
    never, later = made
    assert (never["subject"], never["day"]) == ("R-9", None)
    # 0.60 today, 0.0002 a day: 200 days, less what the uncertain walk takes
    assert 100 < (datetime.date.fromisoformat(later["day"]) - today).days <= 200
    assert later["drift_per_year"][0] == pytest.approx(0.0731, rel=0.02)
    (tmp_path / "reg" / "limits.toml").write_text('schema = "lmeasure.limits/1"\n[[limit]]\nsubject = "R-1"\nresult = "AP_p P1"\n')
    code, text = run(tmp_path / "reg")
    assert (code, "limits.toml" in text) == (1, True)


def test_many_subjects_are_due_as_each_by_itself(register: Register, tmp_path: Path) -> None:
    """Series of 1 to 12 values, forecast together, as one register of each would be."""
    rng = np.random.default_rng(4)
    for robot in range(1, 13):
        days = np.sort(rng.integers(0, 2000, robot))
        register.add(
            [
                Entry("certificate", f"{100 * robot + n:064x}", "", f"R-{robot}", DAY + datetime.timedelta(days=int(day)),
                      {"AP_p P1": Result(1e6 + 1e-4 * day + 0.01 * rng.normal(), None if robot == 7 else 0.01, "mm")})
                for n, day in enumerate(days)
            ],
            "A",
        )  # fmt: skip
    path = tmp_path / "reg" / "limits.toml"
    limits = [f'[[limit]]\nsubject = "R-{robot}"\nresult = "AP_p P1"\nupper = {1e6 + 0.25}\n' for robot in range(1, 14)]
    alone: list[Any] = []
    for limit in limits:
        path.write_text('schema = "lmeasure.limits/1"\n' + limit)
        alone += due(register, read_limits(path.parent))
    path.write_text('schema = "lmeasure.limits/1"\n' + "".join(limits))
    together = due(register, read_limits(path.parent))
    assert {d.limit.subject: (d.day, d.beyond) for d in together} == {d.limit.subject: (d.day, d.beyond) for d in alone}
    assert [d.day for d in together[1:]] == sorted(d.day for d in alone if d.day)


def _append(place: str, first: int) -> None:
    one = Register(place)
    for n in range(first, first + 20):
        one.add([entry(n, AP_P1=0.5)], f"P{first}")
    one.close()


def both_append(place: str) -> None:
    """Two processes, which begin at the same time, append 20 rows each; in a database neither of them finds tables."""
    context = multiprocessing.get_context("spawn")
    both = [context.Process(target=_append, args=(place, first)) for first in (1, 100)]
    for process in both:
        process.start()
    for process in both:
        process.join(120)
    assert [process.exitcode for process in both] == [0, 0]


def test_two_processes_append_to_one_chain(register: Register) -> None:
    both_append(str(Path(str(register.path)).parent))
    assert len(register.entries()) == 40
    assert register.faults() == ()


def test_two_processes_share_a_register_in_postgresql(tmp_path: Path) -> None:
    with postgresql() as url:
        both_append(url)
        code, text = run(tmp_path, "--database", url, "--verify")
        assert (code, "as it was written" in text) == (0, True), text
        folder = certificate_folder(tmp_path / "c", 0.5, "2026-01-15", "ab" * 32)
        assert "1 added" in run(tmp_path, "--database", url, "--add", folder)[1]
        assert "± 0.01 mm" in run(tmp_path, "--database", url, "--subject", "0042", "--result", "AP_p P1")[1]
        assert "back it up" in run(tmp_path, "--database", url, "--backup", tmp_path / "copy.sqlite")[1]
        shared = Register(url)
        assert [e.subject for e in shared.recall("ab" * 32)] == ["0042"]
        engine = sqlalchemy.create_engine(url)
        change = "UPDATE result SET value = 0.4 WHERE entry = 2"
        for text in (change, "DELETE FROM entry", "TRUNCATE use"):
            with pytest.raises(sqlalchemy.exc.SQLAlchemyError, match="append-only"), engine.begin() as connection:
                connection.exec_driver_sql(text)
        with engine.begin() as connection:
            connection.exec_driver_sql("DROP TRIGGER result_change ON result")
            connection.exec_driver_sql(change)
        assert [fault for fault in shared.faults() if "row 2 " in fault]
        with engine.begin() as connection:
            connection.exec_driver_sql("DROP TABLE use")
        with pytest.raises(LMeasureError, match="the database cannot do this"):
            shared.recall("ab" * 32)
        shared.close()
        engine.dispose()
    code, text = run(tmp_path, "--database", url, "--verify")
    assert (code, "cannot be opened" in text) == (1, True), text


def test_an_earlier_register_is_updated_and_copied_and_a_later_one_left_alone(register: Register, tmp_path: Path) -> None:
    register.add([entry(n, AP_P1=0.5) for n in range(1, 4)], "A")
    with closing(sqlite3.connect(str(register.path))) as database:  # as version 1 had it
        database.executescript(
            "DELETE FROM version; INSERT INTO version VALUES (1);"
            "DROP INDEX entry_of_subject; CREATE INDEX ix_entry_subject ON entry (subject)"
        )
    now = Register(tmp_path / "reg")
    assert (len(now.entries()), now.faults(), now.newest) == (3, (), register.newest)
    now.close()
    with closing(sqlite3.connect(str(register.path))) as database:
        names = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'index'")}
        assert ("entry_of_subject" in names, "ix_entry_subject" in names) == (True, False)
        assert database.execute("SELECT number FROM version ORDER BY number").fetchall() == [(1,), (2,)]
        database.execute("INSERT INTO version VALUES (3)")
        database.commit()
    with closing(sqlite3.connect(tmp_path / "reg" / "register-v1.sqlite")) as copy:
        assert copy.execute("SELECT max(number), (SELECT count(*) FROM entry) FROM version").fetchone() == (1, 3)
    code, text = run(tmp_path / "reg")
    assert (code, "update lmeasure" in text) == (1, True)


def test_what_is_no_database_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "register.sqlite").write_text("x" * 5000)
    code, text = run(tmp_path)
    assert (code, "cannot be opened" in text) == (1, True)
    code, text = run(tmp_path, "--database", "nothing://x")
    assert (code, "cannot be opened" in text) == (1, True)
