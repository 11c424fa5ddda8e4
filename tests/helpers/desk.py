"""A desk with small inputs of every command that writes, and a command line for each; OUT stands for the folder that it writes to."""

import shutil
from pathlib import Path

import numpy as np
from capture_bench import POSES, RIG, going, nominal_of, write_inputs

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.recorder import candump_lines
from lmeasure.io import write_table
from lmeasure.recording import read_run

HERE = Path(__file__).parents[1]
SEALED = HERE / "authorities" / "sealed" / "with-run"
RUN = HERE / "authorities" / "truth" / "cell-run"
GRID = "--x=0:50:50 --y=0:50:50 --z=0:50:50"
CERTIFY = "certify sealed/inputs/trajectory.parquet --program sealed/inputs/program.toml --run sealed/inputs/run --trials 100"
SHORT = {
    "schema": "schema rig --out OUT/rig.json",
    "key": "key --out OUT/key",
    "import": "import drive.log --rig run/rig.toml --out OUT/imported --start 0,0,0,0,0,0",
    "reconstruct": "reconstruct run --out OUT/t.parquet",
    "reconstruct csv": "reconstruct run --out OUT/t.csv --rerun OUT/t.rrd",
    "reconstruct tum": "reconstruct run --out OUT/t.tum",
    "reconstruct mcap": "reconstruct run --out OUT/t.mcap",
    "zone": f"zone run/rig.toml {GRID} --out OUT/zone.nc --report OUT/page",
    "inspect": "inspect run/rig.toml --out OUT/page.html",
    "program": "program --out OUT/program --x 0:500 --y 0:500 --z 0:500 --tests pose",
    "certify": f"{CERTIFY} --out OUT/c --zip --tables",
    "mechanism": "mechanism rotopod --out OUT/m.json",
    "init": "init OUT/cell --template three-drums",
    "frames": "frames --robot plan/planned.csv --measured plan/planned.csv --out OUT/frames.json",
    "dyads": "dyads plan/planned.csv --links 1 --starts 5 --out OUT/links",
    "motion": "motion sealed/inputs/trajectory.parquet --half-width-s 0.3 --out OUT/m.csv",
    "report": "report run --out OUT/page",
    "simulate": "simulate scenario.toml --out OUT/simulated",
    "structure": "structure run/rig.toml --out OUT/s.json --report OUT/page",
    "drum": "drum drums.toml --rig rig.toml --out OUT/measured.toml",
    "calibrate": "calibrate campaign --out OUT/calibrated",
    "register": "register OUT/register --add sealed --export OUT/all.csv",
    "compare": "compare sealed sealed2 --out OUT/compared.json --page OUT/compared.html",
}
"""Commands that take a second or less, zone and certify apart."""
LONG = {
    "correct": "correct plan/points.csv --map plan/map.csv --out OUT/corrected",
    "place": "place rig.toml --task placement.toml --generations 1 --out OUT/placed",
    "plan-poses": "plan-poses rig.toml --poses 3 --further 0 --box=-200:200,-200:200,-200:200 --out OUT/poses.csv",
    "identify": "identify --robot ur5 --measurements measurements.csv --out OUT/identified",
    "check": "check --rig rig.toml --bus replay:drive.log --write OUT/checked.toml",
    "check-instrument": "check-instrument run --out OUT/check",
    "demo": "demo --out OUT/demo",
    "qualify": "qualify --out OUT/qualification",
}
"""Commands that take longer, or a person beside them."""
RECORDINGS = {
    "record": "record --rig run/rig.toml --bus replay:drive.log --fast --out OUT/recorded --start 0,0,0,0,0,0",
    "capture": "capture plan/rig.toml --poses plan/planned.csv --bus replay:plan/drive.log --fast --by rest --out OUT/campaign",
}
"""Commands that make recordings, which nothing replaces."""


def set_up(here: Path) -> None:
    """Write the inputs into a folder, in which the commands are run."""
    shutil.copytree(SEALED, here / "sealed")
    shutil.copytree(SEALED, here / "sealed2")
    shutil.copytree(RUN, here / "run")
    shutil.copytree(HERE / "authorities" / "truth" / "cell-12-poses", here / "campaign")
    run = read_run(RUN)
    frames = frames_from_counts(run.passes[0].time_s[:50], run.passes[0].recorded[:50], counter_fields(run.rig), run.rig.can_table.sync_id)
    (here / "drive.log").write_bytes(candump_lines(frames))
    (here / "plan").mkdir()
    write_inputs(here / "plan", nominal_of(RIG), POSES)
    counts = going(POSES[:1], 1.0)
    (here / "plan" / "drive.log").write_bytes(
        candump_lines(frames_from_counts(counts.time_s, counts.recorded, counter_fields(RIG), RIG.can_table.sync_id))
    )
    places = np.random.default_rng(0).uniform(-300.0, 300.0, (50, 3))
    table = dict(zip(("x_mm", "y_mm", "z_mm"), places.T, strict=True))
    turn = {"qx": np.zeros(50), "qy": np.zeros(50), "qz": np.zeros(50), "qw": np.ones(50)}
    off = {f"d{axis}_mm": np.sin(places[:, k] / 300.0) for k, axis in enumerate("xyz")}
    write_table(here / "plan" / "map.csv", table | turn | off)
    (here / "plan" / "points.csv").write_text("name,x_mm,y_mm,z_mm,qx,qy,qz,qw\nA,10,20,30,0,0,0,1\n")
