"""Links between ball joints for the poses that a body shall take: least squares link by link, and minimax of all together."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from lmeasure.core import FileFormatError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, inside, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, option

if TYPE_CHECKING:
    from lmeasure.core import FloatArray
    from lmeasure.robots import Dyad, Minimax

LEAST = 7


class Settings(Writing):
    """Settings of `lmeasure dyads`."""

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
        """Tables of links from one of poses."""
        return Paths(inside(self.out, "links.csv", "minimax.csv", "misses.csv"), (self.poses,))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Minimax]":
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
