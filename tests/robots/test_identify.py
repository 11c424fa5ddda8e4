"""Identification: true robots found again with the uncertainty stated, slips and outliers named, and a real arm as good as outside fits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import LMeasureError, RobotError, se3
from lmeasure.io import columns_of
from lmeasure.robots import Measurements, Robot, Settings, identify, predict, read_measurements, unknown_frames
from lmeasure.robots.identification import hold_out, slips
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined_parameters, unobservable_directions
from lmeasure.robots.identification.problem import Noise, Problem
from lmeasure.robots.identification.unknowns import Unknowns, find_frames
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import SerialRobot

UR5 = Path(__file__).parents[2] / "datasets" / "ur5" / "grid.csv"
BASE = np.array([2000.0, -300.0, 500.0, *Rotation.from_rotvec([0.4, 2.0, -1.0]).as_quat()])
TOOL = np.array([40.0, -25.0, 110.0, *Rotation.from_rotvec([0.3, -0.2, 1.1]).as_quat()])


def built(robot: Robot, rng: np.random.Generator) -> SerialRobot:
    """The robot with errors of 0.3 mm and 0.5 mrad of every parameter of its links."""
    model = robot.model
    links = [p.name.rsplit(".", 1)[1] in {"theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg"} for p in model.parameters]
    sizes = np.array([0.3 if p.unit == "mm" else 5e-4 for p in model.parameters])
    return model.moved(rng.normal(size=len(sizes)) * sizes * links)


def seen(true: SerialRobot, count: int, rng: np.random.Generator, u_mm: float = 0.02, *, whole: bool = False) -> Measurements:
    low, high = true.limits
    joints = rng.uniform(np.maximum(low, -2.5), np.minimum(high, 2.5), (count, len(low)))
    pose = se3.compose(se3.compose(BASE, true.forward(joints)), TOOL)
    noise = np.column_stack([rng.normal(size=(count, 3)) * 1e-4, rng.normal(size=(count, 3)) * u_mm])
    pose = se3.displaced(pose, noise)
    return measured(joints, pose[:, :3], pose[:, 3:] if whole else None, u_position_mm=u_mm, u_rotation_rad=1e-4 if whole else None)


def real(rows: slice) -> Measurements:
    table = np.genfromtxt(UR5, delimiter=",", names=True)[rows]
    joints = np.radians(np.column_stack([table[f"joint_{i}"] for i in range(1, 7)]))
    return measured(joints, np.column_stack([table[f"{axis}_t"] + table[f"{axis}_dif"] for axis in "xyz"]))


@pytest.mark.parametrize("kind", ["places", "poses", "lengths"])
def test_derivatives_of_what_is_predicted_are_those_of_differences(kind: str) -> None:
    rng = np.random.default_rng(4)
    model = shipped("generic7").model
    rows = seen(built(shipped("generic7"), rng), 30, rng, whole=kind == "poses")
    if kind == "lengths":
        stations = np.array([[3000.0, 0.0, 900.0], [1000.0, 2000.0, 0.0]])
        of = np.arange(30) % 2
        length = np.linalg.norm(rows.position - stations[of], axis=1)
        # every third row stays a place, so that the base is asked for too
        length[::3] = np.nan
        place = np.where(np.isnan(length)[:, None], rows.position, np.nan)
        station = [f"S{s}" if not np.isnan(x) else "" for s, x in zip(of, length, strict=True)]
        rows = measured(rows.joints, place, station=station, length_mm=length)
    unknowns = Unknowns(model, np.arange(len(model.parameters)), find_frames(model.forward(rows.joints), rows), rows)
    problem = Problem(unknowns, rows, Noise(0.1, 1e-4))
    theta = 0.3 * rng.normal(size=len(unknowns)) * np.minimum(problem.width, 1.0)
    jacobian = problem.linearised(theta).jacobian
    for i, name in enumerate(unknowns.names):
        h = 1e-5 * min(problem.width[i], 1.0)
        step = h * np.eye(len(theta))[i]
        got = (problem.linearised(theta - step).residuals - problem.linearised(theta + step).residuals) / (2 * h)
        assert jacobian[:, :, i] == pytest.approx(got, rel=2e-5, abs=3e-9 / h), name


def test_robots_lie_where_they_are_said_to_lie() -> None:
    """Determined parameters, and places at other joint values, against the truth, in their own standard uncertainties."""
    rng = np.random.default_rng(12)
    values, inside = [], []
    for name in ("generic6", "generic7", "ur5", "puma560"):
        true = built(shipped(name), rng)
        found = identify(shipped(name).model, seen(true, 80, rng))
        theta = {p.name: p.value for p in true.parameters}
        determined, u = determined_parameters(found.fit), np.sqrt(np.diag(found.fit.covariance))
        assert determined.sum() > 10
        for i, (own, value) in enumerate(zip(found.fit.problem.names, found.fit.problem.unknowns.values(found.fit.x), strict=True)):
            if own in theta and determined[i]:
                values.append((value - theta[own]) / u[i])
        later = seen(true, 200, rng)
        predicted = predict(found, later.joints)
        inside.append(np.linalg.norm(predicted.pose[:, :3] - later.position, axis=1) <= predicted.u95_mm)
        assert found.noise.position_mm < 0.02
    assert 0.85 < np.std(values) < 1.2
    assert 0.92 < np.mean(inside) < 0.98


def test_poses_tell_the_tools_orientation_and_places_do_not() -> None:
    rng = np.random.default_rng(2)
    true = built(shipped("generic6"), rng)
    found = identify(shipped("generic6").model, seen(true, 60, rng, whole=True))
    later = seen(true, 50, rng, 0.0, whole=True)
    off = se3.displacement(found.state.predicted(later), np.column_stack([later.position, later.quaternion]))
    assert np.abs(off).max(axis=0) == pytest.approx(0.0, abs=0.2)
    assert np.abs(off[:, :3]).max() < 1e-3
    assert not unknown_frames(found.fit)
    places = identify(shipped("generic6").model, seen(true, 60, rng))
    assert "orientation was not measured" in unknown_frames(places.fit)[0].text
    assert not any(n.startswith("tool.r") for n in places.fit.problem.names)


def test_lengths_of_a_wire_find_the_robot_too() -> None:
    rng = np.random.default_rng(6)
    true = built(shipped("generic6"), rng)
    stations = np.array([[1500.0, 900.0, 100.0], [300.0, -1600.0, 1500.0], [-900.0, 800.0, 2000.0]])
    rows = seen(true, 150, rng, 0.0)
    of = np.arange(150) % 3
    local = se3.apply(se3.inverse(BASE), rows.position)
    length = np.linalg.norm(local - stations[of], axis=1) + 0.01 * rng.normal(size=150)
    found = identify(shipped("generic6").model, measured(rows.joints, station=[f"S{s}" for s in of], length_mm=length, u_position_mm=0.01))
    error = found.fit.problem.unknowns.residuals(found.fit.x)[:, 3]
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert "base: lengths alone do not determine the position of the robot. Stations and targets are in the robot's base frame" in " ".join(
        s.text for s in unknown_frames(found.fit)
    )


def test_what_cannot_be_told_is_said_in_words() -> None:
    found = identify(shipped("ur5").model, real(slice(0, 1000, 10)))
    texts = {frozenset(s.direction): s.text for s in unobservable_directions(found.fit)}
    assert "the base frame compensates it" in texts[frozenset({"joint_1.d_mm"})]
    assert "they compensate each other" in texts[frozenset({"joint_3.d_mm", "joint_2.d_mm"})]
    assert "the position of the tool compensates it" in texts[frozenset({"joint_6.d_mm"})]
    # none of them moves a measured place
    problem = found.fit.problem
    for direction in unobservable_directions(found.fit):
        free = len(problem.unknowns.freed)
        step = np.array([direction.direction.get(n, 0.0) for n in problem.names[:free]])
        white = problem.whitened(found.fit.at)[1]
        moved = white[:, :free] @ step
        frames = np.linalg.lstsq(white[:, free:], moved, rcond=None)[0]
        assert np.linalg.norm(moved - white[:, free:] @ frames) < 4.0  # a millimetre of one link is some hundreds


def test_the_real_arm_is_predicted_as_well_as_by_outside_fits() -> None:
    """Every fourth of 1,000 poses of a UR5 under a laser tracker; all of them in five folds are in benchmarks/results/identification.md."""
    rows, others = real(slice(0, 1000, 4)), real(slice(1, 1000, 4))
    for families, most in ((("links",), 0.110), (("links", "harmonics"), 0.094)):
        found = identify(shipped("ur5").model, rows, Settings(families))
        predicted = predict(found, others.joints)
        error = np.linalg.norm(predicted.pose[:, :3] - others.position, axis=1)
        assert error.mean() < most
        assert 0.92 < np.mean(error <= predicted.u95_mm) < 0.98
    held = hold_out.cross_validation(found)
    assert held is not None
    assert 0.92 < held.within < 0.98
    worth = {w.family: w for w in hold_out.worth_freeing(found)}
    assert worth["links"].bic < 0.0
    assert worth["once"].bic < 0.0
    assert worth["twice"].chance < 1e-6


@pytest.mark.parametrize(
    ("slip", "code", "said"),
    [
        (slips._other_way(2), "sign", "joint_3 counts in the opposite direction"),
        (slips._robot_times(1.0, np.pi / 180), "units", "angles are radians"),
        (slips._values_swapped(1, 2), "swapped", "joint_2 and joint_3 are swapped"),
        (slips._robot_times(1e-3, 1.0), "units", "lengths are metres"),
    ],
)
def test_slips_are_named_and_undone(slip: slips._Slip, code: str, said: str) -> None:
    rows = real(slice(0, 1000, 25))
    mend = slips.mended(*slip(shipped("ur5"), rows))
    assert [f.code for f in mend.findings] == [code]
    assert said in mend.findings[0].text
    found = identify(mend.robot.model, mend.rows)
    assert found.noise.position_mm < 0.2


def test_a_robot_that_fits_has_no_slips() -> None:
    mend = slips.mended(shipped("ur5"), real(slice(0, 1000, 25)))
    assert mend.findings == ()


def test_outliers_copies_and_limits_are_named() -> None:
    rng = np.random.default_rng(9)
    true = built(shipped("generic6"), rng)
    rows = seen(true, 60, rng)
    place = rows.position.copy()
    place[7] += [0.0, 3.0, 0.0]
    place[20] += [500.0, 0.0, 0.0]
    order = np.r_[np.arange(60), 5]
    joints = rows.joints[order]
    bad = measured(joints, place[order], names=[f"P{i}" for i in range(61)], u_position_mm=0.02)
    robot = shipped("generic6").model
    tight = replace(robot, arm=replace(robot.arm, high=np.full(6, 2.4)))
    found = identify(tight, bad)
    named = {(f.code, f.of) for f in found.findings}
    assert {("outlier", "P7"), ("outlier", "P20"), ("duplicate", "P60"), ("limits", "joint_1")} <= named
    assert found.kept.sum() == 58
    later = seen(true, 100, rng)
    assert np.linalg.norm(predict(found, later.joints).pose[:, :3] - later.position, axis=1).mean() < 0.06


def test_names_that_stand_twice_are_named_and_judge_nothing(tmp_path: Path) -> None:
    """Of other joint values, and of repetitions how far they are apart; several targets of one pose are no repetition. Which rows are
    outliers does not depend on names."""
    rng = np.random.default_rng(9)
    rows = seen(built(shipped("generic6"), rng), 60, rng)
    place = rows.position.copy()
    place[7] += [0.0, 3.0, 0.0]
    names = [f"P{i}" for i in range(60)]
    order, twice = np.r_[np.arange(60), 11, 12], [*names, "P11", "P12"]
    twice[30], twice[31] = "P1", "P2"
    again = place[order]
    again[60] += [0.03, 0.0, 0.0]
    again[61] += [0.0, 0.05, 0.0]
    bad = measured(rows.joints[order], again, names=twice, u_position_mm=0.02).of_lines(range(2, 64))
    robot = shipped("generic6").model
    found = identify(robot, bad)
    said = [f for f in found.findings if f.code == "same-name"]
    assert [(f.of, f.value) for f in said] == [("P1", 2.0), ("P12", pytest.approx(0.05))]
    assert said[0].text == "row P1 (line 32): same name as row P1 (line 3), but other joint values (2 such rows). All are used"
    assert said[1].said.text("ru").startswith("строка P12 (номер в файле 63) и строка P12 (номер в файле 14): одно имя")
    assert found.kept.sum() == 61
    alone = identify(robot, measured(rows.joints[order], again, u_position_mm=0.02))
    np.testing.assert_array_equal(found.kept, alone.kept)
    np.testing.assert_array_equal(found.fit.theta, alone.fit.theta)
    two = measured(rows.joints[order], again, names=twice, target=["a"] * 60 + ["b"] * 2, u_position_mm=0.02)
    assert [f.of for f in identify(robot, two).findings if f.code == "same-name"] == ["P1"]


def test_files_of_others_are_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = seen(built(shipped("ur5"), rng), 12, rng)
    degrees = np.degrees(rows.joints)
    head = "Messpunkt;" + ";".join(f"A{i}" for i in range(1, 7)) + ";X (m);Y (m);Z (m);Gerät"
    lines = [
        ";".join([f"P{i}", *(f"{v:.9f}".replace(".", ",") for v in [*degrees[i], *rows.position[i] / 1e3]), "Zürich"]) for i in range(12)
    ]
    path = tmp_path / "tracker.csv"
    path.write_bytes("\r\n".join(["# Export", "", head, *lines]).encode("cp1252"))
    mapping = "name=Messpunkt,x=X (m)[m],y=Y (m)[m],z=Z (m)[m]," + ",".join(f"joint_{i}=A{i}[deg]" for i in range(1, 7))
    read = read_measurements(path, shipped("ur5").model, columns_of(mapping))
    assert read.joints == pytest.approx(rows.joints, abs=1e-9)
    assert read.position == pytest.approx(rows.position, abs=1e-5)
    assert read.names[3] == "P3"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("a,0,0,0,0,0,0,1,2,", ":2: has . cells|one of x, y, z is empty"),
        ("a,0,0,0,0,0,x,1,2,3", ":2: joint_6_deg: must be a number, is 'x'"),
        ("a,0,0,0,0,0,0,,,", "row a has neither x, y, z nor length"),
        ("a,0,0,0,0,0,1e9,1,2,3", "an angle of"),
        ("a,0,0,0,0,0,0,1,2,3e7", "row a: lies more than"),
    ],
)
def test_rows_that_cannot_be_read_are_named(line: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("name," + ",".join(f"joint_{i}_deg" for i in range(1, 7)) + ",x_mm,y_mm,z_mm\n" + line + "\n", encoding="utf-8")
    with pytest.raises(LMeasureError, match=said):
        read_measurements(path, shipped("ur5").model)


def test_what_is_missing_is_said() -> None:
    with pytest.raises(LMeasureError, match="is not name=column"):
        columns_of("x:X")
    with pytest.raises(LMeasureError, match="At least 3 are needed"):
        identify(shipped("ur5").model, real(slice(0, 2)))
    with pytest.raises(RobotError, match="all 20 rows have the same joint values"):
        identify(shipped("ur5").model, real(slice(0, 20)).of(np.zeros(20, dtype=np.int64)))
    with pytest.raises(RobotError, match=r"cannot be freed. Known"):
        identify(shipped("ur5").model, real(slice(0, 20)), Settings(("everything",)))
