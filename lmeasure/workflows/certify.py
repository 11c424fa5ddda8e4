"""Certification: from a measurement to a certificate a third party can recompute."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from lmeasure.core import CertificationError, OtherTrajectoryError, SettingsError, pasted
from lmeasure.text import Message, Say, from_stated, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.reconstruct import check_joints
from lmeasure.workflows.settings import (
    COLUMNS,
    LANGUAGE,
    RERUN,
    TRAJECTORY,
    U_POSITION,
    U_ROTATION,
    CommandSettings,
    Paths,
    Point,
    Recording,
    Writing,
    known_convention,
    option,
    refuse,
    stated_beside,
    then,
)

CHOICES = "What is certified"


class CertifySettings(Writing):
    NEXT: ClassVar[str] = "verify {out}"
    trajectory: Annotated[Path, option(TRAJECTORY, metavar="TRAJECTORY", positional=True)]
    program: Annotated[Path, option("Commanded poses and paths with their windows.", metavar="program.toml")]
    out: Annotated[Path, option("Folder to write; --force replaces an earlier certificate.", metavar="DIR")]
    run: Annotated[Path | None, option("Run folder of the trajectory: its counts are certified and copied too.")] = None
    rig: Annotated[Path | None, option("Rig of the reconstruction, if not the run's own.")] = None
    constraint: Annotated[str | None, option("Constraint of the reconstruction.")] = None
    repeatability_mm: Annotated[float, option("Standard deviation of the robot between passes, as in `reconstruct`.", ge=0.0)] = 0.0
    continuous: Annotated[
        bool, option("The trajectory is the curve of `reconstruct --continuous`: evaluate it between samples too, with its own errors.")
    ] = False
    joints: Annotated[
        Path | None,
        option("Joint log of the robot (time_s, joint_1_deg, ...) as a prior of the curve's shape; with --robot.", metavar="LOG.csv"),
    ] = None
    robot: Annotated[str | None, option("Robot of --joints: a name (such as ur5) or a robot.toml.", metavar="NAME_OR_FILE")] = None
    columns: Annotated[str, COLUMNS] = ""
    u_position_mm: Annotated[float | None, U_POSITION] = None
    u_rotation_deg: Annotated[float | None, U_ROTATION] = None
    details: Annotated[Path | None, option("Laboratory, customer, item, dates, traceability ...", metavar="details.toml")] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    key: Annotated[Path | None, option("Sign with this private key (`lmeasure key`).", metavar="FILE")] = None
    dcc: Annotated[bool, option("Also write certificate.xml, a DCC 3.3.0.")] = False
    xsd: Annotated[Path | None, option("Validate the DCC with this schema.", metavar="FILE.xsd")] = None
    tables: Annotated[bool, option("Also write certificate.xlsx (with formulas), .csv and .mat.")] = False
    zipped: Annotated[bool, option("Also write DIR.zip, and its digest next to it.", flag="--zip")] = False
    rerun: Annotated[Recording | None, RERUN] = None
    full: Annotated[bool, option("Print all results, not only the main ones.")] = False
    align: Annotated[bool, option("Fit the program's frame to the attained poses.", panel=CHOICES)] = False
    tool_offset_mm: Annotated[Point, option("Point of the tool to certify.", metavar="X,Y,Z", panel=CHOICES)] = (0.0, 0.0, 0.0)
    angles: Annotated[
        str | None, option("Convention of component-wise angles and of the file's angles; default the program's.", panel=CHOICES)
    ] = None
    capability: Annotated[float, option("Largest U95 as a part of the result, for a verdict.", ge=0.0, le=1.0, panel=CHOICES)] = 0.25
    limit_deg: Annotated[float, option("Largest pressure angle for a verdict.", ge=0.0, le=90.0, panel=CHOICES)] = 60.0
    limit_u95_mm: Annotated[float | None, option("Largest U95 of a pose for a verdict.", ge=0.0, panel=CHOICES)] = None
    rule: Annotated[
        Literal["simple", "guarded"] | None,
        option("Decision rule for tolerances: simple or guarded; default as in the details, else guarded.", panel=CHOICES),
    ] = None
    still_mm: Annotated[float, option("Largest motion within a pose window.", ge=0.0, panel=CHOICES)] = 0.2
    trials: Annotated[int, option("Number of Monte Carlo trials.", ge=100, panel=CHOICES)] = 4000
    seed: Annotated[int, option("Seed of Monte Carlo.", ge=0, panel=CHOICES)] = 0

    def paths(self) -> Paths:
        folder, zipped = self.out, f"{self.out.resolve().name}.zip"
        packed = inside(folder.resolve().parent, zipped, f"{zipped}.sha256") if self.zipped else ()
        read = (self.trajectory, self.program, *present(self.details, self.key, self.xsd, self.joints))
        return Paths((*inside(folder, "manifest.json"), *packed, *present(self.rerun)), read)


@workflow
def run_certify(settings: CertifySettings, progress: Progress = silent) -> Result:
    """Evaluate the measurement and write the sealed folder; the result is the certificate."""
    from lmeasure.certificate import Details, Inputs, read_details
    from lmeasure.iso9283 import CertificationSettings
    from lmeasure.report import Choices, every_figure, headline, write_certificate

    if not settings.dcc:
        refuse(settings, message("refuse.dcc"), "xsd")
    if settings.run is None:
        refuse(
            settings,
            message("refuse.run"),
            "rig",
            "constraint",
            "continuous",
            *(("repeatability_mm",) if settings.repeatability_mm else ()),
        )
    check_joints(settings.joints, settings.robot, continuous=settings.continuous)
    if settings.continuous and settings.repeatability_mm:
        raise SettingsError("continuous", message("curve.linear"))
    beside = ("columns", "u_position_mm", "u_rotation_deg")
    if settings.run is not None:
        refuse(settings, message("refuse.elsewhere"), *beside)
    known_convention(settings.angles)
    template = Details() if settings.details is None else read_details(settings.details)
    same = ("align", "angles", "tool_offset_mm", "capability", "limit_u95_mm", "still_mm", "trials", "seed")
    own = {name: getattr(settings, name) for name in same}
    chosen = CertificationSettings(limit_angle_deg=settings.limit_deg, rule=settings.rule or template.rule or "guarded", **own)
    measured = (
        "trajectory",
        "program",
        "run",
        "rig",
        "details",
        "constraint",
        "repeatability_mm",
        "continuous",
        "joints",
        "robot",
        *beside,
    )
    inputs = Inputs(**{name: getattr(settings, name) for name in measured})
    as_written = ("key", "dcc", "xsd", "zipped", "force", "tables")
    choices = Choices(settings.language or template.language or of_terminal(), **{name: getattr(settings, name) for name in as_written})
    try:
        content = write_certificate(settings.out, inputs, chosen, choices, progress=steps(progress, "certify"))
    except OtherTrajectoryError as error:
        if settings.rig is not None:
            raise
        raise OtherTrajectoryError(message("error.if_it_was_reconstructed", error=error)) from None
    if settings.rerun is not None:
        _record(settings, settings.rerun, content)
    lines = [*(every_figure(content) if settings.full else ()), *headline(content, settings.out)]
    assumed = _assumed(content)
    notes = [*_strange(content), *(line.text(content["language"]) for line in assumed)]
    lines += notes
    figures = _figures(content) | _assumed_figures(assumed)
    written = tuple(sorted(p for p in settings.out.rglob("*") if p.is_file()))
    return Result(content, tuple(lines), figures, tuple(notes), files=written)


def _record(settings: CertifySettings, path: Path, content: dict[str, Any]) -> None:
    """Draw the commanded and attained poses, the trajectory, and the results of each pose with their U95."""
    from dataclasses import replace

    import numpy as np

    from lmeasure.recording import read_program
    from lmeasure.rig import read_linked_rig
    from lmeasure.trajectory import read_trajectory
    from lmeasure.view import Series, write_scene

    program = read_program(settings.program)
    trajectory = read_trajectory(settings.trajectory, replace(stated_beside(settings), likely=program.angles))
    of_run = None if settings.run is None else settings.run / "rig.toml"
    rig = settings.rig or of_run
    points = [(a["pose"], a["mean_mm"]) for a in content["attained"]]
    rows = {p.name: i for i, p in enumerate(program.pose)}
    series: dict[tuple[str, str], Series] = {}
    for name, unit in dict.fromkeys((c["name"], c["unit"]) for c in content["characteristics"] if c.get("pose") in rows):
        table = np.full((2, len(rows)), np.nan)
        for c in content["characteristics"]:
            if c["name"] == name and c.get("pose") in rows:
                table[:, rows[c["pose"]]] = np.array([c["value"], c["u95"]], dtype=np.float64)
        stated = np.isfinite(table[1]).any()
        group = f"{name.partition('_')[0]}_{unit.replace('/', '_').replace('%', 'percent')}"
        series[group, name] = Series(table[0], table[1] if stated else None)
    write_scene(
        path,
        content["id"],
        rig=None if rig is None else read_linked_rig(rig)[0],
        program=program,
        points={"attained": ([name for name, _ in points], np.array([mm for _, mm in points]).reshape(-1, 3))},
        moving=(trajectory.time_s, trajectory.poses),
        series=series,
        notes=content["notes"],
    )


TURNED_DEG = 90.0
"""Turn from which the tool was nowhere at its command: quaternions or frames differ from the stated ones."""


def _strange(content: dict[str, Any]) -> list[str]:
    """Return results that no robot can have, in the language of the certificate."""
    off = [c["value"] for c in content["characteristics"] if c["name"] == "AP_rot" and c["value"] is not None]
    if not off or min(off) < TURNED_DEG:
        return []
    say = Say(content["language"])
    return [say("certify.note_every_pose_tool", least=min(off))]


def _assumed(content: dict[str, Any]) -> list[Message]:
    """Return the lines about assumed typical sizes; empty if all is stated, or exact by statement."""
    every = [from_stated(e) for e in content.get("findings", ())]
    found = [m for m in every if m is not None and m.code.startswith("assumed.")]
    return found if any(m.code == "assumed.part" for m in found) else []


def _assumed_figures(lines: list[Message]) -> dict[str, float]:
    """Return the numbers of these lines, named as those of a trajectory."""
    by_code = {line.code: line.values for line in lines}
    if "assumed.part" not in by_code:
        return {}
    part = by_code["assumed.part"]
    stated = {f"u95_if_stated_{m.values['key']}_mm": m.values["then"] for m in lines if m.code == "assumed.statement"}
    return {"largest_u95_position_mm": part["u95"], "largest_u95_assumed_mm": part["part"]} | stated


def _figures(content: dict[str, Any]) -> dict[str, float]:
    """Return how many there are and of how many the instrument is capable, and the largest of the lengths that matter most."""
    from lmeasure.iso9283 import trend_names

    every = content["characteristics"]
    largest = {name: [c["value"] for c in every if c["name"] == name and c["value"] is not None] for name in trend_names()}
    counted = {"characteristics": float(len(every)), "capable": float(sum(c["capable"] is True for c in every))}
    return counted | {f"largest_{name}_mm": max(values) for name, values in largest.items() if values}


class VerifySettings(CommandSettings):
    NEXT: ClassVar[str] = "inspect {bundle}"
    bundle: Annotated[Path, option("Folder or zip that `certify` wrote.", metavar="DIR|FILE.zip", positional=True)]
    public_key: Annotated[Path | None, option("Public key of the expected signer, or a folder of authorised keys.", metavar="FILE|DIR")] = (
        None
    )


@workflow
def run_verify(settings: VerifySettings, progress: Progress = silent) -> Result:
    """Check every byte and compute every result again; the exit code gives the outcome."""
    from lmeasure.certificate import opened_zip, read_public_key, report_lines, verify
    from lmeasure.report import PRINTERS

    names = _authorised(settings.public_key)
    key = None if settings.public_key is None or names else read_public_key(settings.public_key)
    step = steps(progress, "verify")
    if settings.bundle.is_dir():
        found = verify(settings.bundle, key, PRINTERS, step)
    else:
        with tempfile.TemporaryDirectory() as scratch, opened_zip(settings.bundle, Path(scratch)) as folder:
            found = verify(folder, key, PRINTERS, step)
    if names:
        found = replace(found, authorised=names.get(found.signer or "", ""))
    figures: dict[str, float] = {"figures": found.figures, "differences": len(found.differences), "not_compared": len(found.skipped)}
    figures |= {"largest_relative_difference": found.largest} if found.figures else {}
    return Result(found, tuple(report_lines(found, requested=key is not None)), figures, exit_code=found.exit_code)


def _authorised(path: Path | None) -> dict[str, str]:
    """Return the names of the keys of a folder, such as a register's keys/, by their fingerprints; none where it is no folder."""
    from lmeasure.certificate import fingerprint, read_public_key

    if path is None or not path.is_dir():
        return {}
    keys = {fingerprint(read_public_key(key)): key.name.split(".")[0] for key in sorted(path.glob("*.pub"))}
    if not keys:
        raise CertificationError(message("error.holds_no_public_key", where=path))
    return keys


