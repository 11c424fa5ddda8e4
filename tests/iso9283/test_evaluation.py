"""Evaluation as a whole on trajectories made by hand: uncertainty against the law written out, verdicts, zone, frames, rests, refusals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import norm
from synthetic_trajectories import PLACES, UNIT, StatedErrors, by_name, dwells, some_law, synthetic_campaign, trajectory_of

from lmeasure.core import CertificationError, Status
from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.recording import Program

EXACT = StatedErrors()


def test_capable_and_the_verdict_of_the_vector() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.02)
    shared = np.zeros((6, 3))
    shared[3:] = 0.01 * np.eye(3)
    model = Program.model_validate(program)
    found = by_name(evaluate(trajectory, model, StatedErrors(shared=shared)))
    ap = found["AP_p", "P1"]
    assert ap.capable
    assert ap.limit_u95 == pytest.approx(0.25 * ap.value)
    # AP_y is near zero and known to 0.02 mm: its vector says whether the instrument was good enough
    assert found["AP_y", "P1"].u95 > 0.25 * abs(found["AP_y", "P1"].value)
    assert found["AP_y", "P1"].capable
    assert str(found["AP_y", "P1"].note) == "verdict of AP_p"
    # and of itself it says so beside
    assert found["AP_y", "P1"].capable_alone is False
    assert found["AP_x", "P1"].capable_alone is True
    assert found["AP_p", "P1"].capable_alone is None
    assert "capable_alone" not in found["AP_p", "P1"].as_dict()
    # nor does a tolerance make the component larger than its uncertainty
    program["tolerance"] = [{"characteristic": "AP_y", "pose": "P1", "lower": -0.2, "upper": 0.2}]
    held = by_name(evaluate(trajectory, Program.model_validate(program), StatedErrors(shared=shared)))["AP_y", "P1"]
    assert (held.capable, held.capable_alone) == (True, False)
    outside = by_name(evaluate(trajectory, model, StatedErrors(shared=shared), settings=CertificationSettings(limit_angle_deg=20.0)))[
        "AP_x", "P1"
    ]
    assert outside.excluded is not None
    assert (outside.capable, outside.capable_alone) == (False, False)
    strict = by_name(evaluate(trajectory, model, StatedErrors(shared=shared), settings=CertificationSettings(capability=0.01)))
    assert not strict["AP_p", "P1"].capable
    assert not strict["AP_y", "P1"].capable


@pytest.mark.parametrize(
    ("rule", "upper", "verdict"),
    [
        ("simple", 0.31, "conforms"), ("simple", 0.29, "does not conform"), ("guarded", 0.31, "not decided"),
        ("guarded", 0.29, "not decided"), ("guarded", 0.35, "conforms"), ("guarded", 0.25, "does not conform"),
    ],
)  # fmt: skip
def test_conformity(rule: str, upper: float, verdict: str) -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.0)
    shared = np.zeros((6, 3))
    shared[3:] = 0.01 * np.eye(3)
    program["tolerance"] = [{"characteristic": "AP_p", "pose": "P1", "upper": upper, "rule": rule}]
    found = by_name(
        evaluate(trajectory, Program.model_validate(program), StatedErrors(shared=shared), settings=CertificationSettings(trials=5000))
    )
    c = found["AP_p", "P1"].conformity
    assert c is not None
    assert c.verdict == verdict
    assert c.probability == pytest.approx(norm.cdf((upper - 0.3) / 0.01), abs=0.02)
    assert found["AP_p", "P2"].conformity is None


def test_a_signed_figure_is_held_against_its_tolerance() -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.02)
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.02**2 * np.eye(3)
    bare = by_name(evaluate(trajectory, Program.model_validate(program), StatedErrors(random)))["AD_p", "P1-P2"]
    assert not bare.capable
    program["tolerance"] = [{"characteristic": "AD_p", "lower": -0.2, "upper": 0.2}]
    stated = by_name(evaluate(trajectory, Program.model_validate(program), StatedErrors(random)))["AD_p", "P1-P2"]
    assert stated.capable
    assert stated.limit_u95 == pytest.approx(0.05)


def test_what_lies_outside_the_zone_gets_no_verdict() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.02)
    program["tolerance"] = [{"characteristic": "AP_p", "upper": 1.0}]
    first, last = program["pose"][1]["windows_s"][3]
    inside = (trajectory.time_s >= first) & (trajectory.time_s <= last)
    trajectory = replace(trajectory, worst_pressure_angle_deg=np.where(inside, 63.25, 30.0))
    model = Program.model_validate(program)
    found = evaluate(trajectory, model, EXACT)
    assert [(e.kind, e.name) for e in found.excluded] == [("pose", "P2")]
    assert str(found.excluded[0].reason) == "worst pressure angle 63.2 deg. The zone ends at 60 deg"
    c = by_name(found)
    for key in (("AP_p", "P2"), ("AP_x", "P2"), ("RP_l", "P2"), ("AD_p", "P1-P2")):
        assert not c[key].capable
        assert str(c[key].excluded) == f"pose P2: {found.excluded[0].reason}"
        assert c[key].conformity is None
    assert c["AP_p", "P1"].capable
    assert evaluate(trajectory, model, EXACT, settings=CertificationSettings(limit_angle_deg=None)).excluded == ()
    # what is told of moves and loads is held against the zone in windows of its own
    program["posing"] = [{"from": "P1", "to": "P2", "windows_s": [(first - 1.2, last)], "limit_band_mm": 1.0}]
    program["compliance"] = [{"pose": "P2", "windows_s": [(first, last)], "force_n": [(1.0, 0.0, 0.0)]}]
    more = evaluate(trajectory, Program.model_validate(program), EXACT)
    assert [(e.kind, e.name) for e in more.excluded] == [("pose", "P2"), ("compliance", "1"), ("posing", "P1-P2")]
    assert by_name(more)["t_min", "P1-P2"].excluded is not None
    # the other limit: the radius that holds 95 %
    random = np.zeros((6, 6))
    random[3:, 3:] = 0.01**2 * np.eye(3)
    tight = evaluate(trajectory, model, StatedErrors(random), settings=CertificationSettings(limit_angle_deg=None, limit_u95_mm=0.02))
    assert [e.name for e in tight.excluded] == ["P1", "P2"]
    assert "U95 of a position 0.02795 mm" in str(tight.excluded[0].reason)


def test_a_frame_is_fitted_only_when_asked() -> None:
    names = ("P1", "P2", "P3", "P4")
    trajectory, program = synthetic_campaign(np.zeros(3), 0.02, cycles=5, names=names)
    turn, shift = Rotation.from_rotvec([0.01, -0.02, 0.03]), np.array([3.0, -2.0, 1.0])
    poses = trajectory.poses.copy()
    poses[:, :3] = turn.apply(poses[:, :3]) + shift
    poses[:, 3:] = (turn * Rotation.from_quat(poses[:, 3:])).as_quat()
    moved, model = replace(trajectory, poses=poses), Program.model_validate(program)
    plain, fitted = by_name(evaluate(trajectory, model, EXACT)), evaluate(moved, model, EXACT, settings=CertificationSettings(align=True))
    assert by_name(evaluate(moved, model, EXACT))["AP_p", "P1"].value > 3.0
    assert fitted.base_from_program is not None
    np.testing.assert_allclose(fitted.base_from_program[:3], shift, atol=0.05)
    c = by_name(fitted)
    for name in names:
        assert c["AP_p", name].value < 0.05
        assert c["RP_l", name].value == pytest.approx(plain["RP_l", name].value, rel=1e-6)
    # a frame far from the program's, in which every dwell lies nearer to another pose, is no other order
    far = poses.copy()
    far[:, :3] += [200.0, 0.0, 0.0]
    again = by_name(evaluate(replace(trajectory, poses=far), model, EXACT, settings=CertificationSettings(align=True)))
    assert again["AP_p", "P1"].value == pytest.approx(c["AP_p", "P1"].value, abs=1e-9)
    # an error that is a displacement of everything is taken out by the fit
    shared = np.zeros((6, 3))
    shared[3:] = 0.5 * np.eye(3)
    assert by_name(evaluate(moved, model, StatedErrors(shared=shared), settings=CertificationSettings(align=True)))["AP_x", "P1"].u95 < 1e-6
    program["pose"] = program["pose"][:2]
    with pytest.raises(CertificationError, match="fix no frame"):
        evaluate(moved, Program.model_validate(program), EXACT, settings=CertificationSettings(align=True))


def test_a_point_of_the_tool() -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.0, cycles=2, names=("P1",))
    turn = np.array([0.0, 0.0, 0.001])
    trajectory = trajectory_of(trajectory.time_s, trajectory.poses[:, :3], np.tile(turn, (len(trajectory.time_s), 1)))
    random = np.zeros((6, 6))
    random[2, 2] = 1e-5**2
    program["pose"][0]["position_mm"] = (100.0, 0.0, 0.0)
    model = Program.model_validate(program)
    found = by_name(evaluate(trajectory, model, StatedErrors(random), settings=CertificationSettings(tool_offset_mm=(100.0, 0.0, 0.0))))
    # 1 mrad of turn moves the point by 0.1 mm, 10 microrad of doubt by a micrometre, halved by sqrt 2 for two cycles
    assert found["AP_y", "P1"].value == pytest.approx(0.1, abs=1e-5)
    assert found["AP_y", "P1"].u_random == pytest.approx(1e-3 / np.sqrt(2), rel=0.1)


@settings(max_examples=10, deadline=None)
@given(st.permutations(range(4)))
def test_the_order_of_cycles_changes_no_figure(order: list[int]) -> None:
    trajectory, program = synthetic_campaign(np.array([0.1, 0.2, 0.3]), 0.05, cycles=4, names=("P1",))
    places = [trajectory.poses[int(100 * s + 5), :3] for s, _ in program["pose"][0]["windows_s"]]
    time_s, position, windows = dwells(np.array(places)[order])
    program["pose"][0]["windows_s"] = windows
    there = evaluate(trajectory_of(time_s, position), Program.model_validate(program), EXACT)
    here = evaluate(trajectory, Program.model_validate(program), EXACT)
    for a, b in zip(there.characteristics, here.characteristics, strict=True):
        assert a.value == pytest.approx(b.value, abs=1e-9)


def test_rests_are_found_where_no_windows_are_stated() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.1, 0.0]), 0.05, cycles=6, names=("P1", "P2", "P3"))
    stated = by_name(evaluate(trajectory, Program.model_validate(program), EXACT))
    for pose in program["pose"]:
        del pose["windows_s"]
    program["path"] = [{"name": "way", "kind": "linear", "start_mm": PLACES["P1"], "end_mm": PLACES["P2"], "speed_mm_s": 400.0}]
    found = evaluate(trajectory, Program.model_validate(program), EXACT)
    assert any("18 rests" in note for note in found.notes)
    for key, c in by_name(found).items():
        if key[1] is not None:
            assert c.value == pytest.approx(stated[key].value, abs=1e-6)
    way = {c.name: c for c in found.characteristics if c.path == "way"}
    assert way["AT_p"].cycles == 6
    # 0.3 mm along the path does not count, 0.1 across does
    assert way["AT_p"].value == pytest.approx(0.1, abs=0.06)
    assert way["AV"].value == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("what", ["missing", "far", "cycles"])
def test_rests_that_are_not_the_programs(what: str) -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.02, cycles=3, names=("P1", "P2", "P3"))
    for pose in program["pose"]:
        del pose["windows_s"]
    said = {
        "missing": "pose P3: the trajectory has 2 rests at it.*state windows_s of the complete cycles",
        "far": "no rest within",
        "cycles": "found 3 cycles in the trajectory. The program states 5",
    }
    if what == "missing":
        keep = trajectory.time_s < 8.2
        trajectory = trajectory_of(trajectory.time_s[keep], trajectory.poses[keep, :3])
    elif what == "far":
        program["pose"][0]["position_mm"] = (0.0, 0.0, -90.0)
    else:
        program["pose"][0]["cycles"] = 5
    with pytest.raises(CertificationError, match=said[what]) as caught:
        evaluate(trajectory, Program.model_validate(program), EXACT)
    assert "\n" not in str(caught.value)


def test_windows_that_cannot_be_told() -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.02, cycles=3)
    model = Program.model_validate(program)
    start = program["pose"][0]["windows_s"][1][0]
    i = round(start * 100) + 7

    def refused(changed: Any, said: str) -> None:
        with pytest.raises(CertificationError, match=said) as caught:
            evaluate(changed, model, EXACT)
        assert "pose P1, cycle 2" in str(caught.value)

    poses = trajectory.poses.copy()
    poses[i] = np.nan
    status, cause = trajectory.status.copy(), trajectory.cause.copy()
    status[i], cause[i] = Status.GAP, "channel ch3 has no count"
    refused(replace(trajectory, poses=poses, status=status, cause=cause), f"sample {i} at .* s is not ok: channel ch3 has no count")
    refused(replace(trajectory, poses=poses), f"sample {i} at")
    poses = trajectory.poses.copy()
    poses[i, 3:] *= 1.01
    refused(replace(trajectory, poses=poses), f"sample {i} at .*: the quaternion's length is 1.01, not 1")
    for value in (np.inf, 1e300):
        poses = trajectory.poses.copy()
        poses[i, 1] = value
        refused(replace(trajectory, poses=poses), f"sample {i} at .* contains a number that is no position or quaternion")
    poses = trajectory.poses.copy()
    poses[i, 0] += 0.3
    refused(replace(trajectory, poses=poses), f"the robot moves in the window .* sample {i} at .* is 0.3 mm from the middle")
    # the robot went to P2 first
    swapped = [dict(p) for p in program["pose"]]
    swapped[0]["windows_s"], swapped[1]["windows_s"] = swapped[1]["windows_s"], swapped[0]["windows_s"]
    with pytest.raises(CertificationError, match=r"P1 and .* mm from P2: the program runs in another order than its windows"):
        evaluate(trajectory, Program.model_validate(program | {"pose": swapped}), EXACT)
    # it went to a pose that is commanded but not rested at
    elsewhere = [dict(p) for p in swapped]
    elsewhere[1].pop("windows_s")
    with pytest.raises(CertificationError, match=r"P1 and .* mm from P2: the program runs in another order than its windows"):
        evaluate(trajectory, Program.model_validate(program | {"pose": elsewhere}), EXACT)
    late = [dict(p) for p in program["pose"]]
    late[1]["windows_s"] = [(1000.0, 1001.0)]
    with pytest.raises(CertificationError, match=r"pose P2, cycle 1: the trajectory has no sample within \[1000, 1001\] s"):
        evaluate(trajectory, Program.model_validate(program | {"pose": late}), EXACT)


def test_a_robot_that_misses_poses_by_more_than_they_are_apart_runs_in_order() -> None:
    rng = np.random.default_rng(2)
    names = {"P1": (0.0, 0.0, 0.0), "near it": (1.5, 0.0, 0.0), "P2": (200.0, 0.0, 0.0), "P3": (0.0, 150.0, 0.0)}
    places = np.array([np.array(at) + [1.3, 0.2, 0.0] + 0.02 * rng.normal(size=3) for _ in range(4) for at in names.values()])
    time_s, position, windows = dwells(places)
    poses = [{"name": n, "position_mm": at, "quaternion_xyzw": UNIT, "windows_s": windows[i::4]} for i, (n, at) in enumerate(names.items())]
    # moved to, not rested at: nearer to where the tool is at P1
    poses.append({"name": "on the way", "position_mm": (1.3, 0.2, 0.0), "quaternion_xyzw": UNIT})
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": poses})
    found = by_name(evaluate(trajectory_of(time_s, position), program, EXACT))
    assert found["AP_p", "P1"].value == pytest.approx(np.hypot(1.3, 0.2), abs=0.05)


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (3000.0, 0.0, 0.0), (500.0, -900.0, 2000.0)])
def test_a_robot_beside_its_poses_as_a_whole_runs_in_order(away: tuple[float, float, float]) -> None:
    """60 mm beside them, it is nearer to the next pose each time; one that is bent otherwise, too, is told to be far, not in disorder."""
    names = {f"P{i + 1}": (70.0 * i, 20.0 * i**2, 0.0) for i in range(4)}
    at = np.array(list(names.values()))

    def requested(places: np.ndarray) -> Any:
        time_s, position, windows = dwells(np.vstack([places] * 4))
        poses = [
            {"name": n, "position_mm": p, "quaternion_xyzw": UNIT, "windows_s": windows[i::4]} for i, (n, p) in enumerate(names.items())
        ]
        program = Program.model_validate({"schema": "lmeasure.program/1", "pose": poses})
        return by_name(evaluate(trajectory_of(time_s, position), program, EXACT))

    # wherever in the cell
    at = at + np.array(away)
    names = {name: (float(x), float(y), float(z)) for name, (x, y, z) in zip(names, at, strict=True)}
    turned = Rotation.from_euler("z", 4.0, degrees=True).apply(at - away) + away + [62.0, 18.0, 0.0]
    assert requested(turned)["AP_p", "P1"].value == pytest.approx(np.hypot(62.0, 18.0), abs=0.05)
    bent = at + np.array([[66.0, 19.0, 0.0], [50.0, 50.0, 25.0], [64.0, 90.0, 0.0], [60.0, 10.0, 45.0]])
    with pytest.raises(
        CertificationError, match=r"mm from P1 and .* mm from P2: it is so far from all poses \(median .* mm from the nearest one"
    ):
        requested(bent)


def test_what_no_figure_can_be_told_from() -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.02, cycles=3, names=("P1",))
    model = Program.model_validate(program)

    def refused(said: str, changed: Any = trajectory, of: Program = model, **chosen: Any) -> None:
        with pytest.raises(CertificationError, match=said):
            evaluate(changed, of, EXACT, settings=CertificationSettings(**chosen))

    refused("neither poses nor paths", of=Program.model_validate({"schema": "lmeasure.program/1"}))
    times = trajectory.time_s.copy()
    times[8] = times[7]
    refused("sample 8 of the trajectory: its time, 0.07 s, is not after", replace(trajectory, time_s=times))
    refused("trials = 0 is not positive", trials=0)
    refused("still_mm = nan is not positive", still_mm=float("nan"))
    refused("planes = 3 normal to a path are too few: at least 10", planes=3)
    poses = trajectory.poses.copy()
    poses[60] = np.nan
    refused("sample 60 at 0.6 s has no position, though its status is ok", replace(trajectory, poses=poses))
    poses = trajectory.poses.copy()
    poses[:, 3:] = np.nan
    point = replace(trajectory, poses=poses)
    refused("has no orientation", point, tool_offset_mm=(1.0, 0.0, 0.0))
    # where only the position of a point is measured there are only its figures
    names = {c.name for c in evaluate(point, model, EXACT).characteristics}
    assert names == {"AP_p", "AP_x", "AP_y", "AP_z", "RP_l"}


def test_figures_over_groups_of_cycles() -> None:
    _, program = synthetic_campaign(np.zeros(3), 0.0, cycles=12, names=("P1",))
    places = np.zeros((12, 3))
    places[:, 0] = np.tile([0.0, 0.3, 0.3], 4)
    places[:, 1] = np.tile([0.0, 0.0, 0.4], 4)
    places[6:, 2] = 1.2
    time_s, position, windows = dwells(places)
    program["pose"][0] |= {"windows_s": windows, "approaches": ["x", "y", "z"] * 4, "units": ["one"] * 6 + ["other"] * 6}
    program["drift"] = [{"pose": "P1", "group": 6}]
    found = by_name(evaluate(trajectory_of(time_s, position), Program.model_validate(program), EXACT))
    assert found["vAP_p", "P1"].value == pytest.approx(0.5)
    assert found["E", "P1"].value == pytest.approx(1.2)
    first = np.hypot(0.2, 0.4 / 3)
    assert found["dAP_p", "P1"].value == pytest.approx(np.hypot(first, 1.2) - first)
    assert found["dRP_l", "P1"].value == pytest.approx(0.0, abs=1e-9)


def test_settling_posing_and_compliance_of_a_trajectory() -> None:
    rate = 1000.0
    t = np.arange(0, 2.0, 1 / rate)
    # rest at P1 until 0.5 s, 200 mm to P2 in 0.4 s, then a swing of 2 mm that dies down: within 0.5 mm for good at 0.9 + 0.2 ln 4 at latest
    way = 200.0 * np.clip((t - 0.5) / 0.4, 0.0, 1.0)
    swing = np.where(t > 0.9, 2.0 * np.exp(-(t - 0.9) / 0.2) * np.sin(2 * np.pi * 10 * (t - 0.9)), 0.0)
    loads = np.array([0.0, 10.0, 20.0])
    loaded = np.concatenate([np.tile([0.002 * f, 0.0, 0.001 * f], (500, 1)) for f in loads])
    position = np.concatenate([np.column_stack([way + swing, 0 * t, 0 * t]), loaded])
    time_s = np.arange(len(position)) / rate
    program = {
        "schema": "lmeasure.program/1",
        "pose": [
            {"name": "P1", "position_mm": (0.0, 0.0, 0.0), "quaternion_xyzw": UNIT},
            {"name": "P2", "position_mm": (200.0, 0, 0), "quaternion_xyzw": UNIT, "settling_s": [(0.8, 1.999)], "limit_band_mm": 0.5},
        ],
        "posing": [{"from": "P1", "to": "P2", "windows_s": [(0.2, 1.999)], "limit_band_mm": 0.5}],
        "compliance": [
            {"pose": "P1", "windows_s": [(2.1, 2.4), (2.6, 2.9), (3.1, 3.4)], "force_n": [(f, 0.0, 0.0) for f in loads]},
            {"pose": "P2", "force_n": [(1.0, 0.0, 0.0)]},  # not measured yet
        ],
    }
    found = by_name(evaluate(trajectory_of(time_s, position), Program.model_validate(program), EXACT))
    distance = np.abs(way + swing - 200.0)
    last = t[np.flatnonzero(distance > 0.5)[-1]]
    first = 0.5 + 0.4 * 199.5 / 200.0
    assert found["t_s", "P2"].value == pytest.approx(last - first, abs=2e-3)
    assert found["OV", "P2"].value == pytest.approx(distance[t > first].max(), abs=1e-2)
    assert found["t_min", "P1-P2"].value == pytest.approx(last - (0.5 + 0.4 * 0.5 / 200.0), abs=2e-3)
    assert found["C_x", "P1"].value == pytest.approx(0.002, rel=1e-9)
    assert found["C_x", "P1"].unit == "mm/N"
    assert ("C_y", "P1") not in found
    # a band that the robot does not come to rest in: the figures are left out, the reader is told
    program["pose"][1]["limit_band_mm"] = 1e-9  # type: ignore[index]
    program["posing"][0]["limit_band_mm"] = 1e-9  # type: ignore[index]
    left = evaluate(trajectory_of(time_s, position), Program.model_validate(program), EXACT)
    assert {("t_s", "P2"), ("t_min", "P1-P2")}.isdisjoint(by_name(left))
    assert [note for note in map(str, left.notes) if "1e-09 mm" in note] == [
        "pose P2, settling 1: the robot does not settle within 1e-09 mm in the window [0.8, 1.999] s",
        "posing P1-P2, cycle 1: no move from rest to rest within 1e-09 mm in the window [0.2, 1.999] s",
    ]


def test_angles_where_a_convention_is_singular() -> None:
    trajectory, program = synthetic_campaign(np.zeros(3), 0.02, cycles=3, names=("P1",))
    plain = evaluate(trajectory, Program.model_validate(program), EXACT)
    assert by_name(plain)["AP_a", "P1"].angles == "fanuc-wpr"
    assert any("'puma-oat' are singular" in note for note in plain.notes)
    # a convention that the user states is not exchanged for another
    stated = evaluate(trajectory, Program.model_validate(program | {"angles": "zyz"}), EXACT)
    assert ("AP_a", "P1") not in by_name(stated)
    assert by_name(stated)["AP_rot", "P1"].extension


def test_the_same_input_gives_the_same_figures() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.05)
    model = Program.model_validate(program)
    one, other = (evaluate(trajectory, model, StatedErrors(some_law(1), some_law(2))) for _ in range(2))
    assert one.characteristics == other.characteristics
    table = one.characteristics[0].as_dict()
    assert list(table)[:6] == ["name", "pose", "value", "unit", "u95", "capable"]
    assert all(isinstance(v, str | float | int | bool | dict | list) for v in table.values())


def test_angles_of_a_pose_are_counted_from_the_commanded_ones() -> None:
    """A tool that is turned by a right angle: angles and commanded ones together are half a turn, where they would jump."""
    off = np.array([0.1, -0.15, 0.2, 0.05, -0.1])
    half = np.radians(45.0)
    time_s, position, windows = dwells(np.zeros((5, 3)))
    cycle = np.clip(np.searchsorted([end for _, end in windows], time_s), 0, 4)
    turn = np.array([0.0, 0.0, 1.0]) * np.radians(90.0 + off[cycle])[:, None]
    quaternion = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    pose = {"name": "P1", "position_mm": (0.0, 0.0, 0.0), "quaternion_xyzw": quaternion, "windows_s": windows}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose]})
    found = by_name(
        evaluate(trajectory_of(time_s, position, turn), program, EXACT, settings=CertificationSettings(trials=10, angles="kuka-abc"))
    )
    assert found["AP_a", "P1"].value == pytest.approx(off.mean(), abs=1e-6)
    assert found["RP_a", "P1"].value == pytest.approx(3.0 * off.std(ddof=1), abs=1e-6)
