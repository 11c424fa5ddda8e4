"""Pages of certificates: the form of their details, verification of dropped files, and their results over time."""

import contextlib
import datetime
import json
import math
import shutil
from pathlib import Path
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from lmeasure.certificate import with_u95
from lmeasure.core import LMeasureError
from lmeasure.io import files, read_regular
from lmeasure.iso9283 import trend_names
from lmeasure.text import message
from lmeasure.workbench import details as form_of_details  # loads trajectories too: threads of two requests that begin it see halves
from lmeasure.workbench.answers import Bench, Form, bench_of, language_of, page, posted, refused, uploads_of, within
from lmeasure.workbench.project import LARGEST_JSON, LARGEST_TEXT, OutsideError, Project, inside
from lmeasure.workbench.text import said
from lmeasure.workbench.uploads import Uploads, take_in, take_in_folder

HIGH, LEFT = 150, 60


def details(request: Request, form: Form) -> Response:
    """Answer with a details file as a form; a posted one is saved, or all complaints are shown with the typed values."""
    bench, language = bench_of(request), language_of(request)
    known = bench.project.of("details")
    typed = {key: values[-1] for key, values in form.items()}
    file = typed.get("_file") or request.query_params.get("file") or (known[0] if known else "details.toml")
    path = inside(bench.folder, file)
    if path.suffix != ".toml" or (path.exists() and (file not in known or path.stat().st_size > LARGEST_TEXT)):
        raise OutsideError(message("error.is_no_details_file", where=file))
    before: Any = files.read_toml(path) if path.is_file() else {}
    content = form_of_details.filled(before, typed) if typed else dict(before)
    wrong = form_of_details.complaints(content, file) if typed else []
    if typed and not wrong:
        files.rewrite_toml(path, before.holding(content)) if path.is_file() else files.write_toml(path, content)
        return RedirectResponse(f"/details?file={file}&saved=1", 303)
    values = form_of_details.read(path) | {key: text for key, text in typed.items() if not key.startswith("_")}
    shown: dict[str, Any] = {"file": file, "form": form_of_details.FORM, "values": values, "complaints": wrong}
    shown |= {"label": lambda entry: form_of_details.label(entry, language), "saved": request.query_params.get("saved") == "1"}
    return page(request, "details.html", 422 if wrong else 200, missing=form_of_details.missing(content), known=known, **shown)


def preview(request: Request, form: Form) -> Response:
    """Answer with the printed form of the typed values, in both languages; empty rows; faults."""
    typed = {key: values[-1] for key, values in form.items()}
    content = form_of_details.filled({}, typed)
    wrong = form_of_details.complaints(content, "details")
    reported: dict[str, Any] = {
        "complaints": [said(language_of(request), one) for one in wrong],
        "missing": form_of_details.missing(content),
    }
    if not wrong:
        reported["printed"] = {language: form_of_details.printed(content, language) for language in ("en", "ru")}
    return JSONResponse(reported)


async def verify_dropped(request: Request) -> Response:
    """A certificate that is dropped, as a zip or as its folder: kept beside, and verified."""
    bench = bench_of(request)
    async with uploads_of(request, most=5000) as (_, uploads):
        if not uploads:
            return RedirectResponse("/robot", 303)
        try:
            kept = await run_in_threadpool(_kept, bench, uploads)
        except (LMeasureError, OSError) as error:
            return await run_in_threadpool(_not_verified, request, error)
    try:
        job = await bench.jobs.begin(["verify", kept])
    except LMeasureError as error:
        await run_in_threadpool(shutil.rmtree, bench.folder.joinpath(*kept.split("/")[:2]), ignore_errors=True)
        return await run_in_threadpool(_not_verified, request, error)
    return RedirectResponse(f"/jobs/{job.number}", 303)


def _kept(bench: Bench, uploads: Uploads) -> str:
    """Keep a certificate in a folder of its own and return the path of the certificate in the project."""
    number = 1
    while (bench.folder / "verified" / str(number)).exists():
        number += 1
    target = bench.folder / "verified" / str(number)
    try:
        if len(uploads) == 1 and uploads[0][0].lower().endswith(".zip"):
            # as whatever packed it: `verify` itself takes a zip of `certify` alone
            take_in(target, uploads)
        else:
            take_in_folder(target, uploads)
        found = _certificate_in(target, uploads[0][0])
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        with contextlib.suppress(OSError):
            target.parent.rmdir()
        raise
    return found.relative_to(bench.folder).as_posix()


