"""Who is let in: the browser of this machine that was given the address with its token, and programs that know the token.

Against names that lead here from elsewhere (Host), pages of others that post here (Origin, a cookie that is never sent along from them),
frames around our pages, and scripts in what is shown (Content-Security-Policy). There is no way in without the token, whatever the path.
"""

import hmac
import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HERE = ("127.0.0.1", "localhost")
READING = ("GET", "HEAD")
PAGE = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
REPORT = (
    "sandbox allow-scripts allow-popups allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; frame-ancestors 'self'"
)
"""Of a page that a command wrote, with its scripts inside it: it may draw, and reach nothing, neither this server nor another."""


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(24)


class Guard:
    """Lets through to app what comes with the token, to 127.0.0.1 by its own name, and not from another page."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self.app, self.token = app, token
        self.hosts = {f"{name}:{port}" for name in HERE}
        self.origins = {f"http://{host}" for host in self.hosts}
        self.cookie = f"lmeasure-{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            else:
                await refusal(scope, receive, _with_headers(send))
            return
        await self.app(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> Response | None:
        """What is answered to one who may not come in; None to one who may."""
        headers = Headers(scope=scope)
        if headers.get("host", "") not in self.hosts:
            return PlainTextResponse("lmeasure: this server answers to 127.0.0.1 alone\n", 403)
        origin, method = headers.get("origin"), scope.get("method", "GET")
        if origin is not None and origin not in self.origins:
            return PlainTextResponse("lmeasure: asked from another page\n", 403)
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin") and not self._by_link(scope, headers):
            return PlainTextResponse("lmeasure: asked from another page\n", 403)
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and self._is_token(given):
            return None
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if scope["type"] == "http" and method in READING and scope["path"] == "/" and self._is_token(asked):
            welcome = RedirectResponse("/", 303)
            welcome.set_cookie(self.cookie, self.token, httponly=True, samesite="strict", path="/")
            return welcome
        if not self._is_token(self._of_cookie(headers)):
            return PlainTextResponse("lmeasure: open the address that `lmeasure workbench` printed, with its token\n", 403)
        if (method not in READING or scope["type"] == "websocket") and origin is None:
            return PlainTextResponse("lmeasure: a request that changes something says where it comes from\n", 403)
        return None

    def _by_link(self, scope: Scope, headers: Headers) -> bool:
        """A person followed a link to the first page, in a mail or a terminal."""
        return scope["type"] == "http" and scope["path"] == "/" and headers.get("sec-fetch-mode") == "navigate"

    def _of_cookie(self, headers: Headers) -> str:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return ""
        return "" if found is None else found.value

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.setdefault("Content-Security-Policy", PAGE)
            headers.setdefault("Cache-Control", "no-store")
            headers["X-Content-Type-Options"] = "nosniff"
            # by no-referrer a browser would not say where its forms come from
            headers["Referrer-Policy"] = "same-origin"
            headers["Cross-Origin-Opener-Policy"] = "same-origin"
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
        await send(message)

    return sent
