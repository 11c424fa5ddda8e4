"""Two states of the program and what users would take instead, side by side: the same jobs on the same inputs, in turns.

    BEFORE=80f65259 python benchmarks/side_by_side.py [--rounds 5] [--job NAME ...] [--keep FILE --seconds S] [--write]

BEFORE names a commit; the other state is this folder. A job is a command in a process of its own. Each round runs it before, after, and
then the outside way, in processor seconds of all threads; the page has the medians. The first run of a job compiles, and is not counted.
Agreement is by the numbers in the files: the largest difference relative to the largest value of the same column. Inputs are made once, by
BEFORE, and stay in the folder of temporary files.
"""

import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import xarray as xr
from study import Study, table

HERE = Path(__file__).resolve().parent.parent
TRUTH = HERE / "tests" / "authorities" / "truth"
BEFORE = os.environ.get("BEFORE", "HEAD")
SCRATCH = Path(tempfile.gettempdir()) / f"lmeasure-side-by-side-{BEFORE}"
TREES = {"before": SCRATCH / "tree", "after": HERE}
BOX = ["--x", "-300:300:10", "--y", "-300:300:10", "--z", "-300:300:20", "--tilt-rad", "0.3", "--tilt-steps", "3"]
POSES = 200
"""Poses that SciPy solves; its time is that of as many as the job has."""
PREPARE = """
import sys
from pathlib import Path
import numpy as np
sys.path[:0] = [sys.argv[2], sys.argv[2] + "/benchmarks"]
from benchmarks.certify import write_measurement
from benchmarks.log_files import six_cables, write_logs
from lmeasure.rig import read_rig, write_rig
from lmeasure.recording import write_run
from lmeasure.simulation import Leg, simulate_run, smooth_path
out, truth = Path(sys.argv[1]), Path(sys.argv[3])
write_measurement(out / "measured", 5.0)
write_measurement(out / "long", 10.0)
rig = read_rig(truth / "eight-run" / "rig.toml")
rng = np.random.default_rng(5)
home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
legs = [Leg(np.r_[rng.uniform(-100, 100, 3), 0.0, 0.0, 0.0, 1.0], 300.0, 1.0, 1.0) for _ in range(100)]
write_run(out / "eight", simulate_run(rig, *smooth_path(home, legs, 1000.0), noise_mm=0.0, rng=rng).run)
write_rig(out / "six.toml", six_cables())
write_logs(out, np.cumsum(rng.integers(-40, 41, (60_000, 6)), axis=0))
points = [p.name for p in read_rig(truth / "cell-run" / "rig.toml").observation_point]
(out / "placement.toml").write_text(
    "[task]\\nlow_mm = [-200, -200, -200]\\nhigh_mm = [200, 200, 200]\\ntilt_rad = 0.2\\n[[mount]]\\nlow_mm = [-1800, -1800, 1200]\\n"
    f"high_mm = [1800, 1800, 1800]\\npoints = {points}\\n"
)
"""


def pyarrow_writes(out: Path) -> float:
    """Write the trajectory's own table with pyarrow."""
    rows = pq.read_table(out / "t.parquet")
    return used(lambda: pq.write_table(rows, out / "again.parquet"))


def scipy_solves(out: Path) -> float:
    """Solve as many poses by SciPy's least squares, one at a time."""
    from reconstruction import at, by_scipy, cell, noisy_changes

    rig, n = cell(), pq.read_metadata(out / "t.parquet").num_rows
    changes = noisy_changes(rig, at(np.linspace(0.0, 1e-3 * POSES, POSES)), 0.0)
    return used(lambda: by_scipy(rig.cable_rows(), changes)) * n / POSES


def libraries_read(_: Path) -> float:
    """Decode the log with python-can and cantools."""
    from log_files import by_libraries

    return used(lambda: by_libraries(SCRATCH / "log.blf"))


def copies(_: Path) -> float:
    """Copy and hash the measurement's files."""
    from certify import copy_and_hash

    return used(lambda: copy_and_hash(SCRATCH / "long"))


