"""Who is not let in, on every route; what leads out of the project; what is brought in."""

import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from bench import HOST, ORIGIN, PORT, TOKEN, client, served_apart, session, stranger, token, until
from browser import opened
from clicks import entered
from in_process import refused
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from lmeasure import workbench
from lmeasure.core import SettingsError
from lmeasure.workbench import forms
from lmeasure.workbench.guard import Door
from lmeasure.workbench.project import OutsideError, inside
from lmeasure.workbench.project_list import Shelf
from lmeasure.workbench.server import ROUTES, application
from lmeasure.workflows import COMMANDS, load, options_of

EVERY = ROUTES
SECRET = "nobody's business 4711"
NAMED = ("file", "old", "new", "_file", "folder", "into", "back", "then", "name", "run", "path", "out", "rig", "zone", "start", "digest")
"""What addresses and forms name files and places by."""
AWAY = ("../secret.txt", "..%2fsecret.txt", "%2e%2e/secret.txt", "/etc/passwd", "a/../../secret.txt", "link.txt", ".workbench/address")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with a rig, beside a file that is nobody's business, and a link to it."""
    (tmp_path / "secret.txt").write_text(SECRET)
    folder = tmp_path / "project"
    (folder / ".workbench").mkdir(parents=True)
    (folder / ".workbench" / "address").write_text(SECRET)
    (folder / "link.txt").symlink_to(tmp_path / "secret.txt")
    return folder


@pytest.fixture
def visitor(project: Path) -> Iterator[TestClient]:
    with client(project) as one:
        yield one


def addresses() -> list[tuple[str, str]]:
    """Every route with every method that it has."""
    out = []
    for route in EVERY:
        if isinstance(route, Route):
            path = (
                route.path.replace("{number:int}", "1")
                .replace("{command}", "zone")
                .replace("{path:path}", "rig.toml")
                .replace("{name}", "other")
                .replace("{key}", "key")
            )
            out += [(method, path) for method in sorted(route.methods or ())]
    assert len(out) > 40
    return out


def test_nobody_is_let_in_without_the_token_on_any_route(project: Path) -> None:
    with client(project, token=None) as nobody, client(project, token="another") as guesser:
        for method, path in [*addresses(), ("GET", "/static/workbench.js"), ("GET", "/nowhere"), ("GET", "/shown/key/rig.toml")]:
            for one in (nobody, guesser):
                answer = one.request(method, path)
                assert answer.status_code == 403, (method, path)
                assert SECRET not in answer.text
        for path in (f"/rig?code={TOKEN}", f"/?token={TOKEN}", f"/?code={TOKEN}", "/?code=wrong", f"/~{TOKEN}/"):
            assert nobody.get(path).status_code == 403, path


def test_a_session_is_two_secrets_and_neither_is_worth_anything_alone(project: Path) -> None:
    """What another server of 127.0.0.1 might be sent, a person see in an address, or another workbench give."""
    with session(project) as one, session(project) as other:
        path, cookie = str(one.base_url.path).rstrip("/"), dict(one.cookies)
        assert one.get("/").status_code == 200
        secret = next(iter(cookie.values()))
        mine = stranger(one)
        assert mine.get(f"{path}/", headers={"Cookie": f"lmeasure-{PORT}={secret}"}).status_code == 200
        tossed = f"lmeasure-{PORT}=another; lmeasure-{PORT}={secret}; lmeasure-{PORT}=x"  # by another server, for all paths
        assert mine.get(f"{path}/", headers={"Cookie": tossed}).status_code == 200
        for at, cookies, bearer in (
            ("", cookie, ""),
            (path, {}, ""),
            (path, dict(other.cookies), ""),
            (path, {f"lmeasure-{PORT + 1}": secret}, ""),
            ("", {}, secret),
            ("", {}, path.removeprefix("/~")),
            (path, {}, secret),
            ("/~" + secret, cookie, ""),
            ("/~", {f"lmeasure-{PORT}": ""}, ""),
            (str(other.base_url.path).rstrip("/"), cookie, ""),
        ):
            head = {"Cookie": "; ".join(f"{k}={v}" for k, v in cookies.items()), "Authorization": f"Bearer {bearer}"}
            for route in ("/", "/api/project", "/files", "/static/workbench.js"):
                assert mine.get(at + route, headers=head).status_code == 403, (at, cookies, bearer, route)
            assert mine.post(f"{at}/api/jobs", json={}, headers=head | {"Origin": ORIGIN}).status_code == 403


