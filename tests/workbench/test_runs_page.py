"""Runs: a start that is not stated keeps from what follows, a trajectory over time as its file has it, rerun's viewer."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import client, served
from browser import opened
from clicks import entered, press, visit

from lmeasure.accuracy import AXIS_95, along
from lmeasure.core import Status
from lmeasure.recording import read_run, write_run
from lmeasure.trajectory import read_trajectory, reconstruct, write_trajectory
from lmeasure.workbench.trajectories import SHOWN, series

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run and its trajectory, in which some samples have no pose."""
    folder = tmp_path_factory.mktemp("runs") / "project"
    run = read_run(TRUTH / "cell-run")
    write_run(folder / "run", run)
    made = reconstruct(run)
    lost = slice(30, 40)
    poses, status, cause = made.poses.copy(), made.status.copy(), made.cause.copy()
    poses[lost], status[lost], cause[lost] = np.nan, Status.GAP, "no counts"
    write_trajectory(folder / "trajectory.parquet", replace(made, poses=poses, status=status, cause=cause))
    return folder


def startless(folder: Path, project: Path) -> None:
    """A copy of the project whose run does not say where it began."""
    shutil.copytree(project, folder)
    table = folder / "run" / "run.toml"
    text = table.read_text()
    begin = text.index("[start]")
    end = text.find("\n[", begin + 1)
    table.write_text(text[:begin] + ("" if end < 0 else text[end + 1 :]))


def test_without_its_start_a_run_is_not_certified_and_the_page_says_why(project: Path, tmp_path: Path) -> None:
    folder = tmp_path / "project"
    startless(folder, project)
    (folder / "program.toml").write_text('schema = "lmeasure.program/1"\n')
    form = {"_form": "1", "trajectory": "trajectory.parquet", "run": "run", "program": "program.toml", "out": "certificate"}
    with client(folder) as session:
        assert 'data-start="missing"' in session.get("/runs").text
        reported = session.post("/line/certify", data=form).json()
        assert "start pose of this run is not stated" in reported["hindered"]
        assert reported["mend"] == "/start/run"
        refused = session.post("/run/certify", data=form)
        assert refused.status_code == 422
        assert "start pose of this run is not stated" in refused.text
        assert session.get("/api/jobs").json()["jobs"] == []
        assert session.post("/start/run", data={"start": "0,0,0,0,-90,90"}).status_code == 303
        assert "hindered" not in session.post("/line/certify", data=form).json()
        assert 'data-start="stated"' in session.get("/runs").text


def test_series_are_those_of_the_file_with_their_extremes(project: Path) -> None:
    found = along(read_trajectory(project / "trajectory.parquet"))
    moved = found.trajectory
    whole = series(found, -np.inf, np.inf)
    assert len(whole["time_s"]) <= SHOWN + 2
    for i, name in enumerate("xyz"):
        values = np.array(whole[name], dtype=float)
        assert np.nanmax(values) == np.nanmax(moved.poses[:, i])
        assert np.nanmin(values) == np.nanmin(moved.poses[:, i])
    a, b = moved.time_s[10], moved.time_s[40]
    part = series(found, a, b)
    assert part["time_s"] == moved.time_s[10:41].tolist()
    np.testing.assert_array_equal(np.array(part["u_y"], dtype=float), AXIS_95 * moved.u[10:41, 1])
    assert series(found, b + 1e9, b + 2e9) == {}


def test_a_span_is_saved_as_the_file_has_it(project: Path, tmp_path: Path) -> None:
    with client(project) as session:
        answer = session.get("/export/trajectory.parquet?begin=1&end=2")
        assert "attachment" in answer.headers["content-disposition"]
        (tmp_path / "span.csv").write_text(answer.text)
        assert session.get("/along/trajectory.parquet?begin=x").status_code == 422
        assert session.get("/along/run/run.toml").status_code == 422
        assert session.get("/trajectory/run/rig.toml").status_code == 422
    whole, part = read_trajectory(project / "trajectory.parquet"), read_trajectory(tmp_path / "span.csv")
    own = (whole.time_s >= 1.0) & (whole.time_s <= 2.0)
    np.testing.assert_allclose(part.poses, whole.poses[own], rtol=0, atol=1e-12)


def test_the_viewer_alone_may_run_its_machine_code_and_reads_the_project_alone(project: Path) -> None:
    with client(project) as session:
        answer = session.get("/viewer/")
        policy = answer.headers["content-security-policy"]
        assert "'wasm-unsafe-eval'" in policy
        assert "connect-src http://127.0.0.1:8123/raw/ http://127.0.0.1:8123/viewer/ data: blob:" in policy
        assert 'href="https://' not in answer.text
        assert session.get("/viewer/re_viewer.js").headers["content-type"].startswith("text/javascript")
        assert session.get("/viewer/..%2frun.toml").status_code == 404
        for path in ("/", "/runs", "/trajectory/trajectory.parquet"):
            assert "wasm" not in session.get(path).headers["content-security-policy"]


def test_the_slider_moves_all_figures_and_a_gap_is_jumped_to(project: Path, tmp_path: Path) -> None:
    found = along(read_trajectory(project / "trajectory.parquet"))
    gap = next(s for s in found.stretches if not s.ok)
    with served(project) as address, opened(address) as page:
        base = entered(page)
        visit(page, base, "/trajectory/trajectory.parquet")
        page.wait("!!document.getElementById('along').dataset.at")
        page.evaluate("(() => {const e = document.getElementById('cursor'); e.value = 250; e.dispatchEvent(new Event('input'))})()")
        at = float(page.evaluate("document.getElementById('along').dataset.at"))
        i = int(np.abs(found.trajectory.time_s - at).argmin())
        reported = page.evaluate("document.getElementById('at-x').textContent")
        assert reported == f"{found.trajectory.poses[i, 0]:.3f} ± {AXIS_95 * found.trajectory.u[i, 0]:.4f}".replace("-", "\u2212")
        press(page, ".stretches button.bad", f"Math.abs(document.getElementById('along').dataset.at - {gap.begin_s}) < 0.5")
        page.wait("(document.getElementById('along').dataset.shown ?? '').startsWith('begin=')")
        ink = "c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v)"
        drawn = f"[...document.querySelectorAll('canvas.plot')].map(c => {ink})"
        assert page.evaluate(drawn) == [True] * 5
        assert page.errors == []


def test_logs_that_are_dropped_stand_in_the_form_of_import(project: Path, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_text("(1.0) can0 123#00\n")
    with client(tmp_path / "project") as session:
        with log.open("rb") as file:
            answer = session.post("/upload", data={"folder": "logs", "then": "import"}, files={"files": ("drive.log", file)})
        assert answer.headers["location"] == "/run/import?logs=logs%2Fdrive.log"
        page = session.get(answer.headers["location"]).text
    assert ">logs/drive.log</textarea>" in page
    assert 'value="runs/run"' in page
