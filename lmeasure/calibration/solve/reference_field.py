"""Errors of reference poses from the robot's own controller: smooth over its poses, and correlated.

A robot whose links differ from its controller's model has similar errors at neighbouring poses. Such errors are a Gaussian process over
positions and orientations, one for positions and one for rotations, with unknown sizes (`calibration.solve.sizes`). A motion of all poses
together is the robot's base frame, and no error. Joint values are not needed.

Lengths do not show a uniform strain of the poses, as the observation points follow it. Only the curvature of a field shows its size. The
reaches are such that strain and curvature of simulated robots with six axes are in the ratio of the process.
"""

from collections.abc import Mapping

import numpy as np

from lmeasure.core import FloatArray, se3

REACHES = {1000.0: 1.0, 3000.0: 3.0}
"""Size of a field by the distance [mm] within which its errors are alike; a turn counts as its way at `ARM_MM`."""
ARM_MM = 1000.0
HELD_MM = 30.0
FIELD_MM = 0.5
"""Typical size of a field [mm]."""


def fields(poses: FloatArray, J: FloatArray) -> dict[str, FloatArray]:
    """Return covariances (e, e) of residuals by fields of a typical size, by name; J (e, n, 6) derivatives by errors of the poses (n, 7).

    The covariance of a field at two poses is a sum of exp(-d^2/2), d their distance in units of each reach.
    """
    n, arm = len(poses), ARM_MM
    turned = np.abs(poses[:, 3:] @ poses[:, 3:].T).clip(0.0, 1.0)
    square = np.sum((poses[:, None, :3] - poses[None, :, :3]) ** 2, axis=2) + (arm * 2.0 * np.arccos(turned)) ** 2
    # the base frame is where the positions are on the whole; turns count little, and only where positions alone do not hold it
    moved = np.zeros((n, 6, 6))
    moved[:, :3, :3], moved[:, 3:] = np.eye(3), se3.at_points(poses[:, :3])[:, 3:]
    G, weight = moved.reshape(6 * n, 6), np.tile(np.repeat([HELD_MM, 1.0], 3), n)
    F = J.reshape(len(J), 6 * n)
    F = F - (F @ G) @ np.linalg.pinv(G * weight[:, None]) * weight
    by_pose = FIELD_MM * (F / np.tile(np.repeat([arm, 1.0], 3), n)).reshape(len(J), n, 6)
    alike = np.sum([size**2 * np.exp(-0.5 * square / reach**2) for reach, size in REACHES.items()], axis=0)
    out = {}
    for name, own in (("field_position", by_pose[:, :, 3:]), ("field_rotation", by_pose[:, :, :3])):
        smooth = np.einsum("enc,nk->ekc", own, alike, optimize=True)
        out[name] = np.tensordot(smooth, own, axes=((1, 2), (1, 2)))
    return out


def field_covariance(sizes: Mapping[str, float], poses: FloatArray, J: FloatArray) -> FloatArray:
    """Return the covariance (e, e) of residuals by fields of these sizes, in units of the typical one."""
    return np.asarray(sum((sizes[name] ** 2 * A for name, A in fields(poses, J).items()), start=np.zeros((len(J), len(J)))))
