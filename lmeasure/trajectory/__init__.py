"""Where the gripper went: trajectories from runs."""

from lmeasure.trajectory.screw_method import Trajectory, read_trajectory, reconstruct, write_trajectory

__all__ = ["Trajectory", "read_trajectory", "reconstruct", "write_trajectory"]
