"""The mechanic's whole job by clicks alone, over a real bus to a simulated cell; the same files by hand."""

import shutil
from pathlib import Path

import pytest
from bench import client, served
from browser import opened
from journeys import QUICK, Job, looked, mechanic
from test_engineers_journey import by_hand

from lmeasure.io import read_toml

OVER_A_BUS = ("play", "scan", "check", "capture")


def walked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: Job, commands: tuple[str, ...]) -> None:
    """Every page loaded anew in the middle. What a person or a bus has said is taken over by hand, all else is made again."""
    project, hand = tmp_path / "project", tmp_path / "hand"
    with served(project) as address, opened(address) as page:
        wrong: list[str] = []
        mechanic(page, lambda what, shown: wrong.extend(f"{what}: {text}" for text in looked(shown)), way)
        assert wrong == []
        assert {request.split("/")[2] for request in page.requests if request.startswith("http")} == {address.split("/")[2]}
    with client(project) as session:
        jobs = list(reversed(session.get("/api/jobs").json()["jobs"]))
    assert tuple(job["command"] for job in jobs) == commands
    hand.mkdir()
    monkeypatch.chdir(hand)
    (hand / "calibration").mkdir()
    (hand / "zones").mkdir()
    shutil.copy(project / "rig-checked.toml", hand)
    shutil.copytree(project / "calibration" / "poses", hand / "calibration" / "poses")
    for job in jobs:
        if job["command"] not in OVER_A_BUS:
            by_hand([job["line"]], monkeypatch)
        if job["command"] == "init":
            # dimensions, as an editor would
            rig = read_toml(hand / "rig.toml")
            changes = [("rig.toml", f"{rig['observation_point'][0]['position_mm'][2]}]", "2025.0]")]
            if way.calipers:
                changes.append(("drums.toml", "distance_mm = 180.0", "distance_mm = 181.5"))
            for name, before, after in changes:
                text = (hand / name).read_text(encoding="utf-8")
                assert before in text
                (hand / name).write_text(text.replace(before, after, 1), encoding="utf-8")
    files = [path.relative_to(hand) for path in sorted(hand.rglob("*")) if path.is_file()]
    assert len(files) > (20 if way.calipers else 12)
    for file in files:
        assert (project / file).read_bytes() == file.read_bytes(), file


@pytest.mark.slow
@pytest.mark.live
def test_a_mechanic_from_nothing_to_a_calibrated_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The quick form: three drums, two of which are exchanged."""
    walked(tmp_path, monkeypatch, QUICK, ("init", "plan-poses", "play", "scan", "check", "check", "capture", "calibrate"))


@pytest.mark.slow
@pytest.mark.live
def test_a_mechanic_from_nothing_to_a_calibrated_rig_with_its_points_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The long form."""
    commands = ("init", "drum", "plan-poses", "play", "scan", "check", "check", "capture", "calibrate", "zone", "place", "zone")
    walked(tmp_path, monkeypatch, Job(poses=12), commands)
