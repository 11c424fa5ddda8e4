"""`lmeasure demo`: the whole chain on a simulated cell."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for all files; an earlier demo's is written over.")] = Path(
        "lmeasure-demo"
    ),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Which cell, reference poses and motion are drawn.")] = 0,
) -> None:
    """Calibrate, record, reconstruct and map a simulated cell over a virtual CAN bus, and compare with the truth."""
    with _stages() as progress:
        from lmeasure.chains import demo as chain

        result = chain(out, progress, seed)
    rows = [("", "error against the truth", "stated without knowing it"), *((x.what, x.error, x.stated) for x in result.lines)]
    widths = [max(len(row[i]) for row in rows) for i in range(2)]
    typer.echo("")
    for what, error, stated in rows:
        typer.echo(f"{what:{widths[0]}}   {error:>{widths[1]}}   {stated}".rstrip())
    typer.echo("")
    for remark in result.remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"All files are in {out}. Look at")
    for path in result.look:
        typer.echo(f"  {path}")
    typer.echo(f"Open the recording with: lmeasure view {result.look[0]}   (or: python3 run.py view {result.look[0]})")


@contextmanager
def _stages() -> Iterator[Callable[[str, int, int], None]]:
    """A line for each stage on stderr, on a terminal with a bar and its time; the value takes `(stage, done, of)`."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        begun: set[str] = set()

        def say(stage: str, done: int, of: int) -> None:
            if stage not in begun:
                begun.add(stage)
                typer.echo(stage, err=True)

        yield say
        return
    with Progress(TextColumn("{task.description:34}"), BarColumn(), TimeElapsedColumn(), console=console) as shown:
        tasks: dict[str, TaskID] = {}
        current = shown.add_task("load", total=None)

        def step(stage: str, done: int, of: int) -> None:
            nonlocal current
            if stage not in tasks:
                shown.update(current, completed=1, total=1)
                tasks[stage] = current = shown.add_task(stage, total=None)
            shown.update(current, completed=done if done else None, total=of if done else None)

        yield step
        shown.update(current, completed=1, total=1)
