"""Stages put together: one recording, its notes and its blueprint.

Known poses and a calibration's record have plots and notes of their own.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import xarray as xr

from lmeasure.acquisition import Samples
from lmeasure.core import FloatArray, LMeasureError
from lmeasure.recording import Counts, Poses, Run, RunHead, read_counts
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import LengthResiduals, Lengths, length_residuals
from lmeasure.text import message, signs
from lmeasure.trajectory import Each, Trajectory, align
from lmeasure.view.recording import CableSeries, cable_colour, entity_path, indexes_at, named, recording, send_scalars, shown, time_indexes
from lmeasure.view.space import (
    GREY,
    MAX_FRAMES,
    PLAIN,
    TRUTH_COLOUR,
    Thinned,
    draw_frames,
    log_path,
    log_reference,
    log_rig,
    log_zone,
    metres,
    send_tool,
    thinned_note,
)
from lmeasure.view.trajectory import TrajectoryLog, log_trajectory


def log_truth(rec: rr.RecordingStream, rig: Rig, run: Run, poses: FloatArray) -> list[str]:
    """Tool and cables along (n, 7) known poses of the run's samples."""
    frames, time_s = Thinned(MAX_FRAMES, 8), run.passes[0].time_s
    frames.add(np.column_stack([time_s, poses]), np.zeros(1, np.int64))
    send_tool(rec, time_indexes(time_s), poses, place_only=False)
    draw_frames(rec, rig, indexes_at(frames.rows[:, 0], frames.numbers), frames.rows[:, 1:], place_only=False)
    return [message("view.true_motion"), *thinned_note(frames)]


def log_record(rec: rr.RecordingStream, record: CalibrationRecord, reference: Poses | None) -> list[str]:
    """Residuals of a calibration by channel; returns its table of parameters and its warnings as lines of markdown."""
    names = reference.names if reference is not None else tuple(dict.fromkeys(r.pose for r in record.residuals))
    for j, channel in enumerate(dict.fromkeys(r.channel for r in record.residuals)):
        mine = {r.pose: r.mm for r in record.residuals if r.channel == channel}
        rows = np.array([i for i, name in enumerate(names, 1) if name in mine])
        entity = entity_path("calibration_residual_mm", channel)
        rec.log(entity, rr.SeriesLines(colors=cable_colour(j), names=channel), static=True)
        values = np.array([mine[names[i - 1]] for i in rows])
        send_scalars(rec, entity, [rr.TimeColumn("pose", sequence=rows)], values)
    lines = [f"**{w.code}**: {shown(w.text)}" for w in record.warnings]
    lines += [message("view.undetermined", point=u.point, text=u.text) for u in record.unobservable]
    lines.append(message("view.calibration", equations=record.equations, unknowns=record.unknowns, rank=record.rank))
    return lines


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
    reported = False
    with _recording_of(rig, path) as rec:
        if nominal is not None:
            log_rig(rec, nominal, "/world/nominal", GREY, labelled=False)
        if run is not None:
            for number, counts in enumerate(run.passes, 1):
                _counts_series(rec, counts, number).add(counts.time_s, counts.recorded)
        if trajectory is not None:
            lines += log_trajectory(rec, rig, trajectory, errors or {})
            if run is not None:
                residuals = length_residuals(align(run).run, trajectory.poses)
                _residual_series(rec, rig).add(trajectory.time_s, residuals)
                reported = _tells(residuals)
                lines += [] if reported else [message("view.no_residuals")]
        if truth is not None:
            if trajectory is None and run is not None:
                lines += log_truth(rec, rig, run, truth)
            lines += log_path(rec, "/world/truth", truth, TRUTH_COLOUR)
        if reference is not None:
            log_reference(rec, rig, reference)
        if record is not None:
            lines += log_record(rec, record, reference)
        if zone is not None:
            lines += log_zone(rec, zone)
        _log_notes(rec, rig, lines)
        passes = 0 if run is None else len(run.passes)
        moved = trajectory is not None
        seen = {"record": record is not None, "zone": zone is not None, "errors": bool(errors)}
        blueprint = _blueprint(rig, passes, trajectory=moved, residuals=reported, **seen)
        rec.send_blueprint(blueprint, make_active=True, make_default=True)


@contextmanager
def streamed_recording(path: Path, head: RunHead) -> Iterator[Each]:
    """A function that takes a run of one pass piece by piece - counts, lengths, trajectory - into the .rrd at path.

    When the block ends the file stands, with what `write_recording` puts into that of the whole run; when the block fails there is none.
    Raises what `write_recording` raises.
    """
    rig = head.rig
    with _recording_of(rig, path) as rec:
        motion, residuals = TrajectoryLog(rec, rig), LengthResiduals(rig, head.start, head.temperature_c)
        of_cables, of_channels, reported = _residual_series(rec, rig), None, False

        def add(counts: Counts, lengths: Lengths, trajectory: Trajectory) -> None:
            nonlocal of_channels, reported
            if of_channels is None:
                of_channels = _counts_series(rec, counts, 1)
            of_channels.add(counts.time_s, counts.recorded, counts.first)
            motion.add(trajectory)
            left = residuals.of(lengths, trajectory.poses)
            reported = reported or _tells(left)
            of_cables.add(trajectory.time_s, left, counts.first)
            # what waits to be written is memory too
            rec.flush()

        yield add
        _log_notes(rec, rig, [*motion.end(), *([] if reported else [message("view.no_residuals")])])
        rec.send_blueprint(_blueprint(rig, 1, trajectory=True, residuals=reported), make_active=True, make_default=True)