def test_other_names_and_other_pages_are_refused_on_every_route(project: Path) -> None:
    with session(project) as visitor:
        for method, path in addresses():
            for host in ("evil.example", "127.0.0.1:1", f"localhost:{PORT}"):
                assert visitor.request(method, path, headers={"Host": host}).status_code == 403, path
            for origin in ("http://evil.example", "null", "http://127.0.0.1:1", f"https://{HOST}"):
                assert visitor.request(method, path, headers={"Origin": origin}).status_code == 403, (path, origin)
            if method not in ("GET", "HEAD"):
                del visitor.headers["Origin"]
                assert visitor.request(method, path).status_code == 403, path
                visitor.headers["Origin"] = ORIGIN
            for site in ("cross-site", "same-site"):
                assert visitor.request(method, path, headers={"Sec-Fetch-Site": site}).status_code == 403, (path, site)


def test_the_live_stream_is_guarded_as_the_pages_are(project: Path) -> None:
    path = next(r.path for r in EVERY if isinstance(r, WebSocketRoute)).replace("{number:int}", "1")
    with client(project, token=None) as nobody, pytest.raises(WebSocketDisconnect), nobody.websocket_connect(path):
        pass
    with session(project) as one:
        for head in ({"Origin": "http://evil.example", "Host": HOST}, {"Cookie": "", "Host": HOST}):
            with pytest.raises(WebSocketDisconnect), one.websocket_connect(path, headers=head):
                pass


def test_a_code_lets_in_one_browser_once(project: Path) -> None:
    door = Door(TOKEN)
    with TestClient(application(project, door, PORT), base_url=ORIGIN, follow_redirects=False) as person:
        code = door.code()
        assert person.head(f"/?code={code}").status_code == 403  # who only looks whether there is something spends nothing
        assert person.get(f"/?code={code}", headers={"Sec-Fetch-Site": "cross-site"}).status_code == 403
        # from a file or a mail
        answer = person.get(f"/?code={code}", headers={"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"})
        assert answer.status_code == 200
        cookie, path = answer.headers["set-cookie"], re.search(r'url=(/~[\w-]+/)"', answer.text)[1]  # type: ignore[index]
        assert {"httponly", "samesite=strict", f"path={path}".lower()} <= {part.strip().lower() for part in cookie.split(";")}
        assert code not in cookie
        assert TOKEN not in cookie + answer.text
        assert person.get(path).status_code == 200
        assert f'href="{path}rig"' in person.get(path).text
        assert person.post(f"{path}language", data={"back": "/rig"}, headers={"Origin": ORIGIN}).headers["location"] == f"{path}rig"
        assert person.get(f"/?code={code}").status_code == 403
        person.cookies.clear()
        assert person.get(path).status_code == 403
        assert person.get("/api/project", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200


def test_the_browser_is_called_with_nothing_that_lets_anyone_in(tmp_path: Path) -> None:
    """Every user of the machine reads the words that a program is called with; a file for its owner alone leads the browser in, once."""
    called, browser = tmp_path / "called", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$@" > {called}.part; mv {called}.part {called}\n')
    browser.chmod(0o700)
    project = tmp_path / "project"
    with served_apart(project, f"{browser} %s") as address:
        until(called.exists)
        words = called.read_text().strip()
        page = Path(words.removeprefix("file://"))
        assert page.parent == project
        assert page.stat().st_mode & 0o777 == 0o600
        assert "code" not in words
        assert token(project) not in words + page.read_text()
        assert address.split("=")[1] not in page.read_text()  # which is for another browser
        with opened(words) as shown:
            entered(shown)
            shown.wait("!!document.querySelector('.way')")
            assert shown.evaluate("document.cookie") == ""
            assert not page.exists()
            shown.go(address)
            entered(shown)
            shown.go(address)
            assert "has already been used" in shown.evaluate("document.body.innerText")


def test_what_a_report_reads_of_its_address_lets_nobody_in(project: Path) -> None:
    """Its scripts run in a sandbox, and know where they were shown: at an address of that one file."""
    (project / "report.html").write_text("<script>top.location = 'http://127.0.0.1:1/?' + location.href</script>")
    with session(project) as one:
        path = str(one.base_url.path).rstrip("/")
        page = one.get("/look/report.html")
        shown = re.search(r'src="(/shown/\w+/report.html)"', page.text)[1]  # type: ignore[index]
        answer = stranger(one).get(shown)
        assert answer.status_code == 200
        assert path not in shown + answer.text + str(answer.headers)
        assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts")
        assert answer.headers["referrer-policy"] == page.headers["referrer-policy"] == "strict-origin"
        for other in ("rig.toml", "link.txt"):
            assert stranger(one).get(shown.replace("report.html", other)).status_code == 403, other
        # behind the session's path it is only saved
        saved = one.get("/raw/report.html")
        assert saved.headers["content-disposition"].startswith("attachment")
        assert "allow-scripts" not in saved.headers["content-security-policy"]
        assert one.get(shown).status_code == 404


def test_every_answer_forbids_scripts_and_frames_of_others(visitor: TestClient, project: Path) -> None:
    (project / "report.html").write_text("<script>fetch('/')</script>")
    visitor.app.router.routes.insert(0, Route("/fault", lambda request: 1 / 0))  # type: ignore[attr-defined]
    for path in ("/", "/rig", "/commands", "/api", "/static/workbench.css", "/nowhere", "/fault", "/?code=none"):
        answer = visitor.get(path)
        assert answer.status_code == (500 if path == "/fault" else 404 if path == "/nowhere" else 200)
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert {"x-content-type-options", "referrer-policy", "cross-origin-opener-policy", "cache-control"} <= {*answer.headers}
        assert "half-written" not in answer.text  # nobody knows
    shown = re.search(r'src="(/shown/[^"]+)"', visitor.get("/look/report.html").text)[1]  # type: ignore[index]
    own = visitor.get(shown).headers["content-security-policy"]
    assert own.startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in own
    assert "connect-src" not in own  # so that default-src holds: nothing can be asked


def test_every_name_that_pages_ask_for_is_walked() -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in Path(workbench.__file__).parent.glob("*.py"))
    visitor = set(re.findall(r"""query_params\.get(?:list)?\("(\w+)\"""", source))
    visitor |= set(re.findall(r"""form\.get\("(\w+)\"""", source))
    assert visitor - {"token", "saved", "begin", "end", "line", "language", "_digest"} <= {*NAMED}


