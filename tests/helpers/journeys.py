"""The ways of a mechanic and of an engineer through the workbench, from an empty folder, by what a mouse and a keyboard do alone: no
address is typed, no script of a page is called. `python benchmarks/workbench_journeys.py` walks them against the clock and keeps
pictures."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from browser import LOOK, Page
from clicks import ENDED, HERE, fill

READY = "document.readyState === 'complete' && !!document.body"
Reported = Callable[[str, Page], None]
"""Told after each step what was done, on the page that shows it."""


def tap(page: Page, selector: str, then: str) -> None:
    """Press the mouse on what a selector finds, once it is there, and wait."""
    page.wait(f"{READY} && !!document.querySelector({json.dumps(selector)})")
    page.click(selector)
    page.wait(f"{then} && {READY}")


def to(page: Page, path: str) -> None:
    """Go to a page by the row of links above all pages."""
    tap(page, f"header nav a[href$='{path}']", f"{HERE} === '{path}'")


def unfolded(page: Page, form: str) -> None:
    """Open the part of the page that a form is in, where it is folded."""
    fold = f"document.querySelector({json.dumps(form)}).closest('details')"
    page.wait(f"{READY} && !!document.querySelector({json.dumps(form)})")
    if page.evaluate(f"{fold} !== null && !{fold}.open"):
        tap(page, f"details:has(> {form}) > summary", f"{fold}.open")


def begun(page: Page, command: str, **values: str) -> None:
    """Fill in a command's form, load the page anew in the middle of it, and press its button; what was typed is still there."""
    form = f"form[data-command='{command}']"
    unfolded(page, form)
    page.evaluate(f"for (const e of document.querySelectorAll({json.dumps(form + ' details')})) e.open = true")
    fill(page, form, **values)
    page.again()
    typed = [f"document.querySelector({json.dumps(f'{form} [name={name}]')}).value === {json.dumps(v)}" for name, v in values.items()]
    page.wait(" && ".join(["true", *typed]))
    unfolded(page, form)
    tap(page, f"{form} button.go", f"{HERE}.startsWith('/jobs/')")


def done(page: Page) -> None:
    """Load the page of a job anew while it works, and wait until it has ended well."""
    page.again()
    page.wait(f"{ENDED} && {READY}", seconds=1200.0)  # kernels may have to be compiled
    state, reported = page.evaluate("[document.getElementById('job').dataset.state, document.querySelector('main').innerText]")
    assert state == "done", reported


def onward(page: Page, part: str) -> None:
    """Press the button, on the page of a job that is done, that leads on to an address."""
    tap(page, f".after a[href*='{part}']", f"({HERE} + location.search + location.hash).includes('{part}')")


def looked(page: Page) -> list[str]:
    """What is wrong with how the page looks, and with what it said."""
    return [*page.evaluate(LOOK), *(error for error in page.errors if "404" not in error)]


ASKED = "(e => e && !e.hidden ? e.textContent : '')(document.getElementById('asked'))"
WANTED = "(b => b && !b.hidden ? b.textContent : '')(document.getElementById('cell-asked'))"


def self_test(page: Page, *, reload_at: int) -> str:
    """Do what a self-test asks, by the buttons of the simulated cell; the state in which it ends. At a step the page is loaded anew."""
    seen, steps, end = "", 0, time.monotonic() + 550.0
    while not page.evaluate(ENDED):
        assert time.monotonic() < end, page.evaluate("document.querySelector('main').innerText")
        requested = str(page.evaluate(ASKED) or "")
        if requested and requested != seen:
            steps += 1
            if steps == reload_at:
                page.again()
                page.wait(f"{ASKED} === {json.dumps(requested)}")
            if page.evaluate(WANTED):
                page.click("#cell-asked")
                page.wait("document.querySelector('#lines .moves, #lines .unwanted') !== null")
                before = ""
                while before != (before := str(page.evaluate("document.getElementById('lines').innerText"))):
                    time.sleep(0.4)
            seen = requested
            page.click("[data-type='']:not([data-asked])")
            page.wait(f"{ASKED} !== {json.dumps(requested)} || {ENDED}", seconds=60.0)
        time.sleep(0.05)
    page.wait(READY)
    return str(page.evaluate("document.getElementById('job').dataset.state"))


