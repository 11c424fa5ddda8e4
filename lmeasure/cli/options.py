"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer


def _recording(path: Path | None) -> Path | None:
    if path is not None and path.suffix.lower() != ".rrd":
        raise typer.BadParameter(f"{str(path)!r} does not end in .rrd")
    return path


Rerun = Annotated[
    Path | None,
    typer.Option("--rerun", metavar="FILE.rrd", callback=_recording, help="Also write a recording to look at with `lmeasure view`."),
]