@pytest.mark.parametrize("path", AWAY)
def test_no_path_leads_out_of_the_project_on_any_route(visitor: TestClient, project: Path, path: str) -> None:
    """In the address itself, in every parameter, in every field of a form, where a % is a letter as others are."""
    before = sorted(project.parent.rglob("*"))
    for route in (route for route in EVERY if isinstance(route, Route)):
        there = route.path.replace("{number:int}", "1").replace("{command}", "zone").replace("{name}", path)
        for method in sorted(route.methods or ()):
            fields = {} if "%" in path else dict.fromkeys(NAMED, path)
            within = "{path:path}" in route.path
            body = fields if method == "POST" else None
            answer = visitor.request(method, there.replace("{path:path}", path), params=None if within else fields, data=body)
            assert SECRET not in answer.text, (method, there)
            assert answer.status_code < 500, (method, there, answer.text)
            assert "secret" not in answer.headers.get("location", ""), (method, there)
            if within:
                assert answer.status_code in (404, 422), (method, there, answer.status_code)
    assert sorted(project.parent.rglob("*")) == before
    with pytest.raises(OutsideError):
        inside(project, path.replace("%2f", "/").replace("%2e", "."))


class NoDesk:
    """Serves nothing."""

    def address(self, folder: Path, shelf: Shelf) -> str:
        raise AssertionError(f"{folder} was opened")

    def is_open(self, folder: Path) -> bool:
        return False


@pytest.mark.parametrize(
    "name",
    [*(name for name in AWAY if name != "link.txt"), "..", ".", " ", "", ".hidden", "con", "a/b", "a\\b", "a\nb", "C:", "x" * 61, "linked"],
)
def test_no_project_lies_outside_the_folder_of_projects(project: Path, name: str) -> None:
    root = project.parent / "root"
    (root / "here").mkdir(parents=True)
    (root / "linked").symlink_to(project.parent)
    before = sorted(project.parent.rglob("*"))
    with client(root / "here", shelf=Shelf(root, NoDesk())) as visitor:
        answer = visitor.post("/projects", data={"name": name})
        assert answer.status_code == 422
        assert 'role="alert"' in answer.text
        if name.strip("./ ") and "\n" not in name:
            assert visitor.get(f"/projects/{name}").status_code == 404
        assert visitor.get("/").text.count("secret") == 0
        assert "/projects/linked" not in visitor.get("/").text
    with client(root / "here") as visitor:
        assert visitor.post("/projects", data={"name": "other"}).status_code == 404
        assert visitor.get("/projects/here").status_code == 404
    assert sorted(p for p in project.parent.rglob("*") if ".workbench" not in p.parts) == [p for p in before if ".workbench" not in p.parts]


