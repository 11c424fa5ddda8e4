"""Do the tests see when the core is wrong? One small fault at a time is put into a copy of a file, and its tests are run.

    python benchmarks/mutants.py [--files PART ...] [--sample N | --together N] [--seed N] [--limit-s N] [--again] [--plain] [--list]

A fault is an operator, a comparison, a constant, a condition or a statement changed; `--list` prints them without running anything. A fault
that no test sees in time survives; one that hangs is killed. Kernels are first run without being compiled, by tests that are short enough
for that; for a fault that these do not see they are compiled anew, without the compiler's optimisation, for more tests.
Survivors that change nothing which could be seen are named, with the reason, in `equivalent_mutants.toml`, by the text of their line.
Writes `benchmarks/results/mutants.md`; files that are not asked for keep what stands there of them. `--again` tries only the faults that
survived by that report, with the same sample and seed, and takes its word for the others.
"""

import argparse
import ast
import importlib
import json
import math
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NoReturn

import pytest
import scipy.stats
from mutations import Mutant, mutants_of

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
MOST_MEMORY = 8 << 30
SHORT_S = 30.0
"""Of tests: nothing much was compiled in them."""
LIBRARIES = (
    "numba", "scipy.stats", "scipy.optimize", "scipy.spatial.transform", "pandas", "xarray", "pyarrow", "pydantic", "typer",
    "mpmath", "cryptography", "h5py", "lxml", "can", "plotly", "tomli_w",
)  # fmt: skip
EQUIVALENT = ROOT / "benchmarks" / "equivalent_mutants.toml"

