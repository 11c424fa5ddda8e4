"""Paths between their samples: how far a true path may lie off from the one that is read there.

Between samples i and i + 1 the slowest change is none. The robot keeps the velocity it had before i until somewhere it takes the one it has
behind i + 1. It leaves the straight line between the two by tau times D, and comes back to it by (1 - tau) times E, where

    D = dt_i (V_i - V_(i-1)),    E = dt_i (V_(i+1) - V_i)

are the changes of the velocity V between samples, over the step. It turns where both meet, |D| |E| / (|D| + |E|) off the line. This is the
apex of the triangle of the step and of its neighbours' extensions: v h |change of direction| / 4 at a sharp corner in the middle of a
step h, a h^2 / 2 at a steady acceleration a, and nothing on a straight line. Every path that bends to one side only lies within these
triangles.

A motion that the samples resolve is known far better, by cubics: its samples lie on the cubics through their neighbours. Where an apex
hides between them, they lie off by at least a third of its height (`OF_KINK`), and by at least a tenth of the bend there (`OF_BEND`).
Where they lie off no farther than they err, nothing is added.

The corner of a program is known beforehand to be one. A path that passes it at a distance c, rounding it, has

    N = c phi / ((1 / cos(phi / 2) - 1) s)

steps of a length s on an arc about it that turns by phi. The distance that cubics read there is off by less than `SHARP` of the apex of a
sharp corner, and by less than `ROUNDED` / N^2 of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.interpolation import lagrange
from lmeasure.trajectory.pose_errors import PoseErrors

OF_KINK = 3.0
OF_BEND = 0.1
NOISE = 6.0
"""Times the variance of how far samples lie off the cubics, that noise alone hardly reaches in any of a few."""
SHARP = 0.7
ROUNDED = 0.4
AS_UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of what lies anywhere within a bound, over the bound."""


@dataclass(frozen=True)
class Between:
    """Steps between samples.

    apex (k, 3) [mm] from the straight line to the apex of each, from where (k,) on it, as a part of the step; kink (k,) [mm]: the farthest
    that samples about the step lie off the cubics through their neighbours, and part of their noise's variance (k,) that has; bend (k,)
    [mm]: the largest change of velocity about the step, over it.
    """

    apex: FloatArray
    where: FloatArray
    kink: FloatArray
    noise: FloatArray
    bend: FloatArray

    def __getitem__(self, steps: IntArray) -> "Between":
        return Between(*(values[steps] for values in self.values))

    @property
    def values(self) -> tuple[FloatArray, ...]:
        """Return all arrays, in order."""
        return self.apex, self.where, self.kink, self.noise, self.bend

    def bound(self, variance: FloatArray | float) -> FloatArray:
        """(k, 3) how far, and to which side, the path may lie off, by samples whose squared errors [mm^2] are so large on average (k,)."""
        off = np.sqrt(np.maximum(self.kink**2 - NOISE * self.noise * variance, 0.0))
        seen = OF_KINK * off * np.minimum(off / np.maximum(OF_BEND * self.bend, 1e-300), 1.0)
        height = np.linalg.norm(self.apex, axis=-1)
        return self.apex * np.divide(np.minimum(height, seen), height, out=np.zeros_like(height), where=height > 0.0)[..., None]


def between(time_s: FloatArray, positions: FloatArray) -> Between:
    """Return the steps between k samples at time_s (k,) [s] at positions (k, 3) [mm].

    By their times, or as if they came evenly, whichever makes the path smoother there: its shape depends on neither.
    """
    k = len(time_s)
    if k < 5:
        return Between(np.zeros((k - 1, 3)), np.zeros(k - 1), np.zeros(k - 1), np.ones(k - 1), np.zeros(k - 1))
    even = _steps(np.arange(k, dtype=np.float64), positions)
    if not (np.diff(time_s) > 0.0).all():
        return even
    timed = _steps(time_s, positions)
    smoother = timed.kink <= even.kink
    return Between(*(np.where(smoother.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(timed.values, even.values, strict=True)))


def _steps(time_s: FloatArray, positions: FloatArray) -> Between:
    k = len(time_s)
    step = np.diff(time_s)
    velocity = np.diff(positions, axis=0) / step[:, None]
    before, behind = np.zeros((k - 1, 3)), np.zeros((k - 1, 3))
    before[1:] = step[1:, None] * np.diff(velocity, axis=0)
    behind[:-1] = step[:-1, None] * np.diff(velocity, axis=0)
    one, other = np.linalg.norm(before, axis=1), np.linalg.norm(behind, axis=1)
    where = other / np.maximum(one + other, 1e-300)
    apex = -0.5 * (before * where[:, None] + behind * (1.0 - where)[:, None])
    apex[[0, -1]] = 0.0
    # each sample against the cubic through two on either side
    around = np.arange(2, k - 2)[:, None] + np.array([-2, -1, 1, 2])
    weights = lagrange(time_s[around] - time_s[2:-2, None], np.zeros(k - 4))
    off, part = np.zeros(k), np.ones(k)
    off[2:-2] = np.linalg.norm(positions[2:-2] - np.einsum("mk,mki->mi", weights, positions[around]), axis=1)
    part[2:-2] = 1.0 + (weights**2).sum(axis=1)
    about = np.clip(np.arange(k - 1)[:, None] + np.arange(-1, 3), 0, k - 1)
    there = about[np.arange(k - 1), np.argmax(off[about] / np.sqrt(part[about]), axis=1)]
    return Between(apex, where, off[there], part[there], maximum_filter1d(np.maximum(one, other), 3))


def joined(cycles: Sequence[Between]) -> Between:
    """The steps (m,) of each of n cycles as one of m n, step by step."""
    every = (np.stack(each, axis=1) for each in zip(*(b.values for b in cycles), strict=True))
    return Between(*(each.reshape(-1, *each.shape[2:]) for each in every))


def of_samples(errors: PoseErrors) -> FloatArray:
    """(n,) squared errors of single samples [mm^2] on average, of their own and of their place, by which they lie off a smooth path."""
    return np.asarray((errors.own[:, 3:] ** 2).sum(axis=(1, 2)) + (errors.local[:, 3:] ** 2).sum(axis=(1, 2)))


def with_hidden(errors: PoseErrors, own: FloatArray, common: FloatArray) -> PoseErrors:
    """Errors of n places, and what hides between samples: by up to own (n, 3) [mm] anew at every place, and by up to common (n, 3) [mm] in
    common: what reads a corner too round does so in all cycles."""
    added = []
    for bound in (own, common):
        column = np.zeros((len(errors), 6, 1))
        column[:, 3:, 0] = AS_UNIFORM * bound
        added.append(column)
    return replace(
        errors,
        own=np.concatenate([errors.own, added[0]], axis=2) if own.any() else errors.own,
        shared=np.concatenate([errors.shared, added[1]], axis=2) if common.any() else errors.shared,
    )


def at_corner(distance_mm: float, step_mm: float, cosine: float) -> float:
    """How far [mm] the distance at which a path passes a corner may be off, by steps about it; cosine: of the angle between its lines'
    directions."""
    turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    sharp = 0.5 * step_mm * np.sin(0.5 * turn)
    opening = 1.0 / max(np.cos(0.5 * turn), 1e-3) - 1.0
    steps = distance_mm * turn / max(opening * step_mm, 1e-300)
    return float(sharp * min(SHARP, ROUNDED / max(steps, 1e-9) ** 2))
