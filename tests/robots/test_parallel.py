"""Mechanisms as robots: there and back, derivatives by differences, limits, files, identification."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.robots import Measurements, ParallelFile, Settings, any_shipped, checked, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined_parameters
from lmeasure.robots.model import Limits
from lmeasure.robots.parallel import limits, model
from lmeasure.robots.parallel.limits import own_roots
from lmeasure.robots.parallel.model import Parallel
from lmeasure.robots.robot import robot_from_dict

NAMES = (
    "rotopod", "rotopod-cell", "four-chains-cabin", "four-chains", "four-chains-arms", "crank-platform", "logos", "seven-link",
    "three-prr",
)  # fmt: skip


def shipped(name: str) -> ParallelFile:
    found = any_shipped(name)
    assert isinstance(found, ParallelFile)
    return found


def some_joints(robot: Parallel, count: int, rng: np.random.Generator) -> FloatArray:
    """Joint values at poses about home that the platform takes."""
    moves = rng.uniform(-1.0, 1.0, (20 * count, 6)) * robot.units * robot.size_mm * [0.04, 0.04, 0.1, 0.05, 0.05, 0.02]
    poses = robot.nearest(se3.displaced(np.tile(robot.home, (20 * count, 1)), moves))
    joints = own_roots(robot, poses[~np.isnan(poses[:, 0])])
    low, high = robot.limits
    return joints[np.isfinite(joints).all(axis=1) & ((joints >= low) & (joints <= high)).all(axis=1)][:count]


def built(robot: Parallel, rng: np.random.Generator) -> Parallel:
    size = [{"mm": 0.3, "deg": 5e-4, "": 0.0}[p.unit] for p in robot.parameters]
    return robot.moved(rng.normal(size=len(size)) * size)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_of_parallel_robots_are_differences(name: str) -> None:
    rng = np.random.default_rng(2)
    robot = built(shipped(name).model, rng)
    joints = some_joints(robot, 3, rng)
    poses, by_joints, by_parameters = robot.derivatives(joints)

    def twist(at: Callable[[float], FloatArray], h: float) -> FloatArray:
        """Of the fourth order: guides go near singular poses."""
        near, far = (se3.displacement(at(k * h), at(-k * h)) / (2.0 * k * h) for k in (1.0, 2.0))
        at_flange = (4.0 * near - far) / 3.0
        return np.concatenate([at_flange[:, :3], at_flange[:, 3:] - np.cross(at_flange[:, :3], poses[:, :3])], axis=1)

    def driven(step: FloatArray, h: float) -> FloatArray:
        return robot.forward(joints + h * step)

    def changed(step: FloatArray, h: float) -> FloatArray:
        return robot.moved(h * step).forward(joints)

    for i, slides in enumerate(robot.sliding):
        step = np.eye(len(robot.sliding))[i]
        got = twist(partial(driven, step), 1e-3 if slides else 1e-5)
        assert by_joints[:, i] == pytest.approx(got, rel=1e-7, abs=1e-7 * np.abs(got).max())
    for i, p in enumerate(robot.parameters):
        step = np.eye(len(robot.parameters))[i]
        got = twist(partial(changed, step), 1e-3 if p.unit == "mm" else 1e-5)
        assert by_parameters[:, i] == pytest.approx(got, rel=1e-7, abs=1e-7 * np.abs(got).max() + 1e-8), p.name


def test_limits_of_carriages_do_not_depend_on_the_order_of_legs() -> None:
    rng, file = np.random.default_rng(3), shipped("rotopod")
    poses = se3.displaced(np.tile(file.model.home, (300, 1)), rng.uniform(-1, 1, (300, 6)) * [0.004, 0.004, 0.5, 90.0, 90.0, 9.0])
    kept = checked(file.model, file.limits, poses).all
    assert 20 < kept.sum() < 280
    other_way = ParallelFile.model_validate(file.model_dump(by_alias=True) | {"leg": [leg.model_dump() for leg in file.leg[::-1]]})
    np.testing.assert_array_equal(checked(other_way.model, other_way.limits, poses).all, kept)
    # round the guide once more all is as it was; a carriage beyond its neighbour is refused, though gaps from 0 to 360 degrees are allowed
    any_gap = Limits(least_gap_deg=0.0)
    round_again = file.model.home_joints + 2.0 * np.pi
    order = np.argsort(np.mod(angles := file.model.home_joints + [leg.values[2] for leg in file.model.legs], 2.0 * np.pi))
    passed = file.model.home_joints.copy()
    passed[order[0]] += np.mod(angles[order[1]] - angles[order[0]], 2.0 * np.pi) + 0.01
    drives = np.stack([file.model.home_joints, round_again, passed])
    np.testing.assert_array_equal(limits._gaps(file.model, any_gap, drives), [True, True, False])


def test_another_assembly_is_not_taken_for_the_one_of_home() -> None:
    """Below its guide a rotopod has the same carriages; driven there through a singular pose it is not found."""
    robot = shipped("rotopod-cell").model
    mirrored = robot.home * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0]
    assert len(robot.inverse(robot.home)) == 1
    assert len(robot.inverse(mirrored)) == 0
    with pytest.raises(RobotError, match=r"sample 1: the platform cannot be at \(0, 0, 900"):
        robot.follow(np.array([robot.home, robot.home + [0.0, 0.0, 500.0, 0, 0, 0, 0]]), robot.home_joints)


@pytest.mark.parametrize(("name", "part"), [("rotopod-cell", 0.4), ("four-chains-arms", 0.08), ("logos", 0.2), ("seven-link", 0.4)])
def test_far_ways_are_those_gone_in_small_steps(name: str, part: float) -> None:
    """In 60 steps from home, each from the pose before, lost where the rows' determinant changes its sign."""
    robot, rng = shipped(name).model, np.random.default_rng(12)
    low, high = robot.limits
    far = np.where(robot.sliding, high - low, np.minimum(high - low, 3.0))
    joints = robot.home_joints + part * rng.uniform(-1.0, 1.0, (40, len(low))) * far

    def side(poses: FloatArray, drives: FloatArray) -> FloatArray:
        return np.asarray(np.sign(np.linalg.det(robot.rows(poses, drives).pluecker * robot.units)))

    at, good, there = np.tile(robot.home, (40, 1)), np.ones(40, np.bool_), side(robot.home[None], robot.home_joints[None])
    for done in np.linspace(0.0, 1.0, 61):
        drives = robot.home_joints + done * (joints - robot.home_joints)
        at, closed = robot.near(drives, at)
        at[~closed] = robot.home
        good &= closed & (side(at, drives) == there)
    assert good.sum() > 5
    found = robot.forward(joints)
    np.testing.assert_array_equal(~np.isnan(found[:, 0]), good)
    assert np.abs(se3.displacement(found[good], at[good])).max() < 1e-8


