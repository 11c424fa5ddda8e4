"""Pages of the workbench: each answers with a template; jobs do the work."""

import contextlib
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

from lmeasure.core import LMeasureError, SettingsError
from lmeasure.io import not_written
from lmeasure.text import message
from lmeasure.workbench import forms, runs
from lmeasure.workbench.answers import COOKIE, Form, bench_of, files_of, form_of, job_of, language_of, lost, page, posted
from lmeasure.workbench.cards import ONWARD, PAGES, TITLES, card, hindered, lacking, primary
from lmeasure.workbench.cell_state import CellState, cell_state
from lmeasure.workbench.jobs import DONE, FAILED, RUNNING, Job
from lmeasure.workbench.project import OutsideError, Project, following, steps
from lmeasure.workbench.project_list import Shelf
from lmeasure.workbench.text import said, why
from lmeasure.workflows import COMMANDS, JOBS, command_help, job_name

STEP_NAMES = {
    "rig": "workbench.rig",
    "check": "workbench.connect_check",
    "plan": "workbench.plan_poses",
    "calibrate": "workbench.calibrate",
    "zone": "workbench.zone_place",
    "measure": "workbench.measure",
    "certify": "workbench.certify",
    "verify": "workbench.verify",
}


LEADS = {f"/{name}": one.lead for name, one in PAGES.items()} | {"/rig": "workbench.every_dimension_instrument_plain"}
LASTING = ("record", "watch", "capture", "play")
"""Commands that the user ends: their output until then is kept."""
SHOWN = {"calibrate": "calibration", "zone": "zone", "runs": "run", "robot": "certificate", "check": "check"}
"""Pages of commands whose last result is above them: the tile of the cell's state."""
OWN = ("runs", "robot", "zone", "check", "calibrate")
"""Pages of commands that have something of their own above them."""


async def home(request: Request, wrong: str = "", typed: str = "") -> Response:
    """Answer with the state of the cell, its next step, and the projects beside it; wrong is the fault of a name typed for one."""
    project = await run_in_threadpool(lambda: bench_of(request).project)
    return await run_in_threadpool(_home, request, project, await _state(request, project), wrong, typed)


async def _state(request: Request, project: Project) -> CellState:
    """Return the state of the cell; of a project with nothing, or with files that cannot be read in time, a verdict alone."""
    language = language_of(request)
    if project.found:
        with contextlib.suppress(LMeasureError):
            state: CellState = await bench_of(request).reading.ask(cell_state, project.folder, language)
            return state
        return CellState(said(language, "workbench.cannot_read"), "warn")
    return CellState(said(language, "cell.empty"), "warn")


def _home(request: Request, project: Project, state: CellState, wrong: str, typed: str) -> Response:
    bench = bench_of(request)
    jobs = bench.jobs.all()
    checked, verified = (any(job.command == name and job.state == "done" for job in jobs) for name in ("check", "verify"))
    way = [step if step.name != "verify" else step._replace(done=verified) for step in steps(project, checked)]
    values = {"project": project, "steps": way, "step_names": STEP_NAMES, "following": following(way), "jobs": jobs, "leads": LEADS}
    beside = None if bench.shelf is None else bench.shelf.projects()
    return page(request, "home.html", 422 if wrong else 200, **values, state=state, beside=beside, wrong=wrong, typed=typed)


async def cards(request: Request) -> Response:
    """A page of commands."""
    project = await run_in_threadpool(lambda: bench_of(request).project)
    state = await _state(request, project) if request.scope["path"].strip("/") in SHOWN else None
    return await run_in_threadpool(_cards, request, project, state)


def _cards(request: Request, project: Project, state: CellState | None) -> Response:
    bench = bench_of(request)
    name = request.scope["path"].strip("/")
    here = PAGES[name]
    made = [one for one in project.found if one.kind in here.kinds]
    if name == "live" and (seen := next((job for job in bench.jobs.running() if job.command in ("record", "watch")), None)) is not None:
        return RedirectResponse(f"/jobs/{seen.number}", 303)
    shown = [card(command, project, page=name) for command in here.commands]
    values: dict[str, Any] = {"title": here.title, "lead": here.lead, "cards": shown, "made": made, "primary": primary(here, project)}
    if state is not None:
        values |= {"tiles": [tile for tile in state.tiles if tile.name == SHOWN[name]], "plan": state.plan}
    if name == "runs":
        values |= {"made": [], "runs": runs.runs(project, language_of(request)), "trajectories": project.of("trajectory")}
    if name == "calibrate":
        values["records"] = project.of("record")
    if name == "zone":
        pages = [path for path in project.of("page") if Path(path).name == "zone.html"]
        newest = max(pages, key=lambda path: (bench.folder / path).stat().st_mtime, default="")
        values |= {"made": [], "zones": project.of("zone"), "drawn": newest}
    return page(request, f"{name}.html" if name in OWN else "cards.html", **values)


