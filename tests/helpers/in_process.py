"""The command line in this process: faster than a process of its own, where the process is not the subject."""

import contextlib
import io
import sys
from subprocess import CompletedProcess
from unittest import mock

from lmeasure.cli.app import main


def lmeasure(*words: object, typed: str = "") -> "CompletedProcess[str]":
    """Return the exit code, output and errors of a command, as of a process of its own."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    arguments = ["lmeasure", *map(str, words)]
    with contextlib.ExitStack() as within:
        within.enter_context(mock.patch.multiple(sys, argv=arguments, stdin=io.StringIO(typed)))
        within.enter_context(contextlib.redirect_stdout(out))
        within.enter_context(contextlib.redirect_stderr(err))
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def ran(*words: object, typed: str = "") -> str:
    """Return what a command prints; it has to succeed."""
    done = lmeasure(*words, typed=typed)
    assert done.returncode == 0, done.stderr or done.stdout
    return done.stdout


def refused(*words: object, code: int = 1) -> str:
    """Return what a command prints that ends with this exit code."""
    found, text = code_and_text(*words)
    assert found == code, (found, text)
    return text


def code_and_text(*words: object) -> tuple[int, str]:
    """Return the exit code of a command, and what it prints, then its errors without the name of the program before them."""
    done = lmeasure(*words)
    return done.returncode, done.stdout + done.stderr.removeprefix("lmeasure: ").rstrip()