class Job(NamedTuple):
    """A command, with {in}, {out} and {truth} for folders, and what is measured beside it."""

    command: str
    outside: Callable[[Path], float] | None = None


JOBS = {
    "help": Job("--help"),
    "demo": Job("demo --no-browser --out {out}/demo"),
    "calibrate, 20 noisy poses": Job("calibrate {truth}/cell-20-poses-noisy --out {out}"),
    "calibrate, every dimension": Job(
        "calibrate {truth}/cell-20-poses-noisy --solve position,guide,radius,scale,attachment --out {out}"
    ),
    "reconstruct, short": Job("reconstruct {truth}/cell-run --out {out}/t.parquet", scipy_solves),
    "reconstruct, 300,000 samples of six cables": Job("reconstruct {in}/measured/run --out {out}/t.parquet", pyarrow_writes),
    "reconstruct, eight cables": Job("reconstruct {in}/eight --out {out}/t.parquet", pyarrow_writes),
    "import, BLF of 420,000 frames": Job("import {in}/log.blf --rig {in}/six.toml --out {out}/run", libraries_read),
    "zone, six cables": Job(" ".join(["zone {truth}/cell-run/rig.toml", *BOX, "--out {out}/zone.nc"])),
    "zone, linked": Job(" ".join(["zone {in}/calibrated/rig.toml", *BOX, "--out {out}/zone.nc"])),
    "place": Job("place {truth}/cell-run/rig.toml --task {in}/placement.toml --generations 50 --out {out}/placed"),
    "plan-poses": Job(
        "plan-poses {truth}/cell-run/rig.toml --poses 12 --box -200:200,-200:200,-200:200 --out {out}/planned.csv"
    ),
    "certify, ten minutes": Job(
        "certify {in}/long/trajectory.parquet --run {in}/long/run --program {in}/long/program.toml --out {out}", copies
    ),
    "verify, ten minutes": Job("verify {in}/certificate", copies),
}  # fmt: skip
OF_ANOTHER = {1, 3}
"""Exit codes of `verify` for a certificate of another version, which words its notes and pages otherwise."""


def prepare() -> None:
    """Unpack BEFORE and make what the jobs read, once."""
    if (SCRATCH / "ready").exists():
        return
    shutil.rmtree(SCRATCH, ignore_errors=True)
    TREES["before"].mkdir(parents=True)
    archive = subprocess.run(["git", "-C", HERE, "archive", BEFORE], check=True, capture_output=True).stdout
    subprocess.run(["tar", "x", "-C", TREES["before"]], input=archive, check=True)
    subprocess.run([sys.executable, "-c", PREPARE, SCRATCH, TREES["before"], TRUTH], env=environment("before"), check=True)
    run("before", f"calibrate {TRUTH}/cell-20-poses-noisy --out {SCRATCH}/calibrated")
    run("before", filled(JOBS["certify, ten minutes"].command, SCRATCH / "certificate"))
    (SCRATCH / "ready").touch()


def filled(command: str, out: Path) -> str:
    """Return a command with its folders."""
    return command.format(**{"in": SCRATCH, "out": out, "truth": TRUTH})


