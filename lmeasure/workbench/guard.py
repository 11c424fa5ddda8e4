"""Access control: a browser with a one-time address, and programs with the token, are let in.

Cookies ignore ports: every server of 127.0.0.1 receives those of this one. A session is therefore two secrets. One is a part of the path of
all its pages (`/~SECRET/rig`), the other a cookie for that path alone. No other server receives the cookie, as it has no such path; and
neither secret is useful without the other. A page can read its own address. So reports and other files with scripts of their own are shown
at addresses outside that path, each good for one file.

Further checks: names that lead here from elsewhere (Host), requests of other pages (Origin, Sec-Fetch-Site), frames around our pages,
scripts in shown files (Content-Security-Policy), and requests of a wrong size.
"""

import hashlib
import hmac
import secrets
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lmeasure.io import LARGEST_NAME
from lmeasure.text import message
from lmeasure.workbench.text import preferred, said

HERE = "127.0.0.1"
"""The one name of this server: by `localhost` a browser may come to another program's [::1]."""
HTTPS = 443
READING = ("GET", "HEAD")
SESSION = "/~"
SHOWN = "/shown/"
"""Before the key and path of a file that is shown outside the session's path."""
LARGEST_PATH, LARGEST_HEADERS = 4096, 2**16
"""Bytes of a path, and of all headers."""
LARGEST_BODY, LARGEST_UPLOAD = 2**21, 2**31
UPLOADS = ("/upload", "/verify")
PAGE = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
REPORT = (
    "sandbox allow-scripts allow-popups allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; frame-ancestors 'self'"
)
"""Policy for a page that a command wrote, with its scripts inside it: it may draw, but reach neither this server nor another."""


class Site(NamedTuple):
    """The name by which browsers reach a server, and files of its TLS certificate and key; without them it serves this machine alone."""

    name: str = HERE
    certificate: Path | None = None
    key: Path | None = None

    @property
    def secure(self) -> bool:
        """Return whether it is served by TLS."""
        return self.certificate is not None

    def host(self, port: int) -> str:
        """Return its Host header, as browsers send it."""
        return self.name if self.secure and port == HTTPS else f"{self.name}:{port}"

    def origin(self, port: int) -> str:
        """Return its origin."""
        return f"http{'s' if self.secure else ''}://{self.host(port)}"


ON_LOOPBACK = Site()


class Session(NamedTuple):
    """A browser that was let in: the path before all of its pages, and the value of its cookie."""

    path: str
    cookie: str


