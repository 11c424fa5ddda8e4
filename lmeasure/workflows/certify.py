"""From a measurement to a certificate a third party can recompute."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from lmeasure.core import OtherTrajectoryError, SettingsError
from lmeasure.text import Message, Say, from_stated, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import (
    COLUMNS,
    LANGUAGE,
    RERUN,
    TRAJECTORY,
    U_POSITION,
    U_ROTATION,
    Paths,
    Point,
    Recording,
    Writing,
    known_convention,
    option,
    refuse,
    stated_beside,
)

CHOICES = "What is certified"


class Settings(Writing):
    """Settings of `lmeasure certify`; what is certified is chosen as in `lmeasure.CertificationSettings`."""

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
        """A folder, which is replaced as a whole (`certificate.bundle.new_folder`) and known by its manifest, and a zip beside it."""
        folder, zipped = self.out, f"{self.out.resolve().name}.zip"
        packed = inside(folder.resolve().parent, zipped, f"{zipped}.sha256") if self.zipped else ()
        read = (self.trajectory, self.program, *present(self.details, self.key, self.xsd))
        return Paths((*inside(folder, "manifest.json"), *packed, *present(self.rerun)), read)


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[dict[str, Any]]:
    """Evaluate the measurement and write the sealed folder; what was made is the certificate."""
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
    measured = ("trajectory", "program", "run", "rig", "details", "constraint", "repeatability_mm", "continuous", *beside)
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


def _record(settings: Settings, path: Path, content: dict[str, Any]) -> None:
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
"""From which on the tool was nowhere as it was commanded: quaternions or frames are others than stated."""


def _strange(content: dict[str, Any]) -> list[str]:
    """Return what no robot does, in the language of the certificate."""
    off = [c["value"] for c in content["characteristics"] if c["name"] == "AP_rot" and c["value"] is not None]
    if not off or min(off) < TURNED_DEG:
        return []
    say = Say(content["language"])
    return [say("certify.note_every_pose_tool", least=min(off))]


def _assumed(content: dict[str, Any]) -> list[Message]:
    """Return the lines about typical sizes that nobody stated; none where all is stated, or exact by statement."""
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
