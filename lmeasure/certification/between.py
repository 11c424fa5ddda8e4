"""Paths between their samples: how far a true path may lie off from what is read of it there.

Between samples i and i + 1 the slowest change is none: the robot keeps the velocity it had before i until somewhere it takes the one it has
behind i + 1. Kept so, it leaves the straight line between the two by tau times D, and comes back to it by (1 - tau) times E, where

    D = dt_i (V_i - V_(i-1)),    E = dt_i (V_(i+1) - V_i)

are the changes of the velocity V between samples, over the step. It turns where both meet, |D| |E| / (|D| + |E|) off the line: the apex of
the triangle of the step and of its neighbours' extensions. That is v h |change of direction| / 4 at a sharp corner in the middle of a step h,
a h^2 / 2 at a steady acceleration a, and nothing on a straight line. Every path that bends to one side only lies within these triangles.

A motion that the samples resolve is known far better, by cubics. It is one whose samples lie on the cubics through their neighbours: what
they lie off is at least a third of the height of an apex that hides between them (`OF_KINK`). Where they lie off no farther than they err,
nothing is added.

The corner of a program is known beforehand to be one. A path that passes it at a distance c, rounding it, has

    N = c phi / ((1 / cos(phi / 2) - 1) s)

steps of a length s on an arc about it that turns by phi. The distance that cubics read there is off by less than `SHARP` of the apex of a
sharp corner, and by less than `ROUNDED` / N^2 of it.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.interpolation import lagrange

OF_KINK = 3.0
NOISE = 4.0
"""Times the variance of how far samples lie off the cubics, that noise alone hardly reaches in any of a few."""
SHARP = 0.7
ROUNDED = 0.4
AS_UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of what lies anywhere within a bound, over the bound."""


@dataclass(frozen=True)
class Between:
    """Steps between samples: apex (k, 3) [mm] from the line to the apex of each, kink (k,) [mm] the farthest that samples about the step
    lie off the cubics through their neighbours, and part of their noise's variance (k,) that has."""

    apex: FloatArray
    kink: FloatArray
    noise: FloatArray

    def __getitem__(self, steps: IntArray) -> "Between":
        return Between(self.apex[steps], self.kink[steps], self.noise[steps])

    def bound(self, variance: FloatArray | float) -> FloatArray:
        """(k, 3) how far, and to which side, the path may lie off, by samples whose squared errors [mm^2] are so large on average (k,)."""
        seen = OF_KINK * np.sqrt(np.maximum(self.kink**2 - NOISE * self.noise * variance, 0.0))
        height = np.linalg.norm(self.apex, axis=-1)
        return self.apex * np.divide(np.minimum(height, seen), height, out=np.zeros_like(height), where=height > 0.0)[..., None]


def between(time_s: FloatArray, positions: FloatArray) -> Between:
    """The steps between k samples at time_s (k,) [s] at positions (k, 3) [mm]."""
    k = len(time_s)
    apex, kink, noise = np.zeros((k - 1, 3)), np.zeros(k - 1), np.ones(k - 1)
    if k < 5:
        return Between(apex, kink, noise)
    step = np.diff(time_s)
    velocity = np.diff(positions, axis=0) / step[:, None]
    before, behind = np.zeros((k - 1, 3)), np.zeros((k - 1, 3))
    before[1:] = step[1:, None] * np.diff(velocity, axis=0)
    behind[:-1] = step[:-1, None] * np.diff(velocity, axis=0)
    one, other = np.linalg.norm(before, axis=1), np.linalg.norm(behind, axis=1)
    both = np.maximum(one + other, 1e-300)
    apex = -0.5 * (before * (other / both)[:, None] + behind * (one / both)[:, None])
    # each sample against the cubic through two on either side
    around = np.arange(2, k - 2)[:, None] + np.array([-2, -1, 1, 2])
    weights = lagrange(time_s[around] - time_s[2:-2, None], np.zeros(k - 4))
    off, part = np.zeros(k), np.ones(k)
    off[2:-2] = np.linalg.norm(positions[2:-2] - np.einsum("mk,mki->mi", weights, positions[around]), axis=1)
    part[2:-2] = 1.0 + (weights**2).sum(axis=1)
    about = np.clip(np.arange(k - 1)[:, None] + np.arange(-1, 3), 0, k - 1)
    farthest = np.argmax(off[about] / np.sqrt(part[about]), axis=1)
    there = about[np.arange(k - 1), farthest]
    return Between(apex, off[there], part[there])


def at_corner(distance_mm: float, step_mm: float, cosine: float) -> float:
    """How far [mm] the distance at which a path passes a corner may be off, by steps about it; cosine: of the angle between its lines'
    directions."""
    turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    sharp = 0.5 * step_mm * np.sin(0.5 * turn)
    opening = 1.0 / max(np.cos(0.5 * turn), 1e-3) - 1.0
    steps = distance_mm * turn / max(opening * step_mm, 1e-300)
    return float(sharp * min(SHARP, ROUNDED / max(steps, 1e-9) ** 2))
