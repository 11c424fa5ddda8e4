"""Windows from a trajectory and the list of commands: those that the robot really had."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lmeasure.certification.campaign import Campaign, Tests, campaign, timed
from lmeasure.certification.command_files import write_commands
from lmeasure.certification.cube import Cube
from lmeasure.certification.ran import windows_from_rests
from lmeasure.cli import app
from lmeasure.errors import CertificationError
from lmeasure.kernels.screw import OK
from lmeasure.program import Program, read_program, write_program
from lmeasure.robots.cell_robot import cell_robot
from lmeasure.trajectory import Trajectory, write_trajectory

TESTS = Tests(
    tests=("pose", "approach", "stabilisation", "path", "reorientation", "posing"), speeds_percent=(100.0, 50.0), dwell_s=0.6, settle_s=0.4,
    cycles=dict.fromkeys(("pose", "approach", "stabilisation", "path", "reorientation", "posing"), 2),
)  # fmt: skip


@pytest.fixture(scope="module")
def plan() -> Campaign:
    return campaign(Cube(np.zeros(3), 300.0), TESTS)


@pytest.fixture(scope="module")
def ran(plan: Campaign) -> tuple[Program, Trajectory]:
    """The program with the windows it had, and the trajectory, with a rest before the start."""
    robot = replace(cell_robot(), built=cell_robot().nominal)
    done = robot.perform(plan.commands, plan.start, 200.0, np.random.default_rng(0))
    still = 300
    poses = np.concatenate([np.tile(done.poses[0], (still, 1)), done.poses])
    n = len(poses)
    nothing, text = np.zeros((n, 6, 6)), np.full(n, "", dtype=object)
    time_s = np.arange(n) / 200.0 - still / 200.0
    zero = np.zeros(n, np.int64)
    trajectory = Trajectory(time_s, poses, np.zeros(n), zero, np.full(n, OK), text, text, np.zeros(n), nothing, nothing, "nothing")
    return timed(plan.program, done, TESTS.settle_s), trajectory


def test_windows_are_within_the_rests_and_runs_they_belong_to(plan: Campaign, ran: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    program, trajectory = ran
    found = windows_from_rests(plan.program, tmp_path / "commands.csv", trajectory)
    for a, b in zip(program.pose, found.pose, strict=True):
        assert len(a.windows_s) == len(b.windows_s)
        assert len(a.settling_s) == len(b.settling_s)
        for (start, end), (first, last) in zip(a.windows_s, b.windows_s, strict=True):
            assert first == pytest.approx(start, abs=0.35)
            assert last == pytest.approx(end, abs=0.06)
    expected = [p.windows_s for p in program.path] + [p.windows_s for p in program.posing]
    got = [p.windows_s for p in found.path] + [p.windows_s for p in found.posing]
    for had, has in zip(expected, got, strict=True):
        for (start, end), (first, last) in zip(had, has, strict=True):
            assert first == pytest.approx(start, abs=0.3)
            assert last == pytest.approx(end, abs=0.6)
    # what was found stands the program's own checks
    write_program(tmp_path / "p.toml", found)
    assert read_program(tmp_path / "p.toml") == found


def test_a_command_that_was_left_out_is_named(plan: Campaign, ran: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    program, trajectory = ran
    cut = trajectory.time_s < program.pose[2].windows_s[1][0] - 1.0
    short = replace(trajectory, **{k: getattr(trajectory, k)[cut] for k in ("time_s", "poses", "status", "cause", "random", "systematic")})
    with pytest.raises(CertificationError, match=r"command \d+ \(P\d, cycle 2\): no rest near \("):
        windows_from_rests(plan.program, tmp_path / "commands.csv", short)


def test_forces_cannot_be_told_apart(ran: tuple[Program, Trajectory], tmp_path: Path) -> None:
    loaded = campaign(Cube(np.zeros(3), 300.0), Tests(tests=("compliance",), loads_kg=(5.0,)))
    write_commands(tmp_path / "commands.csv", loaded)
    with pytest.raises(CertificationError, match="cannot be told apart"):
        windows_from_rests(loaded.program, tmp_path / "commands.csv", ran[1])


def test_the_command_fills_in_the_program(plan: Campaign, ran: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    write_program(tmp_path / "program.toml", plan.program)
    write_trajectory(tmp_path / "trajectory.parquet", ran[1])
    done = CliRunner().invoke(app, ["program", "--out", str(tmp_path), "--ran", str(tmp_path / "trajectory.parquet")])
    assert done.exit_code == 0, done.output
    assert len(read_program(tmp_path / "program.toml").pose[0].windows_s) == 2
