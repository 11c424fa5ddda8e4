"""Pages while something runs: what a job tells is told in the reader's words, a step is answered once, and a server that ended is said."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from access import faults
from bench import client, kill_server, served_apart, until
from browser import LOOK, Page, opened
from clicks import HERE, entered, fill, press, visit

from lmeasure.acquisition import STALE_S, counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.bus.sources import Notice
from lmeasure.acquisition.recorder import Counting
from lmeasure.cli import events
from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig
from lmeasure.text import message
from lmeasure.workflows import load, options_of

SCRIPT = """
import json, sys
for number, text in enumerate(["Leave all at rest", "Pull c1"], 1):
    print(json.dumps({"event": "asked", "text": text, "number": number, "of": 2, "act": ""}), file=sys.stderr, flush=True)
    sys.stdin.readline()
"""


class Quiet:
    """A source that is not asked."""

    name, timestamp_source, bit_rate = "quiet", "host", None

    def receive(self, timeout_s: float) -> None: ...

    def notices(self) -> list[Notice]:
        return []

    def close(self) -> None: ...


def counted() -> Counting:
    """Seconds of six channels that stand still."""
    rig = cell_rig(0)
    fields = counter_fields(rig)
    counting = Counting(rig, Quiet(), fields, 1)  # type: ignore[arg-type]
    time_s = 1e9 + np.arange(800) / 200.0
    counting.took(counting.samples_of(frames_from_counts(time_s, np.full((800, 6), 7.0), fields, rig.can_table.sync_id)))
    return counting


def live(counting: Counting, seconds: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What a page is told of a recording after so many seconds."""
    monkeypatch.setattr(events, "_shown", -np.inf)
    events.live(counting.progress(seconds), message("workflow.no_pose_where_tool"))
    return dict(json.loads(capsys.readouterr().err))


def test_what_a_dead_bus_sent_last_is_not_shown_as_what_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    counting = counted()
    for seconds, counts in ((0.5, [7.0] * 6), (0.4 + STALE_S, [7.0] * 6), (0.6 + STALE_S, [None] * 6)):
        reported = live(counting, seconds, monkeypatch, capsys)
        assert [c["count"] for c in reported["channels"]] == counts
        assert reported["pose"]["shown"] == ("no counts" if counts[0] is None else "")
        assert reported["samples"] == counting.samples > 100


