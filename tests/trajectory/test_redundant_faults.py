"""Counters that err on redundant cables: origins proved, channels left out, and what the run says of it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import START, cell, motion, position_error, record, with_recorded, words
from test_schemes import EIGHT, SEVEN, rig_of

from lmeasure.core import Status
from lmeasure.recording import read_run, read_run_head, write_run
from lmeasure.trajectory import covariances, read_trajectory, reconstruct, reconstruct_stream


@pytest.mark.parametrize("pairs", [SEVEN, EIGHT])
def test_redundant_cables_prove_an_origin(pairs: list[tuple[str, str]]) -> None:
    run = record(rig_of(pairs), *motion(2500, rate_hz=250.0))
    truth = motion(2500, rate_hz=250.0)[1]
    recorded = run.passes[0].recorded.copy()
    recorded[600:900, 3] += 700.0
    trajectory = reconstruct(with_recorded(run, recorded))
    assert set(words(trajectory)) == {"ok"}
    assert set(trajectory.cable[600:900]) == {"c4"}
    assert set(trajectory.cable[:600]) | set(trajectory.cable[902:]) == {""}
    assert any("But the other cables show that no counts are lost" in note for note in map(str, trajectory.notes))
    assert position_error(trajectory.poses, truth).max() < 0.03


def test_swapped_channels_of_eight_cables_are_never_ok() -> None:
    run = record(rig_of(EIGHT), *motion(1500, rate_hz=250.0))
    recorded = run.passes[0].recorded.copy()
    recorded[:, [1, 4]] = recorded[:, [4, 1]]
    trajectory = reconstruct(with_recorded(run, recorded))
    assert set(words(trajectory)) == {"inconsistent"}
    said = [note for note in map(str, trajectory.notes) if "the cables contradict each other, and no single cable explains it" in note]
    assert [note.split(":")[0] for note in said] == ["from the beginning to the end"]


def test_two_channels_that_err_one_after_the_other_are_each_left_out() -> None:
    run = record(rig_of(EIGHT), *motion(3000, rate_hz=250.0))
    recorded = run.passes[0].recorded.copy()
    for j, begin in ((2, 300), (6, 1800)):
        recorded[begin : begin + 500, j] -= (300.0 * np.sin(np.pi * np.arange(500) / 500) ** 2).round()
    trajectory = reconstruct(with_recorded(run, recorded))
    assert set(words(trajectory)) == {"ok"}
    assert set(trajectory.cable[330:770]) == {"c3"}
    assert set(trajectory.cable[1830:2270]) == {"c7"}
    assert set(trajectory.cable) == {"", "c3", "c7"}
    said = [
        re.match(r"from (\S+) s to (\S+) s: cable c[37] differs from the other cables", note) for note in map(str, trajectory.notes[:2])
    ]
    for found, begin in zip(said, (300, 1800), strict=True):
        assert found is not None, trajectory.notes
        assert abs(float(found[1]) - begin / 250.0) < 0.2
        assert abs(float(found[2]) - (begin + 500) / 250.0) < 0.2
    assert position_error(trajectory.poses, motion(3000, rate_hz=250.0)[1]).max() < 0.03


def test_two_channels_that_err_at_once_are_measured_by_the_others() -> None:
    """Of nine cables, by less than a step that their motion would show: exactly as long as they do, and by what they do."""
    counts = {"c3": 12.0, "c7": -10.0}
    run = record(rig_of([*EIGHT, ("B1", "P3")]), *motion(900, rate_hz=250.0))
    recorded = run.passes[0].recorded.copy()
    recorded[300:600, [2, 6]] += list(counts.values())
    trajectory = reconstruct(with_recorded(run, recorded))
    assert [set(trajectory.cable[part]) for part in (slice(300), slice(300, 600), slice(600, None))] == [{""}, {"c3, c7"}, {""}]
    said = [
        re.match(r"from (\S+) s to (\S+) s: cable (c[37]) differs .* by up to (\S+) mm .*uncertainty (\S+) mm", str(note))
        for note in trajectory.notes
    ]
    found = [one for one in said if one is not None]
    assert [(float(one[1]), float(one[2]), one[3]) for one in found] == [(299 / 250, 599 / 250, "c3"), (299 / 250, 599 / 250, "c7")]
    for one in found:
        assert abs(float(one[4]) - 0.012 * counts[one[3]]) < 4.0 * float(one[5]) < 0.1
    assert position_error(trajectory.poses, motion(900, rate_hz=250.0)[1]).max() < 0.03


def test_two_channels_of_nine_that_err_at_different_times_are_left_out_at_their_own() -> None:
    """Together they explain all alarms; at those of one the other is sound, used, and nothing is said of it."""
    run = record(rig_of([*EIGHT, ("B1", "P3")]), *motion(450, rate_hz=250.0))
    recorded = run.passes[0].recorded.copy()
    recorded[100:200, 2] += 12.0
    recorded[300:400, 6] -= 10.0
    trajectory = reconstruct(with_recorded(run, recorded))
    parts = [slice(100), slice(100, 200), slice(200, 300), slice(300, 400), slice(400, None)]
    assert [set(trajectory.cable[part]) for part in parts] == [{""}, {"c3"}, {""}, {"c7"}, {""}]
    assert len([note for note in map(str, trajectory.notes) if "differs from the other cables" in note]) == 2


def test_without_two_cables_the_covariance_is_that_of_the_others(tmp_path: Path) -> None:
    run = record(rig_of(EIGHT), *motion(400, rate_hz=250.0))
    recorded = run.passes[0].recorded.copy()
    recorded[100:, [6, 7]] = np.nan
    missing = with_recorded(run, recorded)
    trajectory = reconstruct(missing)
    assert set(trajectory.cable[100:]) == {"c7, c8"}
    assert np.isnan(trajectory.residual_mm[100:]).all()
    assert np.isfinite(trajectory.residual_mm[:100]).all()
    found = covariances(trajectory, run)
    np.testing.assert_allclose(found.random, trajectory.random, rtol=1e-9)
    six = reconstruct(record(cell(), *motion(400, rate_hz=250.0)))
    np.testing.assert_allclose(trajectory.random[200], six.random[200], rtol=1e-3, atol=1e-12)
    write_run(tmp_path / "run", missing)
    reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "t.parquet")
    assert set(read_trajectory(tmp_path / "t.parquet").cable[100:]) == {"c7, c8"}


def test_from_file_to_file_the_same_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.io.tables.PIECE_ROWS", 257)
    monkeypatch.setattr("lmeasure.io.tables.PIECE_BYTES", 20_000)
    run = record(rig_of(EIGHT), *motion(2000, rate_hz=250.0))
    recorded = run.passes[0].recorded.copy()
    recorded[700:, 5] += 90.0
    recorded[1200:1500, 2] -= (300.0 * np.sin(np.pi * np.arange(300) / 300) ** 2).round()
    write_run(tmp_path / "run", with_recorded(run, recorded))
    summary = reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "t.parquet")
    whole = reconstruct(read_run(tmp_path / "run"))
    back = read_trajectory(tmp_path / "t.parquet")
    np.testing.assert_allclose(back.poses, whole.poses, atol=1e-9)
    assert back.cable.tolist() == whole.cable.tolist()
    assert back.cause.tolist() == whole.cause.tolist()
    assert back.chi_squared is not None
    assert whole.chi_squared is not None
    np.testing.assert_allclose(back.chi_squared, whole.chi_squared, rtol=1e-6, atol=1e-9)
    for note in map(str, whole.notes):
        assert f"note: {note}" in summary.text()


@pytest.mark.parametrize(
    ("pairs", "said"),
    [
        (None, "no redundancy (6 cables, 6 unknowns)"),
        (SEVEN, "unknowns): faults are detected, but not which cable is wrong"),
        (EIGHT, "unknowns): a wrong cable is detected and not used"),
    ],
)
def test_the_summary_says_what_can_be_seen(pairs: list[tuple[str, str]] | None, said: str) -> None:
    run = record(cell() if pairs is None else rig_of(pairs), *motion(300))
    text = reconstruct(run).summary()
    assert said in text
    assert "or more are detected. The limit comes from the motion's own acceleration" in text
    if pairs is None:
        assert "Errors present from the start are not" in text
    np.testing.assert_array_equal(run.known_start, START)


@pytest.mark.parametrize("unstated", ["exact", "typical"])
def test_a_drawing_that_is_off_is_not_called_a_fault_of_a_cable(unstated: str) -> None:
    """Eight cables of a rig that nobody calibrated: the lengths contradict each other, and the summary says what may be the reason."""
    rig = rig_of(EIGHT)
    run = record(rig, *motion(800, rate_hz=250.0))
    rng = np.random.default_rng(3)
    moved = [p.model_copy(update={"position_mm": tuple(np.array(p.position_mm) + rng.normal(0.0, 3.0, 3))}) for p in rig.observation_point]
    trajectory = reconstruct(replace(run, rig=rig.model_copy(update={"observation_point": tuple(moved), "unstated": unstated})))
    assert set(words(trajectory)) == {"inconsistent"}
    assert any("where its dimensions have larger errors than the uncertainty includes" in note for note in map(str, trajectory.notes))


def test_more_faults_than_anybody_counts_are_never_called_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.trajectory.faults.consistency.ROUNDS", 2)
    run = record(rig_of(EIGHT), *motion(4800, rate_hz=200.0))
    recorded = run.passes[0].recorded.copy()
    for k in range(8):
        begin = 100 + 600 * k
        recorded[begin : begin + 250, (2, 6)[k % 2]] -= np.rint(600.0 * np.sin(np.pi * np.arange(250) / 250) ** 2)[: 4800 - begin]
    trajectory = reconstruct(with_recorded(run, recorded))
    ok = trajectory.status == Status.OK
    assert position_error(trajectory.poses[ok], motion(4800, rate_hz=200.0)[1][ok]).max(initial=0.0) < 0.05
