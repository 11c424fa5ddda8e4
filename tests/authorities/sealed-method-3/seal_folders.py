"""Seal the two folders of this directory; see README.md. `python seal_folders.py OUT` with the version of lmeasure that is to be kept."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.certification import Settings
from lmeasure.certification.asked_tests import Tests
from lmeasure.certification.bundle import MANIFEST, seal
from lmeasure.certification.campaign import campaign, timed
from lmeasure.certification.cube import largest_cube
from lmeasure.certification.measure import Inputs
from lmeasure.program import Drift, Program, Tolerance, write_program
from lmeasure.report.certificate import Choices, write_certificate
from lmeasure.robots.cell_robot import cell_robot
from lmeasure.run import read_run, write_run
from lmeasure.simulation import cell_rig, simulate_run
from lmeasure.trajectory import reconstruct, write_trajectory

RATE_HZ = 50.0
TESTS = Tests(
    tests=("pose", "approach", "stabilisation", "drift", "path", "posing", "compliance", "weaving"),
    speed_mm_s=600.0,
    path_speed_mm_s=400.0,
    speeds_percent=(100.0,),
    loads_kg=(4.0,),
    dwell_s=0.3,
    settle_s=0.16,
    cycles={"pose": 4, "approach": 2, "stabilisation": 2, "path": 2, "posing": 2, "compliance": 2, "weaving": 2},
    drift_s=1.0,
    drift_every_s=1.0,
    weave_mm=(30.0, 60.0),
    limit_band_mm=0.1,
    angles="fanuc-wpr",
)
KEPT = ("line", "rectangle", "weave")


def program_of(program: Program, commands: Any) -> tuple[Program, Any]:
    """With two robots at one pose, a stabilisation length behind corners and a tolerance; without circles."""
    pose = [p.model_copy(update={"units": ("one", "one", "two", "two")}) if p.name == "P3" else p for p in program.pose]
    path = [p.model_copy(update={"stabilisation_mm": 1.5}) if p.name == "rectangle" else p for p in program.path if p.name in KEPT]
    tolerance = (Tolerance(characteristic="AP_p", upper=2.0), Tolerance(characteristic="AP_x", pose="P1", lower=-1.0, upper=1.0))
    drift = tuple(Drift(pose=d.pose, group=5) for d in program.drift)
    told = program.model_copy(update={"pose": tuple(pose), "path": tuple(path), "tolerance": tolerance, "drift": drift, "load_kg": 4.0})
    return told, tuple(c for c in commands if "circle" not in c.target)


def main(out: Path) -> None:
    """with-run: counts, English, a pose and a path beyond the zone; without-run: the trajectory alone, Russian, the frame fitted."""
    rng = np.random.default_rng(5)
    plan = campaign(largest_cube((-90.0, -90.0, -90.0), (90.0, 90.0, 90.0)), TESTS)
    program, commands = program_of(plan.program, plan.commands)
    done = cell_robot(5).perform(commands, plan.start, RATE_HZ, rng)
    moved = simulate_run(cell_rig(5), done.time_s, done.poses, noise_mm=0.0, rng=rng).run
    write_run(out / "made" / "run", replace(moved, u_start=(0.02, 1e-4)))  # a start that was measured
    write_trajectory(out / "made" / "trajectory.parquet", reconstruct(read_run(out / "made" / "run")))
    write_program(out / "made" / "program.toml", timed(program, done, TESTS.settle_s))
    given = out / "made" / "trajectory.parquet", out / "made" / "program.toml"
    zone = Settings(trials=200, still_mm=0.5, limit_angle_deg=12.0)
    fitted = replace(zone, align=True, tool_offset_mm=(0.0, 0.0, 30.0), limit_angle_deg=60.0, limit_u95_mm=0.05762, rule="guarded")
    write_certificate(out / "with-run", Inputs(*given, out / "made" / "run"), zone, Choices())
    write_certificate(out / "without-run", Inputs(*given), fitted, Choices("ru"))
    for name in ("with-run", "without-run"):
        # 5 MB of drawing code each
        for page in ("report.html", "certificate.pdf", MANIFEST):
            (out / name / page).unlink()
        seal(out / name, json.loads((out / name / "certificate.json").read_text(encoding="utf-8"))["id"], [])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
