"""Set up lmeasure beside this file, then run it. Needs only Python itself.

    python3 run.py                      set up, then the demo (--no-browser: open no page)
    python3 run.py test [PYTEST ARGS]   set up, then the tests: the whole suite on all processors, named files in one process
    python3 run.py test --fast          set up, then the tests of a minute: laws, contract, one way through all commands, texts
    python3 run.py docs                 set up, then build the documentation in build/docs and open it (--no-browser: only build)
    python3 run.py COMMAND ...          set up, then `lmeasure COMMAND ...`

Everything is installed into `.venv` in this folder by uv: the one on the PATH, else one that pip fetches; by pip where uv cannot.
Settings of pip (indexes, constraints) hold for uv too. The installer's output goes to `.venv/set-up.log`. A stamp written last
says what was installed: when nothing changed the set-up is only checked, and one that was interrupted is begun again.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036 - this line is for those whose Python is older
    sys.exit("run.py: lmeasure needs Python 3.11 or newer; this is Python %d.%d (%s)" % (*sys.version_info[:2], sys.executable))  # noqa: UP031

import hashlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
WINDOWS = os.name == "nt"
LAST_LINES = 20
"""Of the installer's output, shown when it fails."""
SAME_IN_UV = {name: name for name in ("index-url", "extra-index-url", "find-links", "constraint")}
NOT_FOR_UV = {
    "cert",
    "default-timeout",
    "timeout",
    "retries",
    "disable-pip-version-check",
    "no-cache-dir",
    "cache-dir",
    "root-user-action",
    "progress-bar",
    "break-system-packages",
    "require-virtualenv",
}
"""Settings of pip that say nothing of where packages come from; certificates are the system's in uv."""
ON_ALL_PROCESSORS = ("-n", str(min((os.cpu_count() or 1) + 1, 8)), "--dist", "worksteal")
"""Of the whole suite. A worker goes through neighbouring tests, which share what is made once, and at the end takes others' tests. One
more than there are processors: tests of programs and pages wait for a good part of their time."""
FAST = (
    "tests/cli/test_commands.py", "tests/cli/test_json_of_every_command.py", "tests/core", "tests/estimation/test_least_squares.py",
    "tests/kernels/test_cable.py", "tests/kernels/test_screw.py",
    "tests/layout", "tests/recording", "tests/rig", "tests/sensors/test_lengths.py",
    "tests/text", "tests/trajectory/test_truth.py", "tests/documents/test_docs.py::test_links_lead_to_files",
    "tests/documents/test_docs.py::test_every_command_line_names_a_command_and_options_that_there_are",
)  # fmt: skip
"""Of a minute: the contract and one way through all commands, laws of arrays, kernels and files, the layout, and texts."""
OF_ALL_COMMANDS = ("-h", "--help", "--version")
"""Options that are not the demo's where no command is named."""
PROBE = "import importlib.metadata as m, sys; m.distribution('lmeasure'); print(sys.version)"


class SetUpError(Exception):
    """The set-up cannot be done; the text is one line for the person at the keyboard."""


def plan(arguments: list[str]) -> tuple[frozenset[str], list[str]]:
    """(extras to install, command inside the environment) for the arguments of this script; the command's first word is its script."""
    if not arguments or (arguments[0].startswith("-") and arguments[0] not in OF_ALL_COMMANDS):
        return frozenset(), ["lmeasure", "demo", *arguments]
    if arguments[0] == "test":
        fast = FAST if "--fast" in arguments else ()
        others = [a for a in arguments[1:] if a != "--fast"]
        return frozenset({"test"}), ["pytest", *(() if names_some(others) else ON_ALL_PROCESSORS), *fast, *others]
    if arguments[0] == "docs":
        return frozenset({"docs"}), ["python", str(ROOT / "docs" / "build_site.py"), *arguments[1:]]
    return frozenset({"workbench"} if arguments[0] == "workbench" else ()), ["lmeasure", *arguments]


def names_some(arguments: list[str]) -> bool:
    """Whether arguments of pytest name files or folders: a few tests begin sooner in one process, and can be looked into."""
    return any(not a.startswith("-") and (ROOT / a.partition("::")[0]).exists() for a in arguments)


