"""How long pages of the workbench let a person wait, in headless Chromium: the first page, and the zone behind a point that is dragged.

    python benchmarks/workbench_pages.py [--times 20]

first page: from the server's start, and from the address, until its form can be used. dragged: from the pointer's move to the figures under
the drawing of the rig (volume within 60 degrees, least worst angle, median U95) that belong to the place that it moved to.
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parents[1] / "tests"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from bench import served_apart  # noqa: E402
from browser import Page, opened  # noqa: E402
from clicks import entered  # noqa: E402

from lmeasure.rig import write_rig  # noqa: E402
from lmeasure.simulation import cell_rig  # noqa: E402

USABLE = "document.readyState === 'complete' && !!document.querySelector('.way a')"
DRAG = """(async () => {
  const canvas = document.querySelector('#scene canvas'), told = document.getElementById('scene-zone'), field = document.getElementById(
    'observation_point.0.position_mm.0'), box = canvas.getBoundingClientRect(), out = [];
  const send = (kind, x, y) => canvas.dispatchEvent(new PointerEvent(kind, {clientX: x, clientY: y, pointerId: 1, bubbles: true}));
  canvas.setPointerCapture = () => {};
  let found = null;
  for (let x = 8; x < box.width && !found; x += 8) for (let y = 8; y < box.height && !found; y += 8) {
    const before = field.value;
    const at = [box.left + x, box.top + y];
    send('pointerdown', ...at); send('pointermove', at[0] + 1, at[1]); send('pointerup', ...at);
    if (field.value !== before) found = [box.left + x, box.top + y];
  }
  const settled = async () => { let seen = told.textContent; for (let same = 0; same < 8;) {
    await new Promise((done) => setTimeout(done, 50)); same = told.textContent === seen ? same + 1 : 0; seen = told.textContent; } };
  await settled();
  const own = window.fetch;
  let open = 0;
  window.fetch = async (...asked) => { open++; try { return await own(...asked); } finally { open--; } };
  let [x, y] = found;
  send('pointerdown', x, y);
  for (let i = 0; i < TIMES; i++) {
    const begin = performance.now();
    x += i % 2 ? 9 : -7; send('pointermove', x, y);
    // figures may stay what they were: then the answer has come and was drawn
    while (open || performance.now() - begin < 5) await new Promise((done) => setTimeout(done, 1));
    await new Promise((done) => setTimeout(done, 5));
    out.push(performance.now() - begin);
  }
  send('pointerup', x, y);
  return out;
})()"""


def first_page(page: Page, base: str, times: int) -> list[float]:
    """Milliseconds from the address to the page that can be used."""
    out = []
    for _ in range(times):
        begin = time.perf_counter()
        page.call("Page.navigate", url=base + "/")
        while not page.evaluate(USABLE):
            time.sleep(0.005)
        out.append(1e3 * (time.perf_counter() - begin))
    return out


def reported(name: str, values: list[float]) -> None:
    """One line of figures."""
    ordered = sorted(values)
    most = ordered[int(0.95 * (len(ordered) - 1))]
    print(f"{name}: median {statistics.median(values):.0f} ms, 95 % {most:.0f} ms, largest {ordered[-1]:.0f} ms")


def main() -> None:
    """Measure and print."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--times", type=int, default=20, help="of each")
    times = asked.parse_args().times
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "project"
        project.mkdir()
        write_rig(project / "rig.toml", cell_rig(0))
        begin = time.perf_counter()
        with served_apart(project) as address:
            print(f"server: {1e3 * (time.perf_counter() - begin):.0f} ms until it tells its address")
            with opened(address, Path(scratch) / "profile") as page:
                base = entered(page)
                reported("first page", first_page(page, base, times))
                page.go(f"{base}/rig?file=rig.toml")
                page.wait("document.getElementById('scene-zone').textContent.includes('m³')")
                reported("dragged point to figures", [float(v) for v in page.evaluate(DRAG.replace("TIMES", str(times)))])


if __name__ == "__main__":
    main()
