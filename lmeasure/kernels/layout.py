"""Columns of the arrays of kernels: of a cable, of a pose, of its state.

Plain integers, which Numba compiles as constants; of three columns the first one, and the same three as a slice for NumPy.
"""

# a pose: x, y, z, qx, qy, qz, qw; base_from_tool [mm, base frame]
PLACE, ORIENTATION, POSE_COLUMNS = 0, 3, 7

# a cable [mm, rad]: B and the direction of travel u at B (base frame), radius of the swivel pulley, P (tool frame), drum to fixed pulley
# t_d and a0, axial travel of the pay-out point per count g/N, length of a count c, the angles alpha and beta of u, counts per turn N
BASE, GUIDE, RADIUS, ATTACHMENT, TANGENT, AXIAL, TRAVEL, COUNT_LENGTH, ALPHA, BETA, TURN_COUNTS = 0, 3, 6, 7, 10, 11, 12, 13, 14, 15, 16
# kind of a channel, and values of an angle's encoder: its length of a count is an angle [rad], its zero stands where a cable
# has the pulley's radius; an inclination has its axis for the attachment point, and the way up for B
KIND, ECCENTRICITY, ECCENTRIC_PHASE, CABLE_COLUMNS = 17, 18, 19, 20
CABLE, SWIVEL, INCLINATION, DISTANCE = 0, 1, 2, -1
# kinds that other packages add: lengths count down from the first of these, angles up (`kernels.external`); so lengths are all kinds up to
# CABLE. Their own parameters are in these columns, in the order of OWN_PARAMETERS
EXTERNAL_LENGTH, EXTERNAL_ANGLE = -2, 3
ANGLE_ZERO = RADIUS
BASE_XYZ, GUIDE_XYZ, ATTACHMENT_XYZ = slice(BASE, BASE + 3), slice(GUIDE, GUIDE + 3), slice(ATTACHMENT, ATTACHMENT + 3)

PARAMETERS = (
    "x_mm",
    "y_mm",
    "z_mm",
    "guide_alpha_rad",
    "guide_beta_rad",
    "pulley_radius_mm",
    "scale",
    "tangent_length_mm",
    "axial_offset_mm",
    "attachment_x_mm",
    "attachment_y_mm",
    "attachment_z_mm",
    "groove_pitch_mm",
)
"""What a length is differentiated by, in this order: observation point, guide, pulley, counter, drum, attachment point."""
BY_BASE, BY_ALPHA, BY_BETA, BY_RADIUS, BY_SCALE, BY_TANGENT, BY_AXIAL, BY_ATTACHMENT, BY_PITCH = 0, 3, 4, 5, 6, 7, 8, 9, 12
BY_ANGLE_ZERO = BY_RADIUS
OWN_PARAMETERS = (BY_BASE, BY_BASE + 1, BY_BASE + 2, BY_ALPHA, BY_BETA, BY_TANGENT, BY_AXIAL)
"""Places of an external kind's own parameters among `PARAMETERS`; its zero, its scale and its tool point are where others have theirs."""
OWN_COLUMNS = (BASE, BASE + 1, BASE + 2, ALPHA, BETA, TANGENT, AXIAL)
"""Columns of the rows that have them."""
WIDTH = len(PARAMETERS)

# effects of temperature, tension and weight on a cable (`kernels.effects`): expansion of cable, drum and frame [1/K], 1/EA [1/N], weight
# [N/mm], tension at k = 0 [N] and its rise per length paid out [N/mm], tension of winding [N] or NaN for the drum's own, G [mm]
CABLE_EXPANSION, DRUM_EXPANSION, FRAME_EXPANSION, COMPLIANCE, WEIGHT, TENSION, TENSION_RISE, WINDING_TENSION, GUIDE_LENGTH = range(9)
EFFECT_COLUMNS = 9

# where a run of m cables has got to: its last good pose, the change of the cables there, and last whether and how it was lost
CHANGES = POSE_COLUMNS

# a body that cables must not touch: start and unit way of its middle line, length, radius [mm], 1 when it moves with the tool
BODY_START, BODY_WAY, BODY_LENGTH, BODY_RADIUS, BODY_OF_TOOL, BODY_COLUMNS = 0, 3, 6, 7, 8, 9

# a counter of the live kernel: count per recorded count, largest rate of recorded counts [1/s], number of values or 0, count length [mm],
# 1 where its values are codes, from 0 on, that state an angle, and the known excess in counts
CHANNEL_PER_RECORDED, CHANNEL_RATE, CHANNEL_VALUES, CHANNEL_COUNT_LENGTH, CHANNEL_ABSOLUTE, CHANNEL_SHIFT = range(6)
CHANNEL_COLUMNS = 6

# which way a cable travelled last: the farthest count on its present way, and that way
TRAVEL_FAR, TRAVEL_WAY = range(2)
