"""`python -m lmeasure` and the `lmeasure` command. Ctrl-C ends in one line from the first moment on, before anything else is loaded."""

import gc
import os
import sys
from typing import NoReturn

INTERRUPTED = 130
ALLOCATED = 50_000
"""New objects after which Python looks for garbage: loading makes hardly any, and the usual 700 cost a tenth of a short command."""


def program() -> NoReturn:
    """The command line in a process of its own."""
    gc.set_threshold(ALLOCATED, 20, 20)
    try:
        from lmeasure.cli import program as begun

        begun()
    except KeyboardInterrupt:
        print("lmeasure: interrupted. Nothing was left half-written", file=sys.stderr, flush=True)
        os._exit(INTERRUPTED)


if __name__ == "__main__":
    program()
