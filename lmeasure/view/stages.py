"""Stages put together: one recording, its notes and its blueprint."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import xarray as xr

from lmeasure.calibration_record import CalibrationRecord
from lmeasure.counts import read_counts
from lmeasure.poses import Poses
from lmeasure.rig import Rig
from lmeasure.run import Run
from lmeasure.trajectory import Trajectory
from lmeasure.view.plots import log_counts, log_record, log_residuals, log_trajectory, log_truth
from lmeasure.view.recording import FloatArray, recording
from lmeasure.view.space import GREY, TRUTH_COLOUR, WHITE, log_path, log_reference, log_rig, log_zone, metres


def write_recording(
    path: Path,
    rig: Rig,
    *,
    run: Run | None = None,
    trajectory: Trajectory | None = None,
    truth: FloatArray | None = None,
    errors: Mapping[str, FloatArray] | None = None,
    nominal: Rig | None = None,
    reference: Poses | None = None,
    record: CalibrationRecord | None = None,
    zone: xr.Dataset | None = None,
    notes: Sequence[str] = (),
) -> None:
    """Write what the stages gave as one .rrd, whole or not at all, with a blueprint that opens it.

    run: counts, and with a trajectory the residual of each cable; truth (k, 7) poses where they are known [mm, unit quaternions], which
    without a trajectory are those of the run's samples and move the picture; errors: (n,) columns on the trajectory's samples, names with
    units; nominal: the rig before calibration; reference and record: poses and result of a calibration; zone: dataset of the contract's
    netCDF. LMeasureError when the file cannot be written.
    """
    lines = list(notes)
    with recording(Path(path), f"lmeasure {rig.name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        log_rig(rec, rig, "/world/rig", WHITE, labelled=True)
        if nominal is not None:
            log_rig(rec, nominal, "/world/nominal", GREY, labelled=False)
        if run is not None:
            log_counts(rec, run)
        if trajectory is not None:
            lines += log_trajectory(rec, rig, trajectory, errors or {})
            if run is not None:
                log_residuals(rec, run, trajectory)
        if truth is not None:
            if trajectory is None and run is not None:
                lines += log_truth(rec, rig, run, truth)
            lines += log_path(rec, "/world/truth", truth, np.ones(len(truth), np.bool_), TRUTH_COLOUR)
        if reference is not None:
            log_reference(rec, rig, reference)
        if record is not None:
            lines += log_record(rec, record, reference)
        if zone is not None:
            lines += log_zone(rec, zone)
        rec.log("/notes", rr.TextDocument(_notes(rig, lines), media_type=rr.MediaType.MARKDOWN), static=True)
        rec.send_blueprint(_blueprint(rig, run, trajectory, record, zone, errors), make_active=True, make_default=True)


def write_counts_recording(path: Path, rig: Rig, counts: Sequence[Path]) -> None:
    """Write the counts of the passes there are as yet, from their files, as one .rrd; raises what `write_recording` raises."""
    passes = tuple(read_counts(file) for file in counts)
    # counts alone need no start pose
    write_recording(path, rig, run=Run(rig, np.full(7, np.nan), passes))


def _notes(rig: Rig, lines: Sequence[str]) -> str:
    """The page beside the pictures."""
    head = [
        f"# {rig.name}",
        "",
        "Space in metres, base frame, Z up. Scalars carry their unit in the name; the record of truth is Parquet.",
        "",
    ]
    assumed = [f"assumed, measured by nobody: {', '.join(rig.assumed)}"] if rig.assumed else []
    return "\n".join([*head, *(f"- {line}" for line in [*lines, *assumed])]) + "\n"


def _blueprint(
    rig: Rig,
    run: Run | None,
    trajectory: Trajectory | None,
    record: CalibrationRecord | None,
    zone: xr.Dataset | None,
    errors: Mapping[str, FloatArray] | None,
) -> rrb.Blueprint:
    """Space on the left, seen from outside the rig; what there is of plots on the right; the notes under them."""

    def plot(name: str, origin: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.Corner2D.LeftTop)

    points = metres(np.array([p.position_mm for p in rig.observation_point]))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    size = max(float(np.ptp(points, axis=0).max()), 0.5)
    eye = rrb.EyeControls3D(position=middle + size * np.array([0.75, -0.9, 0.5]), look_target=middle, eye_up=(0, 0, 1))

    def space(name: str, contents: Sequence[str]) -> rrb.Spatial3DView:
        return rrb.Spatial3DView(
            name=name,
            origin="/world",
            contents=contents,
            eye_controls=eye,
            overrides={"/world/zone/outside": rrb.EntityBehavior(visible=False)},
            line_grid=rrb.LineGrid3D(visible=False),
        )

    # a zone is full of nodes: it has a view of its own, or hides the gripper
    moving = trajectory is not None or run is not None or record is not None
    spaces = [space("Rig and gripper", ["$origin/**", "- $origin/zone/**"])] if moving or zone is None else []
    spaces += [space("Accuracy zone", ["$origin/**"])] if zone is not None else []
    pages: list[rrb.Vertical] = []
    if trajectory is not None:
        motion: list[rrb.View] = [plot("Position [mm]", "/position_mm"), plot("Worst pressure angle [deg]", "/worst_pressure_angle_deg")]
        if run is not None:
            motion.append(plot("Residual of each cable [mm]", "/residual_mm"))
        motion.append(rrb.StateTimelineView(name="Status", origin="/status_lane"))
        spread: list[rrb.View] = [plot("Error against truth", "/errors")] if errors else []
        spread += [
            plot("Standard uncertainty, position [mm]", "/u_position_mm"),
            plot("Standard uncertainty, rotation [rad]", "/u_rotation_rad"),
        ]
        pages += [rrb.Vertical(*motion, name="Motion", row_shares=[2] * (len(motion) - 1) + [1]), rrb.Vertical(*spread, name="Uncertainty")]
    if run is not None:
        passes = [plot(f"Counts, pass {i}", f"/counts/pass{i}") for i in range(1, len(run.passes) + 1)]
        pages.append(rrb.Vertical(*passes, name="Counts"))
    if record is not None:
        residuals = plot("Calibration residuals [mm] (timeline: pose)", "/calibration_residual_mm")
        pages.append(rrb.Vertical(residuals, name="Calibration"))
    text: list[rrb.View] = [rrb.TextDocumentView(name="Notes", origin="/notes")]
    if trajectory is not None:
        text.append(rrb.TextLogView(name="Status", origin="/status"))
    right = rrb.Vertical(rrb.Tabs(*pages), rrb.Tabs(*text), row_shares=[3, 1]) if pages else rrb.Tabs(*text)
    timeline = "time" if run is not None or trajectory is not None else "pose"
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Tabs(*spaces), right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=timeline),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
