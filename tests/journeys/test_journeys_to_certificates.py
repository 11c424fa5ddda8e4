"""An engineer with a log, and a laboratory with a rig: from an empty folder to a certificate that a third party has verified. No file is
written by hand but what the test's robot leaves: its counts, as a log of the bus. `pytest -s` shows what each command took, `-m slow` runs
the standard's own number of cycles."""

import shutil
from pathlib import Path

import can
import numpy as np
import pytest
from test_journeys import said

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.recorder import candump_lines
from lmeasure.io.tables import read_table
from lmeasure.rig import Rig, read_rig
from lmeasure.simulation import Leg, simulate_run, smooth_path

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
RATE_HZ = 100.0
MISSES_MM = np.array([0.3, 0.0, 0.0])
WHOLE = "--tests", "pose", "--speeds", "100"
"""Of the test program: five poses with the standard's thirty cycles."""
QUICK = *WHOLE, "--cycles", "pose=3", "--dwell", "0.9"


def driven(rig: Rig, commands: Path, log: Path) -> None:
    """The log of a robot that runs the commands of a program and misses every place by the same: candump's, or Vector's by its suffix."""
    table = read_table(commands)
    places = np.column_stack([table.numbers(n) for n in ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")])
    places[:, :3] += MISSES_MM
    speed, dwell = table.numbers("speed_mm_s"), table.numbers("dwell_s")
    legs = [Leg(place, float(v), 1.0, float(rest)) for place, v, rest in zip(places, speed, dwell, strict=True)]
    time_s, rows = smooth_path(HOME, legs, RATE_HZ)
    counts = simulate_run(rig, time_s, rows, noise_mm=0.0, rng=np.random.default_rng(3)).run.passes[0].recorded
    frames = frames_from_counts(time_s, counts, counter_fields(rig), rig.can_table.sync_id)
    if log.suffix == ".asc":
        candump = log.with_suffix(".log")
        candump.write_bytes(candump_lines(frames))
        with can.ASCWriter(log) as writer, can.LogReader(candump) as reader:
            for message in reader:
                writer(message)
        candump.unlink()
    else:
        log.write_bytes(candump_lines(frames))


def accuracy(folder: Path) -> np.ndarray:
    """(n, 2) AP_p of every pose and its U95, as the certificate states them."""
    import json

    reported = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))["characteristics"]
    return np.array([[c["value"], c["u95"]] for c in reported if c["name"] == "AP_p"])


def stated_exact(path: Path) -> None:
    """The simulated robot's start and rig have no other errors than those stated, which nobody but the simulation knows."""
    path.write_text('unstated = "exact"\n' + path.read_text(encoding="utf-8"), encoding="utf-8")


