"""`lmeasure certify`: from a measurement to a certificate a third party can recompute."""

import math
from pathlib import Path
from typing import Annotated

import typer

CHOICES = "What is certified"


def certify(
    trajectory: Annotated[Path, typer.Argument(metavar="TRAJECTORY", help="Trajectory as `reconstruct` writes it.")],
    program: Annotated[Path, typer.Option("--program", metavar="program.toml", help="Commanded poses and paths with their windows.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write: a new one, or that of an earlier certificate.")],
    run: Annotated[
        Path | None, typer.Option("--run", help="Run folder of the trajectory: its counts are certified and copied too.")
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig the trajectory was reconstructed with, if not the run's own.")] = None,
    constraint: Annotated[str | None, typer.Option("--constraint", help="The constraint it was reconstructed with.")] = None,
    repeatability_mm: Annotated[
        float, typer.Option("--repeatability-mm", min=0.0, help="Of the robot between passes, as at `reconstruct`.")
    ] = 0.0,
    details: Annotated[
        Path | None, typer.Option("--details", metavar="details.toml", help="Laboratory, customer, item, dates, traceability ...")
    ] = None,
    language: Annotated[str, typer.Option("--language", help="en or ru.")] = "en",
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="Sign with this private key (`lmeasure key`).")] = None,
    dcc: Annotated[bool, typer.Option("--dcc", help="Also write certificate.xml, a DCC 3.3.0.")] = False,
    xsd: Annotated[Path | None, typer.Option("--xsd", metavar="FILE.xsd", help="Hold the DCC against this schema.")] = None,
    zipped: Annotated[bool, typer.Option("--zip", help="Also pack the folder into DIR.zip, its digest beside it.")] = False,
    align: Annotated[bool, typer.Option("--align", help="Fit the program's frame to the attained poses.", rich_help_panel=CHOICES)] = False,
    tool_offset_mm: Annotated[
        str, typer.Option("--tool-offset-mm", metavar="X,Y,Z", help="Point of the tool to certify.", rich_help_panel=CHOICES)
    ] = "0,0,0",
    angles: Annotated[
        str | None, typer.Option("--angles", help="Convention of component-wise angles; default the program's.", rich_help_panel=CHOICES)
    ] = None,
    capability: Annotated[
        float, typer.Option("--capability", min=0.0, max=1.0, help="Largest U95 as a part of a figure.", rich_help_panel=CHOICES)
    ] = 0.25,
    limit_deg: Annotated[
        float,
        typer.Option("--limit-deg", min=0.0, max=90.0, help="Pressure angle beyond which no verdict is given.", rich_help_panel=CHOICES),
    ] = 60.0,
    limit_u95_mm: Annotated[
        float | None, typer.Option("--limit-u95-mm", min=0.0, help="The same for the 95 % radius of a pose.", rich_help_panel=CHOICES)
    ] = None,
    rule: Annotated[str, typer.Option("--rule", help="simple or guarded: decision on tolerances.", rich_help_panel=CHOICES)] = "simple",
    still_mm: Annotated[
        float, typer.Option("--still-mm", min=0.0, help="Largest motion within a window of a pose.", rich_help_panel=CHOICES)
    ] = 0.2,
    trials: Annotated[int, typer.Option("--trials", min=100, help="Trials of Monte Carlo.", rich_help_panel=CHOICES)] = 4000,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Its seed.", rich_help_panel=CHOICES)] = 0,
) -> None:
    """Certify a robot by ISO 9283: certificate.json, certificate.pdf, report.html and copies of all inputs in one sealed folder."""
    from lmeasure.certification import Settings
    from lmeasure.certification.certificate import LANGUAGES
    from lmeasure.certification.measure import Inputs
    from lmeasure.cli.progress import bar
    from lmeasure.conventions import CONVENTIONS
    from lmeasure.report.certificate import Choices, lines, write_certificate

    if language not in LANGUAGES:
        raise typer.BadParameter(f"{language!r} is not one of {', '.join(LANGUAGES)}", param_hint="--language")
    if rule not in ("simple", "guarded"):
        raise typer.BadParameter(f"{rule!r} is neither simple nor guarded", param_hint="--rule")
    if xsd is not None and not dcc:
        raise typer.BadParameter("goes with --dcc", param_hint="--xsd")
    of_run = {"--rig": rig is not None, "--constraint": constraint is not None, "--repeatability-mm": repeatability_mm != 0.0}
    if run is None and any(of_run.values()):
        raise typer.BadParameter("goes with --run", param_hint=next(name for name, given in of_run.items() if given))
    if angles is not None and angles not in CONVENTIONS:
        raise typer.BadParameter(f"{angles!r} is not one of {', '.join(CONVENTIONS)}", param_hint="--angles")
    settings = Settings(
        align=align,
        angles=angles,
        tool_offset_mm=_point(tool_offset_mm),
        capability=capability,
        limit_angle_deg=limit_deg,
        limit_u95_mm=limit_u95_mm,
        rule="guarded" if rule == "guarded" else "simple",
        still_mm=still_mm,
        trials=trials,
        seed=seed,
    )
    inputs = Inputs(trajectory, program, run, rig, details, constraint, repeatability_mm)
    with bar("certify") as progress:
        content = write_certificate(out, inputs, settings, Choices(language, key, dcc, xsd, zipped), progress)
    typer.echo("\n".join(lines(content)))


def _point(text: str) -> tuple[float, float, float]:
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != 3 or not all(map(math.isfinite, found)):
        raise typer.BadParameter(f"{text!r} is not three numbers with commas between them", param_hint="--tool-offset-mm")
    return found[0], found[1], found[2]
