"""Runs and their results: runs without a start, a trajectory over time, rerun's viewer for a recording."""

import math
import shlex
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from lmeasure.calibration import Comparison, chance, compare_records, read_earlier
from lmeasure.core import LMeasureError
from lmeasure.recording import read_run_head
from lmeasure.text import Say, message
from lmeasure.view import policy as web_policy, viewer_file
from lmeasure.workbench import trajectories
from lmeasure.workbench.answers import Bench, bench_of, file_of, language_of, page, within
from lmeasure.workbench.project import LARGEST_JSON, OutsideError, Project, inside


class RunAt(NamedTuple):
    """A run of the project: its path; its start: stated, reported (by encoders), missing, or unread; the faults of its files; the state of
    its recording."""

    path: str
    start: str
    error: str
    reported: tuple[str, ...]


def runs(project: Project, language: str) -> list[RunAt]:
    """Return all runs of a project."""
    return [_run(project.folder, path, language) for path in project.of("run")]


def _run(folder: Path, path: str, language: str) -> RunAt:
    try:
        head = read_run_head(folder / path)
    except (LMeasureError, OSError) as error:
        return RunAt(path, "unread", within(folder, error, language), ())
    start = "stated" if head.start is not None else "reported" if head.rig.swivel else "missing"
    return RunAt(path, start, "", tuple(note.text(language) for one in head.recorded for note in one.notes()))


async def trajectory(request: Request) -> Response:
    """Answer with a trajectory over time: plots under one cursor, omitted samples, and exports."""
    path = await run_in_threadpool(file_of, request)
    found = await bench_of(request).reading.ask(trajectories.about, path, language_of(request))
    return await run_in_threadpool(_trajectory, request, path, found)


def _trajectory(request: Request, path: Path, found: dict[str, Any]) -> Response:
    project = bench_of(request).project
    here = path.relative_to(project.folder).as_posix()
    recordings = [one for one in project.of("recording") if Path(one).parent == Path(here).parent] or list(project.of("recording"))
    return page(request, "trajectory.html", path=here, recordings=recordings[:1], **found)


def _span(request: Request) -> tuple[float, float]:
    """Return the span of an address, ?begin=...&end=... in s."""
    try:
        return float(request.query_params.get("begin", "-inf")), float(request.query_params.get("end", "inf"))
    except ValueError as error:
        raise LMeasureError(str(error)) from None


async def along_json(request: Request) -> Response:
    """Series of a span of time: some samples, the extremes among them; null where nothing is known."""
    path = await run_in_threadpool(file_of, request)
    return JSONResponse(await bench_of(request).reading.ask(trajectories.series_of, path, *_span(request)))


async def export(request: Request) -> Response:
    """The samples of a span as .csv, all columns of a trajectory file."""
    path, reading = await run_in_threadpool(file_of, request), bench_of(request).reading
    span = _span(request)
    text, row = await reading.ask(trajectories.rows, path, *span, 0)

    async def pieces() -> AsyncIterator[str]:
        yield text
        there = row
        while there:
            piece, there = await reading.ask(trajectories.rows, path, *span, there)
            yield piece

    return StreamingResponse(pieces(), media_type="text/csv", headers={"Content-Disposition": 'attachment; filename="span.csv"'})


def viewer(request: Request) -> Response:
    """rerun's viewer, as `lmeasure view --web` serves it; its page runs its own code and reads recordings of the project alone."""
    found = viewer_file(request.path_params["path"])
    if found is None:
        raise OutsideError("workbench.there_no_such_file")
    kind, content = found
    origin = f"{request.url.scheme}://{request.headers['host']}{request.scope['at']}"
    policy = web_policy(f"{origin}/raw/ {origin}/viewer/") + "; frame-ancestors 'self'"
    headers = {"Content-Security-Policy": policy, "Cache-Control": "no-store" if kind.startswith("text/html") else "private, max-age=86400"}
    return Response(content, media_type=kind, headers=headers)


NORMAL_95 = 1.959964
"""Half the width of the interval that holds 95 % of a normal value, in its standard deviations."""


class Value(NamedTuple):
    """A value before and now with its change and its U95, in the unit of its name."""

    name: str
    old: float
    new: float
    change: float
    u95: float

    @property
    def beyond(self) -> bool:
        """Return whether the change is more than U95."""
        return abs(self.change) > self.u95


def moved(request: Request) -> Response:
    """The page: two calibrations are chosen, ?old=...&new=..., the last two where none is."""
    bench = bench_of(request)
    records = sorted(bench.project.of("record"), key=lambda path: ((bench.folder / path).stat().st_mtime, path))
    old, new = (request.query_params.get(name, "") for name in ("old", "new"))
    if not old and not new and len(records) > 1:
        old, new = records[-2:]
    values: dict[str, Any] = {"records": records, "old": old, "new": new, "found": None, "error": "", "line": ""}
    if old and new:
        values |= {"line": shlex.join(["lmeasure", "compare", old, new]), "chance": chance}
        try:
            found = _compared(bench, old, new)
            values |= {"found": found, "values": shifts(found), "notes": [Say(language_of(request)).message(note) for note in found.notes]}
        except (LMeasureError, OSError) as error:
            values["error"] = within(bench.folder, error, language_of(request))
    return page(request, "moved.html", 422 if values["error"] else 200, **values)


def _compared(bench: Bench, old: str, new: str) -> Comparison:
    paths = [inside(bench.folder, text) for text in (old, new)]
    if any(path.is_file() and path.stat().st_size > LARGEST_JSON for path in paths):
        raise OutsideError(message("error.or_is_too_large", old=old, new=new))
    first, later = (read_earlier(path) for path in paths)
    return compare_records(replace(first, source=old), replace(later, source=new))


def shifts(found: Comparison) -> dict[str, list[Value]]:
    """The values of each point, those that have an uncertainty."""
    out: dict[str, list[Value]] = {}
    for v in found.values:
        if v.u > 0.0 and math.isfinite(v.u):
            owner, _, key = v.name.removeprefix("tool.").rpartition(".")
            out.setdefault(owner, []).append(Value(key, v.old, v.new, v.change, NORMAL_95 * v.u))
    return out


ROUTES = (
    Route("/trajectory/{path:path}", trajectory),
    Route("/along/{path:path}", along_json),
    Route("/export/{path:path}", export),
    Route("/viewer/{path:path}", viewer),
    Route("/calibrations", moved),
)
