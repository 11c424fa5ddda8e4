"""Pages of a project's objects: its files, a rig, a run's start, an uploaded certificate."""

import contextlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from lmeasure.acquisition import log_suffixes
from lmeasure.core import LMeasureError
from lmeasure.io import open_regular, read_toml, rewrite_toml
from lmeasure.kernels import compilation
from lmeasure.recording import read_run_head, start_from_text
from lmeasure.text import message
from lmeasure.workbench import guard, rig_form
from lmeasure.workbench.answers import HERE, Form, as_file, bench_of, file_of, language_of, page, posted, uploads_of, within
from lmeasure.workbench.cards import card
from lmeasure.workbench.project import OutsideError, inside
from lmeasure.workbench.text import said, why
from lmeasure.workbench.uploads import take_in

LARGEST_TEXT = 200_000
BELOW: tuple[tuple[str, str, Callable[[str], dict[str, str]]], ...] = (
    ("drum", "drum", lambda file: {"measurements": file}),
    ("placement", "place", lambda file: {"task": file}),
)
"""The command that takes a file of a kind, and how it is given of it."""


def raw(request: Request) -> Response:
    """A file of the project as it is."""
    return as_file(file_of(request))


def shown(request: Request) -> Response:
    """A file of the project in a frame of a page, at the address that the page was given for it, outside its session's path."""
    with contextlib.suppress(OutsideError):
        if not request.scope["at"]:
            return as_file(file_of(request), shown=True)
    return PlainTextResponse("lmeasure: there is no such file\n", 404)


def look(request: Request) -> Response:
    """A file, or folder, of the project in a page."""
    bench = bench_of(request)
    path = inside(bench.folder, request.path_params["path"])
    here = path.relative_to(bench.folder.resolve()).as_posix()
    if not path.exists():
        raise OutsideError("workbench.there_no_such_file")
    values: dict[str, Any] = {
        "path": here,
        "raw": path.is_file(),
        "frame": "",
        "text": "",
        "rows": [],
        "recording": path.suffix == ".rrd",
        "inside": [],
        "uses": _uses(here, path),
    }
    if path.is_dir():
        found = sorted(p for p in path.iterdir() if not p.name.startswith(".") and not p.is_symlink())
        values["inside"] = [p.relative_to(bench.folder.resolve()).as_posix() for p in found]
        pages = [p for p in found if p.suffix == ".html"]
        values["frame"] = pages[0].relative_to(bench.folder.resolve()).as_posix() if pages else ""
    elif path.suffix == ".html":
        values["frame"] = here
    elif path.suffix in (".toml", ".csv", ".json", ".log", ".txt", ".asc", ".trc", ".urdf", ".tum", ".md", ".pub", ".sha256"):
        with open_regular(path) as file:
            values["text"] = file.read(LARGEST_TEXT).decode("utf-8", "replace")
    return page(request, "look.html", **values)


def _uses(here: str, path: Path) -> list[tuple[str, str]]:
    """Return the possible uses of a file."""
    if (path / "run.toml").is_file():
        return [
            (f"/run/reconstruct?{urlencode({'run': here})}", "workbench.reconstruct_trajectory"),
            (f"/start/{here}", "workbench.start_pose"),
        ]
    if (path / "certificate.json").is_file():
        return [(f"/run/verify?{urlencode({'bundle': here})}", "workbench.verify_certificate")]
    if path.name == "rig.toml" or path.suffix == ".toml":
        return [(f"/rig?{urlencode({'file': here})}", "workbench.change_values")] if rig_form.kind_of(path) else []
    if path.suffix in (".parquet", ".tum", ".mcap") or (path.suffix == ".csv" and _head(path).startswith("time_s,x_mm")):
        return [(f"/trajectory/{here}", "workbench.look_over_time")]
    if path.suffix in log_suffixes():
        return [(f"/run/import?{urlencode({'logs': here})}", "workbench.import_logs")]
    return []


def _head(path: Path) -> str:
    with contextlib.suppress(LMeasureError, OSError), open_regular(path) as file:
        return file.readline(500).decode("utf-8", "replace")
    return ""


def everything(request: Request) -> Response:
    """All files of the project."""
    return _everything(request, "", "imported")


def _everything(request: Request, error: str, into: str) -> Response:
    return page(request, "files.html", 422 if error else 200, project=bench_of(request).project, error=error, into=into)


async def upload(request: Request) -> Response:
    """Files come in: all of them, or none."""
    bench = bench_of(request)
    async with uploads_of(request, most=200) as (form, uploads):
        into = form.get("folder", [""])[-1] or "."
        try:
            target = await run_in_threadpool(inside, bench.folder, into)
            taken = await run_in_threadpool(take_in, target, uploads)
        except (LMeasureError, OSError) as error:
            return await run_in_threadpool(_everything, request, within(bench.folder, error, language_of(request)), into)
    if form.get("then", [""])[-1] == "import":
        logs = [path.relative_to(bench.folder).as_posix() for path in taken]
        return RedirectResponse(f"/run/import?{urlencode({'logs': logs}, doseq=True)}", 303)
    return RedirectResponse("/files", 303)


