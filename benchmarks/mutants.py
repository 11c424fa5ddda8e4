"""Do the tests see when the core is wrong? One small fault at a time is put into a copy of a file, and its tests are run.

    python benchmarks/mutants.py [--files PART ...] [--sample N] [--seed N] [--again] [--folder F] [--list]

A fault is an operator, a comparison, a constant, a condition or a statement changed; `--list` prints them without running anything. A fault
that no test sees in time survives; one that hangs is killed. `trials.py` says how they are run; kernels are not compiled.
Survivors that change nothing which could be seen are named, with the reason, in `equivalent_mutants.toml`, by the text of their line.
Writes `benchmarks/results/mutants.md`; files that are not asked for keep what stands there of them. `--again` tries only the faults that
survived by that report, with the same sample and seed, and takes its word for the others.
"""

import argparse
import importlib
import json
import os
import random
import tomllib
from pathlib import Path

from core_tests import CORE
from mutations import Mutant, mutants_of
from trials import ROOT, try_all

RESULTS = ROOT / "benchmarks" / "results"
LIBRARIES = (
    "numba", "scipy.stats", "scipy.optimize", "scipy.spatial.transform", "pandas", "xarray", "pyarrow", "pydantic", "typer",
    "mpmath", "cryptography", "h5py", "lxml", "can", "plotly", "tomli_w",
)  # fmt: skip
EQUIVALENT = ROOT / "benchmarks" / "equivalent_mutants.toml"


def faults_of(file: str) -> list[Mutant]:
    """All faults of a file of the package."""
    return mutants_of(file, (ROOT / "lmeasure" / file).read_text(encoding="utf-8"))


def sampled(file: str, sample: int | None, seed: int) -> list[Mutant]:
    """Those of a file's faults that are to be tried, in its order: all, or so many."""
    every = faults_of(file)
    some = every if sample is None else random.Random(f"{seed} {file}").sample(every, min(sample, len(every)))
    return sorted(some, key=lambda m: m.start)


def load_libraries() -> None:
    """Before faults are tried: all that the tests need, once for all forks."""
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    os.environ.pop("NUMBA_CACHE_DIR", None)
    for name in LIBRARIES:
        importlib.import_module(name)


def equivalents() -> dict[tuple[str, str, str], str]:
    """Why a fault changes nothing that could be seen, by its key."""
    if not EQUIVALENT.exists():
        return {}
    table = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))
    return {(m["file"], m["line"], m["change"]): m["why"] for m in table["mutant"]}


def run(file: str, chosen: list[Mutant], *, before: str | None = None, keep: Path | None = None) -> str:
    """The section of the report about a file, of whose faults those chosen are tried. before: the section that stood there, of which only
    survivors are tried again."""
    every, tests, known = faults_of(file), CORE[file], equivalents()
    survivors, tried = [m for m in chosen if m.key in known], [m for m in chosen if m.key not in known]
    if before is not None and f"({len(every)} in the file, {len(chosen)} tried" in before:  # else the file was changed since
        tried = [m for m in tried if f"`{m.source}`: `{m.change}`: survives" in before]

    def tell(m: Mutant, killed: bool) -> None:
        print(f"{file} line {m.line} `{m.source}`: `{m.change}`: {'killed' if killed else 'SURVIVES'}", flush=True)
        if not killed:
            survivors.append(m)

    if tried:
        try_all(tried, tests, keep=keep, tell=tell)
    same = [m for m in survivors if m.key in known]
    reported, dead = len(chosen) - len(same), len(chosen) - len(survivors)
    survivors.sort(key=lambda m: m.start)
    lines = [
        f"## {file}",
        "",
        f"{dead} of {reported} killed ({len(every)} in the file, {len(chosen)} tried, {len(same)} equivalent), by `{' '.join(tests)}`.",
        "",
        *(
            f"- line {m.line}, `{m.source}`: `{m.change}`: {'equivalent: ' + known[m.key] if m.key in known else 'survives'}"
            for m in survivors
        ),
    ]
    return "\n".join(lines).rstrip() + "\n"


def written(sections: dict[str, str]) -> str:
    """The whole report."""
    counts = [tuple(int(word) for word in (line.split()[0], line.split()[2])) for s in sections.values() for line in s.splitlines()[2:3]]
    dead, reported = (sum(c[i] for c in counts) for i in (0, 1))
    head = "# Faults in the core, and whether tests see them\n\nMade by `python benchmarks/mutants.py`, which says what a fault is.\n"
    head += "The `strict=True` of a `zip` is left as it is, with the reason in `mutations.py`; older sections still count it.\n"
    total = f"\n**{dead} of {reported} killed ({100 * dead / max(reported, 1):.1f} %), equivalent ones apart.** "
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
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", action="store_true", help="only what survived by the report that stands")
    parser.add_argument("--list", action="store_true", help="print the faults as JSON lines, run nothing")
    parser.add_argument("--folder", type=Path, help="kept for the next time: which lines each test passes")
    parser.add_argument("--out", type=Path, default=RESULTS / "mutants.md")
    options = parser.parse_args()
    files = [file for file in CORE if any(part in file for part in options.files)]
    if options.list:
        for file in files:
            for m in faults_of(file):
                print(json.dumps({"file": m.file, "number": m.line, "line": m.source, "change": m.change}))
        return
    load_libraries()
    sections = earlier(options.out)
    for file in files:
        before = sections[file] if options.again else None
        sections[file] = run(file, sampled(file, options.sample, options.seed), before=before, keep=options.folder)
        options.out.write_text(written(sections), encoding="utf-8")


if __name__ == "__main__":
    main()
