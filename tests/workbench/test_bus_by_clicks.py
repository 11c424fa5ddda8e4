"""A simulated cell on a real bus of this machine, by clicks alone: who speaks lights up, poses are captured through a reload, a motion is
recorded in large figures."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from bench import served

from lmeasure.counts import read_counts
from lmeasure.files import read_table
from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig

sys.path[:0] = [str(Path(__file__).parents[1] / name) for name in ("report", "capture")]
from browser import LOOK, Page, opened  # noqa: E402
from capture_bench import some_poses, write_inputs  # noqa: E402
from clicks import ENDED, fill, press, visit  # noqa: E402

pytestmark = pytest.mark.live


def begun(page: Page, base: str, path: str, command: str, **values: str) -> str:
    """Begin a command from a page; the path of its job."""
    visit(page, base, path)
    fill(page, f"form[data-command={command}]", **values)
    press(page, f"form[data-command={command}] button.go", "location.pathname.startsWith('/jobs/') && document.readyState === 'complete'")
    return str(page.evaluate("location.pathname"))


def test_who_speaks_a_capture_and_a_recording_by_clicks(tmp_path: Path) -> None:
    rig = cell_rig(0)
    write_inputs(tmp_path, rig, some_poses(3), u_position_mm=[0.05] * 3, u_rotation_deg=[0.01] * 3)
    with served(tmp_path) as address, opened(address) as page:
        base = address.split("/?")[0]
        begun(page, base, "/check", "play", off_mm="0", off_deg="0")
        page.wait("document.querySelectorAll('#cell-cables button').length === 6")

        visit(page, base, "/check")
        assert page.evaluate("document.querySelector('form[data-command=check] [name=bus]').value").startswith("udp_multicast:239.74.")
        page.wait("document.querySelectorAll('#cell-cables button').length === 6")
        page.evaluate("document.getElementById('scan-listen').click()")
        page.wait("document.querySelectorAll('#scan-lines tbody tr').length === 7")
        page.evaluate("document.querySelector('[data-cable=c3]').click()")
        page.wait("document.querySelector('#scan-lines tr.lit')?.cells[0].textContent === '183'")
        assert page.evaluate("document.querySelectorAll('#scan-lines tr.lit').length") == 1
        page.evaluate("document.querySelector('[data-cable=c3]').click()")
        page.evaluate("document.getElementById('scan-end').click()")
        # of rests the first is read wherever the robot stands
        page.evaluate("document.querySelector('#cell-poses button').click()")
        page.wait("document.getElementById('cell-at').textContent.startsWith('stands at 1')")

        job = begun(page, base, "/calibrate", "capture", dwell_s="0.2", settle_s="0.1", u_repeatability_mm="0", out="campaign", by="rest")
        goal, end = "", time.monotonic() + 90.0
        while not page.now(ENDED):
            assert time.monotonic() < end, (goal, page.now("document.querySelector('main').innerText"))
            asked = page.now("(b => b && !b.hidden ? b.textContent : '')(document.getElementById('cell-asked'))") or ""
            if asked and asked != goal:
                goal = asked
                if page.now("document.querySelectorAll('#capture-poses .read').length") == 2:
                    visit(page, base, job)  # loaded again in the middle: all that was read is there
                    page.wait("document.querySelectorAll('#capture-readings tbody tr').length === 2")
                    assert page.evaluate(LOOK) == []
                page.now("document.getElementById('cell-asked').click()")
            time.sleep(0.05)
        assert page.evaluate("document.getElementById('job').dataset.state") == "done"

        begun(page, base, "/live", "record", out="run", start="0,0,0,90,-90,0")
        page.wait("document.getElementById('live')?.hidden === false")
        page.evaluate("document.querySelector('[data-do=run]').click()")
        page.wait("document.querySelectorAll('#channels .moves').length === 6")
        figures = page.evaluate("[document.getElementById('pose').innerText, document.getElementById('pose-u95').textContent]")
        assert figures[1].startswith("± 0.0"), figures
        assert page.evaluate("document.getElementById('live-lost').textContent") == "0"
        page.go(base + "/live")  # which leads to what is being recorded
        page.wait("location.pathname.startsWith('/jobs/') && document.getElementById('live')?.hidden === false")
        press(page, "#cancel", ENDED)
        assert [error for error in page.errors if "404" not in error] == []
    table = read_table(tmp_path / "campaign" / "counts.csv")
    assert list(dict.fromkeys(table.text("pose"))) == ["1", "2", "3"]
    assert np.isfinite(read_counts(tmp_path / "run" / "pass1.csv").recorded).all()


def test_one_job_is_not_begun_twice(tmp_path: Path) -> None:
    """By a second click, or another browser on the same project: both are led to the same job."""
    from concurrent.futures import ThreadPoolExecutor

    from bench import client

    write_rig(tmp_path / "rig.toml", cell_rig(0))
    with client(tmp_path) as asked:
        form = {"_form": "1", "rig": "rig.toml", "bus": "udp_multicast:239.74.201.3", "out": "run", "turns": "on"}
        with ThreadPoolExecutor(4) as several:
            answers = list(several.map(lambda _: asked.post("/run/record", data=form).headers["location"], range(4)))
        assert set(answers) == {"/jobs/1"}
        assert [job["state"] for job in asked.get("/api/jobs").json()["jobs"]] == ["running"]
        asked.delete("/api/jobs/1")
