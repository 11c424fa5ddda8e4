"""Corners and weaves of attained paths: cut, overshot, read between samples, with the U95 of an overshoot and of a weave."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from honest import assert_honest
from synthetic_paths import CIRCLE, EXACT, LINE, SQUARE, _once, figures, program_of, runs
from synthetic_trajectories import UNIT, StatedErrors, trajectory_of

from lmeasure.core import CertificationError, FloatArray
from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.iso9283.clauses.corners import Corner, at_corner
from lmeasure.iso9283.clauses.weaving import Weave, WeavePart
from lmeasure.iso9283.paths import Cycle, Line
from lmeasure.recording import CommandedPath, Program


def test_corners_cut_and_overshot() -> None:
    # corner 1 is cut by a chord 3 mm before to 3 mm behind it; corner 2 is overshot by 2 mm and regained 10 mm behind; corner 3 is met
    points = np.array([[-10.0, 0, 0], [197, 0, 0], [200, 3, 0], [200, 202, 0], [190, 200, 0], [0, 200, 0], [0, -10, 0]])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    way = np.arange(0.0, arc[-1], 0.1)
    place = np.column_stack([np.interp(way, arc, points[:, i]) for i in range(3)])
    trajectory, windows = runs(way, [place, place])
    found = figures(trajectory, program_of(SQUARE | {"stabilisation_mm": 0.5}, windows))
    assert found["CR", "corner 1"] == pytest.approx(3.0 / np.sqrt(2.0), abs=0.02)
    # cubics swing by up to a twentieth of a step at a kink
    assert found["CO", "corner 1"] == pytest.approx(0.0, abs=5e-3)
    assert found["CR", "corner 2"] == pytest.approx(0.0, abs=0.06)
    assert found["CO", "corner 2"] == pytest.approx(2.0, abs=0.06)
    # deviation falls from 2 to 0 over 10 mm: 0.5 is left 7.5 mm behind
    assert found["SPL", "corner 2"] == pytest.approx(7.5, abs=0.1)
    assert found["SPL", "corner 3"] == pytest.approx(0.0, abs=1e-3)
    # within 1.9 mm it is back at once, half a millimetre behind
    assert figures(trajectory, program_of(SQUARE | {"stabilisation_mm": 1.9}, windows))["SPL", "corner 2"] == pytest.approx(0.5, abs=0.1)
    assert found["CO", "corner 3"] == pytest.approx(0.0, abs=5e-3)
    outside = replace(trajectory, worst_pressure_angle_deg=np.full(len(trajectory.time_s), 70.0))
    every = evaluate(outside, program_of(SQUARE | {"stabilisation_mm": 0.5}, windows), EXACT, settings=CertificationSettings(trials=10))
    assert all(c.excluded is not None and not c.capable for c in every.characteristics)
    # a cycle that runs a millimetre above the path never comes back to it
    trajectory, windows = runs(way, [place, place + [0.0, 0.0, 1.0]])
    above = evaluate(trajectory, program_of(SQUARE | {"stabilisation_mm": 0.5}, windows), EXACT, settings=CertificationSettings(trials=10))
    assert not [c for c in above.characteristics if c.name == "SPL"]
    assert [note for note in map(str, above.notes) if "half way" in note] == [
        f"path square, cycle 2: after corner {i}, the robot is not within 0.5 mm half way to the next" for i in (1, 2, 3)
    ]


def test_a_path_that_ends_at_its_corner_has_come_to_it() -> None:
    """Nothing lies behind the last sample, and the step to it is that of the others."""
    way = np.arange(-90.0, 1.0, 1.5)
    corner = Corner(1, np.array([10.0, 20.0, 30.0]), np.eye(3)[0], np.eye(3)[1], way_mm=100.0, before_mm=300.0, after_mm=200.0)
    poses = np.column_stack([10.0 + way, np.full(len(way), 20.0), np.full(len(way), 30.5), np.tile(UNIT, (len(way), 1))])
    found = at_corner(Cycle(np.arange(len(way)), way / 250.0, poses, 100.0 + way), corner, "path square, cycle 1")
    assert found.step_mm == pytest.approx(1.5)
    np.testing.assert_allclose(found.nearest, [0.0, 0.0, 0.5], atol=1e-9)
    assert found.behind == slice(len(way) - 2, len(way))
    np.testing.assert_allclose(found.beyond, [-1.5, 0.0], atol=1e-9)
    short = Cycle(np.arange(1), way[-1:], poses[-1:], way[-1:] + 100.0)
    with pytest.raises(
        CertificationError, match=r"^path square, cycle 1: has 1 sample within half a side of corner 1. At least 2 are needed$"
    ):
        at_corner(short, corner, "path square, cycle 1")


def some_weave(y: FloatArray, width: int) -> Weave:
    """Rows y (4, k) about the farthest places of two strokes along x and of all; the middle is crossed half way between samples."""
    none, side = np.zeros((2, 2, 3)), np.array([1.0, -1.0, 1.0, -1.0])
    return Weave(
        direction=np.eye(3)[0], samples=np.zeros(y.shape, np.int64), positions=np.zeros((*y.shape, 3)), y=y, width=width, side=side,
        edges=np.zeros((2, 2), np.int64), edge_positions=none, edge_y=np.array([[-1.0, 1.0], [1.0, -1.0]]),
        edge_s=np.array([[0.0, 1.0], [2.0, 3.0]]),
    )  # fmt: skip


@pytest.mark.parametrize("reduced", [False, True])
def test_the_farthest_of_a_stroke_is_looked_for_on_either_side(reduced: bool) -> None:
    """As far as it may be in truth, and no farther."""
    errors: Any = None
    i, peaks = np.arange(15), np.array([13.5, 0.5, 7.0, 7.25])[:, None]
    y = np.array([1.0, -1.0, 1.0, -1.0])[:, None] * (10.0 - 0.1 * (i - peaks) ** 2)
    far, times = WeavePart((some_weave(y, 7),), errors).state(np.zeros((64, 6)), reduced)
    np.testing.assert_allclose(far[0], [10.0, -10.0, 10.0, -10.0], atol=1e-9)
    np.testing.assert_allclose(times[0], [0.5, 2.5])
    narrow = some_weave(np.tile(np.arange(-3.0, 4.0), (4, 1)), 1)
    far, _ = WeavePart((narrow,), errors).state(np.zeros((32, 6)), reduced)
    np.testing.assert_allclose(far[0], [1.0, -1.0, 1.0, -1.0], atol=1e-9)


def test_what_lies_between_samples_is_read() -> None:
    # a circle of 50 mm in steps of 2.5: between them a chord is 16 um inside
    way = np.arange(-10.0, 325.0, 2.5)
    small = CIRCLE | {"radius_mm": 50.0, "start_mm": (60.0, 20.0, 30.0), "normal": (0.0, 0.0, 1.0), "speed_mm_s": 500.0}
    place = np.array([10.0, 20.0, 30.0]) + 50.0 * np.column_stack([np.cos(way / 50.0), np.sin(way / 50.0), np.zeros(len(way))])
    found = figures(*_once(way, place, small, 200.0))
    assert found["AT_p", None] < 1e-4
    assert found["FV", None] < 1e-4
    # a corner taken along a circle of 8 mm, in steps of a millimetre from anywhere
    for begin in (0.0, 0.3, 0.6):
        way = np.arange(-10.0 + begin, 195.0 + 4.0 * np.pi + 8.0, 1.0)
        turn = np.clip((way - 192.0) / 8.0, 0.0, np.pi / 2)
        place = np.column_stack([np.minimum(way, 192.0) + 8.0 * np.sin(turn), 8.0 - 8.0 * np.cos(turn), 0.0 * way])
        place[:, 1] += np.maximum(way - 192.0 - 4.0 * np.pi, 0.0)
        bent = {"name": "bent", "kind": "points", "points_mm": [(0.0, 0.0, 0.0), (200.0, 0.0, 0.0), (200.0, 11.0, 0.0)]}
        assert figures(*_once(way, place, bent, 200.0))["CR", "corner 1"] == pytest.approx(8.0 * (np.sqrt(2.0) - 1.0), abs=2e-3)
    # a weave of eleven samples
    way = np.arange(-5.0, 205.0, 0.9)
    place = np.column_stack([way, 4.0 * np.sin(2 * np.pi * way / 10.0), np.zeros(len(way))])
    path = {"name": "w", "kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (200.0, 0.0, 0.0), "weave_stroke_mm": 8.0}
    assert figures(*_once(way, place, path | {"weave_distance_mm": 10.0}, 100.0))["WS", None] == pytest.approx(0.0, abs=0.2)


def test_nothing_is_read_round_a_corner() -> None:
    points = np.array([[-10.0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0], [0, -10, 0]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for step in (1.0, 3.7):
        way = np.arange(0.0, arc[-1], step)
        place = np.column_stack([np.interp(way, arc, points[:, i]) for i in range(3)])
        found = figures(*_once(way, place, SQUARE | {"speed_mm_s": 100.0 * step}, 100.0))
        assert found["AT_p", None] == pytest.approx(0.0, abs=1e-9)
        assert found["FV", None] == pytest.approx(0.0, abs=1e-6)
        assert found["CO", "corner 2"] == pytest.approx(0.0, abs=1e-9)


def test_no_plane_stands_at_a_corner() -> None:
    square = Line(CommandedPath.model_validate(SQUARE))
    np.testing.assert_allclose(square.planes(16), np.arange(25.0, 800.0, 50.0))
    # thirty in four equal sides: eight each, 12.5 mm from the corners
    np.testing.assert_allclose(square.planes(30)[[0, 7, 8, -1]], [12.5, 187.5, 212.5, 787.5])
    assert len(Line(CommandedPath.model_validate(LINE)).planes(30)) == 30
    # of each line's planes two at its quarters, between which velocities are taken
    for number, each in ((102, 26), (100, 22), (30, 6)):
        ways = square.planes(number, quarters=True)
        assert len(ways) == 4 * each
        assert {50.0, 150.0, 250.0, 350.0, 450.0, 550.0, 650.0, 750.0} <= set(np.round(ways, 9))
    np.testing.assert_allclose(square.planes(16, quarters=True), square.planes(16))
    zigzag = {"name": "z", "kind": "points", "points_mm": [(10.0 * i, 3.0 * (i % 2), 0.0) for i in range(30)]}
    assert len(Line(CommandedPath.model_validate(zigzag)).planes(10)) == 29


def test_a_fitted_frame_takes_corners_and_weaves_along() -> None:
    way = np.arange(-5.0, 205.0, 0.1)
    weave = np.column_stack([way, 4.0 * np.sin(2 * np.pi * way / 10.0), np.zeros(len(way))])
    corners = np.array([[-10.0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0], [0, -10, 0]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    around = np.column_stack([np.interp(np.arange(0.0, arc[-1], 0.1), arc, corners[:, i]) for i in range(3)])
    places = np.array([[0.0, 0.0, 0.0], [200.0, 0.0, 0.0], [0.0, 200.0, 0.0]])
    pieces = [*(np.tile(p, (300, 1)) for p in places), weave, around]
    ends = np.cumsum([len(p) for p in pieces])
    time_s = np.arange(ends[-1]) / 1000.0
    windows = [(time_s[b - len(p)], time_s[b - 1]) for p, b in zip(pieces, ends, strict=True)]
    line = {"kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (200.0, 0.0, 0.0), "speed_mm_s": 100.0}
    program = Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": [
                {"name": f"P{i}", "position_mm": tuple(p), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "windows_s": [windows[i]]}
                for i, p in enumerate(places)
            ],
            "path": [
                line | {"name": "w", "weave_stroke_mm": 8.0, "weave_distance_mm": 10.0, "windows_s": [windows[3]]},
                SQUARE | {"windows_s": [windows[4]]},
            ],
        }
    )
    # a displacement of everything moves the frame that is fitted to the poses, and no figure in it
    shared = np.zeros((6, 3))
    shared[3:] = 0.5 * np.eye(3)
    found = evaluate(
        trajectory_of(time_s, np.concatenate(pieces)), program, StatedErrors(shared=shared), settings=CertificationSettings(align=True)
    )
    names = {c.name for c in found.characteristics}
    assert {"CR", "CO", "WS", "WF", "AT_p"} <= names
    # but for a sharp corner, which lies anywhere between two samples
    assert max(c.u95 for c in found.characteristics if c.path != "square") < 1e-4


def test_the_u95_of_a_weave_holds_what_it_says() -> None:
    way = np.arange(-5.0, 105.0, 0.2)
    path = {"name": "w", "kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (100.0, 0.0, 0.0), "speed_mm_s": 100.0}
    path |= {"weave_stroke_mm": 8.0, "weave_distance_mm": 10.0}
    place = np.column_stack([way, 4.0 * np.sin(2 * np.pi * way / 9.73), np.zeros(len(way))])
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.005**2 * np.eye(3)
    trajectory, windows = runs(way, [place, place])
    program = program_of(path, windows)
    true = figures(trajectory, program)
    ratios = []
    for seed in range(24):
        noisy = trajectory.poses.copy()
        noisy[:, :3] += 0.005 * np.random.default_rng(seed).normal(size=(len(noisy), 3))
        found = evaluate(
            replace(trajectory, poses=noisy), program, StatedErrors(random), settings=CertificationSettings(trials=200, planes=20)
        )
        ratios.append([(c.value - true[c.name, None]) / c.u95 for c in found.characteristics if c.name in ("WS", "WF")])
        ws = next(c for c in found.characteristics if c.name == "WS")
        assert ws.u95 < 0.12  # 0.005 mm by which the largest of noisy samples are larger, at both ends of a stroke
    stroke, frequency = np.transpose(ratios)
    assert_honest(stroke)
    assert_honest(frequency)


def test_a_weave() -> None:
    way = np.arange(-5.0, 205.0, 0.05)
    place = np.column_stack([way, 4.1 * np.sin(2 * np.pi * way / 9.8), np.zeros(len(way))])
    trajectory, windows = runs(way, [place, place], 1000.0)  # 50 mm/s
    path = {"name": "w", "kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (200.0, 0.0, 0.0), "speed_mm_s": 50.0}
    found = figures(trajectory, program_of(path | {"weave_stroke_mm": 8.0, "weave_distance_mm": 10.0}, windows))
    assert found["WS", None] == pytest.approx(2.5, abs=0.01)
    assert found["WF", None] == pytest.approx(100.0 * (10.0 / 9.8 - 1.0), abs=0.01)
    with pytest.raises(CertificationError, match=r"0 strokes across the path. At least 2"):
        figures(
            trajectory_of(trajectory.time_s, np.column_stack([np.tile(way, 2), np.zeros((2 * len(way), 2))])),
            program_of(path | {"weave_stroke_mm": 8.0, "weave_distance_mm": 10.0}, windows),
        )


def test_a_corner_without_samples_is_refused() -> None:
    side = np.concatenate([np.arange(-10.0, 95.0, 0.5), np.arange(305.0, 810.0, 0.5)])
    arc = np.arange(-200.0, 1001.0, 200.0)
    corners = np.array([[0.0, -200, 0], [0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0], [0, 0, 0], [0, -200, 0]])
    corners[0] = [-200.0, 0, 0]
    place = np.column_stack([np.interp(side, arc, corners[:, i]) for i in range(3)])
    trajectory, windows = runs(side, [place])
    with pytest.raises(CertificationError, match="path square, cycle 1: has 0 samples within half a side of corner 1"):
        figures(trajectory, program_of(SQUARE, windows))


COUNT_MM = 0.012


def passed_corner(overshoot_mm: float, seed: int, rate_hz: float) -> tuple[float, float, float]:
    """CO, its U95 and the truth where three cycles run an angle of 100 mm and swing beyond the second line by a bump of 5 mm of way."""
    rng = np.random.default_rng(seed)
    cycles, true = [], []
    for _ in range(3):
        way = np.arange(-5.0, 205.0, 100.0 / rate_hz) + 100.0 / rate_hz * rng.random()
        behind = np.maximum(way - 100.0, 0.0)
        bump = overshoot_mm * np.exp(-(((behind - 10.0) / 5.0) ** 2)) * (behind > 0.0)
        place = np.column_stack([np.minimum(way, 100.0) + bump, behind, 0.0 * way])
        true.append(bump.max())
        # three lengths at an angle to each other, read in whole counts
        axes = np.array([[0.8, 0.6, 0.0], [-0.48, 0.64, 0.6], [0.36, -0.48, 0.8]])
        phase = rng.random(3)
        cycles.append((COUNT_MM * (np.rint(place @ axes.T / COUNT_MM + phase) - phase)) @ axes)
    most = min(len(c) for c in cycles)
    trajectory, windows = runs(np.arange(float(most)), [c[:most] for c in cycles], rate_hz)
    path = {"name": "angle", "kind": "points", "points_mm": [(0.0, 0, 0), (100.0, 0, 0), (100.0, 100.0, 0)], "windows_s": windows}
    law = np.zeros((6, 6))
    law[3:, 3:] = COUNT_MM**2 / 12.0 * np.eye(3)
    program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path]})
    found = evaluate(trajectory, program, StatedErrors(law, rounded=True), settings=CertificationSettings(trials=200, seed=seed, planes=20))
    co = next(c for c in found.characteristics if c.name == "CO")
    return co.value, co.u95, float(np.mean(true))


@pytest.mark.parametrize(("overshoot_mm", "rate_hz"), [(0.0, 100.0), (1.0, 250.0)])
def test_u95_of_an_overshoot_holds_that_of_a_robot_without_one(overshoot_mm: float, rate_hz: float) -> None:
    """The largest of hundreds of samples is so much larger than none: it never was within U95 by the samples about it alone."""
    found = np.array([passed_corner(overshoot_mm, seed, rate_hz) for seed in range(20)])
    assert np.mean(np.abs(found[:, 0] - found[:, 2]) <= found[:, 1]) >= 0.9
    # nor is it only wide: a large overshoot is told to half a count
    assert np.median(found[:, 1]) < (0.5 if overshoot_mm == 1.0 else 1.2) * COUNT_MM


def rounded(way: FloatArray, radius: float) -> FloatArray:
    """Places (n, 3) on the way past a corner at the origin, from -X and on along +Y, rounded by an arc that is met at zero."""
    turn = np.clip(way / radius if radius > 0.0 else np.where(way < 0.0, 0.0, np.inf), 0.0, np.pi / 2)
    behind = np.maximum(way - radius * np.pi / 2, 0.0)
    return np.column_stack([np.minimum(way, 0.0) - radius * (1.0 - np.sin(turn)), radius * (1.0 - np.cos(turn)) + behind, 0.0 * way])


def round_off(radius: float, rate_hz: float, seed: int) -> tuple[float, float]:
    """CR and its U95 of three cycles at 240 mm/s, of phases that are drawn."""
    rng = np.random.default_rng(seed)
    cycles = [rounded(np.arange(-105.0, 105.0, 240.0 / rate_hz) + 240.0 / rate_hz * rng.random(), radius) for _ in range(3)]
    most = min(len(c) for c in cycles)
    trajectory, windows = runs(np.arange(float(most)), [c[:most] + 0.0035 * rng.normal(size=(most, 3)) for c in cycles], rate_hz)
    path = {"name": "angle", "kind": "points", "points_mm": [(-100.0, 0, 0), (0.0, 0, 0), (0.0, 100.0, 0)], "windows_s": windows}
    program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path]})
    law = StatedErrors(np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * 0.0035**2)
    found = evaluate(trajectory, program, law, settings=CertificationSettings(trials=300, seed=seed, planes=20)).characteristics
    cr = next(c for c in found if c.name == "CR")
    assert cr.u95 is not None
    return cr.value, cr.u95


@pytest.mark.parametrize(("radius", "most"), [(0.0, 0.9), (2.0, 0.55)])
def test_corners_between_samples_are_uncertain(radius: float, most: float) -> None:
    found = np.array([round_off(radius, 80.0, seed) for seed in range(15)])
    error = np.abs(found[:, 0] - radius * (np.sqrt(2.0) - 1.0))
    assert np.mean(error <= found[:, 1]) >= 0.93
    # no more than paths may differ between samples 3 mm apart that are not faster there than about it
    assert found[:, 1].max() < most


def test_corners_that_the_samples_resolve_are_as_certain_as_before() -> None:
    found = np.array([round_off(2.0, 1000.0, seed) for seed in range(3)])
    # of the mean of three cycles, each read from four samples
    assert (found[:, 1] < 1.96 * 0.0035 / np.sqrt(3.0) * 1.05).all()
