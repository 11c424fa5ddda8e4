"""Reconstruction: from a run folder to a trajectory."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from lmeasure.core import SettingsError, TrajectoryError, pasted
from lmeasure.text import Say, composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import (
    ALIGN,
    ANGLES,
    BROWSER,
    COLUMNS,
    RERUN,
    START,
    TRAJECTORY,
    U_POSITION,
    U_ROTATION,
    Paths,
    Point,
    Quaternion,
    Recording,
    Start,
    Writing,
    notes_of_file,
    option,
    refuse,
    stated_beside,
    then,
)

if TYPE_CHECKING:
    from lmeasure.recording import Run, RunHead, StatedStart
    from lmeasure.trajectory import Each, Motion, Trajectory, Vibration


FIRST_PART = "part-00000.parquet"


class ReconstructSettings(Writing):
    NEXT: ClassVar[str] = "report {out} --out report"
    OUT_FILE: ClassVar[str] = "trajectory.parquet"
    run: Annotated[Path, option("Run folder: run.toml, rig.toml and the counts of each pass.", metavar="RUN", positional=True)]
    out: Annotated[Path, option("Trajectory to write: .parquet, .csv, .tum for the poses alone, .mcap for ROS 2.")]
    rig: Annotated[Path | None, option("rig.toml to use instead of the run's own.")] = None
    start: Annotated[Start | None, option(f"Start pose, instead of the run's: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    constraint: Annotated[str | None, option("Constraint of the tool if there are too few cables: planar or vertical-axis.")] = None
    repeatability_mm: Annotated[float, option("Standard deviation of the robot between passes, per axis.", ge=0.0)] = 0.0
    uncertainty: Annotated[
        Literal["linear", "monte-carlo"], option("Method: linear, or monte-carlo, which repeats the run with random inputs (JCGM 101).")
    ] = "linear"
    trials: Annotated[int, option("Number of trials of monte-carlo.", ge=2)] = 400
    seed: Annotated[int, option("Seed of monte-carlo.")] = 0
    continuous: Annotated[
        bool, option("Fit a curve in continuous time to all readings, each at its own time, and write its control poses beside OUT.")
    ] = False
    joints: Annotated[
        Path | None,
        option("Joint log of the robot (time_s, joint_1_deg, ...) as a prior of the curve's shape; with --robot.", metavar="LOG.csv"),
    ] = None
    robot: Annotated[str | None, option("Robot of --joints: a name (such as ur5) or a robot.toml.", metavar="NAME_OR_FILE")] = None
    angles: Annotated[bool, option("Add the angles of the rig's convention.")] = False
    scheduler: Annotated[
        str | None, option("Reconstruct a long run in parts by a Dask scheduler, or local; OUT is a folder.", metavar="tcp://HOST:PORT")
    ] = None
    rerun: Annotated[Recording | None, RERUN] = None

    @property
    def curve(self) -> Path:
        """Return the file of the curve's control poses."""
        return self.out.with_suffix(".curve" + (self.out.suffix if self.out.suffix in {".csv", ".parquet"} else ".parquet"))

    @property
    def parts(self) -> Path:
        """Return the folder of a trajectory in parts: OUT, which may be there already with its parts."""
        return self.out.parent if (self.out.parent / FIRST_PART).is_file() else self.out

    def paths(self) -> Paths:
        out = self.out if self.scheduler is None else self.parts / FIRST_PART
        return Paths(
            (out, *((self.curve,) if self.continuous else ()), *present(self.rerun)),
            (*in_run_folder(self.run), *present(self.rig, None if self.start is None else Path(self.start), self.joints)),
        )


@workflow
def run_reconstruct(settings: ReconstructSettings, progress: Progress = silent) -> Result:
    """Reconstruct and write, piece by piece if possible: then the result is a summary, as the whole is never in memory."""
    from lmeasure.api import explained, reconstruct_curve
    from lmeasure.recording import read_run, read_run_head, stated_start
    from lmeasure.trajectory import can_stream, reconstruct, reconstruct_stream

    stated = None if settings.start is None else stated_start(settings.start)
    head = read_run_head(settings.run, settings.rig, stated)
    named = head.rig.angles if settings.angles else None
    linear = settings.uncertainty == "linear"
    if settings.continuous and not (linear and settings.repeatability_mm == 0.0):
        raise SettingsError("continuous", message("curve.linear"))
    check_joints(settings.joints, settings.robot, continuous=settings.continuous)
    progress(0.0, "reconstruct")
    if settings.scheduler is not None:
        return _in_parts(settings, head, progress, whole=can_stream(head) and linear and not settings.continuous)
    if can_stream(head) and linear and not settings.continuous:
        with _each_piece(settings.rerun, head) as each:
            reported = steps(progress, "reconstruct")
            summary = reconstruct_stream(head, settings.out, settings.constraint, named, progress=reported, each=each, judge=explained)
        return Result(summary, tuple(summary.text().splitlines()), summary.figures())
    recorded = read_run(settings.run, settings.rig, stated)
    if settings.continuous:
        from lmeasure.trajectory import write_curve
        from lmeasure.workflows.identify import nominal

        robot = None if settings.robot is None else nominal(settings.robot).model
        trajectory, curve = reconstruct_curve(recorded, settings.constraint, joints=settings.joints, robot=robot)
        write_curve(settings.curve, curve)
        return _written(settings, recorded, trajectory, progress)
    trajectory = reconstruct(
        recorded,
        settings.constraint,
        settings.repeatability_mm,
        trials=0 if linear else settings.trials,
        seed=0 if linear else settings.seed,
        progress=None if linear else steps(progress, "monte-carlo"),
        judge=explained,
    )
    return _written(settings, recorded, trajectory, progress)


