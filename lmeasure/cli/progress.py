"""Display of a working command: a bar that vanishes, stages that stay, a table of a recording, questions."""

import os
import queue
import shutil
import sys
import tempfile
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import typer

from lmeasure.cli import events, machine
from lmeasure.cli.interrupts import heeded
from lmeasure.cli.text import rendered, stage, word
from lmeasure.core import CancelledError, SettingsError
from lmeasure.kernels import compilation
from lmeasure.text import message

if TYPE_CHECKING:
    from lmeasure.acquisition import Check, Step
    from lmeasure.procedures import Session
    from lmeasure.workflows import CommandSettings, Progress, Result, Workflow


LEAST_COLUMNS = 20
REDRAWN_S = 0.1
INDENT = 4
"""Indent of the rest of a line that is too long, beyond its own."""

termios: ModuleType | None
try:
    import termios
except ImportError:  # Windows: its console does the editing
    termios = None


def columns() -> int:
    """Return the characters that a line may have now; the last column stays empty, as some terminals wrap there."""
    return max(shutil.get_terminal_size().columns - 1, LEAST_COLUMNS)


def fitted(text: str, width: int) -> list[str]:
    """Return the text in lines that are no wider, broken at two blanks, so that a name stays beside its value, else between words."""
    out = []
    for line in text.split("\n"):
        begin = line[: len(line) - len(line.lstrip())]
        if len(line) <= width:
            out.append(line)
            continue
        blank = "  " if "  " in line.strip() else " "
        row = ""
        for piece in line.strip().split(blank):
            if row.strip() and len(row) + len(blank) + len(piece) > width:
                out.append(row)
                row = begin + " " * INDENT + piece
            else:
                row = f"{row}{blank}{piece}" if row.strip() else begin + piece
            if len(row) > width:  # a piece that no line can hold
                *full, row = textwrap.wrap(row, width, subsequent_indent=begin + " " * INDENT, break_on_hyphens=False)
                out += full
        out.append(row)
    return out


def cut(text: str, width: int) -> str:
    """The text, or its first words: no half of a number is shown."""
    if len(text) <= width:
        return text
    head = text[: width - 1]
    if text[width - 1] != " " and " " in head:
        head = head.rsplit(" ", 1)[0]
    return f"{head.rstrip()}…"


class TypedLines:
    """Lines of standard input as they are typed, read beside the work; nothing is read before the first question for them.

    If the terminal allows it, `state_line` shows the letters: the terminal would put them into a line that is being renewed. pending is the
    typed part of an unfinished line.
    """

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[tuple[str, float]] = queue.SimpleQueue()
        self._by_person = events.enabled()
        self.waited_s = 0.0
        """Time that the last lines had waited, where a person typed them; a script may type ahead [s]."""
        self._ended = self.gone = False
        self._before: list[Any] | None = None
        self._reader: threading.Thread | None = None
        self.pending = ""

    def typed(self) -> list[str]:
        """Those since the last question."""
        if self._reader is None:
            self._begin()
        ended, out, self.waited_s = self._ended, [], 0.0
        while not self._lines.empty():
            line, at = self._lines.get()
            out.append(line)
            self.waited_s = max(self.waited_s, time.monotonic() - at) if self._by_person else 0.0
        self.gone = ended
        return out

    def answer(self, text: str) -> str:
        """The next line, as the answer to a question of another program's page; typer.Abort where there is none."""
        events.tell("asked", text=rendered(text), number=0, of=0)
        while not (lines := self.typed()):
            if self.gone:
                raise typer.Abort
            time.sleep(0.05)
        for later in lines[1:]:
            self._lines.put((later, time.monotonic()))
        return lines[0]

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._before is not None and termios is not None:
            with suppress(OSError, termios.error):
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._before)
            self._before = None

    def _begin(self) -> None:
        read = self._read_lines
        if termios is not None and sys.stdin is not None and sys.stdin.isatty() and sys.stderr is not None and sys.stderr.isatty():
            self._before = termios.tcgetattr(sys.stdin.fileno())
            own = termios.tcgetattr(sys.stdin.fileno())
            own[3] &= ~(termios.ECHO | termios.ICANON)  # Ctrl-C is still Ctrl-C
            own[6][termios.VMIN], own[6][termios.VTIME] = 1, 0
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, own)
            read, self._by_person = self._read_letters, True
        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()

    def _read_lines(self) -> None:
        if sys.stdin is not None:
            for line in sys.stdin:
                self._lines.put((line.rstrip("\n"), time.monotonic()))
        self._ended = True

    def _read_letters(self) -> None:
        import codecs

        decoder = codecs.getincrementaldecoder(sys.stdin.encoding or "utf-8")("replace")
        while part := os.read(sys.stdin.fileno(), 1024):
            text = decoder.decode(part)
            if text.startswith("\x1b"):  # an arrow, or another key without a letter
                continue
            for letter in text:
                if letter in "\r\n":
                    self._lines.put((self.pending, time.monotonic()))
                    self.pending = ""
                elif letter in "\x7f\b":
                    self.pending = self.pending[:-1]
                elif letter in "\x15\x17":  # Ctrl-U, Ctrl-W
                    self.pending = ""
                elif letter == "\x04" and not self.pending:  # Ctrl-D
                    self._ended = True
                    return
                elif letter.isprintable():
                    self.pending += letter
        self._ended = True


