"""The folder of a demo: its own, known again by a mark, which holds the demo's table once it has come to its end."""

import json
from collections.abc import Sequence
from pathlib import Path

from lmeasure import files
from lmeasure.errors import LMeasureError, OverwriteError
from lmeasure.opened import read_regular

SCHEMA = "lmeasure.demo/1"
MARK = "demo.json"
LARGEST_MARK = 1 << 20


def claim(out: Path) -> None:
    """Make the folder, or check that it holds an earlier demo and nothing of anybody else."""
    written = out / MARK
    try:
        if out.exists() and not out.is_dir():
            raise OverwriteError(f"{out}: is a file; the demo needs a folder of its own")
        if out.is_dir() and any(out.iterdir()) and not _is_mark(written):
            raise OverwriteError(f"{out}: holds other files and no {MARK} of an earlier demo; give --out a folder of its own")
    except OSError as error:
        raise LMeasureError(f"{out}: cannot be looked into: {error.strerror or error}") from error
    mark(out, None)


def _is_mark(path: Path) -> bool:
    try:
        content = json.loads(read_regular(path, LARGEST_MARK))
    except (LMeasureError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and content.get("schema") == SCHEMA


def mark(out: Path, table: Sequence[object] | None) -> None:
    """The demo's own file: by it the folder is known again; it holds the table once the demo has come to its end."""
    content = {"schema": SCHEMA, "finished": table is not None, "table": [vars(line) for line in table or ()]}
    files.write_text(out / MARK, json.dumps(content, indent=1) + "\n")
