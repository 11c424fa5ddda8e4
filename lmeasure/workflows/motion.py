"""Velocity, acceleration and jerk of a trajectory."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.core import SettingsError, TrajectoryError
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import (
    ALIGN,
    ANGLES,
    COLUMNS,
    TRAJECTORY,
    U_POSITION,
    U_ROTATION,
    Paths,
    Writing,
    notes_of_file,
    option,
    stated_beside,
)

if TYPE_CHECKING:
    from lmeasure.trajectory import Motion, Vibration


FASTEST_MM_S = 1e5
"""No robot moves as fast: places or times are in other units."""


class Settings(Writing):
    """What `lmeasure motion` is asked."""

    trajectory: Annotated[Path, option(TRAJECTORY, metavar="TRAJECTORY", positional=True)]
    out: Annotated[Path, option("Motion to write, .parquet or .csv.")]
    columns: Annotated[str, COLUMNS] = ""
    u_position_mm: Annotated[float | None, U_POSITION] = None
    u_rotation_deg: Annotated[float | None, U_ROTATION] = None
    angles: Annotated[str | None, ANGLES] = None
    align: Annotated[Path | None, ALIGN] = None
    half_width_s: Annotated[
        float | None,
        option(
            "Half width of the window of the local cubics. [chosen by the data, at most 0.02 or what the sampling needs]",
            within=(0.0, 60.0),
        ),
    ] = None

    def paths(self) -> Paths:
        """A motion from a trajectory."""
        return Paths((self.out,), (self.trajectory, *present(self.align)))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Motion]":
    """Smooth the trajectory and write its motion."""
    import numpy as np

    from lmeasure.core import QUATERNION_COLUMNS
    from lmeasure.iso9283 import in_program_frame
    from lmeasure.trajectory import motion_of, read_trajectory, write_motion

    progress(0.0, "motion")
    trajectory = read_trajectory(settings.trajectory, stated_beside(settings))
    if settings.align is not None:
        trajectory = in_program_frame(trajectory, settings.align)
    lasts = float(np.ptp(trajectory.time_s))
    if settings.half_width_s is not None and settings.half_width_s > lasts > 0.0:
        raise SettingsError("half_width_s", f"{settings.half_width_s:g} s to either side of a trajectory that lasts {lasts:.6g} s")
    try:
        found = motion_of(trajectory, settings.half_width_s)
    except TrajectoryError as error:
        raise TrajectoryError(f"{settings.trajectory}: {error}") from None
    progress(1.0, "motion")
    write_motion(settings.out, found)
    largest, u95 = found.largest_speed()
    way = float(np.nanmax(found.path_mm))
    told = f"{len(found.time_s)} samples, window +-{found.half_width_s:g} s: path {way:.3f} mm, speed up to {largest:.3f}"
    figures = {"path_mm": way, "largest_speed_mm_s": largest, "half_width_s": found.half_width_s, "highest_hz": found.highest_hz}
    figures |= {f"vibration_{i}_{v.axis}_{name}": value for i, v in enumerate(found.vibration, 1) for name, value in v.values().items()}
    if "position" in trajectory.absent:
        told += " mm/s; no uncertainty is stated: state it by columns or --u-position-mm"
    else:
        u = np.nanmedian(np.linalg.norm(found.u_velocity[:, 3:], axis=1))
        told += f" +- {u95:.3f} mm/s (U95 of the largest; standard uncertainty of one {u:.3f} mm/s)"
        figures["u95_mm_s"] = u95
    turned = not np.isnan(found.poses[:, 3:]).all()
    lines, warnings = notes_of_file((*trajectory.notes, *found.stamps.notes))
    notes = list[str]()
    if lost := int(np.isnan(trajectory.poses[:, 0]).sum()):
        notes.append(f"{lost} of {len(trajectory.time_s)} samples have no pose: motion is told where the window holds enough others")
    if largest > FASTEST_MM_S:
        notes.append(f"no robot moves at {largest / 1e3:.0f} m/s: places or times are in other units than stated")
    if not turned:
        named = f"{', '.join(QUATERNION_COLUMNS[:-1])} and {QUATERNION_COLUMNS[-1]}, or the angles of a controller"
        notes.append(f"the orientation is not measured, or not under known names ({named}): nothing is said of rotations")
    more = tuple(f"note: {note}" for note in notes)
    return Result(found, (told, *map(_line, found.vibration), _above(found), *lines, *more), figures, (*warnings, *more))


def _line(v: "Vibration") -> str:
    """Return one vibration in words."""
    return (
        f"vibration along {v.axis}: {v.frequency_hz:.3f} +- {v.u95_frequency_hz:.3f} Hz, amplitude {1e3 * v.amplitude_mm:.2f} +- "
        f"{1e3 * v.u95_amplitude_mm:.2f} um, {v.speed_mm_s:.3f} +- {v.u95_speed_mm_s:.3f} mm/s (U95)"
    )


def _above(found: "Motion") -> str:
    """Return the highest frequency that the samples show, in words."""
    none = "" if found.vibration else "no vibration found; "
    return f"{none}the samples show vibration up to {found.highest_hz:.4g} Hz, and nothing is stated about faster motion"
