"""Programs that state joint values and the pose of one point, in every dialect that can: both are corrected to one place, and frames that
are not the controller's are refused. Poses are computed by matrices from the table of links, by no code of lmeasure."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from kinematics_readers import Matrix, by_table
from scipy.spatial.transform import Rotation

from lmeasure.core import RobotError
from lmeasure.io import Column, columns_of
from lmeasure.robot_programs import Corrected, Source, corrected_program, dialect_of
from lmeasure.robots import IdentifiedRobot, Limits, Robot, write_robot
from lmeasure.robots.model import Frame
from lmeasure.robots.robot import Revolute, shipped

HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TURNED = Frame(position_mm=(0.0, 0.0, 0.0), quaternion_xyzw=(0.0, 0.0, 1.0, 0.0))
AHEAD = Frame(position_mm=(0.0, 0.0, 100.0), quaternion_xyzw=(0.0, float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5))))
ROBOT = shipped("generic6").model_copy(update={"base": TURNED, "flange": AHEAD})
"""As its controller has it: the base turned by half a turn, the flange 100 mm on and turned by a quarter."""
POINTS = {
    "pick": (12.0, -20.0, 25.0, 30.0, 50.0, -15.0),
    "place": (-35.0, -5.0, 10.0, -20.0, 65.0, 40.0),
    "drop": (60.0, -30.0, 40.0, 15.0, -40.0, 5.0),
}
ENDS = {"ur": "p.script", "krl": "p.src", "rapid": "p.mod", "fanuc": "p.ls", "fanuc-both": "p.ls", "csv": "p.csv", "robodk": "p.csv"}


def pose(robot: Robot, degrees: tuple[float, ...], tmp_path: Path) -> Matrix:
    write_robot(tmp_path / "oracle.toml", robot)
    return by_table(tmp_path / "oracle.toml", {f"joint_{i + 1}": np.radians(v) for i, v in enumerate(degrees)})


def program(dialect: str, points: Mapping[str, tuple[tuple[float, ...], Matrix]]) -> str:
    """Every point by its joint values and by its pose, with the digits that controllers write."""
    lines, data = list[str](), list[str]()
    for number, (name, (q, at)) in enumerate(points.items(), 1):
        xyz, turn = at[:3, 3], Rotation.from_matrix(at[:3, :3])
        rx, ry, rz = turn.as_euler("xyz", degrees=True)
        x, y, z, w = turn.as_quat()
        deg, mm = [f"{v:.4f}" for v in q], [f"{v:.3f}" for v in xyz]
        if dialect == "ur":
            v = turn.as_rotvec()
            data.append(f"  global {name}_p=p[{', '.join(f'{t:.6f}' for t in (*(xyz / 1e3), *v))}]")
            data.append(f"  global {name}_q=[{', '.join(f'{np.radians(t):.6f}' for t in q)}]")
            lines.append(f"  movej(get_inverse_kin({name}_p, qnear={name}_q), a=1.4, v=1.05)")
        elif dialect == "krl":
            axes = ", ".join(f"A{i + 1} {t}" for i, t in enumerate(deg))
            data.append(f"DECL E6AXIS {name}_j={{{axes}}}")
            data.append(f"DECL E6POS {name}_p={{X {mm[0]}, Y {mm[1]}, Z {mm[2]}, A {rz:.4f}, B {ry:.4f}, C {rx:.4f}}}")
            lines += [f"PTP {name}_j", f"LIN {name}_p"]
        elif dialect == "rapid":
            data.append(f"CONST jointtarget j{name.title()}:=[[{','.join(deg)}],[9E9,9E9,9E9,9E9,9E9,9E9]];")
            cf = [int(np.floor(q[i] / 90.0)) for i in (0, 3, 5)]
            data.append(
                f"CONST robtarget p{name.title()}:=[[{','.join(mm)}],[{w:.7f},{x:.7f},{y:.7f},{z:.7f}],"
                f"[{cf[0]},{cf[1]},{cf[2]},{int(q[4] < 0)}],[9E9,9E9,9E9,9E9,9E9,9E9]];"
            )
            lines += [f"MoveAbsJ j{name.title()},v100,fine,tool0;", f"MoveL p{name.title()},v100,fine,tool0;"]
        elif dialect.startswith("fanuc"):
            axes = ",".join(f"J{i + 1}= {t:.3f} deg" for i, t in enumerate(q))
            place = f"X = {mm[0]} mm, Y = {mm[1]} mm, Z = {mm[2]} mm,\n W = {rx:.3f} deg, P = {ry:.3f} deg, R = {rz:.3f} deg"
            if dialect == "fanuc-both":
                lines.append(f"  {number}:J P[{number}] 20% FINE ;")
                data.append(f"P[{number}]{{\n GP1:\n UF : 0, UT : 0,\n {axes},\n {place}\n}};")
            else:
                lines += [f"  :J P[{2 * number - 1}:{name}] 20% FINE ;", f"  :L P[{2 * number}:{name}] 100mm/sec FINE ;"]
                data.append(f'P[{2 * number - 1}:"{name}"]{{\n GP1:\n UF : 0, UT : 0,\n {axes}\n}};')
                data.append(f'P[{2 * number}:"{name}"]{{\n GP1:\n UF : 0, UT : 0,\n {place}\n}};')
        else:
            places = [*mm, x, y, z, w] if dialect == "csv" else [*mm, rx, ry, rz]
            lines.append(",".join([name, *deg, *(str(v) for v in places)]))
    if dialect == "ur":
        return "\n".join(["def p():", "  set_tcp(p[0,0,0,0,0,0])", *data, *lines, "end", ""])
    if dialect == "krl":
        return "\n".join(["DEF p()", *data, "$BASE=$NULLFRAME", "$TOOL=$NULLFRAME", *lines, "END", ""])
    if dialect == "rapid":
        return "\n".join(["MODULE p", *data, "PROC main()", *lines, "ENDPROC", "ENDMODULE", ""])
    if dialect.startswith("fanuc"):
        return "\n".join(["/PROG P", "/MN", *lines, "/POS", *data, "/END", ""])
    joints = [f"joint_{i}_deg" if dialect == "csv" else f"J{i}" for i in range(1, 7)]
    names = ["x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"] if dialect == "csv" else ["X", "Y", "Z", "Rx", "Ry", "Rz"]
    return "\n".join([",".join(["name", *joints, *names]), *lines, ""])


def corrected(robot: Robot, name: str, text: str, near: tuple[float, ...] = (), columns: dict[str, Column] | None = None) -> Corrected:
    """Corrected for the robot with a shoulder that is 0.05 degrees off."""
    model = robot.model
    names = [p.name for p in model.parameters]
    change = np.zeros(len(names))
    change[names.index("joint_2.theta_deg")] = np.radians(0.05)
    known = IdentifiedRobot(
        model, model.moved(change), HERE, HERE, ("joint_2.theta_deg",), np.array([[1e-6]]), 0.01, 30.0, 1.0, True, model
    )
    known = known.stated(None, None)
    sources = (Source(name, text),)
    dialect = dialect_of([Path(name)], sources, columns=columns)
    return corrected_program(dialect.read(sources).stated({}), dialect, known, limits=Limits(), near=near)


@pytest.mark.parametrize("dialect", ENDS)
def test_joint_values_and_pose_of_a_point_become_one_place(dialect: str, tmp_path: Path) -> None:
    points = {name: (q, pose(ROBOT, q, tmp_path)) for name, q in POINTS.items()}
    done = corrected(ROBOT, ENDS[dialect], program(dialect, points), near=next(iter(POINTS.values())))
    assert {o.left for o in done.outcomes} == {""}
    poses = [o for o in done.outcomes if not o.target.joints]
    assert len(poses) == len(POINTS)
    for outcome, (q, at) in zip(poses, points.values(), strict=True):
        assert outcome.correction is not None
        joints = np.degrees(outcome.correction.joints)
        assert joints[1] == pytest.approx(q[1] - 0.05, abs=5e-3)  # rounding of the programs
        determined = pose(ROBOT, tuple(joints), tmp_path)
        size = 1000.0 if dialect == "ur" else 1.0
        np.testing.assert_allclose(size * np.array(outcome.values[:3]), determined[:3, 3], atol=2e-2)
        assert 0.1 < np.linalg.norm(determined[:3, 3] - at[:3, 3]) < 3.0
    for outcome, (q, _) in zip([o for o in done.outcomes if o.target.joints], points.values(), strict=dialect != "ur"):
        assert outcome.values == pytest.approx((q[0], q[1] - 0.05, *q[2:]), abs=5e-3)


WRONG: dict[str, tuple[dict[str, object], str]] = {
    "base": ({"base": None}, r"its base differs from the controller's by .* a turn of -?0\.0, -?0\.0, -?180\.0°.*--base-link"),
    "flange": ({"flange": None}, r"the robot's flange at its joint values is 100\.0 mm and 90\.0° from .*; its flange differs .*--tip"),
    "near": (
        {"flange": Frame(position_mm=(0.0, 25.0, 100.0), quaternion_xyzw=AHEAD.quaternion_xyzw)},
        "is 25.0 mm and 0.0°.* its flange differs",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("dialect", ENDS)
def test_frames_that_are_not_the_controller_s_are_refused(dialect: str, wrong: str, tmp_path: Path) -> None:
    points = {name: (q, pose(ROBOT, q, tmp_path)) for name, q in POINTS.items()}
    robot = ROBOT.model_copy(update=WRONG[wrong][0])
    with pytest.raises(RobotError, match=WRONG[wrong][1]) as caught:
        corrected(robot, ENDS[dialect], program(dialect, points), near=next(iter(POINTS.values())))
    assert re.match(rf"{ENDS[dialect]}:\d+: ", str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dialect", ["ur", "csv", "fanuc"])
def test_an_arm_that_errs_is_no_contradiction(dialect: str, tmp_path: Path) -> None:
    """The controller knows its own arm, 3 mm and 0.2 degrees off the nominal one."""
    own = ROBOT.with_values({"joint_2.theta_deg": ROBOT.joint[1].theta_deg + 0.1, "joint_3.d_mm": 2.0, "joint_4.alpha_deg": 90.1})
    points = {name: (q, pose(own, q, tmp_path)) for name, q in POINTS.items()}
    assert 2.0 < np.linalg.norm((points["pick"][1] - pose(ROBOT, POINTS["pick"], tmp_path))[:3, 3]) < 8.0
    done = corrected(ROBOT, ENDS[dialect], program(dialect, points), near=next(iter(POINTS.values())))
    assert {o.left for o in done.outcomes} == {""}


def test_a_rough_hint_is_no_evidence_and_a_far_one_is_not_followed(tmp_path: Path) -> None:
    rough = {
        name: (tuple(np.round(v, -1) + s for v, s in zip(q, (5.0, -20.0, 15.0, 10.0, 10.0, -10.0), strict=True)), pose(ROBOT, q, tmp_path))
        for name, q in POINTS.items()
    }
    assert {o.left for o in corrected(ROBOT, "p.script", program("ur", rough)).outcomes} == {""}
    # one posture beside all poses is a hint; of a single point it says too little unless it is far off
    same = {name: (POINTS["pick"], at) for name, (_, at) in rough.items()}
    assert len([o for o in corrected(ROBOT, "p.script", program("ur", same)).outcomes if not o.left]) >= 2
    far = {name: ((q[0] + (175.0 if name == "pick" else -170.0), *q[1:]), at) for name, (q, at) in rough.items()}
    assert any("none of its" in o.left and "within 90°" in o.left for o in corrected(ROBOT, "p.script", program("ur", far)).outcomes)


def test_one_row_that_contradicts_itself_is_left(tmp_path: Path) -> None:
    points = {name: (q, pose(ROBOT, q, tmp_path)) for name, q in POINTS.items()}
    points["drop"][1][:3, 3] += [0.0, 80.0, 0.0]
    left = {o.target.name: o.left for o in corrected(ROBOT, "p.csv", program("csv", points)).outcomes if o.left}
    assert list(left) == ["drop"]
    assert left["drop"].startswith("its pose and its joint values differ by 80.0 mm")
    # joint values of another robot: no frame explains them
    other = {name: ((q[0], -q[1], *q[2:]), at) for name, (q, at) in points.items()}
    with pytest.raises(RobotError, match="no other base or flange explains it"):
        corrected(ROBOT, "p.csv", program("csv", other))


def test_a_third_axis_counted_from_the_horizontal_is_named_and_can_be_stated(tmp_path: Path) -> None:
    points = {name: ((*q[:2], q[2] - q[1], *q[3:]), pose(ROBOT, q, tmp_path)) for name, q in POINTS.items()}
    text, near = program("fanuc", points), points["pick"][0]
    with pytest.raises(RobotError, match=r"; joint_3 is counted from the horizontal: add a link that follows joint_2 by 1 "):
        corrected(ROBOT, "p.ls", text, near)
    level = Revolute(name="level", follows="joint_2", ratio=1.0)
    coupled = ROBOT.model_copy(update={"joint": (*ROBOT.joint[:2], level, *ROBOT.joint[2:])})
    done = corrected(coupled, "p.ls", text, near)
    assert {o.left for o in done.outcomes} == {""}
    for outcome, (q, _) in zip([o for o in done.outcomes if o.target.joints], points.values(), strict=True):
        assert outcome.values == pytest.approx((q[0], q[1] - 0.05, q[2] + 0.05, *q[3:]), abs=5e-3)


def test_a_table_in_other_units_is_written_back_in_them(tmp_path: Path) -> None:
    """Metres, a rotation vector in radians and joint values in radians under headers of their own, names in a column without a name."""
    points = {name: (q, pose(ROBOT, q, tmp_path)) for name, q in POINTS.items()}
    lines = [",X,Y,Z,U,V,W," + ",".join(f"A{i}" for i in range(1, 7))]
    for name, (q, at) in points.items():
        numbers = [*(at[:3, 3] / 1e3), *Rotation.from_matrix(at[:3, :3]).as_rotvec(), *np.radians(q)]
        lines.append(",".join([name, *(f"{v:.7f}" for v in numbers)]))
    columns = columns_of("x=X[m],y=Y[m],z=Z[m],rx=U[rad],ry=V[rad],rz=W[rad]," + ",".join(f"joint_{i}=A{i}[rad]" for i in range(1, 7)))
    done = corrected(ROBOT, "p.csv", "\n".join([*lines, ""]), columns=columns)
    rows = [line.split(",") for line in done.texts[0].splitlines()[1:]]
    assert [row[0] for row in rows] == list(POINTS)
    for row, q in zip(rows, POINTS.values(), strict=True):
        joints = np.degrees([float(v) for v in row[7:]])
        assert joints == pytest.approx((q[0], q[1] - 0.05, *q[2:]), abs=2e-5)
        determined = pose(ROBOT, tuple(joints), tmp_path)
        np.testing.assert_allclose([1e3 * float(v) for v in row[1:4]], determined[:3, 3], atol=2e-3)
        np.testing.assert_allclose(Rotation.from_rotvec([float(v) for v in row[4:7]]).as_matrix(), determined[:3, :3], atol=1e-6)
    for text, said in (
        ("x=Q[m]", "has no such column. It has x, y, z"),
        ("rx=U", "angles with their unit"),
        ("speed=X", "a table of targets has"),
    ):
        with pytest.raises(RobotError, match=said):
            corrected(ROBOT, "p.csv", "\n".join(lines), columns=columns_of(text))
    with pytest.raises(RobotError, match="works only with tables"):
        corrected(ROBOT, "p.mod", "", columns=columns)