class CompareSettings(Writing):
    OUT_FILE: ClassVar[str] = "comparison.json"
    certificates: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option(
            "Folders of certificates or certificate.json files, or two calibrations; the earlier one first.",
            metavar="CERTIFICATE...",
            positional=True,
        ),
    ]
    out: Annotated[Path | None, option("JSON file to write all results of the comparison to.", metavar="FILE.json")] = None

    page: Annotated[
        Path | None, option("Folder for a report with both side by side, and the effect of a correction between them.", metavar="FILE.html")
    ] = None
    corrections: Annotated[
        Path | None,
        option("corrections.json of `lmeasure correct`: also list the remaining error of the kinematic calibration.", metavar="FILE"),
    ] = None
    between: Annotated[
        bool, option("Compare the results of several laboratories for one robot: consensus, degrees of equivalence, E_n. Also takes DCCs.")
    ] = False
    common_mm: Annotated[float, Field(ge=0), option("Standard uncertainty that all laboratories share, for results in mm.")] = 0.0
    artefact_mm: Annotated[float, Field(ge=0), option("Standard uncertainty of the robot between the measurements, for results in mm.")] = (
        0.0
    )
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def following(self) -> str:
        if self.page is not None or self.between:
            return then("verify {first}", first=self.certificates[0])
        return then(f"compare {' '.join(map(pasted, self.certificates))} --page comparison.html")

    def paths(self) -> Paths:
        read = [path / name for path in self.certificates for name in ("certificate.json", "calibration.json", "rig.toml")]
        return Paths(present(self.out, self.page), (*self.certificates, *read, *present(self.corrections)))


