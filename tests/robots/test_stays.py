"""Readings of one stay: the robot errs once for all of them; and predictions far from the measured joint values."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import ran
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.io.tables import read_table
from lmeasure.robots import Identified, Measurements, beyond, cross_validation, identify, identify_with_choice, predict, read_identified
from lmeasure.robots.identification.measurements import measured, stays_of
from lmeasure.robots.robot import shipped

CASE = Path(__file__).parents[1] / "authorities" / "repeated-readings"
UR5 = Path(__file__).parents[2] / "datasets" / "ur5" / "grid.csv"
NAMES = [f"joint_{i}_deg" for i in range(1, 7)]
SEATS = np.array([[40.0, -25.0, 110.0], [-90.0, 30.0, 60.0], [20.0, 80.0, 140.0]])


def read(rng: np.random.Generator, stays: int, times: int, u_mm: float = 0.003, **more: Any) -> Measurements:
    """Three targets at each stay of an arm whose joints repeat to 0.01 degrees, each read some times."""
    arm = shipped("generic6").model
    joints = rng.uniform(-2.0, 2.0, (stays, 6))
    flange = arm.forward(joints + np.radians(0.01) * rng.normal(size=joints.shape))
    each = np.repeat(np.arange(3), times)
    places = np.stack([se3.apply(flange, np.broadcast_to(SEATS[k], (stays, 3))) for k in each], axis=1).reshape(-1, 3)
    places += u_mm * rng.normal(size=places.shape)
    return measured(np.repeat(joints, len(each), axis=0), places, target=[f"T{k}" for k in np.tile(each, stays)], **more)


def test_ten_readings_say_what_their_means_say(tmp_path: Path) -> None:
    found, said = {}, {}
    truth = read_table(CASE / "unseen.csv").matrix(["x_mm", "y_mm", "z_mm"])
    for name in ("ten_readings", "means"):
        out = tmp_path / name
        arguments = ["--measurements", str(CASE / f"{name}.csv"), "--out", str(out), "--predict", str(CASE / "unseen.csv")]
        said[name] = ran("identify", "--robot", "ur5", *arguments)
        determined = read_table(out / "predictions.csv")
        error = np.linalg.norm(determined.matrix(["x_mm", "y_mm", "z_mm"]) - truth, axis=1)
        assert error.mean() == pytest.approx(0.20, abs=0.01)
        assert 0.90 <= np.mean(error <= determined.numbers("u95_mm")) <= 0.98
        found[name] = json.loads((out / "identified.json").read_text(encoding="utf-8"))
        assert found[name]["freed"] == ["links"]
        assert found[name]["stays"] == 40
        assert found[name]["held_out"]["mean_mm"] == pytest.approx(0.18, abs=0.01)
    one, other = found["ten_readings"], found["means"]
    assert "400 rows at 40 stays, mean error" in said["ten_readings"]
    assert one["noise"]["reading_mm"] == pytest.approx(0.002, rel=0.05)
    assert [p["u"] for p in one["parameters"]] == pytest.approx([p["u"] for p in other["parameters"]], rel=0.02)
    assert one["freedom"] == pytest.approx(other["freedom"], rel=0.02)
    assert "400 rows at 40 stays" in (tmp_path / "ten_readings" / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")


def test_variances_are_those_of_the_restricted_likelihood_of_all_readings() -> None:
    """Against the likelihood of every single reading, with a dense covariance and derivatives by differences."""
    rng = np.random.default_rng(8)
    found = identify(shipped("generic6").model, read(rng, 25, 3))
    rows, unknowns, x = found.rows, found.fit.problem.unknowns, found.fit.x
    assert found.kept.all()
    size = unknowns.width * 1e-6

    def places(at: FloatArray) -> FloatArray:
        return unknowns.state(at).predicted(rows)[:, :3].reshape(-1)

    steps = np.maximum(size, 1e-7)
    J = np.column_stack([(places(x + d) - places(x - d)) / (2.0 * s) for d, s in zip(np.diag(steps), steps, strict=True)])
    r = (rows.position.reshape(-1) - places(x)).astype(np.float64)
    place, stay = places(x).reshape(-1, 3), np.repeat(np.arange(25), 9)
    same = np.kron((stay[:, None] == stay[None]).astype(float), np.eye(3))
    middle = np.array([place[stay == s].mean(axis=0) for s in range(25)])[stay]
    turned = np.concatenate([-np.cross(np.eye(3)[None], (p - m)[None, None])[0] for p, m in zip(place, middle, strict=True)])
    by_turn = (turned @ turned.T) * np.kron((stay[:, None] == stay[None]).astype(float), np.ones((3, 3)))
    prior = np.diag(1.0 / unknowns.width**2)

    def likelihood(log: FloatArray) -> float:
        turn, shift, reading = np.exp(2.0 * log)
        V = turn * by_turn + shift * same + reading * np.eye(len(r))
        weighted = np.linalg.solve(V, J)
        information = J.T @ weighted + prior
        left = r - J @ np.linalg.solve(information, J.T @ np.linalg.solve(V, r) - prior @ x * 0.0)
        return float(-0.5 * (np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1] + left @ np.linalg.solve(V, left)))

    noise = found.noise
    at = np.log([noise.rotation_rad, noise.position_mm, noise.reading_mm])
    best = likelihood(at)
    for k in range(3):
        for step in (-0.05, 0.05):
            assert likelihood(at + step * np.eye(3)[k]) < best + 1e-4
    assert noise.reading_mm == pytest.approx(0.003, rel=0.1)


def test_stays_are_found_from_joints_and_order() -> None:
    sliding = np.zeros(2, np.bool_)
    here, there = np.radians([10.1234, -35.4321]), np.radians([11.0, -35.4321])
    digit = np.radians([1e-4, -1e-4])
    assert stays_of(np.array([here, here + digit, here, there, there, here]), sliding).tolist() == [0, 0, 0, 1, 1, 2]
    coarse = np.radians([[10.1, 20.0], [10.2, 20.0], [10.4, 20.0]])
    assert stays_of(coarse, sliding).tolist() == [0, 0, 1]
    whole = np.radians([[10.0, 20.0], [11.0, 20.0], [11.0, 20.0]])
    assert stays_of(whole, sliding).tolist() == [0, 1, 1]


def test_stated_readings_are_believed_and_what_they_do_not_show_is_common() -> None:
    """An instrument that is stated with 0.05 mm and whose readings of one stay scatter by less errs by the rest in all of them alike."""
    rng = np.random.default_rng(3)
    rows = read(rng, 40, 4, 0.002, u_position_mm=0.05)
    found = identify(shipped("generic6").model, rows)
    own = found.fit.problem.rows.covariance[:, 3, 3]
    assert own == pytest.approx(np.full(len(own), 0.05**2), rel=0.01)
    joints = rng.uniform(-2.0, 2.0, (5, 6))
    assert (predict(found, joints).u95_mm > 2.795 * 0.05).all()
    louder = identify(shipped("generic6").model, read(rng, 40, 4, 0.1, u_position_mm=0.05))
    said = [f for f in louder.findings if f.code == "readings"]
    assert said[0].value == pytest.approx(2.0, rel=0.1)


def test_a_bad_reading_a_bad_target_and_a_bad_stay_are_set_aside_alone() -> None:
    rng = np.random.default_rng(5)
    rows = read(rng, 40, 4)
    position, joints = rows.position.copy(), rows.joints.copy()
    position[5] += [0.4, -0.3, 0.2]  # one of four readings
    position[12 * 7 + 4 : 12 * 7 + 8] += [1.0, 1.0, -1.0]  # all of a target at a stay
    joints[12 * 20 : 12 * 21, 2] += np.radians(0.5)  # all of a stay
    found = identify(shipped("generic6").model, replace(rows, position=position, joints=joints))
    bad = {5, *range(12 * 7 + 4, 12 * 7 + 8), *range(12 * 20, 12 * 21)}
    assert set(np.flatnonzero(~found.kept).tolist()) == bad
    assert {f.of for f in found.findings if f.code == "outlier"} == {str(i + 1) for i in bad}


def real() -> Measurements:
    table = np.genfromtxt(UR5, delimiter=",", names=True)
    joints = np.radians(np.column_stack([table[f"joint_{i}"] for i in range(1, 7)]))
    return measured(joints, np.column_stack([table[f"{axis}_t"] + table[f"{axis}_dif"] for axis in "xyz"]))


def judged(found: Identified[Any]) -> Identified[Any]:
    held = cross_validation(found)
    assert held is not None
    return replace(found, misfit=held.misfit, beyond=beyond(found))


@pytest.mark.parametrize(("cut", "mean_mm", "least", "most"), [("joint_1", 0.17, 0.85, 1.0), ("chance", 0.1, 0.93, 0.97)])
def test_the_unseen_half_of_a_real_workspace_lies_within_u95(cut: str, mean_mm: float, least: float, most: float) -> None:
    rows = real()
    along = {"joint_1": -rows.joints[:, 0], "chance": np.random.default_rng(2).random(1000)}[cut]
    half = along < np.median(along)
    found = judged(identify_with_choice(shipped("ur5").model, rows.of(np.flatnonzero(half))))
    determined = predict(found, rows.joints[~half])
    error = np.linalg.norm(rows.position[~half] - determined.pose[:, :3], axis=1)
    assert error.mean() < mean_mm
    assert least <= np.mean(error <= determined.u95_mm) <= most


def test_a_robot_of_which_the_model_lacks_nothing_is_not_widened() -> None:
    found = judged(identify(shipped("generic6").model, read(np.random.default_rng(9), 60, 1)))
    assert found.beyond.factor == 0.0


def test_a_joint_that_never_moved_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    arm, tables = shipped("ur5").model, {}
    for name, count in (("measured", 60), ("asked", 8)):
        joints = rng.uniform(-2.0, 2.0, (count, 6))
        if name == "measured":
            joints[:, 3] = 0.5
        places = se3.apply(arm.forward(joints + 1e-4 * rng.normal(size=joints.shape)), np.broadcast_to(SEATS[0], (count, 3)))
        head = ",".join(["name", *NAMES, "x_mm", "y_mm", "z_mm"])
        values = np.column_stack([np.degrees(joints), places]).tolist()
        lines = [",".join([f"P{i}", *map(repr, row)]) for i, row in enumerate(values)]
        tables[name] = tmp_path / f"{name}.csv"
        tables[name].write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    files = ["--measurements", str(tables["measured"]), "--predict", str(tables["asked"]), "--out", str(out)]
    said = ran("identify", "--robot", "ur5", *files)
    assert "warning joint-unmoved: joint_4 was at 28.6479 deg in all measurements" in said
    determined = read_table(out / "predictions.csv")
    most = f"{determined.numbers('u95_mm').max():.3g}"
    assert f"asked.csv: 8 rows move joint_4, which did not move in any measurement. Their U95 is up to {most} mm" in said
    # what `correct` reads states the same, but for the instrument, of which nothing is known here
    joints = np.radians(read_table(tables["asked"]).matrix(NAMES))
    assert read_identified(out).u95_mm(joints) == pytest.approx(determined.numbers("u95_mm"), rel=0.1)


def test_oriented_readings_of_a_stay_are_averaged() -> None:
    rng = np.random.default_rng(6)
    arm = shipped("generic6").model
    joints = rng.uniform(-2.0, 2.0, (40, 6))
    seat = se3.pose(SEATS[0], Rotation.random(rng=rng))
    poses = np.repeat(se3.compose(arm.forward(joints + np.radians(0.01) * rng.normal(size=joints.shape)), seat), 5, axis=0)
    poses = se3.displaced(poses, rng.normal(size=(200, 6)) * np.repeat([1e-5, 0.004], 3))
    found = identify(arm, measured(np.repeat(joints, 5, axis=0), poses[:, :3], poses[:, 3:]))
    assert found.stays == 40
    assert found.noise.reading_mm == pytest.approx(0.004, rel=0.15)
    assert found.noise.reading_rad == pytest.approx(1e-5, rel=0.15)
    assert found.noise.rotation_rad == pytest.approx(np.radians(0.01) * np.sqrt(2.0), rel=0.3)
    # the arm reaches about 1 m: 0.01 degrees of some joints
    assert 0.05 < found.noise.position_mm < 0.2
