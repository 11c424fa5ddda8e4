"""The whole ways through the workbench by mouse and keyboard, in headless Chromium, against the clock.

    python benchmarks/workbench_journeys.py newcomer|mechanic|engineer [--pictures FOLDER]

newcomer: from `lmeasure demo` to its page with all pictures drawn. mechanic: from an empty folder to a calibrated rig in its zone with its
points placed anew, over a bus of this machine to a simulated cell whose plugs are exchanged. engineer: from an empty folder to a signed
certificate of a simulated robot, verified. Every page is loaded anew in the middle. Printed: when each step was done, how long it took, and
what is wrong with how its page looks.

The others walk by commands, and print the time of each: an engineer with a foreign log and a laboratory
(`pytest -s tests/journeys/test_journeys_to_certificates.py`), a researcher (`pytest -s -m slow
tests/journeys/test_journey_of_a_researcher.py`).
"""

import argparse
import base64
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from bench import served  # noqa: E402
from browser import Page, opened  # noqa: E402
from journeys import Job, engineer, looked, mechanic  # noqa: E402


def main() -> None:
    """Walk, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("who", choices=("newcomer", "mechanic", "engineer"))
    parser.add_argument("--pictures", type=Path, help="a folder for a picture of each step's page")
    parser.add_argument("--poses", type=int, default=20, help="of the mechanic's calibration")
    asked = parser.parse_args()
    begin = last = time.monotonic()
    number = 0

    def reported(what: str, page: Page) -> None:
        nonlocal last, number
        number += 1
        now = time.monotonic()
        print(f"{now - begin:7.1f} s  {now - last:6.1f} s  {what}", *looked(page), sep="\n    " if looked(page) else "  ", flush=True)
        if asked.pictures is not None:
            asked.pictures.mkdir(parents=True, exist_ok=True)
            (asked.pictures / f"{asked.who}-{number:02}.png").write_bytes(base64.b64decode(page.shoot()))
        last = time.monotonic()

    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "project"
        if asked.who == "newcomer":
            subprocess.run([sys.executable, "-m", "lmeasure", "demo", "--out", str(project), "--no-browser"], check=True)
            print(f"{time.monotonic() - begin:7.1f} s  the demo has ended")
            with opened(project / "demo.html") as page:
                page.wait("[...document.querySelectorAll('.js-plotly-plot')].length === 6")
                page.wait("[...document.querySelectorAll('.js-plotly-plot')].every(e => e._fullLayout)")
                reported("its page is there", page)
            return
        with served(project) as address, opened(address, Path(scratch) / "profile") as page:
            begin = last = time.monotonic()
            if asked.who == "mechanic":
                mechanic(page, reported, Job(poses=asked.poses))
            else:
                engineer(page, reported, project)


if __name__ == "__main__":
    main()