@workflow
def run_compare(settings: CompareSettings, progress: Progress = silent) -> Result:
    """Compare, and write the figures where requested."""
    if settings.between or any(path.suffix.lower() == ".xml" for path in settings.certificates):
        return _laboratories(settings)
    if stray := next((name for name in ("common_mm", "artefact_mm") if getattr(settings, name)), None):
        raise SettingsError(stray, message("error.goes_with_between"))
    if any(_is_calibration(path) for path in settings.certificates):
        return _calibrations(settings)
    from lmeasure.certificate import CERTIFICATE, as_dict, canonical, compare_certificates, improvement, lines, read_certificate
    from lmeasure.io import files
    from lmeasure.report import reported as of_improvement, write_comparison_page
    from lmeasure.robot_programs import identified_mm

    read = [(str(path), read_certificate(path / CERTIFICATE if path.is_dir() else path)) for path in settings.certificates]
    found = compare_certificates(read)
    progress(1.0, "compare")
    reported, better = list(lines(found)), None
    if len(read) == 2:
        by_name = dict(read)
        first, later = (by_name[name] for name in found.names)
        left = None if settings.corrections is None else identified_mm(settings.corrections)
        better = improvement(first, later, left) if any(pair.shifts for pair in found.pairs) else None
    if settings.corrections is not None and better is None:
        raise SettingsError("corrections", message("error.tells_of_two_certificates"))
    if settings.corrections is not None and better is not None:
        reported += of_improvement(better)
    # nothing is written before all that is read has been
    if settings.out is not None:
        files.write_text(settings.out, canonical(as_dict(found)).decode("utf-8"))
    if settings.page is not None:
        contents = [(name, dict(read)[name]) for name in found.names]
        write_comparison_page(settings.page, found, contents, better, language=settings.language or of_terminal())
    written = [str(path) for path in (settings.out, settings.page) if path is not None]
    reported += [message("line.written", files=tuple(written))] if written else []
    shifts = [shift.distance_mm for pair in found.pairs for shift in pair.shifts]
    figures = {"certificates": float(len(read)), "compared": float(sum(len(pair.changes) for pair in found.pairs))}
    figures |= {"largest_shift_mm": max(shifts)} if shifts else {}
    figures |= {"largest_exchangeability_mm": max(e.value_mm for e in found.exchangeability)} if found.exchangeability else {}
    return Result(found, tuple(reported), figures)


