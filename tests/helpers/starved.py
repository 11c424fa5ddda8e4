"""Runs command lines, each in the same process, where nothing can be written: `python starved.py full|closed FOLDER`, lines on standard
input, in which OUT is the folder. On standard output a JSON list a line: exit code, lines of standard error, files in the folder."""

import contextlib
import ctypes
import io
import json
import os
import resource
import shutil
import sys
from pathlib import Path
from typing import Any

PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2
LARGEST = 100
"""Bytes of a file on the full disk."""


def main() -> None:
    """Closed: the same once more without root's right to write everywhere."""
    mode, folder = sys.argv[1], Path(sys.argv[2])
    if mode == "closed" and os.geteuid() == 0:
        prctl = ctypes.CDLL(None).prctl
        dropped = [prctl(PR_CAPBSET_DROP, right, 0, 0, 0) for right in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH)]
        os.execv(sys.executable, [sys.executable, __file__, "open" if any(dropped) else "shut", str(folder)])
    for line in sys.stdin:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        if mode != "full":
            folder.chmod(0o555)
        said = ended(line.replace("OUT", str(folder)).split(), LARGEST if mode == "full" else -1)
        folder.chmod(0o755)
        print(json.dumps(["root" if mode == "open" else said[0], said[1], [p.name for p in folder.rglob("*") if p.is_file()]]))


def ended(words: list[str], largest: int) -> tuple[Any, list[str]]:
    """Exit code and lines of standard error."""
    from lmeasure.cli.app import main

    usual, err = resource.getrlimit(resource.RLIMIT_FSIZE), io.StringIO()
    sys.argv = ["lmeasure", *words]
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, usual[1]))
            main()
    except SystemExit as end:
        return end.code, err.getvalue().splitlines()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    return None, []


if __name__ == "__main__":
    main()
