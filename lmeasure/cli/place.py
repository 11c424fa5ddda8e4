"""`lmeasure place`: where to put the points."""

from pathlib import Path
from typing import Annotated

import typer

from lmeasure.cli.options import Rerun


def place(
    rig: Annotated[Path, typer.Argument(metavar="RIG.toml", help="The rig as it is, or a first sketch of it.")],
    task: Annotated[Path, typer.Option("--task", metavar="PLACEMENT.toml", help="Task, mounting boxes, keep-outs, tolerance.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for rig.toml and placement.json.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the search.")] = 0,
    generations: Annotated[int, typer.Option("--generations", min=1, help="Most generations of the global search.")] = 2000,
    rerun: Rerun = None,
) -> None:
    """Search places for observation and attachment points that make the instrument best where the robot works."""
    import json

    from lmeasure import files
    from lmeasure.accuracy.placement import place as stage
    from lmeasure.accuracy.placement import placement_record, read_placement
    from lmeasure.cli.progress import bar
    from lmeasure.rig import read_rig, write_rig

    wanted = read_placement(task)
    sketch = read_rig(rig)
    with bar("place") as progress:
        placed = stage(sketch, wanted, seed, progress, generations=generations)
    record = placement_record(placed, seed)
    files.write_text(out / "placement.json", json.dumps(record, indent=1, allow_nan=False) + "\n")
    write_rig(out / "rig.toml", placed.rig)
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, placed.rig, nominal=sketch)
    typer.echo(placed.summary())
