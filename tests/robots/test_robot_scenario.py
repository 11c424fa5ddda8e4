"""A mechanism in a scenario: planted errors move it, its rests tell them, commands of a program are gone through and certified."""

from pathlib import Path

import numpy as np
import pytest
from in_process import ran

from lmeasure.core import FileFormatError, RobotError, se3
from lmeasure.io import files
from lmeasure.iso9283 import Tests, campaign, largest_cube, simulate_robot, write_commands
from lmeasure.recording import read_program, read_run, write_program
from lmeasure.robots import any_shipped, nearness, read_robot
from lmeasure.robots.parallel.limits import spread
from lmeasure.robots.parallel.model import Parallel
from lmeasure.simulation import scenario_from_dict
from lmeasure.trajectory import reconstruct

WAYPOINTS = [
    {
        "position_mm": [20.0 * np.cos(k), 20.0 * np.sin(2 * k), 8.0 * np.cos(3 * k)],
        "quaternion_xyzw": [0.0, 0.0, np.sin(0.02 * k), np.cos(0.02 * k)],
    }
    for k in range(6)
]
FIRST = {"schema": "lmeasure.scenario/1", "rate_hz": 100.0, "motion": {"speed_mm_s": 200.0, "dwell_s": 0.8}}


def of(robot: dict[str, object], **more: object) -> dict[str, object]:
    return {**FIRST, "waypoint": WAYPOINTS, "robot": robot, **more}


@pytest.mark.parametrize("model", ["rotopod-cell", "four-chains-arms", "logos", "gough", "generic6", "input-rods"])
def test_a_robot_without_errors_goes_where_it_is_told(model: str, tmp_path: Path) -> None:
    done = simulate_robot(*scenario_from_dict(of({"model": model})), tmp_path).performance
    rests = [int(s.end_s * 100) - 1 for s in done.spans]
    determined = np.array([c.poses[-1] for c in done.commands])
    assert np.abs(se3.displacement(done.poses[rests], determined)).max() < 1e-6
    # servos lag behind on the way
    assert np.abs(se3.displacement(done.poses, done.commanded)).max() > 0.1


def test_planted_errors_are_those_of_the_built_robot(tmp_path: Path) -> None:
    robot: dict[str, object] = {"model": "rotopod-cell", "errors": {"leg_1.rod_mm": 0.8}}
    run = simulate_robot(*scenario_from_dict(of(robot)), tmp_path)
    off = np.array([q.value - p.value for p, q in zip(run.drawn.model.parameters, run.built.model.parameters, strict=True)])
    names = [p.name for p in run.drawn.model.parameters]
    assert {names[i]: round(off[i], 9) for i in np.flatnonzero(off)} == {"leg_1.rod_mm": 0.8}
    done = run.performance
    rest = int(done.spans[0].end_s * 100) - 1
    # to first order, by the derivative that another test holds to differences
    _, _, by_parameters = run.drawn.model.derivatives(done.requested[rest : rest + 1])
    twist = 0.8 * by_parameters[0, names.index("leg_1.rod_mm")]
    flange, base = run.drawn.model.forward(done.requested[rest : rest + 1])[0], np.array([0.0, 0.0, -400.0, 0.0, 0.0, 0.0, 1.0])
    moved = se3.displacement(se3.compose(se3.inverse(base), done.poses[rest]), flange)
    np.testing.assert_allclose(moved[:3], twist[:3], atol=3e-5)
    np.testing.assert_allclose(moved[3:], twist[3:] + np.cross(twist[:3], flange[:3]), atol=0.02)


