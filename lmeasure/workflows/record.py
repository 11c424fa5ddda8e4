"""Recording: from a CAN bus to a run folder."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from lmeasure.core import GeometryError, LMeasureError, RigError, SettingsError, TrajectoryError
from lmeasure.text import count_of, joined, message, reason
from lmeasure.workflows.flow import Ending, Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import RERUN, RIG, START, CommandSettings, Paths, Recording, Start, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.acquisition import Ask, Check, LiveIdentifier, Progress as State, Samples
    from lmeasure.trajectory import PoseWatch

    Show = Callable[[State, PoseWatch | str], None]
    """Takes the state of a recording, and where its poses are, or why there are none."""


LAG = option(
    "Also show the pose and the speed of a smooth curve, so many seconds behind. It averages rounding of the counts.", ge=0.001, unit="s"
)


class RecordSettings(Writing):
    rig: Annotated[Path, RIG]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, replay:FILE, ...", metavar="INTERFACE:CHANNEL")]
    out: Annotated[Path, option("Run folder to write.", metavar="RUN")]
    seconds: Annotated[float | None, option("Stop after this time; default with Ctrl-C.", ge=0.001, unit="s")] = None
    start: Annotated[Start | None, option(f"Pose at zeroing of the counters: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    passage: Annotated[int, option("Number of the repetition of the motion; all passes use one run folder.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    fast: Annotated[bool, option("replay: run as fast as possible instead of in real time.")] = False
    live: Annotated[bool, option("Show counts, speeds, the pose, faults and latency live; --rerun then grows too.")] = False
    lag_s: Annotated[float | None, LAG] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        return then("reconstruct {out} --out {out}/trajectory.parquet" + ("" if self.start else " --start X,Y,Z,O,A,T"), out=self.out)

    def paths(self) -> Paths:
        return Paths(present(self.rerun), (self.rig,))


@workflow
def run_record(settings: RecordSettings, progress: Progress = silent, show: "Show | None" = None) -> Result:
    """Record a pass. show gets its state all the while with `live`. A recording that ends early is kept, and a failure."""
    from lmeasure.acquisition import record_session

    pose = pose_watch(settings.rig, settings.start, settings.passage, settings.lag_s) if settings.live else ""
    ending = Ending(progress)
    noted: list[str] = []
    with _growing(settings) as growing:
        takers = [taker for taker in (None if isinstance(pose, str) else pose, growing) if taker is not None]

        def each(samples: "Samples") -> None:
            for taker in takers:
                taker(samples)

        def reported(state: "State") -> None:
            if settings.live and show is not None:
                show(state, pose)
            ending(state.seconds, settings.seconds, f"{state.samples} samples")

        def said(note: str) -> None:
            noted.append(note)
            progress(0.0, note)

        before = _files(settings.out)
        recording = record_session(
            settings.rig,
            settings.bus,
            settings.out,
            seconds=settings.seconds,
            start=settings.start,
            passage=settings.passage,
            options=settings.bus_option,
            paced=not settings.fast,
            show=None if show is None and progress is silent else reported,
            each=each,
            stop=lambda: ending.ended,
            say=said,
        )
    ended = recording.ended
    if ended == "complete" and settings.rerun is not None:
        from lmeasure.rig import read_rig
        from lmeasure.view import write_counts_recording

        passes = [recording.folder / f"pass{i}.csv" for i in range(1, settings.passage + 1)]
        write_counts_recording(settings.rerun, read_rig(settings.rig), passes)
    notes = (*noted, *((_missing(settings),) if settings.start is None and settings.passage == 1 else ()))
    early = "" if ended == "complete" else message("workflow.ended_early", folder=settings.out, why=ended)
    figures = {"samples": float(recording.samples), "frames": float(recording.frames), "duration_s": recording.seconds}
    figures |= {"faults": float(sum(recording.faults.values()))} | {f"closure_{c}_counts": v for c, v in recording.closure.items()}
    made = tuple(path for path, changed in _files(settings.out).items() if before.get(path) != changed)
    return Result(recording, (*recording.summary().splitlines(), *notes), figures, notes, failure=early, files=made)


def _files(folder: Path) -> dict[Path, int]:
    """The files of a run folder, and when each was written last: a later pass joins those of the first."""
    return {path: path.stat().st_mtime_ns for path in sorted(folder.glob("*")) if path.is_file()}


def _missing(settings: RecordSettings) -> str:
    """Return the messages about a run without a start."""
    from lmeasure.rig import read_rig
    from lmeasure.trajectory import enough_absolute

    if enough_absolute(read_rig(settings.rig)):
        return message("workflow.note_absolute")
    where = settings.out / "run.toml"
    return message("workflow.note_no_start_pose", where=where)


def pose_watch(rig: Path, start: str | None, passage: int, lag_s: float | None = None) -> "PoseWatch | str":
    """Return the follower of a pass's poses for a rig's file from a start, compiled before the bus is opened, or the reason for none.
    lag_s: of a curve that it follows too."""
    from lmeasure.recording import Run, start_from_text
    from lmeasure.rig import read_linked_rig
    from lmeasure.trajectory import CurveStream, LivePose, PoseWatch, enough_absolute

    measured, calibration = read_linked_rig(rig)
    if start is None and not enough_absolute(measured):
        return message("workflow.no_pose_where_tool")
    try:
        known = None if start is None else start_from_text(start, measured)
        live = LivePose(measured, known, calibration, aside=True)
        curve = None if lag_s is None else CurveStream(Run(measured, known, (), calibration), lag_s=lag_s)
    except (RigError, GeometryError, TrajectoryError) as error:
        return message("workflow.no_pose", error=error)
    if live.channels != tuple(measured.counters_of(passage)):
        return message("workflow.no_pose_channels")
    return PoseWatch(live, curve)


def _growing(settings: RecordSettings) -> "AbstractContextManager[Callable[[Samples], None] | None]":
    """Return the writer of samples into the recording for viewing, while it is live."""
    if settings.rerun is None or not settings.live:
        return nullcontext(None)
    from lmeasure.rig import read_rig
    from lmeasure.view import growing_counts

    return growing_counts(settings.rerun, tuple(read_rig(settings.rig).counters_of(settings.passage)), settings.passage)


class WatchSettings(CommandSettings):
    NEXT: ClassVar[str] = "record {rig} --bus {bus} --out run"
    rig: Annotated[Path, RIG]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, replay:FILE, ...", metavar="INTERFACE:CHANNEL")]
    seconds: Annotated[float | None, option("Stop after this time; default with Ctrl-C.", ge=0.001, unit="s")] = None
    start: Annotated[Start | None, option(f"Pose at zeroing of the counters: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    fast: Annotated[bool, option("replay: run as fast as possible instead of in real time.")] = False
    lag_s: Annotated[float | None, LAG] = None

    def paths(self) -> Paths:
        return Paths((), (self.rig,))


@workflow
def run_watch(settings: WatchSettings, progress: Progress = silent, show: "Show | None" = None) -> Result:
    """Watch until the time is over or the user ends it; show gets counts, speeds, faults and the pose all the while."""
    from lmeasure.acquisition import connect, options_from_text, watch
    from lmeasure.rig import read_linked_rig

    rig, _ = read_linked_rig(settings.rig)
    pose = pose_watch(settings.rig, settings.start, settings.passage, settings.lag_s)
    taker: Callable[[Samples], None] = (lambda samples: None) if isinstance(pose, str) else pose
    ending = Ending(progress)

    def reported(state: "State") -> None:
        if show is not None:
            show(state, pose)
        ending(state.seconds, settings.seconds, f"{state.samples} samples")

    options = options_from_text(settings.bus_option)
    link = connect(rig, settings.rig.parent, settings.bus, passage=settings.passage, options=options, paced=not settings.fast)
    try:
        last = watch(
            rig,
            link.source,
            link.fields,
            passage=settings.passage,
            seconds=settings.seconds,
            show=reported,
            each=taker,
            stop=lambda: ending.ended,
        )
    finally:
        link.source.close()
    faults = tuple(count_of(kind, n) for kind, n in sorted(last.faults.items())) or message("acquisition.no_faults")
    line = message("workflows.samples_from_frames_over", samples=last.samples, frames=last.frames, seconds=last.seconds, faults=faults)
    figures = {"samples": float(last.samples), "frames": float(last.frames), "frames_lost": float(last.lost)}
    return Result(last, (line,), figures | {"faults": float(sum(last.faults.values()))})


class ScanSettings(CommandSettings):
    bus: Annotated[str | None, option("Listen to this bus; without it, `scan` lists the adapters.", metavar="INTERFACE:CHANNEL")] = None
    seconds: Annotated[float, option("Listening time.", ge=0.1, le=3600, unit="s")] = 5.0
    bit_rate: Annotated[int | None, option("Bit rate of the bus, if the adapter needs it.", ge=1, unit="bit/s")] = None
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()

    def following(self) -> str:
        return then("scan --bus socketcan:can0") if self.bus is None else then("check rig.toml --bus {bus}", bus=self.bus)

    def paths(self) -> Paths:
        return Paths((), ())


@workflow
def run_scan(
    settings: ScanSettings, progress: Progress = silent, *, show: "Callable[[float, tuple[LiveIdentifier, ...]], None] | None" = None
) -> Result:
    """List adapters, or listen; show gets the senders all the while."""
    from lmeasure.acquisition import adapters, listen, open_source, options_from_text

    if settings.bus is None:
        if settings.bus_option or settings.bit_rate is not None:
            raise SettingsError("bus", message("error.is_missing_which_bus"))
        progress(0.0, "looking for adapters")
        found, unanswered = adapters()
        notes = tuple(message("workflows.driver_did_not_answer", name=name) for name in unanswered)
        lines = tuple(one.line() for one in found) or (message("workflow.no_adapter_found_interfaces"),)
        made = [{"bus": one.bus, "options": list(one.options), "about": one.about} for one in found]
        following = then("scan --bus {bus}", bus=found[0].bus) if found else ""
        return Result(made, (*lines, *notes), {"adapters": float(len(found))}, notes, next=following)
    ending = Ending(progress)

    def reported(seconds: float, spoken: "tuple[LiveIdentifier, ...]") -> None:
        if show is not None:
            show(seconds, spoken)
        ending(seconds, settings.seconds, "listening")

    source = open_source(settings.bus, settings.bit_rate, options_from_text(settings.bus_option))
    try:
        found_there = listen(source, settings.seconds, show=reported, stop=lambda: ending.ended)
    finally:
        source.close()
    heard: list[dict[str, Any]] = [
        {"identifier": c.name, "frames": c.frames, "rate_hz": c.rate_hz, "moves": [*(f.text for f in c.counters), *c.others]}
        for c in found_there.carried
    ]
    figures = {"identifiers": float(len(found_there.carried)), "counters": float(sum(len(c.counters) for c in found_there.carried))}
    return Result(heard, tuple(found_there.lines()), figures)


class CheckSettings(Writing):
    rig: Annotated[Path, RIG]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, ...", metavar="INTERFACE:CHANNEL")]
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    turns: Annotated[bool, option("Also count one turn of each drum.", flag="--turns/--no-turns")] = True
    write: Annotated[
        Path | None, option("Rig to write, with channels and signs as they are.", flag="--out", metavar="RIG.toml", also=("--write",))
    ] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        return then("plan-poses {rig} --poses 12 --box=-300:300,-300:300,-300:300 --out planned.csv", rig=self.write or self.rig)

    def paths(self) -> Paths:
        return Paths(present(self.write, self.rerun), (self.rig,))


@workflow
def run_check(settings: CheckSettings, progress: Progress = silent, *, ask: "Ask") -> Result:
    """Walk through the self-test: ask shows each request and returns when the user has done it; progress names the devices found. Faults
    are a failure."""
    from lmeasure.acquisition import connect, corrected, not_corrected, options_from_text, range_notes, self_test
    from lmeasure.io import files
    from lmeasure.rig import rig_from_dict

    document = files.read_toml(settings.rig)
    rig = rig_from_dict(document, str(settings.rig))
    link = connect(rig, settings.rig.parent, settings.bus, passage=settings.passage, options=options_from_text(settings.bus_option))
    try:
        for note in range_notes(rig, link.fields, settings.passage):
            progress(0.0, note)
        for device in link.devices:
            progress(0.0, ", ".join(f"{k} {v}" for k, v in device.identity().items()))
        result = self_test(rig, link, ask, passage=settings.passage, turns=settings.turns)
    finally:
        link.source.close()
    faults = result.all_faults
    if settings.rerun is not None:
        import numpy as np

        from lmeasure.view import Series, write_scene

        strokes = {c.cable: np.array([c.stroke_mm, c.slack_mm], dtype=np.float64) for c in result.cables}
        series = {(group, name): Series(v[i : i + 1]) for name, v in strokes.items() for i, group in enumerate(("stroke_mm", "slack_mm"))}
        write_scene(settings.rerun, rig.name, rig=rig, series=series, notes=[*faults, *result.notes])
    failure = message("workflow.faults", rig=settings.rig, count=len(faults), first=faults[0]) if faults else ""
    data, reported = corrected(document, result)
    left = () if settings.write is None else not_corrected(result)
    if settings.write is None:
        hint = (message("workflows.write_file_writes_rig", count=len(reported), what=joined(reported)),) if reported else ()
        return Result(result, (*result.notes, *hint), _figures(result), tuple(faults), failure=failure)
    content = document.holding(data)
    rig_from_dict(content, str(settings.write))
    try:
        files.rewrite_toml(settings.write, content)
    except LMeasureError as error:  # the user has completed the self-test: keep its results
        return Result(result, (*result.notes, *reported, *left), _figures(result), tuple(faults), failure=reason(error))
    code = "workflow.checked_again" if reported or left else "workflow.checked_nothing"
    lines = (*result.notes, *reported, *left, message(code, file=settings.write))
    return Result(result, lines, _figures(result), tuple(faults), failure=failure)


def _figures(result: "Check") -> dict[str, float]:
    """Return the numbers of the whole and of each cable."""
    found = {"rate_hz": result.rate_hz, "faults": float(len(result.all_faults))}
    for c in result.cables:
        shown = {"stroke_mm": c.stroke_mm, "slack_mm": c.slack_mm, "counts_per_turn": c.counts_per_turn}
        found |= {f"{c.cable}.{name}": value for name, value in shown.items() if value is not None}
    return found
