"""What axe-core finds wrong with a page for those who use a keyboard, a screen reader, or weak eyes."""

import json
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from browser import Page

GRAVE = ("serious", "critical")


@cache
def _axe() -> str:
    """The script of axe-core that its package for Python ships; its driver of browsers is not needed."""
    found = find_spec("axe_playwright_python")
    assert found is not None
    assert found.origin is not None
    return (Path(found.origin).parent / "axe.min.js").read_text(encoding="utf-8")


def faults(page: Page) -> list[tuple[str, Any]]:
    """Serious and critical faults of the page as it stands: rule, and the elements. What frames show is looked at as pages of its own."""
    if not page.evaluate("typeof axe === 'object'"):
        page.evaluate(_axe() + "; 1")
    requested = "axe.run(document, {iframes: false, resultTypes: ['violations']}).then((found) => JSON.stringify(found.violations))"
    reported = json.loads(page.evaluate(requested))
    return [(v["id"], [node["html"][:120] for node in v["nodes"]][:5]) for v in reported if v["impact"] in GRAVE]
