"""A robot with known errors is tested in the simulated cell, measured through the bus and certified, beside the truth."""

import itertools
import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmeasure.certificate import Inputs
from lmeasure.core import QUATERNION_COLUMNS, FloatArray, Status
from lmeasure.demo.calibrated_cell import CALIBRATE, COUNT, Progress, RobotCell, Step, calibrated_cell, stages
from lmeasure.demo.robot_loop import COMPARED, LOOP_STAGES, Loop, Retest, close_loop
from lmeasure.io import files
from lmeasure.iso9283 import CertificationSettings, Tests, campaign, evaluate, largest_cube, timed, write_commands
from lmeasure.recording import POSITION_COLUMNS, Program, Run, read_run, write_program, write_run
from lmeasure.robots import RATED_LOAD_KG, RATED_SPEED_MM_S, cell_robot
from lmeasure.simulation import cell_rig
from lmeasure.text import message, of_terminal
from lmeasure.trajectory import Trajectory, reconstruct, write_trajectory

SCHEMA = "lmeasure.demo/1"
MARK = "demo.json"
OF_CELL = (
    MARK,
    "campaign",
    "calibration",
    "run",
    "truth.parquet",
    "trajectory.parquet",
    "demo.rrd",
    "zone.nc",
    "zone.html",
    "demo.html",
    "robot",
)
"""Files and folders of the demo of the cell."""
OF_ROBOT = (
    *OF_CELL[:-4], "commands.csv", "program.toml", "certificate", "characteristics.csv", "robot.toml", "identification", "identified",
    "corrected", "again", "comparison.json", "comparison.html",
)  # fmt: skip
"""Files and folders of the demo of the robot."""


def fresh(name: str) -> Path:
    """Return the first of NAME, NAME-2, NAME-3, ... that does not exist in the working folder."""
    return next(path for path in (Path(name if n == 1 else f"{name}-{n}") for n in itertools.count(1)) if not os.path.lexists(path))


def existing(out: Path, names: Sequence[str]) -> list[Path]:
    """Return the files that exist under these names of a folder, those in folders included, and those that killed processes left
    unfinished, under the names that they were to get."""
    every = [one for name in names for one in (out / name, *sorted((out / name).rglob("*")))]
    folders = [out, *(one for one in every if one.is_dir() and not one.is_symlink())]
    left = [one for folder in folders for one in files.abandoned(folder) if folder != out or one.name in names]
    there = [one for one in every if os.path.lexists(one) and (one.is_symlink() or not one.is_dir())]
    unfinished = {one.path for one in left}
    return [*(one for one in there if one not in unfinished), *(one.path.with_name(one.name) for one in left if one.path.is_file())]


def mark(out: Path, table: Sequence[object] | None) -> None:
    """Write demo.json: the demo's table once it has ended, none before."""
    content = {"schema": SCHEMA, "finished": table is not None, "table": [vars(line) for line in table or ()]}
    files.write_text(out / MARK, json.dumps(content, indent=1) + "\n")


ROBOT_STAGES = COUNT, CALIBRATE, PERFORM, RECORD, RECONSTRUCT, CERTIFY, *_, DRAW = (
    COUNT,
    CALIBRATE,
    message("demo.let_robot_run_test"),
    message("demo.record_over_bus"),
    "reconstruct",
    "certify",
    *LOOP_STAGES,
    "draw",
)

CUBE = largest_cube((-250.0,) * 3, (250.0,) * 3)
AGAIN = ("pose", "path")
"""Tests that are run again by the corrected program."""
RATE_HZ, BRIEF_RATE_HZ = 200.0, 125.0
TESTS = Tests(
    tests=("pose", "approach", "stabilisation", "path", "reorientation", "posing", "compliance", "weaving"),
    speed_mm_s=RATED_SPEED_MM_S,
    speeds_percent=(100.0,),
    loads_kg=(RATED_LOAD_KG,),
    dwell_s=0.45,
    settle_s=0.3,
    cycles={"approach": 10, "reorientation": 5, "compliance": 2, "weaving": 2},
    weave_mm=(10.0, 40.0),
    limit_band_mm=0.05,
    angles="fanuc-wpr",
)
"""Tests at one speed and load, with short rests and fewer cycles of some tests, to save time."""


@dataclass(frozen=True)
class ComparedCharacteristic:
    """A characteristic compared with the truth: value and U95 as certified, true_value from the true poses of the same cycles."""

    name: str
    where: str
    unit: str
    value: float
    u95: float
    true_value: float
    inside: bool
    capable: bool


@dataclass(frozen=True)
class RobotDemo:
    """Results of the demo: every characteristic beside its truth, the effect of the correction on the robot, and the files to look at, the
    most telling first. loop: None where it was left out."""

    held: tuple[ComparedCharacteristic, ...]
    loop: Loop | None
    remarks: tuple[str, ...]
    look: tuple[Path, ...]

    def shown(self) -> tuple[ComparedCharacteristic, ...]:
        """One of each name: at P1 or on the line where it is known there, else the first."""
        best: dict[str, ComparedCharacteristic] = {}
        for h in self.held:
            plain = h.where in {"P1", "line"}
            if h.name not in best or (plain and best[h.name].where not in {"P1", "line"}):
                best[h.name] = h
        return tuple(best.values())


