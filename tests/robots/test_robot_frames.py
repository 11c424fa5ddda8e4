"""AX = YB: coverage of what is stated, and the cost of a generic optimiser."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process import ran
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.io import files
from lmeasure.recording import Poses, pose_columns
from lmeasure.robots import frames

U_MM, U_RAD = 0.05, 2e-4


def drawn(rng: np.random.Generator, count: int = 12) -> tuple[Poses, Poses, FloatArray, FloatArray]:
    """Poses of the flange and, with errors, of the target; and the true base and tool."""
    names = tuple(f"P{i}" for i in range(count))
    robot = se3.pose(rng.uniform(-500, 500, (count, 3)), Rotation.random(count, rng=rng))
    base = se3.pose(rng.uniform(-2000, 2000, 3), Rotation.random(rng=rng))
    tool = se3.pose(rng.uniform(-200, 200, 3), Rotation.random(rng=rng))
    noise = np.column_stack([U_RAD * rng.normal(size=(count, 3)), U_MM * rng.normal(size=(count, 3))])
    seen = se3.displaced(se3.compose(se3.compose(base, robot), tool), noise)
    zero = np.zeros(count)
    return Poses(names, robot, zero, zero), Poses(names, seen, zero + U_MM, zero + U_RAD), base, tool


def test_what_is_stated_holds() -> None:
    rng = np.random.default_rng(30)
    squares = []
    for _ in range(60):
        robot, seen, base, tool = drawn(rng)
        found = frames(robot, seen)
        off = np.concatenate([se3.displacement(found.state.base, base), se3.displacement(found.state.targets[0], tool)])
        unit = found.fit.problem.unknowns.size
        squares.append(off / unit @ np.linalg.solve(found.fit.covariance, off / unit))
    inside = int((np.array(squares) < 21.026).sum())  # chi-squared of 12, 95 %
    assert binomtest(inside, 60, 0.95).pvalue > 0.01


def test_the_cost_is_a_generic_optimisers() -> None:
    robot, seen, base, tool = drawn(np.random.default_rng(3))
    found = frames(robot, seen)
    assert found.noise.position_mm < U_MM
    sigma = np.hypot(U_MM, found.noise.position_mm), np.hypot(U_RAD, found.noise.rotation_rad)

    def residuals(x: FloatArray) -> FloatArray:
        made = se3.compose(se3.compose(se3.displaced(base, x[:6]), robot.rows), se3.displaced(tool, x[6:]))
        off = se3.displacement(seen.rows, made)
        return np.concatenate([(off[:, 3:] / sigma[0]).reshape(-1), (off[:, :3] / sigma[1]).reshape(-1)])

    best = least_squares(residuals, np.zeros(12), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.fit.chi2 == pytest.approx(2.0 * best.cost, rel=1e-9)


def test_more_scatter_than_stated_is_said() -> None:
    robot, seen, _, _ = drawn(np.random.default_rng(3))
    assert not frames(robot, seen).findings
    bold = frames(robot, seen.with_uncertainty(0.2 * U_MM, 0.2 * U_RAD))
    assert [f.code for f in bold.findings] == ["misfit"]


def test_positions_alone_tell_the_base_and_say_what_they_do_not() -> None:
    robot, seen, base, _ = drawn(np.random.default_rng(4), 20)
    seen = Poses(seen.names, seen.rows, seen.u_position_mm, np.zeros(20), oriented=False)
    found = frames(robot, seen)
    assert np.abs(se3.displacement(found.state.base, base)[3:]).max() < 0.2
    assert not found.fit.problem.unknowns.turned.any()


def test_poses_that_belong_to_others_give_no_frames() -> None:
    """Names of two tables that share none; each pose under its neighbour's name; quaternions with w first: no frames, and the reason."""
    robot, seen, _, _ = drawn(np.random.default_rng(5))
    with pytest.raises(RobotError, match=r"no pose has one name in both tables: the robot's first is 'P0', .* 'Q0'"):
        frames(robot, replace(seen, names=tuple(f"Q{i}" for i in range(len(seen)))))
    for strange in (
        replace(seen, names=(*seen.names[1:], seen.names[0])),
        replace(seen, rows=np.column_stack([seen.rows[:, :3], np.roll(seen.rows[:, 3:], 1, axis=1)])),
    ):
        with pytest.raises(RobotError, match=r"still miss each other by .* mm of a spread of .* mm: names, the order of quaternions"):
            frames(robot, strange)


def test_poses_of_one_table_alone_are_named(tmp_path: Path) -> None:
    robot, seen, _, _ = drawn(np.random.default_rng(6))
    for name, poses in (("robot.csv", robot), ("seen.csv", seen.of(np.arange(1, 12)))):
        files.write_table(tmp_path / name, pose_columns(poses))
    out = tmp_path / "frames.json"
    words = ["--robot", str(tmp_path / "robot.csv"), "--measured", str(tmp_path / "seen.csv"), "--out", str(out)]
    assert f"warning unmatched: pose 'P0' is only in {tmp_path / 'robot.csv'}, and is not used" in ran("frames", *words).splitlines()
    assert [w["code"] for w in json.loads(out.read_text())["warnings"]] == ["unmatched"]
