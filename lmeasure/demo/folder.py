"""The folder of a demo: a fresh one, or one that --force may write over; demo.json in it holds the demo's table once it has ended."""

import itertools
import json
import os
from collections.abc import Sequence
from pathlib import Path

from lmeasure.io import files

SCHEMA = "lmeasure.demo/1"
MARK = "demo.json"
OF_CELL = (
    MARK,
    "campaign",
    "calibration",
    "run",
    "truth.parquet",
    "trajectory.parquet",
    "demo.rrd",
    "zone.nc",
    "zone.html",
    "demo.html",
    "robot",
)
"""Files and folders of the demo of the cell."""
OF_ROBOT = (
    *OF_CELL[:-4], "commands.csv", "program.toml", "certificate", "characteristics.csv", "robot.toml", "identification", "identified",
    "corrected", "again", "comparison.json", "comparison.html",
)  # fmt: skip
"""Files and folders of the demo of the robot."""


def fresh(name: str) -> Path:
    """Return the first of NAME, NAME-2, NAME-3, ... that does not exist in the working folder."""
    return next(path for path in (Path(name if n == 1 else f"{name}-{n}") for n in itertools.count(1)) if not os.path.lexists(path))


def existing(out: Path, names: Sequence[str]) -> list[Path]:
    """Return the files that exist under these names of a folder, those in folders included, and those that killed processes left
    unfinished, under the names that they were to get."""
    every = [one for name in names for one in (out / name, *sorted((out / name).rglob("*")))]
    folders = [out, *(one for one in every if one.is_dir() and not one.is_symlink())]
    left = [one for folder in folders for one in files.abandoned(folder) if folder != out or one.name in names]
    there = [one for one in every if os.path.lexists(one) and (one.is_symlink() or not one.is_dir())]
    unfinished = {one.path for one in left}
    return [*(one for one in there if one not in unfinished), *(one.path.with_name(one.name) for one in left if one.path.is_file())]


def mark(out: Path, table: Sequence[object] | None) -> None:
    """Write demo.json: the demo's table once it has ended, none before."""
    content = {"schema": SCHEMA, "finished": table is not None, "table": [vars(line) for line in table or ()]}
    files.write_text(out / MARK, json.dumps(content, indent=1) + "\n")
