"""Attacks on the workbench, each tried on a real server: what it answers, what it leaves, what it takes.

    python benchmarks/workbench_attacks.py [--only KIND] [--keep] [--first]

Each attempt has a project of its own beside a file that is nobody's business. It is refused where the answer is 4xx and the project is as
it was. --keep writes the table to benchmarks/results/workbench_attacks.md, whose column "before" stays; --first writes that column instead
(with PYTHONPATH at the code that is looked at).
"""

import argparse
import contextlib
import http.client
import json
import os
import re
import resource
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import hostile
from hostile import DIGITS, LONG, packed

from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig

TABLE = Path(__file__).parent / "results" / "workbench_attacks.md"
PATIENCE_S = 20.0
MB = 2**20
SECRET = "nobody's business 4711"
RIG = """schema = "lmeasure.rig/1"
name = "none"
"""


def bounded() -> None:
    """Let a process take 8 GB: this machine has other work."""
    resource.setrlimit(resource.RLIMIT_AS, (2**33, resource.getrlimit(resource.RLIMIT_AS)[1]))


class Server:
    """A workbench over a folder, begun anew where it was ended or hangs."""

    def __init__(self, root: Path) -> None:
        self.root, self.project = root, root / "project"
        self.process: subprocess.Popen[str] | None = None

    def begin(self) -> None:
        """Make the project anew, and begin the server where none answers."""
        if self.process is None or self.process.poll() is not None:
            shutil.rmtree(self.root, ignore_errors=True)
            self.project.mkdir(parents=True)
            words = [sys.executable, "-m", "lmeasure", "workbench", str(self.project), "--no-browser"]
            self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, preexec_fn=bounded)
            assert self.process.stdout is not None
            address = next(word for word in self.process.stdout.readline().split() if word.startswith("http://"))
            self.address, self.port = address, int(address.split(":")[2].split("/")[0])
            own = self.project / ".workbench" / "token"
            self.token = own.read_text().strip() if own.exists() else address.split("=")[1]
        for path in self.project.iterdir():
            if path.name != ".workbench":
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        (self.root / "secret.txt").write_text(SECRET)
        write_rig(self.project / "rig.toml", cell_rig(0))
        (self.project / ".git" / "hooks").mkdir(parents=True)
        (self.project / ".git" / "config").write_text(SECRET)
        (self.project / "link.txt").symlink_to(self.root / "secret.txt")

    def end(self) -> None:
        """Kill it."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def ask(self, method: str, path: str, body: bytes | None = None, head: dict[str, str] | None = None, *, known: bool = True) -> Any:
        """Status, headers and text of an answer; known: as a program with the token. OSError where none comes."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        with contextlib.closing(connection):
            own = {"Authorization": f"Bearer {self.token}"} if known else {}
            connection.request(method, path, body, own | {"Origin": f"http://127.0.0.1:{self.port}"} | (head or {}))
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read(20 * MB).decode("utf-8", "replace")

    def memory(self) -> float:
        """Megabytes that the server and its processes have taken at most."""
        assert self.process is not None
        found, out = [self.process.pid], 0.0
        while found:
            pid = found.pop()
            with contextlib.suppress(OSError):
                status = Path(f"/proc/{pid}/status").read_text()
                # a process that has just ended has none
                out += sum(int(size) for size in re.findall(r"VmHWM:\s+(\d+)", status)) / 1024
                found += [int(one) for task in Path(f"/proc/{pid}/task").iterdir() for one in (task / "children").read_text().split()]
        return out


Attempt = Callable[[Server], str]
"""What is tried, and what came of it: a text that begins with `refused` where nobody is harmed."""


def tree(folder: Path) -> dict[str, int]:
    """What lies in a folder and beside it, but for what the workbench keeps of itself."""
    found = (path for path in folder.parent.rglob("*") if ".workbench" not in path.parts)
    return {str(path): path.lstat().st_size for path in found}


