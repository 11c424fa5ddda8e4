"""Corrections: where a true robot goes when it is told what the identified one says, branches, limits, and the command from files."""

import json
from pathlib import Path

import numpy as np
import pytest
from in_process import code_and_text, ran, refused
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.robot_programs import fanuc, fits, krl, rapid, ur_script
from lmeasure.robots import IdentifiedRobot, Limits, RobotModel, in_keep_out, read_identified, ways
from lmeasure.robots.correction.error_map import correct
from lmeasure.robots.identification.record import Placed
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import SerialRobot

TOOL = np.array([10.0, 20.0, 150.0, 0.0, np.sin(0.1), 0.0, np.cos(0.1)])
BASE = np.array([1000.0, 50.0, -30.0, 0.0, 0.0, np.sin(0.6), np.cos(0.6)])
SIZES = {"theta_deg": 5e-4, "alpha_deg": 5e-4, "beta_deg": 5e-4, "d_mm": 0.3, "a_mm": 0.3}
HEADER = "name," + ",".join(f"joint_{i}_deg" for i in range(1, 7))


def true_robot(seed: int) -> SerialRobot:
    rng, nominal = np.random.default_rng(seed), shipped("generic6").model
    change = [rng.normal() * SIZES.get(p.name.rpartition(".")[2], 0.0) for p in nominal.parameters]
    return nominal.moved(np.array(change))


def joints_of(rng: np.random.Generator, number: int) -> FloatArray:
    low, high = shipped("generic6").model.limits
    q = rng.uniform(np.maximum(low, -2.0), np.minimum(high, 2.0), (number, 6))
    q[:, 4] = rng.choice([-1.0, 1.0], number) * rng.uniform(0.4, 1.6, number)
    return q


def places(robot: SerialRobot, joints: FloatArray) -> FloatArray:
    """(N, 3) of the target, as an instrument sees it."""
    return np.asarray(se3.compose(se3.compose(BASE, robot.forward(joints)), np.broadcast_to(TOOL, (len(joints), 7)))[:, :3])


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SerialRobot]:
    folder, rng, true = tmp_path_factory.mktemp("robot"), np.random.default_rng(2), true_robot(1)
    q = joints_of(rng, 100)
    xyz = places(true, q) + rng.normal(0.0, 0.02, (100, 3))
    rows = [f"p{i}," + ",".join(f"{v:.12g}" for v in (*np.degrees(a), *b)) for i, (a, b) in enumerate(zip(q, xyz, strict=True))]
    (folder / "m.csv").write_text("\n".join([HEADER + ",x_mm,y_mm,z_mm", *rows]) + "\n")
    ran("identify", "--robot", "generic6", "--measurements", folder / "m.csv", "--out", folder / "id", "--u-position-mm", "0.02")
    return folder, true


def test_the_true_robot_goes_where_it_was_meant_to(identified: tuple[Path, SerialRobot]) -> None:
    """In the instrument's frame, where the nominal robot would stand on the base that was found: as near as the stated U95 says."""
    folder, true = identified
    robot = read_identified(folder / "id")
    q = joints_of(np.random.default_rng(3), 120)
    found = [correct(robot.nominal, robot.found, one, Limits()) for one in q]
    # with the elbow stretched a shorter arm cannot go where the nominal one would
    refused = np.array([bool(c.refused) for c in found])
    assert {c.refused for c in found if c.refused} == {"the identified robot does not reach it"}
    assert refused.sum() <= 5
    q, found = q[~refused], [c for c in found if not c.refused]
    assert max(c.left_mm for c in found) < 1e-6
    wanted = se3.compose(se3.compose(robot.base, robot.nominal.forward(q)), np.broadcast_to(robot.tool, (len(q), 7)))[:, :3]
    solved = np.array([c.joints for c in found])
    before = np.linalg.norm(places(true, q) - wanted, axis=1)
    after = np.linalg.norm(places(true, solved) - wanted, axis=1)
    assert np.median(after) < 0.1 * np.median(before)
    u95 = robot.u95_mm(solved)
    assert np.mean(after < u95) > 0.9
    assert u95.max() < 0.15
    # the told pose, reached by the nominal robot, is that of the corrected joint values
    for one, c in zip(q[:10], found, strict=False):
        assert np.abs(robot.nominal.forward(c.joints[None])[0] - c.flange).max() < 1e-9
        assert ways(robot.nominal, c.flange, one)[0] == pytest.approx(c.joints, abs=1e-8)


