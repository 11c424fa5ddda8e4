"""The engineer's whole job by clicks alone, from an empty folder to a signed certificate that is verified; the same files by hand."""

import shlex
import shutil
from pathlib import Path

import pytest
from bench import client, served
from browser import Page, opened
from campaigns import write_campaign
from clicks import HERE, begin, choose, ended, entered, press, visit

from lmeasure.cli.app import main


def onward(page: Page, part: str) -> None:
    """Press the button, on the page of a job that is done, that leads on to an address."""
    press(page, f".after a[href*='{part}']", f"{HERE}.startsWith('{part}')")


def certified(page: Page, base: str, **given: str) -> None:
    """Make a key, and certify with it."""
    visit(page, base, "/robot")
    begin(page, "key", out="lab.key")
    visit(page, base, "/robot")
    begin(page, "certify", key="lab.key", out="certificates/first", **given)


def dropped(page: Page, base: str, packed: Path) -> str:
    """What is said of a zip that is dropped."""
    visit(page, base, "/robot")
    choose(page, "#packed", packed)
    press(page, "form[action$='/verify'] button.go", f"{HERE}.startsWith('/jobs/') && document.readyState === 'complete'")
    page.wait("!!document.querySelector('.after')", seconds=400.0)
    return str(page.evaluate("document.querySelector('main').innerText"))


def by_hand(lines: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The command lines that the pages showed, typed."""
    for line in lines:
        monkeypatch.setattr("sys.argv", shlex.split(line))
        with pytest.raises(SystemExit) as ended_with:
            main()
        assert not ended_with.value.code, line


def simulated_and_mapped(page: Page, base: str) -> None:
    """A rig is begun, simulated and mapped."""
    press(page, "a.button[href$='/rig']", f"{HERE} === '/rig'")
    begin(page, "init")
    visit(page, base, "/run/simulate")
    begin(page, "simulate", scenario="scenario.toml")
    visit(page, base, "/run/zone")
    begin(page, "zone", rig="rig.toml", x="-100:100:100", y="-100:100:100", z="-100:100:100")


def walked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, whole: bool) -> None:
    """A robot's run that is brought in, mapped, reconstructed, certified and verified; whole: after a rig of one's own, and with the page
    of the trajectory. What the pages made is what the command lines that they showed make."""
    brought, project, hand = tmp_path / "brought", tmp_path / "project", tmp_path / "hand"
    write_campaign(brought)
    with served(project) as address, opened(address) as page:
        base = entered(page)
        if whole:
            simulated_and_mapped(page, base)
        visit(page, base, "/files")
        choose(page, "#upload", *sorted((brought / "run").iterdir()), brought / "program.toml")
        page.evaluate("document.getElementById('into').value = 'measured'")
        press(page, "form[action$='/upload'] button.go", "document.getElementById('upload')?.files.length === 0")
        if not whole:
            visit(page, base, "/run/zone")
            begin(page, "zone", rig="measured/rig.toml", x="-100:100:100", y="-100:100:100", z="-100:100:100")
        visit(page, base, "/look/measured")
        press(page, "main a.button[href*='reconstruct']", f"{HERE} === '/run/reconstruct'")
        begin(page, "reconstruct", out="trajectory.parquet")
        onward(page, "/run/report")
        if whole:
            begin(page, "report")
        certified(page, base, trajectory="trajectory.parquet", run="measured", program="measured/program.toml", trials="100")
        shutil.make_archive(str(tmp_path / "mine"), "zip", project / "certificates" / "first")
        reported = dropped(page, base, tmp_path / "mine.zip")
        assert "done" in reported
        assert "equal to the digit" in reported
        assert [error for error in page.errors if "404" not in error] == []
    with client(project) as session:
        lines = [job["line"] for job in reversed(session.get("/api/jobs").json()["jobs"])]
    assert len(lines) == (8 if whole else 5)
    hand.mkdir()
    monkeypatch.chdir(hand)
    shutil.copytree(project / "measured", "measured")
    for folder in ("runs", "zones"):
        Path(folder).mkdir()
    by_hand([line for line in lines if line.split()[1] not in ("key", "certify", "verify")], monkeypatch)
    files = [path.relative_to(hand) for path in sorted(hand.rglob("*")) if path.is_file()]
    assert {Path("trajectory.parquet"), Path("zones/zone.nc")} <= {*files}
    assert len(files) > (20 if whole else 6)
    assert not whole or {Path("drums.toml"), Path("runs/simulated/run.toml"), Path("runs/page/trajectory.html")} <= {*files}
    for file in files:
        assert (project / file).read_bytes() == file.read_bytes(), file


def test_an_engineer_from_a_measured_run_to_a_verified_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The quick form: what `init`, `simulate` and `report` write is seen by their own tests."""
    walked(tmp_path, monkeypatch, whole=False)


@pytest.mark.slow
def test_an_engineer_from_nothing_to_a_verified_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same after a rig of one's own."""
    walked(tmp_path, monkeypatch, whole=True)


@pytest.mark.slow
def test_an_engineer_with_a_simulated_robot(tmp_path: Path) -> None:
    """The long form: the cell, its robot and its test cube are the button of an empty project."""
    with served(tmp_path / "project") as address, opened(address) as page:
        base = entered(page)
        press(page, ".tour button.go", f"{HERE} === '/jobs/1' && document.readyState === 'complete'")
        ended(page)
        visit(page, base, "/calibrate")
        begin(page, "calibrate", folder="cell/campaign", out="calibrated")
        onward(page, "/run/zone")
        begin(page, "zone")
        onward(page, "/run/program")
        begin(page, "program", tests="pose,path")
        visit(page, base, "/runs")
        begin(page, "reconstruct", run="cell/run", out="trajectory.parquet")
        onward(page, "/run/report")
        begin(page, "report")
        certified(page, base, trajectory="trajectory.parquet", run="cell/run", program="cell/program.toml")
        onward(page, "/run/verify")
        begin(page, "verify")
        shutil.make_archive(str(tmp_path / "mine"), "zip", tmp_path / "project" / "certificates" / "first")
        assert "equal to the digit" in dropped(page, base, tmp_path / "mine.zip")
        assert [error for error in page.errors if "404" not in error] == []