class Door:
    """The ways into one server: a token for programs, codes that let in one browser each, and the sessions of those browsers.

    changed is called with a code once it was spent.
    """

    def __init__(self, token: str = "", changed: Callable[[str], None] = lambda code: None) -> None:
        self.token = token or secrets.token_urlsafe(24)
        self.changed = changed
        self._codes: set[str] = set()
        self._sessions: dict[str, Session] = {}
        self._key = secrets.token_bytes(32)
        self._turn = threading.Lock()

    def code(self) -> str:
        """Return a new code, which lets in one browser."""
        with self._turn:
            self._codes.add(code := secrets.token_urlsafe(24))
        return code

    def spend(self, code: str) -> Session | None:
        """Return a new session for a code that was not spent before; None for any other text."""
        with self._turn:
            if not any(_same(code, known) for known in self._codes):
                return None
            self._codes.discard(code)
            session = Session(SESSION + secrets.token_urlsafe(18), secrets.token_urlsafe(24))
            self._sessions[session.path] = session
        self.changed(code)
        return session

    def knows(self, path: str, cookie: str) -> bool:
        """Return whether path and cookie belong to one session."""
        session = self._sessions.get(path)
        return session is not None and _same(cookie, session.cookie)

    def key(self, path: str) -> str:
        """Return the secret part of the address of one file of the project."""
        return hmac.new(self._key, path.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()[:40]


class Guard:
    """Let through to app requests from a session or with the token, under the site's own name, and not from another page."""

    def __init__(self, app: ASGIApp, door: Door, port: int, site: Site = ON_LOOPBACK) -> None:
        self.app, self.door, self.site = app, door, site
        self.host, self.origin = site.host(port), site.origin(port)
        self.cookie = f"lmeasure-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        let_in = self._let_in(scope)
        if isinstance(let_in, Response):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            else:
                await let_in(scope, receive, _answering(send, ""))
            return
        most, length = LARGEST_UPLOAD if let_in["path"] in UPLOADS else LARGEST_BODY, Headers(scope=scope).get("content-length", "0")
        if int(length) > most:
            await _refusal(Headers(scope=scope), _too_large(most), 413)(scope, receive, _answering(send, ""))
            return
        await self.app(let_in, _bounded(receive, most), _answering(send, let_in["at"]))

    def _let_in(self, scope: Scope) -> Scope | Response:
        """Return the request for the pages, with its session's path in `at`, or the refusal."""
        headers, path = Headers(scope=scope), scope["path"]
        if headers.get("host", "") != self.host:
            return _refusal(headers, message("guard.other_host", host=self.site.name))
        origin, method = headers.get("origin"), scope.get("method", "GET")
        if origin is not None and origin != self.origin:
            return _refusal(headers, message("guard.other_page"))
        # a person followed a link to the first page, in a mail or a terminal
        by_link = scope["type"] == "http" and path == "/" and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not by_link:
            return _refusal(headers, message("guard.other_page"))
        if (strange := _strange(path, headers)) is not None:
            return strange
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and _same(given, self.door.token):
            return {**scope, "at": ""}
        if path.startswith(SHOWN) and method in READING:
            key, _, file = path.removeprefix(SHOWN).partition("/")
            if _same(key, self.door.key(file)):
                return {**scope, "at": ""}
        if scope["type"] == "http" and method == "GET" and path == "/" and "code" in (query := _query(scope)):
            session = self.door.spend(query["code"][0])
            if session is not None:
                return self._welcome(session)
            return _refusal(headers, message("guard.used_address"))
        begin, _, rest = path[1:].partition("/")
        # another server may have set a cookie of the same name for all paths: both come
        if not any(self.door.knows(f"/{begin}", cookie) for cookie in self._cookies(headers)):
            return _refusal(headers, message("guard.open_address"))
        if (method not in READING or scope["type"] == "websocket") and origin is None:
            return _refusal(headers, message("guard.no_origin"))
        return {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode(), "at": f"/{begin}"}

    def _welcome(self, session: Session) -> Response:
        """Return a page that leads on by itself. After a redirection the browser would not send the cookie, since the request came from a
        file or a mail."""
        answer = HTMLResponse(
            f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0;url={session.path}/"><title>lmeasure</title>'
            f'<link rel="icon" href="data:,"><a href="{session.path}/">lmeasure</a>'
        )
        answer.set_cookie(self.cookie, session.cookie, httponly=True, samesite="strict", secure=self.site.secure, path=f"{session.path}/")
        return answer

    def _cookies(self, headers: Headers) -> list[str]:
        pairs = (part.strip().partition("=") for part in headers.get("cookie", "").split(";"))
        return [value for name, _, value in pairs if name == self.cookie]


def _query(scope: Scope) -> dict[str, list[str]]:
    try:
        return parse_qs(scope.get("query_string", b"").decode("latin-1"))
    except ValueError:
        return {}


def _same(given: str, secret: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), secret.encode())


def _refusal(headers: Headers, text: str, status: int = 403) -> Response:
    """Return an answer in the browser's language."""
    return PlainTextResponse(f"lmeasure: {said(preferred(headers.get('accept-language', '')), text)}\n", status)


def _too_large(most: int) -> str:
    return message("guard.too_large", megabytes=most / 2**20)


def _strange(path: str, headers: Headers) -> Response | None:
    """Return the refusal of a malformed request; None for others."""
    encoded = path.encode("utf-8", "surrogatepass")
    if b"\0" in encoded or len(encoded) > LARGEST_PATH or any(len(part) > LARGEST_NAME for part in encoded.split(b"/")):
        return _refusal(headers, message("guard.no_page"), 404)
    if sum(len(name) + len(value) for name, value in headers.raw) > LARGEST_HEADERS:
        return _refusal(headers, message("guard.headers", bytes=LARGEST_HEADERS), 431)
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()) or len(length) > 15:
        return _refusal(headers, message("guard.length"), 400)
    return None


def _bounded(receive: Receive, most: int) -> Receive:
    """Receive a body of at most so many bytes."""
    taken = 0

    async def received() -> Message:
        nonlocal taken
        came = await receive()
        if came["type"] == "http.request":
            taken += len(came.get("body", b""))
            if taken > most:
                raise HTTPException(413, _too_large(most))
        return came

    return received


def secured(headers: MutableHeaders) -> None:
    """Set the headers of every answer on scripts, frames, copies and addresses."""
    headers.setdefault("Content-Security-Policy", PAGE)
    headers.setdefault("Cache-Control", "no-store")
    headers["X-Content-Type-Options"] = "nosniff"
    # never a path, which is half of a session; with no-referrer a browser would hide the origin of its forms
    headers["Referrer-Policy"] = "strict-origin"
    headers["Cross-Origin-Opener-Policy"] = "same-origin"
    headers["Cross-Origin-Resource-Policy"] = "same-origin"


def _answering(send: Send, at: str) -> Send:
    """Send with the headers of every answer; addresses of this server are those of the session."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            secured(headers)
            there = headers.get("location", "")
            if at and there.startswith("/") and not there.startswith("//"):
                headers["location"] = at + there
        await send(message)

    return sent
