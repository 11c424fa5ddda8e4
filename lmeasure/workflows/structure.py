"""Study of a rig's links, before anything is built or measured."""

import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from lmeasure.core import FileFormatError, SettingsError, StructureError
from lmeasure.text import composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, workflow
from lmeasure.workflows.settings import (
    LANGUAGE,
    RERUN,
    Numbers,
    Pair,
    Paths,
    Point,
    Quaternion,
    Range,
    Recording,
    Writing,
    option,
    places_of,
    pose_with,
    refuse,
    then,
)

if TYPE_CHECKING:
    from lmeasure.core import FloatArray
    from lmeasure.robots import Dyad
    from lmeasure.structure import Linkage, Workspace


AT_A_POSE = "At a pose"
LENGTHS = "Lengths"
ALONG = "Along a trajectory"
MOST_LEVELS = 50


class StructureSettings(Writing):
    OUT_FILE: ClassVar[str] = "structure.json"
    file: Annotated[
        Path | None,
        option(
            "rig.toml, robot.toml or name of a platform, or a table of points and links (docs/files.md).", metavar="FILE", positional=True
        ),
    ] = None
    out: Annotated[Path | None, option("JSON file to write all results to.", metavar="FILE.json")] = None
    listed: Annotated[bool, option("List all structures of six links instead of reading a file.", flag="--list")] = False
    lengths_mm: Annotated[
        Numbers | None,
        option("Lengths in the file's order; finds all their assembly modes.", metavar="L1,L2,...", panel=LENGTHS, unit="mm"),
    ] = None
    within_mm: Annotated[float, option("Allowed contradiction of seven or more lengths.", panel=LENGTHS, within=(0.0, math.inf))] = 0.5
    design: Annotated[bool, option("Reduce the links' limits_mm until no pose within them is singular, and prove it.", panel=LENGTHS)] = (
        False
    )
    position_mm: Annotated[
        Point | None,
        option(
            "Position of the platform: determine its condition, and other poses with the same lengths.", metavar="X,Y,Z", panel=AT_A_POSE
        ),
    ] = None
    quaternion: Annotated[
        Quaternion | None, option("Orientation of the platform; default the base's.", metavar="X,Y,Z,W", panel=AT_A_POSE)
    ] = None
    singular: Annotated[
        bool,
        option(
            "Find the nearest singular pose: what moves there, which drives lead out, and which extra drives close it.", panel=AT_A_POSE
        ),
    ] = False
    to_mm: Annotated[
        Point | None, option("Second position: determinant and condition on the straight path to it.", metavar="X,Y,Z", panel=AT_A_POSE)
    ] = None
    boundary: Annotated[
        Literal["xy", "xz", "yz"] | None, option("Trace the boundary of the workspace around the pose in this plane.", panel=AT_A_POSE)
    ] = None
    levels: Annotated[
        Range | None,
        option("Slices at these coordinates of the third axis; default the pose's.", metavar="START:STOP:STEP", panel=AT_A_POSE, unit="mm"),
    ] = None
    reach_mm: Annotated[
        float | None, option("Half width of the window around the pose; default the rig's size.", panel=AT_A_POSE, within=(0.0, math.inf))
    ] = None
    limit_deg: Annotated[
        float | None,
        option("Largest pressure angle in the workspace; default no limit except singular poses.", panel=AT_A_POSE, within=(0.0, 90.0)),
    ] = None
    length_mm: Annotated[Pair | None, option("Smallest and largest length in the workspace.", metavar="MIN:MAX", panel=AT_A_POSE)] = None
    trajectory: Annotated[
        Path | None,
        option("Trajectory whose motion is split into the screw that lengths see least and the rest.", metavar="TRAJECTORY", panel=ALONG),
    ] = None
    parts: Annotated[Path | None, option("Table of both parts to write.", metavar="FILE.csv", panel=ALONG)] = None
    report: Annotated[Path | None, option("Write structure.html, with drawings, into this folder.", metavar="DIR")] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        if self.file is None:
            return then("structure rig.toml --report structure")
        return then("structure {file} --report structure" if self.report is None else "zone {file} --out zone.nc", file=self.file)

    def paths(self) -> Paths:
        report = () if self.report is None else inside(self.report, "structure.html")
        file = None if self.file is not None and not self.file.suffix and not self.file.exists() else self.file
        return Paths((*present(self.out, self.rerun, self.parts), *report), present(file, self.trajectory))


