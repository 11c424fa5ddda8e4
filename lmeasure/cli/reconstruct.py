"""`lmeasure reconstruct`: from a run folder to a trajectory."""

from pathlib import Path
from typing import Annotated

import typer

from lmeasure.cli.options import Rerun


def reconstruct(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder: run.toml, rig.toml and the counts of each pass.")],
    out: Annotated[Path, typer.Option("--out", help="Trajectory to write, .parquet or .csv.")],
    rig: Annotated[Path | None, typer.Option("--rig", help="Use this rig.toml instead of the run's own.")] = None,
    constraint: Annotated[
        str | None, typer.Option("--constraint", help="What holds the tool where cables are too few: planar or vertical-axis.")
    ] = None,
    rerun: Rerun = None,
) -> None:
    """Reconstruct the gripper's trajectory from recorded counts, with its uncertainty, by the screw method."""
    from lmeasure.run import read_run
    from lmeasure.trajectory import reconstruct as stage
    from lmeasure.trajectory import write_trajectory

    recorded = read_run(run, rig)
    trajectory = stage(recorded, constraint)
    write_trajectory(out, trajectory)
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, recorded.rig, run=recorded, trajectory=trajectory)
    typer.echo(trajectory.summary())
