"""From a CAN bus to a run folder."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.core import GeometryError, RigError, TrajectoryError
from lmeasure.text import message
from lmeasure.workflows.flow import Ending, Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import RERUN, RIG, START, Paths, Recording, Start, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.acquisition import Progress as State, Recording as Recorded, Samples
    from lmeasure.trajectory import PoseWatch

    Show = Callable[[State, PoseWatch | str], None]
    """Takes the state of a recording, and where its poses are, or why there are none."""


class Settings(Writing):
    """Settings of `lmeasure record`."""

    rig: Annotated[Path, RIG]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, replay:FILE, ...", metavar="INTERFACE:CHANNEL")]
    out: Annotated[Path, option("Run folder to write.", metavar="RUN")]
    seconds: Annotated[float | None, option("Stop after this time; default with Ctrl-C.", ge=0.001, unit="s")] = None
    start: Annotated[Start | None, option(f"Pose at zeroing of the counters: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    passage: Annotated[int, option("Number of the repetition of the motion; all passes use one run folder.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    fast: Annotated[bool, option("replay: run as fast as possible instead of in real time.")] = False
    live: Annotated[bool, option("Show counts, speeds, the pose, faults and latency live; --rerun then grows too.")] = False
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        """Return the command that reconstructs the motion."""
        return then("reconstruct {out} --out {out}/trajectory.parquet" + ("" if self.start else " --start X,Y,Z,O,A,T"), out=self.out)

    def paths(self) -> Paths:
        """The recording to look at. That of the bus needs a folder without a run: nothing in it is ever written over."""
        return Paths(present(self.rerun), (self.rig,))


@workflow
def run(settings: Settings, progress: Progress = silent, show: "Show | None" = None) -> "Result[Recorded]":
    """Record a pass. show is given of it all the while, where `live` is asked for. A recording that ends early is kept, and a failure."""
    from lmeasure.acquisition import record_session

    pose = pose_watch(settings.rig, settings.start, settings.passage) if settings.live else ""
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
            stop=lambda: ending.asked,
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


def _missing(settings: Settings) -> str:
    """Return what is said of a run without a start."""
    from lmeasure.rig import read_rig
    from lmeasure.trajectory import enough_absolute

    if enough_absolute(read_rig(settings.rig)):
        return message("workflow.note_absolute")
    where = settings.out / "run.toml"
    return message("workflow.note_no_start_pose", where=where)


def pose_watch(rig: Path, start: str | None, passage: int) -> "PoseWatch | str":
    """Return what follows the poses of a pass of a rig's file from a start, compiled before the bus is opened, or why there are none."""
    from lmeasure.recording import start_from_text
    from lmeasure.rig import read_linked_rig
    from lmeasure.trajectory import LivePose, PoseWatch, enough_absolute

    measured, calibration = read_linked_rig(rig)
    if start is None and not enough_absolute(measured):
        return message("workflow.no_pose_where_tool")
    try:
        known = None if start is None else start_from_text(start, measured)
        live = LivePose(measured, known, calibration, aside=True)
    except (RigError, GeometryError, TrajectoryError) as error:
        return message("workflow.no_pose", error=str(error))
    if live.channels != tuple(measured.counters_of(passage)):
        return message("workflow.no_pose_channels")
    return PoseWatch(live)


def _growing(settings: Settings) -> "AbstractContextManager[Callable[[Samples], None] | None]":
    """Return what takes the samples into the recording to look at, while it is live."""
    if settings.rerun is None or not settings.live:
        return nullcontext(None)
    from lmeasure.rig import read_rig
    from lmeasure.view import growing_counts

    return growing_counts(settings.rerun, tuple(read_rig(settings.rig).counters_of(settings.passage)), settings.passage)