def test_u95_is_the_identification_s_own(identified: tuple[Path, SerialRobot]) -> None:
    """Derivatives by differences of the model itself, one parameter after the other."""
    folder, _ = identified
    robot = read_identified(folder / "id")
    q = joints_of(np.random.default_rng(4), 3)
    rows = robot._rows(q)

    def seen(own: RobotModel, base: FloatArray, tool: FloatArray) -> FloatArray:
        return np.asarray(se3.compose(se3.compose(base, own.forward(q)), np.broadcast_to(tool, (3, 7)))[:, :3])

    every = [p.name for p in robot.found.parameters]
    for k, name in enumerate(robot.names):
        both = []
        for sign in (1.0, -1.0):
            h = sign * 1e-4
            own, base, tool = robot.found, robot.base, robot.tool
            if name in every:
                change = np.zeros(len(every))
                change[every.index(name)] = h * robot.found.parameters[every.index(name)].size
                own = own.moved(change)
            else:
                key = name.rpartition(".")[2]
                axis = ["rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm"].index(key)
                delta = np.eye(6)[axis] * (np.radians(h) if axis < 3 else h)
                base, tool = (se3.displaced(base, delta), tool) if name.startswith("base") else (base, se3.displaced(tool, delta))
            both.append(seen(own, base, tool))
        np.testing.assert_allclose(rows[:, :, k], (both[0] - both[1]) / 2e-4, rtol=1e-5, atol=1e-5)


def test_limits(identified: tuple[Path, SerialRobot]) -> None:
    folder, _ = identified
    robot = read_identified(folder / "id")
    q = joints_of(np.random.default_rng(5), 1)[0]
    small = correct(robot.nominal, robot.found, q, Limits(most_mm=0.05))
    assert small.refused.endswith("° exceeds the limits, 0.05 mm and 1°")
    assert np.array_equal(small.joints, q)
    clipped = correct(robot.nominal, robot.found, q, Limits(most_mm=0.05, clip=True))
    assert clipped.clipped
    assert not clipped.refused
    assert clipped.size_mm == pytest.approx(0.05, rel=1e-3)
    assert 0.0 < clipped.left_mm < clipped.was_mm
    low, _ = robot.nominal.limits
    at_limit = q.copy()
    at_limit[1] = low[1]
    beyond = [correct(robot.nominal, robot.found, np.where(np.arange(6) == 1, v, q), Limits()) for v in (low[1], low[1] + 1e-9)]
    assert any("outside its limit" in c.refused for c in beyond) or all((c.joints >= low).all() for c in beyond)
    wrist = np.array([0.3, 0.2, 0.4, 0.5, 1e-5, 0.1])
    assert "a singular pose is near" in correct(robot.nominal, robot.found, wrist, Limits()).refused


def test_boxes_are_kept_out_of_on_the_way_too() -> None:
    limits = Limits(keep_out=(np.array([[0.0, 10.0], [0.0, 10.0], [0.0, 10.0]]),))
    assert in_keep_out(limits, np.array([[-5.0, 5.0, 5.0], [-1.0, 5.0, 5.0]])) is None
    assert in_keep_out(limits, np.array([[-5.0, 5.0, 5.0], [15.0, 5.0, 5.0]])) == 1
    assert in_keep_out(limits, np.array([[5.0, 5.0, 5.0]])) == 0
    assert in_keep_out(limits, np.array([[-5.0, -5.0, 5.0], [20.0, 9.0, 5.0]])) == 1
    assert in_keep_out(limits, np.array([[-5.0, -5.0, 5.0], [20.0, -1.0, 5.0]])) is None


def _arm(robot: SerialRobot, q: FloatArray) -> tuple[bool, bool]:
    """(behind, up) of an arm that faces along X at zero, by its points in the upright plane of its first joint."""
    points, _ = robot.arm.axes(q[None])
    shoulder, elbow, wrist = (points[0, i] for i in (1, 2, 4))
    front = np.array([np.cos(q[0]), np.sin(q[0]), 0.0])
    (e, w) = (np.array([(p - shoulder) @ front, (p - shoulder)[2]]) for p in (elbow, wrist))
    return bool(wrist @ front < 0.0), bool(e[0] * w[1] - e[1] * w[0] < 0.0)


