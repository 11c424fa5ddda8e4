"""The closed loop over a simulated cell: from counts on a bus to a trajectory and a zone, beside the truth they came from."""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lmeasure.accuracy import axis, radii_95, scan_zone, tilts, write_zone
from lmeasure.calibration import Calibration
from lmeasure.certificate import Improvement
from lmeasure.core import QUATERNION_COLUMNS, Status
from lmeasure.demo.calibrated_cell import (
    CALIBRATE,
    COUNT,
    DWELL_S,
    SPEED_MM_S,
    Progress,
    RobotCell,
    calibrated_cell,
    different_counts,
    record_motion,
    stages,
)
from lmeasure.demo.robot_in_cell import TESTS, RobotTest, mark, robot_tested
from lmeasure.io import files
from lmeasure.recording import POSITION_COLUMNS, Run, read_run, write_run
from lmeasure.rig import Rig
from lmeasure.simulation import WORK_SPACE_MM, WORK_TILT_RAD, Leg, cell_rig, scattered_poses, simulate_run, smooth_path
from lmeasure.text import Say, message, of_terminal
from lmeasure.trajectory import Trajectory, reconstruct, write_trajectory

if TYPE_CHECKING:
    import xarray as xr

    from lmeasure.report import Part


from scipy.stats import chi2

from lmeasure.core import FloatArray, se3
from lmeasure.sensors import span_lengths

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
HELD_OUT_POSES = 150
COVERAGE = 0.95


@dataclass(frozen=True)
class Errors:
    """A trajectory against the truth, over the samples that are ok.

    position_mm (n, 3), rotation_rad (n, 3): small rotation that takes the reconstructed to the true orientation, base axes; NaN where not
    ok. inside_position, inside_rotation: fraction of the samples whose error lies in the stated 95 % region.
    """

    position_mm: FloatArray
    rotation_rad: FloatArray
    inside_position: float
    inside_rotation: float


def errors_of(trajectory: Trajectory, truth: FloatArray) -> Errors:
    """Compare with (n, 7) true poses, sample by sample."""
    ok = trajectory.status == Status.OK
    delta = np.full((len(truth), 6), np.nan)
    delta[ok] = se3.displacement(truth[ok], trajectory.poses[ok])
    rotation, position = delta[:, :3], delta[:, 3:]
    covariance = trajectory.random + trajectory.systematic
    inside = [
        float(np.mean(_mahalanobis(error[ok], covariance[ok][:, part, part]) <= chi2.ppf(COVERAGE, 3)))
        for error, part in ((position, slice(3, 6)), (rotation, slice(0, 3)))
    ]
    return Errors(position, rotation, *inside)


def _mahalanobis(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariance, errors[..., None])[..., 0]))


def held_out_length_error(true: Rig, found: Rig, rng: np.random.Generator) -> float:
    """rms [mm] of the lengths a calibrated rig predicts at poses it was not calibrated at, against the true rig's, each cable's mean
    removed."""
    poses = scattered_poses(HELD_OUT_POSES, (WORK_SPACE_MM,) * 3, WORK_TILT_RAD, HOME, rng=rng)
    difference = span_lengths(found, poses) - span_lengths(true, poses)
    return rms(difference - difference.mean(axis=0))


def rms(values: FloatArray) -> float:
    """Root of the mean square of numbers, NaN left out."""
    return math.sqrt(float(np.nanmean(values**2)))


def vector_rms(vectors: FloatArray) -> float:
    """Root of the mean square length of (n, 3) vectors, NaN left out."""
    return math.sqrt(3.0) * rms(vectors)


def point_error(rig: Rig, true: Rig) -> float:
    """rms distance [mm] of the observation points of two rigs."""
    found = np.array([p.position_mm for p in rig.observation_point]) - np.array([p.position_mm for p in true.observation_point])
    return vector_rms(found)


