"""`lmeasure simulate`: from a scenario to a run folder with the truth beside it."""

from pathlib import Path
from typing import Annotated

import typer


def simulate(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="scenario.toml: rig, motion, noise, reference poses.")],
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Folder to write: a run folder, truth.parquet, calibration/.")],
) -> None:
    """Simulate the instrument along a motion: what its counters would record, with the true poses beside it."""
    from lmeasure.simulation import read_scenario, write_simulated
    from lmeasure.simulation import simulate as stage

    simulated = stage(*read_scenario(scenario))
    write_simulated(out, simulated)
    typer.echo(simulated.summary())
