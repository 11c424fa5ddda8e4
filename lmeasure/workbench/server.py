"""The server: a project, its ways in and a port of 127.0.0.1 of their own; a desk has several of them open."""

import asyncio
import contextlib
import logging
import os
import re
import socket
import ssl
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path
from types import FrameType

import uvicorn
from jinja2 import pass_context
from jinja2.runtime import Context
from markupsafe import Markup, escape
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from lmeasure.core import LMeasureError
from lmeasure.io import not_written, os_reason
from lmeasure.report import BASE_STYLE, blocks, kept
from lmeasure.text import decimal, message, number, typed
from lmeasure.workbench import api, certificates, pages, project_files, register, runs
from lmeasure.workbench.answers import HERE, TEMPLATES, Bench, language_of, lost, refused, unread
from lmeasure.workbench.guard import ON_LOOPBACK, Door, Guard, Site, secured
from lmeasure.workbench.project import OWN
from lmeasure.workbench.project_list import Shelf
from lmeasure.workbench.text import said
from lmeasure.workflows import COMMANDS, load

GRACE_S = 3
LONGEST_END_S = 30.0
"""Longest time for the end of a server."""
_OPTION = re.compile(r"--[a-z][\w-]*")
for _name in COMMANDS:
    # at the start, in one thread: two requests must not see half-loaded modules
    load(_name)
ROUTES = (*pages.ROUTES, *project_files.ROUTES, *runs.ROUTES, *certificates.ROUTES, *register.ROUTES, *api.ROUTES)
CANNOT_READ = (LMeasureError, OSError, RecursionError)
"""Errors of reading a file of a project: a document may be too deep."""


def application(
    folder: Path,
    door: Door,
    port: int,
    language: str = "en",
    *,
    shelf: Shelf | None = None,
    site: Site = ON_LOOPBACK,
    scheduler: str | None = None,
) -> Starlette:
    """Return the application over a project folder, for those whom the door lets in; shelf: where the projects beside it are."""
    bench = Bench(folder.resolve(), language, door, shelf, site, scheduler)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        yield
        await bench.close()

    base = Route("/static/base.css", lambda _: FileResponse(BASE_STYLE))
    static = Mount("/static", StaticFiles(directory=HERE / "static"))
    app = Starlette(
        routes=[*ROUTES, base, static],
        middleware=[Middleware(Guard, door=door, port=port, site=site)],
        exception_handlers={HTTPException: _refused, **dict.fromkeys(CANNOT_READ, unread), Exception: _failed},
        lifespan=lifespan,
    )
    app.router.redirect_slashes = False
    app.state.bench = bench
    TEMPLATES.env.filters["words"] = lambda name: name.replace("_", " ")
    TEMPLATES.env.filters["whole"] = lambda line: Markup(_OPTION.sub(r'<span class="kept">\g<0></span>', str(escape(line))))
    TEMPLATES.env.filters["together"] = lambda text: Markup(kept(text))
    TEMPLATES.env.filters["blocks"] = blocks
    TEMPLATES.env.filters["number"] = _number
    TEMPLATES.env.filters["typed"] = typed
    return app


@pass_context
def _number(context: Context, value: float | str, form: str = "") -> str:
    """Return a number as the reader's language writes it: a value in a format, or a value and its U95 that are printed already."""
    language = context["language"]
    printed = value if isinstance(value, str) else number(language, value, form)
    return "\u00a0±\u00a0".join(re.sub("^-", "\u2212", decimal(language, one)) for one in printed.split(" ± "))


async def _refused(request: Request, error: Exception) -> Response:
    code = error.status_code if isinstance(error, HTTPException) else 500
    text = str(getattr(error, "detail", error))
    if code == HTTPStatus.NOT_FOUND:
        text = said(language_of(request), "workbench.there_no_such_page", page=request.scope["path"])
        return await run_in_threadpool(lost, request, text)
    return await run_in_threadpool(refused, request, code, str(code), text)


async def _failed(request: Request, error: Exception) -> Response:
    """Report a fault of this program: without a template, which may be the failing part, and with the headers of every answer."""
    text = said(language_of(request), "workbench.fault_this_program_traceback", fault=type(error).__name__)
    answer = PlainTextResponse(f"500\n{text}\n", 500)
    secured(answer.headers)
    return answer


class _Server(uvicorn.Server):
    """Ends when it is ended: where something is waited for that never comes, after LONGEST_END_S."""

    last: Callable[[], None]

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """End, or be ended."""
        super().handle_exit(sig, frame)

        def end() -> None:
            self.last()
            os._exit(128 + sig)

        timer = threading.Timer(LONGEST_END_S, end)
        timer.daemon = True
        timer.start()


def _is_fault(record: logging.LogRecord) -> bool:
    """Return whether a fault is none that a server has by itself when it ends before all that it computes."""
    given_up = record.exc_info is not None and isinstance(record.exc_info[1], asyncio.CancelledError)
    return not given_up and not record.getMessage().startswith("Cancel ")


