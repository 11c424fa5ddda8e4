"""`lmeasure calibrate`: from reference poses and counts to calibrated observation points."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from lmeasure.cli.options import Rerun


def calibrate(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Calibration folder: rig.toml (nominal), reference_poses.csv, counts.csv.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for rig.toml, calibration.json and report.html.")],
    solve: Annotated[
        str, typer.Option("--solve", help="What to solve for: position, guide, radius, scale, tangent, axial, pitch, attachment.")
    ] = "position,guide",
    neighbourhood_mm: Annotated[
        float,
        typer.Option("--neighbourhood-mm", min=1e-3, max=1e5, help="Half width of the search around the nominal and coarse positions."),
    ] = 100.0,
    neighbourhood_deg: Annotated[
        float, typer.Option("--neighbourhood-deg", min=1e-3, max=180, help="Half width of the search around the nominal guide angles.")
    ] = 15.0,
    prior: Annotated[
        bool, typer.Option("--prior", help="Use the nominal rig's priors in every direction, not only where data are silent.")
    ] = False,
    robust: Annotated[
        bool, typer.Option("--robust", help="Robust loss (Tukey's biweight) against reference poses that the others contradict.")
    ] = False,
    hold_out: Annotated[
        str, typer.Option("--hold-out", metavar="POSE,POSE,...", help="Reference poses to keep out of the fit; they judge it.")
    ] = "",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the LP-search.")] = 0,
    self_: Annotated[
        bool, typer.Option("--self", help="Estimate the poses too and trust none: seven cables or more to a body, four to one point.")
    ] = False,
    frame: Annotated[str, typer.Option("--frame", help="What holds the frame with --self: rig (nominal) or poses (reference).")] = "rig",
    u_position_mm: Annotated[
        float | None,
        typer.Option(
            "--u-position-mm", min=0, help="Standard uncertainty of each coordinate of the reference poses, instead of their file's."
        ),
    ] = None,
    u_rotation_deg: Annotated[
        float | None,
        typer.Option(
            "--u-rotation-deg", min=0, help="Standard uncertainty of their orientations about each axis, instead of their file's."
        ),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option("--compare", metavar="OLD", help="Earlier output folder or calibration.json: say what moved, and whether by chance."),
    ] = None,
    rerun: Rerun = None,
) -> None:
    """Find the observation points from recorded counts at reference poses, with what the data can and cannot tell."""
    from lmeasure.calibration import Settings, read_campaign
    from lmeasure.calibration import calibrate as stage
    from lmeasure.calibration import compare as comparing
    from lmeasure.calibration_record import write_calibration_record
    from lmeasure.cli.progress import bar
    from lmeasure.errors import CalibrationError
    from lmeasure.poses import write_poses
    from lmeasure.report.calibration import write_calibration_page
    from lmeasure.rig import write_rig

    if frame not in ("rig", "poses"):
        raise typer.BadParameter(f"{frame!r} is neither rig nor poses", param_hint="--frame")
    held: Literal["rig", "poses"] = "rig" if frame == "rig" else "poses"
    groups = tuple(g.strip() for g in solve.split(",") if g.strip())
    kept = tuple(name.strip() for name in hold_out.split(",") if name.strip())
    campaign = read_campaign(folder)
    u_rotation = None if u_rotation_deg is None else math.radians(u_rotation_deg)
    campaign = replace(campaign, poses=campaign.poses.with_uncertainty(u_position_mm, u_rotation))
    # read before anything is written: OLD may be the very folder of --out
    earlier = None if compare is None else comparing.read_earlier(compare)
    with bar("calibrating") as progress:
        chosen = Settings(groups, neighbourhood_mm, neighbourhood_deg, prior, seed, robust, kept, self_, held)
        result = stage(campaign, chosen, progress)
    comparison = None if earlier is None else comparing.compare(earlier, result, seed)
    write_calibration_page(out / "report.html", result, comparison)
    write_calibration_record(out / "calibration.json", result.record)
    if result.refused is not None:
        # an earlier one would seem to belong to this record
        (out / "rig.toml").unlink(missing_ok=True)
        raise CalibrationError(f"{folder}: {result.refused}; no rig.toml is written, read {out / 'report.html'}")
    write_rig(out / "rig.toml", result.rig)
    if result.record.poses:
        write_poses(out / "poses.csv", result.campaign.poses)
    record = result.record
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, result.rig, nominal=campaign.rig, reference=result.campaign.poses, record=record)
    for p in record.parameters:
        typer.echo(f"{p.name:28s} {p.value:14.4f}  u {p.u:.3g}")
    typer.echo(f"{record.equations} equations, {record.unknowns} unknowns, rank {record.rank}")
    typer.echo(f"residuals {record.noise['residual_rms_mm']:.4g} mm rms")
    for e in record.predicted["lengths"]:
        typer.echo(f"predicted over the workspace: cable {e['cable']} u {e['rms_mm']:.4f} mm rms, {e['worst_mm']:.4f} at worst")
    if "against_nominal" in record.validation:
        told = record.validation["against_nominal"]
        typer.echo(f"lengths at poses left out: {told['rms_mm']:.4f} mm rms; by the nominal rig {told['nominal_mm']:.4f}")
    if "held_out" in record.validation:
        told = record.validation["held_out"]
        text = f"{told['rms_mm']:.4f} mm rms, {told['expected_mm']:.4f} expected, {100 * told['within_95']:.0f}% within 95 %"
        typer.echo(f"lengths at the poses held out: {text}")
    for w in record.warnings:
        typer.echo(f"warning {w.code}: {w.text}")
    if comparison is not None:
        typer.echo(comparing.summary(comparison))
    poses = f", {out / 'poses.csv'}" if record.poses else ""
    typer.echo(f"written: {out / 'rig.toml'}, {out / 'calibration.json'}, {out / 'report.html'}{poses}")
