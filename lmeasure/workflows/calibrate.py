"""Calibration: observation points from reference poses and counts."""

import datetime
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from lmeasure.core import CalibrationError, SettingsError
from lmeasure.text import message, of_terminal
from lmeasure.workflows.flow import Progress, Result, in_run_folder, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import (
    COLUMNS,
    LANGUAGE,
    RERUN,
    START,
    Distances,
    Names,
    Paths,
    Recording,
    Start,
    Writing,
    distances,
    option,
    radians_of,
    refuse,
    then,
)

if TYPE_CHECKING:
    from lmeasure.calibration import Calibration, Campaign
    from lmeasure.procedures import Closure
    from lmeasure.rig import CalibrationRecord
    from lmeasure.view import Series


class CalibrateSettings(Writing):
    NEXT: ClassVar[str] = "zone {out}/rig.toml --report {out} --out {out}/zone.nc"
    folder: Annotated[
        Path,
        option(
            "Calibration folder with rig.toml (nominal), reference_poses.csv, counts.csv; with --self and --continue, a run folder too.",
            metavar="FOLDER",
            positional=True,
        ),
    ]
    out: Annotated[Path, option("Folder for rig.toml, calibration.json and report.html.")]
    solve: Annotated[
        Names,
        option(
            "Parameters, default all uncertain ones: position, guide, radius, scale, tangent, axial, pitch, attachment; run-out, "
            "eccentricity, offset, diameter, backlash, tilt. For one observation point: run-out:B3."
        ),
    ] = ()
    neighbourhood_mm: Annotated[float, option("Half width of the search around the nominal and coarse positions.", ge=1e-3, le=1e5)] = 100.0
    neighbourhood_deg: Annotated[float, option("Half width of the search around the nominal guide angles.", ge=1e-3, le=180)] = 15.0
    prior: Annotated[bool, option("Use the nominal rig's priors for all parameters, not only for unobservable ones.")] = False
    robust: Annotated[bool, option("Use a robust loss (Tukey's biweight) against wrong reference poses.")] = False
    hold_out: Annotated[Names, option("Validation poses: reference poses that are not in the fit.", metavar="POSE,POSE,...")] = ()
    seed: Annotated[int, option("Seed of the LP-search.", ge=0)] = 0
    self_calibration: Annotated[
        bool, option("Estimate the poses too, without references. Needs seven cables to a body, or four to one point.", flag="--self")
    ] = False
    continued: Annotated[
        bool, option("Refine the linked calibration of a run's rig with this run, if the rig has not moved since.", flag="--continue")
    ] = False
    distance: Annotated[
        Distances,
        option(
            "With --self: known distance of the tool origin between two poses (of a run: start, or times in s), mm, and its standard "
            "uncertainty. Separate several with ';'.",
            metavar="NAME1,NAME2,mm,u",
        ),
    ] = ()
    rig: Annotated[Path | None, option("rig.toml to use instead of the run's own.")] = None
    start: Annotated[Start | None, option(f"Approximate start pose, instead of the run's: {START}.", metavar="X,Y,Z,O,A,T|FILE")] = None
    samples: Annotated[int, option("Number of samples of a run to use, as different as possible.", ge=10, le=200)] = 40
    frame: Annotated[Literal["rig", "poses"], option("Frame for --self: rig (nominal) or poses (reference).")] = "rig"
    u_position_mm: Annotated[
        float | None, option("Standard uncertainty of each coordinate of the reference poses; default from their file.", ge=0)
    ] = None
    u_rotation_deg: Annotated[
        float | None, option("Standard uncertainty of their orientations, about each axis; default from their file.", ge=0)
    ] = None
    unstated: Annotated[
        Literal["typical", "exact"] | None,
        option("What a missing u_... key of the rig means, instead of its own unstated: typical, a typical size; exact, 0."),
    ] = None
    reference: Annotated[
        Literal["tracker", "robot", "unknown"] | None,
        option("Source of the reference poses, instead of the column in their file. The errors of a robot vary smoothly with the pose."),
    ] = None
    columns: Annotated[str, COLUMNS] = ""
    compare: Annotated[
        Path | None, option("Earlier output folder or calibration.json: report the parts that moved beyond chance.", metavar="OLD")
    ] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        made = inside(self.out, "rig.toml", "calibration.json", "report.html", "poses.csv")
        run = in_run_folder(self.folder) if (self.folder / "run.toml").is_file() else ()
        start = None if self.start is None else Path(self.start)
        read = (*inside(self.folder, "rig.toml", "reference_poses.csv", "counts.csv"), *run, *present(self.rig, start))
        if self.compare is not None:
            read = (*read, self.compare, self.compare / "calibration.json")
        return Paths((*made, *present(self.rerun)), read)


