"""Record in simulated worlds: bus, clocks, disk and kills from one seed (`tests/helpers/worlds.py`); and plant bugs to be found.

    python benchmarks/simulated_world.py --keep FILE [--runs SEEDS] [--first SEED] [--write]
    python benchmarks/simulated_world.py --planted --keep FILE [--seeds N] [--write]

Each seed is a recording with its faults. A sample that was shown is in the files, no count is invented, each file is whole or absent, the
log gives the same counts again, and every tenth seed leaves the same bytes when it is lived again. --planted puts each fault of
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
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from study import Kept, Study, show, table

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors")]

from worlds import drawn, lived  # noqa: E402

PLANTED = Path(__file__).parent / "planted_bugs.toml"
LIVED_AGAIN = 10
"""Every tenth seed."""


def draw(seed: int) -> dict[str, Any]:
    """Live one seed, some twice."""
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as name:
        outcome = lived(drawn(seed), Path(name) / "run")
        wrong = list(outcome.wrong)
        if seed % LIVED_AGAIN == 0 and lived(drawn(seed), Path(name) / "run").digest != outcome.digest:
            wrong.append("lived again, it leaves other bytes")
    return asdict(outcome) | {"wrong": wrong, "processor_s": time.process_time() - begun}


def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
    """Return the table of faults and ends."""
    wrong = [one for one in records if one["wrong"]]
    rows = []
    for kind in sorted({fault for one in records for fault in one["faults"]} | {"none"}):
        own = [one for one in records if kind in (one["faults"] or ["none"])]
        ends = [sum(one["ended"].startswith(end) for one in own) for end in ("complete", "killed", "refused")]
        rows.append([kind, len(own), *ends, len(own) - sum(ends), sum(bool(one["wrong"]) for one in own)])
    hours, spent = sum(one["seconds"] for one in records) / 3600.0, sum(one["processor_s"] for one in records) / 3600.0
    lines = [
        "# Recordings in simulated worlds",
        "`python benchmarks/simulated_world.py --keep FILE --write`",
        f"{len(records)} seeds, {hours:.1f} simulated hours in {spent:.2f} hours of one processor: {hours / spent:.0f} an hour. "
        f"{sum(one['samples'] for one in records)} samples. {len(wrong)} seeds were wrong.",
        *(f"- seed {one['seed']}: {'; '.join(one['wrong'][:2])}" for one in wrong[:10]),
        table(["fault", "seeds", "complete", "killed", "refused", "ended early", "wrong"], rows),
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


def plant(asked: argparse.Namespace) -> int:
    """Plant each bug in a process of its own, and write the table."""
    bugs = tomllib.loads(PLANTED.read_text(encoding="utf-8"))["bug"]
    kept, rows, missed = Kept(asked.keep, asked.seconds), [], 0

    def tried(bug: dict[str, str]) -> list[Any]:
        with multiprocessing.get_context("fork").Pool(1) as pool:
            try:
                return list(pool.apply_async(found, (bug, asked.seeds)).get(asked.patience))
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
    about = f"{len(bugs)} bugs were planted, {len(bugs) - missed} of them found by the first {asked.seeds} seeds at most."
    head = "# Planted bugs\n\n`python benchmarks/simulated_world.py --planted --keep FILE --write`"
    show(asked, f"{head}\n\n{about}\n\n{table(['module', 'code', 'bug', 'first seed', 'noticed'], rows)}", "planted_bugs")
    return int(missed > len(bugs) // 25)


STUDY = Study("simulated_world", draw, page, "seeds", 200)

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
