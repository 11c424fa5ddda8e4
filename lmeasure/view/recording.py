"""One .rrd file, written whole, and the indexes of its columns."""

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import xarray as xr
from numpy.typing import NDArray

from lmeasure.accuracy import zone_surface
from lmeasure.core import BoolArray, FileFormatError, FloatArray, IntArray, LMeasureError, pasted
from lmeasure.io import files, open_regular, os_reason
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, GUIDE_XYZ, RADIUS, wrap_geometry
from lmeasure.recording import Poses
from lmeasure.rig import Rig
from lmeasure.text import Message, message, of_terminal

# `python -m rerun_cli` would lose the exit code
RERUN = (sys.executable, "-c", "import sys, rerun_cli.__main__ as r; sys.exit(r.main())")


def check_recording(path: Path, name: Path | None = None) -> None:
    """FileFormatError (naming `name`, default the path) unless the file is a whole .rrd that this version of rerun reads."""
    from rerun.chunk import RrdReader

    name = name or path
    open_regular(path).close()
    try:
        with warnings.catch_warnings():
            # a file that was cut off is only warned about
            warnings.simplefilter("error")
            RrdReader(path).store()
    except OSError as error:
        raise FileFormatError(message("error.cannot_be_read", where=name, broken=os_reason(error))) from error
    except (RuntimeError, ValueError, Warning) as error:
        raise FileFormatError(message("error.is_not_a_whole", where=name)) from error


def open_viewer(path: Path) -> None:
    """Open a recording in rerun's viewer and wait until that is closed; LMeasureError without a recording or a display."""
    check_recording(path)
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise LMeasureError(message("error.cannot_be_shown_there", where=path, path=pasted(path)))
    # the viewer also listens for other programs' recordings: on this machine only
    code = subprocess.run([*RERUN, str(Path(path).resolve()), "--bind", "127.0.0.1"], check=False).returncode
    if code != 0:
        raise LMeasureError(message("error.the_rerun_viewer_ended", where=path, value=code))


Colour = tuple[int, int, int]

LAST_TIME_S = 9e9  # rerun counts nanoseconds in 64 bits
# Okabe and Ito: distinguished by colour-blind readers too
CABLE_COLOURS: tuple[Colour, ...] = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)


@contextmanager
def recording(path: Path, name: str) -> Iterator[rr.RecordingStream]:
    """A stream into a temporary file that becomes `path` once it can be read back."""
    if path.suffix.lower() != ".rrd":
        raise FileFormatError(message("error.the_name_must_end_in_rrd", where=path))
    with files.whole(path) as temporary:
        rec = rr.RecordingStream("lmeasure")
        if not rr.is_enabled(rec):
            raise LMeasureError(message("error.the_environment_variable_rerun", where=path))
        _room(temporary)  # without any, rerun may wait for ever
        temporary.unlink()
        try:
            rec.save(temporary)
            rec.send_recording_name(name)
            yield rec
            rec.flush()
        except RuntimeError as error:
            _room(temporary)  # rerun does not report a full disk
            raise LMeasureError(message("error.cannot_be_written_2", where=path, error=error)) from error
        finally:
            rec.disconnect()
        check_recording(temporary, path)


def _room(path: Path) -> None:
    """OSError where the file cannot grow; it is left as one that cannot be used."""
    with path.open("ab") as file:
        file.write(bytes(1 << 16))


def shown(line: str) -> str:
    """Return a line in the language of the terminal."""
    return line.text(of_terminal()) if isinstance(line, Message) else line


def named(name: str, /, **values: object) -> str:
    """Return the name of a part of a recording in the language of the terminal."""
    return message(f"view.name.{name}", **values).text(of_terminal())


def entity_path(*parts: str) -> str:
    """Return an entity path whose last parts are names from files: each stays one part whatever it contains."""
    return rr.new_entity_path(list(parts))


def indexes_at(time_s: FloatArray, samples: IntArray) -> list[rr.TimeColumn]:
    """Indexes of samples: their time to the nearest nanosecond and their number."""
    if np.abs(time_s).max() > LAST_TIME_S:
        raise LMeasureError(message("error.time_s_a_recording", time_s=time_s[np.argmax(np.abs(time_s))], last_time_s=LAST_TIME_S))
    return [rr.TimeColumn("time", duration=np.rint(time_s * 1e9).astype("timedelta64[ns]")), rr.TimeColumn("sample", sequence=samples)]


