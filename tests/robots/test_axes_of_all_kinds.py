"""Robots of seven axes from planning to a corrected program, and a gantry of sliding axes from URDF, by the commands."""

import json
from pathlib import Path

import numpy as np
from in_process import refused
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.io import write_table
from lmeasure.io.tables import read_table
from lmeasure.robots import read_identified, read_measurements, read_urdf
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import SerialRobot

BASE = np.array([2000.0, -300.0, 500.0, *Rotation.from_rotvec([0.4, 2.0, -1.0]).as_quat()])
TOOL = np.array([40.0, -25.0, 110.0, 0.0, 0.0, 0.0, 1.0])
LINKS = ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")
GANTRY = """<robot name="gantry"><link name="w"/><link name="a"/><link name="b"/><link name="c"/><link name="t"/>
<joint name="x" type="prismatic"><parent link="w"/><child link="a"/><origin xyz="0 0 2"/><axis xyz="1 0 0"/>
<limit lower="0" upper="3" effort="0" velocity="0"/></joint>
<joint name="y" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.1 0 0.2"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="0" velocity="0"/></joint>
<joint name="z" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0.05 0.1 0"/><axis xyz="0 0 -1"/>
<limit lower="0" upper="1.2" effort="0" velocity="0"/></joint>
<joint name="tip" type="fixed"><parent link="c"/><child link="t"/><origin xyz="0 0 -0.3"/></joint></robot>"""


def ran(*arguments: object, code: int = 0) -> str:
    return " ".join(refused(*arguments, code=code).split())


def built(nominal: SerialRobot, seed: int, **more: float) -> SerialRobot:
    """With errors of 0.3 mm and 0.5 mrad of every parameter of its links, and of further ones by the ends of their names."""
    rng, ends = np.random.default_rng(seed), [p.name.rsplit(".", 1)[1] for p in nominal.parameters]
    size = [(0.3 if p.unit == "mm" else 5e-4) * (end in LINKS) for p, end in zip(nominal.parameters, ends, strict=True)]
    return nominal.moved(rng.normal(size=len(size)) * size + [more.get(end, 0.0) for end in ends])


def places(true: SerialRobot, joints: FloatArray, u_mm: float = 0.0, seed: int = 0) -> FloatArray:
    where = se3.compose(se3.compose(np.broadcast_to(BASE, (len(joints), 7)), true.forward(joints)), np.broadcast_to(TOOL, (len(joints), 7)))
    return se3.displaced(where, np.random.default_rng(seed).normal(size=(len(joints), 6)) * np.repeat([1e-5, u_mm], 3))


def xyz(where: FloatArray) -> dict[str, FloatArray]:
    return {f"{axis}_mm": where[:, k] for k, axis in enumerate("xyz")}


def test_seven_axes_by_command(tmp_path: Path) -> None:
    nominal = shipped("generic7").model
    true = built(nominal, 7)
    ran("plan-poses", "--robot", "generic7", "--poses", 30, "--tool", "40,-25,110", "--out", tmp_path / "joints.csv")
    planned = read_measurements(tmp_path / "joints.csv", nominal, joints_alone=True)
    table = read_table(tmp_path / "joints.csv")
    keys = [f"joint_{i + 1}_deg" for i in range(7)]
    measured = {"name": list(planned.names), **{key: table.numbers(key) for key in keys}}
    write_table(tmp_path / "m.csv", measured | xyz(places(true, planned.joints, 0.02)))
    low, high = np.clip(nominal.limits, -1.4, 1.4)
    requested = np.random.default_rng(3).uniform(low + 0.1, high - 0.1, (40, 7))
    write_table(tmp_path / "asked.csv", {"name": [f"A{i}" for i in range(40)], **dict(zip(keys, np.degrees(requested.T), strict=True))})
    said = ran("identify", "--robot", "generic7", "--measurements", tmp_path / "m.csv", "--out", tmp_path / "id", "--free", "links",
               "--predict", tmp_path / "asked.csv")  # fmt: skip
    assert "30 rows, mean error" in said
    determined = read_table(tmp_path / "id" / "predictions.csv")
    off = np.linalg.norm(determined.matrix(["x_mm", "y_mm", "z_mm"]) - places(true, requested, 0.02, 1)[:, :3], axis=1)
    assert np.mean(off <= determined.numbers("u95_mm")) >= 0.85
    assert np.median(off) < 0.2
    # base and target from poses, with the identified robot's flange
    robot = read_identified(tmp_path / "id")
    assert isinstance(robot.found, SerialRobot)
    for name, poses in (("flange", robot.found.forward(requested)), ("target", places(true, requested))):
        write_table(
            tmp_path / f"{name}.csv",
            {"pose": [f"A{i}" for i in range(40)], **xyz(poses), **dict(zip(("qx", "qy", "qz", "qw"), poses[:, 3:].T, strict=True))},
        )
    ran("frames", "--robot", tmp_path / "flange.csv", "--measured", tmp_path / "target.csv", "--out", tmp_path / "frames.json")
    frames = json.loads((tmp_path / "frames.json").read_text())
    assert np.linalg.norm(np.array(frames["base"]["position_mm"]) - BASE[:3]) < 0.5
    # corrected joint values send the true robot nearer to where the nominal one was meant to go
    program = tmp_path / "program.csv"
    write_table(program, {"name": [f"T{i}" for i in range(10)], **{key: np.degrees(requested[:10, k]) for k, key in enumerate(keys)}})
    assert "10 of 10 targets corrected" in ran("correct", program, "--identified", tmp_path / "id", "--out", tmp_path / "out")
    corrected = np.radians(read_table(tmp_path / "out" / "program.csv").matrix(keys))
    meant = se3.compose(
        se3.compose(np.broadcast_to(robot.base, (10, 7)), nominal.forward(requested[:10])), np.broadcast_to(robot.tool, (10, 7))
    )
    before, after = (np.linalg.norm(places(true, q)[:, :3] - meant[:, :3], axis=1) for q in (requested[:10], corrected))
    assert np.median(after) < 0.2 * np.median(before)


