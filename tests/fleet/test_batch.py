"""One command for many folders: what is done again, what a failure costs, and the same bytes whoever does it."""

import errno
import hashlib
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fsspec
import pandas as pd
import pytest
from cluster import two_workers, worker
from in_process import refused

import lmeasure.workflows.batch as batch
from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.recorder import candump_lines
from lmeasure.fleet import Item, read_items
from lmeasure.recording import read_run

RUN = Path(__file__).parents[1] / "authorities" / "truth" / "cell-run"
BY = ("--folders", "{robot}/{day}/{name}")


def runs_of(here: Path, robots: int = 2, days: int = 2, samples: int = 60) -> Path:
    """Write short runs: runs/r1/2026-01-01/run; no two are equal."""
    rows = (RUN / "pass1.csv").read_text().splitlines()
    for robot in range(robots):
        for day in range(days):
            folder = here / "runs" / f"r{robot + 1}" / f"2026-01-{day + 1:02d}" / "run"
            folder.mkdir(parents=True)
            for name in ("rig.toml", "run.toml"):
                shutil.copy(RUN / name, folder / name)
            (folder / "pass1.csv").write_text("\n".join(rows[: samples + 10 * robot + day]) + "\n")
    return here / "runs"


def done(*words: object, code: int = 0) -> str:
    return refused("batch", *words, code=code)


def digests(store: Path) -> dict[str, str]:
    """Return the bytes of all trajectories and figures, as digests."""
    paths = sorted((*(store / "trajectory").rglob("*.parquet"), *(store / "figures").rglob("*.parquet")))
    return {str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def test_names_robots_and_days_of_items(tmp_path: Path) -> None:
    runs = runs_of(tmp_path)
    named = read_items([f"{runs}/*/*/run"], "run", "{robot}/{day}/{name}")
    assert [(i.robot, i.day, i.name) for i in named] == [(r, d, "run") for r in ("r1", "r2") for d in ("2026-01-01", "2026-01-02")]
    # without names of the folders, they tell the items apart
    assert [i.name for i in read_items([f"{runs}/*/*/run"], "run")][:2] == ["r1-2026-01-01-run", "r1-2026-01-02-run"]
    assert [i.name for i in read_items([str(runs)], "run")] == ["r1", "r2"]
    written = tmp_path / "trajectory" / "robot=r7" / "day=2026-02-03"
    written.mkdir(parents=True)
    (written / "a.parquet").touch()
    assert [(i.robot, i.day, i.name) for i in read_items([f"{tmp_path}/trajectory/*/*/*"], "trajectory")] == [("r7", "2026-02-03", "a")]
    table = tmp_path / "items.csv"
    table.write_text("name,robot,run,start\na,r1,x/1,\nb,r2,x/2,start.toml\n")
    first, second = read_items([str(table)], "run")
    assert (first.options, second.options, second.day) == ({"run": "x/1"}, {"run": "x/2", "start": "start.toml"}, "unknown")
    assert Item("../up", "a/b", "..").place == "robot=a%2Fb/day=%2E%2E/..%2Fup"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing"], "nothing: does not exist"),
        (["nothing*"], "has such a name"),
        (["{runs}/*/*/run", "--folders", "{week}"], "names folders by"),
        (["{runs}/*/*/run", "--folders", "{robot}/old/{name}"], "does not end in"),
        (["{runs}/*/*/run", "--folders", "{name}"], "two items are named run"),
        (["{runs}/*/*/run", "--set", "colour=red"], "colour=red' is not NAME=VALUE"),
        (["{runs}/*/*/run", "--scheduler", "nonsense"], "'nonsense': is no address"),
        (["table.csv"], "table.csv, line 3: has not 2 cells"),
    ],
)
def test_wrong_use_is_one_line(words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "1000")
    runs_of(tmp_path)
    Path("table.csv").write_text("name,run\na,runs\nb\n")
    code = 2 if "line 3" not in said and "address" not in said else 1
    output = done("reconstruct", *(word.replace("{runs}", "runs") for word in words), "--out", "store", code=code)
    assert said in " ".join(output.split())


