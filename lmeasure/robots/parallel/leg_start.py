"""Legs of a parallel robot from measured poses, each by itself: where an identification of all of them together begins.

At a pose that was measured a leg's equation holds no other leg, as that of an SS dyad does (source 004): its point on the platform, its
lower end and its length are fitted to the poses alone, without the forward problem, which a robot far from its drawing may not even have.
A dyad's sphere is a carriage's, a crank's or a strut's surface here, moved by its joint; all is least squares from the nominal values, held
by what these may be off by.
"""

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.robots.parallel.model import Parallel

U_MM = 0.1
"""Of an equation, by the measured pose, that a value's own uncertainty is weighed against."""
ROUNDS = 12
SETTLED = 1e-6
HELD = 1e-12


def legs_at(robot: Parallel, poses: FloatArray, joints: FloatArray, free: IntArray) -> FloatArray:
    """(p,) changes of the parameters, rad and mm, that fit each leg best to poses (N, 7) of the flange in the base at joint values (N, n);
    those of the indices free alone change."""
    parameters = robot.parameters
    width = np.full(len(parameters), HELD)
    width[free] = [parameters[i].width * parameters[i].size for i in free]
    change = np.zeros(len(parameters))
    cuts = np.cumsum([0, *(len(leg.parameters) for leg in robot.legs)])
    for _ in range(ROUNDS):
        own = robot.moved(change)
        lacks, by_values = own.closing(poses, joints)
        step = np.zeros_like(change)
        for leg in range(len(robot.legs)):
            part, equations = slice(cuts[leg], cuts[leg + 1]), robot.owners == leg
            rows = by_values[:, equations, part].reshape(-1, cuts[leg + 1] - cuts[leg]) / U_MM * width[part]
            right = -lacks[:, equations].reshape(-1) / U_MM
            square = rows.T @ rows + np.eye(rows.shape[1])
            step[part] = width[part] * np.linalg.solve(square, rows.T @ right - change[part] / width[part])
        change = change + step
        if np.abs(step / width).max() < SETTLED:
            break
    return change
