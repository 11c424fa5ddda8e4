"""Stages in a row: the closed loop over a simulated cell, from counts on a bus to a trajectory, beside the truth it came from."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from lmeasure import files
from lmeasure.accuracy import scan_zone, write_zone
from lmeasure.accuracy.zone import axis, tilts
from lmeasure.acquisition.feed import record_feed
from lmeasure.calibration import Calibration, calibrate, read_campaign
from lmeasure.conventions import QUATERNION_COLUMNS
from lmeasure.errors import LMeasureError
from lmeasure.kernels.screw import OK
from lmeasure.lengths import span_lengths
from lmeasure.poses import POSITION_COLUMNS
from lmeasure.rig import Rig
from lmeasure.run import Run, read_run, write_run
from lmeasure.simulation import Leg, SimulatedRun, cell_rig, scattered_poses, simulate_campaign, simulate_run, smooth_path, write_campaign
from lmeasure.simulation.cell import WORK_SPACE_MM, WORK_TILT_RAD
from lmeasure.trajectory import Trajectory, reconstruct, write_trajectory

FloatArray = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
"""Called with the stage, and how much of it is done of how much."""

SCHEMA = "lmeasure.demo/1"
MARK = "demo.json"
STAGES = COUNT, CALIBRATE, RECORD, RECONSTRUCT, MAP, DRAW = (
    "count reference poses over the bus",
    "calibrate",
    "record a motion over the bus",
    "reconstruct",
    "map the zone",
    "draw",
)

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
REFERENCE_POSES = 20
U_REFERENCE_MM = 0.02  # of each coordinate of a reference pose, as a laser tracker gives it
U_REFERENCE_RAD = 5e-5
NOMINAL_SHIFT_MM, NOMINAL_SHIFT_DEG = 30.0, 5.0
DWELL_S = 0.2
REFERENCE_RATE_HZ, RUN_RATE_HZ = 200.0, 1000.0
WAYPOINTS = 12
SPEED_MM_S = 800.0
ZONE_HALF_MM, ZONE_STEP_MM = 900.0, 100.0
HELD_OUT_POSES = 150
COVERAGE = 0.95


def count_at_stops(rig: Rig, stops: FloatArray, progress: Callable[[int, int], None] | None = None) -> FloatArray:
    """(n, m) recorded counts of pass 1 at (n, 7) poses that a robot drives to and rests at, through the bus; zeroed at the first."""
    legs = [Leg(pose, SPEED_MM_S, 1.0, DWELL_S) for pose in stops]
    time_s, poses = smooth_path(stops[0], legs, REFERENCE_RATE_HZ)
    simulated = simulate_run(rig, time_s, poses, 0.0, np.random.default_rng(0))
    counts = record_feed(rig, simulated.run.passes[0], progress=progress).counts
    resting = [int(np.flatnonzero((np.abs(poses - pose) < 1e-9).all(axis=1))[-1]) for pose in stops]
    return counts.recorded[resting]


def record_motion(simulated: SimulatedRun, progress: Callable[[int, int], None] | None = None) -> Run:
    """The simulated run as it arrives on the other side of the bus, pass by pass."""
    passes = (record_feed(simulated.run.rig, c, i, progress).counts for i, c in enumerate(simulated.run.passes, 1))
    return replace(simulated.run, passes=tuple(passes))


def _different_counts(sent: Run, received: Run) -> str:
    """How many recorded counts of two runs differ, lost samples included."""
    total = sum(c.recorded.size for c in sent.passes)
    same = 0
    for there, here in zip(sent.passes, received.passes, strict=True):
        if here.recorded.shape == there.recorded.shape:
            same += int((here.recorded == there.recorded).sum())
    return f"{total - same} of {total}"


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
    ok = trajectory.status == OK
    position, rotation = np.full((len(truth), 3), np.nan), np.full((len(truth), 3), np.nan)
    position[ok] = truth[ok, :3] - trajectory.poses[ok, :3]
    rotation[ok] = (Rotation.from_quat(truth[ok, 3:]) * Rotation.from_quat(trajectory.poses[ok, 3:]).inv()).as_rotvec()
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
    poses = scattered_poses(HELD_OUT_POSES, (WORK_SPACE_MM,) * 3, WORK_TILT_RAD, HOME, rng)
    difference = span_lengths(found, poses) - span_lengths(true, poses)
    return _rms(difference - difference.mean(axis=0))


def _rms(values: FloatArray) -> float:
    """Root of the mean square of numbers, NaN left out."""
    return math.sqrt(float(np.nanmean(values**2)))


@dataclass(frozen=True)
class Line:
    """One line of the demo's table: what, its error against the truth, and what the program said of it without knowing the truth."""

    what: str
    error: str
    stated: str


