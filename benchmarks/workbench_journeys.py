"""The whole ways of six persons to what they want, by mouse and keyboard in Chromium or by commands, against the clock.

    python benchmarks/workbench_journeys.py WHO ... [--pictures FOLDER] [--write]

newcomer: from `lmeasure demo` to its page with all pictures drawn. mechanic: from an empty folder to a calibrated rig in its zone with
its points placed anew, over a bus of this machine to a simulated cell whose plugs are exchanged. engineer: from an empty folder to a
signed certificate of a simulated robot, verified. Every page is loaded anew in the middle. foreign-log: from a log of another program to
a verified certificate. laboratory: from a rig to a certificate that others verify. researcher: the README's script line by line, and the
notebooks cell by cell. Printed: when each step was done, how long it took, and what is wrong with how its page looks. --write keeps a row
for each in results/journeys.md.
"""

import argparse
import base64
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests"
TABLE = Path(__file__).parent / "results" / "journeys.md"
sys.path.insert(0, str(TESTS / "helpers"))

from bench import served  # noqa: E402
from browser import Page, opened  # noqa: E402
from journeys import Job, engineer, looked, mechanic  # noqa: E402

BY_COMMANDS = {
    "foreign-log": "test_journeys_to_certificates.py -k engineer",
    "laboratory": "test_journeys_to_certificates.py -k laboratory",
    "researcher": "test_journey_of_a_researcher.py -m slow",
}
FROM_TO = {
    "newcomer": "`lmeasure demo` to its page, all pictures drawn",
    "mechanic": "an empty folder to a calibrated rig in its zone, by clicks",
    "engineer": "an empty folder to a signed, verified certificate, by clicks",
    "foreign-log": "a log of another program to a verified certificate",
    "laboratory": "a rig to a certificate that others verify",
    "researcher": "the README's script and the notebooks",
}
HEAD = """# Journeys

`python benchmarks/workbench_journeys.py WHO --write`. Wall time, with the number of processes that the machine's two processors had to do
meanwhile (load average of a minute); a step is a page or a command whose end a person sees.

| who | from, to | steps | time [s] | load |
|---|---|---:|---:|---:|
"""


def newcomer(project: Path, step: Callable[[str, Page | None], None]) -> None:
    """Run the demo, and open its page."""
    subprocess.run([sys.executable, "-m", "lmeasure", "demo", "--out", str(project), "--no-browser"], check=True)
    step("the demo has ended", None)
    with opened(project / "demo.html") as page:
        page.wait("[...document.querySelectorAll('.js-plotly-plot')].length === 6")
        page.wait("[...document.querySelectorAll('.js-plotly-plot')].every(e => e._fullLayout)")
        step("its page is there", page)


def by_commands(who: str) -> int:
    """Walk by the test of the suite that is this way; the number of its steps."""
    file, *rest = BY_COMMANDS[who].split()
    words = [sys.executable, "-m", "pytest", "-n0", "-q", "-s", str(TESTS / "journeys" / file), *rest]
    done = subprocess.run(words, capture_output=True, text=True, cwd=TESTS.parent, check=False)
    print(done.stdout)
    if done.returncode:
        sys.exit(done.returncode)
    return len(re.findall(r": \d+\.\d s", done.stdout))


def walk(who: str, pictures: Path | None, poses: int) -> tuple[int, float]:
    """Walk; the number of steps and the time [s]."""
    begin = last = time.monotonic()
    number = 0

    def step(what: str, page: Page | None) -> None:
        nonlocal last, number
        number += 1
        now, wrong = time.monotonic(), [] if page is None else looked(page)
        print(f"{now - begin:7.1f} s  {now - last:6.1f} s  {what}", *wrong, sep="\n    " if wrong else "  ", flush=True)
        if pictures is not None and page is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            (pictures / f"{who}-{number:02}.png").write_bytes(base64.b64decode(page.shoot()))
        last = time.monotonic()

    if who in BY_COMMANDS:
        return by_commands(who), time.monotonic() - begin
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "project"
        if who == "newcomer":
            newcomer(project, step)
            return number, last - begin
        with served(project) as address, opened(address, Path(scratch) / "profile") as page:
            begin = last = time.monotonic()
            if who == "mechanic":
                mechanic(page, step, Job(poses=poses))
            else:
                engineer(page, step, project)
            return number, last - begin


def keep(who: str, steps: int, seconds: float) -> None:
    """Write the row of a way into the table, in place of an earlier one."""
    rows = TABLE.read_text(encoding="utf-8").splitlines() if TABLE.exists() else []
    known = {name: row for row in rows for name in FROM_TO if row.startswith(f"| {name} ")}
    known[who] = f"| {who} | {FROM_TO[who]} | {steps} | {seconds:.0f} | {os.getloadavg()[0]:.1f} |"
    TABLE.write_text(HEAD + "".join(f"{known[name]}\n" for name in FROM_TO if name in known), encoding="utf-8")


def main() -> None:
    """Walk, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("who", nargs="+", choices=tuple(FROM_TO))
    parser.add_argument("--pictures", type=Path, help="a folder for a picture of each step's page")
    parser.add_argument("--poses", type=int, default=20, help="of the mechanic's calibration")
    parser.add_argument("--write", action="store_true", help="keep the row of each in results/journeys.md")
    options = parser.parse_args()
    for who in options.who:
        steps, seconds = walk(who, options.pictures, options.poses)
        if options.write:
            keep(who, steps, seconds)


if __name__ == "__main__":
    main()
