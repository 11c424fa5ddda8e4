"""`lmeasure record`: from a CAN bus to a run folder."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmeasure.cli.options import Rerun

if TYPE_CHECKING:
    from lmeasure.acquisition.recorder import Progress
    from lmeasure.acquisition.samples import Samples
    from lmeasure.trajectory.live import PoseWatch


def record(
    rig: Annotated[Path, typer.Option("--rig", help="rig.toml; its [can] table says which frames carry the counters.")],
    bus: Annotated[
        str,
        typer.Option("--bus", metavar="INTERFACE:CHANNEL", help="socketcan:can0, slcan:/dev/ttyACM0, replay:FILE, ..."),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Run folder to write.")],
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.001, help="Stop after this time; else with Ctrl-C.")] = None,
    start: Annotated[
        str | None, typer.Option("--start", metavar="X,Y,Z,QX,QY,QZ,QW", help="Pose at which the counters were zeroed, mm and quaternion.")
    ] = None,
    passage: Annotated[int, typer.Option("--pass", min=1, help="Which repetition of the motion; later ones join the same run folder.")] = 1,
    option: Annotated[
        list[str] | None, typer.Option("--bus-option", metavar="KEY=VALUE", help="Handed to the interface, such as host=... and port=...")
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="replay: as fast as possible, not in the log's own time.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show counts, speeds, the pose, faults and latency while recording; --rerun grows then too.")
    ] = False,
    rerun: Rerun = None,
) -> None:
    """Record a pass of the motion: every frame as it came, and the counts decoded from it."""
    from lmeasure.acquisition.session import record_session
    from lmeasure.errors import AcquisitionError

    pose = _pose(rig, start, passage) if live else None
    with _display(pose) as show, _growing(rerun if live else None, rig, passage) as growing:
        takers = [taker for taker in (None if isinstance(pose, str) else pose, growing) if taker is not None]

        def each(samples: "Samples") -> None:
            for taker in takers:
                taker(samples)

        recording = record_session(
            rig, bus, out, seconds=seconds, start=start, passage=passage, options=option or [], paced=not fast, show=show, each=each
        )
    typer.echo(recording.summary())
    if start is None and passage == 1:
        typer.echo(f"note: no --start pose: where the tool started is unknown; state [start] in {out / 'run.toml'} before poses are wanted")
    if recording.ended != "complete":
        raise AcquisitionError(f"{out}: ended early, what came before is kept: {recording.ended}")
    if rerun is not None:
        from lmeasure.rig import read_rig
        from lmeasure.view.stages import write_counts_recording

        write_counts_recording(rerun, read_rig(rig), [recording.folder / f"pass{i}.csv" for i in range(1, passage + 1)])


def _pose(rig: Path, start: str | None, passage: int) -> "PoseWatch | str":
    """What follows the poses, compiled before the bus is opened, or why there are none."""
    if start is None:
        return "no pose: where the tool starts is unknown without --start"
    from lmeasure.acquisition.session import pose_from_text
    from lmeasure.errors import GeometryError, RigError, TrajectoryError
    from lmeasure.rig import read_rig
    from lmeasure.trajectory.live import LivePose, PoseWatch

    measured = read_rig(rig)
    try:
        live = LivePose(measured, pose_from_text(start))
    except (RigError, GeometryError, TrajectoryError) as error:
        return f"no pose: {error}"
    if live.channels != tuple(measured.drums_of(passage)):
        return "no pose: the channels are not those of the cables"
    return PoseWatch(live)


def _display(pose: "PoseWatch | str | None") -> "AbstractContextManager[Callable[[Progress], None] | None]":
    if pose is not None:
        from lmeasure.cli.live import live_table

        return live_table(pose)
    return nullcontext(None)


def _growing(rerun: Path | None, rig: Path, passage: int) -> "AbstractContextManager[Callable[[Samples], None] | None]":
    if rerun is None:
        return nullcontext(None)
    from lmeasure.rig import read_rig
    from lmeasure.view.live import growing_counts

    return growing_counts(rerun, tuple(read_rig(rig).drums_of(passage)), passage)