@pytest.mark.parametrize("away", ["../secret.txt", "/etc/passwd", "link.txt", ".workbench/address"])
def test_no_file_of_any_command_lies_outside(project: Path, away: str) -> None:
    """Options that are paths, and texts that may hold one."""
    walked = 0
    for command in (name for name in COMMANDS if name not in forms.NOT_HERE):
        for option in options_of(load(command).settings):
            if option.name in forms.HIDDEN or option.kind not in ("path", "list", "text"):
                continue
            for text in (away,) if option.kind == "path" else (away, f"replay:{away}", f"x={away}"):
                walked += 1
                with pytest.raises(SettingsError) as refused:
                    forms.command_words(command, {option.name: [text] if option.kind == "list" else text}, project)
                assert refused.value.option == option.name, (command, option.name, text)
    assert walked > 300


def test_what_leads_outside_begins_no_job(visitor: TestClient, project: Path) -> None:
    for away in ("../secret.txt", "link.txt"):
        reported = visitor.post("/line/zone", data={"rig": away, "_form": "1"}).json()
        assert reported["option"] == "rig", reported
        assert visitor.post("/run/zone", data={"rig": away, "_form": "1"}).status_code == 422
        assert visitor.post("/api/jobs", json={"command": "zone", "settings": {"rig": away}}).status_code == 422
    assert not list((project / ".workbench").glob("jobs/*"))


@pytest.mark.parametrize("bus", ["replay:../secret.txt", "replay:/etc/passwd", "replay:link.txt"])
def test_a_bus_reads_no_file_outside(visitor: TestClient, bus: str) -> None:
    reported = visitor.post("/line/record", data={"rig": "rig.toml", "out": "run", "bus": bus}).json()
    assert reported["option"] == "bus", reported


def test_what_is_brought_in_stays_in_its_folder_and_writes_over_nothing(visitor: TestClient, project: Path) -> None:
    def bring(name: str, content: bytes = b"x", folder: str = "in") -> int:
        return visitor.post("/upload", data={"folder": folder}, files={"files": (name, content)}).status_code

    assert bring("drive.log") == 303
    assert (project / "in" / "drive.log").read_bytes() == b"x"
    assert bring("drive.log", b"other") == 422
    assert (project / "in" / "drive.log").read_bytes() == b"x"
    for name in (".hidden", "con.txt", "a\nb"):
        assert bring(name) == 422, name
    bring("../../plain.txt")
    assert [p.parent.name for p in project.parent.rglob("plain.txt")] == ["in"]
    assert bring("a.log", folder="../elsewhere") == 422
    assert bring("a.log", folder=".workbench") == 422
    for entry in ("../evil.txt", "/evil.txt", "a/../../evil.txt", "a\\..\\evil.txt"):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as held:
            held.writestr(entry, "x")
        assert bring("bad.zip", packed.getvalue()) == 422, entry
        assert visitor.post("/verify", files={"files": ("bad.zip", packed.getvalue())}).status_code == 422
    assert bring("no.zip", b"not a zip") == 422
    assert not list(project.parent.rglob("evil*"))
    assert not (project / "in" / "bad.zip").exists()


def words_of(process: Path) -> str:
    """Command line of a process, which may be gone by now."""
    try:
        return (process / "cmdline").read_bytes().decode("utf-8", "replace")
    except OSError:
        return ""


def target_of(link: Path) -> str:
    """What an open file is, which may be closed by now."""
    try:
        return str(link.readlink())
    except OSError:
        return ""


def sockets_of(folder: Path) -> set[str]:
    """Where the server's own process listens, TCP and UDP, of either family."""
    server = next(entry for entry in Path("/proc").glob("[0-9]*") if f"workbench\0{folder}\0" in words_of(entry))
    own = {target_of(link).removeprefix("socket:[").rstrip("]") for link in (server / "fd").iterdir()}
    found = set()
    for kind, listening in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        path = server / "net" / kind
        rows = [line.split() for line in path.read_text().splitlines()[1:]] if path.exists() else []
        found |= {row[1] for row in rows if row[3] == listening and row[9] in own}
    return found


def test_only_the_loopback_interface_listens(project: Path) -> None:
    with served_apart(project) as address:
        port = int(address.split(":")[2].split("/")[0])
        assert sockets_of(project) == {f"0100007F:{port:04X}"}
        noted = project / ".workbench" / "address"
        again = noted.read_text().strip()
        assert again != address  # for a second browser
        assert noted.stat().st_mode & 0o777 == (noted.parent / "token").stat().st_mode & 0o777 == 0o600
        assert token(project) not in (address, again)
        for one in (address, again):
            with urlopen(one) as answer:
                assert "Set-Cookie" in answer.headers
            with pytest.raises(HTTPError, match="403"):
                urlopen(one)
        assert noted.read_text().strip() not in (address, again)


def test_a_folder_that_is_a_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "is a file, no folder" in refused("workbench", tmp_path / "file", "--no-browser", code=2)