class Served:
    """A project on a port: bound, and answered once it runs.

    PROJECT/.workbench/address has an address that lets in one browser, PROJECT/.workbench/token the token for programs; both are for this
    user alone, and last as long as the server. LMeasureError where the port is taken or the folder cannot be written.
    """

    def __init__(
        self, folder: Path, port: int, language: str, shelf: Shelf | None = None, *, site: Site = ON_LOOPBACK, scheduler: str | None = None
    ) -> None:
        self._site = site
        tls = _tls(site)
        self._listener = _listener(site.name, port)
        self._folder, self._port = folder, int(self._listener.getsockname()[1])
        self._door = Door(changed=self._spent)
        self._noted = {folder / OWN / "address": self.address(), folder / OWN / "token": self._door.token}
        try:
            for path, text in self._noted.items():
                _note(path, text)
        except BaseException:
            self._listener.close()
            raise
        app = application(folder, self._door, self._port, language, shelf=shelf, site=site, scheduler=scheduler)
        quiet = {"log_level": "warning", "access_log": False, "server_header": False, **tls}
        self._server = _Server(uvicorn.Config(app, timeout_graceful_shutdown=GRACE_S, **quiet))  # type: ignore[arg-type]
        self._server.last = self._forget
        logging.getLogger("uvicorn.error").addFilter(_is_fault)
        self._thread: threading.Thread | None = None

    def address(self) -> str:
        """Return a new address, which lets in one browser."""
        return f"{self._site.origin(self._port)}/?code={self._door.code()}"

    def show(self, opens: Callable[[str], object]) -> None:
        """Let the browser in that `opens` opens.

        A browser is called with an address as its argument, and every user of a machine reads the arguments of every program. So it is
        called with a file for this user alone, which leads it to an address and goes when that has been used.
        """
        path, address = self._folder / f"open-{self._port}.html", self.address()
        _note(path, f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0;url={address}">')
        self._noted[path] = address
        if opens(path.resolve().as_uri()) is False:
            path.unlink(missing_ok=True)

    def _spent(self, code: str) -> None:
        for path, text in list(self._noted.items()):
            if text.endswith(f"={code}"):
                with contextlib.suppress(OSError, LMeasureError):
                    path.unlink(missing_ok=True)
                    if path.suffix:
                        del self._noted[path]
                    else:
                        self._noted[path] = self.address()
                        _note(path, self._noted[path])

    def _forget(self) -> None:
        for path in self._noted:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)

    def run(self) -> None:
        """Answer until Ctrl-C, or, in another thread than the first, until the end."""
        try:
            with contextlib.suppress(KeyboardInterrupt):
                self._server.run(sockets=[self._listener])
        finally:
            self._listener.close()
            self._forget()

    def begin(self) -> None:
        """Answer from a thread of its own."""
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the thread, and the jobs of the project as by Ctrl-C."""
        self._server.should_exit = True
        if self._thread is not None:
            self._thread.join()


def _tls(site: Site) -> dict[str, str]:
    """Return the files of TLS as uvicorn takes them; LMeasureError where they do not fit each other, or need a password."""
    if site.certificate is None or site.key is None:
        return {}
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(site.certificate, site.key, lambda: "")
    except (OSError, ValueError) as error:
        why = " ".join(str(error).split())
        raise LMeasureError(message("error.tls_files", certificate=site.certificate, key=site.key, why=why)) from None
    return {"ssl_certfile": str(site.certificate), "ssl_keyfile": str(site.key)}


def _listener(name: str, port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((name, port))
        listener.listen(128)  # early requests wait until the server is up
    except OSError as error:
        listener.close()
        raise LMeasureError(message("error.port_of_cannot_be", port=port, loopback=name, error=os_reason(error))) from error
    return listener


def _note(path: Path, text: str) -> None:
    """Write a file that this user alone reads."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_CREAT | os.O_WRONLY | os.O_EXCL, 0o600), "w") as file:
            file.write(text + "\n")
    except OSError as error:
        raise LMeasureError(not_written(path, error)) from error


class Desk:
    """The open projects of a shelf in this process: each has a port, a token and sessions of its own, so that no page has access to another
    project."""

    def __init__(self, language: str, site: Site = ON_LOOPBACK, scheduler: str | None = None) -> None:
        self._language, self._site, self._scheduler = language, site, scheduler
        self._open: dict[Path, Served] = {}
        self._turn = threading.Lock()

    def put(self, folder: Path, served: Served) -> None:
        """Take a project that is open already."""
        self._open[folder.resolve()] = served

    def address(self, folder: Path, shelf: Shelf) -> str:
        """Return an address that lets a browser into a project, which is served from now on if it was not. LMeasureError where it cannot
        be."""
        with self._turn:
            served = self._open.get(folder.resolve())
            if served is None:
                served = Served(folder, 0, self._language, shelf, site=self._site, scheduler=self._scheduler)
                self._open[folder.resolve()] = served
                served.begin()
            return served.address()

    def is_open(self, folder: Path) -> bool:
        """Return whether a project is being served."""
        return folder.resolve() in self._open

    def close(self) -> None:
        for served in self._open.values():
            served.end()


def serve(
    folder: Path,
    port: int,
    language: str,
    say: Callable[[str], None],
    *,
    within: Path | None = None,
    show: Callable[[str], object] | None = None,
    site: Site = ON_LOOPBACK,
    scheduler: str | None = None,
) -> None:
    """Serve the project until Ctrl-C.

    say prints an address that lets in one browser; show opens a browser, which is let in. within: a folder of projects, which its pages
    begin and open. site: its address; scheduler: of its jobs. LMeasureError if the port is used or the folder cannot be written.
    """
    desk = Desk(language, site, scheduler)
    shelf = None if within is None else Shelf(within.resolve(), desk)
    served = Served(folder, port, language, shelf, site=site, scheduler=scheduler)
    desk.put(folder, served)
    say(served.address())
    if show is not None:
        served.show(show)
    try:
        served.run()
    finally:
        desk.close()
