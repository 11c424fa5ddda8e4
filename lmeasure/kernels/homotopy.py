"""Assemblies of six straight links followed from one platform to another: one path of a parameter homotopy in Study coordinates.

Unknowns are eight homogeneous complex numbers x = (e, g): e the quaternion of the orientation, scalar first, and g = p e with the position
p. A link from a in the base's frame to b in the platform's has the length l where |g + e b - a e|^2 = l^2 |e|^2, a quadric:

    g.g + 2 g.(e b - a e) + c e.e + 2 e.(a e b) = 0,  c = |a|^2 + |b|^2 - l^2,

all products bilinear. With the Study quadric e.g = 0 these are seven equations (Wampler, Forward displacement analysis of general six-in-
parallel SPS (Stewart) platform manipulators using soma coordinates, 1996). A link's row is (a, b, c).
"""

import math

import numpy as np

from lmeasure.core import ComplexArray, IntArray
from lmeasure.kernels.decorators import inline, kernel

REACHED, LOST = 0, 1
FIRST_STEP, LEAST_STEP, MOST_STEPS = 0.02, 1e-9, 4000
NEAR = 1e-4
"""How far, of a point of length one, a step may end beside its path: so near Newton's method does not leave it for another."""
WANTED = 1e-6
"""How far it is meant to end; steps grow and shrink by that."""
STAGES = 6
PART = (0.0, 0.5, 0.5, 1.0, 1.0, 1.0)
"""Where in a step each stage stands."""
WEIGHT = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)


@inline
def equations(links: ComplexArray, x: ComplexArray, J: ComplexArray, F: ComplexArray) -> None:
    """The seven equations (7,) at x (8,) into F and their derivatives into J (8, 8), whose last row is left as it is."""
    e0, e1, e2, e3, g0, g1, g2, g3 = x
    gg, ee = g0 * g0 + g1 * g1 + g2 * g2 + g3 * g3, e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3
    for i in range(6):
        a1, a2, a3, b1, b2, b3, c = links[i]
        d1, d2, d3, s1, s2, s3 = b1 - a1, b2 - a2, b3 - a3, a1 + b1, a2 + b2, a3 + b3
        # e b - a e, and g b - a g
        h0, h1 = -(d1 * e1 + d2 * e2 + d3 * e3), e0 * d1 + e2 * s3 - e3 * s2
        h2, h3 = e0 * d2 + e3 * s1 - e1 * s3, e0 * d3 + e1 * s2 - e2 * s1
        k0, k1 = -(d1 * g1 + d2 * g2 + d3 * g3), g0 * d1 + g2 * s3 - g3 * s2
        k2, k3 = g0 * d2 + g3 * s1 - g1 * s3, g0 * d3 + g1 * s2 - g2 * s1
        # u = e b, w = a u
        u0, u1 = -(e1 * b1 + e2 * b2 + e3 * b3), e0 * b1 + e2 * b3 - e3 * b2
        u2, u3 = e0 * b2 + e3 * b1 - e1 * b3, e0 * b3 + e1 * b2 - e2 * b1
        w0, w1 = -(a1 * u1 + a2 * u2 + a3 * u3), u0 * a1 + a2 * u3 - a3 * u2
        w2, w3 = u0 * a2 + a3 * u1 - a1 * u3, u0 * a3 + a1 * u2 - a2 * u1
        J[i, 0], J[i, 1] = 2.0 * (c * e0 - k0 + 2.0 * w0), 2.0 * (c * e1 - k1 + 2.0 * w1)
        J[i, 2], J[i, 3] = 2.0 * (c * e2 - k2 + 2.0 * w2), 2.0 * (c * e3 - k3 + 2.0 * w3)
        J[i, 4], J[i, 5], J[i, 6], J[i, 7] = 2.0 * (g0 + h0), 2.0 * (g1 + h1), 2.0 * (g2 + h2), 2.0 * (g3 + h3)
        F[i] = gg + 2.0 * (g0 * h0 + g1 * h1 + g2 * h2 + g3 * h3) + c * ee + 2.0 * (e0 * w0 + e1 * w1 + e2 * w2 + e3 * w3)
    J[6, 0], J[6, 1], J[6, 2], J[6, 3], J[6, 4], J[6, 5], J[6, 6], J[6, 7] = g0, g1, g2, g3, e0, e1, e2, e3
    F[6] = e0 * g0 + e1 * g1 + e2 * g2 + e3 * g3


