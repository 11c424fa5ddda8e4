"""What a person does in the workbench's pages with mouse and keyboard, in a browser that a test drives."""

import json
from pathlib import Path

from browser import Page

HERE = "location.pathname.replace(/^\\/~[^/]+/, '')"
"""The path of a page, without that of its session."""
ENDED = "!!document.querySelector('.after')"


def entered(page: Page) -> str:
    """The address before all pages of a browser that is let in, once it is."""
    page.wait("location.pathname.startsWith('/~') && document.readyState === 'complete'")
    return str(page.evaluate("location.origin + location.pathname.split('/').slice(0, 2).join('/')"))


def visit(page: Page, base: str, path: str) -> None:
    """Open a page of the workbench."""
    page.go(base + path)
    page.wait(f"{HERE} + location.search === {path!r} && document.readyState === 'complete'")


def press(page: Page, selector: str, then: str) -> None:
    """Press what a selector finds, once it is there, and wait."""
    found = f"(e => e && document.readyState === 'complete' && (e.click(), true))(document.querySelector({json.dumps(selector)}))"
    page.wait(found)
    page.wait(then)


def fill(page: Page, form: str, **values: str) -> None:
    """Type into the fields of a form."""
    for name, value in values.items():
        found = json.dumps(f"{form} [name='{name}']")
        typed = "for (const kind of ['input', 'change']) e.dispatchEvent(new Event(kind, {bubbles: true}))"
        page.evaluate(f"(() => {{const e = document.querySelector({found}); e.value = {json.dumps(value)}; {typed}}})()")


def choose(page: Page, selector: str, *paths: Path) -> None:
    """Choose files, or a folder, for a field."""
    page.call("DOM.enable")
    root = page.call("DOM.getDocument")["root"]["nodeId"]
    node = page.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
    page.call("DOM.setFileInputFiles", nodeId=node, files=[str(path) for path in paths])


def begin(page: Page, command: str, **values: str) -> int:
    """Fill in the form of a command, press its button and wait until its job has ended well; its number."""
    form = f"form[data-command='{command}']"
    page.wait(f"document.readyState === 'complete' && !!document.querySelector({json.dumps(form)})")
    fill(page, form, **values)
    press(page, f"{form} button.go", f"{HERE}.startsWith('/jobs/') && document.readyState === 'complete'")
    return ended(page)


def ended(page: Page, state: str = "done") -> int:
    """Wait until the job of the page has ended, in that state; its number."""
    page.wait(ENDED, seconds=400.0)
    reported = page.evaluate("[document.getElementById('job').dataset.state, document.querySelector('main').innerText]")
    assert reported[0] == state, reported[1]
    return int(page.evaluate("document.getElementById('job').dataset.number"))
