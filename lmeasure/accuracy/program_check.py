"""A robot program compared with the zone, and its paths that leave the zone led around the limits by the least deviation (thesis 5.2)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.accuracy.scan import run
from lmeasure.accuracy.zone import at_pose, make_plan, named_figures
from lmeasure.core import AccuracyError, FloatArray, StructureError, se3
from lmeasure.linkages import PathBounds, ToolLimits, detour, nearest_pose
from lmeasure.recording import CommandedPath, Program
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.structure import Linkage, bounds_of
from lmeasure.text import message

if TYPE_CHECKING:
    import xarray as xr

STEP_MM = 5.0


@dataclass(frozen=True)
class Part:
    """A pose or path of the program: points (n, 3) [mm], worst pressure angle [deg] and 95 % radius [mm] (n,) at each with the orientation
    there, distance (n,) to the nearest node outside the zone or the scanned box's face [mm], 0 where the point itself is outside."""

    name: str
    points: FloatArray
    angle_deg: FloatArray
    u95_mm: FloatArray
    to_edge_mm: FloatArray

    def line(self) -> str:
        """One line for a person."""
        edge = self.to_edge_mm.min()
        where = message("guard.inside", edge=edge) if edge > 0 else message("guard.leaves")
        return message("guard.line", name=self.name, angle=self.angle_deg.max(), u95=self.u95_mm.max(), where=where)


def guard(
    rig: Rig, calibration: CalibrationRecord | None, zone: "xr.Dataset", program: Program, *, rotation: Rotation, step_mm: float = STEP_MM
) -> list[Part]:
    """Compare each pose and path of the program with a scanned zone of the same rig.

    Poses and paths have the orientations the program states; a path without one is taken with `rotation`. The distance to the edge is that
    of the zone's nodes, at all the orientations it was scanned with: no finer than its grid. Raises the errors of `scan_zone`.
    """
    places = [
        (f"pose {p.name}", np.array([p.position_mm], dtype=np.float64), Rotation.from_quat([p.quaternion_xyzw])) for p in program.pose
    ]
    places += [(f"path {p.name}", *_along(p, rotation, step_mm)) for p in program.path]
    start = np.array(zone.attrs["zero_pose_xyz_mm_qxyzw"], dtype=np.float64)
    out = []
    for name, points, turns in places:
        plan = make_plan(rig, calibration, points, turns, start=start)
        # each position has the drums and orientation of a pose there
        own = np.broadcast_to(plan.quaternions, (len(points), 4))
        found = [run(at_pose(plan, rig, calibration, np.concatenate([points[i], own[i]])), workers=1) for i in range(len(points))]
        both = np.hstack([f for f, _ in found]), np.hstack([flags for _, flags in found])
        figures = named_figures(*both, full=False, near=False, six=plan.six)
        out.append(Part(name, points, figures["worst_pressure_angle_deg"], figures["u95_position_mm"], _to_edge(zone, points)))
    return out


def _along(path: CommandedPath, rotation: Rotation, step_mm: float) -> tuple[FloatArray, Rotation]:
    """Points (n, 3) of a path [mm] and its orientation: one, or one for each point where the tool turns on the way."""
    points = path.points(step_mm)
    if path.end_quaternion_xyzw is None:
        return points, Rotation.from_quat([rotation.as_quat() if path.quaternion_xyzw is None else path.quaternion_xyzw])
    turns = path.orientation(_share(points))
    assert turns is not None
    return points, turns


def _to_edge(zone: "xr.Dataset", points: FloatArray) -> FloatArray:
    axes = [zone[name].values for name in "xyz"]
    low, high = np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])
    distance = np.minimum(points - low, high - points).min(axis=1)
    inside = zone["in_zone"].values.astype(bool)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    if (~inside).any():
        distance = np.minimum(distance, scipy.spatial.cKDTree(nodes[~inside]).query(points)[0])
    nearest = scipy.spatial.cKDTree(nodes.reshape(-1, 3)).query(points)[1]
    return np.where(inside.ravel()[nearest], np.maximum(distance, 0.0), 0.0)


def guard_columns(parts: list[Part]) -> dict[str, Any]:
    """Columns of a table over all points of all parts."""
    return {
        "part": [part.name for part in parts for _ in part.points],
        **{f"{axis}_mm": np.concatenate([part.points[:, i] for part in parts]) for i, axis in enumerate("xyz")},
        "pressure_angle_deg": np.concatenate([part.angle_deg for part in parts]),
        "u95_position_mm": np.concatenate([part.u95_mm for part in parts]),
        "to_edge_mm": np.concatenate([part.to_edge_mm for part in parts]),
    }