def rig(request: Request, form: Form) -> Response:
    """Answer with the rig as a form; a posted one is saved, or all complaints are shown with the typed values."""
    bench = bench_of(request)
    project = bench.project
    complaints: list[str] = []
    typed: dict[str, str] = {}
    rigs = project.of("rig")
    others = (*project.of("drums"), *project.of("placement"))
    file = request.query_params.get("file", rigs[0] if rigs else "")
    if request.method == "POST":
        typed = {key: values[-1] for key, values in form.items()}
        file = typed.get("_file", "")
    begin = card("init", project, page="rig")
    values: dict[str, Any] = {
        "title": "workbench.rig",
        "lead": "workbench.every_dimension_instrument_plain",
        "rigs": (*rigs, *others),
        "file": "",
    }
    values |= {"cards": [begin], "made": [], "saved": request.query_params.get("saved") == "1", "complaints": complaints}
    if file:
        path = inside(bench.folder, file)
        kind = rig_form.kind_of(path)
        if not kind:
            raise OutsideError(message("error.is_no_rig_of", where=file))
        if request.method == "POST":
            complaints += rig_form.save(path, typed)
            if not complaints:
                return RedirectResponse(f"/rig?{urlencode({'file': file, 'saved': 1})}", 303)
        document, digest = rig_form.read(path)
        shown = [
            (name, [leaf._replace(value=typed.get(leaf.key, leaf.value)) for leaf in leaves]) for name, leaves in rig_form.parts(document)
        ]
        values["faults"] = [] if request.method == "POST" else rig_form.faults(path, document)
        values |= {"file": file, "parts": shown, "digest": digest, "links": "calibration" in document}
        values["beside"] = rig_form.beside(document, complaints)
        below = [card(command, project, page="rig", reported=reported(file)) for of, command, reported in BELOW if of == kind]
        values |= {"drawing": _drawing(language_of(request)), "kind": kind, "cards": below}
    return page(request, "rig.html", 422 if complaints else 200, **values)


def _drawing(language: str) -> str:
    """The picture of one cable in a language; its style is in the page's own, which alone may set one."""
    picture = re.sub(r"<style>.*?</style>", "", (HERE / "static" / "cable.svg").read_text(encoding="utf-8"), flags=re.DOTALL)
    return re.sub(r">([^<>]+)</text>", lambda found: f">{said(language, found[1])}</text>", picture)


def rig_scene(request: Request) -> Response:
    """Points and cables of a rig, for the picture in space; that its file is no whole rig is an answer too: {error}."""
    try:
        path = inside(bench_of(request).folder, request.query_params.get("file", ""))
    except (LMeasureError, OSError) as error:
        return JSONResponse({"error": why(language_of(request), error)}, 422)
    try:
        return JSONResponse(rig_form.scene(path))
    except (LMeasureError, OSError, RecursionError) as error:
        return JSONResponse({"error": why(language_of(request), error)})


async def coarse(request: Request) -> Response:
    """Answer with the quality of a rig whose points are dragged: posted {file, points: {name: [x, y, z]}, limit_deg}. A rig without a zone,
    such as two cables, has an answer too: {error}."""
    bench = bench_of(request)
    try:
        content = await request.json()
        path = inside(bench.folder, str(content["file"]))
        points = {str(name): tuple(float(v) for v in at) for name, at in content["points"].items()}
        limit = float(content.get("limit_deg", 60.0))
    except (LMeasureError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        return JSONResponse(
            {"error": why(language_of(request), error) if isinstance(error, LMeasureError) else "wanted: {file, points, limit_deg}"}, 422
        )
    try:
        return JSONResponse(await run_in_threadpool(rig_form.coarse, path, points, limit))
    except (LMeasureError, OSError) as error:
        return JSONResponse({"error": why(language_of(request), error)})
    except (ValueError, TypeError, RecursionError):
        return JSONResponse({"error": "wanted: {file, points, limit_deg}"}, 422)


async def compiled(request: Request) -> Response:
    """Answer with the kernel that this server compiles just now, and its time [s]: the reason for a slow first coarse zone."""
    now = compilation.now()
    return JSONResponse({} if now is None else {"name": now[0], "seconds": now[1]})


def start(request: Request, form: Form) -> Response:
    """Show or state the pose of a run's zeroing."""
    bench, error = bench_of(request), ""
    folder = inside(bench.folder, request.path_params["path"])
    table = folder / "run.toml"
    if not table.is_file():
        raise OutsideError(message("error.is_no_run_folder", where=request.path_params["path"]))
    head = read_run_head(folder)
    here = folder.relative_to(bench.folder.resolve()).as_posix()
    if request.method == "POST":
        text = form.get("start", [""])[-1]
        try:
            if not re.fullmatch(r"[\s\d.,;eE+\-]+", text):
                raise OutsideError(message("error.wanted_six_or_seven"))
            stated = start_from_text(text.replace(";", ","), head.rig)
            document = read_toml(table)
            pose = {"position_mm": stated[:3].tolist(), "quaternion_xyzw": stated[3:].tolist()}
            rewrite_toml(table, document.holding({**document, "start": {**document.get("start", {}), **pose}}))
            return RedirectResponse(f"/look/{here}", 303)
        except (LMeasureError, OSError) as failed:
            error = str(failed)
    return page(request, "start.html", 422 if error else 200, run=here, head=head, error=error)


ROUTES = (
    Route("/rig", posted(rig), methods=["GET", "POST"]),
    Route("/scene", rig_scene),
    Route("/coarse", coarse, methods=["POST"]),
    Route("/compiling", compiled),
    Route("/start/{path:path}", posted(start), methods=["GET", "POST"]),
    Route("/files", everything),
    Route("/upload", upload, methods=["POST"]),
    Route("/raw/{path:path}", raw),
    Route(guard.SHOWN + "{key}/{path:path}", shown),
    Route("/look/{path:path}", look),
)
