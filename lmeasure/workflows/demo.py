"""The whole chain on a simulated cell."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.core import pasted
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import BROWSER, Paths, Writing, option

if TYPE_CHECKING:
    from lmeasure.demo import Demo, RobotDemo


class Settings(Writing):
    """Settings of `lmeasure demo`."""

    NEXT: ClassVar[str] = "workbench my-cell"
    out: Annotated[Path | None, option("Folder for all files; default a new one, lmeasure-demo or lmeasure-robot-demo.", metavar="DIR")] = (
        None
    )
    seed: Annotated[int, option("Seed of the simulated cell, reference poses and motion, or robot.", ge=0)] = 0
    robot: Annotated[bool, option("Let a simulated robot run the test cube of ISO 9283; certify, correct and certify it again.")] = False
    correct: Annotated[
        bool, option("With a robot: correct it and certify it again. --no-correct takes half as long.", flag="--correct/--no-correct")
    ] = True

    browser: Annotated[bool, BROWSER] = True

    def paths(self) -> Paths:
        """Everything in the folder that the demo writes."""
        from lmeasure.demo import OF_CELL, OF_ROBOT, existing

        return Paths() if self.out is None else Paths(tuple(existing(self.out, OF_ROBOT if self.robot else OF_CELL)))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Demo | RobotDemo]":
    """The demo of the cell, or that of the robot."""

    def step(stage: str, done: int, of: int) -> None:
        progress(done / of if of else 0.0, stage)

    progress(0.0, "load")
    from lmeasure.demo import fresh

    if settings.robot:
        from lmeasure.demo import robot_demo
        from lmeasure.report import reported

        tested = robot_demo(settings.out or fresh("lmeasure-robot-demo"), step, settings.seed, correct=settings.correct)
        head = ("characteristic", "value", "U95", "truth", "unit", "")
        rows = [
            (f"{h.name} {h.where}", *(f"{v:.4g}" for v in (h.value, h.u95, h.true_value)), h.unit, "inside" if h.inside else "OUTSIDE")
            for h in tested.shown()
        ]
        held = tested.held
        figures = {"characteristics": float(len(held)), "truth_inside_u95": float(sum(h.inside for h in held))}
        figures |= {f"{h.name}_{'percent' if h.unit == '%' else h.unit}": h.value for h in tested.shown()}
        corrected: tuple[str, ...] = ()
        if tested.loop is not None:
            better, (before, after) = tested.loop.improvement, tested.loop.true_mm
            corrected = (
                "",
                message("workflow.corrected_measured_again"),
                *reported(better),
                message("workflows.truly_mm_before_mm", before=before, after=after),
            )
            figures |= {"mean_distance_before_mm": better.before_mm[0], "mean_distance_after_mm": better.after_mm[0]}
            figures |= {"improvement": better.factor, "improvement_at_least": better.factor_95[0], "noise_floor_mm": better.floor_mm}
        said = _told([head, *rows], tested.remarks, tested.look, corrected)
        page = tested.look[0] if tested.look[0].suffix == ".html" else None
        return Result(tested, said, figures, tested.remarks, tested.look, page=page)
    from lmeasure.demo import demo

    shown = demo(settings.out or fresh("lmeasure-demo"), step, settings.seed)
    found = shown.figures
    lines = (
        message("demo_page.measured", poses=int(found["with_a_pose"]), mm=found["error_of_position_mm"]),
        message("demo_page.honest", percent=100.0 * found["positions_inside_95"]),
        message("demo_page.robot.text", before=found["robot_before_mm"], after=found["robot_after_mm"]),
        message("demo_page.page", page=shown.look[0]),
    )
    return Result(shown, lines, found, shown.remarks, shown.look, page=shown.look[0])


def _told(rows: Sequence[tuple[str, ...]], remarks: tuple[str, ...], look: tuple[Path, ...], more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """The table, more lines, what to know besides, and where to look."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    table = []
    for first, *others in rows:
        cells = [f"{cell:>{width}}" for cell, width in zip(others[:-1], widths[1:-1], strict=True)]
        table.append("   ".join([f"{first:{widths[0]}}", *cells, others[-1]]).rstrip())
    files = [message("workflows.all_files_look", folder=look[0].parent), *(f"  {path}" for path in look)]
    recording = next(path for path in look if path.suffix == ".rrd")
    command = f"view {pasted(recording)}"
    opened = message("demo.open_recording", command=f"lmeasure {command}", other=f"python3 run.py {command}")
    return ("", *table, *more, "", *(message("line.note", text=remark) for remark in remarks), *files, opened)
