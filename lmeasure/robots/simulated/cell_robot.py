"""The arm that stands in the simulated cell: as its maker drew it, and as it was built."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.robots.file_fields import Place
from lmeasure.robots.robot import Payload, Robot, shipped
from lmeasure.robots.simulated.arm import SimulatedRobot

FOOT_MM = (1100.0, 0.0, -500.0)
"""At the side of the cell where no cable passes, below the work space; the arm looks along -X."""
TOOL_MM = 100.0
"""From the flange down to the tool's origin."""
U_LENGTH_MM, U_ANGLE_RAD = 0.15, 2e-4
JOINT_NOISE_RAD = 1.5e-5
BACKLASH_RAD = 3e-5
RATED_SPEED_MM_S = 1000.0
RATED_LOAD_KG = 20.0
RAMP_S = (0.08, 0.03)
GROWTH = 1.5e-4
"""A steel arm that gets 13 K warmer."""
GROWTH_S = 1800.0
REST = (0.0, 0.0, 0.0, 0.0, 1.4, 0.0)
"""Joint angles near which it stands before it begins."""
# the flange looks down, the tool's axes are those of the base frame at rest
_FRAMES = (
    se3.pose(FOOT_MM, Rotation.from_rotvec([0.0, 0.0, math.pi])),
    se3.pose([0.0, 0.0, TOOL_MM], Rotation.from_matrix(np.diag([-1.0, 1.0, -1.0]))),
)
"""Where the arm stands in the cell, and the tool on its flange."""


def nominal_robot() -> Robot:
    """The arm as its maker drew it, as a robot.toml has it: where it stands in the cell, its tool, and the rated load at that."""
    place = [Place(position_mm=tuple(row[:3]), quaternion_xyzw=tuple(row[3:])) for row in _FRAMES]
    payload = Payload(mass_kg=RATED_LOAD_KG, centre_mm=place[1].position_mm)
    return shipped("generic6").model_copy(update={"name": "cell_robot", "base": place[0], "tool": place[1], "payload": payload})


def cell_robot(seed: int = 0) -> SimulatedRobot:
    """A robot of 20 kg with normal errors of its links: a few tenths of a millimetre at the tool, as no two are built."""
    rng = np.random.default_rng(seed)
    nominal = nominal_robot().arm
    axes = nominal.axes_count
    errors = rng.normal(size=nominal.links.shape) * [U_ANGLE_RAD, U_LENGTH_MM, U_LENGTH_MM, U_ANGLE_RAD, U_ANGLE_RAD]
    return SimulatedRobot(
        nominal,
        nominal.with_errors(errors),
        rest=np.array(REST),
        ramp_s=RAMP_S,
        natural_rad_s=rng.uniform(80.0, 110.0, axes),
        damping=rng.uniform(0.4, 0.55, axes),
        joint_noise_rad=JOINT_NOISE_RAD * rng.uniform(0.5, 1.5, axes),
        backlash_rad=BACKLASH_RAD * rng.uniform(0.5, 1.5, axes),
        stiffness_n_mm_rad=np.array([2e9, 2e9, 1.5e9, 4e8, 4e8, 3e8]),
        growth=GROWTH,
        growth_s=GROWTH_S,
    )