@contextmanager
def state_line(keys: TypedLines | None = None) -> "Iterator[tuple[Callable[[str], None], Callable[[str], None] | None]]":
    """Yield a function that prints lines, and one that renews a line on a terminal, at most ten times a second, with the typed text at its
    end. Both use the reader's language, and no line is wider than the terminal."""
    if events.enabled():
        yield lambda text: events.tell("said", text=rendered(text)), events.Paced("state")
        return
    on_terminal = sys.stderr is not None and sys.stderr.isatty()
    shown, state = 0.0, ""

    def clear() -> None:
        nonlocal state
        if state:
            print(f"\r{'':{min(len(state), columns())}}\r", end="", file=sys.stderr, flush=True)
        state = ""

    def say(text: str) -> None:
        text = rendered(text)
        if on_terminal:
            clear()
        for line in fitted(text, columns()) if on_terminal and sys.stdout.isatty() else [text]:
            typer.echo(line)

    def show(text: str) -> None:
        nonlocal shown, state
        if time.monotonic() - shown < REDRAWN_S:
            return
        width, pending = columns(), "" if keys is None else keys.pending
        typed = f"  > {pending[-width // 2 :]}" if pending else ""
        new = cut(rendered(text), width - len(typed)) + typed
        print(f"\r{new:{min(len(state), width)}}", end="\b" * max(min(len(state), width) - len(new), 0), file=sys.stderr, flush=True)
        shown, state = time.monotonic(), new

    try:
        yield say, show if on_terminal else None
    finally:
        if on_terminal:
            clear()
        if keys is not None:
            keys.close()


