"""Radius of the sphere that holds 95 % of a three-dimensional Gaussian with any covariance.

The squared distance Q from the mean is a sum of three independent chi-squares weighted by the eigenvalues; its characteristic function is
det(I - 2it C)^(-1/2), so its distribution depends on C through the invariants e1 = trace, e2 = sum of principal 2x2 minors,
e3 = determinant alone. Hence r95 = sqrt(e1) f(a, b) with a = 3 e2/e1^2 and b = 27 e3/e1^3, both in [0, 1]: no eigenvalues, no branch. f is
the minimax polynomial of degree 5 to the exact quantile (`accuracy.radius.exact_radius_95`): iteratively reweighted least squares over a
grid of ratios of eigenvalues, denser towards the needle and the disc. Its error is less than 5e-5 of the radius everywhere.
"""

import math

from lmeasure.kernels.decorators import inline

# coefficients of a^i b^j, i down, j across
RADIUS_95 = (
    (1.96004334, -0.00235847327, -0.0753295811, -0.059095258, -0.202221293, -0.0345639095),
    (-0.242814538, 0.0739663265, 0.553339323, 0.503434729, 0.302303467),
    (-0.0714822104, 0.0669815393, -1.08313637, -0.562140276),
    (-0.00888948428, -0.381142257, 0.657978782),
    (-0.250916862, 0.148544589),
    (0.321536949,),
)


@inline
def radius_95(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> float:
    """r95 [mm] of the covariance with these elements [mm^2]; NaN when it is zero."""
    e1 = xx + yy + zz
    k = 1.0 / e1
    a = 3.0 * k * k * (xx * yy + yy * zz + zz * xx - xy * xy - xz * xz - yz * yz)
    b = 27.0 * k * k * k * (xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))
    c = RADIUS_95
    f0 = c[0][0] + b * (c[0][1] + b * (c[0][2] + b * (c[0][3] + b * (c[0][4] + b * c[0][5]))))
    f1 = c[1][0] + b * (c[1][1] + b * (c[1][2] + b * (c[1][3] + b * c[1][4])))
    f2 = c[2][0] + b * (c[2][1] + b * (c[2][2] + b * c[2][3]))
    f3 = c[3][0] + b * (c[3][1] + b * c[3][2])
    f4 = c[4][0] + b * c[4][1]
    return math.sqrt(e1) * (f0 + a * (f1 + a * (f2 + a * (f3 + a * (f4 + a * c[5][0])))))