def captured(page: Page, *, reload_at: int) -> None:
    """Send the robot to each pose that is wanted; the first is read by its button, the others as they rest. With so many read the page
    is loaded anew."""
    goal, end = "", time.monotonic() + 550.0
    while not page.evaluate(ENDED):
        assert time.monotonic() < end, (goal, page.evaluate("document.querySelector('main').innerText"))
        requested = str(page.evaluate(WANTED) or "")
        read = page.evaluate("document.querySelectorAll('#capture-poses .read').length") or 0
        if requested and requested != goal:
            if read == reload_at:
                page.again()
                page.wait(f"document.querySelectorAll('#capture-poses .read').length === {read} && {WANTED} === {json.dumps(requested)}")
            page.click("#cell-asked")
            page.wait(f"document.getElementById('cell-at').textContent.includes({json.dumps(f' {requested.split()[-1]}:')})")
            goal = requested
            if read == 0:
                there = f"`${{document.getElementById('cell').dataset.stands}} {requested.split()[-1]}:`"
                stands = f"document.getElementById('cell-at')?.textContent.includes({there})"
                page.wait(f"{stands} && document.querySelector('#capture-lamp.still') !== null")
                time.sleep(1.0)  # a person looks, and presses
                page.click("[data-type='']:not([data-asked])")
        time.sleep(0.05)
    page.wait(READY)
    assert page.evaluate("document.getElementById('job').dataset.state") == "done", page.evaluate(
        "document.querySelector('main').innerText"
    )


def who_speaks(page: Page, cables: int) -> None:
    """Listen on the bus, and pull the third cable: one line moves, that of its node."""
    page.wait(f"document.querySelectorAll('#cell-cables button').length === {cables}")
    tap(page, "#scan-listen", f"document.querySelectorAll('#scan-lines tbody tr').length === {cables + 1}")
    tap(page, "[data-cable=c3]", "document.querySelector('#scan-lines tr.lit') !== null")
    assert page.evaluate("document.querySelectorAll('#scan-lines tr.lit').length") == 1
    tap(page, "[data-cable=c3]", "document.querySelector('[data-cable=c3].out') === null")
    tap(page, "#scan-end", "document.getElementById('scan-end').hidden")


@dataclass(frozen=True)
class Job:
    """What a mechanic does: the shape of the rig, how many drums it has, how many poses are read and for how long, which plugs are
    exchanged, whether the drums are worked out from what a caliper said, whether a turn of each is counted, whether the zone is mapped and
    better places are searched."""

    template: str = "six-cables"
    drums: int = 6
    poses: int = 20
    dwell_s: str = "1.0"
    exchange: str = "ch2,ch5"
    calipers: bool = True
    turns: bool = True
    zone: bool = True


QUICK = Job(template="three-drums", drums=3, poses=4, dwell_s="0.3", exchange="ch1,ch3", calipers=False, turns=False, zone=False)
"""For a suite."""
GRID = dict.fromkeys("xyz", "-200:200:100")


def plugged(page: Page, reported: Reported, job: Job) -> None:
    """A cell is played whose plugs are exchanged; who speaks is seen, the plugs are found, mended by one click, and checked."""
    to(page, "/check")
    begun(page, "play", exchange=job.exchange)
    page.wait(f"document.querySelectorAll('#cell-cables button').length === {job.drums}")
    page.again()
    reported("a cell is played", page)
    to(page, "/check")
    who_speaks(page, job.drums)
    reported("who speaks", page)
    if not job.turns:
        unfolded(page, "form[data-command=check]")
        tap(page, "form[data-command=check] details summary", "document.querySelector('form[data-command=check] details').open")
        tap(page, "form[data-command=check] [name=turns]", "!document.querySelector('form[data-command=check] [name=turns]').checked")
    begun(page, "check")
    first = self_test(page, reload_at=4)
    assert first == "failed", page.evaluate("document.querySelector('main').innerText")
    red = page.evaluate("[...document.querySelectorAll('.cables .red')].map(row => row.cells[0].textContent)")
    assert red == [channel.replace("ch", "c") for channel in job.exchange.split(",")]
    reported("plugs are found exchanged", page)
    onward(page, "rig=rig-checked.toml")
    begun(page, "check", write="")
    assert self_test(page, reload_at=3) == "done", page.evaluate("document.querySelector('main').innerText")
    assert page.evaluate("document.querySelectorAll('.cables .red').length") == 0
    reported("the mended rig is checked", page)


