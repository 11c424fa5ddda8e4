"""Attained paths against commanded ones: planes, deviations, speeds, corners, weaves; figures known from how the motion was made."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from synthetic_paths import CIRCLE, EXACT, LINE, SQUARE, _once, figures, program_of, runs
from synthetic_trajectories import StatedErrors, trajectory_of

from lmeasure.core import CertificationError
from lmeasure.iso9283 import CertificationSettings, Evaluation, evaluate
from lmeasure.iso9283.attainment import attained
from lmeasure.iso9283.clauses.path import PathPart, tests as path_tests
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.paths import Line
from lmeasure.recording import CommandedPath
from lmeasure.trajectory.time.stamps import sound


def test_a_line_with_known_deviations() -> None:
    way = np.arange(-5.0, 505.0, 0.5)
    along, across = np.array([0.6, 0.8, 0.0]), np.array([0.8, -0.6, 0.0])
    ideal = way[:, None] * along
    # two cycles 0.3 and 0.5 mm aside, and 0.2 mm high in the middle
    high = 0.2 * np.exp(-(((way - 250.0) / 50.0) ** 2))[:, None] * np.array([0.0, 0.0, 1.0])
    trajectory, windows = runs(way, [ideal + 0.3 * across + high, ideal + 0.5 * across + high])
    found = figures(trajectory, program_of(LINE, windows), planes=101)
    assert found["AT_p", None] == pytest.approx(np.hypot(0.4, 0.2), abs=1e-4)
    assert found["RT_p", None] == pytest.approx(0.1, abs=1e-9)  # both 0.1 from their middle
    # 0.5 mm in 2 ms, where a hump adds nothing along the line
    assert found["AV", None] == pytest.approx(0.0, abs=1e-9)
    assert found["RV", None] == pytest.approx(0.0, abs=1e-9)
    assert found["FV", None] == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize(("lost_mm", "reported"), [(0.0, False), (4.0, False), (12.0, False), (40.0, True)])
def test_a_part_of_the_way_without_samples_is_reported(lost_mm: float, *, reported: bool) -> None:
    # planes stand 5 mm apart, samples 0.5 mm; in the second cycle samples are missing from 200 mm on
    way = np.arange(-5.0, 505.0, 0.5)
    ideal = way[:, None] * np.array([0.6, 0.8, 0.0])
    trajectory, windows = runs(way, [ideal, ideal])
    second = np.arange(len(trajectory.time_s)) - len(way)
    seen = (second < 0) | (way[second] <= 200.0) | (way[second] >= 200.0 + lost_mm)
    kept = trajectory_of(trajectory.time_s[seen], trajectory.poses[seen, :3])
    path = evaluate(kept, program_of(LINE, windows), EXACT, settings=CertificationSettings(trials=10)).paths[0]
    if reported:
        assert path.unseen == "cycle 2: there are no samples from 2.86 to 3.02 s, on 40 mm of the path"
    else:
        assert path.unseen is None


def test_speeds_of_a_line() -> None:
    # cycle 1 at 245 and 255 mm/s by turns, cycle 2 at 260 throughout
    rate, length = 500.0, 520.0
    one = np.cumsum(np.concatenate([[0.0], np.where((np.arange(1100) // 100) % 2 == 0, 245.0, 255.0) / rate])) - 10.0
    two = np.arange(1101) * 260.0 / rate - 10.0
    along = np.array([0.6, 0.8, 0.0])
    trajectory, windows = runs(one, [np.minimum(w, length)[:, None] * along for w in (one, two)], rate)
    found = evaluate(trajectory, program_of(LINE, windows), EXACT, settings=CertificationSettings(trials=10, planes=50))
    value = {c.name: c.value for c in found.characteristics}
    speed = found.paths[0].speed_mm_s
    assert speed.shape == (2, 49)
    assert value["FV"] == pytest.approx(10.0, abs=0.2)
    means = speed[:, 12:37].mean(axis=1)
    assert value["AV"] == pytest.approx(100.0 * (means.mean() / 250.0 - 1.0))
    assert value["RV"] == pytest.approx(300.0 * means.std(ddof=1) / 250.0)
    assert means[1] == pytest.approx(260.0, abs=1e-6)


def test_a_circle_with_another_radius_and_centre() -> None:
    turn = np.linspace(-0.05, 2 * np.pi + 0.05, 3000)
    circle = np.column_stack([10.0 + 100.4 * np.cos(turn), 20.0 + 100.4 * np.sin(turn), np.full(len(turn), 30.3)])
    trajectory, windows = runs(turn, [circle])
    found = figures(trajectory, program_of(CIRCLE, windows))
    assert found["AT_p", None] == pytest.approx(0.5, abs=1e-4)
    assert ("RT_p", None) not in found


def test_speeds_are_those_in_the_middle_of_the_lines() -> None:
    fine = np.arange(-10.0, 810.0, 0.1)
    from_corner = (fine + 100.0) % 200.0 - 100.0
    seconds = np.cumsum(0.1 / (100.0 * (1.0 - 0.8 * np.exp(-((from_corner / 10.0) ** 2)))))
    way = np.interp(np.arange(seconds[0], seconds[-1], 5e-3), seconds, fine)
    points = np.array([[-10.0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0], [0, -10, 0]])
    place = np.column_stack([np.interp(way, [-10.0, 200.0, 400.0, 600.0, 810.0], points[:, i]) for i in range(3)])
    found = figures(*_once(way, place, SQUARE | {"speed_mm_s": 100.0}, 200.0))
    assert found["AV", None] == pytest.approx(0.0, abs=0.01)
    assert found["FV", None] == pytest.approx(0.0, abs=0.05)


def test_level_speeds_of_several_lines_are_likely_level() -> None:
    way = np.arange(0.0, 810.0, 0.5)
    points = np.array([[0.0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0], [0, -10, 0]])
    place = np.column_stack([np.interp(way, [0.0, 200.0, 400.0, 600.0, 810.0], points[:, i]) for i in range(3)])
    rng = np.random.default_rng(6)
    trajectory, windows = runs(way, [place + 0.005 * rng.normal(size=place.shape) for _ in range(5)])
    program, law = program_of(SQUARE | {"speed_mm_s": 250.0}, windows), StatedErrors(np.diag([0.0, 0.0, 0.0, 25e-6, 25e-6, 25e-6]))
    (test,) = path_tests(attained(trajectory, program, CertificationSettings(), sound(trajectory.time_s), rig_angles=None))
    part = test.parts(lambda samples: law.at(trajectory, samples)[0])[Subject("path", "square")]
    measured, likely = (part.state(np.zeros((len(part.errors), 6)), reduced).speed_mm_s for reduced in (False, True))
    assert np.ptp(likely) < 1e-3 * np.ptp(measured)
    assert likely.mean() == pytest.approx(measured.mean(), rel=1e-9)


def test_uneven_times_do_not_make_deviations() -> None:
    rng = np.random.default_rng(4)
    way = np.arange(-5.0, 505.0, 0.5)
    place = way[:, None] * np.array([0.6, 0.8, 0.0]) + 0.005 * rng.normal(size=(len(way), 3))
    trajectory, windows = runs(way, [place])
    late = trajectory.time_s.copy()
    # samples stamped in pairs
    late[1::2] = late[:-1:2] + 5e-5
    random = np.diag([0.0, 0.0, 0.0, 25e-6, 25e-6, 25e-6])
    even, paired = (
        evaluate(
            t, program_of(LINE, windows), StatedErrors(random, rounded=True), settings=CertificationSettings(trials=50)
        ).characteristics
        for t in (trajectory, replace(trajectory, time_s=late))
    )
    (one,), (other,) = ([c for c in found if c.name == "AT_p"] for found in (even, paired))
    assert other.value == pytest.approx(one.value, rel=0.5)
    assert other.u95 == pytest.approx(one.u95, rel=0.2)


@pytest.mark.parametrize("begun_deg", [0.0, 90.0, -170.0])
def test_orientation_along_a_path_that_turns(begun_deg: float) -> None:
    way = np.arange(-5.0, 505.0, 0.5)
    ideal = way[:, None] * np.array([0.6, 0.8, 0.0])
    turn = np.array([0.0, 0.0, 1.0]) * (0.4 * np.clip(way / 500.0, 0, 1) + np.radians(begun_deg + 0.25))[:, None]
    time_s = np.arange(len(way)) / 500.0
    trajectory = trajectory_of(time_s, ideal, turn)
    half = np.radians(begun_deg) / 2.0
    begun, ended = ((0.0, 0.0, float(np.sin(a)), float(np.cos(a))) for a in (half, half + 0.2))
    turning = {"quaternion_xyzw": begun, "end_quaternion_xyzw": ended}
    program = program_of(LINE | turning, [(time_s[0], time_s[-1])])
    found = evaluate(trajectory, program, EXACT, settings=CertificationSettings(trials=10, angles="kuka-abc"))
    value = {c.name: c for c in found.characteristics}
    assert value["AT_p"].clause == "8.4"
    assert value["AT_a"].value == pytest.approx(0.25, abs=1e-6)
    assert value["AT_a"].angles == "kuka-abc"
    assert value["AT_rot"].extension
    assert value["AT_rot"].value == pytest.approx(0.25, abs=1e-6)


def test_a_line_that_comes_near_itself_is_followed() -> None:
    path = CommandedPath.model_validate(
        {"name": "hairpin", "kind": "points", "points_mm": ((0.0, 0, 0), (100.0, 0, 0), (100.0, 2, 0), (0.0, 2, 0))}
    )
    line = Line(path)
    points = path.points(0.5)
    way = line.way(points + np.array([0.0, 0.0, 0.3]))
    np.testing.assert_allclose(way, np.linspace(0.0, 202.0, len(points)), atol=0.6)
    np.testing.assert_allclose(line.at(np.array([50.0, 101.0]))[0], [[50.0, 0, 0], [100.0, 1.0, 0]])
    np.testing.assert_allclose(line.at(np.array([50.0, 101.0]))[1], [[1.0, 0, 0], [0.0, 1.0, 0]])


@pytest.mark.parametrize(
    ("window", "said"),
    [
        ((0.2, 2.036), "begins 45 mm along the path. The window must contain its start"),
        ((0.0, 1.9), "ends 470 mm along the path, before its end"),
        ((0.0, 0.02), "has 11 samples. At least 20"),
        ((5.0, 6.0), "no sample within"),
    ],
)
def test_windows_that_do_not_hold_the_path(window: tuple[float, float], said: str) -> None:
    way = np.arange(-5.0, 505.0, 0.5)
    trajectory, _ = runs(way, [way[:, None] * np.array([0.6, 0.8, 0.0])])
    with pytest.raises(CertificationError, match=said) as caught:
        figures(trajectory, program_of(LINE, [window]))
    assert str(caught.value).startswith("path line, cycle 1: ")


def test_a_path_run_backwards_is_refused() -> None:
    way = np.arange(-5.0, 505.0, 0.5)[::-1]
    trajectory, windows = runs(way, [way[:, None] * np.array([0.6, 0.8, 0.0])])
    with pytest.raises(CertificationError, match="runs backwards"):
        figures(trajectory, program_of(LINE, windows))


def uncertain(errors: StatedErrors) -> Evaluation:
    """Ten cycles of a line with 0.05 mm of scatter and 1 mm aside, under a law of errors."""
    rng = np.random.default_rng(4)
    way = np.arange(-5.0, 505.0, 0.5)
    ideal = way[:, None] * np.array([0.6, 0.8, 0.0]) + np.array([0.8, -0.6, 0.0])
    trajectory, windows = runs(way, [ideal + 0.05 * rng.normal(size=3) for _ in range(10)])
    return evaluate(trajectory, program_of(LINE, windows), errors, settings=CertificationSettings(trials=2000))


def test_an_error_shared_by_the_run_moves_accuracy_alone() -> None:
    shared = np.zeros((6, 3))
    shared[3:] = 0.01 * np.eye(3)
    found = {c.name: c for c in uncertain(StatedErrors(shared=shared)).characteristics}
    # across the path, in the direction of the deviation: 0.01 mm
    assert found["AT_p"].u95 == pytest.approx(1.96 * 0.01, rel=0.06)
    assert found["AT_p"].u_systematic == pytest.approx(0.01, rel=0.06)
    assert found["AT_p"].u_random == 0.0
    for name in ("RT_p", "AV", "RV", "FV"):
        assert found[name].u95 < 1e-9


def test_an_error_along_the_path_moves_times_by_what_the_robot_needs_there() -> None:
    # from half way on half as fast: a robot that is seen 0.05 mm ahead slows down 0.05 mm later
    seconds = np.arange(0.0, 4.2, 2e-3)
    way = np.interp(seconds, [0.0, 1.3, 4.2], [-10.0, 250.0, 540.0])
    along = np.array([0.6, 0.8, 0.0])
    deviating = 0.2 * np.sin(way / 40.0)[:, None] * np.array([0.0, 0.0, 1.0])
    path, shared = LINE | {"speed_mm_s": 200.0}, np.zeros((6, 1))
    shared[3:, 0] = 0.05 * along

    def found(shift_mm: float, law: StatedErrors) -> dict[str, Any]:
        trajectory, windows = runs(way, [(way + 0.02 * k + shift_mm)[:, None] * along + deviating for k in range(2)])
        evaluation = evaluate(
            trajectory, program_of(path, windows), law, settings=CertificationSettings(trials=500 if law is not EXACT else 1, planes=40)
        )
        return {c.name: c for c in evaluation.characteristics}

    at, ahead, behind = (found(shift, EXACT) for shift in (0.0, 0.05, -0.05))
    stated = found(0.0, StatedErrors(shared=shared))
    u = 0.5 * abs(ahead["AV"].value - behind["AV"].value)
    assert u > 0.005
    assert stated["AV"].u_systematic == pytest.approx(u, rel=0.1)
    assert stated["AV"].u95 == pytest.approx(1.96 * u, rel=0.1)
    assert at["AV"].u95 == 0.0


@pytest.mark.parametrize("samples", [600, 120])
def test_velocities_are_those_of_just_the_middle_half(samples: int) -> None:
    """A robot that speeds up to the middle of the line and slows down behind it is slowest where the half begins and ends."""
    rate = 250.0**2 / (2.0 * 270.0)
    half = np.sqrt(2.0 * 270.0 / rate)
    seconds = np.linspace(np.sqrt(20.0 / rate), 2.0 * half - np.sqrt(20.0 / rate), samples)
    way = np.where(seconds < half, 0.5 * rate * seconds**2 - 20.0, 520.0 - 0.5 * rate * (2.0 * half - seconds) ** 2)
    along = np.array([0.6, 0.8, 0.0])
    trajectory, windows = runs(way, [way[:, None] * along], float(1.0 / (seconds[1] - seconds[0])))
    found = {
        c.name: c.value
        for c in evaluate(
            trajectory, program_of(LINE | {"speed_mm_s": 250.0}, windows), EXACT, settings=CertificationSettings(trials=1)
        ).characteristics
    }
    # the mean of v = sqrt(2 rate (s + 20)) from 125 to 250 mm
    mean = np.sqrt(2.0 * rate) * (270.0**1.5 - 145.0**1.5) / 1.5 / 125.0
    assert found["AV"] == pytest.approx(100.0 * (mean - 250.0) / 250.0, abs=0.03)
    assert found["FV"] == pytest.approx(250.0 - np.sqrt(2.0 * rate * 145.0), rel=0.08)


def test_an_error_of_each_sample_moves_all() -> None:
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.01**2 * np.eye(3)
    found = {c.name: c for c in uncertain(StatedErrors(random)).characteristics}
    # mean over ten cycles, the largest of a hundred planes
    assert 0.01 / np.sqrt(10) < found["AT_p"].u95 < 6 * 0.01 / np.sqrt(10)
    # v = (s_b - s_a) / t over the middle 250 mm: errors of two ends, mean of ten cycles
    assert found["AV"].u95 == pytest.approx(100.0 * 1.96 * np.sqrt(2.0) * 0.01 / 250.0 / np.sqrt(10), rel=0.1)
    assert found["FV"].u95 > 0.1


@pytest.mark.parametrize(
    ("stretch", "middle"),
    [
        ([0] * 9, [2, 3, 4, 5]),
        ([0] * 5 + [1] * 9 + [2] * 3, [1, 2, 7, 8, 9, 10, 14, 15]),
        # a path that turns at every plane has no line: then all of it counts
        ([0, 1, 2, 3], [0, 1, 2]),
        ([0, 0], [0]),
    ],
)
def test_the_middle_of_a_path_is_half_of_each_of_its_lines(stretch: list[int], middle: list[int]) -> None:
    """Pieces from plane to plane within one line, without a quarter of them at either end."""
    part = SimpleNamespace(crossings=SimpleNamespace(stretch=np.array(stretch)))
    found: Any = PathPart.__dict__["_middle"].fget(part)
    assert found.tolist() == middle