@workflow
def run_calibrate(settings: CalibrateSettings, progress: Progress = silent) -> Result:
    """Calibrate, and write rig, record and page. CalibrationError where the rig must not be used, which is then not written."""
    from lmeasure.calibration import (
        CalibrationSettings,
        Distance,
        calibrate,
        compare as comparing_compare,
        comparison_summary,
        read_earlier,
    )
    from lmeasure.recording import write_poses
    from lmeasure.report import write_calibration_page
    from lmeasure.rig import write_calibration_record, write_rig

    out = settings.out
    if settings.continued:
        return _continued(settings, progress)
    campaign = _campaign(settings)
    rig = campaign.rig if settings.unstated is None else campaign.rig.model_copy(update={"unstated": settings.unstated})
    campaign = replace(
        campaign, rig=rig, poses=campaign.poses.with_uncertainty(settings.u_position_mm, radians_of(settings.u_rotation_deg))
    )
    campaign = campaign if settings.reference is None else replace(campaign, source=settings.reference)
    earlier = None if settings.compare is None else read_earlier(settings.compare)
    fit = ("solve", "neighbourhood_mm", "neighbourhood_deg", "prior", "seed", "robust", "hold_out", "self_calibration", "frame")
    known = tuple(Distance(*each) for each in distances(settings.distance))
    chosen = CalibrationSettings(**{name: getattr(settings, name) for name in fit}, distances=known)
    result = _referred(calibrate(campaign, chosen, steps(progress, "calibrating")), settings.folder / "reference.xml")
    comparison = None if earlier is None else comparing_compare(earlier, result, settings.seed)
    write_calibration_page(out / "report.html", result, comparison, settings.language or of_terminal())
    write_calibration_record(out / "calibration.json", result.record)
    if result.refused is not None:
        # an earlier one would seem to belong to this record
        (out / "rig.toml").unlink(missing_ok=True)
        raise CalibrationError(message("error.no_rig_toml_is", where=settings.folder, refused=result.refused, out=out / "report.html"))
    write_rig(out / "rig.toml", result.rig)
    if result.record.poses:
        write_poses(out / "poses.csv", result.campaign.poses)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, result.rig, nominal=campaign.rig, reference=result.campaign.poses, record=result.record)
    compared = () if comparison is None else tuple(comparison_summary(comparison).splitlines())
    poses = f", {out / 'poses.csv'}" if result.record.poses else ""
    written = message("workflow.written", v0=out / "rig.toml", v1=out / "calibration.json", v2=out / "report.html", poses=poses)
    return Result(
        result,
        (*_lines(result.record), *compared, written),
        {p.name: p.value for p in result.record.parameters} | {"residual_rms_mm": result.record.noise["residual_rms_mm"]},
        tuple(f"{w.code}: {w.text}" for w in result.record.warnings),
        details=_details(result.record),
    )


def _referred(result: "Calibration", path: Path) -> "Calibration":
    """The calibration with warnings of its reference instrument, whose DCC may lie in the folder: today it is used."""
    from lmeasure.certificate import read_dcc
    from lmeasure.rig import Finding

    if not path.is_file():
        return result
    doubts = (Finding(code="reference", text=text) for text in read_dcc(path).doubts(datetime.date.today()))
    return replace(result, record=result.record.model_copy(update={"warnings": (*result.record.warnings, *doubts)}))


def _campaign(settings: CalibrateSettings) -> "Campaign":
    """The campaign of a calibration folder, or of a run whose poses are found with the rig."""
    from lmeasure.calibration import is_run, read_campaign, read_motion, without_slips
    from lmeasure.io import columns_of
    from lmeasure.recording import stated_start

    if not is_run(settings.folder):
        refuse(settings, message("refuse.run_folder"), "rig", "start")
        read = read_campaign(settings.folder, columns_of(settings.columns))
        return without_slips(read, str(settings.folder / "reference_poses.csv"))
    if not settings.self_calibration:
        raise CalibrationError(message("error.a_run_has_no", where=settings.folder))
    start = None if settings.start is None else stated_start(settings.start)
    times = tuple(name for a, b, _, _ in distances(settings.distance) for name in (a, b))
    return read_motion(settings.folder, settings.rig, start, samples=settings.samples, named=times)[0]