def judged(
    server: Server, method: str, path: str, body: bytes | None = None, head: dict[str, str] | None = None, *, fine: bool = False
) -> str:
    """Ask, and say how it was answered; fine: an answer that is no refusal harms nobody either."""
    before, memory, begun = tree(server.project), server.memory(), time.monotonic()
    try:
        status, headers, text = server.ask(method, path, body, head)
    except (OSError, http.client.HTTPException) as error:
        took = time.monotonic() - begun
        return f"no answer in {took:.0f} s" if took > PATIENCE_S - 1.0 else f"refused: {type(error).__name__}"
    took, grown, left = time.monotonic() - begun, server.memory() - memory, set(tree(server.project)) ^ set(before)
    reported = [str(status)]
    reported += [f"{took:.0f} s"] if took > 3.0 else []
    reported += [f"{grown / 1024:.1f} GB"] if grown > 700 else []
    reported += [f"{len(left)} left"] if left else []
    reported += ["shows what it should not"] if SECRET in text else []
    reported += ["no security headers"] if "content-security-policy" not in {name.lower() for name in headers} else []
    bad = status >= 500 or grown > 700 or took > 10.0 or SECRET in text or (status < 400 and not fine) or (status >= 400 and left)
    return f"{'' if bad or len(reported) > 2 else 'refused: ' if status >= 400 else 'harmless: '}{', '.join(reported)}"


def multipart(files: list[tuple[str, bytes]], **fields: str) -> tuple[bytes, dict[str, str]]:
    """A form with files as a browser sends it."""
    parts = [f'--b\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'.encode() for name, value in fields.items()]
    for name, content in files:
        parts.append(f'--b\r\nContent-Disposition: form-data; name="files"; filename="{name}"\r\n\r\n'.encode() + content + b"\r\n")
    return b"".join(parts) + b"--b--\r\n", {"Content-Type": "multipart/form-data; boundary=b"}


def bring(*files: tuple[str, bytes], to: str = "/upload", folder: str = "in", fine: bool = False) -> Attempt:
    """Bring files in."""
    return lambda server: judged(server, "POST", to, *multipart(list(files), **({"folder": folder} if to == "/upload" else {})), fine=fine)


def get(path: str, head: dict[str, str] | None = None, *, fine: bool = False) -> Attempt:
    """Ask for a page."""
    return lambda server: judged(server, "GET", path, None, head, fine=fine)


def post(path: str, form: Any, *, kind: str = "application/x-www-form-urlencoded", fine: bool = False) -> Attempt:
    """Send a form, or a text."""
    body = form if isinstance(form, bytes) else form.encode() if isinstance(form, str) else urlencode(form).encode()
    return lambda server: judged(server, "POST", path, body, {"Content-Type": kind}, fine=fine)


def sent(path: str, text: str, *, fine: bool = False) -> Attempt:
    """Send JSON."""
    return post(path, text, kind="application/json", fine=fine)


def lies(make: Callable[[Path], object], *paths: str, fine: bool = True) -> Attempt:
    """Lay something into the project and ask for pages; the worst answer counts."""

    def tried(server: Server) -> str:
        make(server.project)
        answers = [judged(server, "GET", path, fine=fine) for path in paths]
        return next((text for text in answers if not text.startswith(("refused", "harmless"))), answers[0])

    return tried


def waited_for(make: Callable[[Path], object], path: str) -> Attempt:
    """Ask for something that may be waited for, then end the server."""

    def tried(server: Server) -> str:
        make(server.project)
        asked = threading.Thread(target=lambda: judged(server, "GET", path), daemon=True)
        asked.start()
        time.sleep(1.0)
        assert server.process is not None
        begun = time.monotonic()
        server.process.send_signal(signal.SIGTERM)
        try:
            server.process.wait(30.0)
        except subprocess.TimeoutExpired:
            server.end()
            return "does not end in 30 s"
        return f"refused: ends in {time.monotonic() - begun:.0f} s"

    return tried


def held_up(make: Callable[[], bytes]) -> Attempt:
    """Bring in a zip and ask for a page meanwhile: how long that waits at most."""

    def tried(server: Server) -> str:
        body, head = multipart([("x.zip", make())], folder="in")
        upload = threading.Thread(target=lambda: judged(server, "POST", "/upload", body, head), daemon=True)
        upload.start()
        longest = 0.0
        while upload.is_alive():
            begun = time.monotonic()
            with contextlib.suppress(OSError):
                server.ask("GET", "/api/jobs")
            longest = max(longest, time.monotonic() - begun)
            time.sleep(0.02)
        return f"{'refused: ' if longest < 1.5 else ''}others wait {longest:.1f} s"

    return tried


