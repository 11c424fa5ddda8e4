"""`lmeasure structure` with drives at rods: the design of 4.3, input rods of chapter 3, the screw method, and refusals, all by command."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import code_and_text
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

SIDE = 20.0 * np.sin(np.pi / 3.0)
FEET = [(300.0, 0.0, 0.0), (-150.0, 260.0, 0.0), (-150.0, -260.0, 0.0)]
THROUGH = [(200.0, 0.0, 0.0), (-100.0, 170.0, 0.0), (-100.0, -170.0, 0.0)]
POINTS = [(240.0, 60.0, 20.0), (230.0, -70.0, 10.0), (10.0, 190.0, 0.0), (-180.0, 150.0, 15.0), (-160.0, -160.0, 5.0), (20.0, -210.0, 12.0)]


def rod(name: str, base: str, platform: str, length: float, joint: str) -> str:
    return f'[[rod]]\nname = "{name}"\nbase = "{base}"\nplatform = "{platform}"\njoint = "{joint}"\nlength_mm = {length}\n'


def link(one: str, other: str, more: str = "") -> str:
    return f'[[link]]\nfrom = "{one}"\nto = "{other}"\n{more}'


def points(side: str, letter: str, every: Any) -> str:
    return f"[{side}]\n" + "".join(f"{letter}{i} = {list(map(float, p))}\n" for i, p in enumerate(every, 1))


def pierced(side: float, last: float) -> str:
    """Figure 4.9 b: A1A2 of the platform and the third rod; rods of 70, base points 20 apart, A2A3 of 25, A1A3 of 35, drives to 45."""
    x = (35.0**2 - 25.0**2 + side**2) / (2.0 * side)
    platform = [(0.0, 0.0, 0.0), (side, 0.0, 0.0), (x, np.sqrt(35.0**2 - x**2), 0.0)]
    text = points("base", "B", [(0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (10.0, SIDE, 0.0)]) + points("platform", "A", platform)
    text += "".join(rod(f"P{i}", f"B{i}", f"A{i}", length, "platform") for i, length in ((1, 70.0), (2, 70.0), (3, last)))
    ends = ((1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (3, 3))
    return text + "".join(link(f"B{b}", f"P{r}", "limits_mm = [38.0, 45.0]\n") for b, r in ends)


def fed() -> str:
    text = points("base", "B", FEET) + points("platform", "C", THROUGH) + "".join(f"P{i} = {list(p)}\n" for i, p in enumerate(POINTS, 1))
    text += "".join(rod(f"D{i}", f"B{i}", f"C{i}", 800.0, "base") for i in (1, 2, 3))
    return text + "".join(link(f"D{(1, 1, 1, 2, 2, 3)[i]}", f"P{i + 1}", "limits_mm = [250.0, 550.0]\n") for i in range(6))


def found(folder: Path, text: str, *words: str) -> tuple[int, str, dict[str, Any]]:
    path = folder / "rods.toml"
    path.write_text('schema = "lmeasure.structure/1"\n' + text)
    out = folder / "s.json"
    code, said = code_and_text("structure", path, "--out", out, "--force", *words)
    return code, said, json.loads(out.read_text()) if code == 0 else {}


def test_the_design_of_4_3(tmp_path: Path) -> None:
    """With A1A2 of 45.2 and a rod of 75 no tetrahedron is ever flat."""
    code, _, record = found(tmp_path, pierced(45.2, 75.0), "--design")
    assert (code, record["design"]["clear_as_given"]) == (0, [True, True, True])
    assert record["design"]["free"] == record["design"]["given"]


def test_poses_rows_and_drives_that_lead_out_of_a_singular_pose(tmp_path: Path) -> None:
    text = pierced(45.2, 75.0)
    code, _, record = found(tmp_path, text, "--lengths-mm", "41,42,43,41,42,41")
    assert (code, record["status"], len(record["assemblies"]), record["rods"], record["straight_links"]) == (
        0,
        "all accounted for",
        8,
        3,
        True,
    )
    assert record["class"] == "L-321-321"
    one = next(a for a in record["assemblies"] if a["position_mm"][2] < 0.0)
    place, turn = ",".join(map(repr, one["position_mm"])), ",".join(map(repr, one["quaternion_xyzw"]))
    code, _, record = found(tmp_path, text, f"--position-mm={place}", f"--quaternion={turn}", "--singular", "--boundary", "xy")
    assert code == 0
    np.testing.assert_allclose(record["lengths_mm"], [41, 42, 43, 41, 42, 41], atol=1e-9)
    assert record["boundary"]["slices"][0]["closed"]
    assert {limit.split()[-1] for limit in record["boundary"]["slices"][0]["limits"]} <= {"long", "short"}
    at = record["singular_pose"]
    assert (at["rank"], at["extra_drives"]) == (5, None)
    for name, way in at["leads_out"].items():
        if way != "no part":
            number = int(name.split()[-1]) - 1
            assert [reaches(at, number, sign) for sign in (1.0, -1.0)] == [way == "lengthen", way == "shorten"], name


def drives(pose: np.ndarray) -> np.ndarray:
    """Of `pierced(45.2, 75)`, from points in space."""
    x = (35.0**2 - 25.0**2 + 45.2**2) / 90.4
    A = pose[:3] + Rotation.from_quat(pose[3:]).apply([(0.0, 0.0, 0.0), (45.2, 0.0, 0.0), (x, np.sqrt(35.0**2 - x**2), 0.0)])
    B = np.array([(0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (10.0, SIDE, 0.0)])
    P = A + (B - A) / np.linalg.norm(B - A, axis=1, keepdims=True) * np.array([[70.0], [70.0], [75.0]])
    return np.linalg.norm(B[[0, 1, 2, 1, 2, 2]] - P[[0, 0, 0, 1, 1, 2]], axis=1)


def reaches(at: dict[str, Any], drive: int, sign: float) -> bool:
    """Whether a drive changed alone has a pose beside the singular one, by brute force."""
    pose = np.array(at["position_mm"] + at["quaternion_xyzw"])
    aim = drives(pose) + sign * 1e-4 * np.eye(6)[drive]
    twist = np.array(at["lost_twists"][0])

    def off(step: np.ndarray) -> np.ndarray:
        return drives(np.r_[pose[:3] + step[3:], (Rotation.from_rotvec(step[:3]) * Rotation.from_quat(pose[3:])).as_quat()]) - aim

    step = np.r_[twist[:3], twist[3:] + np.cross(twist[:3], pose[:3])]
    starts = [s * step for s in (-0.03, -0.01, 0.01, 0.03)]
    return bool(min(np.abs(least_squares(off, s, xtol=1e-15, ftol=1e-15, gtol=1e-15).fun).max() for s in starts) < 1e-8)


def test_input_rods_by_command(tmp_path: Path) -> None:
    """Chapter 3: rows as derived for input rods, and the pose that the screw method drives to."""
    code, _, record = found(tmp_path, fed(), "--position-mm", "10,-20,400")
    assert code == 0
    assert (record["class"], record["notation"], record["straight_links"], record["freedoms"]) == ("L-111111-321", None, False, 6)
    P, C, B = np.array(POINTS) + [10, -20, 400], np.array(THROUGH) + [10, -20, 400], np.array(FEET)
    w = (C - B) / np.linalg.norm(C - B, axis=1, keepdims=True)
    for i, j in enumerate((0, 0, 0, 1, 1, 2)):
        D, k = B[j] + 800.0 * w[j], 800.0 / np.linalg.norm(C[j] - B[j])
        u = (P[i] - D) / np.linalg.norm(P[i] - D)
        n = u - w[j] * (w[j] @ u)
        about = np.array([10, -20, 400])
        np.testing.assert_allclose(
            record["rows"][i], np.r_[np.cross(P[i] - about, u) - k * np.cross(C[j] - about, n), u - k * n], atol=1e-9
        )
        assert record["lengths_mm"][i] == pytest.approx(np.linalg.norm(P[i] - D), rel=1e-12)
    lengths = ",".join(map(repr, record["lengths_mm"]))
    code, _, driven = found(tmp_path, fed(), "--position-mm", "0,0,410", "--lengths-mm", lengths)
    assert code == 0
    np.testing.assert_allclose(driven["forward"]["position_mm"], [10, -20, 400], atol=1e-6)
    assert driven["status"] == "not proved"
    assert any(np.allclose(a["position_mm"], [10, -20, 400], atol=1e-5) for a in driven["assemblies"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("joint_", "joint_"), None),
        (('to = "P3"', 'to = "P9"'), "link 6: the platform has no point 'P9'. It has A1, A2, A3, P1, P2, P3"),
        (('platform = "A2"', 'platform = "A9"'), "rod 2: the platform has no point 'A9'. It has A1, A2, A3"),
        (('name = "P3"', 'name = "B1"'), "rod 'B1': a point or another rod has this name"),
        (('from = "B3"\nto = "P3"', 'from = "P3"\nto = "P3"'), "link 6: joins the rod 'P3' to itself"),
        (('to = "P3"', 'to = "A3"'), "rod 'P3': no link ends at it"),
        (
            ('[[link]]\nfrom = "B3"\nto = "P3"\n', '[[link]]\nfrom = "B1"\nto = "P3"\n[[link]]\nfrom = "B3"\nto = "P3"\n'),
            "has rods and 7 links",
        ),
        (("length_mm = 75.0", "length_mm = -75.0"), "[rod P3].length_mm: must be positive"),
    ],
)
def test_rods_that_are_none_are_refused(tmp_path: Path, change: tuple[str, str], says: str | None) -> None:
    text = pierced(45.2, 75.0).replace("limits_mm = [38.0, 45.0]\n", "").replace(*change)
    code, said, _ = found(tmp_path, text)
    assert code == (0 if says is None else 1), said
    assert says is None or says in said


def test_poses_and_jobs_that_rods_cannot_take(tmp_path: Path) -> None:
    code, said, _ = found(tmp_path, pierced(45.2, 75.0), "--position-mm=0,0,-200")
    assert code == 1
    assert "rod" in said
    assert "on the wrong side of the point that it goes through" in said
    for word in ("--design", "--singular"):
        code, said, _ = found(tmp_path, fed(), "--position-mm", "0,0,400", word)
        assert code == 1
        assert "no straight links have the poses of these rods" in said
