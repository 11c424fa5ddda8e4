"""A look at a recording."""

from pathlib import Path
from typing import Annotated

from lmeasure.core import SettingsError
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, option


class Settings(Asked):
    """What `lmeasure view` is asked."""

    recording: Annotated[Path, option("Recording that a stage wrote with --rerun, or the demo.", metavar="FILE.rrd", positional=True)]
    web: Annotated[
        bool,
        option(
            "Serve rerun's web viewer to browsers of this machine, which needs no display here; Ctrl-C ends it.",
            flag="--web",
            label="In a browser",
        ),
    ] = False
    port: Annotated[int | None, option("Port of 127.0.0.1 for --web; 0 takes a free one. [9090]", ge=0, le=65535)] = None


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[None]:
    """Open the viewer, or serve it until it is ended; progress is told where."""
    if settings.web:
        from lmeasure.view import serve

        serve(settings.recording, 9090 if settings.port is None else settings.port, lambda text: progress(0.0, text))
    elif settings.port is not None:
        raise SettingsError("port", "goes with --web")
    else:
        from lmeasure.view import open_viewer

        open_viewer(settings.recording)
    return Result(None, ())