@pytest.mark.parametrize(("model", "unit"), [("rotopod-cell", "deg"), ("input-rods", "mm")])
def test_a_program_is_gone_through_and_certified_by_command(model: str, unit: str, tmp_path: Path) -> None:
    plan = campaign(
        largest_cube((-30.0,) * 3, (30.0,) * 3),
        Tests(tests=("pose",), cycles={"pose": 3}, speed_mm_s=200.0, speeds_percent=(100.0,), dwell_s=0.6),
    )
    write_commands(tmp_path / "commands.csv", plan)
    text = f'schema = "lmeasure.scenario/1"\nrate_hz = 100.0\n[robot]\nmodel = "{model}"\ncommands = "commands.csv"\nu_mm = 0.2\n'
    (tmp_path / "scenario.toml").write_text(text)
    program, measured = tmp_path / "program.toml", tmp_path / "t.parquet"
    write_program(program, plan.program)
    ran("simulate", tmp_path / "scenario.toml", "--out", tmp_path / "run")
    ran("reconstruct", tmp_path / "run", "--out", measured)
    ran("program", "--ran", measured, "--out", tmp_path)
    ran("certify", measured, "--run", tmp_path / "run", "--program", program, "--out", tmp_path / "certificate")
    ran("verify", tmp_path / "certificate")
    drawn, true = (read_robot(tmp_path / "run" / "robot" / part) for part in ("robot.toml", "true/robot.toml"))
    assert drawn != true
    rests = files.read_table(tmp_path / "run" / "robot" / "joints.csv")
    trajectory, truth = reconstruct(read_run(tmp_path / "run")), files.read_table(tmp_path / "run" / "truth.parquet")
    # where the controller went by its drawing, the built robot was: within counts, its first pose being the start
    joints = rests.matrix([f"leg_{i}_{unit}" for i in range(1, 7)]) * (np.pi / 180.0 if unit == "deg" else 1.0)
    at = np.searchsorted(trajectory.time_s, rests.numbers("time_s"))
    flange = true.model.forward(joints)
    base = np.array([0.0, 0.0, -400.0, 0.0, 0.0, 0.0, 1.0])
    places = se3.compose(np.tile(base, (len(flange), 1)), flange)[:, :3]
    assert np.abs(places - truth.matrix(("x_mm", "y_mm", "z_mm"))[at]).max() < 1e-3
    assert np.abs(places - trajectory.poses[at, :3]).max() < 0.1
    assert np.abs(places - se3.compose(np.tile(base, (len(flange), 1)), drawn.model.forward(joints))[:, :3]).max() > 0.2


@pytest.mark.parametrize(
    ("robot", "more", "complaint"),
    [
        ({"model": "rotopode"}, {}, "scenario: robot.model: 'rotopode' is not a shipped robot. Known: "),
        ({"model": "rotopod-cell", "errors": {"leg_9.rod_mm": 1.0}}, {}, "robot.errors: 'leg_9.rod_mm' is no parameter of 'rotopod-cell'"),
        ({"model": "rotopod-cell", "commands": "c.csv"}, {}, r"needs either \[\[waypoint\]\] or commands, not both"),
        (
            {"model": "rotopod"},
            {"waypoint": [{"position_mm": [0.0, 0.0, 60.0]}]},
            r"command 1 \(on the way, cycle 1\): sample .*: the platform",
        ),
        ({"model": "gough"}, {"waypoint": [{"position_mm": [0.0, 0.0, 400.0]}]}, "leg_1 would be at .* mm, beyond its limits"),
        ({"model": "ur5"}, {}, "robot 'ur5': paths are followed by elbow arms"),
    ],
)
def test_what_a_robot_cannot_do_is_said_in_one_line(
    robot: dict[str, object], more: dict[str, object], complaint: str, tmp_path: Path
) -> None:
    with pytest.raises((FileFormatError, RobotError), match=complaint) as raised:
        simulate_robot(*scenario_from_dict(of(robot, **more)), tmp_path)
    assert "\n" not in str(raised.value)


def test_joints_go_over_home_where_no_straight_way_is(tmp_path: Path) -> None:
    """Between two poses of four chains hinged on arms; it rests where its joint values are, all the same."""
    model = any_shipped("four-chains-arms").model
    assert isinstance(model, Parallel)
    far = spread(model, np.random.default_rng(3).random((2000, 6)), most_rad=1.0)
    far = far[~np.isnan(model.forward(far)[:, 0])]
    near = nearness(model.jacobians(model.forward(far), far).output, model.units)
    far = far[near > 0.1 * nearness(model.jacobians(model.home[None], model.home_joints[None]).output, model.units)]
    lines = far[:-1] + np.linspace(0.0, 1.0, 21)[:, None, None] * (far[1:] - far[:-1])
    lost = np.asarray(np.isnan(model.forward(lines.reshape(-1, 6))[:, 0]).reshape(21, -1).any(axis=0))
    first = int(np.argmax(lost))
    assert lost[first]
    joints = far[first : first + 2]
    names = [f"{n}_deg" for n in model.joint_names]
    files.write_table(tmp_path / "joints.csv", dict(zip(names, np.degrees(joints).T, strict=True)))
    scenario = {**FIRST, "motion": {"dwell_s": 0.4}, "robot": {"model": "four-chains-arms", "commands": "joints.csv"}}
    done = simulate_robot(*scenario_from_dict(scenario), tmp_path).performance
    rests = [int(s.end_s * 100) for s in done.spans]
    np.testing.assert_allclose(done.requested[rests], joints, atol=1e-9)
    own = se3.compose(np.tile(se3.inverse(model.home), (len(joints), 1)), model.forward(joints))
    assert np.abs(se3.displacement(done.poses[rests], own)).max() < 1e-6


