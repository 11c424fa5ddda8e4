"""A headless Chromium driven over its DevTools protocol: open a page, click as a person would, hear its console."""

import atexit
import base64
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-dev-shm-usage", "--hide-scrollbars", "--window-size=1300,1000", "--remote-debugging-port=0",
)  # fmt: skip


LOOK = (Path(__file__).parent / "look.js").read_text(encoding="utf-8")
"""What is wrong with how a page looks, as far as a machine can tell: a list of texts."""

PATIENCE_S = 180.0
"""How long a page is waited for: longer than a machine with much else to do keeps it."""

PLACE = """(selector, across, down) => {
  const e = document.querySelector(selector);
  if (!e) return null;
  e.scrollIntoView({block: 'center', behavior: 'instant'});
  const box = e.getBoundingClientRect(), x = box.x + across * box.width, y = box.y + down * box.height;
  const own = (hit) => hit && (e.contains(hit) || e.ownerSVGElement?.contains(hit) || hit.closest('label')?.control === e);
  window.pressed = false;
  // a press that ends on something else, because the page moved in between, is no click; plotly covers what is pressed
  const kind = e.closest('.js-plotly-plot') ? 'mousedown' : 'click';
  document.addEventListener(kind, (event) => { window.pressed = Boolean(own(event.target)); }, {once: true, capture: true});
  return own(document.elementFromPoint(x, y)) ? [x, y] : null;
}"""
"""Where the mouse goes to press an element, nothing while it is not there or covered; `pressed` says afterwards whether it was."""

LEAVING = ("Inspected target navigated or closed", "Execution context was destroyed", "Cannot find context with specified id")
"""What the browser answers to a script of a page that it is just leaving."""


class Page:
    """One open page. `errors` holds every console error, uncaught exception and failed request so far, `requests` what it asked for."""

    def __init__(self, socket: ClientConnection, session: str, browser: str) -> None:
        self.browser = browser
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._arrived: list[str] = []
        self._socket, self._session, self._number = socket, session, 0

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Answer of one protocol command."""
        reported = self._answer(method, **parameters)
        assert "error" not in reported, reported
        return dict(reported["result"])

    def _answer(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Answer or error of one protocol command; events that come before it are heard."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters, "sessionId": self._session}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if message.get("id") == self._number and message.get("sessionId") == self._session:
                return dict(message)
            self._hear(message)

    def _hear(self, message: dict[str, Any]) -> None:
        method, reported = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(reported["exceptionDetails"].get("exception", reported["exceptionDetails"])))
        elif method == "Runtime.consoleAPICalled" and reported["type"] in {"error", "assert"}:
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in reported["args"]))
        elif method == "Network.requestWillBeSent":
            self.requests.append(reported["request"]["url"])
        elif method == "Page.frameNavigated" and "parentId" not in reported["frame"]:
            self._arrived.append(reported["frame"]["loaderId"])
        elif method == "Log.entryAdded" and reported["entry"]["level"] == "error":
            self.errors.append(reported["entry"]["text"])

    def evaluate(self, script: str) -> Any:
        """Value of a script in the page; one that is just leaving is asked again once the next is there."""
        end = time.monotonic() + PATIENCE_S
        while "error" in (reported := self._answer("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)):
            assert any(text in str(reported) for text in LEAVING), reported
            assert time.monotonic() < end, reported
            time.sleep(0.05)
        assert "exceptionDetails" not in reported["result"], reported
        return reported["result"]["result"].get("value")

    def wait(self, script: str, seconds: float = PATIENCE_S) -> None:
        """Until the script is true, in whatever page is there by then; AssertionError when it never is. What it asks for may not be there
        yet: a script that fails is not true."""
        end = time.monotonic() + seconds
        requested = f"(() => {{ try {{ return {{is: !!({script})}} }} catch (error) {{ return {{is: false, error: String(error)}} }} }})()"
        while not (reported := self.evaluate(requested))["is"]:
            assert time.monotonic() < end, f"never true: {script}; {reported.get('error', '')} {self.errors}"
            time.sleep(0.05)

    def click(self, selector: str, across: float = 0.5, down: float = 0.5) -> None:
        """Press and release the mouse on the first element of a selector, at a fraction of its width and height, once it stands still and
        nothing covers it; again where the page moved just then, as a person would who sees that nothing happens."""
        place = f"({PLACE})({json.dumps(selector)}, {across}, {down})"
        end, before, here = time.monotonic() + PATIENCE_S, None, None
        while before is None or self.evaluate("window.pressed === false"):
            while here is None or here != before:
                assert time.monotonic() < end, f"{selector}: is not there, is covered, or does not stand still; {self.errors}"
                before, here = here, self.evaluate(place)
                time.sleep(0.02)
            for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
                self.call("Input.dispatchMouseEvent", type=kind, x=here[0], y=here[1], button="left", buttons=1, clickCount=1)
            here = None

    def go(self, page: Path | str) -> None:
        """Open a page in place of this one."""
        address = page.resolve().as_uri() if isinstance(page, Path) else page
        reported = self.call("Page.navigate", url=address)
        # a place within the page that is there already has no loader; an address that is saved, not shown, has an error
        if "loaderId" in reported and "errorText" not in reported:
            self._arrival(lambda: reported["loaderId"] in self._arrived)
        self.wait("document.readyState === 'complete'")

    def again(self) -> None:
        """Load the page anew, as F5 does."""
        before = len(self._arrived)
        self.call("Page.reload")
        self._arrival(lambda: len(self._arrived) > before)
        self.wait("document.readyState === 'complete'")

    def _arrival(self, there: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not there():
            assert time.monotonic() < end, "the page never came"
            self.evaluate("0")  # events are heard while an answer is waited for
            time.sleep(0.02)

    def resize(self, width: int, height: int = 1000, zoom: float = 1.0) -> None:
        """Look at the page at another width, in pixels of the page at a zoom; what follows the width has drawn itself anew at the end."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=zoom, mobile=False)
        self.evaluate("new Promise(done => setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(() => done(1))), 300))")

    def shoot(self) -> str:
        """The page's whole picture, as PNG in base64."""
        return str(self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True)["data"])

    def printed(self) -> bytes:
        """The page as the browser prints it on A4, as PDF."""
        return base64.b64decode(self.call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69, printBackground=True)["data"])


