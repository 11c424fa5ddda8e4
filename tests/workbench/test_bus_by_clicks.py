"""A simulated cell on a real bus of this machine, by clicks alone: a motion is watched, then recorded, in large figures."""

from pathlib import Path

import numpy as np
import pytest
from bench import served
from browser import LOOK, Page, opened
from clicks import ENDED, HERE, entered, fill, press, visit
from in_process import ran
from journeys import QUICK, plugged, tap

from lmeasure.recording import read_counts, read_run_head
from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig

pytestmark = pytest.mark.live


def begun(page: Page, base: str, path: str, command: str, **values: str) -> str:
    """Begin a command from a page; the path of its job."""
    visit(page, base, path)
    fill(page, f"form[data-command={command}]", **values)
    press(page, f"form[data-command={command}] button.go", f"{HERE}.startsWith('/jobs/') && document.readyState === 'complete'")
    return str(page.evaluate(f"{HERE}"))


@pytest.mark.slow
def test_a_bus_is_watched_and_recorded_by_clicks(tmp_path: Path) -> None:
    """Watched first, which writes nothing; its button leads to a recording that knows rig, bus and start."""
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    figures = "[document.getElementById('pose').innerText, document.getElementById('pose-u95').textContent]"
    with served(tmp_path) as address, opened(address) as page:
        base = entered(page)
        begun(page, base, "/check", "play", off_mm="0", off_deg="0")
        page.wait("document.getElementById('cell-at').textContent.includes('home')")

        watched = begun(page, base, "/live", "watch")
        page.wait("document.getElementById('pose-u95').textContent.startsWith('± 0.0')")
        assert len(page.evaluate("[...document.querySelectorAll('#channels .still')].map(e => e.innerText)")) == 6
        page.again()  # what comes is there again
        page.wait("document.getElementById('pose-u95').textContent.startsWith('± 0.0')")
        assert page.evaluate(LOOK) == []
        tap(page, "#cancel", ENDED)
        assert page.evaluate(f"[{HERE}, document.getElementById('job').dataset.state]") == [watched, "done"]

        tap(page, ".after a[href*='/run/record']", f"{HERE} === '/run/record'")
        fill(page, "form[data-command=record]", out="run")
        tap(page, "form[data-command=record] button.go", f"{HERE}.startsWith('/jobs/')")
        page.wait("document.getElementById('live').hidden === false")
        tap(page, "[data-do=run]", "document.querySelectorAll('#channels .moves').length === 6")
        assert page.evaluate(figures)[1].startswith("± 0.0"), page.evaluate(figures)
        assert page.evaluate("document.getElementById('live-lost').textContent") == "0"
        page.go(base + "/live")  # which leads to what is being recorded
        page.wait(f"{HERE}.startsWith('/jobs/') && document.getElementById('live').hidden === false")
        tap(page, "#cancel", ENDED)
        assert [error for error in page.errors if "404" not in error] == []
    assert np.isfinite(read_counts(tmp_path / "run" / "pass1.csv").recorded).all()
    assert read_run_head(tmp_path / "run").start is not None
    assert sorted(path.name for path in tmp_path.iterdir()) == [".workbench", "rig.toml", "run"]


def test_one_job_is_not_begun_twice(tmp_path: Path) -> None:
    """By a second click, or another browser on the same project: both are led to the same job."""
    from concurrent.futures import ThreadPoolExecutor

    from bench import client

    write_rig(tmp_path / "rig.toml", cell_rig(0))
    with client(tmp_path) as session:
        form = {"_form": "1", "rig": "rig.toml", "bus": "udp_multicast:239.74.201.3", "out": "run", "turns": "on"}
        with ThreadPoolExecutor(4) as several:
            answers = list(several.map(lambda _: session.post("/run/record", data=form).headers["location"], range(4)))
        assert set(answers) == {"/jobs/1"}
        assert [job["state"] for job in session.get("/api/jobs").json()["jobs"]] == ["running"]
        session.delete("/api/jobs/1")


@pytest.mark.slow
def test_exchanged_plugs_are_found_and_mended_by_one_click(tmp_path: Path) -> None:
    """Exactly two cables are red; then none is."""
    ran("init", tmp_path, "--template", QUICK.template)
    with served(tmp_path) as address, opened(address) as page:
        plugged(page, lambda what, shown: None, QUICK)
        assert page.errors == []