def _laboratories(settings: CompareSettings) -> Result:
    """Compare laboratories."""
    from lmeasure.certificate import as_json, canonical, compare_laboratories, laboratory_lines, read_laboratory
    from lmeasure.io import files

    if stray := next((name for name in ("page", "corrections") if getattr(settings, name) is not None), None):
        raise SettingsError(stray, message("error.does_not_go_with"))
    laboratories = [read_laboratory(path) for path in settings.certificates]
    found = compare_laboratories(laboratories, common_mm=settings.common_mm, artefact_mm=settings.artefact_mm)
    if settings.out is not None:
        files.write_text(settings.out, canonical(as_json(found)).decode("utf-8"))
    apart = {e.laboratory for one in found for e in one.laboratories if abs(e.e_n) > 1.0}
    figures = {"laboratories": float(len(laboratories)), "results": float(len(found)), "apart": float(len(apart))}
    figures["largest_e_n"] = max(abs(e.e_n) for one in found for e in one.laboratories)
    return Result(found, tuple(laboratory_lines(found)), figures)


def _is_calibration(path: Path) -> bool:
    return path.name == "calibration.json" or (path / "calibration.json").is_file()


def _calibrations(settings: CompareSettings) -> Result:
    """Return the changes between two calibrations, by their records."""
    from dataclasses import asdict

    from lmeasure.calibration import compare_records, comparison_summary, read_earlier
    from lmeasure.certificate import canonical
    from lmeasure.io import files

    other = next((path for path in settings.certificates if not _is_calibration(path)), None)
    if other is not None:
        raise SettingsError("certificates", message("error.holds_no_calibration_json", where=other))
    if len(settings.certificates) != 2:
        raise SettingsError("certificates", message("error.of_calibrations_two_are"))
    refuse(settings, message("refuse.certificates"), "page", "corrections")
    found = compare_records(*map(read_earlier, settings.certificates))
    if settings.out is not None:
        files.write_text(settings.out, canonical(asdict(found)).decode("utf-8"))
    figures = {"largest_shift_mm": found.together.distance_mm, "moved": float(sum(p.moved for p in found.points))}
    return Result(found, tuple(comparison_summary(found).splitlines()), figures, found.notes)


