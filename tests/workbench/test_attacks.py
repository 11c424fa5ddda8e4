"""Attacks from outside, by what is brought in, what is asked, what lies in a project: refused in a line, nothing waits, nothing is left."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from html import unescape
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import Request, urlopen

import hostile
import numpy as np
import pytest
from bench import client, served_apart, token
from hostile import DIGITS, LONG
from starlette.testclient import TestClient

from lmeasure.core import FileFormatError
from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig
from lmeasure.workbench import project_files
from lmeasure.workbench.worker import worker


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with a rig and a hidden folder of another program."""
    folder = tmp_path / "project"
    (folder / ".git" / "hooks").mkdir(parents=True)
    (folder / ".git" / "config").write_text("secret")
    write_rig(folder / "rig.toml", cell_rig(0))
    return folder


@pytest.fixture
def session(project: Path) -> Iterator[TestClient]:
    with client(project) as one:
        yield one


def tree(folder: Path) -> dict[str, bytes]:
    """Every file and folder of a project with its content, but for what the workbench keeps of itself."""
    found = (path for path in folder.rglob("*") if ".workbench" not in path.relative_to(folder).parts)
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in found}


def said(text: str) -> str:
    """What a page says is wrong: one line."""
    found = re.search(r'<p class="error" role="alert">([^<]*)</p>', text)
    return unescape(found[1]) if found else ""


def test_no_zip_leaves_anything_or_ends_in_a_fault(session: TestClient, project: Path) -> None:
    before = tree(project.parent)
    for name, content in hostile.zips().items():
        for path, data in (("/upload", {"folder": "in"}), ("/verify", {})):
            answer = session.post(path, data=data, files={"files": ("x.zip", content)})
            assert answer.status_code == 422, (name, path, answer.status_code)
            assert said(answer.text), (name, path)
            assert "\n" not in said(answer.text), (name, path)
            assert "/tmp" not in said(answer.text), (name, said(answer.text))
            assert tree(project.parent) == before, (name, path)


def test_of_several_files_all_are_taken_in_or_none(session: TestClient, project: Path) -> None:
    before = tree(project)
    for second in (("bad.zip", b"no zip"), ("a.csv", b"again"), (".hidden", b""), ("rig.toml", b""), ("a" * 300, b"")):
        answer = session.post("/upload", data={"folder": "."}, files=[("files", ("a.csv", b"1")), ("files", second)])
        assert answer.status_code == 422, second
        assert tree(project) == before, second
    for names in (("c/a", "c/a"), ("c/a", "c/a/b"), ("c/a", ".git/x"), ("c/a", "c/../../x")):
        answer = session.post("/verify", files=[("files", (name, b"1")) for name in names])
        assert answer.status_code == 422, names
        assert tree(project) == before, names


def test_what_is_hidden_is_neither_written_nor_served(session: TestClient, project: Path) -> None:
    before = tree(project)
    for folder in (".git/hooks", "./.git", ".new", "a/.git", "a/../.git/hooks"):
        assert session.post("/upload", data={"folder": folder}, files={"files": ("post-commit", b"x")}).status_code == 422, folder
        assert session.post("/run/init", data={"_form": "1", "template": "six-cables", "out": folder}).status_code == 422, folder
        assert session.post("/details", data={"_file": f"{folder}/d.toml"}).status_code == 404, folder
    for path in ("/raw/.git/config", "/look/.git/config", "/look/.git", "/rig?file=.git/config", "/trajectory/.git/config"):
        answer = session.get(path)
        assert answer.status_code == 404, path
        assert "secret" not in answer.text
    assert tree(project) == before