_ZONES = "pivoted or parameter or every_node or definitions or cannot_run or zero_pose"
_COUNTERS = [
    "tests/trajectory/test_counter_faults.py",
    "tests/trajectory/test_redundant_faults.py",
    "tests/test_docs.py::test_constants_are_those_of_the_program",
]
_SEALED = [
    "tests/certification/test_iso_tests.py",
    "tests/certification/test_paths.py",
    "tests/certification/test_corners_and_weaves.py",
    "tests/certification/test_method.py",
    "tests/certification/test_evaluation.py",
    "tests/certification/test_instants.py",
    "-k",
    "method_3 or test_evaluation or test_instants or test_iso_tests or corners_cut or at_its_corner or of_a_stroke",
]
_CHANNELS = [
    "tests/observation/test_kinds.py",
    "tests/observation/test_parameters.py",
    "tests/observation/test_solver.py",
    "tests/observation/test_runs_of_sensors.py",
]
_ESTIMATED = [f"tests/estimation/test_{name}.py" for name in ("release", "gauge", "least_squares", "judging")]
_STRAIGHT = ["tests/lcoordinate/test_straight.py", "-k", "not forty and not monodromy"]
_KINDS = "cable channel continuation distance inclination joint of_rig parameters solver swivel wrap"
_TESTS = "pose approaches exchangeability drift distance compliance path velocity corners weaving settling posing stabilisation"
_EVALUATED = "angles attainment capability evaluate exclusions figure fitted_frame instants"
_CAMPAIGNS = [
    "tests/calibration/test_recover.py",
    "tests/calibration/test_visits.py",
    "-k",
    "exact_poses or stated_pose or default or two_passes or visit",
]
CORE = {
    "kernels/cable.py": ["tests/kernels/test_cable.py"],
    "kernels/counter.py": ["tests/kernels/test_counter.py", "tests/acquisition/test_counters.py"],
    "kernels/screw.py": ["tests/kernels/test_screw.py", "tests/kernels/test_screw_covariances.py"],
    "kernels/lanes.py": ["tests/kernels/test_lanes.py", "-k", "tiles_ or in_pieces or 75_degrees or short_dip or spoil"],
    "kernels/least_squares.py": ["tests/observation/test_fast_paths.py", "-k", "few_samples or constrained"],
    "kernels/zone.py": ["tests/accuracy/test_zone.py", "tests/accuracy/test_scan.py", "-k", _ZONES],
    "kernels/zone_rows.py": ["tests/accuracy/test_zone.py", "tests/accuracy/test_scan.py", "-k", _ZONES],
    "kernels/zone_lanes.py": ["tests/accuracy/test_scan.py", "-k", _ZONES],
    "kernels/zone_linked.py": ["tests/accuracy/test_scan.py", "-k", _ZONES],
    "kernels/zone_six.py": ["tests/accuracy/test_scan.py", "-k", _ZONES],
    "kernels/zone_redundant.py": ["tests/accuracy/test_redundant_zone.py"],
    "lcoordinate/singularity.py": ["tests/lcoordinate/test_singularity.py"],
    "lcoordinate/architecture.py": ["tests/lcoordinate/test_architecture.py"],
    "lcoordinate/certified.py": _STRAIGHT,
    "lcoordinate/levers.py": ["tests/lcoordinate/test_levers.py"],
    "lcoordinate/pluecker.py": ["tests/lcoordinate/test_links.py", "tests/lcoordinate/test_singularity.py"],
    "lcoordinate/singular.py": ["tests/lcoordinate/test_links.py"],
    "lcoordinate/starts.py": _STRAIGHT,
    "lcoordinate/straight.py": _STRAIGHT,
    "lcoordinate/structures.py": ["tests/lcoordinate/test_structures.py", "tests/lcoordinate/test_architecture.py"],
    "lcoordinate/study.py": _STRAIGHT,
    "lcoordinate/tetrahedra.py": _STRAIGHT,
    "lcoordinate/workspace.py": ["tests/lcoordinate/test_workspace.py", "-k", "not led"],
    "lcoordinate/intervals.py": ["tests/lcoordinate/test_flat.py"],
    "lcoordinate/flat.py": ["tests/lcoordinate/test_flat.py"],
    "lcoordinate/bounds.py": ["tests/lcoordinate/test_workspace.py"],
    "lcoordinate/detour.py": ["tests/lcoordinate/test_workspace.py", "-k", "path or led"],
    "estimation/least_squares.py": _ESTIMATED,
    "estimation/fit.py": _ESTIMATED,
    "estimation/elimination.py": _ESTIMATED,
    "estimation/regions.py": [*_ESTIMATED, "tests/calibration/test_regions.py"],
    "estimation/deletion.py": _ESTIMATED,
    "estimation/robust.py": _ESTIMATED,
    "estimation/explanations.py": _ESTIMATED,
    "estimation/problem.py": _ESTIMATED,
    "estimation/exchange.py": ["tests/estimation/test_exchange.py"],
    "estimation/information.py": ["tests/estimation/test_exchange.py"],
    "estimation/observability.py": ["tests/estimation/test_observability.py"],
    "estimation/normal_equations.py": ["tests/estimation/test_normal_equations.py"],
    **{f"observation/{name}.py": _CHANNELS for name in _KINDS.split()},
    "observation/cable_effects.py": ["tests/kernels/test_cable_effects.py"],
    "calibration/residuals.py": _CAMPAIGNS,
    "calibration/unknowns.py": _CAMPAIGNS,
    "calibration/misfit.py": ["tests/calibration/test_real_world.py", "-k", "sound_data or positions or state_nothing or run-out or named"],
    "trajectory/budget.py": ["tests/trajectory/test_budget.py"],
    "trajectory/exact.py": ["tests/test_taken_as_exact.py"],
    "trajectory/steps.py": ["tests/trajectory/test_steps.py", *_COUNTERS],
    "trajectory/continuity.py": ["tests/trajectory/test_continuity.py", *_COUNTERS],
    "trajectory/standing.py": ["tests/trajectory/test_standing.py", *_COUNTERS],
    "trajectory/doubts.py": ["tests/trajectory/test_doubts.py", *_COUNTERS],
    "trajectory/redundancy.py": ["tests/trajectory/test_redundancy.py", *_COUNTERS],
    "trajectory/consistency.py": ["tests/trajectory/test_schemes.py", *_COUNTERS],
    "interpolation.py": ["tests/test_interpolation.py", "tests/trajectory/test_passes.py", "-k", "interpolation or between"],
    "certification/iso9283_pose.py": ["tests/certification/test_iso9283.py"],
    "certification/iso9283_path.py": ["tests/certification/test_iso9283.py"],
    "certification/iso9283_time.py": ["tests/certification/test_iso9283.py"],
    "certification/uncertainty.py": ["tests/certification/test_u95.py"],
    "certification/verify.py": ["tests/certification/test_verify.py"],
    "certification/again.py": ["tests/certification/test_verify.py"],
    **{f"certification/iso9283/{name}.py": _SEALED for name in _TESTS.split()},
    **{f"certification/{name}.py": _SEALED for name in _EVALUATED.split()},
    "findings.py": ["tests/test_findings.py"],
    "trajectory/pose_errors.py": [
        "tests/trajectory/test_pose_errors.py",
        "tests/certification/test_u95.py",
        "tests/certification/test_method.py",
        "-k",
        "test_pose_errors or in_common or method_3",
    ],
    "acquisition/samples.py": ["tests/acquisition/test_samples.py"],
    "accuracy/zone.py": ["tests/accuracy/test_zone.py", "-k", "not 60_degrees and not limit_of and not volume and not limits_asked"],
}
"""Files of the package, and the tests that are to see a fault in them."""

