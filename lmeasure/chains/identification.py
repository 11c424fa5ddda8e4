"""The files of an identification, and what is found out beside it for them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lmeasure import files
from lmeasure.report.robot import write_robot_page
from lmeasure.robots import identified, judged
from lmeasure.robots.identify import Identified
from lmeasure.robots.judged import HeldOut
from lmeasure.robots.noted import Noted
from lmeasure.robots.robot import AnyRobot, Robot, write_robot
from lmeasure.robots.urdf import write_urdf
from lmeasure.robots.workspace import Workspace, workspace


@dataclass(frozen=True)
class Judged:
    """An identification that knows how rows fared that were held out of it, and how well it predicts over the workspace."""

    found: Identified[Any]
    held: HeldOut | None
    over: Workspace | None
    record: dict[str, Any]


def judge(found: Identified[Any], inputs: Sequence[Path], findings: Sequence[Noted], seed: int = 0) -> Judged:
    """Hold rows out, and make the record of it all."""
    held = judged.held_out(found, seed=seed)
    found = replace(found, misfit=1.0 if held is None else held.misfit, beyond=judged.beyond(found))
    curve, worth, over = judged.learning_curve(found, seed), judged.worth_freeing(found), workspace(found, seed=seed)
    record = identified.record(found, inputs, held, curve, worth=worth, findings=findings, over=over)
    return Judged(found, held, over, record)


def write_identification(out: Path, robot: AnyRobot, of: Judged, language: str) -> list[str]:
    """robot.toml, robot.urdf of a serial arm, workspace.csv, report.html and, last, identified.json into the folder; their names."""
    result = identified.corrected(robot, of.found)
    write_robot(out / "robot.toml", result)
    if isinstance(result, Robot):  # URDF has words for serial arms alone
        write_urdf(out / "robot.urdf", result)
    if of.over is not None:
        files.write_table(out / "workspace.csv", of.over.columns())
    write_robot_page(out / "report.html", of.found, of.record, of.over, language=language)
    identified.write_record(out / "identified.json", of.record | identified.nominal_frames(robot))
    urdf, space = ["robot.urdf"] * isinstance(result, Robot), ["workspace.csv"] * (of.over is not None)
    return ["identified.json", "robot.toml", *urdf, "report.html", *space]