class KeySettings(Writing):
    NEXT: ClassVar[str] = "certify trajectory.parquet --program program.toml --key {out} --out certificate"
    OUT_FILE: ClassVar[str] = "key.pem"
    out: Annotated[Path, option("Private key to write; the public key is FILE.pub.", metavar="FILE")]

    def paths(self) -> Paths:
        return Paths((self.out, Path(f"{self.out}.pub")))


@workflow
def run_key(settings: KeySettings, progress: Progress = silent) -> Result:
    """Write both keys; the result is their fingerprint."""
    from lmeasure.certificate import new_key

    fingerprint, public = new_key(settings.out, force=settings.force), Path(f"{settings.out}.pub")
    reported = (
        message("workflows.private_key_public_key", file=settings.out, public=public),
        message("workflows.fingerprint", fingerprint=fingerprint),
    )
    return Result(fingerprint, reported)


class QualifySettings(Writing):
    NEXT: ClassVar[str] = "certify trajectory.parquet --program program.toml --out certificate"
    out: Annotated[Path, option("Folder for qualification.json and qualification.pdf.", metavar="DIR")]
    key: Annotated[Path | None, option("Sign qualification.json with this private key.", metavar="FILE")] = None

    def paths(self) -> Paths:
        names = ("qualification.json", "qualification.pdf", *(("signature.json",) if self.key else ()))
        return Paths(inside(self.out, *names), present(self.key))


@workflow
def run_qualify(settings: QualifySettings, progress: Progress = silent) -> Result:
    """Run all checks and write the report."""
    from lmeasure.certificate import read_private_key
    from lmeasure.qualification import check_text, run_checks, write_qualification

    if settings.key is not None:
        read_private_key(settings.key)  # check the key before the long computation
    checks = run_checks(steps(progress, "qualify"))
    settings.out.mkdir(parents=True, exist_ok=True)
    content = write_qualification(settings.out, checks, settings.key)
    lines = [
        message("qualify.passed" if c.passed else "qualify.failed", check=check_text(c), found=c.found, wanted=c.wanted) for c in checks
    ]
    failed = [c for c in checks if not c.passed]
    lines.append(message("qualify.qualified" if not failed else "qualify.not_qualified", count=len(checks), failed=len(failed)))
    figures = {"checks": float(len(checks)), "failed": float(len(failed))}
    return Result(content, tuple(lines), figures, exit_code=1 if failed else 0)
