"""Display of a bus, before anything is recorded."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.text import count_of, message
from lmeasure.workflows.flow import Ending, Progress, Result, silent, workflow
from lmeasure.workflows.record import pose_watch
from lmeasure.workflows.settings import RIG, START, Asked, Paths, Start, option

if TYPE_CHECKING:
    from lmeasure.acquisition import Progress as State, Samples
    from lmeasure.trajectory import PoseWatch

    Show = Callable[[State, PoseWatch | str], None]
    """Takes the state of things, and where the poses are, or why there are none."""


class Settings(Asked):
    """Settings of `lmeasure watch`."""

    NEXT: ClassVar[str] = "record {rig} --bus {bus} --out run"
    rig: Annotated[Path, RIG]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, replay:FILE, ...", metavar="INTERFACE:CHANNEL")]
    seconds: Annotated[float | None, option("Stop after this time; default with Ctrl-C.", ge=0.001, unit="s")] = None
    start: Annotated[Start | None, option(f"Pose at zeroing of the counters: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    fast: Annotated[bool, option("replay: run as fast as possible instead of in real time.")] = False

    def paths(self) -> Paths:
        """It writes nothing."""
        return Paths((), (self.rig,))


@workflow
def run(settings: Settings, progress: Progress = silent, show: "Show | None" = None) -> "Result[State]":
    """Watch until the time is over or somebody ends it; show is given of counts, speeds, faults and the pose all the while."""
    from lmeasure.acquisition import connect, options_from_text, watch
    from lmeasure.rig import read_linked_rig

    rig, _ = read_linked_rig(settings.rig)
    pose = pose_watch(settings.rig, settings.start, settings.passage)
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
            stop=lambda: ending.asked,
        )
    finally:
        link.source.close()
    faults = tuple(count_of(kind, n) for kind, n in sorted(last.faults.items())) or message("acquisition.no_faults")
    line = message("workflows.samples_from_frames_over", samples=last.samples, frames=last.frames, seconds=last.seconds, faults=faults)
    figures = {"samples": float(last.samples), "frames": float(last.frames), "frames_lost": float(last.lost)}
    return Result(last, (line,), figures | {"faults": float(sum(last.faults.values()))})
