"""From log files of CAN frames to a run folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from lmeasure.core import SettingsError, pasted
from lmeasure.text import Say, composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import BROWSER, RERUN, START, Paths, Point, Quaternion, Recording, Start, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.acquisition import Imported, Scan
    from lmeasure.recording import StatedStart


class Settings(Writing):
    """Settings of `lmeasure import`."""

    logs: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option("Log of each pass: .blf, .asc, .log, .txt, .trc, .csv (all also .gz), .mf4 (extra mf4).", metavar="LOG...", positional=True),
    ]
    rig: Annotated[Path | None, option("rig.toml; its table [can] assigns frames to counters.")] = None
    out: Annotated[Path | None, option("Run folder to write.", metavar="RUN")] = None
    scan: Annotated[bool, option("List the contents of the logs and suggest a table [can], without writing files.", flag="--scan")] = False
    report: Annotated[Path | None, option("With --scan: page to write, with counts over time.", metavar="FILE.html")] = None
    browser: Annotated[bool, BROWSER] = True
    start: Annotated[Start | None, option(f"Start pose: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    position_mm: Annotated[Point | None, option("Start position; use it with --quaternion-xyzw instead of --start.", metavar="X,Y,Z")] = (
        None
    )
    quaternion_xyzw: Annotated[Quaternion | None, option("Start orientation.", metavar="X,Y,Z,W")] = None
    dbc: Annotated[Path | None, option("DBC file with the counters; default the rig's.")] = None
    bus: Annotated[str | None, option("Read only this bus of the log.")] = None
    parquet: Annotated[bool, option("Write the counts as .parquet instead of .csv.")] = False
    rerun: Annotated[Recording | None, RERUN] = None

    @model_validator(mode="after")
    def _says_whose_counters(self) -> Self:
        if not self.scan and self.rig is None:
            raise SettingsError("rig", message("error.is_missing_without_one", logs=pasted(self.logs[0])))
        if not self.scan and self.out is None:
            raise SettingsError("out", message("error.is_missing"))
        if self.report is not None and not self.scan:
            raise SettingsError("report", message("error.goes_with_scan"))
        return self

    def following(self) -> str:
        """Return the command that reconstructs the motion, or reads the log by a rig."""
        if self.out is None or self.scan:
            return then("import {log} --rig rig.toml --out run", log=self.logs[0])
        known = self.start is not None or self.position_mm is not None
        return then("reconstruct {out} --out {out}/trajectory.parquet" + ("" if known else " --start X,Y,Z,O,A,T"), out=self.out)

    def paths(self) -> Paths:
        """A run folder from logs, a rig, a start and a DBC file."""
        if self.out is None:
            return Paths(present(self.rerun, self.report), (*self.logs, *present(self.rig, self.dbc)))
        start = () if self.start is None or not Path(self.start).is_file() else (Path(self.start),)
        ends = (".parquet" if self.parquet else ".csv", ".events.csv")
        passes = inside(self.out, *(f"pass{n}{end}" for n in range(1, len(self.logs) + 1) for end in ends))
        run = inside(self.out, "run.toml", "rig.toml", "calibration.json")
        return Paths((*run, *passes, *present(self.rerun, self.report)), (*self.logs, *start, *present(self.rig, self.dbc)))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Imported | tuple[Scan, ...]]":
    """Read the logs and write the run folder, or only look at what they hold."""
    if settings.scan:
        return _scanned(settings, progress)
    assert settings.rig is not None
    assert settings.out is not None
    from lmeasure.acquisition import import_logs, with_dbc, write_import
    from lmeasure.recording import start_of_rig, start_uncertainty
    from lmeasure.rig import read_linked_rig

    stated = _start(settings)
    rig, calibration = read_linked_rig(settings.rig)
    pose = None if stated is None else start_of_rig(stated.table, rig, stated.source)
    u_start = (None, None) if stated is None else start_uncertainty(stated.table, stated.source)
    if settings.dbc is not None:
        rig = with_dbc(rig, settings.dbc)
    imported = import_logs(
        settings.logs,
        rig,
        pose,
        calibration=calibration,
        u_start=u_start,
        folder=settings.rig.parent,
        bus=settings.bus,
        progress=steps(progress, "bytes"),
    )
    write_import(settings.out, imported, ".parquet" if settings.parquet else ".csv", force=settings.force)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, imported.run.rig, run=imported.run)
    notes = (message("workflow.note_no_start", where=str(settings.out / "run.toml")),) if pose is None else ()
    logs = imported.logs
    unread = tuple(composed("{file}: {note}", file=str(log.path), note=note) for log in logs for note in log.report.notes())
    figures: dict[str, float] = {"frames": sum(log.report.frames for log in logs), "samples": sum(len(log.counts.time_s) for log in logs)}
    figures |= {"duration_s": float(max(log.counts.time_s[-1] for log in logs)), "faults": sum(log.events.tally.total() for log in logs)}
    figures |= {"lines": sum(log.report.total for log in logs), "known": sum(log.report.known for log in logs)}
    figures |= {"unread": sum(log.report.unread for log in logs)}
    return Result(imported, (*imported.summary().splitlines(), *notes), figures, (*unread, *notes))


def _scanned(settings: Settings, progress: Progress) -> "Result[Imported | tuple[Scan, ...]]":
    from lmeasure.acquisition import scan_log

    found = tuple(scan_log(log, steps(progress, "bytes")) for log in settings.logs)
    lines = [line for scan in found for line in scan.lines()]
    counters = sum(len(c.counters) for scan in found for c in scan.carried)
    notes = tuple(composed("{file}: {note}", file=str(scan.path), note=note) for scan in found for note in scan.notes)
    figures = {"identifiers": float(sum(len(s.carried) for s in found)), "counter_like": float(counters)}
    if settings.report is not None:
        from lmeasure.report import scans_figure, write_inspection_page

        what = message("inspect.logs", files=tuple(str(log) for log in settings.logs), counters=counters)
        write_inspection_page(
            settings.report,
            settings.logs[0].name,
            what,
            lines=lines,
            figure=scans_figure(found, Say(of_terminal())),
            language=of_terminal(),
        )
    return Result(found, tuple(lines), figures, notes, page=settings.report)


def _start(settings: Settings) -> "StatedStart | None":
    from lmeasure.recording import StatedStart, stated_start

    position, turn = settings.position_mm, settings.quaternion_xyzw
    if settings.start is not None and (position is not None or turn is not None):
        raise SettingsError("start", message("error.is_given_and_so"))
    if position is not None and turn is None:
        raise SettingsError("position_mm", message("error.half_a_start_pose"))
    if turn is not None and position is None:
        raise SettingsError("quaternion_xyzw", message("error.states_half_of_the"))
    if settings.start is not None:
        return stated_start(settings.start)
    if position is None or turn is None:
        return None
    return StatedStart({"position_mm": list(position), "quaternion_xyzw": list(turn)}, "--position-mm, --quaternion-xyzw")
