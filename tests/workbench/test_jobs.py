"""Jobs are the command line: the same files; they are ended, killed and found again, and what they recorded is kept."""

import json
import random
import re
import shutil
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest
from bench import client, kill_server, served_apart, token, until
from capture_bench import motion, on_bus, some_poses, true_rig, write_inputs
from in_process import ran

from lmeasure.recording import read_counts
from lmeasure.rig import write_rig
from lmeasure.workbench import jobs

SEALED = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run"


def test_a_job_leaves_what_the_command_line_leaves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    by_hand, by_page = tmp_path / "hand", tmp_path / "page"
    by_hand.mkdir()
    by_page.mkdir()
    monkeypatch.chdir(by_hand)
    ran("init", ".", "--template", "six-cables")
    with client(by_page) as session:
        answer = session.post("/run/init", data={"_form": "1", "template": "six-cables", "out": "."})
        assert answer.headers["location"] == "/jobs/1"
        until(lambda: session.get("/api/jobs/1").json()["state"] != "running")
        job = session.get("/api/jobs/1").json()
        assert job["state"] == "done"
        assert job["line"] == "lmeasure init --template six-cables"
        page = session.get("/jobs/1").text
        assert "/look/rig.toml" in page
        assert "Enter its dimensions" in page
        # once more: it writes over no file, and says so
        again = session.post("/api/jobs", json={"command": "init", "settings": {"template": "six-cables"}}).json()["number"]
        until(lambda: session.get(f"/api/jobs/{again}").json()["state"] != "running")
        failed = session.get(f"/api/jobs/{again}").json()
        assert failed["state"] == "failed"
        assert "rig.toml: exists" in failed["result"]["error"]
        assert "Enter its dimensions" not in session.get(f"/jobs/{again}").text
    files = sorted(p.relative_to(by_hand) for p in by_hand.rglob("*") if p.is_file())
    assert len(files) > 5
    for file in files:
        assert (by_page / file).read_bytes() == (by_hand / file).read_bytes(), file
    # another server finds both, as they ended
    with client(by_page) as session:
        assert [job["state"] for job in session.get("/api/jobs").json()["jobs"]] == ["failed", "done"]


