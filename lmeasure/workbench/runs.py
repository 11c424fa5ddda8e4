"""Runs, and what was made of them: which still lack their start, a trajectory over time, rerun's viewer for a recording."""

from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from lmeasure.core import LMeasureError
from lmeasure.recording import read_run_head
from lmeasure.view import policy as web_policy, viewer_file
from lmeasure.workbench import trajectories
from lmeasure.workbench.answers import bench_of, file_of, language_of, lost, page, unread, within
from lmeasure.workbench.project import Project


class RunAt(NamedTuple):
    """A run of the project: its path; what its start is: stated, reported (by encoders), missing, or unread; what is wrong with
    its files; what its recording says."""

    path: str
    start: str
    error: str
    reported: tuple[str, ...]


def runs(project: Project, language: str) -> list[RunAt]:
    """All runs of a project as they stand."""
    return [_run(project.folder, path, language) for path in project.of("run")]


def _run(folder: Path, path: str, language: str) -> RunAt:
    try:
        head = read_run_head(folder / path)
    except (LMeasureError, OSError) as error:
        return RunAt(path, "unread", within(folder, error), ())
    start = "stated" if head.start is not None else "reported" if head.rig.swivel else "missing"
    return RunAt(path, start, "", tuple(note.text(language) for one in head.recorded for note in one.notes()))


async def trajectory(request: Request) -> Response:
    """A trajectory over time: plots under one cursor, what is left out, and ways to take it elsewhere."""
    path = await run_in_threadpool(file_of, request)
    if path is None:
        return await run_in_threadpool(lost, request, "workbench.there_no_such_file")
    try:
        found = await bench_of(request).reading.ask(trajectories.about, path, language_of(request))
    except (LMeasureError, OSError) as error:
        return await run_in_threadpool(unread, request, error)
    return await run_in_threadpool(_trajectory, request, path, found)


def _trajectory(request: Request, path: Path, found: dict[str, Any]) -> Response:
    project = bench_of(request).project
    here = path.relative_to(project.folder).as_posix()
    recordings = [one for one in project.of("recording") if Path(one).parent == Path(here).parent] or list(project.of("recording"))
    return page(request, "trajectory.html", path=here, recordings=recordings[:1], **found)


def _span(request: Request) -> tuple[float, float]:
    """The span that an address asks for, ?begin=...&end=... in s; ValueError for none."""
    return float(request.query_params.get("begin", "-inf")), float(request.query_params.get("end", "inf"))


async def along_json(request: Request) -> Response:
    """Series of a span of time: some samples, the extremes among them; null where nothing is known."""
    path = await run_in_threadpool(file_of, request)
    if path is None:
        return JSONResponse({"error": "no such file in the project"}, 404)
    try:
        return JSONResponse(await bench_of(request).reading.ask(trajectories.series_of, path, *_span(request)))
    except (LMeasureError, OSError, ValueError) as error:
        return JSONResponse({"error": within(bench_of(request).folder, error)}, 422)


async def export(request: Request) -> Response:
    """The samples of a span as .csv, all columns of a trajectory file."""
    path, reading = await run_in_threadpool(file_of, request), bench_of(request).reading
    if path is None:
        return await run_in_threadpool(lost, request, "workbench.there_no_such_file")
    try:
        span = _span(request)
        text, row = await reading.ask(trajectories.rows, path, *span, 0)
    except (LMeasureError, OSError, ValueError) as error:
        return await run_in_threadpool(unread, request, error)

    async def pieces() -> AsyncIterator[str]:
        yield text
        there = row
        while there:
            piece, there = await reading.ask(trajectories.rows, path, *span, there)
            yield piece

    return StreamingResponse(pieces(), media_type="text/csv", headers={"Content-Disposition": 'attachment; filename="span.csv"'})


def viewer(request: Request) -> Response:
    """rerun's viewer, as `lmeasure view --web` serves it; its page runs its own code and reads recordings of the project alone."""
    name = request.path_params["path"]
    try:
        found = viewer_file(name)
    except (LMeasureError, OSError) as error:
        return unread(request, error)
    if found is None:
        return lost(request, "workbench.there_no_such_file")
    kind, content = found
    origin = f"{request.url.scheme}://{request.headers['host']}{request.scope['at']}"
    policy = web_policy(f"{origin}/raw/ {origin}/viewer/") + "; frame-ancestors 'self'"
    headers = {"Content-Security-Policy": policy, "Cache-Control": "no-store" if kind.startswith("text/html") else "private, max-age=86400"}
    return Response(content, media_type=kind, headers=headers)


def routes() -> Sequence[Route]:
    """Of these pages."""
    return [
        Route("/trajectory/{path:path}", trajectory),
        Route("/along/{path:path}", along_json),
        Route("/export/{path:path}", export),
        Route("/viewer/{path:path}", viewer),
    ]
