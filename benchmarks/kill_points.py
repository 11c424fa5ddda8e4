"""Kill every command that writes at each rename and each fsync once: every file is whole or absent afterwards, and the rerun works.

    python benchmarks/kill_points.py [COMMAND ...]

Each command of `tests/cli/desk.py` runs in a process that ends (as by SIGKILL) before and after its n-th such call, for every n. A file is
whole when it has the bytes of a run that was not killed; of files whose bytes differ from run to run only the names are compared. The table
goes to benchmarks/results/kill_points.md.
"""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "cli"), str(ROOT / "tests")]
from desk import SHORT, set_up  # noqa: E402

from lmeasure import files  # noqa: E402

CALLS = ("replace", "rename", "fsync")
KILLED = 137


@contextmanager
def killed_at(number: int, *, after: bool) -> Iterator[list[int]]:
    """End the process at that rename or fsync, counted from 1; 0 ends it never. The value counts them."""
    count, usual, exchange = [0], {name: getattr(os, name) for name in CALLS}, files.exchange

    def wrapped(call: Any) -> Any:
        def at(*args: Any, **more: Any) -> Any:
            count[0] += 1
            if count[0] == number and not after:
                os._exit(KILLED)
            result = call(*args, **more)
            if count[0] == number:
                os._exit(KILLED)
            return result

        return at

    for name in CALLS:
        setattr(os, name, wrapped(usual[name]))
    files.exchange = wrapped(exchange)
    try:
        yield count
    finally:
        for name in CALLS:
            setattr(os, name, usual[name])
        files.exchange = exchange


def ended(line: str, out: Path, number: int = 0, *, after: bool = False, force: bool = False) -> tuple[int, int]:
    """Run a command in a child process; return its exit code and how many renames and fsyncs it made."""
    from lmeasure.cli import main

    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            sys.argv = ["lmeasure", *line.replace("OUT", str(out)).split(), *(["--force"] if force else [])]
            with killed_at(number, after=after) as count, redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                try:
                    main()
                    code = 0
                except SystemExit as end:
                    code = end.code if isinstance(end.code, int) else 1
            os.write(write, str(count[0]).encode())
        finally:
            os._exit(code)
    os.close(write)
    with os.fdopen(read) as told:
        count_text = told.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), int(count_text or 0)


def made(out: Path) -> dict[str, bytes]:
    """Return the files of a folder but for unfinished ones, by their names."""
    every = (path for path in out.rglob("*") if path.is_file() and ".part" not in str(path.relative_to(out)))
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in every}


def looked_at(line: str, here: Path) -> tuple[int, list[str]]:
    """Return at how many points a command was killed, and what was wrong then."""
    out, wrong = here / "out", []
    whole: list[dict[str, bytes]] = []
    for _ in range(2):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        code, count = ended(line, out)
        if code:
            return 0, [f"exit code {code} without a kill"]
        whole.append(made(out))
    same = {name for name in whole[0] if whole[0][name] == whole[1].get(name)}
    for number in range(1, count + 1):
        for after in (False, True):
            at = f"{'after' if after else 'before'} call {number} of {count}"
            shutil.rmtree(out)
            out.mkdir()
            if ended(line, out, number, after=after)[0] != KILLED:
                wrong.append(f"{at}: was not killed")
                continue
            left = made(out)
            wrong += [f"{at}: {n} is strange or torn" for n, c in left.items() if n not in whole[0] or (n in same and c != whole[0][n])]
            code, _ = ended(line, out, force=bool(left))
            again = made(out)
            if code or set(again) != set(whole[0]) or any(again[n] != whole[0][n] for n in same):
                wrong.append(f"{at}: the rerun ended with {code} and {len(again)} of {len(whole[0])} files")
            if any(".part" in path.name for path in out.rglob("*")):
                wrong.append(f"{at}: the rerun left an unfinished file")
    return 2 * count, wrong


def main() -> None:
    """Write the table."""
    rows = ["| command | killed at | wrong |", "|---|---|---|"]
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        set_up(here)
        os.chdir(here)
        ended("init . --template six-cables", here)
        for name in sys.argv[1:] or SHORT:
            points, wrong = looked_at(SHORT[name], here)
            rows.append(f"| `{name}` | {points} | {'; '.join(wrong[:3]) or 'nothing'} |")
            print(rows[-1], flush=True)
    text = "# Commands killed at each rename and fsync\n\n`python benchmarks/kill_points.py`\n\n" + "\n".join(rows) + "\n"
    (ROOT / "benchmarks" / "results" / "kill_points.md").write_text(text)


if __name__ == "__main__":
    main()