def test_what_configurations_say() -> None:
    robot = shipped("generic6").model
    q = np.zeros(6)
    for q in joints_of(np.random.default_rng(8), 60):
        behind, up = _arm(robot, q)
        t = sum(1 << i for i in range(6) if q[i] < 0.0)
        quarters = {f"cf{i}": int(np.floor(np.degrees(q[i - 1]) / 90.0)) for i in (1, 4, 6)}
        cfx = 4 * int(behind) + int(q[4] < 0.0)
        for wrong in (False, True):
            assert fits(krl.DIALECT, {"S": int(behind) + 2 * int(up != wrong), "T": t}, robot, q) != wrong
            assert fits(krl.DIALECT, {"S": int(behind) + 2 * int(up), "T": t ^ int(wrong)}, robot, q) != wrong
            assert fits(rapid.DIALECT, quarters | {"cfx": cfx ^ (4 * int(wrong))}, robot, q) != wrong
            assert fits(rapid.DIALECT, quarters | {"cf4": quarters["cf4"] + int(wrong), "cfx": cfx}, robot, q) != wrong
            turns = {"turn1": 0, "turn2": 0, "turn3": 0}
            assert fits(fanuc.DIALECT, turns | {"front": int(behind == wrong), "up": int(up)}, robot, q) != wrong
            assert fits(fanuc.DIALECT, turns | {"front": int(not behind), "up": int(up != wrong)}, robot, q) != wrong
    assert fits(ur_script.DIALECT, {}, robot, q)
    assert fits(krl.DIALECT, {}, robot, q)


def program(folder: Path, robot: IdentifiedRobot, q: FloatArray) -> Path:
    """A KRL program of these targets with their T, in a base and with a tool."""
    base, tool = np.array([100.0, 0, 0, 0, 0, 0, 1.0]), np.array([0, 0, 120.0, 0, 0, 0, 1.0])
    lines = ["DEF P( )", "$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}", "$TOOL={X 0,Y 0,Z 120,A 0,B 0,C 0}"]
    home = ",".join(f"A{i + 1} {v:.6f}" for i, v in enumerate(np.degrees(q[0])))
    lines.append(f"PTP {{{home}}} ; start")
    for one in q:
        pose = se3.compose(se3.compose(se3.inverse(base), robot.nominal.forward(one[None])[0]), tool)
        a, b, c = se3.rotation(pose).as_euler("ZYX", degrees=True)
        t = sum(1 << i for i in range(6) if one[i] < 0.0)
        assert isinstance(robot.nominal, SerialRobot)
        behind, up = _arm(robot.nominal, one)
        numbers = f"X {pose[0]:.6f},Y {pose[1]:.6f},Z {pose[2]:.6f},A {a:.8f},B {b:.8f},C {c:.8f},S {int(behind) + 2 * int(up)},T {t}"
        lines.append(f"LIN {{{numbers}}} ; to part")
    path = folder / "p.src"
    path.write_bytes("\r\n".join([*lines, "PTP HOME", "END", ""]).encode())
    return path


def test_a_placed_robot_moves_as_its_derivatives_say() -> None:
    """Beside differences of its forward kinematics, and its inverse beside its forward one."""
    rng, robot = np.random.default_rng(8), true_robot(8)
    placed = Placed(robot, BASE, TOOL)
    q, h = joints_of(rng, 3), 1e-6
    poses, by_joints, by_parameters = placed.derivatives(q)
    np.testing.assert_allclose(poses, se3.compose(se3.compose(BASE, robot.forward(q)), TOOL), atol=1e-9)
    changes = [(h * step, None) for step in np.eye(6)] + [(np.zeros(6), h * step) for step in np.eye(len(robot.parameters))]
    found = np.concatenate([by_joints, by_parameters], axis=1)
    for k, (turn, change) in enumerate(changes):
        ahead, behind = ((placed if change is None else placed.moved(s * change)).forward(q + s * turn) for s in (1.0, -1.0))
        moved = (se3.displacement(ahead, poses) - se3.displacement(behind, poses)) / (2.0 * h)
        twist = np.concatenate([moved[:, :3], moved[:, 3:] + np.cross(poses[:, :3], moved[:, :3])], axis=1)
        np.testing.assert_allclose(found[:, k], twist, atol=2e-3, rtol=1e-5)
    assert any(np.allclose(one, q[0], atol=1e-8) for one in Placed(shipped("generic6").model, BASE, TOOL).inverse(
        se3.compose(se3.compose(BASE, shipped("generic6").model.forward(q[:1])[0]), TOOL)))  # fmt: skip