@pytest.mark.parametrize(("dialect", "requested"), [("log", QUICK), pytest.param("asc", WHOLE, marks=pytest.mark.slow)])
def test_an_engineer_from_a_log_to_a_verified_certificate(
    dialect: str, requested: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    log = Path(f"drive.{dialect}")
    said(monkeypatch, capsys, "init", "cell", "--template", "six-cables")
    said(monkeypatch, capsys, "program", "--x=-150:150", "--y=-150:150", "--z=-150:150", *requested, "--out", "tests")
    driven(read_rig(Path("cell/rig.toml")), Path("tests/commands.csv"), log)
    guess = said(monkeypatch, capsys, "import", log, "--scan")
    # what a person does with the guess
    rig = Path("cell/rig.toml")
    table = guess[guess.index("\n[can]") : guess.rindex("next: lmeasure import")]
    rig.write_text(rig.read_text(encoding="utf-8") + table, encoding="utf-8")
    stated_exact(rig)
    reported = said(monkeypatch, capsys, "import", log, "--rig", rig, "--out", "run", "--start", "0,0,0,0,-90,90")
    assert "no faults" in reported
    stated_exact(Path("run/run.toml"))
    said(monkeypatch, capsys, "reconstruct", "run", "--out", "trajectory.parquet")
    said(monkeypatch, capsys, "report", "run", "--out", "page")
    assert (tmp_path / "page" / "trajectory.html").stat().st_size > 10_000
    said(monkeypatch, capsys, "program", "--out", "tests", "--ran", "trajectory.parquet")
    words = "certify", "trajectory.parquet", "--run", "run", "--program", "tests/program.toml", "--out", "certificate"
    said(monkeypatch, capsys, *words, *(("--trials", 400) if requested == QUICK else ()))
    found = accuracy(Path("certificate"))
    assert len(found) >= 5
    # one start pose and one draw of phases for all
    assert np.abs(found[:, 0] - 0.3).max() < 2.0 * found[:, 1].max() < 0.1
    assert "every file's hash is right" in said(monkeypatch, capsys, "verify", "certificate")


@pytest.mark.parametrize("requested", [QUICK, pytest.param(WHOLE, marks=pytest.mark.slow)])
def test_a_laboratory_from_a_rig_to_a_certificate_that_others_verify(
    requested: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The campaign is a simulated rig's, the robot another simulation of the same rig."""
    monkeypatch.chdir(tmp_path)
    said(monkeypatch, capsys, "init", "lab", "--template", "six-cables")
    said(monkeypatch, capsys, "simulate", "lab/scenario.toml", "--out", "tried")
    said(monkeypatch, capsys, "calibrate", "tried/calibration", "--out", "calibrated")
    grid = ("--x=-200:200:100", "--y=-200:200:100", "--z=-200:200:100") if requested == QUICK else ()
    reported = said(monkeypatch, capsys, "zone", "calibrated/rig.toml", *grid, "--out", "zone.nc", "--report", "zone")
    assert "nodes are in the zone" in reported
    assert {p.name for p in Path("zone").iterdir()} >= {"zone.html", "zone.pdf"}
    said(monkeypatch, capsys, "program", "--zone", "zone.nc", *requested, "--out", "tests")
    driven(read_rig(Path("lab/rig.toml")), Path("tests/commands.csv"), Path("drive.log"))
    said(monkeypatch, capsys, "import", "drive.log", "--rig", "calibrated/rig.toml", "--out", "run", "--start", "0,0,0,0,-90,90")
    stated_exact(Path("run/run.toml"))
    said(monkeypatch, capsys, "reconstruct", "run", "--out", "trajectory.parquet")
    said(monkeypatch, capsys, "program", "--out", "tests", "--ran", "trajectory.parquet")
    said(monkeypatch, capsys, "key", "--out", "laboratory.pem")
    words = "certify", "trajectory.parquet", "--run", "run", "--program", "tests/program.toml", "--key", "laboratory.pem", "--zip"
    for language in ("en", "ru"):
        reported = said(
            monkeypatch, capsys, *words, *(("--trials", 400) if requested == QUICK else ()), "--language", language, "--out", language
        )
        assert f"lmeasure verify {language}" in reported
    found = accuracy(Path("en"))
    # the largest cube of the whole zone goes beyond the reference poses, where the instrument is worse and says so
    assert np.all(np.abs(found[:, 0] - 0.3) < 2.0 * found[:, 1])
    assert found[:, 1].min() < 0.15
    np.testing.assert_array_equal(accuracy(Path("ru")), found)
    assert "Протокол испытаний" in Path("ru/report.html").read_text(encoding="utf-8")

    # somebody else, elsewhere, has what he was sent and the public key
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.copytree("ru", elsewhere / "copy")
    for name in ("en.zip", "laboratory.pem.pub"):
        shutil.copy(name, elsewhere / name)
    monkeypatch.chdir(elsewhere)
    for what in ("copy", "en.zip"):
        reported = said(monkeypatch, capsys, "verify", what, "--public-key", "laboratory.pem.pub")
        assert "the requested key" in reported
        assert "every file's hash is right" in reported
    counts = Path("copy/inputs/run/pass1.csv")
    changed = bytearray(counts.read_bytes())
    changed[-3] ^= 1  # a digit of the last count
    counts.write_bytes(changed)
    reported = said(monkeypatch, capsys, "verify", "copy", "--public-key", "laboratory.pem.pub", code=1)
    assert "inputs/run/pass1.csv" in reported
    assert "every file's hash is right" not in reported
