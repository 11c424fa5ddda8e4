"""Normal equations of redundant channels, WIDTH samples at once and no lane branching: N holds the upper halves of symmetric 6x6 matrices,
and behind them the right sides, a row of lanes for each component.
"""

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.lanes import WIDTH

FREE = 6
PAIRS = 21
"""Of the components of a twist: the upper half of a symmetric 6x6 matrix, row by row."""

Symmetric = tuple[
    float, float, float, float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float, float, float,
]  # fmt: skip


@kernel
def gather(a: FloatArray, r: FloatArray, b: FloatArray, s: FloatArray, N: FloatArray) -> None:
    """Add what two channels, rows a, b (6 WIDTH,) and residuals r, s (WIDTH,), give to the normal equations N (27 WIDTH,)."""
    for i in range(WIDTH):
        a0, a1, a2, a3, a4, a5 = a[i], a[WIDTH + i], a[2 * WIDTH + i], a[3 * WIDTH + i], a[4 * WIDTH + i], a[5 * WIDTH + i]
        b0, b1, b2, b3, b4, b5 = b[i], b[WIDTH + i], b[2 * WIDTH + i], b[3 * WIDTH + i], b[4 * WIDTH + i], b[5 * WIDTH + i]
        N[i] += a0 * a0 + b0 * b0
        N[WIDTH + i] += a0 * a1 + b0 * b1
        N[2 * WIDTH + i] += a0 * a2 + b0 * b2
        N[3 * WIDTH + i] += a0 * a3 + b0 * b3
        N[4 * WIDTH + i] += a0 * a4 + b0 * b4
        N[5 * WIDTH + i] += a0 * a5 + b0 * b5
        N[6 * WIDTH + i] += a1 * a1 + b1 * b1
        N[7 * WIDTH + i] += a1 * a2 + b1 * b2
        N[8 * WIDTH + i] += a1 * a3 + b1 * b3
        N[9 * WIDTH + i] += a1 * a4 + b1 * b4
        N[10 * WIDTH + i] += a1 * a5 + b1 * b5
        N[11 * WIDTH + i] += a2 * a2 + b2 * b2
        N[12 * WIDTH + i] += a2 * a3 + b2 * b3
        N[13 * WIDTH + i] += a2 * a4 + b2 * b4
        N[14 * WIDTH + i] += a2 * a5 + b2 * b5
        N[15 * WIDTH + i] += a3 * a3 + b3 * b3
        N[16 * WIDTH + i] += a3 * a4 + b3 * b4
        N[17 * WIDTH + i] += a3 * a5 + b3 * b5
        N[18 * WIDTH + i] += a4 * a4 + b4 * b4
        N[19 * WIDTH + i] += a4 * a5 + b4 * b5
        N[20 * WIDTH + i] += a5 * a5 + b5 * b5
        N[21 * WIDTH + i] += a0 * r[i] + b0 * s[i]
        N[22 * WIDTH + i] += a1 * r[i] + b1 * s[i]
        N[23 * WIDTH + i] += a2 * r[i] + b2 * s[i]
        N[24 * WIDTH + i] += a3 * r[i] + b3 * s[i]
        N[25 * WIDTH + i] += a4 * r[i] + b4 * s[i]
        N[26 * WIDTH + i] += a5 * r[i] + b5 * s[i]


