"""Workspaces of mechanisms node by node beside formulas that share nothing with the program: coarse grids of `benchmarks/workspaces.py`."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from lmeasure.robots import ParallelFile, any_shipped, over_grid

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))
import workspaces  # noqa: E402

COARSER = 3


@pytest.mark.parametrize("case", [case for case in workspaces.CASES if case.yaw is not None], ids=lambda case: f"{case.robot}-{case.yaw:g}")
def test_no_node_is_judged_otherwise(case: workspaces.Case) -> None:
    file = any_shipped(case.robot)
    assert isinstance(file, ParallelFile)
    x, y, z = (
        np.arange(a, b + 0.5 * step, step if case.robot == "three-prr" and i == 2 else COARSER * step)
        for i, (a, b, step) in enumerate(case[1:4])
    )
    assert case.yaw is not None
    half = math.radians(case.yaw) / 2.0
    found = over_grid(file, (x, y, z), np.array([0.0, 0.0, math.sin(half), math.cos(half)])).found.inside
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    own = workspaces.judged(workspaces.read(case.robot), nodes, case.yaw)
    assert (own.reshape(found.shape) == found).all()
    assert 0 < found.sum() < found.size


@pytest.mark.parametrize("case", workspaces.REPORTED, ids=lambda case: case.robot)
def test_no_value_that_a_robot_of_fewer_freedoms_is_told_is_judged_otherwise(case: workspaces.Reported) -> None:
    """About home, where some can be taken and some not."""
    axes = [np.arange(a, b + 0.5 * step, (5 if len(case.axes) == 3 else 9) * step) for a, b, step in case.axes]
    if len(axes) == 3:
        axes[2] = np.array([187.0, 195.0, 201.0])
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    scale = np.array([np.radians(1.0)] * 2 + [1.0]) if len(axes) == 3 else np.ones(1)
    found = workspaces.taken(case.robot, nodes)
    np.testing.assert_array_equal(case.can(workspaces.read(case.robot), nodes * scale), found)
    assert 0 < found.sum() < len(found)
