"""Pluecker rows of links, and their pressure angles."""

import numpy as np

from lmeasure.core import FloatArray


def pluecker_rows(arms: FloatArray, directions: FloatArray) -> FloatArray:
    """(..., m, 6) rows (r x e ; e) of links whose unit directions (..., m, 3) point from the base to the body, r (..., m, 3) being the arms
    from the reference point to the attachment points, in the same axes: row . (omega; v) is the rate of a link's length."""
    return np.concatenate([np.cross(arms, directions), directions], axis=-1)


def pressure_angles(rows: FloatArray, arms: FloatArray) -> FloatArray:
    """(..., 6) pressure-angle analogues [rad] of six links, rows (..., 6, 6) with the arms (..., 6, 3) (thesis 5.1, 5.7).

    The angle between link i and the velocity v_i of its attachment point when only link i changes. At unit rate e_i . v_i = 1, so that it
    is arccos(1/|v_i|). LinAlgError where the rows are singular.
    """
    unit_twists = np.swapaxes(np.linalg.inv(rows), -1, -2)
    v = unit_twists[..., 3:] + np.cross(unit_twists[..., :3], arms)
    return np.asarray(np.arccos(1.0 / np.sqrt(np.maximum(1.0, (v * v).sum(axis=-1)))))