def test_nothing_that_is_asked_is_a_fault(session: TestClient, project: Path) -> None:
    """Names that are too long, numbers of thousands of digits, half letters, JSON that is deep, and forms without end."""
    half, deep = "\ud800", hostile.deep(900)
    names = (LONG, DIGITS, f"{LONG}/rig.toml", quote("\0"), "a%00b", "%ff%fe", "%ed%a0%80", "я" * 200, "/".join(["d"] * 3000))
    pages = (
        "jobs/", "raw/", "look/", "run/", "start/", "trajectory/", "along/", "export/", "viewer/", "projects/", "api/jobs/", "shown/x/",
        "",
    )  # fmt: skip
    questions = ("rig?file=", "scene?file=", "details?file=", "calibrations?old=x&new=", "run/zone?_form=1&rig=", "?code=")
    for name in names:
        for page in pages:
            assert 400 <= session.get(f"/{page}{name}").status_code < 500, (page, name[:20])
        for question in questions:
            assert session.get(f"/{question}{name}").status_code < 500, (question, name[:20])
        assert session.post("/upload", data={"folder": name}, files={"files": (name, b"x")}).status_code in (303, 400, 422)
    for path, data in (
        ("/run/zone", {"rig": "rig.toml", "out": "z.nc", "u95_mm": DIGITS, "_form": "1"}),
        ("/run/record", {"rig": "rig.toml", "out": "r", "bus": "virtual:x", "seconds": f"1e{DIGITS}", "_form": "1"}),
        ("/run/init", {"out": LONG + "/x", "template": "six-cables", "_form": "1"}),
        ("/rig", {"_file": "rig.toml", "_digest": "x", "observation_point.0.position_mm.0": DIGITS}),
        ("/rig", {"_file": LONG}),
        ("/details", {"_file": "d.toml", "conditions.temperature_c": DIGITS}),
        ("/start/rig.toml", {"start": DIGITS}),
        ("/projects", {"name": LONG}),
        ("/nowhere", {}),
    ):
        assert 400 <= session.post(path, data=data).status_code < 500, path
    for path in ("/details/preview", "/line/zone", "/language"):
        assert session.post(path, data={"rig": DIGITS, "back": DIGITS, "conditions.temperature_c": DIGITS}).status_code < 500
    bodies = [deep, hostile.deep(200_000), DIGITS, "{", "nul", '"\\ud800"', f'{{"command": "zone", "settings": {{"u95_mm": {DIGITS}}}}}']
    bodies += [json.dumps({"command": c, "settings": s}) for c in ("zone", half) for s in ({"rig": half}, {half: 1}, {"rig": {"a": [1]}})]
    bodies += [
        '{"command": "zone", "settings": {"rig": ' + deep + "}}",
        '{"file": "rig.toml", "points": {"B1": [1' + "0" * 400 + ", 0, 0]}}",
    ]
    for body in bodies:
        for path in ("/api/jobs", "/api/jobs/1", "/coarse"):
            answer = session.post(path, content=body.encode(), headers={"Content-Type": "application/json"})
            assert answer.status_code < 500, (path, body[:80])
            assert answer.status_code >= 400 or path == "/coarse", (path, body[:80])
    bound = {"Content-Type": "multipart/form-data; boundary=b"}
    tricky = b'--b\r\nContent-Disposition: form-data; name="name"\r\n\r\n\\ud800\r\n--b--\r\n'
    for content, head in (
        (b"", {"Content-Type": "multipart/form-data"}),
        (b"--b\r\nnothing", bound),
        (b"\r\n" * 10_000, bound),
        (tricky, {"Content-Type": "multipart/form-data; boundary=b; charset=unicode_escape"}),
        (b"&".join(b"f%d=1" % i for i in range(5000)), {"Content-Type": "application/x-www-form-urlencoded"}),
        (b"name=" + b"x" * 3_000_000, {"Content-Type": "application/x-www-form-urlencoded"}),
        (b"name=1", {"Content-Type": "application/x-www-form-urlencoded", "Content-Length": DIGITS}),
    ):
        for path in ("/upload", "/verify", "/projects", "/line/zone", "/details/preview"):
            assert session.post(path, content=content, headers=head).status_code < 500, (path, head)
    for head in (
        {"Cookie": "=" * 5000},
        {"Cookie": '"' + LONG},
        {"Accept-Language": DIGITS},
        {"Content-Type": LONG},
        {"Range": f"bytes={DIGITS}-"},
    ):
        for path in ("/", "/raw/rig.toml"):
            assert session.get(path, headers=head).status_code < 500, head
    assert session.get("/", headers={"X-Long": "x" * 70_000}).status_code == 431


