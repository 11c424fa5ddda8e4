"""Pages of a register: its instruments and robots, control charts of a result, the due list, and recall."""

import datetime
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lmeasure.core import CertificationError, FloatArray
from lmeasure.workbench.answers import bench_of, language_of, page
from lmeasure.workbench.project import OutsideError, inside
from lmeasure.workbench.project_list import REGISTER
from lmeasure.workbench.text import why

if TYPE_CHECKING:
    from lmeasure.register import Register

BASELINE = 10
WIDTH, HIGH, LEFT = 600, 150, 60


class Curve(NamedTuple):
    """A chart in a picture of WIDTH by HIGH: its name, x and y of its points, those that signal, y of its limits at each point, and its
    largest value."""

    name: str
    points: list[tuple[float, float]]
    signals: list[int]
    limits: list[list[tuple[float, float]]]
    top: float


@contextmanager
def _opened(request: Request) -> Iterator["Register"]:
    """The register that a page's address names, of this project; LMeasureError where there is none."""
    from lmeasure.register import FILE, Register

    folder = inside(bench_of(request).folder, _folder(request))
    if not (folder / FILE).is_file():
        raise OutsideError("workbench.register_none")
    register = Register(folder)
    try:
        yield register
    finally:
        register.close()


def _folder(request: Request) -> str:
    """Return the folder that the address names, or else the project's register that is nearest to the top; empty where it has none."""
    named = request.query_params.get("folder")
    return next(iter(bench_of(request).project.of("register")), "") if named is None else named


def _page(request: Request, view: str, **values: Any) -> Response:
    return page(request, "register.html", view=view, folder=_folder(request) or REGISTER, **values)


def instruments(request: Request) -> Response:
    """Robots, rigs and references of the register, with how many documents each has and when the last was made; how to begin one."""
    if not _folder(request):
        return _page(request, "none")
    with _opened(request) as register:
        return _page(request, "instruments", subjects=register.subjects(), newest=register.newest, faults=())


def charts(request: Request) -> Response:
    """The results of a subject; one of them over time, with control charts and forecast."""
    from lmeasure.register import control_charts, forecast

    requested = {key: request.query_params.get(key, "") for key in ("subject", "kind", "result")}
    with _opened(request) as register:
        names = register.results(requested["subject"], requested["kind"])
        if requested["result"] not in names:
            return _page(request, "results", **requested, names=names)
        days, values, u, unit = register.series(requested["subject"], requested["result"], requested["kind"])
    rows = [(_date(d), float(v), None if np.isnan(s) else float(s)) for d, v, s in zip(days, values, u, strict=True)]
    drawn, low, high, reason = [_values(days, values, u)], None, None, ""
    if len(values) >= BASELINE:
        try:
            drawn += [_chart(days, c.name, c.statistic, c.limit) for c in control_charts(values, BASELINE)]
        except CertificationError as error:
            reason = why(language_of(request), error)
    try:
        low, high = forecast(days, values, u).interval(days[-1] + 365.25)
    except CertificationError as error:
        reason = reason or why(language_of(request), error)
    shown = {"unit": unit, "rows": rows, "charts": drawn, "interval": None if low is None else (low, high), "reason": reason}
    return _page(request, "charts", **requested, **shown, baseline=BASELINE, width=WIDTH, high=HIGH)


def due_list(request: Request) -> Response:
    """Return the instruments due for calibration, the earliest first."""
    from lmeasure.register import due, read_limits

    with _opened(request) as register:
        assert register.path is not None
        return _page(request, "due", waiting=due(register, read_limits(register.path.parent)), today=datetime.date.today())


def recall(request: Request) -> Response:
    """Documents that others depend on, or those that depend on one, directly or through others."""
    digest = request.query_params.get("digest", "")
    with _opened(request) as register:
        found = register.recall(digest) if digest else register.used()
    return _page(request, "recall", digest=digest, found=found)


def _date(day: float) -> str:
    return (datetime.date(1970, 1, 1) + datetime.timedelta(days=int(day))).isoformat()


def _placed(days: FloatArray, values: FloatArray, top: float) -> list[tuple[float, float]]:
    """Places in the picture: days from left to right, from -top at its bottom to top."""
    span = float(np.ptp(days)) or 1.0
    x = LEFT + (WIDTH - LEFT - 20) * (days - days.min()) / span
    y = 10.0 + (HIGH - 40.0) * 0.5 * (1.0 - np.clip(values / (top or 1.0), -1.0, 1.0))
    return list(zip(np.round(x, 1).tolist(), np.round(y, 1).tolist(), strict=True))


def _values(days: FloatArray, values: FloatArray, u: FloatArray) -> Curve:
    """The values about their mean, with two standard uncertainties to either side."""
    away, wide = values - values.mean(), 2.0 * np.nan_to_num(u)
    top = float((np.abs(away) + wide).max()) or 1.0
    return Curve("", _placed(days, away, top), [], [_placed(days, away + sign * wide, top) for sign in (1.0, -1.0)], top)


def _chart(days: FloatArray, name: str, statistic: FloatArray, limit: FloatArray) -> Curve:
    top = 1.1 * float(np.maximum(np.abs(statistic), limit).max())
    signals = np.flatnonzero(np.abs(statistic) > limit).tolist()
    return Curve(name, _placed(days, statistic, top), signals, [_placed(days, sign * limit, top) for sign in (1.0, -1.0)], top)


ROUTES = (
    Route("/register", instruments),
    Route("/register/charts", charts),
    Route("/register/due", due_list),
    Route("/register/recall", recall),
)