def cookie_elsewhere(server: Server) -> str:
    """Be let in as a browser; then ask with what a server on another port is sent."""
    _, headers, _ = server.ask("GET", server.address.removeprefix(f"http://127.0.0.1:{server.port}"), known=False)
    cookie = headers["set-cookie"]
    found = re.search(r"path=([^;]+)", cookie, re.IGNORECASE)
    path = found[1] if found else "/"
    sent_elsewhere = path == "/"  # by a browser to the first page of any port
    stolen = cookie.split(";")[0]
    answers = [server.ask("GET", at, None, {"Cookie": stolen}, known=False)[0] for at in ("/", "/api/project", "/files")]
    stolen_value = stolen.split("=", 1)[1]
    as_bearer = server.ask("GET", "/api/project", None, {"Authorization": f"Bearer {stolen_value}"}, known=False)[0]
    again = server.ask("GET", server.address.removeprefix(f"http://127.0.0.1:{server.port}"), known=False)[0]
    server.end()  # its address is spent
    if sent_elsewhere or 200 in answers or as_bearer == 200 or again in (200, 303):
        return f"lets in: sent to every port {sent_elsewhere}, alone {answers}, as token {as_bearer}, address again {again}"
    return "refused: sent to no other port, 403 alone, as token and for the address again"


def words_of_browser(server: Server) -> str:
    """Read what a browser is called with, and ask with it."""
    server.end()
    with tempfile.TemporaryDirectory() as name:
        called, browser = Path(name) / "called", Path(name) / "browser"
        browser.write_text(f'#!/bin/sh\necho "$@" > {called}.part; mv {called}.part {called}\n')
        browser.chmod(0o700)
        words = [sys.executable, "-m", "lmeasure", "workbench", str(Path(name) / "p")]
        with subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ | {"BROWSER": f"{browser} %s"}
        ) as process:
            end = time.monotonic() + 30.0
            while not called.exists() and time.monotonic() < end:
                time.sleep(0.05)
            reported = called.read_text().strip()
            process.kill()
        if reported.startswith("file://"):
            return f"refused: a file, mode {'not ' if 'open-' not in reported else ''}for its owner alone"
        return "the token, for every user of the machine"


def raw_request(content: bytes) -> Attempt:
    """Bytes as they are."""

    def tried(server: Server) -> str:
        with socket.create_connection(("127.0.0.1", server.port), PATIENCE_S) as talk:
            talk.settimeout(PATIENCE_S)
            head = f"Host: 127.0.0.1:{server.port}\r\nAuthorization: Bearer {server.token}\r\nOrigin: http://127.0.0.1:{server.port}\r\n"
            talk.sendall(content.replace(b"HEAD\r\n", head.encode()))
            try:
                answer = talk.recv(65536).decode("latin-1")
            except OSError as error:
                return f"no answer: {type(error).__name__}"
        code = int(answer.split()[1]) if answer.startswith("HTTP") else 0
        return f"{'refused: ' if 400 <= code < 500 or code == 0 else 'harmless: ' if code < 400 else ''}{code or 'closed'}"

    return tried


