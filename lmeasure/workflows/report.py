"""The page of a trajectory: of a run, of a trajectory file, or of what another instrument measured."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from lmeasure.text import LANGUAGES, Versions, composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, workflow
from lmeasure.workflows.settings import (
    ALIGN,
    ANGLES,
    COLUMNS,
    LANGUAGE,
    START,
    U_POSITION,
    U_ROTATION,
    Paths,
    Start,
    Writing,
    notes_of_file,
    option,
    refuse,
    stated_beside,
    then,
)

if TYPE_CHECKING:
    from lmeasure.accuracy import Along
    from lmeasure.rig import Rig


class Settings(Writing):
    """Settings of `lmeasure report`."""

    measured: Annotated[
        Path,
        option(
            "Run folder, or trajectory from `reconstruct` or another instrument: .csv, .parquet, .tum, EuRoC.",
            metavar="RUN_OR_TRAJECTORY",
            positional=True,
        ),
    ]
    out: Annotated[Path, option("Folder for trajectory.html.", metavar="DIR")]
    rig: Annotated[Path | None, option("rig.toml to use instead of the run's own; with a trajectory: rig to draw.")] = None
    start: Annotated[Start | None, option(f"Start pose, instead of the run's: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    constraint: Annotated[str | None, option("Constraint of a run's tool if there are too few cables: planar or vertical-axis.")] = None
    columns: Annotated[str, COLUMNS] = ""
    u_position_mm: Annotated[float | None, U_POSITION] = None
    u_rotation_deg: Annotated[float | None, U_ROTATION] = None
    angles: Annotated[str | None, ANGLES] = None
    align: Annotated[Path | None, ALIGN] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def following(self) -> str:
        """Return the command that certifies a robot by the trajectory, or reconstructs that."""
        if self.measured.is_dir():
            return then("reconstruct {run} --out {run}/trajectory.parquet", run=self.measured)
        return then("certify {trajectory} --program program.toml --out certificate", trajectory=self.measured)

    def paths(self) -> Paths:
        """A page from a run or a trajectory."""
        start = None if self.start is None else Path(self.start)
        read = in_run_folder(self.measured) if self.measured.is_dir() else (self.measured,)
        return Paths(inside(self.out, "trajectory.html"), (*read, *present(self.rig, start, self.align)))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Along]":
    """Read or reconstruct the trajectory and write its page."""
    return write_report(settings, settings.out / "trajectory.html", progress)


def write_report(settings: Settings, page: Path, progress: Progress) -> "Result[Along]":
    """Read or reconstruct the trajectory and write this page."""
    from lmeasure.accuracy import along
    from lmeasure.api import explained
    from lmeasure.io import files
    from lmeasure.iso9283 import in_program_frame
    from lmeasure.recording import read_run, stated_start
    from lmeasure.report import trajectory_summary, write_trajectory_page
    from lmeasure.rig import read_linked_rig
    from lmeasure.trajectory import read_trajectory, reconstruct, stamps_of

    progress(0.0, "read")
    if settings.measured.is_dir():
        beside = ("columns", "u_position_mm", "u_rotation_deg", "angles", "align")
        refuse(settings, message("refuse.trajectory_file"), *beside)
        recorded = read_run(settings.measured, settings.rig, None if settings.start is None else stated_start(settings.start))
        progress(0.2, "reconstruct")
        rig: Rig | None = recorded.rig
        trajectory = reconstruct(recorded, settings.constraint, judge=explained)
        sources = [settings.measured / "run.toml", *(Path(c.source) for c in recorded.passes)]
    else:
        refuse(settings, message("refuse.run_folder"), "start", "constraint")
        trajectory = read_trajectory(settings.measured, stated_beside(settings))
        if settings.align is not None:
            trajectory = in_program_frame(trajectory, settings.align)
        rig = None if settings.rig is None else read_linked_rig(settings.rig)[0]
        sources = [settings.measured]
    progress(0.6, "report")
    found = along(trajectory)
    inputs = [(path.name, files.sha256(path)) for path in sources]
    name = settings.measured.resolve().name
    write_trajectory_page(page, name, found, rig, inputs=inputs, language=settings.language or of_terminal())
    progress(1.0, "report")
    rows = zip(*([f"{label}: {value}" for label, value in trajectory_summary(found, one)] for one in LANGUAGES), strict=True)
    reported = [composed("{row}", row=Versions(dict(zip(LANGUAGES, row, strict=True)))) for row in rows]
    figures = {"samples": float(len(trajectory.time_s)), "left_out": float(sum(s.samples for s in found.stretches if not s.ok))}
    if found.worst is not None:
        figures["worst_u95_position_mm"] = float(found.u95_mm[found.worst])
    if found.motion is not None:
        figures["largest_speed_mm_s"] = found.motion.largest_speed()[0]
    notes = () if settings.measured.is_dir() else (*trajectory.notes, *stamps_of(trajectory).notes)
    lines, warnings = notes_of_file(notes)
    return Result(found, (*reported, *lines, message("line.written", files=page)), figures, warnings)
