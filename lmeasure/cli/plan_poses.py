"""`lmeasure plan-poses`: which reference poses to measure."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmeasure.cli.options import Rerun

if TYPE_CHECKING:
    from lmeasure.calibration import Campaign
    from lmeasure.calibration.reach import Region

BOX = "X0:X1,Y0:Y1,Z0:Z1"
LIMITS = "What a cable allows"
STATED = "by default exact, with --extend the largest recorded"


def plan_poses(
    rig: Annotated[Path, typer.Argument(metavar="RIG.toml", help="The rig as far as it is known; its u_... are the priors.")],
    poses: Annotated[int, typer.Option("--poses", min=1, help="How many poses to choose; with --extend, how many more.")],
    out: Annotated[Path, typer.Option("--out", help="The reference_poses.csv to write; its first pose is the zero pose.")],
    box: Annotated[
        str | None, typer.Option("--box", metavar=BOX, help="Where the tool origin may go [mm]; with --extend by default as it went.")
    ] = None,
    tilt_deg: Annotated[float, typer.Option("--tilt-deg", min=0, max=90, help="Largest component of the tilt's rotation vector.")] = 15.0,
    quaternion: Annotated[str | None, typer.Option("--quaternion", metavar="X,Y,Z,W", help="Orientation that is tilted.")] = None,
    zone_box: Annotated[str | None, typer.Option("--zone-box", metavar=BOX, help="Where lengths matter; by default the box.")] = None,
    zone_tilt_deg: Annotated[
        float | None, typer.Option("--zone-tilt-deg", min=0, max=90, help="Tilt in the zone; by default that of the poses.")
    ] = None,
    criterion: Annotated[
        str, typer.Option("--criterion", help="G: least worst variance over the zone; I: least mean variance; D: least determinant.")
    ] = "G",
    extend: Annotated[
        Path | None, typer.Option("--extend", metavar="FOLDER", help="Calibration folder already recorded: its counters go on.")
    ] = None,
    u_position_mm: Annotated[
        float | None, typer.Option("--u-position-mm", min=0, help=f"Standard uncertainty of a pose's coordinates; {STATED}.")
    ] = None,
    u_rotation_deg: Annotated[
        float | None, typer.Option("--u-rotation-deg", min=0, help=f"Standard uncertainty of a pose's rotations; {STATED}.")
    ] = None,
    solve: Annotated[str, typer.Option("--solve", help="What the calibration will solve for, as `lmeasure calibrate` has it.")] = (
        "position,guide"
    ),
    passes: Annotated[str, typer.Option("--pass", metavar="N,...", help="Whose cables are measured.")] = "1",
    max_wrap_deg: Annotated[
        float, typer.Option("--max-wrap-deg", min=1, max=360, help="Largest angle wrapped on a swivel pulley.", rich_help_panel=LIMITS)
    ] = 170.0,
    min_span_mm: Annotated[
        float, typer.Option("--min-span-mm", min=0, help="Shortest free span from the pulley.", rich_help_panel=LIMITS)
    ] = 100.0,
    max_length_mm: Annotated[
        float, typer.Option("--max-length-mm", min=1, help="Longest cable from B to the attachment point.", rich_help_panel=LIMITS)
    ] = 1e6,
    clearance_mm: Annotated[
        float, typer.Option("--clearance-mm", min=0, help="Between free spans, and to other pulleys.", rich_help_panel=LIMITS)
    ] = 10.0,
    min_tension_n: Annotated[
        float, typer.Option("--min-tension-n", min=0, help="Least tension at a drum whose tension the rig states.", rich_help_panel=LIMITS)
    ] = 0.0,
    further: Annotated[int, typer.Option("--further", min=0, max=50, help="Poses beyond the plan to weigh in the table.")] = 3,
    quaternions: Annotated[bool, typer.Option("--quaternions", help="Write quaternions, not the rig's angles.")] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of candidates and starts.")] = 0,
    rerun: Rerun = None,
) -> None:
    """Choose reference poses that leave the least uncertainty in the lengths over a zone, and say what each brings."""
    import math
    from dataclasses import replace

    from lmeasure.calibration.campaign import further_columns
    from lmeasure.calibration.exchange import CRITERIA
    from lmeasure.calibration.plan_summary import summary
    from lmeasure.calibration.planning import Settings
    from lmeasure.calibration.planning import plan_poses as stage
    from lmeasure.calibration.reach import Limits
    from lmeasure.cli.progress import bar
    from lmeasure.files import write_table
    from lmeasure.poses import pose_columns
    from lmeasure.rig import read_rig

    if criterion not in CRITERIA:
        raise typer.BadParameter(f"{criterion!r} is not one of {', '.join(CRITERIA)}", param_hint="--criterion")
    if out.suffix.lower() != ".csv":
        raise typer.BadParameter(f"{str(out)!r} does not end in .csv", param_hint="--out")
    if box is None and extend is None:
        raise typer.BadParameter("say where the robot may go", param_hint="--box")
    what = read_rig(rig)
    u = u_position_mm, None if u_rotation_deg is None else math.radians(u_rotation_deg)
    recorded = None if extend is None else _recorded(extend, u[0] or 0.0, u[1] or 0.0)
    u_position, u_rotation = _uncertainties(u, recorded)
    region = _region("--box", box, tilt_deg, quaternion, recorded)
    zone = None
    if zone_box is not None or zone_tilt_deg is not None:
        zone = _region("--zone-box", zone_box or box, tilt_deg if zone_tilt_deg is None else zone_tilt_deg, quaternion, recorded)
    settings = Settings(
        poses,
        region,
        zone,
        criterion,
        tuple(g.strip() for g in solve.split(",") if g.strip()),
        u_position,
        u_rotation,
        _passes(passes),
        Limits(max_wrap_deg, min_span_mm, max_length_mm, clearance_mm, min_tension_n),
        further,
        seed,
    )
    with bar("planning") as progress:
        plan = stage(what, settings, recorded, progress)
    more = {} if extend is None or recorded is None else further_columns(extend, len(plan.poses) - plan.recorded)
    # planned as if exact where nothing is said of it; how exactly they will be known nobody has stated yet
    unsaid = {"position": plan.poses.u_position_mm, "rotation": plan.poses.u_rotation_rad}
    planned = replace(plan.poses, absent=tuple(name for name, u in unsaid.items() if plan.poses.covariance is None and not u.any()))
    write_table(out, pose_columns(planned, None if quaternions else what.angles) | more)
    if rerun is not None:
        from lmeasure.view.stages import write_recording

        write_recording(rerun, what, reference=plan.poses)
    typer.echo(summary(plan))
    typer.echo(f"written: {out}" + ("; fill in temperature_c of the new poses when they are counted" if "temperature_c" in more else ""))


def _recorded(folder: Path, u_position_mm: float, u_rotation_rad: float) -> "Campaign":
    """The campaign; poses that state no uncertainty take that of the new ones."""
    from dataclasses import replace

    from lmeasure.calibration import read_campaign
    from lmeasure.errors import CalibrationError

    campaign = read_campaign(folder)
    old = campaign.poses
    if not old.oriented:
        raise CalibrationError(
            f"{folder}: its reference poses have no orientations; planning needs whole poses, as poses.csv of a calibration"
        )
    return replace(campaign, poses=old.or_uncertain(u_position_mm, u_rotation_rad))


def _uncertainties(given: tuple[float | None, float | None], recorded: "Campaign | None") -> tuple[float, float]:
    """Of the new poses [mm, rad]: what is given, else the largest of the recorded ones, else none."""
    if recorded is None:
        return given[0] or 0.0, given[1] or 0.0
    stated = recorded.poses.u_position_mm.max(), recorded.poses.u_rotation_rad.max()
    position, rotation = (float(most) if u is None else u for u, most in zip(given, stated, strict=True))
    return position, rotation


def _region(name: str, text: str | None, tilt_deg: float, quaternion: str | None, recorded: "Campaign | None") -> "Region":
    """The box given, or that of the recorded poses; tilts about the orientation given, the recorded ones' mean, or the identity."""
    import math

    import numpy as np

    from lmeasure.calibration.reach import Region

    if text is not None:
        spans = [_numbers(name, part, ":", 2) for part in text.split(",")]
        if len(spans) != 3:
            raise typer.BadParameter(f"{text!r} is not {BOX}", param_hint=name)
        low, high = np.array(spans).T
    else:
        assert recorded is not None
        low, high = recorded.poses.rows[:, :3].min(axis=0), recorded.poses.rows[:, :3].max(axis=0)
    middle = np.array([0.0, 0.0, 0.0, 1.0]) if recorded is None else recorded.poses.rotation.mean().as_quat()
    if quaternion is not None:
        middle = np.array(_numbers("--quaternion", quaternion, ",", 4))
        if not abs(float(middle @ middle) - 1.0) < 1e-3:
            raise typer.BadParameter(f"{quaternion!r} is not a unit quaternion x,y,z,w", param_hint="--quaternion")
        middle /= np.linalg.norm(middle)
    return Region(low, high, math.radians(tilt_deg), middle)


def _passes(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a list of whole numbers", param_hint="--pass") from None


def _numbers(name: str, text: str, separator: str, count: int) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = ()
    if len(values) != count:
        raise typer.BadParameter(f"{text!r} is not {count} numbers with {separator!r} between them", param_hint=name)
    return values
