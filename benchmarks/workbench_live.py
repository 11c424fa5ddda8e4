"""The workbench's live page over hours: from a frame on the bus to its figures on the screen, and what grows meanwhile.

`python benchmarks/workbench_live.py [--minutes 60] [--rate 1000] [--kept rows.csv]` plays six channels on a bus of this machine, records
them from the page in a headless Chromium, and looks every few seconds at the median that the page states and at the memory of the server,
the recorder and the browser. It prints how they are at first, in the middle and in the end, their slopes over the second half, and whether
the recorder lost anything.
"""

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from bench import served_apart, token, until  # noqa: E402
from browser import Page, opened  # noqa: E402
from clicks import entered  # noqa: E402
from study import options, show, table  # noqa: E402

from lmeasure.recording import read_counts  # noqa: E402
from lmeasure.rig import write_rig  # noqa: E402
from lmeasure.simulation import cell_rig  # noqa: E402
from lmeasure.workflows import own_bus  # noqa: E402

EVERY_S = 5.0
COLUMNS = ("seconds", "frame_to_screen_ms", "server_mb", "recorder_mb", "browser_mb", "scripts_mb")
MB = 2**20


def resident(pid: int) -> float:
    """Memory of a process [MB], what it shares counted by its part."""
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    except OSError:
        return float("nan")
    return next(int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")) / 1024


def processes(word: str) -> list[int]:
    """Those whose command line has the word."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if word.encode() in entry.read_bytes():
                found.append(int(entry.parent.name))
        except OSError:
            continue
    return found


def heap(page: Page) -> float:
    """Of the page's scripts, what is in use after a collection [MB]."""
    page.call("HeapProfiler.collectGarbage")
    return float(page.call("Runtime.getHeapUsage")["usedSize"]) / MB


def measure(folder: Path, minutes: float, rate_hz: float, kept: Path | None = None) -> dict[str, Any]:
    """The table of what was seen, kept in a file as it grows, and what the recorder says in the end."""
    write_rig(folder / "rig.toml", cell_rig(0))
    with served_apart(folder) as address, opened(address, folder / ".profile") as page:
        base, known = address.split("/?")[0], token(folder)

        def ask(path: str, content: Any = None) -> Any:
            head = {"Authorization": f"Bearer {known}", "Content-Type": "application/json"}
            with urlopen(Request(base + path, None if content is None else json.dumps(content).encode(), head)) as answer:
                return json.load(answer)

        def begin(command: str, **settings: Any) -> int:
            return int(ask("/api/jobs", {"command": command, "settings": settings})["number"])

        bus = own_bus(folder)
        cell = begin("play", rig="rig.toml", bus=bus, rate_hz=rate_hz)
        until(lambda: "cell" in ask(f"/jobs/{cell}/last")["last"], 180.0)
        job = begin("record", rig="rig.toml", bus=bus, out="run", start="0,0,0,90,-90,0")
        until(lambda: ask(f"/jobs/{job}/last")["last"].get("live", {}).get("samples", 0) > 100, 180.0)
        page.go(f"{entered(page)}/jobs/{job}")
        rows = []
        server = processes("workbench\0" + str(folder))
        recorder = [int(json.loads((folder / f".workbench/jobs/{job:04}/asked.json").read_text())["process"])]
        begun = time.monotonic()
        while time.monotonic() - begun < 60.0 * minutes:
            if not ask(f"/jobs/{cell}/last")["last"]["cell"]["moves"]:
                ask(f"/api/jobs/{cell}", {"line": "run"})
            time.sleep(EVERY_S)
            median = page.evaluate("document.getElementById('live-screen').textContent")
            memory = [sum(map(resident, pids)) for pids in (server, recorder, processes(str(folder / ".profile")))]
            rows.append([time.monotonic() - begun, float(median) if median != "–" else np.nan, *memory, heap(page)])
            if kept is not None:
                np.savetxt(
                    kept, rows, "%.3f", ",", header="seconds,frame_to_screen_ms,server_mb,recorder_mb,browser_mb,scripts_mb", comments=""
                )
        last = ask(f"/jobs/{job}/last")["last"]["live"]
        with urlopen(Request(f"{base}/api/jobs/{job}", method="DELETE", headers={"Authorization": f"Bearer {known}"})):
            pass
        until(lambda: ask(f"/jobs/{job}/last")["state"] != "running", 60.0)
    counts = read_counts(folder / "run" / "pass1.csv")
    gaps = int(np.isnan(counts.recorded).any(axis=1).sum())
    return {"rows": np.array(rows), "last": last, "samples": len(counts.time_s), "gaps": gaps, "seconds": float(counts.time_s[-1])}


def main() -> None:
    """Measure and print."""
    parser = options(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--kept", type=Path, help="a .csv that the table is written to while it grows")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        reported = measure(Path(name), arguments.minutes, arguments.rate, arguments.kept)
    rows, last = reported["rows"], reported["last"]
    seconds = reported["seconds"]
    lines = [
        f"# The workbench's live page, {arguments.minutes:g} minutes at {arguments.rate:g} Hz",
        f"{reported['samples']} samples in {seconds:.0f} s ({reported['samples'] / seconds:.0f} a second). Frames lost: {last['lost']}, "
        f"samples with an empty cell: {reported['gaps']}, faults: {last['faults'] or 'none'}.",
        f"Frame to screen: median {np.nanmedian(rows[:, 1]):.0f} ms, largest median {np.nanmax(rows[:, 1]):.0f} ms.",
    ]
    half, memory = rows[len(rows) // 2 :], []
    for j, what in enumerate(("server", "recorder", "browser", "scripts of the page"), 2):
        slope = np.polyfit(half[:, 0], half[:, j], 1)[0] * 3600.0 if len(half) > 2 else np.nan
        memory.append([what, *(f"{rows[i, j]:.1f}" for i in (0, len(rows) // 2, -1)), f"{slope:+.2f}"])
    head = ["memory [MB]", "at first", "in the middle", "in the end", "change over the second half, a straight line [MB/h]"]
    show(arguments, "\n\n".join([*lines, table(head, memory)]), "workbench_live")


if __name__ == "__main__":
    main()
