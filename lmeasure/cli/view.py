"""`lmeasure view`: look at a recording."""

from pathlib import Path
from typing import Annotated

import typer


def view(
    recording: Annotated[Path, typer.Argument(metavar="FILE.rrd", help="Recording that a stage wrote with --rerun, or the demo.")],
) -> None:
    """Open a recording in the rerun viewer: the rig in space, and every figure over time."""
    from lmeasure.view.viewer import open_viewer

    open_viewer(recording)
