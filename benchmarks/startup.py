"""How long a user waits: for the help, and for a first result on a machine where nothing is compiled, and later.

    python benchmarks/startup.py [--write]

Each command runs in processes of its own, first with an empty cache of kernels, then again after the process in the background has compiled
what it used, or twenty seconds later on a machine that is too busy for it. Processor seconds count the command with all its threads and
children that it waited for, not the process in the background. --write keeps the table in results/startup.md.
"""

import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from study import options, show

LONGEST_S = 20.0
"""For which the process in the background is waited for."""
COMPILED = re.compile(r"Compiled now: (.*)")


def timed(command: list[str], environment: Mapping[str, str], output: Path) -> tuple[float, float]:
    """Return wall and processor seconds of a process; what it prints goes to a file."""
    begin = time.perf_counter()
    to_file = [(os.POSIX_SPAWN_OPEN, n, str(output), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600) for n in (1, 2)]
    child = os.posix_spawn(command[0], command, environment, file_actions=to_file)
    _, status, usage = os.wait4(child, 0)
    if status:
        sys.exit(f"{' '.join(command)}: {output.read_text()}")
    return time.perf_counter() - begin, usage.ru_utime + usage.ru_stime


def wait_for_background(cache: Path) -> None:
    """Wait until no process compiles in the cache any longer."""
    import fcntl

    until = time.monotonic() + LONGEST_S
    time.sleep(3.0)
    while (lock := cache / "beside.lock").exists() and time.monotonic() < until:
        with lock.open("wb") as turn:
            try:
                fcntl.flock(turn, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                time.sleep(1.0)
            else:
                return


def compiled(output: Path) -> int:
    """Return how many kernels the command compiled itself, by its own word."""
    found = COMPILED.search(output.read_text())
    return 0 if found is None else len([name for name in found[1].split(",") if name.strip()])


def main() -> None:
    """Measure, print, and keep when asked."""
    settings = options(__doc__).parse_args()
    lmeasure = [sys.executable, "-m", "lmeasure"]
    with tempfile.TemporaryDirectory() as scratch:
        folder, out = Path(scratch), Path(scratch) / "output"
        jobs = {
            "demo": ["demo", "--no-browser", "--out", f"{folder}/demo"],
            "reconstruct, 7,527 samples": ["reconstruct", f"{folder}/demo/run", "--out", f"{folder}/t.parquet"],
            "zone, 185,193 poses": [
                "zone", f"{folder}/demo/run/rig.toml", *(f"--{axis}=-900:900:100" for axis in "xyz"), "--tilt-rad", "0.3",
                "--tilt-steps", "3", "--out", f"{folder}/zone.nc",
            ],
            "calibrate, 20 poses": ["calibrate", f"{folder}/demo/campaign", "--out", f"{folder}/calibration"],
        }  # fmt: skip
        rows = []
        for name, command in (("python -c pass", [sys.executable, "-c", "pass"]), ("lmeasure --help", [*lmeasure, "--help"])):
            wall, used = min(timed(command, os.environ, out) for _ in range(5))
            rows.append(f"| `{name}` | | | {wall:.2f} | {used:.2f} |")
        for number, (name, arguments) in enumerate(jobs.items()):
            cache = folder / f"cache-{number}"
            environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
            command = [*lmeasure, *arguments, "-f", "-v"]
            first = timed(command, environment, out)
            kernels = compiled(out)
            wait_for_background(cache)
            later = timed(command, environment, out)
            print(name, first, later, flush=True)
            rows.append(f"| {name} | {first[1]:.2f} | {kernels} | {later[0]:.2f} | {later[1]:.2f} |")
    load = "" if not hasattr(os, "getloadavg") else f", load average {os.getloadavg()[0]:.1f}"
    lines = [
        "# Start-up",
        "",
        f"`python benchmarks/startup.py --write` on {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}{load}.",
        "",
        "Processor seconds count all threads. The first run begins with nothing compiled.",
        "",
        "| command | first, processor [s] | kernels it compiled | later, wall [s] | later, processor [s] |",
        "|---|---:|---:|---:|---:|",
        *rows,
        "",
    ]
    show(settings, "\n".join(lines), "startup")


if __name__ == "__main__":
    main()
