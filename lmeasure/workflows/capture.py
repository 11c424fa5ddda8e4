"""Reference poses counted over a bus, one after the other, into a calibration folder."""

import getpass
import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Protocol

from lmeasure.core import CancelledError, GeometryError, LMeasureError, SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import CommandSettings, Names, Paths, Start, option

if TYPE_CHECKING:
    from lmeasure.acquisition import Link, Progress as State
    from lmeasure.demo import PlayedCell
    from lmeasure.procedures import CaptureFolder, Session
    from lmeasure.rig import Rig


READING = "How a reading is taken"
KNOWN = "How well the poses are known"
QUESTIONS = {
    "u_position_mm": message("workflow.standard_uncertainty_each_coordinate"),
    "u_rotation_deg": message("workflow.standard_uncertainty_their_orientation"),
    "u_repeatability_mm": message("workflow.standard_deviation_robot_comes"),
}


class Keys(Protocol):
    """Lines that a user types."""

    def typed(self) -> list[str]:
        """Those since the last question."""

    @property
    def gone(self) -> bool:
        """Return whether there will be no more."""


class CaptureSettings(CommandSettings):
    NEXT: ClassVar[str] = "calibrate {out} --out calibrated"
    rig: Annotated[Path, option("Nominal rig.toml; its table [can] assigns frames to counters.", metavar="RIG", positional=True)]
    poses: Annotated[Path, option("Reference poses, as `plan-poses` writes them.", metavar="planned.csv")]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, replay:FILE, ...", metavar="INTERFACE:CHANNEL")]
    out: Annotated[Path, option("Calibration folder to write or continue.", metavar="FOLDER")]
    by: Annotated[
        Literal["key", "rest", "both"],
        option(
            "key: record with Enter; rest: record when the robot rests; both: the first with Enter, the others at rests near their pose.",
            panel=READING,
        ),
    ] = "both"
    dwell_s: Annotated[float, option("Averaging time of the counts.", ge=0.05, le=30, panel=READING)] = 1.0
    settle_s: Annotated[float, option("Rest time of the robot before the averaging.", ge=0, le=30, panel=READING)] = 0.3
    closure: Annotated[bool, option("Record the first pose again at the end.", flag="--closure/--no-closure", panel=READING)] = True
    u_position_mm: Annotated[float | None, option(f"{QUESTIONS['u_position_mm'].removesuffix(' [mm]')}.", ge=0, panel=KNOWN)] = None
    u_rotation_deg: Annotated[float | None, option(f"{QUESTIONS['u_rotation_deg'].removesuffix(' [degrees]')}.", ge=0, panel=KNOWN)] = None
    u_repeatability_mm: Annotated[float | None, option(f"{QUESTIONS['u_repeatability_mm'].removesuffix(' [mm]')}.", ge=0, panel=KNOWN)] = (
        None
    )
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    fast: Annotated[bool, option("replay: run as fast as possible instead of in real time.")] = False

    def paths(self) -> Paths:
        return Paths((), (self.rig, self.poses))


@workflow
def run_capture(
    settings: CaptureSettings,
    progress: Progress = silent,
    *,
    say: Callable[[str], None] = print,
    keys: Keys | None = None,
    ask: Callable[[str], str] | None = None,
    show: "Callable[[Session], None] | None" = None,
) -> Result:
    """Capture until all poses are read, or the user ends it; readings are kept, and the next call continues.

    say prints lines, keys gives typed lines (none without it), ask puts a question, show gets the state all the while. A source that ends
    too early, and counters that do not return, are failures.
    """
    from lmeasure.acquisition import as_mapped, connect, options_from_text, with_files_beside
    from lmeasure.procedures import Session, Settings as stage_Settings, open_folder
    from lmeasure.rig import read_rig

    rig, here = read_rig(settings.rig).model_copy(update={"calibration": None}), settings.rig.parent
    options = options_from_text(settings.bus_option)
    link = connect(rig, here, settings.bus, passage=settings.passage, options=options, paced=not settings.fast)
    try:
        kept, beside = with_files_beside(as_mapped(rig, link.fields), here)
        channels = tuple(f.channel for f in link.fields)
        folder = open_folder(settings.out, kept, channels, settings.passage, planned=settings.poses, beside=beside)
        _state_uncertainty(settings, folder, ask)
        how = stage_Settings(settings.by, settings.dwell_s, settings.settle_s, settings.closure)
        session = Session(folder, how, say)
        if keys is None:
            session.keys_are_gone()
        ended = "complete" if session.finished else _record(session, link, progress, keys, show)
    finally:
        link.source.close()
    return _result(session, ended)


