"""What is lost at a singular pose is named, and what is not is measured there."""

import numpy as np
from cells import START, FloatArray, cell, position_error, record
from scipy.spatial.transform import Rotation

from lmeasure.core import Status
from lmeasure.kernels import CABLE_COLUMNS, span_lengths
from lmeasure.trajectory import reconstruct
from lmeasure.trajectory.reconstruction.screw_method import explain, split_at

ALL = np.arange(6)
U = np.full(6, 0.0035)


def meeting_an_axis() -> FloatArray:
    """Six straight cables whose lines all meet the vertical through (40, -25): none sees a turn about it."""
    axis = np.array([40.0, -25.0, 0.0])
    rows = np.zeros((6, CABLE_COLUMNS))
    for i, row in enumerate(rows):
        out = np.array([np.cos(2.4 * i), np.sin(2.4 * i), 0.0])
        low, high = axis + 150.0 * out, axis + 900.0 * out
        row[7:10] = low + [0.0, 0.0, 20.0 * i]
        row[:3] = high + [0.0, 0.0, (-1) ** i * (400.0 + 90.0 * i)]
        row[3:6] = (0.0, 0.0, 1.0)
    return rows


def test_a_turn_about_a_known_axis_is_named() -> None:
    lost = split_at(meeting_an_axis(), START, ALL, U).lost
    np.testing.assert_allclose(lost.direction, [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(lost.point[:2], [40.0, -25.0], atol=1e-6)
    assert abs(lost.pitch_mm) < 1e-6
    assert lost.mm_per_mm < 1e-12
    assert str(lost.said) == "a turn about the axis through (40.0, -25.0, 0.0) mm along (0.000, 0.000, 1.000)"


def test_parallel_cables_lose_a_shift() -> None:
    rows = meeting_an_axis()
    rows[:, :3] = rows[:, 7:10] + np.column_stack([np.cos(1.1 * ALL), np.sin(1.1 * ALL), 0.0 * ALL]) * 800.0
    lost = split_at(rows, START, ALL, U).lost
    assert str(lost.said) == "a shift along (0.000, 0.000, 1.000)"


def test_what_is_not_lost_is_measured_with_its_uncertainty() -> None:
    rows = meeting_an_axis()
    split = split_at(rows, START, ALL, U)
    moved = np.concatenate([[0.03, -0.02, 0.05], Rotation.from_rotvec([2e-4, -1e-4, 3e-4]).as_quat()])
    changes = span_lengths(rows, moved[None]) - span_lengths(rows, START[None])
    twists, u = split.determined(changes)
    # the determined part differs from the motion by a multiple of what is lost: a turn about (40, -25)
    rest = np.array([2e-4, -1e-4, 3e-4, 0.03, -0.02, 0.05]) - twists[0]
    np.testing.assert_allclose(rest[:2], 0.0, atol=1e-7)
    np.testing.assert_allclose(rest[3:], np.cross([0.0, 0.0, rest[2]], [-40.0, 25.0, 0.0]), atol=1e-4)
    noise = np.random.default_rng(0).normal(0.0, U, (4000, 6))
    np.testing.assert_allclose(split.determined(noise)[0].std(axis=0), u, rtol=0.06)
    (said,) = explain(split, changes)
    text = str(said)
    assert text.startswith("not determined: a turn about the axis")
    assert "Determined since the last pose, within " in text


def test_a_run_into_a_singular_pose_says_what_is_lost() -> None:
    times = np.arange(3000) / 1000.0
    turn = 1.5 * np.sin(np.pi * times / times[-1])
    poses = np.column_stack([30.0 * times, 0 * times, 0 * times, Rotation.from_rotvec(np.outer(turn, [0.0, 0.0, 1.0])).as_quat()])
    found = reconstruct(record(cell(), times, poses))
    refused = np.flatnonzero(found.status == Status.SINGULAR)
    assert len(refused)
    assert "it is singular here or on the path to it; not determined: a turn about the axis" in str(found.cause[refused[0]])
    near = np.flatnonzero((found.status == Status.OK) & (found.worst_pressure_angle_deg > 88.0))
    assert len(near)
    assert all(str(found.cause[i]).startswith("nearly singular: 1 mm of a turn") for i in near)
    ok = found.status == Status.OK
    assert position_error(found.poses[ok], poses[ok]).max() < 1.0
