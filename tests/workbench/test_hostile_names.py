"""Names as an attacker gives them to files, rigs, channels, certificates and jobs: on every page they are text; and a server that is abused
by connections answers everybody else."""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import quote, urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest
from bench import client, served_apart, token
from starlette.testclient import TestClient
from test_let_in_by_token import SECRET

from lmeasure.io import write_table
from lmeasure.rig import rig_from_dict, write_rig
from lmeasure.simulation import cell_rig

MARK = "hAcKeD"
HOSTILE = (
    f"<script>{MARK}()</script>",
    f'"><img src=x onerror={MARK}()>',
    f"' autofocus onfocus='{MARK}()",
    f"<svg onload={MARK}()>",
    f"javascript:{MARK}()",
    f"{{{{{MARK}.__class__}}}}",
    f"=cmd|'{MARK}'!A0",
    f"</title><base href=//{MARK}.example>",
)
NAME = f"<svg/onload={MARK}()>"
"""As hostile as the name of a cable may be."""
PAGES = (
    "", "files", "commands", "certificates", "runs", "calibration", "register", "register/due", "register/recall", "register/charts",
    "trend",
    "details", "rig", "scene", "calibrations", "api/project", "api/jobs",
)  # fmt: skip
RAN = {"href", "src", "action", "formaction", "data", "srcdoc", "style"}
"""Attributes whose values a browser follows or runs."""


class Found(HTMLParser):
    """Elements and attributes that a hostile text has become."""

    def __init__(self) -> None:
        super().__init__()
        self.wrong: list[str] = []
        self._script = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Look at an element."""
        self._script = tag in ("script", "style")
        for name, value in attrs:
            follows = name in RAN and (value or "").strip().lower().startswith(("javascript:", "data:text", "//"))
            if MARK.lower() in name or (MARK in (value or "") and (name.startswith("on") or follows)):
                self.wrong.append(f"<{tag} {name}={value}>")
        if tag == "base" or MARK.lower() in tag:
            self.wrong.append(f"<{tag}>")

    def handle_endtag(self, tag: str) -> None:
        """Leave an element."""
        self._script = False

    def handle_data(self, data: str) -> None:
        """Look at a script."""
        if self._script and MARK in data:
            self.wrong.append(data[:100])


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project whose every name is hostile."""
    folder = tmp_path / "project"
    jobs = folder / ".workbench" / "jobs"
    rig = cell_rig(0).to_dict()
    for n, text in enumerate(HOSTILE):
        safe = text.replace("/", "\u2215")
        (folder / f"{safe} d").mkdir(parents=True)
        write_table(folder / f"{safe}.csv", {"pose": [text, text + "2"], "x_mm": np.zeros(2)})
        for kind in ("rig.toml", "log", "json", "html", "svg", "md"):
            (folder / f"{safe}.{kind}").write_text(f"{text}\nname = {json.dumps(text)}\n")
        own = rig | {"name": text, "cable": [one | {"name": one["name"] + NAME} for one in rig["cable"]]}
        (folder / f"cell{n}").mkdir()
        write_rig(folder / f"cell{n}" / "rig.toml", rig_from_dict(own))
        run = f'schema = "lmeasure.run/1"\nrig = {json.dumps(text)}\n[[pass]]\ncounts = {json.dumps(text)}\n'
        (folder / f"cell{n}" / "run.toml").write_text(run)
        (folder / f"cell{n}" / "details.toml").write_text(f"[customer]\nname = {json.dumps(text)}\n")
        job = jobs / f"{n + 1:04}"
        job.mkdir(parents=True)
        asked = {"number": n + 1, "command": "zone", "words": ["zone", text], "begun": text}
        (job / "asked.json").write_text(json.dumps(asked))
        events = [{"event": "said", "text": text}, {"event": text, "text": text}]
        (job / "said.jsonl").write_text("".join(json.dumps(one) + "\n" for one in events))
        result = {"summary": [text], "notes": [text], "warnings": [text], "figures": {text: 1.0}, "error": text, "files": [text]}
        (job / "end.json").write_text(json.dumps({"state": "failed", "ended": text, "code": 1, "result": result}))
    (folder / "rig.toml").write_bytes((folder / "cell0" / "rig.toml").read_bytes())
    return folder


@pytest.fixture
def asked(project: Path) -> Iterator[TestClient]:
    with client(project) as one:
        yield one


def addresses(project: Path) -> list[str]:
    """Every page, with every file of the project where a page shows one."""
    files = [quote(path.relative_to(project).as_posix()) for path in sorted(project.rglob("*")) if ".workbench" not in path.parts]
    shown = [f"look/{file}" for file in files] + [f"rig?file={file}" for file in files if file.endswith("rig.toml")]
    shown += [f"{page}/{file}" for page in ("trajectory", "start") for file in files[::7]]
    shown += [f"{page}?file={quote(text)}" for page in ("rig", "details") for text in HOSTILE]
    shown += [f"trend?robot={quote(text)}" for text in HOSTILE] + [f"run/zone?_form=1&rig={quote(text)}" for text in HOSTILE]
    return [*PAGES, *shown, *(f"jobs/{n + 1}" for n in range(len(HOSTILE)))]