@workflow
def run_structure(settings: StructureSettings, progress: Progress = silent) -> Result:
    """Describe the links, and write the requested files."""
    from lmeasure.io import files
    from lmeasure.structure import all_structures, described, described_lines, list_lines, read_linkage

    _check(settings)
    if settings.file is None:
        every = all_structures()
        if settings.report is not None:
            from lmeasure.report import write_list_page

            write_list_page(settings.report / "structure.html", every, settings.language or of_terminal())
        made: Any = every
        lines = list_lines(every)
    else:
        linkage = of_robot(settings.file) or read_linkage(settings.file)
        if settings.lengths_mm is not None:
            linkage = linkage.with_lengths(settings.lengths_mm, "--lengths-mm")
        turn = settings.quaternion or (0.0, 0.0, 0.0, 1.0)
        pose, to = (None if place is None else pose_with(place, turn) for place in (settings.position_mm, settings.to_mm))
        try:
            made = described(
                linkage, pose, to=to, workspace=_workspace(settings), design=settings.design, near_singular=settings.singular,
                within_mm=settings.within_mm,
            )  # fmt: skip
        except StructureError as error:
            raise FileFormatError(composed("{where}: {error}", where=settings.file, error=error)) from None
        lines = described_lines(made)
        if settings.trajectory is not None and settings.parts is not None:
            lines.append(_split(linkage, settings.trajectory, settings.parts))
        progress(0.5, "structure")
        if settings.report is not None:
            from lmeasure.report import write_structure_page

            page, language = settings.report / "structure.html", settings.language or of_terminal()
            write_structure_page(page, settings.file.name, linkage, made, pose=pose, language=language)
        if settings.rerun is not None:
            from lmeasure.view import write_structure_recording

            write_structure_recording(settings.rerun, settings.file.name, linkage, made, pose=pose)
    progress(1.0, "structure")
    if settings.out is not None:
        files.write_json(settings.out, made)
    written = () if settings.report is None else (message("line.written", files=settings.report / "structure.html"),)
    return Result(made, (*lines, *written), _figures(made))


def _split(linkage: "Linkage", trajectory: Path, out: Path) -> str:
    """Write both parts of a trajectory's motion."""
    import numpy as np

    from lmeasure.io import files
    from lmeasure.structure import parts
    from lmeasure.trajectory import read_trajectory

    found = read_trajectory(trajectory)
    own = parts(linkage, found.poses)
    files.write_table(out, {"time_s": found.time_s} | own.columns())
    worst = int(np.nanargmax(own.reciprocal_mm_per_mm))
    return message(
        "structure.parts_of_motion", time=float(found.time_s[worst]), along=float(own.reciprocal_mm_per_mm[worst]),
        rest=float(own.orthogonal_mm_per_mm[worst]), file=out,
    )  # fmt: skip


def of_robot(path: Path) -> "Linkage | None":
    """The links of a platform, a built-in one by its name or in a robot.toml; None for any other file: a hexapod's legs within their
    limits, or those of a mechanism whose six equations are lengths, with its drives as at home. FileFormatError for another robot."""
    import numpy as np

    from lmeasure.io import files
    from lmeasure.robots import SCHEMA, ParallelFile, PlatformFile, any_shipped, hooke_joints, read_robot, shipped_names
    from lmeasure.structure import Linkage

    built_in = not path.exists() and str(path) in shipped_names()
    if not built_in and files.read_toml(path).get("schema") != SCHEMA:
        return None
    robot = any_shipped(str(path)) if built_in else read_robot(path)
    if isinstance(robot, PlatformFile):
        model = robot.model
        names = [(leg.name, f"base of {leg.name}", f"platform of {leg.name}") for leg in robot.leg]
        ends = np.sort(model.scale[:, None] * np.column_stack([model.low, model.high]) + model.offset[:, None], axis=1)
        base, platform = (model.base, model.platform) if model.links is None else model.links.bodies
        return Linkage(base, platform, names, model.lengths(model.home[None])[0], ends, rods=model.links)
    if isinstance(robot, ParallelFile):
        held = robot.model.held_by_lengths()
        if held is not None:
            names = [(leg.name, f"base of {leg.name}", f"platform of {leg.name}") for leg in robot.leg]
            hooke = hooke_joints(robot.model, robot.limits)
            points = np.array([leg.platform_mm for leg in robot.leg])
            return Linkage(held.ends, points, names, held.lengths, held.limits, hooke=hooke)
    raise FileFormatError(message("error.robot_is_not_held", where=path, name=robot.name))


