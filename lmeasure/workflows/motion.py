"""Velocity, acceleration and jerk of a trajectory."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.core import SettingsError, TrajectoryError
from lmeasure.text import composed, message
from lmeasure.workflows.flow import Progress, Result, in_run_folder, present, silent, workflow
from lmeasure.workflows.settings import (
    ALIGN,
    ANGLES,
    COLUMNS,
    RERUN,
    TRAJECTORY,
    U_POSITION,
    U_ROTATION,
    Paths,
    Recording,
    Writing,
    notes_of_file,
    option,
    refuse,
    stated_beside,
)

if TYPE_CHECKING:
    from lmeasure.trajectory import Motion, Vibration


FASTEST_MM_S = 1e5
"""No robot moves as fast: places or times are in other units."""


class Settings(Writing):
    """Settings of `lmeasure motion`."""

    NEXT: ClassVar[str] = "report {trajectory} --out report"
    OUT_FILE: ClassVar[str] = "motion.parquet"
    trajectory: Annotated[Path, option(TRAJECTORY, metavar="TRAJECTORY", positional=True)]
    out: Annotated[Path, option("Motion to write, .parquet or .csv.")]
    columns: Annotated[str, COLUMNS] = ""
    u_position_mm: Annotated[float | None, U_POSITION] = None
    u_rotation_deg: Annotated[float | None, U_ROTATION] = None
    run: Annotated[
        Path | None, option("Run folder of a trajectory from `reconstruct --continuous`: take the motion from its curve.", metavar="RUN")
    ] = None
    angles: Annotated[str | None, ANGLES] = None
    align: Annotated[Path | None, ALIGN] = None
    half_width_s: Annotated[
        float | None,
        option(
            "Half width of the window of the local cubics. [chosen by the data, at most 0.02 or what the sampling needs]",
            within=(0.0, 60.0),
        ),
    ] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        """A motion from a trajectory."""
        counts = () if self.run is None else in_run_folder(self.run)
        return Paths((self.out, *present(self.rerun)), (self.trajectory, *present(self.align), *counts))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Motion]":
    """Smooth the trajectory and write its motion."""
    import numpy as np

    from lmeasure.core import QUATERNION_COLUMNS
    from lmeasure.iso9283 import in_program_frame
    from lmeasure.recording import read_run
    from lmeasure.trajectory import motion_of, motion_of_curve, read_trajectory, reconstruct_curve, write_motion

    if settings.run is not None:
        beside = ("columns", "u_position_mm", "u_rotation_deg", "align", "half_width_s")
        refuse(settings, message("refuse.curve"), *beside)
    progress(0.0, "motion")
    trajectory = read_trajectory(settings.trajectory, stated_beside(settings))
    if settings.align is not None:
        trajectory = in_program_frame(trajectory, settings.align)
    lasts = float(np.ptp(trajectory.time_s))
    if settings.half_width_s is not None and settings.half_width_s > lasts > 0.0:
        raise SettingsError("half_width_s", message("error.s_to_either_side", half_width_s=settings.half_width_s, lasts=lasts))
    try:
        if settings.run is None:
            found = motion_of(trajectory, settings.half_width_s)
        else:
            of_run, curve = reconstruct_curve(read_run(settings.run))
            found = motion_of_curve(trajectory, curve, of_run)
    except TrajectoryError as error:
        raise TrajectoryError(composed("{where}: {error}", where=settings.trajectory, error=error)) from None
    progress(1.0, "motion")
    write_motion(settings.out, found)
    if settings.rerun is not None:
        from lmeasure.view import Series, write_scene

        columns, of = found.columns(), {"velocity": "v{}_mm_s", "acceleration": "a{}_mm_s2"}
        groups = {"speed": ["speed_mm_s"]} | {group: [name.format(axis) for axis in "xyz"] for group, name in of.items()}
        series = {(g, name): Series(columns[name], columns[f"u_{name}"], found.time_s) for g, names in groups.items() for name in names}
        write_scene(settings.rerun, settings.trajectory.name, moving=(found.time_s, found.poses), series=series)
    largest, u95 = found.largest_speed()
    way = float(np.nanmax(found.path_mm))
    reported: str = message(
        "workflows.samples_window_s_path" if settings.run is None else "workflows.samples_of_curve",
        samples=len(found.time_s),
        window=found.half_width_s,
        path=way,
        speed=largest,
    )
    figures = {"path_mm": way, "largest_speed_mm_s": largest, "half_width_s": found.half_width_s, "highest_hz": found.highest_hz}
    figures |= {f"vibration_{i}_{v.axis}_{name}": value for i, v in enumerate(found.vibration, 1) for name, value in v.values().items()}
    if "position" in trajectory.absent:
        reported = message("workflow.no_speed_uncertainty", what=reported)
    else:
        u = np.nanmedian(np.linalg.norm(found.u_velocity[:, 3:], axis=1))
        reported = message("workflow.speed_uncertainty", what=reported, u95=u95, u=u)
        figures["u95_mm_s"] = u95
    turned = not np.isnan(found.poses[:, 3:]).all()
    lines, warnings = notes_of_file((*trajectory.notes, *found.stamps.notes))
    notes = list[str]()
    if lost := int(np.isnan(trajectory.poses[:, 0]).sum()):
        notes.append(message("workflows.samples_have_no_pose", lost=lost, all=len(trajectory.time_s)))
    if largest > FASTEST_MM_S:
        notes.append(message("workflows.no_robot_moves_m", speed=largest / 1000.0))
    if not turned:
        notes.append(message("workflow.no_orientation", named=tuple(QUATERNION_COLUMNS)))
    above = () if settings.run is not None else (_above(found),)
    more = tuple(message("line.note", text=note) for note in notes)
    return Result(found, (reported, *map(_line, found.vibration), *above, *lines, *more), figures, (*warnings, *more))


def _line(v: "Vibration") -> str:
    """Return one vibration in words."""
    return message(
        "workflows.vibration_along_hz_amplitude",
        axis=v.axis,
        hz=v.frequency_hz,
        u_hz=v.u95_frequency_hz,
        um=1000.0 * v.amplitude_mm,
        u_um=1000.0 * v.u95_amplitude_mm,
        speed=v.speed_mm_s,
        u_speed=v.u95_speed_mm_s,
    )


def _above(found: "Motion") -> str:
    """Return the highest frequency that the samples show, in words."""
    return message("workflow.vibration_up_to" if found.vibration else "workflow.no_vibration_up_to", hz=found.highest_hz)