def time_indexes(time_s: FloatArray, first: int = 0) -> list[rr.TimeColumn]:
    """Indexes of samples that follow each other, from the number of the first one on."""
    return indexes_at(time_s, first + np.arange(len(time_s)))


def send_scalars(rec: rr.RecordingStream, entity: str, indexes: Sequence[rr.TimeColumn], values: FloatArray) -> None:
    rec.send_columns(entity, indexes, rr.Scalars.columns(scalars=np.ascontiguousarray(values, dtype=np.float64)))


def send_measurements(rec: rr.RecordingStream, entity: str, indexes: Sequence[rr.TimeColumn], values: FloatArray, *, u: FloatArray) -> None:
    """Send values with their standard uncertainties: a plot draws a line and a band of one standard uncertainty to each side."""
    columns = rr.Measurements.columns(values=np.ascontiguousarray(values, dtype=np.float64), variances=np.square(u, dtype=np.float64))
    rec.send_columns(entity, indexes, columns)


def cable_colour(cable: int) -> Colour:
    return CABLE_COLOURS[cable % len(CABLE_COLOURS)]


class CableSeries:
    """A figure of every cable or channel over time, given for one piece of a run after the other."""

    def __init__(self, rec: rr.RecordingStream, parents: Sequence[str], names: Sequence[str]) -> None:
        self._rec, self._entities = rec, [entity_path(*parents, name) for name in names]
        for j, (entity, name) in enumerate(zip(self._entities, names, strict=True)):
            rec.log(entity, rr.SeriesLines(colors=cable_colour(j), names=name), static=True)

    def add(self, time_s: FloatArray, values: FloatArray, first: int = 0) -> None:
        """Send (n, names) values at times (n,) of samples; first: index of the first one."""
        indexes = time_indexes(time_s, first)
        for entity, column in zip(self._entities, values.T, strict=True):
            send_scalars(self._rec, entity, indexes, column)


def changed_rows(values: NDArray[np.generic], before: object = None) -> IntArray:
    """Rows at which a value differs from the row before, which to the first row is `before`; None: the first row is one of them."""
    later = np.flatnonzero(values[1:] != values[:-1]) + 1
    new = before is None or values[0] != before
    return np.concatenate([[0], later] if new else [later]).astype(np.int64)


