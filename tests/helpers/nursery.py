"""Recorders by the dozen without starting Python for each: a line `OUT FILE_SIZE_LIMIT ARGUMENT ...` (tabs between) on stdin forks one.

It answers with the child's process id, and with its exit status once `wait` is asked. What the child prints goes to OUT.txt.
"""

import os
import resource
import sys
from pathlib import Path


def main() -> None:
    """Answer lines until the input ends."""
    # everything a recorder needs, once
    import can  # noqa: F401

    import lmeasure.acquisition.session
    import lmeasure.simulation  # noqa: F401
    from lmeasure.cli.app import main as lmeasure_main

    print("ready", flush=True)
    child = 0
    for line in sys.stdin:
        out, *rest = line.rstrip("\n").split("\t")
        if out == "wait":
            print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
            continue
        child = os.fork()
        if child:
            print(child, flush=True)
            continue
        said = os.open(Path(out), os.O_CREAT | os.O_WRONLY)
        os.dup2(said, 1)
        os.dup2(said, 2)
        limit = int(rest[0])
        if limit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        sys.argv = ["lmeasure", *rest[1:]]
        code = 0
        try:
            lmeasure_main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
