"""Corrections where they are hard: near singular poses, limits, half a turn; other robots than six-axis arms; boxes and largest sizes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.robot_programs import Corrected, Dialect, Source, corrected_program, fanuc, fits, krl, rapid, target_tables
from lmeasure.robots import IdentifiedRobot, Limits, RobotModel, any_shipped, whole_turns
from lmeasure.robots.correction.error_map import MOST_JOINT_RAD, correct
from lmeasure.robots.platform import Platform
from lmeasure.robots.robot import shipped

SIZES = {"theta_deg": 5e-4, "alpha_deg": 5e-4, "beta_deg": 5e-4, "d_mm": 0.3, "a_mm": 0.3}
HERE = np.array([0.0, 0, 0, 0, 0, 0, 1.0])
ARM: RobotModel = shipped("generic6").model


def built(nominal: RobotModel, seed: int, mm: float = 0.3) -> RobotModel:
    """Arms err in their links, parallel robots in every length."""
    rng = np.random.default_rng(seed)
    size = [SIZES.get(p.name.rpartition(".")[2], 0.0) if nominal is ARM else mm * (p.unit == "mm") for p in nominal.parameters]
    return nominal.moved(rng.normal(size=len(size)) * np.array(size))


def sign(robot: RobotModel, joints: FloatArray, h: float = 1e-6) -> float:
    """Of the determinant of differences of the flange's poses."""
    rows = [se3.displacement(robot.forward((joints + h * e)[None])[0], robot.forward((joints - h * e)[None])[0]) for e in np.eye(6)]
    return float(np.sign(np.linalg.det(np.array(rows) / ([1.0] * 3 + [1e3] * 3))))


def stretched() -> float:
    """Joint 3 at which the wrist's centre is farthest from the second axis: forearm (120, 850) along the upper arm."""
    return float(np.arctan2(850.0, 120.0) - np.pi) if sign(ARM, np.array([0, 0, np.arctan2(850.0, 120.0) + 0.1, 0.3, 0.8, 0])) == sign(
        ARM, np.array([0, 0, np.arctan2(850.0, 120.0) - 0.1, 0.3, 0.8, 0])) else float(np.arctan2(850.0, 120.0))  # fmt: skip


def test_never_another_branch_near_a_stretched_elbow_and_a_straight_wrist() -> None:
    rng = np.random.default_rng(3)
    kept = refused = 0
    for i in range(40):
        q = rng.uniform(-1.0, 1.0, 6)
        off = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3.5, -0.5))
        q[2], q[4] = (stretched() + off, 0.9) if i % 2 else (0.3, off)
        done = correct(ARM, built(ARM, i), q, Limits())
        refused += bool(done.refused)
        if done.refused:
            assert np.array_equal(done.joints, q)
            continue
        kept += 1
        assert sign(ARM, q) == sign(ARM, done.joints) != 0.0, (i, off)
        assert np.abs(done.joints - q).max() <= MOST_JOINT_RAD
        assert done.left_mm < 1e-6
        # the controller's nearest way to the told pose is the corrected one
        ways = ARM.inverse(done.flange)
        assert np.abs(ways - done.joints).max(axis=1).min() < 1e-6
    assert kept >= 8
    assert refused >= 8


def test_joint_limits_hold_after_the_correction() -> None:
    low, high = ARM.limits
    rng, said = np.random.default_rng(4), []
    for i in range(24):
        q = np.array([0.3, 0.1, 0.4, 0.5, 0.9, 0.2]) + rng.uniform(-0.2, 0.2, 6)
        axis, end = int(rng.choice([0, 3, 5])), bool(rng.integers(2))
        q[axis] = (high if end else low)[axis]
        done = correct(ARM, built(ARM, i), q, Limits())
        said.append("outside its limit" in done.refused)
        assert ((done.joints >= low) & (done.joints <= high)).all()
    assert 4 <= sum(said) <= 20


def identified(nominal: RobotModel, found: RobotModel) -> IdentifiedRobot:
    one = np.eye(1) * 1e-6
    return IdentifiedRobot(nominal, found, HERE, HERE, ("base.x_mm",), one, 0.02, 50.0, 1.0, False, found)


def program(targets: list[tuple[FloatArray, tuple[int, ...]]]) -> str:
    lines = []
    for q, conf in targets:
        x, y, z, *turn = ARM.forward(q[None])[0]
        numbers = f"[[{x:.6f},{y:.6f},{z:.6f}],[{turn[3]:.12f},{turn[0]:.12f},{turn[1]:.12f},{turn[2]:.12f}],[{','.join(map(str, conf))}]"
        lines.append(f"MoveL {numbers},[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;")
    return "\n".join(lines)


def done_with(
    text: str, dialect: Dialect, found: RobotModel, limits: Limits, name: str = "a.mod", near: FloatArray = HERE[:6]
) -> Corrected:
    listing = dialect.read([Source(name, text)]).stated({})
    return corrected_program(listing, dialect, identified(ARM, found), limits=limits, near=np.degrees(near).tolist())


