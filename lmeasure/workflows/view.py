"""A look at a recording."""

from pathlib import Path
from typing import Annotated

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, option


class Settings(Asked):
    """What `lmeasure view` is asked."""

    recording: Annotated[Path, option("Recording that a stage wrote with --rerun, or the demo.", metavar="FILE.rrd", positional=True)]


@workflow("view")
def run(settings: Settings, progress: Progress = silent) -> Result[None]:
    """Open the viewer, which goes on by itself."""
    from lmeasure.view.viewer import open_viewer

    open_viewer(settings.recording)
    return Result(None, ())
