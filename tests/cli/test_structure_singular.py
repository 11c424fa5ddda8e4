"""`lmeasure structure --singular`: the thesis' columns, a pose beside them, and refusals, all by command."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import code_and_text, ran
from scipy.spatial.transform import Rotation

from lmeasure.io import files

COLUMNS = 'schema = "lmeasure.structure/1"\n' + "".join(
    f"[{side}]\n" + "".join(f"{side[0].upper()}{i} = {p}\n" for i, p in enumerate(points, 1))
    for side, points in (
        ("base", ["[0, -1, -1.6]", "[1, 0, -1.6]", "[0, 1, -1.6]", "[0, -2.6, 0]", "[2.6, 0, 0]", "[0, 2.6, 0]"]),
        ("platform", ["[0, -1, 0]", "[1, 0, 0]", "[0, 1, 0]"]),
    )
)
LINKS = "".join(f'[[link]]\nfrom = "B{i + 1}"\nto = "P{i % 3 + 1}"\n' for i in range(6))


def found(folder: Path, *words: str, links: str = LINKS) -> tuple[int, str, dict[str, Any]]:
    (folder / "columns.toml").write_text(COLUMNS + links)
    out = folder / "s.json"
    code, said = code_and_text("structure", folder / "columns.toml", "--singular", "--out", out, "--force", *words)
    return code, said, json.loads(out.read_text()) if out.exists() else {}


def test_the_columns_of_4_5(tmp_path: Path) -> None:
    code, said, record = found(tmp_path, "--position-mm", "0,0,0")
    assert code == 0
    at = record["singular_pose"]
    assert (at["rank"], at["away_mm"], at["topology"]) == (5, 0.0, "surface")
    np.testing.assert_allclose(at["gradient"], [0, 0, 6.5, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(np.abs(at["lost_twists"]), [[0, 0, 1, 0, 0, 0]], atol=1e-12)
    assert len(at["twists"]) == 5
    np.testing.assert_allclose(np.array(at["twists"]) @ at["gradient"], 0.0, atol=1e-9)
    # the two arms on the body's axis are as short as they can be
    assert at["leads_out"] == {f"link {i}": "lengthen" if i in (4, 6) else "no part" for i in range(1, 7)}
    sixth = next(one for one in at["extra_drives"] if one["drives"][0]["link"] == "link 6")
    assert sixth["drives"][0]["pair"] == "base"
    np.testing.assert_allclose(sixth["drives"][0]["rates"], [-0.625], atol=1e-12)
    assert sixth["drives"][0]["exit_rate"] == pytest.approx(-0.625)
    assert abs(sixth["determinant"]) == pytest.approx(2.0)
    assert "lengthen one of these to lead out. To shorten it jams: link 4, link 6" in said


def test_a_pose_beside_a_singular_one_leads_there(tmp_path: Path) -> None:
    code, _, record = found(tmp_path, "--position-mm", "0.02,0.01,0.03", "--quaternion", "0,0,0.02,0.9998")
    assert code == 0
    at = record["singular_pose"]
    assert 0.0 < at["away_mm"] < 0.05
    assert abs(at["quaternion_xyzw"][2]) < 2e-3  # nothing but the turn about z was wrong to first order
    assert at["rank"] == 5


def test_what_cannot_be_analysed_is_refused(tmp_path: Path) -> None:
    code, said, _ = found(tmp_path)
    assert code == 2
    assert "needs --position-mm" in said
    code, said, record = found(tmp_path, "--position-mm", "0,0,0", links=LINKS + '[[link]]\nfrom = "B1"\nto = "P2"\n')
    assert (code, record) == (1, {})
    assert "7 links. Singular poses are analysed for six" in said


def test_a_motion_past_a_singular_pose_in_its_two_parts(tmp_path: Path) -> None:
    """Thesis, conclusion: a turn about z of the columns is the part that lengths do not see, a shift is the other one."""
    (tmp_path / "columns.toml").write_text(COLUMNS + LINKS)
    turn = np.array([0.02, 0.01, 0.0, -0.01, -0.01, -0.01])
    x = np.array([0.0, 0.0, 0.0, 0.0, 1e-4, 2e-4])
    table = {
        "time_s": np.arange(6.0),
        "x_mm": x,
        "y_mm": 0 * x,
        "z_mm": 0 * x,
        "qx": 0 * x,
        "qy": 0 * x,
        "qz": np.sin(turn / 2),
        "qw": np.cos(turn / 2),
    }
    files.write_table(tmp_path / "t.csv", table)
    words = ["structure", str(tmp_path / "columns.toml"), "--trajectory", str(tmp_path / "t.csv"), "--parts", str(tmp_path / "p.csv")]
    assert "nearest to a singular pose at 2 s" in ran(*words)
    found = files.read_table(tmp_path / "p.csv")
    rim = np.linalg.norm(np.array([[0, -1], [1, 0], [0, 1]]) - [1 / 3, 0], axis=1).max()
    along, rest = found.numbers("reciprocal_mm"), found.numbers("orthogonal_mm")
    np.testing.assert_allclose(np.abs(along[:4]), [0.0, 0.01 * rim, 0.01 * rim, 0.01 * rim], rtol=2e-3, atol=1e-12)
    np.testing.assert_allclose(rest[4:], 1e-4, rtol=2e-3)
    assert np.abs(along[4:]).max() < 3e-6
    # lengths off by 1 mm together move the body by so much: by differences of its own
    base = np.array([[0, -1, -1.6], [1, 0, -1.6], [0, 1, -1.6], [0, -2.6, 0], [2.6, 0, 0], [0, 2.6, 0]])
    body = np.array([[0, -1, 0], [1, 0, 0], [0, 1, 0]] * 2, dtype=float)

    def lengths(step: np.ndarray) -> np.ndarray:
        turned = Rotation.from_rotvec(step[:3] / rim) * Rotation.from_rotvec([0, 0, turn[1]])
        return np.asarray(np.linalg.norm(turned.apply(body) + step[3:] - base, axis=1))

    J = np.array([(lengths(h) - lengths(-h)) / 2e-6 for h in 1e-6 * np.eye(6)]).T
    gains = np.linalg.svd(np.linalg.inv(J), compute_uv=False)
    assert gains[0] == pytest.approx(float(found.numbers("reciprocal_mm_per_mm", gaps=True)[1]), rel=1e-5)
    assert gains[1] == pytest.approx(float(found.numbers("orthogonal_mm_per_mm")[1]), rel=1e-5)
