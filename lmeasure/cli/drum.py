"""`lmeasure drum`: from what a mechanic measures on the drums to the rig file."""

from pathlib import Path
from typing import Annotated

import typer


def drum(
    measurements: Annotated[
        Path, typer.Argument(metavar="MEASUREMENTS.toml", help="What was measured, a drum table per observation point (docs/drum.md).")
    ],
    rig: Annotated[Path, typer.Option("--rig", help="The rig whose drums these are.")],
    out: Annotated[Path, typer.Option("--out", help="Rig file to write.")],
    point: Annotated[list[str] | None, typer.Option("--point", help="Only this observation point; may be repeated.")] = None,
) -> None:
    """Fill the drums of a rig file from radii, distances and the full-wind count."""
    from lmeasure.drum import choose, drum_summary, read_drums, with_drums
    from lmeasure.rig import read_rig, write_rig

    before = read_rig(rig)
    measured = choose(read_drums(measurements), point or [], str(measurements))
    write_rig(out, with_drums(before, measured))
    for one in measured:
        typer.echo(drum_summary(one))
    if before.calibration is not None:
        typer.echo(f"note: the link to {before.calibration} is dropped: it was made with the drums as they were; calibrate again")