STAGES = COUNT, CALIBRATE, RECORD, RECONSTRUCT, MAP, TEST_ROBOT, DRAW = (
    COUNT,
    CALIBRATE,
    message("demo.record_motion_over_bus"),
    "reconstruct",
    message("demo.map_zone"),
    message("demo.test_robot"),
    "draw",
)
BRIEF = replace(TESTS, tests=("pose",), cycles={"pose": 4})
"""Tests of the robot: pose accuracy alone, in 4 cycles where ISO 9283 has 30."""
ROBOT_STEPS = 9

PAGE = "demo.html"
LOST_COUNTS = 200
"""Counts of the fault on the page."""
RUN_RATE_HZ = 500.0
WAYPOINTS = 12
ZONE_HALF_MM, ZONE_STEP_MM = 900.0, 150.0


@dataclass(frozen=True)
class Line:
    """One line of the demo's table: a name, its error compared with the truth, and the program's prediction without the truth."""

    what: str
    error: str
    stated: str


@dataclass(frozen=True)
class Demo:
    """Results of a demo: its figures as lines and as numbers, remarks, and the files to look at, the most informative first."""

    lines: tuple[Line, ...]
    figures: Mapping[str, float]
    remarks: tuple[str, ...]
    look: tuple[Path, ...]


def demo(out: Path, progress: Progress | None = None, seed: int = 0) -> Demo:
    """Run the whole chain on a simulated cell, every count over a virtual CAN bus, and write all files into the folder `out`."""
    # slow to import, and needed only for pages and pictures
    from lmeasure.report import write_demo_page, write_zone_page
    from lmeasure.view import write_recording

    out = Path(out)
    mark(out, None)
    step = stages(progress)
    rng = np.random.default_rng(seed)
    true = cell_rig(seed)
    cell = calibrated_cell(out, true, rng, step)
    campaign, calibration = cell.campaign, cell.calibration

    report = step(RECORD)
    waypoints = scattered_poses(WAYPOINTS, (WORK_SPACE_MM,) * 3, WORK_TILT_RAD, HOME, rng=rng)
    path = smooth_path(HOME, [Leg(p, SPEED_MM_S, 1.0, DWELL_S) for p in waypoints], RUN_RATE_HZ)
    moved = simulate_run(true, *path, noise_mm=0.0, rng=rng)
    recorded = record_motion(moved, report)
    # the next steps use the calibrated rig only
    write_run(out / "run", replace(recorded, rig=calibration.rig, calibration=calibration.record))
    columns = {"time_s": recorded.passes[0].time_s}
    columns |= dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), moved.poses.T, strict=True))
    files.write_table(out / "truth.parquet", columns)

    report = step(RECONSTRUCT)
    run = read_run(out / "run")
    trajectory = reconstruct(run)
    write_trajectory(out / "trajectory.parquet", trajectory)
    errors = errors_of(trajectory, moved.poses)

    report = step(MAP)
    zone, true_zone = map_zone(run, report), map_zone(replace(run, rig=true, calibration=None), report)
    write_zone(out / "zone.nc", zone)
    write_zone_page(out / "zone.html", zone, run.rig, run.calibration, language=of_terminal())

    report = step(TEST_ROBOT)
    done = itertools.count(1)
    robot = robot_tested(
        out / "robot", RobotCell(true, calibration), BRIEF, correct=True, seed=seed, rng=rng,
        step=lambda stage: _within(report, next(done), ROBOT_STEPS), thorough=False,
    )  # fmt: skip

    report = step(DRAW)
    u95 = radii_95((trajectory.random + trajectory.systematic)[:, 3:, 3:])
    distance = np.linalg.norm(errors.position_mm, axis=1)
    within = float(np.nanmean(distance <= u95))
    verdict = message(
        "demo_page.verdict", poses=int((trajectory.status == Status.OK).sum()), mm=vector_rms(errors.position_mm), percent=100.0 * within
    )
    found = DemoResults(run, calibration, trajectory, distance, u95, zone, robot)
    write_demo_page(out / PAGE, message("demo_page.title"), verdict, found.parts(Say(of_terminal())), language=of_terminal())
    write_recording(
        out / "demo.rrd",
        run.rig,
        run=run,
        trajectory=trajectory,
        truth=moved.poses,
        errors=dict(zip(("x_mm", "y_mm", "z_mm"), errors.position_mm.T, strict=True)),
        nominal=campaign.nominal,
        reference=campaign.measured,
        record=calibration.record,
        zone=zone,
    )
    lines = (
        Line(message("demo.line.counts"), different_counts(moved.run, recorded), ""),
        *_calibration_lines(campaign.nominal, true, calibration, rng),
        *_trajectory_lines(trajectory, errors),
        Line(message("demo.line.zone"), f"{_volume(zone) - _volume(true_zone):+.4f} of {_volume(true_zone):.4f}", f"{_volume(zone):.4f}"),
    )
    remarks = (message("demo.one_draw"), *(message("demo.calibration_warns", text=w.text) for w in calibration.record.warnings))
    mark(out, lines)
    look = (PAGE, "demo.rrd", "zone.html", "calibration/report.html", "trajectory.parquet", "run", "zone.nc")
    figures = {
        "samples": float(len(trajectory.status)),
        "with_a_pose": float((trajectory.status == Status.OK).sum()),
        "error_of_points_mm": point_error(calibration.rig, true),
        "error_of_position_mm": vector_rms(errors.position_mm),
        "error_of_rotation_rad": vector_rms(errors.rotation_rad),
        "positions_inside_95": within,
        "rotations_inside_95": errors.inside_rotation,
        "robot_before_mm": found.improvement.before_mm[0],
        "robot_after_mm": found.improvement.after_mm[0],
        "zone_volume_mm3": float(zone.attrs["zone_volume_mm3"]),
    }
    return Demo(lines, figures, remarks, tuple(out / name for name in look))