def script(name: str) -> Path:
    """Path of a program inside the environment."""
    return VENV / "Scripts" / f"{name}.exe" if WINDOWS else VENV / "bin" / name


def identity() -> dict[str, str]:
    """What the environment was made from; a change of the first two needs a new one, of the last a new installation."""
    return {"folder": str(ROOT), "python": sys.version, "pyproject": hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()}


def read_stamp(path: Path) -> dict[str, Any]:
    """The stamp of the last complete set-up; empty when there is none."""
    try:
        stamp = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) and isinstance(stamp.get("extras"), list) else {}


def write_stamp(path: Path, made_from: dict[str, str], extras: frozenset[str]) -> None:
    """Write the stamp, whole or not at all."""
    temporary = path.with_suffix(".part")
    temporary.write_text(json.dumps({**made_from, "extras": sorted(extras)}, indent=1), encoding="utf-8")
    temporary.replace(path)


def todo(stamp: dict[str, Any], made_from: dict[str, str], extras: frozenset[str]) -> str:
    """What the stamp leaves to do: "nothing", "install" into the environment that is there, or "rebuild" it."""
    if any(stamp.get(key) != made_from[key] for key in ("folder", "python")):
        return "rebuild"
    if stamp.get("pyproject") != made_from["pyproject"] or not extras <= set(stamp["extras"]):
        return "install"
    return "nothing"


def works() -> bool:
    """True when the environment's Python runs, is this version, and has lmeasure installed."""
    try:
        answer = subprocess.run([script("python"), "-I", "-c", PROBE], capture_output=True, text=True, check=False, timeout=120)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return answer.returncode == 0 and answer.stdout.strip() == sys.version.strip() and script("lmeasure").exists()


def say(text: str) -> None:
    """Print a line for the reader; standard output is left to the command."""
    print(f"run.py: {text}", file=sys.stderr, flush=True)


class Progress:
    """One line on the terminal that grows while the set-up works; elsewhere nothing until it ends."""

    def __init__(self) -> None:
        self.began, self._ended = time.monotonic(), threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __enter__(self) -> "Progress":
        if sys.stderr.isatty():
            self._thread.start()
        else:
            say("setting up lmeasure: about a minute the first time")
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        if self._thread.ident:
            self._thread.join()
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def _show(self) -> None:
        while not self._ended.wait(0.5):
            text = f"setting up lmeasure (about a minute the first time): {time.monotonic() - self.began:.0f} s, {packages()} packages"
            print(f"\r\x1b[Krun.py: {text}", end="", file=sys.stderr, flush=True)


def call(command: list[str], what: str) -> None:
    """Run one step with its output in the log; SetUpError with the log's last lines when it fails."""
    log = VENV / "set-up.log"
    try:
        with log.open("ab") as out:
            code = subprocess.call(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT)
    except OSError as error:
        raise SetUpError(f"{what} failed: {command[0]}: {error.strerror or error}") from error
    if code != 0:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()[-LAST_LINES:] if log.is_file() else []
        print(*lines, sep="\n", end="\n" if lines else "", file=sys.stderr)
        raise SetUpError(f"{what} failed (exit {code}){f'; all of its output is in {log}' if lines else ''}. The next call begins again")


def packages() -> int:
    """How many packages the environment holds so far."""
    return sum(1 for place in ("lib/python*/site-packages", "Lib/site-packages") for _ in VENV.glob(f"{place}/*.dist-info"))


def make_environment(uv: str | None) -> None:
    """Make a new empty environment, in place of whatever is there."""
    if uv is None and importlib.util.find_spec("ensurepip") is None:
        raise SetUpError("this Python cannot make environments with pip; install python3-venv (Debian, Ubuntu), or uv")
    if VENV.is_symlink() or VENV.is_file():
        VENV.unlink()
    elif VENV.exists():
        shutil.rmtree(VENV)
    VENV.mkdir()
    call([sys.executable, "-m", "venv", *(["--without-pip"] if uv else []), str(VENV)], "making the environment")


