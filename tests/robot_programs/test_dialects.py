"""Programs of controllers go through and back with nothing but their targets changed; an independent reader computes the same poses."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from programs import ALL, UR, about, homogeneous, listed
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.robot_programs import Dialect, Listing, dialect_of, opened
from lmeasure.robot_programs.program import Source, as_written, rewritten


def matrix(row: FloatArray) -> np.ndarray:
    return homogeneous(list(row[:3]), se3.matrices(row))


def in_the_robot(dialect: Dialect, listing: Listing, name: str) -> np.ndarray:
    """base_from_flange of a target, through the frames of the listing."""
    target = next(t for t in listing.targets if t.name == name)
    pose = se3.compose(listing.frames[target.base], dialect.pose(target.values))
    return matrix(se3.compose(pose, se3.inverse(listing.frames[target.tool])))


def abc(x: float, y: float, z: float, a: float, b: float, c: float) -> np.ndarray:
    return homogeneous([x, y, z], about(2, a) @ about(1, b) @ about(0, c))


def wpr(x: float, y: float, z: float, w: float, p: float, r: float) -> np.ndarray:
    return homogeneous([x, y, z], about(2, r) @ about(1, p) @ about(0, w))


def quaternion(place: list[float], q: list[float]) -> np.ndarray:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return homogeneous(place, np.array(turn))


def test_what_krl_moves_to() -> None:
    dialect, listing = listed("krl")
    names = [t.name for t in listing.targets]
    assert sorted(names) == sorted(
        ["LIN of line 17", "CIRC of line 20", "CIRC of line 20", "LIN of line 30", "XP1", "XP2", "XHOME", "TAUGHT"]
    )
    grip, fixture = abc(0, 0, 120, 0, 0, 0), abc(100, 0, 50, 30, 0, 0)
    expected = {
        "XP1": abc(50, 60, 70, 90, 0, 0) @ abc(1000.5, -200.25, 800.125, 180, 0.5, 179.9) @ np.linalg.inv(grip),
        "XP2": abc(900, 100, 700, -90, 45.5, 10) @ np.linalg.inv(grip),
        "TAUGHT": fixture @ abc(100, 20.5, -3.25, 1, 2, 3) @ np.linalg.inv(grip),
        "LIN of line 17": fixture @ abc(10, 20, 30, 0, 90, 0) @ np.linalg.inv(grip),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(in_the_robot(dialect, listing, name), value, atol=1e-9)
    assert next(t for t in listing.targets if t.name == "XP1").flags == {"S": 2, "T": 10}
    assert next(t for t in listing.targets if t.name == "XHOME").joints
    said = [str(u) for u in listing.stated({}).unread]
    for part in (
        "pick.src:18: LIN_REL: a relative move, not a target",
        "pick.src:27: LIN XP1:{X 0,Y 0,Z 50,A 0,B 0,C 0}: a computed target",
        "pick.src:28: LIN of line 28: X, Y, A, B, C not stated",
        "UNUSED: no motion uses it here, so its frames are unknown",
        "TWICE: used in several frames: $BASE of line 23 / TOOL_DATA[1], $NULLFRAME / TOOL_DATA[1]",
        "pick.src:30: LIN of line 30: the frame BASE_DATA[7] is not stated",
    ):
        assert any(part in line for line in said), (part, said)
    assert len(said) == 6
    reported = listing.stated({"BASE_DATA[7]": np.array([1.0, 0, 0, 0, 0, 0, 1])})
    assert "LIN of line 30" in [t.name for t in reported.targets]


def test_what_rapid_moves_to() -> None:
    dialect, listing = listed("rapid")
    listing = listing.stated({})
    grip = quaternion([0, 0, 120.5], [1, 0, 0, 0])
    fixture = quaternion([500, 0, 100], [0.707106781, 0, 0, 0.707106781]) @ quaternion([0, 10, 0], [1, 0, 0, 0])
    expected = {
        "p10": quaternion([600.25, -100.5, 400], [0, 0, 1, 0]) @ np.linalg.inv(grip),
        "p20": fixture @ quaternion([10, 20, 30], [0.5, 0.5, -0.5, 0.5]) @ np.linalg.inv(grip),
        "MoveL of line 19": quaternion([1.5, 2.5, 3.5], [1, 0, 0, 0]),
        "MoveC of line 20": fixture @ quaternion([7, 8, 9], [1, 0, 0, 0]),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(in_the_robot(dialect, listing, name), value, atol=1e-6)
    assert {t.name for t in listing.targets} == {*expected, "jHome"}
    assert next(t for t in listing.targets if t.name == "p20").flags == {"cf1": -1, "cf4": 0, "cf6": -1, "cfx": 0}
    said = [str(u) for u in listing.unread]
    for part in (
        "wBelt: a moving work object",
        "pGrid: an array of robtarget",
        "MoveL Offs(p20,0,0,50): a computed target",
        "pTwo: used in several frames: wfix / tgrip, wobj0 / tgrip",
        "pFree: no motion uses it",
        "pBelt: the frame wbelt is not stated",
        "MoveL pGrid{1}: a computed target",
    ):
        assert any(part in line for line in said), (part, said)
    assert len(said) == 7


def test_what_fanuc_moves_to() -> None:
    dialect, listing = listed("fanuc")
    stated = {"UF[1]": np.array([10.0, 20, 30, 0, 0, np.sqrt(0.5), np.sqrt(0.5)]), "UT[2]": np.array([0, 0, 100.0, 0, 0, 0, 1])}
    listing = listing.stated(stated)
    assert {t.name for t in listing.targets} == {"P[1]", "P[2]", "P[4]", "P[5]", "P[6]"}
    user, grip = wpr(10, 20, 30, 0, 0, 90), wpr(0, 0, 100, 0, 0, 0)
    np.testing.assert_allclose(
        in_the_robot(dialect, listing, "P[2]"), user @ wpr(410.125, -22.5, 300, -179.9, 0.5, 20) @ np.linalg.inv(grip), atol=1e-9
    )
    np.testing.assert_allclose(
        in_the_robot(dialect, listing, "P[5]"), wpr(440, -52.5, 300, -179.9, 0.5, 50) @ np.linalg.inv(grip), atol=1e-9
    )
    assert next(t for t in listing.targets if t.name == "P[1]").flags == {
        "flip": 0, "up": 1, "front": 1, "turn1": 0, "turn2": 0, "turn3": 0,
    }  # fmt: skip
    said = [str(u) for u in listing.unread]
    for part in ("L PR[7]: a computed position", "P[3]: is a target of OFFSET", "P[7]: no motion uses it", "P[8]: not taught"):
        assert any(part in line for line in said), (part, said)
    assert len(said) == 4
    assert {t.name for t in listed("fanuc")[1].stated({}).targets} == {"P[6]"}  # frames of a controller are in no listing


def test_what_ur_script_moves_to() -> None:
    dialect, listing = listed("ur-script")
    listing = listing.stated({})

    def vector(place: list[float], turn: list[float]) -> np.ndarray:
        angle = float(np.linalg.norm(turn))
        k = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]]) / (angle or 1.0)
        return homogeneous([1000 * v for v in place], np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)

    first, second = vector([0, 0, 0.1205], [0, 0, 0]), vector([0, 0, 0.2], [0, 0, 0])
    expected = {
        "at_part_p": vector([0.4001, -0.2002, 0.3003], [3.14, 0.01, 0.02]) @ np.linalg.inv(first),
        "movel of line 16": vector([0.5, 0.1, 0.05], [0, 0, 1.570796]) @ vector([0.01, 0.02, 0.03], [0.1, 0.2, 0.3]) @ np.linalg.inv(first),
        "movel of line 23": vector([0.3, 0.2, 0.1], [0, 3.1, 0]) @ np.linalg.inv(second),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(in_the_robot(dialect, listing, name), value, atol=1e-9)
    assert sorted(t.name for t in listing.targets) == sorted(
        [*expected, "home_q", "movej of line 15", "movec of line 17", "movec of line 17"]
    )
    said = [str(u) for u in listing.unread]
    for part in (
        "movel above_p: a target that is computed, or set elsewhere",
        "movel changed_p: a target",
        "movej get_inverse_kin(above_p): a target",
    ):
        assert any(part in line for line in said), (part, said)
    assert len(said) == 3
    without = UR.replace("set_tcp(p[0.0, 0.0, 0.1205, 0.0, 0.0, 0.0])", "set_tcp(measured)")
    lost = listed("ur-script", (("a.script", without),))[1].stated({})
    assert any("the frame set_tcp of a.script:3 is not stated" in str(u) for u in lost.unread)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(ALL)), st.integers(0, 10**6))
def test_numbers_and_poses_are_inverse(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    dialect, _ = listed(name)
    row = se3.pose(rng.uniform(-1000, 1000, 3), Rotation.random(random_state=rng))
    old = dialect.numbers(se3.displaced(row, rng.uniform(-1, 1, 6) * 0.01), [0.0] * 7).tolist()
    assert np.abs(se3.displacement(dialect.pose(dialect.numbers(row, old).tolist()), row)).max() < 1e-9


MOTIONS = {
    "krl": ["XP1", "XP2", "XHOME", "TAUGHT", "LIN of line 17", "CIRC of line 20", "CIRC of line 20", "LIN of line 30"],
    "rapid": ["jHome", "p10", "p20", "MoveL of line 19", "MoveC of line 20", "MoveC of line 20", "pBelt"],
    "fanuc": ["P[1]", "P[2]", "P[4]", "P[5]", "P[6]"],
    "ur-script": [
        *("home_q", "at_part_p", "movej of line 15", "movel of line 16"),
        *("movec of line 17", "movec of line 17", "movel of line 23"),
    ],
}


@pytest.mark.parametrize("name", sorted(MOTIONS))
def test_targets_are_ordered_by_their_motions(name: str) -> None:
    """Not by where their numbers stand: data come before or behind all motions, and in another order."""
    _, listing = listed(name)
    assert [t.name for t in sorted(listing.targets, key=lambda t: t.moved)] == MOTIONS[name]


@pytest.mark.parametrize(
    ("text", "name", "targets"),
    [
        ("name,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,1.5,2,3,0,0,0,1\nb,1,x,3,0,0,0,1\n", "csv", 1),
        ("name;x_mm;y_mm;z_mm;a_deg;b_deg;c_deg\r\na;1,5;2,25;3;10;20;30\r\n", "csv", 1),
        ('\xef\xbb\xbfname,joint_1_deg,joint_2_deg\n"a, b",10,20\n# remark\nc,11,21,5\n', "csv", 1),
        ("X,Y,Z,Rx,Ry,Rz\n1,2,3,4,5,6\n", "robodk", 1),
        ("name,J1,J2,J3,J4,J5,J6\np,1,2,3,4,5,6\n", "robodk", 1),
    ],
)
def test_tables(text: str, name: str, targets: int) -> None:
    dialect, listing = listed(name, (("a.csv", text),))
    assert len(listing.targets) == targets
    target = listing.targets[0]
    if target.joints:
        moved = rewritten(listing, dialect, {0: [v + 1.5 for v in target.values]})[0]
        assert dialect.read([Source("a.csv", moved)]).targets[0].values == tuple(v + 1.5 for v in target.values)
    else:
        pose = se3.displaced(dialect.pose(target.values), [0.0, 0.0, 0.01, 1.25, 0.0, 0.0])
        moved = rewritten(listing, dialect, {0: dialect.numbers(pose, target.values).tolist()})[0]
        again = dialect.read([Source("a.csv", moved)]).targets[0]
        assert np.abs(se3.displacement(dialect.pose(again.values), pose)).max() < 1e-6
        assert moved.count("\n") == text.count("\n")
        assert moved.count("\r") == text.count("\r")
        if "1,5" in text:
            assert "2,75" in moved


def test_numbers_look_as_they_did() -> None:
    assert as_written("100", 100.00001, 4) == "100"
    assert as_written("100", 100.25, 4) == "100.2500"
    assert as_written("+20.5", 20.75, 2) == "+20.75"
    assert as_written("1.0E2", -0.00001, 4) == "0.0000"
    assert as_written("-3.123456", -3.5, 4) == "-3.500000"


def test_which_dialect(tmp_path: Path) -> None:
    for name in ("a.src", "b.mod"):
        (tmp_path / name).write_bytes(b"\xff\x80 caf\xe9\r\n")
    paths = [tmp_path / "a.src"]
    assert opened(paths)[0].text.encode("latin-1") == b"\xff\x80 caf\xe9\r\n"
    assert dialect_of(paths, opened(paths)).name == "krl"
    with pytest.raises(RobotError, match=r"do not decide the dialect. State --dialect krl or rapid"):
        dialect_of([tmp_path / "a.src", tmp_path / "b.mod"], opened(paths))
    with pytest.raises(RobotError, match="'cobol' is none of krl, rapid"):
        dialect_of(paths, opened(paths), "cobol")
