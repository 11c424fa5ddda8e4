"""A workbench under test: its application asked as a browser with the token asks, and a real server as a process."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from starlette.testclient import TestClient

from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig
from lmeasure.workbench.guard import Door
from lmeasure.workbench.project_list import Shelf
from lmeasure.workbench.server import Desk, Served, application

TOKEN, PORT = "a-token-of-the-test", 8123
HOST = f"127.0.0.1:{PORT}"
ORIGIN = f"http://{HOST}"
SEALED = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run"


@contextmanager
def client(folder: Path, *, token: str | None = TOKEN, shelf: Shelf | None = None) -> Iterator[TestClient]:
    """A program that knows the token; without it, a stranger."""
    with TestClient(
        application(folder, Door(TOKEN), PORT, shelf=shelf), base_url=ORIGIN, follow_redirects=False, raise_server_exceptions=False
    ) as requested:
        requested.headers["Origin"] = ORIGIN
        if token is not None:
            requested.headers["Authorization"] = f"Bearer {token}"
        yield requested


@contextmanager
def session(folder: Path, *, shelf: Shelf | None = None) -> Iterator[TestClient]:
    """A browser that was let in: its addresses lie behind its session's path, and it has the session's cookie."""
    door = Door(TOKEN)
    known = door.spend(door.code())
    assert known is not None
    with TestClient(
        application(folder, door, PORT, shelf=shelf), base_url=ORIGIN + known.path, follow_redirects=False, raise_server_exceptions=False
    ) as requested:
        requested.headers["Origin"] = ORIGIN
        requested.cookies.set(f"lmeasure-{PORT}", known.cookie)
        yield requested


def stranger(to: TestClient) -> TestClient:
    """One who asks the server of another, with nothing of his."""
    return TestClient(to.app, base_url=ORIGIN, follow_redirects=False, raise_server_exceptions=False)


@contextmanager
def served(folder: Path, within: Path | None = None) -> Iterator[str]:
    """The address that lets in one browser, of a server in a thread of this process; within: a folder of projects."""
    folder.mkdir(parents=True, exist_ok=True)
    desk = Desk("en")
    server = Served(folder, 0, "en", None if within is None else Shelf(within, desk))
    desk.put(folder, server)
    server.begin()
    try:
        yield server.address()
    finally:
        desk.close()


@contextmanager
def served_apart(folder: Path, browser: str = "") -> Iterator[str]:
    """The address that lets in one browser, of a server of its own process, which is killed at the end if it has not ended; browser: a
    program that it opens with its page."""
    words = [sys.executable, "-m", "lmeasure", "workbench", str(folder), *(() if browser else ("--no-browser",))]
    environment = os.environ | {"BROWSER": browser}
    # a browser opens only from a terminal
    ours, theirs = os.openpty() if browser else os.pipe()
    process = subprocess.Popen(words, stdout=theirs, stderr=subprocess.STDOUT, start_new_session=True, env=environment)
    os.close(theirs)
    try:
        with os.fdopen(ours, encoding="utf-8") as printed:
            line = printed.readline()
            assert "http://127.0.0.1:" in line, line
            yield next(word for word in line.split() if word.startswith("http://"))
    finally:
        process.kill()
        process.wait()


def token(folder: Path) -> str:
    """The token for programs of the server of a project."""
    return (folder / ".workbench" / "token").read_text().strip()


def kill_server(address_file: Path) -> None:
    """As a power failure would, the server alone: its port tells which process it is."""
    port = address_file.read_text().split(":")[2].split("/")[0]
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = entry.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"workbench" in words and str(address_file.parents[1]).encode() in words:
            os.kill(int(entry.parent.name), signal.SIGKILL)
            return
    raise AssertionError(f"no server at {port}")


def until(true: "object", seconds: float = 180.0) -> None:
    """Wait for what is called to be true; AssertionError when it never is."""
    end = time.monotonic() + seconds
    while not true():  # type: ignore[operator]
        assert time.monotonic() < end, "never true"
        time.sleep(0.05)


def some_files_of_the_demo(folder: Path) -> None:
    """The simulated cell, with a run, a calibration and a certificate."""
    shutil.copytree(SEALED, folder / "cell" / "certificate")
    shutil.copytree(SEALED / "inputs" / "run", folder / "cell" / "run")
    shutil.copy(SEALED / "inputs" / "trajectory.parquet", folder / "cell" / "trajectory.parquet")
    (folder / "cell" / "campaign").mkdir()
    (folder / "cell" / "calibration").mkdir()
    (folder / "cell" / "calibration" / "report.html").write_text("<!doctype html><title>calibration</title>")
    (folder / "cell" / "certificate" / "report.html").write_text("<!doctype html><title>certificate</title>")
    write_rig(folder / "cell" / "campaign" / "rig.toml", cell_rig(0))
