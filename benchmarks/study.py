"""Run the studies: draw records seed by seed, keep them, continue where a start ended, and write the page of results.

A study states its name, its factors, one draw and its page (`Study`). Every study has these options:

    --runs N         number of seeds; the study's own word for its runs (--rigs, --campaigns ...) means the same
    --first N        first seed (--seed where the study has no seed of its own)
    --keep FILE      JSON lines of records, by key; the next start draws only what is missing (join files by `cat`)
    --seconds S      begin nothing new after this time
    --processes N    draw in N processes
    --write          write results/NAME.md; --out FILE writes another page

and one option per factor, with one or more of its levels.
"""

import argparse
import itertools
import json
import math
import multiprocessing
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import scipy.stats

RESULTS = Path(__file__).parent / "results"
Asked = argparse.Namespace
Record = dict[str, Any]


@dataclass(frozen=True)
class Study:
    """A study: `draw(seed, *levels)` gives a record, or None for a seed that is passed over; `page(records)` gives the text of the results,
    and for an exit code whether they are as they must be.

    `key` names a record in a file that keeps them, by seed and factors. `cases` states the levels that a seed is drawn with, by the levels
    that are asked for; without it these are all their products.
    """

    name: str
    draw: Callable[..., Any]
    page: Callable[[list[Any]], str | tuple[str, bool]]
    runs: str = "runs"
    count: int = 100
    factors: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    key: str = ""
    cases: Callable[[Asked, int], Iterable[tuple[Any, ...]]] | None = None
    record: Callable[..., Any] = dict

    def parser(self, about: str | None) -> argparse.ArgumentParser:
        """Return the options that all studies have and one for each factor."""
        parser = options(about)
        parser.add_argument(
            "--runs", f"--{self.runs}", dest="runs", type=int, default=self.count, help="number of seeds; 0: only what is kept"
        )
        parser.add_argument(*(["--first"] if "seed" in self.factors else ["--first", "--seed"]), type=int, default=0, help="first seed")
        parser.add_argument("--keep", type=Path, help="file of what has run, to continue from")
        parser.add_argument("--seconds", type=float, default=math.inf, help="begin nothing new after this time")
        parser.add_argument("--processes", type=int, default=1)
        for name, levels in self.factors.items():
            parser.add_argument(
                f"--{name}",
                type=partial(several, levels),
                action="extend",
                nargs="+",
                help=f"of {', '.join(map(str, levels))}".replace("%", "%%"),
            )
        return parser

    def run(self, arguments: Asked) -> list[Any]:
        """Return all records that are kept, after those that are asked for were drawn."""
        for name, levels in self.factors.items():
            chosen = getattr(arguments, name)
            setattr(arguments, name, list(itertools.chain(*chosen)) if chosen else list(levels))
        key = self.key or " ".join(f"{{{name}}}" for name in (*self.factors, "seed"))
        cases = self.cases or (lambda arguments, seed: itertools.product(*(getattr(arguments, name) for name in self.factors)))
        seeds = range(arguments.first, arguments.first + arguments.runs)
        every = ((seed, *levels) for seed in seeds for levels in cases(arguments, seed))
        runs = (
            (key.format(seed=seed, **dict(zip(self.factors, levels, strict=False))), partial(self.draw, seed, *levels))
            for seed, *levels in every
        )
        kept = Kept(arguments.keep, arguments.seconds)
        kept.run(runs, arguments.processes)
        return [self.record(**r) if isinstance(r, dict) else r for r in kept.known.values() if r is not None]

    def command(self, about: str | None) -> int:
        """Run what the command line asks for, show the page, and return the exit code."""
        arguments = self.parser(about).parse_args()
        records = self.run(arguments)
        if not records:
            raise SystemExit(f"{self.name}: no record was drawn, and none is kept")
        page = self.page(records)
        text, good = page if isinstance(page, tuple) else (page, True)
        show(arguments, text, self.name)
        return int(not good)


