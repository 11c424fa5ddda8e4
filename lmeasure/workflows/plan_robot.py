"""Which poses of a robot to measure for its identification: `plan-poses --robot`."""

from dataclasses import replace
from typing import TYPE_CHECKING

from lmeasure.core import SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result
from lmeasure.workflows.identify import frames_of, nominal
from lmeasure.workflows.plan_settings import Settings, poses_file
from lmeasure.workflows.settings import pose_of

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from lmeasure.core import FloatArray
    from lmeasure.rig import Rig
    from lmeasure.robots import Plan

U_MM = 0.05
"""Standard uncertainty of a measured coordinate, robot and instrument together, where none is stated."""
CANDIDATES = 1500


def run_robot(settings: Settings, progress: Progress) -> "Result[Plan]":
    """Plan poses of a robot, and write its joint values and the poses expected at them."""
    import numpy as np

    from lmeasure.core import se3
    from lmeasure.io import columns_of, files
    from lmeasure.recording import pose_columns, poses_from_rows
    from lmeasure.robots import REGULAR, Allowed, freed, joint_columns, planned, read_measurements, to_plan

    robot = nominal(str(settings.robot), settings.tip, settings.base_link)
    model = robot.model
    freed(model, settings.free)  # names what is none before anything is computed
    base = pose_of(settings.base, "base") if settings.base else None
    tool = pose_of(settings.tool, "tool") if settings.tool else None
    sits = tool if tool is not None else robot.tool_pose
    stands = base if base is not None else np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    boxes = np.array([settings.keep_out] if settings.keep_out else []).reshape(-1, 3, 2)
    allowed = Allowed(model, stands, sits, boxes, _zone(settings), REGULAR)
    progress(0.0, "candidates")
    if settings.candidates is not None:
        given = read_measurements(settings.candidates, model, columns_of(settings.columns), joints_alone=True)
        keep = np.flatnonzero(allowed(given.joints))
        joints, names = given.joints[keep], [given.names[i] for i in keep]
        if len(joints) < settings.poses:
            raise SettingsError(
                "candidates",
                message(
                    "error.rows_of_are_allowed", where=settings.candidates, n_joints=len(joints), n_given=len(given), poses=settings.poses
                ),
            )
    else:
        joints, names = allowed.candidates(CANDIDATES, settings.seed), []
        joints = _typed(joints, model.sliding)
        joints = joints[allowed(joints)]
    progress(0.3, "choosing")
    u = settings.u_position_mm or U_MM
    plan = planned(to_plan(model, settings.free, stands, sits, joints=joints), joints, joints, settings.poses, u_mm=u, seed=settings.seed)
    order = plan.order
    own = [names[i] for i in order] if names else [f"P{i + 1}" for i in range(len(order))]
    at = se3.compose(model.forward(joints[order]), np.broadcast_to(sits, (len(order), 7)))
    files.write_table(settings.out, {"name": own, **joint_columns(model, joints[order])})
    expected = replace(poses_from_rows(se3.compose(np.broadcast_to(stands, at.shape), at), own), absent=("position", "rotation"))
    files.write_table(poses_file(settings.out), pose_columns(expected))
    lines: list[str] = [
        message("workflows.poses_candidates_left_uncertain", n=len(order), all=len(joints), u=u),
        *(
            message("workflow.after_mm_random", k=k, expected_mm=plan.expected_mm[k - 1], random_mm=plan.random_mm[k - 1])
            for k in _steps(len(order))
        ),
    ]
    if tool is None and robot.tool is None:
        lines.append(message("workflow.note_no_tool_stated_tool"))
    if base is None and (settings.zone is not None or settings.rig is not None):
        lines.append(message("workflow.note_no_place_robot"))
    lines += [*frames_of(robot), message("workflow.written_6", out=settings.out, poses_file=poses_file(settings.out))]
    figures = {"expected_mm": float(plan.expected_mm[-1]), "random_mm": float(plan.random_mm[-1])}
    return Result(plan, tuple(lines), figures)


def _steps(count: int) -> list[int]:
    return sorted({k for k in (10, 15, 20, 30, 45, 60, 80, 100, 150) if k < count} | {count})


def _typed(joints: "FloatArray", sliding: "np.typing.NDArray[np.bool_]") -> "FloatArray":
    """Joint values as they are typed: to 0.01 degrees or 0.1 mm."""
    import numpy as np

    return np.asarray(np.where(sliding, np.round(joints, 1), np.radians(np.round(np.degrees(joints), 2))))


def _zone(settings: Settings) -> "xr.Dataset | Rig | None":
    from lmeasure.accuracy import read_zone
    from lmeasure.rig import read_rig

    if settings.zone is not None and settings.rig is not None:
        raise SettingsError("zone", message("error.a_zone_or_a"))
    if settings.zone is not None:
        return read_zone(settings.zone)
    return None if settings.rig is None else read_rig(settings.rig)
