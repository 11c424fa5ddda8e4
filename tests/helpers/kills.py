"""What a kill or a power failure would leave of a command's files, at every rename, removal and fsync that it makes.

A kill leaves what the file system has at that instant, so one run is enough to see what a kill at each of these calls leaves. A power
failure leaves what an fsync has brought to the disk: the bytes of a file by one of the file, a name by one of its folder.
"""

import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

from lmeasure.cli.app import main
from lmeasure.io import files

CALLS = ("replace", "rename", "unlink", "rmdir", "fsync")
ABSENT_FOR_A_WHILE = {"key.pub"}
"""Gone while the private key is replaced: two keys of different pairs would be worse than one alone."""
WRITTEN_TWICE = {"demo.json"}
"""Says first that the demo has not ended, then what it found."""
Content = dict[str, bytes | None]
"""Bytes of files by their names in a folder; None for folders."""


@dataclass
class Observation:
    """calls: how many there were; states: what the folder held at them, each once; wrong: what was not on the disk when it had to be."""

    calls: int = 0
    states: list[Content] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


def content(folder: Path) -> Content:
    """Return what a folder holds."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def made(state: Content) -> dict[str, bytes]:
    """Return the files of a state under their own names."""
    return {name: data for name, data in state.items() if data is not None and ".part" not in name and ".old" not in name}


@contextmanager
def watched(folder: Path) -> Iterator[Observation]:
    """Look at a folder at each call of the block, and at its end; what it holds at the beginning counts as being on the disk."""
    seen = Observation()
    on_disk: dict[int, Any] = {path.stat().st_ino: _stamp(path) for path in [folder, *folder.rglob("*")]}
    usual, exchange = {name: getattr(os, name) for name in CALLS}, files.exchange

    def look(when: str = "when it has its name") -> None:
        state = content(folder)
        if state not in seen.states:
            seen.states.append(state)
        late = [name for name in made(state) if on_disk.get((folder / name).stat().st_ino) != _stamp(folder / name)]
        seen.wrong.extend(f"{name}: its bytes are not on the disk {when}" for name in late)

    def named_too_early(path: Path) -> None:
        inner = [one for one in [path, *path.rglob("*")] if one.is_dir()] if path.is_dir() and path.is_relative_to(folder) else []
        late = [one for one in inner if on_disk.get(one.stat().st_ino) != _stamp(one)]
        seen.wrong.extend(f"{one.name}: gets its name before the names in it are on the disk" for one in late)

    def wrapped(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def at(*args: Any, **more: Any) -> Any:
            seen.calls += 1
            look()
            if name in ("replace", "rename", "exchange"):
                named_too_early(Path(args[0]))
            result = call(*args, **more)
            if name == "fsync":
                on_disk[os.fstat(args[0]).st_ino] = _stamp(args[0])
            look()
            return result

        return at

    for name, call in usual.items():
        setattr(os, name, wrapped(name, call))
    files.exchange = wrapped("exchange", exchange)
    try:
        yield seen
        look("at the end")
        for one in [folder, *(path for path in folder.rglob("*") if path.is_dir())]:
            known = on_disk.get(one.stat().st_ino) or {}
            lost = [path.name for path in one.iterdir() if (path.name, path.stat().st_ino) not in known]
            seen.wrong.extend(f"{(one / name).relative_to(folder)}: its name is not on the disk at the end" for name in lost)
    finally:
        for name, call in usual.items():
            setattr(os, name, call)
        files.exchange = exchange
        seen.wrong[:] = dict.fromkeys(seen.wrong)


def _stamp(path: Path | int) -> Any:
    """Return what is different once a file has other bytes, or a folder other names."""
    found = os.stat(path)  # noqa: PTH116 - of an open file too
    if stat.S_ISDIR(found.st_mode):
        return {(entry.name, entry.inode()) for entry in os.scandir(path)}
    return found.st_size, found.st_mtime_ns


def ended(line: str, out: Path, *, force: bool = False) -> int:
    """Run a command line in this process, OUT in it being that folder; return its exit code."""
    argv = sys.argv
    sys.argv = ["lmeasure", *line.replace("OUT", str(out)).split(), *(["--force"] if force else [])]
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        sys.argv = argv
    return 0


def lay(state: Content, folder: Path, process: int) -> None:
    """Let a folder hold a state alone, the unfinished files in it being those of another process."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, data in state.items():
        path = folder / name.replace(f".{os.getpid()}.", f".{process}.")
        path.mkdir(parents=True, exist_ok=True) if data is None else path.write_bytes(data)


@dataclass(frozen=True)
class KillReport:
    """calls: of how many the states were looked at; reruns: from how many states the command was run again; wrong: what was wrong."""

    calls: int
    reruns: int
    wrong: list[str]


def looked_at(line: str, out: Path, most_reruns: int = 1000) -> KillReport:
    """Look at a command that writes its files for the first time, then at one that replaces others, and run it again from what is left.

    At each call a file has the bytes that were there before or those at the end; the files of a certificate have either together. Run
    again from each state, the command writes the same names, and the same bytes where it does so at all.
    """
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    wrong: list[str] = []
    left: dict[Any, Content] = {}
    finals: list[dict[str, bytes]] = []
    calls = 0
    for force in (False, True):
        before: Content = {}
        if force:  # the same files, each a byte longer, and somebody else's
            before = {name: data if data is None else data + b"\n" for name, data in content(out).items()}
        lay(before, out, gone.pid)
        with watched(out) as seen:
            code = ended(line, out, force=force)
        when = "replacing: " if force else ""
        if code:
            return KillReport(calls, 0, [*wrong, f"{when}exit code {code}"])
        finals.append(made(content(out)))
        calls += seen.calls
        wrong += [when + text for text in seen.wrong]
        for state in seen.states:
            wrong += [when + text for text in torn(made(state), made(before), finals[-1])]
            kinds = {name: data == finals[-1].get(name) for name, data in state.items()}
            left.setdefault(tuple(kinds.items()), state)
    names, same = set(finals[0]), {name for name in finals[0] if finals[0][name] == finals[1].get(name)}
    states = list(left.values())
    for state in states[:: -(-len(states) // most_reruns)]:
        lay(state, out, gone.pid)
        code = ended(line, out, force=bool(made(state)))
        again = content(out)
        if code or set(made(again)) != names or any(again[name] != finals[0][name] for name in same):
            wrong.append(f"run again from {sorted(state)}: exit code {code}, {len(made(again))} of {len(names)} files")
        if len(made(again)) != sum(data is not None for data in again.values()):
            wrong.append(f"run again from {sorted(state)}: an unfinished file is left")
    return KillReport(calls, len(states[:: -(-len(states) // most_reruns)]), list(dict.fromkeys(wrong)))


def _once(state: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in state.items() if Path(name).name not in WRITTEN_TWICE}


def torn(state: dict[str, bytes], before: dict[str, bytes], final: dict[str, bytes]) -> list[str]:
    """Return what is wrong with a state between two others."""
    wrong = [f"{name}: is half-written" for name, data in _once(state).items() if data not in (before.get(name), final.get(name))]
    gone = [name for name in before if name not in state and name in final and Path(name).name not in ABSENT_FOR_A_WHILE]
    wrong += [f"{name}: is gone for a while" for name in gone]
    for folder in {name.rpartition("/")[0] for name in final if name.endswith("manifest.json")}:
        own = {name for name in final if name.startswith(f"{folder}/")}
        new = {name for name in own if state.get(name) == final[name] != before.get(name)}
        old = {name for name in own if state.get(name) != final[name]}
        if new and old:
            wrong.append(f"{folder}: is of two certificates")
    return wrong
