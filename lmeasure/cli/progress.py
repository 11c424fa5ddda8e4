"""Display of a working command: a bar that vanishes, stages that stay, a table of a recording, questions."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lmeasure.cli import events, machine
from lmeasure.cli.interrupts import heeded
from lmeasure.cli.terminal import TypedLines, columns, fitted, state_line
from lmeasure.cli.text import rendered, stage, word
from lmeasure.core import CancelledError, SettingsError
from lmeasure.kernels import compilation
from lmeasure.text import message

if TYPE_CHECKING:
    from lmeasure.acquisition import Check, Step
    from lmeasure.procedures import Session
    from lmeasure.workflows import Asked, Progress, Result, Workflow


def with_bar(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """Under a progress bar."""
    with bar(workflow.name) as progress:
        return workflow.run(settings, heeded(progress))


def quietly(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """Run without a word."""
    return workflow.run(settings, heeded(lambda fraction, text: None))


def recording(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """Under the table of a recording, where it is asked for."""
    if not settings.live:
        return workflow.run(settings)
    from lmeasure.accuracy import radii_95  # noqa: F401 - takes long, and not while frames come

    if events.asked():
        return workflow.run(settings, show=events.live)
    from lmeasure.cli.live import live_table

    with live_table() as show:
        return workflow.run(settings, show=show)


def watching(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """Under the table of what comes."""
    if events.asked():
        return workflow.run(settings, show=events.live)
    from lmeasure.cli.live import live_table

    with live_table() as show:
        return workflow.run(settings, show=show)


def questions(workflow: "Workflow", settings: "Asked") -> "Result[Check]":
    """With a person who does what is asked while the counts are shown, and the table of what came of it."""
    from lmeasure.acquisition import Finished

    keys = TypedLines()
    alone = sys.stdin is not None and sys.stdin.isatty() and not events.asked()
    with state_line(keys) as (say, show):

        def ask(step: "Step") -> str:
            text, begun = rendered(step.text), time.monotonic()
            finished, warned = Finished(step, begun), False
            say(f"{step.number}/{step.of} {word('cli.or_wait' if alone and not step.question else 'cli.press_enter', text=text)}")
            if events.asked():  # a page has a button for it
                events.tell("asked", text=text, number=step.number, of=step.of, act=step.act)
            while True:
                lines = keys.typed()
                if alone and lines and time.monotonic() - keys.waited_s < begun + JUST_BEGUN_S:
                    lines = []  # it was typed for the step before, which has gone on by itself
                elif alone and lines and not finished.moved and not warned:
                    warned = True
                    say(word("cli.nothing_moved"))
                elif lines:
                    return lines[0]
                if keys.gone:
                    raise typer.Abort
                state = step.look()
                if show is not None:
                    show(state)
                if events.asked():
                    events.moved(step.moved())
                if finished.seen(time.monotonic()) and alone:
                    return ""

        result: Result[Check] = workflow.run(settings, lambda fraction, text: say(text), ask=ask)
    _print(result.made)
    return result


def capturing(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """With lines for what was read, a line that stays in its place for the state of things, and a person, or a script, that types."""
    on_terminal = sys.stdin is not None and sys.stdin.isatty()

    def ask(text: str) -> str:
        return str(typer.prompt("\n".join(fitted(rendered(text), columns())), default="", show_default=False, prompt_suffix=": "))

    keys = TypedLines()
    with state_line(keys) as (say, line):

        def show(session: "Session") -> None:
            if line is not None:
                line(session.line())
            if events.asked():
                events.captured(session)

        def progress(fraction: float, text: str) -> None:
            if events.asked() and keys.gone:  # whoever asked for it: it ends as by Ctrl-C
                raise CancelledError

        if on_terminal or events.asked():
            return workflow.run(settings, progress, say=say, keys=keys, ask=ask if on_terminal else keys.answer, show=show)
        return workflow.run(settings, say=say, keys=keys)


def opens_pages(settings: "Any") -> bool:
    """Return whether the page of a command is opened in a browser: on a terminal, unless nobody wants it."""
    on_terminal = sys.stdout is not None and sys.stdout.isatty()
    return bool(getattr(settings, "browser", False)) and on_terminal and not events.asked() and not machine.asked()


def inspecting(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """Show a bar; a page that nobody named is written aside, where it is opened."""
    name = next(name for name in ("report", "out") if name in type(settings).model_fields)
    if opens_pages(settings) and getattr(settings, name) is None and getattr(settings, "scan", True):
        settings = settings.model_copy(update={name: Path(tempfile.mkdtemp(prefix="lmeasure-")) / "inspect.html"})
    return with_bar(workflow, settings)


def listening(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """Under a progress bar, and for other programs with who speaks."""
    with bar(workflow.name) as progress:
        return workflow.run(settings, progress, show=events.spoken if events.asked() else None)


def playing(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """With a person, a page, or a script, that types what is to be done, until the end of what is typed."""
    keys = TypedLines()
    with state_line(keys) as (say, _):
        return workflow.run(settings, say=say, keys=keys, show=events.played if events.asked() else None)


def beginning(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """With questions, where no template answers them."""

    def ask(question: str, default: str) -> str:
        try:
            return str(typer.prompt(rendered(question), default=default))
        except typer.Abort:
            if sys.stdin is not None and sys.stdin.isatty():
                raise
            raise SettingsError("template", message("error.is_missing_and_nobody")) from None

    if settings.list or settings.template is not None:
        return workflow.run(settings)
    return workflow.run(settings, ask=ask)


def with_stages(workflow: "Workflow", settings: "Asked") -> "Result[Any]":
    """With a line for each stage."""
    with stages() as progress:
        return workflow.run(settings, heeded(progress))


def in_browser(workflow: "Workflow", settings: "Any") -> "Result[Any]":
    """With the address of its pages."""
    try:
        from lmeasure.workbench import ON_LOOPBACK, Site, serve
    except ModuleNotFoundError as error:
        from lmeasure.core import LMeasureError, how_to_install

        raise LMeasureError(message("error.the_workbench_needs_which", name=error.name, install=how_to_install("workbench"))) from error

    if settings.browser and not opens_pages(settings):
        settings = settings.model_copy(update={"browser": False})

    def served(asked: "Any", say: Callable[[str], None], show: Callable[[str], object] | None) -> None:
        site = Site(asked.host, asked.tls_certificate, asked.tls_key) if asked.host else ON_LOOPBACK
        about = {"within": asked.within, "site": site, "scheduler": asked.scheduler}
        serve(asked.folder, asked.port, asked.language, say, show=show, **about)

    return workflow.run(settings, lambda fraction, address: typer.echo(word("cli.workbench_at", address=address)), serve=served)


JUST_BEGUN_S = 0.5
"""For so long a step takes no answer that may have been meant for the one before."""
Face = Callable[["Workflow", Any], "Result[Any]"]
FACES: dict[str, Face] = {
    "capture": capturing,
    "check": questions,
    "import": inspecting,
    "init": beginning,
    "inspect": inspecting,
    "play": playing,
    "scan": listening,
    "demo": with_stages,
    "record": recording,
    "watch": watching,
    "workbench": in_browser,
    "view": lambda workflow, settings: workflow.run(settings, lambda fraction, text: typer.echo(rendered(text))),
}
"""Of commands that show something else than a bar."""


SILENT = (with_bar, with_stages, inspecting)
"""Faces that only show progress."""


@contextmanager
def reported_compiling() -> Iterator[None]:
    """Says on a terminal that kernels are being compiled, which takes long once, and afterwards for how long it was."""

    def begun(name: str) -> None:
        print(word("cli.compiling", name=name), file=sys.stderr, flush=True)

    def listed(name: str) -> None:
        events.tell("compiling", text=name)

    before, since = len(compilation.names), compilation.seconds
    on_terminal = not events.asked() and sys.stderr is not None and sys.stderr.isatty()
    compilation.begun = listed if events.asked() else begun if on_terminal else None
    try:
        yield
    finally:
        done = compilation.names[before:]
        if on_terminal and done:
            values = {"count": len(done), "seconds": compilation.seconds - since, "names": tuple(dict.fromkeys(done))}
            print(word("cli.compiled", **values), file=sys.stderr, flush=True)
        compilation.begun = None


@contextmanager
def bar(label: str) -> "Iterator[Progress]":
    """A progress bar on stderr, named by the label until the work names itself.

    It vanishes when the work is done, and is not there at all where nobody watches: an error stays one line.
    """
    if events.asked():
        yield events.progress(stage(label))
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(stage(label), total=None)
        yield lambda fraction, text: shown.update(task, completed=fraction, total=1.0, description=stage(text))


@contextmanager
def stages() -> "Iterator[Progress]":
    """A line for each stage on stderr, on a terminal with a bar and its time."""
    if events.asked():
        yield events.progress(stage("load"))
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        begun: set[str] = {"load"}

        def say(fraction: float, name: str) -> None:
            if name not in begun:
                begun.add(name)
                typer.echo(stage(name), err=True)

        yield say
        return
    with Progress(TextColumn("{task.description:34}"), BarColumn(), TimeElapsedColumn(), console=console) as shown:
        tasks: dict[str, TaskID] = {"load": shown.add_task(stage("load"), total=None)}
        current = tasks["load"]

        def step(fraction: float, name: str) -> None:
            nonlocal current
            if name not in tasks:
                shown.update(current, completed=1, total=1)
                tasks[name] = current = shown.add_task(stage(name), total=None)
            shown.update(current, completed=fraction or None, total=1.0 if fraction else None)

        yield step
        shown.update(current, completed=1, total=1)


def _print(result: "Check") -> None:
    """The table, as wide as its contents, and under it every fault on a line of its own."""

    def sign(direction: int | None) -> str:
        return "-" if direction is None else f"{direction:+d}"

    def number(value: float | None, form: str) -> str:
        return "-" if value is None else f"{value:{form}}"

    head = [word(f"cli.column.{name}") for name in ("cable", "channel", "moved", "direction", "stroke_mm", "slack_mm", "counts_turn")]
    rows = [
        [c.cable, c.channel, c.moved or "-", sign(c.direction), number(c.stroke_mm, ".1f"), number(c.slack_mm, "+.3f")]
        + ["-" if c.counts_per_turn is None else f"{c.counts_per_turn:.0f} / {c.expected_per_turn:g}", "" if c.faults else "ok"]
        for c in result.cables
    ]
    lines = _table([[*head, ""], *rows])
    if result.encoders:
        head = [word(f"cli.column.{name}") for name in ("encoder", "channel", "moved", "direction", "turned_deg", "back_deg")]
        rows = [
            [e.what.removeprefix("swivel of ").removeprefix("inclination "), e.channel, e.moved or "-", sign(e.direction)]
            + [number(e.turned_deg, ".1f"), number(e.back_deg, "+.3f"), "" if e.faults else "ok"]
            for e in result.encoders
        ]
        lines += _table([[*head, ""], *rows])
    rest = message("cli.samples_s_rest_counters", rate=result.rate_hz, counts=max(result.spread.values()))
    lines += [rendered(line) for line in (rest, *(message("line.fault", text=fault) for fault in result.all_faults))]
    for line in lines:
        for part in fitted(line, columns()) if sys.stdout.isatty() else [line]:
            typer.echo(part)


def _table(rows: list[list[str]]) -> list[str]:
    """Rows below each other: names to the left, at most ten letters of each, numbers to the right."""
    short = [[*(name[:10] for name in row[:3]), *row[3:]] for row in rows]
    widths = [max(len(row[j]) for row in short) for j in range(len(short[0]))]
    return [" ".join(f"{c:{'<' if j < 3 else '>'}{widths[j]}}" for j, c in enumerate(row)).rstrip() for row in short]
