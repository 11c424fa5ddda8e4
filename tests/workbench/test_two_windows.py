"""Two browsers at once on one project, and several projects at once: nothing is lost, and each shows what is."""

import random
from pathlib import Path

import numpy as np
import pytest
from bench import served
from browser import Page, opened, window
from capture_bench import motion, on_bus, some_poses, true_rig
from clicks import ENDED, HERE, begin, entered, fill, press, visit

from lmeasure.recording import read_counts
from lmeasure.rig import read_rig, write_rig

SAMPLES = "Number(document.getElementById('live-samples')?.textContent)"
JOBS = "[...document.querySelectorAll('.jobs tbody tr')].map(r => [r.cells[1].textContent, r.cells[2].textContent])"


@pytest.mark.live
def test_one_window_records_and_another_works_in_the_same_project(tmp_path: Path) -> None:
    """They share no cookie. The other looks on, changes the rig, is led to the same recording, and works; both say the same in the end."""
    rig = true_rig()
    write_rig(tmp_path / "rig.toml", rig)
    there = motion(rig, some_poses(3), 0.3, speed_mm_s=800.0).recorded
    counts = np.tile(np.vstack([there, there[::-1]]), (30, 1))
    port, group = random.randrange(20000, 60000), f"239.74.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
    reported = {"bus": f"udp_multicast:{group}", "bus_option": f"port={port}", "out": "run"}
    bus = {"interface": "udp_multicast", "channel": group, "port": port, "hop_limit": 0}
    with (
        on_bus(rig, counts, bus),
        served(tmp_path) as address,
        opened(address) as one,
        # an address lets in one browser; here is the next
        window(one.browser, (tmp_path / ".workbench" / "address").read_text().strip()) as other,
    ):
        bases = {page: entered(page) for page in (one, other)}
        form = "form[data-command=record]"
        for page in (one, other):
            visit(page, bases[page], "/live")
            fill(page, form, **reported)
        for page in (one, other):
            press(page, f"{form} button.go", f"{HERE} === '/jobs/1' && document.readyState === 'complete'")
            page.wait(f"{SAMPLES} > 20")
        visit(other, bases[other], "/rig?file=rig.toml")
        fill(other, "#rig-form", **{"observation_point.0.position_mm.0": "861.5"})
        press(other, "#rig-form button.go", "location.search.includes('saved')")
        visit(other, bases[other], "/run/key")
        assert begin(other, "key", out="lab.key") == 2
        before = one.evaluate(SAMPLES)
        visit(other, bases[other], "/jobs/1")
        other.wait(f"{SAMPLES} > {before}")
        press(one, "#cancel", ENDED)
        other.wait(ENDED)  # by itself
        samples = [page.evaluate("document.querySelector('.summary').textContent.split(' ')[0]") for page in (one, other)]
        for page in (one, other):
            visit(page, bases[page], "/")
        seen = [page.evaluate(JOBS) for page in (one, other)]
        assert [page.errors for page in (one, other)] == [[], []]
    kept = read_counts(tmp_path / "run" / "pass1.csv")
    assert samples == [str(len(kept.time_s))] * 2
    gaps = np.isnan(kept.recorded[:-1]).any()  # the last row may be ended while it comes
    assert not gaps
    # as it was when the recording began, and as it is now
    assert read_rig(tmp_path / "run" / "rig.toml").observation_point == rig.observation_point
    assert read_rig(tmp_path / "rig.toml").observation_point[0].position_mm[0] == 861.5
    assert seen[0] == seen[1]
    assert [(line.split()[1], state) for line, state in seen[0]] == [("key", "done"), ("record", "done")]


def listed(page: Page) -> list[str]:
    """The projects on Home, as they stand there."""
    return [str(text) for text in page.evaluate("[...document.querySelectorAll('#projects li')].map(e => e.innerText.trim())")]


def test_projects_are_begun_opened_and_switched_by_clicks(tmp_path: Path) -> None:
    """Each has its own address; what is begun in one is not in another."""
    root = tmp_path / "root"
    with served(root / "first", root) as address, opened(address) as page:
        entered(page)
        assert listed(page) == ["first this one"]
        fill(page, "#projects form", name="../second")
        press(page, "#projects form button", "!!document.querySelector('#projects .error')")
        assert page.evaluate("document.getElementById('project-name').value") == "../second"
        fill(page, "#projects form", name="second cell")
        press(page, "#projects form button", "document.querySelectorAll('#projects li').length === 2 && location.hash === '#projects'")
        base = entered(page).rpartition("/")[0]
        press(
            page, "#projects a", f"document.readyState === 'complete' && location.origin !== {base!r} && !!document.querySelector('.way')"
        )
        assert "code" not in page.evaluate("location.href")
        assert page.evaluate("document.querySelector('h1').textContent") == "second cell"
        press(page, "a.button[href$='/rig']", f"{HERE} === '/rig'")
        begin(page, "init")
        press(page, "a.brand", f"{HERE} === '/' && document.readyState === 'complete'")
        assert listed(page) == ["second cell this one", "first is open"]
        press(
            page, "#projects a", f"location.origin === {base!r} && document.readyState === 'complete' && !!document.querySelector('.way')"
        )
        assert page.evaluate(JOBS) == []
        assert [error for error in page.errors if "422" not in error] == []
    assert sorted(path.name for path in root.iterdir()) == ["first", "second cell"]
    assert read_rig(root / "second cell" / "rig.toml")
    assert not (root / "first" / "rig.toml").exists()
    assert not list(root.glob("*/.workbench/address"))  # both have ended