def check_joints(joints: Path | None, robot: str | None, *, continuous: bool) -> None:
    """Check that a joint log comes with a robot, and both with a curve; SettingsError."""
    for name, value, needed in (("joints", joints, robot), ("robot", robot, joints)):
        if value is not None and (needed is None or not continuous):
            raise SettingsError(name, message("curve.log_options"))


def _in_parts(settings: ReconstructSettings, head: "RunHead", progress: Progress, *, whole: bool) -> Result:
    """Reconstruct a long run by the workers of a scheduler, into files of a folder."""
    from lmeasure.api import explained
    from lmeasure.trajectory import reconstruct_in_parts

    if not whole or settings.rerun is not None or settings.repeatability_mm:
        raise SettingsError("scheduler", message("error.parts_not_possible"))
    out = settings.parts.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for earlier in out.glob("part-*.parquet"):
        earlier.unlink()
    named = head.rig.angles if settings.angles else None
    reported = steps(progress, "reconstruct")
    summary = reconstruct_in_parts(
        head, out, settings.scheduler or "", settings.constraint, angles=named, progress=reported, judge=explained
    )
    return Result(summary, tuple(summary.text().splitlines()), summary.figures(), files=tuple(sorted(out.glob("part-*.parquet"))))


def _written(settings: ReconstructSettings, recorded: "Run", trajectory: "Trajectory", progress: Progress) -> Result:
    """Write a trajectory that is whole in memory, and the requested recording."""
    from lmeasure.trajectory import write_trajectory

    progress(1.0, "reconstruct")
    write_trajectory(settings.out, trajectory, recorded.rig.angles if settings.angles else None)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, recorded.rig, run=recorded, trajectory=trajectory)
    return Result(trajectory, tuple(trajectory.summary().splitlines()), trajectory.overview().figures())


def _each_piece(rerun: Path | None, head: "RunHead") -> AbstractContextManager["Each | None"]:
    """Return the writer of a run's pieces into the requested recording, if any."""
    if rerun is None:
        return nullcontext()
    from lmeasure.view import streamed_recording

    return streamed_recording(rerun, head)


FASTEST_MM_S = 1e5
"""No robot moves as fast: places or times are in other units."""


class MotionSettings(Writing):
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
        counts = () if self.run is None else in_run_folder(self.run)
        return Paths((self.out, *present(self.rerun)), (self.trajectory, *present(self.align), *counts))


@workflow
def run_motion(settings: MotionSettings, progress: Progress = silent) -> Result:
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