@dataclass(frozen=True)
class Demo:
    """What a demo gave: its figures as lines, what to know besides, and the files to look at, the most telling first."""

    lines: tuple[Line, ...]
    remarks: tuple[str, ...]
    look: tuple[Path, ...]


def demo(out: Path, progress: Progress | None = None, seed: int = 0) -> Demo:
    """The whole chain on a simulated cell, every count over a virtual CAN bus, all files into the folder `out`.

    A folder that holds something else is refused with an LMeasureError; an earlier demo's is written over.
    """
    # slow to import, and needed only for pages and pictures
    from lmeasure.calibration_record import write_calibration_record
    from lmeasure.report.calibration import write_calibration_page
    from lmeasure.report.zone import write_zone_page
    from lmeasure.rig import write_rig
    from lmeasure.view.stages import write_recording

    def step(stage: str) -> Callable[[int, int], None]:
        def report(done: int, of: int) -> None:
            if progress is not None:
                progress(stage, done, of)

        report(0, 1)
        return report

    out = Path(out)
    _claim(out)
    rng = np.random.default_rng(seed)
    true = cell_rig(seed)

    report = step(COUNT)
    asked = simulate_campaign(
        true,
        REFERENCE_POSES,
        rng,
        centre=HOME,
        half_mm=(WORK_SPACE_MM,) * 3,
        tilt_rad=WORK_TILT_RAD,
        u_position_mm=U_REFERENCE_MM,
        u_rotation_rad=U_REFERENCE_RAD,
        nominal_shift_mm=NOMINAL_SHIFT_MM,
        nominal_shift_deg=NOMINAL_SHIFT_DEG,
    )
    campaign = replace(asked, recorded=count_at_stops(true, asked.poses, report))
    write_campaign(out / "campaign", campaign)

    report = step(CALIBRATE)
    calibration = calibrate(read_campaign(out / "campaign"), progress=report)
    write_calibration_page(out / "calibration" / "report.html", calibration)
    write_calibration_record(out / "calibration" / "calibration.json", calibration.record)
    write_rig(out / "calibration" / "rig.toml", calibration.rig)

    report = step(RECORD)
    waypoints = scattered_poses(WAYPOINTS, (WORK_SPACE_MM,) * 3, WORK_TILT_RAD, HOME, rng)
    moved = simulate_run(true, *smooth_path(HOME, [Leg(p, SPEED_MM_S, 1.0, DWELL_S) for p in waypoints], RUN_RATE_HZ), 0.0, rng)
    recorded = record_motion(moved, report)
    # what follows knows the calibrated rig only
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
    write_zone_page(out / "zone.html", zone, run.rig)

    report = step(DRAW)
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
        Line("counts lost or changed on the bus", _different_counts(moved.run, recorded), ""),
        *_calibration_lines(campaign.nominal, true, calibration, rng),
        *_trajectory_lines(trajectory, errors),
        Line("zone volume [m^3]", f"{_volume(zone) - _volume(true_zone):+.4f} of {_volume(true_zone):.4f}", f"{_volume(zone):.4f}"),
    )
    remarks = (
        "the calibration's error is one draw and nearly the same along the whole run: the fraction inside 95 % scatters with it",
        *(f"calibration: {w.text}" for w in calibration.record.warnings),
    )
    _mark(out, lines)
    look = ("demo.rrd", "zone.html", "calibration/report.html", "trajectory.parquet", "run", "zone.nc")
    return Demo(lines, remarks, tuple(out / name for name in look))