def with_bar(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Under a progress bar."""
    with bar(workflow.name) as progress:
        return workflow.run(settings, heeded(progress))


def quietly(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Run without a word."""
    return workflow.run(settings, heeded(lambda fraction, text: None))


def recording(workflow: "Workflow", settings: "Any") -> "Result":
    """Show the table of a recording, if it is wanted."""
    if not settings.live:
        return workflow.run(settings)
    from lmeasure.accuracy import radii_95  # noqa: F401 - takes long, and not while frames come

    if events.enabled():
        return workflow.run(settings, show=events.live)
    from lmeasure.cli.live import live_table

    with live_table() as show:
        return workflow.run(settings, show=show)


def watching(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Show the table of the incoming counts."""
    if events.enabled():
        return workflow.run(settings, show=events.live)
    from lmeasure.cli.live import live_table

    with live_table() as show:
        return workflow.run(settings, show=show)


def questions(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Ask the user to act while the counts are shown, then show the table of results."""
    from lmeasure.acquisition import Finished

    keys = TypedLines()
    alone = sys.stdin is not None and sys.stdin.isatty() and not events.enabled()
    with state_line(keys) as (say, show):

        def ask(step: "Step") -> str:
            text, begun = rendered(step.text), time.monotonic()
            finished, warned = Finished(step, begun), False
            say(f"{step.number}/{step.of} {word('cli.or_wait' if alone and not step.question else 'cli.press_enter', text=text)}")
            if events.enabled():  # a page has a button for it
                events.tell("asked", text=text, number=step.number, of=step.of, act=step.act)
            while True:
                lines = keys.typed()
                if alone and lines and time.monotonic() - keys.waited_s < begun + JUST_BEGUN_S:
                    lines = []  # typed for the previous step, which has continued by itself
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
                if events.enabled():
                    events.moved(step.moved())
                if finished.seen(time.monotonic()) and alone:
                    return ""

        result: Result = workflow.run(settings, lambda fraction, text: say(text), ask=ask)
    _print(result.made)
    return result


def capturing(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Show lines for readings and one line for the state, and take lines that a user or a script types."""
    on_terminal = sys.stdin is not None and sys.stdin.isatty()

    def ask(text: str) -> str:
        return str(typer.prompt("\n".join(fitted(rendered(text), columns())), default="", show_default=False, prompt_suffix=": "))

    keys = TypedLines()
    with state_line(keys) as (say, line):

        def show(session: "Session") -> None:
            if line is not None:
                line(session.line())
            if events.enabled():
                events.captured(session)

        def progress(fraction: float, text: str) -> None:
            if events.enabled() and keys.gone:  # the caller has gone: end as by Ctrl-C
                raise CancelledError

        if on_terminal or events.enabled():
            return workflow.run(settings, progress, say=say, keys=keys, ask=ask if on_terminal else keys.answer, show=show)
        return workflow.run(settings, say=say, keys=keys)


def opens_pages(settings: "Any") -> bool:
    """Return whether the page of a command is opened in a browser: on a terminal, unless switched off."""
    on_terminal = sys.stdout is not None and sys.stdout.isatty()
    return bool(getattr(settings, "browser", False)) and on_terminal and not events.enabled() and not machine.enabled()


def inspecting(workflow: "Workflow", settings: "Any") -> "Result":
    """Show a bar; a page without a name is written to a temporary folder, where it is opened."""
    name = next(name for name in ("report", "out") if name in type(settings).model_fields)
    if opens_pages(settings) and getattr(settings, name) is None and getattr(settings, "scan", True):
        settings = settings.model_copy(update={name: Path(tempfile.mkdtemp(prefix="lmeasure-")) / "inspect.html"})
    return with_bar(workflow, settings)


def listening(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Show a progress bar, and the senders for other programs."""
    with bar(workflow.name) as progress:
        return workflow.run(settings, progress, show=events.spoken if events.enabled() else None)


def playing(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Take lines that a user, a page or a script types, until their end."""
    keys = TypedLines()
    with state_line(keys) as (say, _):
        return workflow.run(settings, say=say, keys=keys, show=events.played if events.enabled() else None)


def beginning(workflow: "Workflow", settings: "Any") -> "Result":
    """Ask questions that no template answers."""

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


def with_stages(workflow: "Workflow", settings: "CommandSettings") -> "Result":
    """Show a line for each stage."""
    with stages() as progress:
        return workflow.run(settings, heeded(progress))


def in_browser(workflow: "Workflow", settings: "Any") -> "Result":
    """Show the address of its pages."""
    try:
        from lmeasure.workbench import ON_LOOPBACK, Site, serve
    except ModuleNotFoundError as error:
        from lmeasure.core import LMeasureError, how_to_install

        raise LMeasureError(message("error.the_workbench_needs_which", name=error.name, install=how_to_install("workbench"))) from error

    if settings.browser and not opens_pages(settings):
        settings = settings.model_copy(update={"browser": False})

    def served(requested: "Any", say: Callable[[str], None], show: Callable[[str], object] | None) -> None:
        site = Site(requested.host, requested.tls_certificate, requested.tls_key) if requested.host else ON_LOOPBACK
        about = {"within": requested.within, "site": site, "scheduler": requested.scheduler}
        serve(requested.folder, requested.port, requested.language, say, show=show, **about)

    return workflow.run(settings, lambda fraction, address: typer.echo(word("cli.workbench_at", address=address)), serve=served)


JUST_BEGUN_S = 0.5
"""Time for which a step ignores answers, which may have been meant for the one before."""
Face = Callable[["Workflow", Any], "Result"]
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
"""Faces of commands that show something else than a bar."""


SILENT = (with_bar, with_stages, inspecting)
"""Faces that only show progress."""


@contextmanager
def reported_compiling() -> Iterator[None]:
    """Report on a terminal that kernels are being compiled, which takes long once, and afterwards for how long it was."""

    def begun(name: str) -> None:
        print(word("cli.compiling", name=name), file=sys.stderr, flush=True)

    def listed(name: str) -> None:
        events.tell("compiling", text=name)

    before, since = len(compilation.names), compilation.seconds
    on_terminal = not events.enabled() and sys.stderr is not None and sys.stderr.isatty()
    compilation.begun = listed if events.enabled() else begun if on_terminal else None
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
    """Show a progress bar on stderr, named by the label until the work names itself.

    It vanishes when the work is done, and does not appear without a terminal: an error stays one line.
    """
    if events.enabled():
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
    if events.enabled():
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
