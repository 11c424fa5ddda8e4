"""From a scenario to a run folder with the truth beside it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, workflow
from lmeasure.workflows.settings import RERUN, Paths, Recording, Writing, option

if TYPE_CHECKING:
    from lmeasure.simulation import Simulated


class Settings(Writing):
    """Settings of `lmeasure simulate`."""

    NEXT: ClassVar[str] = "reconstruct {out} --out {out}/trajectory.parquet"
    scenario: Annotated[Path, option("scenario.toml: rig, motion, noise, reference poses.", metavar="SCENARIO", positional=True)]
    out: Annotated[Path, option("Folder to write: a run folder, truth.parquet, calibration/.", metavar="RUN")]
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        """A run folder, the truth, and a calibration folder with its truth."""
        campaign = self.out / "calibration"
        counted = inside(campaign, "rig.toml", "reference_poses.csv", "counts.csv")
        true = inside(campaign / "true", "rig.toml", "reference_poses.csv")
        robot = (
            *inside(self.out / "robot", "robot.toml", "joints.csv", "program.toml"),
            *inside(self.out / "robot" / "true", "robot.toml"),
        )
        return Paths((*in_run_folder(self.out, "truth.parquet"), *counted, *true, *robot, *present(self.rerun)), (self.scenario,))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Simulated]":
    """Simulate and write the folder."""
    from lmeasure.simulation import read_scenario, simulate, write_simulated

    progress(0.0, "simulate")
    scenario, rig = read_scenario(settings.scenario)
    remarks: tuple[str, ...] = ()
    if scenario.robot is None:
        simulated = simulate(scenario, rig)
        progress(1.0, "simulate")
        write_simulated(settings.out, simulated)
    else:
        from lmeasure.iso9283 import simulate_robot, write_robot_run

        performed = simulate_robot(scenario, rig, settings.scenario.parent, str(settings.scenario))
        simulated, remarks = performed.simulated, performed.remarks
        progress(1.0, "simulate")
        write_robot_run(settings.out, performed)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        moved, campaign = simulated.run, simulated.campaign
        write_recording(
            settings.rerun,
            rig,
            run=None if moved is None else moved.run,
            truth=None if moved is None else moved.poses,
            nominal=None if campaign is None else campaign.nominal,
            reference=None if campaign is None else campaign.measured,
        )
    figures: dict[str, float] = {}
    if simulated.run is not None:
        passes = simulated.run.run.passes
        figures |= {"samples": float(len(passes[0].time_s)), "duration_s": float(passes[0].time_s[-1]), "passes": float(len(passes))}
    if simulated.campaign is not None:
        figures["reference_poses"] = float(len(simulated.campaign.poses))
    reported: tuple[str, ...] = ()
    if scenario.robot is not None:
        reported = (message("workflow.robot_rests" if performed.program is None else "workflow.robot_rests_program"),)
    return Result(
        simulated, (*simulated.summary().splitlines(), *reported, *(message("line.note", text=text) for text in remarks)), figures, remarks
    )