class Thinned:
    """The first row of all and others at equal steps, about `limit` of them, the last, and every row that must be kept.

    Rows that come in one piece give at most the limit, in pieces up to twice as many: the step doubles as they become more. Only those
    rows are held.
    """

    def __init__(self, limit: int, width: int) -> None:
        self._limit, self._step = limit, 1
        self.seen = 0
        """Rows that were given."""
        self.numbers: IntArray = np.empty(0, np.int64)
        """(k,) numbers of the rows that are held, from 0."""
        self.rows: FloatArray = np.empty((0, width))
        """(k, width) those rows."""
        self._keep = np.empty(0, np.bool_)

    def __len__(self) -> int:
        return len(self.numbers)

    def add(self, rows: FloatArray, keep: IntArray) -> None:
        """Take the next rows (n, width), of which those at the indices `keep` must stay."""
        n = len(rows)
        if self.seen == 0:
            self._step = -(-n // self._limit)
        while self.seen + n > 2 * self._limit * self._step:
            self._step *= 2
        chosen = np.union1d(np.arange(-self.seen % self._step, n, self._step), np.append(keep, n - 1)).astype(np.int64)
        numbers = np.concatenate([self.numbers, self.seen + chosen])
        must: BoolArray = np.concatenate([self._keep, np.isin(chosen, keep)])
        self.seen += n
        stay = must | (numbers % self._step == 0) | (numbers == self.seen - 1)
        self.numbers, self._keep = numbers[stay], must[stay]
        self.rows = np.concatenate([self.rows, rows[chosen]])[stay]


MAX_FRAMES = 3000  # pictures of the cables: a run of a minute at fifty a second
MAX_PATH_POINTS = 20000
SHADES = 16  # of a way, by its 95 % radius
# thicknesses in pixels stay visible at any distance
CABLE, THIN, THICK = rr.Radius.ui_points(1.2), rr.Radius.ui_points(0.8), rr.Radius.ui_points(2.0)
SAGITTA_MM = 0.5
"""Largest distance of a drawn arc from the true one: less than a pixel of a screen that the rig fills."""

GREY, TRUTH_COLOUR = (130, 130, 130), (120, 220, 120)
PLAIN = (118, 124, 138)
"""Seen before the viewer's light ground and its dark one, and names in it too."""
# the 95 % radius, or without it the worst pressure angle: teal to yellow, on to red
ZONE_COLOURS = ((33, 145, 140), (253, 231, 37), (170, 20, 30))
SKIN = (33, 145, 140, 70)


def metres(values_mm: FloatArray) -> NDArray[np.float32]:
    """Millimetres as rerun keeps lengths."""
    return (1e-3 * values_mm).astype(np.float32)


def log_rig(rec: rr.RecordingStream, rig: Rig, root: str, colour: Colour, *, labelled: bool) -> None:
    """Observation points, and the last stretch of each guide: the cable comes to B along it."""
    names = [p.name for p in rig.observation_point]
    at = metres(np.array([p.position_mm for p in rig.observation_point]))
    along = {c.from_point: row[GUIDE_XYZ] for c, row in zip(rig.cable, rig.cable_rows(), strict=True)}
    used = [i for i, name in enumerate(names) if name in along]
    way = 0.15 * np.array([along[names[i]] for i in used])
    rec.log(f"{root}/observation_points", rr.Points3D(at, radii=0.012, colors=colour, labels=names, show_labels=labelled), static=True)
    rec.log(f"{root}/guides", rr.Arrows3D(vectors=way, origins=at[used] - way, radii=0.003, colors=colour), static=True)


def _arcs(centres: FloatArray, bases: FloatArray, along: FloatArray, angles: FloatArray, points: int) -> FloatArray:
    """(n, m, points, 3) arcs about (n, m, 3) pulley centres, from B through (n, m) angles; B (m, 3) and R u (m, 3), all in one unit."""
    outward = centres - bases
    turn = (angles[..., None] * np.linspace(0.0, 1.0, points))[..., None]
    return np.asarray(centres[..., None, :] + np.sin(turn) * along[:, None, :] - np.cos(turn) * outward[..., None, :])


def _points(rows: FloatArray, angle: float) -> int:
    """Return how many points an arc through that angle [rad] about the largest pulley of the rows needs."""
    step = 2.0 * np.arccos(1.0 - min(SAGITTA_MM / max(rows[:, RADIUS].max(), SAGITTA_MM), 0.5))
    return max(int(np.ceil(angle / step)), 1) + 1


def send_tool(rec: rr.RecordingStream, indexes: Sequence[rr.TimeColumn], poses: FloatArray, *, place_only: bool) -> None:
    """Tool at (n, 7) poses [mm]; a pose of NaN shows nothing.

    place_only: no orientation was measured, a pose is the place of the attachment point that all cables lead to.
    """
    ok = ~np.isnan(poses[:, 0])
    each = ok.astype(np.int64)
    if place_only:
        rec.send_columns("/world/tool", indexes, rr.Points3D.columns(positions=metres(poses[ok, :3])).partition(each))
        return
    tool = rr.Transform3D.columns(translation=metres(poses[ok, :3]), quaternion=poses[ok, 3:])
    rec.send_columns("/world/tool", indexes, tool.partition(each))
    rec.send_columns("/world/tool", indexes, rr.TransformAxes3D.columns(axis_length=np.full(ok.sum(), 0.1)).partition(each))


def draw_frames(
    rec: rr.RecordingStream, rig: Rig, indexes: Sequence[rr.TimeColumn], poses: FloatArray, *, place_only: bool, looks: bool = True
) -> None:
    """Draw cables, pulleys and platform at (n, 7) poses as in `send_tool`; with the looks of all moving parts, once."""
    shown = (~np.isnan(poses[:, 0])).astype(np.int64)
    poses = poses[shown == 1]
    rows = rig.cable_rows()
    if place_only:
        rows[:, ATTACHMENT_XYZ] = 0.0
        poses = np.column_stack([poses[:, :3], np.tile((0.0, 0.0, 0.0, 1.0), (len(poses), 1))])
    if looks:
        _log_looks(rec, rig, place_only=place_only)
    centre, tangent, attachment, angle = wrap_geometry(rows, poses)
    along = rows[:, RADIUS, None] * rows[:, GUIDE_XYZ]
    wrapped = _arcs(centre, rows[:, BASE_XYZ], along, angle, _points(rows, angle.max(initial=0.0)))
    cables = metres(np.concatenate([wrapped, attachment[:, :, None, :]], axis=2))
    for j, c in enumerate(rig.cable):
        strips = rr.LineStrips3D.columns(strips=cables[:, j]).partition(shown)
        rec.send_columns(entity_path("world", "cables", c.name), indexes, strips)
    circles = metres(_arcs(centre, rows[:, BASE_XYZ], along, np.full(angle.shape, 2 * np.pi), _points(rows, 2 * np.pi)))
    m = len(rig.cable)
    strips = rr.LineStrips3D.columns(strips=circles.reshape(-1, *circles.shape[2:]))
    rec.send_columns("/world/pulleys", indexes, strips.partition(m * shown))
    points = rr.Points3D.columns(positions=metres(tangent.reshape(-1, 3)))
    rec.send_columns("/world/tangent_points", indexes, points.partition(m * shown))
    # the platform: through the attachment points in the order of the cables, each once
    corners = list({c.to_point: j for j, c in enumerate(rig.cable)}.values())
    outline = metres(attachment[:, [*corners, corners[0]]])
    rec.send_columns("/world/platform", indexes, rr.LineStrips3D.columns(strips=outline).partition(shown))


def _log_looks(rec: rr.RecordingStream, rig: Rig, *, place_only: bool) -> None:
    """Send colours and thicknesses of moving parts."""
    if place_only:
        rec.log("/world/tool", rr.Points3D.from_fields(colors=PLAIN, radii=THICK), static=True)
    for j, c in enumerate(rig.cable):
        rec.log(entity_path("world", "cables", c.name), rr.LineStrips3D.from_fields(colors=cable_colour(j), radii=CABLE), static=True)
    rec.log("/world/pulleys", rr.LineStrips3D.from_fields(colors=PLAIN, radii=THIN), static=True)
    rec.log("/world/tangent_points", rr.Points3D.from_fields(colors=PLAIN, radii=THICK), static=True)
    rec.log("/world/platform", rr.LineStrips3D.from_fields(colors=PLAIN, radii=THICK), static=True)


def thinned_note(frames: Thinned) -> list[str]:
    """Return the messages about frames that are fewer than the samples."""
    text = message("view.frames", drawn=len(frames), samples=frames.seen)
    return [text] if len(frames) < frames.seen else []


def log_path(rec: rr.RecordingStream, entity: str, poses: FloatArray, colour: Colour) -> list[str]:
    """The whole way of the tool origin along (n, 7) known poses [mm]."""
    path = Thinned(MAX_PATH_POINTS, 4)
    path.add(np.column_stack([poses[:, :3], np.ones(len(poses))]), np.zeros(1, np.int64))
    return draw_path(rec, entity, path, colour)


def draw_path(rec: rr.RecordingStream, entity: str, path: Thinned, colour: Colour) -> list[str]:
    """The way of the tool origin through rows of its place [mm] and 1, or 0 where it is not known: there it is broken."""
    strips = [metres(part[:, :3]) for part in np.split(path.rows, changed_rows(path.rows[:, 3])[1:]) if part[0, 3] and len(part) > 1]
    rec.log(entity, rr.LineStrips3D(strips, colors=colour, radii=THIN), static=True)
    return [message("view.line", entity=entity, drawn=len(path), samples=path.seen)] if len(path) < path.seen else []


def draw_shaded_path(rec: rr.RecordingStream, entity: str, path: Thinned) -> list[str]:
    """Draw the same in the colours of U95, from rows of position [mm], whether it is known, and that radius [mm], NaN without a statement:
    a strip for each colour, which begins at the end of the one before."""
    radius = path.rows[:, 4]
    stated = (path.rows[:, 3] > 0.0) & np.isfinite(radius) & (radius > 0.0)
    if not stated.any():
        return draw_path(rec, entity, path, PLAIN)
    low, middle, top = np.log10(np.percentile(radius[stated], (0, 50, 95)))
    shade = np.full(len(radius), -1.0)
    shade[stated] = np.rint(np.interp(np.log10(radius[stated]), _rising(low, middle, top), (0.0, SHADES / 2, SHADES)))
    strips, colours = [], []
    for part in np.split(np.arange(len(path)), changed_rows(path.rows[:, 3])[1:]):
        if not path.rows[part[0], 3] or len(part) < 2:
            continue
        starts = changed_rows(shade[part])
        for begin, end in zip(starts, [*starts[1:], len(part) - 1], strict=True):
            if end > begin:
                strips.append(metres(path.rows[part[begin : end + 1], :3]))
                colours.append(_zone_colour(shade[part[begin]] / SHADES) if shade[part[begin]] >= 0.0 else PLAIN)
    rec.log(entity, rr.LineStrips3D(strips, colors=colours, radii=THICK), static=True)
    fewer = [message("view.line", entity=entity, drawn=len(path), samples=path.seen)] if len(path) < path.seen else []
    return [*fewer, _shades(entity, low, middle, top)]


def _shades(entity: str, *ends: float) -> Message:
    """Return the meaning of the colours: the logarithms of the least, the middle and the largest radius [mm]."""
    return message(
        "view.shades", entity=entity, **{name: float(10.0**end) for name, end in zip(("low", "middle", "top"), ends, strict=True)}
    )


def _rising(low: float, middle: float, top: float) -> tuple[float, float, float]:
    """The same, a little apart where they are one."""
    return low, max(middle, low + 1e-9), max(top, middle + 1e-9, low + 2e-9)


def _zone_colour(part: float) -> Colour:
    """Return the colour of a zone, from the first over the middle to the last."""
    red, green, blue = (int(np.interp(part, (0.0, 0.5, 1.0), channel)) for channel in zip(*ZONE_COLOURS, strict=True))
    return red, green, blue


def log_reference(rec: rr.RecordingStream, rig: Rig, reference: Poses) -> None:
    """Reference poses on their own timeline, and all of them as points."""
    index = [rr.TimeColumn("pose", sequence=np.arange(1, len(reference) + 1))]
    send_tool(rec, index, reference.rows, place_only=False)
    draw_frames(rec, rig, index, reference.rows, place_only=False)
    at = metres(reference.rows[:, :3])
    points = rr.Points3D(at, radii=0.006, colors=CABLE_COLOURS[1], labels=reference.names, show_labels=False)
    rec.log("/world/reference_poses", points, static=True)


def log_zone(rec: rr.RecordingStream, zone: xr.Dataset) -> list[str]:
    """Nodes of an accuracy zone as two clouds, with the angle kept beside each node, and its skin; nodes without an angle are not drawn."""
    angle = zone["worst_pressure_angle_deg"].transpose("x", "y", "z").to_numpy().astype(np.float64)
    inside = zone["in_zone"].transpose("x", "y", "z").to_numpy() == 1
    nodes = np.stack(np.meshgrid(*(zone[axis].to_numpy() for axis in "xyz"), indexing="ij"), axis=-1)
    limit = float(zone.attrs["limit_deg"])
    known = np.isfinite(angle)
    shade, middle, top, reported = angle, limit, 90.0, message("view.shades_angle", entity="/world/zone")
    if "u95_position_mm" in zone:
        u95 = zone["u95_position_mm"].transpose("x", "y", "z").to_numpy().astype(np.float64)
        ends = np.log10(np.percentile(u95[np.isfinite(u95) & (u95 > 0.0)], (0, 50, 95))) if np.isfinite(u95).any() else np.zeros(3)
        # logarithms, from the least on: few places would else take all the colours
        shade = np.log10(np.where(np.isfinite(u95) & (u95 > 0.0), u95, 10.0 ** ends[2])) - ends[0]
        middle, top = ends[1] - ends[0], max(ends[2] - ends[0], 1e-9)
        reported = _shades("/world/zone", *ends)
    for name, mask, radius in (("inside", inside & known, THICK), ("outside", ~inside & known, THIN)):
        values = angle[mask]
        shades = [np.interp(shade[mask], (0.0, middle, top), channel) for channel in zip(*ZONE_COLOURS, strict=True)]
        cloud = rr.Points3D(metres(nodes[mask]), colors=np.stack(shades, axis=-1).astype(np.uint8), radii=radius)
        rec.log(f"/world/zone/{name}", cloud, rr.AnyValues(worst_pressure_angle_deg=values), static=True)
    vertices, triangles = zone_surface(zone)
    if len(triangles):
        skin = rr.Mesh3D(vertex_positions=metres(vertices), triangle_indices=triangles.astype(np.uint32), albedo_factor=SKIN)
        rec.log("/world/zone/surface", skin, static=True)
    drawn = int((inside & known).sum())
    return [
        message("view.zone", inside=drawn, all=int(angle.size), limit=limit),
        reported,
        *([message("view.zone_unknown", count=int((~known).sum()))] if not known.all() else []),
    ]