class ImportSettings(Writing):
    logs: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option("Log of each pass: .blf, .asc, .log, .txt, .trc, .csv (all also .gz), .mf4 (extra mf4).", metavar="LOG...", positional=True),
    ]
    rig: Annotated[Path | None, option("rig.toml; its table [can] assigns frames to counters.")] = None
    out: Annotated[Path | None, option("Run folder to write.", metavar="RUN")] = None
    scan: Annotated[bool, option("List the contents of the logs and suggest a table [can], without writing files.", flag="--scan")] = False
    report: Annotated[Path | None, option("With --scan: page to write, with counts over time.", metavar="FILE.html")] = None
    browser: Annotated[bool, BROWSER] = True
    start: Annotated[Start | None, option(f"Start pose: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    position_mm: Annotated[Point | None, option("Start position; use it with --quaternion-xyzw instead of --start.", metavar="X,Y,Z")] = (
        None
    )
    quaternion_xyzw: Annotated[Quaternion | None, option("Start orientation.", metavar="X,Y,Z,W")] = None
    dbc: Annotated[Path | None, option("DBC file with the counters; default the rig's.")] = None
    bus: Annotated[str | None, option("Read only this bus of the log.")] = None
    parquet: Annotated[bool, option("Write the counts as .parquet instead of .csv.")] = False
    rerun: Annotated[Recording | None, RERUN] = None

    @model_validator(mode="after")
    def _check_rig_and_out(self) -> Self:
        if not self.scan and self.rig is None:
            raise SettingsError("rig", message("error.is_missing_without_one", logs=pasted(self.logs[0])))
        if not self.scan and self.out is None:
            raise SettingsError("out", message("error.is_missing"))
        if self.report is not None and not self.scan:
            raise SettingsError("report", message("error.goes_with_scan"))
        return self

    def following(self) -> str:
        if self.out is None or self.scan:
            return then("import {log} --rig rig.toml --out run", log=self.logs[0])
        known = self.start is not None or self.position_mm is not None
        return then("reconstruct {out} --out {out}/trajectory.parquet" + ("" if known else " --start X,Y,Z,O,A,T"), out=self.out)

    def paths(self) -> Paths:
        if self.out is None:
            return Paths(present(self.rerun, self.report), (*self.logs, *present(self.rig, self.dbc)))
        start = () if self.start is None or not Path(self.start).is_file() else (Path(self.start),)
        ends = (".parquet" if self.parquet else ".csv", ".events.csv")
        passes = inside(self.out, *(f"pass{n}{end}" for n in range(1, len(self.logs) + 1) for end in ends))
        run = inside(self.out, "run.toml", "rig.toml", "calibration.json")
        return Paths((*run, *passes, *present(self.rerun, self.report)), (*self.logs, *start, *present(self.rig, self.dbc)))


@workflow
def run_import(settings: ImportSettings, progress: Progress = silent) -> Result:
    """Read the logs and write the run folder, or only print their content."""
    if settings.scan:
        return _scanned(settings, progress)
    assert settings.rig is not None
    assert settings.out is not None
    from lmeasure.acquisition import import_logs, with_dbc, write_import
    from lmeasure.recording import start_of_rig, start_uncertainty
    from lmeasure.rig import read_linked_rig

    stated = _start(settings)
    rig, calibration = read_linked_rig(settings.rig)
    pose = None if stated is None else start_of_rig(stated.table, rig, stated.source)
    u_start = (None, None) if stated is None else start_uncertainty(stated.table, stated.source)
    if settings.dbc is not None:
        rig = with_dbc(rig, settings.dbc)
    imported = import_logs(
        settings.logs,
        rig,
        pose,
        calibration=calibration,
        u_start=u_start,
        folder=settings.rig.parent,
        bus=settings.bus,
        progress=steps(progress, "bytes"),
    )
    write_import(settings.out, imported, ".parquet" if settings.parquet else ".csv", force=settings.force)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, imported.run.rig, run=imported.run)
    notes = (message("workflow.note_no_start", where=str(settings.out / "run.toml")),) if pose is None else ()
    logs = imported.logs
    unread = tuple(composed("{file}: {note}", file=str(log.path), note=note) for log in logs for note in log.report.notes())
    figures: dict[str, float] = {"frames": sum(log.report.frames for log in logs), "samples": sum(log.samples for log in logs)}
    figures |= {"duration_s": max(log.seconds for log in logs), "faults": sum(log.events.tally.total() for log in logs)}
    figures |= {"lines": sum(log.report.total for log in logs), "known": sum(log.report.known for log in logs)}
    figures |= {"unread": sum(log.report.unread for log in logs)}
    return Result(imported, (*imported.summary().splitlines(), *notes), figures, (*unread, *notes))


def _scanned(settings: ImportSettings, progress: Progress) -> Result:
    from lmeasure.acquisition import scan_log

    found = tuple(scan_log(log, steps(progress, "bytes")) for log in settings.logs)
    lines = [line for scan in found for line in scan.lines()]
    counters = sum(len(c.counters) for scan in found for c in scan.carried)
    notes = tuple(composed("{file}: {note}", file=str(scan.path), note=note) for scan in found for note in scan.notes)
    figures = {"identifiers": float(sum(len(s.carried) for s in found)), "counter_like": float(counters)}
    if settings.report is not None:
        from lmeasure.report import scans_figure, write_inspection_page

        what = message("inspect.logs", files=tuple(str(log) for log in settings.logs), counters=counters)
        write_inspection_page(
            settings.report,
            settings.logs[0].name,
            what,
            lines=lines,
            figure=scans_figure(found, Say(of_terminal())),
            language=of_terminal(),
        )
    return Result(found, tuple(lines), figures, notes, page=settings.report)


def _start(settings: ImportSettings) -> "StatedStart | None":
    from lmeasure.recording import StatedStart, stated_start

    position, turn = settings.position_mm, settings.quaternion_xyzw
    if settings.start is not None and (position is not None or turn is not None):
        raise SettingsError("start", message("error.is_given_and_so"))
    if position is not None and turn is None:
        raise SettingsError("position_mm", message("error.half_a_start_pose"))
    if turn is not None and position is None:
        raise SettingsError("quaternion_xyzw", message("error.states_half_of_the"))
    if settings.start is not None:
        return stated_start(settings.start)
    if position is None or turn is None:
        return None
    return StatedStart({"position_mm": list(position), "quaternion_xyzw": list(turn)}, "--position-mm, --quaternion-xyzw")
