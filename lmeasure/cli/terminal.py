"""A terminal on which lines stand, and under them one that is renewed, with what a person types at its end."""

import os
import queue
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import ModuleType
from typing import Any

import typer

from lmeasure.cli import events
from lmeasure.cli.text import rendered

LEAST_COLUMNS = 20
REDRAWN_S = 0.1
INDENT = 4
"""Of what is left of a line that is too long, beyond its own."""

termios: ModuleType | None
try:
    import termios
except ImportError:  # Windows: its console does the editing
    termios = None


def columns() -> int:
    """As many characters as a line may have now; the last place of a terminal stays empty, or some go on to the next line by themselves."""
    return max(shutil.get_terminal_size().columns - 1, LEAST_COLUMNS)


def fitted(text: str, width: int) -> list[str]:
    """The text in lines that are no wider: broken where two blanks stand, so that a name stays beside its value, else between words."""
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

    On a terminal that lets them, letters are shown by `state_line` and not by the terminal, which would put them where a line is being
    renewed: pending is what has been typed of the line that is not ended.
    """

    def __init__(self) -> None:
        self._lines: queue.SimpleQueue[tuple[str, float]] = queue.SimpleQueue()
        self._by_person = events.asked()
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
    """What prints lines, and what renews one on a terminal, ten times a second at most, with what is being typed at its end. Both in the
    reader's language, and none wider than the terminal."""
    if events.asked():
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
