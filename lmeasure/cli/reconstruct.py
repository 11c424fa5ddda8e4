"""`lmeasure reconstruct`: from a run folder to a trajectory."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmeasure.cli.options import Rerun

if TYPE_CHECKING:
    from lmeasure.run import RunHead
    from lmeasure.trajectory.stream import Each


def reconstruct(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder: run.toml, rig.toml and the counts of each pass.")],
    out: Annotated[Path, typer.Option("--out", help="Trajectory to write: .parquet, .csv, .tum for the poses alone, .mcap for ROS 2.")],
    rig: Annotated[Path | None, typer.Option("--rig", help="Use this rig.toml instead of the run's own.")] = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--start", metavar="X,Y,Z,QX,QY,QZ,QW|FILE", help="Start pose, or a file with it as table start, instead of the run's."
        ),
    ] = None,
    constraint: Annotated[
        str | None, typer.Option("--constraint", help="What holds the tool where cables are too few: planar or vertical-axis.")
    ] = None,
    repeatability_mm: Annotated[
        float, typer.Option("--repeatability-mm", min=0.0, help="Standard deviation per axis of the robot between repeated passes.")
    ] = 0.0,
    uncertainty: Annotated[
        str, typer.Option("--uncertainty", help="linear, or monte-carlo: the run again and again with its inputs drawn (JCGM 101).")
    ] = "linear",
    trials: Annotated[int, typer.Option("--trials", min=2, help="Trials of monte-carlo.")] = 400,
    seed: Annotated[int, typer.Option("--seed", help="Seed of monte-carlo.")] = 0,
    angles: Annotated[bool, typer.Option("--angles", help="Add the angles of the rig's convention.")] = False,
    rerun: Rerun = None,
) -> None:
    """Reconstruct the gripper's trajectory from recorded counts, with its uncertainty, by the screw method."""
    from lmeasure.cli.progress import bar
    from lmeasure.run import read_run, read_run_head
    from lmeasure.start import stated_start
    from lmeasure.trajectory import can_stream, reconstruct_stream, write_trajectory
    from lmeasure.trajectory import reconstruct as stage

    if uncertainty not in ("linear", "monte-carlo"):
        raise typer.BadParameter(f"{uncertainty!r} is neither linear nor monte-carlo", param_hint="--uncertainty")
    stated = None if start is None else stated_start(start)
    head = read_run_head(run, rig, stated)
    named = head.rig.angles if angles else None
    if can_stream(head) and uncertainty == "linear":
        with _each_piece(rerun, head) as each, bar("reconstruct") as progress:
            summary = reconstruct_stream(head, out, constraint, named, progress, each)
        typer.echo(summary.text())
        return
    recorded = read_run(run, rig, stated)
    if uncertainty == "linear":
        trajectory = stage(recorded, constraint, repeatability_mm)
    else:
        with bar("monte-carlo") as progress:
            trajectory = stage(recorded, constraint, repeatability_mm, trials, seed, progress)
    write_trajectory(out, trajectory, named)
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, recorded.rig, run=recorded, trajectory=trajectory)
    typer.echo(trajectory.summary())


def _each_piece(rerun: Path | None, head: "RunHead") -> AbstractContextManager["Each | None"]:
    """What takes the pieces of a run into the recording that is asked for, if one is."""
    if rerun is None:
        return nullcontext()
    from lmeasure.view.stages import streamed_recording

    return streamed_recording(rerun, head)
