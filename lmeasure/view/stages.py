"""Stages put together: one recording, its notes and its blueprint.

Known poses and a calibration's record have plots and notes of their own.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import xarray as xr

from lmeasure.accuracy import stated_radii_95
from lmeasure.acquisition import Samples
from lmeasure.core import WORDS, FloatArray, IntArray, LMeasureError, Status, se3
from lmeasure.linkages import LINKS, incidence
from lmeasure.recording import Counts, Poses, Run, RunHead, read_counts
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.robots import ParallelFile, mechanism_outline, motion, nearness
from lmeasure.sensors import LengthResiduals, Lengths, length_residuals
from lmeasure.structure import Linkage, described_lines
from lmeasure.text import message, signs
from lmeasure.trajectory import Each, Trajectory, align
from lmeasure.view.recording import (
    CABLE,
    GREY,
    MAX_FRAMES,
    MAX_PATH_POINTS,
    PLAIN,
    THICK,
    TRUTH_COLOUR,
    CableSeries,
    Thinned,
    cable_colour,
    changed_rows,
    draw_frames,
    draw_shaded_path,
    entity_path,
    indexes_at,
    log_path,
    log_reference,
    log_rig,
    log_zone,
    metres,
    named,
    recording,
    send_measurements,
    send_scalars,
    send_tool,
    shown,
    thinned_note,
    time_indexes,
)

GOOD, BAD = (0, 130, 95), (213, 94, 0)
PLACE = ("x_mm", "y_mm", "z_mm")
SERIES = {"u_position_mm": ("u_x_mm", "u_y_mm", "u_z_mm"), "u_rotation_rad": ("u_rx_rad", "u_ry_rad", "u_rz_rad")}


def log_trajectory(rec: rr.RecordingStream, rig: Rig, trajectory: Trajectory, errors: Mapping[str, FloatArray]) -> list[str]:
    """Draw a whole trajectory; return notes for the reader."""
    log = TrajectoryLog(rec, rig)
    log.add(trajectory)
    indexes = time_indexes(trajectory.time_s)
    columns = trajectory.columns()
    for name, values in errors.items():
        if f"u_{name}" in columns:
            send_measurements(rec, entity_path("errors", name), indexes, values, u=columns[f"u_{name}"])
        else:
            send_scalars(rec, entity_path("errors", name), indexes, values)
    return log.end()


class TrajectoryLog:
    """A trajectory on its way into a recording: give it one piece after the other, then end it.

    Tool, scalars and statuses go out with their piece; of the poses only those are held at which cables and the path are drawn: a few
    thousand and those where the status changes.
    """

    def __init__(self, rec: rr.RecordingStream, rig: Rig) -> None:
        self._rec, self._rig = rec, rig
        self._frames = Thinned(MAX_FRAMES, 8)  # time and pose
        self._path = Thinned(MAX_PATH_POINTS, 5)  # place, whether it is known, its 95 % radius
        self._statuses = _Statuses(rec)
        # until a pose is known
        self._place_only = len({c.to_point for c in rig.cable}) == 1
        self._covers = ""
        self._notes: dict[str, None] = {}

    def add(self, piece: Trajectory) -> None:
        """Take the next samples."""
        rec, first = self._rec, self._frames.seen
        indexes = time_indexes(piece.time_s, first)
        known = ~np.isnan(piece.poses[:, 0])
        if known.any():
            self._place_only = bool(np.isnan(piece.poses[known, 3]).all())
        send_tool(rec, indexes, piece.poses, place_only=self._place_only)
        send_scalars(rec, "/worst_pressure_angle_deg", indexes, piece.worst_pressure_angle_deg)
        columns = piece.columns()
        for name in PLACE:
            send_measurements(rec, f"/position_mm/{name}", indexes, columns[name], u=columns[f"u_{name}"])
        for group, names in SERIES.items():
            for name in names:
                send_scalars(rec, f"/{group}/{name}", indexes, columns[name])
        changes = self._statuses.add(piece, first)
        self._frames.add(np.column_stack([piece.time_s, piece.poses]), changes)
        ok = piece.status == Status.OK
        before = self._path.rows[-1, 3] if len(self._path) else None
        radii = stated_radii_95((piece.random + piece.systematic)[:, 3:, 3:])
        self._path.add(np.column_stack([piece.poses[:, :3], ok, radii]), changed_rows(ok, before))
        self._covers = piece.covers
        self._notes |= dict.fromkeys(piece.notes)

    def end(self) -> list[str]:
        """Draw the parts over the whole run; return notes for the reader."""
        self._statuses.end(self._frames.seen)
        frames, path = self._frames, self._path
        for i in range(0, len(frames), MAX_FRAMES):
            part = slice(i, i + MAX_FRAMES)
            indexes = indexes_at(frames.rows[part, 0], frames.numbers[part])
            draw_frames(self._rec, self._rig, indexes, frames.rows[part, 1:], place_only=self._place_only, looks=i == 0)
        notes = [message("trajectory.uncertainties", covers=self._covers), *self._notes, *thinned_note(frames)]
        return notes + draw_shaded_path(self._rec, "/world/path", path)


@dataclass
class _Stretch:
    """Samples of one status, from the first on."""

    first: int
    time_s: float
    status: int
    cause: str
    cable: str

    def text(self, last: int) -> str:
        detail = f": {self.cause}" * bool(self.cause) + f", cable {self.cable}" * bool(self.cable)
        return f"samples {self.first} to {last}: {WORDS[self.status]}{detail}"


class _Statuses:
    """Statuses as a log and a lane. A stretch of samples is sent when its end is known."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec = rec
        self._open: _Stretch | None = None
        shades = [GOOD if status == Status.OK else BAD for status in Status]
        rec.log("/status_lane", rr.StateConfiguration(values=WORDS, colors=shades), static=True)

    def add(self, piece: Trajectory, first: int) -> IntArray:
        """Take the next samples, first: index of the first one; return the rows of changes."""
        was = self._open
        causes = piece.cause
        columns = (piece.status, was and was.status), (causes, was and was.cause), (piece.cable, was and was.cable)
        rows = np.unique(np.concatenate([changed_rows(values, before) for values, before in columns]))
        begun = [_Stretch(first + i, float(piece.time_s[i]), int(piece.status[i]), causes[i], str(piece.cable[i])) for i in rows.tolist()]
        stretches = [was, *begun] if was is not None else begun
        self._say(stretches[:-1], [s.first - 1 for s in stretches[1:]])
        self._open = stretches[-1]
        return rows

    def end(self, samples: int) -> None:
        """The run has that many samples."""
        if self._open is not None:
            self._say([self._open], [samples - 1])

    def _say(self, stretches: list[_Stretch], last: list[int]) -> None:
        if not stretches:
            return
        at = indexes_at(np.array([s.time_s for s in stretches]), np.array([s.first for s in stretches]))
        texts = [s.text(i) for s, i in zip(stretches, last, strict=True)]
        levels = ["INFO" if s.status == Status.OK else "WARN" for s in stretches]
        self._rec.send_columns("/status", at, rr.TextLog.columns(text=texts, level=levels))
        self._rec.send_columns("/status_lane", at, rr.StateChange.columns(state=[WORDS[s.status] for s in stretches]))


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
    """Write the results of the stages as one .rrd, whole or not at all, with a blueprint that opens it.

    run: counts, and with a trajectory the residual of each cable; truth (k, 7) known poses [mm, unit quaternions], which without a
    trajectory are those of the run's samples and move the picture; errors: (n,) columns on the trajectory's samples, names with units;
    nominal: the rig before calibration; reference and record: poses and result of a calibration; zone: dataset of the contract's netCDF.
    LMeasureError if the file cannot be written.
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
    """Yield a function that takes a run of one pass piece by piece (counts, lengths, trajectory) into the .rrd at path.

    At the end of the block the file is complete, with the content of `write_recording` for the whole run; if the block fails there is none.
    Raises the errors of `write_recording`.
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
            # unwritten data use memory too
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
    """Return whether residuals exceed the solver's rounding."""
    known = np.abs(residuals[np.isfinite(residuals)])
    return bool(len(known)) and float(known.max()) > ROUNDING_MM