MARGIN = 1e-6  # of the limits' scale: a path on a limit is not called beyond it for its rounding
INSIDE = 1e-8  # of the limits' scale: an end that moves keeps them by so much more
SIDES = 8  # sides of the polygon about a path that represents all planes of its weave
SETTLED = 5e-7  # of the limits' scale: as little as a path that turns may miss the margin by
ROUNDS = 12  # largest number of rounds until the rotation along a detour settles


@dataclass(frozen=True)
class PathCheck:
    """Result of a path: commanded and led points (n, 3) [mm], equal if it keeps the limits; left: the reason why it was not led; weaves:
    whether it was shifted as a whole."""

    name: str
    commanded: FloatArray
    points: FloatArray
    left: str = ""
    weaves: bool = False

    @property
    def deviation_mm(self) -> FloatArray:
        """(n,) between the two."""
        return np.linalg.norm(self.points - self.commanded, axis=1)

    @property
    def changed(self) -> bool:
        return bool(self.deviation_mm.max() > 0.0)

    def line(self) -> str:
        """One line for a person."""
        if self.left:
            return message("accuracy.path_left", name=self.name, why=self.left)
        if not self.changed:
            return message("accuracy.path_keeps_limits", name=self.name)
        start, *_, end = off = self.deviation_mm
        code = "path_shifted" if self.weaves else "path_and_ends_led" if max(start, end) > 0.0 else "path_led_around_most"
        return message(f"accuracy.{code}", name=self.name, mm=off.max(), start=start, end=end)


def corrected(kept_at: Callable[[FloatArray], PathBounds | None], program: Program, rotation: Rotation) -> tuple[Program, list[PathCheck]]:
    """Return the program with every path within the limits of a rig or a mechanism, and the change of each path.

    A path that leaves them becomes one of points; its orientations, speed and cycles stay. It keeps the limits between its points. An end
    beyond a limit moves to the nearest place that keeps it. A path that weaves is shifted as a whole until its weave keeps the limits in
    every plane. kept_at: of a pose (7,), the limits in its assembly mode, None where it does not keep them (`within`). rotation: of paths
    that state none. The assembly is that of the first commanded pose that keeps the limits. AccuracyError if no pose keeps the limits.
    """
    places = [np.array([*p.position_mm, *p.quaternion_xyzw], dtype=np.float64) for p in program.pose]
    places += [pose for path in program.path for pose in _poses(path, path.points(STEP_MM), rotation)]
    inside = next(((k, pose) for pose in places if (k := kept_at(pose)) is not None), None)
    if inside is None:
        raise AccuracyError(message("error.no_pose_or_path"))
    found = [_led(*inside, path, rotation) for path in program.path]
    paths = tuple(_as_points(path, one) if one.changed else path for path, one in zip(program.path, found, strict=True))
    return program.model_copy(update={"path": paths}), found


def within(linkage: Linkage, limit_deg: float, lengths_mm: tuple[float, float] | None = None) -> Callable[[FloatArray], PathBounds | None]:
    """Return the limits of links for `corrected`: cables as they run over their pulleys, rods, Hooke joints."""

    def kept_at(pose: FloatArray) -> PathBounds | None:
        try:
            bounds = bounds_of(linkage, pose, limit_deg, lengths_mm)
        except StructureError:
            return None
        return keeping(bounds, pose)

    return kept_at


def keeping(kept: PathBounds, pose: FloatArray) -> PathBounds | None:
    """Return the limits where a pose (7,) keeps them, else None."""
    with np.errstate(invalid="ignore"):
        return kept if (kept.values(pose) >= MARGIN).all() else None


def _poses(path: CommandedPath, points: FloatArray, rotation: Rotation, share: FloatArray | None = None) -> FloatArray:
    """(n, 7) commanded poses at points (n, 3); share (n,): of the path's length, by default that of the points."""
    turns = path.orientation(_share(points) if share is None else share)
    return np.column_stack([points, np.tile(rotation.as_quat(), (len(points), 1)) if turns is None else turns.as_quat()])


def _share(points: FloatArray) -> FloatArray:
    """(n,) shares of the length of a path through points (n, 3)."""
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.asarray(gone / max(float(gone[-1]), 1e-300))