@inline
def factors(N: FloatArray, i: int) -> Symmetric:
    """N = L D L^T: 1/d0 .. 1/d5 and the fifteen entries of L below its diagonal, row by row."""
    i0 = 1.0 / N[i]
    n1, n2, n3, n4, n5 = N[WIDTH + i], N[2 * WIDTH + i], N[3 * WIDTH + i], N[4 * WIDTH + i], N[5 * WIDTH + i]
    l10, l20, l30, l40, l50 = n1 * i0, n2 * i0, n3 * i0, n4 * i0, n5 * i0
    i1 = 1.0 / (N[6 * WIDTH + i] - l10 * n1)
    m2, m3, m4, m5 = N[7 * WIDTH + i] - l20 * n1, N[8 * WIDTH + i] - l30 * n1, N[9 * WIDTH + i] - l40 * n1, N[10 * WIDTH + i] - l50 * n1
    l21, l31, l41, l51 = m2 * i1, m3 * i1, m4 * i1, m5 * i1
    i2 = 1.0 / (N[11 * WIDTH + i] - l20 * n2 - l21 * m2)
    o3 = N[12 * WIDTH + i] - l30 * n2 - l31 * m2
    o4 = N[13 * WIDTH + i] - l40 * n2 - l41 * m2
    o5 = N[14 * WIDTH + i] - l50 * n2 - l51 * m2
    l32, l42, l52 = o3 * i2, o4 * i2, o5 * i2
    i3 = 1.0 / (N[15 * WIDTH + i] - l30 * n3 - l31 * m3 - l32 * o3)
    p4 = N[16 * WIDTH + i] - l40 * n3 - l41 * m3 - l42 * o3
    p5 = N[17 * WIDTH + i] - l50 * n3 - l51 * m3 - l52 * o3
    l43, l53 = p4 * i3, p5 * i3
    i4 = 1.0 / (N[18 * WIDTH + i] - l40 * n4 - l41 * m4 - l42 * o4 - l43 * p4)
    q5 = N[19 * WIDTH + i] - l50 * n4 - l51 * m4 - l52 * o4 - l53 * p4
    l54 = q5 * i4
    i5 = 1.0 / (N[20 * WIDTH + i] - l50 * n5 - l51 * m5 - l52 * o5 - l53 * p5 - l54 * q5)
    return (
        i0, i1, i2, i3, i4, i5, l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54,
    )  # fmt: skip


@kernel
def inverse(N: FloatArray, V: FloatArray) -> None:
    """The inverses of all lanes' N, as N has them, into V (21 WIDTH,): L^-T D^-1 L^-1."""
    for i in range(WIDTH):
        i0, i1, i2, i3, i4, i5, l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54 = factors(N, i)
        k10, k21, k32, k43, k54 = -l10, -l21, -l32, -l43, -l54
        k20 = -l20 - l21 * k10
        k31 = -l31 - l32 * k21
        k42 = -l42 - l43 * k32
        k53 = -l53 - l54 * k43
        k30 = -l30 - l31 * k10 - l32 * k20
        k41 = -l41 - l42 * k21 - l43 * k31
        k52 = -l52 - l53 * k32 - l54 * k42
        k40 = -l40 - l41 * k10 - l42 * k20 - l43 * k30
        k51 = -l51 - l52 * k21 - l53 * k31 - l54 * k41
        k50 = -l50 - l51 * k10 - l52 * k20 - l53 * k30 - l54 * k40
        m1, m2, m3, m4, m5 = k10 * i1, k20 * i2, k30 * i3, k40 * i4, k50 * i5
        V[i] = i0 + k10 * m1 + k20 * m2 + k30 * m3 + k40 * m4 + k50 * m5
        V[WIDTH + i] = m1 + k21 * m2 + k31 * m3 + k41 * m4 + k51 * m5
        V[2 * WIDTH + i] = m2 + k32 * m3 + k42 * m4 + k52 * m5
        V[3 * WIDTH + i] = m3 + k43 * m4 + k53 * m5
        V[4 * WIDTH + i] = m4 + k54 * m5
        V[5 * WIDTH + i] = m5
        m2, m3, m4, m5 = k21 * i2, k31 * i3, k41 * i4, k51 * i5
        V[6 * WIDTH + i] = i1 + k21 * m2 + k31 * m3 + k41 * m4 + k51 * m5
        V[7 * WIDTH + i] = m2 + k32 * m3 + k42 * m4 + k52 * m5
        V[8 * WIDTH + i] = m3 + k43 * m4 + k53 * m5
        V[9 * WIDTH + i] = m4 + k54 * m5
        V[10 * WIDTH + i] = m5
        m3, m4, m5 = k32 * i3, k42 * i4, k52 * i5
        V[11 * WIDTH + i] = i2 + k32 * m3 + k42 * m4 + k52 * m5
        V[12 * WIDTH + i] = m3 + k43 * m4 + k53 * m5
        V[13 * WIDTH + i] = m4 + k54 * m5
        V[14 * WIDTH + i] = m5
        m4, m5 = k43 * i4, k53 * i5
        V[15 * WIDTH + i] = i3 + k43 * m4 + k53 * m5
        V[16 * WIDTH + i] = m4 + k54 * m5
        V[17 * WIDTH + i] = m5
        V[18 * WIDTH + i] = i4 + k54 * k54 * i5
        V[19 * WIDTH + i] = k54 * i5
        V[20 * WIDTH + i] = i5