@contextmanager
def _recording_of(rig: Rig, path: Path) -> Iterator[rr.RecordingStream]:
    """A recording that shows the rig."""
    with recording(Path(path), f"lmeasure {rig.name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        log_rig(rec, rig, "/world/rig", PLAIN, labelled=True)
        yield rec


GRID_M, FAINT = 0.5, (120, 120, 120, 60)
"""Lines of the floor, which lies under the lowest observation point: half a metre apart."""
ROUNDING_MM = 1e-6


def _tells(residuals: FloatArray) -> bool:
    """Whether residuals are more than what the solver's rounding leaves."""
    known = np.abs(residuals[np.isfinite(residuals)])
    return bool(len(known)) and float(known.max()) > ROUNDING_MM


def _counts_series(rec: rr.RecordingStream, counts: Counts, passage: int) -> CableSeries:
    return CableSeries(rec, ("counts", f"pass{passage}"), counts.channels)


def _residual_series(rec: rr.RecordingStream, rig: Rig) -> CableSeries:
    return CableSeries(rec, ("residual_mm",), [c.name for c in rig.cable])


def write_counts_recording(path: Path, rig: Rig, counts: Sequence[Path]) -> None:
    """Write the counts of the passes there are as yet, from their files, as one .rrd; raises what `write_recording` raises."""
    passes = tuple(read_counts(file) for file in counts)
    # counts alone need no start pose
    write_recording(path, rig, run=Run(rig, None, passes))


def _log_notes(rec: rr.RecordingStream, rig: Rig, lines: Sequence[str]) -> None:
    """The page beside the pictures."""
    head = [f"# {rig.name}", "", shown(message("view.head")), ""]
    assumed = [message("view.assumed", names=tuple(rig.assumed))] if rig.assumed else []
    text = "\n".join([*head, *(f"- {signs(shown(line))}" for line in [*lines, *assumed])]) + "\n"
    rec.log("/notes", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _blueprint(
    rig: Rig, passes: int, *, trajectory: bool, residuals: bool = False, record: bool = False, zone: bool = False, errors: bool = False
) -> rrb.Blueprint:
    """Space on the left, seen from outside the rig; the plots of what there is on the right; the notes under them."""

    def plot(name: str, origin: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.Corner2D.LeftTop)

    points = metres(np.array([p.position_mm for p in rig.observation_point]))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    size = max(float(np.ptp(points, axis=0).max()), 0.5)
    floor = rr.components.Plane3D((0.0, 0.0, 1.0), float(min(points[:, 2].min(), 0.0)))
    eye = rrb.EyeControls3D(position=middle + size * np.array([0.75, -0.9, 0.5]), look_target=middle, eye_up=(0, 0, 1))

    def space(name: str, contents: Sequence[str]) -> rrb.Spatial3DView:
        return rrb.Spatial3DView(
            name=name,
            origin="/world",
            contents=contents,
            eye_controls=eye,
            overrides={"/world/zone/outside": rrb.EntityBehavior(visible=False)},
            line_grid=rrb.LineGrid3D(visible=True, spacing=GRID_M, plane=floor, color=FAINT, stroke_width=1.0),
        )

    # a zone is full of nodes: it has a view of its own, or hides the gripper
    moving = trajectory or passes > 0 or record
    spaces = [space(named("rig"), ["$origin/**", "- $origin/zone/**"])] if moving or not zone else []
    spaces += [space(named("zone"), ["$origin/**"])] if zone else []
    pages: list[rrb.Vertical] = []
    if trajectory:
        motion: list[rrb.View] = [plot(named("position"), "/position_mm"), plot(named("pressure_angle"), "/worst_pressure_angle_deg")]
        if residuals:
            motion.append(plot(named("residuals"), "/residual_mm"))
        motion.append(rrb.StateTimelineView(name=named("status"), origin="/status_lane"))
        spread: list[rrb.View] = [plot(named("errors"), "/errors")] if errors else []
        spread += [plot(named("u_position"), "/u_position_mm"), plot(named("u_rotation"), "/u_rotation_rad")]
        pages += [
            rrb.Vertical(*motion, name=named("motion"), row_shares=[2] * (len(motion) - 1) + [1]),
            rrb.Vertical(*spread, name=named("uncertainty")),
        ]
    if passes:
        plots = [plot(named("counts_pass", number=i), f"/counts/pass{i}") for i in range(1, passes + 1)]
        pages.append(rrb.Vertical(*plots, name=named("counts")))
    if record:
        of_poses = plot(named("calibration_residuals"), "/calibration_residual_mm")
        pages.append(rrb.Vertical(of_poses, name=named("calibration")))
    text: list[rrb.View] = [rrb.TextDocumentView(name=named("notes"), origin="/notes")]
    if trajectory:
        text.append(rrb.TextLogView(name=named("status"), origin="/status"))
    right = rrb.Vertical(rrb.Tabs(*pages), rrb.Tabs(*text), row_shares=[3, 1]) if pages else rrb.Tabs(*text)
    timeline = "time" if passes or trajectory else "pose"
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Tabs(*spaces), right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=timeline),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


@contextmanager
def growing_counts(path: Path, channels: tuple[str, ...], passage: int = 1) -> Iterator[Callable[[Samples], None]]:
    """A function that appends samples, their times from the first one [s], to the .rrd at path; what it holds can be read at any moment.

    The counts stand where `write_recording` puts those of the pass. LMeasureError when the file cannot be written.
    """
    rec = rr.RecordingStream("lmeasure")
    try:
        rec.save(path)
        series = CableSeries(rec, ("counts", f"pass{passage}"), channels)
    except RuntimeError as error:
        raise LMeasureError(message("error.cannot_be_written_2", where=path, error=error)) from error
    given = 0

    def append(samples: Samples) -> None:
        nonlocal given
        series.add(samples.time_s, samples.recorded, given)
        given += len(samples.time_s)
        rec.flush()

    try:
        yield append
    finally:
        rec.disconnect()