def test_only_what_has_changed_is_done_again_and_a_failure_costs_its_item(tmp_path: Path) -> None:
    runs, store = runs_of(tmp_path), tmp_path / "store"
    (runs / "r2" / "2026-01-02" / "run" / "pass1.csv").write_text("time_s,ch1\n0,x\n")
    words = ("reconstruct", f"{runs}/*/*/run", *BY, "--out", store)
    output = done(*words, code=1)
    assert "4 items" in output
    assert "3 done, 1 failed, 0 unchanged" in output
    assert re.search(r"failed: run \(robot r2, day 2026-01-02\): .*pass1\.csv", output)
    before = digests(store)
    assert len(before) == 6
    # any tool reads the store: robot and day are columns
    table = pd.read_parquet(store / "trajectory")
    assert table.groupby(["robot", "day"], observed=True).size().to_dict() == {
        ("r1", "2026-01-01"): 59, ("r1", "2026-01-02"): 60, ("r2", "2026-01-01"): 69,
    }  # fmt: skip
    with sqlite3.connect(store / "catalogue.sqlite") as database:
        states = dict(database.execute("SELECT robot || day, state FROM item").fetchall())
    database.close()
    assert states["r22026-01-02"] == "failed"
    assert "r2,2026-01-02" in (store / "reconstruct.csv").read_text().replace('"', "")
    assert "1 of 4 items failed" in (store / "reconstruct.html").read_text()

    shutil.copy(runs / "r1" / "2026-01-01" / "run" / "pass1.csv", runs / "r2" / "2026-01-02" / "run" / "pass1.csv")
    counts = (runs / "r1" / "2026-01-01" / "run" / "pass1.csv").read_text()
    (runs / "r1" / "2026-01-01" / "run" / "pass1.csv").write_text("\n".join(counts.splitlines()[:-9]) + "\n")
    (store / "trajectory" / "robot=r2" / "day=2026-01-01" / "run.parquet").write_bytes(b"not a table")
    assert "3 done, 0 failed, 1 unchanged" in done(*words)
    after = digests(store)
    changed = {name for name in after if name.startswith("trajectory") and after[name] != before.get(name)}
    assert changed == {f"trajectory/robot={r}/day={d}/run.parquet" for r, d in (("r1", "2026-01-01"), ("r2", "2026-01-02"))}
    assert "0 done, 0 failed, 4 unchanged" in done(*words)
    # another option is another result
    assert "4 done" in done(*words, "--set", "angles=true")
    assert not (store / ".parts").exists()


def test_a_full_store_stops_the_batch_and_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs, store = runs_of(tmp_path), tmp_path / "store"
    keep, kept = batch_keep(), list[str]()

    def full(self: object, made: Path, place: str) -> None:
        if place.startswith("trajectory") and len(kept) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        kept.append(place)
        keep(self, made, place)

    with monkeypatch.context() as patch:
        patch.setattr("lmeasure.fleet.Store.keep", full)
        output = done("reconstruct", f"{runs}/*/*/run", *BY, "--out", store, code=1)
    assert "No space left on device. 2 of 4 items are kept" in output
    assert "2 done, 0 failed, 2 unchanged" in done("reconstruct", f"{runs}/*/*/run", *BY, "--out", store)


def batch_keep() -> Callable[[object, Path, str], None]:
    from lmeasure.fleet import Store

    return Store.keep  # type: ignore[return-value]


def test_a_worker_of_another_version_does_nothing(tmp_path: Path) -> None:
    task = batch.Task("reconstruct", Item("a"), {"run": str(RUN)}, str(tmp_path), "0.0", None)
    came = batch.worked(task)
    assert isinstance(came, batch.Stop)
    assert came.line.endswith("not 0.0")
    assert list(tmp_path.iterdir()) == []


def test_results_go_to_a_place_that_is_no_folder(tmp_path: Path) -> None:
    runs = runs_of(tmp_path, robots=1)
    words = ("reconstruct", f"{runs}/*/*/run", *BY, "--out", "memory://fleet")
    assert "contains no database" in " ".join(done(*words, code=2).split())
    more = ("--catalogue", str(tmp_path / "items.sqlite"))
    assert "2 done" in done(*words, *more)
    assert "2 unchanged" in done(*words, *more)
    place = fsspec.filesystem("memory")
    assert len(place.glob("/fleet/trajectory/robot=r1/*/run.parquet")) == 2
    done("reconstruct", f"{runs}/*/*/run", *BY, "--out", tmp_path / "store")
    for path in (tmp_path / "store" / "trajectory").rglob("*.parquet"):
        assert place.cat_file(f"/fleet/{path.relative_to(tmp_path / 'store').as_posix()}") == path.read_bytes()


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """An object store on loopback, with a bucket `plant`, as fsspec reaches it."""
    from moto.server import ThreadedMotoServer  # takes a second, which nobody else need wait

    server = ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    about = {"AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_DEFAULT_REGION": "us-east-1"}
    for name, value in {**about, "AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret"}.items():
        monkeypatch.setenv(name, value)
    place = fsspec.filesystem("s3", skip_instance_cache=True)
    place.mkdir("plant")
    yield place
    server.stop()


