"""The server: one project, one token, 127.0.0.1 alone."""

import contextlib
import os
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles

from lmeasure.errors import LMeasureError
from lmeasure.workbench import api, certificates, pages, runs, things
from lmeasure.workbench.answers import HERE, TEMPLATES, Bench, page
from lmeasure.workbench.guard import Guard, new_token
from lmeasure.workbench.project import OWN

LOOPBACK = "127.0.0.1"


def application(folder: Path, token: str, port: int, language: str = "en") -> Starlette:
    """The application over a project folder, for who has the token."""
    bench = Bench(folder.resolve(), language)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        yield
        await bench.jobs.close()

    static = Mount("/static", StaticFiles(directory=HERE / "static"))
    app = Starlette(
        routes=[*pages.routes(), *things.routes(), *runs.routes(), *certificates.routes(), *api.routes(), static],
        middleware=[Middleware(Guard, token=token, port=port)],
        exception_handlers={HTTPException: _refused, Exception: _failed},
        lifespan=lifespan,
    )
    app.state.bench = bench
    TEMPLATES.env.filters["words"] = lambda name: name.replace("_", " ")
    return app


async def _refused(request: Request, error: Exception) -> Response:
    code = error.status_code if isinstance(error, HTTPException) else 500
    return page(request, "error.html", code, title=str(code), text=str(getattr(error, "detail", error)))


async def _failed(request: Request, error: Exception) -> Response:
    text = f"A fault of this program: {type(error).__name__}. Nothing was left half-written."
    return page(request, "error.html", 500, title="500", text=text)


def serve(folder: Path, port: int, language: str, say: Callable[[str], None]) -> None:
    """Serve the project until Ctrl-C; say is told the address with its token, which also stands in PROJECT/.workbench/address, for this
    user alone.

    LMeasureError where the port is taken or the folder cannot be written.
    """
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen(128)  # who comes before the server is up waits
    except OSError as error:
        listener.close()
        raise LMeasureError(f"port {port} of {LOOPBACK} cannot be had: {error.strerror or error}; --port 0 takes a free one") from error
    with listener:
        port, token = int(listener.getsockname()[1]), new_token()
        address = f"http://{LOOPBACK}:{port}/?token={token}"
        noted = folder / OWN / "address"
        try:
            noted.parent.mkdir(parents=True, exist_ok=True)
            noted.unlink(missing_ok=True)
            with os.fdopen(os.open(noted, os.O_CREAT | os.O_WRONLY | os.O_EXCL, 0o600), "w") as file:
                file.write(address + "\n")
        except OSError as error:
            raise LMeasureError(f"{noted}: cannot be written: {error.strerror or error}") from error
        say(address)
        config = uvicorn.Config(
            application(folder, token, port, language),
            log_level="warning",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=3,
        )
        try:
            with contextlib.suppress(KeyboardInterrupt):
                uvicorn.Server(config).run(sockets=[listener])
        finally:
            noted.unlink(missing_ok=True)