def counter_fault(run: Run) -> tuple[Trajectory, float]:
    """Let a counter jump in the middle of the run; return the trajectory that is reconstructed then, and the time of the jump [s]."""
    counts = run.passes[0]
    recorded = counts.recorded.copy()
    row = len(recorded) // 2
    recorded[row:, 0] += LOST_COUNTS
    return reconstruct(replace(run, passes=(replace(counts, recorded=recorded), *run.passes[1:]))), float(counts.time_s[row])


def _within(report: Callable[[int, int], None], number: int, of: int) -> Callable[[int, int], None]:
    """Report a step as part of a stage."""
    report(min(number - 1, of), of)
    return lambda done, total: report(min(number - 1, of), of)


class DemoResults(NamedTuple):
    """Contents of the page: run, calibration and trajectory, its distances from the truth and its U95 (n,) [mm], the zone, the robot."""

    run: Run
    calibration: Calibration
    trajectory: Trajectory
    distance_mm: FloatArray
    u95_mm: FloatArray
    zone: "xr.Dataset"
    robot: RobotTest

    @property
    def improvement(self) -> Improvement:
        """Return the robot's improvement by correction."""
        assert self.robot.loop is not None
        return self.robot.loop.improvement

    def parts(self, say: Say) -> "list[Part]":
        """Return the steps of the page: a sentence, a picture, a file and a command each."""
        from lmeasure.report import Part, distances_figure, errors_beside_figure, fault_figure, playing_figure, residuals_figure, u95_figure

        run, calibration, inside = self.run, self.calibration, self.zone["in_zone"].values.astype(bool)
        best = float(self.zone["u95_position_mm"].values[inside].min()) if inside.any() else math.nan
        broken, at = counter_fault(run)
        bad = broken.time_s[broken.status != Status.OK]
        better = self.improvement
        text = message
        return [
            Part(
                text("demo_page.cell"), text("demo_page.cell.text", cables=len(run.rig.cable)),
                playing_figure(run.rig, self.trajectory, say), "demo.rrd", "lmeasure view demo.rrd",
            ),
            Part(
                text("demo_page.error"), text("demo_page.error.text"),
                errors_beside_figure(self.trajectory.time_s, self.distance_mm, self.u95_mm, say), "trajectory.parquet",
                "lmeasure reconstruct run --out trajectory.parquet",
            ),
            Part(
                text("demo_page.calibration"),
                text("demo_page.calibration.text", poses=len(calibration.campaign.poses), rms=calibration.record.noise["residual_rms_mm"]),
                residuals_figure(calibration.record, calibration.rig, say), "calibration/report.html",
                "lmeasure calibrate campaign --out calibration",
            ),
            Part(
                text("demo_page.zone"), text("demo_page.zone.text", volume=_volume(self.zone), best=best),
                u95_figure(self.zone, say, every=True), "zone.html", "lmeasure zone calibration/rig.toml --out zone.nc --report zone",
            ),
            Part(
                text("demo_page.fault"), text("demo_page.fault.text", counts=LOST_COUNTS, at=at, samples=len(bad)),
                fault_figure(run.passes[0], at, (float(bad[0]), float(bad[-1])) if len(bad) else None, say), "run/pass1.csv",
                "lmeasure check-instrument run --out check",
            ),
            Part(
                text("demo_page.robot"), text("demo_page.robot.text", before=better.before_mm[0], after=better.after_mm[0]),
                distances_figure(better, say), "robot/comparison.html",
                "lmeasure compare robot/certificate robot/again/certificate --out comparison.json --page comparison.html",
            ),
        ]  # fmt: skip