def _counts_series(rec: rr.RecordingStream, counts: Counts, passage: int) -> CableSeries:
    return CableSeries(rec, ("counts", f"pass{passage}"), counts.channels)


def _residual_series(rec: rr.RecordingStream, rig: Rig) -> CableSeries:
    return CableSeries(rec, ("residual_mm",), [c.name for c in rig.cable])


def write_counts_recording(path: Path, rig: Rig, counts: Sequence[Path]) -> None:
    """Write the counts of the passes so far, from their files, as one .rrd; raises the errors of `write_recording`."""
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
    """Return the layout: space on the left, seen from outside the rig; plots on the right; notes under them."""

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
    """Yield a function that appends samples, their times from the first one [s], to the .rrd at path, which can be read at any moment.

    The counts have the place of the pass in `write_recording`. LMeasureError if the file cannot be written.
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


PLATFORM, BOUNDARY, LEAST = (86, 150, 255), (120, 220, 120), (190, 120, 255)
FACES = np.array([(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)], dtype=np.uint32)
MEASURES = {"determinant": "determinant", "mm_per_mm": "rim", "worst_pressure_angle_deg": "pressure_angle"}


def write_structure_recording(path: Path, name: str, linkage: Linkage, record: dict[str, Any], *, pose: FloatArray | None) -> None:
    """Write links and their record (`structure.record.described`) as one .rrd; timeline `assembly`: 0 is the pose, and those of the lengths
    behind it; timeline `way`: per mille of the way."""
    with recording(Path(path), f"lmeasure structure {name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        labels = [point for _, point, _ in linkage.names]
        rec.log("/world/base", rr.Points3D(metres(linkage.base), radii=THICK, colors=PLAIN, labels=labels), static=True)
        poses = [] if pose is None else [(0, pose)]
        for i, one in enumerate(record.get("assemblies", []), 1):
            poses.append((i, np.array([*one["position_mm"], *one["quaternion_xyzw"]])))
        for number, at in poses:
            rec.set_time("assembly", sequence=number)
            _log_platform(rec, linkage, at)
            _log_tetrahedra(rec, linkage, at)
        rec.reset_time()
        if "least_seen_screw" in record and pose is not None:
            screw, size = record["least_seen_screw"], float(np.ptp(linkage.base, axis=0).max()) / 2.0
            way = size * np.array(screw["direction"])
            foot = np.array(screw["point_mm"])
            rec.log(
                "/world/screw_seen_least",
                rr.Arrows3D(origins=metres(foot - way / 2.0), vectors=metres(way), colors=LEAST, radii=THICK),
                static=True,
            )
        for k, piece in enumerate(record.get("boundary", {}).get("slices", [])):
            places = np.array(piece["places_mm"])
            strip = np.vstack([places, places[:1]]) if piece["closed"] else places
            rec.log(f"/world/boundary/{k}", rr.LineStrips3D([metres(strip)], colors=BOUNDARY, radii=CABLE), static=True)
        if "way" in record:
            _log_way(rec, linkage, record["way"])
        lines = "\n".join(f"- {shown(line).strip()}" for line in described_lines(record))
        rec.log("/notes", rr.TextDocument(f"# {name}\n\n{lines}\n", media_type=rr.MediaType.MARKDOWN), static=True)
        rec.send_blueprint(_structure_blueprint("way" in record), make_active=True, make_default=True)


def _log_platform(rec: rr.RecordingStream, linkage: Linkage, pose: FloatArray) -> None:
    points = se3.apply(pose, linkage.platform)
    outline = metres(np.vstack([np.unique(points, axis=0), points[:1]]))
    rec.log("/world/platform", rr.LineStrips3D([outline], colors=PLATFORM, radii=THICK))
    rec.log("/world/platform/points", rr.Points3D(metres(points), radii=THICK, colors=PLATFORM, labels=[p for _, _, p in linkage.names]))
    strips = metres(linkage.strips(pose))
    rec.log("/world/links", rr.LineStrips3D(list(strips), colors=[cable_colour(i) for i in range(len(strips))], radii=CABLE))


def _log_tetrahedra(rec: rr.RecordingStream, linkage: Linkage, pose: FloatArray) -> None:
    """Draw the tetrahedra that give the assemblies, if any."""
    if len(linkage.base) != LINKS:
        return
    found = incidence(linkage.base, linkage.platform)
    place: dict[tuple[str, int], FloatArray] = {}
    for number, (p, b) in zip(found.order, found.structure.links, strict=True):
        place["P", p], place["B", b] = se3.apply(pose, linkage.platform[number]), linkage.base[number]
    for n, (side, i, corners) in enumerate(found.structure.placements or (), 1):
        points = np.array([place[side, i], *(place[c] for c in corners)])
        colour = (*cable_colour(n), 60)
        mesh = rr.Mesh3D(vertex_positions=metres(points), triangle_indices=FACES, albedo_factor=colour)
        rec.log(f"/world/tetrahedra/{n}", mesh)


def _log_way(rec: rr.RecordingStream, linkage: Linkage, way: dict[str, Any]) -> None:
    rec.log("/world/way", rr.LineStrips3D([metres(np.array(way["position_mm"]))], colors=GREY, radii=CABLE), static=True)
    for key in MEASURES:
        for share, value in zip(way["share"], way[key], strict=True):
            if value is not None:
                rec.set_time("way", sequence=round(1000.0 * share))
                rec.log(f"/way/{key}", rr.Scalars(value))
    rec.reset_time()


def _structure_blueprint(way: bool) -> rrb.Blueprint:
    space: rrb.View = rrb.Spatial3DView(name=named("structure"), origin="/world", line_grid=rrb.LineGrid3D(visible=False))
    notes: rrb.View = rrb.TextDocumentView(name=named("notes"), origin="/notes")
    right: list[rrb.View] = [rrb.TimeSeriesView(name=named(name), origin=f"/way/{key}") for key, name in MEASURES.items()] if way else []
    return rrb.Blueprint(rrb.Horizontal(space, rrb.Vertical(*right, notes), column_shares=[3, 2]), rrb.TimePanel(state="expanded"))


ARM, LEG = (124, 58, 237), (234, 120, 60)


def write_mechanism_recording(path: Path, file: ParallelFile) -> None:
    """Write the motion as one .rrd; timeline `step`."""
    robot = file.model
    poses, joints = motion(file)
    near = nearness(robot.jacobians(poses, joints).output, robot.units)
    with recording(Path(path), f"lmeasure mechanism {file.name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rec.log(
            "/world/base",
            rr.LineStrips3D([metres(s) for s in mechanism_outline(file, robot.home).base], colors=GREY, radii=CABLE),
            static=True,
        )
        for step, (pose, q) in enumerate(zip(poses, joints, strict=True)):
            rec.set_time("step", sequence=step)
            at = mechanism_outline(file, pose)
            rec.log("/world/legs", rr.LineStrips3D([metres(s) for s in at.legs], colors=LEG, radii=CABLE))
            if at.arms:
                rec.log("/world/arms", rr.LineStrips3D([metres(s) for s in at.arms], colors=ARM, radii=THICK))
            rec.log("/world/platform", rr.LineStrips3D([metres(at.platform)], colors=PLATFORM, radii=THICK))
            for name, slides, value in zip(robot.joint_names, robot.sliding, q, strict=True):
                unit = "mm" if slides else "deg"
                rec.log(f"/joints/{unit}/{name}", rr.Scalars(float(value if slides else np.degrees(value))))
            rec.log("/nearness", rr.Scalars(float(near[step])))
        rec.reset_time()
        space = rrb.Spatial3DView(name=file.name, origin="/world", line_grid=rrb.LineGrid3D(visible=False))
        units = dict.fromkeys("mm" if slides else "deg" for slides in robot.sliding)
        views: list[rrb.View] = [rrb.TimeSeriesView(name=named("joints", unit=unit), origin=f"/joints/{unit}") for unit in units]
        views.append(rrb.TimeSeriesView(name=named("nearness"), origin="/nearness"))
        layout = rrb.Horizontal(space, rrb.Vertical(*views), column_shares=[3, 2])
        rec.send_blueprint(rrb.Blueprint(layout, rrb.TimePanel(state="expanded")), make_active=True, make_default=True)
