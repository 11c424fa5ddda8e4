"""`lmeasure motion`: velocity, acceleration and jerk of a trajectory."""

from pathlib import Path
from typing import Annotated

import typer


def motion(
    trajectory: Annotated[Path, typer.Argument(metavar="TRAJECTORY", help="Trajectory as `reconstruct` writes it.")],
    out: Annotated[Path, typer.Option("--out", help="Motion to write, .parquet or .csv.")],
    half_width_s: Annotated[float, typer.Option("--half-width-s", help="Half width of the window of the local cubics.")] = 0.02,
) -> None:
    """Smooth a trajectory by local cubics and write velocity, acceleration and jerk with their uncertainties."""
    import numpy as np

    from lmeasure.trajectory import read_trajectory
    from lmeasure.trajectory.motion import motion_of, write_motion

    found = motion_of(read_trajectory(trajectory), half_width_s)
    write_motion(out, found)
    u = np.nanmedian(np.linalg.norm(found.u_velocity[:, 3:], axis=1))
    largest, u95 = found.largest_speed()
    typer.echo(
        f"{len(found.time_s)} samples, window +-{found.half_width_s:g} s: path {np.nanmax(found.path_mm):.3f} mm, "
        f"speed up to {largest:.3f} +- {u95:.3f} mm/s (U95 of the largest; standard uncertainty of one {u:.3f} mm/s, of independent errors)"
    )
    if found.stamps.note:
        typer.echo(f"note: {found.stamps.note}")
