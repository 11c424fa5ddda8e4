"""The command line: it parses and prints; what a command does is its workflow.

Nothing heavy is imported before a command runs, so that `lmeasure --help` answers at once. Exit codes: 0 done; 1 the data cannot give the
answer, said in one line; 2 wrong usage.
"""

import errno
import os
import sys
import traceback
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from lmeasure.errors import CancelledError, LMeasureError, OverwriteError, SettingsError, shortened
from lmeasure.workflows import COMMANDS

NO_ANSWER, WRONG_USE = 1, 2
FULL = (errno.ENOSPC, errno.EPIPE, errno.EIO, errno.EDQUOT)
INTERRUPTED = 130
"""Exit code of typer where Ctrl-C ended a command."""


class Commands(TyperGroup):
    """The commands of the workflows, each made when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """All names, in their order."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command, None for an unknown one."""
        if cmd_name not in COMMANDS:
            return None
        from lmeasure.cli.commands import command

        return command(cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Names and first sentences, without a look at what they stand for."""
        TyperGroup(commands={name: TyperCommand(name, help=text) for name, text in COMMANDS.items()}).format_commands(ctx, formatter)


app = typer.Typer(
    name="lmeasure",
    cls=Commands,
    help="Cables, drums and encoders as a 6-DOF metrology instrument: from raw counts to the certificate of a robot.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: drawing it would take three times as long as everything else
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"lmeasure {version('lmeasure')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")] = False,
) -> None:
    pass


def main() -> None:
    """Entry point of the `lmeasure` command."""
    # before numpy is loaded: the matrices here are small, and threads of BLAS only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer has caught the interrupt, and says nothing
            print(f"lmeasure: {CancelledError()}", file=sys.stderr)
        _end(end.code)
    except CancelledError as error:
        _end(INTERRUPTED, str(error))
    except (OverwriteError, SettingsError) as error:
        _end(WRONG_USE, str(error))
    except LMeasureError as error:
        _end(NO_ANSWER, str(error))
    except MemoryError as error:
        _end(NO_ANSWER, f"this machine's memory is not enough for what was asked: {error}")
    except OSError as error:
        if error.errno not in FULL or error.filename is not None:
            _unforeseen(error)
        _end(NO_ANSWER, f"standard output cannot be written: {error.strerror}")
    except Exception as error:
        _unforeseen(error)


def _unforeseen(error: Exception) -> NoReturn:
    """What no module foresaw, in one line; with the traceback where LMEASURE_DEBUG asks for it."""
    if os.environ.get("LMEASURE_DEBUG"):
        raise error
    at = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(at.filename).name}:{at.lineno}"
    _end(
        NO_ANSWER,
        f"a fault of this program, {type(error).__name__} in {place}: {shortened(str(error))}; nothing was left half-written. Please "
        "report this line, the command and its files; with LMEASURE_DEBUG=1 set the command says more",
    )


def _end(code: "int | str | None", text: str = "") -> NoReturn:
    """End with that exit code, the text on standard error, and what is still held of the output written, if it can be."""
    if text:
        print(f"lmeasure: {' '.join(text.split())}", file=sys.stderr)
    try:
        if sys.stdout is not None:  # closed by whoever called
            sys.stdout.flush()
    except OSError as error:
        # the interpreter would try again at its end, and say so in its own way
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not text:
            print(f"lmeasure: standard output cannot be written: {error.strerror}; files are whole", file=sys.stderr)
        code = code or NO_ANSWER
    raise SystemExit(code) from None