def zip64_lie() -> bytes:
    """Its list of entries is said to be 2^60 bytes long."""
    raw = packed(hostile.GOOD)
    at = raw.index(b"PK\x05\x06")
    (where,) = struct.unpack("<L", raw[at + 16 : at + 20])
    record = struct.pack("<4sQHHLLQQQQ", b"PK\x06\x06", 44, 45, 45, 0, 0, 1, 1, 2**60, where)
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, at, 1)
    end = struct.pack("<4sHHHHLLH", b"PK\x05\x06", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return raw[:at] + record + locator + end


def parquet(make: Callable[[Path], None]) -> Callable[[Path], None]:
    """Lay a table into the project."""
    return lambda project: make(project / "x.parquet")


def sparse(name: str, head: str, size: int) -> Callable[[Path], None]:
    """Lay a file of zeros behind a head into the project."""

    def made(project: Path) -> None:
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text(head)
        os.truncate(project / name, size)

    return made


def text(name: str, content: str) -> Callable[[Path], None]:
    """Lay a file into the project."""

    def made(project: Path) -> None:
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text(content)

    return made


def fifo(name: str, *others: tuple[str, str]) -> Callable[[Path], None]:
    """Lay a pipe into the project, and files beside it."""

    def made(project: Path) -> None:
        for other, content in others:
            text(other, content)(project)
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        os.mkfifo(project / name)

    return made


def unix_socket(project: Path) -> None:
    """Lay a socket into the project."""
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(os.path.relpath(project / "x.toml"))


def attempts() -> Iterator[tuple[str, str, Attempt]]:
    """Kind, what is tried, and how."""
    for name, content in hostile.zips().items():
        yield "zip", f"{name}, in *Files*", bring(("x.zip", content))
    for name, content in list(hostile.zips().items())[::3]:
        yield "zip", f"{name}, to be verified", bring(("x.zip", content), to="/verify")
    yield "zip", "its list is said to be 2^60 bytes", bring(("x.zip", zip64_lie()))
    yield "zip", "3 GB of zeros in 3 MB", bring(("x.zip", hostile.bomb(3 * 2**30)))
    yield "zip", "200 MB of zeros that say to be 5 bytes", bring(("x.zip", hostile.bomb(200 * MB, 5)))
    yield "zip", "a name of 200 letters of three bytes", bring(("x.zip", packed(hostile.GOOD, ("字" * 200, b"1"))))
    yield "zip", "a name that ends with a dot", bring(("x.zip", packed(hostile.GOOD, ("a.", b"1"))))
    yield "zip", "a name that ends with a blank", bring(("x.zip", packed(hostile.GOOD, ("a ", b"1"))))
    yield "zip", "an empty name within a path", bring(("x.zip", packed(hostile.GOOD, ("a//b.txt", b"1"))))
    yield "zip", "a dot within a path", bring(("x.zip", packed(hostile.GOOD, ("a/./b.txt", b"1"))))
    yield "zip", "a name written from right to left", bring(("x.zip", packed(hostile.GOOD, ("a\u202egpj.exe", b"1"))))
    yield (
        "zip",
        "a link of Windows by its attributes",
        bring(("x.zip", packed(hostile.GOOD, (hostile.entry("l", 0o120000), b"/etc/passwd")))),
    )
    yield "zip", "a zip named .git.zip", bring((".git.zip", packed(hostile.GOOD)))
    yield "zip", "a zip beside a file of its name", bring(("x", b"1"), ("x.zip", packed(hostile.GOOD)))
    yield "zip", "two zips, the second garbled", bring(("a.zip", packed(hostile.GOOD)), ("b.zip", hostile.garbled()))
    yield "zip", "a zip of folders alone", bring(("x.zip", packed((zipfile.ZipInfo("a/"), b""), (zipfile.ZipInfo("b/"), b""))), fine=True)
    yield "zip", "3 GB of zeros, others ask meanwhile", held_up(lambda: hostile.bomb(2**31 - MB))

    for folder in (
        ".git/hooks",
        "a/../.git/hooks",
        ".",
        "..",
        "/tmp",
        "link.txt",
        "rig.toml/x",
        LONG,
        DIGITS,
        "\0",
        ".workbench/jobs",
        "~/x",
    ):
        fine = folder in (".", "~/x")
        yield "upload", f"into the folder {folder[:20]!r}", bring(("a.csv", b"1"), folder=folder, fine=fine)
    for name in (".bashrc", "a\\..\\..\\b", "con.txt", "x" * 300, "字" * 120, "a\tb", "a.csv:stream", "..", ""):
        yield "upload", f"a file called {name[:20]!r}", bring((name, b"1"), fine=name in ("", "a\\..\\..\\b"))
    yield "upload", "a second file that is there already", bring(("a.csv", b"1"), ("rig.toml", b"1"), folder=".")
    yield "upload", "the same file twice", bring(("a.csv", b"1"), ("a.csv", b"2"))
    yield "upload", "300 files", bring(*((f"f{i}.csv", b"1") for i in range(300)))
    yield "upload", "a folder with .git, to be verified", bring(("c/certificate.json", b"{}"), ("c/.git/hooks/x", b"1"), to="/verify")
    yield "upload", "a folder that leads up, to be verified", bring(("c/certificate.json", b"{}"), ("c/../../x", b"1"), to="/verify")
    yield "upload", "a file that is a folder, to be verified", bring(("c/a", b"1"), ("c/a/b", b"1"), to="/verify")
    yield "upload", "no boundary", post("/upload", b"x", kind="multipart/form-data", fine=True)
    yield "upload", "half a form", post("/upload", b"--b\r\nnothing", kind="multipart/form-data; boundary=b", fine=True)
    yield (
        "upload",
        "letters of an unknown set",
        post("/upload", multipart([("a", b"")])[0], kind="multipart/form-data; boundary=b; charset=x", fine=True),
    )
    yield (
        "upload",
        "half a letter as a name",
        post("/upload", multipart([("\\ud800.csv", b"1")])[0], kind="multipart/form-data; boundary=b; charset=unicode_escape"),
    )

    bad = {"256 bytes": "n" * 256, "5,000 digits": DIGITS, "a zero byte": "%00", "no UTF-8": "%ff%fe", "half a letter": "%ed%a0%80"}
    bad |= {"3,000 folders": "/".join(["d"] * 3000), "200 Russian letters": quote("я" * 200), "dots": "%2e%2e/%2e%2e/secret.txt"}
    for name, value in bad.items():
        for page in ("raw/", "look/", "jobs/", "run/", "start/", "trajectory/"):
            yield "path", f"/{page} with {name}", get(f"/{page}{value}")
        yield "path", f"/rig?file= with {name}", get(f"/rig?file={value}")
        yield "path", f"/?tour= with {name}", get(f"/?tour={value}", fine=True)
    for path in ("/raw/.git/config", "/look/.git", "/look/.git/config", "/raw/link.txt", "/rig?file=.git/config", "/raw/.workbench/token"):
        yield "path", path, get(path)

    zone = {"rig": "rig.toml", "out": "z.nc", "_form": "1"}
    yield "number", "5,000 digits in a form", post("/run/zone", zone | {"u95_mm": DIGITS})
    yield "number", "5,000 digits as a name in a form", post("/run/zone", zone | {"out": DIGITS})
    yield "number", "5,000 digits in the line of a form", post("/line/zone", zone | {"u95_mm": DIGITS}, fine=True)
    yield "number", "5,000 digits in a rig", post("/rig", {"_file": "rig.toml", "_digest": "", "name": DIGITS})
    yield "number", "5,000 digits as the name of a project", post("/projects", {"name": DIGITS})
    yield "number", "1e5000 in a form", post("/run/zone", zone | {"u95_mm": "1e5000"}, fine=True)
    yield "number", "NaN in a form", post("/run/zone", zone | {"u95_mm": "nan"}, fine=True)
    yield "number", "5,000 digits in JSON", sent("/api/jobs", f'{{"command": "zone", "settings": {{"u95_mm": {DIGITS}}}}}')
    yield (
        "number",
        "400 digits as a place",
        sent("/coarse", f'{{"file": "rig.toml", "points": {{"B1": [{DIGITS[:400]}, 0, 0]}}}}', fine=True),
    )
    yield "number", "10^400 as a limit", sent("/coarse", f'{{"file": "rig.toml", "points": {{}}, "limit_deg": {DIGITS[:400]}}}', fine=True)
    yield (
        "number",
        "5,000 digits as a length",
        raw_request(b"POST /api/jobs HTTP/1.1\r\nHEAD\r\nContent-Length: " + DIGITS.encode() + b"\r\n\r\n"),
    )
    yield "number", "a span of 5,000 digits", get(f"/along/rig.toml?begin={DIGITS}&end=x")
    for depth in (900, 100_000):
        yield "JSON", f"{depth} lists in lists", sent("/api/jobs", hostile.deep(depth))
        yield (
            "JSON",
            f"{depth} lists in lists as a setting",
            sent("/api/jobs", f'{{"command": "zone", "settings": {{"rig": {hostile.deep(depth)}}}}}'),
        )
        yield "JSON", f"{depth} lists in lists for the zone", sent("/coarse", f'{{"file": {hostile.deep(depth)}}}')
    yield "JSON", "half a letter as a file", sent("/api/jobs", '{"command": "zone", "settings": {"rig": "\\ud800"}}')
    yield "JSON", "half a letter as a command", sent("/api/jobs", '{"command": "\\ud800"}')
    yield "JSON", "half a letter for the zone", sent("/coarse", '{"file": "\\ud800", "points": {}}')
    yield "JSON", "a zero byte as a file", sent("/coarse", '{"file": "\\u0000", "points": {}}')
    yield "JSON", "3 MB", sent("/api/jobs", json.dumps({"command": "x" * 3_000_000}))
    yield "JSON", "a line for no job", sent("/api/jobs/99999999999", '{"line": "x"}')
    yield "form", "5,000 fields", post("/line/zone", {f"f{i}": "1" for i in range(5000)}, fine=True)
    yield "form", "a field of 3 MB", post("/line/zone", {"rig": "x" * 3_000_000})
    yield "form", "back to another place", post("/language", {"language": "ru", "back": "//evil.example/"}, fine=True)
    yield "form", "back with a line end", post("/language", {"language": "ru", "back": "/\r\nSet-Cookie: a=b"}, fine=True)
    yield "header", "100 kB in one header", get("/", {"X-Long": "x" * 100_000})
    yield (
        "header",
        "2,000 headers",
        raw_request(b"GET / HTTP/1.1\r\nHEAD\r\n" + b"".join(b"X-%d: 1\r\n" % i for i in range(2000)) + b"\r\n"),
    )
    yield "header", "cookies of 50 kB", get("/", {"Cookie": "a=" + '"' * 50_000}, fine=True)
    yield "header", "a range of 5,000 digits", get("/raw/rig.toml", {"Range": f"bytes={DIGITS}-{DIGITS}"}, fine=True)
    yield "header", "1,000 ranges", get("/raw/rig.toml", {"Range": "bytes=" + ",".join(["0-1"] * 1000)}, fine=True)
    yield "header", "languages of 5,000 digits", get("/", {"Accept-Language": DIGITS}, fine=True)

    run = ("r/run.toml", "schema = 'lmeasure.run/1'\nrig = 'rig.toml'\n")
    yield "waiting", "a pipe x.toml, looked at", lies(fifo("x.toml"), "/look/x.toml", "/")
    yield "waiting", "a pipe as the rig of a run", lies(fifo("r/rig.toml", run), "/run/reconstruct", "/runs", "/look/r")
    yield "waiting", "a pipe as a run", lies(fifo("r/run.toml"), "/runs", "/look/r", "/start/r")
    yield "waiting", "a pipe x.parquet", lies(fifo("x.parquet"), "/trajectory/x.parquet", "/raw/x.parquet")
    yield "waiting", "a pipe x.csv", lies(fifo("x.csv"), "/look/x.csv", "/trajectory/x.csv")
    yield "waiting", "a pipe calibration.json", lies(fifo("calibration.json"), "/calibrations?old=calibration.json&new=calibration.json")
    yield "waiting", "a pipe certificate.json", lies(fifo("c/certificate.json"), "/trend", "/robot", "/look/c/certificate.json")
    yield "waiting", "a pipe details.toml", lies(fifo("details.toml"), "/details", "/details?file=details.toml")
    yield "waiting", "a socket x.toml", lies(unix_socket, "/look/x.toml", "/rig?file=x.toml")
    yield (
        "waiting",
        "a folder x.toml",
        lies(lambda project: (project / "x.toml").mkdir(), "/look/x.toml", "/rig?file=x.toml", "/raw/x.toml"),
    )
    yield (
        "waiting",
        "a link to /dev/zero",
        lies(lambda project: (project / "z.toml").symlink_to("/dev/zero"), "/look/z.toml", "/raw/z.toml"),
    )
    yield "waiting", "a link to itself", lies(lambda project: (project / "z.toml").symlink_to("z.toml"), "/look/z.toml", "/raw/z.toml", "/")
    yield "waiting", "the end, while a pipe is looked at", waited_for(fifo("x.toml"), "/look/x.toml")
    yield "waiting", "the end, while the rig of a run is a pipe", waited_for(fifo("r/rig.toml", run), "/run/reconstruct")

    equal = parquet(lambda path: hostile.parquet_of_equal_numbers(path, 1_000_000, 30))
    yield "memory", "30 million rows of equal numbers", lies(equal, "/trajectory/x.parquet")
    yield (
        "memory",
        "2 GB of one text",
        lies(parquet(lambda path: hostile.parquet_of_one_text(path, 200_000, 10_000)), "/trajectory/x.parquet"),
    )
    yield "memory", "the same along time", lies(equal, "/along/x.parquet")
    yield "memory", "the same as .csv", lies(equal, "/export/x.parquet")
    table = "time_s,x_mm,y_mm,z_mm\n"
    yield "memory", "a sparse table of 3 GB", lies(sparse("x.csv", table, 3 * 2**30), "/trajectory/x.csv")
    yield "memory", "a sparse .tum of 3 GB", lies(sparse("x.tum", "0 0 0 0 0 0 0 1\n", 3 * 2**30), "/trajectory/x.tum")
    yield "memory", "a sparse .mcap of 3 GB", lies(sparse("x.mcap", "\x89MCAP0\r\n", 3 * 2**30), "/trajectory/x.mcap")
    yield "memory", "a sparse certificate of 3 GB", lies(sparse("c/certificate.json", "{}", 3 * 2**30), "/trend", "/robot")
    yield (
        "memory",
        "a sparse calibration of 3 GB",
        lies(sparse("calibration.json", "{}", 3 * 2**30), "/calibrations?old=calibration.json&new=calibration.json"),
    )
    yield "memory", "a sparse rig of 3 GB", lies(sparse("x.toml", RIG, 3 * 2**30), "/rig?file=x.toml", "/look/x.toml", "/check")
    yield (
        "memory",
        "a rig with 100,000 tables in tables",
        lies(text("x.toml", RIG + f"[{'.'.join('a' * 100_000)}]\n"), "/rig?file=x.toml", "/"),
    )
    yield "memory", "a certificate of 100,000 lists in lists", lies(text("c/certificate.json", hostile.deep(100_000)), "/trend", "/robot")

    yield "let in", "the cookie on another port, as a token, the address again", cookie_elsewhere
    yield "let in", "the words that the browser is called with", words_of_browser


def earlier() -> dict[tuple[str, str], list[str]]:
    """What the table says came of each attempt, before and now."""
    if not TABLE.exists():
        return {}
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in TABLE.read_text(encoding="utf-8").splitlines() if line.startswith("|")
    ]
    return {(row[0], row[1]): row[2:] for row in rows[2:]}


