"""Two states of the program side by side: the same jobs, the same inputs, taken in turn, and whether the figures agree.

    python benchmarks/side_by_side.py BEFORE AFTER [--rounds 10] [--only NAME ...] [--write]

BEFORE and AFTER are folders with the sources (`git worktree add BEFORE COMMIT`). The inputs are made once, by BEFORE; every job is a
command in a process of its own, run once to compile and then in turn, BEFORE, AFTER, BEFORE ..., so that what else the machine does hits
both. Times are the processor's, of which the median of the rounds is taken. Figures are those in the files that a job writes: the largest
difference relative to the largest value of the same column. --write keeps the table in results/side_by_side.md.
"""

import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from study import options, show

TRUTH = Path(__file__).parent.parent / "tests" / "authorities" / "truth"
BOX = ["--x", "-300:300:10", "--y", "-300:300:10", "--z", "-300:300:20", "--tilt-rad", "0.3", "--tilt-steps", "3"]
PREPARE = """
import sys
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[2])
from benchmarks.certify import write_measurement
from lmeasure.rig import read_rig
from lmeasure.recording import write_run
from lmeasure.simulation import Leg, simulate_run, smooth_path
out, truth = Path(sys.argv[1]), Path(sys.argv[3])
write_measurement(out / "measured", 5.0)
rig = read_rig(truth / "eight-run" / "rig.toml")
rng = np.random.default_rng(5)
home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
legs = [Leg(np.r_[rng.uniform(-100, 100, 3), 0.0, 0.0, 0.0, 1.0], 300.0, 1.0, 1.0) for _ in range(100)]
write_run(out / "eight", simulate_run(rig, *smooth_path(home, legs, 1000.0), noise_mm=0.0, rng=rng).run)
"""
JOBS = {
    "help": ["--help"],
    "calibrate, 20 noisy poses": ["calibrate", "{truth}/cell-20-poses-noisy", "--out", "{out}"],
    "calibrate, every dimension": [
        "calibrate", "{truth}/cell-20-poses-noisy", "--solve", "position,guide,radius,scale,attachment", "--out", "{out}"
    ],
    "reconstruct, 300,000 samples of six cables": ["reconstruct", "{in}/measured/run", "--out", "{out}/t.parquet"],
    "reconstruct, eight cables": ["reconstruct", "{in}/eight", "--out", "{out}/t.parquet"],
    "zone, six cables": ["zone", "{truth}/cell-run/rig.toml", *BOX, "--out", "{out}/zone.nc"],
    "zone, linked": ["zone", "{in}/calibrated/rig.toml", *BOX, "--out", "{out}/zone.nc"],
    "plan-poses": [
        "plan-poses", "{truth}/cell-run/rig.toml", "--poses", "12", "--box", "-200:200,-200:200,-200:200", "--out", "{out}/planned.csv"
    ],
    "certify": [
        "certify", "{in}/measured/trajectory.parquet", "--run", "{in}/measured/run", "--program", "{in}/measured/program.toml",
        "--out", "{out}",
    ],
    "verify": ["verify", "{in}/certificate"],
}  # fmt: skip
PASSED = {0, 3}
"""Exit codes: 3 is `verify`, whose figures agree but whose printed pages, of another version, are not compared."""


def main() -> None:
    """Measure, print, and keep when asked."""
    parser = options(__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--only", nargs="*", default=list(JOBS))
    args = parser.parse_args()
    trees = [args.before.resolve(), args.after.resolve()]
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        prepare(scratch / "in", trees[0])
        rows = [measured(name, trees, scratch, args.rounds) for name in args.only]
    machine = f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    states = [
        subprocess.run(["git", "-C", t, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip() for t in trees
    ]
    lines = [
        "# Before and after",
        "",
        f"`python benchmarks/side_by_side.py BEFORE AFTER --rounds {args.rounds}`, {states[0]} and {states[1]}, on {machine}: processor "
        f"seconds, medians of {args.rounds} runs taken in turn; speed after over before; the largest difference of figures in the files.",
        "",
        "| job | before [s] | after [s] | speed | figures differ by |",
        "|---|---:|---:|---:|---:|",
        *rows,
        "",
    ]
    show(args, "\n".join(lines), "side_by_side")


def prepare(out: Path, tree: Path) -> None:
    """What the jobs read."""
    out.mkdir()
    subprocess.run([sys.executable, "-c", PREPARE, out, tree, TRUTH], env=environment(tree), check=True, capture_output=True)
    run(tree, ["calibrate", str(TRUTH / "cell-20-poses-noisy"), "--out", str(out / "calibrated")])
    run(tree, [word.format(**{"in": out, "out": out / "certificate", "truth": TRUTH}) for word in JOBS["certify"]])


def environment(tree: Path) -> dict[str, str]:
    """Of a process that runs these sources on one thread, with compiled code of their own."""
    own = {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return {**os.environ, **own}


def run(tree: Path, command: list[str]) -> float:
    """Processor time [s] of a command."""
    code = "import resource, subprocess, sys; r = subprocess.run(sys.argv[1:], capture_output=True, text=True); "
    code += "u = resource.getrusage(resource.RUSAGE_CHILDREN); print(u.ru_utime + u.ru_stime, r.returncode); print(r.stderr)"
    line = [sys.executable, "-c", code, sys.executable, "-m", "lmeasure", *command]
    done = subprocess.run(line, env=environment(tree), cwd=tree, check=True, capture_output=True, text=True)
    (first, *complaints) = done.stdout.splitlines()
    seconds, status = first.split()
    if int(status) not in PASSED:
        raise SystemExit(f"{tree}: lmeasure {' '.join(command)}: exit {status}: {' '.join(complaints)}")
    return float(seconds)


def measured(name: str, trees: list[Path], scratch: Path, rounds: int) -> str:
    """The table's line of a job."""
    times: list[list[float]] = [[], []]
    outs = [scratch / "before", scratch / "after"]
    for number in range(-1, rounds):
        for tree, out, own in zip(trees, outs, times, strict=True):
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir()
            seconds = run(tree, [word.format(**{"in": scratch / "in", "out": out, "truth": TRUTH}) for word in JOBS[name]])
            if number >= 0:
                own.append(seconds)
    before, after = (statistics.median(own) for own in times)
    return f"| {name} | {before:.2f} | {after:.2f} | {before / after:.2f} | {difference(*outs)} |"


def difference(before: Path, after: Path) -> str:
    """The largest relative difference of figures in two folders' files, and which."""
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
    """Columns of numbers of a file, by name; of JSON every list of entries as columns."""
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


if __name__ == "__main__":
    main()