def _led(kept: PathBounds, inside: FloatArray, path: CommandedPath, rotation: Rotation) -> PathCheck:
    points = path.points(STEP_MM)
    if path.weave_stroke_mm is not None:
        return _shifted(kept, path, points, rotation)
    share = _share(points)
    with np.errstate(invalid="ignore"):
        keeps = np.all(kept.values(_poses(path, points, rotation)) >= MARGIN, axis=1)
    if keeps.all():
        return PathCheck(path.name, points, points)
    for _ in range(ROUNDS):
        poses = _poses(path, points, rotation, share)
        try:
            for end, order in ((0, 1), (-1, -1)):
                # an end far away is searched from the place where the path comes in
                begin = np.append((poses[::order][int(np.argmax(keeps[::order]))] if keeps.any() else inside)[:3], poses[end, 3:])
                poses[end] = nearest_pose(kept, poses[end], MARGIN, begin, aim=MARGIN + INSIDE, turns=False)
            found = detour(kept, poses, margin=MARGIN, turns=False)
        except StructureError as error:
            return PathCheck(path.name, points, points, str(error).removeprefix("path: "))
        # the tool turns along the new path by its length, which is another one
        own = _share(found.poses[:, :3])
        if path.end_quaternion_xyzw is None or _keeps(kept, _poses(path, found.poses[:, :3], rotation)):
            commanded = np.column_stack([np.interp(found.parameter, np.arange(len(points)), column) for column in points.T])
            return PathCheck(path.name, commanded, found.poses[:, :3])
        share = np.interp(np.arange(len(points)), found.parameter, own)
    return PathCheck(path.name, points, points, message("accuracy.path_turns"))


def _shifted(kept: PathBounds, path: CommandedPath, points: FloatArray, rotation: Rotation) -> PathCheck:
    """Return a weaving path shifted by the least way. The program does not state the plane of the weave, so all around the line count."""
    assert path.weave_stroke_mm is not None
    along = points[-1] - points[0]
    _, _, axes = np.linalg.svd(along[None])
    turn = 2.0 * np.pi / SIDES * np.arange(SIDES)
    # the polygon is around the circle
    rim = 0.5 * path.weave_stroke_mm / np.cos(np.pi / SIDES) * np.column_stack([np.cos(turn), np.sin(turn)]) @ axes[1:]
    poses = _poses(path, points, rotation)
    places = np.repeat(poses, SIDES + 1, axis=0)
    places[:, :3] += np.tile(np.vstack([np.zeros(3), rim]), (len(points), 1))
    whole = ToolLimits(kept, se3.compose(se3.inverse(places), np.broadcast_to(poses[0], places.shape)))
    try:
        with np.errstate(invalid="ignore"):
            shift = nearest_pose(whole, poses[0], MARGIN, turns=False)[:3] - points[0]
    except StructureError as error:
        return PathCheck(path.name, points, points, str(error).removeprefix("path: "))
    return PathCheck(path.name, points, points + shift, weaves=True)


def _keeps(kept: PathBounds, poses: FloatArray) -> bool:
    """Return whether a path through poses (n, 7) keeps the limits, halfway between them too."""
    half = se3.displaced(poses[:-1], 0.5 * se3.displacement(poses[1:], poses[:-1]))
    with np.errstate(invalid="ignore"):
        return bool((kept.values(np.concatenate([poses, half])) >= MARGIN - SETTLED).all())


def _as_points(path: CommandedPath, found: PathCheck) -> CommandedPath:
    """The path through other points, or shifted as a whole."""
    if found.weaves:
        return path.model_copy(update={"start_mm": tuple(found.points[0].tolist()), "end_mm": tuple(found.points[-1].tolist())})
    keys = ("name", "windows_s", "cycles", "speed_percent", "load_kg", "speed_mm_s", "quaternion_xyzw", "end_quaternion_xyzw")
    apart = np.append(True, np.linalg.norm(np.diff(found.points, axis=0), axis=1) > 1e-9)
    points = tuple(tuple(point) for point in found.points[apart].tolist())
    kept = {key: value for key in keys if (value := getattr(path, key)) is not None}
    return CommandedPath(**kept, kind="points", points_mm=points)


def correction_columns(found: list[PathCheck]) -> dict[str, Any]:
    """Columns of a table over all points of the paths that were led around."""
    led = [one for one in found if one.changed]
    both = [np.concatenate([getattr(one, key) for one in led] or [np.empty((0, 3))]) for key in ("commanded", "points")]
    return {
        "path": [one.name for one in led for _ in one.points],
        **{f"commanded_{axis}_mm": both[0][:, i] for i, axis in enumerate("xyz")},
        **{f"{axis}_mm": both[1][:, i] for i, axis in enumerate("xyz")},
        "deviation_mm": np.linalg.norm(both[1] - both[0], axis=1),
    }