def main() -> None:
    """Try all, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="a kind")
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--first", action="store_true")
    asked = parser.parse_args()
    rows, column = earlier(), 0 if asked.first else 1
    tried: dict[tuple[str, str], None] = {}
    with tempfile.TemporaryDirectory(prefix="attacks-") as name:
        server = Server(Path(name) / "root")
        for kind, what, attempt in attempts():
            tried[kind, what] = None
            if asked.only not in ("", kind):
                continue
            server.begin()
            try:
                reported = attempt(server)
            except Exception as error:
                reported = f"{type(error).__name__}: {error}"[:100]
            rows.setdefault((kind, what), ["", ""])[column] = reported.replace("|", "/")
            print(f"{kind:8} {what[:60]:60} {reported}", flush=True)
            if any(word in reported for word in ("no answer", "GB", "end in", "Error")):
                server.end()  # which may hang, or be full
        server.end()
    rows = {key: rows.get(key, ["", ""]) for key in tried}
    through = [sum(not row[i].startswith(("refused", "harmless")) for row in rows.values()) for i in (0, 1)]
    print(f"{len(rows)} attempts, got through: {through[0]} before, {through[1]} now")
    if not (asked.keep or asked.first):
        return
    lines = [f"| {kind} | {what} | {before} | {now} |" for (kind, what), (before, now) in rows.items()]
    head = f"""# Attacks on the workbench

`python benchmarks/workbench_attacks.py --keep`

{len(rows)} attempts: {through[0]} got through before, {through[1]} now.

A refusal is an answer 4xx, or a closed connection, that leaves the project as it was. Harmless is an answer that harms nobody.
`left` counts files and folders.

| kind | attempt | before | now |
|---|---|---|---|
"""
    TABLE.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
