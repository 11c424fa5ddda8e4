"""State of a cell, read from the files of its project: its uncertainty, its last measurement, due work.

Read in the process of `worker`: files may be large, or made to expand.
"""

import datetime
import json
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmeasure.accuracy import read_zone
from lmeasure.core import LMeasureError
from lmeasure.io import read_regular
from lmeasure.report import cell_plan, glance
from lmeasure.rig import read_linked_rig
from lmeasure.text import Say
from lmeasure.workbench import trajectories
from lmeasure.workbench.project import LARGEST_JSON, Project, look_at

CANNOT_READ = (LMeasureError, OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError, OverflowError)
LARGEST = 2**28
"""Bytes of a zone that home reads."""


class Tile(NamedTuple):
    """One part of the state: its name, its heading, a value, its meaning, a note in small type, a state (good, warn, bad, or none), and the
    page that shows more."""

    name: str
    title: str
    value: str
    about: str
    note: str
    state: str
    page: str


class CellState(NamedTuple):
    """State of a cell: verdict and its state (good, warn, bad); tiles; a drawing (SVG, or empty); lines of due work, and whether any is
    overdue; whether the last check of the instrument failed."""

    verdict: str
    state: str
    tiles: tuple[Tile, ...] = ()
    plan: str = ""
    due: tuple[str, ...] = ()
    overdue: bool = False
    check_failed: bool = False


def cell_state(folder: Path, language: str) -> CellState:
    """Return the state of the cell of a project."""
    project, say = look_at(folder), Say(language)
    rig_file, zone_file = main_rig(project), newest(folder, project.of("zone"))
    rig = None if rig_file is None else _read(lambda: read_linked_rig(folder / rig_file)[0])
    zone = None if zone_file is None else _read(lambda: _zone(folder / zone_file, (folder / zone_file).stat().st_mtime_ns))
    calibrated = rig_file is not None and rig_file in project.calibrated()
    found: list[Tile | None] = [
        _tile("calibration", rig_file if calibrated else None, say, lambda at: _calibration(folder / at, say)),
        _tile("zone", zone_file, say, lambda at: _zone_tile(folder / at, say)),
        _tile("check", newest(folder, project.of("check")), say, lambda at: _check(folder / at, say)),
        _tile("run", newest(folder, project.of("trajectory")) or newest(folder, project.of("run")), say, lambda at: _run(folder / at, say)),
        _tile("certificate", _last_certificate(project), say, lambda at: _certificate(folder / at, say)),
    ]
    tiles = tuple(tile for tile in found if tile is not None)
    due = _read(lambda: _due(project, say)) or ()
    failed = any(tile.name == "check" and tile.state == "bad" for tile in tiles)
    if failed:
        verdict, state = say("cell.check_failed"), "bad"
    elif zone is not None and calibrated and (u95 := _u95(zone)) is not None:
        verdict, state = say("cell.measures", mm=u95[1]), "good"
    elif calibrated:
        verdict, state = say("cell.calibrated"), "good"
    elif rig_file is not None:
        verdict, state = say("cell.nominal"), "warn"
    else:
        verdict, state = say("cell.empty"), "warn"
    plan = None if rig is None else _read(lambda: cell_plan(rig, zone, say))
    return CellState(verdict, state, tiles, plan or "", tuple(text for text, _ in due), any(late for _, late in due), failed)


def main_rig(project: Project) -> str | None:
    """Return the rig of the cell: the newest calibrated one, else the newest; copies in runs and certificates are none."""
    copies = {Path(run) for run in project.of("run")}
    own = [path for path in project.of("rig") if Path(path).parent not in copies]
    return newest(project.folder, [path for path in own if path in project.calibrated()]) or newest(project.folder, own)


def newest(folder: Path, paths: Iterable[str]) -> str | None:
    """Return the path that was changed last."""
    known = [(when, path) for path in paths if (when := _changed(folder / path)) is not None]
    return max(known)[1] if known else None


def _changed(path: Path) -> float | None:
    inner = next((path / name for name in ("run.toml", "certificate.json") if (path / name).is_file()), path)
    return _read(lambda: inner.stat().st_mtime)


def _read(work: Callable[[], Any]) -> Any:
    """Return the file's content; None if it is unreadable."""
    try:
        return work()
    except CANNOT_READ:
        return None


def _tile(name: str, path: str | None, say: Say, of: Callable[[str], tuple[str, str, str, str]]) -> Tile | None:
    """Return the tile of a file, as unread where it cannot be read; None without a file."""
    if path is None:
        return None
    address = {"calibration": f"/look/{Path(path).parent.as_posix()}", "run": f"/trajectory/{path}"}.get(name, f"/look/{path}")
    if name == "run" and not Path(path).suffix:
        address = f"/look/{path}"
    if name == "check":
        address = f"/look/{Path(path).with_suffix('.html').as_posix()}"
    try:
        value, about, note, state = of(path)
    except CANNOT_READ:
        value, about, note, state = "\u2013", say("cell.unread", file=path), "", "bad"
    return Tile(name, say(f"cell.title.{name}"), value, about, note, state, address)