def test_a_gantry_in_millimetres_from_positions(tmp_path: Path) -> None:
    """Scales of the axes and what they are out of square are found; where zeros and frames make up for each other it is said. Joints named
    as the measured coordinates are not taken for them."""
    (tmp_path / "gantry.urdf").write_text(GANTRY)
    nominal = read_urdf(tmp_path / "gantry.urdf").model
    assert nominal.sliding.all()
    true = built(nominal, 1, scale=2e-4)
    joints = np.random.default_rng(2).uniform(*nominal.limits, (60, 3))
    columns = {f"joint_{i + 1}_mm": joints[:, i] for i in range(3)} | xyz(places(true, joints, 0.02))
    write_table(tmp_path / "m.csv", {"name": [f"P{i}" for i in range(60)], **columns})
    said = ran("identify", "--robot", tmp_path / "gantry.urdf", "--measurements", tmp_path / "m.csv", "--out", tmp_path / "id")
    assert "freed: links, scale" in said
    record = json.loads((tmp_path / "id" / "identified.json").read_text())
    assert record["warnings"] == []
    determined = {p["name"]: p for p in record["parameters"] if p["determined"] and not p["name"].startswith("base")}
    assert {"x.scale", "y.scale", "z.scale", "x.alpha_deg", "y.theta_deg", "y.alpha_deg"} == set(determined)
    assert all(abs(determined[f"{axis}.scale"]["value"] - 1.0002) < 4.0 * determined[f"{axis}.scale"]["u"] < 1e-4 for axis in "xyz")
    # angles between the axes, whatever frames stand for their directions
    axes = []
    for robot in (true, read_identified(tmp_path / "id").found):
        moved = robot.forward(np.vstack([np.zeros(3), 1000.0 * np.eye(3)]))[:, :3]
        axes.append((moved[1:] - moved[0]) / np.linalg.norm(moved[1:] - moved[0], axis=1)[:, None])
    square = [np.degrees(np.arccos(np.array([a[0] @ a[1], a[1] @ a[2], a[0] @ a[2]]))) for a in axes]
    assert np.abs(square[0] - 90.0).max() > 0.02
    np.testing.assert_allclose(square[1], square[0], atol=0.003)
    assert any("tool.x_mm: no measurement depends on it" in u["text"] for u in record["unobservable"])
    # out again as URDF, in metres
    again = read_urdf(tmp_path / "id" / "robot.urdf").model
    np.testing.assert_allclose(again.limits, nominal.limits, atol=1e-9)
    # without a column of joints the measured x is not taken for the joint x
    write_table(tmp_path / "bare.csv", {"name": ["A", "B", "C"], **xyz(places(true, joints[:3]))})
    refused = ran(
        "identify", "--robot", tmp_path / "gantry.urdf", "--measurements", tmp_path / "bare.csv", "--out", tmp_path / "no", code=1
    )
    assert "bare.csv: column 'joint_1_mm' is missing" in refused
