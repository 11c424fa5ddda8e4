"""`lmeasure demo`: the whole chain on a simulated cell."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for all files; an earlier demo's is written over. [lmeasure-demo]"),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Which cell, reference poses and motion, or robot, are drawn.")] = 0,
    robot: Annotated[
        bool, typer.Option("--robot", help="Let a simulated robot run the test cube of ISO 9283 and certify it. [lmeasure-robot-demo]")
    ] = False,
) -> None:
    """Calibrate, record, reconstruct and map a simulated cell over a virtual CAN bus, and compare with the truth."""
    rows, remarks, look = _robot(out or Path("lmeasure-robot-demo"), seed) if robot else _cell(out or Path("lmeasure-demo"), seed)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    typer.echo("")
    for first, *others in rows:
        cells = [f"{cell:>{width}}" for cell, width in zip(others[:-1], widths[1:-1], strict=True)]
        typer.echo("   ".join([f"{first:{widths[0]}}", *cells, others[-1]]).rstrip())
    typer.echo("")
    for remark in remarks:
        typer.echo(f"note: {remark}")
    typer.echo(f"All files are in {look[0].parent}. Look at")
    for path in look:
        typer.echo(f"  {path}")
    typer.echo(f"Open the recording with: lmeasure view {look[0]}   (or: python3 run.py view {look[0]})")


def _cell(out: Path, seed: int) -> tuple[list[tuple[str, ...]], tuple[str, ...], tuple[Path, ...]]:
    with _stages() as progress:
        from lmeasure.chains import demo as chain

        result = chain(out, progress, seed)
    head = ("", "error against the truth", "stated without knowing it")
    return [head, *((x.what, x.error, x.stated) for x in result.lines)], result.remarks, result.look


def _robot(out: Path, seed: int) -> tuple[list[tuple[str, ...]], tuple[str, ...], tuple[Path, ...]]:
    with _stages() as progress:
        from lmeasure.chains.robot_demo import robot_demo

        result = robot_demo(out, progress, seed)
    head = ("characteristic", "value", "U95", "truth", "unit", "")
    rows = [
        (f"{h.name} {h.where}", *(f"{v:.4g}" for v in (h.value, h.u95, h.true_value)), h.unit, "inside" if h.inside else "OUTSIDE")
        for h in result.shown()
    ]
    return [head, *rows], result.remarks, result.look


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