def several(levels: Sequence[Any], text: str) -> list[Any]:
    """Return the levels that a word of the command line names: one, several with commas or semicolons between, or `all`."""
    known = {str(level): level for level in levels}
    if text == "all":
        return list(levels)
    try:
        return [known[text]] if text in known else [known[one.strip()] for one in text.replace(";", ",").split(",") if one]
    except KeyError as error:
        raise argparse.ArgumentTypeError(f"{error}: choose from {', '.join(known)}") from None


class Kept:
    """Records by key, of a file of JSON lines or of nothing without one; nothing new is begun `seconds` after it was made."""

    def __init__(self, path: Path | None, seconds: float = math.inf) -> None:
        self.path, self.until = path, time.monotonic() + seconds
        text = path.read_text(encoding="utf-8") if path is not None and path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if path is not None and whole != text:  # of a start that was stopped while it wrote
            path.write_text(whole, encoding="utf-8", newline="\n")
        self.known: dict[str, Any] = dict(json.loads(line) for line in whole.splitlines())

    def __call__(self, key: str, run: Callable[[], Any]) -> Any:
        """Return the record of a key, drawn now if it is not known; None where the time is over."""
        if key not in self.known and time.monotonic() <= self.until:
            self.put(key, run())
        return self.known.get(key)

    def put(self, key: str, record: Any) -> None:
        """Keep a record as JSON has it."""
        line = json.dumps([key, record], default=_plain)
        self.known[key] = json.loads(line)[1]
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as out:
                out.write(line + "\n")

    def run(self, runs: Iterable[tuple[str, Callable[[], Any]]], processes: int = 1) -> None:
        """Draw what is not known, each kept as soon as it and those before it are done."""
        left = ((key, run) for key, run in runs if key not in self.known)
        if processes == 1:
            for key, run in left:
                self(key, run)
            return
        with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
            for key, future in _ahead(pool, itertools.takewhile(lambda _: time.monotonic() <= self.until, left), 2 * processes):
                self.put(key, future.result())


def _ahead(pool: ProcessPoolExecutor, runs: Iterable[tuple[str, Callable[[], Any]]], most: int) -> Iterator[tuple[str, Future[Any]]]:
    """Yield runs in their order; the next few are computed meanwhile."""
    begun: deque[tuple[str, Future[Any]]] = deque()
    for key, run in runs:
        begun.append((key, pool.submit(run)))
        if len(begun) == most:
            yield begun.popleft()
    yield from begun


def _plain(value: Any) -> Any:
    """Return a dataclass or a scalar or array of NumPy as JSON has it."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value.tolist()


def options(about: str | None) -> argparse.ArgumentParser:
    """Return the options that every benchmark with a page of results has."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the page of results")
    parser.add_argument("--out", "--results", dest="out", type=Path, help="another page to write")
    return parser


def show(arguments: Asked, text: str, name: str) -> None:
    """Print a page of results, and write it if the command line says so. A bare table replaces the first one of a page that is there."""
    text, path = text.rstrip("\n") + "\n", arguments.out or RESULTS / f"{name}.md"
    print(text)
    if arguments.write or arguments.out:
        if text.startswith("|") and path.exists():
            text = re.sub(r"(^\|.*\n)+", lambda _: text, path.read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
        path.write_text(text, encoding="utf-8", newline="\n")


def table(head: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table in Markdown."""
    return "\n".join([_line(head), "|---" * len(head) + "|", *map(_line, rows)])


def _line(cells: Sequence[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def percent(outcomes: Iterable[Any], digits: int = 1) -> str:
    """Return the share of outcomes that are true, in percent."""
    every = list(outcomes)
    return f"{100.0 * sum(map(float, every)) / len(every):.{digits}f}" if every else "nan"


def two_sided(outcomes: Iterable[Any], chance: float = 0.95) -> float:
    """Return how probable it is, for outcomes of this chance, that as many or a less probable number of them are true."""
    every = [bool(one) for one in outcomes]
    return float(scipy.stats.binomtest(sum(every), len(every), chance).pvalue) if every else math.nan
