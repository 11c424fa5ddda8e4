"""Two calibrations of a project beside each other: which points moved, by how much, and whether by chance; what `lmeasure compare` says."""

import math
import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lmeasure.calibration import Comparison, chance, compare_records, read_earlier
from lmeasure.core import LMeasureError
from lmeasure.text import Say
from lmeasure.workbench.answers import Bench, bench_of, language_of, page, within
from lmeasure.workbench.project import LARGEST_JSON, OutsideError, inside

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
            values["error"] = within(bench.folder, error)
    return page(request, "moved.html", 422 if values["error"] else 200, **values)


def _compared(bench: Bench, old: str, new: str) -> Comparison:
    paths = [inside(bench.folder, text) for text in (old, new)]
    if any(path.is_file() and path.stat().st_size > LARGEST_JSON for path in paths):
        raise OutsideError(f"{old} or {new}: is too large for a calibration")
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


def routes() -> Sequence[Route]:
    """Of this page."""
    return [Route("/calibrations", moved)]
