"""What a person does with the mouse: a rig changed; how all pages look."""

from pathlib import Path
from typing import Any

import pytest
from access import faults
from bench import served, some_files_of_the_demo
from browser import LOOK, Page, opened
from clicks import entered, fill, press, visit
from test_check import two_cables

from lmeasure.rig import read_rig, write_rig
from lmeasure.workflows import load

PAGES = (
    "/", "/rig", "/check", "/live", "/calibrate", "/zone", "/runs", "/robot", "/files", "/commands", "/api", "/run/structure", "/details",
    "/trend", "/calibrations", "/register", "/nowhere",
)  # fmt: skip


def looked_at(
    page: Page, base: str, widths: dict[str, tuple[int, ...]], paths: tuple[str, ...] = PAGES, *, quick: bool = False
) -> list[Any]:
    """What is wrong with how pages look, in languages at widths, and what axe-core finds. quick: every third page, others in each
    language."""
    wrong: list[Any] = []
    for i, (language, wide) in enumerate(widths.items()):
        press(page, f".language [value={language}]", f"document.documentElement?.lang === '{language}'")
        for path in paths[i % 3 :: 3] if quick else paths:
            for width in wide:
                page.resize(width)
                visit(page, base, path)
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
        "/trajectory/cell/trajectory.parquet", "/look/cell/certificate", "/look/cell/run", "/start/cell/run", "/run/certify", "/run/zone",
    )  # fmt: skip
    with served(tmp_path) as address, opened(address) as page:
        assert looked_at(page, entered(page), {language: (390, 1024, 1400, 2560, 3840)}, (*PAGES, *more)) == []


def test_a_rig_is_changed_and_every_page_stands(tmp_path: Path) -> None:
    """In both languages; nothing is asked of another machine, nothing runs over."""
    init = load("init")
    init.run(init.settings.model_validate({"out": tmp_path, "template": "six-cables"}))
    with served(tmp_path) as address, opened(address) as page:
        base = entered(page)
        page.wait("!!document.querySelector('.way')")
        assert "code" not in page.evaluate("location.href")
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
        assert {request.split("/")[2] for request in page.requests if request.startswith("http")} == {base.split("/")[2]}
