"""Coarse place of an observation point: straight cables from four or more reference poses.

Thesis Rashoyan 2021, 5.5, eqs. 5.6-5.8. With Q_j = P_j - P_1, x = B - P_1 and dl_j the change of the cable since pose 1,
|x - Q_j|^2 = (l_1 + dl_j)^2 and |x|^2 = l_1^2 give the linear equations

    Q_j . x + l_1 dl_j = (|Q_j|^2 - dl_j^2) / 2,

so x = a + b l_1 and (b.b - 1) l_1^2 + 2 a.b l_1 + a.a = 0: two roots. (The printed 5.7 has squares on the coordinate differences and
5.8 repeats its first row's terms; both are misprints.) Changing the sign of all dl leaves B and turns l_1 over, so l_1 > 0 decides the
sign of the counts.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray

FLAT = 1e-6  # of the largest spread of the poses: below it they lie in a plane and B has a mirror image


@dataclass(frozen=True)
class CoarseSolution:
    """One root: position (3,) of B [mm, base frame], first_length of the straight cable at the zero pose [mm], rms of the straight
    lengths' misfit [mm], physical when the length and all later ones are positive."""

    position: FloatArray
    first_length: float
    rms: float
    physical: bool


def coarse_solutions(points: FloatArray, changes: FloatArray, zero: int, near: FloatArray) -> list[CoarseSolution]:
    """Both roots from (n, 3) positions of the attachment point [mm] and (n,) changes of the cable [mm].

    Physical roots stand first; of two, the one nearer to the point's nominal position near (3,): four poses fit both exactly.

    Empty when there are fewer than four poses or they lie in a plane. When noise leaves no real root, the nearest (double) one is given.
    """
    others = np.delete(np.arange(len(points)), zero)
    Q, dl = points[others] - points[zero], changes[others] - changes[zero]
    if len(others) < 3:
        return []
    spread = np.linalg.svd(Q, compute_uv=False)
    if spread[2] < FLAT * spread[0]:
        return []
    right = np.column_stack([(np.einsum("ij,ij->i", Q, Q) - dl**2) / 2, -dl])
    a, b = np.linalg.lstsq(Q, right, rcond=None)[0].T
    A, B, C = b @ b - 1.0, a @ b, a @ a
    root = np.sqrt(max(B * B - A * C, 0.0))
    # the stable pair of roots of A l^2 + 2 B l + C
    s = -(B + np.copysign(root, B))
    lengths = {s / A if A != 0 else np.inf, C / s if s != 0 else 0.0}
    out = []
    for length in lengths:
        if not np.isfinite(length):
            continue
        x = a + b * length
        misfit = np.linalg.norm(x - Q, axis=1) - (length + dl)
        physical = bool(length > 0 and (length + dl > 0).all())
        out.append(CoarseSolution(points[zero] + x, float(length), float(np.sqrt(np.mean(misfit**2))), physical))
    return sorted(out, key=lambda c: (not c.physical, float(np.linalg.norm(c.position - near))))
