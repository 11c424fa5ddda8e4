"""What pages and the API share: the state of one server, and how errors and files are answered."""

import asyncio
import mimetypes
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.templating import Jinja2Templates

from lmeasure.workbench import buses, guard, tour
from lmeasure.workbench.cards import TITLES
from lmeasure.workbench.jobs import Job, Jobs
from lmeasure.workbench.processes import prepared
from lmeasure.workbench.project import OWN, OutsideError, Project, inside, look_at
from lmeasure.workbench.shelf import Shelf
from lmeasure.workbench.words import preferred, said

HERE = Path(__file__).parent
TEMPLATES = Jinja2Templates(directory=HERE / "templates")
COOKIE = "lmeasure-language"
PAUSE_S = 0.5
"""After which a page stands in its browser, and the first job may be prepared."""


@dataclass
class Bench:
    """One project, open in this server; shelf: where others are, if that was stated."""

    folder: Path
    language: str
    shelf: Shelf | None = None
    jobs: Jobs = field(init=False)

    def __post_init__(self) -> None:
        self.jobs = Jobs(self.folder, self.language)

    @property
    def project(self) -> Project:
        """As it is now."""
        return replace(look_at(self.folder), known=buses.known(self.jobs))


def bench_of(request: Request) -> Bench:
    """The state of the server that was asked."""
    bench: Bench = request.app.state.bench
    return bench


def language_of(request: Request) -> str:
    """The language that was chosen, else the browser's."""
    chosen = request.cookies.get(COOKIE, "")
    return chosen if chosen in ("en", "ru") else preferred(request.headers.get("accept-language", ""))


def page(request: Request, name: str, status: int = 200, **values: Any) -> Response:
    """A page from its template, with the words of its reader."""
    language = language_of(request)
    bench = bench_of(request)
    asyncio.get_running_loop().call_later(PAUSE_S, prepared.want)
    stop = tour.shown(bench.project, asked) if (asked := request.query_params.get("tour", "")) else None
    known = {"language": language, "bench": bench, "tour": stop, "titles": TITLES}
    known |= {"running": bench.jobs.running(), "playing": buses.playing(bench.jobs)}
    return TEMPLATES.TemplateResponse(
        request,
        name,
        {"_": lambda text, **more: said(language, text, **more), **known, **values},
        status_code=status,
    )


def job_of(request: Request) -> Job | None:
    """The job of the path; None where there is none."""
    return bench_of(request).jobs.jobs.get(int(request.path_params["number"]))


def file_of(request: Request) -> Path | None:
    """The file of the path, within the project; None where there is none, or it is none of the project."""
    try:
        path = inside(bench_of(request).folder, request.path_params["path"])
    except OutsideError:
        return None
    hidden = any(part.startswith(".") for part in path.relative_to(bench_of(request).folder.resolve()).parts)
    return path if path.is_file() and not hidden and OWN not in path.parts else None


def as_file(path: Path) -> Response:
    """A file of the project; pages of reports may draw, and do nothing else."""
    kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    if path.suffix in (".toml", ".csv", ".log", ".txt", ".md"):
        kind = "text/plain; charset=utf-8"
    headers = {"Content-Security-Policy": guard.REPORT if kind in ("text/html", "image/svg+xml") else "default-src 'none'; sandbox"}
    if kind == "application/pdf":
        headers["Content-Security-Policy"] = "default-src 'none'; object-src 'self'; frame-ancestors 'self'"
    return FileResponse(path, media_type=kind, headers=headers)


async def form_of(request: Request) -> dict[str, list[str]]:
    """What a form says, without files."""
    async with request.form(max_files=0, max_fields=1000) as form:
        return {key: [str(value) for value in form.getlist(key)] for key in form}


def unread(request: Request, error: Exception) -> Response:
    """What is no file of the project is not found; what is there and cannot be read is said to be so, by its path in the project."""
    if isinstance(error, OutsideError):
        return lost(request, str(error))
    return page(
        request, "error.html", 422, title=said(language_of(request), "It cannot be read"), text=within(bench_of(request).folder, error)
    )


def within(folder: Path, error: Exception) -> str:
    """What an error says, with paths as they are called in the project."""
    return str(error).replace(f"{folder.resolve()}{os.sep}", "").replace(f"{folder}{os.sep}", "")


def lost(request: Request, text: str) -> Response:
    """Not found, and why in the reader's words where there are some."""
    language = language_of(request)
    return page(request, "error.html", 404, title=said(language, "Not found"), text=said(language, text))
