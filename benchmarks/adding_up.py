"""Studies of many draws, each kept in a table as soon as it is done: pieces that are made one after the other add up."""

import argparse
import csv
from collections.abc import Callable, Iterable
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any


def options(about: str | None, draws: str, out: str) -> argparse.ArgumentParser:
    """--first and how many of these draws, the table they are added to, a table to read instead, and whether the results are written."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument(f"--{draws}", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument("--table", type=Path)
    parser.add_argument("--write", action="store_true")
    return parser


def add_up(asked: argparse.Namespace, made: Iterable[Any], table: Callable[[Path], str], results: Path) -> None:
    """Add what is made, dataclasses of one kind, to the table that was asked for, or read the one that is there; print what it says."""
    if asked.table is None:
        with asked.out.open("a", newline="") as file:
            writer = csv.writer(file)
            for row in made:
                if file.tell() == 0:
                    writer.writerow([f.name for f in fields(row)])
                writer.writerow(astuple(row))
                file.flush()
    text = table(asked.table or asked.out)
    print(text)
    if asked.write:
        results.write_text(text, encoding="utf-8")