def test_hostile_names_are_text_on_every_page(asked: TestClient, project: Path) -> None:
    wrong: dict[str, list[str]] = {}
    pages = marks = 0
    every = addresses(project)
    assert len(every) > 120
    for address in every:
        answer = asked.get(f"/{address}")
        assert answer.status_code < 500, address
        assert "default-src 'none'" in answer.headers["content-security-policy"], address
        if not answer.headers.get("content-type", "").startswith("text/html"):
            continue
        found = Found()
        found.feed(answer.text)
        pages, marks = pages + 1, marks + (MARK in answer.text)
        if found.wrong:
            wrong[address] = found.wrong
    assert wrong == {}
    assert pages > 60
    assert marks > 30, "they are shown"


def test_answers_to_hostile_forms_are_text(asked: TestClient, project: Path) -> None:
    before = {path: path.read_bytes() for path in project.rglob("*") if path.is_file() and ".workbench" not in path.parts}
    wrong: dict[tuple[str, str], list[str]] = {}
    for text in HOSTILE:
        forms = {
            "/run/zone": {"_form": "1", "rig": text, "out": text, "u95_mm": text},
            "/run/record": {"_form": "1", "rig": "rig.toml", "out": "../" + text, "bus": text},
            "/line/zone": {"rig": text, "out": text},
            "/projects": {"name": text},
            "/details": {"_file": text, "customer.name": text},
            "/details/preview": {"_file": "d.toml", "customer.name": text},
            "/rig": {"_file": text, "name": text},
            "/upload": {"folder": "../" + text},
        }
        for path, data in forms.items():
            answer = asked.post(path, data=data)
            assert answer.status_code < 500, (path, text)
            found = Found()
            if answer.headers.get("content-type", "").startswith("text/html"):
                found.feed(answer.text)
            if found.wrong:
                wrong[path, text] = found.wrong
    assert wrong == {}
    assert before == {path: path.read_bytes() for path in before}


def test_abuse_of_connections_holds_up_nobody(tmp_path: Path) -> None:
    """Slow headers and bodies, half requests, two lengths in one, many open connections and listeners: others are answered meanwhile."""
    (tmp_path / "secret.txt").write_text(SECRET)
    project = tmp_path / "project"
    project.mkdir()
    with served_apart(project) as address:
        port, key = urlsplit(address).port or 0, token(project)
        host = f"Host: 127.0.0.1:{port}\r\nAuthorization: Bearer {key}\r\n"
        raw = [
            "GET / HTTP/1.1\r\n",
            f"POST /upload HTTP/1.1\r\n{host}Content-Length: 1000000\r\n\r\n--x",
            f"POST /line/zone HTTP/1.1\r\n{host}Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /no HTTP/1.1\r\n\r\n",
            f"POST /line/zone HTTP/1.1\r\n{host}Content-Length: 1\r\nContent-Length: 2\r\n\r\nab",
            f"POST /line/zone HTTP/1.1\r\n{host}Transfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n",
            f"POST /line/zone HTTP/1.1\r\n{host}Content-Length: -1\r\n\r\n",
            f"GET /../../secret.txt HTTP/1.1\r\n{host}\r\n",
            f"GET /raw/..%2f..%2fsecret.txt HTTP/1.1\r\n{host}\r\n",
            f"GET http://other.example/ HTTP/1.1\r\n{host}\r\n",
            f"GET /\x00 HTTP/1.1\r\n{host}\r\n",
            f"GET / HTTP/9.9\r\n{host}\r\n",
            f"CONNECT 127.0.0.1:22 HTTP/1.1\r\n{host}\r\n",
            f"TRACE / HTTP/1.1\r\n{host}\r\n",
            f"GET / HTTP/1.1\r\n{host}X: a\r\n b\r\n\r\n",
            f"GET /api/jobs/1/live HTTP/1.1\r\n{host}Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 99\r\n\r\n",
            f"GET / HTTP/1.1\r\n{host}Cookie: {'a=b; ' * 20000}\r\n\r\n",
            "\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
            "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
            "\r\n" * 5000,
            "A" * 100_000,
        ]
        answers: list[bytes] = []
        held: list[socket.socket] = []
        with contextlib.ExitStack() as stack:
            for n in range(120):
                one = stack.enter_context(socket.create_connection(("127.0.0.1", port), 5.0))
                with contextlib.suppress(OSError):  # it was closed already
                    one.sendall(raw[n % len(raw)].encode("latin-1"))
                held.append(one)
            for one in held[: len(raw)]:
                one.settimeout(0.3)
                with contextlib.suppress(OSError):
                    answers.append(one.recv(65536))
            begun = time.monotonic()
            with urlopen(Request(f"http://127.0.0.1:{port}/api/project", headers={"Authorization": f"Bearer {key}"}), timeout=60) as answer:
                assert answer.status == 200
            assert time.monotonic() - begun < 30.0
        assert len(answers) > 10
        for said in answers:
            assert SECRET.encode() not in said
            assert not said.startswith(b"HTTP/1.1 5"), said[:80]
            assert b"Traceback" not in said