def mechanic(page: Page, reported: Reported, job: Job = Job()) -> None:
    """From an empty folder to a calibrated rig in its zone, with its points placed anew: dimensions put in, drums worked out, poses
    planned, a cell played whose plugs are exchanged, found and mended, poses captured."""
    tap(page, "a.button[href$='/rig']", f"{HERE} === '/rig'")
    begun(page, "init", template=job.template)
    done(page)
    reported("a rig is begun", page)
    onward(page, "/rig")
    fill(page, "#rig-form", **{"observation_point.0.position_mm.2": "2025"})
    page.again()
    page.wait("document.getElementById('observation_point.0.position_mm.2').value === '2025'")
    page.wait("document.getElementById('scene-zone').textContent.includes('m³')", seconds=300.0)  # kernels may have to be compiled
    tap(page, "#rig-form button.go", "location.search.includes('saved')")
    reported("its dimensions", page)
    if job.calipers:
        tap(page, "nav.inside a[href$='/rig?file=drums.toml']", "location.search === '?file=drums.toml'")
        fill(page, "#rig-form", **{"drum.0.centre_distance_mm": "181.5"})
        page.again()
        page.wait("document.getElementById('drum.0.centre_distance_mm').value === '181.5'")
        tap(page, "#rig-form button.go", "location.search.includes('saved')")
        begun(page, "drum")
        done(page)
        reported("its drums", page)
    to(page, "/calibrate")
    begun(page, "plan-poses", poses=str(job.poses), box="-200:200,-200:200,-200:200")
    done(page)
    reported("poses are planned", page)
    plugged(page, reported, job)
    onward(page, "/calibrate")
    known = {"u_position_mm": "0.02", "u_rotation_deg": "0.003", "u_repeatability_mm": "0", "dwell_s": job.dwell_s}
    begun(page, "capture", rig="rig-checked.toml", **known)
    captured(page, reload_at=2)
    reported("poses are captured", page)
    onward(page, "/calibrate")
    begun(page, "calibrate")
    done(page)
    reported("calibrated", page)
    if not job.zone:
        return
    onward(page, "/run/zone")
    begun(page, "zone", **GRID)
    done(page)
    reported("Its zone", page)
    to(page, "/zone")
    begun(page, "place", rig="calibration/rig/rig.toml", generations="5")
    done(page)
    reported("its points placed anew", page)
    onward(page, "/run/zone")
    begun(page, "zone", **GRID)
    done(page)
    reported("the zone of the placed rig", page)


def engineer(page: Page, reported: Reported, project: Path) -> Path:
    """From an empty folder to a signed certificate of a simulated robot, verified; the zip of the certificate that was dropped."""
    import shutil

    from clicks import choose

    tap(page, ".tour button.go", f"{HERE}.startsWith('/jobs/')")
    done(page)
    reported("a cell, its robot and its campaign are simulated", page)
    to(page, "/calibrate")
    begun(page, "calibrate", folder="cell/campaign", out="calibrated")
    done(page)
    reported("calibrated", page)
    onward(page, "/run/zone")
    begun(page, "zone")
    done(page)
    reported("Its zone", page)
    onward(page, "/run/program")
    begun(page, "program", tests="pose,path")
    done(page)
    reported("a test program", page)
    to(page, "/runs")
    begun(page, "reconstruct", run="cell/run", out="trajectory.parquet")
    done(page)
    reported("the trajectory", page)
    onward(page, "/run/report")
    begun(page, "report")
    done(page)
    reported("its page", page)
    to(page, "/robot")
    begun(page, "key", out="lab.key")
    done(page)
    onward(page, "/run/certify")
    begun(
        page, "certify", key="lab.key", out="certificates/first", trajectory="trajectory.parquet", run="cell/run",
        program="cell/program.toml",
    )  # fmt: skip
    done(page)
    reported("a certificate, signed", page)
    onward(page, "/run/verify")
    begun(page, "verify")
    done(page)
    reported("verified", page)
    packed = Path(shutil.make_archive(str(project.parent / "mine"), "zip", project / "certificates" / "first"))
    to(page, "/robot")
    unfolded(page, "form[action$='/verify']")
    choose(page, "#packed", packed)
    tap(page, "form[action$='/verify'] button.go", f"{HERE}.startsWith('/jobs/')")
    done(page)
    reported("verified as a zip that was dropped", page)
    return packed
