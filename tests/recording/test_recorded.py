"""What a run folder says of its recording is used: digests, faults, an early end, and whose calibration it is."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from cells import cell, motion, record

from lmeasure.core import FileFormatError
from lmeasure.io import files
from lmeasure.recording import Recorded, read_run, read_run_head, write_run
from lmeasure.rig import CalibrationRecord, RecordedParameter, Rig, read_linked_rig, write_calibration_record, write_rig
from lmeasure.trajectory import reconstruct, reconstruct_stream

EARLY: dict[str, Any] = {"pass": 1, "ended": "early", "why": "the bus was lost", "frames": "pass1.log"}


def folder(path: Path, recording: object) -> Path:
    """A run folder with these [[recording]] tables; a digest of "own" becomes that of the counts."""
    write_run(path, record(cell(), *motion(40)))
    data = tomllib.loads((path / "run.toml").read_text())
    text = tomli_w.dumps(data | {"recording": recording}).replace('"own"', f'"{files.sha256(path / "pass1.csv")}"')
    (path / "run.toml").write_text(text)
    return path


def test_counts_that_were_changed_since_are_refused(tmp_path: Path) -> None:
    entry = {"pass": 1, "ended": "complete", "frames": "pass1.log", "sha256": {"pass1.csv": "own", "pass1.log": "0" * 64, "rig.toml": "1"}}
    run = folder(tmp_path / "run", [entry])
    assert read_run(run).recorded[0].sha256["rig.toml"] == "1"
    counts = run / "pass1.csv"
    counts.write_text(counts.read_text().replace("\n0.005,", "\n0.0050,"))
    for read in (read_run, read_run_head):
        with pytest.raises(FileFormatError, match=r"pass1\.csv: is not the file that was recorded: .*run\.toml has another SHA-256 for it"):
            read(run)


def test_an_import_s_digest_is_that_of_its_log(tmp_path: Path) -> None:
    run = folder(tmp_path / "run", [{"pass": 1, "ended": "complete", "bus": "pass1.csv", "sha256": {"pass1.csv": "0" * 64}}])
    assert read_run(run).recorded[0].sha256 == {}


@pytest.mark.parametrize("tables", [["x"], [{"pass": "1"}], [{"faults": 3}], [{"sha256": {"pass1.csv": 5}, "frames": "x"}], "early"])
def test_a_recording_that_this_program_did_not_write_is_refused(tmp_path: Path, tables: object) -> None:
    with pytest.raises(FileFormatError, match=r"run\.toml:\d+: \[?recording"):
        read_run(folder(tmp_path / "run", tables))


def test_how_it_was_recorded_is_said(tmp_path: Path) -> None:
    faults = {"wrap": 3, "overflow": 2, "bus_error": 1, "duplicate": 4}
    run = folder(tmp_path / "run", [EARLY | {"faults": faults}])
    said = ["pass 1: the recording ended early: the bus was lost", "pass 1: faults while it was recorded: 1 bus_error, 2 overflow"]
    assert read_run_head(run).torn == (True,)
    assert [note for note in map(str, reconstruct(read_run(run)).notes) if note.startswith("pass 1")] == said
    whole = folder(tmp_path / "whole", [EARLY | {"ended": "complete", "why": "", "faults": faults}])
    text = reconstruct_stream(read_run_head(whole), tmp_path / "t.csv").text()
    assert f"note: {said[1]}" in text
    assert str(Recorded(1, faults={"of another kind": 2}).notes()[0]).endswith("recorded: 2 of another kind")
    assert "ended early" not in text


def parameters(rig: Rig) -> dict[str, float]:
    """Some of the rig's values by the record's names."""
    point = rig.observation_point[1]
    return {
        "B2.x_mm": point.position_mm[0], "B2.z_mm": point.position_mm[2], "B2.guide_alpha_deg": point.guide_alpha_deg,
        "B2.guide_beta_deg": point.guide_beta_deg, "B2.pulley_radius_mm": point.pulley_radius_mm, "B2.scale": point.drum.scale,
        "B2.groove_pitch_mm": point.drum.groove_pitch_mm, "tool.P3.y_mm": rig.tool["P3"][1],
    }  # fmt: skip


def record_of(rig: Rig, values: dict[str, float], name: str = "cell") -> CalibrationRecord:
    solved = tuple(RecordedParameter(name=n, value=v, u=0.001, prior_u=30.0) for n, v in values.items())
    covariance = tuple(tuple(row) for row in (1e-6 * np.eye(len(values))).tolist())
    return CalibrationRecord(rig=name, parameters=solved, covariance=covariance, residuals=(), equations=0, unknowns=0, rank=0)


def linked(path: Path, values: dict[str, float], name: str = "cell") -> Path:
    """A rig and the record that it links to, of these values."""
    write_rig(path / "rig.toml", cell(calibration="calibration.json"))
    write_calibration_record(path / "calibration.json", record_of(cell(), values, name))
    return path / "rig.toml"


def test_a_calibration_of_this_rig_is_taken(tmp_path: Path) -> None:
    values = parameters(cell())
    assert read_linked_rig(linked(tmp_path, values))[1] is not None
    # as a fit leaves them before they are brought back to their ranges, or rounded, or of things that rigs do not hold
    same = {
        "B2.pulley_radius_mm": -values["B2.pulley_radius_mm"],
        "B2.guide_alpha_deg": 180.0 - values["B2.guide_alpha_deg"],
        "B2.guide_beta_deg": values["B2.guide_beta_deg"] + 540.0,
        "B2.x_mm": round(values["B2.x_mm"] + 4e-7, 6),
        "B2.z_mm": values["B2.z_mm"] + 9e-6,
        "B2.drum_eccentricity_mm": 0.1,
        "sw1.eccentricity_deg": 3.0,
    }
    assert read_linked_rig(linked(tmp_path, values | same))[1] is not None


@pytest.mark.parametrize("name", list(parameters(cell())))
def test_a_calibration_of_other_values_is_refused(tmp_path: Path, name: str) -> None:
    values = parameters(cell())
    rig = linked(tmp_path, values | {name: values[name] + 0.01})
    with pytest.raises(
        FileFormatError, match=rf"calibration\.json: parameter {name} = \S+, but .*rig\.toml has \S+: it is not the calib"
    ) as said:
        read_linked_rig(rig)
    for value in (values[name] + 0.01, values[name]):
        assert f"{value:.9g}" in str(said.value)


@pytest.mark.parametrize(
    ("values", "name", "complaint"),
    [
        ({}, "press", "is the calibration of rig 'press', but .*rig.toml is rig 'cell'"),
        ({"B9.x_mm": 1.0}, "cell", "parameter B9.x_mm: there is no observation point B9 in .*rig.toml"),
        ({"B9.scale": 1.0}, "cell", "parameter B9.scale: there is no observation point B9"),
        ({"tool.P9.x_mm": 1.0}, "cell", r"parameter tool.P9.x_mm: there is no point P9 in \[tool\] of .*rig.toml"),
    ],
)
def test_a_calibration_of_another_rig_is_refused(tmp_path: Path, values: dict[str, float], name: str, complaint: str) -> None:
    with pytest.raises(FileFormatError, match=complaint):
        read_linked_rig(linked(tmp_path, values, name))


def test_a_run_is_refused_with_an_unrelated_calibration(tmp_path: Path) -> None:
    values = parameters(cell())
    write_run(tmp_path, record(cell(), *motion(20)))
    linked(tmp_path, values)
    assert read_run(tmp_path).calibration is not None
    linked(tmp_path, {name: value + 100.0 for name, value in values.items()})
    with pytest.raises(FileFormatError, match=r"parameter B2\.x_mm = 1454\.3, but .* has 1354\.3"):
        read_run(tmp_path)