def robot_demo(
    out: Path,
    progress: Progress | None = None,
    seed: int = 0,
    tests: Tests = TESTS,
    *,
    settings: CertificationSettings | None = None,
    correct: bool = True,
) -> RobotDemo:
    """Calibrate the cell, let the simulated robot run the test cube, measure it and certify it by the settings; all files into `out`.
    correct: correct the robot then, and certify it again.
    """
    # slow to import, and needed only for pictures
    from lmeasure.view import write_recording

    out = Path(out)
    mark(out, None)
    step = stages(progress)
    rng = np.random.default_rng(seed)
    true = cell_rig(seed)
    cell = RobotCell(true, calibrated_cell(out, true, rng, step).calibration)
    tested = robot_tested(out, cell, tests, settings, correct=correct, seed=seed, rng=rng, step=step)
    step(DRAW)
    record = cell.calibration.record
    write_recording(out / "demo.rrd", tested.run.rig, run=tested.run, trajectory=tested.trajectory, truth=tested.truth, record=record)
    mark(out, tested.held)
    look = (
        *(("comparison.html",) if tested.loop else ()),
        "demo.rrd",
        "certificate/report.html",
        "certificate/certificate.pdf",
        "characteristics.csv",
        "program.toml",
        "commands.csv",
        "run",
    )
    remarks = _remarks(tested.held, settings or CertificationSettings())
    return RobotDemo(tested.held, tested.loop, remarks, tuple(out / name for name in look))


class RobotTest(NamedTuple):
    """A tested robot: its characteristics beside their truth, the effect of correction, and the measured beside the true poses (n, 7)."""

    held: tuple[ComparedCharacteristic, ...]
    loop: Loop | None
    run: Run
    trajectory: Trajectory
    truth: FloatArray


def robot_tested(
    out: Path,
    cell: RobotCell,
    tests: Tests,
    settings: CertificationSettings | None = None,
    *,
    correct: bool,
    seed: int,
    rng: np.random.Generator,
    step: Step,
    thorough: bool = True,
) -> RobotTest:
    """Let a simulated robot run the tests in a calibrated cell and certify it; correct it then and certify it again; all files into `out`.

    thorough: as for `close_loop`.
    """
    # slow to import, and needed only for pages
    from lmeasure.report import Choices, write_certificate

    report = step(PERFORM)
    plan = campaign(CUBE, tests)
    write_commands(out / "commands.csv", plan)
    robot = cell_robot(seed)
    rate_hz = RATE_HZ if thorough else BRIEF_RATE_HZ
    done = robot.perform(plan.commands, plan.start, rate_hz, rng, progress=report)
    program = timed(plan.program, done, tests.settle_s)
    write_program(out / "program.toml", program)

    report = step(RECORD)
    write_run(out / "run", cell.record(done, rng, report))
    columns = {"time_s": done.time_s} | dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), done.poses.T, strict=True))
    files.write_table(out / "truth.parquet", columns)

    step(RECONSTRUCT)
    run = read_run(out / "run")
    trajectory = reconstruct(run)
    write_trajectory(out / "trajectory.parquet", trajectory)

    report = step(CERTIFY)
    settings = settings or CertificationSettings()
    inputs = Inputs(out / "trajectory.parquet", out / "program.toml", out / "run")
    choices = Choices(of_terminal(), force=True)
    certificate = write_certificate(out / "certificate", inputs, settings, choices, trajectory=trajectory, progress=report)
    held = hold(certificate["characteristics"], _without_errors(trajectory, done.poses), program, settings)
    files.write_table(
        out / "characteristics.csv", {key: [getattr(h, key) for h in held] for key in ComparedCharacteristic.__dataclass_fields__}
    )

    for name in COMPARED:  # an earlier demo's is of another certificate
        (out / name).unlink(missing_ok=True)
    loop = None
    if correct:
        again = campaign(CUBE, replace(tests, tests=tuple(t for t in AGAIN if t in tests.tests)))
        retest = Retest(again, settings, tests.settle_s, rate_hz)
        loop = close_loop(out, cell, robot, retest, first=(program, done), rng=rng, step=step, thorough=thorough)
    return RobotTest(held, loop, run, trajectory, done.poses)


def hold(
    characteristics: Sequence[Mapping[str, Any]], truth: Trajectory, program: Program, settings: CertificationSettings
) -> tuple[ComparedCharacteristic, ...]:
    """Each characteristic of a certificate beside that of the true trajectory, evaluated alike."""
    of_truth = evaluate(truth, program, settings=replace(settings, trials=100))
    true_values = {_key(c.as_dict()): c for c in of_truth.characteristics}
    return tuple(
        ComparedCharacteristic(
            c["name"], t.where, c["unit"], c["value"], c["u95"], t.value, abs(c["value"] - t.value) <= c["u95"], c["capable"]
        )
        for c in characteristics
        if (t := true_values.get(_key(c))) is not None
    )


def _key(c: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(c.get(key) for key in ("name", "pose", "path", "part"))


def _without_errors(trajectory: Trajectory, poses: FloatArray) -> Trajectory:
    """The true poses as a trajectory that is certain of them."""
    nothing, status = np.zeros_like(trajectory.random), np.full(len(poses), Status.OK)
    return replace(trajectory, poses=poses, status=status, random=nothing, systematic=nothing, covers="nothing: the truth", notes=())


def _remarks(held: tuple[ComparedCharacteristic, ...], settings: CertificationSettings) -> tuple[str, ...]:
    inside = Counter(h.inside for h in held)[True]
    capable = Counter(h.capable for h in held)[True]
    return (
        message("demo.characteristics_lie_within_u95", inside=inside, of=len(held)),
        message("demo.instrument_capable_them_u95", capable=capable, part=settings.capability),
    )
