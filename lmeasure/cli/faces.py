"""What a person sees while a command works: a bar that vanishes, stages that stay, a table of a recording, questions."""

import queue
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from lmeasure import compiling
from lmeasure.cli import events
from lmeasure.cli.words import said
from lmeasure.errors import SettingsError

if TYPE_CHECKING:
    from lmeasure.acquisition.check import Check, Step
    from lmeasure.workflows import Workflow
    from lmeasure.workflows.flow import Progress, Result
    from lmeasure.workflows.settings import Asked


def with_bar(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """Under a progress bar."""
    with bar(workflow.name) as progress:
        return workflow.run(settings, progress)


def recording(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """Under the table of a recording, where it is asked for."""
    if not settings.live:
        return workflow.run(settings)
    if events.asked():
        return workflow.run(settings, show=events.live)
    from lmeasure.cli.live import live_table

    with live_table() as show:
        return workflow.run(settings, show=show)


def questions(workflow: "Workflow", settings: "Asked") -> "Result[Check]":
    """With a person who does what is asked while the counts are shown, and the table of what came of it."""
    keys = TypedLines()
    with state_line() as (say, show):

        def ask(step: "Step") -> str:
            words = said("{text}, then press Enter", text=said(step.text))
            say(f"{step.number}/{step.of} {words}")
            if events.asked():
                events.tell("asked", text=words, number=step.number, of=step.of)
            while not (lines := keys.typed()):
                if keys.gone:
                    raise typer.Abort
                state = step.look()
                if show is not None:
                    show(state)
            return lines[0]

        result: Result[Check] = workflow.run(settings, lambda fraction, text: say(text), ask=ask)
    _print(result.made)
    return result


def capturing(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """With lines for what was read, a line that stays in its place for the state of things, and a person, or a script, that types."""
    on_terminal = sys.stdin is not None and sys.stdin.isatty()

    def ask(text: str) -> str:
        return str(typer.prompt(said(text), default="", show_default=False, prompt_suffix=": "))

    keys = TypedLines()
    with state_line() as (say, show):
        if on_terminal or events.asked():
            return workflow.run(settings, say=say, keys=keys, ask=ask if on_terminal else keys.answer, show=show)
        return workflow.run(settings, say=say, keys=keys)


class TypedLines:
    """Lines of standard input as they are typed, read beside the work; nothing is read before the first question for them."""

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._ended = self.gone = False

    def _read(self) -> None:
        if sys.stdin is not None:
            for line in sys.stdin:
                self._lines.put(line.rstrip("\n"))
        self._ended = True

    def typed(self) -> list[str]:
        """Those since the last question."""
        if self._reader.ident is None:
            self._reader.start()
        ended, out = self._ended, []
        while not self._lines.empty():
            out.append(self._lines.get())
        self.gone = ended
        return out

    def answer(self, text: str) -> str:
        """The next line, as the answer to a question of another program's page; typer.Abort where there is none."""
        events.tell("asked", text=said(text), number=0, of=0)
        while not (lines := self.typed()):
            if self.gone:
                raise typer.Abort
            time.sleep(0.05)
        for later in lines[1:]:
            self._lines.put(later)
        return lines[0]


@contextmanager
def state_line() -> "Iterator[tuple[Callable[[str], None], Callable[[str], None] | None]]":
    """What prints lines, and what renews one on a terminal, ten times a second at most, in which a person may type."""
    if events.asked():
        yield lambda text: events.tell("said", text=text), events.Paced("state")
        return
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda text: typer.echo(text), None
        return
    shown, width = 0.0, max(shutil.get_terminal_size().columns - 1, 20)

    def clear() -> None:
        print(f"\r{'':{width}}\r", end="", file=sys.stderr, flush=True)

    def say(text: str) -> None:
        clear()
        typer.echo(text)

    def show(text: str) -> None:
        nonlocal shown
        if time.monotonic() - shown >= 0.1:
            shown = time.monotonic()
            print(f"\r{text[:width]:{width}}", end="", file=sys.stderr, flush=True)

    try:
        yield say, show
    finally:
        clear()


def beginning(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """With questions, where no template answers them."""

    def ask(question: str, default: str) -> str:
        try:
            return str(typer.prompt(said(question), default=default))
        except typer.Abort:
            if sys.stdin is not None and sys.stdin.isatty():
                raise
            raise SettingsError("template", "is missing, and nobody answers; `lmeasure init --list` lists them") from None

    if settings.list or settings.template is not None:
        return workflow.run(settings)
    return workflow.run(settings, ask=ask)


def with_stages(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """With a line for each stage."""
    with stages() as progress:
        return workflow.run(settings, progress)


def in_browser(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """With the address of its pages."""
    try:
        from lmeasure.workbench.server import serve
    except ModuleNotFoundError as error:
        from lmeasure.errors import LMeasureError
        from lmeasure.extras import how_to_install

        raise LMeasureError(f"the workbench needs {error.name}, which is not installed: {how_to_install('workbench')}") from error

    def told(fraction: float, address: str) -> None:
        typer.echo(said("The workbench is at {address} for browsers of this machine alone; Ctrl-C ends it", address=address))

    return workflow.run(settings, told, serve=serve)


Face = Callable[["Workflow", Any], "Result[Any]"]
FACES: dict[str, Face] = {
    "capture": capturing,
    "check": questions,
    "init": beginning,
    "demo": with_stages,
    "record": recording,
    "workbench": in_browser,
    "view": lambda workflow, settings: workflow.run(settings, lambda fraction, text: typer.echo(text)),
}
"""Of commands that show something else than a bar."""


@contextmanager
def told_of_compiling() -> Iterator[None]:
    """Says on a terminal that kernels are being compiled, which takes long once, and afterwards for how long it was."""

    def begun(name: str) -> None:
        first = "lmeasure: compiling the numerical kernels for this machine, half a minute to two; later calls load them ({name} ...)"
        print(said(first, name=name), file=sys.stderr, flush=True)

    def told(name: str) -> None:
        events.tell("compiling", text=name)

    before, since = len(compiling.names), compiling.seconds
    compiling.begun = told if events.asked() else begun if sys.stderr is not None and sys.stderr.isatty() else None
    try:
        yield
    finally:
        done = compiling.names[before:]
        if compiling.begun is begun and done:
            last = "lmeasure: compiled {count} kernels in {seconds} s, kept for later: {names}"
            names = ", ".join(dict.fromkeys(done))
            print(said(last, count=len(done), seconds=f"{compiling.seconds - since:.0f}", names=names), file=sys.stderr, flush=True)
        compiling.begun = None


@contextmanager
def bar(label: str) -> "Iterator[Progress]":
    """A progress bar on stderr, named by the label until the work names itself.

    It vanishes when the work is done, and is not there at all where nobody watches: an error stays one line.
    """
    if events.asked():
        yield events.progress(said(label))
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(said(label), total=None)
        yield lambda fraction, text: shown.update(task, completed=fraction, total=1.0, description=said(text))


@contextmanager
def stages() -> "Iterator[Progress]":
    """A line for each stage on stderr, on a terminal with a bar and its time."""
    if events.asked():
        yield events.progress(said("load"))
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        begun: set[str] = {"load"}

        def say(fraction: float, stage: str) -> None:
            if stage not in begun:
                begun.add(stage)
                typer.echo(said(stage), err=True)

        yield say
        return
    with Progress(TextColumn("{task.description:34}"), BarColumn(), TimeElapsedColumn(), console=console) as shown:
        tasks: dict[str, TaskID] = {"load": shown.add_task(said("load"), total=None)}
        current = tasks["load"]

        def step(fraction: float, stage: str) -> None:
            nonlocal current
            if stage not in tasks:
                shown.update(current, completed=1, total=1)
                tasks[stage] = current = shown.add_task(said(stage), total=None)
            shown.update(current, completed=fraction or None, total=1.0 if fraction else None)

        yield step
        shown.update(current, completed=1, total=1)


def _print(result: "Check") -> None:
    """The table, within 80 columns, and under it every fault on a line of its own."""
    form = "{:<12.12} {:<10.10} {:<10.10} {:>3} {:>9} {:>9} {:>15} {}"
    typer.echo(form.format("cable", "channel", "moved", "+-", "stroke mm", "slack mm", "counts/turn", "").rstrip())
    for c in result.cables:
        direction = "-" if c.direction is None else f"{c.direction:+d}"
        stroke, slack = ("-" if v is None else f"{v:{f}}" for v, f in ((c.stroke_mm, ".1f"), (c.slack_mm, "+.3f")))
        turn = "-" if c.counts_per_turn is None else f"{c.counts_per_turn:.0f} of {c.expected_per_turn:g}"
        typer.echo(form.format(c.cable, c.channel, c.moved or "-", direction, stroke, slack, turn, "" if c.faults else "ok").rstrip())
    for n, e in enumerate(result.encoders):
        if n == 0:
            typer.echo(form.format("encoder", "channel", "moved", "+-", "turned deg", "back deg", "", "").rstrip())
        direction = "-" if e.direction is None else f"{e.direction:+d}"
        turned, back = ("-" if v is None else f"{v:{f}}" for v, f in ((e.turned_deg, ".1f"), (e.back_deg, "+.3f")))
        name = e.what.removeprefix("swivel of ").removeprefix("inclination ")
        typer.echo(form.format(name, e.channel, e.moved or "-", direction, turned, back, "", "" if e.faults else "ok").rstrip())
    typer.echo(f"{result.rate_hz:.1f} samples/s; at rest the counters move by at most {max(result.spread.values()):g} counts")
    for fault in result.all_faults:
        typer.echo(f"fault: {fault}")
