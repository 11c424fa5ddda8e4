"""`lmeasure zone`: where in the cell the instrument can be believed."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmeasure.cli.options import Rerun

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

RANGE = "START:STOP:STEP"


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
    limit_deg: Annotated[float, typer.Option("--limit-deg", help="Largest pressure angle allowed.")] = 60.0,
    length_mm: Annotated[str | None, typer.Option("--length-mm", metavar="MIN:MAX", help="Cable lengths allowed.")] = None,
    u95_mm: Annotated[float | None, typer.Option("--u95-mm", help="Largest 95 % radius of the position allowed.")] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="DIR", help="Write the page into this folder.")] = None,
    rerun: Rerun = None,
) -> None:
    """Map where every pressure angle stays within the limit, and the 95 % radius of the measured position."""
    from lmeasure.accuracy.zone import scan_zone, summary, write_zone
    from lmeasure.cli.progress import bar
    from lmeasure.run import read_linked_rig

    spans = {name: _numbers(name, text, ":", 3) for name, text in (("--x", x), ("--y", y), ("--z", z))}
    rotations = _oat(o, a, t) if o or a or t else _tilts(tilt_rad, tilt_steps, quaternion)
    lengths = None if length_mm is None else _numbers("--length-mm", length_mm, ":", 2)
    nodes = [_axis(name, span) for name, span in spans.items()]
    linked, calibration = read_linked_rig(rig)
    with bar("zone") as progress:
        data = scan_zone(
            linked,
            calibration,
            nodes[0],
            nodes[1],
            nodes[2],
            rotations,
            limit_deg,
            None if lengths is None else (lengths[0], lengths[1]),
            progress,
            u95_limit_mm=u95_mm,
            spacing_mm=(spans["--x"][2], spans["--y"][2], spans["--z"][2]),
        )
    write_zone(out, data)
    if report is not None:
        from lmeasure.report.zone import write_zone_page

        write_zone_page(report / "zone.html", data, linked)
    if rerun is not None:
        from lmeasure.view import write_recording

        write_recording(rerun, linked, zone=data)
    typer.echo(summary(data))


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

    from lmeasure.conventions import rotation_from_angles

    values = []
    for name, text in zip(("--o", "--a", "--t"), texts, strict=True):
        if text is None:
            raise typer.BadParameter("give --o, --a and --t together", param_hint=name)
        values.append(_axis(name, _numbers(name, text, ":", 3)))
    return rotation_from_angles("puma-oat", np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, 3))


def _axis(name: str, span: tuple[float, ...]) -> "NDArray[np.float64]":
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
