"""URDFs and tables of others through the commands: from the arm to the corrected program, in the frames of its controller."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from in_process import code_and_text
from kinematics_readers import Matrix, shift, turn
from scipy.spatial.transform import Rotation

CASES = Path(__file__).parents[1] / "authorities"
OFF = np.radians([0.0, 0.06, -0.05, 0.0, 0.04, 0.0])
"""By which the joints of the built arm are off."""


def ran(*arguments: object, refused: bool = False) -> str:
    code, text = code_and_text(*arguments)
    assert (code != 0) == refused, text
    return text.replace("\n", " ")


def flange(degrees: object, off: object = 0.0) -> Matrix:
    """base_link_from_tool0 of the arm of `urdf-flange-lost`, written down from its file."""
    q = np.radians(np.asarray(degrees)) + off
    at = (
        shift([0, 0, 400])
        @ turn([0, 0, 1], q[0])
        @ shift([150, 0, 0])
        @ turn([0, 1, 0], q[1])
        @ shift([0, 0, 600])
        @ turn([0, -1, 0], q[2])
    )
    at = (
        at
        @ shift([0, 0, 100])
        @ turn([-1, 0, 0], q[3])
        @ shift([650, 0, 0])
        @ turn([0, -1, 0], q[4])
        @ shift([100, 0, 0])
        @ turn([-1, 0, 0], q[5])
    )
    return np.asarray(at @ shift([100, 0, 0]) @ turn([0, 1, 0], -np.pi / 2) @ turn([1, 0, 0], np.pi))


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, case = tmp_path_factory.mktemp("arm") / "id", CASES / "urdf-flange-lost"
    names = ",".join(f"joint_{i}_deg" for i in range(1, 7))
    requested = f"name,{names},target\na,10,15,-20,30,40,-25,tool\nb,10,15,-20,30,40,-25,ball\n"
    (out.parent / "asked.csv").write_text(requested, encoding="utf-8")
    said = ran(
        "identify", "--robot", case / "arm.urdf", "--measurements", case / "measured.csv", "--out", out, "--free", "links", "--predict",
        out.parent / "asked.csv",
    )  # fmt: skip
    assert "of the .urdf: base 'base_link' (--base-link), flange 'tool0' (--tip)" in said
    assert "warning predict: target 'ball' was not measured (measured: tool). Its 1 row is not used" in said
    return out


def test_one_unknown_target_is_named_and_the_others_are_predicted(identified: Path) -> None:
    rows = pd.read_csv(identified / "predictions.csv")
    assert list(rows["name"]) == ["a"]
    np.testing.assert_allclose(
        rows.loc[0, ["x_mm", "y_mm", "z_mm"]].to_numpy(float), flange([10, 15, -20, 30, 40, -25], OFF)[:3, 3], atol=0.03
    )


def test_the_flange_of_a_urdf_is_that_of_its_programs(identified: Path, tmp_path: Path) -> None:
    case = CASES / "urdf-flange-lost"
    ran(
        "correct", case / "same.ls", "--identified", identified, "--frames", case / "frames.toml", "--near", "10,15,-20,30,40,-25",
        "--out", tmp_path / "c",
    )  # fmt: skip
    by_joints, by_pose = (t["corrected_values"] for t in json.loads((tmp_path / "c" / "corrections.json").read_text())["targets"])
    np.testing.assert_allclose(by_joints, [10, 14.94, -19.95, 30, 39.96, -25], atol=2e-3)
    want = flange([10, 14.94, -19.95, 30, 39.96, -25])
    np.testing.assert_allclose(by_pose[:3], want[:3, 3], atol=0.02)
    assert (Rotation.from_euler("xyz", by_pose[3:], degrees=True).inv() * Rotation.from_matrix(want[:3, :3])).magnitude() < 5e-5
    record = json.loads((identified / "identified.json").read_text())
    np.testing.assert_allclose(record["nominal_flange"]["position_mm"], [0, 0, -200], atol=1e-9)
    # joint values and pose of one point, named so: the frames are those of the program, and are not where the tool is another
    both = (case / "same.ls").read_text().replace("P[1]{", 'P[1:"same"]{').replace("P[2]{", 'P[2:"same"]{')
    (tmp_path / "both.ls").write_text(both)
    wanted = ["--identified", identified, "--near", "10,15,-20,30,40,-25"]
    ran("correct", tmp_path / "both.ls", *wanted, "--frames", case / "frames.toml", "--out", tmp_path / "d")
    (tmp_path / "other.toml").write_text('["UT[1]"]\nposition_mm = [0.0, 0.0, 120.0]\n["UF[0]"]\nposition_mm = [0.0, 0.0, 0.0]\n')
    said = ran("correct", tmp_path / "both.ls", *wanted, "--frames", tmp_path / "other.toml", "--out", tmp_path / "e", refused=True)
    assert "120.0 mm and 0.0° from where its pose has it" in said
    assert not (tmp_path / "e").exists()


def test_a_mimic_joint_elsewhere_and_a_tool_on_the_flange(tmp_path: Path) -> None:
    robot, out = CASES / "urdf-mimic-elsewhere" / "arm.urdf", tmp_path / "joints.csv"
    ran("plan-poses", "--robot", robot, "--poses", "10", "--tool", "30,0,100", "--out", out)
    joints, poses = pd.read_csv(out), pd.read_csv(tmp_path / "joints_poses.csv")
    for (_, q), (_, at) in zip(joints.iterrows(), poses.iterrows(), strict=True):
        a1, a2, a3 = np.radians([q["a1_deg"], q["a2_deg"], q["a3_deg"]])
        own = shift([0, 0, 400]) @ turn([0, 0, 1], a1) @ shift([100, 0, 0]) @ turn([0, 1, 0], a2) @ shift([0, 0, 500]) @ turn([0, 1, 0], a3)
        np.testing.assert_allclose([at["x_mm"], at["y_mm"], at["z_mm"]], (own @ [30, 0, 100, 1])[:3], atol=1e-6)
    # joint values of others to choose from, by their own headers
    table = joints.rename(columns={"name": "", "a1_deg": "A1"})
    table["A1"] = np.radians(table["A1"])
    table.to_csv(tmp_path / "given.csv", index=False)
    ran(
        "plan-poses", "--robot", robot, "--poses", "5", "--tool", "30,0,100", "--candidates", tmp_path / "given.csv", "--columns",
        "name=1,a1=A1[rad]", "--out", tmp_path / "few.csv",
    )  # fmt: skip
    assert set(pd.read_csv(tmp_path / "few.csv")["name"]) <= set(joints["name"])


def test_a_table_as_pandas_writes_it(tmp_path: Path) -> None:
    table = CASES / "unnamed-column" / "robot.csv"
    ran("frames", "--robot", table, "--measured", table, "--out", tmp_path / "f.json")
    found = json.loads((tmp_path / "f.json").read_text())
    np.testing.assert_allclose([*found["base"]["position_mm"], *found["tool"]["position_mm"]], np.zeros(6), atol=1e-4)
    # a running index, other headers in metres, one of the two tables by its own names
    other = pd.read_csv(table).rename(columns={"Unnamed: 0": "which", "x_mm": "X"})
    other["X"] /= 1000.0
    other.to_csv(tmp_path / "other.csv")
    said = ("frames", "--robot", table, "--measured", tmp_path / "other.csv", "--columns", "pose=which,x=X[m]")
    ran(*said, "--out", tmp_path / "g.json")
    np.testing.assert_allclose(json.loads((tmp_path / "g.json").read_text())["base"]["position_mm"], np.zeros(3), atol=1e-4)
    assert "neither" in ran(*said[:-1], "pose=which,x=W[m]", "--out", tmp_path / "i.json", refused=True)


def test_rapid_targets_whose_configuration_is_not_fixed_ask_for_near(identified: Path, tmp_path: Path) -> None:
    at = flange([10, 15, -20, 30, 40, -25])
    x, y, z, w = Rotation.from_matrix(at[:3, :3]).as_quat()
    target = f"CONST robtarget p10:=[[{','.join(f'{v:.4f}' for v in at[:3, 3])}],[{w:.9f},{x:.9f},{y:.9f},{z:.9f}],[0,0,-1,0],"
    target += "[9E9,9E9,9E9,9E9,9E9,9E9]];"
    program = f"MODULE m\n{target}\nPROC main()\nConfL \\Off;\nConfJ \\Off;\nMoveL p10,v100,fine,tool0;\nENDPROC\nENDMODULE\n"
    (tmp_path / "m.mod").write_text(program)
    said = ran("correct", tmp_path / "m.mod", "--identified", identified, "--out", tmp_path / "c")
    assert "0 of 1 target corrected" in said
    assert "its configuration may not apply (ConfJ or ConfL \\Off), and the robot's position before it is unknown. State --near" in said
    said = ran("correct", tmp_path / "m.mod", "--identified", identified, "--near", "10,15,-20,30,40,-25", "--out", tmp_path / "d")
    assert "1 of 1 target corrected" in said
