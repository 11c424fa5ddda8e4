"""Test programs: what the standard asks is there, the robot can run it, and its windows are those of the program."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process import ran, refused
from scipy.spatial.transform import Rotation

from lmeasure.core import CertificationError
from lmeasure.io import files
from lmeasure.iso9283 import TESTS, Campaign, Cube, Tests, campaign, duration_s, timed, write_commands
from lmeasure.iso9283.program.campaign import CYCLES
from lmeasure.iso9283.program.command_files import write_robodk
from lmeasure.recording import Program, read_program, write_program
from lmeasure.robots import cell_robot

CUBE = Cube(np.array([0.0, 0.0, 20.0]), 300.0)
SHORT = Tests(
    tests=TESTS, speeds_percent=(100.0, 50.0), loads_kg=(5.0,), dwell_s=0.6, settle_s=0.3, cycles=dict.fromkeys(TESTS, 2),
    drift_s=60.0, drift_every_s=30.0, weave_mm=(20.0, 40.0),
)  # fmt: skip


@pytest.fixture(scope="module")
def plan() -> Campaign:
    return campaign(CUBE, SHORT)


def test_the_standard_s_numbers_of_cycles_are_the_default() -> None:
    whole = campaign(CUBE, Tests(tests=tuple(t for t in TESTS if t not in {"drift", "compliance"})))
    cycles = {p.name: p.cycles for p in (*whole.program.pose, *whole.program.path)}
    assert cycles["P1"] == cycles["P5 at 10 %"] == CYCLES["pose"] == 30
    assert cycles["P4 from three sides"] == 90
    assert cycles["P1 settling"] == cycles["weave"] == 3
    assert cycles["line"] == cycles["large circle at 50 %"] == cycles["line turning about x"] == 10
    done = dict.fromkeys(cycles, 0)
    for command in whole.commands:
        if command.role in {"pose", "settling", "path"} and command.target:
            done[command.target] += 1
    assert done == {name: n or 0 for name, n in cycles.items()}


def test_poses_are_reached_in_one_direction_and_from_three_sides(plan: Campaign) -> None:
    places = {p.name: np.array(p.position_mm) for p in plan.program.pose}
    before, came = plan.start[:3], dict[str, list[np.ndarray]]()  # type: ignore[type-arg]
    for command in plan.commands:
        if command.target in places:
            assert command.poses[-1, :3] == pytest.approx(places[command.target])
            came.setdefault(command.target, []).append(command.poses[-1, :3] - before)
        before = command.poses[-1, :3]
    assert np.ptp(came["P4"], axis=0).max() < 1e-9
    for name in ("P1", "P2", "P4"):
        sides = np.array(came[f"{name} from three sides"])
        assert np.abs(sides) / 60.0 == pytest.approx(np.tile(np.eye(3), (2, 1)))
        assert next(p for p in plan.program.pose if p.name == f"{name} from three sides").approaches == ("x", "y", "z") * 2


def test_paths_are_those_of_the_program(plan: Campaign) -> None:
    paths = {p.name: p for p in plan.program.path}
    for command in plan.commands:
        if command.role != "path" or command.target == "weave":
            continue
        path = paths[command.target]
        assert command.speed_mm_s == path.speed_mm_s
        grid = path.points(0.2)
        nearest = [np.linalg.norm(grid - at, axis=1).min() for at in command.poses[:, :3]]
        assert max(nearest) < 0.11
    assert {p.kind for p in paths.values()} == {"linear", "circular", "rectangular"}
    turning = paths["line turning about y"]
    assert turning.quaternion_xyzw
    assert turning.end_quaternion_xyzw
    first, last = Rotation.from_quat(turning.quaternion_xyzw), Rotation.from_quat(turning.end_quaternion_xyzw)
    assert (last * first.inv()).as_rotvec() == pytest.approx(np.radians([0.0, 20.0, 0.0]))


def test_the_weave_has_its_stroke_its_way_and_its_speed_along_the_line(plan: Campaign) -> None:
    path = next(p for p in plan.program.path if p.name == "weave")
    command = next(c for c in plan.commands if c.target == "weave")
    start, end = path.corners()
    along = (end - start) / np.linalg.norm(end - start)
    ways = command.poses[:, :3] - start
    side = ways - (ways @ along)[:, None] * along
    height = side @ side[0] / np.linalg.norm(side[0])
    assert height[:4] == pytest.approx([10.0, -10.0, 10.0, -10.0])
    assert np.diff(ways[:4] @ along) == pytest.approx([20.0, 20.0, 20.0])
    assert command.poses[-1, :3] == pytest.approx(end)
    seconds = float(command.durations(np.array([*start, 0, 0, 0, 1.0])).sum())
    assert seconds * (path.speed_mm_s or 0.0) == pytest.approx(np.linalg.norm(end - start))


def test_posing_goes_to_and_fro_within_the_plane(plan: Campaign) -> None:
    places = {p.name: np.array(p.position_mm) for p in plan.program.pose}
    steps = [np.linalg.norm(places[p.to_pose] - places[p.from_pose]) for p in plan.program.posing]
    assert steps == pytest.approx([1, 2, 5, 10, 20, 50, 100, 200])
    assert max(abs((places[p.to_pose] - CUBE.centre) @ CUBE.normal) for p in plan.program.posing) < 1e-9


def test_forces_are_tenths_of_the_load_in_both_directions(plan: Campaign) -> None:
    forces = np.array(plan.program.compliance[0].force_n)
    assert len(forces) == 2 * 6 * 11
    assert np.unique(np.abs(forces[forces != 0.0]).round(9)) == pytest.approx(5.0 * 9.80665 * np.arange(1, 11) / 10)
    assert forces.sum(axis=0) == pytest.approx([0, 0, 0])


def test_a_robot_runs_it_and_the_program_gets_its_windows(plan: Campaign, tmp_path: Path) -> None:
    robot = cell_robot()
    done = robot.perform(plan.commands, plan.start, 200.0, np.random.default_rng(0))
    printed = timed(plan.program, done, SHORT.settle_s)
    # the windows stand the program's own checks: numbers of cycles, order, no two at once
    write_program(tmp_path / "program.toml", printed)
    assert read_program(tmp_path / "program.toml") == printed
    assert done.time_s[-1] == pytest.approx(duration_s(plan) + sum(robot.ramp_s) * len(plan.commands), abs=0.01)
    moved = np.linalg.norm(np.diff(done.poses[:, :3], axis=0), axis=1)
    for pose in printed.pose:
        assert pose.windows_s or pose.name.startswith("posing") or pose.name == "P1 loaded"
        for start, end in pose.windows_s:
            part = slice(int(np.ceil(start * 200)), int(np.floor(end * 200)))
            # a robot of a few tenths of a millimetre, at rest
            assert np.linalg.norm(done.poses[part, :3] - pose.position_mm, axis=1).max() < 2.0
            assert moved[part][:-1].max() < 1e-3
    assert len(printed.compliance[0].windows_s) == len(printed.compliance[0].force_n)
    assert all(len(p.windows_s) == 2 for p in printed.posing)
    assert [len(p.settling_s) for p in printed.pose if p.name == "P1 settling"] == [2]


def test_files_for_people_and_for_robodk(plan: Campaign, tmp_path: Path) -> None:
    write_commands(tmp_path / "commands.csv", plan)
    table = files.read_table(tmp_path / "commands.csv")
    command = table.numbers("command").astype(int)
    assert command[-1] == len(plan.commands)
    ends = np.flatnonzero(np.append(np.diff(command) > 0, True))
    assert table.matrix(("x_mm", "y_mm", "z_mm"))[ends] == pytest.approx(np.array([c.poses[-1, :3] for c in plan.commands]))
    assert table.numbers("dwell_s").sum() == pytest.approx(sum(c.dwell_s for c in plan.commands))
    arcs = [(m, int(c)) for m, c in zip(table.text("move"), command, strict=True) if m != "linear"]
    assert [m for m, _ in arcs] == ["via", "arc"] * (len(arcs) // 2)
    # four points on a circle: with the start, two half circles
    assert len(arcs) == 4 * sum("circle" in c.target for c in plan.commands)

    write_robodk(tmp_path / "robodk.csv", plan)
    rows = np.loadtxt(tmp_path / "robodk.csv", delimiter=",")
    turns = [c for c in plan.commands if c.target == "line turning about z"]
    mine = rows[rows[:, 6] == 1 + next(i for i, c in enumerate(plan.commands) if c is turns[0])]
    rz, ry, rx = np.radians(mine[-1, [5, 4, 3]])
    turn = np.array([[np.cos(rz), -np.sin(rz), 0], [np.sin(rz), np.cos(rz), 0], [0, 0, 1]])
    assert (ry, rx) == pytest.approx((0.0, 0.0))
    assert Rotation.from_quat(turns[0].poses[-1, 3:]).as_matrix() == pytest.approx(turn)


def test_the_command_line(tmp_path: Path) -> None:
    box = ["--x", "-100:100", "--y", "-100:100", "--z", "0:300", "--out", str(tmp_path)]
    printed = ran("program", *box, "--tests", "pose,path", "--cycles", "pose=3,path=2", "--speeds", "100")
    assert "cube of 200 mm about (0, 0, 150) mm, plane C1-C2-C7-C8\n5 poses, 4 paths, " in printed
    program = read_program(tmp_path / "program.toml")
    assert isinstance(program, Program)
    assert program.distance[0].name == "P2-P4"
    for wrong in (box[2:], [*box, "--zone", "zone.nc"], [*box, "--quaternion", "0,0,1"], [*box, "--cycles", "pose"]):
        refused("program", *wrong, "--force", code=2)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tests": ("pose", "flight")}, "no test 'flight'"),
        ({"cycles": {"pose": 1}}, "two cycles at least"),
        ({"settle_s": 0.7}, "nothing to measure"),
        ({"speeds_percent": (120.0,)}, "more than the rated"),
        ({"speed_mm_s": float("nan")}, "finite and more than 0"),
        ({"loads_kg": (0.0,)}, "needs a load"),
        ({"weave_mm": (10.0, 1000.0)}, "longer than the line"),
    ],
)
def test_what_cannot_be_tested_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(CertificationError, match=said):
        campaign(CUBE, replace(SHORT, **change))  # type: ignore[arg-type]