_FEW = ["tests/accuracy/test_scan.py", "tests/accuracy/test_redundant_zone.py", "tests/accuracy/test_zone.py"]
PLAIN = {
    **{f"kernels/{name}.py": [*_FEW, "-k", "few or generalised or zero_pose or definitions"] for name in ("zone", "zone_rows")},
    **{f"kernels/{name}.py": [*_FEW[:2], "-k", "few"] for name in ("zone_lanes", "zone_linked", "zone_six", "zone_redundant")},
    "kernels/cable.py": ["tests/kernels/test_cable.py", "-k", "not on_its_axis"],
    "kernels/counter.py": CORE["kernels/counter.py"],
    "kernels/screw.py": ["tests/kernels/test_screw.py"],
    "kernels/lanes.py": ["tests/kernels/test_lanes.py", "-k", "few_samples or 75_degrees_in"],
    "kernels/least_squares.py": ["tests/observation/test_fast_paths.py", "-k", "few_samples"],
}
"""Tests of kernels that are short without compiling."""


class Copy:
    """A copy of the project in which faults are put."""

    def __init__(self, folder: Path, quick: bool) -> None:
        self.quick = quick
        """Whether kernels are compiled without being optimised, since they are compiled often."""
        self.root = folder / "project"
        self.kept = folder / "kept"
        self._limits: dict[tuple[str, ...], float] = {}
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", "*.egg-info", ".*_cache", "build"))

    def passes(self, tests: list[str], limit_s: float, *, plain: bool = False) -> bool:
        """Whether the tests pass in time, in a fork of this process, which has loaded all libraries and nothing of the project. plain:
        nothing is compiled."""
        child = os.fork()
        if not child:
            os.setsid()
            self._become_pytest(tests, plain)
        until = time.monotonic() + limit_s
        while time.monotonic() < until:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status) == 0
            time.sleep(0.02)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return False

    def _become_pytest(self, tests: list[str], plain: bool) -> NoReturn:
        code = 1
        try:
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
            os.chdir(self.root)
            os.environ |= {"PYTHONPATH": str(self.root), "PYTHONDONTWRITEBYTECODE": "1", "XDG_CACHE_HOME": str(self.kept)}
            os.environ |= {"NUMBA_DISABLE_JIT": "1"} if plain else {"NUMBA_OPT": "0"} if self.quick else {}
            sys.dont_write_bytecode = True
            sys.path[0] = str(self.root)
            code = int(
                pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", "-W", "ignore:Cannot cache compiled", *tests])
            )
        finally:
            os._exit(code)

    def limit(self, tests: list[str], longest_s: float, *, plain: bool = False) -> float:
        """How long [s] tests may take, by how long they take without a fault once all is compiled; SystemExit where they do not pass."""
        if tuple(tests) not in self._limits:
            took_s = math.inf
            for _ in range(1 if plain else 2):
                begun = time.monotonic()
                if not self.passes(tests, longest_s, plain=plain):
                    raise SystemExit(f"tests do not pass without a fault within {longest_s:g} s: {' '.join(tests)}")
                took_s = time.monotonic() - begun
                if took_s < SHORT_S:
                    break
            compiling_s = 120.0 if self.quick and not plain else 0.0
            self._limits[tuple(tests)] = 20.0 + 5.0 * took_s + compiling_s
        return min(longest_s, self._limits[tuple(tests)])

    def killed(self, mutant: Mutant, tests: list[str], longest_s: float, *, plain: bool = False) -> bool:
        """Whether the tests see the fault."""
        limit_s = self.limit(tests, longest_s, plain=plain)
        path = self.root / "lmeasure" / mutant.file
        text = path.read_text(encoding="utf-8")
        kernels = mutant.file.startswith("kernels/")
        before = {p.name for p in self._compiled()}
        ast.parse(mutant.applied(text))  # what is no Python is no fault
        try:
            path.write_text(mutant.applied(text), encoding="utf-8")
            return not self.passes(tests, limit_s, plain=plain)
        finally:
            path.write_text(text, encoding="utf-8")
            for folder in self._compiled() if kernels else ():
                if folder.name not in before:
                    shutil.rmtree(folder)

    def _compiled(self) -> list[Path]:
        return list((self.kept / "lmeasure").glob("kernels-*"))


