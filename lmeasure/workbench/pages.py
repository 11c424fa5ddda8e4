"""The pages: each answers with a template; what is done is done by a job."""

import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

from lmeasure import workflows
from lmeasure.errors import LMeasureError, SettingsError
from lmeasure.files import whole
from lmeasure.workbench import forms, rig_form
from lmeasure.workbench.answers import COOKIE, HERE, as_file, bench_of, file_of, job_of, language_of, page
from lmeasure.workbench.cards import ONWARD, PAGES, TITLES, card
from lmeasure.workbench.jobs import RUNNING, Job
from lmeasure.workbench.project import OutsideError, inside, steps

STEP_NAMES = {
    "rig": "Rig",
    "check": "Connect and check",
    "plan": "Plan poses",
    "calibrate": "Calibrate",
    "zone": "Zone and place",
    "measure": "Measure",
    "certify": "Certify",
    "verify": "Verify",
}
LARGEST_UPLOAD, LARGEST_TEXT = 2**31, 200_000
MOST_UNPACKED = 2**31
_NAME = re.compile(r"[^\W.][\w .+()\-]{0,120}", re.UNICODE)
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


async def home(request: Request) -> Response:
    """What the project has and what comes next."""
    bench = bench_of(request)
    project, jobs = bench.project, bench.jobs.all()
    checked = any(job.command == "check" and job.state == "done" for job in jobs)
    verified = any(job.command == "verify" and job.state == "done" for job in jobs)
    way = [step._asdict() if step.name != "verify" else step._asdict() | {"done": verified} for step in steps(project, checked)]
    following = next((step["name"] for step in way if not step["done"]), "")
    return page(request, "home.html", project=project, steps=way, step_names=STEP_NAMES, following=following, jobs=jobs)


async def cards(request: Request) -> Response:
    """A page of commands."""
    bench = bench_of(request)
    name = request.url.path.strip("/")
    here, project = PAGES[name], bench.project
    made = [one for one in project.found if one.kind in here.kinds]
    shown = [card(command, project, page=name) for command in here.commands]
    return page(request, "cards.html", title=here.title, lead=here.lead, cards=shown, made=made)


async def one_command(request: Request) -> Response:
    """The form of any command, filled with what the address says; posted, it begins a job."""
    name, bench = request.path_params["command"], bench_of(request)
    if name not in workflows.COMMANDS or name in forms.NOT_HERE:
        return lost(request, f"{name}: no command that runs from a page")
    if request.method != "POST":
        query = {key: request.query_params.getlist(key) for key in request.query_params}
        given = forms.filled_in(name, query) if query else None
        return _form(request, name, given=given)
    given = forms.filled_in(name, await _form_of(request))
    try:
        words = forms.asked(name, given, bench.folder)
    except LMeasureError as error:
        told = error if isinstance(error, SettingsError) else str(error)
        return _form(request, name, given=given, error=told, status=422)
    for folder in (Path(words_out).parent for words_out in _outputs(name, given)):
        (bench.folder / folder).mkdir(parents=True, exist_ok=True)
    job = await bench.jobs.begin(words)
    return RedirectResponse(f"/jobs/{job.number}", 303)


async def line(request: Request) -> Response:
    """The command line of a form as it stands, and what is wrong with it."""
    name, bench = request.path_params["command"], bench_of(request)
    if name not in workflows.COMMANDS or name in forms.NOT_HERE:
        return JSONResponse({"error": "no such command"}, 404)
    given = forms.filled_in(name, await _form_of(request))
    words = forms.written_down(name, given)
    try:
        forms.asked(name, given, bench.folder)
    except LMeasureError as error:
        return JSONResponse({"line": words, "option": getattr(error, "option", ""), "error": getattr(error, "text", str(error))})
    return JSONResponse({"line": words, "error": None})


