"""Certificates of trajectories whose time stamps jitter: speeds and times hold it, places and shapes do not feel it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from synthetic_trajectories import StatedErrors, trajectory_of

from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.iso9283.characteristic import Characteristic, Contribution
from lmeasure.iso9283.clauses.velocity import VelocityTest
from lmeasure.iso9283.figure import OfInstants, Subject
from lmeasure.iso9283.uncertainty import most_planes, of_crossing, of_duration, on_times, with_instants
from lmeasure.recording import Program
from lmeasure.text import Message
from lmeasure.trajectory import PoseErrors, Trajectory, stamps_of
from lmeasure.trajectory.time.stamps import sound

SPEED, NOISE_MM, CYCLES = 250.0, 0.0046, 3
LAW = StatedErrors(np.diag([0.0, 0.0, 0.0, *[NOISE_MM**2] * 3]))


def run(seed: int, jitter_s: float, requested: bool = False, walk_s: float = 0.0) -> tuple[Trajectory, Program]:
    """A line of 300 mm at SPEED between ramps, CYCLES times with jumps back between rests, taken every 5 ms - asked: anew 0 to 10 ms after
    the last - and stamped up to jitter_s late, or with intervals of the stamps that err by walk_s and add up."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(2e-4, 0.01, 1500)) if requested else 0.005 * np.arange(1500.0)
    since = np.clip(np.mod(t, 2.4) - 0.4, 0.0, 1.4)
    ramp = 5.0 * SPEED * np.minimum(np.minimum(since, 1.4 - since), 0.1) ** 2
    way = np.where(since < 0.1, ramp, np.where(since > 1.3, 325.0 - ramp, SPEED * (since - 0.05))) - 12.5
    places = way[:, None] * np.array([0.6, 0.8, 0.0]) + [0.0, 0.0, 5.0] + rng.normal(0.0, NOISE_MM, (len(t), 3))
    stamps = np.sort(t + rng.uniform(0.0, jitter_s, len(t))) if jitter_s else t
    stamps = np.cumsum(rng.normal(0.005, walk_s, len(t)).clip(5e-5)) if walk_s else stamps
    random = np.tile(np.diag([0.0, 0.0, 0.0, *[NOISE_MM**2] * 3]), (len(t), 1, 1))
    windows = [np.interp([2.4 * i + 0.3, 2.4 * i + 2.2], t, stamps).tolist() for i in range(CYCLES)]
    path = {"name": "line", "kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (180.0, 240.0, 0.0), "speed_mm_s": SPEED}
    program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path | {"windows_s": windows}]})
    return replace(trajectory_of(stamps, places), random=random), program


def figures(trajectory: Trajectory, program: Program) -> dict[str, Characteristic]:
    found = evaluate(trajectory, program, LAW, settings=CertificationSettings(trials=200, planes=40))
    return {c.name: c for c in found.characteristics}


@pytest.mark.parametrize(("jitter_s", "requested", "walk_s"), [(0.01, False, 0.0), (0.002, True, 0.0), (0.0, False, 0.004)])
def test_speeds_lie_within_their_u95(jitter_s: float, requested: bool, walk_s: float) -> None:
    inside: dict[str, list[bool]] = {"AV": [], "RV": [], "FV": []}
    fluctuation = []
    for seed in range(12):
        found = figures(*run(seed, jitter_s, requested, walk_s))
        for name, held in inside.items():
            held.append(abs(found[name].value) <= found[name].u95)
        fluctuation.append([found["FV"].value, found["FV"].u95])
    for held in inside.values():
        assert sum(held) >= 11
    # nor is it only wide: errors alone make up the value, which is none in truth
    value, u95 = np.array(fluctuation).T
    assert np.median(u95) < 2.0 * value.max()


@pytest.mark.parametrize(("jitter_s", "requested"), [(0.01, False), (0.002, True)])
def test_without_the_stamps_judgement_cycles_differ_by_many_times_their_u95(jitter_s: float, requested: bool) -> None:
    trajectory, program = run(0, jitter_s, requested)
    found = evaluate(trajectory, program, LAW, settings=CertificationSettings(trials=200, planes=40), stamps=sound(trajectory.time_s))
    speeds = next(c for c in found.characteristics if c.name == "RV")
    assert speeds.value > 5.0 * speeds.u95


def test_places_and_shapes_do_not_feel_stamps() -> None:
    still, jittering = (figures(*run(3, jitter_s)) for jitter_s in (0.0, 0.01))
    for name in ("AT_p", "RT_p"):
        assert jittering[name].value == pytest.approx(still[name].value, abs=6e-3)
        assert jittering[name].u95 == pytest.approx(still[name].u95, rel=0.25)
    assert jittering["AV"].u95 > still["AV"].u95


def test_the_certificate_says_it_in_both_languages() -> None:
    for jitter_s, requested in ((0.01, False), (0.002, True)):
        trajectory, program = run(1, jitter_s, requested)
        notes = evaluate(trajectory, program, LAW, settings=CertificationSettings(trials=100, planes=40)).notes
        assert "time stamps are irregular" in notes[0]
        assert isinstance(notes[0], Message)
        assert "метки времени неровны" in notes[0].text("ru")
    assert not evaluate(*run(1, 0.0), LAW, settings=CertificationSettings(trials=100, planes=40)).notes


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
        next(
            c
            for c in evaluate(trajectory, program, LAW, settings=CertificationSettings(trials=200), stamps=s).characteristics
            if c.name == "t_min"
        )
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


