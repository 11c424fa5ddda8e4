"""The command line parses and prints; the work of a command is its workflow.

Nothing heavy is imported before a command runs, so that `lmeasure --help` answers at once. Exit codes: 0 done; 1 the data cannot give the
answer, with one line; 2 wrong usage.
"""

import atexit
import errno
import io
import json
import os
import sys
import traceback
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from lmeasure.cli import interrupts
from lmeasure.cli.help import Group, in_plain_words, wrong_use
from lmeasure.cli.text import rendered, word
from lmeasure.core import CancelledError, LMeasureError, OverwriteError, SettingsError, one_line, shortened
from lmeasure.text import faults, message
from lmeasure.workflows import COMMANDS

NO_ANSWER, WRONG_USE = 1, 2
FULL = (errno.ENOSPC, errno.EPIPE, errno.EIO, errno.EDQUOT)
REFUSED = (*FULL, errno.EINTR, errno.EROFS, errno.EACCES, errno.EPERM, errno.EFBIG, errno.EMFILE, errno.ENFILE, errno.EBUSY, errno.ESTALE)
"""Answers of a file system that are no fault of a program."""
INTERRUPTED = 130
"""Exit code of typer where Ctrl-C ended a command."""


ALIASES = {"calibrate-robot": "identify", "hand-eye": "frames", "simulate-bus": "play"}
"""Names of these commands in other programs."""
FIRST_STEPS = """lmeasure measures the pose of a robot's gripper with draw-wire encoders: the
position and orientation of every sample, and their uncertainty.

  lmeasure demo                see the whole job on a simulated cell
  lmeasure workbench FOLDER    do it step by step in your browser
  lmeasure import LOG --scan   look into a CAN log of your own

All commands: lmeasure --help"""


class Commands(Group):
    """Commands of the workflows, each made when it is used."""

    def list_commands(self, ctx: Any) -> list[str]:
        """All names, in their order."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name or alias, None for an unknown one."""
        name = ALIASES.get(cmd_name, cmd_name)
        if name not in COMMANDS:
            return None
        from lmeasure.cli.commands import command

        return command(name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the first word names; names like it are suggested where there is none."""
        from difflib import get_close_matches

        like = () if args[0] in (*COMMANDS, *ALIASES) else get_close_matches(args[0], [*COMMANDS, *ALIASES], n=3)
        if like:
            ctx.fail(word("cli.did_you_mean", name=args[0], names=tuple(like)))
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="lmeasure",
    cls=Commands,
    help="Measure the 6-DOF pose of a robot's gripper with draw-wire encoders: from raw counts to the robot's certificate.",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: drawing it would take three times as long as everything else
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


@app.callback()
def _options(
    ctx: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop; with --json also digests and libraries.")] = False,
    as_json: Annotated[bool, typer.Option("--json", hidden=True)] = False,
) -> None:
    if version and as_json:
        from lmeasure.certificate import environment

        typer.echo(json.dumps(environment(), indent=1))
    elif version:
        from lmeasure.core import version_of

        typer.echo(f"lmeasure {version_of('lmeasure')}")
    elif as_json:
        ctx.fail("--json goes behind a command, or with --version")
    if version:
        raise typer.Exit
    if ctx.invoked_subcommand is None:
        typer.echo(word("cli.first_steps"))


_code = INTERRUPTED


def program() -> NoReturn:
    """Entry point of the `lmeasure` command."""
    end_at_once()
    run()


def end_at_once() -> None:
    """End the process at once after its libraries' own exits: unloading compiled code and libraries takes a second or more. Call it before
    any of them is loaded, as the first function registered is the last called."""
    atexit.register(lambda: os._exit(_code))


def run() -> NoReturn:
    """`main`, and the exit code with which the process ends at once."""
    global _code
    try:
        main()
        _code = 0
    except SystemExit as end:
        _code = end.code if isinstance(end.code, int) else 0 if end.code is None else NO_ANSWER
        raise
    except Exception:
        _code = NO_ANSWER
        raise
    finally:
        if "lmeasure.kernels.uncompiled" in sys.modules:
            from lmeasure.kernels import compile_beside

            compile_beside()
    raise SystemExit(0)


def main() -> None:
    """Run the command in a process that continues, such as a test: it ends with SystemExit."""
    # before numpy is loaded: the matrices here are small, and threads of BLAS only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a letter gets the rest
            stream.reconfigure(errors="replace" if stream is sys.stdout else "backslashreplace")
    with interrupts.noted():
        try:
            code = app(standalone_mode=False)
            _end(code if isinstance(code, int) else 0, *([message("error.interrupted")] if code == INTERRUPTED else []))
        except typer.TyperException as error:
            print(wrong_use(error), file=sys.stderr)
            _end(error.exit_code, printed=" ".join(in_plain_words(error).split()))
        except (CancelledError, typer.Abort, KeyboardInterrupt):  # the last before the parser watches for it
            _end(INTERRUPTED, message("error.interrupted"))
        except (OverwriteError, SettingsError) as error:
            _end(WRONG_USE, *faults(error))
        except LMeasureError as error:
            _end(NO_ANSWER, *faults(error))
        except MemoryError as error:
            _end(NO_ANSWER, message("cli.memory", error=error))
        except OSError as error:
            from lmeasure.io import not_written, os_reason

            if error.errno in REFUSED and error.filename is not None:
                _end(NO_ANSWER, not_written(Path(os.fsdecode(error.filename)), error, "cli.file"))
            if error.errno not in FULL or error.filename is not None:
                _unforeseen(error)
            _end(NO_ANSWER, message("cli.output", error=os_reason(error)))
        except Exception as error:
            if interrupts.came():  # while something was being loaded, which is now half there
                _end(INTERRUPTED, message("error.interrupted"))
            _unforeseen(error)


def _unforeseen(error: Exception) -> NoReturn:
    """Print an unforeseen error in one line; with the traceback if LMEASURE_DEBUG is set."""
    if os.environ.get("LMEASURE_DEBUG"):
        raise error
    at = traceback.extract_tb(error.__traceback__)[-1]
    fault = f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno}: {shortened(str(error))}"
    from lmeasure.core import plug_in_of, plug_ins_in_use

    if package := plug_in_of(error):
        _end(NO_ANSWER, message("cli.fault_of_package", package=package, fault=fault))
    _end(NO_ANSWER, message("cli.fault", fault=fault + plug_ins_in_use()))


def _end(code: "int | str | None", *texts: str, printed: str = "") -> NoReturn:
    """End with that exit code. Print the texts on standard error, a line each, and the remaining output if possible. The texts, or one that
    was already printed, are the error of `--json`."""
    for text in filter(None, texts):
        print(f"lmeasure: {one_line(rendered(text))}", file=sys.stderr)
    lines = [one_line(text) for text in texts if text]
    try:
        if (lines or printed) and isinstance(code, int) and sys.stdout is not None:
            from lmeasure.cli import machine

            if machine.enabled():
                print(machine.written(machine.of_error(code, lines or [printed])))
        if sys.stdout is not None:  # closed by the caller
            sys.stdout.flush()
    except OSError as error:
        # otherwise the interpreter tries again at its end and prints its own error
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not lines:
            from lmeasure.io import os_reason

            lost = word("cli.output_files_whole", error=os_reason(error))
            print(f"lmeasure: {lost}", file=sys.stderr)
        code = code or NO_ANSWER
    raise SystemExit(code) from None
