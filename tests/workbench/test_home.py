"""Home shows the state of the cell from its files; a file from a failed check is filled into no form."""

import datetime
import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench import client, some_files_of_the_demo

from lmeasure.accuracy import map_zone, tilts, write_zone
from lmeasure.register import Entry, Register, Result
from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig
from lmeasure.workbench import forms
from lmeasure.workbench.project import Step, following

TILE = r'<(?:a|section) class="tile (\w*)"[^>]*><h2>([^<]*)</h2><b>([^<]*)</b>'
NEXT = r'class="following"><a class="button go" href="[^"]*?(/[a-z]+(?:#[a-z]+)?)"'


def test_home_shows_what_the_files_say(tmp_path: Path) -> None:
    """Values are read from the files by other ways; what cannot be read is said in its place."""
    some_files_of_the_demo(tmp_path)
    rig, nodes = cell_rig(0), np.linspace(-100.0, 100.0, 3)
    write_zone(tmp_path / "zone.nc", map_zone(rig, None, (nodes, nodes, nodes), tilts(0.0, 1, None)))
    (tmp_path / "check").mkdir()
    (tmp_path / "check" / "check.json").write_text(
        json.dumps({"verdict": "calibrate again", "closures": [{"failed": True}, {"failed": False}]})
    )
    register = Register(tmp_path / "register")
    register.add([Entry("certificate", "0" * 64, "", "R7", datetime.date(2020, 1, 1), {"AP_p P1": Result(0.5, 0.01, "mm")})], "x")
    register.close()
    limit = '[[limit]]\nsubject = "R7"\nresult = "AP_p P1"\nupper = 1.0\n'
    (tmp_path / "register" / "limits.toml").write_text(f'schema = "lmeasure.limits/1"\n{limit}')
    with client(tmp_path) as session:
        page = session.get("/").text
        (tmp_path / "zone.nc").write_bytes(b"no zone")
        broken = session.get("/").text
    tiles = {title: (state, value) for state, title, value in re.findall(TILE, page)}
    rows = pq.read_metadata(tmp_path / "cell" / "trajectory.parquet").num_rows
    assert tiles["Last run"][1] == f"{rows} of {rows}"
    worst = max(
        (
            c
            for c in json.loads((tmp_path / "cell" / "certificate" / "certificate.json").read_text())["characteristics"]
            if c["name"] == "AP_p"
        ),
        key=lambda c: c["value"],
    )
    assert float(tiles["Last certificate"][1].split("\u00a0")[0]) == pytest.approx(worst["value"], rel=0.05)
    assert tiles["Zone"] == ("good", "0.027 m³")  # 27 nodes of 100 mm
    assert tiles["Instrument check"] == ("bad", "Calibrate again")
    assert "1 of 2 closures" in page
    assert re.search(r"R7: calibration is overdue since 202\d", page)
    assert re.search(NEXT, page)[1] == "/calibrate"  # type: ignore[index]
    assert page.count('class="point"') == len(rig.observation_point)
    assert {title: value for _, title, value in re.findall(TILE, broken)}["Zone"] == "–"
    assert "zone.nc cannot be read" in broken


def test_the_next_step_is_behind_what_is_done() -> None:
    names = "abcd"
    for done, expected in (("", "a"), ("a", "b"), ("ab", "c"), ("ac", "d"), ("acd", "b"), ("abcd", None)):
        step = following([Step(name, "", name in done, ()) for name in names])
        assert (step and step.name) == expected, done


def test_a_file_from_a_failed_check_is_no_preset(tmp_path: Path) -> None:
    """It is offered behind the others, until a check of it has passed."""
    for name in ("rig.toml", "arig.toml"):
        write_rig(tmp_path / name, cell_rig(0))

    def kept(number: int, words: list[str], state: str) -> None:
        own = tmp_path / ".workbench" / "jobs" / f"{number:04}"
        own.mkdir(parents=True)
        (own / "asked.json").write_text(json.dumps({"number": number, "words": words, "command": words[0], "begun": "2026-01-01T00:00:00"}))
        (own / "end.json").write_text(json.dumps({"state": state, "ended": "", "result": None}))

    def preset() -> tuple[str, list[str]]:
        with client(tmp_path) as session:
            page = session.get("/run/record").text
        value = re.search(r'name="rig" value="([^"]*)"', page)
        offers = re.search(r'<datalist id="record-rig-offers">(.*?)</datalist>', page)
        assert value is not None
        assert offers is not None
        return value[1], re.findall(r'value="([^"]*)"', offers[1])

    assert preset()[0] == "arig.toml"
    kept(1, ["check", "rig.toml", "--bus", "x:y", "--write", "arig.toml"], "failed")
    assert preset() == ("rig.toml", ["rig.toml", "arig.toml"])
    kept(2, ["check", "arig.toml", "--bus", "x:y"], "done")
    assert preset()[0] == "arig.toml"
    (tmp_path / "rig.toml").unlink()
    kept(3, ["check", "rig.toml", "--bus", "x:y", "--write", "arig.toml"], "failed")
    assert preset()[0] == ""


def test_home_tries_a_robot_that_is_certified_once(tmp_path: Path) -> None:
    """What the pages look at; correcting it and certifying it again would take as long once more."""
    with client(tmp_path) as session:
        form = re.search(r'<form method="post" action="/run/demo">(.*?)</form>', session.get("/").text)
    assert form is not None
    typed = {name: [value] for name, value in re.findall(r'name="(\w+)" value="(\w+)"', form[1])}
    assert forms.command_words("demo", forms.filled_in("demo", typed), tmp_path) == ["demo", "--out", "cell", "--robot", "--no-correct"]
