"""Two calibrations of a project beside each other: which points moved, by how much, and whether by chance; what `lmeasure compare` says."""

import math
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lmeasure.errors import LMeasureError
from lmeasure.saying import Say
from lmeasure.workbench.answers import Bench, bench_of, language_of, page
from lmeasure.workbench.project import inside

if TYPE_CHECKING:
    from lmeasure.calibration.compare import Comparison

NORMAL_95 = 1.959964
"""Half the width of the interval that holds 95 % of a normal value, in its standard deviations."""


class Value(NamedTuple):
    """A value before and now with its change and what holds the change with 95 %, in the unit of its name."""

    name: str
    old: float
    new: float
    change: float
    u95: float

    @property
    def beyond(self) -> bool:
        """Whether the change is more than that."""
        return abs(self.change) > self.u95


async def moved(request: Request) -> Response:
    """The page: two calibrations are chosen, ?old=...&new=..., the last two where none is."""
    bench = bench_of(request)
    records = sorted(bench.project.of("record"), key=lambda path: ((bench.folder / path).stat().st_mtime, path))
    old, new = (request.query_params.get(name, "") for name in ("old", "new"))
    if not old and not new and len(records) > 1:
        old, new = records[-2:]
    values: dict[str, Any] = {"records": records, "old": old, "new": new, "found": None, "error": "", "line": ""}
    if old and new:
        from lmeasure.calibration.compare import chance

        values |= {"line": shlex.join(["lmeasure", "compare", old, new]), "chance": chance}
        try:
            found = await run_in_threadpool(_compared, bench, old, new)
            values |= {"found": found, "values": shifts(found), "notes": [Say(language_of(request)).told(note) for note in found.notes]}
        except (LMeasureError, OSError) as error:
            values["error"] = str(error)
    return page(request, "moved.html", 422 if values["error"] else 200, **values)


def _compared(bench: Bench, old: str, new: str) -> "Comparison":
    from dataclasses import replace

    from lmeasure.calibration.compare import compare_records, read_earlier

    first, later = (read_earlier(inside(bench.folder, text)) for text in (old, new))
    return compare_records(replace(first, source=old), replace(later, source=new))


def shifts(found: "Comparison") -> dict[str, list[Value]]:
    """The values of each point, those that have an uncertainty."""
    out: dict[str, list[Value]] = {}
    for v in found.values:
        if v.u > 0.0 and math.isfinite(v.u):
            owner, _, key = v.name.removeprefix("tool.").rpartition(".")
            out.setdefault(owner, []).append(Value(key, v.old, v.new, v.change, NORMAL_95 * v.u))
    return out


def routes() -> Sequence[Route]:
    """Of this page."""
    return [Route("/calibrations", moved)]
