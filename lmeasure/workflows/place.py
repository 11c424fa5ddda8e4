"""Where to put the points."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import RERUN, Paths, Recording, Writing, option

if TYPE_CHECKING:
    from lmeasure.accuracy import Placed


class Settings(Writing):
    """Settings of `lmeasure place`."""

    NEXT: ClassVar[str] = "zone {out}/rig.toml --out {out}/zone.nc"
    rig: Annotated[Path, option("Present rig, or a first sketch of it.", metavar="RIG.toml", positional=True)]
    task: Annotated[Path, option("Task, mounting boxes, keep-outs, tolerance.", metavar="PLACEMENT.toml")]
    out: Annotated[Path, option("Folder for rig.toml and placement.json.", metavar="DIR")]
    seed: Annotated[int, option("Seed of the search.", ge=0)] = 0
    generations: Annotated[int, option("Largest number of generations of the global search.", ge=1)] = 2000
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        """A placement from a rig and a task."""
        return Paths((*inside(self.out, "placement.json", "rig.toml"), *present(self.rerun)), (self.rig, self.task))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Placed]":
    """Search, and write the rig and the record of it."""
    from lmeasure.accuracy import place, placement_record, read_placement
    from lmeasure.io import files
    from lmeasure.rig import read_rig, write_rig

    wanted = read_placement(settings.task)
    sketch = read_rig(settings.rig)
    placed = place(sketch, wanted, settings.seed, steps(progress, "place"), generations=settings.generations)
    record = placement_record(placed, settings.seed)
    files.write_json(settings.out / "placement.json", record)
    write_rig(settings.out / "rig.toml", placed.rig)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, placed.rig, nominal=sketch)
    figures = (
        {"rigs_tried": float(placed.evaluations)}
        | placed.after
        | {f"before_{name}": v for name, v in placed.before.items()}
        | placed.assumed.figures()
    )
    return Result(placed, tuple(placed.summary().splitlines()), figures)
