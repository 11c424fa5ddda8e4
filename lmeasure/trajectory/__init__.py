"""Where the gripper went: trajectories from runs."""

from lmeasure.trajectory.elsewhere import Stated, read_trajectory
from lmeasure.trajectory.pose_covariances import PoseCovariances
from lmeasure.trajectory.record import Summary, Trajectory
from lmeasure.trajectory.run_covariances import covariances
from lmeasure.trajectory.runs import reconstruct
from lmeasure.trajectory.screw_method import Reconstruction
from lmeasure.trajectory.stream import can_stream, reconstruct_stream
from lmeasure.trajectory.written import write_trajectory

__all__ = [
    "PoseCovariances",
    "Reconstruction",
    "Stated",
    "Summary",
    "Trajectory",
    "can_stream",
    "covariances",
    "read_trajectory",
    "reconstruct",
    "reconstruct_stream",
    "write_trajectory",
]
