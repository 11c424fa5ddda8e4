"""`lmeasure import`: from log files of CAN frames to a run folder."""

from pathlib import Path
from typing import Annotated

import typer

from lmeasure.cli.options import Rerun


def import_(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="Log of each pass: .blf, .asc, .log, .txt, .trc, .csv (all also .gz), .mf4 (extra mf4)."),
    ],
    rig: Annotated[Path, typer.Option("--rig", help="rig.toml; its [can] table says which frames carry the counters.")],
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Run folder to write.")],
    start: Annotated[Path | None, typer.Option("--start", help="File with the start pose as table start, such as a run.toml.")] = None,
    position_mm: Annotated[
        tuple[float, float, float] | None, typer.Option("--position-mm", metavar="X Y Z", help="Start position, instead of --start.")
    ] = None,
    quaternion_xyzw: Annotated[
        tuple[float, float, float, float] | None, typer.Option("--quaternion-xyzw", metavar="X Y Z W", help="Start orientation.")
    ] = None,
    dbc: Annotated[Path | None, typer.Option("--dbc", help="DBC file that names the counters; default the rig's.")] = None,
    bus: Annotated[str | None, typer.Option("--bus", help="Read only this bus of the log.")] = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write the counts as .parquet instead of .csv.")] = False,
    rerun: Rerun = None,
) -> None:
    """Read log files of CAN frames into a run folder.

    The start pose, at which the counters were zeroed, stands in no log: give it by --start FILE, or by --position-mm and --quaternion-xyzw;
    without them it is unknown, and poses can be had only when it is stated later.
    """
    if (start is not None and position_mm is not None) or (position_mm is None) != (quaternion_xyzw is None):
        raise typer.BadParameter("give the start pose either by --start or by --position-mm and --quaternion-xyzw")

    from lmeasure.acquisition.import_log import import_logs, with_dbc, write_import
    from lmeasure.cli.progress import bar
    from lmeasure.run import read_linked_rig
    from lmeasure.start import StatedStart, start_from, start_of_rig, start_uncertainty

    measured, calibration = read_linked_rig(rig)
    pose, stated = None, None
    u_start: tuple[float, ...] = (0.0, 0.0)
    if start is not None:
        stated = start_from(start)
    elif position_mm is not None:
        table = {"position_mm": list(position_mm), "quaternion_xyzw": list(quaternion_xyzw or ())}
        stated = StatedStart(table, "--position-mm, --quaternion-xyzw")
    if stated is not None:
        pose, u_start = start_of_rig(stated.table, measured, stated.source), start_uncertainty(stated.table, stated.source)
    if dbc is not None:
        measured = with_dbc(measured, dbc)
    with bar("bytes") as progress:
        imported = import_logs(
            logs, measured, pose, calibration=calibration, u_start=u_start, folder=rig.parent, bus=bus, progress=progress
        )
    write_import(out, imported, ".parquet" if parquet else ".csv")
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, imported.run.rig, run=imported.run)
    typer.echo(imported.summary())
    if pose is None:
        typer.echo(f"note: no start pose: where the tool started is unknown; state [start] in {out / 'run.toml'} before poses are wanted")
