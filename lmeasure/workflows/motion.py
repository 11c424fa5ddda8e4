"""Velocity, acceleration and jerk of a trajectory."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, Paths, option

if TYPE_CHECKING:
    from lmeasure.trajectory.motion import Motion


class Settings(Asked):
    """What `lmeasure motion` is asked."""

    trajectory: Annotated[Path, option("Trajectory as `reconstruct` writes it.", metavar="TRAJECTORY", positional=True)]
    out: Annotated[Path, option("Motion to write, .parquet or .csv.")]
    half_width_s: Annotated[float, option("Half width of the window of the local cubics.", within=(0.0, 60.0))] = 0.02

    def paths(self) -> Paths:
        """A motion from a trajectory."""
        return Paths((self.out,), (self.trajectory,))


@workflow("motion")
def run(settings: Settings, progress: Progress = silent) -> "Result[Motion]":
    """Smooth the trajectory and write its motion."""
    import numpy as np

    from lmeasure.trajectory import read_trajectory
    from lmeasure.trajectory.motion import motion_of, write_motion

    progress(0.0, "motion")
    found = motion_of(read_trajectory(settings.trajectory), settings.half_width_s)
    progress(1.0, "motion")
    write_motion(settings.out, found)
    u = np.nanmedian(np.linalg.norm(found.u_velocity[:, 3:], axis=1))
    largest, u95 = found.largest_speed()
    way = float(np.nanmax(found.path_mm))
    told = (
        f"{len(found.time_s)} samples, window +-{found.half_width_s:g} s: path {way:.3f} mm, "
        f"speed up to {largest:.3f} +- {u95:.3f} mm/s (U95 of the largest; standard uncertainty of one {u:.3f} mm/s, of independent errors)"
    )
    notes = (f"note: {found.stamps.note}",) if found.stamps.note else ()
    return Result(found, (told, *notes), {"path_mm": way, "largest_speed_mm_s": largest, "u95_mm_s": u95}, notes)
