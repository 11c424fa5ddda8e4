"""Windows from a trajectory and the list of commands: those that the robot really had."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process import ran, refused

from lmeasure.core import CertificationError, FileFormatError, Status
from lmeasure.iso9283 import Campaign, Cube, Tests, campaign, timed, windows_from_rests, write_commands
from lmeasure.recording import Program, read_program, write_program
from lmeasure.robots import cell_robot
from lmeasure.trajectory import LAG_S, Trajectory, settled, write_trajectory

TESTS = Tests(
    tests=("pose", "approach", "stabilisation", "path", "reorientation", "posing"), speeds_percent=(100.0, 50.0), dwell_s=0.6, settle_s=0.4,
    cycles=dict.fromkeys(("pose", "approach", "stabilisation", "path", "reorientation", "posing"), 2),
)  # fmt: skip


@pytest.fixture(scope="module")
def plan() -> Campaign:
    return campaign(Cube(np.zeros(3), 300.0), TESTS)


@pytest.fixture(scope="module")
def driven(plan: Campaign) -> tuple[Program, Trajectory]:
    """The program with the windows it had, and the trajectory, with a rest before the start."""
    return performed(plan)


def performed(plan: Campaign) -> tuple[Program, Trajectory]:
    robot = replace(cell_robot(), built=cell_robot().nominal)
    done = robot.perform(plan.commands, plan.start, 200.0, np.random.default_rng(0))
    still = 300
    poses = np.concatenate([np.tile(done.poses[0], (still, 1)), done.poses])
    n = len(poses)
    nothing, text = np.zeros((n, 6, 6)), np.full(n, "", dtype=object)
    time_s = np.arange(n) / 200.0 - still / 200.0
    zero = np.zeros(n, np.int64)
    trajectory = Trajectory(time_s, poses, np.zeros(n), zero, np.full(n, Status.OK), text, text, np.zeros(n), nothing, nothing, "nothing")
    return timed(plan.program, done, TESTS.settle_s), trajectory


def test_windows_are_within_the_rests_and_runs_they_belong_to(plan: Campaign, driven: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    program, trajectory = driven
    found, _ = windows_from_rests(plan.program, tmp_path / "commands.csv", trajectory)
    for a, b in zip(program.pose, found.pose, strict=True):
        assert len(a.windows_s) == len(b.windows_s)
        assert len(a.settling_s) == len(b.settling_s)
        for (start, end), (first, last) in zip(a.windows_s, b.windows_s, strict=True):
            assert first == pytest.approx(start, abs=0.35)
            assert end - 0.25 <= last <= end + 0.01
        for (start, end), (first, last) in zip(a.settling_s, b.settling_s, strict=True):
            # from the turn, not from the rest before, which is at the pose itself
            assert first == pytest.approx(start, abs=0.1)
            assert end - 0.25 <= last <= end + 0.01
    expected = [p.windows_s for p in program.path] + [p.windows_s for p in program.posing]
    got = [p.windows_s for p in found.path] + [p.windows_s for p in found.posing]
    for had, has in zip(expected, got, strict=True):
        for (start, end), (first, last) in zip(had, has, strict=True):
            assert first == pytest.approx(start, abs=0.3)
            assert last == pytest.approx(end, abs=0.6)
    # what was found stands the program's own checks
    write_program(tmp_path / "p.toml", found)
    assert read_program(tmp_path / "p.toml") == found


def test_a_command_that_was_left_out_is_named(plan: Campaign, driven: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    program, trajectory = driven
    cut = trajectory.time_s < program.pose[2].windows_s[1][0] - 1.0
    short = replace(trajectory, **{k: getattr(trajectory, k)[cut] for k in ("time_s", "poses", "status", "cause", "random", "systematic")})
    with pytest.raises(CertificationError, match=r"command \d+ \(P\d, cycle 2\): no rest near \("):
        windows_from_rests(plan.program, tmp_path / "commands.csv", short)


def test_a_trajectory_without_a_sample_is_one_line(plan: Campaign, driven: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    nothing = replace(driven[1], **{k: getattr(driven[1], k)[:0] for k in ("time_s", "poses", "status", "cause", "random", "systematic")})
    with pytest.raises(CertificationError, match="the trajectory has no sample"):
        windows_from_rests(plan.program, tmp_path / "commands.csv", nothing)
    head = (tmp_path / "commands.csv").read_text().splitlines()[0]
    (tmp_path / "none.csv").write_text(head + "\n")
    with pytest.raises(FileFormatError, match="contains no command"):
        windows_from_rests(plan.program, tmp_path / "none.csv", driven[1])


LOADED = Tests(
    tests=("pose", "compliance", "weaving"), loads_kg=(5.0,), speeds_percent=(100.0,), dwell_s=0.6, settle_s=0.4,
    cycles=dict.fromkeys(("pose", "compliance", "weaving"), 2),
)  # fmt: skip


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Program, Trajectory]:
    """A folder with program.toml, commands.csv and trajectory.parquet of a compliance test among others, and what it was."""
    folder = tmp_path_factory.mktemp("loaded")
    plan = campaign(Cube(np.zeros(3), 300.0), LOADED)
    program, trajectory = performed(plan)
    write_commands(folder / "commands.csv", plan)
    write_program(folder / "program.toml", plan.program)
    write_trajectory(folder / "trajectory.parquet", trajectory)
    return folder, program, trajectory


def write_times(path: Path, windows: Sequence[tuple[float, float]]) -> None:
    path.write_text("start_s,end_s\n" + "".join(f"{a!r},{b!r}\n" for a, b in windows))


def test_forces_come_from_the_log_of_the_loads(loaded: tuple[Path, Program, Trajectory]) -> None:
    folder, program, _ = loaded
    windows = program.compliance[0].windows_s
    assert len(windows) == 132
    write_times(folder / "loads.csv", windows)
    given = ["program", "--out", str(folder), "--ran", str(folder / "trajectory.parquet")]
    before = (folder / "program.toml").read_bytes()
    assert "cannot be distinguished. State the times of each force with --loaded" in refused(*given)
    assert (folder / "program.toml").read_bytes() == before
    ran(*given, "--loaded", folder / "loads.csv")
    found = read_program(folder / "program.toml")
    assert found.compliance[0].windows_s == windows
    assert len(found.path[0].windows_s) == 2
    # the rest before, at the same place, ends where the forces begin
    first, last = found.pose[0].windows_s[-1]
    assert last <= windows[0][0]
    assert first == pytest.approx(program.pose[0].windows_s[-1][0], abs=0.35)
    # what is stated in the program needs no log
    ran(*given)
    assert read_program(folder / "program.toml") == found


def test_a_log_of_loads_that_cannot_be_is_refused(loaded: tuple[Path, Program, Trajectory], tmp_path: Path) -> None:
    folder, program, trajectory = loaded
    windows = list(program.compliance[0].windows_s)
    wrong = {
        "has 131 rows for 132 forces": windows[:-1],
        "row 1: ": [windows[0], windows[0], *windows[2:]],
        "row 131: ": [*windows[:-1], (windows[-1][0], 1e6)],
        "before the previous one has ended": [(a - 5.0, b - 5.0) for a, b in windows],
    }
    for reported, times in wrong.items():
        write_times(tmp_path / "loads.csv", times)
        with pytest.raises(CertificationError, match=reported):
            windows_from_rests(program, folder / "commands.csv", trajectory, loaded=tmp_path / "loads.csv")


@pytest.mark.parametrize("options", [("--loaded", "x.csv"), ("--ran", "t.parquet", "--x", "0:1", "--y", "0:1", "--z", "0:1")])
def test_options_that_do_not_go_together(options: tuple[str, ...], tmp_path: Path) -> None:
    refused("program", "--out", tmp_path, *options, code=2)


def test_the_command_fills_in_the_program(plan: Campaign, driven: tuple[Program, Trajectory], tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    write_program(tmp_path / "program.toml", plan.program)
    write_trajectory(tmp_path / "trajectory.parquet", driven[1])
    ran("program", "--out", tmp_path, "--ran", tmp_path / "trajectory.parquet")
    assert len(read_program(tmp_path / "program.toml").pose[0].windows_s) == 2


def test_a_count_that_flickers_is_no_departure() -> None:
    """A still robot shows one reading, now and then the next; it leaves when it goes away for good."""
    time_s = np.arange(400) / 200.0
    positions = np.zeros((400, 3))
    positions[230, 0] = positions[300, 0] = 0.005
    positions[380:, 1] = 5.0 * np.arange(20) ** 2 / 400.0
    start, end = settled(time_s, positions, slice(0, 390))
    assert start == pytest.approx(0.975)
    assert end == pytest.approx(time_s[380] - LAG_S)