def test_poses_do_not_depend_on_what_else_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """What cannot be reached, and how many are found together, is nothing to the others."""
    robot = shipped("rotopod-cell").model
    joints = some_joints(robot, 9, np.random.default_rng(4))
    alone = np.concatenate([robot.forward(q[None]) for q in joints])
    assert np.isfinite(alone).all()
    for block in (model.BLOCK, 4):
        monkeypatch.setattr(model, "BLOCK", block)
        among = robot.forward(np.concatenate([joints[:5], joints[:1] + 1e4, np.full((1, 6), np.nan), joints[5:]]))
        assert np.isnan(among[5:7]).all()
        np.testing.assert_allclose(np.delete(among, [5, 6], axis=0), alone, atol=1e-10)
    assert robot.forward(joints[:0]).shape == (0, 7)


def seen(true: Parallel, joints: FloatArray, rng: np.random.Generator, u_mm: float = 0.02) -> Measurements:
    base, tool = np.array([800.0, -300.0, 200.0, 0.1, 0.2, -0.3, 0.927362]), np.array([40.0, -25.0, 110.0, 0.0, 0.0, 0.0, 1.0])
    pose = se3.compose(se3.compose(np.tile(base, (len(joints), 1)), true.forward(joints)), np.tile(tool, (len(joints), 1)))
    pose = se3.displaced(pose, np.column_stack([1e-4 * rng.normal(size=(len(joints), 3)), u_mm * rng.normal(size=(len(joints), 3))]))
    return measured(joints, pose[:, :3], pose[:, 3:], u_position_mm=u_mm, u_rotation_rad=1e-4)


