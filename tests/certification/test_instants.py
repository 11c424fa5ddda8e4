"""Certificates of trajectories whose time stamps jitter: speeds and times hold it, places and shapes do not feel it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_trajectories import StatedErrors, trajectory_of
from numpy.typing import NDArray

from lmeasure.certification import Characteristic, Settings, evaluate
from lmeasure.certification.figure import Subject
from lmeasure.certification.instants import on_times
from lmeasure.certification.iso9283.velocity import VelocityTest
from lmeasure.findings import recognised
from lmeasure.program import Program
from lmeasure.trajectory import Trajectory
from lmeasure.trajectory.stamps import sound, stamps_of

FloatArray = NDArray[np.float64]

SPEED, NOISE_MM, CYCLES = 250.0, 0.0046, 3
LAW = StatedErrors(np.diag([0.0, 0.0, 0.0, *[NOISE_MM**2] * 3]))


def run(seed: int, jitter_s: float, asked: bool = False) -> tuple[Trajectory, Program]:
    """A line of 300 mm at SPEED, CYCLES times with jumps back between rests, taken every 5 ms - asked: anew 0 to 10 ms after the last -
    and stamped up to jitter_s late."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(2e-4, 0.01, 1500)) if asked else 0.005 * np.arange(1500.0)
    way = np.clip(SPEED * (np.mod(t, 2.4) - 0.5), -10.0, 310.0)
    places = way[:, None] * np.array([0.6, 0.8, 0.0]) + [0.0, 0.0, 5.0] + rng.normal(0.0, NOISE_MM, (len(t), 3))
    stamps = np.sort(t + rng.uniform(0.0, jitter_s, len(t))) if jitter_s else t
    random = np.tile(np.diag([0.0, 0.0, 0.0, *[NOISE_MM**2] * 3]), (len(t), 1, 1))
    windows = [np.interp([2.4 * i + 0.3, 2.4 * i + 2.2], t, stamps).tolist() for i in range(CYCLES)]
    path = {"name": "line", "kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (180.0, 240.0, 0.0), "speed_mm_s": SPEED}
    program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path | {"windows_s": windows}]})
    return replace(trajectory_of(stamps, places), random=random), program


def figures(trajectory: Trajectory, program: Program) -> dict[str, Characteristic]:
    found = evaluate(trajectory, program, LAW, settings=Settings(trials=200, planes=40))
    return {c.name: c for c in found.characteristics}


@pytest.mark.parametrize(("jitter_s", "asked"), [(0.01, False), (0.002, True)])
def test_speeds_lie_within_their_u95(jitter_s: float, asked: bool) -> None:
    inside: dict[str, list[bool]] = {"AV": [], "RV": [], "FV": []}
    for seed in range(12):
        found = figures(*run(seed, jitter_s, asked))
        for name, held in inside.items():
            held.append(abs(found[name].value) <= found[name].u95)
    for held in inside.values():
        assert sum(held) >= 10
    # without the stamps' judgement: off by ten times what is said
    trajectory, program = run(0, jitter_s, asked)
    as_stamped = evaluate(trajectory, program, LAW, settings=Settings(trials=200, planes=40), stamps=sound(trajectory.time_s))
    blind = {c.name: c for c in as_stamped.characteristics}
    assert blind["FV"].value > 10.0 * blind["FV"].u95


def test_places_and_shapes_do_not_feel_stamps() -> None:
    still, jittering = (figures(*run(3, jitter_s)) for jitter_s in (0.0, 0.01))
    for name in ("AT_p", "RT_p"):
        assert jittering[name].value == pytest.approx(still[name].value, abs=6e-3)
        assert jittering[name].u95 == pytest.approx(still[name].u95, rel=0.25)
    assert jittering["AV"].u95 > still["AV"].u95


def test_the_certificate_says_it_in_both_languages() -> None:
    for jitter_s, asked in ((0.01, False), (0.002, True)):
        trajectory, program = run(1, jitter_s, asked)
        notes = evaluate(trajectory, program, LAW, settings=Settings(trials=100, planes=40)).notes
        assert "time stamps jitter" in notes[0]
        found = recognised(notes[0])
        assert found is not None
        assert str(found) == notes[0]
        assert "метки времени дрожат" in found.text("ru")
    assert not evaluate(*run(1, 0.0), LAW, settings=Settings(trials=100, planes=40)).notes


def test_windows_go_with_the_samples() -> None:
    trajectory, program = run(2, 0.01)
    stamps = stamps_of(trajectory)
    moved = on_times(program, stamps)
    for (start, end), (new_start, new_end) in zip(program.path[0].windows_s, moved.path[0].windows_s, strict=True):
        before, after = ((t >= a) & (t <= b) for t, a, b in ((stamps.stamp_s, start, end), (stamps.time_s, new_start, new_end)))
        assert np.abs(np.flatnonzero(before)[[0, -1]] - np.flatnonzero(after)[[0, -1]]).max() <= 1
    assert on_times(program, sound(trajectory.time_s)) is program


def test_times_carry_the_instants() -> None:
    # to and fro between two rests: t_min of 0.48 s, told by two instants of a cycle
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(3e-3, 7e-3, 600))
    way = np.clip(SPEED * (t - 1.2), 0.0, 120.0)
    places = way[:, None] * np.array([1.0, 0.0, 0.0]) + rng.normal(0.0, NOISE_MM, (len(t), 3))
    late = t + rng.uniform(0.0, 0.001, len(t))
    random = np.tile(np.diag([0.0, 0.0, 0.0, *[NOISE_MM**2] * 3]), (len(t), 1, 1))
    poses = [
        {"name": name, "position_mm": (x, 0.0, 0.0), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "windows_s": [window]}
        for name, x, window in (("A", 0.0, (0.2, 1.0)), ("B", 120.0, (2.0, 2.6)))
    ]
    posing = {"from": "A", "to": "B", "limit_band_mm": 0.1, "windows_s": [(0.9, 2.3)]}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": poses, "posing": [posing]})
    trajectory = replace(trajectory_of(late, places), random=random)
    judged, blind = (
        next(c for c in evaluate(trajectory, program, LAW, settings=Settings(trials=200), stamps=s).characteristics if c.name == "t_min")
        for s in (None, sound(late))
    )
    stamps = stamps_of(trajectory)
    assert judged.value == blind.value
    assert judged.u95 == pytest.approx(np.hypot(blind.u95, 1.96 * np.sqrt(2.0) * stamps.u_time_s), rel=1e-3)
    assert abs(judged.value - 119.9 / SPEED) <= judged.u95


def test_the_mean_of_ways_over_times_is_more_than_that_over_the_mean_of_times() -> None:
    """Drawn, each error of an instant with its negative, so that the first order is away."""
    rng, u = np.random.default_rng(5), 1e-3
    time_s = np.cumsum(rng.uniform(0.07, 0.1, (20, 3)), axis=0)
    crossings: Any = SimpleNamespace(time_s=time_s)
    velocity = VelocityTest(
        subject=Subject("path", "line"), crossings=crossings, commanded_mm_s=SPEED, stamps=replace(sound(time_s[:, 0]), u_time_s=u)
    )
    errors = rng.normal(0.0, u, (2000, 20, 3))
    longer = [(np.diff(time_s, axis=0) / np.diff(time_s + sign * errors, axis=1)).mean() - 1.0 for sign in (1.0, -1.0)]
    # of a robot that is three per cent slow
    assert velocity._of_instants(-3.0).bias == pytest.approx(97.0 * np.mean(longer), rel=0.02)
