"""Certificates of runs whose counters lost counts: no verdict on what hangs on them, from the counts and from the file alone."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from campaigns import write_campaign
from numpy.typing import NDArray

from lmeasure.certificate import Inputs, Measured, measure
from lmeasure.core import CertificationError, FloatArray
from lmeasure.iso9283 import CertificationSettings
from lmeasure.recording import read_run, write_run
from lmeasure.trajectory import reconstruct, write_trajectory

LOST = 200


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suspected")
    write_campaign(folder)
    return folder


def slipped(samples: NDArray[np.int64]) -> FloatArray:
    """(n,) counts lost a few at a time within so many samples behind an instant: a step would be seen as such."""
    return np.rint(LOST * np.clip(samples / 30.0, 0.0, 1.0))


def certified(campaign: Path, folder: Path, part: float | None, channel: int = 2) -> tuple[Measured, Measured]:
    """With the run and from its trajectory alone, its counts lost after a part of the samples."""
    run = read_run(campaign / "run")
    recorded = run.passes[0].recorded.copy()
    if part is not None:
        recorded[:, channel] += slipped(np.arange(len(recorded)) - int(part * len(recorded)))
    write_run(folder / "run", replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    write_trajectory(folder / "t.parquet", reconstruct(read_run(folder / "run")))
    program, settings = campaign / "program.toml", CertificationSettings(trials=200)
    first = measure(Inputs(folder / "t.parquet", program, folder / "run"), settings)
    return first, measure(Inputs(folder / "t.parquet", program), settings)


def test_a_sound_run_has_its_verdicts(campaign: Path, tmp_path: Path) -> None:
    for found in certified(campaign, tmp_path, None):
        assert found.evaluation.excluded == ()
        assert any(c.capable for c in found.evaluation.characteristics)
        assert not any("suspected" in note for note in map(str, found.notes))


def test_counts_lost_half_way_leave_no_verdict(campaign: Path, tmp_path: Path) -> None:
    with_run, alone = certified(campaign, tmp_path, 0.5)
    for found in (with_run, alone):
        figures = found.evaluation.characteristics
        wrong = next(c for c in figures if c.name == "RP_l" and c.pose == "P1")
        assert wrong.value > 1.0  # 0.27 are true
        assert not any(c.capable or c.conformity for c in figures)
        assert all("suspected lost counts: channel ch3 (cable c3) jumped by" in str(c.excluded) for c in figures)
    assert any(note.startswith("suspected: channel ch3 (cable c3) jumped by") for note in map(str, with_run.notes))


def test_what_was_measured_before_keeps_its_verdict(campaign: Path, tmp_path: Path) -> None:
    """Lost on the line to the last dwell, at P3: figures of P1 and P2 stand, those of P3, of distances to it and of the line do not."""
    for found in certified(campaign, tmp_path, 0.96):
        assert {(e.kind, e.name) for e in found.evaluation.excluded} == {("pose", "P3"), ("path", "line")}
        for c in found.evaluation.characteristics:
            assert (c.excluded is not None) == (c.path == "line" or "P3" in str(c.pose)), c
        assert any(c.capable for c in found.evaluation.characteristics if c.pose == "P1")


def test_what_does_not_close_is_in_u95(campaign: Path, tmp_path: Path) -> None:
    """One return is too little to suspect a step: of a run cut behind it, the figures hold what may have been lost."""
    run, wide = read_run(campaign / "run"), {}
    program = (campaign / "program.toml").read_text().split("[[path]]")[0]
    time_s = run.passes[0].time_s
    poses = tomllib.loads(program)["pose"]
    end = float(poses[0]["windows_s"][1][1]) + 0.06
    kept = [p | {"windows_s": [w for w in p["windows_s"] if w[1] < end]} for p in poses]
    (tmp_path / "program.toml").write_text(tomli_w.dumps({"schema": "lmeasure.program/1", "pose": kept}))
    for lost in (0, LOST):
        recorded = run.passes[0].recorded.copy()
        recorded[:, 2] += slipped(np.arange(len(time_s)) - int(np.searchsorted(time_s, 2.0))) * (lost / LOST)
        whole = run.passes[0]
        counts = replace(whole, time_s=time_s[time_s <= end], recorded=recorded[time_s <= end])
        write_run(tmp_path / "run", replace(run, passes=(counts,)))
        write_trajectory(tmp_path / "t.parquet", reconstruct(read_run(tmp_path / "run")))
        found = measure(Inputs(tmp_path / "t.parquet", tmp_path / "program.toml", tmp_path / "run"), CertificationSettings(trials=400))
        wide[lost] = {c.name: c for c in found.evaluation.characteristics if c.pose == "P1"}
        assert ("closure of the counts" in str(found.evaluation.covers)) == bool(lost)
        assert any("between two rests at one position" in note for note in map(str, found.notes)) == bool(lost)
    for name in ("AP_p", "RP_l"):
        wrong, right = wide[LOST][name], wide[0][name]
        assert abs(wrong.value - right.value) < wrong.u95
        assert not wrong.capable
        assert right.u95 < 0.1 < wrong.u95


def test_what_stepped_is_not_measured_at_all(campaign: Path, tmp_path: Path) -> None:
    """A step while the robot moves is seen, and the dwell behind it named."""
    run = read_run(campaign / "run")
    recorded = run.passes[0].recorded.copy()
    recorded[len(recorded) // 2 :, 2] += LOST
    write_run(tmp_path / "run", replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    write_trajectory(tmp_path / "t.parquet", reconstruct(read_run(tmp_path / "run")))
    with pytest.raises(CertificationError, match=r"is not ok: channel ch3 jumped by about .* counts .* between .* its origin is lost"):
        measure(Inputs(tmp_path / "t.parquet", campaign / "program.toml", tmp_path / "run"), CertificationSettings(trials=200))
