"""Two tabs, a reload in the middle, the button back: what was typed and what runs is still there."""

from pathlib import Path

from bench import client, served
from browser import opened
from clicks import HERE, ended, entered, fill, press, visit

from lmeasure.rig import read_rig, write_rig
from lmeasure.simulation import cell_rig
from lmeasure.workbench import rig_form


def test_what_was_typed_outlives_a_reload_and_the_button_back(tmp_path: Path) -> None:
    with served(tmp_path / "project") as address, opened(address) as page:
        base = entered(page)
        visit(page, base, "/run/init")
        fill(page, "form[data-command=init]", out="mine")
        shown = "document.querySelector('form[data-command=init] [name=out]')?.value"
        page.again()
        page.wait(f"{shown} === 'mine'")
        page.wait("document.querySelector('[data-line]')?.textContent.includes(' mine ')")
        press(page, "form[data-command=init] button.go", f"{HERE} === '/jobs/1' && document.readyState === 'complete'")
        page.again()  # in the middle of the job
        assert ended(page) == 1
        page.evaluate("history.back()")
        page.wait(f"{HERE} === '/run/init' && document.readyState === 'complete' && {shown} === 'mine'")
        assert page.errors == []
    assert read_rig(tmp_path / "project" / "mine" / "rig.toml")


def test_of_two_tabs_the_second_does_not_write_over_the_first(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    _, digest = rig_form.read(tmp_path / "rig.toml")
    with client(tmp_path) as session:
        first = {"_file": "rig.toml", "_digest": digest, "observation_point.0.position_mm.0": "111"}
        assert session.post("/rig", data=first).status_code == 303
        second = session.post("/rig", data=first | {"observation_point.0.position_mm.0": "222"})
        assert second.status_code == 422
        assert "has been changed by another program" in second.text
        assert 'value="222"' in second.text
    assert read_rig(tmp_path / "rig.toml").observation_point[0].position_mm[0] == 111.0