def _state_uncertainty(settings: CaptureSettings, folder: "CaptureFolder", ask: Callable[[str], str] | None) -> None:
    """Take the uncertainties from the options, else from the file, else from the user's answers."""
    from lmeasure.procedures import UNCERTAINTIES

    stated = {name: value for name in UNCERTAINTIES if (value := getattr(settings, name)) is not None}
    poses = folder.poses
    if ask is not None and not folder.readings:
        open_ = {"u_position_mm": "position" in poses.absent, "u_rotation_deg": "rotation" in poses.absent}
        for name in (name for name, is_open in open_.items() if is_open and name not in stated):
            answer = _number(ask, message("workflows.enter_not_known", text=QUESTIONS[name]))
            if answer is not None:
                stated[name] = answer
        if "u_repeatability_mm" not in stated and any(open_.values()):
            answer = _number(ask, message("workflows.enter_not_known", text=QUESTIONS["u_repeatability_mm"]))
            if answer is not None:
                stated["u_repeatability_mm"] = answer
    if stated:
        folder.state_uncertainty(stated)


def _number(ask: Callable[[str], str], question: str) -> float | None:
    """Return the answer, repeating the question until it is a number that is not negative, or empty."""
    while True:
        answer = ask(question).strip().replace(",", ".")
        if not answer:
            return None
        try:
            value = float(answer)
        except ValueError:
            continue
        if 0.0 <= value < 1e6:
            return value


def _record(session: "Session", link: "Link", progress: Progress, keys: Keys | None, show: "Callable[[Session], None] | None") -> str:
    """Record frames while the session runs; return how the recording ended."""
    from lmeasure.acquisition import record

    folder = session.folder
    cables = tuple(c.model_copy(update={"passage": 1}) for c in folder.rig.cables_of(folder.passage))
    turning = {c.from_point for c in cables}
    swivels = tuple(s for s in folder.rig.swivel if s.point in turning and (s.cable is None or s.cable in [c.name for c in cables]))
    asked_to_end = False
    samples, since = 0, time.monotonic()

    def look(state: "State") -> None:
        nonlocal asked_to_end, samples, since
        if state.samples > samples:
            samples, since = state.samples, time.monotonic()
        behind = link.source.behind_s
        if link.source.timestamp_source in ("kernel", "host"):  # stamps of another clock show no latency
            behind = max(behind, state.latency_s or 0.0)
        for line in keys.typed() if keys is not None else ():
            session.behind_s = behind
            session.command(line, getattr(keys, "waited_s", 0.0))
        if keys is not None and keys.gone:
            session.keys_are_gone()
        session.look(state.events, time.monotonic() - since, behind)
        if show is not None:
            show(session)
        try:
            progress(len(folder.of_pass) / max(session.to_read, 1), "reading poses")
        except CancelledError:  # as Ctrl-C: readings are kept
            asked_to_end = True

    recording = record(
        folder.rig.model_copy(update={"cable": cables, "swivel": swivels}),  # a recording of its own, of one pass
        link.source,
        link.fields,
        folder.frames(session.recording),
        devices=[d.identity() for d in link.devices],
        show=look,
        each=session.feed,
        stop=lambda: session.finished or asked_to_end,
    )
    return recording.ended


def _result(session: "Session", ended: str) -> Result:
    folder, closure = session.folder, session.closure
    read = len({r.pose for r in folder.of_pass})
    lines: list[str] = [
        message("workflows.poses_read_readings", read=read, of=len(folder.poses), readings=len(folder.of_pass), folder=folder.path)
    ]
    figures: dict[str, float] = {"poses": float(read), "readings": float(len(folder.of_pass))}
    if session.worth is not None:
        figures |= {"directions_determined": float(session.worth.rank), "unknowns": float(session.worth.unknowns)}
        if session.worth.enough(read):
            figures |= {"u95_length_rms_mm": session.worth.rms_mm, "u95_length_worst_mm": session.worth.worst_mm}
    failure = ""
    if ended != "complete":
        failure = message("workflow.capture_lost", folder=folder.path, why=ended)
    elif not session.finished:
        failure = message("workflow.capture_ended", folder=folder.path, pose=session.goal)
    elif closure is not None and closure.lost:
        failure = message("workflow.capture_closure", folder=folder.path, channels=tuple(closure.lost))
    elif session.goal is not None:
        lines.append(message("workflow.same_command_goes"))
    there = tuple(sorted(path for path in folder.path.rglob("*") if path.is_file()))
    return Result(folder, tuple(lines), figures, tuple(folder.notes), failure=failure, files=there)


BUILT = "How the cell differs from its rig"
AT_ONCE_S = 0.02
"""Rows that are made at once, and how long a line waits at most."""
SILENT_S = 0.5
"""Time of silence required there before."""


def own_bus(folder: Path) -> str:
    """Return a bus of this machine for the simulated cell of a user's folder, so that two cells do not hear each other."""
    digest = hashlib.sha256(f"{getpass.getuser()}:{folder.resolve()}".encode()).digest()
    return f"udp_multicast:239.74.{1 + digest[0] % 250}.{1 + digest[1] % 250}"


