"""`lmeasure identify` from a file: what it writes, that it can be read again, and how it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from in_process import ran, refused
from numpy.typing import NDArray
from recordings import scalars
from scipy.spatial.transform import Rotation

from lmeasure.io.tables import read_table
from lmeasure.robots import read_robot, read_urdf

UR5 = Path(__file__).parents[2] / "datasets" / "ur5" / "grid.csv"
NAMES = [f"joint_{i}_deg" for i in range(1, 7)]


def lines(rows: slice, *, places: bool) -> str:
    table = np.genfromtxt(UR5, delimiter=",", names=True)[rows]
    head = ["name", *NAMES, *(("x_mm", "y_mm", "z_mm") if places else ())]
    out = [",".join(head)]
    for r in table:
        cells = [f"P{int(r['step_order'])}", *(repr(float(r[f"joint_{i}"])) for i in range(1, 7))]
        cells += [repr(float(r[f"{axis}_t"] + r[f"{axis}_dif"])) for axis in "xyz"] if places else []
        out.append(",".join(cells))
    return "\n".join(out) + "\n"


def test_what_is_written(tmp_path: Path) -> None:
    measured, requested, out = tmp_path / "measurements.csv", tmp_path / "asked.csv", tmp_path / "out"
    measured.write_text(lines(slice(0, 1000, 10), places=True), encoding="utf-8")
    requested.write_text(lines(slice(5, 1000, 50), places=False), encoding="utf-8")
    arguments = [
        "identify",
        "--robot",
        "ur5",
        "--measurements",
        str(measured),
        "--out",
        str(out),
        "--predict",
        str(requested),
        "--harmonics",
    ]
    arguments += ["--rerun", str(tmp_path / "robot.rrd")]
    said = ran(*arguments)
    assert "100 rows, mean error" in said
    record = json.loads((out / "identified.json").read_text(encoding="utf-8"))
    n = len(record["parameters"])
    assert np.array(record["covariance"]).shape == (n, n)
    u = [p["u"] for p in record["parameters"]]
    assert np.sqrt(np.diag(record["covariance"])) == pytest.approx(u)
    assert {"name", "value", "nominal", "u", "unit"} <= set(record["parameters"][0])
    assert len(record["base"]["position_mm"]) == 3
    assert len(record["tool"]["quaternion_xyzw"]) == 4
    assert len(record["residuals"]) == 100
    assert record["unobservable"]
    # robot.toml with the base gives the predictions; URDF does without the harmonics' part
    predicted = read_table(out / "predictions.csv")
    place = predicted.matrix(["x_mm", "y_mm", "z_mm"])
    robot = read_robot(out / "robot.toml")
    joints = np.radians(read_table(requested).matrix(NAMES))
    flange = robot.model.forward(joints)
    assert robot.tool is not None
    in_base = flange[:, :3] + Rotation.from_quat(flange[:, 3:]).apply(robot.tool.position_mm)
    turn = Rotation.from_quat(record["base"]["quaternion_xyzw"])
    assert turn.apply(in_base) + record["base"]["position_mm"] == pytest.approx(place, abs=1e-6)
    drawn = read_urdf(out / "robot.urdf").arm.forward(joints)[:, :3]
    assert drawn == pytest.approx(in_base, abs=2.0)
    left = np.linalg.norm([r["mm"] for r in record["residuals"]], axis=1)
    assert scalars(tmp_path / "robot.rrd", "/error_mm/identified", "row") == pytest.approx(left)
    assert len(scalars(tmp_path / "robot.rrd", "/validation_mm/error", "row", "Measurements:variances")) == 100
    error = np.linalg.norm(place - truth_of_asked(), axis=1)
    radius = predicted.numbers("u95_mm")
    assert error.mean() < 0.13
    assert np.mean(error <= radius) >= 0.85
    page = (out / "report.html").read_text(encoding="utf-8")
    for heading in (
        "Errors in space",
        "Position errors at the measured poses",
        "Residuals against joint values",
        "Unobservable parameter combinations",
    ):
        assert heading in page


def truth_of_asked() -> NDArray[np.float64]:
    table = np.genfromtxt(UR5, delimiter=",", names=True)[5:1000:50]
    return np.column_stack([table[f"{axis}_t"] + table[f"{axis}_dif"] for axis in "xyz"])


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--robot", "kr210"], 2, "is not a shipped robot. Known: "),
        (["--robot", "ur5", "--free", "luck"], 2, "cannot be freed. Known: links"),
        (["--robot", "ur5", "--free", "stiffness"], 2, "the robot states no [payload], whose weight would turn its joints"),
        (["--robot", "ur5", "--tip", "flange"], 2, "works only with a .urdf"),
        (["--robot", "ur5", "--columns", "x"], 2, "'x' is not name=column[unit]"),
        (["--robot", "ur5", "--columns", "x=Q"], 1, "column 'Q', which is x in --columns, is missing"),
        (["--robot", "ur5", "--predict", "none.csv"], 1, "none.csv: cannot be read"),
    ],
)
def test_refusals_in_one_line(arguments: list[str], code: int, said: str, tmp_path: Path) -> None:
    measured = tmp_path / "measurements.csv"
    measured.write_text(lines(slice(0, 1000, 40), places=True), encoding="utf-8")
    assert said in refused("identify", "--measurements", measured, "--out", tmp_path / "out", *arguments, code=code)
    assert not (tmp_path / "out" / "identified.json").exists()


def test_measurements_of_another_robot_are_refused(tmp_path: Path) -> None:
    measured = tmp_path / "measurements.csv"
    measured.write_text(lines(slice(0, 1000, 25), places=True), encoding="utf-8")
    err = refused("identify", "--measurements", measured, "--out", tmp_path / "out", "--robot", "puma560")
    assert "measurements.csv: robot 'puma560': the identified robot still misses the measurements by" in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_few_rows_tell_no_noise(tmp_path: Path) -> None:
    measured, out = tmp_path / "measurements.csv", tmp_path / "out"
    measured.write_text(lines(slice(0, 1000, 200), places=True), encoding="utf-8")
    said = ran("identify", "--measurements", measured, "--out", out, "--robot", "ur5")
    assert "robot and instrument: cannot be determined" in said
    assert "cross-validation: none, too few rows" in said
    assert "warning underdetermined" in said
    record = json.loads((out / "identified.json").read_text(encoding="utf-8"))
    assert record["noise"]["position_mm"] is None
    assert [w["code"] for w in record["warnings"]] == ["underdetermined"]