COUNTED = ("freedoms", "links", "complex_assemblies", "rank", "determinant", "worst_pressure_angle_deg")


def _figures(made: "dict[str, Any] | list[dict[str, Any]]") -> dict[str, float]:
    if isinstance(made, list):
        return {"structures": float(len(made))}
    found = {name: float(made[name]) for name in COUNTED if isinstance(made.get(name), int | float)}
    return found | ({"assemblies": float(len(made["assemblies"]))} if "assemblies" in made else {})


def _check(settings: StructureSettings) -> None:
    """Raise SettingsError for contradicting options."""
    if settings.listed == (settings.file is not None):
        raise SettingsError("file", message("error.give_a_file_or"))
    if settings.position_mm is None:
        refuse(settings, message("refuse.orientation_alone"), "quaternion")
        refuse(settings, message("refuse.needs_position"), "to_mm", "boundary", "singular")
    if (settings.trajectory is None) != (settings.parts is None):
        raise SettingsError("trajectory", message("error.goes_with_parts_file"))
    if settings.boundary is None:
        refuse(settings, message("refuse.boundary"), "levels", "reach_mm", "limit_deg", "length_mm")
    if settings.file is None:
        refuse(settings, message("refuse.links"), "position_mm", "lengths_mm", "rerun", "design", "trajectory")
    if settings.reach_mm is not None and not 0.0 < settings.reach_mm < math.inf:
        raise SettingsError("reach_mm", message("error.is_no_distance", reach_mm=settings.reach_mm))
    if settings.limit_deg is not None and not 0.0 < settings.limit_deg <= 90.0:
        raise SettingsError("limit_deg", message("error.does_not_lie_in", limit_deg=settings.limit_deg))
    if settings.length_mm is not None and not 0.0 <= settings.length_mm[0] < settings.length_mm[1]:
        raise SettingsError("length_mm", message("error.the_limits_must_rise"))
    if not 0.0 < settings.within_mm < math.inf:
        raise SettingsError("within_mm", message("error.is_no_distance", reach_mm=settings.within_mm))


def _workspace(settings: StructureSettings) -> "Workspace | None":
    from lmeasure.structure import Workspace

    if settings.boundary is None:
        return None
    levels = () if settings.levels is None else tuple(places_of(settings.levels, "levels", 1, MOST_LEVELS).tolist())
    return Workspace(settings.boundary, levels, settings.reach_mm, settings.limit_deg, settings.length_mm)


LEAST = 7


class DyadsSettings(Writing):
    NEXT: ClassVar[str] = "structure rig.toml --report structure"
    poses: Annotated[Path, option("Poses of the body: x_mm, y_mm, z_mm, qx, qy, qz, qw.", metavar="POSES", positional=True)]
    out: Annotated[Path, option("Folder for links.csv, minimax.csv and misses.csv.", metavar="DIR")]
    angles: Annotated[str, option("Convention of angle columns.")] = "puma-oat"
    links: Annotated[int, option("Number of links; five leave one freedom.", ge=1, le=6)] = 5
    reach_mm: Annotated[
        float | None, option("Largest distance of ball joints from the poses; default three times the spread of the poses.", ge=0)
    ] = None
    free: Annotated[
        Literal["point-on-a-line", "line-in-a-plane", "line", "point", "plane"] | None,
        option("Element of the body that the poses state; their other coordinates are free."),
    ] = None
    starts: Annotated[int, option("Number of random starts of the search.", ge=1, le=100000)] = 200
    seed: Annotated[int, option("Seed of the starts.", ge=0)] = 0

    def paths(self) -> Paths:
        return Paths(inside(self.out, "links.csv", "minimax.csv", "misses.csv"), (self.poses,))


