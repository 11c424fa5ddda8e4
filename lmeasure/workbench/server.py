"""The server: a project, a token and a port of 127.0.0.1 of their own; a desk has several of them open."""

import contextlib
import os
import re
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path

import uvicorn
from markupsafe import Markup, escape
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles

from lmeasure.catalogue import decimal
from lmeasure.errors import LMeasureError
from lmeasure.files import not_written
from lmeasure.workbench import api, calibrations, certificates, pages, projects, runs, things
from lmeasure.workbench.answers import HERE, TEMPLATES, Bench, language_of, lost, page
from lmeasure.workbench.guard import Guard, new_token
from lmeasure.workbench.project import OWN
from lmeasure.workbench.shelf import Shelf
from lmeasure.workbench.words import said

LOOPBACK = "127.0.0.1"
GRACE_S = 3
_OPTION = re.compile(r"--[a-z][\w-]*")
_UNIT = re.compile(r"(?<=\d) (?=(?:mm|мм|%|°)(?!\w))")
ROUTES = (projects, pages, things, runs, calibrations, certificates, api)
"""Modules that answer."""


def application(folder: Path, token: str, port: int, language: str = "en", *, shelf: Shelf | None = None) -> Starlette:
    """The application over a project folder, for who has the token; shelf: where the projects beside it are."""
    bench = Bench(folder.resolve(), language, shelf)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        yield
        await bench.jobs.close()

    static = Mount("/static", StaticFiles(directory=HERE / "static"))
    app = Starlette(
        routes=[*(route for module in ROUTES for route in module.routes()), static],
        middleware=[Middleware(Guard, token=token, port=port)],
        exception_handlers={HTTPException: _refused, Exception: _failed},
        lifespan=lifespan,
    )
    app.state.bench = bench
    TEMPLATES.env.filters["words"] = lambda name: name.replace("_", " ")
    TEMPLATES.env.filters["whole"] = lambda line: Markup(_OPTION.sub(r'<span class="whole">\g<0></span>', str(escape(line))))
    TEMPLATES.env.filters["together"] = lambda text: _UNIT.sub("\u00a0", text.replace(" -", " \u2212").replace(" ± ", "\u00a0±\u00a0"))
    TEMPLATES.env.filters["printed"] = lambda text, language: "\u00a0±\u00a0".join(
        re.sub("^-", "\u2212", decimal(language, one)) for one in text.split(" ± ")
    )
    return app


async def _refused(request: Request, error: Exception) -> Response:
    if isinstance(error, HTTPException) and error.status_code == HTTPStatus.NOT_FOUND:
        return lost(request, said(language_of(request), "{page}: there is no such page", page=request.url.path))
    code = error.status_code if isinstance(error, HTTPException) else 500
    return page(request, "error.html", code, title=str(code), text=str(getattr(error, "detail", error)))


async def _failed(request: Request, error: Exception) -> Response:
    told = "A fault of this program: {fault}. Nothing was left half-written."
    text = said(language_of(request), told, fault=type(error).__name__)
    return page(request, "error.html", 500, title="500", text=text)


class Served:
    """A project on a port: bound and its address noted, for this user alone, in PROJECT/.workbench/address; answered once it runs.

    LMeasureError where the port is taken or the folder cannot be written.
    """

    def __init__(self, folder: Path, port: int, language: str, shelf: Shelf | None = None) -> None:
        self._listener = _listener(port)
        try:
            port, token = int(self._listener.getsockname()[1]), new_token()
            self.address = f"http://{LOOPBACK}:{port}/?token={token}"
            self._noted = folder / OWN / "address"
            _note(self._noted, self.address)
        except BaseException:
            self._listener.close()
            raise
        app = application(folder, token, port, language, shelf=shelf)
        quiet = {"log_level": "warning", "access_log": False, "server_header": False}
        self._server = uvicorn.Server(uvicorn.Config(app, timeout_graceful_shutdown=GRACE_S, **quiet))  # type: ignore[arg-type]
        self._thread: threading.Thread | None = None

    def run(self) -> None:
        """Answer until Ctrl-C, or, in another thread than the first, until the end."""
        try:
            with contextlib.suppress(KeyboardInterrupt):
                self._server.run(sockets=[self._listener])
        finally:
            self._listener.close()
            self._noted.unlink(missing_ok=True)

    def begin(self) -> None:
        """Answer from a thread of its own."""
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the thread, and the jobs of the project as by Ctrl-C."""
        self._server.should_exit = True
        if self._thread is not None:
            self._thread.join()


def _listener(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen(128)  # who comes before the server is up waits
    except OSError as error:
        listener.close()
        raise LMeasureError(f"port {port} of {LOOPBACK} cannot be had: {error.strerror or error}; --port 0 takes a free one") from error
    return listener


def _note(path: Path, address: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_CREAT | os.O_WRONLY | os.O_EXCL, 0o600), "w") as file:
            file.write(address + "\n")
    except OSError as error:
        raise LMeasureError(not_written(path, error)) from error


class Desk:
    """The projects of a shelf that this process has open: each has a port, a token and cookies of its own, so that a page of one says
    nothing in another, whatever is open in how many windows."""

    def __init__(self, language: str) -> None:
        self._language = language
        self._open: dict[Path, Served] = {}
        self._turn = threading.Lock()

    def put(self, folder: Path, served: Served) -> None:
        """A project that is open already."""
        self._open[folder.resolve()] = served

    def address(self, folder: Path, shelf: Shelf) -> str:
        """Where a project is served, from now on if it was not. LMeasureError where it cannot be."""
        with self._turn:
            served = self._open.get(folder.resolve())
            if served is None:
                served = self._open[folder.resolve()] = Served(folder, 0, self._language, shelf)
                served.begin()
            return served.address

    def is_open(self, folder: Path) -> bool:
        """Whether a project is being served."""
        return folder.resolve() in self._open

    def close(self) -> None:
        """End what was opened here."""
        for served in self._open.values():
            served.end()


def serve(folder: Path, port: int, language: str, say: Callable[[str], None], *, within: Path | None = None) -> None:
    """Serve the project until Ctrl-C; say is told the address with its token. within: a folder whose folders are projects, which its pages
    begin and open.

    LMeasureError where the port is taken or the folder cannot be written.
    """
    desk = Desk(language)
    shelf = None if within is None else Shelf(within.resolve(), desk)
    served = Served(folder, port, language, shelf)
    desk.put(folder, served)
    say(served.address)
    try:
        served.run()
    finally:
        desk.close()