@inline
def drift(at: ComplexArray, way: ComplexArray, x: ComplexArray, F: ComplexArray) -> None:
    """The rates (6,) of the links' equations at x while the links at move by way."""
    e0, e1, e2, e3, g0, g1, g2, g3 = x
    ee = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3
    for i in range(6):
        a1, a2, a3, b1, b2, b3, _ = at[i]
        p1, p2, p3, q1, q2, q3, c = way[i]
        d1, d2, d3, s1, s2, s3 = q1 - p1, q2 - p2, q3 - p3, p1 + q1, p2 + q2, p3 + q3
        h0, h1 = -(d1 * e1 + d2 * e2 + d3 * e3), e0 * d1 + e2 * s3 - e3 * s2
        h2, h3 = e0 * d2 + e3 * s1 - e1 * s3, e0 * d3 + e1 * s2 - e2 * s1
        u0, u1 = -(e1 * b1 + e2 * b2 + e3 * b3), e0 * b1 + e2 * b3 - e3 * b2
        u2, u3 = e0 * b2 + e3 * b1 - e1 * b3, e0 * b3 + e1 * b2 - e2 * b1
        v0, v1 = -(e1 * q1 + e2 * q2 + e3 * q3), e0 * q1 + e2 * q3 - e3 * q2
        v2, v3 = e0 * q2 + e3 * q1 - e1 * q3, e0 * q3 + e1 * q2 - e2 * q1
        w0, w1 = -(p1 * u1 + p2 * u2 + p3 * u3), u0 * p1 + p2 * u3 - p3 * u2
        w2, w3 = u0 * p2 + p3 * u1 - p1 * u3, u0 * p3 + p1 * u2 - p2 * u1
        w0, w1 = w0 - (a1 * v1 + a2 * v2 + a3 * v3), w1 + v0 * a1 + a2 * v3 - a3 * v2
        w2, w3 = w2 + v0 * a2 + a3 * v1 - a1 * v3, w3 + v0 * a3 + a1 * v2 - a2 * v1
        F[i] = 2.0 * (g0 * h0 + g1 * h1 + g2 * h2 + g3 * h3) + c * ee + 2.0 * (e0 * w0 + e1 * w1 + e2 * w2 + e3 * w3)
    F[6] = 0.0


@inline
def solve(J: ComplexArray, y: ComplexArray) -> bool:
    """J^-1 y into y, J (8, 8) being used up; False where a pivot vanishes."""
    for k in range(8):
        best, top = k, 0.0
        for i in range(k, 8):
            size = abs(J[i, k].real) + abs(J[i, k].imag)
            if size > top:
                best, top = i, size
        if not top > 1e-300:
            return False
        if best != k:
            for j in range(k, 8):
                J[k, j], J[best, j] = J[best, j], J[k, j]
            y[k], y[best] = y[best], y[k]
        over = 1.0 / J[k, k]
        for i in range(k + 1, 8):
            m = J[i, k] * over
            for j in range(k + 1, 8):
                J[i, j] -= m * J[k, j]
            y[i] -= m * y[k]
        J[k, k] = over
    for k in range(7, -1, -1):
        rest = y[k]
        for j in range(k + 1, 8):
            rest -= J[k, j] * y[j]
        y[k] = rest * J[k, k]
    return True


@inline
def size(x: ComplexArray) -> float:
    """The length of a vector (8,)."""
    square = 0.0
    for i in range(8):
        square += x[i].real * x[i].real + x[i].imag * x[i].imag
    return math.sqrt(square)


@kernel
def follow_homotopy(start: ComplexArray, aim: ComplexArray, points: ComplexArray) -> tuple[ComplexArray, IntArray]:
    """Solutions (n, 8) of links start (6, 7) followed to those of links aim (6, 7) along the straight way between their dimensions.

    (n, 8) ends of length one, and (n,) whether each was REACHED or LOST: a path whose end is singular or at infinity.
    """
    n = points.shape[0]
    ends, determined = points.copy(), np.zeros(n, np.int64)
    way = aim - start
    J, at = np.zeros((8, 8), np.complex128), np.zeros((6, 7), np.complex128)
    x, y, z, k, ahead = np.zeros((5, 8), np.complex128)
    for path in range(n):
        x[:] = points[path]
        t, step, determined[path] = 0.0, FIRST_STEP, LOST
        for _ in range(MOST_STEPS):
            x /= size(x)
            step = min(step, 1.0 - t)
            first, fine = 0.0, True
            ahead[:] = 0.0
            k[:] = 0.0
            # four stages of the classical Runge-Kutta step along the path's tangents, then two of Newton's method, in the patch of x
            for stage in range(STAGES):
                part = PART[stage]
                for i in range(6):
                    for j in range(7):
                        at[i, j] = start[i, j] + (t + part * step) * way[i, j]
                if stage < 4:
                    for j in range(8):
                        y[j] = x[j] + part * step * k[j]
                equations(at, y, J, z)
                if stage < 4:
                    drift(at, way, y, z)
                for j in range(8):
                    J[7, j] = x[j].real - 1j * x[j].imag
                    z[j] = -z[j]
                z[7] = 0.0
                if not solve(J, z):
                    fine = False
                    break
                if stage < 4:
                    for j in range(8):
                        k[j] = z[j]
                        ahead[j] += WEIGHT[stage] * z[j]
                    if stage == 3:
                        for j in range(8):
                            y[j] = x[j] + step * ahead[j]
                    continue
                for j in range(8):
                    y[j] += z[j]
                gone = size(z)
                if stage == 4:
                    first = gone
                    fine = gone < NEAR
                else:
                    fine = gone < 0.01 * first + 1e-10 and size(y) < 2.0
                if not fine:
                    break
            if fine:
                x[:] = y
                t += step
                if t >= 1.0:
                    determined[path] = REACHED
                    break
                step *= min(3.0, max(0.5, 0.9 * (WANTED / (first + 1e-30)) ** 0.2))
            else:
                step *= 0.4
                if step < LEAST_STEP:
                    break
        ends[path] = x / size(x)
    return ends, determined