def _certificate_in(folder: Path, name: str) -> Path:
    found = sorted(folder.rglob("certificate.json"), key=lambda path: len(path.parts))
    if not found:
        raise OutsideError(message("error.holds_no_certificate_json", where=name[:200]))
    return found[0].parent


def _not_verified(request: Request, error: Exception) -> Response:
    language = language_of(request)
    return refused(request, 422, said(language, "workbench.not_verified"), within(bench_of(request).folder, error, language))


class Point(NamedTuple):
    """A figure of one certificate: its folder, the day, the value and its U95; x, y, and the ends of the bar in the picture."""

    folder: str
    day: str
    value: float
    u95: float
    x: float = 0.0
    y: float = 0.0
    low: float = 0.0
    high: float = 0.0

    @property
    def said(self) -> str:
        """Value and U95, which ends where that does."""
        return " ± ".join(with_u95(self.value, self.u95))


class Course(NamedTuple):
    """A figure over time: its name, its unit, its points, and the largest value of the picture."""

    name: str
    unit: str
    points: list[Point]
    top: float


def courses(project: Project) -> dict[str, list[Course]]:
    """Figures over time by robot: maker, model and serial number, as the certificates state them."""
    robots: dict[str, dict[str, list[tuple[str, Point]]]] = {}
    for folder in project.of("certificate"):
        try:
            content = json.loads(read_regular(project.folder / folder / "certificate.json", LARGEST_JSON))
            item = content["details"].get("item", {})
            robot = " ".join(str(item[key]) for key in ("maker", "model", "serial") if key in item)
            day = str(content["details"].get("dates", {}).get("measured_to", content["created"]))[:10]
            datetime.date.fromisoformat(day)
            for name in trend_names():
                own = [c for c in content["characteristics"] if c["name"] == name and c["value"] is not None and c["u95"] is not None]
                if own:
                    worst = max(own, key=lambda c: abs(c["value"]))
                    reported = Point(folder, day, float(worst["value"]), float(worst["u95"]))
                    robots.setdefault(robot, {}).setdefault(name, []).append((str(worst["unit"]), reported))
        except (LMeasureError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
            continue
    return {robot: [_drawn(name, one[0][0], [p for _, p in one]) for name, one in by_name.items()] for robot, by_name in robots.items()}


def _drawn(name: str, unit: str, points: list[Point]) -> Course:
    """Places in a picture of 600 by HIGH, dates from left to right, zero at the bottom."""
    points = sorted(points, key=lambda p: (p.day, p.folder))
    days = [datetime.date.fromisoformat(p.day).toordinal() for p in points]
    top = max(abs(p.value) + p.u95 for p in points)
    top = 1.0 if not math.isfinite(top) or top <= 0.0 else top * 1.1
    span = max(days) - min(days)

    def x(i: int) -> float:
        # certificates of one day are drawn side by side
        along = (days[i] - min(days)) / span if span else (i + 0.5) / len(days)
        return round(LEFT + 500.0 * along + 10.0, 1)

    def y(value: float) -> float:
        return round(10.0 + (HIGH - 40.0) * (1.0 - max(value, 0.0) / top), 1)

    placed = [
        p._replace(x=x(i), y=y(abs(p.value)), low=y(abs(p.value) - p.u95), high=y(abs(p.value) + p.u95)) for i, p in enumerate(points)
    ]
    return Course(name, unit, placed, top)


def trend(request: Request) -> Response:
    """The figures of all certificates of the project over time, by robot."""
    project = bench_of(request).project
    return page(request, "trend.html", robots=courses(project), folders=project.of("certificate"))


ROUTES = (
    Route("/details", posted(details), methods=["GET", "POST"]),
    Route("/details/preview", posted(preview), methods=["POST"]),
    Route("/verify", verify_dropped, methods=["POST"]),
    Route("/trend", trend),
)
