"""The files of an identification, and what is found out beside it for them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lmeasure.io import files
from lmeasure.report import write_robot_page
from lmeasure.robots import (
    AnyRobot,
    HeldOut,
    Identified,
    Noted,
    PredictionMap,
    Robot,
    beyond,
    corrected,
    held_out,
    learning_curve,
    nominal_frames,
    record as identified_record,
    workspace,
    worth_freeing,
    write_record,
    write_robot,
    write_urdf,
)


@dataclass(frozen=True)
class Judged:
    """An identification that knows how rows fared that were held out of it, and how well it predicts over the workspace."""

    found: Identified[Any]
    held: HeldOut | None
    over: PredictionMap | None
    record: dict[str, Any]


def judge(found: Identified[Any], inputs: Sequence[Path], findings: Sequence[Noted], seed: int = 0, *, thorough: bool = True) -> Judged:
    """Hold rows out, and make the record of it all; thorough: find out too how well fewer poses would do."""
    held = held_out(found, seed=seed)
    found = replace(found, misfit=1.0 if held is None else held.misfit, beyond=beyond(found))
    curve, worth, over = learning_curve(found, seed) if thorough else (), worth_freeing(found), workspace(found, seed=seed)
    record = identified_record(found, inputs, held, curve, worth=worth, findings=findings, over=over)
    return Judged(found, held, over, record)


def write_identification(out: Path, robot: AnyRobot, of: Judged, language: str) -> list[str]:
    """robot.toml, robot.urdf of a serial arm, workspace.csv, report.html and, last, identified.json into the folder; their names."""
    result = corrected(robot, of.found)
    write_robot(out / "robot.toml", result)
    if isinstance(result, Robot):  # URDF has words for serial arms alone
        write_urdf(out / "robot.urdf", result)
    if of.over is not None:
        files.write_table(out / "workspace.csv", of.over.columns())
    write_robot_page(out / "report.html", of.found, of.record, of.over, language=language)
    write_record(out / "identified.json", of.record | nominal_frames(robot))
    urdf, space = ["robot.urdf"] * isinstance(result, Robot), ["workspace.csv"] * (of.over is not None)
    return ["identified.json", "robot.toml", *urdf, "report.html", *space]
