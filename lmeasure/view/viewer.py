"""Recordings looked at: whether a file is one, and rerun's viewer on it."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

from lmeasure.core import FileFormatError, LMeasureError, pasted
from lmeasure.io import open_regular, os_reason
from lmeasure.text import message

# `python -m rerun_cli` would lose the exit code
RERUN = (sys.executable, "-c", "import sys, rerun_cli.__main__ as r; sys.exit(r.main())")


def check_recording(path: Path, name: Path | None = None) -> None:
    """FileFormatError (naming `name`, default the path) unless the file is a whole .rrd that this version of rerun reads."""
    from rerun.chunk import RrdReader

    name = name or path
    open_regular(path).close()
    try:
        with warnings.catch_warnings():
            # a file that was cut off is only warned about
            warnings.simplefilter("error")
            RrdReader(path).store()
    except OSError as error:
        raise FileFormatError(message("error.cannot_be_read", where=name, broken=os_reason(error))) from error
    except (RuntimeError, ValueError, Warning) as error:
        raise FileFormatError(message("error.is_not_a_whole", where=name)) from error


def open_viewer(path: Path) -> None:
    """Open a recording in rerun's viewer and wait until that is closed; LMeasureError without a recording or a display."""
    check_recording(path)
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise LMeasureError(message("error.cannot_be_shown_there", where=path, path=pasted(path)))
    # the viewer also listens for other programs' recordings: on this machine only
    code = subprocess.run([*RERUN, str(Path(path).resolve()), "--bind", "127.0.0.1"], check=False).returncode
    if code != 0:
        raise LMeasureError(message("error.the_rerun_viewer_ended", where=path, value=code))
