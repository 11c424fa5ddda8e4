"""Common parts of pages and the API: the state of one server, and how errors and files are answered."""

import asyncio
import contextlib
import mimetypes
import os
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.templating import Jinja2Templates

from lmeasure.text import typed
from lmeasure.workbench import forms, guard
from lmeasure.workbench.cards import TITLES
from lmeasure.workbench.jobs import DONE, FAILED, Job, Jobs
from lmeasure.workbench.processes import prepared
from lmeasure.workbench.project import OutsideError, Project, inside, look_at
from lmeasure.workbench.project_list import Shelf
from lmeasure.workbench.text import preferred, said, why
from lmeasure.workbench.worker import Queue

HERE = Path(__file__).parent
TEMPLATES = Jinja2Templates(directory=HERE / "templates")
COOKIE = "lmeasure-language"
UPLOADS = 2
"""Most uploads at once; others wait."""
OF_PROGRAMS = ("/api/", "/along/")
"""Addresses that programs read: errors are JSON there."""
Form = dict[str, list[str]]
_LINK = re.compile(r'((?:href|src|action|data-src)=")/(?!/|shown/)')
"""An address of this server in a page."""


def playing(jobs: Jobs) -> Job | None:
    """The simulated cell that is being played."""
    return next((job for job in jobs.running() if job.command == "play"), None)


def bus_in_use(jobs: Jobs) -> dict[str, str]:
    """The bus that is used, by the options of commands: that of the cell that is played, with where its robot is at home, else that of the
    last job that had one."""
    cell = playing(jobs)
    last = cell or next((job for job in jobs.all() if job.command in ("check", "capture", "watch", "record", "scan") and _bus(job)), None)
    if last is None or not (bus := _bus(last)) or bus.startswith(("replay:", "simulated:")):
        return {}
    given = forms.of_words(last.command, last.words)
    reported = {"bus": bus, "bus_option": "\n".join(given.get("bus_option", []))}
    state = {} if cell is None else cell.last.get("cell", {})
    if state.get("at") == "home":
        reported["start"] = typed(state["pose"])
    return {key: text for key, text in reported.items() if text}


def _bus(job: Job) -> str:
    """The bus of a job's command line."""
    return str(forms.of_words(job.command, job.words).get("bus", ""))


def files_of(job: Job, folder: Path) -> list[str]:
    """Return the files of the project that a job wrote, pages first."""
    out = []
    for text in (job.result or {}).get("files", ()):
        try:
            path = inside(folder, str(text))
        except OutsideError:
            continue
        if path.is_file():
            out.append(path.relative_to(folder.resolve()).as_posix())
    return sorted(dict.fromkeys(out), key=lambda path: (not path.endswith(".html"), not path.endswith(".pdf"), path))


def doubted(jobs: Jobs, folder: Path) -> frozenset[str]:
    """Return the files that a failed job wrote, unless a later job wrote them anew, or a self-test of them passed."""
    out: set[str] = set()
    good: set[str] = set()
    for job in jobs.all():
        if job.state not in (DONE, FAILED):
            continue
        requested = forms.of_words(job.command, job.words)
        files = {*files_of(job, folder), *({str(requested["write"])} if requested.get("write") else ())}
        if job.state == FAILED:
            out |= files - good
        else:
            good |= {*files, *({str(requested["rig"])} if job.command == "check" and requested.get("rig") else ())}
    return frozenset(out)


@dataclass
class Bench:
    """One project, open in this server; shelf: where others are, if that was stated."""

    folder: Path
    language: str
    door: guard.Door
    shelf: Shelf | None = None
    site: guard.Site = guard.ON_LOOPBACK
    scheduler: str | None = None
    jobs: Jobs = field(init=False)
    reading: Queue = field(init=False, default_factory=Queue)
    taking: asyncio.Semaphore = field(init=False, default_factory=lambda: asyncio.Semaphore(UPLOADS))

    def __post_init__(self) -> None:
        self.jobs = Jobs(self.folder, self.language, self.scheduler)

    async def close(self) -> None:
        await self.jobs.close()

    def shown(self, path: str) -> str:
        """Return the address at which a file of the project is shown: it is good for that file alone, whose scripts can read it."""
        return f"{guard.SHOWN}{self.door.key(path)}/{quote(path)}"

    @property
    def project(self) -> Project:
        return replace(look_at(self.folder), known=bus_in_use(self.jobs), doubted=doubted(self.jobs, self.folder))


def bench_of(request: Request) -> Bench:
    """Return the state of the server of a request."""
    bench: Bench = request.app.state.bench
    return bench


