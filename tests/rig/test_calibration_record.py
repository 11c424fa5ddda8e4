"""calibration.json: there and back, and refused when its covariance is none."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lmeasure.core import FileFormatError
from lmeasure.rig import CalibrationRecord, read_calibration_record, write_calibration_record


def content(**changes: Any) -> dict[str, Any]:
    return {
        "schema": "lmeasure.calibration/1",
        "rig": "demo",
        "parameters": [
            {"name": "B1.x_mm", "value": 1 / 3, "u": 0.1, "prior_u": 30.0},
            {"name": "B1.y_mm", "value": 2.0, "u": 0.2, "prior_u": 30.0},
        ],
        "covariance": [[0.01, 0.005], [0.005, 0.04]],
        "residuals": [{"pose": "1", "channel": "ch1", "mm": 1e-17}],
        "equations": 11,
        "unknowns": 2,
        "rank": 2,
        "unobservable": [{"point": "B1", "direction": {"x_mm": 1.0}, "text": "along x"}],
        "warnings": [{"code": "edge", "text": "at its edge", "channel": "ch1"}],
        "inputs": [{"file": "counts.csv", "sha256": "00"}],
    } | changes


def test_a_record_comes_back(tmp_path: Path) -> None:
    record = CalibrationRecord.model_validate(content())
    path = tmp_path / "calibration.json"
    write_calibration_record(path, record)
    assert read_calibration_record(path) == record
    assert np.array_equal(record.covariance_matrix(), [[0.01, 0.005], [0.005, 0.04]])
    names = set(json.loads(path.read_text()))
    assert {"parameters", "covariance", "residuals", "equations", "unknowns", "rank", "unobservable", "warnings", "inputs"} <= names


REFUSALS = [
    ({"covariance": [[0.01]]}, "covariance: is not 2 x 2 as the parameters ask"),
    ({"covariance": [[0.01, 0.005], [0.006, 0.04]]}, "covariance: is not symmetric"),
    ({"covariance": [[-0.01, 0], [0, 0.04]]}, "covariance: is not symmetric with variances on its diagonal"),
    ({"covariance": [[0.01, 0.03], [0.03, 0.04]]}, "covariance: is not positive semidefinite"),
    ({"covariance": [["x", 0], [0, 1]]}, "number 1 must be a number, is 'x'"),
    ({"schema": "lmeasure.calibration/2"}, "schema"),
    ({"rank": "two"}, "rank"),
    ({"rank": True}, "rank"),
    ({"parameters": [{"name": "a"}]}, "[parameters a].value: is missing"),
    ({"parameters": [{"name": "B1.x_mm", "value": 1, "u": 0.1, "prior_u": 1}] * 2}, "parameters: the name 'B1.x_mm' is given 2 times"),
]


@pytest.mark.parametrize(("changes", "line"), REFUSALS, ids=[line for _, line in REFUSALS])
def test_one_line_names_the_key(tmp_path: Path, changes: dict[str, Any], line: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(content(**changes)))
    with pytest.raises(FileFormatError) as caught:
        read_calibration_record(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b"\xff", b"null", b'{"covariance": NaN}', b'{"equations": 1e999}'])
def test_what_is_no_record(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "calibration.json"
    path.write_bytes(text)
    with pytest.raises(FileFormatError, match=r"calibration\.json: ") as caught:
        read_calibration_record(path)
    assert "\n" not in str(caught.value)


def test_numbers_that_are_not_finite_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="finite"):
        CalibrationRecord.model_validate(content(covariance=[[float("inf"), 0], [0, 1]]))
    with pytest.raises(ValueError, match="finite"):
        CalibrationRecord.model_validate(content(parameters=[{"name": n, "value": float("nan"), "u": 1, "prior_u": 1} for n in "ab"]))
