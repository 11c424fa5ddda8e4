"""The first screen of each report has the assumed part of U95 and the statement that would help most; nothing where all is exact."""

import json
from pathlib import Path

import pytest
from in_process import ran

from lmeasure.recording import read_run, write_run
from lmeasure.report.html import assumed_numbers
from lmeasure.rig import write_rig
from lmeasure.text import Say, from_stated
from lmeasure.trajectory import reconstruct

RUN = Path(__file__).parents[1] / "authorities" / "truth" / "cell-run"
LABEL = "Assumed part of U95"


def figures_of(words: list[str]) -> dict[str, float]:
    done = ran(*words, "--json")
    found: dict[str, float] = json.loads(done)["figures"]
    return found


@pytest.mark.parametrize("unstated", ["typical", "exact"])
def test_pages_and_answers_of_zone_and_trajectory(unstated: str, tmp_path: Path) -> None:
    assumed = unstated == "typical"
    run = read_run(RUN)
    write_rig(tmp_path / "rig.toml", run.rig.model_copy(update={"unstated": unstated}))
    box = [f"--{name}=-100:100:100" for name in "xyz"]
    zone = ["zone", str(tmp_path / "rig.toml"), *box, "--out", str(tmp_path / "zone.nc"), "--report", str(tmp_path / "zone")]
    figures = figures_of(zone)
    write_run(tmp_path / "run", run.__class__(run.rig, run.start, run.passes, unstated="typical" if assumed else "exact"))
    made = ["--out", str(tmp_path / "t.parquet")]
    own = figures_of(["reconstruct", str(tmp_path / "run"), *made])
    figures_of(["report", str(tmp_path / "run"), "--out", str(tmp_path / "page")])
    for found in (figures, own):
        assert ("largest_u95_assumed_mm" in found) == assumed
        assert any(name.startswith("u95_if_stated_") for name in found) == assumed
    for page in ((tmp_path / "zone" / "zone.html"), *(tmp_path / "page").glob("*.html")):
        text = page.read_text(encoding="utf-8")
        assert (LABEL in text) == assumed
        assert ("state the " in text) == assumed


def test_a_certificate_says_it_by_the_messages_that_it_keeps() -> None:
    run = read_run(RUN)
    lines = reconstruct(run.__class__(run.rig, run.start, run.passes)).assumed.lines
    kept = [from_stated(json.loads(json.dumps(line.stated()))) for line in lines]
    (number,) = assumed_numbers(kept, Say())
    assert number.name == LABEL
    assert float(number.value.replace("\u00a0", " ").split()[0]) == pytest.approx(lines[0].values["part"], rel=1e-2)
    assert number.note.startswith("state the start position")
    assert assumed_numbers([None], Say()) == ()
