"""Live in simulated worlds: bus, clocks, disk, processes and kills from one seed; and plant bugs to be found.

    python benchmarks/simulated_world.py --keep FILE [--runs SEEDS] [--first SEED] [--world NAME ...] [--write]
    python benchmarks/simulated_world.py --planted --keep FILE [--seeds N] [--write]

The worlds are recordings (`tests/helpers/worlds.py`), captures (`capture_worlds.py`), jobs of a workbench and a store of results
(`job_worlds.py`). A sample, a reading or a line that was shown is in the files, none is invented, each file is whole or absent, what was
broken off continues to the same results, and every tenth seed leaves the same bytes when it is lived again. --planted puts each fault of
`planted_bugs.toml` into the code, one at a time, and counts those that some seed notices.
"""

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from study import Kept, Study, show, table

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors")]

import capture_worlds  # noqa: E402
import job_worlds  # noqa: E402
from worlds import Outcome, drawn, lived  # noqa: E402

PLANTED = Path(__file__).parent / "planted_bugs.toml"
LIVED_AGAIN = 10
"""Every tenth seed."""


WORLDS: dict[str, tuple[Callable[[int], Any], Callable[[Any, Path], Outcome]]] = {
    "recording": (drawn, lived),
    "capture": (capture_worlds.drawn, capture_worlds.lived),
    "jobs": (job_worlds.drawn, job_worlds.lived),
    "store": (job_worlds.drawn, job_worlds.stored),
}


def draw(seed: int, world: str) -> dict[str, Any]:
    """Live one seed, some twice."""
    begun, (one, live) = time.process_time(), WORLDS[world]
    with tempfile.TemporaryDirectory() as name:
        outcome = live(one(seed), Path(name) / "run")
        wrong = list(outcome.wrong)
        if seed % LIVED_AGAIN == 0 and live(one(seed), Path(name) / "run").digest != outcome.digest:
            wrong.append("lived again, it leaves other bytes")
    return asdict(outcome) | {"world": world, "wrong": wrong, "processor_s": time.process_time() - begun}


def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
    """Return the tables of worlds, and of faults and ends."""
    worlds, rows = [], []
    for world in dict.fromkeys(one["world"] for one in records):
        of_world = [one for one in records if one["world"] == world]
        hours, spent = (sum(one[key] for one in of_world) / 3600.0 for key in ("seconds", "processor_s"))
        kept, bad = sum(one["samples"] for one in of_world), sum(bool(one["wrong"]) for one in of_world)
        worlds.append([world, len(of_world), f"{hours:.1f}", f"{hours / spent:.0f}" if hours else "", kept, bad])
        for kind in sorted({fault for one in of_world for fault in one["faults"]} | {"none"}):
            own = [one for one in of_world if kind in (one["faults"] or ["none"])]
            ends = [sum(one["ended"].startswith(end) for one in own) for end in ("complete", "killed", "refused")]
            rows.append([world, kind, len(own), *ends, len(own) - sum(ends), sum(bool(one["wrong"]) for one in own)])
    wrong = [one for one in records if one["wrong"]]
    lines = [
        "# Simulated worlds",
        "`python benchmarks/simulated_world.py --keep FILE --write`",
        f"{len(records)} seeds. {len(wrong)} were wrong. `acknowledged` counts samples, readings, lines of jobs, and results.",
        *(f"- {one['world']} {one['seed']}: {'; '.join(one['wrong'][:2])}" for one in wrong[:10]),
        table(["world", "seeds", "simulated hours", "in an hour of one processor", "acknowledged", "wrong"], worlds),
        table(["world", "fault", "seeds", "complete", "killed", "refused", "ended early", "wrong"], rows),
    ]
    return "\n\n".join(lines), not wrong


def planted(bug: dict[str, str], module: ModuleType) -> None:
    """Put a bug into a module that is loaded, and into every module that has taken names from it."""
    assert module.__file__ is not None
    text = Path(module.__file__).read_text(encoding="utf-8")
    if text.count(bug["old"]) < 1:
        raise SystemExit(f"{module.__name__} has no {bug['old']!r}")
    before = {name: value for name, value in vars(module).items() if getattr(value, "__module__", None) == module.__name__}
    exec(compile(text.replace(bug["old"], bug["new"], 1), module.__file__, "exec"), vars(module))
    for other in [one for name, one in sys.modules.items() if name.startswith(("lmeasure", "worlds"))]:
        for name, value in list(vars(other).items()):
            if any(value is one for one in before.values()):
                setattr(other, name, vars(module)[value.__name__])


def found(bug: dict[str, str], seeds: int) -> tuple[int, str]:
    """Return the first seed that notices a bug, and what it notices; -1 where none does."""
    module = sys.modules[f"lmeasure.{bug['module']}"]
    planted(bug, module)
    with tempfile.TemporaryDirectory() as name:
        for seed in range(seeds):
            try:
                wrong = lived(drawn(seed), Path(name) / "run").wrong
            except Exception as error:
                wrong = [f"{type(error).__name__}: {error}"]
            if wrong:
                return seed, wrong[0]
    return -1, ""


def plant(options: argparse.Namespace) -> int:
    """Plant each bug in a process of its own, and write the table."""
    bugs = tomllib.loads(PLANTED.read_text(encoding="utf-8"))["bug"]
    kept, rows, missed = Kept(options.keep, options.seconds), [], 0

    def tried(bug: dict[str, str]) -> list[Any]:
        with multiprocessing.get_context("fork").Pool(1) as pool:
            try:
                return list(pool.apply_async(found, (bug, options.seeds)).get(options.patience))
            except multiprocessing.TimeoutError:
                return [0, "does not end"]

    for bug in bugs:
        record = kept(json.dumps(bug), partial(tried, bug))
        if record is None:
            return 1
        seed, text = record
        missed += seed < 0
        cells = [f"`{bug['module']}`", f"`{bug['old'].strip()}`", f"`{bug['new'].strip()}`", seed if seed >= 0 else "not found", text]
        rows.append([str(cell).replace("|", "/").replace("\n", " ")[:150] for cell in cells])
        print(rows[-1], flush=True)
    about = f"{len(bugs)} bugs were planted, {len(bugs) - missed} of them found by the first {options.seeds} seeds at most."
    head = "# Planted bugs\n\n`python benchmarks/simulated_world.py --planted --keep FILE --write`"
    show(options, f"{head}\n\n{about}\n\n{table(['module', 'code', 'bug', 'first seed', 'noticed'], rows)}", "planted_bugs")
    return int(missed > len(bugs) // 25)


STUDY = Study("simulated_world", draw, page, "seeds", 200, {"world": tuple(WORLDS)}, "{world} {seed}")

if __name__ == "__main__":
    if "--planted" in sys.argv:
        parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
        parser.add_argument("--planted", action="store_true", required=True)
        parser.add_argument("--seeds", type=int, default=120, help="seeds for each bug")
        parser.add_argument("--patience", type=float, default=120.0, help="seconds for each bug")
        parser.add_argument("--keep", type=Path, help="file of what has run, to continue from")
        parser.add_argument("--seconds", type=float, default=math.inf, help="begin nothing new after this time")
        parser.add_argument("--write", action="store_true", help="write the page of results")
        parser.add_argument("--out", type=Path, help="another page to write")
        raise SystemExit(plant(parser.parse_args()))
    raise SystemExit(STUDY.command(__doc__))