def test_a_stated_base_and_tool_make_the_robot_right_in_the_instruments_frame(identified: tuple[Path, SerialRobot]) -> None:
    """The base stands 1.5 mm and the target sits 0.8 mm from where they are meant to: that is corrected with the rest."""
    folder, true = identified
    meant_base, meant_tool = BASE + np.array([1.0, -1.0, 0.5, 0, 0, 0, 0]), TOOL + np.array([0.5, 0.5, -0.4, 0, 0, 0, 0])
    robot = read_identified(folder / "id").stated(meant_base, meant_tool)
    q = joints_of(np.random.default_rng(9), 40)
    found = [correct(robot.nominal, robot.seen, one, Limits()) for one in q]
    q, solved = q[[not c.refused for c in found]], np.array([c.joints for c in found if not c.refused])
    wanted = se3.compose(se3.compose(meant_base, robot.nominal.forward(q)), np.broadcast_to(meant_tool, (len(q), 7)))[:, :3]
    before, after = (np.linalg.norm(places(true, at) - wanted, axis=1) for at in (q, solved))
    assert before.mean() > 1.5
    assert np.mean(after <= robot.u95_mm(solved)) >= 0.9
    assert after.max() < 0.15
    assert (robot.u_mm(solved) < robot.u95_mm(solved)).all()


def test_the_command(identified: tuple[Path, SerialRobot], tmp_path: Path) -> None:
    folder, true = identified
    robot = read_identified(folder / "id")
    q = joints_of(np.random.default_rng(6), 25)
    path = program(tmp_path, robot, q)
    done = ran("correct", path, "--identified", folder / "id", "--out", tmp_path / "out")
    assert "not corrected: p.src:30: PTP HOME: no declaration with values here" in done
    record = json.loads((tmp_path / "out" / "corrections.json").read_text())
    assert record["corrected"] == 26
    assert all(t["error_left_mm"] < 1e-6 and t["u95_mm"] < 0.15 for t in record["targets"])
    old, new = path.read_bytes().split(b"\r\n"), (tmp_path / "out" / "p.src").read_bytes().split(b"\r\n")
    assert [o for o, n in zip(old, new, strict=True) if o == n] == old[:3] + old[-3:]
    # a controller that reads the new file sends the true robot where the old one was meant to be
    wanted = se3.compose(se3.compose(robot.base, robot.nominal.forward(q)), np.broadcast_to(robot.tool, (len(q), 7)))[:, :3]
    determined = np.array([t["corrected_values"] for t in record["targets"][1:]])
    pose = se3.pose(determined[:, :3], Rotation.from_euler("ZYX", determined[:, 3:], degrees=True))
    of_base, of_tool = (np.broadcast_to([x, 0.0, z, 0.0, 0.0, 0.0, 1.0], pose.shape) for x, z in ((100.0, 0.0), (0.0, -120.0)))
    flange = se3.compose(se3.compose(of_base, pose), of_tool)
    went = np.array([ways(robot.nominal, f, one)[0] for f, one in zip(flange, q, strict=True)])
    assert np.linalg.norm(places(true, went) - wanted, axis=1).max() < 0.15
    box = ["--out", str(tmp_path / "b"), "--keep-out", "-5000:5000,-5000:5000,-5000:5000"]
    assert "0 of 26 targets corrected" in code_and_text("correct", path, "--identified", folder / "id", *box)[1]


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--near", "1,2"], 2, "2 joint values. The robot has 6"),
        (["--dialect", "cobol"], 2, "'cobol' is none of"),
        (["--frames", "{tmp}/f.toml"], 1, "[BASE]: turn is not known. Known: fanuc_wpr_deg"),
        (["--skip", "nobody"], 2, "no target 'nobody'"),
    ],
)
def test_what_cannot_be_is_one_line(
    identified: tuple[Path, SerialRobot], tmp_path: Path, arguments: list[str], code: int, text: str
) -> None:
    folder, _ = identified
    (tmp_path / "f.toml").write_text("[BASE]\nturn = [1, 2, 3]\n")
    path = program(tmp_path, read_identified(folder / "id"), joints_of(np.random.default_rng(6), 2))
    given = [a.replace("{tmp}", str(tmp_path)) for a in arguments]
    assert text in " ".join(refused("correct", path, "--identified", folder / "id", "--out", tmp_path / "o", *given, code=code).split())
    assert not (tmp_path / "o").exists()


def test_an_identification_that_is_none(tmp_path: Path, identified: tuple[Path, SerialRobot]) -> None:
    folder, _ = identified
    (tmp_path / "robot.toml").write_bytes((folder / "id" / "robot.toml").read_bytes())
    (tmp_path / "identified.json").write_text('{"parameters": []}')
    path = program(tmp_path, read_identified(folder / "id"), joints_of(np.random.default_rng(6), 2))
    assert "not written by `lmeasure identify`" in refused("correct", path, "--identified", tmp_path, "--out", tmp_path / "o")
