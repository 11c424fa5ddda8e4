"""From a short run of a calibrated instrument to a verdict: fit for use, or to be calibrated again."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from lmeasure.core import SettingsError
from lmeasure.text import message, of_terminal
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, workflow
from lmeasure.workflows.settings import LANGUAGE, RERUN, START, Distances, Paths, Recording, Start, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.procedures import Checked, Closure
    from lmeasure.view import Series

CALIBRATE_AGAIN = "plan-poses {rig} --poses 12 --box=-300:300,-300:300,-300:300 --out planned.csv"


class Settings(Writing):
    """Settings of `lmeasure check-instrument`."""

    run: Annotated[
        Path, option("Run folder of the check: stops at several positions, each twice, and the return.", metavar="RUN", positional=True)
    ]
    out: Annotated[Path, option("Folder for check.json and check.html.", metavar="DIR")]
    rig: Annotated[Path | None, option("rig.toml with a linked calibration, instead of the run's own.")] = None
    start: Annotated[Start | None, option(f"Start pose, instead of the run's: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    distance: Annotated[
        Distances,
        option(
            "Known distance of the tool origin between two positions (P1, P2, ... in the order of their first visits), mm, and its "
            "standard uncertainty. Separate several with ';'.",
            metavar="NAME1,NAME2,mm,u",
        ),
    ] = ()
    repeatability_mm: Annotated[float | None, option("Standard deviation of the robot's repeatability, per axis.", ge=0.0, le=10.0)] = None
    near_mm: Annotated[float, option("Largest distance between stops at the same position.", ge=0.01, le=1000.0)] = 2.0
    false_alarm_percent: Annotated[float, option("Part of checks of a sound instrument that may fail.", ge=0.001, le=50.0, unit="%")] = 1.0
    trend: Annotated[Path | None, option("Table to append this check to; its report shows all checks.", metavar="FILE.csv")] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        """Return the command that reconstructs the run."""
        return then("reconstruct {run} --out {run}/trajectory.parquet", run=self.run)

    def paths(self) -> Paths:
        """A record and a page from a run."""
        start = None if self.start is None else Path(self.start)
        return Paths(
            (*inside(self.out, "check.json", "check.html"), *present(self.rerun)), (*in_run_folder(self.run), *present(self.rig, start))
        )


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Checked]":
    """Check, append to the trend, and write record and page."""

    from lmeasure.calibration import Distance
    from lmeasure.io import files
    from lmeasure.procedures import Limits, appended, as_dict, check_instrument, now, said, verdict_text
    from lmeasure.recording import read_run, stated_start
    from lmeasure.report import write_check_page
    from lmeasure.workflows.settings import distances

    if settings.trend is not None and settings.trend.suffix.lower() != ".csv":
        raise SettingsError("trend", message("error.does_not_end_in", trend=str(settings.trend)))
    recorded = read_run(settings.run, settings.rig, None if settings.start is None else stated_start(settings.start))
    progress(0.2, "check")
    known = [Distance(*each) for each in distances(settings.distance)]
    limits = Limits(settings.false_alarm_percent / 100.0, settings.near_mm, settings.repeatability_mm)
    found = check_instrument(recorded, known, limits)
    progress(0.8, "writing")
    when = now()
    sources = [path for path in in_run_folder(settings.run) if path.is_file()] + list(present(settings.rig))
    inputs = [(path.name, files.sha256(path)) for path in sources]
    content = as_dict(found) | {"time": when, "inputs": [{"file": name, "sha256": digest} for name, digest in inputs]}
    with ExitStack() as together:
        # the page, the record and the line of the trend are of one check: all or none
        trend = (
            None
            if settings.trend is None
            else appended(settings.trend, found, when, into=together.enter_context(files.whole(settings.trend)))
        )
        record, page = (together.enter_context(files.whole(settings.out / name)) for name in ("check.json", "check.html"))
        files.write_json(record, content)
        write_check_page(page, found, trend, inputs=inputs, language=settings.language or of_terminal(), when=when)
    if settings.rerun is not None:
        from lmeasure.view import write_scene

        series = _series(found.closures)
        places, notes = (found.stops.names, found.stops.poses[:, :3]), (verdict_text(found), *said(found))
        write_scene(settings.rerun, found.rig, rig=recorded.rig, points={"stops": places}, series=series, notes=notes)
    stops = tuple(
        message("check_line.stop", name=name, s=begin) for name, begin in zip(found.stops.names, found.stops.begin_s, strict=True)
    )
    lines: list[str] = [message("workflows.stops", stops=stops)]
    lines += [_told(c, failed=c in found.failed) for c in found.closures]
    if found.agreement is not None:
        reported = found.agreement
        code = "check_line.disagree" if found.disagrees else "check_line.agree"
        lines.append(message(code, chi=reported.chi_squared, freedom=reported.freedom, p=reported.probability))
    lines += [message("line.note", text=note) for note in said(found)]
    written = message("workflow.written_4", v0=settings.out / "check.json", v1=settings.out / "check.html")
    appended_to = () if settings.trend is None else (message("workflows.appended", path=settings.trend),)
    worst = {kind: max(abs(c.value_mm) for c in found.closures if c.kind == kind) for kind in dict.fromkeys(c.kind for c in found.closures)}
    return Result(
        found,
        (*lines, verdict_text(found), written, *appended_to),
        {f"{kind}_mm": value for kind, value in worst.items()},
        () if found.passed else (verdict_text(found),),
        next="" if found.passed else then(CALIBRATE_AGAIN, rig=settings.rig or settings.run / "rig.toml"),
    )


def _series(every: "tuple[Closure, ...]") -> "dict[tuple[str, str], Series]":
    """Return the closures by kind, each with its U95 as a band."""
    import numpy as np

    from lmeasure.view import Series

    kinds = {kind: [c for c in every if c.kind == kind] for kind in dict.fromkeys(c.kind for c in every)}
    mm = {kind: np.array([(c.value_mm, c.u95_mm) for c in found]) for kind, found in kinds.items()}
    return {("closure_mm", kind): Series(values[:, 0], values[:, 1]) for kind, values in mm.items()}


def _told(closure: "Closure", *, failed: bool) -> str:
    value = round(closure.value_mm, 4) + 0.0  # nothing has no sign
    values = {"value": value, "u95": closure.u95_mm, "p": closure.probability}
    code = "check_line.closure_off" if failed else "check_line.closure"
    return message(code, kind=message(f"check_line.kind.{closure.kind}"), name=closure.name, **values)
