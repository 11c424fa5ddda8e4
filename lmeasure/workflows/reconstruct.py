"""From a run folder to a trajectory."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from lmeasure.core import SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, in_run_folder, present, silent, steps, workflow
from lmeasure.workflows.settings import RERUN, START, Paths, Recording, Start, Writing, option

if TYPE_CHECKING:
    from lmeasure.recording import Run, RunHead
    from lmeasure.trajectory import Each, Summary, Trajectory


FIRST_PART = "part-00000.parquet"


class Settings(Writing):
    """Settings of `lmeasure reconstruct`."""

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
        """A trajectory from a run folder."""
        out = self.out if self.scheduler is None else self.parts / FIRST_PART
        return Paths(
            (out, *((self.curve,) if self.continuous else ()), *present(self.rerun)),
            (*in_run_folder(self.run), *present(self.rig, None if self.start is None else Path(self.start))),
        )


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Trajectory | Summary]":
    """Reconstruct and write, piece by piece where the run can be: then what was made is a summary, as the whole is held nowhere."""
    from lmeasure.api import explained
    from lmeasure.recording import read_run, read_run_head, stated_start
    from lmeasure.trajectory import can_stream, reconstruct, reconstruct_stream

    stated = None if settings.start is None else stated_start(settings.start)
    head = read_run_head(settings.run, settings.rig, stated)
    named = head.rig.angles if settings.angles else None
    linear = settings.uncertainty == "linear"
    if settings.continuous and not (linear and settings.repeatability_mm == 0.0):
        raise SettingsError("continuous", message("curve.linear"))
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
        from lmeasure.trajectory import reconstruct_curve, write_curve

        trajectory, curve = reconstruct_curve(recorded, settings.constraint, judge=explained)
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


def _in_parts(settings: Settings, head: "RunHead", progress: Progress, *, whole: bool) -> "Result[Trajectory | Summary]":
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


def _written(settings: Settings, recorded: "Run", trajectory: "Trajectory", progress: Progress) -> "Result[Trajectory | Summary]":
    """Write a trajectory that is whole in memory, and the recording that is asked for."""
    from lmeasure.trajectory import write_trajectory

    progress(1.0, "reconstruct")
    write_trajectory(settings.out, trajectory, recorded.rig.angles if settings.angles else None)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, recorded.rig, run=recorded, trajectory=trajectory)
    return Result(trajectory, tuple(trajectory.summary().splitlines()), trajectory.overview().figures())


def _each_piece(rerun: Path | None, head: "RunHead") -> AbstractContextManager["Each | None"]:
    """Return what takes the pieces of a run into the recording that is asked for, if one is."""
    if rerun is None:
        return nullcontext()
    from lmeasure.view import streamed_recording

    return streamed_recording(rerun, head)
