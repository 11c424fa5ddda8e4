"""Runs, and what was made of them: which still lack their start, a trajectory over time, rerun's viewer for a recording."""

import io
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

# at the start, in one thread: what two requests begin to load at once is seen in halves
from lmeasure.accuracy.along import AXIS_95, Along, along, kept_rows, merged
from lmeasure.errors import LMeasureError
from lmeasure.run import read_run_head
from lmeasure.trajectory import read_trajectory
from lmeasure.workbench.answers import bench_of, file_of, language_of, lost, page, unread, within
from lmeasure.workbench.project import Project

SHOWN = 1500
"""Samples of a series that a picture gets, the extremes among them."""
LISTED = 500


class RunAt(NamedTuple):
    """A run of the project: its path; what its start is: stated, told (absolute encoders tell it), missing, or unread; what is wrong with
    its files; what its recording says."""

    path: str
    start: str
    error: str
    told: tuple[str, ...]


def runs(project: Project, language: str) -> list[RunAt]:
    """All runs of a project as they stand."""
    return [_run(project.folder, path, language) for path in project.of("run")]


def _run(folder: Path, path: str, language: str) -> RunAt:
    try:
        head = read_run_head(folder / path)
    except (LMeasureError, OSError) as error:
        return RunAt(path, "unread", within(folder, error), ())
    start = "stated" if head.start is not None else "told" if head.rig.swivel else "missing"
    return RunAt(path, start, "", tuple(note.text(language) for one in head.recorded for note in one.notes()))


@lru_cache(maxsize=2)
def _read(path: Path, changed_ns: int) -> Along:
    return along(read_trajectory(path))


def _along(path: Path) -> Along:
    return _read(path, path.stat().st_mtime_ns)


async def trajectory(request: Request) -> Response:
    """A trajectory over time: plots under one cursor, what is left out, and ways to take it elsewhere."""
    path = file_of(request)
    if path is None:
        return lost(request, "There is no such file in the project.")
    here = path.relative_to(bench_of(request).folder.resolve()).as_posix()
    try:
        found = await run_in_threadpool(_along, path)
    except (LMeasureError, OSError) as error:
        return unread(request, error)
    language, project = language_of(request), bench_of(request).project
    recordings = [one for one in project.of("recording") if Path(one).parent == Path(here).parent] or list(project.of("recording"))
    from lmeasure.report.trajectory import summary

    values: dict[str, Any] = {
        "path": here,
        "summary": summary(found, language),
        "left_out": left_out(found, language),
        "recordings": recordings[:1],
    }
    return page(request, "trajectory.html", **values, begin=float(found.trajectory.time_s[0]), end=float(found.trajectory.time_s[-1]))


def left_out(found: Along, language: str) -> list[dict[str, Any]]:
    """Stretches without a pose, or without a cable, in words, in the order of time; those that lie close together are one."""
    from lmeasure.report.trajectory import about_stretch

    time_s = found.trajectory.time_s
    kept = merged(found.stretches, float(time_s[-1] - time_s[0]) / LISTED)
    return [{"begin": s.begin_s, "end": s.end_s, "ok": s.ok, "text": about_stretch(s, language)} for s in kept[:LISTED]]


async def along_json(request: Request) -> Response:
    """Series of a span of time, ?begin=...&end=... in s: some SHOWN samples, the extremes among them; null where nothing is known."""
    path = file_of(request)
    if path is None:
        return JSONResponse({"error": "no such file in the project"}, 404)
    try:
        span = float(request.query_params.get("begin", "-inf")), float(request.query_params.get("end", "inf"))
        found = await run_in_threadpool(_along, path)
        return JSONResponse(await run_in_threadpool(series, found, *span))
    except (LMeasureError, OSError, ValueError) as error:
        return JSONResponse({"error": str(error)}, 422)


def series(found: Along, begin_s: float, end_s: float) -> dict[str, list[float | None]]:
    """time_s; x, y, z [mm] with the half widths of what holds 95 % of each, u_x, u_y, u_z [mm]; u95 [mm], the radius; angle, the worst
    pressure angle [deg]: of the samples of a span."""
    moved = found.trajectory
    own = np.flatnonzero((moved.time_s >= begin_s) & (moved.time_s <= end_s))
    if not len(own):
        return {}
    u = AXIS_95 * moved.u[own, :3]
    columns = dict(zip(("x", "y", "z", "u_x", "u_y", "u_z"), (*moved.poses[own, :3].T, *u.T), strict=True))
    columns |= {"u95": found.u95_mm[own], "angle": moved.worst_pressure_angle_deg[own]}
    rows = kept_rows(list(columns.values()), np.zeros(0, np.int64), SHOWN)
    columns["time_s"] = moved.time_s[own]
    return {name: [None if value != value else value for value in values[rows].tolist()] for name, values in columns.items()}


async def export(request: Request) -> Response:
    """The samples of a span as .csv, all columns of a trajectory file."""
    path = file_of(request)
    if path is None:
        return lost(request, "There is no such file in the project.")

    def cut(begin_s: float, end_s: float) -> str:
        table = _along(path).trajectory.to_frame()
        text = io.StringIO()
        table[(table["time_s"] >= begin_s) & (table["time_s"] <= end_s)].to_csv(text, index=False)
        return text.getvalue()

    try:
        span = float(request.query_params.get("begin", "-inf")), float(request.query_params.get("end", "inf"))
        content = await run_in_threadpool(cut, *span)
    except (LMeasureError, OSError, ValueError) as error:
        return unread(request, error)
    return Response(content, media_type="text/csv", headers={"Content-Disposition": 'attachment; filename="span.csv"'})


async def viewer(request: Request) -> Response:
    """rerun's viewer, as `lmeasure view --web` serves it; its page runs its own code and reads recordings of the project alone."""
    from lmeasure.view import web

    name = request.path_params["path"]
    try:
        found = await run_in_threadpool(web.viewer_file, name)
    except (LMeasureError, OSError) as error:
        return unread(request, error)
    if found is None:
        return lost(request, "There is no such file in the project.")
    kind, content = found
    origin = f"{request.url.scheme}://{request.headers['host']}"
    policy = web.policy(f"{origin}/raw/ {origin}/viewer/") + "; frame-ancestors 'self'"
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
