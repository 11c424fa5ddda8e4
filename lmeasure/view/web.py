"""rerun's own web viewer in any browser, with the recording beside it, for this machine alone.

The viewer is in rerun's wheel. `rerun --serve-web` serves its files on a port of the loopback interface, and with the address of a
recording it opens nothing else. Our server in front of it serves both, the page and the recording, from one port of 127.0.0.1, so that only
one port must be forwarded. The page would load fonts, look for newer versions and report its use: these requests are removed or answered
here, and the browser is forbidden to fetch more.
"""

import http.client
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote, urlsplit

from lmeasure.core import LMeasureError
from lmeasure.io import os_reason
from lmeasure.text import message
from lmeasure.view.recording import check_recording

LOOPBACK = "127.0.0.1"
HERE = ("127.0.0.1", "localhost")
RECORDING = "/recording.rrd"
START_S = 30.0
_NAME = re.compile(r"[\w.\-]*")
_ELSEWHERE = re.compile(rb"<link\b[^>]*\bhref=\"https?://[^>]*>")
_ALONE = b"""<script>{const own = window.fetch.bind(window); window.fetch = (what, how) =>
new URL(what instanceof Request ? what.url : what, location).origin === location.origin ? own(what, how)
: Promise.resolve(new Response("{}", {status: 404}))}</script>"""
"""Script that answers in the page requests to other servers."""


def policy(read: str = "'self'") -> str:
    """Return the rights of the viewer's page: run its own code, and fetch from the places in `read` alone."""
    return (
        "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        f"font-src 'self' data:; img-src 'self' data: blob:; connect-src {read} data: blob:; worker-src 'self' blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def viewer_file(name: str) -> tuple[str, bytes] | None:
    """Kind and content of a file of the viewer, its page for an empty name; None where it has none of that name. rerun runs as long as
    that takes, so that nothing of it stays when this process is killed. LMeasureError where it does not start."""
    if not _NAME.fullmatch(name):
        return None
    with _viewer_files(f"http://{LOOPBACK}:1{RECORDING}") as behind:
        status, kind, content = _fetched(behind, f"/{name}")
    return (kind, content) if status == 200 else None


def _fetched(behind: int, path: str) -> tuple[int, str, bytes]:
    """Return status, kind and content of rerun's answer, its page without requests to other servers."""
    connection = http.client.HTTPConnection(LOOPBACK, behind, timeout=60)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        content, kind = answer.read(), answer.getheader("Content-Type", "application/octet-stream")
    finally:
        connection.close()
    if kind.startswith("text/html"):
        content = _ELSEWHERE.sub(b"", content).replace(b"<head>", b"<head>" + _ALONE, 1)
    return answer.status, kind, content


@contextmanager
def serving(recording: Path, port: int = 0) -> Iterator[ThreadingHTTPServer]:
    """A server of the viewer with the recording, on 127.0.0.1 and that port, a free one for 0; call its `serve_forever`.

    LMeasureError where the file is no recording, the port is taken, or rerun does not start.
    """
    check_recording(recording)
    try:
        server = ThreadingHTTPServer((LOOPBACK, port), _Handler)
    except OSError as error:
        raise LMeasureError(message("error.port_of_cannot_be", port=port, loopback=LOOPBACK, error=os_reason(error))) from error
    try:
        with _viewer_files(f"http://{LOOPBACK}:{server.server_port}{RECORDING}") as behind:
            server.RequestHandlerClass = type("Handler", (_Handler,), {"recording": recording, "behind": behind})
            yield server
    finally:
        server.server_close()


def serve(recording: Path, port: int, say: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; say prints the address."""
    # stopping this process stops rerun too; background processes of a shell without job control ignore Ctrl-C
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with serving(recording, port) as server:
        at = server.server_port
        say(message("view.shown", file=recording, address=f"http://{LOOPBACK}:{at}/"))
        command = f"ssh -L {at}:{LOOPBACK}:{at} {socket.gethostname()}"
        say(message("view.elsewhere", command=command))
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return


@contextmanager
def _viewer_files(recording_url: str) -> Iterator[int]:
    """Port of the loopback interface on which rerun gives the files of its web viewer."""
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        port = int(free.getsockname()[1])
    words = [recording_url, "--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(port)]
    process = subprocess.Popen([_program(), *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        given_up = time.monotonic() + START_S
        while True:
            try:
                socket.create_connection((LOOPBACK, port), timeout=1.0).close()
                break
            except OSError as error:
                if process.poll() is not None or time.monotonic() > given_up:
                    raise LMeasureError(message("error.rerun_s_web_viewer", poll=process.poll())) from error
                time.sleep(0.05)
        yield port
    finally:
        process.terminate()
        process.wait()


def _program() -> str:
    """Return rerun's program in its wheel: started directly, as its launcher would leave it running."""
    wheel = find_spec("rerun_cli")
    if wheel is None or not wheel.submodule_search_locations:
        raise LMeasureError(message("error.rerun_s_program_is"))
    folder = Path(wheel.submodule_search_locations[0])
    places = (folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun", folder / f"rerun{'.exe' if sys.platform == 'win32' else ''}")
    found = next((str(place) for place in places if place.is_file()), None)
    if found is None:
        raise LMeasureError(message("error.rerun_s_program_is_not", where=folder))
    return found


class _Handler(BaseHTTPRequestHandler):
    """Gives the recording, and everything else from rerun."""

    recording: Path
    behind: int

    def do_GET(self) -> None:
        """The page with its recording, the recording, files of the viewer."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """The same without content."""
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
        # a name that leads here from elsewhere would let its pages read the recording
        host = self.headers.get("Host", "")
        if urlsplit(f"//{host}").hostname not in HERE:
            self.send_error(403)
            return
        requested = urlsplit(self.path)
        if requested.path == "/" and "url=" not in requested.query:
            self.send_response(302)
            self.send_header("Location", f"/?url={quote(f'http://{host}{RECORDING}', safe='')}&renderer=webgl")
            self.send_header("Content-Length", "0")
            self.end_headers()
        elif requested.path == RECORDING:
            try:
                with self.recording.open("rb") as file:
                    self._head("application/octet-stream", self.recording.stat().st_size)
                    if body:
                        shutil.copyfileobj(file, self.wfile)
            except FileNotFoundError:
                self.send_error(404)
            except ConnectionError:  # the browser was closed
                return
        else:
            self._relay(body=body)

    def _relay(self, *, body: bool) -> None:
        try:
            status, kind, content = _fetched(self.behind, self.path)
            self._head(kind, len(content), status)
            if body:
                self.wfile.write(content)
        except ConnectionError:
            return
        except OSError:
            self.send_error(502)

    def _head(self, kind: str, length: int, status: int = 200) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(length))
        self.send_header("Content-Security-Policy", policy())
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name of the class above
        ...
