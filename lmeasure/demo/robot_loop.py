"""The closed loop: the robot is identified, its program corrected and run, and certified again beside the first time."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.certificate import (
    CERTIFICATE,
    Comparison,
    Improvement,
    Inputs,
    as_dict,
    canonical,
    compare_certificates,
    improvement,
    read_certificate,
)
from lmeasure.demo.calibrated_cell import RobotCell, Step
from lmeasure.io import files
from lmeasure.iso9283 import POSES, Campaign, CertificationSettings, read_commands, timed, write_commands
from lmeasure.recording import Program, read_run, write_program, write_run
from lmeasure.report import Choices, write_certificate, write_comparison_page, write_correction_page, write_robot_page
from lmeasure.robot_programs import Corrected, Listing, as_record, corrected_program, dialect_of, opened
from lmeasure.robots import (
    RATED_LOAD_KG,
    RATED_SPEED_MM_S,
    AnyRobot,
    Command,
    CrossValidation,
    Identified,
    Limits,
    Noted,
    Performance,
    PredictionMap,
    Robot,
    SimulatedRobot,
    beyond,
    corrected,
    cross_validation,
    identify_with_choice,
    learning_curve,
    nominal_frames,
    nominal_robot,
    read_identified,
    read_robot_measurements,
    record as identified_record,
    workspace,
    worth_freeing,
    write_record,
    write_robot,
    write_urdf,
)
from lmeasure.simulation import WORK_SPACE_MM, WORK_TILT_RAD, scattered_poses
from lmeasure.text import message, of_terminal
from lmeasure.trajectory import Stated, reconstruct, write_trajectory

RECORD, CORRECTION_PAGE = "corrections.json", "corrections.html"


def write_correction(out: Path, found: Corrected, listing: Listing, *, inputs: Sequence[Path], language: str) -> list[str]:
    """The corrected files under their names, corrections.json and corrections.html into the folder; their names."""
    names = [source.name for source in listing.sources]
    for name, text in zip(names, found.texts, strict=True):
        files.write_bytes(out / name, text.encode("latin-1"))
    digests = [(path, files.sha256(path)) for path in inputs]
    record = as_record(found, listing, listing.frames)
    record["inputs"] = [{"file": str(path), "sha256": digest} for path, digest in digests]
    files.write_text(out / RECORD, json.dumps(record, indent=1, allow_nan=False) + "\n")
    write_correction_page(out / CORRECTION_PAGE, found, listing, inputs=[(p.name, digest) for p, digest in digests], language=language)
    return [*names, RECORD, CORRECTION_PAGE]


@dataclass(frozen=True)
class Judged:
    """An identification that knows how rows fared that were held out of it, and how well it predicts over the workspace."""

    found: Identified[Any]
    held: CrossValidation | None
    over: PredictionMap | None
    record: dict[str, Any]


def judge(found: Identified[Any], inputs: Sequence[Path], findings: Sequence[Noted], seed: int = 0, *, thorough: bool = True) -> Judged:
    """Hold rows out, and make the record of it all; thorough: find out too how well fewer poses would do."""
    held = cross_validation(found, seed=seed)
    found = replace(found, misfit=1.0 if held is None else held.misfit, beyond=beyond(found))
    curve, worth, over = learning_curve(found, seed) if thorough else (), worth_freeing(found), workspace(found, seed=seed)
    record = identified_record(found, inputs, held, curve, worth=worth, findings=findings, over=over)
    return Judged(found, held, over, record)


def write_identification(out: Path, robot: AnyRobot, of: Judged, language: str) -> list[str]:
    """robot.toml, robot.urdf of a serial arm, workspace.csv, report.html and, last, identified.json into the folder; their names."""
    result = corrected(robot, of.found)
    write_robot(out / "robot.toml", result)
    if isinstance(result, Robot):  # URDF has words for serial arms alone
        write_urdf(out / "robot.urdf", result)
    if of.over is not None:
        files.write_table(out / "workspace.csv", of.over.columns())
    write_robot_page(out / "report.html", of.found, of.record, of.over, language=language)
    write_record(out / "identified.json", of.record | nominal_frames(robot))
    urdf, space = ["robot.urdf"] * isinstance(result, Robot), ["workspace.csv"] * (of.over is not None)
    return ["identified.json", "robot.toml", *urdf, "report.html", *space]


LOOP_STAGES = IDENTIFY, CORRECT, AGAIN, CERTIFY_AGAIN = (
    message("demo.identify_robot"),
    message("demo.correct_program"),
    message("demo.let_run_corrected_program"),
    message("demo.certify_again"),
)
COMPARED = COMPARISON, PAGE = "comparison.json", "comparison.html"
"""Both certificates side by side: the results, and the page."""
IDENTIFIED_AT = 60
"""Number of poses for the robot's identification, between those of the test and beyond."""
RESTS_S = 0.9
INSIDE = 0.9
"""Part of the work space over which the cell is calibrated."""
STANDS = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""Base frame of the robot in the program's frame, the instrument's: the correction includes the robot's position."""


@dataclass(frozen=True)
class Retest:
    """Plan of the second measurement: the plan of it, how it is certified, how long the robot rests before its poses count, and how
    densely its motion is made."""

    plan: Campaign
    settings: CertificationSettings
    settle_s: float
    rate_hz: float


@dataclass(frozen=True)
class Loop:
    """Results. true_mm: mean distance of the robot's true from the commanded poses, before and after, known to a simulation alone; look:
    the files to look at."""

    identified: Judged
    corrected: Corrected
    comparison: Comparison
    improvement: Improvement
    true_mm: tuple[float, float]
    look: tuple[Path, ...]


