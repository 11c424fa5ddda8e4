"""The command line as a user meets it: a process of its own, exit codes, one line of error, whole files or none."""

import json
import re
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pandas as pd
import pytest
from in_process import lmeasure, ran
from rerun.chunk import RrdReader

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.bus.frames import messages_from_frames
from lmeasure.cli.commands import command
from lmeasure.rig import write_rig
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
BOX = ("--x", "-200:200:200", "--y", "-200:200:200", "--z", "-200:200:200", "--tilt-rad", "0.1")
HEAVY = {"numpy", "scipy", "numba", "pandas", "pyarrow", "xarray", "pydantic", "can", "canopen", "cantools", "rerun", "plotly", "typst"}


def test_every_stage_writes_a_recording_when_asked() -> None:
    stages = "calibrate certify check check-instrument identify import motion place plan-poses program reconstruct record simulate zone"
    for name in stages.split():
        assert "--rerun" in {option for parameter in command(name).params for option in parameter.opts}, name


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom lmeasure.cli.app import app\ntry: app(['--help'])\nexcept SystemExit: pass\nprint(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "reconstruct" in done.stdout
    assert HEAVY & set(done.stderr.split()) == set()


def test_usage() -> None:
    done = lmeasure("--version")
    assert done.returncode == 0
    assert re.fullmatch(r"lmeasure \d+\.\d+\.\d+\n", done.stdout)
    stated = json.loads(lmeasure("--version", "--json").stdout)
    assert f"lmeasure {stated['lmeasure']}\n" == done.stdout
    assert re.fullmatch("[0-9a-f]{64}", stated["lmeasure sources"])
    assert {"python", "numpy", "processor"} <= set(stated)
    assert lmeasure("--json").returncode == 2
    done = lmeasure("calibrat")
    assert done.returncode == 2
    assert "There is no command 'calibrat'. Did you mean calibrate" in done.stderr
    assert lmeasure("reconstruct", TRUTH / "cell-run").returncode == 2
    first = lmeasure()
    assert first.returncode == 0
    assert first.stdout.count("\n  lmeasure ") == 3
    assert lmeasure("hand-eye", "--help").stdout.splitlines()[2:] == lmeasure("frames", "--help").stdout.splitlines()[2:]


def test_from_scenario_to_zone_by_files_alone(tmp_path: Path) -> None:
    """In one process, as each would load the libraries again; the demo's test is the one with a process of its own."""
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        'schema = "lmeasure.scenario/1"\nseed = 3\nrate_hz = 200.0\n'
        "[[waypoint]]\nposition_mm = [120.0, -50.0, 80.0]\n[reference_poses]\ncount = 14\n"
    )
    made, calibrated = tmp_path / "run", tmp_path / "calibrated"
    steps: list[tuple[str | Path, ...]] = [
        ("simulate", scenario, "--out", made, "--rerun", tmp_path / "simulated.rrd"),
        ("calibrate", made / "calibration", "--out", calibrated, "--rerun", tmp_path / "calibrated.rrd"),
        ("reconstruct", made, "--rig", calibrated / "rig.toml", "--out", tmp_path / "t.parquet", "--rerun", tmp_path / "run.rrd"),
        ("zone", calibrated / "rig.toml", *BOX, "--out", tmp_path / "zone.nc", "--rerun", tmp_path / "zone.rrd"),
    ]
    for step in steps:
        assert ran(*step).strip()
    found = pd.read_parquet(tmp_path / "t.parquet")
    assert len(found) == len((made / "pass1.csv").read_text().splitlines()) - 1
    # the motion goes back to its start
    np.testing.assert_allclose(found[["x_mm", "y_mm", "z_mm"]].to_numpy()[-1], 0.0, atol=0.1)
    assert (found["status"] == "ok").all()
    shown = {
        "simulated": "/counts/pass1/ch1",
        "calibrated": "/calibration_residual_mm/ch1",
        "run": "/residual_mm/c1",
        "zone": "/world/zone/inside",
    }
    for name, entity in shown.items():
        assert entity in {chunk.entity_path for chunk in RrdReader(tmp_path / f"{name}.rrd").stream()}


def test_counts_of_a_bus_and_of_its_log_are_drawn_alike(tmp_path: Path) -> None:
    rig = cell_rig(2)
    home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    time_s, poses = smooth_path(home, [Leg(home + [40.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0])], 500.0)
    counts = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(0)).run.passes[0]
    log = tmp_path / "drive.blf"
    with can.BLFWriter(log) as writer:
        frames = frames_from_counts(time_s, counts.recorded, counter_fields(rig, 1), rig.can_table.sync_id)
        for message in messages_from_frames(frames):
            writer.on_message_received(message)
    write_rig(tmp_path / "rig.toml", rig)
    pose = ("--position-mm", "0", "0", "0", "--quaternion-xyzw", "0", "0", "0", "1")
    for words in (
        ("import", log, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "a", *pose, "--rerun", tmp_path / "import.rrd"),
        (
            "record",
            "--bus",
            f"replay:{log}",
            "--fast",
            "--rig",
            tmp_path / "rig.toml",
            "--out",
            tmp_path / "b",
            "--rerun",
            tmp_path / "record.rrd",
        ),
    ):
        ran(*words)
    for name in ("import", "record"):
        stream = RrdReader(tmp_path / f"{name}.rrd").stream().filter(content="/counts/pass1/ch4", components="Scalars:scalars")
        shown = [cell[0] for chunk in stream for cell in chunk.to_record_batch().column("Scalars:scalars").to_pylist()]
        np.testing.assert_array_equal(shown, counts.of("ch4"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("reconstruct", "nowhere", "--out", "OUT/t.parquet"), "nowhere: is not a run folder"),
        (("reconstruct", TRUTH / "cell-run", "--out", "OUT/t.xlsx"), "t.xlsx: the name must end in .parquet, .csv, .tum or .mcap"),
        (("calibrate", TRUTH / "cell-run", "--out", "OUT/c"), "a run has no reference poses. Calibrate it with --self"),
        (("zone", "no.toml", *BOX, "--out", "OUT/zone.nc"), "no.toml: cannot be read: No such file or directory"),
        (("simulate", "no.toml", "--out", "OUT/run"), "no.toml: cannot be read: No such file or directory"),
        (("view", "no.rrd"), "no.rrd: cannot be read: No such file or directory"),
        (("view", __file__), "test_commands.py: is not a whole rerun recording"),
    ],
)
def test_one_line_and_no_file(arguments: tuple[str | Path, ...], message: str, tmp_path: Path) -> None:
    done = lmeasure(*(str(a).replace("OUT", str(tmp_path)) for a in arguments))
    assert done.returncode == 1
    (error,) = done.stderr.splitlines()
    assert error.startswith("lmeasure: ")
    assert message in error
    assert done.stdout.strip() == ""
    assert list(tmp_path.iterdir()) == []


def test_a_recording_must_be_named_as_one(tmp_path: Path) -> None:
    done = lmeasure("reconstruct", TRUTH / "cell-run", "--out", tmp_path / "t.parquet", "--rerun", tmp_path / "t.txt")
    assert done.returncode == 2
    assert "does not end in .rrd" in done.stderr
    assert list(tmp_path.iterdir()) == []