@contextmanager
def opened(page: Path | str, profile: Path | None = None, size: tuple[int, float] | None = None) -> Iterator[Page]:
    """The page, a file or an address: with a profile in a browser of its own, closed afterwards; without, in a window of the one that all
    tests of this process share. Size is the window's width and zoom before the page comes. AssertionError when the machine has no
    Chromium."""
    if profile is None:
        with window(_shared(), page, size) as shown:
            yield shown
        return
    process, address = _started(profile)
    try:
        with window(address, page) as shown:
            yield shown
    finally:
        process.kill()
        process.wait()


def _started(profile: Path) -> tuple["subprocess.Popen[bytes]", str]:
    """A browser that runs, and where it is driven."""
    program = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    assert program, "the tests of pages need Chromium (Debian: apt-get install chromium)"
    words = [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    reported, end = profile / "DevToolsActivePort", time.monotonic() + 60.0
    while not reported.exists() or len(lines := reported.read_text().split()) < 2:
        assert process.poll() is None, "Chromium ended at once"
        assert time.monotonic() < end, "Chromium does not begin"
        time.sleep(0.02)
    return process, f"ws://127.0.0.1:{lines[0]}{lines[1]}"


@cache
def _shared() -> str:
    """Where the browser of this process is driven; it ends with it."""
    profile = Path(tempfile.mkdtemp(prefix="browser-"))
    process, address = _started(profile)

    def end() -> None:
        process.kill()
        process.wait()
        shutil.rmtree(profile, ignore_errors=True)

    atexit.register(end)
    return address


@contextmanager
def window(browser: str, page: Path | str, size: tuple[int, float] | None = None) -> Iterator[Page]:
    """The page in a window of a browser that runs, `Page.browser`, which shares no cookie and no storage with its other windows."""
    with connect(
        browser, max_size=None, max_queue=None, ping_interval=None, open_timeout=PATIENCE_S
    ) as socket:  # another may be looked at for long
        context = _bare(socket, "Target.createBrowserContext", disposeOnDetach=True)["browserContextId"]
        target = _bare(socket, "Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        shown = Page(socket, _bare(socket, "Target.attachToTarget", targetId=target, flatten=True)["sessionId"], browser)
        for domain in ("Runtime", "Log", "Page", "Network"):
            shown.call(f"{domain}.enable")
        if size is not None:
            shown.resize(size[0], zoom=size[1])
        shown.go(page)
        yield shown


def _bare(socket: ClientConnection, method: str, **parameters: Any) -> dict[str, Any]:
    """Answer of a command to the browser itself."""
    socket.send(json.dumps({"id": 0, "method": method, "params": parameters}))
    while True:
        message = json.loads(socket.recv(timeout=PATIENCE_S))
        if message.get("id") == 0 and "sessionId" not in message:
            assert "error" not in message, message
            return dict(message["result"])
