"""Which reference poses to measure."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lmeasure.core import CalibrationError, SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, steps, workflow
from lmeasure.workflows.plan_robot import run_robot
from lmeasure.workflows.plan_settings import OPTIONS, Settings as Settings
from lmeasure.workflows.settings import Box, UnitQuaternion, radians_of

if TYPE_CHECKING:
    from lmeasure.calibration import Campaign, Region


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Any]":
    """Plan, and write the poses."""
    import numpy as np

    from lmeasure.calibration import Limits, PlanSettings, further_columns, plan_details, plan_poses, plan_summary
    from lmeasure.core import convention, rounded_angles
    from lmeasure.io import write_table
    from lmeasure.recording import pose_columns
    from lmeasure.rig import read_rig
    from lmeasure.trajectory import proposed_returns

    out, extend = settings.out, settings.extend
    if out.suffix.lower() != ".csv":
        raise SettingsError("out", message("error.does_not_end_in", trend=str(out)))
    if settings.robot is not None:
        return run_robot(settings, progress)
    stray = next((name for name in OPTIONS if getattr(settings, name)), None)
    if stray is not None:
        raise SettingsError(stray, message("error.goes_with_robot"))
    if settings.rig is None:
        raise SettingsError("rig", message("error.is_missing_the_rig"))
    if settings.box is None and extend is None:
        raise SettingsError("box", message("error.say_where_the_robot"))
    rig = read_rig(settings.rig)
    u = settings.u_position_mm, radians_of(settings.u_rotation_deg)
    recorded = None if extend is None else _recorded(extend, u[0] or 0.0, u[1] or 0.0)
    u_position, u_rotation = _uncertainties(u, recorded)
    tilt, zone_tilt = settings.tilt_deg, settings.zone_tilt_deg
    region = _region(settings.box, tilt, settings.quaternion, recorded)
    zone = None
    if settings.zone_box is not None or zone_tilt is not None:
        zone = _region(settings.zone_box or settings.box, tilt if zone_tilt is None else zone_tilt, settings.quaternion, recorded)
    chosen = PlanSettings(
        settings.poses,
        replace(region, angles=rig.angles if settings.rounded else None),
        zone,
        settings.criterion,
        settings.solve,
        u_position,
        u_rotation,
        settings.passes,
        Limits(
            settings.max_wrap_deg,
            settings.min_span_mm,
            settings.max_length_mm,
            settings.clearance_mm,
            settings.min_tension_n,
            settings.singular_deg,
        ),
        settings.further,
        settings.seed,
    )
    plan = plan_poses(rig, chosen, recorded, steps(progress, "planning"))
    more = {} if extend is None or recorded is None else further_columns(extend, len(plan.poses) - plan.recorded)
    # planned as if exact where nothing is said of it; how exactly they will be known nobody has stated yet
    unsaid = {"position": plan.poses.u_position_mm, "rotation": plan.poses.u_rotation_rad}
    planned = replace(plan.poses, absent=tuple(name for name, u in unsaid.items() if plan.poses.covariance is None and not u.any()))
    columns = pose_columns(planned, None if settings.quaternions else rig.angles) | more
    if settings.rounded and not settings.quaternions:
        for name in convention(rig.angles).columns:  # as they are typed, not as they come back from a rotation
            columns[name] = np.concatenate([columns[name][: plan.recorded], rounded_angles(rig.angles, columns[name][plan.recorded :])])
    write_table(out, columns)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, rig, reference=plan.poses)
    fill_in = message("workflow.fill_in_temperature") if "temperature_c" in more else ""
    figures = {"poses": len(plan.poses), "recorded": plan.recorded, "usable_part": plan.usable, "equations": plan.equations}
    figures |= {"unknowns": len(plan.parameters), "directions_determined": plan.outlook.rank}
    figures |= {"u_length_rms_mm": plan.outlook.rms_mm, "u_length_worst_mm": plan.outlook.worst_mm}
    answer = message("workflow.planned", poses=len(plan.poses), mm=plan.outlook.worst_mm, out=out, fill_in=fill_in)
    returns = proposed_returns(rig, plan.poses.rows, plan.poses.names)
    lines = (answer, *returns, *plan_summary(plan).splitlines())
    return Result(plan, lines, figures, details=tuple(plan_details(plan).splitlines()))


def _recorded(folder: Path, u_position_mm: float, u_rotation_rad: float) -> "Campaign":
    """The campaign; poses that state no uncertainty take that of the new ones."""
    from lmeasure.calibration import read_campaign

    campaign = read_campaign(folder)
    old = campaign.poses
    if not old.oriented:
        raise CalibrationError(message("error.its_reference_poses_have", where=folder))
    return replace(campaign, poses=old.or_uncertain(u_position_mm, u_rotation_rad))


def _uncertainties(given: tuple[float | None, float | None], recorded: "Campaign | None") -> tuple[float, float]:
    """Return the uncertainty of the new poses [mm, rad]: what is given, else the largest of the recorded ones, else none."""
    if recorded is None:
        return given[0] or 0.0, given[1] or 0.0
    stated = recorded.poses.u_position_mm.max(), recorded.poses.u_rotation_rad.max()
    position, rotation = (float(most) if u is None else u for u, most in zip(given, stated, strict=True))
    return position, rotation


def _region(box: Box | None, tilt_deg: float, quaternion: UnitQuaternion | None, recorded: "Campaign | None") -> "Region":
    """The box given, or that of the recorded poses; tilts about the orientation given, the recorded ones' mean, or the identity."""
    import numpy as np

    from lmeasure.calibration import Region

    if box is not None:
        low, high = np.array(box).T
    else:
        assert recorded is not None
        low, high = recorded.poses.rows[:, :3].min(axis=0), recorded.poses.rows[:, :3].max(axis=0)
    middle = np.array([0.0, 0.0, 0.0, 1.0]) if recorded is None else recorded.poses.rotation.mean().as_quat()
    if quaternion is not None:
        middle = np.array(quaternion) / np.linalg.norm(quaternion)
    return Region(low, high, math.radians(tilt_deg), middle)
