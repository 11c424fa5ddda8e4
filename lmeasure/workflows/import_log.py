"""From log files of CAN frames to a run folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from lmeasure.errors import SettingsError
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import RERUN, Asked, Paths, Recording, option

if TYPE_CHECKING:
    from lmeasure.acquisition.import_log import Imported
    from lmeasure.start import StatedStart


class Settings(Asked):
    """What `lmeasure import` is asked."""

    logs: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option("Log of each pass: .blf, .asc, .log, .txt, .trc, .csv (all also .gz), .mf4 (extra mf4).", metavar="LOG...", positional=True),
    ]
    rig: Annotated[Path, option("rig.toml; its [can] table says which frames carry the counters.")]
    out: Annotated[Path, option("Run folder to write.", metavar="RUN")]
    start: Annotated[Path | None, option("File with the start pose as table start, such as a run.toml.")] = None
    position_mm: Annotated[tuple[float, float, float] | None, option("Start position, instead of --start.", metavar="X Y Z")] = None
    quaternion_xyzw: Annotated[tuple[float, float, float, float] | None, option("Start orientation.", metavar="X Y Z W")] = None
    dbc: Annotated[Path | None, option("DBC file that names the counters; default the rig's.")] = None
    bus: Annotated[str | None, option("Read only this bus of the log.")] = None
    parquet: Annotated[bool, option("Write the counts as .parquet instead of .csv.")] = False
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        """A run folder from logs, a rig, a start and a DBC file."""
        ends = (".csv", ".parquet", ".events.csv")
        passes = inside(self.out, *(f"pass{n}{end}" for n in range(1, len(self.logs) + 1) for end in ends))
        return Paths((*in_run_folder(self.out), *passes, *present(self.rerun)), (*self.logs, self.rig, *present(self.start, self.dbc)))


@workflow("import")
def run(settings: Settings, progress: Progress = silent) -> "Result[Imported]":
    """Read the logs and write the run folder."""
    from lmeasure.acquisition.import_log import import_logs, with_dbc, write_import
    from lmeasure.run import read_linked_rig
    from lmeasure.start import start_of_rig, start_uncertainty

    stated = _start(settings)
    rig, calibration = read_linked_rig(settings.rig)
    pose = None if stated is None else start_of_rig(stated.table, rig, stated.source)
    u_start = (0.0, 0.0) if stated is None else start_uncertainty(stated.table, stated.source)
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
    write_import(settings.out, imported, ".parquet" if settings.parquet else ".csv")
    if settings.rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(settings.rerun, imported.run.rig, run=imported.run)
    missing = "note: no start pose: where the tool started is unknown; "
    missing += f"state [start] in {settings.out / 'run.toml'} before poses are wanted"
    notes = (missing,) if pose is None else ()
    return Result(imported, (*imported.summary().splitlines(), *notes), warnings=notes)


def _start(settings: Settings) -> "StatedStart | None":
    from lmeasure.start import StatedStart, start_from

    position, turn = settings.position_mm, settings.quaternion_xyzw
    if (settings.start is not None and position is not None) or (position is None) != (turn is None):
        raise SettingsError("", "give the start pose either by --start or by --position-mm and --quaternion-xyzw")
    if settings.start is not None:
        return start_from(settings.start)
    if position is None or turn is None:
        return None
    return StatedStart({"position_mm": list(position), "quaternion_xyzw": list(turn)}, "--position-mm, --quaternion-xyzw")