def environment(state: str) -> dict[str, str]:
    """Return the environment of a process that runs a state's sources on one thread."""
    own = {"PYTHONPATH": str(TREES[state]), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return {**os.environ, **own}


def run(state: str, command: str) -> float:
    """Return the processor time [s] of a command with its threads, not of what it leaves behind."""
    said = SCRATCH / "said"
    to_file = [(os.POSIX_SPAWN_OPEN, n, str(said), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600) for n in (1, 2)]
    line = [sys.executable, "-m", "lmeasure", *command.split()]
    child = os.posix_spawn(line[0], line, environment(state), file_actions=to_file)
    _, status, usage = os.wait4(child, 0)
    if (code := os.waitstatus_to_exitcode(status)) and not (command.startswith("verify ") and code in OF_ANOTHER):
        raise SystemExit(f"{state}: lmeasure {command}: {said.read_text()}")
    return usage.ru_utime + usage.ru_stime


def used(work: Callable[[], object]) -> float:
    """Return the processor time [s] of some work in this process."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def draw(seed: int, job: str) -> dict[str, Any]:
    """Run a job once in each state and the outside way; in the first round twice, for the first compiles."""
    prepare()
    outs: dict[str, Path] = {state: SCRATCH / f"out-{state}" for state in TREES}
    record: dict[str, Any] = {"job": job}
    for last in (False, True) if seed == 0 else (True,):
        for state, out in outs.items():
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir()
            record[state] = run(state, filled(JOBS[job].command, out))
        if not last:
            time.sleep(20.0)  # for the process that compiles beside the work
    outside = JOBS[job].outside
    record["outside"] = None if outside is None else outside(outs["after"])
    return record | {"differ": difference(*outs.values())}


def page(records: list[Any]) -> str:
    """Return the table."""
    rows = []
    for name, job in JOBS.items():
        mine = [r for r in records if r["job"] == name]
        if not mine:
            continue
        before, after = (statistics.median(r[state] for r in mine) for state in TREES)
        beside = ["", ""]
        if job.outside is not None:
            outside = statistics.median(r["outside"] for r in mine)
            beside = [f"{job.outside.__name__.replace('_', ' ')}: {outside:.2f}", f"{after / outside:.3g}"]
        rows.append([name, f"{before:.2f}", f"{after:.2f}", f"{before / after:.2f}", *beside, mine[-1]["differ"]])
    rounds = min(sum(r["job"] == name for r in records) for name in {r["job"] for r in records})
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return (
        f"# Before and after\n\n`BEFORE={BEFORE} python benchmarks/side_by_side.py --rounds {rounds}` on {machine}: processor seconds, "
        "medians of rounds taken in turns; speed after over before; the outside way and how many times it the job takes; the largest "
        "difference of numbers in the files.\n\n"
        + table(["job", "before [s]", "after [s]", "speed", "outside [s]", "after / outside", "numbers differ by"], rows)
    )


def difference(before: Path, after: Path) -> str:
    """Return the largest relative difference of numbers in two folders' files, and which."""
    worst, where = 0.0, "none written"
    for path in sorted(before.rglob("*")):
        both = (dict(figures(path)), dict(figures(after / path.relative_to(before))))
        for key, one in both[0].items():
            other = both[1].get(key)
            if other is None or other.shape != one.shape or (np.isfinite(one) != np.isfinite(other)).any():
                return f"{path.name}: {key} has other cells"
            finite = np.isfinite(one)
            off = float(np.abs(one - other)[finite].max(initial=0.0) / max(np.abs(one[finite]).max(initial=0.0), 1e-300))
            if where == "none written" or off > worst:
                worst, where = off, f"{path.name}, {key}"
    return where if where == "none written" else "0" if worst == 0.0 else f"{worst:.1e} ({where})"


def figures(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield columns of numbers of a file, by name; of JSON every list of entries as columns."""
    if path.suffix == ".parquet":
        table = pd.read_parquet(path)
        yield from ((c, table[c].to_numpy(float)) for c in table.select_dtypes("number").columns)
    elif path.suffix == ".csv":
        table = pd.read_csv(path)
        yield from ((c, table[c].to_numpy(float)) for c in table.select_dtypes("number").columns)
    elif path.suffix == ".nc":
        with xr.open_dataset(path) as data:
            yield from ((str(n), v.to_numpy().astype(float)) for n, v in data.data_vars.items() if v.dtype.kind in "fiu")
    elif path.name in ("calibration.json", "certificate.json"):
        for key, value in json.loads(path.read_text(encoding="utf-8")).items():
            if isinstance(value, list) and value and isinstance(value[0], dict):
                table = pd.DataFrame(value).select_dtypes("number")
                yield from ((f"{key}.{c}", table[c].to_numpy(float)) for c in table.columns)
            elif key in ("covariance", "tangent_covariance"):
                yield key, np.array(value, dtype=float)


STUDY = Study("side_by_side", draw, page, runs="rounds", count=5, factors={"job": list(JOBS)})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
