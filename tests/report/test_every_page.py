"""Every page that the program writes, opened at the width of a telephone, a desk and a wall: nothing runs over, is clipped, collides, or
asks for anything outside. `LMEASURE_PICTURES=FOLDER pytest -m slow tests/report/test_every_page.py` keeps pictures of them."""

import base64
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import LOOK, Page, opened

sys.path.append(str(Path(__file__).parents[1] / "certification"))
from campaigns import write_campaign

from lmeasure import calibration
from lmeasure.accuracy.zone import axis, scan_zone, tilts
from lmeasure.certification import Settings
from lmeasure.certification.measure import Inputs
from lmeasure.report.calibration import write_calibration_page
from lmeasure.report.certificate import Choices, write_certificate
from lmeasure.report.zone import write_zone_report
from lmeasure.workflows import load

ROOT = Path(__file__).parents[2]
TRUTH = ROOT / "tests" / "authorities" / "truth"
WIDTHS = (390, 1400, 2560)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of each kind, small."""
    out = tmp_path_factory.mktemp("pages")
    write_campaign(out / "campaign")
    given = Inputs(out / "campaign" / "trajectory.parquet", out / "campaign" / "program.toml", out / "campaign" / "run")
    made = {}
    for language in ("en", "ru"):
        write_certificate(out / language, given, Settings(trials=200), Choices(language))
        made[f"certificate {language}"] = out / language / "report.html"
    found = calibration.calibrate(calibration.read_campaign(TRUTH / "cell-12-poses"), calibration.Settings(hold_out=("7",)))
    write_calibration_page(out / "calibration.html", found)
    nodes = axis(-300, 300, 100)
    zone = scan_zone(found.rig, found.record, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 2), limit_deg=40.0, full=True)
    write_zone_report(out / "zone", zone, found.rig, found.record)
    structure = load("structure")
    asked = {"file": TRUTH / "cell-12-poses" / "rig.toml", "report": out / "structure", "position_mm": "0,0,0", "quaternion": "0,0,0,1"}
    structure.run(structure.settings.model_validate(asked))
    table = np.genfromtxt(ROOT / "datasets" / "ur5" / "grid.csv", delimiter=",", names=True)[::12]
    rows = [[f"P{k}", *(r[f"joint_{i}"] for i in range(1, 7)), *(r[f"{a}_t"] + r[f"{a}_dif"] for a in "xyz")] for k, r in enumerate(table)]
    head = ",".join(["name", *(f"joint_{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"])
    (out / "rows.csv").write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    identify = load("identify")
    identify.run(identify.settings.model_validate({"robot": "ur5", "measurements": out / "rows.csv", "out": out / "robot"}))
    made |= {"calibration": out / "calibration.html", "zone": out / "zone" / "zone.html", "identification": out / "robot" / "report.html"}
    return made | {"structure": out / "structure" / "structure.html"}


@pytest.fixture(scope="module")
def browser(pages: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Any:
    with opened(pages["zone"], tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["certificate en", "certificate ru", "calibration", "zone", "identification", "structure"])
def test_nothing_runs_over_collides_or_asks_for_anything(pages: dict[str, Path], browser: Page, kind: str) -> None:
    browser.errors.clear()
    browser.requests.clear()
    browser.go(pages[kind])
    browser.wait("[...document.querySelectorAll('.js-plotly-plot')].every(e => e._fullLayout)")
    told = []
    for width in WIDTHS:
        browser.resize(width)
        told += [f"{width}: {text}" for text in browser.evaluate(LOOK)]
        if "LMEASURE_PICTURES" in os.environ:
            picture = Path(os.environ["LMEASURE_PICTURES"]) / f"{kind.replace(' ', '-')}-{width}.png"
            picture.write_bytes(base64.b64decode(browser.shoot()))
    assert told == []
    assert browser.errors == []
    assert [url[:80] for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []


def test_the_check_sees_what_it_is_for(tmp_path: Path) -> None:
    """A page with every fault it looks for."""
    page = tmp_path / "bad.html"
    svg = '<svg viewBox="0 0 100 20" width="100"><text x="1" y="10">one</text><text x="6" y="10">two</text>'
    svg += '<text x="90" y="10">beyond</text></svg>'
    page.write_text(f'<p style="width: 3000px">wide</p><figure><div class="drawn">{svg}</div></figure><img src="http://127.0.0.1:9/x.png">')
    with opened(page, tmp_path / "profile") as shown:
        shown.resize(1400)
        told = " ".join(shown.evaluate(LOOK))
    assert "the page is 30" in told
    assert "'two' and 'one' collide" in told
    assert "'beyond' is clipped" in told
    assert "'wide' runs over" in told
    assert any(url.startswith("http://127.0.0.1") for url in shown.requests)
