"""Long studies in pieces: what has run is kept line by line in a file, and the next start goes on from there.

Pieces that were made beside each other, by several processes with a file each, are joined by `cat`.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any


class Pieces:
    """Results by their keys, of a file of JSON lines, or of nothing without one; nothing new is begun `seconds` after it was made."""

    def __init__(self, path: Path | None, seconds: float = math.inf) -> None:
        self.path, self.until = path, time.monotonic() + seconds
        lines = path.read_text(encoding="utf-8").splitlines() if path is not None and path.exists() else []
        self.known: dict[str, Any] = dict(json.loads(line) for line in lines)

    def __call__(self, key: str, run: Callable[[], Any]) -> Any:
        """What is known of the key, or what `run` gives of it now, as JSON has it; None where the time is over."""
        if key not in self.known:
            if time.monotonic() > self.until:
                return None
            line = json.dumps([key, run()], default=_plain)
            self.known[key] = json.loads(line)[1]
            if self.path is not None:
                with self.path.open("a", encoding="utf-8") as out:
                    out.write(line + "\n")
        return self.known[key]


def _plain(value: Any) -> Any:
    """A dataclass or a scalar or array of NumPy as what JSON has."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value.tolist()


def kept(path: Path | None) -> list[Any]:
    """All that is kept in a file."""
    return list(Pieces(path).known.values())


def options(about: str | None, draws: str, count: int = 100, *, writes: bool = True) -> argparse.ArgumentParser:
    """--first and how many of these draws, the file that keeps them, when to stop, and whether to write the page of results, if any."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="number (seed) of the first")
    parser.add_argument(f"--{draws}", type=int, default=count, help="how many from there; 0: only what is kept")
    parser.add_argument("--keep", type=Path, help="file for what has run, to go on from")
    parser.add_argument("--seconds", type=float, default=math.inf, help="when to begin nothing new, with --keep")
    if writes:
        parser.add_argument("--write", action="store_true", help="write the page of results")
    return parser


def run_all(asked: argparse.Namespace, runs: Iterable[tuple[str, Callable[[], Any]]]) -> list[Any]:
    """All that is kept, of earlier starts too, after these were run, each by its key."""
    pieces = Pieces(asked.keep, asked.seconds)
    for key, run in runs:
        pieces(key, run)
    return list(pieces.known.values())


def show(asked: argparse.Namespace, text: str, results: Path) -> None:
    """Print a page of results, and write it where that is asked for."""
    print(text)
    if asked.write:
        results.write_text(text, encoding="utf-8", newline="\n")