@workflow
def run_dyads(settings: DyadsSettings, progress: Progress = silent) -> Result:
    """Find links, and write them and by how much they miss each pose."""
    import numpy as np

    from lmeasure.io import files
    from lmeasure.recording import pose_columns, poses_from_rows, read_poses
    from lmeasure.robots import all_fitted, minimax, misses

    given = read_poses(settings.poses, settings.angles, unnamed=True)
    poses = given.rows
    if len(poses) < LEAST:
        raise FileFormatError(message("error.poses_a_link_has", where=settings.poses, n_poses=len(poses), least=LEAST))
    spread = float(np.linalg.norm(np.ptp(poses[:, :3], axis=0)))
    reach = settings.reach_mm or 3.0 * spread
    if not reach > 0.0:
        raise FileFormatError(message("error.all_poses_are_at", where=settings.poses))
    progress(0.0, "least squares")
    every = all_fitted(poses, reach, settings.starts, settings.seed, progress=lambda share: progress(0.7 * share, "least squares"))
    near = [d for d in every if _within(d, poses, reach)]
    if len(near) < settings.links:
        raise FileFormatError(
            message("error.different_links_found_within", where=settings.poses, n_near=len(near), reach=reach, links=settings.links)
        )
    best = near[: settings.links]
    anchors, points, lengths = (np.array(part) for part in list(zip(*best, strict=True))[:3])
    progress(0.7, "minimax")
    kind = "" if settings.free is None else settings.free.replace("-", " ")
    found = minimax(poses, (anchors, points, lengths), kind, lambda share: progress(0.7 + 0.3 * share, "minimax"))
    first = np.array([d.misses for d in best]).T
    last = misses(found.poses, found.anchors, found.points, found.lengths)
    columns = dict(pose_columns(poses_from_rows(found.poses, list(given.names))))
    columns |= {f"link_{j + 1}_{name}_mm": of[:, j] for name, of in (("least_squares", first), ("minimax", last)) for j in range(len(best))}
    names = ("links.csv", "minimax.csv", "misses.csv")
    tables = (_columns(anchors, points, lengths), _columns(found.anchors, found.points, found.lengths), columns)
    with ExitStack() as together:
        for path, table in zip([together.enter_context(files.whole(path)) for path in inside(settings.out, *names)], tables, strict=True):
            files.write_table(path, table)
    progress(1.0, "minimax")
    largest = float(np.abs(first).max())
    lines = (
        message("workflows.links_poses_best_different", links=len(best), poses=len(poses), all=len(near), starts=settings.starts),
        message("workflows.largest_miss_mm_least", one=largest, other=found.largest),
        message("line.written", files=tuple(str(settings.out / name) for name in names)),
    )
    return Result(found, lines, {"largest_miss_mm": largest, "largest_miss_minimax_mm": found.largest})


def _within(dyad: "Dyad", poses: "FloatArray", reach: float) -> bool:
    import numpy as np

    away = np.linalg.norm(dyad.anchor - poses[:, :3].mean(axis=0)), np.linalg.norm(dyad.point)
    return bool(max(away) <= 2.0 * reach and dyad.length > 1e-3 * reach)


def _columns(anchors: "FloatArray", points: "FloatArray", lengths: "FloatArray") -> "dict[str, object]":
    out: dict[str, object] = {"link": [f"leg_{j + 1}" for j in range(len(lengths))]}
    for name, rows in (("base", anchors), ("platform", points)):
        out |= {f"{name}_{axis}_mm": rows[:, k] for k, axis in enumerate("xyz")}
    return out | {"length_mm": lengths}
