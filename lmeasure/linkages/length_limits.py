"""Limits of lengths within which the assembly of one pose is never singular, for links of any structure, proved around that pose.

If no tetrahedra lead to a pose, edges do not determine the singular poses. With the pose for the origin, its Study coordinates are x = (1,
e; g), y = (e; g) is small, and each link is a quadric J_k y + y Q_k y = d_k (1 + e.e), d_k the change of its squared length; the seventh is
Study's. In u = J y, the changes to first order,

    u = T(u) = d (1 + e.e) - u B u / 2,     B_k = 2 A' Q_k A,  A = J^-1,

whose second derivatives are constants. If |T| < U over |u| < U and all |d| < D, and T contracts there, then all lengths between have one
and only one assembly in that box, which changes smoothly with them, and the links hold the platform at it (Kantorovich; Rump, Verification
methods, 2010, 13.3). The box of one pose is not the whole free region: beyond it there is no statement.
"""

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import study_quadric

SLACK = 1e-11  # Of every term: far more than all roundings of it together, quadrics and an inverse of a condition below CONDITION included
CONDITION = 1e4  # with coordinates in parts of the rig's size
STEPS = 200


class Around:
    """Six links from base (6, 3) to platform (6, 3) [mm] around a pose (7,), base_from_platform."""

    def __init__(self, base: FloatArray, platform: FloatArray, pose: FloatArray) -> None:
        here = se3.apply(se3.inverse(pose), base)
        middle = platform.mean(axis=0)
        self.lengths = np.linalg.norm(platform - here, axis=1)
        self._unit = float(2.0 ** np.round(np.log2(np.ptp(np.vstack([here, platform]), axis=0).max())))
        a, b = (here - middle) / self._unit, (platform - middle) / self._unit
        Q = study_quadric.quadrics(study_quadric.links(a, b, (self.lengths / self._unit) ** 2)).real
        J = 2.0 * Q[:, 1:, 0]
        self._holds = bool(np.linalg.cond(J) < CONDITION)
        A = np.linalg.inv(J) if self._holds else np.zeros((7, 7))
        self._B = np.abs(2.0 * np.einsum("pi,kpq,qj->kij", A, Q[:, 1:, 1:], A)) * (1.0 + SLACK)
        self._C = np.abs(A[:3].T @ A[:3]) * (1.0 + SLACK)

    def sound(self, box: FloatArray) -> bool:
        """Return whether the assembly of the pose is proved to continue, never singular, over a box (6, 2) of lengths [mm] around its
        own."""
        if not self._holds or not ((box[:, 0] <= self.lengths) & (self.lengths <= box[:, 1])).all():
            return False
        off = np.abs(box**2 - (self.lengths**2)[:, None]).max(axis=1) / self._unit**2
        D = np.append(off, 0.0) * (1.0 + SLACK) + SLACK
        U = D.copy()
        for _ in range(STEPS):
            wider = 1.0001 * np.maximum(*self._moved(D, U)) + 2.0 * SLACK
            if not (np.isfinite(wider).all() and (wider < 1e3).all()):
                return False
            if (wider <= U).all():
                break
            U = np.maximum(U, wider)
        reach, slope = self._moved(D, U)
        return bool((reach + SLACK < U).all() and (slope + SLACK < U).all())

    def _moved(self, D: FloatArray, U: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(7,) bounds of |T| and of |DT| U over |u| < U, |d| < D."""
        bent, turned = np.einsum("kij,i,j->k", self._B, U, U), float(U @ self._C @ U)
        return D * (1.0 + turned) + 0.5 * bent, bent + 2.0 * D * turned
