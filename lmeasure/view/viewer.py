"""Recordings looked at: whether a file is one, and rerun's viewer on it."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

from lmeasure.core import FileFormatError, LMeasureError, pasted
from lmeasure.io import open_regular

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
        raise FileFormatError(f"{name}: cannot be read: {error.strerror or error}") from error
    except (RuntimeError, ValueError, Warning) as error:
        raise FileFormatError(f"{name}: is not a whole rerun recording") from error


def open_viewer(path: Path) -> None:
    """Open a recording in rerun's viewer and wait until that is closed; LMeasureError without a recording or a display."""
    check_recording(path)
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise LMeasureError(
            f"{path}: cannot be shown: there is no display here; `lmeasure view {pasted(path)} --web` shows it in a browser, "
            "of this machine or of one that forwards a port to it"
        )
    # the viewer also listens for other programs' recordings: on this machine only
    code = subprocess.run([*RERUN, str(Path(path).resolve()), "--bind", "127.0.0.1"], check=False).returncode
    if code != 0:
        raise LMeasureError(f"{path}: the rerun viewer ended with code {code}")