def map_zone(run: Run, progress: Callable[[int, int], None] | None = None) -> xr.Dataset:
    """The accuracy zone of a run's rig about its start pose, over tilts up to the cell's work space."""
    nodes = axis(-ZONE_HALF_MM, ZONE_HALF_MM, ZONE_STEP_MM)
    return scan_zone(run.rig, run.calibration, nodes, nodes, nodes, tilts(WORK_TILT_RAD, 3), progress=progress, start=run.start)


def _calibration_lines(nominal: Rig, true: Rig, calibration: Calibration, rng: np.random.Generator) -> tuple[Line, ...]:
    u = {p.name: p.u for p in calibration.record.parameters}
    stated = _rms(np.array([[u[f"{p.name}.{c}_mm"] for c in "xyz"] for p in true.observation_point])) * math.sqrt(3)
    return (
        Line("observation points before calibration [mm rms]", f"{_point_error(nominal, true):.2f}", ""),
        Line("observation points [mm rms]", f"{_point_error(calibration.rig, true):.3f}", f"u {stated:.3f}"),
        Line("cable lengths at poses held out [mm rms]", f"{held_out_length_error(true, calibration.rig, rng):.4f}", ""),
    )


def _trajectory_lines(trajectory: Trajectory, errors: Errors) -> tuple[Line, ...]:
    u = trajectory.u
    samples, ok = len(trajectory.status), int((trajectory.status == OK).sum())
    return (
        Line("samples reconstructed", f"{ok} of {samples}", ""),
        Line(
            "gripper position [mm rms]",
            f"{_vector_rms(errors.position_mm):.4f}",
            f"u {_vector_rms(u[:, :3]):.4f}; {errors.inside_position:.1%} inside 95 %",
        ),
        Line(
            "gripper rotation [mrad rms]",
            f"{1e3 * _vector_rms(errors.rotation_rad):.4f}",
            f"u {1e3 * _vector_rms(u[:, 3:]):.4f}; {errors.inside_rotation:.1%} inside 95 %",
        ),
    )


def _volume(zone: xr.Dataset) -> float:
    """Volume of the zone [m^3]."""
    return float(zone.attrs["zone_volume_mm3"]) * 1e-9


def _vector_rms(vectors: FloatArray) -> float:
    """Root of the mean square length of (n, 3) vectors, NaN left out."""
    return math.sqrt(3.0) * _rms(vectors)


def _point_error(rig: Rig, true: Rig) -> float:
    found = np.array([p.position_mm for p in rig.observation_point]) - np.array([p.position_mm for p in true.observation_point])
    return _vector_rms(found)


def _claim(out: Path) -> None:
    """Make the folder, or check that it holds an earlier demo and nothing of anybody else."""
    mark = out / MARK
    try:
        if out.exists() and not out.is_dir():
            raise LMeasureError(f"{out}: is a file; the demo needs a folder of its own")
        if out.is_dir() and any(out.iterdir()) and not _is_mark(mark):
            raise LMeasureError(f"{out}: holds other files and no {MARK} of an earlier demo; give --out a folder of its own")
    except OSError as error:
        raise LMeasureError(f"{out}: cannot be looked into: {error.strerror or error}") from error
    _mark(out, None)


def _is_mark(path: Path) -> bool:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.get("schema") == SCHEMA


def _mark(out: Path, lines: tuple[Line, ...] | None) -> None:
    """The demo's own file: by it the folder is known again; it holds the table once the demo has come to its end."""
    content = {"schema": SCHEMA, "finished": lines is not None, "table": [vars(line) for line in lines or ()]}
    files.write_text(out / MARK, json.dumps(content, indent=1) + "\n")
