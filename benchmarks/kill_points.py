"""Look at every command that writes at each rename, removal and fsync: files are whole and durable, and the command can be run again.

    python benchmarks/kill_points.py [COMMAND ...]

Each command of `tests/helpers/desk.py` runs twice in one process: it writes its files for the first time, and replaces others. What a
kill or a
power failure would leave at each call, and how that is judged, `tests/helpers/kills.py` says. From each different state the command is run
again; those that take longest, from some. Recordings are files that grow: of them only the end is judged. `check` waits for a person and
is left out. The table goes to benchmarks/results/kill_points.md; with commands named, it is only printed.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
import pages  # noqa: E402
import test_interim as interim  # noqa: E402
from desk import LONG, RECORDINGS, SHORT, set_up  # noqa: E402
from kills import ended, looked_at, watched  # noqa: E402

from lmeasure.recording import write_run  # noqa: E402

MOST_RERUNS = {"zone": 6, "place": 2, "demo": 2, "plan-poses": 6, "calibrate": 8, "certify": 10, "identify": 6}
"""Of the commands that take long."""
OTHERS = {
    "identify": "identify --robot ur5 --measurements ur5/rows.csv --out OUT/identified",
    "check-instrument": "check-instrument stops --out OUT/check",
}
"""Commands whose inputs take long to make."""


def main() -> None:
    """Write the table."""
    rows = ["| command | calls | run again from | s | wrong |", "|---|---|---|---|---|"]
    every = SHORT | {name: LONG[name] for name in LONG if name != "check"} | OTHERS
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        set_up(here)
        os.chdir(here)
        ended("init . --template six-cables", here)
        write_run(here / "stops", interim.run_of(interim.true_rig(), 0)[0])
        pages.PAGES["identification"](here / "ur5", "en")
        for name in sys.argv[1:] or [*every, *RECORDINGS]:
            begun = time.perf_counter()
            if name in RECORDINGS:
                (here / "recordings").mkdir(exist_ok=True)
                with watched(here / "recordings") as seen:
                    ended(RECORDINGS[name], here / "recordings")
                wrong = [text for text in seen.wrong if text.endswith("at the end")]
                cells = [str(seen.calls), "-"]
            else:
                found = looked_at(every[name], here / "out", MOST_RERUNS.get(name, 1000))
                wrong, cells = found.wrong, [str(found.calls), str(found.reruns)]
            rows.append(f"| `{name}` | {' | '.join(cells)} | {time.perf_counter() - begun:.0f} | {'; '.join(wrong[:3]) or 'nothing'} |")
            print(rows[-1], flush=True)
    if not sys.argv[1:]:
        text = "# Commands at each rename, removal and fsync\n\n`python benchmarks/kill_points.py`\n\n" + "\n".join(rows) + "\n"
        (ROOT / "benchmarks" / "results" / "kill_points.md").write_text(text)


if __name__ == "__main__":
    main()
