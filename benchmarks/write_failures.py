"""Fail every file operation of every command that writes once: no room, a disk error, an interrupted call, and a kill.

    python benchmarks/write_failures.py --keep FILE [--command NAME ...] [--answer ENOSPC ...] [--seconds S] [--write]

A child process runs each command of `tests/helpers/desk.py`, for the first time and where it replaces its files. Before each call that
changes a file in its folder the kernel asks this process (`tests/helpers/failing_files.py`), whichever library makes the call. After each
failure: every file is whole or as it was, one line of text names a file, the exit code is 1, and the command comes to the same files when
it runs again. Of several writes to one file the first, the second and the last fail.
"""

import os
import shutil
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from study import Study, table

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors")]

from desk import LONG, RECORDINGS, SHORT, set_up  # noqa: E402
from failing_files import ANSWERS, failing  # noqa: E402
from kills import ended  # noqa: E402

PERSON_BESIDE = ("check",)
"""Waits for a person."""
OTHERS = {
    "identify": "identify --robot ur5 --measurements ur5/rows.csv --out OUT/identified",
    "check-instrument": "check-instrument stops --out OUT/check",
}
EVERY = {name: line for name, line in (SHORT | LONG | OTHERS | RECORDINGS).items() if name not in PERSON_BESIDE}


def desk() -> Path:
    """Return the folder with all inputs, made once for this process."""
    here = Path(tempfile.gettempdir()) / f"lmeasure-desk-{os.getpid()}"
    if not here.exists():
        import pages
        import test_interim as interim

        from lmeasure.recording import write_run

        here.mkdir()
        set_up(here)
        os.chdir(here)
        ended("init . --template six-cables", here)
        write_run(here / "stops", interim.run_of(interim.true_rig(), 0)[0])
        pages.PAGES["identification"](here / "ur5", "en")
    return here


def draw(seed: int, command: str, files: str, answer: str) -> dict[str, Any] | None:
    """Let each call of a command get one answer, and return what was found; None where nothing can be replaced."""
    del seed
    if command in RECORDINGS and files == "replaced":
        return None
    here, begun = desk(), time.monotonic()
    line, out = EVERY[command], here / "out"
    found = failing(line, out, (answer,), replacing=files == "replaced", recording=command in RECORDINGS)
    return {"command": command, "files": files, "answer": answer, "seconds": time.monotonic() - begun, **asdict(found)}


def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
    """Return the table: a row for each command."""
    rows: list[list[Any]] = []
    for command in dict.fromkeys(one["command"] for one in records):
        own = [one for one in records if one["command"] == command]
        calls = [max((one["calls"] for one in own if one["files"] == files), default=0) for files in ("new", "replaced")]
        failed = [sum(one["failed"] for one in own if one["answer"] == answer) for answer in ANSWERS]
        wrong = [text for one in own for text in one["wrong"]]
        rows.append([f"`{command}`", *calls, *failed, sum(one["reruns"] for one in own), "; ".join(wrong[:2]) or "nothing"])
    total = sum(len(one["wrong"]) for one in records)
    text = table(["command", "calls, new files", "calls, replacing", *ANSWERS, "run again from", "wrong"], rows)
    about = (
        f"{sum(one['failed'] for one in records)} failures, {total} wrong. The columns of answers count the calls that failed in this way, "
        "or at which the command was killed. `run again from` counts the different states of the folder from which the command ran again."
    )
    head = "# Every file operation fails once\n\n`python benchmarks/write_failures.py --keep FILE --write`"
    return f"{head}\n\n{about}\n\n{text}", not total


STUDY = Study(
    "write_failures", draw, page, "repeats", 1,
    {"command": tuple(EVERY), "files": ("new", "replaced"), "answer": tuple(ANSWERS)}, "{command} {files} {answer}",
)  # fmt: skip

if __name__ == "__main__":
    try:
        code = STUDY.command(__doc__)
    finally:
        shutil.rmtree(Path(tempfile.gettempdir()) / f"lmeasure-desk-{os.getpid()}", ignore_errors=True)
    raise SystemExit(code)
