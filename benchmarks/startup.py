"""How long a user waits: for the help, and for the demo's computation on the first and on the second run.

    python benchmarks/startup.py [--write]

The help is the median of several processes, beside a Python that does nothing. The demo runs twice in processes of their own with a kernel
cache that is empty at first: the difference is what compiling takes; the compilers' own event tells how many functions were compiled.
--write keeps the table in results/startup.md.
"""

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from study import options, show

REPEATS = 7
DEMO = """
import sys, time
from pathlib import Path
begin = time.perf_counter()
from numba.core import event
compiled = event.RecordingListener()
event.register("numba:compile", compiled)
from lmeasure.demo import demo
def now():
    return time.perf_counter(), time.process_time()


at = {"load the libraries": (begin, 0.0), "load pages and pictures": now()}
demo(Path(sys.argv[1]), lambda stage, done, of: at.setdefault(stage, now()))
edges = [*at.values(), now()]
for stage, first, last in zip(at, edges, edges[1:]):
    print(f"{stage}\\t{last[0] - first[0]}\\t{last[1] - first[1]}")
print(f"compile events\\t{sum(e.is_start for _, e in compiled.buffer)}\\t0")
"""


def seconds(command: list[str]) -> float:
    """Median wall time of a process [s]."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def demo(folder: Path, cache: Path) -> dict[str, tuple[float, float]]:
    """Wall and processor seconds of each stage, and how many functions were compiled."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", DEMO, str(folder)], check=True, capture_output=True, text=True, env=environment)
    rows = (line.split("\t") for line in done.stdout.splitlines())
    return {name: (float(wall), float(cpu)) for name, wall, cpu in rows}


def processor_seconds(command: list[str]) -> float:
    """Processor time of a process [s]."""
    code = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, capture_output=True); "
    code += "u = resource.getrusage(resource.RUSAGE_CHILDREN); print(u.ru_utime + u.ru_stime)"
    done = subprocess.run([sys.executable, "-c", code, *command], check=True, capture_output=True, text=True)
    return float(done.stdout)


def main() -> None:
    """Measure, print, and keep when asked."""
    asked = options(__doc__).parse_args()
    command = [sys.executable, "-m", "lmeasure", "--help"]
    empty = [sys.executable, "-c", "pass"]
    bare, helped = seconds(empty), seconds(command)
    bare_cpu, helped_cpu = processor_seconds(empty), processor_seconds(command)
    with tempfile.TemporaryDirectory() as scratch:
        runs = [demo(Path(scratch) / "demo", Path(scratch) / "cache") for _ in range(2)]
    compiled = [run.pop("compile events")[0] for run in runs]
    first, second = runs
    total = [[sum(stage[i] for stage in run.values()) for i in (0, 1)] for run in runs]
    machine = f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    load = "" if not hasattr(os, "getloadavg") else f", load average {os.getloadavg()[0]:.1f}"
    lines = [
        "# Start-up",
        "",
        f"`python benchmarks/startup.py --write` on {machine}{load}.",
        "",
        "Processor seconds count all threads and do not depend on what else runs on the machine.",
        "",
        "| help | seconds | ratio | processor seconds |",
        "|---|---:|---:|---:|",
        f"| `python -c pass` | {bare:.3f} | 1 | {bare_cpu:.3f} |",
        f"| `lmeasure --help` | {helped:.3f} | {helped / bare:.1f} | {helped_cpu:.3f} |",
        "",
        "| demo, each in a process of its own | first run [s] | processor | second run [s] | processor |",
        "|---|---:|---:|---:|---:|",
        *(f"| {name} | {first[name][0]:.2f} | {first[name][1]:.2f} | {second[name][0]:.2f} | {second[name][1]:.2f} |" for name in first),
        f"| all | {total[0][0]:.2f} | {total[0][1]:.2f} | {total[1][0]:.2f} | {total[1][1]:.2f} |",
        f"| functions compiled | {compiled[0]:.0f} | | {compiled[1]:.0f} | |",
        "",
    ]
    show(asked, "\n".join(lines), "startup")


if __name__ == "__main__":
    main()
