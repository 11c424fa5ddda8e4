"""Where the gripper went: trajectories from runs."""

from lmeasure.trajectory.record import Trajectory, read_trajectory, write_trajectory
from lmeasure.trajectory.screw_method import Reconstruction, reconstruct

__all__ = ["Reconstruction", "Trajectory", "read_trajectory", "reconstruct", "write_trajectory"]