def _outputs(command: str, given: Mapping[str, Any]) -> list[str]:
    """Files and folders that a form names for writing: the folders around them are made, as a person would."""
    return [str(given[key]) for key in ("out", "report", "rerun", "write", "checkpoint") if isinstance(given.get(key), str)]


def _form(request: Request, name: str, *, given: Any = None, error: SettingsError | str | None = None, status: int = 200) -> Response:
    shown = card(name, bench_of(request).project, page=f"run/{name}", given=given, error=error)
    return page(request, "cards.html", status, title=TITLES.get(name, name), lead="", cards=[shown], made=[])


async def _form_of(request: Request) -> dict[str, list[str]]:
    form = await request.form(max_files=0, max_fields=1000)
    return {key: [str(value) for value in form.getlist(key)] for key in form}


async def job(request: Request) -> Response:
    """A job: what it says, and what it made."""
    found, bench = job_of(request), bench_of(request)
    if found is None:
        return lost(request, "There is no such job.")
    files = _files(found, bench.folder)
    shown = [path for path in files if path.endswith(".html")][:2]
    again = f"/run/{found.command}?{urlencode(_query(found), doseq=True)}"
    return page(request, "job.html", job=found, files=files, shown=shown, again=again, titles=TITLES, onward=ONWARD.get(found.command, ()))


def _files(job: Job, folder: Path) -> list[str]:
    """Files of the project that a job wrote, pages first."""
    out = []
    for text in (job.result or {}).get("files", ()):
        try:
            path = inside(folder, str(text))
        except OutsideError:
            continue
        if path.is_file() and not path.name.startswith("."):
            out.append(path.relative_to(folder.resolve()).as_posix())
    return sorted(dict.fromkeys(out), key=lambda path: (not path.endswith(".html"), not path.endswith(".pdf"), path))


def _query(job: Job) -> dict[str, Any]:
    """What a job was asked, as the fields of its form."""
    return {**forms.of_words(job.command, job.words), "_form": "1"}


async def events(request: Request) -> Response:
    """What a job says, as server-sent events."""
    found, bench = job_of(request), bench_of(request)
    if found is None:
        return lost(request, "There is no such job.")

    async def stream() -> Any:
        async for event in bench.jobs.watch(found):
            yield forms.as_event(event)

    return StreamingResponse(stream(), media_type="text/event-stream")


async def answer(request: Request) -> Response:
    """A line for a job that asks, or its end."""
    found, bench = job_of(request), bench_of(request)
    if found is None:
        return lost(request, "There is no such job.")
    if request.url.path.endswith("/cancel"):
        await bench.jobs.cancel(found)
        return RedirectResponse(f"/jobs/{found.number}", 303)
    form = await _form_of(request)
    taken = found.state == RUNNING and await bench.jobs.type(found, form.get("line", [""])[-1][:500])
    return JSONResponse({"taken": taken}, 200 if taken else 409)


async def raw(request: Request) -> Response:
    """A file of the project as it is."""
    path = file_of(request)
    return lost(request, "There is no such file in the project.") if path is None else as_file(path)


