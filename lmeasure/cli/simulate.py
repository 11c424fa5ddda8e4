"""`lmeasure simulate`: from a scenario to a run folder with the truth beside it."""

from pathlib import Path
from typing import Annotated

import typer

from lmeasure.cli.options import Rerun


def simulate(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO", help="scenario.toml: rig, motion, noise, reference poses.")],
    out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Folder to write: a run folder, truth.parquet, calibration/.")],
    rerun: Rerun = None,
) -> None:
    """Simulate the instrument along a motion: what its counters would record, with the true poses beside it."""
    from lmeasure.simulation import read_scenario, write_simulated
    from lmeasure.simulation import simulate as stage

    asked, rig = read_scenario(scenario)
    simulated = stage(asked, rig)
    write_simulated(out, simulated)
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        moved, campaign = simulated.run, simulated.campaign
        write_recording(
            rerun,
            rig,
            run=None if moved is None else moved.run,
            truth=None if moved is None else moved.poses,
            nominal=None if campaign is None else campaign.nominal,
            reference=None if campaign is None else campaign.measured,
        )
    typer.echo(simulated.summary())