@pytest.mark.parametrize("name", ["rotopod-cell", "four-chains", "logos", "crank-platform"])
def test_a_built_mechanism_is_identified_through_the_same_door(name: str) -> None:
    rng = np.random.default_rng(8)
    nominal = shipped(name).model
    true = built(nominal, rng)
    found = identify(nominal, seen(true, some_joints(nominal, 60, rng), rng), Settings(("links",)))
    later = seen(true, some_joints(nominal, 80, rng), rng)
    predicted = predict(found, later.joints)
    off = np.linalg.norm(predicted.pose[:, :3] - later.position, axis=1)
    assert 0.85 < np.mean(off <= predicted.u95_mm) <= 1.0
    before = np.linalg.norm(found.nominal_errors_mm(), axis=1).mean()
    assert off.mean() < 0.06 < 2.0 * before
    value = {p.name: p.value for p in true.parameters}
    determined, u = determined_parameters(found.fit), np.sqrt(np.diag(found.fit.covariance))
    names, values = found.fit.problem.names, found.fit.problem.unknowns.values(found.fit.x)
    z = [(v - value[n]) / s for n, v, s, known in zip(names, values, u, determined, strict=True) if known and n in value]
    assert not z or np.abs(z).max() < 4.5


@pytest.mark.parametrize("name", ["rotopod-cell", "crank-platform"])
def test_remembered_poses_are_those_of_the_whole_way(name: str) -> None:
    rng = np.random.default_rng(9)
    nominal = shipped(name).model
    joints = some_joints(nominal, 12, rng)
    remembering = nominal.remembering(joints)
    for size in (0.3, 3.0):
        change = rng.normal(size=len(nominal.parameters)) * [size * p.size * (0.1 if p.unit == "deg" else 1.0) for p in nominal.parameters]
        every = np.concatenate([joints, some_joints(nominal, 3, rng)])
        np.testing.assert_allclose(remembering.moved(change).forward(every), nominal.moved(change).forward(every), atol=1e-8)
    # the other side of a singular pose is another assembly, however near it was remembered
    off = {
        key: se3.displaced(pose[None], np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -2.0 * pose[2]]]))[0] for key, pose in remembering.known.items()
    }
    np.testing.assert_allclose(replace(remembering, known=off).forward(joints), nominal.forward(joints), atol=1e-8)


def test_how_exactly_it_was_built_is_what_the_drawing_tells() -> None:
    rng = np.random.default_rng(8)
    nominal = shipped("crank-platform").model
    rows = seen(built(nominal, rng), some_joints(nominal, 40, rng), rng)
    wide, stated = (identify(nominal, rows, Settings(u_links_mm=mm, u_links_deg=deg)) for mm, deg in ((None, None), (0.3, 0.03)))
    u = [np.sqrt(np.diag(found.fit.covariance))[: len(nominal.parameters)] for found in (wide, stated)]
    mm = np.array([p.unit == "mm" for p in nominal.parameters])
    # three freedoms tell little of 54 parameters: the drawing holds most
    assert np.median(u[0][mm]) > 2.0
    assert 0.2 < np.median(u[1][mm]) <= 0.3
    assert (stated.fit.problem.width[: len(mm)][mm] == 0.3).all()
    assert (u[1] < u[0]).all()


def test_files_of_parallel_robots_are_written_and_refused() -> None:
    nominal = shipped("four-chains-arms")
    assert robot_from_dict(nominal.to_dict()) == nominal
    for name in NAMES:
        file = shipped(name)
        changed = file.with_values({p.name: p.value + 0.01 for p in file.model.parameters})
        moved = file.model.moved(np.array([0.01 * p.size for p in file.model.parameters]))
        for one, other in zip(changed.leg, moved.legs, strict=True):
            np.testing.assert_allclose(one.values, other.values, atol=1e-12)
            np.testing.assert_allclose(one.platform_mm, other.point, atol=1e-12)

    def refused(match: str, name: str = "rotopod-cell", leg: dict[str, object] | None = None, **top: object) -> None:
        data = shipped(name).to_dict() | top
        data["leg"] = [*data["leg"]][: 5 if leg == {} else None]
        if leg is not None:
            data["leg"][0] = {**data["leg"][0], **leg}
        with pytest.raises(RobotError, match=match):
            robot_from_dict(data, "robot.toml")

    refused("robot.toml: leg: 5 equations constrain the platform", leg={})
    refused("home: leg_1 does not reach there", leg={"rod_mm": 100.0})
    refused("leg leg_1: its least joint value is not below", leg={"min_deg": 800.0})
    refused("leg: the name 'leg_2' is given twice", leg={"name": "leg_2"})
    refused("home: leg_1 is beyond its limits", leg={"min_deg": 10.0, "max_deg": 20.0})
    refused("commanded: must name 3 of rx, ry, rz, x, y, z", "crank-platform", commanded=["z"])
    refused("base_axis and platform_axis: state both or none", "logos", leg={"base_axis": None})
    refused("rod_mm: ", leg={"rod_mm": -1.0})
    flat = {"position_mm": [0.0, 0.0, 0.001], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
    refused("home: ", "logos", home=flat)
