"""A look at a recording."""

import os
import sys
from pathlib import Path
from typing import Annotated, ClassVar

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, option


class Settings(Asked):
    """Settings of `lmeasure view`."""

    NEXT: ClassVar[str] = "workbench my-cell"
    recording: Annotated[Path, option("Recording from an option --rerun, or from the demo.", metavar="FILE.rrd", positional=True)]
    web: Annotated[
        bool, option("Serve rerun's web viewer to browsers of this machine, without a display; stop with Ctrl-C.", flag="--web")
    ] = False
    port: Annotated[int | None, option("Port of 127.0.0.1 for --web; 0 takes a free one. [9090]", ge=0, le=65535)] = None


def has_display() -> bool:
    """Return whether this machine can show a window."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[None]:
    """Open the viewer, or serve it to browsers where this machine has no display; progress gets the address."""
    if settings.web or settings.port is not None or not has_display():
        from lmeasure.view import serve

        serve(settings.recording, 9090 if settings.port is None else settings.port, lambda text: progress(0.0, text))
    else:
        from lmeasure.view import open_viewer

        open_viewer(settings.recording)
    return Result(None, ())