def test_results_go_to_an_object_store(s3: Any, tmp_path: Path) -> None:
    """A result that was lost there is made again; a bucket that is not there costs one line."""
    words = ("reconstruct", f"{runs_of(tmp_path, robots=1)}/*/*/run", *BY)
    far = ("--out", "s3://plant/fleet", "--catalogue", tmp_path / "items.sqlite")
    assert "2 done" in done(*words, *far)
    assert "2 unchanged" in done(*words, *far)
    done(*words, "--out", tmp_path / "store")
    kept = {p.relative_to(tmp_path / "store").as_posix(): p.read_bytes() for p in (tmp_path / "store" / "trajectory").rglob("*.parquet")}
    assert {f"plant/fleet/{name}" for name in kept} == set(s3.glob("plant/fleet/trajectory/robot=r1/*/run.parquet"))
    assert all(s3.cat_file(f"plant/fleet/{name}") == content for name, content in kept.items())
    s3.rm(f"plant/fleet/{next(iter(kept))}")
    assert "1 done, 0 failed, 1 unchanged" in done(*words, *far)
    assert "s3://nowhere/fleet" in done(*words, "--out", "s3://nowhere/fleet", "--catalogue", tmp_path / "more.sqlite", code=1)


@pytest.mark.parametrize("stopped_s", [1.0, pytest.param(10.0, marks=pytest.mark.slow)])
def test_workers_give_the_same_bytes_though_one_is_killed_and_the_scheduler_stops_for_a_while(stopped_s: float, tmp_path: Path) -> None:
    runs = runs_of(tmp_path, robots=4, days=8)
    here, far = tmp_path / "here", tmp_path / "far"
    done("reconstruct", f"{runs}/*/*/run", *BY, "--out", here)
    with two_workers() as cluster:
        more: list[subprocess.Popen[str]] = []

        def disturb() -> None:
            while len(list((far / "trajectory").rglob("*.parquet"))) < 6:
                time.sleep(0.02)
            os.kill(cluster.workers[0].pid, signal.SIGKILL)
            more.append(worker(cluster.address))
            os.kill(cluster.scheduler.pid, signal.SIGSTOP)
            time.sleep(stopped_s)
            os.kill(cluster.scheduler.pid, signal.SIGCONT)

        thread = threading.Thread(target=disturb)
        thread.start()
        try:
            assert "32 done" in done("reconstruct", f"{runs}/*/*/run", *BY, "--out", far, "--scheduler", cluster.address)
        finally:
            thread.join()
            for process in more:
                process.kill()
                process.wait()
    assert cluster.workers[0].returncode == -signal.SIGKILL
    assert digests(far) == digests(here)  # nothing is lost, nothing there twice


def test_folders_of_results_are_replaced_whole_and_the_next_batch_takes_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = read_run(RUN)
    for robot, samples in (("r1", 40), ("r2", 50)):
        counts = run.passes[0]
        frames = frames_from_counts(
            counts.time_s[:samples], counts.recorded[:samples], counter_fields(run.rig), run.rig.can_table.sync_id
        )  # fmt: skip
        (tmp_path / "logs" / robot).mkdir(parents=True)
        (tmp_path / "logs" / robot / "drive.log").write_bytes(candump_lines(frames))
    shutil.copy(RUN / "rig.toml", "rig.toml")
    words = (
        "import",
        "logs/*/drive.log",
        "--folders",
        "{robot}/{name}",
        "--set",
        "rig=rig.toml",
        "--set",
        f"start={RUN / 'run.toml'}",
        "--out",
        "store",
    )
    output = done(*words)
    assert "2 done" in output
    assert "next: lmeasure batch reconstruct 'store/import/*/*/*' --out store" in output
    written = tmp_path / "store" / "import" / "robot=r1" / "day=unknown" / "drive"
    assert len((written / "pass1.csv").read_text().splitlines()) == 41
    shutil.copy("logs/r2/drive.log", "logs/r1/drive.log")
    (written / "old.txt").touch()
    assert "1 done, 0 failed, 1 unchanged" in done(*words)
    assert len((written / "pass1.csv").read_text().splitlines()) == 51
    assert not (written / "old.txt").exists()
    assert "2 done" in done("reconstruct", "store/import/*/*/*", "--out", "store")
    table = pd.read_parquet("store/trajectory")
    assert table.groupby("robot", observed=True).size().to_dict() == {"r1": 50, "r2": 50}


def test_a_command_that_writes_nothing_fails_by_its_exit_code(tmp_path: Path) -> None:
    sealed = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run"
    shutil.copytree(sealed, tmp_path / "folders" / "changed")
    found = (tmp_path / "folders" / "changed" / "certificate.json").read_text()
    (tmp_path / "folders" / "changed" / "certificate.json").write_text(found.replace("lmeasure.certificate/1", "lmeasure.certificate/9"))
    assert "failed: changed" in done("verify", tmp_path / "folders", "--out", tmp_path / "store", code=1)
