"""Poses of given lengths, reached from a known pose by changing the lengths steadily: the screw method (thesis 4.4)."""

from collections.abc import Callable

import numpy as np

from lmeasure.core import BoolArray, FloatArray, se3

WAY, STEPS = 12, 8
"""Parts in which lengths are changed from those of the known poses, and Newton's steps after the last of them."""
SINGULAR = 1e-9
"""Least singular value of the rows, lengths in parts of the platform's size, at which a pose is lost."""
Rows = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function of poses (N, 7) that gives rows (N, m, 6) by twists (omega; v at the base's origin), and lengths (N, m)."""


def driven(rows_of: Rows, poses: FloatArray, lengths: FloatArray, size_mm: float) -> tuple[FloatArray, BoolArray]:
    """Return poses (N, 7) with lengths (N, m), driven there from poses (N, 7), and whether no step met a singular pose (N,).

    size_mm: length at which a turn counts. More than six lengths are met by least squares.
    """
    begun = rows_of(poses)[1]
    good = np.ones(len(poses), np.bool_)
    size = np.array([*(size_mm,) * 3, 1.0, 1.0, 1.0])
    for step in range(1, WAY + STEPS):
        rows, own = rows_of(poses)
        lost = np.asarray(~np.isfinite(rows).all(axis=(1, 2)))
        u, s, vt = np.linalg.svd(np.where(lost[:, None, None], 0.0, rows) / size, full_matrices=False)
        good &= (s[:, -1] > SINGULAR) & ~lost
        off = np.where(lost[:, None], 0.0, begun + min(step / WAY, 1.0) * (lengths - begun) - own)
        twist = np.einsum("nji,nj->ni", vt, np.einsum("nji,nj->ni", u, off) / np.maximum(s, SINGULAR)) / size
        # a lost platform must not run away from the others' numbers
        twist *= np.minimum(1.0, 0.5 * size_mm / np.maximum(np.abs(twist * size).max(axis=1), 1e-300))[:, None]
        at_origin = np.concatenate([twist[:, :3], twist[:, 3:] + np.cross(twist[:, :3], poses[:, :3])], axis=1)
        poses = se3.displaced(poses, at_origin)
    return poses, good