def map_zone(run: Run, progress: Callable[[int, int], None] | None = None) -> "xr.Dataset":
    """The accuracy zone of a run's rig about its start pose, over tilts up to the cell's work space."""
    nodes = axis(-ZONE_HALF_MM, ZONE_HALF_MM, ZONE_STEP_MM)
    return scan_zone(
        run.rig, run.calibration, x=nodes, y=nodes, z=nodes, rotations=tilts(WORK_TILT_RAD, 3), progress=progress, start=run.start
    )


def _calibration_lines(nominal: Rig, true: Rig, calibration: Calibration, rng: np.random.Generator) -> tuple[Line, ...]:
    u = {p.name: p.u for p in calibration.record.parameters}
    stated = rms(np.array([[u[f"{p.name}.{c}_mm"] for c in "xyz"] for p in true.observation_point])) * math.sqrt(3)
    return (
        Line(message("demo.line.points_before"), f"{point_error(nominal, true):.2f}", ""),
        Line(message("demo.line.points"), f"{point_error(calibration.rig, true):.3f}", f"u {stated:.3f}"),
        Line(message("demo.line.lengths"), f"{held_out_length_error(true, calibration.rig, rng):.4f}", ""),
    )


def _trajectory_lines(trajectory: Trajectory, errors: Errors) -> tuple[Line, ...]:
    u = trajectory.u
    samples, ok = len(trajectory.status), int((trajectory.status == Status.OK).sum())
    return (
        Line(message("demo.line.samples"), f"{ok} of {samples}", ""),
        Line(
            message("demo.line.position"),
            f"{vector_rms(errors.position_mm):.4f}",
            f"u {vector_rms(u[:, :3]):.4f}; {errors.inside_position:.1%} inside 95 %",
        ),
        Line(
            message("demo.line.rotation"),
            f"{1e3 * vector_rms(errors.rotation_rad):.4f}",
            f"u {1e3 * vector_rms(u[:, 3:]):.4f}; {errors.inside_rotation:.1%} inside 95 %",
        ),
    )


def _volume(zone: "xr.Dataset") -> float:
    """Volume of the zone [m^3]."""
    return float(zone.attrs["zone_volume_mm3"]) * 1e-9
