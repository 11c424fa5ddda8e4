"""`lmeasure zone`: where in the cell the instrument can be believed."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmeasure.cli.options import Rerun

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from lmeasure.arrays import FloatArray

RANGE = "START:STOP:STEP"
LIMITS = "Limits"
COMPUTING = "Computing"


def zone(
    rig: Annotated[Path, typer.Argument(metavar="RIG.toml", help="The rig; a linked calibration enters the uncertainty.")],
    x: Annotated[str, typer.Option("--x", metavar=RANGE, help="Nodes of the tool origin along X [mm], both ends included.")],
    y: Annotated[str, typer.Option("--y", metavar=RANGE, help="The same along Y.")],
    z: Annotated[str, typer.Option("--z", metavar=RANGE, help="The same along Z.")],
    out: Annotated[Path, typer.Option("--out", help="netCDF file to write.")],
    tilt_rad: Annotated[float, typer.Option("--tilt-rad", help="Largest component of the rotation vector [rad].")] = 0.0,
    tilt_steps: Annotated[int, typer.Option("--tilt-steps", min=1, help="Equal steps from -tilt to +tilt; 1 means no tilt.")] = 3,
    quaternion: Annotated[str | None, typer.Option("--quaternion", metavar="X,Y,Z,W", help="Orientation that is tilted.")] = None,
    o: Annotated[
        str | None, typer.Option("--o", metavar=RANGE, help="Angle O of the thesis [deg], with --a and --t, instead of tilts.")
    ] = None,
    a: Annotated[str | None, typer.Option("--a", metavar=RANGE, help="Angle A [deg].")] = None,
    t: Annotated[str | None, typer.Option("--t", metavar=RANGE, help="Angle T [deg].")] = None,
    limit_deg: Annotated[float, typer.Option("--limit-deg", help="Largest pressure angle.", rich_help_panel=LIMITS)] = 60.0,
    length_mm: Annotated[str | None, typer.Option("--length-mm", metavar="MIN:MAX", help="Cable lengths.", rich_help_panel=LIMITS)] = None,
    u95_mm: Annotated[float | None, typer.Option("--u95-mm", help="95 % radius of the position.", rich_help_panel=LIMITS)] = None,
    u95_rotation_deg: Annotated[
        float | None, typer.Option("--u95-rotation-deg", help="95 % radius of the orientation.", rich_help_panel=LIMITS)
    ] = None,
    u95_attachment_mm: Annotated[
        float | None, typer.Option("--u95-attachment-mm", help="95 % radius of the worst attachment point.", rich_help_panel=LIMITS)
    ] = None,
    wrap_deg: Annotated[float | None, typer.Option("--wrap-deg", help="Angle wrapped around a pulley.", rich_help_panel=LIMITS)] = None,
    clearance_mm: Annotated[
        float | None, typer.Option("--clearance-mm", help="Least distance of cables from each other and bodies.", rich_help_panel=LIMITS)
    ] = None,
    bodies: Annotated[
        Path | None, typer.Option("--bodies", metavar="FILE.toml", help="Bodies the cables must not touch.", rich_help_panel=LIMITS)
    ] = None,
    one_assembly: Annotated[bool, typer.Option("--one-assembly", help="Keep the determinant's sign.", rich_help_panel=LIMITS)] = False,
    singularity: Annotated[
        float | None, typer.Option("--singularity", help="Least distance to a singular pose.", rich_help_panel=LIMITS)
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Map orientation and attachment points too.", rich_help_panel=COMPUTING)] = False,
    refine: Annotated[
        float | None,
        typer.Option("--refine", metavar="RELATIVE", help="Refine the edge until the volume changes by less.", rich_help_panel=COMPUTING),
    ] = None,
    workers: Annotated[int | None, typer.Option("--workers", min=1, help="Threads; default all cores.", rich_help_panel=COMPUTING)] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="dask scheduler to use.", rich_help_panel=COMPUTING)
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", metavar="DIR", help="Keep chunks here; go on after a kill.", rich_help_panel=COMPUTING)
    ] = None,
    path: Annotated[
        Path | None, typer.Option("--path", metavar="PROGRAM.toml", help="Hold a robot program against the zone; writes OUT.path.csv too.")
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="DIR", help="Write zone.html and zone.pdf into this folder.")] = None,
    rerun: Rerun = None,
) -> None:
    """Map where every pressure angle stays within the limit, and the 95 % radius of the measured position."""
    from lmeasure.accuracy.bodies import read_bodies
    from lmeasure.accuracy.limits import Limits
    from lmeasure.accuracy.zone import scan_zone
    from lmeasure.accuracy.zone_dataset import summary, write_zone
    from lmeasure.cli.progress import bar
    from lmeasure.program import read_program
    from lmeasure.run import read_linked_rig

    spans = {name: _numbers(name, text, ":", 3) for name, text in (("--x", x), ("--y", y), ("--z", z))}
    nodes = [_axis(name, span) for name, span in spans.items()]
    rotations = _oat(o, a, t) if o or a or t else _tilts(tilt_rad, tilt_steps, quaternion)
    lengths = None if length_mm is None else _numbers("--length-mm", length_mm, ":", 2)
    limits = Limits(
        limit_deg,
        None if lengths is None else (lengths[0], lengths[1]),
        u95_mm,
        u95_rotation_deg,
        u95_attachment_mm,
        wrap_deg,
        clearance_mm,
        one_assembly,
        singularity,
    )
    if (o or a or t) and (tilt_rad or quaternion):
        raise typer.BadParameter("give either --o, --a and --t or --tilt-rad and --quaternion", param_hint="--tilt-rad")
    linked, calibration = read_linked_rig(rig)
    program = None if path is None else read_program(path)
    options: dict[str, Any] = {
        "limits": limits,
        "full": full or report is not None,
        "bodies": () if bodies is None else read_bodies(bodies),
        "spacing_mm": (spans["--x"][2], spans["--y"][2], spans["--z"][2]),
        "workers": workers,
        "scheduler": scheduler,
        "checkpoint": checkpoint,
        "refine": refine,
    }
    with bar("zone") as progress:
        data = scan_zone(linked, calibration, nodes[0], nodes[1], nodes[2], rotations, progress=progress, **options)
    write_zone(out, data)
    if report is not None:
        from lmeasure.report.zone import write_zone_report

        write_zone_report(report, data, linked)
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, linked, zone=data)
    typer.echo(summary(data))
    if program is not None:
        from lmeasure import files
        from lmeasure.accuracy.guard import columns, guard

        parts = guard(linked, calibration, data, program, rotations.mean())
        files.write_table(out.with_suffix(".path.csv"), columns(parts))
        typer.echo("\n".join(part.line() for part in parts))


def _tilts(tilt_rad: float, steps: int, quaternion: str | None) -> "Rotation":
    from scipy.spatial.transform import Rotation

    from lmeasure.accuracy.zone import tilts

    if quaternion is None:
        return tilts(tilt_rad, steps)
    values = _numbers("--quaternion", quaternion, ",", 4)
    if not abs(sum(v * v for v in values) - 1.0) < 1e-3:
        raise typer.BadParameter(f"{quaternion!r} is not a unit quaternion x,y,z,w", param_hint="--quaternion")
    return tilts(tilt_rad, steps, Rotation.from_quat(values))


def _oat(*texts: str | None) -> "Rotation":
    import numpy as np

    from lmeasure.accuracy.zone import MAX_ORIENTATIONS
    from lmeasure.conventions import rotation_from_angles

    values = []
    for name, text in zip(("--o", "--a", "--t"), texts, strict=True):
        if text is None:
            raise typer.BadParameter("give --o, --a and --t together", param_hint=name)
        values.append(_axis(name, _numbers(name, text, ":", 3)))
    if math.prod(map(len, values)) > MAX_ORIENTATIONS:
        raise typer.BadParameter(f"more than {MAX_ORIENTATIONS} orientations", param_hint="--o")
    return rotation_from_angles("puma-oat", np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, 3))


def _axis(name: str, span: tuple[float, ...]) -> "FloatArray":
    from lmeasure.accuracy.zone import axis
    from lmeasure.errors import AccuracyError

    try:
        return axis(*span)
    except AccuracyError as error:
        raise typer.BadParameter(str(error), param_hint=name) from None


def _numbers(name: str, text: str, separator: str, count: int) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = ()
    if len(values) != count:
        raise typer.BadParameter(f"{text!r} is not {count} numbers with {separator!r} between them", param_hint=name)
    return values
