"""Any file of ours, or of a known log format, in a page."""

import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.text import LANGUAGES, Message, Say, Versions, composed, message, of_terminal, settled
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import (
    ALIGN,
    ANGLES,
    BROWSER,
    COLUMNS,
    LANGUAGE,
    START,
    U_POSITION,
    U_ROTATION,
    CommandSettings,
    Paths,
    Start,
    Writing,
    notes_of_file,
    option,
    refuse,
    stated_beside,
    then,
)

if TYPE_CHECKING:
    from lmeasure.rig import Rig


class ReportSettings(Writing):
    measured: Annotated[
        Path,
        option(
            "Run folder, or trajectory from `reconstruct` or another instrument: .csv, .parquet, .tum, EuRoC.",
            metavar="RUN_OR_TRAJECTORY",
            positional=True,
        ),
    ]
    out: Annotated[Path, option("Folder for trajectory.html.", metavar="DIR")]
    rig: Annotated[Path | None, option("rig.toml to use instead of the run's own; with a trajectory: rig to draw.")] = None
    start: Annotated[Start | None, option(f"Start pose, instead of the run's: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    constraint: Annotated[str | None, option("Constraint of a run's tool if there are too few cables: planar or vertical-axis.")] = None
    columns: Annotated[str, COLUMNS] = ""
    u_position_mm: Annotated[float | None, U_POSITION] = None
    u_rotation_deg: Annotated[float | None, U_ROTATION] = None
    angles: Annotated[str | None, ANGLES] = None
    align: Annotated[Path | None, ALIGN] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def following(self) -> str:
        if self.measured.is_dir():
            return then("reconstruct {run} --out {run}/trajectory.parquet", run=self.measured)
        return then("certify {trajectory} --program program.toml --out certificate", trajectory=self.measured)

    def paths(self) -> Paths:
        start = None if self.start is None else Path(self.start)
        read = in_run_folder(self.measured) if self.measured.is_dir() else (self.measured,)
        return Paths(inside(self.out, "trajectory.html"), (*read, *present(self.rig, start, self.align)))


@workflow
def run_report(settings: ReportSettings, progress: Progress = silent) -> Result:
    """Read or reconstruct the trajectory and write its page."""
    return write_report(settings, settings.out / "trajectory.html", progress)


def write_report(settings: ReportSettings, page: Path, progress: Progress) -> Result:
    """Read or reconstruct the trajectory and write this page."""
    from lmeasure.accuracy import along
    from lmeasure.api import explained
    from lmeasure.io import files
    from lmeasure.iso9283 import in_program_frame
    from lmeasure.recording import read_run, stated_start
    from lmeasure.report import trajectory_summary, write_trajectory_page
    from lmeasure.rig import read_linked_rig
    from lmeasure.trajectory import read_trajectory, reconstruct, stamps_of

    progress(0.0, "read")
    if settings.measured.is_dir():
        beside = ("columns", "u_position_mm", "u_rotation_deg", "angles", "align")
        refuse(settings, message("refuse.trajectory_file"), *beside)
        recorded = read_run(settings.measured, settings.rig, None if settings.start is None else stated_start(settings.start))
        progress(0.2, "reconstruct")
        rig: Rig | None = recorded.rig
        trajectory = reconstruct(recorded, settings.constraint, judge=explained)
        sources = [settings.measured / "run.toml", *(Path(c.source) for c in recorded.passes)]
    else:
        refuse(settings, message("refuse.run_folder"), "start", "constraint")
        trajectory = read_trajectory(settings.measured, stated_beside(settings))
        if settings.align is not None:
            trajectory = in_program_frame(trajectory, settings.align)
        rig = None if settings.rig is None else read_linked_rig(settings.rig)[0]
        sources = [settings.measured]
    progress(0.6, "report")
    found = along(trajectory)
    inputs = [(path.name, files.sha256(path)) for path in sources]
    name = settings.measured.resolve().name
    write_trajectory_page(page, name, found, rig, inputs=inputs, language=settings.language or of_terminal())
    progress(1.0, "report")
    rows = zip(*([f"{label}: {value}" for label, value in trajectory_summary(found, one)] for one in LANGUAGES), strict=True)
    reported = [composed("{row}", row=Versions(dict(zip(LANGUAGES, row, strict=True)))) for row in rows]
    figures = {"samples": float(len(trajectory.time_s)), "left_out": float(sum(s.samples for s in found.stretches if not s.ok))}
    if found.worst is not None:
        figures["worst_u95_position_mm"] = float(found.u95_mm[found.worst])
    if found.motion is not None:
        figures["largest_speed_mm_s"] = found.motion.largest_speed()[0]
    notes = () if settings.measured.is_dir() else (*trajectory.notes, *stamps_of(trajectory).notes)
    lines, warnings = notes_of_file(notes)
    return Result(found, (*reported, *lines, message("line.written", files=page)), figures, warnings)


class InspectSettings(Writing):
    OUT_FILE: ClassVar[str] = "inspect.html"

    file: Annotated[
        Path, option("Log, run folder, trajectory, zone, certificate, calibration, rig.toml, ...", metavar="FILE", positional=True)
    ]
    out: Annotated[
        Path | None, option("Page to write; on a terminal a page opens without it too.", metavar="FILE.html", also=("--report",))
    ] = None
    browser: Annotated[bool, BROWSER] = True
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def following(self) -> str:
        return then("init my-cell")

    def paths(self) -> Paths:
        return Paths(present(self.out), in_run_folder(self.file) if self.file.is_dir() else (self.file,))


class Content(NamedTuple):
    """Content of a file: its kind in one line, the noun to draw, remarks, numbers, and words of the command to type next."""

    what: Message
    noun: Any = None
    lines: tuple[str, ...] = ()
    figures: dict[str, float] = {}  # noqa: RUF012 - never changed
    next: str = ""


@workflow
def run_inspect(settings: InspectSettings, progress: Progress = silent) -> Result:
    """Print the kind of a file, and write its page on request."""
    path = settings.file
    progress(0.0, "read")
    read, path = _reader(path)
    content = read(path, progress)
    if settings.out is not None:
        _write_page(settings.out, path, content, settings, progress)
    written = () if settings.out is None else (message("line.written", files=settings.out),)
    return Result(None, (content.what, *written), content.figures, next=_next(content, path), page=settings.out)


def _write_page(out: Path, path: Path, content: Content, settings: InspectSettings, progress: Progress) -> None:
    """Write the page of a trajectory by its own report, of anything else its picture and remarks."""
    import xarray as xr

    from lmeasure.certificate import Certificate
    from lmeasure.report import every_figure, figure_of, glance, write_inspection_page, zone_lines
    from lmeasure.trajectory import Trajectory

    if isinstance(content.noun, Trajectory) or content.next.startswith("reconstruct {folder} --out"):
        with suppress(LMeasureError):  # a run without a start has no trajectory, and its counts are drawn
            write_report(ReportSettings(measured=path, out=out.parent, language=settings.language), out, progress)
            return
    language = settings.language or of_terminal()
    lines: Sequence[str] = content.lines
    if isinstance(content.noun, Certificate):
        shown = glance(content.noun.content, language)
        every = every_figure({**content.noun.content, "language": language}, brief=True)[1:]
        lines = [f"{shown.about}: {shown.value}. {shown.outcome}", *(line.strip() for line in every)]
    elif isinstance(content.noun, xr.Dataset):
        lines = zone_lines(content.noun, language)
    figure = None if content.noun is None else figure_of(content.noun, say=Say(language))
    title, command = path.resolve().name, _next(content, path)
    write_inspection_page(out, title, content.what, lines=lines, figure=figure, command=command, language=language)


def _next(content: Content, path: Path) -> str:
    """Return the command to type next; empty where there is none."""
    return then(content.next, file=path, folder=path if path.is_dir() else path.parent) if content.next else ""


Reader = Callable[[Path, Progress], Content]


def _reader(path: Path) -> tuple[Reader, Path]:
    """Return the reader of a file or folder, and its path; FileFormatError for an unknown kind."""
    if not path.exists():
        raise FileFormatError(message("error.is_not_there", where=path))
    if path.is_dir():
        for name, reader in FOLDERS.items():
            if (path / name).is_file():
                return reader, path
        raise FileFormatError(message("error.is_no_folder_of_lmeasure", where=path, folders=", ".join(FOLDERS)))
    if path.name in FOLDERS:
        return FOLDERS[path.name], path.parent
    if path.name == "counts.csv" and (path.parent / "reference_poses.csv").is_file():
        return _campaign, path.parent
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return _toml, path
    return SUFFIXES.get(suffix, _measured), path


def _run(path: Path, progress: Progress) -> Content:
    from lmeasure.recording import read_run

    run = read_run(path)
    samples = sum(len(one.time_s) for one in run.passes)
    seconds = max(float(one.time_s[-1] - one.time_s[0]) for one in run.passes)
    known = run.start is not None
    values = {"file": path, "passes": len(run.passes), "samples": samples, "seconds": seconds}
    code = "inspect.run" if known else "inspect.run_without_start"
    following = "reconstruct {folder} --out {folder}/trajectory.parquet"
    return Content(
        message(code, **values), run, (), {"samples": float(samples)}, following if known else f"{following} --start X,Y,Z,O,A,T"
    )


def _certificate(path: Path, progress: Progress) -> Content:
    from lmeasure.certificate import Certificate, opened_zip

    with tempfile.TemporaryDirectory() as scratch:
        if path.is_dir():
            found = Certificate.read(path)
        else:
            with opened_zip(path, Path(scratch)) as folder:
                found = Certificate.read(folder)
    count = len(found.content["characteristics"])
    what = message("inspect.certificate", file=path, id=found.content["id"], characteristics=count)
    return Content(what, found, (), {"characteristics": float(count)}, "verify {file}")


def _calibration(path: Path, progress: Progress) -> Content:
    from lmeasure.rig import read_calibration_record

    record = read_calibration_record(path / "calibration.json")
    rms = float(record.noise["residual_rms_mm"])
    what = message("inspect.calibration", file=path, parameters=len(record.parameters), mm=rms)
    rows = (composed("{name}  {value:.6g}  u {u:.2g}", name=p.name, value=settled(p.value), u=p.u) for p in record.parameters)
    lines = (*rows, *(w.text for w in record.warnings))
    return Content(what, record, lines, {"residual_rms_mm": rms}, "zone {folder}/rig.toml --out zone.nc")


def _identification(path: Path, progress: Progress) -> Content:
    content = _document(path / "identified.json")
    rows = [composed("{name}  {value:.6g}", name=p["name"], value=settled(p["value"])) for p in content.get("parameters", ())]
    what = message("inspect.identification", file=path, parameters=len(rows))
    return Content(what, None, tuple(rows), {}, "correct program.csv --identified {folder} --out corrected")


def _campaign(path: Path, progress: Progress) -> Content:
    from lmeasure.calibration import read_campaign

    campaign = read_campaign(path)
    what = message("inspect.campaign", file=path, poses=len(campaign.poses))
    return Content(what, campaign.poses, (), {"poses": float(len(campaign.poses))}, "calibrate {folder} --out calibrated")


def _toml(path: Path, progress: Progress) -> Content:
    from lmeasure.io import read_toml
    from lmeasure.recording import read_program
    from lmeasure.rig import read_linked_rig
    from lmeasure.robots import read_robot

    kind = str(read_toml(path).get("schema", "")).removeprefix("lmeasure.").split("/")[0]
    if kind == "rig":
        rig, calibration = read_linked_rig(path)
        code = "inspect.rig" if calibration is None else "inspect.rig_calibrated"
        what = message(code, file=path, name=rig.name, cables=len(rig.cable), points=len(rig.observation_point))
        return Content(what, rig, (), {"cables": float(len(rig.cable))}, "zone {file} --out zone.nc")
    if kind == "program":
        program = read_program(path)
        what = message("inspect.program", file=path, poses=len(program.pose), paths=len(program.path))
        return Content(what, program, (), {"poses": float(len(program.pose))}, "record rig.toml --bus socketcan:can0 --out run")
    if kind == "robot":
        robot = read_robot(path)
        what = message("inspect.robot", file=path, name=robot.name)
        calibrated = "identify --robot {file} --measurements measurements.csv --out identified"
        return Content(what, None, (), {}, "mechanism {file} --report mechanism" if robot.kind == "parallel" else calibrated)
    if kind not in DOCUMENTS:
        raise _unknown(path)
    return Content(message("inspect.document", file=path, kind=kind), None, tuple(path.read_text(encoding="utf-8").splitlines()))


def _zone(path: Path, progress: Progress) -> Content:
    from lmeasure.accuracy import read_zone

    zone = read_zone(path)
    volume = float(zone.attrs["zone_volume_mm3"])
    what = message("inspect.zone", file=path, volume=1e-9 * volume)
    return Content(what, zone, (), {"zone_volume_mm3": volume}, "program --zone {file} --out program")


def _dcc(path: Path, progress: Progress) -> Content:
    from lmeasure.certificate import read_dcc

    dcc = read_dcc(path)
    what = message("inspect.dcc", file=path, id=dcc.identifier, results=len(dcc.results))
    valid = () if dcc.expires is None else (message("dcc.valid_until", expires=dcc.expires.isoformat()),)
    rows = (composed("{name}  {value:.6g} {unit}  u {u:.2g}", name=r.name, value=r.value, unit=r.unit, u=r.u) for r in dcc.results)
    doubts = (message("dcc.not_traceable", id=dcc.identifier),) if dcc.traceable is False else ()
    lines = (dcc.traceability, *valid, *doubts, *rows)
    return Content(what, None, lines, {"results": float(len(dcc.results))}, "register register --add {file}")


def _recording(path: Path, progress: Progress) -> Content:
    from lmeasure.io import read_regular

    if read_regular(path, 1 << 40)[:3] != b"RRF":
        raise _unknown(path)
    return Content(message("inspect.recording", file=path), None, (), {}, "view {file}")


def _json(path: Path, progress: Progress) -> Content:
    content = _document(path)
    kind = str(content.get("schema", "")) if isinstance(content, dict) else ""
    if not kind.startswith("lmeasure."):
        raise _unknown(path)
    lines = json.dumps(content, indent=1, ensure_ascii=False).splitlines()
    return Content(message("inspect.document", file=path, kind=kind.removeprefix("lmeasure.").split("/")[0]), None, tuple(lines))


def _measured(path: Path, progress: Progress) -> Content:
    """Read a log, a trajectory, a table of counts, or one of poses, whichever it is."""
    from lmeasure.acquisition import log_suffixes
    from lmeasure.core import CONVENTIONS
    from lmeasure.recording import read_counts, read_poses
    from lmeasure.trajectory import read_trajectory

    suffix = path.suffix.lower()
    if suffix in log_suffixes() or suffix == ".gz":
        with suppress(LMeasureError):
            return _log(path, progress)
    if suffix in (".csv", ".parquet", ".tum", ".mcap", ".trc", ".txt", ".tsv"):
        with suppress(LMeasureError):
            trajectory = read_trajectory(path)
            posed = int((trajectory.status == 0).sum())
            values = {"file": path, "samples": len(trajectory.time_s), "posed": posed}
            figures = {"samples": float(len(trajectory.time_s)), "with_a_pose": float(posed)}
            return Content(
                message("inspect.trajectory", **values), trajectory, (), figures,
                "certify {file} --program program.toml --out certificate",
            )  # fmt: skip
    if suffix in (".csv", ".parquet"):
        with suppress(LMeasureError):
            counts = read_counts(path)
            what = message("inspect.counts", file=path, channels=tuple(counts.channels), samples=len(counts.time_s))
            return Content(what, counts, (), {"samples": float(len(counts.time_s))})
    if suffix == ".csv":
        for angles in CONVENTIONS:
            with suppress(LMeasureError):
                poses = read_poses(path, angles, positions_alone=True)
                what = message("inspect.poses", file=path, poses=len(poses))
                following = "capture rig.toml --poses {file} --bus socketcan:can0 --out campaign"
                return Content(what, poses, (), {"poses": float(len(poses))}, following)
    raise _unknown(path)


def _log(path: Path, progress: Progress) -> Content:
    from lmeasure.acquisition import scan_log

    scan = scan_log(path, steps(progress, "bytes"))
    counters = sum(len(c.counters) for c in scan.carried)
    frames = sum(c.frames for c in scan.carried)
    what = message("inspect.log", file=path, dialect=scan.dialect, frames=frames, seconds=scan.lasts_s, counters=counters)
    figures = {"frames": float(frames), "counter_like": float(counters)}
    return Content(what, scan, tuple(scan.lines()), figures, "import {file} --rig rig.toml --out run")


def _document(path: Path) -> Any:
    """Return the content of a .json file; FileFormatError where it is none."""
    from lmeasure.io import read_regular

    try:
        return json.loads(read_regular(path, 10**8))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(message("error.is_not_json", where=path, error=error)) from None


def _unknown(path: Path) -> FileFormatError:
    return FileFormatError(message("error.is_no_file_of_lmeasure", where=path))


FOLDERS: dict[str, Reader] = {
    "run.toml": _run,
    "certificate.json": _certificate,
    "calibration.json": _calibration,
    "identified.json": _identification,
    "reference_poses.csv": _campaign,
}
"""Files that decide the kind of a folder."""
SUFFIXES: dict[str, Reader] = {".nc": _zone, ".json": _json, ".rrd": _recording, ".xml": _dcc, ".zip": _certificate}
DOCUMENTS = ("structure", "scenario", "placement", "details", "report", "drum")
"""Kinds of .toml files that are shown as they are."""


class ViewSettings(CommandSettings):
    NEXT: ClassVar[str] = "workbench my-cell"
    recording: Annotated[Path, option("Recording from an option --rerun, or from the demo.", metavar="FILE.rrd", positional=True)]
    web: Annotated[
        bool, option("Serve rerun's web viewer to browsers of this machine, without a display; stop with Ctrl-C.", flag="--web")
    ] = False
    port: Annotated[int | None, option("Port of 127.0.0.1 for --web; 0 takes a free one. [9090]", ge=0, le=65535)] = None


def has_display() -> bool:
    """Return whether this machine can show a window."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@workflow
def run_view(settings: ViewSettings, progress: Progress = silent) -> Result:
    """Open the viewer, or serve it to browsers where this machine has no display; progress gets the address."""
    if settings.web or settings.port is not None or not has_display():
        from lmeasure.view import serve

        serve(settings.recording, 9090 if settings.port is None else settings.port, lambda text: progress(0.0, text))
    else:
        from lmeasure.view import open_viewer

        open_viewer(settings.recording)
    return Result(None, ())