def _ago(path: Path, say: Say) -> str:
    days = (datetime.date.today() - datetime.date.fromtimestamp(path.stat().st_mtime)).days
    return say("cell.today") if days <= 0 else say("cell.yesterday") if days == 1 else say("cell.days_ago", days=days)


def _document(path: Path) -> Any:
    return json.loads(read_regular(path, LARGEST_JSON))


def _calibration(path: Path, say: Say) -> tuple[str, str, str, str]:
    _, record = read_linked_rig(path)
    assert record is not None
    poses = say("cell.poses", count=len({r.pose for r in record.residuals}))
    note = f"{poses}, {_ago(path, say)}"
    predicted = record.predicted
    if "position_worst_mm" in predicted:
        return say("cell.mm", mm=float(predicted["position_worst_mm"])), say("cell.u_position"), note, "good"
    worst = max(float(e["worst_mm"]) for e in predicted["lengths"])
    return say("cell.mm", mm=worst), say("cell.u_length"), note, "good"


@lru_cache(maxsize=1)
def _zone(path: Path, changed_ns: int) -> Any:
    if path.stat().st_size > LARGEST:
        raise ValueError(path)
    return read_zone(path)


def _u95(zone: Any) -> tuple[float, float] | None:
    """Return best and worst U95 of the position in the zone [mm]."""
    u95 = zone["u95_position_mm"].values[zone["in_zone"].values.astype(bool)]
    return (float(np.min(u95)), float(np.max(u95))) if len(u95) else None


def _zone_tile(path: Path, say: Say) -> tuple[str, str, str, str]:
    zone = _zone(path, path.stat().st_mtime_ns)
    volume = say("cell.volume", m3=float(zone.attrs["zone_volume_mm3"]) / 1e9)
    if (u95 := _u95(zone)) is None:
        return volume, say("cell.no_zone"), _ago(path, say), "bad"
    about = say("cell.u95_zone", low=u95[0], high=u95[1], limit=float(zone.attrs["limit_deg"]))
    return volume, about, _ago(path, say), "good"


def _check(path: Path, say: Say) -> tuple[str, str, str, str]:
    content = _document(path)
    closures, passed = content["closures"], content["verdict"] == "passed"
    about = say("cell.closures", closed=sum(not c["failed"] for c in closures), of=len(closures))
    return say("cell.passed" if passed else "cell.calibrate_again"), about, _ago(path, say), "good" if passed else "bad"


def _run(path: Path, say: Say) -> tuple[str, str, str, str]:
    if path.is_dir():
        return path.name, say("cell.not_reconstructed"), _ago(path / "run.toml", say), "warn"
    found = trajectories.along_of(path)
    time_s, bad = found.trajectory.time_s, sum(s.samples for s in found.stretches if not s.ok)
    value = say("page.of", n=len(time_s) - bad, of=len(time_s))
    about = say("cell.samples", seconds=float(time_s[-1] - time_s[0]))
    known = found.u95_mm[np.isfinite(found.u95_mm)]
    span = [say("cell.u95", low=float(known.min()), high=float(known.max()))] if len(known) else []
    return value, about, ", ".join([*span, _ago(path, say)]), "warn" if bad else "good"


def _last_certificate(project: Project) -> str | None:
    """Return the certificate that was written last, as it states itself."""
    made = [
        (str(when), path)
        for path in project.of("certificate")
        if (when := _read(lambda path=path: _document(project.folder / path / "certificate.json")["created"])) is not None  # type: ignore[misc]
    ]
    return max(made)[1] if made else newest(project.folder, project.of("certificate"))


def _certificate(path: Path, say: Say) -> tuple[str, str, str, str]:
    found = glance(_document(path / "certificate.json"), say.language)
    return found.value, f"{found.about}. {found.outcome}", _ago(path / "certificate.json", say), found.state


def _due(project: Project, say: Say) -> list[tuple[str, bool]]:
    """Return the lines of due work in the project's registers, and whether each is overdue."""
    from lmeasure.register import Register, due, read_limits

    out, today = [], datetime.date.today()
    for folder in project.of("register"):
        limits = read_limits(project.folder / folder)
        register = Register(project.folder / folder)
        try:
            out += [(one.said(today).text(say.language), one.overdue(today)) for one in due(register, limits)]
        finally:
            register.close()
    return out