def _continued(settings: CalibrateSettings, progress: Progress) -> Result:
    """The record that a run's rig links, refined by the run, into a new folder."""
    from lmeasure.calibration import Calibration, continued, is_run, predict, predicted_entry, read_motion
    from lmeasure.recording import stated_start
    from lmeasure.report import write_calibration_page
    from lmeasure.rig import write_calibration_record, write_rig

    if not is_run(settings.folder):
        raise CalibrationError(message("error.continue_takes_a_run", where=settings.folder))
    start = None if settings.start is None else stated_start(settings.start)
    campaign, run = read_motion(settings.folder, settings.rig, start, samples=settings.samples)
    if run.calibration is None:
        raise CalibrationError(message("error.its_rig_links_no", where=settings.folder))
    progress(0.3, "continuing")
    found = continued(campaign, run.calibration)
    if found.moved is not None:
        raise CalibrationError(message("error.nothing_is_written", where=settings.folder, moved=found.moved))
    predicted = predict(campaign, found.rig, found.record, settings.seed)
    record = found.record.model_copy(update={"predicted": predicted_entry(campaign, predicted)})
    result = Calibration(found.rig, record, campaign, predicted)
    out = settings.out
    write_calibration_page(out / "report.html", result, None, settings.language or of_terminal())
    write_calibration_record(out / "calibration.json", record)
    write_rig(out / "rig.toml", found.rig)
    written = message("workflow.written_2", v0=out / "rig.toml", v1=out / "calibration.json", v2=out / "report.html")
    figures = {p.name: p.value for p in record.parameters}
    warnings = tuple(f"{w.code}: {w.text}" for w in record.warnings)
    return Result(result, (*_lines(record), written), figures, warnings, details=_details(record))


def _lines(record: "CalibrationRecord") -> list[str]:
    """Return the quality of a calibration, its checks, and its warnings."""
    lines: list[str] = []
    if lengths := record.predicted["lengths"]:
        rms, worst = [e["rms_mm"] for e in lengths], max(lengths, key=lambda e: e["worst_mm"])
        spread = {"least": min(rms), "most": max(rms), "worst": worst["worst_mm"]}
        lines.append(message("calibrated.lengths", **spread, cable=worst["cable"]))
    if "against_nominal" in record.validation:
        reported = record.validation["against_nominal"]
        lines.append(message("workflows.lengths_poses_left_out", rms=reported["rms_mm"], nominal=reported["nominal_mm"]))
    if "held_out" in record.validation:
        reported = record.validation["held_out"]
        part = 100 * reported["within_95"]
        lines.append(message("workflow.held_out", rms=reported["rms_mm"], expected=reported["expected_mm"], part=part))
    if points := [p for p in record.parameters if p.name.endswith(("x_mm", "y_mm", "z_mm"))]:
        least, most = min(points, key=lambda p: p.u), max(points, key=lambda p: p.u)
        name, number = most.name.removesuffix("_mm"), len(record.parameters)
        lines.append(message("calibrated.points", least=least.u, most=most.u, name=name, parameters=number))
    lines.append(message("workflows.residuals_mm_rms", rms=record.noise["residual_rms_mm"]))
    lines.append(message("workflows.equations_unknowns_rank", equations=record.equations, unknowns=record.unknowns, rank=record.rank))
    for e in record.effects:
        verdict = message("workflow.found") if e.found else message("workflow.not_told") if e.bits < 1.0 else message("workflow.not_found")
        size = f"{e.value:.3g} {e.unit}".rstrip()
        effect = {"effect": e.effect, "owner": e.owner, "size": size, "u": e.u, "p": e.probability, "bits": e.bits, "verdict": verdict}
        lines.append(message("workflows.effect_u_p_bits", **effect))
    return [*lines, *(message("line.warning", code=w.code, text=w.text) for w in record.warnings)]


def _details(record: "CalibrationRecord") -> tuple[str, ...]:
    """Return every parameter, and the predicted length of every cable."""
    return (
        *(f"{p.name:28s} {p.value:z14.4f}  u {p.u:.3g}" for p in record.parameters),
        *(
            message("workflows.predicted_over_workspace_cable", cable=e["cable"], rms=e["rms_mm"], worst=e["worst_mm"])
            for e in record.predicted["lengths"]
        ),
    )


CALIBRATE_AGAIN = "plan-poses {rig} --poses 12 --box=-300:300,-300:300,-300:300 --out planned.csv"


class CheckInstrumentSettings(Writing):
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
        return then("reconstruct {run} --out {run}/trajectory.parquet", run=self.run)

    def paths(self) -> Paths:
        start = None if self.start is None else Path(self.start)
        return Paths(
            (*inside(self.out, "check.json", "check.html"), *present(self.rerun)), (*in_run_folder(self.run), *present(self.rig, start))
        )


@workflow
def run_check_instrument(settings: CheckInstrumentSettings, progress: Progress = silent) -> Result:
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
        # page, record and line of the trend belong to one check: all or none
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
    lines += [_closure_line(c, failed=c in found.failed) for c in found.closures]
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


def _closure_line(closure: "Closure", *, failed: bool) -> str:
    value = round(closure.value_mm, 4) + 0.0  # nothing has no sign
    values = {"value": value, "u95": closure.u95_mm, "p": closure.probability}
    code = "check_line.closure_off" if failed else "check_line.closure"
    return message(code, kind=message(f"check_line.kind.{closure.kind}"), name=closure.name, **values)
