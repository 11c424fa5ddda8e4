"""A mechanism as a recording: a motion from home along each of its coordinates, with joint values and the distance from singular poses."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from lmeasure.robots import ParallelFile, drawn, motion, nearness
from lmeasure.view.recording import recording
from lmeasure.view.space import CABLE, GREY, THICK, metres

ARM, LEG, PLATFORM = (124, 58, 237), (234, 120, 60), (86, 150, 255)


def write_mechanism_recording(path: Path, file: ParallelFile) -> None:
    """Write the motion as one .rrd; timeline `step`."""
    robot = file.model
    poses, joints = motion(file)
    near = nearness(robot.jacobians(poses, joints).output, robot.units)
    with recording(Path(path), f"lmeasure mechanism {file.name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rec.log("/world/base", rr.LineStrips3D([metres(s) for s in drawn(file, robot.home).base], colors=GREY, radii=CABLE), static=True)
        for step, (pose, q) in enumerate(zip(poses, joints, strict=True)):
            rec.set_time("step", sequence=step)
            at = drawn(file, pose)
            rec.log("/world/legs", rr.LineStrips3D([metres(s) for s in at.legs], colors=LEG, radii=CABLE))
            if at.arms:
                rec.log("/world/arms", rr.LineStrips3D([metres(s) for s in at.arms], colors=ARM, radii=THICK))
            rec.log("/world/platform", rr.LineStrips3D([metres(at.platform)], colors=PLATFORM, radii=THICK))
            for name, slides, value in zip(robot.joint_names, robot.sliding, q, strict=True):
                unit = "mm" if slides else "deg"
                rec.log(f"/joints/{unit}/{name}", rr.Scalars(float(value if slides else np.degrees(value))))
            rec.log("/nearness", rr.Scalars(float(near[step])))
        rec.reset_time()
        space = rrb.Spatial3DView(name=file.name, origin="/world", line_grid=rrb.LineGrid3D(visible=False))
        units = dict.fromkeys("mm" if slides else "deg" for slides in robot.sliding)
        views: list[rrb.View] = [rrb.TimeSeriesView(name=f"Joints [{unit}]", origin=f"/joints/{unit}") for unit in units]
        views.append(rrb.TimeSeriesView(name="Distance from a singular pose", origin="/nearness"))
        layout = rrb.Horizontal(space, rrb.Vertical(*views), column_shares=[3, 2])
        rec.send_blueprint(rrb.Blueprint(layout, rrb.TimePanel(state="expanded")), make_active=True, make_default=True)