def faults_of(file: str) -> list[Mutant]:
    """All faults of a file of the package."""
    return mutants_of(file, (ROOT / "lmeasure" / file).read_text(encoding="utf-8"))


def equivalents() -> dict[tuple[str, str, str], str]:
    """Why a fault changes nothing that could be seen, by its key."""
    if not EQUIVALENT.exists():
        return {}
    table = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))
    return {(m["file"], m["line"], m["change"]): m["why"] for m in table["mutant"]}


def _survivors(copy: Copy, tests: list[str], tried: list[Mutant], longest_s: float, *, plain: bool) -> list[Mutant]:
    """Those of the faults that the tests do not see; plain: kernels by their short tests alone."""
    out = []
    for number, mutant in enumerate(tried, 1):
        short = PLAIN.get(mutant.file)
        killed = short is not None and copy.killed(mutant, short, longest_s, plain=True)
        if not killed and not (short is not None and plain):
            killed = copy.killed(mutant, tests, longest_s)
        if not killed:
            out.append(mutant)
        print(f"{mutant.file} {number}/{len(tried)} line {mutant.line}: {mutant.change}: {'killed' if killed else 'SURVIVES'}", flush=True)
    return out


def run(
    copy: Copy,
    file: str,
    tests: list[str],
    sample: int | None,
    seed: int,
    longest_s: float,
    *,
    before: str | None = None,
    together: set[Mutant] | None = None,
    plain: bool = False,
) -> str:
    """The section of the report about a file. before: the section that stood there, of which only survivors are tried again; together:
    faults drawn from all files, of which its own are tried."""
    every = faults_of(file)
    chosen = every if sample is None else random.Random(f"{seed} {file}").sample(every, min(sample, len(every)))
    if together is not None:
        chosen = [m for m in every if m in together]
    chosen = sorted(chosen, key=lambda m: m.start)
    known = equivalents()
    survivors, tried = [m for m in chosen if m.key in known], [m for m in chosen if m.key not in known]
    if before is not None and f"({len(every)} in the file, {len(chosen)} tried" in before:  # else the file was changed since
        tried = [m for m in tried if f"`{m.source}`: `{m.change}`: survives" in before]
    survivors += _survivors(copy, tests, tried, longest_s, plain=plain) if tried else []
    same = [m for m in survivors if m.key in known]
    told, dead = len(chosen) - len(same), len(chosen) - len(survivors)
    survivors.sort(key=lambda m: m.start)
    lines = [
        f"## {file}",
        "",
        f"{dead} of {told} killed ({len(every)} in the file, {len(chosen)} tried, {len(same)} equivalent), by `{' '.join(tests)}`.",
        "",
        *(
            f"- line {m.line}, `{m.source}`: `{m.change}`: {'equivalent: ' + known[m.key] if m.key in known else 'survives'}"
            for m in survivors
        ),
    ]
    return "\n".join(lines).rstrip() + "\n"


