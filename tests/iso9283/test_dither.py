"""Dither: the mean of a stated swing is finer than a count, U95 says so, and nothing is gained where no swing is."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from dithering import Dithering
from in_process import ran, refused
from moving_robot import TRUTH, Instrument
from scipy.spatial.transform import Rotation
from test_command_windows import performed
from zeroed import zeroed_exactly

from lmeasure.accuracy import dither_gain
from lmeasure.core import AccuracyError, CertificationError, FloatArray
from lmeasure.iso9283 import (
    CertificationSettings,
    Cube,
    Evaluation,
    Tests,
    campaign,
    dithered,
    evaluate,
    windows_from_rests,
    write_commands,
)
from lmeasure.recording import Counts, Program, read_program, read_run
from lmeasure.rig import read_rig
from lmeasure.text import Message
from lmeasure.trajectory import reconstruct

TESTS = Tests(tests=("pose", "stabilisation"), speeds_percent=(100.0,), dwell_s=2.9, settle_s=0.5, cycles={"pose": 2, "stabilisation": 2})


def evaluated(motion: Dithering, *, stated: bool, unstated: Literal["typical", "exact"] = "exact", play: float = 0.0) -> Evaluation:
    """Evaluate the pose by counts at 100 Hz, exact but for their rounding; play: of each counter [counts]."""
    instrument, time_s = Instrument("cell-run"), np.arange(int(motion.lasts_s * 100.0)) / 100.0
    recorded = instrument.recorded(motion, np.tile(time_s[:, None], (1, len(instrument.channels))))
    run = read_run(TRUTH / "cell-run")
    if play:
        places, turns, *_ = motion.at(time_s)
        counts = np.stack([instrument.counts(j, places, turns) for j in range(len(instrument.channels))], axis=1)
        for i in range(1, len(counts)):
            counts[i] = np.clip(counts[i - 1], counts[i] - 0.5 * play, counts[i] + 0.5 * play)
        recorded = np.rint(counts - counts[:1])
    run = replace(run, rig=run.rig.model_copy(update={"unstated": unstated}), unstated=unstated, start=np.array([0.0] * 6 + [1.0]))
    run = zeroed_exactly(replace(run, passes=(Counts(time_s, instrument.channels, recorded),)))
    pose = {"name": "P", "position_mm": motion.commanded.tolist(), "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "windows_s": motion.windows()}
    swing = {"dither_mm": [0.05, 0.05, 0.05], "dither_s": 1.0} if stated else {}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose | swing]})
    return evaluate(reconstruct(run), program, run=run, settings=CertificationSettings(trials=300))


def codes(found: Evaluation) -> list[str]:
    return [note.code for note in found.notes if isinstance(note, Message) and note.code.startswith("iso.dither")]


def repeatability(rests: FloatArray) -> float:
    away = np.linalg.norm(rests - rests.mean(axis=0), axis=1)
    return float(away.mean() + 3.0 * away.std(ddof=1))


def test_a_stated_swing_makes_rp_finer_than_a_count() -> None:
    """Repeatability of 4 um per axis, counts of 12 um."""
    for seed in (1,):
        swinging, resting = (Dithering(seed, 10, 2, size_mm, 0.004) for size_mm in (0.05, 0.0))
        by_swing, unstated, at_rest = evaluated(swinging, stated=True), evaluated(swinging, stated=False), evaluated(resting, stated=False)
        true = {"RP_l": repeatability(swinging.rests), "AP_p": float(np.linalg.norm(swinging.rests.mean(axis=0) - swinging.commanded))}
        for name, value in true.items():
            fine, coarse, rough = ({c.name: c for c in each.characteristics}[name] for each in (by_swing, unstated, at_rest))
            assert abs(fine.value - value) < fine.u95
            assert fine.u95 < 0.4 * rough.u95
            assert fine.u95 < 0.4 * coarse.u95
        assert [getattr(f, "code", "") for f in by_swing.notes if str(getattr(f, "code", "")).startswith("iso.dither")] == [
            "iso.dither_found"
        ]


@pytest.mark.parametrize("play", [0.0, 2.0])
def test_unstated_play_is_common_to_all_swings(play: float) -> None:
    """Every swing passes the same places in the same directions, so the repeatability keeps its gain."""
    swinging = Dithering(1, 10, 2, 0.05, 0.004)
    (fine,), (rough,) = (
        [c for c in evaluated(motion, stated=stated, unstated="typical", play=play).characteristics if c.name == "RP_l"]
        for motion, stated in ((swinging, True), (Dithering(1, 10, 2, 0.0, 0.004), False))
    )
    assert abs(fine.value - repeatability(swinging.rests)) < fine.u95
    assert fine.u95 < 0.45 * rough.u95


def test_a_robot_that_does_not_swing_gains_nothing() -> None:
    resting = Dithering(1, 5, 2, 0.0, 0.004)
    claimed, plain = evaluated(resting, stated=True), evaluated(resting, stated=False)
    assert [(c.value, c.u95) for c in claimed.characteristics] == [(c.value, c.u95) for c in plain.characteristics]
    assert codes(claimed) == ["iso.dither_missing"]


def test_the_gain_is_that_of_rounded_counts() -> None:
    """Means of whole counts of a simulator that shares no formula, at many places within a count."""
    instrument, rig, rng = Instrument("cell-run"), read_rig(TRUTH / "cell-run" / "rig.toml"), np.random.default_rng(0)
    pose, step = np.array([40.0, -30.0, 20.0, 0.0, 0.0, 0.0, 1.0]), 1e-3
    part = (np.arange(240) + 0.5) / 240.0
    swing = 0.05 * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * part[:, None] * np.arange(1.0, 4.0)))

    def counts(place: FloatArray, turn: FloatArray) -> FloatArray:
        return np.stack([instrument.counts(j, place, Rotation.from_rotvec(turn)) for j in range(6)], axis=1)

    moves = np.vstack([step * np.eye(3), -step * np.eye(3)])
    turned, shifted = counts(np.tile(pose[:3], (6, 1)), moves), counts(pose[:3] + moves, np.zeros((6, 3)))
    slopes = np.hstack([((each[:3] - each[3:]) / (2.0 * step)).T for each in (turned, shifted)])
    along = counts(pose[:3] + swing, np.zeros((240, 3)))
    phases = rng.random((400, 1, 6))
    errors = (np.rint(along + phases) - along - phases).mean(axis=1) @ np.linalg.inv(slopes)[3:].T
    actual = float(np.sqrt((errors**2).sum(axis=1).mean()))
    (rest,), (found,) = dither_gain(rig, pose[None], 0.05)
    assert rest == pytest.approx(float(np.sqrt((np.linalg.inv(slopes)[3:] ** 2).sum() / 12.0)), rel=5e-3)
    assert actual < found < 2.5 * actual
    assert found < 0.25 * rest
    with pytest.raises(AccuracyError, match="determine all of the pose"):
        dither_gain(rig.model_copy(update={"cable": rig.cable[:5]}), pose[None], 0.05)


def test_a_robot_runs_the_swings_and_the_program_gets_their_windows(tmp_path: Path) -> None:
    plan = dithered(campaign(Cube(np.zeros(3), 300.0), TESTS), 0.05, TESTS.settle_s)
    write_commands(tmp_path / "commands.csv", plan)
    timed, trajectory = performed(plan)
    found, _ = windows_from_rests(plan.program, tmp_path / "commands.csv", trajectory)
    for pose, own in zip(timed.pose, found.pose, strict=True):
        assert (pose.dither_s is None) == (pose.name == "P1 settling")
        for (start, end), (first, last) in zip(pose.windows_s, own.windows_s, strict=True):
            part = trajectory.poses[(trajectory.time_s >= max(start, first)) & (trajectory.time_s <= min(end, last)), :3]
            if pose.dither_s is not None:
                assert first == pytest.approx(start, abs=0.4)
                assert last == pytest.approx(end, abs=0.3)
                assert (np.ptp(part, axis=0) > 0.05).all()
    assert sum(len(pose.windows_s) for pose in found.pose if pose.dither_s) == 10


def test_the_command_says_what_swings_bring(tmp_path: Path) -> None:
    box = ["--x", "-100:100", "--y", "-100:100", "--z", "-50:150", "--tests", "pose", "--cycles", "pose=2", "--speeds", "100"]
    rig = ["--rig", TRUTH / "cell-run" / "rig.toml"]
    printed = ran("program", *box, "--dither", "0.05", "--dwell", "2.5", *rig, "--out", tmp_path / "p")
    assert "um at rest, 0." in printed
    assert {p.dither_mm for p in read_program(tmp_path / "p" / "program.toml").pose} == {(0.05, 0.05, 0.05)}
    assert "--rig RIG.toml computes" in ran("program", *box, "--dither", "0.05", "--dwell", "2.5", "--out", tmp_path / "q")
    assert "takes 2.5 s or more" in refused("program", *box, "--dither", "0.05", *rig, "--out", tmp_path / "r")
    assert "at most 0.1 mm" in refused("program", *box, "--dither", "0.2", "--dwell", "2.5", *rig, "--out", tmp_path / "r")
    assert "no test measures a pose" in refused(
        "program", *box, "--tests", "path", "--dither", "0.05", "--dwell", "2.5", "--out", tmp_path / "r", code=2
    )
    with pytest.raises(CertificationError, match="at most"):
        dithered(campaign(Cube(np.zeros(3), 300.0), TESTS), 0.0, TESTS.settle_s)