async def look(request: Request) -> Response:
    """A file, or folder, of the project in a page."""
    bench = bench_of(request)
    try:
        path = inside(bench.folder, request.path_params["path"])
    except OutsideError as error:
        return lost(request, str(error))
    here = path.relative_to(bench.folder.resolve()).as_posix()
    if any(part.startswith(".") for part in Path(here).parts) or not path.exists():
        return lost(request, "There is no such file in the project.")
    values: dict[str, Any] = {
        "path": here,
        "raw": path.is_file(),
        "frame": "",
        "text": "",
        "rows": [],
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
        with path.open("rb") as file:
            values["text"] = file.read(LARGEST_TEXT).decode("utf-8", "replace")
    return page(request, "look.html", **values)


def _uses(here: str, path: Path) -> list[tuple[str, str]]:
    """What may be done with a file."""
    if (path / "run.toml").is_file():
        return [(f"/run/reconstruct?{urlencode({'run': here})}", "Reconstruct the trajectory"), (f"/start/{here}", "Start pose")]
    if (path / "certificate.json").is_file():
        return [(f"/run/verify?{urlencode({'folder': here})}", "Verify a certificate")]
    if path.name == "rig.toml" or path.suffix == ".toml":
        return [(f"/rig?{urlencode({'file': here})}", "Rig")] if rig_form.is_rig(path) else []
    if path.suffix in (".blf", ".asc", ".mf4", ".trc", ".log"):
        return [(f"/run/import?{urlencode({'logs': here})}", "Import logs")]
    return []


async def everything(request: Request) -> Response:
    """All files of the project; posted, files come in."""
    bench, error, into = bench_of(request), "", "imported"
    if request.method == "POST":
        form = await request.form(max_files=200, max_fields=20)
        into = str(form.get("folder", "")) or "."
        try:
            target = inside(bench.folder, into)
            target.mkdir(parents=True, exist_ok=True)
            for upload in form.getlist("files"):
                if not isinstance(upload, str):
                    _take_in(target, upload.filename or "", upload.file)
            return RedirectResponse("/files", 303)
        except (LMeasureError, OSError, zipfile.BadZipFile) as failed:
            error = str(failed)
    return page(request, "files.html", 422 if error else 200, project=bench.project, error=error, into=into)


def _take_in(folder: Path, name: str, file: Any) -> None:
    """Copy an uploaded file into the folder under its own name; a zip is unpacked beside it, into a folder of its name. What is there stays."""
    plain = Path(name.replace("\\", "/")).name
    if not _NAME.fullmatch(plain) or _DEVICES.fullmatch(plain):
        raise OutsideError(f"{plain!r}: a file of that name is not taken in")
    target = folder / plain
    if target.exists() or target.is_symlink():
        raise OutsideError(f"{plain}: is there already, and stays")
    with whole(target) as part, part.open("wb") as sink:
        taken = 0
        while block := file.read(2**20):
            taken += len(block)
            if taken > LARGEST_UPLOAD:
                raise OutsideError(f"{plain}: is larger than {LARGEST_UPLOAD / 2**30:g} GiB")
            sink.write(block)
    if plain.lower().endswith(".zip"):
        try:
            _unpack(target, folder / Path(plain).stem)
        except (OutsideError, zipfile.BadZipFile):
            target.unlink()
            raise


def _unpack(packed: Path, folder: Path) -> None:
    if folder.exists():
        raise OutsideError(f"{folder.name}: is there already, and stays")
    with zipfile.ZipFile(packed) as held:
        entries = [entry for entry in held.infolist() if not entry.is_dir()]
        if sum(entry.file_size for entry in entries) > MOST_UNPACKED or len(entries) > 5000:
            raise OutsideError(f"{packed.name}: holds too much")
        names = [entry.filename for entry in entries]
        # a zip of a folder holds that folder
        top = names[0].split("/")[0] + "/" if names and all("/" in n and n.split("/")[0] == names[0].split("/")[0] for n in names) else ""
        for name in names:
            parts = name.split("/")
            if "\\" in name or name.startswith("/") or any(not _inner(part) for part in parts):
                raise OutsideError(f"{packed.name}: {name!r}: a file of that name is not unpacked")
        for entry in entries:
            target = folder / entry.filename.removeprefix(top)
            target.parent.mkdir(parents=True, exist_ok=True)
            with held.open(entry) as source, target.open("xb") as sink:
                while block := source.read(2**20):
                    sink.write(block)


def _inner(part: str) -> bool:
    # certificates keep which command wrote what in a file with a dot before its name
    return bool(_NAME.fullmatch(part.lstrip(".") or "?")) and part not in (".", "..") and not _DEVICES.fullmatch(part)


async def rig(request: Request) -> Response:
    """The rig as a form; posted, it is saved, or all complaints are shown with what was typed."""
    bench = bench_of(request)
    project, complaints, typed = bench.project, [], {}
    rigs = project.of("rig")
    file = request.query_params.get("file", rigs[0] if rigs else "")
    if request.method == "POST":
        typed = {key: values[-1] for key, values in (await _form_of(request)).items()}
        file = typed.get("_file", "")
    begin = card("init", project, page="rig")
    values: dict[str, Any] = {"title": "Rig", "lead": "Every dimension of the instrument, in plain files.", "rigs": rigs, "file": ""}
    values |= {"cards": [begin], "made": [], "saved": request.query_params.get("saved") == "1", "complaints": complaints}
    if file:
        try:
            path = inside(bench.folder, file)
            if not path.is_file() or path.suffix != ".toml":
                raise OutsideError(f"{file}: is no rig of the project")
            if request.method == "POST":
                complaints += rig_form.save(path, typed)
                if not complaints:
                    return RedirectResponse(f"/rig?{urlencode({'file': file, 'saved': 1})}", 303)
            document, digest = rig_form.read(path)
        except (LMeasureError, OSError) as error:
            return lost(request, str(error))
        shown = [
            (name, [leaf._replace(value=typed.get(leaf.key, leaf.value)) for leaf in leaves]) for name, leaves in rig_form.parts(document)
        ]
        values |= {"file": file, "parts": shown, "digest": digest, "links": "calibration" in document}
        values |= {"drawing": (HERE / "static" / "cable.svg").read_text(encoding="utf-8"), "cards": []}
    return page(request, "rig.html", 422 if complaints else 200, **values)


async def rig_scene(request: Request) -> Response:
    """Points and cables of a rig, for the picture in space."""
    try:
        path = inside(bench_of(request).folder, request.query_params.get("file", ""))
        return JSONResponse(rig_form.scene(path))
    except (LMeasureError, OSError) as error:
        return JSONResponse({"error": str(error)}, 422)


async def all_commands(request: Request) -> Response:
    """Every command, by job."""
    groups = {job: {n: t for n, t in names.items() if n not in forms.NOT_HERE} for job, names in workflows.JOBS.items()}
    return page(request, "commands.html", groups=groups)


async def language(request: Request) -> Response:
    """Choose the language of the pages."""
    form = await _form_of(request)
    chosen, back = form.get("language", ["en"])[-1], form.get("back", ["/"])[-1]
    there = back if re.fullmatch(r"/[\w/.\-]*", back) and not back.startswith("//") else "/"
    response = RedirectResponse(there, 303)
    if chosen in ("en", "ru"):
        response.set_cookie(COOKIE, chosen, samesite="strict", httponly=True, path="/")
        bench_of(request).jobs.language = chosen
    return response


def lost(request: Request, text: str) -> Response:
    """Not found."""
    return page(request, "error.html", 404, title=_not_found(request), text=text)


def _not_found(request: Request) -> str:
    return {"en": "Not found", "ru": "Не найдено"}[language_of(request)]


def routes() -> Sequence[Route]:
    """Of all pages."""
    simple = [Route(f"/{name}", cards) for name in PAGES]
    return [
        Route("/", home),
        *simple,
        Route("/rig", rig, methods=["GET", "POST"]),
        Route("/scene", rig_scene),
        Route("/run/{command}", one_command, methods=["GET", "POST"]),
        Route("/line/{command}", line, methods=["POST"]),
        Route("/jobs/{number:int}", job),
        Route("/jobs/{number:int}/events", events),
        Route("/jobs/{number:int}/type", answer, methods=["POST"]),
        Route("/jobs/{number:int}/cancel", answer, methods=["POST"]),
        Route("/files", everything),
        Route("/upload", everything, methods=["POST"]),
        Route("/raw/{path:path}", raw),
        Route("/look/{path:path}", look),
        Route("/commands", all_commands),
        Route("/language", language, methods=["POST"]),
    ]