def test_what_is_taken_in_holds_up_nobody(session: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a file is written others are answered."""
    begun, others = threading.Event(), threading.Event()

    def slow(*words: Any, **more: Any) -> Any:
        begun.set()
        assert others.wait(20.0), "others were held up"
        return []

    monkeypatch.setattr(project_files, "take_in", slow)
    answers: list[int] = []
    upload = threading.Thread(target=lambda: answers.append(session.post("/upload", files={"files": ("a.csv", b"1")}).status_code))
    upload.start()
    assert begun.wait(20.0)
    assert session.get("/api/jobs").status_code == 200
    assert session.get("/files").status_code == 200
    others.set()
    upload.join()
    assert answers == [303]


def test_no_file_that_is_none_is_waited_for(project: Path) -> None:
    """A pipe, a device or a folder where a file would be, read by every page that reads one; the server answers on, and ends."""
    runs = project / "runs"
    runs.mkdir()
    (runs / "run.toml").write_text("schema = 'lmeasure.run/1'\nrig = 'rig.toml'\n")
    os.mkfifo(runs / "rig.toml")
    for name, make in hostile.no_files(project).items():
        make(project / name)
    os.mkfifo(project / "pipe.parquet")
    with served_apart(project) as address:
        base, head = address.split("/?")[0], {"Authorization": f"Bearer {token(project)}"}
        files = [*hostile.no_files(project), "pipe.parquet", "runs/rig.toml"]
        paths = [f"/{at}{name}" for name in files for at in ("look/", "raw/", "rig?file=", "scene?file=", "details?file=", "trajectory/")]
        for path in [
            *paths,
            "/",
            "/runs",
            "/robot",
            "/look/runs",
            "/run/reconstruct",
            "/start/runs",
            "/calibrations?old=pipe.toml&new=pipe.toml",
        ]:
            try:
                with urlopen(Request(base + path, headers=head), timeout=30.0) as answer:
                    status = answer.status
            except HTTPError as error:
                status = error.code
            assert status < 500, path
        body = b"run=runs&trajectory=pipe.parquet&out=a&_form=1"
        with urlopen(Request(f"{base}/line/reconstruct", body, head), timeout=30.0) as answer:
            assert answer.status == 200


BLOCKED = """
import sys, time
from pathlib import Path
from starlette.routing import Route
from lmeasure.workbench import server
server.LONGEST_END_S = 0.5
def home(request):
    print("asked", flush=True)
    time.sleep(1000)
server.ROUTES = (Route("/", home), *server.ROUTES)
server.serve(Path(sys.argv[1]), 0, "en", lambda address: print(address, flush=True))
"""


def waiting(request: Request) -> None:
    """Ask, and never be answered."""
    with contextlib.suppress(OSError, HTTPException):
        urlopen(request, timeout=60.0)


def test_a_server_that_waits_for_something_ends_all_the_same(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", BLOCKED, str(tmp_path)], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        base = server.stdout.readline().split("/?")[0]
        head = {"Authorization": f"Bearer {token(tmp_path)}"}
        waits = threading.Thread(target=waiting, args=(Request(f"{base}/", headers=head),))
        waits.start()
        assert server.stdout.readline() == "asked\n"
        try:
            server.send_signal(signal.SIGTERM)
            assert server.wait(20.0) in (-signal.SIGTERM, 128 + signal.SIGTERM)
        finally:
            server.kill()
        waits.join()
    assert not list((tmp_path / ".workbench").glob("[at]*"))  # neither address nor token


def test_files_that_stand_for_more_memory_than_there_is(session: TestClient, project: Path) -> None:
    """Some kilobytes of equal numbers or texts, of which a page shows nothing."""
    hostile.parquet_of_equal_numbers(project / "numbers.parquet", 1_000_000, 20)
    hostile.parquet_of_one_text(project / "texts.parquet", 200_000, 10_000)
    (project / "sparse.csv").write_text("time_s,x_mm,y_mm,z_mm\n")
    os.truncate(project / "sparse.csv", 2**34)
    for name in ("numbers.parquet", "texts.parquet", "sparse.csv"):
        assert name == "sparse.csv" or (project / name).stat().st_size < 2**20, name
        for at in ("trajectory", "along", "export"):
            answer = session.get(f"/{at}/{name}")
            assert answer.status_code == 422, (at, name)
            assert "Pages do not show such files" in answer.text, (at, name)
    # what no size tells: the process that reads has a bound, and is begun anew where it ends
    with pytest.raises(FileFormatError, match="needs more than 4096 MB"):
        worker.call(np.empty, (2**30,))  # type: ignore[arg-type]
    with pytest.raises(FileFormatError, match="needs more than"):
        worker.call(os._exit, 1)  # type: ignore[arg-type]
    assert worker.call(len, "four") == 4  # type: ignore[arg-type]