def _made(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LMeasureError(not_written(folder, error)) from error


async def one_command(request: Request) -> Response:
    """Answer with the form of any command, filled from the address; posted, it begins a job."""
    form = await form_of(request) if request.method == "POST" else None
    requested = await run_in_threadpool(_asked, request, form)
    if isinstance(requested, Response):
        return requested
    try:
        job = await bench_of(request).jobs.begin(requested)
    except LMeasureError as error:
        return await run_in_threadpool(_wrong, request, form or {}, error)
    return RedirectResponse(f"/jobs/{job.number}", 303)


def _asked(request: Request, form: Form | None) -> Response | list[str]:
    """Return the words of a form's job, or the page of the form."""
    name, bench = request.path_params["command"], bench_of(request)
    if name not in COMMANDS or name in forms.NOT_HERE:
        return lost(request, said(language_of(request), "workbench.no_command_runs_from", name=name))
    if form is None:
        query = {key: request.query_params.getlist(key) for key in request.query_params}
        given = forms.filled_in(name, query)
        # a link names a field or two; a job that is done again names all that were not left as they are by default
        return _form(request, name, given=forms.defaults(name) | given) if "_form" in query else _form(request, name, reported=given)
    given = forms.filled_in(name, form)
    try:
        words = forms.command_words(name, given, bench.folder)
        option, text = lacking(name, given)
        if option:
            raise SettingsError(option, said(language_of(request), text))
        if hindrance := hindered(name, given, bench.folder):
            raise SettingsError("run", said(language_of(request), hindrance))
        if there := forms.existing(name, given, bench.folder):
            text = "workbench.exists_tick_this_replace"
            raise SettingsError("force", said(language_of(request), text, file=there))
        for folder in (Path(words_out).parent for words_out in _outputs(name, given)):
            _made(bench.folder / folder)
    except LMeasureError as error:
        return _wrong(request, form, error)
    return words


def _wrong(request: Request, form: Form, error: LMeasureError) -> Response:
    """Answer with the form of a command and its fault."""
    name = request.path_params["command"]
    reported = error if isinstance(error, SettingsError) else why(language_of(request), error)
    return _form(request, name, given=forms.filled_in(name, form), error=reported, status=422)


def line(request: Request, form: Form) -> Response:
    """Answer with the command line of an unfinished form, and its fault."""
    name, bench = request.path_params["command"], bench_of(request)
    if name not in COMMANDS or name in forms.NOT_HERE:
        return JSONResponse({"error": "no such command"}, 404)
    given = forms.filled_in(name, form)
    words = forms.written_down(name, given)
    try:
        forms.command_words(name, given, bench.folder)
    except LMeasureError as error:
        language = language_of(request)
        text = said(language, error.text) if isinstance(error, SettingsError) else why(language, error)
        return JSONResponse({"line": words, "option": getattr(error, "option", ""), "error": text})
    option, text = lacking(name, given)
    if option:
        return JSONResponse({"line": words, "option": option, "error": said(language_of(request), text)})
    hindrance = hindered(name, given, bench.folder)
    start = f"/start/{quote(str(given.get('run') or given.get('measured')))}"
    return JSONResponse(
        {"line": words, "error": None} | ({"hindered": said(language_of(request), hindrance), "mend": start} if hindrance else {})
    )


def _outputs(command: str, given: Mapping[str, Any]) -> list[str]:
    """Files and folders that a form names for writing: the folders around them are made, as a person would."""
    return [str(given[key]) for key in ("out", "report", "rerun", "write", "checkpoint") if isinstance(given.get(key), str)]


def _form(
    request: Request, name: str, *, given: Any = None, reported: Any = None, error: SettingsError | str | None = None, status: int = 200
) -> Response:
    shown = card(name, bench_of(request).project, page=f"run/{name}", given=given, reported=reported, error=error)
    return page(request, "cards.html", status, title=TITLES.get(name, name), lead="", cards=[shown], made=[])


def job(request: Request) -> Response:
    """Answer with a job: its output and its files."""
    found, bench = job_of(request), bench_of(request)
    files = files_of(found, bench.folder)
    shown = [path for path in files if path.endswith(".html")][:2]
    again = f"/run/{found.command}?{urlencode(_query(found), doseq=True)}"
    return page(request, "job.html", job=found, files=files, shown=shown, again=again, onward=_onward(found))


def _onward(job: Job) -> tuple[tuple[str, str], ...]:
    """Return the next steps after a job, none if it failed, or was ended before it had written anything. A self-test that found faults is
    repeated with the corrected rig."""
    requested = _query(job)
    if job.command == "check" and job.state == FAILED and requested.get("write"):
        corrected = requested | {"rig": requested["write"], "write": ""}
        return ((f"/run/check?{urlencode(corrected, doseq=True)}", "workbench.take_corrected_rig_check"),)
    if job.state == FAILED or (job.state != DONE and job.command not in LASTING):
        return ()
    given = defaultdict(str, {key: quote(value) for key, value in requested.items() if isinstance(value, str)})
    return tuple((address.format_map(given), text) for address, text in ONWARD.get(job.command, ()))


def _query(job: Job) -> dict[str, Any]:
    """Return the settings of a job, as the fields of its form."""
    return {**forms.of_words(job.command, job.words), "_form": "1"}


async def events(request: Request) -> Response:
    """Return the events of a job, as server-sent events."""
    found, bench = job_of(request), bench_of(request)

    async def stream() -> Any:
        async for event in bench.jobs.watch(found):
            yield forms.as_event(event)

    return StreamingResponse(stream(), media_type="text/event-stream")


async def last(request: Request) -> Response:
    """Return the state of a job, and the last of each passing event."""
    found = job_of(request)
    return JSONResponse({"state": found.state, "result": found.result, "last": found.last})


async def answer(request: Request) -> Response:
    """Send a line to a job that reads answers, or end it."""
    found, bench = job_of(request), bench_of(request)
    if request.scope["path"].endswith("/cancel"):
        await bench.jobs.cancel(found)
        return RedirectResponse(f"/jobs/{found.number}", 303)
    form = await form_of(request)
    taken = found.state == RUNNING and await bench.jobs.type(found, form.get("line", [""])[-1][:500])
    return JSONResponse({"taken": taken}, 200 if taken else 409)


def all_commands(request: Request) -> Response:
    """Every command, by job."""
    groups = {job_name(job): {n: command_help(n) for n in names if n not in forms.NOT_HERE} for job, names in JOBS.items()}
    return page(request, "commands.html", groups=groups)


async def language(request: Request) -> Response:
    """Choose the language of the pages."""
    form = await form_of(request)
    chosen, back = form.get("language", ["en"])[-1], form.get("back", ["/"])[-1]
    there = back if re.fullmatch(r"/[\w/.\-]*", back) and not back.startswith("//") else "/"
    response = RedirectResponse(there, 303)
    if chosen in ("en", "ru"):
        response.set_cookie(COOKIE, chosen, samesite="strict", httponly=True, path="/")
        bench_of(request).jobs.language = chosen
    return response


def _shelf(request: Request) -> Shelf:
    shelf = bench_of(request).shelf
    if shelf is None:
        raise OutsideError("workbench.this_workbench_was_begun")
    return shelf


async def begin(request: Request) -> Response:
    """Begin a project and show it among the others, with the fault of its name."""
    shelf, name = _shelf(request), (await form_of(request)).get("name", [""])[-1].strip()
    try:
        await run_in_threadpool(shelf.begin, name)
    except OutsideError as error:
        return await home(request, wrong=why(language_of(request), error), typed=name)
    return RedirectResponse("/#projects", 303)


def go(request: Request) -> Response:
    """Open a project, if it is not open yet, and go there. Repeated requests are harmless."""
    shelf = _shelf(request)
    try:
        path = shelf.path(request.path_params["name"])
        if not path.is_dir():
            raise OutsideError(message("error.there_is_no_such_project", where=path.name))
        return RedirectResponse(shelf.desk.address(path, shelf), 303)
    except LMeasureError as error:
        return lost(request, why(language_of(request), error))


ROUTES = (
    *(Route(f"/{name}", cards) for name in PAGES),
    Route("/", home),
    Route("/run/{command}", one_command, methods=["GET", "POST"]),
    Route("/line/{command}", posted(line), methods=["POST"]),
    Route("/jobs/{number:int}", job),
    Route("/jobs/{number:int}/events", events),
    Route("/jobs/{number:int}/last", last),
    Route("/jobs/{number:int}/type", answer, methods=["POST"]),
    Route("/jobs/{number:int}/cancel", answer, methods=["POST"]),
    Route("/commands", all_commands),
    Route("/language", language, methods=["POST"]),
    Route("/projects", begin, methods=["POST"]),
    Route("/projects/{name}", go),
)