def pip_settings(pip: list[str]) -> str:
    """Return the settings of pip, a line each."""
    return subprocess.run([*pip, "config", "list"], capture_output=True, text=True, check=False).stdout


def uv_options(settings: str) -> list[str] | None:
    """Return uv's options for what `pip config list` printed; None where pip has settings that uv has not."""
    out: list[str] = []
    for line in settings.splitlines():
        key, _, value = line.partition("=")
        name = key.strip().removeprefix(":env:").rpartition(".")[2]
        values = value.strip().strip("'\"").replace("\\n", " ").split()
        if name in SAME_IN_UV:
            out += [part for one in values for part in (f"--{SAME_IN_UV[name]}", one)]
        elif name not in NOT_FOR_UV:
            return None
    return [*out, "--index-strategy", "unsafe-best-match"] if "--extra-index-url" in out else out


def install(extras: frozenset[str], uv: str | None) -> None:
    """Install the project, editable, with these extras and everything they need."""
    project = f"{ROOT}[{','.join(sorted(extras))}]" if extras else str(ROOT)
    python = str(script("python"))
    pip = [python, "-m", "pip"]
    options = [] if uv else uv_options(pip_settings(pip))
    if options is not None:
        try:
            if uv is None:
                call([*pip, "install", "--disable-pip-version-check", "uv"], "fetching uv")
                uv = str(script("uv"))
            call([uv, "pip", "install", "--python", python, *options, "--editable", project], "the installation")
        except SetUpError:
            if uv is not None and uv != str(script("uv")):
                raise
        else:
            return
    call([*pip, "install", "--disable-pip-version-check", "--editable", project], "the installation")


def set_up(extras: frozenset[str]) -> None:
    """Bring the environment to what pyproject.toml and the extras ask for; does nothing when it is there already."""
    stamp_path = VENV / "lmeasure-set-up.json"
    stamp, made_from = read_stamp(stamp_path), identity()
    left = todo(stamp, made_from, extras)
    if left != "rebuild" and not works():
        say(f"{VENV.name} does not work; it is made again")
        left = "rebuild"
    if left == "nothing":
        return
    extras |= frozenset(stamp.get("extras", ()))
    uv = shutil.which("uv")
    # without a stamp an interrupted installation is recognised: pip would take half-unpacked packages for whole ones
    if VENV.is_dir():
        stamp_path.unlink(missing_ok=True)
    with Progress() as progress:
        if left == "rebuild":
            make_environment(uv)
        install(extras, uv)
    if not works():
        raise SetUpError(f"the installation ended well, but lmeasure does not start from {VENV}")
    write_stamp(stamp_path, made_from, extras)
    say(f"set up in {time.monotonic() - progress.began:.0f} s; the next call starts at once")


def hand_over(command: list[str]) -> NoReturn:
    """Become the command inside the environment; does not return."""
    program = script(command[0])
    environment = os.environ | {"VIRTUAL_ENV": str(VENV), "PATH": f"{program.parent}{os.pathsep}{os.environ.get('PATH', '')}"}
    environment.pop("PYTHONHOME", None)
    if command[0] == "lmeasure":  # as the lines `next: ...` name it
        environment["LMEASURE_PROGRAM"] = "python3 run.py"
    line = [str(program), *command[1:]]
    if not WINDOWS:
        os.execve(program, line, environment)
    # Windows cannot replace a process: wait, and leave Ctrl-C to the command
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(subprocess.call(line, env=environment))


def main(arguments: list[str]) -> NoReturn:
    """Set up, then become the command that the arguments ask for."""
    extras, command = plan(arguments)
    try:
        set_up(extras)
        if command[0] == "pytest":
            os.chdir(ROOT)
        hand_over(command)
    except SetUpError as error:
        sys.exit(f"run.py: {error}")
    except OSError as error:
        sys.exit(f"run.py: {error.filename or ROOT}: {error.strerror or error}")
    except KeyboardInterrupt:
        say("interrupted; the next call begins the set-up again")
        sys.exit(130)


if __name__ == "__main__":
    main(sys.argv[1:])