def test_a_recording_tells_in_the_words_of_who_reads(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    counting = counted()
    counting.assembler.events.tally.update({"gap": 3, "bus_off": 1})
    reported = live(counting, 0.5, monkeypatch, capsys)
    assert (reported["faults"], reported["faults_shown"]) == ({"gap": 3, "bus_off": 1}, "1 bus off, 3 gap")
    monkeypatch.setenv("LANGUAGE", "ru")
    reported = live(counting, 0.5, monkeypatch, capsys)
    assert "пропусков 3" in reported["faults_shown"]
    assert reported["pose"]["text"] == "нет позы: начальная поза неизвестна. Задайте --start"
    assert live(counting, 9.0, monkeypatch, capsys)["pose"]["shown"] == "нет отсчётов"


@pytest.mark.parametrize("command", ["capture", "check", "zone", "certify", "record"])
def test_a_job_is_done_again_as_it_was(command: str, tmp_path: Path) -> None:
    """Of a choice that was left as it is by default the form shows that, not the first of its words."""
    with client(tmp_path) as session:
        page = session.get(f"/run/{command}?_form=1").text
    for option in (o for o in options_of(load(command).settings) if o.kind == "choice" and o.default):
        assert f"<option selected>{option.default}</option>" in page


def test_nothing_comes_after_what_was_ended_before_it_wrote(tmp_path: Path) -> None:
    for number, (command, state) in enumerate((("zone", "cancelled"), ("zone", "done"), ("record", "cancelled")), 1):
        folder = tmp_path / ".workbench" / "jobs" / f"{number:04}"
        folder.mkdir(parents=True)
        words = [command, "--out", "mine", "rig.toml"]
        asked_of = {"number": number, "command": command, "words": words, "begun": "2026-01-01T00:00:00+00:00"}
        (folder / "asked.json").write_text(json.dumps(asked_of))
        (folder / "end.json").write_text(json.dumps({"state": state, "ended": "", "code": 0, "result": None}))
    with client(tmp_path) as session:
        pages = [session.get(f"/jobs/{number}").text.split('class="after"')[1].split("</p>")[0] for number in (1, 2, 3)]
    assert [page.count("href") > 1 for page in pages] == [False, True, True]


def test_a_file_that_cannot_be_read_is_there(tmp_path: Path) -> None:
    """Its page says what is wrong with it, by its path in the project; a rig with a wrong key says so above its values."""
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    (tmp_path / "moved.parquet").write_bytes(b"PAR1")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.toml").write_text('schema = "lmeasure.run/1"\n')
    with client(tmp_path) as session:
        for path in ("/trajectory/moved.parquet", "/start/run"):
            answer = session.get(path)
            assert answer.status_code == 422
            assert "Cannot be read" in answer.text
            assert f"{tmp_path}/" not in answer.text
        assert "Cannot be read" not in session.get("/start/nowhere").text
        runs = session.get("/runs").text
        assert "run/run.toml" in runs
        assert f"{tmp_path}/run" not in runs
        assert "/start/run" not in runs
        assert "cannot be used" not in session.get("/rig").text
        text = (tmp_path / "rig.toml").read_text()
        (tmp_path / "rig.toml").write_text(text.replace("position_mm", "position_mn", 1))
        page = session.get("/rig")
        assert page.status_code == 200
        assert "This file cannot be used:" in page.text
        assert "Did you mean" in page.text
        assert "Did you mean" in session.get("/scene?file=rig.toml").json()["error"]


def shown_again(page: Page, what: str) -> None:
    """Wait until the notice is there, or not, and the page still looks right."""
    page.wait(f"document.getElementById('gone').hidden === {what}")


def test_a_server_that_ended_is_said_by_its_pages(tmp_path: Path) -> None:
    """By that of a job that ran, and by a form that is filled in; nobody is left before a page that pretends."""
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    with served_apart(tmp_path) as address, opened(address) as page:
        base = entered(page)
        visit(page, base, "/run/zone")
        fine = dict.fromkeys("xyz", "-400:400:5")
        fill(page, "form[data-command=zone]", out="zone.nc", **fine)
        press(page, "form[data-command=zone] button.go", f"{HERE} === '/jobs/1' && document.readyState === 'complete'")
        shown_again(page, "true")
        kill_server(tmp_path / ".workbench" / "address")
        shown_again(page, "false")
        for width in (390, 1400):
            page.resize(width)
            assert page.evaluate(LOOK) == []
        assert "does not answer" in page.evaluate("document.getElementById('gone').innerText")


def test_a_step_of_a_self_test_is_answered_once_it_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A double click answers one step, and a click before the next is asked none."""
    from bench import served

    from lmeasure.workbench import processes

    begun = processes.begun

    async def scripted(words: list[str], folder: Path, environment: Any) -> Any:
        import asyncio

        if words[0] != "check":
            return await begun(words, folder, environment)
        pipe = asyncio.subprocess.PIPE
        return await asyncio.create_subprocess_exec(sys.executable, "-c", SCRIPT, cwd=folder, stdin=pipe, stdout=pipe, stderr=pipe)

    monkeypatch.setattr(processes, "begun", scripted)
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    with served(tmp_path) as address, opened(address) as page:
        base = entered(page)
        visit(page, base, "/run/check")
        fill(page, "form[data-command=check]", bus="virtual:none")
        press(page, "form[data-command=check] button.go", f"{HERE} === '/jobs/1' && document.readyState === 'complete'")
        page.wait("document.getElementById('asked').textContent.startsWith('1/2')")
        go = "document.querySelector('button.go[data-type]')"
        twice = f"for (const detail of [1, 2]) {go}.dispatchEvent(new MouseEvent('click', {{bubbles: true, detail}})); {go}.disabled"
        assert page.evaluate(twice) is True
        page.wait("document.getElementById('asked').textContent.startsWith('2/2')")
        page.resize(390)
        line = "Object.assign(document.createElement('li'), {textContent: 'said'})"
        page.evaluate(f"for (let n = 0; n < 99; n++) document.getElementById('log').append({line})")
        assert faults(page) == []  # a log that is longer than its place is reached by the keyboard
        assert page.evaluate(f"[{go}.disabled, document.getElementById('progress').value]") == [False, 0.5]
        said = tmp_path / ".workbench" / "jobs" / "0001" / "said.jsonl"
        until(lambda: said.read_text().count('"typed"') == 1)
        page.evaluate(f"{go}.dispatchEvent(new MouseEvent('click', {{bubbles: true, detail: 2}}))")
        page.evaluate("new Promise((done) => setTimeout(() => done(1), 300))")
        assert said.read_text().count('"typed"') == 1
        page.evaluate(f"{go}.click()")
        page.wait("!!document.querySelector('.after')")
        assert page.errors == []
