"""`lmeasure view --web`: rerun's own viewer draws a recording in a browser, and nobody but this machine can ask for it."""

import base64
import io
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import opened
from PIL import Image

from lmeasure.recording import read_run
from lmeasure.trajectory import reconstruct
from lmeasure.view import write_recording
from lmeasure.view.recording import CABLE_COLOURS

pytestmark = pytest.mark.live

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
LOOPBACK = {"0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F"}
"""127.0.0.1, ::1 and ::ffff:127.0.0.1 as the kernel prints them."""
LISTENS = "0A"


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command, serving a run, and its address."""
    path = tmp_path_factory.mktemp("web") / "run.rrd"
    run = read_run(TRUTH / "cell-run")
    write_recording(path, run.rig, trajectory=reconstruct(run))
    words = [sys.executable, "-m", "lmeasure", "view", str(path), "--web", "--port", "0"]
    # as a shell without job control starts what it runs beside itself: Ctrl-C is ignored there
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    signal.signal(signal.SIGINT, before)
    assert process.stdout is not None
    assert process.stderr is not None
    line = process.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:\d+/", line)
    assert found, line + process.stderr.read()
    yield process, found[0]
    if process.poll() is None:
        process.kill()
    process.communicate()


def children(process: int) -> list[int]:
    """A process and all that it has started."""
    own = [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit() and parent(p) == process]
    return [process, *(c for child in own for c in children(child))]


def parent(process: Path) -> int:
    try:
        return int((process / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:  # it has ended
        return -1


def listening(processes: list[int]) -> list[str]:
    """Addresses, as the kernel prints them, at which the processes listen."""
    links = (f for p in processes for f in Path(f"/proc/{p}/fd").iterdir() if f.is_symlink())
    inodes = {m[1] for link in links if (m := re.fullmatch(r"socket:\[(\d+)\]", str(link.readlink())))}
    rows = [r.split() for table in ("tcp", "tcp6") for r in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
    return [row[1].split(":")[0] for row in rows if row[3] == LISTENS and row[9] in inodes]


def test_a_browser_draws_it_without_an_error_or_a_look_elsewhere(served: tuple[subprocess.Popen[str], str], tmp_path: Path) -> None:
    _, address = served
    with opened(address) as page:
        page.wait("performance.getEntriesByType('resource').some(e => e.name.endsWith('recording.rrd'))")
        shades: set[tuple[int, ...]] = set()
        for _ in range(60):
            picture = Image.open(io.BytesIO(base64.b64decode(page.call("Page.captureScreenshot", format="png")["data"])))
            pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
            shades = {shade for shade in CABLE_COLOURS if (np.abs(pixels - shade).max(axis=1) < 12).sum() > 50}
            if len(shades) >= 4:
                break
        assert len(shades) >= 4, "the cables of the rig are not drawn"
        loaded = page.evaluate("performance.getEntriesByType('resource').map(e => e.name)")
        assert [name for name in loaded if not name.startswith(address)] == []
        assert page.errors == []


@pytest.mark.skipif(sys.platform != "linux", reason="reads the kernel's table of sockets")
def test_nothing_listens_but_on_this_machine(served: tuple[subprocess.Popen[str], str]) -> None:
    process, _ = served
    found = listening(children(process.pid))
    assert len(found) == 2  # the server and rerun behind it
    assert set(found) <= LOOPBACK


def test_a_page_from_elsewhere_cannot_read_the_recording(served: tuple[subprocess.Popen[str], str]) -> None:
    _, address = served
    request = urllib.request.Request(f"{address}recording.rrd", headers={"Host": "elsewhere.example"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request)
    with urllib.request.urlopen(f"{address}recording.rrd") as answer:
        assert answer.headers["Access-Control-Allow-Origin"] is None
        assert answer.read(4) == b"RRF2"


def test_ctrl_c_ends_it_and_leaves_nothing_behind(served: tuple[subprocess.Popen[str], str]) -> None:
    process, _ = served
    (_, behind) = children(process.pid)
    assert process.stdout is not None
    assert "ssh -L" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")
    assert not Path(f"/proc/{behind}").exists()