def test_a_platform_of_three_freedoms_is_simulated_certified_and_identified_by_command(tmp_path: Path) -> None:
    """From joint values of its cranks: robot/program.toml has the rests where its drawing attains them."""

    def run(*words: object) -> str:
        return ran(*words)

    cranks = np.random.default_rng(1).uniform(-40.0, 40.0, (14, 3))
    columns = {"name": [f"P{i}" for i in range(1, 15)], **dict(zip(("leg_1_deg", "leg_3_deg", "leg_5_deg"), cranks.T, strict=True))}
    files.write_table(tmp_path / "joints.csv", columns)
    motion = "motion = { dwell_s = 0.6, cycles = 2 }"
    robot = 'model = "crank-platform"\ncommands = "joints.csv"\nu_mm = 0.2\nu_deg = 0.02\nrepeatability_deg = 0.002'
    (tmp_path / "scenario.toml").write_text(f'schema = "lmeasure.scenario/1"\nrate_hz = 50.0\n{motion}\n[robot]\n{robot}\n')
    assert "in robot/: nominal robot, joints.csv of its rests and program.toml of their poses. True robot: robot/true/" in run(
        "simulate", tmp_path / "scenario.toml", "--out", tmp_path / "run"
    )
    folder = tmp_path / "run" / "robot"
    program, model = read_program(folder / "program.toml"), any_shipped("crank-platform").model
    assert [(p.name, p.cycles) for p in program.pose] == [(f"P{i}", 2) for i in range(1, 15)]
    # its tool is at the start when it is at home
    assert isinstance(model, Parallel)
    drawn = se3.compose(np.tile(se3.inverse(model.home), (14, 1)), model.forward(np.radians(cranks)))
    determined = np.array([[*p.position_mm, *p.quaternion_xyzw] for p in program.pose])
    assert np.abs(se3.displacement(determined, drawn)).max() < 1e-5
    run("reconstruct", tmp_path / "run", "--out", tmp_path / "trajectory.parquet")
    requested = ("--run", tmp_path / "run", "--program", folder / "program.toml", "--out", tmp_path / "certificate")
    assert "AP_p" in run("certify", tmp_path / "trajectory.parquet", *requested)
    built = ("--u-links-mm", 0.2, "--u-links-deg", 0.02, "--free", "links")
    measured = ("--measurements", tmp_path / "run", "--joints", folder / "joints.csv")
    out = run("identify", "--robot", folder / "robot.toml", *measured, *built, "--out", tmp_path / "identified")
    before, after = (float(v) for v in out.partition("mean error ")[2].partition(" mm after")[0].split(" mm before, "))
    assert after < 0.2 * before


def test_a_platform_of_three_freedoms_says_that_the_rest_follows(tmp_path: Path) -> None:
    waypoint = [{"position_mm": [0.0, 0.0, -2.0], "quaternion_xyzw": [0.02, 0.01, 0.0, np.sqrt(1 - 5e-4)]}]
    run = simulate_robot(*scenario_from_dict(of({"model": "crank-platform"}, waypoint=waypoint)), tmp_path)
    assert [text for text in run.remarks if "is commanded in rx, ry, z only. The other joints follow, and its tool is up to" in text]
    rest = int(run.performance.spans[0].end_s * 100) - 1
    assert run.performance.poses[rest, 2] == pytest.approx(-2.0, abs=1e-4)
    turn = se3.matrices(run.performance.poses[rest])[:, 2]
    np.testing.assert_allclose(turn, se3.matrices(np.array([0, 0, 0, *waypoint[0]["quaternion_xyzw"]]))[:, 2], atol=0.02)
