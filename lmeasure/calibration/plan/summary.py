"""A plan of reference poses in words and tables."""

from lmeasure.calibration.plan.pose_choice import Outlook, Plan

MICRO_MM = 1e-3


def _mm(value: float) -> str:
    return f"{value:10.4f}" if value >= MICRO_MM else f"{value:10.2e}"


def _line(first: str, outlook: Outlook, unknowns: int, note: str = "") -> str:
    told = f"{outlook.rank} of {unknowns}"
    return f"{first:>6s} {_mm(outlook.rms_mm)} {_mm(outlook.worst_mm)}  {outlook.worst_cable:8s} {told:>10s}  {note}".rstrip()


def plan_summary(plan: Plan) -> str:
    """What the plan brings: the poses, the predicted uncertainty as they are measured one after the other and with further ones, what each
    is worth, and what stays undetermined."""
    unknowns, planned = len(plan.parameters), len(plan.poses) - plan.recorded
    head = f"{'':>6s} {'rms':>10s} {'worst':>10s}  {'cable':8s} {'determined':>10s}"
    lines = [f"{plan.usable:.0%} of the poses tried can be used"]
    lines += [f"  {part:.0%} ruled out: {reason}" for reason, part in plan.broken if part]
    lines += [
        "",
        "predicted standard uncertainty of a length over the zone, from the calibration alone [mm]",
        "after as many poses:",
        head,
    ]
    for count, outlook in plan.course:
        note = "recorded" if count == plan.recorded else "the plan" if count == len(plan.poses) else ""
        lines.append(_line(str(count), outlook, unknowns, note or ("further" if count > len(plan.poses) else "")))
    if planned > 1:
        lines += ["the plan without one pose:", head]
        lines += [_line(name, outlook, unknowns) for name, outlook in plan.without]
    u_position, u_rotation = plan.poses.u_position_mm, plan.poses.u_rotation_rad
    exact = not (u_position.any() or u_rotation.any())
    lines += ["", f"{plan.equations} equations, {unknowns} unknowns, {plan.outlook.rank} directions determined by the counts"]
    if plan.undetermined:
        lines.append(f"the plan leaves {len(plan.undetermined)} directions undetermined; only the rig's priors hold them:")
        lines += [f"  {u.text}" for u in plan.undetermined]
    lines.append(
        f"predicted worst u {plan.outlook.worst_mm:.3g} mm (cable {plan.outlook.worst_cable}), rms {plan.outlook.rms_mm:.3g} mm"
        + ("; reference poses taken as exact: state --u-position-mm and --u-rotation-deg" if exact else "")
    )
    return "\n".join(lines)