def language_of(request: Request) -> str:
    """The language that was chosen, else the browser's."""
    chosen = request.cookies.get(COOKIE, "")
    return chosen if chosen in ("en", "ru") else preferred(request.headers.get("accept-language", ""))


def page(request: Request, name: str, status: int = 200, **values: Any) -> Response:
    """Return a page from its template, with the words of its reader; addresses in it get the path of the reader's session."""
    language = language_of(request)
    bench = bench_of(request)
    prepared.want_soon()
    known = {"language": language, "bench": bench, "titles": TITLES, "here": request.scope["path"]}
    known["origin"] = f"{request.url.scheme}://{request.headers['host']}{request.scope['at']}"
    known |= {"running": bench.jobs.running(), "playing": playing(bench.jobs)}
    known |= {"_": lambda text, **more: said(language, text, **more), **values}
    text = TEMPLATES.get_template(name).render(known)
    return Response(_LINK.sub(rf"\g<1>{request.scope['at']}/", text), status, media_type="text/html")


def job_of(request: Request) -> Job:
    """The job of the path; OutsideError where there is none."""
    job = bench_of(request).jobs.jobs.get(int(request.path_params["number"]))
    if job is None:
        raise OutsideError("workbench.there_no_such_job")
    return job


def file_of(request: Request) -> Path:
    """The file of the path, within the project; OutsideError where there is none, or it is none of the project."""
    with contextlib.suppress(OutsideError, OSError):
        path = inside(bench_of(request).folder, request.path_params["path"])
        if path.is_file():
            return path
    raise OutsideError("workbench.there_no_such_file")


def as_file(path: Path, *, shown: bool = False) -> Response:
    """A file of the project, to be saved, or shown: pages of reports may draw, and do nothing else."""
    kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    if path.suffix in (".toml", ".csv", ".log", ".txt", ".md"):
        kind = "text/plain; charset=utf-8"
    draws = shown and kind in ("text/html", "image/svg+xml")
    headers = {"Content-Security-Policy": guard.REPORT if draws else "default-src 'none'; sandbox"}
    if shown:
        return FileResponse(path, media_type=kind, headers=headers)
    return FileResponse(path, media_type=kind, headers=headers, filename=path.name)


def plain(text: str) -> str:
    """Return a text that can be written: a request may contain half a letter."""
    return text.encode("utf-8", "replace").decode()


async def form_of(request: Request) -> Form:
    """Return the content of a form, without files."""
    async with request.form(max_files=0, max_fields=1000) as form:
        return {plain(key): [plain(str(value)) for value in form.getlist(key)] for key in form}


@asynccontextmanager
async def uploads_of(request: Request, most: int) -> AsyncIterator[tuple[Form, list[tuple[str, Any]]]]:
    """Yield the fields of a form, and the names and contents of its files, at most so many."""
    async with bench_of(request).taking, request.form(max_files=most, max_fields=20) as form:
        fields = {plain(key): [plain(value) for value in form.getlist(key) if isinstance(value, str)] for key in form}
        files = [one for one in form.getlist("files") if not isinstance(one, str) and one.filename]
        yield fields, [(plain(one.filename or ""), one.file) for one in files]


def posted(answer: Callable[[Request, Form], Response]) -> Callable[[Request], Awaitable[Response]]:
    """Return a handler that answers with a posted form, empty without one, in a thread: files are read and written there."""

    async def answered(request: Request) -> Response:
        form = await form_of(request) if request.method == "POST" else {}
        return await run_in_threadpool(answer, request, form)

    return answered


def unread(request: Request, error: Exception) -> Response:
    """Report a path in the project: not found if it is no file of the project, else unreadable."""
    missing, language = isinstance(error, OutsideError), language_of(request)
    text = within(bench_of(request).folder, error, language)
    if request.scope["path"].startswith(OF_PROGRAMS):
        return JSONResponse({"error": said(language, text)}, 404 if missing else 422)
    return lost(request, text) if missing else refused(request, 422, said(language, "workbench.cannot_read"), text)


def within(folder: Path, error: Exception, language: str) -> str:
    """Return the text of an error, with paths as they are called in the project."""
    return why(language, error).replace(f"{folder.resolve()}{os.sep}", "").replace(f"{folder}{os.sep}", "")


def lost(request: Request, text: str) -> Response:
    """Not found, and why in the reader's words where there are some."""
    language = language_of(request)
    return refused(request, 404, said(language, "workbench.not_found"), said(language, text))


def refused(request: Request, status: int, title: str, text: str) -> Response:
    """Return a page with the reason why there is no other."""
    return page(request, "error.html", status, title=title, text=plain(text))