def test_what_exists_is_said_on_the_form_before_a_job_begins(tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text("mine")
    asked_for = {"_form": "1", "template": "six-cables"}
    with client(tmp_path) as session:
        for named in ({"out": "."}, {}):
            answer = session.post("/run/init", data=asked_for | named)
            assert answer.status_code == 422
            (wrong,) = re.findall(r'<div class="field wrong">(.*?)</div>', answer.text, re.DOTALL)
            assert 'type="checkbox" id="init-force"' in wrong
            assert "scenario.toml exists: tick this to replace it, or choose another name." in wrong
            assert answer.text.count("<details open>") == 1, "it is seen"
        assert session.get("/api/jobs").json()["jobs"] == []
        assert (tmp_path / "scenario.toml").read_text() == "mine"
        assert session.post("/run/init", data=asked_for | {"force": "1"}).headers["location"] == "/jobs/1"
        until(lambda: session.get("/api/jobs/1").json()["state"] != "running")
        assert session.get("/api/jobs/1").json()["state"] == "done"
    assert (tmp_path / "scenario.toml").read_text() != "mine"


def test_a_job_that_finds_no_room_is_said_on_its_form(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of it is left, and once there is room the same form begins it; one that ends on a full disk is seen to end."""
    usual = jobs._write
    most: list[str] = []

    def full(path: Path, content: dict[str, Any]) -> None:
        if path.name in most:
            raise OSError(28, "No space left on device")
        usual(path, content)

    monkeypatch.setattr(jobs, "_write", full)
    with client(tmp_path) as session:
        most[:] = ["asked.json"]
        answer = session.post("/run/init", data={"_form": "1", "template": "six-cables", "out": "."})
        assert answer.status_code == 422
        assert "No space left on device; make room there" in unescape(answer.text)
        listing = {"command": "init", "settings": {"list": True}}
        assert "make room there" in session.post("/api/jobs", json=listing).json()["error"]
        assert list((tmp_path / ".workbench" / "jobs").iterdir()) == []
        most[:] = ["end.json"]
        assert session.post("/api/jobs", json=listing).json()["number"] == 1
        assert '"event": "end", "state": "done"' in session.get("/jobs/1/events").text


def test_a_recording_outlives_the_server(tmp_path: Path) -> None:
    """The server is killed in the middle: the recording ends as by Ctrl-C, whole; the next server says interrupted."""
    rig, poses = true_rig(), some_poses(3)
    write_rig(tmp_path / "rig.toml", rig)
    counts = np.tile(motion(rig, poses, 0.3, speed_mm_s=800.0).recorded, (20, 1))
    port, group = random.randrange(20000, 60000), f"239.74.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
    bus = {"interface": "udp_multicast", "channel": group, "port": port, "hop_limit": 0}
    settings = {"rig": "rig.toml", "bus": f"udp_multicast:{group}", "bus_option": [f"port={port}"], "out": "run"}
    with served_apart(tmp_path) as address:
        base, known = address.split("/?")[0], token(tmp_path)

        def ask(path: str, content: Any = None) -> Any:
            head = {"Authorization": f"Bearer {known}", "Content-Type": "application/json"}
            with urlopen(Request(base + path, None if content is None else json.dumps(content).encode(), head)) as answer:
                return json.load(answer)

        with on_bus(rig, counts, bus):
            ask("/api/jobs", {"command": "record", "settings": settings})
            # on a busy machine, no count may have come for a while
            until(lambda: ask("/api/jobs/1")["last"].get("live", {}).get("pose", {}).get("text", "").startswith("no pose"))
            until(lambda: ask("/api/jobs/1")["last"]["live"]["samples"] > 50)
            assert len(ask("/api/jobs/1")["last"]["live"]["channels"]) == 6
            kill_server(tmp_path / ".workbench" / "address")
            # there from the first moment; closed, it says how the recording ended
            until(lambda: 'ended = "complete"' in (tmp_path / "run" / "run.toml").read_text())
    kept = read_counts(tmp_path / "run" / "pass1.csv")
    assert len(kept.time_s) >= 50
    with client(tmp_path) as session:
        assert session.get("/api/jobs/1").json()["state"] == "interrupted"
        page = session.get("/jobs/1").text
        assert "interrupted" in page
        assert session.get("/look/run").status_code == 200
        assert "No run has a start pose. State it on the run's page. Every further step needs it." in unescape(session.get("/robot").text)
        # stated by the page, it may be certified once there is a trajectory
        assert session.post("/start/run", data={"start": "1,2"}).status_code == 422
        assert session.post("/start/run", data={"start": "/etc/passwd"}).status_code == 422
        assert session.post("/start/run", data={"start": "0,0,0,0,-90,90"}).status_code == 303
        # as it may be typed again
        assert "<code>0, 0, 0, 0, 0, 0, 1</code>" in session.get("/start/run").text
        assert "No run has a start pose. State it on the run's page. Every further step needs it." not in unescape(
            session.get("/robot").text
        )


@pytest.mark.slow
def test_a_capture_outlives_the_server_and_goes_on(tmp_path: Path) -> None:
    """The server is killed between two readings: the capture ends with it, what was read is kept, and the same command goes on."""
    rig, poses = true_rig(2), some_poses(3)
    write_inputs(tmp_path, rig, poses, u_position_mm=[0.05] * 3, u_rotation_deg=[0.01] * 3)
    still = np.tile(motion(rig, poses, 0.3, speed_mm_s=800.0).recorded[:1], (50, 1))
    group = f"239.75.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
    settings: dict[str, Any] = {"rig": "rig.toml", "poses": "planned.csv", "bus": f"udp_multicast:{group}", "out": "campaign", "by": "rest"}
    settings |= {"dwell_s": 0.2, "u_repeatability_mm": 0}
    counts = tmp_path / "campaign" / "counts.csv"
    with served_apart(tmp_path) as address, on_bus(rig, still, {"interface": "udp_multicast", "channel": group, "hop_limit": 0}):
        base, known = address.split("/?")[0], token(tmp_path)
        head = {"Authorization": f"Bearer {known}", "Content-Type": "application/json"}
        asked_for = json.dumps({"command": "capture", "settings": settings}).encode()
        with urlopen(Request(f"{base}/api/jobs", asked_for, head)) as answer:
            assert json.load(answer)["number"] == 1
        process = json.loads((tmp_path / ".workbench/jobs/0001/asked.json").read_text())["process"]
        until(counts.is_file)
        kill_server(tmp_path / ".workbench" / "address")
        until(lambda: not Path(f"/proc/{process}/cmdline").exists() or not Path(f"/proc/{process}/cmdline").read_bytes())
        kept = counts.read_bytes()
        with client(tmp_path) as session:
            assert session.get("/api/jobs/1").json()["state"] == "interrupted"
            assert session.post("/api/jobs", json={"command": "capture", "settings": settings}).json()["number"] == 2
            until(lambda: "readings" in session.get("/jobs/2/last").json()["last"].get("capture", {}))
            assert [one["pose"] for one in session.get("/jobs/2/last").json()["last"]["capture"]["readings"]] == ["1"]
            session.delete("/api/jobs/2")
        assert counts.read_bytes() == kept


@pytest.mark.slow
def test_a_certificate_is_whole_or_not_there_when_the_server_is_killed(tmp_path: Path) -> None:
    """The server is killed while figures are computed: there is no folder, nothing half-written, the next server says interrupted, and the
    button of its page leads to the same command, which nothing hinders (to the end: test_engineers_journey)."""
    shutil.copytree(SEALED / "inputs", tmp_path / "measured")
    settings: dict[str, Any] = {"trajectory": "measured/trajectory.parquet", "run": "measured/run", "program": "measured/program.toml"}
    settings |= {"out": "certificates/first", "trials": 2_000_000}
    with served_apart(tmp_path) as address:
        base, known = address.split("/?")[0], token(tmp_path)
        head = {"Authorization": f"Bearer {known}", "Content-Type": "application/json"}
        begin = Request(f"{base}/api/jobs", json.dumps({"command": "certify", "settings": settings}).encode(), head)
        with urlopen(begin) as answer:
            assert json.load(answer)["number"] == 1
        process = json.loads((tmp_path / ".workbench/jobs/0001/asked.json").read_text())["process"]

        def reported() -> dict[str, Any]:
            with urlopen(Request(f"{base}/api/jobs/1", headers=head)) as answer:
                return dict(json.load(answer))

        until(lambda: reported()["last"].get("progress", {}).get("fraction", 0.0) > 0.0, 300.0)
        kill_server(tmp_path / ".workbench" / "address")
        until(lambda: not Path(f"/proc/{process}/cmdline").exists() or not Path(f"/proc/{process}/cmdline").read_bytes(), 300.0)
    left = [path for path in tmp_path.rglob("*") if not {".workbench", "measured"} & set(path.parts) and path.name != "certificates"]
    assert left == []
    with client(tmp_path) as session:
        page = session.get("/jobs/1").text
        assert session.get("/api/jobs/1").json()["state"] == "interrupted"
        assert "interrupted" in page
        again = unescape(re.search(r'href="(/run/certify\?[^"]+)"', page)[1])  # type: ignore[index]
        form = dict(parse_qsl(urlsplit(again).query))
        assert session.post("/line/certify", data=form).json() == {"line": session.get("/api/jobs/1").json()["line"], "error": None}
        assert session.get(again).status_code == 200


def test_a_long_job_is_ended_by_its_button(tmp_path: Path) -> None:
    with client(tmp_path) as session:
        session.post("/api/jobs", json={"command": "demo", "settings": {"out": "cell"}})
        until(lambda: "progress" in session.get("/api/jobs/1").json()["last"] or session.get("/api/jobs/1").json()["said"])
        assert session.delete("/api/jobs/1").status_code == 200
        until(lambda: session.get("/api/jobs/1").json()["state"] == "cancelled")
        assert not list((tmp_path / "cell").rglob("*.part"))