def close_loop(
    out: Path,
    cell: RobotCell,
    robot: SimulatedRobot,
    retest: Retest,
    *,
    first: tuple[Program, Performance],
    rng: np.random.Generator,
    step: Step,
    thorough: bool = True,
) -> Loop:
    """Identify the robot, correct and run its program, and compare its certificate with the first in `out`; all files into `out`.

    first: the certified program, and its performance; the robot continues from there, as warm as then. thorough: judge the identification
    by validation poses, and by fewer poses; else it takes a third of the poses.
    """
    warm_s = float(first[1].time_s[-1])
    report = step(IDENTIFY)
    count = IDENTIFIED_AT if thorough else IDENTIFIED_AT // 3
    poses = scattered_poses(count, (INSIDE * WORK_SPACE_MM,) * 3, INSIDE * WORK_TILT_RAD, STANDS, rng=rng)
    ways = [Command(row[None], RATED_SPEED_MM_S, RESTS_S, f"I{i}", load_kg=RATED_LOAD_KG) for i, row in enumerate(poses, 1)]
    done = robot.perform(ways, retest.plan.start, retest.rate_hz, rng, since_s=warm_s)
    write_run(out / "identification" / "run", cell.record(done, rng, report))
    joints = out / "identification" / "joints.csv"
    files.write_table(joints, _logged(robot, done))
    drawn = nominal_robot()
    write_robot(out / "robot.toml", drawn)
    judged = identified(drawn, out / "identification" / "run", joints, thorough=thorough)
    language = of_terminal()
    write_identification(out / "identified", drawn, judged, language)

    step(CORRECT)
    commands = out / "again" / "commands.csv"
    write_commands(commands, retest.plan)
    known = read_identified(out / "identified").stated(STANDS, drawn.tool_pose)
    sources = opened([commands])
    dialect = dialect_of([commands], sources)
    listing = dialect.read(sources).stated({"tool": drawn.tool_pose})
    corrected = corrected_program(listing, dialect, known, limits=Limits(), near=np.degrees(robot.rest).tolist())
    inputs = [commands, out / "identified" / "identified.json", out / "identified" / "robot.toml"]
    write_correction(out / "corrected", corrected, listing, inputs=inputs, language=language)

    report = step(AGAIN)
    reported = read_commands(out / "corrected" / "commands.csv")
    later = robot.perform(reported, reported[-1].poses[-1], retest.rate_hz, rng, since_s=warm_s + float(done.time_s[-1]))
    program = timed(retest.plan.program, later, retest.settle_s)
    write_program(out / "again" / "program.toml", program)
    write_run(out / "again" / "run", cell.record(later, rng, report))

    report = step(CERTIFY_AGAIN)
    trajectory = reconstruct(read_run(out / "again" / "run"))
    write_trajectory(out / "again" / "trajectory.parquet", trajectory)
    measured = Inputs(out / "again" / "trajectory.parquet", out / "again" / "program.toml", out / "again" / "run")
    choices = Choices(language, force=True)
    write_certificate(out / "again" / "certificate", measured, retest.settings, choices, trajectory=trajectory, progress=report)
    true_mm = standing(*first), standing(program, later)
    return _compared(out, judged, corrected, true_mm, language)


def standing(program: Program, done: Performance) -> float:
    """Return the mean distance [mm] over the poses P1 to P5 of the robot's true mean pose from the command."""
    distances = []
    for pose in program.pose:
        if pose.name in POSES and pose.windows_s:
            parts = [slice(*np.searchsorted(done.time_s, window)) for window in pose.windows_s]
            mean = np.mean([done.poses[part, :3].mean(axis=0) for part in parts], axis=0)
            distances.append(float(np.linalg.norm(mean - pose.position_mm)))
    return float(np.mean(distances))


def identified(drawn: Robot, run: Path, joints: Path, *, thorough: bool = True) -> Judged:
    """The robot by the rests of a run and the joint values that a controller has logged there."""
    rows = read_robot_measurements(run, joints, drawn.model, Stated())
    found = identify_with_choice(drawn.model, rows.rows)
    return judge(found, [joints], (*rows.notes, *found.findings), thorough=thorough)


def _compared(out: Path, judged: Judged, corrected: Corrected, true_mm: tuple[float, float], language: str) -> Loop:
    """Return the page, the results behind it, and the files to look at first."""
    folders = (out / "certificate", out / "again" / "certificate")
    certificates = [(name, read_certificate(folder / CERTIFICATE)) for name, folder in zip(("before", "after"), folders, strict=True)]
    comparison = compare_certificates(certificates)
    better = improvement(certificates[0][1], certificates[1][1], corrected.u_mm)
    files.write_text(out / COMPARISON, canonical(as_dict(comparison)).decode("utf-8"))
    write_comparison_page(out / PAGE, comparison, certificates, better, language=language)
    look = (PAGE, "identified/report.html", "corrected/corrections.html", "again/certificate/report.html")
    return Loop(judged, corrected, comparison, better, true_mm, tuple(out / name for name in look))


def _logged(robot: SimulatedRobot, done: Performance) -> dict[str, object]:
    """Return the controller's log of each rest: its name, the time in its middle, and the commanded joint values."""
    joints = robot.nominal.follow(done.commanded, robot.rest)
    middle = [0.5 * (span.arrival_s + span.end_s) for span in done.spans]
    rows = joints[np.searchsorted(done.time_s, middle)]
    columns = {f"joint_{i}_deg": np.degrees(column) for i, column in enumerate(rows.T, 1)}
    return {"name": [command.target for command in done.commands], "time_s": np.array(middle), **columns}
