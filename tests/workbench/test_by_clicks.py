"""What a person does with the mouse: a rig begun and changed, cables that are exchanged found and mended; how all pages look."""

import sys
import time
from pathlib import Path
from typing import Any

import pytest
from bench import served

from lmeasure.rig import read_rig, write_rig

sys.path[:0] = [str(Path(__file__).parents[1] / name) for name in ("report", "acquisition")]
from access import faults  # noqa: E402
from browser import LOOK, Page, opened  # noqa: E402
from clicks import ENDED, fill, press, visit  # noqa: E402
from test_buses import a_group  # noqa: E402
from test_check import Bench, two_cables  # noqa: E402
from test_tour import some_files_of_the_demo  # noqa: E402

PAGES = (
    "/",
    "/rig",
    "/check",
    "/live",
    "/calibrate",
    "/zone",
    "/runs",
    "/robot",
    "/files",
    "/commands",
    "/api",
    "/run/structure",
    "/details",
    "/trend",
    "/calibrations",
    "/?tour=1",
    "/nowhere",
)


def looked_at(
    page: Page, base: str, widths: dict[str, tuple[int, ...]], paths: tuple[str, ...] = PAGES, *, quick: bool = False
) -> list[Any]:
    """What is wrong with how pages look, in languages at widths, and what axe-core finds. quick: every other page, others in each
    language."""
    wrong: list[Any] = []
    for i, (language, wide) in enumerate(widths.items()):
        press(page, f".language [value={language}]", f"document.documentElement?.lang === '{language}'")
        for path in paths[i % 2 :: 2] if quick else paths:
            visit(page, base, path)
            for width in wide:
                page.resize(width)
                wrong += [(language, path, width, text) for text in page.evaluate(LOOK)]
            wrong += [(language, path, fault) for fault in faults(page)]
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize("language", ["ru", "en"])
def test_every_page_at_every_width(language: str, tmp_path: Path) -> None:
    """In a language, with a rig, a run, a trajectory and a certificate in the project."""
    write_rig(tmp_path / "rig.toml", two_cables())
    some_files_of_the_demo(tmp_path)
    more = (
        "/trajectory/cell/trajectory.parquet",
        "/look/cell/certificate",
        "/look/cell/run",
        "/start/cell/run",
        "/run/certify",
        "/run/zone",
    )
    with served(tmp_path) as address, opened(address) as page:
        assert looked_at(page, address.split("/?")[0], {language: (390, 1024, 1400, 2560)}, (*PAGES, *more)) == []


def test_a_rig_is_begun_changed_and_every_page_stands(tmp_path: Path) -> None:
    """In both languages; nothing is asked of another machine, nothing runs over."""
    with served(tmp_path) as address, opened(address) as page:
        base = address.split("/?")[0]
        page.wait("!!document.querySelector('.way')")
        assert "token" not in page.evaluate("location.href")
        visit(page, base, "/rig")
        press(page, "form[data-command=init] button.go", "location.pathname === '/jobs/1'")
        visit(page, base, "/jobs/1")  # loaded again in the middle
        page.wait(ENDED)
        assert page.evaluate("document.getElementById('state').textContent") == "done"
        visit(page, base, "/rig?file=rig.toml")
        page.evaluate("document.querySelector('[data-arrow=R]').focus()")
        assert page.evaluate("[...document.querySelectorAll('#cable .lit')].map(e => e.textContent)") == ["R"]
        page.evaluate("document.getElementById('inches').click()")
        fill(page, "#rig-form", **{"observation_point.0.position_mm.2": "80"})
        page.wait("document.getElementById('scene-zone').textContent.includes('m³')")
        press(page, "#rig-form button.go", "location.search.includes('saved')")
        assert read_rig(tmp_path / "rig.toml").observation_point[0].position_mm[2] == pytest.approx(2032.0, abs=1e-9)
        assert read_rig(tmp_path / "rig.toml").observation_point[0].position_mm[0] == 860.0
        assert looked_at(page, base, {"ru": (1024,), "en": (390,)}, quick=True) == []
        # who looks is heard: a field that nothing names
        page.evaluate("document.querySelector('main').append(document.createElement('input'))")
        assert [rule for rule, _ in faults(page)] == ["label"]
        assert [error for error in page.errors if "404" not in error] == []
        assert {request.split("/")[2] for request in page.requests if request.startswith("http")} == {base.removeprefix("http://")}


def test_exchanged_cables_are_red_and_one_click_mends_the_rig(tmp_path: Path) -> None:
    """The self-test over a real bus, a person who pulls, and the buttons of the page."""
    write_rig(tmp_path / "rig.toml", two_cables())
    group = a_group()
    person = Bench(two_cables(), {"interface": "udp_multicast", **group}, wiring=[1, 0])
    try:
        with served(tmp_path) as address, opened(address) as page:
            base = address.split("/?")[0]

            def walk(number: int) -> list[list[str]]:
                page.wait(f"location.pathname === '/jobs/{number}'")
                seen = ""
                while not page.now(ENDED):
                    asked = str(page.now("(e => e && !e.hidden ? e.textContent : '')(document.getElementById('asked'))") or "")
                    if asked and asked != seen:
                        seen = asked
                        person.do(asked.partition("  ")[2])
                        page.now("document.querySelector('[data-type=\"\"]').click()")
                    time.sleep(0.05)
                rows = "[...document.querySelectorAll('.cables tbody tr')]"
                return list(page.evaluate(f"{rows}.map(r => [r.cells[0].textContent, r.className, r.cells[1].textContent])"))

            visit(page, base, "/check")
            fill(page, "form[data-command=check]", rig="rig.toml", bus=f"udp_multicast:{group['channel']}")
            fill(page, "form[data-command=check]", bus_option=f"port={group['port']}", write="mended.toml")
            page.evaluate("document.querySelector('form[data-command=check] [name=turns]').checked = false")
            press(page, "form[data-command=check] button.go", "location.pathname.startsWith('/jobs/')")
            assert [row[:2] for row in walk(1)] == [["c1", "red"], ["c2", "red"]]
            press(page, ".after a[href*='rig=mended']", "location.pathname === '/run/check'")
            press(page, "form[data-command=check] button.go", "location.pathname.startsWith('/jobs/')")
            mended = walk(2)
            assert [row[:2] for row in mended] == [["c1", ""], ["c2", ""]], mended
            assert page.evaluate("document.getElementById('state').textContent") == "done"
    finally:
        person.close()
    assert [c.channel for c in read_rig(tmp_path / "mended.toml").cable] == ["ch2", "ch1"]