class PlaySettings(CommandSettings):
    NEXT: ClassVar[str] = "init my-cell"
    rig: Annotated[Path, option("rig.toml with the measured dimensions of the cell.", metavar="RIG", positional=True)]
    bus: Annotated[
        str | None, option("CAN bus of this machine to send on; default an own bus of this folder.", metavar="INTERFACE:CHANNEL")
    ] = None
    poses: Annotated[Path | None, option("Poses for the line `go POSE`.", metavar="planned.csv")] = None
    commands: Annotated[
        Path | None, option("Commands for the line `run`, as `program` writes them; default a motion of six stops.", metavar="commands.csv")
    ] = None
    at: Annotated[
        Start | None,
        option("Home pose of the robot, in the form of --start of `record`; default the base frame's origin.", metavar="X,Y,Z,O,A,T"),
    ] = None
    rate_hz: Annotated[float, option("Samples per second.", ge=1, le=2000, unit="Hz")] = 200.0
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    off_mm: Annotated[
        float, option("Largest position error of the observation points relative to the rig file.", ge=0, le=500, panel=BUILT)
    ] = 5.0
    off_deg: Annotated[float, option("Largest angle error of the guides.", ge=0, le=20, panel=BUILT)] = 1.0
    u_position_mm: Annotated[float, option("Standard deviation of the robot's position, per coordinate.", ge=0, le=50, panel=BUILT)] = 0.02
    u_rotation_deg: Annotated[float, option("Standard deviation of its orientation, about each axis.", ge=0, le=10, panel=BUILT)] = 0.003
    exchange: Annotated[Names, option("Two channels with swapped encoders.", metavar="CHANNEL,CHANNEL", panel=BUILT)] = ()
    seed: Annotated[int, option("Seed of the simulated cell.", ge=0, panel=BUILT)] = 0

    def paths(self) -> Paths:
        return Paths((), (self.rig,))


@workflow
def run_play(
    settings: PlaySettings,
    progress: Progress = silent,
    *,
    say: Callable[[str], None] = print,
    keys: Keys | None = None,
    show: "Callable[[PlayedCell], None] | None" = None,
) -> Result:
    """Play until the typed lines end, or without keys until Ctrl-C. say prints lines, keys gives typed lines, show gets the state of the
    cell."""
    from lmeasure.acquisition import Pace, bus_opener, counter_fields, options_from_text, play
    from lmeasure.rig import read_rig

    rig, name = read_rig(settings.rig), settings.bus or own_bus(settings.rig.parent)
    cell = _cell(settings, rig, progress)
    fields = counter_fields(rig, settings.passage, settings.rig.parent)
    open_bus = bus_opener(name, rig.can_table.bit_rate, options_from_text(settings.bus_option))
    try:
        bus = open_bus()
    except Exception as error:  # each driver reports a missing device by another exception
        raise LMeasureError(
            message("error.cannot_be_opened", where=name, error=" ".join(str(error).split()) or type(error).__name__)
        ) from error
    if bus.recv(SILENT_S) is not None:
        bus.shutdown()
        raise LMeasureError(message("error.somebody_speaks_there_already", where=name))
    rows, pace = 0, Pace(settings.rate_hz)
    at_once = max(1, round(AT_ONCE_S * settings.rate_hz))
    say(message("workflows.speaks_samples_s", rig=rig.name, bus=name, rate=settings.rate_hz, channels=tuple(f.channel for f in fields)))
    try:
        while not (keys is not None and keys.gone):
            for line in keys.typed() if keys is not None else ():
                _do(cell, line, say)
            if show is not None:
                show(cell)
            try:
                progress(0.0, "playing")
            except CancelledError:
                break
            play(cell.take(at_once), fields, rig.can_table.sync_id, bus, pace=pace)
            rows += at_once
    finally:
        bus.shutdown()
    return Result(None, (message("workflows.samples_were_sent", rows=rows),), {"samples": float(rows)})


def _do(cell: "PlayedCell", line: str, say: Callable[[str], None]) -> None:
    if line.strip():
        try:
            say(cell.do(line))
        except LMeasureError as error:
            say(message("workflows.not_done", why=error))


def _cell(settings: PlaySettings, rig: "Rig", progress: Progress) -> "PlayedCell":
    import numpy as np

    from lmeasure.demo import Built, PlayedCell
    from lmeasure.recording import read_poses, start_from_text

    if settings.passage > rig.passes:
        raise SettingsError("passage", message("error.the_rig_has", where=settings.passage, passes=rig.passes))
    home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]) if settings.at is None else start_from_text(settings.at, rig)
    try:
        return PlayedCell(
            rig,
            home,
            settings.rate_hz,
            how=Built(settings.off_mm, settings.off_deg, settings.u_position_mm, settings.u_rotation_deg, settings.exchange),
            passage=settings.passage,
            poses=None if settings.poses is None else read_poses(settings.poses, rig.angles, positions_alone=True),
            commands=settings.commands,
            seed=settings.seed,
            progress=lambda done, of: progress(done / of, message("demo.runs_program")),
        )
    except GeometryError as error:
        raise LMeasureError(message("error.the_cell_cannot_be", where=settings.rig, error=error)) from error