@pytest.mark.parametrize("axis", [3, 5])
def test_quarters_and_half_turns_do_not_change_unseen(axis: int) -> None:
    """Axes 4 and 6 just before and behind 180 and -180 degrees: what would pass is left, what is kept has the quarter it states."""
    left = []
    for seed in range(8):
        for side, before in ((1.0, -1e-5), (-1.0, 1e-5)):
            q = np.array([0.2, 0.1, 0.3, 0.4, 0.9, 0.3])
            q[axis] = side * np.pi + before
            conf = (0, *(int(np.floor(q[j] / (np.pi / 2))) for j in (3, 5)), 0)
            found = built(ARM, seed)
            outcome = done_with(program([(q, conf)]), rapid.DIALECT, found, Limits(), near=q).outcomes[0]
            assert outcome.correction is not None
            passed = int(np.floor(outcome.correction.joints[axis] / (np.pi / 2))) != conf[axis // 2]
            assert bool(outcome.left) == passed
            assert not passed or "another configuration" in outcome.left
            left.append(passed)
    assert 0 < sum(left) < len(left)


def test_a_joint_at_nothing_is_found_and_its_sign_is_not_lost() -> None:
    """Axis 4 at 0, written with three decimals, so that it seems to be on either side: T says which, and what would change it is left."""
    q = np.radians([40.0, -5.0, 35.0, 0.0, 60.0, 30.0])
    pose = ARM.forward(q[None])[0]
    a, b, c = se3.rotation(pose).as_euler("ZYX", degrees=True)
    place = ",".join(f"{k} {v:.3f}" for k, v in zip("XYZABC", (*pose[:3], a, b, c), strict=True))
    left = 0
    for seed in range(4):
        for turn in (2, 10):
            text = f"$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\nPTP {{{place},S 2,T {turn}}}\n"
            outcome = done_with(text, krl.DIALECT, built(ARM, seed), Limits(), name="a.src", near=q).outcomes[0]
            assert outcome.correction is not None, outcome.left
            assert abs(outcome.correction.before[3]) < 1e-4
            other = (outcome.correction.joints[3] < 0.0) != (turn == 10)
            assert bool(outcome.left) == other
            left += other
    assert left == 4


def test_whole_turns_are_those_that_a_configuration_tells() -> None:
    """Axis 6 at 185 degrees, which is -175 too: the stated turn tells, not what is nearer to the target before."""
    q = np.radians([10.0, 5.0, 20.0, 15.0, 60.0, 185.0])
    x, y, z, *_ = ARM.forward(q[None])[0]
    w, p, r = se3.rotation(ARM.forward(q[None])[0]).as_euler("xyz", degrees=True)
    text = (
        "/MN\n1:L P[1] 1mm/sec FINE ;\n/POS\nP[1]{\n GP1:\n UF : 0, UT : 0, CONFIG : 'N U T, 0, 0, TURN',\n"
        f" X = {x:.6f} mm, Y = {y:.6f} mm, Z = {z:.6f} mm,\n W = {w:.9f} deg, P = {p:.9f} deg, R = {r:.9f} deg\n}};\n/END\n"
    )
    for turn, expected in (("1", 185.0), ("0", -175.0)):
        near = np.radians([0.0, 0, 0, 0, 60, -170])
        found = done_with(text.replace("TURN", turn), fanuc.DIALECT, ARM, Limits(), name="a.ls", near=near).outcomes[0]
        assert found.correction is not None
        assert np.degrees(found.correction.before[5]) == pytest.approx(expected, abs=1e-6)
    assert len(whole_turns(ARM, q)) == 4  # of axes 4 and 6, two each
    assert fits(fanuc.DIALECT, {"front": 1, "up": 1, "turn1": 0, "turn2": 0, "turn3": 1}, ARM, q)


def test_boxes_and_largest_sizes_hold_for_what_is_written() -> None:
    rng = np.random.default_rng(6)
    qs = np.array([0.2, 0.1, 0.3, 0.4, 0.9, 0.3]) + rng.uniform(-0.3, 0.3, (12, 6))
    found = built(ARM, 5)
    text = program(
        [(q, (int(np.floor(q[0] / (np.pi / 2))), int(np.floor(q[3] / (np.pi / 2))), int(np.floor(q[5] / (np.pi / 2))), 0)) for q in qs]
    )
    small = Limits(most_mm=0.2, most_rad=2e-4)
    sizes = [
        (o.correction.size_mm, o.correction.size_rad, o.left) for o in done_with(text, rapid.DIALECT, found, small).outcomes if o.correction
    ]
    assert any("exceeds the limits" in left for _, _, left in sizes)
    clipped = [o.correction for o in done_with(text, rapid.DIALECT, found, replace(small, clip=True)).outcomes if o.correction]
    assert len(clipped) == 12
    assert all(c.size_mm <= 0.2 and c.size_rad <= 2e-4 for c in clipped)
    assert any(c.clipped and 0.0 < c.left_mm < c.was_mm for c in clipped)
    # a box that the nominal place is outside of and the corrected one within, by a tenth of a millimetre
    whole = [o.correction for o in done_with(text, rapid.DIALECT, found, Limits()).outcomes if o.correction]
    at = found.forward(whole[3].joints[None])[0][:3]
    box = np.stack([at - 0.1, at + 0.1], axis=1)
    boxed = done_with(text, rapid.DIALECT, found, Limits(keep_out=(box,))).outcomes
    assert "keep-out box" in boxed[3].left
    assert boxed[3].values == boxed[3].target.values
    assert "keep-out box" in boxed[4].left  # the way to the next leads out of it
    assert not boxed[8].left


def test_seven_axes_move_as_little_as_may_be() -> None:
    robot = shipped("generic7").model
    rng = np.random.default_rng(7)
    found = robot.moved(np.array([rng.normal() * SIZES.get(p.name.rpartition(".")[2], 0.0) for p in robot.parameters]))
    for _ in range(6):
        q = rng.uniform(-0.9, 0.9, 7) + np.array([0, 0.3, 0, -1.0, 0, 0.8, 0])
        done = correct(robot, found, q, Limits())
        assert not done.refused
        assert done.left_mm < 1e-6
        _, twists, _ = found.derivatives(done.joints[None])
        still = np.linalg.svd(twists[0].T)[2][-1]  # the motion that leaves the flange where it is
        assert abs(still @ (done.joints - q)) < 0.05 * np.linalg.norm(done.joints - q) + 1e-7


@pytest.mark.parametrize("name", ["gough", "crank-platform", "four-chains"])
def test_parallel_robots_are_corrected_on_their_assembly(name: str) -> None:
    nominal: RobotModel = any_shipped(name).model
    found = built(nominal, 8, mm=0.05)
    low, high = nominal.limits
    home = nominal.inverse(nominal.home)[0]  # type: ignore[attr-defined]
    rng, kept = np.random.default_rng(9), 0
    for _ in range(4):
        q = home + np.where(nominal.sliding, 8.0, 0.05) * rng.uniform(-1.0, 1.0, len(home))
        if not np.isfinite(nominal.forward(q[None])).all():
            continue
        done = correct(nominal, found, q, Limits())
        if done.refused:
            continue
        kept += 1
        assert ((done.joints >= low) & (done.joints <= high)).all()

        def off(joints: FloatArray, wanted: FloatArray = done.wanted) -> FloatArray:
            return np.asarray(se3.displacement(wanted, found.forward(joints[None])[0]) / ([1.0] * 3 + [1e3] * 3))

        best = least_squares(off, q, x_scale=np.where(nominal.sliding, 1.0, 1e-2), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        assert np.linalg.norm(off(done.joints)) <= np.linalg.norm(best.fun) * (1.0 + 1e-6) + 1e-9
        assert len(q) < 6 or done.left_mm < 1e-4
    assert kept >= 2


def test_lengths_that_no_pose_has_are_refused_in_words() -> None:
    nominal = any_shipped("gough").model
    assert isinstance(nominal, Platform)
    low, high = nominal.limits
    far = np.where(np.arange(6) % 2, low - 200.0, high + 200.0)
    with pytest.raises(RobotError, match="no pose of the nominal or the identified robot"):
        correct(nominal, built(nominal, 1), far, Limits())
    near = nominal.inverse(nominal.home)[0]
    rows = [",".join([n, *(f"{v:.6f}" for v in values)]) for n, values in (("far", far), ("home", near))]
    text = "\n".join(["Name,J1,J2,J3,J4,J5,J6", *rows])
    wide = replace(nominal, low=low - 300.0, high=high + 300.0)
    listing = target_tables.ROBODK.read([Source("a.csv", text)]).stated({})
    outcomes = corrected_program(listing, target_tables.ROBODK, identified(wide, built(wide, 1)), limits=Limits()).outcomes
    assert outcomes[0].left.startswith("no pose")
    assert not outcomes[1].left


@pytest.mark.parametrize(
    ("conf", "off", "left"),
    [((0, 0, 0, 0), False, False), ((1, 0, 0, 0), False, True), ((1, 0, 0, 0), True, False), ((0, -2, -2, 1), True, True)],
)
def test_a_configuration_that_may_be_passed_over_is_no_proof(conf: tuple[int, ...], off: bool, left: bool) -> None:
    """With ConfL off the controller takes the nearest way: quarters that no way has do not matter then, those of another way do."""
    q = np.radians([20.0, -10.0, 15.0, 30.0, 60.0, 10.0])
    text = "ConfL\\Off;\n" * off + program([(q, conf)])
    outcome = done_with(text, rapid.DIALECT, built(ARM, 1), Limits(), near=q).outcomes[0]
    assert bool(outcome.left) == left
    assert not off or not left or "its configuration may not apply" in outcome.left
    if not left:
        assert outcome.correction is not None
        np.testing.assert_allclose(outcome.correction.before, q, atol=1e-6)