def test_every_window_goes_with_the_samples_and_as_far_beyond_them_as_it_was() -> None:
    """Of poses, of their settling, of paths, moves and loads; between two samples in proportion."""
    stamps = replace(sound(np.array([10.0, 11.0, 12.0, 13.0])), kind="even", stamp_s=np.array([10.5, 11.5, 12.7, 13.1]))
    before, after = (9.5, 12.1), (9.0, 11.5)
    later, moved = (13.1, 14.6), (13.0, 14.5)
    end = {"position_mm": (0.0, 0.0, 0.0), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "limit_band_mm": 1.0}
    program = Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": [{"name": "A", **end, "windows_s": [before], "settling_s": [later]}, {"name": "B", **end, "windows_s": [later]}],
            "path": [{"name": "line", "kind": "linear", "start_mm": (0, 0, 0), "end_mm": (1, 0, 0), "windows_s": [before]}],
            "posing": [{"from": "A", "to": "B", "limit_band_mm": 1.0, "windows_s": [later]}],
            "compliance": [{"pose": "A", "windows_s": [before], "force_n": [(1.0, 0.0, 0.0)]}],
        }
    )
    found = on_times(program, stamps)
    first, last = (pytest.approx(window, abs=1e-12) for window in (after, moved))
    assert [list(p.windows_s) for p in found.pose] == [[first], [last]]
    assert list(found.pose[0].settling_s) == [last]
    assert [p.windows_s[0] for p in (found.path[0], found.posing[0], found.compliance[0])] == [first, last, first]
    assert on_times(program, replace(stamps, kind="sound")) is program


def test_planes_that_instants_allow_are_ten_of_their_uncertainties_apart() -> None:
    stamps = replace(sound(np.arange(3.0)), u_time_s=0.01)
    assert [most_planes(stamps, seconds) for seconds in (0.099, 0.101, 2.05, 5.0)] == [0, 1, 20, 50]
    assert most_planes(sound(np.arange(3.0)), 1.0) > 10**9


def test_instants_that_err_are_places_that_err_along_the_path() -> None:
    """Anew at every crossing, and by a rate that all have in common, in proportion to the time since the middle of its cycle."""
    rng, m, n = np.random.default_rng(6), 4, 3
    time_s, pace = np.cumsum(rng.uniform(0.5, 1.0, (m, n)), axis=0), rng.uniform(100.0, 200.0, (m, n))
    tangent = rng.normal(size=(m, 3))
    crossed: Any = SimpleNamespace(time_s=time_s, pace_mm_s=pace, tangent=tangent)
    places = PoseErrors.of(rng.normal(size=(m * n, 6, 2)), rng.normal(size=(m * n, 6, 1)))
    stamps = replace(sound(np.arange(3.0)), kind="even", u_time_s=1e-3, u_rate=1e-4)
    found = of_crossing(places, crossed, stamps)
    weights = rng.normal(size=m * n)
    by_instants = found.covariance_of(weights[None])[0] - places.covariance_of(weights[None])[0]
    # the two laws written out: dt of each crossing, and one rate
    way = np.zeros((m * n, 6))
    way[:, 3:] = (tangent[:, None] * pace[:, :, None]).reshape(-1, 3)
    since = (time_s - time_s.mean(axis=0)).ravel()
    common = (weights * since) @ way * 1e-4
    expected = 1e-6 * np.einsum("k,ki,kj->ij", weights**2, way, way) + np.outer(common, common)
    np.testing.assert_allclose(by_instants, expected, rtol=1e-6, atol=1e-12)
    assert of_crossing(places, crossed, replace(stamps, kind="sound")) is places


def test_a_duration_errs_by_both_ends_of_its_cycles_and_by_the_rate() -> None:
    figure = Characteristic(name="t_s", clause="7.4", value=2.0, unit="s", u95=0.03, capable=False, cycles=5).with_budget(
        (Contribution("counts", 0.01, random=True), Contribution("calibration", 0.004)), 0.03
    )
    stamps = replace(sound(np.arange(3.0)), kind="even", u_time_s=0.006, u_rate=1e-3)
    added = np.hypot(np.sqrt(2.0 / 5.0) * 0.006, 2e-3)
    for value in (2.0, -2.0):
        found = of_duration(replace(figure, value=value), stamps)
        assert found.u95 == pytest.approx(np.hypot(0.03, 1.959964 * added), rel=1e-6)
        assert (found.value, found.u_random) == (value, 0.01)
        assert found.u_systematic == pytest.approx(np.hypot(0.004, added))
        assert found.coverage_factor == pytest.approx(found.u95 / np.sqrt(0.01**2 + 0.004**2 + added**2))
    assert of_duration(figure, sound(np.arange(3.0))) is figure
    exact = figure.with_budget((), 0.0)
    assert with_instants(exact, OfInstants(0.0)).coverage_factor is None
    biased = with_instants(exact, OfInstants(0.01, 0.002))
    assert [biased.u95, biased.u_systematic] == pytest.approx([1.959964 * 0.01 + 0.002, 0.01], rel=1e-6)