def written(sections: dict[str, str], *, unseen: bool = False) -> str:
    """The whole report; unseen: of faults drawn from all that no test was written for."""
    counts = [tuple(int(word) for word in (line.split()[0], line.split()[2])) for s in sections.values() for line in s.splitlines()[2:3]]
    dead, told = (sum(c[i] for c in counts) for i in (0, 1))
    head = "# Faults in the core, and whether tests see them\n\nMade by `python benchmarks/mutants.py`, which says what a fault is.\n"
    total = f"\n**{dead} of {told} killed ({100 * dead / max(told, 1):.1f} %), equivalent ones apart.** "
    if unseen:
        least = scipy.stats.beta.ppf(0.025, dead, told - dead + 1) if dead else 0.0
        most = scipy.stats.beta.ppf(0.975, dead + 1, told - dead) if dead < told else 1.0
        total += f"Drawn from all faults of the core: of these it is {100 * least:.1f} to {100 * most:.1f} % (95 %, Clopper and Pearson).\n"
    else:
        total += "Tests were written for what survived, so that it says nothing of faults that were not tried: `--together` does.\n"
    return head + total + "".join("\n" + sections[file] for file in CORE if file in sections)


def earlier(path: Path) -> dict[str, str]:
    """Sections of the report that stands there, by file."""
    if not path.exists():
        return {}
    parts = path.read_text(encoding="utf-8").split("\n## ")[1:]
    return {part.split("\n", 1)[0]: f"## {part.rstrip()}\n" for part in parts}


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--files", nargs="+", default=[""], help="parts of names, such as iso9283 or kernels/cable")
    parser.add_argument("--sample", type=int, help="so many of each file, chosen by the seed; default all")
    parser.add_argument("--together", type=int, help="so many of all files together: what tests see of the core as a whole")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit-s", type=float, default=600.0, help="longest time of a file's tests")
    parser.add_argument("--again", action="store_true", help="only what survived by the report that stands")
    parser.add_argument("--plain", action="store_true", help="compile nothing: of kernels, what their short tests do not see survives")
    parser.add_argument("--list", action="store_true", help="print the faults as JSON lines, run nothing")
    parser.add_argument("--out", type=Path, default=RESULTS / "mutants.md")
    asked = parser.parse_args()
    files = [file for file in CORE if any(part in file for part in asked.files)]
    if asked.list:
        for file in files:
            for m in faults_of(file):
                print(json.dumps({"file": m.file, "number": m.line, "line": m.source, "change": m.change}))
        return
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    os.environ.pop("NUMBA_CACHE_DIR", None)
    for name in LIBRARIES:
        importlib.import_module(name)
    every = [m for file in files for m in faults_of(file)]
    together = None if asked.together is None else set(random.Random(asked.seed).sample(every, min(asked.together, len(every))))
    sections = earlier(asked.out)
    with tempfile.TemporaryDirectory() as folder:
        copies = {quick: Copy(Path(folder) / str(quick), quick) for quick in {file.startswith("kernels/") for file in files}}
        for file in files:
            before = sections[file] if asked.again else None
            if together is not None and not any(m.file == file for m in together):
                continue
            sections[file] = run(
                copies[file.startswith("kernels/")], file, CORE[file], asked.sample, asked.seed, asked.limit_s,
                before=before, together=together, plain=asked.plain,
            )  # fmt: skip
            asked.out.write_text(written(sections, unseen=together is not None), encoding="utf-8")


if __name__ == "__main__":
    main()
