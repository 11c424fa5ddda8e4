"""The whole chain on a simulated cell."""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from lmeasure.core import LMeasureError, SettingsError, pasted
from lmeasure.io import os_reason
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, workflow
from lmeasure.workflows.registry import load
from lmeasure.workflows.settings import BROWSER, RERUN, CommandSettings, Paths, Recording, Writing, option


class DemoSettings(Writing):
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
        from lmeasure.demo import OF_CELL, OF_ROBOT, existing

        return Paths() if self.out is None else Paths(tuple(existing(self.out, OF_ROBOT if self.robot else OF_CELL)))


@workflow
def run_demo(settings: DemoSettings, progress: Progress = silent) -> Result:
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
        said = _lines([head, *rows], tested.remarks, tested.look, corrected)
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


def _lines(
    rows: Sequence[tuple[str, ...]], remarks: tuple[str, ...], look: tuple[Path, ...], more: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """Return the table, more lines, remarks, and the files to look at."""
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


class SimulateSettings(Writing):
    NEXT: ClassVar[str] = "reconstruct {out} --out {out}/trajectory.parquet"
    scenario: Annotated[Path, option("scenario.toml: rig, motion, noise, reference poses.", metavar="SCENARIO", positional=True)]
    out: Annotated[Path, option("Folder to write: a run folder, truth.parquet, calibration/.", metavar="RUN")]
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        campaign = self.out / "calibration"
        counted = inside(campaign, "rig.toml", "reference_poses.csv", "counts.csv")
        true = inside(campaign / "true", "rig.toml", "reference_poses.csv")
        robot = (
            *inside(self.out / "robot", "robot.toml", "joints.csv", "program.toml"),
            *inside(self.out / "robot" / "true", "robot.toml"),
        )
        return Paths((*in_run_folder(self.out, "truth.parquet"), *counted, *true, *robot, *present(self.rerun)), (self.scenario,))


@workflow
def run_simulate(settings: SimulateSettings, progress: Progress = silent) -> Result:
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


class WarmSettings(CommandSettings):
    NEXT: ClassVar[str] = "demo"


JOBS = (
    ("simulate", {"scenario": "scenario.toml", "out": "run"}),
    ("calibrate", {"folder": "run/calibration", "out": "calibration"}),
    ("reconstruct", {"run": "run", "out": "trajectory.parquet"}),
    ("zone", {"rig": "run/rig.toml", "out": "zone.nc"}),
)
GRID = dict.fromkeys(("x", "y", "z"), "-50:50:50")


@workflow
def run_warm(settings: WarmSettings, progress: Progress = silent) -> Result:
    """Do the demo's work, and that of a rig of each template, in a folder that is not kept; compile each kernel that is used."""
    from lmeasure.demo import demo
    from lmeasure.kernels import compilation, compiled_at_once
    from lmeasure.templates import TEMPLATES

    before, since = len(compilation.names), compilation.seconds
    with compiled_at_once(), tempfile.TemporaryDirectory() as folder:
        demo(Path(folder) / "demo", lambda stage, done, of: progress(done / of if of else 0.0, stage), 0)
        for template in TEMPLATES:
            here = Path(folder) / template
            _do("init", {"out": here, "template": template})
            for name, paths in JOBS:
                progress(0.0, name)
                _do(name, {**{key: here / path for key, path in paths.items()}, **(GRID if name == "zone" else {})})
    count, seconds = len(compilation.names) - before, compilation.seconds - since
    said = message("workflow.warm.done", count=count, seconds=seconds) if count else message("workflow.warm.nothing")
    return Result(count, (said,), {"kernels": float(count), "compiling_s": seconds})


def _do(name: str, values: Mapping[str, object]) -> None:
    job = load(name)
    job.run(job.settings.model_validate(values))


SOURCE = Path(__file__).parents[2] / "docs"
"""Folder of the pages in a copy of the repository; an installed package has none."""


class DocsSettings(CommandSettings):
    NEXT: ClassVar[str] = "demo"
    page: Annotated[
        str | None, option("Page to open, such as zone or troubleshooting; default the first.", metavar="PAGE", positional=True)
    ] = None
    browser: Annotated[bool, BROWSER] = True


@workflow
def run_docs(settings: DocsSettings, progress: Progress = silent) -> Result:
    """Build the site where its pages have changed, and open a page of it."""
    pages = sorted(SOURCE.glob("*.md"))
    if not (SOURCE / "build_site.py").is_file():
        raise LMeasureError(message("error.docs_not_installed"))
    names = [page.stem for page in pages if page.stem != "README"]
    if settings.page is not None and settings.page not in names:
        raise SettingsError("page", message("error.is_not_one_of_2", name=settings.page, templates=", ".join(names)))
    site = SOURCE.parent / "build" / "docs"
    first = site / "index.html"
    if not first.is_file() or first.stat().st_mtime < max(page.stat().st_mtime for page in (*pages, SOURCE.parent / "README.md")):
        if find_spec("sphinx") is None:
            raise LMeasureError(message("error.docs_not_built"))
        progress(0.0, "docs")
        done = subprocess.run(
            [sys.executable, SOURCE / "build_site.py", "--no-browser"],
            capture_output=True,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        if done.returncode:
            raise LMeasureError(message("error.docs_failed", line=((done.stderr or done.stdout).strip().splitlines() or [""])[-1]))
    opened = first if settings.page is None else site / "docs" / f"{settings.page}.html"
    return Result(opened, (message("workflow.docs.page", page=opened),), page=opened)


Serve = Callable[["WorkbenchSettings", Callable[[str], None], Callable[[str], object] | None], None]
"""Serves a project until it is ended: by its settings, a function that is called with an address for one browser, and one that opens a
browser, or None."""


class WorkbenchSettings(CommandSettings):
    NEXT: ClassVar[str] = "workbench {folder}"
    folder: Annotated[Path, option("Project folder; created if it does not exist.", metavar="FOLDER", positional=True)] = Path()
    within: Annotated[Path | None, option("Folder of projects: the page Home opens and creates projects in it.", metavar="FOLDER")] = None
    port: Annotated[int, option("Port to listen on; 0 uses a free one.", ge=0, le=65535)] = 0
    host: Annotated[
        str, option("Name of this machine for browsers of other machines; needs --tls-certificate and --tls-key.", metavar="NAME")
    ] = ""
    tls_certificate: Annotated[Path | None, option("With --host: certificate of that name, with its chain.", metavar="FILE.pem")] = None
    tls_key: Annotated[Path | None, option("With --host: key of the certificate, without a password.", metavar="FILE.pem")] = None
    scheduler: Annotated[str | None, option("Dask scheduler for the jobs batch and zone.", metavar="tcp://HOST:PORT")] = None
    browser: Annotated[bool, BROWSER] = True
    language: Annotated[Literal["en", "ru"], option("Language of the jobs' output (en, ru); pages use the browser's language.")] = "en"

    def paths(self) -> Paths:
        return Paths((), present(self.tls_certificate, self.tls_key))


@workflow
def run_workbench(settings: WorkbenchSettings, progress: Progress = silent, *, serve: Serve) -> Result:
    """Serve the pages until Ctrl-C; progress gets where."""
    if settings.within is not None and settings.folder.resolve().parent != settings.within.resolve():
        raise SettingsError("folder", message("error.is_no_folder_of_within", where=settings.folder, within=settings.within))
    if settings.folder.exists() and not settings.folder.is_dir():
        raise SettingsError("folder", message("error.is_a_file_no", where=settings.folder))
    if len({bool(settings.host), settings.tls_certificate is not None, settings.tls_key is not None}) > 1:
        raise SettingsError("host", message("error.host_needs_tls"))
    try:
        settings.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError("folder", message("error.cannot_be_made", where=settings.folder, error=os_reason(error))) from error

    show = None
    if settings.browser:
        import webbrowser

        show = webbrowser.open
    serve(settings, lambda address: progress(0.0, address), show)
    return Result(None, ())
