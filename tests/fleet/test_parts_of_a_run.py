"""A long run in parts over workers: the rows and bits of the whole, though a worker dies."""

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cluster import two_workers
from in_process import code_and_text

from lmeasure.recording import read_run, read_run_head, write_run
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import reconstruct_in_parts, reconstruct_stream

SAMPLES, LOST = 36_000, 20_000


@pytest.fixture(scope="module")
def long_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three pieces; a channel loses counts in the second, which every later sample depends on, and groups of rows end elsewhere."""
    rng = np.random.default_rng(5)
    legs = [Leg(np.concatenate([rng.uniform(-100.0, 100.0, 3), [0.0, 0.0, 0.0, 1.0]]), 300.0, 1.0, 0.2) for _ in range(60)]
    time_s, poses = smooth_path(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), legs, 1000.0)
    run = simulate_run(cell_rig(0), time_s[:SAMPLES], poses[:SAMPLES], noise_mm=0.0, rng=rng).run
    assert len(run.passes[0].time_s) == SAMPLES
    run.passes[0].recorded[LOST:, 2] += 4000.0
    folder = tmp_path_factory.mktemp("long") / "run"
    write_run(folder, run, {}, ".parquet")
    rows = pd.read_parquet(folder / "pass1.parquet")
    rows.to_parquet(folder / "pass1.parquet", row_group_size=7000, index=False)
    return folder


def test_parts_have_the_rows_and_bits_of_the_whole_though_a_worker_is_killed(long_run: Path, tmp_path: Path) -> None:
    head = read_run_head(long_run)
    whole = reconstruct_stream(head, tmp_path / "whole.parquet")
    out = tmp_path / "parts"
    out.mkdir()
    with two_workers() as cluster:

        def kill() -> None:
            while not list(out.glob("part-*")):
                time.sleep(0.02)
            os.kill(cluster.workers[0].pid, signal.SIGKILL)

        thread = threading.Thread(target=kill)
        thread.start()
        parts = reconstruct_in_parts(head, out, cluster.address, pieces=1)
        thread.join()
    assert sorted(path.name for path in out.iterdir()) == [f"part-0000{n}.parquet" for n in range(3)]
    pd.testing.assert_frame_equal(pd.read_parquet(out), pd.read_parquet(tmp_path / "whole.parquet"), check_exact=True)
    assert (parts.text(), parts.figures()) == (whole.text(), whole.figures())
    assert set(parts.statuses) - {"ok"}  # the lost counts are seen in both


def test_what_goes_in_parts_is_said_in_one_line(long_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.io.cluster.ANSWER_S", 1.0)

    def refused(*words: object) -> str:
        return " ".join(code_and_text("reconstruct", *words, "--scheduler", "tcp://127.0.0.1:1")[1].split())

    assert "without --continuous" in refused(long_run, "--out", tmp_path / "t", "--continuous")
    assert "no dask scheduler answers" in refused(long_run, "--out", tmp_path / "t").lower()
    write_run(tmp_path / "text", read_run(long_run))
    assert "counts in .parquet" in refused(tmp_path / "text", "--out", tmp_path / "u")
